//! Plant models served from a folder, one file a representative.

use crate::make::plant_file;
use std::path::Path;
use std::sync::Arc;
use weald_contract::{PlantModel, Problem};
use weald_render::PrototypeSource;

/// Reads `FOLDER/ID.glb` when the renderer asks for it.
#[derive(Clone, Copy, Debug)]
pub struct FolderPrototypes<'a> {
    /// The folder that `weald plants` wrote.
    pub folder: &'a Path,
}

impl PrototypeSource for FolderPrototypes<'_> {
    fn model(&self, prototype: u32) -> Result<Arc<PlantModel>, Problem> {
        let path = self.folder.join(plant_file(prototype));
        let model = weald_formats::read_plant(&path).map_err(|error| {
            Problem::new(error.to_string()).hint("`weald plants` makes the models of a palette")
        })?;
        Ok(Arc::new(model))
    }
}
