//! Which parts of a mature plant a smaller one has.
//!
//! A mature axis bears a fixed number of slots for its branches or leaves. A smaller plant fills
//! part of them, spread evenly along the axis, and each part comes in gradually. So a plant
//! contains its younger self, and a small step of age changes little.

/// Inverse golden ratio: its multiples modulo 1 spread more evenly than any other's [Knuth98].
const GOLDEN: f64 = 0.618_033_988_749_894_9;

/// How far part `slot` of `count` has grown when `filled` of the slots are filled, in [0, 1].
///
/// 0 means absent. The sum over all slots is near `filled * count`.
pub fn presence(slot: u32, count: u32, filled: f32) -> f32 {
    let threshold = threshold(slot);
    let count = count as f32;
    // The slope lets one part come in at a time; the added 1/count completes all at `filled` 1.
    ((filled * (1.0 + 1.0 / count) - threshold) * count).clamp(0.0, 1.0)
}

/// The share of filled slots at which part `slot` comes in, in [0, 1): spread evenly over slots.
pub fn threshold(slot: u32) -> f32 {
    let turn = f64::from(slot) * GOLDEN + 0.5;
    (turn - f64::from(turn as u32)) as f32
}

/// Part of the slots that a plant fills, from its maturity and vigor.
///
/// Leaf area of real trees grows with the 1.77th power of height [Falster15]; shared among the
/// two orders of branches and the leaves, each gets an exponent near 0.6. A plant without vigor
/// keeps `starved` of what its size would give it.
pub fn filling(maturity: f32, vigor: f32, exponent: f32, starved: f32) -> f32 {
    libm::powf(maturity, exponent) * (starved + (1.0 - starved) * vigor)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_full_plant_has_all_its_parts_and_an_empty_one_none() {
        for count in [1, 2, 7, 50] {
            assert!((0..count).all(|slot| presence(slot, count, 1.0) == 1.0));
            assert!((0..count).all(|slot| presence(slot, count, 0.0) == 0.0));
        }
    }

    #[test]
    fn parts_once_grown_stay() {
        for slot in 0..40 {
            let grown: Vec<f32> =
                (0..=100).map(|step| presence(slot, 40, step as f32 / 100.0)).collect();
            assert!(grown.windows(2).all(|pair| pair[0] <= pair[1]));
        }
    }

    #[test]
    fn the_parts_add_up_to_the_filled_share() {
        for filled in [0.1, 0.33, 0.5, 0.9] {
            let sum: f32 = (0..60).map(|slot| presence(slot, 60, filled)).sum();
            assert!((sum - 60.0 * filled).abs() < 2.0, "{filled} gave {sum}");
        }
    }
}
