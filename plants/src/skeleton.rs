//! The skeleton: what every generator makes and meshing takes.
//!
//! An axis is one botanical axis: trunk, branch, twig, stem, or the midline of a grass blade. It
//! is a run of nodes with radii. Organs (leaves, flowers) are prototypes placed on axes.

use glam::{Quat, Vec3};
use std::ops::Range;
use weald_contract::{Material, Mesh, Seed};

/// Axes, nodes and organs of one plant, in metres, Z up, the foot at the origin.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Skeleton {
    /// Axes; a parent stands before its children.
    pub axes: Vec<Axis>,
    /// Nodes; those of an axis are consecutive.
    pub nodes: Vec<Node>,
    /// Organs, each on an axis.
    pub organs: Vec<PlacedOrgan>,
    /// What the organs look like.
    pub prototypes: Vec<Prototype>,
    /// Materials of axes and prototypes.
    pub materials: Vec<Material>,
}

/// How an axis is swept into triangles.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AxisKind {
    /// A generalized cylinder.
    Stem,
    /// A two-sided ribbon, twice its nodes' radii wide.
    Blade,
}

/// One botanical axis.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Hash of the axis' path from the root; siblings that come and go do not change it.
    pub id: u64,
    /// Index of the axis it grows from.
    pub parent: Option<u32>,
    /// Where it grows from its parent: fraction of the parent's length from its first node.
    pub at: f32,
    /// 0 for what grows from the ground, one more than the parent otherwise; a continuation
    /// after a fork keeps its parent's order.
    pub order: u8,
    /// How it is swept.
    pub kind: AxisKind,
    /// Its nodes, at least two.
    pub nodes: Range<u32>,
    /// Direction, not along the axis, that says where a cross section begins and a blade's upper
    /// side lies at the first node.
    pub normal: Vec3,
    /// Number and relative depth of the lobes of the cross section; 0 lobes means round.
    pub lobes: (u32, f32),
    /// Index into [`Skeleton::materials`].
    pub material: u32,
}

/// Id of an axis from that of its parent, what it is, and its slot among those of its kind.
///
/// Axes from the ground have the parent 0.
pub fn axis_id(parent: u64, kind: &str, slot: u32) -> u64 {
    // A named stream mixes the three without symmetries: a plain exclusive or would give child
    // 2 of child 1 the id of child 1 of child 2.
    Seed(parent).stream(kind, u64::from(slot)).next_u64()
}

/// A point of an axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Node {
    /// Position, m.
    pub position: Vec3,
    /// Radius, or half a blade's width, m.
    pub radius: f32,
}

/// The shape of an organ.
#[derive(Clone, Debug, PartialEq)]
pub struct Prototype {
    /// Name, for instance `leaf`.
    pub name: String,
    /// Meshes in the organ's own space: attached at the origin, growing along +Y, upper side +Z.
    pub meshes: Vec<Mesh>,
}

/// An organ at its place.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PlacedOrgan {
    /// Index into [`Skeleton::prototypes`].
    pub prototype: u32,
    /// Index of the axis that bears it.
    pub axis: u32,
    /// Where it sits, m.
    pub position: Vec3,
    /// World from organ.
    pub rotation: Quat,
    /// Scale along the organ's own axes.
    pub scale: Vec3,
}

impl Axis {
    /// An axis from the ground with a round section; the nodes are filled in by
    /// [`Skeleton::push`].
    pub fn new(id: u64, kind: AxisKind, material: u32) -> Self {
        let nodes = 0..0;
        let (parent, at, order, lobes) = (None, 0.0, 0, (0, 0.0));
        Self { id, parent, at, order, kind, nodes, normal: Vec3::X, lobes, material }
    }

    /// The same axis on a parent.
    pub fn on(self, parent: u32, at: f32, order: u8) -> Self {
        Self { parent: Some(parent), at, order, ..self }
    }

    /// The same axis with its cross section starting towards `normal`.
    pub fn facing(self, normal: Vec3) -> Self {
        Self { normal, ..self }
    }
}

