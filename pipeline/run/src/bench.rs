//! How fast this machine is at each stage: `weald bench`.
//!
//! Every figure times one kernel on an input made here, without files, so that numbers of two
//! machines or two versions can be compared. Each is the best of three runs: what disturbs a
//! measurement only ever makes it slower.

use crate::error::{Error, Result};
use crate::make::grow_one;
use crate::scene::{SceneSpecies, load_species};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::hint::black_box;
use std::path::Path;
use std::sync::Arc;
use std::time::Instant;
use weald_contract::{
    Crs, Frame, FromToml, Grid, Instances, Layers, Palette, PlantModel, Problem, Raster,
    Representative, Seed, Silent, Sources, Value, View, instances,
};
use weald_render::PrototypeSource;

/// What was measured.
#[derive(Clone, Debug, Serialize)]
pub struct Figures {
    /// Version of the program.
    pub version: &'static str,
    /// Threads used.
    pub threads: usize,
    /// Whether inputs were the small ones.
    pub quick: bool,
    /// The figures, by the order of the stages.
    pub figures: Vec<Figure>,
    /// Most memory that the process held, bytes; 0 where the system does not tell.
    pub peak_memory_bytes: u64,
}

/// One figure.
#[derive(Clone, Debug, Serialize)]
pub struct Figure {
    /// What was timed.
    pub name: &'static str,
    /// How much of it a second, or how long it took.
    pub value: f64,
    /// Unit of `value`.
    pub unit: &'static str,
    /// Size of the input.
    pub input: String,
}

/// Measures every stage.
///
/// # Errors
/// A stage refuses an input that was made for it, which would be a mistake of ours.
pub fn bench(is_quick: bool) -> Result<Figures> {
    let size = if is_quick { Size::QUICK } else { Size::FULL };
    let species = species()?;
    let mut figures = terrain(&size)?;
    figures.push(plant_steps(&size, &species)?);
    figures.push(lloyd(&size));
    figures.push(vector_quantization(&size)?);
    figures.push(triangles(&size, &species)?);
    figures.extend(rays(&size, &species)?);
    Ok(Figures {
        version: env!("CARGO_PKG_VERSION"),
        threads: rayon::current_num_threads(),
        quick: is_quick,
        figures,
        peak_memory_bytes: peak_memory().unwrap_or(0),
    })
}

/// Sizes of the inputs.
struct Size {
    terrain_side: usize,
    first_plants: u32,
    years: u32,
    points: usize,
    vectors: usize,
    trees: u32,
    picture: [u32; 2],
    samples: u32,
}

impl Size {
    const FULL: Size = Size {
        terrain_side: 1024,
        first_plants: 10_000,
        years: 20,
        points: 100_000,
        vectors: 100_000,
        trees: 16,
        picture: [240, 135],
        samples: 8,
    };
    const QUICK: Size = Size {
        terrain_side: 256,
        first_plants: 1_000,
        years: 10,
        points: 10_000,
        vectors: 10_000,
        trees: 4,
        picture: [96, 54],
        samples: 4,
    };
}

/// Seconds of the fastest of three runs, and what it made.
fn best<T>(mut work: impl FnMut() -> Result<T>) -> Result<(f64, T)> {
    let mut fastest: Option<(f64, T)> = None;
    for _ in 0..3 {
        let began = Instant::now();
        let made = black_box(work()?);
        let seconds = began.elapsed().as_secs_f64().max(1e-9);
        if fastest.as_ref().is_none_or(|(best, _)| seconds < *best) {
            fastest = Some((seconds, made));
        }
    }
    fastest.ok_or_else(|| wrong("nothing was measured"))
}

/// An input of ours was refused.
fn wrong(error: impl fmt::Display) -> Error {
    Error::Stage { stage: "bench", message: error.to_string() }
}

fn species() -> Result<BTreeMap<String, SceneSpecies>> {
    Ok(load_species(Path::new(""), ["aspen".to_string(), "grass".to_string()])?.1)
}

/// Reads a stage's table from a text of ours.
fn table<T: FromToml>(text: &str) -> Result<T> {
    let tree = Value::parse(0, text).map_err(|problems| wrong(format!("{problems:?}")))?;
    let mut problems = Vec::new();
    T::from_toml(&tree, &mut problems).ok_or_else(|| wrong(format!("{problems:?}")))
}

/// Rolling ground with hollows, 1 m cells.
fn ground(side: usize) -> Grid {
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let wave = |x: f64, length: f64| libm::sin(std::f64::consts::TAU * x / length);
    Grid::from_fn(frame, |x, y| {
        let hills = 6.0 * wave(x, 173.0) * wave(y, 211.0) + 1.5 * wave(x + 0.7 * y, 41.0);
        (100.0 + 0.004 * x + hills) as f32
    })
}

