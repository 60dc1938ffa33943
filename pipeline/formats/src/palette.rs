//! The palette as a text to read and edit.

use crate::bytes::read_text;
use crate::error::{Error, Result};
use crate::provenance::Provenance;
use crate::whole::write_atomically;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use weald_contract::{FromToml, Group, Palette, Problems, Representative, Sources, Value, table};

/// Longest palette that is read: some hundred thousand entries.
const MAX_BYTES: u64 = 16 << 20;

table! {
    /// A palette file.
    pub struct PaletteFile {
        /// How the file came to be, as JSON.
        provenance: Option<Value> = None;
        /// Plants to grow.
        representative: Vec<RepresentativeRow> = Vec::new();
        /// Patches of plants.
        group: Vec<GroupRow> = Vec::new();
    }
}

table! {
    /// A `[[representative]]`.
    pub struct RepresentativeRow {
        /// Number by which instances refer to it.
        id: u32, in 1.0..=4294967295.0;
        /// Species name.
        species: String;
        /// Age, years.
        age: f32, in 0.0..=100000.0;
        /// Vigor in [0, 1].
        vigor: f32, in 0.0..=1.0;
        /// Height, m.
        height: f32, in 0.0..=1000.0;
        /// Crown radius, m.
        radius: f32, in 0.0..=1000.0;
        /// Sum of the importance weights of its plants.
        weight: f64 = 0.0, in 0.0..=f64::MAX;
        /// Number of plants it stands for.
        count: u64 = 0;
    }
}

table! {
    /// A `[[group]]`.
    pub struct GroupRow {
        /// Number by which instances refer to it.
        id: u32, in 1.0..=4294967295.0;
        /// Species name of the group.
        species: String;
        /// Age the group stands for, years.
        age: f32 = 0.0, in 0.0..=100000.0;
        /// Vigor the group stands for.
        vigor: f32 = 1.0, in 0.0..=1.0;
        /// Number of instances of it.
        count: u64 = 0;
    }
}

/// Writes a palette as TOML.
///
/// # Errors
/// When the disk refuses.
pub fn write_palette(path: &Path, palette: &Palette, provenance: &Provenance) -> Result<()> {
    let text = to_toml(palette, provenance);
    write_atomically(path, |file| Ok(file.write_all(text.as_bytes())?))
}

fn to_toml(palette: &Palette, provenance: &Provenance) -> String {
    let mut text = String::new();
    let quote = |word: &str| toml::Value::from(word).to_string();
    let plants: u64 = palette.representatives.iter().map(|r| r.count).sum();
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "# {} representatives stand for {plants} plants; {} groups.\n\
         # Lengths in metres, ages in years, vigor from 0 to 1.\n",
        palette.representatives.len(),
        palette.groups.len(),
    );
    for row in &palette.representatives {
        let _ = write!(
            text,
            "\n[[representative]]\nid = {}\nspecies = {}\nage = {}\nvigor = {}\nheight = {}\n\
             radius = {}\nweight = {:?}\ncount = {}\n",
            row.id,
            quote(&row.species),
            float(row.age),
            float(row.vigor),
            float(row.height),
            float(row.radius),
            row.weight,
            row.count,
        );
    }
    for row in &palette.groups {
        let _ = write!(
            text,
            "\n[[group]]\nid = {}\nspecies = {}\nage = {}\nvigor = {}\ncount = {}\n",
            row.id,
            quote(&row.species),
            float(row.age),
            float(row.vigor),
            row.count,
        );
    }
    let _ = write!(text, "\n[provenance]\njson = {}\n", quote(&provenance.to_json()));
    text
}

/// The shortest text that comes back with the same bits through a 64-bit number.
fn float(value: f32) -> String {
    let short = format!("{value:?}");
    let back = short.parse::<f64>().map(|wide| wide as f32);
    if back == Ok(value) { short } else { format!("{:?}", f64::from(value)) }
}

/// Reads a palette.
///
/// # Errors
/// Names line and column of everything that is wrong; ids must be unique.
pub fn read_palette(path: &Path) -> Result<Palette> {
    parse_palette(path, &read_text(path, MAX_BYTES)?)
}

