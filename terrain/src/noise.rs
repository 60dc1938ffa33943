//! Noise synthesis: octaves of Perlin noise in metres [Perlin02], [Musgrave89].
//!
//! Each octave is a level slice through three-dimensional Perlin noise, halfway between lattice
//! planes, because the two-dimensional kind has only four gradients, all of them diagonal, and
//! vanishes at every lattice point; octaves are turned against each other to hide the rest of
//! the lattice. A grid takes the octaves it can show: one whose wavelength falls below four cells
//! fades out, and is gone at two (the sampling limit). A finer grid therefore shows the same
//! ground with more detail, and not another ground.

use crate::spline::smoothstep;
use noise::{NoiseFn, Perlin};
use weald_contract::words;

words! {
    /// Character of noise.
    pub enum NoiseKind {
        /// Rolling: fractional Brownian motion, the plain sum.
        Fbm = "fbm",
        /// Sharp crests and round hollows.
        Ridged = "ridged",
        /// Round hummocks and sharp furrows.
        Billow = "billow",
    }
}

/// What noise looks like, at amplitude 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct NoiseShape {
    /// Character.
    pub kind: NoiseKind,
    /// Wavelength of the largest octave, m.
    pub wavelength: f64,
    /// Number of octaves.
    pub octaves: u32,
    /// Amplitude of an octave relative to the one before.
    pub roughness: f64,
    /// How much roughness varies: by factors of up to 2 to this power.
    pub roughness_change: f64,
    /// Wavelength of an octave relative to the next.
    pub lacunarity: f64,
    /// How far the noise is dragged out of place, m: bound of each coordinate's shift.
    pub warp: f64,
}

/// Mean of |Perlin noise| on the slices used here, over 10⁷ points and twelve permutation tables
/// (0.253 to 0.283); ridges and billows are centred on it, so that on the whole they move the
/// ground neither up nor down.
const MEAN_ABSOLUTE: f64 = 0.267;

/// Angle between successive octaves: the golden angle never repeats.
const TURN: f64 = 2.399_963_229_728_653;

/// Wavelength of the variation of roughness, relative to the largest octave's.
const ROUGHNESS_WAVELENGTH: f64 = 4.0;

/// Noise on grids of one cell size, in [-1, 1] but for the variation of roughness.
#[derive(Clone, Debug)]
pub struct Fractal {
    perlin: Perlin,
    shape: NoiseShape,
    octaves: Vec<Octave>,
    /// One over the sum of all octaves' amplitudes, those not shown included.
    scale: f64,
}

#[derive(Clone, Copy, Debug)]
struct Octave {
    /// Waves per metre, along the turned axes.
    cos: f64,
    sin: f64,
    /// Slice of the three-dimensional noise.
    plane: f64,
    /// How much of the octave a grid of this cell size can show, 0 to 1.
    shown: f64,
}

impl Fractal {
    /// Noise of a shape, for a grid with cells of `cell` metres (0 for all octaves in full).
    pub fn new(shape: NoiseShape, seed: u32, cell: f64) -> Self {
        let mut octaves = Vec::new();
        let (mut wavelength, mut amplitude, mut sum) = (shape.wavelength, 1.0, 0.0);
        for index in 0..shape.octaves {
            sum += amplitude;
            let (sin, cos) = libm::sincos(f64::from(index) * TURN);
            octaves.push(Octave {
                cos: cos / wavelength,
                sin: sin / wavelength,
                plane: f64::from(index) * 7.0 + 0.5,
                shown: smoothstep(2.0 * cell, 4.0 * cell, wavelength),
            });
            wavelength /= shape.lacunarity;
            amplitude *= shape.roughness;
        }
        octaves.retain(|octave| octave.shown > 0.0);
        Self { perlin: Perlin::new(seed), shape, octaves, scale: 1.0 / sum }
    }

    /// The value at a point, `x` and `y` in metres.
    pub fn at(&self, x: f64, y: f64) -> f64 {
        let (x, y) = self.warped(x, y);
        let gain = self.roughness_at(x, y);
        let (mut sum, mut amplitude) = (0.0, 1.0);
        for octave in &self.octaves {
            let u = octave.cos * x - octave.sin * y;
            let v = octave.sin * x + octave.cos * y;
            let wave = self.perlin.get([u, v, octave.plane]);
            sum += amplitude * octave.shown * self.character(wave);
            amplitude *= gain;
        }
        sum * self.scale
    }

    /// Where the value of a point is taken: another noise of the largest octave's wavelength drags
    /// it, so that ridges bend and crowd.
    fn warped(&self, x: f64, y: f64) -> (f64, f64) {
        let NoiseShape { warp, wavelength, .. } = self.shape;
        if warp == 0.0 {
            return (x, y);
        }
        let shift = |plane: f64| warp * self.perlin.get([x / wavelength, y / wavelength, plane]);
        (x + shift(-17.5), y + shift(-27.5))
    }

