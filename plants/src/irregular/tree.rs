//! From level to level: graphs around endpoints, and the tree that their paths make.

use super::graph::{Graph, NOTHING};
use super::nodes::Scatter;
use super::paths::{Paths, Weights};
use super::refine::First;
use super::space::{Space, Unit};
use super::{Aging, Heading, Irregular, Layout, Sizes, Stage};
use crate::frame::{any_normal, frame_of};
use glam::{Quat, Vec3};
use std::collections::BTreeMap;
use weald_contract::{Problem, Seed, Stream};

/// Nodes of the paths and how they hang together.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tree {
    /// Places, in units of the form; the first is the root.
    pub places: Vec<Vec3>,
    /// The node that bears each, which stands before it; of the root, itself.
    pub parents: Vec<u32>,
    /// Runs of nodes that came from one graph.
    pub patches: Vec<Patch>,
    /// Where paths end.
    pub endpoints: Vec<Endpoint>,
    /// How it went.
    pub report: Report,
}

/// The nodes that came from one graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Patch {
    /// The first of them; the last is the one before the next patch begins.
    pub first: u32,
    /// Chance of this graph, and its name: the same whatever grows elsewhere.
    pub seed: Seed,
}

/// Where a path ends, and perhaps the next graph begins.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Endpoint {
    /// Node of the tree.
    pub node: u32,
    /// Level of the graph that it belongs to, from 1.
    pub level: u32,
    /// What is left of its life; nothing grows from it when that is 0.
    pub lifespan: u32,
    /// Part of the branches that its graph bears.
    pub share: f32,
    /// From the root of its graph to here, unit.
    pub outward: Vec3,
    /// Chance of what grows from it.
    seed: Seed,
}

/// What was grown.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Report {
    /// Graphs made.
    pub graphs: u64,
    /// Nodes of all graphs.
    pub nodes: u64,
    /// Edges of all graphs.
    pub edges: u64,
    /// Endpoints of each level.
    pub endpoints: Vec<u64>,
    /// Endpoints drawn again because no path led to the first choice.
    pub redrawn: u64,
    /// Endpoints that were wanted and found no place.
    pub lost: u64,
    /// Most bytes held at once by graphs, paths and tree.
    pub bytes: usize,
}

impl Report {
    /// Endpoints of all levels.
    pub fn endpoints_in_all(&self) -> u64 {
        self.endpoints.iter().sum()
    }

    fn count(&mut self, level: u32, endpoints: usize) {
        let level = level as usize - 1;
        if self.endpoints.len() <= level {
            self.endpoints.resize(level + 1, 0);
        }
        self.endpoints[level] += endpoints as u64;
    }
}

/// Nodes among which endpoints are drawn, and how many.
pub(super) struct Pool {
    pub(super) nodes: Vec<u32>,
    pub(super) wanted: usize,
}

/// From the coordinates of a graph to those of the tree.
#[derive(Clone, Copy)]
pub(super) struct Place {
    pub(super) origin: Vec3,
    pub(super) rotation: Quat,
    pub(super) scale: f32,
}

impl Place {
    pub(super) const HERE: Self = Self { origin: Vec3::ZERO, rotation: Quat::IDENTITY, scale: 1.0 };

    #[inline]
    fn of(&self, p: Vec3) -> Vec3 {
        self.origin + self.rotation * (p * self.scale)
    }
}

/// Where endpoints of a graph come from.
#[derive(Clone, Copy)]
pub(super) struct Bearer {
    pub(super) level: u32,
    pub(super) lifespan: u32,
    pub(super) seed: Seed,
}

/// A tree while it grows. Graph and paths are used again and again.
pub(super) struct Grower<'a> {
    pub(super) form: &'a Irregular,
    pub(super) stages: Vec<Stage<'a>>,
    pub(super) tree: Tree,
    pub(super) graph: Graph,
    pub(super) paths: Paths,
    pub(super) weights: Weights,
    /// Node of the tree that each node of the graph has become.
    pub(super) in_tree: Vec<u32>,
    filling: f32,
    /// Height above which nothing grows: the ground, of roots.
    pub(super) ceiling: f32,
    /// Volumes of the shapes of further graphs.
    units: BTreeMap<(u32, u32), Unit>,
    walk: Vec<u32>,
    pool: Vec<Pool>,
}

