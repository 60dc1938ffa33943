//! The curves that axes are drawn as: 4-point subdivision of their nodes, thinned where straight.
//!
//! The scheme of Dyn, Gregory and Levin [Dyn87] puts a new point between two old ones at
//! `9/16 (b + c) - 1/16 (a + d)` and keeps the old ones, so that a curve contains every node of
//! its axis. What grows on an axis is moved along with the part that bears it.

use crate::skeleton::{Axis, AxisKind, Node, Skeleton};
use glam::Vec3;

/// Most steps of subdivision: eight chords for one.
const MOST_STEPS: u32 = 3;

/// Chords longer than this many times their neighbour are not bent by it: the scheme takes nodes
/// to be evenly spaced, and would overshoot.
const UNEVEN: f32 = 3.0;

/// One step of 4-point subdivision of nodes: positions and radii, the latter between those of the
/// neighbours.
pub fn subdivide(nodes: &[Node]) -> Vec<Node> {
    let mut finer = Vec::with_capacity(2 * nodes.len());
    for (index, pair) in nodes.windows(2).enumerate() {
        finer.extend([pair[0], between(nodes, index)]);
    }
    finer.extend(nodes.last());
    finer
}

/// Several steps of 4-point subdivision.
pub fn subdivided(nodes: &[Node], steps: u32) -> Vec<Node> {
    let mut finer = nodes.to_vec();
    for _ in 0..steps {
        finer = subdivide(&finer);
    }
    finer
}

/// The new node between nodes `index` and `index + 1`; beyond the ends the line goes on straight.
fn between(nodes: &[Node], index: usize) -> Node {
    let (b, c) = (nodes[index], nodes[index + 1]);
    let straight = |near: Node, far: Node| Node {
        position: 2.0 * near.position - far.position,
        radius: 2.0 * near.radius - far.radius,
    };
    let a = if index > 0 { nodes[index - 1] } else { straight(b, c) };
    let d = nodes.get(index + 2).copied().unwrap_or_else(|| straight(c, b));
    let middle = 0.5 * (b.position + c.position);
    let radius = 9.0 / 16.0 * (b.radius + c.radius) - 1.0 / 16.0 * (a.radius + d.radius);
    let radius = radius.clamp(b.radius.min(c.radius), b.radius.max(c.radius));
    let chord = b.position.distance(c.position);
    let is_even = |other: f32| other < UNEVEN * chord && chord < UNEVEN * other;
    let is_smooth =
        is_even(a.position.distance(b.position)) && is_even(c.position.distance(d.position));
    let bend = 0.125 * (middle - 0.5 * (a.position + d.position));
    Node { position: if is_smooth { middle + bend } else { middle }, radius }
}

/// Steps after which no chord misses the curve by more than `tolerance`, m.
///
/// The miss falls to a quarter with each step.
fn steps(nodes: &[Node], tolerance: f32) -> u32 {
    if nodes.len() < 3 {
        return 0;
    }
    let miss = |index: usize| {
        let middle = 0.5 * (nodes[index].position + nodes[index + 1].position);
        between(nodes, index).position.distance_squared(middle)
    };
    let worst = (0..nodes.len() - 1).map(miss).fold(0.0, f32::max);
    let mut allowed = tolerance * tolerance;
    let mut steps = 0;
    while worst > allowed && steps < MOST_STEPS {
        allowed *= 16.0;
        steps += 1;
    }
    steps
}

/// Leaves out nodes that lie within `tolerance` of the line between those that stay, as do their
/// radii.
fn thin(nodes: &mut Vec<Node>, tolerance: f32) {
    if nodes.len() < 4 {
        return;
    }
    let is_needed = |nodes: &[Node], from: usize, to: usize| {
        let (a, b) = (nodes[from], nodes[to]);
        let chord = b.position - a.position;
        let square = chord.length_squared();
        nodes[from + 1..to].iter().any(|node| {
            let t = (node.position - a.position).dot(chord) / square.max(f32::MIN_POSITIVE);
            let off = node.position.distance_squared(a.position + chord * t);
            let radius = a.radius + (b.radius - a.radius) * t;
            !(0.0..=1.0).contains(&t)
                || off > tolerance * tolerance
                || (node.radius - radius).abs() > tolerance.min(0.15 * node.radius)
        })
    };
    let last = nodes.len() - 1;
    // What stays moves to the front; `from` is the last of it, at its old and its new place.
    let (mut from, mut kept) = (0, 1);
    for to in 2..=last {
        // The last ring stands before the tip: what it closes must not grow long.
        if is_needed(nodes, from, to) || to == last {
            from = to - 1;
            nodes[kept] = nodes[from];
            kept += 1;
        }
    }
    nodes[kept] = nodes[last];
    nodes.truncate(kept + 1);
}

