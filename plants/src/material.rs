//! Colours of leaves and bark, and how vigor changes them.
//!
//! Reflectance and transmittance are linear Rec. 709. Green leaves reflect about a tenth of the
//! green light and transmit nearly as much [Jacquemoud96]; a thin sheet never gives back more
//! than it receives.

use weald_contract::{Material, Problem, Problems, Surface, Written, table};

table! {
    /// Colour of leaves and blades.
    pub struct LeafColor {
        /// Diffuse reflectance of a healthy leaf.
        reflectance: Written<[f32; 3]> = LeafColor::default().reflectance, in 0.0..=1.0;
        /// Diffuse transmittance of a healthy leaf.
        transmittance: Written<[f32; 3]> = LeafColor::default().transmittance, in 0.0..=1.0;
        /// Diffuse reflectance of a withered leaf.
        dry: [f32; 3] = LeafColor::default().dry, in 0.0..=0.8;
        /// How much a plant of vigor 0 has withered, 0 to 1.
        withering: f32 = LeafColor::default().withering, in 0.0..=1.0;
        /// Spread of brightness and hue among the leaves of a plant, 0 to 1.
        spread: f32 = LeafColor::default().spread, in 0.0..=1.0;
        /// Roughness of the waxy coat.
        roughness: f32 = LeafColor::default().roughness, in 0.05..=1.0;
    }
}

impl Default for LeafColor {
    fn default() -> Self {
        Self {
            reflectance: written([0.06, 0.13, 0.04]),
            transmittance: written([0.05, 0.12, 0.02]),
            dry: [0.30, 0.25, 0.12],
            withering: 0.6,
            spread: 0.2,
            roughness: 0.5,
        }
    }
}

/// A default value, written nowhere.
fn written<T>(value: T) -> Written<T> {
    Written { value, span: Default::default() }
}

/// Most of the light that a leaf may give back; real ones stay well below.
const MOST_SCATTERED: f32 = 0.95;

impl LeafColor {
    /// Reports a leaf that would scatter more light than falls on it.
    pub fn check(&self) -> Problems {
        let sums = self.reflectance.value.iter().zip(self.transmittance.value);
        let worst = sums.map(|(r, t)| r + t).fold(0.0, f32::max);
        // A hair's breadth for sums such as 0.55 + 0.4.
        if worst <= MOST_SCATTERED + 1e-5 {
            return Vec::new();
        }
        let what = format!("reflectance and transmittance of the leaf add up to {worst}");
        let hint = format!("their sum may be at most {MOST_SCATTERED} in each channel");
        vec![Problem::at(self.transmittance.span, what).hint(hint)]
    }

    /// The material of variant `index` of `count`, for a plant of this vigor.
    ///
    /// Variants run from darker and bluer to lighter and yellower, as leaves do from shade to
    /// light and from old to young.
    pub fn material(&self, name: &str, vigor: f32, index: u32, count: u32) -> Material {
        let place = (index as f32 + 0.5) / count.max(1) as f32 - 0.5;
        let tilt = [1.0 + 1.6 * place * self.spread, 1.0, 1.0 - 0.8 * place * self.spread];
        let light = 1.0 + 1.4 * place * self.spread;
        // Withering comes late: a plant of middling vigor is still green.
        let dryness = self.withering * (1.0 - vigor) * (1.0 - vigor);
        let mut reflectance = [0.0; 3];
        let mut transmittance = [0.0; 3];
        for channel in 0..3 {
            let shift = light * tilt[channel];
            let green = self.reflectance.value[channel] * shift;
            let through = self.transmittance.value[channel] * shift;
            reflectance[channel] = green + (self.dry[channel] - green) * dryness;
            // A dry leaf scatters more light back and lets a third of that through.
            transmittance[channel] = through + (0.3 * self.dry[channel] - through) * dryness;
        }
        leaf(name, reflectance, transmittance, self.roughness)
    }
}

/// A thin sheet; colours that scatter too much are dimmed.
pub fn leaf(
    name: &str,
    reflectance: [f32; 3],
    transmittance: [f32; 3],
    roughness: f32,
) -> Material {
    let sum = reflectance.iter().zip(transmittance).map(|(r, t)| r + t).fold(0.0, f32::max);
    let dim = if sum > MOST_SCATTERED { MOST_SCATTERED / sum } else { 1.0 };
    Material {
        name: name.into(),
        reflectance: reflectance.map(|r| r * dim),
        roughness,
        surface: Surface::Leaf { transmittance: transmittance.map(|t| t * dim) },
        ..Material::default()
    }
}

/// A thin coloured sheet, such as a petal, that transmits `part` of what it reflects.
pub fn petal(name: &str, reflectance: [f32; 3], part: f32) -> Material {
    leaf(name, reflectance, reflectance.map(|r| r * part), 0.8)
}

/// Something opaque and rough, such as bark.
pub fn opaque(name: &str, reflectance: [f32; 3]) -> Material {
    Material { name: name.into(), reflectance, roughness: 0.9, ..Material::default() }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn read(text: &str) -> LeafColor {
        let value = Value::parse(0, text).unwrap();
        LeafColor::from_toml(&value, &mut Vec::new()).unwrap()
    }

    fn scattered(material: &Material) -> f32 {
        let Surface::Leaf { transmittance } = material.surface else { return 0.0 };
        material.reflectance.iter().zip(transmittance).map(|(r, t)| r + t).fold(0.0, f32::max)
    }

    #[test]
    fn no_leaf_gives_back_more_light_than_falls_on_it() {
        let bright = read("reflectance = [0.5, 0.55, 0.5]\ntransmittance = [0.4, 0.4, 0.4]");
        assert!(bright.check().is_empty());
        for index in 0..5 {
            for vigor in [0.0, 0.4, 1.0] {
                assert!(scattered(&bright.material("leaf", vigor, index, 5)) <= 0.9501);
            }
        }
    }

    #[test]
    fn an_impossible_leaf_is_told_at_its_transmittance() {
        let text = "reflectance = [0.6, 0.6, 0.6]\ntransmittance = [0.5, 0.5, 0.5]";
        let problems = read(text).check();
        let span = problems[0].span.unwrap();
        assert_eq!(&text[span.start as usize..span.end as usize], "[0.5, 0.5, 0.5]");
    }

    #[test]
    fn lost_vigor_turns_green_to_straw() {
        let color = read("");
        let ratio = |vigor| {
            let r = color.material("leaf", vigor, 0, 1).reflectance;
            r[0] / r[1]
        };
        assert!(ratio(0.0) > ratio(0.5) && ratio(0.5) > ratio(1.0));
    }
}
