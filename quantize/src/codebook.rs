//! The code book of any table of numbers: centres, and the centre that stands for each row.

use crate::condense::{cells_for, condensed};
use crate::exact;
use crate::refine::{Partition, descend, descend_from, lloyd};
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

    /// Gathers clusters of samples: numbers those in use from 0 and takes their means.
    fn of_samples(table: &Table, samples: &Samples, labels: &[u32]) -> Self {
        let mut of_rows = vec![0; labels.len()];
        for (row, label) in samples.order.iter().zip(labels) {
            of_rows[*row as usize] = *label;
        }
        Self::of_labels(table, &samples.order, of_rows)
    }

    /// Takes means in the order of `order`, which does not depend on the order of the rows.
    fn of_labels(table: &Table, order: &[u32], mut labels: Vec<u32>) -> Self {
        let used = number_from_zero(&mut labels);
        let columns = table.columns();
        let (sums, weights) = weigh(table, order, &labels, used, |row| table.weights()[row]);
        let mut centres = divide(&sums, &weights, columns);
        if weights.contains(&0.0) {
            let (sums, counts) = weigh(table, order, &labels, used, |_| 1.0);
            let plain = divide(&sums, &counts, columns);
            for (at, centre) in centres.iter_mut().enumerate() {
                if weights[at / columns] == 0.0 {
                    *centre = plain[at];
                }
            }
        }
        Self { columns, centres, labels }
    }
}

/// Weighted sums of the rows of each cluster, and the clusters' weights.
fn weigh(
    table: &Table,
    order: &[u32],
    labels: &[u32],
    clusters: usize,
    weight: impl Fn(usize) -> f64,
) -> (Vec<f64>, Vec<f64>) {
    let columns = table.columns();
    let mut sums = vec![0.0; clusters * columns];
    let mut weights = vec![0.0; clusters];
    for row in order.iter().map(|row| *row as usize) {
        let (label, weight) = (labels[row] as usize, weight(row));
        weights[label] += weight;
        let sums = &mut sums[label * columns..][..columns];
        sums.iter_mut().zip(table.row(row)).for_each(|(sum, value)| *sum += weight * value);
    }
    (sums, weights)
}

fn divide(sums: &[f64], weights: &[f64], columns: usize) -> Vec<f64> {
    sums.iter().enumerate().map(|(at, sum)| sum / weights[at / columns]).collect()
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
    let samples = Samples::of(table);
    let exact_column = match mode {
        Mode::Exact => {
            let labels = (0..table.len() as u32).collect();
            return (Codebook::of_labels(table, &samples.order, labels), samples.order);
        }
        Mode::Paper => None,
        Mode::Fast | Mode::Best => exact::column(table, k),
    };
    if let Some(column) = exact_column {
        let labels = exact::labels(table, column, k);
        return (Codebook::of_labels(table, &samples.order, labels), samples.order);
    }
    let partition = match mode {
        Mode::Paper => split_samples(&samples, k),
        Mode::Fast => fast(&samples, k),
        Mode::Best | Mode::Exact => search(&samples, k),
    };
    (Codebook::of_samples(table, &samples, &partition.labels), samples.order)
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
            return descend_from(samples, centres, 0, 0.0).partition;
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
    Codebook::of_samples(table, &samples, &partition.labels)
}

/// Gains of up to `k - 1` cuts in the order in which splitting makes them: falls of the weighted
/// sum of squared distances, in the table's own units.
pub(crate) fn gains(table: &Table, k: usize) -> Vec<f64> {
    let samples = Samples::of(table);
    cut_tree(&samples, k).gains.into_iter().map(|gain| gain * samples.unit).collect()
}
