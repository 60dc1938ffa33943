//! A camera through which a script picks, sketches and saws as with a mouse [Ganster07] §4.2.
//!
//! Places in the picture are x to the right and y down, both 0 to 1 over a square.

use glam::{Vec2, Vec3};

/// A pinhole camera with a square picture.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    eye: Vec3,
    right: Vec3,
    up: Vec3,
    forward: Vec3,
    /// Half the picture's width at unit distance.
    half: f32,
}

/// Nearest distance that is seen, m.
const NEAR: f32 = 1e-3;

/// A place on a branch as the picture shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seen {
    /// Distance in the picture from what was asked for.
    pub distance: f32,
    /// Anchor value of the place.
    pub anchor: f32,
}

impl Camera {
    /// A camera at `eye` that looks at `target`; `None` if both are the same place.
    pub fn new(eye: Vec3, target: Vec3, fov: f32) -> Option<Self> {
        let forward = (target - eye).try_normalize()?;
        let right = forward.cross(Vec3::Z).try_normalize().unwrap_or(Vec3::X);
        let up = right.cross(forward);
        Some(Self { eye, right, up, forward, half: libm::tanf(0.5 * fov) })
    }

    /// Where a place is seen; `None` behind the camera.
    pub fn project(&self, place: Vec3) -> Option<Vec2> {
        let offset = place - self.eye;
        let depth = offset.dot(self.forward);
        let across = Vec2::new(offset.dot(self.right), -offset.dot(self.up));
        (depth > NEAR).then(|| Vec2::splat(0.5) + across / (2.0 * self.half * depth))
    }

    /// The place seen at `at` in the plane through `on` that is parallel to the picture.
    pub fn in_plane(&self, at: Vec2, on: Vec3) -> Vec3 {
        let depth = (on - self.eye).dot(self.forward);
        let across = (at - Vec2::splat(0.5)) * (2.0 * self.half * depth);
        self.eye + self.forward * depth + self.right * across.x - self.up * across.y
    }

    /// The place of a line of control points that is seen nearest to `at`.
    pub fn nearest(&self, points: &[Vec3], at: Vec2) -> Option<Seen> {
        let on_segment = |(k, pair): (usize, &[Vec3])| {
            let (a, b) = (self.project(pair[0])?, self.project(pair[1])?);
            let along = b - a;
            let u = (at - a).dot(along) / along.length_squared().max(f32::MIN_POSITIVE);
            let u = u.clamp(0.0, 1.0);
            // What is halfway in the picture is nearer than halfway in space.
            let depth = |place: Vec3| (place - self.eye).dot(self.forward);
            let (near, far) = (depth(pair[0]), depth(pair[1]));
            let in_space = u * near / (far + u * (near - far));
            let anchor = (k as f32 + in_space) / (points.len() - 1) as f32;
            Some(Seen { distance: (a + u * along).distance(at), anchor })
        };
        let all = points.windows(2).enumerate().filter_map(on_segment);
        all.min_by(|a, b| a.distance.total_cmp(&b.distance))
    }

    /// Whether a branch is seen to come within `margin` of the line from `from` to `to`.
    pub fn crosses(
        &self,
        points: &[Vec3],
        radii: &[f32],
        [from, to]: [Vec2; 2],
        margin: f32,
    ) -> bool {
        points.windows(2).zip(radii).any(|(pair, radius)| {
            let (Some(a), Some(b)) = (self.project(pair[0]), self.project(pair[1])) else {
                return false;
            };
            let depth = (pair[0] - self.eye).dot(self.forward);
            segment_distance([a, b], [from, to]) <= margin + radius / (2.0 * self.half * depth)
        })
    }
}

/// Distance of two segments of the plane.
fn segment_distance([a, b]: [Vec2; 2], [c, d]: [Vec2; 2]) -> f32 {
    let side = |p: Vec2, q: Vec2, r: Vec2| (q - p).perp_dot(r - p);
    let apart = |p, q, r, s| side(p, q, r) * side(p, q, s) < 0.0;
    if apart(a, b, c, d) && apart(c, d, a, b) {
        return 0.0;
    }
    let to_segment = |p: Vec2, a: Vec2, b: Vec2| {
        let u = (p - a).dot(b - a) / (b - a).length_squared().max(f32::MIN_POSITIVE);
        p.distance(a + (b - a) * u.clamp(0.0, 1.0))
    };
    let ends = [to_segment(a, c, d), to_segment(b, c, d), to_segment(c, a, b), to_segment(d, a, b)];
    ends.into_iter().fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::new(Vec3::new(0.0, -10.0, 1.0), Vec3::new(0.0, 0.0, 1.0), 1.0).unwrap()
    }

    #[test]
    fn places_in_a_plane_are_seen_where_they_were_asked_for() {
        let at = Vec2::new(0.2, 0.7);
        let place = camera().in_plane(at, Vec3::new(0.3, 2.0, 4.0));
        assert!((place.y - 2.0).abs() < 1e-4);
        assert!(camera().project(place).unwrap().distance(at) < 1e-5);
        assert_eq!(camera().project(Vec3::new(0.0, -11.0, 0.0)), None);
    }

    #[test]
    fn what_is_seen_on_a_slanting_line_is_found_in_space() {
        let points = [Vec3::new(-1.0, -5.0, 1.0), Vec3::new(3.0, 20.0, 2.0)];
        let at = camera().project(points[0].lerp(points[1], 0.3)).unwrap();
        let seen = camera().nearest(&points, at).unwrap();
        assert!((seen.anchor - 0.3).abs() < 1e-4 && seen.distance < 1e-5);
    }

    #[test]
    fn a_sweep_hits_what_it_crosses_and_nothing_beside() {
        let points = [Vec3::ZERO, Vec3::new(0.0, 0.0, 2.0)];
        let crosses = |from: [f32; 2], to: [f32; 2]| {
            camera().crosses(&points, &[1e-4; 2], [from.into(), to.into()], 1e-3)
        };
        assert!(crosses([0.4, 0.5], [0.6, 0.5]));
        assert!(!crosses([0.52, 0.5], [0.6, 0.5]));
        assert!(!crosses([0.4, 0.1], [0.6, 0.1]));
    }
}
