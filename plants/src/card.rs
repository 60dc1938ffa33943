//! Cards: leaves and twigs as pictures on flat polygons, cut out by their coverage.
//!
//! A card is painted by looking straight at the geometry it stands for, from its upper side and
//! without perspective or light: the picture holds reflectances. Coverage is tested, not blended
//! (the texel is there or not), so that cards need no order.

use crate::skeleton::Skeleton;
use crate::twig::{self, unfolded};
use glam::Vec2;
use weald_contract::plant_model::srgb;
use weald_contract::{Material, Mesh, Organ, Paint, Placement, PlantModel, Surface, Texture};

/// Texels along the longer side of a card.
const SIDE: u32 = 96;

/// Points along each side of a texel at which it is tested what covers it.
const SAMPLES: u32 = 3;

/// Coverage from which a texel is there.
const CUTOUT: f32 = 0.5;

/// Twigs that are painted; each of the others takes the picture of one of them.
const TWIGS: usize = 4;

/// Turns the leaves of a model into cards: organs whose name begins with `leaf`.
pub fn leaf_cards(model: &mut PlantModel) {
    let mut organs = std::mem::take(&mut model.organs);
    for organ in organs.iter_mut().filter(|organ| organ.name.starts_with("leaf")) {
        if let Some(card) = painted(model, &organ.name, &organ.meshes, &[Facing::Up]) {
            organ.meshes = vec![card];
        }
    }
    model.organs = organs;
}

/// Removes the thinnest branches and their organs from a skeleton; what was removed comes back as
/// a skeleton of examples, each one long, and the places of all.
pub struct Pruned {
    /// What is left.
    pub rest: Skeleton,
    /// Twigs that are to be painted.
    pub examples: Vec<Skeleton>,
    /// For each example, where its picture goes, and on which axis of `rest`.
    pub places: Vec<Vec<(Placement, u32)>>,
}

/// Takes the twigs off a skeleton; `None` if it has too few of them to be worth a card.
pub fn prune(skeleton: &Skeleton) -> Option<Pruned> {
    let twig::Pruned { rest, twigs } = twig::take_off(skeleton);
    if twigs.len() < 4 * TWIGS {
        return None;
    }
    // Examples are those of middling length: of each fourth of the twigs, sorted, the middle one.
    let mut by_length: Vec<usize> = (0..twigs.len()).collect();
    by_length.sort_by(|a, b| twigs[*a].length.total_cmp(&twigs[*b].length).then(a.cmp(b)));
    let example = |k: usize| {
        let twig = &twigs[by_length[(2 * k + 1) * by_length.len() / (2 * TWIGS)]];
        twig.alone(skeleton, 1.0 / twig.length)
    };
    let mut ranks = vec![0; twigs.len()];
    by_length.iter().enumerate().for_each(|(rank, index)| ranks[*index] = rank);
    let mut places = vec![Vec::new(); TWIGS];
    for (twig, rank) in twigs.iter().zip(ranks) {
        let place = Placement {
            position: twig.foot.to_array(),
            rotation: twig.rotation.to_array(),
            scale: [twig.length; 3],
        };
        places[rank * TWIGS / twigs.len()].push((place, twig.bearer));
    }
    Some(Pruned { rest, examples: (0..TWIGS).map(example).collect(), places })
}

/// Paints examples and puts their cards in a model.
///
/// `examples` are models of the twigs; their materials and textures are those of `model`.
pub fn twig_cards(
    model: &mut PlantModel,
    examples: &[PlantModel],
    places: Vec<Vec<(Placement, u32)>>,
) {
    let sways = !model.branches.is_empty();
    for (index, (example, places)) in examples.iter().zip(places).enumerate() {
        let name = format!("twig-{index}");
        let meshes = unfolded(example);
        // Two cards that cross: a twig has leaves on all sides.
        let Some(card) = painted(model, &name, &meshes, &[Facing::Up, Facing::Side]) else {
            continue;
        };
        let branches =
            if sways { places.iter().map(|place| place.1).collect() } else { Vec::new() };
        let placements = places.into_iter().map(|place| place.0).collect();
        model.organs.push(Organ { name, meshes: vec![card], placements, branches });
    }
}

/// The plane of a card: seen from its upper side, or from beside it.
#[derive(Clone, Copy, PartialEq)]
enum Facing {
    Up,
    Side,
}

impl Facing {
    /// Place on the card and height above it.
    fn flat(self, [x, y, z]: [f32; 3]) -> (Vec2, f32) {
        match self {
            Self::Up => (Vec2::new(x, y), z),
            Self::Side => (Vec2::new(-z, y), x),
        }
    }

