//! Open water and soil water, and all the layers that a terrain hands on.

use crate::area;
use crate::config::{Config, Water};
use crate::derive;
use crate::flow::{self, Flood};
use crate::hollow::rising;
use crate::import::Ground;
use crate::lattice::Lattice;
use crate::mask::Map;
use crate::nearest::{NONE, nearest_marked};
use crate::operator::Lake;
use crate::rain::{self, Balance, Catchment, Shower};
use crate::resample::{by_row, gaussian};
use crate::spline::smoothstep;
use crate::stack::Shaped;
use crate::stream::Channel;
use crate::{Error, check_cancelled};
use weald_contract::{Crs, Layers, Problem, Progress};

/// Where water is on the terrain's own grid.
pub(crate) struct Hydrology {
    /// The filled ground and its drains.
    pub flood: Flood,
    /// Level of the open water on each cell; NaN where there is none.
    pub level: Vec<f32>,
    /// The same of lakes and ponds alone, which are level where streams fall.
    pub standing: Vec<f32>,
    /// Area that drains through each cell, m².
    pub upslope_area: Vec<f32>,
    /// Wetness of the soil, 0 dry to 1 saturated.
    pub soil_moisture: Vec<f32>,
    /// Where the rain went, m³.
    pub balance: Balance,
}

/// Fills lakes and streams, lets rain run and soak in.
pub(crate) fn settle(
    config: &Config,
    ground: &Ground,
    shaped: &Shaped<'_>,
    map: &Map<'_>,
    progress: &dyn Progress,
) -> Result<Hydrology, Error> {
    let Lattice { width, height, cell, .. } = shaped.lattice;
    progress.begin("water", 3, "steps");
    let drained = ground.drained(&shaped.altitude);
    let mut flood = flow::fill(width, height, &drained);
    flow::drain_through_floors(width, &drained, &mut flood);
    drop(drained);
    let directions = flow::directions(width, height, &flood);
    let cells = area::drained_cells(width, &directions);
    let upslope_area = cells.iter().map(|cells| (f64::from(*cells) * cell * cell) as f32).collect();
    progress.advance(1);
    check_cancelled(progress)?;

    let mut standing = vec![f32::NAN; shaped.altitude.len()];
    for lake in &shaped.lakes {
        fill_lake(lake, &shaped.lattice, &shaped.altitude, &flood, &mut standing)?;
    }
    let is_lake: Vec<bool> = standing.iter().map(|level| !level.is_nan()).collect();
    let running = stream_levels(shaped);
    let level = higher(&running, &standing);
    let soaked = soak(&config.water, shaped, &soil(&config.water, shaped, map)?, &is_lake, &level);
    progress.advance(1);
    check_cancelled(progress)?;

    let moisture = soaked.soil_water.iter().map(|water| water / config.water.capacity as f32);
    let moisture: Vec<f32> = moisture.collect();
    if config.water.ponds {
        let ponds = soaked.ponded.iter().zip(&shaped.altitude).zip(&level).zip(&mut standing);
        for (((depth, ground), level), standing) in ponds.filter(|(((d, _), _), _)| **d > 0.0) {
            // A pond may have risen over a stream; `max` passes NaN over.
            *standing = standing.max(ground.max(*level) + depth);
        }
    }
    let level = higher(&running, &standing);
    let soil_moisture = wet_shores(&config.water, shaped, &level, moisture);
    progress.advance(1);
    let area = cell * cell;
    let Balance { rain, absorbed, ponded, lakes, outflow } = soaked.balance;
    let balance = Balance {
        rain: rain * area,
        absorbed: absorbed * area,
        ponded: ponded * area,
        lakes: lakes * area,
        outflow: outflow * area,
    };
    Ok(Hydrology { flood, level, standing, upslope_area, soil_moisture, balance })
}

/// The higher of two levels, either of which may be NaN for no water.
fn higher(a: &[f32], b: &[f32]) -> Vec<f32> {
    a.iter().zip(b).map(|(a, b)| a.max(*b)).collect()
}

