//! The film: what each pixel gathered, and the picture made of it.

use crate::matte::{self, RANKS, Ranked};
use crate::tone::{LUMINANCE, luminance};
use glam::Vec3;
use std::collections::BTreeMap;
use weald_contract::Picture;

/// Value of `Z` where nothing but sky is seen, m: as Blender writes it, so that compositors
/// which multiply by coverage meet no infinity.
pub const SKY_DEPTH: f32 = 1e10;

/// Names of the cryptomatte layers.
const SPECIES_MATTE: &str = "CryptoSpecies";
const PLANT_MATTE: &str = "CryptoPlant";

/// Largest radiance kept in a picture: the largest finite half-precision number.
const MAX_RADIANCE: f64 = 65504.0;

/// Sums over the samples of one pixel.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pixel {
    /// Sum of radiance.
    pub radiance: [f64; 3],
    /// The part of it that was scattered at most once.
    pub direct: [f64; 3],
    /// Sum of squares of luminance.
    pub squares: f64,
    /// Samples taken.
    pub samples: u32,
    /// Samples that met something other than sky.
    pub covered: u32,
    /// Sum of first-hit albedo over the covered samples.
    pub albedo: [f64; 3],
    /// Sum of first-hit shading normals.
    pub normal: [f64; 3],
    /// Distance along the view axis and position of the nearest first hit.
    pub nearest: Option<(f32, [f32; 3])>,
    /// Species and plant that most samples saw; 0 and 0 when that is the sky or no plant.
    pub majority: (u32, u64),
    /// Hashes of species and of plants, with the samples that saw them.
    pub species: Ranked<u32>,
    pub plants: Ranked<u32>,
}

impl Pixel {
    /// Adds the light of a sample, of which `direct` was scattered at most once.
    pub fn add_light(&mut self, light: Vec3, direct: Vec3) {
        for axis in 0..3 {
            self.radiance[axis] += f64::from(light[axis]);
            self.direct[axis] += f64::from(direct[axis]);
        }
        self.squares += f64::from(luminance(light.to_array())).powi(2);
    }

    /// Sum of luminance.
    pub fn brightness(&self) -> f64 {
        let [r, g, b] = LUMINANCE.map(f64::from);
        r * self.radiance[0] + g * self.radiance[1] + b * self.radiance[2]
    }

    /// Variance of the mean luminance, were the samples independent; 0 of fewer than two.
    /// Samples are spread better than chance, so the true variance is smaller.
    pub fn variance(&self) -> f64 {
        let n = f64::from(self.samples);
        if self.samples < 2 {
            return 0.0;
        }
        (self.squares - self.brightness().powi(2) / n).max(0.0) / (n * (n - 1.0))
    }
}

/// Names behind the hashes of a picture.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Names {
    pub species: BTreeMap<u32, String>,
    pub plants: BTreeMap<u32, String>,
}

/// What a rendering counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct FilmStatistics {
    /// Pixels times samples.
    pub samples: u64,
    /// Rays traced: towards surfaces, sun and sky.
    pub rays: u64,
}

/// A rendered view.
#[derive(Clone, Debug)]
pub struct Film {
    pub(crate) width: usize,
    pub(crate) height: usize,
    pub(crate) pixels: Vec<Pixel>,
    /// Names of species and of plants in the picture, by their hashes.
    pub(crate) names: Names,
    pub(crate) statistics: FilmStatistics,
}

impl Film {
    /// What was counted.
    pub fn statistics(&self) -> FilmStatistics {
        self.statistics
    }

