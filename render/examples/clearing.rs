//! A pond in a clearing, made in code: terrain, plants and groups of grass from a few lines each,
//! put together as [`weald_render::Parts`] and rendered to a PPM file.
//!
//! `cargo run --release -p weald-render --example clearing -- clearing.ppm [samples] [width]`

use std::collections::BTreeMap;
use std::error::Error;
use std::f64::consts::TAU;
use std::io::Write;
use std::sync::Arc;
use weald_contract::instances::Instance;
use weald_contract::{
    Crs, Frame, FromToml, Group, Instances, Layers, Material, Mesh, Organ, Palette, Placement,
    PlantModel, Problem, Representative, Seed, Silent, Surface, Value, View,
};
use weald_render::{Config, Parts, PrototypeSource, Scene, Sky, SkyPictures, render, tone_map};

/// Terrain of 160 m with a hollow and water in it; finer ground around the view.
fn terrain() -> Layers {
    let height = |x: f64, y: f64| {
        let (dx, dy) = (x - 80.0, y - 92.0);
        let hollow = -4.0 * (-(dx * dx + dy * dy * 1.6) / 700.0).exp();
        hollow + 0.25 * (x * 0.21).sin() * (y * 0.17).cos() + 0.03 * (x * 1.9 + y * 2.3).sin() + 4.5
    };
    let sheet = |frame: Frame| {
        let at: Vec<(f64, f64)> =
            (0..frame.len()).map(|i| frame.center(i % frame.width, i / frame.width)).collect();
        let altitude: Vec<f32> = at.iter().map(|&(x, y)| height(x, y) as f32).collect();
        let depth: Vec<f32> = altitude.iter().map(|h| (2.2 - h).max(0.0)).collect();
        let moisture = altitude.iter().map(|h| (1.05 - 0.3 * (h - 2.2)).clamp(0.0, 1.0)).collect();
        let (crs, layers) = (Crs::default(), BTreeMap::new());
        let mut sheet = Layers { frame, crs, layers, detail: Vec::new() };
        sheet.insert("altitude", "m", "Height.", altitude);
        sheet.insert("water_depth", "m", "Water above ground.", depth);
        sheet.insert("soil_moisture", "1", "Wetness.", moisture);
        sheet
    };
    let mut whole = sheet(Frame { width: 160, height: 160, cell: 1.0, west: 0.0, south: 0.0 });
    whole.detail =
        vec![sheet(Frame { width: 240, height: 240, cell: 0.25, west: 50.0, south: 40.0 })];
    whole
}

fn material(name: &str, rgb: [f32; 3], through: Option<[f32; 3]>, roughness: f32) -> Material {
    let surface = through.map_or(Surface::Opaque, |transmittance| Surface::Leaf { transmittance });
    Material { name: name.into(), reflectance: rgb, roughness, surface, ..Material::default() }
}

/// A trunk with a cloud of leaves on twigs.
fn tree(seed: Seed, height: f32, radius: f32) -> PlantModel {
    let mut chance = seed.stream("tree", 0);
    let mut wood = Mesh { material: 0, ..Mesh::default() };
    let mut stick = |from: [f32; 3], to: [f32; 3], thick: f32, thin: f32| {
        let base = wood.positions.len() as u32;
        for side in 0..7 {
            let (sin, cos) = (side as f32 / 7.0 * std::f32::consts::TAU).sin_cos();
            wood.positions.push([from[0] + thick * cos, from[1] + thick * sin, from[2]]);
            wood.positions.push([to[0] + thin * cos, to[1] + thin * sin, to[2]]);
            wood.normals.extend([[cos, sin, 0.0]; 2]);
        }
        for side in 0..7 {
            let (a, b) = (base + 2 * side, base + 2 * ((side + 1) % 7));
            wood.triangles.extend([[a, b, b + 1], [a, b + 1, a + 1]]);
        }
    };
    stick([0.0; 3], [0.1, 0.05, height * 0.95], height * 0.011, height * 0.002);
    let mut placements = Vec::new();
    for branch in 0..70 {
        let part = 0.3 + 0.68 * branch as f32 / 70.0;
        let turn = branch as f32 * 2.4 + chance.around(0.0, 0.3) as f32;
        let reach = radius * (1.0 - ((part - 0.55) / 0.5).powi(2)).max(0.08);
        let foot = [0.1 * part, 0.05 * part, height * part];
        let tip = [
            foot[0] + reach * turn.cos(),
            foot[1] + reach * turn.sin(),
            foot[2] + 0.5 * reach + chance.around(0.0, 0.2) as f32,
        ];
        stick(foot, tip, 0.02, 0.004);
        for _ in 0..220 {
            let along = chance.unit().powf(0.6) as f32;
            let spread = 0.32;
            let position = [0, 1, 2].map(|axis| {
                foot[axis] + along * (tip[axis] - foot[axis]) + (chance.normal() * spread) as f32
            });
            let axis = [chance.normal(), chance.normal(), chance.normal(), 1.2 * chance.normal()];
            let length = axis.iter().map(|c| c * c).sum::<f64>().sqrt();
            let rotation = axis.map(|c| (c / length) as f32);
            placements.push(Placement {
                position,
                rotation,
                scale: [chance.range(0.8, 1.25) as f32; 3],
            });
        }
    }
    let blade = Mesh {
        positions: [
            [0.0, 0.0, 0.0],
            [0.026, 0.025, 0.004],
            [0.0, 0.06, 0.0],
            [-0.026, 0.025, 0.004],
        ]
        .to_vec(),
        triangles: vec![[0, 1, 2], [0, 2, 3]],
        material: 1,
        ..Mesh::default()
    };
    PlantModel {
        name: "tree".into(),
        materials: vec![
            material("bark", [0.36, 0.34, 0.27], None, 1.0),
            material("leaf", [0.055, 0.105, 0.022], Some([0.06, 0.15, 0.015]), 0.5),
        ],
        wood: vec![wood],
        organs: vec![Organ {
            name: "leaf".into(),
            meshes: vec![blade],
            placements,
            ..Organ::default()
        }],
        ..PlantModel::default()
    }
}

