//! The whole tree: trunk, branches level by level, leaves.

use super::stem::{Bud, Piece, pieces, radius_at};
use super::{Level, WeberPenn, formula};
use crate::Stature;
use crate::frame::{any_normal, direction, rot_x, rot_z};
use crate::material::opaque;
use crate::organ;
use crate::presence::{filling, presence};
use crate::skeleton::{Axis, AxisKind, PlacedOrgan, Skeleton, axis_id};
use glam::{Quat, Vec3};
use weald_contract::{Seed, seed};

/// Thinnest twig, m: mean radii of the twigs of broadleaved trees are 0.8 to 2.5 mm
/// [Morales24].
const TWIG_RADIUS: f32 = 0.0008;

/// Scars on the bare trunk of a mature tree: about as many as branches on the same length of
/// crown.
const SHED_BRANCHES: u32 = 26;

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
    let up = stature.height / skeleton.height().max(f32::MIN_POSITIVE);
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
struct Stem {
    bud: Bud,
    pieces: Vec<(Piece, u32)>,
}

struct Tree<'a> {
    form: &'a WeberPenn,
    stature: &'a Stature,
    seed: Seed,
    /// Factor of the length of branches of level 1.
    fit: f32,
    skeleton: Skeleton,
    /// Prototype of the scars.
    scar: Option<u32>,
    /// Part of the slots that are filled.
    filled: f32,
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
        let form = self.form;
        let trunk = |index: u32| {
            let id = axis_id(0, "trunk", index);
            let mut stream = self.seed.stream("trunk", u64::from(index));
            let yaw = stream.range(0.0, std::f64::consts::TAU) as f32;
            // The first trunk is always there.
            let presence = if index == 0 { 1.0 } else { presence(index, form.trunks, self.filled) };
            let level = form.level.value.first()?;
            let length =
                stream.around(f64::from(level.length[0]), f64::from(level.length[1])) as f32;
            let length = (length * self.stature.height * presence).max(1e-4);
            let mut frame = rot_z(yaw);
            let mut position = Vec3::ZERO;
            if form.trunks > 1 {
                let lean = form.trunk_lean_deg;
                let lean = stream.around(f64::from(lean[0]), f64::from(lean[1])) as f32;
                frame *= rot_x(lean.to_radians());
                let foot = 1.5 * self.stature.stem_radius * (form.trunks as f32).sqrt();
                position = direction(yaw - std::f32::consts::FRAC_PI_2, 1.570_796_4)
                    * foot
                    * stream.unit() as f32;
            }
            // Several trunks share the section of one.
            let shared = self.stature.stem_radius / (form.trunks as f32).sqrt();
            let radius = form.ratio.map_or(shared, |ratio| ratio * length);
            let (parent, offset, relative) = (None, 1.0, 1.0);
            let bud = Bud {
                id,
                level: 0,
                parent,
                position,
                frame,
                length,
                radius,
                offset,
                relative,
                presence,
            };
            (presence > 0.0).then_some(bud)
        };
        (0..form.trunks).filter_map(trunk).collect()
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
        let bare = if bud.level == 0 { self.form.base_size } else { level.bare };
        if bud.level == 0 {
            self.shed(stem, level);
        }
        let mut stream = self.seed.stream("branches", bud.id);
        let phase = if above.rotate_deg[0] < 0.0 { 0.0 } else { stream.range(0.0, 360.0) as f32 };
        for slot in 0..count {
            let mut chance = || stream.around(0.0, 1.0) as f32;
            let chances = [chance(), chance(), chance()];
            let present = presence(slot, count, self.filled);
            if present == 0.0 {
                continue;
            }
            let z = bare + (1.0 - bare) * (slot as f32 + 0.5) / count as f32;
            let place = self.place(stem, level, slot, z);
            let down =
                formula::down_angle(above.down_angle_deg, (1.0 - z) / (1.0 - bare), chances[0]);
            let spin = phase + formula::rotation(above.rotate_deg, slot, chances[1]);
            let frame = place.frame * rot_z(spin.to_radians()) * rot_x(down.to_radians());
            let longest = above.length[0] + above.length[1] * chances[2];
            let (length, relative) = self.child_length(bud, longest, z, bare);
            let length = (length * present).max(1e-4);
            let radius = self.child_radius(bud, length, radius_at(self.form, level, bud, z));
            if bud.level == 0 {
                self.scar(&place, frame * Vec3::Z, radius_at(self.form, level, bud, z));
            }
            buds.push(Bud {
                id: axis_id(bud.id, "branch", slot),
                level: bud.level + 1,
                parent: Some((place.axis, place.at)),
                position: place.position,
                frame,
                length,
                radius,
                offset: z,
                relative,
                presence: present * bud.presence,
            });
        }
    }

    /// Length of a child at the fraction `z`, m, and relative to the longest of its level.
    fn child_length(&self, bud: &Bud, longest: f32, z: f32, bare: f32) -> (f32, f32) {
        if bud.level > 0 {
            let relative = 1.0 - 0.6 * z;
            return (longest * bud.length * relative, relative);
        }
        let relative = formula::shape_ratio(self.form.shape, (1.0 - z) / (1.0 - bare));
        // Where the envelope comes to a point a stub remains: a stem needs a length.
        let relative = relative.max(0.02);
        (bud.length * longest * relative * self.fit, relative)
    }

    fn child_radius(&self, bud: &Bud, length: f32, at_parent: f32) -> f32 {
        // The published relation, without the crown's fit: a tree squeezed by its neighbours has
        // thinner branches only as they are shorter.
        let radius = bud.radius * libm::powf((length / bud.length).min(1.0), self.form.ratio_power);
        radius.max(TWIG_RADIUS).min(at_parent).max(1e-5)
    }

    /// A place on a stem; where the stem has clones, the slot's number says on which.
    fn place(&self, stem: &Stem, level: &Level, slot: u32, z: f32) -> Place {
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

    /// Scars the bare part of a trunk where branches have been shed.
    fn shed(&mut self, stem: &Stem, level: &Level) {
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
    fn scar(&mut self, place: &Place, towards: Vec3, trunk_radius: f32) {
        // Thinner stems still have smooth bark.
        if trunk_radius < 0.012 {
            return;
        }
        let Some(prototype) = self.scar else { return };
        let up = place.frame * Vec3::Z;
        let Some(out) = (towards - up * towards.dot(up)).try_normalize() else { return };
        let frame = Quat::from_mat3(&glam::Mat3::from_cols(up.cross(out), up, out));
        self.skeleton.organs.push(PlacedOrgan {
            prototype,
            axis: place.axis,
            position: place.position - up * (0.3 * trunk_radius),
            rotation: frame,
            scale: Vec3::splat(trunk_radius),
        });
    }

    fn leaves(&mut self, stem: &Stem) {
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
            let mut chance = || stream.around(0.0, 1.0) as f32;
            let chances = [chance(), chance(), chance(), chance()];
            let present = presence(slot, count, self.filled);
            if present == 0.0 {
                continue;
            }
            let part = (slot + 1) as f32 / count as f32;
            let is_fan = leaf.count < 0;
            let z = if is_fan { 1.0 } else { level.bare + (1.0 - level.bare) * part };
            let place = self.place(stem, level, slot, z);
            let (spin, down) = if is_fan {
                (phase + 90.0, leaf.rotate_deg[0] * (part - 0.5))
            } else {
                let spin = phase + formula::rotation(leaf.rotate_deg, slot, chances[0]);
                (spin, formula::down_angle(leaf.down_angle_deg, 1.0 - z, chances[1]))
            };
            let (heading, upper) = leaf_directions(spin.to_radians(), down.to_radians());
            let (heading, upper) = (place.frame * heading, place.frame * upper);
            let length = size * present * (1.0 + leaf.scale_v * chances[2]);
            let position = place.position + heading * (leaf.stalk * length);
            let hue = ((0.5 + 0.5 * chances[3]) * leaf.hues as f32) as u32;
            self.skeleton.organs.push(PlacedOrgan {
                prototype: hue.min(leaf.hues - 1),
                axis: place.axis,
                position,
                rotation: self.pose(heading, upper, position),
                scale: Vec3::new(length * leaf.scale_x, length, length),
            });
        }
    }

    /// Lets a leaf hang and turn its face to the light, which comes from above and outside.
    fn pose(&self, heading: Vec3, upper: Vec3, position: Vec3) -> Quat {
        let leaf = &self.form.leaf;
        let hanging = heading + (-Vec3::Z - heading) * leaf.droop;
        let heading = hanging.try_normalize().unwrap_or(heading);
        // The face turns about the leaf's own length, as a blade does on its stalk.
        let across = |v: Vec3| v - heading * v.dot(heading);
        let light = across(Vec3::Z + 0.5 * position.with_z(0.0).normalize_or_zero());
        let upper = across(upper);
        let turned =
            upper.normalize_or_zero() * (1.0 - leaf.bend) + light.normalize_or_zero() * leaf.bend;
        let upper = turned.try_normalize().unwrap_or_else(|| any_normal(heading));
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

/// A place on an axis.
struct Place {
    axis: u32,
    at: f32,
    position: Vec3,
    frame: Quat,
}
