//! What changes from year to year in a simulation, and nothing else: enough to go on from.

use crate::Death;
use crate::bytes::records;
use crate::ids::IdSource;
use crate::seeds::DormantSeed;
use crate::stand::is_size;
use weald_contract::State;

/// A plant in the simulation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Grower {
    pub(crate) id: u64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) age: f32,
    pub(crate) vigor: f32,
    pub(crate) radius: f32,
    /// Radius that it approaches as it ages, m.
    pub(crate) full_radius: f32,
    /// Index into the participants.
    pub(crate) who: u16,
    pub(crate) state: State,
    /// Whether it stood before the simulation began.
    pub(crate) is_settler: bool,
}

/// All of a simulation that one year changes.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Life {
    /// The year that has passed, counted as in [`crate::SummaryRow::step`].
    pub(crate) year: u32,
    /// Seeds sown so far, with those that did not take hold: the next id's counter.
    pub(crate) sown: u64,
    /// The plants: those found at the start by id, then by arrival.
    pub(crate) growers: Vec<Grower>,
    /// Seeds in the ground, by participant.
    pub(crate) bank: Vec<Vec<DormantSeed>>,
    /// Deaths so far.
    pub(crate) deaths: Vec<Death>,
}

records! {
    Grower {
        id: u64, x: f64, y: f64, age: f32, vigor: f32, radius: f32, full_radius: f32,
        who: u16, state: State, is_settler: bool,
    }
    Life {
        year: u32, sown: u64, growers: Vec<Grower>, bank: Vec<Vec<DormantSeed>>,
        deaths: Vec<Death>,
    }
}

impl Life {
    /// Says why a simulation of these species, by their indices in a population of `species_count`,
    /// cannot go on from here, if it cannot.
    pub(crate) fn fault(&self, species: &[u16], species_count: usize) -> Option<&'static str> {
        let is_sound = |plant: &Grower| {
            let sizes = [plant.age, plant.vigor, plant.radius, plant.full_radius];
            let is_placed = plant.x.is_finite() && plant.y.is_finite();
            let is_known = usize::from(plant.who) < species.len();
            is_known && is_placed && sizes.into_iter().all(is_size) && plant.vigor <= 1.0
        };
        if !self.growers.iter().all(is_sound) {
            return Some("a plant in it cannot be");
        }
        if self.sown >= IdSource::MOST {
            return Some("it counts more seeds than there are ids");
        }
        if self.bank.len() != species.len() {
            return Some("its seeds are of other species");
        }
        let lies = |seed: &DormantSeed| seed.x.is_finite() && seed.y.is_finite();
        for (seeds, &species) in self.bank.iter().zip(species) {
            if !seeds.iter().all(|seed| lies(seed) && seed.species == species) {
                return Some("a seed in it cannot be");
            }
        }
        let is_known = |death: &Death| usize::from(death.species) < species_count;
        (!self.deaths.iter().all(is_known)).then_some("a death in it is of no known species")
    }
}
