//! From densities to plants: cells chosen by count and relaxation, or a grid of patches.

use crate::Error;
use crate::attribute::{Attributes, Looks, Newcomers};
use crate::config::{Amount, Arrange, Halftone, Method};
use crate::curve::{Part, systematic};
use crate::density::{Density, Patch, covering};
use crate::distance::{inside, rise};
use crate::dither::dither;
use crate::field::BoundFormula;
use crate::power::Shares;
use crate::relax::{Lloyd, Relaxation};
use crate::spacing::Keeper;
use crate::stand::{Kind, Spot, Stand, settle, stand_on};
use crate::steps::Site;
use crate::{Unplaced, visible};
use rayon::prelude::*;
use std::f32::consts::{FRAC_PI_2, TAU};
use weald_contract::{Frame, Grid, Plant, Problem, Span, Stream};

/// Attempts to find a place in a cell that the rim of what is painted, or a shore, crosses.
const ATTEMPTS: usize = 16;
/// Least crown at an edge that crowns may not cross, as a part of what it would be: a seedling.
const LEAST_CROWN: f32 = 0.1;

/// Adds the plants that the step's density asks for.
pub(crate) fn run<'a>(
    halftone: &'a Halftone,
    site: &Site<'a>,
    stand: &mut Stand<'a>,
) -> Result<(), Error> {
    let species = stand.species_of(&halftone.species)?;
    let around = halftone.around.iter().map(|name| stand.species_of(name));
    let around: Vec<u16> = around.collect::<Result<_, _>>()?;
    let kind = stand.kind(species);
    let density = Density::new(halftone, kind, site, stand)?;
    let mut plants = match halftone.arrange {
        Arrange::Grid => {
            let sites = grid(halftone, &density, &kind, site, stand)?;
            grown(halftone, &sites, species, &kind, site, stand)?
        }
        Arrange::Scatter => {
            let scattered = scatter(halftone, &around, &density, site, stand)?;
            let mut plants = grown(halftone, &scattered.sites, species, &kind, site, stand)?;
            scattered.tend_rim(halftone, &kind, &mut plants);
            keep_apart(plants, &scattered, species, &density, site, stand)
        }
    };
    let sites: Vec<(u64, [f64; 2])> =
        plants.iter().map(|plant| (plant.id, [plant.x, plant.y])).collect();
    let newcomers = Newcomers { ground: &site.ground, stand, kind, seed: site.seed, sites: &sites };
    halftone.looks().orient(&mut plants, &newcomers)?;
    let tallest = plants.iter().map(|plant| plant.height).fold(0.0, f32::max);
    if let Some(seen) = visible::seen(halftone, f64::from(tallest), site)? {
        plants.retain(|plant| seen.nearest(plant.x, plant.y).is_some_and(|seen| seen > 0.0));
    }
    let columns = amounts(halftone, &plants, site, stand)?;
    stand.add_with(plants, columns);
    Ok(())
}

/// The step's further columns.
fn amounts(
    halftone: &Halftone,
    plants: &[Plant],
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Vec<(String, Vec<f32>)>, Error> {
    let column = |amount: &Amount| {
        let bound = BoundFormula::bind(&amount.formula, site.ground.terrain, stand)?;
        let mut values = bound.numbers(plants.len(), |index| [plants[index].x, plants[index].y])?;
        values.iter_mut().for_each(|value| *value = value.max(0.0));
        Ok((amount.name.value.clone(), values))
    };
    halftone.amount.iter().map(column).collect()
}

impl Halftone {
    fn looks(&self) -> Looks<'_> {
        Looks {
            height: &self.height,
            yaw_deg: &self.yaw_deg,
            upright: &self.upright,
            is_age_given: self.age.is_some(),
        }
    }
}

/// Places of plants, and the ground they were made for.
struct Scattered {
    sites: Vec<(u64, [f64; 2])>,
    /// Plants per m²; no cells where nothing is wanted.
    raster: Grid,
    /// Distance from the edge of what is wanted, m, where the step asks for it.
    inside: Option<Grid>,
}

