//! Stages alone on their files, without the layout and the records of a run.

use crate::error::{Error, Result};
use crate::files;
use crate::make::{self, Growing, Made, Quantizing, RenderPaths, grow_one};
use crate::parameters::{canonical, forms};
use crate::recipe::Stage;
use crate::scene::{self, Scene, SceneSpecies, load_species};
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::table::{FromToml, Kind, Table};
use weald_contract::{Progress, Representative, Seed, Sources, Span, Value};
use weald_formats::{Parent, Provenance};

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
    let plants = weald_formats::read_population(population)?;
    make::check_plants(population, &plants, true)?;
    let (_, species) = load_species(folder_of(population), plants.species.iter().cloned())?;
    let species: BTreeMap<_, _> =
        species.into_iter().map(|(name, found)| (name, found.species)).collect();
    let sizes: BTreeMap<_, _> = species.iter().map(|(name, found)| (name, &found.size)).collect();
    let parameters = json!({ "quantize": canonical(&config), "species": canonical(&sizes) });
    let seed = Seed(fields.seed).part(Stage::Quantize.word(), 0);
    let quantizing = Quantizing { config: &config, species: &species, seed, sources: &sources };
    quantizing.make(population, folder, story(Stage::Quantize, parameters, fields.seed), progress)
}

/// `weald quantize POPULATION --scene SCENE -o FOLDER`.
///
/// # Errors
/// See [`make::quantize`].
pub fn quantize_in_scene(
    scene: &Scene,
    population: &Path,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Made> {
    make::check_plants(population, &weald_formats::read_population(population)?, true)?;
    let story = scene_story(scene, Stage::Quantize, false)?;
    make::quantize(scene, population, folder, story, progress)
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
pub fn plants(palette: &Path, folder: &Path, seed: u64, progress: &dyn Progress) -> Result<Made> {
    let names = make::species_names(&weald_formats::read_palette(palette)?);
    let (sources, species) = load_species(folder_of(palette), names)?;
    let parameters = json!({ "species": forms(&species) });
    let seed_of_stage = Seed(seed).part(Stage::Plants.word(), 0);
    let growing = Growing { species: &species, seed: seed_of_stage, sources: &sources };
    growing.make(palette, folder, story(Stage::Plants, parameters, seed), progress)
}

/// A plant asked for by age and vigor.
#[derive(Clone, Copy, Debug)]
pub struct Wanted {
    /// Age, years.
    pub age: f32,
    /// Vigor in [0, 1].
    pub vigor: f32,
    /// Root of all chance.
    pub seed: u64,
}

/// `weald plants SPECIES --age 20 --vigor 0.8 -o PLANT.glb`: a species file, or a name that the
/// program knows.
///
/// # Errors
/// The species is nowhere or has mistakes, cannot be grown, or the disk refuses.
pub fn plant(species: &str, wanted: Wanted, file: &Path) -> Result<Made> {
    files::must_end(file, "glb")?;
    let (sources, name, found) = species_given(species)?;
    let Some(form) = &found.form else {
        let members = found.species.group.iter().flat_map(|group| &group.member);
        let members: Vec<&str> = members.map(|member| member.species.value.as_str()).collect();
        return Err(Error::plain(
            format!("`{name}` is a patch of other plants and has no form of its own"),
            format!("grow one of its members: {}", members.join(", ")),
        ));
    };
    check_wanted(wanted)?;
    let size = &found.species.size;
    let height = size.height_at(wanted.age, wanted.vigor);
    let plant = Representative {
        id: 1,
        species: name,
        age: wanted.age,
        vigor: wanted.vigor,
        height,
        radius: size.radius_of_height(height),
        weight: 1.0,
        count: 1,
    };
    let seed = Seed(wanted.seed).part(Stage::Plants.word(), 0);
    let model = grow_one(&sources, form, size, &plant, seed)?;
    make::make_folder_of(file)?;
    let parameters = json!({
        "species": { "size": canonical(size), "form": canonical(form) },
        "age": canonical(&wanted.age), "vigor": canonical(&wanted.vigor),
    });
    let story = story(Stage::Plants, parameters, wanted.seed);
    weald_formats::write_plant(file, &model, &story)?;
    let preview = file.with_extension("png");
    let sheet = crate::preview::contact_sheet(&[(model.name.clone(), &model)], PORTRAIT_SIDE);
    weald_formats::write_png(&preview, sheet.width, sheet.height, &sheet.rgb, &story)?;
    let report = json!({
        "height": canonical(&height),
        "triangles": model.unique_triangles(),
        "instanced_triangles": model.instanced_triangles(),
    });
    Ok(Made { files: vec![file.to_path_buf(), preview], report, ..Made::default() })
}

/// Complains of an age or vigor that no plant has.
fn check_wanted(wanted: Wanted) -> Result<()> {
    let limits = [("--age", wanted.age, 10_000.0), ("--vigor", wanted.vigor, 1.0)];
    match limits.into_iter().find(|(_, value, most)| !(0.0..=*most).contains(value)) {
        Some((flag, value, most)) => {
            Err(Error::plain(format!("{flag} is {value}"), format!("allowed: 0 to {most}")))
        }
        None => Ok(()),
    }
}

/// Side of a single plant's portrait, pixels.
const PORTRAIT_SIDE: usize = 640;

/// A species by file or by name.
fn species_given(given: &str) -> Result<(Sources, String, SceneSpecies)> {
    let path = Path::new(given);
    let is_name = !given.ends_with(".toml") && !path.exists();
    if is_name {
        let (sources, mut species) = load_species(Path::new(""), [given.to_string()])?;
        let found = species.remove(given);
        let found =
            found.ok_or_else(|| Error::plain(format!("no species `{given}`"), "give a file"))?;
        return Ok((sources, given.into(), found));
    }
    let mut sources = Sources::default();
    let mut problems = Vec::new();
    let text = scene::read_text(path)?;
    let found = scene::read_species(given, &text, &mut sources, &mut problems);
    let form = found.as_ref().and_then(|found| found.form.as_ref());
    problems.extend(form.map(weald_plants::Form::check).into_iter().flatten());
    match found {
        Some(found) if problems.is_empty() => {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            Ok((sources, name, found))
        }
        _ => Err(Error::Wrong { sources: sources.into(), problems }),
    }
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
