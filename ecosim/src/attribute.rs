//! Age and vigor of plants that a step creates.

use crate::Error;
use crate::config::Attribute;
use crate::field::BoundFormula;
use crate::ground::Ground;
use crate::stand::{Kind, Stand};
use rayon::prelude::*;
use weald_contract::Seed;

/// Ages that plants get when nothing is said, as parts of the lifespan.
const USUAL_AGE: [f32; 2] = [0.2, 0.8];

/// What a step says of age and vigor.
pub(crate) struct Attributes<'a> {
    pub(crate) age: &'a Option<Attribute>,
    pub(crate) age_noise: f32,
    pub(crate) vigor: &'a Option<Attribute>,
    pub(crate) vigor_noise: f32,
}

impl Attributes<'_> {
    /// Returns the age and vigor of the plants with these ids and places.
    pub(crate) fn draw(
        &self,
        ground: &Ground<'_>,
        stand: &Stand<'_>,
        kind: &Kind<'_>,
        seed: Seed,
        plants: &[(u64, [f64; 2])],
    ) -> Result<Vec<(f32, f32)>, Error> {
        let lifespan = kind.size.lifespan;
        let usual = Attribute::Range(USUAL_AGE.map(|part| part * lifespan));
        let age = self.age.as_ref().unwrap_or(&usual);
        let ages =
            numbers(age, Noise::Relative(self.age_noise), "age", ground, stand, seed, plants)?;
        let vigors = match self.vigor {
            Some(vigor) => {
                let noise = Noise::Absolute(self.vigor_noise);
                numbers(vigor, noise, "vigor", ground, stand, seed, plants)?
            }
            None => {
                let natural = |&(id, [x, y]): &(u64, [f64; 2])| {
                    kind.ecology.vigor(ground.soil_moisture(x, y), seed, id)
                };
                plants.par_iter().map(natural).collect()
            }
        };
        let tidy = |(age, vigor): (f32, f32)| (age.max(0.0), vigor.clamp(0.0, 1.0));
        Ok(ages.into_iter().zip(vigors).map(tidy).collect())
    }
}

/// How a number given by a formula is varied.
#[derive(Clone, Copy)]
enum Noise {
    Absolute(f32),
    Relative(f32),
}

fn numbers(
    attribute: &Attribute,
    noise: Noise,
    name: &str,
    ground: &Ground<'_>,
    stand: &Stand<'_>,
    seed: Seed,
    plants: &[(u64, [f64; 2])],
) -> Result<Vec<f32>, Error> {
    let stream = |id| seed.stream(name, id);
    match attribute {
        Attribute::Range([low, high]) => {
            let (low, high) = (f64::from(*low), f64::from(*high));
            Ok(plants.par_iter().map(|&(id, _)| stream(id).range(low, high) as f32).collect())
        }
        Attribute::Formula(formula) => {
            let bound = BoundFormula::bind(formula, ground.terrain, stand)?;
            let values = bound.numbers(plants.len(), |index| plants[index].1)?;
            let varied = |(value, &(id, _)): (f32, &(u64, [f64; 2]))| {
                let chance = stream(id).around(0.0, 1.0) as f32;
                match noise {
                    Noise::Absolute(spread) => value + spread * chance,
                    Noise::Relative(spread) => value * (1.0 + spread * chance),
                }
            };
            Ok(values.into_par_iter().zip(plants).map(varied).collect())
        }
    }
}
