//! Writing a plant as GLB.

use super::glb::{BINARY_CHUNK, JSON_CHUNK, MAGIC};
use super::{texture, y_up};
use crate::error::{Error, Result};
use crate::provenance::Provenance;
use serde_json::{Map, Value as Json, json};
use std::path::Path;
use weald_contract::{Branch, Material, Mesh, Organ, Paint, Placement, PlantModel, Surface};

/// Component type of 32-bit floats [glTF] §3.6.2.2.
const FLOAT: u32 = 5126;
/// Component type of 32-bit indices.
const UNSIGNED_INT: u32 = 5125;
/// Component type of 16-bit indices.
const UNSIGNED_SHORT: u32 = 5123;
/// Component type of 16-bit numbers in [-1, 1].
const SHORT: u32 = 5122;
/// Target of a buffer view of vertices.
const ARRAY_BUFFER: u32 = 34962;
/// Target of a buffer view of indices.
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

pub(super) fn to_glb(path: &Path, model: &PlantModel, provenance: &Provenance) -> Result<Vec<u8>> {
    check(path, model)?;
    let mut scene = Scene::default();
    for texture in &model.textures {
        let view = scene.view(texture::to_png(path, texture)?, None);
        let image = json!({ "name": texture.name, "bufferView": view, "mimeType": "image/png" });
        scene.images.push(image);
    }
    for mesh in model.wood.iter().filter(|mesh| draws(mesh)) {
        let primitive = scene.primitive(mesh);
        scene.node("wood", vec![primitive], None);
    }
    for organ in model.organs.iter().filter(|organ| !organ.placements.is_empty()) {
        let drawn = organ.meshes.iter().filter(|mesh| draws(mesh));
        let primitives: Vec<Json> = drawn.map(|mesh| scene.primitive(mesh)).collect();
        if !primitives.is_empty() {
            let instancing = scene.instancing(organ);
            scene.node(&organ.name, primitives, Some(instancing));
        }
    }
    let branches = scene.branches(&model.branches);
    let mut document = scene.document(model, provenance);
    if let Some(branches) = branches {
        document["scenes"][0]["extras"] = json!({ "weald": { "branches": branches } });
    }
    assemble(path, &document, scene.binary)
}

fn draws(mesh: &Mesh) -> bool {
    !mesh.triangles.is_empty()
}

fn check(path: &Path, model: &PlantModel) -> Result<()> {
    let organs = model.organs.iter().flat_map(|organ| {
        organ.meshes.iter().enumerate().map(move |mesh| (organ.name.as_str(), mesh))
    });
    let wood = model.wood.iter().enumerate().map(|mesh| ("wood", mesh));
    for (part, (index, mesh)) in wood.chain(organs) {
        let finite = |numbers: &[f32]| numbers.iter().all(|number| number.is_finite());
        let is_finite = finite(mesh.positions.as_flattened())
            && finite(mesh.normals.as_flattened())
            && finite(mesh.uvs.as_flattened());
        if draws(mesh) && !(is_finite && mesh.is_sound(model.materials.len())) {
            let message = format!("mesh {index} of the {part} is unsound");
            let hint = "indices must be in range, columns of equal length and numbers finite";
            return Err(Error::invalid(path, message, hint));
        }
    }
    for organ in &model.organs {
        let finite = |place: &Placement| {
            let numbers = place.position.iter().chain(&place.rotation).chain(&place.scale);
            numbers.into_iter().all(|number| number.is_finite())
        };
        if !organ.placements.iter().all(finite) {
            let message = format!("a place of organ `{}` is not finite", organ.name);
            return Err(Error::invalid(path, message, ""));
        }
    }
    check_paint(path, model)?;
    check_branches(path, model)
}

