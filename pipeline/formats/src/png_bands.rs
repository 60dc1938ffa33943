//! Images too large to hold: read row by row and averaged down as they come.
//!
//! Every pixel counts in full, so that sums over the image, and with them numbers of plants, stay
//! what they were; only detail finer than two pixels in 16,384 is lost.

use crate::error::{Error, Result};
use png::{BitDepth, ColorType, Decoder, Limits, Transformations};
use std::io::BufReader;
use std::path::Path;
use weald_contract::Image;

/// Widest and highest image that is held as it is, pixels: 1 GB of numbers.
pub(crate) const LARGE_SIDE: u32 = 1 << 14;
/// Pixels along the longer side of what a larger image is averaged to, at most.
const REDUCED_SIDE: usize = 1 << 13;
/// Widest and highest image that is read at all.
const MAX_SIDE: u32 = 1 << 16;

/// Reads one band of a PNG whose width or height is above [`LARGE_SIDE`].
pub(crate) fn read(path: &Path) -> Result<Image> {
    let file = std::fs::File::open(path).map_err(Error::io("open", path))?;
    let unreadable = |error: png::DecodingError| {
        Error::invalid(path, format!("this is not a readable PNG: {error}"), "it may be cut short")
    };
    // A row of the widest image, twice, with what the decoder keeps beside it.
    let limits = Limits { bytes: 64 << 20 };
    let mut decoder = Decoder::new_with_limits(BufReader::with_capacity(1 << 20, file), limits);
    decoder.set_transformations(Transformations::EXPAND);
    let mut reader = decoder.read_info().map_err(unreadable)?;
    let (columns, rows) = (reader.info().width, reader.info().height);
    if columns > MAX_SIDE || rows > MAX_SIDE {
        let message = format!("the image has {columns} × {rows} pixels");
        return Err(Error::invalid(path, message, format!("at most {MAX_SIDE} a side are read")));
    }
    if reader.info().interlaced {
        let message = format!("an interlaced image of {columns} × {rows} pixels");
        return Err(Error::unsupported(path, message, "save it without interlacing"));
    }
    let (color, depth) = reader.output_color_type();
    let channels = match color {
        ColorType::Grayscale => 1,
        ColorType::GrayscaleAlpha => 2,
        ColorType::Rgb => 3,
        ColorType::Rgba => 4,
        ColorType::Indexed => return Err(Error::unsupported(path, "a palette", "save it as gray")),
    };
    let pixel = Pixel { channels, is_wide: depth == BitDepth::Sixteen };
    let mut reduced = Reduced::new(columns as usize, rows as usize);
    let mut line = vec![0.0f32; columns as usize];
    while let Some(row) = reader.next_row().map_err(unreadable)? {
        pixel.values(path, row.data(), &mut line)?;
        reduced.add(&line);
    }
    Ok(reduced.image())
}

/// How a pixel stands in a row.
struct Pixel {
    channels: usize,
    is_wide: bool,
}

impl Pixel {
    fn values(&self, path: &Path, row: &[u8], line: &mut [f32]) -> Result<()> {
        let bytes = if self.is_wide { 2 } else { 1 };
        let code = |pixel: &[u8], channel: usize| match self.is_wide {
            true => u16::from_be_bytes([pixel[2 * channel], pixel[2 * channel + 1]]),
            false => u16::from(pixel[channel]),
        };
        let most = if self.is_wide { 65535.0 } else { 255.0 };
        for (value, pixel) in line.iter_mut().zip(row.chunks_exact(self.channels * bytes)) {
            let first = code(pixel, 0);
            if self.channels >= 3 && (code(pixel, 1) != first || code(pixel, 2) != first) {
                let hint = "one band is needed: save it as grayscale";
                return Err(Error::invalid(path, "the image is coloured", hint));
            }
            *value = f32::from(first) / most;
        }
        Ok(())
    }
}

/// An image on its way to fewer pixels, each the mean of the area that it covers.
struct Reduced {
    /// Pixels across and down before.
    from: [usize; 2],
    /// Pixels across and down after.
    to: [usize; 2],
    /// Sums over area, of the rows that are done and the one at work.
    sums: Vec<f64>,
    row: usize,
}

