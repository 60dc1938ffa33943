//! From longitude and latitude to metres: rasters in degrees come to their UTM zone.

use crate::error::{Error, Result};
use crate::geotiff::MAX_CELLS;
use rayon::prelude::*;
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Raster, UtmZone};

/// Points along an edge of a raster that find where its image in the plane ends.
const EDGE_POINTS: usize = 65;

/// Beyond these latitudes, degrees, there are no UTM zones [Snyder87] p. 57.
const LATITUDES: std::ops::RangeInclusive<f64> = -80.0..=84.0;

/// Widest raster, degrees of longitude: three zones, whose rims are stretched by half a percent.
const WIDEST: f64 = 18.0;

/// GeoTIFF keys of a vertical system: its code, name, datum and unit [OGC19-008].
const VERTICAL_KEYS: std::ops::RangeInclusive<u16> = 4096..=4099;

/// A rectangle of cells in the units of a map, which may be degrees.
#[derive(Clone, Debug)]
pub(crate) struct Cells {
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
    /// West edge, or its longitude.
    pub west: f64,
    /// North edge, or its latitude.
    pub north: f64,
    /// Width of a cell.
    pub across: f64,
    /// Height of a cell.
    pub down: f64,
}

impl Cells {
    fn middle(&self) -> (f64, f64) {
        let longitude = self.west + 0.5 * self.width as f64 * self.across;
        (longitude, self.north - 0.5 * self.height as f64 * self.down)
    }

    /// Bilinear value at fractions of cells from the north-west corner, of those neighbours that
    /// have data; NaN where less than half of the weight has.
    fn sample(&self, values: &[f32], column: f64, row: f64) -> f32 {
        let u = (column - 0.5).clamp(0.0, (self.width - 1) as f64);
        let v = (row - 0.5).clamp(0.0, (self.height - 1) as f64);
        let (c0, r0) = (u as usize, v as usize);
        let (c1, r1) = ((c0 + 1).min(self.width - 1), (r0 + 1).min(self.height - 1));
        let (fu, fv) = ((u - c0 as f64) as f32, (v - r0 as f64) as f32);
        let corners = [
            (c0, r0, (1.0 - fu) * (1.0 - fv)),
            (c1, r0, fu * (1.0 - fv)),
            (c0, r1, (1.0 - fu) * fv),
            (c1, r1, fu * fv),
        ];
        let (mut sum, mut weight) = (0.0, 0.0);
        for (column, row, share) in corners {
            let value = values[row * self.width + column];
            if !value.is_nan() {
                sum += value * share;
                weight += share;
            }
        }
        if weight >= 0.5 { sum / weight } else { f32::NAN }
    }
}

/// Brings a raster in degrees to squares of metres in the UTM zone of its middle.
///
/// The squares are as large as the cells in the middle, to three digits; values between cells
/// are bilinear. The result is the largest rectangle, parallel to the zone's axes, whose edges
/// touch no edge of the raster's image, so that it has no empty corners. `crs` says the datum:
/// WGS 84, NAD83 and ETRS89 are known, and none means WGS 84.
///
/// # Errors
/// When the datum is another, or the raster lies near a pole, is wider than the projection
/// serves, or would have too many cells.
pub(crate) fn to_utm(path: &Path, degrees: &Cells, values: &[f32], crs: &Crs) -> Result<Raster> {
    check(path, degrees)?;
    let zone = Zone::of(path, degrees, crs.epsg)?;
    let frame = zone.frame(path, degrees)?;
    let mut projected = vec![0.0f32; frame.len()];
    let rows = projected.par_chunks_mut(frame.width).enumerate();
    rows.for_each(|(row, line)| {
        for (column, value) in line.iter_mut().enumerate() {
            let (longitude, latitude) = zone.to_degrees(degrees, frame.center(column, row));
            let column = (longitude - degrees.west) / degrees.across;
            *value = degrees.sample(values, column, (degrees.north - latitude) / degrees.down);
        }
    });
    let crs = Crs { epsg: Some(zone.epsg), keys: zone.keys(&crs.keys), ..Crs::default() };
    Ok(Raster { grid: Grid { frame, values: projected }, crs })
}

