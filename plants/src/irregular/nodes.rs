//! Nodes scattered by throwing darts, none nearer to another than a given distance.

use super::cells::Cells;
use super::space::{COMMON, Space};
use crate::volume::Bounds;
use glam::{IVec3, Vec3};
use weald_contract::Stream;

/// Least distance of two nodes over the side of the cube that each has for itself: darts fill at
/// most 0.733 of their number for a distance of 1 (random sequential packing of balls takes 0.384
/// of the volume), so that 0.7 uses not quite half of what is possible.
pub const CLOSENESS: f32 = 0.7;

/// Throws that miss, for each node wanted, after which the volume counts as full.
const MOST_MISSES: u64 = 30;

const NOTHING: u32 = u32::MAX;

/// Nodes of a graph before they are joined.
#[derive(Clone, Debug, Default)]
pub struct Nodes {
    /// Places.
    pub places: Vec<Vec3>,
    /// Part of each; empty where there is only one.
    pub parts: Vec<u8>,
    /// First node of each cell, and the node after each.
    heads: Vec<u32>,
    next: Vec<u32>,
}

/// How nodes are scattered.
pub struct Scatter {
    /// Nodes wanted, with those that are given.
    pub count: usize,
    /// Least distance of two of them.
    pub apart: f32,
}

impl Nodes {
    /// Scatters nodes in a space, after those that are given.
    ///
    /// Given nodes stand where they stand; there are fewer nodes than wanted where the space is
    /// full before. `is_free` tells where nodes may be.
    pub fn scatter(
        &mut self,
        space: &Space<'_>,
        how: &Scatter,
        given: &[Vec3],
        stream: &mut Stream,
        is_free: impl Fn(Vec3) -> bool,
    ) {
        let bounds = given.iter().fold(space.bounds(), |sum, p| sum.with_point(*p));
        let cells = Cells::over(bounds, how.apart, 8 * how.count + 64);
        self.clear(cells.len());
        let has_parts = space.has_parts();
        for p in given {
            self.add(&cells, *p);
            if has_parts {
                self.parts.push(space.part_of(*p));
            }
        }
        let most = MOST_MISSES * how.count as u64;
        let mut misses = 0;
        // Throws beside the volume are no sign that it is full; but one of no volume must end.
        let mut throws = 1000 * (how.count as u64 + 100);
        while self.places.len() < how.count && misses < most && throws > 0 {
            throws -= 1;
            let Some((p, part)) = space.sample(stream) else { continue };
            if !self.is_alone(&cells, p, how.apart) || !is_free(p) {
                misses += 1;
                continue;
            }
            misses = 0;
            self.add(&cells, p);
            if has_parts {
                self.parts.push(part);
            }
        }
    }

    /// Puts nodes on a cubic lattice, after those that are given.
    pub fn lattice(&mut self, space: &Space<'_>, pitch: f32, given: &[Vec3]) {
        self.clear(0);
        let Bounds { low, high } = space.bounds();
        let count = ((high - low) / pitch).floor().as_ivec3();
        // The lattice passes through the first given node: the root.
        let origin = given.first().copied().unwrap_or(low);
        let first = ((low - origin) / pitch).ceil().as_ivec3();
        let has_parts = space.has_parts();
        let mut add = |p: Vec3| {
            self.places.push(p);
            if has_parts {
                self.parts.push(space.part_of(p));
            }
        };
        given.iter().for_each(|p| add(*p));
        for x in 0..=count.x {
            for y in 0..=count.y {
                for z in 0..=count.z {
                    let p = origin + (first + IVec3::new(x, y, z)).as_vec3() * pitch;
                    let is_given = given.iter().any(|other| other.distance(p) < 0.1 * pitch);
                    if space.contains(p) && !is_given {
                        add(p);
                    }
                }
            }
        }
    }

    fn clear(&mut self, cells: usize) {
        self.places.clear();
        self.parts.clear();
        self.next.clear();
        self.heads.clear();
        self.heads.resize(cells, NOTHING);
    }

    fn add(&mut self, cells: &Cells, p: Vec3) {
        let head = &mut self.heads[cells.index(cells.of(p))];
        self.next.push(std::mem::replace(head, self.places.len() as u32));
        self.places.push(p);
    }

    /// Whether no node lies within a distance of at most a cell's side.
    fn is_alone(&self, cells: &Cells, p: Vec3, apart: f32) -> bool {
        let square = apart * apart;
        // Most that stand in the way stand in the same cell.
        let own = self.heads[cells.index(cells.of(p))];
        if own != NOTHING && self.places[own as usize].distance_squared(p) < square {
            return false;
        }
        let low = cells.of(p - apart);
        let high = cells.of(p + apart);
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for z in low.z..=high.z {
                    let mut node = self.heads[cells.index(IVec3::new(x, y, z))];
                    while node != NOTHING {
                        if self.places[node as usize].distance_squared(p) < square {
                            return false;
                        }
                        node = self.next[node as usize];
                    }
                }
            }
        }
        true
    }

    /// Gives back what only scattering needs.
    pub fn let_go(&mut self) {
        self.heads = Vec::new();
        self.next = Vec::new();
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        12 * self.places.capacity()
            + self.parts.capacity()
            + 4 * (self.heads.capacity() + self.next.capacity())
    }

    /// Whether two nodes may be joined: parts meet only in what is common to all.
    #[inline]
    pub fn may_join(&self, a: usize, b: usize) -> bool {
        if self.parts.is_empty() {
            return true;
        }
        let (a, b) = (self.parts[a], self.parts[b]);
        a == b || a == COMMON || b == COMMON
    }
}
