//! An order of rows that depends on their content alone, along a Z-curve [Morton66].
//!
//! Rows that follow each other along the curve lie near each other in all columns: sums along it do
//! not depend on the order in which a table came, a draw at equal steps is even in all directions,
//! and a run of rows fits into a small box.

use crate::samples::{DIGIT_BITS, sort_keys};
use crate::table::Table;
use std::cmp::Ordering;
use std::ops::Range;

/// Bits of a place along the curve.
const BITS: u32 = 32;

/// Bits of a place by which all rows are sorted at first.
const SORTED_BITS: u32 = 2 * DIGIT_BITS;

/// How numbers of the columns become a place along the curve.
pub(crate) struct Curve {
    columns: Vec<Axis>,
}

/// Bits of one column.
struct Axis {
    index: usize,
    low: f64,
    /// Steps of the column for each unit, a power of two over the column's range.
    scale: f64,
    last_step: u32,
    /// For each byte of a step, from the lowest, where the bits of its values lie on the curve.
    bytes: Vec<[u32; 256]>,
}

impl Curve {
    /// A curve through the box of `ranges`, columns with their least and largest number, each less
    /// than the other.
    ///
    /// Each bit, from the highest, halves the column that is widest by then, so that places on the
    /// curve are about cubes.
    pub fn through(ranges: &[(usize, Range<f64>)]) -> Self {
        // Halves, because the width of the widest range of f64 is infinite.
        let half = |range: &Range<f64>| range.end / 2.0 - range.start / 2.0;
        let mut widths: Vec<f64> = ranges.iter().map(|(_, range)| half(range)).collect();
        let mut bits = vec![Vec::new(); ranges.len()];
        for bit in (0..BITS).rev() {
            let widest = (0..widths.len()).reduce(|a, b| if widths[b] > widths[a] { b } else { a });
            let Some(widest) = widest else { break };
            widths[widest] /= 2.0;
            bits[widest].push(bit);
        }
        let columns = ranges.iter().zip(bits);
        let axis = |((index, range), bits): (&(usize, Range<f64>), Vec<u32>)| {
            let steps = libm::exp2(bits.len() as f64);
            Axis {
                index: *index,
                low: range.start,
                scale: steps / 2.0 / half(range),
                last_step: (steps - 1.0) as u32,
                bytes: spread(&bits),
            }
        };
        Self { columns: columns.map(axis).collect() }
    }

    /// The place of a row.
    fn place(&self, row: &[f64]) -> u32 {
        let on_axis = |axis: &Axis| {
            let step = (((row[axis.index] - axis.low) * axis.scale) as u32).min(axis.last_step);
            let bytes = axis.bytes.iter().zip(step.to_le_bytes());
            bytes.fold(0, |place, (bits, byte)| place | bits[usize::from(byte)])
        };
        self.columns.iter().fold(0, |place, axis| place | on_axis(axis))
    }

    /// Row numbers of a table, sorted along the curve; rows at one place by their numbers and then
    /// their weight.
    pub fn sorted_rows(&self, table: &Table) -> Vec<u32> {
        let key = |row: usize| u64::from(self.place(table.row(row))) << 32 | row as u64;
        let mut keys = sort_keys((0..table.len()).map(key).collect(), SORTED_BITS);
        // Few rows agree in so many bits.
        let agree = |a: &u64, b: &u64| (a ^ b) >> (64 - SORTED_BITS) == 0;
        for run in keys.chunk_by_mut(agree).filter(|run| run.len() > 1) {
            let by_row = |a: &u64, b: &u64| compare(table, *a as u32, *b as u32);
            run.sort_by(|a, b| (a >> 32).cmp(&(b >> 32)).then_with(|| by_row(a, b)));
        }
        keys.into_iter().map(|key| key as u32).collect()
    }
}

