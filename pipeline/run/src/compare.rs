//! Do two files hold the same? `weald compare`: pictures, rasters, terrains, tables, plants.

use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use serde::Serialize;
use std::collections::BTreeSet;
use std::fmt;
use std::path::{Path, PathBuf};
use weald_formats::Column;

/// The outcome of a comparison.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Comparison {
    /// A line for each part compared: a channel, layer or column.
    pub parts: Vec<Part>,
    /// What cannot be compared at all: other sizes, parts that only one has.
    pub mismatches: Vec<String>,
    /// Largest difference that counts as equal.
    pub tolerance: f64,
}

/// How much one part differs.
#[derive(Clone, Debug, Serialize)]
pub struct Part {
    /// Channel, layer or column.
    pub name: String,
    /// Root of the mean squared difference.
    pub rmse: f64,
    /// Largest difference; infinite where only one value is a number.
    pub max: f64,
    /// How many values differ at all.
    pub differing: usize,
}

impl Comparison {
    /// Whether nothing differs by more than the tolerance.
    pub fn is_same(&self) -> bool {
        self.mismatches.is_empty() && self.parts.iter().all(|part| part.max <= self.tolerance)
    }
}

/// Compares two files, or two folders file by file.
///
/// # Errors
/// A file is missing, damaged or of a kind that cannot be compared.
pub fn compare(a: &Path, b: &Path, tolerance: f64) -> Result<Comparison> {
    let mut comparison = Comparison { tolerance, ..Comparison::default() };
    if a.is_dir() && b.is_dir() {
        compare_folders(a, b, &mut comparison)?;
    } else {
        compare_files(a, b, "", &mut comparison)?;
    }
    Ok(comparison)
}

/// Compares all files of two folders by their names; files with equal bytes are done at once.
fn compare_folders(a: &Path, b: &Path, comparison: &mut Comparison) -> Result<()> {
    let (in_a, in_b) = (files_below(a)?, files_below(b)?);
    let names: BTreeSet<&PathBuf> = in_a.union(&in_b).collect();
    for name in names {
        let label = name.display().to_string();
        if !in_a.contains(name) || !in_b.contains(name) {
            let side = if in_a.contains(name) { "first" } else { "second" };
            comparison.mismatches.push(format!("only the {side} has {label}"));
            continue;
        }
        compare_files(&a.join(name), &b.join(name), &format!("{label} "), comparison)?;
    }
    Ok(())
}

/// Paths of all files below a folder, relative to it; records of runs are left out.
fn files_below(folder: &Path) -> Result<BTreeSet<PathBuf>> {
    let mut found = BTreeSet::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        let entries = std::fs::read_dir(&next).map_err(|error| Error::system(&next, error))?;
        for entry in entries {
            let path = entry.map_err(|error| Error::system(&next, error))?.path();
            if path.is_dir() && path.file_name().is_some_and(|name| name != ".weald") {
                open.push(path);
            } else if path.is_file() {
                found.insert(path.strip_prefix(folder).unwrap_or(&path).to_path_buf());
            }
        }
    }
    Ok(found)
}

fn compare_files(a: &Path, b: &Path, prefix: &str, comparison: &mut Comparison) -> Result<()> {
    let (kind_a, kind_b) = (files::kind(a)?, files::kind(b)?);
    if kind_a != kind_b {
        let message = format!("{prefix}{} against {}", kind_a.describe(), kind_b.describe());
        comparison.mismatches.push(message);
        return Ok(());
    }
    if a.is_file() && weald_formats::hash_file(a)? == weald_formats::hash_file(b)? {
        comparison.parts.push(Part {
            name: format!("{prefix}bytes"),
            rmse: 0.0,
            max: 0.0,
            differing: 0,
        });
        return Ok(());
    }
    let columns = (columns(a, kind_a)?, columns(b, kind_b)?);
    if let Some(sizes) = other_sizes(&columns.0, &columns.1) {
        comparison.mismatches.push(format!("{prefix}{sizes}"));
        return Ok(());
    }
    compare_columns(prefix, &columns.0, &columns.1, comparison);
    Ok(())
}

/// The sizes of two pictures or rasters in words, unless they are equal: then no value of one has
/// a partner in the other, and the sizes say all.
fn other_sizes(a: &[(String, Column)], b: &[(String, Column)]) -> Option<String> {
    let size = |columns: &[(String, Column)]| match columns.first() {
        Some((name, Column::Integer(size))) if name == "size" => Some(size.clone()),
        _ => None,
    };
    match (size(a)?.as_slice(), size(b)?.as_slice()) {
        (a, b) if a == b => None,
        ([wide_a, high_a], [wide_b, high_b]) => {
            Some(format!("sizes: {wide_a} x {high_a} against {wide_b} x {high_b}"))
        }
        _ => None,
    }
}

