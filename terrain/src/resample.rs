//! Values between cells, on coarser grids, and smoothed.

use rayon::prelude::*;
use weald_contract::Frame;

/// Value at a point by cubic convolution with a = -1/2 [Keys81]: smooth, through the cells'
/// values, exact on planes; flat beyond the outermost centres.
pub fn bicubic(frame: &Frame, values: &[f32], x: f64, y: f64) -> f32 {
    let u = ((x - frame.west) / frame.cell - 0.5).clamp(0.0, (frame.width - 1) as f64);
    let v = ((frame.north() - y) / frame.cell - 0.5).clamp(0.0, (frame.height - 1) as f64);
    let (column, row) = (u as usize, v as usize);
    let across = keys_weights(u - column as f64);
    let down = keys_weights(v - row as f64);
    let mut sum = 0.0;
    for (j, weight_down) in down.iter().enumerate() {
        let row = (row + j).saturating_sub(1).min(frame.height - 1);
        let line = &values[row * frame.width..][..frame.width];
        let tap = |(i, weight): (usize, &f64)| {
            let column = (column + i).saturating_sub(1).min(frame.width - 1);
            weight * f64::from(line[column])
        };
        sum += weight_down * across.iter().enumerate().map(tap).sum::<f64>();
    }
    sum as f32
}

/// Weights of the four neighbours at distance 1 + t, t, 1 - t, 2 - t [Keys81, eq. 15].
pub fn keys_weights(t: f64) -> [f64; 4] {
    let (t2, t3) = (t * t, t * t * t);
    [
        0.5 * (-t3 + 2.0 * t2 - t),
        0.5 * (3.0 * t3 - 5.0 * t2 + 2.0),
        0.5 * (-3.0 * t3 + 4.0 * t2 + t),
        0.5 * (t3 - t2),
    ]
}

/// The values on another frame: averaged where its cells are larger, cubic where smaller.
pub fn resample(from: &Frame, values: &[f32], to: &Frame) -> Vec<f32> {
    let ratio = to.cell / from.cell;
    // A coarse cell is the mean of points no farther apart than the fine ones.
    let points = ratio.ceil().max(1.0) as usize;
    by_row(to.width, to.height, |row, line| {
        for (column, out) in line.iter_mut().enumerate() {
            let (x, y) = to.center(column, row);
            *out = if points == 1 {
                bicubic(from, values, x, y)
            } else {
                mean_around(from, values, (x, y), to.cell, points)
            };
        }
    })
}

fn mean_around(from: &Frame, values: &[f32], at: (f64, f64), side: f64, points: usize) -> f32 {
    let offset = |i: usize| ((i as f64 + 0.5) / points as f64 - 0.5) * side;
    let mut sum = 0.0;
    for j in 0..points {
        for i in 0..points {
            sum += f64::from(from.sample(values, at.0 + offset(i), at.1 + offset(j)));
        }
    }
    (sum / (points * points) as f64) as f32
}

/// Values computed a row at a time, rows in parallel.
pub fn by_row(width: usize, height: usize, row: impl Fn(usize, &mut [f32]) + Sync) -> Vec<f32> {
    let mut values = vec![0.0; width * height];
    values.par_chunks_mut(width.max(1)).enumerate().for_each(|(index, line)| row(index, line));
    values
}

/// Standard deviation in cells from which repeated means stand for a Gaussian: a lone spike is then
/// 8 % lower, smooth ground hardly differs, and the cost no longer grows with the width.
const WIDE: f64 = 12.0;

/// Largest value, in metres, and largest standard deviation, in cells, whose sums fit 64 bits:
/// 2²² m are 2⁴² parts, of which 2²⁰ are added.
const MOST: f32 = (1u32 << 22) as f32;
const WIDEST: f64 = 1e5;

fn is_wide(sigma_cells: f64) -> bool {
    (WIDE..=WIDEST).contains(&sigma_cells)
}

/// Cells within which a Gaussian of `sigma` metres is kept: three standard deviations hold 99.7 %.
pub fn gaussian_reach(sigma: f64, cell: f64) -> usize {
    if is_wide(sigma / cell) {
        return mean_reaches(sigma / cell).iter().sum();
    }
    (3.0 * sigma / cell).ceil() as usize
}

/// Gaussian smoothing with standard deviation `sigma` metres; beyond the rim the rim's values go
/// on.
pub fn gaussian(width: usize, height: usize, cell: f64, values: &[f32], sigma: f64) -> Vec<f32> {
    let is_summable = values.iter().all(|value| value.abs() <= MOST);
    if is_wide(sigma / cell) && is_summable {
        return repeated_means(width, height, values, sigma / cell);
    }
    narrow_gaussian(width, height, cell, values, sigma)
}

/// Means in a row whose variances add up: four come close to the bell.
const MEANS: usize = 4;

