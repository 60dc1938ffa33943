//! Plants per m² on a raster, from an image, a number, a formula, plots and neighbours.

use crate::Error;
use crate::clump::Clumps;
use crate::config::{Effect, Halftone};
use crate::distance::add_nearness;
use crate::field::{BoundFormula, ImageField};
use crate::ground::Ground;
use crate::plots;
use crate::shadow::shadow_frame;
use crate::stand::{Kind, Stand};
use crate::steps::{Site, image_of};
use rayon::prelude::*;
use weald_contract::{Frame, Grid, Problem};

/// Most cells of the first look at a density, which finds where and how dense it is.
const LOOK_CELLS: f64 = 1e6;
/// Expected plants in a cell where the density is greatest. At 1 or 1/2 dithering would give a
/// lattice, which relaxation cannot undo; smaller cells cost time.
const FILLING: f64 = 0.3;
/// Cells along the longer side of the terrain, at least, so that sparse densities keep shape.
const LEAST_CELLS_ACROSS: f64 = 256.0;
/// Most cells of a raster: 256 MB of them.
const MOST_CELLS: f64 = 6.4e7;

/// Where a density comes from: the product of an image, a number and a formula, and 0 where
/// the species cannot stand.
pub(crate) struct Density<'a> {
    image: Option<ImageField<'a>>,
    per_m2: f64,
    formula: Option<BoundFormula<'a>>,
    plots: Option<Grid>,
    /// What neighbours leave of the density, on the raster of crowns.
    left: Option<Grid>,
    clumps: Option<Clumps>,
    ground: Ground<'a>,
    kind: Kind<'a>,
}

/// What a first look at a density found.
pub(crate) struct Look {
    grid: Grid,
    /// Greatest density, plants per m².
    greatest: f32,
    /// Plants in all, about.
    pub(crate) count: f64,
}

/// A rectangle in map coordinates: the part of a cell that lies on the terrain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Patch {
    pub(crate) west: f64,
    pub(crate) east: f64,
    pub(crate) south: f64,
    pub(crate) north: f64,
}

impl Patch {
    /// Returns the part of a cell that lies on the terrain.
    pub(crate) fn of(cells: &Frame, terrain: &Frame, column: usize, row: usize) -> Self {
        let (x, y) = cells.center(column, row);
        let half = 0.5 * cells.cell;
        Self {
            west: (x - half).max(terrain.west),
            east: (x + half).min(terrain.east()),
            south: (y - half).max(terrain.south),
            north: (y + half).min(terrain.north()),
        }
    }

    pub(crate) fn center(&self) -> [f64; 2] {
        [0.5 * (self.west + self.east), 0.5 * (self.south + self.north)]
    }

    /// Returns the area, m².
    pub(crate) fn area(&self) -> f64 {
        (self.east - self.west).max(0.0) * (self.north - self.south).max(0.0)
    }
}

impl<'a> Density<'a> {
    /// Finds the image, binds the formula and checks that they fit the terrain.
    pub(crate) fn new(
        halftone: &'a Halftone,
        kind: Kind<'a>,
        site: &Site<'a>,
        stand: &mut Stand<'a>,
    ) -> Result<Self, Error> {
        let image = match &halftone.density {
            None => None,
            Some(path) => {
                let image = image_of(path, &site.around)?;
                let is_scaled = image.is_float
                    || halftone.per_m2.is_some()
                    || halftone.formula.is_some()
                    || halftone.plots.is_some()
                    || halftone.arrange == crate::Arrange::Grid;
                if !is_scaled {
                    return Err(Problem::at(path.span, "this image says where, but not how dense")
                        .hint("give `per_m2`, the plants per m² where it is full")
                        .into());
                }
                Some(ImageField::new(path, image, halftone.invert, site.ground.frame())?)
            }
        };
        let species = stand.species_of(&halftone.species)?;
        let plots = match &halftone.plots {
            None => None,
            Some(path) => {
                let table = plots::table_of(path, site)?;
                Some(plots::density(path, table, species, stand, site.around.terrain)?)
            }
        };
        let stand = &*stand;
        let clump = |clump| Clumps::new(clump, site.shared_seed, site.ground.frame());
        let bind = |formula| BoundFormula::bind(formula, site.around.terrain, stand);
        Ok(Self {
            image,
            per_m2: halftone.per_m2.map_or(1.0, f64::from),
            formula: halftone.formula.as_ref().map(bind).transpose()?,
            plots,
            left: left_by_neighbours(halftone, site, stand),
            clumps: halftone.clump.as_ref().map(clump),
            ground: site.ground.clone(),
            kind,
        })
    }

