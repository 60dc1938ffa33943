//! How evenly plants stand and how truly they follow what is painted, beside plain methods.

mod world;

use weald_contract::{Frame, Grid, Seed};
use weald_ecosim::{Part, Relaxation, dither, relax, systematic};

/// A square of one metre a cell's width, with an expected number in each cell.
struct Painting {
    side: usize,
    expected: Vec<f32>,
}

impl Painting {
    /// Scales `value` of column and row, both 0 to 1, to hold `plants`.
    fn new(side: usize, plants: f64, value: impl Fn(f64, f64) -> f64) -> Self {
        let at = |cell: usize| {
            let along = |c: usize| (c as f64 + 0.5) / side as f64;
            value(along(cell % side), along(cell / side)).max(0.0)
        };
        let values: Vec<f64> = (0..side * side).map(at).collect();
        let scale = plants / values.iter().sum::<f64>();
        Self { side, expected: values.iter().map(|value| (value * scale) as f32).collect() }
    }

    fn grid(&self) -> Grid {
        let frame = Frame { width: self.side, height: self.side, cell: 1.0, west: 0.0, south: 0.0 };
        Grid { frame, values: self.expected.clone() }
    }

    /// Places at random in cells.
    fn places(&self, cells: &[usize], seed: u64) -> Vec<[f64; 2]> {
        let mut stream = Seed(seed).stream("jitter", 0);
        let mut place = |cell: usize| {
            let (column, row) = (cell % self.side, self.side - 1 - cell / self.side);
            [column as f64 + stream.unit(), row as f64 + stream.unit()]
        };
        cells.iter().map(|&cell| place(cell)).collect()
    }

