//! OpenEXR: pictures of named channels, linear light.
//!
//! One part holds all channels, `R G B A Z albedo.R …`, sorted by name, in ZIP blocks of 16
//! lines: the form that every compositor opens. Colours are 16-bit floats; depth, positions and
//! ids keep 32 bits.

use crate::bytes::{MAX_FILE_BYTES, read_bounded};
use crate::error::{Error, Result};
use crate::provenance::Provenance;
use crate::whole::write_atomically;
use exr::meta::MetaData;
use exr::meta::attribute::{AttributeValue, Chromaticities, Text};
use exr::prelude::{
    AnyChannel, AnyChannels, Encoding, FlatSamples, IntegerBounds, LayerAttributes, ReadChannels,
    ReadLayers, SmallVec, Vec2, WritableImage, f16,
};
use std::io::{Cursor, Write};
use std::path::Path;
use weald_contract::{Channel, Image, Picture};

/// Name of the attribute that holds the provenance.
const ATTRIBUTE: &str = "weald";

/// Most samples (pixels times channels) that are read: four gigabytes as floats.
const MAX_SAMPLES: usize = 1 << 30;

/// Most samples that a byte of file may stand for. ZIP reaches 516 half floats a byte; a file
/// that promises far more is damaged, and its promise is not worth the memory.
const SAMPLES_PER_BYTE: usize = 1 << 14;

/// Chromaticities of Rec. 709 primaries and its white, D65 [BT709] §1.
const REC709: Chromaticities = Chromaticities {
    red: Vec2(0.640, 0.330),
    green: Vec2(0.300, 0.600),
    blue: Vec2(0.150, 0.060),
    white: Vec2(0.3127, 0.3290),
};

/// Writes a picture. Values beyond a 16-bit float's reach become the largest it has, 65504.
///
/// # Errors
/// When a channel has another size, two share a name, or the disk refuses.
pub fn write_picture(path: &Path, picture: &Picture, provenance: &Provenance) -> Result<()> {
    check(path, picture)?;
    let channels: SmallVec<[AnyChannel<FlatSamples>; 4]> = picture
        .channels
        .iter()
        .filter_map(|channel| {
            let name = Text::new_or_none(&channel.name)?;
            Some(AnyChannel::new(name, samples(channel)))
        })
        .collect();
    let size = Vec2(picture.width, picture.height);
    let mut attributes = LayerAttributes {
        software_name: Text::new_or_none(format!("weald {}", provenance.version)),
        ..LayerAttributes::default()
    };
    if let Some(json) = Text::new_or_none(ascii(&provenance.to_json())) {
        attributes.other.insert(Text::from(ATTRIBUTE), AttributeValue::Text(json));
    }
    for (name, text) in &picture.attributes {
        if let (Some(name), Some(text)) = (Text::new_or_none(name), Text::new_or_none(ascii(text)))
        {
            attributes.other.insert(name, AttributeValue::Text(text));
        }
    }
    let layer = exr::image::Layer::new(
        size,
        attributes,
        Encoding::SMALL_LOSSLESS,
        AnyChannels::sort(channels),
    );
    let mut image = exr::image::Image::from_layer(layer);
    image.attributes.display_window = IntegerBounds::from_dimensions(size);
    image.attributes.chromaticities = Some(REC709);
    write_atomically(path, |file| {
        let mut bytes = Cursor::new(Vec::new());
        image.write().to_buffered(&mut bytes)?;
        sort_header(bytes.get_mut());
        Ok(file.write_all(bytes.get_ref())?)
    })
}

/// Puts the attributes of a single part's header into the order of their names: the writer keeps
/// them in a map of no order, and equal pictures must give equal bytes. Each is a name and a type,
/// both ended by a zero byte, a length and a value; an empty name ends the header.
fn sort_header(bytes: &mut [u8]) {
    /// Length of the magic number and the version.
    const START: usize = 8;
    let name_end = |from: usize| Some(from + bytes.get(from..)?.iter().position(|&b| b == 0)?);
    let mut attributes = Vec::new();
    let mut at = START;
    while bytes.get(at).is_some_and(|&byte| byte != 0) {
        let Some(kind_end) = name_end(at).and_then(|end| name_end(end + 1)) else { return };
        let Some(length) = bytes.get(kind_end + 1..kind_end + 5) else { return };
        let length = u32::from_le_bytes([length[0], length[1], length[2], length[3]]) as usize;
        let next = kind_end + 5 + length;
        let Some(attribute) = bytes.get(at..next) else { return };
        attributes.push(attribute.to_vec());
        at = next;
    }
    attributes.sort();
    let sorted = attributes.concat();
    bytes[START..START + sorted.len()].copy_from_slice(&sorted);
}