/// A bunch of bent blades.
fn tuft(seed: Seed, height: f32, blades: usize, rgb: [f32; 3], through: [f32; 3]) -> PlantModel {
    let mut chance = seed.stream("tuft", 0);
    let mut mesh = Mesh { material: 0, ..Mesh::default() };
    for _ in 0..blades {
        let (sin, cos) = chance.range(0.0, TAU).sin_cos();
        let (foot, lean) = (chance.range(0.0, 0.05), chance.range(0.05, 0.6));
        let length = f64::from(height) * chance.range(0.5, 1.0);
        let base = mesh.positions.len() as u32;
        for step in 0..4 {
            let part = f64::from(step) / 3.0;
            let out = foot + lean * length * part * part;
            let half = 0.003 * (1.0 - part) + 0.0003;
            let z = length * part * (1.0 - 0.3 * lean * part);
            for side in [-half, half] {
                let (x, y) = (cos * out - sin * side, sin * out + cos * side);
                mesh.positions.push([x as f32, y as f32, z as f32]);
            }
        }
        for step in 0..3 {
            let a = base + 2 * step;
            mesh.triangles.extend([[a, a + 1, a + 3], [a, a + 3, a + 2]]);
        }
    }
    PlantModel {
        name: "tuft".into(),
        materials: vec![material("blade", rgb, Some(through), 0.6)],
        wood: vec![mesh],
        ..PlantModel::default()
    }
}

struct Models(BTreeMap<u32, Arc<PlantModel>>);

impl PrototypeSource for Models {
    fn model(&self, prototype: u32) -> Result<Arc<PlantModel>, Problem> {
        self.0.get(&prototype).cloned().ok_or_else(|| Problem::new("no such plant"))
    }
}

fn representative(id: u32, species: &str, height: f32, radius: f32) -> Representative {
    let species = species.to_string();
    Representative { id, species, age: 10.0, vigor: 1.0, height, radius, weight: 1.0, count: 1 }
}

/// Models and palette: trees 1 to 4, tufts 5 and 6, reeds 7, patches 10 to 13.
fn plants(seed: Seed) -> (Models, Palette) {
    let mut models = BTreeMap::new();
    let mut palette = Palette::default();
    for id in 1..=4 {
        let (height, radius) = (6.0 + 2.0 * id as f32, 1.3 + 0.3 * id as f32);
        models.insert(id, Arc::new(tree(seed.part("tree", id.into()), height, radius)));
        palette.representatives.push(representative(id, "tree", height, radius));
    }
    for (id, height, blades, rgb, through) in [
        (5, 0.35, 60, [0.085, 0.125, 0.035], [0.06, 0.11, 0.02]),
        (6, 0.5, 40, [0.16, 0.15, 0.06], [0.09, 0.09, 0.03]),
        (7, 1.7, 14, [0.07, 0.12, 0.035], [0.05, 0.09, 0.02]),
    ] {
        models
            .insert(id, Arc::new(tuft(seed.part("tuft", id.into()), height, blades, rgb, through)));
        palette.representatives.push(representative(id, "grass", height, 0.1));
    }
    for id in 10..14 {
        let species = "meadow".to_string();
        palette.groups.push(Group { id, species, age: 1.0, vigor: 1.0, count: 1 });
    }
    (Models(models), palette)
}

