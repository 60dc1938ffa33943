//! Twigs: the thinnest branches with all that grows on them, as parts that plants can share.
//!
//! Trees of one species bear thousands of twigs that look alike. A few of them, each kept once,
//! may stand for all [Deussen98, section "Approximate instancing"]: [`take_off`] parts a skeleton
//! from its twigs, [`traits`] says how they look as numbers, and [`replaced`] puts shared ones in
//! their places, turned and scaled as the twigs there were.

use crate::frame::{frame_of, organ_rotation};
use crate::mesh::{Meshing, SAG, append, coarsened, model_with};
use crate::skeleton::{Axis, AxisKind, Node, PlacedOrgan, Skeleton};
use glam::{Quat, Vec3};
use weald_contract::{Material, Mesh, PlantModel};

/// A twig of a skeleton, as it lies.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Twig {
    /// Its axis in the skeleton.
    pub axis: u32,
    /// The axis that bears it, in what is left of the skeleton.
    pub bearer: u32,
    /// Its foot, m.
    pub foot: Vec3,
    /// World from twig: along +Y, upper side +Z.
    pub rotation: Quat,
    /// From foot to tip, m.
    pub length: f32,
}

/// A skeleton without its twigs.
#[derive(Clone, Debug, Default)]
pub struct Pruned {
    /// What is left.
    pub rest: Skeleton,
    /// What was taken off.
    pub twigs: Vec<Twig>,
}

/// Takes the twigs off a skeleton: branches of the highest order that bear no branches and are
/// borne themselves.
pub fn take_off(skeleton: &Skeleton) -> Pruned {
    let is_twig = are_twigs(skeleton);
    let mut pruned = Pruned { rest: bare(skeleton), twigs: Vec::new() };
    let mut kept = vec![u32::MAX; skeleton.axes.len()];
    for (index, axis) in skeleton.axes.iter().enumerate() {
        let bearer = axis.parent.map(|parent| kept[parent as usize]);
        if is_twig[index] {
            pruned.twigs.push(Twig::of(skeleton, index, bearer.unwrap_or(0)));
            continue;
        }
        let axis = Axis { parent: bearer, ..axis.clone() };
        let nodes = skeleton.nodes_of(&skeleton.axes[index]);
        kept[index] = pruned.rest.push(axis, nodes.iter().copied());
    }
    let organs = skeleton.organs.iter().filter(|organ| !is_twig[organ.axis as usize]);
    pruned.rest.organs =
        organs.map(|organ| PlacedOrgan { axis: kept[organ.axis as usize], ..*organ }).collect();
    pruned
}

fn are_twigs(skeleton: &Skeleton) -> Vec<bool> {
    let highest = skeleton.axes.iter().map(|axis| axis.order).max().unwrap_or(0);
    let mut is_twig: Vec<bool> = skeleton
        .axes
        .iter()
        .map(|axis| axis.order == highest && axis.parent.is_some() && axis.kind == AxisKind::Stem)
        .collect();
    for axis in &skeleton.axes {
        if let Some(bears) = axis.parent.and_then(|parent| is_twig.get_mut(parent as usize)) {
            *bears = false;
        }
    }
    is_twig
}

/// A skeleton of the same materials and prototypes, without axes.
fn bare(skeleton: &Skeleton) -> Skeleton {
    Skeleton {
        materials: skeleton.materials.clone(),
        prototypes: skeleton.prototypes.clone(),
        ..Skeleton::default()
    }
}

impl Twig {
    fn of(skeleton: &Skeleton, axis: usize, bearer: u32) -> Self {
        let nodes = skeleton.nodes_of(&skeleton.axes[axis]);
        let (foot, tip) = (nodes[0].position, nodes[nodes.len() - 1].position);
        let heading = (tip - foot).normalize_or(Vec3::Z);
        let rotation = organ_rotation(frame_of(heading, Vec3::Z));
        let length = foot.distance(tip).max(1e-4);
        Self { axis: axis as u32, bearer, foot, rotation, length }
    }

    /// A point in the twig's own space, in metres.
    fn local(&self, point: Vec3) -> Vec3 {
        self.rotation.inverse() * (point - self.foot)
    }

