//! From densities to plants: cells chosen by count and relaxation, or a grid of patches.

use crate::Error;
use crate::attribute::{Attributes, Newcomers};
use crate::config::{Arrange, Halftone, Method};
use crate::curve::{Part, systematic};
use crate::density::{Density, Patch, covering};
use crate::dither::dither;
use crate::relax::{Lloyd, Relaxation};
use crate::stand::{Kind, Spot, Stand, settle};
use crate::steps::Site;
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, TAU};
use weald_contract::{Frame, Grid, Plant, Problem, Span};

/// Attempts to find a place in a cell that the rim of what is painted, or a shore, crosses.
const ATTEMPTS: usize = 16;

/// Adds the plants that the step's density asks for.
pub(crate) fn run(
    halftone: &Halftone,
    site: &Site<'_>,
    stand: &mut Stand<'_>,
) -> Result<(), Error> {
    let species = stand.species_of(&halftone.species)?;
    let kind = stand.kind(species);
    let density = Density::new(halftone, kind, site, stand)?;
    let sites = match halftone.arrange {
        Arrange::Scatter => scatter(halftone, &density, site, stand)?,
        Arrange::Grid => grid(halftone, &density, &kind, site, stand)?,
    };
    let plants = grown(halftone, &sites, species, &kind, site, stand)?;
    stand.add(plants);
    Ok(())
}

