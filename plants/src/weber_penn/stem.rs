//! One stem: its bends, its forks into clones, and places on it.

use super::{Level, WeberPenn, formula};
use crate::frame::{rot_x, rot_z};
use crate::skeleton::{Node, axis_id};
use glam::{Quat, Vec3};
use weald_contract::{Seed, Stream};

/// Everything that is settled before a stem grows.
#[derive(Clone, Copy, Debug)]
pub(super) struct Bud {
    /// Hash of the path from the root.
    pub id: u64,
    /// Level of the stem, 0 for trunks.
    pub level: usize,
    /// Axis it grows from and the fraction of that axis.
    pub parent: Option<(u32, f32)>,
    /// First point, m.
    pub position: Vec3,
    /// World from stem at the first point: Z along the stem.
    pub frame: Quat,
    /// Length, m.
    pub length: f32,
    /// Radius at the base, m.
    pub radius: f32,
    /// Where it grows on the parent stem, as fraction of that stem's length.
    pub offset: f32,
    /// Length relative to the longest stem of its level.
    pub relative: f32,
    /// How far it has come in, in (0, 1]; see [`crate::presence`].
    pub presence: f32,
}

/// A run of segments without forks: the stem itself or one of its clones.
#[derive(Clone, Debug)]
pub(super) struct Piece {
    /// Hash of the path from the root.
    pub id: u64,
    /// Index of the piece it forks from.
    pub from: Option<usize>,
    /// Segment of the stem that it begins with.
    pub first: u32,
    /// Joints, one more than segments, m.
    pub points: Vec<Vec3>,
    /// World from stem, one a segment.
    pub frames: Vec<Quat>,
}

/// Most pieces of one stem: forks of forks grow without bound.
const MOST_PIECES: usize = 48;

/// Grows the pieces of a stem, parents before their clones.
pub(super) fn pieces(form: &WeberPenn, level: &Level, bud: &Bud, root: Seed) -> Vec<Piece> {
    let first = Start {
        id: bud.id,
        from: None,
        first: 0,
        point: bud.position,
        frame: bud.frame,
        correction: 0.0,
    };
    let mut starts = vec![first];
    let mut pieces = Vec::new();
    while pieces.len() < starts.len() {
        let index = pieces.len();
        let grower =
            PieceGrower { form, level, bud, stream: root.stream("stem", starts[index].id) };
        let piece = grower.grow(index, &mut starts);
        pieces.push(piece);
    }
    pieces
}

/// Where and how a piece begins.
#[derive(Clone, Copy)]
struct Start {
    id: u64,
    from: Option<usize>,
    first: u32,
    point: Vec3,
    frame: Quat,
    /// Angle a segment by which the piece bends back after a fork, rad.
    correction: f32,
}

struct PieceGrower<'a> {
    form: &'a WeberPenn,
    level: &'a Level,
    bud: &'a Bud,
    stream: Stream,
}

