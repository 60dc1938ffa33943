//! Well-spread random numbers for light paths.
//!
//! Owen-scrambled Sobol points [Burley20], four dimensions at a time. Each pixel has its own
//! scramble, and each group of four dimensions beyond the table continues with another one, so
//! a path may draw as many numbers as it likes.

use weald_contract::{Seed, seed::mix};

/// Draws the numbers of one sample of one pixel, in a fixed order.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sampler {
    pixel: u32,
    sample: u32,
    set: u32,
}

impl Sampler {
    /// The numbers of a sample.
    pub fn new(seed: Seed, pixel: u64, sample: u32) -> Self {
        Self { pixel: mix(seed.0 ^ mix(pixel)) as u32, sample, set: 0 }
    }

    /// The next four numbers, each in [0, 1).
    pub fn next(&mut self) -> [f32; 4] {
        let sets = sobol_burley::NUM_DIMENSION_SETS_4D;
        let (set, round) = (self.set % sets, self.set / sets);
        self.set += 1;
        sobol_burley::sample_4d(self.sample, set, self.pixel ^ round.wrapping_mul(0x9E37_79B9))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn sixteen_samples_fall_into_sixteen_strata_of_every_dimension() {
        for set in 0..4 {
            for dimension in 0..4 {
                let mut strata = [0; 16];
                for sample in 0..16 {
                    let mut sampler = Sampler::new(Seed(1), 9, sample);
                    let numbers = (0..=set).map(|_| sampler.next()).last().unwrap();
                    strata[(numbers[dimension] * 16.0) as usize] += 1;
                }
                assert_eq!(strata, [1; 16]);
            }
        }
    }

    #[test]
    fn pixels_draw_different_numbers() {
        let first = |pixel| Sampler::new(Seed(1), pixel, 0).next();
        assert_ne!(first(0), first(1));
    }
}