fn check(path: &Path, picture: &Picture) -> Result<()> {
    let pixels = picture.width.saturating_mul(picture.height);
    let fits_window = |side: usize| i32::try_from(side).is_ok_and(|side| side > 0);
    if !fits_window(picture.width) || !fits_window(picture.height) || picture.channels.is_empty() {
        let message = format!(
            "a picture of {} x {} pixels and {} channels",
            picture.width,
            picture.height,
            picture.channels.len()
        );
        return Err(Error::invalid(path, message, "it needs a pixel and a channel"));
    }
    let mut names = std::collections::BTreeSet::new();
    for channel in &picture.channels {
        let name = &channel.name;
        if channel.values.len() != pixels {
            let message = format!("channel `{name}` has {} values", channel.values.len());
            return Err(Error::invalid(path, message, format!("the picture has {pixels} pixels")));
        }
        // OpenEXR ends a name with a zero byte and allows 255 bytes before it.
        let is_plain = name.is_ascii() && (1..256).contains(&name.len()) && !name.contains('\0');
        if !is_plain || !names.insert(name) {
            let hint = "names are ASCII, unique and of 1 to 255 characters";
            return Err(Error::invalid(path, format!("`{name}` is no name for a channel"), hint));
        }
    }
    Ok(())
}

fn samples(channel: &Channel) -> FlatSamples {
    if channel.is_exact {
        return FlatSamples::F32(channel.values.clone());
    }
    let largest = f16::MAX.to_f32();
    let narrow = |&value: &f32| f16::from_f32(value.clamp(-largest, largest));
    FlatSamples::F16(channel.values.iter().map(narrow).collect())
}

/// JSON with every character beyond ASCII escaped: EXR texts are single bytes.
fn ascii(json: &str) -> String {
    let mut text = String::with_capacity(json.len());
    let mut units = [0; 2];
    for character in json.chars() {
        if character.is_ascii() {
            text.push(character);
        } else {
            for unit in character.encode_utf16(&mut units) {
                text.push_str(&format!("\\u{unit:04x}"));
            }
        }
    }
    text
}

/// Reads a picture, ours or anyone's: the first part without deep data. Channels come sorted by
/// name.
///
/// # Errors
/// When the file is missing, damaged or larger than we read.
pub fn read_picture(path: &Path) -> Result<Picture> {
    parse_picture(path, &read_bounded(path, MAX_FILE_BYTES)?)
}

/// Reads a picture from bytes; `path` is for messages only.
///
/// # Errors
/// As [`read_picture`].
pub fn parse_picture(path: &Path, bytes: &[u8]) -> Result<Picture> {
    check_size(path, bytes)?;
    let image = guarded(path, || {
        exr::prelude::read()
            .no_deep_data()
            .largest_resolution_level()
            .all_channels()
            .first_valid_layer()
            .all_attributes()
            .non_parallel()
            .from_buffered(Cursor::new(bytes))
    })?;
    let layer = image.layer_data;
    let (width, height) = (layer.size.width(), layer.size.height());
    let mut picture = Picture::new(width, height);
    for (name, value) in layer.attributes.other {
        if let AttributeValue::Text(text) = value
            && name.to_string() != ATTRIBUTE
        {
            picture.attributes.insert(name.to_string(), text.to_string());
        }
    }
    for channel in layer.channel_data.list {
        let name = channel.name.to_string();
        let (values, is_exact): (Vec<f32>, bool) = match channel.sample_data {
            FlatSamples::F16(values) => {
                (values.iter().map(|value| value.to_f32()).collect(), false)
            }
            FlatSamples::F32(values) => (values, true),
            FlatSamples::U32(values) => (values.iter().map(|&value| value as f32).collect(), true),
        };
        if values.len() != width.saturating_mul(height) {
            let message = format!("channel `{name}` is subsampled");
            return Err(Error::unsupported(path, message, "channels of full size are"));
        }
        picture.channels.push(Channel { name, values, is_exact });
    }
    Ok(picture)
}

/// Refuses sizes that the header promises but that we would not hold, before anything of that
/// size is allocated.
fn check_size(path: &Path, bytes: &[u8]) -> Result<()> {
    let meta = guarded(path, || MetaData::read_from_buffered(bytes, false))?;
    let mut total = 0usize;
    for header in &meta.headers {
        let pixels = header.layer_size.width().saturating_mul(header.layer_size.height());
        total = total.saturating_add(pixels.saturating_mul(header.channels.list.len()));
    }
    let limit = MAX_SAMPLES.min(bytes.len().saturating_mul(SAMPLES_PER_BYTE));
    if total > limit {
        let message = format!("the picture promises {total} samples");
        let hint = format!("a file of its length may hold at most {limit}");
        return Err(Error::invalid(path, message, hint));
    }
    Ok(())
}

/// Runs the third-party reader; its errors become ours.
fn guarded<T>(path: &Path, read: impl FnOnce() -> exr::error::Result<T>) -> Result<T> {
    read().map_err(|error| {
        let message = format!("this is not a readable OpenEXR picture: {error}");
        Error::invalid(path, message, "the file may be cut short")
    })
}

