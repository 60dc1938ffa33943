//! The thin glossy coat of leaves: what it reflects, and what it lets through.
//!
//! A coat is a layer of GGX microfacets [Walter07] with the Fresnel reflectance of cuticle (0.04
//! at normal incidence [Woolley71], an index of 1.5). What it does not reflect comes back from the diffuse leaf
//! below, in proportion to what the coat lets through on the way in and on the way out
//! [Kelemen01] §2: with E(µ) the part that the coat reflects of light from cosine µ, and Ē its
//! mean over the hemisphere, the diffuse lobe is multiplied by
//! (1 - E(µ_view)) (1 - E(µ_light)) / (1 - Ē).
//! The product is symmetric, and its integral over all light is 1 - E(µ_view): a leaf that
//! absorbs nothing returns everything, whatever the angle. Light that facets scatter among
//! themselves is thereby counted as diffuse.

use glam::Vec3;
use std::f32::consts::{PI, TAU};
use std::sync::LazyLock;

/// Roughness from which on a surface has no coat to speak of.
const MATT: f32 = 0.95;

/// Least roughness: its microfacet roughness, the square, is 0.01, a near mirror. Smoother coats
/// would make highlights that few paths find.
const SMOOTH: f32 = 0.1;

/// Refractive index of the coat: 0.04 of the light is reflected at normal incidence.
const INDEX: f32 = 1.5;

/// Least cosine for which a coat is evaluated; below it shadowing divides by nothing.
const GRAZING: f32 = 1e-4;

/// A coat of some roughness.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coat {
    /// Microfacet roughness.
    alpha: f32,
    /// Where the roughness lies between two rows of the table.
    row: usize,
    part: f32,
    /// 1 / (1 - Ē).
    gain: f32,
}

/// A value of the lobe, times the cosine of the light, and the density of drawing it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Lobe {
    pub value: f32,
    pub pdf: f32,
}

impl Coat {
    /// The coat of a surface, unless it is matt.
    pub fn new(roughness: f32) -> Option<Self> {
        (roughness < MATT).then(|| {
            let roughness = roughness.max(SMOOTH);
            let row = (roughness - SMOOTH) / (MATT - SMOOTH) * (ROWS - 1) as f32;
            let low = (row as usize).min(ROWS - 2);
            let part = row - low as f32;
            let mean = ALBEDO.means[low].lerp(ALBEDO.means[low + 1], part);
            Self { alpha: roughness * roughness, row: low, part, gain: 1.0 / (1.0 - mean) }
        })
    }

    /// Microfacet roughness.
    pub fn alpha(&self) -> f32 {
        self.alpha
    }

    /// How much the coat hides what lies below more at grazing angles (15° above the surface) than
    /// straight down, as part of what a smooth one does: 1 smooth, less where it is rough.
    pub fn fading(&self) -> f32 {
        let low = 0.26;
        (self.albedo(low) - self.albedo(1.0)) / (fresnel(low) - fresnel(1.0))
    }

    /// Part of light from everywhere above that the coat reflects.
    pub fn mean_albedo(&self) -> f32 {
        1.0 - 1.0 / self.gain
    }

    /// Part of the light from a direction that the coat reflects.
    pub fn albedo(&self, cos: f32) -> f32 {
        let column = cos.clamp(0.0, 1.0).sqrt() * (COLUMNS - 1) as f32;
        let left = (column as usize).min(COLUMNS - 2);
        let along = column - left as f32;
        let [low, high] = [&ALBEDO.table[self.row], &ALBEDO.table[self.row + 1]];
        let at = |row: &[f32; COLUMNS]| row[left].lerp(row[left + 1], along);
        at(low).lerp(at(high), self.part)
    }

    /// Factor of the diffuse lobe below the coat, see the head of this file.
    pub fn passes(&self, cos_view: f32, cos_light: f32) -> f32 {
        (1.0 - self.albedo(cos_view)) * (1.0 - self.albedo(cos_light)) * self.gain
    }

