//! Lloyd's relaxation: each plant moves to the centre of mass of its Voronoi polygon.
//!
//! It evens out the distances between neighbours [Lloyd82], [Deussen98]. The mass is the square
//! of the wanted density: in the plane, cells weighted by a density ρ^2 come to hold plants of
//! density ρ, while weighting by ρ itself would drift towards its square root [Gersho79].
//!
//! A polygon is the square about its plant, three spacings to each side, cut by the bisectors
//! towards the plant's Delaunay neighbours. The square bounds the polygons beside empty ground,
//! and with them the ring of plants that a tile must know beyond its own. Tiles are the leaves
//! of a median split, so that dense and empty regions cost what their plants cost.

use crate::Error;
use crate::config::RelaxStep;
use crate::density::covering;
use crate::field::BoundFormula;
use crate::stand::{Stand, stand_on};
use crate::steps::Site;
use delaunator::{Point, next_halfedge, triangulate};
use rayon::prelude::*;
use std::f64::consts::SQRT_2;
use weald_contract::{Frame, Grid};

/// Plants in a tile, at most. Delaunay triangulation is fastest while a tile fits the second
/// level cache; smaller tiles spend more on their rings.
const TILE: usize = 8192;
/// Half the side of the square about a plant, in local spacings. In an even pattern a polygon
/// reaches 0.62 spacings; relaxing plants are at times twice as far apart.
const REACH: f64 = 2.0;
/// Farthest move in one iteration, in local spacings.
const LONGEST_MOVE: f64 = 0.5;
/// Over-relaxation of all passes but the last: a plant moves this many times the way to the
/// centre. 1.8 needs half as many passes as 1 for the same evenness (measured on constant and
/// painted densities) and loses no fidelity.
const OVER: f64 = 1.8;
/// Lines along which a polygon's mass is summed, at least.
const LEAST_LINES: f64 = 10.0;
/// Most cells of the raster of masses; finer densities are averaged down to it.
const MASS_CELLS: usize = 4_000_000;
/// Up to so many plants all are each other's neighbours, and no triangulation is needed.
const FEW: usize = 8;

/// How one pass of relaxation moves plants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relaxation {
    /// Part of the way to the centre of mass; above 1 is over-relaxation, below 2 it converges.
    pub step: f64,
}

impl Relaxation {
    /// The usual choice for pass number `pass` of `passes`: over-relaxed, and plain at the end.
    pub fn pass(pass: u32, passes: u32) -> Self {
        Self { step: if pass + 1 < passes { OVER } else { 1.0 } }
    }
}

/// Moves plants, given in map coordinates, once towards the centres of their polygons.
///
/// `density` says how dense plants are wanted, in any unit; no plant moves to where it is 0.
/// Plants beyond its frame stay. The result does not depend on the number of threads.
pub fn relax(places: &mut [[f64; 2]], density: &Grid, relaxation: &Relaxation) {
    if places.is_empty() {
        return;
    }
    let masses = Masses::new(density, places.len());
    let local: Vec<[f64; 2]> = places.iter().map(|place| masses.local(*place)).collect();
    let mut order: Vec<u32> = (0..local.len() as u32).collect();
    let tiles = split(&mut order, &local);
    let tiles: Vec<Tile> = tiles.into_iter().map(|members| Tile::new(members, &local)).collect();
    let moved: Vec<Vec<(u32, [f64; 2])>> = tiles
        .par_iter()
        .map(|tile| relax_tile(tile, &tiles, &local, &masses, relaxation))
        .collect();
    for (index, place) in moved.into_iter().flatten() {
        places[index as usize] = masses.on_map(place);
    }
}

/// A group of plants near each other.
struct Tile {
    members: Vec<u32>,
    /// Rectangle that holds them: low and high corner.
    low: [f64; 2],
    high: [f64; 2],
}

impl Tile {
    fn new(members: Vec<u32>, places: &[[f64; 2]]) -> Self {
        let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
        for &member in &members {
            for axis in 0..2 {
                low[axis] = low[axis].min(places[member as usize][axis]);
                high[axis] = high[axis].max(places[member as usize][axis]);
            }
        }
        Self { members, low, high }
    }

