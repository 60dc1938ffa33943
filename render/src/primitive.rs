//! What shading knows of a triangle.

use glam::Vec3;

/// Normals, material and place on a texture of a triangle.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Face {
    /// Unit normals at the corners, packed.
    normals: [u32; 3],
    /// Index into the scene's materials.
    pub material: u16,
    /// A random number shared by all triangles of an organ, by which its colour varies.
    pub shade: u16,
    /// Number of the chart, counted from 1; 0 for none. [`CUT`] is set where parts are cut out.
    chart: u32,
}

/// Bit of a face's chart that says that a texture decides where the surface is.
const CUT: u32 = 1 << 31;

impl Face {
    /// A face with normals at its corners.
    pub fn new(normals: [Vec3; 3], material: u16) -> Self {
        Self { normals: normals.map(pack_normal), material, shade: 0, chart: 0 }
    }

    /// The same face on a chart, perhaps with parts cut out.
    pub fn on_chart(self, chart: u32, is_cut: bool) -> Self {
        debug_assert!(chart < CUT - 1);
        Self { chart: (chart + 1) | if is_cut { CUT } else { 0 }, ..self }
    }

    /// Number of the chart that it lies on.
    pub fn chart(&self) -> Option<u32> {
        (self.chart & !CUT).checked_sub(1)
    }

    /// Whether a texture decides where it is.
    pub fn is_cut(&self) -> bool {
        self.chart & CUT != 0
    }

    /// The same face with turned normals.
    pub fn turned(self, turn: impl Fn(Vec3) -> Vec3) -> Self {
        let normals = self.normals.map(|packed| pack_normal(turn(unpack_normal(packed))));
        Self { normals, ..self }
    }

    /// The same face counted from another corner; its chart is to be turned likewise.
    pub fn rotated(self, by: usize) -> Self {
        Self { normals: [0, 1, 2].map(|i| self.normals[(by + i) % 3]), ..self }
    }

    /// Whether this face, drawn on beyond its second and third corner, is `other`, which has
    /// those two the other way round and a new corner before them; charts are not looked at.
    pub fn continues(&self, other: &Face) -> bool {
        let [a, b, c] = self.normals;
        let [d, e, f] = other.normals;
        if (self.material, self.shade) != (other.material, other.shade) || (e, f) != (c, b) {
            return false;
        }
        let beyond = unpack_normal(b) + unpack_normal(c) - unpack_normal(a);
        // Half a degree is less than anyone sees.
        (a == b && b == c && c == d) || beyond.normalize().dot(unpack_normal(d)) > 0.99996
    }

    /// Interpolated normal; `u` and `v` weigh the second and third corner.
    pub fn normal(&self, u: f32, v: f32) -> Vec3 {
        let [a, b, c] = self.normals;
        if a == b && b == c {
            return unpack_normal(a);
        }
        let sum = (1.0 - u - v) * unpack_normal(a) + u * unpack_normal(b) + v * unpack_normal(c);
        sum.normalize_or(unpack_normal(a))
    }
}

/// A unit vector in 32 bits: folded onto an octahedron, 16 bits a coordinate [Cigolle14].
///
/// The error is below 0.01°.
fn pack_normal(n: Vec3) -> u32 {
    let n = n / (n.x.abs() + n.y.abs() + n.z.abs());
    let sign = |value: f32| if value < 0.0 { -1.0 } else { 1.0 };
    let (x, y) = if n.z < 0.0 {
        ((1.0 - n.y.abs()) * sign(n.x), (1.0 - n.x.abs()) * sign(n.y))
    } else {
        (n.x, n.y)
    };
    let code = |value: f32| (value.clamp(-1.0, 1.0) * 32767.0).round() as i16 as u16;
    u32::from(code(x)) | u32::from(code(y)) << 16
}

fn unpack_normal(packed: u32) -> Vec3 {
    let decode = |bits: u32| f32::from(bits as u16 as i16) / 32767.0;
    let (x, y) = (decode(packed), decode(packed >> 16));
    let z = 1.0 - x.abs() - y.abs();
    let fold = (-z).max(0.0);
    let push = |value: f32| if value < 0.0 { value + fold } else { value - fold };
    Vec3::new(push(x), push(y), z).normalize()
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn packed_normals_turn_by_less_than_a_hundredth_of_a_degree() {
        let mut chance = Seed(5).stream("normals", 0);
        for _ in 0..10_000 {
            let n = Vec3::from_array([0; 3].map(|_| chance.normal() as f32)).normalize();
            let angle = unpack_normal(pack_normal(n)).cross(n).length();
            assert!(angle.to_degrees() < 0.01, "{n} turned by {}°", angle.to_degrees());
        }
        for n in [Vec3::Z, -Vec3::Z, Vec3::X, -Vec3::X, Vec3::Y, -Vec3::Y] {
            assert!(unpack_normal(pack_normal(n)).abs_diff_eq(n, 1e-6));
        }
    }
}
