//! Clustering tables longer than memory: rows come in chunks, several times, from the caller.
//!
//! One pass counts rows and weight, one draws a sample, in which clusters are searched; then
//! steps of all rows move the centres, and the last pass measures the error. What is held at a
//! time is the sample, a chunk a thread and the sums of [`GROUP`] chunks, however long the table.

use crate::Error;
use crate::codebook::{Mode, cluster};
use crate::condense::Draw;
use crate::nearest::Blocks;
use crate::table::Table;
use rayon::prelude::*;
use serde::Serialize;
use weald_contract::{Problem, Progress};

/// A table in chunks, which the caller reads or makes when they are asked for.
pub trait Chunks: Sync {
    /// Columns of every chunk.
    fn columns(&self) -> usize;

    /// Number of chunks.
    fn len(&self) -> usize;

    /// Whether there is no chunk.
    fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A chunk, from 0; the same whenever it is asked for. Called from several threads.
    ///
    /// # Errors
    /// The chunk cannot be had; the problem names it.
    fn chunk(&self, number: usize) -> Result<Table, Problem>;
}

/// How a long table is clustered.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Streaming {
    /// Most clusters.
    pub clusters: usize,
    /// How the sample is clustered.
    pub mode: Mode,
    /// Rows of the sample, about; 256 for each cluster leave the error of the sample below that
    /// of the search.
    pub sample: usize,
    /// Lloyd's steps of all rows; each reads the table once.
    pub steps: usize,
}

/// Clusters of a long table. The labels of a chunk are had from [`Streamed::labels`].
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Streamed {
    /// Columns of the table.
    pub columns: usize,
    /// Centre after centre, `columns` numbers each.
    pub centres: Vec<f64>,
    /// Rows nearest to each centre; 0 where a step left a centre without rows.
    pub counts: Vec<u64>,
    /// Weight of those rows.
    pub weights: Vec<f64>,
    /// Rows read.
    pub rows: u64,
    /// Weighted mean of the squared distances between rows and their centres; the plain mean
    /// when no row carries weight.
    pub weighted_mse: f64,
}

/// Chunks whose sums are held together.
const GROUP: usize = 64;

impl Streaming {
    /// A sample of 256 rows a cluster, and one step of all rows.
    pub fn new(clusters: usize, mode: Mode) -> Self {
        let clusters = clusters.max(1);
        Self { clusters, mode, sample: (1 << 18).max(clusters.saturating_mul(256)), steps: 1 }
    }

    /// Memory that the work takes beside what the caller's chunks are made from, bytes, for
    /// chunks of at most `chunk_rows` rows on `threads` threads.
    pub fn memory(&self, columns: usize, chunk_rows: usize, threads: usize) -> u64 {
        let row = (columns as u64 + 1) * 8;
        // A sample as numbers, as drawn chunks, as f32, and its sorted axes while it is split.
        let sample = self.sample as u64 * (2 * row + (columns as u64 + 1) * 28 + 32);
        let sums = (GROUP * self.clusters) as u64 * (columns as u64 + 3) * 8;
        sample + sums + (chunk_rows * threads) as u64 * row
    }
}

/// Clusters a table that comes in chunks. The result does not depend on the number of threads.
///
/// # Errors
/// A chunk that cannot be had or has other columns, or the caller asks to stop.
pub fn cluster_chunks(
    chunks: &dyn Chunks,
    how: &Streaming,
    progress: &dyn Progress,
) -> Result<Streamed, Error> {
    if chunks.columns() == 0 {
        return Err(Problem::new("a table needs at least one column").into());
    }
    let passes = Passes { chunks, progress };
    progress.begin("clustering", (chunks.len() * (how.steps + 3)) as u64, "chunks");
    let totals = passes.over(|_, table| Total::of(table))?;
    let whole = totals.iter().copied().fold(Total::default(), Total::plus);
    let sample = passes.sample(&totals, whole, how.sample)?;
    let book = cluster(&sample, how.clusters, how.mode);
    let mut centres = book.centres;
    for _ in 0..how.steps {
        let sums = passes.sums(&centres, whole)?;
        sums.move_centres(&mut centres);
    }
    let sums = passes.sums(&centres, whole)?;
    Ok(Streamed {
        columns: chunks.columns(),
        weighted_mse: if sums.total > 0.0 { sums.squares / sums.total } else { 0.0 },
        counts: sums.counts,
        weights: sums.weights,
        rows: whole.rows,
        centres,
    })
}

