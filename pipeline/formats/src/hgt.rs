//! SRTM's `.hgt`: a square of one degree, big-endian heights on its lines, named by its corner.

use crate::bytes::read_bounded;
use crate::error::{Error, Result};
use crate::utm::{self, Cells};
use std::path::Path;
use weald_contract::{Crs, Raster};

/// Height that stands for "no data".
const VOID: i16 = -32768;

/// Points along a side: of three arc seconds, one, and a half.
const SIDES: [usize; 3] = [1201, 3601, 7201];

/// Reads a tile of the Shuttle Radar Topography Mission, brought to its UTM zone.
///
/// The name says the place: `N40W106.hgt` has its south-west point at 40° N, 106° W. Heights are
/// whole metres above the geoid EGM96; points lie on the edges, and neighbours share them.
///
/// # Errors
/// When the name says no place or the length is that of no known tile.
pub(crate) fn read_raster(path: &Path) -> Result<Raster> {
    let longest = 2 * 7201u64.pow(2);
    parse_raster(path, &read_bounded(path, longest)?)
}

fn parse_raster(path: &Path, bytes: &[u8]) -> Result<Raster> {
    let Some(side) = SIDES.into_iter().find(|side| bytes.len() == 2 * side * side) else {
        let message = format!("a tile of {} bytes", bytes.len());
        let hint = "tiles of 1201, 3601 or 7201 points a side, two bytes each, are read";
        return Err(Error::invalid(path, message, hint));
    };
    let name = path.file_stem().map(|stem| stem.to_string_lossy()).unwrap_or_default();
    let Some((west, south)) = corner(&name) else {
        let message = format!("the name `{name}` says no place");
        let hint = "name it by its south-west corner, such as N40W106.hgt";
        return Err(Error::invalid(path, message, hint));
    };
    let height = |pair: &[u8]| match pair {
        [high, low] => i16::from_be_bytes([*high, *low]),
        _ => VOID,
    };
    let metres = |height: i16| if height == VOID { f32::NAN } else { f32::from(height) };
    let values: Vec<f32> = bytes.chunks_exact(2).map(|pair| metres(height(pair))).collect();
    let step = 1.0 / (side - 1) as f64;
    // Points are centres of cells, half of which lie beyond the degree.
    let (west, north) = (west - 0.5 * step, south + 1.0 + 0.5 * step);
    let degrees = Cells { width: side, height: side, west, north, across: step, down: step };
    // EPSG:5773 is heights above EGM96.
    let keys = vec![1, 1, 0, 1, 4096, 0, 1, 5773];
    utm::to_utm(path, &degrees, &values, &Crs { epsg: Some(4326), keys, ..Crs::default() })
}

/// Longitude and latitude of the south-west corner that a name such as `N40W106` says.
fn corner(name: &str) -> Option<(f64, f64)> {
    let name = name.as_bytes().get(..7)?;
    let number = |digits: &[u8]| std::str::from_utf8(digits).ok()?.parse::<u8>().ok();
    let signed = |letter: u8, plus: u8, minus: u8, number: u8| match letter.to_ascii_uppercase() {
        found if found == plus => Some(f64::from(number)),
        found if found == minus => Some(-f64::from(number)),
        _ => None,
    };
    let latitude = signed(name[0], b'N', b'S', number(&name[1..3])?)?;
    Some((signed(name[3], b'E', b'W', number(&name[4..7])?)?, latitude))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_tile_lies_where_its_name_says() {
        // The height is the column, and a void at the first point.
        let mut bytes: Vec<u8> =
            (0..1201 * 1201).flat_map(|index| i16::to_be_bytes((index % 1201) as i16)).collect();
        bytes[..2].copy_from_slice(&VOID.to_be_bytes());
        let tile = parse_raster(Path::new("N40W106.hgt"), &bytes).unwrap();
        assert_eq!(tile.crs.epsg, Some(32613));
        assert!(tile.crs.keys.ends_with(&[4096, 0, 1, 5773]));
        // 105.25° W is column 900; PROJ puts 40.05° N there at this place.
        let value = tile.grid.sample(478_675.636_173_3, 4_433_336.688_997_4);
        assert!((value - 900.0).abs() < 0.02, "{value}");
        assert!(tile.grid.values.iter().all(|v| v.is_nan() || (0.0..=1200.0).contains(v)));
    }

    #[test]
    fn names_and_lengths_that_say_nothing_are_refused() {
        assert_eq!(corner("s03e037"), Some((37.0, -3.0)));
        assert_eq!(corner("N40W106.SRTMGL1"), Some((-106.0, 40.0)));
        for name in ["", "dem", "X40W106", "N4aW106", "N40W", "N40W999", "été40W1"] {
            assert_eq!(corner(name), None, "{name}");
        }
        let whole = vec![0; 2 * 1201 * 1201];
        assert!(
            parse_raster(Path::new("dem.hgt"), &whole).unwrap_err().to_string().contains("N40")
        );
        let error = parse_raster(Path::new("N40W106.hgt"), &whole[1..]).unwrap_err().to_string();
        assert!(error.contains("1201"), "{error}");
    }
}
