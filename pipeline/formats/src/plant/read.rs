//! Reading a GLB: every bound is checked, every node is visited once.

use super::glb::{
    self, BranchColumns, Document, InstanceAttributes, MaterialEntry, Node, Numbers, Primitive,
    TextureInfo, TextureTransform,
};
use super::{MAX_ITEMS, texture, z_up};
use crate::error::{Error, Result};
use glam::{DMat3, DMat4, DQuat, DVec3, Quat};
use std::path::Path;
use weald_contract::{
    Branch, Material, Mesh, Organ, Paint, Placement, PlantModel, Surface, Texture,
};

/// Extensions that change geometry but that we may ignore or understand.
const KNOWN: [&str; 4] = [
    "EXT_mesh_gpu_instancing",
    "KHR_materials_diffuse_transmission",
    "KHR_materials_unlit",
    "KHR_texture_transform",
];

pub(super) fn from_glb(path: &Path, bytes: &[u8]) -> Result<PlantModel> {
    let (document, binary) = glb::open(path, bytes)?;
    if let Some(name) = document.extensions_required.iter().find(|n| !KNOWN.contains(&n.as_str())) {
        let hint = "export it again without compression or quantization";
        return Err(Error::unsupported(path, format!("the extension {name}"), hint));
    }
    let numbers = Numbers { path, document: &document, binary };
    let mut reader = Reader { path, document: &document, numbers, ..Reader::new(path, &document) };
    reader.materials()?;
    reader.branches()?;
    reader.scene()?;
    let scene = document.scenes.get(document.scene.unwrap_or(0));
    let stem = || path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let name = scene.and_then(|scene| scene.name.clone()).or_else(stem).unwrap_or_default();
    Ok(PlantModel { name, ..reader.model })
}

struct Reader<'a> {
    path: &'a Path,
    document: &'a Document,
    numbers: Numbers<'a>,
    model: PlantModel,
    /// Vertices, triangles and placements so far.
    items: usize,
    /// Index of the material for meshes that name none, once there is one.
    plain: Option<u32>,
}

impl<'a> Reader<'a> {
    fn new(path: &'a Path, document: &'a Document) -> Self {
        let numbers = Numbers { path, document, binary: &[] };
        Self { path, document, numbers, model: PlantModel::default(), items: 0, plain: None }
    }

    /// Reads the materials, and those textures that give them their colour.
    fn materials(&mut self) -> Result<()> {
        self.model.materials = self.document.materials.iter().map(material).collect();
        // Where each image stands among the textures that are kept.
        let mut places: Vec<Option<u32>> = vec![None; self.document.images.len()];
        let image_of = |info: &TextureInfo| self.document.textures.get(info.index)?.source;
        let infos = |entry: &MaterialEntry| paint_of(entry).and_then(image_of);
        let mut used: Vec<usize> = self.document.materials.iter().filter_map(infos).collect();
        used.sort_unstable();
        used.dedup();
        for image in used {
            let Some(texture) = self.texture(image)? else { continue };
            places[image] = Some(self.model.textures.len() as u32);
            self.model.textures.push(texture);
        }
        for (material, entry) in self.model.materials.iter_mut().zip(&self.document.materials) {
            let info = paint_of(entry);
            let place = info.and_then(image_of).and_then(|image| *places.get(image)?);
            let paint = info.zip(place);
            material.paint =
                paint.map(|(info, texture)| Paint { texture, size: paint_size(entry, info) });
            if material.paint.is_none() {
                material.cutout = None;
            }
        }
        Ok(())
    }

    /// An image of the file; `None` for one that lies beside it or is of another format.
    fn texture(&mut self, index: usize) -> Result<Option<Texture>> {
        let Some(entry) = self.document.images.get(index) else { return Ok(None) };
        let Some(view) = entry.buffer_view else { return Ok(None) };
        let Some(bytes) = self.numbers.view(view) else {
            return Err(self.wrong(format!("image {index} reaches outside the file")));
        };
        let name = entry.name.clone().unwrap_or_default();
        let texture = texture::from_bytes(self.path, name, bytes)?;
        self.count(texture.texels.len())?;
        Ok(Some(texture))
    }

