//! Marks: whether the sizes of plants depend on those of their neighbours.

use crate::neighbors::Cells;
use crate::pattern::{Error, Pattern, Table, check_radii};
use crate::ripley::{Correction, pair_weight};
use crate::size::quantile;

/// The mark correlation at rising radii: mean product of the marks of two points r apart, over the
/// square of the mean mark [Stoyan94] §14. Below 1 neighbours are small: they compete.
///
/// Columns `r, theo, trans, iso`. Both means over pairs are smoothed with a Gaussian kernel whose
/// standard deviation is Silverman's rule [Silverman86] eq. 3.31 on the distances up to the largest
/// radius, as in spatstat; the sums here are exact where spatstat's are binned.
///
/// # Errors
/// Fewer than two points; another number of marks than of points; a mark that is negative or not
/// finite, named by its row; all marks zero; fewer than two pairs within the largest radius, or
/// all at one distance; radii that are not finite, negative or not rising.
pub fn mark_correlation(pattern: &Pattern, marks: &[f64], radii: &[f64]) -> Result<Table, Error> {
    let pairs = MarkedPairs::of(pattern, marks, radii)?;
    let columns = vec![
        ("r", radii.to_vec()),
        ("theo", vec![1.0; radii.len()]),
        ("trans", pairs.translated(marks)),
        ("iso", pairs.correlation(marks, |pair| pair.isotropic)),
    ];
    Ok(Table { name: "markcorr", columns })
}

/// The pairs of a pattern, found once for any marks that have the same mean.
pub(crate) struct MarkedPairs<'a> {
    radii: &'a [f64],
    pairs: Vec<Pair>,
    smoother: Smoother,
    mean: f64,
}

impl<'a> MarkedPairs<'a> {
    pub fn of(pattern: &Pattern, marks: &[f64], radii: &'a [f64]) -> Result<Self, Error> {
        pattern.check_pairs()?;
        check_radii(radii)?;
        let mean = mean_mark(pattern, marks)?;
        let pairs = Pair::all(pattern, radii.last().copied().unwrap_or(0.0));
        let smoother = Smoother::of(&pairs)?;
        Ok(Self { radii, pairs, smoother, mean })
    }

    /// The mark correlation with translation correction.
    pub fn translated(&self, marks: &[f64]) -> Vec<f64> {
        self.correlation(marks, |pair| pair.translation)
    }

    fn correlation(&self, marks: &[f64], weight: fn(&Pair) -> f64) -> Vec<f64> {
        let products: Vec<f64> =
            self.pairs.iter().map(|pair| marks[pair.a] * marks[pair.b]).collect();
        let weights: Vec<f64> = self.pairs.iter().map(weight).collect();
        let ratio = |r: &f64| self.smoother.ratio(&self.pairs, &products, &weights, *r);
        self.radii.iter().map(|r| ratio(r) / (self.mean * self.mean)).collect()
    }
}

fn mean_mark(pattern: &Pattern, marks: &[f64]) -> Result<f64, Error> {
    if marks.len() != pattern.len() {
        return Err(Error::Unmatched { sizes: marks.len(), points: pattern.len() });
    }
    if let Some(row) = marks.iter().position(|mark| !(mark.is_finite() && *mark >= 0.0)) {
        let right = "a finite number of at least 0 is right";
        return Err(Error::BadValue { what: "the mark", row, value: marks[row], right });
    }
    let mean = marks.iter().sum::<f64>() / marks.len() as f64;
    if mean > 0.0 { Ok(mean) } else { Err(Error::NoSpread { what: "marks" }) }
}

/// Two points, the nearer pairs first.
struct Pair {
    /// Numbers in the pattern.
    a: usize,
    b: usize,
    distance: f64,
    /// Weights by the edge corrections, mean of both directions.
    translation: f64,
    isotropic: f64,
}

impl Pair {
    /// All pairs up to a distance, once each, sorted by it.
    fn all(pattern: &Pattern, reach: f64) -> Vec<Self> {
        let cells = Cells::new(pattern, reach);
        let window = pattern.window();
        let mut pairs = Vec::new();
        for index in 0..cells.points.len() {
            cells.for_around(cells.points[index], reach, |other, squared, apart| {
                if other <= index {
                    return;
                }
                let distance = squared.sqrt();
                let weight = |correction, center: usize| {
                    pair_weight(correction, window, cells.points[center], distance, apart)
                };
                let isotropic =
                    weight(Correction::Isotropic, index) + weight(Correction::Isotropic, other);
                pairs.push(Pair {
                    a: cells.numbers[index],
                    b: cells.numbers[other],
                    distance,
                    translation: weight(Correction::Translation, index),
                    isotropic: isotropic / 2.0,
                });
            });
        }
        pairs.sort_by(|a, b| a.distance.total_cmp(&b.distance).then((a.a, a.b).cmp(&(b.a, b.b))));
        pairs
    }
}

