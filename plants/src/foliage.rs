//! Leaves for trees that are grown without thinking of them: on the youngest wood.

use crate::frame::{across, any_normal};
use crate::material::LeafColor;
use crate::organ::{self, LeafShape};
use crate::skeleton::{PlacedOrgan, Skeleton};
use glam::{Mat3, Quat, Vec3};
use weald_contract::{Problems, Seed, table};

table! {
    /// Leaves on the youngest wood.
    pub struct Foliage {
        /// Leaves at a node of the youngest wood; 0 leaves the tree bare.
        count: u32 = 2, in 0.0..=100.0;
        /// Outline.
        shape: LeafShape = LeafShape::Ovate;
        /// Length, m.
        scale: f32 = 0.1, in 0.001..=10.0;
        /// Width over length.
        scale_x: f32 = 0.6, in 0.01..=5.0;
        /// Spread of size, relative.
        scale_v: f32 = 0.15, in 0.0..=0.9;
        /// Angle from the twig, degrees.
        down_angle_deg: f32 = 50.0, in 0.0..=180.0;
        /// How far leaves turn their faces to the light, 0 to 1.
        bend: f32 = 0.5, in 0.0..=1.0;
        /// Rise of the margin over the midrib, relative to length.
        fold: f32 = 0.12, in 0.0..=1.0;
        /// Kinds of leaves that differ in colour.
        hues: u32 = 3, in 1.0..=8.0;
        /// Colour.
        color: LeafColor = LeafColor::default();
    }
}

/// A piece of young wood that bears leaves.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twig {
    /// Index of its axis in the skeleton.
    pub axis: u32,
    /// Name of the node, the same whatever grows elsewhere.
    pub id: u64,
    /// Where it begins, m.
    pub from: Vec3,
    /// Where it ends, m.
    pub to: Vec3,
}

impl Foliage {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        self.color.check()
    }

    /// Puts leaves on twigs.
    pub fn dress(&self, skeleton: &mut Skeleton, twigs: &[Twig], vigor: f32, seed: Seed) {
        if self.count == 0 || twigs.is_empty() {
            return;
        }
        let first = skeleton.prototypes.len() as u32;
        for hue in 0..self.hues {
            let material = self.color.material(&format!("leaf-{hue}"), vigor, hue, self.hues);
            let material = skeleton.add_material(material);
            let mesh = organ::leaf(self.shape, self.fold, 0.2, material);
            skeleton.add_prototype(&format!("leaf-{hue}"), vec![mesh]);
        }
        skeleton.organs.reserve(twigs.len() * self.count as usize);
        for twig in twigs {
            for slot in 0..self.count {
                skeleton.organs.push(self.leaf(twig, slot, first, seed));
            }
        }
    }

    fn leaf(&self, twig: &Twig, slot: u32, first: u32, seed: Seed) -> PlacedOrgan {
        let mut stream = Seed(seed.0 ^ twig.id).stream("leaf", u64::from(slot));
        let along = (slot as f32 + stream.unit() as f32) / self.count as f32;
        let position = twig.from.lerp(twig.to, along);
        let axis = (twig.to - twig.from).try_normalize().unwrap_or(Vec3::Z);
        let side = any_normal(axis);
        let turn = slot as f32 * 2.4 + stream.range(0.0, std::f64::consts::TAU) as f32;
        let (sin_t, cos_t) = libm::sincosf(turn);
        let down = self.down_angle_deg.to_radians() * stream.range(0.8, 1.2) as f32;
        let (sin_d, cos_d) = libm::sincosf(down);
        let out = side * cos_t + axis.cross(side) * sin_t;
        let heading = (axis * cos_d + out * sin_d).normalize();
        let grown = across(axis, heading).unwrap_or_default() * (1.0 - self.bend);
        let lit = across(Vec3::Z, heading).unwrap_or_default() * self.bend;
        let upper = across(grown + lit, heading).unwrap_or_else(|| any_normal(heading));
        let length = self.scale * (1.0 + self.scale_v * stream.range(-1.0, 1.0) as f32);
        PlacedOrgan {
            prototype: first + stream.below(u64::from(self.hues)) as u32,
            axis: twig.axis,
            position,
            rotation: Quat::from_mat3(&Mat3::from_cols(heading.cross(upper), heading, upper)),
            scale: Vec3::new(length * self.scale_x, length, length),
        }
    }
}
