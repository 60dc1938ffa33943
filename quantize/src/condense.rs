//! Fewer samples that stand for many, so that a search need not look at all of them.
//!
//! Long tables are thinned to a weighted sample, in which the weighted sum over any set of rows
//! is kept on average; or condensed into the means of many small cells, in which the clusters of
//! a search differ from those of all rows by less than the cells are wide [HarPeled04].

use crate::samples::Samples;

/// A systematic draw of about `most` rows, one after the other.
///
/// Half of the chance is shared out by weight, half alike: heavy rows are never missed, nor are
/// regions of light ones. Rows are drawn at equal steps of summed chance; that needs no random
/// numbers, and is even along the order in which they come.
pub(crate) struct Draw {
    /// Draws expected for each row, and for each unit of its weight.
    each: f64,
    by_weight: f64,
    /// Draws expected of the rows that went by.
    passed: f64,
}

impl Draw {
    /// A draw from `rows` rows that weigh `weight` together.
    pub fn new(rows: u64, weight: f64, most: usize) -> Self {
        let alike = most as f64 / rows.max(1) as f64;
        match weight > 0.0 {
            true => Self { each: alike / 2.0, by_weight: most as f64 / 2.0 / weight, passed: 0.0 },
            false => Self { each: alike, by_weight: 0.0, passed: 0.0 },
        }
    }

    /// Draws so far.
    fn drawn(&self) -> u64 {
        (self.passed + 0.5) as u64
    }

    /// Passes by rows that others look at.
    pub fn skip(&mut self, rows: u64, weight: f64) {
        self.passed += self.each * rows as f64 + self.by_weight * weight;
    }

    /// What the next row, of this weight, weighs in the sample; `None` when it is not drawn.
    pub fn weight_of(&mut self, weight: f64) -> Option<f64> {
        let expected = self.each + self.by_weight * weight;
        let before = self.drawn();
        self.passed += expected;
        let draws = self.drawn() - before;
        (draws > 0).then(|| weight * draws as f64 / expected)
    }
}

/// About `most` samples drawn from many, or `None` when there are less than twice as many.
pub(crate) fn thinned(samples: &Samples, most: usize) -> Option<Samples> {
    if most == 0 || samples.len() / 2 < most {
        return None;
    }
    let total: f64 = samples.weights.iter().map(|weight| f64::from(*weight)).sum();
    let mut draw = Draw::new(samples.len() as u64, total, most);
    let mut thin = Samples {
        order: Vec::with_capacity(most),
        rows: Vec::with_capacity(most * samples.dims),
        dims: samples.dims,
        weights: Vec::with_capacity(most),
        unit: samples.unit,
    };
    for (index, weight) in samples.weights.iter().enumerate() {
        if let Some(weight) = draw.weight_of(f64::from(*weight)) {
            thin.order.push(index as u32);
            thin.rows.extend_from_slice(samples.row(index));
            thin.weights.push(weight as f32);
        }
    }
    Some(thin)
}

/// Cells of a condensed table at least, cells for each cluster where clusters are many, and rows for
/// each cell where rows are many.
const CELLS: usize = 1 << 12;
const CELLS_A_CLUSTER: usize = 64;
const ROWS_A_CELL: usize = 64;

/// Cells in which `k` clusters of `rows` rows are sought.
pub(crate) fn cells_for(rows: usize, k: usize) -> usize {
    CELLS.max(k.saturating_mul(CELLS_A_CLUSTER)).max(rows / ROWS_A_CELL)
}

/// Weighted means of about `cells` runs of samples, or `None` when there are less than four times
/// as many samples.
///
/// Runs follow the curve along which samples lie, so that they are small in all columns. They end
/// where [`Draw`] would draw a sample: heavy samples are cells of their own, and light regions are
/// not left to a few.
pub(crate) fn condensed(samples: &Samples, cells: usize) -> Option<Samples> {
    if cells == 0 || samples.len() / 4 < cells || samples.dims == 0 {
        return None;
    }
    let total: f64 = samples.weights.iter().map(|weight| f64::from(*weight)).sum();
    let mut draw = Draw::new(samples.len() as u64, total, cells);
    let (mut rows, mut weights) = (Vec::new(), Vec::new());
    let (mut sums, mut sum) = (vec![0.0; samples.dims], 0.0);
    for (index, weight) in samples.weights.iter().enumerate() {
        let weight = f64::from(*weight);
        sum += weight;
        sums.iter_mut().zip(samples.row(index)).for_each(|(s, x)| *s += weight * f64::from(*x));
        let ends = draw.weight_of(weight).is_some() || index + 1 == samples.len();
        if ends && sum > 0.0 {
            rows.extend(sums.iter().map(|s| (s / sum) as f32));
            weights.push(sum as f32);
            sums.fill(0.0);
            sum = 0.0;
        }
    }
    let order = (0..weights.len() as u32).collect();
    Some(Samples { order, rows, dims: samples.dims, weights, unit: samples.unit })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Table;
    use weald_contract::Seed;

    fn samples(rows: usize) -> Samples {
        let mut random = Seed(4).stream("rows", 0);
        let values = (0..rows * 2).map(|_| random.normal()).collect();
        let weights = (0..rows).map(|_| random.unit().max(0.01).powi(-2)).collect();
        Samples::of(&Table::new(values, 2, weights).unwrap())
    }

    fn weight_and_mean(samples: &Samples) -> [f64; 2] {
        let sum = |value: &dyn Fn(usize) -> f64| (0..samples.len()).map(value).sum::<f64>();
        let weight = sum(&|i| f64::from(samples.weights[i]));
        [weight, sum(&|i| f64::from(samples.weights[i] * samples.row(i)[0])) / weight]
    }

    #[test]
    fn a_sample_keeps_weight_and_mean() {
        let all = samples(40_000);
        let [weight, mean] = weight_and_mean(&all);
        let thin = thinned(&all, 4000).unwrap();
        assert!((2000..=4000).contains(&thin.len()));
        let [thin_weight, thin_mean] = weight_and_mean(&thin);
        assert!((thin_weight / weight - 1.0).abs() < 0.02, "{thin_weight} of {weight}");
        assert!((thin_mean - mean).abs() < 0.01, "{thin_mean} for {mean}");
    }

    #[test]
    fn a_row_that_weighs_nearly_all_is_drawn() {
        let mut weights = vec![1e-9; 5000];
        weights[1234] = 1.0;
        let values = (0..5000).map(f64::from).collect();
        let all = Samples::of(&Table::new(values, 1, weights).unwrap());
        let thin = thinned(&all, 100).unwrap();
        let heavy = thin.weights.iter().position(|weight| *weight > 0.5).unwrap();
        assert_eq!(thin.order[heavy], 1234);
        assert!((thin.weights[heavy] - 1.0).abs() < 0.05);
    }

    #[test]
    fn cells_keep_weight_and_mean_to_rounding() {
        let all = samples(10_000);
        let cells = condensed(&all, 500).unwrap();
        // A heavy row would be drawn more than once, and is one cell.
        assert!((350..=501).contains(&cells.len()), "{}", cells.len());
        let ([weight, mean], [cell_weight, cell_mean]) =
            (weight_and_mean(&all), weight_and_mean(&cells));
        assert!((cell_weight / weight - 1.0).abs() < 1e-5 && (cell_mean - mean).abs() < 1e-5);
    }

    #[test]
    fn few_samples_stay_as_they_are() {
        let all = samples(100);
        assert!(thinned(&all, 51).is_none() && condensed(&all, 26).is_none());
        assert!(thinned(&all, 0).is_none() && condensed(&all, 0).is_none());
    }
}