/// Reads a palette from its text; `path` is for messages only.
///
/// # Errors
/// As [`read_palette`].
pub fn parse_palette(path: &Path, text: &str) -> Result<Palette> {
    let file = parse(path, text)?;
    let palette = Palette {
        representatives: file.representative.into_iter().map(Representative::from).collect(),
        groups: file.group.into_iter().map(Group::from).collect(),
    };
    let plants = palette.representatives.iter().map(|row| row.id);
    let mut ids: Vec<u32> = plants.chain(palette.groups.iter().map(|row| row.id)).collect();
    ids.sort_unstable();
    match ids.array_windows().find(|[a, b]| a == b) {
        Some([id, _]) => {
            let hint = "representatives and groups share one series of ids";
            Err(Error::invalid(path, format!("two entries have the id {id}"), hint))
        }
        None => Ok(palette),
    }
}

fn parse(path: &Path, text: &str) -> Result<PaletteFile> {
    let mut sources = Sources::default();
    let source = sources.add(path.display().to_string(), text);
    let mut problems = Problems::new();
    let read = match Value::parse(source, text) {
        Ok(value) => PaletteFile::from_toml(&value, &mut problems),
        Err(found) => {
            problems = found;
            None
        }
    };
    match read.filter(|_| problems.is_empty()) {
        Some(file) => Ok(file),
        None => {
            let line = |problem: &weald_contract::Problem| match problem
                .span
                .and_then(|span| sources.line_column(span))
            {
                Some((line, column)) => format!("line {line}, column {column}: {problem}"),
                None => problem.to_string(),
            };
            let lines: Vec<String> = problems.iter().map(line).collect();
            Err(Error::invalid(path, lines.join("\n  "), ""))
        }
    }
}

/// The provenance inside a palette, if any.
pub(crate) fn provenance(path: &Path) -> Result<Option<Provenance>> {
    let text = read_text(path, MAX_BYTES)?;
    // Any TOML may be asked: scenes and species simply have none.
    let Ok(value) = Value::parse(0, &text) else { return Ok(None) };
    let table =
        value.as_table().and_then(|table| table.get("provenance")).and_then(Value::as_table);
    let json = table.and_then(|table| table.get("json")).and_then(Value::as_str);
    Ok(json.and_then(Provenance::from_json))
}

impl From<RepresentativeRow> for Representative {
    fn from(row: RepresentativeRow) -> Self {
        let RepresentativeRow { id, species, age, vigor, height, radius, weight, count } = row;
        Self { id, species, age, vigor, height, radius, weight, count }
    }
}

impl From<GroupRow> for Group {
    fn from(row: GroupRow) -> Self {
        let GroupRow { id, species, age, vigor, count } = row;
        Self { id, species, age, vigor, count }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;
    use proptest::prelude::*;

    fn sample() -> Palette {
        let plant = |id: u32| Representative {
            id,
            species: "quaking \"aspen\"".into(),
            age: 0.1 * id as f32,
            vigor: 1.0 / 3.0,
            height: 1e-7,
            radius: 123.456,
            weight: 1e-300 * f64::from(id),
            count: 1 << 62,
        };
        let group = Group { id: 9, species: "turf".into(), age: 2.0, vigor: 0.7, count: 31_415 };
        Palette { representatives: vec![plant(1), plant(2)], groups: vec![group] }
    }

    #[test]
    fn a_palette_comes_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("palette.toml");
        for palette in [sample(), Palette::default()] {
            write_palette(&path, &palette, &story()).unwrap();
            assert_eq!(read_palette(&path).unwrap(), palette);
            assert_eq!(provenance(&path).unwrap(), Some(story()));
        }
    }

    #[test]
    fn a_slip_is_named_with_line_and_what_was_meant() {
        let text = "[[group]]\nid = 1\nspecies = \"turf\"\nvigour = 0.5\n";
        let error = parse_palette(Path::new("palette.toml"), text).unwrap_err().to_string();
        assert!(error.contains("line 4, column 1") && error.contains("`vigor`"), "{error}");
        let twice = "[[group]]\nid = 1\nspecies = \"a\"\n[[group]]\nid = 1\nspecies = \"b\"\n";
        let error = parse_palette(Path::new("palette.toml"), twice).unwrap_err().to_string();
        assert!(error.contains("two entries have the id 1"), "{error}");
    }

    proptest! {
        #[test]
        fn every_float_survives_its_text(bits in any::<u32>()) {
            let value = f32::from_bits(bits);
            prop_assume!(value.is_finite());
            let back: f64 = float(value).parse().unwrap();
            prop_assert_eq!((back as f32).to_bits(), bits);
        }

        #[test]
        fn random_text_never_panics(text in "(\\[\\[group\\]\\]|id|species|=|\n|[0-9.\"e-]|[a-z]){0,60}") {
            let _ = parse_palette(Path::new("p.toml"), &text);
        }
    }
}
