//! A level: a tree over triangles or over placements of another level.

use super::Bounds;
use super::braid::opened;
use super::build::{Wide, build, widen};
use super::lanes::{LEAF, LocalRay};
use super::split::{Pieces, split};
use super::tight::Nodes;
use crate::paint::Charts;
use crate::primitive::Face;
use glam::{Mat3A, Quat, Vec3, Vec3A};

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
    /// Index of each triangle's face; [`HALF`] is set where the parallelogram is meant, [`CUT`]
    /// where a texture decides whether there is anything, [`AGAIN`] where another lane has it too.
    pub face: [u32; 8],
}

/// Bit of a face's index that marks a parallelogram: the sign, by which vectors blend.
pub(crate) const HALF: u32 = 1 << 31;

/// Bit of a face's index that says that parts of it are cut out.
pub(crate) const CUT: u32 = 1 << 30;

/// Bit of a face's index that marks the further pieces of a triangle that hangs in several leaves.
const AGAIN: u32 = 1 << 29;

/// The face's index itself.
pub(crate) const FACE: u32 = AGAIN - 1;

/// A placement: scaled, then rotated, then moved. 28 bytes; scenes have millions.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Instance {
    position: [f32; 3],
    scale: f32,
    /// Rotation: a quaternion x, y, z, w of any length, which bends the direction that the plant's
    /// file asks for by less than 0.003°, a millimetre at the top of a tree.
    rotation: [i16; 4],
    /// Number of the level that is placed.
    pub level: u32,
}

/// A tree and what hangs in it.
pub(crate) struct Level {
    pub nodes: Nodes,
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
        plants: Plants,
        /// What each leaf holds: an instance, and the node of its level where it begins; empty
        /// when leaf number `i` is all of instance number `i`.
        parts: Vec<Part>,
    },
}

/// A part of an instance: what hangs below a node of its level.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Part {
    pub instance: u32,
    pub root: u32,
}

/// Numbers of plants, in as many bytes as they need.
pub(crate) enum Plants {
    /// Numbers of 32 bits, or of 64 bits whose upper halves are few, as those of a step of ecosim
    /// are: the lower halves, and for each the number of its upper half.
    Narrow { low: Vec<u32>, upper: Vec<u8>, halves: Vec<u32> },
    /// Any numbers.
    Wide(Vec<u64>),
}

impl Plants {
    fn new(plants: Vec<u64>) -> Self {
        let half = |plant: &u64| (plant >> 32) as u32;
        let mut halves: Vec<u32> = Vec::new();
        for plant in &plants {
            if let Err(place) = halves.binary_search(&half(plant)) {
                halves.insert(place, half(plant));
            }
            if halves.len() > 256 {
                return Self::Wide(plants);
            }
        }
        let low = plants.iter().map(|&plant| plant as u32).collect();
        let number = |plant: &u64| halves.partition_point(|&known| known < half(plant)) as u8;
        let upper = if halves.len() > 1 { plants.iter().map(number).collect() } else { Vec::new() };
        Self::Narrow { low, upper, halves }
    }

    /// The plant of an instance.
    pub fn of(&self, instance: usize) -> u64 {
        match self {
            Self::Narrow { low, upper, halves } => {
                let upper = upper.get(instance).map_or(0, |&number| usize::from(number));
                u64::from(halves[upper]) << 32 | u64::from(low[instance])
            }
            Self::Wide(plants) => plants[instance],
        }
    }

