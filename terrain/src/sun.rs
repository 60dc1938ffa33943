//! Sun and sky: how much light reaches the ground past the hills around it.
//!
//! The sun's path follows the formulas of [FAO56, eq. 21 to 26]; the beam is weakened by the air it
//! crosses, light from the sky follows from the beam [Liu60], and both meet the slope of the ground.
//! Horizons are found in a fan of azimuths. Along each, the ground is cut into parallel profiles; the
//! highest point that a cell sees lies on the upper hull of the profile in front of it, which one
//! sweep keeps up to date, so that a horizon costs the same wherever it lies.

use crate::derive;
use rayon::prelude::*;
use std::f64::consts::{FRAC_PI_2, PI, TAU};

/// Solar constant, MJ m⁻² per minute [FAO56, eq. 21].
const SOLAR_CONSTANT: f64 = 0.0820;

/// Minutes that the sun takes for one radian of hour angle.
const MINUTES_PER_RADIAN: f64 = 24.0 * 60.0 / TAU;

/// Azimuths in which horizons are sought: 5.6 degrees apart, a third of what the sun moves along
/// the horizon in an hour.
const AZIMUTHS: usize = 64;

/// Horizons held at a time; bounds memory at 4 bytes a cell each.
const AZIMUTHS_AT_A_TIME: usize = 4;

/// The ground that is lit.
#[derive(Clone, Copy, Debug)]
pub struct Relief<'a> {
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
    /// Side of a cell, m.
    pub cell: f64,
    /// Altitudes, m.
    pub altitude: &'a [f32],
}

/// Where the sun goes, and through what air.
#[derive(Clone, Debug, PartialEq)]
pub struct Season {
    /// Latitude, radians, north positive.
    pub latitude: f64,
    /// Days of the year, from 1; the result is their mean.
    pub days: Vec<f64>,
    /// Share of the beam that passes the air when the sun stands overhead; 1 for no air at all,
    /// which leaves no light from the sky either.
    pub transmissivity: f64,
    /// Places of the sun from its rise to its set.
    pub steps: usize,
}

/// Light at every cell.
#[derive(Clone, Debug, PartialEq)]
pub struct Light {
    /// Energy on the ground's own slope, MJ m⁻² d⁻¹; empty when not asked for.
    pub insolation: Vec<f32>,
    /// Cosine-weighted share of the sky that the ground's slope sees; empty when not asked for.
    pub sky_view: Vec<f32>,
}

/// One place of the sun with what it stands for.
#[derive(Clone, Copy, Debug)]
struct Place {
    /// Unit vector to the sun: east, north, up.
    toward: [f64; 3],
    /// Tangent of the height above the horizon.
    tangent: f64,
    /// Energy of the beam on a plane that faces it, MJ m⁻² in the mean day.
    beam: f64,
}

/// Sun places of a mean day, by the azimuth nearest to each, and the light of the open sky.
struct Course {
    by_azimuth: Vec<Vec<Place>>,
    /// Diffuse energy on level open ground, MJ m⁻² d⁻¹.
    diffuse: f64,
}

impl Season {
    fn course(&self) -> Course {
        let mut course = Course { by_azimuth: vec![Vec::new(); AZIMUTHS], diffuse: 0.0 };
        for day in &self.days {
            self.add_day(*day, &mut course);
        }
        course
    }

