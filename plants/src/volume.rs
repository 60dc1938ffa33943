//! Solids that trees grow in: primitives, their union, and surfaces of revolution.
//!
//! A solid is known by its signed distance, negative inside. Distances are exact for balls,
//! cylinders, tubes and revolved outlines, and never too large for the others, so that "within
//! `d` of the surface" can be asked of all of them.

use crate::frame::any_normal;
use glam::{Vec2, Vec3};
use weald_contract::table::FromTable;
use weald_contract::{Problem, Problems, Stream, Written, choice, table};

choice! {
    /// A solid.
    pub enum Solid by "shape" {
        /// All points within a distance of a centre.
        "ball" => Ball(Ball),
        /// The part of a ball within an angle of an axis through its centre.
        "sector" => Sector(Sector),
        /// A ball stretched along X, Y and Z.
        "ellipsoid" => Ellipsoid(Ellipsoid),
        /// A round pillar between two points, upright or tilted.
        "cylinder" => Cylinder(Cylinder),
        /// A cone.
        "cone" => Cone(Cone),
        /// A box with sides along X, Y and Z.
        "box" => Block(Block),
        /// All points within a distance of a drawn line.
        "tube" => Tube(Tube),
        /// A drawn outline turned about a vertical axis.
        "revolution" => Revolution(Revolution),
    }
}

table! {
    /// All points within a distance of a centre.
    pub struct Ball {
        /// Centre.
        center: [f32; 3] = [0.0; 3];
        /// Radius.
        radius: f32, in 1e-6..=1e6;
    }
}

table! {
    /// The part of a ball within an angle of an axis through its centre.
    pub struct Sector {
        /// Centre of the ball.
        center: [f32; 3] = [0.0; 3];
        /// Radius of the ball.
        radius: f32, in 1e-6..=1e6;
        /// Half of the opening: 90 gives a half ball, 180 the whole.
        half_angle_deg: f32, in 1.0..=180.0;
        /// Direction of the axis.
        axis: [f32; 3] = [0.0, 0.0, 1.0];
    }
}

table! {
    /// A ball stretched along X, Y and Z.
    pub struct Ellipsoid {
        /// Centre.
        center: [f32; 3] = [0.0; 3];
        /// Half axes.
        radii: [f32; 3], in 1e-6..=1e6;
    }
}

table! {
    /// A round pillar between two points.
    pub struct Cylinder {
        /// Centre of the lower end.
        from: [f32; 3] = [0.0; 3];
        /// Centre of the upper end.
        to: [f32; 3];
        /// Radius.
        radius: f32, in 1e-6..=1e6;
    }
}

table! {
    /// A cone.
    pub struct Cone {
        /// Centre of the base.
        base: [f32; 3] = [0.0; 3];
        /// Tip.
        apex: [f32; 3];
        /// Radius of the base.
        radius: f32, in 1e-6..=1e6;
    }
}

table! {
    /// A box with sides along X, Y and Z.
    pub struct Block {
        /// Lowest corner.
        low: [f32; 3];
        /// Highest corner.
        high: [f32; 3];
    }
}

table! {
    /// All points within a distance of a drawn line.
    pub struct Tube {
        /// Corners of the line.
        points: Written<Vec<[f32; 3]>>;
        /// Radius.
        radius: f32, in 1e-6..=1e6;
    }
}

table! {
    /// A drawn outline turned about a vertical axis.
    pub struct Revolution {
        /// Foot of the axis.
        center: [f32; 3] = [0.0; 3];
        /// Corners of the outline: distance from the axis and height, from one end to the other.
        outline: Written<Vec<[f32; 2]>>;
    }
}

/// The value that a table has when nothing is written in it.
///
/// # Panics
/// A field without a default: a mistake in a table's declaration.
pub(crate) fn defaults<T: FromTable>() -> T {
    T::from_table(&Default::default(), Default::default(), &mut Vec::new())
        .unwrap_or_else(|| panic!("a field of a table that may be left out has no default"))
}

