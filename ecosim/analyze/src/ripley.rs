//! Ripley's K, Besag's L and the pair correlation: what stands at which distance of a plant.
//!
//! For a point pattern of density λ, λ K(r) is the mean number of further points within r of a
//! point [Ripley77]; L(r) = sqrt(K(r) / π) is r where points are spread at random [Besag77]; g(r)
//! is K'(r) / 2πr. Points near the rim miss neighbours that were not observed; edge corrections
//! weight the observed ones up [Baddeley16] chapter 7.

use crate::neighbors::Cells;
use crate::pattern::{Error, Pattern, Table, Window, check_radii};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};

weald_contract::words! {
    /// What is done about neighbours outside the window.
    pub enum Correction {
        /// Nothing: too low at large distances.
        None = "un",
        /// Only points farther than r from the rim count as centres [Ripley88].
        Border = "border",
        /// A pair counts by the share of the window that a pair of this offset fits into [Ohser83].
        Translation = "trans",
        /// A pair counts by the share of the circle through the neighbour that is inside [Ripley77].
        Isotropic = "iso",
    }
}

/// The four corrections in the order of the tables' columns.
const ALL: [Correction; 4] =
    [Correction::None, Correction::Border, Correction::Translation, Correction::Isotropic];

/// Largest weight of a pair: beyond it one pair would outvote all others. As in spatstat.
const MOST_WEIGHT: f64 = 100.0;

/// Points whose pairs one task sums.
const CHUNK: usize = 1024;

/// Ripley's K at rising radii.
///
/// Pairs at a distance of exactly r count. NaN where the border method has no point left.
///
/// # Errors
/// Fewer than two points; radii that are not finite, negative or not rising.
pub fn ripley_k(
    pattern: &Pattern,
    radii: &[f64],
    correction: Correction,
) -> Result<Vec<f64>, Error> {
    Ok(ks(pattern, radii, &[correction])?.swap_remove(0))
}

/// K for several corrections in one pass over the pairs.
fn ks(
    pattern: &Pattern,
    radii: &[f64],
    corrections: &[Correction],
) -> Result<Vec<Vec<f64>>, Error> {
    pattern.check_pairs()?;
    check_radii(radii)?;
    let cells = Cells::new(pattern, reach_of(radii));
    let sums = Around::itself(pattern, &cells).sums(radii, corrections, |_, _| 1.0);
    let n = pattern.len() as f64;
    let pairs = pattern.intensity() * (n - 1.0);
    let k = |(correction, sums): (&Correction, Vec<f64>)| match correction {
        Correction::Border => border_ratio(pattern, radii, &sums, |_| pattern.intensity()),
        _ => sums.into_iter().map(|sum| sum / pairs).collect(),
    };
    Ok(corrections.iter().zip(sums).map(k).collect())
}

/// Cross K for several corrections: pairs of a point of one pattern with one of another.
fn cross_ks(
    from: &Pattern,
    to: &Pattern,
    radii: &[f64],
    corrections: &[Correction],
) -> Result<Vec<Vec<f64>>, Error> {
    check_cross(from, to)?;
    check_radii(radii)?;
    let cells = Cells::new(to, reach_of(radii));
    let sums = Around::others(from, &cells).sums(radii, corrections, |_, _| 1.0);
    let pairs = from.intensity() * to.len() as f64;
    let k = |(correction, sums): (&Correction, Vec<f64>)| match correction {
        Correction::Border => border_ratio(from, radii, &sums, |_| to.intensity()),
        _ => sums.into_iter().map(|sum| sum / pairs).collect(),
    };
    Ok(corrections.iter().zip(sums).map(k).collect())
}

/// Refuses two patterns that have no pair or were not observed in one window.
pub(crate) fn check_cross(from: &Pattern, to: &Pattern) -> Result<(), Error> {
    let found = from.len().min(to.len());
    if found == 0 {
        return Err(Error::TooFew { what: "points of a type", found, needed: 1 });
    }
    if from.window() != to.window() {
        return Err(Error::Windows);
    }
    Ok(())
}

