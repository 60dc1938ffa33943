//! What surrounds a plant, as the plant itself can ask: open L-systems [Mech96].
//!
//! | module | the answer |
//! |---|---|
//! | `?E(a)`, `answers = "light"` | part of the open sky's light that arrives, 0 to 1; the module is a bunch of leaves of `a` m² |
//! | `?E(r)`, `answers = "neighbors"` | other modules `?E` within `r` m |
//! | `?P(x, y, z)` | the turtle's place, m |
//! | `?H(x, y, z)`, `?L`, `?U` | its heading, left and up |
//!
//! Lengths are those of the drawing, before it is scaled to the height asked for. Light follows
//! Beer's law through voxels that hold the leaf area of all modules that ask: along a ray
//! `exp(-G Σ a / d²)` for voxels of side `d` [Monsi53], with `G` = 1/2, which is exact for leaves
//! that face all ways. Rays go to `SKY`, and a ray counts as much as a level surface receives
//! from its part of an evenly bright sky.

use super::turtle::Question;
use glam::{IVec3, Vec3};
use std::collections::BTreeMap;
use weald_contract::{Curve, table, words};

words! {
    /// What `?E` is answered with.
    pub enum Answers {
        /// The light that arrives.
        Light = "light",
        /// The number of others near.
        Neighbors = "neighbors",
    }
}

table! {
    /// What surrounds a plant that asks.
    pub struct Environment {
        /// What `?E` is answered with: `light` or `neighbors`.
        answers: Answers = Answers::Light;
        /// Side of the voxels in which light is lost, m.
        voxel: f32 = 0.1, in 0.001..=10.0;
        /// Light that others leave at a height above the ground: a number, or points
        /// `[[height in m, light], …]`.
        daylight: Curve = Curve::constant(1.0), in 0.0..=1.0;
    }
}

impl Default for Environment {
    fn default() -> Self {
        Self { answers: Answers::Light, voxel: 0.1, daylight: Curve::constant(1.0) }
    }
}

/// Rays of light: one from above and rings at 30 and 60 degrees from it, as parts of a turn.
const SKY: [(f32, u8); 3] = [(0.0, 1), (30.0, 6), (60.0, 10)];

/// Projection of leaves that face all ways, per leaf area.
const PROJECTION: f32 = 0.5;

/// Voxels that a ray goes through at most: what stands farther away takes nothing.
const FARTHEST: f32 = 60.0;

/// A ray and its share of the light on a level surface.
type Ray = (Vec3, f32);

impl Environment {
    /// Answers every question; those of one plant are asked at once.
    pub fn answers(&self, questions: &[Question]) -> Vec<super::rewrite::Answer> {
        let askers: Vec<&Question> = questions.iter().filter(|q| q.letter == 'E').collect();
        let leaves = Leaves::new(&askers, self.voxel);
        let (rays, crowd) = (rays(), Crowd::new(&askers));
        let answer = |question: &Question| {
            let values = match (question.letter, self.answers) {
                ('P', _) => question.position.to_array(),
                ('H', _) => question.frame[0].to_array(),
                ('L', _) => question.frame[1].to_array(),
                ('U', _) => question.frame[2].to_array(),
                (_, Answers::Light) => {
                    let sky = leaves.light(question.position, &rays);
                    [sky * self.daylight.at(question.position.z), 0.0, 0.0]
                }
                (_, Answers::Neighbors) => [crowd.within(question) as f32, 0.0, 0.0],
            };
            super::rewrite::Answer { id: question.id, values }
        };
        questions.iter().map(answer).collect()
    }
}

/// Directions to the sky, with weights of sum 1.
fn rays() -> Vec<Ray> {
    let ring = |(from_above, count): (f32, u8)| {
        let (sin, cos) = libm::sincosf(f32::to_radians(from_above));
        (0..count).map(move |i| {
            let around = std::f32::consts::TAU * (f32::from(i) + 0.5) / f32::from(count);
            let (y, x) = libm::sincosf(around);
            (Vec3::new(sin * x, sin * y, cos), cos)
        })
    };
    let rays: Vec<Ray> = SKY.into_iter().flat_map(ring).collect();
    let total: f32 = rays.iter().map(|ray| ray.1).sum();
    rays.into_iter().map(|(to_sky, weight)| (to_sky, weight / total)).collect()
}

