//! Clusters of the rows of anyone's table of numbers: `weald quantize --table`.

use crate::error::{Error, Result};
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};
use std::time::Instant;
use weald_contract::source::nearest;
use weald_contract::{Problem, Progress, Sources};
use weald_formats::{Column, Provenance, RowGroups, Table};
use weald_quantize::{Chunks, Codebook, Streamed, Streaming, TableError, cluster, cluster_chunks};

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
    pub rows: u64,
    /// Columns compared.
    pub columns: Vec<String>,
    /// Clusters found; fewer than asked for where there are fewer distinct rows with weight.
    pub clusters: usize,
    /// Weighted mean of the squared distances between rows and their centres.
    pub weighted_mse: f64,
    /// Time to cluster, s; reading is counted only of tables that are read group by group, and
    /// writing never.
    pub seconds: f64,
    /// The table of centres, if it was written.
    pub output: Option<PathBuf>,
}

/// Rows beyond which a Parquet table is read group by group, again and again, instead of held:
/// in memory a row of three numbers and a weight takes up to about 150 bytes, here 2.5 GB.
const LONG_ROWS: u64 = 1 << 24;

/// Clusters the rows of a table, and writes the centres if asked.
///
/// # Errors
/// The table is damaged, lacks a column, or holds what is no number; the disk refuses.
pub fn quantize_table(request: &Request, progress: &dyn Progress) -> Result<Found> {
    let ending = request.table.extension();
    let is_parquet = ending.is_some_and(|ending| ending.eq_ignore_ascii_case("parquet"));
    if is_parquet {
        let groups = RowGroups::open(&request.table)?;
        if groups.rows() > LONG_ROWS {
            return quantize_groups(request, &groups, progress);
        }
    }
    let path = &request.table;
    let table = weald_formats::read_table(path)?;
    let part = Part { path, table: &table, first_row: 0 };
    let columns = chosen(request, &table)?;
    let rows = part.numbers(&columns, request.weight.as_deref())?;
    drop(table);
    let began = Instant::now();
    let book = cluster(&rows, request.clusters, request.mode);
    let seconds = began.elapsed().as_secs_f64();
    let clusters = Clusters::of_book(&book, &rows);
    write_centres(request, &columns, &clusters)?;
    Ok(Found {
        rows: rows.len() as u64,
        clusters: book.len(),
        weighted_mse: book.distortion(&rows),
        columns,
        seconds,
        output: request.output.clone(),
    })
}

/// Lloyd's steps of all rows after the sample's clusters: none where splitting is to be alone, and
/// a second and third after a longer search, which gain what the sample did not know.
fn steps(mode: Mode) -> usize {
    match mode {
        Mode::Paper => 0,
        Mode::Fast => 1,
        Mode::Best | Mode::Exact => 3,
    }
}

/// [`quantize_table`] of a table longer than memory.
fn quantize_groups(
    request: &Request,
    groups: &RowGroups,
    progress: &dyn Progress,
) -> Result<Found> {
    if request.mode == Mode::Exact {
        let message = format!("{} rows are too many for `exact`", groups.rows());
        return Err(Error::plain(message, format!("it holds up to {LONG_ROWS}; choose `best`")));
    }
    let columns = chosen(request, &groups.read(0, &|_| true)?)?;
    let began = Instant::now();
    let weight = request.weight.as_deref();
    let chunks = Groups { path: &request.table, groups, columns: &columns, weight };
    let streaming = Streaming::new(request.clusters, request.mode);
    let streaming = Streaming { steps: steps(request.mode), ..streaming };
    let found = cluster_chunks(&chunks, &streaming, progress).map_err(|error| match error {
        weald_quantize::Error::Problem(problem) => Error::wrong(&Sources::default(), problem),
        weald_quantize::Error::Cancelled => Error::Stopped { saved: false },
    })?;
    let seconds = began.elapsed().as_secs_f64();
    let clusters = Clusters::of_streamed(&found);
    write_centres(request, &columns, &clusters)?;
    Ok(Found {
        rows: found.rows,
        clusters: clusters.counts.len(),
        weighted_mse: found.weighted_mse,
        columns,
        seconds,
        output: request.output.clone(),
    })
}

/// The row groups of a file as chunks of a long table.
struct Groups<'a> {
    path: &'a Path,
    groups: &'a RowGroups,
    columns: &'a [String],
    weight: Option<&'a str>,
}

impl Chunks for Groups<'_> {
    fn columns(&self) -> usize {
        self.columns.len()
    }

    fn len(&self) -> usize {
        self.groups.len()
    }

    fn chunk(&self, number: usize) -> Result<weald_quantize::Table, Problem> {
        let is_wanted =
            |name: &str| self.weight == Some(name) || self.columns.iter().any(|c| c == name);
        let read = || {
            let table = self.groups.read(number, &is_wanted)?;
            let first_row = self.groups.first_row(number);
            Part { path: self.path, table: &table, first_row }.numbers(self.columns, self.weight)
        };
        read().map_err(|error: Error| match error {
            Error::Wrong { problems, .. } if !problems.is_empty() => problems[0].clone(),
            other => Problem::new(other.to_string()),
        })
    }
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

