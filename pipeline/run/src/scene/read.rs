//! Reading a scene: from text to values without a mistake, or to every mistake at once.

use super::{Changes, Scene, SceneInput, SceneObject, SceneSpecies, SceneTables};
use crate::error::{Error, Result, none_wrong};
use crate::{edit, library};
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::source::nearest;
use weald_contract::table::{Entry, FromToml, Kind, Table};
use weald_contract::{Input, InputKind, Problem, Problems, Sources, Span, Species, Value, Written};

/// Reads a text file, bounded so that a wrong name does not fill the memory.
pub fn read_text(path: &Path) -> Result<String> {
    /// Scenes and species are a few kilobytes.
    const MAX_BYTES: u64 = 16 << 20;
    let size = std::fs::metadata(path).map_err(|error| missing(path, error))?.len();
    if size > MAX_BYTES {
        let message = format!("{} has {size} bytes", path.display());
        return Err(Error::plain(message, "a TOML file of at most 16 MB was expected"));
    }
    let bytes = std::fs::read(path).map_err(|error| Error::system(path, error))?;
    String::from_utf8(bytes).map_err(|error| {
        let at = error.utf8_error().valid_up_to();
        Error::plain(
            format!("{} is not UTF-8 at byte {at}", path.display()),
            "a TOML text was expected",
        )
    })
}

fn missing(path: &Path, error: std::io::Error) -> Error {
    if error.kind() != std::io::ErrorKind::NotFound {
        return Error::system(path, error);
    }
    let hint = match path.file_name().and_then(|name| name.to_str()) {
        Some("scene.toml") => {
            "give a folder that holds a `scene.toml`, or make one with `weald new`".into()
        }
        _ => near_file(path).unwrap_or_else(|| "check the path".into()),
    };
    Error::plain(format!("there is no file {}", path.display()), hint)
}

/// "did you mean" for a file that is not there, from its folder's names.
pub fn near_file(path: &Path) -> Option<String> {
    let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
    let entries = std::fs::read_dir(folder.unwrap_or(Path::new("."))).ok()?;
    let mut names: Vec<String> =
        entries.flatten().map(|entry| entry.file_name().to_string_lossy().into_owned()).collect();
    names.sort();
    let name = path.file_name()?.to_string_lossy().into_owned();
    nearest(&name, names.iter().map(String::as_str)).map(|near| format!("did you mean `{near}`?"))
}

/// Reads one species file's text into what the stages need.
///
/// `None` when something is wrong, which is then in `problems`.
pub fn read_species(
    origin: &str,
    text: &str,
    sources: &mut Sources,
    problems: &mut Problems,
) -> Option<SceneSpecies> {
    let none = SpeciesChanges { name: "", flags: &[] };
    read_changed(origin, text, none, sources, problems)
}

/// What flags change in a species.
struct SpeciesChanges<'a> {
    name: &'a str,
    /// `species.NAME.field=value`, in order.
    flags: &'a [String],
}

fn read_changed(
    origin: &str,
    text: &str,
    changes: SpeciesChanges<'_>,
    sources: &mut Sources,
    problems: &mut Problems,
) -> Option<SceneSpecies> {
    let source = sources.add(origin, text);
    let tree = Value::parse(source, text).map_err(|found| problems.extend(found)).ok()?;
    let tree = changes.apply(tree, sources, problems);
    let species = Species::read(&tree, problems)?;
    let before = problems.len();
    let ecology = species.ecology.as_ref().and_then(|v| FromToml::from_toml(v, problems));
    let form = species.form.as_ref().and_then(|v| FromToml::from_toml(v, problems));
    let look = species
        .look
        .as_ref()
        .map_or(Some(Default::default()), |v| FromToml::from_toml(v, problems));
    (problems.len() == before).then(|| SceneSpecies {
        species,
        ecology,
        form,
        look: look.unwrap_or_default(),
        origin: origin.into(),
    })
}

impl SpeciesChanges<'_> {
    /// Carries the flags out. They name the species, so that it is put where they look for it.
    fn apply(&self, tree: Value, sources: &mut Sources, problems: &mut Problems) -> Value {
        let within = |key: &str, value: Value| {
            let (span, key) = (value.span, key.to_string());
            let entries = vec![Entry { key, key_span: span, value }];
            Value { span, kind: Kind::Table(Table { entries }) }
        };
        let mut root = within(SPECIES.trim_end_matches('.'), within(self.name, tree));
        for flag in self.flags {
            edit::set(&mut root, flag, sources, problems);
        }
        [(), ()].iter().fold(root, |value, ()| match value.kind {
            Kind::Table(mut table) if table.entries.len() == 1 => table.entries.remove(0).value,
            _ => value,
        })
    }
}