    /// The twig with its organs as a skeleton of its own, `scale` times as large.
    pub fn alone(&self, skeleton: &Skeleton, scale: f32) -> Skeleton {
        let mut alone = bare(skeleton);
        let axis = &skeleton.axes[self.axis as usize];
        let nodes = skeleton.nodes_of(axis).iter().map(|node| Node {
            position: self.local(node.position) * scale,
            radius: node.radius * scale,
        });
        let normal = self.rotation.inverse() * axis.normal;
        alone.push(Axis { parent: None, order: 0, normal, ..axis.clone() }, nodes);
        for organ in skeleton.organs.iter().filter(|organ| organ.axis == self.axis) {
            alone.organs.push(PlacedOrgan {
                axis: 0,
                position: self.local(organ.position) * scale,
                rotation: (self.rotation.inverse() * organ.rotation).normalize(),
                scale: organ.scale * scale,
                ..*organ
            });
        }
        alone
    }
}

/// Numbers by which twigs are compared.
pub const TRAITS: usize = 7;

/// How a twig looks, and how much of its plant it is.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Traits {
    /// In a twig of length 1, scaled so that equal steps look about equally different (ours):
    /// number of organs and their size (logarithms), thickness (logarithm), how far it bends up
    /// and aside, its slope, and how green its leaves are.
    pub values: [f64; TRAITS],
    /// Area of its organs, length by width, m².
    pub organ_area: f64,
    /// Area of organs and wood, m²: what it counts beside others.
    pub weight: f64,
    /// From foot to tip, m.
    pub length: f64,
}

/// How the twigs that were taken off a skeleton look.
pub fn traits(skeleton: &Skeleton, twigs: &[Twig]) -> Vec<Traits> {
    let mut sums = vec![Borne::default(); skeleton.axes.len()];
    for organ in &skeleton.organs {
        let borne = &mut sums[organ.axis as usize];
        borne.count += 1.0;
        borne.size += f64::from(organ.scale.y.abs());
        borne.area += f64::from((organ.scale.x * organ.scale.y).abs());
        borne.green += green(skeleton, organ);
    }
    twigs.iter().map(|twig| of_twig(skeleton, twig, &sums[twig.axis as usize])).collect()
}

/// Sums over the organs that an axis bears.
#[derive(Clone, Copy, Default)]
struct Borne {
    count: f64,
    size: f64,
    area: f64,
    green: f64,
}

/// Green reflectance of an organ's first mesh.
fn green(skeleton: &Skeleton, organ: &PlacedOrgan) -> f64 {
    let mesh = skeleton.prototypes.get(organ.prototype as usize).and_then(|p| p.meshes.first());
    let material = mesh.and_then(|mesh| skeleton.materials.get(mesh.material as usize));
    material.map_or(0.0, |material| f64::from(material.reflectance[1]))
}

fn of_twig(skeleton: &Skeleton, twig: &Twig, borne: &Borne) -> Traits {
    let length = f64::from(twig.length);
    let nodes = skeleton.nodes_of(&skeleton.axes[twig.axis as usize]);
    let thickness = 2.0 * f64::from(nodes[0].radius);
    let bend = nodes.iter().fold(Vec3::ZERO, |sum, node| sum + twig.local(node.position));
    let bend = bend / (nodes.len() as f32 * twig.length);
    let mean = |sum: f64| if borne.count > 0.0 { sum / borne.count } else { 0.0 };
    let slope = (twig.rotation * Vec3::Y).z;
    let values = [
        libm::log(1.0 + borne.count),
        libm::log(1e-2 + mean(borne.size) / length),
        0.3 * libm::log(1e-3 + thickness / length),
        4.0 * f64::from(bend.z),
        4.0 * f64::from(bend.x),
        0.5 * f64::from(slope),
        4.0 * mean(borne.green),
    ];
    let weight = borne.area + thickness * length;
    Traits { values, organ_area: borne.area, weight, length }
}

/// A twig that others share.
#[derive(Clone, Debug, PartialEq)]
pub struct Shape {
    /// Its wood and organs, in its own space, m; materials are those below.
    pub meshes: Vec<Mesh>,
    /// Materials of the plant that it grew on.
    pub materials: Vec<Material>,
    /// From foot to tip, m.
    pub length: f32,
}

impl Shape {
    /// The twig of a skeleton, as finely meshed as it is on its plant, with organs so many times as
    /// large.
    pub fn of(skeleton: &Skeleton, twig: &Twig, organ_scale: f32) -> Self {
        let meshing = Meshing { sag: coarsened(SAG, skeleton.height()), ..Meshing::default() };
        let mut alone = twig.alone(skeleton, 1.0);
        alone.organs.iter_mut().for_each(|organ| organ.scale *= organ_scale);
        let model = model_with("twig", &alone, &meshing);
        Self { meshes: merged(&unfolded(&model)), materials: model.materials, length: twig.length }
    }