/// Levels of the water in streams; NaN elsewhere.
fn stream_levels(shaped: &Shaped<'_>) -> Vec<f32> {
    let channels: Vec<&Channel> =
        shaped.layers.iter().filter_map(|layer| layer.wet_channel()).collect();
    channel_levels(&channels, &shaped.lattice, &shaped.altitude)
}

/// Levels of the water that channels carry, where it stands above the ground.
pub(crate) fn channel_levels(
    channels: &[&Channel],
    lattice: &Lattice,
    altitude: &[f32],
) -> Vec<f32> {
    by_row(lattice.width, lattice.height, |row, levels| {
        levels.fill(f32::NAN);
        let y = lattice.y(row);
        let ground = &altitude[row * lattice.width..][..lattice.width];
        for channel in channels {
            let segments = channel.segments_near_row(y);
            if segments.is_empty() {
                continue;
            }
            for (column, level) in levels.iter_mut().enumerate() {
                let water = channel.water_at(&segments, [lattice.x(column), y]);
                if let Some(water) = water.filter(|water| *water > f64::from(ground[column])) {
                    *level = level.max(water as f32);
                }
            }
        }
    })
}

/// Lets water stand in the hollow around a lake's point.
fn fill_lake(
    lake: &Lake,
    lattice: &Lattice,
    altitude: &[f32],
    flood: &Flood,
    standing: &mut [f32],
) -> Result<(), Problem> {
    let start = lake_cell(lake, lattice, altitude, flood)?;
    let surface = lake.level.value as f32;
    let mut reached = vec![start];
    let mut is_reached = vec![false; altitude.len()];
    is_reached[start] = true;
    // No cell of the rim is reached: the lake's level does not spill.
    while let Some(cell) = reached.pop() {
        if !standing[cell].is_nan() && standing[cell] != surface {
            let message =
                format!("a lake with its level at {} m stands in this hollow", standing[cell]);
            return Err(Problem::at(lake.level.span, message).hint("give both the same level"));
        }
        standing[cell] = surface;
        for direction in 0..8 {
            let beside = flow::neighbor(cell, direction, lattice.width);
            if !is_reached[beside] && altitude[beside] < surface {
                is_reached[beside] = true;
                reached.push(beside);
            }
        }
    }
    Ok(())
}

/// The cell of a lake's point, if water can stand there up to the lake's level.
fn lake_cell(
    lake: &Lake,
    lattice: &Lattice,
    altitude: &[f32],
    flood: &Flood,
) -> Result<usize, Problem> {
    let [x, y] = lake.at.value;
    let frame = lattice.frame((0.0, 0.0));
    let Some((column, row)) = frame.cell_at(x, y) else {
        return Err(Problem::at(lake.at.span, format!("({x}, {y}) lies outside the terrain"))
            .hint(format!("the terrain is {} × {} m", frame.east(), frame.north())));
    };
    let cell = frame.index(column, row);
    let (ground, spill) = (altitude[cell], flood.level[cell]);
    let surface = lake.level.value as f32;
    if spill <= ground || spill.is_nan() {
        return Err(Problem::at(
            lake.at.span,
            format!("({x}, {y}) does not lie in a hollow: water would run off its ground at {ground:.2} m"),
        )
        .hint("choose a point on the hollow's floor"));
    }
    // Printed levels are rounded inwards, so that taking them at their word works.
    let highest = (f64::from(spill) * 100.0).floor() / 100.0;
    let lowest = (f64::from(ground) * 100.0).ceil() / 100.0;
    if surface <= ground {
        return Err(Problem::at(
            lake.level.span,
            format!("the level {surface} m lies below the ground at ({x}, {y}), {ground:.2} m"),
        )
        .hint(format!("choose a level between {lowest:.2} and {highest:.2}")));
    }
    if surface > spill {
        return Err(Problem::at(
            lake.level.span,
            format!("at {surface} m this lake would spill over its hollow's rim"),
        )
        .hint(format!("the highest level possible is {highest:.2}")));
    }
    Ok(cell)
}

/// Slope on which soil is too thin to hold any water: it no longer stays on its ground. (Ours.)
pub(crate) const BARE_SLOPE_DEG: f32 = 60.0;