/// A box around something.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Bounds {
    /// Lowest coordinates.
    pub low: Vec3,
    /// Highest coordinates.
    pub high: Vec3,
}

impl Bounds {
    /// The box that holds nothing.
    pub const NONE: Self =
        Self { low: Vec3::splat(f32::INFINITY), high: Vec3::splat(f32::NEG_INFINITY) };

    /// The box around both.
    pub fn with(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// The box that holds a point as well.
    pub fn with_point(self, p: Vec3) -> Self {
        self.with(Self { low: p, high: p })
    }

    /// The box that is larger by `by` on all sides.
    pub fn grown(self, by: f32) -> Self {
        Self { low: self.low - by, high: self.high + by }
    }

    /// A point drawn evenly.
    pub fn sample(&self, stream: &mut Stream) -> Vec3 {
        let t = [(); 3].map(|()| stream.unit() as f32);
        self.low + (self.high - self.low) * Vec3::from_array(t)
    }

    /// Volume; 0 of a box that holds nothing.
    pub fn volume(&self) -> f64 {
        let size = (self.high - self.low).max(Vec3::ZERO).as_dvec3();
        size.x * size.y * size.z
    }
}

fn v(p: [f32; 3]) -> Vec3 {
    Vec3::from_array(p)
}

/// Distance to a segment.
pub(crate) fn to_segment(p: Vec3, a: Vec3, b: Vec3) -> f32 {
    let along = b - a;
    let t = (p - a).dot(along) / along.length_squared().max(f32::MIN_POSITIVE);
    p.distance(a + along * t.clamp(0.0, 1.0))
}

/// Length along and distance across the axis from `origin` in direction `axis` (unit).
fn about(p: Vec3, origin: Vec3, axis: Vec3) -> (f32, f32) {
    let along = (p - origin).dot(axis);
    (along, (p - origin - axis * along).length())
}

impl Sector {
    fn axis(&self) -> Vec3 {
        v(self.axis).normalize_or(Vec3::Z)
    }

    fn distance(&self, p: Vec3) -> f32 {
        let (along, across) = about(p, v(self.center), self.axis());
        let ball = (along * along + across * across).sqrt() - self.radius;
        let (sin, cos) = libm::sincosf(self.half_angle_deg.to_radians());
        if self.half_angle_deg >= 180.0 { ball } else { ball.max(across * cos - along * sin) }
    }

    fn contains(&self, p: Vec3) -> bool {
        let q = p - v(self.center);
        let square = q.length_squared();
        square <= self.radius * self.radius
            && (self.half_angle_deg >= 180.0
                || q.dot(self.axis())
                    >= libm::cosf(self.half_angle_deg.to_radians()) * square.sqrt())
    }

    /// A point drawn evenly from the sector.
    pub fn sample(&self, stream: &mut Stream) -> Vec3 {
        let least = libm::cosf(self.half_angle_deg.to_radians());
        let distance = self.radius * libm::cbrtf(stream.unit() as f32);
        let cos = stream.range(f64::from(least), 1.0) as f32;
        let turn = stream.range(0.0, std::f64::consts::TAU) as f32;
        let axis = self.axis();
        let side = any_normal(axis);
        let (sin_t, cos_t) = libm::sincosf(turn);
        let across = side * cos_t + axis.cross(side) * sin_t;
        v(self.center) + (axis * cos + across * (1.0 - cos * cos).max(0.0).sqrt()) * distance
    }

