//! Error against size: a population quantized with more and more models, `weald quantize --sweep`.
//!
//! For each number of models a species the population is quantized, its models are grown, and a
//! sample of plants is grown exactly to see what the models cost in looks. Written are a table and,
//! for each number, maps of plants in the colour of their model and of their error, and a sheet of
//! the models.

use crate::alone::{Fields, config_of, folder_of, story};
use crate::analysis::plot;
use crate::appearance::{Likeness, Shape, likeness};
use crate::error::{Error, Result};
use crate::instancing::{INSTANCE_BYTES, Instancing, TRIANGLE_BYTES};
use crate::make::{Quantizing, grow_one};
use crate::preview::{self, Sketch};
use crate::recipe::Stage;
use crate::scene::{SceneSpecies, load_species};
use rayon::prelude::*;
use serde::Serialize;
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt;
use std::path::{Path, PathBuf};
use weald_analyze::figure::{Figure, Series, Style};
use weald_contract::{Plant, PlantModel, Population, Progress, Representative, Seed, Sources};
use weald_formats::{Column, Table};
use weald_plants::Conditions;
use weald_quantize::{Config, PartsReport, Quantized};

/// Longer side of a map, pixels.
const MAP_SIDE: usize = 480;

/// Plants that are grown exactly for each row: enough for the mean to settle to about a
/// hundredth, few enough to grow in seconds.
const SAMPLE: usize = 48;

/// What one number of models a species costs and saves.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Row {
    /// Models asked for of each species.
    pub asked: u32,
    /// Models grown, patches built and instances placed in all.
    pub models: u64,
    /// See `models`.
    pub groups: u64,
    /// See `models`.
    pub instances: u64,
    /// Triangles stored.
    pub unique_triangles: u64,
    /// Triangles seen, organs and patches counted at each of their places.
    pub instanced_triangles: u64,
    /// Bytes of stored triangles and of all transforms.
    pub bytes: u64,
    /// Bytes if every plant stood there for itself.
    pub bytes_without: u64,
    /// `bytes_without` over `bytes`.
    pub compression: f64,
    /// Organs of the models, if all models shared as many shapes as a species has models.
    pub parts: PartsReport,
    /// Weighted mean of the squared distances in the space of comparison, over all species.
    pub distortion: f64,
    /// Height before the instance is scaled, as a part of the model's: the worst plant.
    pub worst_height: f64,
    /// Exact plants against the models in their place, mean of a sample.
    pub likeness: Likeness,
    /// Exact plants against plants as deserving of another chance: what individuals differ.
    pub individuals: Likeness,
}

/// A sweep.
#[derive(Clone, Debug, Serialize)]
pub struct Sweep {
    /// By rising number of models.
    pub rows: Vec<Row>,
    /// Files that were written.
    pub files: Vec<PathBuf>,
}

