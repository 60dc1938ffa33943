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
mod nearest;
mod neighbours;
mod order;
mod palette;
mod parts;
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
pub use parts::{PartsReport, share_organs};
pub use report::{Drift, Level, Report, SpeciesReport, WorstPlant};
pub use stream::{Chunks, Streamed, Streaming, cluster_chunks};
pub use table::{Table, TableError};

/// Number of the algorithm: rises when equal input gives other bytes.
pub const OUTPUT_VERSION: u32 = 8;

weald_contract::words! {
    /// How much each plant counts when plants are grouped.
    pub enum Weights {
        /// By the ground that its crown covers: large plants get more of the palette.
        Area = "area",
        /// All alike.
        Uniform = "uniform",
        /// By how large the crown looks from `eye`: near plants get more of the palette, and those
        /// out of the picture less.
        View = "view",
    }
}

weald_contract::table! {
    /// How many plant models are grown, and how plants share them.
    pub struct Config {
        /// Plant models grown of each species, unless `budget` is given.
        representatives: u32 = 8, in 1.0..=1000000.0;
        /// Plant models grown in all; species share them by what each model gains.
        budget: Option<u32> = None, in 1.0..=1000000.0;
        /// Memory that models and instances may take together while they are rendered, GB. What a
        /// model takes the caller knows: [`quantize_within`].
        memory_gb: Option<f64> = None, in 0.001..=1000000.0;
        /// `paper` splits only, `fast` adds three steps of refinement, `best` searches on; `exact`
        /// grows a model for every plant.
        mode: Mode = Mode::Fast;
        /// Models are added to a species until no plant's height differs from its model's by more
        /// than this part, before it is scaled.
        max_height_error: Option<f32> = None, in 0.001..=10.0;
        /// What makes a plant count for more.
        weights: Weights = Weights::Area;
        /// Where plants are seen from when `weights = "view"`: map coordinates and altitude, m. In a
        /// scene the eye of the view that is rendered, unless it is given.
        eye: Option<[f64; 3]> = None, in -1e9..=1e9;
        /// What the eye looks at, map coordinates, m; all around without it.
        target: Option<[f64; 2]> = None, in -1e9..=1e9;
        /// Horizontal angle that the picture shows around `target`, degrees.
        fov_deg: f64 = 50.0, in 1.0..=360.0;
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
            memory_gb: None,
            mode: Mode::Fast,
            max_height_error: None,
            weights: Weights::Area,
            eye: None,
            target: None,
            fov_deg: 50.0,
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
        let mut problems = groups::problems(species);
        let others = [
            ("`budget`", self.budget.is_some()),
            ("`max_height_error`", self.max_height_error.is_some()),
            ("`mode = \"exact\"`", self.mode == Mode::Exact),
        ];
        for (other, _) in
            others.iter().filter(|(_, is_given)| *is_given && self.memory_gb.is_some())
        {
            let message =
                format!("`memory_gb` says how many models there are, and so does {other}");
            problems.push(Problem::new(message).hint("give one of them"));
        }
        problems
    }

    /// Whether plants are weighted by how they look from an eye that is yet to be named.
    pub fn lacks_eye(&self) -> bool {
        self.weights == Weights::View && self.eye.is_none()
    }
}

/// Geometry that the models of a palette may take together.
#[derive(Clone, Copy)]
pub struct Bytes<'a> {
    /// Bytes of all models.
    pub budget: u64,
    /// Bytes of one model of a species, about.
    pub of_model: &'a (dyn Fn(&str) -> u64 + Sync),
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
    palette::build(config, population, species, None, seed, progress)
}

/// [`quantize`], with as many models as fit into a number of bytes.
///
/// Every species has one model; after that the species whose next model gains most for its bytes
/// gets it, until no further one fits. `representatives` and `budget` of the config are not
/// looked at.
///
/// # Errors
/// As [`quantize`]; or one model a species is too much already.
pub fn quantize_within(
    bytes: Bytes<'_>,
    config: &Config,
    population: &Population,
    species: &BTreeMap<String, Species>,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Quantized, Error> {
    palette::build(config, population, species, Some(bytes), seed, progress)
}