fn check_paint(path: &Path, model: &PlantModel) -> Result<()> {
    if let Some(texture) = model.textures.iter().find(|texture| !texture.is_sound()) {
        let message = format!("the texture `{}` has not one texel a place", texture.name);
        return Err(Error::invalid(path, message, ""));
    }
    for material in &model.materials {
        let is_sound = |paint: &Paint| {
            (paint.texture as usize) < model.textures.len()
                && paint.size.iter().all(|side| side.is_finite() && *side > 0.0)
        };
        let fits = material.paint.as_ref().is_none_or(is_sound)
            && material.cutout.is_none_or(|cutout| cutout > 0.0 && cutout <= 1.0);
        if !fits {
            let message = format!("the paint of material `{}` is unsound", material.name);
            let hint = "its texture must exist, its size be positive and its cutout in (0, 1]";
            return Err(Error::invalid(path, message, hint));
        }
    }
    Ok(())
}

fn check_branches(path: &Path, model: &PlantModel) -> Result<()> {
    let mut found = model.branches.iter().enumerate();
    let is_sound = |(index, branch): (usize, &Branch)| {
        let mut numbers = branch.pivot.iter().chain([&branch.stiffness, &branch.phase]);
        branch.parent.is_none_or(|parent| (parent as usize) < index)
            && numbers.all(|number| number.is_finite())
    };
    let meshes = model.wood.iter().chain(model.organs.iter().flat_map(|organ| &organ.meshes));
    let lists = meshes.map(|mesh| &mesh.branches).chain(model.organs.iter().map(|o| &o.branches));
    let exists = |index: &u32| (*index as usize) < model.branches.len();
    let is_complete = |organ: &Organ| [0, organ.placements.len()].contains(&organ.branches.len());
    if found.all(is_sound)
        && lists.flatten().all(exists)
        && model.organs.iter().all(is_complete)
        // The file keeps indices as floats, which are exact below this.
        && model.branches.len() < 1 << 24
    {
        return Ok(());
    }
    let hint = "bearers come first, indices are in range and there is one a vertex or place";
    Err(Error::invalid(path, "the branches that wind moves are unsound".to_owned(), hint))
}

/// The document as it grows.
#[derive(Default)]
struct Scene {
    nodes: Vec<Json>,
    meshes: Vec<Json>,
    accessors: Vec<Json>,
    views: Vec<Json>,
    images: Vec<Json>,
    binary: Vec<u8>,
    has_instances: bool,
}

impl Scene {
    fn node(&mut self, name: &str, primitives: Vec<Json>, instancing: Option<Json>) {
        let mesh = self.meshes.len();
        self.meshes.push(json!({ "name": name, "primitives": primitives }));
        let mut node = json!({ "name": name, "mesh": mesh });
        if let Some(instancing) = instancing {
            node["extensions"] = json!({ "EXT_mesh_gpu_instancing": instancing });
            self.has_instances = true;
        }
        self.nodes.push(node);
    }

    fn primitive(&mut self, mesh: &Mesh) -> Json {
        let positions: Vec<[f32; 3]> = mesh.positions.iter().map(|&p| y_up(p)).collect();
        let mut attributes = Map::new();
        let position = self.vectors(&positions, Some(ARRAY_BUFFER), true);
        attributes.insert("POSITION".into(), position.into());
        if !mesh.normals.is_empty() {
            let normals: Vec<[f32; 3]> = mesh.normals.iter().map(|&n| y_up(n)).collect();
            let normal = self.vectors(&normals, Some(ARRAY_BUFFER), false);
            attributes.insert("NORMAL".into(), normal.into());
        }
        if !mesh.uvs.is_empty() {
            let uv = self.vectors(&mesh.uvs, Some(ARRAY_BUFFER), false);
            attributes.insert("TEXCOORD_0".into(), uv.into());
        }
        if let Some(branch) = self.branch_column(&mesh.branches, Some(ARRAY_BUFFER)) {
            attributes.insert("_BRANCH".into(), branch.into());
        }
        let indices = self.indices(&mesh.triangles);
        json!({ "attributes": attributes, "indices": indices, "material": mesh.material })
    }

