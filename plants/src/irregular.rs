//! Irregular trees by least-cost paths through random graphs [Xu12].
//!
//! Nodes are scattered in a volume and joined to their neighbours by edges of random cost. The
//! cheapest paths from some of them, the endpoints, to the root make a tree, whose branches are
//! crooked because chance made straight ways dear. Around every endpoint a smaller graph is made,
//! which carries the tree on; and so on for a few levels.
//!
//! This file holds the parameters; [`space`] says where nodes may be, [`nodes`] scatters them,
//! [`graph`] joins them, [`paths`] finds the ways, [`tree`] goes from level to level, `roots` does
//! the same below the ground, and `build` makes a [`crate::Skeleton`] with thick and thin wood.
//!
//! Lengths are in units of the form's own until the finished tree is stretched to the height of
//! its species.
//!
//! # Where this departs from the paper
//! - The paper's text has the direction of a further graph point from its root back to the one
//!   before, its pseudocode the other way; the pseudocode is right.
//! - Sectors of the Yao graph in space are not given. They are the faces of a cube here, or the
//!   octants. A sector in which nobody is near is followed for two to three spacings only, unless
//!   its node would stand alone, and edges longer than two must have their middle in the volume:
//!   trunk and crown are else joined through the air.
//! - "Random" weights are `least + (1 - least) * chance^irregularity` times the length.
//! - Thickness `w = s^zeta` is multiplied so that the trunk's base has the radius asked for. As
//!   `w` only grows with `s`, the longest way to an endpoint of each level gives it: one sweep
//!   over the tree for each exponent instead of a walk from each endpoint.
//! - Dart throwing ends when it has missed thirty times for each node wanted.
//! - An endpoint that no path leads to is drawn again; [`Report`] tells how many were.
//! - Which branches face the light is told by the way from a graph's root to its endpoint, before
//!   it is turned.
//! - Random lifespans fall by a whole number from 1 to what is left less 1.
//! - Between the joint of a subvolume and the trunk nobody asks for a part; the joint is a node.
//! - `guide` makes growth against a direction dear, an idea of the authors' later work [Xu15] in its
//!   simplest form.

mod build;
mod cells;
pub mod graph;
pub mod nodes;
pub mod paths;
mod refine;
mod roots;
pub mod space;
pub mod tree;

pub use tree::{Report, Tree};

use nodes::CLOSENESS;

use crate::Stature;
use crate::foliage::Foliage;
use crate::presence::filling;
use crate::skeleton::Skeleton;
use crate::volume::{self, Solid, defaults};
use glam::Vec3;
use weald_contract::{Problem, Problems, Seed, Written, table, words};

words! {
    /// How nodes are laid out.
    pub enum Layout {
        /// By chance, none too near to another.
        Poisson = "poisson",
        /// On a cubic lattice: for comparison.
        Lattice = "lattice",
    }
}

words! {
    /// Which nodes are joined.
    pub enum Links {
        /// The nearest in each of six sectors, the faces of a cube.
        Yao = "yao",
        /// The nearest in each octant.
        Octants = "octants",
        /// All within `link` times the spacing.
        Threshold = "threshold",
    }
}

words! {
    /// The shape of a further graph; its root is at the narrow end, or where it says.
    pub enum Shape {
        /// The part of a ball within the half angle; 180 degrees give the whole.
        Sector = "sector",
        /// A cone that narrows outwards, its root in the middle of its base.
        Cone = "cone",
        /// A cone that widens outwards from its root.
        InvertedCone = "inverted_cone",
        /// An egg with its root at one end.
        Ellipsoid = "ellipsoid",
    }
}

words! {
    /// Where a further graph points.
    pub enum Heading {
        /// On from the root of the graph before through the endpoint.
        Outward = "outward",
        /// Anywhere.
        Random = "random",
        /// To `toward`.
        Fixed = "fixed",
    }
}

words! {
    /// How lifespans fall from level to level.
    pub enum Aging {
        /// By one.
        Fixed = "fixed",
        /// By chance: some branches end, the others lose a random part.
        Random = "random",
    }
}

