//! Leaves, petals and blades that the models of a species share: `shared_organs` of `[plants]`.

use super::plants::{Growing, has_levels};
use crate::error::{Error, Result};
use std::collections::BTreeMap;
use weald_contract::{Organ, PlantModel, Representative};
use weald_plants::twig;
use weald_quantize::PartsReport;

/// Gives the models of each species a few shapes of organs, if the conditions ask for it, and tells
/// by species what was saved. Shared twigs stay as they are.
///
/// # Errors
/// An organ with a position that is not finite.
pub(super) fn share(
    growing: &Growing<'_>,
    representatives: &[Representative],
    models: &mut [PlantModel],
) -> Result<BTreeMap<String, PartsReport>> {
    let Some(most) = growing.conditions.shared_organs else { return Ok(BTreeMap::new()) };
    let mut species: BTreeMap<&str, Vec<&mut PlantModel>> = BTreeMap::new();
    for (plant, model) in representatives.iter().zip(models) {
        if growing.species.get(&plant.species).is_some_and(has_levels) {
            species.entry(&plant.species).or_default().push(model);
        }
    }
    let is_twig = |organ: &Organ| organ.name.starts_with(twig::PREFIX);
    let share = |(name, mut models): (&str, Vec<&mut PlantModel>)| {
        weald_quantize::share_organs(&mut models, most as usize, is_twig)
            .map(|report| (name.to_owned(), report))
            .map_err(|problem| Error::wrong(growing.sources, problem))
    };
    species.into_iter().map(share).collect()
}
