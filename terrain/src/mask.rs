//! Masks: where an operator acts, from 0 (not at all) to 1 (in full).
//!
//! Conditions of one mask multiply, and so do the masks of a list unless one says otherwise. Bands of slope and altitude are
//! soft over `falloff` in their own unit, shapes over `feather` metres, both outwards, along the
//! same spline.

use crate::area;
use crate::derive;
use crate::flow;
use crate::footprint::{Footprint, Outline};
use crate::lattice::Lattice;
use crate::noise::{Fractal, NoiseKind, NoiseShape};
use crate::spline::{Polyline, influence, smoothstep};
use std::collections::BTreeMap;
use weald_contract::formula::Variable;
use weald_contract::table::{Json, Kind, Value};
use weald_contract::{
    Formula, Frame, FromToml, Image, Layers, Problem, Problems, Seed, Span, Written, table, words,
};

table! {
    /// Conditions on a place; those that are given multiply.
    pub struct Mask {
        /// Slope from … to …, degrees.
        slope_deg: Option<Written<[f64; 2]>> = None, in 0.0..=90.0;
        /// Altitude from … to …, m.
        altitude: Option<Written<[f64; 2]>> = None, in -100000.0..=100000.0;
        /// Aspect from … clockwise to …, degrees; [315, 45] is the north. Level ground has none.
        aspect_deg: Option<Written<[f64; 2]>> = None, in 0.0..=360.0;
        /// Curvature across the slope from … to …, 1/m; ridges are positive.
        curvature_plan: Option<Written<[f64; 2]>> = None, in -1000.0..=1000.0;
        /// Curvature along the slope from … to …, 1/m; positive where it steepens downwards.
        curvature_profile: Option<Written<[f64; 2]>> = None, in -1000.0..=1000.0;
        /// Area that drains through the place, from … to …, m2.
        upslope_area: Option<Written<[f64; 2]>> = None, in 0.0..=1e15;
        /// Topographic wetness index from … to ….
        wetness: Option<Written<[f64; 2]>> = None, in -100.0..=100.0;
        /// Width of the ramp at the ends of a band, in its unit.
        falloff: f64 = 0.0, in 0.0..=100000.0;
        /// A disc.
        disc: Option<Disc> = None;
        /// A rectangle: west, south, east, north, scene coordinates, m.
        rectangle: Option<Written<[f64; 4]>> = None, in -1000000.0..=1000000.0;
        /// A polygon: its corners, scene coordinates, m.
        polygon: Option<Written<Vec<[f64; 2]>>> = None, in -1000000.0..=1000000.0;
        /// The neighbourhood of a line.
        line: Option<Line> = None;
        /// The ground under a thing.
        footprint: Option<Footprint> = None;
        /// Patches of noise.
        noise: Option<NoiseMask> = None;
        /// An image over the whole terrain; white is 1.
        image: Option<Written<String>> = None;
        /// A formula over `altitude` (m), `slope` and `aspect` (degrees), `curvature_plan` and
        /// `curvature_profile` (1/m), `upslope_area` (m2), `wetness`, `x` and `y` (m).
        formula: Option<Written<Formula>> = None;
        /// Width of the ramp around shapes, m.
        feather: f64 = 0.0, in 0.0..=100000.0;
        /// Whether the mask is 1 where it would be 0.
        invert: bool = false;
        /// How it joins the masks before it in a list.
        combine: Combine = Combine::Multiply;
    }
}

words! {
    /// How a mask joins those before it; results are held between 0 and 1.
    pub enum Combine {
        /// Both.
        Multiply = "multiply",
        /// The sum.
        Add = "add",
        /// What was there less this.
        Subtract = "subtract",
        /// The lesser.
        Min = "min",
        /// The greater: either.
        Max = "max",
        /// The mean.
        Mean = "mean",
    }
}

impl Combine {
    fn join(self, before: f32, value: f32) -> f32 {
        let joined = match self {
            Self::Multiply => before * value,
            Self::Add => before + value,
            Self::Subtract => before - value,
            Self::Min => before.min(value),
            Self::Max => before.max(value),
            Self::Mean => 0.5 * (before + value),
        };
        joined.clamp(0.0, 1.0)
    }
}

table! {
    /// A disc.
    pub struct Disc {
        /// Centre, scene coordinates, m.
        at: [f64; 2], in -1000000.0..=1000000.0;
        /// Radius, m.
        radius: f64, in 0.0..=1000000.0;
    }
}

table! {
    /// Places near a line.
    pub struct Line {
        /// Points of the line, scene coordinates, m.
        points: Written<Vec<[f64; 2]>>, in -1000000.0..=1000000.0;
        /// Width of the strip along it, m.
        width: f64, in 0.0..=1000000.0;
    }
}