    fn point(self, flat: Vec2) -> [f32; 3] {
        match self {
            Self::Up => [flat.x, flat.y, 0.0],
            Self::Side => [0.0, flat.y, -flat.x],
        }
    }

    fn normal(self) -> [f32; 3] {
        match self {
            Self::Up => [0.0, 0.0, 1.0],
            Self::Side => [1.0, 0.0, 0.0],
        }
    }
}

/// Paints meshes on one card a facing, adds the texture and material to the model, and gives the
/// mesh of the cards. `None` if there is nothing to be seen.
fn painted(
    model: &mut PlantModel,
    name: &str,
    meshes: &[Mesh],
    facings: &[Facing],
) -> Option<Mesh> {
    let brightest = brightest(model, meshes)?;
    let mut canvases: Vec<(Rectangle, Canvas)> = Vec::new();
    for &facing in facings {
        let rectangle = Rectangle::around(meshes, facing)?;
        let canvas = Canvas::of(model, meshes, facing, &rectangle, brightest.reflectance);
        canvases.push((rectangle, canvas));
    }
    // Side by side in one texture.
    let height = canvases.iter().map(|(_, canvas)| canvas.height).max()?;
    let width = canvases.iter().map(|(_, canvas)| canvas.width).sum::<u32>();
    let mut texels = vec![[0, 0, 0, 0]; (width * height) as usize];
    let mut card = Mesh { material: model.materials.len() as u32, ..Mesh::default() };
    let mut left = 0;
    for (&facing, (rectangle, canvas)) in facings.iter().zip(&canvases) {
        for (row, line) in canvas.texels.chunks(canvas.width as usize).enumerate() {
            let start = row * width as usize + left as usize;
            texels[start..start + line.len()].copy_from_slice(line);
        }
        let across = [left, left + canvas.width].map(|x| x as f32 / width as f32);
        let down = canvas.height as f32 / height as f32;
        add_quad(&mut card, facing, rectangle, across, down);
        left += canvas.width;
    }
    bleed(&mut texels, width as usize);
    let texture = model.textures.len() as u32;
    model.textures.push(Texture { name: name.into(), width, height, texels });
    model.materials.push(Material {
        name: format!("{name}-card"),
        paint: Some(Paint { texture, size: [1.0; 2] }),
        cutout: Some(CUTOUT),
        ..brightest
    });
    Some(card)
}

/// A material that reflects and transmits in each channel as much as the most of all that meshes
/// show: what the card's texture is counted in.
fn brightest(model: &PlantModel, meshes: &[Mesh]) -> Option<Material> {
    let mut found: Option<Material> = None;
    let mut through = [0.0_f32; 3];
    for mesh in meshes {
        let material = model.materials.get(mesh.material as usize)?;
        let best = found.get_or_insert_with(|| material.clone());
        for channel in 0..3 {
            best.reflectance[channel] =
                best.reflectance[channel].max(material.reflectance[channel]);
        }
        if let Surface::Leaf { transmittance } = material.surface {
            through = std::array::from_fn(|c| through[c].max(transmittance[c]));
            best.roughness = material.roughness;
        }
    }
    let mut best = found?;
    let room = best.reflectance.map(|reflected| 0.95 - reflected);
    let transmittance = std::array::from_fn(|c| through[c].min(room[c]).max(0.0));
    best.surface = Surface::Leaf { transmittance };
    Some(best)
}

/// What a card covers, in its own plane.
struct Rectangle {
    low: Vec2,
    high: Vec2,
}

impl Rectangle {
    fn around(meshes: &[Mesh], facing: Facing) -> Option<Self> {
        let points = meshes.iter().flat_map(|mesh| &mesh.positions);
        let mut points = points.map(|point| facing.flat(*point).0);
        let first = points.next()?;
        let (low, high) = points.fold((first, first), |(low, high), p| (low.min(p), high.max(p)));
        let least = 1e-3 * (high - low).max_element();
        (least > 0.0).then(|| Self { low, high: high.max(low + least) })
    }

    fn size(&self) -> Vec2 {
        self.high - self.low
    }
}

/// Adds the two triangles of a card with their place in the texture.
fn add_quad(card: &mut Mesh, facing: Facing, rectangle: &Rectangle, across: [f32; 2], down: f32) {
    let first = card.positions.len() as u32;
    let Rectangle { low, high } = rectangle;
    // The texture's first row is the far end of the card.
    let corners = [
        (Vec2::new(low.x, low.y), [across[0], down]),
        (Vec2::new(high.x, low.y), [across[1], down]),
        (Vec2::new(high.x, high.y), [across[1], 0.0]),
        (Vec2::new(low.x, high.y), [across[0], 0.0]),
    ];
    for (corner, uv) in corners {
        card.positions.push(facing.point(corner));
        card.normals.push(facing.normal());
        card.uvs.push(uv);
    }
    card.triangles.extend([[0, 1, 2], [0, 2, 3]].map(|t: [u32; 3]| t.map(|i| first + i)));
}

