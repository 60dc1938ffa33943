//! GeoTIFF: one band of numbers with its place on the map [OGC19-008].
//!
//! The geokeys (tags 34735 to 34737) are carried through as raw numbers: real files hold keys
//! that no typed model accepts. Unit, definition and provenance stand in GDAL's metadata
//! (tag 42112), where `gdalinfo` and QGIS show them.

use crate::error::{Error, Result};
use crate::provenance::Provenance;
use crate::utm::{self, Cells};
use crate::whole::{AnyError, write_atomically};
use geotiff_reader::{GeoTiffFile, GeoTiffOpenOptions};
use std::path::Path;
use tiff_core::{Compression, Predictor, Tag, TagValue, TiffSample};
use tiff_writer::{ImageBuilder, TiffWriter, WriteOptions};
use weald_contract::{Crs, Frame, Grid, Image, Raster};

const MODEL_PIXEL_SCALE: u16 = 33550;
const MODEL_TIEPOINT: u16 = 33922;
const GEO_KEYS: u16 = 34735;
const GEO_DOUBLES: u16 = 34736;
const GEO_ASCII: u16 = 34737;
const GDAL_METADATA: u16 = 42112;
/// GDAL's text for the value that means "no data".
const GDAL_NODATA: u16 = 42113;

/// Geokey that says whether a value belongs to a cell (1) or a point (2).
const RASTER_TYPE_KEY: u16 = 1025;
/// Geokey of the unit of projected coordinates; 9001 is the metre.
const LINEAR_UNIT_KEY: u16 = 3076;

/// Side of a tile, cells; GDAL's own default for tiled files.
const TILE: usize = 256;

/// Most cells that are read, 2²⁸ (16,384 × 16,384): one gigabyte of values.
pub const MAX_CELLS: usize = 1 << 28;

/// Most cells that a byte of file may stand for: GDAL's sparse files leave whole tiles of up to
/// 1024 x 1024 cells to 16 bytes of their table.
const CELLS_PER_BYTE: usize = 1 << 16;

/// Cells whose sides differ by less than this part are squares: 10,000 of them drift apart by a
/// tenth of a cell. Converters leave differences of 1e-9 to 1e-7.
const SQUARE_TOLERANCE: f64 = 1e-5;

/// A band with what its file says about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Values and map.
    pub raster: Raster,
    /// Unit, empty when not said.
    pub unit: String,
    /// What the values mean, empty when not said.
    pub definition: String,
}

/// Reads a raster; longitude and latitude are brought to the UTM zone of the raster's middle.
///
/// # Errors
/// When the file is damaged, has several bands, is rotated or has cells that are not square.
pub fn read_raster(path: &Path) -> Result<Raster> {
    Ok(read_band(path)?.raster)
}

/// Reads a raster with unit and definition.
///
/// # Errors
/// As [`read_raster`].
pub fn read_band(path: &Path) -> Result<Band> {
    let file = open(path)?;
    let items = metadata_items(&file);
    let item = |name: &str| find_item(&items, name).unwrap_or_default();
    let (unit, definition) = (item("UNITTYPE"), item("DEFINITION"));
    let south = find_item(&items, "WEALD_SOUTH").and_then(|text| text.parse().ok());
    Ok(Band { raster: raster(path, &file, south)?, unit, definition })
}

/// Reads a raster from bytes; `path` is for messages only.
///
/// # Errors
/// As [`read_raster`].
pub fn parse_raster(path: &Path, bytes: Vec<u8>) -> Result<Raster> {
    let file = guarded(path, || GeoTiffFile::from_bytes_with_options(bytes, options()))?;
    raster(path, &file, None)
}

/// Reads one band as an image: integers become code / maximum.
///
/// # Errors
/// As [`read_raster`].
pub fn read_image(path: &Path) -> Result<Image> {
    let file = open(path)?;
    let Samples { mut values, maximum } = samples(path, &file)?;
    if let Some(maximum) = maximum {
        values.iter_mut().for_each(|value| *value = (f64::from(*value) / maximum) as f32);
    }
    let Grid { frame, values } = place(path, &file, values, None)?.grid;
    let (width, height) = (frame.width, frame.height);
    Ok(Image { width, height, values, is_float: maximum.is_none(), frame: Some(frame) })
}

/// The provenance inside a GeoTIFF, if any.
///
/// # Errors
/// When the file is not a readable GeoTIFF.
pub fn provenance(path: &Path) -> Result<Option<Provenance>> {
    let file = open(path)?;
    let item = find_item(&metadata_items(&file), "weald");
    Ok(item.and_then(|json| Provenance::from_json(&json)))
}

