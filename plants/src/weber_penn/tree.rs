//! The whole tree: trunks, then branches level by level.

use super::stem::{Bud, Piece, pieces, radius_at};
use super::{Level, WeberPenn, formula};
use crate::Stature;
use crate::frame::{rot_x, rot_z};
use crate::material::opaque;
use crate::organ;
use crate::presence::{filling, presence};
use crate::skeleton::{Axis, AxisKind, Skeleton, axis_id};
use glam::{Quat, Vec3};
use std::f32::consts::PI;
use weald_contract::{Seed, seed};

/// Thinnest twig, m: mean radii of the twigs of broadleaved trees are 0.8 to 2.5 mm
/// [Morales24].
const TWIG_RADIUS: f32 = 0.0008;

/// Shortest stem, m: what has just come in still needs a direction.
const SHORTEST: f32 = 1e-4;

/// Fewest and most a branch is stretched to meet the crown radius asked for.
const FIT: (f32, f32) = (0.15, 5.0);

/// Fewest and most the finished crown is stretched sideways to meet the rest.
const STRETCH: (f32, f32) = (0.5, 1.6);

/// Part of the crown radius that the first level of branches reaches; twigs and leaves do the
/// rest.
const BRANCH_REACH: f32 = 0.85;

/// Grows a tree of the stature asked for.
pub(super) fn grow(form: &WeberPenn, stature: &Stature, seed: Seed) -> Skeleton {
    let fit = if form.fit_crown { crown_fit(form, stature, seed) } else { 1.0 };
    let mut tree = Tree::new(form, stature, seed, fit);
    tree.grow(form.level.value.len());
    let mut skeleton = tree.skeleton;
    let up = skeleton.stretch_to(stature.height);
    let across = if form.fit_crown {
        (stature.radius / skeleton.reach().max(1e-6)).clamp(STRETCH.0 * up, STRETCH.1 * up)
    } else {
        up
    };
    skeleton.stretch(across, up, 1.0);
    skeleton
}

/// Factor of the length of first-level branches that makes them reach the crown radius.
///
/// Measured on trunk and branches alone, all slots filled, so that it changes slowly with age.
fn crown_fit(form: &WeberPenn, stature: &Stature, seed: Seed) -> f32 {
    let mature = Stature { maturity: 1.0, vigor: 1.0, ..*stature };
    let mut probe = Tree::new(form, &mature, seed, 1.0);
    probe.grow(2);
    let skeleton = &probe.skeleton;
    let tips = skeleton.axes.iter().filter(|axis| axis.order == 1);
    let mut reaches: Vec<f32> = tips
        .filter_map(|axis| skeleton.nodes_of(axis).last())
        .map(|tip| tip.position.truncate().length())
        .collect();
    reaches.sort_by(f32::total_cmp);
    // The widest quarter makes the crown's outline.
    let widest = &reaches[reaches.len() - reaches.len().div_ceil(4)..];
    let mean = widest.iter().sum::<f32>() / widest.len().max(1) as f32;
    let fit = BRANCH_REACH * stature.radius / mean.max(1e-6);
    if widest.is_empty() { 1.0 } else { fit.clamp(FIT.0, FIT.1) }
}

/// A stem that has grown: what its children and leaves need to know.
pub(super) struct Stem {
    pub bud: Bud,
    /// Its pieces with the axes they became.
    pieces: Vec<(Piece, u32)>,
}

/// A place on an axis.
pub(super) struct Place {
    /// Index of the axis.
    pub axis: u32,
    /// Fraction of the axis.
    pub at: f32,
    /// The point there, m.
    pub position: Vec3,
    /// World from stem there.
    pub frame: Quat,
}

/// A place on a stem where a branch may grow.
struct Slot {
    index: u32,
    /// Fraction of the part of the stem that bears branches, from below.
    part: f32,
    /// Fraction of the whole stem.
    z: f32,
    /// Chances in [-1, 1]: down angle, rotation, length.
    chances: [f32; 3],
    /// How far the branch has come in.
    presence: f32,
}

/// A tree while it grows.
pub(super) struct Tree<'a> {
    pub form: &'a WeberPenn,
    pub stature: &'a Stature,
    pub seed: Seed,
    /// Factor of the length of branches of level 1.
    fit: f32,
    pub skeleton: Skeleton,
    /// Prototype of the scars.
    pub scar: Option<u32>,
    /// Part of the slots that are filled.
    pub filled: f32,
}

impl<'a> Tree<'a> {
    fn new(form: &'a WeberPenn, stature: &'a Stature, seed: Seed, fit: f32) -> Self {
        let filled = filling(stature.maturity, stature.vigor, form.filling_exponent, form.starved);
        let skeleton = Skeleton::default();
        let mut tree = Self { form, stature, seed, fit, skeleton, scar: None, filled };
        tree.dress();
        tree
    }

