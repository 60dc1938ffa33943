//! Clusters of the rows of anyone's table of numbers: `weald quantize --table`.

use crate::error::{Error, Result};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;
use weald_contract::source::nearest;
use weald_formats::{Column, Provenance, Table};
use weald_quantize::{Codebook, TableError, cluster};

pub use weald_quantize::Mode;

/// What to cluster, and how.
#[derive(Clone, Debug)]
pub struct Request {
    /// A table, `.csv` or `.parquet`.
    pub table: PathBuf,
    /// Columns that are compared; all columns of numbers but the weight when there are none.
    pub columns: Vec<String>,
    /// Column of weights; all rows weigh alike without one.
    pub weight: Option<String>,
    /// Most clusters.
    pub clusters: usize,
    /// How long clusters are improved.
    pub mode: Mode,
    /// Table to write the centres to.
    pub output: Option<PathBuf>,
}

/// What was found.
#[derive(Clone, Debug, Serialize)]
pub struct Found {
    /// Rows of the table.
    pub rows: usize,
    /// Columns compared.
    pub columns: Vec<String>,
    /// Clusters found; fewer than asked for where there are fewer distinct rows with weight.
    pub clusters: usize,
    /// Weighted mean of the squared distances between rows and their centres.
    pub weighted_mse: f64,
    /// Time to cluster, s; reading and writing not counted.
    pub seconds: f64,
    /// The table of centres, if it was written.
    pub output: Option<PathBuf>,
}

/// Clusters the rows of a table, and writes the centres if asked.
///
/// # Errors
/// The table is damaged, lacks a column, or holds what is no number; the disk refuses.
pub fn quantize_table(request: &Request) -> Result<Found> {
    let path = &request.table;
    let table = weald_formats::read_table(path)?;
    let columns = chosen(request, &table)?;
    let rows = numbers(path, &table, &columns, request.weight.as_deref())?;
    drop(table);
    let began = Instant::now();
    let book = cluster(&rows, request.clusters, request.mode);
    let seconds = began.elapsed().as_secs_f64();
    if let Some(output) = &request.output {
        weald_formats::write_table(output, &centres(&columns, &rows, &book), &story(request)?)?;
    }
    Ok(Found {
        rows: rows.len(),
        clusters: book.len(),
        weighted_mse: book.distortion(&rows),
        columns,
        seconds,
        output: request.output.clone(),
    })
}

/// The columns asked for, or all of numbers but the weight.
fn chosen(request: &Request, table: &Table) -> Result<Vec<String>> {
    if !request.columns.is_empty() {
        return Ok(request.columns.clone());
    }
    let is_compared = |(name, column): &&(String, Column)| {
        column.texts().is_none() && request.weight.as_ref() != Some(name)
    };
    let found: Vec<String> =
        table.columns.iter().filter(is_compared).map(|(name, _)| name.clone()).collect();
    if found.is_empty() {
        let message = format!("{} has no column of numbers", request.table.display());
        return Err(Error::plain(message, "name columns with `--columns a,b,c`"));
    }
    Ok(found)
}

fn numbers(
    path: &Path,
    table: &Table,
    names: &[String],
    weight: Option<&str>,
) -> Result<weald_quantize::Table> {
    let columns =
        names.iter().map(|name| column(path, table, name)).collect::<Result<Vec<Vec<f64>>>>()?;
    let weights = match weight {
        Some(name) => column(path, table, name)?,
        None => vec![1.0; table.rows()],
    };
    let mut values = Vec::with_capacity(table.rows() * columns.len());
    for row in 0..table.rows() {
        values.extend(columns.iter().map(|column| column[row]));
    }
    weald_quantize::Table::new(values, columns.len(), weights)
        .map_err(|error| not_a_number(path, table, names, weight, error))
}

/// A column of numbers; a text among them is named by its row.
fn column(path: &Path, table: &Table, name: &str) -> Result<Vec<f64>> {
    let Some(found) = table.column(name) else {
        let known: Vec<&str> = table.columns.iter().map(|(name, _)| name.as_str()).collect();
        let hint = match nearest(name, known.iter().copied()) {
            Some(near) => format!("did you mean `{near}`?"),
            None => format!("it has: {}", known.join(", ")),
        };
        return Err(Error::plain(format!("{} has no column `{name}`", path.display()), hint));
    };
    if let Some(values) = found.numbers() {
        return Ok(values);
    }
    let texts = found.texts().unwrap_or_default();
    let row = texts.iter().position(|text| !text.is_empty() && text.parse::<f64>().is_err());
    let at = row.map_or(String::new(), |row| format!("row {}, ", row + 1));
    let text = row.and_then(|row| texts.get(row)).map_or("", |text| text);
    let message = format!("{}, {at}column `{name}`: `{text}` is no number", path.display());
    Err(Error::plain(message, "leave the column or the row out"))
}

/// The error of a table, with the row as a reader of the file counts it: from 1, below the header.
fn not_a_number(
    path: &Path,
    table: &Table,
    names: &[String],
    weight: Option<&str>,
    error: TableError,
) -> Error {
    let (row, name) = match &error {
        TableError::NotFinite { row, column } => (*row, names.get(*column).map(String::as_str)),
        TableError::BadWeight { row } => (*row, weight),
        _ => return Error::plain(format!("{}: {error}", path.display()), "use a shorter table"),
    };
    let name = name.unwrap_or_default();
    let values = table.column(name).and_then(Column::numbers);
    let value = values.and_then(|values| values.get(row).copied()).unwrap_or(f64::NAN);
    let value = if value.is_nan() { "missing or NaN".to_string() } else { value.to_string() };
    let right = match error {
        TableError::BadWeight { .. } => "a finite number of at least 0 is right",
        _ => "a finite number is right",
    };
    let message = format!("{}, row {}, column `{name}` is {value}", path.display(), row + 1);
    Error::plain(message, right)
}

