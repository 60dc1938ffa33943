//! How far seeds fall from their mother.
//!
//! A kernel gives the distribution of distances; directions are alike. Of the several forms that
//! [Nathan12] compares, those stand here that field studies fit most often. Densities `p(r)` are
//! per area around the mother, `f(r) = 2 π r p(r)` per distance.

use std::f64::consts::TAU;
use weald_contract::{Stream, choice, table};

choice! {
    /// A dispersal kernel.
    pub enum Kernel by "kernel" {
        /// Anywhere within a distance.
        "uniform" => Uniform(Uniform),
        /// Thin tail: many small steps.
        "gaussian" => Gaussian(Gaussian),
        /// From fat tails to flat tops; shape 1 is the exponential kernel.
        "exponential_power" => ExponentialPower(ExponentialPower),
        /// A Gaussian whose width varies from seed to seed; the tail is a power law.
        "two_dt" => TwoDt(TwoDt),
        /// Distances whose logarithm is normal.
        "lognormal" => Lognormal(Lognormal),
        /// Distances of first passage, with given mean and shape.
        "wald" => Wald(Wald),
        /// The same from wind, fall and the mother's height.
        "wind" => Wind(Wind),
    }
}

table! {
    /// Density `1 / (π R²)` up to the distance R.
    pub struct Uniform {
        /// Greatest distance R, m.
        radius: f32, in 0.001..=100000.0;
    }
}

table! {
    /// Density `exp(-(r/a)²) / (π a²)`; mean distance `a √π / 2`.
    pub struct Gaussian {
        /// Scale a, m.
        scale: f32, in 0.001..=100000.0;
    }
}

table! {
    /// Density `b exp(-(r/a)^b) / (2 π a² Γ(2/b))`; mean distance `a Γ(3/b) / Γ(2/b)` [Clark99].
    pub struct ExponentialPower {
        /// Scale a, m.
        scale: f32, in 0.001..=100000.0;
        /// Exponent b; below 1 the tail is fat, 2 is the Gaussian.
        shape: f32 = 1.0, in 0.2..=10.0;
    }
}

table! {
    /// Density `b / (π a²) (1 + (r/a)²)^-(b+1)`; mean distance `a √π Γ(b - 1/2) / (2 Γ(b))`,
    /// infinite up to b = 1/2 [Clark99].
    pub struct TwoDt {
        /// Scale a, m.
        scale: f32, in 0.001..=100000.0;
        /// Exponent b; the lower, the fatter the tail.
        shape: f32 = 1.0, in 0.1..=100.0;
    }
}

table! {
    /// Distance per distance `exp(-ln²(r/a) / (2 s²)) / (r s √(2π))`; mean `a exp(s²/2)`.
    pub struct Lognormal {
        /// Median distance a, m.
        scale: f32, in 0.001..=100000.0;
        /// Standard deviation s of the logarithm of distance.
        shape: f32 = 1.0, in 0.01..=5.0;
    }
}

table! {
    /// Distance per distance `√(λ / (2π r³)) exp(-λ (r - μ)² / (2 μ² r))`; variance `μ³/λ`
    /// [Katul05].
    pub struct Wald {
        /// Mean distance μ, m.
        mean: f32, in 0.001..=100000.0;
        /// Shape λ, m.
        shape: f32, in 0.0001..=1000000.0;
    }
}

table! {
    /// The Wald kernel of seeds in turbulent air [Katul05]: released at the mother's height H,
    /// with `μ = H U / V` and `λ = (H / σ)²`.
    pub struct Wind {
        /// Mean horizontal wind U between the crown and the ground, m/s.
        speed: f32 = 2.0, in 0.01..=100.0;
        /// Terminal velocity V of a falling seed, m/s.
        fall: f32, in 0.01..=100.0;
        /// Turbulence σ of the air, √m; the greater, the farther the few fly.
        turbulence: f32 = 1.0, in 0.001..=1000.0;
    }
}

