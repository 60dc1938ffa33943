//! Age, vigor, height and orientation of plants that a step creates.

use crate::Error;
use crate::config::Attribute;
use crate::field::BoundFormula;
use crate::ground::Ground;
use crate::stand::{Kind, Stand, lean_on};
use rayon::prelude::*;
use weald_contract::{Plant, Seed};

/// Ages that plants get when nothing is said, as parts of the lifespan.
pub(crate) const USUAL_AGE: [f32; 2] = [0.2, 0.8];

/// What a step says of age and vigor.
pub(crate) struct Attributes<'a> {
    pub(crate) age: &'a Option<Attribute>,
    pub(crate) age_noise: f32,
    pub(crate) vigor: &'a Option<Attribute>,
    pub(crate) vigor_noise: f32,
}

/// What a step says of height and orientation.
pub(crate) struct Looks<'a> {
    pub(crate) height: &'a Option<Attribute>,
    pub(crate) yaw_deg: &'a Option<Attribute>,
    pub(crate) upright: &'a Option<Attribute>,
    /// Whether ages were given; if not, they follow from heights that are.
    pub(crate) is_age_given: bool,
}

impl Looks<'_> {
    /// Gives plants the heights that the step names, with the crowns that go with them.
    pub(crate) fn size(
        &self,
        plants: &mut [Plant],
        newcomers: &Newcomers<'_>,
    ) -> Result<(), Error> {
        let Some(height) = self.height else { return Ok(()) };
        let heights = newcomers.numbers("height", height, Noise::Absolute(0.0))?;
        let size = newcomers.kind.size;
        plants.par_iter_mut().zip(heights).for_each(|(plant, height)| {
            // A plant has some height; a formula that falls below 0 means a seedling.
            plant.height = height.max(LEAST_HEIGHT * size.height);
            plant.radius = size.radius_of_height(plant.height);
            if !self.is_age_given {
                plant.age = size.age_of_height(plant.height, plant.vigor);
            }
        });
        Ok(())
    }

    /// Turns plants about their axes, and leans the axes, as the step says.
    pub(crate) fn orient(
        &self,
        plants: &mut [Plant],
        newcomers: &Newcomers<'_>,
    ) -> Result<(), Error> {
        if let Some(yaw) = self.yaw_deg {
            let yaws = newcomers.numbers("yaw", yaw, Noise::Absolute(0.0))?;
            plants.par_iter_mut().zip(yaws).for_each(|(plant, yaw)| plant.yaw = yaw.to_radians());
        }
        if let Some(upright) = self.upright {
            let weights = newcomers.numbers("upright", upright, Noise::Absolute(0.0))?;
            plants.par_iter_mut().zip(weights).for_each(|(plant, upright)| {
                lean_on(newcomers.ground, upright.clamp(0.0, 1.0), plant);
            });
        }
        Ok(())
    }
}

/// Least height that a plant is given, as a part of its species'.
const LEAST_HEIGHT: f32 = 0.001;

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
            let ecology = self.kind.ecology;
            ecology.vigor(self.ground.suitability(ecology, x, y), self.seed, id)
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