impl PieceGrower<'_> {
    fn grow(mut self, index: usize, starts: &mut Vec<Start>) -> Piece {
        let Start { id, from, first, mut point, mut frame, mut correction } = starts[index];
        let res = self.level.curve_res;
        let step = self.bud.length / res as f32;
        let count = (res - first) as usize;
        let mut points = Vec::with_capacity(count + 1);
        let mut frames = Vec::with_capacity(count);
        points.push(point);
        // Splits are diffused: the fraction of a split that is owed goes on to the next joint.
        let mut owed = self.stream.unit() as f32;
        for segment in first..res {
            // A clone's first segment has its direction from the fork.
            if segment > first || first == 0 {
                frame = self.bend(frame, segment, correction);
            }
            point += frame * Vec3::Z * step;
            points.push(point);
            frames.push(frame);
            let left = res - segment - 1;
            let splits = if left > 0 { self.splits(segment, &mut owed) } else { 0 };
            let room = MOST_PIECES.saturating_sub(starts.len()) as u32;
            if splits.min(room) > 0 {
                let fork =
                    Start { id, from: Some(index), first: segment + 1, point, frame, correction };
                let angle = self.fork(&fork, splits.min(room), left, starts);
                frame *= rot_x(angle);
                correction -= angle / left as f32;
            }
        }
        Piece { id, from, first, points, frames }
    }

    /// Number of clones that split off at the end of a segment.
    fn splits(&mut self, segment: u32, owed: &mut f32) -> u32 {
        if self.bud.level == 0 && segment == 0 && self.form.base_splits > 0 {
            return self.form.base_splits;
        }
        *owed += self.level.seg_splits;
        let whole = libm::floorf(*owed);
        *owed -= whole;
        whole as u32
    }

    /// Starts `count` clones and returns the angle by which the stem itself turns away.
    fn fork(&mut self, at: &Start, count: u32, left: u32, starts: &mut Vec<Start>) -> f32 {
        let declination = libm::acosf((at.frame * Vec3::Z).z.clamp(-1.0, 1.0));
        let [mean, variation] = self.level.split_angle_deg;
        let chosen = self.stream.around(f64::from(mean), f64::from(variation)) as f32;
        let angle = (chosen.to_radians() - declination).max(0.0);
        let is_base = self.bud.level == 0 && at.first == 1 && self.form.base_splits > 0;
        for clone in 0..count {
            let frame = if is_base {
                let spin = std::f32::consts::TAU * (clone + 1) as f32 / (count + 1) as f32;
                at.frame * rot_z(spin) * rot_x(angle)
            } else {
                rot_z(self.spread(declination)) * at.frame * rot_x(angle)
            };
            let id = axis_id(at.id, "clone", at.first * 64 + clone);
            let correction = at.correction - angle / left as f32;
            starts.push(Start { id, frame, correction, ..*at });
        }
        angle
    }

    /// Angle about the vertical between a clone and its stem, rad:
    /// `20 + 0.75 (30 + |declination - 90|) u²` degrees to either side [WP95] §4.2.
    fn spread(&mut self, declination: f32) -> f32 {
        let u = self.stream.unit() as f32;
        let side = if self.stream.unit() < 0.5 { -1.0 } else { 1.0 };
        let wide = 30.0 + (declination.to_degrees() - 90.0).abs();
        side * (20.0 + 0.75 * wide * u * u).to_radians()
    }

    /// The frame of a segment from that of the one before.
    fn bend(&mut self, frame: Quat, segment: u32, correction: f32) -> Quat {
        let level = self.level;
        let res = level.curve_res as f32;
        if level.curve_v_deg < 0.0 {
            return self.coil(frame, segment);
        }
        let curve = if level.curve_back_deg == 0.0 {
            level.curve_deg / res
        } else if segment * 2 < level.curve_res {
            2.0 * level.curve_deg / res
        } else {
            2.0 * level.curve_back_deg / res
        };
        let mut angle = curve.to_radians() + correction;
        if self.bud.level >= 2 {
            angle -= self.attraction(frame) / res;
        }
        // Crookedness bends to all sides; about one axis only, as published, a stem would stay
        // in a plane.
        let crooked = f64::from((level.curve_v_deg / res).to_radians());
        let (pitch, side) = (self.stream.around(0.0, crooked), self.stream.range(0.0, 1.0));
        let turned = frame * rot_x(angle);
        let spin = std::f32::consts::TAU * side as f32;
        turned * rot_z(spin) * rot_x(pitch as f32) * rot_z(-spin)
    }

    /// A helix: the heading leans by the size of the negative variation from the stem's axis
    /// and goes once around it in four segments. The paper leaves the pitch open.
    fn coil(&mut self, frame: Quat, segment: u32) -> Quat {
        let lean = rot_x(-self.level.curve_v_deg.to_radians());
        let quarter = rot_z(std::f32::consts::FRAC_PI_2);
        if segment == 0 { frame * lean } else { frame * lean.inverse() * quarter * lean }
    }

    /// How far the whole stem turns upwards, rad: `attraction_up` times declination times the
    /// cosine of the orientation [WP95] §4.8.
    fn attraction(&self, frame: Quat) -> f32 {
        let declination = libm::acosf((frame * Vec3::Z).z.clamp(-1.0, 1.0));
        self.form.attraction_up * declination * (frame * Vec3::Y).z
    }
}

