//! Parquet by columns: Zstandard, byte-stream split for floats, dictionaries for words.

use crate::error::{Error, Result};
use crate::table::{Column, MAX_ROWS, Metadata, Table};
use crate::whole::{AnyError, write_atomically};
use parquet::basic::{
    Compression, ConvertedType, Encoding, LogicalType, Repetition, Type, ZstdLevel,
};
use parquet::column::reader::{ColumnReader, ColumnReaderImpl};
use parquet::column::writer::ColumnWriter;
use parquet::data_type::{ByteArray, DataType};
use parquet::file::metadata::{KeyValue, RowGroupMetaData};
use parquet::file::properties::{WriterProperties, WriterVersion};
use parquet::file::reader::{FileReader, SerializedFileReader};
use parquet::file::writer::{SerializedFileWriter, SerializedRowGroupWriter};
use parquet::schema::types::{ColumnDescriptor, ColumnPath, Type as SchemaType};
use std::cell::Cell;
use std::collections::HashMap;
use std::fs::File;
use std::ops::Range;
use std::path::{Path, PathBuf};
use std::sync::Arc;

/// Rows of a row group: the size at which DuckDB spreads a file over its threads.
const GROUP_ROWS: usize = 122_880;

/// Rows that are decoded at once.
const BATCH_ROWS: usize = 1 << 14;

/// Most columns that are read.
const MAX_COLUMNS: usize = 4096;

/// Zstandard's default; higher levels gain under 2 % on our columns.
const ZSTD_LEVEL: i32 = 3;

/// Name of the column of points that makes a table a GeoParquet file.
pub(crate) const GEOMETRY: &str = "geometry";

/// Map coordinates to write as a column of points.
#[derive(Clone, Copy)]
pub(crate) struct Points<'a> {
    pub x: &'a [f64],
    pub y: &'a [f64],
}

type Done = std::result::Result<(), AnyError>;

/// Writes a table whose columns have been checked to agree.
pub(crate) fn write(
    path: &Path,
    table: &Table,
    points: Option<Points<'_>>,
    metadata: &Metadata,
) -> Result<()> {
    write_atomically(path, |file| {
        let schema = Arc::new(schema(table, points.is_some())?);
        let properties = Arc::new(properties(table, metadata)?);
        let mut writer = SerializedFileWriter::new(file, schema, properties)?;
        let rows = table.rows();
        for start in (0..rows).step_by(GROUP_ROWS) {
            let group = writer.next_row_group()?;
            write_group(group, table, points, start..rows.min(start + GROUP_ROWS))?;
        }
        writer.close()?;
        Ok(())
    })
}

fn schema(table: &Table, has_points: bool) -> std::result::Result<SchemaType, AnyError> {
    let mut fields = Vec::new();
    for (name, column) in &table.columns {
        let (physical, logical) = match column {
            Column::Float(_) => (Type::DOUBLE, None),
            Column::Float32(_) => (Type::FLOAT, None),
            Column::Integer(_) => (Type::INT64, None),
            Column::Unsigned(_) => (Type::INT64, Some(LogicalType::integer(64, false))),
            Column::Text(_) => (Type::BYTE_ARRAY, Some(LogicalType::String)),
        };
        fields.push((name.as_str(), physical, logical));
    }
    if has_points {
        fields.push((GEOMETRY, Type::BYTE_ARRAY, None));
    }
    let build = |(name, physical, logical): (&str, Type, Option<LogicalType>)| {
        let builder = SchemaType::primitive_type_builder(name, physical);
        let builder = builder.with_repetition(Repetition::REQUIRED).with_logical_type(logical);
        Ok(Arc::new(builder.build()?))
    };
    let fields = fields.into_iter().map(build).collect::<std::result::Result<_, AnyError>>()?;
    Ok(SchemaType::group_type_builder("schema").with_fields(fields).build()?)
}

