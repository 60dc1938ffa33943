//! Any table of numbers, checked: the input of clustering.

/// Rows of numbers with a weight each.
#[derive(Clone, Debug, PartialEq)]
pub struct Table {
    /// Row after row.
    values: Vec<f64>,
    columns: usize,
    /// One a row, finite and not negative.
    weights: Vec<f64>,
}

/// Why numbers are no table.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TableError {
    /// No columns.
    #[error("a table needs at least one column")]
    NoColumns,
    /// The number of values is not rows times columns.
    #[error("{values} values do not fill {rows} rows of {columns} columns")]
    Ragged {
        /// Values given.
        values: usize,
        /// Weights given, one a row.
        rows: usize,
        /// Columns asked for.
        columns: usize,
    },
    /// More rows than labels can number.
    #[error("{rows} rows are too many; at most {} are clustered at once", u32::MAX)]
    TooLong {
        /// Rows given.
        rows: usize,
    },
    /// NaN or an infinity.
    #[error("row {row}, column {column} is not a finite number")]
    NotFinite {
        /// Row, from 0.
        row: usize,
        /// Column, from 0.
        column: usize,
    },
    /// A weight below zero, NaN or an infinity.
    #[error("the weight of row {row} is not a finite number of at least 0")]
    BadWeight {
        /// Row, from 0.
        row: usize,
    },
}

impl Table {
    /// Makes a table from `values`, row after row, and a weight for each row.
    ///
    /// # Errors
    /// See [`TableError`]. An empty table is one, with no rows.
    pub fn new(values: Vec<f64>, columns: usize, weights: Vec<f64>) -> Result<Self, TableError> {
        let rows = weights.len();
        if columns == 0 {
            return Err(TableError::NoColumns);
        }
        if rows.checked_mul(columns) != Some(values.len()) {
            return Err(TableError::Ragged { values: values.len(), rows, columns });
        }
        if u32::try_from(rows).is_err() {
            return Err(TableError::TooLong { rows });
        }
        if let Some(at) = values.iter().position(|value| !value.is_finite()) {
            return Err(TableError::NotFinite { row: at / columns, column: at % columns });
        }
        if let Some(row) = weights.iter().position(|w| !(w.is_finite() && *w >= 0.0)) {
            return Err(TableError::BadWeight { row });
        }
        Ok(Self { values, columns, weights })
    }

    /// Number of rows.
    pub fn len(&self) -> usize {
        self.weights.len()
    }

    /// Whether there is no row.
    pub fn is_empty(&self) -> bool {
        self.weights.is_empty()
    }

    /// Number of columns.
    pub fn columns(&self) -> usize {
        self.columns
    }

    /// The numbers of a row.
    ///
    /// # Panics
    /// When there is no such row.
    pub fn row(&self, index: usize) -> &[f64] {
        &self.values[index * self.columns..][..self.columns]
    }

    /// All weights, one a row.
    pub fn weights(&self) -> &[f64] {
        &self.weights
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_number_that_is_not_finite_is_named_by_row_and_column() {
        let table = Table::new(vec![0.0, 1.0, 2.0, f64::NAN], 2, vec![1.0; 2]);
        assert_eq!(table, Err(TableError::NotFinite { row: 1, column: 1 }));
    }

    #[test]
    fn weights_are_finite_and_not_negative() {
        for bad in [-1.0, f64::NAN, f64::INFINITY] {
            let table = Table::new(vec![0.0, 1.0], 1, vec![1.0, bad]);
            assert_eq!(table, Err(TableError::BadWeight { row: 1 }));
        }
    }

    #[test]
    fn values_must_fill_the_rows() {
        assert!(matches!(
            Table::new(vec![0.0; 5], 2, vec![1.0; 2]),
            Err(TableError::Ragged { .. })
        ));
        assert_eq!(Table::new(vec![], 0, vec![]), Err(TableError::NoColumns));
        assert!(Table::new(vec![], 3, vec![]).is_ok_and(|table| table.is_empty()));
    }
}
