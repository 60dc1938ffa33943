//! A contact sheet: plant models side by side, seen from the south.
//!
//! A plain z-buffer with one light is enough to see whether a model is whole and grows the right
//! way up, and takes milliseconds where a path tracer takes minutes.

use super::sketch::Sketch;
use glam::{Quat, Vec3};
use rayon::prelude::*;
use weald_contract::{Mesh, Paint, PlantModel, Surface};

const BACKGROUND: [u8; 3] = [238, 240, 236];
/// Where the light comes from: the viewer's upper left.
const LIGHT: Vec3 = Vec3::new(-0.48, -0.64, 0.6);
/// Margin around a model, part of its cell.
const MARGIN: f32 = 0.06;
/// Height of the line under a model that holds its name, pixels.
const CAPTION: usize = 16;

/// How models are drawn.
#[derive(Clone, Copy)]
struct Style {
    background: [u8; 3],
    /// Wood alone, in this colour, without light.
    flat: Option<[u8; 3]>,
}

const LIT: Style = Style { background: BACKGROUND, flat: None };
const SCHEMATIC: Style = Style { background: [255; 3], flat: Some([0; 3]) };

/// Draws each named model in a square cell of `side` pixels, in rows.
pub fn contact_sheet(models: &[(String, &PlantModel)], side: usize) -> Sketch {
    sheet(models, side, LIT)
}

/// Draws the branches of each named model as black cones on white.
pub fn schematic_sheet(models: &[(String, &PlantModel)], side: usize) -> Sketch {
    sheet(models, side, SCHEMATIC)
}

fn sheet(models: &[(String, &PlantModel)], side: usize, style: Style) -> Sketch {
    let columns = (models.len() as f64).sqrt().ceil().max(1.0) as usize;
    let rows = models.len().div_ceil(columns).max(1);
    let cells: Vec<Sketch> =
        models.par_iter().map(|(_, model)| portrait(model, side, style)).collect();
    let background = style.background;
    let mut sheet = Sketch::filled(columns * side, rows * (side + CAPTION), background);
    for (index, (cell, (name, _))) in cells.iter().zip(models).enumerate() {
        let x = (index % columns * side) as i64;
        let y = (index / columns * (side + CAPTION)) as i64;
        sheet.paste(cell, x, y);
        let fits = name.chars().count() as i64 * 8 < side as i64;
        sheet.text(x + 6, y + side as i64 + 2, name, if fits { 2 } else { 1 }, [40, 44, 40]);
    }
    sheet
}

/// One model, filling the cell; the horizontal line marks the ground.
///
/// Drawn larger and averaged, so that blades thinner than a pixel fade instead of breaking up.
fn portrait(model: &PlantModel, side: usize, style: Style) -> Sketch {
    let large = drawing(model, side * OVERSAMPLING, style);
    let mut small = Sketch::filled(side, side, style.background);
    for (row, line) in small.rgb.chunks_exact_mut(3 * side).enumerate() {
        for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
            for (channel, value) in pixel.iter_mut().enumerate() {
                *value = block_mean(&large, column, row, channel);
            }
        }
    }
    small
}

/// Pixels of the drawing across one of the portrait.
const OVERSAMPLING: usize = 3;

/// Mean of a channel over the block of drawn pixels that become one.
fn block_mean(large: &Sketch, column: usize, row: usize, channel: usize) -> u8 {
    let mut sum = 0;
    for y in row * OVERSAMPLING..(row + 1) * OVERSAMPLING {
        let start = 3 * (y * large.width + column * OVERSAMPLING) + channel;
        sum += large.rgb[start..]
            .iter()
            .step_by(3)
            .take(OVERSAMPLING)
            .map(|v| u32::from(*v))
            .sum::<u32>();
    }
    let count = (OVERSAMPLING * OVERSAMPLING) as u32;
    ((sum + count / 2) / count) as u8
}

