//! Trees that organize themselves by competition of their buds [Palubicki09].
//!
//! All trees lay out their buds alike; which of them become lasting branches is decided by
//! competition for space or light, and by a signal inside the tree that favours some over
//! others. A tree grows in cycles, one a year or so:
//!
//! 1. each bud learns how good its surroundings are ([`shadow`], [`markers`]);
//! 2. resource gathers at the base and is shared out to the buds ([`fate`]);
//! 3. buds with enough of it put out shoots;
//! 4. branches that gather too little for their size are shed;
//! 5. branches thicken by what they have borne.
//!
//! This file holds the parameters, [`plant`] the tree as data, [`garden`] the cycle for one
//! tree or several in one space, [`script`] the commands that change space and trees on the
//! way, and `build` makes a [`crate::Skeleton`] of the result.
//!
//! Lengths are in internodes until the finished tree is stretched to the height of its species.

mod build;
pub mod fate;
pub mod garden;
pub mod markers;
pub mod plant;
pub mod script;
pub mod shadow;

pub use garden::{Garden, Neighbor, Report};

use crate::foliage::Foliage;
use crate::skeleton::Skeleton;
use crate::volume::{Solid, defaults};
use crate::{Error, Stature};
use glam::Vec3;
use weald_contract::{Curve, Problem, Problems, Seed, Written, table, words};

words! {
    /// What buds compete for.
    pub enum Competition {
        /// Light: metamers cast shadow on voxels below them.
        Shadow = "shadow",
        /// Space: points that mark free space are used up.
        Markers = "markers",
    }
}

words! {
    /// How shadows of several metamers add up.
    pub enum ShadowModel {
        /// They add; light is what they leave of the full light.
        Additive = "additive",
        /// Each lets a part of the light through.
        Multiplicative = "multiplicative",
    }
}

words! {
    /// Where a shoot turns in the light.
    pub enum Seeking {
        /// Against the gradient of shadow.
        Gradient = "gradient",
        /// To the lightest voxel that its bud sees.
        Lightest = "lightest",
    }
}

words! {
    /// How resource is shared out.
    pub enum Fate {
        /// At each fork, by light and by a fixed bias for the main axis.
        BorchertHonda = "borchert_honda",
        /// Along each axis, by light and by rank.
        Priority = "priority",
    }
}

table! {
    /// Shadow propagation.
    pub struct Shadows {
        /// How shadows add up.
        model: ShadowModel = ShadowModel::Additive;
        /// Voxels along X, Y and Z; shoots stop at the walls.
        grid: [u32; 3] = [96, 96, 96], in 2.0..=1024.0;
        /// Side of a voxel, internodes.
        voxel: f32 = 1.5, in 0.1..=100.0;
        /// Light of a bud that nothing shades: C of the paper.
        full: f32 = 1.0, in 0.01..=100.0;
        /// Shadow in a metamer's own voxel, a of the paper; in the multiplicative model the part
        /// of light that it takes at distance 0.
        strength: f32 = 0.2, in 0.0001..=10.0;
        /// By how much shadow is weaker from layer to layer: b of the paper.
        decay: f32 = 2.0, in 1.0..=100.0;
        /// Layers below a metamer that it shades.
        depth: u32 = 6, in 0.0..=32.0;
        /// Voxels by which each layer is wider on each side than the one above.
        spread: f32 = 1.0, in 0.0..=4.0;
        /// Uneven shadow everywhere from the start, so that no two directions are quite alike.
        noise: f32 = 0.02, in 0.0..=1.0;
        /// Where shoots turn.
        seeking: Seeking = Seeking::Gradient;
        /// How far a bud sees when it seeks the lightest voxel, voxels.
        reach: u32 = 3, in 1.0..=16.0;
    }
}