/// Text and origin of a species: beside the scene first, then from the program.
pub fn find_species(folder: &Path, name: &str) -> Option<(String, Result<String>)> {
    let beside = folder.join("species").join(format!("{name}.toml"));
    if beside.is_file() {
        return Some((beside.display().to_string(), read_text(&beside)));
    }
    let text = library::species(name)?;
    Some((format!("weald:species/{name}.toml"), Ok(text.into())))
}

/// Species by name with their texts, and the members of those that are groups, for commands that
/// have no scene: from `species/` in `folder`, then from the program.
///
/// # Errors
/// Everything that is wrong with them, or that one is nowhere.
pub fn load_species(
    folder: &Path,
    names: impl IntoIterator<Item = String>,
) -> Result<(Sources, BTreeMap<String, SceneSpecies>)> {
    let mut reader = Reader::new(&folder.join("scene.toml"));
    let names: Vec<String> = names.into_iter().collect();
    // The names themselves are the text that a problem points into.
    let text = names.join(" ");
    let source = reader.sources.add("species asked for", text);
    let mut start = 0;
    let mut wanted = Vec::new();
    for value in names {
        let end = start + value.len();
        wanted.push(Written { value, span: Span { source, start: start as u32, end: end as u32 } });
        start = end + 1;
    }
    let species = reader.species(wanted);
    for found in species.values() {
        reader.problems.extend(found.form.iter().flat_map(weald_plants::Form::check));
        reader.problems.extend(found.look.check());
    }
    none_wrong(&reader.sources, reader.problems)?;
    Ok((reader.sources, species))
}

/// A scene on its way from text to [`Scene`].
pub(super) struct Reader {
    path: PathBuf,
    pub(super) sources: Sources,
    problems: Problems,
    /// `--set species.NAME.…`, by species.
    species_changes: BTreeMap<String, Vec<String>>,
}

/// What flags that change a species begin with.
const SPECIES: &str = "species.";

/// The tables of a scene; those with a mistake are absent.
struct Tables {
    scene: Option<SceneTables>,
    terrain: Option<weald_terrain::Config>,
    ecosim: Option<weald_ecosim::Config>,
    quantize: Option<weald_quantize::Config>,
    plants: Option<weald_plants::Conditions>,
    sky: Option<weald_render::Sky>,
    render: Option<weald_render::Config>,
}

impl Reader {
    pub(super) fn new(path: &Path) -> Self {
        Self {
            path: path.to_path_buf(),
            sources: Sources::default(),
            problems: Vec::new(),
            species_changes: BTreeMap::new(),
        }
    }

    fn folder(&self) -> PathBuf {
        self.path.parent().unwrap_or(Path::new("")).to_path_buf()
    }

    /// Reads every table, then checks what stands between tables, species and files.
    pub(super) fn read(mut self, mut tree: Value, changes: &Changes) -> Result<Scene> {
        for flag in &changes.set {
            match flag.strip_prefix(SPECIES).and_then(|rest| rest.split_once('.')) {
                Some((name, _)) => {
                    let name = name.trim().to_string();
                    self.species_changes.entry(name).or_default().push(flag.clone());
                }
                None => edit::set(&mut tree, flag, &mut self.sources, &mut self.problems),
            }
        }
        let tables = self.tables(&tree);
        self.check_views(&tables, &tree);
        let terrain_inputs =
            self.open_inputs(tables.terrain.as_ref().map(weald_terrain::Config::inputs));
        let ecosim_inputs =
            self.open_inputs(tables.ecosim.as_ref().map(weald_ecosim::Config::inputs));
        let models = tables.scene.as_ref().map(object_inputs).unwrap_or_default();
        let skies = tables.sky.as_ref().map(weald_render::Sky::inputs).unwrap_or_default();
        let object_inputs = self.open_inputs(Some([models, skies].concat()));
        let mut wanted = tables.ecosim.as_ref().map_or_else(Vec::new, named_species);
        if let Some(ecosim) = &tables.ecosim {
            wanted.extend(self.species_of_tables(ecosim, &ecosim_inputs));
        }
        let planted = sorted_names(&wanted);
        let species = self.species(wanted);
        self.check_changes(&species);

        let Tables {
            scene: Some(mut tables),
            terrain: Some(terrain),
            ecosim: Some(ecosim),
            quantize: Some(quantize),
            plants: Some(plants),
            sky: Some(sky),
            render: Some(render),
        } = tables
        else {
            // Each table that could not be read has left its problems.
            return Err(Error::Wrong { sources: self.sources.into(), problems: self.problems });
        };
        tables.seed = changes.seed.unwrap_or(tables.seed);
        let mut scene = Scene {
            name: scene_name(&self.path),
            sources: Sources::default(),
            path: self.path,
            tables,
            terrain,
            ecosim,
            quantize,
            plants,
            sky,
            render,
            planted,
            species,
            terrain_inputs,
            ecosim_inputs,
            object_inputs,
        };
        self.problems.extend(scene.stage_problems(&self.problems));
        none_wrong(&self.sources, self.problems)?;
        scene.sources = self.sources;
        Ok(scene)
    }

