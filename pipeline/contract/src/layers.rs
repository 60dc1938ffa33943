//! A terrain: named layers on one grid, with finer patches where a view needs them.

use crate::grid::{Crs, Frame, Grid};
use std::collections::BTreeMap;

/// Values of one layer and what they mean.
#[derive(Clone, Debug, PartialEq)]
pub struct Layer {
    /// Unit, in the spelling of `docs/formats.md`: `m`, `degree`, `1`, `kg m-2`.
    pub unit: String,
    /// One sentence saying how the values are defined.
    pub definition: String,
    /// One value a cell, north row first.
    pub values: Vec<f32>,
}

/// A terrain.
///
/// `altitude` is always present. **Scene coordinates** are metres from the south-west corner of
/// `frame`: `x_scene = x_map - frame.west`.
#[derive(Clone, Debug, PartialEq)]
pub struct Layers {
    /// Where the cells lie, in map coordinates.
    pub frame: Frame,
    /// The map's reference system.
    pub crs: Crs,
    /// Layers by their file stem, for instance `soil_moisture`.
    pub layers: BTreeMap<String, Layer>,
    /// Finer patches inside `frame`, with the same layers; the first that holds a point counts.
    pub detail: Vec<Layers>,
}

impl Layers {
    /// Values of a layer on this grid.
    pub fn values(&self, name: &str) -> Option<&[f32]> {
        self.layers.get(name).map(|layer| layer.values.as_slice())
    }

    /// A copy of one layer as a grid.
    pub fn grid(&self, name: &str) -> Option<Grid> {
        let values = self.values(name)?.to_vec();
        Some(Grid { frame: self.frame, values })
    }

    /// Adds or replaces a layer.
    pub fn insert(&mut self, name: &str, unit: &str, definition: &str, values: Vec<f32>) {
        assert_eq!(values.len(), self.frame.len(), "layer {name} does not fit its frame");
        let layer = Layer { unit: unit.into(), definition: definition.into(), values };
        self.layers.insert(name.into(), layer);
    }

    /// The finest grid that holds a point given in map coordinates.
    pub fn finest(&self, x: f64, y: f64) -> &Layers {
        self.detail.iter().find(|patch| patch.frame.contains(x, y)).unwrap_or(self)
    }

    /// Bilinear value of a layer at a point in map coordinates, from the finest grid there.
    ///
    /// `None` when the terrain has no such layer.
    pub fn sample(&self, name: &str, x: f64, y: f64) -> Option<f32> {
        let grid = self.finest(x, y);
        Some(grid.frame.sample(grid.values(name)?, x, y))
    }
}
