//! Plants: a model for every representative of a palette.

use super::twigs::SharedTwigs;
use super::{Made, make_folder, organs, parent, stage_seed};
use crate::error::{Error, Result};
use crate::instancing::Instancing;
use crate::parameters::canonical;
use crate::preview;
use crate::recipe::Stage;
use crate::scene::{Scene, SceneSpecies};
use rayon::prelude::*;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use weald_contract::{Instances, PlantModel, Progress, Representative, Seed, Sources};
use weald_formats::Provenance;
use weald_plants::detail::Detail;
use weald_plants::irregular::Report;
use weald_plants::{Conditions, Form, Skeleton, Stature, look};

/// File name of a representative's model, the full one or one of its coarser levels from 1 on.
pub fn plant_file(id: u32, level: u32) -> String {
    match level {
        0 => format!("{id:04}.glb"),
        _ => format!("{id:04}-{level}.glb"),
    }
}

/// Whether a species has coarser levels: somebody's model has not.
pub fn has_levels(found: &SceneSpecies) -> bool {
    !matches!(found.form, None | Some(Form::Model(_)))
}

/// Plants: a model for every representative of a palette.
///
/// # Errors
/// The palette is damaged, a species cannot be grown, or the disk refuses.
pub fn plants(
    scene: &Scene,
    palette: &Path,
    folder: &Path,
    provenance: Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    Growing::of(scene).make(palette, folder, provenance, progress)
}

/// What plants needs besides the palette; a scene provides it, or the command line alone.
pub struct Growing<'a> {
    /// Every species of the palette.
    pub species: &'a BTreeMap<String, SceneSpecies>,
    /// Season, textures and the like.
    pub conditions: &'a Conditions,
    /// Seed of the stage.
    pub seed: Seed,
    /// Texts for problems.
    pub sources: &'a Sources,
}

impl<'a> Growing<'a> {
    /// As a scene provides it.
    pub fn of(scene: &'a Scene) -> Self {
        Self {
            species: &scene.species,
            conditions: &scene.plants,
            seed: stage_seed(scene, Stage::Plants),
            sources: &scene.sources,
        }
    }

    /// Writes `ID.glb` for each representative into `folder`, and a contact sheet beside it.
    ///
    /// # Errors
    /// The palette is damaged, a species cannot be grown, or the disk refuses.
    pub fn make(
        &self,
        palette_file: &Path,
        folder: &Path,
        mut provenance: Provenance,
        progress: &dyn Progress,
    ) -> Result<Made> {
        provenance.inputs.push(parent(palette_file)?);
        let palette = weald_formats::read_palette(palette_file)?;
        make_folder(folder)?;
        let representatives = &palette.representatives;
        let twigs = SharedTwigs::of(self, &palette, progress)?;
        let mut models = self.grow_all(representatives, &twigs, progress)?;
        let organs = organs::share(self, representatives, &mut models)?;
        progress.begin("writing models", representatives.len() as u64, "plants");
        representatives.par_iter().zip(&models).try_for_each(|(plant, model)| {
            self.write(plant, model, folder, &provenance)?;
            progress.advance(1);
            Ok::<(), Error>(())
        })?;

        let files = representatives.iter().flat_map(|plant| {
            let levels = 0..=self.levels_of(plant).len() as u32;
            levels.map(|level| folder.join(plant_file(plant.id, level)))
        });
        let files = files.collect();
        let unique: u64 = models.iter().map(PlantModel::unique_triangles).sum();
        let instanced: u64 = models.iter().map(PlantModel::instanced_triangles).sum();
        let mut report = json!({
            "models": models.len(), "triangles": unique, "instanced_triangles": instanced,
        });
        if self.conditions.shared_twigs.is_some() {
            report["twigs"] = json!(twigs.reports());
        }
        if self.conditions.shared_organs.is_some() {
            report["organs"] = json!(organs);
        }
        let mut words = String::new();
        if let Some(instances) = beside(palette_file)? {
            let models: Vec<&PlantModel> = models.iter().collect();
            let instancing = Instancing::of(&palette, &instances, &models);
            words = instancing.to_string();
            report["instancing"] = json!(instancing);
        }
        let mut made = Made { files, report, words };
        let sheet: Vec<_> = representatives.iter().map(caption).zip(&models).collect();
        let sheet = preview::contact_sheet(&sheet, SHEET_CELL);
        made.preview(&folder.with_extension("png"), &sheet, &provenance)?;
        Ok(made)
    }

