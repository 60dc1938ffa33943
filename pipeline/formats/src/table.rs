//! Tables of named columns: ours (summaries, deaths) and anyone's.
//!
//! A file's name decides between Parquet and CSV. What does not fit in CSV, provenance and
//! reference system, stands beside it in `NAME.csv.json`.

use crate::bytes::ending;
use crate::error::{Error, Result};
use crate::provenance::Provenance;
use crate::{csv_table, geojson, geopackage, parquet_table};
use serde_json::Value as Json;
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;

/// Most rows that are read, 2²⁷: ten times the largest stand we plan for.
pub const MAX_ROWS: usize = 1 << 27;

/// A table of named columns of equal length.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Table {
    /// Name and values of each column, in the order of the file.
    pub columns: Vec<(String, Column)>,
}

/// One column.
#[derive(Clone, Debug, PartialEq)]
pub enum Column {
    /// 64-bit numbers with a fraction; NaN where a value is missing.
    Float(Vec<f64>),
    /// 32-bit numbers with a fraction; NaN where a value is missing.
    Float32(Vec<f32>),
    /// Whole numbers.
    Integer(Vec<i64>),
    /// Whole numbers that are never negative, such as ids.
    Unsigned(Vec<u64>),
    /// Texts, empty where a value is missing; equal ones may share memory.
    Text(Vec<Arc<str>>),
}

impl Column {
    /// Number of rows.
    pub fn len(&self) -> usize {
        match self {
            Self::Float(values) => values.len(),
            Self::Float32(values) => values.len(),
            Self::Integer(values) => values.len(),
            Self::Unsigned(values) => values.len(),
            Self::Text(values) => values.len(),
        }
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// A column of texts.
    pub fn text<T: AsRef<str>>(texts: impl IntoIterator<Item = T>) -> Self {
        Self::Text(texts.into_iter().map(|text| Arc::from(text.as_ref())).collect())
    }

    /// The values as numbers; `None` for a column of texts.
    pub fn numbers(&self) -> Option<Vec<f64>> {
        match self {
            Self::Float(values) => Some(values.clone()),
            Self::Float32(values) => Some(values.iter().map(|&value| f64::from(value)).collect()),
            Self::Integer(values) => Some(values.iter().map(|&value| value as f64).collect()),
            Self::Unsigned(values) => Some(values.iter().map(|&value| value as f64).collect()),
            Self::Text(_) => None,
        }
    }

    /// The values as texts; `None` for a column of numbers.
    pub fn texts(&self) -> Option<&[Arc<str>]> {
        match self {
            Self::Text(values) => Some(values),
            _ => None,
        }
    }
}

impl Table {
    /// Adds a column at the end.
    pub fn with(mut self, name: &str, column: Column) -> Self {
        self.columns.push((name.into(), column));
        self
    }

    /// The column with this name.
    pub fn column(&self, name: &str) -> Option<&Column> {
        self.columns.iter().find(|(found, _)| found == name).map(|(_, column)| column)
    }

    /// Removes and returns the column with this name.
    pub fn take(&mut self, name: &str) -> Option<Column> {
        let index = self.columns.iter().position(|(found, _)| found == name)?;
        Some(self.columns.remove(index).1)
    }

    /// Number of rows.
    pub fn rows(&self) -> usize {
        self.columns.first().map_or(0, |(_, column)| column.len())
    }

    /// Complains of columns that differ in length or share a name.
    pub(crate) fn check(&self, path: &Path) -> Result<()> {
        let mut names: Vec<&str> = self.columns.iter().map(|(name, _)| name.as_str()).collect();
        names.sort_unstable();
        if let Some([name, _]) = names.array_windows().find(|[a, b]| a == b) {
            return Err(Error::invalid(path, format!("two columns are called `{name}`"), ""));
        }
        let rows = self.rows();
        match self.columns.iter().find(|(_, column)| column.len() != rows) {
            None => Ok(()),
            Some((name, column)) => {
                let message = format!("column `{name}` has {} rows", column.len());
                Err(Error::invalid(path, message, format!("the first column has {rows}")))
            }
        }
    }
}

/// What a table's file says beside its rows, by key: `weald` is the provenance.
pub(crate) type Metadata = BTreeMap<String, Json>;

/// Key of the provenance in Parquet's metadata and in a CSV's companion.
pub(crate) const PROVENANCE_KEY: &str = "weald";

pub(crate) fn metadata_with(provenance: &Provenance) -> Metadata {
    // A provenance is strings, numbers and JSON: it always converts.
    let value = serde_json::to_value(provenance).unwrap_or_default();
    Metadata::from([(PROVENANCE_KEY.to_string(), value)])
}

fn provenance_in(metadata: &Metadata) -> Option<Provenance> {
    serde_json::from_value(metadata.get(PROVENANCE_KEY)?.clone()).ok()
}

/// The kinds of tables. The last two are maps of other programs, which are read only.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum TableKind {
    Parquet,
    Csv,
    GeoJson,
    GeoPackage,
}

/// The kind that a file's name asks for.
pub(crate) fn kind_of(path: &Path) -> Result<TableKind> {
    match ending(path).as_str() {
        "parquet" | "geoparquet" => Ok(TableKind::Parquet),
        "csv" => Ok(TableKind::Csv),
        "geojson" => Ok(TableKind::GeoJson),
        "gpkg" => Ok(TableKind::GeoPackage),
        other => {
            let message = format!("a table that ends in `.{other}`");
            let hint = "`.parquet` and `.csv` are, and to read `.geojson` and `.gpkg`";
            Err(Error::unsupported(path, message, hint))
        }
    }
}