/// Tables that bring the bits of a number, the highest first, to their places.
fn spread(bits: &[u32]) -> Vec<[u32; 256]> {
    let from_lowest: Vec<u32> = bits.iter().rev().copied().collect();
    let table = |bits: &[u32]| {
        let of_value = |value: usize| {
            let is_set = |bit: &(usize, &u32)| value >> bit.0 & 1 == 1;
            bits.iter().enumerate().filter(is_set).fold(0, |place, (_, bit)| place | 1 << bit)
        };
        std::array::from_fn(of_value)
    };
    from_lowest.chunks(8).map(table).collect()
}

fn compare(table: &Table, a: u32, b: u32) -> Ordering {
    let (a, b) = (a as usize, b as usize);
    let columns = table.row(a).iter().zip(table.row(b)).map(|(a, b)| a.total_cmp(b));
    columns
        .fold(Ordering::Equal, Ordering::then)
        .then(table.weights()[a].total_cmp(&table.weights()[b]))
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn four_quarters_of_a_square_follow_each_other() {
        let curve = Curve::through(&[(0, 0.0..1.0), (1, 0.0..1.0)]);
        let place = |x: f64, y: f64| curve.place(&[x, y]) >> 30;
        assert_eq!(
            [place(0.1, 0.1), place(0.1, 0.9), place(0.9, 0.1), place(0.9, 0.9)],
            [0, 1, 2, 3]
        );
        assert_eq!((curve.place(&[0.0, 0.0]), curve.place(&[1.0, 1.0])), (0, u32::MAX));
    }

    #[test]
    fn a_wide_column_is_halved_until_it_is_as_narrow_as_the_others() {
        // Eight times as wide: three bits before the first of the narrow one.
        let curve = Curve::through(&[(0, 0.0..1.0), (1, 0.0..8.0)]);
        for step in 0..8 {
            let y = f64::from(step) + 0.5;
            assert_eq!(curve.place(&[0.0, y]) >> 29, step);
            assert_eq!(curve.place(&[0.9, y]) >> 29, step);
        }
    }

    #[test]
    fn the_order_does_not_depend_on_the_order_of_the_table() {
        let mut random = Seed(3).stream("rows", 0);
        let rows: Vec<[f64; 3]> =
            (0..5000).map(|_| [random.below(9) as f64, random.unit(), random.normal()]).collect();
        let sorted = |rows: &[[f64; 3]]| {
            let table = Table::new(rows.concat(), 3, vec![1.0; rows.len()]).unwrap();
            let curve = Curve::through(&[(0, 0.0..9.0), (2, -5.0..5.0)]);
            let order = curve.sorted_rows(&table);
            order.into_iter().flat_map(|row| table.row(row as usize).to_vec()).collect::<Vec<_>>()
        };
        let mut turned = rows.clone();
        turned.rotate_left(1234);
        turned.reverse();
        assert_eq!(sorted(&rows), sorted(&turned));
    }

    #[test]
    fn a_run_along_the_curve_lies_in_a_small_box() {
        let mut random = Seed(5).stream("rows", 0);
        let values = (0..4 * 20_000).map(|_| random.unit()).collect();
        let table = Table::new(values, 4, vec![1.0; 20_000]).unwrap();
        let ranges: Vec<_> = (0..4).map(|column| (column, 0.0..1.0)).collect();
        let order = Curve::through(&ranges).sorted_rows(&table);
        let side = |run: &[u32], column: usize| {
            let values = run.iter().map(|row| table.row(*row as usize)[column]);
            let [low, high] = values.fold([1.0f64, 0.0f64], |[a, b], v| [a.min(v), b.max(v)]);
            high - low
        };
        let sides: Vec<f64> =
            order.chunks(32).flat_map(|run| (0..4).map(|c| side(run, c))).collect();
        // 32 of 20,000 rows would fill a cube of side 0.2; runs that cross a border are longer.
        let mean = sides.iter().sum::<f64>() / sides.len() as f64;
        assert!(mean < 0.35, "{mean}");
    }
}
