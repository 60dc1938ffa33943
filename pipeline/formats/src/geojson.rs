//! GeoJSON [RFC7946]: a feature collection of points becomes a table, a row a feature.
//!
//! Properties are columns; a point's coordinates are the columns `x` and `y`. The standard knows
//! longitude and latitude only, but the member `crs` of its predecessor, which QGIS and GDAL
//! still write for maps in metres, is understood.

use crate::bytes::{MAX_FILE_BYTES, read_text};
use crate::cells::{Cell, Gathered};
use crate::error::{Error, Result};
use crate::table::{MAX_ROWS, Table};
use serde_json::Value as Json;
use std::path::Path;
use weald_contract::Crs;

/// Reads points and their properties.
pub(crate) fn read(path: &Path) -> Result<(Table, Crs)> {
    parse(path, &read_text(path, MAX_FILE_BYTES)?)
}

/// Reads points from text; `path` is for messages only.
pub(crate) fn parse(path: &Path, text: &str) -> Result<(Table, Crs)> {
    let json: Json = serde_json::from_str(text)
        .map_err(|error| Error::invalid(path, format!("this is not JSON: {error}"), ""))?;
    let features = json.get("features").and_then(Json::as_array).ok_or_else(|| {
        let hint = "an object of type `FeatureCollection` with a list `features` is read";
        Error::invalid(path, "this is no GeoJSON collection of features", hint)
    })?;
    if features.len() > MAX_ROWS {
        let hint = format!("at most {MAX_ROWS}");
        return Err(Error::invalid(path, "there are too many features", hint));
    }
    let mut gathered = Gathered::default();
    for name in ["x", "y"] {
        gathered.declare(name);
    }
    for (row, feature) in features.iter().enumerate() {
        for (name, value) in
            feature.get("properties").and_then(Json::as_object).into_iter().flatten()
        {
            gathered.set(name, cell(value));
        }
        // Places last: the geometry counts, also where properties are called x and y.
        let [x, y] = point(path, row, feature.get("geometry"))?;
        gathered.set("x", Cell::Float(x));
        gathered.set("y", Cell::Float(y));
        gathered.end_row();
    }
    Ok((gathered.table(), reference_system(&json)))
}

fn cell(value: &Json) -> Cell {
    match value {
        Json::Null | Json::Array(_) | Json::Object(_) => Cell::Missing,
        Json::Bool(is_true) => Cell::Integer(i64::from(*is_true)),
        Json::String(text) => Cell::Text(text.clone()),
        Json::Number(number) => match number.as_i64() {
            Some(whole) => Cell::Integer(whole),
            None => Cell::Float(number.as_f64().unwrap_or(f64::NAN)),
        },
    }
}

fn point(path: &Path, row: usize, geometry: Option<&Json>) -> Result<[f64; 2]> {
    let wrong = |message: String| Error::Cell {
        path: path.into(),
        row: row as u64 + 1,
        column: "geometry".into(),
        message,
    };
    let geometry = geometry.filter(|geometry| !geometry.is_null());
    let geometry = geometry.ok_or_else(|| wrong("the feature has no geometry".into()))?;
    let kind = geometry.get("type").and_then(Json::as_str).unwrap_or("nothing");
    let coordinates = geometry.get("coordinates");
    let coordinates = match kind {
        "Point" => coordinates,
        // What many programs make of a layer of points.
        "MultiPoint" => coordinates.and_then(Json::as_array).and_then(|points| match &points[..] {
            [only] => Some(only),
            _ => None,
        }),
        other => {
            let shown: String = other.chars().take(40).collect();
            return Err(wrong(format!("expected a Point, found `{shown}`")));
        }
    };
    let axis = |index: usize| coordinates?.get(index)?.as_f64().filter(|number| number.is_finite());
    match (axis(0), axis(1)) {
        (Some(x), Some(y)) => Ok([x, y]),
        _ => Err(wrong(format!("this {kind} does not have the coordinates of one place"))),
    }
}

/// The system that `crs` names, as `EPSG:26915` or `urn:ogc:def:crs:EPSG::26915`; without it
/// WGS 84 longitude and latitude [RFC7946] §4.
fn reference_system(json: &Json) -> Crs {
    let name = json.pointer("/crs/properties/name").and_then(Json::as_str);
    let code = name.and_then(|name| name.rsplit(':').next()?.parse().ok());
    match code {
        Some(epsg) => Crs { epsg: Some(epsg), is_geographic: epsg == 4326, ..Crs::default() },
        None => Crs { epsg: Some(4326), is_geographic: true, ..Crs::default() },
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Column;
    use proptest::prelude::*;

    /// An example in the form of [RFC7946] §1.5, with a point and its properties.
    const TREES: &str = r#"{ "type": "FeatureCollection", "features": [
        { "type": "Feature", "geometry": { "type": "Point", "coordinates": [102.0, 0.5] },
          "properties": { "species": "oak", "height_m": 12.5, "tag": 7 } },
        { "type": "Feature", "geometry": { "type": "MultiPoint", "coordinates": [[102.5, 0.25, 9]] },
          "properties": { "species": "ash", "tag": 8, "note": null } } ] }"#;

    #[test]
    fn points_and_properties_become_rows() {
        let (table, crs) = parse(Path::new("trees.geojson"), TREES).unwrap();
        assert_eq!(table.column("x"), Some(&Column::Float(vec![102.0, 102.5])));
        assert_eq!(table.column("y"), Some(&Column::Float(vec![0.5, 0.25])));
        assert_eq!(table.column("tag"), Some(&Column::Integer(vec![7, 8])));
        assert!(matches!(table.column("height_m"), Some(Column::Float(h)) if h[1].is_nan()));
        assert!(crs.is_geographic);
        table.check(Path::new("trees.geojson")).unwrap();
    }

    #[test]
    fn the_old_member_crs_names_a_map_in_metres() {
        let text = TREES.replacen(
            '{',
            r#"{ "crs": { "type": "name", "properties": { "name": "urn:ogc:def:crs:EPSG::26915" } },"#,
            1,
        );
        let (_, crs) = parse(Path::new("trees.geojson"), &text).unwrap();
        assert_eq!((crs.epsg, crs.is_geographic), (Some(26915), false));
    }

    #[test]
    fn what_is_no_point_is_named_by_its_row() {
        let text = TREES.replace("MultiPoint", "Polygon");
        let error = parse(Path::new("trees.geojson"), &text).unwrap_err().to_string();
        assert_eq!(
            error,
            "trees.geojson, row 2, column `geometry`: expected a Point, found `Polygon`"
        );
        for text in
            ["", "[]", "{\"features\": 3}", "{\"features\": [null]}", "{\"features\": [{}]}"]
        {
            assert!(parse(Path::new("t.geojson"), text).is_err(), "{text}");
        }
    }

    proptest! {
        #[test]
        fn damaged_text_is_refused_or_read_but_never_panics(
            at in 0..TREES.len(),
            with in "[\\[\\]{}\",:0-9a-z]{0,3}",
        ) {
            let mut text = TREES.to_string();
            text.replace_range(at..at + 1, &with);
            let _ = parse(Path::new("t.geojson"), &text);
        }
    }
}
