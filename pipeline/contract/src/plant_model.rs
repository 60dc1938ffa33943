//! A plant's geometry: wood once, and organs that are instanced.
//!
//! Metres, Z up, the foot of the plant at the origin.

/// What a surface does with light.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Surface {
    /// Opaque and rough: bark, stems, stones.
    #[default]
    Opaque,
    /// A thin sheet that reflects and transmits diffusely: leaves, petals, blades.
    Leaf {
        /// Diffuse transmittance, linear Rec. 709; reflectance + transmittance ≤ 1.
        transmittance: [f32; 3],
    },
    /// Opaque, and shines of its own: lamps, windows at night.
    Light {
        /// Radiance to all sides, linear Rec. 709, luminance in kcd/m².
        radiance: [f32; 3],
    },
}

/// A picture that surfaces are painted with.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Texture {
    /// Name, for instance `bark`.
    pub name: String,
    /// Texels across; positive.
    pub width: u32,
    /// Texels down; positive.
    pub height: u32,
    /// Red, green and blue in sRGB and coverage, row by row; the first texel lies at texture
    /// coordinates (0, 0), the second further along u, the second row further along v.
    pub texels: Vec<[u8; 4]>,
}

/// How a material is painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Paint {
    /// Index into [`PlantModel::textures`].
    pub texture: u32,
    /// What one copy of the texture covers along u and v, in units of the texture coordinates:
    /// metres on wood, 1 on organs. Copies repeat without end.
    pub size: [f32; 2],
}

/// A material.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Material {
    /// Name, for instance `bark`.
    pub name: String,
    /// Diffuse reflectance, linear Rec. 709.
    pub reflectance: [f32; 3],
    /// Roughness of the glossy coat in (0, 1]; 1 means no coat to speak of.
    pub roughness: f32,
    /// What happens to the light that is not reflected.
    pub surface: Surface,
    /// Texture whose linear colour multiplies reflectance and transmittance, if any.
    pub paint: Option<Paint>,
    /// Coverage of the texture below which the surface is not there at all, in (0, 1]; `None`
    /// means that coverage is ignored.
    pub cutout: Option<f32>,
}

/// A triangle mesh with one material.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertices, m.
    pub positions: Vec<[f32; 3]>,
    /// Unit normals, one a vertex; empty means flat faces.
    pub normals: Vec<[f32; 3]>,
    /// Texture coordinates, one a vertex; empty means none. On wood in metres: around, along.
    pub uvs: Vec<[f32; 2]>,
    /// Three vertex indices a triangle, counter-clockwise seen from outside.
    pub triangles: Vec<[u32; 3]>,
    /// Index into [`PlantModel::materials`].
    pub material: u32,
    /// Index into [`PlantModel::branches`], one a vertex; empty where wind moves nothing.
    pub branches: Vec<u32>,
}

/// Where an organ sits: scaled, then rotated, then moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Placement {
    /// Position, m.
    pub position: [f32; 3],
    /// Unit quaternion x, y, z, w.
    pub rotation: [f32; 4],
    /// Scale along the organ's own axes.
    pub scale: [f32; 3],
}

/// An organ prototype (leaf, flower, blade) and all places where it grows.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Organ {
    /// Name, for instance `leaf`.
    pub name: String,
    /// Its meshes, in the organ's own space: attached at the origin, growing along +Y with its
    /// upper side towards +Z.
    pub meshes: Vec<Mesh>,
    /// Its places in the plant's space.
    pub placements: Vec<Placement>,
    /// Index into [`PlantModel::branches`], one a place; empty where wind moves nothing.
    pub branches: Vec<u32>,
}

/// A part of a plant that wind turns about its foot, and with it all that grows on it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Branch {
    /// The branch that bears it; it stands earlier in the table.
    pub parent: Option<u32>,
    /// Where it is attached, m.
    pub pivot: [f32; 3],
    /// Radius at the foot over length: a blade of grass has 0.002, a trunk 0.02.
    pub stiffness: f32,
    /// Where in its swing it is at time 0, rad; neighbours differ.
    pub phase: f32,
}

/// A grown plant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct PlantModel {
    /// Name, for instance `aspen-3`.
    pub name: String,
    /// Materials of all meshes.
    pub materials: Vec<Material>,
    /// Geometry that is there once: trunk, branches, stems.
    pub wood: Vec<Mesh>,
    /// Geometry that is there many times.
    pub organs: Vec<Organ>,
    /// Textures that the materials name.
    pub textures: Vec<Texture>,
    /// Parts that move in the wind, bearers first; empty unless asked for.
    pub branches: Vec<Branch>,
}

