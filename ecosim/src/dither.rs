//! Error diffusion: which cells of a raster hold a plant, so that counts follow the density.
//!
//! Floyd and Steinberg's dithering [Floyd76], as [Deussen98] uses it, with three changes that
//! keep the count: weights are renormalised over the neighbours that exist and may hold plants;
//! an error without such a neighbour goes to the next cell of the scan; and what rounding still
//! leaves is put right at the cells that were nearest to the other decision. Rows are scanned in
//! turn from the left and from the right, which hides the direction of the scan.

/// Returns the indices of the cells that hold a plant, rising.
///
/// `expected` gives each cell's expected number of plants, row by row; cells where it is not
/// above 0 stay empty. The number of plants is the sum rounded to the nearest whole number, and
/// at most one a cell. Where cells expect more than one plant, the surplus goes to their
/// neighbours.
///
/// # Panics
/// If `expected` does not hold whole rows of `width`.
pub fn dither(width: usize, mut expected: Vec<f32>) -> Vec<usize> {
    if expected.is_empty() {
        return Vec::new();
    }
    assert!(width > 0 && expected.len().is_multiple_of(width), "the raster has an uneven row");
    let (total, open) = totals(&expected);
    let mut cells = diffuse(width, &mut expected);
    let wanted = ((total + 0.5).floor() as usize).min(open);
    correct(&mut cells, &expected, wanted);
    cells
}

/// Returns the sum of the cells above 0, and how many they are.
fn totals(expected: &[f32]) -> (f64, usize) {
    let open = expected.iter().filter(|value| **value > 0.0);
    open.fold((0.0, 0), |(sum, count), &value| (sum + f64::from(value), count + 1))
}

/// Marks a cell that may hold no plant.
const CLOSED: f32 = f32::NEG_INFINITY;

/// Scans the raster and returns the cells whose value reached one half.
///
/// Leaves in `values` what each cell was compared with: its own expectation plus the errors it
/// received.
fn diffuse(width: usize, values: &mut [f32]) -> Vec<usize> {
    let mut lit = Vec::new();
    // Errors for this row and the next, with a spare cell at both ends.
    let (mut here, mut below) = (vec![0.0f64; width + 2], vec![0.0f64; width + 2]);
    let mut homeless = 0.0;
    let height = values.len() / width;
    for row in 0..height {
        let (start, rest) = (row * width, values.len());
        let (line, after) = values[start..rest].split_at_mut(width);
        let next_row = after.get(..width).unwrap_or(&[]);
        let is_open = |line: &[f32], c: usize| line.get(c).is_some_and(|value| *value > 0.0);
        let rightward = row % 2 == 0;
        for step in 0..width {
            let column = if rightward { step } else { width - 1 - step };
            if !is_open(line, column) {
                line[column] = CLOSED;
                continue;
            }
            let value = f64::from(line[column]) + here[column + 1] + std::mem::take(&mut homeless);
            line[column] = value as f32;
            let is_lit = value >= 0.5;
            if is_lit {
                lit.push(start + column);
            }
            let error = value - f64::from(u8::from(is_lit));
            // `wrapping_sub` below the first column gives an index that no line has.
            let (ahead, behind) = if rightward {
                (column + 1, column.wrapping_sub(1))
            } else {
                (column.wrapping_sub(1), column + 1)
            };
            let shares = [
                if is_open(line, ahead) { 7.0 } else { 0.0 },
                if is_open(next_row, behind) { 3.0 } else { 0.0 },
                if is_open(next_row, column) { 5.0 } else { 0.0 },
                if is_open(next_row, ahead) { 1.0 } else { 0.0 },
            ];
            let sum: f64 = shares.iter().sum();
            if sum == 0.0 {
                homeless = error;
                continue;
            }
            let part = error / sum;
            here[ahead.wrapping_add(1)] += part * shares[0];
            below[behind.wrapping_add(1)] += part * shares[1];
            below[column + 1] += part * shares[2];
            below[ahead.wrapping_add(1)] += part * shares[3];
        }
        if !rightward {
            // The row was scanned from the right: bring its cells into rising order.
            let first = lit.partition_point(|&cell| cell < start);
            lit[first..].reverse();
        }
        std::mem::swap(&mut here, &mut below);
        below.fill(0.0);
    }
    lit
}

