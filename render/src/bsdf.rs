//! What surfaces do with light.
//!
//! A surface scatters diffusely to the side the light came from, and a leaf also to the other
//! side; a smooth one has a thin glossy [`Coat`] above that, on both sides. What the coat
//! reflects does not reach the leaf below.
//!
//! Which side light comes from is told by the geometric normal, or light would leak through; how
//! much of it arrives by the shading normal n, as |n · ω| [Veach97] §5.3. Directions that lie above one
//! plane and below the other thereby lose nothing: the wedge that the geometric plane cuts off the
//! hemisphere around n stands opposite the one that it adds, and |n · ω| is the same on both.

use crate::coat::Coat;
use crate::tone::luminance;
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Material of a triangle.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Material {
    /// Diffuse reflectance.
    pub reflectance: Vec3,
    /// Diffuse transmittance; zero for what is opaque.
    pub transmittance: Vec3,
    /// Radiance of its own, to both sides, kcd/m².
    pub emission: Vec3,
    /// Roughness of the coat; from 0.95 on there is none.
    pub roughness: f32,
    /// Largest part of the light that is lost or gained at random from leaf to leaf.
    pub variation: f32,
    /// Whether colour comes from the ground's map instead.
    pub is_ground: bool,
    /// Index of the texture whose colour multiplies reflectance and transmittance.
    pub texture: Option<u32>,
    /// Number in pictures of the species that is made of it; 0 for what is no plant.
    pub species: u32,
}

/// Least cosine between the viewer and the shading normal.
const LEAST_COSINE: f32 = 0.002;

/// A surface at a point, turned towards the viewer.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bsdf {
    pub reflectance: Vec3,
    transmittance: Vec3,
    coat: Option<Coat>,
    /// Unit shading normal on the viewer's side.
    pub normal: Vec3,
    /// Unit geometric normal on the viewer's side.
    pub geometric: Vec3,
}

/// How much light goes on, and how likely this direction was to be drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Scatter {
    /// BSDF times cosine.
    pub value: Vec3,
    /// Density, 1/sr.
    pub pdf: f32,
}

/// A direction that light goes on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct BsdfSample {
    pub direction: Vec3,
    /// BSDF times cosine over density.
    pub weight: Vec3,
    /// Density, 1/sr.
    pub pdf: f32,
}

impl Bsdf {
    /// A surface with these normals, seen from `view` (a unit vector away from the surface).
    pub fn new(material: &Material, geometric: Vec3, shading: Vec3, view: Vec3) -> Self {
        let geometric = if geometric.dot(view) < 0.0 { -geometric } else { geometric };
        let mut normal = if shading.dot(geometric) < 0.0 { -shading } else { shading };
        // A normal that leans away from the viewer would make the near side black.
        let lacks = LEAST_COSINE - normal.dot(view);
        if lacks > 0.0 {
            normal = (normal + lacks * view).normalize_or(geometric);
        }
        Self {
            reflectance: material.reflectance,
            transmittance: material.transmittance,
            coat: Coat::new(material.roughness),
            normal,
            geometric,
        }
    }

    /// Probabilities of drawing the coat, reflection and transmission.
    fn choices(&self, view: Vec3) -> [f32; 3] {
        let coat = self.coat.map_or(0.0, |coat| coat.albedo(self.normal.dot(view)));
        let below = 1.0 - coat;
        let weights = [
            coat,
            below * luminance(self.reflectance.to_array()),
            below * luminance(self.transmittance.to_array()),
        ];
        let total: f32 = weights.iter().sum();
        if total > 0.0 { weights.map(|weight| weight / total) } else { [0.0, 1.0, 0.0] }
    }

    /// Light from `light` to `view`, both unit vectors away from the surface.
    pub fn evaluate(&self, view: Vec3, light: Vec3) -> Scatter {
        let none = Scatter { value: Vec3::ZERO, pdf: 0.0 };
        let (cos_view, cos_light) = (self.normal.dot(view), self.normal.dot(light));
        let side = self.geometric.dot(light);
        if side == 0.0 || cos_view <= 0.0 {
            return none;
        }
        let [coat_chance, reflect_chance, transmit_chance] = self.choices(view);
        let density = cos_light.abs() / PI;
        let passes = self.coat.map_or(1.0, |coat| coat.passes(cos_view, cos_light.abs()));
        if side < 0.0 {
            let value = self.transmittance * (passes * density);
            return Scatter { value, pdf: transmit_chance * density };
        }
        let mut value = self.reflectance * (passes * density);
        let mut pdf = reflect_chance * density;
        if let (Some(coat), true) = (&self.coat, cos_light > 0.0) {
            let lobe = coat.evaluate(self.normal, view, light);
            value += lobe.value;
            pdf += coat_chance * lobe.pdf;
        }
        Scatter { value, pdf }
    }

