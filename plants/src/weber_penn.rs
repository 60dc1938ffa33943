//! Trees by Weber and Penn [WP95].
//!
//! A tree has up to four levels of stems; each level has its own angles, curvature, splits and
//! taper, and the last bears the leaves. This file holds the parameters, [`formula`] the
//! published equations, `stem` the shape of one stem with its clones, `tree` how stems make a
//! tree, `leaves` and `scar` what they bear.
//!
//! Where we depart from the paper:
//! - `Scale` is the height of the plant that is asked for, the trunk's radius follows the
//!   species' `[size]` unless `ratio` is given, and the finished skeleton is stretched to meet
//!   the height exactly.
//! - The parameters describe a mature tree; a smaller one fills only some of its slots for
//!   branches and leaves ([`crate::presence`]).
//! - Random numbers belong to a stem's path, not to the order of work, so the error diffused
//!   over splits and the helix of branches start anew on each stem.

pub mod formula;
mod leaves;
mod scar;
mod stem;
mod tree;

use crate::Stature;
use crate::material::LeafColor;
use crate::organ::LeafShape;
use crate::skeleton::Skeleton;
use weald_contract::{Problem, Problems, Seed, Written, table};

table! {
    /// Weber and Penn's parameters [WP95] appendix; names as there.
    pub struct WeberPenn {
        /// Envelope of the branches: 0 conical, 1 spherical, 2 hemispherical, 3 cylindrical,
        /// 4 tapered cylindrical, 5 flame, 6 inverse conical, 7 tend flame, 8 by `prune`.
        shape: u32 = 7, in 0.0..=8.0;
        /// Bare part of the trunk.
        base_size: f32 = 0.3, in 0.0..=0.98;
        /// Radius of the trunk over its length; by default the `[size]` table's stem.
        ratio: Option<f32> = None, in 0.0005..=0.5;
        /// How a child's radius follows from its length: `(length / parent length)^ratio_power`.
        ratio_power: f32 = 1.2, in 0.1..=5.0;
        /// Lobes around the trunk.
        lobes: u32 = 0, in 0.0..=24.0;
        /// Depth of the lobes relative to the radius.
        lobe_depth: f32 = 0.0, in 0.0..=0.5;
        /// Swelling of the trunk at the ground.
        flare: f32 = 0.0, in 0.0..=10.0;
        /// Stems that the trunk forks into at the end of its first segment, besides itself.
        base_splits: u32 = 0, in 0.0..=16.0;
        /// Trunks that rise from the ground, as of a shrub (ours).
        trunks: u32 = 1, in 1.0..=40.0;
        /// Lean of the trunks where there are several: mean and variation, degrees (ours).
        trunk_lean_deg: [f32; 2] = [20.0, 15.0], in -90.0..=90.0;
        /// Tendency of the higher levels to grow upwards; negative ones droop.
        attraction_up: f32 = 0.0, in -20.0..=20.0;
        /// Whether branches are lengthened or shortened to meet the crown radius asked for.
        fit_crown: bool = false;
        /// How the number of branches and leaves follows the part of the mature height.
        filling_exponent: f32 = 0.6, in 0.0..=3.0;
        /// Part of branches and leaves that a plant without vigor keeps.
        starved: f32 = 0.75, in 0.0..=1.0;
        /// Pruning envelope.
        prune: Option<Prune> = None;
        /// Levels of stems, the trunk first; one to four.
        level: Written<Vec<Level>>;
        /// Leaves.
        leaf: Leaf;
        /// Bark reflectance of each level; the last is used for the levels above.
        bark: Vec<[f32; 3]> = vec![[0.15, 0.12, 0.09]], in 0.0..=0.9;
        /// Reflectance of the scars on the trunk below its branches; none by default (ours).
        scar: Option<[f32; 3]> = None, in 0.0..=0.9;
    }
}

table! {
    /// One level of stems.
    pub struct Level {
        /// Angle from the parent: mean and variation; a negative variation changes it along
        /// the parent instead of by chance.
        down_angle_deg: [f32; 2] = [0.0, 0.0], in -360.0..=360.0;
        /// Angle about the parent from one stem to the next, and its variation; a negative
        /// angle alternates sides.
        rotate_deg: [f32; 2] = [140.0, 0.0], in -360.0..=360.0;
        /// Stems of this level on a parent.
        branches: u32 = 0, in 0.0..=1000.0;
        /// Length relative to the parent, and its variation.
        length: [f32; 2] = [1.0, 0.0], in 0.0..=5.0;
        /// 0 cylinder, 1 cone, 2 rounded tip, up to 3 beads.
        taper: f32 = 1.0, in 0.0..=3.0;
        /// New stems that a stem forks into at each of its joints.
        seg_splits: f32 = 0.0, in 0.0..=4.0;
        /// Angle between forks, and its variation.
        split_angle_deg: [f32; 2] = [0.0, 0.0], in -180.0..=180.0;
        /// Segments of a stem.
        curve_res: u32 = 3, in 1.0..=64.0;
        /// Bend of the whole stem, or of its first half if `curve_back` is not 0.
        curve_deg: f32 = 0.0, in -720.0..=720.0;
        /// Bend of the second half.
        curve_back_deg: f32 = 0.0, in -720.0..=720.0;
        /// Crookedness: spread of the bend over the whole stem; a negative one makes a helix.
        curve_v_deg: f32 = 0.0, in -720.0..=720.0;
        /// Part of the stem, from its base, that bears nothing (ours; the trunk has `base_size`).
        bare: f32 = 0.0, in 0.0..=0.95;
    }
}

