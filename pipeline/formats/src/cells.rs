//! Columns gathered cell by cell, where a row names only some of them: GeoJSON and GeoPackage.

use crate::table::{Column, Table};
use std::collections::HashMap;
use std::sync::Arc;

/// One value of a row.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Cell {
    Missing,
    Integer(i64),
    Float(f64),
    Text(String),
}

/// Rows so far, by column, in the order in which columns were first named.
#[derive(Default)]
pub(crate) struct Gathered {
    columns: Vec<(String, Vec<Cell>)>,
    by_name: HashMap<String, usize>,
    rows: usize,
}

impl Gathered {
    /// Makes sure that a column stands in the table even if no row has a value for it.
    pub(crate) fn declare(&mut self, name: &str) -> usize {
        if let Some(&index) = self.by_name.get(name) {
            return index;
        }
        self.by_name.insert(name.into(), self.columns.len());
        self.columns.push((name.into(), Vec::new()));
        self.columns.len() - 1
    }

    /// Sets a value of the row that [`Gathered::end_row`] will end; the last one given counts.
    pub(crate) fn set(&mut self, name: &str, cell: Cell) {
        let index = self.declare(name);
        let cells = &mut self.columns[index].1;
        cells.truncate(self.rows);
        cells.resize(self.rows, Cell::Missing);
        cells.push(cell);
    }

    pub(crate) fn end_row(&mut self) {
        self.rows += 1;
    }

    pub(crate) fn rows(&self) -> usize {
        self.rows
    }

    /// Returns the table: whole numbers, numbers or texts, the first that fits all cells.
    pub(crate) fn table(self) -> Table {
        let rows = self.rows;
        let column = |(name, mut cells): (String, Vec<Cell>)| {
            cells.resize(rows, Cell::Missing);
            (name, column(&cells))
        };
        Table { columns: self.columns.into_iter().map(column).collect() }
    }
}

fn column(cells: &[Cell]) -> Column {
    if cells.iter().any(|cell| matches!(cell, Cell::Text(_))) {
        let mut words: HashMap<String, Arc<str>> = HashMap::new();
        let mut shared = |text: String| {
            words.entry(text.clone()).or_insert_with(|| Arc::from(text.as_str())).clone()
        };
        let texts = cells.iter().map(|cell| {
            shared(match cell {
                Cell::Missing => String::new(),
                Cell::Integer(number) => number.to_string(),
                Cell::Float(number) => number.to_string(),
                Cell::Text(text) => text.clone(),
            })
        });
        return Column::Text(texts.collect());
    }
    let whole: Option<Vec<i64>> = cells
        .iter()
        .map(|cell| if let Cell::Integer(number) = cell { Some(*number) } else { None })
        .collect();
    match whole.filter(|whole| !whole.is_empty()) {
        Some(whole) => Column::Integer(whole),
        None => {
            let number = |cell: &Cell| match cell {
                Cell::Integer(number) => *number as f64,
                Cell::Float(number) => *number,
                Cell::Missing | Cell::Text(_) => f64::NAN,
            };
            Column::Float(cells.iter().map(number).collect())
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_may_leave_columns_out_and_mix_kinds() {
        let mut gathered = Gathered::default();
        gathered.set("n", Cell::Integer(1));
        gathered.end_row();
        gathered.set("word", Cell::Text("oak".into()));
        gathered.set("n", Cell::Integer(2));
        gathered.set("f", Cell::Float(0.5));
        gathered.end_row();
        let table = gathered.table();
        assert_eq!(table.column("n"), Some(&Column::Integer(vec![1, 2])));
        assert_eq!(table.column("word"), Some(&Column::text(["", "oak"])));
        assert!(
            matches!(table.column("f"), Some(Column::Float(f)) if f[0].is_nan() && f[1] == 0.5)
        );
    }
}