fn properties(
    table: &Table,
    metadata: &Metadata,
) -> std::result::Result<WriterProperties, AnyError> {
    let text = |value: &serde_json::Value| match value {
        // GeoParquet's own key is read by others: its value is the JSON text itself.
        serde_json::Value::String(text) => text.clone(),
        other => other.to_string(),
    };
    let pairs = metadata.iter().map(|(key, value)| KeyValue::new(key.clone(), text(value)));
    let mut builder = WriterProperties::builder()
        .set_writer_version(WriterVersion::PARQUET_2_0)
        .set_created_by(format!("weald {}", env!("CARGO_PKG_VERSION")))
        .set_compression(Compression::ZSTD(ZstdLevel::try_new(ZSTD_LEVEL)?))
        .set_key_value_metadata(Some(pairs.collect()));
    for (name, column) in &table.columns {
        let path = || ColumnPath::from(vec![name.clone()]);
        let encoding = match column {
            Column::Float(_) | Column::Float32(_) => Encoding::BYTE_STREAM_SPLIT,
            Column::Integer(_) | Column::Unsigned(_) => Encoding::DELTA_BINARY_PACKED,
            // Few different words: the default dictionary.
            Column::Text(_) => continue,
        };
        builder = builder
            .set_column_dictionary_enabled(path(), false)
            .set_column_encoding(path(), encoding);
    }
    let geometry = || ColumnPath::from(vec![GEOMETRY.to_string()]);
    Ok(builder.set_column_dictionary_enabled(geometry(), false).build())
}

fn write_group<W: std::io::Write + Send>(
    mut group: SerializedRowGroupWriter<'_, W>,
    table: &Table,
    points: Option<Points<'_>>,
    rows: Range<usize>,
) -> Done {
    for (_, column) in &table.columns {
        let Some(mut writer) = group.next_column()? else { break };
        write_column(writer.untyped(), column, rows.clone())?;
        writer.close()?;
    }
    if let Some(points) = points
        && let Some(mut writer) = group.next_column()?
    {
        if let ColumnWriter::ByteArrayColumnWriter(writer) = writer.untyped() {
            writer.write_batch(&well_known_binary(points, rows), None, None)?;
        }
        writer.close()?;
    }
    group.close()?;
    Ok(())
}

fn write_column(writer: &mut ColumnWriter<'_>, column: &Column, rows: Range<usize>) -> Done {
    match (writer, column) {
        (ColumnWriter::DoubleColumnWriter(writer), Column::Float(values)) => {
            writer.write_batch(&values[rows], None, None)?;
        }
        (ColumnWriter::FloatColumnWriter(writer), Column::Float32(values)) => {
            writer.write_batch(&values[rows], None, None)?;
        }
        (ColumnWriter::Int64ColumnWriter(writer), Column::Integer(values)) => {
            writer.write_batch(&values[rows], None, None)?;
        }
        (ColumnWriter::Int64ColumnWriter(writer), Column::Unsigned(values)) => {
            let bits: Vec<i64> = values[rows].iter().map(|&value| value as i64).collect();
            writer.write_batch(&bits, None, None)?;
        }
        (ColumnWriter::ByteArrayColumnWriter(writer), Column::Text(values)) => {
            let words: Vec<ByteArray> =
                values[rows].iter().map(|word| ByteArray::from(&**word)).collect();
            writer.write_batch(&words, None, None)?;
        }
        // The schema was made from these very columns.
        _ => return Err("the schema does not fit the table".into()),
    }
    Ok(())
}

/// Bytes of a point in well-known binary: byte order, type 1, x, y [OGC06-103r4] §8.2.
const POINT_BYTES: usize = 21;

fn well_known_binary(points: Points<'_>, rows: Range<usize>) -> Vec<ByteArray> {
    let count = rows.len();
    let mut bytes = Vec::with_capacity(count * POINT_BYTES);
    for (x, y) in points.x[rows.clone()].iter().zip(&points.y[rows]) {
        bytes.push(1);
        bytes.extend_from_slice(&1u32.to_le_bytes());
        bytes.extend_from_slice(&x.to_le_bytes());
        bytes.extend_from_slice(&y.to_le_bytes());
    }
    // One allocation shared by all rows.
    let all = ByteArray::from(bytes);
    (0..count).map(|row| all.slice(row * POINT_BYTES, POINT_BYTES)).collect()
}

fn open(path: &Path) -> Result<SerializedFileReader<File>> {
    let file = File::open(path).map_err(Error::io("open", path))?;
    guarded(path, || SerializedFileReader::new(file))
}

/// Runs the third-party reader; its errors become ours.
fn guarded<T>(path: &Path, read: impl FnOnce() -> parquet::errors::Result<T>) -> Result<T> {
    read().map_err(|error| match error.to_string() {
        // The crate's words for a codec that is not built in.
        text if text.contains("Disabled feature") => {
            let hint = "write it with compression zstd, snappy or none";
            Error::unsupported(path, "the compression of this Parquet file", hint)
        }
        text => {
            let message = format!("this is not a readable Parquet file: {text}");
            Error::invalid(path, message, "the file may be cut short")
        }
    })
}