impl Streamed {
    /// The nearest centre of each row of a chunk.
    ///
    /// # Panics
    /// When the chunk has other columns than the table that was clustered.
    pub fn labels(&self, chunk: &Table) -> Vec<u32> {
        assert_eq!(chunk.columns(), self.columns, "a chunk of another table");
        let near = Near::of(&self.centres, self.columns);
        let mut row = Vec::new();
        (0..chunk.len()).map(|index| near.label(chunk.row(index), &mut row)).collect()
    }
}

/// Rows and weight of a chunk or of all.
#[derive(Clone, Copy, Default)]
struct Total {
    rows: u64,
    weight: f64,
}

impl Total {
    fn of(table: &Table) -> Self {
        Self { rows: table.len() as u64, weight: table.weights().iter().sum() }
    }

    fn plus(self, other: Self) -> Self {
        Self { rows: self.rows + other.rows, weight: self.weight + other.weight }
    }
}

/// Reads the chunks again and again.
struct Passes<'a> {
    chunks: &'a dyn Chunks,
    progress: &'a dyn Progress,
}

impl Passes<'_> {
    /// What `look` finds in each chunk, in their order.
    fn over<T: Send>(&self, look: impl Fn(usize, &Table) -> T + Sync) -> Result<Vec<T>, Error> {
        (0..self.chunks.len()).into_par_iter().map(|number| self.look(number, &look)).collect()
    }

    fn look<T>(&self, number: usize, look: impl Fn(usize, &Table) -> T) -> Result<T, Error> {
        if self.progress.is_cancelled() {
            return Err(Error::Cancelled);
        }
        let table = self.chunks.chunk(number)?;
        if table.columns() != self.chunks.columns() {
            return Err(Problem::new(format!(
                "chunk {number} has {} columns where {} are right",
                table.columns(),
                self.chunks.columns()
            ))
            .into());
        }
        self.progress.advance(1);
        Ok(look(number, &table))
    }

    /// About `most` rows, or all when they are fewer; see [`crate::condense`].
    fn sample(&self, totals: &[Total], whole: Total, most: usize) -> Result<Table, Error> {
        let before: Vec<Total> = totals
            .iter()
            .scan(Total::default(), |sum, total| {
                let before = *sum;
                *sum = sum.plus(*total);
                Some(before)
            })
            .collect();
        let is_all = whole.rows / 2 < most as u64;
        let drawn = self.over(|number, table| {
            let mut draw = Draw::new(whole.rows, whole.weight, most);
            draw.skip(before[number].rows, before[number].weight);
            let (mut values, mut weights) = (Vec::new(), Vec::new());
            for (index, weight) in table.weights().iter().enumerate() {
                let drawn = if is_all { Some(*weight) } else { draw.weight_of(*weight) };
                if let Some(weight) = drawn {
                    values.extend_from_slice(table.row(index));
                    weights.push(weight);
                }
            }
            (values, weights)
        })?;
        let (values, weights): (Vec<_>, Vec<_>) = drawn.into_iter().unzip();
        Table::new(values.concat(), self.chunks.columns(), weights.concat())
            .map_err(|error| Problem::new(error.to_string()).into())
    }

    /// Sums over the rows nearest to each centre.
    fn sums(&self, centres: &[f64], whole: Total) -> Result<Sums, Error> {
        let near = Near::of(centres, self.chunks.columns());
        let is_weighted = whole.weight > 0.0;
        let mut total = Sums::new(centres.len(), self.chunks.columns());
        let numbers: Vec<usize> = (0..self.chunks.len()).collect();
        for group in numbers.chunks(GROUP) {
            let parts: Result<Vec<Sums>, Error> = group
                .par_iter()
                .map(|number| self.look(*number, |_, table| Sums::of(table, &near, is_weighted)))
                .collect();
            // In the order of the chunks, whatever thread was done first.
            parts?.iter().for_each(|part| total.add(part));
        }
        Ok(total)
    }
}

