//! Terrain: elevation model and masks to a folder of layers.

use super::{Made, at_field, images, make_folder, stage_error, stage_seed};
use crate::error::{Error, Result};
use crate::parameters::places_named;
use crate::preview;
use crate::recipe::Stage;
use crate::scene::Scene;
use serde_json::{Value as Json, json};
use std::path::{Path, PathBuf};
use weald_contract::{InputKind, Layers, Progress};
use weald_formats::Provenance;

/// Terrain: elevation model and masks to a folder of layers.
///
/// # Errors
/// An input is damaged, the stage refuses, or the disk does.
pub fn terrain(
    scene: &Scene,
    folder: &Path,
    provenance: &Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let stage = Stage::Terrain;
    let source = scene.terrain_inputs.iter().find(|input| input.input.kind == InputKind::Elevation);
    let Some(source) = source else {
        return Err(Error::plain("the scene names no elevation model", "set `terrain.source`"));
    };
    let elevation =
        weald_formats::read_raster(&source.path).map_err(at_field(scene, &source.input))?;
    let images = images(scene, &scene.terrain_inputs)?;
    let views = places_named(scene, &scene.terrain);
    let seed = stage_seed(scene, stage);
    let layers = weald_terrain::build(&scene.terrain, &elevation, &images, &views, seed, progress)
        .map_err(stage_error!(&scene.sources, stage, weald_terrain))?;

    make_folder(folder)?;
    weald_formats::write_terrain(folder, &layers, provenance)?;
    let mut made = Made {
        files: terrain_files(folder, &layers),
        report: terrain_report(&layers),
        ..Made::default()
    };
    made.preview(&folder.with_extension("png"), &preview::draw_relief(&layers), provenance)?;
    Ok(made)
}

/// The files of a terrain's folder.
fn terrain_files(folder: &Path, layers: &Layers) -> Vec<PathBuf> {
    let mut files: Vec<PathBuf> =
        layers.layers.keys().map(|name| folder.join(format!("{name}.tif"))).collect();
    for (index, patch) in layers.detail.iter().enumerate() {
        files.extend(terrain_files(&folder.join(format!("detail-{index}")), patch));
    }
    files
}

fn terrain_report(layers: &Layers) -> Json {
    let frame = layers.frame;
    let depth = layers.values("water_depth").unwrap_or(&[]);
    let wet = depth.iter().filter(|depth| **depth > 0.0).count();
    json!({
        "cells": frame.len(), "cell_m": frame.cell, "layers": layers.layers.len(),
        "detail_cells": layers.detail.iter().map(|patch| patch.frame.len()).sum::<usize>(),
        "water_m2": wet as f64 * frame.cell_area(),
    })
}
