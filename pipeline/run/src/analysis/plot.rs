//! Figures of statistics as pixels.

use crate::preview::Sketch;
use weald_analyze::Figure;
use weald_analyze::figure::{Anchor, SIZE, Shape};

/// Pixels of the picture a pixel of the figure: the lettering of previews is coarse.
const SCALE: f64 = 2.0;

/// Pixels a unit of the letters, which are five units high.
const LETTER_UNIT: i64 = 3;

/// Pixels of a dash and of the gap after it.
const DASH: [f64; 2] = [10.0, 8.0];

/// Draws a figure on white.
pub fn draw(figure: &Figure) -> Sketch {
    let [width, height] = SIZE.map(|length| (length * SCALE) as usize);
    let mut sketch = Sketch::filled(width, height, [255; 3]);
    for shape in figure.drawing() {
        match shape {
            Shape::Line { points, color, width, is_dashed } => {
                let points: Vec<[f64; 2]> = points.into_iter().map(scaled).collect();
                stroke(&mut sketch, &points, color, width * SCALE, is_dashed);
            }
            Shape::Area { points, color } => {
                let points: Vec<[f64; 2]> = points.into_iter().map(scaled).collect();
                fill(&mut sketch, &points, color);
            }
            Shape::Dot { at, radius, color } => {
                let [x, y] = scaled(at);
                sketch.disc(x, y, radius * SCALE, color, 1.0);
            }
            Shape::Text { at, text, anchor, color } => {
                let [x, y] = scaled(at).map(|value| value as i64);
                // Letters are three units wide with one between them. Long titles are set smaller.
                let letters = 4 * text.chars().count() as i64;
                let is_long = anchor == Anchor::Start && x + letters * LETTER_UNIT > width as i64;
                let unit = if is_long { LETTER_UNIT - 1 } else { LETTER_UNIT };
                let length = letters * unit;
                let left = match anchor {
                    Anchor::Start => x,
                    Anchor::Middle => x - length / 2,
                    Anchor::End => x - length,
                };
                sketch.text(left, y - 5 * unit, &text, unit, color);
            }
        }
    }
    sketch
}

fn scaled(point: [f64; 2]) -> [f64; 2] {
    point.map(|value| value * SCALE)
}

/// Draws a line as discs close to each other; thin ones as they are.
fn stroke(sketch: &mut Sketch, points: &[[f64; 2]], color: [u8; 3], width: f64, is_dashed: bool) {
    let mut along = 0.0;
    for [from, to] in points.array_windows() {
        let length = (to[0] - from[0]).hypot(to[1] - from[1]);
        if width <= SCALE && !is_dashed {
            // Through the middle of pixels: on their edges rounding would choose either side.
            let [from, to] = [from, to].map(|point| point.map(|value| value.floor() + 0.5));
            sketch.line(from, to, color, 1.0);
            continue;
        }
        let steps = length.ceil().max(1.0);
        for step in 0..steps as usize {
            let part = step as f64 / steps;
            let is_gap = is_dashed && (along + part * length) % (DASH[0] + DASH[1]) > DASH[0];
            if !is_gap {
                let at = [0, 1].map(|axis: usize| from[axis] + part * (to[axis] - from[axis]));
                sketch.disc(at[0], at[1], width / 2.0, color, 1.0);
            }
        }
        along += length;
    }
}

/// Fills a polygon: pixels whose centre lies inside by the even-odd rule.
fn fill(sketch: &mut Sketch, points: &[[f64; 2]], color: [u8; 3]) {
    for row in 0..sketch.height as i64 {
        let y = row as f64 + 0.5;
        let mut crossings: Vec<f64> = Vec::new();
        for (index, a) in points.iter().enumerate() {
            let b = points[(index + 1) % points.len()];
            if (a[1] <= y) != (b[1] <= y) {
                crossings.push(a[0] + (y - a[1]) / (b[1] - a[1]) * (b[0] - a[0]));
            }
        }
        crossings.sort_by(f64::total_cmp);
        for ends in crossings.chunks_exact(2) {
            let (left, right) = ((ends[0] - 0.5).ceil() as i64, (ends[1] - 0.5).ceil() as i64);
            sketch.rectangle(left, row, right - left, 1, color, 1.0);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_polygon_fills_its_area() {
        let mut sketch = Sketch::filled(40, 40, [255; 3]);
        fill(&mut sketch, &[[5.0, 5.0], [35.0, 5.0], [5.0, 35.0]], [0; 3]);
        let dark = sketch.rgb.iter().step_by(3).filter(|value| **value == 0).count();
        assert!((435..=465).contains(&dark), "{dark} of 450");
    }
}
