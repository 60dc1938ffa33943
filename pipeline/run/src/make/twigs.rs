//! Twigs that the models of a species share: `shared_twigs` of `[plants]`.
//!
//! All plants are grown, their twigs compared and clustered; of each cluster the twig nearest to
//! its centre is kept, and the plants are grown again with kept twigs in the place of their own.

use super::plants::{Growing, has_levels};
use crate::error::{Error, Result};
use rayon::prelude::*;
use serde::Serialize;
use std::collections::BTreeMap;
use weald_contract::{Palette, Progress, Representative};
use weald_plants::Skeleton;
use weald_plants::twig::{self, Shape, TRAITS, Traits};
use weald_quantize::{Codebook, Mode, Table};

/// Twigs of fewer triangles are not worth a placement each.
const LEAST_TRIANGLES: u64 = weald_render::NESTED_TRIANGLES;

/// Twigs that models share, by species.
#[derive(Default)]
pub(crate) struct SharedTwigs {
    species: BTreeMap<String, Shared>,
}

/// The twigs of one species.
struct Shared {
    shapes: Vec<Shape>,
    /// The shape of each twig of a representative, by its id.
    labels: BTreeMap<u32, Vec<u32>>,
    report: TwigReport,
}

/// What sharing twigs saved.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(crate) struct TwigReport {
    /// Twigs of all models.
    pub twigs: u64,
    /// Different ones that are kept.
    pub shared: u64,
    /// Triangles of those that are kept.
    pub triangles: u64,
    /// Weighted mean of squared distances in the space in which twigs are compared.
    pub distortion: f64,
}

impl SharedTwigs {
    /// Compares the twigs of all models of a palette, species by species; none are shared unless
    /// the conditions ask for it.
    ///
    /// # Errors
    /// A species cannot be grown, or the caller asked to stop.
    pub fn of(growing: &Growing<'_>, palette: &Palette, progress: &dyn Progress) -> Result<Self> {
        let Some(count) = growing.conditions.shared_twigs else { return Ok(Self::default()) };
        let mut plants: BTreeMap<&str, Vec<&Representative>> = BTreeMap::new();
        for plant in &palette.representatives {
            if growing.species.get(&plant.species).is_some_and(has_levels) {
                plants.entry(&plant.species).or_default().push(plant);
            }
        }
        let total = plants.values().map(|plants| plants.len() as u64).sum();
        progress.begin("comparing twigs", total, "plants");
        let mut species = BTreeMap::new();
        for (name, plants) in plants {
            if let Some(shared) = Shared::of(growing, &plants, count as usize, progress)? {
                species.insert(name.to_owned(), shared);
            }
        }
        Ok(Self { species })
    }

    /// Whether a plant has shared twigs.
    pub fn has(&self, plant: &Representative) -> bool {
        self.species.get(&plant.species).is_some_and(|kind| kind.labels.contains_key(&plant.id))
    }

    /// The plant's skeleton with shared twigs in the place of its own.
    pub fn shared(&self, plant: &Representative, skeleton: &Skeleton) -> Skeleton {
        let found = self.species.get(&plant.species);
        match found.and_then(|kind| Some((kind, kind.labels.get(&plant.id)?))) {
            Some((kind, labels)) => twig::replaced(twig::take_off(skeleton), &kind.shapes, labels),
            None => skeleton.clone(),
        }
    }

    /// What was saved, by species.
    pub fn reports(&self) -> BTreeMap<&str, TwigReport> {
        self.species.iter().map(|(name, kind)| (name.as_str(), kind.report)).collect()
    }
}

impl Shared {
    /// `None` where sharing does not pay: few twigs, or small ones.
    fn of(
        growing: &Growing<'_>,
        plants: &[&Representative],
        count: usize,
        progress: &dyn Progress,
    ) -> Result<Option<Self>> {
        let found = plants.par_iter().map(|plant| {
            if progress.is_cancelled() {
                return Err(Error::Stopped { saved: false });
            }
            let skeleton = growing.dressed(plant)?;
            let found = twig::traits(&skeleton, &twig::take_off(&skeleton).twigs);
            progress.advance(1);
            Ok(found)
        });
        let found: Vec<Vec<Traits>> = found.collect::<Result<_>>()?;
        let all: Vec<Traits> = found.iter().flatten().copied().collect();
        if all.len() <= count {
            return Ok(None);
        }
        let table = table(&all)?;
        let book = weald_quantize::cluster(&table, count, Mode::Fast);
        let chosen = choose(&all, &book, &table);
        let shapes = shapes(growing, plants, &found, &chosen)?;
        let triangles = shapes.iter().map(Shape::triangles).sum();
        if triangles < LEAST_TRIANGLES * shapes.len() as u64 {
            return Ok(None);
        }
        let report = TwigReport {
            twigs: all.len() as u64,
            shared: shapes.len() as u64,
            triangles,
            distortion: book.distortion(&table),
        };
        Ok(Some(Self { shapes, labels: labels(plants, &found, &book), report }))
    }
}

