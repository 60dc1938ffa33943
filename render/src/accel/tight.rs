//! Nodes in 84 bytes instead of 224, for trees over very many placements.
//!
//! Boxes of children are steps of a grid of 256 on the node's own box, rounded outwards; children
//! follow one another, so that two numbers lead to all of them [Ylitie17] §4. Decoding makes the
//! walk of such a tree somewhat slower: it is for scenes whose top level would not fit otherwise.

use super::Bounds;
use super::lanes::{LEAF, LaneHits, Lanes, LocalRay, Node};
use glam::Vec3A;

/// Eight children, their boxes rounded outwards.
#[derive(Clone, Copy, Debug)]
#[repr(C)]
pub(crate) struct TightNode {
    /// Low corner of the node's box, and the steps along its sides.
    pub low: [f32; 3],
    pub step: [f32; 3],
    /// Low x, y, z, then high x, y, z, in steps.
    pub planes: [[u8; 8]; 6],
    /// First of the children that are nodes, and of those that are leaves.
    first_node: u32,
    first_leaf: u32,
    /// Children that are there, and those of them that are nodes.
    pub used: u8,
    inner: u8,
}

/// What a walk needs of a node.
pub(crate) trait Branch {
    /// Children that a ray meets between 0 and `limit`.
    ///
    /// # Safety
    /// The processor has the features that `L` needs.
    unsafe fn boxes<L: Lanes>(&self, ray: &LocalRay, limit: f32) -> LaneHits;

    /// Where a child leads.
    fn link(&self, lane: usize) -> u32;
}

impl Branch for Node {
    #[inline(always)]
    unsafe fn boxes<L: Lanes>(&self, ray: &LocalRay, limit: f32) -> LaneHits {
        // SAFETY: the caller vouches for the features.
        unsafe { L::boxes(self, ray, limit) }
    }

    #[inline(always)]
    fn link(&self, lane: usize) -> u32 {
        self.links[lane & 7]
    }
}

impl Branch for TightNode {
    #[inline(always)]
    unsafe fn boxes<L: Lanes>(&self, ray: &LocalRay, limit: f32) -> LaneHits {
        // SAFETY: the caller vouches for the features.
        let mut hits = unsafe { L::tight_boxes(self, ray, limit) };
        // An absent child is an empty box, yet rounding may close it.
        hits.mask &= u32::from(self.used);
        hits
    }

    #[inline(always)]
    fn link(&self, lane: usize) -> u32 {
        let before = (1u8 << (lane & 7)) - 1;
        if self.inner >> (lane & 7) & 1 == 1 {
            self.first_node + (self.inner & before).count_ones()
        } else {
            LEAF | (self.first_leaf + (self.used & !self.inner & before).count_ones())
        }
    }
}

impl TightNode {
    /// The same children in less space. Those that are nodes, and those that are leaves, must
    /// follow one another in their numbers, as they do after [`widen`](super::build::widen).
    pub fn new(node: &Node) -> Self {
        let around = node.children().fold(Bounds::EMPTY, |all, (bounds, _)| all.union(bounds));
        let mut tight = Self {
            low: around.low.to_array(),
            step: [0.0; 3],
            planes: [[255; 8], [255; 8], [255; 8], [0; 8], [0; 8], [0; 8]],
            first_node: u32::MAX,
            first_leaf: u32::MAX,
            used: 0,
            inner: 0,
        };
        for axis in 0..3 {
            let mut step = (around.high[axis] - around.low[axis]) / 255.0;
            // The last step must reach the far side in spite of rounding.
            while tight.low[axis] + 255.0 * step < around.high[axis] {
                step = (step * (1.0 + f32::EPSILON)).max(f32::MIN_POSITIVE).next_up();
            }
            tight.step[axis] = step;
        }
        for (slot, (bounds, link)) in node.children().enumerate() {
            debug_assert_eq!(node.links[slot], link, "children fill the first slots");
            tight.used |= 1 << slot;
            if link & LEAF == 0 {
                tight.inner |= 1 << slot;
                tight.first_node = tight.first_node.min(link);
            } else {
                tight.first_leaf = tight.first_leaf.min(link & !LEAF);
            }
            for axis in 0..3 {
                let (low, high) = tight.steps(axis, bounds.low[axis], bounds.high[axis]);
                (tight.planes[axis][slot], tight.planes[axis + 3][slot]) = (low, high);
            }
        }
        tight
    }

