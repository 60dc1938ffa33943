//! The step `simulate`: years of a [`Simulation`] on the plants so far.

use super::life::{Grower, Life};
use super::{Simulation, Year};
use crate::checkpoint::{Begun, Course, Going, Moment};
use crate::config::Simulate;
use crate::stand::{Spot, Stand, settle};
use crate::steps::Site;
use crate::{Error, SummaryRow};
use rayon::prelude::*;
use std::f32::consts::TAU;
use weald_contract::Plant;

/// Runs the step and puts its plants into the stand.
pub(crate) fn run<'a>(
    rules: &'a Simulate,
    ordinal: usize,
    site: &Site<'a>,
    stand: &mut Stand<'a>,
    course: &mut Course<'_>,
) -> Result<(), Error> {
    let years = rules.years.value;
    site.progress.begin("simulate", u64::from(years), "years");
    let mut simulation = Simulation::begin(rules, site, stand)?;
    let bystanders = (stand.population.len() - simulation.len()) as u64;
    let done = match course.begun.take() {
        Some(Begun::Years(life)) => resume(&mut simulation, life, stand)?,
        Some(_) => return Err(Error::Unfit("it stopped in a step of another kind")),
        None => {
            begin(&mut simulation, site, stand)?;
            0
        }
    };
    site.progress.advance(u64::from(done));
    for year in done + 1..=years {
        stand.check_room(simulation.seeds_expected() as u64, "the seeds of one year")?;
        let happened = simulation.step()?;
        let in_all = simulation.len() as u64 + bystanders;
        stand.check_room(in_all.saturating_sub(stand.population.len() as u64), "the simulation")?;
        record(&simulation, &happened, stand);
        keep(&simulation, year, site, stand);
        site.progress.advance(1);
        let going = Going::Years(&simulation.life);
        course.rest(site, 1, &Moment { ordinal, stand, going })?;
    }
    hand_over(simulation, site, stand);
    Ok(())
}

/// Sows the plants of the start.
fn begin(
    simulation: &mut Simulation<'_>,
    site: &Site<'_>,
    stand: &mut Stand<'_>,
) -> Result<(), Error> {
    let rules = simulation.rules;
    let sown = u64::from(rules.initial) * rules.species.len() as u64;
    stand.check_room(sown, "sowing `initial` plants")?;
    stand.check_room(simulation.seeds_expected() as u64, "the seeds of one year")?;
    let start = simulation.sow();
    if !is_as_recorded(simulation, &start, stand) {
        record(simulation, &start, stand);
    }
    if rules.keep.iter().any(|kept| kept.value == 0) {
        simulation.look();
        keep(simulation, 0, site, stand);
    }
    Ok(())
}

/// Goes on from what a checkpoint holds; returns the years that are done.
fn resume(simulation: &mut Simulation<'_>, life: Life, stand: &Stand<'_>) -> Result<u32, Error> {
    let species: Vec<u16> = simulation.participants.iter().map(|p| p.species).collect();
    if let Some(fault) = life.fault(&species, stand.population.species.len()) {
        return Err(Error::Unfit(fault));
    }
    let done =
        life.year.checked_sub(stand.year).filter(|done| *done <= simulation.rules.years.value);
    simulation.life = life;
    done.ok_or(Error::Unfit("its years are not those of the step"))
}

/// Returns whether the last rows of the summary say already what a simulation begins with.
fn is_as_recorded(simulation: &Simulation<'_>, start: &[Year], stand: &Stand<'_>) -> bool {
    simulation.participants.iter().zip(start).all(|(participant, year)| {
        let last = stand.summary.iter().rfind(|row| row.species == participant.species);
        year.births == 0 && last.is_some_and(|row| row.alive == year.alive)
    })
}

fn record(simulation: &Simulation<'_>, years: &[Year], stand: &mut Stand<'_>) {
    let area = simulation.ground.area();
    let rows = simulation.participants.iter().zip(years).map(|(participant, year)| SummaryRow {
        step: simulation.life.year,
        species: participant.species,
        alive: year.alive,
        births: year.births,
        dominated: year.dominated,
        old: year.old,
        disturbed: year.disturbed,
        mean_radius: (year.radius_sum / (year.alive as f64).max(1.0)) as f32,
        cover: (year.area_sum / area) as f32,
        seeds: year.seeds,
        sizes: year.sizes,
    });
    stand.summary.extend(rows);
}

/// Keeps the plants of a year that the step names.
fn keep(simulation: &Simulation<'_>, year: u32, site: &Site<'_>, stand: &mut Stand<'_>) {
    if simulation.rules.keep.iter().any(|kept| kept.value == year) {
        let plants = living(simulation, site, stand);
        stand.keep_a_picture(simulation.life.year, plants);
    }
}

/// Returns the plants as they stand, by id.
fn living(simulation: &Simulation<'_>, site: &Site<'_>, stand: &Stand<'_>) -> Vec<Plant> {
    let before = &stand.population.plants;
    let plant = |grower: &Grower| {
        let participant = &simulation.participants[usize::from(grower.who)];
        let &Grower { id, x, y, age, vigor, radius, state, .. } = grower;
        let settler = before.binary_search_by_key(&id, |plant| plant.id).map(|row| before[row]);
        if let (true, Ok(settler)) = (grower.is_settler, settler) {
            let height = settler.height.max(participant.kind.size.height_at(age, vigor));
            return Plant { age, radius, height, state, ..settler };
        }
        let yaw = site.seed.stream("yaw", id).unit() as f32 * TAU;
        let spot = Spot { id, x, y, age, vigor, yaw };
        let plant = settle(&site.ground, &participant.kind, participant.species, spot);
        Plant { radius, state, ..plant }
    };
    let mut plants: Vec<Plant> = simulation.life.growers.par_iter().map(plant).collect();
    plants.par_sort_by_key(|plant| plant.id);
    plants
}

/// Puts what the simulation left into the stand.
fn hand_over(simulation: Simulation<'_>, site: &Site<'_>, stand: &mut Stand<'_>) {
    stand.year = simulation.life.year;
    let living = living(&simulation, site, stand);
    let took_part = |species| simulation.participants.iter().any(|p| p.species == species);
    stand.succeed(living, took_part);
    stand.bank.retain(|seed| !took_part(seed.species));
    stand.deaths.extend(simulation.life.deaths);
    stand.bank.extend(simulation.life.bank.into_iter().flatten());
}