    /// Volume.
    pub fn volume(&self) -> f32 {
        let cos = libm::cosf(self.half_angle_deg.to_radians());
        std::f32::consts::TAU / 3.0 * self.radius.powi(3) * (1.0 - cos)
    }
}

impl Cylinder {
    fn distance(&self, p: Vec3) -> f32 {
        let (from, to) = (v(self.from), v(self.to));
        let length = from.distance(to);
        let (along, across) = about(p, from, (to - from).normalize_or(Vec3::Z));
        let d = Vec2::new(across - self.radius, (along - 0.5 * length).abs() - 0.5 * length);
        d.max(Vec2::ZERO).length() + d.max_element().min(0.0)
    }
}

impl Cone {
    fn distance(&self, p: Vec3) -> f32 {
        let (base, apex) = (v(self.base), v(self.apex));
        let height = base.distance(apex).max(f32::MIN_POSITIVE);
        let (along, across) = about(p, base, (apex - base).normalize_or(Vec3::Z));
        let slant = (height * height + self.radius * self.radius).sqrt();
        let side = (across - self.radius * (1.0 - along / height)) * height / slant;
        side.max(-along)
    }
}

impl Ellipsoid {
    fn distance(&self, p: Vec3) -> f32 {
        let (q, radii) = (p - v(self.center), v(self.radii));
        // Exact on the surface; the gradient's length scales what is near it.
        let (scaled, gradient) = ((q / radii).length(), (q / (radii * radii)).length());
        match gradient > 0.0 {
            true => scaled * (scaled - 1.0) / gradient,
            false => -radii.min_element(),
        }
    }
}

impl Block {
    fn distance(&self, p: Vec3) -> f32 {
        let (low, high) = (v(self.low), v(self.high));
        let d = (low - p).max(p - high);
        d.max(Vec3::ZERO).length() + d.max_element().min(0.0)
    }
}

impl Tube {
    fn distance(&self, p: Vec3) -> f32 {
        let points = &self.points.value;
        let lines = points.windows(2).map(|ends| to_segment(p, v(ends[0]), v(ends[1])));
        let single = points.first().map(|point| p.distance(v(*point)));
        lines.chain(single).fold(f32::INFINITY, f32::min) - self.radius
    }
}

impl Revolution {
    fn distance(&self, p: Vec3) -> f32 {
        let (along, across) = about(p, v(self.center), Vec3::Z);
        let q = Vec2::new(across, along);
        let outline = &self.outline.value;
        let ends = |i: usize| outline.get(i).map_or(Vec2::ZERO, |p| Vec2::from_array(*p));
        let count = outline.len();
        // The outline is closed by lines across to the axis; the axis itself is no surface.
        let closed = |i: usize| match i {
            0 => ends(0) * Vec2::Y,
            i if i <= count => ends(i - 1),
            _ => ends(count - 1) * Vec2::Y,
        };
        let (mut nearest, mut inside) = (f32::INFINITY, false);
        for i in 0..=count {
            let (a, b) = (closed(i), closed(i + 1));
            nearest = nearest.min(to_segment(q.extend(0.0), a.extend(0.0), b.extend(0.0)));
            if (a.y > q.y) != (b.y > q.y) && q.x < a.x + (b.x - a.x) * (q.y - a.y) / (b.y - a.y) {
                inside = !inside;
            }
        }
        if inside { -nearest } else { nearest }
    }
}

impl Solid {
    /// Distance to the surface, negative inside.
    pub fn distance(&self, p: Vec3) -> f32 {
        match self {
            Self::Ball(ball) => p.distance(v(ball.center)) - ball.radius,
            Self::Sector(sector) => sector.distance(p),
            Self::Ellipsoid(ellipsoid) => ellipsoid.distance(p),
            Self::Cylinder(cylinder) => cylinder.distance(p),
            Self::Cone(cone) => cone.distance(p),
            Self::Block(block) => block.distance(p),
            Self::Tube(tube) => tube.distance(p),
            Self::Revolution(revolution) => revolution.distance(p),
        }
    }

    /// Whether a point lies inside or on the surface.
    pub fn contains(&self, p: Vec3) -> bool {
        match self {
            Self::Ball(ball) => p.distance_squared(v(ball.center)) <= ball.radius * ball.radius,
            Self::Sector(sector) => sector.contains(p),
            _ => self.distance(p) <= 0.0,
        }
    }

