//! From an elevation model to ground that the stack can work on: checked, whole, on its grid.

use crate::config::{Config, Holes};
use crate::lattice::Lattice;
use crate::nearest::nearest_marked;
use crate::resample::resample;
use crate::{Error, check_cancelled};
use rayon::prelude::*;
use std::borrow::Cow;
use weald_contract::{Frame, Grid, Layers, Problem, Progress, Raster, Written};

/// The ground before the first operator.
pub(crate) struct Ground {
    /// The terrain's cells, map coordinates.
    pub frame: Frame,
    /// Altitudes on `frame`, m, all finite.
    pub altitude: Vec<f32>,
    /// The elevation model where its cells are not the terrain's; finer patches read it.
    pub source: Option<Grid>,
    /// Cells of the elevation model that had no data and took their nearest neighbour's.
    pub mended: usize,
    /// The elevation model with NaN in its holes, where layers are to have them too.
    pub holes: Option<Grid>,
}

impl Ground {
    /// Takes the values of all layers out where the elevation model has kept holes.
    pub fn keep_holes(&self, layers: &mut Layers) {
        let Some(holes) = &self.holes else { return };
        let is_hole = marked(holes, &layers.frame);
        for layer in layers.layers.values_mut() {
            for (value, _) in layer.values.iter_mut().zip(&is_hole).filter(|(_, hole)| **hole) {
                *value = f32::NAN;
            }
        }
        layers.detail.iter_mut().for_each(|patch| self.keep_holes(patch));
    }

    /// The ground that water runs over, with NaN in kept holes.
    pub fn drained<'a>(&self, altitude: &'a [f32]) -> Cow<'a, [f32]> {
        let Some(holes) = &self.holes else { return Cow::Borrowed(altitude) };
        let is_hole = marked(holes, &self.frame);
        let lowered =
            altitude.iter().zip(&is_hole).map(|(z, hole)| if *hole { f32::NAN } else { *z });
        Cow::Owned(lowered.collect())
    }
}

/// Which cells of a frame have their centre in a hole.
fn marked(holes: &Grid, frame: &Frame) -> Vec<bool> {
    let is_hole = |index| {
        let (x, y) = frame.center(index % frame.width, index / frame.width);
        holes.nearest(x, y).is_some_and(f32::is_nan)
    };
    (0..frame.len()).into_par_iter().map(is_hole).collect()
}

/// Most cells of a terrain: more would need over 10 GB at [`BYTES_PER_CELL`].
const MAX_CELLS: f64 = 1.34e8;

/// Memory at the widest point: layers, water and what the stack holds, measured.
const BYTES_PER_CELL: f64 = 82.0;

/// Fewest cells along a side: slopes need a cell on both sides.
const MIN_SIDE: usize = 3;

/// Heights beyond this, m, are undeclared marks for "no data", on any planet.
const MAX_HEIGHT: f32 = 1e5;

/// Checks the elevation model, mends its holes and brings it to the wanted cells.
pub(crate) fn ground(
    config: &Config,
    elevation: &Raster,
    progress: &dyn Progress,
) -> Result<Ground, Error> {
    check_source(config, elevation)?;
    let cropped = config.crop.as_ref().map(|crop| cropped(crop, &elevation.grid)).transpose()?;
    let source = cropped.as_ref().unwrap_or(&elevation.grid);
    let frame = target_frame(config, &source.frame)?;
    progress.begin("ground", 1, "grid");
    let (values, mended) = mend(config, source)?;
    check_cancelled(progress)?;
    if mended > 0 {
        let count = values.len();
        progress.say(&format!(
            "{mended} of the elevation model's {count} cells have no data: each takes its nearest \
             neighbour's height"
        ));
    }
    let is_kept = mended > 0 && config.source_holes == Holes::Keep;
    let holes = is_kept.then(|| source.clone());
    let is_same = frame == source.frame;
    let ground = if is_same {
        Ground { frame, altitude: values, source: None, mended, holes }
    } else {
        let altitude = resample(&source.frame, &values, &frame);
        let source = Grid { frame: source.frame, values };
        Ground { frame, altitude, source: Some(source), mended, holes }
    };
    progress.advance(1);
    Ok(ground)
}

