//! Every work cited in the code by key stands in `docs/references.md`, and every entry is cited.

use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

#[test]
fn every_citation_resolves_and_every_reference_is_cited() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    let bibliography = std::fs::read_to_string(root.join("docs/references.md")).unwrap();
    let listed: BTreeSet<String> = bibliography
        .lines()
        .filter_map(|line| line.strip_prefix("- **[")?.split_once(']').map(|(key, _)| key.into()))
        .collect();
    let mut cited = BTreeSet::new();
    for folder in
        ["pipeline", "terrain", "ecosim", "quantize", "plants", "render", "scenes", "docs"]
    {
        for file in sources(&root.join(folder)) {
            cited.extend(citations(&std::fs::read_to_string(&file).unwrap()));
        }
    }
    let unresolved: Vec<&String> = cited.difference(&listed).collect();
    let uncited: Vec<&String> = listed.difference(&cited).collect();
    assert!(unresolved.is_empty(), "cited, but not in docs/references.md: {unresolved:?}");
    assert!(uncited.is_empty(), "in docs/references.md, but cited nowhere: {uncited:?}");
}

/// Rust sources, species files and documents below `folder`, without the bibliography itself.
fn sources(folder: &Path) -> Vec<PathBuf> {
    let Ok(entries) = std::fs::read_dir(folder) else { return Vec::new() };
    let mut found = Vec::new();
    for path in entries.map(|entry| entry.unwrap().path()) {
        let has_ending = |ending: &str| path.extension().is_some_and(|e| e == ending);
        if path.is_dir() && !path.ends_with("target") {
            found.extend(sources(&path));
        } else if (has_ending("rs") || has_ending("md") || has_ending("toml"))
            && !path.ends_with("references.md")
            && !path.ends_with("references.rs")
        {
            found.push(path);
        }
    }
    found
}

/// Keys in brackets, perhaps with a chapter behind: a capital, letters, two digits of the year,
/// perhaps a letter.
fn citations(text: &str) -> BTreeSet<String> {
    let is_key = |key: &str| {
        let name = key.trim_end_matches(|c: char| c.is_ascii_lowercase());
        let letters = name.trim_end_matches(|c: char| c.is_ascii_digit());
        letters.starts_with(|c: char| c.is_ascii_uppercase())
            && letters.len() >= 2
            && letters.chars().all(|c| c.is_ascii_alphabetic())
            && name.len() - letters.len() == 2
            && key.len() - name.len() <= 1
    };
    text.split('[')
        .skip(1)
        .filter_map(|after| after.split_once(']')?.0.split([' ', ',']).next())
        .filter(|key| is_key(key))
        .map(String::from)
        .collect()
}
