//! Entities: branches that hold their parameters and their geometry.
//!
//! Branches are shared by reference count and copied when written, so that keeping an older
//! state of the tree for undo costs a pointer a branch.

use super::notation::Distribution;
use glam::{Quat, Vec3};
use std::collections::HashMap;
use std::sync::Arc;
use weald_contract::Seed;

/// The parameters of a branch, each an interpolated distribution; see [`NAMES`].
pub const PARAMETERS: usize = 13;
/// Names of parameters as scripts write them.
pub const NAMES: [&str; PARAMETERS] = [
    "length",
    "points",
    "gnarl",
    "gravitropism",
    "radius",
    "minradius",
    "angle",
    "rotate",
    "leaves",
    "leaf_anchor",
    "leaf_size",
    "leaf_angle",
    "leaf_rotate",
];
/// Least and greatest allowed value of each parameter.
pub const RANGES: [[f32; 2]; PARAMETERS] = [
    [1e-3, 200.0],
    [2.0, 64.0],
    [0.0, 180.0],
    [-360.0, 360.0],
    [1e-5, 10.0],
    [1e-5, 10.0],
    [-180.0, 180.0],
    [-360.0, 360.0],
    [0.0, 1000.0],
    [0.0, 1.0],
    [1e-3, 10.0],
    [-180.0, 180.0],
    [-360.0, 360.0],
];
const DEFAULTS: [f32; PARAMETERS] =
    [1.0, 5.0, 0.0, 0.0, 0.01, 0.002, 45.0, 137.5, 0.0, 0.5, 0.1, 45.0, 137.5];
/// Index of the length.
pub const LENGTH: usize = 0;
/// Index of the number of control points.
pub const POINTS: usize = 1;
const GNARL: usize = 2;
const GRAVITROPISM: usize = 3;
/// Index of the radius at the start.
pub const RADIUS: usize = 4;
/// Index of the radius at the end.
pub const MIN_RADIUS: usize = 5;
const ANGLE: usize = 6;
/// Index of the angle between siblings.
pub const ROTATE: usize = 7;
/// Index of the number of leaves.
pub const LEAVES: usize = 8;
const LEAF_ANCHOR: usize = 9;
/// Index of their length.
pub const LEAF_SIZE: usize = 10;
const LEAF_ANGLE: usize = 11;
const LEAF_ROTATE: usize = 12;
/// Bit of an anchor that was edited.
pub const ANCHOR_EDITED: u32 = 1 << 30;
/// Bit of an angle about the parent that was drawn.
const ROLL_EDITED: u32 = 1 << 28;
/// Bit of calculated radii.
const RADII_EDITED: u32 = 1 << 29;
/// Most branches of a tree: some 300 MB.
pub const MOST_BRANCHES: usize = 1_000_000;

/// Parameters; branches with equal ones share them.
#[derive(Clone, Debug, PartialEq)]
pub struct Style {
    /// One for each of [`NAMES`].
    pub values: [Distribution; PARAMETERS],
    /// Child parameter sets.
    pub sets: Vec<ChildSet>,
}

/// One child parameter set (CPS).
#[derive(Clone, Debug, PartialEq)]
pub struct ChildSet {
    /// Name.
    pub name: Arc<str>,
    /// Number of branches, along the bearer's own parent.
    pub count: Distribution,
    /// Anchor values.
    pub anchor: Distribution,
    /// What a child is born with if there is no sibling to copy.
    pub child: Arc<Style>,
}

impl Default for Style {
    fn default() -> Self {
        Self { values: DEFAULTS.map(Distribution::constant), sets: Vec::new() }
    }
}

