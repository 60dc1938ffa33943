//! How radii grow from step to step.
//!
//! Each law is autonomous: what a circle gains depends on its radius alone, so that a stand of any
//! sizes can be handed in. The laws with a greatest size are the exact flow of their differential
//! equation over one step; half the rate over twice the steps gives the same radii.

use weald_contract::{Seed, table, words};

words! {
    /// How a radius r changes, per step.
    pub enum Law {
        /// By the same length: `dr/dt = g`.
        Additive = "additive",
        /// By the same part of itself: `r ← r (1 + g)`.
        Geometric = "geometric",
        /// Towards `size`, fastest at half of it: `dr/dt = g r (1 - r/R)` [Verhulst38].
        Logistic = "logistic",
        /// Towards `size`, ever slower: `dr/dt = g (R - r)` [Bertalanffy38].
        VonBertalanffy = "von_bertalanffy",
        /// Towards `size`, `r = R (1 - exp(-g t))^p` [Richards59].
        ChapmanRichards = "chapman_richards",
    }
}

table! {
    /// How radii grow.
    pub struct Growth {
        /// The law.
        law: Law = Law::Additive;
        /// Growth `g`: m per step for `additive`, 1 per step for the others.
        rate: f64 = 0.02, in 0.0..=1000.0;
        /// Greatest radius `R` of the laws that have one, m.
        size: f64 = 5.0, in 0.0001..=1000.0;
        /// Exponent `p` of `chapman_richards`.
        shape: f64 = 1.5, in 0.1..=10.0;
        /// How much plants differ: each grows at its own rate, uniform in g (1 ± spread).
        spread: f64 = 0.0, in 0.0..=1.0;
    }
}

impl Default for Growth {
    fn default() -> Self {
        Self { law: Law::Additive, rate: 0.02, size: 5.0, shape: 1.5, spread: 0.0 }
    }
}

impl Growth {
    /// Returns the rate of one plant, which it keeps for life.
    pub fn rate_of(&self, seed: Seed, id: u64) -> f64 {
        if self.spread == 0.0 {
            return self.rate;
        }
        self.rate * seed.stream("", id).around(1.0, self.spread)
    }

    /// Returns the radius one step later, m; no less than before.
    pub fn step(&self, radius: f64, rate: f64) -> f64 {
        let full = self.size;
        let grown = match self.law {
            Law::Additive => radius + rate,
            Law::Geometric => radius * (1.0 + rate),
            Law::Logistic => {
                // r(t) = R / (1 + (R/r₀ - 1) exp(-g t)).
                full * radius / (radius + (full - radius) * libm::exp(-rate))
            }
            Law::VonBertalanffy => full - (full - radius) * libm::exp(-rate),
            Law::ChapmanRichards => {
                // The part u = (r/R)^(1/p) = 1 - exp(-g t) follows von Bertalanffy.
                let part = libm::pow((radius / full).min(1.0), 1.0 / self.shape);
                full * libm::pow(1.0 - (1.0 - part) * libm::exp(-rate), self.shape)
            }
        };
        // Handed in larger than the law's greatest size, a circle keeps its own.
        grown.max(radius)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LAWS: [Law; 3] = [Law::Logistic, Law::VonBertalanffy, Law::ChapmanRichards];

    fn after(growth: Growth, radius: f64, steps: u32) -> f64 {
        (0..steps).fold(radius, |radius, _| growth.step(radius, growth.rate))
    }

    #[test]
    fn laws_follow_their_closed_forms() {
        let growth = |law| Growth { law, rate: 0.1, size: 4.0, shape: 2.0, spread: 0.0 };
        let close = |found: f64, right: f64| assert!((found - right).abs() < 1e-12, "{found}");
        close(after(growth(Law::Additive), 0.5, 10), 1.5);
        close(after(growth(Law::Geometric), 0.5, 10), 0.5 * 1.1f64.powi(10));
        // At t = 10, g t = 1.
        let decay = (-1.0f64).exp();
        close(after(growth(Law::Logistic), 0.5, 10), 4.0 / (1.0 + 7.0 * decay));
        close(after(growth(Law::VonBertalanffy), 0.5, 10), 4.0 - 3.5 * decay);
        close(after(growth(Law::ChapmanRichards), 0.0, 10), 4.0 * (1.0 - decay).powi(2));
    }

    #[test]
    fn half_the_rate_over_twice_the_steps_is_the_same() {
        for law in LAWS {
            let coarse = Growth { law, rate: 0.2, ..Growth::default() };
            let fine = Growth { rate: 0.1, ..coarse.clone() };
            assert!((after(coarse, 0.3, 20) - after(fine, 0.3, 40)).abs() < 1e-12);
        }
    }

    #[test]
    fn nothing_grows_beyond_its_greatest_size_nor_shrinks() {
        for law in LAWS {
            let growth = Growth { law, ..Growth::default() };
            assert!((after(growth.clone(), 0.1, 5000) - 5.0).abs() < 1e-9);
            assert_eq!(growth.step(7.0, 0.1), 7.0);
        }
    }

    #[test]
    fn plants_differ_by_the_spread_and_no_more() {
        let growth = Growth { spread: 0.5, ..Growth::default() };
        let rates: Vec<f64> = (0..1000).map(|id| growth.rate_of(Seed(1), id) / 0.02).collect();
        assert!(rates.iter().all(|rate| (0.5..=1.5).contains(rate)));
        // Mean 1, standard error 0.5 / sqrt(3 · 1000) = 0.009; five of them.
        assert!((rates.iter().sum::<f64>() / 1000.0 - 1.0).abs() < 0.05);
    }
}
