//! Rasters and one-band images of any format we read, chosen by the file's ending.

use crate::bytes::ending;
use crate::error::{Error, Result};
use crate::{ascii_grid, geotiff, picture, png};
use std::path::Path;
use weald_contract::{Image, Raster};

/// Reads numbers with a place on the map: a GeoTIFF or an ESRI ASCII grid.
///
/// "No data" becomes NaN; cells that are points are moved by half a cell, so that a value always
/// belongs to its cell's centre.
///
/// # Errors
/// When the file is missing, damaged, of another kind, or has cells that are not square.
pub fn read_raster(path: &Path) -> Result<Raster> {
    match ending(path).as_str() {
        "tif" | "tiff" => geotiff::read_raster(path),
        "asc" => ascii_grid::read_raster(path),
        other => {
            let message = format!("an elevation model that ends in `.{other}`");
            Err(Error::unsupported(path, message, "a GeoTIFF (.tif) or ESRI ASCII (.asc) is"))
        }
    }
}

/// Reads one band of densities or parameters: PNG of 8 or 16 bits, GeoTIFF, OpenEXR, ESRI ASCII.
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
        "asc" => {
            let Raster { grid, .. } = ascii_grid::read_raster(path)?;
            let (width, height) = (grid.frame.width, grid.frame.height);
            let frame = Some(grid.frame);
            Ok(Image { width, height, values: grid.values, is_float: true, frame })
        }
        other => {
            let message = format!("an image that ends in `.{other}`");
            Err(Error::unsupported(path, message, "png, tif, exr and asc are"))
        }
    }
}
