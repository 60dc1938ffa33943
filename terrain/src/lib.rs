//! Elevation models to terrain layers: a stack of operators, water and soil.
//!
//! Altitude comes from an elevation model and passes through an ordered list of operators, each
//! confined by a mask in [0, 1], as layers do in a paint program [Deussen98, §3]:
//! `out = lerp(in, op(in), mask)`. When the list is done, water stands in its hollows, rain runs
//! over the ground and soaks into it, and the layers that plants care about are derived.
//!
//! All lengths are metres in scene coordinates (from the terrain's south-west corner), never
//! cells, so that the same list shapes a coarse grid and a finer patch around a view alike.

pub mod area;
mod breach;
mod config;
pub mod derive;
mod detail;
pub mod disperse;
mod editor;
mod environment;
mod erosion;
pub mod fill;
pub mod flow;
mod footprint;
pub mod hollow;
mod import;
mod lattice;
mod mask;
mod nearest;
mod noise;
mod operator;
mod overlay;
pub mod rain;
mod resample;
mod road;
mod spline;
mod stack;
mod stamp;
mod stream;
pub mod suction;
pub mod sun;
mod water;

pub use breach::Breach;
pub use config::{Config, Detail, Holes, LayerCommon, Water};
pub use editor::{COARSE, Editor};
pub use environment::{CATALOGUE, Environment, LayerKind, Routing, kind};
pub use erosion::{Erode, Thermal};
pub use footprint::Footprint;
pub use mask::{Combine, Disc, Line, Mask, Masks, NoiseMask};
pub use noise::{Fractal, NoiseKind, NoiseShape};
pub use operator::{Blend, Clamp, Flatten, Lake, Noise, Offset, Operator, Scale, Smooth, Terrace};
pub use overlay::LayerEdit;
pub use road::Road;
pub use stamp::{Crater, Hill, Remap, Translate};
pub use stream::StreamCut;

use std::collections::BTreeMap;
use weald_contract::{Crs, Image, Layers, Problem, Progress, Raster, Seed, View};

/// Raised whenever the same configuration gives other bytes than before.
pub const OUTPUT_VERSION: u32 = 4;

/// Memory of a cell while a terrain is made, with water and the usual layers, bytes: 81 were
/// measured.
pub const BYTES_PER_CELL: u64 = 82;

/// Why no terrain came out.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// Something in the scene or its files cannot be used.
    #[error(transparent)]
    Problem(#[from] Problem),
    /// The user asked to stop.
    #[error("stopped before the terrain was done")]
    Cancelled,
}

/// Builds a terrain: the layers of the whole ground, and finer patches where `config` asks.
///
/// `elevation` is the opened `config.source`; `images` holds the opened mask images by their path
/// as written, and for the model of a footprint an image that is 1 where its mesh covers the ground,
/// with its frame in the mesh's own metres. Layers: those that [`Config::layer_names`] lists, each with unit and definition.
///
/// # Errors
/// The first [`Problem`] of [`Config::check`], or what only the data can show: an elevation model
/// in degrees, without data or of absurd size; a lake above its hollow's rim; an image of another
/// shape. [`Error::Cancelled`] when `progress` says so.
pub fn build(
    config: &Config,
    elevation: &Raster,
    images: &BTreeMap<String, Image>,
    views: &[View],
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Layers, Error> {
    if let Some(problem) = config.check(views).into_iter().next() {
        return Err(problem.into());
    }
    let ground = import::ground(config, elevation, progress)?;
    // Nothing is asked for twice here: the cache holds nothing.
    let mut cache = stack::Cache::new(0);
    let parts = Parts { ground: &ground, crs: &elevation.crs, images, views, seed };
    parts.layers(config, &mut cache, progress)
}

/// What a terrain is made of besides its configuration.
struct Parts<'a> {
    ground: &'a import::Ground,
    crs: &'a Crs,
    images: &'a BTreeMap<String, Image>,
    views: &'a [View],
    seed: Seed,
}

impl Parts<'_> {
    /// All layers of a configuration that was checked.
    fn layers(
        &self,
        config: &Config,
        cache: &mut stack::Cache,
        progress: &dyn Progress,
    ) -> Result<Layers, Error> {
        let shaped = self.shape(config, cache, progress)?;
        self.settle(config, self.ground, &shaped, progress)
    }

    /// The ground after the last operator.
    fn shape<'a>(
        &self,
        config: &'a Config,
        cache: &mut stack::Cache,
        progress: &dyn Progress,
    ) -> Result<stack::Shaped<'a>, Error> {
        stack::shape(config, self.ground, &self.map(), self.seed, cache, progress)
    }

    /// Water and all layers of shaped ground that lies on the cells of `ground`.
    fn settle(
        &self,
        config: &Config,
        ground: &import::Ground,
        shaped: &stack::Shaped<'_>,
        progress: &dyn Progress,
    ) -> Result<Layers, Error> {
        let (map, views) = (self.map(), self.views);
        let hydrology = water::settle(config, ground, shaped, &map, progress)?;
        let mut layers = water::layers(ground, shaped, &hydrology, self.crs);
        let environment = environment::Source { config, shaped, water: &hydrology };
        environment.extend(&mut layers, progress)?;
        let patches = detail::Patches { ground, shaped, map: &map, views, environment };
        // Patches take the layers as they were made, and are edited on their own cells.
        layers.detail = patches.build(config, &hydrology, &layers, progress)?;
        overlay::run(config, &shaped.lattice, &map, &mut layers)?;
        ground.keep_holes(&mut layers);
        Ok(layers)
    }

    fn map(&self) -> mask::Map<'_> {
        mask::Map { frame: self.ground.frame, images: self.images }
    }
}

/// `Err(Cancelled)` when the user asked to stop.
fn check_cancelled(progress: &dyn Progress) -> Result<(), Error> {
    if progress.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
}