/// Quantizes a population with each number of models a species and writes `sweep.csv`, a plot of it,
/// `map-N.png`, `error-N.png` and `models-N.png` into `folder`.
///
/// # Errors
/// The population is damaged, a species is nowhere or cannot be grown, or the disk refuses.
pub fn sweep(
    population: &Path,
    numbers: &[u32],
    folder: &Path,
    fields: &Fields,
    progress: &dyn Progress,
) -> Result<Sweep> {
    let mut sources = Sources::default();
    let config: Config = config_of(fields, &mut sources)?;
    let plants = weald_formats::read_population(population)?;
    let (_, species) = load_species(folder_of(population), plants.species.iter().cloned())?;
    let work = Work { config, plants: &plants, species: &species, seed: fields.seed };
    let mut story = story(Stage::Quantize, json!({ "sweep": numbers }), fields.seed);
    story.inputs.push(crate::make::parent(population)?);
    std::fs::create_dir_all(folder).map_err(|error| Error::system(folder, error))?;

    let mut sweep = Sweep { rows: Vec::new(), files: Vec::new() };
    progress.begin("sweeping", numbers.len() as u64, "sizes");
    for number in numbers {
        let quantized = work.quantize(*number)?;
        let models = work.models(&quantized)?;
        sweep.rows.push(work.row(*number, &quantized, &models, progress)?);
        for (name, sketch) in [
            (format!("map-{number}.png"), preview::draw_models(&plants, &quantized, MAP_SIDE)),
            (format!("error-{number}.png"), preview::draw_errors(&plants, &quantized, MAP_SIDE)),
            (format!("models-{number}.png"), sheet(&quantized, &models)),
        ] {
            let path = folder.join(name);
            weald_formats::write_png(&path, sketch.width, sketch.height, &sketch.rgb, &story)?;
            sweep.files.push(path);
        }
        progress.advance(1);
    }
    let path = folder.join("sweep.csv");
    weald_formats::write_table(&path, &table(&sweep.rows), &story)?;
    sweep.files.push(path);
    let path = folder.join("sweep.png");
    let sketch = plot::draw(&figure(&sweep.rows));
    weald_formats::write_png(&path, sketch.width, sketch.height, &sketch.rgb, &story)?;
    sweep.files.push(path);
    Ok(sweep)
}

/// What all rows of a sweep share.
struct Work<'a> {
    config: Config,
    plants: &'a Population,
    species: &'a BTreeMap<String, SceneSpecies>,
    seed: u64,
}

impl Work<'_> {
    fn quantize(&self, representatives: u32) -> Result<Quantized> {
        let config =
            Config { representatives, budget: None, memory_gb: None, ..self.config.clone() };
        let species: BTreeMap<_, _> = self
            .species
            .iter()
            .map(|(name, found)| (name.clone(), found.species.clone()))
            .collect();
        let seed = Seed(self.seed).part(Stage::Quantize.word(), 0);
        Quantizing {
            config: &config,
            species: &species,
            seed,
            sources: &Sources::default(),
            growing: None,
        }
        .values(self.plants, &weald_contract::Silent)
    }

    fn models(&self, quantized: &Quantized) -> Result<Vec<PlantModel>> {
        let representatives = &quantized.palette.representatives;
        representatives.par_iter().map(|plant| self.grow(plant, plant.id)).collect()
    }

    /// Grows a plant by the chance of a number.
    fn grow(&self, plant: &Representative, chance: u32) -> Result<PlantModel> {
        let found = self.species.get(&plant.species);
        let Some(found) = found.filter(|found| found.form.is_some()) else {
            let message = format!("species `{}` has no `[form]`", plant.species);
            return Err(Error::plain(message, "a sweep grows plants of every species"));
        };
        let seed = Seed(self.seed).part(Stage::Plants.word(), 0);
        let plant = Representative { id: chance, ..plant.clone() };
        grow_one(&Sources::default(), found, &plant, &Conditions::default(), seed)
    }

    fn row(
        &self,
        asked: u32,
        quantized: &Quantized,
        models: &[PlantModel],
        progress: &dyn Progress,
    ) -> Result<Row> {
        let (palette, instances) = (&quantized.palette, &quantized.instances);
        let unique = models.iter().map(PlantModel::unique_triangles).sum::<u64>();
        let organs = models.iter().flat_map(|model| &model.organs);
        let organ_count: u64 = organs.map(|organ| organ.placements.len() as u64).sum();
        let saved = Instancing::of(palette, instances, &models.iter().collect::<Vec<_>>());
        let instanced = saved.triangles_without as u64;
        let bytes =
            unique * TRIANGLE_BYTES + (organ_count + instances.len() as u64) * INSTANCE_BYTES;
        let bytes_without = instanced * TRIANGLE_BYTES;
        let mut copies = models.to_vec();
        let mut copies: Vec<&mut PlantModel> = copies.iter_mut().collect();
        let parts = weald_quantize::share_organs(&mut copies, asked as usize, |_| false)
            .map_err(|problem| Error::wrong(&Sources::default(), problem))?;
        let report = &quantized.report;
        let (likeness, individuals) = self.appearance(quantized, models, progress)?;
        Ok(Row {
            asked,
            models: models.len() as u64,
            groups: palette.groups.len() as u64,
            instances: instances.len() as u64,
            unique_triangles: unique,
            instanced_triangles: instanced,
            bytes,
            bytes_without,
            compression: bytes_without as f64 / bytes.max(1) as f64,
            parts,
            distortion: mean(report.species.iter().map(|s| (s.distortion, s.seen))),
            worst_height: report.species.iter().map(|s| s.height.worst).fold(0.0, f64::max),
            likeness,
            individuals,
        })
    }

    /// Likeness of a sample of the scene's plants to their models, and to other individuals.
    ///
    /// An exact plant grows by the chance of its model, so that what is seen is the error of age,
    /// vigor and size alone; the other individual grows by a chance of its own.
    fn appearance(
        &self,
        quantized: &Quantized,
        models: &[PlantModel],
        progress: &dyn Progress,
    ) -> Result<(Likeness, Likeness)> {
        let palette = &quantized.palette.representatives;
        // Representatives come first and are numbered from 1.
        let of_model = |row: usize| {
            let index = (quantized.instances.prototype[row] as usize).checked_sub(1)?;
            Some((row, palette.get(index)?, models.get(index)?))
        };
        let rows: Vec<_> = (0..self.plants.len()).filter_map(of_model).collect();
        let step = rows.len().div_ceil(SAMPLE).max(1);
        let sample: Vec<_> = rows.into_iter().step_by(step).collect();
        let pairs = sample.par_iter().map(|(row, model_plant, model)| {
            if progress.is_cancelled() {
                return Err(Error::Stopped { saved: false });
            }
            let exact_plant = exact(&self.plants.plants[*row], model_plant);
            let exact = Shape::of(&self.grow(&exact_plant, model_plant.id)?, 1.0);
            let stand_in = Shape::of(model, quantized.instances.scale[*row]);
            let other = u32::MAX - *row as u32;
            let individual = Shape::of(&self.grow(&exact_plant, other)?, 1.0);
            Ok((likeness(&exact, &stand_in), likeness(&exact, &individual)))
        });
        let (stand_ins, individuals): (Vec<_>, Vec<_>) =
            pairs.collect::<Result<Vec<_>>>()?.into_iter().unzip();
        Ok((mean_likeness(&stand_ins), mean_likeness(&individuals)))
    }
}

