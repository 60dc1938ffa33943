//! Path tracer for instanced landscapes: light of sun and sky through billions of leaves.
//!
//! A [`Scene`] is a tree of levels. Plants are meshes; groups place plants or other groups; the
//! scene places groups, plants, the ground and objects. Nothing is ever copied: a ray is taken
//! into the space of the instance that it enters, to any depth, so memory follows the number of
//! *different* things. [`render`] follows light paths backwards from the eye [Kajiya86], with
//! next-event estimation towards sun and sky and multiple importance sampling [Veach97], and
//! returns a [`Film`] of radiance and first-hit layers.
//!
//! Radiance is linear Rec. 709; its luminance is in kcd/m². Everything is deterministic: the
//! same parts and seed give the same bits for any number of threads.

mod accel;
mod bsdf;
mod camera;
mod coat;
mod config;
mod environment;
mod film;
mod ground;
mod matte;
mod model;
mod nested;
mod noise;
mod paint;
mod path;
pub mod portable;
mod primitive;
pub mod probe;
mod sampler;
mod scene;
mod sky;
mod tone;
mod water;

pub use config::{Config, Sky};
pub use environment::SkyPictures;
pub use film::{Film, FilmStatistics};
pub use ground::mesh as ground_mesh;
pub use model::NESTED_TRIANGLES;
pub use path::render;
pub use probe::probe;
pub use scene::{Object, Parts, PrototypeSource, Scene, Statistics, estimate_bytes};
pub use tone::tone_map;

use weald_contract::Problem;

/// Changes whenever the same input would give other bytes than before.
pub const OUTPUT_VERSION: u32 = 9;

/// Why there is no picture.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Something the user wrote.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The caller asked to stop.
    #[error("stopped before it was done")]
    Cancelled,
    /// The terrain lacks a layer.
    #[error("the terrain has no layer `{0}`; `weald terrain` writes it")]
    MissingLayer(&'static str),
    /// A value of the terrain is not a number, or the grid is too small to have a surface.
    #[error("the terrain's layer `{layer}` cannot be a surface: {what}")]
    BadTerrain {
        /// The layer.
        layer: &'static str,
        /// What is wrong with it.
        what: String,
    },
    /// A picture is no sky.
    #[error("the picture of the sky cannot be used: {what}")]
    BadSky {
        /// What is wrong with it.
        what: String,
    },
    /// A mesh has indices out of range or coordinates that are no numbers.
    #[error("the model of {what} is damaged: {why}")]
    BadModel {
        /// Which prototype or object.
        what: String,
        /// What is wrong with it.
        why: String,
    },
    /// An instance refers to an id that is neither a representative nor a group.
    #[error("row {row} of the instances places prototype {prototype}, which the palette lacks")]
    UnknownPrototype {
        /// Row of the table.
        row: usize,
        /// The id.
        prototype: u32,
    },
    /// Two things of the palette have the same id.
    #[error(
        "the palette gives id {id} to both {first} and {second}; ids of representatives and \
         groups are one series, from 1 on"
    )]
    SharedId {
        /// The id.
        id: u32,
        /// What has it first.
        first: String,
        /// What has it again.
        second: String,
    },
    /// An instance stands nowhere, or has no size.
    #[error("row {row} of the instances is damaged: {why}")]
    BadInstance {
        /// Row of the table.
        row: usize,
        /// What is wrong with it.
        why: &'static str,
    },
    /// Groups contain each other in a circle or nest too deep.
    #[error("group {group} is nested more than {limit} levels deep or contains itself")]
    Nesting {
        /// A group on the circle.
        group: u32,
        /// Levels that are allowed.
        limit: usize,
    },
    /// More things than indices can number.
    #[error("{what}: {count} are more than the {limit} that can be numbered")]
    TooMany {
        /// Of what.
        what: String,
        /// How many there are.
        count: usize,
        /// How many there may be.
        limit: usize,
    },
}
