//! A plant's portrait by the path tracer: on bare ground, under sun and sky.

use crate::error::{Error, Result};
use crate::preview::Sketch;
use glam::{Quat, Vec3};
use std::collections::BTreeMap;
use std::sync::Arc;
use weald_contract::{
    Crs, Frame, FromToml, Instances, Layers, Palette, PlantModel, Problem, Progress,
    Representative, Seed, Silent, Value, View, instances,
};
use weald_render::PrototypeSource;

/// Horizontal angle of view, degrees: that of a long lens, which distorts little.
const FOV_DEG: f64 = 24.0;

/// Room around the plant, part of the picture.
const ROOM: f64 = 1.08;

/// Draws a model, filling the picture.
///
/// # Errors
/// The renderer refuses the model, or the user stops it.
pub fn portrait(
    model: &PlantModel,
    side: u32,
    samples: u32,
    progress: &dyn Progress,
) -> Result<Sketch> {
    let (low, high) = bounds(model);
    let height = f64::from(high.z).max(1e-3);
    let width = f64::from(high.x - low.x).max(f64::from(high.y - low.y)).max(1e-3);
    let extent = height.max(width) * ROOM;
    let distance = 0.5 * extent / (0.5 * FOV_DEG.to_radians()).tan() + 0.3 * width;
    // The ground reaches well beyond what is seen, in few cells.
    let (cells, cell) = (32_usize, distance * 4.0 / 32.0);
    let middle = cells as f64 * cell / 2.0;
    let terrain = ground(cells, cell);
    let models = One(Arc::new(model.clone()));
    let palette = Palette { representatives: vec![row()], groups: Vec::new() };
    let mut placed = Instances::default();
    let offset = 0.5 * (low + high);
    placed.push(instances::Instance {
        group: 0,
        prototype: 1,
        plant_id: 1,
        position: [middle - f64::from(offset.x), middle - f64::from(offset.y), 0.0],
        rotation: [0.0, 0.0, 0.0, 1.0],
        scale: 1.0,
    });
    let parts = weald_render::Parts {
        terrain: &terrain,
        palette: &palette,
        instances: &placed,
        prototypes: &models,
        objects: &[],
        species: &["plant".to_string()],
        sky_pictures: weald_render::SkyPictures::default(),
    };
    let sky: weald_render::Sky = table("sun_azimuth_deg = 225\nsun_elevation_deg = 38")?;
    let scene = weald_render::Scene::build(&parts, &sky, &Silent).map_err(refused)?;
    let (eye, target) = (0.55 * height, 0.5 * height);
    let view: View = table(&format!(
        "name = \"portrait\"\nstand_at = [{middle}, {}]\neye_height = {}\nlook_at = [{middle}, {middle}]\n\
         look_height = {target}\nfov_deg = {FOV_DEG}\n",
        middle - distance,
        eye.max(0.011),
    ))?;
    let config: weald_render::Config = table(&format!(
        "view = \"portrait\"\nresolution = [{side}, {side}]\nsamples = {samples}\n"
    ))?;
    let film = weald_render::render(&scene, &view, &config, Seed(1), progress).map_err(refused)?;
    let picture = film.picture();
    let rgb = weald_render::tone_map(&picture, config.exposure);
    Ok(Sketch { width: picture.width, height: picture.height, rgb })
}

fn refused(error: weald_render::Error) -> Error {
    match error {
        weald_render::Error::Cancelled => Error::Stopped { saved: false },
        other => Error::Stage { stage: "plants", message: format!("portrait: {other}") },
    }
}

/// Box around a model, organs at their places, m.
fn bounds(model: &PlantModel) -> (Vec3, Vec3) {
    let mut corners = (Vec3::splat(f32::INFINITY), Vec3::splat(f32::NEG_INFINITY));
    let mut include = |point: Vec3| {
        corners.0 = corners.0.min(point);
        corners.1 = corners.1.max(point);
    };
    model.wood.iter().flat_map(|mesh| &mesh.positions).for_each(|p| include(Vec3::from(*p)));
    for organ in &model.organs {
        for place in &organ.placements {
            let (scale, position) = (Vec3::from(place.scale), Vec3::from(place.position));
            let rotation = Quat::from_array(place.rotation);
            let points = organ.meshes.iter().flat_map(|mesh| &mesh.positions);
            points.for_each(|p| include(rotation * (scale * Vec3::from(*p)) + position));
        }
    }
    let (low, high) = corners;
    if low.is_finite() && high.is_finite() { (low, high) } else { (Vec3::ZERO, Vec3::splat(1e-3)) }
}

/// Level ground.
fn ground(cells: usize, cell: f64) -> Layers {
    let frame = Frame { width: cells, height: cells, cell, west: 0.0, south: 0.0 };
    let mut layers =
        Layers { frame, crs: Crs::default(), layers: BTreeMap::new(), detail: Vec::new() };
    let all = [("altitude", "m", 0.0), ("slope", "degree", 0.0), ("water_depth", "m", 0.0)];
    for (name, unit, value) in all {
        layers.insert(name, unit, "the same everywhere", vec![value; frame.len()]);
    }
    layers
}

/// The only model.
struct One(Arc<PlantModel>);

impl PrototypeSource for One {
    fn model(&self, _: u32) -> Result<Arc<PlantModel>, Problem> {
        Ok(self.0.clone())
    }
}

fn row() -> Representative {
    Representative {
        id: 1,
        species: "plant".into(),
        age: 1.0,
        vigor: 1.0,
        height: 1.0,
        radius: 1.0,
        weight: 1.0,
        count: 1,
    }
}

/// Reads a table from a text of ours.
fn table<T: FromToml>(text: &str) -> Result<T> {
    let wrong = |message: String| Error::Stage { stage: "plants", message };
    let tree = Value::parse(0, text).map_err(|problems| wrong(format!("{problems:?}")))?;
    let mut problems = Vec::new();
    T::from_toml(&tree, &mut problems).ok_or_else(|| wrong(format!("{problems:?}")))
}
