//! One stage at a time: open what it reads, let it work, write what it made with a preview.
//!
//! `weald run` and the commands of single stages both come through here. A stage always reads
//! its input back from files, never from the memory of the stage before: so a run from nothing
//! and a run that goes on from files make the same bytes, and each file is known to be enough.

use crate::error::{Error, Result};
use crate::parameters::{
    canonical, ecosim_species, parameters, places_named, quantize_species, render_config,
};
use crate::preview::{self, Sketch};
use crate::prototypes::FolderPrototypes;
use crate::recipe::{HashedInput, Stage};
use crate::scene::{Scene, SceneInput, SceneSpecies};
use rayon::prelude::*;
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use weald_contract::{
    Image, InputKind, Layers, Palette, PlantModel, Population, Problem, Progress, Representative,
    Seed, Sources,
};
use weald_formats::{Column, Parent, Provenance, Table};

/// What a stage left.
#[derive(Clone, Debug, Default)]
pub struct Made {
    /// The files, in the order in which they were written.
    pub files: Vec<PathBuf>,
    /// Numbers worth knowing.
    pub report: Json,
}

impl Made {
    fn wrote(&mut self, path: &Path) -> Result<()> {
        self.files.push(path.to_path_buf());
        Ok(())
    }

    fn preview(&mut self, path: &Path, sketch: &Sketch, provenance: &Provenance) -> Result<()> {
        weald_formats::write_png(path, sketch.width, sketch.height, &sketch.rgb, provenance)?;
        self.wrote(path)
    }
}

/// Turns the error of a stage into ours; the three variants that all stages share keep their
/// meaning, the rest are told in words.
macro_rules! stage_error {
    ($sources:expr, $stage:expr, $krate:ident) => {
        |error| match error {
            $krate::Error::Problem(problem) => Error::wrong($sources, problem),
            $krate::Error::Cancelled => Error::Stopped { saved: false },
            #[allow(unreachable_patterns, reason = "some stages have no errors of their own")]
            other => Error::Stage { stage: $stage.word(), message: other.to_string() },
        }
    };
}

/// Version of the program, as it stands in provenance.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The provenance of a stage's files.
pub fn provenance(scene: &Scene, stage: Stage, is_draft: bool, inputs: Vec<Parent>) -> Provenance {
    Provenance {
        stage: stage.word().into(),
        version: VERSION.into(),
        output_version: stage.output_version(),
        parameters: parameters(scene, stage, is_draft),
        seed: scene.tables.seed,
        inputs,
    }
}

/// Scene inputs as parents.
pub fn parents_of_inputs(inputs: &[HashedInput]) -> Vec<Parent> {
    let parent = |input: &HashedInput| Parent {
        name: input.name.clone(),
        blake3: input.blake3.clone(),
        provenance: None,
    };
    inputs.iter().map(parent).collect()
}

/// A file of an earlier stage as a parent, with the story that it tells of itself.
pub(crate) fn parent(path: &Path) -> Result<Parent> {
    let file = if path.is_dir() { path.join("altitude.tif") } else { path.to_path_buf() };
    Ok(Parent {
        name: file_name(&file),
        blake3: weald_formats::hash_file(&file)?,
        provenance: weald_formats::provenance(&file)?.map(Box::new),
    })
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(|error| Error::system(path, error))
}

/// Makes the folder in which a file will stand.
fn make_folder_of(path: &Path) -> Result<()> {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => make_folder(folder),
        _ => Ok(()),
    }
}

/// Opens the images among a stage's inputs, by path as written.
fn images(scene: &Scene, inputs: &[SceneInput]) -> Result<BTreeMap<String, Image>> {
    let mut images = BTreeMap::new();
    for SceneInput { input, path } in inputs.iter().filter(|i| i.input.kind == InputKind::Image) {
        let image = weald_formats::read_image(path).map_err(at_field(scene, input))?;
        images.insert(input.path.value.clone(), image);
    }
    Ok(images)
}