/// Grows the tree above the ground.
pub(super) fn grow(form: &Irregular, filling: f32, seed: Seed) -> Result<Tree, Problem> {
    let mut grower = Grower::new(form, form.stages(), filling);
    grower.first(seed)?;
    grower.further();
    Ok(grower.tree)
}

impl<'a> Grower<'a> {
    pub(super) fn new(form: &'a Irregular, stages: Vec<Stage<'a>>, filling: f32) -> Self {
        let weights = Weights::new(form.least_weight, form.irregularity, form.guide);
        let (tree, graph, paths) = Default::default();
        let (in_tree, units, walk, pool) = Default::default();
        let ceiling = f32::INFINITY;
        Self {
            form,
            stages,
            tree,
            graph,
            paths,
            weights,
            in_tree,
            filling,
            ceiling,
            units,
            walk,
            pool,
        }
    }

    /// The first graph and its paths.
    fn first(&mut self, seed: Seed) -> Result<(), Problem> {
        let form = self.form;
        let first = First::of(form, seed);
        let root = Vec3::from_array(form.root.value);
        let mut given = vec![root];
        given.extend(&first.joints);
        let by_hand = given.len();
        given.extend(form.endpoints.value.iter().map(|p| Vec3::from_array(*p)));
        self.make(&first.space, form.nodes, &given, Place::HERE, seed);
        self.tree.places.push(root);
        self.tree.parents.push(0);
        let source = self.graph.index_of(0);
        self.in_tree[source as usize] = 0;
        let fixed: Vec<u32> = (by_hand..given.len()).map(|at| self.graph.index_of(at)).collect();
        let taken: Vec<u32> = (0..given.len()).map(|at| self.graph.index_of(at)).collect();
        let mut pools = self.pools(&first, &taken, seed);
        let found = self.draw(&[source], &fixed, &mut pools, &mut seed.stream("endpoints", 0));
        if let Some(at) = fixed.iter().position(|node| !self.paths.has_reached(*node)) {
            let what = format!("no path leads from the root to endpoint {}", at + 1);
            let hint = "widen the volume between them, or give the graph more `nodes`";
            return Err(Problem::at(form.endpoints.span, what).hint(hint));
        }
        if found.is_empty() {
            let what = format!(
                "no path leads from the root to any endpoint in a graph of {} nodes",
                self.graph.nodes.places.len()
            );
            let hint = "let trunk and crown overlap, widen the trunk, or give it more `nodes`";
            return Err(Problem::new(what).hint(hint));
        }
        let lifespan = self.form.lifespan.first.unwrap_or(self.stages.len() as u32 + 1);
        self.attach(&found, Place::HERE, Bearer { level: 1, lifespan, seed });
        Ok(())
    }

    /// The nodes that endpoints are drawn from, by crown.
    fn pools(&self, first: &First<'_>, taken: &[u32], seed: Seed) -> Vec<Pool> {
        let form = self.form;
        let crowns = first.crowns.len();
        let wanted = self.filled(form.branches as f32, &mut seed.stream("count", 0));
        let wanted = if form.branches == 0 { 0 } else { wanted };
        let nodes = &self.graph.nodes;
        let pool = |crown: usize| {
            let part = first.part_of_crown(crown);
            let is_good = |node: &u32| {
                let at = *node as usize;
                (part.is_none() || nodes.parts.get(at).copied() == part)
                    && first.allows(crown, nodes.places[at], form.shell)
                    && !taken.contains(node)
            };
            let share = wanted / crowns + usize::from(crown < wanted % crowns);
            let all = 0..nodes.places.len() as u32;
            Pool { nodes: all.filter(is_good).collect(), wanted: share }
        };
        (0..crowns).map(pool).collect()
    }

