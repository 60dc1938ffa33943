//! Variance-based splitting with importance weights [Wan88].
//!
//! All rows start as one cluster. Again and again the cluster is cut whose best cut lowers the
//! weighted sum of squared distances most, across an axis, where the sum falls most. One heap
//! holds the clusters by that gain. [Wan88] takes the cluster of largest variance instead; by
//! gain the error is up to 1 % lower for four or fewer axes and differs by 0.3 % for eight.
//!
//! Each axis is sorted once. A cut then parts the sorted lists stably, as decision trees do
//! [Shafer96], so every list of every cluster stays sorted, and a cut is found by one pass of
//! prefix sums: O(n d log n) once and O(n d) for each level of the tree.

use crate::samples::{NUMBER_BITS, Samples, key, of_key, sort_keys};
use rayon::prelude::*;
use std::cmp::Ordering;
use std::collections::BinaryHeap;

/// Clusters that splitting found.
pub(crate) struct Tree {
    /// Cluster of each sample.
    pub labels: Vec<u32>,
    /// Gain of each cut in the order they were made: the fall of the weighted sum of squared
    /// distances, in the units of [`Samples`]. One fewer than there are clusters.
    pub gains: Vec<f64>,
}

/// Splits samples into at most `k` clusters; fewer when fewer distinct ones carry weight.
pub(crate) fn cut_tree(samples: &Samples, k: usize) -> Tree {
    let mut axes: Vec<Axis> =
        (0..samples.dims).into_par_iter().map(|dim| Axis::sorted(samples, dim)).collect();
    let mut goes_right = vec![false; samples.len()];
    let whole = Cluster { start: 0, end: samples.len(), label: 0 };
    let mut clusters = vec![whole];
    let mut heap = BinaryHeap::from_iter(find_cut(&axes, whole));
    let mut gains = Vec::new();
    while clusters.len() < k {
        let Some(cut) = heap.pop() else { break };
        let right_label = clusters.len() as u32;
        let [left, right] = cut.part(&mut axes, &mut goes_right, right_label);
        clusters[left.label as usize] = left;
        clusters.push(right);
        gains.push(cut.gain);
        if clusters.len() < k {
            heap.extend([left, right].into_iter().filter_map(|part| find_cut(&axes, part)));
        }
    }
    Tree { labels: labels(samples.len(), &clusters, axes.first()), gains }
}

/// Gain of the best cut of a set of samples across any axis; 0 when none gains.
pub(crate) fn best_gain(samples: &Samples, members: &[u32]) -> Option<(usize, f32, f64)> {
    let mut best: Option<(usize, f32, f64)> = None;
    for dim in 0..samples.dims {
        let entries = sorted_entries(samples, dim, members.iter().copied());
        let Some(cut) = best_position(&entries) else { continue };
        if best.is_none_or(|(_, _, gain)| cut.gain > gain) {
            best = Some((dim, entries[cut.position - 1].value, cut.gain));
        }
    }
    best
}

/// One number of one sample, with what a cut needs beside it in memory.
#[derive(Clone, Copy, Default)]
struct Entry {
    value: f32,
    weight: f32,
    sample: u32,
}

/// All samples sorted along one axis, inside each cluster's range.
struct Axis {
    entries: Vec<Entry>,
    /// Room for the right part while entries are parted.
    scratch: Vec<Entry>,
}

impl Axis {
    fn sorted(samples: &Samples, dim: usize) -> Self {
        let entries = sorted_entries(samples, dim, 0..samples.len() as u32);
        Self { scratch: vec![Entry::default(); entries.len()], entries }
    }

    /// Moves the entries that stay left to the front of `range`, keeping both parts in order.
    fn part(&mut self, range: std::ops::Range<usize>, goes_right: &[bool]) {
        let entries = &mut self.entries[range];
        let (mut left, mut right) = (0, 0);
        for index in 0..entries.len() {
            let entry = entries[index];
            let is_right = goes_right[entry.sample as usize];
            // Write to both and advance one: the side is as good as random, a branch would
            // be mispredicted every other time.
            entries[left] = entry;
            self.scratch[right] = entry;
            left += usize::from(!is_right);
            right += usize::from(is_right);
        }
        entries[left..].copy_from_slice(&self.scratch[..right]);
    }
}

/// Entries of some samples, given by rising number, sorted along one axis.
fn sorted_entries(samples: &Samples, dim: usize, members: impl Iterator<Item = u32>) -> Vec<Entry> {
    let value = |sample: u32| samples.rows[sample as usize * samples.dims + dim];
    let keys = sort_keys(members.map(|sample| key(value(sample), sample)).collect(), NUMBER_BITS);
    let entry = |key: u64| {
        let (value, sample) = of_key(key);
        Entry { value, weight: samples.weights[sample as usize], sample }
    };
    keys.into_iter().map(entry).collect()
}

