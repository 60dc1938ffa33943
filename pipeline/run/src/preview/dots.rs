//! The dot diagram: every plant a dot in its species' colour, as large as its crown, over the
//! densities from which plants were made [Deussen98].

use super::relief::MapScale;
use super::sketch::Sketch;
use rayon::prelude::*;
use weald_contract::{Frame, Image, Population};

/// Longer side of the ground, pixels.
const SIDE: usize = 1200;
/// Paper where nothing is wanted.
const PAPER: [u8; 3] = [250, 249, 245];
/// How much of a species' colour the ground takes where it is wanted most.
const TINT: f32 = 0.6;
/// Least radius of a dot, pixels: a seedling is still seen.
const LEAST_RADIUS: f64 = 1.6;
/// Height of a line of the legend, pixels.
const LINE: i64 = 20;
/// Width of an entry of the legend, pixels.
const ENTRY: i64 = 240;

/// A density as it was painted, for one species.
#[derive(Clone, Copy, Debug)]
pub struct Painted<'a> {
    /// The image.
    pub image: &'a Image,
    /// Whether black is dense in it.
    pub invert: bool,
    /// Colour of the species.
    pub color: [u8; 3],
}

/// Draws plants as dots over densities; a legend with numbers stands below the ground.
///
/// Lower plants are drawn first. Species with `false` in `is_drawn`, such as patches of grass that
/// would hide all others, stand in the legend only. `colors` and `is_drawn` are indexed as
/// `population.species`.
pub fn draw_dots(
    population: &Population,
    ground: Frame,
    densities: &[Painted<'_>],
    colors: &[[u8; 3]],
    is_drawn: &[bool],
) -> Sketch {
    let map = MapScale::with_side(ground, SIDE);
    let [width, height] = map.size();
    let columns = (width as i64 / ENTRY).max(1);
    let lines = (population.species.len() as i64 + columns - 1) / columns;
    let legend_height = (lines * LINE + 16) as usize;
    let mut sketch = Sketch::filled(width, height + legend_height, PAPER);
    tint(&mut sketch, &map, ground, densities);
    let is_drawn = |species: u16| is_drawn.get(usize::from(species)).copied().unwrap_or(true);
    let color_of = |species: usize| colors.get(species).copied().unwrap_or([60, 120, 60]);
    let mut order: Vec<usize> =
        (0..population.len()).filter(|&i| is_drawn(population.plants[i].species)).collect();
    order.sort_by(|&a, &b| {
        let height = |i: usize| population.plants[i].height;
        height(a).total_cmp(&height(b)).then(a.cmp(&b))
    });
    for plant in order.into_iter().map(|index| &population.plants[index]) {
        let radius = (f64::from(plant.radius) * map.pixels_per_metre()).max(LEAST_RADIUS);
        dot(&mut sketch, map.pixel(plant.x, plant.y), radius, color_of(usize::from(plant.species)));
    }
    // What reaches over the ground's edge must not stand behind the legend.
    let paper = [0, height as i64, width as i64, legend_height as i64];
    sketch.rectangle(paper[0], paper[1], paper[2], paper[3], PAPER, 1.0);
    let counts = population.counts();
    for (index, name) in population.species.iter().enumerate() {
        let (column, line) = (index as i64 % columns, index as i64 / columns);
        let (x, y) = (8 + column * ENTRY, height as i64 + 10 + line * LINE);
        dot(&mut sketch, [x as f64 + 6.0, y as f64 + 6.0], 6.0, color_of(index));
        let hidden = if is_drawn(index as u16) { "" } else { ", NOT DRAWN" };
        sketch.text(x + 18, y + 1, &format!("{name} {}{hidden}", counts[index]), 2, [30; 3]);
    }
    sketch
}

/// A disc with a rim, through which a wide one lets see what stands below it.
fn dot(sketch: &mut Sketch, [x, y]: [f64; 2], radius: f64, color: [u8; 3]) {
    let rim = color.map(|channel| channel / 3);
    let fill = if radius > 12.0 { 0.45 } else { 1.0 };
    if fill == 1.0 {
        sketch.disc(x, y, radius, rim, 0.9);
        sketch.disc(x, y, radius - 1.0, color, 1.0);
        return;
    }
    sketch.disc(x, y, radius, color, fill);
    let corners = (radius * 2.0).ceil() as usize;
    let on_rim = |corner: usize| {
        let angle = corner as f64 / corners as f64 * std::f64::consts::TAU;
        [x + radius * angle.cos(), y + radius * angle.sin()]
    };
    (0..corners).for_each(|corner| sketch.line(on_rim(corner), on_rim(corner + 1), rim, 0.7));
    sketch.disc(x, y, 2.5, rim, 1.0);
}

/// Gives the ground the colours of what is wanted there.
fn tint(sketch: &mut Sketch, map: &MapScale, ground: Frame, densities: &[Painted<'_>]) {
    let (width, rows) = (sketch.width, map.size()[1]);
    let most: Vec<f32> = densities.iter().map(greatest).collect();
    sketch.rgb.par_chunks_mut(3 * width).take(rows).enumerate().for_each(|(row, line)| {
        for (column, pixel) in line.chunks_exact_mut(3).enumerate() {
            let (x, y) = map.point(column, row);
            for (painted, most) in densities.iter().zip(&most).filter(|(_, most)| **most > 0.0) {
                let share = TINT * painted.at(x, y, ground) / most;
                for (channel, color) in pixel.iter_mut().zip(painted.color) {
                    let mixed = f32::from(*channel) * (1.0 - share) + f32::from(color) * share;
                    *channel = mixed.round() as u8;
                }
            }
        }
    });
}

fn greatest(painted: &Painted<'_>) -> f32 {
    let values = painted.image.values.iter().map(|value| painted.wanted(*value));
    values.fold(0.0, f32::max)
}

impl Painted<'_> {
    fn wanted(&self, value: f32) -> f32 {
        let value = if self.invert { 1.0 - value } else { value };
        value.max(0.0)
    }

    /// What is painted at a place in map coordinates; 0 outside the image.
    fn at(&self, x: f64, y: f64, ground: Frame) -> f32 {
        let frame = self.image.frame.unwrap_or(ground);
        let along = (x - frame.west) / (frame.east() - frame.west);
        let down = (frame.north() - y) / (frame.north() - frame.south);
        if !((0.0..1.0).contains(&along) && (0.0..1.0).contains(&down)) {
            return 0.0;
        }
        let column = (along * self.image.width as f64) as usize;
        let row = (down * self.image.height as f64) as usize;
        self.image.values.get(row * self.image.width + column).map_or(0.0, |v| self.wanted(*v))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Plant, State};

    #[test]
    fn dots_have_their_colour_and_size_over_the_paint() {
        let ground = Frame { width: 12, height: 12, cell: 1.0, west: 100.0, south: 200.0 };
        let plant = |id: u64, species: u16, x: f64, radius: f32| Plant {
            id,
            species,
            state: State::Free,
            x,
            y: 206.0,
            z: 0.0,
            radius,
            height: 1.0,
            age: 1.0,
            vigor: 1.0,
            yaw: 0.0,
            lean: 0.0,
            lean_azimuth: 0.0,
        };
        let population = Population {
            species: vec!["rose".into(), "grass".into()],
            plants: vec![plant(1, 0, 103.0, 0.1), plant(2, 1, 106.0, 1.0)],
            ..Population::default()
        };
        // Painted in the west half only, black on white.
        let values = (0..16).map(|i| if i % 4 < 2 { 0.0 } else { 1.0 }).collect();
        let image = Image { width: 4, height: 4, values, is_float: false, frame: None };
        let painted = Painted { image: &image, invert: true, color: [200, 0, 0] };
        let colors = [[200, 0, 0], [0, 200, 0]];
        let sketch = draw_dots(&population, ground, &[painted], &colors, &[true, false]);
        assert_eq!((sketch.width, sketch.height > 1200), (1200, true));
        // 100 pixels a metre.
        assert_eq!(sketch.get(300, 600), Some([200, 0, 0]));
        assert_eq!(sketch.get(600, 600), Some(PAPER));
        assert_eq!(sketch.get(900, 300), Some(PAPER));
        let [red, green, _] = sketch.get(200, 300).unwrap();
        assert!(red > green + 80, "tinted");
        assert_eq!(sketch.get(315, 600), sketch.get(200, 300), "the dot ends at its radius");
    }
}
