//! Distances to the nearest neighbour: their distribution G, and the index of Clark and Evans.

use crate::neighbors::Cells;
use crate::pattern::{Error, Pattern, Table, check_radii};
use rayon::prelude::*;
use std::f64::consts::PI;

/// A point's distances to its nearest neighbour and to the rim.
#[derive(Clone, Copy)]
struct Reach {
    nearest: f64,
    border: f64,
}

impl Reach {
    /// Whether the neighbour is surely the nearest: none outside can be nearer.
    fn is_sure(self) -> bool {
        self.nearest <= self.border
    }
}

fn reaches(pattern: &Pattern) -> Vec<Reach> {
    let cells = Cells::new(pattern, 0.0);
    let reach = |index: usize| Reach {
        nearest: cells.nearest(index),
        border: pattern.window().border_distance(cells.points[index]),
    };
    (0..pattern.len()).into_par_iter().map(reach).collect()
}

/// Distances from each point to its nearest neighbour, in no order that matters.
pub fn nearest_distances_unsorted(pattern: &Pattern) -> Vec<f64> {
    reaches(pattern).into_iter().map(|reach| reach.nearest).collect()
}

/// Nearest-neighbour distances against those of points spread at random [ClarkEvans54].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ClarkEvans {
    /// Mean distance over `1 / (2 sqrt(λ))`: below 1 clustered, above 1 regular. Points at the
    /// rim miss neighbours, so it is too high.
    pub naive: f64,
    /// The same over the mean that random points in this rectangle have [Donnelly78].
    pub donnelly: f64,
    /// Mean distance to the nearest neighbour.
    pub mean_distance: f64,
}

/// The index of Clark and Evans.
///
/// # Errors
/// Fewer than two points.
pub fn clark_evans(pattern: &Pattern) -> Result<ClarkEvans, Error> {
    pattern.check_pairs()?;
    let n = pattern.len() as f64;
    let mean_distance = nearest_distances_unsorted(pattern).iter().sum::<f64>() / n;
    let expected = 0.5 / pattern.intensity().sqrt();
    // Donnelly's coefficients, fitted by simulation.
    let rim = (0.0514 + 0.0412 / n.sqrt()) * pattern.window().perimeter() / n;
    Ok(ClarkEvans {
        naive: mean_distance / expected,
        donnelly: mean_distance / (expected + rim),
        mean_distance,
    })
}

/// G at rising radii, in the forms that spatstat gives on the same radii.
///
/// `rs` (reduced sample) and `km` [BaddeleyGill97] look at the rim and at deaths by bins of the
/// radii, as spatstat does; on coarse radii they differ from the forms on the distances
/// themselves by up to 0.03. `han` is Hanisch's [Hanisch84], scaled to end at 1.
pub(crate) fn g_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    pattern.check_pairs()?;
    check_radii(radii)?;
    let reaches = reaches(pattern);
    let n = pattern.len() as f64;
    let sure: Vec<Reach> = reaches.iter().copied().filter(|reach| reach.is_sure()).collect();
    // Points whose distance falls into the bin that ends at each radius, summed up to it.
    let up_to = |distances: &mut dyn Iterator<Item = f64>| {
        let mut sorted: Vec<f64> = distances.collect();
        sorted.sort_by(f64::total_cmp);
        let count = |r: &f64| sorted.partition_point(|distance| distance <= r) as f64;
        radii.iter().map(count).collect::<Vec<f64>>()
    };
    let all = up_to(&mut reaches.iter().map(|reach| reach.nearest));
    let events = up_to(&mut sure.iter().map(|reach| reach.nearest));
    let sure_borders = up_to(&mut sure.iter().map(|reach| reach.border));
    let borders = up_to(&mut reaches.iter().map(|reach| reach.border));
    let watched = up_to(&mut reaches.iter().map(|reach| reach.nearest.min(reach.border)));

    let before = |sums: &[f64], row: usize| if row == 0 { 0.0 } else { sums[row - 1] };
    let in_bin = |row: usize| events[row] - before(&events, row);
    let rows = 0..radii.len();
    let rs = rows
        .clone()
        .map(|row| (events[row] - before(&sure_borders, row)) / (n - before(&borders, row)));
    let survival = rows.clone().scan(1.0, |alive, row| {
        let at_risk = n - before(&watched, row);
        if at_risk > 0.0 {
            *alive *= 1.0 - in_bin(row) / at_risk;
        }
        Some(1.0 - *alive)
    });
    let theo = |r: &f64| -libm::expm1(-pattern.intensity() * PI * r * r);
    Ok(Table {
        name: "G",
        columns: vec![
            ("r", radii.to_vec()),
            ("theo", radii.iter().map(theo).collect()),
            ("raw", all.iter().map(|count| count / n).collect()),
            ("rs", rs.collect()),
            ("km", survival.collect()),
            ("han", hanisch(pattern, radii, in_bin)),
        ],
    })
}

/// Each sure distance counts by the area in which a point may have it, less the rim.
fn hanisch(pattern: &Pattern, radii: &[f64], in_bin: impl Fn(usize) -> f64) -> Vec<f64> {
    let window = pattern.window();
    let eroded =
        |r: f64| (window.width() - 2.0 * r).max(0.0) * (window.height() - 2.0 * r).max(0.0);
    let mut sum = 0.0;
    let mut sums = Vec::with_capacity(radii.len());
    for (row, r) in radii.iter().enumerate() {
        // Nothing is sure where no area is left.
        if in_bin(row) > 0.0 {
            sum += in_bin(row) / eroded(*r);
        }
        sums.push(sum);
    }
    let largest = sums.iter().copied().filter(|sum| sum.is_finite()).fold(0.0, f64::max);
    sums.into_iter().map(|sum| sum / largest).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Window;

    #[test]
    fn a_square_lattice_has_twice_the_distances_of_random_points() {
        let points = (0..100).map(|i| [(i % 10) as f64 + 0.5, (i / 10) as f64 + 0.5]).collect();
        let window = Window { x: [0.0, 10.0], y: [0.0, 10.0] };
        let index = clark_evans(&Pattern::new(points, window).unwrap()).unwrap();
        // All distances are 1, the density is 1, and random points have 1/2.
        assert_eq!((index.naive, index.mean_distance), (2.0, 1.0));
        assert!(index.donnelly < index.naive);
    }

    #[test]
    fn g_steps_from_none_to_all_at_the_distance_of_a_lattice() {
        let points = (0..100).map(|i| [(i % 10) as f64 + 0.5, (i / 10) as f64 + 0.5]).collect();
        let window = Window { x: [0.0, 10.0], y: [0.0, 10.0] };
        let pattern = Pattern::new(points, window).unwrap();
        let table = g_table(&pattern, &[0.0, 0.9, 1.1]).unwrap();
        for name in ["raw", "km", "han"] {
            assert_eq!(table.column(name).unwrap(), [0.0, 0.0, 1.0], "{name}");
        }
    }
}
