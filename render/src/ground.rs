//! The ground and the water on it, as meshes, and the colour of the ground.
//!
//! Heights belong to cell centres; triangles span between them. Where the terrain has a detail
//! patch, each coarse cell inside it is divided, and the fine vertices on the rim of the patch lie
//! on the coarse cells' straight edges, so the surface has no gap. Beyond the terrain the ground
//! rolls on for two kilometres, so that no edge of the world is seen.

use crate::Error;
use crate::accel::Triangle;
use crate::noise::{cloudy, smoothstep, value};
use crate::primitive::Face;
use glam::Vec3;
use rayon::prelude::*;
use weald_contract::{Frame, Grid, Layers, Mesh};

/// Distances beyond the outermost cell centres at which the surroundings have vertices, m.
const BEYOND: [f64; 12] =
    [3.0, 8.0, 16.0, 30.0, 55.0, 100.0, 170.0, 280.0, 450.0, 750.0, 1250.0, 2200.0];

/// Farthest distance at which they have, m.
pub(crate) const REACH: f32 = BEYOND[BEYOND.len() - 1] as f32;

/// Height that the surroundings have gained at their far rim, m: enough to hide the horizon of
/// a flat world behind gentle hills.
const RISE: f64 = 22.0;

/// Depth above which water is drawn, m; thinner films are wet soil.
pub(crate) const WATER_FILM: f32 = 0.02;

/// Material numbers that every scene begins with.
pub(crate) const GROUND_MATERIAL: u16 = 0;
pub(crate) const WATER_MATERIAL: u16 = 1;

/// Meshes of a terrain, in scene-local metres.
pub(crate) struct Ground {
    pub triangles: Vec<Triangle>,
    pub water: Vec<Triangle>,
}

/// Map coordinates of the scene-local origin: the terrain's south-west corner at its lowest
/// altitude.
pub(crate) fn origin(terrain: &Layers) -> Result<[f64; 3], Error> {
    let altitude = layer(terrain, "altitude")?;
    let lowest = altitude.iter().copied().fold(f32::INFINITY, f32::min);
    Ok([terrain.frame.west, terrain.frame.south, f64::from(lowest.floor())])
}

/// A layer whose values are all finite.
fn layer<'a>(terrain: &'a Layers, name: &'static str) -> Result<&'a [f32], Error> {
    let values = terrain.values(name).ok_or(Error::MissingLayer(name))?;
    let frame = &terrain.frame;
    if values.len() != frame.len() || !(frame.cell.is_finite() && frame.cell > 0.0) {
        let what = "its values do not fit its grid".to_string();
        return Err(Error::BadTerrain { layer: name, what });
    }
    if frame.width < 2 || frame.height < 2 {
        let what = format!("{} x {} cells are too few", frame.width, frame.height);
        return Err(Error::BadTerrain { layer: name, what });
    }
    if let Some(index) = values.iter().position(|value| !value.is_finite() || value.abs() > 1e6) {
        let (column, row) = (index % frame.width, index / frame.width);
        let what = format!("it is {} at column {column}, row {row}", values[index]);
        return Err(Error::BadTerrain { layer: name, what });
    }
    Ok(values)
}

/// Most cells of the coarse mesh; larger terrains are sampled at wider steps, since detail
/// patches carry what is seen from near. Two triangles a cell, 78 B each, make 0.6 GB.
const MOST_CELLS: usize = 4_000_000;

/// A terrain whose coarse grid has at most `most` cells: the same, or sampled at wider steps.
fn thinned(terrain: &Layers, most: usize) -> std::borrow::Cow<'_, Layers> {
    use std::borrow::Cow;
    let fine = terrain.frame;
    if fine.len() <= most {
        return Cow::Borrowed(terrain);
    }
    let step = (fine.len() as f64 / most as f64).sqrt().ceil();
    // Cells that do not fill a wider one are left to the north and east rim, beyond which the
    // surroundings begin.
    let width = ((fine.width as f64 / step) as usize).max(2);
    let height = ((fine.height as f64 / step) as usize).max(2);
    let frame = Frame { width, height, cell: fine.cell * step, ..fine };
    let mut wide = Layers {
        frame,
        crs: terrain.crs.clone(),
        layers: Default::default(),
        detail: terrain.detail.clone(),
    };
    let needed = ["altitude", "water_depth"].map(|name| terrain.layers.get_key_value(name));
    for (name, layer) in needed.into_iter().flatten() {
        let grid = Grid::from_fn(frame, |x, y| fine.sample(&layer.values, x, y));
        wide.insert(name, &layer.unit, &layer.definition, grid.values);
    }
    Cow::Owned(wide)
}

