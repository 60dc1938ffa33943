//! The eye: a pinhole or a thin lens, a plan without foreshortening, or a view all around.

use crate::accel::Ray;
use glam::Vec3;
use std::f32::consts::{FRAC_PI_2, PI, TAU};
use weald_contract::Projection;

/// Turns points of the picture into rays.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Camera {
    pub eye: Vec3,
    /// Unit vector towards what is looked at.
    pub forward: Vec3,
    pub projection: Projection,
    /// From the middle of the picture to its right and upper rim: at distance 1, or in metres
    /// when there is no foreshortening.
    pub right: Vec3,
    pub up: Vec3,
    pub lens_radius: f32,
    /// Distance along `forward` of what is sharp.
    pub focus: f32,
}

impl Camera {
    /// A camera at `eye` that looks at `target`, both in scene-local metres.
    ///
    /// `fov` is the horizontal angle of view, `aspect` width over height. Looking straight up or
    /// down, the top of the picture is north; looking at the eye itself means looking north. Only
    /// a perspective has a lens; a panorama stands upright, with the target in its middle column,
    /// whatever the angle of view.
    pub fn new(
        projection: Projection,
        eye: Vec3,
        target: Vec3,
        fov: f32,
        aspect: f32,
        lens_radius: f32,
    ) -> Self {
        let focus = (target - eye).length().max(0.05);
        let forward = (target - eye).normalize_or(Vec3::Y);
        let side = forward.cross(Vec3::Z);
        let side = if side.length() > 1e-4 { side.normalize() } else { Vec3::X };
        let half_width = match projection {
            Projection::Orthographic => focus * libm::tanf(0.5 * fov),
            Projection::Perspective | Projection::Panorama => libm::tanf(0.5 * fov),
        };
        Self {
            eye,
            forward,
            projection,
            right: side * half_width,
            up: side.cross(forward) * (half_width / aspect),
            lens_radius,
            focus,
        }
    }

    /// Distance of a point along the view axis, m; in a panorama, from the eye.
    pub fn depth(&self, position: Vec3) -> f32 {
        let away = position - self.eye;
        match self.projection {
            Projection::Panorama => away.length(),
            Projection::Perspective | Projection::Orthographic => away.dot(self.forward),
        }
    }

    /// Width of half a pixel at the eye, m, and what it gains on a metre, in a picture of `width`
    /// pixels: half, because the samples of a pixel are spread over it and blur once more.
    pub fn cone(&self, width: usize) -> [f32; 2] {
        let half = self.right.length() / width as f32;
        match self.projection {
            Projection::Perspective => [0.0, half],
            Projection::Orthographic => [half, 0.0],
            Projection::Panorama => [0.0, PI / width as f32],
        }
    }

    /// The ray through a point of the picture: x from -1 (left) to 1, y from -1 (bottom) to 1;
    /// `lens` picks a point of the lens.
    pub fn ray(&self, x: f32, y: f32, lens: [f32; 2]) -> Ray {
        match self.projection {
            Projection::Perspective => self.perspective(x, y, lens),
            Projection::Orthographic => {
                Ray { origin: self.eye + x * self.right + y * self.up, direction: self.forward }
            }
            Projection::Panorama => Ray { origin: self.eye, direction: self.around(x, y) },
        }
    }

    /// The direction of a point of a panorama: longitude along x, latitude along y.
    fn around(&self, x: f32, y: f32) -> Vec3 {
        let level = self.forward.with_z(0.0).normalize_or(Vec3::Y);
        let right = Vec3::new(level.y, -level.x, 0.0);
        let (sin_x, cos_x) = libm::sincosf(PI * x);
        let (sin_y, cos_y) = libm::sincosf(FRAC_PI_2 * y);
        cos_y * (cos_x * level + sin_x * right) + sin_y * Vec3::Z
    }

