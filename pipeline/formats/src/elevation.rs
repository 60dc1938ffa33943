//! Elevation models: rasters that know their place, and height images that need to be told it.

use crate::bytes::ending;
use crate::error::{Error, Result};
use crate::{image, npy};
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Image, Raster};

/// What a height image does not say about itself.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct HeightScale {
    /// Side of a pixel, m.
    pub cell: Option<f64>,
    /// Heights of black and white, m; floats are metres without it.
    pub heights: Option<[f64; 2]>,
}

/// Reads an elevation model: what [`crate::read_raster`] reads, or a height image (PNG, EXR, NPY)
/// whose south-west corner lies at the map's origin.
///
/// # Errors
/// As [`crate::read_raster`]; when an image lacks its scale, or a raster has one already.
pub fn read_elevation(path: &Path, scale: &HeightScale) -> Result<Raster> {
    let image = match ending(path).as_str() {
        "png" | "exr" => image::read_image(path)?,
        "npy" => npy::read_image(path)?,
        _ if *scale == HeightScale::default() => return image::read_raster(path),
        _ => {
            let message = "the file says its own place and heights";
            let hint = "`source_cell` and `source_heights` are for images: png, exr, npy";
            return Err(Error::invalid(path, message, hint));
        }
    };
    placed(path, image, scale)
}

fn placed(path: &Path, image: Image, scale: &HeightScale) -> Result<Raster> {
    let Image { width, height, mut values, is_float, .. } = image;
    let Some(cell) = scale.cell.filter(|cell| *cell > 0.0 && cell.is_finite()) else {
        let message = "an image does not say how large its pixels are";
        let hint = "set `source_cell` in `[terrain]`: the side of a pixel in metres";
        return Err(Error::invalid(path, message, hint));
    };
    if let Some([black, white]) = scale.heights {
        let metres = |value: f32| (black + (white - black) * f64::from(value)) as f32;
        values.iter_mut().for_each(|value| *value = metres(*value));
    } else if !is_float {
        let message = "an image of codes does not say how high its black and white are";
        let hint = "set `source_heights = [0, 300]` in `[terrain]`: their altitudes in metres";
        return Err(Error::invalid(path, message, hint));
    }
    let frame = Frame { width, height, cell, west: 0.0, south: 0.0 };
    Ok(Raster { grid: Grid { frame, values }, crs: Crs::default() })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEN: HeightScale = HeightScale { cell: Some(10.0), heights: Some([100.0, 400.0]) };

    fn read(name: &str, bytes: &[u8], scale: &HeightScale) -> Result<Raster> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join(name);
        std::fs::write(&path, bytes).unwrap();
        read_elevation(&path, scale)
    }

    fn gray() -> Vec<u8> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("gray.png");
        let story = crate::provenance::tests::story();
        crate::write_gray_png(&path, 3, 1, &[0, 32768, 65535], &story).unwrap();
        std::fs::read(path).unwrap()
    }

    #[test]
    fn sixteen_bits_span_the_heights_of_black_and_white() {
        let found = read("h.png", &gray(), &TEN).unwrap().grid;
        assert_eq!(found.frame, Frame { width: 3, height: 1, cell: 10.0, west: 0.0, south: 0.0 });
        let step = 300.0 / 65535.0;
        let wanted = [100.0, 100.0 + 32768.0 * step, 400.0];
        for (found, wanted) in found.values.iter().zip(wanted) {
            assert!((f64::from(*found) - wanted).abs() < 1e-4, "{found}");
        }
    }

    #[test]
    fn arrays_are_metres_unless_told_otherwise() {
        let header = "{'descr': '<i2', 'fortran_order': False, 'shape': (1, 2), }\n";
        let length = (header.len() as u16).to_le_bytes();
        let bytes =
            [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), &[0x2c, 0x01, 0xff, 0xff]];
        let scale = HeightScale { heights: None, ..TEN };
        assert_eq!(read("h.npy", &bytes.concat(), &scale).unwrap().grid.values, [300.0, -1.0]);
    }

    #[test]
    fn what_is_missing_or_too_much_is_named() {
        let without = |scale: HeightScale| read("h.png", &gray(), &scale).unwrap_err().to_string();
        assert!(without(HeightScale::default()).contains("source_cell"));
        assert!(without(HeightScale { heights: None, ..TEN }).contains("source_heights"));
        let text = "ncols 1\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\n1\n";
        let error = read("h.asc", text.as_bytes(), &TEN).unwrap_err().to_string();
        assert!(error.contains("its own place"), "{error}");
    }
}
