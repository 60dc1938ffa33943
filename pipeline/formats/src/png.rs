//! PNG: painted densities in, previews out.

use crate::bytes::{MAX_FILE_BYTES, read_bounded};
use crate::error::{Error, Result};
use crate::png_bands;
use crate::provenance::Provenance;
use crate::whole::write_atomically;
use image::{DynamicImage, ExtendedColorType, ImageFormat, ImageReader, Limits};
use std::io::{Cursor, Read, Write};
use std::path::Path;
use weald_contract::Image;

/// Keyword of the text chunk that holds the provenance.
const KEYWORD: &str = "weald";

/// Widest and highest picture that is read, pixels.
const MAX_SIDE: u32 = 1 << 15;

/// Most memory a PNG may ask for, bytes: 16k × 16k pixels of 16-bit gray.
const MAX_ALLOCATION: u64 = 1 << 30;

/// An 8-bit colour picture.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Preview {
    /// Pixels across.
    pub width: usize,
    /// Pixels down.
    pub height: usize,
    /// Red, green and blue of each pixel, sRGB, top row first.
    pub rgb: Vec<u8>,
}

/// Writes an 8-bit sRGB picture.
///
/// # Errors
/// When `rgb` has not three bytes a pixel, or the disk refuses.
pub fn write_png(
    path: &Path,
    width: usize,
    height: usize,
    rgb: &[u8],
    provenance: &Provenance,
) -> Result<()> {
    let size = (u32::try_from(width), u32::try_from(height));
    let expected = width.checked_mul(height).and_then(|pixels| pixels.checked_mul(3));
    let (Ok(columns), Ok(rows), true) = (size.0, size.1, expected == Some(rgb.len())) else {
        let message = format!("{} bytes for {width} x {height} pixels", rgb.len());
        return Err(Error::invalid(path, message, "give three bytes a pixel"));
    };
    write(path, rgb, [columns, rows], ExtendedColorType::Rgb8, provenance)
}

/// Writes one band of 16-bit codes, such as a density layer to paint on.
///
/// # Errors
/// When `codes` has not one code a pixel, or the disk refuses.
pub fn write_gray_png(
    path: &Path,
    width: usize,
    height: usize,
    codes: &[u16],
    provenance: &Provenance,
) -> Result<()> {
    let size = (u32::try_from(width), u32::try_from(height));
    let fits = width.checked_mul(height) == Some(codes.len());
    let (Ok(columns), Ok(rows), true) = (size.0, size.1, fits) else {
        let message = format!("{} codes for {width} x {height} pixels", codes.len());
        return Err(Error::invalid(path, message, "give one code a pixel"));
    };
    // The encoder takes the machine's own byte order and writes PNG's.
    let bytes: Vec<u8> = codes.iter().flat_map(|code| code.to_ne_bytes()).collect();
    write(path, &bytes, [columns, rows], ExtendedColorType::L16, provenance)
}

fn write(
    path: &Path,
    pixels: &[u8],
    [columns, rows]: [u32; 2],
    color: ExtendedColorType,
    provenance: &Provenance,
) -> Result<()> {
    write_atomically(path, |file| {
        let mut bytes = Vec::new();
        let encoder = image::codecs::png::PngEncoder::new(&mut bytes);
        image::ImageEncoder::write_image(encoder, pixels, columns, rows, color)?;
        let (head, tail) = bytes.split_at_checked(HEAD_BYTES).unwrap_or((&bytes, &[]));
        file.write_all(head)?;
        file.write_all(&text_chunk(&provenance.to_json()))?;
        file.write_all(tail)?;
        Ok(())
    })
}

/// Reads a picture as 8-bit sRGB; transparency is dropped.
///
/// # Errors
/// When the file is missing or no readable PNG.
pub fn read_png(path: &Path) -> Result<Preview> {
    let picture = parse(path, &read_bounded(path, MAX_FILE_BYTES)?)?.into_rgb8();
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    Ok(Preview { width, height, rgb: picture.into_raw() })
}

