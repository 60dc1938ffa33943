//! Distances that plants keep: those that stand too near others move, or are put elsewhere.
//!
//! A plant that a step adds takes the nearest free place about its own; if there is none, a free
//! place drawn from the step's density. So the number of plants of each species stays what the
//! density says; those for which no place is found are counted and named, never dropped in
//! silence. Plants that stand already stay.

use crate::config::Spacing;
use crate::stand::Stand;
use std::collections::HashMap;
use weald_contract::{Plant, Seed, Stream};

/// Rings of places tried about a plant, each a part of the distance to be kept further out.
const RINGS: u32 = 12;
/// Width of a ring as a part of the distance to be kept.
const RING: f64 = 0.125;
/// Places on the first ring; the others have as many for their length.
const ON_FIRST_RING: u32 = 6;
/// Places drawn from the density for a plant without any near its own. At 99 % of the ground
/// taken, 400 draws still find a place 98 times of 100.
const DRAWS: u32 = 400;

/// The distances to keep between two species, m, at crown radii of the two.
#[derive(Clone, Copy, Debug, Default)]
struct Apart {
    stems: f64,
    crowns: f64,
}

impl Apart {
    fn of(self, radius: f64, other: f64) -> f64 {
        self.stems.max(self.crowns * (radius + other))
    }
}

/// Plants of one species, by the square in which they stand.
struct Neighbours {
    apart: Apart,
    widest: f64,
    side: f64,
    /// Only looked up, never walked through, so that its order does not matter.
    squares: HashMap<(i64, i64), Vec<[f64; 3]>>,
}

impl Neighbours {
    fn square(&self, x: f64, y: f64) -> (i64, i64) {
        ((x / self.side).floor() as i64, (y / self.side).floor() as i64)
    }

    fn add(&mut self, plant: &Plant) {
        let square = self.square(plant.x, plant.y);
        let entry = [plant.x, plant.y, f64::from(plant.radius)];
        self.squares.entry(square).or_default().push(entry);
    }

    /// Returns the distance to be kept from the plants too near a place; `None` when none is.
    fn conflict(&self, x: f64, y: f64, radius: f64) -> Option<f64> {
        let (column, row) = self.square(x, y);
        let reach = (self.apart.of(radius, self.widest) / self.side).ceil() as i64;
        let mut most: Option<f64> = None;
        for r in row - reach..=row + reach {
            for c in column - reach..=column + reach {
                for &[ox, oy, other] in self.squares.get(&(c, r)).into_iter().flatten() {
                    let apart = self.apart.of(radius, other);
                    if (ox - x).powi(2) + (oy - y).powi(2) < apart * apart {
                        most = Some(most.map_or(apart, |most| most.max(apart)));
                    }
                }
            }
        }
        most
    }
}

/// The plants that newcomers of one species keep away from.
pub(crate) struct Keeper {
    neighbours: Vec<Neighbours>,
    /// Index of the newcomers' own species in `neighbours`.
    own: Option<usize>,
}

impl Keeper {
    /// Finds whom newcomers of `species` keep away from; `None` when nobody is named. `widest`
    /// is the greatest crown radius among the newcomers.
    pub(crate) fn new(
        rules: &[Spacing],
        species: u16,
        widest: f32,
        stand: &Stand<'_>,
    ) -> Option<Self> {
        let names = &stand.population.species;
        let mut keeper = Self { neighbours: Vec::new(), own: None };
        for (index, name) in names.iter().enumerate() {
            let apart = apart(rules, &names[usize::from(species)], name);
            let is_own = index == usize::from(species);
            let plants = || {
                let plants = stand.population.plants.iter();
                plants.filter(move |plant| usize::from(plant.species) == index)
            };
            let greatest = plants().map(|plant| plant.radius).fold(0.0, f32::max);
            let others = f64::from(if is_own { greatest.max(widest) } else { greatest });
            let side = apart.of(f64::from(widest), others);
            if side <= 0.0 || (!is_own && plants().next().is_none()) {
                continue;
            }
            let squares = HashMap::new();
            let mut neighbours = Neighbours { apart, widest: others, side, squares };
            plants().for_each(|plant| neighbours.add(plant));
            if is_own {
                keeper.own = Some(keeper.neighbours.len());
            }
            keeper.neighbours.push(neighbours);
        }
        (!keeper.neighbours.is_empty()).then_some(keeper)
    }

