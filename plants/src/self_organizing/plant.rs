//! A tree as flat arrays of metamers and buds.
//!
//! A metamer is an internode with the node at its far end, which bears a terminal bud or the next
//! metamer of its axis, and lateral buds or branches. Metamers stand in the order in which they
//! grew, parents before children, so that what gathers towards the base is one sweep backwards
//! and what spreads from it is one sweep forwards.

use glam::Vec3;

/// What a node bears at one of its places: a bud, a branch, or nothing any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Slot(u32);

/// A place at a node as a reader sees it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Bears {
    /// Nothing: a bud died or a branch fell.
    Nothing,
    /// A living bud.
    Bud {
        /// Cycles that it has not grown.
        idle: u8,
        /// Whether no marker will ever be in its sight.
        is_blind: bool,
    },
    /// The metamer of this index.
    Metamer(u32),
}

impl Slot {
    /// Nothing.
    pub const EMPTY: Self = Self(u32::MAX);
    /// A bud that has just been formed.
    pub const BUD: Self = Self(Self::FIRST_BUD);
    const FIRST_BUD: u32 = 0xFFFF_0000;
    const BLIND: u32 = 0x100;

    /// The metamer of this index.
    pub fn metamer(index: u32) -> Self {
        debug_assert!(index < Self::FIRST_BUD, "more metamers than slots can name");
        Self(index)
    }

    /// What stands here.
    #[inline]
    pub fn bears(self) -> Bears {
        match self.0 {
            u32::MAX => Bears::Nothing,
            bud if bud >= Self::FIRST_BUD => {
                Bears::Bud { idle: bud as u8, is_blind: bud & Self::BLIND != 0 }
            }
            index => Bears::Metamer(index),
        }
    }

    /// Whether a living bud stands here.
    #[inline]
    pub fn is_bud(self) -> bool {
        self.0 >= Self::FIRST_BUD && self != Self::EMPTY
    }

    /// The same bud a cycle later, dead after `life` cycles; others stay.
    #[inline]
    pub fn waited(self, life: u32) -> Self {
        match self.bears() {
            Bears::Bud { idle, .. } if u32::from(idle) >= life.max(1) => Self::EMPTY,
            Bears::Bud { .. } => Self(self.0 + 1),
            _ => self,
        }
    }

    /// The same bud with or without sight of markers.
    pub fn seeing(self, sees: bool) -> Self {
        match (self.is_bud(), sees) {
            (true, true) => Self(self.0 & !Self::BLIND),
            (true, false) => Self(self.0 | Self::BLIND),
            _ => self,
        }
    }
}

/// An internode with the node at its far end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Metamer {
    /// Its node.
    pub tip: Vec3,
    /// Unit direction of the internode.
    pub heading: Vec3,
    /// Unit direction, across the heading, of the node's first lateral bud.
    pub normal: Vec3,
    /// The metamer it grows from; [`Plant::NOTHING`] for the first.
    pub parent: u32,
    /// Place along its axis, from 0.
    pub place: u32,
    /// Id of its axis.
    pub axis: u64,
    /// Cycle in which it grew.
    pub born: u16,
    /// Order of its axis.
    pub order: u8,
    /// Cycles on end in which its branch gathered too little; kept at the first of an axis.
    pub starving: u8,
}

/// A tree: metamers, what their nodes bear, and what passes through them.
#[derive(Clone, Debug)]
pub struct Plant {
    /// Where it stands.
    pub foot: Vec3,
    /// Metamers, parents first.
    pub metamers: Vec<Metamer>,
    /// Places of each node: the axis' own first, then the lateral ones.
    pub slots: Vec<Slot>,
    /// Places at a node.
    pub stride: usize,
    /// Leaves that fallen branches bore, by the metamer they fell from.
    pub scars: Vec<f32>,
    /// Light or space of each place's bud.
    pub light: Vec<f32>,
    /// Direction of free space for each place's bud, with markers.
    pub toward: Vec<Vec3>,
    /// Light of all buds from a metamer on.
    pub gathered: Vec<f32>,
    /// Metamers from a metamer on, itself included.
    pub count: Vec<u32>,
    /// Living buds from a metamer on.
    pub buds: Vec<u32>,
    /// Leaves ever borne from a metamer on, fallen ones included.
    pub pipe: Vec<f32>,
}

impl Plant {
    /// The parent of the first metamer.
    pub const NOTHING: u32 = u32::MAX;

    /// A seedling: one metamer of `length` with its terminal bud and `laterals` lateral ones.
    pub fn seedling(foot: Vec3, length: f32, laterals: u32) -> Self {
        let mut plant = Self::bare(foot, laterals);
        plant.push(Metamer {
            tip: foot + Vec3::Z * length,
            heading: Vec3::Z,
            normal: Vec3::X,
            parent: Self::NOTHING,
            place: 0,
            axis: crate::skeleton::axis_id(0, "trunk", 0),
            born: 0,
            order: 0,
            starving: 0,
        });
        plant
    }

    fn bare(foot: Vec3, laterals: u32) -> Self {
        Self {
            foot,
            metamers: Vec::new(),
            slots: Vec::new(),
            stride: laterals as usize + 1,
            scars: Vec::new(),
            light: Vec::new(),
            toward: Vec::new(),
            gathered: Vec::new(),
            count: Vec::new(),
            buds: Vec::new(),
            pipe: Vec::new(),
        }
    }

    /// Adds a metamer with fresh buds and returns its index.
    pub fn push(&mut self, metamer: Metamer) -> u32 {
        self.metamers.push(metamer);
        self.slots.resize(self.metamers.len() * self.stride, Slot::BUD);
        self.scars.push(0.0);
        (self.metamers.len() - 1) as u32
    }

