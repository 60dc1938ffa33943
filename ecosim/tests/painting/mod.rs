//! A painted square, plain ways to plant it, and how evenly and truly plants stand on it.

#![allow(dead_code, reason = "the tests and the comparison with other programs use parts")]

use weald_contract::{Frame, Grid, Seed};
use weald_ecosim::{Relaxation, relax};

/// A square of one metre a cell's width, with an expected number in each cell.
pub struct Painting {
    /// Cells along a side, and metres.
    pub side: usize,
    /// Expected plants of each cell, north row first.
    pub expected: Vec<f32>,
}

impl Painting {
    /// Scales `value` of column and row, both 0 to 1, to hold `plants`.
    pub fn new(side: usize, plants: f64, value: impl Fn(f64, f64) -> f64) -> Self {
        let at = |cell: usize| {
            let along = |c: usize| (c as f64 + 0.5) / side as f64;
            value(along(cell % side), along(cell / side)).max(0.0)
        };
        let values: Vec<f64> = (0..side * side).map(at).collect();
        let scale = plants / values.iter().sum::<f64>();
        Self { side, expected: values.iter().map(|value| (value * scale) as f32).collect() }
    }

    pub fn grid(&self) -> Grid {
        let frame = Frame { width: self.side, height: self.side, cell: 1.0, west: 0.0, south: 0.0 };
        Grid { frame, values: self.expected.clone() }
    }

    /// Places at random in cells.
    pub fn places(&self, cells: &[usize], seed: u64) -> Vec<[f64; 2]> {
        let mut stream = Seed(seed).stream("jitter", 0);
        let mut place = |cell: usize| {
            let (column, row) = (cell % self.side, self.side - 1 - cell / self.side);
            [column as f64 + stream.unit(), row as f64 + stream.unit()]
        };
        cells.iter().map(|&cell| place(cell)).collect()
    }

    /// Root mean square error of counts in square boxes that expect `mean` plants on average, as
    /// a part of `mean`.
    pub fn count_error(&self, places: &[[f64; 2]], mean: f64) -> f64 {
        let total: f64 = self.expected.iter().map(|value| f64::from(*value)).sum();
        let boxes = ((total / mean).sqrt().round() as usize).max(1);
        let size = self.side as f64 / boxes as f64;
        let mut off = vec![0.0f64; boxes * boxes];
        let mut wanted = vec![0.0f64; boxes * boxes];
        let index = |x: f64, y: f64| {
            let line = |c: f64| ((c / size) as usize).min(boxes - 1);
            line(y) * boxes + line(x)
        };
        places.iter().for_each(|place| off[index(place[0], place[1])] += 1.0);
        // Four by four points a cell: boxes do not end at cells' edges.
        for (cell, value) in self.expected.iter().enumerate() {
            for part in 0..16 {
                let x = (cell % self.side) as f64 + (f64::from(part % 4) + 0.5) / 4.0;
                let y =
                    (self.side - 1 - cell / self.side) as f64 + (f64::from(part / 4) + 0.5) / 4.0;
                wanted[index(x, y)] += f64::from(*value) / 16.0;
            }
        }
        let squares: f64 = off.iter().zip(&wanted).map(|(o, w)| (o - w).powi(2)).sum();
        (squares / off.len() as f64).sqrt() / mean
    }

    /// Spread over mean of the distance to the nearest neighbour, in units of the spacing wanted
    /// there, of places away from the rim.
    pub fn unevenness(&self, places: &[[f64; 2]]) -> f64 {
        let side = self.side as f64;
        let near = Near::new(places, side);
        let margin = 4.0 * side / (places.len() as f64).sqrt();
        let is_inside = |p: &&[f64; 2]| p.iter().all(|c| (margin..side - margin).contains(c));
        let ratio = |place: &[f64; 2]| {
            let cell = (self.side - 1 - place[1] as usize) * self.side + place[0] as usize;
            (near.squared(*place, Some(*place)) * f64::from(self.expected[cell])).sqrt()
        };
        let ratios: Vec<f64> = places.iter().filter(is_inside).map(ratio).collect();
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let variance = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / ratios.len() as f64;
        variance.sqrt() / mean
    }
}

/// Soft blots, strokes and a hard edge, as people paint.
pub fn painted(u: f64, v: f64) -> f64 {
    let blot = |x: f64, y: f64, r: f64| (-((u - x).powi(2) + (v - y).powi(2)) / (r * r)).exp();
    let stroke = if (v - 0.5 - 0.2 * (6.0 * u).sin()).abs() < 0.04 { 0.7 } else { 0.0 };
    let path = if (u - 0.3 - 0.3 * v).abs() < 0.03 { 0.0 } else { 1.0 };
    (0.12 + blot(0.25, 0.3, 0.18) + 0.8 * blot(0.7, 0.7, 0.25) + stroke) * path
}

