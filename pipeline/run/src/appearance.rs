//! How different two plants look: silhouettes, leaf area and height.
//!
//! [Deussen98] leaves open how well a representative stands for its plants. Here a plant is grown
//! exactly and compared with the scaled model that stands in its place. Silhouettes are drawn by
//! parallel projection from two sides, at a scale that both plants share; their intersection over
//! union is 1 where they are the same. A plant as deserving as the exact one, grown by another
//! chance, gives the measure: differences of individuals, which nobody sees in a wood.

use glam::{Quat, Vec3};
use serde::Serialize;
use weald_contract::{PlantModel, Surface};

/// Pixels along the longer side of both silhouettes.
const SIDE: usize = 160;

/// How one plant looks beside another.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Likeness {
    /// Intersection over union of the silhouettes, mean of two sides; 1 when they are the same.
    pub silhouette_iou: f64,
    /// Leaf area of the second as a part of the first's; 1 when both have none.
    pub leaf_area: f64,
    /// Height of the second as a part of the first's.
    pub height: f64,
}

/// A plant's triangles in its own space, what a comparison needs to know.
pub struct Shape {
    triangles: Vec<[Vec3; 3]>,
    leaf_area: f64,
}

impl Shape {
    /// The shape of a model, at a scale.
    pub fn of(model: &PlantModel, scale: f32) -> Self {
        let mut shape = Self { triangles: Vec::new(), leaf_area: 0.0 };
        let is_leaf = |material: u32| {
            let material = model.materials.get(material as usize);
            material.is_some_and(|material| matches!(material.surface, Surface::Leaf { .. }))
        };
        for mesh in &model.wood {
            shape.add(mesh, is_leaf(mesh.material), |p| p * scale);
        }
        for organ in &model.organs {
            for place in &organ.placements {
                let rotation = Quat::from_array(place.rotation);
                let (size, position) = (Vec3::from(place.scale), Vec3::from(place.position));
                for mesh in &organ.meshes {
                    let is_leaf = is_leaf(mesh.material);
                    shape.add(mesh, is_leaf, |p| (rotation * (p * size) + position) * scale);
                }
            }
        }
        shape
    }

    fn add(&mut self, mesh: &weald_contract::Mesh, is_leaf: bool, place: impl Fn(Vec3) -> Vec3) {
        for triangle in &mesh.triangles {
            let found = triangle.map(|index| mesh.positions.get(index as usize));
            let [Some(a), Some(b), Some(c)] = found else { continue };
            let [a, b, c] = [*a, *b, *c].map(|corner| place(Vec3::from(corner)));
            if !(a.is_finite() && b.is_finite() && c.is_finite()) {
                continue;
            }
            if is_leaf {
                self.leaf_area += f64::from((b - a).cross(c - a).length()) / 2.0;
            }
            self.triangles.push([a, b, c]);
        }
    }

    fn height(&self) -> f64 {
        let corners = self.triangles.iter().flatten();
        corners.fold(0.0f32, |height, corner| height.max(corner.z)).into()
    }

    /// Least and largest corner.
    fn bounds(&self) -> [Vec3; 2] {
        let corners = self.triangles.iter().flatten();
        corners.fold([Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY)], |[a, b], c| {
            [a.min(*c), b.max(*c)]
        })
    }

    /// Pixels that the shape covers, seen along `axis` (0 = from the side of x, 1 = of y).
    fn silhouette(&self, axis: usize, frame: &Frame) -> Vec<bool> {
        let mut covered = vec![false; SIDE * SIDE];
        for triangle in &self.triangles {
            fill(&mut covered, triangle.map(|corner| frame.pixel(corner[1 - axis], corner.z)));
        }
        covered
    }
}

/// Compares two shapes that stand at the origin.
pub fn likeness(exact: &Shape, other: &Shape) -> Likeness {
    let part = |a: f64, b: f64| if a == b { 1.0 } else { b / a };
    let iou = |axis: usize| {
        let frame = Frame::of([exact, other], axis);
        let (a, b) = (exact.silhouette(axis, &frame), other.silhouette(axis, &frame));
        let count = |is: fn(bool, bool) -> bool| {
            a.iter().zip(&b).filter(|(a, b)| is(**a, **b)).count() as f64
        };
        let (both, either) = (count(|a, b| a && b), count(|a, b| a || b));
        if either > 0.0 { both / either } else { 1.0 }
    };
    Likeness {
        silhouette_iou: (iou(0) + iou(1)) / 2.0,
        leaf_area: part(exact.leaf_area, other.leaf_area),
        height: part(exact.height(), other.height()),
    }
}