    fn conflict(&self, [x, y]: [f64; 2], radius: f64) -> Option<f64> {
        let conflicts = self.neighbours.iter().filter_map(|n| n.conflict(x, y, radius));
        conflicts.reduce(f64::max)
    }

    /// Moves plants to free places, the largest first; returns those that found one, in the
    /// order of their ids, and how many did not.
    ///
    /// `is_welcome` says where they may stand; `draw` gives a place where they are wanted.
    pub(crate) fn settle(
        &mut self,
        mut plants: Vec<Plant>,
        seed: Seed,
        is_welcome: impl Fn([f64; 2]) -> bool,
        draw: impl Fn(&mut Stream) -> [f64; 2],
    ) -> (Vec<Plant>, u64) {
        plants.sort_by(|a, b| b.radius.total_cmp(&a.radius).then(a.id.cmp(&b.id)));
        let (mut settled, mut homeless) = (Vec::with_capacity(plants.len()), Vec::new());
        // First all that fit where they are, then their neighbours in turn, so that a plant moves
        // only for one that must stay.
        for plant in plants {
            match self.conflict([plant.x, plant.y], f64::from(plant.radius)) {
                None => self.take(plant, &mut settled),
                Some(apart) => homeless.push((plant, apart)),
            }
        }
        let mut left = Vec::new();
        for (mut plant, apart) in homeless {
            match self.place_near(&plant, apart, &is_welcome) {
                Some([x, y]) => {
                    (plant.x, plant.y) = (x, y);
                    self.take(plant, &mut settled);
                }
                None => left.push(plant),
            }
        }
        let mut unplaced = 0;
        for mut plant in left {
            let mut stream = seed.stream("elsewhere", plant.id);
            let radius = f64::from(plant.radius);
            let free = (0..DRAWS)
                .map(|_| draw(&mut stream))
                .find(|place| is_welcome(*place) && self.conflict(*place, radius).is_none());
            match free {
                Some([x, y]) => {
                    (plant.x, plant.y) = (x, y);
                    self.take(plant, &mut settled);
                }
                None => unplaced += 1,
            }
        }
        settled.sort_by_key(|plant| plant.id);
        (settled, unplaced)
    }

    fn take(&mut self, plant: Plant, settled: &mut Vec<Plant>) {
        if let Some(own) = self.own {
            self.neighbours[own].add(&plant);
        }
        settled.push(plant);
    }

    /// Returns the nearest free place on rings about a plant.
    fn place_near(
        &self,
        plant: &Plant,
        apart: f64,
        is_welcome: &impl Fn([f64; 2]) -> bool,
    ) -> Option<[f64; 2]> {
        (1..=RINGS).find_map(|ring| {
            let (radius, count) = (f64::from(ring) * RING * apart, ring * ON_FIRST_RING);
            (0..count)
                .map(|index| {
                    let turn = f64::from(plant.yaw)
                        + std::f64::consts::TAU * f64::from(index) / f64::from(count);
                    [plant.x + radius * libm::cos(turn), plant.y + radius * libm::sin(turn)]
                })
                .find(|place| {
                    is_welcome(*place) && self.conflict(*place, f64::from(plant.radius)).is_none()
                })
        })
    }
}

/// Returns what two species keep between them: the most that any rule asks.
fn apart(rules: &[Spacing], one: &str, other: &str) -> Apart {
    let names = |rule: &Spacing, name: &str| rule.species.iter().any(|s| s.value == name);
    let mut apart = Apart::default();
    for rule in rules {
        let is_meant = match &rule.from {
            // Within a list, every pair keeps the distance, and each species among its own.
            None => names(rule, one) && names(rule, other),
            Some(from) => {
                (names(rule, one) && from.value == other)
                    || (names(rule, other) && from.value == one)
            }
        };
        if is_meant {
            apart.stems = apart.stems.max(rule.stems);
            apart.crowns = apart.crowns.max(rule.crowns);
        }
    }
    apart
}
