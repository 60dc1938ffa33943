//! A scene for Mitsuba 3 [Jakob22]: `scene.xml`, meshes in PLY, pictures of sky, ground and textures.
//!
//! Mitsuba has no material like our leaf, so that its own are blended. A blend adds its parts by
//! weights that also are the chances of drawing them; each part is therefore made brighter by the
//! inverse of its weight, and weights go with what the parts return.
//!
//! Mitsuba starts rays off a surface by 9e-5 of their distance from the origin: 6 mm at 64 m, farther than
//! blades of grass stand apart, which lets light through. The origin is therefore the eye.

use crate::error::Result;
use crate::make::{make_folder, make_folder_of};
use rayon::prelude::*;
use serde_json::json;
use std::collections::{BTreeMap, BTreeSet};
use std::fmt::Write as _;
use std::path::{Path, PathBuf};
use weald_contract::{Picture, Progress, Projection};
use weald_formats::{Provenance, write_atomically};
use weald_render::Config;
use weald_render::portable::{Eye, Finish, Gloss, Painted, Place, Portable, Reach, SMOOTH_MEAN};

/// Least columns of the picture of the sky: a sixth of a degree, so that the horizon is sharp.
const SKY_COLUMNS: usize = 2048;

/// Distance of the disc that stands for the sun, m: so far that its direction is the same all over
/// a scene, and so near that single precision still tells its rim.
const SUN_DISTANCE: f64 = 1e7;

/// Texels of a map of what is there for each texel of coverage, along a side: our outlines lie
/// between texels.
const OPACITY_TIMES: usize = 4;

/// Longest side of such a map, texels.
const MOST_OPACITY: usize = 4096;

/// Mean reflectance of light from everywhere of smooth water, by Fresnel's equations.
const WATER_MEAN: f32 = 0.066;

/// What was written.
pub(super) struct Written {
    /// The scene first.
    pub files: Vec<PathBuf>,
    /// Numbers worth knowing.
    pub report: serde_json::Value,
}

/// A mesh file of a piece.
struct Part {
    finish: u32,
    file: String,
    triangles: usize,
}

/// Writes a scene into a folder.
///
/// # Errors
/// The disk refuses, or the caller asked to stop.
pub(super) fn write(
    portable: &Portable<'_>,
    eye: &Eye,
    config: &Config,
    folder: &Path,
    story: &Provenance,
    progress: &dyn Progress,
) -> Result<Written> {
    make_folder(folder)?;
    let parts = write_meshes(portable, folder, progress)?;
    let used: BTreeSet<u32> = parts.iter().flatten().map(|part| part.finish).collect();
    let mut pictures = Pictures { folder, story, files: Vec::new(), known: BTreeMap::new() };
    let mut text = String::from("<scene version=\"3.0.0\">\n");
    let _ = writeln!(text, "  <!-- weald {} -->", story.to_json().replace("--", "\\u002d\\u002d"));
    text += &camera(eye, config);
    text += &lights(portable, &mut pictures)?;
    for &finish in &used {
        let id = name_of(portable, finish);
        text += &material(portable, &portable.finishes[finish as usize], &id, &mut pictures)?;
    }
    text += &shapes(portable, &parts, eye.position);
    text += "</scene>\n";
    let scene = folder.join("scene.xml");
    write_atomically(&scene, |file| Ok(std::io::Write::write_all(file, text.as_bytes())?))?;

    let mut files = vec![scene];
    files.append(&mut pictures.files);
    files.extend(parts.iter().flatten().map(|part| folder.join(&part.file)));
    let stored: usize = parts.iter().flatten().map(|part| part.triangles).sum();
    let shown: u128 =
        portable.places.iter().map(|p| u128::from(portable.triangle_count(p.piece))).sum();
    let report = json!({
        "pieces": portable.piece_count(),
        "places": portable.places.len(),
        "materials": used.len(),
        "triangles": stored,
        "instanced_triangles": u64::try_from(shown).unwrap_or(u64::MAX),
    });
    Ok(Written { files, report })
}