table! {
    /// The leaves of the last level of stems.
    pub struct Leaf {
        /// Leaves on a stem; a negative number makes a fan at its tip.
        count: i32, in -1000.0..=1000.0;
        /// Outline.
        shape: LeafShape = LeafShape::Ovate;
        /// Length, m.
        scale: f32 = 0.1, in 0.001..=10.0;
        /// Width over length.
        scale_x: f32 = 1.0, in 0.01..=5.0;
        /// Fewer and larger leaves of the same area: 1 as given, less is coarser.
        quality: f32 = 1.0, in 0.01..=1.0;
        /// Angle from the stem, and its variation.
        down_angle_deg: [f32; 2] = [45.0, 10.0], in -360.0..=360.0;
        /// Angle about the stem from leaf to leaf, and its variation.
        rotate_deg: [f32; 2] = [140.0, 0.0], in -360.0..=360.0;
        /// Length of the stalk over that of the leaf; stalks are not drawn (ours).
        stalk: f32 = 0.0, in 0.0..=5.0;
        /// How far leaves turn their faces to the light, 0 to 1.
        bend: f32 = 0.3, in 0.0..=1.0;
        /// How far leaves hang from their stalks, 0 to 1 (ours).
        droop: f32 = 0.0, in 0.0..=1.0;
        /// Spread of size, relative (ours).
        scale_v: f32 = 0.15, in 0.0..=0.9;
        /// Rise of the margin over the midrib, relative to length (ours).
        fold: f32 = 0.12, in 0.0..=1.0;
        /// Kinds of leaves that differ in colour (ours).
        hues: u32 = 3, in 1.0..=8.0;
        /// Colour.
        color: LeafColor = LeafColor::default();
    }
}

table! {
    /// The envelope that stems are shortened to fit [WP95] §4.6.
    pub struct Prune {
        /// How far stems obey, 0 to 1.
        ratio: f32 = 1.0, in 0.0..=1.0;
        /// Width of the envelope relative to the height.
        width: f32 = 0.5, in 0.0..=5.0;
        /// Where it is widest, as part of the crown's height from its foot.
        width_peak: f32 = 0.5, in 0.01..=0.99;
        /// Curvature below the peak.
        power_low: f32 = 0.5, in 0.0..=10.0;
        /// Curvature above the peak.
        power_high: f32 = 0.5, in 0.0..=10.0;
    }
}

/// Most stems and leaves of a tree: the largest published species, the weeping willow, comes to
/// 1.1 million, and a stem takes about a kilobyte.
const MOST_PARTS: f64 = 2e6;

impl WeberPenn {
    /// Everything wrong with the parameters that ranges could not tell.
    pub fn check(&self) -> Problems {
        let mut problems = self.leaf.color.check();
        let levels = self.level.value.len();
        if !(1..=4).contains(&levels) {
            let what = format!("a tree has one to four levels of stems, not {levels}");
            problems.push(Problem::at(self.level.span, what));
        }
        let parts = self.most_parts();
        if parts > MOST_PARTS {
            let what = format!("the tree would have up to {parts:.0} stems and leaves");
            let hint = format!("at most {MOST_PARTS:.0}: lower `branches`, `trunks` or `count`");
            problems.push(Problem::at(self.level.span, what).hint(hint));
        }
        problems
    }

    /// Upper bound of stems and leaves without splits.
    fn most_parts(&self) -> f64 {
        let branches =
            self.level.value.iter().skip(1).map(|level| f64::from(level.branches.max(1)));
        let leaves = f64::from(self.leaf.count.unsigned_abs().max(1));
        f64::from(self.trunks) * branches.product::<f64>() * leaves
    }

    /// Grows a tree.
    pub fn grow(&self, stature: &Stature, seed: Seed) -> Skeleton {
        tree::grow(self, stature, seed)
    }
}

#[cfg(test)]
mod tests;
