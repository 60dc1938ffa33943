//! A model as the tracer wants it: materials, and triangles at all their places.

use crate::Error;
use crate::accel::{Triangle, join_pairs};
use crate::bsdf::Material;
use crate::paint::{Chart, Charts, NO_OUTLINE, Outline, Paints, Presence, Pyramid};
use crate::primitive::Face;
use glam::{Quat, Vec3};
use std::collections::BTreeMap;
use weald_contract::{Mesh, Organ, Paint, Placement, PlantModel, Surface};

/// Variation of brightness from leaf to leaf.
const LEAF_VARIATION: f32 = 0.16;

/// Variation of brightness of bark and stems.
const WOOD_VARIATION: f32 = 0.12;

/// Radiance beyond which no light goes, kcd/m²: that of the sun's disc is 1.6 million.
const MOST_RADIANCE: f32 = 1e7;

/// Farthest coordinate of a model from its origin, m: beyond it single precision is too coarse.
const MODEL_REACH: f32 = 1e5;

/// Most triangles of a model: with the pieces of long ones, as many as faces are numbered.
const MOST_TRIANGLES: usize = 1 << 28;

/// A plant's material as the integrator wants it, but for its texture.
///
/// Reflectance and transmittance are scaled down where together they would exceed 1.
pub(crate) fn material(source: &weald_contract::Material, species: u32) -> Material {
    let clean = |rgb: [f32; 3]| {
        Vec3::from_array(rgb.map(|c| if c.is_finite() { c.clamp(0.0, 1.0) } else { 0.0 }))
    };
    let reflectance = clean(source.reflectance);
    let (transmittance, emission, variation) = match source.surface {
        Surface::Opaque => (Vec3::ZERO, Vec3::ZERO, WOOD_VARIATION),
        Surface::Leaf { transmittance } => (clean(transmittance), Vec3::ZERO, LEAF_VARIATION),
        Surface::Light { radiance } => (Vec3::ZERO, shining(radiance), 0.0),
    };
    let excess = (reflectance + transmittance).max_element().max(1.0);
    Material {
        reflectance: reflectance / excess,
        transmittance: transmittance / excess,
        emission,
        roughness: if source.roughness.is_finite() {
            source.roughness.clamp(0.0, 1.0)
        } else {
            1.0
        },
        variation,
        is_ground: false,
        texture: None,
        species,
    }
}

/// Radiance of a light: what is no number, or below 0, shines not.
fn shining(radiance: [f32; 3]) -> Vec3 {
    Vec3::from_array(
        radiance.map(|c| if c.is_finite() { c.clamp(0.0, MOST_RADIANCE) } else { 0.0 }),
    )
}

/// How a material is painted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Brush {
    /// Index into [`Gallery::textures`].
    pub texture: u32,
    /// What a copy of the texture covers, in units of the texture coordinates.
    size: [f32; 2],
    /// Coverage below which there is nothing.
    pub cutout: Option<f32>,
}

/// The textures of all models, each kept once: plants of a species share theirs.
#[derive(Default)]
pub(crate) struct Gallery {
    pub textures: Vec<Pyramid>,
    /// What textures are made of, by width, height and whether they cut out, and their indices.
    known: BTreeMap<(u32, u32, bool), Vec<Original>>,
}

/// Texels as a model has them, and the index of the texture made from them.
type Original = (Vec<[u8; 4]>, u32);

impl Gallery {
    /// How a material of a model is painted, or what is wrong with its texture.
    pub fn brush(
        &mut self,
        material: &weald_contract::Material,
        model: &PlantModel,
    ) -> Result<Option<Brush>, String> {
        let Some(Paint { texture, size }) = material.paint else { return Ok(None) };
        let Some(found) = model.textures.get(texture as usize) else {
            return Err(format!("is painted with texture {texture}, which is not there"));
        };
        if !found.is_sound() {
            return Err(format!("is painted with texture {texture}, which lacks texels"));
        }
        if !size.iter().all(|side| side.is_finite() && *side != 0.0) {
            return Err(format!("has copies of its texture of size {size:?}"));
        }
        let cutout = material.cutout.filter(|least| *least > 0.0);
        let known = self.known.entry((found.width, found.height, cutout.is_some())).or_default();
        let texture = match known.iter().find(|(texels, _)| *texels == found.texels) {
            Some(&(_, index)) => index,
            None => {
                let index = self.textures.len() as u32;
                self.textures.push(Pyramid::new(found, cutout.is_some()));
                known.push((found.texels.clone(), index));
                index
            }
        };
        Ok(Some(Brush { texture, size, cutout }))
    }
}

