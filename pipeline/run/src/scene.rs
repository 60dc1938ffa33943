//! A scene: one TOML file, the species it names and the files its tables list.
//!
//! Everything that can be known to be wrong before any work is gathered here, from all tables at
//! once: syntax, types, unknown fields, species and views that are nowhere, files that are absent.

mod read;

pub use read::{find_species, load_species, near_file, read_species, read_text};

use crate::error::{Error, Result};
use crate::parameters::{ecosim_species, quantize_species};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::{
    FromToml, Input, Problems, Raster, Sources, Species, Value, View, Written, table,
};
use weald_formats::HeightScale;

table! {
    /// A scene: ground, plants, views and light.
    pub struct SceneTables {
        /// Name for people.
        title: String = String::new();
        /// Root of all chance: another seed gives another scene of the same kind.
        seed: u64 = 0;
        /// The ground: read by the stage terrain.
        terrain: Option<Value> = None;
        /// The plants: read by the stage ecosim.
        ecosim: Option<Value> = None;
        /// How plants become few models: read by the stage quantize.
        quantize: Option<Value> = None;
        /// Season, textures and levels of the models: read by the stage plants.
        plants: Option<Value> = None;
        /// Places to look from.
        view: Vec<View> = Vec::new();
        /// Sun and sky.
        sky: Option<Value> = None;
        /// The picture: read by the stage render.
        render: Option<Value> = None;
        /// Things that are no plants: houses, fences, stones.
        object: Vec<SceneObject> = Vec::new();
    }
}

table! {
    /// A thing that stands in the scene.
    pub struct SceneObject {
        /// Mesh, a `.glb` or `.obj` file.
        model: Written<String>;
        /// Place, scene coordinates, m.
        at: [f64; 2], in -1000000.0..=1000000.0;
        /// Height of its origin above the ground, or above sea level with `altitude = true`, m.
        height: f64 = 0.0, in -10000.0..=100000.0;
        /// Whether `height` counts from sea level.
        altitude: bool = false;
        /// Turn about the vertical, degrees clockwise from north.
        yaw_deg: f64 = 0.0, in -3600.0..=3600.0;
        /// Uniform scale.
        scale: f64 = 1.0, in 0.000001..=1000000.0;
    }
}

/// A species with the tables that the stages read.
#[derive(Clone, Debug)]
pub struct SceneSpecies {
    /// What all stages agree on.
    pub species: Species,
    /// Its `[ecology]`, for ecosim.
    pub ecology: Option<weald_ecosim::Ecology>,
    /// Its `[form]`, for plants.
    pub form: Option<weald_plants::Form>,
    /// Its `[look]`, for plants.
    pub look: weald_plants::Look,
    /// Where the text came from: a path, or `weald:species/NAME.toml` for one in the program.
    pub origin: String,
}

/// A file that a scene names.
#[derive(Clone, Debug)]
pub struct SceneInput {
    /// Field, path as written and what is expected.
    pub input: Input,
    /// The path to open.
    pub path: PathBuf,
}

/// A scene without a mistake that can be found before work.
#[derive(Clone, Debug)]
pub struct Scene {
    /// All texts: the scene, flags, species.
    pub sources: Sources,
    /// The file itself.
    pub path: PathBuf,
    /// Name: that of the folder, or of a file that is not called `scene.toml`.
    pub name: String,
    /// Title, seed, views and objects.
    pub tables: SceneTables,
    /// `[terrain]`.
    pub terrain: weald_terrain::Config,
    /// `[ecosim]`.
    pub ecosim: weald_ecosim::Config,
    /// `[quantize]`.
    pub quantize: weald_quantize::Config,
    /// `[plants]`.
    pub plants: weald_plants::Conditions,
    /// `[sky]`.
    pub sky: weald_render::Sky,
    /// `[render]`.
    pub render: weald_render::Config,
    /// Names of the species that ecosim plants, sorted.
    pub planted: Vec<String>,
    /// Every species that may occur, members of groups too.
    pub species: BTreeMap<String, SceneSpecies>,
    /// Files named by `[terrain]`.
    pub terrain_inputs: Vec<SceneInput>,
    /// Files named by `[ecosim]`.
    pub ecosim_inputs: Vec<SceneInput>,
    /// Models named by `[[object]]`, then pictures named by `[sky]`.
    pub object_inputs: Vec<SceneInput>,
}

