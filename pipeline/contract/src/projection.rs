//! From longitude and latitude to the metres of a map, for maps in UTM zones.
//!
//! Transverse Mercator by Krüger's series to the fourth order in the third flattening [Karney11],
//! exact to a micrometre within a zone. The three datums of the zones we know, WGS 84, NAD83 and
//! ETRS89, are taken for one; they differ by less than 2 m.

use crate::grid::Crs;
use libm::{asinh, atan2, atanh, cos, cosh, sin, sinh, sqrt};

/// Semi-major axis, m, and flattening of WGS 84 and, to a tenth of a millimetre, of GRS 1980.
const RADIUS: f64 = 6_378_137.0;
const FLATTENING: f64 = 1.0 / 298.257_223_563;
/// Scale on the central meridian, and false origin, m [Snyder87] p. 57.
const SCALE: f64 = 0.9996;
const FALSE_EASTING: f64 = 500_000.0;
const FALSE_NORTHING: f64 = 10_000_000.0;

impl Crs {
    /// Returns the map coordinates, m, of a place in degrees; `None` where this is no UTM zone, or
    /// the place lies more than 30 degrees off its meridian.
    pub fn map_from_degrees(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        let (zone, is_south) = utm_zone(self.epsg?)?;
        let meridian = f64::from(zone) * 6.0 - 183.0;
        let away = (longitude - meridian + 540.0).rem_euclid(360.0) - 180.0;
        if !(away.abs() <= 30.0 && latitude.abs() <= 89.0) {
            return None;
        }
        let [easting, northing] = transverse_mercator(away.to_radians(), latitude.to_radians());
        let south = if is_south { FALSE_NORTHING } else { 0.0 };
        Some([FALSE_EASTING + easting, south + northing])
    }
}

/// Zone and hemisphere of an EPSG code: WGS 84 north and south, NAD83, ETRS89 [EPSG].
fn utm_zone(epsg: u32) -> Option<(u32, bool)> {
    match epsg {
        32601..=32660 => Some((epsg - 32600, false)),
        32701..=32760 => Some((epsg - 32700, true)),
        26901..=26923 => Some((epsg - 26900, false)),
        25828..=25838 => Some((epsg - 25800, false)),
        _ => None,
    }
}

/// Metres east of the central meridian and north of the equator.
fn transverse_mercator(away: f64, latitude: f64) -> [f64; 2] {
    let n = FLATTENING / (2.0 - FLATTENING);
    let rectifying = RADIUS / (1.0 + n) * (1.0 + n * n / 4.0 + n * n * n * n / 64.0);
    let series = [
        n / 2.0 - 2.0 / 3.0 * n * n + 5.0 / 16.0 * n * n * n + 41.0 / 180.0 * n * n * n * n,
        13.0 / 48.0 * n * n - 3.0 / 5.0 * n * n * n + 557.0 / 1440.0 * n * n * n * n,
        61.0 / 240.0 * n * n * n - 103.0 / 140.0 * n * n * n * n,
        49561.0 / 161_280.0 * n * n * n * n,
    ];
    let eccentricity = 2.0 * sqrt(n) / (1.0 + n);
    let sine = sin(latitude);
    // Tangent of the conformal latitude.
    let tangent = sinh(atanh(sine) - eccentricity * atanh(eccentricity * sine));
    let north = atan2(tangent, cos(away));
    let east = asinh(sin(away) / sqrt(tangent * tangent + cos(away) * cos(away)));
    let (mut easting, mut northing) = (east, north);
    for (index, factor) in series.iter().enumerate() {
        let order = 2.0 * (index + 1) as f64;
        easting += factor * cos(order * north) * sinh(order * east);
        northing += factor * sin(order * north) * cosh(order * east);
    }
    [SCALE * rectifying * easting, SCALE * rectifying * northing]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_lie_where_proj_puts_them() {
        // From PROJ 9 through pyproj: longitude, latitude, zone, easting, northing.
        let places = [
            (-93.5, 45.25, 26915, 460_764.103_279_709_9, 5_010_844.426_240_254),
            (15.3, -33.1, 32733, 527_993.145_126_225_7, 6_337_586.935_753_739),
            (9.0, 48.5, 25832, 500_000.0, 5_371_875.576_686_556),
            (12.0, 0.0, 32633, 166_021.443_080_541_62, 0.0),
            (-89.0, 60.0, 26915, 723_020.073_601_747_4, 6_658_157.202_284_315),
        ];
        for (longitude, latitude, epsg, easting, northing) in places {
            let crs = Crs { epsg: Some(epsg), ..Crs::default() };
            let [x, y] = crs.map_from_degrees(longitude, latitude).unwrap();
            // GRS 1980 is a hair flatter: a tenth of a millimetre in the north.
            assert!((x - easting).abs() < 1e-3 && (y - northing).abs() < 1e-3, "{x} {y}");
        }
    }

    #[test]
    fn other_maps_and_far_places_are_refused() {
        let crs = |epsg| Crs { epsg, ..Crs::default() };
        assert_eq!(crs(Some(3857)).map_from_degrees(9.0, 48.0), None);
        assert_eq!(crs(None).map_from_degrees(9.0, 48.0), None);
        assert_eq!(crs(Some(25832)).map_from_degrees(99.0, 48.0), None);
        assert_eq!(crs(Some(25832)).map_from_degrees(f64::NAN, 48.0), None);
        // Across the date line the way round is short.
        assert!(crs(Some(32601)).map_from_degrees(179.9, 10.0).is_some());
    }
}
