//! Roots: taproots through a graph below the ground, and laterals that begin on them.

use super::space::{Space, Unit};
use super::tree::{Bearer, Grower, Place, Pool, Tree};
use super::{Irregular, Roots, Shape, stages};
use crate::frame::rot_x;
use glam::Vec3;
use weald_contract::{Problem, Seed};

/// Part of the radius beyond which taproots end, where there are several.
const OUTER: f32 = 0.85;

/// Grows the roots of a form.
pub(super) fn grow(
    form: &Irregular,
    roots: &Roots,
    filling: f32,
    seed: Seed,
) -> Result<Tree, Problem> {
    let seed = seed.part("roots", 0);
    let radius = roots.subradius.unwrap_or(roots.radius / 3.0);
    let mut grower = Grower::new(form, stages(&roots.level, radius, form.shrink), filling);
    grower.ceiling = form.root.value[2];
    first(&mut grower, roots, seed)?;
    grower.further();
    Ok(grower.tree)
}

/// The first graph: paths to the taproots' ends, then from the taproots to the laterals' ends.
fn first(grower: &mut Grower<'_>, roots: &Roots, seed: Seed) -> Result<(), Problem> {
    let origin = Vec3::from_array(grower.form.root.value);
    // Half a turn about X: what grows along +Z grows down.
    let place = Place { origin, rotation: rot_x(std::f32::consts::PI), scale: roots.radius };
    let unit = Unit::new(Shape::Sector, roots.half_angle_deg.to_radians());
    grower.make(&Space::Unit(unit), roots.nodes, &[Vec3::ZERO], place, seed);
    grower.tree.places.push(origin);
    grower.tree.parents.push(0);
    let source = grower.graph.index_of(0);
    grower.in_tree[source as usize] = 0;
    let lifespan = grower.stages.len() as u32 + 1;
    let mut pool =
        [Pool { nodes: taproots(grower, roots, source), wanted: roots.taproots as usize }];
    let stream = &mut seed.stream("taproots", 0);
    let tips = grower.draw(&[source], &[], &mut pool, stream);
    if tips.is_empty() {
        let what = format!("no path leads to a taproot in a graph of {} nodes", roots.nodes);
        return Err(Problem::new(what).hint("give the roots more `nodes`"));
    }
    grower.attach(&tips, place, Bearer { level: 1, lifespan, seed });
    if roots.laterals == 0 {
        return Ok(());
    }
    let all = 0..grower.graph.nodes.places.len() as u32;
    let is_taproot = |node: &u32| grower.in_tree[*node as usize] != super::graph::NOTHING;
    let (on, off): (Vec<u32>, Vec<u32>) = all.partition(is_taproot);
    let near = |node: &u32| {
        let p = grower.graph.nodes.places[*node as usize];
        let to = |other: &u32| grower.graph.nodes.places[*other as usize].distance(p);
        on.iter().any(|other| to(other) <= roots.around)
    };
    let nodes: Vec<u32> = off.into_iter().filter(near).collect();
    let mut pool = [Pool { nodes, wanted: roots.laterals as usize }];
    let ends = grower.draw(&on, &[], &mut pool, stream);
    let seed = seed.part("laterals", 0);
    grower.attach(&ends, place, Bearer { level: 1, lifespan, seed });
    Ok(())
}

/// Nodes that a taproot may end at: the deepest, or for several any far out.
fn taproots(grower: &Grower<'_>, roots: &Roots, source: u32) -> Vec<u32> {
    let places = &grower.graph.nodes.places;
    let all = 0..places.len() as u32;
    if roots.taproots == 1 {
        let off = |node: &u32| places[*node as usize].distance_squared(Vec3::Z);
        let deepest = all.filter(|node| *node != source).min_by(|a, b| off(a).total_cmp(&off(b)));
        return deepest.into_iter().collect();
    }
    all.filter(|node| *node != source && places[*node as usize].length() >= OUTER).collect()
}