/// Makes the meshes of a terrain.
pub(crate) fn build(terrain: &Layers, origin: [f64; 3]) -> Result<Ground, Error> {
    layer(terrain, "altitude")?;
    let terrain = &*thinned(terrain, MOST_CELLS);
    let altitude = layer(terrain, "altitude")?;
    let owners = owners(terrain);
    let coarse = surroundings(terrain, altitude);
    let edge = BEYOND.len();
    let is_ours = |column: usize, row: usize| {
        let inside = column.checked_sub(edge).zip(row.checked_sub(edge));
        inside.is_none_or(|(column, row)| owners.of(column, row).is_none())
    };
    let mut triangles = coarse.triangles(origin, GROUND_MATERIAL, &is_ours);
    for (number, patch) in terrain.detail.iter().enumerate() {
        if let Some(area) = owners.areas[number] {
            layer(patch, "altitude")?;
            let fine = divided(terrain, patch, area);
            let ours = |column: usize, row: usize| {
                let (column, row) = (area.west + column / fine.1, area.north + row / fine.1);
                owners.of(column, row) == Some(number)
            };
            triangles.extend(fine.0.triangles(origin, GROUND_MATERIAL, &ours));
        }
    }
    Ok(Ground { triangles, water: water(terrain, altitude, origin)? })
}

/// The ground and the water as [`Scene::build`](crate::Scene::build) draws them, for other
/// programs: scene-local metres, three vertices a triangle.
///
/// # Errors
/// As the terrain of a scene.
pub fn mesh(terrain: &Layers) -> Result<[Mesh; 2], Error> {
    let ground = build(terrain, origin(terrain)?)?;
    let soup = |triangles: &[Triangle]| {
        let mut mesh = Mesh::default();
        for (triangle, first) in triangles.iter().zip((0u32..).step_by(3)) {
            let at = |u, v| triangle.face.normal(u, v).to_array();
            mesh.positions.extend(triangle.corners.map(|corner| corner.to_array()));
            mesh.normals.extend([at(0.0, 0.0), at(1.0, 0.0), at(0.0, 1.0)]);
            mesh.triangles.push([first, first + 1, first + 2]);
        }
        mesh
    };
    Ok([soup(&ground.triangles), soup(&ground.water)])
}

/// A rectangle of coarse quads: columns `west..east`, rows `north..south` of cell centres.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Area {
    west: usize,
    east: usize,
    north: usize,
    south: usize,
}

/// Which detail patch draws each quad between four coarse cell centres.
struct Owners {
    /// For each patch, the quads that lie wholly inside it.
    areas: Vec<Option<Area>>,
}

impl Owners {
    /// The patch that draws a quad; the first one counts, as in [`Layers::finest`].
    fn of(&self, column: usize, row: usize) -> Option<usize> {
        self.areas.iter().position(|area| {
            area.is_some_and(|a| {
                (a.west..a.east).contains(&column) && (a.north..a.south).contains(&row)
            })
        })
    }
}

fn owners(terrain: &Layers) -> Owners {
    let frame = &terrain.frame;
    let area = |patch: &Layers| {
        // The first and last centre inside the patch.
        let p = &patch.frame;
        let first = |low: f64, start: f64| ((low - start) / frame.cell - 0.5).ceil().max(0.0);
        let last = |high: f64, start: f64| ((high - start) / frame.cell - 0.5).floor();
        let (west, east) = (first(p.west, frame.west), last(p.east(), frame.west));
        let (north, south) = (
            ((frame.north() - p.north()) / frame.cell - 0.5).ceil().max(0.0),
            ((frame.north() - p.south) / frame.cell - 0.5).floor(),
        );
        let (east, south) =
            (east.min(frame.width as f64 - 1.0), south.min(frame.height as f64 - 1.0));
        let is_finer = p.cell < 0.75 * frame.cell && p.width >= 2 && p.height >= 2;
        (is_finer && east > west && south > north).then_some(Area {
            west: west as usize,
            east: east as usize,
            north: north as usize,
            south: south as usize,
        })
    };
    Owners { areas: terrain.detail.iter().map(area).collect() }
}