impl Skeleton {
    /// Appends an axis with its nodes and returns its index.
    pub fn push(&mut self, axis: Axis, nodes: impl IntoIterator<Item = Node>) -> u32 {
        let start = self.nodes.len() as u32;
        self.nodes.extend(nodes);
        self.axes.push(Axis { nodes: start..self.nodes.len() as u32, ..axis });
        (self.axes.len() - 1) as u32
    }

    /// Appends a material and returns its index.
    pub fn add_material(&mut self, material: Material) -> u32 {
        self.materials.push(material);
        (self.materials.len() - 1) as u32
    }

    /// Appends a prototype and returns its index.
    pub fn add_prototype(&mut self, name: &str, meshes: Vec<Mesh>) -> u32 {
        self.prototypes.push(Prototype { name: name.into(), meshes });
        (self.prototypes.len() - 1) as u32
    }

    /// The nodes of an axis.
    pub fn nodes_of(&self, axis: &Axis) -> &[Node] {
        &self.nodes[axis.nodes.start as usize..axis.nodes.end as usize]
    }

    /// Highest node or organ place, m.
    pub fn height(&self) -> f32 {
        let nodes = self.nodes.iter().map(|node| node.position.z);
        nodes.chain(self.organs.iter().map(|organ| organ.position.z)).fold(0.0, f32::max)
    }

    /// Greatest distance of a node or organ place from the vertical through the foot, m.
    pub fn reach(&self) -> f32 {
        let nodes = self.nodes.iter().map(|node| node.position);
        let points = nodes.chain(self.organs.iter().map(|organ| organ.position));
        points.map(|p| p.truncate().length_squared()).fold(0.0, f32::max).sqrt()
    }

    /// The factor by which the skeleton must be stretched to stand `height` high.
    ///
    /// Parameters that lay a plant on the ground would need an infinite one; it then stays
    /// lower than asked for.
    pub fn stretch_to(&self, height: f32) -> f32 {
        let grown = self.height();
        if grown > 0.02 * height { height / grown } else { 1.0 }
    }

    /// Stretches all places by `across` in x and y and `up` in z, and radii by `thickness`.
    ///
    /// Organs keep their own size and direction.
    pub fn stretch(&mut self, across: f32, up: f32, thickness: f32) {
        let scale = Vec3::new(across, across, up);
        for node in &mut self.nodes {
            node.position *= scale;
            node.radius *= thickness;
        }
        for organ in &mut self.organs {
            organ.position *= scale;
        }
    }

    /// Tells the first way in which the skeleton breaks the contract of its types, if it does.
    ///
    /// Every generator keeps it: indices in range, parents first, at least two nodes an axis, a
    /// child beginning on its parent, positive radii, finite numbers, unit rotations.
    pub fn check(&self) -> Result<(), String> {
        for (index, axis) in self.axes.iter().enumerate() {
            self.check_axis(index, axis).map_err(|what| format!("axis {index} {what}"))?;
        }
        for (index, organ) in self.organs.iter().enumerate() {
            self.check_organ(organ).map_err(|what| format!("organ {index} {what}"))?;
        }
        Ok(())
    }

    fn check_axis(&self, index: usize, axis: &Axis) -> Result<(), String> {
        let nodes = self.nodes.get(axis.nodes.start as usize..axis.nodes.end as usize);
        let nodes = nodes.filter(|nodes| nodes.len() >= 2).ok_or("has fewer than two nodes")?;
        if nodes.iter().any(|node| !node.position.is_finite() || !node.radius.is_finite()) {
            return Err("is not finite".into());
        }
        // The last node is the tip, where the radius may vanish.
        if nodes[..nodes.len() - 1].iter().any(|node| node.radius <= 0.0) {
            return Err("has a radius of 0 before its tip".into());
        }
        if axis.material as usize >= self.materials.len() {
            return Err("has no material".into());
        }
        let Some(parent) = axis.parent else { return Ok(()) };
        let parent = self.axes.get(parent as usize).filter(|_| (parent as usize) < index);
        let parent = self.nodes_of(parent.ok_or("stands before its parent")?);
        let gap = distance_to_line(nodes[0].position, parent);
        let length: f32 = parent.windows(2).map(|p| p[0].position.distance(p[1].position)).sum();
        // Places are rounded to about a ten-millionth of their distance from the foot.
        let allowed = 1e-3 * length + 1e-6 * nodes[0].position.length();
        if gap > allowed {
            return Err(format!("begins {gap} m off its parent; {allowed} m are allowed"));
        }
        Ok(())
    }

