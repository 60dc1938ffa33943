//! From metamers to a skeleton: each botanical axis becomes one axis with a node a metamer.

use super::garden::{Garden, Member};
use super::plant::{Bears, Plant};
use crate::foliage::Twig;
use crate::material::opaque;
use crate::skeleton::{Axis, AxisKind, Node, Skeleton, axis_id};
use glam::Vec3;

/// Cycles whose shoots bear leaves.
const LEAFY_CYCLES: u32 = 2;

impl Garden<'_> {
    /// The skeleton of a tree, without leaves, its foot at the origin, in internodes.
    ///
    /// Radii are those of a pipe of radius 1 for each leaf: scale them to the stem at hand.
    pub fn skeleton(&self, index: usize, vigor: f32) -> Skeleton {
        let Member { form, plant, .. } = &self.members[index];
        let mut skeleton = Skeleton::default();
        for (order, color) in form.bark.iter().enumerate() {
            // Bark of a weak tree is a little paler.
            let color = color.map(|c| (c * (1.1 - 0.1 * vigor)).min(0.9));
            skeleton.add_material(opaque(&format!("bark-{order}"), color));
        }
        let tips = self.tips(plant);
        let exponent = 1.0 / form.pipe_exponent;
        let radius = |metamer: usize| libm::powf(plant.pipe[metamer], exponent);
        // Where a metamer ends along its axis, and which axis that is.
        let mut along = vec![(0, 0.0_f32); tips.len()];
        let mut lengths = Vec::new();
        for (number, (base, metamers)) in axes(plant).into_iter().enumerate() {
            let first = &plant.metamers[base];
            let axis = Axis::new(first.axis, AxisKind::Stem, 0).facing(first.normal);
            let (axis, start) = match first.parent {
                Plant::NOTHING => (axis, Vec3::ZERO),
                parent => {
                    let (parent_axis, end) = along[parent as usize];
                    let whole: f32 = lengths[parent_axis as usize];
                    let at = (end / whole.max(f32::MIN_POSITIVE)).min(1.0);
                    (axis.on(parent_axis, at, first.order), tips[parent as usize])
                }
            };
            let (mut length, mut from) = (0.0, start);
            for &metamer in &metamers {
                let tip = tips[metamer as usize];
                length += from.distance(tip);
                along[metamer as usize] = (number as u32, length);
                from = tip;
            }
            lengths.push(length);
            let node = |metamer: &u32| Node {
                position: tips[*metamer as usize],
                radius: radius(*metamer as usize),
            };
            let foot = Node { position: start, radius: radius(base) };
            let material = u32::from(first.order).min(form.bark.len() as u32 - 1);
            let nodes = std::iter::once(foot).chain(metamers.iter().map(node));
            skeleton.push(Axis { material, ..axis }, nodes);
        }
        skeleton
    }

    /// Tips of all metamers with the last cycle's shoots grown to their fraction.
    fn tips(&self, plant: &Plant) -> Vec<Vec3> {
        let mut tips: Vec<Vec3> = Vec::with_capacity(plant.metamers.len());
        for (index, metamer) in plant.metamers.iter().enumerate() {
            let is_newest = u32::from(metamer.born) == self.cycle && metamer.born > 0;
            let part = if is_newest { self.fraction.max(0.05) } else { 1.0 };
            let start = match metamer.parent {
                Plant::NOTHING => Vec3::ZERO,
                parent => tips[parent as usize],
            };
            tips.push(start + (metamer.tip - plant.start(index)) * part);
        }
        tips
    }

    /// The leafy metamers of a tree whose skeleton was stretched by `scale`.
    pub fn twigs(&self, index: usize, scale: f32) -> Vec<Twig> {
        let plant = &self.members[index].plant;
        let tips = self.tips(plant);
        let mut twigs = Vec::new();
        for (axis, (_, metamers)) in axes(plant).into_iter().enumerate() {
            for &metamer in &metamers {
                let metamer = metamer as usize;
                let of = &plant.metamers[metamer];
                if u32::from(of.born) + LEAFY_CYCLES <= self.cycle {
                    continue;
                }
                let from = match of.parent {
                    Plant::NOTHING => Vec3::ZERO,
                    parent => tips[parent as usize],
                };
                let id = axis_id(of.axis, "leaves", of.place);
                let (from, to) = (from * scale, tips[metamer] * scale);
                twigs.push(Twig { axis: axis as u32, id, from, to });
            }
        }
        twigs
    }
}

/// All axes, parents first: the first metamer of each and all its metamers.
fn axes(plant: &Plant) -> Vec<(usize, Vec<u32>)> {
    let mut axes = Vec::new();
    for base in 0..plant.metamers.len() {
        if plant.metamers[base].parent != Plant::NOTHING && !plant.begins_branch(base) {
            continue;
        }
        let mut metamers = vec![base as u32];
        let mut at = base;
        while let Bears::Metamer(next) = plant.slots_of(at)[0].bears() {
            metamers.push(next);
            at = next as usize;
        }
        axes.push((base, metamers));
    }
    axes
}