impl Texture {
    /// Whether there is a texel for every place.
    pub fn is_sound(&self) -> bool {
        let count = u64::from(self.width) * u64::from(self.height);
        count > 0 && count == self.texels.len() as u64
    }

    /// Linear Rec. 709 colour and coverage of a texel in [0, 1], the nearest to (u, v) counted in
    /// copies of the texture.
    pub fn at(&self, u: f32, v: f32) -> [f32; 4] {
        let index = |coordinate: f32, count: u32| {
            let inside = coordinate - coordinate.floor();
            ((inside * count as f32) as u32).min(count - 1) as usize
        };
        let place = index(v, self.height) * self.width as usize + index(u, self.width);
        let [r, g, b, coverage] = self.texels[place];
        [linear(r), linear(g), linear(b), f32::from(coverage) / 255.0]
    }
}

/// Linear light of an sRGB code [IEC61966].
pub fn linear(code: u8) -> f32 {
    let encoded = f32::from(code) / 255.0;
    if encoded <= 0.040_45 { encoded / 12.92 } else { libm::powf((encoded + 0.055) / 1.055, 2.4) }
}

/// The sRGB code of linear light, which is clamped to [0, 1].
pub fn srgb(linear: f32) -> u8 {
    let linear = if linear.is_nan() { 0.0 } else { linear.clamp(0.0, 1.0) };
    let encoded = if linear <= 0.003_130_8 {
        12.92 * linear
    } else {
        1.055 * libm::powf(linear, 1.0 / 2.4) - 0.055
    };
    (encoded * 255.0 + 0.5) as u8
}

impl Mesh {
    /// Whether every index is in range and the columns agree in length.
    pub fn is_sound(&self, material_count: usize) -> bool {
        let n = self.positions.len();
        let fits = |len: usize| len == 0 || len == n;
        fits(self.normals.len())
            && fits(self.uvs.len())
            && fits(self.branches.len())
            && (self.material as usize) < material_count
            && self.triangles.iter().flatten().all(|&index| (index as usize) < n)
    }
}

impl PlantModel {
    /// Triangles stored: wood and one copy of each organ.
    pub fn unique_triangles(&self) -> u64 {
        let organs = self.organs.iter().flat_map(|organ| &organ.meshes);
        self.wood.iter().chain(organs).map(|mesh| mesh.triangles.len() as u64).sum()
    }

    /// Triangles seen: organs counted at each of their places.
    pub fn instanced_triangles(&self) -> u64 {
        let count = |meshes: &[Mesh]| meshes.iter().map(|m| m.triangles.len() as u64).sum::<u64>();
        let organs = self.organs.iter().map(|o| count(&o.meshes) * o.placements.len() as u64);
        count(&self.wood) + organs.sum::<u64>()
    }

    /// Highest z of all wood vertices and organ places, m; 0 when empty.
    pub fn height(&self) -> f32 {
        let wood = self.wood.iter().flat_map(|mesh| &mesh.positions).map(|p| p[2]);
        let organs = self.organs.iter().flat_map(|o| &o.placements).map(|p| p.position[2]);
        wood.chain(organs).fold(0.0, f32::max)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn srgb_meets_the_standard_and_comes_back() {
        // Half the light has the code 188; 0.04045 is where the curve begins.
        assert_eq!([0.0, 0.5, 1.0].map(srgb), [0, 188, 255]);
        assert!((linear(128) - 0.215_861).abs() < 1e-5);
        assert!((0..=255).all(|code| srgb(linear(code)) == code));
    }

    #[test]
    fn textures_repeat_and_begin_at_their_first_texel() {
        let texels = vec![[255, 0, 0, 255], [0, 255, 0, 0], [0, 0, 255, 255], [0; 4]];
        let texture = Texture { name: "t".into(), width: 2, height: 2, texels };
        assert!(texture.is_sound());
        assert_eq!(texture.at(0.1, 0.1), [1.0, 0.0, 0.0, 1.0]);
        assert_eq!(texture.at(0.9, 0.1), [0.0, 1.0, 0.0, 0.0]);
        assert_eq!(texture.at(-0.9, 3.9), [0.0, 0.0, 1.0, 1.0]);
    }
}