/// Consecutive rows of a table's file.
#[derive(Clone, Copy)]
struct Part<'a> {
    path: &'a Path,
    table: &'a Table,
    /// Row of the file, from 0, at which the part begins.
    first_row: u64,
}

impl Part<'_> {
    fn numbers(&self, names: &[String], weight: Option<&str>) -> Result<weald_quantize::Table> {
        let columns =
            names.iter().map(|name| self.column(name)).collect::<Result<Vec<Vec<f64>>>>()?;
        let weights = match weight {
            Some(name) => self.column(name)?,
            None => vec![1.0; self.table.rows()],
        };
        let mut values = Vec::with_capacity(self.table.rows() * columns.len());
        for row in 0..self.table.rows() {
            values.extend(columns.iter().map(|column| column[row]));
        }
        weald_quantize::Table::new(values, columns.len(), weights)
            .map_err(|error| self.not_a_number(names, weight, error))
    }

    /// A column of numbers; a text among them is named by its row.
    fn column(&self, name: &str) -> Result<Vec<f64>> {
        let path = self.path.display();
        let Some(found) = self.table.column(name) else {
            let known: Vec<&str> =
                self.table.columns.iter().map(|(name, _)| name.as_str()).collect();
            let hint = match nearest(name, known.iter().copied()) {
                Some(near) => format!("did you mean `{near}`?"),
                None => format!("it has: {}", known.join(", ")),
            };
            return Err(Error::plain(format!("{path} has no column `{name}`"), hint));
        };
        if let Some(values) = found.numbers() {
            return Ok(values);
        }
        let texts = found.texts().unwrap_or_default();
        let row = texts.iter().position(|text| !text.is_empty() && text.parse::<f64>().is_err());
        let at = row.map_or(String::new(), |row| format!("row {}, ", self.number(row)));
        let text = row.and_then(|row| texts.get(row)).map_or("", |text| text);
        let message = format!("{path}, {at}column `{name}`: `{text}` is no number");
        Err(Error::plain(message, "leave the column or the row out"))
    }

    /// A row as a reader of the file counts it: from 1, below the header.
    fn number(&self, row: usize) -> u64 {
        self.first_row + row as u64 + 1
    }

    /// The error of a table, with its row and what stands there.
    fn not_a_number(&self, names: &[String], weight: Option<&str>, error: TableError) -> Error {
        let path = self.path.display();
        let (row, name) = match &error {
            TableError::NotFinite { row, column } => (*row, names.get(*column).map(String::as_str)),
            TableError::BadWeight { row } => (*row, weight),
            _ => return Error::plain(format!("{path}: {error}"), "use a shorter table"),
        };
        let name = name.unwrap_or_default();
        let values = self.table.column(name).and_then(Column::numbers);
        let value = values.and_then(|values| values.get(row).copied()).unwrap_or(f64::NAN);
        let value = if value.is_nan() { "missing or NaN".to_string() } else { value.to_string() };
        let right = match error {
            TableError::BadWeight { .. } => "a finite number of at least 0 is right",
            _ => "a finite number is right",
        };
        let message = format!("{path}, row {}, column `{name}` is {value}", self.number(row));
        Error::plain(message, right)
    }
}

/// Name of the columns of rows and weight that a cluster stands for.
const COUNT: &str = "count";
const WEIGHT: &str = "weight";

/// Centres, and how many rows of what weight each stands for.
struct Clusters {
    /// Centre after centre.
    centres: Vec<f64>,
    counts: Vec<u64>,
    weights: Vec<f64>,
}

impl Clusters {
    fn of_book(book: &Codebook, rows: &weald_quantize::Table) -> Self {
        let mut counts = vec![0u64; book.len()];
        let mut weights = vec![0.0; book.len()];
        for (label, weight) in book.labels.iter().zip(rows.weights()) {
            counts[*label as usize] += 1;
            weights[*label as usize] += weight;
        }
        Self { centres: book.centres.clone(), counts, weights }
    }

    /// Centres that a step left without rows are no clusters.
    fn of_streamed(found: &Streamed) -> Self {
        let mut clusters = Self { centres: Vec::new(), counts: Vec::new(), weights: Vec::new() };
        let all = found.centres.chunks_exact(found.columns).zip(&found.counts).zip(&found.weights);
        for ((centre, count), weight) in all.filter(|((_, count), _)| **count > 0) {
            clusters.centres.extend(centre);
            clusters.counts.push(*count);
            clusters.weights.push(*weight);
        }
        clusters
    }

