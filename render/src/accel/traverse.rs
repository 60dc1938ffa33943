//! Walking a ray through nested levels.

use super::Bounds;
use super::lanes::{LEAF, LaneHits, Lanes, LocalRay, Portable};
use super::level::{Block, CUT, Content, FACE, Instance, Level, Part, Triangle};
use super::tight::{Branch, Nodes};
use crate::paint::Paints;
use crate::primitive::Face;
use glam::Vec3;

/// Placements between the scene and a triangle.
pub(crate) const MAX_DEPTH: usize = 8;

/// A ray; points on it are `origin + t * direction`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Ray {
    pub origin: Vec3,
    pub direction: Vec3,
}

/// What a ray met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Hit {
    /// Ray parameter.
    pub t: f32,
    /// Barycentric weights of the second and third corner.
    pub u: f32,
    pub v: f32,
    /// Level of the mesh.
    level: u32,
    /// Block and lane: `8 * block + lane`.
    triangle: u32,
    /// Placements from the scene down to the mesh, as leaf numbers.
    path: [u32; MAX_DEPTH],
    depth: u32,
}

impl Hit {
    /// Nothing met yet, looking no farther than `limit`.
    pub fn none(limit: f32) -> Self {
        Self { t: limit, u: 0.0, v: 0.0, level: NONE, triangle: 0, path: [0; MAX_DEPTH], depth: 0 }
    }

    /// Whether something was met.
    pub fn is_some(&self) -> bool {
        self.level != NONE
    }
}

const NONE: u32 = u32::MAX;

/// What is known of the place that a ray met.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Place {
    /// Unit normal of the triangle, to the side from which its corners run counter-clockwise.
    pub geometric: Vec3,
    /// Unit normal interpolated between the corners.
    pub shading: Vec3,
    /// Material and colour of the triangle.
    pub face: Face,
    /// Barycentric weights of the second and third corner.
    pub weights: [f32; 2],
    /// Area of the parallelogram of which the triangle is half, m².
    pub area: f32,
    /// Plant of the outermost placement, 0 for none.
    pub plant: u64,
}

/// Memory of a walk, kept between rays so that none of them allocates.
#[derive(Debug)]
pub(crate) struct Scratch {
    stack: Box<[Entry; STACK]>,
}

impl Default for Scratch {
    fn default() -> Self {
        Self { stack: Box::new([Entry { link: 0, t: 0.0 }; STACK]) }
    }
}

/// Subtrees that may wait at once, a power of two: binary trees are at most 80 deep (see `build`),
/// each of their levels leaves seven siblings waiting at most, and nine trees may be nested.
const STACK: usize = 8192;

/// A subtree that is still to be walked.
#[derive(Clone, Copy, Debug)]
struct Entry {
    link: u32,
    /// Where the ray enters its box.
    t: f32,
}

/// All levels of a scene; each refers only to those before it.
pub(crate) struct Levels {
    list: Vec<Level>,
    /// What faces are painted with, and where they are cut out.
    pub paints: Paints,
    has_avx2: bool,
}

impl Levels {
    /// Levels in an order in which each comes after those it places.
    ///
    /// # Panics
    /// When a level places itself or a later one, or nests deeper than [`MAX_DEPTH`].
    pub fn new(list: Vec<Level>) -> Self {
        let mut depths = Vec::with_capacity(list.len());
        for (number, level) in list.iter().enumerate() {
            let depth = match &level.content {
                Content::Mesh { .. } => 0,
                Content::Group { instances, .. } => {
                    let below = |instance: &Instance| {
                        assert!((instance.level as usize) < number, "levels are out of order");
                        depths[instance.level as usize] + 1
                    };
                    instances.iter().map(below).max().unwrap_or(0)
                }
            };
            assert!(depth <= MAX_DEPTH, "levels nest too deep");
            depths.push(depth);
        }
        #[cfg(target_arch = "x86_64")]
        let has_avx2 = std::arch::is_x86_feature_detected!("avx2");
        #[cfg(not(target_arch = "x86_64"))]
        let has_avx2 = false;
        Self { list, paints: Paints::default(), has_avx2 }
    }

    /// The same levels with what their faces are painted with.
    pub fn painted(self, paints: Paints) -> Self {
        Self { paints, ..self }
    }

    /// The same levels, walked by plain loops.
    #[cfg(test)]
    pub fn portable(mut self) -> Self {
        self.has_avx2 = false;
        self
    }

