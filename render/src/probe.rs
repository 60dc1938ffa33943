//! Bare rays through a scene, without light: for benchmarks and for comparison with other tracers.

use crate::accel::{Bounds, Ray, Scratch};
use crate::bsdf::any_direction;
use crate::scene::Scene;
use glam::Vec3;
use rayon::prelude::*;
use weald_contract::Seed;

/// A ray in scene-local metres: east and north of the terrain's south-west corner, and above the
/// whole metre below its lowest place.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Probe {
    /// Where it starts.
    pub origin: [f32; 3],
    /// Where it goes; distances count in its lengths.
    pub direction: [f32; 3],
}

/// What a [`Probe`] met.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Met {
    /// Distance, in lengths of the direction.
    pub distance: f32,
    /// Unit normal of the surface, to the side from which its corners run counter-clockwise.
    pub normal: [f32; 3],
}

impl From<&Probe> for Ray {
    fn from(probe: &Probe) -> Self {
        Ray { origin: probe.origin.into(), direction: probe.direction.into() }
    }
}

/// Distances to the nearest solid things, infinite where there is none; on the calling thread.
pub fn distances(scene: &Scene, probes: &[Probe]) -> Vec<f32> {
    let mut scratch = Scratch::default();
    let mut distance = |probe: &Probe| {
        let hit = scene.levels.nearest(scene.solid, &probe.into(), f32::INFINITY, &mut scratch);
        if hit.is_some() { hit.t } else { f32::INFINITY }
    };
    probes.iter().map(&mut distance).collect()
}

/// Whether anything solid lies on each ray; on the calling thread.
pub fn are_blocked(scene: &Scene, probes: &[Probe]) -> Vec<bool> {
    let mut scratch = Scratch::default();
    let mut is_blocked = |probe: &Probe| {
        scene.levels.is_blocked(scene.solid, &probe.into(), f32::INFINITY, &mut scratch)
    };
    probes.iter().map(&mut is_blocked).collect()
}

/// What a ray meets.
pub fn meet(scene: &Scene, probe: &Probe) -> Option<Met> {
    let mut scratch = Scratch::default();
    let hit = scene.levels.nearest(scene.solid, &probe.into(), f32::INFINITY, &mut scratch);
    hit.is_some().then(|| {
        let normal = scene.levels.place(scene.solid, &hit).geometric.to_array();
        Met { distance: hit.t, normal }
    })
}

/// Traces `count` rays from random places above the ground in random directions and returns how
/// many met something, on all threads.
pub fn probe(scene: &Scene, count: u64, seed: Seed) -> u64 {
    let bounds = scene.bounds();
    /// Rays that one task traces.
    const BATCH: u64 = 4096;
    let batch = |number: u64| {
        let mut scratch = Scratch::default();
        let rays =
            random_rays(bounds, seed, number).take(BATCH.min(count - number * BATCH) as usize);
        let is_met = |ray: &Ray| {
            scene.levels.nearest(scene.solid, ray, f32::INFINITY, &mut scratch).is_some()
        };
        rays.filter(is_met).count() as u64
    };
    (0..count.div_ceil(BATCH)).into_par_iter().map(batch).sum()
}

/// A series of rays from the middle of a box, where the plants are, at the height of a person.
pub(crate) fn random_rays(bounds: Bounds, seed: Seed, number: u64) -> impl Iterator<Item = Ray> {
    let mut chance = seed.stream("probe", number);
    std::iter::repeat_with(move || {
        let mut at = |low: f32, high: f32| {
            0.5 * (low + high) + 0.02 * (high - low) * chance.around(0.0, 1.0) as f32
        };
        let x = at(bounds.low.x, bounds.high.x);
        let y = at(bounds.low.y, bounds.high.y);
        let origin = Vec3::new(x, y, bounds.low.z + 3.0);
        let u = [chance.unit() as f32, chance.unit() as f32];
        Ray { origin, direction: any_direction(u) }
    })
}