    /// Returns the spacing that the tile's plants would have if they were spread over it evenly,
    /// or along it when it is a line.
    fn spacing(&self) -> f64 {
        let (width, height) = (self.high[0] - self.low[0], self.high[1] - self.low[1]);
        let count = self.members.len() as f64;
        (width * height / count).sqrt().max(width.max(height) / count)
    }

    fn is_near(&self, low: [f64; 2], high: [f64; 2]) -> bool {
        (0..2).all(|axis| self.high[axis] >= low[axis] && self.low[axis] <= high[axis])
    }
}

/// Splits plants at medians, across the longer side, until each part fits a tile.
fn split(order: &mut [u32], places: &[[f64; 2]]) -> Vec<Vec<u32>> {
    if order.len() <= TILE {
        let mut members = order.to_vec();
        members.sort_unstable();
        return vec![members];
    }
    let axis = longer_side(order, places);
    let middle = order.len() / 2;
    // Equal coordinates are told apart by index, so that the parts are the same every time.
    order.select_nth_unstable_by(middle, |&a, &b| {
        places[a as usize][axis].total_cmp(&places[b as usize][axis]).then(a.cmp(&b))
    });
    let (low, high) = order.split_at_mut(middle);
    let (mut tiles, more) = rayon::join(|| split(low, places), || split(high, places));
    tiles.extend(more);
    tiles
}

fn longer_side(order: &[u32], places: &[[f64; 2]]) -> usize {
    let (mut low, mut high) = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    for &index in order {
        for axis in 0..2 {
            low[axis] = low[axis].min(places[index as usize][axis]);
            high[axis] = high[axis].max(places[index as usize][axis]);
        }
    }
    usize::from(high[1] - low[1] > high[0] - low[0])
}

/// Returns the new places of a tile's plants.
fn relax_tile(
    tile: &Tile,
    tiles: &[Tile],
    places: &[[f64; 2]],
    masses: &Masses<'_>,
    relaxation: &Relaxation,
) -> Vec<(u32, [f64; 2])> {
    // A lone tile knows every plant, so that nothing bounds its polygons but the ground.
    let widest = if tiles.len() == 1 { masses.diagonal() } else { 2.0 * tile.spacing() };
    let sites = with_ring(tile, tiles, places, 2.0 * SQRT_2 * REACH * widest);
    let neighbours = Neighbours::new(&sites, tile.members.len());
    let (mut polygon, mut spare) = (Vec::with_capacity(32), Vec::with_capacity(32));
    let relaxed = |(own, &index): (usize, &u32)| {
        let site = sites[own];
        let spacing = masses.spacing(site).min(widest);
        cell_polygon(site, REACH * spacing, &sites, neighbours.of(own), &mut polygon, &mut spare);
        let target = masses.centroid(&polygon)?;
        Some((index, masses.step(site, target, spacing, relaxation.step)))
    };
    tile.members.iter().enumerate().filter_map(relaxed).collect()
}

/// Returns the tile's plants, then all others within `ring` of its rectangle.
fn with_ring(tile: &Tile, tiles: &[Tile], places: &[[f64; 2]], ring: f64) -> Vec<[f64; 2]> {
    let low = tile.low.map(|edge| edge - ring);
    let high = tile.high.map(|edge| edge + ring);
    let mut sites: Vec<[f64; 2]> = tile.members.iter().map(|&m| places[m as usize]).collect();
    for other in
        tiles.iter().filter(|other| !std::ptr::eq(*other, tile) && other.is_near(low, high))
    {
        let inside = |place: &[f64; 2]| {
            (0..2).all(|axis| place[axis] >= low[axis] && place[axis] <= high[axis])
        };
        sites.extend(other.members.iter().map(|&m| places[m as usize]).filter(inside));
    }
    sites
}

/// Delaunay neighbours of the first sites of a list.
struct Neighbours {
    /// Where each site's neighbours begin in `list`, and where the last ones end.
    starts: Vec<u32>,
    list: Vec<u32>,
}

