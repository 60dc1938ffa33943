//! Maps: shaded relief with water and contours, and what stands on it.

use super::sketch::Sketch;
use rayon::prelude::*;
use std::collections::BTreeMap;
use weald_contract::{Frame, Grid, Layers, Population, View};

/// Longest side of a map, pixels.
const MAX_SIDE: usize = 1024;
/// Shorter maps are enlarged to at least this long side.
const MIN_SIDE: usize = 512;
/// Depth at which water looks half as dark as it can, m.
const WATER_DEPTH_SCALE: f32 = 0.7;
/// Colour of cells whose ground is not known.
const NO_GROUND: [u8; 3] = [236, 236, 236];

/// The light of shaded maps comes from the north-west, 45 degrees high [Imhof65].
const LIGHT: [f32; 3] = [-0.5, 0.5, std::f32::consts::FRAC_1_SQRT_2];

/// A map's way from map coordinates to pixels, and back.
#[derive(Clone, Copy, Debug)]
pub struct MapScale {
    frame: Frame,
    /// Pixels a metre.
    pixels_per_metre: f64,
    width: usize,
    height: usize,
}

impl MapScale {
    /// A map of the whole frame with sides between the limits above.
    pub fn of(frame: Frame) -> Self {
        Self::with_side(frame, frame.width.max(frame.height).clamp(MIN_SIDE, MAX_SIDE))
    }

    /// A map of the whole frame whose longer side has so many pixels.
    pub fn with_side(frame: Frame, side: usize) -> Self {
        let long = frame.width.max(frame.height).max(1);
        let scale = side as f64 / long as f64;
        let pixels = |cells: usize| ((cells as f64 * scale).round() as usize).max(1);
        Self {
            frame,
            pixels_per_metre: scale / frame.cell,
            width: pixels(frame.width),
            height: pixels(frame.height),
        }
    }

    /// Pixels across and down.
    pub fn size(&self) -> [usize; 2] {
        [self.width, self.height]
    }

    /// Pixels to a metre.
    pub fn pixels_per_metre(&self) -> f64 {
        self.pixels_per_metre
    }

    /// Pixel of a point in map coordinates.
    pub fn pixel(&self, x: f64, y: f64) -> [f64; 2] {
        [
            (x - self.frame.west) * self.pixels_per_metre,
            (self.frame.north() - y) * self.pixels_per_metre,
        ]
    }

    /// Map coordinates of the middle of a pixel.
    pub fn point(&self, column: usize, row: usize) -> (f64, f64) {
        (
            self.frame.west + (column as f64 + 0.5) / self.pixels_per_metre,
            self.frame.north() - (row as f64 + 0.5) / self.pixels_per_metre,
        )
    }
}

/// Draws a terrain: altitude tints, hill shading, contours, water by depth, and a scale.
pub fn draw_relief(terrain: &Layers) -> Sketch {
    draw_relief_on(terrain, &MapScale::of(terrain.frame))
}

/// The same on a map of another size.
pub fn draw_relief_on(terrain: &Layers, map: &MapScale) -> Sketch {
    let (mut sketch, interval) = draw_ground(terrain, map);
    scale_bar(&mut sketch, map, interval);
    sketch
}

/// The relief alone, with the interval of its contours.
fn draw_ground(terrain: &Layers, map: &MapScale) -> (Sketch, f32) {
    let altitudes = terrain.values("altitude").unwrap_or(&[]);
    let (low, high) = range(altitudes);
    let interval = contour_interval(high - low);
    let mut sketch = Sketch::filled(map.width, map.height, [0; 3]);
    sketch.rgb.par_chunks_mut(3 * map.width).enumerate().for_each(|(row, line)| {
        for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
            let (x, y) = map.point(column, row);
            pixel.copy_from_slice(&relief_color(terrain, map, x, y, (low, high), interval));
        }
    });
    (sketch, interval)
}