impl Kernel {
    /// Draws how far a seed falls from a mother of this height, m.
    pub fn distance(&self, height: f64, stream: &mut Stream) -> f64 {
        // In (0, 1]: its logarithm and its negative powers exist.
        let mut unit = || 1.0 - stream.unit();
        match self {
            Self::Uniform(Uniform { radius }) => f64::from(*radius) * unit().sqrt(),
            Self::Gaussian(Gaussian { scale }) => f64::from(*scale) * (-libm::log(unit())).sqrt(),
            Self::ExponentialPower(ExponentialPower { scale, shape }) => {
                // (r/a)^b follows a gamma distribution of shape 2/b.
                let b = f64::from(*shape);
                f64::from(*scale) * libm::pow(gamma(2.0 / b, stream), 1.0 / b)
            }
            Self::TwoDt(TwoDt { scale, shape }) => {
                // A part (1 + (r/a)²)^-b falls beyond r.
                let beyond = libm::pow(unit(), -1.0 / f64::from(*shape));
                f64::from(*scale) * (beyond - 1.0).max(0.0).sqrt()
            }
            Self::Lognormal(Lognormal { scale, shape }) => {
                f64::from(*scale) * libm::exp(f64::from(*shape) * stream.normal())
            }
            Self::Wald(Wald { mean, shape }) => wald(f64::from(*mean), f64::from(*shape), stream),
            Self::Wind(wind) => {
                let (mean, shape) = wind.wald_of(height);
                if height > 0.0 { wald(mean, shape, stream) } else { 0.0 }
            }
        }
    }

    /// Draws where a seed falls, from a mother of this height: metres to the east and north.
    pub fn offset(&self, height: f64, stream: &mut Stream) -> [f64; 2] {
        let distance = self.distance(height, stream);
        let direction = TAU * stream.unit();
        [distance * libm::cos(direction), distance * libm::sin(direction)]
    }
}

impl Wind {
    /// Returns mean and shape of the Wald kernel of a mother of this height, m.
    pub fn wald_of(&self, height: f64) -> (f64, f64) {
        let [speed, fall, turbulence] = [self.speed, self.fall, self.turbulence].map(f64::from);
        (height * speed / fall, (height / turbulence) * (height / turbulence))
    }
}

/// Draws from the gamma distribution of scale 1 by the squeeze of [Marsaglia00]; a shape below 1
/// is lifted by 1 and brought back by a power of a uniform number (§6 there).
fn gamma(shape: f64, stream: &mut Stream) -> f64 {
    if shape < 1.0 {
        let lifted = gamma(shape + 1.0, stream);
        return lifted * libm::pow(1.0 - stream.unit(), 1.0 / shape);
    }
    let d = shape - 1.0 / 3.0;
    let c = 1.0 / (9.0 * d).sqrt();
    loop {
        let x = stream.normal();
        let cube = (1.0 + c * x) * (1.0 + c * x) * (1.0 + c * x);
        let u = 1.0 - stream.unit();
        let is_under =
            cube > 0.0 && libm::log(u) < 0.5 * x * x + d * (1.0 - cube + libm::log(cube));
        if is_under {
            return d * cube;
        }
    }
}