/// All triangles of a model, and the charts and outlines that they refer to.
pub(crate) struct Shape {
    pub triangles: Vec<Triangle>,
    charts: Vec<Chart>,
    outlines: Vec<Outline>,
}

impl Shape {
    /// Adds charts and outlines to those of all models, and numbers them as they are there.
    pub fn join(&mut self, all: &mut Paints) {
        let (first_chart, first_outline) = (all.charts.len() as u32, all.outlines.len() as u32);
        all.charts.extend(self.charts.drain(..).map(|chart| match chart.outline {
            NO_OUTLINE => chart,
            outline => Chart { outline: first_outline + outline, ..chart },
        }));
        all.outlines.append(&mut self.outlines);
        for Triangle { face, .. } in &mut self.triangles {
            if let Some(chart) = face.chart() {
                *face = face.on_chart(first_chart + chart, face.is_cut());
            }
        }
    }
}

/// Triangles from which an organ that stands in many places is kept once, as a level of its own,
/// rather than copied to each place: a placement takes as much memory as one triangle, but rays are
/// slower through it.
pub const NESTED_TRIANGLES: u64 = 64;

/// Whether an organ may be a level of its own: it is large, and placements of levels have one scale.
pub(crate) fn may_nest(organ: &Organ) -> bool {
    let is_alike = |[x, y, z]: [f32; 3]| x > 0.0 && x == y && x == z;
    triangles(organ) >= NESTED_TRIANGLES && organ.placements.iter().all(|p| is_alike(p.scale))
}

/// Triangles of one copy of an organ.
pub(crate) fn triangles(organ: &Organ) -> u64 {
    organ.meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum()
}

/// What surfaces of a model are made of.
pub(crate) struct Look<'a> {
    /// Number of each of the model's materials among those of all models.
    pub materials: &'a [u16],
    /// How the materials of all models are painted.
    pub brushes: &'a [Option<Brush>],
    /// The textures of all models.
    pub textures: &'a [Pyramid],
}

/// All triangles of a model, organs at each of their places, but for the organs that are `nested`.
///
/// # Errors
/// An index out of range, a coordinate that is no number, too many triangles.
pub(crate) fn shape(
    model: &PlantModel,
    what: &str,
    look: &Look<'_>,
    nested: &dyn Fn(usize) -> bool,
) -> Result<Shape, Error> {
    let damaged = |why: String| Error::BadModel { what: what.to_string(), why };
    let is_here = |(index, _): &(usize, &Organ)| !nested(*index);
    let organs: Vec<&Organ> =
        model.organs.iter().enumerate().filter(is_here).map(|(_, organ)| organ).collect();
    let copies = organs.iter().map(|organ| triangles(organ) * organ.placements.len() as u64);
    let wood: usize = model.wood.iter().map(|mesh| mesh.triangles.len()).sum();
    let mut pile = Pile::new(look, wood + copies.sum::<u64>() as usize);
    for (number, mesh) in model.wood.iter().enumerate() {
        check(mesh, model).map_err(|why| damaged(format!("wood mesh {number} {why}")))?;
        let first_chart = pile.add_charts(mesh);
        pile.append(mesh, first_chart, &|p| p, &|n| n);
    }
    for organ in organs {
        for mesh in &organ.meshes {
            check(mesh, model).map_err(|why| damaged(format!("organ `{}` {why}", organ.name)))?;
            let first_chart = pile.add_charts(mesh);
            for (number, place) in organ.placements.iter().enumerate() {
                let (turn, scale, move_by) = checked(place, organ).map_err(damaged)?;
                // Normals scale by the inverse, or they would lean on stretched organs.
                let shrink = Vec3::from_array(
                    place.scale.map(|s| if s.abs() > 1e-12 { 1.0 / s } else { 0.0 }),
                );
                let point = |p: Vec3| turn * (scale * p) + move_by;
                let normal = |n: Vec3| (turn * (shrink * n)).normalize_or(Vec3::Z);
                let first = pile.triangles.len();
                pile.append(mesh, first_chart, &point, &normal);
                let shade = weald_contract::seed::mix(number as u64) as u16;
                pile.triangles[first..].iter_mut().for_each(|t| t.face.shade = shade);
            }
        }
    }
    pile.finish(what)
}