/// Writes the meshes of all pieces; returns them piece by piece.
fn write_meshes(
    portable: &Portable<'_>,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Vec<Vec<Part>>> {
    let count = portable.piece_count();
    make_folder_of(&folder.join("meshes/x"))?;
    progress.begin("meshes", count as u64, "pieces");
    let write = |piece: usize| {
        if progress.is_cancelled() {
            return Err(crate::error::Error::Stopped { saved: false });
        }
        let mut parts = Vec::new();
        for mesh in portable.meshes(piece) {
            let file = format!("meshes/{piece:04}-{}.ply", name_of(portable, mesh.material));
            weald_formats::write_ply(&folder.join(&file), &mesh)?;
            parts.push(Part { finish: mesh.material, file, triangles: mesh.triangles.len() });
        }
        progress.advance(1);
        Ok(parts)
    };
    (0..count).into_par_iter().map(write).collect()
}

/// The id of a material: its number, and its name in letters that XML and file systems like.
fn name_of(portable: &Portable<'_>, finish: u32) -> String {
    let plain = |c: char| if c.is_ascii_alphanumeric() { c.to_ascii_lowercase() } else { '-' };
    let name: String = portable.finishes[finish as usize].name.chars().map(plain).collect();
    format!("m{finish}-{name}")
}

/// Integrator, sensor and film.
fn camera(eye: &Eye, config: &Config) -> String {
    let target = eye.forward.map(|part| eye.focus * part);
    let kind = match eye.projection {
        Projection::Orthographic => "orthographic",
        _ if eye.lens_radius > 0.0 => "thinlens",
        _ => "perspective",
    };
    let mut lens = String::new();
    let mut float = |name: &str, value: f32| {
        let _ = writeln!(lens, "    <float name=\"{name}\" value=\"{value}\"/>");
    };
    if kind != "orthographic" {
        float("fov", eye.fov.to_degrees());
    }
    if kind == "thinlens" {
        float("aperture_radius", eye.lens_radius);
        float("focus_distance", eye.focus);
    }
    let scale = match kind {
        "orthographic" => format!("      <scale x=\"{0}\" y=\"{0}\"/>\n", eye.half_width),
        _ => String::new(),
    };
    let axis = match kind {
        "orthographic" => "",
        _ => "    <string name=\"fov_axis\" value=\"x\"/>\n",
    };
    let [width, height] = config.resolution;
    format!(
        "  <default name=\"spp\" value=\"{samples}\"/>
  <integrator type=\"path\">
    <integer name=\"max_depth\" value=\"{depth}\"/>
  </integrator>
  <sensor type=\"{kind}\">
{lens}{axis}    <float name=\"near_clip\" value=\"0.01\"/>
    <float name=\"far_clip\" value=\"1e8\"/>
    <transform name=\"to_world\">
{scale}      <lookat origin=\"{origin}\" target=\"{target}\" up=\"{up}\"/>
    </transform>
    <sampler type=\"independent\">
      <integer name=\"sample_count\" value=\"$spp\"/>
    </sampler>
    <film type=\"hdrfilm\">
      <integer name=\"width\" value=\"{width}\"/>
      <integer name=\"height\" value=\"{height}\"/>
      <string name=\"pixel_format\" value=\"rgb\"/>
      <string name=\"component_format\" value=\"float32\"/>
      <rfilter type=\"gaussian\">
        <float name=\"stddev\" value=\"{filter}\"/>
      </rfilter>
    </film>
  </sensor>
",
        samples = config.samples,
        // Ours counts scatterings, theirs the segments of a path.
        depth = config.bounces + 1,
        origin = triple([0.0; 3]),
        target = triple(target),
        up = triple(eye.up),
        filter = eye.filter,
    )
}