    /// All levels beyond the first.
    pub(super) fn further(&mut self) {
        let mut fresh = 0;
        for index in 0..self.stages.len() {
            let is_last = index + 1 == self.stages.len();
            let from_all = is_last && self.form.final_from_all;
            let all = self.tree.endpoints.len();
            self.endow(fresh..all);
            for at in if from_all { 0 } else { fresh }..all {
                let endpoint = self.tree.endpoints[at];
                if endpoint.lifespan > 0 || from_all {
                    self.subgraph(
                        endpoint,
                        if from_all { index } else { self.stage(index, endpoint) },
                    );
                }
            }
            fresh = all;
        }
    }

    /// The stage whose graph an endpoint bears.
    fn stage(&self, index: usize, endpoint: Endpoint) -> usize {
        match self.form.lifespan.sizes {
            Sizes::Level => index,
            Sizes::Lifespan => self.stages.len().saturating_sub(endpoint.lifespan as usize),
        }
    }

    /// Gives endpoints of a level their part of life and branches by how they face the light.
    fn endow(&mut self, range: std::ops::Range<usize>) {
        let Some(light) = &self.form.light else { return };
        let toward = Vec3::from_array(light.toward.value).normalize_or(Vec3::Z);
        let endpoints = &mut self.tree.endpoints[range.clone()];
        let mut order: Vec<usize> = (0..endpoints.len()).collect();
        let facing = |at: &usize| -endpoints[*at].outward.dot(toward);
        order.sort_by(|a, b| facing(a).total_cmp(&facing(b)));
        let Some(first) = endpoints.first() else { return };
        let mut stream = first.seed.stream("light", range.start as u64);
        if let Some([least, most]) = light.branches {
            let draw = |_| stream.range(f64::from(least), f64::from(most)) as f32;
            let mut shares: Vec<f32> = (0..order.len()).map(draw).collect();
            shares.sort_by(|a, b| b.total_cmp(a));
            order.iter().zip(shares).for_each(|(at, share)| endpoints[*at].share = share);
        }
        if let Some([least, most]) = light.loss {
            let span = u64::from(most.saturating_sub(least)) + 1;
            let draw = |_| least + stream.below(span) as u32;
            let mut losses: Vec<u32> = (0..order.len()).map(draw).collect();
            losses.sort_unstable();
            for (at, loss) in order.iter().zip(losses) {
                // What was left before one was taken for the level.
                let left = endpoints[*at].lifespan + 1;
                endpoints[*at].lifespan = left.saturating_sub(loss);
            }
        }
    }

    /// The graph around an endpoint, and its paths.
    fn subgraph(&mut self, endpoint: Endpoint, index: usize) {
        let Stage { level, radius } = self.stages[index];
        let seed = endpoint.seed.part("graph", index as u64);
        let mut stream = seed.stream("heading", 0);
        let heading = turned(level, endpoint.outward, &mut stream);
        let key = (level.shape as u32, level.half_angle_deg.to_bits());
        let unit = *self
            .units
            .entry(key)
            .or_insert_with(|| Unit::new(level.shape, level.half_angle_deg.to_radians()));
        let place = Place {
            origin: self.tree.places[endpoint.node as usize],
            rotation: frame_of(heading, any_normal(heading)),
            scale: radius,
        };
        self.make(&Space::Unit(unit), level.nodes, &[Vec3::ZERO], place, seed);
        let source = self.graph.index_of(0);
        self.in_tree[source as usize] = endpoint.node;
        let wanted = self.filled(level.branches as f32 * endpoint.share, &mut stream);
        let mut pools = std::mem::take(&mut self.pool);
        pools.resize_with(1, || Pool { nodes: Vec::new(), wanted: 0 });
        let places = &self.graph.nodes.places;
        let is_good = |node: &u32| {
            *node != source && places[*node as usize].length_squared() >= level.from * level.from
        };
        pools[0].nodes.clear();
        pools[0].nodes.extend((0..places.len() as u32).filter(is_good));
        pools[0].wanted = wanted;
        let found = self.draw(&[source], &[], &mut pools, &mut seed.stream("endpoints", 0));
        self.pool = pools;
        let bearer = Bearer { level: index as u32 + 2, lifespan: endpoint.lifespan, seed };
        self.attach(&found, place, bearer);
    }

