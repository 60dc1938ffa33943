//! Where the nodes of a graph may be.

use super::Shape;
use crate::volume::{Bounds, Solid};
use glam::Vec3;
use std::borrow::Cow;
use weald_contract::Stream;

/// Part of a volume that is joined to all others: the trunk.
pub const COMMON: u8 = 0;

/// A volume to scatter nodes in.
pub enum Space<'a> {
    /// A union of solids, in parts.
    Union(Union<'a>),
    /// What a further graph fills, from its root at the origin along +Z.
    Unit(Unit),
}

/// A union of solids.
pub struct Union<'a> {
    pieces: Vec<Piece<'a>>,
    /// Sums of the volumes of the boxes up to and with each piece.
    sums: Vec<f64>,
}

/// A solid of a union and the part it belongs to.
pub struct Piece<'a> {
    /// The solid.
    pub solid: Cow<'a, Solid>,
    /// Its part; where pieces overlap the first counts.
    pub part: u8,
    bounds: Bounds,
}

impl<'a> Piece<'a> {
    /// A piece of a part.
    pub fn new(solid: Cow<'a, Solid>, part: u8) -> Self {
        let bounds = solid.bounds();
        Self { solid, part, bounds }
    }
}

impl<'a> Union<'a> {
    /// The union of pieces.
    pub fn new(pieces: Vec<Piece<'a>>) -> Self {
        let mut sum = 0.0;
        let sums = pieces.iter().map(|piece| {
            sum += piece.bounds.volume().max(1e-12);
            sum
        });
        Self { sums: sums.collect(), pieces }
    }

    fn whole(&self) -> f64 {
        self.sums.last().copied().unwrap_or(0.0)
    }

    /// A point drawn evenly from the boxes of the pieces, if it lies in the union; a point of
    /// several pieces counts for the first alone, so that the union is filled evenly.
    fn sample(&self, stream: &mut Stream) -> Option<(Vec3, u8)> {
        let at = stream.unit() * self.whole();
        let index = self.sums.partition_point(|sum| *sum <= at).min(self.pieces.len() - 1);
        let piece = &self.pieces[index];
        let p = in_box(&piece.bounds, stream);
        let is_first = || !self.pieces[..index].iter().any(|other| other.solid.contains(p));
        (piece.solid.contains(p) && is_first()).then_some((p, piece.part))
    }
}

/// A point drawn evenly from a box with one number: steps of a two-millionth of its sides.
#[inline]
fn in_box(bounds: &Bounds, stream: &mut Stream) -> Vec3 {
    let bits = stream.next_u64();
    let part = |shift: u32| ((bits >> shift) & 0x1f_ffff) as f32 * (1.0 / (1 << 21) as f32);
    bounds.low + (bounds.high - bounds.low) * Vec3::new(part(0), part(21), part(42))
}

/// The shape of a further graph: its root at the origin, along +Z, of size 1.
#[derive(Clone, Copy, Debug)]
pub struct Unit {
    shape: Shape,
    cos: f32,
    sin: f32,
    tan: f32,
}

impl Unit {
    /// A shape of a half angle (rad).
    pub fn new(shape: Shape, half_angle: f32) -> Self {
        let (sin, cos) = libm::sincosf(half_angle);
        // Half a turn is the whole ball, whatever rounding makes of its cosine.
        let cos = if half_angle >= std::f32::consts::PI { -1.0 } else { cos };
        Self { shape, cos, sin, tan: sin / cos.max(0.1) }
    }

    #[inline]
    fn contains(&self, p: Vec3) -> bool {
        let across = p.x * p.x + p.y * p.y;
        match self.shape {
            Shape::Sector => {
                let square = across + p.z * p.z;
                square <= 1.0 && p.z >= self.cos * square.sqrt()
            }
            Shape::Cone => p.z >= 0.0 && p.z <= 1.0 && across.sqrt() <= self.tan * (1.0 - p.z),
            Shape::InvertedCone => p.z >= 0.0 && p.z <= 1.0 && across.sqrt() <= self.tan * p.z,
            Shape::Ellipsoid => {
                let along = 2.0 * p.z - 1.0;
                4.0 * across / (self.tan * self.tan) + along * along <= 1.0
            }
        }
    }

    fn bounds(&self) -> Bounds {
        let (width, low) = match self.shape {
            Shape::Sector if self.cos > 0.0 => (self.sin, 0.0),
            Shape::Sector => (1.0, self.cos),
            Shape::Cone | Shape::InvertedCone => (self.tan, 0.0),
            Shape::Ellipsoid => (0.5 * self.tan, 0.0),
        };
        Bounds { low: Vec3::new(-width, -width, low), high: Vec3::new(width, width, 1.0) }
    }

