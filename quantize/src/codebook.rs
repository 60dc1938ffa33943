//! The code book of any table of numbers: centres, and the centre that stands for each row.

use crate::condense::{cells_for, condensed};
use crate::exact;
use crate::refine::{Partition, descend, lloyd, nearest};
use crate::samples::Samples;
use crate::search::search;
use crate::split::cut_tree;
use crate::table::Table;

weald_contract::words! {
    /// How long clusters are improved.
    pub enum Mode {
        /// Splitting alone, as [Wan88] and [Deussen98] do.
        Paper = "paper",
        /// Splitting and three steps of Lloyd, of long tables on a condensed one; exact when one
        /// number varies.
        Fast = "fast",
        /// Steps until they settle, swaps that merge and split, and several starts where there
        /// are few clusters; exact when one number varies.
        Best = "best",
        /// Each row for itself, whatever the number asked for: what others are measured against.
        Exact = "exact",
    }
}

/// Lloyd's steps of [`Mode::Fast`]: three bring the error of splitting from 1.16-1.31 times the
/// best known one to 1.03-1.07 times, at a fraction of the time of converging.
const FAST_STEPS: usize = 3;

/// Lloyd's steps on a condensed table, where a step costs as little as it has cells.
const FAST_CELL_STEPS: usize = 8;

/// Clusters of a table's rows. No cluster is empty.
#[derive(Clone, Debug, PartialEq)]
pub struct Codebook {
    /// Columns of the table.
    pub columns: usize,
    /// Centre after centre, `columns` numbers each: the weighted mean of the cluster's rows, or
    /// the plain mean where they carry no weight.
    pub centres: Vec<f64>,
    /// Cluster of each row.
    pub labels: Vec<u32>,
}

impl Codebook {
    /// Number of clusters.
    pub fn len(&self) -> usize {
        self.centres.len() / self.columns.max(1)
    }

    /// Whether there is no cluster, as of a table without rows.
    pub fn is_empty(&self) -> bool {
        self.centres.is_empty()
    }

    /// The numbers of a centre.
    ///
    /// # Panics
    /// When there is no such cluster.
    pub fn centre(&self, label: usize) -> &[f64] {
        &self.centres[label * self.columns..][..self.columns]
    }

    /// The row of each cluster that is nearest to its centre; the first of equally near ones.
    ///
    /// # Panics
    /// When the table is another than the one that was clustered, and shorter or narrower.
    pub fn nearest_rows(&self, table: &Table) -> Vec<usize> {
        let mut nearest = vec![(f64::INFINITY, 0); self.len()];
        for (row, label) in self.labels.iter().enumerate() {
            let pairs = table.row(row).iter().zip(self.centre(*label as usize));
            let apart = pairs.map(|(value, centre)| (value - centre).powi(2)).sum::<f64>();
            let found = &mut nearest[*label as usize];
            if apart < found.0 {
                *found = (apart, row);
            }
        }
        nearest.into_iter().map(|(_, row)| row).collect()
    }

    /// Weighted mean of the squared distances between rows and their centres; the plain mean
    /// when no row carries weight, and 0 without rows.
    ///
    /// # Panics
    /// When the table is another than the one that was clustered, and shorter or narrower.
    pub fn distortion(&self, table: &Table) -> f64 {
        let is_weighted = table.weights().iter().any(|weight| *weight > 0.0);
        let (mut sum, mut total) = (0.0, 0.0);
        for (index, label) in self.labels.iter().enumerate() {
            let weight = if is_weighted { table.weights()[index] } else { 1.0 };
            let pairs = table.row(index).iter().zip(self.centre(*label as usize));
            sum += weight * pairs.map(|(value, centre)| (value - centre).powi(2)).sum::<f64>();
            total += weight;
        }
        if total > 0.0 { sum / total } else { 0.0 }
    }

    /// Gathers the clusters of samples: numbers those in use from 0 and takes their means in the
    /// order of the samples, which does not depend on the order of the rows.
    fn of_samples(table: &Table, order: &[u32], mut labels: Vec<u32>) -> Self {
        let used = number_from_zero(&mut labels);
        let columns = table.columns();
        let mut of_clusters = sums(table, order, &labels, used, |row| table.weights()[row]);
        let is_light = |sums: &[f64]| sums[columns] == 0.0;
        if of_clusters.chunks_exact(columns + 1).any(is_light) {
            let plain = sums(table, order, &labels, used, |_| 1.0);
            let pairs =
                of_clusters.chunks_exact_mut(columns + 1).zip(plain.chunks_exact(columns + 1));
            pairs
                .filter(|(sums, _)| is_light(sums))
                .for_each(|(sums, plain)| sums.copy_from_slice(plain));
        }
        let mut of_rows = vec![0; labels.len()];
        for (row, label) in order.iter().zip(labels) {
            of_rows[*row as usize] = label;
        }
        Self { columns, centres: means(&of_clusters, columns), labels: of_rows }
    }

    /// [`Self::of_samples`], from a cluster for each row.
    fn of_rows(table: &Table, order: &[u32], labels: &[u32]) -> Self {
        Self::of_samples(table, order, order.iter().map(|row| labels[*row as usize]).collect())
    }
}