    /// A box around the solid.
    pub fn bounds(&self) -> Bounds {
        let around = |center: Vec3, by: Vec3| Bounds { low: center - by, high: center + by };
        match self {
            Self::Ball(ball) => around(v(ball.center), Vec3::splat(ball.radius)),
            Self::Sector(sector) => around(v(sector.center), Vec3::splat(sector.radius)),
            Self::Ellipsoid(ellipsoid) => around(v(ellipsoid.center), v(ellipsoid.radii)),
            Self::Cylinder(c) => {
                Bounds::NONE.with_point(v(c.from)).with_point(v(c.to)).grown(c.radius)
            }
            Self::Cone(c) => {
                around(v(c.base), Vec3::splat(c.radius)).with(Bounds::NONE.with_point(v(c.apex)))
            }
            Self::Block(block) => Bounds { low: v(block.low), high: v(block.high) },
            Self::Tube(tube) => {
                let points = tube.points.value.iter();
                points.fold(Bounds::NONE, |sum, p| sum.with_point(v(*p))).grown(tube.radius)
            }
            Self::Revolution(revolution) => {
                let center = v(revolution.center);
                let ring = |[r, z]: [f32; 2]| {
                    around(center + Vec3::Z * z, Vec3::new(r.abs(), r.abs(), 0.0))
                };
                let points = revolution.outline.value.iter();
                points.fold(Bounds::NONE, |sum, p| sum.with(ring(*p)))
            }
        }
    }

    /// Everything wrong with the solid that ranges could not tell.
    pub fn check(&self) -> Problems {
        let fault = match self {
            Self::Tube(tube) if tube.points.value.is_empty() => {
                Some((tube.points.span, "a tube needs a point"))
            }
            Self::Revolution(revolution) => {
                let outline = &revolution.outline;
                let bad = outline.value.len() < 2 || outline.value.iter().any(|p| p[0] < 0.0);
                let what = "an outline needs two points or more, none left of its axis";
                bad.then_some((outline.span, what))
            }
            _ => None,
        };
        fault.map(|(span, what)| Problem::at(span, what)).into_iter().collect()
    }
}

/// Distance to the surface of the union of solids, negative inside.
///
/// Where solids overlap the point may lie deeper than this tells.
pub fn distance(solids: &[Solid], p: Vec3) -> f32 {
    solids.iter().map(|solid| solid.distance(p)).fold(f32::INFINITY, f32::min)
}

/// A box around all solids.
pub fn bounds(solids: &[Solid]) -> Bounds {
    solids.iter().fold(Bounds::NONE, |sum, solid| sum.with(solid.bounds()))
}

/// Volume of a union, from `count` points in its box: the error is about one part in
/// `sqrt(count)`.
pub fn volume(solids: &[Solid], count: u32, stream: &mut Stream) -> f64 {
    let around = bounds(solids);
    let inside = |p| solids.iter().any(|solid| solid.contains(p));
    let hits = (0..count).filter(|_| inside(around.sample(stream))).count();
    around.volume() * hits as f64 / f64::from(count.max(1))
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Seed, Value};

    fn solid(text: &str) -> Solid {
        let mut problems = Vec::new();
        let read = Solid::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
        read.unwrap_or_else(|| panic!("{problems:?}"))
    }

