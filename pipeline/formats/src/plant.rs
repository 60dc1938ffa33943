//! Plant models as GLB: ours exactly both ways, anyone's as plain geometry.
//!
//! glTF has Y up, we have Z up: every vector (x, y, z) is written as (x, z, -y), so that viewers
//! show plants upright without a turned root node.

mod glb;
mod read;
pub(crate) mod texture;
mod write;

use crate::bytes::{MAX_FILE_BYTES, read_bounded};
use crate::error::Result;
use crate::provenance::Provenance;
use crate::whole::write_atomically;
use glam::{Quat, Vec3};
use std::io::Write;
use std::path::Path;
use weald_contract::{Mesh, Organ, Placement, PlantModel};

/// Most vertices, triangles and placements of a model that is read: about a gigabyte.
pub(crate) const MAX_ITEMS: usize = 1 << 25;

/// Vertices at which [`flatten`] begins another mesh, so that 32-bit indices reach all.
const FLAT_VERTICES: usize = 1 << 30;

/// Writes a model as `.glb`.
///
/// Meshes without triangles, and organs without places, draw nothing and are left out.
///
/// # Errors
/// When a mesh is unsound (an index out of range, a number that is not finite), the model needs
/// more than 4 GiB, or the disk refuses.
pub fn write_plant(path: &Path, model: &PlantModel, provenance: &Provenance) -> Result<()> {
    let bytes = write::to_glb(path, model, provenance)?;
    write_atomically(path, |file| Ok(file.write_all(&bytes)?))
}

/// Reads a model, ours or anyone's `.glb`.
///
/// Nodes are flattened: their transforms are applied to the meshes, which become
/// [`PlantModel::wood`]. Nodes with `EXT_mesh_gpu_instancing` become organs. Of materials, base
/// colour with its texture, cut-outs, roughness and diffuse transmission are kept.
///
/// # Errors
/// When the file is damaged, larger than we read, or compressed by an extension.
pub fn read_plant(path: &Path) -> Result<PlantModel> {
    parse_plant(path, &read_bounded(path, MAX_FILE_BYTES)?)
}

/// Reads a model of any kind that we know: `.glb`, or `.obj` with its materials beside it.
///
/// # Errors
/// As [`read_plant`] and [`crate::read_obj`].
pub fn read_model(path: &Path) -> Result<PlantModel> {
    match path.extension().map(|extension| extension.to_ascii_lowercase()) {
        Some(extension) if extension == "obj" => crate::read_obj(path),
        _ => read_plant(path),
    }
}

/// Reads a model from bytes; `path` is for messages and the model's name only.
///
/// # Errors
/// As [`read_plant`].
pub fn parse_plant(path: &Path, bytes: &[u8]) -> Result<PlantModel> {
    read::from_glb(path, bytes)
}

/// The provenance inside a model, if any.
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    let bytes = read_bounded(path, MAX_FILE_BYTES)?;
    let (document, _) = glb::open(path, &bytes)?;
    let extras = document.asset.extras;
    Ok(extras.get("weald").and_then(|json| serde_json::from_value(json.clone()).ok()))
}

/// A copy of the model with every organ's geometry repeated at each of its places, for viewers
/// that do not know instancing.
pub fn flatten(model: &PlantModel) -> PlantModel {
    let mut flat = PlantModel { organs: Vec::new(), ..model.clone() };
    for organ in &model.organs {
        for mesh in &organ.meshes {
            flatten_mesh(mesh, organ, &mut flat.wood);
        }
    }
    flat
}

fn flatten_mesh(mesh: &Mesh, organ: &Organ, wood: &mut Vec<Mesh>) {
    let places_per_mesh = (FLAT_VERTICES / mesh.positions.len().max(1)).max(1);
    let mut first = 0;
    for places in organ.placements.chunks(places_per_mesh) {
        let mut whole = Mesh { material: mesh.material, ..Mesh::default() };
        for place in places {
            append(mesh, place, &mut whole);
        }
        let count = mesh.positions.len();
        let borne = organ.branches.get(first..).unwrap_or_default().iter().take(places.len());
        whole.branches = borne.flat_map(|&branch| std::iter::repeat_n(branch, count)).collect();
        first += places.len();
        wood.push(whole);
    }
}