/// Vertices on a grid of uneven columns and rows.
struct Sheet {
    /// Map x of the columns, rising.
    xs: Vec<f64>,
    /// Map y of the rows, falling.
    ys: Vec<f64>,
    /// Altitude, row by row.
    heights: Vec<f32>,
}

impl Sheet {
    fn height(&self, column: usize, row: usize) -> f32 {
        self.heights[row * self.xs.len() + column]
    }

    /// Unit normal by central differences; one-sided at the rim.
    fn normal(&self, column: usize, row: usize) -> Vec3 {
        let (c0, c1) = (column.saturating_sub(1), (column + 1).min(self.xs.len() - 1));
        let (r0, r1) = (row.saturating_sub(1), (row + 1).min(self.ys.len() - 1));
        let dx = (self.height(c1, row) - self.height(c0, row)) / (self.xs[c1] - self.xs[c0]) as f32;
        let dy = (self.height(column, r0) - self.height(column, r1))
            / (self.ys[r0] - self.ys[r1]) as f32;
        Vec3::new(-dx, -dy, 1.0).normalize()
    }

    /// Two triangles for each quad that is wanted, in scene-local coordinates.
    fn triangles(
        &self,
        origin: [f64; 3],
        material: u16,
        is_wanted: &(dyn Fn(usize, usize) -> bool + Sync),
    ) -> Vec<Triangle> {
        let vertex = |column: usize, row: usize| {
            let z = f64::from(self.height(column, row)) - origin[2];
            let (x, y) = (self.xs[column] - origin[0], self.ys[row] - origin[1]);
            Vec3::new(x as f32, y as f32, z as f32)
        };
        let quad = |column: usize, row: usize| {
            let corner = |(c, r): (usize, usize)| (vertex(c, r), self.normal(c, r));
            let (nw, ne) = (corner((column, row)), corner((column + 1, row)));
            let (sw, se) = (corner((column, row + 1)), corner((column + 1, row + 1)));
            [[sw, se, ne], [sw, ne, nw]].map(|three| {
                let face = Face::new(three.map(|(_, normal)| normal), material);
                Triangle::new(three.map(|(position, _)| position), face)
            })
        };
        let line = |row: usize| {
            let columns = (0..self.xs.len() - 1).filter(move |&column| is_wanted(column, row));
            columns.flat_map(move |column| quad(column, row)).collect::<Vec<_>>()
        };
        let lines: Vec<Vec<Triangle>> = (0..self.ys.len() - 1).into_par_iter().map(line).collect();
        lines.concat()
    }
}

/// The coarse cell centres and the land beyond them.
fn surroundings(terrain: &Layers, altitude: &[f32]) -> Sheet {
    let frame = terrain.frame;
    let centers_x = (0..frame.width).map(|column| frame.center(column, 0).0);
    let centers_y = (0..frame.height).map(|row| frame.center(0, row).1);
    let (first_x, last_y) = frame.center(0, frame.height - 1);
    let (last_x, first_y) = frame.center(frame.width - 1, 0);
    let before = || BEYOND.iter().rev();
    let xs: Vec<f64> = (before().map(|d| first_x - d).chain(centers_x))
        .chain(BEYOND.iter().map(|d| last_x + d))
        .collect();
    let ys: Vec<f64> = (before().map(|d| first_y + d).chain(centers_y))
        .chain(BEYOND.iter().map(|d| last_y - d))
        .collect();
    let mean = altitude.iter().map(|&h| f64::from(h)).sum::<f64>() / altitude.len() as f64;
    let height = |x: f64, y: f64| {
        let rim = f64::from(frame.sample(altitude, x, y));
        let away = |v: f64, low: f64, high: f64| (low - v).max(v - high).max(0.0);
        let (dx, dy) = (away(x, first_x, last_x), away(y, last_y, first_y));
        let distance = (dx * dx + dy * dy).sqrt();
        if distance == 0.0 {
            return rim as f32;
        }
        // The rim's own shape fades out, hills fade in.
        let kept = 1.0 - f64::from(smoothstep(0.0, 350.0, distance as f32));
        let hill = f64::from(cloudy((x / 420.0) as f32, (y / 420.0) as f32, 5));
        let far = f64::from(smoothstep(0.0, 2000.0, distance as f32));
        (mean + (rim - mean) * kept + far * RISE * (1.0 + 0.6 * hill)) as f32
    };
    let heights = ys.iter().flat_map(|&y| xs.iter().map(move |&x| (x, y)));
    Sheet { heights: heights.map(|(x, y)| height(x, y)).collect(), xs, ys }
}

