//! Piecewise linear curves: a value over age, height or distance.

use crate::source::{Problem, Problems};
use crate::table::{FromToml, Json, Value};

/// A function of one variable given by points, linear between them and constant outside.
///
/// In a file: a number (constant), or `[[x, y], [x, y], …]` with rising `x`.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
#[serde(transparent)]
pub struct Curve {
    /// Points with strictly rising `x`; at least one.
    points: Vec<[f32; 2]>,
}

impl Curve {
    /// The curve that has one value everywhere.
    pub fn constant(value: f32) -> Self {
        Self { points: vec![[0.0, value]] }
    }

    /// A curve through points; `None` unless there is one and `x` rises strictly.
    pub fn new(points: Vec<[f32; 2]>) -> Option<Self> {
        let rising = points.windows(2).all(|pair| pair[0][0] < pair[1][0]);
        let finite = points.iter().flatten().all(|number| number.is_finite());
        (rising && finite && !points.is_empty()).then_some(Self { points })
    }

    /// The points, by rising `x`.
    pub fn points(&self) -> &[[f32; 2]] {
        &self.points
    }

    /// The curve's value at `x`.
    pub fn at(&self, x: f32) -> f32 {
        let after = self.points.partition_point(|point| point[0] <= x);
        let (Some(left), Some(right)) =
            (after.checked_sub(1).and_then(|i| self.points.get(i)), self.points.get(after))
        else {
            let rim = if after == 0 { self.points.first() } else { self.points.last() };
            return rim.map_or(0.0, |point| point[1]);
        };
        let t = (x - left[0]) / (right[0] - left[0]);
        left[1] + t * (right[1] - left[1])
    }
}

impl FromToml for Curve {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        if let Some(number) = value.as_f64().filter(|number| number.is_finite()) {
            return Some(Self::constant(number as f32));
        }
        let points = Vec::<[f32; 2]>::from_toml(value, problems)?;
        let curve = Self::new(points);
        if curve.is_none() {
            problems.push(
                Problem::at(value.span, "the points of a curve must have rising x")
                    .hint("write a number, or [[x, y], [x, y], …]"),
            );
        }
        curve
    }

    fn schema() -> Json {
        serde_json::json!({ "oneOf": [
            { "type": "number" },
            { "type": "array", "minItems": 1, "items": { "type": "array", "items": { "type": "number" }, "minItems": 2, "maxItems": 2 } },
        ] })
    }

    fn outside(&self, range: &std::ops::RangeInclusive<f64>) -> Option<f64> {
        self.points.iter().map(|point| f64::from(point[1])).find(|y| !range.contains(y))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curve_passes_through_its_points_and_is_flat_outside() {
        let curve = Curve::new(vec![[0.0, 1.0], [10.0, 3.0], [20.0, 0.0]]).unwrap();
        let at: Vec<f32> = [-5.0, 0.0, 5.0, 10.0, 15.0, 20.0, 99.0].map(|x| curve.at(x)).into();
        assert_eq!(at, [1.0, 1.0, 2.0, 3.0, 1.5, 0.0, 0.0]);
        assert!(Curve::new(vec![[1.0, 0.0], [1.0, 2.0]]).is_none());
    }
}
