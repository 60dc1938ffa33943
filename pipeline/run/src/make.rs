//! One stage at a time: open what it reads, let it work, write what it made with a preview.
//!
//! `weald run` and the commands of single stages both come through here. A stage always reads
//! its input back from files, never from the memory of the stage before: so a run from nothing
//! and a run that goes on from files make the same bytes, and each file is known to be enough.

mod ecosim;
mod levels;
mod memory;
mod organs;
mod plants;
mod quantize;
mod render;
mod terrain;
mod twigs;

pub use ecosim::{EcosimPaths, ecosim};
pub(crate) use ecosim::{Opened, refusal};
pub use levels::{Leveled, Pixels, level};
pub use plants::{
    Growing, grow_coarse, grow_one, model_file, paths_of, plant_file, plants, skeleton_of,
};
pub use quantize::{Quantizing, quantize};
pub(crate) use render::{Assembled, assemble};
pub use render::{RenderPaths, render, species_names};
pub use terrain::{named_layers, terrain};
pub(crate) use twigs::SharedTwigs;

use crate::error::{Error, Result};
use crate::footprint;
use crate::parameters::parameters;
use crate::preview::Sketch;
use crate::recipe::{HashedInput, Stage};
use crate::scene::{Scene, SceneInput};
use serde_json::Value as Json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::{Image, InputKind, Layers, Population, Problem, Seed};
use weald_formats::{Parent, Provenance};

/// What a stage left.
#[derive(Clone, Debug, Default)]
pub struct Made {
    /// The files, in the order in which they were written.
    pub files: Vec<PathBuf>,
    /// Numbers worth knowing.
    pub report: Json,
    /// A report for people, where numbers alone say too little; may be empty.
    pub words: String,
}

impl Made {
    fn wrote(&mut self, path: &Path) -> Result<()> {
        self.files.push(path.to_path_buf());
        Ok(())
    }

    fn preview(&mut self, path: &Path, sketch: &Sketch, provenance: &Provenance) -> Result<()> {
        weald_formats::write_png(path, sketch.width, sketch.height, &sketch.rgb, provenance)?;
        self.wrote(path)
    }
}

/// Turns the error of a stage into ours; the three variants that all stages share keep their
/// meaning, the rest are told in words.
macro_rules! stage_error {
    ($sources:expr, $stage:expr, $krate:ident) => {
        |error| match error {
            $krate::Error::Problem(problem) => Error::wrong($sources, problem),
            $krate::Error::Cancelled => Error::Stopped { saved: false },
            #[allow(unreachable_patterns, reason = "some stages have no errors of their own")]
            other => Error::Stage { stage: $stage.word(), message: other.to_string() },
        }
    };
}
use stage_error;

/// Version of the program, as it stands in provenance.
const VERSION: &str = env!("CARGO_PKG_VERSION");

/// The provenance of a stage's files.
pub fn provenance(scene: &Scene, stage: Stage, is_draft: bool, inputs: Vec<Parent>) -> Provenance {
    Provenance {
        stage: stage.word().into(),
        version: VERSION.into(),
        output_version: stage.output_version(),
        parameters: parameters(scene, stage, is_draft),
        seed: scene.tables.seed,
        inputs,
    }
}

/// Scene inputs as parents.
pub fn parents_of_inputs(inputs: &[HashedInput]) -> Vec<Parent> {
    let parent = |input: &HashedInput| Parent {
        name: input.name.clone(),
        blake3: input.blake3.clone(),
        provenance: None,
    };
    inputs.iter().map(parent).collect()
}

/// A file of an earlier stage as a parent, with the story that it tells of itself.
pub(crate) fn parent(path: &Path) -> Result<Parent> {
    let file = if path.is_dir() { path.join("altitude.tif") } else { path.to_path_buf() };
    Ok(Parent {
        name: file_name(&file),
        blake3: weald_formats::hash_file(&file)?,
        provenance: weald_formats::provenance(&file)?.map(Box::new),
    })
}

