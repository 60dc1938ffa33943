//! Layers that follow from altitude alone: slope, aspect, curvature, wetness, heat load.

use rayon::prelude::*;

/// Rise per metre towards east and towards north.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Gradient {
    /// dz/dx.
    pub east: f64,
    /// dz/dy.
    pub north: f64,
}

impl Gradient {
    /// Tangent of the slope.
    pub fn tangent(self) -> f64 {
        (self.east * self.east + self.north * self.north).sqrt()
    }

    /// Unit normal of the ground: east, north, up.
    pub fn normal(self) -> [f32; 3] {
        let scale = 1.0 / (1.0 + self.east * self.east + self.north * self.north).sqrt();
        [-self.east * scale, -self.north * scale, scale].map(|part| part as f32)
    }

    /// Slope, degrees.
    pub fn slope_deg(self) -> f32 {
        libm::atan(self.tangent()).to_degrees() as f32
    }

    /// Direction in which the ground falls, degrees clockwise from north in [0, 360); 0 on level
    /// ground, which has none.
    pub fn aspect_deg(self) -> f32 {
        if self.east == 0.0 && self.north == 0.0 {
            return 0.0;
        }
        let degrees = libm::atan2(-self.east, -self.north).to_degrees() as f32;
        // The smallest negative angles round to 360 in single precision.
        // Adding 0 turns -0 into 0.
        let turned = if degrees < 0.0 { degrees + 360.0 } else { degrees + 0.0 };
        if turned >= 360.0 { 0.0 } else { turned }
    }
}

/// Gradient at a cell after Horn: central differences, the nearer of three weighing double
/// [Horn81, p. 18].
///
/// Beyond the rim the ground goes on straight, so that a plane has its own gradient everywhere.
/// Needs at least 2 × 2 cells.
pub fn gradient(
    width: usize,
    height: usize,
    cell: f64,
    altitude: &[f32],
    column: usize,
    row: usize,
) -> Gradient {
    let [[nw, n, ne], [w, _, e], [sw, s, se]] = window(width, height, altitude, column, row);
    Gradient {
        east: ((ne - nw) + 2.0 * (e - w) + (se - sw)) / (8.0 * cell),
        north: ((nw - sw) + 2.0 * (n - s) + (ne - se)) / (8.0 * cell),
    }
}

/// The altitudes of a cell and its eight neighbours, the northern row first.
fn window(
    width: usize,
    height: usize,
    altitude: &[f32],
    column: usize,
    row: usize,
) -> [[f64; 3]; 3] {
    let inside = column > 0 && row > 0 && column + 1 < width && row + 1 < height;
    if inside {
        [row - 1, row, row + 1].map(|row| {
            let line = &altitude[row * width + column - 1..][..3];
            [f64::from(line[0]), f64::from(line[1]), f64::from(line[2])]
        })
    } else {
        [-1, 0, 1].map(|down| {
            [-1, 0, 1].map(|right| {
                let (column, row) = (column as isize + right, row as isize + down);
                extended(width, height, altitude, column, row)
            })
        })
    }
}

/// How the ground bends, 1/m: positive where it bulges, negative where it is hollow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Curvature {
    /// Across the slope: ridges are positive, valleys negative.
    pub plan: f64,
    /// Along the slope: positive where it steepens downwards, negative at its foot.
    pub profile: f64,
}

/// Curvature at a cell from the quartic through its nine altitudes [Zevenbergen87].
///
/// The negative second derivatives across and along the slope, exact where the ground is a
/// quadratic. Level ground has no direction of slope; there both are their mean. Needs at least
/// 2 × 2 cells; beyond the rim the ground goes on straight.
pub fn curvature(
    width: usize,
    height: usize,
    cell: f64,
    altitude: &[f32],
    column: usize,
    row: usize,
) -> Curvature {
    let [[nw, n, ne], [w, z, e], [sw, s, se]] = window(width, height, altitude, column, row);
    let (p, q) = ((e - w) / (2.0 * cell), (n - s) / (2.0 * cell));
    let area = cell * cell;
    let (xx, yy) = ((e - 2.0 * z + w) / area, (n - 2.0 * z + s) / area);
    let xy = (ne - nw - se + sw) / (4.0 * area);
    let squared = p * p + q * q;
    if squared == 0.0 {
        let mean = -0.5 * (xx + yy);
        return Curvature { plan: mean, profile: mean };
    }
    Curvature {
        plan: -(q * q * xx - 2.0 * p * q * xy + p * p * yy) / squared,
        profile: -(p * p * xx + 2.0 * p * q * xy + q * q * yy) / squared,
    }
}