/// A branch, twig, root or the trunk.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// What it grows from.
    pub parent: Option<u32>,
    /// 0 for the trunk.
    pub level: u8,
    /// The set of the parent that it belongs to.
    pub set: u8,
    /// Tag.
    pub tag: Option<Arc<str>>,
    /// Where it grows from: control points of the parent, 0 the first, 1 the last.
    pub anchor: f32,
    /// Angle about the parent, summed over siblings, degrees.
    pub roll: f32,
    /// Chance, given at birth.
    pub seed: u64,
    /// A bit for each parameter edited individually.
    pub edited: u32,
    /// Parameters.
    pub style: Arc<Style>,
    /// Control points relative to the first, in the frame of attachment, once edited.
    pub shape: Option<Arc<[Vec3]>>,
    /// Control points, m.
    pub points: Box<[Vec3]>,
    /// Radii at the control points, m.
    pub radii: Box<[f32]>,
    /// Children by set, then anchor.
    pub children: Vec<u32>,
}

impl Branch {
    /// Uniform in [-1, 1), belonging to a purpose.
    fn chance(&self, purpose: &str, index: usize) -> f32 {
        Seed(self.seed).stream(purpose, index as u64).range(-1.0, 1.0) as f32
    }

    /// A parameter's value.
    pub fn value(&self, parameter: usize) -> f32 {
        let t = if self.parent.is_some() { self.anchor.clamp(0.0, 1.0) } else { 0.5 };
        let value = self.style.values[parameter].at(t, self.chance(NAMES[parameter], 0));
        value.clamp(RANGES[parameter][0], RANGES[parameter][1])
    }

    /// Angle against the parent, degrees; a trunk has none to lean from.
    fn lean(&self) -> f32 {
        if self.parent.is_some() { self.value(ANGLE) } else { 0.0 }
    }

    /// Number of leaves.
    pub fn leaf_count(&self) -> usize {
        self.value(LEAVES).round() as usize
    }

    /// Leaves: place, heading, upper side, size.
    pub fn leaves(&self) -> impl Iterator<Item = Leaf> + '_ {
        let count = self.leaf_count();
        let value = |parameter: usize, index: usize, t: f32| {
            let drawn = self.style.values[parameter].at(t, self.chance(NAMES[parameter], index));
            drawn.clamp(RANGES[parameter][0], RANGES[parameter][1])
        };
        let mut roll = 180.0 * self.chance("first leaf", 0);
        (0..count).map(move |i| {
            let t = if count > 1 { i as f32 / (count - 1) as f32 } else { 0.5 };
            let anchor = value(LEAF_ANCHOR, i, t);
            roll += value(LEAF_ROTATE, i, anchor);
            let (place, tangent) = point_at(&self.points, anchor);
            let frame = attached(tangent, roll, value(LEAF_ANGLE, i, anchor));
            Leaf { place, frame, size: value(LEAF_SIZE, i, anchor) }
        })
    }
}

/// A leaf at its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Leaf {
    /// Its foot, m.
    pub place: Vec3,
    /// Its Z is the direction of growth.
    pub frame: Quat,
    /// Length, m.
    pub size: f32,
}

/// The point of a polygon at an anchor value and the direction of its segment [Ganster07] §4.3.
pub fn point_at(points: &[Vec3], anchor: f32) -> (Vec3, Vec3) {
    let last = points.len() - 1;
    let j = anchor.clamp(0.0, 1.0) * last as f32;
    let k = (j as usize).min(last - 1);
    let segment = points[k + 1] - points[k];
    let place = if anchor >= 1.0 { points[last] } else { points[k] + (j - k as f32) * segment };
    (place, segment.normalize_or(Vec3::Z))
}

/// World from the frame of a child: its Z is the heading.
///
/// The normal about which siblings turn follows from the tangent alone, so that a child far from
/// an edited segment is moved and not turned.
fn attached(tangent: Vec3, roll_deg: f32, angle_deg: f32) -> Quat {
    Quat::from_rotation_arc(Vec3::Z, tangent)
        * Quat::from_rotation_z(roll_deg.to_radians())
        * Quat::from_rotation_x(angle_deg.to_radians())
}

/// A tree of entities; a branch's id is its index and is never used again.
#[derive(Clone, Debug, PartialEq)]
pub struct Tree {
    /// Branches; `None` where one was removed.
    pub branches: Vec<Option<Arc<Branch>>>,
    /// The trunk.
    pub root: Option<u32>,
    /// Chance of all births.
    pub seed: u64,
    /// Where the trunk begins; imported ones may begin below the ground.
    pub foot: Vec3,
    /// Branches rebuilt since the tree began.
    pub rebuilt: u64,
}