    /// Reads the table of branches that wind moves, which only our files have.
    fn branches(&mut self) -> Result<()> {
        let scene = self.document.scenes.get(self.document.scene.unwrap_or(0));
        let ours = scene.and_then(|scene| scene.extras.get("weald")?.get("branches"));
        let Some(columns) = ours else { return Ok(()) };
        let columns: BranchColumns = serde_json::from_value(columns.clone())
            .map_err(|error| self.wrong(format!("the table of branches is wrong: {error}")))?;
        let pivots = self.numbers.vectors::<3>(columns.pivot)?;
        let parents = self.numbers.vectors::<1>(columns.parent)?;
        let stiffness = self.numbers.vectors::<1>(columns.stiffness)?;
        let phases = self.numbers.vectors::<1>(columns.phase)?;
        if [parents.len(), stiffness.len(), phases.len()] != [pivots.len(); 3] {
            return Err(self.wrong("the columns of the table of branches differ in length".into()));
        }
        self.count(pivots.len())?;
        for (index, pivot) in pivots.into_iter().enumerate() {
            let [parent] = parents[index];
            if parent >= index as f32 {
                return Err(self.wrong(format!("branch {index} stands before its bearer")));
            }
            self.model.branches.push(Branch {
                parent: (parent >= 0.0).then_some(parent as u32),
                pivot: z_up(pivot),
                stiffness: stiffness[index][0],
                phase: phases[index][0],
            });
        }
        Ok(())
    }

    /// Which branch each vertex or place follows.
    fn branch_column(&self, accessor: Option<usize>, count: usize) -> Result<Vec<u32>> {
        let numbers = self.optional::<1>(accessor, count)?;
        // Foreign files may use the name for something else.
        let is_ours =
            numbers.iter().all(|&[i]| i >= 0.0 && (i as usize) < self.model.branches.len());
        Ok(if is_ours { numbers.iter().map(|&[i]| i as u32).collect() } else { Vec::new() })
    }

    /// Visits the nodes of the scene, parents first, in the order of the file.
    fn scene(&mut self) -> Result<()> {
        let scenes = &self.document.scenes;
        let roots: Vec<usize> = match scenes.get(self.document.scene.unwrap_or(0)) {
            Some(scene) => scene.nodes.clone(),
            // Without a scene, every node that is nobody's child.
            None => {
                let nodes = &self.document.nodes;
                let mut is_root = vec![true; nodes.len()];
                for &child in nodes.iter().flat_map(|node| &node.children) {
                    if let Some(root) = is_root.get_mut(child) {
                        *root = false;
                    }
                }
                (0..nodes.len()).filter(|&i| is_root.get(i) == Some(&true)).collect()
            }
        };
        let mut is_seen = vec![false; self.document.nodes.len()];
        // A stack of our own: a hostile file nests nodes deeper than threads have stack.
        let mut open: Vec<(usize, DMat4)> =
            roots.into_iter().rev().map(|root| (root, DMat4::IDENTITY)).collect();
        while let Some((index, world_from_parent)) = open.pop() {
            let Some(node) = self.document.nodes.get(index) else {
                return Err(self.wrong(format!("node {index} does not exist")));
            };
            if std::mem::replace(&mut is_seen[index], true) {
                return Err(self.wrong(format!("node {index} has two parents")));
            }
            let world_from_node = world_from_parent * transform(node);
            if !world_from_node.is_finite() {
                return Err(self.wrong(format!("the transform of node {index} is not finite")));
            }
            self.node(node, world_from_node)?;
            open.extend(node.children.iter().rev().map(|&child| (child, world_from_node)));
        }
        Ok(())
    }

    fn node(&mut self, node: &Node, world_from_node: DMat4) -> Result<()> {
        let Some(index) = node.mesh else { return Ok(()) };
        let Some(mesh) = self.document.meshes.get(index) else {
            return Err(self.wrong(format!("mesh {index} does not exist")));
        };
        // Also parts that draw nothing count: many nodes may name one mesh of many of them.
        self.count(mesh.primitives.len())?;
        let mut meshes = Vec::new();
        for primitive in &mesh.primitives {
            meshes.extend(self.primitive(primitive)?);
        }
        match &node.extensions.instancing {
            None => {
                for mut mesh in meshes {
                    apply(&mut mesh, world_from_node);
                    self.model.wood.push(turned(mesh));
                }
            }
            Some(instancing) => {
                let placements = self.placements(&instancing.attributes, world_from_node)?;
                let branches =
                    self.branch_column(instancing.attributes.branch, placements.len())?;
                let name = node.name.clone().unwrap_or_else(|| format!("organ-{index}"));
                let meshes = meshes.into_iter().map(turned).collect();
                self.model.organs.push(Organ { name, meshes, placements, branches });
            }
        }
        Ok(())
    }

