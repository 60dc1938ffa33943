//! Textures inside a GLB: written as PNG, read as PNG or JPEG.

use crate::error::{Error, Result};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder, ImageReader, Limits};
use std::io::Cursor;
use std::path::Path;
use weald_contract::Texture;

/// Widest and highest texture that is read, texels.
const MAX_SIDE: u32 = 8192;

/// Most memory that reading one texture may take, bytes.
const MAX_ALLOCATION: u64 = 1 << 29;

/// A texture as PNG; coverage is written only where it is needed.
pub(super) fn to_png(path: &Path, texture: &Texture) -> Result<Vec<u8>> {
    let Texture { name, width, height, texels } = texture;
    let is_full = texels.iter().all(|texel| texel[3] == 255);
    let (bytes, color) = if is_full {
        let bytes = texels.iter().flat_map(|&[r, g, b, _]| [r, g, b]).collect();
        (bytes, ExtendedColorType::Rgb8)
    } else {
        (texels.as_flattened().to_vec(), ExtendedColorType::Rgba8)
    };
    let mut png = Vec::new();
    let written = PngEncoder::new(&mut png).write_image(&bytes, *width, *height, color);
    written.map_err(|error| Error::invalid(path, format!("the texture `{name}`: {error}"), ""))?;
    Ok(png)
}

/// A texture from the bytes of a picture of any format that we know.
pub(crate) fn from_bytes(path: &Path, name: String, bytes: &[u8]) -> Result<Texture> {
    let wrong = |error: &dyn std::fmt::Display| {
        Error::invalid(path, format!("the texture `{name}` cannot be read: {error}"), "use PNG")
    };
    let reader = ImageReader::new(Cursor::new(bytes)).with_guessed_format();
    let mut reader = reader.map_err(|error| wrong(&error))?;
    let mut limits = Limits::default();
    limits.max_image_width = Some(MAX_SIDE);
    limits.max_image_height = Some(MAX_SIDE);
    limits.max_alloc = Some(MAX_ALLOCATION);
    reader.limits(limits);
    let picture = reader.decode().map_err(|error| wrong(&error))?.into_rgba8();
    let (width, height) = picture.dimensions();
    let texels = picture.pixels().map(|pixel| pixel.0).collect();
    Ok(Texture { name, width, height, texels })
}