    /// Triangles of all meshes.
    pub fn triangles(&self) -> u64 {
        self.meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum()
    }
}

/// Names of shared twigs begin with this, where they stand among a plant's organs.
pub const PREFIX: &str = "twig-";

/// The skeleton with shared twigs in the place of its own, as organs named `twig-N`.
///
/// `labels` gives each twig of `pruned` its shape.
pub fn replaced(pruned: Pruned, shapes: &[Shape], labels: &[u32]) -> Skeleton {
    let Pruned { rest: mut skeleton, twigs } = pruned;
    let mut prototypes = vec![None; shapes.len()];
    for (twig, label) in twigs.iter().zip(labels) {
        let (shape, known) = (&shapes[*label as usize], &mut prototypes[*label as usize]);
        let prototype = *known
            .get_or_insert_with(|| add_shape(&mut skeleton, &format!("{PREFIX}{label}"), shape));
        skeleton.organs.push(PlacedOrgan {
            prototype,
            axis: twig.bearer,
            position: twig.foot,
            rotation: twig.rotation,
            scale: Vec3::splat(twig.length / shape.length),
        });
    }
    skeleton
}

/// Adds a shape with its materials, those that are there already not again.
fn add_shape(skeleton: &mut Skeleton, name: &str, shape: &Shape) -> u32 {
    let mut meshes = shape.meshes.clone();
    for mesh in &mut meshes {
        let material = &shape.materials[mesh.material as usize];
        let known = skeleton.materials.iter().position(|known| known == material);
        mesh.material = match known {
            Some(index) => index as u32,
            None => skeleton.add_material(material.clone()),
        };
    }
    skeleton.add_prototype(name, meshes)
}

/// All meshes of a model, organs at their places.
pub(crate) fn unfolded(model: &PlantModel) -> Vec<Mesh> {
    let mut meshes = model.wood.clone();
    for organ in &model.organs {
        for place in &organ.placements {
            let (rotation, scale) = (Quat::from_array(place.rotation), Vec3::from(place.scale));
            // Normals scale by the inverse.
            let shrink =
                Vec3::from_array(place.scale.map(|s| if s.abs() > 1e-12 { 1.0 / s } else { 0.0 }));
            for mesh in &organ.meshes {
                let mut mesh = mesh.clone();
                for position in &mut mesh.positions {
                    let placed = rotation * (scale * Vec3::from_array(*position));
                    *position = (placed + Vec3::from(place.position)).to_array();
                }
                for normal in &mut mesh.normals {
                    let turned = rotation * (shrink * Vec3::from_array(*normal));
                    *normal = turned.normalize_or(Vec3::Z).to_array();
                }
                meshes.push(mesh);
            }
        }
    }
    meshes
}