impl Neighbours {
    /// Triangulates the sites and gathers the neighbours of the first `count`.
    fn new(sites: &[[f64; 2]], count: usize) -> Self {
        if sites.len() <= FEW {
            return Self::everyone(sites.len(), count);
        }
        let points: Vec<Point> = sites.iter().map(|&[x, y]| Point { x, y }).collect();
        let mesh = triangulate(&points);
        // Each inner edge is two half-edges, one from each end; a rim edge is only one, and
        // counts for both ends.
        let edges = || {
            mesh.triangles.iter().enumerate().flat_map(|(edge, &from)| {
                let to = mesh.triangles[next_halfedge(edge)];
                let is_rim = mesh.halfedges[edge] == delaunator::EMPTY;
                [Some((from, to)), is_rim.then_some((to, from))].into_iter().flatten()
            })
        };
        let mut starts = vec![0u32; count + 1];
        edges().filter(|(from, _)| *from < count).for_each(|(from, _)| starts[from + 1] += 1);
        for site in 0..count {
            starts[site + 1] += starts[site];
        }
        let mut list = vec![0u32; starts[count] as usize];
        let mut next = starts.clone();
        for (from, to) in edges().filter(|(from, _)| *from < count) {
            list[next[from] as usize] = to as u32;
            next[from] += 1;
        }
        Self { starts, list }
    }

    fn everyone(all: usize, count: usize) -> Self {
        let others = |site: usize| (0..all as u32).filter(move |&other| other as usize != site);
        let list = (0..count).flat_map(others).collect();
        let each = all.saturating_sub(1) as u32;
        Self { starts: (0..=count as u32).map(|site| site * each).collect(), list }
    }

    fn of(&self, site: usize) -> &[u32] {
        &self.list[self.starts[site] as usize..self.starts[site + 1] as usize]
    }
}

/// Leaves in `polygon` the square of half side `reach` about a site, cut by the bisectors
/// towards its neighbours.
fn cell_polygon(
    site: [f64; 2],
    reach: f64,
    sites: &[[f64; 2]],
    neighbours: &[u32],
    polygon: &mut Vec<[f64; 2]>,
    spare: &mut Vec<[f64; 2]>,
) {
    let [x, y] = site;
    polygon.clear();
    polygon.extend([
        [x - reach, y - reach],
        [x + reach, y - reach],
        [x + reach, y + reach],
        [x - reach, y + reach],
    ]);
    for &neighbour in neighbours {
        let other = sites[neighbour as usize];
        let normal = [other[0] - x, other[1] - y];
        // Points p with (p - site)·normal = |normal|²/2 are as near to one as to the other.
        let half = 0.5 * (normal[0] * normal[0] + normal[1] * normal[1]);
        if half == 0.0 {
            continue;
        }
        clip(polygon, spare, |p| (p[0] - x) * normal[0] + (p[1] - y) * normal[1] - half);
        std::mem::swap(polygon, spare);
    }
}

/// Leaves in `inside` the part of a convex polygon where `beyond` is not positive.
fn clip(polygon: &[[f64; 2]], inside: &mut Vec<[f64; 2]>, beyond: impl Fn([f64; 2]) -> f64) {
    inside.clear();
    let Some(&last) = polygon.last() else { return };
    let (mut from, mut from_beyond) = (last, beyond(last));
    for &to in polygon {
        let to_beyond = beyond(to);
        if (from_beyond > 0.0) != (to_beyond > 0.0) {
            let t = from_beyond / (from_beyond - to_beyond);
            inside.push([from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])]);
        }
        if to_beyond <= 0.0 {
            inside.push(to);
        }
        (from, from_beyond) = (to, to_beyond);
    }
}

/// Running sums along a row up to a cell's west edge.
#[derive(Clone, Copy, Default)]
struct Running {
    /// Mass, per metre of the row's width across.
    mass: f64,
    /// First moment of the mass about the raster's west edge.
    moment: f64,
}

/// The square of a density, ready for integrals along rows.
///
/// Local coordinates run east and south from the raster's north-west corner.
struct Masses<'a> {
    density: &'a Grid,
    /// Factor that makes the density plants per m².
    scale: f64,
    /// Raster of masses, as coarse as need be.
    width: usize,
    height: usize,
    cell: f64,
    weights: Vec<f32>,
    /// `width + 1` sums a row.
    running: Vec<Running>,
}