/// Trees round the clearing, reeds along the water, patches of grass on dry ground.
fn instances(terrain: &Layers, seed: Seed) -> Instances {
    let mut table = Instances::default();
    let mut chance = seed.stream("places", 0);
    let turned = |yaw: f64| [0.0, 0.0, (yaw / 2.0).sin() as f32, (yaw / 2.0).cos() as f32];
    for group in 10..14 {
        for plant_id in 0..16 {
            let position = [chance.unit() - 0.5, chance.unit() - 0.5, -0.01];
            let rotation = turned(chance.range(0.0, TAU));
            let scale = chance.range(0.6, 1.3) as f32;
            let prototype = if chance.unit() < 0.7 { 5 } else { 6 };
            table.push(Instance { group, prototype, plant_id, position, rotation, scale });
        }
    }
    let mut plant_id = 0;
    let mut plant = |prototype: u32, x: f64, y: f64, rotation: [f32; 4], scale: f64| {
        plant_id += 1;
        let z = f64::from(terrain.sample("altitude", x, y).unwrap_or(0.0));
        let scale = scale as f32;
        table.push(Instance {
            group: 0,
            prototype,
            plant_id,
            position: [x, y, z],
            rotation,
            scale,
        });
    };
    for i in 0..160 * 160 {
        let (x, y) = (f64::from(i % 160) + 0.5, f64::from(i / 160) + 0.5);
        let depth = terrain.sample("water_depth", x, y).unwrap_or(0.0);
        let quarter = chance.below(4) as f64 * std::f64::consts::FRAC_PI_2;
        if depth <= 0.0 {
            plant(10 + chance.below(4) as u32, x, y, turned(quarter), 1.0);
        }
        let shore = f64::from(terrain.sample("altitude", x, y).unwrap_or(0.0)) - 2.2;
        if (-0.35..0.12).contains(&shore) && chance.unit() < 0.75 {
            for _ in 0..5 {
                let (dx, dy) = (chance.around(0.0, 0.5), chance.around(0.0, 0.5));
                plant(7, x + dx, y + dy, turned(chance.range(0.0, TAU)), chance.range(0.6, 1.1));
            }
        }
        let from_middle = ((x - 80.0).powi(2) + (y - 84.0).powi(2)).sqrt();
        let wood = if from_middle > 30.0 { 0.09 } else { 0.004 };
        let is_view = (x - 80.0).abs() < 12.0 && y < 75.0;
        if depth <= 0.0 && !is_view && chance.unit() < wood {
            let turn = turned(chance.range(0.0, TAU));
            plant(1 + chance.below(4) as u32, x, y, turn, chance.range(0.7, 1.15));
        }
    }
    table
}

fn read<T: FromToml>(text: &str) -> Result<T, Box<dyn Error>> {
    let mut problems = Vec::new();
    let value = Value::parse(0, text).map_err(|p| p[0].clone())?;
    T::from_toml(&value, &mut problems).ok_or_else(|| problems[0].clone().into())
}

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let path = arguments.next().unwrap_or("clearing.ppm".into());
    let samples: u32 = arguments.next().map_or(Ok(8), |text| text.parse())?;
    let width: u32 = arguments.next().map_or(Ok(480), |text| text.parse())?;
    let height = width * 9 / 16;

    let seed = Seed(7);
    let terrain = terrain();
    let (prototypes, palette) = plants(seed);
    let instances = instances(&terrain, seed);
    let species = ["grass".to_string(), "meadow".into(), "tree".into()];
    let parts = Parts {
        terrain: &terrain,
        palette: &palette,
        instances: &instances,
        prototypes: &prototypes,
        objects: &[],
        species: &species,
        sky_pictures: SkyPictures::default(),
    };
    let start = std::time::Instant::now();
    let scene = Scene::build(&parts, &Sky::clear_day(), &Silent)?;
    println!("built in {:.1?}: {:?}", start.elapsed(), scene.statistics());

    let view: View = read(
        "name = \"bank\"\nstand_at = [80, 64]\nlook_at = [80, 92]\nlook_height = 1.2\nfov_deg = 60",
    )?;
    let config: Config =
        read(&format!("view = \"bank\"\nresolution = [{width}, {height}]\nsamples = {samples}"))?;
    let start = std::time::Instant::now();
    let film = render(&scene, &view, &config, seed, &Silent)?;
    println!("rendered in {:.1?}: {:?}", start.elapsed(), film.statistics());

    let mut file = std::fs::File::create(&path)?;
    write!(file, "P6\n{width} {height}\n255\n")?;
    file.write_all(&tone_map(&film.picture(), config.exposure))?;
    Ok(())
}