/// Puts a file's error at the field that names the file.
fn at_field<'a>(
    scene: &'a Scene,
    input: &'a weald_contract::Input,
) -> impl Fn(weald_formats::Error) -> Error + 'a {
    move |error| {
        let message = format!("`{}`: {error}", input.field);
        Error::wrong(&scene.sources, Problem::at(input.path.span, message))
    }
}

/// Terrain: elevation model and masks to a folder of layers.
///
/// # Errors
/// An input is damaged, the stage refuses, or the disk does.
pub fn terrain(
    scene: &Scene,
    folder: &Path,
    provenance: &Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let stage = Stage::Terrain;
    let source = scene.terrain_inputs.iter().find(|input| input.input.kind == InputKind::Elevation);
    let Some(source) = source else {
        return Err(Error::plain("the scene names no elevation model", "set `terrain.source`"));
    };
    let elevation =
        weald_formats::read_raster(&source.path).map_err(at_field(scene, &source.input))?;
    let images = images(scene, &scene.terrain_inputs)?;
    let views = places_named(scene, &scene.terrain);
    let seed = stage_seed(scene, stage);
    let layers = weald_terrain::build(&scene.terrain, &elevation, &images, &views, seed, progress)
        .map_err(stage_error!(&scene.sources, stage, weald_terrain))?;

    make_folder(folder)?;
    weald_formats::write_terrain(folder, &layers, provenance)?;
    let mut made = Made { files: terrain_files(folder, &layers), report: terrain_report(&layers) };
    made.preview(&folder.with_extension("png"), &preview::draw_relief(&layers), provenance)?;
    Ok(made)
}

/// The files of a terrain's folder.
fn terrain_files(folder: &Path, layers: &Layers) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        layers.layers.keys().map(|name| folder.join(format!("{name}.tif"))).collect();
    for (index, patch) in layers.detail.iter().enumerate() {
        files.extend(terrain_files(&folder.join(format!("detail-{index}")), patch));
    }
    files
}

fn terrain_report(layers: &Layers) -> Json {
    let frame = layers.frame;
    let depth = layers.values("water_depth").unwrap_or(&[]);
    let wet = depth.iter().filter(|depth| **depth > 0.0).count();
    json!({
        "cells": frame.len(), "cell_m": frame.cell, "layers": layers.layers.len(),
        "detail_cells": layers.detail.iter().map(|patch| patch.frame.len()).sum::<usize>(),
        "water_m2": wet as f64 * frame.cell_area(),
    })
}

/// Seed of a stage: its own, so that stages draw from separate streams.
pub fn stage_seed(scene: &Scene, stage: Stage) -> Seed {
    Seed(scene.tables.seed).part(stage.word(), 0)
}

/// Where ecosim's files go.
#[derive(Clone, Debug)]
pub struct EcosimPaths {
    /// The terrain's folder, to read.
    pub terrain: PathBuf,
    /// A population to go on from, if any.
    pub start: Option<PathBuf>,
    /// The population, `.parquet` or `.csv`.
    pub population: PathBuf,
}

