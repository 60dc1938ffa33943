//! Finer patches of ground around views.
//!
//! A patch starts from the source, interpolated smoothly, and goes through the same stack on its own
//! cells, where noise shows octaves that the terrain's cells cannot. Towards its border a patch
//! fades into the terrain, so that no step shows where it ends. Water levels, soil and flow are
//! the terrain's; the shore is found anew on the finer ground.

use crate::Error;
use crate::config::{Config, Detail};
use crate::environment::Source;
use crate::import::Ground;
use crate::lattice::Lattice;
use crate::mask::Map;
use crate::overlay;
use crate::resample::{bicubic, by_row};
use crate::spline::smoothstep;
use crate::stack::{Shaped, check_finite, halo, replay, sample};
use crate::stream::Channel;
use crate::water::{self, Hydrology};
use weald_contract::{Layers, Problem, Progress, View};

/// Cells of the terrain over which a patch fades into it, unless the patch is too small.
const FADE_CELLS: f64 = 8.0;

/// Largest part of a patch's radius that fades.
const FADE_SHARE: f64 = 0.25;

/// Most cells of a patch with its halo (about 1 GB while it is made).
const MAX_CELLS: usize = 16_000_000;

/// What patches are made of.
pub(crate) struct Patches<'a> {
    /// The ground before the stack.
    pub ground: &'a Ground,
    /// The ground after it.
    pub shaped: &'a Shaped<'a>,
    /// What masks read.
    pub map: &'a Map<'a>,
    /// Views, around which patches lie.
    pub views: &'a [View],
    /// What layers on demand are made from.
    pub environment: Source<'a>,
}

impl Patches<'_> {
    /// Builds all patches of a terrain whose own `layers` are done.
    pub fn build(
        &self,
        config: &Config,
        water: &Hydrology,
        layers: &Layers,
        progress: &dyn Progress,
    ) -> Result<Vec<Layers>, Error> {
        let Self { ground, shaped, map, .. } = self;
        progress.begin("detail", config.detail.len() as u64, "patches");
        let spread_level = spread_level(&shaped.lattice, &water.standing);
        let patch = |detail: &Detail| {
            let lattice = patch_lattice(detail, &shaped.lattice, self.views)?;
            let altitude = self.altitude(detail, &lattice, progress)?;
            let level = levels(&lattice, &altitude, shaped, &spread_level);
            let mut patch = water::local_layers(ground, &lattice, &altitude, &level);
            patch.crs = layers.crs.clone();
            add_hydrology(&mut patch, &lattice, &shaped.lattice, layers);
            self.environment.extend_patch(&mut patch, &lattice, layers);
            overlay::run(config, &lattice, map, &mut patch)?;
            progress.advance(1);
            Ok(patch)
        };
        config.detail.iter().map(patch).collect()
    }

    /// Altitudes of a patch.
    fn altitude(
        &self,
        detail: &Detail,
        lattice: &Lattice,
        progress: &dyn Progress,
    ) -> Result<Vec<f32>, Error> {
        let Self { ground, shaped, map, .. } = self;
        let whole = &shaped.lattice;
        let bounds = whole.refined(lattice.cell);
        let wide = lattice.grown(halo(&shaped.layers, lattice.cell), &bounds);
        if wide.len() > MAX_CELLS {
            let message = format!("this detail would have {} × {} cells", wide.width, wide.height);
            return Err(Problem::at(detail.cell_span(), message)
                .hint(format!("at most {MAX_CELLS} are made: enlarge `cell` or lessen `radius`"))
                .into());
        }
        let start = source_at(&wide, ground);
        let fine = wide.crop(&replay(shaped, &wide, start, map, progress)?, lattice);
        check_finite(&fine, detail.view.span)?;
        let coarse = sample(whole, &shaped.altitude, lattice);
        Ok(fade(detail, lattice, &bounds, whole.cell, &fine, &coarse))
    }
}

/// The cells of a patch: a square around the view's place, as far as the terrain goes.
fn patch_lattice(detail: &Detail, whole: &Lattice, views: &[View]) -> Result<Lattice, Problem> {
    let Some(view) = views.iter().find(|view| view.name == detail.view.value) else {
        return Err(Problem::at(
            detail.view.span,
            format!("there is no view `{}`", detail.view.value),
        ));
    };
    let cell = detail.cell.value;
    if cell >= whole.cell {
        return Err(Problem::at(
            detail.cell_span(),
            "a detail's cell must be smaller than the terrain's",
        )
        .hint(format!("the terrain has cells of {} m", whole.cell)));
    }
    let range = |center: f64, count: usize| {
        let first = ((center - detail.radius) / cell).round().clamp(0.0, count as f64);
        let last = ((center + detail.radius) / cell).round().clamp(0.0, count as f64);
        (first as usize, (last - first) as usize)
    };
    let bounds = whole.refined(cell);
    let (west, width) = range(view.stand_at[0], bounds.width);
    let (south, height) = range(view.stand_at[1], bounds.height);
    if width < 3 || height < 3 {
        return Err(Problem::at(detail.view.span, "this view stands outside the terrain"));
    }
    Ok(Lattice { cell, west, south, width, height })
}

