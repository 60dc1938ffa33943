//! Masses and centres of mass of polygons on a density raster.

use crate::config::Weight;
use rayon::prelude::*;
use weald_contract::Grid;

/// Lines along which a polygon's mass is summed, at least.
const LEAST_LINES: f64 = 10.0;
/// Fewest and most places at which the weight along an edge is looked up.
const LEAST_PLACES: f64 = 2.0;
const MOST_PLACES: f64 = 32.0;
/// Most cells of the raster of masses; finer densities are averaged down to it.
pub(crate) const MASS_CELLS: usize = 4_000_000;

/// Side of the blocks of cells that are known to be even or not, in cells. A polygon is two to
/// six cells wide, so that it meets a few blocks.
const BLOCK: usize = 4;

/// Running sums along a row up to a cell's west edge.
#[derive(Clone, Copy, Default)]
struct Running {
    /// Mass, per metre of the row's width across.
    mass: f64,
    /// First moment of the mass about the raster's west edge.
    moment: f64,
}

/// A density, its square, or where it is at all: weights ready for integrals along rows.
///
/// Local coordinates run east and south from the raster's north-west corner.
pub(crate) struct Masses<'a> {
    density: &'a Grid,
    /// Factor that makes the density plants per m².
    scale: f64,
    /// Raster of masses, as coarse as need be.
    width: usize,
    height: usize,
    cell: f64,
    weights: Vec<f32>,
    /// `width + 1` sums a row.
    running: Vec<Running>,
    /// Weight of each block of [`BLOCK`] cells' side where it is the same all over; else NaN.
    even: Vec<f32>,
    /// Blocks in a row.
    blocks: usize,
}

