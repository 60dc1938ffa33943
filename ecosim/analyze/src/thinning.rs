//! The line along which a crowded stand thins: log mean size over log density.
//!
//! In a crowded, even-aged stand mean mass follows density with slope -3/2 [Yoda63], mean crown
//! area with slope -1. Least squares takes density as exact; the standardized major axis treats
//! both alike and is the usual choice for allometry [Warton06].

use crate::pattern::Error;
use crate::regression::{QuantileLine, quantile_line};
use crate::student::two_sided_quantile;

/// A stand at one time.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct StandState {
    /// Living plants per unit of area.
    pub density: f64,
    /// Mean crown area or mass of a plant.
    pub mean_size: f64,
}

/// A line `log10 size = intercept + slope log10 density`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Line {
    /// Slope.
    pub slope: f64,
    /// Decimal logarithm of the size at density 1.
    pub intercept: f64,
    /// Interval that holds the slope with 95 % confidence, were the states independent. States
    /// of one stand in successive years are not: take it as a lower bound of the doubt.
    pub slope_interval: [f64; 2],
}

/// Lines through a stand's history.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct ThinningLine {
    /// Number of states used.
    pub states: usize,
    /// By ordinary least squares.
    pub least_squares: Line,
    /// By the standardized major axis.
    pub major_axis: Line,
    /// The line below which half of the states lie, in decimal logarithms.
    pub median: QuantileLine,
    /// The line below which 95 % of the states lie: the limit that stands approach.
    pub upper: QuantileLine,
    /// Square of the correlation.
    pub r_squared: f64,
}

/// Part of cases that a confidence interval misses.
const MISSED: f64 = 0.05;

/// Fits lines to the states whose density lies in `window`, both ends excluded.
///
/// Choose the window from the time when crowns have closed: before, plants grow without dying and
/// the line starts too steep.
///
/// # Errors
/// Fewer than three states in the window, all of one density or of one size; a density or size
/// there that is not a positive finite number, named by its row.
pub fn thinning_line(states: &[StandState], window: [f64; 2]) -> Result<ThinningLine, Error> {
    let [low, high] = window;
    let mut points = Vec::new();
    for (row, state) in states.iter().enumerate() {
        if state.density <= low || state.density >= high {
            continue;
        }
        let of = [("the density", state.density), ("the mean size", state.mean_size)];
        for (what, value) in of {
            if !(value.is_finite() && value > 0.0) {
                let right = "a finite number above 0 is right";
                return Err(Error::BadValue { what, row, value, right });
            }
        }
        points.push([libm::log10(state.density), libm::log10(state.mean_size)]);
    }
    if points.len() < 3 {
        let what = "states in the window of densities";
        return Err(Error::TooFew { what, found: points.len(), needed: 3 });
    }
    fit(&points)
}

fn fit(points: &[[f64; 2]]) -> Result<ThinningLine, Error> {
    let n = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / n;
    let [mean_x, mean_y] = [mean(0), mean(1)];
    // Centre before multiplying, or the sums cancel most of their digits away.
    let sum = |a: usize, b: usize| {
        let means = [mean_x, mean_y];
        points.iter().map(|p| (p[a] - means[a]) * (p[b] - means[b])).sum::<f64>()
    };
    let (xx, xy, yy) = (sum(0, 0), sum(0, 1), sum(1, 1));
    if xx == 0.0 {
        return Err(Error::NoSpread { what: "densities in the window" });
    }
    if yy == 0.0 {
        return Err(Error::NoSpread { what: "sizes in the window" });
    }
    let r_squared = xy * xy / (xx * yy);
    let freedom = n - 2.0;
    let t = two_sided_quantile(MISSED, freedom);
    let line = |slope: f64, slope_interval| Line {
        slope,
        intercept: mean_y - slope * mean_x,
        slope_interval,
    };

    let slope = xy / xx;
    let residual = (yy - slope * xy).max(0.0);
    let error = t * (residual / freedom / xx).sqrt();
    let least_squares = line(slope, [slope - error, slope + error]);

    // [Warton06]: the interval of the slope from B = F (1 - r²) / (n - 2), where F of one
    // and n - 2 degrees is t².
    let slope = (yy / xx).sqrt().copysign(xy);
    let b = t * t * (1.0 - r_squared).max(0.0) / freedom;
    let ends = [(b + 1.0).sqrt() - b.sqrt(), (b + 1.0).sqrt() + b.sqrt()].map(|f| slope * f);
    let major_axis = line(slope, [ends[0].min(ends[1]), ends[0].max(ends[1])]);
    let median = quantile_line(points, 0.5)?;
    let upper = quantile_line(points, 0.95)?;
    let states = points.len();
    Ok(ThinningLine { states, least_squares, major_axis, median, upper, r_squared })
}

/// Reineke's density of a stand: how crowded it is, whatever its age [Reineke33].
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct StandDensity {
    /// Stems on a hectare.
    pub stems_per_hectare: f64,
    /// Root of the mean square of the diameters at breast height, cm.
    pub quadratic_mean_cm: f64,
    /// Cross-section of the stems at breast height on a hectare, m².
    pub basal_area: f64,
    /// Stems on a hectare of a stand as crowded whose quadratic mean diameter is ten inches.
    pub index: f64,
}