    /// Adds materials and prototypes: bark by level, then leaf kinds, which take the first
    /// prototypes.
    fn dress(&mut self) {
        let fallback = [[0.15, 0.12, 0.09]];
        let bark = if self.form.bark.is_empty() { &fallback[..] } else { &self.form.bark };
        for (level, &color) in bark.iter().enumerate() {
            self.skeleton.add_material(opaque(&format!("bark-{level}"), color));
        }
        let leaf = &self.form.leaf;
        for hue in 0..leaf.hues {
            let name = format!("leaf-{hue}");
            let material = leaf.color.material(&name, self.stature.vigor, hue, leaf.hues);
            let material = self.skeleton.add_material(material);
            let mesh = organ::leaf(leaf.shape, leaf.fold, 0.08, material);
            self.skeleton.add_prototype(&name, vec![mesh]);
        }
        if let Some(color) = self.form.scar {
            let material = self.skeleton.add_material(opaque("scar", color));
            self.scar = Some(self.skeleton.add_prototype("scar", vec![organ::scar(material)]));
        }
    }

    /// Grows the first `levels` levels, and leaves if those are all.
    fn grow(&mut self, levels: usize) {
        let form = self.form;
        let mut buds = self.trunks();
        for (index, level) in form.level.value.iter().enumerate().take(levels) {
            let mut next = Vec::new();
            for bud in buds {
                let Some(stem) = self.stem(level, bud) else { continue };
                match form.level.value.get(index + 1) {
                    Some(above) => self.branch(&stem, above, &mut next),
                    None => self.leaves(&stem),
                }
            }
            buds = next;
        }
    }

    fn trunks(&self) -> Vec<Bud> {
        let Some(level) = self.form.level.value.first() else { return Vec::new() };
        let trunks = (0..self.form.trunks).map(|index| self.trunk(level, index));
        trunks.filter(|bud| bud.presence > 0.0).collect()
    }

    fn trunk(&self, level: &Level, index: u32) -> Bud {
        let count = self.form.trunks;
        let mut stream = self.seed.stream("trunk", u64::from(index));
        let mut around = |[mean, variation]: [f32; 2]| {
            stream.around(f64::from(mean), f64::from(variation)) as f32
        };
        let yaw = around([PI, PI]);
        // The first trunk is always there.
        let presence = if index == 0 { 1.0 } else { presence(index, count, self.filled) };
        let length = (around(level.length) * self.stature.height * presence).max(SHORTEST);
        // Several trunks stand in a circle, lean out of it and share the section of one.
        let lean = if count > 1 { around(self.form.trunk_lean_deg).to_radians() } else { 0.0 };
        let shared = self.stature.stem_radius / (count as f32).sqrt();
        let away = if count > 1 { 1.5 * shared * count as f32 * around([0.5, 0.5]) } else { 0.0 };
        Bud {
            id: axis_id(0, "trunk", index),
            level: 0,
            parent: None,
            // A positive lean about the stem's X axis is a lean away from its Y axis.
            position: rot_z(yaw) * Vec3::NEG_Y * away,
            frame: rot_z(yaw) * rot_x(lean),
            length,
            radius: self.form.ratio.map_or(shared, |ratio| ratio * length),
            offset: 1.0,
            relative: 1.0,
            presence,
        }
    }

    /// Grows a stem into the skeleton; `None` if pruning leaves nothing of it.
    fn stem(&mut self, level: &Level, bud: Bud) -> Option<Stem> {
        let (bud, grown) = self.pruned(level, bud)?;
        let material = bud.level.min(self.form.bark.len().saturating_sub(1)) as u32;
        let mut indices: Vec<u32> = Vec::with_capacity(grown.len());
        for piece in &grown {
            let mut axis =
                Axis::new(piece.id, AxisKind::Stem, material).facing(bud.frame * Vec3::X);
            let parent = match piece.from {
                Some(from) => {
                    let z = piece.first as f32 / level.curve_res as f32;
                    Some((indices[from], grown[from].own_fraction(z, level.curve_res)))
                }
                None => bud.parent,
            };
            if let Some((parent, at)) = parent {
                axis = axis.on(parent, at, bud.level as u8);
            }
            if bud.level == 0 {
                axis.lobes = (self.form.lobes, self.form.lobe_depth);
            }
            indices.push(self.skeleton.push(axis, piece.nodes(self.form, level, &bud)));
        }
        Some(Stem { bud, pieces: grown.into_iter().zip(indices).collect() })
    }

    /// Shortens a stem until it fits the pruning envelope [WP95] §4.6.
    fn pruned(&self, level: &Level, bud: Bud) -> Option<(Bud, Vec<Piece>)> {
        let grow = |bud: &Bud| pieces(self.form, level, bud, self.seed);
        let free = grow(&bud);
        let Some(prune) = self.form.prune.as_ref().filter(|_| bud.level > 0) else {
            return Some((bud, free));
        };
        if self.is_inside(prune, &free) {
            return Some((bud, free));
        }
        // The longest length that fits, by halving; the last step is a sixty-fourth.
        let (mut fits, mut protrudes) = (0.0, bud.length);
        for _ in 0..6 {
            let length = 0.5 * (fits + protrudes);
            if self.is_inside(prune, &grow(&Bud { length, ..bud })) {
                fits = length;
            } else {
                protrudes = length;
            }
        }
        let length = bud.length + (fits - bud.length) * prune.ratio;
        let short = Bud { length, ..bud };
        // A stub of a fiftieth is not worth growing.
        (length > 0.02 * bud.length).then(|| (short, grow(&short)))
    }

