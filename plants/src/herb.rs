//! Flowering herbs: leafy stems with heads of ray petals, or with plumes of small blossoms.

use crate::Stature;
use crate::frame::{direction, frame_of, organ_rotation};
use crate::grass::{Arch, fit};
use crate::material::{LeafColor, opaque, petal};
use crate::organ::{self, LeafShape};
use crate::presence::{filling, presence};
use crate::skeleton::{Axis, AxisKind, PlacedOrgan, Skeleton, axis_id};
use glam::Vec3;
use weald_contract::{Mesh, Problems, Seed, Stream, table, words};

words! {
    /// How an herb flowers.
    pub enum Inflorescence {
        /// Heads with petals around a disc, as of daisies and coneflowers.
        Rays = "rays",
        /// Arching sprays of small blossoms, as of goldenrods.
        Plume = "plume",
        /// Not at all.
        None = "none",
    }
}

table! {
    /// A flowering herb.
    pub struct Herb {
        /// Stems at full size and vigor.
        stems: u32 = 3, in 1.0..=200.0;
        /// Lean of the stems, inner and outer.
        lean_deg: [f32; 2] = [3.0, 22.0], in 0.0..=90.0;
        /// Leaves on a stem at full size and vigor.
        leaves: u32 = 9, in 0.0..=300.0;
        /// Where leaves grow, from and to, as parts of the stem.
        leaf_zone: [f32; 2] = [0.03, 0.85], in 0.0..=1.0;
        /// Outline of the leaves.
        leaf_shape: LeafShape = LeafShape::Lanceolate;
        /// Length of the lowest and the highest leaves, m.
        leaf_length: [f32; 2] = [0.12, 0.04], in 0.001..=2.0;
        /// Width of a leaf over its length.
        leaf_width: f32 = 0.25, in 0.01..=3.0;
        /// Angle between leaf and stem: lowest and highest.
        leaf_angle_deg: [f32; 2] = [75.0, 40.0], in 0.0..=170.0;
        /// How it flowers.
        flower: Inflorescence = Inflorescence::Rays;
        /// Heads on a stem, or blossoms in its plume.
        heads: u32 = 1, in 0.0..=500.0;
        /// Petals of a head.
        petals: u32 = 13, in 3.0..=60.0;
        /// Radius of a head, or of a blossom, m.
        head_radius: f32 = 0.03, in 0.0005..=0.5;
        /// Radius of the disc relative to the head.
        disc: f32 = 0.3, in 0.02..=0.9;
        /// Height of the disc relative to its radius.
        disc_height: f32 = 0.8, in 0.05..=4.0;
        /// Rise of the petals' tips relative to their length; negative ones hang.
        petal_rise: f32 = 0.1, in -2.0..=2.0;
        /// Colour of the petals or blossoms.
        petal_color: [f32; 3] = [0.65, 0.42, 0.02], in 0.0..=0.9;
        /// Colour of the disc.
        disc_color: [f32; 3] = [0.06, 0.03, 0.015], in 0.0..=0.9;
        /// Colour of the stem.
        stem_color: [f32; 3] = [0.10, 0.14, 0.05], in 0.0..=0.8;
        /// Colour of the leaves.
        color: LeafColor = LeafColor::default();
    }
}

/// Kinds of leaves by colour.
const HUES: u32 = 2;

/// Golden angle, rad: leaves of a stem stand at multiples of it [Vogel79].
const GOLDEN_ANGLE: f32 = 2.399_963_2;

/// Segments of a stem.
const STEM_SEGMENTS: u32 = 4;

/// One stem that has grown.
struct Stem {
    line: Arch,
    axis: u32,
    slot: u32,
    grown: f32,
}

