//! Sizes of plants: how unequal they are.

use crate::pattern::Error;

/// Moments and inequality of sizes.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Sizes {
    /// Number of plants.
    pub count: usize,
    /// Mean, in the unit of the sizes.
    pub mean: f64,
    /// Sample standard deviation (over n - 1) over the mean.
    pub variation: f64,
    /// Third central moment over the 3/2 power of the second.
    pub skewness: f64,
    /// Gini's coefficient, see [`gini`].
    pub gini: f64,
}

impl Sizes {
    /// Describes sizes.
    ///
    /// # Errors
    /// Fewer than two; a negative size or one that is not finite, named by its row; all zero.
    pub fn of(sizes: &[f64]) -> Result<Self, Error> {
        let gini = gini(sizes)?;
        let n = sizes.len() as f64;
        let mean = sizes.iter().sum::<f64>() / n;
        let moment = |power| sizes.iter().map(|x| (x - mean).powi(power)).sum::<f64>() / n;
        let variance = moment(2);
        let skewness = if variance > 0.0 { moment(3) / (variance * variance.sqrt()) } else { 0.0 };
        let variation = (variance * n / (n - 1.0)).sqrt() / mean;
        Ok(Self { count: sizes.len(), mean, variation, skewness, gini })
    }
}

fn check(sizes: &[f64]) -> Result<(), Error> {
    if sizes.len() < 2 {
        return Err(Error::TooFew { what: "sizes", found: sizes.len(), needed: 2 });
    }
    match sizes.iter().position(|size| !(size.is_finite() && *size >= 0.0)) {
        Some(row) => Err(Error::BadValue {
            what: "the size",
            row,
            value: sizes[row],
            right: "a finite number of at least 0 is right",
        }),
        None if sizes.iter().all(|size| *size == 0.0) => Err(Error::NoSpread { what: "sizes" }),
        None => Ok(()),
    }
}

/// Gini's coefficient: the mean difference of all pairs, a plant with itself included, over twice
/// the mean. 0 when all are equal, (n - 1) / n when one has everything [Weiner84].
///
/// # Errors
/// Fewer than two sizes; a negative size or one that is not finite; all zero.
pub fn gini(sizes: &[f64]) -> Result<f64, Error> {
    check(sizes)?;
    let mut sorted = sizes.to_vec();
    sorted.sort_by(f64::total_cmp);
    let n = sorted.len() as f64;
    // In rising order the size of rank i (from 1) is the larger one i - 1 times and the smaller
    // one n - i times.
    let ranked = sorted.iter().enumerate().map(|(i, size)| (2.0 * i as f64 + 1.0 - n) * size);
    Ok(ranked.sum::<f64>() / (n * sorted.iter().sum::<f64>()))
}

/// The quantile for a part in [0, 1], linear between order statistics (type 7 of [Hyndman96]).
///
/// # Errors
/// No values, or one that is not finite.
pub fn quantile(values: &[f64], part: f64) -> Result<f64, Error> {
    if let Some(row) = values.iter().position(|value| !value.is_finite()) {
        let right = "a finite number is right";
        return Err(Error::BadValue { what: "the value", row, value: values[row], right });
    }
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = part.clamp(0.0, 1.0) * sorted.len().saturating_sub(1) as f64;
    let at = |index: f64| sorted.get(index as usize).copied();
    match (at(rank.floor()), at(rank.ceil())) {
        (Some(low), Some(high)) => Ok(low + (high - low) * (rank - rank.floor())),
        _ => Err(Error::TooFew { what: "values", found: 0, needed: 1 }),
    }
}

/// Plants with sizes from `low`, included, to `high`, excluded.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct SizeClass {
    /// Least size.
    pub low: f64,
    /// Least size of the next class.
    pub high: f64,
    /// Number of plants.
    pub count: usize,
}

/// Most classes that are counted.
const MOST_CLASSES: f64 = 1e6;

/// Counts sizes in classes of equal width from 0 to the largest one, empty ones included.
///
/// # Errors
/// Fewer than two sizes; a negative size or one that is not finite; all zero; a width that is not
/// positive or makes more than a million classes.
pub fn size_classes(sizes: &[f64], width: f64) -> Result<Vec<SizeClass>, Error> {
    check(sizes)?;
    let largest = sizes.iter().copied().fold(0.0, f64::max);
    if !(width > 0.0 && width.is_finite() && largest / width < MOST_CLASSES) {
        let right = "a positive width that makes fewer than a million classes is right";
        return Err(Error::BadValue { what: "the width", row: 0, value: width, right });
    }
    let class = |number: usize| SizeClass {
        low: number as f64 * width,
        high: (number + 1) as f64 * width,
        count: 0,
    };
    let number = |size: f64| (size / width) as usize;
    let mut classes: Vec<SizeClass> = (0..=number(largest)).map(class).collect();
    for size in sizes {
        classes[number(*size)].count += 1;
    }
    Ok(classes)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn gini_runs_from_equality_to_one_owner() {
        assert_eq!(gini(&[3.0; 5]), Ok(0.0));
        assert_eq!(gini(&[0.0, 0.0, 0.0, 7.0]), Ok(0.75));
        // All pairs of 1, 2, 3: differences sum to 8, over 2 n² mean = 36.
        assert!((gini(&[3.0, 1.0, 2.0]).unwrap() - 8.0 / 36.0).abs() < 1e-15);
    }

    #[test]
    fn quantiles_are_linear_between_order_statistics() {
        let at = |part| quantile(&[4.0, 1.0, 3.0, 2.0], part).unwrap();
        assert_eq!([0.0, 0.5, 0.9, 1.0].map(at), [1.0, 2.5, 3.7, 4.0]);
        assert!(quantile(&[], 0.5).is_err());
    }

    #[test]
    fn classes_hold_every_plant_once() {
        let classes = size_classes(&[0.0, 0.5, 1.0, 3.9], 1.0).unwrap();
        let counts: Vec<usize> = classes.iter().map(|class| class.count).collect();
        assert_eq!(counts, [2, 1, 0, 1]);
    }

    #[test]
    fn a_negative_size_is_named_by_its_row() {
        assert!(matches!(Sizes::of(&[1.0, -2.0]), Err(Error::BadValue { row: 1, .. })));
    }
}
