//! Fruits: hung beside leaves or set in the place of flowers that have faded.

use crate::frame::organ_rotation;
use crate::material::opaque;
use crate::mesh::append;
use crate::organ::{bead, dome, scaled};
use crate::presence::threshold;
use crate::skeleton::{PlacedOrgan, Skeleton};
use glam::{Quat, Vec3};
use weald_contract::{Mesh, Seed, table, words};

words! {
    /// Shape of a fruit.
    pub enum FruitShape {
        /// A round body, as of apples, cherries and berries.
        Berry = "berry",
        /// A nut in a cup, as of oaks.
        Acorn = "acorn",
        /// Overlapping scales around an axis, as of larches and alders.
        Cone = "cone",
        /// A hanging tassel, as of birches, willows and poplars.
        Catkin = "catkin",
        /// Two wings around a seed, as of maples and ashes.
        Samara = "samara",
        /// A cluster of small round bodies, as of brambles.
        Aggregate = "aggregate",
        /// Seeds that each hang on a parachute, as of dandelions.
        Clock = "clock",
    }
}

words! {
    /// What a fruit grows beside or from.
    pub enum FruitPlace {
        /// Beside leaves.
        Leaf = "leaf",
        /// In the place of flowers.
        Flower = "flower",
    }
}

table! {
    /// Fruits of a species.
    pub struct Fruit {
        /// Shape.
        shape: FruitShape;
        /// Where they grow.
        on: FruitPlace = FruitPlace::Leaf;
        /// Part of the leaves, or flowers, that bear one.
        part: f32 = 0.05, in 0.0..=1.0;
        /// Length, m.
        size: f32 = 0.02, in 0.0005..=0.5;
        /// Width over length.
        width: f32 = 0.8, in 0.02..=5.0;
        /// Length of the stalk over that of the fruit.
        stalk: f32 = 0.5, in 0.0..=10.0;
        /// Reflectance while it grows.
        unripe: [f32; 3] = [0.10, 0.20, 0.05], in 0.0..=0.9;
        /// Reflectance when it is ripe.
        ripe: [f32; 3] = [0.30, 0.06, 0.04], in 0.0..=0.9;
        /// Days of the year on which fruits begin to grow, are ripe and fall.
        days: [f32; 3] = [170.0, 240.0, 300.0], in 0.0..=366.0;
        /// Height as part of the mature height from which a plant bears.
        from: f32 = 0.3, in 0.0..=1.0;
    }
}

impl Fruit {
    /// How large fruits are on a day, 0 to 1, and how ripe; without a day they hang ripe.
    fn state(&self, day: Option<f32>) -> (f32, f32) {
        let [begin, ripe, fall] = self.days;
        let Some(day) = day else { return (1.0, 1.0) };
        if day < begin || day >= fall {
            return (0.0, 0.0);
        }
        let part = if ripe > begin { ((day - begin) / (ripe - begin)).min(1.0) } else { 1.0 };
        // It swells first and colours last.
        (0.25 + 0.75 * part.min(0.8) / 0.8, ((part - 0.6) / 0.4).clamp(0.0, 1.0))
    }
}

/// Hangs a species' fruits on a plant of this part of its mature height.
///
/// Which leaves or flowers bear is a matter of their order, so that a growing plant keeps its
/// fruits. Flowers that have become fruits are taken away.
pub fn bear(skeleton: &mut Skeleton, fruit: &Fruit, maturity: f32, day: Option<f32>, seed: Seed) {
    let (size, ripeness) = fruit.state(day);
    if size == 0.0 || maturity < fruit.from {
        return;
    }
    let prefix = match fruit.on {
        FruitPlace::Leaf => "leaf",
        FruitPlace::Flower => "flower",
    };
    let bears: Vec<bool> = skeleton.prototypes.iter().map(|p| p.name.starts_with(prefix)).collect();
    let mix = |channel: usize| {
        fruit.unripe[channel] + (fruit.ripe[channel] - fruit.unripe[channel]) * ripeness
    };
    let mut skin = opaque("fruit", [mix(0), mix(1), mix(2)]);
    skin.roughness = 0.4;
    let skin = skeleton.add_material(skin);
    let stalk = skeleton.add_material(opaque("stalk", [0.12, 0.12, 0.05]));
    let prototype = skeleton.add_prototype("fruit", meshes(fruit, skin, stalk));
    let mut met = 0;
    let mut fruits = Vec::new();
    skeleton.organs.retain(|organ| {
        if !bears.get(organ.prototype as usize).copied().unwrap_or(false) {
            return true;
        }
        met += 1;
        if threshold(met) >= fruit.part {
            return true;
        }
        let mut stream = seed.stream("fruit", u64::from(met));
        let length = fruit.size * size * stream.range(0.8, 1.15) as f32;
        fruits.push(PlacedOrgan {
            prototype,
            axis: organ.axis,
            position: organ.position,
            rotation: pose(fruit, organ, stream.range(-1.0, 1.0) as f32),
            scale: Vec3::splat(length),
        });
        fruit.on == FruitPlace::Leaf
    });
    skeleton.organs.extend(fruits);
}

