//! Plant populations: where which plant stands, how old and how vigorous it is.
//!
//! A population is made by an ordered list of steps, each of which takes the plants so far and
//! returns them changed: painted densities become plants by halftoning and relaxation, circles
//! grow and compete year after year, single plants are placed or cleared [Deussen98]. So
//! painting and simulation alternate freely.
//!
//! Everything is a function of its arguments: the same inputs and seed give the same bytes for
//! any number of threads and any order of the plants handed in.

mod align;
mod attribute;
mod blobs;
mod bytes;
mod checkpoint;
mod clear;
mod clump;
mod competition;
mod config;
mod curve;
mod density;
mod dispersal;
mod distance;
mod disturbance;
mod dither;
mod field;
mod ground;
mod growth;
mod halftone;
mod ids;
mod inequality;
mod levels;
mod mass;
mod neighbors;
mod place;
mod plots;
mod power;
mod relax;
mod seeds;
pub mod self_thinning;
mod shadow;
mod simulate;
mod spacing;
mod species;
mod stand;
mod steps;
mod thin;
mod visible;
mod voronoi;

pub use checkpoint::{CHECKPOINT_VERSION, Checkpoint, Course, Damaged, Moment, Next, Watch};
pub use clump::Clump;
pub use competition::{Circle, Plain, dominators};
pub use config::{
    Arrange, Attribute, Clear, Config, Edge, Effect, Favour, Halftone, Method, Naming, Neighbour,
    Order, Place, Plots, RelaxStep, Rim, Simulate, Spacing, Step, StepCommon, Thin, Weight,
};
pub use curve::{Part, systematic};
pub use dispersal::{ExponentialPower, Gaussian, Kernel, Lognormal, TwoDt, Uniform, Wald, Wind};
pub use disturbance::{Agent, Disturbance};
pub use dither::dither;
pub use growth::{Growth, Law};
pub use inequality::Inequality;
pub use power::polish;
pub use relax::{Relaxation, relax};
pub use seeds::{DormantSeed, Mast};
pub use simulate::{Simulation, Year};
pub use species::{Ecology, Response};
pub use steps::{grow, grow_on};

use std::collections::BTreeMap;
use weald_contract::{Grid, Image, Layers, Population, Problem, Species, View};

/// Version of what this crate computes; it changes whenever equal inputs give other plants.
pub const OUTPUT_VERSION: u32 = 6;

/// Why no population was made.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Something the user wrote cannot be done.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The caller's [`weald_contract::Progress`] asked to stop.
    #[error("stopped before it was done")]
    Cancelled,
    /// The state was saved, and the work stopped there as the [`Watch`] or the caller asked.
    #[error("stopped before it was done; the state is saved")]
    Paused,
    /// The [`Watch`] could not save the state.
    #[error("the state could not be saved: {0}")]
    NotSaved(#[from] std::io::Error),
    /// The checkpoint is whole but does not belong to this work.
    #[error("the checkpoint does not fit: {0}")]
    Unfit(&'static str),
}

/// All that the steps read besides their own fields.
#[derive(Clone, Copy, Debug)]
pub struct Surroundings<'a> {
    /// The ground; `altitude` is needed always, other layers when a step or species asks.
    pub terrain: &'a Layers,
    /// Species by name.
    pub species: &'a BTreeMap<String, (Species, Ecology)>,
    /// Images by the path that names them in a step.
    pub images: &'a BTreeMap<String, Image>,
    /// Tables of plants by the path that names them in a `place` step.
    pub plants: &'a BTreeMap<String, Population>,
    /// The views of the scene.
    pub views: &'a [View],
}

/// What the steps made.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Outcome {
    /// The plants, sorted by id.
    pub population: Population,
    /// A row for each simulated year and species; year 0 is the start.
    pub summary: Vec<SummaryRow>,
    /// Every plant that died or was cleared away, in order of time, then id.
    pub deaths: Vec<Death>,
    /// Populations of the steps that were to be kept, in order of time.
    pub snapshots: Vec<Snapshot>,
    /// What `spacing` left no room for, a row for each halftone that it concerns.
    pub unplaced: Vec<Unplaced>,
    /// How well sample plots predict each other, a row for each table and species.
    pub plot_fits: Vec<PlotFit>,
    /// Layers that `plots` steps made, plants per m², by name.
    pub layers: BTreeMap<String, Grid>,
}

/// The plants of a simulation at one step, the doomed among them.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The step, counted as in [`SummaryRow::step`].
    pub step: u32,
    /// The plants that take part, with their states.
    pub population: Population,
}

/// Plants of a halftone for which no place was found.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Unplaced {
    /// Index into the species of the population.
    pub species: u16,
    /// Plants that the density asked for.
    pub wanted: u64,
    /// Those of them that stand nowhere.
    pub unplaced: u64,
}

/// How a density was made from sample plots.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PlotFit {
    /// Index into the species of the population.
    pub species: u16,
    /// Plots that count the species.
    pub plots: u64,
    /// Standard deviation of the Gaussian weights, m.
    pub bandwidth: f64,
    /// Leave-one-out error: root mean square, weighted by area, of each plot's density against
    /// the one that the others predict, plants per m².
    pub error: f64,
}

/// State of one species at the end of a simulated year.
///
/// The ledger closes within a `simulate` step: `alive` is the `alive` of the row before, plus
/// `births`, minus `dominated`, `old` and `disturbed`. Where other steps or a sowing changed the
/// plants, a step begins with a row for the state that it finds.
#[derive(Clone, Debug, PartialEq)]
pub struct SummaryRow {
    /// Years since the first simulated year began, over all `simulate` steps.
    pub step: u32,
    /// Index into the species of the population.
    pub species: u16,
    /// Plants alive at the end of the year.
    pub alive: u64,
    /// Seedlings that took hold during the year; at the start, the plants sown then.
    pub births: u64,
    /// Plants that died because a stronger one stood over them.
    pub dominated: u64,
    /// Plants that died of old age.
    pub old: u64,
    /// Plants that a disturbance killed.
    pub disturbed: u64,
    /// Mean crown radius of those alive, m; 0 when there are none.
    pub mean_radius: f32,
    /// Sum of crown areas over the area of the terrain.
    pub cover: f32,
    /// Seeds that lie in the ground at the end of the year.
    pub seeds: u64,
    /// How unequal the crown areas of those alive are.
    pub sizes: Inequality,
}

/// The end of one plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Death {
    /// The plant.
    pub id: u64,
    /// Index into the species of the population.
    pub species: u16,
    /// The year, counted as in [`SummaryRow::step`].
    pub step: u32,
    /// Why it died.
    pub cause: Cause,
    /// The strongest plant that stood over it, when that was the cause.
    pub killer: Option<u64>,
}

/// Why a plant is gone.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Cause {
    /// A plant of greater competitive ability stood over it.
    Dominated,
    /// It reached the lifespan of its species.
    Old,
    /// A disturbance struck it.
    Disturbed(Agent),
    /// A `clear` or `thin` step removed it.
    Cleared,
}

impl Cause {
    /// The word for this cause in a file.
    pub fn word(self) -> &'static str {
        match self {
            Self::Dominated => "dominated",
            Self::Old => "old",
            Self::Disturbed(agent) => agent.word(),
            Self::Cleared => "cleared",
        }
    }
}
