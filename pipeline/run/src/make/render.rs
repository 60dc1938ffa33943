//! Render: everything to a picture.

use super::{
    Made, Pixels, at_field, file_name, level, make_folder_of, parent, plant_file, stage_error,
    stage_seed, whole_terrain,
};
use crate::check::bytes_in_words;
use crate::denoise::Denoiser;
use crate::error::{Error, Result};
use crate::parameters::render_config;
use crate::preview::Sketch;
use crate::prototypes::HeldPrototypes;
use crate::recipe::Stage;
use crate::scene::{Scene, SceneInput};
use serde_json::{Value as Json, json};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use weald_contract::{Image, InputKind, Layers, Palette, Picture, Problem, Progress, View};
use weald_formats::{Parent, Provenance};

/// What render reads and writes.
#[derive(Clone, Debug)]
pub struct RenderPaths {
    /// The terrain's folder.
    pub terrain: PathBuf,
    /// The palette.
    pub palette: PathBuf,
    /// The instances.
    pub instances: PathBuf,
    /// Folder of the models.
    pub plants: PathBuf,
    /// The picture to write, `.exr`; a `.png` goes beside it.
    pub image: PathBuf,
}

/// Render: everything to a picture.
///
/// # Errors
/// A file is damaged, the stage refuses, or the disk does.
pub fn render(
    scene: &Scene,
    paths: &RenderPaths,
    is_draft: bool,
    mut provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let stage = Stage::Render;
    // Before the work, so that none is lost when it is not there.
    let denoiser = scene.render.denoise.then(Denoiser::load).transpose()?;
    let assembled = assemble(scene, paths, is_draft, progress)?;
    let Assembled { built, view, config, counts, inputs } = assembled;
    provenance.inputs.extend(inputs);
    let film = weald_render::render(&built, view, &config, stage_seed(scene, stage), progress)
        .map_err(stage_error!(&scene.sources, stage, weald_render))?;

    let mut made = Made::default();
    make_folder_of(&paths.image)?;
    let mut picture = film.picture();
    if let Some(denoiser) = denoiser {
        denoiser.denoise(&mut picture)?;
    }
    weald_formats::write_picture(&paths.image, &picture, &provenance)?;
    made.wrote(&paths.image)?;
    let rgb = weald_render::tone_map(&picture, config.exposure);
    let sketch = Sketch { width: picture.width, height: picture.height, rgb };
    made.preview(&paths.image.with_extension("png"), &sketch, &provenance)?;
    made.report = json!({ "scene": statistics(built.statistics()), "film": film.statistics() });
    if !scene.plants.levels.is_empty() {
        made.report["levels"] = json!(counts);
    }
    Ok(made)
}

/// A scene put together from the files of a run, to be rendered or written for others to render.
pub(crate) struct Assembled<'a> {
    /// The scene.
    pub built: weald_render::Scene,
    /// The view that `[render]` names.
    pub view: &'a View,
    /// `[render]`, or what a draft makes of it.
    pub config: weald_render::Config,
    /// Placements at each level of detail.
    counts: Vec<u64>,
    /// The files that it was made from.
    pub inputs: Vec<Parent>,
}

/// Opens the files of a run and puts them together.
///
/// # Errors
/// A file is damaged, the stage refuses, or the caller asked to stop.
pub(crate) fn assemble<'a>(
    scene: &'a Scene,
    paths: &RenderPaths,
    is_draft: bool,
    progress: &dyn Progress,
) -> Result<Assembled<'a>> {
    let stage = Stage::Render;
    let error = || stage_error!(&scene.sources, stage, weald_render);
    let terrain = whole_terrain(&paths.terrain)?;
    let palette = weald_formats::read_palette(&paths.palette)?;
    let instances = weald_formats::read_instances(&paths.instances)?;
    weald_formats::check_instances(&palette, &instances).map_err(|problem| {
        let message = format!("{}: {}", paths.instances.display(), problem.message);
        Error::wrong(&scene.sources, Problem { message, ..problem })
    })?;
    let inputs = vec![
        parent(&paths.terrain)?,
        parent(&paths.palette)?,
        // The instances came with the palette: their story is told once.
        Parent { provenance: None, ..parent(&paths.instances)? },
        plants_parent(scene, &paths.plants, &palette)?,
    ];

    let view = scene.wanted_view()?;
    let config = render_config(scene, is_draft);
    let pixels = Pixels::new(view, &view.sight(&terrain), config.resolution[0]);
    let levels = &scene.plants.levels;
    let leveled = level(&palette, &instances, levels, |name| !has_levels(scene, name), &pixels);
    let counts = leveled.counts(levels.len());
    let prototypes = HeldPrototypes::read(&paths.plants, &leveled)?;
    let (palette, instances) = (leveled.palette, leveled.instances);
    let objects = objects(scene, &terrain)?;
    let (sky_image, clouds) = sky_pictures(scene)?;
    let patches: usize = terrain.detail.iter().map(|patch| patch.frame.len()).sum();
    let cells = (terrain.frame.len() + patches) as u64;
    let need = prototypes.bytes(&instances, &objects, cells) + config.film_bytes();
    progress.say(&format!("takes about {} of memory", bytes_in_words(need)));
    let built = weald_render::Scene::build(
        &weald_render::Parts {
            terrain: &terrain,
            palette: &palette,
            instances: &instances,
            prototypes: &prototypes,
            objects: &objects,
            species: &species_names(&palette),
            sky_pictures: weald_render::SkyPictures {
                image: sky_image.as_ref(),
                clouds: clouds.as_ref(),
            },
        },
        &scene.sky,
        progress,
    )
    .map_err(error())?;
    Ok(Assembled { built, view, config, counts, inputs })
}

