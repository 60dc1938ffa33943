//! A grid of cells that finds the points near a point.

use crate::pattern::Pattern;

/// Points sorted by cell, cells in rows from the south-west.
pub(crate) struct Cells {
    origin: [f64; 2],
    /// Width and height of a cell.
    size: [f64; 2],
    /// Columns and rows.
    count: [usize; 2],
    /// First point of each cell, and one past the last point.
    starts: Vec<usize>,
    /// The points, cell by cell.
    pub points: Vec<[f64; 2]>,
    /// Number of each of them in the pattern.
    pub numbers: Vec<usize>,
}

impl Cells {
    /// Sorts points into cells of at least `reach` each way, and of about one point or more.
    pub fn new(pattern: &Pattern, reach: f64) -> Self {
        let window = pattern.window();
        let n = pattern.len().max(1);
        let side = reach.max((window.area() / n as f64).sqrt());
        // More cells than points along a side would only cost memory in narrow windows.
        let count =
            [window.width(), window.height()].map(|length| ((length / side) as usize).clamp(1, n));
        let size = [window.width() / count[0] as f64, window.height() / count[1] as f64];
        let mut cells = Self {
            origin: [window.x[0], window.y[0]],
            size,
            count,
            starts: vec![0; count[0] * count[1] + 1],
            points: vec![[0.0; 2]; pattern.len()],
            numbers: vec![0; pattern.len()],
        };
        cells.fill(pattern.points());
        cells
    }

    /// Counting sort: points of a cell keep their order.
    fn fill(&mut self, points: &[[f64; 2]]) {
        let number = |cells: &Self, point: [f64; 2]| {
            let [column, row] = cells.cell(point);
            row * cells.count[0] + column
        };
        for point in points {
            let cell = number(self, *point);
            self.starts[cell + 1] += 1;
        }
        for cell in 1..self.starts.len() {
            self.starts[cell] += self.starts[cell - 1];
        }
        let mut next = self.starts.clone();
        for (index, point) in points.iter().enumerate() {
            let cell = number(self, *point);
            self.points[next[cell]] = *point;
            self.numbers[next[cell]] = index;
            next[cell] += 1;
        }
    }

    fn cell(&self, point: [f64; 2]) -> [usize; 2] {
        std::array::from_fn(|axis| {
            let cell = (point[axis] - self.origin[axis]) / self.size[axis];
            (cell as usize).min(self.count[axis] - 1)
        })
    }

    /// Sorted points of the columns in `columns` of a row of cells.
    fn run(&self, row: usize, columns: std::ops::RangeInclusive<usize>) -> std::ops::Range<usize> {
        let first = row * self.count[0];
        self.starts[first + columns.start()]..self.starts[first + columns.end() + 1]
    }

    /// Calls `visit` with number, square of the distance and difference in place for every point
    /// that is at most `reach` from a place in the window, in a fixed order.
    ///
    /// `reach` is at most that of [`Cells::new`].
    pub fn for_around(
        &self,
        place: [f64; 2],
        reach: f64,
        mut visit: impl FnMut(usize, f64, [f64; 2]),
    ) {
        let [x, y] = place;
        let [column, row] = self.cell(place);
        let columns = column.saturating_sub(1)..=(column + 1).min(self.count[0] - 1);
        for row in row.saturating_sub(1)..=(row + 1).min(self.count[1] - 1) {
            for other in self.run(row, columns.clone()) {
                let apart = [self.points[other][0] - x, self.points[other][1] - y];
                let squared = apart[0] * apart[0] + apart[1] * apart[1];
                if squared <= reach * reach {
                    visit(other, squared, apart);
                }
            }
        }
    }

    /// Distance from point `index` to the nearest other one; infinite if it is alone.
    pub fn nearest(&self, index: usize) -> f64 {
        self.nearest_to(self.points[index], Some(index))
    }

    /// Distance from a place in the window to the nearest point but `except`; infinite if there
    /// is none.
    pub fn nearest_to(&self, place: [f64; 2], except: Option<usize>) -> f64 {
        let here = self.cell(place);
        let step = self.size[0].min(self.size[1]);
        let mut nearest = f64::INFINITY;
        for ring in 0..self.count[0].max(self.count[1]) {
            // What lies in this ring of cells and beyond is at least `ring - 1` whole cells away.
            if ring > 0 && (ring - 1) as f64 * step > nearest.sqrt() {
                break;
            }
            self.for_ring(here, ring, |other| {
                let [dx, dy] = [0, 1].map(|axis| self.points[other][axis] - place[axis]);
                if except != Some(other) {
                    nearest = nearest.min(dx * dx + dy * dy);
                }
            });
        }
        nearest.sqrt()
    }

    /// Visits the points of the cells whose larger distance from `here`, in cells, is `ring`.
    fn for_ring(&self, here: [usize; 2], ring: usize, mut visit: impl FnMut(usize)) {
        let [column, row] = here;
        let last = [self.count[0] - 1, self.count[1] - 1];
        let west = column.saturating_sub(ring);
        let east = (column + ring).min(last[0]);
        for at in row.saturating_sub(ring)..=(row + ring).min(last[1]) {
            if at.abs_diff(row) == ring {
                self.run(at, west..=east).for_each(&mut visit);
                continue;
            }
            if column >= ring {
                self.run(at, west..=west).for_each(&mut visit);
            }
            if column + ring <= last[0] {
                self.run(at, east..=east).for_each(&mut visit);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Window;
    use proptest::prelude::*;

    fn distance(a: [f64; 2], b: [f64; 2]) -> f64 {
        ((a[0] - b[0]).powi(2) + (a[1] - b[1]).powi(2)).sqrt()
    }

    proptest! {
        #[test]
        fn cells_find_what_looking_at_all_pairs_finds(
            points in prop::collection::vec((0.0..=3.0f64, 0.0..=0.7f64), 1..80),
            reach in 0.0..2.0f64,
        ) {
            let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let window = Window { x: [0.0, 3.0], y: [0.0, 0.7] };
            let cells = Cells::new(&Pattern::new(points, window).unwrap(), reach);
            for index in 0..cells.points.len() {
                let here = cells.points[index];
                let others = (0..cells.points.len()).filter(|other| *other != index);
                let distances: Vec<f64> =
                    others.map(|other| distance(here, cells.points[other])).collect();
                let mut count = 0;
                cells.for_around(here, reach, |other, _, _| count += usize::from(other != index));
                // Squares decide, so a distance of exactly `reach` may round either way.
                let sure = distances.iter().filter(|d| **d < reach * (1.0 - 1e-12)).count();
                let most = distances.iter().filter(|d| **d <= reach * (1.0 + 1e-12)).count();
                prop_assert!((sure..=most).contains(&count));
                let nearest = distances.iter().copied().fold(f64::INFINITY, f64::min);
                prop_assert_eq!(cells.nearest(index), nearest);
            }
        }
    }
}
