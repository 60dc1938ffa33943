//! The multi-species simulation: years of seedlings, growth, competition and death.
//!
//! The circle model of [Deussen98]. A year goes as follows:
//!
//! 1. plants that have reached the lifespan of their species die of old age;
//! 2. disturbances strike, in the order in which they are written;
//! 3. seeds fall, from mature plants by the kernel of their species and from afar anywhere; of
//!    those in the ground where their species can stand a part germinates, and takes hold with
//!    the step's `chance`; each seedling draws its vigor ([`Ecology::vigor`]);
//! 4. everyone grows a year older and to the radius that `[size]` gives for age and vigor;
//! 5. where circles intersect, the plant of smaller competitive ability, vigor times radius over
//!    the species' greatest radius, is dominated and dies with probability 1 - survival.
//!
//! Plants of the same species that stand already take part. All chance comes from streams keyed
//! by plant and year.

mod life;
mod run;

pub(crate) use life::{Grower, Life};
pub(crate) use run::run;

use crate::competition::{Circle, Plain, dominators};
use crate::config::{Edge, Order, Simulate};
use crate::disturbance::Striking;
use crate::field::BoundFormula;
use crate::ground::Ground;
use crate::ids::{IdSource, Tags};
use crate::seeds::{self, DormantSeed};
use crate::species::Ecology;
use crate::stand::{Kind, Stand};
use crate::steps::Site;
use crate::{Cause, Death, Error, Inequality, Surroundings};
use rayon::prelude::*;
use std::f64::consts::PI;
use std::ops::Range;
use weald_contract::{Population, Seed, Silent, Size, State};

/// Attempts to find a place for a plant of the start before it is given up.
const ATTEMPTS: usize = 100;
/// Longest table of growth by age, years; older plants compute.
const LONGEST_TABLE: usize = 4096;
/// Plants whose numbers are added up together; fixed, so that sums do not depend on threads.
const BATCH: usize = 4096;
/// Square metres in a hectare.
const HECTARE: f64 = 1e4;

/// A species in the simulation.
#[derive(Debug)]
struct Participant<'a> {
    /// Index in the population.
    species: u16,
    kind: Kind<'a>,
    /// Radius at each whole age as a part of the full radius.
    growth: Vec<f32>,
}

impl<'a> Participant<'a> {
    fn new(species: u16, kind: Kind<'a>) -> Self {
        let years = (kind.size.lifespan.ceil() as usize + 2).min(LONGEST_TABLE);
        let growth = (0..years).map(|age| part_grown(kind.size, age as f32)).collect();
        Self { species, kind, growth }
    }

    /// Returns the radius at an age: the table holds what `[size]` gives, since radius is a
    /// power of height and height a product of parts for age and for vigor.
    fn radius(&self, age: f32, full_radius: f32) -> f32 {
        let row = if age.fract() == 0.0 { self.growth.get(age as usize) } else { None };
        full_radius * row.copied().unwrap_or_else(|| part_grown(self.kind.size, age))
    }

    fn full_radius(&self, vigor: f32) -> f32 {
        self.kind.size.radius_at(f32::INFINITY, vigor)
    }

    fn ability(&self, plant: &Grower) -> f32 {
        plant.vigor * (plant.radius / self.kind.size.crown_radius)
    }
}

fn part_grown(size: &Size, age: f32) -> f32 {
    size.radius_at(age, 1.0) / size.radius_at(f32::INFINITY, 1.0)
}

/// What happened to one species in one year.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Year {
    /// Plants alive at the end.
    pub alive: u64,
    /// Seedlings that took hold.
    pub births: u64,
    /// Deaths under a stronger plant.
    pub dominated: u64,
    /// Deaths of old age.
    pub old: u64,
    /// Deaths by a disturbance.
    pub disturbed: u64,
    /// Sum of the radii of those alive, m.
    pub radius_sum: f64,
    /// Sum of the areas of their circles, m².
    pub area_sum: f64,
    /// Seeds that lie in the ground at the end.
    pub seeds: u64,
    /// How unequal the areas of their circles are.
    pub sizes: Inequality,
}

/// A simulation that can be stepped year by year.
pub struct Simulation<'a> {
    ground: Ground<'a>,
    participants: Vec<Participant<'a>>,
    chance: Option<BoundFormula<'a>>,
    disturbances: Vec<Striking<'a>>,
    /// Year before the first one.
    start: u32,
    rules: &'a Simulate,
    seed: Seed,
    ids: IdSource,
    life: Life,
}