impl Herb {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        self.color.check()
    }

    /// Grows a plant.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Skeleton {
        let mut skeleton = Skeleton::default();
        let green = skeleton.add_material(opaque("stem", self.stem_color));
        for hue in 0..HUES {
            let name = format!("leaf-{hue}");
            let material = self.color.material(&name, stature.vigor, hue, HUES);
            let material = skeleton.add_material(material);
            skeleton.add_prototype(&name, vec![organ::leaf(self.leaf_shape, 0.1, 0.3, material)]);
        }
        let flower = self.flower(&mut skeleton);
        let filled = filling(stature.maturity, stature.vigor, 0.5, 0.3);
        for slot in 0..self.stems {
            let grown = if slot == 0 { 1.0 } else { presence(slot, self.stems, filled) };
            if grown > 0.0 {
                let stem = self.stem(&mut skeleton, green, stature, slot, grown, seed);
                self.leaves(&mut skeleton, stature, &stem, seed);
                self.heads(&mut skeleton, green, flower, stature, &stem, seed);
            }
        }
        fit(&mut skeleton, stature);
        skeleton
    }

    /// Adds the prototype of a flower head or a blossom, if there is one.
    fn flower(&self, skeleton: &mut Skeleton) -> Option<u32> {
        if self.flower == Inflorescence::None {
            return None;
        }
        let petals = skeleton.add_material(petal("petal", self.petal_color, 0.35));
        if self.flower == Inflorescence::Plume {
            let mesh = organ::scaled(organ::dome(3, 1.2, petals), self.head_radius, [0.0; 3]);
            return Some(skeleton.add_prototype("blossom", vec![mesh]));
        }
        let disc = skeleton.add_material(opaque("disc", self.disc_color));
        let meshes = self.ray_head(petals, disc);
        Some(skeleton.add_prototype("flower", meshes))
    }

    /// A disc with petals around it, in metres.
    fn ray_head(&self, petal_material: u32, disc_material: u32) -> Vec<Mesh> {
        let radius = self.head_radius;
        let long = 1.0 - 0.8 * self.disc;
        // Petals touch each other where they are widest.
        let width =
            1.5 * std::f32::consts::PI * (0.8 * self.disc + 0.62 * long) / self.petals as f32;
        let inner = 0.8 * self.disc / long;
        let petals =
            organ::petals(self.petals, inner, width / long, self.petal_rise, petal_material);
        let petals = organ::scaled(petals, long * radius, [0.0; 3]);
        let disc = organ::dome(6, self.disc_height, disc_material);
        vec![petals, organ::scaled(disc, self.disc * radius, [0.0; 3])]
    }

    fn stem(
        &self,
        skeleton: &mut Skeleton,
        material: u32,
        stature: &Stature,
        slot: u32,
        grown: f32,
        seed: Seed,
    ) -> Stem {
        let mut stream = seed.stream("stem", u64::from(slot));
        let rim = if slot == 0 { 0.2 } else { stream.unit() as f32 };
        let azimuth = stream.range(0.0, std::f64::consts::TAU) as f32;
        let [inner, outer] = self.lean_deg;
        let lean = (inner + (outer - inner) * rim).to_radians();
        let foot = direction(azimuth, std::f32::consts::FRAC_PI_2) * (0.15 * rim * stature.radius);
        let length = stature.height * grown * stream.range(0.75, 1.0) as f32;
        // Stems right themselves as they grow.
        let path = [lean, lean * stream.range(0.0, 0.7) as f32];
        let line = Arch { foot, azimuth, length, path };
        let radius = stature.stem_radius;
        let nodes = line.stem(STEM_SEGMENTS, |t| radius * (1.0 - 0.6 * t));
        let id = axis_id(0, "stem", slot);
        let axis = skeleton.push(Axis::new(id, AxisKind::Stem, material), nodes);
        Stem { line, axis, slot, grown }
    }

    fn leaves(&self, skeleton: &mut Skeleton, stature: &Stature, stem: &Stem, seed: Seed) {
        let mut stream = seed.stream("leaves", u64::from(stem.slot));
        let phase = stream.range(0.0, std::f64::consts::TAU) as f32;
        let filled = filling(stature.maturity, stature.vigor, 0.4, 0.4);
        for slot in 0..self.leaves {
            let mut chance = || stream.around(0.0, 1.0) as f32;
            let (turn, size, tilt, hue) = (chance(), chance(), chance(), chance());
            let grown = presence(slot, self.leaves, filled) * stem.grown;
            if grown == 0.0 {
                continue;
            }
            let part = (slot as f32 + 0.5) / self.leaves as f32;
            let [from, to] = self.leaf_zone;
            let t = from + (to - from) * part;
            let between = |[low, high]: [f32; 2]| low + (high - low) * part;
            let young = stature.maturity.sqrt();
            let length = between(self.leaf_length) * (1.0 + 0.25 * size) * grown * young;
            let angle = between(self.leaf_angle_deg).to_radians() + 0.2 * tilt;
            let azimuth = phase + GOLDEN_ANGLE * slot as f32 + 0.3 * turn;
            let heading = direction(azimuth, angle);
            let rotation = organ_rotation(frame_of(heading, Vec3::Z));
            skeleton.organs.push(PlacedOrgan {
                prototype: u32::from(hue > 0.0),
                axis: stem.axis,
                position: stem.line.point_on(STEM_SEGMENTS, t),
                rotation,
                scale: Vec3::new(length * self.leaf_width, length, length),
            });
        }
    }

    fn heads(
        &self,
        skeleton: &mut Skeleton,
        stalk: u32,
        flower: Option<u32>,
        stature: &Stature,
        stem: &Stem,
        seed: Seed,
    ) {
        let Some(prototype) = flower else { return };
        // Herbs flower when they are half grown, and hardly without vigor.
        let ripe = ((stature.maturity - 0.4) / 0.3).clamp(0.0, 1.0) * (0.4 + 0.6 * stature.vigor);
        if ripe == 0.0 {
            return;
        }
        let mut stream = seed.stream("heads", u64::from(stem.slot));
        let mut flowers =
            Flowers { herb: self, skeleton, stalk, prototype, stature, stem, stream: &mut stream };
        match self.flower {
            Inflorescence::Rays => flowers.rays(ripe),
            Inflorescence::Plume => flowers.plume(ripe),
            Inflorescence::None => {}
        }
    }
}