    fn add_day(&self, day: f64, course: &mut Course) {
        let year = TAU / 365.0 * day;
        let declination = 0.409 * libm::sin(year - 1.39);
        let distance = 1.0 + 0.033 * libm::cos(year);
        let (sin_lat, cos_lat) = libm::sincos(self.latitude);
        let (sin_dec, cos_dec) = libm::sincos(declination);
        // Sun that never sets, or never rises, has a half day of π or 0.
        let cos_half = -(sin_lat * sin_dec) / (cos_lat * cos_dec).max(f64::MIN_POSITIVE);
        let half_day = libm::acos(cos_half.clamp(-1.0, 1.0));
        let step = 2.0 * half_day / self.steps.max(1) as f64;
        let minutes = step * MINUTES_PER_RADIAN / self.days.len() as f64;
        for index in 0..self.steps.max(1) {
            let hour = -half_day + (index as f64 + 0.5) * step;
            let (sin_hour, cos_hour) = libm::sincos(hour);
            let toward = [
                -cos_dec * sin_hour,
                sin_dec * cos_lat - cos_dec * sin_lat * cos_hour,
                sin_lat * sin_dec + cos_lat * cos_dec * cos_hour,
            ];
            if toward[2] <= 0.0 {
                continue;
            }
            let energy = SOLAR_CONSTANT * distance * minutes;
            let passed = self.passed(toward[2]);
            // Clear sky: the less of the beam passes, the more of it the sky sends [Liu60].
            let from_sky = (0.271 - 0.294 * passed).max(0.0);
            course.diffuse += energy * toward[2] * from_sky;
            let level = (toward[0] * toward[0] + toward[1] * toward[1]).sqrt();
            let azimuth = libm::atan2(toward[0], toward[1]).rem_euclid(TAU);
            let sector = (azimuth / TAU * AZIMUTHS as f64).round() as usize % AZIMUTHS;
            let tangent = if level > 0.0 { toward[2] / level } else { f64::INFINITY };
            course.by_azimuth[sector].push(Place { toward, tangent, beam: energy * passed });
        }
    }

    /// Share of the beam that passes the air under a sun of this sine of height: the transmissivity
    /// to the power of the air's thickness [KY89].
    fn passed(&self, sine: f64) -> f64 {
        let height = libm::asin(sine.min(1.0)).to_degrees();
        let mass = 1.0 / (sine + 0.50572 * libm::pow(height + 6.07995, -1.6364));
        libm::pow(self.transmissivity, mass)
    }
}

/// Light on the ground over a season.
///
/// Insolation is beam, unless the horizon hides the sun, plus the sky's light times the share of
/// sky that the slope sees; light from other slopes is left out. Pass no season for the sky alone.
pub fn light(relief: &Relief<'_>, season: Option<&Season>) -> Light {
    let count = relief.altitude.len();
    let course = season.map(Season::course);
    let normals = normals(relief);
    let mut beam = vec![0.0f32; if course.is_some() { count } else { 0 }];
    let mut sky = vec![0.0f32; count];
    let azimuths: Vec<usize> = (0..AZIMUTHS).collect();
    for some in azimuths.chunks(AZIMUTHS_AT_A_TIME) {
        let horizons: Vec<(usize, Vec<f32>)> =
            some.par_iter().map(|&azimuth| (azimuth, horizon(relief, angle_of(azimuth)))).collect();
        for (azimuth, horizon) in &horizons {
            add_sky(angle_of(*azimuth), horizon, &normals, &mut sky);
            if let Some(course) = &course {
                add_beam(&course.by_azimuth[*azimuth], horizon, &normals, &mut beam);
            }
        }
    }
    if let Some(course) = &course {
        let diffuse = course.diffuse as f32;
        beam.par_iter_mut().zip(&sky).for_each(|(beam, sky)| *beam += diffuse * sky);
    }
    Light { insolation: beam, sky_view: sky }
}

fn angle_of(azimuth: usize) -> f64 {
    azimuth as f64 / AZIMUTHS as f64 * TAU
}

/// Unit normals of the ground: east, north, up.
pub fn normals(relief: &Relief<'_>) -> Vec<[f32; 3]> {
    let Relief { width, height, cell, altitude } = *relief;
    let mut normals = vec![[0.0f32; 3]; altitude.len()];
    normals.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        for (column, normal) in line.iter_mut().enumerate() {
            let gradient = derive::gradient(width, height, cell, altitude, column, row);
            *normal = gradient.normal();
        }
    });
    normals
}