/// For each cluster the weighted sums of its rows' numbers, then its weight.
fn sums(
    table: &Table,
    order: &[u32],
    labels: &[u32],
    clusters: usize,
    weigh: impl Fn(usize) -> f64,
) -> Vec<f64> {
    let columns = table.columns();
    let mut sums = vec![0.0; clusters * (columns + 1)];
    for (row, label) in order.iter().zip(labels) {
        let weight = weigh(*row as usize);
        let sums = &mut sums[*label as usize * (columns + 1)..][..=columns];
        let (total, sums) = sums.split_last_mut().expect("a weight");
        sums.iter_mut()
            .zip(table.row(*row as usize))
            .for_each(|(sum, value)| *sum += weight * value);
        *total += weight;
    }
    sums
}

fn means(sums: &[f64], columns: usize) -> Vec<f64> {
    let of_cluster = |sums: &[f64]| {
        let weight = sums[columns];
        sums[..columns].iter().map(|sum| sum / weight).collect::<Vec<_>>()
    };
    sums.chunks_exact(columns + 1).flat_map(of_cluster).collect()
}

/// Numbers the labels in use from 0, keeping their order, and returns how many they are.
fn number_from_zero(labels: &mut [u32]) -> usize {
    let k = labels.iter().max().map_or(0, |label| *label as usize + 1);
    let mut numbers = vec![u32::MAX; k];
    labels.iter().for_each(|label| numbers[*label as usize] = 0);
    let mut used = 0;
    for number in numbers.iter_mut().filter(|number| **number == 0) {
        *number = used;
        used += 1;
    }
    labels.iter_mut().for_each(|label| *label = numbers[*label as usize]);
    used as usize
}

/// Clusters the rows of a table into at most `k` clusters (at least one, if there are rows); with
/// [`Mode::Exact`] each row is one.
///
/// Fewer result when fewer distinct rows carry weight. Rows without weight belong to a cluster,
/// but pull at no centre. The same rows in another order give the same clusters, and so does any
/// number of threads.
pub fn cluster(table: &Table, k: usize, mode: Mode) -> Codebook {
    cluster_in_order(table, k, mode).0
}

/// [`cluster`], and the rows in an order that depends on their content alone: sums taken along it
/// are those of any permutation of the table.
pub(crate) fn cluster_in_order(table: &Table, k: usize, mode: Mode) -> (Codebook, Vec<u32>) {
    // All of it on a thread of the pool: many short steps need not wake another for each.
    rayon::scope(|_| clustered(table, k, mode))
}

fn clustered(table: &Table, k: usize, mode: Mode) -> (Codebook, Vec<u32>) {
    let samples = Samples::of(table);
    let exact_column = match mode {
        Mode::Exact => {
            let labels: Vec<u32> = (0..table.len() as u32).collect();
            return (Codebook::of_rows(table, &samples.order, &labels), samples.order);
        }
        Mode::Paper => None,
        Mode::Fast | Mode::Best => exact::column(table, k),
    };
    if let Some(column) = exact_column {
        let labels = exact::labels(table, column, k);
        return (Codebook::of_rows(table, &samples.order, &labels), samples.order);
    }
    let partition = match mode {
        Mode::Paper => split_samples(&samples, k),
        Mode::Fast => fast(&samples, k),
        Mode::Best | Mode::Exact => search(&samples, k),
    };
    (Codebook::of_samples(table, &samples.order, partition.labels), samples.order)
}

/// Splitting alone.
pub(crate) fn split_samples(samples: &Samples, k: usize) -> Partition {
    let tree = cut_tree(samples, k);
    Partition { k: tree.gains.len() + 1, labels: tree.labels }
}

/// Splitting and a few of Lloyd's steps; of a long table on a condensed one, whose centres all rows
/// then take.
fn fast(samples: &Samples, k: usize) -> Partition {
    if let Some(cells) = condensed(samples, cells_for(samples.len(), k)) {
        let start = split_samples(&cells, k);
        // With fewer clusters than asked for, the cells may lack rows that the table has.
        if start.k == k {
            let centres = descend(&cells, &start, FAST_CELL_STEPS).centres;
            return Partition { labels: nearest(samples, &centres), k };
        }
    }
    lloyd(samples, split_samples(samples, k), FAST_STEPS)
}

/// Splits the rows of a table into at most `k` clusters, without refinement [Wan88].
pub fn split(table: &Table, k: usize) -> Codebook {
    cluster(table, k, Mode::Paper)
}

/// Improves a code book by at most `steps` of Lloyd's steps; the distortion never rises.
///
/// # Panics
/// When `codebook` has not one label for each row of the table.
pub fn refine(table: &Table, codebook: &Codebook, steps: usize) -> Codebook {
    assert_eq!(table.len(), codebook.labels.len(), "a code book of another table");
    let samples = Samples::of(table);
    let labels = samples.order.iter().map(|row| codebook.labels[*row as usize]).collect();
    let start = Partition { labels, k: codebook.len() };
    let partition = lloyd(&samples, start, steps);
    Codebook::of_samples(table, &samples.order, partition.labels)
}

/// Gains of up to `k - 1` cuts in the order in which splitting makes them: falls of the weighted
/// sum of squared distances, in the table's own units.
pub(crate) fn gains(table: &Table, k: usize) -> Vec<f64> {
    let samples = Samples::of(table);
    cut_tree(&samples, k).gains.into_iter().map(|gain| gain * samples.unit).collect()
}