    fn perspective(&self, x: f32, y: f32, lens: [f32; 2]) -> Ray {
        let through = self.forward + x * self.right + y * self.up;
        if self.lens_radius == 0.0 {
            return Ray { origin: self.eye, direction: through.normalize() };
        }
        let radius = self.lens_radius * lens[0].sqrt();
        let (sin, cos) = libm::sincosf(TAU * lens[1]);
        let offset =
            radius * (cos * self.right.normalize_or(Vec3::X) + sin * self.up.normalize_or(Vec3::Z));
        let origin = self.eye + offset;
        let sharp = self.eye + self.focus * through;
        Ray { origin, direction: (sharp - origin).normalize() }
    }
}

/// Draws pixel offsets in proportion to a Blackman-Harris window [Harris78], so that every
/// sample weighs the same [Ernst06].
pub(crate) struct Filter {
    /// Offsets at equal steps of the cumulative window, pixels.
    quantiles: Vec<f32>,
}

impl Filter {
    /// Half the width of the window, pixels.
    const RADIUS: f64 = 1.5;
    /// Quantiles kept; between them offsets are interpolated.
    const STEPS: usize = 1024;

    /// The window, integrated.
    pub fn new() -> Self {
        let fine = 8192;
        let window = |i: usize| {
            let phase = std::f64::consts::TAU * (i as f64 + 0.5) / fine as f64;
            0.35875 - 0.48829 * libm::cos(phase) + 0.14128 * libm::cos(2.0 * phase)
                - 0.01168 * libm::cos(3.0 * phase)
        };
        let total: f64 = (0..fine).map(window).sum();
        let (mut index, mut sum) = (0, 0.0);
        let quantile = |step: usize| {
            let goal = total * step as f64 / Self::STEPS as f64;
            while index < fine && sum + window(index) < goal {
                sum += window(index);
                index += 1;
            }
            (Self::RADIUS * (2.0 * index as f64 / fine as f64 - 1.0)) as f32
        };
        Self { quantiles: (0..=Self::STEPS).map(quantile).collect() }
    }

    /// Standard deviation of the offsets, pixels.
    pub fn deviation(&self) -> f32 {
        let squares: f32 = self.quantiles.windows(2).map(|q| (0.5 * (q[0] + q[1])).powi(2)).sum();
        (squares / Self::STEPS as f32).sqrt()
    }

