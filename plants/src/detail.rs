//! Levels of detail: the same plant with fewer leaves and branches.
//!
//! A coarser level comes from the same skeleton. Thin branches go; of the leaves some stay and are
//! enlarged so that their area is kept, as crowns are judged by the light they stop [WP95] §5.
//! Which leaves stay is decided by evenly spread thresholds, so that a coarser level's leaves are
//! among those of a finer one.

use crate::skeleton::{AxisKind, Skeleton};
use weald_contract::PlantModel;

/// How coarse a level is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Detail {
    /// Part of the organs that stay, in (0, 1].
    pub organs: f32,
    /// Diameter of the thinnest branches that stay, m; blades of grass always do.
    pub thinnest: f32,
    /// How far the flat sides of a ring may lie inside the true circle, m.
    pub sag: f32,
}

impl Detail {
    /// Everything, as grown.
    pub const FULL: Self = Self { organs: 1.0, thinnest: 0.0, sag: crate::mesh::SAG };

    /// A level for a plant seen so far away that `pixel` metres at its place are one pixel.
    ///
    /// Leaves shrink to a fourth of their number at most, twice as wide: larger ones would show.
    /// Branches go that are thinner than half a pixel.
    pub fn for_pixel(pixel: f32) -> Self {
        // A leaf of 5 cm, the commonest size of our trees, may cover about a pixel.
        const LEAF: f32 = 0.05;
        let organs = if pixel > 0.0 { LEAF / pixel } else { 1.0 };
        let organs = (organs * organs).clamp(0.25, 1.0);
        Self { organs, thinnest: 0.5 * pixel, sag: crate::mesh::SAG.max(0.25 * pixel) }
    }
}

/// The skeleton with fewer organs and branches; leaf area stays.
///
/// Organs of a branch that has gone are held by the nearest thicker one, where they were. Trunks
/// stay at any level.
pub fn simplify(skeleton: &Skeleton, detail: &Detail) -> Skeleton {
    let mut coarse = Skeleton {
        prototypes: skeleton.prototypes.clone(),
        materials: skeleton.materials.clone(),
        ..Skeleton::default()
    };
    // Axis of the coarse skeleton that stands for each axis, and whether it is the axis itself.
    let mut places: Vec<(u32, bool)> = Vec::with_capacity(skeleton.axes.len());
    for axis in &skeleton.axes {
        let nodes = skeleton.nodes_of(axis);
        let thickest = nodes.iter().map(|node| node.radius).fold(0.0, f32::max);
        let is_kept = axis.kind == AxisKind::Blade || 2.0 * thickest >= detail.thinnest;
        let place = match axis.parent.map(|parent| places[parent as usize]) {
            None => (coarse.push(axis.clone(), nodes.iter().copied()), true),
            Some((parent, true)) if is_kept => {
                let axis = axis.clone().on(parent, axis.at, axis.order);
                (coarse.push(axis, nodes.iter().copied()), true)
            }
            Some((parent, _)) => (parent, false),
        };
        places.push(place);
    }
    keep_organs(skeleton, detail.organs, &places, &mut coarse);
    coarse
}

/// Copies part of the organs, enlarged so that those of each prototype keep their area.
fn keep_organs(skeleton: &Skeleton, part: f32, places: &[(u32, bool)], coarse: &mut Skeleton) {
    let count = skeleton.prototypes.len();
    // Area before and after by prototype, and how many have been met.
    let (mut all, mut kept, mut met) = (vec![0.0_f64; count], vec![0.0_f64; count], vec![0; count]);
    for organ in &skeleton.organs {
        let prototype = organ.prototype as usize;
        let area = f64::from(organ.scale.x * organ.scale.y);
        all[prototype] += area;
        // The first of its kind stays, or the area of a kind of few would be lost.
        if met[prototype] == 0 || crate::presence::threshold(met[prototype]) < part {
            kept[prototype] += area;
            let axis = places[organ.axis as usize].0;
            coarse.organs.push(crate::skeleton::PlacedOrgan { axis, ..*organ });
        }
        met[prototype] += 1;
    }
    for organ in &mut coarse.organs {
        let prototype = organ.prototype as usize;
        if kept[prototype] > 0.0 {
            organ.scale *= (all[prototype] / kept[prototype]).sqrt() as f32;
        }
    }
}

/// The model of a skeleton at a level of detail.
pub fn model(name: &str, skeleton: &Skeleton, detail: &Detail) -> PlantModel {
    crate::mesh::model_within(name, &simplify(skeleton, detail), detail.sag)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn far_plants_lose_thin_branches_and_at_most_three_in_four_leaves() {
        let near = Detail::for_pixel(0.001);
        assert_eq!((near.organs, near.sag), (1.0, crate::mesh::SAG));
        let far = Detail::for_pixel(0.4);
        assert_eq!((far.organs, far.thinnest, far.sag), (0.25, 0.2, 0.1));
        assert_eq!(Detail::for_pixel(0.0).organs, 1.0);
    }
}
