//! Lloyd's relaxation: each plant moves to the centre of mass of its Voronoi polygon.
//!
//! It evens out the distances between neighbours [Lloyd82], [Deussen98]. The mass is the square
//! of the wanted density: in the plane, cells weighted by a density ρ^2 come to hold plants of
//! density ρ, while weighting by ρ itself would drift towards its square root [Gersho79].
//!
//! The corners of a polygon are the circumcentres of the Delaunay triangles about its plant.
//! Where it would outgrow the square of two spacings to each side of the plant, it is that
//! square, cut by the bisectors towards the plant's Delaunay neighbours. The square bounds the
//! polygons beside empty ground, and with them the ring of plants that a tile must know beyond
//! its own. Tiles are the leaves of a median split, so that dense and empty regions cost what
//! their plants cost.

use crate::Error;
use crate::config::RelaxStep;
use crate::density::covering;
use crate::field::BoundFormula;
use crate::stand::{Stand, stand_on};
use crate::steps::Site;
use delaunator::{EMPTY, Point, Triangulation, next_halfedge, triangulate};
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
/// Neighbours of a plant that triangulation leaves out: one of too few for a mesh, or a twin.
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
/// The result does not depend on the number of threads.
pub fn relax(places: &mut [[f64; 2]], density: &Grid, relaxation: &Relaxation) {
    Lloyd::new(density, places.len()).pass(places, relaxation);
}

/// A density made ready for many passes.
pub(crate) struct Lloyd<'a> {
    masses: Masses<'a>,
}

impl<'a> Lloyd<'a> {
    /// Prepares to relax `count` plants.
    pub(crate) fn new(density: &'a Grid, count: usize) -> Self {
        Self { masses: Masses::new(density, count) }
    }

    /// Moves plants once.
    pub(crate) fn pass(&self, places: &mut [[f64; 2]], relaxation: &Relaxation) {
        let masses = &self.masses;
        let mut plants: Vec<Member> = places
            .par_iter()
            .enumerate()
            .map(|(index, place)| Member { place: masses.local(*place), index: index as u32 })
            .collect();
        let tiles: Vec<Tile<'_>> = split(&mut plants).into_iter().map(Tile::new).collect();
        let moved: Vec<Vec<Member>> =
            tiles.par_iter().map(|tile| relax_tile(tile, &tiles, masses, relaxation)).collect();
        for plant in moved.into_iter().flatten() {
            places[plant.index as usize] = masses.on_map(plant.place);
        }
    }
}

/// A plant at a place in local coordinates.
#[derive(Clone, Copy)]
struct Member {
    place: [f64; 2],
    index: u32,
}

/// A group of plants near each other.
struct Tile<'a> {
    members: &'a [Member],
    /// Rectangle that holds them: low and high corner.
    low: [f64; 2],
    high: [f64; 2],
}

