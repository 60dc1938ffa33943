//! The self-thinning line of a stand's history.

use super::{Found, Output, Request};
use crate::error::{Error, Result};
use serde::Serialize;
use std::fmt;
use std::path::Path;
use weald_analyze::plateau::by_density;
use weald_analyze::thinning::{StandState, ThinningLine, thinning_line};
use weald_analyze::{EarlyStart, Figure, Plateau, plateau};
use weald_formats::{Column, Table};

/// A self-thinning line.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct Thinning {
    /// States of the stand used.
    pub states: usize,
    /// Slope of log mean size over log density, least squares.
    pub slope: f64,
    /// The same by the standardized major axis.
    pub major_axis_slope: f64,
    /// The same of the line below which 95 % of the states lie.
    pub upper_slope: f64,
    /// Least squares over means in classes of density, so that late years do not outvote others.
    pub even_slope: Option<f64>,
    /// Coefficient of determination.
    pub r_squared: f64,
    /// Lowest and highest density that were used.
    pub densities: [f64; 2],
    /// Where cover was level, if it was.
    pub plateau: Option<Plateau>,
    /// Set if the line begins while cover still rises.
    pub early_start: Option<EarlyStart>,
}

/// A history: a row a time.
struct History {
    densities: Vec<f64>,
    sizes: Vec<f64>,
    covers: Vec<f64>,
}

/// Columns of mean size in a history; with a mass, the column `cover` is needed too.
const SIZES: [&str; 2] = ["mean_area", "mean_mass"];

/// Whether a table is a stand's history: the summary of a simulation or anyone's.
pub fn is_history(table: &Table) -> bool {
    let has = |name: &str| table.column(name).is_some();
    let is_summary = has("alive") && (has("cover") || has("mean_radius"));
    is_summary || has("density") && SIZES.iter().any(|name| has(name)) && !has("x")
}

/// Fits a line for each species.
pub fn analyze(request: &Request, table: &Table) -> Result<Found> {
    let path = &request.table;
    let mut output = match &request.output {
        Some(folder) => Some(Output::new(folder, request)?),
        None => None,
    };
    let (mut lines, mut reasons) = (Vec::new(), Vec::new());
    for (name, history) in histories(path, table)? {
        let fit = match Fit::of(&history, request.densities) {
            Ok(fit) => fit,
            Err(error) => {
                reasons.push(if name.is_empty() {
                    error.to_string()
                } else {
                    format!("{name}: {error}")
                });
                continue;
            }
        };
        if let Some(output) = &mut output {
            write(output, &name, &history, &fit)?;
        }
        lines.push((name, fit.in_short()));
    }
    if lines.is_empty() {
        let message = format!("{}: no self-thinning line: {}", path.display(), reasons.join("; "));
        return Err(Error::plain(message, "a self-thinning line needs a stand that thins"));
    }
    Ok(Found::Thinning { lines, files: output.map(|output| output.files).unwrap_or_default() })
}

/// The histories of a table by species; of one without species, a nameless one.
fn histories(path: &Path, table: &Table) -> Result<Vec<(String, History)>> {
    let all = history(path, table)?;
    let Some(names) = table.column("species").and_then(Column::texts) else {
        return Ok(vec![(String::new(), all)]);
    };
    let mut species: Vec<&str> = names.iter().map(|name| &**name).collect();
    species.sort_unstable();
    species.dedup();
    let of = |name: &str| {
        let pick = |values: &[f64]| {
            let rows = names.iter().zip(values).filter(|(found, _)| &***found == name);
            rows.map(|(_, value)| *value).collect()
        };
        let history = History {
            densities: pick(&all.densities),
            sizes: pick(&all.sizes),
            covers: pick(&all.covers),
        };
        (name.to_string(), history)
    };
    Ok(species.into_iter().map(of).collect())
}

/// Densities, mean sizes and covers; factors common to all rows change no slope and no plateau.
fn history(path: &Path, table: &Table) -> Result<History> {
    let numbers = |name: &str| {
        table.column(name).and_then(Column::numbers).ok_or_else(|| {
            let known: Vec<&str> = table.columns.iter().map(|(name, _)| name.as_str()).collect();
            let message = format!("{} has no column `{name}` of numbers", path.display());
            Error::plain(message, format!("its columns are: {}", known.join(", ")))
        })
    };
    let has = |name: &str| table.column(name).is_some();
    if !has("alive") {
        let densities = numbers("density")?;
        let size = SIZES.iter().find(|name| has(name)).unwrap_or(&SIZES[0]);
        let sizes = numbers(size)?;
        let covers = match has("cover") || *size != "mean_area" {
            true => numbers("cover")?,
            false => densities.iter().zip(&sizes).map(|(density, area)| density * area).collect(),
        };
        return Ok(History { densities, sizes, covers });
    }
    let alive = numbers("alive")?;
    let covers = match has("cover") {
        true => numbers("cover")?,
        // The square of the mean radius stands for the mean area where nothing better is known.
        false => {
            let radii = numbers("mean_radius")?;
            alive.iter().zip(radii).map(|(alive, radius)| alive * radius * radius).collect()
        }
    };
    let sizes = covers.iter().zip(&alive).map(|(cover, alive)| cover / alive).collect();
    Ok(History { densities: alive, sizes, covers })
}