/// Colour of one point of a relief.
fn relief_color(
    terrain: &Layers,
    map: &MapScale,
    x: f64,
    y: f64,
    (low, high): (f32, f32),
    interval: f32,
) -> [u8; 3] {
    let altitude = |x, y| terrain.sample("altitude", x, y).unwrap_or(0.0);
    let step = (1.0 / map.pixels_per_metre).max(terrain.frame.cell);
    let here = altitude(x, y);
    if here.is_nan() {
        return NO_GROUND;
    }
    // Beside a hole the ground is drawn as if it went on level.
    let rise = |a: f32, b: f32| {
        let known = |z: f32| if z.is_nan() { here } else { z };
        (known(a) - known(b)) / (2.0 * step) as f32
    };
    let east = rise(altitude(x + step, y), altitude(x - step, y));
    let north = rise(altitude(x, y + step), altitude(x, y - step));
    // Prairie relief is gentle: slopes are drawn three times as steep as they are.
    let (dx, dy) = (-3.0 * east, -3.0 * north);
    let length = (dx * dx + dy * dy + 1.0).sqrt();
    let shade = ((dx * LIGHT[0] + dy * LIGHT[1] + LIGHT[2]) / length).max(0.0) / LIGHT[2];

    let t = ((here - low) / (high - low).max(1e-6)).clamp(0.0, 1.0);
    let mut color = tint(t).map(|channel| channel * (0.35 + 0.65 * shade));
    if (here / interval).floor() != ((here + contour_step(east, north, map)) / interval).floor() {
        color = color.map(|channel| channel * 0.82);
    }
    let depth = terrain.sample("water_depth", x, y).unwrap_or(0.0);
    if depth > 0.005 {
        let deep = depth / (depth + WATER_DEPTH_SCALE);
        let water = mix([0.55, 0.75, 0.85], [0.08, 0.25, 0.45], deep);
        color = mix(color, water, 0.55 + 0.4 * deep);
    }
    color.map(|channel| (channel.clamp(0.0, 1.0) * 255.0).round() as u8)
}

/// How much the ground rises over a pixel: wide enough that a contour is a closed line.
fn contour_step(east: f32, north: f32, map: &MapScale) -> f32 {
    (east.abs().max(north.abs())) / map.pixels_per_metre as f32
}

/// Tints from wet lowland to dry height.
fn tint(t: f32) -> [f32; 3] {
    const STOPS: [[f32; 3]; 4] =
        [[0.52, 0.66, 0.44], [0.72, 0.78, 0.52], [0.86, 0.80, 0.60], [0.93, 0.90, 0.82]];
    let scaled = t * 3.0;
    let index = (scaled as usize).min(2);
    mix(STOPS[index], STOPS[index + 1], scaled - index as f32)
}

fn mix(a: [f32; 3], b: [f32; 3], t: f32) -> [f32; 3] {
    [0, 1, 2].map(|i| a[i] + (b[i] - a[i]) * t)
}

/// Smallest and largest finite value.
fn range(values: &[f32]) -> (f32, f32) {
    let finite = values.iter().copied().filter(|value| value.is_finite());
    let (low, high) = finite.fold((f32::INFINITY, f32::NEG_INFINITY), |(low, high), value| {
        (low.min(value), high.max(value))
    });
    if low <= high { (low, high) } else { (0.0, 0.0) }
}

/// A round interval that gives about a dozen contours.
fn contour_interval(range: f32) -> f32 {
    let rough = f64::from(range.max(1e-3)) / 12.0;
    let decade = 10f64.powf(rough.log10().floor());
    let step = [1.0, 2.0, 5.0, 10.0].into_iter().find(|step| step * decade >= rough);
    (step.unwrap_or(10.0) * decade) as f32
}

/// A bar of a round length, and the contour interval, in the lower left corner.
fn scale_bar(sketch: &mut Sketch, map: &MapScale, interval: f32) {
    let metres =
        f64::from(contour_interval((map.width as f64 / map.pixels_per_metre) as f32 * 2.0));
    let length = (metres * map.pixels_per_metre).round() as i64;
    let (x, y) = (10, sketch.height as i64 - 26);
    let text = format!("{metres} M, CONTOURS {interval} M");
    let width = length.max(4 * 2 * text.len() as i64) + 8;
    sketch.rectangle(x - 4, y - 4, width, 26, [255; 3], 0.7);
    sketch.rectangle(x, y, length, 3, [20; 3], 1.0);
    sketch.text(x, y + 7, &text, 2, [20; 3]);
}

