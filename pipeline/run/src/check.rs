//! What a run will take, before any work: `weald check`.
//!
//! Mistakes are found when the scene is read; what is left to say is how much memory and time
//! the work needs. The figures are estimates from sizes alone, meant to tell seconds from hours.

use crate::error::{Error, Result, none_wrong};
use crate::parameters::render_config;
use crate::scene::{Scene, SceneInput, SceneSpecies};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use weald_contract::table::Tagged;
use weald_contract::{Frame, InputKind, Problem, Problems};
use weald_terrain::BYTES_PER_CELL;

/// Memory of a plant through ecosim and quantize: its row, its feature, its instance.
const BYTES_A_PLANT: u64 = 200;
/// Memory of a plant in the renderer: a node of the tree and a placement.
const BYTES_AN_INSTANCE: u64 = 128;
/// Memory of a pixel: sums of all channels in double precision, then the picture.
const BYTES_A_PIXEL: u64 = 240;
/// Memory of a plant model in the renderer: some 20,000 triangles with their tree.
const BYTES_A_MODEL: u64 = 4 << 20;

/// Seconds a terrain cell takes on one core, with water and derived layers.
const SECONDS_A_CELL: f64 = 2e-6;
/// Seconds a plant takes on one core to be placed, quantized, written and read.
const SECONDS_A_PLANT: f64 = 4e-6;
/// Seconds a model takes on one core.
const SECONDS_A_MODEL: f64 = 0.1;
/// Seconds a light path takes on one core in a wood: six bounces, each with a shadow ray.
const SECONDS_A_SAMPLE: f64 = 1.5e-5;

/// What a run will take.
#[derive(Clone, Debug, Serialize)]
pub struct Estimate {
    /// Terrain cells, finer patches included.
    pub cells: u64,
    /// Most plants that the steps can place; simulations count their first plants only.
    pub plants_at_most: u64,
    /// Plant models to grow.
    pub models_at_most: u64,
    /// Light paths to trace.
    pub samples: u64,
    /// Memory at the fullest moment, were all those plants to stand, bytes.
    pub memory_bytes: u64,
    /// Time on `threads` cores, s.
    pub seconds: f64,
    /// Cores counted on.
    pub threads: usize,
}

/// Estimates a run of a scene that was read without a problem.
///
/// # Errors
/// The elevation model cannot be read, or the run would need more memory than there is.
pub fn estimate(scene: &Scene, is_draft: bool) -> Result<Estimate> {
    let (cells, area) = cells(scene)?;
    let plants = plants_at_most(scene, area);
    refuse_unreadable(scene)?;
    let models = models_at_most(scene, plants);
    let config = render_config(scene, is_draft);
    let pixels = u64::from(config.resolution[0]) * u64::from(config.resolution[1]);
    let samples = pixels * u64::from(config.samples);
    let ground = cells * BYTES_PER_CELL + pixels * BYTES_A_PIXEL;
    let growing = cells * BYTES_PER_CELL / 2 + plants * BYTES_A_PLANT;
    let standing = plants * (BYTES_AN_INSTANCE + BYTES_A_PLANT / 2) + models * BYTES_A_MODEL;
    let threads = rayon::current_num_threads();
    let work = cells as f64 * SECONDS_A_CELL
        + plants as f64 * SECONDS_A_PLANT
        + models as f64 * SECONDS_A_MODEL
        + samples as f64 * SECONDS_A_SAMPLE;
    let estimate = Estimate {
        cells,
        plants_at_most: plants,
        models_at_most: models,
        samples,
        memory_bytes: growing.max(ground + standing),
        seconds: work / threads as f64,
        threads,
    };
    refuse_too_large(scene, ground, &estimate)?;
    Ok(estimate)
}

/// Every image and model that the scene names is opened once, so that a damaged one is told before
/// the work of the stages that come before it.
fn refuse_unreadable(scene: &Scene) -> Result<()> {
    let inputs = [&scene.terrain_inputs, &scene.ecosim_inputs, &scene.object_inputs];
    let mut problems = Problems::new();
    for SceneInput { input, path } in inputs.into_iter().flatten() {
        let read = match input.kind {
            InputKind::Image => weald_formats::read_image(path).map(drop),
            InputKind::Light => weald_formats::read_picture(path).map(drop),
            InputKind::Model => weald_formats::read_model(path).map(drop),
            // Elevation is read for its size, tables for their species.
            _ => Ok(()),
        };
        if let Err(error) = read {
            let message = format!("`{}`: {error}", input.field);
            problems.push(Problem::at(input.path.span, message));
        }
    }
    none_wrong(&scene.sources, problems)
}

