//! Sun and sky.
//!
//! The sky is the analytic model of Hosek and Wilkie [HW12], tabulated over the upper half of
//! the sphere so that it can be looked up and drawn from. Its RGB data come without an absolute
//! scale in their paper; taken as watts, they give the illuminance that lighting engineers
//! measured within a quarter (a test holds this). The sun is a disc whose irradiance is that of
//! space, dimmed by the transmittances of [Preetham99] App. A.1.

use crate::Error;
use crate::environment::{Clouds, SkyPictures, table_of};
use crate::tone::luminance;
use glam::Vec3;
use std::f32::consts::{PI, TAU};

/// Columns of the table, around the horizon.
const WIDTH: usize = 256;
/// Rows of the table, from the horizon up; row boundaries lie at heights (row / HEIGHT)², which
/// are dense near the horizon, where the sky changes fast.
const HEIGHT: usize = 64;

/// Half the apparent diameter of the sun, 0.533° at the mean distance, radians.
pub(crate) const SUN_RADIUS: f64 = 0.533 / 2.0 * std::f64::consts::PI / 180.0;

/// Solar illuminance outside the atmosphere, klx [IESNA00].
const SOLAR_ILLUMINANCE: f64 = 133.3;

/// Colour of sunlight outside the atmosphere at luminance 1: a black body of 5,778 K in
/// Rec. 709 primaries.
const SOLAR_COLOR: [f64; 3] = [1.05, 0.99, 0.95];

/// Luminous efficacy, klm/W, that takes the sky model's radiance to luminance.
const EFFICACY: f32 = 0.683;

/// Wavelengths that stand for red, green and blue, µm: the centroids of the Rec. 709 primaries'
/// matching curves.
const WAVELENGTHS: [f64; 3] = [0.612, 0.549, 0.465];

/// Absorption by ozone at those wavelengths, 1/cm of ozone [Preetham99] Table 2.
const OZONE: [f64; 3] = [0.118, 0.084, 0.0075];

/// How the cells of a table lie on the sphere; columns run counter-clockwise from east.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Layout {
    /// [`WIDTH`] by [`HEIGHT`] cells over the upper half.
    Upper,
    /// Cells of equal angles over all of it, from the nadir up.
    Sphere { columns: usize, rows: usize },
}

impl Layout {
    fn columns(&self) -> usize {
        match self {
            Self::Upper => WIDTH,
            Self::Sphere { columns, .. } => *columns,
        }
    }

    fn rows(&self) -> usize {
        match self {
            Self::Upper => HEIGHT,
            Self::Sphere { rows, .. } => *rows,
        }
    }

    /// Sine of the elevation at the lower and upper rim of a row.
    fn heights(&self, row: usize) -> (f32, f32) {
        match self {
            Self::Upper => row_heights(row),
            Self::Sphere { rows, .. } => {
                let rim = |row: usize| -libm::cos(row as f64 / *rows as f64 * f64::from(PI)) as f32;
                (rim(row), rim(row + 1))
            }
        }
    }

    fn solid_angle(&self, row: usize) -> f32 {
        let (low, high) = self.heights(row);
        (high - low) * TAU / self.columns() as f32
    }

    /// Where in the rows a height lies, from 0 to their number.
    fn row_of(&self, z: f32) -> f32 {
        match self {
            Self::Upper => z.clamp(0.0, 1.0).sqrt() * HEIGHT as f32,
            Self::Sphere { rows, .. } => {
                libm::acosf(-z.clamp(-1.0, 1.0)) * std::f32::consts::FRAC_1_PI * *rows as f32
            }
        }
    }

    /// Whether the table says nothing of a direction.
    fn is_below(&self, direction: Vec3) -> bool {
        *self == Self::Upper && direction.z <= 0.0
    }

    /// The direction of a cell's middle.
    fn direction(&self, index: usize) -> Vec3 {
        let (row, column) = (index / self.columns(), index % self.columns());
        let (low, high) = self.heights(row);
        let z = 0.5 * (low + high);
        let (sin, cos) = libm::sincosf(TAU * (column as f32 + 0.5) / self.columns() as f32);
        let across = (1.0 - z * z).max(0.0).sqrt();
        Vec3::new(across * cos, across * sin, z)
    }
}

