//! What quantization saved, and how far the plants moved for it.

use crate::codebook::Codebook;
use crate::features::LEAST_HEIGHT;
use crate::groups::Patches;
use crate::palette::Standing;
use crate::table::Table;
use serde::Serialize;
use std::fmt;
use weald_contract::{Palette, Representative};

/// Distance between plants and their representatives in one parameter.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Drift {
    /// Weighted mean.
    pub mean: f64,
    /// The worst plant's.
    pub worst: f64,
}

/// One species.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SpeciesReport {
    /// Name.
    pub species: String,
    /// Plants in the scene and placements in patches.
    pub plants: u64,
    /// Plants that are seen: a placement counts as often as its patch stands in the scene.
    pub seen: f64,
    /// Models to grow.
    pub representatives: u64,
    /// Weighted mean of squared distances in the space of comparison.
    pub distortion: f64,
    /// Age, years.
    pub age: Drift,
    /// Vigor.
    pub vigor: Drift,
    /// Height before the instance is scaled, as a part of the representative's.
    pub height: Drift,
    /// Plants seen for each model grown.
    pub compression: f64,
}

/// All species.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Report {
    /// By name.
    pub species: Vec<SpeciesReport>,
    /// Rows of the scene.
    pub plants: u64,
    /// Patches built.
    pub groups: u64,
    /// Models to grow.
    pub representatives: u64,
    /// Rows of instances, those inside patches included.
    pub instances: u64,
    /// Plants that are seen, through all levels.
    pub seen: f64,
    /// Plants seen for each model grown.
    pub compression: f64,
}

impl SpeciesReport {
    pub(crate) fn of(
        name: &str,
        plants: &[Standing],
        table: &Table,
        book: &Codebook,
        chosen: &[Representative],
        number: &[usize],
    ) -> Self {
        let drift = |apart: &dyn Fn(&Standing, &Representative) -> f64| {
            let apart = plants
                .iter()
                .zip(&book.labels)
                .map(|(plant, label)| apart(plant, &chosen[number[*label as usize]]));
            Drift::of(apart.zip(table.weights().iter().copied()))
        };
        let between = |a: f32, b: f32| (f64::from(a) - f64::from(b)).abs();
        let seen = plants.iter().map(|plant| plant.seen).sum();
        Self {
            species: name.to_owned(),
            plants: plants.len() as u64,
            seen,
            representatives: chosen.len() as u64,
            distortion: book.distortion(table),
            age: drift(&|plant, of| between(plant.traits.age, of.age)),
            vigor: drift(&|plant, of| between(plant.traits.vigor, of.vigor)),
            height: drift(&|plant, of| {
                let height = plant.traits.height.max(LEAST_HEIGHT);
                between(height, of.height) / f64::from(of.height)
            }),
            compression: ratio(seen, chosen.len()),
        }
    }
}

impl Drift {
    /// Mean and worst of distances with weights; the plain mean when no weight is above 0.
    fn of(apart: impl Iterator<Item = (f64, f64)>) -> Self {
        let (mut worst, mut sum, mut total, mut plain, mut count) = (0.0f64, 0.0, 0.0, 0.0, 0.0);
        for (apart, weight) in apart {
            worst = worst.max(apart);
            sum += weight * apart;
            total += weight;
            plain += apart;
            count += 1.0;
        }
        let mean = if total > 0.0 { sum / total } else { plain / f64::max(count, 1.0) };
        Self { mean, worst }
    }
}

fn ratio(seen: f64, representatives: usize) -> f64 {
    if representatives == 0 { 0.0 } else { seen / representatives as f64 }
}

impl Report {
    pub(crate) fn of(
        species: Vec<SpeciesReport>,
        palette: &Palette,
        plants: usize,
        patches: &Patches,
    ) -> Self {
        let inside: usize = patches.patches.iter().map(|patch| patch.members.len()).sum();
        let seen = species.iter().map(|species| species.seen).sum();
        Self {
            plants: plants as u64,
            groups: palette.groups.len() as u64,
            representatives: palette.representatives.len() as u64,
            instances: (plants + inside) as u64,
            seen,
            compression: ratio(seen, palette.representatives.len()),
            species,
        }
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let width = self.species.iter().map(|s| s.species.chars().count()).max().unwrap_or(0);
        let width = width.max("species".len());
        writeln!(
            f,
            "{:width$} {:>12} {:>14} {:>6} {:>15} {:>15} {:>15} {:>12}",
            "species", "placed", "seen", "grown", "age, years", "vigor", "height, %", "compression"
        )?;
        let drift = |d: &Drift, scale: f64, digits: usize| {
            format!("{:.digits$} / {:.digits$}", d.mean * scale, d.worst * scale)
        };
        for s in &self.species {
            writeln!(
                f,
                "{:width$} {:>12} {:>14.0} {:>6} {:>15} {:>15} {:>15} {:>10.0}:1",
                s.species,
                s.plants,
                s.seen,
                s.representatives,
                drift(&s.age, 1.0, 2),
                drift(&s.vigor, 1.0, 3),
                drift(&s.height, 100.0, 1),
                s.compression
            )?;
        }
        writeln!(
            f,
            "{:width$} {:>12} {:>14.0} {:>6} {:>15} {:>15} {:>15} {:>10.0}:1",
            "all", self.instances, self.seen, self.representatives, "", "", "", self.compression
        )?;
        write!(f, "{} patches; drift of plants from their models as mean / worst", self.groups)
    }
}