/// Share of `capacity` that the soil map gives each cell; 1 where it says nothing.
fn soil(water: &Water, shaped: &Shaped<'_>, map: &Map<'_>) -> Result<Vec<f32>, Problem> {
    let lattice = &shaped.lattice;
    let Some(path) = &water.soil else {
        return Ok(vec![1.0; shaped.altitude.len()]);
    };
    let (image, frame) = map.image(path)?;
    Ok(by_row(lattice.width, lattice.height, |row, out| {
        let y = lattice.y(row);
        for (column, share) in out.iter_mut().enumerate() {
            let pixel = frame.sample(&image.values, lattice.x(column), y);
            let pixel = pixel.filter(|pixel| pixel.is_finite());
            *share = pixel.map_or(1.0, |pixel| pixel.clamp(0.0, 1.0));
        }
    }))
}

/// Runs the rain model over the ground with its open water.
fn soak(
    water: &Water,
    shaped: &Shaped<'_>,
    soil: &[f32],
    is_lake: &[bool],
    level: &[f32],
) -> rain::Soaked {
    let Lattice { width, height, cell, .. } = shaped.lattice;
    // Soil thins with slope, and its room for water with it. (Ours.)
    let capacity =
        derive::from_gradient(width, height, cell, &shaped.altitude, |index, gradient| {
            let is_saturated = !level[index].is_nan();
            let share =
                if is_saturated { 0.0 } else { 1.0 - gradient.slope_deg() / BARE_SLOPE_DEG };
            water.capacity as f32 * share.max(0.0) * soil[index]
        });
    let surface: Vec<f32> =
        shaped.altitude.iter().zip(level).map(|(ground, level)| ground.max(*level)).collect();
    let catchment = Catchment { width, height, surface: &surface, is_lake, capacity: &capacity };
    let shower = Shower {
        rain: water.rain,
        absorbed: water.absorbed,
        seepage: 1.0 - libm::exp(-cell / water.seepage),
    };
    rain::fall(&catchment, &shower)
}

/// Adds what rises from open water nearby, and evens soil water out.
///
/// The capillary fringe is ours: soil at the water's edge is saturated, and the excess fades as
/// e^(-h / fringe) with the height h above the nearest water and along a spline with the distance
/// to it. Rain and fringe leave the soil dry independently: 1 - m = (1 - m_rain)(1 - m_fringe).
fn wet_shores(water: &Water, shaped: &Shaped<'_>, level: &[f32], rain: Vec<f32>) -> Vec<f32> {
    let Lattice { width, height, cell, .. } = shaped.lattice;
    let is_water: Vec<bool> = level.iter().map(|level| !level.is_nan()).collect();
    let nearest = nearest_marked(width, height, &is_water);
    let moisture = by_row(width, height, |row, out| {
        for (column, out) in out.iter_mut().enumerate() {
            let index = row * width + column;
            let dry = 1.0 - f64::from(rain[index].clamp(0.0, 1.0));
            let wet = match nearest[index] {
                NONE => 0.0,
                shore => {
                    let (dx, dy) = (shore as usize % width, shore as usize / width);
                    let (dx, dy) = (dx.abs_diff(column) as f64, dy.abs_diff(row) as f64);
                    let above = shaped.altitude[index] - level[shore as usize];
                    fringe(water, f64::from(above), cell * (dx * dx + dy * dy).sqrt())
                }
            };
            *out = (1.0 - dry * (1.0 - wet)) as f32;
        }
    });
    let mut spread = gaussian(width, height, cell, &moisture, water.spread);
    for (moisture, is_water) in spread.iter_mut().zip(&is_water) {
        *moisture = if *is_water { 1.0 } else { moisture.clamp(0.0, 1.0) };
    }
    spread
}

/// Share of dry soil's room that open water fills from a height above it and a distance.
fn fringe(water: &Water, above: f64, distance: f64) -> f64 {
    let near = 1.0 - smoothstep(0.0, water.fringe_reach, distance);
    if distance == 0.0 {
        1.0
    } else if water.fringe > 0.0 {
        near * libm::exp(-above.max(0.0) / water.fringe)
    } else {
        0.0
    }
}

