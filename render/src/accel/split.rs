//! Cutting the boxes of long triangles before a tree is built.
//!
//! The box of a twig's side that runs aslant is nearly empty, and rays through the leaves around it
//! would test it for nothing. Such a box is cut in half, and each half shrunk to the part of the
//! triangle inside, as often as pays; the triangle then hangs in several leaves [KA13] §5.

use super::Bounds;
use super::level::Triangle;
use glam::Vec3A;
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Pieces that may be added, as part of the triangles.
const EXTRA: f32 = 0.2;

/// Part of a box's surface that cutting must be able to save.
const WASTE: f32 = 0.3;

/// Boxes, and the triangle that each belongs to.
pub(crate) struct Pieces {
    pub boxes: Vec<Bounds>,
    pub owners: Vec<u32>,
}

/// A piece that may be cut, by how much that could save.
struct Candidate {
    gain: f32,
    piece: u32,
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other).is_eq()
    }
}

impl Eq for Candidate {}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl Ord for Candidate {
    fn cmp(&self, other: &Self) -> Ordering {
        self.gain.total_cmp(&other.gain).then(other.piece.cmp(&self.piece))
    }
}

/// Boxes of triangles, those cut that gain most by it.
pub(crate) fn split(triangles: &[Triangle]) -> Pieces {
    let boxes: Vec<Bounds> = triangles.par_iter().map(Triangle::bounds).collect();
    let owners = (0..triangles.len() as u32).collect();
    let mut pieces = Pieces { boxes, owners };
    let most = triangles.len() + (EXTRA * triangles.len() as f32) as usize;
    let weighed = |piece: usize| {
        let gain = waste(&triangles[piece], &pieces.boxes[piece]);
        (gain > 0.0).then_some(Candidate { gain, piece: piece as u32 })
    };
    let list: Vec<Candidate> = (0..triangles.len()).into_par_iter().filter_map(weighed).collect();
    let mut waiting = BinaryHeap::from(list);
    while pieces.boxes.len() < most
        && let Some(Candidate { piece, .. }) = waiting.pop()
    {
        let owner = pieces.owners[piece as usize];
        let triangle = &triangles[owner as usize];
        let [low, high] = halves(triangle, &pieces.boxes[piece as usize]);
        if low.is_empty() || high.is_empty() {
            continue;
        }
        let new = pieces.boxes.len() as u32;
        pieces.boxes[piece as usize] = low;
        pieces.boxes.push(high);
        pieces.owners.push(owner);
        for (piece, bounds) in [(piece, low), (new, high)] {
            let gain = waste(triangle, &bounds);
            if gain > 0.0 {
                waiting.push(Candidate { gain, piece });
            }
        }
    }
    pieces
}

/// Surface of a box that its part of a triangle does not need, 0 when little could be saved.
fn waste(triangle: &Triangle, bounds: &Bounds) -> f32 {
    let [a, b, c] = triangle.corners;
    let (normal, size) = ((b - a).cross(c - a).abs(), bounds.high - bounds.low);
    if !normal.is_finite() || !size.is_finite() {
        return 0.0;
    }
    // Half the surface of many small boxes around a plane's part in a box is the sum of its three
    // projections; no projection is larger than the triangle's own or the box's side.
    let scale = if triangle.is_half { 1.0 } else { 0.5 };
    let needed = (scale * normal.x).min(size.y * size.z)
        + (scale * normal.y).min(size.z * size.x)
        + (scale * normal.z).min(size.x * size.y);
    let area = bounds.half_area();
    if area - needed > WASTE * area { area - needed } else { 0.0 }
}

/// The two parts of a piece, cut across the longest side of its box.
fn halves(triangle: &Triangle, bounds: &Bounds) -> [Bounds; 2] {
    let size = bounds.high - bounds.low;
    let axis = (0..3).fold(0, |best, axis| if size[axis] > size[best] { axis } else { best });
    let cut = bounds.center()[axis];
    let (mut left, mut right) = (*bounds, *bounds);
    left.high[axis] = cut;
    right.low[axis] = cut;
    [left, right].map(|part| clipped(triangle, &part))
}

/// The box of a triangle's part inside a box.
fn clipped(triangle: &Triangle, inside: &Bounds) -> Bounds {
    let [a, b, c] = triangle.corners.map(Vec3A::from);
    let mut polygon = vec![a, b];
    if triangle.is_half {
        polygon.push(b + c - a);
    }
    polygon.push(c);
    for axis in 0..3 {
        for (plane, sign) in [(inside.low[axis], 1.0), (inside.high[axis], -1.0)] {
            let height = |point: Vec3A| sign * (point[axis] - plane);
            let mut kept = Vec::with_capacity(polygon.len() + 1);
            for (index, &point) in polygon.iter().enumerate() {
                let before = polygon[(index + polygon.len() - 1) % polygon.len()];
                let (h0, h1) = (height(before), height(point));
                if (h0 < 0.0) != (h1 < 0.0) {
                    kept.push(before + (h0 / (h0 - h1)) * (point - before));
                }
                if h1 >= 0.0 {
                    kept.push(point);
                }
            }
            polygon = kept;
        }
    }
    let around = Bounds::of(polygon);
    // Rounding of the cuts must not open a gap between the parts.
    let slack = 4.0 * f32::EPSILON * inside.low.abs().max(inside.high.abs());
    Bounds {
        low: (around.low - slack).max(inside.low),
        high: (around.high + slack).min(inside.high),
    }
}