/// Terrain cells, patches included, and the terrain's area in m².
fn cells(scene: &Scene) -> Result<(u64, f64)> {
    let Some(source) = scene.terrain_inputs.first() else { return Ok((0, 0.0)) };
    let frame = scene
        .read_elevation(&source.path)
        .map_err(|error| {
            Error::wrong(&scene.sources, Problem::at(source.input.path.span, error.to_string()))
        })?
        .grid
        .frame;
    let area = area(scene, &frame);
    let cell = scene.terrain.cell.as_ref().map_or(frame.cell, |cell| cell.value);
    let whole = area / (cell * cell);
    let patches: f64 =
        scene.terrain.detail.iter().map(|d| (2.0 * d.radius / d.cell.value).powi(2)).sum();
    Ok(((whole + patches).min(u64::MAX as f64) as u64, area))
}

/// Area of the part of the elevation model that is kept, m².
fn area(scene: &Scene, frame: &Frame) -> f64 {
    let [width, height] = [frame.width, frame.height].map(|cells| cells as f64 * frame.cell);
    let crop = scene.terrain.crop.as_ref().map_or([0.0, 0.0, width, height], |crop| crop.value);
    let within = |low: f64, high: f64, all: f64| high.min(all) - low.max(0.0);
    within(crop[0], crop[2], width).max(0.0) * within(crop[1], crop[3], height).max(0.0)
}

/// A terrain that the machine cannot hold is an error before work, when it is made alone as well.
pub(crate) fn refuse_too_large_terrain(scene: &Scene, elevation: &Frame) -> Result<()> {
    let cell = scene.terrain.cell.as_ref().map_or(elevation.cell, |cell| cell.value);
    let cells = area(scene, elevation) / (cell * cell);
    let needed = cells * BYTES_PER_CELL as f64;
    match memory_of_machine() {
        Some(available) if needed > available as f64 => Err(Error::plain(
            format!(
                "a terrain of {cells:.0} cells needs about {}, and this process may use {}",
                bytes_in_words(needed as u64),
                bytes_in_words(available)
            ),
            "in `[terrain]`, enlarge `cell`, or keep a part by `crop`",
        )),
        _ => Ok(()),
    }
}

/// Upper bound of the plants that the steps place on an area, m².
fn plants_at_most(scene: &Scene, area: f64) -> u64 {
    let steps = scene.ecosim.step.iter().filter(|step| step.common.enabled);
    let sum: f64 = steps.map(|Tagged { variant, .. }| step_plants(scene, variant, area)).sum();
    sum.min(scene.ecosim.max_plants as f64) as u64
}

fn step_plants(scene: &Scene, step: &weald_ecosim::Step, area: f64) -> f64 {
    match step {
        weald_ecosim::Step::Halftone(halftone) => {
            let group = scene.species.get(&halftone.species.value);
            let side = group.and_then(|found| Some(f64::from(found.species.group.as_ref()?.side)));
            match (halftone.arrange, side) {
                (weald_ecosim::Arrange::Grid, Some(side)) => area / (side * side),
                _ => f64::from(halftone.per_m2.unwrap_or(1.0)) * area,
            }
        }
        weald_ecosim::Step::Simulate(simulate) => {
            let species = simulate.species.iter().filter_map(|name| scene.species.get(&name.value));
            let years = f64::from(simulate.years.value);
            species.map(|found| f64::from(simulate.initial) + arrivals(found, years, area)).sum()
        }
        weald_ecosim::Step::Place(place) => {
            let table = place.plants.as_ref().and_then(|path| table_at(scene, &path.value));
            let rows = table.and_then(|path| weald_formats::read_population(path).ok());
            (place.at.len() + rows.map_or(0, |table| table.len())) as f64
        }
        weald_ecosim::Step::SelfThinning(thinning) => f64::from(thinning.plants),
        _ => 0.0,
    }
}

