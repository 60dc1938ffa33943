//! The plants so far, as steps work on them.

use crate::config::Spacing;
use crate::field::ImageField;
use crate::ground::Ground;
use crate::seeds::DormantSeed;
use crate::species::Ecology;
use crate::{Death, Error, Outcome, PlotFit, Snapshot, SummaryRow, Surroundings, Unplaced};
use glam::Vec3;
use rayon::prelude::*;
use std::collections::BTreeMap;
use weald_contract::{
    Grid, GroupRecipe, Plant, Population, Problem, Size, Species, State, Written, source,
};

/// What steps need to know of a species.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Kind<'a> {
    /// Allometry.
    pub(crate) size: &'a Size,
    /// Traits.
    pub(crate) ecology: &'a Ecology,
    /// The patch it is, if it is no plant.
    pub(crate) group: Option<&'a GroupRecipe>,
}

impl Kind<'_> {
    /// Returns how much of the plant's axis follows the vertical; patches lie on the ground.
    fn upright(&self) -> f32 {
        if self.group.is_some() { 0.0 } else { self.ecology.upright }
    }
}

/// The population between two steps.
///
/// Plants are sorted by id whenever a step begins, so that no result depends on the order in
/// which they were handed in.
#[derive(Debug)]
pub(crate) struct Stand<'a> {
    /// The plants; each entry of `species` has its kind in `kinds`.
    pub(crate) population: Population,
    /// By species index.
    pub(crate) kinds: Vec<Kind<'a>>,
    /// Seeds that lie in the ground.
    pub(crate) bank: Vec<DormantSeed>,
    /// Years simulated so far.
    pub(crate) year: u32,
    /// Rows so far.
    pub(crate) summary: Vec<SummaryRow>,
    /// Deaths so far.
    pub(crate) deaths: Vec<Death>,
    /// Populations kept so far.
    pub(crate) snapshots: Vec<Snapshot>,
    /// What found no place so far.
    pub(crate) unplaced: Vec<Unplaced>,
    /// How well plots predicted each other so far.
    pub(crate) plot_fits: Vec<PlotFit>,
    /// Images that formulas may read, by name.
    pub(crate) images: BTreeMap<&'a str, ImageField<'a>>,
    /// Layers that steps made for the formulas of later ones, by name.
    pub(crate) layers: BTreeMap<&'a str, Grid>,
    /// Distances that plants keep.
    pub(crate) spacing: &'a [Spacing],
    known: &'a BTreeMap<String, (Species, Ecology)>,
    most: u64,
}

/// What a stand carries from step to step.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Belongings {
    pub(crate) population: Population,
    pub(crate) bank: Vec<DormantSeed>,
    pub(crate) year: u32,
    pub(crate) summary: Vec<SummaryRow>,
    pub(crate) deaths: Vec<Death>,
    pub(crate) snapshots: Vec<Snapshot>,
    pub(crate) unplaced: Vec<Unplaced>,
    pub(crate) plot_fits: Vec<PlotFit>,
    pub(crate) layers: BTreeMap<String, Grid>,
}

impl<'a> Stand<'a> {
    /// Begins with the plants of `start`, which must have distinct ids and known species.
    pub(crate) fn new(
        around: &Surroundings<'a>,
        start: Option<&Population>,
        most: u64,
    ) -> Result<Self, Error> {
        let mut population = start.cloned().unwrap_or_default();
        if start.is_none() {
            population.crs = around.terrain.crs.clone();
        }
        Self::with(around, Belongings { population, ..Belongings::default() }, most)
    }

    /// Goes on with what was so far, whose layers must be set by the caller.
    pub(crate) fn with(
        around: &Surroundings<'a>,
        so_far: Belongings,
        most: u64,
    ) -> Result<Self, Error> {
        let Belongings { mut population, bank, year, summary, deaths, snapshots, .. } = so_far;
        let Belongings { unplaced, plot_fits, .. } = so_far;
        let names = std::mem::take(&mut population.species);
        let known = around.species;
        let mut stand = Self {
            population,
            kinds: Vec::new(),
            bank,
            year,
            summary,
            deaths,
            snapshots,
            unplaced,
            plot_fits,
            images: BTreeMap::new(),
            layers: BTreeMap::new(),
            spacing: &[],
            known,
            most,
        };
        for name in &names {
            stand.species_index(name).ok_or_else(|| unknown(name, known))?;
        }
        check_start(&stand.population)?;
        stand.sort();
        let twins = stand.population.plants.windows(2).find(|pair| pair[0].id == pair[1].id);
        match twins.map(|pair| pair[0].id) {
            Some(id) => Err(Problem::new(format!("two plants have the id {id}")).into()),
            None => Ok(stand),
        }
    }