table! {
    /// Patches: 0 where noise is below a range, 1 above it.
    pub struct NoiseMask {
        /// Wavelength of the largest patches, m.
        wavelength: f64, in 0.001..=10000000.0;
        /// Range of noise values over which the mask rises; noise lies in -1 to 1, mostly within a half.
        range: Written<[f64; 2]> = Written { value: [-0.1, 0.1], span: Span::default() }, in -1.0..=1.0;
        /// Number of octaves.
        octaves: u32 = 4, in 1.0..=24.0;
        /// Which of many such noises.
        seed: u32 = 0;
    }
}

/// The masks of an operator, written as one table or a list of them; all multiply.
#[derive(Clone, Debug, Default, PartialEq, serde::Serialize)]
#[serde(transparent)]
pub struct Masks(pub Vec<Mask>);

impl FromToml for Masks {
    fn from_toml(value: &Value, problems: &mut Problems) -> Option<Self> {
        match value.kind {
            Kind::Array(_) => Vec::from_toml(value, problems).map(Self),
            _ => Mask::from_toml(value, problems).map(|mask| Self(vec![mask])),
        }
    }

    fn schema() -> Json {
        let list = [Mask::schema(), Vec::<Mask>::schema()];
        Json::Object([("oneOf".to_string(), Json::Array(list.into()))].into_iter().collect())
    }
}

impl Masks {
    /// Notes what is wrong with the masks' own numbers.
    pub(crate) fn check(&self, problems: &mut Problems) {
        self.0.iter().for_each(|mask| mask.check(problems));
    }

    /// Whether a value depends on neighbouring altitudes, and so on the grid's fineness.
    pub(crate) fn reads_slope(&self) -> bool {
        self.0.iter().any(Mask::reads_slope)
    }

    /// Whether a value depends on the whole ground above it.
    pub(crate) fn reads_flow(&self) -> bool {
        self.0.iter().any(Mask::reads_flow)
    }

    /// Makes the masks ready for grids with cells of `cell` metres.
    pub(crate) fn prepare<'a>(&self, map: &Map<'a>, cell: f64) -> Result<Vec<Ready<'a>>, Problem> {
        self.0.iter().map(|mask| mask.prepare(map, cell)).collect()
    }
}

impl Mask {
    fn check(&self, problems: &mut Problems) {
        let bands = [
            ("slope_deg", &self.slope_deg),
            ("altitude", &self.altitude),
            ("curvature_plan", &self.curvature_plan),
            ("curvature_profile", &self.curvature_profile),
            ("upslope_area", &self.upslope_area),
            ("wetness", &self.wetness),
        ];
        for (name, band) in bands {
            if let Some(band) = band.as_ref().filter(|band| band.value[0] > band.value[1]) {
                let message =
                    format!("`{name}` runs from {} down to {}", band.value[0], band.value[1]);
                problems.push(Problem::at(band.span, message).hint("write the lower end first"));
            }
        }
        if let Some(rectangle) = &self.rectangle {
            let [west, south, east, north] = rectangle.value;
            if west >= east || south >= north {
                let problem = Problem::at(rectangle.span, "this rectangle has no inside");
                problems.push(problem.hint("write [west, south, east, north]"));
            }
        }
        if let Some(polygon) = &self.polygon {
            check_polygon(polygon, problems);
        }
        if let Some(line) = &self.line {
            check_line(&line.points, problems);
        }
        if let Some(noise) = &self.noise
            && noise.range.value[0] >= noise.range.value[1]
        {
            let problem = Problem::at(noise.range.span, "`range` must rise");
            problems.push(problem.hint("for instance [-0.1, 0.1]"));
        }
        self.check_formula(problems);
    }

    fn check_formula(&self, problems: &mut Problems) {
        let Some(formula) = &self.formula else { return };
        for (variable, span) in formula.value.variables().iter().zip(formula.value.spans()) {
            if FormulaInput::of(variable).is_none() {
                // Past the opening quote.
                let span = formula.span.narrow(span.start + 1..span.end + 1);
                problems.push(Problem::at(span, "a mask does not know this name").hint(
                    "known here: altitude, slope, aspect, curvature_plan, \
                               curvature_profile, upslope_area, wetness, x, y",
                ));
            }
        }
    }

    fn formula_inputs(&self) -> impl Iterator<Item = FormulaInput> {
        let variables = self.formula.iter().flat_map(|formula| formula.value.variables());
        variables.filter_map(FormulaInput::of)
    }

