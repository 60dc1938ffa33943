//! Plants of one species, asked for by age and vigor: `weald plants SPECIES`.

use crate::alone::story;
use crate::error::{Error, Result};
use crate::files;
use crate::make::{self, Made, grow_one, skeleton_of};
use crate::parameters::canonical;
use crate::portrait;
use crate::preview::{self, Sketch};
use crate::recipe::Stage;
use crate::scene::{self, SceneSpecies, load_species};
use rayon::prelude::*;
use serde_json::json;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use weald_contract::{PlantModel, Progress, Representative, Seed, Sources};
use weald_plants::Form;
use weald_plants::detail::Detail;

pub use weald_plants::Conditions;

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Age, years.
    pub age: f32,
    /// Vigor in [0, 1].
    pub vigor: f32,
    /// Root of all chance.
    pub seed: u64,
    /// How many plants, each by a chance of its own.
    pub count: u32,
    /// What changes evenly from the first plant to the last.
    pub vary: Vec<Vary>,
    /// Whether all of them are one plant, at other ages or vigors.
    pub same: bool,
    /// Season, textures and the like.
    pub conditions: Conditions,
    /// How many metres a pixel covers for which detail is kept; 0 keeps all.
    pub pixel: f32,
    /// Whether the picture shows the branches as black cones on white.
    pub schematic: bool,
    /// Light paths a pixel of the portrait; 0 draws it without light and shadow, at once.
    pub samples: u32,
    /// Side of the portrait, pixels.
    pub side: u32,
}

/// What a number of plants may differ in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Varied {
    /// Age, years.
    Age,
    /// Vigor.
    Vigor,
    /// Day of the year.
    Day,
}

/// A range that the plants are spread over: `age=10..80`.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Vary {
    /// What.
    pub what: Varied,
    /// From the first plant to the last.
    pub range: [f32; 2],
}

impl FromStr for Vary {
    type Err = String;

    fn from_str(text: &str) -> std::result::Result<Self, String> {
        let wrong =
            || format!("`{text}` is no range: write age=10..80, vigor=0.2..1 or day=90..330");
        let (name, range) = text.split_once('=').ok_or_else(wrong)?;
        let what = match name.trim() {
            "age" => Varied::Age,
            "vigor" => Varied::Vigor,
            "day" => Varied::Day,
            _ => return Err(wrong()),
        };
        let (from, to) = range.split_once("..").ok_or_else(wrong)?;
        let number = |text: &str| text.trim().parse::<f32>().map_err(|_| wrong());
        Ok(Self { what, range: [number(from)?, number(to)?] })
    }
}

/// One plant of those asked for.
struct Individual {
    plant: Representative,
    conditions: Conditions,
}

impl Wanted {
    /// Complains of what no plant has.
    fn check(&self) -> Result<()> {
        let mut limits = vec![("--age", self.age), ("--vigor", self.vigor)];
        for Vary { what, range } in &self.vary {
            let flag = match what {
                Varied::Age => "--age",
                Varied::Vigor => "--vigor",
                Varied::Day => "--day",
            };
            limits.extend(range.map(|value| (flag, value)));
        }
        limits.extend(self.conditions.day.map(|day| ("--day", day)));
        limits.push(("--pixel", self.pixel));
        for (flag, value) in limits {
            let (least, most) = match flag {
                "--age" => (0.0, 10_000.0),
                "--day" => (1.0, 366.0),
                "--pixel" => (0.0, 100.0),
                _ => (0.0, 1.0),
            };
            if !(least..=most).contains(&value) {
                let allowed = format!("allowed: {least} to {most}");
                return Err(Error::plain(format!("{flag} is {value}"), allowed));
            }
        }
        Ok(())
    }

    fn individuals(&self, name: &str, found: &SceneSpecies) -> Vec<Individual> {
        (0..self.count.max(1)).map(|index| self.individual(name, found, index)).collect()
    }

    fn individual(&self, name: &str, found: &SceneSpecies, index: u32) -> Individual {
        let (mut age, mut vigor) = (self.age, self.vigor);
        let mut conditions = self.conditions.clone();
        // A single plant stands at the beginning of a range.
        let part = index as f32 / (self.count.max(2) - 1) as f32;
        for Vary { what, range: [from, to] } in &self.vary {
            let value = from + (to - from) * part;
            match what {
                Varied::Age => age = value,
                Varied::Vigor => vigor = value,
                Varied::Day => conditions.day = Some(value),
            }
        }
        let size = &found.species.size;
        let height = size.height_at(age, vigor);
        let plant = Representative {
            id: if self.same { 1 } else { index + 1 },
            species: name.into(),
            age,
            vigor,
            height,
            radius: size.radius_of_height(height),
            weight: 1.0,
            count: 1,
        };
        Individual { plant, conditions }
    }
}