    /// Returns the index of a species that a step names.
    pub(crate) fn species_of(&mut self, name: &Written<String>) -> Result<u16, Error> {
        let index = self.species_index(&name.value);
        let known = self.known;
        index.ok_or_else(|| Problem { span: Some(name.span), ..unknown(&name.value, known) }.into())
    }

    fn species_index(&mut self, name: &str) -> Option<u16> {
        let (species, ecology) = self.known.get(name)?;
        let index = self.population.species_index(name);
        if usize::from(index) == self.kinds.len() {
            let group = species.group.as_ref();
            self.kinds.push(Kind { size: &species.size, ecology, group });
        }
        Some(index)
    }

    /// Keeps plants, sorted by id, as they stand in a step.
    ///
    /// Where one simulation ends with the step that another begins with, both keep into one table;
    /// of a plant of both the later state counts.
    pub(crate) fn keep_a_picture(&mut self, step: u32, plants: Vec<Plant>) {
        let Population { species, crs, .. } = &self.population;
        let (species, crs) = (species.clone(), crs.clone());
        let mut population = Population { species, crs, plants, ..Population::default() };
        if let Some(earlier) = self.snapshots.pop_if(|last| last.step == step) {
            let plants = &population.plants;
            let is_told = |id: u64| plants.binary_search_by_key(&id, |plant| plant.id).is_ok();
            let others = earlier.population.plants.into_iter().filter(|plant| !is_told(plant.id));
            let others: Vec<Plant> = others.collect();
            population.plants.extend(others);
            population.plants.par_sort_by_key(|plant| plant.id);
        }
        self.snapshots.push(Snapshot { step, population });
    }

    /// Puts plants, sorted by id, in the place of all those that took part in a simulation, by
    /// their species: changed, gone or new.
    pub(crate) fn succeed(&mut self, living: Vec<Plant>, took_part: impl Fn(u16) -> bool) {
        let (mut newcomers, mut keep) = (Vec::new(), Vec::with_capacity(self.population.len()));
        let mut survivors = living.into_iter().peekable();
        for plant in &mut self.population.plants {
            while let Some(newcomer) = survivors.next_if(|survivor| survivor.id < plant.id) {
                newcomers.push(newcomer);
            }
            let survivor = survivors.next_if(|survivor| survivor.id == plant.id);
            keep.push(survivor.is_some() || !took_part(plant.species));
            if let Some(survivor) = survivor {
                *plant = survivor;
            }
        }
        newcomers.extend(survivors);
        self.keep(&keep);
        self.add(newcomers);
    }