/// Reads one band; a colour picture is accepted when its channels agree, as paint programs save.
///
/// Images larger than can be held are averaged down in bands.
pub(crate) fn read_image(path: &Path) -> Result<Image> {
    let largest = size(path)?.map_or(0, |[width, height]| width.max(height));
    if largest > png_bands::LARGE_SIDE {
        return png_bands::read(path);
    }
    parse_image(path, &read_bounded(path, MAX_FILE_BYTES)?)
}

/// Width and height in a PNG's header [PNG] §11.2.1; `None` when it is too short for one.
fn size(path: &Path) -> Result<Option<[u32; 2]>> {
    let file = std::fs::File::open(path).map_err(Error::io("open", path))?;
    let mut head = Vec::new();
    file.take(HEAD_BYTES as u64).read_to_end(&mut head).map_err(Error::io("read", path))?;
    let number = |at: usize| Some(u32::from_be_bytes(head.get(at..)?.first_chunk::<4>().copied()?));
    let sizes = number(16).zip(number(20)).map(|(width, height)| [width, height]);
    Ok(sizes.filter(|_| head.starts_with(&SIGNATURE)))
}

pub(crate) fn parse_image(path: &Path, bytes: &[u8]) -> Result<Image> {
    let picture = parse(path, bytes)?;
    let (width, height) = (picture.width() as usize, picture.height() as usize);
    let from_bytes = |codes: Vec<u8>| codes.iter().map(|&c| f32::from(c) / 255.0).collect();
    let from_words = |codes: Vec<u16>| codes.iter().map(|&c| f32::from(c) / 65535.0).collect();
    let values: Vec<f32> = match picture {
        DynamicImage::ImageLuma8(gray) => from_bytes(gray.into_raw()),
        DynamicImage::ImageLuma16(gray) => from_words(gray.into_raw()),
        DynamicImage::ImageLumaA8(gray) => from_bytes(first_of(&gray.into_raw(), 2)),
        DynamicImage::ImageLumaA16(gray) => from_words(first_of(&gray.into_raw(), 2)),
        DynamicImage::ImageRgb8(rgb) => from_bytes(equal_of(path, &rgb.into_raw(), 3)?),
        DynamicImage::ImageRgb16(rgb) => from_words(equal_of(path, &rgb.into_raw(), 3)?),
        DynamicImage::ImageRgba8(rgb) => from_bytes(equal_of(path, &rgb.into_raw(), 4)?),
        DynamicImage::ImageRgba16(rgb) => from_words(equal_of(path, &rgb.into_raw(), 4)?),
        _ => return Err(Error::unsupported(path, "this kind of PNG", "8 and 16 bits are")),
    };
    Ok(Image { width, height, values, is_float: false, frame: None })
}

fn first_of<T: Copy>(codes: &[T], channels: usize) -> Vec<T> {
    codes.chunks_exact(channels).filter_map(|pixel| pixel.first().copied()).collect()
}

fn equal_of<T: Copy + PartialEq>(path: &Path, codes: &[T], channels: usize) -> Result<Vec<T>> {
    let is_gray = |pixel: &[T]| matches!(pixel, [r, g, b, ..] if r == g && g == b);
    if codes.chunks_exact(channels).all(is_gray) {
        return Ok(first_of(codes, channels));
    }
    let hint = "one band is needed: save it as grayscale";
    Err(Error::invalid(path, "the image is coloured", hint))
}

fn parse(path: &Path, bytes: &[u8]) -> Result<DynamicImage> {
    let mut reader = ImageReader::with_format(Cursor::new(bytes), ImageFormat::Png);
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_ALLOCATION);
    reader.limits(limits);
    reader.decode().map_err(|error| {
        let hint = format!("the file may be cut short; at most {MAX_SIDE} pixels a side are read");
        Error::invalid(path, format!("this is not a readable PNG: {error}"), hint)
    })
}

/// The provenance inside a PNG, if any.
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    let bytes = read_bounded(path, MAX_FILE_BYTES)?;
    if !bytes.starts_with(&SIGNATURE) {
        return Err(Error::invalid(path, "this is not a PNG", "its first bytes are wrong"));
    }
    Ok(find_text(&bytes).and_then(|json| Provenance::from_json(&json)))
}

/// First bytes of every PNG [PNG] §5.2.
const SIGNATURE: [u8; 8] = [0x89, b'P', b'N', b'G', 0x0D, 0x0A, 0x1A, 0x0A];

