//! A tuft of grass or sedge: blades that rise from one foot and arch outwards.

use crate::Stature;
use crate::frame::direction;
use crate::material::{LeafColor, leaf};
use crate::presence::presence;
use crate::skeleton::{Axis, AxisKind, Node, Skeleton, axis_id};
use glam::Vec3;
use weald_contract::{Problems, Seed, Stream, table};

table! {
    /// A tuft.
    pub struct Grass {
        /// Blades of a tuft of vigor 0 and of vigor 1.
        blades: [u32; 2] = [18, 45], in 1.0..=2000.0;
        /// Width of a blade, m.
        width: f32 = 0.004, in 0.0001..=0.5;
        /// Segments of a blade.
        segments: u32 = 4, in 1.0..=16.0;
        /// Radius of the foot relative to the tuft's radius.
        foot: f32 = 0.25, in 0.0..=1.0;
        /// Angle from the vertical at the foot: of the innermost and the outermost blades.
        lean_deg: [f32; 2] = [3.0, 35.0], in 0.0..=90.0;
        /// How far blades bend over towards their tips: innermost and outermost.
        arch_deg: [f32; 2] = [25.0, 80.0], in 0.0..=170.0;
        /// Part of the blades that are dry at vigor 1; all of those lost to vigor are dry too.
        dry: f32 = 0.12, in 0.0..=1.0;
        /// Flowering stems at vigor 1.
        heads: u32 = 2, in 0.0..=200.0;
        /// Length of a seed head relative to the height.
        head_length: f32 = 0.2, in 0.0..=0.9;
        /// Thickness of a seed head, m.
        head_width: f32 = 0.008, in 0.0001..=0.2;
        /// Colour of the seed heads.
        head_color: [f32; 3] = [0.26, 0.20, 0.11], in 0.0..=0.8;
        /// Colour of the blades.
        color: LeafColor = grass_green();
    }
}

/// Meadow grass: a little yellower than tree leaves.
fn grass_green() -> LeafColor {
    let mut color = LeafColor::default();
    color.reflectance.value = [0.07, 0.13, 0.03];
    color.transmittance.value = [0.06, 0.12, 0.02];
    color
}

/// Width of a blade along its length, relative to its greatest: narrow at the foot, widest in
/// the lower third, a long point.
fn blade_width(t: f32) -> f32 {
    (0.65 + 1.4 * t).min(1.0) * (1.0 - t * t)
}

/// Depth below the ground at which blades begin, m: on a slope none may float.
const ROOT_DEPTH: f32 = 0.02;

/// Kinds of blades by colour: two greens and straw.
struct Colors {
    green: [u32; 2],
    dry: u32,
    head: u32,
}

