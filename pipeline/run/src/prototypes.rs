//! Plant models served from a folder, one file a representative.

use crate::error::{Error, Result};
use crate::make::plant_file;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use std::sync::Arc;
use weald_contract::{Instances, Palette, PlantModel, Problem};
use weald_render::{Object, PrototypeSource};

/// Reads `FOLDER/ID.glb` when the renderer asks for it.
#[derive(Clone, Copy, Debug)]
pub struct FolderPrototypes<'a> {
    /// The folder that `weald plants` wrote.
    pub folder: &'a Path,
}

impl PrototypeSource for FolderPrototypes<'_> {
    fn model(&self, prototype: u32) -> std::result::Result<Arc<PlantModel>, Problem> {
        let path = self.folder.join(plant_file(prototype));
        let model = weald_formats::read_plant(&path).map_err(|error| {
            Problem::new(error.to_string()).hint("`weald plants` makes the models of a palette")
        })?;
        Ok(Arc::new(model))
    }
}

/// All models that a scene places, read beforehand, so that what they will take can be told.
pub struct HeldPrototypes {
    models: BTreeMap<u32, Arc<PlantModel>>,
}

impl HeldPrototypes {
    /// Reads the models of the palette that the instances place.
    ///
    /// # Errors
    /// A model is missing or damaged.
    pub fn read(folder: &Path, palette: &Palette, instances: &Instances) -> Result<Self> {
        let placed: BTreeSet<u32> = instances.prototype.iter().copied().collect();
        let ids: Vec<u32> = palette.representatives.iter().map(|plant| plant.id).collect();
        let source = FolderPrototypes { folder };
        let models = ids
            .into_par_iter()
            .filter(|id| placed.contains(id))
            .map(|id| Ok((id, source.model(id)?)))
            .collect::<std::result::Result<_, Problem>>()
            .map_err(|problem| Error::plain(problem.message, problem.hint.unwrap_or_default()))?;
        Ok(Self { models })
    }

    /// Memory that a scene of these models, where they are placed, objects and a terrain of so many
    /// cells will take, bytes.
    pub fn bytes(&self, instances: &Instances, objects: &[Object], cells: u64) -> u64 {
        let models = self.models.iter();
        let triangles = models.map(|(&id, model)| (id, model.instanced_triangles())).collect();
        let objects: u64 = objects.iter().map(|object| object.model.instanced_triangles()).sum();
        // Models of a species hold the same textures, which the scene keeps once.
        let textures = self.models.values().flat_map(|model| &model.textures);
        let different: BTreeSet<(&str, usize)> =
            textures.map(|texture| (texture.name.as_str(), texture.texels.len())).collect();
        let texels: usize = different.into_iter().map(|(_, texels)| texels).sum();
        // With their smaller copies a third more.
        let textures = 6 * texels as u64;
        weald_render::estimate_bytes(&triangles, instances, objects + 2 * cells) + textures
    }
}

impl PrototypeSource for HeldPrototypes {
    fn model(&self, prototype: u32) -> std::result::Result<Arc<PlantModel>, Problem> {
        let missing = || Problem::new(format!("no model of prototype {prototype}"));
        self.models.get(&prototype).cloned().ok_or_else(missing)
    }
}