/// Floyd and Steinberg's dithering as printed: every row from the left, errors that leave the
/// picture are lost.
pub fn plain_diffusion(painting: &Painting) -> Vec<usize> {
    let side = painting.side;
    let mut values: Vec<f64> = painting.expected.iter().map(|value| f64::from(*value)).collect();
    let mut cells = Vec::new();
    for cell in 0..side * side {
        let is_lit = values[cell] >= 0.5;
        cells.extend(is_lit.then_some(cell));
        let error = values[cell] - f64::from(u8::from(is_lit));
        let (column, row) = ((cell % side) as i64, (cell / side) as i64);
        for (dx, dy, weight) in [(1, 0, 7.0), (-1, 1, 3.0), (0, 1, 5.0), (1, 1, 1.0)] {
            let (c, r) = (column + dx, row + dy);
            if (0..side as i64).contains(&c) && r < side as i64 {
                values[r as usize * side + c as usize] += error * weight / 16.0;
            }
        }
    }
    cells
}

/// As many places as are expected, each drawn from the density by itself.
pub fn white_noise(painting: &Painting) -> Vec<[f64; 2]> {
    let mut sum = 0.0;
    let running = |value: &f32| {
        sum += f64::from(*value);
        sum
    };
    let sums: Vec<f64> = painting.expected.iter().map(running).collect();
    let total = sums[sums.len() - 1];
    let mut stream = Seed(3).stream("white", 0);
    let mut draw = || {
        let wanted = stream.unit() * total;
        sums.partition_point(|sum| *sum <= wanted).min(sums.len() - 1)
    };
    let cells: Vec<usize> = (0..total.round() as usize).map(|_| draw()).collect();
    painting.places(&cells, 4)
}

pub fn relaxed(painting: &Painting, mut places: Vec<[f64; 2]>, passes: u32) -> Vec<[f64; 2]> {
    let grid = painting.grid();
    (0..passes).for_each(|pass| relax(&mut places, &grid, &Relaxation::pass(pass, passes)));
    places
}

/// Mean squared distance of the ground from the nearest plant, away from the rim of an even square,
/// as a multiple of that of a hexagonal pattern of as many plants, the least possible: 5/(18 √3)
/// of a plant's area [Gersho79].
pub fn energy(places: &[[f64; 2]], side: f64) -> f64 {
    let near = Near::new(places, side);
    let margin = 4.0 * side / (places.len() as f64).sqrt();
    let lines = 400;
    let step = (side - 2.0 * margin) / f64::from(lines);
    let along = |line: i32| margin + (f64::from(line) + 0.5) * step;
    let mut sum = 0.0;
    for row in 0..lines {
        for column in 0..lines {
            sum += near.squared([along(column), along(row)], None);
        }
    }
    let mean = sum / f64::from(lines * lines);
    let area = side * side / places.len() as f64;
    mean / (5.0 / (18.0 * 3.0f64.sqrt()) * area)
}

/// Mean power of the pattern at waves whose number across the square is between two parts of the
/// root of the number of plants; white noise has 1 everywhere.
pub fn power(places: &[[f64; 2]], side: f64, band: [f64; 2]) -> f64 {
    let root = (places.len() as f64).sqrt();
    let [low, high] = band.map(|part| part * root);
    let most = high.floor() as i32;
    let (mut sum, mut count) = (0.0, 0);
    for ky in 0..=most {
        for kx in -most..=most {
            let length = f64::from(kx * kx + ky * ky).sqrt();
            // Opposite waves have the same power: half of the plane is enough.
            if !(low..high).contains(&length) || (ky == 0 && kx <= 0) {
                continue;
            }
            let turn = std::f64::consts::TAU / side;
            let wave = |place: &[f64; 2]| {
                (turn * (f64::from(kx) * place[0] + f64::from(ky) * place[1])).sin_cos()
            };
            let (s, c) = places.iter().map(wave).fold((0.0, 0.0), |(s, c), (a, b)| (s + a, c + b));
            sum += (s * s + c * c) / places.len() as f64;
            count += 1;
        }
    }
    sum / f64::from(count)
}

/// Plants by the square of the ground in which they stand.
struct Near {
    bins: Vec<Vec<[f64; 2]>>,
    boxes: usize,
    side: f64,
}

impl Near {
    fn new(places: &[[f64; 2]], side: f64) -> Self {
        let boxes = ((places.len() as f64).sqrt() as usize).max(1);
        let mut near = Self { bins: vec![Vec::new(); boxes * boxes], boxes, side };
        for place in places {
            let bin = near.line(place[1]) * boxes + near.line(place[0]);
            near.bins[bin].push(*place);
        }
        near
    }

    fn line(&self, along: f64) -> usize {
        ((along / self.side * self.boxes as f64) as usize).min(self.boxes - 1)
    }

    /// Squared distance to the nearest plant within four squares that is not `own`.
    fn squared(&self, place: [f64; 2], own: Option<[f64; 2]>) -> f64 {
        let range =
            |along: f64| self.line(along).saturating_sub(4)..(self.line(along) + 5).min(self.boxes);
        let mut least = f64::INFINITY;
        for row in range(place[1]) {
            for bin in range(place[0]).map(|column| &self.bins[row * self.boxes + column]) {
                for other in bin.iter().filter(|other| Some(**other) != own) {
                    let squared = (other[0] - place[0]).powi(2) + (other[1] - place[1]).powi(2);
                    least = least.min(squared);
                }
            }
        }
        least
    }
}
