//! Which part of a scene each stage reads, and nothing more.
//!
//! The value handed to a stage and the parameters in its key are made of the same pieces here, so
//! that a stage cannot read what its key does not hold: species come stripped of the tables of
//! other stages, and only those views are passed that the stage's own table names.

use crate::error::{Error, Result};
use crate::recipe::{HashedInput, Recipe, Stage};
use crate::scene::{Scene, SceneInput};
use serde_json::{Value as Json, json};
use std::collections::BTreeMap;
use weald_contract::{Species, View};

/// What rendering leaves as it is but a draft makes smaller.
pub const DRAFT_RESOLUTION: [u32; 2] = [480, 270];
/// Samples a pixel of a draft: enough to judge light and composition.
pub const DRAFT_SAMPLES: u32 = 8;

/// `[render]` as it is used: a draft is smaller and coarser, never larger or finer.
pub fn render_config(scene: &Scene, is_draft: bool) -> weald_render::Config {
    let mut config = scene.render.clone();
    if is_draft {
        let [width, height] = config.resolution;
        let shrink = f64::from(DRAFT_RESOLUTION[0]) / f64::from(width.max(1));
        if shrink < 1.0 {
            let height = (f64::from(height) * shrink).round().max(1.0);
            config.resolution = [DRAFT_RESOLUTION[0], height as u32];
        }
        config.samples = config.samples.min(DRAFT_SAMPLES);
    }
    config
}

/// The views that a stage's canonical parameters name under a key `view`.
pub fn views_named(scene: &Scene, parameters: &Json) -> Vec<View> {
    let mut names = Vec::new();
    collect_view_names(parameters, &mut names);
    scene.tables.view.iter().filter(|view| names.contains(&view.name)).cloned().collect()
}

fn collect_view_names(parameters: &Json, names: &mut Vec<String>) {
    match parameters {
        Json::Object(map) => {
            for (key, value) in map {
                match value {
                    Json::String(name) if key == "view" => names.push(name.clone()),
                    _ => collect_view_names(value, names),
                }
            }
        }
        Json::Array(items) => items.iter().for_each(|item| collect_view_names(item, names)),
        _ => {}
    }
}

/// Species as ecosim sees them: size, ecology and the patch they are, but not how they look.
///
/// Only those that are planted; what grows inside a patch is of no concern before quantize. A
/// species without `[ecology]` comes with the default one, and with the field left empty so that
/// ecosim can tell.
pub fn ecosim_species(scene: &Scene) -> BTreeMap<String, (Species, weald_ecosim::Ecology)> {
    let planted = scene.planted.iter().filter_map(|name| Some((name, scene.species.get(name)?)));
    let known = planted.map(|(name, found)| {
        let species =
            Species { ecology: found.species.ecology.clone(), ..stripped(&found.species) };
        (name.clone(), (species, found.ecology.clone().unwrap_or_default()))
    });
    known.collect()
}

/// Species as quantize sees them: size and the patch they are.
pub fn quantize_species(scene: &Scene) -> BTreeMap<String, Species> {
    let strip = |(name, found): (&String, &crate::scene::SceneSpecies)| {
        (name.clone(), stripped(&found.species))
    };
    scene.species.iter().map(strip).collect()
}

/// A species without names for people, colour of dots, and the tables of single stages.
fn stripped(species: &Species) -> Species {
    Species {
        title: String::new(),
        latin: String::new(),
        color: [0; 3],
        size: species.size.clone(),
        ecology: None,
        form: None,
        group: species.group.clone(),
    }
}

/// The canonical parameters of a stage: what stands in its key and in its files' provenance.
pub fn parameters(scene: &Scene, stage: Stage, is_draft: bool) -> Json {
    match stage {
        Stage::Terrain => with_views(scene, json!({ "terrain": scene.terrain })),
        Stage::Ecosim => {
            let species: BTreeMap<_, _> = ecosim_species(scene)
                .into_iter()
                .map(|(name, (species, ecology))| {
                    let ecology = species.ecology.is_some().then_some(ecology);
                    (
                        name,
                        json!({ "size": species.size, "group": species.group, "ecology": ecology }),
                    )
                })
                .collect();
            with_views(scene, json!({ "ecosim": scene.ecosim, "species": species }))
        }
        Stage::Quantize => {
            let species: BTreeMap<_, _> = quantize_species(scene)
                .into_iter()
                .map(|(name, species)| {
                    (name, json!({ "size": species.size, "group": species.group }))
                })
                .collect();
            json!({ "quantize": scene.quantize, "species": species })
        }
        Stage::Plants => {
            let species: BTreeMap<_, _> = scene
                .species
                .iter()
                .filter(|(_, found)| found.form.is_some())
                .map(|(name, found)| {
                    (name, json!({ "size": found.species.size, "form": found.form }))
                })
                .collect();
            json!({ "species": species })
        }
        Stage::Render => {
            let config = render_config(scene, is_draft);
            let view = scene.rendered_view();
            json!({ "render": config, "view": view, "sky": scene.sky, "object": scene.tables.object })
        }
    }
}

/// Adds the views that the parameters name.
fn with_views(scene: &Scene, mut parameters: Json) -> Json {
    let views = views_named(scene, &parameters);
    if !views.is_empty() {
        parameters["views"] = json!(views);
    }
    parameters
}

/// The files that a stage's table names.
pub fn inputs(scene: &Scene, stage: Stage) -> &[SceneInput] {
    match stage {
        Stage::Terrain => &scene.terrain_inputs,
        Stage::Ecosim => &scene.ecosim_inputs,
        Stage::Render => &scene.object_inputs,
        Stage::Quantize | Stage::Plants => &[],
    }
}

/// Recipes of all stages; hashes every input file.
///
/// # Errors
/// An input cannot be read.
pub fn recipes(scene: &Scene, is_draft: bool) -> Result<BTreeMap<Stage, Recipe>> {
    let mut recipes: BTreeMap<Stage, Recipe> = BTreeMap::new();
    for stage in Stage::ALL {
        let reads = stage.reads().iter().map(|read| (*read, recipes[read].key())).collect();
        let recipe = Recipe {
            stage,
            output_version: stage.output_version(),
            seed: scene.tables.seed,
            parameters: parameters(scene, stage, is_draft),
            inputs: hashed_inputs(scene, stage)?,
            reads,
        };
        recipes.insert(stage, recipe);
    }
    Ok(recipes)
}

/// BLAKE3 of every file that a stage's table names, each once.
///
/// # Errors
/// An input cannot be read.
pub fn hashed_inputs(scene: &Scene, stage: Stage) -> Result<Vec<HashedInput>> {
    let mut hashed: Vec<HashedInput> = Vec::new();
    for SceneInput { input, path } in inputs(scene, stage) {
        if hashed.iter().any(|known| known.name == input.path.value) {
            continue;
        }
        let blake3 = weald_formats::hash_file(path).map_err(Error::File)?;
        hashed.push(HashedInput { name: input.path.value.clone(), blake3 });
    }
    Ok(hashed)
}