/// Draws from the inverse Gaussian distribution by the roots of [Michael76].
fn wald(mean: f64, shape: f64, stream: &mut Stream) -> f64 {
    let normal = stream.normal();
    let ratio = mean * normal * normal / (2.0 * shape);
    // The smaller root m (1 + q - √(q² + 2 q)), written without the difference of near numbers.
    let near = mean / (1.0 + ratio + (ratio * (ratio + 2.0)).sqrt());
    if stream.unit() * (mean + near) <= mean { near } else { mean * mean / near }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    const DRAWS: usize = 20_000;

    fn draws(kernel: &Kernel, height: f64) -> Vec<f64> {
        let draw = |n| kernel.distance(height, &mut Seed(5).stream("kernel", n));
        let mut distances: Vec<f64> = (0..DRAWS as u64).map(draw).collect();
        distances.sort_by(f64::total_cmp);
        distances
    }

    /// Asserts that draws follow a distribution, by the test of Kolmogorov: √n times the largest
    /// deviation exceeds 1.95 once in a thousand samples of that distribution.
    fn assert_follows(name: &str, kernel: &Kernel, height: f64, within: impl Fn(f64) -> f64) {
        let n = DRAWS as f64;
        let deviation = draws(kernel, height).iter().enumerate().fold(0.0f64, |most, (rank, r)| {
            let part = within(*r);
            most.max(part - rank as f64 / n).max((rank + 1) as f64 / n - part)
        });
        assert!(deviation * n.sqrt() < 1.95, "{name}: {}", deviation * n.sqrt());
    }

    /// Distribution function of the normal law.
    fn below(z: f64) -> f64 {
        0.5 * libm::erfc(-z / std::f64::consts::SQRT_2)
    }

    fn wald_within(mean: f64, shape: f64, r: f64) -> f64 {
        let root = (shape / r).sqrt();
        below(root * (r / mean - 1.0))
            + libm::exp(2.0 * shape / mean) * below(-root * (r / mean + 1.0))
    }

    fn exponential_power(shape: f32) -> Kernel {
        Kernel::ExponentialPower(ExponentialPower { scale: 3.0, shape })
    }

    #[test]
    fn distances_follow_the_closed_forms() {
        let disc = Kernel::Uniform(Uniform { radius: 4.0 });
        assert_follows("uniform", &disc, 1.0, |r| r * r / 16.0);
        let bell = Kernel::Gaussian(Gaussian { scale: 4.0 });
        assert_follows("gaussian", &bell, 1.0, |r| 1.0 - (-r * r / 16.0).exp());
        let two_dt = Kernel::TwoDt(TwoDt { scale: 4.0, shape: 0.7 });
        assert_follows("two_dt", &two_dt, 1.0, |r| {
            1.0 - (1.0 + r * r / 16.0).powf(-f64::from(0.7f32))
        });
        let lognormal = Kernel::Lognormal(Lognormal { scale: 4.0, shape: 0.5 });
        assert_follows("lognormal", &lognormal, 1.0, |r| below((r / 4.0).ln() / 0.5));
        let wald = Kernel::Wald(Wald { mean: 20.0, shape: 5.0 });
        assert_follows("wald", &wald, 1.0, |r| wald_within(20.0, 5.0, r));
    }

    /// `∫ 2 π r p(r) dr` is the incomplete gamma function of order 2/b, which is elementary or an
    /// error function where 2/b is whole or one half.
    #[test]
    fn exponential_power_follows_its_closed_forms_from_fat_to_flat() {
        let x = |r: f64, b: f64| (r / 3.0).powf(b);
        assert_follows("b = 1/2", &exponential_power(0.5), 1.0, |r| {
            let x = x(r, 0.5);
            1.0 - (-x).exp() * (1.0 + x + x * x / 2.0 + x * x * x / 6.0)
        });
        assert_follows("exponential", &exponential_power(1.0), 1.0, |r| {
            1.0 - (-x(r, 1.0)).exp() * (1.0 + x(r, 1.0))
        });
        assert_follows("gaussian", &exponential_power(2.0), 1.0, |r| 1.0 - (-x(r, 2.0)).exp());
        assert_follows("b = 4", &exponential_power(4.0), 1.0, |r| libm::erf(x(r, 4.0).sqrt()));
    }

    #[test]
    fn means_are_those_on_paper() {
        let mean = |kernel: &Kernel| draws(kernel, 1.0).iter().sum::<f64>() / DRAWS as f64;
        let close = |found: f64, right: f64, deviation: f64| {
            // Five standard errors.
            assert!((found - right).abs() < 5.0 * deviation / (DRAWS as f64).sqrt(), "{found}");
        };
        // Exponential kernel: mean 2 a, variance 2 a².
        close(mean(&exponential_power(1.0)), 6.0, 3.0 * 2f64.sqrt());
        // Wald: mean μ, variance μ³/λ.
        close(mean(&Kernel::Wald(Wald { mean: 20.0, shape: 5.0 })), 20.0, 40.0);
        // Lognormal: mean a exp(s²/2), variance mean² (exp(s²) - 1).
        let right = 4.0 * 0.125f64.exp();
        let deviation = right * (0.25f64.exp() - 1.0).sqrt();
        close(mean(&Kernel::Lognormal(Lognormal { scale: 4.0, shape: 0.5 })), right, deviation);
        // 2Dt with b = 2: a √π Γ(3/2) / (2 Γ(2)) = a π / 4; E r² = a² / (b - 1).
        let deviation = 4.0 * (1.0 - (std::f64::consts::PI / 4.0).powi(2)).sqrt();
        let two_dt = Kernel::TwoDt(TwoDt { scale: 4.0, shape: 2.0 });
        close(mean(&two_dt), std::f64::consts::PI, deviation);
    }

    #[test]
    fn wind_carries_seeds_of_higher_mothers_farther() {
        let wind = Wind { speed: 2.0, fall: 1.0, turbulence: 2.0 };
        assert_eq!(wind.wald_of(10.0), (20.0, 25.0));
        let kernel = Kernel::Wind(wind);
        assert_follows("wind", &kernel, 10.0, |r| wald_within(20.0, 25.0, r));
        assert_eq!(kernel.distance(0.0, &mut Seed(1).stream("", 0)), 0.0);
    }

    #[test]
    fn no_direction_is_favoured() {
        let kernel = Kernel::Gaussian(Gaussian { scale: 2.0 });
        let offset = |n| kernel.offset(1.0, &mut Seed(6).stream("", n));
        let sum = (0..DRAWS as u64).map(offset).fold([0.0, 0.0], |s, o| [s[0] + o[0], s[1] + o[1]]);
        // Each coordinate has variance a²/2 = 2.
        let bound = 5.0 * (2.0 / DRAWS as f64).sqrt();
        assert!(sum.iter().all(|s| (s / DRAWS as f64).abs() < bound), "{sum:?}");
    }
}