/// All triangles of one organ, in its own space. Parts that share no vertex differ in shade, as
/// leaves do.
///
/// # Errors
/// See [`shape`].
pub(crate) fn organ_shape(
    model: &PlantModel,
    organ: &Organ,
    what: &str,
    look: &Look<'_>,
) -> Result<Shape, Error> {
    let mut pile = Pile::new(look, triangles(organ) as usize);
    let mut part = 0;
    for mesh in &organ.meshes {
        check(mesh, model).map_err(|why| Error::BadModel {
            what: what.to_string(),
            why: format!("organ `{}` {why}", organ.name),
        })?;
        let first_chart = pile.add_charts(mesh);
        let first = pile.triangles.len();
        pile.append(mesh, first_chart, &|p| p, &|n| n);
        let mut highest = None;
        for (triangle, corners) in pile.triangles[first..].iter_mut().zip(&mesh.triangles) {
            // Meshes are written part after part.
            let lowest = corners.iter().min().copied();
            part += u64::from(lowest > highest);
            highest = highest.max(corners.iter().max().copied());
            triangle.face.shade = weald_contract::seed::mix(part) as u16;
        }
    }
    pile.finish(what)
}

/// Turn, scale and place of an organ, or what is wrong with them.
pub(crate) fn checked(place: &Placement, organ: &Organ) -> Result<(Quat, Vec3, Vec3), String> {
    let turn = Quat::from_array(place.rotation);
    let (scale, move_by) = (Vec3::from(place.scale), Vec3::from(place.position));
    if turn.is_finite() && scale.is_finite() && move_by.is_finite() {
        Ok((turn.normalize(), scale, move_by))
    } else {
        Err(format!("a place of organ `{}` is no number", organ.name))
    }
}

/// Triangles of a model while they are gathered.
struct Pile<'a> {
    look: &'a Look<'a>,
    triangles: Vec<Triangle>,
    charts: Charts,
}

impl<'a> Pile<'a> {
    fn new(look: &'a Look<'a>, capacity: usize) -> Self {
        Self { look, triangles: Vec::with_capacity(capacity), charts: Charts::default() }
    }

    fn brush(&self, material: u16) -> Option<Brush> {
        self.look.brushes.get(usize::from(material)).copied().flatten()
    }

    fn material(&self, mesh: &Mesh) -> u16 {
        self.look.materials.get(mesh.material as usize).copied().unwrap_or(0)
    }

    /// Adds a chart for each triangle of a painted mesh; returns the number of the first.
    fn add_charts(&mut self, mesh: &Mesh) -> Option<u32> {
        add_charts(mesh, self.brush(self.material(mesh)), &mut self.charts)
    }

    fn append(
        &mut self,
        mesh: &Mesh,
        first_chart: Option<u32>,
        point: &dyn Fn(Vec3) -> Vec3,
        normal: &dyn Fn(Vec3) -> Vec3,
    ) {
        let material = self.material(mesh);
        append(mesh, material, first_chart, &mut self.triangles, point, normal);
    }

    fn finish(mut self, what: &str) -> Result<Shape, Error> {
        let reach = |t: &Triangle| {
            t.corners.iter().any(|c| !c.is_finite() || c.abs().max_element() > MODEL_REACH)
        };
        if self.triangles.iter().any(reach) {
            let why = format!("it reaches farther than {MODEL_REACH} m");
            return Err(Error::BadModel { what: what.to_string(), why });
        }
        if self.triangles.len() > MOST_TRIANGLES {
            return Err(Error::TooMany {
                what: format!("triangles of {what}"),
                count: self.triangles.len(),
                limit: MOST_TRIANGLES,
            });
        }
        let triangles = join_pairs(&self.triangles, &mut self.charts);
        let charts = std::mem::take(&mut self.charts.list);
        let brush = |face: &Face| self.brush(face.material);
        Ok(cut_out(triangles, charts, &brush, self.look.textures))
    }
}

