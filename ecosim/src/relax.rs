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
use crate::config::{RelaxStep, Weight};
use crate::density::covering;
use crate::field::BoundFormula;
use crate::mass::{MASS_CELLS, Masses, Sweep};
use crate::stand::{Stand, stand_on};
use crate::steps::Site;
use crate::voronoi::Cells;
use delaunator::Point;
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

/// How one pass of relaxation moves plants.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Relaxation {
    /// Part of the way to the centre of mass; above 1 is over-relaxation, below 2 it converges.
    pub step: f64,
    /// What weighs the ground.
    pub weight: Weight,
}

impl Relaxation {
    /// The usual choice for pass number `pass` of `passes`: weighted by the density squared,
    /// over-relaxed, and plain at the end.
    pub fn pass(pass: u32, passes: u32) -> Self {
        Self::weighted(Weight::Squared, pass, passes)
    }

    /// The choice for pass number `pass` of `passes` under another weight. The plain form goes the
    /// whole way to the middle, and no further.
    pub fn weighted(weight: Weight, pass: u32, passes: u32) -> Self {
        let is_over = weight != Weight::Even && pass + 1 < passes;
        Self { step: if is_over { OVER } else { 1.0 }, weight }
    }
}

/// Moves plants, given in map coordinates, once towards the centres of their polygons.
///
/// `density` says how dense plants are wanted, in any unit; no plant moves to where it is 0.
/// The result does not depend on the number of threads.
pub fn relax(places: &mut [[f64; 2]], density: &Grid, relaxation: &Relaxation) {
    let count = places.len();
    Lloyd::new(density, Some(count), relaxation.weight).pass(places, count, relaxation.step);
}

/// A density made ready for many passes.
pub(crate) struct Lloyd<'a> {
    masses: Masses<'a>,
}

impl<'a> Lloyd<'a> {
    /// Prepares to relax on a density in plants per m², or in any unit if it is to hold `count`
    /// plants.
    pub(crate) fn new(density: &'a Grid, count: Option<usize>, weight: Weight) -> Self {
        Self { masses: Masses::new(density, count, weight) }
    }

    /// Moves the first `movable` plants once, `step` times the way to their centres; the others
    /// stay, and keep them off.
    pub(crate) fn pass(&self, places: &mut [[f64; 2]], movable: usize, step: f64) {
        self.pass_in_tiles(places, movable, step, TILE);
    }

    /// A pass in tiles of `most` plants at most.
    fn pass_in_tiles(&self, places: &mut [[f64; 2]], movable: usize, step: f64, most: usize) {
        let masses = &self.masses;
        let mut plants: Vec<Member> = places
            .par_iter()
            .enumerate()
            .map(|(index, place)| Member { place: masses.local(*place), index: index as u32 })
            .collect();
        let tiles: Vec<Tile<'_>> = split(&mut plants, most).into_iter().map(Tile::new).collect();
        let moved: Vec<Vec<Member>> =
            tiles.par_iter().map(|tile| relax_tile(tile, &tiles, masses, movable, step)).collect();
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

    /// Returns the greatest spacing wanted at one of its plants, at most `most`.
    fn widest_spacing(&self, masses: &Masses<'_>, most: f64) -> f64 {
        let spacings = self.members.iter().map(|member| masses.spacing(member.place).min(most));
        spacings.fold(0.0, f64::max)
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
fn split(members: &mut [Member], most: usize) -> Vec<&[Member]> {
    if members.len() <= most {
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
    let (mut tiles, more) = rayon::join(|| split(low, most), || split(high, most));
    tiles.extend(more);
    tiles
}

/// Returns the tile's plants at their new places.
fn relax_tile(
    tile: &Tile<'_>,
    tiles: &[Tile<'_>],
    masses: &Masses<'_>,
    movable: usize,
    step: f64,
) -> Vec<Member> {
    // A lone tile knows every plant, so that nothing bounds its polygons but the ground.
    let widest = if tiles.len() == 1 { masses.diagonal() } else { 2.0 * tile.spacing() };
    let sites = with_ring(tile, tiles, 2.0 * SQRT_2 * REACH * tile.widest_spacing(masses, widest));
    let mut cells = Cells::new(&sites);
    let mut sweep = Sweep::default();
    let relaxed = |(own, member): (usize, &Member)| {
        let spacing = masses.spacing(member.place).min(widest);
        let target = masses.centroid(cells.polygon(own, REACH * spacing), &mut sweep)?;
        let longest = LONGEST_MOVE * spacing;
        let place = destination(member.place, target, longest, step, masses);
        Some(Member { place, ..*member })
    };
    let may_move = |(_, member): &(usize, &Member)| (member.index as usize) < movable;
    tile.members.iter().enumerate().filter(may_move).filter_map(relaxed).collect()
}

/// Returns where a plant goes that wants to move to `target`: `step` times the way, at most
/// [`LONGEST_MOVE`] spacings, and less far or nowhere where it would leave what is wanted.
fn destination(
    site: [f64; 2],
    target: [f64; 2],
    longest: f64,
    step: f64,
    masses: &Masses<'_>,
) -> [f64; 2] {
    let (du, dv) = (step * (target[0] - site[0]), step * (target[1] - site[1]));
    let length = (du * du + dv * dv).sqrt();
    let shrink = if length > longest { longest / length } else { 1.0 };
    [1.0, 0.5, 0.25]
        .iter()
        .map(|part| [site[0] + part * shrink * du, site[1] + part * shrink * dv])
        .find(|place| masses.density_at(*place) > 0.0)
        .unwrap_or(site)
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
    let movable = places.len();
    let lloyd = Lloyd::new(&density, Some(movable), step.weight);
    for pass in 0..step.iterations {
        site.check_cancelled()?;
        let way = Relaxation::weighted(step.weight, pass, step.iterations).step;
        lloyd.pass(&mut places, movable, way);
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

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn tiles_of_any_size_move_plants_to_the_same_places() {
        // Spots on ground that is empty for the greater part.
        let frame = Frame { width: 200, height: 200, cell: 0.5, west: 0.0, south: 0.0 };
        let wanted = |x: f64, y: f64| {
            let spot = (x * 0.13).sin() * (y * 0.11).cos();
            if spot > 0.2 { spot as f32 } else { 0.0 }
        };
        let density = Grid::from_fn(frame, wanted);
        let mut stream = Seed(2).stream("places", 0);
        let mut places = Vec::new();
        while places.len() < 6000 {
            let place = [stream.range(0.0, 100.0), stream.range(0.0, 100.0)];
            let is_wanted = density.nearest(place[0], place[1]).is_some_and(|d| d > 0.0);
            places.extend(is_wanted.then_some(place));
        }
        let lloyd = Lloyd::new(&density, Some(places.len()), Weight::Squared);
        let moved = [100, 1000, 2500].map(|most| {
            let mut moved = places.clone();
            for _ in 0..5 {
                lloyd.pass_in_tiles(&mut moved, places.len(), 1.5, most);
            }
            moved
        });
        // The same corners of polygons come in another order, so that sums round otherwise.
        for other in &moved[1..] {
            for (a, b) in moved[0].iter().zip(other) {
                assert!((a[0] - b[0]).hypot(a[1] - b[1]) < 1e-6, "{a:?} {b:?}");
            }
        }
    }
}
