//! The plants of a scene: a row a plant.

use crate::grid::Crs;
use std::collections::BTreeMap;

/// How a plant stands at the end of a step.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
#[repr(u8)]
pub enum State {
    /// Alive and not overlapped by a stronger plant.
    #[default]
    Free = 0,
    /// Alive, but overlapped by a stronger plant.
    Dominated = 1,
    /// Alive, at its limit of size or age.
    Old = 2,
}

impl State {
    /// The state with this number.
    pub fn from_u8(number: u8) -> Option<Self> {
        [Self::Free, Self::Dominated, Self::Old].get(usize::from(number)).copied()
    }

    /// The word for this state in a file.
    pub fn word(self) -> &'static str {
        ["free", "dominated", "old"][self as usize]
    }
}

/// One plant.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Plant {
    /// Stable number, unique in its population.
    pub id: u64,
    /// Index into [`Population::species`].
    pub species: u16,
    /// Whether it stands free, dominated or old.
    pub state: State,
    /// Map coordinates, m.
    pub x: f64,
    /// Map coordinates, m.
    pub y: f64,
    /// Altitude of the ground it stands on, m.
    pub z: f32,
    /// Crown radius, m.
    pub radius: f32,
    /// Height, m.
    pub height: f32,
    /// Age, years.
    pub age: f32,
    /// Vigor in [0, 1].
    pub vigor: f32,
    /// Turn about its own axis, radians counter-clockwise seen from above.
    pub yaw: f32,
    /// Angle between its axis and the vertical, radians.
    pub lean: f32,
    /// Direction towards which it leans, radians clockwise from north.
    pub lean_azimuth: f32,
}

/// Names of the columns that every table of plants has, or that files keep for themselves: no
/// further column may have one of them.
pub const PLANT_COLUMNS: [&str; 14] = [
    "id",
    "species",
    "x",
    "y",
    "z",
    "radius",
    "height",
    "age",
    "vigor",
    "state",
    "yaw_deg",
    "lean_deg",
    "lean_azimuth_deg",
    "geometry",
];

/// All plants of a scene, in the order of their ids.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Population {
    /// Names of the species; plants refer to them by index.
    pub species: Vec<String>,
    /// The plants.
    pub plants: Vec<Plant>,
    /// Further columns by name, one value a plant.
    pub extra: BTreeMap<String, Vec<f32>>,
    /// Reference system of the map coordinates.
    pub crs: Crs,
}

impl Population {
    /// Number of plants.
    pub fn len(&self) -> usize {
        self.plants.len()
    }

    /// Whether nothing grows.
    pub fn is_empty(&self) -> bool {
        self.plants.is_empty()
    }

    /// Index of a species' name, added if it is new.
    pub fn species_index(&mut self, name: &str) -> u16 {
        let found = self.species.iter().position(|known| known == name);
        found.unwrap_or_else(|| {
            self.species.push(name.into());
            self.species.len() - 1
        }) as u16
    }

    /// Number of plants of each species, in the order of `species`.
    pub fn counts(&self) -> Vec<usize> {
        let mut counts = vec![0; self.species.len()];
        for plant in &self.plants {
            counts[usize::from(plant.species)] += 1;
        }
        counts
    }
}