thread_local! {
    /// Whether this thread is inside [`contained`].
    static IS_CONTAINED: Cell<bool> = const { Cell::new(false) };
}

/// Whether a panic on this thread will be caught and told as an error of the file: a program's
/// panic hook need not speak of it.
pub fn is_panic_contained() -> bool {
    IS_CONTAINED.get()
}

/// Turns panics of the third-party reader into errors.
///
/// Version 60.1 panics on some damaged pages and footers: a dictionary page that is missing, a
/// byte-stream split of odd length, a negative column size (`tests/hostile.rs` finds them).
fn contained<T>(path: &Path, read: impl FnOnce() -> Result<T>) -> Result<T> {
    let outer = IS_CONTAINED.replace(true);
    // What the closure owned is dropped, so no half-changed value is seen afterwards.
    let outcome = std::panic::catch_unwind(std::panic::AssertUnwindSafe(read));
    IS_CONTAINED.set(outer);
    outcome.unwrap_or_else(|_| {
        let message = "this is not a readable Parquet file: its parts contradict each other";
        Err(Error::invalid(path, message, "the file is damaged"))
    })
}

/// Reads what the file says beside its rows; texts that are not JSON are left out.
pub(crate) fn read_metadata(path: &Path) -> Result<Metadata> {
    contained(path, || Ok(metadata_of(&open(path)?)))
}

fn metadata_of(reader: &SerializedFileReader<File>) -> Metadata {
    let pairs = reader.metadata().file_metadata().key_value_metadata();
    let json = |pair: &KeyValue| {
        Some((pair.key.clone(), serde_json::from_str(pair.value.as_deref()?).ok()?))
    };
    pairs.into_iter().flatten().filter_map(json).collect()
}

/// Reads all columns of numbers and words, and what stands beside them.
pub(crate) fn read(path: &Path) -> Result<(Table, Metadata)> {
    contained(path, || read_unguarded(path))
}

fn read_unguarded(path: &Path) -> Result<(Table, Metadata)> {
    let reader = open(path)?;
    rows_of(path, &reader)?;
    let table = read_groups(path, &reader, 0..reader.num_row_groups(), &|_| true)?;
    Ok((table, metadata_of(&reader)))
}

/// Reads columns of numbers and words of some row groups.
fn read_groups(
    path: &Path,
    reader: &SerializedFileReader<File>,
    groups: Range<usize>,
    is_wanted: &dyn Fn(&str) -> bool,
) -> Result<Table> {
    let schema = reader.metadata().file_metadata().schema_descr_ptr();
    let rows = rows_of_groups(path, reader, &groups)?;
    if schema.num_columns() > MAX_COLUMNS {
        let message = format!("the table has {} columns", schema.num_columns());
        return Err(Error::invalid(path, message, format!("at most {MAX_COLUMNS} are read")));
    }
    let mut table = Table::default();
    for (index, descriptor) in schema.columns().iter().enumerate() {
        let name = descriptor.path().string();
        let is_whole = has_no_gaps(reader, index, descriptor);
        let Some(mut column) = empty_column(descriptor, is_whole) else { continue };
        if !is_wanted(&name) {
            continue;
        }
        let mut words = HashMap::new();
        for group in groups.clone() {
            let group = guarded(path, || reader.get_row_group(group))?;
            let pages = guarded(path, || group.get_column_reader(index))?;
            guarded(path, || read_column(pages, descriptor, &mut column, &mut words))?;
            if column.len() > rows {
                break;
            }
        }
        if column.len() != rows {
            let message = format!("column `{name}` has {} rows", column.len());
            return Err(Error::invalid(path, message, format!("the file promises {rows}")));
        }
        table.columns.push((name, column));
    }
    Ok(table)
}

/// Rows that the file promises in some groups: all rows when it is all groups.
fn rows_of_groups(
    path: &Path,
    reader: &SerializedFileReader<File>,
    groups: &Range<usize>,
) -> Result<usize> {
    if *groups == (0..reader.num_row_groups()) {
        return rows_of(path, reader);
    }
    let found = reader.metadata().row_groups().get(groups.clone());
    let rows = found.map(|groups| groups.iter().map(RowGroupMetaData::num_rows).sum::<i64>());
    rows.and_then(|rows| usize::try_from(rows).ok()).ok_or_else(|| {
        let message = format!("the table has no row group {}", groups.start);
        Error::invalid(path, message, "the file has changed while it was read")
    })
}

