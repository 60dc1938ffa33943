//! Footprints: the ground under a house or another thing, as a mask.
//!
//! The thing's outline from above is found once from its mesh and comes here as an image in the
//! mesh's own metres; a mask may then move, turn, stretch and feather it.

use crate::nearest::{NONE, nearest_marked};
use std::sync::Arc;
use weald_contract::{Frame, Image, Problem, Written, table};

table! {
    /// The ground under a thing, seen from above.
    pub struct Footprint {
        /// Mesh, a `.glb` or `.obj` file, such as that of an `[[object]]`.
        model: Written<String>;
        /// Place of the mesh's origin, scene coordinates, m.
        at: [f64; 2], in -1000000.0..=1000000.0;
        /// Turn about the vertical, degrees clockwise from north.
        yaw_deg: f64 = 0.0, in -3600.0..=3600.0;
        /// Uniform scale.
        scale: f64 = 1.0, in 0.000001..=1000000.0;
    }
}

/// Most pixels of an outline with the ground around it that feathering needs.
const MAX_PIXELS: usize = 1 << 22;

/// A footprint in its place: how far each point lies from it.
#[derive(Clone, Debug)]
pub(crate) struct Outline {
    at: [f64; 2],
    cos: f64,
    sin: f64,
    scale: f64,
    /// Pixels in the mesh's metres, with room for feathering around.
    frame: Frame,
    /// Distance to the nearest covered pixel's edge, mesh metres.
    distance: Arc<Vec<f32>>,
}

impl Footprint {
    /// The footprint with room for a ramp of `feather` scene metres, from the mesh's outline: an
    /// image that is 1 where the mesh covers the ground.
    pub(crate) fn outline(&self, image: &Image, feather: f64) -> Result<Outline, Problem> {
        let problem = |message: &str| {
            Problem::at(self.model.span, format!("the model `{}` {message}", self.model.value))
        };
        let frame = image.frame.as_ref().ok_or_else(|| problem("has no outline"))?;
        let margin = (feather / self.scale / frame.cell).ceil() + 1.0;
        let side = |cells: usize| cells as f64 + 2.0 * margin;
        if side(frame.width) * side(frame.height) > MAX_PIXELS as f64 {
            return Err(problem("is small beside the ramp around it")
                .hint(format!("`feather` is {feather} m; take less, or a larger `scale`")));
        }
        let margin = margin as usize;
        let padded = Frame {
            width: frame.width + 2 * margin,
            height: frame.height + 2 * margin,
            cell: frame.cell,
            west: frame.west - margin as f64 * frame.cell,
            south: frame.south - margin as f64 * frame.cell,
        };
        let mut covered = vec![false; padded.len()];
        for (row, values) in image.values.chunks_exact(frame.width).enumerate() {
            for (column, value) in values.iter().enumerate() {
                covered[padded.index(column + margin, row + margin)] = *value > 0.5;
            }
        }
        let (sin, cos) = libm::sincos(self.yaw_deg.to_radians());
        let distance = Arc::new(distances(&padded, &covered));
        Ok(Outline { at: self.at, cos, sin, scale: self.scale, frame: padded, distance })
    }
}

/// Distance of each pixel's centre to the edge of the nearest covered one; 0 on it.
fn distances(frame: &Frame, covered: &[bool]) -> Vec<f32> {
    let nearest = nearest_marked(frame.width, frame.height, covered);
    let place = |index: usize| ((index % frame.width) as f64, (index / frame.width) as f64);
    let distance = |(index, nearest): (usize, &u32)| match *nearest {
        NONE => f32::INFINITY,
        nearest => {
            let ((x0, y0), (x1, y1)) = (place(index), place(nearest as usize));
            let apart = ((x1 - x0) * (x1 - x0) + (y1 - y0) * (y1 - y0)).sqrt();
            ((apart - 0.5).max(0.0) * frame.cell) as f32
        }
    };
    nearest.iter().enumerate().map(distance).collect()
}

impl Outline {
    /// Distance of a point from the footprint, scene coordinates, m; 0 on it.
    pub(crate) fn distance(&self, [x, y]: [f64; 2]) -> f64 {
        let (dx, dy) = ((x - self.at[0]) / self.scale, (y - self.at[1]) / self.scale);
        // Clockwise turns are undone counter-clockwise.
        let (x, y) = (dx * self.cos - dy * self.sin, dx * self.sin + dy * self.cos);
        if !self.frame.contains(x, y) {
            return f64::INFINITY;
        }
        f64::from(self.frame.sample(&self.distance, x, y)) * self.scale
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Span;

    /// A slab of 8 x 2 m that lies to the north-east of its origin.
    fn slab() -> Image {
        let frame = Frame { width: 80, height: 20, cell: 0.1, west: 0.0, south: 0.0 };
        let values = vec![1.0; frame.len()];
        Image { width: 80, height: 20, values, is_float: false, frame: Some(frame) }
    }

    fn footprint(yaw_deg: f64, scale: f64) -> Footprint {
        let model = Written { value: "slab.glb".into(), span: Span::default() };
        Footprint { model, at: [100.0, 50.0], yaw_deg, scale }
    }

    #[test]
    fn a_slab_lies_where_it_is_put_turned_and_stretched() {
        let outline = footprint(90.0, 2.0).outline(&slab(), 5.0).unwrap();
        // Turned clockwise, its length of 16 m runs south and its width of 4 m runs east.
        assert_eq!(outline.distance([102.0, 40.0]), 0.0);
        assert!((outline.distance([107.0, 40.0]) - 3.0).abs() < 0.1);
        assert!((outline.distance([97.0, 40.0]) - 3.0).abs() < 0.1);
        assert_eq!(outline.distance([102.0, 60.0]), f64::INFINITY);
    }

    #[test]
    fn a_ramp_far_wider_than_its_thing_is_refused() {
        let error = footprint(0.0, 1.0).outline(&slab(), 1e6).unwrap_err();
        assert!(error.to_string().contains("feather"), "{error}");
    }
}
