//! Where a person stands and looks: used by terrain (finer ground), ecosim, quantize and render.

use crate::layers::Layers;

crate::words! {
    /// How the directions of a view become a flat picture.
    pub enum Projection {
        /// As a photograph: `fov_deg` across.
        Perspective = "perspective",
        /// Without foreshortening, as a plan or an elevation: as wide as the perspective view is
        /// at the point that is looked at.
        Orthographic = "orthographic",
        /// All around and from straight down to straight up, the point that is looked at in the
        /// middle column: 360° by 180° for a picture twice as wide as high.
        Panorama = "panorama",
    }
}

crate::table! {
    /// A view of the scene.
    pub struct View {
        /// Name, by which other tables refer to it.
        name: String;
        /// Place to stand, scene coordinates, m.
        stand_at: [f64; 2], in -1000000.0..=1000000.0;
        /// Height of the eye above the ground or water there, m.
        eye_height: f64 = 1.7, in 0.01..=100000.0;
        /// Place to look at, scene coordinates, m.
        look_at: [f64; 2], in -1000000.0..=1000000.0;
        /// Height above the ground or water of the point looked at, m.
        look_height: f64 = 1.0, in -1000.0..=100000.0;
        /// Horizontal angle of view, degrees.
        fov_deg: f64 = 50.0, in 1.0..=170.0;
        /// How directions become a flat picture.
        projection: Projection = Projection::Perspective;
    }
}

/// Eye and target of a view in map coordinates, with altitudes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sight {
    /// Where the eye is, m.
    pub eye: [f64; 3],
    /// What it looks at, m.
    pub target: [f64; 3],
}

impl View {
    /// Puts the view on a terrain: heights count from the ground, or from the water above it.
    pub fn sight(&self, terrain: &Layers) -> Sight {
        let place = |at: [f64; 2], height: f64| {
            let (x, y) = (terrain.frame.west + at[0], terrain.frame.south + at[1]);
            let ground = terrain.sample("altitude", x, y).unwrap_or(0.0);
            let water = terrain.sample("water_depth", x, y).unwrap_or(0.0);
            [x, y, f64::from(ground) + f64::from(water.max(0.0)) + height]
        };
        Sight {
            eye: place(self.stand_at, self.eye_height),
            target: place(self.look_at, self.look_height),
        }
    }
}
