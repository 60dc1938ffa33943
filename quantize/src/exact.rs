//! The best clusters in one dimension, by dynamic programming.
//!
//! On a line the best clusters are runs of the sorted values, so the best `k` runs follow from the
//! best `k - 1` of every prefix [Fisher58]. The start of the last run never moves left as the
//! prefix grows, which allows divide and conquer: O(k n log n) time.

use crate::table::Table;

/// Largest number of table cells (distinct values times clusters): 256 MB of run starts.
const MOST_CELLS: usize = 1 << 26;

/// The one column that varies, if there is just one and `k` is small enough for memory.
pub(crate) fn column(table: &Table, k: usize) -> Option<usize> {
    let varies = |column: &usize| {
        (1..table.len()).any(|row| table.row(row)[*column] != table.row(0)[*column])
    };
    let mut varying = (0..table.columns()).filter(varies);
    let column = varying.next()?;
    let fits = table.len().checked_mul(k).is_some_and(|cells| cells <= MOST_CELLS);
    (varying.next().is_none() && fits).then_some(column)
}

/// Labels of the rows for the `k` clusters of least weighted sum of squares of one column, from
/// left to right; as many as there are distinct values if they are fewer.
pub(crate) fn labels(table: &Table, column: usize, k: usize) -> Vec<u32> {
    let mut order: Vec<u32> = (0..table.len() as u32).collect();
    let value = |row: u32| table.row(row as usize)[column];
    // Equal values in the order of their weights: then sums do not depend on the rows' order.
    let weight = |row: u32| table.weights()[row as usize];
    order.sort_unstable_by(|a, b| {
        value(*a).total_cmp(&value(*b)).then(weight(*a).total_cmp(&weight(*b))).then(a.cmp(b))
    });
    let runs: Vec<&[u32]> = order.chunk_by(|a, b| value(*a) == value(*b)).collect();
    let is_weighted = table.weights().iter().any(|weight| *weight > 0.0);
    let distinct: Vec<[f64; 2]> = runs
        .iter()
        .map(|run| {
            let sum: f64 = run.iter().map(|row| weight(*row)).sum();
            [value(run[0]), if is_weighted { sum } else { run.len() as f64 }]
        })
        .collect();
    let starts = best_starts(&distinct, k.clamp(1, distinct.len().max(1)));
    let mut labels = vec![0; table.len()];
    for (index, run) in runs.iter().enumerate() {
        let label = starts.partition_point(|start| *start <= index) - 1;
        run.iter().for_each(|row| labels[*row as usize] = label as u32);
    }
    labels
}

/// First value of each of `k` runs of sorted, distinct `[value, weight]`.
fn best_starts(values: &[[f64; 2]], k: usize) -> Vec<usize> {
    let n = values.len();
    let spread = Spread::of(values);
    let mut cost: Vec<f64> = (0..=n).map(|end| spread.between(0, end)).collect();
    let mut choices = Vec::with_capacity(k.saturating_sub(1));
    for runs in 2..=k {
        let mut layer = Layer {
            spread: &spread,
            before: &cost,
            cost: vec![f64::INFINITY; n + 1],
            start: vec![0; n + 1],
        };
        layer.fill(runs..n + 1, runs - 1..n);
        let Layer { cost: next, start, .. } = layer;
        cost = next;
        choices.push(start);
    }
    let mut starts = vec![0; k];
    let mut end = n;
    for (run, choice) in choices.iter().enumerate().rev() {
        end = choice[end] as usize;
        starts[run + 1] = end;
    }
    starts
}

/// Weighted sums of squares of any run, from prefix sums.
struct Spread {
    /// For each prefix: weight, sum and sum of squares about the middle of all values.
    prefix: Vec<[f64; 3]>,
}

impl Spread {
    fn of(values: &[[f64; 2]]) -> Self {
        let ends = values.first().zip(values.last());
        let middle = ends.map_or(0.0, |(first, last)| first[0] / 2.0 + last[0] / 2.0);
        let mut sums = [0.0; 3];
        let mut prefix = vec![sums];
        for [value, weight] in values {
            let x = value - middle;
            sums = [sums[0] + weight, sums[1] + weight * x, sums[2] + weight * x * x];
            prefix.push(sums);
        }
        Self { prefix }
    }

    /// Weighted sum of squared distances to the mean of values `start..end`.
    fn between(&self, start: usize, end: usize) -> f64 {
        let [weight, sum, squares] =
            std::array::from_fn(|i| self.prefix[end][i] - self.prefix[start][i]);
        // Rounding may leave a run of equal values a hair below zero.
        if weight > 0.0 { (squares - sum * sum / weight).max(0.0) } else { 0.0 }
    }
}

/// Best costs of all prefixes with one run more than `before`.
struct Layer<'a> {
    spread: &'a Spread,
    before: &'a [f64],
    cost: Vec<f64>,
    /// Where the last run of each prefix starts; of equally good ones the first.
    start: Vec<u32>,
}

impl Layer<'_> {
    /// Fills the prefixes with lengths in `ends`, whose last runs start in `starts`.
    fn fill(&mut self, ends: std::ops::Range<usize>, starts: std::ops::Range<usize>) {
        if ends.is_empty() {
            return;
        }
        let end = ends.start + ends.len() / 2;
        let mut best = starts.start;
        for start in starts.start..starts.end.min(end) {
            let cost = self.before[start] + self.spread.between(start, end);
            if cost < self.cost[end] {
                (self.cost[end], best) = (cost, start);
            }
        }
        self.start[end] = best as u32;
        self.fill(ends.start..end, starts.start..best + 1);
        self.fill(end + 1..ends.end, best..starts.end);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    /// Least sum of squares over every way to cut sorted values into `k` runs.
    fn brute(values: &[[f64; 2]], k: usize) -> f64 {
        let of = |run: &[[f64; 2]]| {
            let weight: f64 = run.iter().map(|v| v[1]).sum();
            let mean = run.iter().map(|v| v[0] * v[1]).sum::<f64>() / weight;
            run.iter().map(|v| v[1] * (v[0] - mean).powi(2)).sum::<f64>()
        };
        if k == 1 {
            return of(values);
        }
        let last_run = |start| of(&values[start..]) + brute(&values[..start], k - 1);
        (k - 1..values.len()).map(last_run).fold(f64::INFINITY, f64::min)
    }

    #[test]
    fn dynamic_programming_finds_what_trying_every_cut_finds() {
        let mut random = Seed(3).stream("values", 0);
        for n in 1..=9 {
            let mut values: Vec<[f64; 2]> =
                (0..n).map(|_| [random.normal(), 0.1 + random.unit()]).collect();
            values.sort_by(|a, b| a[0].total_cmp(&b[0]));
            for k in 1..=n {
                let starts = best_starts(&values, k);
                let spread = Spread::of(&values);
                let ends = starts[1..].iter().copied().chain([n]);
                let cost: f64 = starts.iter().zip(ends).map(|(s, e)| spread.between(*s, e)).sum();
                let least = brute(&values, k);
                assert!((cost - least).abs() <= 1e-12 * (1.0 + least), "n {n} k {k}");
            }
        }
    }
}