table! {
    /// Space colonization.
    pub struct Markers {
        /// Markers scattered at the start.
        count: u32 = 20_000, in 0.0..=20_000_000.0;
        /// Where they are scattered; together these solids are the space of the tree.
        space: Vec<Solid> = Vec::new();
        /// Radius of the space that each bud uses up, internodes: rho of the paper.
        occupied: f32 = 2.0, in 0.01..=100.0;
        /// How far a bud sees, internodes: r of the paper.
        sight: f32 = 5.0, in 0.01..=100.0;
        /// Full opening of the cone in which a bud sees: theta of the paper.
        aperture_deg: f32 = 90.0, in 1.0..=360.0;
    }
}

table! {
    /// Weights of the priority model: from `most` for the best lit branch of an axis they fall
    /// on a line to `least`, reached at a part `span` of the list.
    pub struct Priority {
        /// Weight of the first.
        most: f32 = 1.0, in 0.0..=1000.0;
        /// Weight of the last.
        least: f32 = 0.006, in 0.0..=1000.0;
        /// Part of the list over which weights fall: kappa of the paper.
        span: f32 = 0.5, in 0.001..=1.0;
        /// Whether the tip of the axis comes first, whatever its light.
        apical_first: bool = true;
        /// Cycle from which the tip takes its place by its light.
        apical_until: Option<u32> = None;
    }
}

table! {
    /// A self-organizing tree.
    pub struct SelfOrganizing {
        /// What buds compete for.
        competition: Competition = Competition::Shadow;
        /// Shadow propagation.
        shadow: Shadows = defaults();
        /// Space colonization.
        markers: Markers = defaults();
        /// How resource is shared out.
        fate: Fate = Fate::BorchertHonda;
        /// Bias for the main axis over cycles: above 0.5 the trunk prevails.
        lambda: Curve = Curve::constant(0.5), in 0.0..=1.0;
        /// Weights of the priority model.
        priority: Priority = defaults();
        /// Resource for each unit of light, of plants of vigor 0 and 1: alpha of the paper.
        alpha: [f32; 2] = [1.2, 2.0], in 0.0..=100.0;
        /// Cycles over age in years.
        cycles: Curve = years(), in 0.0..=1000.0;
        /// How much shoots turn to free space or light, over cycles: xi of the paper.
        seek: Curve = Curve::constant(0.2), in -10.0..=10.0;
        /// How much shoots turn to `tropism_toward`, over cycles: eta of the paper.
        tropism: Curve = Curve::constant(0.05), in -10.0..=10.0;
        /// Direction of tropism: up.
        tropism_toward: Written<[f32; 3]> = up();
        /// Angle between a bud and its axis, degrees.
        branch_angle_deg: f32 = 50.0, in 0.0..=170.0;
        /// Angle about the axis from node to node, degrees.
        divergence_deg: f32 = 137.5, in -360.0..=360.0;
        /// Lateral buds at a node: 1 alternate, 2 opposite, more whorled.
        buds: u32 = 1, in 1.0..=8.0;
        /// Spread of both angles, degrees.
        jitter_deg: f32 = 6.0, in 0.0..=90.0;
        /// Cycles that a lateral bud lives without growing.
        bud_life: u32 = 5, in 1.0..=250.0;
        /// Metamers of a shoot at most.
        longest_shoot: u32 = 20, in 1.0..=1000.0;
        /// Light for each internode below which a branch is shed; 0 keeps all.
        shed: f32 = 0.0, in 0.0..=100.0;
        /// Cycles on end for which a branch must fall short before it is shed. Space is either
        /// there or not, so that with markers one bad year tells little.
        shed_after: u32 = 1, in 1.0..=250.0;
        /// Exponent n of the pipe model, d^n = sum d_i^n.
        pipe_exponent: f32 = 2.3, in 1.0..=6.0;
        /// Whether what shed branches bore still counts in the diameter.
        pipe_memory: bool = true;
        /// Metamers at which growth ends, come what may.
        most_metamers: u32 = 400_000, in 1.0..=8_000_000.0;
        /// Commands, one a line, each bound to a cycle: see [`script`].
        script: Written<String> = Default::default();
        /// Leaves on the youngest shoots.
        leaf: Foliage = defaults();
        /// Bark reflectance by order; the last is used for the orders above.
        bark: Vec<[f32; 3]> = vec![[0.15, 0.12, 0.09]], in 0.0..=0.9;
    }
}