impl<'a> Simulation<'a> {
    /// Begins a simulation on bare ground, with the plants that the step sows at the start.
    ///
    /// # Errors
    /// An unknown species, or a terrain without what the step's formula reads.
    pub fn new(rules: &'a Simulate, around: &Surroundings<'a>, seed: Seed) -> Result<Self, Error> {
        let mut stand = Stand::new(around, None, u64::MAX)?;
        let ids = Tags::default().take(None, 0);
        let ground = Ground::new(around.terrain)?;
        let site =
            Site { ground, around: *around, seed, shared_seed: seed, ids, progress: &Silent };
        Self::begin(rules, &site, &mut stand)
    }

    fn begin(rules: &'a Simulate, site: &Site<'a>, stand: &mut Stand<'a>) -> Result<Self, Error> {
        let mut participants = Vec::new();
        for name in &rules.species {
            let species = stand.species_of(name)?;
            participants.push(Participant::new(species, stand.kind(species)));
        }
        let bind = |formula| BoundFormula::bind(formula, site.around.terrain, stand);
        let of = |participant: &Participant<'_>| {
            let is_own = |seed: &&DormantSeed| seed.species == participant.species;
            stand.bank.iter().filter(is_own).copied().collect()
        };
        let mut simulation = Self {
            life: Life {
                year: stand.year,
                sown: 0,
                growers: Vec::new(),
                bank: participants.iter().map(of).collect(),
                deaths: Vec::new(),
            },
            ground: site.ground.clone(),
            chance: rules.chance.as_ref().map(bind).transpose()?,
            disturbances: Striking::all(
                &rules.disturbance,
                &rules.species,
                site.around.terrain,
                stand,
                site.seed,
            )?,
            start: stand.year,
            participants,
            rules,
            seed: site.seed,
            ids: site.ids,
        };
        simulation.admit(&stand.population);
        Ok(simulation)
    }

    /// Takes in the plants that stand already.
    fn admit(&mut self, population: &Population) {
        for plant in &population.plants {
            let species = |p: &Participant<'_>| p.species == plant.species;
            let Some(who) = self.participants.iter().position(species) else { continue };
            self.life.growers.push(Grower {
                id: plant.id,
                x: plant.x,
                y: plant.y,
                age: plant.age,
                vigor: plant.vigor,
                radius: plant.radius,
                full_radius: self.participants[who].full_radius(plant.vigor),
                who: who as u16,
                state: plant.state,
                is_settler: true,
            });
        }
    }

    /// Returns the number of plants alive.
    pub fn len(&self) -> usize {
        self.life.growers.len()
    }

    /// Returns whether nothing grows.
    pub fn is_empty(&self) -> bool {
        self.life.growers.is_empty()
    }

    /// Returns the circles of the plants: those found at the start by id, then by arrival.
    pub fn circles(&self) -> Vec<Circle> {
        let (west, south) = (self.ground.frame().west, self.ground.frame().south);
        let circle = |plant: &Grower| Circle {
            x: plant.x - west,
            y: plant.y - south,
            radius: plant.radius,
            ability: self.participants[usize::from(plant.who)].ability(plant),
        };
        self.life.growers.par_iter().map(circle).collect()
    }

    /// Sows the plants of the start; those that find no place in a hundred attempts are
    /// given up.
    pub fn sow(&mut self) -> Vec<Year> {
        let mut years = vec![Year::default(); self.participants.len()];
        for (who, year) in years.iter_mut().enumerate() {
            let first = self.life.sown;
            self.life.sown += u64::from(self.rules.initial);
            let ids = self.ids;
            let sown: Vec<Grower> = (0..self.rules.initial)
                .into_par_iter()
                .filter_map(|n| self.settler(who, ids.id(first + u64::from(n))))
                .collect();
            year.births = sown.len() as u64;
            self.life.growers.extend(sown);
        }
        self.count(&mut years);
        years
    }

    fn settler(&self, who: usize, id: u64) -> Option<Grower> {
        let ecology = self.participants[who].kind.ecology;
        let mut stream = self.seed.stream("settler", id);
        let places = std::iter::repeat_with(|| self.anywhere(&mut stream)).take(ATTEMPTS);
        let [x, y] = places.into_iter().find(|&[x, y]| self.ground.bears(ecology, x, y))?;
        let [youngest, oldest] = self.rules.initial_age.map(f64::from);
        let age = self.seed.stream("age", id).range(youngest, oldest + 1.0).floor();
        Some(self.grower(who, id, [x, y], age.min(oldest) as f32))
    }

    fn anywhere(&self, stream: &mut weald_contract::Stream) -> [f64; 2] {
        let frame = self.ground.frame();
        [stream.range(frame.west, frame.east()), stream.range(frame.south, frame.north())]
    }

    fn grower(&self, who: usize, id: u64, [x, y]: [f64; 2], age: f32) -> Grower {
        let participant = &self.participants[who];
        let ecology = participant.kind.ecology;
        let vigor = ecology.vigor(self.ground.suitability(ecology, x, y), self.seed, id);
        let full_radius = participant.full_radius(vigor);
        let radius = participant.radius(age, full_radius);
        let (who, state, is_settler) = (who as u16, State::Free, false);
        Grower { id, x, y, age, vigor, radius, full_radius, who, state, is_settler }
    }

    /// Lives through one year and says what happened to each species.
    ///
    /// # Errors
    /// When the step's `chance`, or the mortality of a disturbance, has no value somewhere.
    pub fn step(&mut self) -> Result<Vec<Year>, Error> {
        self.life.year += 1;
        let mut years = vec![Year::default(); self.participants.len()];
        self.die_of_age(&mut years);
        self.suffer(&mut years)?;
        self.germinate(&mut years)?;
        self.grow_older();
        self.compete(&mut years);
        self.count(&mut years);
        Ok(years)
    }

    fn die_of_age(&mut self, years: &mut [Year]) {
        let is_old = |plant: &Grower| {
            plant.age >= self.participants[usize::from(plant.who)].kind.size.lifespan
        };
        let doomed: Vec<Option<Option<u64>>> =
            self.life.growers.par_iter().map(|plant| is_old(plant).then_some(None)).collect();
        self.bury(&doomed, Cause::Old, |who| years[who].old += 1);
    }

    /// Lets disturbances strike.
    fn suffer(&mut self, years: &mut [Year]) -> Result<(), Error> {
        for number in 0..self.disturbances.len() {
            let striking = &self.disturbances[number];
            let year = self.life.year;
            if !striking.comes(year - self.start, year) {
                continue;
            }
            let height = |plant: &Grower| {
                let size = self.participants[usize::from(plant.who)].kind.size;
                size.height_at(plant.age, plant.vigor)
            };
            let ground = (self.ground.frame(), self.rules.edge == Edge::Torus);
            let doomed = striking.doomed(&self.life.growers, height, ground, year)?;
            let cause = Cause::Disturbed(striking.agent());
            let doomed: Vec<Option<Option<u64>>> =
                doomed.into_iter().map(|dies| dies.then_some(None)).collect();
            self.bury(&doomed, cause, |who| years[who].disturbed += 1);
        }
        Ok(())
    }

    /// Removes the plants with an entry, which may name a killer.
    fn bury(&mut self, doomed: &[Option<Option<u64>>], cause: Cause, mut tally: impl FnMut(usize)) {
        for (plant, fate) in self.life.growers.iter().zip(doomed) {
            let Some(killer) = *fate else { continue };
            let who = usize::from(plant.who);
            tally(who);
            let (id, step) = (plant.id, self.life.year);
            let species = self.participants[who].species;
            self.life.deaths.push(Death { id, species, step, cause, killer });
        }
        let mut fates = doomed.iter();
        self.life.growers.retain(|_| fates.next().is_none_or(Option::is_none));
    }

    /// Returns the number of seeds that the coming year is expected to bring, of all species,
    /// with those that lie in the ground.
    fn seeds_expected(&self) -> f64 {
        let borne = |batch: &[Grower]| batch.iter().map(|plant| self.crop_of(plant)).sum();
        let borne: Vec<f64> = self.life.growers.par_chunks(BATCH).map(borne).collect();
        let afar = self.participants.iter().map(|p| self.seeds_from_afar(p.kind.ecology));
        let waiting: usize = self.life.bank.iter().map(Vec::len).sum();
        afar.sum::<f64>() + borne.iter().sum::<f64>() + waiting as f64
    }

    fn seeds_from_afar(&self, ecology: &Ecology) -> f64 {
        f64::from(ecology.seedlings) * self.ground.area() / HECTARE
    }

    /// Returns the mean number of seeds that a plant bears in a year.
    fn crop_of(&self, plant: &Grower) -> f64 {
        let ecology = self.participants[usize::from(plant.who)].kind.ecology;
        let is_mature = plant.age >= ecology.maturity;
        let radius = f64::from(plant.radius);
        if is_mature { f64::from(ecology.seeds) * PI * radius * radius } else { 0.0 }
    }

    fn germinate(&mut self, years: &mut [Year]) -> Result<(), Error> {
        for (who, year) in years.iter_mut().enumerate() {
            let ecology = self.participants[who].kind.ecology;
            let mut ground = std::mem::take(&mut self.life.bank[who]);
            ground.extend(self.fall(who));
            let luck = self.seed.part("germination", u64::from(self.life.year));
            let (sprouting, waiting) =
                seeds::part(ground, ecology.germination, ecology.dormancy, luck);
            self.life.bank[who] = waiting;
            let born: Vec<Grower> = self
                .take_hold(sprouting)?
                .into_par_iter()
                .map(|seed| self.grower(who, seed.id, [seed.x, seed.y], 0.0))
                .collect();
            year.births += born.len() as u64;
            self.life.growers.extend(born);
        }
        Ok(())
    }

    /// Returns the seeds of one species that fall this year where it can stand: those from afar,
    /// then those of each mother.
    fn fall(&mut self, who: usize) -> Vec<DormantSeed> {
        let ecology = self.participants[who].kind.ecology;
        let crop = ecology
            .mast
            .as_ref()
            .map_or(1.0, |mast| mast.crop(self.seed.part("mast", who as u64), self.life.year));
        let expected = self.seeds_from_afar(ecology) * crop;
        let mut stream = self.seed.part("seeds", u64::from(self.life.year)).stream("", who as u64);
        let from_afar = (expected + stream.unit()).floor() as u64;
        let mothers = if ecology.seeds > 0.0 { self.mothers(who, crop) } else { Vec::new() };
        let first = self.life.sown;
        let mut fallen = self.land(who, first..first + from_afar, None);
        let mut next = first + from_afar;
        let mut litters = Vec::with_capacity(mothers.len());
        for (mother, count) in mothers {
            litters.push((mother, next..next + count));
            next += count;
        }
        let land = |(mother, seeds): &(usize, Range<u64>)| {
            self.land(who, seeds.clone(), Some(&self.life.growers[*mother]))
        };
        let litters: Vec<Vec<DormantSeed>> = litters.par_iter().map(land).collect();
        fallen.extend(litters.into_iter().flatten());
        self.life.sown = next;
        fallen
    }

    /// Returns the plants of a species that bear seeds this year, by index, and how many each.
    fn mothers(&self, who: usize, crop: f64) -> Vec<(usize, u64)> {
        let luck = self.seed.part("crop", u64::from(self.life.year));
        let seeds_of = |(index, plant): (usize, &Grower)| {
            if usize::from(plant.who) != who {
                return None;
            }
            let expected = self.crop_of(plant) * crop;
            let count = (expected + luck.stream("", plant.id).unit()).floor() as u64;
            (count > 0).then_some((index, count))
        };
        self.life.growers.par_iter().enumerate().filter_map(seeds_of).collect()
    }

    /// Returns the seeds, of those with these numbers, that land where the species can stand:
    /// about a mother by the species' kernel, or anywhere.
    fn land(&self, who: usize, numbers: Range<u64>, mother: Option<&Grower>) -> Vec<DormantSeed> {
        let Participant { species, kind, .. } = &self.participants[who];
        let kernel = mother.and_then(|mother| Some((mother, kind.ecology.dispersal.as_ref()?)));
        let land = |number| {
            let id = self.ids.id(number);
            let mut stream = self.seed.stream("seedling", id);
            let [x, y] = match kernel {
                Some((mother, kernel)) => {
                    let height = f64::from(kind.size.height_at(mother.age, mother.vigor));
                    let [east, north] = kernel.offset(height, &mut stream);
                    self.within_rims(mother.x + east, mother.y + north)
                }
                None => self.anywhere(&mut stream),
            };
            let lands = self.ground.bears(kind.ecology, x, y);
            lands.then_some(DormantSeed { id, species: *species, x, y })
        };
        numbers.into_par_iter().filter_map(land).collect()
    }

    /// Brings a place back onto a torus; on open ground it may lie outside.
    fn within_rims(&self, x: f64, y: f64) -> [f64; 2] {
        let frame = self.ground.frame();
        match self.rules.edge {
            Edge::Open => [x, y],
            Edge::Torus => {
                let along = |at: f64, from: f64, to: f64| from + (at - from).rem_euclid(to - from);
                [along(x, frame.west, frame.east()), along(y, frame.south, frame.north())]
            }
        }
    }

    /// Returns the seeds that the step's `chance` lets live.
    fn take_hold(&self, sprouting: Vec<DormantSeed>) -> Result<Vec<DormantSeed>, Error> {
        let Some(chance) = &self.chance else { return Ok(sprouting) };
        let place = |index: usize| [sprouting[index].x, sprouting[index].y];
        let chances = chance.numbers(sprouting.len(), place)?;
        let drawn = |id: u64| self.seed.stream("chance", id).unit() as f32;
        let pairs = sprouting.into_iter().zip(chances);
        let kept = pairs.filter(|(seed, chance)| drawn(seed.id) < *chance);
        Ok(kept.map(|(seed, _)| seed).collect())
    }

    fn grow_older(&mut self) {
        let participants = &self.participants;
        self.life.growers.par_iter_mut().with_min_len(BATCH).for_each(|plant| {
            plant.age += 1.0;
            let grown = participants[usize::from(plant.who)].radius(plant.age, plant.full_radius);
            // A plant handed in larger than its age says keeps its size until it has caught up.
            plant.radius = plant.radius.max(grown);
        });
    }

    fn compete(&mut self, years: &mut [Year]) {
        let luck = self.seed.part("survival", u64::from(self.life.year));
        let (growers, participants) = (&self.life.growers, &self.participants);
        let survives = |index: usize| {
            let plant: &Grower = &growers[index];
            let survival = participants[usize::from(plant.who)].kind.ecology.survival;
            luck.stream("", plant.id).unit() < f64::from(survival)
        };
        let stronger = dominators(&self.circles(), self.plain(), self.rules.order, survives);
        let fate = |(index, stronger): (usize, &Option<u32>)| {
            let killer = growers[(*stronger)? as usize].id;
            (!survives(index)).then_some(Some(killer))
        };
        let doomed: Vec<Option<Option<u64>>> = stronger.par_iter().enumerate().map(fate).collect();
        self.mark(&stronger);
        self.bury(&doomed, Cause::Dominated, |who| years[who].dominated += 1);
    }

    /// Compares the plants and notes how each stands, without a death.
    pub(crate) fn look(&mut self) {
        let stronger = dominators(&self.circles(), self.plain(), Order::Sync, |_| true);
        self.mark(&stronger);
    }

    fn plain(&self) -> Plain {
        let frame = self.ground.frame();
        match self.rules.edge {
            Edge::Open => Plain::Open,
            Edge::Torus => Plain::Torus([frame.east() - frame.west, frame.north() - frame.south]),
        }
    }

    /// Notes how each plant stands after competition.
    fn mark(&mut self, stronger: &[Option<u32>]) {
        let participants = &self.participants;
        self.life.growers.par_iter_mut().zip(stronger).for_each(|(plant, stronger)| {
            let lifespan = participants[usize::from(plant.who)].kind.size.lifespan;
            plant.state = match stronger {
                _ if plant.age >= lifespan => State::Old,
                Some(_) => State::Dominated,
                None => State::Free,
            };
        });
    }

    /// Fills in what is alive.
    fn count(&self, years: &mut [Year]) {
        let tally = |batch: &[Grower]| {
            let mut sums = vec![(0u64, 0.0f64, 0.0f64); self.participants.len()];
            for plant in batch {
                let (alive, radii, areas) = &mut sums[usize::from(plant.who)];
                let radius = f64::from(plant.radius);
                *alive += 1;
                *radii += radius;
                *areas += PI * radius * radius;
            }
            sums
        };
        let batches: Vec<_> = self.life.growers.par_chunks(BATCH).map(tally).collect();
        for (who, (alive, radii, areas)) in
            batches.iter().flat_map(|sums| sums.iter().copied().enumerate())
        {
            years[who].alive += alive;
            years[who].radius_sum += radii;
            years[who].area_sum += areas;
        }
        let mut radii = vec![Vec::new(); self.participants.len()];
        for plant in &self.life.growers {
            radii[usize::from(plant.who)].push(plant.radius);
        }
        let sizes: Vec<Inequality> = radii.into_par_iter().map(Inequality::of_circles).collect();
        for ((year, bank), sizes) in years.iter_mut().zip(&self.life.bank).zip(sizes) {
            (year.seeds, year.sizes) = (bank.len() as u64, sizes);
        }
    }
}
