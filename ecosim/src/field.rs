//! Numbers at places: terrain layers, crown shadows, images and formulas over them.

use crate::Error;
use crate::density::Patch;
use crate::shadow::crown_shadow;
use crate::stand::Stand;
use rayon::prelude::*;
use weald_contract::formula::Variable;
use weald_contract::{Formula, Frame, Grid, Image, Layers, Problem, Span, Written};

/// Values evaluated together by a formula; its own block length.
const BLOCK: usize = 1024;

/// One terrain layer on the coarse grid and on the finer patches that have it.
///
/// Looks up names once, so that a sample costs an interpolation only.
#[derive(Clone, Debug)]
pub(crate) struct Field<'a> {
    whole: (Frame, &'a [f32]),
    detail: Vec<(Frame, &'a [f32])>,
}

impl<'a> Field<'a> {
    /// Returns the layer of this name, if the terrain has it.
    pub(crate) fn layer(terrain: &'a Layers, name: &str) -> Option<Self> {
        let on = |grid: &'a Layers| grid.values(name).map(|values| (grid.frame, values));
        let whole = on(terrain)?;
        Some(Self { whole, detail: terrain.detail.iter().filter_map(on).collect() })
    }

    /// Returns the bilinear value at map coordinates, from the finest grid there.
    pub(crate) fn at(&self, x: f64, y: f64) -> f32 {
        let (frame, values) = self.finest(x, y);
        frame.sample(values, x, y)
    }

    /// Returns the side of the cells of the finest grid at a place, m.
    pub(crate) fn cell(&self, x: f64, y: f64) -> f64 {
        self.finest(x, y).0.cell
    }

    fn finest(&self, x: f64, y: f64) -> &(Frame, &'a [f32]) {
        self.detail.iter().find(|(frame, _)| frame.contains(x, y)).unwrap_or(&self.whole)
    }
}

/// Where the numbers for one variable of a formula come from.
enum Origin<'a> {
    Layer(Field<'a>),
    Image(ImageField<'a>),
    Grid(Grid),
    X,
    Y,
}

/// A formula whose variables are bound to this terrain and the plants so far.
pub(crate) struct BoundFormula<'a> {
    formula: &'a Written<Formula>,
    origins: Vec<Origin<'a>>,
    /// South-west corner of the terrain, where scene coordinates begin.
    corner: [f64; 2],
}

impl<'a> BoundFormula<'a> {
    /// Binds a formula; crown shadows are those of `stand` as it is now.
    pub(crate) fn bind(
        formula: &'a Written<Formula>,
        terrain: &'a Layers,
        stand: &Stand<'a>,
    ) -> Result<Self, Error> {
        let reads = formula.value.variables().iter().zip(formula.value.spans());
        let origin = |(variable, range): (&Variable, &std::ops::Range<usize>)| match variable {
            Variable::Layer(name) => {
                let image = || stand.images.get(name.as_str()).copied().map(Origin::Image);
                let made = || stand.layers.get(name.as_str()).cloned().map(Origin::Grid);
                let layer = Field::layer(terrain, name).map(Origin::Layer);
                layer.or_else(image).or_else(made).ok_or_else(|| {
                    let span = formula.span.narrow(range.start + 1..range.end + 1);
                    Problem::at(span, format!("the terrain has no layer `{name}`"))
                })
            }
            Variable::CrownShadow(name) => Ok(Origin::Grid(crown_shadow(terrain, stand, name))),
            Variable::X => Ok(Origin::X),
            Variable::Y => Ok(Origin::Y),
        };
        let origins = reads.map(origin).collect::<Result<_, _>>()?;
        let corner = [terrain.frame.west, terrain.frame.south];
        Ok(Self { formula, origins, corner })
    }

    /// Returns where the formula was written.
    pub(crate) fn span(&self) -> Span {
        self.formula.span
    }

    /// Computes the formula at `count` places given in map coordinates by `place`.
    pub(crate) fn values(
        &self,
        count: usize,
        place: impl Fn(usize) -> [f64; 2] + Sync,
    ) -> Vec<f32> {
        let mut out = vec![0.0; count];
        out.par_chunks_mut(BLOCK).enumerate().for_each(|(block, out)| {
            let places: Vec<[f64; 2]> = (0..out.len()).map(|i| place(block * BLOCK + i)).collect();
            let inputs: Vec<Vec<f32>> =
                self.origins.iter().map(|origin| self.read(origin, &places)).collect();
            let inputs: Vec<&[f32]> = inputs.iter().map(Vec::as_slice).collect();
            self.formula.value.eval_block(&inputs, out);
        });
        out
    }

    /// Computes the formula at places, and complains where it is no number.
    pub(crate) fn numbers(
        &self,
        count: usize,
        place: impl Fn(usize) -> [f64; 2] + Sync,
    ) -> Result<Vec<f32>, Error> {
        let values = self.values(count, &place);
        match values.iter().position(|value| value.is_nan()) {
            None => Ok(values),
            Some(index) => {
                let [x, y] = place(index);
                let (x, y) = (x - self.corner[0], y - self.corner[1]);
                Err(Problem::at(
                    self.formula.span,
                    format!("the formula has no value at {x:.1}, {y:.1} (scene coordinates)"),
                )
                .hint("guard divisions, roots and logarithms with `max` or `if`")
                .into())
            }
        }
    }

    fn read(&self, origin: &Origin<'_>, places: &[[f64; 2]]) -> Vec<f32> {
        let value = |&[x, y]: &[f64; 2]| match origin {
            Origin::Layer(field) => field.at(x, y),
            Origin::Image(image) => image.nearest(x, y),
            Origin::Grid(grid) => grid.sample(x, y),
            Origin::X => (x - self.corner[0]) as f32,
            Origin::Y => (y - self.corner[1]) as f32,
        };
        places.iter().map(value).collect()
    }
}

/// A one-band image laid over the terrain.
#[derive(Clone, Copy, Debug)]
pub(crate) struct ImageField<'a> {
    image: &'a Image,
    /// Whether black means dense.
    invert: bool,
    west: f64,
    north: f64,
    pixel_x: f64,
    pixel_y: f64,
}

