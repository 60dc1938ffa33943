//! Eight boxes or eight triangles tested at once.
//!
//! Two implementations of the same arithmetic, in the same order: plain loops for any processor
//! and AVX2 chosen at run time. Neither uses fused multiply-add, so both give the same bits.

use super::Bounds;
use super::level::{Block, HALF};
use super::tight::TightNode;
use glam::{Vec3, Vec3A};

/// Bit of a child link that marks a leaf.
pub(crate) const LEAF: u32 = 1 << 31;

/// Widens the far end of a box's interval by two rounding errors, so that a ray through an edge
/// misses neither neighbour [Ize13].
const GUARD: f32 = 1.0 + 2.0 * f32::EPSILON;

/// Smallest direction component that is inverted; smaller ones would make 0 × ∞ in a box test.
const SMALLEST: f32 = 1e-30;

/// Eight children: their boxes and where they lead.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(32))]
pub(crate) struct Node {
    /// Low x, y, z, then high x, y, z, of the eight children; an absent child is an empty box,
    /// which no ray meets.
    planes: [[f32; 8]; 6],
    /// Number of a node, or of a leaf when [`LEAF`] is set.
    pub links: [u32; 8],
}

impl Node {
    /// No child.
    pub const EMPTY: Node = Node {
        planes: [
            [f32::INFINITY; 8],
            [f32::INFINITY; 8],
            [f32::INFINITY; 8],
            [f32::NEG_INFINITY; 8],
            [f32::NEG_INFINITY; 8],
            [f32::NEG_INFINITY; 8],
        ],
        links: [LEAF; 8],
    };

    /// Fills a slot.
    pub fn set(&mut self, slot: usize, bounds: &Bounds, link: u32) {
        for axis in 0..3 {
            self.planes[axis][slot] = bounds.low[axis];
            self.planes[axis + 3][slot] = bounds.high[axis];
        }
        self.links[slot] = link;
    }

    /// Boxes and links of the children that are there.
    pub fn children(&self) -> impl Iterator<Item = (Bounds, u32)> + '_ {
        let corner = |slot: usize, from: usize| {
            Vec3A::from_array([0, 1, 2].map(|axis| self.planes[from + axis][slot]))
        };
        (0..8)
            .map(move |slot| (Bounds { low: corner(slot, 0), high: corner(slot, 3) }, slot))
            .filter(|(bounds, _)| !bounds.is_empty())
            .map(|(bounds, slot)| (bounds, self.links[slot]))
    }
}

/// A ray in the space of a level, with what box tests need of it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LocalRay {
    pub origin: Vec3,
    pub direction: Vec3,
    inverse: [f32; 3],
    /// Rows of [`Node::planes`] where the ray enters and leaves, by axis.
    near: [usize; 3],
    far: [usize; 3],
}

impl LocalRay {
    #[inline(always)]
    pub fn new(origin: Vec3, direction: Vec3) -> Self {
        let d = direction.to_array();
        let inverse = d.map(|c| 1.0 / if c.abs() < SMALLEST { SMALLEST.copysign(c) } else { c });
        let near = [0, 1, 2].map(|axis| if inverse[axis] < 0.0 { axis + 3 } else { axis });
        let far = [0, 1, 2].map(|axis| if inverse[axis] < 0.0 { axis } else { axis + 3 });
        Self { origin, direction, inverse, near, far }
    }
}

/// Which of eight lanes are hit, and where.
#[derive(Clone, Copy)]
pub(crate) struct LaneHits {
    /// Bit `i` is set when lane `i` is hit.
    pub mask: u32,
    /// Ray parameters; of boxes, of entry.
    pub t: [f32; 8],
}

/// Hits of eight triangles, with barycentric coordinates.
#[derive(Clone, Copy)]
pub(crate) struct TriangleHits {
    pub mask: u32,
    pub t: [f32; 8],
    pub u: [f32; 8],
    pub v: [f32; 8],
}

impl TriangleHits {
    /// Nothing met.
    pub const NONE: Self = Self { mask: 0, t: [0.0; 8], u: [0.0; 8], v: [0.0; 8] };
}

