//! The wood: one tree of 507,200 triangles and its places.

use std::collections::BTreeMap;
use std::error::Error;
use std::f64::consts::TAU;
use std::io::Write;
use std::path::Path;
use std::sync::Arc;
use weald_contract::instances::Instance;
use weald_contract::{
    Crs, Frame, Instances, Layers, Material, Mesh, Palette, PlantModel, Problem, Representative,
    Seed, Silent, Surface,
};
use weald_render::{Parts, PrototypeSource, Scene, Sky, SkyPictures};

type Point = glam::DVec3;

/// Where a tree stands.
pub struct Place {
    pub x: f64,
    pub y: f64,
    pub yaw: f64,
    pub scale: f64,
}

/// N places of a tree, on level ground.
pub struct Wood {
    pub tree: Arc<PlantModel>,
    pub places: Vec<Place>,
    /// Length of a side, m.
    pub side: f64,
    terrain: Layers,
    /// Positions of the ground's mesh, three a triangle.
    pub ground: Mesh,
}

/// Wood (trunk, 70 limbs, 3,150 twigs) and 240,000 leaves, each a rectangle.
pub fn tree() -> Arc<PlantModel> {
    let mut chance = Seed(7).stream("tree", 0);
    let mut wood = Mesh { material: 0, ..Mesh::default() };
    let mut trunk = vec![Point::ZERO];
    for step in 0..16 {
        let aside = Point::new(0.08 * chance.normal(), 0.08 * chance.normal(), 1.0);
        trunk.push(trunk[step] + aside);
    }
    for step in 0..16 {
        let radius = |k: usize| 0.28 * (1.0 - k as f64 / 17.0);
        tube(&mut wood, [trunk[step], trunk[step + 1]], [radius(step), radius(step + 1)], 10);
    }
    let mut twigs = Vec::new();
    for limb in 0..70 {
        let height = chance.range(4.0, 15.5);
        let step = (height as usize).min(15);
        let base = trunk[step].lerp(trunk[step + 1], height - step as f64);
        let reach = 3.2 * (1.0 - ((height - 8.5) / 8.0).powi(2)).max(0.05).sqrt();
        let turn = limb as f64 * 2.39996;
        let way = Point::new(turn.cos(), turn.sin(), chance.range(0.35, 0.65)).normalize();
        let (middle, end) = (base + 0.5 * reach * way + 0.15 * Point::Z, base + reach * way);
        tube(&mut wood, [base, middle], [0.06, 0.035], 6);
        tube(&mut wood, [middle, end], [0.035, 0.01], 6);
        for _ in 0..45 {
            let part = chance.range(0.25, 1.0);
            let from = if part < 0.5 {
                base.lerp(middle, 2.0 * part)
            } else {
                middle.lerp(end, 2.0 * part - 1.0)
            };
            let aside = Point::new(chance.normal(), chance.normal(), chance.normal());
            let to = from + (0.6 * way + 0.6 * aside).normalize() * chance.range(0.35, 0.85);
            tube(&mut wood, [from, to], [0.008, 0.003], 4);
            twigs.push([from, to]);
        }
    }
    let mut leaves = Mesh { material: 1, ..Mesh::default() };
    for _ in 0..240_000 {
        let [from, to] = twigs[chance.below(twigs.len() as u64) as usize];
        let spread = Point::new(chance.normal(), chance.normal(), chance.normal()) * 0.05;
        let foot = from.lerp(to, chance.unit()) + spread;
        let along = Point::new(chance.normal(), chance.normal(), 0.5 * chance.normal()).normalize();
        let across = Point::new(chance.normal(), chance.normal(), chance.normal());
        let across = (across - along * along.dot(across)).normalize();
        let (along, across) =
            (along * chance.range(0.07, 0.1), across * chance.range(0.02, 0.0275));
        let first = leaves.positions.len() as u32;
        let corners = [foot - across, foot + across, foot + across + along, foot - across + along];
        leaves.positions.extend(corners.map(|corner| corner.as_vec3().to_array()));
        leaves.triangles.extend([[0, 1, 3], [2, 3, 1]].map(|three| three.map(|i| first + i)));
    }
    Arc::new(PlantModel {
        name: "tree".into(),
        materials: vec![grey("wood", 0.5), grey("leaf", 0.5)],
        wood: vec![wood, leaves],
        ..PlantModel::default()
    })
}

/// A side of a truncated cone.
fn tube(mesh: &mut Mesh, ends: [Point; 2], radii: [f64; 2], sides: u32) {
    let way = (ends[1] - ends[0]).normalize();
    let (u, v) = way.any_orthonormal_pair();
    let first = mesh.positions.len() as u32;
    for (end, radius) in ends.into_iter().zip(radii) {
        for side in 0..sides {
            let (sin, cos) = (TAU * f64::from(side) / f64::from(sides)).sin_cos();
            mesh.positions.push((end + radius * (cos * u + sin * v)).as_vec3().to_array());
        }
    }
    for side in 0..sides {
        let next = (side + 1) % sides;
        let quad = [[side, next, side + sides], [next, next + sides, side + sides]];
        mesh.triangles.extend(quad.map(|three| three.map(|i| first + i)));
    }
}

fn grey(name: &str, reflectance: f32) -> Material {
    Material {
        name: name.into(),
        reflectance: [reflectance; 3],
        roughness: 1.0,
        surface: Surface::Opaque,
        ..Material::default()
    }
}

struct Model(Arc<PlantModel>);

impl PrototypeSource for Model {
    fn model(&self, _: u32) -> Result<Arc<PlantModel>, Problem> {
        Ok(self.0.clone())
    }
}

