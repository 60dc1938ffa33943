//! A level: a tree over triangles or over placements of another level.

use super::Bounds;
use super::build::{Wide, build, widen};
use super::lanes::{LEAF, LocalRay, Node};
use crate::primitive::Face;
use glam::{Mat3A, Quat, Vec3, Vec3A};
use rayon::prelude::*;

/// A triangle before it is packed, or the parallelogram that it is half of.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Triangle {
    pub corners: [Vec3; 3],
    pub face: Face,
    /// Whether it stands for the whole parallelogram whose fourth corner lies opposite the first:
    /// leaves are rectangles more often than not, and one test then serves for two triangles.
    pub is_half: bool,
}

/// Up to eight triangles or parallelograms of a leaf, lane by lane: `[axis][lane]`.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct Block {
    pub corner: [[f32; 8]; 3],
    pub edge_1: [[f32; 8]; 3],
    pub edge_2: [[f32; 8]; 3],
    /// Index of each triangle's face; [`HALF`] is set where the parallelogram is meant.
    pub face: [u32; 8],
}

/// Bit of a face's index that marks a parallelogram: the sign, by which vectors blend.
pub(crate) const HALF: u32 = 1 << 31;

/// A placement: scaled, then rotated, then moved.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instance {
    /// Rotation, unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    pub position: [f32; 3],
    pub scale: f32,
    /// Number of the level that is placed.
    pub level: u32,
}

/// A tree and what hangs in it.
pub(crate) struct Level {
    pub nodes: Vec<Node>,
    pub content: Content,
}

/// What the leaves of a level hold.
pub(crate) enum Content {
    /// Triangles; leaf number `i` is block number `i`.
    Mesh {
        blocks: Vec<Block>,
        faces: Vec<Face>,
        /// Triangles, two for each parallelogram.
        count: u64,
    },
    /// Placements; leaf number `i` is instance number `i`.
    Group {
        instances: Vec<Instance>,
        /// The plant that each instance stands for.
        plants: Vec<u64>,
    },
}

/// No triangle: a determinant of 0 is never met.
const EMPTY_BLOCK: Block =
    Block { corner: [[0.0; 8]; 3], edge_1: [[0.0; 8]; 3], edge_2: [[0.0; 8]; 3], face: [0; 8] };

/// Triangles in a leaf of a mesh: as many as are tested at once.
const BLOCK_SIZE: usize = 8;

impl Triangle {
    /// A triangle and no more.
    pub fn new(corners: [Vec3; 3], face: Face) -> Self {
        Self { corners, face, is_half: false }
    }

    /// The parallelogram of two triangles that share an edge, if they make one: in shape within
    /// rounding, in material and normals too.
    pub fn joined(&self, other: &Triangle) -> Option<Triangle> {
        // The corner that the other lacks comes first, so that the shared edge lies opposite.
        let turn = (0..3).find(|&i| !other.corners.contains(&self.corners[i]))?;
        let [a, b, c] = [0, 1, 2].map(|i| self.corners[(turn + i) % 3]);
        let far = (0..3).find(|&i| other.corners[i] != b && other.corners[i] != c)?;
        let [d, e, f] = [0, 1, 2].map(|i| other.corners[(far + i) % 3]);
        let rounding = 2.0 * f32::EPSILON * (a.abs() + b.abs() + c.abs() + d.abs()).max_element();
        let slack = rounding + 1e-5 * (b - a).abs().max((c - a).abs()).max_element();
        let is_whole = (e, f) == (c, b) && (b + c - a - d).abs().max_element() <= slack;
        let face = self.face.rotated(turn);
        (is_whole && !self.is_half && !other.is_half && face.continues(&other.face.rotated(far)))
            .then_some(Triangle { corners: [a, b, c], face, is_half: true })
    }

    /// The smallest box around it.
    pub fn bounds(&self) -> Bounds {
        let [a, b, c] = self.corners.map(Vec3A::from);
        let bounds = Bounds::of([a, b, c]);
        if self.is_half { bounds.union(Bounds::of([b + c - a])) } else { bounds }
    }

    /// Triangles that it stands for.
    fn count(&self) -> u64 {
        1 + u64::from(self.is_half)
    }
}

