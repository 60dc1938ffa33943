//! Polish: plants move until each has an equal share of the density, with the middle of that share
//! under its stem.
//!
//! The ground is divided by a power diagram: it belongs to the plant for which the squared
//! distance less the plant's weight is least. Weights are chosen so that all cells hold the same
//! mass, which makes the pattern's low frequencies vanish, and plants go to the centres of their
//! cells [Balzer09]. The masses follow from the weights by Newton's method [DeGoes12]: how they
//! change with them is a Laplacian over the edges of the diagram, solved by conjugate gradients.

use crate::config::Weight;
use crate::mass::{Masses, Sweep};
use delaunator::{EMPTY, Point, next_halfedge, triangulate};
use rayon::prelude::*;
use weald_contract::Grid;

/// Newton steps of one pass at most. Weights are kept from pass to pass, so that two keep masses
/// within a percent of each other.
const STEPS: u32 = 2;
/// Parts of a Newton step that are tried until masses come nearer to each other.
const PARTS: [f64; 4] = [1.0, 0.5, 0.25, 0.125];
/// Conjugate gradients end where the residual is this part of what it was, or after so many turns.
const TOLERANCE: f64 = 1e-3;
const TURNS: u32 = 60;
/// Half the side of the square that bounds a cell, in local spacings.
const REACH: f64 = 3.0;
/// Farthest move in one pass, in local spacings.
const LONGEST_MOVE: f64 = 0.5;
/// Plants that one thread takes at a time.
const CHUNK: usize = 1024;
/// Marks an edge that lies on the bounding square.
const NOBODY: u32 = u32::MAX;

/// Moves plants, given in map coordinates, towards equal shares of a density in any unit.
///
/// The result does not depend on the number of threads.
pub fn polish(places: &mut [[f64; 2]], density: &Grid, passes: u32) {
    let count = places.len();
    let mut shares = Shares::new(density, Some(count), count);
    (0..passes).for_each(|_| shares.pass(places, count));
}

/// A density to be shared out, and the weights so far.
pub(crate) struct Shares<'a> {
    masses: Masses<'a>,
    weights: Vec<f64>,
}

/// What a plant has of the ground.
#[derive(Clone, Default)]
struct Share {
    mass: f64,
    centre: Option<[f64; 2]>,
    /// Plants beyond its edges, and how much mass goes over to it from each as its weight grows,
    /// 1/m².
    edges: Vec<(u32, f64)>,
}

impl<'a> Shares<'a> {
    /// Prepares a density in plants per m², or in any unit if it is to hold `count` plants.
    pub(crate) fn new(density: &'a Grid, count: Option<usize>, plants: usize) -> Self {
        let masses = Masses::new(density, count, Weight::Density);
        Self { masses, weights: vec![0.0; plants] }
    }

    /// Moves the first `movable` plants once; the others stay, with the ground next to them.
    pub(crate) fn pass(&mut self, places: &mut [[f64; 2]], movable: usize) {
        let sites = self.sites(places);
        let shares = self.even_out(&Mesh::new(&sites), movable, STEPS);
        let masses = &self.masses;
        places[..movable].par_iter_mut().enumerate().for_each(|(own, place)| {
            let site = [sites[own].x, sites[own].y];
            let Some(centre) = shares[own].centre else { return };
            let longest = LONGEST_MOVE * masses.spacing(site);
            let way = [centre[0] - site[0], centre[1] - site[1]];
            let length = (way[0] * way[0] + way[1] * way[1]).sqrt();
            let part = if length > longest { longest / length } else { 1.0 };
            let goal = [site[0] + part * way[0], site[1] + part * way[1]];
            if masses.density_at(goal) > 0.0 {
                *place = masses.on_map(goal);
            }
        });
    }

    fn sites(&self, places: &[[f64; 2]]) -> Vec<Point> {
        let local = places.par_iter().map(|place| self.masses.local(*place));
        local.map(|[x, y]| Point { x, y }).collect()
    }

    /// Changes weights so that the first `movable` plants have equal shares, and returns them.
    fn even_out(&mut self, mesh: &Mesh<'_>, movable: usize, steps: u32) -> Vec<Share> {
        let mut shares = shares(&self.masses, mesh, &self.weights);
        let mut off = lacking(&shares, movable);
        let with_ground = holding(&shares);
        for _ in 0..steps {
            let step = newton_step(&shares, &off);
            let tried = PARTS.into_iter().find_map(|part| {
                let changed = self.weights.iter().zip(&step);
                let weights: Vec<f64> = changed.map(|(old, step)| old + part * step).collect();
                let shares = self::shares(&self.masses, mesh, &weights);
                let now = lacking(&shares, movable);
                // A cell that vanished lacks nothing as an island of its own, but has no plant.
                let is_better = norm(&now) < norm(&off) && holding(&shares) >= with_ground;
                is_better.then_some((weights, shares, now))
            });
            let Some(better) = tried else { break };
            (self.weights, shares, off) = better;
        }
        shares
    }
}