    /// Reads each table by itself: a mistake in one must not hide those in another.
    fn tables(&mut self, tree: &Value) -> Tables {
        Tables {
            scene: SceneTables::from_toml(tree, &mut self.problems),
            terrain: self.stage(tree, "terrain"),
            ecosim: self.stage(tree, "ecosim"),
            quantize: self.stage(tree, "quantize"),
            plants: self.stage(tree, "plants"),
            sky: self.stage(tree, "sky"),
            render: self.stage(tree, "render"),
        }
    }

    /// Reads the table of one stage; an absent one is read as an empty one.
    fn stage<T: FromToml>(&mut self, tree: &Value, name: &str) -> Option<T> {
        let found = tree.as_table().and_then(|table| table.get(name));
        if let Some(value) = found {
            return T::from_toml(value, &mut self.problems);
        }
        let empty = Value { span: tree.span, kind: Kind::Table(Table::default()) };
        let mut problems = Vec::new();
        let read = T::from_toml(&empty, &mut problems);
        self.problems.extend(problems.into_iter().map(|problem| Problem {
            message: format!("{} in table `[{name}]`, which is absent", problem.message),
            ..problem
        }));
        read
    }

    /// Complains of views that have the same name, and of names that no view has.
    fn check_views(&mut self, tables: &Tables, tree: &Value) {
        // With a mistake in a `[[view]]` every other one would look unknown as well.
        let Some(scene) = &tables.scene else { return };
        let names: Vec<&str> = scene.view.iter().map(|view| view.name.as_str()).collect();
        for (i, name) in names.iter().enumerate() {
            if names[..i].contains(name) {
                let problem = Problem::new(format!("two views are called `{name}`"));
                let span = name_of_view(tree, i).map(|value| value.span);
                self.problems.push(Problem { span, ..problem.hint("rename one") });
            }
        }
        let of_terrain = tables.terrain.iter().flat_map(|config| config.check(&scene.view));
        // A scene of nothing but ground needs no view until it is rendered.
        let is_seen =
            !scene.view.is_empty() || tree.as_table().is_some_and(|t| t.get("render").is_some());
        let is_weighed = tables.quantize.as_ref().is_some_and(weald_quantize::Config::lacks_eye);
        let of_render = tables.render.iter().filter(|_| is_seen || is_weighed);
        let of_render = of_render.flat_map(|config| config.check(&scene.view));
        self.problems.extend(of_terrain.chain(of_render));
    }

    /// Finds each named file, complaining of those that are not there.
    fn open_inputs(&mut self, inputs: Option<Vec<Input>>) -> Vec<SceneInput> {
        let mut opened = Vec::new();
        for input in inputs.unwrap_or_default() {
            let path = self.folder().join(&input.path.value);
            if path.is_file() {
                opened.push(SceneInput { input, path });
                continue;
            }
            if path.is_dir() {
                let message = format!("{} is a folder", path.display());
                let hint = format!("`{}` takes a file", input.field);
                self.problems.push(Problem::at(input.path.span, message).hint(hint));
                continue;
            }
            let message = format!("there is no file {}", path.display());
            let problem = Problem::at(input.path.span, message);
            self.problems.push(problem.hint(near_file(&path).unwrap_or_else(|| {
                format!("`{}` takes a path relative to the scene's folder", input.field)
            })));
        }
        opened
    }

