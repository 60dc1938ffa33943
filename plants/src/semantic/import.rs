//! Trees of other generators taken in to be edited.
//!
//! Every axis becomes a branch whose parameters are deduced from its geometry, as if it had been
//! sketched; so counts, lengths and places are those of the other generator.

use super::notation::Distribution;
use super::tree::{LEAF_SIZE, LEAVES, MOST_BRANCHES, Tree};
use crate::skeleton::Skeleton;
use glam::Vec3;
use std::sync::Arc;

/// Greatest depth of axes: levels are told apart by a byte.
const DEEPEST: u8 = 250;

/// A tree like a skeleton that stands on one stem.
///
/// # Errors
/// What cannot be taken in, in words: several stems from the ground, or too many axes.
pub fn tree_of(skeleton: &Skeleton, seed: u64) -> Result<Tree, String> {
    let roots = skeleton.axes.iter().filter(|axis| axis.parent.is_none()).count();
    if roots != 1 {
        return Err(format!("it has {roots} stems from the ground; a semantic tree has one"));
    }
    if skeleton.axes.len() > MOST_BRANCHES {
        let count = skeleton.axes.len();
        return Err(format!("it has {count} branches; at most {MOST_BRANCHES} are allowed"));
    }
    let mut tree = Tree { branches: Vec::new(), root: None, seed, foot: Vec3::ZERO, rebuilt: 0 };
    for axis in &skeleton.axes {
        // Axes are numbered as branches are born: both count from 0 and parents come first.
        let nodes = skeleton.nodes_of(axis);
        let points: Vec<Vec3> = nodes.iter().map(|node| node.position).collect();
        let anchor = axis
            .parent
            .map_or(0.0, |parent| super::script::nearest(&tree.get(parent).points, points[0]));
        if axis.parent.is_some_and(|parent| tree.get(parent).level >= DEEPEST) {
            return Err(format!("its branches are nested more than {DEEPEST} deep"));
        }
        if axis.parent.is_none() {
            tree.foot = points[0];
        }
        let id = tree.graft_last(axis.parent, anchor, &points);
        tree.rebuild(id);
        tree.keep_radii(id, nodes.iter().map(|node| node.radius).collect());
    }
    for id in tree.all() {
        tree.finish_grafts(id);
    }
    bear_leaves(&mut tree, skeleton);
    Ok(tree)
}

/// As many leaves on each branch, of their mean length.
fn bear_leaves(tree: &mut Tree, skeleton: &Skeleton) {
    let mut leaves = vec![(0u32, 0.0f32); skeleton.axes.len()];
    for organ in &skeleton.organs {
        let (count, size) = &mut leaves[organ.axis as usize];
        *count += 1;
        *size += organ.scale.y;
    }
    for (id, (count, size)) in leaves.into_iter().enumerate().filter(|(_, (count, _))| *count > 0) {
        let style = Arc::make_mut(&mut tree.get_mut(id as u32).style);
        style.values[LEAVES] = Distribution::constant(count as f32);
        style.values[LEAF_SIZE] = Distribution::constant(size / count as f32);
        style.values[LEAVES + 1] = Distribution { from: [0.1, 0.0], to: Some([1.0, 0.0]) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::semantic::tree::point_at;
    use crate::skeleton::{Axis, AxisKind, Node};

    #[test]
    fn several_stems_are_refused() {
        let mut skeleton = Skeleton::default();
        let node = |z| Node { position: Vec3::new(0.0, 0.0, z), radius: 0.1 };
        for id in 0..2 {
            skeleton.push(Axis::new(id, AxisKind::Stem, 0), [node(0.0), node(1.0)]);
        }
        assert!(tree_of(&skeleton, 1).unwrap_err().contains("2 stems"));
        assert!(tree_of(&Skeleton::default(), 1).is_err());
    }

    #[test]
    fn a_grafted_child_begins_on_its_parent() {
        let mut skeleton = Skeleton::default();
        let node = |x, z| Node { position: Vec3::new(x, 0.0, z), radius: 0.1 };
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), [node(0.0, 0.0), node(0.0, 4.0)]);
        let child = Axis::new(2, AxisKind::Stem, 0).on(0, 0.25, 1);
        skeleton.push(child, [node(0.0, 1.0), node(1.0, 1.5), node(2.0, 1.6)]);
        let tree = tree_of(&skeleton, 1).unwrap();
        assert_eq!(tree.get(1).anchor, 0.25);
        assert_eq!(point_at(&tree.get(0).points, 0.25).0, tree.get(1).points[0]);
        for (point, node) in tree.get(1).points.iter().zip(&skeleton.nodes[2..]) {
            assert!(point.distance(node.position) < 1e-5);
        }
    }
}
