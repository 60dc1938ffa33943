//! Growth that rests and goes on: the whole state between two simulated years, as bytes.
//!
//! A checkpoint holds what the steps so far have made, and of the step that was under way what a
//! year changes. Everything else, ground, species and chance, follows from the same inputs and
//! seed again, so that the plants end up the same to the last bit.

use crate::bytes::{Bytes, records};
use crate::config::{Config, Step};
use crate::levels;
use crate::seeds::DormantSeed;
use crate::self_thinning::Partway;
use crate::simulate::Life;
use crate::stand::{Belongings, Stand, fault};
use crate::steps::Site;
use crate::{
    Agent, Cause, Death, Error, Inequality, PlotFit, Snapshot, SummaryRow, Surroundings, Unplaced,
};
use std::collections::BTreeMap;
use std::io::{self, Write};
use weald_contract::{Crs, Frame, Grid, Plant, Population, State};

/// Version of the bytes of a checkpoint.
pub const CHECKPOINT_VERSION: u32 = 3;

/// Latest year that a checkpoint may tell of: far beyond any scene, and far from overflow.
const LATEST: u32 = 1 << 30;

/// What comes after a rest.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Next {
    /// More years.
    GoOn,
    /// The state is saved, then more years.
    Save,
    /// The state is saved, and the work stops.
    Stop,
}

/// Decides at each rest what comes next, and keeps the state.
pub trait Watch {
    /// Asked after each simulated year (`years` is 1) and between steps (0).
    fn next(&mut self, years: u32) -> Next;

    /// Saves the state.
    ///
    /// # Errors
    /// The state could not be kept; the work ends.
    fn save(&mut self, moment: &Moment<'_>) -> io::Result<()>;
}

/// Where a growth begins, and who may interrupt it.
#[derive(Default)]
pub struct Course<'w> {
    /// Where it goes on from.
    pub(crate) from: Option<Checkpoint>,
    /// Who decides at its rests.
    watch: Option<&'w mut dyn Watch>,
    /// What the first step that runs goes on from.
    pub(crate) begun: Option<Begun>,
}

impl<'w> Course<'w> {
    /// Begins where a checkpoint ends, or anew; `watch` decides at its rests.
    pub fn new(from: Option<Checkpoint>, watch: Option<&'w mut dyn Watch>) -> Self {
        Self { from, watch, begun: None }
    }

    /// Rests: stops when the user asks for it, having saved what there is.
    pub(crate) fn rest(
        &mut self,
        site: &Site<'_>,
        years: u32,
        moment: &Moment<'_>,
    ) -> Result<(), Error> {
        let Some(watch) = &mut self.watch else { return site.check_cancelled() };
        let next = watch.next(years);
        let next = if site.progress.is_cancelled() { Next::Stop } else { next };
        if next != Next::GoOn {
            watch.save(moment)?;
        }
        if next == Next::Stop { Err(Error::Paused) } else { Ok(()) }
    }
}

/// The state at a rest.
pub struct Moment<'a> {
    /// Index of the step that comes next or is under way.
    pub(crate) ordinal: usize,
    pub(crate) stand: &'a Stand<'a>,
    pub(crate) going: Going<'a>,
}

/// The state of the step under way.
pub(crate) enum Going<'a> {
    Between,
    Years(&'a Life),
    Steps { done: u32, sites: &'a Vec<levels::Site> },
}

/// What stands for each [`Going`] in bytes.
const BETWEEN: u8 = 0;
const YEARS: u8 = 1;
const STEPS: u8 = 2;

impl Moment<'_> {
    /// Returns the years simulated so far, counted as in [`SummaryRow::step`].
    pub fn year(&self) -> u32 {
        if let Going::Years(life) = self.going { life.year } else { self.stand.year }
    }

    /// Writes the state, for [`Checkpoint::read`].
    ///
    /// # Errors
    /// Those of `out`.
    pub fn write(&self, out: &mut dyn Write) -> io::Result<()> {
        let Stand { population, bank, year, summary, deaths, snapshots, .. } = self.stand;
        let Stand { unplaced, plot_fits, layers, .. } = self.stand;
        self.ordinal.put(out)?;
        // In the order of `Belongings`.
        population.put(out)?;
        bank.put(out)?;
        year.put(out)?;
        summary.put(out)?;
        deaths.put(out)?;
        snapshots.put(out)?;
        unplaced.put(out)?;
        plot_fits.put(out)?;
        layers.len().put(out)?;
        for (name, grid) in layers {
            name.to_string().put(out)?;
            grid.put(out)?;
        }
        match &self.going {
            Going::Between => BETWEEN.put(out),
            Going::Years(life) => YEARS.put(out).and_then(|()| life.put(out)),
            Going::Steps { done, sites } => {
                STEPS.put(out)?;
                done.put(out)?;
                sites.put(out)
            }
        }
    }
}

/// A state to go on from.
#[derive(Clone, Debug, PartialEq)]
pub struct Checkpoint {
    pub(crate) ordinal: usize,
    pub(crate) so_far: Belongings,
    pub(crate) begun: Option<Begun>,
}

/// What a step that was under way goes on from.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Begun {
    Years(Life),
    Steps(Partway),
}

/// Bytes that are no checkpoint.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("its contents are no state of a simulation")]
pub struct Damaged;

impl Checkpoint {
    /// Reads what [`Moment::write`] wrote.
    ///
    /// # Errors
    /// The bytes are damaged, too few or too many.
    pub fn read(mut bytes: &[u8]) -> Result<Self, Damaged> {
        match Self::take(&mut bytes) {
            Some(checkpoint) if bytes.is_empty() => Ok(checkpoint),
            _ => Err(Damaged),
        }
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        let (ordinal, so_far) = (Bytes::take(from)?, Belongings::take(from)?);
        let begun = match u8::take(from)? {
            BETWEEN => None,
            YEARS => Some(Begun::Years(Life::take(from)?)),
            STEPS => Some(Begun::Steps(Partway::take(from)?)),
            _ => return None,
        };
        Some(Self { ordinal, so_far, begun })
    }