impl Scattered {
    /// Makes plants near the edge younger, as the step's rim says.
    fn tend_rim(&self, halftone: &Halftone, kind: &Kind<'_>, plants: &mut [Plant]) {
        let (Some(rim), Some(inside)) = (&halftone.rim, &self.inside) else { return };
        plants.par_iter_mut().for_each(|plant| {
            let away = inside.sample(plant.x, plant.y);
            let ripe = rise(f64::from(away), 0.0, rim.falloff) as f32;
            let part = rim.least + (1.0 - rim.least) * ripe;
            if part < 1.0 {
                plant.age *= part;
                plant.height = kind.size.height_at(plant.age, plant.vigor);
                plant.radius = kind.size.radius_of_height(plant.height);
            }
            if rim.crowns_inside && plant.radius > away {
                plant.radius = away.max(LEAST_CROWN * plant.radius);
                plant.height = kind.size.height_of_radius(plant.radius);
                plant.age = plant.age.min(kind.size.age_of_height(plant.height, plant.vigor));
            }
        });
    }

    /// Returns where a drawn number between 0 and the sum of expected plants lies.
    fn cell_at(&self, sums: &[f64], part: f64) -> usize {
        let wanted = part * sums.last().copied().unwrap_or(0.0);
        sums.partition_point(|sum| *sum <= wanted).min(sums.len().saturating_sub(1))
    }
}

/// Moves plants that stand nearer to others than the scene's `spacing` allows.
fn keep_apart(
    plants: Vec<Plant>,
    scattered: &Scattered,
    species: u16,
    density: &Density<'_>,
    site: &Site<'_>,
    stand: &mut Stand<'_>,
) -> Vec<Plant> {
    let widest = plants.iter().map(|plant| plant.radius).fold(0.0, f32::max);
    let keeper = Keeper::new(stand.spacing, species, widest, stand);
    let (Some(mut keeper), false) = (keeper, plants.is_empty()) else { return plants };
    let wanted = plants.len() as u64;
    let (raster, terrain) = (&scattered.raster, site.ground.frame());
    let mut sum = 0.0;
    let running = |value: &f32| {
        sum += f64::from(*value);
        sum
    };
    let sums: Vec<f64> = raster.values.iter().map(running).collect();
    let is_welcome = |[x, y]: [f64; 2]| {
        raster.nearest(x, y).is_some_and(|value| value > 0.0) && density.is_welcome(x, y)
    };
    let draw = |stream: &mut Stream| {
        let cell = scattered.cell_at(&sums, stream.unit());
        let (column, row) = (cell % raster.frame.width, cell / raster.frame.width);
        let patch = Patch::of(&raster.frame, terrain, column, row);
        [stream.range(patch.west, patch.east), stream.range(patch.south, patch.north)]
    };
    let (mut settled, unplaced) = keeper.settle(plants, site.seed, is_welcome, draw);
    let kind = stand.kind(species);
    settled.par_iter_mut().for_each(|plant| stand_on(&site.ground, &kind, plant));
    if unplaced > 0 {
        stand.unplaced.push(Unplaced { species, wanted, unplaced });
    }
    settled
}