/// A range of every axis that holds the same samples.
#[derive(Clone, Copy)]
struct Cluster {
    start: usize,
    end: usize,
    label: u32,
}

/// Where a cluster is best cut.
struct Cut {
    gain: f64,
    cluster: Cluster,
    axis: usize,
    /// First entry of the right part, counted from the cluster's start.
    position: usize,
}

/// Below this number of entries, handing axes to other threads costs more than it saves.
const PARALLEL: usize = 16_384;

impl Cut {
    /// Parts every axis; the left part keeps the cluster's label.
    fn part(&self, axes: &mut [Axis], goes_right: &mut [bool], right_label: u32) -> [Cluster; 2] {
        let Cluster { start, end, label } = self.cluster;
        let middle = start + self.position;
        for (index, entry) in axes[self.axis].entries[start..end].iter().enumerate() {
            goes_right[entry.sample as usize] = index >= self.position;
        }
        let part = |(index, axis): (usize, &mut Axis)| {
            if index != self.axis {
                axis.part(start..end, goes_right);
            }
        };
        if end - start < PARALLEL {
            axes.iter_mut().enumerate().for_each(part);
        } else {
            axes.par_iter_mut().enumerate().for_each(part);
        }
        [Cluster { start, end: middle, label }, Cluster { start: middle, end, label: right_label }]
    }
}

/// The best cut of a cluster over all axes; the first axis wins a tie.
fn find_cut(axes: &[Axis], cluster: Cluster) -> Option<Cut> {
    let range = cluster.start..cluster.end;
    let on_axis = |axis: &Axis| best_position(&axis.entries[range.clone()]);
    let found: Vec<Option<Position>> = if range.len() < PARALLEL {
        axes.iter().map(on_axis).collect()
    } else {
        axes.par_iter().map(on_axis).collect()
    };
    let cuts = found.into_iter().enumerate().filter_map(|(axis, found)| {
        found.map(|Position { gain, position }| Cut { gain, cluster, axis, position })
    });
    cuts.reduce(|best, cut| if cut.gain > best.gain { cut } else { best })
}

/// A cut of one sorted list.
struct Position {
    gain: f64,
    position: usize,
}

/// The cut of a sorted list that lowers its weighted sum of squares most.
///
/// With values counted from the weighted mean, the left part's weight `w0` and sum `s0` and the
/// whole weight `w`, the sum of squares falls by `s0² w / (w0 (w - w0))`: nothing cancels. A cut
/// falls between two distinct values and leaves weight on both sides.
fn best_position(entries: &[Entry]) -> Option<Position> {
    let last_weighted = entries.iter().rposition(|entry| entry.weight > 0.0)?;
    let (mut weight, mut sum) = (0.0, 0.0);
    for entry in entries {
        weight += f64::from(entry.weight);
        sum += f64::from(entry.weight) * f64::from(entry.value);
    }
    let mean = sum / weight;
    let (mut left_weight, mut left_sum) = (0.0, 0.0);
    let (mut best, mut position) = (0.0, 0);
    for (index, pair) in entries[..=last_weighted].windows(2).enumerate() {
        left_weight += f64::from(pair[0].weight);
        left_sum += f64::from(pair[0].weight) * (f64::from(pair[0].value) - mean);
        let product = left_weight * (weight - left_weight);
        let score = left_sum * left_sum / product;
        if score > best && pair[0].value < pair[1].value && product > 0.0 {
            (best, position) = (score, index + 1);
        }
    }
    (position > 0).then_some(Position { gain: best * weight, position })
}

fn labels(len: usize, clusters: &[Cluster], axis: Option<&Axis>) -> Vec<u32> {
    let mut labels = vec![0; len];
    for cluster in clusters {
        for entry in axis.map_or(&[][..], |axis| &axis.entries[cluster.start..cluster.end]) {
            labels[entry.sample as usize] = cluster.label;
        }
    }
    labels
}

impl Ord for Cut {
    /// By gain; of equal gains the lower label is the greater, and is cut first.
    fn cmp(&self, other: &Self) -> Ordering {
        let gain = self.gain.total_cmp(&other.gain);
        gain.then_with(|| other.cluster.label.cmp(&self.cluster.label))
    }
}

impl PartialOrd for Cut {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Cut {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Cut {}
