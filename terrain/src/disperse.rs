//! Flow that spreads: the area above every cell when water may divide on its way.
//!
//! **D-infinity** [Tarboton97] sends water straight down the steepest of eight triangular facets,
//! divided between the two cells that the way passes between. **Multiple flow direction** shares it
//! among all lower neighbours by a power of their slope [Freeman91], or by slope times the contour
//! that faces them [Quinn91]. All run over a filled surface; on level ground, and where no neighbour is
//! lower, water takes the way by which the flood came, so that all of it leaves the grid.
//!
//! Cells are visited when nothing more can arrive in them, without sorting.

use crate::flow::{Flood, STEPS, neighbor};
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

fn infinite(width: usize, height: usize, flood: &Flood, amounts: Vec<f64>) -> Vec<f64> {
    let inside = |row: usize, line: &mut [u8]| facets_inside(width, row, &flood.level, line);
    let receivers = receivers(width, height, flood, inside, facet_parts);
    let level = &flood.level;
    descend(width, &receivers, amounts, |cell, receivers| {
        let is_facet = receivers.count_ones() == 2 && receivers & receivers.rotate_left(1) != 0;
        if !is_facet {
            return facet_parts(heights_above(width, height, level, cell % width, cell / width));
        }
        // Which facet it is says enough: its share is found again faster than it is kept.
        let fall = |direction: u8| level[cell] - level[neighbor(cell, direction, width)];
        let side = (receivers & SIDES).trailing_zeros() as u8;
        let corner = (receivers & !SIDES).trailing_zeros() as u8;
        let share = corner_share(fall(side), fall(corner));
        let mut parts = [0.0; 8];
        (parts[side as usize], parts[corner as usize]) = (1.0 - share, share);
        parts
    })
}

/// Bits of the four side neighbours.
const SIDES: u8 = 0b0101_0101;

/// The neighbours that the steepest ways from a row's inner cells lead to, one bit each, 0 where
/// nothing falls: without branches, so that cells share SIMD lanes.
///
/// A way goes straight to a neighbour, or between the two of a facet. The squares of all sixteen
/// slopes are compared; equally steep ways all count, as in [`facet_parts`].
fn facets_inside(width: usize, row: usize, level: &[f32], receivers: &mut [u8]) {
    falls_of_row(width, row, level, receivers, |falls| {
        let (mut straight, mut within) = ([0.0f32; 8], [0.0f32; 8]);
        let mut best = 0.0f32;
        for direction in 0..8 {
            let down = falls[direction].max(0.0);
            straight[direction] = if direction % 2 == 0 { down * down } else { 0.5 * down * down };
            best = best.max(straight[direction]);
        }
        for (facet, (side, corner)) in FACETS.into_iter().enumerate() {
            let s1 = falls[side as usize];
            let s2 = falls[corner as usize] - s1;
            let is_within = (s2 > 0.0) & (s2 < s1);
            within[facet] = if is_within { s1 * s1 + s2 * s2 } else { 0.0 };
            best = best.max(within[facet]);
        }
        let mut bits = 0u32;
        for (facet, (side, corner)) in FACETS.into_iter().enumerate() {
            bits |= if straight[facet] == best { 1 << facet } else { 0 };
            bits |= if within[facet] == best { 1 << side | 1 << corner } else { 0 };
        }
        if best > 0.0 { bits } else { 0 }
    });
}

/// The lower neighbours of a row's inner cells, one bit each.
fn lower_inside(width: usize, row: usize, level: &[f32], receivers: &mut [u8]) {
    falls_of_row(width, row, level, receivers, |falls| {
        let bit = |direction: usize| if falls[direction] > 0.0 { 1 << direction } else { 0 };
        (0..8).fold(0, |bits, direction| bits | bit(direction))
    });
}

/// Sets the inner cells of a row to what `bits` makes of how far their neighbours lie below them.
#[inline]
fn falls_of_row(
    width: usize,
    row: usize,
    level: &[f32],
    receivers: &mut [u8],
    bits: impl Fn([f32; 8]) -> u32,
) {
    let inner = width - 2;
    let line = |row: usize| &level[row * width..][..inner + 2];
    let (above, here, below) = (line(row - 1), line(row), line(row + 1));
    let receivers = &mut receivers[1..][..inner];
    for i in 0..inner {
        let z = here[i + 1];
        let neighbors = [
            here[i + 2],
            below[i + 2],
            below[i + 1],
            below[i],
            here[i],
            above[i],
            above[i + 1],
            above[i + 2],
        ];
        receivers[i] = bits(neighbors.map(|neighbor| z - neighbor)) as u8;
    }
}