/// Ecosim: terrain to plants, with the history of simulations beside them.
///
/// # Errors
/// An input is damaged, the stage refuses, or the disk does.
pub fn ecosim(
    scene: &Scene,
    paths: &EcosimPaths,
    mut provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let stage = Stage::Ecosim;
    let terrain = weald_formats::read_terrain(&paths.terrain)?;
    let start = paths.start.as_deref().map(weald_formats::read_population).transpose()?;
    provenance.inputs.push(parent(&paths.terrain)?);
    if let Some(start) = &paths.start {
        provenance.inputs.push(parent(start)?);
    }
    let outcome = weald_ecosim::grow(
        &scene.ecosim,
        &weald_ecosim::Surroundings {
            terrain: &terrain,
            species: &ecosim_species(scene),
            images: &images(scene, &scene.ecosim_inputs)?,
            plants: &plants_of_tables(scene)?,
            views: &places_named(scene, &scene.ecosim),
        },
        start.as_ref(),
        stage_seed(scene, stage),
        progress,
    )
    .map_err(stage_error!(&scene.sources, stage, weald_ecosim))?;

    let mut made = Made { files: Vec::new(), report: population_report(&outcome.population) };
    made.report["deaths"] = json!(outcome.deaths.len());
    make_folder_of(&paths.population)?;
    weald_formats::write_population(&paths.population, &outcome.population, &provenance)?;
    made.wrote(&paths.population)?;
    let beside = |name: &str| paths.population.with_file_name(name);
    let names = &outcome.population.species;
    let tables = [
        (beside("summary.csv"), summary_table(&outcome.summary, names)),
        (beside("deaths.parquet"), deaths_table(&outcome.deaths, names)),
    ];
    for (path, table) in &tables {
        weald_formats::write_table(path, table, &provenance)?;
        made.wrote(path)?;
    }
    for path in
        made.files.clone().iter().filter(|path| path.extension().is_some_and(|e| e == "csv"))
    {
        made.wrote(&path.with_extension("csv.json"))?;
    }
    let colors = species_colors(scene, &outcome.population);
    let dots = preview::draw_population(&outcome.population, Some(&terrain), &colors);
    made.preview(&paths.population.with_extension("png"), &dots, &provenance)?;
    Ok(made)
}

/// Tables of plants among ecosim's inputs, by path as written.
fn plants_of_tables(scene: &Scene) -> Result<BTreeMap<String, Population>> {
    let mut tables = BTreeMap::new();
    for SceneInput { input, path } in &scene.ecosim_inputs {
        if input.kind == InputKind::Plants {
            let population =
                weald_formats::read_population(path).map_err(at_field(scene, input))?;
            tables.insert(input.path.value.clone(), population);
        }
    }
    Ok(tables)
}

fn species_colors(scene: &Scene, population: &Population) -> Vec<[u8; 3]> {
    let known = scene.species.iter().map(|(name, found)| (name.clone(), found.species.color));
    preview::colors_by_name(&population.species, &known.collect())
}

fn population_report(population: &Population) -> Json {
    let counts =
        population.species.iter().cloned().zip(population.counts().into_iter().map(Json::from));
    json!({ "plants": population.len(), "species": counts.collect::<serde_json::Map<_, _>>() })
}

/// Names of species by their index in a population, as a column.
fn species_column(names: &[String], indices: impl Iterator<Item = u16>) -> Column {
    let name = |index: u16| names.get(usize::from(index)).map_or("", String::as_str);
    Column::text(indices.map(name))
}

/// `summary.csv`: a row a year and species.
fn summary_table(rows: &[weald_ecosim::SummaryRow], names: &[String]) -> Table {
    let counts = |value: fn(&weald_ecosim::SummaryRow) -> u64| {
        Column::Unsigned(rows.iter().map(value).collect())
    };
    let numbers = |value: fn(&weald_ecosim::SummaryRow) -> f32| {
        Column::Float32(rows.iter().map(value).collect())
    };
    Table::default()
        .with("step", counts(|row| u64::from(row.step)))
        .with("species", species_column(names, rows.iter().map(|row| row.species)))
        .with("alive", counts(|row| row.alive))
        .with("births", counts(|row| row.births))
        .with("dominated", counts(|row| row.dominated))
        .with("old", counts(|row| row.old))
        .with("mean_radius", numbers(|row| row.mean_radius))
        .with("cover", numbers(|row| row.cover))
}

/// `deaths.parquet`: a row a death; `killer` is -1 where none is to blame.
fn deaths_table(deaths: &[weald_ecosim::Death], names: &[String]) -> Table {
    let killers = deaths.iter().map(|death| death.killer.map_or(-1, |killer| killer as i64));
    Table::default()
        .with("id", Column::Unsigned(deaths.iter().map(|death| death.id).collect()))
        .with("species", species_column(names, deaths.iter().map(|death| death.species)))
        .with("step", Column::Unsigned(deaths.iter().map(|death| u64::from(death.step)).collect()))
        .with("cause", Column::text(deaths.iter().map(|death| death.cause.word())))
        .with("killer", Column::Integer(killers.collect()))
}

