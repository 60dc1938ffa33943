//! The equations of [WP95], each a function of plain numbers.

use super::Prune;
use std::f32::consts::PI;

/// `ShapeRatio(shape, ratio)`: length of a branch relative to the longest, where `ratio` is 1 at
/// the foot of the crown and 0 at its top [WP95] §4.3.
///
/// Shape 8 is the pruning envelope and counts as a cylinder here, as lengths go.
pub fn shape_ratio(shape: u32, ratio: f32) -> f32 {
    let r = ratio.clamp(0.0, 1.0);
    let flame = if r <= 0.7 { r / 0.7 } else { (1.0 - r) / 0.3 };
    match shape {
        0 => 0.2 + 0.8 * r,
        1 => 0.2 + 0.8 * libm::sinf(PI * r),
        2 => 0.2 + 0.8 * libm::sinf(0.5 * PI * r),
        4 => 0.5 + 0.5 * r,
        5 => flame,
        6 => 1.0 - 0.8 * r,
        7 => 0.5 + 0.5 * flame,
        _ => 1.0,
    }
}

/// Width of the pruning envelope relative to the height, where `ratio` is 1 at the foot of the
/// crown and 0 at its top; 0 outside that [WP95] §4.6.
///
/// Below the peak the paper's text divides by the upper part, which leaves a step; dividing by
/// the lower part makes the envelope continuous.
pub fn envelope(prune: &Prune, ratio: f32) -> f32 {
    if !(0.0..=1.0).contains(&ratio) {
        return 0.0;
    }
    let upper = 1.0 - prune.width_peak;
    let part = if ratio < upper {
        libm::powf(ratio / upper, prune.power_high)
    } else {
        libm::powf((1.0 - ratio) / prune.width_peak, prune.power_low)
    };
    prune.width * part
}

/// Radius of a stem at the fraction `z` of its length, without flare [WP95] §4.4.
pub fn tapered_radius(taper: f32, radius: f32, length: f32, z: f32) -> f32 {
    let unit_taper = match taper {
        t if t < 1.0 => t,
        t if t < 2.0 => 2.0 - t,
        _ => 0.0,
    };
    let cone = radius * (1.0 - unit_taper * z);
    if taper < 1.0 {
        return cone;
    }
    let z2 = (1.0 - z) * length;
    let depth = if taper < 2.0 || z2 < cone { 1.0 } else { taper - 2.0 };
    let z3 = if taper < 2.0 {
        z2
    } else {
        (z2 - 2.0 * cone * libm::floorf(z2 / (2.0 * cone).max(f32::MIN_POSITIVE) + 0.5)).abs()
    };
    if taper < 2.0 && z3 >= cone {
        return cone;
    }
    (1.0 - depth) * cone + depth * (cone * cone - (z3 - cone) * (z3 - cone)).max(0.0).sqrt()
}

/// Factor of the trunk's radius near the ground: 1 + flare at z = 0, 1 from an eighth of the
/// height upwards [WP95] §4.4.
pub fn flare(flare: f32, z: f32) -> f32 {
    let y = (1.0 - 8.0 * z).max(0.0);
    1.0 + flare * (libm::powf(100.0, y) - 1.0) / 100.0
}

/// Angle between a child and its parent; `ratio` is 1 at the first child and 0 at the tip, and
/// `chance` in [-1, 1] [WP95] §4.3.
///
/// A negative variation turns the paper's lowest branches down and the highest up. A tenth of
/// the angle is left to chance there, since an exact progression looks artificial.
pub fn down_angle([angle, variation]: [f32; 2], ratio: f32, chance: f32) -> f32 {
    if variation >= 0.0 {
        return angle + variation * chance;
    }
    let progressed = angle + variation * (1.0 - 2.0 * shape_ratio(0, ratio));
    progressed * (1.0 + 0.1 * chance)
}

/// Angle about the parent of its child number `index`; `chance` in [-1, 1] [WP95] §4.3.
///
/// The variation is added to each child's own angle instead of being carried on to the next, so
/// that a missing sibling does not turn the others.
pub fn rotation([angle, variation]: [f32; 2], index: u32, chance: f32) -> f32 {
    if angle >= 0.0 {
        return angle * index as f32 + variation * chance;
    }
    let side = if index.is_multiple_of(2) { 1.0 } else { -1.0 };
    side * (180.0 + angle + variation * chance)
}

/// Slots for children on a stem of level 1, whose length is `relative` of the longest
/// [WP95] §4.3; `branches` is what the longest has.
pub fn second_level_count(branches: u32, relative: f32) -> u32 {
    libm::roundf(branches as f32 * (0.2 + 0.8 * relative)) as u32
}

/// Slots for children on a stem of level 2, which begins at `offset`, a fraction of its parent.
pub fn third_level_count(branches: u32, offset: f32) -> u32 {
    libm::roundf(branches as f32 * (1.0 - 0.5 * offset)) as u32
}