impl Piece {
    /// Whether this piece reaches the fraction `z` of its stem, made of `res` segments.
    pub fn covers(&self, z: f32, res: u32) -> bool {
        z * res as f32 >= self.first as f32
    }

    /// The fraction of this piece's own length at the fraction `z` of the stem.
    pub fn own_fraction(&self, z: f32, res: u32) -> f32 {
        let first = self.first as f32 / res as f32;
        ((z - first) / (1.0 - first)).clamp(0.0, 1.0)
    }

    /// Segment and place within it at the fraction `z` of the stem.
    fn locate(&self, z: f32, res: u32) -> (usize, f32) {
        let s = (z * res as f32 - self.first as f32).clamp(0.0, self.frames.len() as f32);
        let segment = (s as usize).min(self.frames.len() - 1);
        (segment, s - segment as f32)
    }

    /// The frame at the fraction `z` of the stem.
    pub fn frame(&self, z: f32, res: u32) -> Quat {
        self.frames[self.locate(z, res).0]
    }

    /// The point at the fraction `z` of a stem of `order`, on the polygon of the skeleton's nodes:
    /// what grows there stands on what is drawn.
    pub fn point(&self, z: f32, res: u32, order: usize) -> Vec3 {
        let per_segment = nodes_per_segment(order, res);
        let (segment, u) = self.locate(z, res);
        if per_segment == 1 {
            return self.points[segment].lerp(self.points[segment + 1], u);
        }
        let place = u * per_segment as f32;
        let before = libm::floorf(place).min(per_segment as f32 - 1.0);
        let node = |i: f32| self.smooth(segment, i / per_segment as f32);
        node(before).lerp(node(before + 1.0), place - before)
    }

    /// The point at the fraction `u` of a segment, on the Catmull-Rom curve through the joints,
    /// whose midpoints are those of 4-point subdivision [Dyn87].
    fn smooth(&self, segment: usize, u: f32) -> Vec3 {
        let (b, c) = (self.points[segment], self.points[segment + 1]);
        let a = if segment > 0 { self.points[segment - 1] } else { 2.0 * b - c };
        let d = self.points.get(segment + 2).copied().unwrap_or(2.0 * c - b);
        let (u2, u3) = (u * u, u * u * u);
        0.5 * (2.0 * b
            + (c - a) * u
            + (2.0 * a - 5.0 * b + 4.0 * c - d) * u2
            + (3.0 * b - a - 3.0 * c + d) * u3)
    }

    /// Fractions of the stem at which the skeleton gets nodes: joints, and more of them on few
    /// and thick segments, and where the trunk flares.
    fn stations(&self, level: &Level, order: usize, flared: bool) -> Vec<f32> {
        let res = level.curve_res;
        let per_segment = nodes_per_segment(order, res);
        let mut stations: Vec<f32> = (self.first * per_segment..=res * per_segment)
            .map(|i| i as f32 / (res * per_segment) as f32)
            .collect();
        if flared && self.first == 0 {
            let first = stations[1];
            let low = [0.01, 0.025, 0.05, 0.08].into_iter().filter(|&z| z < 0.9 * first);
            stations.splice(1..1, low);
        }
        stations
    }

