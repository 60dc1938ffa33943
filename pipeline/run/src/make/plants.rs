//! Plants: a model for every representative of a palette.

use super::{Made, make_folder, parent, stage_seed};
use crate::error::{Error, Result};
use crate::parameters::canonical;
use crate::preview;
use crate::recipe::Stage;
use crate::scene::{Scene, SceneSpecies};
use rayon::prelude::*;
use serde_json::json;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{PlantModel, Progress, Representative, Seed, Sources};
use weald_formats::Provenance;

/// File name of a representative's model.
pub fn plant_file(id: u32) -> String {
    format!("{id:04}.glb")
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
    let seed = stage_seed(scene, Stage::Plants);
    let growing = Growing { species: &scene.species, seed, sources: &scene.sources };
    growing.make(palette, folder, provenance, progress)
}

/// What plants needs besides the palette; a scene provides it, or the command line alone.
pub struct Growing<'a> {
    /// Every species of the palette.
    pub species: &'a BTreeMap<String, SceneSpecies>,
    /// Seed of the stage.
    pub seed: Seed,
    /// Texts for problems.
    pub sources: &'a Sources,
}

impl Growing<'_> {
    /// Writes `ID.glb` for each representative into `folder`, and a contact sheet beside it.
    ///
    /// # Errors
    /// The palette is damaged, a species cannot be grown, or the disk refuses.
    pub fn make(
        &self,
        palette: &Path,
        folder: &Path,
        mut provenance: Provenance,
        progress: &dyn Progress,
    ) -> Result<Made> {
        provenance.inputs.push(parent(palette)?);
        let palette = weald_formats::read_palette(palette)?;
        make_folder(folder)?;
        let representatives = &palette.representatives;
        progress.begin("growing plants", representatives.len() as u64, "plants");
        let grown: Vec<(String, PlantModel)> = representatives
            .par_iter()
            .map(|plant| {
                if progress.is_cancelled() {
                    return Err(Error::Stopped { saved: false });
                }
                let model = self.grow(plant)?;
                // A model's story is its own: other species of the scene do not change its bytes.
                let story = plant_provenance(&provenance, plant);
                weald_formats::write_plant(&folder.join(plant_file(plant.id)), &model, &story)?;
                progress.advance(1);
                Ok((caption(plant), model))
            })
            .collect::<Result<_>>()?;

        let files = representatives.iter().map(|plant| folder.join(plant_file(plant.id))).collect();
        let unique: u64 = grown.iter().map(|(_, model)| model.unique_triangles()).sum();
        let instanced: u64 = grown.iter().map(|(_, model)| model.instanced_triangles()).sum();
        let report = json!({
            "models": grown.len(), "triangles": unique, "instanced_triangles": instanced,
        });
        let mut made = Made { files, report, ..Made::default() };
        let sheet: Vec<_> = grown.iter().map(|(name, model)| (name.clone(), model)).collect();
        let sheet = preview::contact_sheet(&sheet, SHEET_CELL);
        made.preview(&folder.with_extension("png"), &sheet, &provenance)?;
        Ok(made)
    }

    /// Grows one representative.
    fn grow(&self, plant: &Representative) -> Result<PlantModel> {
        let found = self.species.get(&plant.species);
        match found.and_then(|found| Some((&found.species.size, found.form.as_ref()?))) {
            Some((size, form)) => grow_one(self.sources, form, size, plant, self.seed),
            None => Err(Error::plain(
                format!(
                    "no `[form]` for representative {} of species `{}`",
                    plant.id, plant.species
                ),
                "add a `[form]` to the species' file: it says how the plant is grown",
            )),
        }
    }
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
/// The form or size cannot be grown.
pub fn grow_one(
    sources: &Sources,
    form: &weald_plants::Form,
    size: &weald_contract::Size,
    plant: &Representative,
    seed: Seed,
) -> Result<PlantModel> {
    let name = format!("{}-{}", plant.species, plant.id);
    let seed = seed.part(&plant.species, u64::from(plant.id));
    weald_plants::grow(&name, form, size, plant, seed).map_err(|error| match error {
        weald_plants::Error::Problem(problem) => Error::wrong(sources, problem),
        other => Error::Stage { stage: Stage::Plants.word(), message: other.to_string() },
    })
}
