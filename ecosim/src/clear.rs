//! Removing plants: everything of some species, in a disc, or where a formula says so.

use crate::config::Clear;
use crate::field::BoundFormula;
use crate::stand::Stand;
use crate::steps::Site;
use crate::{Cause, Death, Error};
use weald_contract::Plant;

/// Removes the plants that the step's species, disc and formula all single out.
pub(crate) fn run(clear: &Clear, site: &Site<'_>, stand: &mut Stand<'_>) -> Result<(), Error> {
    site.progress.begin("clear", 1, "steps");
    let mut species = Vec::new();
    for name in &clear.species {
        species.push(stand.species_of(name)?);
    }
    let places: Vec<[f64; 2]> = stand.population.plants.iter().map(|p| [p.x, p.y]).collect();
    let chosen = match &clear.formula {
        Some(formula) => {
            let bound = BoundFormula::bind(formula, site.around.terrain, stand)?;
            bound.numbers(places.len(), |index| places[index])?
        }
        None => vec![1.0; places.len()],
    };
    let frame = site.ground.frame();
    let in_disc = |plant: &Plant| {
        clear.disc.is_none_or(|[x, y, radius]| {
            let (dx, dy) = (plant.x - frame.west - x, plant.y - frame.south - y);
            dx * dx + dy * dy <= radius * radius
        })
    };
    let is_meant = |plant: &Plant| species.is_empty() || species.contains(&plant.species);
    let keep: Vec<bool> = stand
        .population
        .plants
        .iter()
        .zip(&chosen)
        .map(|(plant, &chosen)| !(chosen > 0.0 && is_meant(plant) && in_disc(plant)))
        .collect();
    record(stand, &keep);
    stand.keep(&keep);
    site.progress.advance(1);
    Ok(())
}

/// Notes the plants that are not kept among the dead.
pub(crate) fn record(stand: &mut Stand<'_>, keep: &[bool]) {
    let year = stand.year;
    let cleared = stand.population.plants.iter().zip(keep).filter(|(_, keep)| !**keep);
    stand.deaths.extend(cleared.map(|(plant, _)| Death {
        id: plant.id,
        species: plant.species,
        step: year,
        cause: Cause::Cleared,
        killer: None,
    }));
}
