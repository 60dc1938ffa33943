//! Semantic trees: scripts replayed, and single edits of a large tree.

use super::{Figure, Size, best};
use crate::error::{Error, Result};
use weald_plants::semantic::script::Editor;
use weald_plants::semantic::trees::TREES;

/// A tree of 9,931 branches.
const LARGE: &str = "oak";

pub(super) fn edits(size: &Size) -> Result<Vec<Figure>> {
    let (time, branches) = best(size, || {
        let made = TREES.iter().map(|example| edited(example.script));
        made.map(|editor| Ok(editor?.tree().all().len())).sum::<Result<usize>>()
    })?;
    let input = format!("nine trees, {branches} branches");
    let mut figures = vec![Figure::time("semantic trees by script", time, input)];
    let oak = TREES.iter().find(|example| example.name == LARGE).expect("a name of the table");
    let mut editor = edited(oak.script)?;
    editor.run("mode recursive off\nselect path trunk/boughs/9").map_err(wrong)?;
    for (name, modes, edit) in [
        ("one branch moved", "mode same_level off", "move point 2 by 0,0,0.1"),
        ("all branches set", "select trunk\nmode recursive on", "set gnarl 7"),
    ] {
        editor.run(modes).map_err(wrong)?;
        let (time, _) = best(size, || {
            editor.run(edit).map_err(wrong)?;
            Ok(editor.tree().rebuilt)
        })?;
        figures.push(Figure::time(name, time, "oak of 9931 branches".into()));
    }
    Ok(figures)
}

fn edited(script: &str) -> Result<Editor> {
    let mut editor = Editor::new(1);
    editor.run(script).map_err(wrong)?;
    Ok(editor)
}

fn wrong(error: weald_plants::semantic::script::ScriptError) -> Error {
    Error::plain(error.to_string(), "the program's own scripts should run")
}