    /// Returns the years simulated so far, counted as in [`SummaryRow::step`].
    pub fn year(&self) -> u32 {
        if let Some(Begun::Years(life)) = &self.begun { life.year } else { self.so_far.year }
    }
}

/// Makes a stand of what a checkpoint holds.
pub(crate) fn restore<'a>(
    config: &'a Config,
    around: &Surroundings<'a>,
    mut so_far: Belongings,
) -> Result<Stand<'a>, Error> {
    if let Some(fault) = fault_of(&so_far) {
        return Err(Error::Unfit(fault));
    }
    let layers = std::mem::take(&mut so_far.layers);
    let mut stand = Stand::with(around, so_far, config.max_plants)?;
    for (name, grid) in layers {
        let is_named = |step: &&'a Step| matches!(step, Step::Plots(p) if p.layer.value == name);
        let Some(Step::Plots(plots)) = config.enabled().find(is_named) else {
            return Err(Error::Unfit("no step makes a layer in it"));
        };
        stand.layers.insert(&plots.layer.value, grid);
    }
    Ok(stand)
}

/// Says what in a checkpoint no steps could have left; plants are looked at as those of a start.
fn fault_of(so_far: &Belongings) -> Option<&'static str> {
    let count = so_far.population.species.len();
    let is_known = |species: u16| usize::from(species) < count;
    let all = [
        so_far.bank.iter().all(|seed| is_known(seed.species)),
        so_far.summary.iter().all(|row| is_known(row.species)),
        so_far.deaths.iter().all(|death| is_known(death.species)),
        so_far.unplaced.iter().all(|row| is_known(row.species)),
        so_far.plot_fits.iter().all(|fit| is_known(fit.species)),
    ];
    if all.contains(&false) {
        return Some("it tells of species that it does not name");
    }
    if so_far.year > LATEST {
        return Some("its year is far off");
    }
    if !so_far.bank.iter().all(|seed| seed.x.is_finite() && seed.y.is_finite()) {
        return Some("a seed in it cannot be");
    }
    let is_sound = |snapshot: &Snapshot| {
        let Population { species, plants, extra, .. } = &snapshot.population;
        extra.is_empty() && plants.iter().all(|plant| fault(plant, species.len()).is_none())
    };
    if !so_far.snapshots.iter().all(is_sound) {
        return Some("a plant in it cannot be");
    }
    (!so_far.layers.values().all(is_grid)).then_some("a layer in it cannot be")
}

fn is_grid(grid: &Grid) -> bool {
    let Frame { width, height, cell, west, south } = grid.frame;
    let is_placed = cell > 0.0 && [cell, west, south].into_iter().all(f64::is_finite);
    is_placed && !grid.values.is_empty() && width.checked_mul(height) == Some(grid.values.len())
}

records! {
    Belongings {
        population: Population, bank: Vec<DormantSeed>, year: u32, summary: Vec<SummaryRow>,
        deaths: Vec<Death>, snapshots: Vec<Snapshot>, unplaced: Vec<Unplaced>,
        plot_fits: Vec<PlotFit>, layers: BTreeMap<String, Grid>,
    }
    Population {
        species: Vec<String>, plants: Vec<Plant>, extra: BTreeMap<String, Vec<f32>>, crs: Crs,
    }
    Plant {
        id: u64, species: u16, state: State, x: f64, y: f64, z: f32, radius: f32, height: f32,
        age: f32, vigor: f32, yaw: f32, lean: f32, lean_azimuth: f32,
    }
    Crs {
        epsg: Option<u32>, is_geographic: bool, keys: Vec<u16>, doubles: Vec<f64>, ascii: String,
    }
    Grid { frame: Frame, values: Vec<f32> }
    Frame { width: usize, height: usize, cell: f64, west: f64, south: f64 }
    DormantSeed { id: u64, species: u16, x: f64, y: f64 }
    SummaryRow {
        step: u32, species: u16, alive: u64, births: u64, dominated: u64, old: u64, disturbed: u64,
        mean_radius: f32, cover: f32, seeds: u64, sizes: Inequality,
    }
    Inequality { gini: f32, variation: f32 }
    Death { id: u64, species: u16, step: u32, cause: Cause, killer: Option<u64> }
    Snapshot { step: u32, population: Population }
    Unplaced { species: u16, wanted: u64, unplaced: u64 }
    PlotFit { species: u16, plots: u64, bandwidth: f64, error: f64 }
}

impl Bytes for State {
    const LEAST: usize = 1;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        (*self as u8).put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        Self::from_u8(u8::take(from)?)
    }
}

/// Number of the first agent of a disturbance among the causes of death.
const FIRST_AGENT: u8 = 16;

impl Bytes for Cause {
    const LEAST: usize = 1;

    fn put(&self, out: &mut dyn Write) -> io::Result<()> {
        let number = match self {
            Self::Dominated => 0,
            Self::Old => 1,
            Self::Cleared => 2,
            Self::Disturbed(agent) => FIRST_AGENT + *agent as u8,
        };
        number.put(out)
    }

    fn take(from: &mut &[u8]) -> Option<Self> {
        match u8::take(from)? {
            0 => Some(Self::Dominated),
            1 => Some(Self::Old),
            2 => Some(Self::Cleared),
            number => {
                let agent = usize::from(number).checked_sub(FIRST_AGENT.into())?;
                Agent::ALL.get(agent).copied().map(Self::Disturbed)
            }
        }
    }
}