/// A Parquet file too long for memory: its rows are read a row group at a time.
#[derive(Debug)]
pub struct RowGroups {
    path: PathBuf,
    /// First row of each group, from 0, and the number of all rows at the end.
    first_rows: Vec<u64>,
}

impl RowGroups {
    /// Reads how many rows the groups of a file have.
    ///
    /// # Errors
    /// When the file is missing or damaged.
    pub fn open(path: &Path) -> Result<Self> {
        let reader = contained(path, || open(path))?;
        let mut first_rows = vec![0u64];
        let mut end = 0u64;
        for group in reader.metadata().row_groups() {
            let rows = u64::try_from(group.num_rows()).ok().filter(|rows| *rows <= MAX_ROWS as u64);
            let Some(all) = rows.and_then(|rows| end.checked_add(rows)) else {
                let message = format!("a row group promises {} rows", group.num_rows());
                return Err(Error::invalid(path, message, format!("at most {MAX_ROWS} are read")));
            };
            end = all;
            first_rows.push(end);
        }
        Ok(Self { path: path.to_path_buf(), first_rows })
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.first_rows.len() - 1
    }

    /// Whether there is no group.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Number of rows of all groups.
    pub fn rows(&self) -> u64 {
        self.first_row(self.len())
    }

    /// Row of the file, from 0, at which a group begins.
    pub fn first_row(&self, group: usize) -> u64 {
        self.first_rows.get(group).copied().unwrap_or(0)
    }

    /// Reads the columns of a group whose names are asked for.
    ///
    /// # Errors
    /// When there is no such group, or it is damaged.
    pub fn read(&self, group: usize, is_wanted: &dyn Fn(&str) -> bool) -> Result<Table> {
        let path = &self.path;
        // Opened anew: copies of an open file share their position, and threads read at once.
        contained(path, || read_groups(path, &open(path)?, group..group + 1, is_wanted))
    }
}

fn rows_of(path: &Path, reader: &SerializedFileReader<File>) -> Result<usize> {
    let rows = reader.metadata().file_metadata().num_rows();
    match usize::try_from(rows) {
        Ok(rows) if rows <= MAX_ROWS => Ok(rows),
        _ => {
            let message = format!("the table promises {rows} rows");
            Err(Error::invalid(path, message, format!("at most {MAX_ROWS} are read")))
        }
    }
}

/// Whether a column has a value in every row: because it must, or because the file counted none
/// missing, as the writers of pandas and DuckDB do for columns that might have had gaps.
fn has_no_gaps(
    reader: &SerializedFileReader<File>,
    index: usize,
    descriptor: &ColumnDescriptor,
) -> bool {
    let counted_none = |group: &RowGroupMetaData| {
        let statistics = group.columns().get(index).and_then(|column| column.statistics());
        statistics.and_then(|statistics| statistics.null_count_opt()) == Some(0)
    };
    descriptor.max_def_level() == 0 || reader.metadata().row_groups().iter().all(counted_none)
}

/// A column to fill, or `None` for types that are left out. Whole numbers with gaps become
/// floats, where a gap is NaN.
fn empty_column(descriptor: &ColumnDescriptor, is_whole: bool) -> Option<Column> {
    let is_text = matches!(
        descriptor.converted_type(),
        ConvertedType::UTF8 | ConvertedType::ENUM | ConvertedType::JSON
    );
    let is_plain = matches!(descriptor.converted_type(), ConvertedType::NONE);
    if descriptor.max_rep_level() > 0 {
        return None;
    }
    match descriptor.physical_type() {
        Type::BYTE_ARRAY if is_text => Some(Column::Text(Vec::new())),
        Type::FLOAT if is_plain => Some(Column::Float32(Vec::new())),
        Type::DOUBLE if is_plain => Some(Column::Float(Vec::new())),
        Type::BOOLEAN | Type::INT32 | Type::INT64 => match descriptor.converted_type() {
            ConvertedType::UINT_64 if is_whole => Some(Column::Unsigned(Vec::new())),
            kind if is_whole_number(kind) && !is_whole => Some(Column::Float(Vec::new())),
            kind if is_whole_number(kind) => Some(Column::Integer(Vec::new())),
            _ => None,
        },
        _ => None,
    }
}

/// Whether a converted type is a number rather than a date, time or decimal.
fn is_whole_number(kind: ConvertedType) -> bool {
    use ConvertedType as T;
    matches!(
        kind,
        T::NONE
            | T::INT_8
            | T::INT_16
            | T::INT_32
            | T::INT_64
            | T::UINT_8
            | T::UINT_16
            | T::UINT_32
            | T::UINT_64
    )
}

