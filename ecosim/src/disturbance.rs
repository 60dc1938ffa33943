//! What kills plants from outside: fire, wind, axe and scythe.
//!
//! A disturbance comes in years that are named, or by chance, strikes the whole ground or discs of
//! it, and kills each plant that it strikes with a probability that may follow the ground. It
//! opens the gaps in which others come up [Watt47].

use crate::Error;
use crate::field::BoundFormula;
use crate::simulate::Grower;
use crate::stand::Stand;
use rayon::prelude::*;
use weald_contract::{Formula, Frame, Layers, Problem, Seed, Written, table, words};

words! {
    /// What a disturbance is, as the ledger of deaths names it.
    pub enum Agent {
        /// Fire.
        Fire = "fire",
        /// Wind.
        Wind = "wind",
        /// Felling.
        Logging = "logging",
        /// Mowing.
        Mowing = "mowing",
        /// Grazing animals.
        Grazing = "grazing",
        /// High water.
        Flood = "flood",
        /// Drought.
        Drought = "drought",
        /// Pests and diseases.
        Pest = "pest",
    }
}

impl Agent {
    /// All, in the order of their numbers.
    pub(crate) const ALL: [Self; 8] = [
        Self::Fire,
        Self::Wind,
        Self::Logging,
        Self::Mowing,
        Self::Grazing,
        Self::Flood,
        Self::Drought,
        Self::Pest,
    ];
}

table! {
    /// What kills plants besides age and shade; `years`, `interval` or both say when.
    pub struct Disturbance {
        /// What it is, as the ledger of deaths names it.
        agent: Written<Agent>;
        /// Years of the step in which it comes, from 1.
        years: Vec<Written<u32>> = Vec::new();
        /// Mean number of years from one to the next, where it comes by chance: each year with
        /// probability 1 / interval.
        interval: Option<f64> = None, in 1.0..=1000000.0;
        /// Least and greatest radius of the ground that is struck, m; left out, the whole terrain.
        radius: Option<Written<[f64; 2]>> = None, in 0.0..=1000000.0;
        /// Discs of ground that are struck each time.
        discs: u32 = 1, in 1.0..=1000000.0;
        /// Chance that a plant which is struck dies: a formula, or a number; left out, 1.
        mortality: Option<Written<Formula>> = None;
        /// Least and greatest height of the plants that may die, m.
        height: Written<[f32; 2]> = Written { value: [0.0, 10000.0], span: Default::default() }, in 0.0..=10000.0;
        /// The species that may die; none named means all of the step.
        species: Vec<Written<String>> = Vec::new();
    }
}

impl Disturbance {
    pub(crate) fn check(
        &self,
        of_step: &[Written<String>],
        last: u32,
        problems: &mut Vec<Problem>,
    ) {
        if self.years.is_empty() && self.interval.is_none() {
            let problem = Problem::at(self.agent.span, "this disturbance never comes");
            problems.push(problem.hint("give `years = [20, 40]`, or `interval`, years"));
        }
        for year in self.years.iter().filter(|year| !(1..=last).contains(&year.value)) {
            let message = format!("year {} is never reached", year.value);
            let hint = format!("the simulation has the years 1 to {last}");
            problems.push(Problem::at(year.span, message).hint(hint));
        }
        for name in self.species.iter().filter(|name| !of_step.contains(name)) {
            let message = format!("species `{}` takes no part in this step", name.value);
            problems.push(Problem::at(name.span, message).hint("name it in the step's `species`"));
        }
        let falls = self.radius.iter().any(|radius| radius.value[0] > radius.value[1]);
        if let (true, Some(radius)) = (falls, &self.radius) {
            let problem = Problem::at(radius.span, "`radius` falls: least comes first");
            problems.push(problem.hint("write `radius = [least, greatest]`"));
        }
        if self.height.value[0] > self.height.value[1] {
            let problem = Problem::at(self.height.span, "`height` falls: least comes first");
            problems.push(problem.hint("write `height = [least, greatest]`"));
        }
    }
}

/// A disturbance on this ground.
pub(crate) struct Striking<'a> {
    rules: &'a Disturbance,
    mortality: Option<BoundFormula<'a>>,
    /// Whether each participant may die.
    concerns: Vec<bool>,
    /// Root of its chance.
    seed: Seed,
}