/// A value for every cell from its curvature.
pub fn from_curvature(
    width: usize,
    height: usize,
    cell: f64,
    altitude: &[f32],
    value: impl Fn(Curvature) -> f64 + Sync,
) -> Vec<f32> {
    crate::resample::by_row(width, height, |row, line| {
        for (column, out) in line.iter_mut().enumerate() {
            *out = value(curvature(width, height, cell, altitude, column, row)) as f32;
        }
    })
}

/// Heat load index at a latitude in radians [McCune02, eq. 1]: annual direct radiation with the
/// aspect folded about the line from north-east to south-west, since afternoons are warmer.
///
/// MJ cm⁻² yr⁻¹. The regression was made for latitudes from 0 to 60 degrees and slopes to 90;
/// south of the equator the aspect is mirrored.
pub fn heat_load(gradient: Gradient, latitude: f64) -> f32 {
    let slope = libm::atan(gradient.tangent());
    let aspect = f64::from(gradient.aspect_deg());
    // The warm side faces south-west in the north, north-west in the south.
    let warmest = if latitude < 0.0 { 315.0 } else { 225.0 };
    let turn = (aspect - warmest).abs();
    let folded = (180.0 - turn.min(360.0 - turn)).to_radians();
    let (sin_l, cos_l) = libm::sincos(latitude.abs());
    let (sin_s, cos_s) = libm::sincos(slope);
    let (sin_a, cos_a) = libm::sincos(folded);
    let logarithm =
        -1.467 + 1.582 * cos_l * cos_s - 1.5 * cos_a * sin_s * sin_l - 0.262 * sin_l * sin_s
            + 0.607 * sin_a * sin_s;
    libm::exp(logarithm) as f32
}

/// Altitude at a cell or, continued straight, one cell beyond the rim.
fn extended(width: usize, height: usize, altitude: &[f32], column: isize, row: isize) -> f64 {
    let along_row = |row: usize| {
        let value = |column: usize| f64::from(altitude[row * width + column]);
        straight(width, column, value)
    };
    straight(height, row, along_row)
}

/// `value` at an index in `0..count`, or continued straight to -1 and `count`.
fn straight(count: usize, index: isize, value: impl Fn(usize) -> f64) -> f64 {
    match usize::try_from(index) {
        Err(_) => 2.0 * value(0) - value(1),
        Ok(index) if index < count => value(index),
        Ok(_) => 2.0 * value(count - 1) - value(count - 2),
    }
}

/// A value for every cell from its gradient.
pub fn from_gradient(
    width: usize,
    height: usize,
    cell: f64,
    altitude: &[f32],
    value: impl Fn(usize, Gradient) -> f32 + Sync,
) -> Vec<f32> {
    let mut values = vec![0.0; altitude.len()];
    values.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        for (column, out) in line.iter_mut().enumerate() {
            let gradient = gradient(width, height, cell, altitude, column, row);
            *out = value(row * width + column, gradient);
        }
    });
    values
}

/// Least tangent of slope for the wetness index: level ground would be infinitely wet. A fall of
/// 1 m in 1 km is about what an elevation model of 1 m cells can tell from none.
const LEAST_TANGENT: f64 = 1e-3;

/// Topographic wetness index ln(a / tan β) [Beven79]: `a` is the upslope area (m²) per metre of
/// contour, here one cell's side; β the slope, with tan β at least 0.001.
pub fn wetness(upslope_area: f64, cell: f64, tangent: f64) -> f32 {
    libm::log(upslope_area / cell / tangent.max(LEAST_TANGENT)) as f32
}

#[cfg(test)]
mod tests {
    use super::*;

    const WIDTH: usize = 9;
    const HEIGHT: usize = 7;
    const CELL: f64 = 2.0;

    /// z = a x + b y in steps that f32 holds exactly.
    fn plane(a: f64, b: f64) -> Vec<f32> {
        let z = |i: usize| {
            let (column, row) = (i % WIDTH, i / WIDTH);
            (a * column as f64 * CELL + b * (HEIGHT - 1 - row) as f64 * CELL) as f32
        };
        (0..WIDTH * HEIGHT).map(z).collect()
    }

