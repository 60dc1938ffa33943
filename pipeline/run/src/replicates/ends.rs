//! What a simulation left, a few numbers a species.

use std::f64::consts::PI;
use weald_analyze::{Pattern, Window, clark_evans};
use weald_contract::{Frame, Plant};
use weald_ecosim::{Inequality, Outcome};

/// Names of the numbers, in the order of [`End::values`].
pub(super) const MEASURES: [&str; 14] = [
    "plants",
    "density",
    "cover",
    "mean_radius",
    "mean_height",
    "mean_age",
    "gini",
    "cv",
    "clark_evans",
    "births",
    "dominated",
    "old",
    "disturbed",
    "seeds",
];

/// One species at the end of a simulation.
pub(super) struct End {
    pub(super) species: String,
    /// See [`MEASURES`]; NaN where there are too few plants to tell.
    pub(super) values: [f64; MEASURES.len()],
}

/// Measures every species.
pub(super) fn measure(outcome: &Outcome, frame: &Frame) -> Vec<End> {
    let population = &outcome.population;
    let mut own: Vec<Vec<&Plant>> = vec![Vec::new(); population.species.len()];
    for plant in &population.plants {
        own[usize::from(plant.species)].push(plant);
    }
    let names = population.species.iter().zip(own).enumerate();
    names
        .map(|(index, (species, plants))| {
            let values = values(index as u16, &plants, outcome, frame);
            End { species: species.clone(), values }
        })
        .collect()
}

fn values(
    species: u16,
    plants: &[&Plant],
    outcome: &Outcome,
    frame: &Frame,
) -> [f64; MEASURES.len()] {
    let area = frame.len() as f64 * frame.cell_area();
    let n = plants.len() as f64;
    // 0 / 0 is no number: nothing has no mean.
    let mean = |of: fn(&Plant) -> f32| plants.iter().map(|p| f64::from(of(p))).sum::<f64>() / n;
    let crowns: f64 = plants.iter().map(|plant| PI * f64::from(plant.radius).powi(2)).sum();
    let sizes = Inequality::of_circles(plants.iter().map(|plant| plant.radius).collect());
    let unequal = |value: f32| if plants.len() < 2 { f64::NAN } else { f64::from(value) };
    let rows = || outcome.summary.iter().filter(move |row| row.species == species);
    let seeds = rows().next_back().map_or(0, |row| row.seeds);
    [
        n,
        n / area,
        crowns / area,
        mean(|plant| plant.radius),
        mean(|plant| plant.height),
        mean(|plant| plant.age),
        unequal(sizes.gini),
        unequal(sizes.variation),
        evenness(plants, frame),
        rows().map(|row| row.births).sum::<u64>() as f64,
        rows().map(|row| row.dominated).sum::<u64>() as f64,
        rows().map(|row| row.old).sum::<u64>() as f64,
        rows().map(|row| row.disturbed).sum::<u64>() as f64,
        seeds as f64,
    ]
}

/// The index of Clark and Evans with Donnelly's correction for the rim.
fn evenness(plants: &[&Plant], frame: &Frame) -> f64 {
    let window = Window { x: [frame.west, frame.east()], y: [frame.south, frame.north()] };
    let inside = plants.iter().map(|plant| [plant.x, plant.y]).filter(|at| window.contains(*at));
    let pattern = Pattern::new(inside.collect(), window);
    pattern.and_then(|pattern| clark_evans(&pattern)).map_or(f64::NAN, |found| found.donnelly)
}