/// The coarse quads of an area, each divided so that parts are as fine as the patch; also
/// returns into how many parts along a side.
fn divided(terrain: &Layers, patch: &Layers, area: Area) -> (Sheet, usize) {
    let frame = terrain.frame;
    let parts = (frame.cell / patch.frame.cell - 1e-9).ceil().max(1.0) as usize;
    let (columns, rows) = ((area.east - area.west) * parts, (area.south - area.north) * parts);
    let (x0, y0) = frame.center(area.west, area.north);
    let step = frame.cell / parts as f64;
    let xs: Vec<f64> = (0..=columns).map(|column| x0 + column as f64 * step).collect();
    let ys: Vec<f64> = (0..=rows).map(|row| y0 - row as f64 * step).collect();
    let coarse = terrain.values("altitude").unwrap_or_default();
    let fine = patch.values("altitude").unwrap_or_default();
    let height = |column: usize, row: usize| {
        let is_rim = column == 0 || row == 0 || column == columns || row == rows;
        // On a coarse edge bilinear interpolation is linear: the edge of the coarse triangles.
        if is_rim {
            frame.sample(coarse, xs[column], ys[row])
        } else {
            patch.frame.sample(fine, xs[column], ys[row])
        }
    };
    let heights: Vec<f32> = (0..=rows)
        .into_par_iter()
        .flat_map_iter(|row| (0..=columns).map(move |column| (column, row)))
        .map(|(column, row)| height(column, row))
        .collect();
    (Sheet { xs, ys, heights }, parts)
}

/// Flat sheets over all cells under water, reaching two cells under the shore so that the water
/// line is where the ground rises through them.
fn water(terrain: &Layers, altitude: &[f32], origin: [f64; 3]) -> Result<Vec<Triangle>, Error> {
    if terrain.values("water_depth").is_none() {
        return Ok(Vec::new());
    }
    let depth = layer(terrain, "water_depth")?;
    let frame = terrain.frame;
    let mut levels: Vec<Option<f32>> = (altitude.iter().zip(depth))
        .map(|(height, &depth)| (depth > WATER_FILM).then_some(height + depth))
        .collect();
    for _ in 0..2 {
        levels = spread(&frame, &levels);
    }
    let sheet = Sheet {
        xs: (0..frame.width).map(|column| frame.center(column, 0).0).collect(),
        ys: (0..frame.height).map(|row| frame.center(0, row).1).collect(),
        heights: levels.iter().map(|level| level.unwrap_or(0.0)).collect(),
    };
    let is_water = |column: usize, row: usize| {
        let corners = [(0, 0), (1, 0), (0, 1), (1, 1)];
        corners.iter().all(|(c, r)| levels[frame.index(column + c, row + r)].is_some())
    };
    let mut triangles = sheet.triangles(origin, WATER_MATERIAL, &is_water);
    // Levels of a lake are even; normals of its mesh would only carry the rim's noise.
    for triangle in &mut triangles {
        triangle.face = Face::new([Vec3::Z; 3], WATER_MATERIAL);
    }
    Ok(triangles)
}

/// Gives dry cells next to wet ones the mean level of those neighbours.
fn spread(frame: &Frame, levels: &[Option<f32>]) -> Vec<Option<f32>> {
    let neighbour = |column: usize, row: usize| {
        let columns = column.saturating_sub(1)..(column + 2).min(frame.width);
        let rows = row.saturating_sub(1)..(row + 2).min(frame.height);
        let near = rows.flat_map(move |r| columns.clone().map(move |c| (c, r)));
        let (sum, count) = near
            .filter_map(|(c, r)| levels[frame.index(c, r)])
            .fold((0.0f64, 0u32), |(sum, count), level| (sum + f64::from(level), count + 1));
        (count > 0).then(|| (sum / f64::from(count)) as f32)
    };
    (0..levels.len())
        .into_par_iter()
        .map(|i| levels[i].or_else(|| neighbour(i % frame.width, i / frame.width)))
        .collect()
}