impl Grass {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        self.color.check()
    }

    /// Grows a tuft.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Skeleton {
        let mut skeleton = Skeleton::default();
        let colors = self.colors(&mut skeleton, stature.vigor);
        let [few, many] = self.blades;
        let count = few.max(many);
        let filled = (few as f32 + (many as f32 - few as f32) * stature.vigor) / count as f32;
        // Seedlings have fewer blades as well.
        let filled = filled * (0.3 + 0.7 * stature.maturity.sqrt());
        for slot in 0..count {
            let grown = presence(slot, count, filled);
            if grown > 0.0 {
                self.blade(&mut skeleton, &colors, stature, slot, grown, seed);
            }
        }
        for slot in 0..self.heads {
            let grown = presence(slot, self.heads, stature.vigor * stature.maturity);
            if grown > 0.0 {
                self.head(&mut skeleton, &colors, stature, slot, grown, seed);
            }
        }
        fit(&mut skeleton, stature);
        skeleton
    }

    fn colors(&self, skeleton: &mut Skeleton, vigor: f32) -> Colors {
        let green = [0, 1].map(|i| {
            skeleton.add_material(self.color.material(&format!("blade-{i}"), vigor, i, 2))
        });
        let dry = self.color.dry;
        let dry = skeleton.add_material(leaf("straw", dry, dry.map(|c| 0.3 * c), 0.7));
        let part = self.head_color.map(|c| 0.25 * c);
        let head = skeleton.add_material(leaf("seed-head", self.head_color, part, 0.8));
        Colors { green, dry, head }
    }

    fn blade(
        &self,
        skeleton: &mut Skeleton,
        colors: &Colors,
        stature: &Stature,
        slot: u32,
        grown: f32,
        seed: Seed,
    ) {
        let mut stream = seed.stream("blade", u64::from(slot));
        // 0 in the middle of the tuft, 1 at its rim; the square root spreads blades evenly.
        let rim = stream.unit().sqrt() as f32;
        let azimuth = stream.range(0.0, std::f64::consts::TAU) as f32;
        let withers = self.dry + (1.0 - self.dry) * 0.5 * (1.0 - stature.vigor);
        let is_dry = (stream.unit() as f32) < withers;
        let material = if is_dry { colors.dry } else { colors.green[stream.below(2) as usize] };
        let length = stature.height * grown * stream.range(0.55, 1.1) as f32;
        let path = self.arch(rim, is_dry, &mut stream);
        let foot =
            direction(azimuth, std::f32::consts::FRAC_PI_2) * (rim * self.foot * stature.radius);
        let facing = azimuth + stream.around(0.0, 0.5) as f32;
        let width = self.width * stream.range(0.7, 1.2) as f32 * thin(stature);
        let shape = Arch { foot, azimuth: facing, length, path };
        let nodes = shape.blade(self.segments, |t| 0.5 * width * blade_width(t));
        let id = axis_id(0, "blade", slot);
        let axis = Axis::new(id, AxisKind::Blade, material);
        skeleton.push(axis.facing(-direction(facing, 1.0).with_z(-0.5).normalize()), nodes);
    }

    /// Angles from the vertical at the foot and the tip, rad.
    fn arch(&self, rim: f32, is_dry: bool, stream: &mut Stream) -> [f32; 2] {
        let between = |[a, b]: [f32; 2]| (a + (b - a) * rim).to_radians();
        let lean = between(self.lean_deg) * stream.range(0.6, 1.4) as f32;
        let arch = between(self.arch_deg) * stream.range(0.5, 1.5) as f32;
        // Dry blades have gone limp.
        let limp = if is_dry { 0.35 } else { 0.0 };
        [lean + 0.5 * limp, (lean + arch + limp).min(2.9)]
    }

    fn head(
        &self,
        skeleton: &mut Skeleton,
        colors: &Colors,
        stature: &Stature,
        slot: u32,
        grown: f32,
        seed: Seed,
    ) {
        let mut stream = seed.stream("head", u64::from(slot));
        let azimuth = stream.range(0.0, std::f64::consts::TAU) as f32;
        let rim = stream.unit() as f32;
        let foot = direction(azimuth, std::f32::consts::FRAC_PI_2)
            * (0.5 * rim * self.foot * stature.radius);
        let length = stature.height * grown * stream.range(1.05, 1.35) as f32;
        let lean = self.lean_deg[0].to_radians() + 0.12 * rim;
        let path = [lean, lean + stream.range(0.1, 0.5) as f32];
        let stem = Arch { foot, azimuth, length, path };
        let width = 0.25 * self.width * thin(stature);
        let from = 1.0 - self.head_length;
        let thick = 0.5 * self.head_width * thin(stature) * grown;
        // Stem and head are one axis each: the head swells and closes to a point.
        let stalk = stem.part(0.0, from, 3, |_| width);
        let head = stem.part(from, 1.0, 4, |t| thick * (0.35 + 2.6 * t).min(1.0) * (1.02 - t));
        let id = axis_id(0, "stalk", slot);
        let stalk = skeleton.push(Axis::new(id, AxisKind::Stem, colors.green[1]), stalk);
        let axis = Axis::new(axis_id(id, "head", 0), AxisKind::Stem, colors.head).on(stalk, 1.0, 1);
        skeleton.push(axis, head);
    }
}

/// Thinner parts for seedlings: a blade of a young tuft is narrower, though less than shorter.
fn thin(stature: &Stature) -> f32 {
    stature.maturity.sqrt().max(0.05)
}

/// Stretches a tuft to the height and radius asked for.
pub(crate) fn fit(skeleton: &mut Skeleton, stature: &Stature) {
    let up = skeleton.stretch_to(stature.height);
    // A tuft so narrow or wide that its blades would break keeps some of its own shape.
    let across = (stature.radius / skeleton.reach().max(1e-6)).clamp(0.4 * up, 2.5 * up);
    skeleton.stretch(across, up, 1.0);
}

