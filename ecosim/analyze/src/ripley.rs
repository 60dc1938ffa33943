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

/// Points whose pairs one task sums. Partial sums are added in order, so the result does not
/// depend on the number of threads.
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
    let sums = pair_sums(pattern, radii, corrections);
    let n = pattern.len() as f64;
    let pairs = pattern.intensity() * (n - 1.0);
    let k = |(correction, sums): (&Correction, Vec<f64>)| match correction {
        Correction::Border => border_ratio(pattern, radii, &sums),
        _ => sums.into_iter().map(|sum| sum / pairs).collect(),
    };
    Ok(corrections.iter().zip(sums).map(k).collect())
}

/// For each correction and radius the weights of all ordered pairs up to that radius.
fn pair_sums(pattern: &Pattern, radii: &[f64], corrections: &[Correction]) -> Vec<Vec<f64>> {
    let reach = radii.last().copied().unwrap_or(0.0);
    let cells = Cells::new(pattern, reach);
    let window = pattern.window();
    let chunk = |first: usize| {
        let mut steps = vec![vec![0.0; radii.len() + 1]; corrections.len()];
        for index in first..(first + CHUNK).min(pattern.len()) {
            let center = cells.points[index];
            let border = window.border_distance(center);
            // First radius at which this point is too near the rim.
            let leaves = radii.partition_point(|r| *r <= border);
            cells.for_near(index, reach, |squared, apart| {
                let distance = squared.sqrt();
                let bin = radii.partition_point(|r| *r < distance);
                for (correction, steps) in corrections.iter().zip(&mut steps) {
                    match correction {
                        Correction::None => steps[bin] += 1.0,
                        Correction::Border if bin < leaves => {
                            steps[bin] += 1.0;
                            steps[leaves] -= 1.0;
                        }
                        Correction::Border => {}
                        Correction::Translation => steps[bin] += translation(window, apart),
                        Correction::Isotropic if border >= distance => steps[bin] += 1.0,
                        Correction::Isotropic => {
                            steps[bin] += isotropic(window, center, distance);
                        }
                    }
                }
            });
        }
        steps
    };
    let firsts: Vec<usize> = (0..pattern.len()).step_by(CHUNK).collect();
    let parts: Vec<Vec<Vec<f64>>> = firsts.into_par_iter().map(chunk).collect();
    let column = |correction: usize| {
        let mut steps = vec![0.0; radii.len()];
        for part in &parts {
            steps.iter_mut().zip(&part[correction]).for_each(|(sum, step)| *sum += step);
        }
        running_sum(steps)
    };
    (0..corrections.len()).map(column).collect()
}

fn running_sum(mut values: Vec<f64>) -> Vec<f64> {
    let mut sum = 0.0;
    for value in &mut values {
        sum += *value;
        *value = sum;
    }
    values
}

/// K by the border method: pairs about the points that are at least r inside, over their number.
fn border_ratio(pattern: &Pattern, radii: &[f64], pairs: &[f64]) -> Vec<f64> {
    let mut borders: Vec<f64> =
        pattern.points().iter().map(|point| pattern.window().border_distance(*point)).collect();
    borders.sort_by(f64::total_cmp);
    let k = |(r, pairs): (&f64, &f64)| {
        let inside = borders.len() - borders.partition_point(|border| border < r);
        pairs / (pattern.intensity() * inside as f64)
    };
    radii.iter().zip(pairs).map(k).collect()
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

pub(crate) fn k_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    let theo: Vec<f64> = radii.iter().map(|r| PI * r * r).collect();
    let mut columns = vec![("r", radii.to_vec()), ("theo", theo)];
    let ks = ks(pattern, radii, &ALL)?;
    columns.extend(ALL.iter().map(|correction| correction.word()).zip(ks));
    Ok(Table { name: "K", columns })
}

pub(crate) fn l_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    let mut table = k_table(pattern, radii)?;
    table.name = "L";
    for (name, values) in &mut table.columns {
        match *name {
            "r" => {}
            "theo" => values.copy_from_slice(radii),
            _ => values.iter_mut().for_each(|k| *k = (*k / PI).sqrt()),
        }
    }
    Ok(table)
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
const KERNEL_WIDTH: f64 = 0.15;

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
    check_radii(radii)?;
    let half_width = KERNEL_WIDTH / pattern.intensity().sqrt();
    let reach = radii.last().copied().unwrap_or(0.0) + half_width;
    let cells = Cells::new(pattern, reach);
    let chunk = |first: usize| {
        let mut sums = vec![0.0; radii.len()];
        for index in first..(first + CHUNK).min(pattern.len()) {
            cells.for_near(index, reach, |squared, apart| {
                let distance = squared.sqrt();
                let weight = translation(pattern.window(), apart);
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
    let firsts: Vec<usize> = (0..pattern.len()).step_by(CHUNK).collect();
    let parts: Vec<Vec<f64>> = firsts.into_par_iter().map(chunk).collect();
    let pairs = pattern.intensity() * (pattern.len() as f64 - 1.0);
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

pub(crate) fn pcf_table(pattern: &Pattern, radii: &[f64]) -> Result<Table, Error> {
    let trans = pair_correlation(pattern, radii, Divisor::Radius)?;
    let columns = vec![("r", radii.to_vec()), ("theo", vec![1.0; radii.len()]), ("trans", trans)];
    Ok(Table { name: "pcf", columns })
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
