//! The container and the JSON of a GLB [glTF] §4, §5: bytes in, checked tables out.

use crate::error::{Error, Result};
use serde::Deserialize;
use serde_json::Value as Json;
use std::path::Path;

/// First four bytes of a GLB.
pub(super) const MAGIC: u32 = 0x4654_6C67;
/// Kind of the chunk that holds the JSON.
pub(super) const JSON_CHUNK: u32 = 0x4E4F_534A;
/// Kind of the chunk that holds the numbers.
pub(super) const BINARY_CHUNK: u32 = 0x004E_4942;

/// The parts of a glTF document that we understand.
#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Document {
    pub asset: Asset,
    pub extensions_required: Vec<String>,
    pub scene: Option<usize>,
    pub scenes: Vec<Scene>,
    pub nodes: Vec<Node>,
    pub meshes: Vec<MeshEntry>,
    pub materials: Vec<MaterialEntry>,
    pub accessors: Vec<Accessor>,
    pub buffer_views: Vec<BufferView>,
    pub textures: Vec<TextureEntry>,
    pub images: Vec<ImageEntry>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct TextureEntry {
    pub source: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct ImageEntry {
    pub name: Option<String>,
    pub buffer_view: Option<usize>,
}

/// A texture as a material names it.
#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct TextureInfo {
    pub index: usize,
    pub tex_coord: usize,
    pub extensions: TextureExtensions,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct TextureExtensions {
    #[serde(rename = "KHR_texture_transform")]
    pub transform: Option<TextureTransform>,
}

#[derive(Clone, Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct TextureTransform {
    pub offset: [f32; 2],
    pub rotation: f32,
    pub scale: Option<[f32; 2]>,
}