words! {
    /// What says which level's graph an endpoint bears.
    pub enum Sizes {
        /// How many levels came before it.
        Level = "level",
        /// How much of its life is left: those soon to end bear the last and smallest.
        Lifespan = "lifespan",
    }
}

table! {
    /// A level beyond the first: a graph around each endpoint of the level before.
    pub struct Level {
        /// Endpoints in each graph: b of the paper.
        branches: u32, in 1.0..=100000.0;
        /// How many levels like this follow each other.
        repeat: u32 = 1, in 1.0..=64.0;
        /// Nodes in each graph: k of the paper.
        nodes: u32 = 120, in 4.0..=1000000.0;
        /// Shape.
        shape: Shape = Shape::Sector;
        /// Half of the opening: alpha of the paper. A cone is as wide at its base as a sector of
        /// this angle would be, an ellipsoid in its middle as a cone there.
        half_angle_deg: f32 = 54.0, in 1.0..=180.0;
        /// Size of the graph: r of the paper. By default that of the level before, shrunk.
        radius: Option<f32> = None, in 1e-6..=1e6;
        /// Part of the radius around the root without endpoints.
        from: f32 = 0.0, in 0.0..=0.95;
        /// Where it points.
        heading: Heading = Heading::Outward;
        /// Direction of a fixed heading: up.
        toward: Written<[f32; 3]> = up();
        /// Angle by which the heading is turned upwards, or downwards if negative; it stops at the
        /// vertical.
        rotate_deg: f32 = 0.0, in -180.0..=180.0;
        /// Exponent of thickness over the way to this level's endpoints: zeta of the paper.
        thickness: f32 = 0.6, in 0.0..=3.0;
    }
}

table! {
    /// Balls that the crown is made of instead of its solids, each joined to the trunk by a cone
    /// of its own: clusters of branches with gaps between.
    pub struct Refine {
        /// Balls wanted.
        count: u32 = 7, in 1.0..=200.0;
        /// Radius of a ball; by default what fills the crown loosely.
        radius: Option<f32> = None, in 1e-6..=1e6;
    }
}

table! {
    /// How long branches go on.
    pub struct Lifespan {
        /// How lifespans fall.
        aging: Aging = Aging::Fixed;
        /// Lifespan of the tree; by default its levels.
        first: Option<u32> = None, in 1.0..=64.0;
        /// Part of the branches that end at each level, where chance decides.
        end: f32 = 0.3, in 0.0..=1.0;
        /// What says which graph an endpoint bears.
        sizes: Sizes = Sizes::Level;
    }
}

table! {
    /// What light changes: the branches of a level are sorted by their angle to it, and those
    /// that face it get the most. Wind from one side works the same.
    pub struct Light {
        /// Direction of the light.
        toward: Written<[f32; 3]> = up();
        /// Part of `branches` that those turned away and those in the light bear.
        branches: Option<[f32; 2]> = None, in 0.0..=20.0;
        /// Loss of lifespan of those in the light and those turned away.
        loss: Option<[u32; 2]> = None, in 1.0..=64.0;
    }
}

table! {
    /// Roots below the ground, by the same method.
    pub struct Roots {
        /// Nodes of the first graph.
        nodes: u32 = 3000, in 4.0..=5000000.0;
        /// How far it reaches.
        radius: f32, in 1e-6..=1e6;
        /// Half of its opening around straight down: 90 fills the half ball below the ground.
        half_angle_deg: f32 = 90.0, in 5.0..=90.0;
        /// Taproots: one goes straight down, more spread.
        taproots: u32 = 1, in 1.0..=100.0;
        /// Roots that begin on the taproots.
        laterals: u32 = 20, in 0.0..=10000.0;
        /// How far from a taproot the laterals reach, as part of the radius.
        around: f32 = 0.4, in 0.01..=2.0;
        /// Radius at the stem over that of the stem.
        girth: f32 = 0.7, in 0.01..=2.0;
        /// Exponent of thickness of the first level.
        thickness: f32 = 0.7, in 0.0..=3.0;
        /// Further levels.
        level: Vec<Level> = Vec::new();
        /// Size of the graphs of the first further level, by default a third of `radius`.
        subradius: Option<f32> = None, in 1e-6..=1e6;
    }
}