    fn reads_slope(&self) -> bool {
        use FormulaInput::{Altitude, X, Y};
        self.slope_deg.is_some()
            || self.aspect_deg.is_some()
            || self.curvature_plan.is_some()
            || self.curvature_profile.is_some()
            || self.reads_flow()
            || self.formula_inputs().any(|input| !matches!(input, Altitude | X | Y))
    }

    fn reads_flow(&self) -> bool {
        use FormulaInput::{UpslopeArea, Wetness};
        self.upslope_area.is_some()
            || self.wetness.is_some()
            || self.formula_inputs().any(|input| matches!(input, UpslopeArea | Wetness))
    }

    fn prepare<'a>(&self, map: &Map<'a>, cell: f64) -> Result<Ready<'a>, Problem> {
        let (falloff, feather) = (self.falloff, self.feather);
        let mut conditions = Vec::new();
        let aspect = self.aspect_deg.as_ref();
        conditions.extend(aspect.map(|w| Condition::Aspect { arc: w.value, falloff }));
        let bands = [
            (&self.curvature_plan, FormulaInput::CurvaturePlan),
            (&self.curvature_profile, FormulaInput::CurvatureProfile),
            (&self.upslope_area, FormulaInput::UpslopeArea),
            (&self.wetness, FormulaInput::Wetness),
        ];
        for (band, input) in bands {
            let band = band.as_ref();
            conditions.extend(band.map(|w| Condition::Band { input, band: w.value, falloff }));
        }
        conditions
            .extend(self.slope_deg.as_ref().map(|w| Condition::Slope { band: w.value, falloff }));
        conditions
            .extend(self.altitude.as_ref().map(|w| Condition::Altitude { band: w.value, falloff }));
        conditions.extend(self.disc.clone().map(|disc| Condition::Disc { disc, feather }));
        conditions.extend(
            self.rectangle.as_ref().map(|w| Condition::Rectangle { sides: w.value, feather }),
        );
        conditions.extend(
            self.polygon.as_ref().map(|polygon| Condition::Polygon {
                ring: Polyline::closed(&polygon.value),
                feather,
            }),
        );
        conditions.extend(self.line.as_ref().map(|line| Condition::Line {
            line: Polyline::new(&line.points.value),
            half_width: 0.5 * line.width,
            feather,
        }));
        if let Some(footprint) = &self.footprint {
            let outline = footprint.outline(map.opened(&footprint.model)?, feather)?;
            conditions.push(Condition::Footprint { outline, feather });
        }
        conditions.extend(
            self.noise.as_ref().map(|mask| Condition::Noise {
                noise: mask.fractal(cell),
                range: mask.range.value,
            }),
        );
        if let Some(path) = &self.image {
            let (image, frame) = map.image(path)?;
            conditions.push(Condition::Image { values: &image.values, frame });
        }
        if let Some(formula) = &self.formula {
            let inputs = formula.value.variables().iter().filter_map(FormulaInput::of).collect();
            conditions.push(Condition::Formula { formula: formula.value.clone(), inputs });
        }
        Ok(Ready { conditions, invert: self.invert, combine: self.combine })
    }
}

impl NoiseMask {
    fn fractal(&self, cell: f64) -> Fractal {
        let shape = NoiseShape {
            kind: NoiseKind::Fbm,
            wavelength: self.wavelength,
            octaves: self.octaves,
            roughness: 0.5,
            roughness_change: 0.0,
            lacunarity: 2.0,
            warp: 0.0,
        };
        // A mask's noise is named by its own `seed`, so that two operators can share a mask.
        let seed = Seed(0).stream("noise mask", u64::from(self.seed)).next_u64() as u32;
        Fractal::new(shape, seed, cell)
    }
}

/// Notes a line that has fewer than two different points.
pub(crate) fn check_line(points: &Written<Vec<[f64; 2]>>, problems: &mut Problems) {
    if points.value.iter().all(|point| Some(point) == points.value.first()) {
        problems.push(Problem::at(points.span, "a line needs at least 2 different points"));
    }
}

/// Notes a polygon without an inside, or one that crosses itself.
fn check_polygon(polygon: &Written<Vec<[f64; 2]>>, problems: &mut Problems) {
    if polygon.value.len() < 3 {
        problems.push(Problem::at(polygon.span, "a polygon needs at least 3 corners"));
    } else if let Some(crossing) = Polyline::closed(&polygon.value).crossing() {
        let [x, y] = crossing;
        let problem =
            Problem::at(polygon.span, format!("this polygon crosses itself at ({x:.2}, {y:.2})"));
        problems.push(problem.hint("list its corners in order along its outline"));
    }
}

