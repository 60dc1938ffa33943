//! ESRI ASCII grids: a header of five or six lines, then numbers, north row first; a `.prj` of the
//! same name may stand beside them.

use crate::bytes::{MAX_FILE_BYTES, read_text};
use crate::error::{Error, Result};
use crate::geotiff::MAX_CELLS;
use crate::prj;
use crate::utm::{self, Cells};
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Raster};

/// Reads an ESRI ASCII grid, and its reference system from the `.prj` of the same name; without
/// one, what can only be longitude and latitude is taken for WGS 84. Degrees are brought to their
/// UTM zone.
///
/// # Errors
/// When the header lacks a field or the numbers are not as many as it says; when the `.prj` is no
/// well-known text, or says feet or a datum that we do not know.
pub fn read_raster(path: &Path) -> Result<Raster> {
    let crs = prj::beside(path).map(|beside| prj::read(&beside)).transpose()?;
    on_map(path, parse_grid(path, &read_text(path, MAX_FILE_BYTES)?)?, crs)
}

/// Reads an ESRI ASCII grid without `.prj` from its text; `path` is for messages only.
///
/// # Errors
/// As [`read_raster`].
pub fn parse_raster(path: &Path, text: &str) -> Result<Raster> {
    on_map(path, parse_grid(path, text)?, None)
}

/// Gives a grid its reference system, and brings degrees to metres.
fn on_map(path: &Path, grid: Grid, crs: Option<Crs>) -> Result<Raster> {
    let is_geographic = crs.as_ref().map_or(are_degrees(&grid.frame), |crs| crs.is_geographic);
    let crs = crs.unwrap_or_default();
    if !is_geographic {
        return Ok(Raster { grid, crs });
    }
    let Frame { width, height, cell, west, .. } = grid.frame;
    let north = grid.frame.north();
    let cells = Cells { width, height, west, north, across: cell, down: cell };
    utm::to_utm(path, &cells, &grid.values, &crs)
}

fn parse_grid(path: &Path, text: &str) -> Result<Grid> {
    let (header, body) = Header::read(path, text)?;
    let frame = header.frame(path)?;
    // Each number takes at least a digit and a space, which bounds the allocation.
    if frame.len() > body.len().div_ceil(2) {
        let message = format!("the header promises {} numbers", frame.len());
        return Err(Error::invalid(path, message, "the file is shorter; it may be cut short"));
    }
    let mut values = Vec::with_capacity(frame.len());
    for word in body.split_ascii_whitespace() {
        let number: f64 = word.parse().map_err(|_| {
            let message = format!("number {} is `{word}`", values.len() + 1);
            Error::invalid(path, message, "only numbers may follow the header")
        })?;
        let is_missing = header.nodata == Some(number);
        values.push(if is_missing { f32::NAN } else { number as f32 });
    }
    if values.len() != frame.len() {
        let message = format!("the grid has {} numbers", values.len());
        let hint = format!("the header promises {} x {}", frame.width, frame.height);
        return Err(Error::invalid(path, message, hint));
    }
    Ok(Grid { frame, values })
}

/// Header fields; `xllcorner` and `xllcenter` are alternatives.
#[derive(Default)]
struct Header {
    ncols: Option<f64>,
    nrows: Option<f64>,
    cellsize: Option<f64>,
    xll: Option<f64>,
    yll: Option<f64>,
    x_is_center: bool,
    y_is_center: bool,
    nodata: Option<f64>,
}

impl Header {
    /// Reads `word number` lines up to the first line that starts with a number.
    fn read<'a>(path: &Path, text: &'a str) -> Result<(Self, &'a str)> {
        let mut header = Self::default();
        let mut rest = text;
        while let Some(line) = rest.lines().next() {
            let mut words = line.split_ascii_whitespace();
            let first = words.next().unwrap_or_default();
            // `nan` begins with a letter but is a value.
            if !first.is_empty() && first.parse::<f64>().is_ok() {
                break;
            }
            if !first.is_empty() {
                let number = words.next().and_then(|word| word.parse().ok());
                header.set(path, first, number)?;
            }
            rest = rest.split_once('\n').map_or("", |(_, after)| after);
        }
        Ok((header, rest))
    }

    fn set(&mut self, path: &Path, word: &str, number: Option<f64>) -> Result<()> {
        let name = word.to_ascii_lowercase();
        let field = match name.as_str() {
            "ncols" => &mut self.ncols,
            "nrows" => &mut self.nrows,
            "cellsize" => &mut self.cellsize,
            "xllcorner" => &mut self.xll,
            "yllcorner" => &mut self.yll,
            "xllcenter" => {
                self.x_is_center = true;
                &mut self.xll
            }
            "yllcenter" => {
                self.y_is_center = true;
                &mut self.yll
            }
            "nodata_value" => &mut self.nodata,
            _ => {
                let shown: String = word.chars().take(40).collect();
                let hint = "an ESRI ASCII grid begins with ncols, nrows, xllcorner, yllcorner, \
                            cellsize and NODATA_value";
                return Err(Error::invalid(path, format!("unknown header `{shown}`"), hint));
            }
        };
        if number.is_none() {
            return Err(Error::invalid(path, format!("`{word}` has no number"), ""));
        }
        *field = number;
        Ok(())
    }

    fn frame(&self, path: &Path) -> Result<Frame> {
        let need = |field: Option<f64>, name: &str| {
            field.filter(|number| number.is_finite()).ok_or_else(|| {
                let hint = "this header is required; is it an ESRI ASCII grid?";
                Error::invalid(path, format!("the header has no `{name}`"), hint)
            })
        };
        let (columns, rows) = (need(self.ncols, "ncols")?, need(self.nrows, "nrows")?);
        let cell = need(self.cellsize, "cellsize")?;
        let is_count = |n: f64| n >= 1.0 && n.fract() == 0.0;
        if !(is_count(columns) && is_count(rows) && columns * rows <= MAX_CELLS as f64) {
            let message = format!("the header says {columns} x {rows} cells");
            return Err(Error::invalid(path, message, format!("1 to {MAX_CELLS} are read")));
        }
        if cell <= 0.0 {
            return Err(Error::invalid(path, format!("the cell size is {cell}"), "it must be > 0"));
        }
        let half = |is_center: bool| if is_center { 0.5 * cell } else { 0.0 };
        let west = need(self.xll, "xllcorner")? - half(self.x_is_center);
        let south = need(self.yll, "yllcorner")? - half(self.y_is_center);
        Ok(Frame { width: columns as usize, height: rows as usize, cell, west, south })
    }
}