    /// The picture.
    ///
    /// Channels: `R G B` (linear Rec. 709, luminance in kcd/m², at most 65504), `A` (part of the
    /// pixel that is not sky), `Z` (distance along the view axis of the nearest thing seen, m;
    /// 1e10 for sky), `albedo.R/G/B`, `normal.X/Y/Z` (means over the part that is not sky),
    /// `position.X/Y/Z` (scene coordinates; Z is the altitude; the place `Z` belongs to),
    /// `species` and `plant` (of the majority; 0 where there is no plant; plant numbers modulo
    /// 2²⁴, the largest whole number a float counts to), `samples`, `direct.R/G/B` (the part of
    /// `R G B` that comes straight from a light or was scattered once), `indirect.R/G/B` (the
    /// rest), `variance` (of the luminance `R G B` has, (kcd/m²)²; an upper bound), and the
    /// cryptomattes `CryptoSpecies00` to `02` and `CryptoPlant00` to `02`, whose names stand in
    /// the picture's attributes.
    pub fn picture(&self) -> Picture {
        let mut picture = Picture::new(self.width, self.height);
        let mut add = |name: &str, is_exact: bool, value: &dyn Fn(&Pixel) -> f32| {
            picture.add(name, is_exact, self.pixels.iter().map(value).collect());
        };
        for (index, name) in ["R", "G", "B"].into_iter().enumerate() {
            add(name, false, &|pixel| mean(pixel.radiance[index], pixel.samples));
        }
        add("A", false, &|pixel| mean(f64::from(pixel.covered), pixel.samples));
        add("Z", true, &|pixel| pixel.nearest.map_or(SKY_DEPTH, |(depth, _)| depth));
        for (index, name) in ["albedo.R", "albedo.G", "albedo.B"].into_iter().enumerate() {
            add(name, false, &|pixel| mean(pixel.albedo[index], pixel.covered));
        }
        for (index, name) in ["normal.X", "normal.Y", "normal.Z"].into_iter().enumerate() {
            add(name, false, &|pixel| mean(pixel.normal[index], pixel.covered));
        }
        for (index, name) in ["position.X", "position.Y", "position.Z"].into_iter().enumerate() {
            add(name, true, &|pixel| pixel.nearest.map_or(0.0, |(_, position)| position[index]));
        }
        add("species", true, &|pixel| pixel.majority.0 as f32);
        add("plant", true, &|pixel| (pixel.majority.1 & 0xff_ffff) as f32);
        add("samples", true, &|pixel| pixel.samples as f32);
        for (index, name) in ["direct.R", "direct.G", "direct.B"].into_iter().enumerate() {
            add(name, false, &|pixel| mean(pixel.direct[index], pixel.samples));
        }
        for (index, name) in ["indirect.R", "indirect.G", "indirect.B"].into_iter().enumerate() {
            let indirect = |pixel: &Pixel| pixel.radiance[index] - pixel.direct[index];
            add(name, false, &|pixel| mean(indirect(pixel), pixel.samples));
        }
        add("variance", true, &|pixel| pixel.variance() as f32);
        for rank in 0..RANKS {
            // Two things to a layer of four channels: hash and share, hash and share.
            let parts = if rank % 2 == 0 { ["R", "G"] } else { ["B", "A"] };
            for layer in [SPECIES_MATTE, PLANT_MATTE] {
                let ranked = |pixel: &Pixel| {
                    if layer == SPECIES_MATTE { pixel.species } else { pixel.plants }
                };
                let [hash, share] = parts.map(|part| format!("{layer}{:02}.{part}", rank / 2));
                add(&hash, true, &|pixel| f32::from_bits(ranked(pixel)[rank].0));
                add(&share, true, &|pixel| mean(f64::from(ranked(pixel)[rank].1), pixel.samples));
            }
        }
        picture.attributes.extend(matte::attributes(SPECIES_MATTE, &self.names.species));
        picture.attributes.extend(matte::attributes(PLANT_MATTE, &self.names.plants));
        picture
    }
}

/// Mean of a sum, 0 of nothing, within what half precision holds.
fn mean(sum: f64, count: u32) -> f32 {
    if count == 0 {
        return 0.0;
    }
    (sum / f64::from(count)).clamp(-MAX_RADIANCE, MAX_RADIANCE) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_variance_is_that_of_the_mean_of_independent_samples() {
        let mut pixel = Pixel::default();
        for grey in [1.0, 2.0, 3.0, 6.0] {
            pixel.samples += 1;
            pixel.add_light(Vec3::splat(grey), Vec3::ZERO);
        }
        // Squared deviations from the mean of 3 add up to 14; 14 / (4 - 1) / 4.
        assert!((pixel.variance() - 14.0 / 12.0).abs() < 1e-6, "{}", pixel.variance());
        assert_eq!(Pixel { samples: 1, ..pixel }.variance(), 0.0);
    }

    #[test]
    fn a_pixel_that_saw_only_sky_is_transparent_and_far() {
        let pixel = Pixel { radiance: [2.0, 4.0, 8.0], samples: 2, ..Pixel::default() };
        let film = Film {
            width: 1,
            height: 1,
            pixels: vec![pixel],
            names: Names::default(),
            statistics: Default::default(),
        };
        let picture = film.picture();
        assert_eq!(picture.channel("G"), Some(&[2.0][..]));
        assert_eq!(picture.channel("A"), Some(&[0.0][..]));
        assert_eq!(picture.channel("Z"), Some(&[SKY_DEPTH][..]));
    }
}