/// What masks read besides altitude: the map's place and the opened images.
pub(crate) struct Map<'a> {
    /// The terrain's frame, map coordinates.
    pub frame: Frame,
    /// Images by path as written.
    pub images: &'a BTreeMap<String, Image>,
}

/// How far the shape of an image may differ from the terrain's: more would stretch what was
/// painted by a visible amount.
const ASPECT_TOLERANCE: f64 = 0.02;

impl<'a> Map<'a> {
    /// An image that is not empty.
    fn opened(&self, path: &Written<String>) -> Result<&'a Image, Problem> {
        let missing =
            || Problem::at(path.span, format!("the image `{}` was not opened", path.value));
        let image = self.images.get(&path.value).ok_or_else(missing)?;
        if image.width == 0 || image.height == 0 || image.values.len() != image.width * image.height
        {
            return Err(Problem::at(path.span, format!("the image `{}` is empty", path.value)));
        }
        Ok(image)
    }

    /// An image and where its pixels lie in scene coordinates.
    ///
    /// One that the map knows keeps its place; another covers the terrain. Then pixels need not be
    /// quite square, which the frame cannot say: heights are stretched to fit.
    pub(crate) fn image(&self, path: &Written<String>) -> Result<(&'a Image, ImageFrame), Problem> {
        let image = self.opened(path)?;
        let pixels =
            Frame { width: image.width, height: image.height, cell: 1.0, west: 0.0, south: 0.0 };
        if let Some(frame) = &image.frame {
            let offset = [self.frame.west - frame.west, self.frame.south - frame.south];
            let scale = [1.0 / frame.cell; 2];
            return Ok((image, ImageFrame { pixels, offset, scale }));
        }
        let terrain = self.frame.width as f64 / self.frame.height as f64;
        let shape = image.width as f64 / image.height as f64;
        if (shape / terrain - 1.0).abs() > ASPECT_TOLERANCE {
            let message = format!(
                "the image is {} × {} pixels, the terrain {} × {} cells: the shapes differ",
                image.width, image.height, self.frame.width, self.frame.height
            );
            return Err(Problem::at(path.span, message)
                .hint(format!("width / height must be {terrain:.3}")));
        }
        let scale = [
            image.width as f64 / (self.frame.width as f64 * self.frame.cell),
            image.height as f64 / (self.frame.height as f64 * self.frame.cell),
        ];
        Ok((image, ImageFrame { pixels, offset: [0.0; 2], scale }))
    }
}

/// Where an image lies: pixel coordinates are `(scene + offset) * scale`.
#[derive(Clone, Debug)]
pub(crate) struct ImageFrame {
    pixels: Frame,
    offset: [f64; 2],
    scale: [f64; 2],
}

impl ImageFrame {
    /// Value at a point in scene coordinates; `None` beyond an image that lies elsewhere on the
    /// map, where nothing was painted.
    pub(crate) fn sample(&self, pixels: &[f32], x: f64, y: f64) -> Option<f32> {
        let x = (x + self.offset[0]) * self.scale[0];
        let y = (y + self.offset[1]) * self.scale[1];
        self.pixels.contains(x, y).then(|| self.pixels.sample(pixels, x, y))
    }
}

/// A mask ready to be evaluated.
#[derive(Clone, Debug)]
pub(crate) struct Ready<'a> {
    conditions: Vec<Condition<'a>>,
    invert: bool,
    combine: Combine,
}

#[derive(Clone, Debug)]
enum Condition<'a> {
    Slope { band: [f64; 2], falloff: f64 },
    Altitude { band: [f64; 2], falloff: f64 },
    Aspect { arc: [f64; 2], falloff: f64 },
    Band { input: FormulaInput, band: [f64; 2], falloff: f64 },
    Disc { disc: Disc, feather: f64 },
    Rectangle { sides: [f64; 4], feather: f64 },
    Polygon { ring: Polyline, feather: f64 },
    Line { line: Polyline, half_width: f64, feather: f64 },
    Footprint { outline: Outline, feather: f64 },
    Noise { noise: Fractal, range: [f64; 2] },
    Image { values: &'a [f32], frame: ImageFrame },
    Formula { formula: Formula, inputs: Vec<FormulaInput> },
}

/// What a formula in a mask may read.
#[derive(Clone, Copy, Debug, PartialEq)]
enum FormulaInput {
    Altitude,
    Slope,
    Aspect,
    CurvaturePlan,
    CurvatureProfile,
    UpslopeArea,
    Wetness,
    X,
    Y,
}

