//! A table made ready for clustering: an order of its own, columns that vary, plain f32.
//!
//! Rows are sorted by their content, so sums are taken in the same order whatever order the
//! caller's rows have, and permuted input gives the same clusters to the last bit.

use crate::order::Curve;
use crate::table::Table;
use rayon::prelude::*;
use std::ops::Range;

/// Rows of a table along a [`Curve`], moved and scaled into [-1, 1].
pub(crate) struct Samples {
    /// Table row of each sample.
    pub order: Vec<u32>,
    /// Sample after sample, `dims` numbers each.
    pub rows: Vec<f32>,
    /// Number of columns that vary.
    pub dims: usize,
    /// Weights as parts of the largest; all 1 when every weight is 0.
    pub weights: Vec<f32>,
    /// What a weighted square of 1 here is in the table's units.
    pub unit: f64,
}

/// How a column is moved so that its middle is 0.
struct Column {
    index: usize,
    middle: f64,
    range: Range<f64>,
}

impl Samples {
    /// Prepares a table.
    ///
    /// One factor scales all columns, which changes no comparison of distances; it keeps any
    /// finite f64 inside the range of f32. Differences below 6e-8 of the widest column vanish.
    pub fn of(table: &Table) -> Self {
        let (columns, half_range) = varying_columns(table);
        let ranges: Vec<_> =
            columns.iter().map(|column| (column.index, column.range.clone())).collect();
        let order = Curve::through(&ranges).sorted_rows(table);
        let dims = columns.len();
        let mut rows = vec![0.0; order.len() * dims];
        let place = |(values, row): (&mut [f32], &u32)| {
            let row = table.row(*row as usize);
            for (value, column) in values.iter_mut().zip(&columns) {
                *value = scale(row[column.index], column.middle, half_range);
            }
        };
        if dims > 0 {
            let chunks = rows.par_chunks_mut(CHUNK * dims).zip(order.par_chunks(CHUNK));
            chunks.for_each(|(rows, order)| rows.chunks_exact_mut(dims).zip(order).for_each(place));
        }
        let largest = table.weights().iter().copied().fold(0.0, f64::max);
        let relative = |row: &u32| match largest {
            0.0 => 1.0,
            largest => (table.weights()[*row as usize] / largest) as f32,
        };
        let weights = order.iter().map(relative).collect();
        let unit = half_range * half_range * if largest > 0.0 { largest } else { 1.0 };
        Self { rows, dims, order, weights, unit }
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.order.len()
    }

    /// The numbers of a sample.
    pub fn row(&self, index: usize) -> &[f32] {
        &self.rows[index * self.dims..][..self.dims]
    }
}

/// Rows handled by one task: enough to outweigh the task, few enough to share out.
pub(crate) const CHUNK: usize = 8192;

/// Bits that sort as the number does, with -0 before 0 (callers have no -0).
fn sortable(value: f32) -> u32 {
    let bits = value.to_bits();
    if bits >> 31 == 1 { !bits } else { bits | 1 << 31 }
}

/// A number and the sample it belongs to, as bits that sort by both.
pub(crate) fn key(value: f32, sample: u32) -> u64 {
    u64::from(sortable(value)) << 32 | u64::from(sample)
}

/// The number and the sample of a [`key`].
pub(crate) fn of_key(key: u64) -> (f32, u32) {
    let bits = (key >> 32) as u32;
    let bits = if bits >> 31 == 1 { bits & !(1 << 31) } else { !bits };
    (f32::from_bits(bits), key as u32)
}

/// Bits of a key that one pass of [`sort_keys`] looks at: three passes cover a number, and the
/// counts of a pass fit into the first-level cache.
pub(crate) const DIGIT_BITS: u32 = 11;

/// Bits of a key that its number takes.
pub(crate) const NUMBER_BITS: u32 = 32;

