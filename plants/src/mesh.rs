//! Sweeping a skeleton into triangles.
//!
//! Stems become generalized cylinders: a ring of vertices around each node, carried along the
//! axis by the least rotation from tangent to tangent (parallel transport, which does not twist
//! [Bishop75]), and closed at the tip. Blades become ribbons. Axes of one material share a mesh;
//! organs stay instanced.

use crate::frame::{across, any_normal};
use crate::skeleton::{Axis, AxisKind, Node, Skeleton};
use glam::{Quat, Vec3};
use weald_contract::{Mesh, Organ, Placement, PlantModel};

/// How far the flat sides of a ring may lie inside the true circle, m.
///
/// A quarter of a centimetre gives a trunk of 10 cm radius its full twelve sides and leaves
/// twigs below 5 mm with the fewest; nobody sees the difference from a few metres.
pub const SAG: f32 = 0.0025;

/// Fewest and most sides of a ring.
const SIDES: (usize, usize) = (3, 12);

/// The model of a grown skeleton.
pub fn model(name: &str, skeleton: &Skeleton) -> PlantModel {
    model_within(name, skeleton, SAG)
}

/// The model of a skeleton whose rings lie at most `sag` metres inside the true circles.
pub fn model_within(name: &str, skeleton: &Skeleton, sag: f32) -> PlantModel {
    let material_count = skeleton.materials.len();
    let mut wood: Vec<Mesh> =
        (0..material_count as u32).map(|material| Mesh { material, ..Mesh::default() }).collect();
    let mut path = Vec::new();
    for axis in &skeleton.axes {
        let Some(mesh) = wood.get_mut(axis.material as usize) else { continue };
        transport(skeleton.nodes_of(axis), axis.normal, &mut path);
        match axis.kind {
            AxisKind::Stem => sweep_stem(axis, &path, sag, mesh),
            AxisKind::Blade => sweep_blade(&path, mesh),
        }
    }
    wood.retain(|mesh| !mesh.triangles.is_empty());
    let materials = skeleton.materials.clone();
    PlantModel {
        name: name.into(),
        materials,
        wood,
        organs: organs(skeleton),
        ..PlantModel::default()
    }
}

/// Area of a mesh stretched by `scale` along its axes, m².
pub fn organ_area(mesh: &Mesh, scale: Vec3) -> f32 {
    let corner = |i: u32| scale * Vec3::from_array(mesh.positions[i as usize]);
    let of = |t: &[u32; 3]| {
        0.5 * (corner(t[1]) - corner(t[0])).cross(corner(t[2]) - corner(t[0])).length()
    };
    mesh.triangles.iter().map(of).sum()
}

/// The organs that occur, each with its places in the order of growth.
fn organs(skeleton: &Skeleton) -> Vec<Organ> {
    let prototypes = skeleton.prototypes.iter();
    let mut organs: Vec<Organ> = prototypes
        .map(|p| Organ { name: p.name.clone(), meshes: p.meshes.clone(), ..Organ::default() })
        .collect();
    for organ in &skeleton.organs {
        let Some(prototype) = organs.get_mut(organ.prototype as usize) else { continue };
        prototype.placements.push(Placement {
            position: organ.position.to_array(),
            rotation: organ.rotation.to_array(),
            scale: organ.scale.to_array(),
        });
    }
    organs.retain(|organ| !organ.placements.is_empty());
    organs
}

/// A node with its tangent and the transported normal.
#[derive(Clone, Copy)]
struct Station {
    position: Vec3,
    radius: f32,
    /// Distance along the axis from its first node, m.
    along: f32,
    tangent: Vec3,
    normal: Vec3,
}

/// Fills `path` with the nodes' tangents, and with `first_normal` carried along them.
fn transport(nodes: &[Node], first_normal: Vec3, path: &mut Vec<Station>) {
    path.clear();
    let mut tangent = Vec3::Z;
    let mut normal = first_normal;
    let mut along = 0.0;
    for (i, node) in nodes.iter().enumerate() {
        let before = nodes[i.saturating_sub(1)].position;
        let after = nodes[(i + 1).min(nodes.len() - 1)].position;
        let turned = (after - before).try_normalize().unwrap_or(tangent);
        if i == 0 {
            normal = across(normal, turned).unwrap_or_else(|| any_normal(turned));
        } else {
            normal = Quat::from_rotation_arc(tangent, turned) * normal;
            along += node.position.distance(before);
        }
        tangent = turned;
        path.push(Station { position: node.position, radius: node.radius, along, tangent, normal });
    }
}