    /// The offset for a uniform number.
    pub fn offset(&self, uniform: f32) -> f32 {
        let scaled = uniform * Self::STEPS as f32;
        let index = (scaled as usize).min(Self::STEPS - 1);
        let (low, high) = (self.quantiles[index], self.quantiles[index + 1]);
        low + (scaled - index as f32) * (high - low)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn perspective(eye: Vec3, target: Vec3, fov: f32, aspect: f32, lens_radius: f32) -> Camera {
        Camera::new(Projection::Perspective, eye, target, fov, aspect, lens_radius)
    }

    #[test]
    fn the_middle_of_the_picture_is_the_target_and_the_rim_is_half_the_angle_away() {
        let fov = 60f32.to_radians();
        let camera = perspective(Vec3::ZERO, Vec3::new(0.0, 10.0, 0.0), fov, 1.5, 0.0);
        assert!(camera.ray(0.0, 0.0, [0.5; 2]).direction.abs_diff_eq(Vec3::Y, 1e-6));
        let right = camera.ray(1.0, 0.0, [0.5; 2]).direction;
        assert!((right.angle_between(Vec3::Y) - fov / 2.0).abs() < 1e-4);
        assert!(right.x > 0.0, "east is to the right when one looks north");
        assert!(camera.ray(0.0, 1.0, [0.5; 2]).direction.z > 0.0);
    }

    fn orthographic(eye: Vec3, target: Vec3, fov_deg: f32) -> Camera {
        let fov = fov_deg.to_radians();
        Camera::new(Projection::Orthographic, eye, target, fov, 2.0, 0.0)
    }

    #[test]
    fn a_plan_keeps_its_scale_at_every_depth_and_is_as_wide_as_the_perspective_at_its_target() {
        let target = Vec3::new(30.0, 40.0, 0.0);
        let camera = orthographic(target.with_z(100.0), target, 90.0);
        for (x, y) in [(-1.0, 0.5), (0.0, 0.0), (1.0, -1.0)] {
            let ray = camera.ray(x, y, [0.3; 2]);
            assert!(ray.direction.abs_diff_eq(-Vec3::Z, 1e-6));
            // 2 · 100 m · tan 45° across, half as much from south (below) to north (above).
            let place = Vec3::new(30.0 + 100.0 * x, 40.0 + 50.0 * y, 100.0);
            assert!(ray.origin.abs_diff_eq(place, 1e-3), "{} {place}", ray.origin);
            assert!((camera.depth(ray.origin + 7.0 * ray.direction) - 7.0).abs() < 1e-4);
        }
    }

    #[test]
    fn a_panorama_sees_every_direction_once_with_east_to_the_right_of_north() {
        let (eye, target) = (Vec3::new(1.0, 2.0, 3.0), Vec3::new(1.0, 22.0, -5.0));
        let camera = Camera::new(Projection::Panorama, eye, target, 1.0, 2.0, 0.1);
        let at = |x, y| camera.ray(x, y, [0.7; 2]).direction;
        for (x, y, direction) in [
            (0.0, 0.0, Vec3::Y),
            (0.5, 0.0, Vec3::X),
            (-0.5, 0.0, -Vec3::X),
            (1.0, 0.0, -Vec3::Y),
            (0.3, 1.0, Vec3::Z),
            (0.3, -1.0, -Vec3::Z),
            (0.0, 0.5, Vec3::new(0.0, 1.0, 1.0).normalize()),
        ] {
            assert!(at(x, y).abs_diff_eq(direction, 1e-6), "{x}, {y}: {}", at(x, y));
        }
        assert!((camera.depth(eye + 4.0 * at(0.9, 0.2)) - 4.0).abs() < 1e-5);
    }

    #[test]
    fn all_rays_through_a_lens_meet_at_the_target() {
        let target = Vec3::new(3.0, 4.0, 1.0);
        let camera = perspective(Vec3::ZERO, target, 1.0, 1.0, 0.2);
        for i in 0..20 {
            let ray = camera.ray(0.0, 0.0, [i as f32 / 20.0, i as f32 * 0.37 % 1.0]);
            let nearest = ray.origin + ray.direction * (target - ray.origin).dot(ray.direction);
            assert!(nearest.abs_diff_eq(target, 1e-4));
        }
    }

    #[test]
    fn looking_straight_down_is_no_special_case_for_the_caller() {
        let camera = perspective(Vec3::Z, Vec3::ZERO, 1.0, 1.0, 0.0);
        assert!(camera.ray(0.3, 0.3, [0.0; 2]).direction.is_finite());
        assert!(perspective(Vec3::Z, Vec3::Z, 1.0, 1.0, 0.0).forward.is_finite());
    }

    #[test]
    fn the_filter_is_symmetric_with_the_variance_of_its_window() {
        let filter = Filter::new();
        let n = 10_000;
        let offsets = (0..n).map(|i| f64::from(filter.offset((i as f32 + 0.5) / n as f32)));
        let (sum, squares) = offsets.fold((0.0, 0.0), |(s, q), x| (s + x, q + x * x));
        let (mean, variance) = (sum / f64::from(n), squares / f64::from(n));
        // Variance of the window over [-R, R], integrated term by term:
        // R² (1/3 + Σ 2 (-1)^k (a_k / a_0) / (π k)²), k = 1..3, with signed coefficients.
        let a = [0.35875, 0.48829, 0.14128, 0.01168];
        let terms = (1..4).map(|k| {
            let pk = std::f64::consts::PI * k as f64;
            2.0 * if k % 2 == 1 { -1.0 } else { 1.0 } * a[k] / a[0] / (pk * pk)
        });
        let exact = Filter::RADIUS.powi(2) * (1.0 / 3.0 + terms.sum::<f64>());
        assert!(mean.abs() < 2e-3, "{mean}");
        assert!((variance - exact).abs() < 0.01 * exact, "{variance} {exact}");
    }
}