/// Sky and sun.
fn lights(portable: &Portable<'_>, pictures: &mut Pictures<'_>) -> Result<String> {
    let columns = portable.sky_columns().max(SKY_COLUMNS).next_multiple_of(4);
    pictures.add("sky.exr", &sky(portable, columns, columns / 2))?;
    // Their map has Y up and its left rim in the north once that is turned; ours begins in the south.
    let mut text = String::from(
        "  <emitter type=\"envmap\" id=\"sky\">
    <string name=\"filename\" value=\"sky.exr\"/>
    <transform name=\"to_world\">
      <matrix value=\"-1 0 0 0 0 0 1 0 0 1 0 0 0 0 0 1\"/>
    </transform>
  </emitter>
",
    );
    let Some(lamp) = portable.lamp().filter(|lamp| lamp.radiance != [0.0; 3]) else {
        return Ok(text);
    };
    let radius = SUN_DISTANCE * libm::tan(lamp.radius);
    let toward = glam::DVec3::from_array(lamp.direction.map(f64::from)).normalize();
    let (side, up) = toward.any_orthonormal_pair();
    let axes =
        [side * radius, up * radius, -toward, SUN_DISTANCE * toward].map(|axis| axis.to_array());
    let row = |axis: usize| axes.map(|column| column[axis].to_string()).join(" ");
    let _ = write!(
        text,
        "  <shape type=\"disk\" id=\"sun\">
    <transform name=\"to_world\">
      <matrix value=\"{} {} {} 0 0 0 1\"/>
    </transform>
    <bsdf type=\"diffuse\"><rgb name=\"reflectance\" value=\"0, 0, 0\"/></bsdf>
    <emitter type=\"area\"><rgb name=\"radiance\" value=\"{}\"/></emitter>
  </shape>
",
        row(0),
        row(1),
        row(2),
        triple(lamp.radiance),
    );
    Ok(text)
}

/// The sky all around: columns clockwise from the south, so that the middle looks north, and rows
/// from the zenith to the nadir, both included, as Mitsuba reads them.
fn sky(portable: &Portable<'_>, columns: usize, rows: usize) -> Picture {
    use std::f64::consts::{PI, TAU};
    let pixel = |index: usize| {
        let zenith = (index / columns) as f64 / (rows - 1) as f64 * PI;
        let azimuth = ((index % columns) as f64 + 0.5) / columns as f64 * TAU - PI;
        let across = libm::sin(zenith);
        let way = [across * libm::sin(azimuth), across * libm::cos(azimuth), libm::cos(zenith)];
        portable.sky(way.map(|c| c as f32))
    };
    let pixels: Vec<[f32; 3]> = (0..columns * rows).into_par_iter().map(pixel).collect();
    let mut picture = Picture::new(columns, rows);
    for (axis, name) in ["R", "G", "B"].into_iter().enumerate() {
        picture.add(name, false, pixels.iter().map(|rgb| rgb[axis]).collect());
    }
    picture
}

/// Pictures beside the scene, each written once.
struct Pictures<'a> {
    folder: &'a Path,
    story: &'a Provenance,
    files: Vec<PathBuf>,
    /// Files of textures by their number and what they are multiplied by.
    known: BTreeMap<(u32, [u32; 3]), String>,
}