/// Radiance of cells.
pub(crate) struct SkyTable {
    pub layout: Layout,
    pub cells: Vec<Vec3>,
}

/// Light from outside the scene.
pub(crate) struct Dome {
    layout: Layout,
    /// Radiance at the cell centres, row by row from the lowest.
    table: Vec<Vec3>,
    /// Radiance from below the horizon: the ground beyond the scene.
    below: Vec3,
    /// The sun, if it shines.
    pub sun: Option<Sun>,
    /// Cumulative probability of rows, then of cells in each row; each ends with 1.
    row_sums: Vec<f32>,
    cell_sums: Vec<f32>,
    /// Probability density of drawing a direction in a cell, 1/sr.
    densities: Vec<f32>,
}

/// The disc of the sun.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Sun {
    /// Unit vector towards its middle.
    pub direction: Vec3,
    /// Radiance of the disc, kcd/m².
    pub radiance: Vec3,
    /// Cosine of its angular radius.
    cos_radius: f32,
}

/// A direction drawn from a light.
#[derive(Clone, Copy, Debug)]
pub(crate) struct LightSample {
    pub direction: Vec3,
    pub radiance: Vec3,
    /// Probability density, 1/sr.
    pub pdf: f32,
}

impl Sun {
    /// Solid angle of the disc, sr.
    fn solid_angle(&self) -> f32 {
        // 2π (1 - cos r) loses all digits in single precision; sin² does not.
        (2.0 * std::f64::consts::PI * 2.0 * libm::sin(0.5 * SUN_RADIUS).powi(2)) as f32
    }

    /// Draws a direction, uniformly over the disc.
    pub fn sample(&self, u: [f32; 2]) -> LightSample {
        let sin = (SUN_RADIUS * f64::from(u[0]).sqrt()) as f32;
        let (side, up) = self.direction.any_orthonormal_pair();
        let (s, c) = libm::sincosf(TAU * u[1]);
        let direction =
            ((1.0 - sin * sin).sqrt() * self.direction + sin * (c * side + s * up)).normalize();
        LightSample { direction, radiance: self.radiance, pdf: 1.0 / self.solid_angle() }
    }

    /// Whether a direction points at the disc.
    pub fn covers(&self, direction: Vec3) -> bool {
        direction.dot(self.direction) >= self.cos_radius
    }
}

impl Dome {
    /// The sky of a table `[sky]`.
    pub fn new(sky: &crate::Sky) -> Self {
        let elevation = f64::from(sky.sun_elevation_deg).to_radians();
        let azimuth = f64::from(sky.sun_azimuth_deg).to_radians();
        let toward = Vec3::new(
            (libm::sin(azimuth) * libm::cos(elevation)) as f32,
            (libm::cos(azimuth) * libm::cos(elevation)) as f32,
            libm::sin(elevation) as f32,
        );
        let turbidity = f64::from(sky.turbidity);
        let irradiance = sun_irradiance(elevation, turbidity);
        let mut sun = Sun {
            direction: toward,
            radiance: Vec3::ONE,
            cos_radius: libm::cos(SUN_RADIUS) as f32,
        };
        sun.radiance = irradiance.map(|e| e as f32).into();
        sun.radiance /= sun.solid_angle();
        let table = SkyTable { layout: Layout::Upper, cells: tabulate(sky, toward) };
        let mut dome = Self::from_table(table, Vec3::ZERO, Some(sun));
        let direct = Vec3::from(irradiance.map(|e| e as f32)) * toward.z;
        dome.below = sky.ground_albedo / PI * (direct + dome.irradiance());
        dome
    }

    /// The sky of a table `[sky]` and of the pictures that it names.
    ///
    /// # Errors
    /// A picture that is no sky.
    pub fn with_pictures(sky: &crate::Sky, pictures: SkyPictures<'_>) -> Result<Self, Error> {
        if let Some(image) = pictures.image {
            let turn = sky.image_turn_deg.to_radians();
            return Ok(Self::of_table(table_of(image, turn, sky.image_gain)?));
        }
        let clear = Self::new(sky);
        Ok(match pictures.clouds {
            Some(image) => {
                clear.clouded(&Clouds { image, size: sky.cloud_size / sky.cloud_height })
            }
            None => clear,
        })
    }

    /// A sky that is a picture, with no sun but the one in it.
    pub fn of_table(table: SkyTable) -> Self {
        Self::from_table(table, Vec3::ZERO, None)
    }

