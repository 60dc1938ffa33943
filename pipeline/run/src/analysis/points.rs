//! A table of points as anyone writes it, and what is wrong with it by row and column.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};
use weald_analyze::thinning::StandDensity;
use weald_analyze::{Pattern, Window};
use weald_formats::{Column, Table};

/// Rows of a table, some of which may have been left out.
pub struct Points {
    path: PathBuf,
    /// The rows that are used.
    pub table: Table,
    /// Number of each of them in the file, from 1.
    rows: Vec<usize>,
}

/// Names of diameter columns that say their unit, and the factor to centimetres.
const DIAMETERS: [(&str, f64); 3] = [("dbh_cm", 1.0), ("dbh_mm", 0.1), ("dbh_m", 100.0)];

/// Columns of sizes, the first that there is counts.
const SIZES: [&str; 6] = ["radius", "height", "dbh", "dbh_cm", "dbh_mm", "dbh_m"];

/// Most types between which cross statistics are computed: tables grow with the square.
const MOST_TYPES: usize = 24;

impl Points {
    pub fn read(path: &Path) -> Result<Self> {
        let table = weald_formats::read_table(path)?;
        let rows = (1..=table.rows()).collect();
        Ok(Self { path: path.to_path_buf(), table, rows })
    }

    /// Leaves out the rows of other species.
    pub fn keep_species(&mut self, species: &str) -> Result<()> {
        let path = self.path.display();
        let Some(names) = self.table.column("species").and_then(Column::texts) else {
            let message = format!("{path} has no column `species` of texts");
            return Err(Error::plain(message, "leave `--species` out to use all rows"));
        };
        let keep: Vec<bool> = names.iter().map(|name| &**name == species).collect();
        if !keep.contains(&true) {
            let mut known: Vec<&str> = names.iter().map(|name| &**name).collect();
            known.sort_unstable();
            known.dedup();
            let message = format!("{path} has no plant of species `{species}`");
            return Err(Error::plain(message, format!("it has: {}", known.join(", "))));
        }
        let columns = std::mem::take(&mut self.table.columns).into_iter();
        self.table.columns = columns.map(|(name, column)| (name, kept(column, &keep))).collect();
        self.rows = pick(std::mem::take(&mut self.rows), &keep);
        Ok(())
    }

    /// The points, inside the sides asked for or their own extent.
    pub fn pattern(&self, sides: Option<[f64; 4]>) -> Result<Pattern> {
        let (x, y) = (self.numbers("x")?, self.numbers("y")?);
        let points: Vec<[f64; 2]> = x.into_iter().zip(y).map(|(x, y)| [x, y]).collect();
        let window = window(&points, sides);
        Pattern::new(points, window).map_err(|error| match error {
            weald_analyze::Error::Outside { row, x, y } => {
                let Window { x: [west, east], y: [south, north] } = window;
                let message =
                    format!("{x}, {y} lies outside the window {west},{south},{east},{north}");
                self.at(row, "x`, `y", message, "--window takes the whole area that was surveyed")
            }
            error => self.refused(None, error),
        })
    }

    /// The finite numbers of a column.
    pub fn numbers(&self, name: &str) -> Result<Vec<f64>> {
        let column = self.column(name)?;
        let Some(numbers) = column.numbers() else {
            let texts = column.texts().unwrap_or_default();
            let row = texts.iter().position(|text| text.parse::<f64>().is_err()).unwrap_or(0);
            let found = texts.get(row).map_or("", |text| text);
            let found: String = found.chars().take(40).collect();
            let message = format!("expected a number, found `{found}`");
            return Err(self.at(row, name, message, "one number a row is right"));
        };
        match numbers.iter().position(|number| !number.is_finite()) {
            Some(row) => {
                let value = numbers[row];
                let what = if value.is_nan() { "is missing".into() } else { format!("is {value}") };
                let hint = "give it, or take the row out";
                Err(self.at(row, name, format!("the value {what}"), hint))
            }
            None => Ok(numbers),
        }
    }

    /// The column `r`: distances that rise.
    pub fn radii(&self) -> Result<Vec<f64>> {
        let radii = self.numbers("r")?;
        let falls = radii.array_windows().position(|[before, after]| after <= before);
        let wrong = match radii.first() {
            Some(first) if *first < 0.0 => Some(0),
            _ => falls.map(|row| row + 1),
        };
        match wrong {
            None => Ok(radii),
            Some(row) => {
                let message = format!("the distance is {}", radii[row]);
                Err(self.at(row, "r", message, "distances from 0 on that rise are right"))
            }
        }
    }

    fn column(&self, name: &str) -> Result<&Column> {
        self.table.column(name).ok_or_else(|| {
            let known: Vec<&str> =
                self.table.columns.iter().map(|(name, _)| name.as_str()).collect();
            let message = format!("{} has no column `{name}`", self.path.display());
            Error::plain(message, format!("its columns are: {}", known.join(", ")))
        })
    }