    /// Branches of a plant that fills a part of them: whole numbers that are right on average.
    fn filled(&self, branches: f32, stream: &mut Stream) -> usize {
        let filled = branches * self.filling.min(1.0);
        // What lacks a rounding error to a whole number is one.
        (filled + 1e-4 + stream.unit() as f32 * 0.9998).floor().max(1.0) as usize
    }

    /// Scatters and joins the nodes of a graph; what is given comes first.
    pub(super) fn make(
        &mut self,
        space: &Space<'_>,
        nodes: u32,
        given: &[Vec3],
        place: Place,
        seed: Seed,
    ) {
        let form = self.form;
        let volume = space.volume(&mut seed.stream("volume", 0));
        let pitch = libm::cbrt(volume / f64::from(nodes)) as f32;
        let count = nodes as usize + given.len();
        let scattered = &mut self.graph.nodes;
        let mut stream = seed.stream("nodes", 0);
        match form.layout {
            Layout::Lattice => scattered.lattice(space, pitch, given),
            Layout::Poisson => {
                let how = Scatter { count, apart: form.spacing * pitch };
                let (ceiling, obstacles) = (self.ceiling, &form.obstacle);
                let is_everywhere = obstacles.is_empty() && ceiling == f32::INFINITY;
                scattered.scatter(space, &how, given, &mut stream, |p| {
                    is_everywhere || {
                        let p = place.of(p);
                        p.z <= ceiling && !obstacles.iter().any(|solid| solid.contains(p))
                    }
                });
            }
        }
        let scattering = self.graph.bytes();
        if count > 10_000 {
            self.graph.nodes.let_go();
        }
        let edges = self.graph.join(form.links, pitch, form.link * pitch, space);
        let count = self.graph.nodes.places.len();
        self.in_tree.clear();
        self.in_tree.resize(count, NOTHING);
        self.weights.seed = seed.0;
        let toward = Vec3::from_array(form.guide_toward.value).normalize_or(Vec3::Z);
        self.weights.toward = place.rotation.inverse() * toward;
        let report = &mut self.tree.report;
        report.graphs += 1;
        report.nodes += count as u64;
        report.edges += edges;
        report.bytes = report.bytes.max(scattering);
    }

    /// Draws endpoints from pools and finds the paths from the sources to them and to `fixed`.
    ///
    /// Those that no path leads to are drawn again from what can be reached.
    pub(super) fn draw(
        &mut self,
        sources: &[u32],
        fixed: &[u32],
        pools: &mut [Pool],
        stream: &mut Stream,
    ) -> Vec<u32> {
        let mut drawn = fixed.to_vec();
        for Pool { nodes, wanted } in pools.iter_mut() {
            let count = (*wanted).min(nodes.len());
            (0..count).for_each(|at| shuffle(nodes, at, stream));
            drawn.extend(&nodes[..count]);
            self.tree.report.lost += (*wanted - count) as u64;
        }
        let reached = self.paths.find(&self.graph, &self.weights, sources, &drawn);
        if reached == drawn.len() {
            return drawn;
        }
        drawn.truncate(fixed.len());
        drawn.retain(|node| self.paths.has_reached(*node));
        for Pool { nodes, wanted } in pools.iter_mut() {
            let mut found = 0;
            for at in 0..nodes.len() {
                if found == *wanted {
                    break;
                }
                if at >= *wanted {
                    shuffle(nodes, at, stream);
                }
                if self.paths.has_reached(nodes[at]) {
                    drawn.push(nodes[at]);
                    found += 1;
                    self.tree.report.redrawn += u64::from(at >= *wanted);
                }
            }
            self.tree.report.lost += ((*wanted).min(nodes.len()) - found) as u64;
        }
        drawn
    }