/// Named values of any file: channels, layers and columns are all the same to a comparison.
fn columns(path: &Path, kind: FileKind) -> Result<Vec<(String, Column)>> {
    let numbers = |values: &[f32]| Column::Float(values.iter().map(|v| f64::from(*v)).collect());
    Ok(match kind {
        FileKind::Picture => {
            let picture = weald_formats::read_picture(path)?;
            let size =
                ("size".into(), Column::Integer(vec![picture.width as i64, picture.height as i64]));
            // Hashes of a cryptomatte are no quantities; who is seen stands in `species` and
            // `plant` too.
            let is_hash = |name: &str| {
                name.starts_with("Crypto") && (name.ends_with(".R") || name.ends_with(".B"))
            };
            let channels = picture.channels.iter().filter(|channel| !is_hash(&channel.name));
            let channels = channels.map(|c| (c.name.clone(), numbers(&c.values)));
            std::iter::once(size).chain(channels).collect()
        }
        FileKind::Png => {
            let preview = weald_formats::read_png(path)?;
            let size = vec![preview.width as i64, preview.height as i64];
            let rgb = preview.rgb.iter().map(|byte| f64::from(*byte)).collect();
            vec![("size".into(), Column::Integer(size)), ("rgb".into(), Column::Float(rgb))]
        }
        FileKind::Raster => {
            let raster = weald_formats::read_raster(path)?;
            let mut columns = frame_columns("", &raster.grid.frame);
            columns.push(("values".into(), numbers(&raster.grid.values)));
            columns
        }
        FileKind::Terrain => terrain_columns("", &weald_formats::read_terrain(path)?),
        FileKind::Population | FileKind::Instances | FileKind::Table => {
            weald_formats::read_table(path)?.columns
        }
        FileKind::Plant => plant_columns(&weald_formats::read_plant(path)?),
        FileKind::Palette => palette_columns(&weald_formats::read_palette(path)?),
        FileKind::Checkpoint => {
            vec![("bytes".into(), Column::text([weald_formats::hash_file(path)?]))]
        }
        FileKind::Report
        | FileKind::Scene
        | FileKind::Species
        | FileKind::Run
        | FileKind::Plants => {
            let text = crate::scene::read_text(path)?;
            vec![("text".into(), Column::text(text.lines()))]
        }
    })
}

fn frame_columns(prefix: &str, frame: &weald_contract::Frame) -> Vec<(String, Column)> {
    let size = vec![frame.width as i64, frame.height as i64];
    let place = vec![frame.cell, frame.west, frame.south];
    vec![
        (format!("{prefix}size"), Column::Integer(size)),
        (format!("{prefix}place"), Column::Float(place)),
    ]
}

fn terrain_columns(prefix: &str, terrain: &weald_contract::Layers) -> Vec<(String, Column)> {
    let mut columns = frame_columns(prefix, &terrain.frame);
    for (name, layer) in &terrain.layers {
        let values = layer.values.iter().map(|value| f64::from(*value)).collect();
        columns.push((format!("{prefix}{name}"), Column::Float(values)));
    }
    for (index, patch) in terrain.detail.iter().enumerate() {
        columns.extend(terrain_columns(&format!("{prefix}detail-{index}/"), patch));
    }
    columns
}

fn plant_columns(model: &weald_contract::PlantModel) -> Vec<(String, Column)> {
    let flat = |rows: &[[f32; 3]]| rows.iter().flatten().map(|v| f64::from(*v)).collect::<Vec<_>>();
    let mut columns = Vec::new();
    for (index, mesh) in model.wood.iter().enumerate() {
        columns.push((format!("wood {index}"), Column::Float(flat(&mesh.positions))));
    }
    for (index, organ) in model.organs.iter().enumerate() {
        let places: Vec<[f32; 3]> = organ.placements.iter().map(|place| place.position).collect();
        columns.push((format!("{} {index} places", organ.name), Column::Float(flat(&places))));
    }
    columns
}

fn palette_columns(palette: &weald_contract::Palette) -> Vec<(String, Column)> {
    let plants = &palette.representatives;
    let numbers = |value: fn(&weald_contract::Representative) -> f64| {
        Column::Float(plants.iter().map(value).collect())
    };
    vec![
        ("id".into(), Column::Integer(plants.iter().map(|plant| i64::from(plant.id)).collect())),
        ("species".into(), Column::text(plants.iter().map(|plant| &plant.species))),
        ("age".into(), numbers(|plant| f64::from(plant.age))),
        ("vigor".into(), numbers(|plant| f64::from(plant.vigor))),
        ("height".into(), numbers(|plant| f64::from(plant.height))),
        ("count".into(), numbers(|plant| plant.count as f64)),
        ("groups".into(), Column::Integer(palette.groups.iter().map(|g| g.count as i64).collect())),
    ]
}

