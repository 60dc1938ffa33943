//! Terrain: the whole stack, and filling and drainage alone.

use super::{Figure, Size, best, given, table, wrong};
use crate::error::Result;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Raster, Seed, Silent};

pub(super) fn terrain(size: &Size, input: Option<&Path>) -> Result<Vec<Figure>> {
    use weald_terrain::disperse::{self, Dispersion, MULTIPLE_EXPONENT};
    use weald_terrain::{fill, flow, sun};
    let raster = match input {
        Some(path) => given::raster(path)?,
        None => Raster { grid: ground(size.terrain_side), crs: Crs::default() },
    };
    let Frame { width, height, .. } = raster.grid.frame;
    let cells = (width * height) as f64;
    let rate = |name, time| {
        Figure::rate(name, cells, "cells/s", time, format!("{width} x {height} cells"))
    };
    let config = "source = \"x\"\n[[op]]\nop = \"noise\"\namplitude = 0.5\nwavelength = 30.0\n";
    let config: weald_terrain::Config = table(config)?;
    let (whole, _) = best(size, || {
        weald_terrain::build(&config, &raster, &BTreeMap::new(), &[], Seed(1), &Silent)
            .map_err(wrong)
    })?;
    let altitude = &raster.grid.values;
    let (levels, _) = best(size, || Ok(fill::levels(width, height, altitude)))?;
    let (filled, flood) = best(size, || Ok(flow::fill(width, height, altitude)))?;
    let raised = flood.level.iter().zip(altitude).map(|(a, b)| f64::from(*a) - f64::from(*b)).sum();
    let (down, drained) = best(size, || {
        let directions = flow::directions(width, height, &flood);
        Ok(flow::drained_cells(width, &directions))
    })?;
    let largest = f64::from(drained.iter().copied().max().unwrap_or(0));
    let spread = |dispersion| {
        let ones = || vec![1.0; width * height];
        best(size, || Ok(disperse::accumulate(width, height, &flood, dispersion, ones())))
    };
    let (infinite, _) = spread(Dispersion::Infinite)?;
    let (multiple, _) = spread(Dispersion::Multiple { exponent: MULTIPLE_EXPONENT })?;
    let relief = sun::Relief { width, height, cell: raster.grid.frame.cell, altitude };
    let days = (0..12).map(|month| 15.0 + 30.4 * f64::from(month)).collect();
    let season = sun::Season { latitude: 0.8, days, transmissivity: 0.7, steps: 24 };
    let (year, _) = best(size, || Ok(sun::light(&relief, Some(&season))))?;
    Ok(vec![
        rate("terrain", whole),
        rate("fill, levels alone", levels),
        rate("fill", filled).with(raised),
        rate("D8 and accumulation", down).with(largest),
        rate("D-infinity", infinite),
        rate("multiple flow", multiple),
        rate("sun and sky of 12 days", year),
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