/// Leaf area in voxels.
struct Leaves {
    area: BTreeMap<[i32; 3], f32>,
    voxel: f32,
    low: IVec3,
    high: IVec3,
}

impl Leaves {
    fn new(askers: &[&Question], voxel: f32) -> Self {
        let (mut area, mut low, mut high) = (BTreeMap::new(), IVec3::MAX, IVec3::MIN);
        for asker in askers.iter().filter(|asker| asker.value > 0.0) {
            let at = cell(asker.position, voxel);
            *area.entry(at.to_array()).or_insert(0.0) += asker.value;
            (low, high) = (low.min(at), high.max(at));
        }
        Self { area, voxel, low, high }
    }

    /// Light that reaches a place, through all voxels but its own.
    fn light(&self, from: Vec3, rays: &[Ray]) -> f32 {
        let passed = |ray: &Ray| {
            let depth = PROJECTION * self.area_along(from, ray.0) / (self.voxel * self.voxel);
            ray.1 * libm::expf(-depth)
        };
        rays.iter().map(passed).sum()
    }

    /// Leaf area in the voxels along a ray, each as far as the ray's way through it is long
    /// compared with its side. From voxel to voxel as in [Amanatides87].
    fn area_along(&self, from: Vec3, to_sky: Vec3) -> f32 {
        let own = cell(from, self.voxel);
        let step = to_sky.signum().as_ivec3();
        // In voxels along the ray: from one wall to the next, and to the first one.
        let between = to_sky.abs().max(Vec3::splat(1e-6)).recip();
        let inside = (from / self.voxel - own.as_vec3()).clamp(Vec3::ZERO, Vec3::ONE);
        let ahead = Vec3::select(to_sky.cmpge(Vec3::ZERO), 1.0 - inside, inside);
        let mut wall = ahead * between;
        let (mut at, mut along, mut sum) = (own, 0.0, 0.0);
        while along < FARTHEST && at.z <= self.high.z {
            let next = wall.min_element();
            if at != own && at.cmpge(self.low).all() && at.cmple(self.high).all() {
                let area = self.area.get(&at.to_array()).copied().unwrap_or(0.0);
                sum += area * (next - along);
            }
            along = next;
            let axis = wall.min_position();
            wall[axis] += between[axis];
            at[axis] += step[axis];
        }
        sum
    }
}

/// Modules that ask, sorted into cells as wide as the farthest asks.
struct Crowd {
    cells: BTreeMap<[i32; 3], Vec<Vec3>>,
    side: f32,
}

impl Crowd {
    fn new(askers: &[&Question]) -> Self {
        let side = askers.iter().map(|asker| asker.value).fold(1e-3, f32::max);
        let mut cells: BTreeMap<[i32; 3], Vec<Vec3>> = BTreeMap::new();
        for asker in askers {
            cells.entry(cell(asker.position, side).to_array()).or_default().push(asker.position);
        }
        Self { cells, side }
    }

    /// How many others stand within the question's radius.
    fn within(&self, question: &Question) -> usize {
        let middle = cell(question.position, self.side);
        let near = (-1..=1).flat_map(|z| (-1..=1).map(move |y| (y, z)));
        let near = near.flat_map(|(y, z)| (-1..=1).map(move |x| middle + IVec3::new(x, y, z)));
        let places = near.filter_map(|at| self.cells.get(&at.to_array())).flatten();
        let reach = question.value * question.value;
        // The module itself is one of them.
        places.filter(|p| p.distance_squared(question.position) <= reach).count().saturating_sub(1)
    }
}