    /// Returns the kind of a species by its index.
    pub(crate) fn kind(&self, species: u16) -> Kind<'a> {
        self.kinds[usize::from(species)]
    }

    /// Returns how many more plants the limit allows.
    pub(crate) fn room(&self) -> u64 {
        self.most.saturating_sub(self.population.len() as u64)
    }

    /// Complains when `more` plants would exceed the limit.
    pub(crate) fn check_room(&self, more: u64, what: &str) -> Result<(), Error> {
        let would = (self.population.len() as u64).saturating_add(more);
        if would <= self.most {
            return Ok(());
        }
        let message = format!("{what} would bring the plants to {would}");
        let hint = format!("`ecosim.max_plants` allows {}; raise it if that is meant", self.most);
        Err(Problem::new(message).hint(hint).into())
    }

    /// Adds plants; columns that they do not have become NaN.
    pub(crate) fn add(&mut self, plants: Vec<Plant>) {
        self.population.plants.extend(plants);
        self.fill_extra();
        self.sort();
    }

    /// Adds plants with values in further columns, one a plant.
    pub(crate) fn add_with(&mut self, plants: Vec<Plant>, columns: Vec<(String, Vec<f32>)>) {
        let before = self.population.plants.len();
        for (name, values) in columns {
            let column = self.population.extra.entry(name).or_default();
            column.resize(before, f32::NAN);
            column.extend(values);
        }
        self.add(plants);
    }

    /// Gives every plant a value in every extra column.
    pub(crate) fn fill_extra(&mut self) {
        for column in self.population.extra.values_mut() {
            column.resize(self.population.plants.len(), f32::NAN);
        }
    }

    /// Keeps the plants whose flag is set.
    pub(crate) fn keep(&mut self, keep: &[bool]) {
        let kept = |index: &usize| keep[*index];
        let order: Vec<usize> = (0..keep.len()).filter(kept).collect();
        self.reorder(&order);
    }

    /// Sorts the plants by id.
    pub(crate) fn sort(&mut self) {
        if self.population.plants.is_sorted_by_key(|plant| plant.id) {
            return;
        }
        if self.population.extra.is_empty() {
            self.population.plants.par_sort_by_key(|plant| plant.id);
            return;
        }
        let plants = &self.population.plants;
        let mut order: Vec<usize> = (0..plants.len()).collect();
        order.par_sort_by_key(|&index| plants[index].id);
        self.reorder(&order);
    }

    fn reorder(&mut self, order: &[usize]) {
        let plants = &self.population.plants;
        self.population.plants = order.iter().map(|&index| plants[index]).collect();
        for column in self.population.extra.values_mut() {
            *column = order.iter().map(|&index| column[index]).collect();
        }
    }

    /// Returns what the steps made.
    pub(crate) fn finish(self) -> Outcome {
        let Self { population, summary, deaths, snapshots, unplaced, plot_fits, layers, .. } = self;
        let layers = layers.into_iter().map(|(name, grid)| (name.to_string(), grid)).collect();
        Outcome { population, summary, deaths, snapshots, unplaced, plot_fits, layers }
    }
}

fn unknown(name: &str, known: &BTreeMap<String, (Species, Ecology)>) -> Problem {
    let problem = Problem::new(format!("unknown species `{name}`"));
    match source::nearest(name, known.keys().map(String::as_str)) {
        Some(near) => problem.hint(format!("did you mean `{near}`?")),
        None => problem.hint("each species needs a file of its name"),
    }
}

fn check_start(population: &Population) -> Result<(), Error> {
    let species_count = population.species.len();
    for (row, plant) in population.plants.iter().enumerate() {
        if let Some(wrong) = fault(plant, species_count) {
            return Err(Problem::new(format!("plant {} (row {row}): {wrong}", plant.id)).into());
        }
    }
    for (name, column) in &population.extra {
        if column.len() != population.plants.len() {
            let message = format!("column `{name}` has {} values", column.len());
            let hint = format!("there are {} plants", population.plants.len());
            return Err(Problem::new(message).hint(hint).into());
        }
    }
    Ok(())
}

/// Returns what is wrong with a plant from a table, if anything is.
pub(crate) fn fault(plant: &Plant, species_count: usize) -> Option<&'static str> {
    let sizes = [plant.radius, plant.height, plant.age];
    if usize::from(plant.species) >= species_count {
        return Some("its species number is beyond the list of species");
    }
    if !plant.x.is_finite() || !plant.y.is_finite() {
        return Some("its place is no number");
    }
    if !sizes.into_iter().all(is_size) {
        return Some("radius, height and age must be numbers from 0");
    }
    (!(0.0..=1.0).contains(&plant.vigor)).then_some("vigor must lie between 0 and 1")
}

/// Whether a number can be a size or an age.
pub(crate) fn is_size(number: f32) -> bool {
    number.is_finite() && number >= 0.0
}

/// A plant before it stands: what the steps decide.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Spot {
    pub(crate) id: u64,
    pub(crate) x: f64,
    pub(crate) y: f64,
    pub(crate) age: f32,
    pub(crate) vigor: f32,
    pub(crate) yaw: f32,
}

