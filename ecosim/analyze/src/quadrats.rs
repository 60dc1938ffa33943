//! Counts in quadrats: whether points gather more than chance would have it.

use crate::pattern::{Error, Pattern};

/// Counts of points in equal rectangles, and what they say.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Quadrats {
    /// Rectangles from west to east.
    pub columns: usize,
    /// Rectangles from south to north.
    pub rows: usize,
    /// Points in each, row by row from the south-west.
    pub counts: Vec<u64>,
    /// Sample variance of the counts over their mean: 1 at random, more in clusters, less where
    /// points keep apart.
    pub variance_mean_ratio: f64,
    /// Morisita's index [Morisita59]: how much likelier two points share a quadrat than at random.
    pub morisita: f64,
}

/// Most rectangles that are counted.
const MOST_QUADRATS: usize = 10_000_000;

impl Quadrats {
    /// Counts the points of a pattern. A point on the line between two belongs to the one with
    /// lower coordinates, as in spatstat; on the window's own rim, to the one inside.
    ///
    /// # Errors
    /// Fewer than two points; fewer than two quadrats or more than ten million.
    pub fn of(pattern: &Pattern, columns: usize, rows: usize) -> Result<Self, Error> {
        pattern.check_pairs()?;
        let found = columns.saturating_mul(rows);
        if !(2..=MOST_QUADRATS).contains(&found) {
            let right = "2 to ten million quadrats are right";
            let value = found as f64;
            return Err(Error::BadValue { what: "the number of quadrats", row: 0, value, right });
        }
        let window = pattern.window();
        let cell = |from_rim: f64, length: f64, count: usize| {
            ((from_rim / length * count as f64).ceil() as usize).clamp(1, count) - 1
        };
        let mut counts = vec![0u64; found];
        for [x, y] in pattern.points() {
            let column = cell(x - window.x[0], window.width(), columns);
            let row = cell(y - window.y[0], window.height(), rows);
            counts[row * columns + column] += 1;
        }
        let (variance_mean_ratio, morisita) = indices(&counts);
        Ok(Self { columns, rows, counts, variance_mean_ratio, morisita })
    }
}

fn indices(counts: &[u64]) -> (f64, f64) {
    let quadrats = counts.len() as f64;
    let points = counts.iter().sum::<u64>() as f64;
    let mean = points / quadrats;
    let squares: f64 = counts.iter().map(|count| (*count as f64 - mean).powi(2)).sum();
    let pairs: f64 = counts.iter().map(|count| *count as f64 * (*count as f64 - 1.0)).sum();
    (squares / (quadrats - 1.0) / mean, quadrats * pairs / (points * (points - 1.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Window;

    const FIELD: Window = Window { x: [0.0, 4.0], y: [0.0, 2.0] };

    #[test]
    fn one_point_a_quadrat_is_perfectly_even() {
        let points = (0..8).map(|i| [(i % 4) as f64 + 0.5, (i / 4) as f64 + 0.5]).collect();
        let quadrats = Quadrats::of(&Pattern::new(points, FIELD).unwrap(), 4, 2).unwrap();
        assert_eq!((quadrats.variance_mean_ratio, quadrats.morisita), (0.0, 0.0));
        assert_eq!(quadrats.counts, [1; 8]);
    }

    #[test]
    fn all_points_in_one_quadrat_give_the_number_of_quadrats() {
        let pattern = Pattern::new(vec![[4.0, 2.0]; 5], FIELD).unwrap();
        let quadrats = Quadrats::of(&pattern, 4, 2).unwrap();
        // Counts 5, 0, ... 0: all pairs share; variance 25/8 over mean 5/8.
        assert_eq!((quadrats.morisita, quadrats.counts[7]), (8.0, 5));
        assert!((quadrats.variance_mean_ratio - 5.0).abs() < 1e-12);
    }

    #[test]
    fn too_many_quadrats_are_refused_before_they_are_counted() {
        let pattern = Pattern::new(vec![[1.0, 1.0]; 2], FIELD).unwrap();
        for (columns, rows) in [(0, 3), (1, 1), (usize::MAX, 2)] {
            assert!(Quadrats::of(&pattern, columns, rows).is_err());
        }
    }
}
