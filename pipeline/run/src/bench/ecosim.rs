//! Ecosim: self-thinning, a simulated stand, and relaxation.

use super::{Figure, Size, best, given, table, wrong};
use crate::error::Result;
use crate::scene::SceneSpecies;
use std::collections::BTreeMap;
use std::path::Path;
use weald_contract::{Crs, Frame, Grid, Layers, Seed, Silent};

/// The bare competition of [Deussen98] §5.1: what is dominated dies, what lives grows.
///
/// Unless circles are given, there is one to a square metre, with a radius of 2 to 10 cm.
pub(super) fn self_thinning(size: &Size, input: Option<&Path>) -> Result<Figure> {
    const YEARS: u32 = 20;
    const GROWTH: f32 = 0.01;
    let circles = match input {
        Some(path) => given::circles(path)?,
        None => {
            let side = f64::from(size.first_plants).sqrt();
            let mut chance = Seed(1).stream("circles", 0);
            (0..size.first_plants)
                .map(|_| {
                    let [x, y, radius] =
                        [(0.0, side), (0.0, side), (0.02, 0.1)].map(|(a, b)| chance.range(a, b));
                    given::circle(x, y, radius as f32)
                })
                .collect()
        }
    };
    let (time, (steps, living)) = best(size, || {
        let (mut circles, mut steps) = (circles.clone(), 0);
        for _ in 0..YEARS {
            steps += circles.len();
            let (plain, order) = (weald_ecosim::Plain::Open, weald_ecosim::Order::Sync);
            let over = weald_ecosim::dominators(&circles, plain, order, |_| false);
            let mut over = over.iter();
            circles.retain(|_| over.next().is_some_and(Option::is_none));
            for circle in &mut circles {
                circle.radius += GROWTH;
                circle.ability = circle.radius;
            }
        }
        Ok((steps, circles.len()))
    })?;
    let input = format!("{} circles at first, {YEARS} years", circles.len());
    let figure = Figure::rate("self-thinning", steps as f64, "plant-steps/s", time, input);
    Ok(figure.with(living as f64))
}

pub(super) fn plant_steps(size: &Size, species: &BTreeMap<String, SceneSpecies>) -> Result<Figure> {
    // A hectare for a thousand plants: crowns meet after a few years, as in a wood.
    let side = (f64::from(size.first_plants) * 10.0).sqrt() as usize;
    let terrain = plain(side);
    let text = format!(
        "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\"]\nyears = {}\ninitial = {}\n",
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
