//! Terrain: elevation model and masks to a folder of layers.

use super::{Made, at_field, images, make_folder, stage_error, stage_seed};
use crate::check::refuse_too_large_terrain;
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
    let layers = layers(scene, progress)?;
    make_folder(folder)?;
    weald_formats::write_terrain(folder, &layers, provenance)?;
    made(folder, &layers, &layers, provenance)
}

/// Just those layers that `[terrain] layers` names: a folder of them is no terrain.
///
/// # Errors
/// See [`terrain`].
pub fn named_layers(
    scene: &Scene,
    folder: &Path,
    provenance: &Provenance,
    progress: &dyn Progress,
) -> Result<Made> {
    let whole = layers(scene, progress)?;
    let mut named = Layers { detail: Vec::new(), ..whole.clone() };
    let names = scene.terrain.named_layers();
    named.layers.retain(|name, _| names.contains(name.as_str()));
    make_folder(folder)?;
    weald_formats::write_layers(folder, &named, provenance)?;
    made(folder, &named, &whole, provenance)
}

/// The files that were written, with a report and a picture of the whole terrain.
fn made(folder: &Path, written: &Layers, whole: &Layers, provenance: &Provenance) -> Result<Made> {
    let mut made = Made {
        files: terrain_files(folder, written),
        report: terrain_report(whole),
        ..Made::default()
    };
    made.preview(&folder.with_extension("png"), &preview::draw_relief(whole), provenance)?;
    Ok(made)
}

/// The layers of a scene's terrain.
fn layers(scene: &Scene, progress: &dyn Progress) -> Result<Layers> {
    let stage = Stage::Terrain;
    let source = scene.terrain_inputs.iter().find(|input| input.input.kind == InputKind::Elevation);
    let Some(source) = source else {
        return Err(Error::plain("the scene names no elevation model", "set `terrain.source`"));
    };
    let elevation = scene.read_elevation(&source.path).map_err(at_field(scene, &source.input))?;
    refuse_too_large_terrain(scene, &elevation.grid.frame)?;
    let images = images(scene, &scene.terrain_inputs)?;
    let views = places_named(scene, &scene.terrain);
    let seed = stage_seed(scene, stage);
    weald_terrain::build(&scene.terrain, &elevation, &images, &views, seed, progress)
        .map_err(stage_error!(&scene.sources, stage, weald_terrain))
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
