//! Shapes of leaves, petals and flower heads: few triangles, true outlines.
//!
//! An organ is attached at the origin, grows along +Y and turns its upper side to +Z. Leaves are
//! one long, so that an instance's scale is width and length in metres.

use glam::Vec3;
use weald_contract::{Mesh, words};

words! {
    /// Outline of a leaf.
    pub enum LeafShape {
        /// Broad and rounded with a point, as of aspens.
        Ovate = "ovate",
        /// Long and narrow, as of willows.
        Lanceolate = "lanceolate",
        /// Widest above the middle with a wavy edge, as of oaks.
        Lobed = "lobed",
        /// Elliptic, as of tupelos and most herbs.
        Elliptic = "elliptic",
        /// Widest near the tip, as of clovers and sassafras.
        Obovate = "obovate",
        /// A narrow strip, as of needles and bracts.
        Linear = "linear",
        /// A toothed heart, as of nettles and brambles.
        Toothed = "toothed",
        /// Cut to the midrib by teeth that point back, as of dandelions.
        Runcinate = "runcinate",
    }
}

/// Half an outline: from the base at (0, 0) to the tip at (0, 1), widths as parts of the whole
/// width, so at most 0.5.
fn half_outline(shape: LeafShape) -> &'static [[f32; 2]] {
    match shape {
        LeafShape::Ovate => &[[0.47, 0.27], [0.43, 0.66]],
        LeafShape::Lanceolate => &[[0.38, 0.25], [0.42, 0.6]],
        LeafShape::Lobed => &[[0.20, 0.25], [0.36, 0.45], [0.50, 0.66], [0.30, 0.93]],
        LeafShape::Elliptic => &[[0.40, 0.28], [0.42, 0.66]],
        LeafShape::Obovate => &[[0.30, 0.45], [0.50, 0.80]],
        LeafShape::Linear => &[[0.48, 0.10], [0.45, 0.85]],
        LeafShape::Toothed => {
            &[[0.42, 0.12], [0.5, 0.3], [0.4, 0.36], [0.41, 0.56], [0.28, 0.62], [0.2, 0.84]]
        }
        LeafShape::Runcinate => &[
            [0.06, 0.22],
            [0.22, 0.24],
            [0.09, 0.36],
            [0.32, 0.4],
            [0.12, 0.52],
            [0.42, 0.57],
            [0.16, 0.68],
            [0.5, 0.74],
        ],
    }
}

/// Area of a leaf of this shape, as part of its length times its width.
pub fn leaf_area(shape: LeafShape) -> f32 {
    let half = half_outline(shape);
    let rim = std::iter::once([0.0, 0.0]).chain(half.iter().copied()).chain([[0.0, 1.0]]);
    let rim: Vec<[f32; 2]> = rim.collect();
    2.0 * rim.windows(2).map(|p| 0.5 * (p[0][0] + p[1][0]) * (p[1][1] - p[0][1])).sum::<f32>()
}

/// A leaf one long and one wide, its halves folded up along the midrib and its length bent down.
///
/// `fold` is the rise of the margin and `bend` the drop of the tip, both as parts of the length.
/// Each half is a fan from the tip where that fits the outline, or else a strip along the
/// midrib.
pub fn leaf(shape: LeafShape, fold: f32, bend: f32, material: u32) -> Mesh {
    let half = half_outline(shape);
    let height = |x: f32, y: f32| 2.0 * fold * x - bend * y * y;
    let mut mesh = Mesh { material, ..Mesh::default() };
    let mut add = |x: f32, y: f32| {
        mesh.positions.push([x, y, height(x.abs(), y)]);
        mesh.uvs.push([x + 0.5, y]);
        (mesh.positions.len() - 1) as u32
    };
    let (base, tip) = (add(0.0, 0.0), add(0.0, 1.0));
    let mut triangles = Vec::new();
    if !sees_whole_rim(half) {
        let triangles = strips(half, [base, tip], &mut add);
        mesh.triangles = triangles;
        smooth(&mut mesh);
        return mesh;
    }
    for side in [1.0, -1.0] {
        let rim: Vec<u32> = half.iter().map(|&[x, y]| add(side * x, y)).collect();
        let rim: Vec<u32> = std::iter::once(base).chain(rim).collect();
        for pair in rim.windows(2) {
            let (a, b) = if side > 0.0 { (pair[0], pair[1]) } else { (pair[1], pair[0]) };
            triangles.push([a, b, tip]);
        }
    }
    mesh.triangles = triangles;
    smooth(&mut mesh);
    mesh
}

/// Whether straight lines from the tip reach every point of the outline inside it.
fn sees_whole_rim(half: &[[f32; 2]]) -> bool {
    let slope = |p: &[f32; 2]| p[0] / (1.0 - p[1]);
    half.windows(2).all(|pair| slope(&pair[0]) <= slope(&pair[1]))
}

