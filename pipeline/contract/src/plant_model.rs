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

/// A material.
#[derive(Clone, Debug, PartialEq)]
pub struct Material {
    /// Name, for instance `bark`.
    pub name: String,
    /// Diffuse reflectance, linear Rec. 709.
    pub reflectance: [f32; 3],
    /// Roughness of the glossy coat in (0, 1]; 1 means no coat to speak of.
    pub roughness: f32,
    /// What happens to the light that is not reflected.
    pub surface: Surface,
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
#[derive(Clone, Debug, PartialEq)]
pub struct Organ {
    /// Name, for instance `leaf`.
    pub name: String,
    /// Its meshes, in the organ's own space: attached at the origin, growing along +Y with its
    /// upper side towards +Z.
    pub meshes: Vec<Mesh>,
    /// Its places in the plant's space.
    pub placements: Vec<Placement>,
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
}

impl Mesh {
    /// Whether every index is in range and the columns agree in length.
    pub fn is_sound(&self, material_count: usize) -> bool {
        let n = self.positions.len();
        let fits = |len: usize| len == 0 || len == n;
        fits(self.normals.len())
            && fits(self.uvs.len())
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