/// Seedlings of a species that may stand at one time in a simulation: those of all its years whose
/// seeds fly in from afar, and, of those borne under crowns that cover the ground once, those that
/// shade lets live.
fn arrivals(found: &SceneSpecies, years: f64, area: f64) -> f64 {
    let ecology = found.ecology.clone().unwrap_or_default();
    let years = years.min(f64::from(found.species.size.lifespan).max(1.0));
    let survival = f64::from(ecology.survival);
    let shaded =
        if survival < 1.0 { (1.0 - survival.powf(years)) / (1.0 - survival) } else { years };
    let [afar, borne] = [ecology.seedlings, ecology.seeds].map(f64::from);
    area * (afar / 1e4 * years + borne * shaded)
}

/// The file of a table that a step names.
fn table_at<'a>(scene: &'a Scene, written: &str) -> Option<&'a Path> {
    let named = |input: &&SceneInput| input.input.path.value == written;
    scene.ecosim_inputs.iter().find(named).map(|input| input.path.as_path())
}

/// Models that the palette may hold.
fn models_at_most(scene: &Scene, plants: u64) -> u64 {
    if scene.quantize.mode == weald_quantize::Mode::Exact {
        return plants;
    }
    let with_form = scene.species.values().filter(|found| found.form.is_some()).count() as u64;
    let by_number = with_form * u64::from(scene.quantize.representatives);
    scene.quantize.budget.map_or(by_number, |budget| u64::from(budget).max(with_form))
}

/// An absurd size is an error before work, not a crash in the middle of it.
///
/// Only what is certain counts: ground and picture. The plants' share is an upper bound, which a
/// formula may thin to almost nothing; ecosim has its own limit, `max_plants`.
fn refuse_too_large(scene: &Scene, certain: u64, estimate: &Estimate) -> Result<()> {
    let Some(available) = memory_of_machine() else { return Ok(()) };
    if certain <= available {
        return Ok(());
    }
    let [width, height] = scene.render.resolution;
    Err(Error::plain(
        format!(
            "ground and picture would need about {}, and this process may use {}",
            bytes_in_words(certain),
            bytes_in_words(available)
        ),
        format!(
            "`[terrain]` asks for {} cells and `[render]` for {width} x {height} pixels: \
             make the larger one smaller",
            estimate.cells
        ),
    ))
}

/// Memory that this process may use, bytes, where the system tells it: the machine's, or less when
/// its group or its address space is limited.
fn memory_of_machine() -> Option<u64> {
    let number = |file: &str, start: &str, place: usize| -> Option<u64> {
        let text = std::fs::read_to_string(file).ok()?;
        let line = text.lines().find(|line| line.starts_with(start))?;
        line.split_whitespace().nth(place)?.parse().ok()
    };
    let machine = number("/proc/meminfo", "MemTotal:", 1).map(|kilobytes| kilobytes * 1024);
    let group = number("/sys/fs/cgroup/memory.max", "", 0);
    let space = number("/proc/self/limits", "Max address space", 3);
    [machine, group, space].into_iter().flatten().min()
}

/// Bytes as people say them.
pub fn bytes_in_words(bytes: u64) -> String {
    let bytes = bytes as f64;
    match bytes {
        b if b < 1e6 => format!("{:.0} kB", b / 1e3),
        b if b < 1e9 => format!("{:.0} MB", b / 1e6),
        b => format!("{:.1} GB", b / 1e9),
    }
}

/// Seconds as people say them.
pub fn seconds_in_words(seconds: f64) -> String {
    match seconds {
        s if s < 10.0 => format!("{s:.1} s"),
        s if s < 120.0 => format!("{s:.0} s"),
        s if s < 7200.0 => format!("{:.0} min", s / 60.0),
        s => format!("{:.0} h", s / 3600.0),
    }
}

impl fmt::Display for Estimate {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "terrain cells     {}", self.cells)?;
        writeln!(f, "plants at most    {}", self.plants_at_most)?;
        writeln!(f, "models at most    {}", self.models_at_most)?;
        writeln!(f, "light paths       {}", self.samples)?;
        writeln!(f, "memory at most    {}", bytes_in_words(self.memory_bytes))?;
        writeln!(
            f,
            "time about        {} on {} threads",
            seconds_in_words(self.seconds),
            self.threads
        )
    }
}
