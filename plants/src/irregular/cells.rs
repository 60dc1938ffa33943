//! A uniform grid over points: which of them lie near a place.

use crate::volume::Bounds;
use glam::{IVec3, Vec3};
use std::ops::Range;

/// Boxes of one size over a region. Points outside belong to the nearest box.
#[derive(Clone, Debug, Default)]
pub struct Cells {
    low: Vec3,
    /// Side of a cell.
    pub side: f32,
    /// Cells along each axis.
    pub size: IVec3,
}

impl Cells {
    /// Cells of at least `side` over a box, at most about `most` of them: where there would be
    /// more, they are larger.
    pub fn over(bounds: Bounds, side: f32, most: usize) -> Self {
        let extent = (bounds.high - bounds.low).max(Vec3::splat(1e-6)).as_dvec3();
        let mut side = f64::from(side).max(extent.max_element() * 1e-4);
        let count = |side: f64| (extent / side).floor() + 1.0;
        while count(side).x * count(side).y * count(side).z > most.max(8) as f64 {
            side *= 1.25;
        }
        let size = count(side).as_ivec3();
        Self { low: bounds.low, side: side as f32, size }
    }

    /// Number of cells.
    pub fn len(&self) -> usize {
        self.size.as_i64vec3().element_product() as usize
    }

    /// The cell that holds a point.
    #[inline]
    pub fn of(&self, p: Vec3) -> IVec3 {
        let scaled = (p - self.low) / self.side;
        // Truncation towards zero is the floor for what lies inside.
        scaled.as_ivec3().clamp(IVec3::ZERO, self.size - 1)
    }

    /// Number of a cell; cells that differ in z alone follow each other.
    #[inline]
    pub fn index(&self, cell: IVec3) -> usize {
        ((cell.x * self.size.y + cell.y) * self.size.z + cell.z) as usize
    }

    /// The corner of a cell with the lowest coordinates.
    #[inline]
    pub fn corner(&self, cell: IVec3) -> Vec3 {
        self.low + cell.as_vec3() * self.side
    }
}

/// Points in the order of their cells.
#[derive(Clone, Debug, Default)]
pub struct Sorted {
    /// The grid.
    pub cells: Cells,
    /// Where the points of each cell begin; one more than there are cells.
    starts: Vec<u32>,
}

impl Sorted {
    /// Sorts points by their cells and writes where each went into `moved`.
    pub fn sort(&mut self, cells: Cells, points: &mut Vec<Vec3>, moved: &mut Vec<u32>) {
        self.starts.clear();
        self.starts.resize(cells.len() + 1, 0);
        for p in points.iter() {
            self.starts[cells.index(cells.of(*p)) + 1] += 1;
        }
        for index in 1..self.starts.len() {
            self.starts[index] += self.starts[index - 1];
        }
        moved.clear();
        for p in points.iter() {
            let next = &mut self.starts[cells.index(cells.of(*p))];
            moved.push(*next);
            *next += 1;
        }
        // Each start has become the start of the next cell.
        self.starts.rotate_right(1);
        self.starts[0] = 0;
        let mut sorted = vec![Vec3::ZERO; points.len()];
        for (p, to) in points.iter().zip(moved.iter()) {
            sorted[*to as usize] = *p;
        }
        *points = sorted;
        self.cells = cells;
    }

    /// Points of the cells at x and y whose z is in a range, which may reach beyond the grid.
    #[inline]
    pub fn row(&self, x: i32, y: i32, z: Range<i32>) -> Range<usize> {
        let size = self.cells.size;
        let (from, to) = (z.start.max(0), z.end.min(size.z));
        if x < 0 || y < 0 || x >= size.x || y >= size.y || from >= to {
            return 0..0;
        }
        let row = ((x * size.y + y) * size.z) as usize;
        self.starts[row + from as usize] as usize..self.starts[row + to as usize] as usize
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * self.starts.capacity()
    }
}
