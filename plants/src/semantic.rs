//! Semantic trees: every branch has parameters and geometry, and each follows the other
//! [Ganster07].
//!
//! [`notation`] reads the values of parameters, [`tree`] holds the branches, [`script`] edits
//! them. A finished tree is a [`Skeleton`] like that of any other generator.

pub mod camera;
pub mod import;
pub mod notation;
pub mod script;
pub mod tree;
pub mod trees;

use crate::material::{LeafColor, opaque};
use crate::organ::{self, LeafShape};
use crate::skeleton::{Axis, AxisKind, Node, PlacedOrgan, Skeleton, axis_id};
use crate::{Stature, frame};
use glam::Vec3;
use script::Editor;
use tree::{Branch, Tree};
use weald_contract::{Problem, Problems, Seed, Written, table};

table! {
    /// A tree made by an edit script.
    pub struct Semantic {
        /// The script, one operation a line.
        script: Written<String>;
        /// Outline of the leaves.
        leaf_shape: LeafShape = LeafShape::Ovate;
        /// Width of a leaf over its length.
        leaf_width: f32 = 0.6, in 0.01..=5.0;
        /// Colour of the leaves.
        leaf_color: LeafColor = LeafColor::default();
        /// Bark reflectance.
        bark: [f32; 3] = [0.15, 0.12, 0.09], in 0.0..=0.9;
    }
}

/// Most leaves of a tree that is drawn: ten times the richest of the paper, some 300 MB.
pub const MOST_LEAVES: usize = 4_000_000;

impl Semantic {
    /// Everything wrong with the script and the colours.
    pub fn check(&self) -> Problems {
        let mut problems = self.leaf_color.check();
        let mut editor = Editor::new(0);
        let leaves = match editor.run(&self.script.value) {
            Ok(_) => Statistics::of(editor.tree()).leaves,
            Err(error) => {
                problems.push(Problem::at(self.script.span, error.to_string()));
                0
            }
        };
        if leaves > MOST_LEAVES {
            let what = format!("the tree would have {leaves} leaves");
            let hint = format!("at most {MOST_LEAVES} are allowed");
            problems.push(Problem::at(self.script.span, what).hint(hint));
        }
        problems
    }

    /// Runs the script with another chance, and fits the tree to a stature.
    ///
    /// # Errors
    /// The first wrong line of the script.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Result<Skeleton, Problem> {
        let mut editor = Editor::new(seed.stream("semantic", 0).next_u64());
        let wrong = |error: script::ScriptError| Problem::at(self.script.span, error.to_string());
        editor.run(&self.script.value).map_err(wrong)?;
        // A young or starved tree lacks some of its branches, always the same ones.
        let kept = (0.7 + 0.3 * stature.vigor) * stature.maturity.powf(0.3);
        let mut skeleton = self.skeleton(editor.tree(), kept, stature.vigor);
        let factor = skeleton.stretch_to(stature.height);
        skeleton.stretch(factor, factor, factor);
        Ok(skeleton)
    }

    /// The skeleton of a tree with a part `kept` of its branches.
    pub fn skeleton(&self, tree: &Tree, kept: f32, vigor: f32) -> Skeleton {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", self.bark));
        skeleton.materials.push(self.leaf_color.material("leaf", vigor, 0, 1));
        skeleton.add_prototype("leaf", vec![organ::leaf(self.leaf_shape, 0.1, 0.1, 1)]);
        let mut waiting: Vec<(u32, Option<u32>)> =
            tree.root.map(|root| (root, None)).into_iter().collect();
        while let Some((id, parent)) = waiting.pop() {
            let branch = tree.get(id);
            let chance = Seed(branch.seed).stream("presence", 0).unit() as f32;
            if parent.is_some() && chance > kept {
                continue;
            }
            let at = parent.map_or(0.0, |_| {
                part_of_length(&tree.get(branch.parent.unwrap_or(0)).points, branch.anchor)
            });
            let axis = Axis::new(axis_id(0, "semantic", id), AxisKind::Stem, 0);
            let axis = match parent {
                Some(parent) => axis.on(parent, at, branch.level),
                None => axis,
            };
            let tangent = (branch.points[1] - branch.points[0]).normalize_or(Vec3::Z);
            let nodes = branch.points.iter().zip(&branch.radii);
            let nodes = nodes.map(|(&position, &radius)| Node { position, radius });
            let index = skeleton.push(axis.facing(frame::any_normal(tangent)), nodes);
            self.place_leaves(&mut skeleton, branch, index);
            waiting.extend(branch.children.iter().rev().map(|&child| (child, Some(index))));
        }
        skeleton
    }

    fn place_leaves(&self, skeleton: &mut Skeleton, branch: &Branch, axis: u32) {
        skeleton.organs.extend(branch.leaves().map(|leaf| {
            PlacedOrgan {
                prototype: 0,
                axis,
                position: leaf.place,
                rotation: frame::organ_rotation(frame::frame_of(
                    (leaf.frame * Vec3::Z).normalize(),
                    Vec3::Z,
                ))
                .normalize(),
                scale: Vec3::new(self.leaf_width, 1.0, 1.0) * leaf.size,
            }
        }));
    }
}

/// The part of a polygon's length that lies before an anchor.
fn part_of_length(points: &[Vec3], anchor: f32) -> f32 {
    let j = anchor.clamp(0.0, 1.0) * (points.len() - 1) as f32;
    let (mut before, mut all) = (0.0, 0.0);
    for (k, pair) in points.windows(2).enumerate() {
        let length = pair[0].distance(pair[1]);
        all += length;
        before += length * (j - k as f32).clamp(0.0, 1.0);
    }
    before / f32::max(all, f32::MIN_POSITIVE)
}

/// A tree in the terms of [Ganster07] table 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
    /// Branches, the trunk among them.
    pub branches: usize,
    /// Leaves.
    pub leaves: usize,
    /// Levels.
    pub levels: usize,
    /// Bytes of control points and radii.
    pub geometry: usize,
    /// Bytes of parameters, those that are shared once.
    pub parameters: usize,
}

impl Statistics {
    /// Counts a tree.
    pub fn of(tree: &Tree) -> Self {
        let mut styles = std::collections::BTreeSet::new();
        let mut counted = Self::default();
        for id in tree.all() {
            let branch = tree.get(id);
            counted.branches += 1;
            counted.leaves += branch.leaf_count();
            counted.levels = counted.levels.max(usize::from(branch.level) + 1);
            counted.geometry += branch.points.len() * size_of::<Vec3>() + branch.radii.len() * 4;
            // The two counts of the shared pointer stand before the branch.
            counted.parameters += size_of::<Branch>() + 16 + size_of::<usize>();
            counted.parameters += branch.children.capacity() * 4;
            counted.parameters +=
                branch.shape.as_ref().map_or(0, |shape| shape.len() * size_of::<Vec3>());
            let style = std::sync::Arc::as_ptr(&branch.style);
            if styles.insert(style) {
                counted.parameters += size_of::<tree::Style>();
                counted.parameters += branch.style.sets.len()
                    * (size_of::<tree::ChildSet>() + size_of::<tree::Style>());
            }
        }
        counted
    }
}

#[cfg(test)]
mod tests;