/// Adds one azimuth's share of the sky [Dozier90, eq. 7b].
///
/// With H from the zenith to the horizon, slope S and aspect A:
/// `(cos S sin²H + sin S cos(φ - A) (H - sin H cos H)) / n`.
fn add_sky(azimuth: f64, horizon: &[f32], normals: &[[f32; 3]], sky: &mut [f32]) {
    let (sin, cos) = libm::sincos(azimuth);
    let cells = sky.par_iter_mut().zip(horizon).zip(normals);
    cells.with_min_len(4096).for_each(|((sky, horizon), normal)| {
        let [east, north, up] = normal.map(f64::from);
        let tangent = f64::from(horizon.max(0.0));
        let from_zenith = FRAC_PI_2 - libm::atan(tangent);
        // sin²H and sin H cos H from the tangent of the height above the level.
        let squared = 1.0 / (1.0 + tangent * tangent);
        let lean = east * sin + north * cos;
        let share = up * squared + lean * (from_zenith - tangent * squared);
        *sky += (share.max(0.0) / AZIMUTHS as f64) as f32;
    });
}

/// Adds the beams of some places of the sun where they are above the horizon.
fn add_beam(places: &[Place], horizon: &[f32], normals: &[[f32; 3]], beam: &mut [f32]) {
    if places.is_empty() {
        return;
    }
    let cells = beam.par_iter_mut().zip(horizon).zip(normals);
    cells.with_min_len(4096).for_each(|((beam, horizon), normal)| {
        let [east, north, up] = normal.map(f64::from);
        let mut sum = 0.0;
        for place in places {
            let facing = east * place.toward[0] + north * place.toward[1] + up * place.toward[2];
            if facing > 0.0 && place.tangent > f64::from(*horizon) {
                sum += place.beam * facing;
            }
        }
        *beam += sum as f32;
    });
}

/// Tangent of the horizon's height at every cell, looking along an azimuth (radians clockwise from
/// north); -∞ where nothing lies that way.
///
/// Profiles pass through cell centres along the longer axis of the direction, and between them
/// along the other, where altitudes are interpolated.
pub fn horizon(relief: &Relief<'_>, azimuth: f64) -> Vec<f32> {
    let Relief { width, height, .. } = *relief;
    let (sin, cos) = libm::sincos(azimuth);
    let is_wide = sin.abs() >= cos.abs();
    // Cells along and across the profiles; `drift` is how far one step along moves across.
    let (along, across) = if is_wide { (width, height) } else { (height, width) };
    let (forward, sideways) = if is_wide { (sin, -cos) } else { (-cos, sin) };
    let drift = sideways / forward;
    let profile = Profile {
        relief,
        is_wide,
        is_forward: forward > 0.0,
        along,
        across,
        drift,
        step: relief.cell * (1.0 + drift * drift).sqrt(),
    };
    let mut horizon = vec![f32::NEG_INFINITY; width * height];
    let total = (drift * along.saturating_sub(1) as f64).round() as isize;
    let (first, last) = (total.min(0), total.max(0));
    let mut hull = Vec::new();
    // Each cell lies on one profile: that which starts at `across - round(drift * along)`.
    for start in -last..across as isize - first {
        profile.sweep(start, &mut hull, &mut horizon);
    }
    horizon
}

/// A family of parallel lines over the ground.
struct Profile<'a> {
    relief: &'a Relief<'a>,
    is_wide: bool,
    /// Whether the direction of sight runs towards higher indices.
    is_forward: bool,
    along: usize,
    across: usize,
    drift: f64,
    /// Metres from one point to the next.
    step: f64,
}

impl Profile<'_> {
    /// Walks one line against the direction of sight, so that what is in front comes first.
    fn sweep(&self, start: isize, hull: &mut Vec<(f64, f64)>, horizon: &mut [f32]) {
        hull.clear();
        for index in 0..self.along {
            let along = if self.is_forward { self.along - 1 - index } else { index };
            let place = start as f64 + self.drift * along as f64;
            let nearest = start + (self.drift * along as f64).round() as isize;
            if nearest < 0 || nearest >= self.across as isize {
                continue;
            }
            let z = self.altitude(along, place);
            let t = index as f64 * self.step;
            // Of the hull's points only those stay that are seen from here.
            while let [.., before, last] = hull.as_slice() {
                let is_hidden = (before.1 - z) * (t - last.0) >= (last.1 - z) * (t - before.0);
                if !is_hidden {
                    break;
                }
                hull.pop();
            }
            if let Some(last) = hull.last() {
                let cell = self.cell(along, nearest as usize);
                horizon[cell] = ((last.1 - z) / (t - last.0)) as f32;
            }
            hull.push((t, z));
        }
    }

    fn cell(&self, along: usize, across: usize) -> usize {
        let width = self.relief.width;
        if self.is_wide { across * width + along } else { along * width + across }
    }

    /// Altitude between the two cells that a line passes between.
    fn altitude(&self, along: usize, place: f64) -> f64 {
        let place = place.clamp(0.0, (self.across - 1) as f64);
        let low = (place as usize).min(self.across.saturating_sub(2));
        let high = (low + 1).min(self.across - 1);
        let z = |across: usize| f64::from(self.relief.altitude[self.cell(along, across)]);
        z(low) + (place - low as f64) * (z(high) - z(low))
    }
}