/// Quantize: plants to a palette and instances, both in `folder`.
///
/// # Errors
/// The population is damaged, the stage refuses, or the disk does.
pub fn quantize(
    scene: &Scene,
    population: &Path,
    folder: &Path,
    provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let seed = stage_seed(scene, Stage::Quantize);
    let species = quantize_species(scene);
    let quantizing =
        Quantizing { config: &scene.quantize, species: &species, seed, sources: &scene.sources };
    quantizing.make(population, folder, provenance, progress)
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
}

impl Quantizing<'_> {
    /// Writes `palette.toml`, `instances.parquet` and `quantize.json` into `folder`.
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
        let quantized =
            weald_quantize::quantize(self.config, &population, self.species, self.seed, progress)
                .map_err(stage_error!(self.sources, Stage::Quantize, weald_quantize))?;
        make_folder(folder)?;
        let report = json!(quantized.report);
        let mut made = Made { files: Vec::new(), report: quantize_report(&quantized) };
        let palette = folder.join("palette.toml");
        weald_formats::write_palette(&palette, &quantized.palette, &provenance)?;
        made.wrote(&palette)?;
        let instances = folder.join("instances.parquet");
        weald_formats::write_instances(&instances, &quantized.instances, &provenance)?;
        made.wrote(&instances)?;
        let path = folder.join("quantize.json");
        write_json(&path, &json!({ "report": report, "provenance": provenance }))?;
        made.wrote(&path)?;
        Ok(made)
    }
}

fn quantize_report(quantized: &weald_quantize::Quantized) -> Json {
    json!({
        "representatives": quantized.palette.representatives.len(),
        "groups": quantized.palette.groups.len(),
        "instances": quantized.instances.len(),
    })
}

/// Writes JSON for people, with a final newline.
///
/// # Errors
/// The disk refuses.
pub fn write_json(path: &Path, value: &Json) -> Result<()> {
    use std::io::Write;
    weald_formats::write_atomically(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        Ok(file.write_all(b"\n")?)
    })?;
    Ok(())
}

/// File name of a representative's model.
pub fn plant_file(id: u32) -> String {
    format!("{id:04}.glb")
}

/// Plants: a model for every representative of a palette.
///
/// # Errors
/// The palette is damaged, a species cannot be grown, or the disk refuses.
pub fn plants(
    scene: &Scene,
    palette: &Path,
    folder: &Path,
    provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let seed = stage_seed(scene, Stage::Plants);
    let growing = Growing { species: &scene.species, seed, sources: &scene.sources };
    growing.make(palette, folder, provenance, progress)
}

/// What plants needs besides the palette; a scene provides it, or the command line alone.
pub struct Growing<'a> {
    /// Every species of the palette.
    pub species: &'a BTreeMap<String, SceneSpecies>,
    /// Seed of the stage.
    pub seed: Seed,
    /// Texts for problems.
    pub sources: &'a Sources,
}