/// Number of sides for a ring of this radius: the fewest whose sagitta `r (1 - cos(pi / n))`
/// stays below `sag`, m.
pub fn side_count(radius: f32, sag: f32) -> usize {
    if radius <= sag {
        return SIDES.0;
    }
    let half_angle = libm::acosf(1.0 - sag / radius);
    (libm::ceilf(std::f32::consts::PI / half_angle) as usize).clamp(SIDES.0, SIDES.1)
}

/// Unit circle points for rings of one number of sides.
fn circle(sides: usize) -> impl Iterator<Item = (f32, f32, f32)> {
    (0..=sides).map(move |i| {
        let angle = std::f32::consts::TAU * i as f32 / sides as f32;
        let (sin, cos) = libm::sincosf(if i == sides { 0.0 } else { angle });
        (angle, sin, cos)
    })
}

/// Sweeps a cylinder along the path.
///
/// The first and last vertex of a ring coincide, so that the texture has a seam. The base stays
/// open: it lies inside the parent or in the ground.
fn sweep_stem(axis: &Axis, path: &[Station], sag: f32, mesh: &mut Mesh) {
    let thickest = path.iter().map(|station| station.radius).fold(0.0, f32::max);
    let sides = if axis.lobes.0 > 0 { SIDES.1 } else { side_count(thickest, sag) };
    let unit: Vec<(f32, f32, f32)> = circle(sides).collect();
    let first = mesh.positions.len() as u32;
    let around = unit.len() as u32;
    let rings = path.len() - 1;
    for (i, station) in path[..rings].iter().enumerate() {
        let lean = lean(path, i);
        let binormal = station.tangent.cross(station.normal);
        for &(angle, sin, cos) in &unit {
            let outward = station.normal * cos + binormal * sin;
            let radius = station.radius * lobe(axis.lobes, angle);
            mesh.positions.push((station.position + outward * radius).to_array());
            mesh.normals.push((outward + station.tangent * lean).normalize().to_array());
            mesh.uvs.push([angle * thickest, station.along]);
        }
    }
    for ring in 0..rings.saturating_sub(1) as u32 {
        let low = first + ring * around;
        for side in 0..around - 1 {
            let (a, b) = (low + side, low + side + 1);
            mesh.triangles.push([a, b, b + around]);
            mesh.triangles.push([a, b + around, a + around]);
        }
    }
    close_tip(path, &unit, thickest, mesh);
}

/// Cone from the last ring to the last node, whatever radius is left there.
fn close_tip(path: &[Station], unit: &[(f32, f32, f32)], thickest: f32, mesh: &mut Mesh) {
    let Some(tip) = path.last() else { return };
    let apex = mesh.positions.len() as u32;
    let ring = apex - unit.len() as u32;
    mesh.positions.push(tip.position.to_array());
    mesh.normals.push(tip.tangent.to_array());
    mesh.uvs.push([std::f32::consts::PI * thickest, tip.along]);
    for side in 0..unit.len() as u32 - 1 {
        mesh.triangles.push([ring + side, ring + side + 1, apex]);
    }
}

/// Slope of the wall at a station: how much the normal leans forward where the stem tapers.
fn lean(path: &[Station], i: usize) -> f32 {
    let (a, b) = (&path[i.saturating_sub(1)], &path[(i + 1).min(path.len() - 1)]);
    let length = b.along - a.along;
    if length > 0.0 { ((a.radius - b.radius) / length).clamp(-2.0, 2.0) } else { 0.0 }
}

/// Factor of the radius at an angle of a lobed section, `1 + depth sin(lobes angle)` [WP95] §4.4.
fn lobe((count, depth): (u32, f32), angle: f32) -> f32 {
    if count == 0 { 1.0 } else { 1.0 + depth * libm::sinf(count as f32 * angle) }
}

