//! Random numbers that do not depend on the order of work.
//!
//! A stream is named and indexed: `seed.stream("dispersal", plant_id)`. Two streams never share
//! state, so threads and tiles may draw in any order and the bytes stay the same.

/// Root of all chance in a run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seed(pub u64);

/// Increment of SplitMix64: 2⁶⁴ over the golden ratio, made odd [Steele14].
const GOLDEN: u64 = 0x9E37_79B9_7F4A_7C15;

/// Mixes 64 bits so that each input bit flips about half of the output bits.
///
/// The finalizer of SplitMix64 [Steele14], variant 13 of Stafford.
pub fn mix(mut z: u64) -> u64 {
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^ (z >> 31)
}

impl Seed {
    /// The stream with this name and index.
    pub fn stream(self, name: &str, index: u64) -> Stream {
        let named = name.bytes().fold(mix(self.0 ^ GOLDEN), |hash, byte| {
            mix(hash.wrapping_add(GOLDEN) ^ u64::from(byte))
        });
        Stream { state: mix(named ^ mix(index.wrapping_mul(GOLDEN))) }
    }

    /// A seed for a part, so that parts may name their streams freely.
    pub fn part(self, name: &str, index: u64) -> Seed {
        Seed(self.stream(name, index).next_u64())
    }
}

/// A sequence of random numbers (SplitMix64).
#[derive(Clone, Debug)]
pub struct Stream {
    state: u64,
}

impl Stream {
    /// The next 64 bits.
    #[inline]
    pub fn next_u64(&mut self) -> u64 {
        self.state = self.state.wrapping_add(GOLDEN);
        mix(self.state)
    }

    /// Uniform in [0, 1), with 53 bits.
    #[inline]
    pub fn unit(&mut self) -> f64 {
        (self.next_u64() >> 11) as f64 * (1.0 / (1u64 << 53) as f64)
    }

    /// Uniform in [low, high).
    #[inline]
    pub fn range(&mut self, low: f64, high: f64) -> f64 {
        low + (high - low) * self.unit()
    }

    /// `center` plus or minus up to `spread`, uniform.
    #[inline]
    pub fn around(&mut self, center: f64, spread: f64) -> f64 {
        center + spread * (2.0 * self.unit() - 1.0)
    }

    /// Uniform whole number below `n`; 0 when `n` is 0.
    #[inline]
    pub fn below(&mut self, n: u64) -> u64 {
        ((u128::from(self.next_u64()) * u128::from(n)) >> 64) as u64
    }

    /// Normal deviate of mean 0 and variance 1 (Box and Muller's polar form needs rejection; this
    /// is the trigonometric one, which always draws twice).
    pub fn normal(&mut self) -> f64 {
        let radius = (-2.0 * libm::log(1.0 - self.unit())).sqrt();
        radius * libm::cos(std::f64::consts::TAU * self.unit())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn splitmix_gives_the_published_sequence() {
        // First outputs of the reference implementation for state 1234567.
        let mut stream = Stream { state: 1_234_567 };
        assert_eq!(stream.next_u64(), 6_457_827_717_110_365_317);
        assert_eq!(stream.next_u64(), 3_203_168_211_198_807_973);
    }

    #[test]
    fn names_and_indices_separate_streams() {
        let seed = Seed(7);
        let mut firsts: Vec<u64> = (0..1000).map(|i| seed.stream("a", i).next_u64()).collect();
        firsts.extend((0..1000).map(|i| seed.stream("b", i).next_u64()));
        firsts.sort_unstable();
        firsts.dedup();
        assert_eq!(firsts.len(), 2000);
    }

    #[test]
    fn uniform_numbers_have_the_moments_of_the_uniform_law() {
        let mut stream = Seed(1).stream("moments", 0);
        let n = 100_000;
        let numbers: Vec<f64> = (0..n).map(|_| stream.unit()).collect();
        let mean = numbers.iter().sum::<f64>() / f64::from(n);
        let variance = numbers.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / f64::from(n);
        // Standard error of the mean is sqrt(1/12/n) = 0.0009; allow five of them.
        assert!((mean - 0.5).abs() < 0.005);
        assert!((variance - 1.0 / 12.0).abs() < 0.002);
    }
}