/// What a command changes in a scene before it is read.
#[derive(Clone, Debug, Default)]
pub struct Changes {
    /// `--set` flags, in order.
    pub set: Vec<String>,
    /// `--seed`.
    pub seed: Option<u64>,
}

impl Scene {
    /// Reads the elevation model with what `[terrain]` says about images of heights.
    ///
    /// # Errors
    /// See [`weald_formats::read_elevation`].
    pub fn read_elevation(&self, path: &Path) -> weald_formats::Result<Raster> {
        let (cell, heights) = (self.terrain.source_cell, self.terrain.source_heights);
        weald_formats::read_elevation(path, &HeightScale { cell, heights })
    }

    /// Reads `scene.toml`, given itself or by its folder.
    ///
    /// # Errors
    /// The file cannot be read, or [`Error::Wrong`] with everything that is wrong in it.
    pub fn load(path: &Path, changes: &Changes) -> Result<Scene> {
        let path = scene_file(path);
        let mut reader = read::Reader::new(&path);
        let text = read_text(&path)?;
        let source = reader.sources.add(path.display().to_string(), text.clone());
        match Value::parse(source, &text) {
            Ok(tree) => reader.read(tree, changes),
            Err(problems) => Err(Error::Wrong { sources: reader.sources.into(), problems }),
        }
    }

    /// The view that `[render]` uses.
    ///
    /// # Errors
    /// The scene has none, or none of that name.
    pub fn wanted_view(&self) -> Result<&View> {
        let found = self.render.find_view(&self.tables.view);
        found.map_err(|problem| Error::wrong(&self.sources, problem))
    }

    /// The view with this name.
    pub fn view(&self, name: &str) -> Option<&View> {
        self.tables.view.iter().find(|view| view.name == name)
    }

    /// The folder that relative paths of the scene start from.
    pub fn folder(&self) -> &Path {
        self.path.parent().unwrap_or(Path::new(""))
    }

    /// Every file the scene depends on: itself, species beside it, inputs.
    pub fn files(&self) -> Vec<PathBuf> {
        let inputs = [&self.terrain_inputs, &self.ecosim_inputs, &self.object_inputs];
        let mut files = vec![self.path.clone()];
        files.extend(inputs.into_iter().flatten().map(|input| input.path.clone()));
        let beside = self.species.values().map(|species| PathBuf::from(&species.origin));
        files.extend(beside.filter(|path| path.is_file()));
        files.sort();
        files.dedup();
        files
    }

    /// What ecosim, quantize and plants find wrong before any work.
    ///
    /// `known` are the problems found so far: a species that could not be read is not complained
    /// of again as unknown.
    fn stage_problems(&self, known: &Problems) -> Problems {
        let mut problems = Vec::new();
        if known.is_empty() {
            problems.extend(self.ecosim.check(&ecosim_species(self), &self.terrain.layer_names()));
            problems.extend(self.quantize.check(&quantize_species(self)));
        }
        for found in self.species.values() {
            problems.extend(found.form.iter().flat_map(weald_plants::Form::check));
            problems.extend(found.look.check());
        }
        problems.extend(self.plants.check());
        problems
    }

    /// JSON Schema of a scene file, from the same declarations that read it.
    pub fn json_schema() -> serde_json::Value {
        let mut schema = SceneTables::schema();
        let stages = [
            ("terrain", weald_terrain::Config::schema()),
            ("ecosim", weald_ecosim::Config::schema()),
            ("quantize", weald_quantize::Config::schema()),
            ("plants", weald_plants::Conditions::schema()),
            ("sky", weald_render::Sky::schema()),
            ("render", weald_render::Config::schema()),
        ];
        for (name, stage) in stages {
            schema["properties"][name] = stage;
        }
        schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
        schema["title"] = "Weald scene".into();
        schema
    }
}

/// JSON Schema of a species file, with the tables that the stages read.
pub fn species_schema() -> serde_json::Value {
    let mut schema = Species::json_schema();
    schema["properties"]["ecology"] = weald_ecosim::Ecology::schema();
    schema["properties"]["form"] = weald_plants::Form::schema();
    schema["properties"]["look"] = weald_plants::Look::schema();
    schema["$schema"] = "https://json-schema.org/draft/2020-12/schema".into();
    schema["title"] = "Weald species".into();
    schema
}

/// The scene file meant by a path: a folder means its `scene.toml`.
pub fn scene_file(path: &Path) -> PathBuf {
    if path.is_dir() { path.join("scene.toml") } else { path.to_path_buf() }
}