impl Tree {
    /// A trunk.
    pub fn new(seed: u64) -> Self {
        let mut tree =
            Self { branches: Vec::new(), root: None, seed, foot: Vec3::ZERO, rebuilt: 0 };
        tree.root = Some(tree.born(None, 0, 0.0, Arc::default()));
        tree.rebuild(0);
        tree
    }

    /// The branch of an id that lives.
    pub fn get(&self, id: u32) -> &Branch {
        self.branches[id as usize].as_ref().expect("ids in lists are alive")
    }

    /// The branch, to be written.
    pub fn get_mut(&mut self, id: u32) -> &mut Branch {
        Arc::make_mut(self.branches[id as usize].as_mut().expect("ids in lists are alive"))
    }

    /// A branch and all that it bears, parents first.
    pub fn subtree(&self, id: u32) -> Vec<u32> {
        let mut found = vec![id];
        let mut next = 0;
        while next < found.len() {
            found.extend(&self.get(found[next]).children);
            next += 1;
        }
        found
    }

    /// Living branches, parents first.
    pub fn all(&self) -> Vec<u32> {
        self.root.map_or_else(Vec::new, |root| self.subtree(root))
    }

    fn born(&mut self, parent: Option<u32>, set: u8, anchor: f32, style: Arc<Style>) -> u32 {
        let id = self.branches.len() as u32;
        let level = parent.map_or(0, |parent| self.get(parent).level + 1);
        let branch = Branch {
            parent,
            level,
            set,
            tag: None,
            anchor,
            roll: 0.0,
            edited: 0,
            style,
            seed: Seed(self.seed).stream("branch", u64::from(id)).next_u64(),
            shape: None,
            points: Box::default(),
            radii: Box::default(),
            children: Vec::new(),
        };
        self.branches.push(Some(Arc::new(branch)));
        id
    }

    /// Puts a branch with a shape of its own on a parent; the shape's points are in the world.
    pub fn graft(&mut self, parent: Option<u32>, anchor: f32, points: &[Vec3]) -> u32 {
        let id = self.graft_last(parent, anchor, points);
        if let Some(parent) = parent {
            self.finish_grafts(parent);
        }
        id
    }

    /// Brings a branch's children in order, and its counts up to date.
    pub(super) fn finish_grafts(&mut self, id: u32) {
        if !self.get(id).children.is_empty() {
            self.sort_children(id);
            self.recount(id);
        }
    }

    /// Makes radii a branch's own.
    pub(super) fn keep_radii(&mut self, id: u32, radii: Box<[f32]>) {
        let branch = self.get_mut(id);
        let style = Arc::make_mut(&mut branch.style);
        style.values[RADIUS] = Distribution::constant(radii[0]);
        style.values[MIN_RADIUS] = Distribution::constant(radii[radii.len() - 1]);
        branch.radii = radii;
        branch.edited |= RADII_EDITED | 1 << RADIUS | 1 << MIN_RADIUS;
    }

    /// Lets radii follow the parameters again.
    pub(super) fn free_radii(&mut self, id: u32) {
        if self.get(id).edited & RADII_EDITED != 0 {
            self.get_mut(id).edited &= !RADII_EDITED;
        }
    }