/// What is wrong with a mesh, if anything is.
fn check(mesh: &Mesh, model: &PlantModel) -> Result<(), String> {
    if !mesh.is_sound(model.materials.len()) {
        return Err("has an index out of range or columns of unequal length".into());
    }
    match mesh.positions.iter().position(|p| p.iter().any(|c| !c.is_finite())) {
        Some(index) => Err(format!("has a vertex that is no number (vertex {index})")),
        None => Ok(()),
    }
}

/// Adds a chart for each triangle of a painted mesh; returns the number of the first.
fn add_charts(mesh: &Mesh, brush: Option<Brush>, charts: &mut Charts) -> Option<u32> {
    let Brush { size, .. } = brush.filter(|_| !mesh.uvs.is_empty())?;
    let first = charts.list.len() as u32;
    charts.list.extend(mesh.triangles.iter().map(|indices| {
        let copies = |i: u32| {
            let uv = mesh.uvs[i as usize];
            [0, 1].map(|axis| {
                let copies = uv[axis] / size[axis];
                if copies.is_finite() { copies } else { 0.0 }
            })
        };
        let corners = indices.map(copies);
        // Whole copies look the same; without them more digits are left for the rest.
        let whole = [0, 1].map(|axis| corners[0][axis].floor());
        let corners = corners.map(|corner| [0, 1].map(|axis| corner[axis] - whole[axis]));
        Chart { corners, outline: NO_OUTLINE }
    }));
    Some(first)
}

/// Adds a mesh's triangles, brought to their place.
fn append(
    mesh: &Mesh,
    material: u16,
    first_chart: Option<u32>,
    triangles: &mut Vec<Triangle>,
    point: &dyn Fn(Vec3) -> Vec3,
    normal: &dyn Fn(Vec3) -> Vec3,
) {
    for (number, indices) in (0..).zip(&mesh.triangles) {
        let corners = indices.map(|i| point(Vec3::from(mesh.positions[i as usize])));
        let flat = (corners[1] - corners[0]).cross(corners[2] - corners[0]);
        let flat = flat.normalize_or(Vec3::Z);
        let normals = if mesh.normals.is_empty() {
            [flat; 3]
        } else {
            indices.map(|i| {
                let n = normal(Vec3::from(mesh.normals[i as usize]));
                if n.is_finite() { n } else { flat }
            })
        };
        let mut face = Face::new(normals, material);
        if let Some(first) = first_chart {
            face = face.on_chart(first + number, false);
        }
        triangles.push(Triangle::new(corners, face));
    }
}