    fn instancing(&mut self, organ: &Organ) -> Json {
        let column = |get: fn(&Placement) -> [f32; 3]| -> Vec<[f32; 3]> {
            organ.placements.iter().map(get).collect()
        };
        // A rotation's axis turns like any vector; scales follow their axes without sign.
        let turn = |place: &Placement| {
            let [x, y, z, w] = place.rotation;
            let [x, y, z] = y_up([x, y, z]);
            [x, y, z, w]
        };
        let rotations: Vec<[f32; 4]> = organ.placements.iter().map(turn).collect();
        let translation = self.vectors(&column(|place| y_up(place.position)), None, true);
        let rotation = self.rotations(&rotations);
        let scales = column(|place| [place.scale[0], place.scale[2], place.scale[1]]);
        let scale = self.vectors(&scales, None, false);
        let mut attributes =
            json!({ "TRANSLATION": translation, "ROTATION": rotation, "SCALE": scale });
        if let Some(branch) = self.branch_column(&organ.branches, None) {
            attributes["_BRANCH"] = branch.into();
        }
        json!({ "attributes": attributes })
    }

    /// Adds the branch of each vertex or place; glTF allows no 32-bit integers here.
    fn branch_column(&mut self, branches: &[u32], target: Option<u32>) -> Option<usize> {
        let numbers: Vec<[f32; 1]> = branches.iter().map(|&index| [index as f32]).collect();
        (!numbers.is_empty()).then(|| self.vectors(&numbers, target, false))
    }

    /// Adds the table of branches; returns the accessor of each of its columns.
    fn branches(&mut self, branches: &[Branch]) -> Option<Json> {
        if branches.is_empty() {
            return None;
        }
        let mut column = |get: &dyn Fn(&Branch) -> f32| {
            let numbers: Vec<[f32; 1]> = branches.iter().map(|branch| [get(branch)]).collect();
            self.vectors(&numbers, None, false)
        };
        let parent = column(&|branch| branch.parent.map_or(-1.0, |index| index as f32));
        let stiffness = column(&|branch| branch.stiffness);
        let phase = column(&|branch| branch.phase);
        let pivots: Vec<[f32; 3]> = branches.iter().map(|branch| y_up(branch.pivot)).collect();
        let pivot = self.vectors(&pivots, None, false);
        Some(json!({ "parent": parent, "pivot": pivot, "stiffness": stiffness, "phase": phase }))
    }

