//! Palettes.
use crate::{Error, Provenance, Result};
use std::path::Path;
use weald_contract::Palette;
/// Writes.
pub fn write_palette(path: &Path, _: &Palette, _: &Provenance) -> Result<()> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads.
pub fn read_palette(path: &Path) -> Result<Palette> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads.
pub fn parse_palette(path: &Path, _: &str) -> Result<Palette> {
    Err(Error::unsupported(path, "not built yet", ""))
}
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    Err(Error::unsupported(path, "not built yet", ""))
}
