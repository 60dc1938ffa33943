//! Tables.
use crate::{Error, Provenance, Result};
use std::path::Path;

/// A table of named columns of equal length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Name and values of each column.
    pub columns: Vec<(String, Column)>,
}

/// One column.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// Numbers with a fraction; NaN where a value is missing.
    Float(Vec<f64>),
    /// 32-bit numbers with a fraction.
    Float32(Vec<f32>),
    /// Whole numbers.
    Integer(Vec<i64>),
    /// Texts.
    Text(Vec<String>),
}
/// Writes.
pub fn write_table(path: &Path, _: &Table, _: &Provenance) -> Result<()> {
    Err(Error::unsupported(path, "not built yet", ""))
}
/// Reads.
pub fn read_table(path: &Path) -> Result<Table> {
    Err(Error::unsupported(path, "not built yet", ""))
}
pub(crate) fn parquet_provenance(path: &Path) -> Result<Option<Provenance>> {
    Err(Error::unsupported(path, "not built yet", ""))
}
pub(crate) fn csv_provenance(path: &Path) -> Result<Option<Provenance>> {
    Err(Error::unsupported(path, "not built yet", ""))
}