    /// Returns the density in each cell of `frame`, plants per m²; 0 where the species cannot
    /// stand or nothing is wanted.
    pub(crate) fn raster(&self, frame: Frame) -> Result<Grid, Error> {
        if frame.is_empty() {
            return Ok(Grid { frame, values: Vec::new() });
        }
        let terrain = *self.ground.frame();
        let center =
            |i: usize| Patch::of(&frame, &terrain, i % frame.width, i / frame.width).center();
        let mut values = match &self.formula {
            Some(formula) => formula.numbers(frame.len(), center)?,
            None => vec![1.0; frame.len()],
        };
        values.par_chunks_mut(frame.width).enumerate().for_each(|(row, line)| {
            for (column, value) in line.iter_mut().enumerate() {
                let wanted = f64::from(value.max(0.0)) * self.per_m2;
                let patch = Patch::of(&frame, &terrain, column, row);
                let [x, y] = patch.center();
                let wanted = wanted * f64::from(self.painted(&patch)) * self.factor(x, y);
                let is_possible = wanted > 0.0 && self.ground.bears(self.kind.ecology, x, y);
                *value = if is_possible { wanted as f32 } else { 0.0 };
            }
        });
        Ok(Grid { frame, values })
    }

    /// Returns what plots, neighbours and clumps make of the density at a place.
    fn factor(&self, x: f64, y: f64) -> f64 {
        let sample = |grid: &Option<Grid>| grid.as_ref().map_or(1.0, |g| f64::from(g.sample(x, y)));
        let clumps = self.clumps.as_ref().map_or(1.0, |clumps| clumps.at(x, y));
        sample(&self.plots) * sample(&self.left) * clumps
    }

    fn painted(&self, patch: &Patch) -> f32 {
        self.image.map_or(1.0, |image| image.mean(patch))
    }

    /// Returns whether a plant may stand at a place: its species bears it, and something is
    /// painted there.
    pub(crate) fn is_welcome(&self, x: f64, y: f64) -> bool {
        self.image.is_none_or(|image| image.nearest(x, y) > 0.0)
            && self.ground.bears(self.kind.ecology, x, y)
    }

    /// Takes a first look at the whole terrain: where plants are wanted, and how dense.
    ///
    /// Every pixel of an image counts. Features of a formula narrower than a terrain cell that lie
    /// more than two cells from any other are not found.
    pub(crate) fn look(&self) -> Result<Look, Error> {
        let terrain = self.ground.frame();
        let (width, height) = (terrain.east() - terrain.west, terrain.north() - terrain.south);
        let cell = terrain.cell.max((width * height / LOOK_CELLS).sqrt());
        let grid = self.raster(covering(terrain, cell))?;
        let greatest = self.greatest(&grid);
        if let (Some(formula), false) = (&self.formula, greatest.is_finite()) {
            let problem = Problem::at(formula.span(), "this gives an infinite density somewhere");
            return Err(problem.hint("guard divisions with `max`").into());
        }
        let count = grid.values.iter().map(|value| f64::from(*value)).sum::<f64>() * cell * cell;
        Ok(Look { grid, greatest, count })
    }

    /// Returns the greatest density, plants per m².
    ///
    /// A cell of the first look averages the pixels in it; dots of an image smaller than that
    /// are denser than their cell, by up to the brightest pixel over the cell's mean.
    fn greatest(&self, look: &Grid) -> f32 {
        let frame = look.frame;
        let peak = self.image.map_or(1.0, |image| image.brightest());
        let at_most = |(index, &value): (usize, &f32)| {
            if value == 0.0 || self.image.is_none() {
                return value;
            }
            let patch =
                Patch::of(&frame, self.ground.frame(), index % frame.width, index / frame.width);
            value * (peak / self.painted(&patch)).max(1.0)
        };
        look.values.par_iter().enumerate().map(at_most).reduce(|| 0.0, f32::max)
    }