impl<'a> Striking<'a> {
    /// Binds the disturbances of a step whose species are `names`.
    pub(crate) fn all(
        rules: &'a [Disturbance],
        names: &[Written<String>],
        terrain: &'a Layers,
        stand: &Stand<'a>,
        seed: Seed,
    ) -> Result<Vec<Self>, Error> {
        let one = |(number, rules): (usize, &'a Disturbance)| {
            let bind = |formula| BoundFormula::bind(formula, terrain, stand);
            let is_meant = |name| rules.species.is_empty() || rules.species.contains(name);
            Ok(Self {
                rules,
                mortality: rules.mortality.as_ref().map(bind).transpose()?,
                concerns: names.iter().map(is_meant).collect(),
                seed: seed.part("disturbance", number as u64),
            })
        };
        rules.iter().enumerate().map(one).collect()
    }

    pub(crate) fn agent(&self) -> Agent {
        self.rules.agent.value
    }

    /// Returns whether it comes in a year, the `ordinal`-th of the step from 1.
    pub(crate) fn comes(&self, ordinal: u32, year: u32) -> bool {
        let is_named = self.rules.years.iter().any(|named| named.value == ordinal);
        let by_chance =
            |interval: f64| self.seed.stream("year", u64::from(year)).unit() * interval < 1.0;
        is_named || self.rules.interval.is_some_and(by_chance)
    }

    /// Returns the discs that it strikes in a year, centre and radius; none means everywhere.
    fn discs(&self, frame: &Frame, year: u32) -> Vec<[f64; 3]> {
        let Some(radius) = &self.rules.radius else { return Vec::new() };
        let [least, greatest] = radius.value;
        let seed = self.seed.part("discs", u64::from(year));
        let disc = |number| {
            let mut stream = seed.stream("", number);
            let x = stream.range(frame.west, frame.east());
            let y = stream.range(frame.south, frame.north());
            [x, y, stream.range(least, greatest)]
        };
        (0..u64::from(self.rules.discs)).map(disc).collect()
    }

    /// Returns which of the plants die in a year; `heights` are theirs, and on a torus discs reach
    /// over the rim.
    ///
    /// # Errors
    /// When the mortality has no value somewhere.
    pub(crate) fn doomed(
        &self,
        growers: &[Grower],
        heights: impl Fn(&Grower) -> f32 + Sync,
        (frame, is_torus): (&Frame, bool),
        year: u32,
    ) -> Result<Vec<bool>, Error> {
        let discs = self.discs(frame, year);
        let size = [frame.east() - frame.west, frame.north() - frame.south];
        let apart = |a: f64, b: f64, size: f64| {
            let apart = (a - b).abs();
            if is_torus { apart.min(size - apart) } else { apart }
        };
        let is_within = |plant: &Grower, [x, y, radius]: &[f64; 3]| {
            let (dx, dy) = (apart(plant.x, *x, size[0]), apart(plant.y, *y, size[1]));
            dx * dx + dy * dy <= radius * radius
        };
        let [least, greatest] = self.rules.height.value;
        let is_struck = |plant: &Grower| {
            self.concerns[usize::from(plant.who)]
                && (least..=greatest).contains(&heights(plant))
                && (self.rules.radius.is_none() || discs.iter().any(|disc| is_within(plant, disc)))
        };
        let struck: Vec<bool> = growers.par_iter().map(is_struck).collect();
        let Some(mortality) = &self.mortality else { return Ok(struck) };
        // Only where a plant is struck must the formula have a value.
        let indices: Vec<usize> = (0..growers.len()).filter(|&index| struck[index]).collect();
        let place = |index: usize| [growers[indices[index]].x, growers[indices[index]].y];
        let chances = mortality.numbers(indices.len(), place)?;
        let luck = self.seed.part("deaths", u64::from(year));
        let mut doomed = vec![false; growers.len()];
        for (index, chance) in indices.into_iter().zip(chances) {
            doomed[index] = luck.stream("", growers[index].id).unit() < f64::from(chance);
        }
        Ok(doomed)
    }
}
