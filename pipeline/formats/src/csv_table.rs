//! Comma-separated values with a header, and the companion `NAME.csv.json`.

use crate::bytes::{MAX_FILE_BYTES, read_bounded, read_text, text};
use crate::error::{Error, Result};
use crate::table::{Column, MAX_ROWS, Metadata, Table};
use crate::whole::{AnyError, write_atomically};
use csv::StringRecord;
use std::collections::HashMap;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::str::FromStr;
use std::sync::Arc;

/// Longest companion that is read; they hold a provenance chain.
const MAX_COMPANION_BYTES: u64 = 64 << 20;

/// What a column is read as.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Want {
    /// 64-bit numbers; a cell that is none is an error.
    Float,
    /// 32-bit numbers; a cell that is none is an error.
    Float32,
    /// Whole numbers from 0; a cell that is none is an error.
    Unsigned,
    /// Texts.
    Text,
    /// 32-bit numbers if all cells are, otherwise the column is left out.
    Float32OrNothing,
    /// Whole numbers, numbers or texts: the first that fits all cells.
    Guess,
}

/// The file beside a CSV.
pub(crate) fn companion(path: &Path) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".json");
    PathBuf::from(name)
}

/// Writes a table whose columns have been checked to agree, and its companion.
///
/// Numbers have as many digits as bring back the same bits; missing ones are empty.
pub(crate) fn write(path: &Path, table: &Table, metadata: &Metadata) -> Result<()> {
    // The companion goes first: a table never stands beside the story of an older one.
    let beside = companion(path);
    write_atomically(&beside, |file| {
        serde_json::to_writer_pretty(&mut *file, metadata)?;
        file.write_all(b"\n")?;
        Ok(())
    })?;
    write_atomically(path, |file| {
        let mut writer = csv::Writer::from_writer(file);
        writer.write_record(table.columns.iter().map(|(name, _)| name))?;
        let mut cell = String::new();
        for row in 0..table.rows() {
            for (_, column) in &table.columns {
                cell.clear();
                write_cell(&mut cell, column, row)?;
                writer.write_field(&cell)?;
            }
            writer.write_record(None::<&[u8]>)?;
        }
        writer.flush()?;
        Ok(())
    })
}

fn write_cell(cell: &mut String, column: &Column, row: usize) -> std::result::Result<(), AnyError> {
    use std::fmt::Write;
    match column {
        Column::Float(values) if values[row].is_nan() => Ok(()),
        Column::Float32(values) if values[row].is_nan() => Ok(()),
        Column::Float(values) => write!(cell, "{}", values[row]),
        Column::Float32(values) => write!(cell, "{}", values[row]),
        Column::Integer(values) => write!(cell, "{}", values[row]),
        Column::Unsigned(values) => write!(cell, "{}", values[row]),
        Column::Text(values) => write!(cell, "{}", values[row]),
    }?;
    Ok(())
}

/// Reads the companion; a CSV without one says nothing beside its rows.
pub(crate) fn read_metadata(path: &Path) -> Result<Metadata> {
    let beside = companion(path);
    if !beside.exists() {
        return Ok(Metadata::new());
    }
    let text = read_text(&beside, MAX_COMPANION_BYTES)?;
    serde_json::from_str(&text).map_err(|error| {
        let hint = "remove it, or write the table again";
        Error::invalid(&beside, format!("the companion is not a JSON object: {error}"), hint)
    })
}

/// Reads a table; `want` says what a column of this name is read as.
pub(crate) fn read(path: &Path, want: impl Fn(&str) -> Want) -> Result<Table> {
    parse(path, read_bounded(path, MAX_FILE_BYTES)?, want)
}

/// Reads a table from bytes; `path` is for messages only.
pub(crate) fn parse(path: &Path, bytes: Vec<u8>, want: impl Fn(&str) -> Want) -> Result<Table> {
    let text = text(path, bytes)?;
    let separator = separator(&text);
    let mut reader = csv::ReaderBuilder::new()
        .delimiter(separator)
        .trim(csv::Trim::All)
        .from_reader(text.as_bytes());
    let bad = |error: csv::Error| bad_row(path, &error);
    let header = reader.headers().map_err(bad)?.clone();
    let records: Vec<StringRecord> =
        reader.records().take(MAX_ROWS + 1).collect::<csv::Result<_>>().map_err(bad)?;
    if records.len() > MAX_ROWS {
        return Err(Error::invalid(
            path,
            "the table is too long",
            format!("at most {MAX_ROWS} rows"),
        ));
    }
    let mut table = Table::default();
    for (index, name) in header.iter().enumerate() {
        let cells = Cells { path, name, index, records: &records };
        if let Some(column) = cells.column(want(name))? {
            table.columns.push((name.into(), column));
        }
    }
    table.check(path)?;
    Ok(table)
}

/// Comma, or semicolon or tab when only they occur in the header: German Excel writes `;`.
fn separator(text: &str) -> u8 {
    let header = text.lines().next().unwrap_or_default();
    match header {
        line if line.contains(',') => b',',
        line if line.contains(';') => b';',
        line if line.contains('\t') => b'\t',
        _ => b',',
    }
}

fn bad_row(path: &Path, error: &csv::Error) -> Error {
    match error.kind() {
        csv::ErrorKind::UnequalLengths { pos, expected_len, len } => {
            let line = pos.as_ref().map_or(0, csv::Position::line);
            let message = format!("line {line} has {len} cells");
            Error::invalid(path, message, format!("the header names {expected_len} columns"))
        }
        _ => Error::invalid(path, format!("this is not a readable CSV: {error}"), ""),
    }
}