/// A scene's statistics as JSON; counts through all levels may pass 64 bits and then become a
/// text.
fn statistics(statistics: &weald_render::Statistics) -> Json {
    let count =
        |number: u128| u64::try_from(number).map_or_else(|_| json!(number.to_string()), Json::from);
    json!({
        "prototypes": statistics.prototypes,
        "instances": statistics.instances,
        "plants": count(statistics.plants),
        "unique_primitives": statistics.unique_primitives,
        "instanced_primitives": count(statistics.instanced_primitives),
        "bytes": statistics.bytes,
    })
}

fn has_levels(scene: &Scene, species: &str) -> bool {
    scene.species.get(species).is_some_and(super::plants::has_levels)
}

/// All models as one parent: the hash of their hashes.
fn plants_parent(scene: &Scene, folder: &Path, palette: &Palette) -> Result<Parent> {
    let mut hasher = blake3::Hasher::new();
    for plant in &palette.representatives {
        let levels = if has_levels(scene, &plant.species) { scene.plants.levels.len() } else { 0 };
        for level in 0..=levels as u32 {
            let path = folder.join(plant_file(plant.id, level));
            hasher.update(weald_formats::hash_file(&path)?.as_bytes());
        }
    }
    let blake3 = hasher.finalize().to_hex().to_string();
    Ok(Parent { name: file_name(folder), blake3, provenance: None })
}

/// Names of all species and groups in a palette, sorted: their order numbers them in pictures.
pub fn species_names(palette: &Palette) -> Vec<String> {
    let plants = palette.representatives.iter().map(|plant| plant.species.clone());
    let mut names: Vec<String> =
        plants.chain(palette.groups.iter().map(|group| group.species.clone())).collect();
    names.sort();
    names.dedup();
    names
}

/// Opens the pictures of `[sky]`: light from everywhere, and clouds.
fn sky_pictures(scene: &Scene) -> Result<(Option<Picture>, Option<Image>)> {
    let (mut light, mut clouds) = (None, None);
    for SceneInput { input, path } in &scene.object_inputs {
        match input.kind {
            InputKind::Light => {
                light = Some(weald_formats::read_picture(path).map_err(at_field(scene, input))?);
            }
            InputKind::Image => {
                clouds = Some(weald_formats::read_image(path).map_err(at_field(scene, input))?);
            }
            _ => {}
        }
    }
    Ok((light, clouds))
}

/// Opens the models of `[[object]]` and puts them on the ground.
fn objects(scene: &Scene, terrain: &Layers) -> Result<Vec<weald_render::Object>> {
    let mut objects = Vec::new();
    let pairs = scene.tables.object.iter().zip(&scene.object_inputs);
    for (index, (object, SceneInput { input, path })) in pairs.enumerate() {
        let model = weald_formats::read_model(path).map_err(at_field(scene, input))?;
        let (x, y) = (terrain.frame.west + object.at[0], terrain.frame.south + object.at[1]);
        let frame = &terrain.frame;
        let [east, north] = [frame.width as f64 * frame.cell, frame.height as f64 * frame.cell];
        let is_on = (0.0..=east).contains(&object.at[0]) && (0.0..=north).contains(&object.at[1]);
        if !(is_on || object.altitude) {
            let message = format!("`object[{index}].at` is {:?}, off the terrain", object.at);
            let hint = format!("0, 0 to {east}, {north} is right, or `altitude = true`");
            let problem = Problem::at(input.path.span, message).hint(hint);
            return Err(Error::wrong(&scene.sources, problem));
        }
        let ground =
            if object.altitude { 0.0 } else { terrain.sample("altitude", x, y).unwrap_or(0.0) };
        objects.push(weald_render::Object {
            model: Arc::new(model),
            position: [x, y, f64::from(ground) + object.height],
            // Azimuths turn clockwise, angles in code the other way.
            yaw: -object.yaw_deg.to_radians() as f32,
            scale: object.scale as f32,
        });
    }
    Ok(objects)
}