fn compare_columns(
    prefix: &str,
    a: &[(String, Column)],
    b: &[(String, Column)],
    comparison: &mut Comparison,
) {
    let names: BTreeSet<&String> = a.iter().chain(b).map(|(name, _)| name).collect();
    let find = |columns: &[(String, Column)], name: &String| {
        columns.iter().find(|(found, _)| found == name).map(|(_, column)| column.clone())
    };
    for name in names {
        let label = format!("{prefix}{name}");
        match (find(a, name), find(b, name)) {
            (Some(a), Some(b)) => match difference(&a, &b) {
                Ok((rmse, max, differing)) => {
                    comparison.parts.push(Part { name: label, rmse, max, differing });
                }
                Err(why) => comparison.mismatches.push(format!("{label}: {why}")),
            },
            (Some(_), None) => comparison.mismatches.push(format!("only the first has {label}")),
            _ => comparison.mismatches.push(format!("only the second has {label}")),
        }
    }
}

/// Root mean square, largest difference, and number of values that differ.
fn difference(a: &Column, b: &Column) -> Result<(f64, f64, usize), String> {
    match (a, b) {
        (Column::Text(a), Column::Text(b)) if a.len() == b.len() => {
            let differing = a.iter().zip(b).filter(|(a, b)| a != b).count();
            let share = if a.is_empty() { 0.0 } else { differing as f64 / a.len() as f64 };
            let max = if differing > 0 { f64::INFINITY } else { 0.0 };
            Ok((share.sqrt(), max, differing))
        }
        _ => match (a.numbers(), b.numbers()) {
            (Some(mut a_values), Some(mut b_values)) if a_values.len() == b_values.len() => {
                // A text file holds the shortest decimals that give back the same single
                // precision number: compare them at that precision.
                if is_single(a) || is_single(b) {
                    a_values
                        .iter_mut()
                        .chain(&mut b_values)
                        .for_each(|v| *v = f64::from(*v as f32));
                }
                Ok(number_difference(&a_values, &b_values))
            }
            (Some(a), Some(b)) => Err(format!("{} values against {}", a.len(), b.len())),
            _ => Err("texts of other length, or texts against numbers".into()),
        },
    }
}

fn is_single(column: &Column) -> bool {
    matches!(column, Column::Float32(_))
}

/// Values that are no numbers in both count as equal.
fn number_difference(a: &[f64], b: &[f64]) -> (f64, f64, usize) {
    let (mut squares, mut max, mut differing) = (0.0, 0.0f64, 0);
    for (a, b) in a.iter().zip(b) {
        if a.to_bits() == b.to_bits() || a == b || (a.is_nan() && b.is_nan()) {
            continue;
        }
        let distance = (a - b).abs();
        let distance = if distance.is_nan() { f64::INFINITY } else { distance };
        differing += 1;
        squares += distance * distance;
        max = max.max(distance);
    }
    ((squares / a.len().max(1) as f64).sqrt(), max, differing)
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for mismatch in &self.mismatches {
            writeln!(f, "{mismatch}")?;
        }
        let differing: Vec<&Part> = self.parts.iter().filter(|part| part.differing > 0).collect();
        if !differing.is_empty() {
            writeln!(f, "{:<32} {:>12} {:>12} {:>10}", "part", "rmse", "max", "differing")?;
        }
        for Part { name, rmse, max, differing } in differing {
            writeln!(f, "{name:<32} {rmse:>12.6} {max:>12.6} {differing:>10}")?;
        }
        let verdict = match (self.is_same(), self.tolerance > 0.0) {
            (true, false) => "same".into(),
            (true, true) => format!("same within {}", self.tolerance),
            (false, _) => "different".into(),
        };
        writeln!(f, "{verdict}")
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn differences_are_those_of_arithmetic() {
        let a = [1.0, 2.0, f64::NAN, 4.0];
        let b = [1.0, 5.0, f64::NAN, 0.0];
        let (rmse, max, differing) = number_difference(&a, &b);
        assert_eq!((max, differing), (4.0, 2));
        // sqrt((9 + 16) / 4)
        assert!((rmse - 2.5).abs() < 1e-12);
        assert_eq!(number_difference(&[1.0], &[f64::NAN]).1, f64::INFINITY);
        assert_eq!(number_difference(&[], &[]), (0.0, 0.0, 0));
    }

    #[test]
    fn columns_of_other_length_or_name_are_mismatches() {
        let number = |values: &[f64]| Column::Float(values.to_vec());
        let mut comparison = Comparison { tolerance: 0.5, ..Comparison::default() };
        let a = [("x".to_string(), number(&[1.0, 2.0])), ("y".to_string(), number(&[0.0]))];
        let b = [("x".to_string(), number(&[1.0, 2.4])), ("z".to_string(), number(&[0.0]))];
        compare_columns("", &a[..1], &b[..1], &mut comparison);
        assert!(comparison.is_same());
        compare_columns("", &a, &b, &mut comparison);
        assert_eq!(comparison.mismatches, ["only the first has y", "only the second has z"]);
        assert!(!comparison.is_same());
        assert!(difference(&number(&[1.0]), &number(&[1.0, 2.0])).is_err());
    }

    #[test]
    fn decimals_of_a_single_precision_number_equal_it() {
        let text = Column::Float(vec![0.1, 382.1526]);
        let single = Column::Float32(vec![0.1, 382.1526]);
        assert_eq!(difference(&text, &single), Ok((0.0, 0.0, 0)));
    }
}
