//! The volume of the first graph: trunk and crown, or balls joined to the trunk by cones.

use super::Irregular;
use super::nodes::{Nodes, Scatter};
use super::space::{COMMON, Piece, Space, Union};
use crate::volume::{Ball, Cone, Solid};
use glam::Vec3;
use std::borrow::Cow;
use weald_contract::Seed;

/// Least distance of the middles of two balls over the side of the cube that each has for itself.
const BALLS_APART: f32 = 0.8;

/// Radius of a ball over the side of that cube.
const BALL_RADIUS: f32 = 0.55;

/// Places of the trunk among which a ball looks for the nearest.
const TRUNK_PLACES: usize = 400;

/// The volume of the first graph.
pub(super) struct First<'a> {
    /// Where nodes may be.
    pub(super) space: Space<'a>,
    /// Solids in which endpoints lie, by part: one part, or one for each ball.
    pub(super) crowns: Vec<Cow<'a, [Solid]>>,
    /// Where cones meet the trunk.
    pub(super) joints: Vec<Vec3>,
}

impl<'a> First<'a> {
    /// The volume of a form.
    pub(super) fn of(form: &'a Irregular, seed: Seed) -> Self {
        let borrow = |solid: &'a Solid| Piece::new(Cow::Borrowed(solid), COMMON);
        let mut pieces: Vec<Piece<'_>> = form.trunk.iter().map(borrow).collect();
        let Some(refine) = &form.refine else {
            pieces.extend(form.crown.iter().map(borrow));
            let space = Space::Union(Union::new(pieces));
            let crowns = vec![Cow::Borrowed(form.crown.as_slice())];
            return Self { space, crowns, joints: Vec::new() };
        };
        let (middles, side) = middles(form, refine.count as usize, seed);
        let radius = refine.radius.unwrap_or(BALL_RADIUS * side);
        let (mut crowns, mut joints) = (Vec::new(), Vec::new());
        let trunk = trunk_places(form, seed);
        for (index, middle) in middles.iter().enumerate() {
            // More parts than there are numbers share the last; `count` allows 200.
            let part = (index + 1).min(255) as u8;
            let joint = nearest(&trunk, *middle);
            let center = middle.to_array();
            let ball = Solid::Ball(Ball { center, radius });
            let cone = Solid::Cone(Cone { base: center, apex: joint.to_array(), radius });
            pieces.push(Piece::new(Cow::Owned(ball.clone()), part));
            if joint.distance(*middle) > 0.1 * radius {
                pieces.push(Piece::new(Cow::Owned(cone), part));
            }
            crowns.push(Cow::Owned(vec![ball]));
            if !joints.contains(&joint) {
                joints.push(joint);
            }
        }
        Self { space: Space::Union(Union::new(pieces)), crowns, joints }
    }

    /// The part whose crown a node of a part may be an endpoint in.
    pub(super) fn part_of_crown(&self, crown: usize) -> Option<u8> {
        (self.crowns.len() > 1 || !self.joints.is_empty()).then(|| (crown + 1).min(255) as u8)
    }

    /// Whether an endpoint may lie at a place: in a crown, and at most `shell` below its surface.
    pub(super) fn allows(&self, crown: usize, place: Vec3, shell: Option<f32>) -> bool {
        let solids = &self.crowns[crown];
        let Some(shell) = shell else { return solids.iter().any(|solid| solid.contains(place)) };
        let depth =
            solids.iter().map(|solid| depth(solid, place)).fold(f32::NEG_INFINITY, f32::max);
        (0.0..=shell).contains(&depth)
    }
}

/// Depth of a place below the surface of a solid, negative outside.
///
/// Of a sector the round surface counts: its shell lies between an outer and an inner ball.
fn depth(solid: &Solid, place: Vec3) -> f32 {
    match solid {
        Solid::Sector(sector) if solid.contains(place) => {
            sector.radius - place.distance(Vec3::from_array(sector.center))
        }
        _ => -solid.distance(place),
    }
}

/// Middles of balls in the crown, and the side of the cube that each has for itself.
fn middles(form: &Irregular, count: usize, seed: Seed) -> (Vec<Vec3>, f32) {
    let crown = form.crown.iter().map(|solid| Piece::new(Cow::Borrowed(solid), COMMON));
    let crown = Space::Union(Union::new(crown.collect()));
    let volume = crown.volume(&mut seed.stream("crown", 0));
    let side = libm::cbrt(volume / count as f64) as f32;
    let mut nodes = Nodes::default();
    let how = Scatter { count, apart: BALLS_APART * side };
    nodes.scatter(&crown, &how, &[], &mut seed.stream("balls", 0), |_| true);
    (nodes.places, side)
}

/// Places in the trunk; the root alone where there is none.
fn trunk_places(form: &Irregular, seed: Seed) -> Vec<Vec3> {
    let root = Vec3::from_array(form.root.value);
    let trunk = form.trunk.iter().map(|solid| Piece::new(Cow::Borrowed(solid), COMMON));
    let pieces: Vec<Piece<'_>> = trunk.collect();
    if pieces.is_empty() {
        return vec![root];
    }
    let trunk = Space::Union(Union::new(pieces));
    let mut stream = seed.stream("trunk", 0);
    let mut places = vec![root];
    for _ in 0..100 * TRUNK_PLACES {
        places.extend(trunk.sample(&mut stream).map(|(p, _)| p));
        if places.len() > TRUNK_PLACES {
            break;
        }
    }
    places
}

fn nearest(places: &[Vec3], to: Vec3) -> Vec3 {
    let closer = |a: &&Vec3, b: &&Vec3| a.distance_squared(to).total_cmp(&b.distance_squared(to));
    places.iter().min_by(closer).copied().unwrap_or(to)
}
