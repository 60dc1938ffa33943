//! Ecosim: self-thinning, a simulated stand, and relaxation.

use super::{Figure, Size, best, given, table, wrong};
use crate::error::Result;
use crate::scene::SceneSpecies;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Layers, Seed, Silent};
use weald_ecosim::self_thinning::{Rules, Stem, Thinning};
use weald_ecosim::{Edge, Growth, Order};

/// Steps of self-thinning, and growth in each, m.
const STEPS: u32 = 20;
const GROWTH: f64 = 0.01;

/// Self-thinning [Deussen98] §5.1: what is dominated dies, what lives grows.
///
/// Unless circles are given, there is one to a square metre, with a radius of 2 to 10 cm.
pub(super) fn self_thinning(size: &Size, input: Option<&Path>) -> Result<Figure> {
    match input {
        Some(path) => {
            let stems = given::stems(path)?;
            let extent = stems.iter().fold(0.0f64, |most, stem| most.max(stem.x).max(stem.y));
            thin("self-thinning", size, extent * 1.001 + 1.0, stems.into_iter())
        }
        None => thin("self-thinning", size, side(size), stand(size.first_plants, 0.0)),
    }
}

/// Self-thinning with one plant in a thousand fifty times as large.
pub(super) fn giants(size: &Size) -> Result<Figure> {
    thin("self-thinning, giants", size, side(size), stand(size.first_plants, 50.0))
}

fn side(size: &Size) -> f64 {
    f64::from(size.first_plants).sqrt()
}

/// Plants one to a square metre; every thousandth is `giant` times as large, unless that is 0.
fn stand(count: u32, giant: f32) -> impl Iterator<Item = Stem> + Clone {
    let (side, mut chance) = (f64::from(count).sqrt(), Seed(1).stream("circles", 0));
    (0..count).map(move |id| {
        let [x, y, radius] =
            [(0.0, side), (0.0, side), (0.02, 0.1)].map(|(a, b)| chance.range(a, b));
        let is_giant = giant > 0.0 && id % 1000 == 0;
        Stem { id, x, y, radius: radius as f32 * if is_giant { giant } else { 1.0 } }
    })
}

fn thin(
    name: &'static str,
    size: &Size,
    side: f64,
    stems: impl Iterator<Item = Stem> + Clone,
) -> Result<Figure> {
    let rules = Rules {
        size: [side, side],
        edge: Edge::Open,
        order: Order::Sync,
        growth: Growth { rate: GROWTH, ..Growth::default() },
        limit: f32::INFINITY,
        seed: Seed(1),
    };
    let (time, (first, steps, living)) = best(size, || {
        let mut thinning = Thinning::new(rules.clone(), stems.clone());
        let (first, mut steps) = (thinning.len(), 0);
        for _ in 0..STEPS {
            steps += thinning.len();
            thinning.look();
            thinning.advance();
        }
        Ok((first, steps, thinning.len()))
    })?;
    let input = format!("{first} circles at first, {STEPS} steps");
    let figure = Figure::rate(name, steps as f64, "plant-steps/s", time, input);
    Ok(figure.with(living as f64))
}

pub(super) fn plant_steps(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Figure> {
    // A hectare for a thousand plants: crowns meet after a few years, as in a wood.
    let side = (f64::from(size.first_plants) * 10.0).sqrt() as usize;
    let terrain = plain(side);
    let text = format!(
        "max_plants = 4000000000\n[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\"]\nyears = {}\n\
         initial = {}\n",
        size.years, size.first_plants
    );
    let config: weald_ecosim::Config = table(&text)?;
    let aspen = &species["aspen"];
    let known =
        [("aspen".to_string(), (aspen.species.clone(), aspen.ecology.clone().unwrap_or_default()))];
    let known = BTreeMap::from(known);
    let around = weald_ecosim::Surroundings {
        terrain: &terrain,
        species: &known,
        images: &BTreeMap::new(),
        plants: &BTreeMap::new(),
        views: &[],
    };
    let (time, outcome) =
        best(size, || weald_ecosim::grow(&config, &around, None, Seed(1), &Silent).map_err(wrong))?;
    let steps: u64 = outcome.summary.iter().filter(|row| row.step > 0).map(|row| row.alive).sum();
    let input = format!("{} plants at first, {} years", size.first_plants, size.years);
    Ok(Figure::rate("simulation", steps as f64, "plant-steps/s", time, input))
}

/// The terrain of a stand: a level plain, moist in the middle.
pub(super) fn plain(side: usize) -> Layers {
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let mut layers =
        Layers { frame, crs: Crs::default(), layers: BTreeMap::new(), detail: Vec::new() };
    for (name, unit, value) in [
        ("altitude", "m", 100.0),
        ("slope", "degree", 0.0),
        ("aspect", "degree", 0.0),
        ("water_depth", "m", 0.0),
        ("soil_moisture", "1", 0.5),
    ] {
        layers.insert(name, unit, "the same everywhere", vec![value; frame.len()]);
    }
    layers
}

pub(super) fn lloyd(size: &Size) -> Result<Figure> {
    let side = (size.points as f64).sqrt() as usize;
    let frame = Frame { width: side, height: side, cell: 1.0, west: 0.0, south: 0.0 };
    let density = Grid::filled(frame, 1.0);
    let mut chance = Seed(1).stream("points", 0);
    let points: Vec<[f64; 2]> = (0..size.points)
        .map(|_| [chance.range(0.0, side as f64), chance.range(0.0, side as f64)])
        .collect();
    let (time, _) = best(size, || {
        let mut moved = points.clone();
        weald_ecosim::relax(&mut moved, &density, &weald_ecosim::Relaxation::pass(0, 1));
        Ok(moved)
    })?;
    let input = format!("{} points, one pass", size.points);
    Ok(Figure::rate("Lloyd relaxation", size.points as f64, "points/s", time, input))
}
