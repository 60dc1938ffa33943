//! Edit scripts of semantic trees: `weald plants edit`.

use crate::alone::story;
use crate::error::{Error, Result};
use crate::files;
use crate::make::{Made, make_folder_of};
use crate::portrait::portrait;
use crate::recipe::Stage;
use crate::specimen::{skeleton_at, species_given};
use serde_json::json;
use std::fmt::Write as _;
use std::path::Path;
use weald_contract::{Progress, Seed, Written};
use weald_plants::material::LeafColor;
use weald_plants::organ::LeafShape;
use weald_plants::semantic::import::tree_of;
use weald_plants::semantic::script::Editor;
use weald_plants::semantic::tree::Tree;
use weald_plants::semantic::trees::{Example, TREES};
use weald_plants::semantic::{MOST_LEAVES, Semantic, Statistics};

/// What to do with an edit script.
#[derive(Clone, Debug)]
pub struct Wanted {
    /// Chance of the tree, unless the script names one.
    pub seed: u64,
    /// Species of this program or file whose tree is edited, and its age, years; none for a trunk
    /// alone.
    pub from: Option<(String, f32)>,
    /// Side of the portrait, pixels.
    pub side: u32,
    /// Light paths a pixel of it.
    pub samples: u32,
}

/// Runs an edit script, from a file or one of the program's nine, and writes the model with its
/// portrait (`.glb`), or the portrait alone (`.png`), if a file is named.
///
/// # Errors
/// A script that cannot be read or has a wrong line; a file that cannot be written.
pub fn edit(
    script: &str,
    wanted: &Wanted,
    output: Option<&Path>,
    progress: &dyn Progress,
) -> Result<Made> {
    let is_picture = output.is_some_and(|file| file.extension().is_some_and(|end| end == "png"));
    if let Some(file) = output.filter(|_| !is_picture) {
        files::must_end(file, "glb")?;
    }
    let example = TREES.into_iter().find(|example| example.name == script);
    let text = match example {
        Some(example) => example.script.to_string(),
        None => read(script)?,
    };
    let mut editor = match &wanted.from {
        Some((species, age)) => Editor::of(imported(species, *age, wanted.seed)?),
        None => Editor::new(wanted.seed),
    };
    let operations = editor.run(&text).map_err(|error| {
        Error::plain(format!("{script}: {error}"), "the lines before it are right")
    })?;
    let counted = Statistics::of(editor.tree());
    let mut made = Made {
        report: json!({
            "operations": operations,
            "branches": counted.branches,
            "leaves": counted.leaves,
            "levels": counted.levels,
            "geometry_bytes": counted.geometry,
            "parameter_bytes": counted.parameters,
        }),
        words: in_words(&counted, example.as_ref()),
        ..Made::default()
    };
    let Some(file) = output else { return Ok(made) };
    if counted.leaves > MOST_LEAVES {
        let what = format!("{script}: the tree has {} leaves", counted.leaves);
        return Err(Error::plain(what, format!("at most {MOST_LEAVES} can be drawn")));
    }
    let form = Semantic {
        script: Written { value: text.clone(), span: Default::default() },
        leaf_shape: LeafShape::Ovate,
        leaf_width: 0.6,
        leaf_color: LeafColor::default(),
        bark: [0.15, 0.12, 0.09],
    };
    let model = weald_plants::mesh::model(script, &form.skeleton(editor.tree(), 1.0, 1.0));
    make_folder_of(file)?;
    let told = story(Stage::Plants, json!({ "script": text, "from": wanted.from }), wanted.seed);
    if !is_picture {
        weald_formats::write_plant(file, &model, &told)?;
        made.files.push(file.into());
    }
    let picture = portrait(&model, wanted.side, wanted.samples, progress)?;
    let preview = file.with_extension("png");
    weald_formats::write_png(&preview, picture.width, picture.height, &picture.rgb, &told)?;
    made.files.push(preview);
    Ok(made)
}

/// A tree of a species, as entities.
fn imported(species: &str, age: f32, seed: u64) -> Result<Tree> {
    let (sources, name, found) = species_given(species)?;
    if found.form.is_none() {
        let hint = "name one of its members";
        return Err(Error::plain(format!("`{name}` is a patch of other plants"), hint));
    }
    let chance = Seed(seed).part(Stage::Plants.word(), 0);
    let skeleton = skeleton_at(&sources, &name, &found, [age, 1.0], chance)?;
    tree_of(&skeleton, seed).map_err(|what| {
        Error::plain(format!("{name} cannot be edited: {what}"), "name a tree, for instance oak")
    })
}

fn read(script: &str) -> Result<String> {
    let path = Path::new(script);
    std::fs::read_to_string(path).map_err(|error| {
        if error.kind() != std::io::ErrorKind::NotFound {
            return Error::system(path, error);
        }
        let names: Vec<&str> = TREES.iter().map(|example| example.name).collect();
        let what = format!("there is no file {script}");
        Error::plain(what, format!("the program itself has {}", names.join(", ")))
    })
}

/// The row of the paper's table, and the paper's own below.
fn in_words(counted: &Statistics, example: Option<&Example>) -> String {
    let mut words =
        String::from("           branches    leaves  levels  geometry B  parameters B  a branch\n");
    let each = counted.parameters / counted.branches.max(1);
    let _ = writeln!(
        words,
        "this tree {:>10} {:>9} {:>7} {:>11} {:>13} {:>9}",
        counted.branches,
        counted.leaves,
        counted.levels,
        counted.geometry,
        counted.parameters,
        each
    );
    if let Some(paper) = example {
        let each = paper.parameters / paper.branches;
        let _ = writeln!(
            words,
            "the paper {:>10} {:>9} {:>7} {:>11} {:>13} {:>9}",
            paper.branches, paper.leaves, "", "", paper.parameters, each
        );
    }
    words
}