/// A Gaussian kernel over distances.
struct Smoother {
    deviation: f64,
}

/// Standard deviations beyond which the kernel is below the rounding of its sum.
const KERNEL_REACH: f64 = 8.5;

impl Smoother {
    /// Silverman's rule on ordered pairs, so that each distance counts twice.
    fn of(pairs: &[Pair]) -> Result<Self, Error> {
        if pairs.len() < 2 {
            let what = "pairs of points within the largest radius";
            return Err(Error::TooFew { what, found: pairs.len(), needed: 2 });
        }
        let twice: Vec<f64> =
            pairs.iter().flat_map(|pair| [pair.distance, pair.distance]).collect();
        let n = twice.len() as f64;
        let mean = twice.iter().sum::<f64>() / n;
        let squares: f64 = twice.iter().map(|distance| (distance - mean).powi(2)).sum();
        let deviation = (squares / (n - 1.0)).sqrt();
        let quartiles = quantile(&twice, 0.75)? - quantile(&twice, 0.25)?;
        let spread = match quartiles > 0.0 {
            true => deviation.min(quartiles / 1.34),
            false => deviation,
        };
        if spread <= 0.0 {
            return Err(Error::NoSpread { what: "distances between points" });
        }
        Ok(Self { deviation: 0.9 * spread * libm::pow(n, -0.2) })
    }

    /// Weighted mean of the values of pairs about a distance; NaN where there are none.
    fn ratio(&self, pairs: &[Pair], values: &[f64], weights: &[f64], r: f64) -> f64 {
        let reach = KERNEL_REACH * self.deviation;
        let first = pairs.partition_point(|pair| pair.distance < r - reach);
        let (mut of_values, mut of_pairs) = (0.0, 0.0);
        let rest = pairs[first..].iter().zip(&values[first..]).zip(&weights[first..]);
        for ((pair, value), weight) in rest.take_while(|((pair, _), _)| pair.distance <= r + reach)
        {
            let t = (pair.distance - r) / self.deviation;
            let kernel = weight * libm::exp(-0.5 * t * t);
            of_values += kernel * value;
            of_pairs += kernel;
        }
        of_values / of_pairs
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Window;
    use weald_contract::Seed;

    const FIELD: Window = Window { x: [0.0, 20.0], y: [0.0, 20.0] };

    fn random(n: u64) -> Pattern {
        let mut stream = Seed(9).stream("points", 0);
        let points = (0..n).map(|_| [stream.range(0.0, 20.0), stream.range(0.0, 20.0)]).collect();
        Pattern::new(points, FIELD).unwrap()
    }

    #[test]
    fn equal_marks_have_correlation_one_at_all_distances() {
        let table = mark_correlation(&random(80), &[3.0; 80], &[0.0, 1.0, 4.0]).unwrap();
        for name in ["trans", "iso"] {
            let values = table.column(name).unwrap();
            assert!(values.iter().all(|k| (k - 1.0).abs() < 1e-12), "{values:?}");
        }
    }

    #[test]
    fn marks_that_do_not_know_their_place_have_correlation_near_one() {
        let mut stream = Seed(10).stream("marks", 0);
        let marks: Vec<f64> = (0..2000).map(|_| stream.unit()).collect();
        let table = mark_correlation(&random(2000), &marks, &[0.5, 1.0, 2.0]).unwrap();
        // About 20,000 pairs are within a bandwidth: three standard errors are 1 %.
        for k in table.column("trans").unwrap() {
            assert!((k - 1.0).abs() < 0.03, "{k}");
        }
    }

    #[test]
    fn a_negative_mark_is_named_by_its_row() {
        let error = mark_correlation(&random(3), &[1.0, 2.0, -1.0], &[0.0, 9.0]).unwrap_err();
        assert!(matches!(error, Error::BadValue { row: 2, .. }));
    }
}