/// The neighbours that every cell gives to: `inside` finds them for the inner cells of a row, `rim`
/// from the falls around one cell. Where there are none, the drain of level ground.
fn receivers(
    width: usize,
    height: usize,
    flood: &Flood,
    inside: impl Fn(usize, &mut [u8]) + Sync,
    rim: impl Fn([f32; 8]) -> [f32; 8] + Sync,
) -> Vec<u8> {
    let mut receivers = vec![0u8; flood.level.len()];
    receivers.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        let is_inner = row > 0 && row + 1 < height && width > 2;
        if is_inner {
            inside(row, line);
        }
        let stride = if is_inner { width - 1 } else { 1 };
        for column in (0..width).step_by(stride) {
            let parts = rim(heights_above(width, height, &flood.level, column, row));
            let bit = |direction: usize| u8::from(parts[direction] > 0.0) << direction;
            line[column] = (0..8).map(bit).sum();
        }
        for (column, receivers) in line.iter_mut().enumerate().filter(|(_, bits)| **bits == 0) {
            *receivers = drain(flood, row * width + column);
        }
    });
    receivers
}

/// Shares of the eight neighbours along the steepest of the facets around a cell; all 0 where none
/// falls.
///
/// Equally steep facets share evenly, where [Tarboton97] takes the first of them: on a cone this
/// keeps the eight axes alike, and takes the error of areas from 0.120 to 0.109.
fn facet_parts(falls: [f32; 8]) -> [f32; 8] {
    // Holes are NaN, and no neighbours.
    let falls = falls.map(|fall| fall.max(f32::NEG_INFINITY));
    let squares = FACETS
        .map(|(side, corner)| facet_slope_squared(falls[side as usize], falls[corner as usize]));
    let best = squares.iter().copied().fold(0.0, f32::max);
    let mut parts = [0.0f32; 8];
    if best == 0.0 {
        return parts;
    }
    let steepest = |facet: &&(u8, u8)| {
        facet_slope_squared(falls[facet.0 as usize], falls[facet.1 as usize]) == best
    };
    let count = FACETS.iter().filter(steepest).count() as f32;
    for &(side, corner) in FACETS.iter().filter(steepest) {
        let share = corner_share(falls[side as usize], falls[corner as usize]);
        parts[side as usize] += (1.0 - share) / count;
        parts[corner as usize] += share / count;
    }
    parts
}

/// Share of the corner in a facet's water, from the falls to its side and its corner: the angle
/// between side and way over that between side and corner [Tarboton97, eq. 4].
#[inline]
fn corner_share(s1: f32, total: f32) -> f32 {
    let s2 = total - s1;
    if s2 >= s1 {
        1.0
    } else if s2 > 0.0 {
        std::f32::consts::FRAC_2_PI * 2.0 * arctangent(s2 / s1)
    } else {
        0.0
    }
}

