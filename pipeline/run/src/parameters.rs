//! Which part of a scene each stage reads, and nothing more.
//!
//! The value handed to a stage and the parameters in its key are made of the same pieces here, so
//! that a stage cannot read what its key does not hold: species come stripped of the tables of
//! other stages, and only those views are passed that the stage's own table names.

use crate::error::Result;
use crate::recipe::{HashedInput, Recipe, Stage};
use crate::scene::{Scene, SceneInput, SceneSpecies};
use serde::Serialize;
use serde_json::{Map, Value as Json, json};
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{GroupRecipe, Projection, Size, Species, View};

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

/// The places of the views that a stage's table names under a key `view`.
///
/// Stages before the picture care where someone stands, for finer ground there, and not where
/// they look or through which lens: those fields are blanked, so that turning the camera makes
/// nothing stale but the picture.
pub fn places_named(scene: &Scene, table: &impl Serialize) -> Vec<View> {
    let mut names = Vec::new();
    collect_names(&canonical(table), "view", &mut names);
    let named = scene.tables.view.iter().filter(|view| names.contains(&view.name));
    let place = |view: &View| View {
        name: view.name.clone(),
        stand_at: view.stand_at,
        eye_height: 0.0,
        look_at: view.stand_at,
        look_height: 0.0,
        fov_deg: 0.0,
        projection: Projection::Perspective,
    };
    named.map(place).collect()
}

/// The views that a stage's table names under a key `visible_from`, whole: what they see matters.
pub fn views_seen_from(scene: &Scene, table: &impl Serialize) -> Vec<View> {
    let mut names = Vec::new();
    collect_names(&canonical(table), "visible_from", &mut names);
    let views = scene.tables.view.iter();
    views.filter(|view| names.contains(&view.name)).cloned().collect()
}

/// A value as canonical JSON: single precision numbers with the decimals that people wrote,
/// where the direct way would widen 0.3 to 0.30000001192092896.
pub fn canonical(value: &impl Serialize) -> Json {
    let text = serde_json::to_string(value).expect("parameters hold only plain values");
    serde_json::from_str(&text).expect("what was just written is JSON")
}

/// Gathers the texts that stand under a key anywhere in a table.
fn collect_names(parameters: &Json, wanted: &str, names: &mut Vec<String>) {
    match parameters {
        Json::Object(map) => {
            for (key, value) in map {
                match value {
                    Json::String(name) if key == wanted => names.push(name.clone()),
                    _ => collect_names(value, wanted, names),
                }
            }
        }
        Json::Array(items) => items.iter().for_each(|item| collect_names(item, wanted, names)),
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
    let strip = |(name, found): (&String, &SceneSpecies)| (name.clone(), stripped(&found.species));
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
        look: None,
        published: None,
        group: species.group.clone(),
    }
}

/// The canonical parameters of a stage: what stands in its key and in its files' provenance.
pub fn parameters(scene: &Scene, stage: Stage, is_draft: bool) -> Json {
    match stage {
        Stage::Terrain => with_places(scene, "terrain", &scene.terrain),
        Stage::Ecosim => {
            let mut parameters = with_places(scene, "ecosim", &scene.ecosim);
            let species = ecosim_species(scene).into_iter().map(|(name, (species, ecology))| {
                let ecology = species.ecology.is_some().then_some(ecology);
                let read = Read { size: &species.size, group: &species.group, ecology };
                (name, canonical(&read))
            });
            parameters["species"] = species.collect::<Map<_, _>>().into();
            let views = views_seen_from(scene, &scene.ecosim);
            if !views.is_empty() {
                parameters["views"] = canonical(&views);
            }
            parameters
        }
        Stage::Quantize => {
            let species = quantize_species(scene).into_iter().map(|(name, species)| {
                let read = Read { size: &species.size, group: &species.group, ecology: None };
                (name, canonical(&read))
            });
            let species = species.collect::<Map<_, _>>();
            let mut parameters =
                json!({ "quantize": canonical(&scene.quantize), "species": species });
            if scene.quantize.memory_gb.is_some() {
                parameters["plants"] = canonical(&scene.plants);
                parameters["forms"] = forms(&scene.species);
            }
            if scene.quantize.lacks_eye() {
                parameters["view"] = canonical(&scene.wanted_view().ok());
            }
            parameters
        }
        Stage::Plants => {
            json!({ "plants": canonical(&scene.plants), "species": forms(&scene.species) })
        }
        Stage::Render => {
            let mut parameters = json!({
                "render": canonical(&render_config(scene, is_draft)),
                "view": canonical(&scene.wanted_view().ok()),
                "sky": canonical(&scene.sky),
                "object": canonical(&scene.tables.object),
            });
            if !scene.plants.levels.is_empty() {
                parameters["levels"] = canonical(&scene.plants.levels);
            }
            parameters
        }
    }
}

/// What ecosim and quantize read of a species.
#[derive(Serialize)]
struct Read<'a> {
    size: &'a Size,
    group: &'a Option<GroupRecipe>,
    #[serde(skip_serializing_if = "Option::is_none")]
    ecology: Option<weald_ecosim::Ecology>,
}

/// What plants reads of each species that it can grow.
pub fn forms(species: &BTreeMap<String, SceneSpecies>) -> Json {
    let form = |(name, found): (&String, &SceneSpecies)| {
        let form = found.form.as_ref()?;
        let mut read = json!({ "size": canonical(&found.species.size), "form": canonical(form) });
        if found.species.look.is_some() {
            read["look"] = canonical(&found.look);
        }
        if let weald_plants::Form::Model(form) = form {
            // A model that cannot be read is told of when it is needed.
            let hash = weald_formats::hash_file(&crate::make::model_file(found, form)).ok();
            read["model"] = json!(hash);
        }
        Some((name.clone(), read))
    };
    species.iter().filter_map(form).collect::<Map<_, _>>().into()
}

/// A stage's table, with the places of the views that it names.
fn with_places(scene: &Scene, name: &str, table: &impl Serialize) -> Json {
    let places: Map<_, _> = places_named(scene, table)
        .into_iter()
        .map(|view| (view.name, json!(view.stand_at)))
        .collect();
    let mut parameters = json!({ name: canonical(table) });
    if !places.is_empty() {
        parameters["places"] = places.into();
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

/// BLAKE3 of every file that a stage's table names, each once, and of the files beside them that
/// are read with them.
///
/// # Errors
/// An input cannot be read.
pub fn hashed_inputs(scene: &Scene, stage: Stage) -> Result<Vec<HashedInput>> {
    let mut hashed: Vec<HashedInput> = Vec::new();
    for SceneInput { input, path } in inputs(scene, stage) {
        if hashed.iter().any(|known| known.name == input.path.value) {
            continue;
        }
        let name = input.path.value.clone();
        hashed.push(HashedInput { name, blake3: weald_formats::hash_file(path)? });
        if let Some(beside) = weald_formats::companion(path) {
            let name =
                Path::new(&input.path.value).with_file_name(beside.file_name().unwrap_or_default());
            let blake3 = weald_formats::hash_file(&beside)?;
            hashed.push(HashedInput { name: name.display().to_string(), blake3 });
        }
    }
    Ok(hashed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn single_precision_numbers_keep_the_decimals_that_people_wrote() {
        let text = canonical(&(0.3f32, 0.042f32, 381.5f64)).to_string();
        assert_eq!(text, "[0.3,0.042,381.5]");
    }
}
