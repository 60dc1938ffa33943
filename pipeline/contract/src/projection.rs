//! Between longitude and latitude and the metres of a map, for maps in UTM zones.
//!
//! Transverse Mercator and its inverse by Krüger's series to the fourth order in the third
//! flattening [Karney11], exact to a micrometre within a zone.

use crate::grid::Crs;
use libm::{asinh, atan, atan2, atanh, cos, cosh, sin, sinh, sqrt};

/// Semi-major axis, m, of WGS 84 and of GRS 1980.
const RADIUS: f64 = 6_378_137.0;
/// Flattenings: these ellipsoids differ by a tenth of a millimetre.
const WGS_84: f64 = 1.0 / 298.257_223_563;
const GRS_1980: f64 = 1.0 / 298.257_222_101;
/// Scale on the central meridian, and false origin, m [Snyder87] p. 57.
const SCALE: f64 = 0.9996;
const FALSE_EASTING: f64 = 500_000.0;
const FALSE_NORTHING: f64 = 10_000_000.0;
/// Newton steps to the geographic latitude: three are exact to the last bits [Karney11] eq. 19.
const LATITUDE_STEPS: usize = 4;

impl Crs {
    /// Returns the map coordinates, m, of a place in degrees; `None` where this is no UTM zone, or
    /// the place lies more than 30 degrees off its meridian.
    pub fn map_from_degrees(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        UtmZone::from_epsg(self.epsg?)?.map_from_degrees(longitude, latitude)
    }
}

/// A zone of the Universal Transverse Mercator projection.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct UtmZone {
    /// Longitude of the central meridian, degrees.
    pub meridian_deg: f64,
    /// Whether northings count from ten thousand kilometres south of the equator.
    pub is_south: bool,
    flattening: f64,
}

impl UtmZone {
    /// The zone of an EPSG code: WGS 84 north and south, NAD83, ETRS89 [EPSG]; `None` for others.
    pub fn from_epsg(epsg: u32) -> Option<Self> {
        let (zone, is_south, flattening) = match epsg {
            32601..=32660 => (epsg - 32600, false, WGS_84),
            32701..=32760 => (epsg - 32700, true, WGS_84),
            26901..=26923 => (epsg - 26900, false, GRS_1980),
            25828..=25838 => (epsg - 25800, false, GRS_1980),
            _ => return None,
        };
        Some(Self { meridian_deg: f64::from(zone) * 6.0 - 183.0, is_south, flattening })
    }

    /// Returns the map coordinates, m, of a place in degrees; `None` more than 30 degrees off the
    /// meridian or within a degree of a pole.
    pub fn map_from_degrees(&self, longitude: f64, latitude: f64) -> Option<[f64; 2]> {
        let away = (longitude - self.meridian_deg + 540.0).rem_euclid(360.0) - 180.0;
        if !(away.abs() <= 30.0 && latitude.abs() <= 89.0) {
            return None;
        }
        let away = away.to_radians();
        let eccentricity = self.eccentricity();
        let sine = sin(latitude.to_radians());
        // Tangent of the conformal latitude.
        let tangent = sinh(atanh(sine) - eccentricity * atanh(eccentricity * sine));
        let north = atan2(tangent, cos(away));
        let east = asinh(sin(away) / sqrt(tangent * tangent + cos(away) * cos(away)));
        let [more_east, more_north] = waves(east, north, &self.forward_series());
        let scale = self.scale();
        let south = if self.is_south { FALSE_NORTHING } else { 0.0 };
        let [easting, northing] = [scale * (east + more_east), scale * (north + more_north)];
        Some([FALSE_EASTING + easting, south + northing])
    }

    /// Returns longitude, within half a turn of the meridian, and latitude, degrees, of map
    /// coordinates, m.
    pub fn degrees_from_map(&self, x: f64, y: f64) -> [f64; 2] {
        let south = if self.is_south { FALSE_NORTHING } else { 0.0 };
        let (east, north) = ((x - FALSE_EASTING) / self.scale(), (y - south) / self.scale());
        let [less_east, less_north] = waves(east, north, &self.inverse_series());
        let (east, north) = (east - less_east, north - less_north);
        let conformal = sin(north) / sqrt(sinh(east) * sinh(east) + cos(north) * cos(north));
        let latitude = atan(geographic_tangent(conformal, self.eccentricity()));
        let away = atan2(sinh(east), cos(north));
        [self.meridian_deg + away.to_degrees(), latitude.to_degrees()]
    }

    fn third_flattening(&self) -> f64 {
        self.flattening / (2.0 - self.flattening)
    }

