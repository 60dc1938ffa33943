//! Flow that spreads: the area above every cell when water may divide on its way.
//!
//! **D-infinity** [Tarboton97] sends water straight down the steepest of eight triangular facets,
//! divided between the two cells that the way passes between. **Multiple flow direction** shares it
//! among all lower neighbours by a power of their slope [Freeman91], or by slope times the contour
//! that faces them [Quinn91]. All run over a filled surface; on level ground, and where no neighbour is
//! lower, water takes the way by which the flood came, so that all of it leaves the grid.
//!
//! Cells are visited when nothing more can arrive in them, without sorting.

use crate::flow::{Flood, OUT, STEPS, neighbor};
use rayon::prelude::*;

/// How water divides.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Dispersion {
    /// Between two neighbours, along the steepest way down [Tarboton97].
    Infinite,
    /// Among all lower neighbours, by this power of the slope [Freeman91].
    Multiple {
        /// The exponent; 1 spreads most.
        exponent: f64,
    },
    /// Among all lower neighbours, by slope times length of contour [Quinn91].
    Quinn,
}

/// Exponent of multiple flow. Freeman found 1.1 best on a cone; on ours, of 65 × 65 cells, areas are
/// off by 0.113 (root mean square) with 1.1 and by 0.10 with 1.25, whose power needs two roots only.
pub const MULTIPLE_EXPONENT: f64 = 1.25;

/// Adds to every cell what runs down to it from above.
///
/// `amounts` of 1 give numbers of cells; nothing is lost: what arrives at cells that drain off
/// the grid is what there was, to rounding.
pub fn accumulate(
    width: usize,
    height: usize,
    flood: &Flood,
    dispersion: Dispersion,
    amounts: Vec<f64>,
) -> Vec<f64> {
    match dispersion {
        Dispersion::Infinite => infinite(width, height, flood, amounts),
        Dispersion::Multiple { exponent } => {
            multiple(width, height, flood, &Share::new(exponent, [1.0; 8]), amounts)
        }
        Dispersion::Quinn => multiple(width, height, flood, &Share::new(1.0, CONTOUR), amounts),
    }
}

/// Facets counted from east, clockwise: the side neighbour and the corner neighbour of each, as
/// direction codes.
const FACETS: [(u8, u8); 8] = [(0, 1), (2, 1), (2, 3), (4, 3), (4, 5), (6, 5), (6, 7), (0, 7)];

/// Where a cell's water goes under D-infinity.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Way {
    /// The facet, or 8 plus a direction for all of it into one neighbour, 16 for off the grid.
    code: u8,
    /// Share of the corner neighbour.
    corner: f32,
}

const STRAIGHT: u8 = 8;
const GONE: u8 = STRAIGHT + OUT;

fn infinite(width: usize, height: usize, flood: &Flood, mut amounts: Vec<f64>) -> Vec<f64> {
    let mut codes = vec![GONE; amounts.len()];
    let mut corners = vec![0.0f32; amounts.len()];
    let rows = codes.par_chunks_mut(width.max(1)).zip(corners.par_chunks_mut(width.max(1)));
    rows.enumerate().for_each(|(row, (codes, corners))| {
        for (column, (code, corner)) in codes.iter_mut().zip(corners).enumerate() {
            let way = steepest_way(width, height, flood, column, row);
            (*code, *corner) = (way.code, way.corner);
        }
    });
    let mut waiting = vec![0u8; amounts.len()];
    for (cell, &code) in codes.iter().enumerate() {
        let (first, second) = receivers(code);
        for direction in [first, second].into_iter().filter(|direction| *direction < OUT) {
            waiting[neighbor(cell, direction, width)] += 1;
        }
    }
    let mut ready = Vec::new();
    for start in 0..amounts.len() {
        if waiting[start] == 0 {
            ready.push(start);
        }
        while let Some(cell) = ready.pop() {
            waiting[cell] = DONE;
            let (first, second) = receivers(codes[cell]);
            // What the corner does not take goes to the side: nothing is lost to rounding.
            let corner = amounts[cell] * f64::from(corners[cell]);
            let shares = [(first, amounts[cell] - corner), (second, corner)];
            for (direction, share) in shares.into_iter().filter(|(to, _)| *to < OUT) {
                let next = neighbor(cell, direction, width);
                amounts[next] += share;
                waiting[next] -= 1;
                if waiting[next] == 0 {
                    ready.push(next);
                }
            }
        }
    }
    amounts
}

/// No cell waits for this one any more.
const DONE: u8 = 255;