/// The reference system of a GeoTIFF, without its values.
///
/// # Errors
/// When the file is not a readable GeoTIFF.
pub fn reference_system(path: &Path) -> Result<Crs> {
    Ok(crs(&open(path)?))
}

fn options() -> GeoTiffOpenOptions {
    // The widest sample has eight bytes.
    let mut options =
        GeoTiffOpenOptions { decode_output_bytes: MAX_CELLS * 8, ..GeoTiffOpenOptions::default() };
    // Largest metadata we meet are provenance chains of some 100 kB.
    options.parse_budgets.max_tag_value_bytes = 64 << 20;
    options.parse_budgets.max_metadata_value_bytes = 128 << 20;
    options.parse_budgets.max_ifds = 256;
    options
}

fn open(path: &Path) -> Result<GeoTiffFile> {
    // Opened here first so that a missing file gives the system's own words.
    std::fs::File::open(path).map_err(Error::io("open", path))?;
    guarded(path, || GeoTiffFile::open_with_options(path, options()))
}

/// Runs the third-party reader and turns its errors into ours.
fn guarded<T>(path: &Path, read: impl FnOnce() -> geotiff_reader::Result<T>) -> Result<T> {
    read().map_err(|error| match error {
        geotiff_reader::Error::NotGeoTiff => Error::invalid(
            path,
            "the TIFF has no place on the map",
            "give it one with `gdal_translate -a_srs -a_ullr`, or save a plain image as PNG",
        ),
        other => Error::invalid(
            path,
            format!("this is not a readable GeoTIFF: {other}"),
            "the file may be cut short; `gdal_translate -co COMPRESS=DEFLATE` writes one we read",
        ),
    })
}

fn raster(path: &Path, file: &GeoTiffFile, south: Option<f64>) -> Result<Raster> {
    let values = samples(path, file)?.values;
    place(path, file, values, south)
}

/// Values on their squares of metres.
fn place(path: &Path, file: &GeoTiffFile, values: Vec<f32>, south: Option<f64>) -> Result<Raster> {
    reject_feet(path, file)?;
    let crs = crs(file);
    let cells = cells(path, file)?;
    if crs.is_geographic {
        return utm::to_utm(path, &cells, &values, &crs);
    }
    let frame = squares(path, &cells, south)?;
    Ok(Raster { grid: Grid { frame, values }, crs })
}

/// The rectangle that the cells tile, in the units of the file's map.
fn cells(path: &Path, file: &GeoTiffFile) -> Result<Cells> {
    let (width, height) = (file.width() as usize, file.height() as usize);
    if width == 0 || height == 0 || width.saturating_mul(height) > MAX_CELLS {
        let message = format!("the raster has {width} x {height} cells");
        return Err(Error::invalid(path, message, format!("1 to {MAX_CELLS} cells are read")));
    }
    let Some(transform) = file.transform() else {
        let hint = "give it one with `gdal_edit.py -a_ullr WEST NORTH EAST SOUTH`";
        return Err(Error::invalid(path, "the TIFF has no place on the map", hint));
    };
    let (across, down) = (transform.pixel_width, -transform.pixel_height);
    let is_straight = transform.skew_x == 0.0 && transform.skew_y == 0.0;
    if !(is_straight && across > 0.0 && down > 0.0) {
        let hint = "warp it north-up with `gdalwarp`";
        return Err(Error::unsupported(path, "a rotated or flipped raster", hint));
    }
    let (west, north) = (transform.origin_x, transform.origin_y);
    let far = [west + width as f64 * across, north - height as f64 * down];
    if [across, down, west, north, far[0], far[1]].iter().any(|number| !number.is_finite()) {
        return Err(Error::invalid(path, "its place on the map is not finite", ""));
    }
    Ok(Cells { width, height, west, north, across, down })
}

/// Cells that must be squares. `exact_south` undoes the rounding of north = south + height · cell.
fn squares(path: &Path, cells: &Cells, exact_south: Option<f64>) -> Result<Frame> {
    let Cells { width, height, west, north, across, down } = *cells;
    if (across - down).abs() > SQUARE_TOLERANCE * across {
        let message = format!("the cells measure {across} x {down}");
        let hint = "cells must be squares in metres: `gdalwarp -t_srs EPSG:UTM_ZONE -tr 1 1`";
        return Err(Error::invalid(path, message, hint));
    }
    let rounded = north - height as f64 * across;
    let near = |south: &f64| (south - rounded).abs() <= 1e-6 * across;
    let south = exact_south.filter(near).unwrap_or(rounded);
    Ok(Frame { width, height, cell: across, west, south })
}

