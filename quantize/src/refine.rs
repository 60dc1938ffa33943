//! Improving a partition by Lloyd's steps.
//!
//! A step gives every sample to the nearest centre and moves every centre to the mean of its
//! samples; neither can raise the distortion [Lloyd82].

use crate::samples::{CHUNK, Samples};
use rayon::prelude::*;

/// Clusters of samples.
#[derive(Clone)]
pub(crate) struct Partition {
    /// Cluster of each sample.
    pub labels: Vec<u32>,
    /// Number of clusters; some may be empty.
    pub k: usize,
}

/// Sums over the samples of each cluster.
struct Sums {
    dims: usize,
    /// For each cluster the weighted sums of its numbers, then its weight.
    sums: Vec<f64>,
    /// Weighted sum of squared distances to the centres that gave the labels.
    distortion: f64,
}

impl Sums {
    fn new(dims: usize, k: usize) -> Self {
        Self { dims, sums: vec![0.0; k * (dims + 1)], distortion: 0.0 }
    }

    fn add(&mut self, label: u32, row: &[f32], weight: f32) {
        let weight = f64::from(weight);
        let sums = &mut self.sums[label as usize * (self.dims + 1)..][..=self.dims];
        for (sum, value) in sums.iter_mut().zip(row) {
            *sum += weight * f64::from(*value);
        }
        sums[self.dims] += weight;
    }

    /// Adds partial sums in the order of their chunks, which no thread count changes.
    fn total(dims: usize, k: usize, parts: Vec<Sums>) -> Self {
        let mut total = Self::new(dims, k);
        for part in parts {
            total.sums.iter_mut().zip(&part.sums).for_each(|(sum, more)| *sum += more);
            total.distortion += part.distortion;
        }
        total
    }

    fn weight(&self, label: usize) -> f64 {
        self.sums[label * (self.dims + 1) + self.dims]
    }

    /// Moves centres to the means of their samples; those without weight stay.
    fn move_centres(&self, centres: &mut [f32]) {
        for (label, centre) in centres.chunks_exact_mut(self.dims).enumerate() {
            let weight = self.weight(label);
            if weight > 0.0 {
                let sums = &self.sums[label * (self.dims + 1)..];
                centre.iter_mut().zip(sums).for_each(|(c, sum)| *c = (sum / weight) as f32);
            }
        }
    }
}

/// Takes at most `steps` of Lloyd's steps, fewer when one no longer helps.
pub(crate) fn lloyd(samples: &Samples, start: Partition, steps: usize) -> Partition {
    if samples.dims == 0 || samples.len() == 0 {
        return start;
    }
    descend(samples, &start, steps).partition
}

/// A partition with its centres and distortion.
#[derive(Clone)]
pub(crate) struct State {
    pub partition: Partition,
    /// Centre after centre.
    pub centres: Vec<f32>,
    /// Weighted sum of squared distances to the centres, in the units of [`Samples`].
    pub distortion: f64,
}

/// At most `steps` of Lloyd's steps from a partition, until one no longer helps.
pub(crate) fn descend(samples: &Samples, start: &Partition, steps: usize) -> State {
    descend_from(samples, means(samples, start), steps, 0.0)
}

/// At most `steps` of Lloyd's steps from centres, until one lowers the distortion by no more than
/// `least_gain` of it.
pub(crate) fn descend_from(
    samples: &Samples,
    mut centres: Vec<f32>,
    steps: usize,
    least_gain: f64,
) -> State {
    let k = centres.len() / samples.dims;
    let (first, mut sums) = assign(samples, &centres, k);
    let mut state = State {
        partition: Partition { labels: first, k },
        centres: centres.clone(),
        distortion: sums.distortion,
    };
    for _ in 0..steps {
        sums.move_centres(&mut centres);
        let (labels, next) = assign(samples, &centres, k);
        let is_last = next.distortion >= state.distortion * (1.0 - least_gain);
        if next.distortion >= state.distortion {
            break;
        }
        state.partition.labels = labels;
        state.centres.copy_from_slice(&centres);
        state.distortion = next.distortion;
        sums = next;
        if is_last {
            break;
        }
    }
    state
}