/// What the colour of the ground depends on.
pub(crate) struct Colors {
    /// Soil moisture in [0, 1].
    moisture: Grid,
    /// Part of the ground that is covered by fallen leaves.
    litter: Grid,
    /// Map coordinates of the scene-local origin.
    west: f64,
    south: f64,
}

/// A tree as far as its litter goes: place in map coordinates and crown radius, m.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Crown {
    pub x: f64,
    pub y: f64,
    pub radius: f64,
}

/// Most cells of the litter map; larger terrains get larger cells.
const LITTER_CELLS: f64 = 4e6;

/// Soil moisture where the terrain does not say.
const UNKNOWN_MOISTURE: f32 = 0.35;

impl Colors {
    /// Colours of a terrain under these crowns.
    pub fn new(terrain: &Layers, crowns: &[Crown]) -> Self {
        let frame = terrain.frame;
        let moisture =
            terrain.grid("soil_moisture").unwrap_or_else(|| Grid::filled(frame, UNKNOWN_MOISTURE));
        let (width, height) = (frame.width as f64 * frame.cell, frame.height as f64 * frame.cell);
        let cell = (width * height / LITTER_CELLS).sqrt().max(0.5);
        let litter_frame = Frame {
            width: (width / cell).ceil().max(1.0) as usize,
            height: (height / cell).ceil().max(1.0) as usize,
            cell,
            ..frame
        };
        let mut litter = Grid::filled(litter_frame, 0.0);
        crowns.iter().for_each(|crown| drop_leaves(&mut litter, crown));
        Self { moisture, litter, west: frame.west, south: frame.south }
    }

    /// Diffuse reflectance at a place in scene-local metres.
    ///
    /// Dry soil is sandy, wet soil dark [LD88]; the crowns' litter is
    /// brown; thatch of last year's grass lies between. Noise of wavelengths from metres to
    /// centimetres keeps any of them from looking painted.
    pub fn reflectance(&self, x: f32, y: f32) -> Vec3 {
        const DRY: Vec3 = Vec3::new(0.235, 0.180, 0.115);
        const WET: Vec3 = Vec3::new(0.060, 0.044, 0.030);
        const THATCH: Vec3 = Vec3::new(0.165, 0.150, 0.070);
        const MEADOW: Vec3 = Vec3::new(0.075, 0.105, 0.030);
        let (map_x, map_y) = (self.west + f64::from(x), self.south + f64::from(y));
        let frame = &self.moisture.frame;
        let patchy = cloudy(x / 11.0, y / 11.0, 11);
        let clumps = cloudy(x / 0.9, y / 0.9, 21);
        let crumbs = cloudy(x / 0.11, y / 0.11, 31);
        let grains = value(x / 0.018, y / 0.018, 41);

        let moisture = self.moisture.sample(map_x, map_y) + 0.12 * patchy + 0.06 * clumps;
        let soil = DRY.lerp(WET, smoothstep(0.15, 0.85, moisture));
        let thatch =
            smoothstep(-0.2, 0.5, clumps + 0.4 * patchy) * (1.0 - smoothstep(0.75, 0.95, moisture));
        let open = soil.lerp(THATCH.lerp(MEADOW, smoothstep(0.2, 0.6, moisture)), 0.8 * thatch);
        let cover =
            self.litter.sample(map_x, map_y) * smoothstep(-0.75, 0.1, clumps + 0.4 * crumbs);
        let covered = open.lerp(fallen_leaves(x, y), cover);

        // Beyond the terrain nothing is planted: the ground itself takes the colour of meadows.
        let outside = (frame.west - map_x)
            .max(map_x - frame.east())
            .max(frame.south - map_y)
            .max(map_y - frame.north());
        let meadow = MEADOW.lerp(THATCH, 0.35 + 0.35 * patchy);
        let color = covered.lerp(meadow, smoothstep(-4.0, 6.0, outside as f32));
        (color * (1.0 + 0.22 * crumbs + 0.16 * grains)).clamp(Vec3::ZERO, Vec3::splat(0.9))
    }
}

