//! Quantile regression: the line below which a given part of the points lies.

use crate::pattern::Error;

/// A line of quantile regression, `y = intercept + slope x`.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct QuantileLine {
    /// Part of the points that lie below.
    pub part: f64,
    /// Slope.
    pub slope: f64,
    /// Value at x = 0.
    pub intercept: f64,
}

/// Fits the line that minimizes the tilted absolute residuals [KoenkerBassett78].
///
/// Exact to rounding: for a given slope the best intercept is an order statistic of the residuals,
/// and the loss, so reduced, is convex in the slope; its subgradient is bisected to neighbouring
/// numbers. Where a whole range of lines is best, one of them is given.
///
/// # Errors
/// Fewer than two points, all at one x, or one that is not finite; a part not between 0 and 1.
pub fn quantile_line(points: &[[f64; 2]], part: f64) -> Result<QuantileLine, Error> {
    if !(part > 0.0 && part < 1.0) {
        let right = "a part between 0 and 1 is right";
        return Err(Error::BadValue { what: "the quantile", row: 0, value: part, right });
    }
    if points.len() < 2 {
        return Err(Error::TooFew { what: "points", found: points.len(), needed: 2 });
    }
    if let Some(row) = points.iter().position(|[x, y]| !(x.is_finite() && y.is_finite())) {
        let [x, y] = points[row];
        let value = if x.is_finite() { y } else { x };
        let right = "a finite number is right";
        return Err(Error::BadValue { what: "the value", row, value, right });
    }
    if points.iter().all(|point| point[0] == points[0][0]) {
        return Err(Error::NoSpread { what: "x values" });
    }
    let mean = points.iter().map(|point| point[0]).sum::<f64>() / points.len() as f64;
    let mut tilted = Tilted::new(points, mean, part);
    let slope = tilted.best_slope();
    let intercept = tilted.intercept(slope) - slope * mean;
    Ok(QuantileLine { part, slope, intercept })
}

/// The loss of quantile regression as a function of the slope alone.
struct Tilted {
    /// x less its mean, y.
    points: Vec<[f64; 2]>,
    /// Residual and x; reordered at each look.
    residuals: Vec<[f64; 2]>,
    part: f64,
    /// Rank of the residual that the best line goes through.
    rank: usize,
}

impl Tilted {
    fn new(points: &[[f64; 2]], mean: f64, part: f64) -> Self {
        let points: Vec<[f64; 2]> = points.iter().map(|[x, y]| [x - mean, *y]).collect();
        let below = (part * points.len() as f64).ceil() as usize;
        let rank = below.clamp(1, points.len()) - 1;
        Self { residuals: points.clone(), points, part, rank }
    }

    /// Sorts residuals into those below the best line of this slope, on it, and above.
    fn look(&mut self, slope: f64) {
        for (residual, [x, y]) in self.residuals.iter_mut().zip(&self.points) {
            *residual = [y - slope * x, *x];
        }
        self.residuals.select_nth_unstable_by(self.rank, |a, b| a[0].total_cmp(&b[0]));
    }

    fn intercept(&mut self, slope: f64) -> f64 {
        self.look(slope);
        self.residuals[self.rank][0]
    }

    /// Subgradient of the loss. Points above pull with `part`, those below with `part - 1`; the
    /// one on the line takes what makes all pulls sum to zero, the condition of the intercept.
    fn gradient(&mut self, slope: f64) -> f64 {
        self.look(slope);
        let xs = |residuals: &[[f64; 2]]| residuals.iter().map(|[_, x]| x).sum::<f64>();
        let n = self.residuals.len() as f64;
        let on = self.rank as f64 - (n - 1.0) * self.part;
        let below = xs(&self.residuals[..self.rank]) * (self.part - 1.0);
        let above = xs(&self.residuals[self.rank + 1..]) * self.part;
        -(below + self.residuals[self.rank][1] * on + above)
    }

    fn best_slope(&mut self) -> f64 {
        let (mut low, mut high) = self.bracket();
        // Each pass halves the interval; they end at neighbouring numbers.
        for _ in 0..200 {
            let middle = low + (high - low) / 2.0;
            if middle <= low || middle >= high {
                break;
            }
            match self.gradient(middle) {
                gradient if gradient < 0.0 => low = middle,
                _ => high = middle,
            }
        }
        high
    }

    /// Two slopes between which the gradient changes sign, about that of least squares.
    fn bracket(&mut self) -> (f64, f64) {
        let sum = |of: fn(&[f64; 2]) -> f64| self.points.iter().map(of).sum::<f64>();
        let start = sum(|[x, y]| x * y) / sum(|[x, _]| x * x);
        let mut step = 1e-3 * start.abs().max(1e-9);
        let (mut low, mut high) = (start - step, start + step);
        while self.gradient(low) > 0.0 && low.is_finite() {
            (high, low) = (low, low - step);
            step *= 2.0;
        }
        while self.gradient(high) < 0.0 && high.is_finite() {
            (low, high) = (high, high + step);
            step *= 2.0;
        }
        (low, high)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn loss(points: &[[f64; 2]], line: [f64; 2], part: f64) -> f64 {
        let tilt = |e: f64| if e > 0.0 { part * e } else { (part - 1.0) * e };
        points.iter().map(|[x, y]| tilt(y - line[0] - line[1] * x)).sum()
    }

    #[test]
    fn points_on_a_line_give_that_line_for_every_quantile() {
        let points: Vec<[f64; 2]> =
            (0..9).map(|i| [f64::from(i), 2.0 - 1.5 * f64::from(i)]).collect();
        for part in [0.05, 0.5, 0.95] {
            let line = quantile_line(&points, part).unwrap();
            assert!((line.slope + 1.5).abs() < 1e-12 && (line.intercept - 2.0).abs() < 1e-12);
        }
    }

    #[test]
    fn one_x_has_no_line() {
        let error = quantile_line(&[[1.0, 2.0], [1.0, 3.0]], 0.5).unwrap_err();
        assert_eq!(error, Error::NoSpread { what: "x values" });
    }

    proptest! {
        #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

        /// A best line goes through two points, so trying all pairs finds the least loss.
        #[test]
        fn no_line_through_two_points_has_less_loss(
            points in prop::collection::vec((-3.0..3.0f64, -3.0..3.0f64), 3..14),
            part in 0.03..0.97f64,
        ) {
            let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
            let line = quantile_line(&points, part).unwrap();
            let found = loss(&points, [line.intercept, line.slope], part);
            for (index, a) in points.iter().enumerate() {
                for b in &points[index + 1..] {
                    let slope = (b[1] - a[1]) / (b[0] - a[0]);
                    let tried = loss(&points, [a[1] - slope * a[0], slope], part);
                    prop_assert!(found <= tried + 1e-9 * (1.0 + tried.abs()) || !tried.is_finite());
                }
            }
        }
    }
}