/// A midline in a vertical plane whose angle from the vertical grows evenly with length.
pub(crate) struct Arch {
    /// First point, m.
    pub foot: Vec3,
    /// Direction of leaning over, rad from X over Y.
    pub azimuth: f32,
    /// Length, m.
    pub length: f32,
    /// Angle from the vertical at the first and the last point, rad.
    pub path: [f32; 2],
}

impl Arch {
    /// The point at the fraction `t` of the length.
    ///
    /// Exact for a constant angle; otherwise the arc of a circle, by its chord.
    pub fn point(&self, t: f32) -> Vec3 {
        let [from, to] = self.path;
        let turn = (to - from) * t;
        // The chord of an arc of angle a has length sin(a/2) / (a/2) of the arc's and the mean
        // direction of its ends.
        let half = 0.5 * turn;
        let chord = if half.abs() < 1e-4 { 1.0 } else { libm::sinf(half) / half };
        self.foot + direction(self.azimuth, from + half) * (self.length * t * chord)
    }

    /// The point at the fraction `t` of the polygon of `segments` that [`Arch::stem`] makes of
    /// it: what grows there stands on what is drawn.
    pub fn point_on(&self, segments: u32, t: f32) -> Vec3 {
        let place = (t * segments as f32).clamp(0.0, segments as f32);
        let before = libm::floorf(place).min(segments as f32 - 1.0);
        let corner = |i: f32| self.point(i / segments as f32);
        corner(before).lerp(corner(before + 1.0), place - before)
    }

    /// Nodes of a blade, its first moved a little below ground.
    pub fn blade(&self, segments: u32, radius: impl Fn(f32) -> f32) -> Vec<Node> {
        let mut nodes = self.part(0.0, 1.0, segments, radius);
        // Blades that arch over come to lie on the ground.
        nodes.iter_mut().for_each(|node| node.position.z = node.position.z.max(0.0));
        nodes[0].position -= self.root();
        nodes
    }

    /// Nodes of a stem, with one more below ground: leaves may grow right from the foot.
    pub fn stem(&self, segments: u32, radius: impl Fn(f32) -> f32) -> Vec<Node> {
        let mut nodes = self.part(0.0, 1.0, segments, radius);
        let root = Node { position: nodes[0].position - self.root(), ..nodes[0] };
        nodes.insert(0, root);
        nodes
    }

    /// From the root to the foot.
    fn root(&self) -> Vec3 {
        direction(self.azimuth, self.path[0]) * ROOT_DEPTH
    }

    /// Nodes of the part between two fractions of the length; `radius` takes the fraction of
    /// the part.
    pub fn part(
        &self,
        from: f32,
        to: f32,
        segments: u32,
        radius: impl Fn(f32) -> f32,
    ) -> Vec<Node> {
        let node = |i: u32| {
            let t = i as f32 / segments as f32;
            let radius = if i < segments { radius(t).max(1e-5) } else { radius(t).max(0.0) };
            Node { position: self.point(from + (to - from) * t), radius }
        };
        (0..=segments).map(node).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_arch_has_its_length_whatever_it_bends() {
        let arch = Arch { foot: Vec3::ZERO, azimuth: 0.4, length: 0.7, path: [0.1, 2.0] };
        let nodes = arch.part(0.0, 1.0, 200, |_| 0.01);
        let length: f32 = nodes.windows(2).map(|p| p[0].position.distance(p[1].position)).sum();
        assert!((length - 0.7).abs() < 1e-4, "{length}");
    }

    #[test]
    fn a_straight_arch_is_straight() {
        let arch = Arch { foot: Vec3::ZERO, azimuth: 0.0, length: 2.0, path: [0.0, 0.0] };
        assert!((arch.point(0.5) - Vec3::Z).length() < 1e-6);
    }

    #[test]
    fn a_blade_is_widest_in_its_lower_half_and_ends_in_a_point() {
        assert_eq!(blade_width(1.0), 0.0);
        assert!(blade_width(0.3) > blade_width(0.0) && blade_width(0.3) > blade_width(0.7));
    }
}
