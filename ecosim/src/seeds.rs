//! Seeds between mother and seedling: crops, mast years, and the bank in the ground.
//!
//! Each year mature plants shed seeds and others come from afar. Of all that lie in the ground, a
//! part germinates; of the rest, a part lives on to the next year [Cohen66].

use rayon::prelude::*;
use weald_contract::{Seed, table};

table! {
    /// Mast years, in which a whole population bears at once most of its seeds [Kelly94].
    ///
    /// Each year is a mast year with probability `1 / interval`, drawn for all plants of a species
    /// together. Crops keep their mean over the years.
    pub struct Mast {
        /// Mean number of years from one mast year to the next.
        interval: f32 = 5.0, in 1.1..=1000.0;
        /// Part of all seeds that fall in mast years.
        share: f32 = 0.9, in 0.0..=1.0;
    }
}

impl Mast {
    /// Returns the crop of a year over the mean crop.
    pub fn crop(&self, seed: Seed, year: u32) -> f64 {
        let [interval, share] = [self.interval, self.share].map(f64::from);
        if seed.stream("mast", u64::from(year)).unit() * interval < 1.0 {
            share * interval
        } else {
            (1.0 - share) * interval / (interval - 1.0)
        }
    }
}

/// A seed in the ground.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DormantSeed {
    /// Id of the plant that it may become.
    pub id: u64,
    /// Index into the species of the population.
    pub species: u16,
    /// Map coordinates, m.
    pub x: f64,
    /// Map coordinates, m.
    pub y: f64,
}

/// Parts all seeds in the ground by what they do this year: those that germinate, and those that
/// wait and live on. Draws are keyed by seed.
pub(crate) fn part(
    seeds: Vec<DormantSeed>,
    germination: f32,
    dormancy: f32,
    luck: Seed,
) -> (Vec<DormantSeed>, Vec<DormantSeed>) {
    if germination >= 1.0 {
        return (seeds, Vec::new());
    }
    let germinates = |seed: &DormantSeed| {
        let mut stream = luck.stream("", seed.id);
        let (sprouts, lives) = (stream.unit(), stream.unit());
        match sprouts < f64::from(germination) {
            true => Some(true),
            false => (lives < f64::from(dormancy)).then_some(false),
        }
    };
    let fates: Vec<Option<bool>> = seeds.par_iter().map(germinates).collect();
    let with = |fate: bool| {
        let mut fates = fates.iter();
        let mut chosen = seeds.clone();
        chosen.retain(|_| fates.next() == Some(&Some(fate)));
        chosen
    };
    (with(true), with(false))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ground(count: u64) -> Vec<DormantSeed> {
        (0..count).map(|id| DormantSeed { id, species: 0, x: 0.0, y: 0.0 }).collect()
    }

    #[test]
    fn crops_keep_their_mean_and_fall_in_mast_years() {
        let mast = Mast { interval: 4.0, share: 0.8 };
        let crops: Vec<f64> = (0..40_000).map(|year| mast.crop(Seed(2), year)).collect();
        let n = crops.len() as f64;
        let large = crops.iter().filter(|crop| **crop > 1.0);
        // A mast crop is 0.8 · 4 of the mean, the others 0.2 · 4/3; their variance is
        // (3.2 - 1)²/4 + (1 - 0.2667)² · 3/4 = 1.6133.
        assert!(crops.iter().all(|c| (c - 3.2).abs() < 1e-6 || (c - 0.8 / 3.0).abs() < 1e-6));
        let mean = crops.iter().sum::<f64>() / n;
        assert!((mean - 1.0).abs() < 5.0 * (1.6133 / n).sqrt(), "{mean}");
        // A binomial count of probability 1/4.
        assert!((large.count() as f64 / n - 0.25).abs() < 5.0 * (0.1875 / n).sqrt());
    }

    #[test]
    fn seeds_germinate_wait_or_perish_in_the_given_parts() {
        let n = 100_000.0f64;
        let (sprouting, waiting) = part(ground(n as u64), 0.3, 0.5, Seed(4));
        let is_near = |found: usize, part: f64| {
            (found as f64 / n - part).abs() < 5.0 * (part * (1.0 - part) / n).sqrt()
        };
        assert!(is_near(sprouting.len(), 0.3) && is_near(waiting.len(), 0.35));
        assert!(sprouting.iter().all(|seed| !waiting.contains(seed) || seed.id > 200));
        let (all, none) = part(ground(10), 1.0, 0.9, Seed(4));
        assert_eq!((all.len(), none.len()), (10, 0));
    }
}
