//! Writes one small file of every kind into a folder, for other programs to open.
//!
//! `cargo run --release -p weald-formats --example sample_folder -- FOLDER [DEM.tif]`, then
//! `benches/peers/open_with_others.py FOLDER`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::instances::Instance;
use weald_contract::{
    Crs, Frame, Grid, Group, Instances, Layers, Material, Mesh, Organ, Palette, Picture, Placement,
    Plant, PlantModel, Population, Raster, Representative, Seed, State, Surface,
};
use weald_formats::{Column, Error, Parent, Provenance, Table};

fn main() -> Result<(), Error> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let folder = arguments.next().unwrap_or_else(|| PathBuf::from("sample"));
    let ground = match arguments.next() {
        Some(path) => weald_formats::read_raster(&path)?,
        None => hills(),
    };
    std::fs::create_dir_all(&folder).map_err(Error::io("create", &folder))?;
    write_all(&folder, &ground)
}

fn write_all(folder: &Path, ground: &Raster) -> Result<(), Error> {
    let story = story();
    let plants = plants(ground);
    weald_formats::write_terrain(&folder.join("terrain"), &terrain(ground), &story)?;
    weald_formats::write_population(&folder.join("population.parquet"), &plants, &story)?;
    weald_formats::write_population(&folder.join("population.csv"), &plants, &story)?;
    weald_formats::write_palette(&folder.join("palette.toml"), &palette(), &story)?;
    let placed = instances(&plants);
    weald_formats::write_instances(&folder.join("instances.parquet"), &placed, &story)?;
    let summary = Table::default()
        .with("year", Column::Integer(vec![0, 1]))
        .with("species", Column::text(["aspen", "willow"]))
        .with("mean_height", Column::Float32(vec![0.5, 1.25]));
    weald_formats::write_table(&folder.join("summary.csv"), &summary, &story)?;
    let prototypes = folder.join("prototypes");
    std::fs::create_dir_all(&prototypes).map_err(Error::io("create", &prototypes))?;
    weald_formats::write_plant(&prototypes.join("aspen-1.glb"), &sapling(), &story)?;
    let flat = weald_formats::flatten(&sapling());
    weald_formats::write_plant(&prototypes.join("aspen-1-flat.glb"), &flat, &story)?;
    weald_formats::write_picture(&folder.join("image.exr"), &picture(), &story)?;
    let rgb: Vec<u8> = (0..64 * 48 * 3).map(|i| (i % 251) as u8).collect();
    weald_formats::write_png(&folder.join("image.png"), 64, 48, &rgb, &story)?;
    weald_formats::write_gray_png(&folder.join("density.png"), 64, 48, &[40_000; 64 * 48], &story)
}

/// Ground of our own, where no elevation model is given.
fn hills() -> Raster {
    let frame = Frame { width: 300, height: 260, cell: 1.0, west: 481_000.0, south: 5_250_000.0 };
    let grid =
        Grid::from_fn(frame, |x, y| ((x / 40.0).sin() * 5.0 + (y / 60.0).cos() * 3.0) as f32);
    Raster { grid, crs: Crs { epsg: Some(26915), ..Crs::default() } }
}

fn terrain(ground: &Raster) -> Layers {
    let frame = ground.grid.frame;
    let mut terrain =
        Layers { frame, crs: ground.crs.clone(), layers: BTreeMap::new(), detail: Vec::new() };
    terrain.insert("altitude", "m", "Height of the ground.", ground.grid.values.clone());
    terrain.insert("water_depth", "m", "Depth of standing water.", vec![0.25; frame.len()]);
    let patch = Frame { width: 40, height: 40, cell: frame.cell / 4.0, ..frame };
    let values = Grid::from_fn(patch, |x, y| ground.grid.sample(x, y)).values;
    let mut detail = Layers {
        frame: patch,
        crs: ground.crs.clone(),
        layers: BTreeMap::new(),
        detail: Vec::new(),
    };
    detail.insert("altitude", "m", "Height of the ground.", values);
    terrain.detail.push(detail);
    terrain
}