impl Growing<'_> {
    /// Writes `ID.glb` for each representative into `folder`, and a contact sheet beside it.
    ///
    /// # Errors
    /// The palette is damaged, a species cannot be grown, or the disk refuses.
    pub fn make(
        &self,
        palette: &Path,
        folder: &Path,
        mut provenance: Provenance,
        progress: &dyn Progress,
    ) -> Result<Made> {
        provenance.inputs.push(parent(palette)?);
        let palette = weald_formats::read_palette(palette)?;
        make_folder(folder)?;
        let representatives = &palette.representatives;
        progress.begin("growing plants", representatives.len() as u64, "plants");
        let grown: Vec<(String, PlantModel)> = representatives
            .par_iter()
            .map(|plant| {
                if progress.is_cancelled() {
                    return Err(Error::Stopped { saved: false });
                }
                let model = self.grow(plant)?;
                // A model's story is its own: other species of the scene do not change its bytes.
                let story = plant_provenance(&provenance, plant);
                weald_formats::write_plant(&folder.join(plant_file(plant.id)), &model, &story)?;
                progress.advance(1);
                Ok((caption(plant), model))
            })
            .collect::<Result<_>>()?;

        let files = representatives.iter().map(|plant| folder.join(plant_file(plant.id))).collect();
        let unique: u64 = grown.iter().map(|(_, model)| model.unique_triangles()).sum();
        let instanced: u64 = grown.iter().map(|(_, model)| model.instanced_triangles()).sum();
        let report = json!({
            "models": grown.len(), "triangles": unique, "instanced_triangles": instanced,
        });
        let mut made = Made { files, report };
        let sheet: Vec<_> = grown.iter().map(|(name, model)| (name.clone(), model)).collect();
        let sheet = preview::contact_sheet(&sheet, SHEET_CELL);
        made.preview(&folder.with_extension("png"), &sheet, &provenance)?;
        Ok(made)
    }

    /// Grows one representative.
    fn grow(&self, plant: &Representative) -> Result<PlantModel> {
        let found = self.species.get(&plant.species);
        match found.and_then(|found| Some((&found.species.size, found.form.as_ref()?))) {
            Some((size, form)) => grow_one(self.sources, form, size, plant, self.seed),
            None => Err(Error::plain(
                format!(
                    "no `[form]` for representative {} of species `{}`",
                    plant.id, plant.species
                ),
                "add a `[form]` to the species' file: it says how the plant is grown",
            )),
        }
    }
}

/// Side of a model's cell on the contact sheet, pixels.
const SHEET_CELL: usize = 200;

fn caption(plant: &Representative) -> String {
    format!("{} {} {:.1} m", plant.id, plant.species, plant.height)
}

fn plant_provenance(stage: &Provenance, plant: &Representative) -> Provenance {
    let species = stage.parameters["species"].get(&plant.species).cloned();
    let parameters = json!({
        "species": species, "name": plant.species,
        "age": canonical(&plant.age), "vigor": canonical(&plant.vigor),
        "height": canonical(&plant.height), "radius": canonical(&plant.radius),
    });
    Provenance { parameters, ..stage.clone() }
}

/// Grows one plant; its chance hangs on its id, so that a palette may be grown in any order.
///
/// # Errors
/// The form or size cannot be grown.
pub fn grow_one(
    sources: &Sources,
    form: &weald_plants::Form,
    size: &weald_contract::Size,
    plant: &Representative,
    seed: Seed,
) -> Result<PlantModel> {
    let name = format!("{}-{}", plant.species, plant.id);
    let seed = seed.part(&plant.species, u64::from(plant.id));
    weald_plants::grow(&name, form, size, plant, seed).map_err(|error| match error {
        weald_plants::Error::Problem(problem) => Error::wrong(sources, problem),
        other => Error::Stage { stage: Stage::Plants.word(), message: other.to_string() },
    })
}

/// What render reads and writes.
#[derive(Clone, Debug)]
pub struct RenderPaths {
    /// The terrain's folder.
    pub terrain: PathBuf,
    /// The palette.
    pub palette: PathBuf,
    /// The instances.
    pub instances: PathBuf,
    /// Folder of the models.
    pub plants: PathBuf,
    /// The picture to write, `.exr`; a `.png` goes beside it.
    pub image: PathBuf,
}

