//! The tables `[render]` and `[sky]` of a scene.

use weald_contract::{Input, InputKind, Problem, Problems, Span, View, Written, table, words};

words! {
    /// How light is followed.
    pub enum Light {
        /// Paths of up to `bounces` scatterings: what is right.
        Paths = "paths",
        /// From what the eye sees to sun and sky only, dimmed by the leaves on the way [Deussen98]:
        /// what is fast.
        Direct = "direct",
    }
}

table! {
    /// How the picture is made.
    pub struct Config {
        /// Name of the `[[view]]` to render; without it, the first.
        view: Written<String> = Written { value: String::new(), span: Span::default() };
        /// Pixels across and down.
        resolution: [u32; 2] = [960, 540], in 1.0..=16384.0;
        /// Light paths traced for each pixel; with `noise`, at most.
        samples: u32 = 24, in 1.0..=65536.0;
        /// Noise at which a square of 16 x 16 pixels is good enough and gets no more samples: the
        /// standard error of its pixels over its mean luminance. 0 takes all samples everywhere.
        noise: f32 = 0.0, in 0.0..=1.0;
        /// Scattering events after which a path ends; 1 is direct light only.
        bounces: u32 = 6, in 1.0..=64.0;
        /// How much colours vary from leaf to leaf and from plant to plant: 1 as in nature, 0 not at
        /// all; leaves have up to 16 % less reflectance and transmittance then, wood up to 12 %.
        variation: f32 = 1.0, in 0.0..=5.0;
        /// How light is followed: `paths`, or `direct` for a fast picture.
        light: Light = Light::Paths;
        /// Stops by which the preview is brighter than the automatic exposure; the EXR is not
        /// touched by it.
        exposure: f32 = 0.0, in -20.0..=20.0;
        /// Whether Open Image Denoise takes the noise out, where it is installed.
        denoise: bool = false;
        /// Diameter of the lens, mm; 0 is a pinhole, where everything is sharp. The lens is
        /// focused on the point that the view looks at.
        aperture_mm: f32 = 0.0, in 0.0..=1000.0;
    }
}

table! {
    /// The light of the day.
    pub struct Sky {
        /// Direction of the sun, degrees clockwise from north.
        sun_azimuth_deg: f32 = 210.0, in -360.0..=360.0;
        /// Height of the sun above the horizon, degrees.
        sun_elevation_deg: f32 = 35.0, in 0.5..=90.0;
        /// Turbidity: 2 is very clear, 3 a clear day, 6 hazy, 10 thick [HW12].
        turbidity: f32 = 3.0, in 1.0..=10.0;
        /// Reflectance of the ground far around, which lights the sky from below.
        ground_albedo: f32 = 0.15, in 0.0..=1.0;
        /// Extinction of the air between things and the eye, 1/km; 0.1 is clear, 4 is fog.
        haze: f32 = 0.1, in 0.0..=1000.0;
        /// A picture of the light from all directions, EXR, twice as wide as high, which takes the
        /// place of sun and sky: its middle looks north, its top at the zenith.
        image: Option<Written<String>> = None;
        /// Turn of that picture, degrees clockwise seen from above.
        image_turn_deg: f32 = 0.0, in -360.0..=360.0;
        /// Factor that takes the picture's values to kcd/m².
        image_gain: f32 = 1.0, in 0.0..=1000000.0;
        /// A picture of clouds seen from above, north up, 0 clear to 1 thick; it repeats.
        clouds: Option<Written<String>> = None;
        /// Height of the clouds above the scene, m.
        cloud_height: f32 = 1500.0, in 10.0..=100000.0;
        /// Ground that a side of the picture of clouds covers, m.
        cloud_size: f32 = 6000.0, in 10.0..=1000000.0;
    }
}

/// Most pixels of a picture: 8K and a little more, some 13 GB while they are joined.
const MOST_PIXELS: u64 = 40_000_000;

impl Config {
    /// Finds what is wrong before any work: a view that does not exist, too large a picture.
    pub fn check(&self, views: &[View]) -> Problems {
        let mistakes = [self.find_view(views).err(), self.check_size().err()];
        mistakes.into_iter().flatten().collect()
    }

