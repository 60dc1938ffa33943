//! Self-thinning of one species, at millions of plants.
//!
//! The first model of [Deussen98]: circles of random size; where two intersect the smaller dies;
//! the others grow. Plants do not move and none are born, so that they are sorted into cells once
//! and stay sorted as the dead drop out; the grid is made anew only when half of them are gone.
//! Places are 32-bit fractions of the field, which makes a torus of it by mere overflow and a
//! plant 16 bytes small; the step is exact for the places so rounded.

mod step;

pub use step::SelfThinning;
pub(crate) use step::{Partway, run};

use crate::Inequality;
use crate::config::{Edge, Order};
use crate::growth::Growth;
use crate::levels::{Field, Levels, Site};
use rayon::prelude::*;
use weald_contract::{Seed, State};

/// Plants that one task looks at.
const RUN: usize = 4096;
/// Fixed point of the sums: whole numbers add up to the same in any order.
const UNIT: f64 = (1u64 << 40) as f64;
const FREE: u8 = State::Free as u8;
const DOMINATED: u8 = State::Dominated as u8;
const OLD: u8 = State::Old as u8;
/// Not yet decided.
const OPEN: u8 = u8::MAX;

/// A plant as it is handed in and out.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stem {
    /// Number; of equals the lower one wins.
    pub id: u32,
    /// Distance from the west rim, m.
    pub x: f64,
    /// Distance from the south rim, m.
    pub y: f64,
    /// Radius, m.
    pub radius: f32,
}

/// The rules of self-thinning.
#[derive(Clone, Debug)]
pub struct Rules {
    /// Width and height of the field, m.
    pub size: [f64; 2],
    /// What lies beyond its rim.
    pub edge: Edge,
    /// Whether all deaths of a step happen at once.
    pub order: Order,
    /// How circles grow.
    pub growth: Growth,
    /// Radius at which a plant is old and dies, m; infinite for never.
    pub limit: f32,
    /// Chance by which plants differ in growth.
    pub seed: Seed,
}

/// A death in the step at hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Loss {
    /// The plant.
    pub id: u32,
    /// The largest plant that stands over it, unless it dies of age.
    pub killer: Option<u32>,
}

/// A stand in numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Tally {
    /// Plants.
    pub alive: u64,
    /// Deaths under a larger plant in the step before.
    pub dominated: u64,
    /// Deaths at the limit size in the step before.
    pub old: u64,
    /// Sum of radii, m, in units of 2⁻⁴⁰ m.
    radii: u128,
    /// Sum of squared radii, m², likewise.
    squares: u128,
}

impl Tally {
    fn add(&mut self, radius: f32) {
        let radius = f64::from(radius);
        self.alive += 1;
        self.radii += u128::from((radius * UNIT) as u64);
        self.squares += u128::from((radius * radius * UNIT) as u64);
    }

    fn with(self, other: Self) -> Self {
        Self {
            alive: self.alive + other.alive,
            dominated: self.dominated + other.dominated,
            old: self.old + other.old,
            radii: self.radii + other.radii,
            squares: self.squares + other.squares,
        }
    }

    /// Returns the mean radius, m; 0 when nothing lives.
    pub fn mean_radius(&self) -> f64 {
        self.radii as f64 / UNIT / (self.alive.max(1)) as f64
    }

    /// Returns the sum of the circles' areas, m².
    pub fn area(&self) -> f64 {
        std::f64::consts::PI * (self.squares as f64 / UNIT)
    }
}

/// A stand that thins.
pub struct Thinning {
    rules: Rules,
    levels: Levels,
    /// State of each site, in the order of `levels.sites`; empty before [`Thinning::look`].
    states: Vec<u8>,
    tally: Tally,
}

impl Thinning {
    /// Begins with these plants. Places beyond the rim are taken modulo the size of the field.
    pub fn new(rules: Rules, stems: impl Iterator<Item = Stem>) -> Self {
        let field = Field::new(rules.size, rules.edge == Edge::Torus);
        let mut sites: Vec<Site> = Vec::with_capacity(stems.size_hint().0);
        sites.extend(stems.map(|stem| {
            let [x, y] = field.fraction([stem.x, stem.y]);
            Site { x, y, radius: stem.radius, id: stem.id }
        }));
        Self::with_sites(rules, sites)
    }

    /// Begins with plants as they lie on the field.
    pub(crate) fn with_sites(rules: Rules, sites: Vec<Site>) -> Self {
        let field = Field::new(rules.size, rules.edge == Edge::Torus);
        let tally = sites.par_chunks(RUN).map(tally).reduce(Tally::default, Tally::with);
        Self { rules, levels: Levels::new(field, sites), states: Vec::new(), tally }
    }

    /// Returns the plants as they lie on the field: all that a later step depends on.
    pub(crate) fn sites(&self) -> &Vec<Site> {
        &self.levels.sites
    }

    /// Returns how many plants live.
    pub fn len(&self) -> usize {
        self.levels.sites.len()
    }

    /// Returns whether nothing lives.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Returns the stand in numbers: as it was when the last deaths had happened and before growth,
    /// so that density and size are of one moment.
    pub fn tally(&self) -> Tally {
        self.tally
    }