    fn character(&self, wave: f64) -> f64 {
        match self.shape.kind {
            NoiseKind::Fbm => wave,
            NoiseKind::Ridged => (MEAN_ABSOLUTE - wave.abs()) / (1.0 - MEAN_ABSOLUTE),
            NoiseKind::Billow => (wave.abs() - MEAN_ABSOLUTE) / (1.0 - MEAN_ABSOLUTE),
        }
    }

    /// Roughness itself follows a slow noise: "the rate of change in roughness across the surface
    /// of the terrain" [Deussen98, §3].
    fn roughness_at(&self, x: f64, y: f64) -> f64 {
        if self.shape.roughness_change == 0.0 {
            return self.shape.roughness;
        }
        let slow = 1.0 / (ROUGHNESS_WAVELENGTH * self.shape.wavelength);
        let change = self.perlin.get([x * slow, y * slow, -7.5]);
        (self.shape.roughness * libm::exp2(self.shape.roughness_change * change)).min(1.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPE: NoiseShape = NoiseShape {
        kind: NoiseKind::Fbm,
        wavelength: 32.0,
        octaves: 6,
        roughness: 0.5,
        roughness_change: 0.0,
        lacunarity: 2.0,
        warp: 0.0,
    };

    /// Values on a sloping walk that meets no lattice twice.
    fn walk(noise: &Fractal, count: usize) -> Vec<f64> {
        (0..count).map(|i| i as f64).map(|i| noise.at(i * 1.713, i * 2.347)).collect()
    }

    fn mean(values: &[f64]) -> f64 {
        values.iter().sum::<f64>() / values.len() as f64
    }

    #[test]
    fn every_kind_of_noise_has_mean_zero_and_stays_within_one() {
        for kind in [NoiseKind::Fbm, NoiseKind::Ridged, NoiseKind::Billow] {
            let one_octave = NoiseShape { kind, octaves: 1, ..SHAPE };
            let values = walk(&Fractal::new(one_octave, 7, 0.0), 400_000);
            // Permutation tables differ by this much.
            assert!(mean(&values).abs() < 0.025, "{kind:?}: {}", mean(&values));
            assert!(values.iter().all(|v| v.abs() <= 1.0));
        }
    }

    #[test]
    fn a_finer_grid_shows_the_same_ground_with_more_detail() {
        let (coarse, fine) = (Fractal::new(SHAPE, 7, 1.0), Fractal::new(SHAPE, 7, 0.25));
        let differences: Vec<f64> =
            walk(&coarse, 20_000).iter().zip(walk(&fine, 20_000)).map(|(a, b)| b - a).collect();
        // At 1 m the octaves of 32 to 4 m are complete, 2 m and below are missing: 1/16 + 1/32 of
        // the first amplitude, over the sum 63/32 of all.
        let bound = (1.0 / 16.0 + 1.0 / 32.0) / (63.0 / 32.0);
        assert!(differences.iter().all(|d| d.abs() <= bound));
        assert!(differences.iter().any(|d| d.abs() > 0.1 * bound));
    }

    #[test]
    fn roughness_change_makes_some_places_smoother_than_others() {
        let rough = |noise: &Fractal, x: f64| {
            let steps = (0..200).map(|i| x + f64::from(i) * 0.5);
            steps.map(|x| (noise.at(x + 0.5, 9.0) - noise.at(x, 9.0)).abs()).sum::<f64>()
        };
        let spread = |change: f64| {
            let noise = Fractal::new(NoiseShape { roughness_change: change, ..SHAPE }, 3, 0.0);
            let roughs: Vec<f64> = (0..60).map(|i| rough(&noise, f64::from(i) * 97.0)).collect();
            let low = roughs.iter().copied().fold(f64::MAX, f64::min);
            roughs.iter().copied().fold(0.0, f64::max) / low
        };
        assert!(spread(3.0) > 1.5 * spread(0.0));
    }

    #[test]
    fn warped_noise_is_the_plain_one_moved_by_no_more_than_its_bound() {
        let plain = Fractal::new(NoiseShape { octaves: 1, ..SHAPE }, 7, 0.0);
        let warped = Fractal::new(NoiseShape { octaves: 1, warp: 12.0, ..SHAPE }, 7, 0.0);
        let mut furthest = 0.0f64;
        for i in 0..2000 {
            let (x, y) = (f64::from(i) * 1.713, f64::from(i) * 2.347);
            let (u, v) = warped.warped(x, y);
            assert_eq!(warped.at(x, y), plain.at(u, v));
            furthest = furthest.max((u - x).abs()).max((v - y).abs());
        }
        assert!(furthest > 4.0 && furthest <= 12.0, "{furthest}");
    }

    #[test]
    fn golden_values_guard_the_noise_crate() {
        let noise = Fractal::new(SHAPE, 7, 0.0);
        let golden: [f64; 3] = [-0.009164289987136916, -0.2709764028164235, -0.20120027202947424];
        for (value, (x, y)) in golden.iter().zip([(0.0, 0.0), (12.5, 99.0), (-40.0, 3.25)]) {
            assert_eq!(noise.at(x, y), *value);
        }
    }
}