/// Draws plants as discs of their crowns' size over the relief, with a legend by colour.
///
/// Without a terrain the plants stand on a plain of their own extent. Lower plants are drawn
/// first, so that trees cover grass; `colors` is indexed as `population.species`.
pub fn draw_population(
    population: &Population,
    terrain: Option<&Layers>,
    colors: &[[u8; 3]],
) -> Sketch {
    let (map, mut sketch) = match terrain {
        Some(terrain) => {
            let map = MapScale::of(terrain.frame);
            let (mut relief, interval) = draw_ground(terrain, &map);
            // Faded, so that dots stand out.
            relief.rgb.iter_mut().for_each(|channel| *channel = 128 + *channel / 2);
            scale_bar(&mut relief, &map, interval);
            (map, relief)
        }
        None => {
            let map = MapScale::of(extent(population));
            (map, Sketch::filled(map.width, map.height, [245, 243, 236]))
        }
    };
    let mut order: Vec<usize> = (0..population.len()).collect();
    order.sort_by(|&a, &b| {
        let height = |i: usize| population.plants[i].height;
        height(a).total_cmp(&height(b)).then(a.cmp(&b))
    });
    for plant in order.into_iter().map(|index| &population.plants[index]) {
        let [x, y] = map.pixel(plant.x, plant.y);
        let radius = f64::from(plant.radius) * map.pixels_per_metre;
        let color = colors.get(usize::from(plant.species)).copied().unwrap_or([60, 120, 60]);
        // Small herbs must still be seen, yet a meadow of them must not hide the map.
        let alpha = if radius < 0.7 { 0.35 } else { 0.8 };
        sketch.disc(x, y, radius, color, alpha);
    }
    legend(&mut sketch, population, colors);
    sketch
}

/// A frame around all plants, a tenth wider; one metre when there is none.
fn extent(population: &Population) -> Frame {
    let finite =
        population.plants.iter().filter(|plant| plant.x.is_finite() && plant.y.is_finite());
    let mut bounds = [f64::INFINITY, f64::INFINITY, f64::NEG_INFINITY, f64::NEG_INFINITY];
    for plant in finite {
        bounds = [
            bounds[0].min(plant.x),
            bounds[1].min(plant.y),
            bounds[2].max(plant.x),
            bounds[3].max(plant.y),
        ];
    }
    if bounds[0] > bounds[2] {
        bounds = [0.0, 0.0, 1.0, 1.0];
    }
    let side = (bounds[2] - bounds[0]).max(bounds[3] - bounds[1]).max(1.0) * 1.1;
    let cell = side / MIN_SIDE as f64;
    let middle = [(bounds[0] + bounds[2]) / 2.0, (bounds[1] + bounds[3]) / 2.0];
    Frame {
        width: MIN_SIDE,
        height: MIN_SIDE,
        cell,
        west: middle[0] - side / 2.0,
        south: middle[1] - side / 2.0,
    }
}

/// Names, colours and numbers in the upper left corner.
fn legend(sketch: &mut Sketch, population: &Population, colors: &[[u8; 3]]) {
    let counts = population.counts();
    let lines: Vec<String> = population
        .species
        .iter()
        .zip(&counts)
        .map(|(name, count)| format!("{name} {count}"))
        .collect();
    let width = lines.iter().map(|line| line.chars().count()).max().unwrap_or(0) as i64 * 8 + 30;
    sketch.rectangle(6, 6, width, 16 * lines.len() as i64 + 6, [255; 3], 0.75);
    for (i, line) in (0i64..).zip(&lines) {
        let color = colors.get(i as usize).copied().unwrap_or([60, 120, 60]);
        sketch.disc(17.0, 17.0 + 16.0 * i as f64, 5.0, color, 1.0);
        sketch.text(28, 12 + 16 * i, line, 2, [20; 3]);
    }
}

/// Draws where a view stands, what it looks at, and the wedge that it sees.
pub fn draw_view(sketch: &mut Sketch, map: &MapScale, view: &View) {
    let Frame { west, south, .. } = map.frame;
    let place = |at: [f64; 2]| map.pixel(west + at[0], south + at[1]);
    let (eye, target) = (place(view.stand_at), place(view.look_at));
    let along = (target[1] - eye[1]).atan2(target[0] - eye[0]);
    let reach = (sketch.width + sketch.height) as f64;
    for side in [-0.5, 0.5] {
        let angle = along + side * view.fov_deg.to_radians();
        let far = [eye[0] + reach * angle.cos(), eye[1] + reach * angle.sin()];
        sketch.line(eye, far, [190, 30, 30], 0.8);
    }
    sketch.line(eye, target, [190, 30, 30], 0.35);
    sketch.disc(eye[0], eye[1], 5.0, [190, 30, 30], 1.0);
    sketch.disc(target[0], target[1], 3.0, [190, 30, 30], 0.7);
    sketch.text(eye[0] as i64 + 8, eye[1] as i64 - 5, &view.name, 2, [150, 20, 20]);
}