/// Makes a plant of a spot: the ground gives altitude and lean, the allometry size.
pub(crate) fn settle(ground: &Ground<'_>, kind: &Kind<'_>, species: u16, spot: Spot) -> Plant {
    let height = kind.size.height_at(spot.age, spot.vigor);
    let mut plant = Plant {
        id: spot.id,
        species,
        state: State::Free,
        x: spot.x,
        y: spot.y,
        z: 0.0,
        radius: kind.size.radius_of_height(height),
        height,
        age: spot.age,
        vigor: spot.vigor,
        yaw: spot.yaw,
        lean: 0.0,
        lean_azimuth: 0.0,
    };
    stand_on(ground, kind, &mut plant);
    plant
}

/// Puts a plant on the ground at its x and y: altitude and lean.
pub(crate) fn stand_on(ground: &Ground<'_>, kind: &Kind<'_>, plant: &mut Plant) {
    plant.z = ground.altitude(plant.x, plant.y);
    lean_on(ground, kind.upright(), plant);
}

/// Leans a plant: its axis is "a weighted sum of the terrain's normal and the vertical"
/// [Deussen98], of which `upright` is the vertical's weight.
pub(crate) fn lean_on(ground: &Ground<'_>, upright: f32, plant: &mut Plant) {
    let axis = ground.normal(plant.x, plant.y) * (1.0 - upright) + Vec3::Z * upright;
    let across = (axis.x * axis.x + axis.y * axis.y).sqrt();
    plant.lean = libm::atan2f(across, axis.z);
    plant.lean_azimuth = if across > 0.0 {
        libm::atan2f(axis.x, axis.y).rem_euclid(std::f32::consts::TAU)
    } else {
        0.0
    };
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use weald_contract::{Crs, Frame, FromToml, Layers, Value};

    /// A square terrain that rises by `slope` to the east, with soil of moisture 0.5.
    pub(crate) fn ramp(cells: usize, cell: f64, slope: f32) -> Layers {
        let frame = Frame { width: cells, height: cells, cell, west: 0.0, south: 0.0 };
        let mut terrain =
            Layers { frame, crs: Crs::default(), layers: BTreeMap::new(), detail: Vec::new() };
        let altitude = (0..frame.len()).map(|i| slope * frame.center(i % cells, 0).0 as f32);
        terrain.insert("altitude", "m", "height", altitude.collect());
        terrain.insert("soil_moisture", "1", "moisture", vec![0.5; frame.len()]);
        terrain
    }

    /// A species from the text of its tables.
    pub(crate) fn species(text: &str) -> (Species, Ecology) {
        let mut problems = Vec::new();
        let value = Value::parse(0, &format!("form = {{}}\n{text}")).unwrap();
        let species = Species::read(&value, &mut problems).unwrap();
        let ecology = species.ecology.as_ref().map(|e| Ecology::from_toml(e, &mut problems));
        assert_eq!(problems, []);
        (species, ecology.flatten().unwrap_or_default())
    }

    #[test]
    fn the_axis_lies_between_normal_and_vertical() {
        // On a slope of 45 degrees towards the west, a plant leans west (270 degrees).
        let terrain = ramp(20, 1.0, 1.0);
        let ground = Ground::new(&terrain).unwrap();
        let (species, mut ecology) = species("size = { height = 2, crown_radius = 1 }");
        let mut lean = |upright| {
            ecology.upright = upright;
            let kind = Kind { size: &species.size, ecology: &ecology, group: None };
            let spot = Spot { id: 1, x: 10.0, y: 10.0, age: 5.0, vigor: 1.0, yaw: 0.0 };
            let plant = settle(&ground, &kind, 0, spot);
            (plant.lean.to_degrees(), plant.lean_azimuth.to_degrees(), plant.z)
        };
        let (normal, azimuth, z) = lean(0.0);
        assert!((normal - 45.0).abs() < 1e-3 && (azimuth - 270.0).abs() < 1e-3);
        assert!((z - 10.0).abs() < 1e-5);
        assert_eq!(lean(1.0).0, 0.0);
        // Half and half: the sum of two unit vectors halves the angle between them.
        assert!((lean(0.5).0 - 22.5).abs() < 1e-3);
    }
}