fn terrain(size: &Size) -> Result<Vec<Figure>> {
    let side = size.terrain_side;
    let cells = (side * side) as f64;
    let input = format!("{side} x {side} cells");
    let raster = Raster { grid: ground(side), crs: Crs::default() };
    let config = "source = \"x\"\n[[op]]\nop = \"noise\"\namplitude = 0.5\nwavelength = 30.0\n";
    let config: weald_terrain::Config = table(config)?;
    let (seconds, _) = best(|| {
        weald_terrain::build(&config, &raster, &BTreeMap::new(), &[], Seed(1), &Silent)
            .map_err(wrong)
    })?;
    let (flow_seconds, _) = best(|| {
        let flood = weald_terrain::flow::fill(side, side, &raster.grid.values);
        let directions = weald_terrain::flow::directions(side, side, &flood);
        Ok(weald_terrain::flow::accumulate(side, &directions, vec![1.0; side * side]))
    })?;
    Ok(vec![
        Figure { name: "terrain", value: cells / seconds, unit: "cells/s", input: input.clone() },
        Figure {
            name: "fill, D8, accumulate",
            value: cells / flow_seconds,
            unit: "cells/s",
            input,
        },
    ])
}

/// The terrain of a stand: a level plain, moist in the middle.
fn plain(side: usize) -> Layers {
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let mut layers =
        Layers { frame, crs: Crs::default(), layers: BTreeMap::new(), detail: Vec::new() };
    for (name, unit, value) in [
        ("altitude", "m", 100.0),
        ("slope", "degree", 0.0),
        ("aspect", "degree", 0.0),
        ("water_depth", "m", 0.0),
        ("soil_moisture", "1", 0.5),
    ] {
        layers.insert(name, unit, "the same everywhere", vec![value; frame.len()]);
    }
    layers
}

