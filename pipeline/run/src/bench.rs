//! How fast this machine is at each stage: `weald bench`.
//!
//! Every figure times one kernel on an input made here, without files, so that numbers of two
//! machines or two versions can be compared. Each is the best of three runs: what disturbs a
//! measurement only ever makes it slower.
//!
//! Comparisons with other programs measure one stage at a time, on data that both can read
//! ([`Request::input`]), and read off the result as well as the time ([`Figure::result`]).

mod clock;
mod given;

use crate::bench::clock::Stopwatch;
use crate::error::{Error, Result};
use crate::make::grow_one;
use crate::recipe::Stage;
use crate::scene::{SceneSpecies, load_species};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use weald_contract::{
    Crs, Frame, FromToml, Grid, Instances, Layers, Palette, PlantModel, Problem, Raster,
    Representative, Seed, Silent, Sources, Value, View, instances,
};
use weald_render::PrototypeSource;

/// What to measure.
#[derive(Clone, Debug, Default)]
pub struct Request {
    /// Smaller inputs.
    pub quick: bool,
    /// This stage alone; all of them when absent.
    pub only: Option<Stage>,
    /// Size of the stage's input: cells along a side of the terrain, plants or points, rows,
    /// trees to grow, trees in the picture.
    pub size: Option<u32>,
    /// A file to measure on: an elevation model for terrain, a table with `x`, `y` and `radius`
    /// for ecosim, a table of numbers (and perhaps `weight`) for quantize.
    pub input: Option<PathBuf>,
    /// Runs of which the fastest counts; 3 when absent.
    pub repeat: Option<u32>,
}

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
    /// Seconds of the fastest run.
    pub seconds: f64,
    /// Processor seconds of that run, all threads together; 0 where the system does not tell.
    pub cpu_seconds: f64,
    /// A number of the result that another program must find too, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub result: Option<f64>,
    /// Size of the input.
    pub input: String,
}

impl Figure {
    /// Work a second.
    fn rate(name: &'static str, work: f64, unit: &'static str, time: Time, input: String) -> Self {
        Self { value: work / time.seconds, ..Self::time(name, time, input) }.of(unit)
    }

    /// A time.
    fn time(name: &'static str, time: Time, input: String) -> Self {
        let Time { seconds, cpu_seconds } = time;
        Self { name, value: seconds, unit: "s", seconds, cpu_seconds, result: None, input }
    }

    fn of(self, unit: &'static str) -> Self {
        Self { unit, ..self }
    }

    fn with(self, result: f64) -> Self {
        Self { result: Some(result), ..self }
    }
}

/// Measures every stage, or the one asked for.
///
/// # Errors
/// The input file cannot be read or does not fit, or a stage refuses an input that was made for
/// it, which would be a mistake of ours.
pub fn bench(request: &Request) -> Result<Figures> {
    let size = Size::of(request);
    let species = species()?;
    let mut figures = Vec::new();
    for stage in Stage::ALL {
        if request.only.is_some_and(|only| only != stage) {
            continue;
        }
        let input = request.input.as_deref();
        match stage {
            Stage::Terrain => figures.extend(terrain(&size, input)?),
            Stage::Ecosim => {
                figures.push(self_thinning(&size, input)?);
                if input.is_none() {
                    figures.push(plant_steps(&size, &species)?);
                    figures.push(lloyd(&size)?);
                }
            }
            Stage::Quantize => figures.extend(vector_quantization(&size, input)?),
            Stage::Plants => figures.push(triangles(&size, &species)?),
            Stage::Render => figures.extend(rays(&size, &species)?),
        }
    }
    Ok(Figures {
        version: env!("CARGO_PKG_VERSION"),
        threads: rayon::current_num_threads(),
        quick: request.quick,
        figures,
        peak_memory_bytes: peak_memory().unwrap_or(0),
    })
}

/// Sizes of the inputs.
#[derive(Clone, Copy)]
struct Size {
    terrain_side: usize,
    first_plants: u32,
    years: u32,
    points: usize,
    vectors: usize,
    trees: u32,
    standing: u32,
    picture: [u32; 2],
    samples: u32,
    repeat: u32,
}

impl Size {
    const FULL: Size = Size {
        terrain_side: 1024,
        first_plants: 10_000,
        years: 20,
        points: 100_000,
        vectors: 100_000,
        trees: 16,
        standing: 256,
        picture: [240, 135],
        samples: 8,
        repeat: 3,
    };
    const QUICK: Size = Size {
        terrain_side: 256,
        first_plants: 1_000,
        years: 10,
        points: 10_000,
        vectors: 10_000,
        trees: 4,
        standing: 64,
        picture: [96, 54],
        samples: 4,
        repeat: 3,
    };