/// Reads the terrain that a later stage stands on, which must have no holes.
pub(crate) fn whole_terrain(folder: &Path) -> Result<Layers> {
    let terrain = weald_formats::read_terrain(folder)?;
    let altitudes = terrain.values("altitude").unwrap_or_default();
    match altitudes.iter().filter(|altitude| altitude.is_nan()).count() {
        0 => Ok(terrain),
        holes => Err(Error::plain(
            format!("{}: {holes} cells have no altitude", folder.display()),
            "plants and pictures need whole ground: `source_holes = \"fill\"` in `[terrain]`",
        )),
    }
}

fn file_name(path: &Path) -> String {
    path.file_name().map_or_else(String::new, |name| name.to_string_lossy().into_owned())
}

/// Makes a folder and those around it.
pub(crate) fn make_folder(path: &Path) -> Result<()> {
    std::fs::create_dir_all(path).map_err(|error| Error::system(path, error))
}

/// Makes the folder in which a file will stand.
pub(crate) fn make_folder_of(path: &Path) -> Result<()> {
    match path.parent() {
        Some(folder) if !folder.as_os_str().is_empty() => make_folder(folder),
        _ => Ok(()),
    }
}

/// Opens the images among a stage's inputs, by path as written, and takes the outlines of models.
fn images(scene: &Scene, inputs: &[SceneInput]) -> Result<BTreeMap<String, Image>> {
    let mut images = BTreeMap::new();
    for SceneInput { input, path } in inputs {
        let image = match input.kind {
            InputKind::Image => weald_formats::read_image(path),
            InputKind::Model => weald_formats::read_model(path).map(|model| footprint::of(&model)),
            _ => continue,
        };
        images.insert(input.path.value.clone(), image.map_err(at_field(scene, input))?);
    }
    Ok(images)
}

/// Puts a file's error at the field that names the file.
fn at_field<'a>(
    scene: &'a Scene,
    input: &'a weald_contract::Input,
) -> impl Fn(weald_formats::Error) -> Error + 'a {
    move |error| {
        let message = format!("`{}`: {error}", input.field);
        Error::wrong(&scene.sources, Problem::at(input.path.span, message))
    }
}

/// Complains of the first plant of a table that people wrote which has a number that no plant has,
/// or, where all are needed, lacks one.
///
/// # Errors
/// The mistake, with file, row and column.
pub fn check_plants(path: &Path, population: &Population, are_all_needed: bool) -> Result<()> {
    for (row, plant) in population.plants.iter().enumerate() {
        // The limits of a palette: what lies beyond could be written there, but not read back.
        let numbers = [
            ("age", plant.age, 100_000.0),
            ("vigor", plant.vigor, 1.0),
            ("height", plant.height, 1000.0),
            ("radius", plant.radius, 1000.0),
        ];
        let is_wrong = |value: f32, most| match value.is_nan() {
            true => are_all_needed,
            false => !(0.0..=most).contains(&value),
        };
        if let Some((name, value, most)) = numbers.iter().find(|(_, v, most)| is_wrong(*v, *most)) {
            let what = match value.abs() {
                size if size.is_nan() => "is missing".into(),
                size if size >= 1e9 => format!("is {value:e}"),
                _ => format!("is {value}"),
            };
            let place = format!("{}, row {}, column `{name}`", path.display(), row + 1);
            let hint = match value.is_nan() {
                true => "every plant needs age, vigor, height and radius".into(),
                false => format!("0 to {most} is right"),
            };
            return Err(Error::plain(format!("{place}: the value {what}"), hint));
        }
    }
    Ok(())
}

/// Seed of a stage: its own, so that stages draw from separate streams.
pub fn stage_seed(scene: &Scene, stage: Stage) -> Seed {
    Seed(scene.tables.seed).part(stage.word(), 0)
}

/// Writes JSON for people, with a final newline.
///
/// # Errors
/// The disk refuses.
pub fn write_json(path: &Path, value: &Json) -> Result<()> {
    use std::io::Write;
    weald_formats::write_atomically(path, |file| {
        serde_json::to_writer_pretty(&mut *file, value)?;
        Ok(file.write_all(b"\n")?)
    })?;
    Ok(())
}
