//! Axis-aligned boxes.

use glam::Vec3A;

/// A box; empty when `low` exceeds `high`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Bounds {
    pub low: Vec3A,
    pub high: Vec3A,
}

impl Bounds {
    /// The box that holds nothing and adds nothing.
    pub const EMPTY: Bounds = Bounds { low: Vec3A::INFINITY, high: Vec3A::NEG_INFINITY };

    /// The smallest box around points.
    pub fn of(points: impl IntoIterator<Item = Vec3A>) -> Self {
        points.into_iter().fold(Self::EMPTY, |b, p| Self { low: b.low.min(p), high: b.high.max(p) })
    }

    /// The smallest box around both.
    pub fn union(self, other: Self) -> Self {
        Self { low: self.low.min(other.low), high: self.high.max(other.high) }
    }

    /// Whether nothing is inside.
    pub fn is_empty(&self) -> bool {
        self.low.cmpgt(self.high).any()
    }

    /// Middle of the box.
    pub fn center(&self) -> Vec3A {
        0.5 * self.low + 0.5 * self.high
    }

    /// Half the surface; 0 for an empty box.
    pub fn half_area(&self) -> f32 {
        let d = (self.high - self.low).max(Vec3A::ZERO);
        d.x * d.y + d.y * d.z + d.z * d.x
    }
}