    /// Number of levels.
    pub fn len(&self) -> usize {
        self.list.len()
    }

    /// What the leaves of a level hold.
    pub fn content(&self, level: u32) -> &Content {
        &self.list[level as usize].content
    }

    /// Triangles of a level, each at every place.
    pub fn count(&self, level: u32) -> u128 {
        self.list[level as usize].triangle_count(&self.list)
    }

    /// All triangles of a level, brought to where its placements put them.
    pub fn triangles(&self, level: u32) -> Vec<Triangle> {
        self.list[level as usize].triangles(&self.list)
    }

    /// The smallest box around a level.
    pub fn bounds(&self, level: u32) -> Bounds {
        self.list[level as usize].bounds()
    }

    /// The nearest thing that the ray meets in `level` before `limit`.
    pub fn nearest(&self, level: u32, ray: &Ray, limit: f32, scratch: &mut Scratch) -> Hit {
        let mut hit = Hit::none(limit);
        self.start::<false>(level, ray, &mut hit, scratch);
        hit
    }

    /// Whether the ray meets anything in `level` before `limit`.
    pub fn is_blocked(&self, level: u32, ray: &Ray, limit: f32, scratch: &mut Scratch) -> bool {
        self.start::<true>(level, ray, &mut Hit::none(limit), scratch)
    }

    fn start<const ANY: bool>(
        &self,
        level: u32,
        ray: &Ray,
        hit: &mut Hit,
        scratch: &mut Scratch,
    ) -> bool {
        let ray = LocalRay::new(ray.origin, ray.direction);
        let mut walk = Walk {
            levels: &self.list,
            paints: &self.paints,
            path: [0; MAX_DEPTH],
            hit,
            stack: &mut scratch.stack,
            top: 0,
        };
        #[cfg(target_arch = "x86_64")]
        if self.has_avx2 {
            // SAFETY: `has_avx2` is only set when the processor says so.
            return unsafe { avx2::descend::<ANY>(&mut walk, level, 0, &ray, 0) };
        }
        // SAFETY: plain loops need no feature.
        unsafe { walk_level::<Portable, ANY>(&mut walk, level, 0, &ray, 0, portable::<ANY>) }
    }

    /// What lies where a ray met something.
    pub fn place(&self, root: u32, hit: &Hit) -> Place {
        let mut chain = [None; MAX_DEPTH];
        let (mut level, mut plant) = (root, 0);
        let steps = chain.iter_mut().zip(hit.path).take(hit.depth as usize);
        for (number, (step, index)) in steps.enumerate() {
            let Content::Group { instances, plants, .. } = &self.list[level as usize].content
            else {
                break;
            };
            let instance = &instances[index as usize];
            if number == 0 {
                plant = plants.of(index as usize);
            }
            *step = Some(instance);
            level = instance.level;
        }
        let mesh = &self.list[hit.level as usize];
        let (face, edges) = mesh.triangle(hit.triangle);
        let out = |normal: Vec3| {
            let inner_first = chain.iter().flatten().rev();
            let turned = inner_first.fold(normal, |normal, instance| instance.turn(normal));
            turned.normalize_or(Vec3::Z)
        };
        let scale: f32 = chain.iter().flatten().map(|instance| instance.scale()).product();
        let across = edges.0.cross(edges.1);
        Place {
            geometric: out(across.normalize_or(Vec3::Z)),
            shading: out(face.normal(hit.u, hit.v)),
            face,
            weights: [hit.u, hit.v],
            area: across.length() * scale * scale,
            plant,
        }
    }
}

impl Level {
    /// Face and edges of the triangle with this number.
    fn triangle(&self, number: u32) -> (Face, (Vec3, Vec3)) {
        let (block, lane) = (number as usize / 8, number as usize % 8);
        match &self.content {
            Content::Mesh { blocks, faces, .. } => {
                let block: &Block = &blocks[block];
                (faces[(block.face[lane] & FACE) as usize], block.edges(lane))
            }
            Content::Group { .. } => (Face::default(), (Vec3::X, Vec3::Y)),
        }
    }
}

/// State of a walk.
struct Walk<'a> {
    levels: &'a [Level],
    paints: &'a Paints,
    path: [u32; MAX_DEPTH],
    hit: &'a mut Hit,
    stack: &'a mut [Entry; STACK],
    /// Entries on the stack.
    top: usize,
}

