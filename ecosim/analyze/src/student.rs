//! Student's t: the width of confidence intervals.

/// The value that a t variable of `freedom` degrees exceeds in size with probability `both`.
///
/// By bisection of the distribution, to the last few bits of f64.
pub(crate) fn two_sided_quantile(both: f64, freedom: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while tail(high, freedom) > both && high < 1e300 {
        (low, high) = (high, high * 2.0);
    }
    // Each pass halves the interval: 100 leave neighbouring numbers.
    for _ in 0..100 {
        let middle = low + (high - low) / 2.0;
        if tail(middle, freedom) > both {
            low = middle;
        } else {
            high = middle;
        }
    }
    low + (high - low) / 2.0
}

/// Probability that |t| exceeds a value: `I_{ν / (ν + t²)}(ν/2, 1/2)` [Abramowitz64] §26.7.
fn tail(t: f64, freedom: f64) -> f64 {
    incomplete_beta(freedom / (freedom + t * t), freedom / 2.0, 0.5)
}

/// The regularized incomplete beta function `I_x(a, b)`, by its continued fraction
/// [Abramowitz64] §26.5 on the side where it converges fast.
fn incomplete_beta(x: f64, a: f64, b: f64) -> f64 {
    if x <= 0.0 || x >= 1.0 {
        return x.clamp(0.0, 1.0);
    }
    if x > (a + 1.0) / (a + b + 2.0) {
        return 1.0 - incomplete_beta(1.0 - x, b, a);
    }
    let log_beta = libm::lgamma(a) + libm::lgamma(b) - libm::lgamma(a + b);
    let front = libm::exp(a * libm::log(x) + b * libm::log1p(-x) - log_beta) / a;
    front * beta_fraction(x, a, b)
}

/// The continued fraction of the incomplete beta function, from the front [Lentz76].
fn beta_fraction(x: f64, a: f64, b: f64) -> f64 {
    /// Stands for a denominator that became 0.
    const TINY: f64 = 1e-300;
    /// Enough for a, b up to 1e6: terms needed grow with the square root.
    const MOST_TERMS: u32 = 10_000;
    let apart = |value: f64| if value.abs() < TINY { TINY } else { value };
    let mut c = 1.0;
    let mut d = 1.0 / apart(1.0 - (a + b) * x / (a + 1.0));
    let mut fraction = d;
    for term in 1..MOST_TERMS {
        let m = f64::from(term);
        let even = m * (b - m) * x / ((a + 2.0 * m - 1.0) * (a + 2.0 * m));
        let odd = -(a + m) * (a + b + m) * x / ((a + 2.0 * m) * (a + 2.0 * m + 1.0));
        let mut step = 1.0;
        for numerator in [even, odd] {
            d = 1.0 / apart(1.0 + numerator * d);
            c = apart(1.0 + numerator / c);
            step = c * d;
            fraction *= step;
        }
        if (step - 1.0).abs() < 1e-16 {
            break;
        }
    }
    fraction
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::f64::consts::PI;

    #[test]
    fn quantiles_for_one_and_two_degrees_have_closed_forms() {
        // For one degree t = tan(π (1 - p) / 2); for two, t² = 2 (1 - p)² / (1 - (1 - p)²).
        for both in [0.5f64, 0.05, 0.001] {
            let one = (PI * (1.0 - both) / 2.0).tan();
            assert!((two_sided_quantile(both, 1.0) / one - 1.0).abs() < 1e-11);
            let q = 1.0 - both;
            let two = (2.0 * q * q / (1.0 - q * q)).sqrt();
            assert!((two_sided_quantile(both, 2.0) / two - 1.0).abs() < 1e-11);
        }
    }

    #[test]
    fn many_degrees_give_the_normal_quantile() {
        assert!((two_sided_quantile(0.05, 1e6) - 1.959_966).abs() < 1e-5);
    }
}