    fn eccentricity(&self) -> f64 {
        sqrt(self.flattening * (2.0 - self.flattening))
    }

    /// Radius of the circle as long as a meridian, scaled to the map, m [Karney11] eq. 14.
    fn scale(&self) -> f64 {
        let n = self.third_flattening();
        SCALE * RADIUS / (1.0 + n) * (1.0 + n * n / 4.0 + n * n * n * n / 64.0)
    }

    /// [Karney11] eq. 35.
    fn forward_series(&self) -> [f64; 4] {
        let n = self.third_flattening();
        [
            n / 2.0 - 2.0 / 3.0 * n * n + 5.0 / 16.0 * n * n * n + 41.0 / 180.0 * n * n * n * n,
            13.0 / 48.0 * n * n - 3.0 / 5.0 * n * n * n + 557.0 / 1440.0 * n * n * n * n,
            61.0 / 240.0 * n * n * n - 103.0 / 140.0 * n * n * n * n,
            49561.0 / 161_280.0 * n * n * n * n,
        ]
    }

    /// [Karney11] eq. 36.
    fn inverse_series(&self) -> [f64; 4] {
        let n = self.third_flattening();
        [
            n / 2.0 - 2.0 / 3.0 * n * n + 37.0 / 96.0 * n * n * n - n * n * n * n / 360.0,
            n * n / 48.0 + n * n * n / 15.0 - 437.0 / 1440.0 * n * n * n * n,
            17.0 / 480.0 * n * n * n - 37.0 / 840.0 * n * n * n * n,
            4397.0 / 161_280.0 * n * n * n * n,
        ]
    }
}

/// Sums of a series in twice, four times, ... the complex angle: east, north.
fn waves(east: f64, north: f64, series: &[f64; 4]) -> [f64; 2] {
    let mut sums = [0.0; 2];
    for (index, factor) in series.iter().enumerate() {
        let order = 2.0 * (index + 1) as f64;
        sums[0] += factor * cos(order * north) * sinh(order * east);
        sums[1] += factor * sin(order * north) * cosh(order * east);
    }
    sums
}

/// Tangent of the geographic latitude from that of the conformal one [Karney11] eq. 19-21.
fn geographic_tangent(conformal: f64, eccentricity: f64) -> f64 {
    let shrink = 1.0 - eccentricity * eccentricity;
    let mut tangent = conformal;
    for _ in 0..LATITUDE_STEPS {
        let secant = sqrt(1.0 + tangent * tangent);
        let sigma = sinh(eccentricity * atanh(eccentricity * tangent / secant));
        let found = tangent * sqrt(1.0 + sigma * sigma) - sigma * secant;
        let step = (conformal - found) / sqrt(1.0 + found * found);
        tangent += step * (1.0 + shrink * tangent * tangent) / (shrink * secant);
    }
    tangent
}

#[cfg(test)]
mod tests {
    use super::*;

    /// From PROJ 9 through pyproj: longitude, latitude, zone, easting, northing.
    const PLACES: [(f64, f64, u32, f64, f64); 10] = [
        (-93.5, 45.25, 26915, 460_764.103_279_709_9, 5_010_844.426_240_254),
        (15.3, -33.1, 32733, 527_993.145_126_225_7, 6_337_586.935_753_739),
        (9.0, 48.5, 25832, 500_000.0, 5_371_875.576_686_556),
        (12.0, 0.0, 32633, 166_021.443_080_541_62, 0.0),
        (-89.0, 60.0, 26915, 723_020.073_601_747_4, 6_658_157.202_284_315),
        (-105.25, 40.05, 32613, 478_675.636_173_3, 4_433_336.688_997_4),
        (7.85, 47.99, 32632, 414_199.186_772_2, 5_315_828.604_316_2),
        (-70.3, -33.4, 32719, 379_106.235_541_5, 6_303_612.531_601_5),
        (177.5, -17.8, 32760, 552_991.209_812_5, 8_031_870.770_360_4),
        (15.6, 78.2, 32633, 513_696.945_417_0, 8_680_760.053_195_6),
    ];

    #[test]
    fn places_lie_where_proj_puts_them_and_come_back() {
        for (longitude, latitude, epsg, easting, northing) in PLACES {
            let zone = UtmZone::from_epsg(epsg).unwrap();
            let [x, y] = zone.map_from_degrees(longitude, latitude).unwrap();
            assert!((x - easting).hypot(y - northing) < 1e-6, "{x} {y} for {easting} {northing}");
            let [east, north] = zone.degrees_from_map(x, y);
            let error = (east - longitude).hypot(north - latitude);
            assert!(error < 1e-11, "{error} at {longitude} {latitude}");
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