    /// Species that occur in tables of plants which the scene names.
    fn species_of_tables(
        &mut self,
        config: &weald_ecosim::Config,
        inputs: &[SceneInput],
    ) -> Vec<Written<String>> {
        let mut names = Vec::new();
        for SceneInput { input, path } in inputs {
            if input.kind != InputKind::Plants {
                continue;
            }
            let read = weald_formats::read_population(path).map_err(Error::from);
            let checked = read.and_then(|population| {
                crate::make::check_plants(path, &population, false).map(|()| population)
            });
            match checked {
                Ok(population) => {
                    let meant = config.species_of_table(&input.path.value, &population.species);
                    let span = input.path.span;
                    names.extend(meant.into_iter().map(|value| Written { value, span }));
                }
                Err(error) => self.problems.push(Problem::at(input.path.span, error.to_string())),
            }
        }
        names
    }

    /// Reads every wanted species, and the members of those that are groups.
    fn species(&mut self, mut wanted: Vec<Written<String>>) -> BTreeMap<String, SceneSpecies> {
        let mut read = BTreeMap::new();
        let mut failed: Vec<String> = Vec::new();
        while let Some(name) = wanted.pop() {
            if read.contains_key(&name.value) || failed.contains(&name.value) {
                continue;
            }
            match self.one_species(&name) {
                Some(found) => {
                    let members = found.species.group.iter().flat_map(|group| &group.member);
                    wanted.extend(members.map(|member| member.species.clone()));
                    read.insert(name.value, found);
                }
                None => failed.push(name.value),
            }
        }
        read
    }

    fn one_species(&mut self, name: &Written<String>) -> Option<SceneSpecies> {
        let Some((origin, text)) = find_species(&self.folder(), &name.value) else {
            self.problems.push(unknown_species(name, &self.folder()));
            return None;
        };
        match text {
            Ok(text) => {
                let flags = self.species_changes.get(&name.value).map_or(&[][..], Vec::as_slice);
                let changes = SpeciesChanges { name: &name.value, flags };
                read_changed(&origin, &text, changes, &mut self.sources, &mut self.problems)
            }
            Err(error) => {
                self.problems.push(Problem::at(name.span, error.to_string()));
                None
            }
        }
    }

    /// Complains of changes to species that the scene does not have.
    fn check_changes(&mut self, species: &BTreeMap<String, SceneSpecies>) {
        let unknown = self.species_changes.keys().filter(|name| !species.contains_key(*name));
        for name in unknown.cloned().collect::<Vec<_>>() {
            let problem = Problem::new(format!("`--set`: the scene has no species `{name}`"));
            let known: Vec<&str> = species.keys().map(String::as_str).collect();
            let hint = match nearest(&name, known.iter().copied()) {
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("it has {}", known.join(", ")),
            };
            self.problems.push(problem.hint(hint));
        }
    }
}

/// Where the name of a view stands in the text.
fn name_of_view(tree: &Value, index: usize) -> Option<&Value> {
    match &tree.as_table()?.get("view")?.kind {
        Kind::Array(views) => views.get(index)?.as_table()?.get("name"),
        _ => None,
    }
}

/// The complaint about a species that is nowhere, with those that are.
fn unknown_species(name: &Written<String>, folder: &Path) -> Problem {
    let mut known: Vec<String> =
        library::SPECIES.iter().map(|(known, _)| (*known).to_string()).collect();
    let beside = std::fs::read_dir(folder.join("species")).into_iter().flatten().flatten();
    known.extend(beside.filter_map(|entry| Some(entry.path().file_stem()?.to_str()?.to_string())));
    known.sort();
    known.dedup();
    let hint = match nearest(&name.value, known.iter().map(String::as_str)) {
        Some(near) => format!("did you mean `{near}`?"),
        None => format!(
            "write species/{}.toml beside the scene, or use one of: {}",
            name.value,
            known.join(", ")
        ),
    };
    Problem::at(name.span, format!("unknown species `{}`", name.value)).hint(hint)
}

/// Each name once, sorted.
fn sorted_names(names: &[Written<String>]) -> Vec<String> {
    let mut sorted: Vec<String> = names.iter().map(|name| name.value.clone()).collect();
    sorted.sort();
    sorted.dedup();
    sorted
}