    /// Compares circles: decides who is free, dominated or old. Nobody dies yet.
    pub fn look(&mut self) {
        let (levels, limit) = (&self.levels, self.rules.limit);
        let mut states = vec![FREE; levels.sites.len()];
        let is_open = if self.rules.order == Order::Sync { DOMINATED } else { OPEN };
        let look = |(sites, states): (&[Site], &mut [u8])| {
            for (site, state) in sites.iter().zip(states) {
                if levels.any_over(site, |_| true) {
                    *state = is_open;
                }
            }
        };
        levels.sites.par_chunks(RUN).zip(states.par_chunks_mut(RUN)).for_each(look);
        if self.rules.order == Order::Greedy {
            settle(levels, &mut states);
        }
        let age = |(site, state): (&Site, &mut u8)| {
            if *state == FREE && site.radius >= limit {
                *state = OLD;
            }
        };
        if limit < f32::INFINITY {
            levels.sites.par_iter().zip(&mut states).with_min_len(RUN).for_each(age);
        }
        self.states = states;
    }

    /// Returns how unequal those plants are that will live on: between [`Thinning::look`] and
    /// [`Thinning::advance`], the plants that [`Thinning::tally`] tells of afterwards.
    pub fn inequality(&self) -> Inequality {
        let lives = |index: usize| self.states.get(index).is_none_or(|state| *state == FREE);
        let sites = self.levels.sites.par_iter().enumerate().with_min_len(RUN);
        let radius = |(index, site): (usize, &Site)| lives(index).then_some(site.radius);
        Inequality::of_circles(sites.filter_map(radius).collect())
    }

    /// Returns the plants with their states, by id. Before [`Thinning::look`] all are free.
    pub fn stems(&self) -> Vec<(Stem, State)> {
        let field = self.levels.field();
        let stem = |(index, site): (usize, &Site)| {
            let [x, y] = field.place(site);
            let state = self.states.get(index).copied().and_then(State::from_u8);
            let stem = Stem { id: site.id, x, y, radius: site.radius };
            (stem, state.unwrap_or_default())
        };
        let mut stems: Vec<_> = self.levels.sites.par_iter().enumerate().map(stem).collect();
        stems.par_sort_unstable_by_key(|(stem, _)| stem.id);
        stems
    }

    /// Returns who will die by [`Thinning::advance`], by id.
    pub fn losses(&self) -> Vec<Loss> {
        let (levels, states) = (&self.levels, &self.states);
        let is_greedy = self.rules.order == Order::Greedy;
        let loss = |(site, state): (&Site, &u8)| match *state {
            DOMINATED => {
                let counts = |index: usize| !is_greedy || states[index] != DOMINATED;
                Some(Loss { id: site.id, killer: levels.greatest_over(site, counts) })
            }
            OLD => Some(Loss { id: site.id, killer: None }),
            _ => None,
        };
        let mut losses: Vec<Loss> = levels.sites.par_iter().zip(states).filter_map(loss).collect();
        losses.par_sort_unstable_by_key(|loss| loss.id);
        losses
    }

    /// Lets the dominated and the old die, and the others grow.
    pub fn advance(&mut self) {
        let growth = &self.rules.growth;
        // A part of its own, so that streams need no name, whose letters cost time.
        let seed = self.rules.seed.part("growth", 0);
        let grow = |site: &mut Site| {
            let rate = growth.rate_of(seed, u64::from(site.id));
            site.radius = growth.step(f64::from(site.radius), rate) as f32;
        };
        let tallies = self.levels.sweep(&self.states, FREE, grow, |sites, states| {
            let count = |state| states.iter().filter(|other| **other == state).count() as u64;
            Tally { dominated: count(DOMINATED), old: count(OLD), ..tally(sites) }
        });
        self.tally = tallies.into_iter().fold(Tally::default(), Tally::with);
        self.states = Vec::new();
    }

    /// Returns bytes held for each of `plants` while one step is made, at most: the plant, its
    /// state, its share of the grid, and a second copy while the grid is made. Its radius among those
    /// that [`Thinning::inequality`] measures is gone by then.
    pub const BYTES_A_PLANT: usize = 2 * size_of::<Site>() + 1 + 2 * size_of::<u32>();
}

fn tally(sites: &[Site]) -> Tally {
    let mut tally = Tally::default();
    sites.iter().for_each(|site| tally.add(site.radius));
    tally
}

/// Decides the open sites: alive if every larger circle that meets it is dead, dead if one lives.
///
/// Each round looks at the states of the round before, so that no result depends on threads; the
/// end is the same as taking plants by falling size.
fn settle(levels: &Levels, states: &mut [u8]) {
    let mut open: Vec<u32> =
        (0..states.len() as u32).filter(|&index| states[index as usize] == OPEN).collect();
    while !open.is_empty() {
        let decide = |&index: &u32| {
            let site = &levels.sites[index as usize];
            if levels.any_over(site, |other| states[other] == FREE) {
                return DOMINATED;
            }
            if levels.any_over(site, |other| states[other] == OPEN) { OPEN } else { FREE }
        };
        let decided: Vec<u8> = open.par_iter().with_min_len(RUN / 8).map(decide).collect();
        for (&index, &state) in open.iter().zip(&decided) {
            states[index as usize] = state;
        }
        let mut decided = decided.iter();
        open.retain(|_| decided.next() == Some(&OPEN));
    }
}