    fn grow_all(
        &self,
        representatives: &[Representative],
        twigs: &SharedTwigs,
        progress: &dyn Progress,
    ) -> Result<Vec<PlantModel>> {
        progress.begin("growing plants", representatives.len() as u64, "plants");
        let grown = representatives.par_iter().map(|plant| {
            if progress.is_cancelled() {
                return Err(Error::Stopped { saved: false });
            }
            let model = self.grow(plant, twigs)?;
            progress.advance(1);
            Ok(model)
        });
        grown.collect()
    }

    /// Writes a model and its coarser levels.
    fn write(
        &self,
        plant: &Representative,
        model: &PlantModel,
        folder: &Path,
        stage: &Provenance,
    ) -> Result<()> {
        // A model's story is its own: other species of the scene do not change its bytes.
        let mut story = plant_provenance(stage, plant);
        let shared = [
            ("shared_twigs", self.conditions.shared_twigs),
            ("shared_organs", self.conditions.shared_organs),
        ];
        for (name, count) in shared {
            if let Some(count) = count {
                story.parameters[name] = json!(count);
            }
        }
        weald_formats::write_plant(&folder.join(plant_file(plant.id, 0)), model, &story)?;
        self.write_levels(plant, folder, &story)
    }

    /// Sizes of a pixel for which a representative has models besides the full one, m.
    fn levels_of(&self, plant: &Representative) -> &[f32] {
        let found = self.species.get(&plant.species).filter(|found| has_levels(found));
        found.map_or(&[], |_| &self.conditions.levels)
    }

    /// Writes the coarser models of a representative.
    fn write_levels(
        &self,
        plant: &Representative,
        folder: &Path,
        story: &Provenance,
    ) -> Result<()> {
        let Self { species, conditions, seed, sources } = *self;
        for (pixel, level) in self.levels_of(plant).iter().zip(1..) {
            let detail = Detail::for_pixel(*pixel);
            let found = &species[&plant.species];
            let model = grow_coarse(sources, found, plant, conditions, &detail, seed)?;
            let mut story = story.clone();
            story.parameters["pixel"] = canonical(pixel);
            weald_formats::write_plant(&folder.join(plant_file(plant.id, level)), &model, &story)?;
        }
        Ok(())
    }

    /// Grows one representative, with the twigs that its species shares.
    pub(crate) fn grow(&self, plant: &Representative, twigs: &SharedTwigs) -> Result<PlantModel> {
        let found = self.found(plant)?;
        let Self { conditions, seed, sources, .. } = *self;
        if !twigs.has(plant) {
            return grow_one(sources, found, plant, conditions, seed);
        }
        let skeleton = twigs.shared(plant, &self.dressed(plant)?);
        Ok(look::level(&name(plant), &skeleton, &found.look, conditions, &Detail::FULL))
    }

    /// The skeleton of a representative, with all that it bears.
    pub(super) fn dressed(&self, plant: &Representative) -> Result<Skeleton> {
        dressed(self.sources, self.found(plant)?, plant, self.conditions, self.seed)
    }

    fn found(&self, plant: &Representative) -> Result<&SceneSpecies> {
        let found = self.species.get(&plant.species);
        found.filter(|found| found.form.is_some()).ok_or_else(|| {
            Error::plain(
                format!(
                    "no `[form]` for representative {} of species `{}`",
                    plant.id, plant.species
                ),
                "add a `[form]` to the species' file: it says how the plant is grown",
            )
        })
    }
}

/// The instances that quantize wrote beside a palette; a palette may stand alone.
fn beside(palette: &Path) -> Result<Option<Instances>> {
    let path = palette.with_file_name("instances.parquet");
    if !path.is_file() {
        return Ok(None);
    }
    Ok(Some(weald_formats::read_instances(&path)?))
}

