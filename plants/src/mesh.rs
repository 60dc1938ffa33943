//! Sweeping a skeleton into triangles.
//!
//! An axis is first smoothed by 4-point subdivision, which keeps its nodes [Dyn87], until its
//! chords are flat enough, and thinned where nodes add nothing. Stems become generalized
//! cylinders: a ring of vertices around each node, carried along the axis by the least rotation
//! from tangent to tangent (parallel transport, which does not twist [Bishop75]), swollen into a
//! collar where they leave their bearer, and closed at the tip. Blades become ribbons. Axes of
//! one material share a mesh; organs stay instanced.

use crate::curve::{self, Course};
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

/// Part of a plant's height by which a chord may miss the curve: a pixel of a picture 500 pixels
/// high that it fills.
const BEND: f32 = 0.002;

/// Part of a plant's height by which a ring may miss the circle.
const ROUND: f32 = 0.0004;

/// Vertices at which another mesh is begun, so that files can name them by 16-bit indices: the
/// longest axis (some hundred rings of thirteen) still fits.
const SHORT_INDICES: usize = 60_000;

/// How a skeleton is swept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Meshing {
    /// How far the flat sides of a ring may lie inside the true circle, m.
    pub sag: f32,
    /// Length around a stem to which texture coordinates close, m: the width of one copy of the
    /// bark. 0 leaves them as they are.
    pub tile: f32,
    /// Whether the model knows its branches, so that wind can move it.
    pub sways: bool,
}

impl Default for Meshing {
    fn default() -> Self {
        Self { sag: SAG, tile: 0.0, sways: false }
    }
}

/// The model of a grown skeleton.
pub fn model(name: &str, skeleton: &Skeleton) -> PlantModel {
    model_with(name, skeleton, &Meshing::default())
}

/// The model of a skeleton whose rings lie at most `sag` metres inside the true circles.
pub fn model_within(name: &str, skeleton: &Skeleton, sag: f32) -> PlantModel {
    model_with(name, skeleton, &Meshing { sag, ..Meshing::default() })
}

/// The model of a skeleton, swept as asked for.
pub fn model_with(name: &str, skeleton: &Skeleton, meshing: &Meshing) -> PlantModel {
    let material_count = skeleton.materials.len();
    let mut open: Vec<Mesh> =
        (0..material_count as u32).map(|material| Mesh { material, ..Mesh::default() }).collect();
    let height = skeleton.height();
    let meshing = &Meshing { sag: coarsened(meshing.sag, height), ..*meshing };
    let courses = curve::courses(skeleton, meshing.sag, BEND * height);
    reserve(skeleton, &courses, meshing, &mut open);
    let mut wood = Vec::new();
    let circles = Circles::new();
    let (mut drawn, mut path) = (Vec::new(), Vec::new());
    for (index, axis) in skeleton.axes.iter().enumerate() {
        let Some(mesh) = open.get_mut(axis.material as usize) else { continue };
        if mesh.positions.len() > SHORT_INDICES {
            wood.push(std::mem::replace(mesh, Mesh { material: axis.material, ..Mesh::default() }));
        }
        let first = mesh.positions.len();
        courses.draw(skeleton, index, &mut drawn);
        transport(&drawn, axis.normal, &mut path);
        match axis.kind {
            AxisKind::Stem => {
                collar(skeleton, axis, meshing.sag, &mut path);
                sweep_stem(axis, &path, meshing, &circles, mesh);
            }
            AxisKind::Blade => sweep_blade(&path, mesh),
        }
        if meshing.sways {
            mesh.branches.resize(mesh.branches.len() + mesh.positions.len() - first, index as u32);
        }
    }
    wood.extend(open.into_iter().filter(|mesh| !mesh.triangles.is_empty()));
    PlantModel {
        name: name.into(),
        materials: skeleton.materials.clone(),
        wood,
        organs: organs(skeleton, &courses, meshing.sways),
        branches: if meshing.sways { crate::wind::branches(skeleton) } else { Vec::new() },
        ..PlantModel::default()
    }
}