/// A line with the states that it was fitted to.
struct Fit {
    line: ThinningLine,
    even: Option<ThinningLine>,
    densities: [f64; 2],
    plateau: Option<Plateau>,
    early_start: Option<EarlyStart>,
    /// Rows that the line was fitted to.
    is_used: Vec<bool>,
}

impl Fit {
    /// Fits the states of the densities asked for, else those of the plateau, else all in which
    /// the stand thins.
    fn of(history: &History, asked: Option<[f64; 2]>) -> Result<Self, weald_analyze::Error> {
        let History { densities, covers, .. } = history;
        let level = plateau(densities, covers);
        let rows = match &level {
            Ok(level) if asked.is_none() => level.rows[0]..level.rows[1] + 1,
            _ => 0..densities.len(),
        };
        let [low, high] = asked.unwrap_or([0.0, f64::MAX]);
        // Years in which a stand gains plants are no thinning.
        let thins = |row: usize| row > 0 && densities[row] <= densities[row - 1];
        let is_in = |row: usize| {
            let density = densities[row];
            rows.contains(&row) && density > low && density < high
        };
        let is_used: Vec<bool> = (0..densities.len())
            .map(|row| is_in(row) && (asked.is_some() || thins(row)) && history.sizes[row] > 0.0)
            .collect();
        let states: Vec<StandState> = (0..densities.len())
            .filter(|row| is_used[*row])
            .map(|row| history.state(row))
            .collect();
        let line = thinning_line(&states, [0.0, f64::MAX])?;
        let even = thinning_line(&by_density(&states), [0.0, f64::MAX]).ok();
        let range = states.iter().map(|state| state.density);
        let densities_used =
            range.fold([f64::INFINITY, 0.0], |[low, high]: [f64; 2], d| [low.min(d), high.max(d)]);
        let level = level.ok();
        let early_start = level.as_ref().and_then(|level| {
            level.early_start(densities, covers, densities_used[1] * (1.0 + f64::EPSILON))
        });
        Ok(Self { line, even, densities: densities_used, plateau: level, early_start, is_used })
    }

    fn in_short(&self) -> Thinning {
        Thinning {
            states: self.line.states,
            slope: self.line.least_squares.slope,
            major_axis_slope: self.line.major_axis.slope,
            upper_slope: self.line.upper.slope,
            even_slope: self.even.map(|line| line.least_squares.slope),
            r_squared: self.line.r_squared,
            densities: self.densities,
            plateau: self.plateau,
            early_start: self.early_start,
        }
    }
}

impl History {
    fn state(&self, row: usize) -> StandState {
        StandState { density: self.densities[row], mean_size: self.sizes[row] }
    }
}

fn write(output: &mut Output<'_>, name: &str, history: &History, fit: &Fit) -> Result<()> {
    let letter = |c: char| if c.is_alphanumeric() || c == '_' { c } else { '_' };
    let word: String = name.chars().map(letter).collect();
    let stem = if word.is_empty() { "thinning".into() } else { format!("thinning.{word}") };
    let columns = vec![
        ("density", history.densities.clone()),
        ("mean_size", history.sizes.clone()),
        ("cover", history.covers.clone()),
        ("used", fit.is_used.iter().map(|used| f64::from(u8::from(*used))).collect()),
    ];
    output.table(&stem, &weald_analyze::Table { name: "thinning", columns })?;
    let states: Vec<StandState> =
        (0..history.densities.len()).map(|row| history.state(row)).collect();
    let title = if name.is_empty() { "self-thinning" } else { name };
    let figure = Figure::of_thinning(title, &states, &fit.line, fit.densities);
    output.figure(&stem, &figure)
}

pub fn write_lines(f: &mut fmt::Formatter<'_>, lines: &[(String, Thinning)]) -> fmt::Result {
    writeln!(
        f,
        "{:<16} {:>7} {:>9} {:>11} {:>7} {:>9} {:>6}  densities",
        "species", "states", "slope", "major axis", "95 %", "by class", "r2"
    )?;
    for (name, line) in lines {
        let Thinning { states, slope, major_axis_slope, upper_slope, r_squared, .. } = line;
        let even = line.even_slope.map_or("-".into(), |slope| format!("{slope:.3}"));
        let [low, high] = line.densities;
        writeln!(
            f,
            "{name:<16} {states:>7} {slope:>9.3} {major_axis_slope:>11.3} {upper_slope:>7.3} \
             {even:>9} {r_squared:>6.3}  {low:.4} to {high:.4}"
        )?;
        match (&line.plateau, &line.early_start) {
            (None, _) => writeln!(
                f,
                "note: cover does not level off; all states that thin were used, and the slope \
                 may be too steep"
            )?,
            (_, Some(early)) => writeln!(f, "note: {early}")?,
            _ => {}
        }
    }
    Ok(())
}