    /// Facets with height-correlated shadowing [Heitz14] eq. 99; both directions lie on the side
    /// of the normal.
    pub fn evaluate(&self, normal: Vec3, view: Vec3, light: Vec3) -> Lobe {
        let half = (view + light).normalize_or(normal);
        let (cos_view, cos_light) = (normal.dot(view).max(GRAZING), normal.dot(light));
        let cos_half = normal.dot(half);
        let a2 = self.alpha * self.alpha;
        let d = cos_half * cos_half * (a2 - 1.0) + 1.0;
        let facets = a2 / (PI * d * d);
        let reach = |cos: f32| (a2 + (1.0 - a2) * cos * cos).sqrt();
        let visible = 0.5 / (cos_light * reach(cos_view) + cos_view * reach(cos_light));
        let value = fresnel(view.dot(half)) * facets * visible * cos_light;
        // Density of visible facets over that of reflected directions [Heitz18] eq. 17.
        let masked = 2.0 / (1.0 + reach(cos_view) / cos_view);
        Lobe { value, pdf: masked * facets / (4.0 * cos_view) }
    }

    /// Draws a facet as the viewer sees them, by a spherical cap [DB23].
    pub fn visible_facet(&self, normal: Vec3, view: Vec3, u: [f32; 2]) -> Vec3 {
        let (x, y) = normal.any_orthonormal_pair();
        let local = Vec3::new(view.dot(x), view.dot(y), view.dot(normal));
        let stretched = Vec3::new(local.x * self.alpha, local.y * self.alpha, local.z).normalize();
        let (sin, cos) = libm::sincosf(TAU * u[0]);
        let z = (1.0 - u[1]) * (1.0 + stretched.z) - stretched.z;
        let across = (1.0 - z * z).clamp(0.0, 1.0).sqrt();
        let half = Vec3::new(across * cos, across * sin, z) + stretched;
        let half = Vec3::new(half.x * self.alpha, half.y * self.alpha, half.z).normalize();
        half.x * x + half.y * y + half.z * normal
    }
}

/// Fresnel reflectance of the coat for unpolarised light. The usual short form by powers of 1 - cos
/// [Schlick94] has a sixth too little at 45°, which dark leaves, half of whose light comes from the coat,
/// showed beside another renderer.
pub(crate) fn fresnel(cos: f32) -> f32 {
    let cos = cos.clamp(0.0, 1.0);
    let inner = (1.0 - (1.0 - cos * cos) / (INDEX * INDEX)).sqrt();
    let across = (cos - INDEX * inner) / (cos + INDEX * inner);
    let along = (INDEX * cos - inner) / (INDEX * cos + inner);
    0.5 * (across * across + along * along)
}

/// Rows of the table, of equal steps of roughness from [`SMOOTH`] to [`MATT`].
const ROWS: usize = 16;

/// Columns, of equal steps of the root of the cosine: the coat changes fast at grazing angles.
const COLUMNS: usize = 32;

/// Side of the square of facets whose mean is an entry of the table; a test holds how near it
/// comes to that of many more.
const FACETS: usize = 32;

/// What coats reflect of light from each direction, and on the mean over the hemisphere.
struct Albedo {
    table: [[f32; COLUMNS]; ROWS],
    means: [f32; ROWS],
}

/// Half a million facets, once in a program's life.
static ALBEDO: LazyLock<Albedo> = LazyLock::new(|| {
    let table: [[f32; COLUMNS]; ROWS] = std::array::from_fn(|row| {
        let roughness = SMOOTH + (MATT - SMOOTH) * row as f32 / (ROWS - 1) as f32;
        std::array::from_fn(|column| {
            let root = column as f32 / (COLUMNS - 1) as f32;
            reflected(roughness * roughness, root * root, FACETS)
        })
    });
    Albedo { table, means: table.map(|row| mean(&row)) }
});