/// `weald plants SPECIES --age 20 --vigor 0.8 -o PLANT.glb`: a species file, or a name that the
/// program knows. With several plants, `PLANT-01.glb` and so on, and one sheet of all.
///
/// # Errors
/// The species is nowhere or has mistakes, cannot be grown, or the disk refuses.
pub fn plants(
    species: &str,
    wanted: &Wanted,
    file: &Path,
    progress: &dyn Progress,
) -> Result<Made> {
    let is_picture = file.extension().is_some_and(|extension| extension == "png");
    if !is_picture {
        files::must_end(file, "glb")?;
    }
    wanted.check()?;
    let (sources, name, found) = species_given(species)?;
    has_form(&name, &found)?;
    let individuals = wanted.individuals(&name, &found);
    let seed = Seed(wanted.seed).part(Stage::Plants.word(), 0);
    progress.begin("growing plants", individuals.len() as u64, "plants");
    let models: Vec<PlantModel> = individuals
        .par_iter()
        .map(|individual| {
            if progress.is_cancelled() {
                return Err(Error::Stopped { saved: false });
            }
            let model = grown(&sources, &found, individual, wanted, seed)?;
            progress.advance(1);
            Ok(model)
        })
        .collect::<Result<_>>()?;
    make::make_folder_of(file)?;
    let mut made = Made::default();
    if !is_picture {
        let width = individuals.len().to_string().len();
        for (index, (individual, model)) in individuals.iter().zip(&models).enumerate() {
            let path = numbered(file, index, individuals.len(), width);
            let story = told(&found, individual, wanted.seed);
            weald_formats::write_plant(&path, model, &story)?;
            made.files.push(path);
        }
    }
    let sheet = picture(&individuals, &models, wanted, progress)?;
    let preview = file.with_extension("png");
    let story = told(&found, &individuals[0], wanted.seed);
    weald_formats::write_png(&preview, sheet.width, sheet.height, &sheet.rgb, &story)?;
    made.files.push(preview);
    let sum = |count: fn(&PlantModel) -> u64| models.iter().map(count).sum::<u64>();
    made.report = json!({
        "models": models.len(),
        "height": canonical(&individuals[0].plant.height),
        "triangles": sum(PlantModel::unique_triangles),
        "instanced_triangles": sum(PlantModel::instanced_triangles),
    });
    if let [Individual { plant, .. }] = individuals.as_slice() {
        tell_paths(&mut made, make::paths_of(&found, plant, seed));
    }
    Ok(made)
}

/// Tells how the paths of an irregular tree were found.
fn tell_paths(made: &mut Made, report: Option<weald_plants::irregular::Report>) {
    let Some(report) = report else { return };
    let endpoints = report.endpoints_in_all();
    made.report["paths"] = json!({
        "graphs": report.graphs,
        "nodes": report.nodes,
        "edges": report.edges,
        "endpoints": report.endpoints,
        "redrawn": report.redrawn,
        "lost": report.lost,
    });
    made.words = format!(
        "paths to {endpoints} endpoints through {} graphs of {} nodes and {} edges",
        report.graphs, report.nodes, report.edges
    );
    if report.redrawn > 0 {
        made.words += &format!("\n{} endpoints out of reach were drawn again", report.redrawn);
    }
    if report.lost > 0 {
        made.words += &format!("\n{} endpoints found no place", report.lost);
    }
}

/// A group has no form of its own.
fn has_form(name: &str, found: &SceneSpecies) -> Result<()> {
    if found.form.is_some() {
        return Ok(());
    }
    let members = found.species.group.iter().flat_map(|group| &group.member);
    let members: Vec<&str> = members.map(|member| member.species.value.as_str()).collect();
    Err(Error::plain(
        format!("`{name}` is a patch of other plants and has no form of its own"),
        format!("grow one of its members: {}", members.join(", ")),
    ))
}

fn grown(
    sources: &Sources,
    found: &SceneSpecies,
    individual: &Individual,
    wanted: &Wanted,
    seed: Seed,
) -> Result<PlantModel> {
    let Individual { plant, conditions } = individual;
    let is_file = matches!(found.form, Some(Form::Model(_)));
    if wanted.pixel <= 0.0 || is_file {
        return grow_one(sources, found, plant, conditions, seed);
    }
    make::grow_coarse(sources, found, plant, conditions, &Detail::for_pixel(wanted.pixel), seed)
}

/// File of plant `index` of `count`: the name itself for a single one.
fn numbered(file: &Path, index: usize, count: usize, width: usize) -> PathBuf {
    if count == 1 {
        return file.to_path_buf();
    }
    let stem = file.file_stem().unwrap_or_default().to_string_lossy();
    file.with_file_name(format!("{stem}-{:0width$}.glb", index + 1))
}

