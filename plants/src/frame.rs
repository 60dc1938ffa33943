//! Directions and rotations that come out the same on every machine.
//!
//! `glam` takes its sines from the platform; angles that land in a model's bytes go through
//! `libm` here instead.

use glam::{Quat, Vec3};

/// Rotation by `angle` (rad) about the X axis.
pub fn rot_x(angle: f32) -> Quat {
    let (sin, cos) = libm::sincosf(0.5 * angle);
    Quat::from_xyzw(sin, 0.0, 0.0, cos)
}

/// Rotation by `angle` (rad) about the Z axis.
pub fn rot_z(angle: f32) -> Quat {
    let (sin, cos) = libm::sincosf(0.5 * angle);
    Quat::from_xyzw(0.0, 0.0, sin, cos)
}

/// The unit vector at angle `declination` (rad) from the vertical, towards `azimuth` (rad, from
/// X over Y).
pub fn direction(azimuth: f32, declination: f32) -> Vec3 {
    let (sin_a, cos_a) = libm::sincosf(azimuth);
    let (sin_d, cos_d) = libm::sincosf(declination);
    Vec3::new(sin_d * cos_a, sin_d * sin_a, cos_d)
}

/// The direction of `v` at right angles to unit vector `axis`.
///
/// `None` where hardly anything of `v` points across: what is left there is rounding error, and
/// scaling it up would give a direction that is not at right angles.
pub fn across(v: Vec3, axis: Vec3) -> Option<Vec3> {
    let rest = v - axis * v.dot(axis);
    let square = rest.length_squared();
    // Squares below this have lost their digits.
    (square > 1e-6 * v.length_squared() && square > 1e-36).then(|| rest * (1.0 / square.sqrt()))
}

/// A unit vector at right angles to unit vector `axis`.
pub fn any_normal(axis: Vec3) -> Vec3 {
    let helper = if axis.x.abs() < 0.7 { Vec3::X } else { Vec3::Y };
    axis.cross(helper).normalize()
}

/// World from organ, where `frame` has its Z along the growth of the organ and its Y towards
/// the organ's upper side: organs grow along +Y with their upper side towards +Z.
pub fn organ_rotation(frame: Quat) -> Quat {
    // Half a turn about the diagonal of Y and Z exchanges those two and mirrors X.
    let half = std::f32::consts::FRAC_1_SQRT_2;
    frame * Quat::from_xyzw(0.0, half, half, 0.0)
}

/// The frame whose Z is unit `heading` and whose Y is as near to `upper` as can be.
pub fn frame_of(heading: Vec3, upper: Vec3) -> Quat {
    let y = across(upper, heading).unwrap_or_else(|| any_normal(heading));
    Quat::from_mat3(&glam::Mat3::from_cols(y.cross(heading), y, heading))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_organ_grows_along_the_heading_with_its_upper_side_up() {
        let frame = frame_of(Vec3::X, Vec3::Z);
        let rotation = organ_rotation(frame);
        assert!((rotation * Vec3::Y - Vec3::X).length() < 1e-6);
        assert!((rotation * Vec3::Z - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn what_points_along_the_axis_has_no_direction_across_it() {
        let axis = Vec3::new(0.6, 0.0, 0.8);
        assert_eq!(across(axis * 3.0, axis), None);
        assert_eq!(across(Vec3::ZERO, axis), None);
        let found = across(Vec3::new(1.0, 2.0, 3.0), axis).unwrap();
        assert!(found.dot(axis).abs() < 1e-6 && (found.length() - 1.0).abs() < 1e-6);
    }

    #[test]
    fn rotations_follow_the_right_hand() {
        let quarter = std::f32::consts::FRAC_PI_2;
        assert!((rot_x(quarter) * Vec3::Y - Vec3::Z).length() < 1e-6);
        assert!((rot_z(quarter) * Vec3::X - Vec3::Y).length() < 1e-6);
        assert!((direction(quarter, quarter) - Vec3::Y).length() < 1e-6);
    }
}
