//! GeoTIFF and ESRI ASCII grids.
#![no_main]
use std::path::Path;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = weald_formats::geotiff::parse_raster(Path::new("fuzz.tif"), bytes.to_vec());
    if let Ok(text) = std::str::from_utf8(bytes) {
        let _ = weald_formats::ascii_grid::parse_raster(Path::new("fuzz.asc"), text);
    }
});