/// Accessors of the columns of the table of branches that wind moves.
#[derive(Debug, Deserialize)]
pub(super) struct BranchColumns {
    pub parent: usize,
    pub pivot: usize,
    pub stiffness: usize,
    pub phase: usize,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Asset {
    pub version: String,
    pub extras: Json,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Scene {
    pub name: Option<String>,
    pub nodes: Vec<usize>,
    pub extras: Json,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Node {
    pub name: Option<String>,
    pub mesh: Option<usize>,
    pub children: Vec<usize>,
    pub matrix: Option<[f64; 16]>,
    pub translation: Option<[f64; 3]>,
    pub rotation: Option<[f64; 4]>,
    pub scale: Option<[f64; 3]>,
    pub extensions: NodeExtensions,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct NodeExtensions {
    #[serde(rename = "EXT_mesh_gpu_instancing")]
    pub instancing: Option<Instancing>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Instancing {
    pub attributes: InstanceAttributes,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "UPPERCASE")]
pub(super) struct InstanceAttributes {
    pub translation: Option<usize>,
    pub rotation: Option<usize>,
    pub scale: Option<usize>,
    #[serde(rename = "_BRANCH")]
    pub branch: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct MeshEntry {
    pub primitives: Vec<Primitive>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Primitive {
    pub attributes: Attributes,
    pub indices: Option<usize>,
    pub material: Option<usize>,
    pub mode: Option<u32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct Attributes {
    #[serde(rename = "POSITION")]
    pub position: Option<usize>,
    #[serde(rename = "NORMAL")]
    pub normal: Option<usize>,
    #[serde(rename = "TEXCOORD_0")]
    pub uv: Option<usize>,
    #[serde(rename = "_BRANCH")]
    pub branch: Option<usize>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct MaterialEntry {
    pub name: Option<String>,
    pub pbr_metallic_roughness: Pbr,
    pub emissive_factor: Option<[f32; 3]>,
    pub alpha_mode: Option<String>,
    pub alpha_cutoff: Option<f32>,
    pub extensions: MaterialExtensions,
    pub extras: Json,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Pbr {
    pub base_color_factor: Option<[f32; 4]>,
    pub base_color_texture: Option<TextureInfo>,
    pub roughness_factor: Option<f32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default)]
pub(super) struct MaterialExtensions {
    #[serde(rename = "KHR_materials_diffuse_transmission")]
    pub transmission: Option<Transmission>,
    #[serde(rename = "KHR_materials_emissive_strength")]
    pub emission: Option<Emission>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Emission {
    pub emissive_strength: Option<f32>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Transmission {
    pub diffuse_transmission_factor: f32,
    pub diffuse_transmission_color_factor: Option<[f32; 3]>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct Accessor {
    pub buffer_view: Option<usize>,
    pub byte_offset: usize,
    pub component_type: u32,
    pub normalized: bool,
    pub count: usize,
    #[serde(rename = "type")]
    pub shape: String,
    pub sparse: Option<Json>,
}

#[derive(Debug, Default, Deserialize)]
#[serde(default, rename_all = "camelCase")]
pub(super) struct BufferView {
    pub buffer: usize,
    pub byte_offset: usize,
    pub byte_length: usize,
    pub byte_stride: Option<usize>,
}

/// Splits a GLB into its document and its numbers.
pub(super) fn open<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Document, &'a [u8])> {
    let damaged = |message: &str| {
        Error::invalid(
            path,
            format!("this is not a readable GLB: {message}"),
            "it may be cut short",
        )
    };
    let mut words = Words { bytes };
    let header = (words.next(), words.next(), words.next());
    let (Some(MAGIC), Some(2), Some(length)) = header else {
        return Err(damaged("its header is not that of version 2"));
    };
    if length as usize > bytes.len() {
        return Err(damaged("it is shorter than its header says"));
    }
    let (json, mut words) = chunk(words, JSON_CHUNK).ok_or_else(|| damaged("it has no JSON"))?;
    let document: Document = serde_json::from_slice(json)
        .map_err(|error| damaged(&format!("its JSON is wrong: {error}")))?;
    if !document.asset.version.starts_with("2.") {
        return Err(damaged("it is not glTF 2"));
    }
    // The numbers are optional and, if there, the second chunk.
    let mut binary: &[u8] = &[];
    if !words.bytes.is_empty() {
        (binary, words) =
            chunk(words, BINARY_CHUNK).ok_or_else(|| damaged("its second chunk is cut short"))?;
    }
    let _ = words;
    Ok((document, binary))
}

/// Little-endian words at the head of a slice.
#[derive(Clone, Copy)]
struct Words<'a> {
    bytes: &'a [u8],
}

impl Words<'_> {
    fn next(&mut self) -> Option<u32> {
        let (word, rest) = self.bytes.split_first_chunk::<4>()?;
        self.bytes = rest;
        Some(u32::from_le_bytes(*word))
    }
}

fn chunk(mut words: Words<'_>, kind: u32) -> Option<(&[u8], Words<'_>)> {
    let length = words.next()? as usize;
    (words.next()? == kind).then_some(())?;
    let (body, rest) = words.bytes.split_at_checked(length)?;
    Some((body, Words { bytes: rest }))
}

/// Reads accessors of a document, checking every bound.
pub(super) struct Numbers<'a> {
    pub path: &'a Path,
    pub document: &'a Document,
    pub binary: &'a [u8],
}

impl Numbers<'_> {
    /// Vectors of `N` numbers; integers are taken as normalized.
    pub fn vectors<const N: usize>(&self, index: usize) -> Result<Vec<[f32; N]>> {
        let shape = ["SCALAR", "VEC2", "VEC3", "VEC4"].get(N - 1).copied().unwrap_or_default();
        let elements = self.elements(index, shape, N)?;
        let vector = |bytes: &[u8]| {
            let mut vector = [0.0; N];
            let width = bytes.len() / N;
            for (number, part) in vector.iter_mut().zip(bytes.chunks_exact(width.max(1))) {
                *number = component(elements.kind, part);
            }
            vector
        };
        let vectors: Vec<[f32; N]> = elements.iter().map(vector).collect();
        match vectors.iter().flatten().all(|number| number.is_finite()) {
            true => Ok(vectors),
            false => Err(self.wrong(index, "holds a number that is not finite")),
        }
    }

    /// Vertex indices.
    pub fn indices(&self, index: usize) -> Result<Vec<u32>> {
        let elements = self.elements(index, "SCALAR", 1)?;
        let number = |bytes: &[u8]| match *bytes {
            [a] => u32::from(a),
            [a, b] => u32::from(u16::from_le_bytes([a, b])),
            [a, b, c, d] => u32::from_le_bytes([a, b, c, d]),
            _ => u32::MAX,
        };
        match elements.kind {
            5121 | 5123 | 5125 => Ok(elements.iter().map(number).collect()),
            _ => Err(self.wrong(index, "holds indices that are not whole numbers")),
        }
    }

    fn elements(&self, index: usize, shape: &str, parts: usize) -> Result<Elements<'_>> {
        let accessor = self.document.accessors.get(index);
        let accessor = accessor.ok_or_else(|| self.wrong(index, "does not exist"))?;
        if accessor.shape != shape {
            return Err(self.wrong(index, &format!("is no {shape}")));
        }
        let (Some(view), None) = (accessor.buffer_view, &accessor.sparse) else {
            let message = format!("accessor {index} is sparse, which");
            return Err(Error::unsupported(self.path, message, "plain ones are"));
        };
        let width = match accessor.component_type {
            5120 | 5121 => 1,
            5122 | 5123 => 2,
            5125 | 5126 => 4,
            _ => return Err(self.wrong(index, "has an unknown component type")),
        };
        let is_whole = accessor.component_type != 5126;
        if parts > 1 && is_whole && !accessor.normalized {
            return Err(self.wrong(index, "holds integers that are not normalized"));
        }
        let bytes = self.view(view).ok_or_else(|| self.wrong(index, "reaches outside the file"))?;
        let size = width * parts;
        let stride = self.document.buffer_views.get(view).and_then(|view| view.byte_stride);
        let stride = stride.filter(|&stride| stride > 0).unwrap_or(size);
        let elements = Elements::new(bytes, accessor, size, stride);
        elements.ok_or_else(|| self.wrong(index, "reaches outside its part of the file"))
    }

    /// The bytes of a view, if they lie inside the file.
    pub fn view(&self, index: usize) -> Option<&[u8]> {
        let view = self.document.buffer_views.get(index)?;
        let end = view.byte_offset.checked_add(view.byte_length)?;
        // Buffer 0 is the one inside the file; others would be files beside it.
        if view.buffer == 0 { self.binary.get(view.byte_offset..end) } else { None }
    }

    fn wrong(&self, index: usize, what: &str) -> Error {
        Error::invalid(self.path, format!("accessor {index} {what}"), "the file is damaged")
    }
}

/// The elements of an accessor, known to lie inside the file.
struct Elements<'a> {
    bytes: &'a [u8],
    kind: u32,
    count: usize,
    size: usize,
    stride: usize,
}

impl<'a> Elements<'a> {
    fn new(bytes: &'a [u8], accessor: &Accessor, size: usize, stride: usize) -> Option<Self> {
        let bytes = bytes.get(accessor.byte_offset..)?;
        let count = accessor.count;
        let last = count.saturating_sub(1).checked_mul(stride)?;
        let end = if count == 0 { 0 } else { last.checked_add(size)? };
        // Elements that overlap would let a small file ask for much memory.
        (stride >= size && end <= bytes.len()).then_some(Self {
            bytes,
            kind: accessor.component_type,
            count,
            size,
            stride,
        })
    }

    fn iter(&self) -> impl Iterator<Item = &[u8]> {
        let element = |i: usize| {
            let start = i * self.stride;
            self.bytes.get(start..start + self.size).unwrap_or_default()
        };
        (0..self.count).map(element)
    }
}

/// One component as a float; integers are normalized [glTF] §3.11.
fn component(kind: u32, bytes: &[u8]) -> f32 {
    match (kind, bytes) {
        (5126, &[a, b, c, d]) => f32::from_le_bytes([a, b, c, d]),
        (5120, &[a]) => (f32::from(a as i8) / 127.0).max(-1.0),
        (5121, &[a]) => f32::from(a) / 255.0,
        (5122, &[a, b]) => (f32::from(i16::from_le_bytes([a, b])) / 32767.0).max(-1.0),
        (5123, &[a, b]) => f32::from(u16::from_le_bytes([a, b])) / 65535.0,
        _ => f32::NAN,
    }
}
