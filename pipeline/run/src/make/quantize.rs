//! Quantize: plants to a palette and instances.

use super::plants::Growing;
use super::{Made, make_folder, memory, parent, stage_error, stage_seed, write_json};
use crate::error::{Error, Result};
use crate::parameters::quantize_species;
use crate::preview;
use crate::recipe::Stage;
use crate::scene::Scene;
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{Population, Progress, Projection, Seed, Sources};
use weald_formats::Provenance;
use weald_quantize::{Bytes, Config, Quantized, Weights};

/// Longer side of a map, pixels.
const MAP_SIDE: usize = 1000;

/// Quantize: plants to a palette and instances, both in `folder`. `terrain` is the folder of the
/// terrain that a view stands on.
///
/// # Errors
/// The population is damaged, the stage refuses, or the disk does.
pub fn quantize(
    scene: &Scene,
    population: &Path,
    terrain: Option<&Path>,
    folder: &Path,
    mut provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let seed = stage_seed(scene, Stage::Quantize);
    let species = quantize_species(scene);
    let config = seen_by_view(scene, terrain)?;
    if let Some(terrain) = terrain.filter(|_| scene.quantize.lacks_eye()) {
        provenance.inputs.push(parent(terrain)?);
    }
    let growing = Growing::of(scene);
    let quantizing = Quantizing {
        config: &config,
        species: &species,
        seed,
        sources: &scene.sources,
        growing: Some(&growing),
    };
    quantizing.make(population, folder, provenance, progress)
}

/// The table, with the eye of the view that is rendered where plants are weighted by a view.
fn seen_by_view(scene: &Scene, terrain: Option<&Path>) -> Result<Config> {
    let mut config = scene.quantize.clone();
    if !config.lacks_eye() {
        return Ok(config);
    }
    let view = scene.wanted_view()?;
    let Some(terrain) = terrain else {
        return Err(Error::plain(
            "`weights = \"view\"`: where the eye is hangs on the terrain below it",
            "give its folder by `--terrain`, or `eye = [x, y, altitude]` in `[quantize]`",
        ));
    };
    let sight = view.sight(&weald_formats::read_terrain(terrain)?);
    config.eye = Some(sight.eye);
    match view.projection {
        Projection::Perspective => {
            config.target = Some([sight.target[0], sight.target[1]]);
            config.fov_deg = view.fov_deg;
        }
        Projection::Panorama => {}
        // A plan shows near and far alike.
        Projection::Orthographic => config.weights = Weights::Area,
    }
    Ok(config)
}

/// What quantize needs besides the population; a scene provides it, or the command line alone.
pub struct Quantizing<'a> {
    /// `[quantize]`.
    pub config: &'a weald_quantize::Config,
    /// Every species of the population and the members of their groups.
    pub species: &'a BTreeMap<String, weald_contract::Species>,
    /// Seed of the stage.
    pub seed: Seed,
    /// Texts for problems.
    pub sources: &'a Sources,
    /// What grows models, to weigh them where `memory_gb` is given.
    pub growing: Option<&'a Growing<'a>>,
}

impl Quantizing<'_> {
    /// Quantizes a population that is in memory.
    ///
    /// # Errors
    /// The stage refuses, or was asked to stop.
    pub fn values(&self, population: &Population, progress: &dyn Progress) -> Result<Quantized> {
        match (self.config.memory_gb, self.growing) {
            (Some(gigabytes), Some(growing)) => {
                let allowed = (gigabytes * 1e9) as u64;
                memory::quantize_within(allowed, self, growing, population, progress)
            }
            _ => self.plain(population, progress),
        }
    }

    /// By numbers of models alone.
    pub(super) fn plain(
        &self,
        population: &Population,
        progress: &dyn Progress,
    ) -> Result<Quantized> {
        weald_quantize::quantize(self.config, population, self.species, self.seed, progress)
            .map_err(stage_error!(self.sources, Stage::Quantize, weald_quantize))
    }

    /// With models of so many bytes, about.
    pub(super) fn within(
        &self,
        bytes: Bytes<'_>,
        population: &Population,
        progress: &dyn Progress,
    ) -> Result<Quantized> {
        let Self { config, species, seed, .. } = *self;
        weald_quantize::quantize_within(bytes, config, population, species, seed, progress)
            .map_err(stage_error!(self.sources, Stage::Quantize, weald_quantize))
    }

    /// Writes `palette.toml`, `instances.parquet` and `quantize.json` into `folder`, and maps of
    /// which model stands where (`quantize.png`) and how far its height is off
    /// (`quantize-error.png`).
    ///
    /// # Errors
    /// The population is damaged, the stage refuses, or the disk does.
    pub fn make(
        &self,
        population: &Path,
        folder: &Path,
        mut provenance: Provenance,
        progress: &dyn Progress,
    ) -> Result<Made> {
        provenance.inputs.push(parent(population)?);
        let population = weald_formats::read_population(population)?;
        let quantized = self.values(&population, progress)?;
        make_folder(folder)?;
        let report = json!(quantized.report);
        let words = quantized.report.to_string();
        let mut made = Made { report: quantize_report(&quantized), words, ..Made::default() };
        let models = preview::draw_models(&population, &quantized, MAP_SIDE);
        let errors = preview::draw_errors(&population, &quantized, MAP_SIDE);
        // Room for the columns of the instances.
        drop(population);
        let palette = folder.join("palette.toml");
        weald_formats::write_palette(&palette, &quantized.palette, &provenance)?;
        made.wrote(&palette)?;
        let instances = folder.join("instances.parquet");
        weald_formats::write_instances(&instances, &quantized.instances, &provenance)?;
        made.wrote(&instances)?;
        let path = folder.join("quantize.json");
        write_json(&path, &json!({ "report": report, "provenance": provenance }))?;
        made.wrote(&path)?;
        made.preview(&folder.join("quantize.png"), &models, &provenance)?;
        made.preview(&folder.join("quantize-error.png"), &errors, &provenance)?;
        Ok(made)
    }
}

fn quantize_report(quantized: &Quantized) -> Json {
    json!({
        "representatives": quantized.palette.representatives.len(),
        "groups": quantized.palette.groups.len(),
        "instances": quantized.instances.len(),
    })
}