/// Triangles of a leaf between its midrib and its rim, corner by corner.
fn strips(
    half: &[[f32; 2]],
    [base, tip]: [u32; 2],
    add: &mut impl FnMut(f32, f32) -> u32,
) -> Vec<[u32; 3]> {
    let midrib: Vec<u32> = half.iter().map(|&[_, y]| add(0.0, y)).collect();
    let mut triangles = Vec::new();
    for side in [1.0, -1.0] {
        let rim: Vec<u32> = half.iter().map(|&[x, y]| add(side * x, y)).collect();
        let mut face = |a: u32, b: u32, c: u32| {
            triangles.push(if side > 0.0 { [a, b, c] } else { [a, c, b] });
        };
        face(base, rim[0], midrib[0]);
        for i in 0..half.len() - 1 {
            face(midrib[i], rim[i], rim[i + 1]);
            face(midrib[i], rim[i + 1], midrib[i + 1]);
        }
        face(midrib[half.len() - 1], rim[half.len() - 1], tip);
    }
    triangles
}

/// Petals in a ring around +Y, opening towards it: `count` of length 1 and width `width`.
///
/// `rise` is how far the petals' tips stand above their bases along +Y; negative ones hang, as
/// of coneflowers. `inner` is the radius at which they begin.
pub fn petals(count: u32, inner: f32, width: f32, rise: f32, material: u32) -> Mesh {
    let mut mesh = Mesh { material, ..Mesh::default() };
    for petal in 0..count {
        let angle = std::f32::consts::TAU * petal as f32 / count as f32;
        let (sin, cos) = libm::sincosf(angle);
        let out = Vec3::new(cos, 0.0, sin);
        let across = Vec3::new(-sin, 0.0, cos) * (0.5 * width);
        let point = |along: f32, side: f32, up: f32| {
            (out * (inner + along) + across * side + Vec3::Y * (rise * up)).to_array()
        };
        let first = mesh.positions.len() as u32;
        // Two triangles: a kite that is widest beyond the middle.
        mesh.positions.extend([
            point(0.0, 0.0, 0.0),
            point(0.62, -1.0, 0.5),
            point(1.0, 0.0, 1.0),
            point(0.62, 1.0, 0.5),
        ]);
        mesh.triangles.extend([[first, first + 3, first + 2], [first, first + 2, first + 1]]);
    }
    smooth(&mut mesh);
    mesh
}

/// A dome around +Y: `sides` triangles from a rim of radius 1 to an apex at `height`. It is open
/// below, where petals or the stalk hide it.
pub fn dome(sides: u32, height: f32, material: u32) -> Mesh {
    let mut mesh = Mesh { material, ..Mesh::default() };
    for side in 0..sides {
        let (sin, cos) = libm::sincosf(std::f32::consts::TAU * side as f32 / sides as f32);
        mesh.positions.push([cos, 0.0, sin]);
    }
    mesh.positions.push([0.0, height, 0.0]);
    for side in 0..sides {
        mesh.triangles.push([(side + 1) % sides, side, sides]);
    }
    smooth(&mut mesh);
    mesh
}

/// A closed body of length 1 along +Y and width 1, pointed at both ends: buds, grains, berries.
pub fn bead(sides: u32, material: u32) -> Mesh {
    let mut mesh = Mesh { material, ..Mesh::default() };
    mesh.positions.extend([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]);
    for y in BEAD_RINGS {
        for side in 0..sides {
            let (sin, cos) = libm::sincosf(std::f32::consts::TAU * side as f32 / sides as f32);
            mesh.positions.push([0.5 * cos, y, 0.5 * sin]);
        }
    }
    for side in 0..sides {
        let (a, b) = (2 + side, 2 + (side + 1) % sides);
        let (c, d) = (a + sides, b + sides);
        mesh.triangles.extend([[0, a, b], [a, c, d], [a, d, b], [1, d, c]]);
    }
    smooth(&mut mesh);
    mesh
}

/// Heights of the two widest rings of a bead: between them it is a cylinder.
const BEAD_RINGS: [f32; 2] = [0.3, 0.65];

/// A scar on a stem of radius 1 along +Y: a lens that lies on the side of +Z.
pub fn scar(material: u32) -> Mesh {
    let mut mesh = Mesh { material, ..Mesh::default() };
    // Angle around the stem and half height; the stem's own polygon lies inside the circle, so a
    // little outside it the lens covers both.
    const RIM: [(f32, f32); 6] =
        [(-0.8, 0.0), (-0.45, 0.11), (-0.1, 0.22), (0.2, 0.2), (0.5, 0.1), (0.85, 0.0)];
    let at = |angle: f32, y: f32| {
        let (sin, cos) = libm::sincosf(angle);
        ([1.015 * sin, y - 0.15 * sin * sin, 1.015 * cos], [sin, 0.0, cos])
    };
    for (angle, half) in RIM {
        for y in [-half, half] {
            let (position, normal) = at(angle, y);
            mesh.positions.push(position);
            mesh.normals.push(normal);
        }
    }
    for i in 0..RIM.len() as u32 - 1 {
        let (a, b) = (2 * i, 2 * i + 2);
        mesh.triangles.push([a, b, b + 1]);
        mesh.triangles.push([a, b + 1, a + 1]);
    }
    mesh
}

