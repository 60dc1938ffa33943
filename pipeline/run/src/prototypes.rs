//! Plant models served from a folder, one file a representative and level of detail.

use crate::error::{Error, Result};
use crate::make::{Growing, Leveled, SharedTwigs, plant_file};
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use weald_contract::{Instances, Palette, PlantModel, Problem, Progress};
use weald_render::{Object, PrototypeSource};

/// All models that a scene places, read beforehand, so that what they will take can be told.
pub struct HeldPrototypes {
    models: BTreeMap<u32, Arc<PlantModel>>,
}

impl HeldPrototypes {
    /// Reads the models of the palette that the instances place, from `FOLDER/ID.glb` and
    /// `FOLDER/ID-LEVEL.glb`.
    ///
    /// # Errors
    /// A model is missing or damaged.
    pub fn read(folder: &Path, leveled: &Leveled) -> Result<Self> {
        let placed: BTreeSet<u32> = leveled.instances.prototype.iter().copied().collect();
        let ids: Vec<u32> = leveled.palette.representatives.iter().map(|plant| plant.id).collect();
        let model = |id: u32| {
            let (plant, level) = leveled.origin(id);
            let path = folder.join(plant_file(plant, level));
            let model = weald_formats::read_plant(&path).map_err(|error| {
                Error::plain(error.to_string(), "`weald plants` makes the models of a palette")
            })?;
            Ok((id, Arc::new(model)))
        };
        let models = ids.into_par_iter().filter(|id| placed.contains(id)).map(model);
        Ok(Self { models: models.collect::<Result<_>>()? })
    }

    /// Grows a model for each representative of a palette.
    ///
    /// # Errors
    /// A species cannot be grown, or the caller asked to stop.
    pub fn grow(palette: &Palette, growing: &Growing<'_>, progress: &dyn Progress) -> Result<Self> {
        let twigs = SharedTwigs::of(growing, palette, progress)?;
        progress.begin("weighing models", palette.representatives.len() as u64, "plants");
        let models = palette.representatives.par_iter().map(|plant| {
            if progress.is_cancelled() {
                return Err(Error::Stopped { saved: false });
            }
            let model = growing.grow(plant, &twigs)?;
            progress.advance(1);
            Ok((plant.id, Arc::new(model)))
        });
        Ok(Self { models: models.collect::<Result<_>>()? })
    }

    /// One of the models, where there is one of that id.
    pub fn only(&self, id: u32) -> Self {
        let model = self.models.get(&id).map(|model| (id, Arc::clone(model)));
        Self { models: model.into_iter().collect() }
    }

    /// Memory that a scene of these models, where they are placed, objects and a terrain of so many
    /// cells will take, bytes.
    pub fn bytes(&self, instances: &Instances, objects: &[Object], cells: u64) -> u64 {
        let objects: u64 = objects.iter().map(|object| object.model.instanced_triangles()).sum();
        // Models of a species hold the same textures, which the scene keeps once.
        let textures = self.models.values().flat_map(|model| &model.textures);
        let different: BTreeSet<(&str, usize)> =
            textures.map(|texture| (texture.name.as_str(), texture.texels.len())).collect();
        let texels: usize = different.into_iter().map(|(_, texels)| texels).sum();
        // With their smaller copies a third more.
        let textures = 6 * texels as u64;
        weald_render::estimate_bytes(&self.models, instances, objects + 2 * cells) + textures
    }
}

impl PrototypeSource for HeldPrototypes {
    fn model(&self, prototype: u32) -> std::result::Result<Arc<PlantModel>, Problem> {
        let missing = || Problem::new(format!("no model of prototype {prototype}"));
        self.models.get(&prototype).cloned().ok_or_else(missing)
    }
}