impl Pictures<'_> {
    fn add(&mut self, name: &str, picture: &Picture) -> Result<()> {
        let path = self.folder.join(name);
        make_folder_of(&path)?;
        weald_formats::write_picture(&path, picture, self.story)?;
        self.files.push(path);
        Ok(())
    }

    /// The file of a texture times a colour.
    fn texture(&mut self, portable: &Portable<'_>, texture: u32, by: [f32; 3]) -> Result<String> {
        let key = (texture, by.map(f32::to_bits));
        if let Some(name) = self.known.get(&key) {
            return Ok(name.clone());
        }
        let name = format!("textures/{:04}.exr", self.known.len());
        self.add(&name, &portable.texture(texture, by))?;
        self.known.insert(key, name.clone());
        Ok(name)
    }

    /// The file that says where a texture leaves anything.
    fn opacity(&mut self, portable: &Portable<'_>, texture: u32, least: f32) -> Result<String> {
        let name = format!("textures/cutout-{texture:04}-{:03}.png", (least * 255.0) as u32);
        let path = self.folder.join(&name);
        if self.files.contains(&path) {
            return Ok(name);
        }
        make_folder_of(&path)?;
        let (width, height, _) = portable.opacity(texture, least, 1);
        let times = (MOST_OPACITY / width.max(height).max(1)).clamp(1, OPACITY_TIMES);
        let (width, height, is_there) = portable.opacity(texture, least, times);
        let codes: Vec<u16> =
            is_there.into_iter().map(|is| if is { u16::MAX } else { 0 }).collect();
        weald_formats::write_gray_png(&path, width, height, &codes, self.story)?;
        self.files.push(path);
        Ok(name)
    }
}

/// A material under an id.
fn material(
    portable: &Portable<'_>,
    finish: &Finish,
    id: &str,
    pictures: &mut Pictures<'_>,
) -> Result<String> {
    let (inner, cutout) = match finish.paint {
        Painted::Ground(reach) => {
            let name = match reach {
                Reach::Near => "ground.exr",
                Reach::Far => "land-beyond.exr",
            };
            pictures.add(name, &portable.ground(reach))?;
            (
                two_sided(&format!("<bsdf type=\"diffuse\">{}</bsdf>", map("reflectance", name))),
                None,
            )
        }
        Painted::Water { alpha } => {
            let mut body = portable.water();
            // Their surface keeps as much of the light from within as its outside reflects.
            let values = body.channels.iter_mut().flat_map(|channel| &mut channel.values);
            values.for_each(|value| *value *= 1.0 - WATER_MEAN);
            pictures.add("water.exr", &body)?;
            (
                format!(
                    "<bsdf type=\"roughplastic\"><string name=\"distribution\" value=\"beckmann\"/>\
                     <float name=\"alpha\" value=\"{alpha}\"/><float name=\"int_ior\" \
                     value=\"1.333\"/>{}</bsdf>",
                    map("diffuse_reflectance", "water.exr")
                ),
                None,
            )
        }
        Painted::Texture { texture, cutout } => {
            let mut paint = |name: &str, color: [f32; 3]| -> Result<String> {
                Ok(map(name, &pictures.texture(portable, texture, color)?))
            };
            (blend(finish, &mut paint)?, cutout.map(|least| (texture, least)))
        }
        Painted::Plain => (blend(finish, &mut |name, color| Ok(rgb(name, color)))?, None),
    };
    let whole = match cutout {
        None => inner,
        Some((texture, least)) => {
            let file = pictures.opacity(portable, texture, least)?;
            format!(
                "<bsdf type=\"mask\"><texture type=\"bitmap\" name=\"opacity\"><string \
                 name=\"filename\" value=\"{file}\"/><string name=\"filter_type\" \
                 value=\"nearest\"/><boolean name=\"raw\" value=\"true\"/></texture>{inner}</bsdf>"
            )
        }
    };
    // The id belongs to the outermost.
    Ok(format!("  {}\n", whole.replacen("<bsdf", &format!("<bsdf id=\"{id}\""), 1)))
}

/// Writes a colour as a parameter of this name.
type Paint<'a> = dyn FnMut(&str, [f32; 3]) -> Result<String> + 'a;

