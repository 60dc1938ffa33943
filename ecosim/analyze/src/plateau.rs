//! The time in which a stand thins along its line: from canopy closure until it breaks up.
//!
//! Along the line density times mean crown area, the cover, is constant. Before, crowns grow
//! without touching and cover rises: a fit that begins there is too steep. The plateau is sought
//! by densities and not by time, since a stand spends most of its years at low density.

use crate::pattern::Error;
use crate::thinning::StandState;
use std::fmt;

/// When a stand's cover was level.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Plateau {
    /// The level of cover.
    pub cover: f64,
    /// Densities in which cover was level, lowest and highest, both included.
    pub densities: [f64; 2],
    /// First and last row.
    pub rows: [usize; 2],
}

/// Classes of density in a factor of ten.
const CLASSES: f64 = 20.0;

/// Classes whose mean cover is so near are on one level; sparse stands scatter by some percent.
const NEAR: f64 = 0.05;

/// Part of the level from which on it counts as reached. At 97 % the local slope of the
/// simplest model of circles is within a hundredth of its limit.
const REACHED: f64 = 0.97;

/// Least ratio of the densities at both ends: a shorter plateau may be a bend.
const LEAST_RATIO: f64 = 1.5;

/// A class of densities: mean cover.
struct Class {
    number: i64,
    cover: f64,
}

/// Finds the plateau of cover in a stand's history, a density and a cover a row, in order of time.
///
/// The level is the one that most classes of density share, twenty a decade; the plateau runs from
/// the first row that has 97 % of it to the last class that is within 5 % of it.
///
/// # Errors
/// Another number of covers than of densities; fewer than three rows in which both are positive
/// and finite; no level that holds while density falls by a third.
pub fn plateau(densities: &[f64], covers: &[f64]) -> Result<Plateau, Error> {
    if densities.len() != covers.len() {
        return Err(Error::Unmatched { sizes: covers.len(), points: densities.len() });
    }
    let rows: Vec<(usize, f64, f64)> = (densities.iter().zip(covers).enumerate())
        .map(|(row, (density, cover))| (row, *density, *cover))
        .filter(|(_, d, c)| d.is_finite() && c.is_finite() && *d > 0.0 && *c > 0.0)
        .collect();
    if rows.len() < 3 {
        let what = "states with plants and cover";
        return Err(Error::TooFew { what, found: rows.len(), needed: 3 });
    }
    let classes = classes(&rows);
    let level = level(&classes);
    let is_level = |class: &&Class| (class.cover / level - 1.0).abs() <= NEAR;
    let last_class = classes.iter().rev().find(is_level).map_or(i64::MIN, |class| class.number);
    let reached = rows.iter().find(|(_, _, cover)| *cover >= REACHED * level);
    let last = rows.iter().rev().find(|(_, density, _)| class_of(*density) == last_class);
    match (reached, last) {
        (Some(first), Some(last)) if first.0 < last.0 && first.1 >= LEAST_RATIO * last.1 => {
            Ok(Plateau { cover: level, densities: [last.1, first.1], rows: [first.0, last.0] })
        }
        _ => Err(Error::NoPlateau { last: rows[rows.len() - 1].2 }),
    }
}

/// Classes of falling density, numbered upwards.
fn class_of(density: f64) -> i64 {
    (-CLASSES * libm::log10(density)).floor() as i64
}

fn classes(rows: &[(usize, f64, f64)]) -> Vec<Class> {
    let mut sorted: Vec<(i64, f64)> =
        rows.iter().map(|(_, density, cover)| (class_of(*density), *cover)).collect();
    // Stable: covers of a class stay in order of time, and their sum does not depend on luck.
    sorted.sort_by_key(|(number, _)| *number);
    let class = |rows: &[(i64, f64)]| Class {
        number: rows[0].0,
        cover: rows.iter().map(|(_, cover)| cover).sum::<f64>() / rows.len() as f64,
    };
    sorted.chunk_by(|a, b| a.0 == b.0).map(class).collect()
}

/// The cover that most classes are near to; of several, the higher.
fn level(classes: &[Class]) -> f64 {
    let near = |level: f64| {
        let covers = classes.iter().map(|class| class.cover);
        covers.filter(|cover| (cover / level - 1.0).abs() <= NEAR).collect::<Vec<f64>>()
    };
    let all = classes.iter().map(|class| near(class.cover));
    let mean = |covers: &[f64]| covers.iter().sum::<f64>() / covers.len() as f64;
    let best = all.max_by(|a, b| a.len().cmp(&b.len()).then(mean(a).total_cmp(&mean(b))));
    best.map_or(f64::NAN, |covers| mean(&covers))
}

