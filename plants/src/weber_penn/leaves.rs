//! Leaves on the last level of stems [WP95] §4.5.

use super::tree::{Stem, Tree};
use super::{Level, formula};
use crate::frame::{across, any_normal};
use crate::presence::presence;
use crate::skeleton::PlacedOrgan;
use glam::{Quat, Vec3};

/// What is settled about a leaf before it is placed.
struct Sprout {
    slot: u32,
    /// Fraction of the leafy part of the stem.
    part: f32,
    /// Angle about the stem of leaf 0, degrees.
    phase: f32,
    /// Chances in [-1, 1]: rotation, down angle, size, hue.
    chances: [f32; 4],
    /// Length, m.
    length: f32,
}

impl Tree<'_> {
    /// Puts its leaves on a stem of the last level.
    pub(super) fn leaves(&mut self, stem: &Stem) {
        let leaf = &self.form.leaf;
        let bud = &stem.bud;
        let Some(level) = self.form.level.value.get(bud.level) else { return };
        let count = formula::leaf_count(leaf.count, bud.offset, leaf.quality);
        // A seedling's leaves are in proportion to it; those of a tree do not know its height.
        let young = 1.0 / (1.0 + 3.0 * leaf.scale / self.stature.height);
        let size = leaf.scale / leaf.quality.sqrt() * young * bud.presence;
        let mut stream = self.seed.stream("leaves", bud.id);
        let phase = stream.range(0.0, 360.0) as f32;
        for slot in 0..count {
            // Absent leaves draw too, so that the others do not change when they come in.
            let chances = [(); 4].map(|()| stream.around(0.0, 1.0) as f32);
            let present = presence(slot, count, self.filled);
            if present > 0.0 {
                let part = (slot + 1) as f32 / count as f32;
                let length = size * present * (1.0 + leaf.scale_v * chances[2]);
                let sprout = Sprout { slot, part, phase, chances, length };
                let organ = self.leaf(stem, level, &sprout);
                self.skeleton.organs.push(organ);
            }
        }
    }

    fn leaf(&self, stem: &Stem, level: &Level, sprout: &Sprout) -> PlacedOrgan {
        let leaf = &self.form.leaf;
        let Sprout { slot, part, phase, chances, length } = *sprout;
        let is_fan = leaf.count < 0;
        let z = if is_fan { 1.0 } else { level.bare + (1.0 - level.bare) * part };
        let (spin, down) = if is_fan {
            (phase + 90.0, leaf.rotate_deg[0] * (part - 0.5))
        } else {
            let spin = phase + formula::rotation(leaf.rotate_deg, slot, chances[0]);
            (spin, formula::down_angle(leaf.down_angle_deg, 1.0 - z, chances[1]))
        };
        let place = self.place(stem, level, slot, z);
        let (heading, upper) = leaf_directions(spin.to_radians(), down.to_radians());
        let (heading, upper) = (place.frame * heading, place.frame * upper);
        let position = place.position + heading * (leaf.stalk * length);
        let hue = ((0.5 + 0.5 * chances[3]) * leaf.hues as f32) as u32;
        PlacedOrgan {
            prototype: hue.min(leaf.hues - 1),
            axis: place.axis,
            position,
            rotation: self.pose(heading, upper, position),
            scale: Vec3::new(length * leaf.scale_x, length, length),
        }
    }

    /// Lets a leaf hang and turn its face to the light, which comes from above and outside.
    fn pose(&self, heading: Vec3, upper: Vec3, position: Vec3) -> Quat {
        let leaf = &self.form.leaf;
        let hanging = heading + (-Vec3::Z - heading) * leaf.droop;
        let heading = hanging.try_normalize().unwrap_or(heading);
        // The face turns about the leaf's own length, as a blade does on its stalk.
        let light = Vec3::Z + 0.5 * position.with_z(0.0).normalize_or_zero();
        let grown = across(upper, heading).unwrap_or_default() * (1.0 - leaf.bend);
        let lit = across(light, heading).unwrap_or_default() * leaf.bend;
        let upper = across(grown + lit, heading).unwrap_or_else(|| any_normal(heading));
        Quat::from_mat3(&glam::Mat3::from_cols(heading.cross(upper), heading, upper))
    }
}

/// Heading and upper side of a leaf in its stem's frame: `spin` about the stem, then `down` from
/// it, the upper side towards the stem's tip.
fn leaf_directions(spin: f32, down: f32) -> (Vec3, Vec3) {
    let (sin_s, cos_s) = libm::sincosf(spin);
    let (sin_d, cos_d) = libm::sincosf(down);
    let out = Vec3::new(sin_s, -cos_s, 0.0);
    (out * sin_d + Vec3::Z * cos_d, Vec3::Z * sin_d - out * cos_d)
}
