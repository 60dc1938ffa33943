//! A stand that thins, as [Deussen98] shows it: the plot of size over density, and the field at
//! chosen steps with its plants green, red where they are dominated and yellow where old.

use super::Sketch;
use crate::analysis::plot;
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
/// Part of the first density below which a stand has forgotten its first sizes.
const FORGOTTEN: f64 = 0.1;
/// Units of the letters, pixels.
const LETTER: i64 = 3;

const PAPER: [u8; 3] = [255, 255, 255];
const GROUND: [u8; 3] = [246, 243, 235];
const INK: [u8; 3] = [40, 40, 40];

/// Returns the colour of a state, and of the rim of its circles.
fn colors(state: State) -> [[u8; 3]; 2] {
    match state {
        State::Free => [[104, 168, 88], [44, 92, 40]],
        State::Dominated => [[214, 84, 70], [128, 30, 24]],
        State::Old => [[240, 204, 70], [150, 116, 10]],
    }
}

/// Draws the plot above the snapshots.
pub fn draw_stand(rows: &[SummaryRow], snapshots: &[Snapshot], frame: &Frame) -> Sketch {
    let plot = plot::draw(&figure(rows, frame));
    let count = snapshots.len().max(1);
    let width = plot.width.max(count * SIDE + (count + 1) * GAP);
    let mut sheet = Sketch::filled(width, plot.height + SIDE + 3 * GAP, PAPER);
    sheet.paste(&plot, ((width - plot.width) / 2) as i64, 0);
    let side = side_shown(snapshots, frame);
    for (column, snapshot) in snapshots.iter().enumerate() {
        let left = (GAP + column * (SIDE + GAP)) as i64;
        let top = plot.height + GAP;
        sheet.paste(&draw_field(&snapshot.population.plants, frame, side), left, top as i64);
        let title = format!("step {}  {} plants", snapshot.step, snapshot.population.len());
        sheet.text(left, (top + SIDE + GAP / 2) as i64, &title, LETTER, INK);
    }
    sheet
}

/// Returns the side of the square that all snapshots show, m.
fn side_shown(snapshots: &[Snapshot], frame: &Frame) -> f64 {
    let [width, height] = [frame.east() - frame.west, frame.north() - frame.south];
    let counts = snapshots.iter().map(|snapshot| snapshot.population.len() as f64);
    let (most, fewest) = (counts.clone().fold(1.0, f64::max), counts.fold(f64::INFINITY, f64::min));
    let side = (width * height * SHOWN / (most * fewest.max(1.0)).sqrt()).sqrt();
    side.min(width).min(height)
}

fn draw_field(plants: &[Plant], frame: &Frame, side: f64) -> Sketch {
    let mut sketch = Sketch::filled(SIDE, SIDE, GROUND);
    let scale = SIDE as f64 / side;
    // The dominated on top: they are the smaller ones, within the circles of others.
    let mut order: Vec<&Plant> = plants.iter().collect();
    order.sort_by(|a, b| b.radius.total_cmp(&a.radius).then(a.id.cmp(&b.id)));
    for plant in order {
        let x = (plant.x - frame.west) * scale;
        let y = SIDE as f64 - (plant.y - frame.south) * scale;
        let radius = f64::from(plant.radius) * scale;
        let [fill, rim] = colors(plant.state);
        if radius > 2.5 {
            sketch.disc(x, y, radius, rim, 1.0);
            sketch.disc(x, y, radius - 1.5, fill, 1.0);
        } else {
            sketch.disc(x, y, radius, fill, 1.0);
        }
    }
    sketch
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