/// Bit of a float's sign.
const SIGN: u32 = 1 << 31;

/// A way to test eight at once.
pub(crate) trait Lanes {
    /// Boxes that the ray meets between 0 and `limit`.
    ///
    /// # Safety
    /// The processor has the features that the implementation needs.
    unsafe fn boxes(node: &Node, ray: &LocalRay, limit: f32) -> LaneHits;

    /// The same of a node in its tight form.
    ///
    /// # Safety
    /// The processor has the features that the implementation needs.
    unsafe fn tight_boxes(node: &TightNode, ray: &LocalRay, limit: f32) -> LaneHits;

    /// Triangles and parallelograms that the ray meets between 0 and `limit`, exclusive, from
    /// either side [MT97]. Degenerate ones have a determinant of 0 and are never met. The division
    /// by the determinant is put off: most blocks are missed.
    ///
    /// # Safety
    /// The processor has the features that the implementation needs.
    unsafe fn triangles(block: &Block, ray: &LocalRay, limit: f32) -> TriangleHits;
}

/// Plain loops.
pub(crate) struct Portable;

impl Lanes for Portable {
    #[inline(always)]
    unsafe fn boxes(node: &Node, ray: &LocalRay, limit: f32) -> LaneHits {
        plain_boxes(|row, lane| node.planes[row][lane], ray, limit)
    }

    #[inline(always)]
    unsafe fn tight_boxes(node: &TightNode, ray: &LocalRay, limit: f32) -> LaneHits {
        plain_boxes(|row, lane| node.plane(row % 3, node.planes[row][lane]), ray, limit)
    }

    #[inline(always)]
    unsafe fn triangles(block: &Block, ray: &LocalRay, limit: f32) -> TriangleHits {
        let mut hits = TriangleHits::NONE;
        for lane in 0..8 {
            let corner = Vec3::from_array([0, 1, 2].map(|axis| block.corner[axis][lane]));
            let edge_1 = Vec3::from_array([0, 1, 2].map(|axis| block.edge_1[axis][lane]));
            let edge_2 = Vec3::from_array([0, 1, 2].map(|axis| block.edge_2[axis][lane]));
            let p = cross(ray.direction, edge_2);
            let determinant = dot(edge_1, p);
            let size = determinant.abs();
            let sign = |value: f32| f32::from_bits(value.to_bits() ^ determinant.to_bits() & SIGN);
            let s = ray.origin - corner;
            let q = cross(s, edge_1);
            let u = sign(dot(s, p));
            let v = sign(dot(ray.direction, q));
            let reach =
                if block.face[lane] & HALF != 0 { if u > v { u } else { v } } else { u + v };
            let inverse = 1.0 / size;
            let (u, v, t) = (u * inverse, v * inverse, sign(dot(edge_2, q)) * inverse);
            let is_inside = u >= 0.0 && v >= 0.0 && reach <= size && size > 0.0;
            let is_hit = is_inside && t > 0.0 && t < limit;
            hits.mask |= u32::from(is_hit) << lane;
            (hits.t[lane], hits.u[lane], hits.v[lane]) = (t, u, v);
        }
        hits
    }
}

/// Box tests in plain loops.
#[inline(always)]
fn plain_boxes(plane: impl Fn(usize, usize) -> f32, ray: &LocalRay, limit: f32) -> LaneHits {
    let o = ray.origin.to_array();
    let mut hits = LaneHits { mask: 0, t: [0.0; 8] };
    for lane in 0..8 {
        let (mut near, mut far) = (0.0f32, limit);
        for (axis, origin) in o.into_iter().enumerate() {
            let enter = (plane(ray.near[axis], lane) - origin) * ray.inverse[axis];
            let leave = (plane(ray.far[axis], lane) - origin) * ray.inverse[axis];
            near = if enter > near { enter } else { near };
            far = if leave < far { leave } else { far };
        }
        hits.t[lane] = near;
        hits.mask |= u32::from(near <= far * GUARD) << lane;
    }
    hits
}

