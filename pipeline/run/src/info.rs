//! The story of a file, back to the ground: `weald info`.

use crate::checkpoint;
use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use crate::parameters::canonical;
use crate::scene::{Changes, Scene};
use serde::Serialize;
use serde_json::{Value as Json, json};
use std::fmt;
use std::path::Path;
use weald_contract::Sources;
use weald_formats::{Column, Provenance};

/// What a file holds and how it came to be.
#[derive(Clone, Debug, Serialize)]
pub struct Info {
    /// The path, as given.
    pub path: String,
    /// The kind, in words.
    pub kind: String,
    /// What is in it: sizes, ranges, counts.
    pub facts: Vec<(String, Json)>,
    /// How it came to be; absent in files of other programs.
    pub provenance: Option<Provenance>,
    /// BLAKE3 of a single file's bytes.
    pub blake3: Option<String>,
}

/// Reads what can be told of a file or folder.
///
/// # Errors
/// There is nothing there, nothing we know, or it is damaged.
pub fn info(path: &Path) -> Result<Info> {
    let kind = files::kind(path)?;
    Ok(Info {
        path: path.display().to_string(),
        kind: kind.describe().into(),
        facts: facts(path, kind)?,
        provenance: provenance(path, kind)?,
        blake3: path.is_file().then(|| weald_formats::hash_file(path)).transpose()?,
    })
}

/// The provenance of a file; of a folder, that of what was made last in it.
fn provenance(path: &Path, kind: FileKind) -> Result<Option<Provenance>> {
    match kind {
        FileKind::Run => {
            let last =
                ["image.exr", "image-draft.exr", "palette.toml", "population.parquet", "terrain"];
            let found = last.iter().map(|name| path.join(name)).find(|path| path.exists());
            Ok(found.map(|path| weald_formats::provenance(&path)).transpose()?.flatten())
        }
        FileKind::Plants => match files::with_ending(path, "glb")?.first() {
            Some(file) => Ok(weald_formats::provenance(file)?),
            None => Ok(None),
        },
        FileKind::Report => {
            let report: Json = read_json(path)?;
            Ok(serde_json::from_value(report["provenance"].clone()).ok())
        }
        // People wrote these, and a checkpoint is told by its facts.
        FileKind::Scene | FileKind::Species | FileKind::Checkpoint => Ok(None),
        // An .asc of another program has no place for a story.
        FileKind::Raster if path.extension().is_some_and(|ending| ending == "asc") => Ok(None),
        _ => Ok(weald_formats::provenance(path)?),
    }
}

fn read_json(path: &Path) -> Result<Json> {
    let text = crate::scene::read_text(path)?;
    serde_json::from_str(&text)
        .map_err(|error| Error::plain(format!("{}: {error}", path.display()), "JSON was expected"))
}

/// What is in a file, as name and value.
fn facts(path: &Path, kind: FileKind) -> Result<Vec<(String, Json)>> {
    match kind {
        FileKind::Terrain => terrain_facts(path),
        FileKind::Run => run_facts(path),
        FileKind::Plants => plants_facts(path),
        FileKind::Raster => raster_facts(path),
        FileKind::Population => population_facts(path),
        FileKind::Instances => instances_facts(path),
        FileKind::Table => table_facts(path),
        FileKind::Palette => palette_facts(path),
        FileKind::Scene => scene_facts(path),
        FileKind::Species => species_facts(path),
        FileKind::Plant => plant_facts(path),
        FileKind::Picture => picture_facts(path),
        FileKind::Png => {
            let preview = weald_formats::read_png(path)?;
            Ok(vec![fact("size", format!("{} x {} pixels", preview.width, preview.height))])
        }
        FileKind::Report => Ok(vec![fact("report", read_json(path)?["report"].clone())]),
        FileKind::Checkpoint => checkpoint_facts(path),
    }
}

fn fact(name: &str, value: impl Into<Json>) -> (String, Json) {
    (name.into(), value.into())
}

fn frame_facts(frame: &weald_contract::Frame, crs: &weald_contract::Crs) -> Vec<(String, Json)> {
    let crs = match crs.epsg {
        Some(code) => json!(format!("EPSG:{code}")),
        None => json!("none named"),
    };
    vec![
        fact("size", format!("{} x {} cells of {} m", frame.width, frame.height, frame.cell)),
        fact("west, south", format!("{}, {}", frame.west, frame.south)),
        fact("reference system", crs),
    ]
}