    /// The types of a column in alphabetical order, with the points of each.
    pub fn types(&self, name: &str, pattern: &Pattern) -> Result<Vec<(String, Pattern)>> {
        let words: Vec<String> = match self.column(name)? {
            Column::Text(texts) => texts.iter().map(|text| text.to_string()).collect(),
            Column::Integer(values) => values.iter().map(i64::to_string).collect(),
            Column::Unsigned(values) => values.iter().map(u64::to_string).collect(),
            Column::Float(_) | Column::Float32(_) => {
                let message = format!("column `{name}` of {} holds fractions", self.path.display());
                return Err(Error::plain(
                    message,
                    "types are words or whole numbers; is it `--marks`?",
                ));
            }
        };
        if let Some(row) = words.iter().position(String::is_empty) {
            return Err(self.at(
                row,
                name,
                "the type is missing".into(),
                "give it, or take the row out",
            ));
        }
        let mut known = words.clone();
        known.sort_unstable();
        known.dedup();
        if !(2..=MOST_TYPES).contains(&known.len()) {
            let message = format!("column `{name}` holds {} types", known.len());
            return Err(Error::plain(
                message,
                format!("2 to {MOST_TYPES} types have cross statistics"),
            ));
        }
        let of = |kind: String| {
            let places = pattern.points().iter().zip(&words);
            let points = places.filter(|(_, word)| **word == kind).map(|(point, _)| *point);
            let pattern = Pattern::new(points.collect(), *pattern.window());
            Ok((kind, pattern.map_err(|error| self.refused(None, error))?))
        };
        known.into_iter().map(of).collect()
    }

    /// Sizes for the size distribution, the crown radius or what stands for it, with the column's
    /// name; none where some plants have not been measured.
    pub fn sizes(&self) -> Option<(&'static str, Vec<f64>)> {
        SIZES
            .iter()
            .find_map(|name| Some((*name, self.table.column(name)?.numbers()?)))
            .filter(is_whole)
    }

    /// Reineke's density, if a column names diameters and their unit.
    pub fn stand_density(&self, area: f64) -> Result<Option<StandDensity>> {
        let in_cm = |(name, to_cm): &(&'static str, f64)| {
            let diameters = self.table.column(name)?.numbers()?;
            Some((*name, diameters.into_iter().map(|diameter| diameter * to_cm).collect()))
        };
        let Some((name, diameters)) = DIAMETERS.iter().find_map(in_cm).filter(is_whole) else {
            return Ok(None);
        };
        let density = StandDensity::of(&diameters, area);
        density.map(Some).map_err(|error| self.refused(Some(name), error))
    }

    /// What the user should know of columns that were not used.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = Vec::new();
        let numbers = |name: &str| self.table.column(name)?.numbers();
        let has_unit = DIAMETERS.iter().any(|(name, _)| numbers(name).is_some());
        if numbers("dbh").is_some() && !has_unit {
            let note = "column `dbh` does not say its unit: call it dbh_cm, dbh_mm or dbh_m to \
                        get basal area and Reineke's density index";
            notes.push(note.into());
        }
        for name in SIZES {
            let missing = |values: Vec<f64>| values.iter().position(|value| !value.is_finite());
            if let Some(row) = numbers(name).and_then(missing) {
                let row = self.rows.get(row).copied().unwrap_or(row + 1);
                notes.push(format!("column `{name}` has no value in row {row} and is left out"));
            }
        }
        notes
    }

    /// An error of the statistics, said of this file; `column` is where its values are from.
    pub fn refused(&self, column: Option<&str>, error: weald_analyze::Error) -> Error {
        use weald_analyze::Error::{BadValue, Cancelled};
        match (column, error) {
            (_, Cancelled) => Error::Stopped { saved: false },
            (Some(column), BadValue { row, value, right, .. }) => {
                self.at(row, column, format!("the value is {value}"), right)
            }
            (_, error) => Error::plain(
                format!("{}: {error}", self.path.display()),
                "`weald info` shows what the table holds",
            ),
        }
    }

    fn at(&self, row: usize, column: &str, message: String, hint: &str) -> Error {
        let row = self.rows.get(row).copied().unwrap_or(row + 1);
        let path = self.path.display();
        Error::plain(format!("{path}, row {row}, column `{column}`: {message}"), hint)
    }
}

/// Whether all plants have been measured.
fn is_whole((_, values): &(&'static str, Vec<f64>)) -> bool {
    values.iter().all(|value| value.is_finite())
}

fn pick<T>(values: Vec<T>, keep: &[bool]) -> Vec<T> {
    values.into_iter().zip(keep).filter(|(_, keep)| **keep).map(|(value, _)| value).collect()
}

/// The rows of a column that are kept.
fn kept(column: Column, keep: &[bool]) -> Column {
    match column {
        Column::Float(values) => Column::Float(pick(values, keep)),
        Column::Float32(values) => Column::Float32(pick(values, keep)),
        Column::Integer(values) => Column::Integer(pick(values, keep)),
        Column::Unsigned(values) => Column::Unsigned(pick(values, keep)),
        Column::Text(values) => Column::Text(pick(values, keep)),
    }
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