fn plants(ground: &Raster) -> Population {
    let frame = ground.grid.frame;
    let mut stream = Seed(7).stream("sample", 0);
    let mut plant = |id: u64| {
        let x = frame.west + stream.unit() * (frame.east() - frame.west);
        let y = frame.south + stream.unit() * (frame.north() - frame.south);
        let mut up_to = |limit: f64| stream.range(0.0, limit) as f32;
        Plant {
            id,
            species: (id % 2) as u16,
            state: State::from_u8((id % 3) as u8).unwrap_or_default(),
            x,
            y,
            z: ground.grid.sample(x, y),
            radius: up_to(4.0),
            height: up_to(20.0),
            age: up_to(100.0),
            vigor: up_to(1.0),
            yaw: up_to(6.0),
            lean: up_to(0.2),
            lean_azimuth: up_to(6.0),
        }
    };
    Population {
        plants: (0..1000).map(&mut plant).collect(),
        species: ["quaking aspen", "willow"].map(String::from).into(),
        extra: BTreeMap::from([("dbh".into(), vec![0.2; 1000])]),
        crs: ground.crs.clone(),
    }
}

fn palette() -> Palette {
    let plant = Representative {
        id: 1,
        species: "quaking aspen".into(),
        age: 30.0,
        vigor: 0.8,
        height: 9.5,
        radius: 2.25,
        weight: 812.5,
        count: 1000,
    };
    let group = Group { id: 2, species: "turf".into(), age: 2.0, vigor: 0.7, count: 4 };
    Palette { representatives: vec![plant], groups: vec![group] }
}

fn instances(population: &Population) -> Instances {
    let mut instances = Instances { crs: population.crs.clone(), ..Instances::default() };
    for plant in &population.plants {
        instances.push(Instance {
            group: 0,
            prototype: 1,
            plant_id: plant.id,
            position: [plant.x, plant.y, f64::from(plant.z)],
            rotation: [0.0, 0.0, 0.6, 0.8],
            scale: plant.height / 9.5,
        });
    }
    instances
}

fn sapling() -> PlantModel {
    let trunk = Mesh {
        positions: vec![[-0.1, 0.0, 0.0], [0.1, 0.0, 0.0], [0.0, 0.0, 2.0]],
        normals: vec![[0.0, -1.0, 0.0]; 3],
        uvs: vec![[0.0, 0.0], [0.2, 0.0], [0.1, 2.0]],
        triangles: vec![[0, 1, 2]],
        ..Mesh::default()
    };
    let blade = Mesh {
        positions: vec![[0.0, 0.0, 0.0], [0.03, 0.08, 0.0], [-0.03, 0.08, 0.0]],
        normals: vec![[0.0, 0.0, 1.0]; 3],
        uvs: Vec::new(),
        triangles: vec![[0, 1, 2]],
        material: 1,
        ..Mesh::default()
    };
    let place = |i: u8| Placement {
        position: [0.0, 0.0, 1.0 + f32::from(i) * 0.01],
        rotation: [0.0, 0.0, 0.6, 0.8],
        scale: [1.0, 1.0, 1.0],
    };
    let leaf = Surface::Leaf { transmittance: [0.1, 0.3, 0.05] };
    let material = |name: &str, reflectance, surface| Material {
        name: name.into(),
        reflectance,
        roughness: 0.8,
        surface,
        ..Material::default()
    };
    PlantModel {
        name: "aspen-1".into(),
        materials: vec![
            material("bark", [0.3, 0.28, 0.25], Surface::Opaque),
            material("leaf", [0.1, 0.25, 0.05], leaf),
        ],
        wood: vec![trunk],
        organs: vec![Organ {
            name: "leaf".into(),
            meshes: vec![blade],
            placements: (0..100).map(place).collect(),
            ..Organ::default()
        }],
        ..PlantModel::default()
    }
}

fn picture() -> Picture {
    let (width, height) = (64usize, 48usize);
    let ramp = |scale: f32| (0..width * height).map(|i| i as f32 * scale).collect::<Vec<f32>>();
    let mut picture = Picture::new(width, height);
    for name in ["R", "G", "B", "A", "albedo.R", "normal.X"] {
        picture.add(name, false, vec![0.5; width * height]);
    }
    for name in ["Z", "position.X", "species"] {
        picture.add(name, true, ramp(0.1));
    }
    picture
}

fn story() -> Provenance {
    Provenance {
        stage: "sample".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        output_version: 1,
        parameters: serde_json::json!({ "note": "<&> \"ä\"" }),
        seed: 7,
        inputs: vec![Parent { name: "ground".into(), blake3: String::new(), provenance: None }],
    }
}