    /// As [`Tree::graft`], but leaves the parent's children unsorted and uncounted.
    pub(super) fn graft_last(&mut self, parent: Option<u32>, anchor: f32, points: &[Vec3]) -> u32 {
        let style = match parent {
            Some(parent) => {
                let bearer = self.get_mut(parent);
                let style = Arc::make_mut(&mut bearer.style);
                if style.sets.is_empty() {
                    let one = Distribution::constant(0.0);
                    let child = Arc::default();
                    style.sets.push(ChildSet {
                        name: "sketched".into(),
                        count: one,
                        anchor: one,
                        child,
                    });
                }
                Arc::clone(&style.sets[0].child)
            }
            None => Arc::default(),
        };
        let id = self.born(parent, 0, anchor, style);
        match parent {
            Some(parent) => {
                self.get_mut(parent).children.push(id);
            }
            None => self.root = Some(id),
        }
        let (_, tangent) = parent
            .map_or((Vec3::ZERO, Vec3::Z), |parent| point_at(&self.get(parent).points, anchor));
        // The roll that has the heading in the plane of tangent and first segment.
        let heading = Quat::from_rotation_arc(Vec3::Z, tangent).inverse() * (points[1] - points[0]);
        let branch = self.get_mut(id);
        branch.roll = heading.x.atan2(-heading.y).to_degrees();
        branch.edited |= ANCHOR_EDITED | ROLL_EDITED | 1 << GNARL | 1 << POINTS;
        let style = Arc::make_mut(&mut branch.style);
        style.values[GNARL] = Distribution::constant(0.0);
        style.values[POINTS] = Distribution::constant(points.len() as f32);
        self.reshape(id, points);
        id
    }

    /// Takes control points in the world as a branch's own, and deduces length and angle.
    pub fn reshape(&mut self, id: u32, points: &[Vec3]) {
        let tangent = self.foot(id).1;
        let branch = self.get_mut(id);
        let first = (points[1] - points[0]).normalize_or(tangent);
        let length: f32 = points.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
        let set = |branch: &mut Branch, parameter: usize, value: f32| {
            Arc::make_mut(&mut branch.style).values[parameter] = Distribution::constant(value);
            branch.edited |= 1 << parameter;
        };
        set(branch, LENGTH, length);
        set(branch, ANGLE, first.angle_between(tangent).to_degrees());
        let frame = attached(tangent, branch.roll, branch.lean()).inverse();
        branch.shape = Some(points.iter().map(|&point| frame * (point - points[0])).collect());
    }

    /// Where a branch begins, and the direction of its parent there.
    fn foot(&self, id: u32) -> (Vec3, Vec3) {
        let branch = self.get(id);
        branch.parent.map_or((self.foot, Vec3::Z), |parent| {
            point_at(&self.get(parent).points, branch.anchor)
        })
    }

    fn sort_children(&mut self, id: u32) {
        let mut children = std::mem::take(&mut self.get_mut(id).children);
        let key = |&child: &u32| (self.get(child).set, self.get(child).anchor, child);
        children.sort_by(|a, b| {
            let (a, b) = (key(a), key(b));
            a.0.cmp(&b.0).then(a.1.total_cmp(&b.1)).then(a.2.cmp(&b.2))
        });
        self.get_mut(id).children = children;
    }

    /// Writes down how many children each set has after branches were added or removed by hand.
    pub fn recount(&mut self, id: u32) {
        let counts: Vec<usize> = (0..self.get(id).style.sets.len())
            .map(|set| self.in_set(id, set as u8).len())
            .collect();
        let style = Arc::make_mut(&mut self.get_mut(id).style);
        for (set, count) in style.sets.iter_mut().zip(counts) {
            set.count = Distribution::constant(count as f32);
        }
    }

    fn in_set(&self, id: u32, set: u8) -> Vec<u32> {
        let children = self.get(id).children.iter().copied();
        children.filter(|&child| self.get(child).set == set).collect()
    }

    /// Removes a branch with all that it bears.
    pub fn remove(&mut self, id: u32) {
        match self.get(id).parent {
            Some(parent) => self.get_mut(parent).children.retain(|&child| child != id),
            None => self.root = None,
        }
        for dead in self.subtree(id) {
            self.branches[dead as usize] = None;
        }
    }

    /// Makes the numbers of children what the sets say, moving those that exist.
    ///
    /// # Errors
    /// If the tree would have more than [`MOST_BRANCHES`].
    pub fn populate(&mut self, id: u32) -> Result<(), String> {
        for set in 0..self.get(id).style.sets.len() {
            self.populate_set(id, set)?;
        }
        self.sort_children(id);
        self.turn_children(id);
        for child in self.get(id).children.clone() {
            self.populate(child)?;
        }
        Ok(())
    }