/// A fit that begins while cover still rises.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct EarlyStart {
    /// Density from which on the fit uses states.
    pub density: f64,
    /// Cover there, as part of the plateau's.
    pub cover: f64,
    /// Density from which on cover is level.
    pub level_from: f64,
}

impl Plateau {
    /// Whether a fit to the states of densities below `high` begins too early.
    ///
    /// A tenth above the plateau's begin is taken as meaning it.
    pub fn early_start(&self, densities: &[f64], covers: &[f64], high: f64) -> Option<EarlyStart> {
        let used = densities.iter().zip(covers).find(|(density, _)| **density < high)?;
        let early = *used.0 > 1.1 * self.densities[1];
        early.then_some(EarlyStart {
            density: *used.0,
            cover: used.1 / self.cover,
            level_from: self.densities[1],
        })
    }
}

impl fmt::Display for EarlyStart {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "the fit starts too early: at density {:.4} cover is {:.0} % of its plateau, which \
             begins at density {:.4}; the slope comes out too steep",
            self.density,
            100.0 * self.cover,
            self.level_from
        )
    }
}

/// States averaged in classes of density, so that years of slow change do not outvote the rest.
///
/// Twenty classes a decade; means are geometric, as the fit is in logarithms. States without a
/// positive density and size are left out.
pub fn by_density(states: &[StandState]) -> Vec<StandState> {
    let usable = |state: &&StandState| {
        let StandState { density, mean_size } = state;
        density.is_finite() && mean_size.is_finite() && *density > 0.0 && *mean_size > 0.0
    };
    let mut sorted: Vec<StandState> = states.iter().filter(usable).copied().collect();
    sorted.sort_by_key(|state| class_of(state.density));
    let mean = |states: &[StandState]| {
        let mean = |of: fn(&StandState) -> f64| {
            let logs: f64 = states.iter().map(|state| libm::log(of(state))).sum();
            libm::exp(logs / states.len() as f64)
        };
        StandState { density: mean(|s| s.density), mean_size: mean(|s| s.mean_size) }
    };
    sorted.chunk_by(|a, b| class_of(a.density) == class_of(b.density)).map(mean).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Density falls by 1 % a row; cover rises by 2 % a row to 0.3 and falls at the end.
    fn history() -> (Vec<f64>, Vec<f64>) {
        let density = |row: i32| 0.99f64.powi(row);
        let cover = |row: i32| match row {
            400.. => 0.3 * 0.99f64.powi(row - 400),
            row => (0.01 * 1.02f64.powi(row)).min(0.3),
        };
        ((0..500).map(density).collect(), (0..500).map(cover).collect())
    }

    #[test]
    fn the_plateau_begins_where_cover_has_risen_and_ends_where_it_falls() {
        let (densities, covers) = history();
        let found = plateau(&densities, &covers).unwrap();
        // 0.01 · 1.02^t reaches 0.97 · 0.3 at t = 170.2, and 0.99^t falls by 5 % in 5 rows.
        assert!((found.cover / 0.3 - 1.0).abs() < 0.01, "{found:?}");
        assert!((165..=172).contains(&found.rows[0]), "{found:?}");
        assert!((398..=415).contains(&found.rows[1]), "{found:?}");
    }

    #[test]
    fn a_fit_from_before_the_plateau_is_doubted() {
        let (densities, covers) = history();
        let found = plateau(&densities, &covers).unwrap();
        let early = found.early_start(&densities, &covers, 0.5).unwrap();
        assert!(early.cover < 0.2, "{early}");
        assert_eq!(found.early_start(&densities, &covers, found.densities[1] * 1.01), None);
    }

    #[test]
    fn cover_that_only_rises_has_no_plateau() {
        let (densities, covers) = history();
        let error = plateau(&densities[..150], &covers[..150]).unwrap_err();
        assert!(matches!(error, Error::NoPlateau { .. }), "{error}");
    }

    #[test]
    fn classes_of_density_lie_on_the_line_of_their_states() {
        let state = |row: i32| {
            let density = 0.99f64.powi(row);
            StandState { density, mean_size: 2.0 * density.powf(-1.5) }
        };
        let states: Vec<StandState> = (0..300).map(state).collect();
        let classes = by_density(&states);
        assert!((25..=28).contains(&classes.len()));
        for StandState { density, mean_size } in classes {
            assert!((mean_size * density.powf(1.5) - 2.0).abs() < 1e-9);
        }
    }
}
