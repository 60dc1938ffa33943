//! Forms that are set into the ground: hills, craters; and ground that is moved or bent as a whole.

use crate::lattice::Lattice;
use crate::resample::{by_row, keys_weights};
use crate::spline::influence;
use weald_contract::{Problem, Problems, Written, table};

table! {
    /// A round hill, or with a negative height a hollow.
    pub struct Hill {
        /// Its middle, scene coordinates, m.
        at: [f64; 2], in -1000000.0..=1000000.0;
        /// Distance from the middle to its foot, m.
        radius: f64, in 0.001..=1000000.0;
        /// Height in the middle, m.
        height: f64, in -100000.0..=100000.0;
        /// Part of the radius that is level on top.
        top: f64 = 0.0, in 0.0..=1.0;
    }
}

table! {
    /// A crater: a bowl with a raised rim.
    pub struct Crater {
        /// Its middle, scene coordinates, m.
        at: [f64; 2], in -1000000.0..=1000000.0;
        /// Distance from the middle to the crest of the rim, m.
        radius: f64, in 0.001..=1000000.0;
        /// Depth of the middle below the ground around, m.
        depth: f64, in 0.0..=100000.0;
        /// Height of the rim above the ground around, m.
        rim: f64 = 0.0, in 0.0..=100000.0;
        /// Width of the rim's outer side, m.
        falloff: f64 = 10.0, in 0.0..=1000000.0;
    }
}

table! {
    /// Moving the ground sideways; what comes in at the rim continues the rim.
    pub struct Translate {
        /// How far it moves to the east and to the north, m.
        by: [f64; 2], in -1000000.0..=1000000.0;
    }
}

table! {
    /// A curve from altitude to altitude: scaling that differs with height.
    pub struct Remap {
        /// Points [before, after], m, both rising in the first; smooth and without overshoot between.
        points: Written<Vec<[f64; 2]>>, in -100000.0..=100000.0;
    }
}

fn distance(from: [f64; 2], x: f64, y: f64) -> f64 {
    let (dx, dy) = (x - from[0], y - from[1]);
    (dx * dx + dy * dy).sqrt()
}

impl Hill {
    /// Altitude with the hill upon it.
    pub(crate) fn at(&self, x: f64, y: f64, altitude: f64) -> f64 {
        let top = self.top * self.radius;
        let side = self.radius - top;
        altitude + self.height * influence(distance(self.at, x, y), top, side)
    }
}

impl Crater {
    /// Altitude with the crater in it: a paraboloid up to the crest, a ramp beyond.
    pub(crate) fn at(&self, x: f64, y: f64, altitude: f64) -> f64 {
        let r = distance(self.at, x, y) / self.radius;
        if r < 1.0 {
            return altitude - self.depth + (self.depth + self.rim) * r * r;
        }
        altitude + self.rim * influence(r * self.radius, self.radius, self.falloff)
    }
}

impl Translate {
    /// Cells within which the operator looks.
    pub(crate) fn reach(&self, cell: f64) -> usize {
        // Two more for the interpolation.
        let farthest = self.by[0].abs().max(self.by[1].abs());
        (farthest / cell).ceil() as usize + 2
    }

    /// The moved ground. Every cell looks equally far, so tiles see what the whole does.
    pub(crate) fn run(&self, lattice: &Lattice, altitude: &[f32]) -> Vec<f32> {
        let Lattice { width, height, cell, .. } = *lattice;
        let split = |shift: f64| (shift.floor() as isize, keys_weights(shift - shift.floor()));
        let (columns, across) = split(-self.by[0] / cell);
        let (rows, down) = split(self.by[1] / cell);
        let tap = |at: usize, shift: isize, i: usize, count: usize| {
            (at as isize + shift + i as isize - 1).clamp(0, count as isize - 1) as usize
        };
        let moved = by_row(width, height, |row, out| {
            let line = &altitude[row * width..][..width];
            for (column, out) in out.iter_mut().enumerate() {
                let weigh =
                    |(i, w): (usize, &f64)| w * f64::from(line[tap(column, columns, i, width)]);
                *out = across.iter().enumerate().map(weigh).sum::<f64>() as f32;
            }
        });
        by_row(width, height, |row, out| {
            let lines = [0, 1, 2, 3].map(|i| &moved[tap(row, rows, i, height) * width..][..width]);
            for (column, out) in out.iter_mut().enumerate() {
                let weigh = |(line, w): (&&[f32], &f64)| w * f64::from(line[column]);
                *out = lines.iter().zip(&down).map(weigh).sum::<f64>() as f32;
            }
        })
    }
}

impl Remap {
    /// Notes points that make no curve.
    pub(crate) fn check(&self, problems: &mut Problems) {
        let points = &self.points.value;
        if points.len() < 2 || points.windows(2).any(|pair| pair[0][0] >= pair[1][0]) {
            problems.push(
                Problem::at(self.points.span, "a curve needs at least 2 points in rising order")
                    .hint("write [[before, after], [before, after]]"),
            );
        }
    }