/// What a leaf, bark or stone does with light: diffuse reflection, diffuse transmission and a coat,
/// as far as it has them.
fn blend(finish: &Finish, paint: &mut Paint<'_>) -> Result<String> {
    let lost = finish.coat.map_or(0.0, |coat| coat.albedo);
    let below = |color: [f32; 3]| color.map(|c| c * (1.0 - lost));
    let (reflected, transmitted) = (below(finish.reflectance), below(finish.transmittance));
    let most = |color: [f32; 3]| color.into_iter().fold(0.0, f32::max);
    let shares = [most(reflected), most(transmitted), lost];
    let total: f32 = shares.iter().sum();
    let [reflect, transmit, coat] =
        shares.map(|share| if total > 0.0 { share / total } else { 0.0 });
    // Mitsuba refuses colours above 1, which only the brightest petals would reach.
    let brighter = |color: [f32; 3], by: f32| color.map(|c| (c * by).min(1.0));
    let mut lobes: Vec<(f32, String)> = Vec::new();
    // Under a smooth coat of the same index light fades towards grazing angles, under a rough one
    // less, under none not at all.
    let fading = finish.coat.map_or(0.0, |coat| coat.fading);
    if (reflect > 0.0 && fading < 1.0) || total == 0.0 {
        let color = paint("reflectance", brighter(reflected, 1.0 / reflect.max(1e-6)))?;
        let text = two_sided(&format!("<bsdf type=\"diffuse\">{color}</bsdf>"));
        lobes.push((reflect * (1.0 - fading), text));
    }
    if reflect * fading > 0.0 {
        let by = 1.0 / (reflect * (1.0 - SMOOTH_MEAN));
        let color = paint("diffuse_reflectance", brighter(reflected, by))?;
        let text = two_sided(&format!(
            "<bsdf type=\"plastic\"><float name=\"int_ior\" value=\"1.5\"/><float \
             name=\"specular_reflectance\" value=\"0\"/>{color}</bsdf>"
        ));
        lobes.push((reflect * fading, text));
    }
    if transmit > 0.0 {
        let color = paint("base_color", brighter(transmitted, 1.0 / transmit))?;
        lobes.push((
            transmit,
            format!(
                "<bsdf type=\"principledthin\"><float name=\"diff_trans\" value=\"2\"/><float \
                 name=\"spec_trans\" value=\"0\"/>{color}</bsdf>"
            ),
        ));
    }
    if let (Some(Gloss { alpha, .. }), true) = (finish.coat, coat > 0.0) {
        lobes.push((
            coat,
            two_sided(&format!(
                "<bsdf type=\"roughconductor\"><string name=\"distribution\" value=\"ggx\"/><float \
                 name=\"alpha\" value=\"{alpha}\"/><float name=\"eta\" value=\"1.5\"/><float \
                 name=\"k\" value=\"0\"/><float name=\"specular_reflectance\" value=\"{}\"/></bsdf>",
                1.0 / coat
            )),
        ));
    }
    Ok(blended(lobes))
}

/// Blends parts by their weights, two by two.
fn blended(lobes: Vec<(f32, String)>) -> String {
    let add = |(weight, text): (f32, String), (more, lobe): (f32, String)| {
        let part = more / (weight + more);
        let blend = format!(
            "<bsdf type=\"blendbsdf\"><float name=\"weight\" value=\"{part}\"/>{text}{lobe}</bsdf>"
        );
        (weight + more, blend)
    };
    lobes.into_iter().reduce(add).map_or_else(String::new, |(_, text)| text)
}

fn two_sided(bsdf: &str) -> String {
    format!("<bsdf type=\"twosided\">{bsdf}</bsdf>")
}

fn map(name: &str, file: &str) -> String {
    format!(
        "<texture type=\"bitmap\" name=\"{name}\"><string name=\"filename\" \
         value=\"{file}\"/></texture>"
    )
}

fn rgb(name: &str, color: [f32; 3]) -> String {
    format!("<rgb name=\"{name}\" value=\"{}\"/>", triple(color))
}

fn triple(values: [f32; 3]) -> String {
    values.map(|value| value.to_string()).join(", ")
}