/// Render: everything to a picture.
///
/// # Errors
/// A file is damaged, the stage refuses, or the disk does.
pub fn render(
    scene: &Scene,
    paths: &RenderPaths,
    is_draft: bool,
    mut provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let stage = Stage::Render;
    let error = || stage_error!(&scene.sources, stage, weald_render);
    let terrain = weald_formats::read_terrain(&paths.terrain)?;
    let palette = weald_formats::read_palette(&paths.palette)?;
    let instances = weald_formats::read_instances(&paths.instances)?;
    weald_formats::check_instances(&palette, &instances)
        .map_err(|problem| Error::wrong(&scene.sources, problem))?;
    provenance.inputs.extend([parent(&paths.terrain)?, parent(&paths.palette)?]);
    // The instances came with the palette: their story is told once.
    provenance.inputs.push(Parent { provenance: None, ..parent(&paths.instances)? });
    provenance.inputs.push(plants_parent(&paths.plants, &palette)?);

    let view = scene.rendered_view().ok_or_else(|| {
        Error::plain(format!("unknown view `{}`", scene.render.view.value), "add a `[[view]]`")
    })?;
    let config = render_config(scene, is_draft);
    let built = weald_render::Scene::build(
        &weald_render::Parts {
            terrain: &terrain,
            palette: &palette,
            instances: &instances,
            prototypes: &FolderPrototypes { folder: &paths.plants },
            objects: &objects(scene, &terrain)?,
            species: &species_names(&palette),
        },
        &scene.sky,
        progress,
    )
    .map_err(error())?;
    let film = weald_render::render(&built, view, &config, stage_seed(scene, stage), progress)
        .map_err(error())?;

    let mut made = Made::default();
    make_folder_of(&paths.image)?;
    let picture = film.picture();
    weald_formats::write_picture(&paths.image, &picture, &provenance)?;
    made.wrote(&paths.image)?;
    let rgb = weald_render::tone_map(&picture, config.exposure);
    let sketch = Sketch { width: picture.width, height: picture.height, rgb };
    made.preview(&paths.image.with_extension("png"), &sketch, &provenance)?;
    made.report = json!({ "scene": statistics(built.statistics()), "film": film.statistics() });
    Ok(made)
}

/// A scene's statistics as JSON; the count of instanced primitives may pass 64 bits and then
/// becomes a text.
fn statistics(statistics: &weald_render::Statistics) -> Json {
    let instanced = statistics.instanced_primitives;
    json!({
        "prototypes": statistics.prototypes,
        "instances": statistics.instances,
        "unique_primitives": statistics.unique_primitives,
        "instanced_primitives": u64::try_from(instanced).map_or_else(|_| json!(instanced.to_string()), Json::from),
        "bytes": statistics.bytes,
    })
}

/// All models as one parent: the hash of their hashes.
fn plants_parent(folder: &Path, palette: &Palette) -> Result<Parent> {
    let mut hasher = blake3::Hasher::new();
    for plant in &palette.representatives {
        let path = folder.join(plant_file(plant.id));
        hasher.update(weald_formats::hash_file(&path)?.as_bytes());
    }
    let blake3 = hasher.finalize().to_hex().to_string();
    Ok(Parent { name: file_name(folder), blake3, provenance: None })
}

/// Names of all species and groups in a palette, sorted: their order numbers them in pictures.
pub fn species_names(palette: &Palette) -> Vec<String> {
    let plants = palette.representatives.iter().map(|plant| plant.species.clone());
    let mut names: Vec<String> =
        plants.chain(palette.groups.iter().map(|group| group.species.clone())).collect();
    names.sort();
    names.dedup();
    names
}

/// Opens the models of `[[object]]` and puts them on the ground.
fn objects(scene: &Scene, terrain: &Layers) -> Result<Vec<weald_render::Object>> {
    let mut objects = Vec::new();
    for (object, SceneInput { input, path }) in scene.tables.object.iter().zip(&scene.object_inputs)
    {
        let model = weald_formats::read_plant(path).map_err(at_field(scene, input))?;
        let (x, y) = (terrain.frame.west + object.at[0], terrain.frame.south + object.at[1]);
        let ground =
            if object.altitude { 0.0 } else { terrain.sample("altitude", x, y).unwrap_or(0.0) };
        objects.push(weald_render::Object {
            model: Arc::new(model),
            position: [x, y, f64::from(ground) + object.height],
            // Azimuths turn clockwise, angles in code the other way.
            yaw: -object.yaw_deg.to_radians() as f32,
            scale: object.scale as f32,
        });
    }
    Ok(objects)
}
