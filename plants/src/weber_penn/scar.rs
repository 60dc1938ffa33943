//! Scars on trunks: dark marks below branches and where branches have been shed.

use super::Level;
use super::stem::radius_at;
use super::tree::{Place, Stem, Tree};
use crate::frame::{across, direction};
use crate::presence::presence;
use crate::skeleton::PlacedOrgan;
use glam::{Quat, Vec3};

/// Scars on the bare trunk of a mature tree: about as many as branches on the same length of
/// crown.
const SHED_BRANCHES: u32 = 26;

/// Trunk radius below which bark is still smooth, m.
const SMOOTH: f32 = 0.012;

impl Tree<'_> {
    /// Scars the bare part of a trunk where branches have been shed.
    pub(super) fn shed(&mut self, stem: &Stem, level: &Level) {
        if self.scar.is_none() {
            return;
        }
        let mut stream = self.seed.stream("scars", stem.bud.id);
        for slot in 0..SHED_BRANCHES {
            let z = self.form.base_size * stream.range(0.06, 1.0) as f32;
            let azimuth = stream.range(0.0, std::f64::consts::TAU) as f32;
            if presence(slot, SHED_BRANCHES, self.stature.maturity) > 0.0 {
                let place = self.place(stem, level, slot, z);
                let radius = radius_at(self.form, level, &stem.bud, z);
                self.scar(&place, direction(azimuth, std::f32::consts::FRAC_PI_2), radius);
            }
        }
    }

    /// Leaves a scar on the trunk below a branch that grows, or grew, towards `towards`.
    pub(super) fn scar(&mut self, place: &Place, towards: Vec3, trunk_radius: f32) {
        if trunk_radius < SMOOTH {
            return;
        }
        let Some(prototype) = self.scar else { return };
        let up = place.frame * Vec3::Z;
        let Some(out) = across(towards, up) else { return };
        let frame = Quat::from_mat3(&glam::Mat3::from_cols(up.cross(out), up, out));
        self.skeleton.organs.push(PlacedOrgan {
            prototype,
            axis: place.axis,
            position: place.position - up * (0.3 * trunk_radius),
            rotation: frame,
            scale: Vec3::splat(trunk_radius),
        });
    }
}
