//! Writing a plant as GLB.

use super::glb::{BINARY_CHUNK, JSON_CHUNK, MAGIC};
use super::y_up;
use crate::error::{Error, Result};
use crate::provenance::Provenance;
use serde_json::{Map, Value as Json, json};
use std::path::Path;
use weald_contract::{Material, Mesh, Organ, Placement, PlantModel, Surface};

/// Component type of 32-bit floats [glTF] §3.6.2.2.
const FLOAT: u32 = 5126;
/// Component type of 32-bit indices.
const UNSIGNED_INT: u32 = 5125;
/// Target of a buffer view of vertices.
const ARRAY_BUFFER: u32 = 34962;
/// Target of a buffer view of indices.
const ELEMENT_ARRAY_BUFFER: u32 = 34963;

pub(super) fn to_glb(path: &Path, model: &PlantModel, provenance: &Provenance) -> Result<Vec<u8>> {
    check(path, model)?;
    let mut scene = Scene::default();
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
    let document = scene.document(model, provenance);
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
    Ok(())
}

/// The document as it grows.
#[derive(Default)]
struct Scene {
    nodes: Vec<Json>,
    meshes: Vec<Json>,
    accessors: Vec<Json>,
    views: Vec<Json>,
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
        let rotation = self.vectors(&rotations, None, false);
        let scales = column(|place| [place.scale[0], place.scale[2], place.scale[1]]);
        let scale = self.vectors(&scales, None, false);
        json!({ "attributes": { "TRANSLATION": translation, "ROTATION": rotation, "SCALE": scale } })
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

    fn indices(&mut self, triangles: &[[u32; 3]]) -> usize {
        let bytes = triangles.as_flattened().iter().flat_map(|index| index.to_le_bytes()).collect();
        let view = self.view(bytes, Some(ELEMENT_ARRAY_BUFFER));
        self.accessors.push(json!({
            "bufferView": view, "componentType": UNSIGNED_INT,
            "count": triangles.len() * 3, "type": "SCALAR",
        }));
        self.accessors.len() - 1
    }

    /// Adds bytes, whose number is a multiple of four, and returns the index of their view.
    fn view(&mut self, mut bytes: Vec<u8>, target: Option<u32>) -> usize {
        let mut view = json!({
            "buffer": 0, "byteOffset": self.binary.len(), "byteLength": bytes.len(),
        });
        if let Some(target) = target {
            view["target"] = target.into();
        }
        self.views.push(view);
        self.binary.append(&mut bytes);
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
        let materials: Vec<Json> = model.materials.iter().map(material).collect();
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

/// A material for viewers, with our own numbers in `extras`.
///
/// glTF mixes a reflecting and a transmitting sheet: reflectance = (1 - f) · base and
/// transmittance = f · colour. Any f between the largest transmittance and one minus the largest
/// reflectance gives factors of at most 1; the share of the light that passes lies there.
fn material(material: &Material) -> Json {
    let Material { name, reflectance, roughness, surface } = material;
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