impl Reduced {
    fn new(columns: usize, rows: usize) -> Self {
        let factor = columns.max(rows).div_ceil(REDUCED_SIDE);
        let to = [columns, rows].map(|side| side.div_ceil(factor));
        Self { from: [columns, rows], to, sums: vec![0.0; to[0] * to[1]], row: 0 }
    }

    fn add(&mut self, line: &[f32]) {
        let [width, height] = self.to;
        let mut means = vec![0.0f64; width];
        for (column, &value) in line.iter().enumerate() {
            for (at, part) in shares(column, self.from[0], width) {
                means[at] += part * f64::from(value);
            }
        }
        for (at, part) in shares(self.row, self.from[1], height) {
            let sums = &mut self.sums[at * width..(at + 1) * width];
            sums.iter_mut().zip(&means).for_each(|(sum, mean)| *sum += part * mean);
        }
        self.row += 1;
    }

    fn image(self) -> Image {
        let [width, height] = self.to;
        let area = self.from[0] as f64 / width as f64 * (self.from[1] as f64 / height as f64);
        let values = self.sums.into_iter().map(|sum| (sum / area) as f32).collect();
        Image { width, height, values, is_float: false, frame: None }
    }
}

/// The one or two pixels after that a pixel before falls on, and how much of it on each.
fn shares(index: usize, from: usize, to: usize) -> impl Iterator<Item = (usize, f64)> {
    // In units of 1 / (from · to), of which a pixel before is `to` wide, one after `from`.
    let (start, end) = (index * to, (index + 1) * to);
    let first = start / from;
    let edge = (first + 1) * from;
    let here = (edge.min(end) - start) as f64 / to as f64;
    let beyond = end.saturating_sub(edge) as f64 / to as f64;
    let second = (beyond > 0.0).then_some((first + 1, beyond));
    std::iter::once((first, here)).chain(second)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn written(width: u32, height: u32, color: ColorType, row: impl Fn(u32) -> Vec<u8>) -> Image {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("large.png");
        let file = std::fs::File::create(&path).unwrap();
        let mut encoder = png::Encoder::new(std::io::BufWriter::new(file), width, height);
        encoder.set_color(color);
        encoder.set_compression(png::Compression::Fastest);
        let mut writer = encoder.write_header().unwrap();
        let mut stream = writer.stream_writer().unwrap();
        (0..height).for_each(|r| std::io::Write::write_all(&mut stream, &row(r)).unwrap());
        stream.finish().unwrap();
        drop(writer);
        crate::read_image(&path).unwrap()
    }

    #[test]
    fn a_wide_image_is_averaged_and_keeps_its_sum() {
        // 20,001 pixels do not divide evenly; the third pixel of 60 is white.
        let image = written(20_001, 60, ColorType::Grayscale, |row| {
            (0..20_001u32).map(|column| if (column + row) % 60 == 2 { 255 } else { 0 }).collect()
        });
        assert_eq!((image.width, image.height), (6667, 20));
        let mean = image.values.iter().map(|value| f64::from(*value)).sum::<f64>()
            / image.values.len() as f64;
        let white: u32 =
            (0..60).map(|row| (0..20_001u32).filter(|c| (c + row) % 60 == 2).count() as u32).sum();
        let expected = f64::from(white) / (20_001.0 * 60.0);
        assert!((mean - expected).abs() < 1e-8 * expected.max(1.0), "{mean} {expected}");
    }

    #[test]
    fn a_coloured_row_is_refused_and_a_gray_one_read() {
        let image = written(17_000, 2, ColorType::Rgb, |_| vec![51; 3 * 17_000]);
        assert!(image.values.iter().all(|value| (value - 0.2).abs() < 1e-6));
    }

    #[test]
    fn pixels_are_shared_out_wholly() {
        for (from, to) in [(10, 3), (20_001, 6667), (40_000, 8000), (7, 7)] {
            let mut sums = vec![0.0; to];
            for index in 0..from {
                let parts: f64 = shares(index, from, to)
                    .map(|(at, part)| {
                        sums[at] += part;
                        part
                    })
                    .sum();
                assert!((parts - 1.0).abs() < 1e-12);
            }
            let even = from as f64 / to as f64;
            assert!(sums.iter().all(|sum| (sum - even).abs() < 1e-9), "{from} {to}");
        }
    }
}
