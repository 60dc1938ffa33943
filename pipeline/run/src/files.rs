//! Which of our files is this? Told by the name's ending and, for tables, by the columns.

use crate::error::{Error, Result};
use crate::library;
use crate::preview::colors_by_name;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::{FromToml, Population, Sources, Species, Value};

/// The kinds of files that pass between stages.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// A folder of layers.
    Terrain,
    /// An output folder of `weald run`.
    Run,
    /// A folder of plant models.
    Plants,
    /// One raster.
    Raster,
    /// Plants, a row each.
    Population,
    /// Where representatives stand.
    Instances,
    /// Any other table.
    Table,
    /// Representatives.
    Palette,
    /// A scene's tables.
    Scene,
    /// A species' tables.
    Species,
    /// A plant model.
    Plant,
    /// An OpenEXR picture.
    Picture,
    /// An 8-bit picture.
    Png,
    /// A JSON report.
    Report,
    /// The state of a simulation.
    Checkpoint,
}

impl FileKind {
    /// The kind in words, with its article.
    pub fn describe(self) -> &'static str {
        match self {
            FileKind::Terrain => "a terrain",
            FileKind::Run => "an output folder",
            FileKind::Plants => "a folder of plants",
            FileKind::Raster => "a raster",
            FileKind::Population => "a population",
            FileKind::Instances => "a table of instances",
            FileKind::Table => "a table",
            FileKind::Palette => "a palette",
            FileKind::Scene => "a scene",
            FileKind::Species => "a species",
            FileKind::Plant => "a plant model",
            FileKind::Picture => "a picture",
            FileKind::Png => "an 8-bit picture",
            FileKind::Report => "a report",
            FileKind::Checkpoint => "a checkpoint of a simulation",
        }
    }
}

/// Tells what a path holds.
///
/// # Errors
/// There is nothing, or nothing that we know.
pub fn kind(path: &Path) -> Result<FileKind> {
    if !path.exists() {
        let hint = crate::scene::near_file(path).unwrap_or_else(|| "check the path".into());
        return Err(Error::plain(format!("there is no file {}", path.display()), hint));
    }
    if path.is_dir() {
        return folder_kind(path);
    }
    let ending = path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase());
    match ending.as_deref() {
        Some("tif" | "tiff" | "asc") => Ok(FileKind::Raster),
        Some("parquet" | "csv" | "geojson" | "gpkg") => table_kind(path),
        Some("toml") => toml_kind(path),
        Some("glb") => Ok(FileKind::Plant),
        Some("exr") => Ok(FileKind::Picture),
        Some("png") => Ok(FileKind::Png),
        Some("json") => Ok(FileKind::Report),
        _ if crate::checkpoint::is_checkpoint(path) => Ok(FileKind::Checkpoint),
        _ => Err(Error::plain(
            format!("{} is no file of ours", path.display()),
            "known endings: tif, asc, parquet, csv, geojson, gpkg, toml, glb, exr, png, json",
        )),
    }
}

fn folder_kind(path: &Path) -> Result<FileKind> {
    if path.join(".weald").is_dir() {
        return Ok(FileKind::Run);
    }
    if path.join("altitude.tif").is_file() {
        return Ok(FileKind::Terrain);
    }
    if !with_ending(path, "glb")?.is_empty() {
        return Ok(FileKind::Plants);
    }
    if path.join("scene.toml").is_file() {
        return Ok(FileKind::Scene);
    }
    Err(Error::plain(
        format!("{} holds no file of ours", path.display()),
        "give a scene's folder, a terrain's (with `altitude.tif`), one of plants, or the output \
         of `weald run`",
    ))
}

/// Tells TOML files apart by the tables that only one kind has.
fn toml_kind(path: &Path) -> Result<FileKind> {
    let text = crate::scene::read_text(path)?;
    let mut sources = Sources::default();
    let source = sources.add(path.display().to_string(), text.clone());
    let tree = Value::parse(source, &text)
        .map_err(|problems| Error::Wrong { sources: sources.into(), problems })?;
    let has = |key| tree.as_table().is_some_and(|table| table.get(key).is_some());
    Ok(match () {
        () if has("size") => FileKind::Species,
        () if has("terrain") || has("render") => FileKind::Scene,
        () => FileKind::Palette,
    })
}

/// Tells tables apart by the columns that only one kind has.
fn table_kind(path: &Path) -> Result<FileKind> {
    let table = weald_formats::read_table(path)?;
    let has = |name: &str| table.columns.iter().any(|(column, _)| column == name);
    Ok(match () {
        () if has("prototype") && has("group") => FileKind::Instances,
        () if has("species") && has("x") && has("y") => FileKind::Population,
        () => FileKind::Table,
    })
}

/// Refuses to write a file under a name that other programs would take for something else.
///
/// # Errors
/// The name does not end so.
pub fn must_end(path: &Path, ending: &str) -> Result<()> {
    match path.extension() {
        Some(found) if found.eq_ignore_ascii_case(ending) => Ok(()),
        _ => Err(Error::plain(
            format!("{} does not end in `.{ending}`", path.display()),
            format!("{} is right", path.with_extension(ending).display()),
        )),
    }
}

/// Files of a folder with this ending, sorted by name.
///
/// # Errors
/// The folder cannot be read.
pub fn with_ending(folder: &Path, ending: &str) -> Result<Vec<PathBuf>> {
    let entries = std::fs::read_dir(folder).map_err(|error| Error::system(folder, error))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.retain(|path| path.extension().is_some_and(|found| found == ending));
    files.sort();
    Ok(files)
}

/// The folder of a terrain, also when one of its layers was named.
pub fn terrain_folder(path: &Path) -> PathBuf {
    match path.file_name() {
        Some(name) if name == "altitude.tif" => path.parent().unwrap_or(Path::new(".")).into(),
        _ => path.into(),
    }
}

/// Colours for a population's species: from `species/` near the file, then from the program.
pub fn colors_of(population: &Population, near: &Path) -> Vec<[u8; 3]> {
    let folder = near.parent().unwrap_or(Path::new("."));
    let mut known = BTreeMap::new();
    for name in &population.species {
        let beside = folder.join("species").join(format!("{name}.toml"));
        let text = std::fs::read_to_string(beside).ok();
        let text = text.or_else(|| library::species(name).map(str::to_string));
        if let Some(color) = text.and_then(|text| color_in(&text)) {
            known.insert(name.clone(), color);
        }
    }
    colors_by_name(&population.species, &known)
}

/// The colour of a species file; `None` when the file has mistakes, which matter elsewhere.
fn color_in(text: &str) -> Option<[u32; 3]> {
    let source = Sources::default().add("species", text);
    let tree = Value::parse(source, text).ok()?;
    Species::from_toml(&tree, &mut Vec::new()).map(|species| species.color)
}