    /// Root mean square error of counts in square boxes that expect `mean` plants on average, as
    /// a part of `mean`.
    fn count_error(&self, places: &[[f64; 2]], mean: f64) -> f64 {
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
    fn unevenness(&self, places: &[[f64; 2]]) -> f64 {
        let side = self.side as f64;
        let boxes = ((places.len() as f64).sqrt() as usize).max(1);
        let line = |c: f64| ((c / side * boxes as f64) as usize).min(boxes - 1);
        let mut bins = vec![Vec::new(); boxes * boxes];
        places.iter().for_each(|p| bins[line(p[1]) * boxes + line(p[0])].push(*p));
        let mut ratios = Vec::new();
        let margin = 4.0 * side / boxes as f64;
        for place in places.iter().filter(|p| p.iter().all(|c| (margin..side - margin).contains(c)))
        {
            let near = |c: f64| line(c).saturating_sub(4)..(line(c) + 5).min(boxes);
            let mut least = f64::INFINITY;
            for row in near(place[1]) {
                for other in near(place[0]).flat_map(|column| &bins[row * boxes + column]) {
                    let squared = (other[0] - place[0]).powi(2) + (other[1] - place[1]).powi(2);
                    if other != place {
                        least = least.min(squared);
                    }
                }
            }
            let cell = (self.side - 1 - place[1] as usize) * self.side + place[0] as usize;
            ratios.push((least * f64::from(self.expected[cell])).sqrt());
        }
        let mean = ratios.iter().sum::<f64>() / ratios.len() as f64;
        let variance = ratios.iter().map(|r| (r - mean).powi(2)).sum::<f64>() / ratios.len() as f64;
        variance.sqrt() / mean
    }
}

/// Soft blots, strokes and a hard edge, as people paint.
fn painted(u: f64, v: f64) -> f64 {
    let blot = |x: f64, y: f64, r: f64| (-((u - x).powi(2) + (v - y).powi(2)) / (r * r)).exp();
    let stroke = if (v - 0.5 - 0.2 * (6.0 * u).sin()).abs() < 0.04 { 0.7 } else { 0.0 };
    let path = if (u - 0.3 - 0.3 * v).abs() < 0.03 { 0.0 } else { 1.0 };
    (0.12 + blot(0.25, 0.3, 0.18) + 0.8 * blot(0.7, 0.7, 0.25) + stroke) * path
}

/// Floyd and Steinberg's dithering as printed: every row from the left, errors that leave the
/// picture are lost.
fn plain_diffusion(painting: &Painting) -> Vec<usize> {
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
fn white_noise(painting: &Painting) -> Vec<[f64; 2]> {
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

/// Poisson disks by dart throwing, whose radius follows the density: the count is what fits.
fn poisson_disks(painting: &Painting) -> Vec<[f64; 2]> {
    let side = painting.side as f64;
    let mut stream = Seed(5).stream("darts", 0);
    let bins = painting.side / 4;
    let bin = |c: f64| ((c / side * bins as f64) as usize).min(bins - 1);
    let mut kept: Vec<Vec<[f64; 2]>> = vec![Vec::new(); bins * bins];
    // Disks at random cover 0.547 of the plane, each of half the distance kept: the distance
    // that would give the wanted count is 0.83 spacings of a square lattice.
    for _ in 0..1_500_000 {
        let place = [side * stream.unit(), side * stream.unit()];
        let cell = (painting.side - 1 - place[1] as usize) * painting.side + place[0] as usize;
        let apart = 0.83 / f64::from(painting.expected[cell].max(1e-4)).sqrt();
        let reach = (apart / side * bins as f64).ceil() as usize;
        let near = |c: f64| bin(c).saturating_sub(reach)..(bin(c) + reach + 1).min(bins);
        let is_free = near(place[1]).all(|row| {
            near(place[0]).all(|column| {
                kept[row * bins + column].iter().all(|other| {
                    (other[0] - place[0]).powi(2) + (other[1] - place[1]).powi(2) >= apart * apart
                })
            })
        });
        if is_free {
            kept[bin(place[1]) * bins + bin(place[0])].push(place);
        }
    }
    kept.concat()
}

fn relaxed(painting: &Painting, mut places: Vec<[f64; 2]>, passes: u32) -> Vec<[f64; 2]> {
    let grid = painting.grid();
    (0..passes).for_each(|pass| relax(&mut places, &grid, &Relaxation::pass(pass, passes)));
    places
}

fn report(what: &str, painting: &Painting, places: &[[f64; 2]]) {
    println!(
        "{what}: {} plants, @64 {:.4} @256 {:.4} @1024 {:.4} cv {:.4}",
        places.len(),
        painting.count_error(places, 64.0),
        painting.count_error(places, 256.0),
        painting.count_error(places, 1024.0),
        painting.unevenness(places)
    );
}

#[test]
fn relaxed_plants_of_the_curve_follow_a_painting() {
    let picture = Painting::new(240, 4_000.0, painted);
    let cells = systematic(Part::whole(240, 240), &picture.expected);
    assert_eq!(cells.len(), 4_000);
    let places = relaxed(&picture, picture.places(&cells, 1), 10);
    let (error, spread) = (picture.count_error(&places, 256.0), picture.unevenness(&places));
    // White noise would give 1/√256 = 0.0625 and 0.52.
    assert!(error < 0.015 && spread < 0.08, "{error} {spread}");
}

#[test]
#[ignore = "measures, and prints what it measured"]
fn a_table_of_methods() {
    let cells = |painting: &Painting, is_curve: bool| {
        if is_curve {
            systematic(Part::whole(painting.side, painting.side), &painting.expected)
        } else {
            dither(painting.side, painting.expected.clone())
        }
    };
    let constant = Painting::new(223, 10_000.0, |_, _| 1.0);
    let picture = Painting::new(360, 10_000.0, painted);
    for (name, painting) in [("constant", &constant), ("painted", &picture)] {
        let plain = painting.places(&plain_diffusion(painting), 1);
        let (white, disks) = (white_noise(painting), poisson_disks(painting));
        for (method, places) in [("plain diffusion", plain), ("white", white), ("disks", disks)] {
            report(&format!("{name} {method}"), painting, &places);
        }
        for is_curve in [false, true] {
            let start = painting.places(&cells(painting, is_curve), 1);
            for passes in [0, 1, 5, 10, 20, 100] {
                let places = relaxed(painting, start.clone(), passes);
                let method = if is_curve { "curve" } else { "diffusion" };
                report(&format!("{name} {method} {passes}"), painting, &places);
            }
        }
    }
}