/// Name of the columns of rows and weight that a cluster stands for.
const COUNT: &str = "count";
const WEIGHT: &str = "weight";

/// A row a cluster: its centre, and how many rows of what weight it stands for.
fn centres(columns: &[String], rows: &weald_quantize::Table, book: &Codebook) -> Table {
    let mut counts = vec![0u64; book.len()];
    let mut weights = vec![0.0; book.len()];
    for (label, weight) in book.labels.iter().zip(rows.weights()) {
        counts[*label as usize] += 1;
        weights[*label as usize] += weight;
    }
    let values = |column: usize| (0..book.len()).map(|label| book.centre(label)[column]).collect();
    let mut table = Table::default();
    for (index, name) in columns.iter().enumerate() {
        table = table.with(name, Column::Float(values(index)));
    }
    let is_free = |name: &str| !columns.iter().any(|column| column == name);
    for (name, column) in [(COUNT, Column::Unsigned(counts)), (WEIGHT, Column::Float(weights))] {
        if is_free(name) {
            table = table.with(name, column);
        }
    }
    table
}

fn story(request: &Request) -> Result<Provenance> {
    Ok(Provenance {
        stage: "quantize".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        output_version: weald_quantize::OUTPUT_VERSION,
        parameters: serde_json::json!({
            "columns": request.columns, "weight": request.weight,
            "clusters": request.clusters, "mode": request.mode.word(),
        }),
        seed: 0,
        inputs: vec![crate::make::parent(&request.table)?],
    })
}

impl fmt::Display for Found {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} rows of {} in {} clusters: weighted mean squared error {:.6e}, {:.3} s",
            self.rows,
            self.columns.join(", "),
            self.clusters,
            self.weighted_mse,
            self.seconds
        )?;
        self.output.iter().try_for_each(|path| writeln!(f, "wrote {}", path.display()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn request(folder: &Path, text: &str, columns: &[&str]) -> Request {
        let table = folder.join("v.csv");
        std::fs::write(&table, text).unwrap();
        Request {
            table,
            columns: columns.iter().map(|name| name.to_string()).collect(),
            weight: None,
            clusters: 2,
            mode: Mode::Best,
            output: Some(folder.join("centres.csv")),
        }
    }

    #[test]
    fn two_heaps_of_rows_are_told_apart_by_weight() {
        let folder = tempfile::tempdir().unwrap();
        let text = "a,b,name,w\n0,1,x,1\n0,3,y,3\n10,5,z,1\n10,5,z,0\n";
        let found = quantize_table(&Request {
            weight: Some("w".into()),
            ..request(folder.path(), text, &[])
        })
        .unwrap();
        assert_eq!((found.rows, found.clusters), (4, 2));
        assert_eq!(found.columns, ["a", "b"]);
        // Weights 1 and 3 at b = 1 and 3: the mean is 2.5, the sum of squares 1 * 2.25 + 3 * 0.25.
        assert!((found.weighted_mse - 3.0 / 5.0).abs() < 1e-12);
        let centres = weald_formats::read_table(&folder.path().join("centres.csv")).unwrap();
        assert_eq!(centres.column("b").and_then(Column::numbers).unwrap(), [2.5, 5.0]);
        assert_eq!(centres.column("count").and_then(Column::numbers).unwrap(), [2.0, 2.0]);
    }

    #[test]
    fn what_is_no_number_is_named_by_row_and_column() {
        let folder = tempfile::tempdir().unwrap();
        let message = |text: &str, columns: &[&str], weight: Option<&str>| {
            let request = request(folder.path(), text, columns);
            let request = Request { weight: weight.map(String::from), ..request };
            quantize_table(&request).unwrap_err().to_string()
        };
        let missing = message("a,b\n1,2\n3,\n", &["a", "b"], None);
        assert!(missing.contains("row 2, column `b`"), "{missing}");
        let text = message("a,b\n1,2\n3,tall\n", &["b"], None);
        assert!(text.contains("row 2, column `b`: `tall`"), "{text}");
        let weight = message("a,w\n1,2\n3,-1\n", &["a"], Some("w"));
        assert!(weight.contains("row 2, column `w` is -1"), "{weight}");
        let absent = message("height,w\n1,2\n", &["hight"], None);
        assert!(absent.contains("did you mean `height`"), "{absent}");
    }

    #[test]
    fn parquet_gives_what_csv_gives() {
        let folder = tempfile::tempdir().unwrap();
        let as_csv = request(folder.path(), "a,b\n0,1\n1,1\n7,7\n8,9\n", &["a", "b"]);
        let found = quantize_table(&as_csv).unwrap();
        let table = weald_formats::read_table(&as_csv.table).unwrap();
        let path = folder.path().join("v.parquet");
        weald_formats::write_table(&path, &table, &story(&as_csv).unwrap()).unwrap();
        let again = quantize_table(&Request { table: path, ..as_csv }).unwrap();
        assert_eq!(again.weighted_mse, found.weighted_mse);
    }
}