impl<'a> Masses<'a> {
    fn new(density: &'a Grid, count: usize) -> Self {
        let frame = density.frame;
        let factor = ((frame.len() as f64 / MASS_CELLS as f64).sqrt().ceil() as usize).max(1);
        let (width, height) = (frame.width.div_ceil(factor), frame.height.div_ceil(factor));
        let cell = frame.cell * factor as f64;
        let mut weights = vec![0.0f32; width * height];
        weights.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
            for (column, weight) in line.iter_mut().enumerate() {
                let mean = block_mean(density, factor, column, row);
                *weight = mean * mean;
            }
        });
        let mut running = vec![Running::default(); (width + 1) * height];
        running.par_chunks_mut(width + 1).zip(weights.par_chunks(width.max(1))).for_each(
            |(sums, line)| {
                for (column, &weight) in line.iter().enumerate() {
                    let (from, to) = (column as f64 * cell, (column + 1) as f64 * cell);
                    let weight = f64::from(weight);
                    let last = sums[column];
                    sums[column + 1] = Running {
                        mass: last.mass + weight * cell,
                        moment: last.moment + weight * 0.5 * (to * to - from * from),
                    };
                }
            },
        );
        let rows = density.values.par_chunks(frame.width.max(1));
        let sums: Vec<f64> =
            rows.map(|row| row.iter().map(|value| f64::from(value.max(0.0))).sum()).collect();
        let plants = sums.iter().sum::<f64>() * frame.cell_area();
        let scale = if plants > 0.0 { count as f64 / plants } else { 0.0 };
        Self { density, scale, width, height, cell, weights, running }
    }

    /// Returns the longest distance on the raster, m.
    fn diagonal(&self) -> f64 {
        let frame = self.density.frame;
        frame.cell * ((frame.width * frame.width + frame.height * frame.height) as f64).sqrt()
    }

    fn local(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let frame = self.density.frame;
        [x - frame.west, frame.north() - y]
    }

    fn on_map(&self, [u, v]: [f64; 2]) -> [f64; 2] {
        let frame = self.density.frame;
        [frame.west + u, frame.north() - v]
    }

    /// Returns the density wanted at a local place, plants per m²; 0 outside.
    fn density_at(&self, [u, v]: [f64; 2]) -> f64 {
        let frame = self.density.frame;
        let (column, row) = ((u / frame.cell).floor(), (v / frame.cell).floor());
        let is_inside =
            column >= 0.0 && row >= 0.0 && column < frame.width as f64 && row < frame.height as f64;
        if !is_inside {
            return 0.0;
        }
        let value = self.density.values[row as usize * frame.width + column as usize];
        f64::from(value.max(0.0)) * self.scale
    }

    /// Returns the spacing of plants at the density wanted at a place; infinite where it is 0.
    fn spacing(&self, place: [f64; 2]) -> f64 {
        1.0 / self.density_at(place).sqrt()
    }

    /// Returns the centre of mass of a convex polygon; `None` when it holds no mass.
    ///
    /// Sums midpoint lines, each exact along its row.
    fn centroid(&self, polygon: &[[f64; 2]]) -> Option<[f64; 2]> {
        let (top, bottom) = polygon
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(t, b), p| (t.min(p[1]), b.max(p[1])));
        let (top, bottom) = (top.max(0.0), bottom.min(self.height as f64 * self.cell));
        if top.partial_cmp(&bottom) != Some(std::cmp::Ordering::Less) {
            return None;
        }
        let lines = ((bottom - top) / self.cell).ceil().max(LEAST_LINES);
        let apart = (bottom - top) / lines;
        let (mut mass, mut moment_u, mut moment_v) = (0.0, 0.0, 0.0);
        for line in 0..lines as usize {
            let v = top + (line as f64 + 0.5) * apart;
            let Some((from, to)) = crossing(polygon, v) else { continue };
            let row = ((v / self.cell) as usize).min(self.height - 1);
            let (start, end) = (self.sums(row, from), self.sums(row, to));
            let along = end.mass - start.mass;
            mass += along;
            moment_u += end.moment - start.moment;
            moment_v += along * v;
        }
        (mass > 0.0).then(|| [moment_u / mass, moment_v / mass])
    }

    /// Returns the sums along a row up to `u`.
    fn sums(&self, row: usize, u: f64) -> Running {
        let u = u.clamp(0.0, self.width as f64 * self.cell);
        let column = ((u / self.cell) as usize).min(self.width - 1);
        let edge = column as f64 * self.cell;
        let weight = f64::from(self.weights[row * self.width + column]);
        let before = self.running[row * (self.width + 1) + column];
        Running {
            mass: before.mass + weight * (u - edge),
            moment: before.moment + weight * 0.5 * (u * u - edge * edge),
        }
    }

    /// Returns where a plant goes that wants to move to `target`: `step` times the way, at most
    /// [`LONGEST_MOVE`] spacings, and less far or nowhere where it would leave what is wanted.
    fn step(&self, site: [f64; 2], target: [f64; 2], spacing: f64, step: f64) -> [f64; 2] {
        let (du, dv) = (step * (target[0] - site[0]), step * (target[1] - site[1]));
        let length = (du * du + dv * dv).sqrt();
        let longest = LONGEST_MOVE * spacing;
        let shrink = if length > longest { longest / length } else { 1.0 };
        [1.0, 0.5, 0.25]
            .iter()
            .map(|part| [site[0] + part * shrink * du, site[1] + part * shrink * dv])
            .find(|place| self.density_at(*place) > 0.0)
            .unwrap_or(site)
    }
}

