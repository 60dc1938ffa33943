//! How a species lives: the table `[ecology]` of its file.

use crate::dispersal::Kernel;
use crate::seeds::Mast;
use weald_contract::source::nearest;
use weald_contract::{Problem, Seed, Written, table};

table! {
    /// How a species answers to a layer of the terrain.
    ///
    /// The response is 1 within the range that it likes best, and falls off as a Gaussian outside:
    /// `r = exp(-d² / (2 t²))` at a distance d from the range, with the tolerance t [Gauch72].
    pub struct Response {
        /// Name of the layer.
        layer: Written<String>;
        /// Least and greatest value that it likes best, in the layer's unit.
        best: Written<[f32; 2]>, in -1000000000.0..=1000000000.0;
        /// Standard deviation of the response outside, in the layer's unit.
        tolerance: f32, in 0.000001..=1000000000.0;
    }
}

impl Response {
    /// Returns the response to a value of the layer, 0 to 1.
    pub fn at(&self, value: f32) -> f32 {
        let [least, greatest] = self.best.value;
        let off = (value - value.clamp(least, greatest.max(least))) / self.tolerance;
        libm::expf(-0.5 * off * off)
    }
}

table! {
    /// How a species comes, competes and dies.
    ///
    /// The five traits of the multi-species model of [Deussen98]: new plants, size (in `[size]`),
    /// growth, survival under domination, preference for wet or dry ground; and where the
    /// species cannot stand at all.
    pub struct Ecology {
        /// Seeds from afar, per hectare and year; they fall anywhere.
        seedlings: f32 = 20.0, in 0.0..=1000000.0;
        /// Seeds that a mature plant bears, per m² of crown and year.
        seeds: f32 = 0.0, in 0.0..=1000000.0;
        /// Age from which a plant bears seeds, years.
        maturity: f32 = 10.0, in 0.0..=10000.0;
        /// How far its seeds fall from a plant; left out, anywhere.
        dispersal: Option<Kernel> = None;
        /// Years in which all plants bear most of their seeds; left out, crops are even.
        mast: Option<Mast> = None;
        /// Part of the seeds in the ground that germinates in a year; the others wait.
        germination: f32 = 1.0, in 0.0..=1.0;
        /// Part of the waiting seeds that lives on to the next year.
        dormancy: f32 = 0.0, in 0.0..=1.0;
        /// Probability to live on through a year under a stronger plant: shade tolerance.
        survival: f32 = 0.3, in 0.0..=1.0;
        /// Soil moisture it likes best, from -1 (driest) over 0 (middling) to 1 (wettest).
        wet_preference: f32 = 0.0, in -1.0..=1.0;
        /// How wide a range of soil moisture suits it: standard deviation of its response.
        wet_tolerance: f32 = 0.35, in 0.01..=100.0;
        /// How it answers to other layers of the terrain; vigor is the product of all.
        response: Vec<Response> = Vec::new();
        /// Least and greatest depth of water it stands in, m.
        water_depth: [f32; 2] = [0.0, 0.0], in 0.0..=100.0;
        /// Steepest ground it stands on, degrees.
        slope_max_deg: f32 = 60.0, in 0.0..=90.0;
        /// Weight of the vertical against the ground's normal in the plant's axis.
        upright: f32 = 1.0, in 0.0..=1.0;
        /// Largest part of its vigor that chance takes from a plant.
        growth_spread: f32 = 0.2, in 0.0..=1.0;
    }
}

impl Default for Ecology {
    fn default() -> Self {
        Self {
            seedlings: 20.0,
            seeds: 0.0,
            maturity: 10.0,
            dispersal: None,
            mast: None,
            germination: 1.0,
            dormancy: 0.0,
            survival: 0.3,
            wet_preference: 0.0,
            wet_tolerance: 0.35,
            response: Vec::new(),
            water_depth: [0.0, 0.0],
            slope_max_deg: 60.0,
            upright: 1.0,
            growth_spread: 0.2,
        }
    }
}