/// Signature and header chunk (8 + 8 + 13 + 4 bytes), after which text may stand.
const HEAD_BYTES: usize = 33;

/// An uncompressed iTXt chunk [PNG] §11.3.3.4; the encoder in use cannot write one.
fn text_chunk(text: &str) -> Vec<u8> {
    let mut body = b"iTXt".to_vec();
    body.extend_from_slice(KEYWORD.as_bytes());
    // End of keyword, not compressed, method 0, no language, no translated keyword.
    body.extend_from_slice(&[0, 0, 0, 0, 0]);
    body.extend_from_slice(text.as_bytes());
    let mut chunk = ((body.len() - 4) as u32).to_be_bytes().to_vec();
    let sum = crc32(&body);
    chunk.append(&mut body);
    chunk.extend_from_slice(&sum.to_be_bytes());
    chunk
}

/// The text under our keyword.
fn find_text(bytes: &[u8]) -> Option<String> {
    let mut rest = bytes.get(SIGNATURE.len()..)?;
    loop {
        let (length, after) = rest.split_first_chunk::<4>()?;
        let (kind, after) = after.split_first_chunk::<4>()?;
        let (body, after) = after.split_at_checked(u32::from_be_bytes(*length) as usize)?;
        if kind == b"iTXt"
            && let Some(text) = body.strip_prefix(b"weald\0\0\0\0\0")
        {
            return String::from_utf8(text.to_vec()).ok();
        }
        rest = after.get(4..)?;
    }
}

/// CRC-32 of PNG chunks, bit by bit [PNG] annex D; texts are short, so no table is kept.
fn crc32(bytes: &[u8]) -> u32 {
    let step = |sum: u32, _| if sum & 1 == 1 { 0xEDB8_8320 ^ (sum >> 1) } else { sum >> 1 };
    !bytes.iter().fold(!0u32, |sum, &byte| (0..8).fold(sum ^ u32::from(byte), step))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;

    #[test]
    fn a_preview_comes_back_with_its_provenance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("preview.png");
        let rgb: Vec<u8> = (0..5 * 3 * 3).map(|i| i * 5).collect();
        write_png(&path, 5, 3, &rgb, &story()).unwrap();
        assert_eq!(read_png(&path).unwrap(), Preview { width: 5, height: 3, rgb });
        assert_eq!(provenance(&path).unwrap(), Some(story()));
    }

    #[test]
    fn a_density_layer_comes_back_code_for_code() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("density.png");
        write_gray_png(&path, 2, 2, &[0, 1, 256, 65535], &story()).unwrap();
        let codes = read_image(&path).unwrap().values.into_iter().map(|value| value * 65535.0);
        assert_eq!(codes.collect::<Vec<_>>(), [0.0, 1.0, 256.0, 65535.0]);
        assert!(write_gray_png(&path, 2, 2, &[0], &story()).is_err());
    }

    #[test]
    fn the_check_sum_is_the_published_one() {
        // "IEND" without data ends every PNG with the bytes AE 42 60 82.
        assert_eq!(crc32(b"IEND"), 0xAE42_6082);
    }

    #[test]
    fn a_value_is_its_code_over_the_maximum_in_eight_and_sixteen_bits() {
        let encode = |picture: DynamicImage| {
            let mut bytes = Cursor::new(Vec::new());
            picture.write_to(&mut bytes, ImageFormat::Png).unwrap();
            parse_image(Path::new("x.png"), &bytes.into_inner())
        };
        let gray8 = image::GrayImage::from_raw(2, 1, vec![0, 51]).unwrap();
        assert_eq!(encode(gray8.into()).unwrap().values, [0.0, 0.2]);
        let gray16 = image::ImageBuffer::from_raw(2, 1, vec![65535u16, 13107]).unwrap();
        assert_eq!(encode(DynamicImage::ImageLuma16(gray16)).unwrap().values, [1.0, 0.2]);
        let rgb = image::RgbImage::from_raw(1, 1, vec![1, 2, 3]).unwrap();
        assert!(encode(rgb.into()).unwrap_err().to_string().contains("grayscale"));
    }
}
