//! How fast this machine is at each stage: `weald bench`.
//!
//! Every figure times one kernel on an input made here, without files, so that numbers of two
//! machines or two versions can be compared. Each is the best of three runs: what disturbs a
//! measurement only ever makes it slower.
//!
//! Comparisons with other programs measure one stage at a time, on data that both can read
//! ([`Request::input`]), and read off the result as well as the time ([`Figure::result`]).

mod clock;
mod ecosim;
mod given;
mod growing_trees;
mod plants;
mod quantize;
mod render;
mod semantic_trees;
mod terrain;

use crate::bench::clock::Stopwatch;
use crate::error::{Error, Result};
use crate::recipe::Stage;
use crate::scene::{SceneSpecies, load_species};
use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use std::hint::black_box;
use std::path::{Path, PathBuf};
use weald_contract::{FromToml, Value};

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
            Stage::Terrain => figures.extend(terrain::terrain(&size, input)?),
            Stage::Ecosim => {
                figures.push(ecosim::self_thinning(&size, input)?);
                if input.is_none() {
                    figures.push(ecosim::giants(&size)?);
                    figures.push(ecosim::plant_steps(&size, &species)?);
                    figures.push(ecosim::lloyd(&size)?);
                }
            }
            Stage::Quantize => figures.extend(quantize::vector_quantization(&size, input)?),
            Stage::Plants => {
                figures.push(plants::triangles(&size, &species)?);
                figures.extend(plants::black_oak(&size, &species)?);
                if !request.quick {
                    figures.push(plants::many_trees(&size, &species)?);
                }
                // Seconds each: only for who asks for this stage.
                if request.quick || request.only.is_some() {
                    figures.extend(growing_trees::figures(&size, request.quick)?);
                }
                figures.extend(semantic_trees::edits(&size)?);
            }
            Stage::Render => figures.extend(render::rays(&size, &species)?),
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
    best_of(size, || Ok(()), |()| work())
}

/// The same of work that uses up its input, whose making is not timed.
fn best_of<S, T>(
    size: &Size,
    mut prepare: impl FnMut() -> Result<S>,
    mut work: impl FnMut(S) -> Result<T>,
) -> Result<(Time, T)> {
    let mut fastest: Option<(Time, T)> = None;
    for _ in 0..size.repeat {
        let input = prepare()?;
        let watch = Stopwatch::start();
        let made = black_box(work(input)?);
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
    Ok(load_species(Path::new(""), ["aspen", "grass", "oak"].map(String::from))?.1)
}

/// Reads a stage's table from a text of ours.
fn table<T: FromToml>(text: &str) -> Result<T> {
    let tree = Value::parse(0, text).map_err(|problems| wrong(format!("{problems:?}")))?;
    let mut problems = Vec::new();
    T::from_toml(&tree, &mut problems).ok_or_else(|| wrong(format!("{problems:?}")))
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