/// Takes from a density what lies within the inset of its edge, and gives it to the rest.
fn inset(raster: &mut Grid, inside: &Grid, by: f64) {
    let total = |grid: &Grid| {
        let rows = grid.values.par_chunks(4096).map(sum);
        rows.collect::<Vec<f64>>().iter().sum::<f64>()
    };
    let before = total(raster);
    raster.values.par_iter_mut().zip(&inside.values).for_each(|(value, away)| {
        if f64::from(*away) < by {
            *value = 0.0;
        }
    });
    let after = total(raster);
    if after > 0.0 {
        let scale = (before / after) as f32;
        raster.values.par_iter_mut().for_each(|value| *value *= scale);
    }
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
    let newcomers = Newcomers { ground, stand, kind, seed, sites };
    let drawn = attributes.draw(&newcomers)?;
    let plant = |(&(id, [x, y]), (age, vigor)): (&(u64, [f64; 2]), (f32, f32))| {
        let mut stream = site.seed.stream("yaw", id);
        let yaw = match halftone.arrange {
            Arrange::Scatter => stream.unit() as f32 * TAU,
            // Square patches tile only when turned by quarters.
            Arrange::Grid => stream.below(4) as f32 * FRAC_PI_2,
        };
        settle(ground, &kind, species, Spot { id, x, y, age, vigor, yaw })
    };
    let mut plants: Vec<Plant> = sites.par_iter().zip(drawn).map(plant).collect();
    halftone.looks().size(&mut plants, &newcomers)?;
    Ok(plants)
}

/// Chooses cells by the density, moves each plant at random within its cell, and relaxes.
fn scatter(
    halftone: &Halftone,
    around: &[u16],
    density: &Density<'_>,
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Scattered, Error> {
    let what = format!("the halftone of `{}`", halftone.species.value);
    let passes = u64::from(halftone.relax) + u64::from(halftone.polish);
    site.progress.begin(&what, 2 + passes, "passes");
    let cell = halftone.cell.as_ref().map(|cell| cell.value);
    let look = density.look()?;
    // The look is rough; what is far too much is refused before finer work.
    if look.count > 2.0 * stand.room() as f64 {
        stand.check_room(look.count as u64, &what)?;
    }
    let terrain = site.ground.frame();
    let Some(mut raster) = density.fitted(&look, cell, &what)? else {
        let raster = Grid { frame: Frame { width: 0, height: 0, ..*terrain }, values: Vec::new() };
        return Ok(Scattered { sites: Vec::new(), raster, inside: None });
    };
    let edge = halftone.rim.as_ref().map(|rim| (rim, inside(&raster)));
    if let Some((rim, inside)) = &edge {
        inset(&mut raster, inside, rim.inset);
    }
    site.progress.advance(1);
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
    let (plants, lies_near) = (&stand.population.plants, raster.frame);
    let stays = plants.iter().filter(|plant| around.contains(&plant.species));
    let fixed = stays.map(|plant| [plant.x, plant.y]);
    places.extend(fixed.filter(|[x, y]| lies_near.contains(*x, *y)));
    spread(halftone, &raster, &mut places, homes.len(), site)?;
    places.truncate(homes.len());
    let placed = |(index, [x, y]): (usize, [f64; 2])| {
        let id = site.ids.id(number_in(&whole, &raster.frame, cells[index]));
        // The raster knows cells only; a plant that left what bears it goes back home.
        (id, if density.is_welcome(x, y) { [x, y] } else { homes[index] })
    };
    let sites = places.into_par_iter().enumerate().map(placed).collect();
    Ok(Scattered { sites, raster, inside: edge.map(|(_, inside)| inside) })
}

/// Evens out the first `movable` places: relaxation, then polish.
fn spread(
    halftone: &Halftone,
    raster: &Grid,
    places: &mut [[f64; 2]],
    movable: usize,
    site: &Site<'_>,
) -> Result<(), Error> {
    if halftone.relax > 0 {
        let lloyd = Lloyd::new(raster, None, halftone.weight);
        for pass in 0..halftone.relax {
            site.check_cancelled()?;
            let step = Relaxation::weighted(halftone.weight, pass, halftone.relax).step;
            lloyd.pass(places, movable, step);
            site.progress.advance(1);
        }
    }
    if halftone.polish > 0 {
        let mut shares = Shares::new(raster, None, places.len());
        for _ in 0..halftone.polish {
            site.check_cancelled()?;
            shares.pass(places, movable);
            site.progress.advance(1);
        }
    }
    Ok(())
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
