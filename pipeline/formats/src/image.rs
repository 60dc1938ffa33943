//! Rasters and one-band images of any format we read, chosen by the file's ending.

use crate::bytes::ending;
use crate::error::{Error, Result};
use crate::{ascii_grid, geotiff, hgt, npy, picture, png, prj};
use std::path::{Path, PathBuf};
use weald_contract::{Image, Raster};

/// Reads numbers with a place on the map: a GeoTIFF, an ESRI ASCII grid or a tile of SRTM.
///
/// "No data" becomes NaN; cells that are points are moved by half a cell, so that a value always
/// belongs to its cell's centre. Longitude and latitude are brought to metres in a UTM zone.
///
/// # Errors
/// When the file is missing, damaged, of another kind, or has cells that are not square.
pub fn read_raster(path: &Path) -> Result<Raster> {
    match ending(path).as_str() {
        "tif" | "tiff" => geotiff::read_raster(path),
        "asc" => ascii_grid::read_raster(path),
        "hgt" => hgt::read_raster(path),
        "png" | "exr" | "npy" => {
            let message = "this image has no place on the map";
            let hint = "a scene gives it one: `source_cell` and `source_heights` in `[terrain]`";
            Err(Error::invalid(path, message, hint))
        }
        other => {
            let message = format!("an elevation model that ends in `.{other}`");
            let hint = "GeoTIFF (.tif), ESRI ASCII (.asc) and SRTM (.hgt) are";
            Err(Error::unsupported(path, message, hint))
        }
    }
}

/// The file beside a raster that is read with it, where there is one: the `.prj` of an ESRI ASCII
/// grid.
pub fn companion(path: &Path) -> Option<PathBuf> {
    if ending(path) == "asc" { prj::beside(path) } else { None }
}

/// Reads one band of densities or parameters: PNG of 8 or 16 bits, GeoTIFF, OpenEXR, ESRI ASCII,
/// NumPy.
///
/// Integers become code / maximum without gamma; floats are kept.
///
/// # Errors
/// When the file is missing, damaged, of another kind, or has several bands that differ.
pub fn read_image(path: &Path) -> Result<Image> {
    match ending(path).as_str() {
        "png" => png::read_image(path),
        "tif" | "tiff" => geotiff::read_image(path),
        "exr" => picture::read_image(path),
        "npy" => npy::read_image(path),
        "asc" => {
            let Raster { grid, .. } = ascii_grid::read_raster(path)?;
            let (width, height) = (grid.frame.width, grid.frame.height);
            let frame = Some(grid.frame);
            Ok(Image { width, height, values: grid.values, is_float: true, frame })
        }
        other => {
            let message = format!("an image that ends in `.{other}`");
            Err(Error::unsupported(path, message, "png, tif, exr, asc and npy are"))
        }
    }
}