/// How far rings may lie inside the true circles on a plant of this height, m.
pub(crate) fn coarsened(sag: f32, height: f32) -> f32 {
    sag.max(ROUND * height)
}

/// Appends a mesh to another of the same material and columns.
pub(crate) fn append(whole: &mut Mesh, part: &Mesh) {
    let first = whole.positions.len() as u32;
    whole.material = part.material;
    whole.positions.extend(&part.positions);
    whole.normals.extend(&part.normals);
    whole.uvs.extend(&part.uvs);
    whole.triangles.extend(part.triangles.iter().map(|corners| corners.map(|c| c + first)));
}

/// Makes room for what the axes can become at most: growing meshes again and again would cost
/// more than sweeping them. Room that is not used is never touched.
fn reserve(skeleton: &Skeleton, courses: &Course, meshing: &Meshing, wood: &mut [Mesh]) {
    let mut most = vec![(0, 0); wood.len()];
    for (index, axis) in skeleton.axes.iter().enumerate() {
        let Some((vertices, triangles)) = most.get_mut(axis.material as usize) else { continue };
        let rings = courses.most_nodes(axis, index) + COLLAR.len();
        let sides = sides(axis, skeleton.nodes_of(axis)[0].radius, meshing.sag);
        *vertices += rings * (sides + 1);
        *triangles += 2 * rings * sides;
    }
    for (mesh, (vertices, triangles)) in wood.iter_mut().zip(most) {
        mesh.positions.reserve(vertices);
        mesh.normals.reserve(vertices);
        mesh.uvs.reserve(vertices);
        mesh.triangles.reserve(triangles);
    }
}

