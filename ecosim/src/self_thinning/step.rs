//! The step `self_thinning`: a stand of one species that thins itself on the terrain.

use super::{Loss, Rules, Stem, Thinning};
use crate::bytes::records;
use crate::checkpoint::{Begun, Course, Going, Moment};
use crate::config::{Edge, Order, check_kept};
use crate::growth::Growth;
use crate::levels;
use crate::stand::{Spot, Stand, is_size, settle};
use crate::steps::Site;
use crate::{Cause, Death, Error, Inequality, SummaryRow};
use rayon::prelude::*;
use std::f32::consts::TAU;
use weald_contract::{Plant, Problem, State, Written, table};

table! {
    /// Lets a stand of one species thin itself: of circles that intersect the smaller dies.
    ///
    /// Plants of the species that stand already take part; others are left as they are.
    pub struct SelfThinning {
        /// The species.
        species: Written<String>;
        /// Plants sown at the start, uniformly over the terrain.
        plants: u32 = 0, in 0.0..=1000000000.0;
        /// Least and greatest radius of those, m.
        radius: [f32; 2] = [0.01, 0.05], in 0.0..=1000.0;
        /// Steps to simulate.
        steps: Written<u32>, in 1.0..=1000000.0;
        /// How radii grow.
        growth: Growth = Growth::default();
        /// Radius at which a plant is old and dies, m; left out, never.
        limit: Option<f32> = None, in 0.0..=1000.0;
        /// Whether all deaths of a step happen at once.
        order: Order = Order::Sync;
        /// What lies beyond the rim; on a torus the pattern tiles.
        edge: Edge = Edge::Torus;
        /// Steps whose plants are kept in a table each, with the state in which they then stood.
        keep: Vec<Written<u32>> = Vec::new();
        /// Whether each death is noted with its killer.
        ledger: bool = true;
    }
}

impl SelfThinning {
    pub(crate) fn check(&self, problems: &mut Vec<Problem>) {
        if self.radius[0] > self.radius[1] {
            let problem = Problem::at(self.species.span, "`radius` falls: least comes first");
            problems.push(problem.hint("write `radius = [least, greatest]`"));
        }
        check_kept(&self.keep, self.steps.value, "step", problems);
    }
}

/// A stand part of the way through its steps.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Partway {
    /// Steps that are done.
    done: u32,
    /// The plants that live.
    sites: Vec<levels::Site>,
}

records! {
    Partway { done: u32, sites: Vec<levels::Site> }
    levels::Site { x: u32, y: u32, radius: f32, id: u32 }
}

/// Runs the step and puts its plants into the stand.
pub(crate) fn run(
    rules: &SelfThinning,
    ordinal: usize,
    site: &Site<'_>,
    stand: &mut Stand<'_>,
    course: &mut Course<'_>,
) -> Result<(), Error> {
    let species = stand.species_of(&rules.species)?;
    let steps = rules.steps.value;
    stand.check_room(u64::from(rules.plants), "sowing `plants`")?;
    site.progress.begin("self-thinning", u64::from(steps), "steps");
    let run = Run { rules, site, species, ids: ids(rules, site, stand, species) };
    let (mut thinning, done) = match course.begun.take() {
        Some(Begun::Steps(partway)) => run.resume(partway)?,
        Some(_) => return Err(Error::Unfit("it stopped in a step of another kind")),
        None => {
            let thinning = Thinning::new(run.rules_of_thinning(), run.stems(stand).into_iter());
            run.record(&thinning, thinning.inequality(), stand, u64::from(rules.plants));
            (thinning, 0)
        }
    };
    let years = stand.year.checked_sub(done);
    let first_year = years.ok_or(Error::Unfit("its years are not those of the step"))?;
    site.progress.advance(u64::from(done));
    for step in done..=steps {
        thinning.look();
        stand.year = first_year + step;
        if rules.keep.iter().any(|kept| kept.value == step) {
            stand.keep_a_picture(stand.year, run.plants(&thinning, stand));
        }
        if step == steps {
            break;
        }
        stand.year += 1;
        if rules.ledger {
            let deaths = thinning.losses().into_iter().map(|loss| run.death(loss, stand.year));
            stand.deaths.extend(deaths);
        }
        let sizes = thinning.inequality();
        thinning.advance();
        run.record(&thinning, sizes, stand, 0);
        site.progress.advance(1);
        let going = Going::Steps { done: step + 1, sites: thinning.sites() };
        course.rest(site, 1, &Moment { ordinal, stand, going })?;
    }
    let living = run.plants(&thinning, stand);
    stand.succeed(living, |other| other == species);
    Ok(())
}