/// Beside leaves fruits hang, a little towards where the leaf points; what was a flower keeps its
/// direction.
fn pose(fruit: &Fruit, organ: &PlacedOrgan, spin: f32) -> Quat {
    if fruit.on == FruitPlace::Flower {
        return organ.rotation;
    }
    let heading = (0.5 * (organ.rotation * Vec3::Y) - 1.4 * Vec3::Z).normalize_or(-Vec3::Z);
    let side = organ.rotation * Vec3::X + 0.3 * spin * Vec3::Z;
    organ_rotation(crate::frame::frame_of(heading, side))
}

/// The fruit one long with its stalk, hanging along +Y from the origin.
fn meshes(fruit: &Fruit, skin: u32, stalk: u32) -> Vec<Mesh> {
    let body = |mesh: Mesh, width: f32, from: f32| placed(mesh, [width, 1.0, width], from);
    let from = fruit.stalk;
    let mut meshes = match fruit.shape {
        FruitShape::Berry => vec![body(bead(6, skin), fruit.width, from)],
        FruitShape::Catkin => vec![body(bead(5, skin), fruit.width, from)],
        FruitShape::Acorn => {
            // The cup covers the upper third and is a little wider.
            let mut cup = scaled(dome(6, -0.9, stalk), 0.42, [0.0; 3]);
            cup.triangles.iter_mut().for_each(|triangle| triangle.swap(1, 2));
            cup.normals.iter_mut().flatten().for_each(|part| *part = -*part);
            let cup = placed(cup, [fruit.width * 1.25, 0.9, fruit.width * 1.25], from + 0.4);
            vec![body(bead(6, skin), fruit.width, from), cup]
        }
        FruitShape::Cone => vec![body(cone(skin), fruit.width, from)],
        FruitShape::Samara => vec![placed(samara(skin), [fruit.width, 1.0, 1.0], from)],
        FruitShape::Aggregate => vec![body(aggregate(skin), fruit.width, from)],
        FruitShape::Clock => vec![placed(clock(skin), [1.0; 3], 0.0)],
    };
    if from > 0.0 && fruit.shape != FruitShape::Clock {
        meshes.push(placed(bead(3, stalk), [0.05, from, 0.05], 0.0));
    }
    meshes
}

/// The mesh stretched and moved along +Y.
fn placed(mut mesh: Mesh, scale: [f32; 3], from: f32) -> Mesh {
    for position in &mut mesh.positions {
        *position = std::array::from_fn(|axis| position[axis] * scale[axis]);
        position[1] += from;
    }
    for normal in &mut mesh.normals {
        let turned = Vec3::from_array(std::array::from_fn(|axis| normal[axis] / scale[axis]));
        *normal = turned.normalize_or(Vec3::Y).to_array();
    }
    mesh
}

/// Five whorls of four scales each, one long and one wide.
fn cone(material: u32) -> Mesh {
    let mut cone = Mesh::default();
    const WHORLS: u32 = 5;
    for whorl in 0..WHORLS {
        let along = (whorl as f32 + 0.5) / WHORLS as f32;
        let radius = 0.5 * libm::sinf(std::f32::consts::PI * (0.15 + 0.8 * along)).max(0.2);
        let scale = dome(4, 0.55, material);
        let turned = Quat::from_xyzw(
            0.0,
            libm::sinf(0.4 * whorl as f32),
            0.0,
            libm::cosf(0.4 * whorl as f32),
        );
        let mut scale = placed(scale, [radius, 0.45, radius], along - 0.1);
        for vector in scale.positions.iter_mut().chain(&mut scale.normals) {
            *vector = (turned * Vec3::from_array(*vector)).to_array();
        }
        append(&mut cone, &scale);
    }
    cone
}

/// A seed with two wings that hang at an angle.
fn samara(material: u32) -> Mesh {
    let mut wings = Mesh { material, ..Mesh::default() };
    for side in [-1.0_f32, 1.0] {
        let first = wings.positions.len() as u32;
        let rim = [[0.0, 0.0], [0.10, 0.05], [0.34, 0.55], [0.5, 0.95], [0.36, 1.0], [0.14, 0.5]];
        wings.positions.extend(rim.map(|[x, y]| [side * x, y, 0.03 * x]));
        wings.normals.extend([[0.0, 0.0, 1.0]; 6]);
        for [a, b, c] in [[0, 1, 5], [1, 2, 5], [2, 4, 5], [2, 3, 4]] {
            let turned = if side > 0.0 { [a, b, c] } else { [a, c, b] };
            wings.triangles.push(turned.map(|index| first + index));
        }
    }
    wings
}

