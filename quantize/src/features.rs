//! The space in which plants are compared: few numbers in which equal steps look alike.
//!
//! [Deussen98] asks for parameters made perceptually linear, as size is no linear function of
//! age. Three numbers describe a plant here. Instances are scaled to the height of their plant,
//! so what remains visible is a difference of form:
//!
//! - **maturity**: the square root of the height that a vigorous plant has at this age, as a part
//!   of the final one. The curve of growth makes decades of an old tree count as little as they
//!   change it; the root lies between absolute differences, which would lump all saplings
//!   together, and relative ones, which would spend the palette on seedlings;
//! - **vigor**, at half the weight: it moves height by less than half and thins the crown;
//! - **stature**: the logarithm of height over the height that age and vigor explain. It is 0
//!   throughout where a population follows the allometry, and then adds nothing.

use crate::Weights;
use std::f64::consts::PI;
use weald_contract::{Plant, Size};

/// Numbers a plant.
pub(crate) const COUNT: usize = 3;

/// Vigor's share against maturity, both of which run from 0 to 1.
const VIGOR_SCALE: f64 = 0.5;

/// A plant of twice the expected height is as far off as one of `STATURE_SCALE * ln 2` less
/// maturity: about a quarter of the way from seed to full size.
const STATURE_SCALE: f64 = 0.35;

/// Statures beyond this factor either way are treated alike: they come from plants of nearly no
/// height, whose ratio means nothing.
const LARGEST_STATURE: f32 = 8.0;

/// Lowest height that is modelled, m: a model of height 0 could not be scaled.
pub(crate) const LEAST_HEIGHT: f32 = 0.001;

/// What quantization looks at in a plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Traits {
    /// Years.
    pub age: f32,
    /// In [0, 1].
    pub vigor: f32,
    /// Height, m.
    pub height: f32,
    /// Crown radius, m.
    pub radius: f32,
}

impl Traits {
    pub fn of_plant(plant: &Plant) -> Self {
        let Plant { age, vigor, height, radius, .. } = *plant;
        Self { age, vigor, height, radius }
    }

    /// A plant of this age and vigor that follows its species' allometry.
    pub fn of_age(size: &Size, age: f32, vigor: f32) -> Self {
        let height = size.height_at(age, vigor);
        Self { age, vigor, height, radius: size.radius_of_height(height) }
    }

    /// The plant's place in the space of comparison.
    pub fn features(&self, size: &Size) -> [f64; COUNT] {
        let maturity = size.height_at(self.age, 1.0) / size.height;
        let expected = size.height_at(self.age, self.vigor).max(LEAST_HEIGHT);
        let stature = self.height.max(LEAST_HEIGHT) / expected;
        let stature = stature.clamp(1.0 / LARGEST_STATURE, LARGEST_STATURE);
        // The population stores heights in f32: below this step, stature is their rounding.
        let stature = if (stature - 1.0).abs() < 1e-5 { 1.0 } else { stature };
        [
            f64::from(maturity).sqrt(),
            f64::from(self.vigor) * VIGOR_SCALE,
            libm::log(f64::from(stature)) * STATURE_SCALE,
        ]
    }

    /// How much such a plant counts that is seen `seen` times, and whose inverse squared distances
    /// from the eye sum to `nearness`.
    ///
    /// Seen from afar, a crown fills an angle of its area over the squared distance.
    pub fn weight(&self, weights: Weights, seen: f64, nearness: f64) -> f64 {
        let area = PI * f64::from(self.radius).powi(2);
        match weights {
            Weights::Area => area * seen,
            Weights::Uniform => seen,
            Weights::View => area * nearness,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn oak() -> Size {
        let value = Value::parse(0, "height = 20\ncrown_radius = 6").unwrap();
        Size::from_toml(&value, &mut Vec::new()).unwrap()
    }

    #[test]
    fn a_decade_counts_for_a_sapling_and_hardly_for_an_old_tree() {
        let oak = oak();
        let maturity = |age| Traits::of_age(&oak, age, 0.7).features(&oak)[0];
        assert!(maturity(12.0) - maturity(2.0) > 0.3);
        assert!(maturity(90.0) - maturity(80.0) < 0.01);
    }

    #[test]
    fn a_plant_that_follows_its_allometry_has_no_stature_of_its_own() {
        let oak = oak();
        let plant = Traits::of_age(&oak, 30.0, 0.4);
        assert_eq!(plant.features(&oak)[2], 0.0);
        let taller = Traits { height: plant.height * 2.0, ..plant };
        let expected = STATURE_SCALE * std::f64::consts::LN_2;
        assert!((taller.features(&oak)[2] - expected).abs() < 1e-6);
    }
}