impl FormulaInput {
    fn of(variable: &Variable) -> Option<Self> {
        match variable {
            Variable::Layer(name) if name == "altitude" => Some(Self::Altitude),
            Variable::Layer(name) if name == "slope" => Some(Self::Slope),
            Variable::Layer(name) if name == "aspect" => Some(Self::Aspect),
            Variable::Layer(name) if name == "curvature_plan" => Some(Self::CurvaturePlan),
            Variable::Layer(name) if name == "curvature_profile" => Some(Self::CurvatureProfile),
            Variable::Layer(name) if name == "upslope_area" => Some(Self::UpslopeArea),
            Variable::Layer(name) if name == "wetness" => Some(Self::Wetness),
            Variable::X => Some(Self::X),
            Variable::Y => Some(Self::Y),
            _ => None,
        }
    }
}

/// One row of cells with the altitudes of the whole field around it.
#[derive(Clone, Copy)]
pub(crate) struct Row<'a> {
    /// The field's cells.
    pub lattice: &'a Lattice,
    /// Altitudes of the whole field, m.
    pub altitude: &'a [f32],
    /// Which row, from the north.
    pub row: usize,
    /// What only the whole ground can tell, where a mask asks for it.
    pub whole: Option<&'a Whole>,
}

/// Fields that follow from the whole ground.
#[derive(Clone, Debug)]
pub(crate) struct Whole {
    /// Area that drains through each cell by steepest descent, m².
    upslope_area: Vec<f32>,
    /// Topographic wetness index over that area.
    wetness: Vec<f32>,
}

impl Whole {
    /// The fields, if a mask asks for them.
    pub fn of(masks: &Masks, lattice: &Lattice, altitude: &[f32]) -> Option<Self> {
        if !masks.reads_flow() {
            return None;
        }
        let Lattice { width, height, cell, .. } = *lattice;
        let flood = flow::fill(width, height, altitude);
        let cells = area::drained_cells(width, &flow::directions(width, height, &flood));
        let area = |index: usize| f64::from(cells[index]) * cell * cell;
        let wetness = derive::from_gradient(width, height, cell, altitude, |index, gradient| {
            derive::wetness(area(index), cell, gradient.tangent())
        });
        Some(Self { upslope_area: (0..cells.len()).map(|i| area(i) as f32).collect(), wetness })
    }

    /// The fields as finished layers have them, if a mask asks for them.
    pub fn of_layers(masks: &Masks, layers: &Layers) -> Option<Self> {
        if !masks.reads_flow() {
            return None;
        }
        let values = |name: &str| layers.values(name).map(<[f32]>::to_vec);
        Some(Self { upslope_area: values("upslope_area")?, wetness: values("wetness")? })
    }
}

impl Row<'_> {
    /// Altitudes of this row.
    pub fn altitudes(&self) -> &[f32] {
        &self.altitude[self.row * self.lattice.width..][..self.lattice.width]
    }

    fn slope_deg(&self, column: usize) -> f32 {
        self.gradient(column).slope_deg()
    }

    fn gradient(&self, column: usize) -> derive::Gradient {
        let Lattice { width, height, cell, .. } = *self.lattice;
        derive::gradient(width, height, cell, self.altitude, column, self.row)
    }
}

impl Row<'_> {
    fn value(&self, input: FormulaInput, column: usize) -> f32 {
        let Lattice { width, height, cell, .. } = *self.lattice;
        let curvature = || derive::curvature(width, height, cell, self.altitude, column, self.row);
        let index = self.row * width + column;
        match input {
            FormulaInput::Altitude => self.altitude[index],
            FormulaInput::Slope => self.slope_deg(column),
            FormulaInput::Aspect => self.gradient(column).aspect_deg(),
            FormulaInput::CurvaturePlan => curvature().plan as f32,
            FormulaInput::CurvatureProfile => curvature().profile as f32,
            FormulaInput::UpslopeArea => self.whole.map_or(0.0, |whole| whole.upslope_area[index]),
            FormulaInput::Wetness => self.whole.map_or(0.0, |whole| whole.wetness[index]),
            FormulaInput::X => self.lattice.x(column) as f32,
            FormulaInput::Y => self.lattice.y(self.row) as f32,
        }
    }
}

/// Multiplies `weights` by the masks' values along a row.
pub(crate) fn apply(masks: &[Ready<'_>], row: &Row<'_>, weights: &mut [f32]) {
    let values_of = |mask: &Ready<'_>| {
        let mut values = vec![1.0; weights.len()];
        mask.conditions.iter().for_each(|condition| condition.apply(row, &mut values));
        if mask.invert {
            values.iter_mut().for_each(|value| *value = 1.0 - *value);
        }
        values
    };
    // The first mask of a list has none before it to join, but may be taken from full cover.
    let mut joined = vec![1.0f32; weights.len()];
    for (index, mask) in masks.iter().enumerate() {
        let combine = match mask.combine {
            Combine::Subtract => Combine::Subtract,
            _ if index == 0 => Combine::Multiply,
            other => other,
        };
        for (joined, value) in joined.iter_mut().zip(values_of(mask)) {
            *joined = combine.join(*joined, value);
        }
    }
    weights.iter_mut().zip(joined).for_each(|(weight, mask)| *weight *= mask);
}