/// The plant itself where its model would stand.
fn exact(plant: &Plant, model: &Representative) -> Representative {
    Representative {
        age: plant.age,
        vigor: plant.vigor,
        height: plant.height.max(1e-3),
        radius: plant.radius,
        weight: 1.0,
        count: 1,
        ..model.clone()
    }
}

fn mean(values: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (sum, weight) =
        values.fold((0.0, 0.0), |(s, w), (value, weight)| (s + value * weight, w + weight));
    if weight > 0.0 { sum / weight } else { 0.0 }
}

fn mean_likeness(all: &[Likeness]) -> Likeness {
    let of = |value: fn(&Likeness) -> f64| mean(all.iter().map(|like| (value(like), 1.0)));
    Likeness {
        silhouette_iou: of(|like| like.silhouette_iou),
        leaf_area: of(|like| like.leaf_area),
        height: of(|like| like.height),
    }
}

/// Models on a sheet at most, so that each is still seen.
const SHEET_MODELS: usize = 64;

fn sheet(quantized: &Quantized, models: &[PlantModel]) -> Sketch {
    let palette = &quantized.palette.representatives;
    let step = models.len().div_ceil(SHEET_MODELS).max(1);
    let named: Vec<(String, &PlantModel)> = palette
        .iter()
        .zip(models)
        .step_by(step)
        .map(|(plant, model)| (format!("{} {:.1} m", plant.id, plant.height), model))
        .collect();
    preview::contact_sheet(&named, 96)
}

