//! Instances.
use crate::{Error, Provenance, Result};
use std::path::Path;
use weald_contract::{Instances, Palette, Problem};
/// Writes instances.
pub fn write_instances(path: &Path, _: &Instances, _: &Provenance) -> Result<()> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads instances.
pub fn read_instances(path: &Path) -> Result<Instances> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Checks.
pub fn check_instances(_: &Palette, _: &Instances) -> std::result::Result<(), Problem> {
    Ok(())
}
