//! NumPy's `.npy`: one array of numbers [Kern07].

use crate::bytes::{MAX_FILE_BYTES, read_bounded};
use crate::error::{Error, Result};
use crate::geotiff::MAX_CELLS;
use std::path::Path;
use weald_contract::Image;

/// First bytes of every file.
const MAGIC: &[u8] = b"\x93NUMPY";

/// Reads an array of two dimensions, rows from north to south; integers are kept as numbers.
///
/// # Errors
/// When the file is damaged, has other than two dimensions, or holds no plain numbers.
pub(crate) fn read_image(path: &Path) -> Result<Image> {
    parse_image(path, &read_bounded(path, MAX_FILE_BYTES)?)
}

fn parse_image(path: &Path, bytes: &[u8]) -> Result<Image> {
    let (header, body) = header(bytes).ok_or_else(|| {
        Error::invalid(path, "this is no array of NumPy", "`numpy.save(path, array)` writes one")
    })?;
    let kind = text_of(header, "descr").unwrap_or_default();
    let Some((size, number)) = reader(kind) else {
        let message = format!("an array of the type `{kind}`");
        let hint = "integers and floats are: `numpy.save(path, array.astype('f4'))`";
        return Err(Error::unsupported(path, message, hint));
    };
    let Some([height, width]) = shape(header) else {
        let message = format!("an array of the shape {}", field(header, "shape").unwrap_or("?"));
        return Err(Error::unsupported(path, message, "arrays of two dimensions are"));
    };
    let cells = width.saturating_mul(height);
    if cells == 0 || cells > MAX_CELLS || body.len() != cells * size {
        let message = format!("{} bytes for {height} x {width} numbers", body.len());
        let hint = format!("{size} bytes a number and 1 to {MAX_CELLS} numbers are expected");
        return Err(Error::invalid(path, message, hint));
    }
    let mut values: Vec<f32> = body.chunks_exact(size).map(number).collect();
    if field(header, "fortran_order").is_some_and(|word| word.starts_with("True")) {
        values = (0..cells).map(|index| values[index % width * height + index / width]).collect();
    }
    Ok(Image { width, height, values, is_float: true, frame: None })
}

/// The dictionary at a file's head, and the numbers after it.
fn header(bytes: &[u8]) -> Option<(&str, &[u8])> {
    let rest = bytes.strip_prefix(MAGIC)?;
    let (version, rest) = rest.split_at_checked(2)?;
    let (length, rest) = match version[0] {
        1 => {
            let (length, rest) = rest.split_first_chunk::<2>()?;
            (usize::from(u16::from_le_bytes(*length)), rest)
        }
        2 | 3 => {
            let (length, rest) = rest.split_first_chunk::<4>()?;
            (usize::try_from(u32::from_le_bytes(*length)).ok()?, rest)
        }
        _ => return None,
    };
    let (header, body) = rest.split_at_checked(length)?;
    Some((std::str::from_utf8(header).ok()?, body))
}

/// What follows a key of the dictionary, up to its end.
fn field<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    let at = header.find(&format!("'{key}':"))?;
    let rest = header[at + key.len() + 3..].trim_start();
    let end = if rest.starts_with('(') { rest.find(')')? + 1 } else { rest.find([',', '}'])? };
    rest.get(..end)
}

fn text_of<'a>(header: &'a str, key: &str) -> Option<&'a str> {
    field(header, key)?.trim().strip_prefix('\'')?.strip_suffix('\'')
}

/// Rows and columns.
fn shape(header: &str) -> Option<[usize; 2]> {
    let inner = field(header, "shape")?.strip_prefix('(')?.strip_suffix(')')?;
    let mut sides = inner.split(',').map(|side| side.trim().parse::<usize>().ok());
    match (sides.next()?, sides.next()?, sides.next()) {
        (Some(rows), Some(columns), None) => Some([rows, columns]),
        _ => None,
    }
}

/// Makes a number of its bytes.
type Number = fn(&[u8]) -> f32;

/// Bytes of a number and how to read it, by NumPy's name of the type.
fn reader(kind: &str) -> Option<(usize, Number)> {
    macro_rules! number {
        ($ty:ty, $from:ident) => {
            (size_of::<$ty>(), |bytes| {
                bytes.try_into().map_or(f32::NAN, |bytes| <$ty>::$from(bytes) as f32)
            })
        };
    }
    Some(match kind {
        "|u1" | "<u1" | ">u1" | "|b1" => number!(u8, from_le_bytes),
        "|i1" | "<i1" | ">i1" => number!(i8, from_le_bytes),
        "<u2" => number!(u16, from_le_bytes),
        "<i2" => number!(i16, from_le_bytes),
        "<u4" => number!(u32, from_le_bytes),
        "<i4" => number!(i32, from_le_bytes),
        "<u8" => number!(u64, from_le_bytes),
        "<i8" => number!(i64, from_le_bytes),
        "<f4" => number!(f32, from_le_bytes),
        "<f8" => number!(f64, from_le_bytes),
        ">u2" => number!(u16, from_be_bytes),
        ">i2" => number!(i16, from_be_bytes),
        ">u4" => number!(u32, from_be_bytes),
        ">i4" => number!(i32, from_be_bytes),
        ">u8" => number!(u64, from_be_bytes),
        ">i8" => number!(i64, from_be_bytes),
        ">f4" => number!(f32, from_be_bytes),
        ">f8" => number!(f64, from_be_bytes),
        _ => return None,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn file(header: &str, body: &[u8]) -> Vec<u8> {
        let length = (header.len() as u16).to_le_bytes();
        [MAGIC, &[1, 0], &length, header.as_bytes(), body].concat()
    }

    fn parse(header: &str, body: &[u8]) -> Result<Image> {
        parse_image(Path::new("a.npy"), &file(header, body))
    }

    #[test]
    fn rows_and_columns_keep_their_order_in_both_layouts() {
        let row_major = "{'descr': '<i2', 'fortran_order': False, 'shape': (2, 3), }\n";
        let body: Vec<u8> = (0..6i16).flat_map(i16::to_le_bytes).collect();
        let image = parse(row_major, &body).unwrap();
        assert_eq!((image.width, image.height), (3, 2));
        assert_eq!(image.values, [0.0, 1.0, 2.0, 3.0, 4.0, 5.0]);
        let column_major = "{'descr': '>f8', 'fortran_order': True, 'shape': (2, 3), }\n";
        let body: Vec<u8> =
            [0.0f64, 3.0, 1.0, 4.0, 2.0, 5.0].into_iter().flat_map(f64::to_be_bytes).collect();
        assert_eq!(parse(column_major, &body).unwrap().values, image.values);
    }

    #[test]
    fn what_is_no_plain_raster_is_refused_by_its_name() {
        let cases = [
            ("{'descr': '<c8', 'fortran_order': False, 'shape': (1, 1), }", "<c8"),
            ("{'descr': '|u1', 'fortran_order': False, 'shape': (8,), }", "(8,)"),
            ("{'descr': '|u1', 'fortran_order': False, 'shape': (2, 2, 2), }", "(2, 2, 2)"),
            ("{'descr': '|u1', 'fortran_order': False, 'shape': (3, 3), }", "3 x 3"),
            ("{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (1, 2), }", "type"),
        ];
        for (header, word) in cases {
            let error = parse(header, &[0; 8]).unwrap_err().to_string();
            assert!(error.starts_with("a.npy: ") && error.contains(word), "{error}");
        }
        assert!(parse_image(Path::new("a.npy"), b"\x93NUMPY\x01\x00\xff\xff").is_err());
    }
}
