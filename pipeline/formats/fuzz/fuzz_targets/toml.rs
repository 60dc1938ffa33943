//! The tables users write: a palette, a species and a view.
#![no_main]
use std::path::Path;
use weald_contract::{FromToml, Problems, Species, Value, View};

libfuzzer_sys::fuzz_target!(|text: &str| {
    let _ = weald_formats::parse_palette(Path::new("fuzz.toml"), text);
    if let Ok(value) = Value::parse(0, text) {
        let mut problems = Problems::new();
        let _ = Species::read(&value, &mut problems);
        let _ = View::from_toml(&value, &mut problems);
    }
});