impl Walk<'_> {
    /// The place of an entry; never out of range, and so not looked at twice.
    #[inline(always)]
    fn at(&mut self, index: usize) -> &mut Entry {
        &mut self.stack[index & (STACK - 1)]
    }

    /// Pushes a child that was hit.
    #[inline(always)]
    fn push(&mut self, link: u32, t: f32) {
        let top = self.top;
        *self.at(top) = Entry { link, t };
        self.top += 1;
    }

    /// Takes the next subtree that begins before the nearest hit so far, above `base`.
    #[inline(always)]
    fn pop(&mut self, base: usize) -> Option<u32> {
        while self.top > base {
            self.top -= 1;
            let top = self.top;
            let entry = *self.at(top);
            if entry.t < self.hit.t {
                return Some(entry.link);
            }
        }
        None
    }
}

/// Walks a level that an instance leads to, compiled for the same processor features.
type Descend = unsafe fn(&mut Walk<'_>, u32, u32, &LocalRay, usize) -> bool;

unsafe fn portable<const ANY: bool>(
    walk: &mut Walk<'_>,
    level: u32,
    root: u32,
    ray: &LocalRay,
    depth: usize,
) -> bool {
    // SAFETY: plain loops need no feature.
    unsafe { walk_level::<Portable, ANY>(walk, level, root, ray, depth, portable::<ANY>) }
}

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{LocalRay, Walk, walk_level};
    use crate::accel::lanes::Avx2;

    /// The walk compiled with AVX2.
    ///
    /// # Safety
    /// The processor has AVX2.
    #[target_feature(enable = "avx2")]
    pub(super) unsafe fn descend<const ANY: bool>(
        walk: &mut Walk<'_>,
        level: u32,
        root: u32,
        ray: &LocalRay,
        depth: usize,
    ) -> bool {
        // SAFETY: the caller promises AVX2.
        unsafe { walk_level::<Avx2, ANY>(walk, level, root, ray, depth, descend::<ANY>) }
    }
}

/// Walks what hangs below a node of a level; returns whether something was met when `ANY` is set.
///
/// # Safety
/// The processor has the features that `L` needs.
#[inline(always)]
unsafe fn walk_level<L: Lanes, const ANY: bool>(
    walk: &mut Walk<'_>,
    number: u32,
    root: u32,
    ray: &LocalRay,
    depth: usize,
    descend: Descend,
) -> bool {
    let levels = walk.levels;
    let level = &levels[number as usize];
    match &level.content {
        Content::Mesh { blocks, faces, .. } => {
            let leaf = |walk: &mut Walk<'_>, leaf: u32| {
                let block = &blocks[leaf as usize];
                // SAFETY: the caller vouches for the features.
                let mut found = unsafe { L::triangles(block, ray, walk.hit.t) };
                if found.mask != 0 {
                    cut_out(walk.paints, &mut found, block, faces);
                    record(walk, &found, number, leaf, depth);
                }
                found.mask != 0
            };
            let Nodes::Wide(nodes) = &level.nodes else { return false };
            // SAFETY: as above.
            unsafe { walk_tree::<L, _, _, ANY>(walk, root, nodes, blocks, ray, leaf) }
        }
        Content::Group { instances, parts, .. } => {
            let leaf = |walk: &mut Walk<'_>, leaf: u32| {
                let part =
                    parts.get(leaf as usize).copied().unwrap_or(Part { instance: leaf, root: 0 });
                let instance = &instances[part.instance as usize];
                walk.path[depth] = part.instance;
                let local = instance.enter(ray);
                // SAFETY: `descend` needs the same features as this walk.
                unsafe { descend(walk, instance.level, part.root, &local, depth + 1) }
            };
            match &level.nodes {
                // SAFETY: as above.
                Nodes::Wide(nodes) => unsafe {
                    walk_tree::<L, _, _, ANY>(walk, root, nodes, instances, ray, leaf)
                },
                // SAFETY: as above.
                Nodes::Tight(nodes) => unsafe {
                    walk_tree::<L, _, _, ANY>(walk, root, nodes, instances, ray, leaf)
                },
            }
        }
    }
}

