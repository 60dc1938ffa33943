//! Scenes, plans, cache, previews and exporters: the one place where stages meet.
//!
//! A scene is read once, with every mistake found ([`scene`]). Each stage has a recipe of all
//! that its output depends on ([`recipe`], [`parameters`]); a plan compares recipes with the
//! records of earlier runs ([`plan`], [`record`]), and [`execute`] makes what is stale. Around
//! that stand the commands that look at files: [`info`], [`compare`], [`preview`], [`check`],
//! [`canvas`], [`export`], [`analysis`], [`vectors`], [`sweep`], [`bench`].

pub mod alone;
pub mod analysis;
pub mod appearance;
pub mod bench;
pub mod canvas;
pub mod check;
pub mod checkpoint;
pub mod compare;
mod denoise;
pub mod edit;
pub mod error;
pub mod execute;
pub mod export;
pub mod files;
mod footprint;
pub mod info;
pub mod instancing;
pub mod library;
pub mod make;
pub mod parameters;
pub mod plan;
pub mod portrait;
pub mod preview;
pub mod prototypes;
pub mod real;
pub mod recipe;
pub mod record;
pub mod replicates;
pub mod scene;
pub mod semantic;
pub mod specimen;
pub mod sweep;
pub mod template;
pub mod vectors;

pub use error::{Error, Result};
pub use execute::{Done, Layout, Listener, execute};
pub use plan::Plan;
pub use recipe::Stage;
pub use scene::{Changes, Scene};
pub use weald_formats::is_panic_contained;