fn crs(file: &GeoTiffFile) -> Crs {
    let tags = |code| file.tiff().ifds().iter().find_map(|ifd| ifd.tag(code)).map(|t| &t.value);
    let keys = match tags(GEO_KEYS) {
        Some(TagValue::Short(keys)) => keys.clone(),
        _ => Vec::new(),
    };
    let doubles = match tags(GEO_DOUBLES) {
        Some(TagValue::Double(doubles)) => doubles.clone(),
        _ => Vec::new(),
    };
    let ascii = match tags(GEO_ASCII) {
        Some(TagValue::Ascii(ascii)) => ascii.clone(),
        _ => String::new(),
    };
    let info = file.crs();
    let is_geographic = info.model_type == 2;
    let code = if is_geographic { info.geographic_epsg() } else { info.projected_epsg() };
    // 0 is "undefined" and 32767 "user-defined" [OGC19-008] §7.1.
    let epsg = code.filter(|code| !matches!(code, 0 | 32767)).map(u32::from);
    Crs { epsg, is_geographic, keys, doubles, ascii }
}

fn reject_feet(path: &Path, file: &GeoTiffFile) -> Result<()> {
    match file.geokeys().get_short(LINEAR_UNIT_KEY) {
        Some(unit) if !matches!(unit, 0 | 9001 | 32767) => Err(Error::unsupported(
            path,
            format!("a map in the unit EPSG:{unit}"),
            "coordinates must be metres: `gdalwarp -t_srs EPSG:UTM_ZONE`",
        )),
        _ => Ok(()),
    }
}

/// Values of the first band as numbers, NaN where there is no data.
struct Samples {
    values: Vec<f32>,
    /// Largest code of an integer band.
    maximum: Option<f64>,
}

fn samples(path: &Path, file: &GeoTiffFile) -> Result<Samples> {
    if file.band_count() != 1 {
        let message = format!("a raster of {} bands", file.band_count());
        let hint = "choose one with `gdal_translate -b 1`";
        return Err(Error::unsupported(path, message, hint));
    }
    let cells = (file.width() as usize).saturating_mul(file.height() as usize);
    let length = usize::try_from(file.tiff().source().len()).unwrap_or(usize::MAX);
    let limit = MAX_CELLS.min(length.saturating_mul(CELLS_PER_BYTE));
    if cells == 0 || cells > limit {
        let message = format!("the raster promises {cells} cells");
        let hint = format!("a file of its length may hold 1 to {limit}");
        return Err(Error::invalid(path, message, hint));
    }
    let ifd = guarded(path, || Ok(file.tiff().ifd(file.base_ifd_index())?))?;
    let layout = guarded(path, || Ok(ifd.raster_layout()?))?;
    let bits = layout.bits_per_sample;
    let unsigned = 2f64.powi(i32::from(bits)) - 1.0;
    let signed = 2f64.powi(i32::from(bits) - 1) - 1.0;
    let nodata = file.nodata().and_then(|text| text.trim().parse::<f64>().ok());
    let (values, maximum) = match (layout.sample_format, bits) {
        (1, 1..=8) => (band::<u8>(path, file, nodata)?, Some(unsigned)),
        (1, 9..=16) => (band::<u16>(path, file, nodata)?, Some(unsigned)),
        (1, 32) => (band::<u32>(path, file, nodata)?, Some(unsigned)),
        (1, 64) => (band::<u64>(path, file, nodata)?, Some(unsigned)),
        (2, 8) => (band::<i8>(path, file, nodata)?, Some(signed)),
        (2, 16) => (band::<i16>(path, file, nodata)?, Some(signed)),
        (2, 32) => (band::<i32>(path, file, nodata)?, Some(signed)),
        (2, 64) => (band::<i64>(path, file, nodata)?, Some(signed)),
        (3, 32) => (band::<f32>(path, file, nodata)?, None),
        (3, 64) => (band::<f64>(path, file, nodata)?, None),
        (format, bits) => {
            let message = format!("sample format {format} with {bits} bits");
            let hint = "convert with `gdal_translate -ot Float32`";
            return Err(Error::unsupported(path, message, hint));
        }
    };
    if values.len() != cells {
        return Err(Error::invalid(path, "the band has another size than its file says", ""));
    }
    Ok(Samples { values, maximum })
}

