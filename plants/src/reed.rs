//! Reeds: tall stems with long arching leaves, and a plume or a cattail on top.

use crate::Stature;
use crate::frame::direction;
use crate::grass::{Arch, fit};
use crate::material::{LeafColor, leaf, opaque};
use crate::presence::{filling, presence};
use crate::skeleton::{Axis, AxisKind, Node, Skeleton, axis_id};
use glam::Vec3;
use weald_contract::{Problems, Seed, table, words};

words! {
    /// What stands on top of a reed.
    pub enum ReedHead {
        /// A feathery plume that hangs to one side, as of common reed.
        Plume = "plume",
        /// A brown cylinder below a spike, as of cattails.
        Cattail = "cattail",
        /// Nothing: a shoot that does not flower.
        None = "none",
    }
}

table! {
    /// A clump of reed.
    pub struct Reed {
        /// Stems at full size and vigor.
        stems: u32 = 3, in 1.0..=200.0;
        /// Leaves on a stem.
        leaves: u32 = 8, in 0.0..=100.0;
        /// Where leaves grow, from and to, as parts of the stem.
        leaf_zone: [f32; 2] = [0.2, 0.88], in 0.0..=1.0;
        /// Length of the longest leaves relative to the height.
        leaf_length: f32 = 0.28, in 0.01..=1.5;
        /// Width of a leaf, m.
        leaf_width: f32 = 0.02, in 0.0005..=0.5;
        /// Segments of a leaf.
        segments: u32 = 4, in 1.0..=16.0;
        /// Angle of the leaves from the vertical where they begin and where they end.
        leaf_angle_deg: [f32; 2] = [25.0, 105.0], in 0.0..=170.0;
        /// What stands on top.
        head: ReedHead = ReedHead::Plume;
        /// Length of the head relative to the height.
        head_length: f32 = 0.13, in 0.01..=0.5;
        /// Thickness of a cattail, m.
        head_width: f32 = 0.024, in 0.001..=0.3;
        /// Colour of the head.
        head_color: [f32; 3] = [0.20, 0.14, 0.09], in 0.0..=0.8;
        /// Colour of the stem.
        stem_color: [f32; 3] = [0.16, 0.17, 0.06], in 0.0..=0.8;
        /// Colour of the leaves.
        color: LeafColor = LeafColor::default();
    }
}

/// Segments of a stem.
const STEM_SEGMENTS: u32 = 4;

/// Materials of a clump.
struct Colors {
    stem: u32,
    green: [u32; 2],
    dry: u32,
    head: u32,
}

/// One stem's place and posture.
struct Stem {
    line: Arch,
    axis: u32,
    slot: u32,
    /// How far the stem has come in.
    grown: f32,
}