/// Means of clusters; those without weight get the plain mean of their samples.
pub(crate) fn means(samples: &Samples, partition: &Partition) -> Vec<f32> {
    let (dims, k) = (samples.dims, partition.k);
    let sum = |weigh: &(dyn Fn(usize) -> f32 + Sync)| {
        let chunks = partition.labels.par_chunks(CHUNK).enumerate().map(|(chunk, labels)| {
            let mut sums = Sums::new(dims, k);
            for (offset, label) in labels.iter().enumerate() {
                let sample = chunk * CHUNK + offset;
                sums.add(*label, samples.row(sample), weigh(sample));
            }
            sums
        });
        Sums::total(dims, k, chunks.collect())
    };
    let mut centres = vec![0.0; k * dims];
    let weighted = sum(&|sample| samples.weights[sample]);
    if (0..k).any(|label| weighted.weight(label) == 0.0) {
        sum(&|_| 1.0).move_centres(&mut centres);
    }
    weighted.move_centres(&mut centres);
    centres
}

/// Centres side by side in blocks of this many, so that one instruction compares several.
const LANES: usize = 8;

/// Gives every sample to its nearest centre.
fn assign(samples: &Samples, centres: &[f32], k: usize) -> (Vec<u32>, Sums) {
    let dims = samples.dims;
    let blocks = Blocks::of(centres, dims);
    let mut labels = vec![0; samples.len()];
    let chunks = labels.par_chunks_mut(CHUNK).enumerate().map(|(chunk, labels)| {
        let mut sums = Sums::new(dims, k);
        for (offset, label) in labels.iter_mut().enumerate() {
            let sample = chunk * CHUNK + offset;
            let (row, weight) = (samples.row(sample), samples.weights[sample]);
            let near = blocks.nearest(row);
            *label = near.label;
            sums.add(near.label, row, weight);
            sums.distortion += f64::from(weight) * f64::from(near.distance);
        }
        sums
    });
    let parts = chunks.collect();
    (labels, Sums::total(dims, k, parts))
}

/// Centres in blocks of [`LANES`], sorted along the first axis.
///
/// A block is first numbers together, then second ones, …. The last block is filled up with
/// centres that are infinitely far.
pub(crate) struct Blocks {
    values: Vec<f32>,
    /// Cluster of each lane of each block.
    labels: Vec<u32>,
    /// Least and largest first number of each block; both rise.
    ranges: Vec<[f32; 2]>,
}

/// The centre that was found.
pub(crate) struct Nearest {
    pub label: u32,
    /// Squared distance.
    distance: f32,
}

impl Blocks {
    pub fn of(centres: &[f32], dims: usize) -> Self {
        let first = |label: u32| centres[label as usize * dims];
        let mut labels: Vec<u32> = (0..(centres.len() / dims) as u32).collect();
        labels.sort_by(|a, b| first(*a).total_cmp(&first(*b)));
        let mut values = Vec::with_capacity(centres.len() + LANES * dims);
        let mut ranges = Vec::new();
        for block in labels.chunks(LANES) {
            ranges.push([first(block[0]), first(block[block.len() - 1])]);
            for dim in 0..dims {
                let value = |label: &u32| centres[*label as usize * dims + dim];
                let lane = |lane: usize| block.get(lane).map_or(f32::INFINITY, value);
                values.extend((0..LANES).map(lane));
            }
        }
        labels.resize(ranges.len() * LANES, u32::MAX);
        Self { values, labels, ranges }
    }

    pub fn nearest(&self, row: &[f32]) -> Nearest {
        // The same loop, compiled for each common number of axes.
        match row.len() {
            2 => row.first_chunk::<2>().map_or_else(|| self.search(row), |row| self.search(row)),
            3 => row.first_chunk::<3>().map_or_else(|| self.search(row), |row| self.search(row)),
            4 => row.first_chunk::<4>().map_or_else(|| self.search(row), |row| self.search(row)),
            _ => self.search(row),
        }
    }

