//! Erosion: streams that cut down, slopes that creep, rock that falls.
//!
//! **Streams** lower their bed by `K Aᵐ Sⁿ` a year, A being the area above and S the slope: the
//! stream power law. It is solved implicitly from the mouth upwards, where each cell needs only the
//! new height of the next one down, so that any step of time is stable [Braun13]. Water in hollows
//! leaves over their outlets; beds there wait until the outlet is low enough. **Slopes** creep as
//! heat spreads [Culling60]. **Falling rock** rests at its angle of repose [Musgrave89].

use crate::area;
use crate::flow::{self, OUT, STEPS};
use crate::lattice::Lattice;
use crate::resample::{by_row, gaussian};
use weald_contract::table;

table! {
    /// Hydraulic erosion: streams cut down, slopes creep.
    pub struct Erode {
        /// Time, years.
        years: f64 = 100000.0, in 0.0..=1e9;
        /// Steps in which drainage is found anew.
        steps: u32 = 20, in 1.0..=10000.0;
        /// Erodibility K, in m^(1 - 2m) per year.
        erodibility: f64 = 5e-6, in 0.0..=1.0;
        /// Exponent m of the area above.
        area_exponent: f64 = 0.5, in 0.0..=2.0;
        /// Exponent n of the slope.
        slope_exponent: f64 = 1.0, in 0.1..=4.0;
        /// Rise of the ground, m per year; the terrain's rim stays.
        uplift: f64 = 0.0, in 0.0..=1.0;
        /// Creep of slopes, m2 per year.
        diffusion: f64 = 0.001, in 0.0..=100.0;
    }
}

table! {
    /// Thermal erosion: what is steeper than rock and soil can stand slides down.
    pub struct Thermal {
        /// Angle of repose, degrees.
        repose_deg: f64 = 35.0, in 1.0..=89.0;
        /// Passes; rock moves by a cell in each.
        passes: u32 = 50, in 1.0..=10000.0;
    }
}

/// Distance to each neighbour, in cells.
const DISTANCE: [f64; 8] = {
    const D: f64 = std::f64::consts::SQRT_2;
    [1.0, D, 1.0, D, 1.0, D, 1.0, D]
};

impl Erode {
    /// The ground after the whole time.
    pub(crate) fn run(&self, lattice: &Lattice, altitude: &[f32]) -> Vec<f32> {
        let mut ground = altitude.to_vec();
        let years = self.years / f64::from(self.steps);
        for _ in 0..self.steps {
            self.cut(lattice, &mut ground, years);
            ground = creep(lattice, &ground, self.diffusion * years);
        }
        ground
    }

    /// One step of streams, from their mouths upwards.
    fn cut(&self, lattice: &Lattice, ground: &mut [f32], years: f64) {
        let Lattice { width, height, cell, .. } = *lattice;
        let mut flood = flow::fill(width, height, ground);
        flow::drain_through_floors(width, ground, &mut flood);
        let directions = flow::directions(width, height, &flood);
        let cells = area::drained_cells(width, &directions);
        let order = flow::upstream_first(width, &directions);
        for here in order.into_iter().rev().map(|here| here as usize) {
            let direction = directions[here];
            if direction >= OUT {
                continue;
            }
            let next = f64::from(ground[flow::neighbor(here, direction, width)]);
            let risen = f64::from(ground[here]) + self.uplift * years;
            let area = f64::from(cells[here]) * cell * cell;
            let distance = DISTANCE[direction as usize & 7] * cell;
            let power = self.erodibility * years * libm::pow(area, self.area_exponent);
            ground[here] = self.lowered(risen, next, power, distance) as f32;
        }
    }

    /// Solves `h + power ((h - next) / distance)ⁿ = risen` for h.
    fn lowered(&self, risen: f64, next: f64, power: f64, distance: f64) -> f64 {
        if risen <= next {
            return risen;
        }
        if self.slope_exponent == 1.0 {
            let ratio = power / distance;
            return (risen + ratio * next) / (1.0 + ratio);
        }
        // Newton's method on the fall; the bracket keeps it between level and unchanged.
        let n = self.slope_exponent;
        let (mut low, mut high) = (0.0, risen - next);
        let mut fall = high;
        for _ in 0..NEWTON_STEPS {
            let slope = fall / distance;
            let excess = fall + power * libm::pow(slope, n) - (risen - next);
            if excess > 0.0 {
                high = fall
            } else {
                low = fall
            }
            let steepness = 1.0 + power * n / distance * libm::pow(slope, n - 1.0);
            let newton = fall - excess / steepness;
            let is_inside = newton > low && newton < high;
            fall = if is_inside { newton } else { 0.5 * (low + high) };
        }
        next + fall
    }
}