/// Where a point falls on the picture that two shapes share.
struct Frame {
    left: f32,
    bottom: f32,
    pixels_per_metre: f32,
}

impl Frame {
    fn of(shapes: [&Shape; 2], axis: usize) -> Self {
        let [[a, b], [c, d]] = shapes.map(Shape::bounds);
        let (low, high) = (a.min(c), b.max(d));
        let across = 1 - axis;
        let size = (high[across] - low[across]).max(high.z - low.z).max(1e-6);
        Self { left: low[across], bottom: low.z, pixels_per_metre: SIDE as f32 / size }
    }

    fn pixel(&self, across: f32, up: f32) -> [f32; 2] {
        [(across - self.left), (up - self.bottom)].map(|x| x * self.pixels_per_metre)
    }
}

/// Covers the pixels whose middle lies in a triangle, and those of its longest edge: a blade is
/// thinner than a pixel and still seen.
fn fill(covered: &mut [bool], [a, b, c]: [[f32; 2]; 3]) {
    let clip = |value: f32| (value.max(0.0) as usize).min(SIDE - 1);
    let low = |i: usize| a[i].min(b[i]).min(c[i]);
    let high = |i: usize| a[i].max(b[i]).max(c[i]);
    let edge = |u: [f32; 2], v: [f32; 2], p: [f32; 2]| {
        (v[0] - u[0]) * (p[1] - u[1]) - (v[1] - u[1]) * (p[0] - u[0])
    };
    for row in clip(low(1))..=clip(high(1)) {
        for column in clip(low(0))..=clip(high(0)) {
            let p = [column as f32 + 0.5, row as f32 + 0.5];
            let sides = [edge(a, b, p), edge(b, c, p), edge(c, a, p)];
            if sides.iter().all(|side| *side >= 0.0) || sides.iter().all(|side| *side <= 0.0) {
                covered[row * SIDE + column] = true;
            }
        }
    }
    let length = |[u, v]: [[f32; 2]; 2]| (v[0] - u[0]).hypot(v[1] - u[1]);
    let longest = [[a, b], [b, c], [c, a]]
        .into_iter()
        .reduce(|longest, edge| if length(edge) > length(longest) { edge } else { longest });
    if let Some([u, v]) = longest {
        let steps = (length([u, v]).ceil() as usize).clamp(1, 2 * SIDE);
        for step in 0..=steps {
            let t = step as f32 / steps as f32;
            let at = [0, 1].map(|i| clip(u[i] + t * (v[i] - u[i])));
            covered[at[1] * SIDE + at[0]] = true;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Material, Mesh};

    /// An upright board, `width` by `height`, that faces both x and y.
    fn board(width: f32, height: f32) -> PlantModel {
        let (w, h) = (width / 2.0, height);
        let positions = vec![[-w, -w, 0.0], [w, w, 0.0], [w, w, h], [-w, -w, h]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
        let material = Material {
            name: "leaf".into(),
            reflectance: [0.1; 3],
            roughness: 1.0,
            surface: Surface::Leaf { transmittance: [0.1; 3] },
            ..Material::default()
        };
        PlantModel { materials: vec![material], wood: vec![mesh], ..PlantModel::default() }
    }

    #[test]
    fn a_plant_looks_like_itself() {
        let shape = Shape::of(&board(1.0, 2.0), 1.3);
        let like = likeness(&shape, &shape);
        assert_eq!(like, Likeness { silhouette_iou: 1.0, leaf_area: 1.0, height: 1.0 });
        let none = Shape::of(&PlantModel::default(), 1.0);
        assert_eq!(likeness(&none, &none).silhouette_iou, 1.0);
    }

    #[test]
    fn boards_of_half_the_width_cover_half_of_both() {
        let (wide, narrow) = (Shape::of(&board(2.0, 2.0), 1.0), Shape::of(&board(1.0, 2.0), 1.0));
        let like = likeness(&wide, &narrow);
        assert!((like.silhouette_iou - 0.5).abs() < 0.02, "{}", like.silhouette_iou);
        assert!((like.leaf_area - 0.5).abs() < 1e-6 && like.height == 1.0);
    }

    #[test]
    fn a_scaled_model_is_compared_at_its_scale() {
        let (large, small) = (Shape::of(&board(1.0, 2.0), 1.0), Shape::of(&board(0.5, 1.0), 2.0));
        let like = likeness(&large, &small);
        assert!(like.silhouette_iou > 0.98 && (like.height - 1.0).abs() < 1e-6);
    }
}
