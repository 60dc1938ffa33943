//! Point statistics of anyone's table: `weald analyze`.

use crate::error::{Error, Result};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use weald_analyze::thinning::{StandState, ThinningLine, thinning_line};
use weald_analyze::{Pattern, Report, Statistic, Window, statistics};
use weald_formats::{Column, Provenance, Table};

/// What to compute, of what.
#[derive(Clone, Debug)]
pub struct Request {
    /// A table with columns `x` and `y` in metres, or the summary of a simulation.
    pub table: PathBuf,
    /// Only rows whose `species` is this.
    pub species: Option<String>,
    /// West, south, east and north side, m; without it, the extent of the points.
    pub window: Option<[f64; 4]>,
    /// Largest distance, m; without it, a quarter of the window's shorter side.
    pub radius: Option<f64>,
    /// Number of distances.
    pub steps: usize,
    /// Folder for the tables.
    pub output: Option<PathBuf>,
}

/// What was found.
#[derive(Clone, Debug, Serialize)]
#[serde(untagged)]
pub enum Found {
    /// Of a table of points.
    Pattern {
        /// The pattern in a few numbers.
        report: Report,
        /// Tables that were written.
        files: Vec<PathBuf>,
    },
    /// Of a stand's history: a line for each species.
    Thinning {
        /// Species and its self-thinning line.
        lines: Vec<(String, Thinning)>,
    },
}

/// A self-thinning line.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Thinning {
    /// States of the stand used.
    pub states: usize,
    /// Slope of ln(mean size) over ln(density), least squares.
    pub slope: f64,
    /// The same by the standardized major axis.
    pub major_axis_slope: f64,
    /// Coefficient of determination.
    pub r_squared: f64,
}

/// Computes the statistics of a table.
///
/// # Errors
/// The table is damaged, has too few rows or not the columns, or the disk refuses.
pub fn analyze(request: &Request) -> Result<Found> {
    let path = &request.table;
    let mut table = weald_formats::read_table(path)?;
    if let Some(species) = &request.species {
        table = rows_of_species(path, table, species)?;
    }
    if table.column("alive").is_some() && table.column("mean_radius").is_some() {
        return thinning(path, &table);
    }
    let points = points(path, &table)?;
    let window = window(&points, request.window);
    let pattern = Pattern::new(points, window).map_err(|error| refused(path, error))?;
    let report =
        Report::of(&pattern, sizes(&table).as_deref()).map_err(|error| refused(path, error))?;
    let files = match &request.output {
        Some(folder) => write_functions(request, &pattern, folder)?,
        None => Vec::new(),
    };
    Ok(Found::Pattern { report, files })
}

fn refused(path: &Path, error: weald_analyze::Error) -> Error {
    Error::plain(format!("{}: {error}", path.display()), "`weald info` shows what the table holds")
}

/// The rows of one species.
fn rows_of_species(path: &Path, table: Table, species: &str) -> Result<Table> {
    let Some(names) = table.column("species").and_then(Column::texts).map(<[_]>::to_vec) else {
        let message = format!("{} has no column `species` of texts", path.display());
        return Err(Error::plain(message, "leave `--species` out to use all rows"));
    };
    let keep: Vec<bool> = names.iter().map(|name| &**name == species).collect();
    if !keep.contains(&true) {
        let mut known: Vec<&str> = names.iter().map(|name| &**name).collect();
        known.sort_unstable();
        known.dedup();
        let message = format!("{} has no plant of species `{species}`", path.display());
        return Err(Error::plain(message, format!("it has: {}", known.join(", "))));
    }
    let columns = table.columns.into_iter().map(|(name, column)| (name, kept(column, &keep)));
    Ok(Table { columns: columns.collect() })
}

/// The rows of a column that are kept.
fn kept(column: Column, keep: &[bool]) -> Column {
    fn pick<T>(values: Vec<T>, keep: &[bool]) -> Vec<T> {
        values.into_iter().zip(keep).filter(|(_, keep)| **keep).map(|(value, _)| value).collect()
    }
    match column {
        Column::Float(values) => Column::Float(pick(values, keep)),
        Column::Float32(values) => Column::Float32(pick(values, keep)),
        Column::Integer(values) => Column::Integer(pick(values, keep)),
        Column::Unsigned(values) => Column::Unsigned(pick(values, keep)),
        Column::Text(values) => Column::Text(pick(values, keep)),
    }
}

fn numbers(path: &Path, table: &Table, name: &str) -> Result<Vec<f64>> {
    table.column(name).and_then(Column::numbers).ok_or_else(|| {
        let known: Vec<&str> = table.columns.iter().map(|(name, _)| name.as_str()).collect();
        let message = format!("{} has no column `{name}` of numbers", path.display());
        Error::plain(
            message,
            format!("columns `x` and `y` in metres are needed; it has: {}", known.join(", ")),
        )
    })
}

