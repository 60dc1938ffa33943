//! Render: a scene built, and rays followed through it.

use super::ecosim::plain;
use super::plants::grown;
use super::{Figure, Size, best, table, wrong};
use crate::error::Result;
use crate::scene::SceneSpecies;
use std::collections::BTreeMap;
use std::sync::Arc;
use weald_contract::{
    Instances, Palette, PlantModel, Problem, Representative, Seed, Silent, View, instances,
};
use weald_render::PrototypeSource;

/// A wood on a meadow: trees every 4 m or so, tufts of grass every half metre.
pub(super) fn rays(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Vec<Figure>> {
    /// Square metres to a tree.
    const ROOM: f64 = 16.0;
    /// Tufts of grass to a tree.
    const TUFTS: u64 = 64;
    let side = (f64::from(size.standing) * ROOM).sqrt().max(8.0);
    let terrain = plain(side as usize);
    let models = Held(vec![
        Arc::new(grown(species, "aspen", 25.0, 1)?),
        Arc::new(grown(species, "grass", 3.0, 2)?),
    ]);
    let palette =
        Palette { representatives: vec![row(1, "aspen"), row(2, "grass")], groups: Vec::new() };
    let mut placed = Instances::default();
    scatter(&mut placed, 1, u64::from(size.standing), side);
    scatter(&mut placed, 2, u64::from(size.standing) * TUFTS, side);
    let sky: weald_render::Sky = table("")?;
    let parts = weald_render::Parts {
        terrain: &terrain,
        palette: &palette,
        instances: &placed,
        prototypes: &models,
        objects: &[],
        species: &["aspen".to_string(), "grass".to_string()],
        sky_pictures: weald_render::SkyPictures::default(),
    };
    let (built, scene) =
        best(size, || weald_render::Scene::build(&parts, &sky, &Silent).map_err(wrong))?;
    let middle = side / 2.0;
    let view = format!("name = \"in\"\nstand_at = [{middle}, 2]\nlook_at = [{middle}, 40]\n");
    let view: View = table(&view)?;
    let [width, height] = size.picture;
    let samples = size.samples;
    let config = format!("view = \"in\"\nresolution = [{width}, {height}]\nsamples = {samples}\n");
    let config: weald_render::Config = table(&config)?;
    let (time, film) = best(size, || {
        weald_render::render(&scene, &view, &config, Seed(1), &Silent).map_err(wrong)
    })?;
    let counted = film.statistics();
    let triangles = scene.statistics().instanced_primitives;
    let standing = format!("{} instances, {triangles} triangles", placed.len());
    let input = format!("{width} x {height}, {samples} samples, {standing}");
    Ok(vec![
        Figure::time("scene", built, standing),
        Figure::rate("rays", counted.rays as f64, "rays/s", time, input.clone()),
        Figure::rate("light paths", counted.samples as f64, "samples/s", time, input),
    ])
}

/// Models held in memory, by id from 1.
struct Held(Vec<Arc<PlantModel>>);

impl PrototypeSource for Held {
    fn model(&self, prototype: u32) -> Result<Arc<PlantModel>, Problem> {
        let index = (prototype as usize).wrapping_sub(1);
        self.0.get(index).cloned().ok_or_else(|| Problem::new(format!("no model {prototype}")))
    }
}

fn row(id: u32, species: &str) -> Representative {
    Representative {
        id,
        species: species.into(),
        age: 1.0,
        vigor: 1.0,
        height: 1.0,
        radius: 1.0,
        weight: 1.0,
        count: 1,
    }
}

/// Places `count` instances at random, turned at random.
fn scatter(placed: &mut Instances, prototype: u32, count: u64, side: f64) {
    for plant in 0..count {
        let mut chance = Seed(1).stream("scatter", u64::from(prototype) << 32 | plant);
        let (x, y) = (chance.range(0.0, side), chance.range(0.0, side));
        let half = chance.range(0.0, std::f64::consts::PI);
        placed.push(instances::Instance {
            group: 0,
            prototype,
            plant_id: plant,
            position: [x, y, 100.0],
            rotation: [0.0, 0.0, libm::sin(half) as f32, libm::cos(half) as f32],
            scale: 1.0,
        });
    }
}