/// Directions that a way leads to; [`OUT`] for none.
fn receivers(code: u8) -> (u8, u8) {
    match FACETS.get(code as usize) {
        Some(&facet) => facet,
        None => (code - STRAIGHT, OUT),
    }
}

/// The steepest way down over the eight facets around a cell.
fn steepest_way(width: usize, height: usize, flood: &Flood, column: usize, row: usize) -> Way {
    let cell = row * width + column;
    let falls = heights_above(width, height, &flood.level, column, row);
    let sides = FACETS.map(|(side, _)| falls[side as usize]);
    let corners = FACETS.map(|(_, corner)| falls[corner as usize]);
    let mut squares = [0.0f32; 8];
    // Without branches, so that facets share SIMD lanes.
    for facet in 0..8 {
        squares[facet] = facet_slope_squared(sides[facet], corners[facet]);
    }
    let mut best = 0;
    for facet in 1..8 {
        if squares[facet] > squares[best] {
            best = facet;
        }
    }
    if squares[best] == 0.0 {
        return Way { code: STRAIGHT + flood.toward[cell], corner: 0.0 };
    }
    let (s1, s2) = (sides[best], corners[best] - sides[best]);
    let (side, corner) = FACETS[best];
    if s1 > 0.0 && s2 > 0.0 && s2 < s1 {
        let angle = libm::atanf(s2 / s1);
        return Way { code: best as u8, corner: angle * std::f32::consts::FRAC_2_PI * 2.0 };
    }
    let straight = if s2 >= s1 { corner } else { side };
    Way { code: STRAIGHT + straight, corner: 0.0 }
}

/// Square of the steepest slope within a facet, from the falls to its side and its corner
/// neighbour; 0 where it rises.
#[inline]
fn facet_slope_squared(s1: f32, total: f32) -> f32 {
    // s1 down to the side, s2 on from there to the corner.
    let s2 = total - s1;
    let (down, across) = (s1.max(0.0), total.max(0.0));
    let straight = if s2 >= s1 { 0.5 * across * across } else { down * down };
    if s2 > 0.0 && s2 < s1 { s1 * s1 + s2 * s2 } else { straight }
}

/// How far each of the eight neighbours lies below a cell; -∞ where there is none.
#[inline]
fn heights_above(
    width: usize,
    height: usize,
    level: &[f32],
    column: usize,
    row: usize,
) -> [f32; 8] {
    let cell = row * width + column;
    let here = level[cell];
    if column > 0 && row > 0 && column + 1 < width && row + 1 < height {
        let line = |start: usize| -> [f32; 3] {
            let line = &level[start..start + 3];
            [here - line[0], here - line[1], here - line[2]]
        };
        let [nw, n, ne] = line(cell - width - 1);
        let [w, _, e] = line(cell - 1);
        let [sw, s, se] = line(cell + width - 1);
        return [e, se, s, sw, w, nw, n, ne];
    }
    STEPS.map(|(right, down)| {
        match (column.checked_add_signed(right), row.checked_add_signed(down)) {
            (Some(x), Some(y)) if x < width && y < height => here - level[y * width + x],
            _ => f32::NEG_INFINITY,
        }
    })
}

/// Distance to the eight neighbours, in cells.
const DISTANCE: [f64; 8] = {
    const D: f64 = std::f64::consts::SQRT_2;
    [1.0, D, 1.0, D, 1.0, D, 1.0, D]
};

/// Length of contour that faces the four sides and the four corners, in cells [Quinn91, fig. 3].
const CONTOUR: [f64; 8] = {
    const CORNER: f64 = 0.25 * std::f64::consts::SQRT_2;
    [0.5, CORNER, 0.5, CORNER, 0.5, CORNER, 0.5, CORNER]
};

fn multiple(
    width: usize,
    height: usize,
    flood: &Flood,
    share: &Share,
    mut amounts: Vec<f64>,
) -> Vec<f64> {
    let mut waiting = donors(width, height, flood);
    let mut ready = Vec::new();
    for start in 0..amounts.len() {
        if waiting[start] == 0 {
            ready.push(start);
        }
        while let Some(cell) = ready.pop() {
            waiting[cell] = DONE;
            let shares = share.of(width, height, flood, cell);
            let sum: f64 = shares.iter().sum();
            let amount = amounts[cell];
            let mut give = |direction: u8, part: f64| {
                let next = neighbor(cell, direction, width);
                amounts[next] += part;
                waiting[next] -= 1;
                if waiting[next] == 0 {
                    ready.push(next);
                }
            };
            if sum > 0.0 {
                let scale = amount / sum;
                for (direction, share) in shares.iter().enumerate().filter(|(_, s)| **s > 0.0) {
                    give(direction as u8, share * scale);
                }
            } else if flood.toward[cell] < OUT {
                give(flood.toward[cell], amount);
            }
        }
    }
    amounts
}

