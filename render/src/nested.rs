//! Organs that are levels of their own: twigs that many plants share.
//!
//! A large organ that stands in many places, of one plant or of many, is kept once; a plant is then
//! its wood and placements of such organs. Small organs are copied to all their places, where rays
//! find them sooner.

use crate::model::{may_nest, triangles};
use std::collections::BTreeMap;
use std::sync::Arc;
use weald_contract::{Organ, PlantModel};

/// Places from which an organ is kept once rather than copied.
const LEAST_PLACES: usize = 16;

/// A model, and the number of each of its materials among those of all models.
pub(crate) type Known = (Arc<PlantModel>, Vec<u16>);

/// Which organs of which models are levels of their own.
#[derive(Default)]
pub(crate) struct Nested {
    /// Model and organ of each of the different organs.
    pub originals: Vec<(usize, usize)>,
    /// For each model its organs that are nested, and which of the originals they are.
    pub of_model: Vec<BTreeMap<usize, usize>>,
}

impl Nested {
    /// Finds organs that are equal, materials and all, and stand in many places.
    pub fn find(models: &[Known]) -> Self {
        let mut found = Self { of_model: vec![BTreeMap::new(); models.len()], ..Self::default() };
        let mut places: Vec<usize> = Vec::new();
        let mut known: BTreeMap<(&str, u64), Vec<usize>> = BTreeMap::new();
        for (model, (plant, _)) in models.iter().enumerate() {
            let organs = plant.organs.iter().enumerate().filter(|(_, organ)| may_nest(organ));
            for (number, organ) in organs {
                let alike = known.entry((&organ.name, triangles(organ))).or_default();
                let at = (model, number);
                let same = alike.iter().copied();
                let same = same.into_iter().find(|o| are_equal(models, found.originals[*o], at));
                let original = same.unwrap_or_else(|| {
                    alike.push(places.len());
                    found.originals.push(at);
                    places.push(0);
                    places.len() - 1
                });
                places[original] += organ.placements.len();
                found.of_model[model].insert(number, original);
            }
        }
        found.drop_rare(&places);
        found
    }

    /// Organs of few places are copied after all.
    fn drop_rare(&mut self, places: &[usize]) {
        let mut numbers = vec![None; places.len()];
        let mut kept = Vec::new();
        for (original, _) in places.iter().enumerate().filter(|(_, p)| **p >= LEAST_PLACES) {
            numbers[original] = Some(kept.len());
            kept.push(self.originals[original]);
        }
        self.originals = kept;
        for organs in &mut self.of_model {
            let renumbered = organs.iter().filter_map(|(&organ, &o)| Some((organ, numbers[o]?)));
            *organs = renumbered.collect();
        }
    }
}

fn are_equal(models: &[Known], a: (usize, usize), b: (usize, usize)) -> bool {
    let [(a, of_a), (b, of_b)] = [a, b].map(|(model, organ)| {
        let (plant, materials) = &models[model];
        let organ: &Organ = &plant.organs[organ];
        (organ, materials)
    });
    let material = |of: &[u16], number: u32| of.get(number as usize).copied();
    a.meshes.len() == b.meshes.len()
        && a.meshes.iter().zip(&b.meshes).all(|(a, b)| {
            material(of_a, a.material) == material(of_b, b.material)
                && a.positions == b.positions
                && a.triangles == b.triangles
                && a.normals == b.normals
                && a.uvs == b.uvs
        })
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Mesh, Placement};

    fn twig(triangles: usize, bend: f32, places: usize, scale: [f32; 3]) -> Organ {
        let mesh = Mesh {
            positions: vec![[0.0; 3], [1.0, bend, 0.0], [0.0, 1.0, 0.0]],
            triangles: vec![[0, 1, 2]; triangles],
            ..Mesh::default()
        };
        let place = Placement { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale };
        let placements = vec![place; places];
        Organ { name: "twig".into(), meshes: vec![mesh], placements, ..Organ::default() }
    }

    #[test]
    fn equal_organs_of_many_places_in_all_are_one() {
        let model = |organs: Vec<Organ>, material: u16| {
            (Arc::new(PlantModel { organs, ..PlantModel::default() }), vec![material])
        };
        let one = [1.0; 3];
        let models = [
            model(vec![twig(100, 0.0, 9, one), twig(100, 0.5, 40, one)], 3),
            // Equal to the first, and 16 places together; then small, stretched and rare ones.
            model(vec![twig(10, 0.0, 90, one), twig(100, 0.0, 7, [2.0; 3])], 3),
            model(vec![twig(100, 0.0, 90, [1.0, 2.0, 1.0]), twig(100, 0.0, 15, one)], 4),
        ];
        let found = Nested::find(&models);
        assert_eq!(found.originals, [(0, 0), (0, 1)]);
        let of_model: Vec<Vec<(usize, usize)>> =
            found.of_model.iter().map(|of| of.iter().map(|(a, b)| (*a, *b)).collect()).collect();
        assert_eq!(of_model, [vec![(0, 0), (1, 1)], vec![(1, 0)], vec![]]);
    }
}