/// K of points whose density varies from place to place: 1 / λ is the weight of a point
/// [BaddeleyMW00].
///
/// One of the two weights of a pair is scaled so that all sum to the area, as spatstat does by
/// default: an error of the overall level enters once and not twice. With the constant intensity
/// n / A this is K with n² in place of n (n - 1).
fn inhomogeneous_ks(
    pattern: &Pattern,
    intensity: &[f64],
    radii: &[f64],
    corrections: &[Correction],
) -> Result<Vec<Vec<f64>>, Error> {
    pattern.check_pairs()?;
    check_radii(radii)?;
    let weights = intensity_weights(pattern, intensity)?;
    let cells = Cells::new(pattern, reach_of(radii));
    // In the order of the cells, in which pairs are met.
    let sorted: Vec<f64> = cells.numbers.iter().map(|number| weights[*number]).collect();
    let sums =
        Around::itself(pattern, &cells).sums(radii, corrections, |i, j| sorted[i] * sorted[j]);
    let area = pattern.window().area();
    let level = area / weights.iter().sum::<f64>();
    let k = |(correction, sums): (&Correction, Vec<f64>)| match correction {
        Correction::Border => {
            let k = border_ratio(pattern, radii, &sums, |point| weights[point]);
            k.into_iter().map(|k| k * level).collect()
        }
        _ => sums.into_iter().map(|sum| sum * level / area).collect(),
    };
    Ok(corrections.iter().zip(sums).map(k).collect())
}

fn intensity_weights(pattern: &Pattern, intensity: &[f64]) -> Result<Vec<f64>, Error> {
    if intensity.len() != pattern.len() {
        return Err(Error::Unmatched { sizes: intensity.len(), points: pattern.len() });
    }
    let weight = |(row, value): (usize, &f64)| {
        let right = "a finite number above 0 is right";
        let error = Error::BadValue { what: "the intensity", row, value: *value, right };
        if value.is_finite() && *value > 0.0 { Ok(1.0 / value) } else { Err(error) }
    };
    intensity.iter().enumerate().map(weight).collect()
}

/// The largest radius.
fn reach_of(radii: &[f64]) -> f64 {
    radii.last().copied().unwrap_or(0.0)
}

/// Centres, and the points that are looked for around them.
struct Around<'a> {
    centers: &'a [[f64; 2]],
    window: &'a Window,
    cells: &'a Cells,
    /// Whether centres are the points of the cells, in their order: none is its own neighbour.
    is_itself: bool,
}

impl<'a> Around<'a> {
    fn itself(pattern: &'a Pattern, cells: &'a Cells) -> Self {
        Self { centers: &cells.points, window: pattern.window(), cells, is_itself: true }
    }

    fn others(from: &'a Pattern, cells: &'a Cells) -> Self {
        Self { centers: from.points(), window: from.window(), cells, is_itself: false }
    }

    /// Runs `add` over all centres in chunks; what each chunk gathers, in order.
    ///
    /// Partial sums are added in this order, so nothing depends on the number of threads.
    fn in_chunks<T: Send>(&self, gather: impl Fn(std::ops::Range<usize>) -> T + Sync) -> Vec<T> {
        let n = self.centers.len();
        let firsts: Vec<usize> = (0..n).step_by(CHUNK).collect();
        firsts.into_par_iter().map(|first| gather(first..(first + CHUNK).min(n))).collect()
    }

    /// Visits the neighbours of a centre with their number, squared distance and offset.
    fn visit(&self, center: usize, reach: f64, mut visit: impl FnMut(usize, f64, [f64; 2])) {
        self.cells.for_around(self.centers[center], reach, |other, squared, apart| {
            if !(self.is_itself && other == center) {
                visit(other, squared, apart);
            }
        });
    }

    /// For each correction and radius the weights of all ordered pairs up to that radius.
    fn sums(
        &self,
        radii: &[f64],
        corrections: &[Correction],
        weight: impl Fn(usize, usize) -> f64 + Sync,
    ) -> Vec<Vec<f64>> {
        let reach = reach_of(radii);
        let chunk = |centers: std::ops::Range<usize>| {
            let mut steps = vec![vec![0.0; radii.len() + 1]; corrections.len()];
            for index in centers {
                let center = self.centers[index];
                let border = self.window.border_distance(center);
                // First radius at which this point is too near the rim.
                let leaves = radii.partition_point(|r| *r <= border);
                self.visit(index, reach, |other, squared, apart| {
                    let distance = squared.sqrt();
                    let bin = radii.partition_point(|r| *r < distance);
                    let pair = weight(index, other);
                    for (correction, steps) in corrections.iter().zip(&mut steps) {
                        match correction {
                            Correction::None => steps[bin] += pair,
                            Correction::Border if bin < leaves => {
                                steps[bin] += pair;
                                steps[leaves] -= pair;
                            }
                            Correction::Border => {}
                            Correction::Translation => {
                                steps[bin] += pair * translation(self.window, apart);
                            }
                            Correction::Isotropic if border >= distance => steps[bin] += pair,
                            Correction::Isotropic => {
                                steps[bin] += pair * isotropic(self.window, center, distance);
                            }
                        }
                    }
                });
            }
            steps
        };
        let parts = self.in_chunks(chunk);
        let column = |correction: usize| {
            let mut steps = vec![0.0; radii.len()];
            for part in &parts {
                steps.iter_mut().zip(&part[correction]).for_each(|(sum, step)| *sum += step);
            }
            running_sum(steps)
        };
        (0..corrections.len()).map(column).collect()
    }
}