/// 1 on an arc of the compass, falling to 0 over `falloff` degrees beyond its ends.
fn on_arc(aspect: f64, [from, to]: [f64; 2], falloff: f64) -> f64 {
    let width = if to >= from { to - from } else { to - from + 360.0 };
    let turned = |angle: f64| (angle + 720.0) % 360.0;
    let past = turned(aspect - from);
    let beyond = if past <= width { 0.0 } else { (past - width).min(360.0 - past) };
    influence(beyond, 0.0, falloff)
}

/// 1 within a band, falling to 0 over `falloff` beyond its ends.
fn in_band(value: f64, [low, high]: [f64; 2], falloff: f64) -> f64 {
    influence((low - value).max(value - high), 0.0, falloff)
}

/// Distance from a point to a rectangle; 0 inside.
fn outside_rectangle([west, south, east, north]: [f64; 4], [x, y]: [f64; 2]) -> f64 {
    let dx = (west - x).max(x - east).max(0.0);
    let dy = (south - y).max(y - north).max(0.0);
    (dx * dx + dy * dy).sqrt()
}

impl Condition<'_> {
    fn apply(&self, row: &Row<'_>, values: &mut [f32]) {
        let y = row.lattice.y(row.row);
        match self {
            Self::Slope { band, falloff } => {
                weigh(values, |column| in_band(f64::from(row.slope_deg(column)), *band, *falloff))
            }
            Self::Altitude { band, falloff } => {
                let altitudes = row.altitudes();
                weigh(values, |column| in_band(f64::from(altitudes[column]), *band, *falloff));
            }
            Self::Aspect { arc, falloff } => weigh(values, |column| {
                let gradient = row.gradient(column);
                let is_level = gradient.tangent() == 0.0;
                if is_level {
                    0.0
                } else {
                    on_arc(f64::from(gradient.aspect_deg()), *arc, *falloff)
                }
            }),
            Self::Band { input, band, falloff } => weigh(values, |column| {
                in_band(f64::from(row.value(*input, column)), *band, *falloff)
            }),
            Self::Disc { disc, feather } => weigh(values, |column| {
                let (dx, dy) = (row.lattice.x(column) - disc.at[0], y - disc.at[1]);
                influence((dx * dx + dy * dy).sqrt(), disc.radius, *feather)
            }),
            Self::Rectangle { sides, feather } => weigh(values, |column| {
                influence(outside_rectangle(*sides, [row.lattice.x(column), y]), 0.0, *feather)
            }),
            Self::Polygon { ring, feather } => {
                let segments = ring.segments_near_row(y, *feather);
                weigh(values, |column| {
                    let point = [row.lattice.x(column), y];
                    if ring.encloses(point) {
                        return 1.0;
                    }
                    let near = ring.nearest(&segments, point);
                    near.map_or(0.0, |near| influence(near.distance, 0.0, *feather))
                });
            }
            Self::Line { line, half_width, feather } => {
                let segments = line.segments_near_row(y, half_width + feather);
                weigh(values, |column| {
                    let near = line.nearest(&segments, [row.lattice.x(column), y]);
                    near.map_or(0.0, |near| influence(near.distance, *half_width, *feather))
                });
            }
            Self::Footprint { outline, feather } => weigh(values, |column| {
                influence(outline.distance([row.lattice.x(column), y]), 0.0, *feather)
            }),
            Self::Noise { noise, range } => weigh(values, |column| {
                smoothstep(range[0], range[1], noise.at(row.lattice.x(column), y))
            }),
            Self::Image { values: pixels, frame } => weigh(values, |column| {
                let value = frame.sample(pixels, row.lattice.x(column), y).unwrap_or(0.0);
                if value.is_finite() { f64::from(value.clamp(0.0, 1.0)) } else { 0.0 }
            }),
            Self::Formula { formula, inputs } => apply_formula(formula, inputs, row, values),
        }
    }
}

/// Multiplies each value that is not yet 0.
fn weigh(values: &mut [f32], factor: impl Fn(usize) -> f64) {
    for (column, value) in values.iter_mut().enumerate().filter(|(_, value)| **value != 0.0) {
        *value *= factor(column) as f32;
    }
}