fn append(mesh: &Mesh, place: &Placement, whole: &mut Mesh) {
    let rotation = Quat::from_array(place.rotation);
    let (scale, position) = (Vec3::from(place.scale), Vec3::from(place.position));
    let first = whole.positions.len() as u32;
    let place_of = |p: &[f32; 3]| (position + rotation * (scale * Vec3::from(*p))).to_array();
    whole.positions.extend(mesh.positions.iter().map(place_of));
    // Normals scale inversely; an organ squeezed flat keeps the direction it had.
    let inverse = Vec3::select(scale.cmpeq(Vec3::ZERO), Vec3::ONE, scale.recip());
    let turn = |n: &[f32; 3]| {
        (rotation * (inverse * Vec3::from(*n))).normalize_or(Vec3::from(*n)).to_array()
    };
    whole.normals.extend(mesh.normals.iter().map(turn));
    whole.uvs.extend(&mesh.uvs);
    let is_mirrored = scale.element_product() < 0.0;
    let triangle = |&[a, b, c]: &[u32; 3]| match is_mirrored {
        true => [first + a, first + c, first + b],
        false => [first + a, first + b, first + c],
    };
    whole.triangles.extend(mesh.triangles.iter().map(triangle));
}

/// glTF's vector of ours.
fn y_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    [x, z, -y]
}

