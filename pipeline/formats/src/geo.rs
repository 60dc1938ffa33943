//! Reference systems in tables: our own record, and GeoParquet's for other programs.

use serde::{Deserialize, Serialize};
use serde_json::{Value as Json, json};
use weald_contract::Crs;

/// Key of our record in Parquet's metadata and a CSV's companion.
pub(crate) const CRS_KEY: &str = "weald_crs";

/// A reference system as JSON; the raw geokeys make a round trip exact.
#[derive(Serialize, Deserialize)]
#[serde(default)]
#[derive(Default)]
struct Record {
    epsg: Option<u32>,
    is_geographic: bool,
    keys: Vec<u16>,
    doubles: Vec<f64>,
    ascii: String,
}

/// Our record of a reference system.
pub(crate) fn to_json(crs: &Crs) -> Json {
    let Crs { epsg, is_geographic, keys, doubles, ascii } = crs.clone();
    serde_json::to_value(Record { epsg, is_geographic, keys, doubles, ascii }).unwrap_or_default()
}

/// The reference system of a record; an empty one when it is not ours.
pub(crate) fn from_json(json: Option<&Json>) -> Crs {
    let record: Option<Record> = json.and_then(|json| serde_json::from_value(json.clone()).ok());
    let Record { epsg, is_geographic, keys, doubles, ascii } = record.unwrap_or_default();
    Crs { epsg, is_geographic, keys, doubles, ascii }
}

/// GeoParquet's `geo` entry for a column of points [GeoParquet] 1.1.
pub(crate) fn geoparquet(crs: &Crs, x: &[f64], y: &[f64]) -> Json {
    let mut column = json!({
        "encoding": "WKB",
        "geometry_types": ["Point"],
        // Absent would mean longitude and latitude; null means unknown.
        "crs": crs.epsg.and_then(projjson),
    });
    if let (Some((west, east)), Some((south, north))) = (extent(x), extent(y)) {
        column["bbox"] = json!([west, south, east, north]);
    }
    json!({
        "version": "1.1.0",
        "primary_column": "geometry",
        "columns": { "geometry": column },
    })
}

fn extent(numbers: &[f64]) -> Option<(f64, f64)> {
    let low = numbers.iter().copied().reduce(f64::min)?;
    let high = numbers.iter().copied().reduce(f64::max)?;
    (low.is_finite() && high.is_finite()).then_some((low, high))
}

/// The reference system that a foreign GeoParquet file names, by its EPSG code.
pub(crate) fn from_geoparquet(geo: Option<&Json>) -> Crs {
    let crs = geo.and_then(|geo| {
        let name = geo.get("primary_column")?.as_str()?;
        geo.get("columns")?.get(name)?.get("crs")
    });
    let id = crs.and_then(|crs| crs.get("id"));
    let is_epsg = id.and_then(|id| id.get("authority")).is_some_and(|name| name == "EPSG");
    let code = id.and_then(|id| id.get("code")).and_then(Json::as_u64);
    let epsg = code.and_then(|code| u32::try_from(code).ok()).filter(|_| is_epsg);
    let kind = crs.and_then(|crs| crs.get("type")).and_then(Json::as_str);
    Crs { epsg, is_geographic: kind == Some("GeographicCRS"), ..Crs::default() }
}

/// A geodetic datum as PROJJSON spells it.
struct Datum {
    /// Name of the geographic system on it.
    system: &'static str,
    /// Name of the datum.
    datum: &'static str,
    /// Name of its ellipsoid.
    ellipsoid: &'static str,
    /// Reciprocal of the ellipsoid's flattening; all have a semi-major axis of 6,378,137 m.
    inverse_flattening: f64,
    /// EPSG code of the geographic system.
    code: u32,
}

const WGS84: Datum = Datum {
    system: "WGS 84",
    datum: "World Geodetic System 1984",
    ellipsoid: "WGS 84",
    inverse_flattening: 298.257_223_563,
    code: 4326,
};
const NAD83: Datum = Datum {
    system: "NAD83",
    datum: "North American Datum 1983",
    ellipsoid: "GRS 1980",
    inverse_flattening: 298.257_222_101,
    code: 4269,
};
const ETRS89: Datum = Datum {
    system: "ETRS89",
    datum: "European Terrestrial Reference System 1989",
    ellipsoid: "GRS 1980",
    inverse_flattening: 298.257_222_101,
    code: 4258,
};