    /// Memory that the picture will need while it is made, bytes.
    pub fn film_bytes(&self) -> u64 {
        let [width, height] = self.resolution.map(u64::from);
        // Tiles and the film hold each pixel once while they are joined.
        2 * width * height * size_of::<crate::film::Pixel>() as u64
    }

    /// Refuses pictures of more than [`MOST_PIXELS`].
    pub(crate) fn check_size(&self) -> Result<(), Problem> {
        let [width, height] = self.resolution.map(u64::from);
        if width * height <= MOST_PIXELS {
            return Ok(());
        }
        let message = format!("`render.resolution` asks for {width} x {height} pixels");
        let hint = format!("at most {MOST_PIXELS} in all, for instance 7680 x 4320");
        Err(Problem::new(message).hint(hint))
    }

    /// The view that the table names.
    ///
    /// # Errors
    /// There is none of that name; the problem lists those that exist.
    pub fn find_view<'a>(&self, views: &'a [View]) -> Result<&'a View, Problem> {
        let is_wanted = |view: &&View| self.view.value.is_empty() || view.name == self.view.value;
        views.iter().find(is_wanted).ok_or_else(|| {
            if self.view.value.is_empty() {
                return Problem::new("the scene has no view to render".to_string())
                    .hint("add a `[[view]]` with `name`, `stand_at` and `look_at`");
            }
            let names: Vec<&str> = views.iter().map(|view| view.name.as_str()).collect();
            let hint = match weald_contract::source::nearest(&self.view.value, names.clone()) {
                Some(near) => format!("did you mean `{near}`?"),
                None if names.is_empty() => "the scene has no `[[view]]`".to_string(),
                None => format!("views of this scene: {}", names.join(", ")),
            };
            Problem::at(self.view.span, format!("unknown view `{}`", self.view.value)).hint(hint)
        })
    }
}

impl Sky {
    /// The sky of a table that says nothing.
    pub fn clear_day() -> Self {
        Self {
            sun_azimuth_deg: 210.0,
            sun_elevation_deg: 35.0,
            turbidity: 3.0,
            ground_albedo: 0.15,
            haze: 0.1,
            image: None,
            image_turn_deg: 0.0,
            image_gain: 1.0,
            clouds: None,
            cloud_height: 1500.0,
            cloud_size: 6000.0,
        }
    }

    /// The pictures that the table names.
    pub fn inputs(&self) -> Vec<Input> {
        let input = |field: &str, path: &Written<String>, kind: InputKind| Input {
            field: format!("sky.{field}"),
            path: path.clone(),
            kind,
        };
        let image = self.image.iter().map(|path| input("image", path, InputKind::Light));
        let clouds = self.clouds.iter().map(|path| input("clouds", path, InputKind::Image));
        image.chain(clouds).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    #[test]
    fn an_empty_sky_table_is_a_clear_day() {
        let value = Value::parse(0, "").unwrap();
        assert_eq!(Sky::from_toml(&value, &mut Vec::new()), Some(Sky::clear_day()));
    }

    #[test]
    fn a_picture_too_large_for_memory_is_refused_before_any_work() {
        let text = "view = \"bank\"\nresolution = [16384, 16384]";
        let value = Value::parse(0, text).unwrap();
        let config = Config::from_toml(&value, &mut Vec::new()).unwrap();
        let problem = config.check_size().unwrap_err().to_string();
        assert!(problem.contains("16384 x 16384") && problem.contains("7680 x 4320"), "{problem}");
    }

    #[test]
    fn a_misspelt_view_is_pointed_at() {
        let value = Value::parse(0, "view = \"bnak\"").unwrap();
        let config = Config::from_toml(&value, &mut Vec::new()).unwrap();
        let view = "name = \"bank\"\nstand_at = [0, 0]\nlook_at = [1, 0]";
        let view = View::from_toml(&Value::parse(0, view).unwrap(), &mut Vec::new()).unwrap();
        let problems = config.check(&[view]);
        assert!(problems[0].to_string().contains("did you mean `bank`?"));
        assert!(problems[0].span.is_some());
    }
}
