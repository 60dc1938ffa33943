//! Distances to the nearest point: from points (G), from anywhere (F), their comparison (J), and
//! the index of Clark and Evans.

use crate::neighbors::Cells;
use crate::pattern::{Error, Pattern, Table, check_radii};
use crate::ripley::check_cross;
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
pub(crate) fn g_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    pattern.check_pairs()?;
    check_radii(radii)?;
    let forms = Forms::of(pattern, &reaches(pattern), radii);
    Ok(forms.table("G", "han", random_g(pattern, radii), radii))
}

/// Cross G: distribution of the distance from points of `from` to the nearest point of `to`.
///
/// Columns as those of G; `theo` is for points of `to` spread at random.
///
/// # Errors
/// A pattern without a point; two windows; radii that are not finite, negative or not rising.
pub fn cross_g_table(from: &Pattern, to: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    check_cross(from, to)?;
    check_radii(radii)?;
    let reaches = reaches_from(from.points(), to);
    Ok(Forms::of(to, &reaches, radii).table("G", "han", random_g(to, radii), radii))
}

/// The reduced sample and the Kaplan-Meier form of G on the distances themselves, not on bins.
///
/// Columns `r, theo, rs, km`. The forms of `G` look at rim and neighbours only at the radii, as
/// spatstat does; on coarse radii they differ from these by up to 0.03.
///
/// # Errors
/// Fewer than two points; radii that are not finite, negative or not rising.
pub fn continuous_g_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    pattern.check_pairs()?;
    check_radii(radii)?;
    let reaches = reaches(pattern);
    let columns = vec![
        ("r", radii.to_vec()),
        ("theo", random_g(pattern, radii)),
        ("rs", reduced_sample(&reaches, radii)),
        ("km", kaplan_meier(&reaches, radii)),
    ];
    Ok(Table { name: "G.continuous", columns })
}

/// Of the points at least r from the rim, the part whose neighbour is within r.
fn reduced_sample(reaches: &[Reach], radii: &[f64]) -> Vec<f64> {
    let mut borders: Vec<f64> = reaches.iter().map(|reach| reach.border).collect();
    borders.sort_by(f64::total_cmp);
    // A point counts at the radii from its distance to the neighbour to that to the rim.
    let mut steps = vec![0.0; radii.len() + 1];
    for reach in reaches.iter().filter(|reach| reach.is_sure()) {
        steps[radii.partition_point(|r| *r < reach.nearest)] += 1.0;
        steps[radii.partition_point(|r| *r <= reach.border)] -= 1.0;
    }
    let mut events = 0.0;
    let part = |(r, step): (&f64, &f64)| {
        events += step;
        events / (borders.len() - borders.partition_point(|border| border < r)) as f64
    };
    radii.iter().zip(&steps).map(part).collect()
}

/// One less the product over the distances up to r of the part of points that go on beyond each.
fn kaplan_meier(reaches: &[Reach], radii: &[f64]) -> Vec<f64> {
    let mut sorted = reaches.to_vec();
    let seen = |reach: &Reach| reach.nearest.min(reach.border);
    // At equal distance neighbours come before the rim: those points were still watched.
    sorted.sort_by(|a, b| seen(a).total_cmp(&seen(b)).then(b.is_sure().cmp(&a.is_sure())));
    let (mut alive, mut next) = (1.0, 0);
    let mut survival = Vec::with_capacity(radii.len());
    for r in radii {
        while next < sorted.len() && seen(&sorted[next]) <= *r {
            let at_risk = (sorted.len() - next) as f64;
            if sorted[next].is_sure() {
                // Ties one after the other multiply to the same as at once.
                alive *= 1.0 - 1.0 / at_risk;
            }
            next += 1;
        }
        survival.push(1.0 - alive);
    }
    survival
}

/// Test places along the longer side of the window for F.
const PLACES: usize = 256;

/// F at rising radii: distribution of the distance from any place to the nearest point.
///
/// Places are the centres of a grid of cells as square as the window allows, 256 along its longer
/// side; distances are exact. Columns `r, theo, raw, rs, km, cs`, where `cs` is the form of Chiu
/// and Stoyan [ChiuStoyan98], which weights a distance by the area in which it can be sure.
pub(crate) fn f_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    check_cross(pattern, pattern)?;
    check_radii(radii)?;
    Ok(empty_space(pattern, radii).table("F", "cs", random_g(pattern, radii), radii))
}

