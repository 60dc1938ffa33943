//! Still water: a smooth surface over a cloudy medium.
//!
//! The surface reflects and refracts by Fresnel's equations. Below it light is absorbed and
//! scattered by a homogeneous medium, which gives depth its colour. Seen from the eye, light is
//! refracted; on its way between the bed and sun or sky it crosses the surface in a straight
//! line and is only attenuated ([Deussen98] §6 treats shadow rays through leaves alike), since
//! refracted connections to a light cannot be drawn.

use glam::Vec3;
use weald_contract::Seed;

/// Refractive index of fresh water against air [QF95].
const INDEX: f32 = 1.333;

/// Extinction of pond water, 1/m: a white disc vanishes at about two metres, as in ponds rich in
/// plankton [Kirk11] ch. 3.
pub(crate) const EXTINCTION: f32 = 1.4;

/// Part of the extinguished light that is scattered: green survives best between plankton's
/// absorption of blue and water's own of red. Deep water then returns 1 to 3 % of the light, as
/// natural waters do [Kirk11] ch. 6.
pub(crate) const SCATTERING_ALBEDO: Vec3 = Vec3::new(0.15, 0.19, 0.10);

/// Ripples that a light breeze makes: a sum of sine waves.
pub(crate) struct Ripples {
    /// Wave vector, 1/m, phase and amplitude of the slope.
    waves: Vec<([f32; 2], f32, f32)>,
}

/// Slope that a single wave adds, from the smallest to the longest wave.
const WAVE_SLOPE: f32 = 0.006;

impl Ripples {
    /// Waves of 6 cm to 1.6 m that run about the same way.
    pub fn new() -> Self {
        let mut chance = Seed(1998).stream("ripples", 0);
        let wave = |number: i32| {
            let length = 0.06 * libm::powf(1.5, number as f32);
            let heading = chance.around(0.6, 1.1) as f32;
            let number = std::f32::consts::TAU / length;
            let phase = chance.range(0.0, std::f64::consts::TAU) as f32;
            let vector = [number * libm::cosf(heading), number * libm::sinf(heading)];
            (vector, phase, WAVE_SLOPE)
        };
        Self { waves: (0..9).map(wave).collect() }
    }

    /// Roughness of a Beckmann distribution of facets with the slopes of the ripples: the root of
    /// their mean square [Beckmann63], that of gusts taken over the whole surface.
    pub fn roughness(&self) -> f32 {
        let side = 200;
        let square = |i: usize| {
            // Steps that no wave is a multiple of.
            let n = self.normal(0.37 * (i % side) as f32, 0.53 * (i / side) as f32);
            (n.x * n.x + n.y * n.y) / (n.z * n.z)
        };
        let sum: f32 = (0..side * side).map(square).sum();
        (sum / (side * side) as f32).sqrt()
    }

    /// Unit normal of the rippled surface at a place.
    pub fn normal(&self, x: f32, y: f32) -> Vec3 {
        // Ripples come in patches: gusts touch the water here and not there.
        let gust = 0.35
            + 0.65
                * crate::noise::smoothstep(-0.3, 0.5, crate::noise::cloudy(x / 9.0, y / 9.0, 77));
        let slope = |sum: [f32; 2], &(vector, phase, amplitude): &([f32; 2], f32, f32)| {
            let height = libm::cosf(vector[0] * x + vector[1] * y + phase);
            let along =
                gust * amplitude * height / (vector[0] * vector[0] + vector[1] * vector[1]).sqrt();
            [sum[0] + along * vector[0], sum[1] + along * vector[1]]
        };
        let [sx, sy] = self.waves.iter().fold([0.0; 2], slope);
        Vec3::new(-sx, -sy, 1.0).normalize()
    }
}

/// Fresnel reflectance of unpolarised light that meets the surface at `cos` from air
/// (`from_below` = false) or from water; 1 at total reflection.
pub(crate) fn reflectance(cos: f32, from_below: bool) -> f32 {
    let ratio = if from_below { INDEX } else { 1.0 / INDEX };
    let cos = cos.clamp(0.0, 1.0);
    let sin2 = ratio * ratio * (1.0 - cos * cos);
    if sin2 >= 1.0 {
        return 1.0;
    }
    let inner = (1.0 - sin2).sqrt();
    let across = (ratio * cos - inner) / (ratio * cos + inner);
    let along = (cos - ratio * inner) / (cos + ratio * inner);
    0.5 * (across * across + along * along)
}

/// Direction after refraction of unit `direction` at `normal`, which points against it; `None`
/// at total reflection.
pub(crate) fn refract(direction: Vec3, normal: Vec3, from_below: bool) -> Option<Vec3> {
    let ratio = if from_below { INDEX } else { 1.0 / INDEX };
    let cos = -direction.dot(normal);
    let sin2 = ratio * ratio * (1.0 - cos * cos);
    (sin2 < 1.0)
        .then(|| (ratio * direction + (ratio * cos - (1.0 - sin2).sqrt()) * normal).normalize())
}

/// Part of the light that is left after a straight way of `distance` under water.
pub(crate) fn transmittance(distance: f32) -> f32 {
    libm::expf(-EXTINCTION * distance.max(0.0))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn water_reflects_two_percent_straight_down_and_all_at_grazing_incidence() {
        // ((n - 1) / (n + 1))² = 0.0204 for n = 1.333.
        assert!((reflectance(1.0, false) - 0.0204).abs() < 1e-4);
        assert!((reflectance(1.0, true) - 0.0204).abs() < 1e-4);
        assert!(reflectance(0.0, false) > 0.999);
        // The critical angle is asin(1 / 1.333) = 48.6°.
        assert_eq!(reflectance(49f32.to_radians().cos(), true), 1.0);
        assert!(reflectance(48f32.to_radians().cos(), true) < 0.9);
    }

    #[test]
    fn refraction_obeys_snell_and_runs_backwards() {
        let down = Vec3::new(0.6, 0.0, -0.8);
        let inside = refract(down, Vec3::Z, false).unwrap();
        assert!((inside.x * INDEX - 0.6).abs() < 1e-5);
        let back = refract(-inside, -Vec3::Z, true).unwrap();
        assert!(back.abs_diff_eq(-down, 1e-5));
    }

    #[test]
    fn ripples_are_gentle() {
        let ripples = Ripples::new();
        for i in 0..1000 {
            let normal = ripples.normal(i as f32 * 0.13, i as f32 * 0.29);
            assert!(normal.z > 0.99 && (normal.length() - 1.0).abs() < 1e-5);
        }
    }
}
