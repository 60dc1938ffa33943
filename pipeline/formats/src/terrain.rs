//! A terrain's folder: one GeoTIFF a layer on one grid, finer patches in `detail-0`, `detail-1` …

use crate::error::{Error, Result};
use crate::geotiff::{self, BandRef};
use crate::provenance::Provenance;
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::{Crs, Frame, Layer, Layers};

/// The layer that every terrain has; it is written last, so that its provenance vouches for all.
pub(crate) const ALTITUDE_FILE: &str = "altitude.tif";
const ALTITUDE: &str = "altitude";

/// Most patches that are read; a scene has a few views.
const MAX_DETAIL: usize = 256;

/// Writes a terrain as a folder of GeoTIFFs.
///
/// Layers of an earlier terrain that this one lacks are removed, other files are left alone.
///
/// # Errors
/// When the terrain has no `altitude` or the disk refuses.
pub fn write_terrain(folder: &Path, terrain: &Layers, provenance: &Provenance) -> Result<()> {
    if !terrain.layers.contains_key(ALTITUDE) {
        let message = "the terrain has no layer `altitude`";
        return Err(Error::invalid(folder, message, "every terrain needs one"));
    }
    if let Some(name) = terrain.layers.keys().find(|name| !is_layer_name(name)) {
        let message = format!("`{name}` is no name for a layer");
        return Err(Error::invalid(folder, message, "use letters, digits, `_` and `-`"));
    }
    std::fs::create_dir_all(folder).map_err(Error::io("create", folder))?;
    remove_stale(folder, terrain)?;
    for (index, patch) in terrain.detail.iter().enumerate() {
        write_terrain(&folder.join(format!("detail-{index}")), patch, provenance)?;
    }
    write_layers(folder, terrain, provenance)
}

/// Writes layers as GeoTIFFs, and nothing else: without `altitude`, the folder is no terrain.
///
/// # Errors
/// When the disk refuses.
pub fn write_layers(folder: &Path, terrain: &Layers, provenance: &Provenance) -> Result<()> {
    let write = |(name, layer): (&String, &Layer)| {
        let band = BandRef {
            name,
            frame: terrain.frame,
            crs: &terrain.crs,
            unit: &layer.unit,
            definition: &layer.definition,
            values: &layer.values,
        };
        geotiff::write_band(&folder.join(format!("{name}.tif")), band, provenance)
    };
    let others: Vec<_> = terrain.layers.iter().filter(|(name, _)| *name != ALTITUDE).collect();
    // Collected in order, so that the first error is the same for any thread count.
    let written: Vec<Result<()>> = others.into_par_iter().map(write).collect();
    written.into_iter().collect::<Result<()>>()?;
    terrain.layers.get_key_value(ALTITUDE).map_or(Ok(()), write)
}

fn is_layer_name(name: &str) -> bool {
    let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '_' || c == '-';
    !name.is_empty() && name.chars().all(is_plain)
}

/// Removes what an earlier terrain left: our own layers and patches that this one lacks, and the
/// old `altitude`, whose provenance would vouch for a folder that is being rewritten.
fn remove_stale(folder: &Path, terrain: &Layers) -> Result<()> {
    for path in tiffs(folder)? {
        let is_kept = stem(&path).is_some_and(|n| n != ALTITUDE && terrain.layers.contains_key(&n));
        if !is_kept && matches!(geotiff::provenance(&path), Ok(Some(_))) {
            std::fs::remove_file(&path).map_err(Error::io("remove", &path))?;
        }
    }
    for index in terrain.detail.len()..MAX_DETAIL {
        let patch = folder.join(format!("detail-{index}"));
        if !patch.is_dir() {
            break;
        }
        if matches!(geotiff::provenance(&patch.join(ALTITUDE_FILE)), Ok(Some(_))) {
            std::fs::remove_dir_all(&patch).map_err(Error::io("remove", &patch))?;
        }
    }
    Ok(())
}

/// Reads a terrain's folder, ours or one of GeoTIFFs on one grid.
///
/// # Errors
/// When `altitude.tif` is missing, or a layer is damaged or lies on another grid.
pub fn read_terrain(folder: &Path) -> Result<Layers> {
    let mut terrain = read_grid(folder)?;
    for index in 0..MAX_DETAIL {
        let patch = folder.join(format!("detail-{index}"));
        if !patch.is_dir() {
            break;
        }
        terrain.detail.push(read_grid(&patch)?);
    }
    Ok(terrain)
}

fn read_grid(folder: &Path) -> Result<Layers> {
    let altitude = folder.join(ALTITUDE_FILE);
    if !altitude.is_file() {
        let hint = "a terrain is a folder of GeoTIFFs, one of them `altitude.tif`";
        return Err(Error::invalid(folder, "there is no `altitude.tif` in this folder", hint));
    }
    let read = |path: &PathBuf| geotiff::read_band(path);
    let paths = tiffs(folder)?;
    let bands: Vec<Result<geotiff::Band>> = paths.par_iter().map(read).collect();
    let first = paths.iter().position(|path| *path == altitude);
    let mut place: Option<(Frame, Crs)> = None;
    let mut layers = BTreeMap::new();
    // Altitude first: it decides the grid.
    let mut bands: Vec<_> = paths.iter().zip(bands).collect();
    bands.swap(0, first.unwrap_or(0));
    for (path, band) in bands {
        let band = band?;
        let (frame, crs) = (band.raster.grid.frame, band.raster.crs);
        let (grid, _) = place.get_or_insert((frame, crs));
        require_same_grid(path, grid, &frame)?;
        let values = band.raster.grid.values;
        let layer = Layer { unit: band.unit, definition: band.definition, values };
        layers.insert(stem(path).unwrap_or_default(), layer);
    }
    match place {
        Some((frame, crs)) => Ok(Layers { frame, crs, layers, detail: Vec::new() }),
        None => Err(Error::invalid(folder, "there is no layer in this folder", "")),
    }
}