impl Reed {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        self.color.check()
    }

    /// Grows a clump.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Skeleton {
        let mut skeleton = Skeleton::default();
        let colors = self.colors(&mut skeleton, stature.vigor);
        let filled = filling(stature.maturity, stature.vigor, 0.5, 0.5);
        for slot in 0..self.stems {
            // A clump has at least one stem.
            let grown = if slot == 0 { 1.0 } else { presence(slot, self.stems, filled) };
            if grown > 0.0 {
                let stem = self.stem(&mut skeleton, &colors, stature, slot, grown, seed);
                self.leaves(&mut skeleton, &colors, stature, &stem, seed);
                self.head(&mut skeleton, &colors, stature, &stem, seed);
            }
        }
        fit(&mut skeleton, stature);
        skeleton
    }

    fn colors(&self, skeleton: &mut Skeleton, vigor: f32) -> Colors {
        let stem = skeleton.add_material(opaque("stem", self.stem_color));
        let green = [0, 1]
            .map(|i| skeleton.add_material(self.color.material(&format!("leaf-{i}"), vigor, i, 2)));
        let dry = self.color.dry;
        let dry = skeleton.add_material(leaf("dry", dry, dry.map(|c| 0.3 * c), 0.7));
        let head = match self.head {
            ReedHead::Plume => {
                leaf("plume", self.head_color, self.head_color.map(|c| 0.6 * c), 0.9)
            }
            _ => opaque("cattail", self.head_color),
        };
        Colors { stem, green, dry, head: skeleton.add_material(head) }
    }

    fn stem(
        &self,
        skeleton: &mut Skeleton,
        colors: &Colors,
        stature: &Stature,
        slot: u32,
        grown: f32,
        seed: Seed,
    ) -> Stem {
        let mut stream = seed.stream("stem", u64::from(slot));
        let azimuth = stream.range(0.0, std::f64::consts::TAU) as f32;
        let away = if slot == 0 { 0.0 } else { stream.range(0.15, 0.45) as f32 };
        let foot = direction(azimuth, std::f32::consts::FRAC_PI_2) * (away * stature.radius);
        let lean = stream.range(0.0, 0.1) as f32;
        let length = stature.height * grown * stream.range(0.82, 1.0) as f32;
        let azimuth = azimuth + stream.around(0.0, 1.0) as f32;
        let line =
            Arch { foot, azimuth, length, path: [lean, lean + stream.range(0.0, 0.15) as f32] };
        let radius = stature.stem_radius;
        let nodes = line.stem(STEM_SEGMENTS, |t| radius * (1.0 - 0.75 * t));
        let id = axis_id(0, "stem", slot);
        let axis = skeleton.push(Axis::new(id, AxisKind::Stem, colors.stem), nodes);
        Stem { line, axis, slot, grown }
    }

    fn leaves(
        &self,
        skeleton: &mut Skeleton,
        colors: &Colors,
        stature: &Stature,
        stem: &Stem,
        seed: Seed,
    ) {
        let mut stream = seed.stream("leaves", u64::from(stem.slot));
        // Leaves stand in two rows that the wind turns to one side.
        let plane = stream.range(0.0, std::f64::consts::TAU) as f32;
        let filled = filling(stature.maturity, stature.vigor, 0.3, 0.6);
        for slot in 0..self.leaves {
            let mut chance = |spread: f64| stream.around(0.0, spread) as f32;
            let (turn, size, droop, color) = (chance(0.6), chance(0.15), chance(0.3), chance(1.0));
            let grown = presence(slot, self.leaves, filled);
            if grown == 0.0 {
                continue;
            }
            let part = (slot as f32 + 0.5) / self.leaves as f32;
            let [from, to] = self.leaf_zone;
            let t = from + (to - from) * part;
            let azimuth = plane + std::f32::consts::PI * (slot % 2) as f32 + turn;
            // The middle leaves are the longest.
            let longest = 0.6 + 1.6 * part * (1.0 - part);
            let length = self.leaf_length * stature.height * longest * (1.0 + size) * grown;
            let [start, end] = self.leaf_angle_deg.map(f32::to_radians);
            let path = [start, (end + droop).clamp(start, 2.9)];
            let line = Arch { foot: stem.line.point_on(STEM_SEGMENTS, t), azimuth, length, path };
            let width = self.leaf_width * (0.5 + 0.5 * stature.maturity) * grown;
            let nodes = line.part(0.0, 1.0, self.segments, |t| 0.5 * width * blade(t));
            // The lowest leaves wither first.
            let is_dry = part < 0.35 * (1.2 - stature.vigor);
            let material = if is_dry { colors.dry } else { colors.green[usize::from(color > 0.0)] };
            let id = axis_id(axis_id(0, "stem", stem.slot), "leaf", slot);
            let axis = Axis::new(id, AxisKind::Blade, material).on(stem.axis, t, 1);
            let upper = direction(azimuth + std::f32::consts::PI, 1.570_796_4 - start);
            skeleton.push(axis.facing(upper), nodes);
        }
    }

    fn head(
        &self,
        skeleton: &mut Skeleton,
        colors: &Colors,
        stature: &Stature,
        stem: &Stem,
        seed: Seed,
    ) {
        // Reeds flower when they are nearly grown.
        let ripe = ((stature.maturity - 0.6) / 0.25).clamp(0.0, 1.0) * stem.grown;
        if ripe == 0.0 {
            return;
        }
        match self.head {
            ReedHead::Plume => self.plume(skeleton, colors, stature, stem, ripe, seed),
            ReedHead::Cattail => self.cattail(skeleton, colors, stem, ripe),
            ReedHead::None => {}
        }
    }

    /// Drooping brushes of two-sided ribbons, to the lee side.
    fn plume(
        &self,
        skeleton: &mut Skeleton,
        colors: &Colors,
        stature: &Stature,
        stem: &Stem,
        ripe: f32,
        seed: Seed,
    ) {
        const BRUSHES: u32 = 15;
        let mut stream = seed.stream("plume", u64::from(stem.slot));
        let length = self.head_length * stature.height * ripe;
        for brush in 0..BRUSHES {
            let part = brush as f32 / (BRUSHES - 1) as f32;
            let t = 1.0 - self.head_length * 0.8 * (1.0 - part);
            let azimuth = stem.line.azimuth + stream.around(0.0, 1.6) as f32;
            let start = 0.1 + 0.3 * (1.0 - part);
            let end = start + stream.range(0.5, 1.3) as f32;
            let own = length * (0.85 - 0.3 * part) * stream.range(0.8, 1.2) as f32;
            let line = Arch {
                foot: stem.line.point_on(STEM_SEGMENTS, t),
                azimuth,
                length: own,
                path: [start, end],
            };
            let width = 0.1 * own;
            let nodes =
                line.part(0.0, 1.0, 3, |t| 0.5 * width * (0.3 + 2.5 * t).min(1.0) * (1.0 - t * t));
            let id = axis_id(axis_id(0, "stem", stem.slot), "brush", brush);
            let axis = Axis::new(id, AxisKind::Blade, colors.head).on(stem.axis, t, 1);
            // Turned edgewise by chance, so that the plume is no fan.
            let face = direction(stream.range(0.0, std::f64::consts::TAU) as f32, 1.2);
            skeleton.push(axis.facing(face), nodes);
        }
    }

    /// A cylinder with round ends around the upper stem, and a thin spike above it.
    fn cattail(&self, skeleton: &mut Skeleton, colors: &Colors, stem: &Stem, ripe: f32) {
        let (from, to) = (0.94 - self.head_length, 0.94);
        let thick = 0.5 * self.head_width * ripe;
        let swelling = |t: f32| thick * (4.0 * t.min(1.0 - t) + 0.25).min(1.0);
        let node = |i: u32| {
            let t = i as f32 / 6.0;
            let position = stem.line.point_on(STEM_SEGMENTS, from + (to - from) * t);
            Node { position, radius: swelling(t).max(1e-5) }
        };
        let nodes = (0..=6).map(node);
        let id = axis_id(axis_id(0, "stem", stem.slot), "cattail", 0);
        let axis = Axis::new(id, AxisKind::Stem, colors.head).on(stem.axis, from, 1);
        skeleton.push(axis.facing(Vec3::X), nodes);
    }
}