/// Makes plants of ids and places.
fn grown(
    halftone: &Halftone,
    sites: &[(u64, [f64; 2])],
    species: u16,
    kind: &Kind<'_>,
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Vec<Plant>, Error> {
    let attributes = Attributes {
        age: &halftone.age,
        age_noise: halftone.age_noise,
        vigor: &halftone.vigor,
        vigor_noise: halftone.vigor_noise,
    };
    let (ground, seed, kind) = (&site.ground, site.seed, *kind);
    let drawn = attributes.draw(&Newcomers { ground, stand, kind, seed, sites })?;
    let plant = |(&(id, [x, y]), (age, vigor)): (&(u64, [f64; 2]), (f32, f32))| {
        let mut stream = site.seed.stream("yaw", id);
        let yaw = match halftone.arrange {
            Arrange::Scatter => stream.unit() as f32 * TAU,
            // Square patches tile only when turned by quarters.
            Arrange::Grid => stream.below(4) as f32 * FRAC_PI_2,
        };
        settle(ground, &kind, species, Spot { id, x, y, age, vigor, yaw })
    };
    Ok(sites.par_iter().zip(drawn).map(plant).collect())
}

/// Chooses cells by the density, moves each plant at random within its cell, and relaxes.
fn scatter(
    halftone: &Halftone,
    density: &Density<'_>,
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Vec<(u64, [f64; 2])>, Error> {
    let what = format!("the halftone of `{}`", halftone.species.value);
    site.progress.begin(&what, 2 + u64::from(halftone.relax), "passes");
    let cell = halftone.cell.as_ref().map(|cell| cell.value);
    let look = density.look()?;
    // The look is rough; what is far too much is refused before finer work.
    if look.count > 2.0 * stand.room() as f64 {
        stand.check_room(look.count as u64, &what)?;
    }
    let Some(raster) = density.fitted(&look, cell, &what)? else { return Ok(Vec::new()) };
    site.progress.advance(1);
    let terrain = site.ground.frame();
    let expected = expected_plants(&raster, terrain);
    if let Some(cell) = &halftone.cell {
        check_one_a_cell(&raster, &expected, terrain, cell.span)?;
    }
    let total: f64 = expected.par_chunks(4096).map(sum).collect::<Vec<_>>().iter().sum();
    stand.check_room(total.round() as u64, &what)?;
    let whole = covering(terrain, raster.frame.cell);
    let cells = match halftone.method {
        Method::FloydSteinberg => dither(raster.frame.width, expected),
        Method::Hilbert => systematic(part_of(&whole, &raster.frame), &expected),
    };
    site.progress.advance(1);
    let home = |&cell: &usize| home_in(cell, &raster.frame, density, site);
    let homes: Vec<[f64; 2]> = cells.par_iter().map(home).collect();
    let mut places = homes.clone();
    if halftone.relax > 0 {
        let (lloyd, movable) = (Lloyd::new(&raster, None), places.len());
        for pass in 0..halftone.relax {
            site.check_cancelled()?;
            lloyd.pass(&mut places, movable, &Relaxation::pass(pass, halftone.relax));
            site.progress.advance(1);
        }
    }
    let placed = |(index, [x, y]): (usize, [f64; 2])| {
        let id = site.ids.id(number_in(&whole, &raster.frame, cells[index]));
        // The raster knows cells only; a plant that left what bears it goes back home.
        (id, if density.is_welcome(x, y) { [x, y] } else { homes[index] })
    };
    Ok(places.into_par_iter().enumerate().map(placed).collect())
}

fn sum(values: &[f32]) -> f64 {
    values.iter().map(|value| f64::from(*value)).sum()
}

/// Returns the expected number of plants in the part of each cell that lies on the terrain.
fn expected_plants(raster: &Grid, terrain: &Frame) -> Vec<f32> {
    let frame = raster.frame;
    let expected = |(index, density): (usize, &f32)| {
        let patch = Patch::of(&frame, terrain, index % frame.width, index / frame.width);
        (f64::from(*density) * patch.area()) as f32
    };
    raster.values.par_iter().enumerate().map(expected).collect()
}

fn check_one_a_cell(
    raster: &Grid,
    expected: &[f32],
    terrain: &Frame,
    span: Span,
) -> Result<(), Error> {
    let Some(index) = expected.iter().position(|expected| *expected > 1.0) else { return Ok(()) };
    let frame = raster.frame;
    let (x, y) = frame.center(index % frame.width, index / frame.width);
    let (density, cell) = (raster.values[index], frame.cell);
    let message = format!(
        "{density} plants per m² at {:.1}, {:.1} are more than one in a cell of {cell} m",
        x - terrain.west,
        y - terrain.south
    );
    let fitting = 1.0 / f64::from(density).sqrt();
    let hint = format!("leave `cell` out, or make it at most {fitting:.3}");
    Err(Problem::at(span, message).hint(hint).into())
}

/// Returns a random place in the part of a cell that lies on the terrain, where the plant is
/// welcome; the centre if none is found, which is where the ground was found to bear it.
fn home_in(cell: usize, frame: &Frame, density: &Density<'_>, site: &Site<'_>) -> [f64; 2] {
    let (column, row) = (cell % frame.width, cell / frame.width);
    let patch = Patch::of(frame, site.ground.frame(), column, row);
    let mut stream = site.seed.stream("jitter", cell as u64);
    let mut draw =
        || [stream.range(patch.west, patch.east), stream.range(patch.south, patch.north)];
    let places = std::iter::repeat_with(&mut draw).take(ATTEMPTS);
    let welcome = places.into_iter().find(|&[x, y]| density.is_welcome(x, y));
    welcome.unwrap_or(patch.center())
}

/// Returns a cell's number in the frame that covers the terrain: the same whatever part of it
/// plants are wanted in, so that ids do not change when that part does.
fn number_in(whole: &Frame, part: &Frame, cell: usize) -> u64 {
    let [left, top] = part_of(whole, part).offset;
    let (column, row) = (cell % part.width, cell / part.width);
    (top + row) as u64 * whole.width as u64 + (left + column) as u64
}

/// Returns where the frame of a part lies in the whole, in cells.
fn part_of(whole: &Frame, part: &Frame) -> Part {
    let left = ((part.west - whole.west) / part.cell).round() as usize;
    let top = ((whole.north() - part.north()) / part.cell).round() as usize;
    Part { width: part.width, offset: [left, top], whole: [whole.width, whole.height] }
}

/// Takes the cells of a square grid at random, each with its density as probability.
fn grid(
    halftone: &Halftone,
    density: &Density<'_>,
    kind: &Kind<'_>,
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Vec<(u64, [f64; 2])>, Error> {
    let what = format!("the grid of `{}`", halftone.species.value);
    site.progress.begin(&what, 1, "steps");
    let side = halftone.cell.as_ref().map(|cell| cell.value);
    let side = side.or(kind.group.map(|group| f64::from(group.side))).unwrap_or(1.0);
    let terrain = site.ground.frame();
    let frame = whole_cells(terrain, side);
    let cells = frame.width as u64 * frame.height as u64;
    stand.check_room(cells, &what)?;
    let raster = density.raster(frame)?;
    let taken = |(index, &probability): (usize, &f32)| {
        let (x, y) = frame.center(index % frame.width, index / frame.width);
        let is_drawn = || site.seed.stream("taken", index as u64).unit() < f64::from(probability);
        let is_taken = probability > 0.0 && is_drawn() && are_corners_dry(site, kind, x, y, side);
        is_taken.then(|| (site.ids.id(index as u64), [x, y]))
    };
    let taken = raster.values.par_iter().enumerate().filter_map(taken).collect();
    site.progress.advance(1);
    Ok(taken)
}

/// Returns the grid of cells that lie wholly on the terrain.
fn whole_cells(terrain: &Frame, side: f64) -> Frame {
    let cells = |length: f64| (length / side + 1e-6).floor() as usize;
    let (width, height) =
        (cells(terrain.width as f64 * terrain.cell), cells(terrain.height as f64 * terrain.cell));
    Frame { width, height, cell: side, ..*terrain }
}

/// Returns whether the corners of a patch are as dry, or as deep, as its plants need.
fn are_corners_dry(site: &Site<'_>, kind: &Kind<'_>, x: f64, y: f64, side: f64) -> bool {
    let half = 0.5 * side;
    [(-half, -half), (half, -half), (-half, half), (half, half)]
        .iter()
        .all(|(dx, dy)| site.ground.is_depth_right(kind.ecology, x + dx, y + dy))
}