impl<'a> Masses<'a> {
    /// Sums up a density in plants per m², or in any unit if it is to hold `count` plants.
    pub(crate) fn new(density: &'a Grid, count: Option<usize>, by: Weight) -> Self {
        let frame = density.frame;
        let factor = ((frame.len() as f64 / MASS_CELLS as f64).sqrt().ceil() as usize).max(1);
        let (width, height) = (frame.width.div_ceil(factor), frame.height.div_ceil(factor));
        let cell = frame.cell * factor as f64;
        let mut weights = vec![0.0f32; width * height];
        weights.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
            for (column, weight) in line.iter_mut().enumerate() {
                let mean = block_mean(density, factor, column, row);
                *weight = match by {
                    Weight::Even => f32::from(u8::from(mean > 0.0)),
                    Weight::Density => mean,
                    Weight::Squared => mean * mean,
                };
            }
        });
        let mut running = vec![Running::default(); (width + 1) * height];
        running.par_chunks_mut(width + 1).zip(weights.par_chunks(width.max(1))).for_each(
            |(sums, line)| {
                for (column, &weight) in line.iter().enumerate() {
                    let (from, to) = (column as f64 * cell, (column + 1) as f64 * cell);
                    let weight = f64::from(weight);
                    let last = sums[column];
                    sums[column + 1] = Running {
                        mass: last.mass + weight * cell,
                        moment: last.moment + weight * 0.5 * (to * to - from * from),
                    };
                }
            },
        );
        let (even, blocks) = even_blocks(&weights, width, height);
        let scale = count.map_or(1.0, |count| scale_to(density, count));
        Self { density, scale, width, height, cell, weights, running, even, blocks }
    }

    /// Returns the longest distance on the raster, m.
    pub(crate) fn diagonal(&self) -> f64 {
        let frame = self.density.frame;
        frame.cell * ((frame.width * frame.width + frame.height * frame.height) as f64).sqrt()
    }

    /// Returns map coordinates as local ones.
    pub(crate) fn local(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let frame = self.density.frame;
        [x - frame.west, frame.north() - y]
    }

    /// Returns local coordinates as map ones.
    pub(crate) fn on_map(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let frame = self.density.frame;
        [frame.west + u, frame.north() - v]
    }

    /// Returns the density wanted at a local place, plants per m²; 0 outside.
    pub(crate) fn density_at(&self, [u, v]: [f64; 2]) -> f64 {
        let frame = self.density.frame;
        let (column, row) = ((u / frame.cell).floor(), (v / frame.cell).floor());
        let is_inside =
            column >= 0.0 && row >= 0.0 && column < frame.width as f64 && row < frame.height as f64;
        if !is_inside {
            return 0.0;
        }
        let value = self.density.values[row as usize * frame.width + column as usize];
        f64::from(value.max(0.0)) * self.scale
    }

    /// Returns the spacing of plants at the density wanted at a place; infinite where it is 0.
    pub(crate) fn spacing(&self, place: [f64; 2]) -> f64 {
        1.0 / self.density_at(place).sqrt()
    }

    /// Returns the centre of mass of a convex polygon; `None` when it holds no mass.
    pub(crate) fn centroid(&self, polygon: &[[f64; 2]], sweep: &mut Sweep) -> Option<[f64; 2]> {
        self.mass_and_centroid(polygon, sweep).map(|(_, centre)| centre)
    }

    /// Returns the mass of a convex polygon and its centre; `None` when it holds no mass.
    ///
    /// Exact where the density is even; elsewhere sums midpoint lines, each exact along its row.
    pub(crate) fn mass_and_centroid(
        &self,
        polygon: &[[f64; 2]],
        sweep: &mut Sweep,
    ) -> Option<(f64, [f64; 2])> {
        if let Some(weight) = self.even_weight(polygon) {
            return middle(polygon).map(|(area, centre)| (weight * area, centre));
        }
        if !sweep.draw(polygon, self.cell, self.height as f64 * self.cell) {
            return None;
        }
        let (mut mass, mut moment_u, mut moment_v) = (0.0, 0.0, 0.0);
        for (line, &(from, to)) in sweep.spans.iter().enumerate().filter(|(_, s)| s.0 < s.1) {
            let v = sweep.at(line);
            let row = ((v / self.cell) as usize).min(self.height - 1);
            let (start, end) = (self.sums(row, from), self.sums(row, to));
            let along = end.mass - start.mass;
            mass += along;
            moment_u += end.moment - start.moment;
            moment_v += along * v;
        }
        let centre = [moment_u / mass, moment_v / mass];
        (mass > 0.0).then_some((mass * sweep.apart, centre))
    }

    /// Returns the mean weight along a line, from a place in each cell of its length at most.
    pub(crate) fn mean_weight(&self, from: [f64; 2], to: [f64; 2]) -> f64 {
        let along = [to[0] - from[0], to[1] - from[1]];
        let length = (along[0] * along[0] + along[1] * along[1]).sqrt();
        let count = (length / self.cell).ceil().clamp(LEAST_PLACES, MOST_PLACES);
        let weight = |index: usize| {
            let part = (index as f64 + 0.5) / count;
            self.weight_at([from[0] + part * along[0], from[1] + part * along[1]])
        };
        (0..count as usize).map(weight).sum::<f64>() / count
    }

    /// Returns the weight of the raster at a local place; 0 outside.
    fn weight_at(&self, [u, v]: [f64; 2]) -> f64 {
        let (column, row) = ((u / self.cell).floor(), (v / self.cell).floor());
        let is_inside =
            column >= 0.0 && row >= 0.0 && column < self.width as f64 && row < self.height as f64;
        if !is_inside {
            return 0.0;
        }
        f64::from(self.weights[row as usize * self.width + column as usize])
    }

    /// Returns the weight all around a polygon on the raster, where it is the same and above 0.
    fn even_weight(&self, polygon: &[[f64; 2]]) -> Option<f64> {
        let start = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        let (low, high) = polygon.iter().fold(start, |(l, h), p| {
            ([l[0].min(p[0]), l[1].min(p[1])], [h[0].max(p[0]), h[1].max(p[1])])
        });
        let (east, south) = (self.width as f64 * self.cell, self.height as f64 * self.cell);
        let is_on = low[0] >= 0.0 && low[1] >= 0.0 && high[0] < east && high[1] < south;
        if !is_on {
            return None;
        }
        let block = |length: f64| (length / self.cell) as usize / BLOCK;
        let weight = self.even[block(low[1]) * self.blocks + block(low[0])];
        let columns = block(low[0])..block(high[0]) + 1;
        let is_even = weight > 0.0
            && (block(low[1])..block(high[1]) + 1).all(|row| {
                self.even[row * self.blocks..][columns.clone()].iter().all(|even| *even == weight)
            });
        is_even.then(|| f64::from(weight))
    }

    /// Returns the sums along a row up to `u`.
    fn sums(&self, row: usize, u: f64) -> Running {
        let u = u.clamp(0.0, self.width as f64 * self.cell);
        let column = ((u / self.cell) as usize).min(self.width - 1);
        let edge = column as f64 * self.cell;
        let weight = f64::from(self.weights[row * self.width + column]);
        let before = self.running[row * (self.width + 1) + column];
        Running {
            mass: before.mass + weight * (u - edge),
            moment: before.moment + weight * 0.5 * (u * u - edge * edge),
        }
    }
}