/// Meshes where they stand: those of many places as groups and instances. Lights cannot be
/// instanced, and what stands once need not be.
fn shapes(portable: &Portable<'_>, parts: &[Vec<Part>], eye: [f32; 3]) -> String {
    let mut counts = vec![0u64; parts.len()];
    portable.places.iter().for_each(|place| counts[place.piece] += 1);
    let is_apart = |piece: usize, part: &Part| counts[piece] == 1 || portable.shines(part.finish);
    let mut text = String::new();
    let mut has_group = vec![false; parts.len()];
    for (piece, list) in parts.iter().enumerate() {
        let grouped: String =
            list.iter().filter(|p| !is_apart(piece, p)).map(|p| shape(portable, p, "")).collect();
        has_group[piece] = !grouped.is_empty();
        if has_group[piece] {
            let _ = writeln!(text, "  <shape type=\"shapegroup\" id=\"piece-{piece}\">");
            text += &grouped;
            text += "  </shape>\n";
        }
    }
    for place in &portable.places {
        let piece = place.piece;
        let matrix = matrix(place, eye);
        if has_group[piece] {
            let _ = writeln!(
                text,
                "  <shape type=\"instance\"><ref id=\"piece-{piece}\"/>{matrix}</shape>"
            );
        }
        for part in parts[piece].iter().filter(|part| is_apart(piece, part)) {
            text += &shape(portable, part, &matrix);
        }
    }
    text
}

/// A mesh of a piece.
fn shape(portable: &Portable<'_>, part: &Part, matrix: &str) -> String {
    let emission = portable.finishes[part.finish as usize].emission;
    let emitter = match portable.shines(part.finish) {
        true => format!("<emitter type=\"area\">{}</emitter>", rgb("radiance", emission)),
        false => String::new(),
    };
    format!(
        "    <shape type=\"ply\"><string name=\"filename\" value=\"{}\"/><ref \
         id=\"{}\"/>{matrix}{emitter}</shape>\n",
        part.file,
        name_of(portable, part.finish)
    )
}

fn matrix(place: &Place, eye: [f32; 3]) -> String {
    let rows = [0, 1, 2].map(|axis| {
        let [x, y, z, w] = place.scene_from_piece[axis];
        [x, y, z, w - eye[axis]].map(|value| value.to_string()).join(" ")
    });
    format!(
        "<transform name=\"to_world\"><matrix value=\"{} 0 0 0 1\"/></transform>",
        rows.join(" ")
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    fn finish(reflectance: f32, transmittance: f32, coat: Option<Gloss>) -> Finish {
        Finish {
            name: "leaf".into(),
            reflectance: [reflectance; 3],
            transmittance: [transmittance; 3],
            emission: [0.0; 3],
            coat,
            paint: Painted::Plain,
        }
    }

    fn blend_of(finish: &Finish) -> String {
        blend(finish, &mut |name, color| Ok(rgb(name, color))).unwrap()
    }

    #[test]
    fn a_matt_leaf_is_a_blend_whose_parts_add_up() {
        // Weight 0.4 of transmission 0.5 is 0.2, weight 0.6 of reflection 0.5 is 0.3.
        let text = blend_of(&finish(0.3, 0.2, None));
        assert!(text.contains("name=\"weight\" value=\"0.4\""), "{text}");
        assert!(text.contains("name=\"reflectance\" value=\"0.5, 0.5, 0.5\""), "{text}");
        assert!(text.contains("name=\"base_color\" value=\"0.5, 0.5, 0.5\""), "{text}");
    }

    #[test]
    fn opaque_and_black_surfaces_need_no_blend() {
        assert!(!blend_of(&finish(0.3, 0.0, None)).contains("blendbsdf"));
        assert!(blend_of(&finish(0.0, 0.0, None)).contains("value=\"0, 0, 0\""));
        let coat = Some(Gloss { alpha: 0.25, albedo: 0.05, fading: 0.5 });
        assert_eq!(blend_of(&finish(0.3, 0.2, coat)).matches("blendbsdf").count(), 3);
    }
}