/// Steps that bring the fall to the last digits of single precision, by bisection alone if need be.
const NEWTON_STEPS: u32 = 24;

/// Above this share of a cell's area, diffusion in one explicit step would be crude.
const EXPLICIT_LIMIT: f64 = 0.2;

/// Ground after diffusion, whose product of coefficient and time is `amount` m².
///
/// Diffusion is Gaussian smoothing with the variance `2 amount`; where that is less than a cell
/// shows, one explicit step is closer.
fn creep(lattice: &Lattice, ground: &[f32], amount: f64) -> Vec<f32> {
    let Lattice { width, height, cell, .. } = *lattice;
    let share = amount / (cell * cell);
    if share > EXPLICIT_LIMIT {
        return gaussian(width, height, cell, ground, (2.0 * amount).sqrt());
    }
    by_row(width, height, |row, out| {
        let line = |row: usize| &ground[row * width..][..width];
        let (above, here, below) =
            (line(row.saturating_sub(1)), line(row), line((row + 1).min(height - 1)));
        for (column, out) in out.iter_mut().enumerate() {
            let z = f64::from(here[column]);
            let sides = [
                above[column],
                below[column],
                here[column.saturating_sub(1)],
                here[(column + 1).min(width - 1)],
            ];
            let sum: f64 = sides.iter().map(|side| f64::from(*side)).sum();
            *out = (z + share * (sum - 4.0 * z)) as f32;
        }
    })
}

/// Share of the greatest excess that moves in a pass: half levels two cells out.
const MOVED: f64 = 0.5;

impl Thermal {
    /// The ground after all passes.
    pub(crate) fn run(&self, lattice: &Lattice, altitude: &[f32]) -> Vec<f32> {
        let mut ground: Vec<f32> = altitude.to_vec();
        for _ in 0..self.passes {
            ground = self.pass(lattice, &ground);
        }
        ground
    }

    fn pass(&self, lattice: &Lattice, ground: &[f32]) -> Vec<f32> {
        let Lattice { width, height, .. } = *lattice;
        let excess = |from: usize, direction: usize| self.excess(lattice, ground, from, direction);
        // What each cell loses for each metre of excess towards a neighbour.
        let rates = by_row(width, height, |row, out| {
            for (column, out) in out.iter_mut().enumerate() {
                let all = [0, 1, 2, 3, 4, 5, 6, 7].map(|d| excess(row * width + column, d));
                let (sum, most) =
                    (all.iter().sum::<f64>(), all.iter().copied().fold(0.0, f64::max));
                *out = if sum > 0.0 { (MOVED * most / sum) as f32 } else { 0.0 };
            }
        });
        by_row(width, height, |row, out| {
            for (column, out) in out.iter_mut().enumerate() {
                let here = row * width + column;
                let mut gained = 0.0;
                for (direction, (right, down)) in STEPS.iter().enumerate() {
                    gained -= f64::from(rates[here]) * excess(here, direction);
                    let beside = (column.checked_add_signed(*right), row.checked_add_signed(*down));
                    if let (Some(x), Some(y)) = beside
                        && x < width
                        && y < height
                    {
                        let beside = y * width + x;
                        gained += f64::from(rates[beside]) * excess(beside, direction ^ 4);
                    }
                }
                *out = (f64::from(ground[here]) + gained) as f32;
            }
        })
    }