    fn bytes(&self) -> usize {
        match self {
            Self::Narrow { low, upper, .. } => size_of_val(&low[..]) + upper.len(),
            Self::Wide(plants) => size_of_val(&plants[..]),
        }
    }
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
    pub fn joined(&self, other: &Triangle, charts: &mut Charts) -> Option<Triangle> {
        // The corner that the other lacks comes first, so that the shared edge lies opposite.
        let turn = (0..3).find(|&i| !other.corners.contains(&self.corners[i]))?;
        let [a, b, c] = [0, 1, 2].map(|i| self.corners[(turn + i) % 3]);
        let far = (0..3).find(|&i| other.corners[i] != b && other.corners[i] != c)?;
        let [d, e, f] = [0, 1, 2].map(|i| other.corners[(far + i) % 3]);
        let rounding = 2.0 * f32::EPSILON * (a.abs() + b.abs() + c.abs() + d.abs()).max_element();
        let slack = rounding + 1e-5 * (b - a).abs().max((c - a).abs()).max_element();
        let is_whole = (e, f) == (c, b) && (b + c - a - d).abs().max_element() <= slack;
        let (face, beyond) = (self.face.rotated(turn), other.face.rotated(far));
        if !is_whole || self.is_half || other.is_half || !face.continues(&beyond) {
            return None;
        }
        let face = match (face.chart(), beyond.chart()) {
            (None, None) => face,
            (Some(chart), Some(beyond)) => {
                let (chart, beyond) = (charts.turn(chart, turn), charts.turn(beyond, far));
                if !charts.continues(chart, beyond) {
                    return None;
                }
                face.on_chart(chart, face.is_cut())
            }
            _ => return None,
        };
        Some(Triangle { corners: [a, b, c], face, is_half: true })
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

/// Joins neighbours in a list into parallelograms; faces lie on `charts`.
pub(crate) fn join_pairs(triangles: &[Triangle], charts: &mut Charts) -> Vec<Triangle> {
    let mut joined = Vec::with_capacity(triangles.len());
    let mut rest = triangles;
    while let [first, tail @ ..] = rest {
        let whole = tail.first().and_then(|second| first.joined(second, charts));
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

    /// The triangles inside, but for further pieces. Lanes are filled from the first on, and each
    /// face is used once.
    fn unpack(&self, faces: &[Face]) -> Vec<Triangle> {
        let number = |lane: usize| self.face[lane] & FACE;
        let is_used = |&lane: &usize| lane == 0 || number(lane) > number(lane - 1);
        let triangle = |lane: usize| {
            let corner = Vec3::from_array([0, 1, 2].map(|axis| self.corner[axis][lane]));
            let (edge_1, edge_2) = self.edges(lane);
            let corners = [corner, corner + edge_1, corner + edge_2];
            let is_half = self.face[lane] & HALF != 0;
            Triangle { corners, face: faces[number(lane) as usize], is_half }
        };
        let is_first = |&lane: &usize| self.face[lane] & AGAIN == 0;
        (0..BLOCK_SIZE).take_while(is_used).filter(is_first).map(triangle).collect()
    }

    /// A block of triangles, the index of the face of each, and whether it is a further piece.
    fn pack(triangles: impl Iterator<Item = (Triangle, u32, bool)>) -> Self {
        let mut block = EMPTY_BLOCK;
        for (lane, (triangle, face, is_again)) in triangles.enumerate() {
            let [a, b, c] = triangle.corners;
            for axis in 0..3 {
                block.corner[axis][lane] = a[axis];
                block.edge_1[axis][lane] = b[axis] - a[axis];
                block.edge_2[axis][lane] = c[axis] - a[axis];
            }
            let flag = |is_set: bool, bit: u32| if is_set { bit } else { 0 };
            let cut = flag(triangle.face.is_cut(), CUT);
            let again = flag(is_again, AGAIN);
            block.face[lane] = face | flag(triangle.is_half, HALF) | cut | again;
        }
        block
    }
}

impl Instance {
    /// A placement of a level by a unit quaternion x, y, z, w, a scale and a position.
    pub fn new(rotation: [f32; 4], scale: f32, position: [f32; 3], level: u32) -> Self {
        // The largest component gets all of its 16 bits, and so do the others.
        let largest = rotation.iter().fold(0.0f32, |most, c| most.max(c.abs()));
        let rotation = rotation.map(|c| (c / largest * f32::from(i16::MAX)).round() as i16);
        Self { position, scale, rotation, level }
    }

    /// The axis and the cosine of half the angle, both as long as the quaternion, and 2 over its
    /// squared length.
    #[inline(always)]
    fn rotation(&self) -> (Vec3, f32, f32) {
        let [x, y, z, w] = self.rotation.map(f32::from);
        (Vec3::new(x, y, z), w, 2.0 / ((x * x + y * y) + (z * z + w * w)))
    }

    /// Takes a ray into the space of what is placed; `t` keeps its meaning.
    #[inline(always)]
    pub fn enter(&self, ray: &LocalRay) -> LocalRay {
        let (axis, w, gain) = self.rotation();
        let shrink = 1.0 / self.scale;
        let turn = |v: Vec3| rotate(axis, -w, gain, v) * shrink;
        let origin = turn(ray.origin - Vec3::from_array(self.position));
        LocalRay::new(origin, turn(ray.direction))
    }

    /// Turn, scale and position of what is placed.
    pub fn pose(&self) -> (Quat, f32, Vec3) {
        let turn = Quat::from_array(self.rotation.map(f32::from)).normalize();
        (turn, self.scale, Vec3::from_array(self.position))
    }

    /// Its scale.
    pub fn scale(&self) -> f32 {
        self.scale
    }

    /// Turns a direction from the space of what is placed into the space of the placement.
    pub fn turn(&self, direction: Vec3) -> Vec3 {
        let (axis, w, gain) = self.rotation();
        rotate(axis, w, gain, direction)
    }

    /// A point of what is placed, in the space of the placement.
    pub fn carry_point(&self, point: Vec3) -> Vec3 {
        self.turn(point) * self.scale + Vec3::from_array(self.position)
    }

    /// A triangle of what is placed, in the space of the placement.
    fn carry(&self, triangle: Triangle) -> Triangle {
        let corners = triangle.corners.map(|corner| self.carry_point(corner));
        Triangle { corners, face: triangle.face.turned(|normal| self.turn(normal)), ..triangle }
    }

    /// Box of boxes that are placed together.
    pub fn place(&self, boxes: &[Bounds]) -> Bounds {
        let column = |axis: Vec3| Vec3A::from(self.turn(axis) * self.scale);
        let matrix = Mat3A::from_cols(column(Vec3::X), column(Vec3::Y), column(Vec3::Z));
        let place = |bounds: &Bounds| self.place_one(bounds, &matrix);
        boxes.iter().map(place).fold(Bounds::EMPTY, Bounds::union)
    }

    fn place_one(&self, bounds: &Bounds, matrix: &Mat3A) -> Bounds {
        let center = *matrix * bounds.center() + Vec3A::from_array(self.position);
        let half = 0.5 * (bounds.high - bounds.low);
        let reach = matrix.x_axis.abs() * half.x
            + matrix.y_axis.abs() * half.y
            + matrix.z_axis.abs() * half.z;
        // Rounding of the transform, here and in `enter`, must not move geometry out of its box.
        let slack = 4.0 * f32::EPSILON * (center.abs() + reach);
        Bounds { low: center - reach - slack, high: center + reach + slack }
    }
}

/// Rotation of a vector by a quaternion of any length; `gain` is 2 over its squared length.
#[inline(always)]
fn rotate(axis: Vec3, w: f32, gain: f32, v: Vec3) -> Vec3 {
    let aside = gain * axis.cross(v);
    v + w * aside + axis.cross(aside)
}

impl Level {
    /// A mesh. Faces are stored in the order of leaves, so that neighbours share cache lines.
    pub fn mesh(triangles: &[Triangle]) -> Self {
        let Pieces { boxes, owners } = split(triangles);
        let tree = build(&boxes, BLOCK_SIZE);
        let Wide { nodes, leaves } = widen(&tree, BLOCK_SIZE);
        let faces = leaves.iter().flat_map(|&(first, count)| first..first + count);
        let faces: Vec<Face> = faces
            .map(|item| triangles[owners[tree.order[item as usize] as usize] as usize].face)
            .collect();
        let mut next = 0;
        let starts = leaves.iter().map(|&(first, count)| {
            next += count;
            (first, count, next - count)
        });
        let mut is_packed = vec![false; triangles.len()];
        let blocks = starts
            .map(|(first, count, face)| {
                let items = &tree.order[first as usize..(first + count) as usize];
                Block::pack(items.iter().zip(face..).map(|(&item, face)| {
                    let owner = owners[item as usize] as usize;
                    let is_again = std::mem::replace(&mut is_packed[owner], true);
                    (triangles[owner], face, is_again)
                }))
            })
            .collect();
        let count = triangles.iter().map(Triangle::count).sum();
        Self { nodes: Nodes::Wide(nodes), content: Content::Mesh { blocks, faces, count } }
    }

    /// A group of placements of `levels`, each with the plant that it stands for.
    ///
    /// Placements of empty levels are left out.
    pub fn group(placed: &[(Instance, u64)], levels: &[Level]) -> Self {
        let is_something =
            |(instance, _): &&(Instance, u64)| !levels[instance.level as usize].nodes.is_empty();
        let placed: Vec<(Instance, u64)> = placed.iter().filter(is_something).copied().collect();
        let (parts, boxes) = opened(&placed, levels);
        let tree = build(&boxes, 1);
        drop(boxes);
        let Wide { nodes, leaves } = widen(&tree, 1);
        let nodes = Nodes::over(nodes, placed.len());
        let in_order = leaves.iter().map(|&(first, _)| tree.order[first as usize] as usize);
        if parts.iter().all(|part| part.root == 0) {
            // Nothing is opened: instances go in the order of leaves, for their neighbours' sake.
            let (instances, plants) = in_order.map(|item| placed[item]).unzip();
            let plants = Plants::new(plants);
            return Self {
                nodes,
                content: Content::Group { instances, plants, parts: Vec::new() },
            };
        }
        // Instances in the order in which leaves first speak of them.
        let mut numbers = vec![u32::MAX; placed.len()];
        let (mut instances, mut plants) = (Vec::new(), Vec::new());
        let renumbered = in_order.map(|item| {
            let part = parts[item];
            let number = &mut numbers[part.instance as usize];
            if *number == u32::MAX {
                *number = instances.len() as u32;
                let (instance, plant) = placed[part.instance as usize];
                instances.push(instance);
                plants.push(plant);
            }
            Part { instance: *number, root: part.root }
        });
        let parts = renumbered.collect();
        let plants = Plants::new(plants);
        Self { nodes, content: Content::Group { instances, plants, parts } }
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
        self.nodes.children(0).into_iter().fold(Bounds::EMPTY, |all, (bounds, _)| all.union(bounds))
    }

    /// Up to 64 boxes that hold everything below a node: they bound a turned placement more
    /// tightly than one.
    pub fn outline(&self, root: u32) -> Vec<Bounds> {
        let open = |(bounds, link): (Bounds, u32)| -> Vec<Bounds> {
            if link & LEAF != 0 {
                return vec![bounds];
            }
            self.nodes.children(link).into_iter().map(|(bounds, _)| bounds).collect()
        };
        self.nodes.children(root).into_iter().flat_map(open).collect()
    }

    /// Memory of nodes, triangles and placements, bytes.
    pub fn bytes(&self) -> u64 {
        let content = match &self.content {
            Content::Mesh { blocks, faces, .. } => {
                size_of_val(&blocks[..]) + size_of_val(&faces[..])
            }
            Content::Group { instances, plants, parts } => {
                size_of_val(&instances[..]) + plants.bytes() + size_of_val(&parts[..])
            }
        };
        (self.nodes.bytes() + content) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn a_triangle_that_hangs_in_several_leaves_comes_back_once() {
        // Needles aslant are cut into pieces.
        let mut chance = Seed(8).stream("needles", 0);
        let mut point = |reach: f64| Vec3::from([0; 3].map(|_| chance.around(0.0, reach) as f32));
        let needles: Vec<Triangle> = (0..500)
            .map(|_| {
                let (a, along, aside) = (point(1.0), point(1.0), point(0.01));
                Triangle::new([a, a + along, a + aside], Face::new([Vec3::Z; 3], 0))
            })
            .collect();
        let level = Level::mesh(&needles);
        let Content::Mesh { faces, .. } = &level.content else { panic!("it is a mesh") };
        assert!(faces.len() > 550, "{} pieces", faces.len());
        let back = level.triangles(&[]);
        assert_eq!(back.len(), 500);
        assert_eq!(Level::mesh(&back).triangle_count(&[]), 500);
    }

    #[test]
    fn numbers_of_plants_come_back_in_whatever_form_they_are_kept() {
        let few: Vec<u64> = (0..1000).map(|i| ((i % 7) << 45) + i * 3).collect();
        let many: Vec<u64> = (0..1000).map(|i| (i << 40) + 5).collect();
        for (numbers, bytes) in [((0..1000).collect(), 4000), (few, 5000), (many, 8000)] {
            let plants = Plants::new(numbers.clone());
            assert_eq!(plants.bytes(), bytes);
            assert!(numbers.iter().enumerate().all(|(i, &number)| plants.of(i) == number));
        }
    }
}
