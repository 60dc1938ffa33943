//! Sample plots: counts on small areas become a density for the whole ground.

use crate::PlotFit;
use crate::config::Plots;
use crate::stand::Stand;
use crate::steps::Site;
use crate::{Error, align, density};
use rayon::prelude::*;
use weald_contract::{Grid, Layers, Population, Problem, Written};

/// Most cells of the raster of densities between plots; they vary no faster than plots lie.
const MOST_CELLS: f64 = 65_536.0;
/// Bandwidths tried, as parts of the mean distance between neighbouring plots.
const BANDWIDTHS: [f64; 8] = [0.35, 0.5, 0.71, 1.0, 1.41, 2.0, 2.83, 4.0];
/// Weight that all plots have everywhere, as a part of a plot's own: far from all of them, the
/// density is their mean.
const FAR: f64 = 1e-9;

/// A plot: what was counted on how much ground.
#[derive(Clone, Copy, Debug)]
struct Plot {
    at: [f64; 2],
    area: f64,
    count: f64,
}

/// Adds the layer that the step names.
pub(crate) fn run<'a>(
    step: &'a Plots,
    site: &Site<'a>,
    stand: &mut Stand<'a>,
) -> Result<(), Error> {
    site.progress.begin("plots", 1, "layers");
    let species = stand.species_of(&step.species)?;
    let table = table_of(&step.plots, site)?;
    let layer = density(&step.plots, table, species, stand, site.around.terrain)?;
    stand.layers.insert(&step.layer.value, layer);
    site.progress.advance(1);
    Ok(())
}

/// Returns the table of plots that a path names.
pub(crate) fn table_of<'a>(
    path: &Written<String>,
    site: &Site<'a>,
) -> Result<&'a Population, Problem> {
    site.around
        .plants
        .get(&path.value)
        .ok_or_else(|| Problem::at(path.span, format!("the table `{}` was not read", path.value)))
}

/// Returns the density of a species between the plots of a table, plants per m².
///
/// The table names `x`, `y` (map coordinates of the middle), `species`, `count`, and the size of the
/// plot: `area` (m²), or `radius` of a circle, or `width` and perhaps `length` of a rectangle (m).
/// The estimate is the ratio of weighted counts to weighted areas, with Gaussian weights whose
/// width predicts the plots best when each is left out in turn.
pub(crate) fn density(
    path: &Written<String>,
    table: &Population,
    species: u16,
    stand: &mut Stand<'_>,
    around: &Layers,
) -> Result<Grid, Error> {
    let terrain = &around.frame;
    let plots = read(path, table, &stand.population.species[usize::from(species)], around)?;
    let fit = best(&plots);
    let (width, height) = (terrain.east() - terrain.west, terrain.north() - terrain.south);
    let cell = terrain.cell.max((width * height / MOST_CELLS).sqrt());
    let frame = density::covering(terrain, cell);
    let values = (0..frame.len())
        .into_par_iter()
        .map(|cell| {
            let (x, y) = frame.center(cell % frame.width, cell / frame.width);
            estimate(&plots, None, [x, y], fit.bandwidth) as f32
        })
        .collect();
    stand.plot_fits.push(PlotFit { species, ..fit });
    Ok(Grid { frame, values })
}

fn read(
    path: &Written<String>,
    table: &Population,
    species: &str,
    terrain: &Layers,
) -> Result<Vec<Plot>, Error> {
    let wrong = |message: String| Problem::at(path.span, format!("`{}`: {message}", path.value));
    let hint = "a table of plots has x, y, species, count, and area (m²), radius or width (m)";
    let lacks = |name: &str| wrong(format!("there is no column `{name}`")).hint(hint);
    let counts = table.extra.get("count").ok_or_else(|| lacks("count"))?;
    let is_sized = table.plants.iter().any(|plant| !plant.radius.is_nan());
    if !is_sized && !["area", "width"].iter().any(|name| table.extra.contains_key(*name)) {
        return Err(lacks("area").into());
    }
    let places = align::places(path, table, None, terrain)?;
    let mut plots = Vec::new();
    for (row, plant) in table.plants.iter().enumerate() {
        if table.species.get(usize::from(plant.species)).is_none_or(|name| name != species) {
            continue;
        }
        let (area, count) = (area(table, row), f64::from(counts[row]));
        let is_sound = area > 0.0 && area.is_finite() && count >= 0.0 && count.is_finite();
        if !is_sound || places[row].iter().any(|along| !along.is_finite()) {
            let message = format!("row {}: area {area}, count {count}", row + 1);
            return Err(wrong(message).hint("areas lie above 0, counts at or above it").into());
        }
        plots.push(Plot { at: places[row], area, count });
    }
    if plots.is_empty() {
        return Err(wrong(format!("no plot counts `{species}`")).into());
    }
    Ok(plots)
}