    /// Adds the paths to endpoints to the tree, and the endpoints.
    pub(super) fn attach(&mut self, ends: &[u32], place: Place, bearer: Bearer) {
        self.tree.patches.push(Patch { first: self.tree.places.len() as u32, seed: bearer.seed });
        let mut stream = bearer.seed.stream("life", 0);
        for (ordinal, end) in ends.iter().enumerate() {
            let source = self.add_path(*end, place);
            let root = self.tree.places[source as usize];
            let node = self.in_tree[*end as usize];
            let outward = (self.tree.places[node as usize] - root).normalize_or(Vec3::Z);
            let lifespan = self.aged(bearer.lifespan, &mut stream);
            let seed = bearer.seed.part("end", ordinal as u64);
            let (level, share) = (bearer.level, 1.0);
            self.tree.endpoints.push(Endpoint { node, level, lifespan, share, outward, seed });
        }
        self.tree.report.count(bearer.level, ends.len());
        let tree = 16 * self.tree.places.capacity()
            + size_of::<Endpoint>() * self.tree.endpoints.capacity()
            + size_of::<Patch>() * self.tree.patches.capacity();
        let all = tree + self.graph.bytes() + self.paths.bytes() + 4 * self.in_tree.capacity();
        self.tree.report.bytes = self.tree.report.bytes.max(all);
    }

    /// Adds what is new of the path to a node; returns the node of the tree where the path began.
    fn add_path(&mut self, end: u32, place: Place) -> u32 {
        self.walk.clear();
        let mut node = end;
        while self.in_tree[node as usize] == NOTHING {
            self.walk.push(node);
            node = self.paths.before[node as usize];
        }
        let mut parent = self.in_tree[node as usize];
        while let Some(node) = self.walk.pop() {
            let new = self.tree.places.len() as u32;
            self.tree.places.push(place.of(self.graph.nodes.places[node as usize]));
            self.tree.parents.push(parent);
            self.in_tree[node as usize] = new;
            parent = new;
        }
        // On from there to the source, which alone has nothing before it.
        while self.paths.before[node as usize] != NOTHING {
            node = self.paths.before[node as usize];
        }
        self.in_tree[node as usize]
    }

    /// The lifespan of what grows from something with this one.
    fn aged(&self, lifespan: u32, stream: &mut Stream) -> u32 {
        let by_chance = self.form.lifespan.aging == Aging::Random;
        let loss = match by_chance {
            true if stream.unit() < f64::from(self.form.lifespan.end) => lifespan,
            // Something is left, if it is only enough for one level.
            true if lifespan > 1 => 1 + stream.below(u64::from(lifespan) - 1) as u32,
            _ => 1,
        };
        lifespan.saturating_sub(loss)
    }
}

/// One step of Fisher and Yates: puts a random one of the entries from `at` on at `at`.
fn shuffle(nodes: &mut [u32], at: usize, stream: &mut Stream) {
    let other = at + stream.below((nodes.len() - at) as u64) as usize;
    nodes.swap(at, other);
}

/// Where a further graph points.
fn turned(level: &super::Level, outward: Vec3, stream: &mut Stream) -> Vec3 {
    let heading = match level.heading {
        Heading::Outward => outward,
        Heading::Fixed => Vec3::from_array(level.toward.value).normalize_or(Vec3::Z),
        Heading::Random => {
            let z = stream.range(-1.0, 1.0);
            let (sin, cos) = libm::sincos(stream.range(0.0, std::f64::consts::TAU));
            let across = (1.0 - z * z).max(0.0).sqrt();
            Vec3::new((across * cos) as f32, (across * sin) as f32, z as f32)
        }
    };
    let flat = heading.truncate().length();
    if level.rotate_deg == 0.0 || flat < 1e-5 {
        return heading;
    }
    let quarter = std::f32::consts::FRAC_PI_2;
    let rise = libm::atan2f(heading.z, flat) + level.rotate_deg.to_radians();
    let (sin, cos) = libm::sincosf(rise.clamp(-quarter, quarter));
    let side = heading.truncate() / flat * cos.max(0.0);
    side.extend(sin)
}