/// The cells of a grid whose centres lie in a rectangle, given from its south-west corner.
fn cropped(crop: &Written<[f64; 4]>, grid: &Grid) -> Result<Grid, Problem> {
    let whole = Lattice::of(&grid.frame);
    let range = |low: f64, high: f64, count: usize| {
        let place = |edge: f64| (edge / whole.cell).round().clamp(0.0, count as f64) as usize;
        (place(low), place(high) - place(low))
    };
    let [west, south, east, north] = crop.value;
    let (first_column, width) = range(west, east, whole.width);
    let (first_row, height) = range(south, north, whole.height);
    if width < MIN_SIDE || height < MIN_SIDE {
        let message = format!("this leaves {width} × {height} cells of the elevation model");
        return Err(Problem::at(crop.span, message).hint(format!(
            "at least {MIN_SIDE} × {MIN_SIDE} are needed; the model is {} × {} m",
            whole.width as f64 * whole.cell,
            whole.height as f64 * whole.cell
        )));
    }
    let part = Lattice { west: first_column, south: first_row, width, height, ..whole };
    let frame = part.frame((grid.frame.west, grid.frame.south));
    Ok(Grid { frame, values: whole.crop(&grid.values, &part) })
}

fn check_source(config: &Config, elevation: &Raster) -> Result<(), Problem> {
    let problem = |message: String| Problem::at(config.source.span, message);
    let Frame { width, height, cell, west, south } = elevation.grid.frame;
    if elevation.crs.is_geographic {
        return Err(problem("the elevation model's coordinates are degrees".into())
            .hint("bring it to a map in metres first, such as its UTM zone"));
    }
    if !(cell > 0.0 && cell.is_finite() && west.is_finite() && south.is_finite()) {
        return Err(problem(format!(
            "the elevation model has cells of {cell} at ({west}, {south})"
        ))
        .hint("a cell's side and the corner must be finite, the side positive"));
    }
    if width.checked_mul(height) != Some(elevation.grid.values.len()) {
        return Err(problem("the elevation model's values do not fit its size".into()));
    }
    if width < MIN_SIDE || height < MIN_SIDE {
        return Err(problem(format!("the elevation model is {width} × {height} cells"))
            .hint(format!("at least {MIN_SIDE} × {MIN_SIDE} are needed")));
    }
    Ok(())
}

/// The terrain's frame: the source's, or as many of the wanted cells as cover it best.
fn target_frame(config: &Config, source: &Frame) -> Result<Frame, Problem> {
    let cell = config.cell.as_ref().map_or(source.cell, |cell| cell.value);
    let span = config.cell.as_ref().map_or(config.source.span, |cell| cell.span);
    let (width, height) = if cell == source.cell {
        (source.width as f64, source.height as f64)
    } else {
        let cells = |count: usize| (count as f64 * source.cell / cell).round();
        (cells(source.width), cells(source.height))
    };
    if width * height > MAX_CELLS {
        let gigabytes = width * height * BYTES_PER_CELL / 1e9;
        let fitting = cell * (width * height / MAX_CELLS).sqrt();
        return Err(Problem::at(
            span,
            format!("{width} × {height} cells would need about {gigabytes:.0} GB of memory"),
        )
        .hint(format!("set `cell` to at least {fitting:.3}")));
    }
    if width < MIN_SIDE as f64 || height < MIN_SIDE as f64 {
        return Err(Problem::at(
            span,
            format!("cells of {cell} m leave {width} × {height} of them"),
        )
        .hint(format!("at least {MIN_SIDE} × {MIN_SIDE} are needed")));
    }
    Ok(Frame { width: width as usize, height: height as usize, cell, ..*source })
}

/// Gives cells without data the value of the nearest one that has data.
fn mend(config: &Config, source: &Grid) -> Result<(Vec<f32>, usize), Problem> {
    let problem = |message: String| Problem::at(config.source.span, message);
    let known: Vec<bool> = source.values.iter().map(|value| value.is_finite()).collect();
    let missing = known.iter().filter(|known| !**known).count();
    let is_enough = match config.source_holes {
        Holes::Fill => missing * 2 <= known.len(),
        Holes::Keep => missing < known.len(),
    };
    if !is_enough {
        let share = 100.0 * missing as f64 / known.len() as f64;
        return Err(problem(format!("{share:.0} % of the elevation model is without data")).hint(
            "at least half of its cells must have a height: crop it to where there is data, or set \
             `source_holes = \"keep\"`",
        ));
    }
    let absurd = source.values.iter().find(|value| value.is_finite() && value.abs() > MAX_HEIGHT);
    if let Some(value) = absurd {
        return Err(problem(format!("the elevation model has a height of {value} m"))
            .hint("if that stands for \"no data\", declare it in the file"));
    }
    let mut values = source.values.clone();
    if missing > 0 {
        let nearest = nearest_marked(source.frame.width, source.frame.height, &known);
        for (value, index) in values.iter_mut().zip(nearest).filter(|(value, _)| !value.is_finite())
        {
            *value = source.values[index as usize];
        }
    }
    Ok((values, missing))
}