/// A picture of meshes.
struct Canvas {
    width: u32,
    height: u32,
    texels: Vec<[u8; 4]>,
}

impl Canvas {
    fn of(
        model: &PlantModel,
        meshes: &[Mesh],
        facing: Facing,
        rectangle: &Rectangle,
        brightest: [f32; 3],
    ) -> Self {
        let size = rectangle.size();
        let longest = size.max_element();
        let texels = |side: f32| ((side / longest * SIDE as f32) as u32).clamp(8, SIDE);
        let (width, height) = (texels(size.x), texels(size.y));
        let (columns, rows) = ((width * SAMPLES) as usize, (height * SAMPLES) as usize);
        let mut samples = vec![(f32::NEG_INFINITY, [0.0_f32; 3]); columns * rows];
        for mesh in meshes {
            for triangle in &mesh.triangles {
                fill(model, mesh, triangle, facing, rectangle, (columns, rows), &mut samples);
            }
        }
        let mut canvas = Self { width, height, texels: Vec::new() };
        for row in 0..height {
            for column in 0..width {
                let mut sum = [0.0; 3];
                let mut covered = 0;
                for y in row * SAMPLES..(row + 1) * SAMPLES {
                    for x in column * SAMPLES..(column + 1) * SAMPLES {
                        let (depth, color) = samples[y as usize * columns + x as usize];
                        if depth > f32::NEG_INFINITY {
                            covered += 1;
                            (0..3).for_each(|c| sum[c] += color[c]);
                        }
                    }
                }
                let mean = |c: usize| srgb(sum[c] / covered.max(1) as f32 / brightest[c].max(1e-6));
                let coverage = covered * 255 / (SAMPLES * SAMPLES);
                canvas.texels.push([mean(0), mean(1), mean(2), coverage as u8]);
            }
        }
        canvas
    }
}

/// Marks the samples that a triangle covers and that nothing above it covers.
fn fill(
    model: &PlantModel,
    mesh: &Mesh,
    triangle: &[u32; 3],
    facing: Facing,
    rectangle: &Rectangle,
    (columns, rows): (usize, usize),
    samples: &mut [(f32, [f32; 3])],
) {
    let Some(material) = model.materials.get(mesh.material as usize) else { return };
    let grid = Vec2::new(columns as f32, rows as f32) / rectangle.size();
    let corner = |index: u32| {
        let (flat, depth) = facing.flat(mesh.positions[index as usize]);
        let place = (flat - rectangle.low) * grid;
        (Vec2::new(place.x, rows as f32 - place.y), depth)
    };
    let [(a, za), (b, zb), (c, zc)] = triangle.map(corner);
    let area = (b - a).perp_dot(c - a);
    if area.abs() < 1e-9 {
        return;
    }
    let uv = |index: u32| Vec2::from(mesh.uvs.get(index as usize).copied().unwrap_or_default());
    let uvs = triangle.map(uv);
    let (low, high) = (a.min(b).min(c), a.max(b).max(c));
    let range = |low: f32, high: f32, most: usize| {
        (low.max(0.0) as usize).min(most)..(high.max(0.0).ceil() as usize).min(most)
    };
    for y in range(low.y, high.y, rows) {
        for x in range(low.x, high.x, columns) {
            let p = Vec2::new(x as f32 + 0.5, y as f32 + 0.5);
            let weight = |u: Vec2, v: Vec2| (v - u).perp_dot(p - u) / area;
            let (wa, wb, wc) = (weight(b, c), weight(c, a), weight(a, b));
            let depth = wa * za + wb * zb + wc * zc;
            let sample = &mut samples[y * columns + x];
            if wa.min(wb).min(wc) >= 0.0 && depth > sample.0 {
                let shade = material.paint.and_then(|paint| {
                    let at = (wa * uvs[0] + wb * uvs[1] + wc * uvs[2]) / Vec2::from(paint.size);
                    Some(model.textures.get(paint.texture as usize)?.at(at.x, at.y))
                });
                let shade = shade.unwrap_or([1.0; 4]);
                *sample = (depth, std::array::from_fn(|c| material.reflectance[c] * shade[c]));
            }
        }
    }
}

