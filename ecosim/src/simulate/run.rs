//! The step `simulate`: years of a [`Simulation`] on the plants so far.

use super::life::{Grower, Life};
use super::{Simulation, Year};
use crate::checkpoint::{Begun, Course, Going, Moment};
use crate::config::Simulate;
use crate::seeds::DormantSeed;
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
            begin(&mut simulation, stand)?;
            0
        }
    };
    site.progress.advance(u64::from(done));
    for _ in done..years {
        stand.check_room(simulation.seeds_expected() as u64, "the seeds of one year")?;
        let happened = simulation.step()?;
        let in_all = simulation.len() as u64 + bystanders;
        stand.check_room(in_all.saturating_sub(stand.population.len() as u64), "the simulation")?;
        record(&simulation, &happened, stand);
        site.progress.advance(1);
        let going = Going::Years(&simulation.life);
        course.rest(site, 1, &Moment { ordinal, stand, going })?;
    }
    hand_over(simulation, site, stand);
    Ok(())
}

/// Sows the plants of the start.
fn begin(simulation: &mut Simulation<'_>, stand: &mut Stand<'_>) -> Result<(), Error> {
    let rules = simulation.rules;
    let sown = u64::from(rules.initial) * rules.species.len() as u64;
    stand.check_room(sown, "sowing `initial` plants")?;
    stand.check_room(simulation.seeds_expected() as u64, "the seeds of one year")?;
    let start = simulation.sow();
    if !is_as_recorded(simulation, &start, stand) {
        record(simulation, &start, stand);
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
        mean_radius: (year.radius_sum / (year.alive as f64).max(1.0)) as f32,
        cover: (year.area_sum / area) as f32,
        seeds: year.seeds,
    });
    stand.summary.extend(rows);
}

/// Puts what the simulation left into the stand: settlers changed or removed, others added.
fn hand_over(simulation: Simulation<'_>, site: &Site<'_>, stand: &mut Stand<'_>) {
    stand.year = simulation.life.year;
    let took_part = |plant: &Plant| {
        simulation.participants.iter().any(|participant| participant.species == plant.species)
    };
    // Growers and plants are both sorted by id, settlers being found in one walk.
    let mut settlers = simulation.life.growers.iter().filter(|plant| plant.is_settler).peekable();
    let mut keep = Vec::with_capacity(stand.population.len());
    for plant in &mut stand.population.plants {
        let survivor = settlers.next_if(|grower| grower.id == plant.id);
        keep.push(survivor.is_some() || !took_part(plant));
        if let Some(grower) = survivor {
            let size = simulation.participants[usize::from(grower.who)].kind.size;
            plant.height = plant.height.max(size.height_at(grower.age, grower.vigor));
            (plant.age, plant.radius, plant.state) = (grower.age, grower.radius, grower.state);
        }
    }
    stand.keep(&keep);
    let newcomer = |grower: &Grower| {
        let participant = &simulation.participants[usize::from(grower.who)];
        let yaw = site.seed.stream("yaw", grower.id).unit() as f32 * TAU;
        let &Grower { id, x, y, age, vigor, .. } = grower;
        let spot = Spot { id, x, y, age, vigor, yaw };
        let plant = settle(&site.ground, &participant.kind, participant.species, spot);
        Plant { radius: grower.radius, state: grower.state, ..plant }
    };
    let newcomers: Vec<&Grower> =
        simulation.life.growers.iter().filter(|g| !g.is_settler).collect();
    stand.add(newcomers.par_iter().map(|grower| newcomer(grower)).collect());
    stand.deaths.extend(simulation.life.deaths);
    let is_own = |seed: &DormantSeed| {
        simulation.participants.iter().any(|participant| participant.species == seed.species)
    };
    stand.bank.retain(|seed| !is_own(seed));
    stand.bank.extend(simulation.life.bank.into_iter().flatten());
}