/// Returns where a horizontal line enters and leaves a convex polygon.
fn crossing(polygon: &[[f64; 2]], v: f64) -> Option<(f64, f64)> {
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    let mut from = *polygon.last()?;
    for &to in polygon {
        if (from[1] > v) != (to[1] > v) {
            let u = from[0] + (v - from[1]) / (to[1] - from[1]) * (to[0] - from[0]);
            (low, high) = (low.min(u), high.max(u));
        }
        from = to;
    }
    (low < high).then_some((low, high))
}

/// Returns the mean density of a block of cells, counting those beyond the rim as empty.
fn block_mean(density: &Grid, factor: usize, column: usize, row: usize) -> f32 {
    let frame = density.frame;
    if factor == 1 {
        return density.values[row * frame.width + column].max(0.0);
    }
    let columns = column * factor..((column + 1) * factor).min(frame.width);
    let rows = row * factor..((row + 1) * factor).min(frame.height);
    let sum: f32 = rows
        .map(|r| {
            let line = &density.values[r * frame.width..][columns.clone()];
            line.iter().map(|value| value.max(0.0)).sum::<f32>()
        })
        .sum();
    sum / (factor * factor) as f32
}

/// Relaxes the plants of some species together, wherever they can stand.
pub(crate) fn run(step: &RelaxStep, site: &Site<'_>, stand: &mut Stand<'_>) -> Result<(), Error> {
    site.progress.begin("relax", u64::from(step.iterations), "passes");
    let mut species = Vec::new();
    for name in &step.species {
        species.push(stand.species_of(name)?);
    }
    let plants = &stand.population.plants;
    let meant = |index: &usize| species.is_empty() || species.contains(&plants[*index].species);
    let chosen: Vec<usize> = (0..plants.len()).filter(meant).collect();
    let mut places: Vec<[f64; 2]> =
        chosen.iter().map(|&index| [plants[index].x, plants[index].y]).collect();
    let density = wanted(step, chosen.len(), site, stand)?;
    for pass in 0..step.iterations {
        site.check_cancelled()?;
        relax(&mut places, &density, &Relaxation::pass(pass, step.iterations));
        site.progress.advance(1);
    }
    for (&index, [x, y]) in chosen.iter().zip(places) {
        let kind = stand.kind(stand.population.plants[index].species);
        if site.ground.bears(kind.ecology, x, y) {
            let plant = &mut stand.population.plants[index];
            (plant.x, plant.y) = (x, y);
            stand_on(&site.ground, &kind, plant);
        }
    }
    Ok(())
}

/// Returns the density that the step asks for, on cells of about a third of a spacing.
fn wanted(
    step: &RelaxStep,
    count: usize,
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Grid, Error> {
    let spacing = (site.ground.area() / count.max(1) as f64).sqrt();
    let coarsest = (site.ground.area() / MASS_CELLS as f64).sqrt();
    let frame: Frame = covering(site.ground.frame(), (spacing / 3.0).max(coarsest));
    let Some(formula) = &step.formula else { return Ok(Grid::filled(frame, 1.0)) };
    let bound = BoundFormula::bind(formula, site.around.terrain, stand)?;
    let values = bound.numbers(frame.len(), |index| {
        let (x, y) = frame.center(index % frame.width, index / frame.width);
        [x, y]
    })?;
    Ok(Grid { frame, values })
}