/// Largest relative difference between the aspects of an image and the terrain that is taken
/// for rounding: a painter who scales 400 m to 1,000 pixels may be off by a few pixels.
const ASPECT_TOLERANCE: f64 = 0.02;

impl<'a> ImageField<'a> {
    /// Lays an image over the terrain, by its own georeference or from rim to rim.
    pub(crate) fn new(
        path: &Written<String>,
        image: &'a Image,
        invert: bool,
        terrain: &Frame,
    ) -> Result<Self, Error> {
        check_image(path, image)?;
        if let Some(frame) = image.frame {
            check_overlap(path, &frame, terrain)?;
            let (west, north) = (frame.west, frame.north());
            return Ok(Self {
                image,
                invert,
                west,
                north,
                pixel_x: frame.cell,
                pixel_y: frame.cell,
            });
        }
        let (width, height) = (image.width as f64, image.height as f64);
        let (metres_x, metres_y) =
            (terrain.width as f64 * terrain.cell, terrain.height as f64 * terrain.cell);
        let distortion = (width / height) / (metres_x / metres_y);
        if !(1.0 - ASPECT_TOLERANCE..=1.0 + ASPECT_TOLERANCE).contains(&distortion) {
            let message = format!(
                "a density image of another size: {} x {} pixels over {metres_x} x {metres_y} m",
                image.width, image.height
            );
            let hint = format!(
                "paint on {} x {} pixels, one a cell, or any size of the same proportions; \
                 `weald canvas` makes one",
                terrain.width, terrain.height
            );
            return Err(Problem::at(path.span, message).hint(hint).into());
        }
        let (pixel_x, pixel_y) = (metres_x / width, metres_y / height);
        let (west, north) = (terrain.west, terrain.north());
        Ok(Self { image, invert, west, north, pixel_x, pixel_y })
    }

    /// Returns the mean value over a patch, each pixel weighted by the area that it shares with
    /// it, so that the sum over the cells of any raster is the sum over the image.
    ///
    /// What lies beyond the image counts as 0, also when inverted.
    pub(crate) fn mean(&self, patch: &Patch) -> f32 {
        let along = |edge: f64| (edge - self.west) / self.pixel_x;
        let down = |edge: f64| (self.north - edge) / self.pixel_y;
        let (left, right) = (along(patch.west), along(patch.east));
        let (top, bottom) = (down(patch.north), down(patch.south));
        let mut sum = 0.0;
        for row in touched(top, bottom, self.image.height) {
            let line = &self.image.values[row * self.image.width..][..self.image.width];
            let columns = touched(left, right, self.image.width);
            let shares = columns.map(|c| shared(left, right, c) * f64::from(self.value(line[c])));
            sum += shared(top, bottom, row) * shares.sum::<f64>();
        }
        let area = (right - left) * (bottom - top);
        if area > 0.0 { (sum / area) as f32 } else { 0.0 }
    }