fn running_sum(mut values: Vec<f64>) -> Vec<f64> {
    let mut sum = 0.0;
    for value in &mut values {
        sum += *value;
        *value = sum;
    }
    values
}

/// K by the border method: weights of the pairs about the points that are at least r inside, over
/// the weights of those points.
fn border_ratio(
    pattern: &Pattern,
    radii: &[f64],
    pairs: &[f64],
    weight: impl Fn(usize) -> f64,
) -> Vec<f64> {
    let mut borders: Vec<(f64, f64)> = pattern
        .points()
        .iter()
        .enumerate()
        .map(|(index, point)| (pattern.window().border_distance(*point), weight(index)))
        .collect();
    borders.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total = running_sum(borders.iter().map(|(_, weight)| *weight).collect());
    let k = |(r, pairs): (&f64, &f64)| match borders.partition_point(|(border, _)| border >= r) {
        0 => f64::NAN,
        inside => pairs / total[inside - 1],
    };
    radii.iter().zip(pairs).map(k).collect()
}

/// Weight of a pair by an edge correction that weights pairs, and 1 by the others.
pub(crate) fn pair_weight(
    correction: Correction,
    window: &Window,
    center: [f64; 2],
    distance: f64,
    apart: [f64; 2],
) -> f64 {
    match correction {
        Correction::None | Correction::Border => 1.0,
        Correction::Translation => translation(window, apart),
        Correction::Isotropic if window.border_distance(center) >= distance => 1.0,
        Correction::Isotropic => isotropic(window, center, distance),
    }
}

/// Weight of a pair by the window's overlap with itself, moved by the pair's offset.
fn translation(window: &Window, apart: [f64; 2]) -> f64 {
    let overlap = (window.width() - apart[0].abs()) * (window.height() - apart[1].abs());
    (window.area() / overlap).min(MOST_WEIGHT)
}

/// Weight of a pair by the part of the circle about `center` through the neighbour that lies
/// inside the window.
///
/// Each side cuts off the directions within `acos(h / d)` of its normal, but only as far as the
/// corners: beyond them the next side is the one that cuts.
fn isotropic(window: &Window, center: [f64; 2], distance: f64) -> f64 {
    let [west, east] = [center[0] - window.x[0], window.x[1] - center[0]];
    let [south, north] = [center[1] - window.y[0], window.y[1] - center[1]];
    let cut = |to_side: f64, to_next: [f64; 2]| {
        if to_side >= distance {
            return 0.0;
        }
        let half_angle = libm::acos(to_side / distance);
        to_next.map(|next| half_angle.min(to_corner(to_side, next))).iter().sum()
    };
    let outside: f64 = cut(west, [south, north])
        + cut(east, [south, north])
        + cut(south, [west, east])
        + cut(north, [west, east]);
    let inside = 1.0 - outside / TAU;
    // A circle wholly outside gives no weight to measure; rounding may leave a hair.
    if inside > 1.0 / MOST_WEIGHT { 1.0 / inside } else { MOST_WEIGHT }
}

/// Angle between the normal of a side and the corner with the next one.
fn to_corner(to_side: f64, to_next: f64) -> f64 {
    // A point in the corner itself: the two sides share the right angle between their normals.
    if to_side == 0.0 && to_next == 0.0 { PI / 4.0 } else { libm::atan2(to_next, to_side) }
}

fn table_of(name: &'static str, radii: &[f64], ks: Vec<Vec<f64>>) -> Table {
    let theo: Vec<f64> = radii.iter().map(|r| PI * r * r).collect();
    let mut columns = vec![("r", radii.to_vec()), ("theo", theo)];
    columns.extend(ALL.iter().map(|correction| correction.word()).zip(ks));
    Table { name, columns }
}

pub(crate) fn k_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    Ok(table_of("K", radii, ks(pattern, radii, &ALL)?))
}