    /// A mesh in glTF's axes; `None` for points and lines.
    fn primitive(&mut self, primitive: &Primitive) -> Result<Option<Mesh>> {
        let mode = primitive.mode.unwrap_or(4);
        let (Some(position), 4..=6) = (primitive.attributes.position, mode) else {
            return Ok(None);
        };
        let positions = self.numbers.vectors::<3>(position)?;
        let normals = self.optional::<3>(primitive.attributes.normal, positions.len())?;
        let mut uvs = self.optional::<2>(primitive.attributes.uv, positions.len())?;
        let branches = self.branch_column(primitive.attributes.branch, positions.len())?;
        let entry = primitive.material.and_then(|index| self.document.materials.get(index));
        if let Some(transform) = entry.and_then(paint_of).and_then(bent_transform) {
            uvs.iter_mut().for_each(|uv| *uv = moved_uv(*uv, transform));
        }
        let indices = match primitive.indices {
            Some(index) => self.numbers.indices(index)?,
            None => (0..positions.len() as u32).collect(),
        };
        let triangles = triangles(mode, &indices);
        self.count(positions.len() + triangles.len())?;
        let material = match primitive.material {
            Some(index) => u32::try_from(index).unwrap_or(u32::MAX),
            None => self.plain_material(),
        };
        let mesh = Mesh { positions, normals, uvs, triangles, material, branches };
        match mesh.is_sound(self.model.materials.len()) {
            true => Ok(Some(mesh)),
            false => Err(self.wrong("a mesh names a vertex or material that is not there".into())),
        }
    }

    fn optional<const N: usize>(
        &self,
        accessor: Option<usize>,
        count: usize,
    ) -> Result<Vec<[f32; N]>> {
        let vectors = accessor.map_or(Ok(Vec::new()), |index| self.numbers.vectors::<N>(index))?;
        match vectors.len() {
            0 => Ok(Vec::new()),
            found if found == count => Ok(vectors),
            found => {
                Err(self.wrong(format!("a mesh has {count} vertices but {found} normals or uvs")))
            }
        }
    }

    fn plain_material(&mut self) -> u32 {
        *self.plain.get_or_insert_with(|| {
            self.model.materials.push(material(&MaterialEntry::default()));
            (self.model.materials.len() - 1) as u32
        })
    }

    fn placements(
        &mut self,
        attributes: &InstanceAttributes,
        world_from_node: DMat4,
    ) -> Result<Vec<Placement>> {
        let read3 = |accessor: Option<usize>| {
            accessor.map(|index| self.numbers.vectors::<3>(index)).transpose()
        };
        let (positions, scales) = (read3(attributes.translation)?, read3(attributes.scale)?);
        let rotations =
            attributes.rotation.map(|index| self.numbers.vectors::<4>(index)).transpose()?;
        let lengths = [
            positions.as_ref().map(Vec::len),
            rotations.as_ref().map(Vec::len),
            scales.as_ref().map(Vec::len),
        ];
        let count = lengths.iter().flatten().copied().max().unwrap_or(0);
        if lengths.iter().flatten().any(|&length| length != count) {
            return Err(self.wrong("the attributes of instances differ in length".into()));
        }
        self.count(count)?;
        let frame = Similarity::of(world_from_node).ok_or_else(|| {
            let hint = "apply the node's transform before exporting";
            Error::unsupported(self.path, "instances under a sheared or mirrored node", hint)
        })?;
        let place = |i: usize| {
            let position = positions.as_ref().and_then(|list| list.get(i)).copied();
            let rotation = rotations.as_ref().and_then(|list| list.get(i)).copied();
            let scale = scales.as_ref().and_then(|list| list.get(i)).copied();
            frame.place(
                position.unwrap_or([0.0; 3]),
                rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]),
                scale.unwrap_or([1.0; 3]),
            )
        };
        Ok((0..count).map(place).collect())
    }

    /// Bounds what a small file may unfold to by naming the same numbers again and again.
    fn count(&mut self, items: usize) -> Result<()> {
        self.items = self.items.saturating_add(items);
        if self.items <= MAX_ITEMS {
            return Ok(());
        }
        let message =
            format!("the model has more than {MAX_ITEMS} vertices, triangles and instances");
        Err(Error::invalid(self.path, message, "simplify it"))
    }

    fn wrong(&self, message: String) -> Error {
        Error::invalid(self.path, message, "the file is damaged")
    }
}

