//! Ecosim: terrain to plants, with the history of simulations beside them.

use super::{
    Made, at_field, images, make_folder_of, parent, stage_error, stage_seed, whole_terrain,
};
use crate::checkpoint::{self, Keeper, Saving};
use crate::error::{Error, Result};
use crate::parameters::{ecosim_species, hashed_inputs, views_seen_from};
use crate::preview;
use crate::recipe::Stage;
use crate::scene::{Scene, SceneInput};
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use weald_contract::{Crs, Frame, Image, InputKind, Layers, Population, Problem, Progress, Seed};
use weald_ecosim::{Course, Outcome, Surroundings};
use weald_formats::geotiff::BandRef;
use weald_formats::{Column, Provenance, Table};

/// Where ecosim's files go.
#[derive(Clone, Debug)]
pub struct EcosimPaths {
    /// The terrain's folder, to read.
    pub terrain: PathBuf,
    /// A population to go on from, if any.
    pub start: Option<PathBuf>,
    /// The population, `.parquet` or `.csv`.
    pub population: PathBuf,
    /// Whether and where the state is saved as the work goes on.
    pub saving: Option<Saving>,
}

/// Ecosim: terrain to plants, with the history of simulations beside them.
///
/// # Errors
/// An input is damaged, the stage refuses, or the disk does; [`Error::Paused`] when the work was
/// stopped with its state saved.
pub fn ecosim(
    scene: &Scene,
    paths: &EcosimPaths,
    mut provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let opened = Opened::new(scene, &paths.terrain, paths.start.as_deref())?;
    let outcome = match &paths.saving {
        None => opened
            .grow(scene, stage_seed(scene, Stage::Ecosim), progress, Course::default())
            .map_err(refusal(scene))?,
        Some(saving) => opened.grow_saving(scene, paths, saving, &provenance, progress)?,
    };
    provenance.inputs.push(parent(&paths.terrain)?);
    if let Some(start) = &paths.start {
        provenance.inputs.push(parent(start)?);
    }
    let made = opened.write(scene, &paths.population, &outcome, &provenance)?;
    paths.saving.as_ref().map_or(Ok(()), Saving::close)?;
    Ok(made)
}

/// Turns the stage's error into ours.
pub(crate) fn refusal(scene: &Scene) -> impl Fn(weald_ecosim::Error) -> Error {
    stage_error!(&scene.sources, Stage::Ecosim, weald_ecosim)
}

/// All that a growth reads, opened.
pub(crate) struct Opened {
    terrain: Arc<Layers>,
    start: Option<Arc<Population>>,
    images: Arc<BTreeMap<String, Image>>,
    plants: Arc<BTreeMap<String, Population>>,
}

impl Opened {
    pub(crate) fn new(scene: &Scene, terrain: &Path, start: Option<&Path>) -> Result<Self> {
        let terrain = Arc::new(whole_terrain(terrain)?);
        let start = start.map(weald_formats::read_population).transpose()?.map(Arc::new);
        Self::on(scene, terrain, start)
    }

    /// Opens the files of another scene on the same ground; what is the same is shared.
    pub(crate) fn like(&self, own: &Scene, other: &Scene) -> Result<Self> {
        let Self { terrain, start, images, plants } = self;
        let paths = |scene: &Scene| -> Vec<PathBuf> {
            scene.ecosim_inputs.iter().map(|input| input.path.clone()).collect()
        };
        if paths(own) == paths(other) {
            let (terrain, start) = (terrain.clone(), start.clone());
            return Ok(Self { terrain, start, images: images.clone(), plants: plants.clone() });
        }
        Self::on(other, terrain.clone(), start.clone())
    }

    fn on(scene: &Scene, terrain: Arc<Layers>, start: Option<Arc<Population>>) -> Result<Self> {
        check_maps(scene, &terrain.crs)?;
        let images = Arc::new(images(scene, &scene.ecosim_inputs)?);
        Ok(Self { terrain, start, images, plants: Arc::new(plants_of_tables(scene)?) })
    }

    /// The ground's extent.
    pub(crate) fn frame(&self) -> &Frame {
        &self.terrain.frame
    }

    pub(crate) fn grow(
        &self,
        scene: &Scene,
        seed: Seed,
        progress: &dyn Progress,
        course: Course<'_>,
    ) -> Result<Outcome, weald_ecosim::Error> {
        let around = Surroundings {
            terrain: &self.terrain,
            species: &ecosim_species(scene),
            images: &self.images,
            plants: &self.plants,
            views: &views_seen_from(scene, &scene.ecosim),
        };
        let start = self.start.as_deref();
        weald_ecosim::grow_on(&scene.ecosim, &around, start, seed, progress, course)
    }

