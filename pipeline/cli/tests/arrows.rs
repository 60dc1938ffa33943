//! The arrows between crates are those of ARCHITECTURE.md, and no others.

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

/// Every allowed arrow: a crate and what it may depend on.
const ARROWS: &[(&str, &[&str])] = &[
    ("weald-contract", &[]),
    ("weald-formats", &["weald-contract"]),
    ("weald-terrain", &["weald-contract"]),
    ("weald-ecosim", &["weald-contract"]),
    ("weald-analyze", &["weald-contract"]),
    ("weald-quantize", &["weald-contract"]),
    ("weald-plants", &["weald-contract"]),
    ("weald-render", &["weald-contract"]),
    (
        "weald-run",
        &[
            "weald-analyze",
            "weald-contract",
            "weald-ecosim",
            "weald-formats",
            "weald-plants",
            "weald-quantize",
            "weald-render",
            "weald-terrain",
        ],
    ),
    ("weald-cli", &["weald-contract", "weald-run"]),
];

/// Crates that know a file format; only `formats` may use them. `image` also draws nothing but
/// files, and `toml` reads the languages of the contract.
const FILE_FORMATS: &[&str] =
    &["parquet", "csv", "gltf", "exr", "geotiff-reader", "tiff-core", "tiff-writer"];

fn read(path: &Path) -> toml::Table {
    let text =
        std::fs::read_to_string(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    text.parse().unwrap_or_else(|error| panic!("{}: {error}", path.display()))
}

/// Names of the dependencies of every member of the workspace, tests' own included.
fn dependencies() -> BTreeMap<String, BTreeSet<String>> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let workspace = read(&root.join("Cargo.toml"));
    let members = workspace["workspace"]["members"].as_array().expect("a list of members");
    let mut found = BTreeMap::new();
    for member in members {
        let folder = root.join(member.as_str().expect("a path"));
        let manifest = read(&folder.join("Cargo.toml"));
        let name = manifest["package"]["name"].as_str().expect("a name").to_string();
        let mut names = BTreeSet::new();
        for table in ["dependencies", "dev-dependencies", "build-dependencies"] {
            let entries = manifest.get(table).and_then(|table| table.as_table());
            names.extend(entries.into_iter().flat_map(|table| table.keys().cloned()));
        }
        found.insert(name, names);
    }
    found
}

#[test]
fn crates_depend_on_each_other_only_along_the_arrows() {
    let found = dependencies();
    let allowed: BTreeMap<&str, &[&str]> = ARROWS.iter().copied().collect();
    for (name, dependencies) in &found {
        let allowed = allowed.get(name.as_str()).unwrap_or_else(|| {
            panic!("{name} is in no picture: add it to ARCHITECTURE.md and to this list")
        });
        for arrow in dependencies.iter().filter(|arrow| arrow.starts_with("weald-")) {
            assert!(
                allowed.contains(&arrow.as_str()),
                "an arrow outside the picture: {name} -> {arrow}"
            );
        }
    }
    let members: BTreeSet<&str> = found.keys().map(String::as_str).collect();
    for (name, _) in ARROWS {
        assert!(members.contains(name), "{name} is in the picture but not in the workspace");
    }
}

#[test]
fn only_formats_knows_file_formats() {
    for (name, dependencies) in dependencies() {
        if name == "weald-formats" {
            continue;
        }
        let known: Vec<_> =
            FILE_FORMATS.iter().filter(|format| dependencies.contains(**format)).collect();
        assert!(
            known.is_empty(),
            "{name} knows {known:?}; files are the business of weald-formats"
        );
    }
}

#[test]
fn stages_open_no_path_print_nothing_and_read_no_clock() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let forbidden =
        ["std::fs", "println!", "std::env::", "Instant::now", "SystemTime", "File::open"];
    for stage in ["terrain", "ecosim", "ecosim/analyze", "quantize", "plants", "render"] {
        for file in sources(&root.join(stage).join("src")) {
            let text = std::fs::read_to_string(&file).expect("a source file is text");
            // Tests at the end of a file may do as they like.
            let code = text.split("#[cfg(test)]").next().unwrap_or_default();
            let lines = code.lines().filter(|line| !line.trim_start().starts_with("//"));
            for line in lines {
                let found = forbidden.iter().find(|word| line.contains(**word));
                assert!(found.is_none(), "{}: {}", file.display(), line.trim());
            }
        }
    }
}

fn sources(folder: &Path) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(sources(&path));
        } else if path.extension().is_some_and(|ending| ending == "rs") {
            found.push(path);
        }
    }
    found
}