/// Adds or removes the few cells that the count is off, the least decided first.
fn correct(cells: &mut Vec<usize>, values: &[f32], wanted: usize) {
    let missing = wanted as i64 - cells.len() as i64;
    if missing == 0 {
        return;
    }
    let mut is_lit = vec![false; values.len()];
    cells.iter().for_each(|&cell| is_lit[cell] = true);
    let candidate = |cell: &usize| is_lit[*cell] == (missing < 0) && values[*cell] > CLOSED;
    let mut candidates: Vec<usize> = (0..values.len()).filter(candidate).collect();
    let towards = if missing > 0 { -1.0 } else { 1.0 };
    let order = |a: &usize, b: &usize| {
        (towards * values[*a]).total_cmp(&(towards * values[*b])).then(a.cmp(b))
    };
    let count = (missing.unsigned_abs() as usize).min(candidates.len());
    if count < candidates.len() {
        candidates.select_nth_unstable_by(count, order);
    }
    candidates[..count].iter().for_each(|&cell| is_lit[cell] = missing > 0);
    cells.clear();
    cells.extend((0..values.len()).filter(|&cell| is_lit[cell]));
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    fn interior_weights_are_those_of_floyd_and_steinberg() {
        // One cell of 0.4 in a field of a hair above nothing: its error goes on 7:3:5:1.
        let mut values = vec![1e-30f32; 15];
        values[2] = 0.4;
        diffuse(5, &mut values);
        let (part, near) = (0.4 / 16.0, 1e-6);
        assert!((f64::from(values[3]) - 7.0 * part).abs() < near);
        // The second row is scanned from the right, so that its own errors have mixed in; the
        // first cell reached there has received 1/16 of the first error and all of the second.
        let second = 7.0 * part;
        let third = second * 7.0 / 16.0;
        assert!((f64::from(values[4]) - third).abs() < near);
        let below_last = second / 16.0 + third * 5.0 / 8.0;
        assert!((f64::from(values[9]) - below_last).abs() < near);
    }

    /// The same rule written down plainly: the whole picture of errors, cell by cell.
    fn plainly(width: usize, expected: &[f32]) -> Vec<bool> {
        let height = expected.len() / width;
        let mut value: Vec<f64> = expected.iter().map(|value| f64::from(*value)).collect();
        let mut lit = vec![false; expected.len()];
        let mut carried = 0.0;
        for row in 0..height {
            for step in 0..width {
                let way: i64 = if row % 2 == 0 { 1 } else { -1 };
                let column = if way == 1 { step } else { width - 1 - step };
                let at = |dx: i64, dy: usize| -> Option<usize> {
                    let c = usize::try_from(column as i64 + way * dx).ok()?;
                    (c < width && row + dy < height).then_some((row + dy) * width + c)
                };
                let own = row * width + column;
                if expected[own] <= 0.0 {
                    continue;
                }
                let sum = value[own] + std::mem::take(&mut carried);
                lit[own] = sum >= 0.5;
                let error = if lit[own] { sum - 1.0 } else { sum };
                let to: Vec<(usize, f64)> = [(1, 0, 7.0), (-1, 1, 3.0), (0, 1, 5.0), (1, 1, 1.0)]
                    .into_iter()
                    .filter_map(|(dx, dy, part)| Some((at(dx, dy)?, part)))
                    .filter(|(cell, _)| expected[*cell] > 0.0)
                    .collect();
                let parts: f64 = to.iter().map(|(_, part)| part).sum();
                to.iter().for_each(|(cell, part)| value[*cell] += error * part / parts);
                if to.is_empty() {
                    carried = error;
                }
            }
        }
        lit
    }

    #[test]
    fn nothing_expected_gives_nothing() {
        assert!(dither(4, vec![0.0; 16]).is_empty());
        assert!(dither(4, Vec::new()).is_empty());
        assert!(dither(3, vec![f32::NAN; 9]).is_empty());
    }

    #[test]
    fn one_full_cell_in_an_empty_image_is_one_plant_there() {
        let mut expected = vec![0.0; 100];
        expected[37] = 1.0;
        assert_eq!(dither(10, expected), [37]);
        assert_eq!(dither(1, vec![1.0]), [0]);
    }

    #[test]
    fn counts_in_blocks_follow_a_ramp() {
        // Expected count of a block of 25 x 100 cells: the integral of the ramp over it.
        let (width, height) = (200, 100);
        let expected: Vec<f32> =
            (0..width * height).map(|i| (i % width) as f32 / width as f32 * 0.6).collect();
        let cells = dither(width, expected.clone());
        for block in 0..8 {
            let within = |cell: &usize| (cell % width) / 25 == block;
            let count = cells.iter().filter(|cell| within(cell)).count() as f32;
            let sum: f32 =
                (0..width * height).filter(|cell| within(cell)).map(|cell| expected[cell]).sum();
            assert!((count - sum).abs() <= 0.02 * sum + 8.0, "{count} for {sum}");
        }
    }

    proptest! {
        #[test]
        fn cells_are_those_of_the_rule_written_down_plainly(
            width in 1usize..40,
            height in 1usize..40,
            scale in 0.001f32..1.0,
            holes in 0.0f32..0.6,
            seed in any::<u64>(),
        ) {
            let mut stream = weald_contract::Seed(seed).stream("image", 0);
            let expected: Vec<f32> = (0..width * height)
                .map(|_| {
                    let value = stream.unit() as f32 * scale;
                    if (stream.unit() as f32) < holes { 0.0 } else { value }
                })
                .collect();
            let plain = plainly(width, &expected);
            let plain: Vec<usize> = (0..plain.len()).filter(|cell| plain[*cell]).collect();
            prop_assert_eq!(diffuse(width, &mut expected.clone()), plain);
        }

        #[test]
        fn the_count_is_the_rounded_sum_on_any_image(
            width in 1usize..40,
            height in 1usize..40,
            scale in 0.001f32..1.0,
            holes in 0.0f32..1.0,
            seed in any::<u64>(),
        ) {
            let mut stream = weald_contract::Seed(seed).stream("image", 0);
            let expected: Vec<f32> = (0..width * height)
                .map(|_| {
                    let value = stream.unit() as f32 * scale;
                    if (stream.unit() as f32) < holes { 0.0 } else { value }
                })
                .collect();
            let sum: f64 = expected.iter().map(|value| f64::from(*value)).sum();
            let cells = dither(width, expected.clone());
            prop_assert_eq!(cells.len(), (sum + 0.5).floor() as usize);
            prop_assert!(cells.windows(2).all(|pair| pair[0] < pair[1]));
            prop_assert!(cells.iter().all(|&cell| expected[cell] > 0.0));
        }
    }
}