/// The model at full size.
fn drawing(model: &PlantModel, side: usize, style: Style) -> Sketch {
    let triangles = triangles(model, style);
    let mut sketch = Sketch::filled(side, side, style.background);
    let (mut low, mut high) = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    for corner in triangles.iter().flat_map(|triangle| triangle.corners) {
        low = low.min(corner);
        high = high.max(corner);
    }
    if !(low.is_finite() && high.is_finite()) {
        return sketch;
    }
    let low = low.min(Vec3::new(low.x, low.y, 0.0));
    let size = (high.x - low.x).max(high.z - low.z).max(1e-6);
    let scale = side as f32 * (1.0 - 2.0 * MARGIN) / size;
    let middle = (low.x + high.x) / 2.0;
    let ground = side as f32 * (1.0 - MARGIN) + low.z * scale;
    let project =
        |p: Vec3| Vec3::new(side as f32 / 2.0 + (p.x - middle) * scale, ground - p.z * scale, p.y);

    if style.flat.is_none() {
        let line = [150, 146, 132];
        sketch.rectangle(0, ground as i64, side as i64, OVERSAMPLING as i64, line, 1.0);
    }
    let mut depth = vec![f32::INFINITY; side * side];
    for triangle in &triangles {
        fill(&mut sketch, &mut depth, triangle.corners.map(project), triangle.color);
    }
    sketch
}

/// A triangle in the plant's space with its shaded colour.
struct Shaded {
    corners: [Vec3; 3],
    color: [u8; 3],
}

/// All triangles of a model, organs at each of their places.
fn triangles(model: &PlantModel, style: Style) -> Vec<Shaded> {
    let mut all = Vec::new();
    for mesh in &model.wood {
        add(&mut all, model, mesh, |p| p);
    }
    if let Some(color) = style.flat {
        // What lies in the ground is not part of the picture.
        all.retain(|triangle| triangle.corners.iter().any(|corner| corner.z > 0.0));
        all.iter_mut().for_each(|triangle| triangle.color = color);
        return all;
    }
    for organ in &model.organs {
        for place in &organ.placements {
            let rotation = Quat::from_array(place.rotation);
            let (scale, position) = (Vec3::from(place.scale), Vec3::from(place.position));
            for mesh in &organ.meshes {
                add(&mut all, model, mesh, |p| rotation * (p * scale) + position);
            }
        }
    }
    all
}

fn add(
    all: &mut Vec<Shaded>,
    model: &PlantModel,
    mesh: &Mesh,
    plant_from_mesh: impl Fn(Vec3) -> Vec3,
) {
    let Some(material) = model.materials.get(mesh.material as usize) else { return };
    let through = match material.surface {
        Surface::Leaf { transmittance } => Vec3::from(transmittance),
        Surface::Opaque | Surface::Light { .. } => Vec3::ZERO,
    };
    for triangle in &mesh.triangles {
        let found = triangle.map(|index| mesh.positions.get(index as usize));
        let [Some(a), Some(b), Some(c)] = found else { continue };
        let corners = [*a, *b, *c].map(|p| plant_from_mesh(Vec3::from(p)));
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize_or_zero();
        // Leaves are seen from both sides; the side in shadow shows the light that passes.
        let facing = normal.dot(LIGHT) * if normal.y > 0.0 { -1.0 } else { 1.0 };
        let shade = material.paint.map_or(Vec3::ONE, |paint| texel(model, mesh, triangle, paint));
        let reflectance = shade * Vec3::from(material.reflectance);
        let through = shade * through;
        let light =
            reflectance * (0.35 + 0.85 * facing.max(0.0)) + through * (-facing).max(0.0) * 0.85;
        // 1.6 brings leaves, whose reflectance is low, to a visible tone.
        let color = (light * 1.6).to_array().map(encode);
        all.push(Shaded { corners, color });
    }
}

