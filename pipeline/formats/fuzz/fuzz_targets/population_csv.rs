//! Tables of plants as CSV.
#![no_main]
use std::path::Path;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    let path = Path::new("fuzz.csv");
    let _ = weald_formats::population::parse_population_csv(path, bytes.to_vec());
});
