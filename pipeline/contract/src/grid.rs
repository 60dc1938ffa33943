//! Rasters in map coordinates.

/// Where the cells of a raster lie.
///
/// Cells are squares; a value belongs to its cell's centre. Row 0 is the north edge; nobody but
/// this type needs to know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Frame {
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
    /// Side of a cell, m.
    pub cell: f64,
    /// Map coordinate of the west edge, m.
    pub west: f64,
    /// Map coordinate of the south edge, m.
    pub south: f64,
}

impl Frame {
    /// Number of cells.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Whether there is no cell.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Map coordinate of the east edge, m.
    pub fn east(&self) -> f64 {
        self.west + self.width as f64 * self.cell
    }

    /// Map coordinate of the north edge, m.
    pub fn north(&self) -> f64 {
        self.south + self.height as f64 * self.cell
    }

    /// Area of a cell, m².
    pub fn cell_area(&self) -> f64 {
        self.cell * self.cell
    }

    /// Map coordinates of a cell's centre.
    pub fn center(&self, column: usize, row: usize) -> (f64, f64) {
        let x = self.west + (column as f64 + 0.5) * self.cell;
        let y = self.south + ((self.height - 1 - row) as f64 + 0.5) * self.cell;
        (x, y)
    }

    /// The cell (column, row) that holds a point, if one does.
    pub fn cell_at(&self, x: f64, y: f64) -> Option<(usize, usize)> {
        let column = ((x - self.west) / self.cell).floor();
        let row = ((self.north() - y) / self.cell).floor();
        let inside =
            column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        inside.then_some((column as usize, row as usize))
    }

    /// Whether a point lies inside or on the rim.
    pub fn contains(&self, x: f64, y: f64) -> bool {
        x >= self.west && x <= self.east() && y >= self.south && y <= self.north()
    }

    /// Index of a cell in row-major order, north row first.
    pub fn index(&self, column: usize, row: usize) -> usize {
        row * self.width + column
    }

    /// Cell indices and weights of bilinear interpolation at a point.
    ///
    /// Points beyond the outermost cell centres take the nearest rim value.
    pub fn bilinear(&self, x: f64, y: f64) -> [(usize, f32); 4] {
        let u = ((x - self.west) / self.cell - 0.5).clamp(0.0, (self.width - 1) as f64);
        let v = ((self.north() - y) / self.cell - 0.5).clamp(0.0, (self.height - 1) as f64);
        let (c0, r0) = (u as usize, v as usize);
        let (c1, r1) = ((c0 + 1).min(self.width - 1), (r0 + 1).min(self.height - 1));
        let (fu, fv) = ((u - c0 as f64) as f32, (v - r0 as f64) as f32);
        [
            (self.index(c0, r0), (1.0 - fu) * (1.0 - fv)),
            (self.index(c1, r0), fu * (1.0 - fv)),
            (self.index(c0, r1), (1.0 - fu) * fv),
            (self.index(c1, r1), fu * fv),
        ]
    }

    /// Bilinear value at a point of row-major `values` on this frame.
    pub fn sample(&self, values: &[f32], x: f64, y: f64) -> f32 {
        self.bilinear(x, y).iter().map(|&(index, weight)| values[index] * weight).sum()
    }
}

/// One band of values on a [`Frame`]: heights, densities, masks.
#[derive(Clone, Debug, PartialEq)]
pub struct Grid {
    /// Where the cells lie.
    pub frame: Frame,
    /// `frame.len()` values, north row first. Readers turn "no data" into NaN; stages take only
    /// finite values.
    pub values: Vec<f32>,
}

impl Grid {
    /// A grid of one value.
    pub fn filled(frame: Frame, value: f32) -> Self {
        Self { frame, values: vec![value; frame.len()] }
    }

    /// A grid whose values are computed at cell centres, `(x, y)` in map coordinates.
    pub fn from_fn(frame: Frame, value: impl Fn(f64, f64) -> f32 + Sync) -> Self {
        use rayon::prelude::*;
        let mut values = vec![0.0; frame.len()];
        values.par_chunks_mut(frame.width.max(1)).enumerate().for_each(|(row, line)| {
            for (column, cell) in line.iter_mut().enumerate() {
                let (x, y) = frame.center(column, row);
                *cell = value(x, y);
            }
        });
        Self { frame, values }
    }

    /// Bilinear value at a point in map coordinates; the rim value outside.
    pub fn sample(&self, x: f64, y: f64) -> f32 {
        self.frame.sample(&self.values, x, y)
    }

    /// Value of the cell that holds a point, if one does.
    pub fn nearest(&self, x: f64, y: f64) -> Option<f32> {
        self.frame.cell_at(x, y).map(|(column, row)| self.values[self.frame.index(column, row)])
    }
}

/// A coordinate reference system, carried through untouched.
///
/// The raw GeoTIFF keys are kept because real files hold keys that no typed model accepts.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Crs {
    /// EPSG code of the projected (or geographic) system, where the keys name one.
    pub epsg: Option<u32>,
    /// Whether coordinates are degrees.
    pub is_geographic: bool,
    /// GeoKeyDirectory (tag 34735).
    pub keys: Vec<u16>,
    /// GeoDoubleParams (tag 34736).
    pub doubles: Vec<f64>,
    /// GeoAsciiParams (tag 34737).
    pub ascii: String,
}

/// A grid read from a file, with its map.
#[derive(Clone, Debug, PartialEq)]
pub struct Raster {
    /// The values; NaN where the file says "no data".
    pub grid: Grid,
    /// The map's reference system; empty when the file names none.
    pub crs: Crs,
}

/// One band of an image: density, mask or parameter.
///
/// Values of integer images are code / maximum (0 to 1, no gamma); float images are kept as is.
#[derive(Clone, Debug, PartialEq)]
pub struct Image {
    /// Pixels from west to east.
    pub width: usize,
    /// Pixels from north to south.
    pub height: usize,
    /// Values, north row first.
    pub values: Vec<f32>,
    /// Whether the file holds floats, which are plants per m² when no scale is given.
    pub is_float: bool,
    /// Its place on the map, if the file says so; otherwise it covers the whole terrain.
    pub frame: Option<Frame>,
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { width: 3, height: 2, cell: 2.0, west: 100.0, south: 50.0 };

    #[test]
    fn row_zero_is_the_north_edge() {
        assert_eq!(FRAME.center(0, 0), (101.0, 53.0));
        assert_eq!(FRAME.cell_at(101.0, 53.0), Some((0, 0)));
        assert_eq!(FRAME.cell_at(99.9, 53.0), None);
    }

    #[test]
    fn bilinear_sampling_reproduces_a_plane_between_centres() {
        let plane = Grid::from_fn(FRAME, |x, y| (2.0 * x - y) as f32);
        for (x, y) in [(101.0, 51.0), (102.3, 52.2), (105.0, 53.0)] {
            assert!((f64::from(plane.sample(x, y)) - (2.0 * x - y)).abs() < 1e-4);
        }
    }
}