/// Colour of a texture in the middle of a triangle.
fn texel(model: &PlantModel, mesh: &Mesh, triangle: &[u32; 3], paint: Paint) -> Vec3 {
    let corner = |index: &u32| mesh.uvs.get(*index as usize).copied().unwrap_or_default();
    let [a, b, c] = [&triangle[0], &triangle[1], &triangle[2]].map(corner);
    let middle = [0, 1].map(|axis: usize| (a[axis] + b[axis] + c[axis]) / 3.0 / paint.size[axis]);
    let texture = model.textures.get(paint.texture as usize).filter(|texture| texture.is_sound());
    texture.map_or(Vec3::ONE, |texture| {
        let [r, g, b, _] = texture.at(middle[0], middle[1]);
        Vec3::new(r, g, b)
    })
}

/// sRGB byte of a linear value (IEC 61966-2-1).
fn encode(linear: f32) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    let encoded = match linear {
        dark if dark <= 0.003_130_8 => 12.92 * dark,
        bright => 1.055 * libm::powf(bright, 1.0 / 2.4) - 0.055,
    };
    (encoded * 255.0).round() as u8
}

/// Fills a projected triangle where it is nearest; thin ones keep at least their edges' pixels.
fn fill(sketch: &mut Sketch, depth: &mut [f32], corners: [Vec3; 3], color: [u8; 3]) {
    let side = sketch.width;
    let [a, b, c] = corners;
    if !(a.is_finite() && b.is_finite() && c.is_finite()) {
        return;
    }
    let low = a.min(b).min(c);
    let high = a.max(b).max(c);
    let area = (b - a).truncate().perp_dot((c - a).truncate());
    let clip = |value: f32| (value.max(0.0) as usize).min(side - 1);
    for row in clip(low.y.floor())..=clip(high.y.ceil()) {
        for column in clip(low.x.floor())..=clip(high.x.ceil()) {
            let p = Vec3::new(column as f32 + 0.5, row as f32 + 0.5, 0.0);
            let weight = |u: Vec3, v: Vec3| (v - u).truncate().perp_dot((p - u).truncate()) / area;
            let (wa, wb, wc) = (weight(b, c), weight(c, a), weight(a, b));
            // A blade of grass is thinner than a pixel: let it reach a little past its edges.
            let slack = -(0.5 / area.abs().sqrt().max(0.5)).min(0.5);
            if area == 0.0 || wa.min(wb).min(wc) < slack {
                continue;
            }
            let y = wa * a.z + wb * b.z + wc * c.z;
            let at = row * side + column;
            if y < depth[at] {
                depth[at] = y;
                sketch.blend(column as i64, row as i64, color, 1.0);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Material;

    fn post() -> PlantModel {
        let positions = vec![[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.5, 0.0, 2.0], [-0.5, 0.0, 2.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2], [0, 2, 3]], ..Mesh::default() };
        let material = Material {
            name: "bark".into(),
            reflectance: [0.3, 0.2, 0.1],
            roughness: 1.0,
            ..Material::default()
        };
        PlantModel {
            name: "post".into(),
            materials: vec![material],
            wood: vec![mesh],
            ..PlantModel::default()
        }
    }

    #[test]
    fn a_post_stands_upright_in_the_middle_of_its_cell() {
        let sketch = portrait(&post(), 100, LIT);
        let is_post = |x, y| sketch.get(x, y) != Some(BACKGROUND);
        assert!(is_post(50, 50) && is_post(50, 10));
        assert!(!is_post(10, 50) && !is_post(90, 50));
        // The foot stands on the ground line.
        assert!(is_post(50, 92));
    }

    #[test]
    fn srgb_encoding_meets_the_standard_at_its_known_points() {
        assert_eq!([0.0, 1.0, 0.214_041, 0.5].map(encode), [0, 255, 127, 188]);
    }

    #[test]
    fn an_empty_or_broken_model_gives_an_empty_cell() {
        assert!(portrait(&PlantModel::default(), 32, LIT).rgb.chunks(3).all(|p| p == BACKGROUND));
        let mut broken = post();
        broken.wood[0].positions[0][0] = f32::NAN;
        broken.wood[0].triangles.push([0, 1, 99]);
        let _ = portrait(&broken, 32, LIT);
    }
}
