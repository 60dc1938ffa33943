//! The scene: ground, water, plants and objects put together for tracing.

use crate::{Error, Sky};
use std::sync::Arc;
use weald_contract::{Instances, Layers, Palette, PlantModel, Problem, Progress};

/// Serves plant models; the caller grows them, or reads them from its cache.
pub trait PrototypeSource: Sync {
    /// The model of a representative. Called once for each that is used, from any thread.
    ///
    /// # Errors
    /// Whatever kept the caller from having it.
    fn model(&self, prototype: u32) -> Result<Arc<PlantModel>, Problem>;
}

/// Something that is not a plant: a house, a fence, a bench.
#[derive(Clone, Debug)]
pub struct Object {
    /// What it looks like.
    pub model: Arc<PlantModel>,
    /// Where its origin stands: map coordinates and altitude, m.
    pub position: [f64; 3],
    /// Turn about the vertical, radians counter-clockwise seen from above.
    pub yaw: f32,
    /// Uniform scale.
    pub scale: f32,
}

/// What a scene is made of.
pub struct Parts<'a> {
    /// The ground. Layer `altitude` is required; `water_depth` and `soil_moisture` are used.
    pub terrain: &'a Layers,
    /// Representatives and groups.
    pub palette: &'a Palette,
    /// Where they stand.
    pub instances: &'a Instances,
    /// What the representatives look like.
    pub prototypes: &'a dyn PrototypeSource,
    /// Other things.
    pub objects: &'a [Object],
    /// Names of species, sorted; number in the picture = index + 1.
    pub species: &'a [String],
}

/// How large a scene is.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Serialize)]
pub struct Statistics {
    /// Different plant models and objects.
    pub prototypes: u64,
    /// Placements that are stored, at all levels.
    pub instances: u64,
    /// Triangles that are stored.
    pub unique_primitives: u64,
    /// Triangles that rays can meet: each counted wherever it is placed, through all levels.
    pub instanced_primitives: u128,
    /// Memory of geometry, trees and placements, bytes.
    pub bytes: u64,
}

/// A scene ready for tracing.
pub struct Scene {
    statistics: Statistics,
}

impl Scene {
    /// Puts a scene together.
    ///
    /// # Errors
    /// A damaged model, instance or terrain, a prototype that cannot be had, or a wish to stop.
    pub fn build(parts: &Parts<'_>, sky: &Sky, progress: &dyn Progress) -> Result<Scene, Error> {
        let _ = (parts, sky, progress);
        Err(Problem::new("not built yet").into())
    }

    /// How large it is.
    pub fn statistics(&self) -> &Statistics {
        &self.statistics
    }
}