/// Centres made ready to find the nearest: moved and scaled to the range of f32.
struct Near<'a> {
    centres: &'a [f64],
    middle: Vec<f64>,
    half_range: f64,
    blocks: Blocks,
}

impl<'a> Near<'a> {
    fn of(centres: &'a [f64], columns: usize) -> Self {
        let range = |column: usize| {
            let values = centres.iter().skip(column).step_by(columns);
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], v| [a.min(*v), b.max(*v)])
        };
        let ranges: Vec<[f64; 2]> = (0..columns).map(range).collect();
        let middle: Vec<f64> = ranges.iter().map(|[a, b]| a / 2.0 + b / 2.0).collect();
        let widest = ranges.iter().map(|[a, b]| b / 2.0 - a / 2.0).fold(0.0, f64::max);
        let half_range = if widest > 0.0 { widest } else { 1.0 };
        let scaled = centres.iter().enumerate();
        let scaled: Vec<f32> =
            scaled.map(|(at, v)| ((v - middle[at % columns]) / half_range) as f32).collect();
        Self { blocks: Blocks::of(&scaled, columns), centres, middle, half_range }
    }

    /// The nearest centre; `room` is reused from row to row.
    fn label(&self, row: &[f64], room: &mut Vec<f32>) -> u32 {
        room.clear();
        let scaled = row.iter().zip(&self.middle);
        // Rows far outside of the centres stay inside the range of f32.
        room.extend(scaled.map(|(v, m)| ((v - m) / self.half_range).clamp(-1e15, 1e15) as f32));
        self.blocks.nearest(room).label
    }
}

/// Sums over rows by their nearest centre.
struct Sums {
    columns: usize,
    /// Weighted sums of the rows of each centre.
    sums: Vec<f64>,
    weights: Vec<f64>,
    counts: Vec<u64>,
    /// Weighted sum of squared distances, and the weight of all rows.
    squares: f64,
    total: f64,
}

impl Sums {
    fn new(values: usize, columns: usize) -> Self {
        let k = values / columns.max(1);
        Self {
            columns,
            sums: vec![0.0; values],
            weights: vec![0.0; k],
            counts: vec![0; k],
            squares: 0.0,
            total: 0.0,
        }
    }

    fn of(table: &Table, near: &Near<'_>, is_weighted: bool) -> Self {
        let columns = table.columns();
        let mut sums = Self::new(near.centres.len(), columns);
        let mut room = Vec::with_capacity(columns);
        for index in 0..table.len() {
            let row = table.row(index);
            let label = near.label(row, &mut room) as usize;
            let weight = if is_weighted { table.weights()[index] } else { 1.0 };
            let centre = &near.centres[label * columns..][..columns];
            let apart = row.iter().zip(centre).map(|(v, c)| (v - c).powi(2)).sum::<f64>();
            sums.squares += weight * apart;
            sums.total += weight;
            sums.weights[label] += weight;
            sums.counts[label] += 1;
            let of_label = &mut sums.sums[label * columns..][..columns];
            of_label.iter_mut().zip(row).for_each(|(sum, value)| *sum += weight * value);
        }
        sums
    }