    fn of(request: &Request) -> Self {
        let mut size = if request.quick { Self::QUICK } else { Self::FULL };
        size.repeat = request.repeat.unwrap_or(size.repeat).max(1);
        let Some((stage, wanted)) = request.only.zip(request.size) else { return size };
        let count = wanted.max(1) as usize;
        match stage {
            Stage::Terrain => size.terrain_side = count.max(2),
            Stage::Ecosim => (size.first_plants, size.points) = (wanted.max(1), count),
            Stage::Quantize => size.vectors = count,
            Stage::Plants => size.trees = wanted.max(1),
            Stage::Render => size.standing = wanted.max(1),
        }
        size
    }
}

/// How long something took.
#[derive(Clone, Copy)]
struct Time {
    seconds: f64,
    cpu_seconds: f64,
}

/// Time of the fastest run, and what it made.
fn best<T>(size: &Size, mut work: impl FnMut() -> Result<T>) -> Result<(Time, T)> {
    let mut fastest: Option<(Time, T)> = None;
    for _ in 0..size.repeat {
        let watch = Stopwatch::start();
        let made = black_box(work()?);
        let (seconds, cpu_seconds) = watch.read();
        if fastest.as_ref().is_none_or(|(best, _)| seconds < best.seconds) {
            fastest = Some((Time { seconds, cpu_seconds }, made));
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

fn terrain(size: &Size, input: Option<&Path>) -> Result<Vec<Figure>> {
    use weald_terrain::flow;
    let raster = match input {
        Some(path) => given::raster(path)?,
        None => Raster { grid: ground(size.terrain_side), crs: Crs::default() },
    };
    let Frame { width, height, .. } = raster.grid.frame;
    let cells = (width * height) as f64;
    let rate = |name, time| {
        Figure::rate(name, cells, "cells/s", time, format!("{width} x {height} cells"))
    };
    let config = "source = \"x\"\n[[op]]\nop = \"noise\"\namplitude = 0.5\nwavelength = 30.0\n";
    let config: weald_terrain::Config = table(config)?;
    let (whole, _) = best(size, || {
        weald_terrain::build(&config, &raster, &BTreeMap::new(), &[], Seed(1), &Silent)
            .map_err(wrong)
    })?;
    let altitude = &raster.grid.values;
    let (fill, flood) = best(size, || Ok(flow::fill(width, height, altitude)))?;
    let raised = flood.level.iter().zip(altitude).map(|(a, b)| f64::from(*a) - f64::from(*b)).sum();
    let (down, drained) = best(size, || {
        let directions = flow::directions(width, height, &flood);
        Ok(flow::accumulate(width, &directions, vec![1.0; width * height]))
    })?;
    let largest = drained.iter().copied().fold(0.0, f64::max);
    Ok(vec![
        rate("terrain", whole),
        rate("fill", fill).with(raised),
        rate("D8 and accumulation", down).with(largest),
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
    let (time, outcome) =
        best(size, || weald_ecosim::grow(&config, &around, None, Seed(1), &Silent).map_err(wrong))?;
    let steps: u64 = outcome.summary.iter().filter(|row| row.step > 0).map(|row| row.alive).sum();
    let input = format!("{} plants at first, {} years", size.first_plants, size.years);
    Ok(Figure::rate("simulation", steps as f64, "plant-steps/s", time, input))
}

/// The bare competition of [Deussen98] §5.1: what is dominated dies, what lives grows.
///
/// Unless circles are given, there is one to a square metre, with a radius of 2 to 10 cm.
fn self_thinning(size: &Size, input: Option<&Path>) -> Result<Figure> {
    const YEARS: u32 = 20;
    const GROWTH: f32 = 0.01;
    let circles = match input {
        Some(path) => given::circles(path)?,
        None => {
            let side = f64::from(size.first_plants).sqrt();
            let mut chance = Seed(1).stream("circles", 0);
            (0..size.first_plants)
                .map(|_| {
                    let [x, y, radius] =
                        [(0.0, side), (0.0, side), (0.02, 0.1)].map(|(a, b)| chance.range(a, b));
                    given::circle(x, y, radius as f32)
                })
                .collect()
        }
    };
    let (time, (steps, living)) = best(size, || {
        let (mut circles, mut steps) = (circles.clone(), 0);
        for _ in 0..YEARS {
            steps += circles.len();
            let (plain, order) = (weald_ecosim::Plain::Open, weald_ecosim::Order::Sync);
            let over = weald_ecosim::dominators(&circles, plain, order, |_| false);
            let mut over = over.iter();
            circles.retain(|_| over.next().is_some_and(Option::is_none));
            for circle in &mut circles {
                circle.radius += GROWTH;
                circle.ability = circle.radius;
            }
        }
        Ok((steps, circles.len()))
    })?;
    let input = format!("{} circles at first, {YEARS} years", circles.len());
    let figure = Figure::rate("self-thinning", steps as f64, "plant-steps/s", time, input);
    Ok(figure.with(living as f64))
}

fn lloyd(size: &Size) -> Result<Figure> {
    let side = (size.points as f64).sqrt() as usize;
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let density = Grid::filled(frame, 1.0);
    let mut chance = Seed(1).stream("points", 0);
    let points: Vec<[f64; 2]> = (0..size.points)
        .map(|_| [chance.range(0.0, side as f64), chance.range(0.0, side as f64)])
        .collect();
    let (time, _) = best(size, || {
        let mut moved = points.clone();
        weald_ecosim::relax(&mut moved, &density, &weald_ecosim::Relaxation::pass(0, 1));
        Ok(moved)
    })?;
    let input = format!("{} points, one pass", size.points);
    Ok(Figure::rate("Lloyd relaxation", size.points as f64, "points/s", time, input))
}

fn vector_quantization(size: &Size, input: Option<&Path>) -> Result<Vec<Figure>> {
    use weald_quantize::{Mode, cluster};
    const COLUMNS: usize = 4;
    const CLUSTERS: usize = 64;
    let table = match input {
        Some(path) => given::numbers(path)?,
        None => {
            let mut chance = Seed(1).stream("vectors", 0);
            let values = (0..size.vectors * COLUMNS).map(|_| chance.unit()).collect();
            weald_quantize::Table::new(values, COLUMNS, vec![1.0; size.vectors]).map_err(wrong)?
        }
    };
    let input = format!("{} rows of {} to {CLUSTERS}", table.len(), table.columns());
    [
        ("vector quantization, paper", Mode::Paper),
        ("vector quantization, fast", Mode::Fast),
        ("vector quantization, best", Mode::Best),
    ]
    .into_iter()
    .map(|(name, mode)| {
        let (time, found) = best(size, || Ok(cluster(&table, CLUSTERS, mode)))?;
        Ok(Figure::time(name, time, input.clone()).with(found.distortion(&table)))
    })
    .collect()
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
    let (time, models) = best(size, || {
        (0..size.trees)
            .into_par_iter()
            .map(|id| grown(species, "aspen", 60.0, id))
            .collect::<Result<Vec<_>>>()
    })?;
    let count: u64 = models.iter().map(PlantModel::instanced_triangles).sum();
    let input = format!("{} trees, {count} triangles with leaves", size.trees);
    let figure = Figure::rate("Weber-Penn aspen", count as f64, "triangles/s", time, input);
    Ok(figure.with(count as f64))
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
    /// Square metres to a tree.
    const ROOM: f64 = 16.0;
    /// Tufts of grass to a tree.
    const TUFTS: u64 = 64;
    let side = (f64::from(size.standing) * ROOM).sqrt().max(8.0);
    let terrain = plain(side as usize);
    let models = Held(vec![
        Arc::new(grown(species, "aspen", 25.0, 1)?),
        Arc::new(grown(species, "grass", 3.0, 2)?),
    ]);
    let palette =
        Palette { representatives: vec![row(1, "aspen"), row(2, "grass")], groups: Vec::new() };
    let mut placed = Instances::default();
    scatter(&mut placed, 1, u64::from(size.standing), side);
    scatter(&mut placed, 2, u64::from(size.standing) * TUFTS, side);
    let sky: weald_render::Sky = table("")?;
    let parts = weald_render::Parts {
        terrain: &terrain,
        palette: &palette,
        instances: &placed,
        prototypes: &models,
        objects: &[],
        species: &["aspen".to_string(), "grass".to_string()],
    };
    let (built, scene) =
        best(size, || weald_render::Scene::build(&parts, &sky, &Silent).map_err(wrong))?;
    let middle = side / 2.0;
    let view = format!("name = \"in\"\nstand_at = [{middle}, 2]\nlook_at = [{middle}, 40]\n");
    let view: View = table(&view)?;
    let [width, height] = size.picture;
    let samples = size.samples;
    let config = format!("view = \"in\"\nresolution = [{width}, {height}]\nsamples = {samples}\n");
    let config: weald_render::Config = table(&config)?;
    let (time, film) = best(size, || {
        weald_render::render(&scene, &view, &config, Seed(1), &Silent).map_err(wrong)
    })?;
    let counted = film.statistics();
    let triangles = scene.statistics().instanced_primitives;
    let standing = format!("{} instances, {triangles} triangles", placed.len());
    let input = format!("{width} x {height}, {samples} samples, {standing}");
    Ok(vec![
        Figure::time("scene", built, standing),
        Figure::rate("rays", counted.rays as f64, "rays/s", time, input.clone()),
        Figure::rate("light paths", counted.samples as f64, "samples/s", time, input),
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
        for Figure { name, value, unit, input, .. } in &self.figures {
            let value = match value {
                v if *v >= 1e6 => format!("{:.2} M", v / 1e6),
                v if *v >= 1e3 => format!("{:.1} k", v / 1e3),
                v => format!("{v:.4} "),
            };
            writeln!(f, "{name:<27} {value:>10}{unit:<14} {input}")?;
        }
        let memory = crate::check::bytes_in_words(self.peak_memory_bytes);
        writeln!(f, "{:<27} {memory}", "peak memory")?;
        writeln!(f, "{:<27} {}", "threads", self.threads)
    }
}