/// The table of L from that of K.
pub(crate) fn l_of(mut table: Table) -> Table {
    table.name = "L";
    let radii = table.columns[0].1.clone();
    for (name, values) in &mut table.columns {
        match *name {
            "r" => {}
            "theo" => values.copy_from_slice(&radii),
            _ => values.iter_mut().for_each(|k| *k = (*k / PI).sqrt()),
        }
    }
    table
}

/// Cross K: λ of `to` times it is the mean number of points of `to` within r of one of `from`.
///
/// Columns as those of K. Where the types are spread independently it is `π r²`. `border` looks at
/// the distances themselves, as for one type; spatstat does so by bins of the radii here.
///
/// # Errors
/// A pattern without a point; two windows; radii that are not finite, negative or not rising.
pub fn cross_k_table(from: &Pattern, to: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    Ok(table_of("K", radii, cross_ks(from, to, radii, &ALL)?))
}

/// Cross L: `sqrt(K / π)` of [`cross_k_table`].
///
/// # Errors
/// See [`cross_k_table`].
pub fn cross_l_table(from: &Pattern, to: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    Ok(l_of(cross_k_table(from, to, radii)?))
}

/// K relative to a density that varies, given at each point [BaddeleyMW00].
///
/// Columns as those of K; the theory of points that are independent, given the density, is
/// `π r²`. One of the two weights `1 / λ` of a pair is scaled so that all sum to the area, as
/// spatstat does by default.
///
/// # Errors
/// Fewer than two points; another number of densities than of points, or one that is not positive,
/// named by its row; radii that are not finite, negative or not rising.
pub fn inhomogeneous_k_table(
    pattern: &Pattern,
    intensity: &[f64],
    radii: &[f64],
) -> Result<Table, Error> {
    Ok(table_of("Kinhom", radii, inhomogeneous_ks(pattern, intensity, radii, &ALL)?))
}

weald_contract::words! {
    /// Which length the ring's circumference is taken of in the pair correlation.
    pub enum Divisor {
        /// The radius asked for: infinite at 0 where a pair is near.
        Radius = "r",
        /// The pair's own distance: less bias near 0; coincident points are left out.
        Distance = "d",
    }
}

/// Half width of the kernel times the square root of the density, after [Stoyan94].
pub(crate) const KERNEL_WIDTH: f64 = 0.15;

/// The pair correlation at rising radii, translation-corrected.
///
/// The exact sum over pairs of Epanechnikov's kernel of half width `0.15 / sqrt(λ)`; spatstat
/// takes it from a binned density and is 0.1 to 1 % off this sum.
///
/// # Errors
/// Fewer than two points; radii that are not finite, negative or not rising.
pub fn pair_correlation(
    pattern: &Pattern,
    radii: &[f64],
    divisor: Divisor,
) -> Result<Vec<f64>, Error> {
    pattern.check_pairs()?;
    let half_width = KERNEL_WIDTH / pattern.intensity().sqrt();
    let cells = Cells::new(pattern, reach_of(radii) + half_width);
    let pairs = pattern.intensity() * (pattern.len() as f64 - 1.0);
    Around::itself(pattern, &cells).correlation(radii, half_width, pairs, divisor)
}

/// The pair correlation of points of `from` with points of `to`, translation-corrected.
///
/// The kernel's half width is `0.15 / sqrt(λ)` of `to`.
///
/// # Errors
/// A pattern without a point; two windows; radii that are not finite, negative or not rising.
pub fn cross_pair_correlation(
    from: &Pattern,
    to: &Pattern,
    radii: &[f64],
    divisor: Divisor,
) -> Result<Vec<f64>, Error> {
    check_cross(from, to)?;
    let half_width = KERNEL_WIDTH / to.intensity().sqrt();
    let cells = Cells::new(to, reach_of(radii) + half_width);
    let pairs = from.intensity() * to.len() as f64;
    Around::others(from, &cells).correlation(radii, half_width, pairs, divisor)
}