/// Energy that would reach level ground without air, MJ m⁻² d⁻¹ [FAO56, eq. 21].
pub fn extraterrestrial(latitude: f64, day: f64) -> f64 {
    let year = TAU / 365.0 * day;
    let declination = 0.409 * libm::sin(year - 1.39);
    let distance = 1.0 + 0.033 * libm::cos(year);
    let cos_sunset = -libm::tan(latitude) * libm::tan(declination);
    let sunset = libm::acos(cos_sunset.clamp(-1.0, 1.0));
    let product = libm::sin(latitude) * libm::sin(declination);
    let other = libm::cos(latitude) * libm::cos(declination);
    24.0 * 60.0 / PI * SOLAR_CONSTANT * distance * (sunset * product + other * libm::sin(sunset))
}

#[cfg(test)]
mod tests {
    use super::*;

    const SIDE: usize = 41;

    /// Light in the middle of ground given in metres from there.
    fn light_at(
        season: Option<&Season>,
        side: usize,
        ground: impl Fn(f64, f64) -> f64,
    ) -> (f64, f64) {
        let middle = (side / 2) as f64;
        let z = |i: usize| ground((i % side) as f64 - middle, middle - (i / side) as f64) as f32;
        let altitude: Vec<f32> = (0..side * side).map(z).collect();
        let relief = Relief { width: side, height: side, cell: 1.0, altitude: &altitude };
        let light = light(&relief, season);
        let center = side * (side / 2) + side / 2;
        let insolation = light.insolation.get(center).map_or(0.0, |v| f64::from(*v));
        (insolation, f64::from(light.sky_view[center]))
    }

    fn airless(latitude_deg: f64, day: f64) -> Season {
        let latitude = latitude_deg.to_radians();
        Season { latitude, days: vec![day], transmissivity: 1.0, steps: 400 }
    }

    #[test]
    fn level_ground_receives_the_published_extraterrestrial_radiation() {
        // The first is the worked example 8 of FAO-56, printed as 32.2.
        let published = [
            (-20.0, 246.0, 32.19),
            (45.0, 172.0, 41.9105),
            (45.0, 80.0, 26.5251),
            (45.0, 355.0, 10.4406),
        ];
        for (latitude, day, expected) in published {
            let exact = extraterrestrial(f64::to_radians(latitude), day);
            assert!((exact / expected - 1.0).abs() < 2e-4, "{exact}");
            let (got, _) = light_at(Some(&airless(latitude, day)), SIDE, |_, _| 5.0);
            assert!((got / expected - 1.0).abs() < 1e-3, "{got} {expected}");
        }
    }

    #[test]
    fn a_slope_receives_what_level_ground_does_at_its_equivalent_latitude() {
        let tangent = 30f64.to_radians().tan();
        let published = [(172.0, 38.3268), (80.0, 36.4542), (355.0, 26.5119)];
        for (day, expected) in published {
            let season = airless(45.0, day);
            // The slope itself hides the sun only when the sun is behind it.
            let (south, _) = light_at(Some(&season), SIDE, |_, y| tangent * y);
            assert!((south / expected - 1.0).abs() < 1e-3, "{south} {expected}");
            let (east, _) = light_at(Some(&season), SIDE, |x, _| -tangent * x);
            let (west, _) = light_at(Some(&season), SIDE, |x, _| tangent * x);
            assert!((east / west - 1.0).abs() < 1e-5, "{east} {west}");
        }
        let (north, _) = light_at(Some(&airless(45.0, 355.0)), SIDE, |_, y| -tangent * y);
        assert_eq!(north, 0.0, "a northern slope of 30 degrees has no sun in midwinter");
    }