/// Looks at what textures cut out: triangles of which nothing is left go, and those of which parts
/// are left learn their outline.
fn cut_out(
    mut triangles: Vec<Triangle>,
    mut charts: Vec<Chart>,
    brush: &dyn Fn(&Face) -> Option<Brush>,
    textures: &[Pyramid],
) -> Shape {
    let mut outlines: Vec<Outline> = Vec::new();
    // Organs name the same few charts at all their places.
    let mut known: BTreeMap<u32, Outline> = BTreeMap::new();
    triangles.retain_mut(|triangle| {
        let Some(number) = triangle.face.chart() else { return true };
        let Some(Brush { texture, cutout: Some(least), .. }) = brush(&triangle.face) else {
            return true;
        };
        let chart = &mut charts[number as usize];
        let outline =
            known.entry(number).or_insert_with(|| Outline::new(chart, textures, texture, least));
        match outline.of_all(triangle.is_half) {
            Presence::Absent => false,
            Presence::Whole => true,
            Presence::Mixed => {
                if chart.outline == NO_OUTLINE {
                    chart.outline = outlines.len() as u32;
                    outlines.push(outline.clone());
                }
                triangle.face = triangle.face.on_chart(number, true);
                true
            }
        }
    });
    Shape { triangles, charts, outlines }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::{Level, Levels, Ray, Scratch};
    use weald_contract::Texture;

    /// Half of it red and there, half blue and gone.
    fn halves() -> Texture {
        let texel = |i: usize| if i % 8 < 4 { [255, 0, 0, 255] } else { [0, 0, 255, 0] };
        Texture { name: "halves".into(), width: 8, height: 8, texels: (0..64).map(texel).collect() }
    }

    /// A square leaf of 1 m that lies level, at two places, painted with `texture`.
    fn leaf(texture: Texture, cutout: Option<f32>) -> PlantModel {
        let mesh = Mesh {
            positions: vec![[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [0.0, 1.0, 0.0]],
            uvs: vec![[0.0, 0.0], [1.0, 0.0], [1.0, 1.0], [0.0, 1.0]],
            triangles: vec![[0, 1, 2], [0, 2, 3]],
            ..Mesh::default()
        };
        let place = |x: f32| Placement {
            position: [x, 0.0, 0.0],
            rotation: [0.0, 0.0, 0.0, 1.0],
            scale: [1.0; 3],
        };
        let material = weald_contract::Material {
            name: "leaf".into(),
            reflectance: [0.5; 3],
            roughness: 1.0,
            paint: Some(Paint { texture: 0, size: [1.0; 2] }),
            cutout,
            ..weald_contract::Material::default()
        };
        let organ = Organ {
            name: "leaf".into(),
            meshes: vec![mesh],
            placements: vec![place(0.0), place(5.0)],
            ..Organ::default()
        };
        PlantModel {
            materials: vec![material],
            textures: vec![texture],
            organs: vec![organ],
            ..PlantModel::default()
        }
    }

    fn levels(model: &PlantModel) -> (Levels, Gallery) {
        let mut gallery = Gallery::default();
        let brushes: Vec<Option<Brush>> = model
            .materials
            .iter()
            .map(|material| gallery.brush(material, model).expect("its texture is sound"))
            .collect();
        let materials: Vec<u16> = (0..model.materials.len() as u16).collect();
        let look = Look { materials: &materials, brushes: &brushes, textures: &gallery.textures };
        let mut shape = shape(model, "leaf", &look, &|_| false).expect("it is sound");
        let mut paints = Paints::default();
        shape.join(&mut paints);
        paints.textures = std::mem::take(&mut gallery.textures);
        (Levels::new(vec![Level::mesh(&shape.triangles)]).painted(paints), gallery)
    }

    #[test]
    fn rays_go_through_what_is_cut_out() {
        let texture = halves();
        let (levels, _) = levels(&leaf(texture.clone(), Some(0.5)));
        let mut scratch = Scratch::default();
        let mut is_met = |levels: &Levels, x: f32, y: f32| {
            let ray = Ray { origin: Vec3::new(x, y, 2.0), direction: -Vec3::Z };
            let hit = levels.nearest(0, &ray, f32::INFINITY, &mut scratch);
            assert_eq!(hit.is_some(), levels.is_blocked(0, &ray, f32::INFINITY, &mut scratch));
            hit.is_some()
        };
        for i in 0..40 {
            for j in 0..40 {
                let (x, y) = ((i as f32 + 0.5) / 40.0, (j as f32 + 0.5) / 40.0);
                // Between the middles of covered and uncovered texels coverage fades.
                let is_near_rim = (x - 0.5).abs() < 1.0 / 16.0 || !(0.0625..=0.9375).contains(&x);
                for at in [x, 5.0 + x] {
                    assert!(is_near_rim || is_met(&levels, at, y) == (x < 0.5), "{at} {y}");
                }
            }
        }
        // Without a threshold, coverage counts for nothing.
        let (whole, _) = self::levels(&leaf(texture, None));
        assert!(is_met(&whole, 0.8, 0.3));
    }

    #[test]
    fn a_leaf_that_is_all_there_or_not_at_all_needs_no_outline() {
        for (coverage, count) in [(255, 2), (0, 0)] {
            let texels = vec![[10, 20, 30, coverage]; 64];
            let (levels, _) = levels(&leaf(Texture { texels, ..halves() }, Some(0.5)));
            assert!(levels.paints.outlines.is_empty());
            let mut scratch = Scratch::default();
            let ray = Ray { origin: Vec3::new(0.3, 0.3, 2.0), direction: -Vec3::Z };
            assert_eq!(levels.is_blocked(0, &ray, 9.0, &mut scratch), count > 0);
        }
    }

    #[test]
    fn a_leaf_has_the_colours_of_its_texture_and_from_afar_their_mean() {
        let (levels, _) = levels(&leaf(halves(), None));
        // Both places share the two charts of the organ, of which one serves the parallelogram.
        assert!(levels.paints.charts.len() <= 4, "{}", levels.paints.charts.len());
        let mut scratch = Scratch::default();
        let mut color = |x: f32, y: f32, width: f32| {
            let ray = Ray { origin: Vec3::new(x, y, 2.0), direction: -Vec3::Z };
            let hit = levels.nearest(0, &ray, f32::INFINITY, &mut scratch);
            levels.paints.color(0, &levels.place(0, &hit), width)
        };
        for (x, y) in [(0.2, 0.1), (0.3, 0.8), (5.2, 0.7), (5.3, 0.2)] {
            assert_eq!(color(x, y, 0.0), Vec3::X);
            assert_eq!(color(x + 0.5, y, 0.0), Vec3::Z);
            // A window as wide as the leaf.
            assert!(color(x, y, 1.0).abs_diff_eq(Vec3::new(0.5, 0.0, 0.5), 3e-3));
        }
    }

    #[test]
    fn textures_that_are_damaged_are_refused_and_equal_ones_kept_once() {
        let mut gallery = Gallery::default();
        let mut try_brush = |model: &PlantModel| gallery.brush(&model.materials[0], model);
        let good = leaf(halves(), Some(0.5));
        assert!(try_brush(&good).is_ok() && try_brush(&good).is_ok());
        let mut short = good.clone();
        short.textures[0].texels.pop();
        assert!(try_brush(&short).unwrap_err().contains("lacks texels"));
        let mut missing = good.clone();
        missing.textures.clear();
        assert!(try_brush(&missing).unwrap_err().contains("not there"));
        let mut flat = good.clone();
        flat.materials[0].paint = Some(Paint { texture: 0, size: [0.0, 1.0] });
        assert!(try_brush(&flat).is_err());
        assert_eq!(gallery.textures.len(), 1);
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn outlines_spare_most_looks_at_texels() {
        use std::time::Instant;
        // Cards of 10 cm with a disc on them, at random in a box of 20 m: the inside of a crown.
        let texel = |i: usize| {
            let (x, y) = ((i % 128) as f32 - 63.5, (i / 128) as f32 - 63.5);
            [9, 99, 9, (255.0 * (60.5 - x.hypot(y)).clamp(0.0, 1.0)) as u8]
        };
        let texels = (0..128 * 128).map(texel).collect();
        let texture = Texture { name: "disc".into(), width: 128, height: 128, texels };
        let mut model = leaf(texture, Some(0.5));
        let mut chance = weald_contract::Seed(9).stream("crown", 0);
        let place = |_| Placement {
            position: [0; 3].map(|_| chance.around(0.0, 10.0) as f32),
            rotation: Quat::from_array([0; 4].map(|_| chance.normal() as f32))
                .normalize()
                .to_array(),
            scale: [0.1; 3],
        };
        model.organs[0].placements = (0..500_000).map(place).collect();
        let (mapped, _) = levels(&model);
        let (mut asking, _) = levels(&model);
        asking.paints.outlines.iter_mut().for_each(Outline::forget);
        model.materials[0].cutout = None;
        let (whole, _) = levels(&model);
        let rays: Vec<Ray> =
            crate::probe::random_rays(mapped.bounds(0), weald_contract::Seed(1), 0)
                .take(400_000)
                .collect();
        for (name, levels) in
            [("maps", &mapped), ("texels", &asking), ("no cut-outs", &whole)].repeat(3)
        {
            let mut scratch = Scratch::default();
            let start = Instant::now();
            let met =
                rays.iter().filter(|ray| levels.is_blocked(0, ray, f32::INFINITY, &mut scratch));
            let met = met.count();
            println!(
                "{name}: {:.3} million rays a second, {met} met",
                rays.len() as f64 / start.elapsed().as_secs_f64() / 1e6
            );
        }
    }
}
