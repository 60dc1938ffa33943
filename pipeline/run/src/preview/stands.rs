//! Stands at chosen steps, as [Deussen98] shows them: a plot, and the field with its circles.
//!
//! Of one species, the plot is size over density and plants are green, red where they are dominated
//! and yellow where old. Of several, it is cover over time; plants have the colour of their species,
//! and a red rim where they are dominated, a yellow one where old.

use super::Sketch;
use crate::analysis::plot;
use std::collections::BTreeSet;
use weald_analyze::figure::{Figure, Series, Style};
use weald_contract::{Frame, Plant, State};
use weald_ecosim::{Snapshot, SummaryRow};

/// Pixels along a side of the field.
const SIDE: usize = 560;
/// Pixels between pictures.
const GAP: usize = 24;
/// Steps from one dot of the plot to the next.
const DOT_STEPS: u32 = 10;
/// Plants that are shown, about, of a number between the most and the fewest of the snapshots; all
/// show the same ground.
const SHOWN: f64 = 300.0;
/// The same of crowns, of stands of several species.
const SHOWN_CROWNS: f64 = 150.0;
/// Fields beside each other.
const MOST_COLUMNS: usize = 4;
/// Part of the first density below which a stand has forgotten its first sizes.
const FORGOTTEN: f64 = 0.1;
/// Units of the letters, pixels.
const LETTER: i64 = 3;

const PAPER: [u8; 3] = [255, 255, 255];
const GROUND: [u8; 3] = [246, 243, 235];
const INK: [u8; 3] = [40, 40, 40];

/// Returns the colour of a state, and of the rim of its circles.
fn state_colors(state: State) -> [[u8; 3]; 2] {
    match state {
        State::Free => [[104, 168, 88], [44, 92, 40]],
        State::Dominated => [[214, 84, 70], [128, 30, 24]],
        State::Old => [[240, 204, 70], [150, 116, 10]],
    }
}

/// Draws the plot above the snapshots; `names` and `colors` are those of the rows' species.
pub fn draw_stand(
    rows: &[SummaryRow],
    snapshots: &[Snapshot],
    frame: &Frame,
    names: &[String],
    colors: &[[u8; 3]],
) -> Sketch {
    let kinds: BTreeSet<u16> = rows.iter().map(|row| row.species).collect();
    if kinds.len() == 1 {
        let window = Window::of_equals(snapshots, frame);
        return sheet(&figure(rows, frame), snapshots, &window, &|plant| state_colors(plant.state));
    }
    let paint = |plant: &Plant| {
        let color = colors.get(usize::from(plant.species)).copied().unwrap_or(INK);
        let rim = match plant.state {
            State::Free => color.map(|channel| channel / 2),
            state => state_colors(state)[0],
        };
        [color, rim]
    };
    let window = Window::of_unequals(snapshots, frame);
    sheet(&cover_figure(rows, &kinds, names, colors), snapshots, &window, &paint)
}

/// Lays out the plot and, below it, the fields in rows.
fn sheet(
    figure: &Figure,
    snapshots: &[Snapshot],
    window: &Window,
    paint: &dyn Fn(&Plant) -> [[u8; 3]; 2],
) -> Sketch {
    let plot = plot::draw(figure);
    let columns = snapshots.len().clamp(1, MOST_COLUMNS);
    let lines = snapshots.len().div_ceil(columns);
    let width = plot.width.max(columns * SIDE + (columns + 1) * GAP);
    let line = SIDE + 2 * GAP;
    let mut sheet = Sketch::filled(width, plot.height + GAP + lines * line, PAPER);
    sheet.paste(&plot, ((width - plot.width) / 2) as i64, 0);
    for (index, snapshot) in snapshots.iter().enumerate() {
        let left = (GAP + index % columns * (SIDE + GAP)) as i64;
        let top = plot.height + GAP + index / columns * line;
        sheet.paste(&window.draw(&snapshot.population.plants, paint), left, top as i64);
        let title = format!("step {}  {} plants", snapshot.step, snapshot.population.len());
        sheet.text(left, (top + SIDE + GAP / 2) as i64, &title, LETTER, INK);
    }
    sheet
}

/// The square of ground that all snapshots show.
struct Window {
    west: f64,
    south: f64,
    side: f64,
}

impl Window {
    /// Shows [`SHOWN`] plants of a stand of equals, at its corner: it looks the same everywhere.
    fn of_equals(snapshots: &[Snapshot], frame: &Frame) -> Self {
        let side = side_of(SHOWN, snapshots.iter().map(|s| s.population.len() as f64), frame);
        Self { west: frame.west, south: frame.south, side }
    }