/// Arctangent of a number in 0 to 1, to 1e-7 [Abramowitz64, 4.4.49].
#[inline]
fn arctangent(x: f32) -> f32 {
    const ODD: [f32; 9] = [
        0.002_866_225_7,
        -0.016_165_737,
        0.042_909_615,
        -0.075_289_64,
        0.106_562_64,
        -0.142_089,
        0.199_935_51,
        -0.333_331_45,
        1.0,
    ];
    let square = x * x;
    x * ODD.iter().fold(0.0, |sum, factor| sum * square + factor)
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

/// Bit of the neighbour by which a cell with none lower drains; 0 if it leads off the grid.
fn drain(flood: &Flood, cell: usize) -> u8 {
    1u8.checked_shl(u32::from(flood.toward[cell])).unwrap_or(0)
}

/// Adds to every cell what all above it hold. `receivers` has a bit for each neighbour that a cell
/// gives to, and `parts` their shares where there are several, in any unit.
fn descend(
    width: usize,
    receivers: &[u8],
    mut amounts: Vec<f64>,
    parts: impl Fn(usize, u8) -> [f32; 8],
) -> Vec<f64> {
    let steps = STEPS.map(|(right, down)| down * width as isize + right);
    let mut waiting = donors(width, receivers);
    let mut ready: Vec<u32> = Vec::new();
    for start in 0..amounts.len() {
        if waiting[start] == 0 {
            ready.push(start as u32);
        }
        while let Some(cell) = ready.pop() {
            let cell = cell as usize;
            waiting[cell] = DONE;
            let amount = amounts[cell];
            let mut give = |direction: u32, part: f64| {
                let next = cell.wrapping_add_signed(steps[direction as usize & 7]);
                amounts[next] += part;
                waiting[next] -= 1;
                if waiting[next] == 0 {
                    ready.push(next as u32);
                }
            };
            let mut left = receivers[cell];
            if left.is_power_of_two() {
                give(left.trailing_zeros(), amount);
            } else if left != 0 {
                let parts = parts(cell, left);
                let sum: f64 = parts.iter().map(|part| f64::from(*part)).sum();
                let scale = amount / sum;
                while left != 0 {
                    let direction = left.trailing_zeros();
                    give(direction, f64::from(parts[direction as usize & 7]) * scale);
                    left &= left - 1;
                }
            }
        }
    }
    amounts
}

/// No cell waits for this one any more.
const DONE: u8 = 255;

/// How many neighbours give to each cell: gathered row by row, in parallel.
fn donors(width: usize, receivers: &[u8]) -> Vec<u8> {
    let height = receivers.len() / width.max(1);
    let mut donors = vec![0u8; receivers.len()];
    donors.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, donors)| {
        for (direction, (right, down)) in STEPS.into_iter().enumerate() {
            // Who gives here in this direction lies against it.
            let Some(from) = row.checked_add_signed(-down).filter(|from| *from < height) else {
                continue;
            };
            let line = &receivers[from * width..][..width];
            let (to, from) = match right {
                1 => (&mut donors[1..], &line[..width - 1]),
                -1 => (&mut donors[..width - 1], &line[1..]),
                _ => (&mut donors[..], line),
            };
            for (count, bits) in to.iter_mut().zip(from) {
                *count += (bits >> direction) & 1;
            }
        }
    });
    donors
}

/// How far each of the eight neighbours lies below a cell; -∞ where there is none.
#[inline(always)] // a call costs as much as the work
fn heights_above(
    width: usize,
    height: usize,
    level: &[f32],
    column: usize,
    row: usize,
) -> [f32; 8] {
    let cell = row * width + column;
    if column > 0 && row > 0 && column + 1 < width && row + 1 < height {
        return falls_inside(width, level, cell);
    }
    let here = level[cell];
    STEPS.map(|(right, down)| {
        match (column.checked_add_signed(right), row.checked_add_signed(down)) {
            (Some(x), Some(y)) if x < width && y < height => here - level[y * width + x],
            _ => f32::NEG_INFINITY,
        }
    })
}

/// How far each of the eight neighbours of an inner cell lies below it.
#[inline]
fn falls_inside(width: usize, level: &[f32], cell: usize) -> [f32; 8] {
    let here = level[cell];
    let line = |start: usize| -> [f32; 3] {
        let line = &level[start..start + 3];
        [here - line[0], here - line[1], here - line[2]]
    };
    let [nw, n, ne] = line(cell - width - 1);
    let [w, _, e] = line(cell - 1);
    let [sw, s, se] = line(cell + width - 1);
    [e, se, s, sw, w, nw, n, ne]
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
    amounts: Vec<f64>,
) -> Vec<f64> {
    let inside = |row: usize, line: &mut [u8]| lower_inside(width, row, &flood.level, line);
    let receivers = receivers(width, height, flood, inside, |falls| falls);
    descend(width, &receivers, amounts, |cell, _| {
        share.of(heights_above(width, height, &flood.level, cell % width, cell / width))
    })
}

/// The rule by which a cell's water is shared out.
struct Share {
    exponent: f64,
    /// Contour over distance to the power, for the eight directions.
    factors: [f32; 8],
}