    /// The steps around an interval.
    fn steps(&self, axis: usize, low: f32, high: f32) -> (u8, u8) {
        let scaled = |value: f32| (value - self.low[axis]) / self.step[axis].max(f32::MIN_POSITIVE);
        let (mut first, mut last) = (scaled(low).floor() as u8, scaled(high).ceil() as u8);
        while first > 0 && self.plane(axis, first) > low {
            first -= 1;
        }
        while last < 255 && self.plane(axis, last) < high {
            last += 1;
        }
        (first, last)
    }

    /// Where a step lies.
    #[inline(always)]
    pub fn plane(&self, axis: usize, step: u8) -> f32 {
        self.low[axis] + f32::from(step) * self.step[axis]
    }

    /// Boxes and links of the children that are there.
    fn children(&self) -> impl Iterator<Item = (Bounds, u32)> + '_ {
        let corner = |slot: usize, from: usize| {
            let at = |axis: usize| self.plane(axis, self.planes[from + axis][slot]);
            Vec3A::new(at(0), at(1), at(2))
        };
        (0..8).filter(|slot| self.used >> slot & 1 == 1).map(move |slot| {
            (Bounds { low: corner(slot, 0), high: corner(slot, 3) }, self.link(slot))
        })
    }
}

/// Nodes of a level's tree.
pub(crate) enum Nodes {
    Wide(Vec<Node>),
    Tight(Vec<TightNode>),
}

impl Nodes {
    /// Nodes in the form that suits a tree over so many placements.
    pub fn over(nodes: Vec<Node>, placements: usize) -> Self {
        /// From this many placements on, nodes take hundreds of megabytes. They save 17 of 71 bytes a
        /// placement; at a million, rays took 1.14 times as long (`benches/peers/ray_sets.rs`).
        const MANY: usize = 4_000_000;
        if placements < MANY {
            return Self::Wide(nodes);
        }
        Self::Tight(nodes.iter().map(TightNode::new).collect())
    }

    /// Whether there is no tree.
    pub fn is_empty(&self) -> bool {
        match self {
            Self::Wide(nodes) => nodes.is_empty(),
            Self::Tight(nodes) => nodes.is_empty(),
        }
    }

    /// Boxes and links of a node's children; none where there is no such node.
    pub fn children(&self, index: u32) -> Vec<(Bounds, u32)> {
        let index = index as usize;
        match self {
            Self::Wide(nodes) => nodes.get(index).into_iter().flat_map(Node::children).collect(),
            Self::Tight(nodes) => {
                nodes.get(index).into_iter().flat_map(TightNode::children).collect()
            }
        }
    }

    /// Memory, bytes.
    pub fn bytes(&self) -> usize {
        match self {
            Self::Wide(nodes) => size_of_val(&nodes[..]),
            Self::Tight(nodes) => size_of_val(&nodes[..]),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::lanes::Portable;
    use super::*;
    use glam::Vec3;
    use weald_contract::Seed;

    #[test]
    fn tight_boxes_hold_the_boxes_that_they_stand_for() {
        let mut chance = Seed(4).stream("tight", 0);
        for round in 0..300 {
            let reach = [1.0, 1e-3, 1e5][round % 3];
            let mut node = Node::EMPTY;
            let count = 1 + round % 8;
            for slot in 0..count {
                let mut at = || Vec3A::from_array([0; 3].map(|_| chance.around(0.0, reach) as f32));
                let (a, b) = (at() + 7.0, at() + 7.0);
                let link = if slot % 3 == 0 {
                    40 + slot as u32 / 3
                } else {
                    LEAF | (90 + (slot - slot / 3 - 1) as u32)
                };
                node.set(slot, &Bounds { low: a.min(b), high: a.max(b) }, link);
            }
            let tight = TightNode::new(&node);
            assert_eq!(tight.children().count(), count);
            for ((wide, link), (outer, same)) in node.children().zip(tight.children()) {
                assert_eq!((outer.union(wide), link), (outer, same), "round {round}");
            }
            // Whatever the ray meets of the node, it meets of its tight form.
            let origin = Vec3::from_array([0; 3].map(|_| chance.around(7.0, 2.0 * reach) as f32));
            let way = Vec3::from_array([0; 3].map(|_| chance.normal() as f32));
            let ray = LocalRay::new(origin, way);
            // SAFETY: plain loops need no feature.
            let (wide, tight) = unsafe {
                (
                    node.boxes::<Portable>(&ray, f32::INFINITY),
                    tight.boxes::<Portable>(&ray, f32::INFINITY),
                )
            };
            assert_eq!(wide.mask & !tight.mask, 0);
        }
    }
}
