//! Plants: trees grown and meshed.

use super::{Figure, Size, best};
use crate::error::Result;
use crate::make::{grow_one, skeleton_of};
use crate::scene::SceneSpecies;
use std::collections::BTreeMap;
use weald_contract::{PlantModel, Representative, Seed, Sources};
use weald_plants::{Conditions, Skeleton};

pub(super) fn triangles(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Figure> {
    use rayon::prelude::*;
    let (time, models) = best(size, || {
        (0..size.trees)
            .into_par_iter()
            .map(|id| grown(species, "aspen", 60.0, id))
            .collect::<Result<Vec<_>>>()
    })?;
    let count: u64 = models.iter().map(PlantModel::instanced_triangles).sum();
    let input = format!("{} trees, {count} triangles with leaves", size.trees);
    let figure = Figure::rate("Weber-Penn aspen", count as f64, "triangles/s", time, input);
    Ok(figure.with(count as f64))
}

/// The black oak that Weber and Penn published, from its parameters to triangles and instances on
/// one thread, and the sweeping of its wood alone.
pub(super) fn black_oak(
    size: &Size,
    species: &BTreeMap<String, SceneSpecies>,
) -> Result<[Figure; 2]> {
    let found = &species["oak"];
    let plant = full_grown(found, "oak", found.species.size.lifespan, 1);
    let (time, model) = best(size, || {
        grow_one(&Sources::default(), found, &plant, &Conditions::default(), Seed(1))
    })?;
    let leaves: usize = model.organs.iter().map(|organ| organ.placements.len()).sum();
    let skeleton = skeleton_of(&Sources::default(), found, &plant, Seed(1))?;
    let stems = skeleton.axes.len();
    let bare = Skeleton { organs: Vec::new(), ..skeleton };
    let (swept, wood) = best(size, || Ok(weald_plants::mesh::model("oak", &bare)))?;
    let triangles: usize = wood.wood.iter().map(|mesh| mesh.triangles.len()).sum();
    let input = format!("{stems} stems, {leaves} leaves, {triangles} triangles of wood");
    let oak = Figure::time("Weber-Penn black oak", time, input.clone()).with(leaves as f64);
    Ok([oak, Figure::rate("sweeping wood", triangles as f64, "triangles/s", swept, input)])
}

/// Different trees of about the size of a medium tree for games: a hundred branches and some five
/// thousand leaves, on all threads.
pub(super) fn many_trees(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Figure> {
    use rayon::prelude::*;
    // A young oak of 6 m: its stems and leaves are told.
    const AGE: f32 = 26.0;
    let found = &species["oak"];
    let grow = |id: u32| {
        let plant = full_grown(found, "oak", AGE, id);
        grow_one(&Sources::default(), found, &plant, &Conditions::default(), Seed(1))
    };
    let (time, counts) = best(size, || {
        let one = |id| {
            let model = grow(id)?;
            let leaves: usize = model.organs.iter().map(|organ| organ.placements.len()).sum();
            Ok([model.unique_triangles(), leaves as u64])
        };
        (1..=MANY).into_par_iter().map(one).collect::<Result<Vec<[u64; 2]>>>()
    })?;
    let mean =
        |column: usize| counts.iter().map(|count| count[column]).sum::<u64>() / u64::from(MANY);
    let input = format!("{MANY} young oaks, {} leaves and {} triangles each", mean(1), mean(0));
    Ok(Figure::time("different trees", time, input))
}

/// Trees that are grown one after another.
const MANY: u32 = 1000;

fn full_grown(found: &SceneSpecies, name: &str, age: f32, id: u32) -> Representative {
    let size = &found.species.size;
    let height = size.height_at(age, 1.0);
    Representative {
        id,
        species: name.into(),
        age,
        vigor: 1.0,
        height,
        radius: size.radius_of_height(height),
        weight: 1.0,
        count: 1,
    }
}

/// A full-grown plant of a species.
pub(super) fn grown(
    species: &BTreeMap<String, SceneSpecies>,
    name: &str,
    age: f32,
    id: u32,
) -> Result<PlantModel> {
    let found = &species[name];
    let size = &found.species.size;
    let height = size.height_at(age, 0.9);
    let plant = Representative {
        id,
        species: name.into(),
        age,
        vigor: 0.9,
        height,
        radius: size.radius_of_height(height),
        weight: 1.0,
        count: 1,
    };
    grow_one(&Sources::default(), found, &plant, &Conditions::default(), Seed(1))
}