/// Reineke's reference diameter, ten inches, in cm.
const REFERENCE_CM: f64 = 25.4;

/// Slope of ln N over ln Dq in fully stocked stands, with the sign turned [Reineke33].
const REINEKE_SLOPE: f64 = 1.605;

impl StandDensity {
    /// Describes the stems of an area by their diameters at breast height in cm.
    ///
    /// # Errors
    /// No stem; a diameter that is negative or not finite, named by its row; all diameters zero;
    /// an area that is not positive.
    pub fn of(diameters_cm: &[f64], area_m2: f64) -> Result<Self, Error> {
        if diameters_cm.is_empty() {
            return Err(Error::TooFew { what: "stems", found: 0, needed: 1 });
        }
        if !(area_m2.is_finite() && area_m2 > 0.0) {
            let right = "a positive area in square metres is right";
            return Err(Error::BadValue { what: "the area", row: 0, value: area_m2, right });
        }
        let bad = |diameter: &f64| !(diameter.is_finite() && *diameter >= 0.0);
        if let Some(row) = diameters_cm.iter().position(bad) {
            let right = "a finite number of at least 0 is right";
            let value = diameters_cm[row];
            return Err(Error::BadValue { what: "the diameter", row, value, right });
        }
        let squares: f64 = diameters_cm.iter().map(|diameter| diameter * diameter).sum();
        if squares <= 0.0 {
            return Err(Error::BadValue {
                what: "the diameter",
                row: 0,
                value: 0.0,
                right: "at least one above 0 is right",
            });
        }
        /// Square metres of a hectare.
        const HECTARE: f64 = 1e4;
        let n = diameters_cm.len() as f64;
        let stems_per_hectare = n * HECTARE / area_m2;
        let quadratic_mean_cm = (squares / n).sqrt();
        // π/4 d², d in cm: 1e-4 makes it m².
        let basal_area = std::f64::consts::FRAC_PI_4 * squares * 1e-4 * HECTARE / area_m2;
        let index = stems_per_hectare * libm::pow(quadratic_mean_cm / REFERENCE_CM, REINEKE_SLOPE);
        Ok(Self { stems_per_hectare, quadratic_mean_cm, basal_area, index })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn stand_on_the_yoda_line_has_slope_minus_three_halves() {
        let state = |density: f64| StandState { density, mean_size: 7.0 * density.powf(-1.5) };
        let states: Vec<StandState> = (1..50).map(|i| state(0.02 * f64::from(i))).collect();
        let line = thinning_line(&states, [0.0, f64::INFINITY]).unwrap();
        for fit in [line.least_squares, line.major_axis] {
            assert!((fit.slope + 1.5).abs() < 1e-12);
            assert!((fit.intercept - 7f64.log10()).abs() < 1e-12);
        }
        assert_eq!(line.states, 49);
    }

    #[test]
    fn the_major_axis_of_exchanged_axes_is_the_same_line() {
        let states: Vec<StandState> = [(1.0, 9.0), (2.0, 5.0), (3.0, 4.0), (5.0, 1.5)]
            .map(|(density, mean_size)| StandState { density, mean_size })
            .into();
        let swapped: Vec<StandState> = states
            .iter()
            .map(|s| StandState { density: s.mean_size, mean_size: s.density })
            .collect();
        let slope = |states: &[StandState]| {
            thinning_line(states, [0.0, f64::INFINITY]).unwrap().major_axis.slope
        };
        assert!((slope(&states) * slope(&swapped) - 1.0).abs() < 1e-12);
    }

    #[test]
    fn a_stand_of_ten_inch_stems_has_its_stem_number_as_density_index() {
        let stand = StandDensity::of(&[25.4; 50], 1000.0).unwrap();
        assert!(
            (stand.stems_per_hectare - 500.0).abs() < 1e-9 && (stand.index - 500.0).abs() < 1e-9
        );
        // π/4 · 0.254² m² a stem.
        assert!((stand.basal_area - 25.335_374).abs() < 1e-6);
        // Along Reineke's line stems of double diameter are fewer by 2^1.605.
        let twice = StandDensity::of(&[50.8; 50], 1000.0 * 2f64.powf(1.605)).unwrap();
        assert!((twice.index - stand.index).abs() < 1e-9);
        assert!(matches!(StandDensity::of(&[1.0, -2.0], 9.0), Err(Error::BadValue { row: 1, .. })));
        assert!(StandDensity::of(&[0.0], 9.0).is_err());
    }

    #[test]
    fn one_density_has_no_line() {
        let states = [StandState { density: 1.0, mean_size: 2.0 }; 4];
        let error = thinning_line(&states, [0.0, 9.0]).unwrap_err();
        assert!(matches!(error, Error::NoSpread { .. }));
    }

    #[test]
    fn a_mean_size_of_zero_is_named_by_its_row() {
        let mut states = [StandState { density: 1.0, mean_size: 2.0 }; 4];
        states[2].mean_size = 0.0;
        let error = thinning_line(&states, [0.0, 9.0]).unwrap_err();
        assert!(matches!(error, Error::BadValue { row: 2, .. }));
    }
}
