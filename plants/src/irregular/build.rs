//! From paths to a skeleton: thickness by the length of the way to the tips, and axes that go on
//! in the thickest child.

use super::graph::NOTHING;
use super::tree::Tree;
use super::{Irregular, Stage, stages};
use crate::foliage::Twig;
use crate::frame::any_normal;
use crate::material::opaque;
use crate::skeleton::{Axis, AxisKind, Node, Skeleton, axis_id};
use glam::Vec3;

/// A skeleton whose stem has radius 1 at its base, and where its leaves belong.
pub(super) struct Built {
    pub(super) skeleton: Skeleton,
    pub(super) twigs: Vec<Twig>,
}

/// Makes the skeleton of a tree and its roots.
pub(super) fn skeleton(form: &Irregular, tree: &Tree, roots: Option<&Tree>, vigor: f32) -> Built {
    let mut skeleton = Skeleton::default();
    for (order, color) in form.bark.iter().enumerate() {
        // Bark of a weak tree is a little paler.
        let color = color.map(|c| (c * (1.1 - 0.1 * vigor)).min(0.9));
        skeleton.add_material(opaque(&format!("bark-{order}"), color));
    }
    let exponents = exponents(form.thickness, &form.stages());
    let wood = Wood::of(tree, &exponents, form.thickness_unit);
    let mut built = Built { skeleton, twigs: Vec::new() };
    built.add(tree, &wood, form, 1.0, true);
    if let (Some(below), Some(roots)) = (roots, &form.roots) {
        let levels = stages(&roots.level, 1.0, 1.0);
        let exponents = self::exponents(roots.thickness, &levels);
        let wood = Wood::of(below, &exponents, form.thickness_unit);
        built.add(below, &wood, form, roots.girth, false);
    }
    built
}

/// Exponents of thickness by level.
fn exponents(first: f32, stages: &[Stage<'_>]) -> Vec<f32> {
    std::iter::once(first).chain(stages.iter().map(|stage| stage.level.thickness)).collect()
}

/// Thickness of a tree's nodes.
pub(super) struct Wood {
    /// Thickness of each node: `w = s^zeta`, the most of what the levels propose.
    pub(super) width: Vec<f32>,
    /// Thickness of the edge to each node at its lower end.
    pub(super) foot: Vec<f32>,
    /// Longest way from each node to an endpoint above it.
    pub(super) longest: Vec<f32>,
}

impl Wood {
    /// Measures a tree. Exponents are by level; ways are counted in `unit`s.
    pub(super) fn of(tree: &Tree, exponents: &[f32], unit: f32) -> Self {
        let count = tree.places.len();
        let zeros = || vec![0.0_f32; count];
        let mut wood = Self { width: zeros(), foot: zeros(), longest: zeros() };
        let edge =
            |node: usize| tree.places[node].distance(tree.places[tree.parents[node] as usize]);
        let mut distinct = exponents.to_vec();
        distinct.sort_by(f32::total_cmp);
        distinct.dedup();
        // Levels of one exponent propose together what the longest way among them does.
        for exponent in distinct {
            let mut way = vec![-1.0_f32; count];
            for end in &tree.endpoints {
                if exponents[end.level as usize - 1] == exponent {
                    way[end.node as usize] = way[end.node as usize].max(0.0);
                }
            }
            let thickness = |way: f32| libm::powf(way / unit, exponent);
            for node in (0..count).rev().filter(|node| *node > 0) {
                if way[node] < 0.0 {
                    continue;
                }
                let below = way[node] + edge(node);
                wood.foot[node] = wood.foot[node].max(thickness(below));
                let parent = tree.parents[node] as usize;
                way[parent] = way[parent].max(below);
                if way[node] > 0.0 {
                    wood.width[node] = wood.width[node].max(thickness(way[node]));
                    wood.longest[node] = wood.longest[node].max(way[node]);
                }
            }
            wood.longest[0] = wood.longest[0].max(way[0]);
            wood.width[0] = wood.width[0].max(if way[0] > 0.0 { thickness(way[0]) } else { 0.0 });
        }
        wood
    }
}

/// Where a node of the tree stands in the skeleton.
#[derive(Clone, Copy, Default)]
struct Seat {
    axis: u32,
    along: f32,
}

impl Built {
    /// Adds the axes of a tree whose base is to have a radius.
    fn add(&mut self, tree: &Tree, wood: &Wood, form: &Irregular, base: f32, is_leafy: bool) {
        let thickest = thickest(tree, wood);
        let origin = tree.places[0];
        let scale = base / wood.width[0].max(f32::MIN_POSITIVE);
        // Exponents of 0 would leave a radius at the tip, which is a point.
        let radius = |width: f32| (scale * width).max(1e-6);
        let leafy = form.leafy * wood.longest[0];
        let mut seats = vec![Seat::default(); tree.places.len()];
        let mut lengths: Vec<f32> = Vec::new();
        let first_axis = self.skeleton.axes.len() as u32;
        let mut patch = 0;
        let mut chain = Vec::new();
        for start in 1..tree.places.len() {
            while tree.patches.get(patch + 1).is_some_and(|next| next.first as usize <= start) {
                patch += 1;
            }
            let parent = tree.parents[start] as usize;
            if thickest[parent] as usize == start && parent != 0 {
                continue;
            }
            chain.clear();
            chain.push(start);
            while let Some(next) = Some(thickest[chain[chain.len() - 1]]).filter(|n| *n != NOTHING)
            {
                chain.push(next as usize);
            }
            let of = tree.patches[patch];
            let id = axis_id(of.seed.0, "axis", start as u32 - of.first);
            let heading = (tree.places[start] - tree.places[parent]).normalize_or(Vec3::Z);
            let axis = Axis::new(id, AxisKind::Stem, 0).facing(any_normal(heading));
            let axis = if parent == 0 {
                axis
            } else {
                let seat = seats[parent];
                let whole = lengths.get((seat.axis - first_axis) as usize).copied();
                let at = seat.along / whole.unwrap_or(1.0).max(f32::MIN_POSITIVE);
                let order = self.skeleton.axes[seat.axis as usize].order.saturating_add(1);
                axis.on(seat.axis, at.min(1.0), order)
            };
            let material = u32::from(axis.order).min(form.bark.len() as u32 - 1);
            let place = |node: usize| tree.places[node] - origin;
            let foot = Node { position: place(parent), radius: radius(wood.foot[start]) };
            let mut nodes = vec![foot];
            let (mut along, index) = (0.0, self.skeleton.axes.len() as u32);
            let mut below = parent;
            for &node in &chain {
                along += tree.places[node].distance(tree.places[below]);
                seats[node] = Seat { axis: index, along };
                nodes.push(Node { position: place(node), radius: radius(wood.width[node]) });
                if is_leafy && wood.longest[node] <= leafy {
                    let id = axis_id(id, "leaves", (nodes.len() - 2) as u32);
                    let (from, to) = (place(below), place(node));
                    self.twigs.push(Twig { axis: index, id, from, to });
                }
                below = node;
            }
            lengths.push(along);
            self.skeleton.push(Axis { material, ..axis }, nodes);
        }
    }
}

/// The thickest child of each node: the one that its axis goes on in.
fn thickest(tree: &Tree, wood: &Wood) -> Vec<u32> {
    let mut thickest = vec![NOTHING; tree.places.len()];
    for node in 1..tree.places.len() {
        let best = &mut thickest[tree.parents[node] as usize];
        if *best == NOTHING || wood.foot[node] > wood.foot[*best as usize] {
            *best = node as u32;
        }
    }
    thickest
}