fn points(path: &Path, table: &Table) -> Result<Vec<[f64; 2]>> {
    let (x, y) = (numbers(path, table, "x")?, numbers(path, table, "y")?);
    Ok(x.into_iter().zip(y).map(|(x, y)| [x, y]).collect())
}

/// Sizes for the size distribution: the crown radius, or what stands for it.
fn sizes(table: &Table) -> Option<Vec<f64>> {
    ["radius", "height", "dbh"].iter().find_map(|name| table.column(name)?.numbers())
}

/// The window asked for, or the extent of the points.
fn window(points: &[[f64; 2]], sides: Option<[f64; 4]>) -> Window {
    if let Some([west, south, east, north]) = sides {
        return Window { x: [west, east], y: [south, north] };
    }
    let range = |axis: usize| {
        points
            .iter()
            .map(|point| point[axis])
            .fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], v| [low.min(v), high.max(v)])
    };
    Window { x: range(0), y: range(1) }
}

/// Writes `K.csv`, `L.csv`, `G.csv` and `pcf.csv`.
fn write_functions(request: &Request, pattern: &Pattern, folder: &Path) -> Result<Vec<PathBuf>> {
    std::fs::create_dir_all(folder).map_err(|error| Error::system(folder, error))?;
    let side = pattern.window().width().min(pattern.window().height());
    let radius = request.radius.unwrap_or(side / 4.0);
    let last = request.steps.max(2) - 1;
    let radii: Vec<f64> = (0..=last).map(|step| radius * step as f64 / last as f64).collect();
    let wanted = [Statistic::K, Statistic::L, Statistic::G, Statistic::Pcf];
    let tables =
        statistics(pattern, &wanted, &radii).map_err(|error| refused(&request.table, error))?;
    let story = story(request)?;
    let mut files = Vec::new();
    for table in tables {
        let path = folder.join(format!("{}.csv", table.name));
        let columns = table.columns.into_iter();
        let columns = columns.map(|(name, values)| (name.to_string(), Column::Float(values)));
        weald_formats::write_table(&path, &Table { columns: columns.collect() }, &story)?;
        files.push(path);
    }
    Ok(files)
}

fn story(request: &Request) -> Result<Provenance> {
    let path = &request.table;
    Ok(Provenance {
        stage: "analyze".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        output_version: 1,
        parameters: serde_json::json!({
            "species": request.species, "window": request.window,
            "radius": request.radius, "steps": request.steps,
        }),
        seed: 0,
        inputs: vec![crate::make::parent(path)?],
    })
}

/// The self-thinning line of each species in a simulation's summary.
///
/// Mean size is the square of the mean crown radius, to which the space of a plant is
/// proportional; a density is alive plants, whose unit does not change a slope. States in which a
/// species still gains plants are no thinning and are left out.
fn thinning(path: &Path, table: &Table) -> Result<Found> {
    let names = table.column("species").and_then(Column::texts).unwrap_or(&[]);
    let (alive, radius) = (numbers(path, table, "alive")?, numbers(path, table, "mean_radius")?);
    let mut species: Vec<&str> = names.iter().map(|name| &**name).collect();
    species.sort_unstable();
    species.dedup();
    let mut lines = Vec::new();
    for name in species {
        let rows =
            (0..alive.len()).filter(|row| names.get(*row).is_some_and(|found| &**found == name));
        let history: Vec<StandState> = rows
            .map(|row| StandState { density: alive[row], mean_size: radius[row].powi(2) })
            .collect();
        let thins =
            |pair: &[StandState]| pair[1].density < pair[0].density && pair[1].density > 0.0;
        let states: Vec<StandState> =
            history.windows(2).filter(|pair| thins(pair)).map(|pair| pair[1]).collect();
        if let Ok(line) = thinning_line(&states, [0.0, f64::MAX]) {
            lines.push((name.to_string(), in_short(&line)));
        }
    }
    if lines.is_empty() {
        let message =
            format!("{}: no species loses plants over at least three years", path.display());
        return Err(Error::plain(message, "a self-thinning line needs a stand that thins"));
    }
    Ok(Found::Thinning { lines })
}

fn in_short(line: &ThinningLine) -> Thinning {
    Thinning {
        states: line.states,
        slope: line.least_squares.slope,
        major_axis_slope: line.major_axis.slope,
        r_squared: line.r_squared,
    }
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Found::Pattern { report, files } => {
                writeln!(f, "{report}")?;
                files.iter().try_for_each(|file| writeln!(f, "wrote {}", file.display()))
            }
            Found::Thinning { lines } => {
                writeln!(
                    f,
                    "{:<16} {:>7} {:>9} {:>11} {:>6}",
                    "species", "states", "slope", "major axis", "r2"
                )?;
                lines.iter().try_for_each(|(name, line)| {
                    let Thinning { states, slope, major_axis_slope, r_squared } = line;
                    writeln!(f, "{name:<16} {states:>7} {slope:>9.3} {major_axis_slope:>11.3} {r_squared:>6.3}")
                })
            }
        }
    }
}
