//! Quantize: rows of numbers to few representatives, in each mode.

use super::{Figure, Size, best, given, wrong};
use crate::error::Result;
use std::path::Path;
use weald_contract::Seed;

pub(super) fn vector_quantization(size: &Size, input: Option<&Path>) -> Result<Vec<Figure>> {
    use weald_quantize::{Mode, cluster};
    const COLUMNS: usize = 4;
    const CLUSTERS: usize = 64;
    let table = match input {
        Some(path) => given::numbers(path)?,
        None => {
            let mut chance = Seed(1).stream("vectors", 0);
            let values = (0..size.vectors * COLUMNS).map(|_| chance.unit()).collect();
            weald_quantize::Table::new(values, COLUMNS, vec![1.0; size.vectors]).map_err(wrong)?
        }
    };
    let input = format!("{} rows of {} to {CLUSTERS}", table.len(), table.columns());
    [
        ("vector quantization, paper", Mode::Paper),
        ("vector quantization, fast", Mode::Fast),
        ("vector quantization, best", Mode::Best),
    ]
    .into_iter()
    .map(|(name, mode)| {
        let (time, found) = best(size, || Ok(cluster(&table, CLUSTERS, mode)))?;
        Ok(Figure::time(name, time, input.clone()).with(found.distortion(&table)))
    })
    .collect()
}