impl Around<'_> {
    /// Kernel sums over pairs, over the circumference and `pairs`, the number of pairs there would
    /// be in a unit of area.
    fn correlation(
        &self,
        radii: &[f64],
        half_width: f64,
        pairs: f64,
        divisor: Divisor,
    ) -> Result<Vec<f64>, Error> {
        check_radii(radii)?;
        let reach = reach_of(radii) + half_width;
        let directions = if self.is_itself { 2.0 } else { 1.0 };
        let chunk = |centers: std::ops::Range<usize>| {
            let mut sums = vec![0.0; radii.len()];
            for index in centers {
                self.visit(index, reach, |other, squared, apart| {
                    // Both directions of a pair weigh alike: each is met once and counted twice.
                    if self.is_itself && other < index {
                        return;
                    }
                    let distance = squared.sqrt();
                    let weight = directions * translation(self.window, apart);
                    let weight = match divisor {
                        Divisor::Radius => weight,
                        Divisor::Distance if distance > 0.0 => weight / distance,
                        Divisor::Distance => return,
                    };
                    let from = radii.partition_point(|r| *r <= distance - half_width);
                    for (r, sum) in radii[from..].iter().zip(&mut sums[from..]) {
                        let t = (r - distance) / half_width;
                        if t >= 1.0 {
                            break;
                        }
                        *sum += weight * (1.0 - t * t);
                    }
                });
            }
            sums
        };
        let parts = self.in_chunks(chunk);
        let scale = 0.75 / half_width / (TAU * pairs);
        let g = |row: usize| match parts.iter().map(|part| part[row]).sum::<f64>() {
            0.0 => 0.0,
            sum => match divisor {
                Divisor::Radius => scale * sum / radii[row],
                Divisor::Distance => scale * sum,
            },
        };
        Ok((0..radii.len()).map(g).collect())
    }
}

fn pcf_of(radii: &[f64], trans: Vec<f64>) -> Table {
    let columns = vec![("r", radii.to_vec()), ("theo", vec![1.0; radii.len()]), ("trans", trans)];
    Table { name: "pcf", columns }
}

pub(crate) fn pcf_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    Ok(pcf_of(radii, pair_correlation(pattern, radii, Divisor::Radius)?))
}

/// [`cross_pair_correlation`] as a table `r, theo, trans`.
///
/// # Errors
/// See [`cross_pair_correlation`].
pub fn cross_pcf_table(from: &Pattern, to: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    Ok(pcf_of(radii, cross_pair_correlation(from, to, radii, Divisor::Radius)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SQUARE: Window = Window { x: [0.0, 2.0], y: [0.0, 2.0] };

    #[test]
    fn circles_cut_by_sides_and_corners_weigh_what_geometry_says() {
        // About the middle of a side half the circle is outside; in a corner three quarters.
        assert!((isotropic(&SQUARE, [0.0, 1.0], 0.5) - 2.0).abs() < 1e-12);
        assert!((isotropic(&SQUARE, [0.0, 0.0], 0.5) - 4.0).abs() < 1e-12);
        // About the centre, of radius sqrt(2), it touches the window only at the corners.
        assert_eq!(isotropic(&SQUARE, [1.0, 1.0], 2f64.sqrt()), MOST_WEIGHT);
        // Of radius 2/sqrt(3) each side cuts off 60 degrees: a third remains.
        assert!((isotropic(&SQUARE, [1.0, 1.0], 2.0 / 3f64.sqrt()) - 3.0).abs() < 1e-9);
    }

    #[test]
    fn two_points_have_the_k_of_their_one_pair() {
        let pattern = Pattern::new(vec![[0.5, 1.0], [1.5, 1.0]], SQUARE).unwrap();
        let at = |correction| ripley_k(&pattern, &[0.9, 1.0], correction).unwrap();
        // Area over n (n - 1), times two ordered pairs, from the distance 1 on.
        assert_eq!(at(Correction::None), [0.0, 4.0]);
        // The window moved by 1 overlaps by half.
        assert_eq!(at(Correction::Translation), [0.0, 8.0]);
        assert!(at(Correction::Border).iter().all(|k| k.is_nan()));
    }

    #[test]
    fn coincident_points_are_pairs_at_distance_zero() {
        let pattern = Pattern::new(vec![[1.0, 1.0]; 3], SQUARE).unwrap();
        for correction in ALL {
            let expected = if correction == Correction::Border { 8.0 / 3.0 } else { 4.0 };
            let k = ripley_k(&pattern, &[0.0, 0.5], correction).unwrap();
            assert!(k.iter().all(|k| (k - expected).abs() < 1e-12), "{correction:?} {k:?}");
        }
        let g = pair_correlation(&pattern, &[0.0, 0.1], Divisor::Radius).unwrap();
        assert!(g[0].is_infinite() && g[1] > 0.0);
    }

    #[test]
    fn fewer_than_two_points_have_no_pairs() {
        let one = Pattern::new(vec![[1.0, 1.0]], SQUARE).unwrap();
        let error = ripley_k(&one, &[1.0], Correction::None).unwrap_err();
        assert_eq!(error, Error::TooFew { what: "points", found: 1, needed: 2 });
    }
}