    /// Where an internode begins.
    pub fn start(&self, index: usize) -> Vec3 {
        match self.metamers[index].parent {
            Self::NOTHING => self.foot,
            parent => self.metamers[parent as usize].tip,
        }
    }

    /// The places of a node.
    #[inline]
    pub fn slots_of(&self, index: usize) -> &[Slot] {
        &self.slots[index * self.stride..(index + 1) * self.stride]
    }

    /// Whether a metamer is the first of a lateral branch.
    #[inline]
    pub fn begins_branch(&self, index: usize) -> bool {
        let parent = self.metamers[index].parent;
        parent != Self::NOTHING
            && self.slots[parent as usize * self.stride] != Slot::metamer(index as u32)
    }

    /// Direction of the bud at a place: the axis' own, or `angle` (rad) away from it.
    pub fn bud_direction(&self, index: usize, place: usize, angle: f32) -> Vec3 {
        let Metamer { heading, normal, .. } = self.metamers[index];
        if place == 0 {
            return heading;
        }
        let laterals = (self.stride - 1) as f32;
        let turn = std::f32::consts::TAU * (place - 1) as f32 / laterals;
        let (sin_t, cos_t) = libm::sincosf(turn);
        let (sin_a, cos_a) = libm::sincosf(angle);
        let side = normal * cos_t + heading.cross(normal) * sin_t;
        heading * cos_a + side * sin_a
    }

    /// Gathers light and counts from the tips to the base: the sweep backwards.
    pub fn gather(&mut self) {
        let count = self.metamers.len();
        self.gathered.resize(count, 0.0);
        self.count.resize(count, 0);
        self.buds.resize(count, 0);
        for index in (0..count).rev() {
            let (mut light, mut metamers, mut buds) = (0.0, 1, 0);
            for place in index * self.stride..(index + 1) * self.stride {
                match self.slots[place].bears() {
                    Bears::Nothing => {}
                    Bears::Bud { .. } => {
                        light += self.light[place];
                        buds += 1;
                    }
                    Bears::Metamer(child) => {
                        let child = child as usize;
                        light += self.gathered[child];
                        metamers += self.count[child];
                        buds += self.buds[child];
                    }
                }
            }
            self.gathered[index] = light;
            (self.count[index], self.buds[index]) = (metamers, buds);
        }
    }

    /// Gathers pipes from the tips to the base: those of a metamer lead to its own leaf, to those
    /// of all metamers beyond it, and to those of fallen branches as far as scars remember them.
    pub fn gather_pipes(&mut self) {
        self.pipe.clear();
        self.pipe.extend(self.scars.iter().map(|scar| 1.0 + scar));
        for index in (1..self.metamers.len()).rev() {
            self.pipe[self.metamers[index].parent as usize] += self.pipe[index];
        }
    }

    /// Removes the branches that begin with a marked metamer, and calls `fallen` for each metamer
    /// removed. What a branch bore stays in the pipe of the metamer below it if `memory`.
    ///
    /// The memory needs [`Plant::gather_pipes`] since the last growth.
    pub fn shed(&mut self, mut marked: Vec<bool>, memory: bool, mut fallen: impl FnMut(Vec3)) {
        let count = self.metamers.len();
        let mut index_after = vec![Self::NOTHING; count];
        let mut kept = 0;
        for index in 0..count {
            let parent = self.metamers[index].parent;
            let falls_with = parent != Self::NOTHING && marked[parent as usize];
            if marked[index] && !falls_with && parent != Self::NOTHING {
                let parent = parent as usize;
                if memory {
                    self.scars[parent] += self.pipe.get(index).copied().unwrap_or(1.0);
                }
                let places = parent * self.stride..(parent + 1) * self.stride;
                let branch = Slot::metamer(index as u32);
                self.slots[places].iter_mut().for_each(|slot| {
                    if *slot == branch {
                        *slot = Slot::EMPTY;
                    }
                });
            }
            marked[index] |= falls_with;
            if marked[index] {
                fallen(self.metamers[index].tip);
            } else {
                index_after[index] = kept;
                kept += 1;
            }
        }
        self.close_gaps(&index_after);
    }

    fn close_gaps(&mut self, index_after: &[u32]) {
        let after = |index: u32| match index {
            Self::NOTHING => Self::NOTHING,
            index => index_after[index as usize],
        };
        let mut kept = 0;
        for (index, &new) in index_after.iter().enumerate() {
            if new == Self::NOTHING {
                continue;
            }
            let metamer = self.metamers[index];
            self.metamers[kept] = Metamer { parent: after(metamer.parent), ..metamer };
            self.scars[kept] = self.scars[index];
            for place in 0..self.stride {
                let slot = self.slots[index * self.stride + place];
                self.slots[kept * self.stride + place] = match slot.bears() {
                    Bears::Metamer(child) => Slot::metamer(after(child)),
                    _ => slot,
                };
            }
            kept += 1;
        }
        self.metamers.truncate(kept);
        self.scars.truncate(kept);
        self.slots.truncate(kept * self.stride);
    }

    /// Bytes that the tree takes.
    pub fn bytes(&self) -> usize {
        let floats = self.scars.capacity() + self.light.capacity() + self.gathered.capacity();
        self.metamers.capacity() * size_of::<Metamer>()
            + self.slots.capacity() * size_of::<Slot>()
            + self.toward.capacity() * size_of::<Vec3>()
            + (floats + self.pipe.capacity() + self.count.capacity() + self.buds.capacity()) * 4
    }
}
