//! Plant models.
#![no_main]
use std::path::Path;

libfuzzer_sys::fuzz_target!(|bytes: &[u8]| {
    if let Ok(model) = weald_formats::plant::parse_plant(Path::new("fuzz.glb"), bytes) {
        assert!(model.wood.iter().all(|mesh| mesh.is_sound(model.materials.len())));
    }
});
