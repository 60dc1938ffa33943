//! Error and time of clustering on a mixture like the parameters of six species of plants.
//!
//! ```sh
//! cargo run --release -p weald-quantize --example figures -- 100000 4 64 fast
//! cargo run --release -p weald-quantize --example figures -- rows.csv 4 64 best
//! cargo run --release -p weald-quantize --example figures -- chunks:20000000 3 64 fast
//! ```
//!
//! A file holds a header, then rows of as many numbers as are asked for and their weight. Rows in
//! chunks are made whenever they are asked for, which takes most of the time told.

use std::time::Instant;
use weald_contract::{Problem, Seed, Silent};
use weald_quantize::{Chunks, Mode, Streaming, Table, TableError, cluster, cluster_chunks};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let given: Vec<String> = std::env::args().skip(1).collect();
    let word = |at: usize, default: &str| given.get(at).map_or(default, |word| word).to_owned();
    let columns = word(1, "4").parse()?;
    let k: usize = word(2, "64").parse()?;
    let mode = match word(3, "fast").as_str() {
        "paper" => Mode::Paper,
        "best" => Mode::Best,
        _ => Mode::Fast,
    };
    if let Some(rows) = word(0, "").strip_prefix("chunks:") {
        return in_chunks(&Mixture { rows: rows.parse()?, columns }, k, mode);
    }
    let table = match word(0, "100000") {
        path if path.ends_with(".csv") => read(&std::fs::read_to_string(path)?, columns)?,
        rows => mixture(rows.parse()?, columns, 0)?,
    };
    let (began, cpu_before) = (Instant::now(), cpu_seconds());
    let book = cluster(&table, k, mode);
    let (seconds, cpu) = (began.elapsed().as_secs_f64(), cpu_seconds() - cpu_before);
    println!(
        "{} rows of {columns} to {}: weighted mse {:.6e}, {seconds:.3} s, {cpu:.2} s of processor",
        table.len(),
        book.len(),
        book.distortion(&table)
    );
    Ok(())
}

/// A mixture that is made chunk by chunk.
struct Mixture {
    rows: usize,
    columns: usize,
}

const CHUNK: usize = 1 << 17;

impl Chunks for Mixture {
    fn columns(&self) -> usize {
        self.columns
    }

    fn len(&self) -> usize {
        self.rows.div_ceil(CHUNK)
    }

    fn chunk(&self, number: usize) -> Result<Table, Problem> {
        let rows = CHUNK.min(self.rows - number * CHUNK);
        mixture(rows, self.columns, number as u64).map_err(|error| Problem::new(error.to_string()))
    }
}

fn in_chunks(rows: &Mixture, k: usize, mode: Mode) -> Result<(), Box<dyn std::error::Error>> {
    let how = Streaming::new(k, mode);
    let (began, cpu_before) = (Instant::now(), cpu_seconds());
    let found = cluster_chunks(rows, &how, &Silent)?;
    let (seconds, cpu) = (began.elapsed().as_secs_f64(), cpu_seconds() - cpu_before);
    println!(
        "{} rows of {} in chunks to {k}: weighted mse {:.6e}, {seconds:.3} s, {cpu:.2} s of processor, at most {} MB",
        found.rows,
        found.columns,
        found.weighted_mse,
        how.memory(rows.columns, CHUNK, 2) >> 20
    );
    Ok(())
}

/// Ages, vigors and sizes that hang together, with weights of a perspective view: `1/z²`.
fn mixture(rows: usize, columns: usize, chunk: u64) -> Result<Table, TableError> {
    let mut random = Seed(1).stream("mixture", chunk);
    let mut values = Vec::with_capacity(rows * columns);
    let mut weights = Vec::with_capacity(rows);
    for _ in 0..rows {
        let kind = random.below(6) as f64;
        let age = (0.6 * random.normal() + 0.25 * (kind - 2.5)).exp();
        let vigor = (0.5 + 0.2 * random.normal()).clamp(0.0, 1.0);
        let height = age.powf(0.7) * (0.5 + vigor) * (0.1 * random.normal()).exp();
        let lean = random.unit() * random.unit() * (0.5 + 0.1 * kind);
        let root = age.sqrt() / 3.0 * (0.15 * random.normal()).exp();
        let all = [age / 6.0, vigor, height / 5.0, lean, 0.6 * vigor + 0.3 * random.unit(), root];
        let more = (all.len()..columns).map(|_| 0.0);
        values.extend(all.into_iter().chain(more).take(columns));
        weights.push(random.unit().max(0.03).powi(-2));
    }
    Table::new(values, columns, weights)
}

fn read(text: &str, columns: usize) -> Result<Table, Box<dyn std::error::Error>> {
    let (mut values, mut weights) = (Vec::new(), Vec::new());
    for line in text.lines().skip(1) {
        let row = line.split(',').map(str::parse).collect::<Result<Vec<f64>, _>>()?;
        values.extend(row.iter().take(columns));
        weights.extend(row.get(columns));
    }
    Ok(Table::new(values, columns, weights)?)
}

/// Seconds of processor time of all threads; 0 where the system does not tell.
fn cpu_seconds() -> f64 {
    // Hundredths of a second are what every Linux counts for user programs.
    const TICKS: f64 = 100.0;
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let after_name = stat.rsplit(')').next().unwrap_or_default();
    let ticks = after_name.split_whitespace().skip(11).take(2);
    ticks.filter_map(|ticks| ticks.parse::<f64>().ok()).sum::<f64>() / TICKS
}
