//! GeoPackage [GPKG]: the points of its layer become a table, a row a feature.

use crate::cells::{Cell, Gathered};
use crate::error::{Error, Result};
use crate::sqlite::{Database, Row, Stored, Value};
use crate::table::Table;
use std::path::Path;
use weald_contract::Crs;

/// Reads the points of the only layer, and their attributes.
pub(crate) fn read(path: &Path) -> Result<(Table, Crs)> {
    points(path, &Database::open(path)?)
}

fn points(path: &Path, database: &Database) -> Result<(Table, Crs)> {
    let no_layer = |message: &str| Error::invalid(path, message, "a layer of points is read");
    let contents = rows(path, database, "gpkg_contents", &["table_name", "data_type"])?;
    let is_layer = |row: &&Vec<Value>| row[1].text() == Some("features");
    let layers: Vec<&str> =
        contents.iter().filter(is_layer).filter_map(|row| row[0].text()).collect();
    let layer = match &layers[..] {
        [only] => *only,
        [] => return Err(no_layer("this GeoPackage has no layer of features")),
        several => {
            let message = format!("it has {} layers: {}", several.len(), several.join(", "));
            return Err(Error::invalid(path, message, "export the one you mean to its own file"));
        }
    };
    let known = ["table_name", "column_name", "srs_id"];
    let geometries = rows(path, database, "gpkg_geometry_columns", &known)?;
    let own = geometries.iter().find(|row| row[0].text() == Some(layer));
    let own = own.ok_or_else(|| no_layer("its layer has no geometry"))?;
    let geometry = own[1].text().unwrap_or_default();
    let crs = reference_system(path, database, own[2].whole().unwrap_or(0))?;
    let table = table(path, database, layer)?;
    let Some(at) = table.columns.iter().position(|(name, _)| name == geometry) else {
        return Err(no_layer(&format!("layer `{layer}` has no column `{geometry}`")));
    };
    let mut gathered = Gathered::default();
    for name in ["x", "y"] {
        gathered.declare(name);
    }
    for row in database.rows_of(&table)? {
        let [x, y] = row.values.get(at).and_then(point).ok_or_else(|| Error::Cell {
            path: path.into(),
            row: gathered.rows() as u64 + 1,
            column: geometry.into(),
            message: "expected a point with a place".into(),
        })?;
        for (index, (name, is_number)) in table.columns.iter().enumerate() {
            match row.values.get(index) {
                _ if *is_number => gathered.set(name, Cell::Integer(row.number)),
                Some(Value::Cell(cell)) => gathered.set(name, cell.clone()),
                // Columns added later are missing in older rows; blobs are no attributes.
                Some(Value::Blob(_)) | None => {}
            }
        }
        // Places last: the geometry counts, also where attributes are called x and y.
        gathered.set("x", Cell::Float(x));
        gathered.set("y", Cell::Float(y));
        gathered.end_row();
    }
    Ok((gathered.table(), crs))
}

fn table(path: &Path, database: &Database, name: &str) -> Result<Stored> {
    database.table(name)?.ok_or_else(|| {
        Error::invalid(path, format!("it has no table `{name}`"), "a GeoPackage is expected")
    })
}

/// Some columns of all rows of a table, in the order asked for.
fn rows(path: &Path, database: &Database, name: &str, columns: &[&str]) -> Result<Vec<Vec<Value>>> {
    let stored = table(path, database, name)?;
    let place = |column: &&str| stored.columns.iter().position(|(own, _)| own == column);
    let places: Option<Vec<usize>> = columns.iter().map(place).collect();
    let places = places.ok_or_else(|| {
        Error::invalid(path, format!("its table `{name}` lacks a column"), columns.join(", "))
    })?;
    let chosen = |row: Row| {
        let value = |&place: &usize| match row.values.get(place) {
            _ if stored.columns[place].1 => Value::Cell(Cell::Integer(row.number)),
            Some(value) => value.clone(),
            None => Value::Cell(Cell::Missing),
        };
        places.iter().map(value).collect()
    };
    Ok(database.rows_of(&stored)?.into_iter().map(chosen).collect())
}

/// The system with this number in the file's own list; none for numbers below 1, which mean that
/// it is not known [GPKG] §1.1.2.
fn reference_system(path: &Path, database: &Database, id: i64) -> Result<Crs> {
    let names = ["srs_id", "organization", "organization_coordsys_id", "definition"];
    let systems = rows(path, database, "gpkg_spatial_ref_sys", &names)?;
    let Some(system) = systems.iter().find(|row| row[0].whole() == Some(id) && id > 0) else {
        return Ok(Crs::default());
    };
    let is_epsg = system[1].text().is_some_and(|name| name.eq_ignore_ascii_case("EPSG"));
    let epsg = system[2].whole().and_then(|code| u32::try_from(code).ok()).filter(|_| is_epsg);
    let definition = system[3].text().unwrap_or_default().trim_start();
    let is_geographic = ["GEOGCS", "GEOGCRS", "GEODCRS"].iter().any(|d| definition.starts_with(d));
    Ok(Crs { epsg, is_geographic, ..Crs::default() })
}