/// One cycle a year.
fn years() -> Curve {
    Curve::new(vec![[0.0, 0.0], [1000.0, 1000.0]]).unwrap_or_else(|| Curve::constant(10.0))
}

fn up() -> Written<[f32; 3]> {
    Written { value: [0.0, 0.0, 1.0], span: Default::default() }
}

/// Most voxels of a grid: 512 million take 4 GB.
const MOST_VOXELS: u64 = 1 << 29;

impl SelfOrganizing {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        let mut problems = self.leaf.check();
        let spans = self.markers.space.iter().flat_map(Solid::check);
        problems.extend(spans);
        let voxels: u64 = self.shadow.grid.iter().map(|side| u64::from(*side)).product();
        if voxels > MOST_VOXELS {
            let what = format!("a grid of {voxels} voxels takes {} GB", voxels >> 27);
            problems.push(Problem::new(what).hint(format!("at most {MOST_VOXELS} voxels")));
        }
        if Vec3::from_array(self.tropism_toward.value).try_normalize().is_none() {
            let what = "`tropism_toward` has no direction";
            problems.push(Problem::at(self.tropism_toward.span, what).hint("up is [0, 0, 1]"));
        }
        if self.competition == Competition::Markers {
            problems.extend(self.check_markers());
        }
        if self.priority.least > self.priority.most {
            let what = "`least` of the priority model is more than `most`";
            problems.push(Problem::new(what).hint("weights fall from `most` to `least`"));
        }
        if self.bark.is_empty() {
            problems.push(Problem::new("`bark` needs a colour"));
        }
        problems.extend(script::Script::read(&self.script).err().unwrap_or_default());
        problems
    }

    fn check_markers(&self) -> Problems {
        let markers = &self.markers;
        let paints = self.script.value.contains("brush");
        let mut problems = Vec::new();
        if markers.count == 0 && !paints {
            let what = "without markers there is no space to grow in";
            problems.push(Problem::new(what).hint("set `markers.count`, or paint them by `brush`"));
        }
        if markers.count > 0 && markers.space.is_empty() {
            let what = "markers need a `space`";
            let hint =
                "for instance space = [{ shape = 'ball', center = [0, 0, 20], radius = 15 }]";
            problems.push(Problem::new(what).hint(hint));
        }
        problems
    }

    /// Grows a tree of so many years to a stature, alone in its space.
    ///
    /// # Errors
    /// A command of the script cannot be carried out.
    pub fn grow(&self, age: f32, stature: &Stature, seed: Seed) -> Result<Skeleton, Problem> {
        let cycles = self.cycles.at(age).max(1.0);
        let mut garden = Garden::new(self, &[(Vec3::ZERO, stature.vigor)], seed)?;
        garden.grow_to(cycles)?;
        let mut skeleton = garden.skeleton(0, stature.vigor);
        let up = skeleton.stretch_to(stature.height);
        let base = skeleton.nodes.first().map_or(1.0, |node| node.radius);
        skeleton.stretch(up, up, stature.stem_radius / base.max(f32::MIN_POSITIVE));
        self.leaf.dress(&mut skeleton, &garden.twigs(0, up), stature.vigor, seed);
        Ok(skeleton)
    }
}

impl From<Error> for Problem {
    fn from(error: Error) -> Self {
        match error {
            Error::Problem(problem) => problem,
            other => Problem::new(other.to_string()),
        }
    }
}

#[cfg(test)]
mod tests;
