//! Plants: trees grown and meshed.

use super::{Figure, Size, best};
use crate::error::Result;
use crate::make::grow_one;
use crate::scene::SceneSpecies;
use std::collections::BTreeMap;
use weald_contract::{PlantModel, Representative, Seed, Sources};
use weald_plants::Conditions;

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