/// Reads one band: the only channel, or `Y`, or `R` when red, green and blue agree.
pub(crate) fn read_image(path: &Path) -> Result<Image> {
    let Picture { width, height, mut channels, .. } = read_picture(path)?;
    let find = |name: &str| channels.iter().position(|channel| channel.name == name);
    let values = |index: Option<usize>| index.and_then(|i| channels.get(i)).map(|c| &c.values);
    let (red, green, blue) = (find("R"), find("G"), find("B"));
    let is_gray = values(red) == values(green) && values(green) == values(blue);
    let index = match (channels.len(), find("Y")) {
        (1, _) => Some(0),
        (_, Some(luminance)) => Some(luminance),
        _ => red.filter(|_| is_gray),
    };
    let Some(index) = index else {
        let names: Vec<&str> = channels.iter().map(|channel| channel.name.as_str()).collect();
        let message = format!("the picture has the channels {}", names.join(", "));
        return Err(Error::invalid(path, message, "one band is needed: a single channel or `Y`"));
    };
    let values = channels.swap_remove(index).values;
    Ok(Image { width, height, values, is_float: true, frame: None })
}

/// The provenance inside a picture, if any.
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    let file = std::fs::File::open(path).map_err(Error::io("open", path))?;
    let meta = guarded(path, || MetaData::read_from_unbuffered(file, false))?;
    let attribute = |header: &exr::meta::header::Header| match header
        .own_attributes
        .other
        .get(&Text::from(ATTRIBUTE))
    {
        Some(AttributeValue::Text(text)) => Provenance::from_json(&text.to_string()),
        _ => None,
    };
    Ok(meta.headers.iter().find_map(attribute))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;

    fn sample() -> Picture {
        let (width, height) = (37, 21);
        let ramp = |k: f32| (0..width * height).map(|i| i as f32 * k).collect::<Vec<f32>>();
        let mut picture = Picture::new(width, height);
        // By name, as the file sorts them.
        picture.add("B", false, ramp(0.25));
        picture.add("G", false, ramp(0.5));
        picture.add("R", false, ramp(1.0));
        picture.add("Z", true, ramp(0.1));
        picture.add("albedo.R", false, ramp(0.125));
        picture.add("plant", true, ramp(12_345.0));
        let manifest = "{\"aspen\":\"1234abcd\"}".to_string();
        picture.attributes.insert("cryptomatte/0123456/manifest".into(), manifest);
        picture
    }

    #[test]
    fn a_picture_comes_back_bit_for_bit_with_its_provenance() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("image.exr");
        write_picture(&path, &sample(), &story()).unwrap();
        assert_eq!(read_picture(&path).unwrap(), sample());
        assert_eq!(provenance(&path).unwrap(), Some(story()));
    }

    #[test]
    fn equal_pictures_give_equal_bytes() {
        let folder = tempfile::tempdir().unwrap();
        let mut large = Picture::new(300, 400);
        for number in 0..20 {
            large.attributes.insert(format!("cryptomatte/{number}"), "plants".into());
        }
        large.add("Y", true, (0..120_000).map(|i| ((i * 7919) % 1000) as f32).collect());
        let write = |name: &str| {
            let path = folder.path().join(name);
            write_picture(&path, &large, &story()).unwrap();
            std::fs::read(path).unwrap()
        };
        assert!(write("a.exr") == write("b.exr"));
    }

    #[test]
    fn light_too_bright_for_sixteen_bits_stays_finite() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("sun.exr");
        let mut sun = Picture::new(1, 1);
        sun.add("R", false, vec![1e9]);
        write_picture(&path, &sun, &story()).unwrap();
        assert_eq!(read_picture(&path).unwrap().channel("R"), Some(&[65504.0][..]));
    }

    #[test]
    fn one_band_is_the_only_channel_or_y_or_gray_red() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("density.exr");
        let band = |names: &[(&str, f32)]| {
            let mut picture = Picture::new(1, 1);
            names.iter().for_each(|&(name, value)| picture.add(name, true, vec![value]));
            write_picture(&path, &picture, &story()).unwrap();
            read_image(&path).map(|image| image.values)
        };
        assert_eq!(band(&[("depth", 3.0)]).unwrap(), [3.0]);
        assert_eq!(band(&[("A", 1.0), ("Y", 4.0)]).unwrap(), [4.0]);
        assert_eq!(band(&[("R", 5.0), ("G", 5.0), ("B", 5.0), ("A", 1.0)]).unwrap(), [5.0]);
        assert!(band(&[("R", 5.0), ("G", 6.0), ("B", 5.0)]).is_err());
    }

    #[test]
    fn channels_that_do_not_fit_are_named() {
        let mut picture = sample();
        picture.channels[3].values.pop();
        let error = write_picture(Path::new("x.exr"), &picture, &story()).unwrap_err();
        assert!(error.to_string().contains("`Z`"), "{error}");
    }
}