impl Share {
    fn new(exponent: f64, contour: [f64; 8]) -> Self {
        let factor = |i: usize| (contour[i] / libm::pow(DISTANCE[i], exponent)) as f32;
        Self { exponent, factors: std::array::from_fn(factor) }
    }

    /// Parts for the eight neighbours, in no unit, from how far they lie below.
    #[inline]
    fn of(&self, falls: [f32; 8]) -> [f32; 8] {
        let greatest = falls.iter().copied().fold(0.0, f32::max);
        // Relative to the greatest, no power can overflow and not all of them vanish.
        let relative = falls.map(|fall| fall.max(0.0) / greatest);
        let powers = if self.exponent == 1.0 {
            relative
        } else if self.exponent == MULTIPLE_EXPONENT {
            relative.map(|fall| fall * fall.sqrt().sqrt())
        } else {
            relative.map(|fall| libm::pow(f64::from(fall), self.exponent) as f32)
        };
        std::array::from_fn(|i| powers[i] * self.factors[i])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::{OUT, fill};
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
        let parts = facet_parts(heights_above(40, 40, &flood.level, 20, 20));
        let corner = 0.5f64.atan() / std::f64::consts::FRAC_PI_4;
        assert!((f64::from(parts[1]) - corner).abs() < 1e-6 && (corner - 0.5903).abs() < 1e-4);
        assert!((parts[0] + parts[1] - 1.0).abs() < 1e-6);
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
        assert!(infinite <= 0.12, "{infinite}");
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

    #[test]
    fn the_short_arctangent_is_that_of_the_library() {
        for i in 0..=1000u16 {
            let x = f32::from(i) / 1000.0;
            assert!((arctangent(x) - libm::atanf(x)).abs() < 2e-7, "{x}");
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(48))]

        #[test]
        fn facets_of_a_row_are_those_of_its_cells(steps in 1u64..400, seed: u64) {
            let (width, height) = (23, 9);
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            for row in 1..height - 1 {
                let mut receivers = vec![0u8; width];
                facets_inside(width, row, &ground, &mut receivers);
                let inner = receivers.iter().enumerate().take(width - 1).skip(1);
                for (column, receivers) in inner {
                    let parts = facet_parts(heights_above(width, height, &ground, column, row));
                    for (direction, part) in parts.iter().enumerate() {
                        prop_assert_eq!(receivers >> direction & 1 == 1, *part > 0.0);
                    }
                }
            }
        }

        #[test]
        fn what_falls_leaves_the_grid_on_any_ground(
            width in 1usize..24,
            height in 1usize..24,
            steps in 1u64..400,
            holes in prop_oneof![Just(0.0), 0.0..0.2],
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let mut ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            let mut pierce = |z: &mut f32| *z = if stream.unit() < holes { f32::NAN } else { *z };
            ground.iter_mut().for_each(&mut pierce);
            let flood = fill(width, height, &ground);
            for dispersion in [Dispersion::Infinite, MULTIPLE, Dispersion::Quinn] {
                let area = accumulate(width, height, &flood, dispersion, vec![1.0; ground.len()]);
                let is_end = |&cell: &usize| {
                    let (column, row) = (cell % width, cell / width);
                    let falls = heights_above(width, height, &flood.level, column, row);
                    flood.toward[cell] == OUT && !falls.iter().any(|fall| *fall > 0.0)
                };
                let sum: f64 = (0..ground.len()).filter(is_end).map(|cell| area[cell]).sum();
                prop_assert!((sum - ground.len() as f64).abs() < 1e-6 * sum.max(1.0));
            }
        }
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn speed_of_dispersed_flow() {
        for side in [1024, 4096] {
            let ground = crate::flow::rough_hills(side);
            let flood = fill(side, side, &ground);
            for dispersion in [Dispersion::Infinite, MULTIPLE, Dispersion::Quinn] {
                let start = std::time::Instant::now();
                accumulate(side, side, &flood, dispersion, vec![1.0; ground.len()]);
                let rate = ground.len() as f64 / start.elapsed().as_secs_f64() / 1e6;
                println!("{side}², {dispersion:?}: {rate:.1} Mcell/s");
            }
        }
    }
}