/// The rule by which a cell's water is shared out.
struct Share {
    exponent: f64,
    /// Contour over distance to the power, for the eight directions.
    factors: [f64; 8],
}

impl Share {
    fn new(exponent: f64, contour: [f64; 8]) -> Self {
        let factor = |i: usize| contour[i] / libm::pow(DISTANCE[i], exponent);
        Self { exponent, factors: std::array::from_fn(factor) }
    }

    /// Parts for the eight neighbours, in no unit; all 0 where none is lower.
    #[inline]
    fn of(&self, width: usize, height: usize, flood: &Flood, cell: usize) -> [f64; 8] {
        let (column, row) = (cell % width, cell / width);
        let falls = heights_above(width, height, &flood.level, column, row);
        let greatest = falls.iter().copied().fold(0.0, f32::max);
        if greatest == 0.0 {
            return [0.0; 8];
        }
        // Relative to the greatest, no power can overflow and not all of them vanish.
        let scale = 1.0 / f64::from(greatest);
        let relative = falls.map(|fall| f64::from(fall.max(0.0)) * scale);
        let powers = if self.exponent == 1.0 {
            relative
        } else if self.exponent == MULTIPLE_EXPONENT {
            relative.map(|fall| fall * fall.sqrt().sqrt())
        } else {
            relative.map(|fall| libm::pow(fall, self.exponent))
        };
        std::array::from_fn(|i| powers[i] * self.factors[i])
    }
}

/// How many neighbours send water to each cell.
fn donors(width: usize, height: usize, flood: &Flood) -> Vec<u8> {
    let mut waiting = vec![0u8; flood.level.len()];
    waiting.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        for (column, count) in line.iter_mut().enumerate() {
            let falls = heights_above(width, height, &flood.level, column, row);
            let is_donor = |fall: &f32| *fall < 0.0 && *fall > f32::NEG_INFINITY;
            let higher: u8 = falls.iter().map(|fall| u8::from(is_donor(fall))).sum();
            let is_lowest = falls.iter().all(|fall| *fall <= 0.0);
            *count = higher | if is_lowest { LOWEST } else { 0 };
        }
    });
    // Level ground drains where the flood came from.
    for cell in 0..waiting.len() {
        if waiting[cell] & LOWEST != 0 && flood.toward[cell] < OUT {
            waiting[neighbor(cell, flood.toward[cell], width)] += 1;
        }
    }
    waiting.par_iter_mut().for_each(|count| *count &= !LOWEST);
    waiting
}