    /// The nodes of this piece in the skeleton.
    pub fn nodes(&self, form: &WeberPenn, level: &Level, bud: &Bud) -> Vec<Node> {
        let flared = bud.level == 0 && form.flare > 0.0;
        let node = |z: f32| Node {
            position: self.point(z, level.curve_res, bud.level),
            radius: radius_at(form, level, bud, z),
        };
        let stations = self.stations(level, bud.level, flared);
        let mut nodes: Vec<Node> = stations.into_iter().map(node).collect();
        if bud.level == 0 && self.first == 0 {
            // On a slope the ground falls away below the stem's rim: the foot goes deeper.
            let foot = nodes[0];
            let depth = 3.0 * bud.radius;
            nodes.insert(0, Node { position: foot.position - Vec3::Z * depth, ..foot });
        }
        nodes
    }
}

/// Nodes a segment: trunks get at least ten in all and branches five, so that they look bent
/// rather than broken.
fn nodes_per_segment(order: usize, res: u32) -> u32 {
    match order {
        0 => 10_u32.div_ceil(res),
        1 => 5_u32.div_ceil(res),
        _ => 1,
    }
}

/// Radius of a stem at the fraction `z` of its length, m; never less than a fiftieth of its
/// base, since beads would pinch it off.
pub(super) fn radius_at(form: &WeberPenn, level: &Level, bud: &Bud, z: f32) -> f32 {
    let radius = formula::tapered_radius(level.taper, bud.radius, bud.length, z);
    let flare = if bud.level == 0 { formula::flare(form.flare, z) } else { 1.0 };
    (radius * flare).max(0.02 * bud.radius)
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn form(trunk: &str) -> WeberPenn {
        let text =
            format!("{trunk}\n[[level]]\ncurve_res = 8\ncurve_v_deg = 40\n[leaf]\ncount = 0");
        WeberPenn::from_toml(&Value::parse(0, &text).unwrap(), &mut Vec::new()).unwrap()
    }

    fn bud() -> Bud {
        Bud {
            id: 5,
            level: 0,
            parent: None,
            position: Vec3::ZERO,
            frame: Quat::IDENTITY,
            length: 4.0,
            radius: 0.1,
            offset: 1.0,
            relative: 1.0,
            presence: 1.0,
        }
    }

    #[test]
    fn the_smooth_stem_passes_through_its_joints() {
        let form = form("");
        let pieces = pieces(&form, &form.level.value[0], &bud(), Seed(3));
        assert_eq!(pieces.len(), 1);
        for (i, joint) in pieces[0].points.iter().enumerate() {
            let on_curve = pieces[0].point(i as f32 / 8.0, 8, 0);
            assert!(on_curve.distance(*joint) < 1e-5);
        }
    }

    #[test]
    fn segments_are_all_equally_long() {
        let form = form("");
        let piece = pieces(&form, &form.level.value[0], &bud(), Seed(3)).remove(0);
        for pair in piece.points.windows(2) {
            assert!((pair[0].distance(pair[1]) - 0.5).abs() < 1e-5);
        }
    }

    #[test]
    fn base_splits_fork_at_the_end_of_the_first_segment() {
        let form = form("base_splits = 2");
        let pieces = pieces(&form, &form.level.value[0], &bud(), Seed(3));
        assert_eq!(pieces.len(), 3);
        for clone in &pieces[1..] {
            assert_eq!((clone.first, clone.from), (1, Some(0)));
            assert_eq!(clone.points[0], pieces[0].points[1]);
            assert!(!clone.covers(0.1, 8) && clone.covers(0.2, 8));
            assert!((clone.own_fraction(1.0, 8) - 1.0).abs() < 1e-6);
        }
    }

    #[test]
    fn a_flared_trunk_gets_nodes_near_the_ground_and_a_foot_below_it() {
        let form = form("flare = 1");
        let level = &form.level.value[0];
        let piece = pieces(&form, level, &bud(), Seed(3)).remove(0);
        let nodes = piece.nodes(&form, level, &bud());
        assert!(nodes[0].position.z < 0.0 && nodes[1].position == Vec3::ZERO);
        assert!(nodes.windows(2).all(|pair| pair[0].position.z < pair[1].position.z));
        assert!((nodes[1].radius - 0.1 * 1.99).abs() < 1e-3);
    }
}
