//! Stages alone on their files, without the layout and the records of a run.

use crate::error::{Error, Result};
use crate::files;
use crate::make::{self, Growing, Made, Quantizing, RenderPaths};
use crate::parameters::{canonical, forms};
use crate::recipe::Stage;
use crate::scene::{self, Scene, load_species};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::table::{FromToml, Kind, Table};
use weald_contract::{Progress, Seed, Sources, Span, Value};
use weald_formats::{Parent, Provenance};
use weald_plants::Conditions;

/// `weald terrain SCENE -o FOLDER`.
///
/// # Errors
/// See [`make::terrain`].
pub fn terrain(scene: &Scene, folder: &Path, progress: &dyn Progress) -> Result<Made> {
    let story = scene_story(scene, Stage::Terrain, false)?;
    make::terrain(scene, folder, &story, progress)
}

/// `weald terrain SCENE --layers NAMES -o FOLDER`: the names are those of `[terrain] layers`.
///
/// # Errors
/// See [`make::named_layers`].
pub fn named_layers(scene: &Scene, folder: &Path, progress: &dyn Progress) -> Result<Made> {
    let story = scene_story(scene, Stage::Terrain, false)?;
    make::named_layers(scene, folder, &story, progress)
}

/// `weald ecosim SCENE --terrain FOLDER -o POPULATION`.
///
/// # Errors
/// See [`make::ecosim`].
pub fn ecosim(scene: &Scene, paths: &make::EcosimPaths, progress: &dyn Progress) -> Result<Made> {
    let story = scene_story(scene, Stage::Ecosim, false)?;
    make::ecosim(scene, paths, story, progress)
}

/// `weald render SCENE --from FOLDER -o IMAGE`.
///
/// # Errors
/// See [`make::render`].
pub fn render(
    scene: &Scene,
    paths: &RenderPaths,
    is_draft: bool,
    progress: &dyn Progress,
) -> Result<Made> {
    files::must_end(&paths.image, "exr")?;
    let story = scene_story(scene, Stage::Render, is_draft)?;
    make::render(scene, paths, is_draft, story, progress)
}

/// Provenance with the hashes of the files that the scene names for a stage.
fn scene_story(scene: &Scene, stage: Stage, is_draft: bool) -> Result<Provenance> {
    let hashed = crate::parameters::hashed_inputs(scene, stage)?;
    let parents = make::parents_of_inputs(&hashed);
    Ok(make::provenance(scene, stage, is_draft, parents))
}

/// What `weald quantize` and `weald plants` say on the command line instead of in a scene.
#[derive(Clone, Debug, Default)]
pub struct Fields {
    /// Fields of the stage's table as `name=value`.
    pub set: Vec<String>,
    /// Root of all chance.
    pub seed: u64,
}

/// `weald quantize POPULATION -o FOLDER` without a scene: species beside it or in the program.
///
/// # Errors
/// The population is damaged, a species is nowhere, or see [`Quantizing::make`].
pub fn quantize(
    population: &Path,
    folder: &Path,
    fields: &Fields,
    progress: &dyn Progress,
) -> Result<Made> {
    let mut sources = Sources::default();
    let config: weald_quantize::Config = config_of(fields, &mut sources)?;
    // A large population is not held twice.
    let names = {
        let plants = weald_formats::read_population(population)?;
        make::check_plants(population, &plants, true)?;
        plants.species
    };
    let (texts, found) = load_species(folder_of(population), names)?;
    let species: BTreeMap<_, _> =
        found.iter().map(|(name, found)| (name.clone(), found.species.clone())).collect();
    let sizes: BTreeMap<_, _> = species.iter().map(|(name, found)| (name, &found.size)).collect();
    let mut parameters = json!({ "quantize": canonical(&config), "species": canonical(&sizes) });
    if config.memory_gb.is_some() {
        parameters["forms"] = forms(&found);
    }
    let seed_of = |stage: Stage| Seed(fields.seed).part(stage.word(), 0);
    let growing = Growing {
        species: &found,
        conditions: &Conditions::default(),
        seed: seed_of(Stage::Plants),
        sources: &texts,
    };
    let quantizing = Quantizing {
        config: &config,
        species: &species,
        seed: seed_of(Stage::Quantize),
        sources: &sources,
        growing: Some(&growing),
    };
    quantizing.make(population, folder, story(Stage::Quantize, parameters, fields.seed), progress)
}

/// `weald quantize POPULATION --scene SCENE [--terrain FOLDER] -o FOLDER`.
///
/// # Errors
/// See [`make::quantize`].
pub fn quantize_in_scene(
    scene: &Scene,
    population: &Path,
    terrain: Option<&Path>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Made> {
    make::check_plants(population, &weald_formats::read_population(population)?, true)?;
    let story = scene_story(scene, Stage::Quantize, false)?;
    make::quantize(scene, population, terrain, folder, story, progress)
}

/// `weald plants PALETTE --scene SCENE -o FOLDER`.
///
/// # Errors
/// See [`make::plants`].
pub fn plants_in_scene(
    scene: &Scene,
    palette: &Path,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Made> {
    let story = scene_story(scene, Stage::Plants, false)?;
    make::plants(scene, palette, folder, story, progress)
}

/// Whether a TOML file is a palette rather than a species.
pub fn is_palette(path: &Path) -> bool {
    let tree = scene::read_text(path).ok().and_then(|text| Value::parse(0, &text).ok());
    let has = |key| tree.as_ref().and_then(Value::as_table).is_some_and(|t| t.get(key).is_some());
    (has("representative") || has("group")) && !has("size")
}

/// `weald plants PALETTE -o FOLDER` without a scene: species beside it or in the program.
///
/// # Errors
/// The palette is damaged, a species is nowhere, or see [`Growing::make`].
pub fn plants(
    palette: &Path,
    folder: &Path,
    conditions: &Conditions,
    seed: u64,
    progress: &dyn Progress,
) -> Result<Made> {
    let names = make::species_names(&weald_formats::read_palette(palette)?);
    let (sources, species) = load_species(folder_of(palette), names)?;
    let parameters = json!({ "plants": canonical(conditions), "species": forms(&species) });
    let seed_of_stage = Seed(seed).part(Stage::Plants.word(), 0);
    let sources = &sources;
    let growing = Growing { species: &species, conditions, seed: seed_of_stage, sources };
    growing.make(palette, folder, story(Stage::Plants, parameters, seed), progress)
}

/// Reads a stage's table that consists of flags only.
pub(crate) fn config_of<T: FromToml>(fields: &Fields, sources: &mut Sources) -> Result<T> {
    let mut tree = Value { span: Span::default(), kind: Kind::Table(Table::default()) };
    let mut problems = Vec::new();
    for field in &fields.set {
        crate::edit::set(&mut tree, field, sources, &mut problems);
    }
    match T::from_toml(&tree, &mut problems) {
        Some(config) if problems.is_empty() => Ok(config),
        _ => Err(Error::Wrong { sources: sources.clone().into(), problems }),
    }
}

pub(crate) fn story(stage: Stage, parameters: serde_json::Value, seed: u64) -> Provenance {
    Provenance {
        stage: stage.word().into(),
        version: env!("CARGO_PKG_VERSION").into(),
        output_version: stage.output_version(),
        parameters,
        seed,
        inputs: Vec::<Parent>::new(),
    }
}

pub(crate) fn folder_of(path: &Path) -> &Path {
    path.parent().unwrap_or(Path::new(""))
}