/// Delaunay neighbours of sites, a run for each.
struct Mesh<'a> {
    sites: &'a [Point],
    starts: Vec<u32>,
    neighbours: Vec<u32>,
}

impl<'a> Mesh<'a> {
    fn new(sites: &'a [Point]) -> Self {
        let mesh = triangulate(sites);
        let edge = |from: usize| (mesh.triangles[from], mesh.triangles[next_halfedge(from)]);
        // Each half-edge tells its end of its start; one on the rim tells the start, too.
        let told = |from: usize| {
            let (start, end) = edge(from);
            let back = (mesh.halfedges[from] == EMPTY).then_some((start, end));
            std::iter::once((end, start)).chain(back)
        };
        let mut starts = vec![0u32; sites.len() + 1];
        let half_edges = 0..mesh.triangles.len();
        half_edges.clone().flat_map(told).for_each(|(own, _)| starts[own + 1] += 1);
        (0..sites.len()).for_each(|own| starts[own + 1] += starts[own]);
        let mut neighbours = vec![0; starts[sites.len()] as usize];
        let mut next = starts.clone();
        for (own, other) in half_edges.flat_map(told) {
            neighbours[next[own] as usize] = other as u32;
            next[own] += 1;
        }
        Self { sites, starts, neighbours }
    }

    fn around(&self, own: usize) -> &[u32] {
        &self.neighbours[self.starts[own] as usize..self.starts[own + 1] as usize]
    }
}

/// Returns how many plants have any ground.
fn holding(shares: &[Share]) -> usize {
    shares.iter().filter(|share| share.mass > 0.0).count()
}

/// Returns what each of the first `movable` plants lacks of its fair share, and 0 for the others.
///
/// Shares are fair among plants whose ground hangs together: an island keeps what it has.
fn lacking(shares: &[Share], movable: usize) -> Vec<f64> {
    let islands = islands(shares);
    let mut sums = vec![(0.0, 0u32); shares.len()];
    for (share, &island) in shares.iter().zip(&islands).take(movable) {
        sums[island].0 += share.mass;
        sums[island].1 += 1;
    }
    let lacks = |own: usize| {
        let (mass, count) = sums[islands[own]];
        if own < movable { mass / f64::from(count) - shares[own].mass } else { 0.0 }
    };
    (0..shares.len()).into_par_iter().map(lacks).collect()
}

/// Returns for each plant the first one of its island.
fn islands(shares: &[Share]) -> Vec<usize> {
    let mut first: Vec<usize> = (0..shares.len()).collect();
    fn root(first: &mut [usize], mut own: usize) -> usize {
        while first[own] != own {
            first[own] = first[first[own]];
            own = first[own];
        }
        own
    }
    for (own, share) in shares.iter().enumerate() {
        for &(other, _) in share.edges.iter().filter(|(_, flow)| *flow > 0.0) {
            let (a, b) = (root(&mut first, own), root(&mut first, other as usize));
            first[a.max(b)] = a.min(b);
        }
    }
    (0..shares.len()).map(|own| root(&mut first, own)).collect()
}

/// Returns the changes of weights that would fill what is lacking, were masses linear in them.
fn newton_step(shares: &[Share], off: &[f64]) -> Vec<f64> {
    let diagonal: Vec<f64> = shares
        .par_iter()
        .map(|share| share.edges.iter().map(|(_, flow)| flow).sum::<f64>())
        .map(|sum| if sum > 0.0 { sum } else { 1.0 })
        .collect();
    let apply = |vector: &[f64]| -> Vec<f64> {
        let row = |own: usize| {
            let flows = shares[own].edges.iter();
            flows.map(|&(other, flow)| flow * (vector[own] - vector[other as usize])).sum()
        };
        (0..shares.len()).into_par_iter().map(row).collect()
    };
    let eased = |residual: &[f64]| -> Vec<f64> {
        residual.par_iter().zip(&diagonal).map(|(residual, own)| residual / own).collect()
    };
    let mut step = vec![0.0; shares.len()];
    let mut residual = off.to_vec();
    let mut direction = eased(&residual);
    let first = dot(&residual, &direction);
    let mut left = first;
    for _ in 0..TURNS {
        if left <= TOLERANCE * TOLERANCE * first {
            break;
        }
        let image = apply(&direction);
        let part = left / dot(&direction, &image);
        if !part.is_finite() {
            break;
        }
        add(&mut step, part, &direction);
        add(&mut residual, -part, &image);
        let next = eased(&residual);
        let now = dot(&residual, &next);
        direction.par_iter_mut().zip(next).for_each(|(d, next)| *d = next + now / left * *d);
        left = now;
    }
    step
}