fn plant_steps(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Figure> {
    // A hectare for a thousand plants: crowns meet after a few years, as in a wood.
    let side = (f64::from(size.first_plants) * 10.0).sqrt() as usize;
    let terrain = plain(side);
    let text = format!(
        "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\"]\nyears = {}\ninitial = {}\n",
        size.years, size.first_plants
    );
    let config: weald_ecosim::Config = table(&text)?;
    let aspen = &species["aspen"];
    let known =
        [("aspen".to_string(), (aspen.species.clone(), aspen.ecology.clone().unwrap_or_default()))];
    let known = BTreeMap::from(known);
    let around = weald_ecosim::Surroundings {
        terrain: &terrain,
        species: &known,
        images: &BTreeMap::new(),
        plants: &BTreeMap::new(),
        views: &[],
    };
    let (seconds, outcome) =
        best(|| weald_ecosim::grow(&config, &around, None, Seed(1), &Silent).map_err(wrong))?;
    let steps: u64 = outcome.summary.iter().filter(|row| row.step > 0).map(|row| row.alive).sum();
    Ok(Figure {
        name: "simulation",
        value: steps as f64 / seconds,
        unit: "plant-steps/s",
        input: format!("{} plants at first, {} years", size.first_plants, size.years),
    })
}

fn lloyd(size: &Size) -> Figure {
    let side = (size.points as f64).sqrt() as usize;
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let density = Grid::filled(frame, 1.0);
    let mut chance = Seed(1).stream("points", 0);
    let points: Vec<[f64; 2]> = (0..size.points)
        .map(|_| [chance.range(0.0, side as f64), chance.range(0.0, side as f64)])
        .collect();
    let mut fastest = f64::INFINITY;
    for _ in 0..3 {
        let mut moved = points.clone();
        let began = Instant::now();
        weald_ecosim::relax(&mut moved, &density, &weald_ecosim::Relaxation::pass(0, 1));
        black_box(&moved);
        fastest = fastest.min(began.elapsed().as_secs_f64());
    }
    Figure {
        name: "Lloyd relaxation",
        value: size.points as f64 / fastest,
        unit: "points/s",
        input: format!("{} points, one pass", size.points),
    }
}

fn vector_quantization(size: &Size) -> Result<Figure> {
    const COLUMNS: usize = 4;
    const CLUSTERS: usize = 64;
    let mut chance = Seed(1).stream("vectors", 0);
    let values = (0..size.vectors * COLUMNS).map(|_| chance.unit()).collect();
    let table =
        weald_quantize::Table::new(values, COLUMNS, vec![1.0; size.vectors]).map_err(wrong)?;
    let (seconds, _) =
        best(|| Ok(weald_quantize::cluster(&table, CLUSTERS, weald_quantize::Mode::Fast)))?;
    Ok(Figure {
        name: "vector quantization",
        value: seconds,
        unit: "s",
        input: format!("{} rows of {COLUMNS} to {CLUSTERS}", size.vectors),
    })
}

/// A full-grown plant of a species.
fn grown(
    species: &BTreeMap<String, SceneSpecies>,
    name: &str,
    age: f32,
    id: u32,
) -> Result<PlantModel> {
    let found = &species[name];
    let form = found.form.as_ref().ok_or_else(|| wrong(format!("{name} has no form")))?;
    let size = &found.species.size;
    let height = size.height_at(age, 0.9);
    let plant = Representative {
        id,
        species: name.into(),
        age,
        vigor: 0.9,
        height,
        radius: size.radius_of_height(height),
        weight: 1.0,
        count: 1,
    };
    grow_one(&Sources::default(), form, size, &plant, Seed(1))
}

fn triangles(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Figure> {
    use rayon::prelude::*;
    let (seconds, models) = best(|| {
        (0..size.trees)
            .into_par_iter()
            .map(|id| grown(species, "aspen", 60.0, id))
            .collect::<Result<Vec<_>>>()
    })?;
    let count: u64 = models.iter().map(PlantModel::instanced_triangles).sum();
    Ok(Figure {
        name: "Weber-Penn aspen",
        value: count as f64 / seconds,
        unit: "triangles/s",
        input: format!("{} trees, {count} triangles with leaves", size.trees),
    })
}

/// Models held in memory, by id from 1.
struct Held(Vec<Arc<PlantModel>>);

impl PrototypeSource for Held {
    fn model(&self, prototype: u32) -> Result<Arc<PlantModel>, Problem> {
        let index = (prototype as usize).wrapping_sub(1);
        self.0.get(index).cloned().ok_or_else(|| Problem::new(format!("no model {prototype}")))
    }
}

/// A wood on a meadow: trees every 4 m or so, tufts of grass every half metre.
fn rays(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Vec<Figure>> {
    const SIDE: usize = 64;
    let terrain = plain(SIDE);
    let models = Held(vec![
        Arc::new(grown(species, "aspen", 25.0, 1)?),
        Arc::new(grown(species, "grass", 3.0, 2)?),
    ]);
    let palette =
        Palette { representatives: vec![row(1, "aspen"), row(2, "grass")], groups: Vec::new() };
    let mut placed = Instances::default();
    scatter(&mut placed, 1, 256, SIDE as f64);
    scatter(&mut placed, 2, 16_384, SIDE as f64);
    let sky: weald_render::Sky = table("")?;
    let parts = weald_render::Parts {
        terrain: &terrain,
        palette: &palette,
        instances: &placed,
        prototypes: &models,
        objects: &[],
        species: &["aspen".to_string(), "grass".to_string()],
    };
    let scene = weald_render::Scene::build(&parts, &sky, &Silent).map_err(wrong)?;
    let view: View = table("name = \"in\"\nstand_at = [32, 2]\nlook_at = [32, 40]\n")?;
    let [width, height] = size.picture;
    let samples = size.samples;
    let config = format!("view = \"in\"\nresolution = [{width}, {height}]\nsamples = {samples}\n");
    let config: weald_render::Config = table(&config)?;
    let (seconds, film) =
        best(|| weald_render::render(&scene, &view, &config, Seed(1), &Silent).map_err(wrong))?;
    let counted = film.statistics();
    let input = format!(
        "{width} x {height}, {samples} samples, {} triangles",
        scene.statistics().instanced_primitives
    );
    Ok(vec![
        Figure {
            name: "rays",
            value: counted.rays as f64 / seconds,
            unit: "rays/s",
            input: input.clone(),
        },
        Figure {
            name: "light paths",
            value: counted.samples as f64 / seconds,
            unit: "samples/s",
            input,
        },
    ])
}

fn row(id: u32, species: &str) -> Representative {
    Representative {
        id,
        species: species.into(),
        age: 1.0,
        vigor: 1.0,
        height: 1.0,
        radius: 1.0,
        weight: 1.0,
        count: 1,
    }
}

/// Places `count` instances at random, turned at random.
fn scatter(placed: &mut Instances, prototype: u32, count: u64, side: f64) {
    for plant in 0..count {
        let mut chance = Seed(1).stream("scatter", u64::from(prototype) << 32 | plant);
        let (x, y) = (chance.range(0.0, side), chance.range(0.0, side));
        let half = chance.range(0.0, std::f64::consts::PI);
        placed.push(instances::Instance {
            group: 0,
            prototype,
            plant_id: plant,
            position: [x, y, 100.0],
            rotation: [0.0, 0.0, libm::sin(half) as f32, libm::cos(half) as f32],
            scale: 1.0,
        });
    }
}

/// Most memory that this process held, bytes, where the system tells it.
pub fn peak_memory() -> Option<u64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find(|line| line.starts_with("VmHWM:"))?;
    let kilobytes: u64 = line.split_whitespace().nth(1)?.parse().ok()?;
    Some(kilobytes * 1024)
}

impl fmt::Display for Figures {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for Figure { name, value, unit, input } in &self.figures {
            let value = match value {
                v if *v >= 1e6 => format!("{:.2} M", v / 1e6),
                v if *v >= 1e3 => format!("{:.1} k", v / 1e3),
                v => format!("{v:.4} "),
            };
            writeln!(f, "{name:<22} {value:>10}{unit:<14} {input}")?;
        }
        let memory = crate::check::bytes_in_words(self.peak_memory_bytes);
        writeln!(f, "{:<22} {memory}", "peak memory")?;
        writeln!(f, "{:<22} {}", "threads", self.threads)
    }
}