/// Least, mean and greatest of the finite values.
fn spread<T: Copy + Into<f64>>(values: &[T]) -> Json {
    let finite = values.iter().map(|value| (*value).into()).filter(|value: &f64| value.is_finite());
    let finite: Vec<f64> = finite.collect();
    if finite.is_empty() {
        return json!("no finite value");
    }
    let low = finite.iter().copied().fold(f64::INFINITY, f64::min);
    let high = finite.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mean = finite.iter().sum::<f64>() / finite.len() as f64;
    let holes = values.len() - finite.len();
    let holes = if holes > 0 { format!(", {holes} without data") } else { String::new() };
    json!(format!("{low:.4} to {high:.4}, mean {mean:.4}{holes}"))
}

fn terrain_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let terrain = weald_formats::read_terrain(path)?;
    let mut facts = frame_facts(&terrain.frame, &terrain.crs);
    for (name, layer) in &terrain.layers {
        facts.push(fact(&format!("{name} [{}]", layer.unit), spread(&layer.values)));
    }
    for (index, patch) in terrain.detail.iter().enumerate() {
        let frame = patch.frame;
        let text = format!("{} x {} cells of {} m", frame.width, frame.height, frame.cell);
        facts.push(fact(&format!("detail-{index}"), text));
    }
    Ok(facts)
}

fn raster_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let raster = weald_formats::read_raster(path)?;
    let mut facts = frame_facts(&raster.grid.frame, &raster.crs);
    facts.push(fact("values", spread(&raster.grid.values)));
    Ok(facts)
}

fn population_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let population = weald_formats::read_population(path)?;
    let mut facts = vec![fact("plants", population.len())];
    for (name, count) in population.species.iter().zip(population.counts()) {
        facts.push(fact(&format!("  {name}"), count));
    }
    let column = |value: fn(&weald_contract::Plant) -> f32| {
        spread(&population.plants.iter().map(value).collect::<Vec<_>>())
    };
    facts.push(fact("height [m]", column(|plant| plant.height)));
    facts.push(fact("age [years]", column(|plant| plant.age)));
    facts.push(fact("vigor", column(|plant| plant.vigor)));
    Ok(facts)
}

fn instances_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let instances = weald_formats::read_instances(path)?;
    let mut prototypes = instances.prototype.clone();
    prototypes.sort_unstable();
    prototypes.dedup();
    let in_scene = instances.group.iter().filter(|group| **group == 0).count();
    Ok(vec![
        fact("rows", instances.len()),
        fact("in the scene", in_scene),
        fact("in groups", instances.len() - in_scene),
        fact("different prototypes", prototypes.len()),
    ])
}

fn table_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let table = weald_formats::read_table(path)?;
    let describe = |(name, column): &(String, Column)| match column.numbers() {
        Some(values) => (name.clone(), spread(&values)),
        None => {
            let mut distinct = column.texts().unwrap_or(&[]).to_vec();
            distinct.sort();
            distinct.dedup();
            (name.clone(), json!(format!("text, {} different", distinct.len())))
        }
    };
    Ok(table.columns.iter().map(describe).collect())
}

fn palette_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let palette = weald_formats::read_palette(path)?;
    let mut facts = vec![
        fact("representatives", palette.representatives.len()),
        fact("groups", palette.groups.len()),
    ];
    for name in crate::make::species_names(&palette) {
        let own = palette.representatives.iter().filter(|plant| plant.species == name);
        let plants: u64 = own.clone().map(|plant| plant.count).sum();
        let patches = palette.groups.iter().filter(|group| group.species == name);
        let patch_count: u64 = patches.clone().map(|group| group.count).sum();
        let text = match patches.count() {
            0 => format!("{} models for {plants} plants", own.count()),
            kinds => format!("{kinds} patches placed {patch_count} times"),
        };
        facts.push(fact(&format!("  {name}"), text));
    }
    Ok(facts)
}

fn checkpoint_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let Some(checkpoint::Header { recipe, year }) = checkpoint::describe(path)? else {
        return Ok(Vec::new());
    };
    let steps = recipe.parameters["ecosim"]["step"].as_array().map_or(0, Vec::len);
    let mut facts = vec![fact("years done", year), fact("steps", steps), fact("seed", recipe.seed)];
    facts.extend(recipe.inputs.into_iter().map(|input| fact(&input.name, input.blake3)));
    Ok(facts)
}

fn scene_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let scene = Scene::load(path, &Changes::default())?;
    let views: Vec<&str> = scene.tables.view.iter().map(|view| view.name.as_str()).collect();
    let [width, height] = scene.render.resolution;
    Ok(vec![
        fact("title", scene.tables.title.clone()),
        fact("seed", scene.tables.seed),
        fact("elevation model", scene.terrain.source.value.clone()),
        fact("terrain operators", scene.terrain.op.len()),
        fact("ecosim steps", scene.ecosim.step.len()),
        fact("species planted", scene.planted.join(", ")),
        fact("views", views.join(", ")),
        fact("picture", format!("{width} x {height}, {} samples", scene.render.samples)),
    ])
}

