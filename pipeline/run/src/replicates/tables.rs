//! Tables and a figure of many simulations.

use super::ends::MEASURES;
use super::{Point, Request, Run, plants_files};
use crate::analysis::plot;
use crate::error::Result;
use crate::make::Made;
use crate::preview;
use serde_json::json;
use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use weald_analyze::figure::{Band, Figure, Series, Style};
use weald_analyze::quantile;
use weald_ecosim::SummaryRow;
use weald_formats::{Column, Provenance, Table};

/// Parts of the replicates that lie below the quantiles of the tables.
const QUANTILES: [(&str, f64); 7] = [
    ("least", 0.0),
    ("q05", 0.05),
    ("q25", 0.25),
    ("median", 0.5),
    ("q75", 0.75),
    ("q95", 0.95),
    ("greatest", 1.0),
];

/// A number of the history by its name in `summary.csv`.
type YearMeasure = (&'static str, fn(&SummaryRow) -> f64);

const YEAR_MEASURES: [YearMeasure; 9] = [
    ("alive", |row| row.alive as f64),
    ("births", |row| row.births as f64),
    ("dominated", |row| row.dominated as f64),
    ("old", |row| row.old as f64),
    ("disturbed", |row| row.disturbed as f64),
    ("mean_radius", |row| f64::from(row.mean_radius)),
    ("cover", |row| f64::from(row.cover)),
    ("gini", |row| f64::from(row.sizes.gini)),
    ("seeds", |row| row.seeds as f64),
];

/// How replicates of one number lie.
struct Spread {
    count: usize,
    mean: f64,
    /// Standard deviation of the replicates, over n - 1; NaN of one.
    deviation: f64,
    quantiles: [f64; QUANTILES.len()],
}

impl Spread {
    /// Describes the values that are numbers.
    fn of(values: impl Iterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.filter(|value| value.is_finite()).collect();
        let n = values.len() as f64;
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let at = |part| {
            if values.is_empty() { f64::NAN } else { quantile(&values, part).unwrap_or(f64::NAN) }
        };
        Self {
            count: values.len(),
            mean,
            deviation: (squares / (n - 1.0)).sqrt(),
            quantiles: QUANTILES.map(|(_, part)| at(part)),
        }
    }
}

/// Rows that say which point they belong to, and of what they are.
#[derive(Default)]
struct Rows {
    points: Vec<usize>,
    species: Vec<String>,
    measures: Vec<&'static str>,
    steps: Vec<u64>,
    spreads: Vec<Spread>,
}

impl Rows {
    fn push(
        &mut self,
        point: usize,
        species: &str,
        step: u32,
        measure: &'static str,
        spread: Spread,
    ) {
        self.points.push(point);
        self.species.push(species.into());
        self.steps.push(step.into());
        self.measures.push(measure);
        self.spreads.push(spread);
    }

    /// Returns the spread of a measure of a species at the end of a point.
    fn find(&self, point: usize, species: &str, measure: &str) -> Option<&Spread> {
        let is_it = |&row: &usize| {
            self.points[row] == point
                && self.species[row] == species
                && self.measures[row] == measure
        };
        (0..self.points.len()).find(is_it).map(|row| &self.spreads[row])
    }

    fn table(&self, request: &Request, points: &[Point], has_steps: bool) -> Table {
        let mut table = named_points(request, points, &self.points);
        if has_steps {
            table = table.with("step", Column::Unsigned(self.steps.clone()));
        }
        let numbers =
            |of: &dyn Fn(&Spread) -> f64| Column::Float(self.spreads.iter().map(of).collect());
        let mut table = table
            .with("species", Column::text(&self.species))
            .with("measure", Column::text(&self.measures))
            .with(
                "replicates",
                Column::Unsigned(self.spreads.iter().map(|s| s.count as u64).collect()),
            )
            .with("mean", numbers(&|spread| spread.mean))
            .with("sd", numbers(&|spread| spread.deviation))
            .with("se", numbers(&|spread| spread.deviation / (spread.count as f64).sqrt()));
        for (index, (name, _)) in QUANTILES.iter().enumerate() {
            table = table.with(name, numbers(&|spread| spread.quantiles[index]));
        }
        table
    }
}

/// Columns for the number of each row's point and for the values of the fields that vary.
fn named_points(request: &Request, points: &[Point], rows: &[usize]) -> Table {
    let numbers = Column::Unsigned(rows.iter().map(|point| *point as u64).collect());
    let mut table = Table::default().with("point", numbers);
    for (index, sweep) in request.sweeps.iter().enumerate() {
        let written = || rows.iter().map(|point| points[*point].values[index].as_str());
        let parsed: Option<Vec<f64>> = written().map(|value| value.parse().ok()).collect();
        let column = parsed.map_or_else(|| Column::text(written()), Column::Float);
        table = table.with(&sweep.field, column);
    }
    table
}

/// Writes the tables and the figure, and says the most important in words.
pub(super) fn write(
    request: &Request,
    points: &[Point],
    runs: &[&[Run]],
    story: &Provenance,
) -> Result<Made> {
    let (ends, years) = (ends(runs), years(runs));
    let mut made = Made {
        report: json!({ "points": points.len(), "replicates": request.replicates }),
        words: in_words(request, points, &ends),
        ..Made::default()
    };
    for (name, table) in [
        ("replicates.csv", each(request, points, runs)),
        ("statistics.csv", ends.table(request, points, false)),
        ("years.csv", years.table(request, points, true)),
    ] {
        let path = request.folder.join(name);
        weald_formats::write_table(&path, &table, story)?;
        let companion = path.with_extension("csv.json");
        made.files.extend([path, companion]);
    }
    let figure = figure(request, points, &ends, &years);
    let path = request.folder.join("cover.svg");
    weald_formats::write_atomically(&path, |file| Ok(file.write_all(figure.svg().as_bytes())?))?;
    made.files.push(path);
    let (path, sketch) = (request.folder.join("cover.png"), plot::draw(&figure));
    weald_formats::write_png(&path, sketch.width, sketch.height, &sketch.rgb, story)?;
    made.files.push(path);
    if request.keep_plants {
        let count = request.replicates as usize;
        made.files.extend(plants_files(&request.folder, points.len(), count));
    }
    Ok(made)
}

/// A row a point, replicate and species.
fn each(request: &Request, points: &[Point], runs: &[&[Run]]) -> Table {
    let all = || {
        runs.iter().enumerate().flat_map(|(point, runs)| {
            runs.iter().enumerate().flat_map(move |(replicate, run)| {
                run.ends.iter().map(move |end| (point, replicate, run, end))
            })
        })
    };
    let rows: Vec<usize> = all().map(|(point, ..)| point).collect();
    let mut table = named_points(request, points, &rows)
        .with("replicate", Column::Unsigned(all().map(|(_, k, ..)| k as u64).collect()))
        .with("seed", Column::Unsigned(all().map(|(_, _, run, _)| run.seed).collect()))
        .with("species", Column::text(all().map(|(.., end)| &end.species)));
    for (index, name) in MEASURES.iter().enumerate() {
        let values = all().map(|(.., end)| end.values[index]).collect();
        table = table.with(name, Column::Float(values));
    }
    table
}

/// How the ends of each point lie. A species that a replicate lacks counts there as none.
fn ends(runs: &[&[Run]]) -> Rows {
    let mut rows = Rows::default();
    for (point, runs) in runs.iter().enumerate() {
        let mut found: BTreeMap<&str, Vec<&[f64; MEASURES.len()]>> = BTreeMap::new();
        for end in runs.iter().flat_map(|run| &run.ends) {
            found.entry(&end.species).or_default().push(&end.values);
        }
        for (species, values) in found {
            for (index, measure) in MEASURES.iter().enumerate() {
                let spread = Spread::of(values.iter().map(|values| values[index]));
                rows.push(point, species, 0, measure, spread);
            }
        }
    }
    rows
}

/// How the years of each point lie; where a step begins with a year that ended another, its last
/// row counts.
fn years(runs: &[&[Run]]) -> Rows {
    let mut rows = Rows::default();
    for (point, runs) in runs.iter().enumerate() {
        let mut found: BTreeMap<(&str, u32), Vec<&SummaryRow>> = BTreeMap::new();
        for run in *runs {
            let mut last: BTreeMap<(&str, u32), &SummaryRow> = BTreeMap::new();
            for row in &run.years {
                last.insert((&run.names[usize::from(row.species)], row.step), row);
            }
            for (key, row) in last {
                found.entry(key).or_default().push(row);
            }
        }
        for ((species, step), own) in found {
            for (measure, value) in YEAR_MEASURES {
                let spread = Spread::of(own.iter().map(|row| value(row)));
                rows.push(point, species, step, measure, spread);
            }
        }
    }
    rows
}

/// Plants and cover of each point, mean and standard deviation.
fn in_words(request: &Request, points: &[Point], ends: &Rows) -> String {
    let mut words = String::new();
    for (number, point) in points.iter().enumerate() {
        if !request.sweeps.is_empty() {
            let fields = request.sweeps.iter().zip(&point.values);
            let fields: Vec<String> =
                fields.map(|(sweep, value)| format!("{} = {value}", sweep.field)).collect();
            let _ = writeln!(words, "{}", fields.join(", "));
        }
        let mut names: Vec<&String> = ends.species.iter().collect();
        names.sort();
        names.dedup();
        for species in names {
            let [plants, cover] = ["plants", "cover"].map(|name| ends.find(number, species, name));
            let (Some(plants), Some(cover)) = (plants, cover) else { continue };
            let or_none = |deviation: f64| if deviation.is_nan() { 0.0 } else { deviation };
            let _ = writeln!(
                words,
                "  {species:<20} plants {:>10.1} ± {:<8.1} cover {:.4} ± {:.4}",
                plants.mean,
                or_none(plants.deviation),
                cover.mean,
                or_none(cover.deviation)
            );
        }
    }
    words
}

/// Cover of each species: over the one field that varies, when it is a number, or else over the
/// years of the first point. A line through the medians, a band from the 5 % to the 95 % quantile.
fn figure(request: &Request, points: &[Point], ends: &Rows, years: &Rows) -> Figure {
    let parsed: Option<Vec<f64>> = match request.sweeps.as_slice() {
        [_] if points.len() > 1 => points.iter().map(|p| p.values[0].parse().ok()).collect(),
        _ => None,
    };
    let rows = if parsed.is_some() { ends } else { years };
    let mut curves: BTreeMap<&str, Vec<[f64; 4]>> = BTreeMap::new();
    for row in (0..rows.points.len()).filter(|&row| rows.measures[row] == "cover") {
        let x = match &parsed {
            Some(values) => values[rows.points[row]],
            None if rows.points[row] == 0 => rows.steps[row] as f64,
            None => continue,
        };
        let [_, low, _, median, _, high, _] = rows.spreads[row].quantiles;
        curves.entry(&rows.species[row]).or_default().push([x, low, median, high]);
    }
    let colors = colors(points, curves.keys().copied());
    let is_sound = |p: &&[f64; 4]| p.iter().all(|value| value.is_finite());
    let band = |(species, curve): (&&str, &Vec<[f64; 4]>)| Band {
        label: String::new(),
        rows: curve.iter().filter(is_sound).map(|[x, low, _, high]| [*x, *low, *high]).collect(),
        color: colors[*species].map(|channel| 255 - (255 - channel) / 3),
    };
    let line = |(species, curve): (&&str, &Vec<[f64; 4]>)| Series {
        label: species.replace('_', " "),
        points: curve.iter().map(|[x, _, median, _]| [*x, *median]).collect(),
        color: colors[*species],
        style: Style::Line,
    };
    let x_label = if parsed.is_some() { request.sweeps[0].field.clone() } else { "step".into() };
    Figure {
        title: format!("{} replicates: median, 5 to 95 %", request.replicates),
        x_label,
        y_label: "cover by crowns".into(),
        bands: curves.iter().map(band).collect(),
        series: curves.iter().map(line).collect(),
    }
}

/// Colours of species as their files say.
fn colors<'a>(
    points: &[Point],
    names: impl Iterator<Item = &'a str>,
) -> BTreeMap<&'a str, [u8; 3]> {
    let names: Vec<&str> = names.collect();
    let owned: Vec<String> = names.iter().map(|name| name.to_string()).collect();
    let known = points.iter().flat_map(|point| &point.scene.species);
    let known = known.map(|(name, found)| (name.clone(), found.species.color)).collect();
    names.into_iter().zip(preview::colors_by_name(&owned, &known)).collect()
}