/// Our vector of glTF's.
pub(crate) fn z_up([x, y, z]: [f32; 3]) -> [f32; 3] {
    [x, -z, y]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;
    use proptest::prelude::*;
    use weald_contract::{Branch, Material, Paint, Surface, Texture};

    /// A trunk of two triangles and a leaf in three places.
    pub(super) fn sapling() -> PlantModel {
        let material = |name: &str, surface| Material {
            name: name.into(),
            reflectance: [0.1, 0.3, 1.0 / 3.0],
            roughness: 0.7,
            surface,
            paint: None,
            cutout: None,
        };
        let leaf = Surface::Leaf { transmittance: [0.05, 0.4, 0.1] };
        let trunk = Mesh {
            positions: vec![[0.0, 0.0, 0.0], [0.1, 0.0, 0.0], [0.1, -0.0, 2.0], [0.0, 0.2, 2.0]],
            normals: vec![[0.0, -1.0, 0.0]; 4],
            uvs: vec![[0.0, 0.0], [0.1, 0.0], [0.1, 2.0], [0.0, 2.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            material: 0,
            branches: Vec::new(),
        };
        let blade = Mesh {
            positions: vec![[0.0, 0.0, 0.0], [0.01, 0.05, 0.0], [-0.01, 0.05, 0.003]],
            normals: Vec::new(),
            uvs: Vec::new(),
            triangles: vec![[0, 1, 2]],
            material: 1,
            branches: Vec::new(),
        };
        let place = |height: f32, sign: f32| Placement {
            position: [0.05 * sign, 0.3, height],
            rotation: Quat::from_euler(glam::EulerRot::ZYX, height, 0.3, -sign).to_array(),
            scale: [1.0, 0.5 + height, 1.5],
        };
        PlantModel {
            name: "aspen-3 \"ä\"".into(),
            materials: vec![material("bark", Surface::Opaque), material("leaf", leaf)],
            wood: vec![trunk.clone(), Mesh { normals: Vec::new(), uvs: Vec::new(), ..trunk }],
            organs: vec![Organ {
                name: "leaf".into(),
                meshes: vec![blade.clone(), Mesh { material: 0, ..blade }],
                placements: vec![place(1.0, 1.0), place(1.5, -1.0), place(2.0, 1.0)],
                branches: Vec::new(),
            }],
            textures: Vec::new(),
            branches: Vec::new(),
        }
    }

    fn bytes_of(model: &PlantModel) -> Vec<u8> {
        write::to_glb(Path::new("plant.glb"), model, &story()).unwrap()
    }

    #[test]
    fn a_plant_comes_back_bit_for_bit_with_its_provenance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("aspen-3.glb");
        write_plant(&path, &sapling(), &story()).unwrap();
        assert_eq!(read_plant(&path).unwrap(), sapling());
        assert_eq!(provenance(&path).unwrap(), Some(story()));
    }

    /// The sapling with bark and leaf painted, the leaf cut out, and a trunk and twig that sway.
    fn swaying() -> PlantModel {
        let mut plant = sapling();
        let texel = |i: u8| [i * 7, 255 - i, i, 255];
        let bark = Texture {
            name: "bark".into(),
            width: 3,
            height: 2,
            texels: (0..6).map(texel).collect(),
        };
        let mut leaf = Texture { name: "leaf".into(), ..bark.clone() };
        leaf.texels[4][3] = 0;
        plant.textures = vec![bark, leaf];
        plant.materials[0].paint = Some(Paint { texture: 0, size: [0.3, 0.7] });
        plant.materials[1].paint = Some(Paint { texture: 1, size: [1.0, 1.0] });
        plant.materials[1].cutout = Some(0.4);
        let trunk = Branch { parent: None, pivot: [0.0; 3], stiffness: 0.03, phase: 0.4 };
        let twig = Branch { parent: Some(0), pivot: [0.1, 0.2, 1.0], ..trunk };
        plant.branches = vec![trunk, twig];
        plant.wood[0].branches = vec![0, 0, 0, 1];
        plant.organs[0].branches = vec![0, 1, 1];
        plant
    }

    #[test]
    fn textures_cutouts_and_branches_come_back_bit_for_bit() {
        let bytes = bytes_of(&swaying());
        assert_eq!(parse_plant(Path::new("p.glb"), &bytes).unwrap(), swaying());
    }

    #[test]
    fn an_independent_reader_finds_textures_and_cutouts() {
        let bytes = bytes_of(&flatten(&swaying()));
        let gltf = gltf::Gltf::from_slice(&bytes).unwrap();
        let leaf = gltf.materials().nth(1).unwrap();
        assert_eq!(leaf.alpha_mode(), gltf::material::AlphaMode::Mask);
        assert_eq!(leaf.alpha_cutoff(), Some(0.4));
        let info = leaf.pbr_metallic_roughness().base_color_texture().unwrap();
        let gltf::image::Source::View { view, mime_type } = info.texture().source().source() else {
            panic!("the texture lies outside the file");
        };
        assert_eq!((info.tex_coord(), mime_type), (0, "image/png"));
        let blob = gltf.blob.as_deref().unwrap();
        let png = image::load_from_memory(&blob[view.offset()..view.offset() + view.length()]);
        let png = png.unwrap().into_rgba8();
        assert_eq!((png.width(), png.height(), png.get_pixel(1, 1).0), (3, 2, [28, 251, 4, 0]));
    }

    #[test]
    fn flattening_lets_organs_follow_their_branch() {
        let flat = flatten(&swaying());
        assert_eq!(flat.wood[2].branches, [0, 0, 0, 1, 1, 1, 1, 1, 1]);
    }

    #[test]
    fn unsound_paint_and_branches_are_refused() {
        let refused = |change: fn(&mut PlantModel)| {
            let mut model = swaying();
            change(&mut model);
            write::to_glb(Path::new("p.glb"), &model, &story()).unwrap_err().to_string()
        };
        let error = refused(|m| m.materials[0].paint.as_mut().unwrap().texture = 2);
        assert!(error.contains("material `bark`"), "{error}");
        assert!(refused(|m| m.textures[0].width = 4).contains("`bark`"));
        assert!(refused(|m| m.materials[1].cutout = Some(0.0)).contains("`leaf`"));
        assert!(refused(|m| m.branches[0].parent = Some(0)).contains("branches"));
        assert!(refused(|m| m.organs[0].branches.truncate(1)).contains("branches"));
        assert!(refused(|m| m.wood[0].branches = vec![2; 4]).contains("branches"));
    }

    #[test]
    fn a_lamp_comes_back_bit_for_bit() {
        let mut lamp = sapling();
        lamp.materials[0].surface = Surface::Light { radiance: [3.3, 0.7, 12.1] };
        assert_eq!(parse_plant(Path::new("lamp.glb"), &bytes_of(&lamp)).unwrap(), lamp);
    }

    #[test]
    fn an_independent_reader_accepts_our_file_and_sees_it_upright() {
        let bytes = bytes_of(&flatten(&sapling()));
        let gltf = gltf::Gltf::from_slice(&bytes).unwrap();
        let mut highest = 0f32;
        let mut triangles = 0;
        for primitive in gltf.meshes().flat_map(|mesh| mesh.primitives()) {
            let reader = primitive.reader(|_| gltf.blob.as_deref());
            highest = reader.read_positions().unwrap().map(|p| p[1]).fold(highest, f32::max);
            triangles += reader.read_indices().unwrap().into_u32().count() / 3;
            let bounds = primitive.bounding_box();
            assert!(bounds.min[1] >= -0.1 && bounds.max[1] <= 2.2, "{bounds:?}");
        }
        assert_eq!((highest, triangles as u64), (2.0, sapling().instanced_triangles()));
    }

    #[test]
    fn parts_that_draw_nothing_are_left_out() {
        let mut model = sapling();
        model.wood.push(Mesh::default());
        model.organs.push(Organ { placements: Vec::new(), ..model.organs[0].clone() });
        let back = parse_plant(Path::new("p.glb"), &bytes_of(&model)).unwrap();
        assert_eq!(back, sapling());
    }

    #[test]
    fn flattening_repeats_each_organ_where_instancing_would_draw_it() {
        let model = sapling();
        let flat = flatten(&model);
        assert_eq!(flat.unique_triangles(), model.instanced_triangles());
        assert!(flat.wood.iter().all(|mesh| mesh.is_sound(flat.materials.len())));
        // The second vertex of the blade at its third place, by hand.
        let place = &model.organs[0].placements[2];
        let local = Vec3::from(model.organs[0].meshes[0].positions[1]) * Vec3::from(place.scale);
        let expected = Quat::from_array(place.rotation) * local + Vec3::from(place.position);
        let found = Vec3::from(flat.wood[2].positions[2 * 3 + 1]);
        assert!(found.abs_diff_eq(expected, 1e-6), "{found} {expected}");
    }

    #[test]
    fn a_mirrored_place_turns_its_triangles_round() {
        let mut model = sapling();
        model.organs[0].placements[0].scale = [-1.0, 1.0, 1.0];
        assert_eq!(flatten(&model).wood[2].triangles[0], [0, 2, 1]);
    }

    #[test]
    fn unsound_meshes_are_refused() {
        let mut model = sapling();
        model.wood[0].triangles[0][2] = 4;
        let error = write::to_glb(Path::new("p.glb"), &model, &story()).unwrap_err().to_string();
        assert!(error.contains("mesh 0 of the wood"), "{error}");
        let mut model = sapling();
        model.wood[1].positions[0][0] = f32::NAN;
        assert!(write::to_glb(Path::new("p.glb"), &model, &story()).is_err());
    }

    proptest! {
        #[test]
        fn damaged_files_never_panic(flips in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..8), cut in any::<prop::sample::Index>()) {
            let good = bytes_of(&swaying());
            let mut bytes = good.clone();
            for (index, value) in flips {
                bytes[index.index(good.len())] = value;
            }
            let _ = parse_plant(Path::new("p.glb"), &bytes);
            bytes.truncate(cut.index(good.len()));
            prop_assert!(parse_plant(Path::new("p.glb"), &bytes).is_err());
        }

        #[test]
        fn axes_turn_there_and_back_bit_for_bit(x in any::<f32>(), y in any::<f32>(), z in any::<f32>()) {
            let back = z_up(y_up([x, y, z]));
            prop_assert_eq!(back.map(f32::to_bits), [x, y, z].map(f32::to_bits));
        }
    }
}
