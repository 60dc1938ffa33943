//! What quantization saved, and how far the plants moved for it.

use crate::codebook::Codebook;
use crate::features::LEAST_HEIGHT;
use crate::palette::{Place, Standing};
use crate::table::Table;
use serde::Serialize;
use std::fmt;
use weald_contract::{Instances, Palette, Representative};

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
    /// Plants of the scene that are farthest from their models, the worst first.
    pub worst_plants: Vec<WorstPlant>,
}

/// A plant of the scene that its model stands for poorly.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct WorstPlant {
    /// Its id.
    pub plant: u64,
    /// Id of its representative.
    pub representative: u32,
    /// Distance from the centre of its cluster in the space of comparison.
    pub distance: f64,
    /// Height before the instance is scaled, as a part of the representative's.
    pub height: f64,
}

/// How often prototypes of one kind stand in the scene and in groups.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Level {
    /// `plants` or `groups`.
    pub level: &'static str,
    /// Prototypes stored.
    pub prototypes: u64,
    /// Rows of instances that refer to them.
    pub instances: u64,
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
    /// Plants, then groups.
    pub levels: Vec<Level>,
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
            worst_plants: worst_plants(plants, table, book, chosen, number),
        }
    }
}

/// Worst plants that are told of each species.
const WORST: usize = 3;

fn worst_plants(
    plants: &[Standing],
    table: &Table,
    book: &Codebook,
    chosen: &[Representative],
    number: &[usize],
) -> Vec<WorstPlant> {
    let of_plant = |(index, plant): (usize, &Standing)| {
        let Place::Scene { id, .. } = plant.place else { return None };
        let label = book.labels[index] as usize;
        let pairs = table.row(index).iter().zip(book.centre(label));
        let squares: f64 = pairs.map(|(value, centre)| (value - centre).powi(2)).sum();
        let model = &chosen[number[label]];
        let height = plant.traits.height.max(LEAST_HEIGHT);
        Some(WorstPlant {
            plant: id,
            representative: model.id,
            distance: squares.sqrt(),
            height: f64::from(height) / f64::from(model.height),
        })
    };
    let mut all: Vec<WorstPlant> = plants.iter().enumerate().filter_map(of_plant).collect();
    let worse = |a: &WorstPlant, b: &WorstPlant| {
        b.distance.total_cmp(&a.distance).then(a.plant.cmp(&b.plant))
    };
    if all.len() > WORST {
        all.select_nth_unstable_by(WORST, worse);
        all.truncate(WORST);
    }
    all.sort_by(worse);
    all
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
        instances: &Instances,
        plants: usize,
    ) -> Self {
        let models = palette.representatives.len();
        let of_models = instances.prototype.iter().filter(|id| **id as usize <= models).count();
        let level = |level, prototypes: usize, instances: usize| Level {
            level,
            prototypes: prototypes as u64,
            instances: instances as u64,
        };
        let levels = vec![
            level("plants", models, of_models),
            level("groups", palette.groups.len(), instances.len() - of_models),
        ];
        let seen = species.iter().map(|species| species.seen).sum();
        Self {
            plants: plants as u64,
            groups: palette.groups.len() as u64,
            representatives: palette.representatives.len() as u64,
            instances: instances.len() as u64,
            seen,
            compression: ratio(seen, palette.representatives.len()),
            species,
            levels,
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
