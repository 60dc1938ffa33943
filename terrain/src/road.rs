//! Roads and paths: a level strip along a line, cut into rising ground and filled over hollows.

use crate::mask::check_line;
use crate::spline::Polyline;
use crate::stream::{Channel, StreamCut};
use weald_contract::{Problem, Problems, Written, table};

table! {
    /// A road or path.
    pub struct Road {
        /// Points of its middle line, scene coordinates, m.
        points: Written<Vec<[f64; 2]>>, in -1000000.0..=1000000.0;
        /// Whether the line is a smooth curve through the points, and not straight between them.
        curved: bool = true;
        /// Width of the level strip, m.
        width: f64, in 0.0..=100000.0;
        /// Width of each side slope, from the strip to untouched ground, m.
        falloff: f64 = 3.0, in 0.0..=100000.0;
        /// Steepest climb along the line, m per m.
        max_grade: f64 = 0.08, in 0.0..=10.0;
        /// Height of the strip above the ground it follows, m.
        raise: f64 = 0.0, in -1000.0..=1000.0;
        /// Deepest cut or highest fill that is accepted, m.
        max_depth: Option<f64> = None, in 0.0..=100000.0;
    }
}

impl Road {
    /// Notes what is wrong with the road's own numbers.
    pub(crate) fn check(&self, problems: &mut Problems) {
        check_line(&self.points, problems);
    }

    /// Lays the strip along the line over ground whose altitude `ground(x, y)` gives.
    pub(crate) fn lay(
        &self,
        cell: f64,
        ground: impl Fn(f64, f64) -> f32,
    ) -> Result<Channel, Problem> {
        let points = &self.points.value;
        let line = if self.curved { Polyline::curved(points) } else { Polyline::new(points) };
        let strip = StreamCut::strip(&self.points, self.width, self.falloff);
        let mut bed =
            Channel::over(line, strip, cell, |[x, y]| f64::from(ground(x, y)) + self.raise);
        let surface = bed.levels().to_vec();
        let steepest = self.max_grade * bed.spacing();
        bed.set_levels(gentle(&surface, steepest));
        self.check_depth(&surface, &bed)?;
        Ok(bed)
    }

    fn check_depth(&self, surface: &[f64], bed: &Channel) -> Result<(), Problem> {
        let Some(limit) = self.max_depth else { return Ok(()) };
        let depths = surface.iter().zip(bed.levels()).map(|(ground, bed)| ground - bed);
        let Some((index, depth)) = depths.enumerate().find(|(_, depth)| depth.abs() > limit) else {
            return Ok(());
        };
        let station = index as f64 * bed.spacing();
        let what = if depth > 0.0 { "a cut" } else { "a fill" };
        let message =
            format!("{station:.0} m along the line the road needs {what} of {:.2} m", depth.abs());
        Err(Problem::at(self.points.span, message)
            .hint("lead the line along the slope, or raise `max_grade` or `max_depth`"))
    }
}

/// Heights that climb by at most `step` from one to the next, midway between the lowest such
/// heights above `surface` and the highest below it: cuts and fills are alike.
fn gentle(surface: &[f64], step: f64) -> Vec<f64> {
    let (mut above, mut below) = (surface.to_vec(), surface.to_vec());
    for i in 1..surface.len() {
        above[i] = above[i].max(above[i - 1] - step);
        below[i] = below[i].min(below[i - 1] + step);
    }
    for i in (1..surface.len()).rev() {
        above[i - 1] = above[i - 1].max(above[i] - step);
        below[i - 1] = below[i - 1].min(below[i] + step);
    }
    above.iter().zip(&below).map(|(a, b)| 0.5 * (a + b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn road(max_depth: Option<f64>) -> Road {
        Road {
            points: Written { value: vec![[0.0, 0.0], [200.0, 0.0]], ..Default::default() },
            curved: false,
            width: 4.0,
            falloff: 3.0,
            max_grade: 0.1,
            raise: 0.0,
            max_depth,
        }
    }

    /// A ridge across the road, with sides of 30 %.
    fn ridge(x: f64, _: f64) -> f32 {
        (10.0 - 0.3 * (x - 100.0).abs()).max(0.0) as f32
    }

    #[test]
    fn a_road_is_level_across_never_too_steep_and_cuts_as_much_as_it_fills() {
        let bed = road(None).lay(1.0, ridge).unwrap();
        let steps = bed.levels().windows(2).map(|pair| (pair[1] - pair[0]).abs());
        assert!(steps.fold(0.0, f64::max) <= 0.1 * bed.spacing() + 1e-12);
        let deepest = bed
            .levels()
            .iter()
            .enumerate()
            .map(|(i, z)| f64::from(ridge(i as f64 * bed.spacing(), 0.0)) - z);
        let (cut, fill) = deepest.fold((0.0f64, 0.0f64), |(c, f), d| (c.max(d), f.max(-d)));
        assert!(cut > 1.0 && (cut - fill).abs() < 0.2, "{cut} {fill}");
        for distance in [0.0, 1.0, 2.0] {
            assert_eq!(bed.shape(&[0], [100.0, distance], 10.0), bed.bed_at(100.0));
        }
        assert_eq!(bed.shape(&[0], [100.0, 5.1], 7.0), 7.0);
    }

    #[test]
    fn a_cut_deeper_than_allowed_is_told_with_its_place() {
        let problem = road(Some(1.0)).lay(1.0, ridge).unwrap_err();
        assert!(problem.to_string().contains("along the line"), "{problem}");
    }
}