/// Side of a model's cell on the contact sheet, pixels.
const SHEET_CELL: usize = 200;

fn caption(plant: &Representative) -> String {
    format!("{} {} {:.1} m", plant.id, plant.species, plant.height)
}

fn plant_provenance(stage: &Provenance, plant: &Representative) -> Provenance {
    let species = stage.parameters["species"].get(&plant.species).cloned();
    let parameters = json!({
        "species": species, "name": plant.species,
        "age": canonical(&plant.age), "vigor": canonical(&plant.vigor),
        "height": canonical(&plant.height), "radius": canonical(&plant.radius),
    });
    Provenance { parameters, ..stage.clone() }
}

/// Grows one plant; its chance hangs on its id, so that a palette may be grown in any order.
///
/// # Errors
/// The form or size cannot be grown, or the species' model cannot be read.
pub fn grow_one(
    sources: &Sources,
    found: &SceneSpecies,
    plant: &Representative,
    conditions: &Conditions,
    seed: Seed,
) -> Result<PlantModel> {
    if let Some(Form::Model(form)) = &found.form {
        let model = weald_formats::read_model(&model_file(found, form))?;
        let stature =
            Stature::new(&found.species.size, plant).map_err(|error| told(sources, error))?;
        return Ok(PlantModel { name: name(plant), ..form.fit(model, &stature) });
    }
    grow_coarse(sources, found, plant, conditions, &Detail::FULL, seed)
}

/// Grows one plant with so much detail.
///
/// # Errors
/// The form or size cannot be grown.
pub fn grow_coarse(
    sources: &Sources,
    found: &SceneSpecies,
    plant: &Representative,
    conditions: &Conditions,
    detail: &Detail,
    seed: Seed,
) -> Result<PlantModel> {
    let skeleton = dressed(sources, found, plant, conditions, seed)?;
    Ok(look::level(&name(plant), &skeleton, &found.look, conditions, detail))
}

fn name(plant: &Representative) -> String {
    format!("{}-{}", plant.species, plant.id)
}

/// The skeleton of a plant with all that it bears.
fn dressed(
    sources: &Sources,
    found: &SceneSpecies,
    plant: &Representative,
    conditions: &Conditions,
    seed: Seed,
) -> Result<Skeleton> {
    let mut skeleton = skeleton_of(sources, found, plant, seed)?;
    let maturity = (plant.height / found.species.size.height).clamp(0.0, 1.0);
    look::dress(&mut skeleton, &found.look, conditions, maturity, own_seed(plant, seed));
    Ok(skeleton)
}

/// The bare skeleton of a plant that [`grow_one`] would grow.
///
/// # Errors
/// The form or size cannot be grown.
pub fn skeleton_of(
    sources: &Sources,
    found: &SceneSpecies,
    plant: &Representative,
    seed: Seed,
) -> Result<Skeleton> {
    let Some(form) = &found.form else {
        return Err(Error::plain(format!("species `{}` has no `[form]`", plant.species), ""));
    };
    let seed = own_seed(plant, seed);
    weald_plants::skeleton(form, &found.species.size, plant, seed)
        .map_err(|error| told(sources, error))
}

/// How the paths of an irregular tree were found; `None` of other plants.
pub fn paths_of(found: &SceneSpecies, plant: &Representative, seed: Seed) -> Option<Report> {
    let Some(Form::Irregular(form)) = &found.form else { return None };
    let stature = Stature::new(&found.species.size, plant).ok()?;
    form.report(&stature, own_seed(plant, seed)).ok()
}

fn own_seed(plant: &Representative, seed: Seed) -> Seed {
    seed.part(&plant.species, u64::from(plant.id))
}

/// Path of the model that a species is made of: relative to the species' own file.
pub fn model_file(found: &SceneSpecies, form: &weald_plants::ModelFile) -> PathBuf {
    Path::new(&found.origin).parent().unwrap_or(Path::new("")).join(&form.file.value)
}

fn told(sources: &Sources, error: weald_plants::Error) -> Error {
    match error {
        weald_plants::Error::Problem(problem) => Error::wrong(sources, problem),
        other => Error::Stage { stage: Stage::Plants.word(), message: other.to_string() },
    }
}