    /// A row a cluster.
    fn table(&self, columns: &[String]) -> Table {
        let values = |column: usize| {
            self.centres.iter().skip(column).step_by(columns.len()).copied().collect()
        };
        let mut table = Table::default();
        for (index, name) in columns.iter().enumerate() {
            table = table.with(name, Column::Float(values(index)));
        }
        let is_free = |name: &str| !columns.iter().any(|column| column == name);
        let more = [
            (COUNT, Column::Unsigned(self.counts.clone())),
            (WEIGHT, Column::Float(self.weights.clone())),
        ];
        more.into_iter()
            .filter(|(name, _)| is_free(name))
            .fold(table, |table, (name, column)| table.with(name, column))
    }
}

fn write_centres(request: &Request, columns: &[String], clusters: &Clusters) -> Result<()> {
    let Some(output) = &request.output else { return Ok(()) };
    Ok(weald_formats::write_table(output, &clusters.table(columns), &story(request)?)?)
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
    use weald_contract::{Seed, Silent};

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
        let found = quantize_table(
            &Request { weight: Some("w".into()), ..request(folder.path(), text, &[]) },
            &Silent,
        )
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
            quantize_table(&request, &Silent).unwrap_err().to_string()
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
        let found = quantize_table(&as_csv, &Silent).unwrap();
        let table = weald_formats::read_table(&as_csv.table).unwrap();
        let path = folder.path().join("v.parquet");
        weald_formats::write_table(&path, &table, &story(&as_csv).unwrap()).unwrap();
        let again = quantize_table(&Request { table: path, ..as_csv }, &Silent).unwrap();
        assert_eq!(again.weighted_mse, found.weighted_mse);
    }

    /// A Parquet table of two row groups, with one value replaced.
    fn long(folder: &Path, bad: Option<(usize, f64)>) -> Request {
        const ROWS: usize = 150_000;
        let mut random = Seed(4).stream("long", 0);
        let mut columns = [Vec::new(), Vec::new(), Vec::new()];
        for _ in 0..ROWS {
            let kind = random.below(6) as f64;
            columns[0].push(kind + 0.2 * random.normal());
            columns[1].push(kind * kind / 6.0 + 0.3 * random.normal());
            columns[2].push(random.unit());
        }
        if let Some((row, value)) = bad {
            columns[1][row] = value;
        }
        let [a, b, w] = columns.map(Column::Float);
        let table = Table::default().with("a", a).with("b", b).with("w", w);
        let request = Request {
            table: folder.join("long.parquet"),
            weight: Some("w".into()),
            clusters: 24,
            mode: Mode::Fast,
            ..request(folder, "a\n1\n", &[])
        };
        // The story needs a file to tell of; the table is not there yet.
        let story = story(&Request { table: folder.join("v.csv"), ..request.clone() }).unwrap();
        weald_formats::write_table(&request.table, &table, &story).unwrap();
        request
    }

    #[test]
    fn groups_of_rows_are_clustered_about_as_well_as_all_at_once() {
        let folder = tempfile::tempdir().unwrap();
        let request = long(folder.path(), None);
        let whole = quantize_table(&request, &Silent).unwrap();
        let groups = RowGroups::open(&request.table).unwrap();
        assert_eq!(groups.len(), 2);
        let found = quantize_groups(&request, &groups, &Silent).unwrap();
        assert!((0.98..1.03).contains(&(found.weighted_mse / whole.weighted_mse)));
        assert_eq!((found.rows, &found.columns), (whole.rows, &whole.columns));
        let centres = weald_formats::read_table(&folder.path().join("centres.csv")).unwrap();
        let counts = centres.column("count").and_then(Column::numbers).unwrap();
        assert_eq!((counts.len(), counts.iter().sum::<f64>()), (found.clusters, 150_000.0));
        // Splitting alone, of a sample that holds all rows, gives the clusters of splitting alone,
        // with each row at the nearest centre.
        let paper = Request { mode: Mode::Paper, ..request };
        let alone = quantize_groups(&paper, &groups, &Silent).unwrap();
        assert!(alone.weighted_mse <= quantize_table(&paper, &Silent).unwrap().weighted_mse);
        assert!(alone.weighted_mse > found.weighted_mse);
    }

    #[test]
    fn a_hole_in_a_later_group_is_named_by_its_row_in_the_file() {
        let folder = tempfile::tempdir().unwrap();
        let request = long(folder.path(), Some((140_000, f64::NAN)));
        let groups = RowGroups::open(&request.table).unwrap();
        let hole = quantize_groups(&request, &groups, &Silent).unwrap_err().to_string();
        assert!(hole.contains("row 140001, column `b`"), "{hole}");
        let absent = Request { columns: vec!["a".into(), "bb".into()], ..request.clone() };
        let absent = quantize_groups(&absent, &groups, &Silent).unwrap_err().to_string();
        assert!(absent.contains("no column `bb`"), "{absent}");
        let exact = Request { mode: Mode::Exact, ..request };
        let exact = quantize_groups(&exact, &groups, &Silent).unwrap_err().to_string();
        assert!(exact.contains("too many for `exact`"), "{exact}");
    }
}
