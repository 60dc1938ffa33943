//! Plant models.
use crate::{Error, Provenance, Result};
use std::path::Path;
use weald_contract::PlantModel;
/// Writes.
pub fn write_plant(path: &Path, _: &PlantModel, _: &Provenance) -> Result<()> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads.
pub fn read_plant(path: &Path) -> Result<PlantModel> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Flattens.
pub fn flatten(model: &PlantModel) -> PlantModel {
    model.clone()
}
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    Err(Error::unsupported(path, "not built yet", ""))
}