/// Names of species that `[ecosim]` uses.
fn named_species(config: &weald_ecosim::Config) -> Vec<Written<String>> {
    config.species().into_iter().cloned().collect()
}

fn object_inputs(tables: &SceneTables) -> Vec<Input> {
    let input = |(index, object): (usize, &SceneObject)| Input {
        field: format!("object[{index}].model"),
        path: object.model.clone(),
        kind: InputKind::Model,
    };
    tables.object.iter().enumerate().map(input).collect()
}

/// Name of a scene for its output folder.
fn scene_name(path: &Path) -> String {
    let stem = path.file_stem().map(|stem| stem.to_string_lossy().into_owned());
    let folder = || {
        let folder = path.parent().filter(|folder| !folder.as_os_str().is_empty());
        let folder = folder.unwrap_or(Path::new(".")).canonicalize().ok()?;
        Some(folder.file_name()?.to_string_lossy().into_owned())
    };
    match stem {
        Some(stem) if stem != "scene" => stem,
        _ => folder().unwrap_or_else(|| "scene".into()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A scene that is right but for its elevation model, which is nowhere.
    const SCENE: &str = include_str!("../template/scene.toml");

    /// Problems of a scene's text, each with the line it points at.
    fn problems(text: &str) -> Vec<(usize, String)> {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("scene.toml");
        std::fs::write(&path, text).unwrap();
        match Scene::load(&path, &Changes::default()) {
            Err(Error::Wrong { sources, problems }) => problems
                .iter()
                .map(|problem| {
                    let place = problem.span.and_then(|span| sources.line_column(span));
                    (place.map_or(0, |(line, _)| line), problem.to_string())
                })
                .collect(),
            Err(other) => vec![(0, other.to_string())],
            Ok(_) => Vec::new(),
        }
    }

    #[test]
    fn the_template_lacks_only_its_ground() {
        let found = problems(SCENE);
        assert_eq!(found.len(), 1, "{found:?}");
        assert!(found[0].1.contains("there is no file"));
    }

    #[test]
    fn mistakes_in_different_tables_do_not_hide_each_other() {
        let text = SCENE
            .replace("rain = 0.8", "rian = 0.8")
            .replace("years = 40", "years = -4")
            .replace("representatives = 8", "representatives = 8.5")
            .replace("fov_deg = 50.0", "fov_deg = 500.0");
        let found: Vec<String> = problems(&text).into_iter().map(|(_, text)| text).collect();
        for word in ["rian", "-4", "8.5", "fov_deg"] {
            assert!(found.iter().any(|text| text.contains(word)), "no `{word}` in {found:#?}");
        }
        assert_eq!(found.len(), 4, "{found:#?}");
    }

    #[test]
    fn unknown_species_views_and_files_are_told_together() {
        let text =
            SCENE.replace("\"meadow\"", "\"medow\"").replace("view = \"bank\"", "view = \"bnak\"");
        let found: Vec<String> = problems(&text).into_iter().map(|(_, text)| text).collect();
        for word in ["medow", "bnak", "no file"] {
            assert!(found.iter().any(|text| text.contains(word)), "no `{word}` in {found:#?}");
        }
    }

    #[test]
    fn a_scene_without_a_table_says_which() {
        let found = problems("seed = 1");
        assert!(
            found.iter().any(|(_, text)| text.contains("`[terrain]`, which is absent")),
            "{found:?}"
        );
    }

    #[test]
    fn a_name_near_the_right_one_is_suggested() {
        let folder = tempfile::tempdir().unwrap();
        std::fs::write(folder.path().join("ground.tif"), "").unwrap();
        let hint = near_file(&folder.path().join("gruond.tif"));
        assert_eq!(hint, Some("did you mean `ground.tif`?".to_string()));
        assert_eq!(near_file(&folder.path().join("xyz.png")), None);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn no_change_of_a_scene_makes_the_reader_panic(
            at in 0..SCENE.len(), cut in 0..40usize, insert in "[\\PC\n]{0,8}",
        ) {
            let start = (0..=at).rev().find(|&i| SCENE.is_char_boundary(i)).unwrap_or(0);
            let end = (at + cut..=SCENE.len()).find(|&i| SCENE.is_char_boundary(i));
            let text = format!("{}{insert}{}", &SCENE[..start], &SCENE[end.unwrap_or(SCENE.len())..]);
            problems(&text);
        }
    }
}