fn check(path: &Path, degrees: &Cells) -> Result<()> {
    let (longitude, latitude) = degrees.middle();
    let south = degrees.north - degrees.height as f64 * degrees.down;
    let span = degrees.width as f64 * degrees.across;
    let is_on_earth = longitude.abs() <= 540.0 && degrees.north <= 90.0 && south >= -90.0;
    let has_size = degrees.across > 0.0 && degrees.down > 0.0;
    if !is_on_earth || !has_size {
        let message = format!(
            "cells of {} x {} degrees around {longitude}, {latitude} lie on no globe",
            degrees.across, degrees.down
        );
        return Err(Error::invalid(path, message, "longitudes and latitudes must be degrees"));
    }
    let has_zone = LATITUDES.contains(&degrees.north) && LATITUDES.contains(&south);
    if !has_zone {
        let message = format!("the raster reaches from {south} to {} degrees north", degrees.north);
        let hint = "UTM zones end at -80 and 84: `gdalwarp -t_srs EPSG:3413` or EPSG:3031";
        return Err(Error::unsupported(path, message, hint));
    }
    if span > WIDEST {
        let message = format!("the raster spans {span:.1} degrees of longitude");
        let hint = format!(
            "up to {WIDEST} are brought to one UTM zone: cut it, or `gdalwarp` it to another map"
        );
        return Err(Error::unsupported(path, message, hint));
    }
    Ok(())
}

/// The zone that a raster comes to.
struct Zone {
    epsg: u32,
    plane: UtmZone,
}

impl Zone {
    /// The zone of a raster's middle on the datum of an EPSG code.
    fn of(path: &Path, degrees: &Cells, datum: Option<u32>) -> Result<Self> {
        let (longitude, latitude) = degrees.middle();
        let wrapped = (longitude + 180.0).rem_euclid(360.0);
        let zone = (wrapped / 6.0) as u32 % 60 + 1;
        let is_south = latitude < 0.0;
        // EPSG numbers the zones of a datum in runs, and only those where it is used [EPSG].
        let wgs84 = if is_south { 32700 + zone } else { 32600 + zone };
        let epsg = match datum {
            None | Some(4326 | 4979) => wgs84,
            Some(4269) if !is_south && zone <= 23 => 26900 + zone,
            Some(4258) if !is_south && (28..=38).contains(&zone) => 25800 + zone,
            // The three datums differ by less than two metres.
            Some(4269 | 4258) => wgs84,
            Some(other) => {
                let message = format!("longitude and latitude in EPSG:{other}");
                let hint = format!("WGS 84, NAD83 and ETRS89 are: `gdalwarp -t_srs EPSG:{wgs84}`");
                return Err(Error::unsupported(path, message, hint));
            }
        };
        let plane = UtmZone::from_epsg(epsg).ok_or_else(|| refused(path))?;
        Ok(Self { epsg, plane })
    }

    /// A longitude and latitude, degrees, in metres.
    fn to_metres(&self, path: &Path, (longitude, latitude): (f64, f64)) -> Result<(f64, f64)> {
        let place = self.plane.map_from_degrees(longitude, latitude);
        place.map(|[x, y]| (x, y)).ok_or_else(|| refused(path))
    }

    /// Metres in degrees, the longitude within half a turn of the raster's middle.
    fn to_degrees(&self, raster: &Cells, (x, y): (f64, f64)) -> (f64, f64) {
        let [longitude, latitude] = self.plane.degrees_from_map(x, y);
        let turns = ((raster.middle().0 - longitude) / 360.0).round();
        (longitude + 360.0 * turns, latitude)
    }