    /// Returns the value of the pixel that holds a place; 0 outside the image.
    pub(crate) fn nearest(&self, x: f64, y: f64) -> f32 {
        let column = ((x - self.west) / self.pixel_x).floor();
        let row = ((self.north - y) / self.pixel_y).floor();
        let inside = column >= 0.0
            && row >= 0.0
            && column < self.image.width as f64
            && row < self.image.height as f64;
        let index = || row as usize * self.image.width + column as usize;
        if inside { self.value(self.image.values[index()]) } else { 0.0 }
    }

    /// Returns what a pixel stands for.
    fn value(&self, pixel: f32) -> f32 {
        if self.invert { (1.0 - pixel).max(0.0) } else { pixel }
    }

    /// Returns the greatest value.
    pub(crate) fn brightest(&self) -> f32 {
        self.image.values.iter().map(|&pixel| self.value(pixel)).fold(0.0, f32::max)
    }
}

/// Returns the pixels that `from..to` touches, all in pixels.
fn touched(from: f64, to: f64, size: usize) -> std::ops::Range<usize> {
    // Casts of negative numbers give 0.
    (from.floor() as usize).min(size)..(to.ceil() as usize).min(size)
}

/// Returns the length of the part of pixel `index` that lies in `from..to`.
fn shared(from: f64, to: f64, index: usize) -> f64 {
    let (start, end) = (index as f64, (index + 1) as f64);
    (to.min(end) - from.max(start)).max(0.0)
}

/// Complains of an image that covers nothing of the terrain.
fn check_overlap(path: &Written<String>, image: &Frame, terrain: &Frame) -> Result<(), Error> {
    let is_beside = image.west >= terrain.east()
        || image.east() <= terrain.west
        || image.south >= terrain.north()
        || image.north() <= terrain.south;
    if !is_beside {
        return Ok(());
    }
    let extent = |frame: &Frame| {
        format!("{} to {}, {} to {}", frame.west, frame.east(), frame.south, frame.north())
    };
    let message =
        format!("the image `{}` lies beside the terrain, at {}", path.value, extent(image));
    let hint = format!("the terrain's map coordinates run from {}", extent(terrain));
    Err(Problem::at(path.span, message).hint(hint).into())
}

fn check_image(path: &Written<String>, image: &Image) -> Result<(), Error> {
    let problem = |message: String| Err(Problem::at(path.span, message).into());
    if image.width == 0 || image.height == 0 || image.values.len() != image.width * image.height {
        return problem(format!("the image `{}` has no pixels", path.value));
    }
    let bad = image.values.iter().position(|value| !value.is_finite() || *value < 0.0);
    if let Some(index) = bad {
        let (column, row) = (index % image.width, index / image.width);
        let value = image.values[index];
        return problem(format!(
            "the density image `{}` holds {value} at column {column}, row {row}; \
             densities are numbers from 0",
            path.value
        ));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    const FRAME: Frame = Frame { width: 8, height: 4, cell: 1.0, west: 100.0, south: 50.0 };

    fn image(width: usize, height: usize) -> Image {
        let values = (0..width * height).map(|i| i as f32).collect();
        Image { width, height, values, is_float: false, frame: None }
    }

    fn path() -> Written<String> {
        Written { value: "density.png".into(), ..Written::default() }
    }

    #[test]
    fn an_image_without_a_map_covers_the_terrain_from_rim_to_rim() {
        let image = image(4, 2);
        let field = ImageField::new(&path(), &image, false, &FRAME).unwrap();
        // Pixels are 2 m wide; row 0 is the north.
        assert_eq!(field.nearest(101.0, 53.0), 0.0);
        assert_eq!(field.nearest(107.9, 50.1), 7.0);
        let patch = |west, east, south, north| Patch { west, east, south, north };
        assert_eq!(field.mean(&patch(100.0, 108.0, 50.0, 54.0)), 3.5);
        // A quarter of pixel 5 and three quarters of pixel 6, in the south row.
        assert_eq!(field.mean(&patch(103.5, 105.5, 50.5, 51.5)), 5.75);
        // Half beyond the paper.
        assert_eq!(field.mean(&patch(107.0, 109.0, 50.0, 51.0)), 3.5);
    }

    #[test]
    fn an_image_of_another_aspect_is_refused_with_the_size_of_the_terrain() {
        let image = image(4, 4);
        let error = ImageField::new(&path(), &image, false, &FRAME).unwrap_err().to_string();
        assert!(error.contains("another size") && error.contains("8 x 4 pixels"), "{error}");
    }

    #[test]
    fn an_image_with_nan_is_refused_at_its_pixel() {
        let mut image = image(4, 2);
        image.values[6] = f32::NAN;
        let error = ImageField::new(&path(), &image, false, &FRAME).unwrap_err().to_string();
        assert!(error.contains("column 2, row 1"), "{error}");
    }
}