/// Radius at a fraction of an axis' length.
pub fn radius_at(nodes: &[Node], at: f32) -> f32 {
    let (index, t) = locate(nodes, at);
    nodes[index].radius + (nodes[index + 1].radius - nodes[index].radius) * t
}

/// Chord and place on it at a fraction of an axis' length.
fn locate(nodes: &[Node], at: f32) -> (usize, f32) {
    let lengths = || nodes.windows(2).map(|pair| pair[0].position.distance(pair[1].position));
    let mut rest = at.clamp(0.0, 1.0) * lengths().sum::<f32>();
    for (index, length) in lengths().enumerate() {
        if rest <= length && length > 0.0 {
            return (index, rest / length);
        }
        rest -= length;
    }
    (nodes.len() - 2, 1.0)
}

/// The axes of a skeleton as they are drawn.
pub struct Course {
    axes: Vec<Drawn>,
}

/// How an axis is drawn.
struct Drawn {
    /// How far chords may miss the curve, m.
    tolerance: f32,
    /// Steps of subdivision.
    steps: u32,
    /// How far what bears it has carried it, m.
    shift: Vec3,
}

/// Radius of a branch whose bends are seen as they are; those of twigs hide among leaves, m.
const THICK: f32 = 0.02;

/// How the axes of a skeleton are drawn: chords of a branch 2 cm thick may miss the curve by
/// `bend`, those of trunks by half and those of twigs by three times that, but all by `sag`, m.
pub fn courses(skeleton: &Skeleton, sag: f32, bend: f32) -> Course {
    let mut course = Course { axes: Vec::with_capacity(skeleton.axes.len()) };
    for axis in &skeleton.axes {
        let nodes = skeleton.nodes_of(axis);
        let allowed = match axis.kind {
            // A blade is seen from the side by its edge alone: twice as much is allowed.
            AxisKind::Blade => 2.0 * sag,
            AxisKind::Stem => sag.max(bend * (THICK / nodes[0].radius.max(1e-6)).clamp(0.5, 3.0)),
        };
        let shift = axis.parent.map_or(Vec3::ZERO, |parent| course.carried(skeleton, parent, axis));
        course.axes.push(Drawn { tolerance: allowed, steps: steps(nodes, allowed), shift });
    }
    course
}

impl Course {
    /// How far the foot of an axis lies from where its bearer's nodes put it.
    fn carried(&self, skeleton: &Skeleton, parent: u32, axis: &Axis) -> Vec3 {
        let Some(&Drawn { steps, shift, .. }) = self.axes.get(parent as usize) else {
            return Vec3::ZERO;
        };
        if steps == 0 {
            return shift;
        }
        let nodes = skeleton.nodes_of(&skeleton.axes[parent as usize]);
        let (index, t) = locate(nodes, axis.at);
        shift + bulge(nodes, index, t, steps)
    }

    /// Puts the nodes that an axis is drawn with into `drawn`.
    pub fn draw(&self, skeleton: &Skeleton, index: usize, drawn: &mut Vec<Node>) {
        let nodes = skeleton.nodes_of(&skeleton.axes[index]);
        let Drawn { tolerance, steps, shift } = self.axes[index];
        drawn.clear();
        if steps == 0 {
            drawn.extend_from_slice(nodes);
        } else {
            drawn.append(&mut subdivided(nodes, steps));
        }
        if shift != Vec3::ZERO {
            drawn.iter_mut().for_each(|node| node.position += shift);
        }
        thin(drawn, tolerance);
    }

    /// Most nodes that an axis is drawn with.
    pub fn most_nodes(&self, axis: &Axis, index: usize) -> usize {
        axis.nodes.len() << self.axes[index].steps
    }

    /// Where a point beside an axis comes to lie.
    pub fn moved(&self, skeleton: &Skeleton, index: usize, point: Vec3) -> Vec3 {
        let Drawn { steps, shift, .. } = self.axes[index];
        if steps == 0 {
            return point + shift;
        }
        let nodes = skeleton.nodes_of(&skeleton.axes[index]);
        let mut nearest = (f32::INFINITY, 0, 0.0);
        for (index, pair) in nodes.windows(2).enumerate() {
            let chord = pair[1].position - pair[0].position;
            let square = chord.length_squared().max(f32::MIN_POSITIVE);
            let t = ((point - pair[0].position).dot(chord) / square).clamp(0.0, 1.0);
            let off = point.distance_squared(pair[0].position + chord * t);
            if off < nearest.0 {
                nearest = (off, index, t);
            }
        }
        point + shift + bulge(nodes, nearest.1, nearest.2, steps)
    }
}

