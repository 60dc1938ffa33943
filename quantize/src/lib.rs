//! Approximate instancing: a population becomes a palette of few representatives and many instances.
//!
//! Plants of a species that are close in a space of perceptually even parameters look alike, so
//! one model can stand for all of them [Deussen98, section "Approximate instancing"]. The space
//! is partitioned by variance-based splitting with importance weights [Wan88], improved by a few
//! steps of [Lloyd82], or partitioned exactly where only one parameter varies [Fisher58]. Patches
//! of plants are grouped in the same manner, and groups may contain groups.
//!
//! ```text
//!  population ─► features ─► budget ─► split ─► refine ─► palette + instances + report
//!       └─► groups: patches are quantized by vigor, filled with drawn members,
//!           and the members join the free-standing plants of their species ─┘
//! ```
//!
//! [`cluster`], [`split`] and [`refine`] work on any table of numbers.

mod budget;
mod codebook;
mod condense;
mod exact;
mod features;
mod groups;
mod palette;
mod refine;
mod report;
mod samples;
mod search;
mod split;
mod stream;
mod table;

use std::collections::BTreeMap;
use weald_contract::{
    Input, Instances, Palette, Population, Problem, Problems, Progress, Seed, Species,
};

pub use codebook::{Codebook, Mode, cluster, refine, split};
pub use report::{Drift, Report, SpeciesReport};
pub use stream::{Chunks, Streamed, Streaming, cluster_chunks};
pub use table::{Table, TableError};

/// Number of the algorithm: rises when equal input gives other bytes.
pub const OUTPUT_VERSION: u32 = 2;

weald_contract::words! {
    /// How much each plant counts when plants are grouped.
    pub enum Weights {
        /// By the ground that its crown covers: large plants get more of the palette.
        Area = "area",
        /// All alike.
        Uniform = "uniform",
    }
}

weald_contract::table! {
    /// How many plant models are grown, and how plants share them.
    pub struct Config {
        /// Plant models grown of each species, unless `budget` is given.
        representatives: u32 = 8, in 1.0..=1000000.0;
        /// Plant models grown in all; species share them by what each model gains.
        budget: Option<u32> = None, in 1.0..=1000000.0;
        /// `paper` splits only, `fast` adds three steps of refinement, `best` searches on.
        mode: Mode = Mode::Fast;
        /// What makes a plant count for more.
        weights: Weights = Weights::Area;
        /// Kinds of patch, by vigor, of each group species.
        group_representatives: u32 = 4, in 1.0..=10000.0;
        /// Different patches grown of each kind.
        group_variants: u32 = 8, in 1.0..=10000.0;
    }
}

impl Default for Config {
    fn default() -> Self {
        Self {
            representatives: 8,
            budget: None,
            mode: Mode::Fast,
            weights: Weights::Area,
            group_representatives: 4,
            group_variants: 8,
        }
    }
}

/// Why a population was not quantized.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Something in the scene, a species or the population is not right.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The caller asked to stop.
    #[error("stopped before it was done")]
    Cancelled,
}

/// A population, quantized.
#[derive(Clone, Debug, PartialEq)]
pub struct Quantized {
    /// The plants to grow and the patches made of them.
    pub palette: Palette,
    /// Where they stand: a row a plant in the scene, in the order of the plants, then the
    /// members of each group.
    pub instances: Instances,
    /// What was saved and what it costs.
    pub report: Report,
}

impl Config {
    /// Files that the table names: none.
    pub fn inputs(&self) -> Vec<Input> {
        Vec::new()
    }

    /// Finds what can be found wrong before any work: members of groups that are no species, and
    /// groups that contain themselves.
    pub fn check(&self, species: &BTreeMap<String, Species>) -> Problems {
        groups::problems(species)
    }
}

/// Groups similar plants, picks a representative for each group and places its instances.
///
/// `species` holds at least every species of the population and every member of their groups.
/// The result depends on neither the number of threads nor, apart from the order of the scene's
/// rows, the order of the plants.
///
/// # Errors
/// A plant with a number that is not finite, negative or out of range; an unknown species; a group
/// that contains itself; a budget below the number of species; patches with more members than
/// memory is likely to hold.
pub fn quantize(
    config: &Config,
    population: &Population,
    species: &BTreeMap<String, Species>,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Quantized, Error> {
    palette::build(config, population, species, seed, progress)
}