/// Complains of writing what is read only.
pub(crate) fn read_only(path: &Path) -> Error {
    let message = format!("writing a table that ends in `.{}`", ending(path));
    Error::unsupported(path, message, "`.parquet` and `.csv` are, which QGIS opens too")
}

/// Writes a table as Parquet or CSV, by the name's ending.
///
/// # Errors
/// When columns differ in length or share a name, or the disk refuses.
pub fn write_table(path: &Path, table: &Table, provenance: &Provenance) -> Result<()> {
    table.check(path)?;
    let metadata = metadata_with(provenance);
    match kind_of(path)? {
        TableKind::Parquet => parquet_table::write(path, table, None, &metadata),
        TableKind::Csv => csv_table::write(path, table, &metadata),
        TableKind::GeoJson | TableKind::GeoPackage => Err(read_only(path)),
    }
}

/// Reads a table, ours or anyone's. In a CSV the values decide what a column holds.
///
/// Nested columns, dates and raw bytes of a Parquet file are left out.
///
/// # Errors
/// When the file is missing, damaged or of another kind.
pub fn read_table(path: &Path) -> Result<Table> {
    match kind_of(path)? {
        TableKind::Parquet => Ok(parquet_table::read(path)?.0),
        TableKind::Csv => csv_table::read(path, |_| csv_table::Want::Guess),
        TableKind::GeoJson => Ok(geojson::read(path)?.0),
        TableKind::GeoPackage => Ok(geopackage::read(path)?.0),
    }
}

pub(crate) fn parquet_provenance(path: &Path) -> Result<Option<Provenance>> {
    Ok(provenance_in(&parquet_table::read_metadata(path)?))
}

pub(crate) fn csv_provenance(path: &Path) -> Result<Option<Provenance>> {
    std::fs::metadata(path).map_err(Error::io("open", path))?;
    Ok(provenance_in(&csv_table::read_metadata(path)?))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;

    fn sample() -> Table {
        Table::default()
            .with("year", Column::Integer(vec![-1, 0, i64::MAX]))
            .with("id", Column::Unsigned(vec![0, 7, u64::MAX]))
            .with("height", Column::Float32(vec![0.1, f32::MIN_POSITIVE, 3.5]))
            .with("x", Column::Float(vec![481_000.123_456_789, -0.0, f64::MAX]))
            .with("species", Column::text(["aspen", "a, \"quoted\" ümlaut", ""]))
    }

    #[test]
    fn a_table_comes_back_from_parquet_with_its_types() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.parquet");
        write_table(&path, &sample(), &story()).unwrap();
        assert_eq!(read_table(&path).unwrap(), sample());
        assert_eq!(parquet_provenance(&path).unwrap(), Some(story()));
    }

    #[test]
    fn row_groups_hold_the_rows_that_the_whole_table_holds() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.parquet");
        let numbers: Vec<i64> = (0..300_000).collect();
        let table = Table::default()
            .with("a", Column::Integer(numbers.clone()))
            .with("b", Column::Float(numbers.iter().map(|n| *n as f64 / 3.0).collect()));
        write_table(&path, &table, &story()).unwrap();
        let groups = crate::RowGroups::open(&path).unwrap();
        assert_eq!((groups.len(), groups.rows()), (3, 300_000));
        let mut found = Vec::new();
        for group in 0..groups.len() {
            assert_eq!(groups.first_row(group), found.len() as u64);
            let table = groups.read(group, &|name| name == "b").unwrap();
            assert_eq!(table.columns.len(), 1);
            found.extend(table.column("b").and_then(Column::numbers).unwrap());
        }
        assert_eq!(Some(found), table.column("b").and_then(Column::numbers));
        assert!(groups.read(3, &|_| true).unwrap_err().to_string().contains("row group 3"));
    }

    #[test]
    fn a_table_comes_back_from_csv_with_its_values() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("table.csv");
        write_table(&path, &sample(), &story()).unwrap();
        let back = read_table(&path).unwrap();
        assert_eq!(back.column("year"), sample().column("year"));
        assert_eq!(back.column("x"), sample().column("x"));
        assert_eq!(back.column("species"), sample().column("species"));
        assert_eq!(csv_provenance(&path).unwrap(), Some(story()));
    }

    #[test]
    fn an_empty_table_keeps_its_columns() {
        let folder = tempfile::tempdir().unwrap();
        let empty = Table::default().with("a", Column::Float(Vec::new()));
        for name in ["t.parquet", "t.csv"] {
            let path = folder.path().join(name);
            write_table(&path, &empty, &story()).unwrap();
            let back = read_table(&path).unwrap();
            assert_eq!((back.rows(), back.columns.len()), (0, 1), "{name}");
        }
    }

    #[test]
    fn unequal_columns_and_twins_are_refused_before_writing() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("t.csv");
        let column = |n| Column::Integer(vec![0; n]);
        let unequal = Table::default().with("a", column(1)).with("b", column(2));
        assert!(write_table(&path, &unequal, &story()).unwrap_err().to_string().contains("`b`"));
        let twins = Table::default().with("a", column(1)).with("a", column(1));
        assert!(write_table(&path, &twins, &story()).is_err());
        assert!(!path.exists());
    }
}