/// The cells of one column.
struct Cells<'a> {
    path: &'a Path,
    name: &'a str,
    index: usize,
    records: &'a [StringRecord],
}

impl Cells<'_> {
    fn iter(&self) -> impl Iterator<Item = &str> {
        self.records.iter().map(|record| record.get(self.index).unwrap_or_default())
    }

    fn column(&self, want: Want) -> Result<Option<Column>> {
        Ok(match want {
            Want::Float => Some(Column::Float(self.strict("a number", float, f64::NAN)?)),
            Want::Float32 => Some(Column::Float32(self.strict("a number", float, f32::NAN)?)),
            Want::Unsigned => {
                let parse = |cell: &str| cell.parse().ok().map(Some);
                let cells = self.strict("a whole number from 0", parse, None::<u64>)?;
                Some(Column::Unsigned(self.present(cells)?))
            }
            Want::Text => Some(self.texts()),
            Want::Float32OrNothing => self.all(float, f32::NAN).map(Column::Float32),
            Want::Guess => Some(self.guess()),
        })
    }

    /// Every cell parsed, `missing` for empty ones; an error names the first that cannot be.
    fn strict<T: Copy>(
        &self,
        what: &str,
        parse: impl Fn(&str) -> Option<T>,
        missing: T,
    ) -> Result<Vec<T>> {
        let cell = |(row, cell): (usize, &str)| match is_missing(cell) {
            true => Ok(missing),
            false => parse(cell).ok_or_else(|| {
                let shown: String = cell.chars().take(40).collect();
                self.wrong(row, format!("expected {what}, found `{shown}`"))
            }),
        };
        self.iter().enumerate().map(cell).collect()
    }

    fn present<T>(&self, cells: Vec<Option<T>>) -> Result<Vec<T>> {
        let cell = |(row, cell): (usize, Option<T>)| {
            cell.ok_or_else(|| self.wrong(row, "the cell is empty".into()))
        };
        cells.into_iter().enumerate().map(cell).collect()
    }

    fn wrong(&self, row: usize, message: String) -> Error {
        let (path, column) = (self.path.into(), self.name.into());
        Error::Cell { path, row: row as u64 + 1, column, message }
    }

    /// Every cell parsed, or `None` if one cannot be.
    fn all<T: Copy>(&self, parse: impl Fn(&str) -> Option<T>, missing: T) -> Option<Vec<T>> {
        self.iter().map(|cell| if is_missing(cell) { Some(missing) } else { parse(cell) }).collect()
    }

    fn guess(&self) -> Column {
        let whole: Option<Vec<i64>> = self.iter().map(|cell| cell.parse().ok()).collect();
        match whole.filter(|_| !self.records.is_empty()) {
            Some(whole) => Column::Integer(whole),
            None => match self.all(float, f64::NAN) {
                Some(numbers) => Column::Float(numbers),
                None => self.texts(),
            },
        }
    }

    fn texts(&self) -> Column {
        let mut words: HashMap<&str, Arc<str>> = HashMap::new();
        let shared = |cell| words.entry(cell).or_insert_with(|| Arc::from(cell)).clone();
        Column::Text(self.iter().map(shared).collect())
    }
}

fn float<T: FromStr>(cell: &str) -> Option<T> {
    cell.parse().ok()
}

/// Spellings of "no value" that R, pandas, spreadsheets and databases write.
fn is_missing(cell: &str) -> bool {
    matches!(cell, "" | "NA" | "NaN" | "nan" | "NULL")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read_str(text: &str, want: impl Fn(&str) -> Want) -> Result<Table> {
        parse(Path::new("plants.csv"), text.as_bytes().to_vec(), want)
    }

    #[test]
    fn values_decide_what_a_foreign_column_holds() {
        let table = read_str("\u{feff}a;b;c\n1;2.5;x\n2;NA;y\n", |_| Want::Guess).unwrap();
        assert_eq!(table.column("a"), Some(&Column::Integer(vec![1, 2])));
        assert!(
            matches!(table.column("b"), Some(Column::Float(b)) if b[0] == 2.5 && b[1].is_nan())
        );
        assert_eq!(table.column("c"), Some(&Column::text(["x", "y"])));
    }

    #[test]
    fn a_bad_cell_is_named_by_row_and_column() {
        let error = read_str("x,y\n1,2\n3,oak\n", |_| Want::Float).unwrap_err().to_string();
        assert_eq!(error, "plants.csv, row 2, column `y`: expected a number, found `oak`");
    }

    #[test]
    fn a_short_row_is_named_by_its_line() {
        let error = read_str("x,y\n1,2\n3\n", |_| Want::Float).unwrap_err().to_string();
        assert_eq!(error, "plants.csv: line 3 has 1 cells; the header names 2 columns");
    }

    #[test]
    fn every_float_comes_back_bit_for_bit() {
        for bits in [1u32, 0x0080_0000, 0x3DCC_CCCD, 0x7F7F_FFFF, 0x8000_0000, 0x4B7F_FFFF] {
            let mut cell = String::new();
            write_cell(&mut cell, &Column::Float32(vec![f32::from_bits(bits)]), 0).unwrap();
            assert_eq!(float::<f32>(&cell).unwrap().to_bits(), bits, "{cell}");
        }
    }
}