/// Half widths, in cells, of means over `2 reach + 1` cells that together have the variance of a
/// Gaussian as nearly as whole cells can [Kovesi10].
fn mean_reaches(sigma: f64) -> [usize; MEANS] {
    let n = MEANS as f64;
    let ideal = (12.0 * sigma * sigma / n + 1.0).sqrt();
    // The largest odd width that is not wider, and the next.
    let low = (((ideal - 1.0) * 0.5).floor()).max(0.0);
    let w = 2.0 * low + 1.0;
    let count = (12.0 * sigma * sigma - n * w * w - 4.0 * n * w - 3.0 * n) / (-4.0 * w - 4.0);
    let narrow = count.round().clamp(0.0, n) as usize;
    let mut reaches = [low as usize + 1; MEANS];
    reaches[..narrow].fill(low as usize);
    reaches
}

/// Parts of a metre in which running sums count. Whole numbers add up to the same sum wherever
/// they start, so that tiles have the bytes of the whole; 2⁻²⁰ m is finer than single precision
/// holds above 8 m.
const PARTS: f64 = (1u64 << 20) as f64;

fn repeated_means(width: usize, height: usize, values: &[f32], sigma: f64) -> Vec<f32> {
    let reaches = mean_reaches(sigma);
    let mut field: Vec<i64> =
        values.iter().map(|value| (f64::from(*value) * PARTS).round() as i64).collect();
    field.par_chunks_mut(width.max(1)).for_each(|line| {
        let mut before = vec![0; line.len()];
        for reach in reaches {
            before.copy_from_slice(line);
            means_along(&before, reach, line);
        }
    });
    // Columns are rows of the turned field.
    let mut turned = turn(width, height, &field);
    turned.par_chunks_mut(height.max(1)).for_each(|line| {
        let mut before = vec![0; line.len()];
        for reach in reaches {
            before.copy_from_slice(line);
            means_along(&before, reach, line);
        }
    });
    by_row(width, height, |row, out| {
        for (column, out) in out.iter_mut().enumerate() {
            *out = (turned[column * height + row] as f64 / PARTS) as f32;
        }
    })
}

fn turn(width: usize, height: usize, field: &[i64]) -> Vec<i64> {
    let mut turned = vec![0; field.len()];
    turned.par_chunks_mut(height.max(1)).enumerate().for_each(|(column, line)| {
        for (row, out) in line.iter_mut().enumerate() {
            *out = field[row * width + column];
        }
    });
    turned
}

/// Means over `2 reach + 1` cells, rounded to whole parts; the ends go on beyond the line.
fn means_along(line: &[i64], reach: usize, out: &mut [i64]) {
    let Some(last) = line.len().checked_sub(1) else { return };
    let at = |index: isize| line[index.clamp(0, last as isize) as usize];
    let reach = reach as isize;
    let count = 2 * reach as i64 + 1;
    let mut sum: i64 = (-reach..=reach).map(at).sum();
    for (index, out) in out.iter_mut().enumerate() {
        // Rounded halves up, also below 0.
        *out = (2 * sum + count).div_euclid(2 * count);
        sum += at(index as isize + reach + 1) - at(index as isize - reach);
    }
}

fn narrow_gaussian(width: usize, height: usize, cell: f64, values: &[f32], sigma: f64) -> Vec<f32> {
    let reach = gaussian_reach(sigma, cell).min(width.max(height));
    if reach == 0 {
        return values.to_vec();
    }
    let weights = gaussian_weights(reach, sigma / cell);
    let across = by_row(width, height, |row, out| {
        let line = &values[row * width..][..width];
        for (column, out) in out.iter_mut().enumerate() {
            let tap = |(i, weight): (usize, &f64)| {
                let from = (column + i).saturating_sub(reach).min(width - 1);
                weight * f64::from(line[from])
            };
            *out = weights.iter().enumerate().map(tap).sum::<f64>() as f32;
        }
    });
    by_row(width, height, |row, out| {
        let mut sums = vec![0.0f64; width];
        for (i, weight) in weights.iter().enumerate() {
            let from = (row + i).saturating_sub(reach).min(height - 1);
            let line = &across[from * width..][..width];
            sums.iter_mut().zip(line).for_each(|(sum, value)| *sum += weight * f64::from(*value));
        }
        out.iter_mut().zip(sums).for_each(|(out, sum)| *out = sum as f32);
    })
}

