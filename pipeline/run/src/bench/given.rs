//! Inputs of a bench that come from files, so that another program can be given the same.

use crate::error::{Error, Result};
use std::path::Path;
use weald_contract::Raster;
use weald_ecosim::self_thinning::Stem;
use weald_formats::table::{Column, Table, read_table};

/// An elevation model without gaps.
pub(super) fn raster(path: &Path) -> Result<Raster> {
    let raster = weald_formats::read_raster(path)?;
    match raster.grid.values.iter().all(|altitude| altitude.is_finite()) {
        true => Ok(raster),
        false => Err(refused(path, "some cells have no altitude", "a bench needs all of them")),
    }
}

/// Circles from the columns `x`, `y` and `radius`.
pub(super) fn stems(path: &Path) -> Result<Vec<Stem>> {
    let table = read_table(path)?;
    let column = |name: &str| match table.column(name) {
        Some(column) => finite(path, name, column),
        None => Err(refused(path, &format!("no column `{name}`"), "circles have x, y and radius")),
    };
    let (x, y, radius) = (column("x")?, column("y")?, column("radius")?);
    if let Some(row) = radius.iter().position(|radius| *radius < 0.0) {
        let message = format!("the radius of row {} is negative", row + 1);
        return Err(refused(path, &message, "radii are lengths in metres"));
    }
    let stem = |(id, ((x, y), radius)): (usize, ((f64, f64), f64))| Stem {
        id: id as u32,
        x,
        y,
        radius: radius as f32,
    };
    Ok(x.into_iter().zip(y).zip(radius).enumerate().map(stem).collect())
}

/// Rows of all numeric columns; the column `weight`, if there is one, weighs them.
pub(super) fn numbers(path: &Path) -> Result<weald_quantize::Table> {
    let mut table = read_table(path)?;
    let rows = table.rows();
    let weights = match table.take("weight") {
        Some(column) => finite(path, "weight", &column)?,
        None => vec![1.0; rows],
    };
    let columns = numeric_columns(path, &table)?;
    let mut values = Vec::with_capacity(rows * columns.len());
    for row in 0..rows {
        values.extend(columns.iter().map(|column| column[row]));
    }
    weald_quantize::Table::new(values, columns.len(), weights)
        .map_err(|error| refused(path, &error.to_string(), "a bench needs a table of numbers"))
}

fn numeric_columns(path: &Path, table: &Table) -> Result<Vec<Vec<f64>>> {
    let numeric = table.columns.iter().filter(|(_, column)| !matches!(column, Column::Text(_)));
    numeric.map(|(name, column)| finite(path, name, column)).collect()
}

/// The numbers of a column, none of them missing.
fn finite(path: &Path, name: &str, column: &Column) -> Result<Vec<f64>> {
    let values: Vec<f64> = match column {
        Column::Float(values) => values.clone(),
        Column::Float32(values) => values.iter().map(|value| f64::from(*value)).collect(),
        Column::Integer(values) => values.iter().map(|value| *value as f64).collect(),
        Column::Unsigned(values) => values.iter().map(|value| *value as f64).collect(),
        Column::Text(_) => {
            return Err(refused(path, &format!("column `{name}` holds texts"), "numbers"));
        }
    };
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(values),
        Some(row) => {
            let message = format!("column `{name}` has no number in row {}", row + 1);
            Err(refused(path, &message, "fill the gap or leave the row out"))
        }
    }
}

fn refused(path: &Path, message: &str, hint: &str) -> Error {
    Error::plain(format!("{}: {message}", path.display()), hint)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(text: &str) -> tempfile::TempPath {
        let file = tempfile::Builder::new().suffix(".csv").tempfile().unwrap();
        std::fs::write(file.path(), text).unwrap();
        file.into_temp_path()
    }

    #[test]
    fn circles_are_numbered_by_row() {
        let path = file("radius,x,y\n0.5,1,2\n0.25,3,4\n");
        let found = stems(&path).unwrap();
        assert_eq!(found.len(), 2);
        assert_eq!((found[1].x, found[1].y), (3.0, 4.0));
        assert_eq!((found[1].radius, found[1].id), (0.25, 1));
    }

    #[test]
    fn weights_are_no_column_of_the_table() {
        let path = file("a,weight,b\n1,0.5,2\n3,1.5,4\n");
        let found = numbers(&path).unwrap();
        assert_eq!((found.len(), found.columns()), (2, 2));
        assert_eq!(found.row(1), [3.0, 4.0]);
        assert_eq!(found.weights(), [0.5, 1.5]);
    }

    #[test]
    fn what_does_not_fit_is_named() {
        for (text, word) in [
            ("x,y\n1,2\n", "radius"),
            ("x,y,radius\n1,2,-1\n", "negative"),
            ("x,y,radius\n1,2,oak\n", "texts"),
            ("x,y,radius\n1,,3\n", "row 1"),
        ] {
            let path = file(text);
            let message = stems(&path).unwrap_err().to_string();
            assert!(message.contains(word), "{message}");
        }
    }
}