    /// The same sky behind clouds: they hide it, shine by its light and the sun's, and dim the sun
    /// where it stands behind them.
    fn clouded(&self, clouds: &Clouds<'_>) -> Self {
        let layout = Layout::Sphere { columns: 1024, rows: 512 };
        let sun_light =
            self.sun.map_or(Vec3::ZERO, |sun| sun.radiance * sun.solid_angle() * sun.direction.z);
        let light = self.irradiance() + sun_light;
        let cell = |index: usize| {
            let direction = layout.direction(index);
            let cover = clouds.cover(direction);
            let toward_sun = self.sun.map_or(0.0, |sun| sun.direction.dot(direction));
            self.radiance(direction).lerp(clouds.radiance(cover, light, toward_sun), cover)
        };
        let cells = (0..layout.columns() * layout.rows()).map(cell).collect();
        let sun = self.sun.map(|sun| Sun {
            radiance: sun.radiance * (1.0 - clouds.cover(sun.direction)).powi(2),
            ..sun
        });
        Self::from_table(SkyTable { layout, cells }, self.below, sun)
    }

    /// The same radiance from everywhere and no sun: a furnace.
    #[cfg(test)]
    pub fn constant(radiance: f32) -> Self {
        let radiance = Vec3::splat(radiance);
        let table = SkyTable { layout: Layout::Upper, cells: vec![radiance; WIDTH * HEIGHT] };
        Self::from_table(table, radiance, None)
    }

    /// A sun and nothing else.
    #[cfg(test)]
    pub fn only_sun(mut self) -> Self {
        self.table.fill(Vec3::ZERO);
        self.below = Vec3::ZERO;
        self
    }

    fn from_table(table: SkyTable, below: Vec3, sun: Option<Sun>) -> Self {
        let SkyTable { layout, cells: table } = table;
        let (columns, rows) = (layout.columns(), layout.rows());
        let brightness: Vec<f32> = table.iter().map(|rgb| luminance(rgb.to_array())).collect();
        // A floor keeps every direction possible, so that no cell between bright neighbours, which
        // interpolation lights, is ever missed.
        let mean = brightness.iter().map(|&b| f64::from(b)).sum::<f64>() / table.len() as f64;
        let floor = 1e-4 * (1.0 + mean as f32);
        let solid_angles: Vec<f32> = (0..rows).map(|row| layout.solid_angle(row)).collect();
        let weight = |index: usize| {
            f64::from(brightness[index] + floor) * f64::from(solid_angles[index / columns])
        };
        let total: f64 = (0..table.len()).map(weight).sum();
        let mut dome = Self {
            layout,
            densities: (0..table.len())
                .map(|i| (weight(i) / total) as f32 / solid_angles[i / columns])
                .collect(),
            row_sums: Vec::with_capacity(rows),
            cell_sums: Vec::with_capacity(table.len()),
            below,
            sun,
            table: Vec::new(),
        };
        let mut sum = 0.0;
        for row in 0..rows {
            let cells = row * columns..(row + 1) * columns;
            let row_weight: f64 = cells.clone().map(weight).sum();
            sum += row_weight;
            dome.row_sums.push((sum / total) as f32);
            let mut part = 0.0;
            for index in cells {
                part += weight(index);
                dome.cell_sums.push((part / row_weight) as f32);
            }
        }
        dome.table = table;
        dome
    }

    /// Columns of the table.
    pub fn columns(&self) -> usize {
        self.layout.columns()
    }

    /// Irradiance of the sky without sun on level ground.
    pub fn irradiance(&self) -> Vec3 {
        let part = |index: usize| {
            let row = index / self.layout.columns();
            let (low, high) = self.layout.heights(row);
            self.table[index] * ((0.5 * (low + high)).max(0.0) * self.layout.solid_angle(row))
        };
        (0..self.table.len()).map(part).sum()
    }