/// Returns the factor that makes a density hold `count` plants.
fn scale_to(density: &Grid, count: usize) -> f64 {
    let rows = density.values.par_chunks(density.frame.width.max(1));
    let sums: Vec<f64> =
        rows.map(|row| row.iter().map(|value| f64::from(value.max(0.0))).sum()).collect();
    let plants = sums.iter().sum::<f64>() * density.frame.cell_area();
    if plants > 0.0 { count as f64 / plants } else { 0.0 }
}

/// Returns the mean density of a block of cells, counting those beyond the rim as empty.
fn block_mean(density: &Grid, factor: usize, column: usize, row: usize) -> f32 {
    let frame = density.frame;
    if factor == 1 {
        return density.values[row * frame.width + column].max(0.0);
    }
    let columns = column * factor..((column + 1) * factor).min(frame.width);
    let rows = row * factor..((row + 1) * factor).min(frame.height);
    let sum: f32 = rows
        .map(|r| {
            let line = &density.values[r * frame.width..][columns.clone()];
            line.iter().map(|value| value.max(0.0)).sum::<f32>()
        })
        .sum();
    sum / (factor * factor) as f32
}

/// Returns the weight of each block of cells, NaN where it varies, and the blocks in a row.
fn even_blocks(weights: &[f32], width: usize, height: usize) -> (Vec<f32>, usize) {
    let blocks = width.div_ceil(BLOCK);
    let mut even = vec![f32::NAN; blocks * height.div_ceil(BLOCK)];
    even.par_chunks_mut(blocks.max(1)).enumerate().for_each(|(row, line)| {
        let rows = row * BLOCK..((row + 1) * BLOCK).min(height);
        for (column, even) in line.iter_mut().enumerate() {
            let columns = column * BLOCK..((column + 1) * BLOCK).min(width);
            let first = weights[rows.start * width + columns.start];
            let is_first = |weight: &f32| *weight == first;
            let is_even = |r: usize| weights[r * width..][columns.clone()].iter().all(is_first);
            if rows.clone().all(is_even) {
                *even = first;
            }
        }
    });
    (even, blocks)
}

/// Returns the area of a polygon and its centre; `None` when it has no area.
fn middle(polygon: &[[f64; 2]]) -> Option<(f64, [f64; 2])> {
    // Corners are taken relative to the first one, so that far from 0 few digits cancel.
    let &[u0, v0] = polygon.first()?;
    let (mut area, mut sum_u, mut sum_v) = (0.0, 0.0, 0.0);
    for pair in polygon.windows(2) {
        let (a, b) = ([pair[0][0] - u0, pair[0][1] - v0], [pair[1][0] - u0, pair[1][1] - v0]);
        // Twice the area of the triangle to the first corner, whose centre is (a + b) / 3.
        let cross = a[0] * b[1] - a[1] * b[0];
        area += cross;
        sum_u += cross * (a[0] + b[0]);
        sum_v += cross * (a[1] + b[1]);
    }
    let centre = [u0 + sum_u / (3.0 * area), v0 + sum_v / (3.0 * area)];
    (area != 0.0).then(|| (0.5 * area.abs(), centre))
}

/// Evenly spaced lines across a convex polygon, and where each enters and leaves it.
#[derive(Default)]
pub(crate) struct Sweep {
    top: f64,
    apart: f64,
    spans: Vec<(f64, f64)>,
}

impl Sweep {
    /// Draws lines at least `finest` apart unless that were fewer than [`LEAST_LINES`], between
    /// 0 and `bottom`; says whether any line meets the polygon.
    fn draw(&mut self, polygon: &[[f64; 2]], finest: f64, bottom: f64) -> bool {
        let start = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = polygon.iter().fold(start, |(l, h), p| (l.min(p[1]), h.max(p[1])));
        let (top, bottom) = (low.max(0.0), high.min(bottom));
        if top.partial_cmp(&bottom) != Some(std::cmp::Ordering::Less) {
            return false;
        }
        let lines = ((bottom - top) / finest).ceil().max(LEAST_LINES);
        (self.top, self.apart) = (top, (bottom - top) / lines);
        self.spans.clear();
        self.spans.resize(lines as usize, start);
        let mut from = polygon[polygon.len() - 1];
        for &to in polygon {
            self.cross(from, to);
            from = to;
        }
        true
    }