fn transform(node: &Node) -> DMat4 {
    if let Some(matrix) = &node.matrix {
        return DMat4::from_cols_array(matrix);
    }
    if node.translation.is_none() && node.rotation.is_none() && node.scale.is_none() {
        return DMat4::IDENTITY;
    }
    DMat4::from_scale_rotation_translation(
        node.scale.map_or(DVec3::ONE, DVec3::from_array),
        node.rotation.map_or(DQuat::IDENTITY, DQuat::from_array),
        node.translation.map_or(DVec3::ZERO, DVec3::from_array),
    )
}

/// Triangles of a list, strip or fan [glTF] §3.7.2.1.
fn triangles(mode: u32, indices: &[u32]) -> Vec<[u32; 3]> {
    match mode {
        5 => {
            let turn = |(i, &[a, b, c]): (usize, &[u32; 3])| {
                if i % 2 == 0 { [a, b, c] } else { [b, a, c] }
            };
            indices.array_windows().enumerate().map(turn).collect()
        }
        6 => {
            let hub = indices.first().copied().unwrap_or(0);
            let rim = indices.get(1..).unwrap_or_default();
            rim.array_windows().map(|&[b, c]| [hub, b, c]).collect()
        }
        _ => indices.as_chunks().0.to_vec(),
    }
}

fn apply(mesh: &mut Mesh, world_from_node: DMat4) {
    // Files of ours have no transforms; their numbers must stay as they are.
    if world_from_node == DMat4::IDENTITY {
        return;
    }
    let wide = |v: &[f32; 3]| DVec3::from_array(v.map(f64::from));
    for position in &mut mesh.positions {
        *position = world_from_node.transform_point3(wide(position)).as_vec3().to_array();
    }
    let linear = DMat3::from_mat4(world_from_node);
    // Cofactors turn normals rightly even where the transform flattens.
    let cofactors = DMat3::from_cols(
        linear.y_axis.cross(linear.z_axis),
        linear.z_axis.cross(linear.x_axis),
        linear.x_axis.cross(linear.y_axis),
    );
    for normal in &mut mesh.normals {
        let turned = (cofactors * wide(normal)).normalize_or(wide(normal));
        *normal = turned.as_vec3().to_array();
    }
    if linear.determinant() < 0.0 {
        mesh.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
        mesh.normals.as_flattened_mut().iter_mut().for_each(|part| *part = -*part);
    }
}

fn turned(mut mesh: Mesh) -> Mesh {
    mesh.positions.iter_mut().chain(&mut mesh.normals).for_each(|vector| *vector = z_up(*vector));
    mesh
}

/// A move, turn and even scale of a node that holds instances.
enum Similarity {
    /// Nothing: numbers stay as they are.
    Identity,
    /// Scale, rotation, translation.
    Moved(f64, DQuat, DVec3),
}

impl Similarity {
    fn of(world_from_node: DMat4) -> Option<Self> {
        if world_from_node == DMat4::IDENTITY {
            return Some(Self::Identity);
        }
        let (scale, rotation, translation) = world_from_node.to_scale_rotation_translation();
        let even = DVec3::splat(scale.x);
        let back = DMat4::from_scale_rotation_translation(even, rotation, translation);
        // Exporters round to single precision.
        let tolerance = 1e-5 * scale.x.abs().max(translation.abs().max_element());
        let fits = scale.x > 0.0 && back.abs_diff_eq(world_from_node, tolerance);
        fits.then_some(Self::Moved(scale.x, rotation, translation))
    }