/// Sides of an axis' rings: twelve where they have lobes.
fn sides(axis: &Axis, thickest: f32, sag: f32) -> usize {
    match axis.kind {
        AxisKind::Blade => 1,
        AxisKind::Stem if axis.lobes.0 > 0 => SIDES.1,
        AxisKind::Stem => side_count(thickest, sag),
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
fn organs(skeleton: &Skeleton, courses: &Course, sways: bool) -> Vec<Organ> {
    let prototypes = skeleton.prototypes.iter();
    let mut organs: Vec<Organ> = prototypes
        .map(|p| Organ { name: p.name.clone(), meshes: p.meshes.clone(), ..Organ::default() })
        .collect();
    let mut counts = vec![0; organs.len()];
    for organ in &skeleton.organs {
        if let Some(count) = counts.get_mut(organ.prototype as usize) {
            *count += 1;
        }
    }
    for (organ, count) in organs.iter_mut().zip(counts) {
        organ.placements.reserve_exact(count);
    }
    for organ in &skeleton.organs {
        let Some(prototype) = organs.get_mut(organ.prototype as usize) else { continue };
        let moved = courses.moved(skeleton, organ.axis as usize, organ.position);
        prototype.placements.push(Placement {
            position: moved.to_array(),
            rotation: rounded(organ.rotation).to_array(),
            scale: organ.scale.to_array(),
        });
        if sways {
            prototype.branches.push(organ.axis);
        }
    }
    organs.retain(|organ| !organ.placements.is_empty());
    organs
}

/// A rotation whose parts are whole 32767ths, which files keep in half the bytes; it is off by
/// less than a five-hundredth of a degree.
fn rounded(rotation: Quat) -> Quat {
    const PARTS: f32 = 32767.0;
    // Adding and taking away this number leaves the nearest whole number, even ones at halves.
    const WHOLE: f32 = 12_582_912.0;
    let part = |x: f32| ((x * PARTS + WHOLE) - WHOLE) / PARTS;
    Quat::from_array(rotation.to_array().map(part))
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

/// Swells a branch where it leaves a thicker bearer: rings outside the bearer's surface that
/// widen towards it, as wood grows around a branch's foot [Shigo85].
fn collar(skeleton: &Skeleton, axis: &Axis, sag: f32, path: &mut Vec<Station>) {
    let Some(parent) = axis.parent.and_then(|parent| skeleton.axes.get(parent as usize)) else {
        return;
    };
    let [foot, next, ..] = path[..] else { return };
    // A fork's continuation has no collar, nor has what is too thin for it to be seen.
    if parent.order == axis.order || parent.kind != AxisKind::Stem || foot.radius < 6.0 * sag {
        return;
    }
    let surface = curve::radius_at(skeleton.nodes_of(parent), axis.at);
    let length = next.along - foot.along;
    let ring = |(out, swell): (f32, f32)| {
        let along = surface + out * foot.radius;
        let t = along / length;
        let radius = (foot.radius + (next.radius - foot.radius) * t) * swell;
        let position = foot.position.lerp(next.position, t);
        // The foot's own tangent, or the rings would lean.
        Station { position, radius: radius.min(surface), along: foot.along + along, ..foot }
    };
    let rings = COLLAR.map(ring);
    let outermost = rings[COLLAR.len() - 1].along;
    if surface > 1.2 * foot.radius && outermost < next.along {
        path[0].radius = rings[0].radius;
        path.splice(1..1, rings);
    }
}

/// Rings of a collar: distance from the bearer's surface in radii of the branch, and how much
/// wider than the branch it is there.
const COLLAR: [(f32, f32); 3] = [(-0.2, 1.45), (0.5, 1.16), (1.4, 1.0)];

/// Length around a stem in texture coordinates, m: its girth, rounded to whole copies.
fn girth(radius: f32, tile: f32) -> f32 {
    let girth = std::f32::consts::TAU * radius;
    if tile > 0.0 { libm::roundf(girth / tile).max(1.0) * tile } else { girth }
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

/// Angle, sine and cosine of the points of rings, by their number of sides.
struct Circles([[(f32, f32, f32); SIDES.1 + 1]; SIDES.1 + 1]);

impl Circles {
    fn new() -> Self {
        let mut circles = [[(0.0, 0.0, 1.0); SIDES.1 + 1]; SIDES.1 + 1];
        for (sides, circle) in circles.iter_mut().enumerate().skip(SIDES.0) {
            for (i, point) in circle[..=sides].iter_mut().enumerate() {
                let angle = std::f32::consts::TAU * i as f32 / sides as f32;
                let (sin, cos) = libm::sincosf(if i == sides { 0.0 } else { angle });
                *point = (angle, sin, cos);
            }
        }
        Self(circles)
    }

    /// The points of a ring. The first comes twice, so that the texture has a seam, except on
    /// twigs, where nobody sees it.
    fn ring(&self, sides: usize) -> &[(f32, f32, f32)] {
        &self.0[sides][..if sides == SIDES.0 { sides } else { sides + 1 }]
    }
}

/// Sweeps a cylinder along the path.
///
/// The base stays open: it lies inside the parent or in the ground.
fn sweep_stem(
    axis: &Axis,
    path: &[Station],
    meshing: &Meshing,
    circles: &Circles,
    mesh: &mut Mesh,
) {
    let thickest = path.iter().map(|station| station.radius).fold(0.0, f32::max);
    let sides = sides(axis, thickest, meshing.sag);
    let unit = circles.ring(sides);
    let girth = girth(thickest, meshing.tile) / std::f32::consts::TAU;
    let first = mesh.positions.len() as u32;
    let (sides, around) = (sides as u32, unit.len() as u32);
    let rings = path.len() - 1;
    for (i, station) in path[..rings].iter().enumerate() {
        let lean = lean(path, i);
        let binormal = station.tangent.cross(station.normal);
        for &(angle, sin, cos) in unit {
            let outward = station.normal * cos + binormal * sin;
            let radius = station.radius * lobe(axis.lobes, angle);
            mesh.positions.push((station.position + outward * radius).to_array());
            mesh.normals.push((outward + station.tangent * lean).normalize().to_array());
            mesh.uvs.push([angle * girth, station.along]);
        }
    }
    for ring in 0..rings.saturating_sub(1) as u32 {
        let low = first + ring * around;
        for side in 0..sides {
            let (a, b) = (low + side, low + (side + 1) % around);
            mesh.triangles.push([a, b, b + around]);
            mesh.triangles.push([a, b + around, a + around]);
        }
    }
    // A cone from the last ring to the last node, whatever radius is left there.
    let Some(tip) = path.last() else { return };
    let apex = mesh.positions.len() as u32;
    let last = apex - around;
    mesh.positions.push(tip.position.to_array());
    mesh.normals.push(tip.tangent.to_array());
    mesh.uvs.push([std::f32::consts::PI * girth, tip.along]);
    for side in 0..sides {
        mesh.triangles.push([last + side, last + (side + 1) % around, apex]);
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
    fn a_thick_branch_gets_a_collar_and_a_twig_does_not() {
        let mesh_of = |radius: f32| {
            let mut skeleton = Skeleton::default();
            skeleton.add_material(opaque("bark", [0.2; 3]));
            let node = |position, radius| Node { position, radius };
            let trunk = [node(Vec3::ZERO, 0.2), node(Vec3::Z * 4.0, 0.2)];
            skeleton.push(Axis::new(1, AxisKind::Stem, 0), trunk);
            let branch = [node(Vec3::Z * 2.0, radius), node(Vec3::new(2.0, 0.0, 2.0), radius)];
            skeleton.push(Axis::new(2, AxisKind::Stem, 0).on(0, 0.5, 1), branch);
            model("test", &skeleton).wood.remove(0)
        };
        let widest = |mesh: &Mesh, x: f32| {
            let is_near = |p: &&[f32; 3]| (p[0] - x).abs() < 0.02 && (p[2] - 2.0).abs() < 0.5;
            let near = mesh.positions.iter().filter(is_near);
            near.map(|p| (p[2] - 2.0).hypot(p[1])).fold(0.0, f32::max)
        };
        let thick = mesh_of(0.08);
        // A fifth of a radius inside the trunk's surface it is 1.45 times as wide.
        assert!((widest(&thick, 0.2 - 0.016) - 0.116).abs() < 1e-3);
        assert!((widest(&thick, 0.2 + 1.4 * 0.08) - 0.08).abs() < 1e-3);
        let count = |mesh: &Mesh| mesh.positions.len();
        assert_eq!(count(&mesh_of(0.002)), 13 + 1 + 3 + 1);
    }

    #[test]
    fn bark_closes_around_a_stem() {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let node = |z| Node { position: Vec3::Z * z, radius: 0.13 };
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), [node(0.0), node(1.0), node(2.0)]);
        let meshing = Meshing { tile: 0.3, ..Meshing::default() };
        let mesh = model_with("test", &skeleton, &meshing).wood.remove(0);
        let around = mesh.uvs.iter().map(|uv| uv[0]).fold(0.0, f32::max);
        // 0.82 m hold three copies of 0.3 m.
        assert!((around - 0.9).abs() < 1e-5);
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
        // Bent a little: chords are flat enough as they are, and none can be left out.
        let nodes = [0.0_f32, 0.1, 0.2, 0.3, 0.4].map(|z| (0.0, z * z, z, 0.004));
        let mesh = swept(&nodes, AxisKind::Blade);
        assert_eq!(mesh.triangles.len(), 7);
        for triangle in &mesh.triangles {
            let [a, b, c] = triangle.map(|i| Vec3::from_array(mesh.positions[i as usize]));
            let normal = Vec3::from_array(mesh.normals[triangle[0] as usize]);
            assert!((b - a).cross(c - a).dot(normal) > 0.0);
        }
    }
}
