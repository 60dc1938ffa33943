//! What a species looks like besides its form, and the circumstances under which it is shown.
//!
//! A generator gives the skeleton; this adds what all generators share: root flare, fruits,
//! season, level of detail, textures and wind.

use crate::card;
use crate::detail::{Detail, simplify};
use crate::fruit::{self, Fruit};
use crate::mesh::{Meshing, model_with};
use crate::season::{self, Calendar};
use crate::skeleton::{AxisKind, Node, Skeleton};
use crate::texture::{self, Bark, Veins};
use weald_contract::{PlantModel, Problem, Problems, Seed, table};

table! {
    /// The `[look]` of a species.
    pub struct Look {
        /// Pattern of its bark or stems; plain by default.
        bark: Option<Bark> = None;
        /// Veins of its leaves.
        veins: Veins = Veins::None;
        /// Days on which it unfolds, turns and sheds its leaves; evergreen by default.
        season: Option<Calendar> = None;
        /// Its fruits.
        fruit: Vec<Fruit> = Vec::new();
        /// Swelling of trunks at the ground, as part of their radius; forms that have a `flare`
        /// of their own need none.
        root_flare: f32 = 0.0, in 0.0..=5.0;
    }
}

impl Default for Look {
    fn default() -> Self {
        let (bark, season, fruit) = (None, None, Vec::new());
        Self { bark, veins: Veins::None, season, fruit, root_flare: 0.0 }
    }
}

table! {
    /// How plants are shown: the `[plants]` of a scene.
    pub struct Conditions {
        /// Day of the year, 1 to 366, by which leaves unfold, turn and fall and fruits ripen;
        /// summer without seasons by default.
        day: Option<f32> = None, in 1.0..=366.0;
        /// Sizes of a pixel, m, by rising size: plants so far away that a pixel is at least that
        /// large at their place are shown by coarser models. None by default; `[0.01, 0.04]`
        /// makes two.
        levels: Vec<f32> = Vec::new(), in 0.0001..=10.0;
        /// Whether bark and leaves are painted.
        textures: bool = true;
        /// Whether models know how wind moves them.
        wind: bool = false;
        /// Whether leaves are pictures on cards instead of meshes with an outline.
        leaf_cards: bool = false;
        /// Whether the thinnest branches with their leaves are pictures on cards.
        twig_cards: bool = false;
        /// Different twigs that all models of a species share: each is kept once, and rays find it
        /// through another placement. Each model has its own without it.
        shared_twigs: Option<u32> = None, in 1.0..=65536.0;
        /// Different leaves, petals and blades that all models of a species share, at least one of
        /// each make; the others are stretched from those most like them. Each model has its own
        /// without it.
        shared_organs: Option<u32> = None, in 1.0..=65536.0;
    }
}

impl Default for Conditions {
    fn default() -> Self {
        let levels = Vec::new();
        Self {
            day: None,
            levels,
            textures: true,
            wind: false,
            leaf_cards: false,
            twig_cards: false,
            shared_twigs: None,
            shared_organs: None,
        }
    }
}

impl Conditions {
    /// Everything wrong with them that ranges could not tell.
    pub fn check(&self) -> Problems {
        let rises = self.levels.windows(2).all(|pair| pair[0] < pair[1]);
        let problem = || {
            Problem::new(format!("the `levels` of `[plants]` are {:?}", self.levels))
                .hint("they are sizes of a pixel in metres, each larger than the one before")
        };
        let mut problems: Problems = (!rises).then(problem).into_iter().collect();
        if self.twig_cards && self.shared_twigs.is_some() {
            let problem = Problem::new("`[plants]` has both `twig_cards` and `shared_twigs`");
            problems.push(problem.hint("cards are pictures of the twigs: give one of them"));
        }
        problems
    }
}

impl Look {
    /// Everything wrong with it that ranges could not tell.
    pub fn check(&self) -> Problems {
        let calendar = self.season.iter().flat_map(Calendar::check);
        let fruits = self.fruit.iter().filter(|fruit| {
            let [begin, ripe, fall] = fruit.days;
            !(begin <= ripe && ripe <= fall)
        });
        let fruits = fruits.map(|fruit| {
            Problem::new(format!("the `days` of a fruit are {:?}", fruit.days))
                .hint("they are those on which it begins to grow, is ripe and falls, in this order")
        });
        calendar.chain(fruits).collect()
    }
}

/// Adds to a grown skeleton what a species looks like under some conditions at any level of detail.
///
/// `maturity` is the plant's height as part of that of an old one. The same arguments give the
/// same bytes.
pub fn dress(
    skeleton: &mut Skeleton,
    look: &Look,
    conditions: &Conditions,
    maturity: f32,
    seed: Seed,
) {
    if look.root_flare > 0.0 {
        flare(skeleton, look.root_flare);
    }
    for (index, fruit) in look.fruit.iter().enumerate() {
        let seed = seed.part("fruit", index as u64);
        fruit::bear(skeleton, fruit, maturity, conditions.day, seed);
    }
    if let (Some(calendar), Some(day)) = (&look.season, conditions.day) {
        season::dress(skeleton, calendar, day, seed.part("season", 0));
    }
}