fn species_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let mut sources = Sources::default();
    let mut problems = Vec::new();
    let text = crate::scene::read_text(path)?;
    let name = path.display().to_string();
    let Some(found) = crate::scene::read_species(&name, &text, &mut sources, &mut problems) else {
        return Err(Error::Wrong { sources: sources.into(), problems });
    };
    let size = &found.species.size;
    let form = found.form.as_ref().map_or("a patch of other species", weald_plants::Form::word);
    Ok(vec![
        fact("title", found.species.title.clone()),
        fact("latin", found.species.latin.clone()),
        fact("form", form),
        fact("height [m]", canonical(&size.height)),
        fact("crown radius [m]", canonical(&size.crown_radius)),
        fact("lifespan [years]", canonical(&size.lifespan)),
    ])
}

fn plant_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let model = weald_formats::read_plant(path)?;
    let mut facts = vec![
        fact("name", model.name.clone()),
        fact("height [m]", f64::from(model.height())),
        fact("triangles stored", model.unique_triangles()),
        fact("triangles with organs", model.instanced_triangles()),
    ];
    for organ in &model.organs {
        facts.push(fact(&format!("  {}", organ.name), organ.placements.len()));
    }
    Ok(facts)
}

fn plants_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let files = files::with_ending(path, "glb")?;
    let mut facts = vec![fact("models", files.len())];
    for file in files {
        let model = weald_formats::read_plant(&file)?;
        let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let text = format!(
            "{}, {:.2} m, {} triangles",
            model.name,
            model.height(),
            model.instanced_triangles()
        );
        facts.push(fact(&format!("  {name}"), text));
    }
    Ok(facts)
}

fn picture_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let picture = weald_formats::read_picture(path)?;
    let mut facts = vec![fact("size", format!("{} x {} pixels", picture.width, picture.height))];
    for channel in &picture.channels {
        facts.push(fact(&format!("  {}", channel.name), spread(&channel.values)));
    }
    Ok(facts)
}

fn run_facts(path: &Path) -> Result<Vec<(String, Json)>> {
    let mut facts = Vec::new();
    for stage in crate::Stage::ALL {
        let record = crate::record::Record::read(&crate::record::record_path(path, stage, false));
        let text = match record {
            Some(record) => {
                let bytes: u64 = record.outputs.iter().map(|output| output.bytes).sum();
                let key = record.key.get(..12).unwrap_or_default().to_string();
                json!(format!(
                    "{} files, {bytes} bytes, key {key}, {}",
                    record.outputs.len(),
                    record.report
                ))
            }
            None => json!("not made"),
        };
        facts.push(fact(stage.word(), text));
    }
    Ok(facts)
}

impl fmt::Display for Info {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "{}: {}", self.path, self.kind)?;
        for (name, value) in &self.facts {
            match value {
                Json::String(text) => writeln!(f, "  {name:<24} {text}")?,
                other => writeln!(f, "  {name:<24} {other}")?,
            }
        }
        if let Some(hash) = &self.blake3 {
            writeln!(f, "  {:<24} {hash}", "blake3")?;
        }
        match &self.provenance {
            Some(provenance) => story(f, provenance, 0),
            None => writeln!(f, "  it does not say how it came to be"),
        }
    }
}

/// Tells how something was made, then how each of its inputs was.
fn story(f: &mut fmt::Formatter<'_>, made: &Provenance, depth: usize) -> fmt::Result {
    let indent = "  ".repeat(depth + 1);
    let Provenance { stage, version, output_version, seed, .. } = made;
    writeln!(f, "{indent}made by {stage} (weald {version}, output {output_version}), seed {seed}")?;
    for (name, value) in made.parameters.as_object().into_iter().flatten() {
        let text = value.to_string();
        let short: String = text.chars().take(MAX_PARAMETER_CHARS).collect();
        let more = if short.len() < text.len() { "…" } else { "" };
        writeln!(f, "{indent}  {name} = {short}{more}")?;
    }
    for input in &made.inputs {
        let hash = input.blake3.get(..12).unwrap_or(&input.blake3);
        writeln!(f, "{indent}from {} ({hash})", input.name)?;
        if let Some(earlier) = &input.provenance {
            story(f, earlier, depth + 1)?;
        }
    }
    Ok(())
}

/// Longest parameter shown whole; `--json` shows all.
const MAX_PARAMETER_CHARS: usize = 160;