/// The definition of an EPSG code in PROJJSON: the UTM zones of three datums.
///
/// A complete definition of any code would need the EPSG database, and PROJ refuses a bare code;
/// other systems are therefore written as unknown, with the code in our own record.
fn projjson(epsg: u32) -> Option<Json> {
    // EPSG numbers its UTM zones in runs: 32601-32660 north, 32701-32760 south, 26901-26923, and
    // 25828-25838 [EPSG].
    let (datum, zone, is_south) = match epsg {
        32601..=32660 => (WGS84, epsg - 32600, false),
        32701..=32760 => (WGS84, epsg - 32700, true),
        26901..=26923 => (NAD83, epsg - 26900, false),
        25828..=25838 => (ETRS89, epsg - 25800, false),
        _ => return None,
    };
    let zone_name = format!("UTM zone {zone}{}", if is_south { "S" } else { "N" });
    let parameter = |name: &str, value: f64, unit: &str, code: u32| json!({ "name": name, "value": value, "unit": unit, "id": { "authority": "EPSG", "code": code } });
    let axis = |name: &str, abbreviation: &str, direction: &str, unit: &str| json!({ "name": name, "abbreviation": abbreviation, "direction": direction, "unit": unit });
    // Central meridian, scale and false origin of a UTM zone [Snyder87] p. 57.
    let central_meridian = f64::from(zone) * 6.0 - 183.0;
    let false_northing = if is_south { 10_000_000.0 } else { 0.0 };
    Some(json!({
        "$schema": "https://proj.org/schemas/v0.7/projjson.schema.json",
        "type": "ProjectedCRS",
        "name": format!("{} / {zone_name}", datum.system),
        "base_crs": {
            "type": "GeographicCRS",
            "name": datum.system,
            "datum": {
                "type": "GeodeticReferenceFrame",
                "name": datum.datum,
                "ellipsoid": {
                    "name": datum.ellipsoid,
                    "semi_major_axis": 6_378_137,
                    "inverse_flattening": datum.inverse_flattening,
                },
            },
            "coordinate_system": {
                "subtype": "ellipsoidal",
                "axis": [
                    axis("Geodetic latitude", "Lat", "north", "degree"),
                    axis("Geodetic longitude", "Lon", "east", "degree"),
                ],
            },
            "id": { "authority": "EPSG", "code": datum.code },
        },
        "conversion": {
            "name": zone_name,
            "method": {
                "name": "Transverse Mercator",
                "id": { "authority": "EPSG", "code": 9807 },
            },
            "parameters": [
                parameter("Latitude of natural origin", 0.0, "degree", 8801),
                parameter("Longitude of natural origin", central_meridian, "degree", 8802),
                parameter("Scale factor at natural origin", 0.9996, "unity", 8805),
                parameter("False easting", 500_000.0, "metre", 8806),
                parameter("False northing", false_northing, "metre", 8807),
            ],
        },
        "coordinate_system": {
            "subtype": "Cartesian",
            "axis": [
                axis("Easting", "E", "east", "metre"),
                axis("Northing", "N", "north", "metre"),
            ],
        },
        "id": { "authority": "EPSG", "code": epsg },
    }))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reference_system_survives_its_record() {
        let (keys, doubles) = (vec![1, 1, 0, 0], vec![0.1, 298.257]);
        let crs = Crs { epsg: Some(3857), is_geographic: true, keys, doubles, ascii: "a|b".into() };
        assert_eq!(from_json(Some(&to_json(&crs))), crs);
        assert_eq!(from_json(None), Crs::default());
    }

    #[test]
    fn the_lidar_scene_lies_in_the_zone_whose_meridian_is_93_west() {
        let json = projjson(26915).unwrap();
        assert_eq!(json["conversion"]["parameters"][1]["value"], -93.0);
        let geo = geoparquet(&Crs { epsg: Some(26915), ..Crs::default() }, &[1.0], &[2.0]);
        assert_eq!(from_geoparquet(Some(&geo)).epsg, Some(26915));
        assert!(geoparquet(&Crs::default(), &[], &[])["columns"]["geometry"]["crs"].is_null());
    }
}