/// Walks a tree; `leaves` are only asked for ahead of time, `visit` looks at them.
///
/// # Safety
/// The processor has the features that `L` needs.
#[inline(always)]
unsafe fn walk_tree<L: Lanes, N: Branch, T, const ANY: bool>(
    walk: &mut Walk<'_>,
    root: u32,
    nodes: &[N],
    leaves: &[T],
    ray: &LocalRay,
    visit: impl Fn(&mut Walk<'_>, u32) -> bool,
) -> bool {
    if nodes.is_empty() {
        return false;
    }
    // Entries of the levels above lie below this one and stay untouched.
    let base = walk.top;
    let mut link = root;
    loop {
        if link & LEAF != 0 {
            if visit(walk, link & !LEAF) && ANY {
                return true;
            }
        } else {
            let node = &nodes[link as usize];
            // SAFETY: the caller vouches for the features.
            let boxes = unsafe { node.boxes::<L>(ray, walk.hit.t) };
            if boxes.mask != 0 {
                link = nearest_child(walk, nodes, leaves, &boxes, node);
                continue;
            }
        }
        match walk.pop(base) {
            Some(next) => link = next,
            None => return false,
        }
    }
}

/// The nearest of the children that were hit; the others wait, the farthest at the bottom. Any
/// hit will do for a shadow, yet near ones are the likelier occluders.
#[inline(always)]
fn nearest_child<N: Branch, T>(
    walk: &mut Walk<'_>,
    nodes: &[N],
    leaves: &[T],
    boxes: &LaneHits,
    node: &N,
) -> u32 {
    let mut mask = boxes.mask;
    let mut take = || {
        let lane = mask.trailing_zeros() as usize & 7;
        mask &= mask - 1;
        (node.link(lane), boxes.t[lane], mask)
    };
    let (first, first_t, rest) = take();
    fetch_ahead(nodes, leaves, first);
    if rest == 0 {
        return first;
    }
    let (second, second_t, rest) = take();
    fetch_ahead(nodes, leaves, second);
    let (mut near, mut near_t) = (first, first_t);
    let bottom = walk.top;
    if second_t < first_t {
        walk.push(first, first_t);
        (near, near_t) = (second, second_t);
    } else {
        walk.push(second, second_t);
    }
    let mut rest = rest;
    while rest != 0 {
        let (link, t, left) = take();
        rest = left;
        fetch_ahead(nodes, leaves, link);
        let (link, t) = if t < near_t {
            (std::mem::replace(&mut near, link), std::mem::replace(&mut near_t, t))
        } else {
            (link, t)
        };
        // Insertion sort: two or three children are hit on average.
        walk.push(link, t);
        let mut slot = walk.top - 1;
        while slot > bottom && walk.at(slot - 1).t < t {
            *walk.at(slot) = *walk.at(slot - 1);
            slot -= 1;
        }
        *walk.at(slot) = Entry { link, t };
    }
    near
}

/// Asks for the memory of a child that will be walked soon: waiting for it is a third of the time
/// of a walk through leaves.
#[inline(always)]
fn fetch_ahead<N, T>(nodes: &[N], leaves: &[T], link: u32) {
    let index = (link & !LEAF) as usize;
    if link & LEAF == 0 { touch(nodes, index) } else { touch(leaves, index) }
}

/// Asks for the cache lines of an element.
#[inline(always)]
fn touch<T>(list: &[T], index: usize) {
    #[cfg(target_arch = "x86_64")]
    if let Some(element) = list.get(index) {
        use std::arch::x86_64::{_MM_HINT_T0, _mm_prefetch};
        let start = std::ptr::from_ref(element).cast::<i8>();
        for line in 0..size_of::<T>().div_ceil(64) {
            // SAFETY: a prefetch reads nothing; the address is inside the element.
            unsafe { _mm_prefetch::<_MM_HINT_T0>(start.add(64 * line)) };
        }
    }
    #[cfg(not(target_arch = "x86_64"))]
    let _ = (list, index);
}

/// Forgets what was met where it is cut out.
#[inline(always)]
fn cut_out(paints: &Paints, found: &mut super::lanes::TriangleHits, block: &Block, faces: &[Face]) {
    let mut mask = found.mask;
    while mask != 0 {
        let lane = mask.trailing_zeros() as usize & 7;
        mask &= mask - 1;
        let number = block.face[lane];
        if number & CUT != 0
            && let Some(chart) = faces[(number & FACE) as usize].chart()
            && !paints.is_there(chart, found.u[lane], found.v[lane])
        {
            found.mask &= !(1 << lane);
        }
    }
}

/// Keeps the nearest of the triangles that were met.
#[inline(always)]
fn record(
    walk: &mut Walk<'_>,
    found: &super::lanes::TriangleHits,
    level: u32,
    block: u32,
    depth: usize,
) {
    let mut mask = found.mask;
    while mask != 0 {
        let lane = mask.trailing_zeros() as usize;
        mask &= mask - 1;
        if found.t[lane] < walk.hit.t {
            *walk.hit = Hit {
                t: found.t[lane],
                u: found.u[lane],
                v: found.v[lane],
                level,
                triangle: 8 * block + lane as u32,
                path: walk.path,
                depth: depth as u32,
            };
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::level::HALF;
    use super::super::{Triangle, join_pairs};
    use super::*;
    use crate::paint::Charts;
    use glam::Quat;
    use weald_contract::{Seed, seed::Stream};

    fn point(chance: &mut Stream, reach: f64) -> Vec3 {
        Vec3::from_array([0; 3].map(|_| chance.range(-reach, reach) as f32))
    }

    fn direction(chance: &mut Stream) -> Vec3 {
        Vec3::from_array([0; 3].map(|_| chance.normal() as f32)).normalize()
    }

    fn triangles(chance: &mut Stream, count: usize, size: f64) -> Vec<Triangle> {
        let one = |chance: &mut Stream| {
            let a = point(chance, 1.0);
            let corners = [a, a + point(chance, size), a + point(chance, size)];
            Triangle::new(corners, Face::default())
        };
        (0..count).map(|_| one(chance)).collect()
    }

    fn placements(chance: &mut Stream, count: usize, levels: u64) -> Vec<(Instance, u64)> {
        let one = |plant: usize| {
            let axis = direction(chance);
            let turn = Quat::from_axis_angle(axis, chance.range(0.0, 6.0) as f32);
            let position = point(chance, 10.0).to_array();
            let scale = chance.range(0.3, 2.0) as f32;
            let level = chance.below(levels) as u32;
            let instance = Instance::new(turn.to_array(), scale, position, level);
            (instance, plant as u64)
        };
        (0..count).map(one).collect()
    }

    /// Every triangle of a level brought into its space, by walking all placements.
    fn flatten(levels: &[Level], level: usize) -> Vec<[Vec3; 3]> {
        match &levels[level].content {
            Content::Mesh { blocks, .. } => {
                // Unused lanes hold a point, which no ray meets.
                let lanes = 0..8 * blocks.len();
                let corners = |i: usize| {
                    let (block, lane) = (&blocks[i / 8], i % 8);
                    let a = Vec3::from_array([0, 1, 2].map(|axis| block.corner[axis][lane]));
                    let (edge_1, edge_2) = block.edges(lane);
                    let (b, c) = (a + edge_1, a + edge_2);
                    let is_half = block.face[lane] & HALF != 0;
                    std::iter::once([a, b, c]).chain(is_half.then_some([b + edge_2, c, b]))
                };
                lanes.flat_map(corners).collect()
            }
            Content::Group { instances, .. } => {
                let place = |instance: &Instance| {
                    let out = |p: Vec3| instance.carry_point(p);
                    let inner = flatten(levels, instance.level as usize);
                    inner.into_iter().map(|corners| corners.map(out)).collect::<Vec<_>>()
                };
                instances.iter().flat_map(place).collect()
            }
        }
    }

    /// Plain test of every triangle, in double precision.
    fn brute_force(triangles: &[[Vec3; 3]], ray: &Ray) -> f64 {
        let (o, d) = (ray.origin.as_dvec3(), ray.direction.as_dvec3());
        let test = |corners: &[Vec3; 3]| {
            let [a, b, c] = corners.map(|corner| corner.as_dvec3());
            let p = d.cross(c - a);
            let inverse = 1.0 / (b - a).dot(p);
            let s = o - a;
            let q = s.cross(b - a);
            let (u, v, t) = (s.dot(p) * inverse, d.dot(q) * inverse, (c - a).dot(q) * inverse);
            (u >= 0.0 && v >= 0.0 && u + v <= 1.0 && t > 0.0).then_some(t)
        };
        triangles.iter().filter_map(test).fold(f64::INFINITY, f64::min)
    }

    /// Scene of three levels of nesting.
    fn nested(chance: &mut Stream) -> Vec<Level> {
        let mut levels: Vec<Level> =
            (0..3).map(|_| Level::mesh(&triangles(chance, 60, 0.4))).collect();
        let group = Level::group(&placements(chance, 9, 3), &levels);
        levels.push(group);
        let top = Level::group(&placements(chance, 12, 4), &levels);
        levels.push(top);
        levels
    }

    #[test]
    fn nested_instances_are_met_where_brute_force_meets_them() {
        let mut chance = Seed(11).stream("nested", 0);
        for _ in 0..4 {
            let levels = nested(&mut chance);
            let top = levels.len() - 1;
            let flat = flatten(&levels, top);
            let levels = Levels::new(levels);
            let mut scratch = Scratch::default();
            let mut differing = 0;
            for _ in 0..500 {
                let origin = point(&mut chance, 30.0);
                let ray = Ray { origin, direction: (point(&mut chance, 8.0) - origin).normalize() };
                let hit = levels.nearest(top as u32, &ray, f32::INFINITY, &mut scratch);
                let truth = brute_force(&flat, &ray);
                let blocked = levels.is_blocked(top as u32, &ray, f32::INFINITY, &mut scratch);
                assert_eq!(blocked, hit.is_some());
                let is_same = hit.is_some() == truth.is_finite()
                    && (!hit.is_some() || (f64::from(hit.t) - truth).abs() < 1e-4 * truth.max(1.0));
                differing += usize::from(!is_same);
            }
            // A ray within a rounding error of an edge may go either way: a few in a thousand.
            assert!(differing <= 1, "{differing} of 500 rays differ");
        }
    }

    /// Leaves as pairs of triangles, and slivers that run aslant among them.
    fn leaves_and_twigs(chance: &mut Stream) -> Vec<Triangle> {
        let mut list = Vec::new();
        for number in 0..400 {
            let a = point(chance, 1.0);
            let (x, y) = (point(chance, 0.1), point(chance, 0.1));
            let face = Face::new([x.cross(y).normalize(); 3], number);
            list.push(Triangle::new([a, a + x, a + y], face));
            list.push(Triangle::new([a + x + y, a + y, a + x], face));
        }
        for _ in 0..60 {
            let (a, way) = (point(chance, 1.0), point(chance, 1.5));
            list.push(Triangle::new([a, a + way, a + way + point(chance, 0.01)], Face::default()));
        }
        list
    }

    #[test]
    fn parallelograms_and_cut_slivers_are_met_where_brute_force_meets_them() {
        let mut chance = Seed(21).stream("leaves", 0);
        let list = leaves_and_twigs(&mut chance);
        let joined = join_pairs(&list, &mut Charts::default());
        assert_eq!(joined.len(), 460, "each pair is one");
        let level = Level::mesh(&joined);
        assert_eq!(level.triangle_count(&[]), list.len() as u128);
        let flat: Vec<[Vec3; 3]> = list.iter().map(|triangle| triangle.corners).collect();
        let levels = Levels::new(vec![level]);
        let mut scratch = Scratch::default();
        let mut differing = 0;
        for _ in 0..3000 {
            let origin = point(&mut chance, 3.0);
            let ray = Ray { origin, direction: point(&mut chance, 1.0) - origin };
            let hit = levels.nearest(0, &ray, f32::INFINITY, &mut scratch);
            let truth = brute_force(&flat, &ray);
            let is_same = hit.is_some() == truth.is_finite()
                && (!hit.is_some() || (f64::from(hit.t) - truth).abs() < 1e-4);
            differing += usize::from(!is_same);
        }
        assert!(differing <= 2, "{differing} of 3000 rays differ");
    }

    #[test]
    fn triangles_that_make_no_parallelogram_stay_two() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let first = Triangle::new(corners, Face::new([Vec3::Z; 3], 1));
        let other = |far: Vec3, material: u16| {
            Triangle::new([far, Vec3::Y, Vec3::X], Face::new([Vec3::Z; 3], material))
        };
        let whole = Vec3::new(1.0, 1.0, 0.0);
        assert!(first.joined(&other(whole, 1), &mut Charts::default()).is_some());
        assert!(
            first.joined(&other(whole, 2), &mut Charts::default()).is_none(),
            "another material"
        );
        assert!(first.joined(&other(whole + 0.01, 1), &mut Charts::default()).is_none(), "a kite");
        let turned = Triangle::new([whole, Vec3::X, Vec3::Y], Face::new([Vec3::Z; 3], 1));
        assert!(first.joined(&turned, &mut Charts::default()).is_none(), "it faces the other way");
        let bent =
            Triangle::new([whole, Vec3::Y, Vec3::X], Face::new([Vec3::X, Vec3::Z, Vec3::Z], 1));
        assert!(first.joined(&bent, &mut Charts::default()).is_none(), "its normals bend");
    }

    #[test]
    fn crowded_placements_are_met_where_brute_force_meets_them() {
        let mut chance = Seed(23).stream("crowd", 0);
        let mesh = Level::mesh(&join_pairs(&leaves_and_twigs(&mut chance), &mut Charts::default()));
        let placed: Vec<(Instance, u64)> = placements(&mut chance, 120, 1)
            .into_iter()
            .map(|(instance, plant)| {
                let turn = Quat::from_rotation_z(chance.range(0.0, 6.0) as f32).to_array();
                let at = instance.carry_point(Vec3::ZERO) * 0.2;
                (Instance::new(turn, 1.3, at.to_array(), 0), plant)
            })
            .collect();
        let levels = vec![mesh];
        let group = Level::group(&placed, &levels);
        let Content::Group { parts, .. } = &group.content else { panic!("a group") };
        assert!(parts.len() > placed.len(), "crowded placements are opened");
        let levels = vec![levels.into_iter().next().unwrap(), group];
        let flat = flatten(&levels, 1);
        let levels = Levels::new(levels);
        let mut scratch = Scratch::default();
        let mut differing = 0;
        for _ in 0..500 {
            let origin = point(&mut chance, 6.0);
            let ray = Ray { origin, direction: point(&mut chance, 2.0) - origin };
            let hit = levels.nearest(1, &ray, f32::INFINITY, &mut scratch);
            let truth = brute_force(&flat, &ray);
            let is_same = hit.is_some() == truth.is_finite()
                && (!hit.is_some() || (f64::from(hit.t) - truth).abs() < 1e-4);
            differing += usize::from(!is_same);
        }
        assert!(differing <= 1, "{differing} of 500 rays differ");
    }

    #[test]
    fn plain_loops_and_vectors_give_the_same_bits() {
        let make = || nested(&mut Seed(5).stream("bits", 0));
        let (fast, plain) = (Levels::new(make()), Levels::new(make()).portable());
        let mut chance = Seed(6).stream("rays", 0);
        let mut scratch = Scratch::default();
        for _ in 0..2000 {
            let ray = Ray { origin: point(&mut chance, 15.0), direction: direction(&mut chance) };
            let a = fast.nearest(4, &ray, f32::INFINITY, &mut scratch);
            let b = plain.nearest(4, &ray, f32::INFINITY, &mut scratch);
            assert_eq!(
                (a.t.to_bits(), a.u.to_bits(), a.triangle),
                (b.t.to_bits(), b.u.to_bits(), b.triangle)
            );
        }
    }

    #[test]
    fn our_walk_agrees_with_obvhs_on_a_mesh() {
        let mut chance = Seed(8).stream("mesh", 0);
        let list = triangles(&mut chance, 3000, 0.1);
        let theirs: Vec<obvhs::triangle::Triangle> = list
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.corners.map(glam::Vec3A::from);
                obvhs::triangle::Triangle { v0, v1, v2 }
            })
            .collect();
        let tree = obvhs::bvh2::builder::build_bvh2_from_tris(
            &theirs,
            obvhs::BvhBuildParams::medium_build(),
            &mut std::time::Duration::default(),
        );
        let levels = Levels::new(vec![Level::mesh(&list)]);
        let mut scratch = Scratch::default();
        let mut differing = 0;
        for _ in 0..3000 {
            let ray = Ray { origin: point(&mut chance, 2.0), direction: direction(&mut chance) };
            let mine = levels.nearest(0, &ray, f32::INFINITY, &mut scratch);
            let mut hit = obvhs::ray::RayHit::none();
            let their_ray = obvhs::ray::Ray::new_inf(ray.origin.into(), ray.direction.into());
            tree.ray_traverse(their_ray, &mut hit, |ray, id| {
                theirs[tree.primitive_indices[id] as usize].intersect(ray)
            });
            let t = if mine.is_some() { mine.t } else { f32::INFINITY };
            differing += usize::from(!(t == hit.t || (t - hit.t).abs() < 1e-4));
        }
        assert!(differing <= 3, "{differing} of 3000 rays differ");
    }

    #[test]
    fn hostile_geometry_is_never_met_and_never_hides_what_is_there() {
        let zero = [Vec3::ZERO; 3];
        let line = [Vec3::ZERO, Vec3::X, 2.0 * Vec3::X];
        let far = [Vec3::splat(1e18), Vec3::splat(2e18), Vec3::new(1e18, -1e18, 0.0)];
        let real =
            [Vec3::new(-1.0, -1.0, 5.0), Vec3::new(3.0, -1.0, 5.0), Vec3::new(-1.0, 3.0, 5.0)];
        let mut list: Vec<Triangle> = Vec::new();
        for corners in [zero, line, far, real] {
            list.extend([Triangle::new(corners, Face::default()); 5]);
        }
        let levels = Levels::new(vec![Level::mesh(&list)]);
        let mut scratch = Scratch::default();
        for direction in [Vec3::Z, Vec3::new(0.1, 0.0, 1.0), Vec3::new(-0.0, 0.1, 1.0)] {
            let ray = Ray { origin: Vec3::ZERO, direction };
            let hit = levels.nearest(0, &ray, f32::INFINITY, &mut scratch);
            assert!((hit.t - 5.0).abs() < 1e-5, "{direction} met at {}", hit.t);
        }
        let away = Ray { origin: Vec3::new(0.2, 0.3, 0.0), direction: -Vec3::Z };
        assert!(!levels.is_blocked(0, &away, f32::INFINITY, &mut scratch));
    }

    #[test]
    fn empty_levels_are_never_met() {
        let levels = vec![Level::mesh(&[]), Level::group(&[], &[])];
        let levels = Levels::new(levels);
        let ray = Ray { origin: Vec3::ZERO, direction: Vec3::Z };
        for level in [0, 1] {
            assert!(!levels.nearest(level, &ray, 1.0, &mut Scratch::default()).is_some());
            assert!(levels.bounds(level).is_empty());
        }
    }

    #[test]
    fn a_turned_placement_turns_the_normal_and_names_its_plant() {
        let corners = [Vec3::ZERO, Vec3::X, Vec3::Y];
        let mesh = Level::mesh(&[Triangle::new(corners, Face::new([Vec3::Z; 3], 7))]);
        let turn = Quat::from_rotation_x(std::f32::consts::FRAC_PI_2);
        let instance = Instance::new(turn.to_array(), 2.0, [5.0, 0.0, 0.0], 0);
        let group = Level::group(&[(instance, 42)], std::slice::from_ref(&mesh));
        let levels = Levels::new(vec![mesh, group]);
        let ray = Ray { origin: Vec3::new(5.2, -3.0, 0.2), direction: Vec3::Y };
        let hit = levels.nearest(1, &ray, f32::INFINITY, &mut Scratch::default());
        assert!((hit.t - 3.0).abs() < 1e-5);
        let place = levels.place(1, &hit);
        assert!(place.shading.abs_diff_eq(-Vec3::Y, 1e-5), "{}", place.shading);
        assert!(place.geometric.abs_diff_eq(-Vec3::Y, 1e-5));
        assert_eq!((place.face.material, place.plant), (7, 42));
    }

    proptest::proptest! {
        #[test]
        fn no_soup_of_numbers_makes_building_or_walking_panic(
            numbers in proptest::collection::vec(proptest::num::f32::ANY, 0..400),
            ray in proptest::array::uniform6(proptest::num::f32::ANY),
        ) {
            let corner = |c: &[f32]| Vec3::new(c[0], c[1], c[2]);
            let list: Vec<Triangle> = numbers
                .chunks_exact(9)
                .map(|nine| [corner(&nine[..3]), corner(&nine[3..6]), corner(&nine[6..])])
                .map(|corners| Triangle::new(corners, Face::default()))
                .collect();
            let mesh = Level::mesh(&list);
            let upright = Instance::new(Quat::IDENTITY.to_array(), 1.0, [0.0; 3], 0);
            let group = Level::group(&[(upright, 1)], std::slice::from_ref(&mesh));
            let levels = Levels::new(vec![mesh, group]);
            let ray = Ray { origin: corner(&ray[..3]), direction: corner(&ray[3..]) };
            let mut scratch = Scratch::default();
            let hit = levels.nearest(1, &ray, f32::INFINITY, &mut scratch);
            proptest::prop_assert!(!hit.is_some() || hit.t > 0.0);
        }
    }
}
