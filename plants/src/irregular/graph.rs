//! Which nodes are joined: the Yao graph, or all within a distance.
//!
//! The space around a node is cut into sectors, and the node is joined to the nearest other in
//! each [Yao77]. A node chooses as many others as there are sectors, and may be chosen by more. With
//! the six faces of a cube seen from its middle as sectors a node has about eight neighbours;
//! with the eight octants [Germer07] more than ten.
//!
//! All sectors are searched together in the cells around the node's own. Where a node further out
//! could still be nearer, or none was found, the search of a sector goes on outwards in layers of
//! the cells that it can reach.

use super::Links;
use super::cells::{Cells, Sorted};
use super::nodes::Nodes;
use super::space::Space;
use crate::volume::Bounds;
use glam::{IVec3, Vec3};
use std::ops::Range;

/// No node.
pub const NOTHING: u32 = u32::MAX;

/// Layers of cells beyond which nobody is looked for. Within a volume the nearest node of a
/// sector lies in the first three; further ones are found only along trunks so thin that nodes
/// stand in them one above the other.
const MOST_LAYERS: i32 = 8;

/// Layers searched around nodes that have found neighbours enough: on the surface of a volume
/// outer sectors are empty however far one looks.
const FEW_LAYERS: i32 = 2;

/// Neighbours that are enough.
const ENOUGH: usize = 3;

/// Side of a cell over that of the cube that a node has for itself: found by trial from 0.9 to 1.6.
const CELL: f32 = 1.2;

/// Edges longer than this many sides of the cube that a node has for itself must have their
/// middle in the volume: others would cut corners through the air.
const LONG: f32 = 2.0;

/// Nodes and who is joined to whom.
#[derive(Clone, Debug, Default)]
pub struct Graph {
    /// The nodes, in the order of their cells.
    pub nodes: Nodes,
    sorted: Sorted,
    /// Sectors, for each of which every node has a slot in `chosen`.
    sectors: usize,
    /// The nearest node in each sector; [`NOTHING`] where there is none.
    chosen: Vec<u32>,
    /// Where the list of each node in `others` begins.
    starts: Vec<u32>,
    /// Those that chose a node without being chosen by it; of a threshold graph, all neighbours.
    others: Vec<u32>,
    /// Where each node went when they were sorted.
    moved: Vec<u32>,
}

/// How space around a node is cut.
trait Sectors {
    const COUNT: usize;

    /// The first layer that is not wholly in the block of 27 cells.
    const FIRST_LAYER: i32;

    /// The sector that a direction lies in.
    fn of(d: Vec3) -> usize;

    /// The boxes of cells, as lowest and highest offsets, that make up a layer of a sector.
    fn layer(sector: usize, layer: i32) -> [Option<(IVec3, IVec3)>; 3];

    /// How far a node of a sector must be, at least, that lies beyond a layer. `low` and `high`
    /// are the distances from the place to the walls of its own cell.
    fn beyond(sector: usize, layer: i32, low: Vec3, high: Vec3, side: f32) -> f32;

    /// The same of what lies outside of the block of 27 cells around the place.
    fn beyond_block(sector: usize, low: Vec3, high: Vec3, side: f32) -> f32;
}

/// The faces of a cube: -x, +x, -y, +y, -z, +z.
struct Faces;

impl Sectors for Faces {
    const COUNT: usize = 6;
    const FIRST_LAYER: i32 = 1;

    #[inline]
    fn of(d: Vec3) -> usize {
        let a = d.abs();
        let axis = if a.x >= a.y && a.x >= a.z { 0 } else { 1 + usize::from(a.z > a.y) };
        2 * axis + usize::from(d[axis] > 0.0)
    }

    fn layer(sector: usize, layer: i32) -> [Option<(IVec3, IVec3)>; 3] {
        // Within the layer the sector is as wide as it is far, and a cell more.
        let (mut low, mut high) = (IVec3::splat(-layer - 1), IVec3::splat(layer + 1));
        let along = if sector % 2 == 1 { layer } else { -layer };
        (low[sector / 2], high[sector / 2]) = (along, along);
        [Some((low, high)), None, None]
    }

    #[inline]
    fn beyond(sector: usize, layer: i32, low: Vec3, high: Vec3, side: f32) -> f32 {
        let wall = if sector % 2 == 1 { high } else { low };
        wall[sector / 2] + layer as f32 * side
    }

    #[inline]
    fn beyond_block(sector: usize, low: Vec3, high: Vec3, side: f32) -> f32 {
        // Out of the far wall, or out of a side wall: as far along as across, at least.
        let axis = sector / 2;
        let ahead = if sector % 2 == 1 { high[axis] } else { low[axis] };
        let nearest = low.min(high);
        let across = nearest[(axis + 1) % 3].min(nearest[(axis + 2) % 3]);
        (ahead + side).min(std::f32::consts::SQRT_2 * (across + side))
    }
}