/// Sweeps a ribbon along the path, pointed at its end.
fn sweep_blade(path: &[Station], mesh: &mut Mesh) {
    let first = mesh.positions.len() as u32;
    let Some((tip, body)) = path.split_last() else { return };
    for station in body {
        let side = station.tangent.cross(station.normal) * station.radius;
        for (offset, u) in [(-side, -station.radius), (side, station.radius)] {
            mesh.positions.push((station.position + offset).to_array());
            mesh.normals.push(station.normal.to_array());
            mesh.uvs.push([u, station.along]);
        }
    }
    mesh.positions.push(tip.position.to_array());
    mesh.normals.push(tip.normal.to_array());
    mesh.uvs.push([0.0, tip.along]);
    let apex = first + 2 * body.len() as u32;
    for pair in 0..body.len().saturating_sub(1) as u32 {
        let (left, right) = (first + 2 * pair, first + 2 * pair + 1);
        mesh.triangles.push([left, right, right + 2]);
        mesh.triangles.push([left, right + 2, left + 2]);
    }
    mesh.triangles.push([apex - 2, apex - 1, apex]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::opaque;

    fn swept(nodes: &[(f32, f32, f32, f32)], kind: AxisKind) -> Mesh {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let nodes =
            nodes.iter().map(|&(x, y, z, radius)| Node { position: Vec3::new(x, y, z), radius });
        skeleton.push(Axis::new(1, kind, 0), nodes);
        model("test", &skeleton).wood.remove(0)
    }

    /// Volume by the divergence theorem; an open base in the plane z = 0 contributes nothing.
    fn volume(mesh: &Mesh) -> f32 {
        let corner = |i: u32| Vec3::from_array(mesh.positions[i as usize]);
        let of = |t: &[u32; 3]| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0;
        mesh.triangles.iter().map(of).sum()
    }

    #[test]
    fn a_cylinder_encloses_the_volume_of_its_twelve_sided_prism() {
        let mesh = swept(
            &[
                (0.0, 0.0, 0.0, 0.5),
                (0.0, 0.0, 1.0, 0.5),
                (0.0, 0.0, 2.0, 0.5),
                (0.0, 0.0, 2.0, 0.0),
            ],
            AxisKind::Stem,
        );
        // A regular 12-gon of circumradius r has the area 3 r².
        assert!((volume(&mesh) - 2.0 * 3.0 * 0.25).abs() < 1e-4);
    }

    #[test]
    fn a_bent_tapering_stem_is_closed_and_faces_outward() {
        let bend: Vec<_> = (0..12)
            .map(|i| {
                let a = 0.15 * i as f32;
                (1.0 - a.cos(), 0.1 * a, a.sin(), 0.1 * (1.0 - i as f32 / 11.0))
            })
            .collect();
        let mesh = swept(&bend, AxisKind::Stem);
        assert!(volume(&mesh) > 0.0);
        // Away from seam and open base every edge is shared by two triangles that run along it
        // in opposite directions.
        let key = |i: u32| mesh.positions[i as usize].map(f32::to_bits);
        let mut edges: Vec<_> = mesh
            .triangles
            .iter()
            .flat_map(|t| [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])])
            .map(|(a, b)| (key(a), key(b)))
            .collect();
        edges.sort_unstable();
        let unpaired =
            edges.iter().filter(|(a, b)| edges.binary_search(&(*b, *a)).is_err()).count();
        let base_edges = side_count(0.1, SAG);
        assert_eq!(unpaired, base_edges);
        for (triangle, _) in mesh.triangles.iter().zip(0..) {
            let [a, b, c] = triangle.map(|i| Vec3::from_array(mesh.positions[i as usize]));
            let normal = Vec3::from_array(mesh.normals[triangle[0] as usize]);
            assert!((b - a).cross(c - a).dot(normal) > 0.0);
        }
    }

    #[test]
    fn frames_do_not_twist_along_a_helix() {
        let nodes: Vec<Node> = (0..200)
            .map(|i| {
                let a = 0.05 * i as f32;
                Node { position: Vec3::new(a.cos(), a.sin(), 0.3 * a), radius: 0.1 }
            })
            .collect();
        let mut path = Vec::new();
        transport(&nodes, Vec3::X, &mut path);
        for pair in path.windows(2) {
            // The change of a transported normal has no part around the tangent.
            let middle = (pair[0].tangent + pair[1].tangent).normalize();
            let twist = (pair[1].normal - pair[0].normal).dot(middle.cross(pair[0].normal));
            assert!(twist.abs() < 1e-4, "{twist}");
            assert!(pair[1].normal.dot(pair[1].tangent).abs() < 1e-4);
        }
    }

    #[test]
    fn thick_rings_have_more_sides_up_to_twelve() {
        assert_eq!(
            [0.001, 0.004, 0.01, 0.03, 0.1, 1.0].map(|r| side_count(r, SAG)),
            [3, 3, 5, 8, 12, 12]
        );
    }

    #[test]
    fn a_blade_of_five_nodes_has_seven_triangles_facing_its_normal() {
        let nodes = [0.0, 0.1, 0.2, 0.3, 0.4].map(|z| (0.0, 0.0, z, 0.004));
        let mesh = swept(&nodes, AxisKind::Blade);
        assert_eq!(mesh.triangles.len(), 7);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| Vec3::from_array(mesh.positions[i as usize]));
            let normal = Vec3::from_array(mesh.normals[triangle[0] as usize]);
            assert!((b - a).cross(c - a).dot(normal) > 0.0);
        }
    }
}