    /// Grows with rests at which the state is saved, from the state that was saved before.
    fn grow_saving(
        &self,
        scene: &Scene,
        paths: &EcosimPaths,
        saving: &Saving,
        story: &Provenance,
        progress: &dyn Progress,
    ) -> Result<Outcome> {
        make_folder_of(&saving.file)?;
        let inputs = hashed_inputs(scene, Stage::Ecosim)?;
        let recipe = checkpoint::recipe(story, inputs, &paths.terrain, paths.start.as_deref())?;
        let from = saving.open(&recipe)?;
        let saved = from.as_ref().map(|checkpoint| {
            checkpoint::tell(saving, checkpoint, progress);
            checkpoint.year()
        });
        let mut keeper = Keeper::new(saving, &recipe, saved);
        let seed = stage_seed(scene, Stage::Ecosim);
        let grown = self.grow(scene, seed, progress, Course::new(from, Some(&mut keeper)));
        grown.map_err(|error| match (error, keeper.saved) {
            (weald_ecosim::Error::Paused | weald_ecosim::Error::Cancelled, Some(year)) => {
                Error::Paused { file: saving.file.clone(), year }
            }
            (error, _) => refusal(scene)(error),
        })
    }

    /// Writes the plants, the history and the previews.
    fn write(
        &self,
        scene: &Scene,
        population: &Path,
        outcome: &Outcome,
        provenance: &Provenance,
    ) -> Result<Made> {
        let mut made = Made { report: population_report(&outcome.population), ..Made::default() };
        made.report["deaths"] = json!(outcome.deaths.len());
        report_planting(&mut made.report, outcome);
        make_folder_of(population)?;
        weald_formats::write_population(population, &outcome.population, provenance)?;
        made.wrote(population)?;
        self.write_history(population, outcome, provenance, &mut made)?;
        self.write_previews(scene, population, outcome, provenance, &mut made)?;
        Ok(made)
    }

    /// Writes summary, deaths, layers and kept steps beside the population.
    fn write_history(
        &self,
        population: &Path,
        outcome: &Outcome,
        provenance: &Provenance,
        made: &mut Made,
    ) -> Result<()> {
        let beside = |name: &str| population.with_file_name(name);
        let names = &outcome.population.species;
        let area = self.terrain.frame.len() as f64 * self.terrain.frame.cell_area();
        let tables = [
            (beside("summary.csv"), summary_table(&outcome.summary, names, area)),
            (beside("deaths.parquet"), deaths_table(&outcome.deaths, names)),
        ];
        for (path, table) in &tables {
            weald_formats::write_table(path, table, provenance)?;
            made.wrote(path)?;
        }
        let is_csv = |path: &&PathBuf| path.extension().is_some_and(|ending| ending == "csv");
        for path in made.files.clone().iter().filter(is_csv) {
            made.wrote(&path.with_extension("csv.json"))?;
        }
        for (name, grid) in &outcome.layers {
            let path = beside(&format!("{name}.tif"));
            let band = BandRef {
                name,
                frame: grid.frame,
                crs: &self.terrain.crs,
                unit: "m-2",
                definition: "plants between sample plots",
                values: &grid.values,
            };
            weald_formats::geotiff::write_band(&path, band, provenance)?;
            made.wrote(&path)?;
        }
        for snapshot in &outcome.snapshots {
            let path = numbered(population, snapshot.step);
            weald_formats::write_population(&path, &snapshot.population, provenance)?;
            made.wrote(&path)?;
        }
        Ok(())
    }

    fn write_previews(
        &self,
        scene: &Scene,
        population: &Path,
        outcome: &Outcome,
        provenance: &Provenance,
        made: &mut Made,
    ) -> Result<()> {
        let Outcome { population: plants, summary, snapshots, .. } = outcome;
        let colors = species_colors(scene, plants);
        if !snapshots.is_empty() {
            let (frame, names) = (&self.terrain.frame, &plants.species);
            let sheet = preview::draw_stand(summary, snapshots, frame, names, &colors);
            made.preview(&population.with_file_name("stand.png"), &sheet, provenance)?;
        }
        let dots = preview::draw_population(plants, Some(&self.terrain), &colors);
        made.preview(&population.with_extension("png"), &dots, provenance)?;
        let densities = densities(scene, &self.images);
        if !densities.is_empty() {
            let is_patch =
                |name: &String| scene.species.get(name).is_some_and(|s| s.species.group.is_some());
            let is_drawn: Vec<bool> = plants.species.iter().map(|name| !is_patch(name)).collect();
            let ground = self.terrain.frame;
            let dots = preview::draw_dots(plants, ground, &densities, &colors, &is_drawn);
            made.preview(&population.with_extension("dots.png"), &dots, provenance)?;
        }
        Ok(())
    }
}

