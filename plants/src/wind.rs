//! Wind: which parts of a plant turn about which foot, and how they swing.
//!
//! Every axis is a branch that wind turns about its foot, together with all that it bears. A
//! branch gives way the more the longer and thinner it is: its stiffness is the radius of its
//! foot over its length. [`sway`] poses a model that carries the table; it is the reference for
//! programs that animate the exported attributes.

use crate::skeleton::Skeleton;
use glam::{Quat, Vec3};
use weald_contract::{Branch, PlantModel, Seed};

/// The branches of a skeleton, one for each axis in its order.
pub fn branches(skeleton: &Skeleton) -> Vec<Branch> {
    skeleton
        .axes
        .iter()
        .map(|axis| {
            let nodes = skeleton.nodes_of(axis);
            let length: f32 = nodes.windows(2).map(|p| p[0].position.distance(p[1].position)).sum();
            Branch {
                parent: axis.parent,
                pivot: nodes[0].position.to_array(),
                stiffness: nodes[0].radius / length.max(1e-4),
                phase: Seed(axis.id).stream("phase", 0).range(0.0, std::f64::consts::TAU) as f32,
            }
        })
        .collect()
}

/// A steady wind with gusts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Wind {
    /// Speed at the plant, m/s.
    pub speed: f32,
    /// Direction that it blows towards, rad from X over Y.
    pub towards: f32,
    /// Time, s.
    pub time: f32,
}

/// Stiffness that halves the lean of a branch.
///
/// Trunks lie at 0.01 to 0.03, twigs and stalks at 0.002 to 0.01.
const HALF_STIFF: f32 = 0.008;

/// Lean of the most pliant branch in a wind of 10 m/s, rad.
const LEAN: f32 = 0.35;

/// Angle by which a branch leans downwind at a moment, rad.
///
/// Drag grows with the square of the speed while leaves give way, which leaves a power near 1.3
/// [Vogel89]; gusts swing the branch about its lean.
pub fn lean(branch: &Branch, wind: &Wind) -> f32 {
    let pliancy = HALF_STIFF / (HALF_STIFF + branch.stiffness.max(0.0));
    let strength = libm::powf(wind.speed.max(0.0) / 10.0, 1.3);
    // Thin parts swing faster: 0.5 Hz for a trunk to about 2 Hz for a twig.
    let rate = std::f32::consts::TAU * (0.5 + 1.5 * pliancy);
    let swing = libm::sinf(rate * wind.time + branch.phase);
    let slow = libm::sinf(0.37 * rate * wind.time + 1.7 * branch.phase);
    let angle = LEAN * pliancy * strength * (0.55 + 0.3 * swing + 0.15 * slow);
    angle.clamp(-1.2, 1.2)
}

/// A rigid motion: what is at `p` comes to `turn * p + shift`.
#[derive(Clone, Copy)]
struct Motion {
    turn: Quat,
    shift: Vec3,
}

/// The model as it stands in the wind at a moment; one without branches stays as it is.
pub fn sway(model: &PlantModel, wind: &Wind) -> PlantModel {
    let mut posed = model.clone();
    if model.branches.is_empty() {
        return posed;
    }
    let motions = motions(&model.branches, wind);
    for mesh in &mut posed.wood {
        let branches = std::mem::take(&mut mesh.branches);
        for (vertex, &branch) in branches.iter().enumerate() {
            let Motion { turn, shift } = motions[branch as usize];
            if let Some(position) = mesh.positions.get_mut(vertex) {
                *position = (turn * Vec3::from_array(*position) + shift).to_array();
            }
            if let Some(normal) = mesh.normals.get_mut(vertex) {
                *normal = (turn * Vec3::from_array(*normal)).to_array();
            }
        }
        mesh.branches = branches;
    }
    for organ in &mut posed.organs {
        for (place, &branch) in organ.placements.iter_mut().zip(&organ.branches) {
            let Motion { turn, shift } = motions[branch as usize];
            place.position = (turn * Vec3::from_array(place.position) + shift).to_array();
            place.rotation = (turn * Quat::from_array(place.rotation)).normalize().to_array();
        }
    }
    posed
}