    fn add(&mut self, part: &Self) {
        let add = |all: &mut [f64], more: &[f64]| {
            all.iter_mut().zip(more).for_each(|(sum, more)| *sum += more);
        };
        add(&mut self.sums, &part.sums);
        add(&mut self.weights, &part.weights);
        self.counts.iter_mut().zip(&part.counts).for_each(|(sum, more)| *sum += more);
        self.squares += part.squares;
        self.total += part.total;
    }

    /// Centres without weight stay.
    fn move_centres(&self, centres: &mut [f64]) {
        for (at, centre) in centres.iter_mut().enumerate() {
            let weight = self.weights[at / self.columns];
            if weight > 0.0 {
                *centre = self.sums[at] / weight;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Seed, Silent};

    /// Chunks made from a seed.
    struct Made {
        rows: usize,
        chunk_rows: usize,
    }

    impl Chunks for Made {
        fn columns(&self) -> usize {
            3
        }

        fn len(&self) -> usize {
            self.rows.div_ceil(self.chunk_rows)
        }

        fn chunk(&self, number: usize) -> Result<Table, Problem> {
            let start = number * self.chunk_rows;
            let rows = start..(start + self.chunk_rows).min(self.rows);
            let (mut values, mut weights) = (Vec::new(), Vec::new());
            for row in rows {
                let mut random = Seed(9).stream("row", row as u64);
                let kind = random.below(5) as f64;
                values.extend((0..3).map(|_| kind + 0.4 * random.normal()));
                weights.push(random.unit().max(0.05).powi(-2));
            }
            Table::new(values, 3, weights).map_err(|error| Problem::new(error.to_string()))
        }
    }

    fn streaming(sample: usize) -> Streaming {
        Streaming { sample, ..Streaming::new(12, Mode::Fast) }
    }

    #[test]
    fn a_table_in_chunks_is_clustered_nearly_as_well_as_a_whole_one() {
        let made = Made { rows: 60_000, chunk_rows: 7_000 };
        let whole = Made { rows: 60_000, chunk_rows: 60_000 }.chunk(0).unwrap();
        let streamed = cluster_chunks(&made, &streaming(6_000), &Silent).unwrap();
        let at_once = cluster(&whole, 12, Mode::Fast).distortion(&whole);
        assert!(streamed.weighted_mse < at_once * 1.03, "{} {at_once}", streamed.weighted_mse);
        assert_eq!((streamed.rows, streamed.counts.iter().sum()), (60_000, 60_000));
        // The error told is that of the labels.
        let labels = streamed.labels(&whole);
        let book = crate::Codebook { columns: 3, centres: streamed.centres.clone(), labels };
        assert!((book.distortion(&whole) / streamed.weighted_mse - 1.0).abs() < 1e-9);
    }

    #[test]
    fn threads_do_not_change_what_is_found_in_chunks() {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let made = Made { rows: 20_000, chunk_rows: 130 };
            pool.install(|| cluster_chunks(&made, &streaming(3_000), &Silent).unwrap())
        };
        assert_eq!(on(1), on(2));
    }

    #[test]
    fn short_tables_are_taken_whole_and_no_rows_are_no_clusters() {
        let how = Streaming { steps: 2, ..Streaming::new(50, Mode::Best) };
        let few = cluster_chunks(&Made { rows: 40, chunk_rows: 7 }, &how, &Silent).unwrap();
        assert!(few.counts.len() == 40 && few.weighted_mse < 1e-12);
        let none = cluster_chunks(&Made { rows: 0, chunk_rows: 7 }, &how, &Silent).unwrap();
        assert!(none.centres.is_empty() && none.weighted_mse == 0.0);
    }

    #[test]
    fn memory_does_not_grow_with_the_table() {
        // 64 clusters of a hundred million rows of 3 columns, in chunks of a million.
        let bytes = Streaming::new(64, Mode::Fast).memory(3, 1 << 20, 2);
        assert!(bytes < 200 << 20, "{bytes}");
    }
}