fn told(found: &SceneSpecies, individual: &Individual, seed: u64) -> weald_formats::Provenance {
    let Individual { plant, conditions } = individual;
    let parameters = json!({
        "species": {
            "size": canonical(&found.species.size),
            "form": canonical(&found.form),
            "look": canonical(&found.look),
        },
        "plants": canonical(conditions),
        "age": canonical(&plant.age), "vigor": canonical(&plant.vigor), "number": plant.id,
    });
    story(Stage::Plants, parameters, seed)
}

/// The picture that goes beside the models.
fn picture(
    individuals: &[Individual],
    models: &[PlantModel],
    wanted: &Wanted,
    progress: &dyn Progress,
) -> Result<Sketch> {
    if let ([model], false, 1..) = (models, wanted.schematic, wanted.samples) {
        return portrait::portrait(model, wanted.side, wanted.samples, progress);
    }
    let captions = individuals.iter().map(|individual| caption(individual, wanted));
    let named: Vec<(String, &PlantModel)> = captions.zip(models).collect();
    let side = if models.len() == 1 { wanted.side as usize } else { CELL };
    Ok(match wanted.schematic {
        true => preview::schematic_sheet(&named, side),
        false => preview::contact_sheet(&named, side),
    })
}

/// Side of a plant's cell where there are several, pixels.
const CELL: usize = 240;

fn caption(individual: &Individual, wanted: &Wanted) -> String {
    let Individual { plant, conditions } = individual;
    let mut caption = format!("{} {:.0} years", plant.species, plant.age);
    if wanted.vary.iter().any(|vary| vary.what == Varied::Vigor) {
        caption = format!("{caption} vigor {:.2}", plant.vigor);
    }
    match conditions.day {
        Some(day) => format!("{caption} day {day:.0}"),
        None => caption,
    }
}

/// A species by file or by name.
///
/// # Errors
/// It is nowhere or has mistakes.
pub fn species_given(given: &str) -> Result<(Sources, String, SceneSpecies)> {
    let path = Path::new(given);
    let extension = path.extension().and_then(|extension| extension.to_str());
    let is_name = !given.ends_with(".toml") && !path.exists();
    if is_name {
        let (sources, mut species) = load_species(Path::new(""), [given.to_string()])?;
        let found = species.remove(given);
        let found =
            found.ok_or_else(|| Error::plain(format!("no species `{given}`"), "give a file"))?;
        return Ok((sources, given.into(), found));
    }
    if let Some("glb" | "obj") = extension {
        let hint = "write a species file with `[form] generator = \"model\"` and `file = ...`";
        return Err(Error::plain(format!("{given} is a model, not a species"), hint));
    }
    let mut sources = Sources::default();
    let mut problems = Vec::new();
    let text = scene::read_text(path)?;
    let found = scene::read_species(given, &text, &mut sources, &mut problems);
    if let Some(found) = &found {
        problems.extend(found.form.iter().flat_map(Form::check));
        problems.extend(found.look.check());
    }
    match found {
        Some(found) if problems.is_empty() => {
            let name = path.file_stem().unwrap_or_default().to_string_lossy().into_owned();
            Ok((sources, name, found))
        }
        _ => Err(Error::Wrong { sources: sources.into(), problems }),
    }
}

/// The skeleton of a species at an age and vigor.
///
/// # Errors
/// The form cannot be grown.
pub(crate) fn skeleton_at(
    sources: &Sources,
    name: &str,
    found: &SceneSpecies,
    [age, vigor]: [f32; 2],
    seed: Seed,
) -> Result<weald_plants::Skeleton> {
    let height = found.species.size.height_at(age, vigor);
    let plant = Representative {
        id: 1,
        species: name.into(),
        age,
        vigor,
        height,
        radius: found.species.size.radius_of_height(height),
        weight: 1.0,
        count: 1,
    };
    skeleton_of(sources, found, &plant, seed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_read_and_others_told_what_they_look_like() {
        let age = Vary { what: Varied::Age, range: [10.0, 80.0] };
        assert_eq!("age=10..80".parse(), Ok(age));
        assert_eq!("day = 90 .. 330".parse::<Vary>().unwrap().what, Varied::Day);
        for wrong in ["age", "age=10", "size=1..2", "age=a..b"] {
            assert!(wrong.parse::<Vary>().unwrap_err().contains("age=10..80"));
        }
    }

    #[test]
    fn several_plants_are_numbered_and_one_is_not() {
        assert_eq!(numbered(Path::new("a/oak.glb"), 0, 1, 1), Path::new("a/oak.glb"));
        assert_eq!(numbered(Path::new("a/oak.glb"), 4, 20, 2), Path::new("a/oak-05.glb"));
    }
}