    #[test]
    fn volumes_are_those_of_the_textbook() {
        let pi = std::f64::consts::PI;
        for (text, wanted) in [
            ("shape = 'ball'\nradius = 2", 32.0 / 3.0 * pi),
            // 2/3 pi r^3 (1 - cos 60 deg)
            ("shape = 'sector'\nradius = 2\nhalf_angle_deg = 60", 8.0 / 3.0 * pi),
            ("shape = 'sector'\nradius = 2\nhalf_angle_deg = 120", 8.0 * pi),
            ("shape = 'ellipsoid'\nradii = [1, 2, 3]", 8.0 * pi),
            ("shape = 'cylinder'\nto = [3, 0, 4]\nradius = 1", 5.0 * pi),
            ("shape = 'cone'\napex = [0, 3, 0]\nradius = 2", 4.0 * pi),
            ("shape = 'box'\nlow = [0, 0, 0]\nhigh = [1, 2, 3]", 6.0),
            ("shape = 'tube'\npoints = [[0, 0, 0], [0, 0, 3]]\nradius = 1", (3.0 + 4.0 / 3.0) * pi),
            // A cone of height 3 and radius 2, upside down, as an outline.
            ("shape = 'revolution'\noutline = [[0, 0], [2, 3]]", 4.0 * pi),
        ] {
            let found = volume(&[solid(text)], 200_000, &mut Seed(3).stream("v", 0));
            assert!((found / wanted - 1.0).abs() < 0.02, "{text}: {found} for {wanted}");
        }
    }

    #[test]
    fn what_a_solid_contains_is_at_no_distance_from_it() {
        for text in [
            "shape = 'ball'\nradius = 2",
            "shape = 'sector'\nradius = 2\nhalf_angle_deg = 50\naxis = [1, 2, 0]",
            "shape = 'sector'\nradius = 2\nhalf_angle_deg = 140",
            "shape = 'sector'\nradius = 2\nhalf_angle_deg = 180",
        ] {
            let (solid, mut stream) = (solid(text), Seed(4).stream("c", 0));
            for _ in 0..5_000 {
                let p = solid.bounds().sample(&mut stream);
                let distance = solid.distance(p);
                assert!(distance.abs() < 1e-5 || solid.contains(p) == (distance < 0.0), "{text}");
            }
        }
    }

    #[test]
    fn points_drawn_from_a_sector_lie_in_it_and_fill_it_evenly() {
        let Solid::Sector(sector) = solid(
            "shape = 'sector'\ncenter = [1, 2, 3]\nradius = 2\nhalf_angle_deg = 70\naxis = [1, 1, 0]",
        ) else {
            panic!()
        };
        let mut stream = Seed(5).stream("s", 0);
        let points: Vec<Vec3> = (0..20_000).map(|_| sector.sample(&mut stream)).collect();
        assert!(points.iter().all(|p| sector.distance(*p) < 1e-4));
        // Half of the radius holds an eighth of the volume.
        let center = Vec3::new(1.0, 2.0, 3.0);
        let near = points.iter().filter(|p| p.distance(center) < 1.0).count();
        assert!((near as f32 / 20_000.0 - 0.125).abs() < 0.01);
    }

    #[test]
    fn no_point_is_nearer_to_the_surface_than_its_distance_tells() {
        // A signed distance has a slope of at most 1: a step of h changes it by at most h.
        for text in [
            "shape = 'sector'\nradius = 2\nhalf_angle_deg = 50",
            "shape = 'cone'\napex = [0, 1, 3]\nradius = 2",
            "shape = 'cylinder'\nto = [1, 0, 2]\nradius = 0.5",
            "shape = 'revolution'\noutline = [[1, 0], [2, 1], [0.5, 3]]",
        ] {
            let solid = solid(text);
            let around = solid.bounds().grown(1.0);
            let mut stream = Seed(9).stream("d", 0);
            for _ in 0..2_000 {
                let (a, b) = (around.sample(&mut stream), around.sample(&mut stream));
                let change = (solid.distance(a) - solid.distance(b)).abs();
                assert!(change <= a.distance(b) * 1.001 + 1e-5, "{text}");
            }
        }
    }

    #[test]
    fn an_outline_beyond_its_axis_is_refused() {
        assert!(!solid("shape = 'revolution'\noutline = [[-1, 0], [2, 3]]").check().is_empty());
        assert!(!solid("shape = 'tube'\npoints = []\nradius = 1").check().is_empty());
    }
}