    fn populate_set(&mut self, id: u32, set: usize) -> Result<(), String> {
        let branch = self.get(id);
        let rules = branch.style.sets[set].clone();
        let t = if branch.parent.is_some() { branch.anchor } else { 0.5 };
        let count = rules.count.at(t, branch.chance("count", set)).round().max(0.0) as usize;
        if self.branches.len() + count > MOST_BRANCHES {
            return Err(format!("the tree would have more than {MOST_BRANCHES} branches"));
        }
        let mut anchors: Vec<f32> = (0..count)
            .map(|i| {
                let t = if count > 1 { i as f32 / (count - 1) as f32 } else { 0.5 };
                rules.anchor.at(t, branch.chance("anchor", (set << 16) + i)).clamp(0.0, 1.0)
            })
            .collect();
        anchors.sort_by(f32::total_cmp);
        let children = self.in_set(id, set as u8);
        let own: Vec<(f32, bool)> = children
            .iter()
            .map(|&child| {
                (
                    self.get(child).anchor,
                    self.get(child).edited != 0 || self.get(child).tag.is_some(),
                )
            })
            .collect();
        let assigned = assign(&own, &anchors);
        let mut kept: Vec<Option<u32>> = vec![None; count];
        for (&child, place) in children.iter().zip(assigned) {
            let Some(place) = place else {
                self.remove(child);
                continue;
            };
            kept[place] = Some(child);
            if self.get(child).edited & ANCHOR_EDITED == 0
                && self.get(child).anchor != anchors[place]
            {
                self.get_mut(child).anchor = anchors[place];
            }
        }
        for place in 0..count {
            if kept[place].is_some() {
                continue;
            }
            let nearest = (0..count)
                .filter_map(|other| kept[other].map(|child| (other.abs_diff(place), child)))
                .min()
                .map(|(_, child)| self.get(child));
            // Texts are copied, individual marks are not: an edited sibling gives its set's.
            let style = match nearest {
                Some(sibling) if sibling.edited == 0 => Arc::clone(&sibling.style),
                _ => Arc::clone(&rules.child),
            };
            let born = self.born(Some(id), set as u8, anchors[place], style);
            self.get_mut(id).children.push(born);
        }
        Ok(())
    }

    /// Builds the geometry of a branch and of all that it bears from parameters.
    pub fn rebuild(&mut self, id: u32) {
        let (foot, tangent) = self.foot(id);
        let limit = self.get(id).parent.map_or(f32::MAX, |parent| {
            let parent = self.get(parent);
            0.95 * radius_at(&parent.radii, self.get(id).anchor)
        });
        let branch = self.get_mut(id);
        let frame = attached(tangent, branch.roll, branch.lean());
        branch.points = match &branch.shape {
            Some(shape) => {
                let own: f32 = shape.windows(2).map(|pair| pair[0].distance(pair[1])).sum();
                let scale = branch.value(LENGTH) / own.max(f32::MIN_POSITIVE);
                let scale = if (scale - 1.0).abs() < 1e-5 { 1.0 } else { scale };
                shape.iter().map(|&point| foot + frame * (scale * point)).collect()
            }
            None => grown(branch, foot, frame),
        };
        let count = branch.points.len();
        if branch.edited & RADII_EDITED == 0 || branch.radii.len() != count {
            let (first, last) = (branch.value(RADIUS).min(limit), branch.value(MIN_RADIUS));
            let along = |i: usize| i as f32 / (count - 1) as f32;
            branch.radii =
                (0..count).map(|i| first + (last.min(first) - first) * along(i)).collect();
        }
        self.rebuilt += 1;
        for child in self.get(id).children.clone() {
            self.rebuild(child);
        }
    }

    /// Sums up the angles between siblings; sketched ones stay where they were drawn.
    pub fn turn_children(&mut self, id: u32) {
        let mut roll = 0.0;
        for child in self.get(id).children.clone() {
            if self.get(child).edited & ROLL_EDITED == 0 {
                roll += self.get(child).value(ROTATE);
                self.get_mut(child).roll = roll;
            }
        }
    }