/// Motion of each branch: its bearer's, after its own turn about its foot.
fn motions(branches: &[Branch], wind: &Wind) -> Vec<Motion> {
    let (sin, cos) = libm::sincosf(wind.towards);
    // What leans downwind turns about the horizontal across the wind.
    let across = Vec3::new(-sin, cos, 0.0);
    let mut motions: Vec<Motion> = Vec::with_capacity(branches.len());
    for branch in branches {
        let (half_sin, half_cos) = libm::sincosf(0.5 * lean(branch, wind));
        let own = Quat::from_xyzw(across.x * half_sin, across.y * half_sin, 0.0, half_cos);
        let pivot = Vec3::from_array(branch.pivot);
        let still = Motion { turn: Quat::IDENTITY, shift: Vec3::ZERO };
        let borne = branch.parent.and_then(|parent| motions.get(parent as usize));
        let borne = borne.copied().unwrap_or(still);
        motions.push(Motion {
            turn: (borne.turn * own).normalize(),
            shift: borne.turn * (pivot - own * pivot) + borne.shift,
        });
    }
    motions
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::opaque;
    use crate::mesh::{Meshing, model_with};
    use crate::skeleton::{Axis, AxisKind, Node};

    fn forked() -> Skeleton {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let node = |position, radius| Node { position, radius };
        let trunk = [node(Vec3::ZERO, 0.1), node(Vec3::Z * 4.0, 0.02)];
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), trunk);
        let twig = [node(Vec3::Z * 2.0, 0.004), node(Vec3::new(1.0, 0.0, 2.5), 0.001)];
        skeleton.push(Axis::new(2, AxisKind::Stem, 0).on(0, 0.5, 1), twig);
        skeleton
    }

    fn model() -> PlantModel {
        model_with("test", &forked(), &Meshing { sways: true, ..Meshing::default() })
    }

    #[test]
    fn thin_branches_give_way_more_than_thick_ones() {
        let model = model();
        assert_eq!(model.branches.len(), 2);
        assert_eq!((model.branches[0].parent, model.branches[1].parent), (None, Some(0)));
        assert!(model.branches[0].stiffness > 4.0 * model.branches[1].stiffness);
        let wind = Wind { speed: 8.0, towards: 0.0, time: 0.0 };
        let still = |branch: &Branch| Branch { phase: 0.0, ..*branch };
        let [trunk, twig] = [0, 1].map(|i| lean(&still(&model.branches[i]), &wind));
        assert!(twig > trunk && trunk > 0.0);
    }

    #[test]
    fn a_branch_stays_on_its_bearer_and_keeps_its_length() {
        let model = model();
        let posed = sway(&model, &Wind { speed: 12.0, towards: 1.0, time: 0.7 });
        let wind = Wind { speed: 12.0, towards: 1.0, time: 0.7 };
        let motions = motions(&model.branches, &wind);
        let foot = Vec3::from_array(model.branches[1].pivot);
        let by = |m: Motion| m.turn * foot + m.shift;
        assert!(by(motions[0]).distance(by(motions[1])) < 1e-5);
        // Turning does not stretch: edges inside a branch keep their length.
        let mesh = |m: &PlantModel, i: usize| Vec3::from_array(m.wood[0].positions[i]);
        let branches = &model.wood[0].branches;
        for i in 1..branches.len() {
            if branches[i] == branches[i - 1] {
                let before = mesh(&model, i).distance(mesh(&model, i - 1));
                let after = mesh(&posed, i).distance(mesh(&posed, i - 1));
                assert!((before - after).abs() < 1e-4);
            }
        }
        assert_ne!(posed, model);
    }

    #[test]
    fn without_wind_nothing_moves() {
        let model = model();
        let posed = sway(&model, &Wind { speed: 0.0, towards: 0.3, time: 5.0 });
        let pairs = model.wood[0].positions.iter().zip(&posed.wood[0].positions);
        assert!(
            pairs
                .into_iter()
                .all(|(a, b)| { Vec3::from_array(*a).distance(Vec3::from_array(*b)) < 1e-5 })
        );
    }

    #[test]
    fn plants_lean_downwind() {
        let posed = sway(&model(), &Wind { speed: 10.0, towards: 0.0, time: 0.0 });
        let mean = posed.wood[0].positions.iter().map(|p| p[0]).sum::<f32>();
        let still = model().wood[0].positions.iter().map(|p| p[0]).sum::<f32>();
        assert!(mean > still);
    }
}