/// A number that a TIFF may hold.
trait Number: TiffSample + Copy {
    fn as_f64(self) -> f64;
}

macro_rules! numbers {
    ($($ty:ty)*) => { $(impl Number for $ty { fn as_f64(self) -> f64 { self as f64 } })* };
}
numbers!(u8 u16 u32 u64 i8 i16 i32 i64 f32 f64);

fn band<T: Number>(path: &Path, file: &GeoTiffFile, nodata: Option<f64>) -> Result<Vec<f32>> {
    let array = guarded(path, || file.read_band::<T>(0))?;
    // Files hold "no data" as text with fewer digits than the value has, so that a value as
    // large as -3.4028235e38 is only met within a tolerance.
    let is_missing =
        |value: f64| nodata.is_some_and(|missing| (value - missing).abs() <= 1e-6 * missing.abs());
    let number = |&sample: &T| {
        let value = sample.as_f64();
        if is_missing(value) { f32::NAN } else { value as f32 }
    };
    Ok(array.iter().map(number).collect())
}

/// Writes one band: tiles of 256, 32-bit floats, Deflate with the floating-point predictor.
///
/// # Errors
/// When the values do not fit the frame, or the disk refuses.
pub fn write_band(path: &Path, band: BandRef<'_>, provenance: &Provenance) -> Result<()> {
    let frame = band.frame;
    let size = (u32::try_from(frame.width), u32::try_from(frame.height));
    let (Ok(width), Ok(height), false) = (size.0, size.1, frame.is_empty()) else {
        let message = format!("a raster of {} x {} cells", frame.width, frame.height);
        return Err(Error::unsupported(path, message, "both sides must be 1 to 2³² - 1"));
    };
    if band.values.len() != frame.len() {
        let message = format!("{} values for {} cells", band.values.len(), frame.len());
        return Err(Error::invalid(path, message, "give one value a cell"));
    }
    let mut image = ImageBuilder::new(width, height)
        .sample_type::<f32>()
        .compression(Compression::Deflate)
        .predictor(Predictor::FloatingPoint)
        .tiles(TILE as u32, TILE as u32);
    for tag in map_tags(&frame, band.crs) {
        image = image.tag(tag);
    }
    let metadata = metadata_xml(&band, provenance);
    image = image.tag(Tag::new(GDAL_METADATA, TagValue::Ascii(metadata)));
    if band.values.iter().any(|value| value.is_nan()) {
        image = image.tag(Tag::new(GDAL_NODATA, TagValue::Ascii("nan".into())));
    }
    write_atomically(path, |file| write_tiles(file, image, &frame, band.values))
}

/// What [`write_band`] writes.
#[derive(Clone, Copy, Debug)]
pub struct BandRef<'a> {
    /// Name for people, the layer's.
    pub name: &'a str,
    /// Where the cells lie.
    pub frame: Frame,
    /// The map's reference system.
    pub crs: &'a Crs,
    /// Unit.
    pub unit: &'a str,
    /// What the values mean.
    pub definition: &'a str,
    /// One value a cell, north row first.
    pub values: &'a [f32],
}

fn write_tiles(
    file: &mut std::io::BufWriter<std::fs::File>,
    image: ImageBuilder,
    frame: &Frame,
    values: &[f32],
) -> std::result::Result<(), AnyError> {
    let mut writer = TiffWriter::new(file, WriteOptions::auto())?;
    let handle = writer.add_image(image)?;
    let across = frame.width.div_ceil(TILE);
    let mut tile = vec![0.0; TILE * TILE];
    for index in 0..across * frame.height.div_ceil(TILE) {
        let (left, top) = (index % across * TILE, index / across * TILE);
        copy_tile(frame, values, left, top, &mut tile);
        writer.write_block(&handle, index, &tile)?;
    }
    writer.finish()?;
    Ok(())
}

/// Copies the tile whose corner is (left, top); cells outside repeat the rim, which compresses
/// better than a step to zero.
fn copy_tile(frame: &Frame, values: &[f32], left: usize, top: usize, tile: &mut [f32]) {
    for (row, line) in tile.chunks_exact_mut(TILE).enumerate() {
        let start = frame.index(left, (top + row).min(frame.height - 1));
        let inside = TILE.min(frame.width - left);
        line[..inside].copy_from_slice(&values[start..start + inside]);
        let rim = line[inside - 1];
        line[inside..].fill(rim);
    }
}