/// Twelve drupelets around a core.
fn aggregate(material: u32) -> Mesh {
    let mut whole = Mesh::default();
    for drupelet in 0..12_u32 {
        let (row, place) = (drupelet / 4, drupelet % 4);
        let angle = std::f32::consts::TAU * (place as f32 + 0.5 * (row % 2) as f32) / 4.0;
        let out = if row == 2 { 0.14 } else { 0.27 };
        let (sin, cos) = libm::sincosf(angle);
        let mut part = placed(bead(4, material), [0.5, 0.42, 0.5], 0.08 + 0.25 * row as f32);
        for position in &mut part.positions {
            position[0] += out * cos;
            position[2] += out * sin;
        }
        append(&mut whole, &part);
    }
    whole
}

/// Parachutes all around a point: each a thin ray with a flat tuft at its end.
fn clock(material: u32) -> Mesh {
    let mut whole = Mesh { material, ..Mesh::default() };
    const SEEDS: u32 = 36;
    for seed in 0..SEEDS {
        // Evenly spread over the sphere by the golden angle [Vogel79].
        let y = 1.0 - 2.0 * (seed as f32 + 0.5) / SEEDS as f32;
        let ring = (1.0 - y * y).max(0.0).sqrt();
        let (sin, cos) = libm::sincosf(2.399_963_2 * seed as f32);
        let out = Vec3::new(ring * cos, y, ring * sin);
        let side = crate::frame::any_normal(out);
        let up = out.cross(side);
        let first = whole.positions.len() as u32;
        let tip = out * 0.8;
        let points = [
            Vec3::ZERO,
            tip + side * 0.01,
            tip - side * 0.01,
            tip,
            out + side * 0.18,
            out + up * 0.18 - side * 0.09,
            out - up * 0.18 - side * 0.09,
        ];
        whole.positions.extend(points.map(|p| (0.5 * p).to_array()));
        whole.normals.extend([out.to_array(); 7]);
        let faces = [[0, 1, 2], [3, 4, 5], [3, 5, 6], [3, 6, 4]];
        whole.triangles.extend(faces.map(|face| face.map(|index: u32| first + index)));
    }
    whole
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::skeleton::{Axis, AxisKind, Node};
    use weald_contract::{FromToml, Value};

    fn fruit(text: &str) -> Fruit {
        Fruit::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap()
    }

    fn twig(name: &str) -> Skeleton {
        let mut skeleton = Skeleton::default();
        let green = skeleton.add_material(opaque("leaf", [0.1; 3]));
        let prototype = skeleton.add_prototype(name, Vec::new());
        let node = |z| Node { position: Vec3::Z * z, radius: 0.01 };
        let axis = skeleton.push(Axis::new(1, AxisKind::Stem, green), [node(0.0), node(1.0)]);
        let (position, rotation, scale) = (Vec3::Z, Quat::IDENTITY, Vec3::ONE);
        let organ = PlacedOrgan { prototype, axis, position, rotation, scale };
        skeleton.organs = vec![organ; 400];
        skeleton
    }

    #[test]
    fn part_of_the_leaves_bear_a_fruit_that_hangs() {
        let mut skeleton = twig("leaf-0");
        bear(&mut skeleton, &fruit("shape = \"acorn\"\npart = 0.1"), 1.0, None, Seed(1));
        assert_eq!(skeleton.check(), Ok(()));
        let fruits: Vec<_> = skeleton.organs.iter().filter(|o| o.prototype == 1).collect();
        assert!((36..=44).contains(&fruits.len()), "{}", fruits.len());
        assert_eq!(skeleton.organs.len(), 400 + fruits.len());
        assert!(fruits.iter().all(|f| (f.rotation * Vec3::Y).z < -0.5));
    }

    #[test]
    fn flowers_become_fruits() {
        let mut skeleton = twig("flower");
        let text = "shape = \"clock\"\non = \"flower\"\npart = 0.5";
        bear(&mut skeleton, &fruit(text), 1.0, None, Seed(1));
        assert_eq!(skeleton.organs.len(), 400);
    }

    #[test]
    fn fruits_come_ripen_and_fall_by_the_day() {
        let fruit = fruit("shape = \"berry\"\ndays = [170, 240, 300]");
        assert_eq!(fruit.state(Some(100.0)), (0.0, 0.0));
        let (young, green) = fruit.state(Some(180.0));
        assert!(young > 0.2 && young < 0.6 && green == 0.0);
        let (size, ripe) = fruit.state(Some(250.0));
        assert!(size == 1.0 && ripe > 0.999);
        assert_eq!(fruit.state(Some(300.0)), (0.0, 0.0));
    }

    #[test]
    fn every_shape_is_sound_and_hangs_below_its_stalk() {
        for shape in ["berry", "acorn", "cone", "catkin", "samara", "aggregate", "clock"] {
            let fruit = fruit(&format!("shape = \"{shape}\""));
            for mesh in meshes(&fruit, 0, 1) {
                assert!(mesh.is_sound(2) && !mesh.triangles.is_empty(), "{shape}");
                let unit = |n: &[f32; 3]| (Vec3::from_array(*n).length() - 1.0).abs() < 1e-3;
                assert!(mesh.normals.iter().all(unit), "{shape}");
                assert!(mesh.positions.iter().all(|p| p[1] < 1.7 && p[1] > -0.6), "{shape}");
            }
        }
    }
}