/// The place of a geometry in GeoPackage's binary form [GPKG] §2.1.3: a header, then WKB.
fn point(value: &Value) -> Option<[f64; 2]> {
    let Value::Blob(blob) = value else { return None };
    let [b'G', b'P', _, flags, ..] = blob[..] else { return None };
    let envelope = match flags >> 1 & 7 {
        0 => 0,
        1 => 32,
        2 | 3 => 48,
        4 => 64,
        _ => return None,
    };
    well_known_point(blob.get(8 + envelope..)?)
}

/// The place of a WKB point, with or without further coordinates, or of a collection of one.
fn well_known_point(bytes: &[u8]) -> Option<[f64; 2]> {
    let (&order, rest) = bytes.split_first()?;
    let word = |bytes: &[u8]| {
        let four = bytes.first_chunk::<4>().copied()?;
        Some(if order == 0 { u32::from_be_bytes(four) } else { u32::from_le_bytes(four) })
    };
    let number = |at: usize| {
        let eight = rest.get(at..)?.first_chunk::<8>().copied()?;
        let number = if order == 0 { f64::from_be_bytes(eight) } else { f64::from_le_bytes(eight) };
        Some(number).filter(|number| number.is_finite())
    };
    match word(rest)? {
        1 | 1001 | 2001 | 3001 => Some([number(4)?, number(12)?]),
        // A multipoint of one: its only part begins after the count.
        4 | 1004 | 2004 | 3004 if word(rest.get(4..)?)? == 1 => {
            let part = rest.get(8..)?;
            let is_point = |kind: u32| matches!(kind, 1 | 1001 | 2001 | 3001);
            word(part.get(1..)?).filter(|kind| is_point(*kind)).and_then(|_| well_known_point(part))
        }
        _ => None,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Column;
    use proptest::prelude::*;

    /// Written by `tests/data/trees.py` with Python's SQLite.
    const TREES: &[u8] = include_bytes!("../tests/data/trees.gpkg");

    fn read(bytes: Vec<u8>) -> Result<(Table, Crs)> {
        let path = Path::new("trees.gpkg");
        points(path, &Database::new(path, bytes)?)
    }

    #[test]
    fn a_layer_written_by_another_program_is_read() {
        let (table, crs) = read(TREES.to_vec()).unwrap();
        // The rows are what the script wrote: enough of them for several levels of pages.
        let rows = 700;
        let numbers = |name: &str| table.column(name).and_then(Column::numbers).unwrap();
        let expected = |value: fn(f64) -> f64| {
            (0..rows).map(|row| value(f64::from(row))).collect::<Vec<f64>>()
        };
        assert_eq!(numbers("x"), expected(|row| 481_000.0 + row));
        assert_eq!(numbers("y"), expected(|row| 5_250_000.0 - 0.5 * row));
        assert_eq!(numbers("fid"), expected(|row| row + 1.0));
        assert_eq!(numbers("dbh_cm"), expected(|row| row / 8.0));
        let species = table.column("species").and_then(Column::texts).unwrap();
        assert_eq!((&*species[0], &*species[1], &*species[699]), ("oak", "ash", "ash"));
        // A text longer than a page stands in a chain of overflow pages.
        let notes = table.column("note").and_then(Column::texts).unwrap();
        assert_eq!((&*notes[3], notes[4].len()), ("", 9000));
        assert!(notes[4].bytes().all(|byte| byte == b'n'));
        assert_eq!((crs.epsg, crs.is_geographic), (Some(26915), false));
    }

    #[test]
    fn what_is_no_geopackage_says_so() {
        assert!(read(Vec::new()).unwrap_err().to_string().contains("no SQLite database"));
        let mut utf16 = TREES.to_vec();
        utf16[59] = 2;
        assert!(read(utf16).unwrap_err().to_string().contains("UTF-8"));
        assert!(read(TREES[..2048].to_vec()).is_err());
    }

    #[test]
    fn points_of_both_byte_orders_and_dimensions_are_read() {
        let wkb = |order: u8, kind: u32, numbers: &[f64]| {
            let mut bytes = vec![order];
            let big = order == 0;
            bytes.extend(if big { kind.to_be_bytes() } else { kind.to_le_bytes() });
            for number in numbers {
                bytes.extend(if big { number.to_be_bytes() } else { number.to_le_bytes() });
            }
            bytes
        };
        assert_eq!(well_known_point(&wkb(0, 1, &[1.5, -2.0])), Some([1.5, -2.0]));
        assert_eq!(well_known_point(&wkb(1, 1001, &[1.5, -2.0, 9.0])), Some([1.5, -2.0]));
        assert_eq!(well_known_point(&wkb(1, 2, &[1.5, -2.0])), None);
        // An empty point has coordinates that are no numbers.
        assert_eq!(well_known_point(&wkb(1, 1, &[f64::NAN, f64::NAN])), None);
        let mut several = vec![1, 4, 0, 0, 0, 1, 0, 0, 0];
        several.extend(wkb(1, 1, &[3.0, 4.0]));
        assert_eq!(well_known_point(&several), Some([3.0, 4.0]));
    }

    proptest! {
        #[test]
        fn damaged_files_are_refused_or_read_but_never_panic(
            changes in prop::collection::vec((0..TREES.len(), any::<u8>()), 1..20),
            length in 0..=TREES.len(),
        ) {
            let mut bytes = TREES.to_vec();
            changes.iter().for_each(|(at, byte)| bytes[*at] = *byte);
            bytes.truncate(length.max(TREES.len() / 2));
            let _ = read(bytes);
        }
    }
}