/// Error of looks against bytes, with what individuals of equal age, vigor and size differ by.
fn figure(rows: &[Row]) -> Figure {
    let series = |label: &str, color, style, error: &dyn Fn(&Row) -> f64| Series {
        label: label.into(),
        points: rows.iter().map(|row| [row.bytes as f64 / 1e6, 100.0 * error(row).abs()]).collect(),
        color,
        style,
    };
    let [blue, orange, green] = [[0, 114, 178], [213, 94, 0], [0, 158, 115]];
    Figure {
        title: "Plants against their models".into(),
        x_label: "models and instances, MB".into(),
        y_label: "error, %".into(),
        bands: Vec::new(),
        series: vec![
            series("outline", blue, Style::Line, &|row| 1.0 - row.likeness.silhouette_iou),
            series("leaf area", orange, Style::Line, &|row| 1.0 - row.likeness.leaf_area),
            series("height", green, Style::Line, &|row| 1.0 - row.likeness.height),
            series("outline of individuals", blue, Style::Dashed, &|row| {
                1.0 - row.individuals.silhouette_iou
            }),
        ],
    }
}

fn table(rows: &[Row]) -> Table {
    let whole = |of: fn(&Row) -> u64| Column::Unsigned(rows.iter().map(of).collect());
    let real = |of: fn(&Row) -> f64| Column::Float(rows.iter().map(of).collect());
    Table::default()
        .with("asked", whole(|row| u64::from(row.asked)))
        .with("models", whole(|row| row.models))
        .with("groups", whole(|row| row.groups))
        .with("instances", whole(|row| row.instances))
        .with("unique_triangles", whole(|row| row.unique_triangles))
        .with("instanced_triangles", whole(|row| row.instanced_triangles))
        .with("bytes", whole(|row| row.bytes))
        .with("bytes_without", whole(|row| row.bytes_without))
        .with("compression", real(|row| row.compression))
        .with("organs", whole(|row| row.parts.organs))
        .with("shared_organs", whole(|row| row.parts.shared))
        .with("organ_triangles", whole(|row| row.parts.triangles))
        .with("shared_organ_triangles", whole(|row| row.parts.shared_triangles))
        .with("distortion", real(|row| row.distortion))
        .with("worst_height", real(|row| row.worst_height))
        .with("silhouette_iou", real(|row| row.likeness.silhouette_iou))
        .with("leaf_area", real(|row| row.likeness.leaf_area))
        .with("height", real(|row| row.likeness.height))
        .with("individuals_silhouette_iou", real(|row| row.individuals.silhouette_iou))
        .with("individuals_leaf_area", real(|row| row.individuals.leaf_area))
}

impl fmt::Display for Sweep {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{:>6} {:>7} {:>9} {:>14} {:>9} {:>12} {:>10} {:>9} {:>7} {:>7}",
            "asked",
            "models",
            "triangles",
            "seen",
            "MB",
            "compression",
            "distortion",
            "height, %",
            "outline",
            "leaves"
        )?;
        for row in &self.rows {
            writeln!(
                f,
                "{:>6} {:>7} {:>9} {:>14} {:>9.1} {:>10.0}:1 {:>10.2e} {:>9.1} {:>7.3} {:>7.3}",
                row.asked,
                row.models,
                row.unique_triangles,
                row.instanced_triangles,
                row.bytes as f64 / 1e6,
                row.compression,
                row.distortion,
                row.worst_height * 100.0,
                row.likeness.silhouette_iou,
                row.likeness.leaf_area
            )?;
        }
        if let Some(row) = self.rows.last() {
            writeln!(
                f,
                "individuals of equal age, vigor and size: outline {:.3}, leaves {:.3}",
                row.individuals.silhouette_iou, row.individuals.leaf_area
            )?;
        }
        self.files.iter().try_for_each(|path| writeln!(f, "wrote {}", path.display()))
    }
}
