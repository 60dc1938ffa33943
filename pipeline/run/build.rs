//! Lists the species files of `scenes/species/`, so that the binary carries them.
//!
//! Writes a table of (name, text) sorted by name; `src/library.rs` includes it.

use std::fmt::Write as _;
use std::path::Path;
use std::{env, fs};

fn main() {
    let folder = Path::new(&env::var("CARGO_MANIFEST_DIR").expect("cargo sets it"))
        .join("../../scenes/species");
    println!("cargo:rerun-if-changed={}", folder.display());
    let mut files: Vec<_> = fs::read_dir(&folder)
        .map(|entries| entries.flatten().map(|entry| entry.path()).collect())
        .unwrap_or_default();
    files.retain(|path| path.extension().is_some_and(|extension| extension == "toml"));
    files.sort();

    let mut table = String::from("&[\n");
    for path in files {
        println!("cargo:rerun-if-changed={}", path.display());
        let name = path.file_stem().expect("a listed file has a name").to_string_lossy();
        let path = path.canonicalize().expect("a listed file exists");
        writeln!(table, "    ({name:?}, include_str!({path:?})),").expect("strings take all");
    }
    table.push_str("]\n");
    let out = Path::new(&env::var("OUT_DIR").expect("cargo sets it")).join("species.rs");
    fs::write(out, table).expect("the build folder can be written");
}