    fn check_organ(&self, organ: &PlacedOrgan) -> Result<(), String> {
        if organ.prototype as usize >= self.prototypes.len() {
            return Err("has no prototype".into());
        }
        if organ.axis as usize >= self.axes.len() {
            return Err("has no axis".into());
        }
        let finite = organ.position.is_finite() && organ.scale.is_finite();
        if !finite || (organ.rotation.length_squared() - 1.0).abs() > 1e-3 {
            return Err("is not placed by a rotation and finite numbers".into());
        }
        Ok(())
    }
}

/// Distance of a point from a polygon of nodes.
fn distance_to_line(point: Vec3, nodes: &[Node]) -> f32 {
    let to_segment = |pair: &[Node]| {
        let (a, b) = (pair[0].position, pair[1].position);
        let along = (point - a).dot(b - a) / (b - a).length_squared().max(f32::MIN_POSITIVE);
        point.distance(a + (b - a) * along.clamp(0.0, 1.0))
    };
    nodes.windows(2).map(to_segment).fold(f32::INFINITY, f32::min)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::opaque;

    fn node(x: f32, z: f32) -> Node {
        Node { position: Vec3::new(x, 0.0, z), radius: 0.01 }
    }

    fn stem() -> Skeleton {
        let mut skeleton = Skeleton::default();
        let bark = skeleton.add_material(opaque("bark", [0.2; 3]));
        skeleton.push(Axis::new(1, AxisKind::Stem, bark), [node(0.0, 0.0), node(0.0, 1.0)]);
        skeleton
    }

    #[test]
    fn a_branch_that_floats_beside_its_parent_breaks_the_contract() {
        let mut good = stem();
        good.push(Axis::new(2, AxisKind::Stem, 0).on(0, 0.5, 1), [node(0.0, 0.5), node(1.0, 1.0)]);
        assert_eq!(good.check(), Ok(()));
        let mut bad = stem();
        bad.push(Axis::new(2, AxisKind::Stem, 0).on(0, 0.5, 1), [node(0.1, 0.5), node(1.0, 1.0)]);
        assert!(bad.check().unwrap_err().contains("off its parent"));
    }

    #[test]
    fn a_child_before_its_parent_breaks_the_contract() {
        let mut skeleton = stem();
        skeleton.axes[0].parent = Some(0);
        assert!(skeleton.check().unwrap_err().contains("before its parent"));
    }

    #[test]
    fn a_plant_that_lies_on_the_ground_is_not_stretched_to_the_sky() {
        assert_eq!(stem().stretch_to(3.0), 3.0);
        assert_eq!(Skeleton::default().stretch_to(3.0), 1.0);
    }

    #[test]
    fn stretching_moves_places_but_not_organ_sizes() {
        let mut skeleton = stem();
        let leaf = skeleton.add_prototype("leaf", Vec::new());
        skeleton.organs.push(PlacedOrgan {
            prototype: leaf,
            axis: 0,
            position: Vec3::new(1.0, 0.0, 1.0),
            rotation: Quat::IDENTITY,
            scale: Vec3::ONE,
        });
        skeleton.stretch(2.0, 3.0, 1.0);
        assert_eq!((skeleton.reach(), skeleton.height()), (2.0, 3.0));
        assert_eq!(skeleton.organs[0].scale, Vec3::ONE);
    }
}
