//! Files that a stage's table names; the stage lists them, `run` opens them.

use crate::table::Written;

/// One file that a table names.
#[derive(Clone, Debug, PartialEq)]
pub struct Input {
    /// The field, for instance `terrain.source` or `ecosim.step[2].density`.
    pub field: String,
    /// The path as written, relative to the scene.
    pub path: Written<String>,
    /// What is expected in it.
    pub kind: InputKind,
}

/// What an input file holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum InputKind {
    /// Heights with a georeference, m.
    Elevation,
    /// One band of densities, parameters or mask values.
    Image,
    /// Radiance from all directions.
    Light,
    /// A table of plants.
    Plants,
    /// A mesh.
    Model,
}