/// Ids of the plants that stand and of those to be sown, by rising id: a plant's number in the
/// simulation is its place in this list, so that of equals the lower id wins.
fn ids(rules: &SelfThinning, site: &Site<'_>, stand: &Stand<'_>, species: u16) -> Vec<u64> {
    let own = stand.population.plants.iter().filter(|plant| plant.species == species);
    let sown = (0..u64::from(rules.plants)).map(|counter| site.ids.id(counter));
    let mut ids: Vec<u64> = own.map(|plant| plant.id).chain(sown).collect();
    ids.par_sort_unstable();
    ids
}

struct Run<'a, 'b> {
    rules: &'a SelfThinning,
    site: &'a Site<'b>,
    species: u16,
    ids: Vec<u64>,
}

impl Run<'_, '_> {
    fn size(&self) -> [f64; 2] {
        let frame = self.site.ground.frame();
        [frame.east() - frame.west, frame.north() - frame.south]
    }

    fn rules_of_thinning(&self) -> Rules {
        Rules {
            size: self.size(),
            edge: self.rules.edge,
            order: self.rules.order,
            growth: self.rules.growth.clone(),
            limit: self.rules.limit.unwrap_or(f32::INFINITY),
            seed: self.site.seed,
        }
    }

    /// Goes on from what a checkpoint holds; returns the steps that are done as well.
    fn resume(&self, Partway { done, sites }: Partway) -> Result<(Thinning, u32), Error> {
        let is_sound =
            |site: &levels::Site| (site.id as usize) < self.ids.len() && is_size(site.radius);
        if done > self.rules.steps.value || !sites.iter().all(is_sound) {
            return Err(Error::Unfit("its steps or plants are not those of the step"));
        }
        Ok((Thinning::with_sites(self.rules_of_thinning(), sites), done))
    }

    fn stems(&self, stand: &Stand<'_>) -> Vec<Stem> {
        let (frame, plants) = (self.site.ground.frame(), &stand.population.plants);
        let [width, height] = self.size();
        let stem = |(number, &id): (usize, &u64)| {
            let number = number as u32;
            if let Ok(row) = plants.binary_search_by_key(&id, |plant| plant.id) {
                let Plant { x, y, radius, .. } = plants[row];
                return Stem { id: number, x: x - frame.west, y: y - frame.south, radius };
            }
            let mut chance = self.site.seed.stream("stem", id);
            let [x, y] = [chance.range(0.0, width), chance.range(0.0, height)];
            let [least, greatest] = self.rules.radius.map(f64::from);
            Stem { id: number, x, y, radius: chance.range(least, greatest) as f32 }
        };
        self.ids.par_iter().enumerate().map(stem).collect()
    }

    fn death(&self, loss: Loss, step: u32) -> Death {
        let killer = loss.killer.map(|killer| self.ids[killer as usize]);
        let cause = if killer.is_some() { Cause::Dominated } else { Cause::Old };
        Death { id: self.ids[loss.id as usize], species: self.species, step, cause, killer }
    }

    /// Adds a row to the summary.
    fn record(&self, thinning: &Thinning, sizes: Inequality, stand: &mut Stand<'_>, births: u64) {
        let tally = thinning.tally();
        stand.summary.push(SummaryRow {
            step: stand.year,
            species: self.species,
            alive: tally.alive,
            births,
            dominated: tally.dominated,
            old: tally.old,
            disturbed: 0,
            mean_radius: tally.mean_radius() as f32,
            cover: (tally.area() / self.site.ground.area()) as f32,
            seeds: 0,
            sizes,
        });
    }

    /// Returns the plants as they stand, by id.
    fn plants(&self, thinning: &Thinning, stand: &Stand<'_>) -> Vec<Plant> {
        let (kind, before) = (stand.kind(self.species), &stand.population.plants);
        let frame = self.site.ground.frame();
        let plant = |(stem, state): (Stem, State)| {
            let id = self.ids[stem.id as usize];
            let height = kind.size.height_of_radius(stem.radius);
            if let Ok(row) = before.binary_search_by_key(&id, |plant| plant.id) {
                let height = height.max(before[row].height);
                return Plant { radius: stem.radius, height, state, ..before[row] };
            }
            let yaw = self.site.seed.stream("yaw", id).unit() as f32 * TAU;
            let (x, y) = (frame.west + stem.x, frame.south + stem.y);
            let age = kind.size.age_of_height(height, 1.0);
            let spot = Spot { id, x, y, age, vigor: 1.0, yaw };
            let plant = settle(&self.site.ground, &kind, self.species, spot);
            Plant { radius: stem.radius, height, state, ..plant }
        };
        thinning.stems().into_par_iter().map(plant).collect()
    }
}