/// Width of a reed leaf along its length: a rounded foot, then an even taper.
fn blade(t: f32) -> f32 {
    (0.5 + 3.0 * t).min(1.0) * (1.0 - t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn grown(text: &str, maturity: f32) -> Skeleton {
        let reed = Reed::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap();
        let height = 2.0 * maturity;
        let stature = Stature { height, radius: 0.4, stem_radius: 0.005, maturity, vigor: 1.0 };
        reed.grow(&stature, Seed(4))
    }

    fn count(skeleton: &Skeleton, kind: AxisKind) -> usize {
        skeleton.axes.iter().filter(|axis| axis.kind == kind).count()
    }

    #[test]
    fn a_mature_reed_without_head_has_its_stems_and_leaves_and_nothing_else() {
        let reed = grown("stems = 4\nleaves = 6\nhead = \"none\"", 1.0);
        assert_eq!((count(&reed, AxisKind::Stem), count(&reed, AxisKind::Blade)), (4, 24));
        assert!(reed.axes.iter().filter(|a| a.kind == AxisKind::Blade).all(|a| a.parent.is_some()));
    }

    #[test]
    fn reeds_flower_only_when_nearly_grown() {
        let text = "stems = 1\nleaves = 0\nhead = \"cattail\"";
        assert_eq!(count(&grown(text, 0.5), AxisKind::Stem), 1);
        assert_eq!(count(&grown(text, 1.0), AxisKind::Stem), 2);
    }

    #[test]
    fn leaves_begin_within_their_zone() {
        let reed = grown("stems = 2\nleaves = 9\nleaf_zone = [0.3, 0.6]\nhead = \"none\"", 1.0);
        let blades = reed.axes.iter().filter(|axis| axis.kind == AxisKind::Blade);
        assert!(blades.map(|axis| axis.at).all(|at| (0.3..=0.6).contains(&at)));
    }
}