    /// Looks at the block where the row lies along the first axis, then outwards on both sides
    /// until the first axis alone is farther than the nearest centre found.
    #[inline(always)]
    fn search(&self, row: &[f32]) -> Nearest {
        let size = row.len() * LANES;
        let block = |number: usize| &self.values[number * size..][..size];
        let first = row[0];
        let start = self.ranges.partition_point(|range| range[0] <= first).saturating_sub(1);
        let mut lanes = Lanes::new().compare(row, block(start), start);
        let (mut left, mut right) = (start, start + 1);
        loop {
            let nearest = lanes.least();
            let is_near = |gap: f32| gap * gap < nearest;
            let goes_left = left > 0 && is_near(first - self.ranges[left - 1][1]);
            let goes_right = right < self.ranges.len() && is_near(self.ranges[right][0] - first);
            if goes_left {
                left -= 1;
                lanes = lanes.compare(row, block(left), left);
            }
            if goes_right {
                lanes = lanes.compare(row, block(right), right);
                right += 1;
            }
            if !(goes_left || goes_right) {
                break;
            }
        }
        let lane = (1..LANES).fold(0, |a, b| if lanes.best[b] < lanes.best[a] { b } else { a });
        let label = self.labels[lanes.block[lane] as usize * LANES + lane];
        Nearest { label, distance: lanes.best[lane] }
    }
}

/// The nearest centre so far in each lane.
#[derive(Clone, Copy)]
struct Lanes {
    /// Squared distance.
    best: [f32; LANES],
    /// Number of the centre's block.
    block: [u32; LANES],
}

impl Lanes {
    #[inline(always)]
    fn new() -> Self {
        Self { best: [f32::INFINITY; LANES], block: [0; LANES] }
    }

    /// By value, so that both arrays stay in registers.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "three arrays advance together")]
    fn compare(mut self, row: &[f32], block: &[f32], number: usize) -> Self {
        let mut distance = [0f32; LANES];
        for (value, lanes) in row.iter().zip(block.chunks_exact(LANES)) {
            for lane in 0..LANES {
                let apart = value - lanes[lane];
                distance[lane] += apart * apart;
            }
        }
        for lane in 0..LANES {
            let is_nearer = distance[lane] < self.best[lane];
            self.best[lane] = if is_nearer { distance[lane] } else { self.best[lane] };
            self.block[lane] = if is_nearer { number as u32 } else { self.block[lane] };
        }
        self
    }

    #[inline(always)]
    fn least(&self) -> f32 {
        self.best.iter().copied().fold(f32::INFINITY, |a, b| if b < a { b } else { a })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn blocks_find_the_centre_that_looking_at_all_finds() {
        for dims in 1..=6 {
            let mut random = Seed(8).stream("centres", dims as u64);
            let mut numbers = |n: usize| -> Vec<f32> {
                // Steps of 1/8: distances are exact, and tie.
                (0..n * dims).map(|_| random.below(33) as f32 / 8.0 - 2.0).collect()
            };
            for k in [1, 7, 8, 9, 100, 2000] {
                let (centres, rows) = (numbers(k), numbers(200));
                let blocks = Blocks::of(&centres, dims);
                for row in rows.chunks_exact(dims) {
                    let distance = |centre: &[f32]| {
                        centre.iter().zip(row).map(|(c, r)| (c - r).powi(2)).sum::<f32>()
                    };
                    let least =
                        centres.chunks_exact(dims).map(distance).fold(f32::INFINITY, f32::min);
                    let near = blocks.nearest(row);
                    let centre = &centres[near.label as usize * dims..][..dims];
                    assert_eq!((near.distance, distance(centre)), (least, least));
                }
            }
        }
    }
}
