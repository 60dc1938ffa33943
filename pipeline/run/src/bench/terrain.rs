//! Terrain: filling, drainage and light alone, the whole stack, and one edit.

use super::{Figure, Size, best, best_of, given, peak_memory, table, wrong};
use crate::error::Result;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Image, Raster, Seed, Silent};
use weald_terrain::disperse::{self, Dispersion, MULTIPLE_EXPONENT};
use weald_terrain::sun::Relief;
use weald_terrain::{Config, Editor, area, derive, fill, flow, suction, sun};

/// Cells up to which light and the whole stack are measured: they need more memory, and minutes,
/// and grow as the area does.
const MOST_CELLS_IN_ALL: usize = 1 << 25;

pub(super) fn terrain(size: &Size, input: Option<&Path>) -> Result<Vec<Figure>> {
    let given = || match input {
        Some(path) => given::raster(path),
        None => Ok(Raster { grid: ground(size.terrain_side), crs: Crs::default() }),
    };
    // The chain first, so that the most memory so far is its own.
    let mut figures = vec![chain(size, || Ok(given()?.grid))?];
    let raster = given()?;
    figures.extend(drainage(size, &raster.grid)?);
    if raster.grid.frame.len() <= MOST_CELLS_IN_ALL {
        figures.extend(light(size, &raster.grid)?);
        figures.extend(stack(size, &raster)?);
    }
    Ok(figures)
}

fn rate(name: &'static str, frame: &Frame, time: super::Time) -> Figure {
    let Frame { width, height, .. } = *frame;
    Figure::rate(name, frame.len() as f64, "cells/s", time, cells(width, height))
}

fn cells(width: usize, height: usize) -> String {
    format!("{width} x {height} cells")
}

/// From altitude to the wetness index: filling, D8 areas, D-infinity areas, and what it makes of
/// them, each given up when the next no longer needs it.
fn chain(size: &Size, given: impl FnMut() -> Result<Grid>) -> Result<Figure> {
    let (time, (frame, _, mean)) = best_of(size, given, |Grid { frame, values }| {
        let Frame { width, height, cell, .. } = frame;
        let mut flood = flow::fill(width, height, &values);
        drop(values);
        let directions = flow::directions(width, height, &flood);
        let largest = area::drained_cells(width, &directions).into_iter().max();
        drop(directions);
        let ones = vec![1.0; width * height];
        let areas = disperse::accumulate(width, height, &flood, Dispersion::Infinite, ones);
        flood = flow::Flood { toward: Vec::new(), ..flood };
        let wetness =
            derive::from_gradient(width, height, cell, &flood.level, |index, gradient| {
                derive::wetness(areas[index] * cell * cell, cell, gradient.tangent())
            });
        let sum: f64 = wetness.iter().map(|wetness| f64::from(*wetness)).sum();
        Ok((frame, largest, sum / wetness.len() as f64))
    })?;
    let memory = peak_memory().map_or_else(String::new, |bytes| {
        let per_cell = bytes as f64 / frame.len() as f64;
        format!(", at most {per_cell:.1} B a cell in all")
    });
    let figure = rate("fill, D8, D-inf, wetness", &frame, time).with(mean);
    Ok(Figure { input: figure.input.clone() + &memory, ..figure })
}

fn drainage(size: &Size, grid: &Grid) -> Result<Vec<Figure>> {
    let Frame { width, height, cell, .. } = grid.frame;
    let altitude = &grid.values;
    let (levels, _) = best(size, || Ok(fill::levels(width, height, altitude)))?;
    let (filled, flood) = best(size, || Ok(flow::fill(width, height, altitude)))?;
    let raised = flood.level.iter().zip(altitude).map(|(a, b)| f64::from(*a) - f64::from(*b)).sum();
    let (down, largest) = best(size, || {
        let directions = flow::directions(width, height, &flood);
        Ok(area::drained_cells(width, &directions).into_iter().max().unwrap_or(0))
    })?;
    let spread = |dispersion| {
        let ones = || vec![1.0; width * height];
        best(size, || Ok(disperse::accumulate(width, height, &flood, dispersion, ones())))
    };
    let (infinite, _) = spread(Dispersion::Infinite)?;
    let (multiple, areas) = spread(Dispersion::Multiple { exponent: MULTIPLE_EXPONENT })?;
    let relief = Relief { width, height, cell, altitude };
    let areas: Vec<f32> = areas.iter().map(|cells| (cells * cell) as f32).collect();
    let (drawn, _) = best(size, || Ok(suction::wetness(&relief, areas.clone(), 10.0)))?;
    Ok(vec![
        rate("fill, levels alone", &grid.frame, levels),
        rate("fill", &grid.frame, filled).with(raised),
        rate("D8 and accumulation", &grid.frame, down).with(f64::from(largest)),
        rate("D-infinity", &grid.frame, infinite),
        rate("multiple flow", &grid.frame, multiple),
        rate("wetness by suction", &grid.frame, drawn),
    ])
}

fn light(size: &Size, grid: &Grid) -> Result<Vec<Figure>> {
    let Frame { width, height, cell, .. } = grid.frame;
    let relief = Relief { width, height, cell, altitude: &grid.values };
    let days = (0..12).map(|month| 15.0 + 30.4 * f64::from(month)).collect();
    let season = sun::Season { latitude: 0.8, days, transmissivity: 0.7, steps: 24 };
    let (year, _) = best(size, || Ok(sun::light(&relief, Some(&season))))?;
    Ok(vec![rate("sun and sky of 12 days", &grid.frame, year)])
}

/// All layers of a short list of operators, and how long an editor takes to show one more hill.
fn stack(size: &Size, raster: &Raster) -> Result<Vec<Figure>> {
    let noise = "source = \"x\"\n[[op]]\nop = \"noise\"\namplitude = 0.5\nwavelength = 30.0\n";
    let plain: Config = table(noise)?;
    let images: BTreeMap<String, Image> = BTreeMap::new();
    let (whole, _) = best(size, || {
        weald_terrain::build(&plain, raster, &images, &[], Seed(1), &Silent).map_err(wrong)
    })?;
    let edited = |height: u32| {
        let hill =
            format!("[[op]]\nop = \"hill\"\nat = [90, 90]\nradius = 40\nheight = {height}\n");
        table::<Config>(&(noise.to_string() + &hill))
    };
    let kept = 1 << 30;
    let mut editor =
        Editor::new(plain, raster.clone(), images, vec![], Seed(1), kept).map_err(wrong)?;
    editor.altitude(&Silent).map_err(wrong)?;
    let mut height = 0;
    let (edit, _) = best(size, || {
        height += 1;
        editor.apply(edited(height)?).map_err(wrong)?;
        editor.altitude(&Silent).map_err(wrong)
    })?;
    let Frame { width, height, .. } = raster.grid.frame;
    Ok(vec![
        rate("terrain", &raster.grid.frame, whole),
        Figure::time("one more hill", edit, cells(width, height)),
    ])
}

/// Rolling ground with hollows, 1 m cells.
fn ground(side: usize) -> Grid {
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let wave = |x: f64, length: f64| libm::sin(std::f64::consts::TAU * x / length);
    Grid::from_fn(frame, |x, y| {
        let hills = 6.0 * wave(x, 173.0) * wave(y, 211.0) + 1.5 * wave(x + 0.7 * y, 41.0);
        (100.0 + 0.004 * x + hills) as f32
    })
}