/// The cell around a place; absurd places share the outermost ones.
fn cell(p: Vec3, side: f32) -> IVec3 {
    (p / side).floor().clamp(Vec3::splat(-1e9), Vec3::splat(1e9)).as_ivec3()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn ask(id: u64, value: f32, position: Vec3) -> Question {
        Question { id, letter: 'E', value, position, frame: [Vec3::Z, Vec3::X, Vec3::Y] }
    }

    fn light_at_the_ground(leaves: Vec<Question>, voxel: f32) -> f32 {
        let environment = Environment { voxel, ..Environment::default() };
        let mut questions = leaves;
        questions.push(ask(0, 0.0, Vec3::new(0.05, 0.05, 0.0)));
        environment.answers(&questions).last().unwrap().values[0]
    }

    #[test]
    fn a_wide_layer_of_leaves_dims_the_light_by_beers_law() {
        // Leaf area index 1.5 at 2 m: a ray at angle t goes through 1.5 / cos t.
        let (side, index) = (0.1, 1.5_f32);
        let cells = (-60..=60).flat_map(|i| (-60..=60).map(move |j| (i as f32, j as f32)));
        let middle = |i: f32| side * (i + 0.5);
        let leaves = cells
            .map(|(i, j)| ask(1, index * side * side, Vec3::new(middle(i), middle(j), 2.05)))
            .collect();
        let light = light_at_the_ground(leaves, side);
        let wanted: f32 =
            rays().iter().map(|(to_sky, weight)| weight * (-0.5 * index / to_sky.z).exp()).sum();
        assert!((light - wanted).abs() < 1e-3, "{light} for {wanted}");
        // Diffuse transmission through leaves that face all ways, 2 ∫ cos t sin t e^(-L/2 / cos t)
        // = 2 E3(0.75) = 0.32: sixteen rays come near.
        assert!((light - 0.32).abs() < 0.05, "{light}");
    }

    #[test]
    fn a_bunch_of_leaves_shades_what_is_below_it_and_not_itself() {
        let environment = Environment::default();
        let questions = [
            ask(1, 0.02, Vec3::new(0.05, 0.05, 1.05)),
            ask(2, 0.02, Vec3::new(0.05, 0.05, 0.55)),
            ask(3, 0.02, Vec3::new(3.05, 0.05, 0.55)),
        ];
        let light: Vec<f32> =
            environment.answers(&questions).iter().map(|answer| answer.values[0]).collect();
        assert!((light[0] - 1.0).abs() < 1e-6 && (light[2] - 1.0).abs() < 1e-6, "{light:?}");
        // Straight up the leaf area index is 2; that ray has 1 part of 1 + 6 cos 30 + 10 cos 60.
        let above = 1.0 / (1.0 + 6.0 * 0.75_f32.sqrt() + 5.0);
        assert!((light[1] - (1.0 - above * (1.0 - (-1.0_f32).exp()))).abs() < 1e-3, "{light:?}");
    }

    #[test]
    fn others_may_leave_less_light_near_the_ground() {
        let daylight = Curve::new(vec![[0.0, 0.1], [2.0, 0.9]]).unwrap();
        let environment = Environment { daylight, ..Environment::default() };
        let answer = environment.answers(&[ask(1, 0.0, Vec3::Z)]);
        assert!((answer[0].values[0] - 0.5).abs() < 1e-6);
    }

    proptest! {
        #[test]
        fn neighbors_are_those_that_a_plain_search_finds(
            places in prop::collection::vec((0.0f32..4.0, 0.0f32..4.0, 0.0f32..4.0, 0.0f32..1.5), 1..60),
        ) {
            let askers: Vec<Question> = places.iter().zip(0..)
                .map(|((x, y, z, r), id)| ask(id, *r, Vec3::new(*x, *y, *z))).collect();
            let environment = Environment { answers: Answers::Neighbors, ..Environment::default() };
            for (answer, asker) in environment.answers(&askers).iter().zip(&askers) {
                let near = |other: &&Question| {
                    other.id != asker.id
                        && other.position.distance_squared(asker.position) <= asker.value * asker.value
                };
                prop_assert_eq!(answer.values[0], askers.iter().filter(near).count() as f32);
            }
        }
    }
}