/// Part of the light from a cosine that facets reflect, by the mean weight of `side` × `side`
/// visible ones.
fn reflected(alpha: f32, cos: f32, side: usize) -> f32 {
    let coat = Coat { alpha, row: 0, part: 0.0, gain: 1.0 };
    let cos = cos.max(GRAZING);
    let view = Vec3::new((1.0 - cos * cos).max(0.0).sqrt(), 0.0, cos);
    let middle = |step: usize| (step as f32 + 0.5) / side as f32;
    let weight = |number: usize| {
        let u = [middle(number / side), middle(number % side)];
        let half = coat.visible_facet(Vec3::Z, view, u);
        let light = 2.0 * view.dot(half) * half - view;
        if light.z <= 0.0 {
            return 0.0;
        }
        let lobe = coat.evaluate(Vec3::Z, view, light);
        if lobe.pdf > 0.0 { f64::from(lobe.value / lobe.pdf) } else { 0.0 }
    };
    let sum: f64 = (0..side * side).map(weight).sum();
    (sum / (side * side) as f64) as f32
}

/// 2 ∫ E(µ) µ dµ of a row that is linear in s = √µ between its entries: ∫ E 4 s³ ds, exactly,
/// so that the lobes add up to 1 with the table as it is.
fn mean(row: &[f32; COLUMNS]) -> f32 {
    let step = 1.0 / (COLUMNS - 1) as f64;
    let part = |column: usize| {
        let (s0, s1) = (column as f64 * step, (column + 1) as f64 * step);
        let (e0, e1) = (f64::from(row[column]), f64::from(row[column + 1]));
        let slope = (e1 - e0) / step;
        let moment = |power: i32| (s1.powi(power) - s0.powi(power)) / f64::from(power);
        4.0 * ((e0 - slope * s0) * moment(4) + slope * moment(5))
    };
    (0..COLUMNS - 1).map(part).sum::<f64>() as f32
}

trait Lerp {
    fn lerp(self, other: Self, part: Self) -> Self;
}

impl Lerp for f32 {
    fn lerp(self, other: f32, part: f32) -> f32 {
        self + part * (other - self)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fresnel_gives_what_is_known_at_normal_brewster_and_grazing_incidence() {
        assert!((fresnel(1.0) - 0.04).abs() < 1e-6 && fresnel(0.0) == 1.0);
        // At Brewster's angle, tan θ = n, one polarisation is gone: ((n² - 1) / (n² + 1))² / 2.
        let brewster = 1.0 / (1.0f32 + INDEX * INDEX).sqrt();
        assert!((fresnel(brewster) - 0.5 * (1.25f32 / 3.25).powi(2)).abs() < 1e-6);
    }

    #[test]
    fn a_smooth_coat_reflects_what_fresnel_says() {
        let coat = Coat::new(0.1).unwrap();
        for cos in [1.0, 0.8, 0.5, 0.3] {
            let (got, exact) = (coat.albedo(cos), fresnel(cos));
            assert!((got - exact).abs() < 0.01, "{cos}: {got}, not {exact}");
        }
        // Fresnel's mean over the hemisphere, as tables of smooth dielectrics give it.
        let mean = coat.mean_albedo();
        assert!((mean - 0.0918).abs() < 0.003, "{mean}");
    }

    #[test]
    fn the_table_holds_what_many_more_facets_reflect() {
        for roughness in [0.1f32, 0.33, 0.62, 0.95] {
            for cos in [0.0, 0.01, 0.1, 0.4, 1.0] {
                let few = reflected(roughness * roughness, cos, FACETS);
                let many = reflected(roughness * roughness, cos, 10 * FACETS);
                assert!((few - many).abs() < 0.003, "{roughness}, {cos}: {few}, not {many}");
            }
        }
    }

    #[test]
    fn matt_surfaces_have_no_coat_and_rough_ones_a_weak_one() {
        assert!(Coat::new(0.95).is_none() && Coat::new(1.0).is_none());
        let coat = Coat::new(0.9).unwrap();
        assert!(coat.albedo(1.0) < 0.05 && coat.albedo(0.0) < 1.0);
    }
}