/// How far the subdivided curve lies from the chord at the place `t` on it.
fn bulge(nodes: &[Node], index: usize, t: f32, steps: u32) -> Vec3 {
    // Two nodes to either side are all that the curve over one chord depends on after the first
    // step; a third keeps the ends of the window from being seen.
    let from = index.saturating_sub(3);
    let to = (index + 5).min(nodes.len());
    let finer = subdivided(&nodes[from..to], steps);
    let scale = (1_usize << steps) as f32;
    let place = ((index - from) as f32 + t) * scale;
    let before = (place as usize).min(finer.len() - 2);
    let curve = finer[before].position.lerp(finer[before + 1].position, place - before as f32);
    curve - nodes[index].position.lerp(nodes[index + 1].position, t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::opaque;
    use proptest::prelude::*;

    fn nodes(points: &[[f32; 3]]) -> Vec<Node> {
        let node = |p: &[f32; 3]| Node { position: Vec3::from_array(*p), radius: 0.01 };
        points.iter().map(node).collect()
    }

    #[test]
    fn a_cubic_is_met_exactly() {
        // The scheme reproduces polynomials up to degree three on even spacing.
        let cubic = |t: f32| [t, t * t - 2.0 * t, 0.1 * t * t * t];
        let nodes = nodes(&(0..8).map(|i| cubic(i as f32)).collect::<Vec<_>>());
        for index in 1..6 {
            let found = between(&nodes, index).position;
            let expected = Vec3::from_array(cubic(index as f32 + 0.5));
            // Chords grow by less than three from one to the next here.
            assert!(found.distance(expected) < 2e-5, "{found} {expected}");
        }
    }

    #[test]
    fn after_s_steps_there_are_the_stated_number_of_points() {
        let mut curve = nodes(&[[0.0; 3], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [2.0, 1.0, 0.0]]);
        for step in 1..=3 {
            curve = subdivide(&curve);
            assert_eq!(curve.len(), 3 * (1 << step) + 1);
        }
    }

    #[test]
    fn straight_stems_are_thinned_and_bent_ones_smoothed() {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let straight: Vec<[f32; 3]> = (0..20).map(|i| [0.0, 0.0, 0.1 * i as f32]).collect();
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), nodes(&straight));
        let bent: Vec<[f32; 3]> =
            (0..5).map(|i| [1.0 - (0.4 * i as f32).cos(), 0.0, (0.4 * i as f32).sin()]).collect();
        skeleton.push(Axis::new(2, AxisKind::Stem, 0), nodes(&bent));
        let course = courses(&skeleton, 0.0025, 0.0);
        let drawn = |index| {
            let mut drawn = Vec::new();
            course.draw(&skeleton, index, &mut drawn);
            drawn
        };
        assert_eq!(drawn(0).len(), 3);
        let curve = drawn(1);
        assert!(curve.len() > bent.len());
        // The circle of radius 1 around (1, 0, 0), away from the straight ends.
        let inner = curve.iter().filter(|n| n.position.z > 0.4 && n.position.z < 0.9);
        for node in inner {
            let off = (node.position - Vec3::X).length() - 1.0;
            assert!(off.abs() < 0.004, "{off}");
        }
    }

    #[test]
    fn what_grows_on_a_curve_goes_with_it() {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let arch = [[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 0.0, 0.0]];
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), nodes(&arch));
        // At the middle of the arch, where the curve rises highest above the chord.
        let twig = nodes(&[[0.5, 0.0, 1.0], [0.5, 0.0, 2.0]]);
        skeleton.push(Axis::new(2, AxisKind::Stem, 0).on(0, 0.5, 1), twig);
        let course = courses(&skeleton, 0.001, 0.0);
        let mut drawn = Vec::new();
        course.draw(&skeleton, 1, &mut drawn);
        let foot = drawn[0].position;
        assert!((foot.z - 1.125).abs() < 1e-5, "{foot}");
        let leaf = course.moved(&skeleton, 0, Vec3::new(0.5, 0.0, 1.0));
        assert!(leaf.distance(foot) < 1e-5);
    }

    proptest! {
        #[test]
        fn curves_contain_their_nodes(points in prop::collection::vec(prop::array::uniform3(-5.0f32..5.0), 2..9)) {
            let rough = nodes(&points);
            let fine = subdivide(&subdivide(&rough));
            for (i, node) in rough.iter().enumerate() {
                prop_assert_eq!(fine[4 * i], *node);
            }
        }
    }
}