/// The octants: bit 0 for +x, bit 1 for +y, bit 2 for +z.
struct Octants;

impl Sectors for Octants {
    const COUNT: usize = 8;
    const FIRST_LAYER: i32 = 2;

    #[inline]
    fn of(d: Vec3) -> usize {
        usize::from(d.x > 0.0) | usize::from(d.y > 0.0) << 1 | usize::from(d.z > 0.0) << 2
    }

    fn layer(sector: usize, layer: i32) -> [Option<(IVec3, IVec3)>; 3] {
        // The three outer sides of the cube of cells, without counting an edge twice.
        let boxes = [
            (IVec3::new(layer, 0, 0), IVec3::new(layer, layer, layer)),
            (IVec3::new(0, layer, 0), IVec3::new(layer - 1, layer, layer)),
            (IVec3::new(0, 0, layer), IVec3::new(layer - 1, layer - 1, layer)),
        ];
        let sign = IVec3::from_array([0, 1, 2].map(|axis| (sector >> axis & 1) as i32 * 2 - 1));
        boxes.map(|(a, b)| {
            let is_some = a.cmple(b).all();
            is_some.then(|| ((a * sign).min(b * sign), (a * sign).max(b * sign)))
        })
    }

    #[inline]
    fn beyond(sector: usize, layer: i32, low: Vec3, high: Vec3, side: f32) -> f32 {
        let wall = |axis: usize| if sector >> axis & 1 == 1 { high[axis] } else { low[axis] };
        wall(0).min(wall(1)).min(wall(2)) + layer as f32 * side
    }

    #[inline]
    fn beyond_block(sector: usize, low: Vec3, high: Vec3, side: f32) -> f32 {
        Self::beyond(sector, 1, low, high, side)
    }
}

/// The nearest node of each sector: square of the distance, and number.
type Nearest = [(f32, u32); 8];

impl Graph {
    /// Joins the nodes, first sorting them by place; returns how many edges there are.
    ///
    /// `pitch` is the side of the cube that a node has for itself, `reach` how far a threshold
    /// graph joins, both in the units of the nodes.
    pub fn join(&mut self, links: Links, pitch: f32, reach: f32, space: &Space<'_>) -> u64 {
        self.sort(if links == Links::Threshold { reach } else { CELL * pitch });
        match links {
            Links::Yao => self.choose::<Faces>(pitch, space),
            Links::Octants => self.choose::<Octants>(pitch, space),
            Links::Threshold => {
                self.sectors = 0;
                self.chosen.clear();
                self.link_within(reach);
            }
        }
        let chosen = self.chosen.iter().filter(|node| **node != NOTHING).count();
        (chosen + self.others.len()) as u64 / 2
    }

    /// Where a node that was given went.
    pub fn index_of(&self, given: usize) -> u32 {
        self.moved[given]
    }

    fn sort(&mut self, side: f32) {
        let places = &mut self.nodes.places;
        let bounds = places.iter().fold(Bounds::NONE, |sum, p| sum.with_point(*p));
        let cells = Cells::over(bounds, side, 4 * places.len() + 64);
        self.sorted.sort(cells, places, &mut self.moved);
        if !self.nodes.parts.is_empty() {
            let mut parts = vec![0; self.moved.len()];
            for (part, to) in self.nodes.parts.iter().zip(&self.moved) {
                parts[*to as usize] = *part;
            }
            self.nodes.parts = parts;
        }
    }

    fn choose<S: Sectors>(&mut self, pitch: f32, space: &Space<'_>) {
        self.sectors = S::COUNT;
        let mut chosen = std::mem::take(&mut self.chosen);
        chosen.clear();
        chosen.reserve_exact(S::COUNT * self.nodes.places.len());
        let long = (LONG * pitch).powi(2);
        for node in 0..self.nodes.places.len() {
            let nearest = self.nearest::<S>(node);
            let is_outside = |other: u32| {
                let (a, b) = (self.nodes.places[node], self.nodes.places[other as usize]);
                !space.contains(0.5 * (a + b))
            };
            chosen.extend(nearest[..S::COUNT].iter().map(|(square, other)| {
                if *square > long && *other != NOTHING && is_outside(*other) {
                    NOTHING
                } else {
                    *other
                }
            }));
        }
        self.chosen = chosen;
        self.gather_others();
    }