table! {
    /// A tree of least-cost paths.
    pub struct Irregular {
        /// Solids of the trunk, in which no endpoints lie.
        trunk: Vec<Solid> = Vec::new();
        /// Solids of the crown.
        crown: Vec<Solid>;
        /// Where the tree stands: a place in trunk or crown.
        root: Written<[f32; 3]> = Written { value: [0.0; 3], span: Default::default() };
        /// Nodes of the first graph: K of the paper.
        nodes: u32 = 3000, in 4.0..=5000000.0;
        /// Endpoints of the first graph: b of the paper.
        branches: u32 = 12, in 0.0..=1000000.0;
        /// Endpoints placed by hand, besides.
        endpoints: Written<Vec<[f32; 3]>> = Default::default();
        /// Depth below the surface of the crown (of sectors, the round one) down to which endpoints
        /// lie; by default anywhere.
        shell: Option<f32> = None, in 0.0..=1e6;
        /// Balls that the crown is made of; its endpoints are shared out evenly among them.
        refine: Option<Refine> = None;
        /// Where no node may be.
        obstacle: Vec<Solid> = Vec::new();
        /// How nodes are laid out.
        layout: Layout = Layout::Poisson;
        /// Least distance of two nodes over the side of the cube that each has for itself: d of the
        /// paper. Above 0.9 the volume is full before all nodes are in it.
        spacing: f32 = CLOSENESS, in 0.05..=1.0;
        /// Which nodes are joined.
        links: Links = Links::Yao;
        /// How far a threshold joins, in spacings: cube roots of the volume of a node.
        link: f32 = 1.6, in 0.1..=10.0;
        /// Least weight of an edge relative to its length.
        least_weight: f32 = 0.1, in 0.0..=1.0;
        /// Power of chance in the weights: 0 gives the straightest ways, more makes them crooked.
        irregularity: f32 = 1.0, in 0.0..=20.0;
        /// How much growing against `guide_toward` costs: 1 doubles the length.
        guide: f32 = 0.0, in 0.0..=100.0;
        /// Direction in which growing costs least: up.
        guide_toward: Written<[f32; 3]> = up();
        /// Size of the graphs of the second level; by default 0.4 of the crown's half width.
        radius: Option<f32> = None, in 1e-6..=1e6;
        /// Size of a graph over that of the level before: a of the paper.
        shrink: f32 = 0.7, in 0.05..=2.0;
        /// Levels beyond the first.
        level: Vec<Level> = Vec::new();
        /// Whether the last level's graphs stand around the endpoints of all levels.
        final_from_all: bool = false;
        /// How long branches go on.
        lifespan: Lifespan = defaults();
        /// What light changes.
        light: Option<Light> = None;
        /// Roots below the ground.
        roots: Option<Roots> = None;
        /// Exponent of thickness over the way to the first level's endpoints: zeta of the paper.
        thickness: f32 = 0.8, in 0.0..=3.0;
        /// Length of way that counts as 1 in the power of thickness.
        thickness_unit: f32 = 1.0, in 1e-6..=1e6;
        /// Whether the crown is stretched to the radius of its species.
        fit_crown: bool = false;
        /// How the number of branches follows the part of the mature height.
        filling_exponent: f32 = 0.3, in 0.0..=3.0;
        /// Part of the branches that a plant without vigor keeps.
        starved: f32 = 0.75, in 0.0..=1.0;
        /// Part of the longest way from tip to root over which wood bears leaves, from the tips.
        leafy: f32 = 0.06, in 0.0..=1.0;
        /// Leaves.
        leaf: Foliage = defaults();
        /// Bark reflectance by order; the last is used for the orders above.
        bark: Vec<[f32; 3]> = vec![[0.15, 0.12, 0.09]], in 0.0..=0.9;
    }
}

fn up() -> Written<[f32; 3]> {
    Written { value: [0.0, 0.0, 1.0], span: Default::default() }
}

/// Levels at most.
const MOST_LEVELS: usize = 64;