    fn volume(&self) -> f64 {
        let (cos, tan) = (f64::from(self.cos), f64::from(self.tan));
        let pi = std::f64::consts::PI;
        match self.shape {
            Shape::Sector => 2.0 / 3.0 * pi * (1.0 - cos),
            Shape::Cone | Shape::InvertedCone => pi / 3.0 * tan * tan,
            Shape::Ellipsoid => pi / 6.0 * tan * tan,
        }
    }
}

/// Points from which the volume of a union is told: half a hundredth, or better.
const VOLUME_POINTS: u32 = 40_000;

impl Space<'_> {
    /// A point drawn evenly from the space and its part, or `None` for a throw that missed.
    #[inline]
    pub fn sample(&self, stream: &mut Stream) -> Option<(Vec3, u8)> {
        match self {
            Self::Union(union) => union.sample(stream),
            Self::Unit(unit) => {
                let p = in_box(&unit.bounds(), stream);
                unit.contains(p).then_some((p, COMMON))
            }
        }
    }

    /// Whether a point lies inside.
    pub fn contains(&self, p: Vec3) -> bool {
        match self {
            Self::Union(union) => union.pieces.iter().any(|piece| piece.solid.contains(p)),
            Self::Unit(unit) => unit.contains(p),
        }
    }

    /// The part that a point belongs to; what lies outside belongs to all.
    pub fn part_of(&self, p: Vec3) -> u8 {
        match self {
            Self::Union(union) => {
                let found = union.pieces.iter().find(|piece| piece.solid.contains(p));
                found.map_or(COMMON, |piece| piece.part)
            }
            Self::Unit(_) => COMMON,
        }
    }

    /// Whether there are parts that are kept apart.
    pub fn has_parts(&self) -> bool {
        match self {
            Self::Union(union) => union.pieces.iter().any(|piece| piece.part != COMMON),
            Self::Unit(_) => false,
        }
    }

    /// A box around the space.
    pub fn bounds(&self) -> Bounds {
        match self {
            Self::Union(union) => {
                union.pieces.iter().fold(Bounds::NONE, |sum, piece| sum.with(piece.bounds))
            }
            Self::Unit(unit) => unit.bounds(),
        }
    }

    /// Volume: of a union from chance, of a unit by its formula.
    pub fn volume(&self, stream: &mut Stream) -> f64 {
        match self {
            Self::Union(union) => {
                let hits = (0..VOLUME_POINTS).filter(|_| union.sample(stream).is_some()).count();
                union.whole() * hits.max(1) as f64 / f64::from(VOLUME_POINTS)
            }
            Self::Unit(unit) => unit.volume(),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn units_have_the_volumes_of_the_textbook_and_points_within() {
        for shape in [Shape::Sector, Shape::Cone, Shape::InvertedCone, Shape::Ellipsoid] {
            for half_angle in [0.4_f32, 0.9, 1.2] {
                let unit = Unit::new(shape, half_angle);
                let space = Space::Unit(unit);
                let mut stream = Seed(1).stream("volume", 0);
                let hits = (0..100_000).filter(|_| space.sample(&mut stream).is_some()).count();
                let found = unit.bounds().volume() * hits as f64 / 100_000.0;
                assert!((found / unit.volume() - 1.0).abs() < 0.02, "{shape:?} {half_angle}");
            }
        }
        assert!((Unit::new(Shape::Sector, std::f32::consts::PI).volume() - 4.18879).abs() < 1e-4);
    }

    #[test]
    fn a_union_is_filled_evenly_where_its_solids_overlap() {
        // Two unit balls a radius apart: 9/8 pi... their union is 2 * 4/3 pi - 5/12 pi = 9/4 pi.
        let ball = |x: f32| {
            let center = [x, 0.0, 0.0];
            let solid = Solid::Ball(crate::volume::Ball { center, radius: 1.0 });
            Piece::new(Cow::Owned(solid), COMMON)
        };
        let space = Space::Union(Union::new(vec![ball(0.0), ball(1.0)]));
        let mut stream = Seed(2).stream("union", 0);
        let volume = space.volume(&mut stream) / std::f64::consts::PI;
        assert!((volume - 2.25).abs() < 0.03, "{volume}");
        let points: Vec<Vec3> =
            (0..100_000).filter_map(|_| space.sample(&mut stream)).map(|(p, _)| p).collect();
        // The lens that both share is 5/27 of the whole.
        let shared =
            points.iter().filter(|p| p.length() < 1.0 && p.distance(Vec3::X) < 1.0).count();
        assert!((shared as f64 / points.len() as f64 - 5.0 / 27.0).abs() < 0.006);
    }
}