/// The elevation model at a patch's cells, cubic between its own.
fn source_at(lattice: &Lattice, ground: &Ground) -> Vec<f32> {
    let (frame, values) = match &ground.source {
        Some(source) => (source.frame, source.values.as_slice()),
        None => (ground.frame, ground.altitude.as_slice()),
    };
    by_row(lattice.width, lattice.height, |row, out| {
        let y = ground.frame.south + lattice.y(row);
        for (column, out) in out.iter_mut().enumerate() {
            *out = bicubic(&frame, values, ground.frame.west + lattice.x(column), y);
        }
    })
}

/// The fine ground, becoming the terrain's at those borders beyond which the terrain goes on.
fn fade(
    detail: &Detail,
    lattice: &Lattice,
    bounds: &Lattice,
    coarse_cell: f64,
    fine: &[f32],
    coarse: &[f32],
) -> Vec<f32> {
    let band = (FADE_CELLS * coarse_cell).min(FADE_SHARE * detail.radius);
    let reaches = |edge: usize, bound: usize| if edge == bound { f64::INFINITY } else { 0.0 };
    let (open_west, open_south) = (reaches(lattice.west, 0), reaches(lattice.south, 0));
    let open_east = reaches(lattice.west + lattice.width, bounds.width);
    let open_north = reaches(lattice.south + lattice.height, bounds.height);
    let from_edge = |index: usize| (index as f64 + 0.5) * lattice.cell;
    by_row(lattice.width, lattice.height, |row, out| {
        let north = from_edge(row) + open_north;
        let south = from_edge(lattice.height - 1 - row) + open_south;
        for (column, out) in out.iter_mut().enumerate() {
            let west = from_edge(column) + open_west;
            let east = from_edge(lattice.width - 1 - column) + open_east;
            // The outermost cells, half a cell from the border, are the terrain's own.
            let inside = west.min(east).min(north).min(south) - 0.5 * lattice.cell;
            let weight = smoothstep(0.0, band, inside) as f32;
            let index = row * lattice.width + column;
            *out = coarse[index] + weight * (fine[index] - coarse[index]);
        }
    })
}

/// Levels of standing water, each also on the eight cells around it: on finer ground the shore may
/// lie in a neighbour of a flooded cell.
fn spread_level(lattice: &Lattice, level: &[f32]) -> Vec<f32> {
    let Lattice { width, height, .. } = *lattice;
    by_row(width, height, |row, out| {
        for (column, out) in out.iter_mut().enumerate() {
            let rows = row.saturating_sub(1)..=(row + 1).min(height - 1);
            let columns = column.saturating_sub(1)..=(column + 1).min(width - 1);
            let around = rows.flat_map(|row| columns.clone().map(move |column| (column, row)));
            let own = level[row * width + column];
            // `max` passes NaN over: no water gives way to any.
            let highest = around.map(|(x, y)| level[y * width + x]).fold(f32::NAN, f32::max);
            *out = if own.is_nan() { highest } else { own };
        }
    })
}

/// Levels of open water on a patch: the terrain's, and those of streams, which fall on the way.
fn levels(
    lattice: &Lattice,
    altitude: &[f32],
    shaped: &Shaped<'_>,
    spread_level: &[f32],
) -> Vec<f32> {
    let channels: Vec<&Channel> =
        shaped.layers.iter().filter_map(|layer| layer.wet_channel()).collect();
    let running = water::channel_levels(&channels, lattice, altitude);
    let frame = shaped.lattice.frame((0.0, 0.0));
    by_row(lattice.width, lattice.height, |row, out| {
        for (column, out) in out.iter_mut().enumerate() {
            let standing = frame
                .cell_at(lattice.x(column), lattice.y(row))
                .map_or(f32::NAN, |(column, row)| spread_level[frame.index(column, row)]);
            let running = running[row * lattice.width + column];
            *out = running.max(standing);
        }
    })
}

/// Adds what the terrain's own grid says about flow and soil.
fn add_hydrology(patch: &mut Layers, lattice: &Lattice, whole: &Lattice, layers: &Layers) {
    let sampled = |name: &str| layers.values(name).map(|values| sample(whole, values, lattice));
    for name in ["filled", "upslope_area", "wetness"] {
        if let Some(values) = sampled(name) {
            water::insert_hydrology(patch, name, values);
        }
    }
    let mut moisture = sampled("soil_moisture").unwrap_or_default();
    for (moisture, depth) in moisture.iter_mut().zip(patch.values("water_depth").unwrap_or(&[])) {
        if *depth > 0.0 {
            *moisture = 1.0;
        }
    }
    let definition = layers.layers.get("soil_moisture").map(|layer| layer.definition.clone());
    patch.insert("soil_moisture", "1", &definition.unwrap_or_default(), moisture);
}
