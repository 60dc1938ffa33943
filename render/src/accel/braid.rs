//! Opening placements that crowd each other, before a tree is built over them.
//!
//! A ray that enters the boxes of five crowns walks five trees from their roots. When the children
//! of a crown go into the tree in its stead, they sort by where they are, and most are never
//! entered [Benthin17]. Yet each part that is entered costs a transform, so opening pays only
//! where boxes overlap: with crowns of 6 m every 5 m rays became 1.09 times slower by it on the
//! geometric mean of eight kinds, every 3.5 m 1.08 times faster, every 2.5 m 1.25 times
//! (`benches/peers/ray_sets.rs`).

use super::level::{Instance, Level, Part};
use super::{Bounds, lanes::LEAF};
use rayon::prelude::*;

/// Memory for opened parts, bytes: a small part of what a scene takes anyway.
const BUDGET: usize = 16 << 20;

/// Memory that a part takes: itself and its share of the nodes.
const PART_BYTES: usize = 40;

/// Boxes over a point of the plan from which on opening pays.
const CROWDED: f32 = 4.5;

/// Most cells along a side of the plan on which crowding is counted.
const CELLS: f32 = 1024.0;

/// The parts in which placements go into a tree, and their boxes: all of a placement, or its
/// children where it is crowded, the most crowded first, as far as the budget lasts.
pub(crate) fn opened(placed: &[(Instance, u64)], levels: &[Level]) -> (Vec<Part>, Vec<Bounds>) {
    let outlines: Vec<Vec<Bounds>> = levels.par_iter().map(|level| level.outline(0)).collect();
    let mut boxes: Vec<Bounds> = placed
        .par_iter()
        .map(|(instance, _)| instance.place(&outlines[instance.level as usize]))
        .collect();
    let mut parts: Vec<Part> =
        (0..placed.len() as u32).map(|instance| Part { instance, root: 0 }).collect();
    let most = placed.len() + BUDGET / PART_BYTES;
    for index in crowded(&boxes) {
        if parts.len() + 7 > most {
            break;
        }
        let instance = &placed[index].0;
        let level = &levels[instance.level as usize];
        for (slot, (bounds, link)) in level.nodes.children(0).into_iter().enumerate() {
            let inner = if link & LEAF != 0 { vec![bounds] } else { level.outline(link) };
            let part = Part { instance: index as u32, root: link };
            let bounds = instance.place(&inner);
            if slot == 0 {
                (parts[index], boxes[index]) = (part, bounds);
            } else {
                parts.push(part);
                boxes.push(bounds);
            }
        }
    }
    (parts, boxes)
}

/// Indices of the boxes that stand where many do, the most crowded first.
fn crowded(boxes: &[Bounds]) -> Vec<usize> {
    let footprint = |b: &Bounds| (b.high.x - b.low.x) * (b.high.y - b.low.y);
    let mut sizes: Vec<f32> = boxes.iter().map(footprint).collect();
    if sizes.len() < 8 {
        return Vec::new();
    }
    let middle = sizes.len() / 2;
    let typical = *sizes.select_nth_unstable_by(middle, f32::total_cmp).1;
    let centers = Bounds::of(boxes.iter().map(Bounds::center));
    let extent = centers.high - centers.low;
    // Sixteen typical boxes fit into a cell: fewer would count by chance.
    let cell = (4.0 * typical.sqrt()).max(extent.x.max(extent.y) / CELLS);
    if !(cell > 0.0 && cell.is_finite()) {
        return Vec::new();
    }
    let columns = (extent.x / cell) as usize + 1;
    let rows = (extent.y / cell) as usize + 1;
    let place = |b: &Bounds| {
        let at = (b.center() - centers.low) / cell;
        (at.y as usize).min(rows - 1) * columns + (at.x as usize).min(columns - 1)
    };
    let mut cover = vec![0.0f32; columns * rows];
    // What spans many cells, such as the ground, covers all of them once at most.
    for bounds in boxes.iter().filter(|b| footprint(b) < 16.0 * cell * cell) {
        cover[place(bounds)] += footprint(bounds) / (cell * cell);
    }
    let mut found: Vec<(f32, usize)> = boxes
        .iter()
        .enumerate()
        .map(|(index, bounds)| (cover[place(bounds)], index))
        .filter(|&(cover, _)| cover >= CROWDED)
        .collect();
    found.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    found.into_iter().map(|(_, index)| index).collect()
}