    /// Shows as many crowns that count in the middle of the ground: seedlings below tall trees
    /// would narrow the view to one of them, so a crown counts by its share of the cover,
    /// (Σ r²)² / Σ r⁴ being the number of equals with the same shares.
    fn of_unequals(snapshots: &[Snapshot], frame: &Frame) -> Self {
        let count = |snapshot: &Snapshot| {
            let radii = snapshot.population.plants.iter().map(|plant| f64::from(plant.radius));
            let sum = |power| radii.clone().map(|radius| radius.powi(power)).sum::<f64>();
            let fourth = sum(4);
            if fourth > 0.0 { sum(2).powi(2) / fourth } else { snapshot.population.len() as f64 }
        };
        let side = side_of(SHOWN_CROWNS, snapshots.iter().map(count), frame);
        let [x, y] = [frame.west + frame.east(), frame.south + frame.north()];
        Self { west: (x - side) / 2.0, south: (y - side) / 2.0, side }
    }

    fn draw(&self, plants: &[Plant], paint: &dyn Fn(&Plant) -> [[u8; 3]; 2]) -> Sketch {
        let mut sketch = Sketch::filled(SIDE, SIDE, GROUND);
        let scale = SIDE as f64 / self.side;
        // The dominated on top: they are the smaller ones, within the circles of others.
        let mut order: Vec<&Plant> = plants.iter().collect();
        order.sort_by(|a, b| b.radius.total_cmp(&a.radius).then(a.id.cmp(&b.id)));
        for plant in order {
            let x = (plant.x - self.west) * scale;
            let y = SIDE as f64 - (plant.y - self.south) * scale;
            let radius = f64::from(plant.radius) * scale;
            let [fill, rim] = paint(plant);
            if radius > 2.5 {
                sketch.disc(x, y, radius, rim, 1.0);
                sketch.disc(x, y, radius - 1.5, fill, 1.0);
            } else {
                sketch.disc(x, y, radius, fill, 1.0);
            }
        }
        sketch
    }
}

/// Returns the side of a square with about so many plants, where their number lies between the
/// most and the fewest of the snapshots, m.
fn side_of(shown: f64, counts: impl Iterator<Item = f64> + Clone, frame: &Frame) -> f64 {
    let [width, height] = [frame.east() - frame.west, frame.north() - frame.south];
    let (most, fewest) = (counts.clone().fold(1.0, f64::max), counts.fold(f64::INFINITY, f64::min));
    let side = (width * height * shown / (most * fewest.max(1.0)).sqrt()).sqrt();
    side.min(width).min(height)
}

/// The plot of cover over time, a line a species.
fn cover_figure(
    rows: &[SummaryRow],
    kinds: &BTreeSet<u16>,
    names: &[String],
    colors: &[[u8; 3]],
) -> Figure {
    let line = |&species: &u16| {
        let own = rows.iter().filter(|row| row.species == species);
        Series {
            label: names.get(usize::from(species)).map_or("", String::as_str).replace('_', " "),
            points: own.map(|row| [f64::from(row.step), f64::from(row.cover)]).collect(),
            color: colors.get(usize::from(species)).copied().unwrap_or(INK),
            style: Style::Line,
        }
    };
    Figure {
        title: "crowns; rims below: red dominated, yellow old".into(),
        x_label: "step".into(),
        y_label: "cover by crowns".into(),
        bands: Vec::new(),
        series: kinds.iter().map(line).collect(),
    }
}

/// The plot of mean area over density, with every tenth step a dot.
fn figure(rows: &[SummaryRow], frame: &Frame) -> Figure {
    let area = frame.len() as f64 * frame.cell_area();
    let alive = rows.iter().filter(|row| row.alive > 0);
    let state = |row: &SummaryRow| {
        let density = row.alive as f64 / area;
        [libm::log10(density), libm::log10(f64::from(row.cover) / density)]
    };
    let dots = alive.clone().filter(|row| row.step % DOT_STEPS == 0).map(state).collect();
    let first = rows.first().map_or(0.0, |row| row.alive as f64);
    // Deaths of age leave the line: they thin the stand although nobody stands over anybody.
    let late: Vec<[f64; 2]> = alive
        .take_while(|row| row.old == 0)
        .filter(|row| (row.alive as f64) < FORGOTTEN * first)
        .map(state)
        .collect();
    let mut series = vec![Series {
        label: "every tenth step".into(),
        points: dots,
        color: INK,
        style: Style::Dots,
    }];
    if let (Some(slope), Some(from), Some(to)) = (slope(&late), late.first(), late.last()) {
        let line = |x: f64| [x, to[1] + slope * (x - to[0])];
        series.push(Series {
            label: format!("slope {slope:.3}"),
            points: vec![line(from[0]), line(to[0])],
            color: [200, 70, 50],
            style: Style::Line,
        });
    }
    Figure {
        title: "self-thinning".into(),
        x_label: "log10 density, plants per m2".into(),
        y_label: "log10 mean area, m2".into(),
        bands: Vec::new(),
        series,
    }
}

/// Least-squares slope; `None` through fewer than two different points.
fn slope(points: &[[f64; 2]]) -> Option<f64> {
    let count = points.len() as f64;
    let mean = |axis: usize| points.iter().map(|point| point[axis]).sum::<f64>() / count;
    let (x, y) = (mean(0), mean(1));
    let across: f64 = points.iter().map(|point| (point[0] - x).powi(2)).sum();
    let along: f64 = points.iter().map(|point| (point[0] - x) * (point[1] - y)).sum();
    (across > 0.0).then(|| along / across)
}
