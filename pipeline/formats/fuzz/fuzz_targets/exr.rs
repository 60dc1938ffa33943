//! Pictures.
#![no_main]
use std::path::Path;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let _ = weald_formats::picture::parse_picture(Path::new("fuzz.exr"), bytes);
});