    fn place(&self, position: [f32; 3], rotation: [f32; 4], scale: [f32; 3]) -> Placement {
        let (position, rotation, scale) = match self {
            Self::Identity => (position, rotation, scale),
            Self::Moved(even, turn, shift) => {
                let local = DVec3::from_array(position.map(f64::from));
                let moved = (*shift + *turn * (local * *even)).as_vec3().to_array();
                let turned = (turn.as_quat() * Quat::from_array(rotation)).normalize().to_array();
                (moved, turned, scale.map(|part| part * *even as f32))
            }
        };
        let [qx, qy, qz, qw] = rotation;
        let [x, y, z] = z_up([qx, qy, qz]);
        let scale = [scale[0], scale[2], scale[1]];
        Placement { position: z_up(position), rotation: [x, y, z, qw], scale }
    }
}

/// A material from glTF's factors, or from our own numbers where the file has them.
fn material(entry: &MaterialEntry) -> Material {
    let pbr = &entry.pbr_metallic_roughness;
    let [r, g, b, _] = pbr.base_color_factor.unwrap_or([1.0; 4]).map(unit);
    let transmission = entry.extensions.transmission.as_ref();
    let factor = transmission.map_or(0.0, |found| unit(found.diffuse_transmission_factor));
    let color = transmission.and_then(|found| found.diffuse_transmission_color_factor);
    let ours = entry.extras.get("weald");
    let own = |name: &str| -> Option<[f32; 3]> {
        let list: [f32; 3] = serde_json::from_value(ours?.get(name)?.clone()).ok()?;
        Some(list.map(unit))
    };
    let reflectance = own("reflectance").unwrap_or([r, g, b].map(|part| part * (1.0 - factor)));
    let transmittance = own("transmittance")
        .or_else(|| transmission.map(|_| color.unwrap_or([1.0; 3]).map(|c| unit(c) * factor)));
    Material {
        name: entry.name.clone().unwrap_or_default(),
        reflectance,
        roughness: unit(pbr.roughness_factor.unwrap_or(1.0)),
        surface: match (transmittance, radiance(entry)) {
            (Some(transmittance), _) => Surface::Leaf { transmittance },
            (None, Some(radiance)) => Surface::Light { radiance },
            (None, None) => Surface::Opaque,
        },
        paint: None,
        cutout: cutout(entry),
    }
}

/// Coverage below which a surface is not there. What fades softly is cut at one half.
fn cutout(entry: &MaterialEntry) -> Option<f32> {
    let cutoff = match entry.alpha_mode.as_deref() {
        Some("MASK") => entry.alpha_cutoff.unwrap_or(0.5),
        Some("BLEND") => 0.5,
        _ => return None,
    };
    let [.., factor] = entry.pbr_metallic_roughness.base_color_factor.unwrap_or([1.0; 4]);
    // A cutoff of 0 lets everything through.
    let cutout = if factor == 1.0 { cutoff } else { cutoff / factor };
    (cutout > 0.0).then_some(cutout.min(1.0))
}

/// The texture that gives a material its colour, if it uses the coordinates that we read.
fn paint_of(entry: &MaterialEntry) -> Option<&TextureInfo> {
    entry.pbr_metallic_roughness.base_color_texture.as_ref().filter(|info| info.tex_coord == 0)
}

/// What one copy of a texture covers: as we wrote it, or from a transform that only scales.
fn paint_size(entry: &MaterialEntry, info: &TextureInfo) -> [f32; 2] {
    let ours = entry.extras.get("weald").and_then(|ours| ours.get("size"));
    let scale = info.extensions.transform.as_ref().and_then(|transform| transform.scale);
    let given = || match (bent_transform(info), scale) {
        (None, Some(scale)) => scale.map(|part| 1.0 / part),
        _ => [1.0; 2],
    };
    let size: Option<[f32; 2]> = ours.and_then(|size| serde_json::from_value(size.clone()).ok());
    let is_sound = |size: &[f32; 2]| size.iter().all(|side| side.is_finite() && *side > 0.0);
    size.filter(is_sound).unwrap_or_else(given)
}