/// Weights at -reach..=reach cells, of sum 1.
fn gaussian_weights(reach: usize, sigma_cells: f64) -> Vec<f64> {
    let bell = |i: usize| {
        let distance = i as f64 - reach as f64;
        libm::exp(-0.5 * (distance / sigma_cells) * (distance / sigma_cells))
    };
    let bells: Vec<f64> = (0..=2 * reach).map(bell).collect();
    let sum: f64 = bells.iter().sum();
    bells.iter().map(|bell| bell / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { width: 12, height: 10, cell: 2.0, west: 100.0, south: 50.0 };

    fn plane(frame: &Frame) -> Vec<f32> {
        let z = |i: usize| {
            let (x, y) = frame.center(i % frame.width, i / frame.width);
            (0.5 * x - 0.25 * y) as f32
        };
        (0..frame.len()).map(z).collect()
    }

    #[test]
    fn bicubic_values_pass_through_cells_and_lie_on_planes() {
        let values = plane(&FRAME);
        assert_eq!(bicubic(&FRAME, &values, 105.0, 57.0), (52.5 - 14.25) as f32);
        for (x, y) in [(105.3, 57.9), (110.0, 60.0), (118.2, 64.4)] {
            let expected = 0.5 * x - 0.25 * y;
            assert!((f64::from(bicubic(&FRAME, &values, x, y)) - expected).abs() < 1e-5);
        }
    }

    #[test]
    fn a_plane_stays_a_plane_on_coarser_and_finer_grids() {
        for cell in [0.5, 4.0] {
            let (width, height) = ((24.0 / cell) as usize, (20.0 / cell) as usize);
            let to = Frame { width, height, cell, ..FRAME };
            let resampled = resample(&FRAME, &plane(&FRAME), &to);
            let inner = |i: &usize| {
                let (x, y) = to.center(i % width, i / width);
                (104.0..=120.0).contains(&x) && (54.0..=66.0).contains(&y)
            };
            for i in (0..to.len()).filter(inner) {
                assert!((resampled[i] - plane(&to)[i]).abs() < 1e-4, "cell {cell}");
            }
        }
    }

    #[test]
    fn smoothing_a_spike_gives_the_gaussian_and_keeps_its_volume() {
        let (size, sigma) = (61, 4.0);
        let mut spike = vec![0.0f32; size * size];
        spike[30 * size + 30] = 1000.0;
        let smooth = gaussian(size, size, 1.0, &spike, sigma);
        let sum: f64 = smooth.iter().map(|&v| f64::from(v)).sum();
        assert!((sum - 1000.0).abs() < 0.01);
        let expected = |d2: f64| 1000.0 / (std::f64::consts::TAU * 16.0) * (-d2 / 32.0).exp();
        for (dx, dy) in [(0, 0), (4, 0), (3, 5)] {
            let got = f64::from(smooth[(30 + dy) * size + 30 + dx]);
            let exact = expected((dx * dx + dy * dy) as f64);
            // Cutting at three standard deviations moves 0.3 % of the weight inwards, twice.
            assert!((got / exact - 1.0).abs() < 0.007, "{got} {exact}");
        }
    }

    #[test]
    fn repeated_means_are_a_gaussian_that_costs_the_same_at_any_width() {
        let (size, sigma) = (181, 14.3);
        let mut spike = vec![0.0f32; size * size];
        spike[90 * size + 90] = 1e6;
        let wide = gaussian(size, size, 1.0, &spike, sigma);
        let exact = narrow_gaussian(size, size, 1.0, &spike, sigma);
        let peak = exact.iter().copied().fold(0.0, f32::max);
        let worst = wide.iter().zip(&exact).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        // Four means have a kurtosis of 3 - 1.2 / 4, which takes 3.75 % off a peak, along both axes.
        assert!(worst < 0.09 * peak, "{worst} of {peak}");
        let sum: f64 = wide.iter().map(|v| f64::from(*v)).sum();
        assert!((sum / 1e6 - 1.0).abs() < 1e-3, "{sum}");
        let second = |values: &[f32]| {
            let moment = |(i, v): (usize, &f32)| f64::from(*v) * ((i % size) as f64 - 90.0).powi(2);
            values.iter().enumerate().map(moment).sum::<f64>() / 1e6
        };
        assert!((second(&wide) / (sigma * sigma) - 1.0).abs() < 0.03, "{}", second(&wide));
    }

    #[test]
    fn repeated_means_of_a_tile_with_its_halo_have_the_bytes_of_the_whole() {
        let (width, height) = (260, 3);
        let mut stream = weald_contract::Seed(2).stream("ground", 0);
        let values: Vec<f32> =
            (0..width * height).map(|_| 300.0 + 40.0 * stream.unit() as f32).collect();
        let whole = gaussian(width, height, 1.0, &values, 13.0);
        let reach = gaussian_reach(13.0, 1.0);
        let (from, to) = (100 - reach, 140 + reach);
        let tile: Vec<f32> =
            values.chunks(width).flat_map(|row| row[from..to].iter().copied()).collect();
        let part = gaussian(to - from, height, 1.0, &tile, 13.0);
        for row in 0..height {
            let inner = &part[row * (to - from) + reach..][..40];
            assert_eq!(inner, &whole[row * width + 100..][..40]);
        }
    }
}