fn apply_formula(formula: &Formula, inputs: &[FormulaInput], row: &Row<'_>, values: &mut [f32]) {
    let width = row.lattice.width;
    let along = |input: &FormulaInput| (0..width).map(|column| row.value(*input, column)).collect();
    let columns: Vec<Vec<f32>> = inputs.iter().map(along).collect();
    let columns: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
    let mut results = vec![0.0; width];
    formula.eval_block(&columns, &mut results);
    for (value, result) in values.iter_mut().zip(results) {
        *value *= if result.is_nan() { 0.0 } else { result.clamp(0.0, 1.0) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const LATTICE: Lattice = Lattice { cell: 1.0, west: 0, south: 0, width: 20, height: 10 };

    /// A mask's values on ground that rises 0.5 m a metre to the east, by cell.
    fn values(text: &str) -> Vec<f32> {
        values_of(&[text])
    }

    /// The same for a list of masks.
    fn values_of(texts: &[&str]) -> Vec<f32> {
        let mut problems = Vec::new();
        let read = |text: &&str| Mask::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
        let masks: Option<Vec<Mask>> = texts.iter().map(read).collect();
        assert_eq!(problems, []);
        let masks = Masks(masks.unwrap());
        let images = BTreeMap::new();
        let map = Map { frame: LATTICE.frame((0.0, 0.0)), images: &images };
        let ready = masks.prepare(&map, LATTICE.cell).unwrap();
        let altitude: Vec<f32> =
            (0..LATTICE.len()).map(|i| 0.5 * LATTICE.x(i % LATTICE.width) as f32).collect();
        let whole = Whole::of(&masks, &LATTICE, &altitude);
        let row = |row| {
            let mut weights = vec![1.0; LATTICE.width];
            let whole = whole.as_ref();
            apply(
                &ready,
                &Row { lattice: &LATTICE, altitude: &altitude, row, whole },
                &mut weights,
            );
            weights
        };
        (0..LATTICE.height).flat_map(row).collect()
    }

    #[test]
    fn masks_of_aspect_curvature_flow_and_wetness_know_their_ground() {
        // The ground rises to the east, so it falls to the west: 270 degrees.
        assert!(values("aspect_deg = [225, 315]").iter().all(|v| *v == 1.0));
        assert!(values("aspect_deg = [315, 45]").iter().all(|v| *v == 0.0));
        assert_eq!(on_arc(350.0, [315.0, 45.0], 0.0), 1.0);
        assert_eq!(on_arc(55.0, [315.0, 45.0], 20.0), 0.5);
        assert_eq!(on_arc(305.0, [315.0, 45.0], 20.0), 0.5);
        assert!(values("curvature_plan = [-0.001, 0.001]").iter().all(|v| *v == 1.0));
        assert!(values("curvature_profile = [0.01, 1]").iter().all(|v| *v == 0.0));
        // Column x drains the 20 - x cells of 1 m² east of it and itself.
        let flow = values("upslope_area = [16, 100]");
        assert_eq!([3.5, 5.5].map(|x| at(&flow, x, 5.0)), [1.0, 0.0]);
        // ln(a / tan b) = ln(17 / 0.5) = 3.53 at x = 3.5.
        let wet = values("wetness = [3.5, 9]");
        assert_eq!([3.5, 4.5].map(|x| at(&wet, x, 5.0)), [1.0, 0.0]);
        let formula = values("formula = \"upslope_area / 20\"");
        assert_eq!([0.5, 19.5].map(|x| at(&formula, x, 5.0)), [1.0, 0.05]);
    }

    #[test]
    fn masks_of_a_list_combine_as_each_of_them_says() {
        let west = "rectangle = [0, 0, 12, 10]";
        let joined = |combine: &str| {
            let east = format!("rectangle = [8, 0, 20, 10]\ncombine = \"{combine}\"");
            let all = values_of(&[west, &east]);
            [4.5, 10.5, 16.5].map(|x| at(&all, x, 5.0))
        };
        assert_eq!(joined("multiply"), [0.0, 1.0, 0.0]);
        assert_eq!(joined("max"), [1.0, 1.0, 1.0]);
        assert_eq!(joined("add"), [1.0, 1.0, 1.0]);
        assert_eq!(joined("subtract"), [1.0, 0.0, 0.0]);
        assert_eq!(joined("min"), [0.0, 1.0, 0.0]);
        assert_eq!(joined("mean"), [0.5, 1.0, 0.5]);
    }

    /// Value at a point in scene coordinates.
    fn at(values: &[f32], x: f64, y: f64) -> f32 {
        let frame = LATTICE.frame((0.0, 0.0));
        let (column, row) = frame.cell_at(x, y).unwrap();
        values[frame.index(column, row)]
    }

    #[test]
    fn bands_are_one_inside_and_half_in_the_middle_of_their_ramp() {
        // atan(0.5) = 26.565 degrees everywhere.
        assert!(values("slope_deg = [20, 30]").iter().all(|v| *v == 1.0));
        assert!(values("slope_deg = [30, 40]").iter().all(|v| *v == 0.0));
        let ramp = values("slope_deg = [28.565051, 40]\nfalloff = 4");
        assert!(ramp.iter().all(|v| (v - 0.5).abs() < 1e-5));
        let altitude = values("altitude = [4, 100]\nfalloff = 2");
        assert_eq!(
            [7.5, 5.5, 3.5].map(|x| at(&altitude, x, 5.0)),
            [0.957_031_25, 0.316_406_25, 0.0]
        );
    }

    #[test]
    fn shapes_cover_their_inside_and_feather_outwards() {
        let disc = values("disc = { at = [10, 5], radius = 2 }\nfeather = 4");
        assert_eq!(at(&disc, 10.5, 5.5), 1.0);
        assert!((0.0..1.0).contains(&at(&disc, 13.5, 5.5)) && at(&disc, 17.5, 5.5) == 0.0);
        let rectangle = values("rectangle = [2, 3, 8, 6]");
        let inside = |x: f64, y: f64| f32::from(x > 2.0 && x < 8.0 && y > 3.0 && y < 6.0);
        let polygon = values("polygon = [[2, 3], [8, 3], [8, 6], [2, 6]]");
        for (x, y) in (0..20).flat_map(|x| (0..10).map(move |y| (x as f64 + 0.5, y as f64 + 0.5))) {
            assert_eq!(at(&rectangle, x, y), inside(x, y));
            assert_eq!(at(&polygon, x, y), inside(x, y));
        }
        let line = values("line = { points = [[0, 5], [20, 5]], width = 2 }");
        assert_eq!([5.5, 6.5].map(|y| at(&line, 9.0, y)), [1.0, 0.0]);
    }

    #[test]
    fn conditions_multiply_and_the_whole_may_be_inverted() {
        let both = values("rectangle = [0, 0, 10, 10]\naltitude = [2, 100]");
        assert_eq!([1.5, 6.5, 12.5].map(|x| at(&both, x, 5.0)), [0.0, 1.0, 0.0]);
        let inverted = values("rectangle = [0, 0, 10, 10]\naltitude = [2, 100]\ninvert = true");
        assert!(both.iter().zip(&inverted).all(|(a, b)| a + b == 1.0));
    }

    #[test]
    fn formulas_see_the_ground_and_are_held_between_zero_and_one() {
        let formula = values("formula = \"altitude / 5\"");
        assert_eq!([1.5, 5.5, 15.5].map(|x| at(&formula, x, 5.0)), [0.15, 0.55, 1.0]);
        let slope = values("formula = \"if(slope > 26 and aspect == 270, y / 10, 1 / 0 - 1 / 0)\"");
        assert_eq!(at(&slope, 3.0, 2.5), 0.25);
    }

    #[test]
    fn an_image_covers_the_terrain_with_its_north_row_first_and_must_have_its_shape() {
        let image = |width, height, frame| Image {
            width,
            height,
            values: (0..width * height).map(|i| f32::from(i < width)).collect(),
            is_float: false,
            frame,
        };
        let frame = LATTICE.frame((500.0, 700.0));
        let on_map = Frame { width: 4, height: 2, cell: 1.0, west: 504.0, south: 702.0 };
        let images = BTreeMap::from([
            ("fits".to_string(), image(4, 2, None)),
            ("square".to_string(), image(2, 2, None)),
            ("placed".to_string(), image(4, 2, Some(on_map))),
        ]);
        let map = Map { frame, images: &images };
        let image = |name: &str| map.image(&Written { value: name.into(), ..Default::default() });
        let (pixels, place) = image("fits").unwrap();
        let value = |x: f64, y: f64| {
            let (x, y) =
                ((x + place.offset[0]) * place.scale[0], (y + place.offset[1]) * place.scale[1]);
            place.pixels.sample(&pixels.values, x, y)
        };
        assert_eq!([value(10.0, 9.0), value(10.0, 5.0), value(10.0, 1.0)], [1.0, 0.5, 0.0]);
        let problem = image("square").unwrap_err();
        assert!(problem.to_string().contains("width / height must be 2.000"), "{problem}");
        let (_, place) = image("placed").unwrap();
        assert_eq!((place.offset, place.scale), ([-4.0, -2.0], [1.0, 1.0]));
        assert!(image("absent").is_err());
    }
}
