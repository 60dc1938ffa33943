//! Cells in scene coordinates: the whole ground, a tile of it, or a finer patch.

use weald_contract::Frame;

/// Square cells on a lattice through the scene's origin, the terrain's south-west corner.
///
/// Cells are counted in whole numbers from that origin, so that a tile of a lattice computes
/// exactly the coordinates that the whole does.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lattice {
    /// Side of a cell, m.
    pub cell: f64,
    /// Cells between the origin and the west edge.
    pub west: usize,
    /// Cells between the origin and the south edge.
    pub south: usize,
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
}

impl Lattice {
    /// The lattice of all cells of a frame.
    pub fn of(frame: &Frame) -> Self {
        Self { cell: frame.cell, west: 0, south: 0, width: frame.width, height: frame.height }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.width * self.height
    }

    /// Metres east of the origin of a column's centres.
    pub fn x(&self, column: usize) -> f64 {
        ((self.west + column) as f64 + 0.5) * self.cell
    }

    /// Metres north of the origin of a row's centres; row 0 is the north edge.
    pub fn y(&self, row: usize) -> f64 {
        ((self.south + self.height - 1 - row) as f64 + 0.5) * self.cell
    }

    /// The same cells as a frame whose south-west corner lies at `origin` plus their offset.
    pub fn frame(&self, origin: (f64, f64)) -> Frame {
        Frame {
            width: self.width,
            height: self.height,
            cell: self.cell,
            west: origin.0 + self.west as f64 * self.cell,
            south: origin.1 + self.south as f64 * self.cell,
        }
    }

    /// As many smaller cells, from the same south-west corner, as fit.
    pub fn refined(&self, cell: f64) -> Lattice {
        let cells = |count: usize| (count as f64 * self.cell / cell).floor() as usize;
        Lattice { cell, west: 0, south: 0, width: cells(self.width), height: cells(self.height) }
    }

    /// The lattice that has `margin` more cells on every side, as far as `bounds` allows.
    pub fn grown(&self, margin: usize, bounds: &Lattice) -> Lattice {
        let west = self.west.saturating_sub(margin).max(bounds.west);
        let south = self.south.saturating_sub(margin).max(bounds.south);
        let east = (self.west + self.width + margin).min(bounds.west + bounds.width);
        let north = (self.south + self.height + margin).min(bounds.south + bounds.height);
        Lattice { cell: self.cell, west, south, width: east - west, height: north - south }
    }

    /// The values of `part`'s cells out of `values` on this lattice, which must hold them.
    pub fn crop(&self, values: &[f32], part: &Lattice) -> Vec<f32> {
        let first_column = part.west - self.west;
        let first_row = (self.south + self.height) - (part.south + part.height);
        let rows = values.chunks_exact(self.width).skip(first_row).take(part.height);
        rows.flat_map(|row| &row[first_column..first_column + part.width]).copied().collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_has_the_coordinates_and_values_of_the_whole() {
        let whole = Lattice { cell: 0.3, west: 0, south: 0, width: 7, height: 5 };
        let tile = Lattice { west: 2, south: 1, width: 3, height: 2, ..whole };
        let values: Vec<f32> = (0..whole.len()).map(|i| i as f32).collect();
        assert_eq!(tile.x(0), whole.x(2));
        assert_eq!(tile.y(0), whole.y(2), "the tile's north row is the third of the whole");
        assert_eq!(whole.crop(&values, &tile), [16.0, 17.0, 18.0, 23.0, 24.0, 25.0]);
        assert_eq!(tile.grown(9, &whole), whole);
    }
}