impl<'a> Tile<'a> {
    fn new(members: &'a [Member]) -> Self {
        let (low, high) = bounds(members);
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

fn bounds(members: &[Member]) -> ([f64; 2], [f64; 2]) {
    let start = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    members.iter().fold(start, |(low, high), member| {
        let [x, y] = member.place;
        ([low[0].min(x), low[1].min(y)], [high[0].max(x), high[1].max(y)])
    })
}

/// Splits plants at medians, across the longer side, until each part fits a tile.
fn split(members: &mut [Member]) -> Vec<&[Member]> {
    if members.len() <= TILE {
        return vec![members];
    }
    let (low, high) = bounds(members);
    let axis = usize::from(high[1] - low[1] > high[0] - low[0]);
    let middle = members.len() / 2;
    // Equal coordinates are told apart by index, so that the parts are the same every time.
    members.select_nth_unstable_by(middle, |a, b| {
        a.place[axis].total_cmp(&b.place[axis]).then(a.index.cmp(&b.index))
    });
    let (low, high) = members.split_at_mut(middle);
    let (mut tiles, more) = rayon::join(|| split(low), || split(high));
    tiles.extend(more);
    tiles
}

/// Returns the tile's plants at their new places.
fn relax_tile(
    tile: &Tile<'_>,
    tiles: &[Tile<'_>],
    masses: &Masses<'_>,
    relaxation: &Relaxation,
) -> Vec<Member> {
    // A lone tile knows every plant, so that nothing bounds its polygons but the ground.
    let widest = if tiles.len() == 1 { masses.diagonal() } else { 2.0 * tile.spacing() };
    let sites = with_ring(tile, tiles, 2.0 * SQRT_2 * REACH * widest);
    let mut cells = Cells::new(&sites);
    let mut sweep = Sweep::default();
    let relaxed = |(own, member): (usize, &Member)| {
        let spacing = masses.spacing(member.place).min(widest);
        let target = masses.centroid(cells.polygon(own, REACH * spacing), &mut sweep)?;
        let place = masses.step(member.place, target, spacing, relaxation.step);
        Some(Member { place, ..*member })
    };
    tile.members.iter().enumerate().filter_map(relaxed).collect()
}

/// Returns the tile's plants, then all others within `ring` of its rectangle.
fn with_ring(tile: &Tile<'_>, tiles: &[Tile<'_>], ring: f64) -> Vec<Point> {
    let low = tile.low.map(|edge| edge - ring);
    let high = tile.high.map(|edge| edge + ring);
    let point = |member: &Member| Point { x: member.place[0], y: member.place[1] };
    let mut sites: Vec<Point> = tile.members.iter().map(point).collect();
    for other in tiles.iter().filter(|other| other.is_near(low, high)) {
        if std::ptr::eq(other.members, tile.members) {
            continue;
        }
        let inside = |member: &&Member| {
            (0..2).all(|axis| (low[axis]..=high[axis]).contains(&member.place[axis]))
        };
        sites.extend(other.members.iter().filter(inside).map(point));
    }
    sites
}

/// Voronoi polygons of sites.
struct Cells<'a> {
    sites: &'a [Point],
    mesh: Triangulation,
    /// Circumcentres of the triangles: the corners of the polygons.
    corners: Vec<[f64; 2]>,
    /// For each site, a half-edge that ends in it, on the rim where there is one; `EMPTY` for
    /// sites that the mesh leaves out.
    arrivals: Vec<usize>,
    polygon: Vec<[f64; 2]>,
    spare: Vec<[f64; 2]>,
    neighbours: Vec<usize>,
}

impl<'a> Cells<'a> {
    fn new(sites: &'a [Point]) -> Self {
        let mesh = triangulate(sites);
        let corner = |t: &[usize]| circumcentre(&sites[t[0]], &sites[t[1]], &sites[t[2]]);
        let corners = mesh.triangles.chunks_exact(3).map(corner).collect();
        let mut arrivals = vec![EMPTY; sites.len()];
        for edge in 0..mesh.triangles.len() {
            let end = mesh.triangles[next_halfedge(edge)];
            if arrivals[end] == EMPTY || mesh.halfedges[edge] == EMPTY {
                arrivals[end] = edge;
            }
        }
        let (polygon, spare, neighbours) = (Vec::new(), Vec::new(), Vec::new());
        Self { sites, mesh, corners, arrivals, polygon, spare, neighbours }
    }

    /// Returns the polygon of a site within the square of half side `reach` about it.
    fn polygon(&mut self, own: usize, reach: f64) -> &[[f64; 2]] {
        let is_whole = self.go_around(own);
        let site = &self.sites[own];
        let is_inside = |corner: &[f64; 2]| {
            (corner[0] - site.x).abs() <= reach && (corner[1] - site.y).abs() <= reach
        };
        if !is_whole || !self.polygon.iter().all(is_inside) {
            self.cut_square(own, reach);
        }
        &self.polygon
    }

    /// Gathers a site's neighbours and the corners of its polygon in turn; says whether they
    /// go all the way around.
    fn go_around(&mut self, own: usize) -> bool {
        self.polygon.clear();
        self.neighbours.clear();
        let first = self.arrivals[own];
        if first == EMPTY {
            // Twins of other sites, and sites too few for a mesh: everyone is a neighbour.
            let few = 0..self.sites.len().min(FEW);
            self.neighbours.extend(few.filter(|&other| other != own));
            return false;
        }
        let mut arrival = first;
        loop {
            self.neighbours.push(self.mesh.triangles[arrival]);
            self.polygon.push(self.corners[arrival / 3]);
            let departure = next_halfedge(arrival);
            arrival = self.mesh.halfedges[departure];
            if arrival == EMPTY {
                self.neighbours.push(self.mesh.triangles[next_halfedge(departure)]);
                return false;
            }
            if arrival == first {
                return true;
            }
        }
    }