    #[test]
    fn a_plane_has_its_own_slope_everywhere_rim_and_corners_included() {
        for (a, b) in [(0.5, 0.25), (-0.125, 1.0), (0.0, -2.0)] {
            let altitude = plane(a, b);
            for i in 0..altitude.len() {
                let g = gradient(WIDTH, HEIGHT, CELL, &altitude, i % WIDTH, i / WIDTH);
                assert!((g.east - a).abs() < 1e-6 && (g.north - b).abs() < 1e-6);
                let expected = f64::hypot(a, b).atan().to_degrees();
                assert!((f64::from(g.slope_deg()) - expected).abs() < 1e-5);
            }
        }
    }

    #[test]
    fn aspect_is_where_a_ball_would_roll_clockwise_from_north() {
        let aspect = |east, north| Gradient { east, north }.aspect_deg();
        assert_eq!(aspect(0.0, -1.0), 0.0, "falls to the north");
        assert_eq!(aspect(-1.0, 0.0), 90.0, "falls to the east");
        assert_eq!(aspect(0.0, 1.0), 180.0);
        assert_eq!(aspect(1.0, 0.0), 270.0);
        assert_eq!(aspect(1.0, -1.0), 315.0);
        assert_eq!(aspect(1e-30, -1.0), 0.0, "a hair west of north is not 360");
        assert_eq!(aspect(0.0, 0.0), 0.0, "level");
    }

    #[test]
    fn curvature_of_a_quadratic_is_its_second_derivative_and_a_plane_has_none() {
        // z = a x² + b x y + c y² + d x + e y in steps that f32 holds exactly.
        let (a, b, c, d, e) = (0.125, -0.25, 0.0625, 1.0, 0.5);
        let place = |i: usize| ((i % WIDTH) as f64 * CELL, (HEIGHT - 1 - i / WIDTH) as f64 * CELL);
        let z = |i: usize| {
            let (x, y) = place(i);
            (a * x * x + b * x * y + c * y * y + d * x + e * y) as f32
        };
        let bowl: Vec<f32> = (0..WIDTH * HEIGHT).map(z).collect();
        for (column, row) in (1..WIDTH - 1).flat_map(|x| (1..HEIGHT - 1).map(move |y| (x, y))) {
            let (x, y) = place(row * WIDTH + column);
            let (p, q) = (2.0 * a * x + b * y + d, b * x + 2.0 * c * y + e);
            let steep = p * p + q * q;
            let along = (2.0 * a * p * p + 2.0 * b * p * q + 2.0 * c * q * q) / steep;
            let across = (2.0 * a * q * q - 2.0 * b * p * q + 2.0 * c * p * p) / steep;
            let got = curvature(WIDTH, HEIGHT, CELL, &bowl, column, row);
            assert!((got.profile + along).abs() < 1e-9 && (got.plan + across).abs() < 1e-9);
        }
        let flat = from_curvature(WIDTH, HEIGHT, CELL, &plane(0.5, 0.25), |c| c.plan + c.profile);
        assert!(flat.iter().all(|c| c.abs() < 1e-6));
    }

    #[test]
    fn heat_load_is_that_of_level_ground_at_any_aspect_and_greatest_to_the_south_west() {
        let latitude = 45f64.to_radians();
        let load = |aspect: f64, slope: f64| {
            let (sin, cos) = aspect.to_radians().sin_cos();
            let tangent = slope.to_radians().tan();
            heat_load(Gradient { east: -tangent * sin, north: -tangent * cos }, latitude)
        };
        let level = (-1.467 + 1.582 * latitude.cos()).exp();
        assert!((f64::from(load(10.0, 0.0)) - level).abs() < 1e-6);
        // Mirrored about the line from north-east to south-west.
        assert!((load(225.0 + 70.0, 30.0) - load(225.0 - 70.0, 30.0)).abs() < 1e-5);
        assert!(load(225.0, 30.0) > load(135.0, 30.0) && load(135.0, 30.0) > load(45.0, 30.0));
    }

    #[test]
    fn wetness_on_a_plane_is_its_formula() {
        // On a plane falling east, (x + 1) cells drain through column x.
        let (cell, tangent) = (2.0, 0.05);
        for x in 0..60 {
            let area = f64::from(x + 1) * cell * cell;
            let expected = (f64::from(x + 1) * cell / tangent).ln();
            assert!((f64::from(wetness(area, cell, tangent)) - expected).abs() < 1e-6);
        }
    }
}
