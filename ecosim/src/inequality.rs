//! How unequal the plants of a stand are, by the areas of their crowns.
//!
//! A stand in which large plants suppress small ones grows unequal until the small ones die; one
//! in which all share alike does not. Gini's coefficient is the usual measure [Weiner84].

use std::f64::consts::PI;

/// Plants up to which every size counts for itself.
const EXACT: usize = 1 << 16;
/// Bits of a radius that are left out for more plants: sizes that differ by less than one part in
/// 32,768 are taken together, which no printed digit shows.
const COARSE: u32 = 8;

/// How unequal crown areas are.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Inequality {
    /// Gini's coefficient: the mean difference of all pairs, a plant with itself included, over
    /// twice the mean. 0 when all are equal or there are fewer than two.
    pub gini: f32,
    /// Coefficient of variation: standard deviation (over n - 1) over the mean.
    pub variation: f32,
}

impl Inequality {
    /// Measures circles of these radii.
    pub fn of_circles(radii: Vec<f32>) -> Self {
        let n = radii.len() as f64;
        let classes = if radii.len() <= EXACT { one_by_one(radii) } else { by_classes(&radii) };
        let total: f64 = classes.iter().map(|class| class.count * class.area).sum();
        if n < 2.0 || total <= 0.0 {
            return Self::default();
        }
        // The plant of rank i (from 0) is the larger one of i pairs and the smaller of n - 1 - i;
        // over a class that begins with rank k, 2 i + 1 - n adds up to c (2 k + c - n).
        let (mut ranked, mut squares, mut before) = (0.0, 0.0, 0.0);
        for Class { area, count } in classes {
            ranked += count * (2.0 * before + count - n) * area;
            squares += count * (area - total / n) * (area - total / n);
            before += count;
        }
        let variation = (squares / (n - 1.0)).sqrt() * n / total;
        Self { gini: (ranked / (n * total)) as f32, variation: variation as f32 }
    }
}

/// Circles of one area.
struct Class {
    area: f64,
    count: f64,
}

fn class(radius: f32, count: f64) -> Class {
    Class { area: PI * f64::from(radius) * f64::from(radius), count }
}

/// Returns a class a circle, by rising size.
fn one_by_one(mut radii: Vec<f32>) -> Vec<Class> {
    radii.sort_unstable_by(f32::total_cmp);
    radii.into_iter().map(|radius| class(radius, 1.0)).collect()
}

/// Returns classes of circles of nearly the same size, by rising size. Numbers from 0 rise as their
/// bits do, so that counting by the leading bits sorts them.
fn by_classes(radii: &[f32]) -> Vec<Class> {
    let key = |radius: f32| radius.to_bits() >> COARSE;
    let keys = || radii.iter().map(|radius| key(*radius));
    let (least, most) = keys().fold((u32::MAX, 0), |(low, high), k| (low.min(k), high.max(k)));
    let mut counts = vec![0u32; (most - least) as usize + 1];
    keys().for_each(|key| counts[(key - least) as usize] += 1);
    let middle = |key: u32| f32::from_bits((key << COARSE) | (1 << (COARSE - 1)));
    let taken = (least..).zip(counts).filter(|(_, count)| *count > 0);
    taken.map(|(key, count)| class(middle(key), f64::from(count))).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    fn radii(count: u64) -> Vec<f32> {
        let mut stream = Seed(2).stream("radii", count);
        (0..count).map(|_| stream.range(0.01, 3.0) as f32).collect()
    }

    #[test]
    fn the_coefficients_are_those_of_all_pairs() {
        let radii = radii(300);
        let areas: Vec<f64> = radii.iter().map(|r| f64::from(*r).powi(2)).collect();
        let n = areas.len() as f64;
        let mean = areas.iter().sum::<f64>() / n;
        let pairs: f64 = areas.iter().flat_map(|a| areas.iter().map(move |b| (a - b).abs())).sum();
        let squares: f64 = areas.iter().map(|a| (a - mean).powi(2)).sum();
        let found = Inequality::of_circles(radii);
        assert!((f64::from(found.gini) - pairs / (2.0 * n * n * mean)).abs() < 1e-6);
        assert!((f64::from(found.variation) - (squares / (n - 1.0)).sqrt() / mean).abs() < 1e-6);
    }

    /// Radii uniform up to R have areas with distribution √(a/A), hence the coefficient
    /// 1 - 2 ∫ (share of the smaller p) dp = 1 - 2 ∫ p³ dp = 1/2, and variance over squared mean
    /// (1/5 - 1/9) / (1/9) = 4/5.
    #[test]
    fn large_stands_are_counted_by_classes_to_the_same_end() {
        let radii = radii(200_000);
        let coarse = Inequality::of_circles(radii.clone());
        let (mut ranked, mut total) = (0.0, 0.0);
        for (rank, class) in one_by_one(radii).iter().enumerate() {
            ranked += (2.0 * rank as f64 + 1.0 - 200_000.0) * class.area;
            total += class.area;
        }
        assert!((f64::from(coarse.gini) - ranked / (200_000.0 * total)).abs() < 1e-6);
        assert!(
            (coarse.gini - 0.5).abs() < 0.01 && (coarse.variation - 0.8f32.sqrt()).abs() < 0.01
        );
    }

    #[test]
    fn equals_few_and_none_are_not_unequal() {
        for radii in [vec![], vec![1.0], vec![0.0; 5]] {
            assert_eq!(Inequality::of_circles(radii), Inequality::default());
        }
        let equals = Inequality::of_circles(vec![0.7; 100_000]);
        assert_eq!((equals.gini, equals.variation), (0.0, 0.0));
        // One of n has everything: (n - 1) / n.
        let one = Inequality::of_circles(vec![0.0, 0.0, 0.0, 2.0]);
        assert_eq!((one.gini, one.variation), (0.75, 2.0));
    }
}