    /// Widens the spans of the lines that an edge crosses.
    fn cross(&mut self, from: [f64; 2], to: [f64; 2]) {
        let (upper, lower) = if from[1] <= to[1] { (from, to) } else { (to, from) };
        // Line k lies at top + (k + 1/2) apart; casts of negative numbers give 0.
        let line = |v: f64| ((v - self.top) / self.apart + 0.5) as usize;
        let lines = line(upper[1])..line(lower[1]).min(self.spans.len());
        let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
        for index in lines {
            let u = upper[0] + (self.at(index) - upper[1]) * slope;
            let (low, high) = self.spans[index];
            self.spans[index] = (low.min(u), high.max(u));
        }
    }

    fn at(&self, index: usize) -> f64 {
        self.top + (index as f64 + 0.5) * self.apart
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Frame;

    const FRAME: Frame = Frame { width: 40, height: 40, cell: 0.25, west: 100.0, south: 200.0 };

    #[test]
    fn the_centre_of_an_even_triangle_is_the_mean_of_its_corners() {
        let grid = Grid::filled(FRAME, 3.0);
        let masses = Masses::new(&grid, Some(100), Weight::Squared);
        let corners = [[1.0, 1.0], [7.0, 2.0], [3.0, 9.0]];
        let [u, v] = masses.centroid(&corners, &mut Sweep::default()).unwrap();
        assert!((u - 11.0 / 3.0).abs() < 1e-12 && (v - 4.0).abs() < 1e-12, "{u} {v}");
        // A hair of unevenness in a far corner of each block: the sum over lines is taken.
        let grid = Grid::from_fn(FRAME, |x, y| 3.0 + 1e-5 * ((x + y) % 0.9) as f32);
        let masses = Masses::new(&grid, Some(100), Weight::Squared);
        let [u, v] = masses.centroid(&corners, &mut Sweep::default()).unwrap();
        // 32 lines across the triangle: their midpoint rule is off by less than 1/1000 of it.
        assert!((u - 11.0 / 3.0).abs() < 8e-3 && (v - 4.0).abs() < 8e-3, "{u} {v}");
    }

    #[test]
    fn mass_is_the_square_of_density() {
        // Density 1 in the west half and 2 in the east half of a rectangle: masses 1 to 4, so
        // that the centre lies at (1 · 1/4 + 4 · 3/4) / 5 = 0.65 of its width.
        let grid = Grid::from_fn(FRAME, |x, _| if x < 105.0 { 1.0 } else { 2.0 });
        let masses = Masses::new(&grid, Some(100), Weight::Squared);
        let rectangle = [[3.0, 2.0], [7.0, 2.0], [7.0, 3.0], [3.0, 3.0]];
        let [u, v] = masses.centroid(&rectangle, &mut Sweep::default()).unwrap();
        assert!((u - (3.0 + 0.65 * 4.0)).abs() < 1e-9 && (v - 2.5).abs() < 1e-9, "{u} {v}");
    }

    #[test]
    fn a_polygon_off_the_raster_or_on_empty_ground_has_no_centre() {
        let grid = Grid::from_fn(FRAME, |x, _| if x < 105.0 { 0.0 } else { 2.0 });
        let masses = Masses::new(&grid, Some(100), Weight::Squared);
        let square = |u: f64, v: f64| [[u, v], [u + 1.0, v], [u + 1.0, v + 1.0], [u, v + 1.0]];
        let mut sweep = Sweep::default();
        assert!(masses.centroid(&square(1.0, 1.0), &mut sweep).is_none());
        assert!(masses.centroid(&square(6.0, -3.0), &mut sweep).is_none());
        assert!(masses.centroid(&square(20.0, 5.0), &mut sweep).is_none());
        assert!(masses.centroid(&square(6.0, 5.0), &mut sweep).is_some());
    }

    #[test]
    fn coarser_masses_keep_the_mean() {
        let checks = |x: f64, y: f64| f32::from(u8::from(((x + y) * 4.0) as i64 % 2 == 0));
        let grid = Grid::from_fn(FRAME, checks);
        assert_eq!(block_mean(&grid, 2, 3, 5), 0.5);
        assert_eq!(block_mean(&grid, 40, 0, 0), 0.5);
    }
}