/// Sorts keys by at least so many of their highest bits; those of equal bits stay in their order.
///
/// Radix sort from the lowest digit up.
pub(crate) fn sort_keys(mut keys: Vec<u64>, bits: u32) -> Vec<u64> {
    if keys.len() < 1 << DIGIT_BITS {
        keys.sort_by_key(|key| key >> (64 - bits));
        return keys;
    }
    let mut sorted = vec![0; keys.len()];
    for shift in (64 - bits..64).step_by(DIGIT_BITS as usize) {
        let digit = |key: u64| (key >> shift) as usize & ((1 << DIGIT_BITS) - 1);
        let mut next = vec![0u32; 1 << DIGIT_BITS];
        keys.iter().for_each(|key| next[digit(*key)] += 1);
        let mut start = 0;
        for place in &mut next {
            start += std::mem::replace(place, start);
        }
        for key in &keys {
            let place = &mut next[digit(*key)];
            sorted[*place as usize] = *key;
            *place += 1;
        }
        std::mem::swap(&mut keys, &mut sorted);
    }
    keys
}

fn scale(value: f64, middle: f64, half_range: f64) -> f32 {
    // Adding 0 turns -0 into 0, so that equal numbers have equal bits.
    ((value - middle) / half_range) as f32 + 0.0
}

/// Columns with more than one value, and half the width of the widest.
fn varying_columns(table: &Table) -> (Vec<Column>, f64) {
    let ranges = ranges(table);
    // Halve before subtracting: the difference of two large numbers may overflow.
    let half = |range: &[f64; 2]| range[1] / 2.0 - range[0] / 2.0;
    let half_range = ranges.iter().map(half).fold(0.0, f64::max);
    let columns = ranges.iter().enumerate().filter_map(|(index, range)| {
        let middle = range[0] / 2.0 + range[1] / 2.0;
        let [low, high] = range.map(|value| scale(value, middle, half_range));
        (low < high).then_some(Column { index, middle, range: range[0]..range[1] })
    });
    (columns.collect(), half_range)
}

/// The least and the largest number of each column.
fn ranges(table: &Table) -> Vec<[f64; 2]> {
    let columns = table.columns();
    let (mut low, mut high) = (vec![f64::INFINITY; columns], vec![f64::NEG_INFINITY; columns]);
    for row in 0..table.len() {
        for ((low, high), value) in low.iter_mut().zip(&mut high).zip(table.row(row)) {
            *low = if *value < *low { *value } else { *low };
            *high = if *value > *high { *value } else { *high };
        }
    }
    low.into_iter().zip(high).map(|(low, high)| [low, high]).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sortable_bits_order_as_numbers_do() {
        let numbers = [f32::NEG_INFINITY, -2.0, -1e-30, 0.0, 1e-30, 0.5, 3.0, f32::INFINITY];
        assert!(numbers.windows(2).all(|pair| sortable(pair[0]) < sortable(pair[1])));
    }

    #[test]
    fn keys_sort_by_number_and_then_by_sample() {
        let mut random = weald_contract::Seed(2).stream("keys", 0);
        for n in [10, 5000] {
            // Few distinct numbers, so that many are equal.
            let keys: Vec<u64> =
                (0..n).map(|sample| key(random.below(50) as f32 - 25.0, sample)).collect();
            let mut expected = keys.clone();
            expected.sort_unstable();
            assert!(keys.iter().enumerate().all(|(i, key)| of_key(*key).1 == i as u32));
            assert_eq!(sort_keys(keys, NUMBER_BITS), expected);
        }
        assert_eq!(of_key(key(-0.75, 9)), (-0.75, 9));
    }

    #[test]
    fn columns_that_do_not_vary_are_left_out() {
        let values = vec![5.0, 1.0, 7.0, 5.0, 2.0, 7.0];
        let samples = Samples::of(&Table::new(values, 3, vec![1.0; 2]).unwrap());
        assert_eq!((samples.dims, samples.rows), (1, vec![-1.0, 1.0]));
    }

    #[test]
    fn the_widest_numbers_of_f64_fit() {
        let values = vec![-f64::MAX, f64::MAX, 0.0];
        let samples = Samples::of(&Table::new(values, 1, vec![1.0; 3]).unwrap());
        assert_eq!(samples.rows, vec![-1.0, 0.0, 1.0]);
    }
}