/// The density images of the halftones that run, with the colours of their species.
fn densities<'a>(scene: &Scene, images: &'a BTreeMap<String, Image>) -> Vec<preview::Painted<'a>> {
    let steps = scene.ecosim.step.iter().filter(|step| step.common.enabled);
    steps
        .filter_map(|step| {
            let weald_ecosim::Step::Halftone(halftone) = &step.variant else { return None };
            let image = images.get(&halftone.density.as_ref()?.value)?;
            let color = scene.species.get(&halftone.species.value)?.species.color;
            let color = color.map(|channel| channel.min(255) as u8);
            Some(preview::Painted { image, invert: halftone.invert, color })
        })
        .collect()
}

/// Complains of images on another map than the terrain's.
fn check_maps(scene: &Scene, terrain: &Crs) -> Result<()> {
    for SceneInput { input, path } in &scene.ecosim_inputs {
        let is_map = path
            .extension()
            .is_some_and(|e| e.eq_ignore_ascii_case("tif") || e.eq_ignore_ascii_case("tiff"));
        if input.kind != InputKind::Image || !is_map {
            continue;
        }
        let image =
            weald_formats::geotiff::reference_system(path).map_err(at_field(scene, input))?;
        // Images in degrees come to their UTM zone as they are read.
        let differ = matches!((image.epsg, terrain.epsg), (Some(a), Some(b)) if a != b);
        if differ && !image.is_geographic {
            let system = |crs: &Crs| format!("EPSG:{}", crs.epsg.unwrap_or_default());
            let message = format!(
                "`{}` is a map in {}, the terrain in {}",
                input.path.value,
                system(&image),
                system(terrain)
            );
            let hint = format!(
                "bring it to the terrain's reference system: `gdalwarp -t_srs {}`",
                system(terrain)
            );
            let problem = Problem::at(input.path.span, message).hint(hint);
            return Err(Error::wrong(&scene.sources, problem));
        }
    }
    Ok(())
}

/// Name of the population of one step: `population-0099.parquet`.
fn numbered(population: &Path, step: u32) -> PathBuf {
    let part = |part: Option<&OsStr>| part.unwrap_or_default().to_string_lossy().into_owned();
    let (stem, ending) = (part(population.file_stem()), part(population.extension()));
    population.with_file_name(format!("{stem}-{step:04}.{ending}"))
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

/// Adds what spacing left no room for, and how well sample plots predict each other.
fn report_planting(report: &mut Json, outcome: &weald_ecosim::Outcome) {
    let name = |species: u16| &outcome.population.species[usize::from(species)];
    for row in &outcome.unplaced {
        report[format!("{}_without_room", name(row.species))] = json!(row.unplaced);
    }
    for fit in &outcome.plot_fits {
        report[format!("{}_plot_error_per_m2", name(fit.species))] = json!(fit.error);
    }
}

/// Names of species by their index in a population, as a column.
fn species_column(names: &[String], indices: impl Iterator<Item = u16>) -> Column {
    let name = |index: u16| names.get(usize::from(index)).map_or("", String::as_str);
    Column::text(indices.map(name))
}

/// `summary.csv`: a row a year and species.
fn summary_table(rows: &[weald_ecosim::SummaryRow], names: &[String], area: f64) -> Table {
    let counts = |value: fn(&weald_ecosim::SummaryRow) -> u64| {
        Column::Unsigned(rows.iter().map(value).collect())
    };
    let numbers = |value: fn(&weald_ecosim::SummaryRow) -> f32| {
        Column::Float32(rows.iter().map(value).collect())
    };
    let derived = |value: &dyn Fn(&weald_ecosim::SummaryRow) -> f64| {
        Column::Float(rows.iter().map(value).collect())
    };
    Table::default()
        .with("step", counts(|row| u64::from(row.step)))
        .with("species", species_column(names, rows.iter().map(|row| row.species)))
        .with("alive", counts(|row| row.alive))
        .with("births", counts(|row| row.births))
        .with("dominated", counts(|row| row.dominated))
        .with("old", counts(|row| row.old))
        .with("disturbed", counts(|row| row.disturbed))
        .with("mean_radius", numbers(|row| row.mean_radius))
        .with("cover", numbers(|row| row.cover))
        .with("seeds", counts(|row| row.seeds))
        .with("density", derived(&|row| row.alive as f64 / area))
        .with("mean_area", derived(&|row| f64::from(row.cover) * area / row.alive.max(1) as f64))
        .with("gini", numbers(|row| row.sizes.gini))
        .with("cv", numbers(|row| row.sizes.variation))
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