    /// Squares that cover the raster's image but for its slanting edges.
    fn frame(&self, path: &Path, degrees: &Cells) -> Result<Frame> {
        let (width, height) = (degrees.width as f64, degrees.height as f64);
        let edge = |from: (f64, f64), to: (f64, f64)| -> Result<Vec<(f64, f64)>> {
            let place = |k: usize| {
                let t = k as f64 / (EDGE_POINTS - 1) as f64;
                let (column, row) = (from.0 + t * (to.0 - from.0), from.1 + t * (to.1 - from.1));
                (degrees.west + column * degrees.across, degrees.north - row * degrees.down)
            };
            (0..EDGE_POINTS).map(|k| self.to_metres(path, place(k))).collect()
        };
        let (nw, ne, sw, se) = ((0.0, 0.0), (width, 0.0), (0.0, height), (width, height));
        let most = |points: Vec<f64>| points.into_iter().fold(f64::NEG_INFINITY, f64::max);
        let least = |points: Vec<f64>| points.into_iter().fold(f64::INFINITY, f64::min);
        let x = |points: Vec<(f64, f64)>| points.into_iter().map(|point| point.0).collect();
        let y = |points: Vec<(f64, f64)>| points.into_iter().map(|point| point.1).collect();
        let (west, east) = (most(x(edge(nw, sw)?)), least(x(edge(ne, se)?)));
        let (south, north) = (most(y(edge(sw, se)?)), least(y(edge(nw, ne)?)));
        let cell = self.cell(path, degrees)?;
        let (columns, rows) = (((east - west) / cell).floor(), ((north - south) / cell).floor());
        let is_held = columns >= 1.0 && rows >= 1.0 && columns * rows <= MAX_CELLS as f64;
        if !is_held {
            let message = format!("in UTM the raster has {columns} x {rows} cells of {cell} m");
            return Err(Error::invalid(path, message, format!("1 to {MAX_CELLS} are read")));
        }
        Ok(Frame { width: columns as usize, height: rows as usize, cell, west, south })
    }

    /// Side of a square as large as the cell in the middle, m, to three digits.
    fn cell(&self, path: &Path, degrees: &Cells) -> Result<f64> {
        let (longitude, latitude) = degrees.middle();
        let (dx, dy) = (0.5 * degrees.across, 0.5 * degrees.down);
        let length = |a: (f64, f64), b: (f64, f64)| -> Result<f64> {
            let (a, b) = (self.to_metres(path, a)?, self.to_metres(path, b)?);
            Ok((a.0 - b.0).hypot(a.1 - b.1))
        };
        let across = length((longitude - dx, latitude), (longitude + dx, latitude))?;
        let down = length((longitude, latitude - dy), (longitude, latitude + dy))?;
        let side = (across * down).sqrt();
        // Through its decimal digits, so that 81.1 is 81.1.
        Ok(format!("{side:.2e}").parse().unwrap_or(side))
    }

    /// Keys of the projected system, with those of heights that the source had.
    fn keys(&self, source: &[u16]) -> Vec<u16> {
        let mut entries = vec![
            [1024, 0, 1, 1],
            [1025, 0, 1, 1],
            [3072, 0, 1, u16::try_from(self.epsg).unwrap_or_default()],
        ];
        let heights = source.chunks_exact(4).skip(1).filter_map(|key| match *key {
            // Only numbers that stand in the key itself: the others' tables are not carried.
            [key, 0, 1, value] if VERTICAL_KEYS.contains(&key) => Some([key, 0, 1, value]),
            _ => None,
        });
        entries.extend(heights);
        let header = [1, 1, 0, entries.len() as u16];
        std::iter::once(header).chain(entries).flatten().collect()
    }
}