/// Sums over chunks of fixed size, in turn, so that threads do not matter.
fn dot(a: &[f64], b: &[f64]) -> f64 {
    let chunk = |(a, b): (&[f64], &[f64])| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let sums: Vec<f64> = a.par_chunks(CHUNK).zip(b.par_chunks(CHUNK)).map(chunk).collect();
    sums.iter().sum()
}

fn norm(vector: &[f64]) -> f64 {
    dot(vector, vector).sqrt()
}

fn add(to: &mut [f64], factor: f64, what: &[f64]) {
    to.par_iter_mut().zip(what).for_each(|(to, what)| *to += factor * what);
}

fn shares(masses: &Masses<'_>, mesh: &Mesh<'_>, weights: &[f64]) -> Vec<Share> {
    let mut shares = vec![Share::default(); mesh.sites.len()];
    shares.par_chunks_mut(CHUNK).enumerate().for_each(|(chunk, shares)| {
        let mut cell = Cell::default();
        for (index, share) in shares.iter_mut().enumerate() {
            *share = cell.share(chunk * CHUNK + index, masses, mesh, weights);
        }
    });
    shares
}

/// One power cell: its corners, and whom the edge from each corner to the next divides from.
#[derive(Default)]
struct Cell {
    corners: Vec<[f64; 2]>,
    beyond: Vec<u32>,
    spare: (Vec<[f64; 2]>, Vec<u32>),
    cut_by: Vec<u32>,
    sweep: Sweep,
}

impl Cell {
    fn share(
        &mut self,
        own: usize,
        masses: &Masses<'_>,
        mesh: &Mesh<'_>,
        weights: &[f64],
    ) -> Share {
        self.draw(own, masses, mesh, weights);
        if self.corners.is_empty() {
            // Heavier neighbours took it all.
            return Share::default();
        }
        let Some((mass, centre)) = masses.mass_and_centroid(&self.corners, &mut self.sweep) else {
            return Share::default();
        };
        let site = &mesh.sites[own];
        let mut edges = Vec::with_capacity(self.beyond.len());
        for (index, &other) in self.beyond.iter().enumerate().filter(|(_, o)| **o != NOBODY) {
            let (a, b) = (self.corners[index], self.corners[(index + 1) % self.corners.len()]);
            let length = ((b[0] - a[0]).powi(2) + (b[1] - a[1]).powi(2)).sqrt();
            let rival = &mesh.sites[other as usize];
            let apart = ((rival.x - site.x).powi(2) + (rival.y - site.y).powi(2)).sqrt();
            // An edge moves by 1/2d as its plant's weight grows by 1.
            edges.push((other, masses.mean_weight(a, b) * length / (2.0 * apart)));
        }
        Share { mass, centre: Some(centre), edges }
    }

    /// Cuts the square about a plant by its neighbours and theirs: weights that differ by less
    /// than a squared spacing let no one farther off reach the cell.
    fn draw(&mut self, own: usize, masses: &Masses<'_>, mesh: &Mesh<'_>, weights: &[f64]) {
        let &Point { x, y } = &mesh.sites[own];
        let reach = (REACH * masses.spacing([x, y])).min(masses.diagonal());
        self.corners.clear();
        self.corners.extend([
            [x - reach, y - reach],
            [x + reach, y - reach],
            [x + reach, y + reach],
            [x - reach, y + reach],
        ]);
        self.beyond.clear();
        self.beyond.extend([NOBODY; 4]);
        self.cut_by.clear();
        self.cut_by.extend_from_slice(mesh.around(own));
        for &near in mesh.around(own) {
            self.cut_by.extend_from_slice(mesh.around(near as usize));
        }
        let near = mesh.around(own).len();
        self.cut_by[near..].sort_unstable();
        for index in 0..self.cut_by.len() {
            let other = self.cut_by[index];
            let is_again = index > near && self.cut_by[index - 1] == other;
            if other as usize != own && !is_again {
                self.cut(own, other, mesh, weights);
            }
        }
    }

