//! Plain values that cross a stage boundary, and the small languages users write.
//!
//! Everything here is data: no file is opened, nothing is printed, no clock is read. A type
//! enters only if one stage hands it to another, or if the same words stand in several tables
//! of a scene. Lengths are metres, time is years, angles are radians in values and degrees in
//! texts (`_deg`); X is east, Y is north, Z is up.

pub mod curve;
pub mod formula;
pub mod grid;
pub mod input;
pub mod instances;
pub mod layers;
pub mod palette;
pub mod picture;
pub mod plant_model;
pub mod population;
pub mod progress;
mod projection;
pub mod seed;
pub mod size;
pub mod source;
pub mod species;
pub mod table;
pub mod view;

pub use curve::Curve;
pub use formula::Formula;
pub use grid::{Crs, Frame, Grid, Image, Raster};
pub use input::{Input, InputKind};
pub use instances::Instances;
pub use layers::{Layer, Layers};
pub use palette::{Group, Palette, Representative};
pub use picture::{Channel, Picture};
pub use plant_model::{
    Branch, Material, Mesh, Organ, Paint, Placement, PlantModel, Surface, Texture,
};
pub use population::{PLANT_COLUMNS, Plant, Population, State};
pub use progress::{Progress, Silent};
pub use projection::UtmZone;
pub use seed::{Seed, Stream};
pub use size::Size;
pub use source::{Problem, Problems, Source, Sources, Span};
pub use species::{GroupMember, GroupRecipe, Species};
pub use table::{FromToml, Value, Written};
pub use view::{Projection, View};