fn empty_space(pattern: &Pattern, radii: &[f64]) -> Forms {
    let window = pattern.window();
    let longer = window.width().max(window.height());
    let along = |length: f64| ((PLACES as f64 * length / longer).ceil() as usize).clamp(1, PLACES);
    let [columns, rows] = [along(window.width()), along(window.height())];
    let place = |number: usize| {
        let [column, row] = [number % columns, number / columns].map(|cell| cell as f64 + 0.5);
        [
            window.x[0] + column / columns as f64 * window.width(),
            window.y[0] + row / rows as f64 * window.height(),
        ]
    };
    let places: Vec<[f64; 2]> = (0..columns * rows).map(place).collect();
    Forms::of(pattern, &reaches_from(&places, pattern), radii)
}

/// J at rising radii, `(1 - G) / (1 - F)` [VanLieshout96]: 1 for points spread at random, less in
/// clusters, more where points keep apart.
///
/// Columns `r, theo, un, rs, km, han`; `han` is Hanisch's G over Chiu and Stoyan's F. NaN from the
/// radius on at which no place is left that far from a point.
pub(crate) fn j_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    pattern.check_pairs()?;
    check_radii(radii)?;
    let g = Forms::of(pattern, &reaches(pattern), radii);
    let f = empty_space(pattern, radii);
    let j = |g: &[f64], f: &[f64]| {
        let ratio = |(g, f): (&f64, &f64)| if *f < 1.0 { (1.0 - g) / (1.0 - f) } else { f64::NAN };
        g.iter().zip(f).map(ratio).collect::<Vec<f64>>()
    };
    let columns = vec![
        ("r", radii.to_vec()),
        ("theo", vec![1.0; radii.len()]),
        ("un", j(&g.raw, &f.raw)),
        ("rs", j(&g.reduced, &f.reduced)),
        ("km", j(&g.kaplan_meier, &f.kaplan_meier)),
        ("han", j(&g.weighted, &f.weighted)),
    ];
    Ok(Table { name: "J", columns })
}

/// The distribution that points spread at random with the density of a pattern have.
fn random_g(pattern: &Pattern, radii: &[f64]) -> Vec<f64> {
    radii.iter().map(|r| -libm::expm1(-pattern.intensity() * PI * r * r)).collect()
}

/// Distances from places to the nearest point, and to the rim.
fn reaches_from(places: &[[f64; 2]], to: &Pattern) -> Vec<Reach> {
    let cells = Cells::new(to, 0.0);
    let reach = |place: &[f64; 2]| Reach {
        nearest: cells.nearest_to(*place, None),
        border: to.window().border_distance(*place),
    };
    places.par_iter().map(reach).collect()
}

/// A distribution of distances at rising radii, in the forms of spatstat.
///
/// `reduced` (reduced sample) and `kaplan_meier` [BaddeleyGill97] look at the rim and at events by
/// bins of the radii. `weighted` is Hanisch's form [Hanisch84] of G or Chiu and Stoyan's of F,
/// scaled to end at 1.
struct Forms {
    raw: Vec<f64>,
    reduced: Vec<f64>,
    kaplan_meier: Vec<f64>,
    weighted: Vec<f64>,
}

impl Forms {
    fn of(pattern: &Pattern, reaches: &[Reach], radii: &[f64]) -> Self {
        let n = reaches.len() as f64;
        let sure: Vec<Reach> = reaches.iter().copied().filter(|reach| reach.is_sure()).collect();
        // Numbers of distances up to each radius.
        let up_to = |distances: &mut dyn Iterator<Item = f64>| {
            let mut sorted: Vec<f64> = distances.collect();
            sorted.sort_unstable_by(f64::total_cmp);
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
        let survival = rows.scan(1.0, |alive, row| {
            let at_risk = n - before(&watched, row);
            if at_risk > 0.0 {
                *alive *= 1.0 - in_bin(row) / at_risk;
            }
            Some(1.0 - *alive)
        });
        Self {
            raw: all.iter().map(|count| count / n).collect(),
            reduced: rs.collect(),
            kaplan_meier: survival.collect(),
            weighted: hanisch(pattern, radii, in_bin),
        }
    }

    fn table(
        self,
        name: &'static str,
        weighted: &'static str,
        theo: Vec<f64>,
        radii: &[f64],
    ) -> Table {
        let columns = vec![
            ("r", radii.to_vec()),
            ("theo", theo),
            ("raw", self.raw),
            ("rs", self.reduced),
            ("km", self.kaplan_meier),
            (weighted, self.weighted),
        ];
        Table { name, columns }
    }
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