    /// Adds an accessor of vectors; returns its index.
    fn vectors<const N: usize>(
        &mut self,
        vectors: &[[f32; N]],
        target: Option<u32>,
        has_bounds: bool,
    ) -> usize {
        let view = self.view(bytemuck_le(vectors.as_flattened()), target);
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"][N - 1];
        let mut accessor = json!({
            "bufferView": view, "componentType": FLOAT, "count": vectors.len(), "type": shape,
        });
        if has_bounds {
            let bound = |pick: fn(f32, f32) -> f32| -> Vec<f32> {
                let along = |axis: usize| vectors.iter().map(|v| v[axis]).reduce(pick);
                (0..N).map(|axis| along(axis).unwrap_or(0.0)).collect()
            };
            accessor["min"] = json!(bound(f32::min));
            accessor["max"] = json!(bound(f32::max));
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    /// Adds rotations: as 16-bit numbers where those are the same, which the extension allows.
    fn rotations(&mut self, rotations: &[[f32; 4]]) -> usize {
        let short = |part: f32| -> Option<i16> {
            let whole = (part * 32767.0).round();
            // As they will be read.
            let back = f32::from(whole as i16) / 32767.0;
            (whole.abs() <= 32767.0 && back == part).then_some(whole as i16)
        };
        let shorts: Option<Vec<i16>> = rotations.as_flattened().iter().map(|p| short(*p)).collect();
        let Some(shorts) = shorts else { return self.vectors(rotations, None, false) };
        let view = self.view(shorts.iter().flat_map(|part| part.to_le_bytes()).collect(), None);
        self.accessors.push(json!({
            "bufferView": view, "componentType": SHORT, "normalized": true,
            "count": rotations.len(), "type": "VEC4",
        }));
        self.accessors.len() - 1
    }

    /// Adds the indices of triangles: in 16 bits where that is enough.
    fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let indices = triangles.as_flattened();
        // The largest 16-bit index restarts strips and is not allowed.
        let is_short = indices.iter().all(|&index| index < u32::from(u16::MAX));
        let (bytes, kind) = if is_short {
            let short = |&index: &u32| (index as u16).to_le_bytes();
            (indices.iter().flat_map(short).collect(), UNSIGNED_SHORT)
        } else {
            (indices.iter().flat_map(|index| index.to_le_bytes()).collect(), UNSIGNED_INT)
        };
        let view = self.view(bytes, Some(ELEMENT_ARRAY_BUFFER));
        self.accessors.push(json!({
            "bufferView": view, "componentType": kind,
            "count": triangles.len() * 3, "type": "SCALAR",
        }));
        self.accessors.len() - 1
    }

    /// Adds bytes and returns the index of their view.
    fn view(&mut self, mut bytes: Vec<u8>, target: Option<u32>) -> usize {
        let mut view = json!({
            "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len(),
        });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.views.push(view);
        self.binary.append(&mut bytes);
        // Every view begins at a multiple of four.
        self.binary.resize(self.binary.len().next_multiple_of(4), 0);
        self.views.len() - 1
    }

    fn document(&mut self, model: &PlantModel, provenance: &Provenance) -> Json {
        let mut extensions = Vec::new();
        if self.has_instances {
            extensions.push("EXT_mesh_gpu_instancing");
        }
        let is_leaf = |material: &Material| matches!(material.surface, Surface::Leaf { .. });
        if model.materials.iter().any(is_leaf) {
            extensions.push("KHR_materials_diffuse_transmission");
        }
        let is_light = |material: &Material| matches!(material.surface, Surface::Light { .. });
        if model.materials.iter().any(is_light) {
            extensions.push("KHR_materials_emissive_strength");
        }
        let is_scaled = |material: &Material| material.paint.is_some_and(|p| p.size != [1.0; 2]);
        if model.materials.iter().any(is_scaled) {
            extensions.push("KHR_texture_transform");
        }
        let mut document = json!({
            "asset": {
                "version": "2.0",
                "generator": format!("weald {}", provenance.version),
                "extras": { "weald": provenance },
            },
            "scene": 0,
            "scenes": [{ "name": model.name }],
        });
        let nodes: Vec<usize> = (0..self.nodes.len()).collect();
        let materials: Vec<Json> = model.materials.iter().map(painted).collect();
        let textures: Vec<Json> =
            (0..self.images.len()).map(|i| json!({ "source": i, "sampler": 0 })).collect();
        let mut set = |name: &str, list: Vec<Json>| {
            // glTF forbids empty lists.
            if !list.is_empty() {
                document[name] = list.into();
            }
        };
        set("extensionsUsed", extensions.into_iter().map(Json::from).collect());
        set("nodes", std::mem::take(&mut self.nodes));
        set("meshes", std::mem::take(&mut self.meshes));
        set("materials", materials);
        if !textures.is_empty() {
            // Linear between texels and levels; repeated, as is the default.
            set("samplers", vec![json!({ "magFilter": 9729, "minFilter": 9987 })]);
        }
        set("textures", textures);
        set("images", std::mem::take(&mut self.images));
        set("accessors", std::mem::take(&mut self.accessors));
        set("bufferViews", std::mem::take(&mut self.views));
        if !self.binary.is_empty() {
            set("buffers", vec![json!({ "byteLength": self.binary.len() })]);
        }
        if !nodes.is_empty() {
            document["scenes"][0]["nodes"] = nodes.into();
        }
        document
    }
}

fn bytemuck_le(numbers: &[f32]) -> Vec<u8> {
    numbers.iter().flat_map(|number| number.to_le_bytes()).collect()
}

/// A material with its texture.
fn painted(material: &Material) -> Json {
    let mut json = plain(material);
    if let Some(cutout) = material.cutout {
        json["alphaMode"] = "MASK".into();
        json["alphaCutoff"] = cutout.into();
    }
    let Some(Paint { texture, size }) = material.paint else { return json };
    let mut info = json!({ "index": texture });
    if size != [1.0; 2] {
        let scale = size.map(|side| 1.0 / side);
        info["extensions"] = json!({ "KHR_texture_transform": { "scale": scale } });
        json["extras"]["weald"]["size"] = json!(size);
    }
    if matches!(material.surface, Surface::Leaf { .. }) {
        json["extensions"]["KHR_materials_diffuse_transmission"]["diffuseTransmissionColorTexture"] =
            info.clone();
    }
    json["pbrMetallicRoughness"]["baseColorTexture"] = info;
    json
}

/// A material for viewers, with our own numbers in `extras`.
///
/// glTF mixes a reflecting and a transmitting sheet: reflectance = (1 - f) · base and
/// transmittance = f · colour. Any f between the largest transmittance and one minus the largest
/// reflectance gives factors of at most 1; the share of the light that passes lies there.
fn plain(material: &Material) -> Json {
    let Material { name, reflectance, roughness, surface, .. } = material;
    let pbr = |[r, g, b]: [f32; 3]| {
        json!({
            "baseColorFactor": [r, g, b, 1.0], "metallicFactor": 0.0, "roughnessFactor": roughness,
        })
    };
    match surface {
        Surface::Opaque => json!({
            "name": name,
            "pbrMetallicRoughness": pbr(reflectance.map(unit)),
            "extras": { "weald": { "reflectance": reflectance } },
        }),
        Surface::Light { radiance } => {
            let most = radiance.iter().copied().fold(0.0, f32::max);
            let factor = radiance.map(|part| if most > 0.0 { unit(part / most) } else { 0.0 });
            json!({
                "name": name,
                "pbrMetallicRoughness": pbr(reflectance.map(unit)),
                "emissiveFactor": factor,
                "extensions": { "KHR_materials_emissive_strength": {
                    "emissiveStrength": 1000.0 * most,
                } },
                "extras": { "weald": { "reflectance": reflectance, "radiance": radiance } },
            })
        }
        Surface::Leaf { transmittance } => {
            let largest = |color: &[f32; 3]| color.iter().copied().fold(0.0, f32::max);
            let (reflected, passed) = (largest(reflectance), largest(transmittance));
            let both = reflected + passed;
            let factor = if both > 0.0 { unit(passed / both) } else { 0.0 };
            let divide = |color: &[f32; 3], by: f32| {
                color.map(|part| if by > 0.0 { unit(part / by) } else { 0.0 })
            };
            json!({
                "name": name,
                "doubleSided": true,
                "pbrMetallicRoughness": pbr(divide(reflectance, 1.0 - factor)),
                "extensions": { "KHR_materials_diffuse_transmission": {
                    "diffuseTransmissionFactor": factor,
                    "diffuseTransmissionColorFactor": divide(transmittance, factor),
                } },
                "extras": { "weald": { "reflectance": reflectance, "transmittance": transmittance } },
            })
        }
    }
}

fn unit(number: f32) -> f32 {
    number.clamp(0.0, 1.0)
}

fn assemble(path: &Path, document: &Json, mut binary: Vec<u8>) -> Result<Vec<u8>> {
    let mut json = document.to_string().into_bytes();
    json.resize(json.len().next_multiple_of(4), b' ');
    binary.resize(binary.len().next_multiple_of(4), 0);
    let chunks = [(JSON_CHUNK, json), (BINARY_CHUNK, binary)];
    let chunks: Vec<_> = chunks.into_iter().filter(|(_, body)| !body.is_empty()).collect();
    let length = 12 + chunks.iter().map(|(_, body)| 8 + body.len()).sum::<usize>();
    let Ok(total) = u32::try_from(length) else {
        let message = format!("a model of {length} bytes");
        return Err(Error::unsupported(path, message, "a GLB holds at most 4 GiB"));
    };
    let mut bytes = Vec::with_capacity(length);
    for word in [MAGIC, 2, total] {
        bytes.extend_from_slice(&word.to_le_bytes());
    }
    for (kind, body) in chunks {
        // Each chunk is shorter than the whole, whose length fits.
        bytes.extend_from_slice(&(body.len() as u32).to_le_bytes());
        bytes.extend_from_slice(&kind.to_le_bytes());
        bytes.extend_from_slice(&body);
    }
    Ok(bytes)
}
