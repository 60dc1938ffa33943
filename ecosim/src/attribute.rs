//! Age and vigor of plants that a step creates.

use crate::Error;
use crate::config::Attribute;
use crate::field::BoundFormula;
use crate::ground::Ground;
use crate::stand::{Kind, Stand};
use rayon::prelude::*;
use weald_contract::Seed;

/// Ages that plants get when nothing is said, as parts of the lifespan.
pub(crate) const USUAL_AGE: [f32; 2] = [0.2, 0.8];

/// What a step says of age and vigor.
pub(crate) struct Attributes<'a> {
    pub(crate) age: &'a Option<Attribute>,
    pub(crate) age_noise: f32,
    pub(crate) vigor: &'a Option<Attribute>,
    pub(crate) vigor_noise: f32,
}

/// The plants that want numbers.
pub(crate) struct Newcomers<'a> {
    pub(crate) ground: &'a Ground<'a>,
    pub(crate) stand: &'a Stand<'a>,
    pub(crate) kind: Kind<'a>,
    pub(crate) seed: Seed,
    /// Ids and places.
    pub(crate) sites: &'a [(u64, [f64; 2])],
}

impl Attributes<'_> {
    /// Returns age, from 0 to the lifespan, and vigor, from 0 to 1, of each plant.
    pub(crate) fn draw(&self, plants: &Newcomers<'_>) -> Result<Vec<(f32, f32)>, Error> {
        let lifespan = plants.kind.size.lifespan;
        let usual = Attribute::Range(USUAL_AGE.map(|part| part * lifespan));
        let age = self.age.as_ref().unwrap_or(&usual);
        let ages = plants.numbers("age", age, Noise::Relative(self.age_noise))?;
        let vigors = match self.vigor {
            Some(vigor) => plants.numbers("vigor", vigor, Noise::Absolute(self.vigor_noise))?,
            None => plants.natural_vigors(),
        };
        let tidy = |(age, vigor): (f32, f32)| (age.clamp(0.0, lifespan), vigor.clamp(0.0, 1.0));
        Ok(ages.into_iter().zip(vigors).map(tidy).collect())
    }
}

/// How a number given by a formula is varied.
#[derive(Clone, Copy)]
enum Noise {
    Absolute(f32),
    Relative(f32),
}

impl Newcomers<'_> {
    fn natural_vigors(&self) -> Vec<f32> {
        let vigor = |&(id, [x, y]): &(u64, [f64; 2])| {
            self.kind.ecology.vigor(self.ground.soil_moisture(x, y), self.seed, id)
        };
        self.sites.par_iter().map(vigor).collect()
    }

    /// Returns the numbers that an attribute gives; `name` names their random streams.
    fn numbers(&self, name: &str, attribute: &Attribute, noise: Noise) -> Result<Vec<f32>, Error> {
        let stream = |id| self.seed.stream(name, id);
        let formula = match attribute {
            Attribute::Range([low, high]) => {
                let (low, high) = (f64::from(*low), f64::from(*high));
                let drawn = |&(id, _): &(u64, _)| stream(id).range(low, high) as f32;
                return Ok(self.sites.par_iter().map(drawn).collect());
            }
            Attribute::Formula(formula) => formula,
        };
        let bound = BoundFormula::bind(formula, self.ground.terrain, self.stand)?;
        let values = bound.numbers(self.sites.len(), |index| self.sites[index].1)?;
        let varied = |(value, &(id, _)): (f32, &(u64, [f64; 2]))| {
            let chance = stream(id).around(0.0, 1.0) as f32;
            match noise {
                Noise::Absolute(spread) => value + spread * chance,
                Noise::Relative(spread) => value * (1.0 + spread * chance),
            }
        };
        Ok(values.into_par_iter().zip(self.sites).map(varied).collect())
    }
}