impl Ecology {
    /// Returns how well soil of this moisture (0 to 1) suits the species, 0 to 1.
    ///
    /// A Gaussian response along the gradient, the usual first model of a species' optimum
    /// [Gauch72]: `s(m) = exp(-(m - o)² / (2 b²))`, with the optimum
    /// `o = (1 + wet_preference) / 2` and the breadth `b = wet_tolerance`.
    pub fn suitability(&self, moisture: f32) -> f32 {
        let optimum = 0.5 * (1.0 + self.wet_preference);
        let off = (moisture.clamp(0.0, 1.0) - optimum) / self.wet_tolerance;
        libm::expf(-0.5 * off * off)
    }

    /// Returns the vigor of one plant on ground of this suitability, 0 to 1.
    ///
    /// The paper asks for "a randomized function of the water concentration at the plant
    /// location and the plant's preference" [Deussen98] without giving it. Ours is
    /// `vigor = s (1 - growth_spread u)`, where `s` is the product of [`Ecology::suitability`] for
    /// the moisture and every [`Response`], and `u` uniform in [0, 1) from the plant's own stream, so
    /// that it never exceeds 1.
    pub fn vigor(&self, suitability: f32, seed: Seed, id: u64) -> f32 {
        let chance = seed.stream("vigor", id).unit() as f32;
        suitability * (1.0 - self.growth_spread * chance)
    }

    /// Complains of responses to layers that the terrain does not have, and of ranges that fall.
    pub(crate) fn check(&self, layers: &[&str], problems: &mut Vec<Problem>) {
        for Response { layer, best, .. } in &self.response {
            if !layers.contains(&layer.value.as_str()) {
                let message = format!("the terrain has no layer `{}`", layer.value);
                let hint = match nearest(&layer.value, layers.iter().copied()) {
                    Some(near) => format!("did you mean `{near}`?"),
                    None => format!("`layers = [\"{}\"]` in `[terrain]` may make it", layer.value),
                };
                problems.push(Problem::at(layer.span, message).hint(hint));
            }
            if best.value[0] > best.value[1] {
                let problem = Problem::at(best.span, "`best` falls: least comes first");
                problems.push(problem.hint("write `best = [least, greatest]`"));
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    #[test]
    fn default_values_are_those_of_an_empty_table() {
        let empty = Value::parse(0, "").unwrap();
        assert_eq!(Ecology::from_toml(&empty, &mut Vec::new()), Some(Ecology::default()));
    }

    #[test]
    fn suitability_peaks_at_the_preferred_moisture_and_falls_as_a_gaussian() {
        let wet = Ecology { wet_preference: 0.6, wet_tolerance: 0.2, ..Ecology::default() };
        assert_eq!(wet.suitability(0.8), 1.0);
        // One standard deviation off: exp(-1/2).
        assert!((wet.suitability(0.6) - 0.606_530_7).abs() < 1e-5);
        assert!((wet.suitability(1.0) - wet.suitability(0.6)).abs() < 1e-6);
    }

    #[test]
    fn a_response_is_level_within_its_range_and_falls_as_a_gaussian_outside() {
        let none = weald_contract::Span::default();
        let response = |best| Response {
            layer: Written { value: "insolation".into(), span: none },
            best: Written { value: best, span: none },
            tolerance: 4.0,
        };
        let range = response([12.0, 18.0]);
        assert!([12.0, 15.0, 18.0].iter().all(|value| range.at(*value) == 1.0));
        // One and two standard deviations off: exp(-1/2), exp(-2).
        for (value, right) in [(8.0, 0.606_530_7), (22.0, 0.606_530_7), (26.0, 0.135_335_3f32)] {
            assert!((range.at(value) - right).abs() < 1e-6);
        }
        assert_eq!(response([5.0, 5.0]).at(5.0), 1.0);
    }

    #[test]
    fn chance_takes_at_most_the_spread_from_vigor() {
        let ecology = Ecology { growth_spread: 0.5, ..Ecology::default() };
        let vigors: Vec<f32> = (0..1000).map(|id| ecology.vigor(1.0, Seed(3), id)).collect();
        assert!(vigors.iter().all(|v| (0.5..=1.0).contains(v)));
        let mean = vigors.iter().sum::<f32>() / 1000.0;
        // Mean of 1 - u/2 is 3/4; standard error 0.5 / sqrt(12 · 1000) = 0.0046, five of them.
        assert!((mean - 0.75).abs() < 0.023, "{mean}");
    }
}