fn map_tags(frame: &Frame, crs: &Crs) -> Vec<Tag> {
    let keys = keys_of(crs);
    // Keys are copied untouched, so the tie point must mean what they say: with "point" it is
    // the centre of the first cell.
    let is_point =
        keys.chunks_exact(4).skip(1).any(|key| matches!(key, [RASTER_TYPE_KEY, 0, _, 2]));
    let shift = if is_point { 0.5 * frame.cell } else { 0.0 };
    let tie = vec![0.0, 0.0, 0.0, frame.west + shift, frame.north() - shift, 0.0];
    let mut tags = vec![
        Tag::new(MODEL_PIXEL_SCALE, TagValue::Double(vec![frame.cell, frame.cell, 0.0])),
        Tag::new(MODEL_TIEPOINT, TagValue::Double(tie)),
    ];
    if !keys.is_empty() {
        tags.push(Tag::new(GEO_KEYS, TagValue::Short(keys)));
    }
    if !crs.doubles.is_empty() {
        tags.push(Tag::new(GEO_DOUBLES, TagValue::Double(crs.doubles.clone())));
    }
    if !crs.ascii.is_empty() {
        tags.push(Tag::new(GEO_ASCII, TagValue::Ascii(crs.ascii.clone())));
    }
    tags
}

/// The raw keys, or keys made from the EPSG code where the map came without any.
fn keys_of(crs: &Crs) -> Vec<u16> {
    match crs.epsg.map(u16::try_from) {
        Some(Ok(code)) if crs.keys.is_empty() => {
            let (model, key) = if crs.is_geographic { (2, 2048) } else { (1, 3072) };
            let header = [1, 1, 0, 3];
            let entries = [[1024, 0, 1, model], [RASTER_TYPE_KEY, 0, 1, 1], [key, 0, 1, code]];
            [header].into_iter().chain(entries).flatten().collect()
        }
        _ => crs.keys.clone(),
    }
}

fn metadata_xml(band: &BandRef<'_>, provenance: &Provenance) -> String {
    let south = format!("{:?}", band.frame.south);
    let items = [
        ("DESCRIPTION", " sample=\"0\" role=\"description\"", band.name),
        ("UNITTYPE", " sample=\"0\" role=\"unittype\"", band.unit),
        ("DEFINITION", " sample=\"0\"", band.definition),
        ("WEALD_SOUTH", "", &south),
        ("weald", "", &provenance.to_json()),
    ];
    let lines = items.map(|(name, attributes, text)| {
        format!("  <Item name=\"{name}\"{attributes}>{}</Item>\n", escape(text))
    });
    format!("<GDALMetadata>\n{}</GDALMetadata>\n", lines.concat())
}

/// Escapes twice: GDAL takes an item's text for escaped even after its XML parser has undone one
/// layer, and writes its own files so; text escaped once would end at its first `&`.
fn escape(text: &str) -> String {
    let once = |text: &str| text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;");
    once(&once(text))
}

/// The inverse of [`escape`], which also reads quotes that others escape.
fn unescape(text: &str) -> String {
    let once = |text: &str| {
        text.replace("&lt;", "<")
            .replace("&gt;", ">")
            .replace("&quot;", "\"")
            .replace("&apos;", "'")
            .replace("&amp;", "&")
    };
    once(&once(text))
}

/// Name and text of the items of GDAL's metadata.
///
/// GDAL writes a flat list of `<Item name="…">…</Item>`; that is all that is understood here.
fn metadata_items(file: &GeoTiffFile) -> Vec<(String, String)> {
    let ifds = file.tiff().ifds();
    let tag = ifds.iter().find_map(|ifd| ifd.tag(GDAL_METADATA));
    let Some(TagValue::Ascii(xml)) = tag.map(|tag| &tag.value) else {
        return Vec::new();
    };
    let item = |part: &str| {
        let (opening, rest) = part.split_once('>')?;
        let (_, name) = opening.split_once("name=\"")?;
        let (name, _) = name.split_once('"')?;
        let (text, _) = rest.split_once("</Item>")?;
        Some((name.to_string(), unescape(text)))
    };
    xml.split("<Item ").skip(1).filter_map(item).collect()
}

fn find_item(items: &[(String, String)], name: &str) -> Option<String> {
    items.iter().find(|(found, _)| found == name).map(|(_, text)| text.clone())
}