/// Joins neighbours in a list into parallelograms.
pub(crate) fn join_pairs(triangles: &[Triangle]) -> Vec<Triangle> {
    let mut joined = Vec::with_capacity(triangles.len());
    let mut rest = triangles;
    while let [first, tail @ ..] = rest {
        let whole = tail.first().and_then(|second| first.joined(second));
        joined.push(whole.unwrap_or(*first));
        rest = if whole.is_some() { &tail[1..] } else { tail };
    }
    joined.shrink_to_fit();
    joined
}

impl Block {
    /// The triangle's edges from its first corner.
    pub fn edges(&self, lane: usize) -> (Vec3, Vec3) {
        let pick = |rows: &[[f32; 8]; 3]| Vec3::from_array([0, 1, 2].map(|axis| rows[axis][lane]));
        (pick(&self.edge_1), pick(&self.edge_2))
    }

    /// The triangles inside. Lanes are filled from the first on, and each face is used once.
    fn unpack(&self, faces: &[Face]) -> Vec<Triangle> {
        let number = |lane: usize| self.face[lane] & !HALF;
        let is_used = |&lane: &usize| lane == 0 || number(lane) > number(lane - 1);
        let triangle = |lane: usize| {
            let corner = Vec3::from_array([0, 1, 2].map(|axis| self.corner[axis][lane]));
            let (edge_1, edge_2) = self.edges(lane);
            let corners = [corner, corner + edge_1, corner + edge_2];
            let is_half = self.face[lane] & HALF != 0;
            Triangle { corners, face: faces[number(lane) as usize], is_half }
        };
        (0..BLOCK_SIZE).take_while(is_used).map(triangle).collect()
    }

    fn pack(triangles: impl Iterator<Item = (Triangle, u32)>) -> Self {
        let mut block = EMPTY_BLOCK;
        for (lane, (triangle, face)) in triangles.enumerate() {
            let [a, b, c] = triangle.corners;
            for axis in 0..3 {
                block.corner[axis][lane] = a[axis];
                block.edge_1[axis][lane] = b[axis] - a[axis];
                block.edge_2[axis][lane] = c[axis] - a[axis];
            }
            block.face[lane] = if triangle.is_half { face | HALF } else { face };
        }
        block
    }
}

impl Instance {
    /// Takes a ray into the space of what is placed; `t` keeps its meaning.
    #[inline(always)]
    pub fn enter(&self, ray: &LocalRay) -> LocalRay {
        let [x, y, z, w] = self.rotation;
        let inverse = Quat::from_xyzw(-x, -y, -z, w);
        let shrink = 1.0 / self.scale;
        let origin = rotate(inverse, ray.origin - Vec3::from_array(self.position)) * shrink;
        LocalRay::new(origin, rotate(inverse, ray.direction) * shrink)
    }

    /// Turns a direction from the space of what is placed into the space of the placement.
    pub fn turn(&self, direction: Vec3) -> Vec3 {
        rotate(Quat::from_array(self.rotation), direction)
    }

    /// A triangle of what is placed, in the space of the placement.
    fn carry(&self, triangle: Triangle) -> Triangle {
        let out = |p: Vec3| self.turn(p) * self.scale + Vec3::from_array(self.position);
        let corners = triangle.corners.map(out);
        Triangle { corners, face: triangle.face.turned(|normal| self.turn(normal)), ..triangle }
    }

    /// Box of a box that is placed.
    fn place(&self, bounds: &Bounds) -> Bounds {
        let matrix = Mat3A::from_quat(Quat::from_array(self.rotation)) * self.scale;
        let center = matrix * bounds.center() + Vec3A::from_array(self.position);
        let half = 0.5 * (bounds.high - bounds.low);
        let reach = matrix.x_axis.abs() * half.x
            + matrix.y_axis.abs() * half.y
            + matrix.z_axis.abs() * half.z;
        // Rounding of the transform, here and in `enter`, must not move geometry out of its box.
        let slack = 4.0 * f32::EPSILON * (center.abs() + reach);
        Bounds { low: center - reach - slack, high: center + reach + slack }
    }
}

/// Rotation of a vector by a unit quaternion.
#[inline(always)]
fn rotate(q: Quat, v: Vec3) -> Vec3 {
    let axis = Vec3::new(q.x, q.y, q.z);
    let twice = 2.0 * axis.cross(v);
    v + q.w * twice + axis.cross(twice)
}