/// One mesh for each material, and for each set of columns, in the order in which they are met.
fn merged(meshes: &[Mesh]) -> Vec<Mesh> {
    let columns = |mesh: &Mesh| (mesh.material, mesh.normals.is_empty(), mesh.uvs.is_empty());
    let mut all: Vec<Mesh> = Vec::new();
    for mesh in meshes.iter().filter(|mesh| !mesh.triangles.is_empty()) {
        let index = all.iter().position(|other| columns(other) == columns(mesh));
        let index = index.unwrap_or_else(|| {
            all.push(Mesh { material: mesh.material, ..Mesh::default() });
            all.len() - 1
        });
        append(&mut all[index], mesh);
    }
    all
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::{LeafColor, opaque};
    use crate::organ::{LeafShape, leaf};

    /// A trunk with twigs of some lengths, a leaf of a tenth of the twig at the tip of each.
    fn tree(lengths: &[f32]) -> Skeleton {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let green = skeleton.add_material(LeafColor::default().material("leaf", 1.0, 0, 1));
        let leaf = skeleton.add_prototype("leaf", vec![leaf(LeafShape::Ovate, 0.0, 0.0, green)]);
        let node = |position, radius| Node { position, radius };
        let trunk = [node(Vec3::ZERO, 0.1), node(Vec3::Z * 4.0, 0.02)];
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), trunk);
        for (index, &length) in lengths.iter().enumerate() {
            let at = (index as f32 + 0.5) / lengths.len() as f32;
            let (sin, cos) = libm::sincosf(2.4 * index as f32);
            let heading = Vec3::new(cos, sin, 0.5).normalize();
            let (foot, tip) = (Vec3::Z * (4.0 * at), Vec3::Z * (4.0 * at) + heading * length);
            let axis = Axis::new(2 + index as u64, AxisKind::Stem, 0).on(0, at, 1);
            let axis = axis.facing(heading.any_orthonormal_vector());
            let axis = skeleton.push(axis, [node(foot, 0.01 * length), node(tip, 0.002 * length)]);
            let rotation = organ_rotation(frame_of(heading, Vec3::Z));
            let scale = Vec3::splat(0.1 * length);
            let position = tip;
            skeleton.organs.push(PlacedOrgan { prototype: leaf, axis, position, rotation, scale });
        }
        skeleton
    }

    #[test]
    fn a_tree_whose_twigs_differ_in_size_alone_is_the_same_with_one_of_them() {
        let skeleton = tree(&[0.3, 0.6, 0.45, 0.9]);
        let pruned = take_off(&skeleton);
        assert_eq!(
            (pruned.rest.axes.len(), pruned.rest.organs.len(), pruned.twigs.len()),
            (1, 0, 4)
        );
        let found = traits(&skeleton, &pruned.twigs);
        for other in &found {
            let apart = other.values.iter().zip(found[0].values).map(|(a, b)| (a - b).abs());
            assert!(apart.fold(0.0, f64::max) < 1e-5);
        }
        let shape = Shape::of(&skeleton, &pruned.twigs[2], 1.0);
        let shared = replaced(pruned, std::slice::from_ref(&shape), &[0; 4]);
        assert_eq!(shared.check(), Ok(()));
        let model = crate::mesh::model("tree", &shared);
        let organ = &model.organs[0];
        assert_eq!((organ.name.as_str(), organ.placements.len()), ("twig-0", 4));
        assert_eq!(shape.meshes.len(), 2, "one for bark, one for leaves");
        assert!(organ.meshes.iter().all(|mesh| mesh.is_sound(model.materials.len())));
        // Tips of leaves are where they were.
        let leaf = &skeleton.prototypes[0].meshes[0].positions;
        let leaves = organ.meshes.iter().find(|mesh| mesh.material == 1).expect("leaves");
        for (place, own) in organ.placements.iter().zip(&skeleton.organs) {
            for (corner, shared) in leaf.iter().zip(&leaves.positions) {
                let was = own.position + own.rotation * (own.scale * Vec3::from(*corner));
                let turned =
                    Quat::from_array(place.rotation) * (place.scale[0] * Vec3::from(*shared));
                let is = Vec3::from(place.position) + turned;
                assert!(was.distance(is) < 2e-3, "{was} {is}");
            }
        }
    }

    #[test]
    fn larger_organs_have_a_larger_area_and_the_wood_stays() {
        let skeleton = tree(&[0.5]);
        let twig = take_off(&skeleton).twigs[0];
        let area = |shape: &Shape, material: u32| {
            let meshes = shape.meshes.iter().filter(|mesh| mesh.material == material);
            meshes.map(|mesh| crate::mesh::organ_area(mesh, Vec3::ONE)).sum::<f32>()
        };
        let [plain, wide] = [1.0, 2.0].map(|scale| Shape::of(&skeleton, &twig, scale));
        assert!((area(&wide, 1) / area(&plain, 1) - 4.0).abs() < 1e-3);
        assert_eq!(area(&wide, 0), area(&plain, 0));
    }

    #[test]
    fn twigs_of_another_plant_bring_their_materials() {
        let (own, mut other) = (tree(&[0.3, 0.5]), tree(&[0.4]));
        other.materials[1] = LeafColor::default().material("leaf", 0.1, 0, 1);
        let shape = Shape::of(&other, &take_off(&other).twigs[0], 1.0);
        let shared = replaced(take_off(&own), &[shape], &[0, 0]);
        assert_eq!(shared.materials.len(), own.materials.len() + 1);
        let meshes = &shared.prototypes.last().expect("the twig").meshes;
        let reflectances = meshes.iter().map(|m| shared.materials[m.material as usize].reflectance);
        let expected = [&other.materials[0], &other.materials[1]].map(|m| m.reflectance);
        assert_eq!(reflectances.collect::<Vec<_>>(), expected);
    }
}
