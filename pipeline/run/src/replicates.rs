//! Many simulations of one scene: `weald ecosim --replicates N --sweep FIELD=VALUES`.
//!
//! One simulation is one draw. Replicates with other seeds say how far draws differ, and a sweep
//! how the stand answers to a parameter. Every point of a sweep uses the same seeds, so that points
//! differ by their parameters and not by luck as well.

mod ends;
mod sweep;
mod tables;

pub use sweep::Sweep;

use crate::error::{Error, Result};
use crate::make::{self, Made, Opened};
use crate::recipe::Stage;
use crate::scene::{Changes, Scene};
use ends::End;
use rayon::prelude::*;
use serde_json::json;
use std::path::{Path, PathBuf};
use weald_contract::{Progress, Seed};
use weald_ecosim::{Course, SummaryRow};
use weald_formats::Provenance;

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Request {
    /// The scene's folder or file.
    pub scene: PathBuf,
    /// Changes to it.
    pub changes: Changes,
    /// The terrain's folder.
    pub terrain: PathBuf,
    /// A population to go on from, if any.
    pub start: Option<PathBuf>,
    /// Simulations at each point of the sweep.
    pub replicates: u32,
    /// Fields that vary; every value of one meets every value of the others.
    pub sweeps: Vec<Sweep>,
    /// Whether the plants of each are written too.
    pub keep_plants: bool,
    /// Where tables and figures go.
    pub folder: PathBuf,
}

/// One combination of values.
struct Point {
    /// A value of each field that varies, as written.
    values: Vec<String>,
    scene: Scene,
    opened: Opened,
}

/// What is kept of one simulation.
struct Run {
    seed: u64,
    ends: Vec<End>,
    /// The history, with the species' names.
    years: Vec<SummaryRow>,
    names: Vec<String>,
}

/// Most points that a sweep may have; a guard against a slip in a range.
const MOST_POINTS: usize = 10_000;

/// Simulates a scene many times and writes `replicates.csv`, `statistics.csv`, `years.csv` and a
/// figure.
///
/// # Errors
/// The scene or a value is wrong, told before any work; a simulation refuses; the disk does.
pub fn replicates(request: &Request, progress: &dyn Progress) -> Result<Made> {
    let points = points(request)?;
    let count = request.replicates as usize;
    std::fs::create_dir_all(&request.folder)
        .map_err(|error| Error::system(&request.folder, error))?;
    let story = story(request, &points)?;
    progress.begin("replicates", (points.len() * count) as u64, "runs");
    // In the order of the table; each result depends on its point and seed alone.
    let runs = (0..points.len() * count)
        .into_par_iter()
        .map(|task| {
            let run = one(request, &points, task, &story, progress);
            progress.advance(1);
            run
        })
        .collect::<Result<Vec<Run>>>()?;
    let by_point: Vec<&[Run]> = runs.chunks(count).collect();
    tables::write(request, &points, &by_point, &story)
}

/// Loads the scene of each point, so that every mistake is told before the work.
fn points(request: &Request) -> Result<Vec<Point>> {
    let mut points: Vec<Point> = Vec::new();
    for values in sweep::combinations(&request.sweeps, MOST_POINTS)? {
        let mut changes = request.changes.clone();
        let fields = request.sweeps.iter().zip(&values);
        changes.set.extend(fields.map(|(sweep, value)| format!("{}={value}", sweep.field)));
        let scene = Scene::load(&request.scene, &changes)?;
        let opened = match points.first() {
            None => Opened::new(&scene, &request.terrain, request.start.as_deref())?,
            Some(first) => first.opened.like(&first.scene, &scene)?,
        };
        points.push(Point { values, scene, opened });
    }
    Ok(points)
}

/// Hears only of a wish to stop: parts of many simulations at once tell nobody anything.
struct Hushed<'a>(&'a dyn Progress);

impl Progress for Hushed<'_> {
    fn begin(&self, _: &str, _: u64, _: &str) {}

    fn advance(&self, _: u64) {}

    fn is_cancelled(&self) -> bool {
        self.0.is_cancelled()
    }
}

/// Simulates and measures one replicate of one point.
fn one(
    request: &Request,
    points: &[Point],
    task: usize,
    story: &Provenance,
    progress: &dyn Progress,
) -> Result<Run> {
    let count = request.replicates as usize;
    let (number, replicate) = (task / count, task % count);
    let point = &points[number];
    let seed = point.scene.tables.seed.wrapping_add(replicate as u64);
    let root = Seed(seed).part(Stage::Ecosim.word(), 0);
    let grown = point.opened.grow(&point.scene, root, &Hushed(progress), Course::default());
    let outcome = grown.map_err(make::refusal(&point.scene))?;
    if request.keep_plants {
        let path = request.folder.join(plants_name(points.len(), number, replicate));
        let story = Provenance { seed, ..story.clone() };
        weald_formats::write_population(&path, &outcome.population, &story)?;
    }
    let ends = ends::measure(&outcome, point.opened.frame());
    Ok(Run { seed, ends, years: outcome.summary, names: outcome.population.species })
}

/// Name of the table of one replicate's plants.
fn plants_name(points: usize, point: usize, replicate: usize) -> String {
    match points {
        1 => format!("plants-{replicate:04}.parquet"),
        _ => format!("plants-{point:04}-{replicate:04}.parquet"),
    }
}

/// The story of the tables: the scene's, with what varies.
fn story(request: &Request, points: &[Point]) -> Result<Provenance> {
    let Some(first) = points.first() else {
        return Err(Error::plain("this sweep has no value", "give one at least"));
    };
    let hashed = crate::parameters::hashed_inputs(&first.scene, Stage::Ecosim)?;
    let parents = make::parents_of_inputs(&hashed);
    let mut story = make::provenance(&first.scene, Stage::Ecosim, false, parents);
    story.parameters["replicates"] = json!(request.replicates);
    for sweep in &request.sweeps {
        story.parameters["sweep"][&sweep.field] = json!(sweep.values);
    }
    story.inputs.push(make::parent(&request.terrain)?);
    if let Some(start) = &request.start {
        story.inputs.push(make::parent(start)?);
    }
    Ok(story)
}

/// Files of plants, in the order of points and replicates.
fn plants_files(folder: &Path, points: usize, count: usize) -> Vec<PathBuf> {
    let tasks = (0..points).flat_map(|point| (0..count).map(move |run| (point, run)));
    tasks.map(|(point, run)| folder.join(plants_name(points, point, run))).collect()
}