/// Leaves on the ground: each patch of a few centimetres is a leaf of its own brown.
fn fallen_leaves(x: f32, y: f32) -> Vec3 {
    const LEAVES: [Vec3; 4] = [
        Vec3::new(0.190, 0.120, 0.060),
        Vec3::new(0.120, 0.070, 0.036),
        Vec3::new(0.240, 0.175, 0.085),
        Vec3::new(0.075, 0.048, 0.030),
    ];
    // Bend the lattice, so that no rows of leaves are seen.
    let bend = |seed: u32| 1.6 * value(x / 0.09, y / 0.09, seed);
    let kind = value(x / 0.045 + bend(51), y / 0.045 + bend(52), 53);
    let place = (0.5 + 0.5 * kind).clamp(0.0, 1.0) * 3.0;
    let index = (place as usize).min(2);
    LEAVES[index].lerp(LEAVES[index + 1], smoothstep(0.3, 0.7, place - index as f32))
}

/// Adds the litter under one crown: full below it, thinning out to 1.4 crown radii.
fn drop_leaves(litter: &mut Grid, crown: &Crown) {
    let frame = litter.frame;
    let reach = 1.4 * crown.radius;
    if !(reach > 0.0 && reach < 1e3) {
        return;
    }
    let column = |x: f64| (x - frame.west) / frame.cell - 0.5;
    let row = |y: f64| (frame.north() - y) / frame.cell - 0.5;
    let clip = |value: f64, count: usize| value.clamp(0.0, count as f64) as usize;
    let columns = clip(column(crown.x - reach).ceil(), frame.width)
        ..clip(column(crown.x + reach).floor() + 1.0, frame.width);
    let rows = clip(row(crown.y + reach).ceil(), frame.height)
        ..clip(row(crown.y - reach).floor() + 1.0, frame.height);
    for row in rows {
        for column in columns.clone() {
            let (x, y) = frame.center(column, row);
            let distance = ((x - crown.x).powi(2) + (y - crown.y).powi(2)).sqrt() / crown.radius;
            let fallen = 0.9 * (1.0 - smoothstep(0.7, 1.4, distance as f32));
            let cell = &mut litter.values[frame.index(column, row)];
            *cell = 1.0 - (1.0 - *cell) * (1.0 - fallen);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Crs;

    fn terrain(width: usize, cell: f64, height: impl Fn(f64, f64) -> f32) -> Layers {
        let frame = Frame { width, height: width, cell, west: 1000.0, south: 2000.0 };
        let mut layers =
            Layers { frame, crs: Crs::default(), layers: Default::default(), detail: vec![] };
        let values = (0..frame.len()).map(|i| {
            let (x, y) = frame.center(i % width, i / width);
            height(x, y)
        });
        layers.insert("altitude", "m", "Height.", values.collect());
        layers
    }

    fn with_detail() -> Layers {
        let bumps = |x: f64, y: f64| (x * 1.3).sin() as f32 * 0.4 + (y * 0.9).cos() as f32 * 0.3;
        let mut coarse = terrain(20, 1.0, bumps);
        let mut fine = terrain(32, 0.25, bumps);
        fine.frame = Frame { west: 1005.1, south: 2006.2, ..fine.frame };
        coarse.detail.push(fine);
        coarse
    }

    /// Area covered by triangles inside the terrain's centres, seen from above.
    fn covered(triangles: &[Triangle], low: f32, high: f32) -> f64 {
        let inside = |t: &&Triangle| {
            let middle = (t.corners[0] + t.corners[1] + t.corners[2]) / 3.0;
            middle.x > low && middle.x < high && middle.y > low && middle.y < high
        };
        let area = |t: &Triangle| {
            let (a, b) = (t.corners[1] - t.corners[0], t.corners[2] - t.corners[0]);
            f64::from(a.x * b.y - a.y * b.x) / 2.0
        };
        triangles.iter().filter(inside).map(area).sum()
    }

    #[test]
    fn detail_replaces_coarse_cells_without_gap_or_overlap() {
        let terrain = with_detail();
        let ground = build(&terrain, origin(&terrain).unwrap()).unwrap();
        let area = covered(&ground.triangles, 0.5, 19.5);
        assert!((area - 19.0 * 19.0).abs() < 1e-3, "{area}");
        assert!(ground.triangles.len() > 2 * 19 * 19 + 2 * 24 * 24);
    }

    #[test]
    fn every_edge_inside_the_ground_is_shared_or_lies_on_a_coarser_edge() {
        let terrain = with_detail();
        let ground = build(&terrain, origin(&terrain).unwrap()).unwrap();
        // Rim vertices of the fine mesh interpolate the coarse edge: their height is the mean of
        // its ends, weighted by distance.
        let frame = terrain.frame;
        let coarse = terrain.values("altitude").unwrap();
        let area = owners(&terrain).areas[0].unwrap();
        let (x0, y0) = frame.center(area.west, area.north);
        let rim_x = (x0 - frame.west) as f32;
        let on_rim = ground.triangles.iter().flat_map(|t| t.corners).filter(|p| {
            (p.x - rim_x).abs() < 1e-4 && p.y > 0.4 && f64::from(p.y) < y0 - frame.south - 0.1
        });
        let lowest = origin(&terrain).unwrap()[2];
        for p in on_rim {
            let expected = frame.sample(coarse, x0, frame.south + f64::from(p.y));
            assert!((f64::from(expected) - lowest - f64::from(p.z)).abs() < 1e-4, "{p} {expected}");
        }
    }

    #[test]
    fn a_large_terrain_is_sampled_at_wider_steps_and_keeps_its_shape() {
        let land = terrain(40, 1.0, |x, y| (0.5 * (x - 1000.0) + 0.25 * (y - 2000.0)) as f32);
        let wide = thinned(&land, 120);
        assert_eq!((wide.frame.width, wide.frame.height, wide.frame.cell), (10, 10, 4.0));
        let height = wide.sample("altitude", 1010.0, 2020.0).unwrap();
        assert!((height - 10.0).abs() < 1e-3, "{height}");
        assert_eq!(thinned(&land, 1600).frame, land.frame);
    }

    #[test]
    fn a_lake_is_a_flat_sheet_that_reaches_under_its_shore() {
        let mut bowl = terrain(30, 1.0, |x, y| {
            (((x - 1015.0).powi(2) + (y - 2015.0).powi(2)).sqrt() * 0.2) as f32
        });
        let depth: Vec<f32> =
            bowl.values("altitude").unwrap().iter().map(|h| (1.0 - h).max(0.0)).collect();
        bowl.insert("water_depth", "m", "Depth.", depth);
        let ground = build(&bowl, origin(&bowl).unwrap()).unwrap();
        assert!(!ground.water.is_empty());
        let corners: Vec<Vec3> = ground.water.iter().flat_map(|t| t.corners).collect();
        assert!(corners.iter().all(|p| (p.z - 1.0).abs() < 1e-5));
        let radius = corners.iter().map(|p| (p.x - 15.0).hypot(p.y - 15.0)).fold(0.0, f32::max);
        assert!(radius > 5.0, "the shore is 5 m from the middle, the sheet ends at {radius} m");
    }

    #[test]
    fn wet_ground_is_darker_than_dry_ground_and_litter_is_brown() {
        let mut land = terrain(20, 1.0, |_, _| 0.0);
        let moisture = (0..400).map(|i| if i % 20 < 10 { 0.0 } else { 1.0 }).collect();
        land.insert("soil_moisture", "1", "Wetness.", moisture);
        let mean = |colors: &Colors, west: f32| {
            let points =
                (0..900).map(|i| (west + (i % 30) as f32 * 0.1, 8.0 + (i / 30) as f32 * 0.1));
            points.map(|(x, y)| colors.reflectance(x, y)).sum::<Vec3>() / 900.0
        };
        let bare = Colors::new(&land, &[]);
        assert!(mean(&bare, 2.0).x > 2.0 * mean(&bare, 15.0).x);
        let crown = Crown { x: 1003.5, y: 2009.5, radius: 5.0 };
        let wood = mean(&Colors::new(&land, &[crown]), 2.0);
        assert!(wood.x > wood.y && wood.y > wood.z);
    }

    #[test]
    fn damaged_terrains_are_refused() {
        let mut land = terrain(4, 1.0, |_, _| 0.0);
        land.layers.get_mut("altitude").unwrap().values[5] = f32::NAN;
        let problem =
            origin(&land).and_then(|origin| build(&land, origin).map(|_| ())).unwrap_err();
        assert!(problem.to_string().contains("column 1, row 1"), "{problem}");
        land.layers.clear();
        assert!(matches!(origin(&land), Err(Error::MissingLayer("altitude"))));
    }
}