/// Written out so that the order of additions is the same as in the AVX2 version.
#[inline(always)]
fn dot(a: Vec3, b: Vec3) -> f32 {
    (a.x * b.x + a.y * b.y) + a.z * b.z
}

#[inline(always)]
fn cross(a: Vec3, b: Vec3) -> Vec3 {
    Vec3::new(a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x)
}

#[cfg(target_arch = "x86_64")]
pub(crate) use avx2::Avx2;

#[cfg(target_arch = "x86_64")]
mod avx2 {
    use super::{Block, GUARD, LaneHits, Lanes, LocalRay, Node, TightNode, TriangleHits};
    use std::arch::x86_64::*;

    /// 256-bit vectors.
    pub(crate) struct Avx2;

    impl Lanes for Avx2 {
        #[inline(always)]
        unsafe fn boxes(node: &Node, ray: &LocalRay, limit: f32) -> LaneHits {
            // SAFETY: the caller promises AVX2.
            unsafe { boxes(node, ray, limit) }
        }

        #[inline(always)]
        unsafe fn tight_boxes(node: &TightNode, ray: &LocalRay, limit: f32) -> LaneHits {
            // SAFETY: the caller promises AVX2.
            unsafe { tight_boxes(node, ray, limit) }
        }

        #[inline(always)]
        unsafe fn triangles(block: &Block, ray: &LocalRay, limit: f32) -> TriangleHits {
            // SAFETY: the caller promises AVX2.
            unsafe { triangles(block, ray, limit) }
        }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn load(lanes: &[f32; 8]) -> __m256 {
        // SAFETY: the reference covers the eight floats that are read.
        unsafe { _mm256_loadu_ps(lanes.as_ptr()) }
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn store(lanes: __m256) -> [f32; 8] {
        let mut array = [0.0; 8];
        // SAFETY: the array covers the eight floats that are written.
        unsafe { _mm256_storeu_ps(array.as_mut_ptr(), lanes) };
        array
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn boxes(node: &Node, ray: &LocalRay, limit: f32) -> LaneHits {
        let row = |_: usize, row: usize| {
            // SAFETY: rows are numbers below 6, see `LocalRay::new`.
            load(unsafe { node.planes.get_unchecked(row) })
        };
        slabs(row, ray, limit)
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn tight_boxes(node: &TightNode, ray: &LocalRay, limit: f32) -> LaneHits {
        let row = |axis: usize, row: usize| {
            // SAFETY: rows are numbers below 6, see `LocalRay::new`; each is eight bytes long.
            let bytes = unsafe { _mm_loadl_epi64(node.planes.get_unchecked(row).as_ptr().cast()) };
            let steps = _mm256_cvtepi32_ps(_mm256_cvtepu8_epi32(bytes));
            let along = _mm256_mul_ps(steps, _mm256_set1_ps(node.step[axis]));
            _mm256_add_ps(_mm256_set1_ps(node.low[axis]), along)
        };
        slabs(row, ray, limit)
    }

    /// Box tests; `row` gives the planes of an axis by the number of their row.
    #[inline]
    #[target_feature(enable = "avx2")]
    fn slabs(row: impl Fn(usize, usize) -> __m256, ray: &LocalRay, limit: f32) -> LaneHits {
        let o = ray.origin.to_array();
        let (mut near, mut far) = (_mm256_setzero_ps(), _mm256_set1_ps(limit));
        for (axis, origin) in o.into_iter().enumerate() {
            let origin = _mm256_set1_ps(origin);
            let inverse = _mm256_set1_ps(ray.inverse[axis]);
            let enter = _mm256_sub_ps(row(axis, ray.near[axis]), origin);
            let leave = _mm256_sub_ps(row(axis, ray.far[axis]), origin);
            // These return the second operand when one is NaN, as the plain version does.
            near = _mm256_max_ps(_mm256_mul_ps(enter, inverse), near);
            far = _mm256_min_ps(_mm256_mul_ps(leave, inverse), far);
        }
        let far = _mm256_mul_ps(far, _mm256_set1_ps(GUARD));
        let mask = _mm256_movemask_ps(_mm256_cmp_ps::<_CMP_LE_OQ>(near, far)) as u32;
        LaneHits { mask, t: store(near) }
    }

    type Three = [__m256; 3];

    #[inline]
    #[target_feature(enable = "avx2")]
    fn cross(a: Three, b: Three) -> Three {
        let term = |i: usize, j: usize| {
            _mm256_sub_ps(_mm256_mul_ps(a[i], b[j]), _mm256_mul_ps(a[j], b[i]))
        };
        [term(1, 2), term(2, 0), term(0, 1)]
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn dot(a: Three, b: Three) -> __m256 {
        let xy = _mm256_add_ps(_mm256_mul_ps(a[0], b[0]), _mm256_mul_ps(a[1], b[1]));
        _mm256_add_ps(xy, _mm256_mul_ps(a[2], b[2]))
    }

    #[inline]
    #[target_feature(enable = "avx2")]
    fn triangles(block: &Block, ray: &LocalRay, limit: f32) -> TriangleHits {
        let [dx, dy, dz] = ray.direction.to_array();
        let direction = [_mm256_set1_ps(dx), _mm256_set1_ps(dy), _mm256_set1_ps(dz)];
        let [ox, oy, oz] = ray.origin.to_array();
        let edge_1 = [load(&block.edge_1[0]), load(&block.edge_1[1]), load(&block.edge_1[2])];
        let edge_2 = [load(&block.edge_2[0]), load(&block.edge_2[1]), load(&block.edge_2[2])];
        let s = [
            _mm256_sub_ps(_mm256_set1_ps(ox), load(&block.corner[0])),
            _mm256_sub_ps(_mm256_set1_ps(oy), load(&block.corner[1])),
            _mm256_sub_ps(_mm256_set1_ps(oz), load(&block.corner[2])),
        ];
        let (zero, one) = (_mm256_setzero_ps(), _mm256_set1_ps(1.0));
        let p = cross(direction, edge_2);
        let determinant = dot(edge_1, p);
        let minus = _mm256_set1_ps(-0.0);
        let sign = _mm256_and_ps(determinant, minus);
        let size = _mm256_andnot_ps(minus, determinant);
        let q = cross(s, edge_1);
        let u = _mm256_xor_ps(dot(s, p), sign);
        let v = _mm256_xor_ps(dot(direction, q), sign);
        // SAFETY: eight numbers of 32 bits; only their signs are looked at.
        let halves = unsafe { _mm256_loadu_ps(block.face.as_ptr().cast()) };
        let reach = _mm256_blendv_ps(_mm256_add_ps(u, v), _mm256_max_ps(u, v), halves);
        let in_u = _mm256_cmp_ps::<_CMP_GE_OQ>(u, zero);
        let in_v = _mm256_cmp_ps::<_CMP_GE_OQ>(v, zero);
        let in_w = _mm256_cmp_ps::<_CMP_LE_OQ>(reach, size);
        let is_some = _mm256_cmp_ps::<_CMP_GT_OQ>(size, zero);
        let inside = _mm256_and_ps(_mm256_and_ps(in_u, in_v), _mm256_and_ps(in_w, is_some));
        if _mm256_movemask_ps(inside) == 0 {
            return TriangleHits::NONE;
        }
        let inverse = _mm256_div_ps(one, size);
        let t = _mm256_mul_ps(_mm256_xor_ps(dot(edge_2, q), sign), inverse);
        let after = _mm256_cmp_ps::<_CMP_GT_OQ>(t, zero);
        let before = _mm256_cmp_ps::<_CMP_LT_OQ>(t, _mm256_set1_ps(limit));
        let mask = _mm256_and_ps(inside, _mm256_and_ps(after, before));
        let mask = _mm256_movemask_ps(mask) as u32;
        let (u, v) = (_mm256_mul_ps(u, inverse), _mm256_mul_ps(v, inverse));
        TriangleHits { mask, t: store(t), u: store(u), v: store(v) }
    }
}