/// Returns a plot's area, m²: as it is told, or a circle's, or a rectangle's.
fn area(table: &Population, row: usize) -> f64 {
    let told = |name: &str| {
        let value = table.extra.get(name).map(|column| f64::from(column[row]));
        value.filter(|value| !value.is_nan())
    };
    let radius = f64::from(table.plants[row].radius);
    let circle = (!radius.is_nan()).then_some(std::f64::consts::PI * radius * radius);
    let rectangle = || {
        let width = told("width")?;
        Some(width * told("length").unwrap_or(width))
    };
    told("area").or(circle).or_else(rectangle).unwrap_or(f64::NAN)
}

/// Returns the density at a place from all plots but one.
fn estimate(plots: &[Plot], without: Option<usize>, [x, y]: [f64; 2], bandwidth: f64) -> f64 {
    let (mut count, mut area) = (0.0, 0.0);
    for (_, plot) in plots.iter().enumerate().filter(|(index, _)| Some(*index) != without) {
        let squared = (plot.at[0] - x).powi(2) + (plot.at[1] - y).powi(2);
        let weight = libm::exp(-0.5 * squared / (bandwidth * bandwidth)) + FAR;
        count += weight * plot.count;
        area += weight * plot.area;
    }
    if area > 0.0 { count / area } else { 0.0 }
}

/// Finds the width that predicts left-out plots best, by the root mean square of density errors
/// weighted by area.
fn best(plots: &[Plot]) -> PlotFit {
    let spacing = mean_spacing(plots);
    let fit = |part: &f64| {
        let bandwidth = part * spacing;
        let off = |(index, plot): (usize, &Plot)| {
            let error = estimate(plots, Some(index), plot.at, bandwidth) - plot.count / plot.area;
            plot.area * error * error
        };
        let area: f64 = plots.iter().map(|plot| plot.area).sum();
        let error = (plots.iter().enumerate().map(off).sum::<f64>() / area).sqrt();
        PlotFit { species: 0, plots: plots.len() as u64, bandwidth, error }
    };
    let fits = BANDWIDTHS.iter().map(fit);
    let better = |a: PlotFit, b: PlotFit| if b.error < a.error { b } else { a };
    fits.reduce(better).unwrap_or_default()
}

/// Returns the mean distance of plots from the nearest other one; 1 m for a single plot.
fn mean_spacing(plots: &[Plot]) -> f64 {
    let nearest = |(index, plot): (usize, &Plot)| {
        let others = plots.iter().enumerate().filter(move |(other, _)| *other != index);
        let squared = |(_, o): (usize, &Plot)| {
            (o.at[0] - plot.at[0]).powi(2) + (o.at[1] - plot.at[1]).powi(2)
        };
        others.map(squared).fold(f64::INFINITY, f64::min).sqrt()
    };
    let distances = plots.iter().enumerate().map(nearest).filter(|d| d.is_finite() && *d > 0.0);
    let (sum, count) = distances.fold((0.0, 0), |(sum, count), d| (sum + d, count + 1));
    if count == 0 { 1.0 } else { sum / f64::from(count) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn grid(mut count: impl FnMut(f64, f64) -> f64) -> Vec<Plot> {
        let place = |i: usize| [(i % 8) as f64 * 10.0, (i / 8) as f64 * 10.0];
        (0..64)
            .map(|i| Plot { at: place(i), area: 4.0, count: count(place(i)[0], place(i)[1]) })
            .collect()
    }

    #[test]
    fn equal_plots_give_their_density_everywhere_without_error() {
        let plots = grid(|_, _| 12.0);
        let fit = best(&plots);
        assert!(fit.error < 1e-12);
        assert!((estimate(&plots, None, [500.0, -300.0], fit.bandwidth) - 3.0).abs() < 1e-12);
    }

    #[test]
    fn a_gradient_is_followed_and_noise_is_smoothed() {
        // Counts of 4 to 32 along x: 1 to 8 plants per m².
        let smooth = grid(|x, _| 4.0 + 0.4 * x);
        let fit = best(&smooth);
        let middle = estimate(&smooth, None, [35.0, 35.0], fit.bandwidth);
        assert!((middle - 4.5).abs() < 0.3, "{middle}");
        let mut stream = weald_contract::Seed(3).stream("noise", 0);
        let noisy = best(&grid(|_, _| 12.0 + (8.0 * stream.unit() - 4.0)));
        assert!(noisy.bandwidth > fit.bandwidth);
        // Uniform noise of 4 on 4 m²: a standard deviation of 1/√3 per m² cannot be predicted.
        assert!((0.4..0.8).contains(&noisy.error), "{}", noisy.error);
    }
}