type Words = HashMap<Vec<u8>, Arc<str>>;

fn read_column(
    pages: ColumnReader,
    descriptor: &ColumnDescriptor,
    column: &mut Column,
    words: &mut Words,
) -> parquet::errors::Result<()> {
    let levels = descriptor.max_def_level();
    let is_unsigned = matches!(
        descriptor.converted_type(),
        ConvertedType::UINT_8 | ConvertedType::UINT_16 | ConvertedType::UINT_32
    );
    match (pages, column) {
        (ColumnReader::DoubleColumnReader(pages), Column::Float(out)) => {
            each(pages, levels, |value| out.push(value.copied().unwrap_or(f64::NAN)))
        }
        (ColumnReader::FloatColumnReader(pages), Column::Float32(out)) => {
            each(pages, levels, |value| out.push(value.copied().unwrap_or(f32::NAN)))
        }
        (ColumnReader::Int64ColumnReader(pages), Column::Integer(out)) => {
            each(pages, levels, |value| out.push(value.copied().unwrap_or(0)))
        }
        (ColumnReader::Int64ColumnReader(pages), Column::Unsigned(out)) => {
            each(pages, levels, |value| out.push(value.copied().unwrap_or(0) as u64))
        }
        (ColumnReader::Int64ColumnReader(pages), Column::Float(out)) => {
            each(pages, levels, |value| out.push(value.map_or(f64::NAN, |&v| v as f64)))
        }
        (ColumnReader::Int32ColumnReader(pages), Column::Integer(out)) => {
            let number = |v: i32| if is_unsigned { i64::from(v as u32) } else { i64::from(v) };
            each(pages, levels, |value| out.push(value.map_or(0, |&v| number(v))))
        }
        (ColumnReader::Int32ColumnReader(pages), Column::Float(out)) => {
            let number = |v: i32| if is_unsigned { f64::from(v as u32) } else { f64::from(v) };
            each(pages, levels, |value| out.push(value.map_or(f64::NAN, |&v| number(v))))
        }
        (ColumnReader::BoolColumnReader(pages), Column::Integer(out)) => {
            each(pages, levels, |value| out.push(value.map_or(0, |&v| i64::from(v))))
        }
        (ColumnReader::BoolColumnReader(pages), Column::Float(out)) => {
            each(pages, levels, |value| {
                out.push(value.map_or(f64::NAN, |&v| f64::from(u8::from(v))))
            })
        }
        (ColumnReader::ByteArrayColumnReader(pages), Column::Text(out)) => {
            each(pages, levels, |value| out.push(word(value, words)))
        }
        _ => Err(parquet::errors::ParquetError::General("column types do not agree".into())),
    }
}

/// The word of a cell, shared with equal cells.
fn word(value: Option<&ByteArray>, words: &mut Words) -> Arc<str> {
    let Some(value) = value else { return Arc::from("") };
    if let Some(known) = words.get(value.data()) {
        return known.clone();
    }
    let text: Arc<str> = Arc::from(String::from_utf8_lossy(value.data()));
    words.insert(value.data().to_vec(), text.clone());
    text
}

/// Calls `push` for each row of a column chunk, with `None` where the value is missing.
fn each<T: DataType>(
    mut pages: ColumnReaderImpl<T>,
    full_level: i16,
    mut push: impl FnMut(Option<&T::T>),
) -> parquet::errors::Result<()> {
    let mut values = Vec::new();
    let mut levels = Vec::new();
    let mut total = 0;
    loop {
        values.clear();
        levels.clear();
        let wanted_levels = (full_level > 0).then_some(&mut levels);
        let (rows, _, _) = pages.read_records(BATCH_ROWS, wanted_levels, None, &mut values)?;
        total += rows;
        if rows == 0 || total > MAX_ROWS {
            return Ok(());
        }
        if full_level == 0 {
            values.iter().for_each(|value| push(Some(value)));
            continue;
        }
        let mut present = values.iter();
        for &level in &levels {
            push(if level == full_level { present.next() } else { None });
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_contained_panic_is_known_as_such_and_becomes_an_error() {
        assert!(!is_panic_contained());
        let error = contained::<()>(Path::new("x.parquet"), || {
            assert!(is_panic_contained());
            // Without the hook: a quiet unwinding.
            std::panic::resume_unwind(Box::new("damaged page"))
        })
        .unwrap_err();
        assert!(error.to_string().contains("x.parquet"));
        assert!(!is_panic_contained());
    }
}