/// Whether a place and a cell size can only be longitude and latitude.
///
/// For grids without a `.prj`. Ten-millimetre cells occur in laboratories, but those
/// are measured from an origin, not from a corner that lies whole degrees away from it.
fn are_degrees(&Frame { cell, west, south, .. }: &Frame) -> bool {
    cell < 0.01 && (1.0..=180.0).contains(&west.abs()) && (1.0..=90.0).contains(&south.abs())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn parse(text: &str) -> Result<Raster> {
        parse_raster(Path::new("dem.asc"), text)
    }

    #[test]
    fn corner_and_centre_headers_mean_the_same_place() {
        let corner = "ncols 2\nnrows 1\nxllcorner 10\nyllcorner 20\ncellsize 4\n1 2\n";
        let center = "NCOLS 2\r\nNROWS 1\r\nXLLCENTER 12\r\nYLLCENTER 22\r\nCELLSIZE 4\r\n1 2\r\n";
        assert_eq!(parse(corner).unwrap(), parse(center).unwrap());
    }

    #[test]
    fn missing_values_become_nan() {
        let text =
            "ncols 2\nnrows 1\nxllcorner 0\nyllcorner 0\ncellsize 1\nNODATA_value -9999\n-9999 5";
        let values = parse(text).unwrap().grid.values;
        assert!(values[0].is_nan() && values[1] == 5.0);
    }

    #[test]
    fn a_cut_file_and_an_absurd_size_are_refused() {
        for body in ["ncols 3\nnrows 2", "ncols 1e9\nnrows 1e9", "ncols -1\nnrows 2", "ncols x"] {
            let text = format!("{body}\nxllcorner 0\nyllcorner 0\ncellsize 1\n1 2 3 4 5");
            let error = parse(&text).unwrap_err().to_string();
            assert!(error.starts_with("dem.asc: "), "{error}");
        }
    }

    #[test]
    fn the_companion_says_the_map() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("dem.asc");
        let header = "ncols 9\nnrows 9\nxllcorner 4.5\nyllcorner 52.0\ncellsize 0.05\n";
        std::fs::write(&path, format!("{header}{}", "3 ".repeat(81))).unwrap();
        // Cells so wide are metres unless the companion says otherwise.
        assert_eq!(read_raster(&path).unwrap().crs, Crs::default());
        let system = r#"GEOGCS["GCS_ETRS_1989",DATUM["D_ETRS_1989",SPHEROID["GRS_1980",1,2]]]"#;
        std::fs::write(path.with_extension("prj"), system).unwrap();
        let raster = read_raster(&path).unwrap();
        assert_eq!(raster.crs.epsg, Some(25831));
        assert!(raster.grid.frame.cell > 3000.0);
        std::fs::write(path.with_extension("prj"), "metres").unwrap();
        assert!(read_raster(&path).unwrap_err().to_string().contains("dem.prj"));
    }

    #[test]
    fn degrees_become_metres() {
        let grid = |corner: &str, cell: &str| {
            format!("ncols 1\nnrows 1\n{corner}\ncellsize {cell}\n1630\n")
        };
        let read = |text: String| parse_raster(Path::new("dem.asc"), &text);
        // Three arc seconds near Boulder, 71 by 92.5 m.
        let header = "ncols 9\nnrows 9\nxllcorner -105.36\nyllcorner 40.02\ncellsize 0.000833333";
        let boulder = read(format!("{header}\n{}", "1630 ".repeat(81))).unwrap();
        assert_eq!((boulder.crs.epsg, boulder.grid.frame.cell), (Some(32613), 81.1));
        assert!(boulder.grid.values.iter().all(|height| (height - 1630.0).abs() < 1e-3));
        // A sand box of five-millimetre cells.
        assert!(read(grid("xllcorner 0\nyllcorner 0", "0.005")).is_ok());
        assert!(read(grid("xllcorner 500000\nyllcorner 40", "0.005")).is_ok());
    }
}