/// The model of a dressed skeleton at a level of detail.
pub fn level(
    name: &str,
    skeleton: &Skeleton,
    look: &Look,
    conditions: &Conditions,
    detail: &Detail,
) -> PlantModel {
    let bark = look.bark.as_ref().filter(|_| conditions.textures);
    let tile = bark.map_or(0.0, |bark| bark.size[0]);
    let meshing = Meshing { sag: detail.sag, tile, sways: conditions.wind };
    let coarse;
    let mut shown = skeleton;
    if *detail != Detail::FULL {
        coarse = simplify(skeleton, detail);
        shown = &coarse;
    }
    let pruned = if conditions.twig_cards { card::prune(shown) } else { None };
    let rest = pruned.as_ref().map_or(shown, |pruned| &pruned.rest);
    let mut model = model_with(name, rest, &meshing);
    if conditions.textures {
        texture::paint(&mut model.materials, &mut model.textures, bark, look.veins);
    }
    if let Some(pruned) = pruned {
        let plain = Meshing { sag: 0.0005, tile, sways: false };
        let example = |twig| model_with("twig", twig, &plain);
        let examples: Vec<PlantModel> = pruned.examples.iter().map(example).collect();
        card::twig_cards(&mut model, &examples, pruned.places);
    }
    if conditions.leaf_cards {
        card::leaf_cards(&mut model);
    }
    model
}

/// Height over the ground at which a root flare has fallen to a third, in radii of the trunk.
const FLARE_HEIGHT: f32 = 1.2;

/// Widens trunks where they meet the ground.
fn flare(skeleton: &mut Skeleton, amount: f32) {
    let old = std::mem::take(&mut skeleton.nodes);
    for axis in &mut skeleton.axes {
        let nodes = &old[axis.nodes.start as usize..axis.nodes.end as usize];
        let start = skeleton.nodes.len() as u32;
        let is_trunk = axis.order == 0 && axis.parent.is_none() && axis.kind == AxisKind::Stem;
        if is_trunk {
            skeleton.nodes.extend(flared(nodes, amount));
        } else {
            skeleton.nodes.extend(nodes);
        }
        axis.nodes = start..skeleton.nodes.len() as u32;
    }
}

/// The nodes of a trunk with more of them near the ground, widened there.
fn flared(nodes: &[Node], amount: f32) -> Vec<Node> {
    let ground = nodes.iter().find(|node| node.position.z >= 0.0).unwrap_or(&nodes[0]);
    let (base, radius) = (ground.position.z, ground.radius.max(1e-5));
    let factor = |z: f32| 1.0 + amount * libm::expf(-(z - base).max(0.0) / (FLARE_HEIGHT * radius));
    let mut wide = Vec::with_capacity(nodes.len() + 3);
    for pair in nodes.windows(2) {
        wide.push(pair[0]);
        let rise = pair[1].position.z - pair[0].position.z;
        for step in [0.5, 1.2, 2.5] {
            let t = (base + step * radius - pair[0].position.z) / rise;
            if rise > 0.0 && (0.05..0.95).contains(&t) {
                wide.push(Node {
                    position: pair[0].position.lerp(pair[1].position, t),
                    radius: pair[0].radius + (pair[1].radius - pair[0].radius) * t,
                });
            }
        }
    }
    wide.extend(nodes.last());
    wide.iter_mut().for_each(|node| node.radius *= factor(node.position.z));
    wide
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::opaque;
    use crate::skeleton::Axis;
    use glam::Vec3;

    #[test]
    fn a_flared_trunk_is_wide_at_the_ground_and_unchanged_above() {
        let mut skeleton = Skeleton::default();
        skeleton.add_material(opaque("bark", [0.2; 3]));
        let node = |z: f32| Node { position: Vec3::Z * z, radius: 0.2 };
        skeleton.push(Axis::new(1, AxisKind::Stem, 0), [node(0.0), node(3.0), node(6.0)]);
        flare(&mut skeleton, 0.8);
        assert_eq!(skeleton.check(), Ok(()));
        let nodes = skeleton.nodes_of(&skeleton.axes[0]);
        assert_eq!(nodes.len(), 5);
        assert!((nodes[0].radius - 0.36).abs() < 1e-6);
        assert!(nodes.windows(2).all(|pair| pair[0].radius >= pair[1].radius));
        assert!((nodes[4].radius - 0.2).abs() < 1e-4);
    }
}