    /// Leaves in `polygon` the square about a site, cut by the bisectors towards its neighbours.
    fn cut_square(&mut self, own: usize, reach: f64) {
        let &Point { x, y } = &self.sites[own];
        self.polygon.clear();
        self.polygon.extend([
            [x - reach, y - reach],
            [x + reach, y - reach],
            [x + reach, y + reach],
            [x - reach, y + reach],
        ]);
        for &neighbour in &self.neighbours {
            let other = &self.sites[neighbour];
            let normal = [other.x - x, other.y - y];
            // Points p with (p - site)·normal = |normal|²/2 are as near to one as to the other.
            let half = 0.5 * (normal[0] * normal[0] + normal[1] * normal[1]);
            if half == 0.0 {
                continue;
            }
            clip(&self.polygon, &mut self.spare, |p| {
                (p[0] - x) * normal[0] + (p[1] - y) * normal[1] - half
            });
            std::mem::swap(&mut self.polygon, &mut self.spare);
        }
    }
}

/// Returns the point as far from `a` as from `b` and `c`; not finite when they lie on a line.
fn circumcentre(a: &Point, b: &Point, c: &Point) -> [f64; 2] {
    let (bx, by, cx, cy) = (b.x - a.x, b.y - a.y, c.x - a.x, c.y - a.y);
    let (b2, c2) = (bx * bx + by * by, cx * cx + cy * cy);
    let scale = 0.5 / (bx * cy - by * cx);
    [a.x + (cy * b2 - by * c2) * scale, a.y + (bx * c2 - cx * b2) * scale]
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

/// Evenly spaced lines across a convex polygon, and where each enters and leaves it.
#[derive(Default)]
struct Sweep {
    top: f64,
    apart: f64,
    spans: Vec<(f64, f64)>,
}

impl Sweep {
    /// Draws lines at least `finest` apart unless that were fewer than [`LEAST_LINES`], between
    /// 0 and `bottom`; says whether any line meets the polygon.
    fn draw(&mut self, polygon: &[[f64; 2]], finest: f64, bottom: f64) -> bool {
        let start = (f64::INFINITY, f64::NEG_INFINITY);
        let (low, high) = polygon.iter().fold(start, |(l, h), p| (l.min(p[1]), h.max(p[1])));
        let (top, bottom) = (low.max(0.0), high.min(bottom));
        if top.partial_cmp(&bottom) != Some(std::cmp::Ordering::Less) {
            return false;
        }
        let lines = ((bottom - top) / finest).ceil().max(LEAST_LINES);
        (self.top, self.apart) = (top, (bottom - top) / lines);
        self.spans.clear();
        self.spans.resize(lines as usize, start);
        let mut from = polygon[polygon.len() - 1];
        for &to in polygon {
            self.cross(from, to);
            from = to;
        }
        true
    }

    /// Widens the spans of the lines that an edge crosses.
    fn cross(&mut self, from: [f64; 2], to: [f64; 2]) {
        let (upper, lower) = if from[1] <= to[1] { (from, to) } else { (to, from) };
        // Line k lies at top + (k + 1/2) apart; casts of negative numbers give 0.
        let line = |v: f64| ((v - self.top) / self.apart + 0.5) as usize;
        let lines = line(upper[1])..line(lower[1]).min(self.spans.len());
        let slope = (lower[0] - upper[0]) / (lower[1] - upper[1]);
        for index in lines {
            let u = upper[0] + (self.at(index) - upper[1]) * slope;
            let (low, high) = self.spans[index];
            self.spans[index] = (low.min(u), high.max(u));
        }
    }

    fn at(&self, index: usize) -> f64 {
        self.top + (index as f64 + 0.5) * self.apart
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
    fn centroid(&self, polygon: &[[f64; 2]], sweep: &mut Sweep) -> Option<[f64; 2]> {
        if !sweep.draw(polygon, self.cell, self.height as f64 * self.cell) {
            return None;
        }
        let (mut mass, mut moment_u, mut moment_v) = (0.0, 0.0, 0.0);
        for (line, &(from, to)) in sweep.spans.iter().enumerate().filter(|(_, s)| s.0 < s.1) {
            let v = sweep.at(line);
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
    let lloyd = Lloyd::new(&density, places.len());
    for pass in 0..step.iterations {
        site.check_cancelled()?;
        lloyd.pass(&mut places, &Relaxation::pass(pass, step.iterations));
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