/// Draws one band of values from dark (lowest) to light (highest); no data is red.
pub fn draw_values(grid: &Grid) -> Sketch {
    let map = MapScale::of(grid.frame);
    let (low, high) = range(&grid.values);
    let mut sketch = Sketch::filled(map.width, map.height, [0; 3]);
    for row in 0..map.height {
        for column in 0..map.width {
            let (x, y) = map.point(column, row);
            let value = grid.nearest(x, y).unwrap_or(f32::NAN);
            let t = (value - low) / (high - low).max(1e-12);
            let color = if value.is_finite() { viridis(t) } else { [200, 40, 40] };
            sketch.blend(column as i64, row as i64, color, 1.0);
        }
    }
    sketch
}

/// Perceptually even colours for values, five stops of the map "viridis" [SmithWalt15].
fn viridis(t: f32) -> [u8; 3] {
    const STOPS: [[f32; 3]; 5] = [
        [68.0, 1.0, 84.0],
        [59.0, 82.0, 139.0],
        [33.0, 145.0, 140.0],
        [94.0, 201.0, 98.0],
        [253.0, 231.0, 37.0],
    ];
    let scaled = t.clamp(0.0, 1.0) * 4.0;
    let index = (scaled as usize).min(3);
    mix(STOPS[index], STOPS[index + 1], scaled - index as f32).map(|channel| channel.round() as u8)
}

/// Colours by species for populations whose species files are at hand.
pub fn colors_by_name(names: &[String], known: &BTreeMap<String, [u32; 3]>) -> Vec<[u8; 3]> {
    let color = |(index, name): (usize, &String)| match known.get(name) {
        Some(color) => color.map(|channel| channel.min(255) as u8),
        None => fallback_color(index),
    };
    names.iter().enumerate().map(color).collect()
}

/// Well separated hues for species without a colour: the golden angle around the wheel.
fn fallback_color(index: usize) -> [u8; 3] {
    let hue = (index as f32 * 0.618_034).fract() * 6.0;
    let wave = |shift: f32| ((hue + shift).rem_euclid(6.0) - 3.0).abs() - 1.0;
    [wave(0.0), wave(4.0), wave(2.0)].map(|level| (60.0 + 150.0 * level.clamp(0.0, 1.0)) as u8)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn slope() -> Layers {
        let frame = Frame { width: 64, height: 32, cell: 1.0, west: 1000.0, south: 2000.0 };
        let ground = Grid::from_fn(frame, |x, _| (x - 1000.0) as f32 * 0.1);
        let mut layers =
            Layers { frame, crs: Default::default(), layers: BTreeMap::new(), detail: vec![] };
        layers.insert("altitude", "m", "ground", ground.values);
        layers
    }

    #[test]
    fn a_map_keeps_the_shape_of_its_frame() {
        let sketch = draw_relief(&slope());
        assert_eq!((sketch.width, sketch.height), (512, 256));
    }

    #[test]
    fn slopes_towards_the_light_are_brighter() {
        let mut east_up = slope();
        let west_up = Grid::from_fn(east_up.frame, |x, _| (1064.0 - x) as f32 * 0.1);
        // The light stands in the north-west: ground that falls to the west faces it.
        let brightness =
            |layers: &Layers| draw_relief(layers).rgb.iter().map(|&v| u64::from(v)).sum::<u64>();
        let facing = brightness(&east_up);
        east_up.insert("altitude", "m", "ground", west_up.values);
        assert!(facing > brightness(&east_up));
    }

    #[test]
    fn contours_have_round_intervals_and_a_dozen_lines() {
        for (range, interval) in
            [(12.0, 1.0), (13.0, 2.0), (5.0, 0.5), (100.0, 10.0), (0.0, 0.0001)]
        {
            let found = contour_interval(range);
            assert!((found - interval).abs() < 1e-6 * interval.max(1.0), "{range}: {found}");
        }
    }

    #[test]
    fn a_dot_lies_where_its_plant_stands() {
        let map = MapScale::of(slope().frame);
        assert_eq!(map.pixel(1000.0, 2032.0), [0.0, 0.0]);
        assert_eq!(map.pixel(1064.0, 2000.0), [512.0, 256.0]);
    }
}