    /// Radiance from a direction, without the sun.
    pub fn radiance(&self, direction: Vec3) -> Vec3 {
        if self.layout.is_below(direction) {
            return self.below;
        }
        let (columns, rows) = (self.layout.columns(), self.layout.rows());
        let row = self.layout.row_of(direction.z) - 0.5;
        let column = azimuth_turns(direction) * columns as f32 - 0.5;
        let (r0, c0) = (row.max(0.0) as usize, column.floor());
        let (fr, fc) = (row.max(0.0) - r0 as f32, column - c0);
        let r1 = (r0 + 1).min(rows - 1);
        let c0 = (c0 as i32).rem_euclid(columns as i32) as usize;
        let c1 = (c0 + 1) % columns;
        let line = |r: usize| self.table[r * columns + c0].lerp(self.table[r * columns + c1], fc);
        line(r0.min(rows - 1)).lerp(line(r1), fr)
    }

    /// Draws a direction in proportion to the sky's luminance; above the horizon, unless the sky
    /// is a picture of all directions.
    pub fn sample(&self, u: [f32; 2]) -> LightSample {
        let columns = self.layout.columns();
        let (row, fr) = invert(&self.row_sums, u[0]);
        let (column, fc) = invert(&self.cell_sums[row * columns..(row + 1) * columns], u[1]);
        let (low, high) = self.layout.heights(row);
        let z = low + fr * (high - low);
        let (sin, cos) = libm::sincosf(TAU * (column as f32 + fc) / columns as f32);
        let across = (1.0 - z * z).max(0.0).sqrt();
        let z = if self.layout == Layout::Upper { z.max(1e-6) } else { z };
        let direction = Vec3::new(across * cos, across * sin, z);
        let pdf = self.densities[row * columns + column];
        LightSample { direction, radiance: self.radiance(direction), pdf }
    }

    /// Density with which [`Dome::sample`] draws a direction, 1/sr.
    pub fn pdf(&self, direction: Vec3) -> f32 {
        if self.layout.is_below(direction) {
            return 0.0;
        }
        let (columns, rows) = (self.layout.columns(), self.layout.rows());
        let row = (self.layout.row_of(direction.z) as usize).min(rows - 1);
        let column = (azimuth_turns(direction) * columns as f32) as usize;
        self.densities[row * columns + column.min(columns - 1)]
    }
}

/// Sine of the elevation at the lower and upper rim of a row.
fn row_heights(row: usize) -> (f32, f32) {
    let rim = |row: usize| (row as f32 / HEIGHT as f32).powi(2);
    (rim(row), rim(row + 1))
}

/// Angle from east, counter-clockwise, in turns: [0, 1).
fn azimuth_turns(direction: Vec3) -> f32 {
    let turns = libm::atan2f(direction.y, direction.x) / TAU;
    if turns < 0.0 { turns + 1.0 } else { turns }
}

/// The step of a cumulative distribution that holds `u`, and how far into it `u` lies.
fn invert(sums: &[f32], u: f32) -> (usize, f32) {
    let step = sums.partition_point(|&sum| sum <= u).min(sums.len() - 1);
    let low = if step == 0 { 0.0 } else { sums[step - 1] };
    let width = sums[step] - low;
    (step, if width > 0.0 { ((u - low) / width).clamp(0.0, 1.0) } else { 0.5 })
}

/// Irradiance of the sun on a plane that faces it, klx, as linear Rec. 709
/// [Preetham99] App. A.1.
fn sun_irradiance(elevation: f64, turbidity: f64) -> [f64; 3] {
    let zenith_deg = 90.0 - elevation.to_degrees();
    // Relative optical mass of the air [KY89].
    let mass = 1.0 / (libm::sin(elevation) + 0.50572 * libm::pow(96.07995 - zenith_deg, -1.6364));
    let aerosol = 0.04608 * turbidity - 0.04586;
    let ozone_cm = 0.35;
    [0, 1, 2].map(|band| {
        let wavelength = WAVELENGTHS[band];
        let rayleigh = 0.008735 * libm::pow(wavelength, -4.08);
        let haze = aerosol.max(0.0) * libm::pow(wavelength, -1.3);
        let optical_depth = rayleigh + haze + OZONE[band] * ozone_cm;
        SOLAR_ILLUMINANCE * SOLAR_COLOR[band] * libm::exp(-optical_depth * mass)
    })
}