impl Wood {
    /// N places on a jittered lattice, with a clearing of 6 m in the middle.
    pub fn new(tree: &Arc<PlantModel>, count: usize) -> Result<Self, Box<dyn Error>> {
        let mut chance = Seed(11).stream("places", count as u64);
        let cells = (count as f64).sqrt().ceil() as usize;
        let side = 5.0 * cells as f64;
        let mut places = Vec::with_capacity(count);
        for index in 0..count {
            let mut at = |cell: usize| {
                5.0 * (cell as f64 + 0.5 + chance.around(0.0, 0.35) - cells as f64 / 2.0)
            };
            let (mut x, mut y) = (at(index % cells), at(index / cells));
            let away = x.hypot(y);
            if away < 6.0 {
                (x, y) = (x * 6.0 / away.max(0.1), y * 6.0 / away.max(0.1));
            }
            let (yaw, scale) = (chance.range(0.0, TAU), chance.range(0.7, 1.3));
            places.push(Place { x: x + side / 2.0, y: y + side / 2.0, yaw, scale });
        }
        let frame = Frame { width: 50, height: 50, cell: side / 50.0, west: 0.0, south: 0.0 };
        let mut terrain =
            Layers { frame, crs: Crs::default(), layers: BTreeMap::new(), detail: Vec::new() };
        terrain.insert("altitude", "m", "Height.", vec![0.0; frame.len()]);
        let [ground, _] = weald_render::ground_mesh(&terrain)?;
        Ok(Self { tree: tree.clone(), places, side, terrain, ground })
    }

    /// Name, place and direction of the two eyes.
    pub fn eyes(&self) -> [(&'static str, [f32; 3], [f32; 3]); 2] {
        let (middle, corner) = (0.5 * self.side as f32, 0.08 * self.side as f32);
        [
            ("ground", [middle, middle, 1.7], [1.0, 0.3, 0.06]),
            ("aerial", [corner, corner, 35.0], [1.0, 0.9, -0.22]),
        ]
    }

    /// Our scene of it.
    pub fn scene(&self) -> Result<Scene, weald_render::Error> {
        let mut instances = Instances::default();
        for (place, plant_id) in self.places.iter().zip(1..) {
            let half = 0.5 * place.yaw;
            instances.push(Instance {
                group: 0,
                prototype: 1,
                plant_id,
                position: [place.x, place.y, 0.0],
                rotation: [0.0, 0.0, half.sin() as f32, half.cos() as f32],
                scale: place.scale as f32,
            });
        }
        let representative = Representative {
            id: 1,
            species: "tree".into(),
            age: 20.0,
            vigor: 1.0,
            height: 16.0,
            radius: 3.2,
            weight: 1.0,
            count: 1,
        };
        let palette = Palette { representatives: vec![representative], groups: Vec::new() };
        let parts = Parts {
            terrain: &self.terrain,
            palette: &palette,
            instances: &instances,
            prototypes: &Model(self.tree.clone()),
            objects: &[],
            species: &["tree".to_string()],
            sky_pictures: SkyPictures::default(),
        };
        Scene::build(&parts, &Sky::clear_day(), &Silent)
    }

    /// Rows of a placement's matrix, three by four.
    pub fn matrix(place: &Place) -> [f32; 12] {
        let (sin, cos) = (place.yaw.sin() * place.scale, place.yaw.cos() * place.scale);
        let rows = [cos, -sin, 0.0, place.x, sin, cos, 0.0, place.y, 0.0, 0.0, place.scale, 0.0];
        rows.map(|value| value as f32)
    }

    /// Writes `tree.bin` (counts of vertices and triangles, then positions and indices) and
    /// `places-N.bin` (a matrix a tree), all little-endian of 32 bits.
    pub fn write(&self, folder: &Path) -> Result<(), Box<dyn Error>> {
        std::fs::create_dir_all(folder)?;
        let (positions, triangles) = self.soup();
        let mut file = std::io::BufWriter::new(std::fs::File::create(folder.join("tree.bin"))?);
        file.write_all(&(positions.len() as u32).to_le_bytes())?;
        file.write_all(&(triangles.len() as u32).to_le_bytes())?;
        for value in positions.iter().flatten() {
            file.write_all(&value.to_le_bytes())?;
        }
        for value in triangles.iter().flatten() {
            file.write_all(&value.to_le_bytes())?;
        }
        let name = format!("places-{}.bin", self.places.len());
        let mut file = std::io::BufWriter::new(std::fs::File::create(folder.join(name))?);
        for value in self.places.iter().flat_map(Self::matrix) {
            file.write_all(&value.to_le_bytes())?;
        }
        Ok(())
    }

    /// All vertices and triangles of the tree.
    pub fn soup(&self) -> (Vec<[f32; 3]>, Vec<[u32; 3]>) {
        let (mut positions, mut triangles) = (Vec::new(), Vec::new());
        for mesh in &self.tree.wood {
            let base = positions.len() as u32;
            positions.extend(&mesh.positions);
            triangles.extend(mesh.triangles.iter().map(|three| three.map(|i| base + i)));
        }
        (positions, triangles)
    }
}

/// A table of the scene's language.
pub fn read<T: weald_contract::FromToml>(text: &str) -> Result<T, Box<dyn Error>> {
    let mut problems = Vec::new();
    let value = weald_contract::Value::parse(0, text).map_err(|p| p[0].clone())?;
    T::from_toml(&value, &mut problems).ok_or_else(|| problems[0].clone().into())
}