/// What the flowers of one stem need while they are placed.
struct Flowers<'a> {
    herb: &'a Herb,
    skeleton: &'a mut Skeleton,
    stalk: u32,
    prototype: u32,
    stature: &'a Stature,
    stem: &'a Stem,
    stream: &'a mut Stream,
}

impl Flowers<'_> {
    /// One head on the stem's tip, the others on side branches below it.
    fn rays(&mut self, ripe: f32) {
        let count = self.herb.heads;
        for slot in 0..count {
            let azimuth = self.stream.range(0.0, std::f64::consts::TAU) as f32;
            let nod = self.stream.range(0.05, 0.5) as f32;
            let long = self.stream.range(0.14, 0.26) as f32;
            let size = self.stream.range(0.85, 1.1) as f32;
            let grown = if slot == 0 { ripe } else { presence(slot, count, ripe) };
            if grown == 0.0 {
                continue;
            }
            let (axis, place) = if slot == 0 {
                (self.stem.axis, self.stem.line.point(1.0))
            } else {
                let t = 0.9 - 0.35 * slot as f32 / count as f32;
                let foot = self.stem.line.point_on(STEM_SEGMENTS, t);
                let length = long * self.stature.height * grown;
                let line = Arch { foot, azimuth, length, path: [0.8, 0.3] };
                self.branch(&line, t, slot)
            };
            let facing = direction(azimuth, nod);
            self.flower(axis, place, facing, size * grown.sqrt() * self.stem.grown);
        }
    }

    /// Arching sprays from the upper third, blossoms sitting on their upper sides.
    fn plume(&mut self, ripe: f32) {
        const SPRAYS: u32 = 9;
        let count = self.herb.heads;
        let per_spray = count.div_ceil(SPRAYS);
        for spray in 0..SPRAYS {
            let part = spray as f32 / (SPRAYS - 1) as f32;
            let t = 0.7 + 0.3 * part;
            let azimuth = self.stem.line.azimuth + GOLDEN_ANGLE * spray as f32;
            let length = (0.19 - 0.1 * part) * self.stature.height * ripe * self.stem.grown;
            let line = Arch {
                foot: self.stem.line.point_on(STEM_SEGMENTS, t),
                azimuth,
                length,
                path: [0.6, 1.8 - part],
            };
            let (axis, _) = self.branch(&line, t, spray);
            for blossom in 0..per_spray.min(count - (spray * per_spray).min(count)) {
                let along =
                    0.2 + 0.8 * (blossom as f32 + self.stream.unit() as f32) / per_spray as f32;
                let size = self.stream.range(0.7, 1.15) as f32 * (1.1 - 0.5 * along);
                let azimuth = self.stream.range(0.0, std::f64::consts::TAU) as f32;
                let facing = direction(azimuth, 0.5);
                self.flower(axis, line.point(along.min(1.0)), facing, size * ripe.sqrt());
            }
        }
    }

    /// Grows a side branch; gives its axis and its tip.
    fn branch(&mut self, line: &Arch, t: f32, slot: u32) -> (u32, Vec3) {
        let radius = 0.45 * self.stature.stem_radius;
        let nodes = line.part(0.0, 1.0, 2, |t| radius * (1.0 - 0.5 * t));
        let id = axis_id(axis_id(0, "stem", self.stem.slot), "branch", slot);
        let axis = Axis::new(id, AxisKind::Stem, self.stalk).on(self.stem.axis, t, 1);
        (self.skeleton.push(axis, nodes), line.point(1.0))
    }

    fn flower(&mut self, axis: u32, position: Vec3, facing: Vec3, size: f32) {
        let rotation = organ_rotation(frame_of(facing, Vec3::X));
        let scale = Vec3::splat(size.max(0.05));
        let prototype = self.prototype;
        self.skeleton.organs.push(PlacedOrgan { prototype, axis, position, rotation, scale });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn grown(text: &str, maturity: f32, vigor: f32) -> Skeleton {
        let herb = Herb::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap();
        let height = 0.8 * maturity;
        herb.grow(&Stature { height, radius: 0.2, stem_radius: 0.003, maturity, vigor }, Seed(4))
    }

    fn organs(skeleton: &Skeleton, name: &str) -> usize {
        let is_named = |organ: &&PlacedOrgan| {
            skeleton.prototypes[organ.prototype as usize].name.starts_with(name)
        };
        skeleton.organs.iter().filter(is_named).count()
    }

    #[test]
    fn a_mature_herb_has_all_leaves_and_heads() {
        let herb = grown("stems = 3\nleaves = 8\nheads = 2", 1.0, 1.0);
        assert_eq!((organs(&herb, "leaf"), organs(&herb, "flower")), (24, 6));
    }

    #[test]
    fn every_blossom_of_a_plume_finds_its_place() {
        for heads in [1, 8, 9, 10, 50] {
            let text = format!("stems = 1\nleaves = 0\nflower = \"plume\"\nheads = {heads}");
            assert_eq!(organs(&grown(&text, 1.0, 1.0), "blossom"), heads);
        }
    }

    #[test]
    fn young_herbs_have_leaves_but_no_flowers() {
        let herb = grown("stems = 1\nleaves = 8\nheads = 2", 0.3, 1.0);
        assert!(organs(&herb, "leaf") > 0);
        assert_eq!(organs(&herb, "flower"), 0);
    }

    #[test]
    fn a_head_is_as_wide_as_asked_for() {
        let text = "stems = 1\nleaves = 0\nhead_radius = 0.05\npetal_rise = 0";
        let herb = grown(text, 1.0, 1.0);
        let flower = herb.prototypes.iter().find(|p| p.name == "flower").unwrap();
        let points = flower.meshes.iter().flat_map(|mesh| &mesh.positions);
        let radius = points.map(|p| p[0].hypot(p[2])).fold(0.0, f32::max);
        assert!((radius - 0.05).abs() < 0.005, "{radius}");
    }
}