/// The same mesh scaled about the origin and moved.
pub fn scaled(mut mesh: Mesh, scale: f32, offset: [f32; 3]) -> Mesh {
    for position in &mut mesh.positions {
        *position = (Vec3::from_array(*position) * scale + Vec3::from_array(offset)).to_array();
    }
    mesh
}

/// Sets each vertex normal to the mean of its triangles', weighted by area.
fn smooth(mesh: &mut Mesh) {
    let mut sums = vec![Vec3::ZERO; mesh.positions.len()];
    for triangle in &mesh.triangles {
        let [a, b, c] = triangle.map(|i| Vec3::from_array(mesh.positions[i as usize]));
        let normal = (b - a).cross(c - a);
        triangle.iter().for_each(|&i| sums[i as usize] += normal);
    }
    mesh.normals = sums.iter().map(|sum| sum.normalize_or(Vec3::Z).to_array()).collect();
}

#[cfg(test)]
mod tests {
    use super::*;

    const SHAPES: [LeafShape; 8] = [
        LeafShape::Ovate,
        LeafShape::Lanceolate,
        LeafShape::Lobed,
        LeafShape::Elliptic,
        LeafShape::Obovate,
        LeafShape::Linear,
        LeafShape::Toothed,
        LeafShape::Runcinate,
    ];

    fn area(mesh: &Mesh) -> f32 {
        let corner = |i: u32| Vec3::from_array(mesh.positions[i as usize]);
        let of = |t: &[u32; 3]| {
            0.5 * (corner(t[1]) - corner(t[0])).cross(corner(t[2]) - corner(t[0])).length()
        };
        mesh.triangles.iter().map(of).sum()
    }

    #[test]
    fn flat_leaves_have_the_area_of_their_outline_and_face_up() {
        for shape in SHAPES {
            let mesh = leaf(shape, 0.0, 0.0, 0);
            assert!(mesh.is_sound(1));
            assert!((area(&mesh) - leaf_area(shape)).abs() < 0.02, "{shape:?}");
            assert!((4..=36).contains(&mesh.triangles.len()));
            assert!(mesh.normals.iter().all(|n| n[2] > 0.99));
            assert!(
                mesh.positions.iter().all(|p| p[0].abs() <= 0.5 && (0.0..=1.0).contains(&p[1]))
            );
        }
    }

    #[test]
    fn a_bead_is_closed_and_faces_outward() {
        let mesh = bead(6, 0);
        let corner = |i: u32| Vec3::from_array(mesh.positions[i as usize]);
        let of = |t: &[u32; 3]| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0;
        let volume: f32 = mesh.triangles.iter().map(of).sum();
        // Two pyramids of height 0.65 together and a prism of 0.35 on a hexagon of radius 1/2.
        let hexagon = 1.5 * 3_f32.sqrt() / 4.0;
        assert!((volume - hexagon * (0.65 / 3.0 + 0.35)).abs() < 1e-5, "{volume}");
    }

    #[test]
    fn a_folded_leaf_rises_to_its_margin() {
        let mesh = leaf(LeafShape::Ovate, 0.2, 0.0, 0);
        assert!(mesh.positions.iter().any(|p| p[2] > 0.1));
        assert!(mesh.positions.iter().filter(|p| p[0] == 0.0).all(|p| p[2] == 0.0));
    }

    #[test]
    fn petals_lie_around_the_stalk_and_look_away_from_it() {
        let mesh = petals(13, 0.2, 0.3, 0.0, 0);
        assert_eq!(mesh.triangles.len(), 26);
        assert!(mesh.normals.iter().all(|n| n[1] > 0.99));
    }

    #[test]
    fn a_dome_has_the_volume_of_its_pyramid_and_so_faces_outward() {
        let mesh = dome(4, 0.6, 0);
        let corner = |i: u32| Vec3::from_array(mesh.positions[i as usize]);
        let of = |t: &[u32; 3]| corner(t[0]).dot(corner(t[1]).cross(corner(t[2]))) / 6.0;
        let volume: f32 = mesh.triangles.iter().map(of).sum();
        // A square of diagonal 2 has the area 2; a third of base times height.
        assert!((volume - 2.0 * 0.6 / 3.0).abs() < 1e-5, "{volume}");
    }
}