/// Slots for leaves on a stem that begins at `offset`, a fraction of its parent [WP95] §4.5.
pub fn leaf_count(leaves: i32, offset: f32, quality: f32) -> u32 {
    let mature = leaves.unsigned_abs() as f32 * shape_ratio(4, offset) * quality;
    libm::roundf(mature) as u32
}

#[cfg(test)]
mod tests {
    use super::*;

    fn close(a: f32, b: f32) -> bool {
        (a - b).abs() < 1e-5
    }

    #[test]
    fn shape_ratios_are_those_of_the_published_table() {
        // Rows: shape; columns: ratio 0, 0.5, 0.7, 1, worked out by hand.
        let table = [
            (0, [0.2, 0.6, 0.76, 1.0]),
            (1, [0.2, 1.0, 0.2 + 0.8 * 0.809_017, 0.2]),
            (2, [0.2, 0.2 + 0.8 * 0.5_f32.sqrt(), 0.2 + 0.8 * 0.891_006_5, 1.0]),
            (3, [1.0, 1.0, 1.0, 1.0]),
            (4, [0.5, 0.75, 0.85, 1.0]),
            (5, [0.0, 5.0 / 7.0, 1.0, 0.0]),
            (6, [1.0, 0.6, 0.44, 0.2]),
            (7, [0.5, 0.5 + 2.5 / 7.0, 1.0, 0.5]),
        ];
        for (shape, expected) in table {
            for (ratio, value) in [0.0, 0.5, 0.7, 1.0].into_iter().zip(expected) {
                assert!(close(shape_ratio(shape, ratio), value), "shape {shape} at {ratio}");
            }
        }
    }

    #[test]
    fn tapers_are_cylinder_cone_and_rounded_tip() {
        assert!(close(tapered_radius(0.0, 2.0, 10.0, 0.9), 2.0));
        assert!(close(tapered_radius(1.0, 2.0, 10.0, 0.25), 1.5));
        assert!(close(tapered_radius(0.5, 2.0, 10.0, 1.0), 1.0));
        // Taper 2: a cylinder with a half sphere on top. At 1 below the tip of a stem of
        // radius 2 the sphere's section is sqrt(4 - 1).
        assert!(close(tapered_radius(2.0, 2.0, 10.0, 0.9), 3.0_f32.sqrt()));
        assert!(close(tapered_radius(2.0, 2.0, 10.0, 0.5), 2.0));
        // Taper 3: spheres of radius 2 in a row; between two of them nothing is left.
        assert!(close(tapered_radius(3.0, 2.0, 12.0, 1.0 - 2.0 / 12.0), 2.0));
        assert!(tapered_radius(3.0, 2.0, 12.0, 1.0 - 4.0 / 12.0) < 0.01);
    }

    #[test]
    fn the_flare_is_widest_at_the_ground_and_gone_at_an_eighth() {
        assert!(close(flare(0.6, 0.0), 1.0 + 0.6 * 0.99));
        assert!(close(flare(0.6, 0.0625), 1.0 + 0.6 * 0.09));
        assert!(close(flare(0.6, 0.125), 1.0));
        assert!(close(flare(0.6, 0.8), 1.0));
    }

    #[test]
    fn aspen_branches_droop_below_and_rise_above() {
        // Quaking aspen: 60, -50. At the foot 60 + 50, at the top 60 - 30.
        assert!(close(down_angle([60.0, -50.0], 1.0, 0.0), 110.0));
        assert!(close(down_angle([60.0, -50.0], 0.0, 0.0), 30.0));
        assert!(close(down_angle([45.0, 10.0], 0.3, -1.0), 35.0));
    }

    #[test]
    fn negative_rotation_alternates_sides() {
        assert!(close(rotation([-120.0, 0.0], 0, 0.0), 60.0));
        assert!(close(rotation([-120.0, 0.0], 1, 0.0), -60.0));
        assert!(close(rotation([140.0, 0.0], 3, 0.0), 420.0));
    }

    #[test]
    fn counts_fall_with_length_and_offset() {
        assert_eq!(second_level_count(30, 1.0), 30);
        assert_eq!(second_level_count(30, 0.5), 18);
        assert_eq!(third_level_count(300, 0.5), 225);
        assert_eq!(leaf_count(25, 1.0, 1.0), 25);
        assert_eq!(leaf_count(-20, 0.0, 1.0), 10);
    }

    #[test]
    fn the_envelope_peaks_at_its_width_without_a_step() {
        let prune =
            Prune { ratio: 1.0, width: 0.4, width_peak: 0.6, power_low: 0.5, power_high: 0.5 };
        assert!(close(envelope(&prune, 0.4), 0.4));
        assert!((envelope(&prune, 0.3999) - envelope(&prune, 0.4001)).abs() < 1e-3);
        assert!(close(envelope(&prune, 0.0), 0.0));
        assert_eq!(envelope(&prune, 1.2), 0.0);
    }
}