/// Depth of water above the ground, m; 0 where there is none.
pub(crate) fn depth(ground: f32, level: f32) -> f32 {
    // The comparison is false for NaN, which stands for no water.
    if level > ground { level - ground } else { 0.0 }
}

/// All layers on the terrain's own grid.
pub(crate) fn layers(ground: &Ground, shaped: &Shaped<'_>, water: &Hydrology, crs: &Crs) -> Layers {
    let Lattice { width, height, cell, .. } = shaped.lattice;
    let mut layers = local_layers(ground, &shaped.lattice, &shaped.altitude, &water.level);
    layers.frame = ground.frame;
    layers.crs = crs.clone();
    // Water that ends in a hollow makes its floor wet, and not the way out over its rim: here the
    // area is that of shared flow on the ground as it is.
    let drained = ground.drained(&shaped.altitude);
    let order = rising(&drained);
    let ones = vec![1.0; drained.len()];
    let cells = flow::accumulate_shared(width, &drained, &order, ones);
    let wetness =
        derive::from_gradient(width, height, cell, &shaped.altitude, |index, gradient| {
            derive::wetness(cells[index] * cell * cell, cell, gradient.tangent())
        });
    let Balance { rain, absorbed, ponded, lakes, outflow } = water.balance;
    let moisture = format!(
        "Water in the soil over what level soil holds, under open water 1. Of {rain:.1} m3 of \
         rain {absorbed:.1} were absorbed, {ponded:.1} stayed in hollows, {lakes:.1} ran into lakes, \
         {outflow:.1} ran off"
    );
    insert_hydrology(&mut layers, "filled", water.flood.level.clone());
    insert_hydrology(&mut layers, "upslope_area", water.upslope_area.clone());
    insert_hydrology(&mut layers, "wetness", wetness);
    layers.insert("soil_moisture", "1", &moisture, water.soil_moisture.clone());
    layers
}

/// The layers that follow from altitude and water level alone, on any lattice.
pub(crate) fn local_layers(
    ground: &Ground,
    lattice: &Lattice,
    altitude: &[f32],
    level: &[f32],
) -> Layers {
    let Lattice { width, height, cell, .. } = *lattice;
    let frame = lattice.frame((ground.frame.west, ground.frame.south));
    let mut layers =
        Layers { frame, crs: Crs::default(), layers: Default::default(), detail: Vec::new() };
    let slope = derive::from_gradient(width, height, cell, altitude, |_, g| g.slope_deg());
    let aspect = derive::from_gradient(width, height, cell, altitude, |_, g| g.aspect_deg());
    let depth = altitude.iter().zip(level).map(|(ground, level)| depth(*ground, *level)).collect();
    let mended = match ground.mended {
        0 => String::new(),
        count => format!("; {count} cells of the source had no data and took their neighbours'"),
    };
    let altitude_means = format!("Altitude of the ground, in the source's vertical datum{mended}");
    layers.insert("altitude", "m", &altitude_means, altitude.to_vec());
    layers.insert("slope", "degree", "Steepness of the ground, 3 x 3 cells (Horn)", slope);
    let aspect_means = "Direction in which the ground falls, clockwise from north; 0 where level";
    layers.insert("aspect", "degree", aspect_means, aspect);
    layers.insert("water_depth", "m", "Depth of open water above the ground", depth);
    layers
}

/// Adds a layer of the coarse hydrology with its unit and meaning.
pub(crate) fn insert_hydrology(layers: &mut Layers, name: &str, values: Vec<f32>) {
    let (unit, definition) = match name {
        "filled" => ("m", "Lowest level from which water can leave the cell: hollows filled"),
        "upslope_area" => {
            ("m2", "Area that drains through the cell by steepest descent (D8), hollows included")
        }
        _ => (
            "1",
            "Topographic wetness index ln(a / tan b): a area above per metre of contour, tan b >= 0.001",
        ),
    };
    layers.insert(name, unit, definition, values);
}