/// A transform of texture coordinates that does more than scale them up or down.
fn bent_transform(info: &TextureInfo) -> Option<&TextureTransform> {
    let is_bent = |transform: &&TextureTransform| {
        let scale = transform.scale.unwrap_or([1.0; 2]);
        let is_even = scale.iter().all(|part| *part > 0.0 && part.recip().is_finite());
        transform.offset != [0.0; 2] || transform.rotation != 0.0 || !is_even
    };
    info.extensions.transform.as_ref().filter(is_bent)
}

/// Texture coordinates scaled, turned and moved, as `KHR_texture_transform` asks.
fn moved_uv([u, v]: [f32; 2], transform: &TextureTransform) -> [f32; 2] {
    let [width, height] = transform.scale.unwrap_or([1.0; 2]);
    let (u, v) = (u * width, v * height);
    let (sin, cos) = transform.rotation.sin_cos();
    let [x, y] = transform.offset;
    [u * cos + v * sin + x, v * cos - u * sin + y]
}

/// Radiance of a material that shines, kcd/m²: glTF counts in cd/m².
fn radiance(entry: &MaterialEntry) -> Option<[f32; 3]> {
    let ours = entry.extras.get("weald").and_then(|ours| ours.get("radiance"));
    let strength = entry.extensions.emission.as_ref().and_then(|found| found.emissive_strength);
    let scale = strength.unwrap_or(1.0) / 1000.0;
    let given = entry.emissive_factor?.map(|part| part * scale);
    let exact = ours.and_then(|list| serde_json::from_value(list.clone()).ok());
    let radiance: [f32; 3] = exact.unwrap_or(given);
    let is_sound = radiance.iter().all(|part| part.is_finite() && *part >= 0.0);
    (is_sound && radiance.iter().any(|part| *part > 0.0)).then_some(radiance)
}