    /// Draws a direction from three uniform numbers.
    pub fn sample(&self, view: Vec3, u: [f32; 3]) -> Option<BsdfSample> {
        let [coat_chance, reflect_chance, _] = self.choices(view);
        let facet = self.coat.filter(|_| u[2] < coat_chance);
        let direction = if let Some(coat) = facet {
            let half = coat.visible_facet(self.normal, view, [u[0], u[1]]);
            2.0 * view.dot(half) * half - view
        } else {
            // The direction or its opposite, whichever lies on the side that is wanted.
            let either = cosine_direction(self.normal, [u[0], u[1]]);
            let is_above = self.geometric.dot(either) > 0.0;
            if is_above == (u[2] < coat_chance + reflect_chance) { either } else { -either }
        };
        let lowest = self.geometric.dot(direction).min(self.normal.dot(direction));
        if facet.is_some() && lowest <= 0.0 {
            return None;
        }
        let Scatter { value, pdf } = self.evaluate(view, direction);
        (pdf > 0.0).then(|| BsdfSample { direction, weight: value / pdf, pdf })
    }
}

/// A direction around `normal` with a density of cosine over π.
fn cosine_direction(normal: Vec3, u: [f32; 2]) -> Vec3 {
    let (x, y) = normal.any_orthonormal_pair();
    let radius = u[0].sqrt();
    let (sin, cos) = libm::sincosf(TAU * u[1]);
    let up = (1.0 - u[0]).max(0.0).sqrt();
    (radius * (cos * x + sin * y) + up * normal).normalize_or(normal)
}

