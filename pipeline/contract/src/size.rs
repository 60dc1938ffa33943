//! Allometry of a species: how high, wide and heavy a plant of a given age and vigor is.
//!
//! The simulation grows crowns, quantization compares plants and the generators build them; all
//! three must agree, so the table `[size]` of a species file is read here once.

crate::table! {
    /// Size of a plant as a function of age and vigor.
    ///
    /// Height follows Chapman and Richards [Richards59]:
    /// `H(a, v) = height (1 - slowest_vigor (1 - v)) (1 - exp(-rate a))^shape`.
    /// Crown radius and trunk diameter are powers of height.
    pub struct Size {
        /// Height of an old, vigorous plant, m.
        height: f32, in 0.01..=150.0;
        /// Rate of approach to the final height, 1/year.
        rate: f32 = 0.05, in 0.0001..=1000.0;
        /// Exponent of the growth curve: above 1, growth starts slowly.
        shape: f32 = 1.2, in 0.1..=10.0;
        /// Part of the height that a plant of vigor 0 lacks.
        vigor_loss: f32 = 0.4, in 0.0..=0.95;
        /// Crown radius of a plant of full `height`, m.
        crown_radius: f32, in 0.001..=100.0;
        /// Exponent of crown radius over height.
        crown_exponent: f32 = 1.0, in 0.2..=3.0;
        /// Trunk or stem diameter at the base of a plant of full `height`, m.
        stem_diameter: f32 = 0.01, in 0.0001..=20.0;
        /// Exponent of stem diameter over height; 3/2 is elastic similarity [McMahon73].
        stem_exponent: f32 = 1.5, in 0.2..=3.0;
        /// Age at which a plant dies of old age, years.
        lifespan: f32 = 100.0, in 0.01..=10000.0;
        /// Dry mass of a plant of full `height`, kg; mass grows with the third power of height.
        mass: f32 = 1.0, in 0.0..=1000000.0;
    }
}

impl Size {
    /// Height of a plant, m.
    pub fn height_at(&self, age: f32, vigor: f32) -> f32 {
        let grown = 1.0 - libm::expf(-self.rate * age.max(0.0));
        self.height * self.vigor_factor(vigor) * libm::powf(grown, self.shape)
    }

    /// Crown radius of a plant, m.
    pub fn radius_at(&self, age: f32, vigor: f32) -> f32 {
        self.radius_of_height(self.height_at(age, vigor))
    }

    /// Crown radius that goes with a height, m.
    pub fn radius_of_height(&self, height: f32) -> f32 {
        self.crown_radius * libm::powf(height / self.height, self.crown_exponent)
    }

    /// Height that goes with a crown radius, m: the inverse of [`Size::radius_of_height`].
    pub fn height_of_radius(&self, radius: f32) -> f32 {
        self.height * libm::powf(radius / self.crown_radius, 1.0 / self.crown_exponent)
    }

    /// Stem diameter that goes with a height, m.
    pub fn stem_diameter_of_height(&self, height: f32) -> f32 {
        self.stem_diameter * libm::powf(height / self.height, self.stem_exponent)
    }

    /// Height that goes with a stem diameter, m: the inverse of [`Size::stem_diameter_of_height`].
    pub fn height_of_stem_diameter(&self, diameter: f32) -> f32 {
        self.height * libm::powf(diameter / self.stem_diameter, 1.0 / self.stem_exponent)
    }

    /// Dry mass that goes with a height, kg.
    pub fn mass_of_height(&self, height: f32) -> f32 {
        self.mass * (height / self.height).powi(3)
    }

    /// Age at which a plant of this vigor reaches `height`, years: the inverse of
    /// [`Size::height_at`], at most [`Size::lifespan`].
    pub fn age_of_height(&self, height: f32, vigor: f32) -> f32 {
        let part = height / (self.height * self.vigor_factor(vigor));
        let grown = libm::powf(part.clamp(0.0, 1.0), 1.0 / self.shape);
        let age = -libm::logf(1.0 - grown) / self.rate;
        age.min(self.lifespan)
    }

    fn vigor_factor(&self, vigor: f32) -> f32 {
        1.0 - self.vigor_loss * (1.0 - vigor.clamp(0.0, 1.0))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn oak() -> Size {
        let value = crate::Value::parse(0, "height = 20\ncrown_radius = 6").unwrap();
        crate::FromToml::from_toml(&value, &mut Vec::new()).unwrap()
    }

    #[test]
    fn age_and_height_are_inverse_below_the_lifespan() {
        let oak = oak();
        for age in [1.0, 10.0, 60.0] {
            for vigor in [0.0, 0.5, 1.0] {
                let back = oak.age_of_height(oak.height_at(age, vigor), vigor);
                assert!((back - age).abs() < 1e-2 * age, "{age} {vigor} gave {back}");
            }
        }
    }

    #[test]
    fn stem_diameter_and_height_are_inverse() {
        let oak = oak();
        for height in [0.5, 5.0, 20.0] {
            let back = oak.height_of_stem_diameter(oak.stem_diameter_of_height(height));
            assert!((back - height).abs() < 1e-4 * height);
        }
    }

    #[test]
    fn plants_grow_with_age_and_with_vigor() {
        let oak = oak();
        assert!(oak.height_at(20.0, 0.5) < oak.height_at(21.0, 0.5));
        assert!(oak.height_at(20.0, 0.5) < oak.height_at(20.0, 0.6));
        assert_eq!(oak.height_at(0.0, 1.0), 0.0);
    }
}