    /// Slopes of the curve at its points: where it turns they are level, elsewhere the weighted
    /// harmonic means of the slopes beside them, so that it never overshoots [Fritsch84].
    pub(crate) fn tangents(&self) -> Vec<f64> {
        let points = &self.points.value;
        let rise = |i: usize| (points[i + 1][1] - points[i][1]) / (points[i + 1][0] - points[i][0]);
        let last = points.len() - 1;
        let tangent = |i: usize| {
            if i == 0 {
                return rise(0);
            }
            if i == last {
                return rise(last - 1);
            }
            let (before, after) = (rise(i - 1), rise(i));
            if before * after <= 0.0 {
                return 0.0;
            }
            let (h0, h1) = (points[i][0] - points[i - 1][0], points[i + 1][0] - points[i][0]);
            let (w0, w1) = (2.0 * h1 + h0, h1 + 2.0 * h0);
            (w0 + w1) / (w0 / before + w1 / after)
        };
        (0..points.len()).map(tangent).collect()
    }

    /// The curve's value; beyond its ends it goes on straight.
    pub(crate) fn at(&self, tangents: &[f64], altitude: f64) -> f64 {
        let points = &self.points.value;
        let after = points.partition_point(|point| point[0] <= altitude);
        if after == 0 || after == points.len() {
            let end = after.saturating_sub(1);
            return points[end][1] + tangents[end] * (altitude - points[end][0]);
        }
        let ([x0, y0], [x1, y1]) = (points[after - 1], points[after]);
        let h = x1 - x0;
        let t = (altitude - x0) / h;
        let (t2, t3) = (t * t, t * t * t);
        (2.0 * t3 - 3.0 * t2 + 1.0) * y0
            + (t3 - 2.0 * t2 + t) * h * tangents[after - 1]
            + (3.0 * t2 - 2.0 * t3) * y1
            + (t3 - t2) * h * tangents[after]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_crater_has_its_depth_its_rim_and_ends() {
        let crater = Crater { at: [5.0, 5.0], radius: 10.0, depth: 4.0, rim: 1.0, falloff: 6.0 };
        let at = |r: f64| crater.at(5.0 + r, 5.0, 100.0);
        assert_eq!([at(0.0), at(10.0), at(16.0), at(20.0)], [96.0, 101.0, 100.0, 100.0]);
        // The volume of the bowl below the old ground: z = -d + (d + rim) r² reaches 0 at r0.
        assert!((at(10.0 * (4.0f64 / 5.0).sqrt()) - 100.0).abs() < 1e-9);
    }

    #[test]
    fn a_hill_has_its_height_on_top_and_ends_at_its_radius() {
        let hill = Hill { at: [0.0, 0.0], radius: 10.0, height: 3.0, top: 0.2 };
        assert_eq!([0.0, 2.0, 6.0, 10.0].map(|r| hill.at(r, 0.0, 7.0)), [10.0, 10.0, 8.5, 7.0]);
    }

    #[test]
    fn moving_by_whole_cells_moves_values_and_a_plane_moves_by_any_length() {
        let lattice = Lattice { cell: 2.0, west: 0, south: 0, width: 30, height: 20 };
        let z = |x: f64, y: f64| (0.5 * x - 0.25 * y + 3.0) as f32;
        let ground: Vec<f32> = (0..lattice.len())
            .map(|i| z(lattice.x(i % lattice.width), lattice.y(i / lattice.width)))
            .collect();
        for by in [[4.0, -6.0], [3.3, 1.7]] {
            let moved = Translate { by }.run(&lattice, &ground);
            for (column, row) in (5..25).flat_map(|x| (5..15).map(move |y| (x, y))) {
                let expected = z(lattice.x(column) - by[0], lattice.y(row) - by[1]);
                assert!((moved[row * lattice.width + column] - expected).abs() < 1e-4);
            }
        }
    }

    #[test]
    fn a_curve_passes_its_points_rises_with_them_and_goes_on_straight() {
        let points = vec![[0.0, 0.0], [10.0, 1.0], [20.0, 15.0], [30.0, 15.0], [40.0, 45.0]];
        let curve = Remap { points: Written { value: points.clone(), ..Default::default() } };
        let tangents = curve.tangents();
        assert!(points.iter().all(|p| (curve.at(&tangents, p[0]) - p[1]).abs() < 1e-12));
        let values: Vec<f64> =
            (-50..500).map(|i| curve.at(&tangents, f64::from(i) * 0.1)).collect();
        assert!(values.windows(2).all(|pair| pair[1] >= pair[0] - 1e-12));
        assert!((curve.at(&tangents, 25.0) - 15.0).abs() < 1e-12, "a level stretch stays level");
        assert!((curve.at(&tangents, 41.0) - 48.0).abs() < 1e-9);
    }
}