impl Level {
    /// A mesh. Faces are stored in the order of leaves, so that neighbours share cache lines.
    pub fn mesh(triangles: &[Triangle]) -> Self {
        let boxes: Vec<Bounds> = triangles.par_iter().map(Triangle::bounds).collect();
        let tree = build(&boxes, BLOCK_SIZE);
        let Wide { nodes, leaves } = widen(&tree, BLOCK_SIZE);
        let faces = leaves.iter().flat_map(|&(first, count)| first..first + count);
        let faces: Vec<Face> =
            faces.map(|item| triangles[tree.order[item as usize] as usize].face).collect();
        let mut next = 0;
        let starts = leaves.iter().map(|&(first, count)| {
            next += count;
            (first, count, next - count)
        });
        let blocks = starts
            .map(|(first, count, face)| {
                let items = &tree.order[first as usize..(first + count) as usize];
                Block::pack(items.iter().map(|&item| triangles[item as usize]).zip(face..))
            })
            .collect();
        let count = triangles.iter().map(Triangle::count).sum();
        Self { nodes, content: Content::Mesh { blocks, faces, count } }
    }

    /// A group of placements of `levels`, each with the plant that it stands for.
    ///
    /// Placements of empty levels are left out.
    pub fn group(placed: &[(Instance, u64)], levels: &[Level]) -> Self {
        let outlines: Vec<Vec<Bounds>> = levels.iter().map(Level::outline).collect();
        let is_something =
            |(instance, _): &&(Instance, u64)| !outlines[instance.level as usize].is_empty();
        let placed: Vec<(Instance, u64)> = placed.iter().filter(is_something).copied().collect();
        let boxes: Vec<Bounds> = placed
            .par_iter()
            .map(|(instance, _)| {
                let outline = &outlines[instance.level as usize];
                let boxes = outline.iter().map(|bounds| instance.place(bounds));
                boxes.fold(Bounds::EMPTY, Bounds::union)
            })
            .collect();
        let tree = build(&boxes, 1);
        let Wide { nodes, leaves } = widen(&tree, 1);
        let (instances, plants) =
            leaves.iter().map(|&(first, _)| placed[tree.order[first as usize] as usize]).unzip();
        Self { nodes, content: Content::Group { instances, plants } }
    }

    /// All triangles with their faces, brought to where the level's placements put them.
    pub fn triangles(&self, levels: &[Level]) -> Vec<Triangle> {
        match &self.content {
            Content::Mesh { blocks, faces, .. } => {
                blocks.iter().flat_map(|block| block.unpack(faces)).collect()
            }
            Content::Group { instances, .. } => {
                let inside = |instance: &Instance| {
                    let triangles = levels[instance.level as usize].triangles(levels);
                    triangles.into_iter().map(|triangle| instance.carry(triangle)).collect()
                };
                instances.iter().flat_map::<Vec<Triangle>, _>(inside).collect()
            }
        }
    }

    /// Number of triangles that a ray can meet.
    pub fn triangle_count(&self, levels: &[Level]) -> u128 {
        match &self.content {
            Content::Mesh { count, .. } => u128::from(*count),
            Content::Group { instances, .. } => {
                let inside = |i: &Instance| levels[i.level as usize].triangle_count(levels);
                instances.iter().map(inside).sum()
            }
        }
    }

    /// The smallest box around everything.
    pub fn bounds(&self) -> Bounds {
        let children = self.nodes.first().into_iter().flat_map(Node::children);
        children.fold(Bounds::EMPTY, |all, (bounds, _)| all.union(bounds))
    }

    /// Up to 64 boxes that hold everything: they bound a turned placement more tightly than one.
    fn outline(&self) -> Vec<Bounds> {
        let children = self.nodes.first().into_iter().flat_map(Node::children);
        let open = |(bounds, link): (Bounds, u32)| -> Vec<Bounds> {
            if link & LEAF != 0 {
                return vec![bounds];
            }
            self.nodes[link as usize].children().map(|(bounds, _)| bounds).collect()
        };
        children.flat_map(open).collect()
    }

    /// Memory of nodes, triangles and placements, bytes.
    pub fn bytes(&self) -> u64 {
        let content = match &self.content {
            Content::Mesh { blocks, faces, .. } => size_of_val(&blocks[..]) + size_of_val(&faces[..]),
            Content::Group { instances, plants } => {
                size_of_val(&instances[..]) + size_of_val(&plants[..])
            }
        };
        (size_of_val(&self.nodes[..]) + content) as u64
    }
}