    /// Returns the raster whose cells hold at most one plant, cropped to where plants are
    /// wanted; `None` when they are wanted nowhere.
    ///
    /// `cell` overrules the side of the cells.
    pub(crate) fn fitted(
        &self,
        look: &Look,
        cell: Option<f64>,
        what: &str,
    ) -> Result<Option<Grid>, Error> {
        let terrain = self.ground.frame();
        let (width, height) = (terrain.east() - terrain.west, terrain.north() - terrain.south);
        let greatest = look.greatest;
        let Some(extent) = occupied(&look.grid) else { return Ok(None) };
        let side = width.max(height);
        let usual = (FILLING / f64::from(greatest)).sqrt().min(side / LEAST_CELLS_ACROSS);
        let cell = cell.unwrap_or(side / cells_along(side / usual));
        let frame = crop(terrain, &extent, cell);
        let cells = frame.width as f64 * frame.height as f64;
        if cells > MOST_CELLS {
            let message = format!(
                "{what}: up to {greatest} plants per m² need {cells:.0} cells of {cell:.3} m"
            );
            let hint = format!("at most {MOST_CELLS:.0} are used; lower the density");
            return Err(Problem::new(message).hint(hint).into());
        }
        self.raster(frame).map(Some)
    }
}

/// Returns what the neighbours that a step names leave of its density, 0 to 1.
fn left_by_neighbours(halftone: &Halftone, site: &Site<'_>, stand: &Stand<'_>) -> Option<Grid> {
    if halftone.neighbour.is_empty() {
        return None;
    }
    let frame = shadow_frame(site.ground.frame());
    let mut left = Grid::filled(frame, 1.0);
    let population = &stand.population;
    for neighbour in &halftone.neighbour {
        let mut near = Grid::filled(frame, 0.0);
        for plant in &population.plants {
            if population.species[usize::from(plant.species)] == neighbour.species.value {
                add_nearness(&mut near, plant, neighbour.within, neighbour.transition);
            }
        }
        let strength = neighbour.strength as f32;
        left.values.iter_mut().zip(near.values).for_each(|(left, near)| {
            let felt = match neighbour.effect {
                Effect::Repel => near,
                Effect::Attract => 1.0 - near,
            };
            *left *= 1.0 - strength * felt;
        });
    }
    Some(left)
}

/// Returns how many cells to lay along the terrain where at least `least` are needed.
///
/// A whole number keeps the rim cells whole. It is one of eight to each doubling, so that a
/// slightly denser image has the same cells, and plants elsewhere keep their places and ids.
fn cells_along(least: f64) -> f64 {
    let mut step = 1.0;
    while least > 16.0 * step {
        step *= 2.0;
    }
    (least / step).ceil() * step
}

/// Returns the frame of cells of a given side that covers the terrain from its south-west
/// corner.
pub(crate) fn covering(terrain: &Frame, cell: f64) -> Frame {
    // A cell that sticks out by a rounding error is not begun.
    let cells = |length: f64| ((length / cell - 1e-6).ceil() as usize).max(1);
    let width = cells(terrain.width as f64 * terrain.cell);
    let height = cells(terrain.height as f64 * terrain.cell);
    Frame { width, height, cell, ..*terrain }
}

/// Rows and columns, half open, counted from the north-west.
struct Extent {
    west: f64,
    east: f64,
    south: f64,
    north: f64,
}

/// Returns the rectangle of the cells that are not 0, with two cells about it.
fn occupied(grid: &Grid) -> Option<Extent> {
    let frame = grid.frame;
    let mut extent: Option<Extent> = None;
    for (index, _) in grid.values.iter().enumerate().filter(|(_, value)| **value > 0.0) {
        let (x, y) = frame.center(index % frame.width, index / frame.width);
        let e = extent.get_or_insert(Extent { west: x, east: x, south: y, north: y });
        (e.west, e.east) = (e.west.min(x), e.east.max(x));
        (e.south, e.north) = (e.south.min(y), e.north.max(y));
    }
    let margin = 2.5 * frame.cell;
    extent.map(|e| Extent {
        west: e.west - margin,
        east: e.east + margin,
        south: e.south - margin,
        north: e.north + margin,
    })
}

/// Returns the part inside `extent` of the frame of cells that covers the terrain.
fn crop(terrain: &Frame, extent: &Extent, cell: f64) -> Frame {
    let whole = covering(terrain, cell);
    let first = |from: f64| (from / cell).floor().max(0.0);
    let last = |to: f64, count: usize| ((to / cell).ceil()).min(count as f64);
    let (left, bottom) = (first(extent.west - whole.west), first(extent.south - whole.south));
    let right = last(extent.east - whole.west, whole.width);
    let top = last(extent.north - whole.south, whole.height);
    Frame {
        width: ((right - left) as usize).max(1),
        height: ((top - bottom) as usize).max(1),
        cell,
        west: whole.west + left * cell,
        south: whole.south + bottom * cell,
    }
}
