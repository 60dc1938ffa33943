//! Smooth random fields for colours that are never quite even.

/// Hash of a lattice point to [0, 1).
fn lattice(x: i32, y: i32, seed: u32) -> f32 {
    // Two rounds of multiply and xor-shift; constants of [Wellons18] spread the bits well enough
    // for colour.
    let mut h = (x as u32).wrapping_mul(0x8DA6_B343)
        ^ (y as u32).wrapping_mul(0xD816_3841)
        ^ seed.wrapping_mul(0xCB1A_B31F);
    h = (h ^ (h >> 16)).wrapping_mul(0x7FEB_352D);
    h = (h ^ (h >> 15)).wrapping_mul(0x846C_A68B);
    ((h ^ (h >> 16)) >> 8) as f32 / (1 << 24) as f32
}

/// Value noise in [-1, 1] with a wavelength of about 1.
pub(crate) fn value(x: f32, y: f32, seed: u32) -> f32 {
    let (fx, fy) = (x.floor(), y.floor());
    let (ix, iy) = (fx as i32, fy as i32);
    let ease = |t: f32| t * t * (3.0 - 2.0 * t);
    let (u, v) = (ease(x - fx), ease(y - fy));
    let at = |dx: i32, dy: i32| lattice(ix.wrapping_add(dx), iy.wrapping_add(dy), seed);
    let south = at(0, 0) + u * (at(1, 0) - at(0, 0));
    let north = at(0, 1) + u * (at(1, 1) - at(0, 1));
    2.0 * (south + v * (north - south)) - 1.0
}

/// Three octaves of [`value`], still about in [-1, 1].
pub(crate) fn cloudy(x: f32, y: f32, seed: u32) -> f32 {
    (4.0 * value(x, y, seed)
        + 2.0 * value(2.03 * x, 2.03 * y, seed + 1)
        + value(4.11 * x, 4.11 * y, seed + 2))
        / 5.0
}

/// Smooth step from 0 below `low` to 1 above `high`.
pub(crate) fn smoothstep(low: f32, high: f32, x: f32) -> f32 {
    let t = ((x - low) / (high - low)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn noise_is_continuous_across_cells_and_bounded() {
        for i in -50..50 {
            let x = i as f32;
            let jump = (value(x - 1e-4, 0.3, 1) - value(x + 1e-4, 0.3, 1)).abs();
            assert!(jump < 1e-2);
            assert!(value(x * 0.37, x * 0.11, 2).abs() <= 1.0);
        }
    }

    #[test]
    fn noise_has_mean_zero() {
        let n = 200;
        let points = (0..n * n).map(|i| ((i % n) as f32 * 0.73, (i / n) as f32 * 0.73));
        let mean = points.map(|(x, y)| value(x, y, 3)).sum::<f32>() / (n * n) as f32;
        assert!(mean.abs() < 0.02, "{mean}");
    }
}