/// Lets colours run a little way out under what is cut off, so that filters find no dark rim.
fn bleed(texels: &mut [[u8; 4]], width: usize) {
    for _ in 0..3 {
        let old = texels.to_vec();
        for (index, texel) in texels.iter_mut().enumerate().filter(|(_, texel)| texel[3] == 0) {
            let around =
                [index.wrapping_sub(1), index + 1, index.wrapping_sub(width), index + width];
            let found = around.into_iter().filter_map(|at| old.get(at));
            if let Some([r, g, b, _]) = found.into_iter().find(|t| t[..3] != [0, 0, 0]) {
                *texel = [*r, *g, *b, 0];
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::LeafColor;
    use crate::organ::{LeafShape, leaf, leaf_area};
    use crate::skeleton::{Axis, AxisKind, Node, PlacedOrgan};
    use glam::{Quat, Vec3};

    /// Area of a card that is there, of a card of two triangles.
    fn covered(model: &PlantModel, mesh: &Mesh) -> f32 {
        let material = &model.materials[mesh.material as usize];
        let texture = &model.textures[material.paint.unwrap().texture as usize];
        let there = texture.texels.iter().filter(|texel| texel[3] >= 128).count();
        let area = crate::mesh::organ_area(mesh, Vec3::ONE);
        area * there as f32 / texture.texels.len() as f32
    }

    #[test]
    fn a_leaf_card_covers_what_the_leaf_covers() {
        for shape in [LeafShape::Ovate, LeafShape::Lobed, LeafShape::Runcinate] {
            let material = LeafColor::default().material("leaf", 1.0, 0, 1);
            let green = material.reflectance;
            let organ = Organ {
                name: "leaf-0".into(),
                meshes: vec![leaf(shape, 0.1, 0.1, 0)],
                ..Organ::default()
            };
            let mut model = PlantModel {
                materials: vec![material],
                organs: vec![organ],
                ..PlantModel::default()
            };
            leaf_cards(&mut model);
            let card = &model.organs[0].meshes[0];
            assert_eq!(card.triangles.len(), 2);
            let (found, expected) = (covered(&model, card), leaf_area(shape));
            assert!((found / expected - 1.0).abs() < 0.08, "{shape:?}: {found} {expected}");
            assert_eq!(model.materials[1].reflectance, green);
        }
    }

    #[test]
    fn twigs_become_cards_where_they_were() {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(crate::material::opaque("bark", [0.2; 3]));
        let green = skeleton.add_material(LeafColor::default().material("leaf", 1.0, 0, 1));
        let leaf = skeleton.add_prototype("leaf", vec![leaf(LeafShape::Ovate, 0.0, 0.0, green)]);
        let node = |position, radius| Node { position, radius };
        let trunk = [node(Vec3::ZERO, 0.1), node(Vec3::Z * 4.0, 0.02)];
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), trunk);
        for i in 0..40 {
            let foot = Vec3::Z * (0.1 * i as f32);
            let tip = foot + Vec3::new(0.3 + 0.01 * i as f32, 0.0, 0.1);
            let axis = Axis::new(2 + i, AxisKind::Stem, 0).on(0, 0.025 * i as f32, 1);
            let axis = skeleton.push(axis, [node(foot, 0.004), node(tip, 0.001)]);
            let (position, rotation) = (tip, Quat::IDENTITY);
            let scale = Vec3::splat(0.1);
            skeleton.organs.push(PlacedOrgan { prototype: leaf, axis, position, rotation, scale });
        }
        let pruned = prune(&skeleton).unwrap();
        assert_eq!((pruned.rest.axes.len(), pruned.rest.organs.len()), (1, 0));
        assert_eq!(pruned.places.iter().map(Vec::len).collect::<Vec<_>>(), [10; 4]);
        assert!(pruned.examples.iter().all(|example| example.organs.len() == 1));
        let tip = pruned.examples[0].nodes_of(&pruned.examples[0].axes[0])[1].position;
        assert!(tip.distance(Vec3::Y) < 1e-5);
        let examples: Vec<PlantModel> =
            pruned.examples.iter().map(|twig| crate::mesh::model("twig", twig)).collect();
        let mut model = crate::mesh::model("tree", &pruned.rest);
        twig_cards(&mut model, &examples, pruned.places);
        assert_eq!(model.organs.len(), 4);
        for organ in &model.organs {
            assert_eq!(organ.meshes[0].triangles.len(), 4);
            assert!(organ.meshes[0].is_sound(model.materials.len()));
        }
        assert!(prune(&pruned.rest).is_none());
    }
}