    /// The nearest node in each sector around a node.
    fn nearest<S: Sectors>(&self, node: usize) -> Nearest {
        let cells = &self.sorted.cells;
        let place = self.nodes.places[node];
        let cell = cells.of(place);
        let mut nearest = [(f32::INFINITY, NOTHING); 8];
        self.look::<S>(node, cell, (IVec3::NEG_ONE, IVec3::ONE), &mut nearest);
        let low = (place - cells.corner(cell)).max(Vec3::ZERO);
        let high = (Vec3::splat(cells.side) - low).max(Vec3::ZERO);
        let is_open =
            |nearest: &Nearest, sector: usize, beyond: f32| nearest[sector].0 > beyond * beyond;
        let is_found = |nearest: &Nearest| nearest.iter().filter(|n| n.1 != NOTHING).count();
        let go_on = |nearest: &mut Nearest, sector: usize, layers: Range<i32>| {
            for layer in layers {
                for (from, to) in S::layer(sector, layer).into_iter().flatten() {
                    self.look::<S>(node, cell, (from, to), nearest);
                }
                if !is_open(nearest, sector, S::beyond(sector, layer, low, high, cells.side)) {
                    break;
                }
            }
        };
        for sector in 0..S::COUNT {
            if is_open(&nearest, sector, S::beyond_block(sector, low, high, cells.side)) {
                go_on(&mut nearest, sector, S::FIRST_LAYER..FEW_LAYERS + 1);
            }
        }
        if is_found(&nearest) < ENOUGH {
            for sector in 0..S::COUNT {
                if nearest[sector].1 == NOTHING {
                    go_on(&mut nearest, sector, FEW_LAYERS + 1..MOST_LAYERS + 1);
                }
            }
        }
        nearest
    }

    /// Looks through the cells at a range of offsets from a node's.
    #[inline]
    fn look<S: Sectors>(
        &self,
        node: usize,
        cell: IVec3,
        (from, to): (IVec3, IVec3),
        nearest: &mut Nearest,
    ) {
        let place = self.nodes.places[node];
        let low = (cell + from).max(IVec3::ZERO);
        let high = (cell + to).min(self.sorted.cells.size - 1);
        if low.cmpgt(high).any() {
            return;
        }
        for x in low.x..=high.x {
            for y in low.y..=high.y {
                for other in self.sorted.row(x, y, low.z..high.z + 1) {
                    let d = self.nodes.places[other] - place;
                    let square = d.length_squared();
                    let best = &mut nearest[S::of(d)];
                    if square < best.0 && other != node && self.nodes.may_join(node, other) {
                        *best = (square, other as u32);
                    }
                }
            }
        }
    }

    /// Lists for every node those that chose it and that it did not choose.
    fn gather_others(&mut self) {
        let Self { chosen, starts, others, sectors, .. } = self;
        let slots = *sectors;
        let one_sided = |node: usize, slot: usize| {
            let other = chosen[node * slots + slot];
            let is_one_sided = other != NOTHING && {
                let back = other as usize * slots;
                !chosen[back..back + slots].contains(&(node as u32))
            };
            is_one_sided.then_some(other as usize)
        };
        list(chosen.len() / slots, starts, others, |add| {
            for node in 0..chosen.len() / slots {
                for other in (0..slots).filter_map(|slot| one_sided(node, slot)) {
                    add(other, node as u32);
                }
            }
        });
    }

    fn link_within(&mut self, reach: f32) {
        let Self { nodes, sorted, starts, others, .. } = self;
        let around = (reach / sorted.cells.side).ceil() as i32;
        list(nodes.places.len(), starts, others, |add| {
            for (node, place) in nodes.places.iter().enumerate() {
                let cell = sorted.cells.of(*place);
                for x in cell.x - around..=cell.x + around {
                    for y in cell.y - around..=cell.y + around {
                        for other in sorted.row(x, y, cell.z - around..cell.z + around + 1) {
                            let square = nodes.places[other].distance_squared(*place);
                            if square < reach * reach
                                && other != node
                                && nodes.may_join(node, other)
                            {
                                add(node, other as u32);
                            }
                        }
                    }
                }
            }
        });
    }

    /// The nodes that a node is joined to.
    #[inline]
    pub fn neighbors(&self, node: u32) -> impl Iterator<Item = u32> {
        let node = node as usize;
        let chosen = &self.chosen[node * self.sectors..(node + 1) * self.sectors];
        let others = &self.others[self.starts[node] as usize..self.starts[node + 1] as usize];
        chosen.iter().chain(others).copied().filter(|other| *other != NOTHING)
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        let numbers = [&self.chosen, &self.starts, &self.others, &self.moved];
        let numbers = numbers.iter().map(|list| 4 * list.capacity()).sum::<usize>();
        self.nodes.bytes() + self.sorted.bytes() + numbers
    }
}

/// Fills lists of numbers, one after another, from what `each` adds: it is run twice, once to
/// count.
fn list(
    count: usize,
    starts: &mut Vec<u32>,
    entries: &mut Vec<u32>,
    each: impl Fn(&mut dyn FnMut(usize, u32)),
) {
    starts.clear();
    starts.resize(count + 1, 0);
    each(&mut |at, _| starts[at + 1] += 1);
    for index in 1..=count {
        starts[index] += starts[index - 1];
    }
    entries.clear();
    entries.reserve_exact(starts[count] as usize);
    entries.resize(starts[count] as usize, 0);
    each(&mut |at, entry| {
        entries[starts[at] as usize] = entry;
        starts[at] += 1;
    });
    starts.rotate_right(1);
    starts[0] = 0;
}