/// A factor in [0, 1]; what is no number becomes 0.
fn unit(number: f32) -> f32 {
    if number.is_nan() { 0.0 } else { number.clamp(0.0, 1.0) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::{EulerRot, Vec3};
    use serde_json::{Value as Json, json};

    /// A GLB of one triangle (0,0,0) (1,0,0) (0,2,0), with these nodes.
    fn triangle(nodes: Json) -> Vec<u8> {
        let numbers: Vec<u8> = [0f32, 0., 0., 1., 0., 0., 0., 2., 0.]
            .iter()
            .flat_map(|number| number.to_le_bytes())
            .collect();
        let json = json!({
            "asset": { "version": "2.0" },
            "nodes": nodes,
            "meshes": [{ "primitives": [{ "attributes": { "POSITION": 0 } }] }],
            "accessors": [{ "bufferView": 0, "componentType": 5126, "count": 3, "type": "VEC3" }],
            "bufferViews": [{ "buffer": 0, "byteLength": 36 }],
            "buffers": [{ "byteLength": 36 }],
        });
        let mut text = json.to_string().into_bytes();
        text.resize(text.len().next_multiple_of(4), b' ');
        let mut bytes = Vec::new();
        let total = (12 + 8 + text.len() + 8 + numbers.len()) as u32;
        let words = [glb::MAGIC, 2, total, text.len() as u32, glb::JSON_CHUNK];
        words.iter().for_each(|word| bytes.extend(word.to_le_bytes()));
        bytes.extend(text);
        [36, glb::BINARY_CHUNK].iter().for_each(|word| bytes.extend(word.to_le_bytes()));
        bytes.extend(numbers);
        bytes
    }

    fn read(nodes: Json) -> Result<PlantModel> {
        from_glb(Path::new("bench.glb"), &triangle(nodes))
    }

    #[test]
    fn a_foreign_model_is_moved_by_all_its_nodes_and_turned_upright() {
        let model = read(json!([
            { "translation": [10, 0, 0], "children": [1] },
            { "scale": [1, 3, 1], "mesh": 0 },
        ]))
        .unwrap();
        // glTF's height 2, tripled, is our z; its x is moved by ten.
        assert_eq!(model.wood[0].positions, [[10., 0., 0.], [11., 0., 0.], [10., 0., 6.]]);
        assert_eq!((model.name.as_str(), model.materials.len()), ("bench", 1));
    }

    #[test]
    fn a_mirrored_node_turns_its_triangles_round() {
        let model = read(json!([{ "scale": [-1, 1, 1], "mesh": 0 }])).unwrap();
        assert_eq!(model.wood[0].triangles, [[0, 2, 1]]);
    }

    #[test]
    fn nodes_in_a_circle_and_missing_meshes_are_refused() {
        let circle = json!([{ "children": [1] }, { "children": [2] }, { "children": [1] }]);
        assert!(read(circle).unwrap_err().to_string().contains("two parents"));
        assert!(read(json!([{ "mesh": 7 }])).unwrap_err().to_string().contains("mesh 7"));
        assert!(read(json!([{ "children": [9] }])).unwrap_err().to_string().contains("node 9"));
    }

    #[test]
    fn a_small_file_cannot_unfold_without_limit() {
        // 10,000 nodes name one mesh of 10,000 parts that draw nothing.
        let parts: Vec<Primitive> = (0..10_000).map(|_| Primitive::default()).collect();
        let nodes = (0..10_000).map(|_| Node { mesh: Some(0), ..Node::default() }).collect();
        let scene = glb::Scene { nodes: (0..10_000).collect(), ..glb::Scene::default() };
        let meshes = vec![glb::MeshEntry { primitives: parts }];
        let document = Document { nodes, meshes, scenes: vec![scene], ..Document::default() };
        let error = Reader::new(Path::new("bomb.glb"), &document).scene().unwrap_err();
        assert!(error.to_string().contains("more than"), "{error}");
    }

    #[test]
    fn a_long_chain_of_nodes_does_not_exhaust_the_stack() {
        let count = 100_000;
        let chain: Vec<Json> = (0..count).map(|i| json!({ "children": [i + 1] })).collect();
        let nodes = chain.into_iter().chain([json!({ "mesh": 0 })]).collect();
        assert_eq!(read(nodes).unwrap().wood.len(), 1);
    }

    #[test]
    fn instances_follow_their_nodes_move_turn_and_even_scale() {
        let turn = DQuat::from_euler(EulerRot::XYZ, 0.3, -1.0, 2.0);
        let matrix =
            DMat4::from_scale_rotation_translation(DVec3::splat(2.0), turn, DVec3::new(1., 2., 3.));
        let place = Similarity::of(matrix).unwrap().place([4., 5., 6.], [0., 0., 0., 1.], [1.; 3]);
        let expected = matrix.transform_point3(DVec3::new(4., 5., 6.)).as_vec3();
        assert!(Vec3::from(z_up(expected.to_array())).abs_diff_eq(place.position.into(), 1e-5));
        assert_eq!(place.scale, [2.0; 3]);
        let sheared = DMat4::from_scale(DVec3::new(1.0, 2.0, 1.0));
        assert!(Similarity::of(sheared).is_none());
    }

    #[test]
    fn strips_and_fans_become_triangles() {
        assert_eq!(triangles(5, &[0, 1, 2, 3]), [[0, 1, 2], [2, 1, 3]]);
        assert_eq!(triangles(6, &[0, 1, 2, 3]), [[0, 1, 2], [0, 2, 3]]);
        assert_eq!(triangles(4, &[0, 1, 2, 3]), [[0, 1, 2]]);
    }

    #[test]
    fn a_leaf_material_shares_light_between_reflection_and_transmission() {
        let entry: MaterialEntry = serde_json::from_value(json!({
            "pbrMetallicRoughness": { "baseColorFactor": [0.5, 1.0, 0.0, 1.0] },
            "extensions": { "KHR_materials_diffuse_transmission": { "diffuseTransmissionFactor": 0.25 } },
        }))
        .unwrap();
        let leaf = material(&entry);
        assert_eq!(leaf.reflectance, [0.375, 0.75, 0.0]);
        assert_eq!(leaf.surface, Surface::Leaf { transmittance: [0.25; 3] });
        let lamp = material(
            &serde_json::from_value(json!({
                "emissiveFactor": [1.0, 0.5, 0.0],
                "extensions": { "KHR_materials_emissive_strength": { "emissiveStrength": 4000.0 } },
            }))
            .unwrap(),
        );
        assert_eq!(lamp.surface, Surface::Light { radiance: [4.0, 2.0, 0.0] });
    }
}