/// Accepts frames that agree within a thousandth of a cell: other programs write rounded numbers.
fn require_same_grid(path: &Path, grid: &Frame, found: &Frame) -> Result<()> {
    let near = |a: f64, b: f64| (a - b).abs() <= 1e-3 * grid.cell;
    let same = (grid.width, grid.height) == (found.width, found.height)
        && near(grid.west, found.west)
        && near(grid.south, found.south)
        && near(grid.east(), found.east());
    if same {
        return Ok(());
    }
    let words = |f: &Frame| {
        format!("{} x {} cells of {} m at ({}, {})", f.width, f.height, f.cell, f.west, f.south)
    };
    let message = format!("the layer has {}", words(found));
    Err(Error::invalid(path, message, format!("`altitude.tif` has {}", words(grid))))
}

fn stem(path: &Path) -> Option<String> {
    path.file_stem().map(|stem| stem.to_string_lossy().into_owned())
}

/// GeoTIFFs of a folder by name.
fn tiffs(folder: &Path) -> Result<Vec<PathBuf>> {
    let mut paths = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(Error::io("list", folder))? {
        let path = entry.map_err(Error::io("list", folder))?.path();
        let is_hidden = path.file_name().is_some_and(|n| n.to_string_lossy().starts_with('.'));
        if !is_hidden && crate::bytes::ending(&path) == "tif" && path.is_file() {
            paths.push(path);
        }
    }
    paths.sort();
    Ok(paths)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;

    fn terrain(frame: Frame, crs: Crs) -> Layers {
        let mut terrain = Layers { frame, crs, layers: BTreeMap::new(), detail: Vec::new() };
        let values = |k: f32| (0..frame.len()).map(|i| (i as f32 * k).sin() * 100.0).collect();
        terrain.insert("altitude", "m", "Height of the ground", values(0.01));
        terrain.insert("slope", "degree", "Angle <of> the \"steepest\" line & more", values(0.3));
        terrain
    }

    fn utm() -> Crs {
        let keys = vec![1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 26915];
        Crs { epsg: Some(26915), keys, ..Crs::default() }
    }

    #[test]
    fn a_terrain_comes_back_bit_for_bit_with_its_patches_and_provenance() {
        let folder = tempfile::tempdir().unwrap();
        // Numbers whose sums round: the south edge must still come back exactly.
        let frame =
            Frame { width: 300, height: 257, cell: 0.1, west: 481_000.3, south: 5_250_000.7 };
        let mut whole = terrain(frame, utm());
        let patch = Frame { width: 8, height: 8, cell: 0.025, ..frame };
        whole.detail.push(terrain(patch, utm()));
        write_terrain(folder.path(), &whole, &story()).unwrap();
        assert_eq!(read_terrain(folder.path()).unwrap(), whole);
        assert_eq!(crate::provenance(folder.path()).unwrap(), Some(story()));
    }

    #[test]
    fn layers_of_an_earlier_terrain_go_and_files_of_others_stay() {
        let folder = tempfile::tempdir().unwrap();
        let frame = Frame { width: 4, height: 3, cell: 1.0, west: 0.0, south: 0.0 };
        let mut whole = terrain(frame, Crs::default());
        whole.detail.push(terrain(frame, Crs::default()));
        write_terrain(folder.path(), &whole, &story()).unwrap();
        std::fs::write(folder.path().join("notes.txt"), "mine").unwrap();
        whole.layers.remove("slope");
        whole.detail.clear();
        write_terrain(folder.path(), &whole, &story()).unwrap();
        assert_eq!(read_terrain(folder.path()).unwrap(), whole);
        assert!(folder.path().join("notes.txt").exists());
    }

    #[test]
    fn a_point_raster_keeps_its_keys_and_its_place() {
        let folder = tempfile::tempdir().unwrap();
        let mut crs = utm();
        crs.keys[11] = 2;
        let frame = Frame { width: 5, height: 4, cell: 2.0, west: 100.0, south: 200.0 };
        let whole = terrain(frame, crs);
        write_terrain(folder.path(), &whole, &story()).unwrap();
        assert_eq!(read_terrain(folder.path()).unwrap(), whole);
    }

    #[test]
    fn a_layer_on_another_grid_is_named() {
        let folder = tempfile::tempdir().unwrap();
        let frame = Frame { width: 4, height: 3, cell: 1.0, west: 0.0, south: 0.0 };
        write_terrain(folder.path(), &terrain(frame, Crs::default()), &story()).unwrap();
        let other = tempfile::tempdir().unwrap();
        let wide = Frame { width: 5, ..frame };
        write_terrain(other.path(), &terrain(wide, Crs::default()), &story()).unwrap();
        std::fs::copy(other.path().join("slope.tif"), folder.path().join("slope.tif")).unwrap();
        let text = read_terrain(folder.path()).unwrap_err().to_string();
        assert!(text.contains("slope.tif") && text.contains("5 x 3"), "{text}");
    }

    #[test]
    fn a_missing_folder_says_what_a_terrain_is() {
        let text = read_terrain(Path::new("nowhere")).unwrap_err().to_string();
        assert!(text.contains("nowhere") && text.contains("altitude.tif"), "{text}");
    }
}