fn table(all: &[Traits]) -> Result<Table> {
    let values = all.iter().flat_map(|traits| traits.values);
    let weights = all.iter().map(|traits| traits.weight);
    Table::new(values.collect(), TRAITS, weights.collect())
        .map_err(|error| Error::plain(format!("twigs cannot be compared: {error}"), ""))
}

/// A twig that is kept.
struct Chosen {
    /// Row of the table.
    row: usize,
    /// How many times as large its organs are to become, so that all twigs for which it stands
    /// have their area together: crowns are judged by the light that they stop.
    organ_scale: f32,
}

fn choose(all: &[Traits], book: &Codebook, table: &Table) -> Vec<Chosen> {
    // Area of the organs of all twigs of a cluster, and sum of their squared lengths.
    let mut sums = vec![[0.0, 0.0]; book.len()];
    for (traits, label) in all.iter().zip(&book.labels) {
        let [area, squares] = &mut sums[*label as usize];
        *area += traits.organ_area;
        *squares += traits.length * traits.length;
    }
    let chosen = |(row, [area, squares]): (usize, [f64; 2])| {
        let kept = &all[row];
        let becomes = kept.organ_area * squares / (kept.length * kept.length);
        let ratio = if becomes > 0.0 { area / becomes } else { 1.0 };
        Chosen { row, organ_scale: ratio.sqrt().clamp(0.5, 2.0) as f32 }
    };
    book.nearest_rows(table).into_iter().zip(sums).map(chosen).collect()
}

/// Grows the plants again that bear chosen twigs, and meshes those.
fn shapes(
    growing: &Growing<'_>,
    plants: &[&Representative],
    found: &[Vec<Traits>],
    chosen: &[Chosen],
) -> Result<Vec<Shape>> {
    // First row of each plant.
    let mut starts = vec![0];
    for traits in found {
        starts.push(starts[starts.len() - 1] + traits.len());
    }
    let mut wanted: BTreeMap<usize, Vec<(usize, &Chosen)>> = BTreeMap::new();
    for (label, chosen) in chosen.iter().enumerate() {
        let plant = starts.partition_point(|start| *start <= chosen.row) - 1;
        wanted.entry(plant).or_default().push((label, chosen));
    }
    let grown = wanted.par_iter().map(|(plant, chosen)| {
        let skeleton = growing.dressed(plants[*plant])?;
        let pruned = twig::take_off(&skeleton);
        let shape = |(label, chosen): &(usize, &Chosen)| {
            let twig = &pruned.twigs[chosen.row - starts[*plant]];
            (*label, Shape::of(&skeleton, twig, chosen.organ_scale))
        };
        Ok(chosen.iter().map(shape).collect())
    });
    let grown: Vec<Vec<(usize, Shape)>> = grown.collect::<Result<_>>()?;
    let shapes: BTreeMap<usize, Shape> = grown.into_iter().flatten().collect();
    Ok(shapes.into_values().collect())
}

/// The clusters of each plant's twigs, by the plant's id.
fn labels(
    plants: &[&Representative],
    found: &[Vec<Traits>],
    book: &Codebook,
) -> BTreeMap<u32, Vec<u32>> {
    let mut rest = book.labels.as_slice();
    let mut of_plant = |(plant, traits): (&&Representative, &Vec<Traits>)| {
        let (own, after) = rest.split_at(traits.len());
        rest = after;
        (plant.id, own.to_vec())
    };
    plants.iter().zip(found).map(&mut of_plant).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::load_species;
    use std::path::Path;
    use weald_contract::{Seed, Silent};
    use weald_plants::{Conditions, measure};

    #[test]
    fn aspens_with_eight_twigs_keep_the_area_of_their_leaves() {
        let (sources, species) = load_species(Path::new(""), ["aspen".to_owned()]).unwrap();
        let size = &species["aspen"].species.size;
        let plant = |id: u32| {
            let age = 6.0 + 4.0 * id as f32;
            let (vigor, weight, count) = (1.0 - 0.1 * id as f32, 1.0, 1);
            let [height, radius] = [size.height_at(age, vigor), size.radius_at(age, vigor)];
            let species = "aspen".to_owned();
            Representative { id, species, age, vigor, height, radius, weight, count }
        };
        let palette = Palette { representatives: (1..6).map(plant).collect(), groups: Vec::new() };
        let conditions = Conditions { shared_twigs: Some(8), ..Conditions::default() };
        let (conditions, sources, species) = (&conditions, &sources, &species);
        let growing = Growing { species, conditions, seed: Seed(1), sources };
        let twigs = SharedTwigs::of(&growing, &palette, &Silent).unwrap();
        let report = twigs.reports()["aspen"];
        assert!(report.shared == 8 && report.twigs > 500, "{report:?}");
        let mut sums = [0.0, 0.0];
        for plant in &palette.representatives {
            let own = growing.dressed(plant).unwrap();
            let shared = twigs.shared(plant, &own);
            assert_eq!(shared.check(), Ok(()));
            let areas = [&own, &shared].map(measure::leaf_area);
            assert!((areas[1] / areas[0] - 1.0).abs() < 0.15, "{areas:?}");
            sums = [sums[0] + areas[0], sums[1] + areas[1]];
        }
        assert!((sums[1] / sums[0] - 1.0).abs() < 0.01, "{sums:?}");
    }
}