/// Radiance at all cell centres.
fn tabulate(sky: &crate::Sky, sun: Vec3) -> Vec<Vec3> {
    use hw_skymodel::rgb::{SkyParams, SkyState};
    let params = SkyParams {
        // The model begins at the horizon and ends at the zenith.
        elevation: sky.sun_elevation_deg.clamp(0.0, 90.0).to_radians().min(0.5 * PI),
        turbidity: sky.turbidity.clamp(1.0, 10.0),
        albedo: [sky.ground_albedo.clamp(0.0, 1.0); 3],
    };
    let Ok(state) = SkyState::new(&params) else {
        // Clamped parameters are always in range.
        return vec![Vec3::ZERO; WIDTH * HEIGHT];
    };
    let (coefficients, radiances) = state.raw();
    let model = |direction: Vec3| hosek_wilkie(&coefficients, &radiances, direction, sun);
    let cell = |index: usize| {
        let (row, column) = (index / WIDTH, index % WIDTH);
        let z = ((row as f32 + 0.5) / HEIGHT as f32).powi(2);
        let (sin, cos) = libm::sincosf(TAU * (column as f32 + 0.5) / WIDTH as f32);
        let across = (1.0 - z * z).sqrt();
        model(Vec3::new(across * cos, across * sin, z)).max(Vec3::ZERO) * EFFICACY
    };
    (0..WIDTH * HEIGHT).map(cell).collect()
}