fn refused(path: &Path) -> Error {
    let message = "the raster lies too far off its UTM zone";
    Error::invalid(path, message, "`gdalwarp -t_srs EPSG:UTM_ZONE` may do it")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn raster(west: f64, north: f64, step: f64, side: usize) -> Cells {
        Cells { width: side, height: side, west, north, across: step, down: step }
    }

    fn project(degrees: &Cells, value: impl Fn(f64, f64) -> f64, crs: &Crs) -> Result<Raster> {
        let values: Vec<f32> = (0..degrees.width * degrees.height)
            .map(|index| {
                let (column, row) = (index % degrees.width, index / degrees.width);
                let longitude = degrees.west + (column as f64 + 0.5) * degrees.across;
                value(longitude, degrees.north - (row as f64 + 0.5) * degrees.down) as f32
            })
            .collect();
        to_utm(Path::new("dem"), degrees, &values, crs)
    }

    #[test]
    fn middles_choose_the_zone() {
        let places = [(-105.25, 40.05, 32613), (-70.3, -33.4, 32719), (177.5, -17.8, 32760)];
        for (longitude, latitude, epsg) in places {
            let degrees = raster(longitude - 0.01, latitude + 0.01, 0.0004, 50);
            assert_eq!(Zone::of(Path::new("dem"), &degrees, None).unwrap().epsg, epsg);
        }
    }

    #[test]
    fn values_keep_their_place_and_no_corner_is_empty() {
        // A plane in degrees is a plane for bilinear values.
        let degrees = raster(-105.4, 40.1, 1.0 / 3600.0, 400);
        let plane = |longitude: f64, latitude: f64| 1000.0 * (longitude + 105.0) + 700.0 * latitude;
        let found = project(&degrees, plane, &Crs::default()).unwrap();
        let frame = found.grid.frame;
        assert_eq!((found.crs.epsg, frame.cell), (Some(32613), 27.0));
        let zone = Zone::of(Path::new("dem"), &degrees, None).unwrap();
        for (column, row) in [(0, 0), (frame.width - 1, 0), (7, frame.height - 1), (150, 160)] {
            let (longitude, latitude) = zone.to_degrees(&degrees, frame.center(column, row));
            let wanted = plane(longitude, latitude);
            let value = f64::from(found.grid.values[frame.index(column, row)]);
            // Half a cell at the rim takes the rim's value.
            assert!((value - wanted).abs() < 0.35, "{value} for {wanted}");
        }
        assert!(found.grid.values.iter().all(|value| value.is_finite()));
    }

    #[test]
    fn the_date_line_is_no_edge() {
        let degrees = raster(179.9, -17.0, 0.001, 200);
        let found = project(&degrees, |longitude, _| longitude, &Crs::default()).unwrap();
        assert!(found.grid.values.iter().all(|value| (179.9..180.1).contains(value)));
    }

    #[test]
    fn holes_stay_holes_and_heights_keep_their_system() {
        let degrees = raster(10.0, 50.0, 0.001, 100);
        let hole = |longitude: f64, _| if longitude < 10.05 { f64::NAN } else { 1.0 };
        let keys = vec![1, 1, 0, 2, 2048, 0, 1, 4326, 4096, 0, 1, 5773];
        let found = project(&degrees, hole, &Crs { keys, ..Crs::default() }).unwrap();
        let missing = found.grid.values.iter().filter(|value| value.is_nan()).count();
        let share = missing as f64 / found.grid.values.len() as f64;
        assert!((share - 0.5).abs() < 0.02, "{share}");
        assert!(found.crs.keys.ends_with(&[4096, 0, 1, 5773]), "{:?}", found.crs.keys);
    }

    #[test]
    fn datums_keep_their_zones_and_strangers_are_refused() {
        let degrees = raster(-105.4, 40.1, 0.001, 100);
        let with =
            |code| project(&degrees, |_, _| 1.0, &Crs { epsg: Some(code), ..Crs::default() });
        assert_eq!(with(4269).unwrap().crs.epsg, Some(26913));
        let error = with(4267).unwrap_err().to_string();
        assert!(error.contains("EPSG:4267") && error.contains("EPSG:32613"), "{error}");
    }

    #[test]
    fn the_poles_and_the_whole_world_are_refused() {
        let polar = project(&raster(0.0, 89.0, 0.01, 100), |_, _| 1.0, &Crs::default());
        assert!(polar.unwrap_err().to_string().contains("84"));
        let world = project(&raster(-180.0, 60.0, 1.0, 100), |_, _| 1.0, &Crs::default());
        assert!(world.unwrap_err().to_string().contains("longitude"));
        let nonsense = project(&raster(0.0, 1e9, 1.0, 100), |_, _| 1.0, &Crs::default());
        assert!(nonsense.unwrap_err().to_string().contains("globe"));
    }
}