/// Mark of a cell with no lower neighbour, above all counts.
const LOWEST: u8 = 64;

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::fill;
    use proptest::prelude::*;

    const MULTIPLE: Dispersion = Dispersion::Multiple { exponent: MULTIPLE_EXPONENT };

    fn grid(width: usize, height: usize, z: impl Fn(usize, usize) -> f64) -> Vec<f32> {
        (0..width * height).map(|i| z(i % width, i / width) as f32).collect()
    }

    fn area(width: usize, height: usize, ground: &[f32], dispersion: Dispersion) -> Vec<f64> {
        let flood = fill(width, height, ground);
        accumulate(width, height, &flood, dispersion, vec![1.0; ground.len()])
    }

    #[test]
    fn on_planes_d_infinity_is_exact() {
        let east = area(40, 20, &grid(40, 20, |x, _| -2.0 * x as f64), Dispersion::Infinite);
        assert!(east.iter().enumerate().all(|(i, a)| (a - (i % 40 + 1) as f64).abs() < 1e-9));
        let ground = grid(40, 40, |x, y| -(x as f64) - y as f64);
        let diagonal = area(40, 40, &ground, Dispersion::Infinite);
        for (x, y) in (0..39).flat_map(|x| (0..39).map(move |y| (x, y))) {
            assert!((diagonal[y * 40 + x] - (x.min(y) + 1) as f64).abs() < 1e-9);
        }
        // Falling by 2 to the east and 1 to the south: 0.5903 of the angle lies towards the corner.
        let ground = grid(40, 40, |x, y| -2.0 * x as f64 - y as f64);
        let flood = fill(40, 40, &ground);
        let way = steepest_way(40, 40, &flood, 20, 20);
        let corner = 0.5f64.atan() / std::f64::consts::FRAC_PI_4;
        assert!((f64::from(way.corner) - corner).abs() < 1e-6 && (corner - 0.5903).abs() < 1e-4);
        assert_eq!(receivers(way.code), (0, 1));
        let area = accumulate(40, 40, &flood, Dispersion::Infinite, vec![1.0; 1600]);
        // Away from the rims every column passes on all that came: x + 1.
        for (x, y) in (0..38).flat_map(|x| (x + 1..39).map(move |y| (x, y))) {
            assert!((area[y * 40 + x] - (x + 1) as f64).abs() < 1e-4, "{x} {y}");
        }
    }

    /// Root mean square of the relative error of specific area for 5 < r < 28 on 65 × 65 cells.
    fn cone_error(slope: f64, exact: impl Fn(f64) -> f64, dispersion: Dispersion) -> f64 {
        let radius = |x: usize, y: usize| f64::hypot(x as f64 - 32.0, y as f64 - 32.0);
        let ground = grid(65, 65, |x, y| 100.0 + slope * radius(x, y));
        let area = area(65, 65, &ground, dispersion);
        let errors: Vec<f64> = (0..area.len())
            .map(|i| (area[i], radius(i % 65, i / 65)))
            .filter(|(_, r)| *r > 5.0 && *r < 28.0)
            .map(|(area, r)| (area / exact(r) - 1.0).powi(2))
            .collect();
        (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
    }

    #[test]
    fn on_a_cone_specific_area_is_half_the_radius() {
        // Above a ring of radius r lies π r², through 2 π r of contour: r / 2.
        let infinite = cone_error(-1.0, |r| r / 2.0, Dispersion::Infinite);
        let multiple = cone_error(-1.0, |r| r / 2.0, MULTIPLE);
        // The same method elsewhere is 0.12 off, to two digits; ours is the method as published.
        assert!(infinite < 0.125, "{infinite}");
        assert!(multiple <= 0.11, "{multiple}");
    }

    #[test]
    fn in_a_funnel_specific_area_is_that_of_the_ring_outside() {
        // Inside a ridge of radius R, π (R² - r²) lies above 2 π r of contour.
        let (ridge, middle) = (32.0, 32 * 65 + 32);
        let radius = |x: usize, y: usize| f64::hypot(x as f64 - 32.0, y as f64 - 32.0);
        let level = grid(65, 65, |x, y| ridge - (ridge - radius(x, y)).abs());
        // Not filled: the middle swallows what arrives.
        let flood = Flood { toward: vec![OUT; level.len()], level };
        let error = |dispersion| {
            let area = accumulate(65, 65, &flood, dispersion, vec![1.0; 65 * 65]);
            assert!(area[middle] > 3000.0);
            let errors: Vec<f64> = (0..area.len())
                .map(|i| (area[i], radius(i % 65, i / 65)))
                .filter(|(_, r)| *r > 5.0 && *r < 28.0)
                .map(|(area, r)| (area / ((ridge * ridge - r * r) / (2.0 * r)) - 1.0).powi(2))
                .collect();
            (errors.iter().sum::<f64>() / errors.len() as f64).sqrt()
        };
        assert!(error(MULTIPLE) <= 0.11, "{}", error(MULTIPLE));
        // Converging ways of one or two cells leave stripes.
        assert!(error(Dispersion::Infinite) <= 0.19, "{}", error(Dispersion::Infinite));
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn what_falls_leaves_the_grid_on_any_ground(
            width in 1usize..24,
            height in 1usize..24,
            steps in 1u64..400,
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            let flood = fill(width, height, &ground);
            for dispersion in [Dispersion::Infinite, MULTIPLE, Dispersion::Quinn] {
                let area = accumulate(width, height, &flood, dispersion, vec![1.0; ground.len()]);
                let is_end = |&cell: &usize| {
                    let (column, row) = (cell % width, cell / width);
                    let falls = heights_above(width, height, &flood.level, column, row);
                    flood.toward[cell] == OUT && falls.iter().all(|fall| *fall <= 0.0)
                };
                let sum: f64 = (0..ground.len()).filter(is_end).map(|cell| area[cell]).sum();
                prop_assert!((sum - ground.len() as f64).abs() < 1e-6 * sum.max(1.0));
            }
        }
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn speed_of_dispersed_flow() {
        let side = 1024;
        let ground = crate::flow::rough_hills(side);
        let flood = fill(side, side, &ground);
        for dispersion in [Dispersion::Infinite, MULTIPLE, Dispersion::Quinn] {
            let start = std::time::Instant::now();
            accumulate(side, side, &flood, dispersion, vec![1.0; ground.len()]);
            let rate = ground.len() as f64 / start.elapsed().as_secs_f64() / 1e6;
            println!("{dispersion:?}: {rate:.1} Mcell/s");
        }
    }
}