    #[test]
    fn the_floor_of_a_trench_sees_the_cosine_of_its_walls() {
        // Long enough for the walls to fill the view but for what lies along the trench.
        for degrees in [15.0, 30.0, 45.0f64] {
            let tangent = degrees.to_radians().tan();
            let (_, sky) = light_at(None, 401, |x, _| tangent * x.abs());
            let expected = degrees.to_radians().cos();
            assert!((sky - expected).abs() < 1e-2, "{degrees}: {sky} {expected}");
        }
    }

    #[test]
    fn a_tilted_plane_sees_half_of_one_plus_the_cosine_of_its_slope() {
        let tangent = 35f64.to_radians().tan();
        let (_, sky) = light_at(None, 201, |x, _| tangent * x);
        let expected = 0.5 * (1.0 + 35f64.to_radians().cos());
        assert!((sky - expected).abs() < 1e-3, "{sky} {expected}");
        let (_, level) = light_at(None, SIDE, |_, _| 0.0);
        assert!((level - 1.0).abs() < 1e-5);
    }

    #[test]
    fn horizons_are_those_of_a_search_along_the_line_of_sight() {
        let side = 61;
        let altitude = crate::flow::rough_hills(side);
        let relief = Relief { width: side, height: side, cell: 10.0, altitude: &altitude };
        let z = |x: usize, y: usize| f64::from(altitude[y * side + x]);
        let eastern = horizon(&relief, FRAC_PI_2);
        let diagonal = horizon(&relief, 0.75 * PI);
        for (x, y) in (0..side - 1).flat_map(|x| (0..side - 1).map(move |y| (x, y))) {
            let rise = |(i, there): (usize, f64), unit: f64| (there - z(x, y)) / (i as f64 * unit);
            let east = (1..side - x).map(|i| rise((i, z(x + i, y)), 10.0)).fold(f64::MIN, f64::max);
            assert!((f64::from(eastern[y * side + x]) - east).abs() < 1e-4);
            let reach = 1..(side - x).min(side - y);
            let unit = 10.0 * std::f64::consts::SQRT_2;
            let south_east =
                reach.map(|i| rise((i, z(x + i, y + i)), unit)).fold(f64::MIN, f64::max);
            assert!((f64::from(diagonal[y * side + x]) - south_east).abs() < 1e-4);
        }
    }

    #[test]
    fn a_wall_takes_the_morning_sun_and_air_takes_part_of_the_rest() {
        let season = airless(45.0, 80.0);
        let (open, _) = light_at(Some(&season), SIDE, |_, _| 0.0);
        let wall = |x: f64, _: f64| if x > 3.0 { 1000.0 } else { 0.0 };
        let (shaded, _) = light_at(Some(&season), SIDE, wall);
        // The afternoon remains, and what passes the wall's end, 4 m east and 20 m south, before noon.
        assert!((0.5..0.57).contains(&(shaded / open)), "{}", shaded / open);
        let air = Season { transmissivity: 0.7, steps: 48, ..season };
        let (through_air, _) = light_at(Some(&air), SIDE, |_, _| 0.0);
        assert!((0.5..0.8).contains(&(through_air / open)), "{}", through_air / open);
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn speed_of_a_year_of_sun() {
        let side = 1024;
        let altitude = crate::flow::rough_hills(side);
        let relief = Relief { width: side, height: side, cell: 10.0, altitude: &altitude };
        let days = (0..12).map(|month| 15.0 + 30.4 * f64::from(month)).collect();
        let season = Season { latitude: 0.8, days, transmissivity: 0.7, steps: 24 };
        let start = std::time::Instant::now();
        light(&relief, Some(&season));
        println!("12 days: {:.2} s", start.elapsed().as_secs_f64());
    }
}