    fn is_inside(&self, prune: &super::Prune, pieces: &[Piece]) -> bool {
        let height = self.stature.height;
        let inside = |point: &Vec3| {
            let ratio = (height - point.z) / (height * (1.0 - self.form.base_size));
            point.truncate().length() < height * formula::envelope(prune, ratio)
        };
        // The base lies on the parent, inside or not.
        pieces.iter().all(|piece| piece.points.iter().skip(1).all(inside))
    }

    /// Puts the buds of the next level on a stem.
    fn branch(&mut self, stem: &Stem, above: &Level, buds: &mut Vec<Bud>) {
        let bud = &stem.bud;
        let Some(level) = self.form.level.value.get(bud.level) else { return };
        let count = match bud.level {
            0 => above.branches,
            1 => formula::second_level_count(above.branches, bud.relative),
            _ => formula::third_level_count(above.branches, bud.offset),
        };
        if bud.level == 0 {
            self.shed(stem, level);
        }
        let bare = if bud.level == 0 { self.form.base_size } else { level.bare };
        let mut stream = self.seed.stream("branches", bud.id);
        let phase = if above.rotate_deg[0] < 0.0 { 0.0 } else { stream.range(0.0, 360.0) as f32 };
        for index in 0..count {
            // Absent branches draw too, so that the others do not change when they come in.
            let chances = [(); 3].map(|()| stream.around(0.0, 1.0) as f32);
            let presence = presence(index, count, self.filled);
            let part = (index as f32 + 0.5) / count as f32;
            let slot = Slot { index, part, z: bare + (1.0 - bare) * part, chances, presence };
            if presence > 0.0 {
                buds.push(self.bud(stem, [level, above], &slot, phase));
            }
        }
    }

    /// The branch at a slot of a stem; `levels` are the stem's own and the branch's.
    fn bud(&mut self, stem: &Stem, [level, above]: [&Level; 2], slot: &Slot, phase: f32) -> Bud {
        let parent = &stem.bud;
        let place = self.place(stem, level, slot.index, slot.z);
        let from_top = 1.0 - slot.part;
        let down = formula::down_angle(above.down_angle_deg, from_top, slot.chances[0]);
        let spin = phase + formula::rotation(above.rotate_deg, slot.index, slot.chances[1]);
        let frame = place.frame * rot_z(spin.to_radians()) * rot_x(down.to_radians());
        let parent_radius = radius_at(self.form, level, parent, slot.z);
        if parent.level == 0 {
            self.scar(&place, frame * Vec3::Z, parent_radius);
        }
        let longest = above.length[0] + above.length[1] * slot.chances[2];
        let (length, relative) = self.child_length(parent, longest, slot);
        let length = (length * slot.presence).max(SHORTEST);
        Bud {
            id: axis_id(parent.id, "branch", slot.index),
            level: parent.level + 1,
            parent: Some((place.axis, place.at)),
            position: place.position,
            frame,
            length,
            radius: self.child_radius(parent, length, parent_radius),
            offset: slot.z,
            relative,
            presence: slot.presence * parent.presence,
        }
    }

    /// Length of a child at a slot, m, and relative to the longest of its level [WP95] §4.3.
    fn child_length(&self, bud: &Bud, longest: f32, slot: &Slot) -> (f32, f32) {
        if bud.level > 0 {
            let relative = 1.0 - 0.6 * slot.z;
            return (longest * bud.length * relative, relative);
        }
        let relative = formula::shape_ratio(self.form.shape, 1.0 - slot.part);
        // Where the envelope comes to a point a stub remains: a stem needs a length.
        let relative = relative.max(0.02);
        (bud.length * longest * relative * self.fit, relative)
    }

    /// Radius of a child at its base, m: by its length, and never above the parent's there.
    fn child_radius(&self, bud: &Bud, length: f32, at_parent: f32) -> f32 {
        let radius = bud.radius * libm::powf((length / bud.length).min(1.0), self.form.ratio_power);
        radius.max(TWIG_RADIUS).min(at_parent).max(1e-5)
    }

    /// A place on a stem; where the stem has clones, the slot's number says on which.
    pub fn place(&self, stem: &Stem, level: &Level, slot: u32, z: f32) -> Place {
        let res = level.curve_res;
        let (piece, axis) = match &stem.pieces[..] {
            [only] => only,
            several => {
                let covering = || several.iter().filter(|(piece, _)| piece.covers(z, res));
                let count = covering().count().max(1) as u64;
                let pick = seed::mix(stem.bud.id ^ u64::from(slot)) % count;
                covering().nth(pick as usize).unwrap_or(&several[0])
            }
        };
        Place {
            axis: *axis,
            at: piece.own_fraction(z, res),
            position: piece.point(z, res, stem.bud.level),
            frame: piece.frame(z, res),
        }
    }
}
