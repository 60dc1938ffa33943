//! Pictures.
use crate::{Error, Provenance, Result};
use std::path::Path;
use weald_contract::{Image, Picture};
/// Writes.
pub fn write_picture(path: &Path, _: &Picture, _: &Provenance) -> Result<()> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads.
pub fn read_picture(path: &Path) -> Result<Picture> {
    Err(Error::unsupported(path, "not built yet", ""))
}
pub(crate) fn read_image(path: &Path) -> Result<Image> {
    Err(Error::unsupported(path, "not built yet", ""))
}
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    Err(Error::unsupported(path, "not built yet", ""))
}
