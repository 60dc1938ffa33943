//! Tables of plants.
use crate::{Error, Provenance, Result};
use std::path::Path;
use weald_contract::Population;
/// Writes plants.
pub fn write_population(path: &Path, _: &Population, _: &Provenance) -> Result<()> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads plants.
pub fn read_population(path: &Path) -> Result<Population> {
    Err(Error::unsupported(path, "not built yet", ""))
}