    /// Takes away what belongs to another plant.
    fn cut(&mut self, own: usize, other: u32, mesh: &Mesh<'_>, weights: &[f64]) {
        let (site, rival) = (&mesh.sites[own], &mesh.sites[other as usize]);
        let normal = [rival.x - site.x, rival.y - site.y];
        let squared = normal[0] * normal[0] + normal[1] * normal[1];
        if squared == 0.0 {
            return;
        }
        let edge = 0.5 * (squared + weights[own] - weights[other as usize]);
        let out = |p: &[f64; 2]| (p[0] - site.x) * normal[0] + (p[1] - site.y) * normal[1] - edge;
        if self.corners.iter().all(|corner| out(corner) <= 0.0) {
            return;
        }
        let (corners, beyond) = &mut self.spare;
        corners.clear();
        beyond.clear();
        for index in 0..self.corners.len() {
            let (from, to) = (self.corners[index], self.corners[(index + 1) % self.corners.len()]);
            let (from_out, to_out) = (out(&from), out(&to));
            if from_out <= 0.0 {
                corners.push(from);
                beyond.push(self.beyond[index]);
            }
            if (from_out > 0.0) != (to_out > 0.0) {
                let part = from_out / (from_out - to_out);
                corners
                    .push([from[0] + part * (to[0] - from[0]), from[1] + part * (to[1] - from[1])]);
                // Going out, the new edge runs along the cut; coming in, the old edge goes on.
                beyond.push(if from_out <= 0.0 { other } else { self.beyond[index] });
            }
        }
        std::mem::swap(&mut self.corners, corners);
        std::mem::swap(&mut self.beyond, beyond);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Frame, Seed};

    fn scattered(count: usize, side: f64) -> Vec<[f64; 2]> {
        let mut stream = Seed(6).stream("places", 0);
        (0..count).map(|_| [stream.range(0.0, side), stream.range(0.0, side)]).collect()
    }

    fn level() -> Grid {
        let frame = Frame { width: 60, height: 60, cell: 0.5, west: 0.0, south: 0.0 };
        Grid::filled(frame, 1.0)
    }

    #[test]
    fn cells_divide_the_ground_among_plants_whatever_their_weights() {
        let grid = level();
        let masses = Masses::new(&grid, None, Weight::Density);
        let places = scattered(900, 30.0);
        let sites: Vec<Point> = places.iter().map(|p| Point { x: p[0], y: p[1] }).collect();
        let mesh = Mesh::new(&sites);
        let mut stream = Seed(7).stream("weights", 0);
        let weights: Vec<f64> = sites.iter().map(|_| stream.range(0.0, 0.3)).collect();
        let mut cell = Cell::default();
        // Every place belongs to the plant with the least power distance, and to that one only.
        for _ in 0..200 {
            let place = [stream.range(3.0, 27.0), stream.range(3.0, 27.0)];
            let power = |own: usize| {
                let site = &sites[own];
                (site.x - place[0]).powi(2) + (site.y - place[1]).powi(2) - weights[own]
            };
            let nearest = (0..sites.len()).min_by(|&a, &b| power(a).total_cmp(&power(b))).unwrap();
            for own in 0..sites.len() {
                cell.draw(own, &masses, &mesh, &weights);
                let corners = &cell.corners;
                let is_left = |i: usize| {
                    let (a, b) = (corners[i], corners[(i + 1) % corners.len()]);
                    (b[0] - a[0]) * (place[1] - a[1]) - (b[1] - a[1]) * (place[0] - a[0]) >= 0.0
                };
                let holds = corners.len() > 2 && (0..corners.len()).all(is_left);
                assert_eq!(holds, own == nearest);
            }
        }
    }

    #[test]
    fn shares_become_equal() {
        let grid = Grid::from_fn(level().frame, |x, _| 0.4 + 0.04 * x as f32);
        let expected: Vec<f32> = grid.values.iter().map(|value| value * 0.25).collect();
        let cells = crate::systematic(crate::Part::whole(60, 60), &expected);
        let middle = |&cell: &usize| grid.frame.center(cell % 60, cell / 60);
        let mut places: Vec<[f64; 2]> = cells.iter().map(middle).map(|(x, y)| [x, y]).collect();
        for pass in 0..10 {
            crate::relax(&mut places, &grid, &crate::Relaxation::pass(pass, 10));
        }
        let count = places.len();
        let spread = |shares: &[Share]| {
            let total: f64 = shares.iter().map(|share| share.mass).sum();
            norm(&lacking(shares, count)) / total * (count as f64).sqrt()
        };
        let mut found = Shares::new(&grid, None, count);
        let sites = found.sites(&places);
        let mesh = Mesh::new(&sites);
        let before = spread(&shares(&found.masses, &mesh, &found.weights));
        let after = [1, 2, 4].map(|steps| {
            found.weights.fill(0.0);
            spread(&found.even_out(&mesh, count, steps))
        });
        // Newton's method: each step does far better than the one before.
        assert!(before > 0.05 && after[1] < 0.01 && after[2] < 0.002, "{before} {after:?}");
    }

    #[test]
    fn few_coincident_and_unwanted_plants_are_harmless() {
        let empty = Grid::filled(level().frame, 0.0);
        for mut places in [vec![], vec![[1.0, 1.0]], vec![[1.0, 1.0]; 5], scattered(3, 2.0)] {
            let before = places.clone();
            polish(&mut places, &level(), 3);
            assert!(places.iter().flatten().all(|along| (0.0..=30.0).contains(along)));
            let mut still = before.clone();
            polish(&mut still, &empty, 3);
            assert_eq!(still, before);
        }
    }
}
