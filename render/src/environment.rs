//! Skies from pictures: photographs of all directions, and clouds.

use crate::Error;
use crate::sky::{Layout, SkyTable};
use glam::Vec3;
use std::f32::consts::{FRAC_1_PI, PI, TAU};
use weald_contract::{Image, Picture};

/// Pictures that `[sky]` names, opened by the caller.
#[derive(Clone, Copy, Default)]
pub struct SkyPictures<'a> {
    /// Radiance from everywhere, for [`Sky::image`](crate::Sky): columns clockwise from south over
    /// west, north (in the middle) and east, rows from the zenith down.
    pub image: Option<&'a Picture>,
    /// Cover of clouds, for [`Sky::clouds`](crate::Sky): 0 clear to 1 thick.
    pub clouds: Option<&'a Image>,
}

/// Most columns of a table; larger pictures are averaged down to it.
const MOST_COLUMNS: usize = 4096;

/// Part of the light on a cloud that it sends down; thick ones send less. Chosen so that an overcast
/// sky lets a quarter to a half of a clear day through [IESNA00].
const CLOUD_WHITENESS: f32 = 0.55;

/// Radiance of a picture from all directions, turned clockwise and brightened.
pub(crate) fn table_of(picture: &Picture, turn: f32, gain: f32) -> Result<SkyTable, Error> {
    let wrong = |what: &str| Error::BadSky { what: what.to_string() };
    let names = [["R", "r", "Y"], ["G", "g", "Y"], ["B", "b", "Y"]];
    let channel = |names: [&str; 3]| names.iter().find_map(|name| picture.channel(name));
    let [Some(red), Some(green), Some(blue)] = names.map(channel) else {
        return Err(wrong("it has no channels R, G and B"));
    };
    let (width, height) = (picture.width, picture.height);
    if width < 4 || height < 2 || width != 2 * height {
        let size = format!("it has {width} x {height} pixels; twice as wide as high is right");
        return Err(wrong(&size));
    }
    let step = width.div_ceil(MOST_COLUMNS);
    let (columns, rows) = (width / step, height / step);
    let pixel = |x: usize, y: usize| {
        let index = y * width + x % width;
        Vec3::new(red[index], green[index], blue[index])
    };
    if let Some(index) =
        red.iter().chain(green).chain(blue).position(|v| !v.is_finite() || *v < 0.0)
    {
        let at = index % (width * height);
        let place = format!("column {}, row {}", at % width, at / width);
        return Err(wrong(&format!("its light is no number, or below 0, at {place}")));
    }
    let layout = Layout::Sphere { columns, rows };
    let cell = |index: usize| {
        // The table's rows rise and its columns run counter-clockwise from east.
        let (row, column) = (index / columns, index % columns);
        let azimuth = PI / 2.0 - (column as f32 + 0.5) / columns as f32 * TAU - turn;
        let left = (azimuth / TAU + 0.5).rem_euclid(1.0) * width as f32;
        let first = (left - 0.5 * step as f32).round() as i64;
        let top = (rows - 1 - row) * step;
        let mut sum = Vec3::ZERO;
        for y in top..top + step {
            for x in 0..step {
                sum += pixel((first + x as i64).rem_euclid(width as i64) as usize, y);
            }
        }
        sum * (gain / (step * step) as f32)
    };
    Ok(SkyTable { layout, cells: (0..columns * rows).map(cell).collect() })
}

/// Clouds on a plane above the scene.
pub(crate) struct Clouds<'a> {
    pub image: &'a Image,
    /// Side of the picture on the plane over the plane's height.
    pub size: f32,
}