/// A direction anywhere, uniformly.
pub(crate) fn any_direction(u: [f32; 2]) -> Vec3 {
    let z = 1.0 - 2.0 * u[0];
    let across = (1.0 - z * z).max(0.0).sqrt();
    let (sin, cos) = libm::sincosf(TAU * u[1]);
    Vec3::new(across * cos, across * sin, z)
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Seed, seed::Stream};

    fn leaf(reflectance: f32, transmittance: f32, roughness: f32) -> Bsdf {
        seen_from(Vec3::Z, reflectance, transmittance, roughness)
    }

    fn seen_from(view: Vec3, reflectance: f32, transmittance: f32, roughness: f32) -> Bsdf {
        let material = Material {
            reflectance: Vec3::splat(reflectance),
            transmittance: Vec3::splat(transmittance),
            emission: Vec3::ZERO,
            roughness,
            variation: 0.0,
            is_ground: false,
            texture: None,
            species: 0,
        };
        Bsdf::new(&material, Vec3::Z, Vec3::Z, view)
    }

    #[test]
    fn a_surface_with_a_bent_normal_returns_what_a_flat_one_does() {
        for degrees in [5.0, 20.0, 40.0] {
            let bent = view_at(degrees);
            let view = Vec3::new(0.2, 0.5, 0.8).normalize();
            for (reflectance, transmittance) in [(0.5, 0.5), (0.7, 0.1)] {
                let bsdf = Bsdf { normal: bent, ..leaf(reflectance, transmittance, 1.0) };
                let got = albedo(&bsdf, view);
                assert!((got - reflectance - transmittance).abs() < 1e-3, "{degrees}°: {got}");
            }
        }
    }

    fn numbers(chance: &mut Stream) -> [f32; 3] {
        [0; 3].map(|_| chance.unit() as f32)
    }

    fn view_at(degrees: f32) -> Vec3 {
        Vec3::new(degrees.to_radians().sin(), 0.0, degrees.to_radians().cos())
    }

    /// Mean weight of drawn directions: the part of the light that is not absorbed.
    fn albedo(bsdf: &Bsdf, view: Vec3) -> f32 {
        let mut chance = Seed(1).stream("albedo", 0);
        let n = 40_000;
        let weight = |u| bsdf.sample(view, u).map_or(0.0, |sample| sample.weight.x);
        (0..n).map(|_| weight(numbers(&mut chance))).sum::<f32>() / n as f32
    }

    #[test]
    fn a_matt_leaf_returns_exactly_what_it_reflects_and_transmits() {
        for (reflectance, transmittance) in [(0.5, 0.5), (0.1, 0.3), (1.0, 0.0)] {
            let got = albedo(&leaf(reflectance, transmittance, 1.0), view_at(30.0));
            assert!((got - reflectance - transmittance).abs() < 1e-3, "{got}");
        }
    }

    #[test]
    fn a_coated_leaf_that_absorbs_nothing_returns_all_light_at_every_angle() {
        for roughness in [0.05, 0.17, 0.3, 0.45, 0.6, 0.75, 0.9] {
            for degrees in [0.0, 20.0, 45.0, 60.0, 70.0, 80.0, 85.0, 88.0, 89.5] {
                for (reflectance, transmittance) in [(0.6, 0.4), (1.0, 0.0)] {
                    let view = view_at(degrees);
                    let got = albedo(&seen_from(view, reflectance, transmittance, roughness), view);
                    assert!((got - 1.0).abs() < 0.01, "{roughness} at {degrees}° returns {got}");
                }
            }
        }
    }

    #[test]
    fn a_coat_hides_what_absorbs_below_it_but_never_makes_light() {
        for roughness in [0.1, 0.5, 0.9] {
            let mut last = 0.0;
            for degrees in [0.0, 60.0, 75.0, 85.0] {
                let view = view_at(degrees);
                let got = albedo(&seen_from(view, 0.1, 0.1, roughness), view);
                assert!(got > last - 0.01 && got < 1.0, "{roughness} at {degrees}°: {got}");
                last = got;
            }
        }
    }

    #[test]
    fn light_runs_the_same_way_backwards() {
        let mut chance = Seed(2).stream("reciprocity", 0);
        for number in 0..3000 {
            let bsdf = leaf(0.3, 0.2, [0.12, 0.4, 0.85, 1.0][number % 4]);
            let mut up = || cosine_direction(Vec3::Z, [0; 2].map(|_| chance.unit() as f32));
            let (view, light) = (up(), up());
            let there = bsdf.evaluate(view, light).value.x / light.z;
            let back = bsdf.evaluate(light, view).value.x / view.z;
            assert!((there - back).abs() < 2e-3 * there.max(1.0), "{there} {back}");
            // Through the leaf, the viewer stands on the other side on the way back.
            let there = bsdf.evaluate(view, -light).value.x / light.z;
            let back = bsdf.evaluate(light, -view).value.x / view.z;
            assert!((there - back).abs() < 1e-4 && there > 0.0, "{there} {back}");
        }
    }

    #[test]
    fn the_density_of_directions_is_what_it_is_said_to_be() {
        // χ² over cells of equal area of the sphere, expected counts by fine integration.
        let (rows, columns, draws) = (10, 12, 60_000);
        let bent = Bsdf { normal: view_at(-25.0), ..leaf(0.4, 0.3, 0.5) };
        for bsdf in [leaf(0.4, 0.3, 1.0), leaf(0.4, 0.0, 0.5), leaf(0.2, 0.3, 0.35), bent] {
            let view = view_at(50.0);
            let mut expected = vec![0.0f64; rows * columns];
            let fine = 24;
            for (cell, sum) in expected.iter_mut().enumerate() {
                for i in 0..fine * fine {
                    let part = |k: usize| (k as f32 + 0.5) / fine as f32;
                    let v = (cell / columns) as f32 + part(i / fine);
                    let u = (cell % columns) as f32 + part(i % fine);
                    let direction = any_direction([v / rows as f32, u / columns as f32]);
                    let area = 4.0 * std::f64::consts::PI / (rows * columns * fine * fine) as f64;
                    *sum += f64::from(bsdf.evaluate(view, direction).pdf) * area;
                }
            }
            let mut counts = vec![0u32; rows * columns];
            let mut chance = Seed(3).stream("chi", 0);
            for _ in 0..draws {
                if let Some(sample) = bsdf.sample(view, numbers(&mut chance)) {
                    let row = ((1.0 - sample.direction.z) / 2.0 * rows as f32) as usize;
                    let turn = sample.direction.y.atan2(sample.direction.x) / TAU;
                    let column = ((turn + 1.0) % 1.0 * columns as f32) as usize;
                    counts[row.min(rows - 1) * columns + column.min(columns - 1)] += 1;
                }
            }
            let (mut chi, mut freedom) = (0.0, 0);
            for (&count, &share) in counts.iter().zip(&expected) {
                let mean = share * f64::from(draws);
                if mean > 5.0 {
                    chi += (f64::from(count) - mean).powi(2) / mean;
                    freedom += 1;
                }
            }
            // Five standard deviations of χ² above its mean.
            let limit = f64::from(freedom) + 5.0 * (2.0 * f64::from(freedom)).sqrt();
            assert!(chi < limit, "χ² {chi} of {freedom} cells");
        }
    }
}
