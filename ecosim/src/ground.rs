//! The ground under a plant: how high, how steep, how deep under water.

use crate::Error;
use crate::field::Field;
use crate::species::Ecology;
use glam::Vec3;
use weald_contract::{Frame, Layers, Problem};

/// Depth up to which ground counts as dry, m: a film that interpolation leaves at a shore.
const FILM: f32 = 0.01;

/// The terrain as plants meet it.
#[derive(Clone, Debug)]
pub(crate) struct Ground<'a> {
    pub(crate) terrain: &'a Layers,
    altitude: Field<'a>,
    water_depth: Option<Field<'a>>,
    soil_moisture: Option<Field<'a>>,
}

impl<'a> Ground<'a> {
    /// Looks up the layers that plants depend on.
    pub(crate) fn new(terrain: &'a Layers) -> Result<Self, Error> {
        let layer = |name| Field::layer(terrain, name);
        let altitude =
            layer("altitude").ok_or_else(|| Problem::new("the terrain has no layer `altitude`"))?;
        if terrain.frame.is_empty() {
            return Err(Problem::new("the terrain has no cells").into());
        }
        let (water_depth, soil_moisture) = (layer("water_depth"), layer("soil_moisture"));
        Ok(Self { terrain, altitude, water_depth, soil_moisture })
    }

    /// Returns where the terrain lies.
    pub(crate) fn frame(&self) -> &Frame {
        &self.terrain.frame
    }

    /// Returns the area of the terrain, m².
    pub(crate) fn area(&self) -> f64 {
        self.frame().len() as f64 * self.frame().cell_area()
    }

    /// Returns the altitude, m.
    pub(crate) fn altitude(&self, x: f64, y: f64) -> f32 {
        self.altitude.at(x, y)
    }

    /// Returns the depth of water, m; 0 on dry ground.
    pub(crate) fn water_depth(&self, x: f64, y: f64) -> f32 {
        self.water_depth.as_ref().map_or(0.0, |field| field.at(x, y).max(0.0))
    }

    /// Returns the soil moisture, 0 to 1; middling where the terrain does not say.
    pub(crate) fn soil_moisture(&self, x: f64, y: f64) -> f32 {
        self.soil_moisture.as_ref().map_or(0.5, |field| field.at(x, y))
    }

    /// Returns how well a place suits a species, 0 to 1: the product of its responses to moisture
    /// and to all layers that it answers to.
    pub(crate) fn suitability(&self, ecology: &Ecology, x: f64, y: f64) -> f32 {
        let of_layers = ecology.response.iter().map(|response| {
            let layer = Field::layer(self.terrain, &response.layer.value);
            layer.map_or(1.0, |layer| response.at(layer.at(x, y)))
        });
        ecology.suitability(self.soil_moisture(x, y)) * of_layers.product::<f32>()
    }

    /// Returns the unit normal, from central differences over one cell to each side.
    pub(crate) fn normal(&self, x: f64, y: f64) -> Vec3 {
        let h = self.altitude.cell(x, y);
        let along = |dx: f64, dy: f64| {
            (self.altitude(x + dx, y + dy) - self.altitude(x - dx, y - dy)) / (2.0 * h) as f32
        };
        Vec3::new(-along(h, 0.0), -along(0.0, h), 1.0).normalize()
    }

    /// Returns whether a plant of this ecology can stand at a place: on the terrain, in water
    /// of a depth it bears, on ground that is not too steep.
    pub(crate) fn bears(&self, ecology: &Ecology, x: f64, y: f64) -> bool {
        self.frame().contains(x, y)
            && self.is_depth_right(ecology, x, y)
            && self.is_gentle_enough(ecology, x, y)
    }

    /// Returns whether the water at a place is as deep as a plant of this ecology bears.
    pub(crate) fn is_depth_right(&self, ecology: &Ecology, x: f64, y: f64) -> bool {
        let [least, greatest] = ecology.water_depth;
        let depth = self.water_depth(x, y);
        depth >= least && depth <= greatest.max(FILM)
    }

    fn is_gentle_enough(&self, ecology: &Ecology, x: f64, y: f64) -> bool {
        // cos(slope) is the normal's z; comparing cosines spares the inverse function.
        ecology.slope_max_deg >= 90.0
            || self.normal(x, y).z >= libm::cosf(ecology.slope_max_deg.to_radians())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stand::tests::ramp;

    #[test]
    fn a_ramp_has_the_normal_of_its_plane() {
        // Rises one metre in two towards the east: normal (-1/2, 0, 1) / |..|.
        let terrain = ramp(20, 1.0, 0.5);
        let normal = Ground::new(&terrain).unwrap().normal(10.0, 10.0);
        assert!((normal - Vec3::new(-0.5, 0.0, 1.0).normalize()).length() < 1e-5);
    }

    #[test]
    fn steep_ground_bears_only_what_clings_to_it() {
        // A slope of 26.57 degrees.
        let terrain = ramp(20, 1.0, 0.5);
        let ground = Ground::new(&terrain).unwrap();
        let ecology = |slope_max_deg| Ecology { slope_max_deg, ..Ecology::default() };
        assert!(ground.bears(&ecology(27.0), 10.0, 10.0));
        assert!(!ground.bears(&ecology(26.0), 10.0, 10.0));
        assert!(!ground.bears(&ecology(27.0), 21.0, 10.0));
    }

    #[test]
    fn water_bears_only_what_stands_in_it() {
        let mut terrain = ramp(20, 1.0, 0.0);
        let depth = (0..400).map(|i| if i % 20 < 10 { 0.3 } else { 0.0 }).collect();
        terrain.insert("water_depth", "m", "depth", depth);
        let ground = Ground::new(&terrain).unwrap();
        let reed = Ecology { water_depth: [0.1, 0.5], ..Ecology::default() };
        assert!(ground.bears(&reed, 5.0, 5.0) && !ground.bears(&reed, 15.0, 5.0));
        let oak = Ecology::default();
        assert!(!ground.bears(&oak, 5.0, 5.0) && ground.bears(&oak, 15.0, 5.0));
    }
}