    /// How much farther a neighbour lies below a cell than the angle of repose allows, m.
    fn excess(&self, lattice: &Lattice, ground: &[f32], from: usize, direction: usize) -> f64 {
        let Lattice { width, height, cell, .. } = *lattice;
        let (right, down) = STEPS[direction];
        let (Some(x), Some(y)) =
            ((from % width).checked_add_signed(right), (from / width).checked_add_signed(down))
        else {
            return 0.0;
        };
        if x >= width || y >= height {
            return 0.0;
        }
        let fall = f64::from(ground[from]) - f64::from(ground[y * width + x]);
        let allowed = libm::tan(self.repose_deg.to_radians()) * DISTANCE[direction] * cell;
        (fall - allowed).max(0.0)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn in_steady_state_slopes_follow_the_stream_power_law() {
        // S = (U / K)^(1/n) A^(-m/n), along every channel [Braun13].
        let (width, height, cell) = (40, 30, 100.0);
        let lattice = Lattice { cell, west: 0, south: 0, width, height };
        let mut stream = weald_contract::Seed(1).stream("ground", 0);
        let start: Vec<f32> = (0..width * height).map(|_| stream.unit() as f32).collect();
        for slope_exponent in [1.0, 2.0] {
            let erode = Erode {
                years: 4e7,
                steps: 400,
                erodibility: 2e-5,
                area_exponent: 0.5 * slope_exponent,
                slope_exponent,
                uplift: 1e-3,
                diffusion: 0.0,
            };
            let erode =
                if slope_exponent == 2.0 { Erode { erodibility: 2e-7, ..erode } } else { erode };
            let ground = erode.run(&lattice, &start);
            let flood = flow::fill(width, height, &ground);
            let directions = flow::directions(width, height, &flood);
            let cells = area::drained_cells(width, &directions);
            let mut seen = 0;
            for (here, &direction) in directions.iter().enumerate().filter(|(_, d)| **d < OUT) {
                let fall = ground[here] - ground[flow::neighbor(here, direction, width)];
                assert!(fall > 0.0, "water stands at cell {here}");
                let slope = f64::from(fall) / (DISTANCE[direction as usize] * cell);
                let area = f64::from(cells[here]) * cell * cell;
                let expected =
                    (erode.uplift / erode.erodibility).powf(1.0 / slope_exponent) * area.powf(-0.5);
                // Both heights are rounded to single precision, now and in the step before.
                let rounding = f64::from(ground[here] * f32::EPSILON / fall);
                let apart = (slope / expected - 1.0).abs();
                assert!(apart < 1e-4 + 2.0 * rounding, "{slope} {expected}, rounding {rounding}");
                seen += 1;
            }
            assert!(seen > 1000);
        }
    }

    #[test]
    fn creep_smooths_a_wave_at_the_rate_of_diffusion() {
        let (width, cell, wavelength) = (128, 1.0, 32.0);
        let lattice = Lattice { cell, west: 0, south: 0, width, height: 3 };
        let waves = std::f64::consts::TAU / wavelength;
        let wave = |i: usize| (100.0 + ((i % width) as f64 * waves).cos()) as f32;
        let ground: Vec<f32> = (0..width * 3).map(wave).collect();
        for amount in [0.1, 8.0] {
            // A wave dies away as e^(-k² D t); crest at column 64.
            let height = f64::from(creep(&lattice, &ground, amount)[width + 64]) - 100.0;
            assert!((height - (-waves * waves * amount).exp()).abs() < 3e-3, "{amount}: {height}");
        }
    }

    #[test]
    fn rock_slides_to_its_angle_of_repose_and_none_is_lost() {
        let side = 41;
        let lattice = Lattice { cell: 1.0, west: 0, south: 0, width: side, height: side };
        let tower = |i: usize| {
            let (dx, dy) = ((i % side).abs_diff(20), (i / side).abs_diff(20));
            if dx <= 2 && dy <= 2 { 30.0 } else { 0.0 }
        };
        let ground: Vec<f32> = (0..side * side).map(tower).collect();
        let thermal = Thermal { repose_deg: 35.0, passes: 2000 };
        let rested = thermal.run(&lattice, &ground);
        let steepest = (0..rested.len())
            .flat_map(|from| (0..8).map(move |direction| (from, direction)))
            .map(|(from, direction)| thermal.excess(&lattice, &rested, from, direction))
            .fold(0.0, f64::max);
        assert!(steepest < 0.02, "{steepest}");
        let sum = |ground: &[f32]| ground.iter().map(|z| f64::from(*z)).sum::<f64>();
        assert!((sum(&rested) / sum(&ground) - 1.0).abs() < 1e-4);
    }
}