/// Endpoints and nodes of all graphs at most: a tree of that size takes minutes and gigabytes.
const MOST_ENDPOINTS: f64 = 1e7;
const MOST_NODES: f64 = 3e8;

/// A level beyond the first, with its size.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stage<'a> {
    pub(crate) level: &'a Level,
    pub(crate) radius: f32,
}

/// All further levels, one after another; the first has `radius` unless it names its own.
pub(crate) fn stages(levels: &[Level], radius: f32, shrink: f32) -> Vec<Stage<'_>> {
    let mut stages: Vec<Stage<'_>> = Vec::new();
    let each = levels.iter().flat_map(|level| (0..level.repeat).map(move |turn| (level, turn)));
    for (level, turn) in each.take(MOST_LEVELS) {
        let next = stages.last().map_or(radius, |stage| stage.radius * shrink);
        let radius = level.radius.filter(|_| turn == 0).unwrap_or(next);
        stages.push(Stage { level, radius });
    }
    stages
}

impl Irregular {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        let mut problems = self.leaf.check();
        let roots = self.roots.iter().flat_map(|roots| &roots.level);
        let solids = [&self.trunk, &self.crown, &self.obstacle];
        problems.extend(solids.into_iter().flatten().flat_map(Solid::check));
        problems.extend(self.level.iter().chain(roots).flat_map(Level::check));
        self.check_numbers(&mut problems);
        for (name, direction) in [
            ("guide_toward", Some(&self.guide_toward)),
            ("toward", self.light.as_ref().map(|light| &light.toward)),
        ] {
            problems.extend(direction.and_then(|direction| no_direction(name, direction)));
        }
        if self.crown.is_empty() {
            let hint = "for instance { shape = 'ball', center = [0, 0, 8], radius = 5 }";
            problems.push(Problem::new("`crown` needs a solid").hint(hint));
        } else if problems.is_empty() {
            problems.extend(self.outside("the root", self.root.span, self.root.value));
            for (index, place) in self.endpoints.value.iter().enumerate() {
                let what = format!("endpoint {}", index + 1);
                problems.extend(self.outside(&what, self.endpoints.span, *place));
            }
        }
        problems
    }

    fn check_numbers(&self, problems: &mut Problems) {
        let wanted = self.branches as usize + self.endpoints.value.len();
        if wanted == 0 {
            let hint = "set `branches`, or place `endpoints`";
            problems.push(Problem::new("a tree needs an endpoint").hint(hint));
        }
        if wanted >= self.nodes as usize {
            let what = format!("{wanted} endpoints in a graph of {} nodes", self.nodes);
            problems.push(Problem::new(what).hint("give it more `nodes`, or fewer `branches`"));
        }
        if self.bark.is_empty() {
            problems.push(Problem::new("`bark` needs a colour"));
        }
        let levels: usize = self.level.iter().map(|level| level.repeat as usize).sum();
        if levels > MOST_LEVELS {
            let what = format!("{levels} levels; at most {MOST_LEVELS} are grown");
            problems.push(Problem::new(what));
        }
        let (endpoints, nodes) = self.estimate();
        if endpoints > MOST_ENDPOINTS || nodes > MOST_NODES {
            let what = format!("the tree would have {endpoints:.0} endpoints and {nodes:.0} nodes");
            let most = format!("at most {MOST_ENDPOINTS:.0} and {MOST_NODES:.0} are grown");
            problems.push(Problem::new(what).hint(most));
        }
    }

    /// Endpoints and graph nodes of a full-grown tree in which no branch ends early.
    pub fn estimate(&self) -> (f64, f64) {
        let mut last = f64::from(self.branches) + self.endpoints.value.len() as f64;
        let (mut endpoints, mut nodes) = (last, f64::from(self.nodes));
        let stages = self.stages();
        for (index, Stage { level, .. }) in stages.iter().enumerate() {
            let is_final = self.final_from_all && index + 1 == stages.len();
            let bearers = if is_final { endpoints } else { last };
            nodes += bearers * f64::from(level.nodes);
            last = bearers * f64::from(level.branches);
            endpoints += last;
        }
        (endpoints, nodes)
    }

    fn outside(&self, what: &str, span: weald_contract::Span, place: [f32; 3]) -> Option<Problem> {
        let place = Vec3::from_array(place);
        let all = || self.trunk.iter().chain(&self.crown);
        let bounds = all().fold(volume::Bounds::NONE, |sum, solid| sum.with(solid.bounds()));
        let allowed = 1e-3 * (bounds.high - bounds.low).length();
        let off = all().map(|solid| solid.distance(place)).fold(f32::INFINITY, f32::min);
        // Written so that a distance that is no number counts as outside.
        let is_inside = off <= allowed;
        (!is_inside).then(|| {
            let message = format!("{what} lies {off:.3} outside of trunk and crown");
            let hint = "move it inside, or let a solid reach it";
            if span == Default::default() {
                Problem::new(message).hint(hint)
            } else {
                Problem::at(span, message).hint(hint)
            }
        })
    }

    pub(crate) fn stages(&self) -> Vec<Stage<'_>> {
        let bounds = volume::bounds(&self.crown);
        let half = 0.5 * (bounds.high - bounds.low).truncate().max_element();
        stages(&self.level, self.radius.unwrap_or(0.4 * half), self.shrink)
    }

    /// The tree above the ground in units of the form, with a part `filling` of the branches.
    ///
    /// # Errors
    /// No path leads from the root to any endpoint, or to one that was placed by hand.
    pub fn tree(&self, filling: f32, seed: Seed) -> Result<Tree, Problem> {
        tree::grow(self, filling, seed)
    }

    /// How the paths of [`Irregular::grow`] above the ground are found: what is drawn again, and
    /// what finds no place.
    ///
    /// # Errors
    /// No path leads from the root to any endpoint, or to one that was placed by hand.
    pub fn report(&self, stature: &Stature, seed: Seed) -> Result<Report, Problem> {
        Ok(self.tree(self.filling(stature), seed)?.report)
    }

    fn filling(&self, stature: &Stature) -> f32 {
        filling(stature.maturity, stature.vigor, self.filling_exponent, self.starved)
    }

    /// Grows a tree to a stature.
    ///
    /// # Errors
    /// No path leads from the root to any endpoint, or to one that was placed by hand.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Result<Skeleton, Problem> {
        let filling = self.filling(stature);
        let tree = self.tree(filling, seed)?;
        let roots = match &self.roots {
            Some(roots) => Some(roots::grow(self, roots, filling, seed)?),
            None => None,
        };
        let mut grown = build::skeleton(self, &tree, roots.as_ref(), stature.vigor);
        let skeleton = &mut grown.skeleton;
        let up = skeleton.stretch_to(stature.height);
        let reach = skeleton.reach();
        let is_fitted = self.fit_crown && reach * up > 0.02 * stature.radius;
        let across = if is_fitted { stature.radius / reach } else { up };
        skeleton.stretch(across, up, stature.stem_radius);
        for twig in &mut grown.twigs {
            let scale = Vec3::new(across, across, up);
            (twig.from, twig.to) = (twig.from * scale, twig.to * scale);
        }
        self.leaf.dress(skeleton, &grown.twigs, stature.vigor, seed);
        Ok(grown.skeleton)
    }
}

impl Level {
    fn check(&self) -> Problems {
        let mut problems = Vec::new();
        if self.shape != Shape::Sector && self.half_angle_deg > 80.0 {
            let what = format!("a {} of half angle {}", self.shape.word(), self.half_angle_deg);
            problems.push(Problem::new(what).hint("it can be at most 80 degrees"));
        }
        if self.branches >= self.nodes {
            let what = format!("{} endpoints in graphs of {} nodes", self.branches, self.nodes);
            problems.push(Problem::new(what).hint("give the level more `nodes`"));
        }
        problems.extend(no_direction("toward", &self.toward));
        problems
    }
}

fn no_direction(name: &str, direction: &Written<[f32; 3]>) -> Option<Problem> {
    let length = Vec3::from_array(direction.value).length();
    let is_fine = length > 1e-6 && length.is_finite();
    let what = format!("`{name}` must point somewhere");
    (!is_fine).then(|| Problem::at(direction.span, what))
}

#[cfg(test)]
mod tests;
