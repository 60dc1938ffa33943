//! Improving a partition by Lloyd's steps.
//!
//! A step gives every sample to the nearest centre and moves every centre to the mean of its
//! samples; neither can raise the distortion [Lloyd82].

use crate::nearest::Centres;
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

/// The nearest centre of every sample.
pub(crate) fn nearest(samples: &Samples, centres: &[f32]) -> Vec<u32> {
    let dims = samples.dims;
    let centres = Centres::of(centres, dims);
    let mut labels = vec![0; samples.len()];
    let chunks = labels.par_chunks_mut(CHUNK).zip(samples.rows.par_chunks(CHUNK * dims));
    chunks.for_each(|(labels, rows)| {
        centres.nearest_of_rows(rows, |offset, near| labels[offset] = near.label);
    });
    labels
}

/// Gives every sample to its nearest centre, and sums up those of each.
fn assign(samples: &Samples, centres: &[f32], k: usize) -> (Vec<u32>, Sums) {
    let dims = samples.dims;
    let centres = Centres::of(centres, dims);
    let mut labels = vec![0; samples.len()];
    let chunks = labels.par_chunks_mut(CHUNK).enumerate().map(|(chunk, labels)| {
        let mut sums = Sums::new(dims, k);
        let first = chunk * CHUNK;
        let rows = &samples.rows[first * dims..][..labels.len() * dims];
        centres.nearest_of_rows(rows, |offset, near| {
            let weight = samples.weights[first + offset];
            labels[offset] = near.label;
            sums.add(near.label, &rows[offset * dims..][..dims], weight);
            sums.distortion += f64::from(weight) * f64::from(near.distance);
        });
        sums
    });
    let parts = chunks.collect();
    (labels, Sums::total(dims, k, parts))
}