/// The formula of [HW12] eq. 8 and 9, in `libm` so that it gives the same bits everywhere.
fn hosek_wilkie(
    coefficients: &[f32; 27],
    radiances: &[f32; 3],
    direction: Vec3,
    sun: Vec3,
) -> Vec3 {
    let cos_gamma = direction.dot(sun).clamp(-1.0, 1.0);
    let gamma = libm::acosf(cos_gamma);
    let cos_theta = direction.z.max(0.0);
    let channel = |c: usize| {
        let p = &coefficients[9 * c..9 * c + 9];
        let mie = (1.0 + cos_gamma * cos_gamma)
            / libm::powf(1.0 + p[8] * p[8] - 2.0 * p[8] * cos_gamma, 1.5);
        let gradient = 1.0 + p[0] * libm::expf(p[1] / (cos_theta + 0.01));
        let glow = p[2]
            + p[3] * libm::expf(p[4] * gamma)
            + p[5] * cos_gamma * cos_gamma
            + p[6] * mie
            + p[7] * cos_theta.sqrt();
        radiances[c] * gradient * glow
    };
    Vec3::new(channel(0), channel(1), channel(2))
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    fn day() -> Dome {
        Dome::new(&crate::Sky::clear_day())
    }

    /// χ² of drawn directions against the claimed density, over bins that do not line up with
    /// the table: 15 around and 11 up, of equal steps of √z. Returns it with its bins.
    fn chi_squared(dome: &Dome, draws: u32) -> (f64, f64) {
        let (around, up, fine) = (15, 11, 60);
        let mut expected = vec![0.0f64; around * up];
        for i in 0..up * fine {
            for j in 0..around * fine {
                let root = (i as f32 + 0.5) / (up * fine) as f32;
                let z = root * root;
                let (sin, cos) = ((j as f32 + 0.5) / (around * fine) as f32 * TAU).sin_cos();
                let across = (1.0 - z * z).sqrt();
                let pdf = dome.pdf(Vec3::new(across * cos, across * sin, z));
                // dω = dz dφ and dz = 2 √z d√z.
                let area = f64::from(2.0 * root) / (up * fine) as f64 * f64::from(TAU)
                    / (around * fine) as f64;
                expected[i / fine * around + j / fine] += f64::from(pdf) * area;
            }
        }
        let total: f64 = expected.iter().sum();
        assert!((total - 1.0).abs() < 2e-3, "the density adds up to {total}");
        let mut counts = vec![0u32; around * up];
        let mut chance = Seed(2).stream("sky", 0);
        for _ in 0..draws {
            let sample = dome.sample([chance.unit() as f32, chance.unit() as f32]);
            let row = (sample.direction.z.sqrt() * up as f32) as usize;
            let column = (azimuth_turns(sample.direction) * around as f32) as usize;
            counts[row.min(up - 1) * around + column.min(around - 1)] += 1;
        }
        let terms = counts.iter().zip(&expected).filter(|(_, share)| **share > 0.0);
        let term = |(count, share): (&u32, &f64)| {
            let mean = share / total * f64::from(draws);
            (f64::from(*count) - mean).powi(2) / mean
        };
        (terms.map(term).sum(), (around * up) as f64)
    }

    #[test]
    fn drawn_directions_have_the_density_they_claim() {
        for elevation in [5.0, 35.0, 85.0] {
            let sky = crate::Sky { sun_elevation_deg: elevation, ..crate::Sky::clear_day() };
            let (chi, bins) = chi_squared(&Dome::new(&sky), 100_000);
            // Five standard deviations of χ² above its mean.
            assert!(chi < bins + 5.0 * (2.0 * bins).sqrt(), "sun at {elevation}°: χ² {chi}");
        }
    }

    #[test]
    fn directions_drawn_from_a_picture_have_the_density_they_claim() {
        // χ² over 20 x 20 cells of equal solid angle, which do not line up with the picture's.
        let mut chance = Seed(8).stream("picture", 0);
        let cells: Vec<Vec3> =
            (0..64 * 32).map(|_| Vec3::splat(chance.unit().powi(6) as f32)).collect();
        let layout = Layout::Sphere { columns: 64, rows: 32 };
        let dome = Dome::of_table(SkyTable { layout, cells });
        // Fine enough for the rows at the poles, whose heights are a two-hundredth of the whole.
        let (side, fine, draws) = (20, 160, 200_000);
        let mut expected = vec![0.0f64; side * side];
        for i in 0..side * fine {
            for j in 0..side * fine {
                let part = |k: usize| (k as f32 + 0.5) / (side * fine) as f32;
                let z = 2.0 * part(i) - 1.0;
                let (sin, cos) = (TAU * part(j)).sin_cos();
                let across = (1.0 - z * z).sqrt();
                let pdf = f64::from(dome.pdf(Vec3::new(across * cos, across * sin, z)));
                expected[i / fine * side + j / fine] += pdf;
            }
        }
        let cell = 4.0 * std::f64::consts::PI / (side * fine).pow(2) as f64;
        let total = expected.iter().sum::<f64>() * cell;
        assert!((total - 1.0).abs() < 3e-3, "the density adds up to {total}");
        let mut counts = vec![0u32; side * side];
        for _ in 0..draws {
            let way = dome.sample([chance.unit() as f32, chance.unit() as f32]).direction;
            let row = ((way.z + 1.0) / 2.0 * side as f32) as usize;
            let column = (azimuth_turns(way) * side as f32) as usize;
            counts[row.min(side - 1) * side + column.min(side - 1)] += 1;
        }
        let chi: f64 = (counts.iter().zip(&expected))
            .map(|(&count, &share)| {
                let mean = share * cell / total * f64::from(draws);
                (f64::from(count) - mean).powi(2) / mean
            })
            .sum();
        let bins = (side * side) as f64;
        assert!(chi < bins + 5.0 * (2.0 * bins).sqrt(), "χ² {chi}");
    }

    #[test]
    fn clouds_hide_the_sun_behind_them_and_light_the_ground_less() {
        let image = |cover: f32| weald_contract::Image {
            width: 1,
            height: 1,
            values: vec![cover],
            is_float: true,
            frame: None,
        };
        let with = |cover: f32| {
            let image = image(cover);
            let pictures = SkyPictures { image: None, clouds: Some(&image) };
            Dome::with_pictures(&crate::Sky::clear_day(), pictures).unwrap()
        };
        let (clear, half, thick) = (with(0.0), with(0.5), with(1.0));
        assert!((clear.irradiance() / day().irradiance() - 1.0).abs().max_element() < 0.02);
        assert_eq!(thick.sun.unwrap().radiance, Vec3::ZERO);
        assert!(half.irradiance().x > clear.irradiance().x, "broken clouds are brighter than blue");
        let on_ground = |dome: &Dome| {
            let sun = dome.sun.unwrap();
            luminance(dome.irradiance().to_array())
                + luminance((sun.radiance * sun.solid_angle()).to_array()) * sun.direction.z
        };
        // An overcast sky lets a quarter to a half of a clear day's light through [IESNA00] ch. 8.
        assert!((0.2..0.5).contains(&(on_ground(&thick) / on_ground(&clear))));
    }

    #[test]
    fn a_drawn_direction_asked_for_its_density_gives_the_one_it_was_drawn_with() {
        let dome = day();
        let mut chance = Seed(3).stream("sky", 0);
        let differs = |_: &u32| {
            let sample = dome.sample([chance.unit() as f32, chance.unit() as f32]);
            (dome.pdf(sample.direction) / sample.pdf - 1.0).abs() > 1e-4
        };
        // Rounding takes a direction on the rim of a cell to its neighbour now and then.
        assert!((0..20_000).filter(differs).count() < 20);
    }

    #[test]
    fn the_mean_of_light_over_density_is_the_irradiance() {
        let dome = day();
        let mut chance = Seed(2).stream("sky", 1);
        let n = 60_000;
        let mut light = Vec3::ZERO;
        for _ in 0..n {
            let sample = dome.sample([chance.unit() as f32, chance.unit() as f32]);
            light += sample.radiance * (sample.direction.z / sample.pdf / n as f32);
        }
        let exact = dome.irradiance();
        assert!((light - exact).abs().max_element() < 0.02 * exact.max_element());
    }

    #[test]
    fn a_constant_dome_lights_level_ground_with_pi() {
        let light = Dome::constant(1.0).irradiance();
        assert!((light - PI).abs().max_element() < 1e-3, "{light}");
    }

    #[test]
    fn sun_and_sky_stand_in_the_proportion_of_a_clear_day() {
        // On a clear day with the sun at 35° the sun gives 127.5 exp(-0.21 / sin 35°) klx where
        // it is faced and the sky a fifth of the light on level ground [IESNA00] ch. 8.
        let dome = day();
        let sun = dome.sun.unwrap();
        let direct = luminance((sun.radiance * sun.solid_angle()).to_array()) * sun.direction.z;
        let sky = luminance(dome.irradiance().to_array());
        assert!((50.0..80.0).contains(&(direct + sky)), "{direct} + {sky} klx");
        assert!((0.15..0.30).contains(&(sky / (sky + direct))), "{direct} + {sky} klx");
    }

    #[test]
    fn the_clear_sky_gives_the_illuminance_that_was_measured() {
        // Clear sky without sun, on level ground: 0.8 + 15.5 √sin(elevation) klx [IESNA00] ch. 8.
        for degrees in [15.0f32, 30.0, 45.0, 60.0, 75.0] {
            let sky = crate::Sky {
                sun_elevation_deg: degrees,
                turbidity: 2.5,
                ..crate::Sky::clear_day()
            };
            let measured = 0.8 + 15.5 * degrees.to_radians().sin().sqrt();
            let got = luminance(Dome::new(&sky).irradiance().to_array());
            assert!((got / measured - 1.0).abs() < 0.25, "{degrees}°: {got} klx, not {measured}");
        }
    }

    #[test]
    fn the_sun_of_a_low_elevation_is_redder() {
        let [r, _, b] = sun_irradiance(10f64.to_radians(), 3.0);
        let [high_r, _, high_b] = sun_irradiance(60f64.to_radians(), 3.0);
        assert!(r / b > 1.3 * high_r / high_b);
    }

    #[test]
    fn our_formula_gives_the_radiance_of_the_published_model() {
        use hw_skymodel::rgb::{Channel, SkyParams, SkyState};
        let params = SkyParams { elevation: 0.6, turbidity: 3.0, albedo: [0.2; 3] };
        let state = SkyState::new(&params).unwrap();
        let (coefficients, radiances) = state.raw();
        let sun = Vec3::new(0.6f32.cos(), 0.0, 0.6f32.sin());
        let direction = Vec3::new(0.2, 0.5, 0.7).normalize();
        let mine = hosek_wilkie(&coefficients, &radiances, direction, sun);
        let gamma = direction.angle_between(sun);
        let theirs = state.radiance(direction.z.acos(), gamma, Channel::G);
        assert!((mine.y / theirs - 1.0).abs() < 1e-4);
    }

    #[test]
    fn the_sun_is_drawn_inside_its_disc() {
        let sun = day().sun.unwrap();
        let mut chance = Seed(4).stream("sun", 0);
        for _ in 0..1000 {
            let u = [chance.unit() as f32 * 0.99, chance.unit() as f32];
            let angle = sun.sample(u).direction.as_dvec3().cross(sun.direction.as_dvec3()).length();
            assert!(angle < SUN_RADIUS * 1.001);
        }
        assert!((sun.solid_angle() - 6.8e-5).abs() < 1e-6, "{}", sun.solid_angle());
    }
}