    /// Radii from the tips down: `r^law` below a branching is the sum of that above (da Vinci).
    pub fn calculate_radii(&mut self, id: u32, law: f32) {
        let mut order = self.subtree(id);
        order.reverse();
        let mut sums: HashMap<u32, f32> = HashMap::new();
        for id in order {
            let branch = self.get(id);
            let last = branch.points.len() - 1;
            let mut sum = branch.value(MIN_RADIUS).powf(law);
            let mut radii = vec![0.0; last + 1];
            let mut children = branch
                .children
                .iter()
                .map(|&c| (self.get(c).anchor * last as f32, sums[&c]))
                .collect::<Vec<_>>();
            children.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.total_cmp(&b.1)));
            for i in (0..=last).rev() {
                while let Some((_, child)) = children.pop_if(|(at, _)| *at >= i as f32) {
                    sum += child;
                }
                radii[i] = sum.powf(1.0 / law);
            }
            sums.insert(id, sum);
            self.keep_radii(id, radii.into());
        }
    }
}

/// Radius at an anchor value, m.
pub fn radius_at(radii: &[f32], anchor: f32) -> f32 {
    let j = anchor.clamp(0.0, 1.0) * (radii.len() - 1) as f32;
    let k = (j as usize).min(radii.len() - 2);
    radii[k] + (radii[k + 1] - radii[k]) * (j - k as f32)
}

/// Control points by length, gnarl and gravitropism.
fn grown(branch: &Branch, foot: Vec3, frame: Quat) -> Box<[Vec3]> {
    let count = branch.value(POINTS).round() as usize;
    let step = branch.value(LENGTH) / (count - 1) as f32;
    let gnarl = branch.value(GNARL).to_radians();
    let gravitropism = branch.value(GRAVITROPISM).to_radians() / (count - 1) as f32;
    let mut heading = frame * Vec3::Z;
    let mut points = vec![foot];
    for i in 1..count {
        let mut chance = Seed(branch.seed).stream("gnarl", i as u64);
        let (about, by) =
            (chance.unit() as f32 * std::f32::consts::TAU, chance.unit() as f32 * gnarl);
        let across = heading.any_orthonormal_vector();
        heading =
            Quat::from_axis_angle(Quat::from_axis_angle(heading, about) * across, by) * heading;
        // The axis is as long as the sine of the angle from the vertical.
        let axis = heading.cross(Vec3::Z);
        heading = (Quat::from_scaled_axis(axis * gravitropism) * heading).normalize();
        points.push(points[i - 1] + step * heading);
    }
    points.into()
}

/// Places for children (anchor, protected) in order, of least total change; `None` removes one.
fn assign(children: &[(f32, bool)], places: &[f32]) -> Vec<Option<usize>> {
    let (m, n) = (children.len(), places.len());
    // Protected children are given up last.
    let drop = |i: usize| if children[i].1 { 1e6 } else { 1e3 };
    let width = n + 1;
    let mut cost = vec![0.0f64; (m + 1) * width];
    for i in 1..=m {
        cost[i * width] = cost[(i - 1) * width] + drop(i - 1);
        for j in 1..=n {
            let here = cost[(i - 1) * width + j - 1]
                + f64::from((children[i - 1].0 - places[j - 1]).abs());
            let without = cost[(i - 1) * width + j] + drop(i - 1);
            cost[i * width + j] = here.min(without).min(cost[i * width + j - 1]);
        }
    }
    let mut found = vec![None; m];
    let (mut i, mut j) = (m, n);
    while i > 0 {
        if j > 0 && cost[i * width + j] == cost[i * width + j - 1] {
            j -= 1;
        } else if cost[i * width + j] == cost[(i - 1) * width + j] + drop(i - 1) {
            i -= 1;
        } else {
            (i, j) = (i - 1, j - 1);
            found[i] = Some(j);
        }
    }
    found
}