impl Clouds<'_> {
    /// Cover in a direction, 0 to 1; clouds fade into the haze at the horizon.
    pub fn cover(&self, direction: Vec3) -> f32 {
        if direction.z <= 0.01 {
            return 0.0;
        }
        let reach = 1.0 / (direction.z * self.size);
        let at =
            |along: f32, side: usize| (along * reach + 0.5).rem_euclid(1.0) * side as f32 - 0.5;
        let (x, y) = (at(direction.x, self.image.width), at(-direction.y, self.image.height));
        let (x0, y0) = (x.floor(), y.floor());
        let pixel = |x: f32, y: f32| {
            let column = (x as i64).rem_euclid(self.image.width as i64) as usize;
            let row = (y as i64).rem_euclid(self.image.height as i64) as usize;
            self.image.values[row * self.image.width + column]
        };
        let line = |y: f32| pixel(x0, y) * (1.0 - (x - x0)) + pixel(x0 + 1.0, y) * (x - x0);
        let cover = line(y0) * (1.0 - (y - y0)) + line(y0 + 1.0) * (y - y0);
        let cover = if cover.is_finite() { cover.clamp(0.0, 1.0) } else { 0.0 };
        cover * crate::noise::smoothstep(0.02, 0.2, direction.z)
    }

    /// Radiance of a cloud: white by the light of sun and sky on it, brighter towards the sun
    /// where it is thin.
    pub fn radiance(&self, cover: f32, light: Vec3, toward_sun: f32) -> Vec3 {
        let silver = 1.0 + 1.5 * (1.0 - cover) * (0.5 + 0.5 * toward_sun).powi(8);
        light * (CLOUD_WHITENESS * FRAC_1_PI * (1.0 - 0.55 * cover) * silver)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::sky::Dome;

    /// A picture that is bright in one pixel of 32 x 16.
    fn lamp(x: usize, y: usize) -> Picture {
        let mut picture = Picture::new(32, 16);
        for name in ["R", "G", "B"] {
            let values = (0..512).map(|i| if i == y * 32 + x { 100.0 } else { 0.5 }).collect();
            picture.add(name, true, values);
        }
        picture
    }

    #[test]
    fn the_middle_of_the_picture_is_north_and_its_right_half_east() {
        let dome =
            |picture: &Picture, turn: f32| Dome::of_table(table_of(picture, turn, 1.0).unwrap());
        let north = dome(&lamp(16, 7), 0.0);
        let way = |degrees: f32| {
            Vec3::new(degrees.to_radians().sin(), degrees.to_radians().cos(), 0.09).normalize()
        };
        assert!(north.radiance(way(5.6)).x > 90.0);
        assert!(dome(&lamp(24, 7), 0.0).radiance(way(95.6)).x > 90.0);
        // Turned by 90° clockwise, what was in the north stands in the east.
        assert!(dome(&lamp(16, 7), PI / 2.0).radiance(way(95.6)).x > 90.0);
        // The top row is at the zenith, its fourth pixel south-west of it.
        let zenith = way(219.4) * Vec3::new(0.05, 0.05, 0.0) + Vec3::Z;
        assert!(dome(&lamp(3, 0), 0.0).radiance(zenith.normalize()).x > 90.0);
        assert_eq!(dome(&lamp(3, 0), 0.0).radiance(-Vec3::Z).x, 0.5);
    }

    #[test]
    fn odd_pictures_are_refused_in_words() {
        let error = |picture: &Picture| table_of(picture, 0.0, 1.0).err().unwrap().to_string();
        assert!(error(&Picture::new(8, 4)).contains("channels"));
        let mut square = lamp(0, 0);
        square.height = 8;
        assert!(error(&square).contains("32 x 8"));
        let mut dark = lamp(0, 0);
        dark.channels[1].values[40] = f32::NAN;
        assert!(error(&dark).contains("column 8, row 1"));
    }

    #[test]
    fn clouds_cover_what_stands_over_them() {
        let values = vec![1.0, 1.0, 0.0, 0.0];
        let image = Image { width: 2, height: 2, values, is_float: true, frame: None };
        let clouds = Clouds { image: &image, size: 4.0 };
        let cover = |x: f32, y: f32| clouds.cover(Vec3::new(x, y, 1.0).normalize());
        // The first row of a picture lies to the north.
        assert_eq!((cover(0.3, 1.0), cover(0.3, -1.0)), (1.0, 0.0));
        assert_eq!(clouds.cover(Vec3::X), 0.0);
    }
}
