//! Figures of statistics: what to draw, and SVG of it.
//!
//! A [`Figure`] is curves, bands and dots in data coordinates. [`Figure::drawing`] lays it out as
//! a list of shapes in pixels, which [`Figure::svg`] writes as text and others may rasterize.

use crate::envelope::Envelope;
use crate::pattern::Table;
use crate::thinning::{StandState, ThinningLine};
use std::fmt::Write;

/// A figure with one pair of axes.
#[derive(Clone, Debug, PartialEq)]
pub struct Figure {
    /// Above the axes.
    pub title: String,
    /// Below the horizontal axis.
    pub x_label: String,
    /// Above the vertical axis.
    pub y_label: String,
    /// Areas between two curves, drawn first.
    pub bands: Vec<Band>,
    /// Curves and dots, drawn in order.
    pub series: Vec<Series>,
}

/// The area between two curves over the same x.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// In the legend; one without a label does not stand there.
    pub label: String,
    /// x, lower and upper y.
    pub rows: Vec<[f64; 3]>,
    /// Fill.
    pub color: Color,
}

/// A curve or dots.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// In the legend.
    pub label: String,
    /// x and y; a curve is interrupted where one is not finite.
    pub points: Vec<[f64; 2]>,
    /// Of line or dots.
    pub color: Color,
    /// How it is drawn.
    pub style: Style,
}

/// An sRGB colour.
pub type Color = [u8; 3];

/// How a series is drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Style {
    /// A line.
    Line,
    /// A broken line.
    Dashed,
    /// A dot a point.
    Dots,
}

/// A shape in pixels, x to the right and y down.
#[derive(Clone, Debug, PartialEq)]
pub enum Shape {
    /// A line through points.
    Line {
        /// Corners.
        points: Vec<[f64; 2]>,
        /// Stroke.
        color: Color,
        /// Stroke width.
        width: f64,
        /// Whether it is broken.
        is_dashed: bool,
    },
    /// A filled polygon.
    Area {
        /// Corners.
        points: Vec<[f64; 2]>,
        /// Fill.
        color: Color,
    },
    /// A filled disc.
    Dot {
        /// Centre.
        at: [f64; 2],
        /// Radius.
        radius: f64,
        /// Fill.
        color: Color,
    },
    /// A line of text.
    Text {
        /// Left end, middle or right end of the base line.
        at: [f64; 2],
        /// What it says.
        text: String,
        /// Which of these.
        anchor: Anchor,
        /// Fill.
        color: Color,
    },
}

/// Which part of a text stands at its place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Anchor {
    /// The left end.
    Start,
    /// The middle.
    Middle,
    /// The right end.
    End,
}

/// Width and height of a figure, pixels.
pub const SIZE: [f64; 2] = [640.0, 440.0];

/// Room left, above, right and below the axes for numbers and legend.
const MARGINS: [f64; 4] = [72.0, 40.0, 132.0, 48.0];

/// Height of letters.
const LETTERS: f64 = 12.0;

const INK: Color = [34, 34, 34];
const PALE: Color = [221, 221, 221];
const GREY: Color = [136, 136, 136];

/// Colours that stay apart for colour-blind eyes [Okabe08], theory first in grey.
const COLORS: [Color; 5] =
    [[0, 114, 178], [213, 94, 0], [0, 158, 115], [204, 121, 167], [230, 159, 0]];

impl Figure {
    /// The columns of a table of a statistic over its first column, `theo` as a broken line.
    pub fn of_table(title: &str, table: &Table) -> Self {
        let radii = table.columns.first().map_or(&[][..], |(_, values)| values);
        let mut colors = COLORS.iter().cycle();
        let series = table.columns.iter().skip(1).map(|(name, values)| {
            let is_theory = *name == "theo";
            let color = if is_theory { Some(&GREY) } else { colors.next() };
            Series {
                label: (*name).to_string(),
                points: radii.iter().zip(values).map(|(x, y)| [*x, *y]).collect(),
                color: *color.unwrap_or(&INK),
                style: if is_theory { Style::Dashed } else { Style::Line },
            }
        });
        let (x_label, y_label) = ("r".into(), table.name.into());
        Self { title: title.into(), x_label, y_label, bands: vec![], series: series.collect() }
    }

    /// The observed curve on its pointwise and global envelope.
    pub fn of_envelope(envelope: &Envelope) -> Self {
        let rows = |ends: &[Vec<f64>; 2]| {
            let ends = ends[0].iter().zip(&ends[1]);
            let row = |(r, (low, high)): (&f64, (&f64, &f64))| [*r, *low, *high];
            envelope.radii.iter().zip(ends).map(row).collect()
        };
        let band = |label: &str, ends, color| Band { label: label.into(), rows: rows(ends), color };
        let series = |label: &str, values: &[f64], color, style| Series {
            label: label.into(),
            points: envelope.radii.iter().zip(values).map(|(x, y)| [*x, *y]).collect(),
            color,
            style,
        };
        Self {
            title: envelope.to_string(),
            x_label: "r".into(),
            y_label: envelope.subject.statistic.into(),
            bands: vec![
                band("global", &envelope.global, [232, 238, 244]),
                band("pointwise", &envelope.pointwise, [200, 214, 228]),
            ],
            series: vec![
                series("mean", &envelope.mean, GREY, Style::Dashed),
                series("observed", &envelope.observed, COLORS[1], Style::Line),
            ],
        }
    }

    /// A stand's history in logarithms, with the lines over the densities they were fitted to.
    pub fn of_thinning(
        title: &str,
        states: &[StandState],
        line: &ThinningLine,
        densities: [f64; 2],
    ) -> Self {
        let log = |state: &StandState| [libm::log10(state.density), libm::log10(state.mean_size)];
        let points: Vec<[f64; 2]> = states.iter().map(log).collect();
        let ends = densities.map(libm::log10);
        let fit = |label: &str, slope: f64, intercept: f64, color, style| Series {
            label: format!("{label} {slope:.3}"),
            points: ends.map(|x| [x, intercept + slope * x]).to_vec(),
            color,
            style,
        };
        let (ols, sma, upper) = (line.least_squares, line.major_axis, line.upper);
        Self {
            title: title.into(),
            x_label: "log10 density".into(),
            y_label: "log10 mean size".into(),
            bands: vec![],
            series: vec![
                Series { label: "states".into(), points, color: GREY, style: Style::Dots },
                fit("OLS", ols.slope, ols.intercept, COLORS[0], Style::Line),
                fit("SMA", sma.slope, sma.intercept, COLORS[1], Style::Dashed),
                fit("95 %", upper.slope, upper.intercept, COLORS[2], Style::Line),
            ],
        }
    }

    /// Lays the figure out.
    pub fn drawing(&self) -> Vec<Shape> {
        let axes = Axes::around(self);
        let mut shapes = axes.shapes(self);
        shapes.extend(self.bands.iter().filter_map(|band| axes.band(band)));
        shapes.extend(self.series.iter().flat_map(|series| axes.series(series)));
        shapes.extend(self.legend());
        shapes
    }

    /// The figure as an SVG file.
    pub fn svg(&self) -> String {
        let [width, height] = SIZE;
        let mut text = format!(
            "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" \
             viewBox=\"0 0 {width} {height}\" font-family=\"sans-serif\" \
             font-size=\"{LETTERS}\">\n<title>{}</title>\n\
             <rect width=\"{width}\" height=\"{height}\" fill=\"#ffffff\"/>\n",
            escape(&self.title)
        );
        for shape in self.drawing() {
            write_shape(&mut text, &shape);
        }
        text.push_str("</svg>\n");
        text
    }

    fn legend(&self) -> Vec<Shape> {
        let left = SIZE[0] - MARGINS[2] + 12.0;
        let bands = self.bands.iter().map(|band| (band.label.as_str(), band.color, None));
        let series = self.series.iter();
        let series = series.map(|s| (s.label.as_str(), s.color, Some(s.style)));
        let mut shapes = Vec::new();
        let labelled = bands.chain(series).filter(|(label, ..)| !label.is_empty());
        for (row, (label, color, style)) in labelled.enumerate() {
            let y = MARGINS[1] + 8.0 + 18.0 * row as f64;
            let line = [[left, y], [left + 22.0, y]];
            shapes.push(match style {
                None => rectangle([left, y - 5.0], [left + 22.0, y + 5.0], color),
                Some(Style::Dots) => Shape::Dot { at: [left + 11.0, y], radius: 2.0, color },
                Some(style) => Shape::Line {
                    points: line.to_vec(),
                    color,
                    width: 1.8,
                    is_dashed: style == Style::Dashed,
                },
            });
            let at = [left + 28.0, y + 4.0];
            shapes.push(Shape::Text { at, text: label.into(), anchor: Anchor::Start, color: INK });
        }
        shapes
    }
}

fn widen([low, high]: [f64; 2], value: f64) -> [f64; 2] {
    [low.min(value), high.max(value)]
}

fn rectangle(from: [f64; 2], to: [f64; 2], color: Color) -> Shape {
    Shape::Area { points: vec![from, [to[0], from[1]], to, [from[0], to[1]]], color }
}

/// Data ranges, and where they lie in pixels.
struct Axes {
    x: [f64; 2],
    y: [f64; 2],
}

impl Axes {
    /// Ranges that hold all that is finite. Bands may be cut where they are far wider than curves.
    fn around(figure: &Figure) -> Self {
        let points = figure.series.iter().flat_map(|series| series.points.iter().copied());
        let ends = figure.bands.iter().flat_map(|band| &band.rows);
        let ends = ends.flat_map(|[x, low, high]| [[*x, *low], [*x, *high]]);
        let finite = points.chain(ends).filter(|[x, y]| x.is_finite() && y.is_finite());
        let none = [f64::INFINITY, f64::NEG_INFINITY];
        let (x, y) =
            finite.fold((none, none), |(x, y), point| (widen(x, point[0]), widen(y, point[1])));
        Self { x: roomy(x, 0.0), y: roomy(y, 0.04) }
    }

    /// A place in pixels.
    fn place(&self, [x, y]: [f64; 2]) -> [f64; 2] {
        let [left, top, right, bottom] = MARGINS;
        let part = |value: f64, [low, high]: [f64; 2]| (value - low) / (high - low);
        [
            left + part(x, self.x) * (SIZE[0] - left - right),
            SIZE[1] - bottom - part(y, self.y) * (SIZE[1] - top - bottom),
        ]
    }

    fn shapes(&self, figure: &Figure) -> Vec<Shape> {
        let text =
            |at, text: &str, anchor| Shape::Text { at, text: text.into(), anchor, color: INK };
        let line = |from, to, color| Shape::Line {
            points: vec![from, to],
            color,
            width: 1.0,
            is_dashed: false,
        };
        let [left, top] = self.place([self.x[0], self.y[1]]);
        let [right, bottom] = self.place([self.x[1], self.y[0]]);
        let mut shapes = Vec::new();
        for (value, label) in ticks(self.x) {
            let x = self.place([value, self.y[0]])[0];
            shapes.push(line([x, top], [x, bottom], PALE));
            shapes.push(text([x, bottom + 18.0], &label, Anchor::Middle));
        }
        for (value, label) in ticks(self.y) {
            let y = self.place([self.x[0], value])[1];
            shapes.push(line([left, y], [right, y], PALE));
            shapes.push(text([left - 6.0, y + 4.0], &label, Anchor::End));
        }
        shapes.push(line([left, top], [left, bottom], INK));
        shapes.push(line([left, bottom], [right, bottom], INK));
        shapes.push(text([left - 60.0, 16.0], &figure.title, Anchor::Start));
        shapes.push(text([left, top - 8.0], &figure.y_label, Anchor::Middle));
        shapes.push(text([right, bottom + 36.0], &figure.x_label, Anchor::End));
        shapes
    }

    fn band(&self, band: &Band) -> Option<Shape> {
        let rows: Vec<&[f64; 3]> =
            band.rows.iter().filter(|row| row.iter().all(|value| value.is_finite())).collect();
        let upper = rows.iter().map(|[x, _, high]| self.place([*x, *high]));
        let lower = rows.iter().rev().map(|[x, low, _]| self.place([*x, *low]));
        let points: Vec<[f64; 2]> = upper.chain(lower).collect();
        (points.len() > 2).then_some(Shape::Area { points, color: band.color })
    }

    fn series(&self, series: &Series) -> Vec<Shape> {
        let color = series.color;
        let is_finite = |point: &[f64; 2]| point.iter().all(|value| value.is_finite());
        if series.style == Style::Dots {
            let finite = series.points.iter().filter(|point| is_finite(point));
            let dot = |point: &[f64; 2]| Shape::Dot { at: self.place(*point), radius: 1.6, color };
            return finite.map(dot).collect();
        }
        let runs = series.points.split(|point| !is_finite(point)).filter(|run| run.len() > 1);
        let line = |run: &[[f64; 2]]| Shape::Line {
            points: run.iter().map(|point| self.place(*point)).collect(),
            color,
            width: 1.8,
            is_dashed: series.style == Style::Dashed,
        };
        runs.map(line).collect()
    }
}

/// A range with some room at both ends; any range at all where there is none.
fn roomy([low, high]: [f64; 2], room: f64) -> [f64; 2] {
    if low > high {
        return [0.0, 1.0];
    }
    if low == high {
        let half = if low == 0.0 { 1.0 } else { low.abs() / 2.0 };
        return [low - half, high + half];
    }
    [low - room * (high - low), high + room * (high - low)]
}

/// Round values in a range, four to nine of them, with their texts.
fn ticks([low, high]: [f64; 2]) -> Vec<(f64, String)> {
    let power = libm::floor(libm::log10((high - low) / 4.0));
    let unit = libm::pow(10.0, power);
    let steps = (high - low) / unit;
    let step = [10.0, 5.0, 2.0].into_iter().find(|step| steps / step >= 4.0).unwrap_or(1.0) * unit;
    let digits = (-power).clamp(0.0, 12.0) as usize;
    let first = libm::ceil(low / step);
    let text = |value: f64| match value == 0.0 || (1e-6..1e7).contains(&value.abs()) {
        true => format!("{value:.digits$}"),
        false => format!("{value:.1e}"),
    };
    // At most fifty: the step is at least a fiftieth of the range.
    let values = (0..50).map(|number| (first + f64::from(number)) * step);
    let inside = values.take_while(|value| *value <= high + step * 1e-9);
    // Adding 0 turns -0 into 0.
    inside.map(|value| (value, text(value + 0.0))).collect()
}

fn write_shape(text: &mut String, shape: &Shape) {
    // Writing to a string cannot fail.
    let _ = match shape {
        Shape::Line { points, color, width, is_dashed } => {
            let dashes = if *is_dashed { " stroke-dasharray=\"5 4\"" } else { "" };
            writeln!(
                text,
                "<polyline points=\"{}\" fill=\"none\" stroke=\"{}\" stroke-width=\"{width}\"{dashes}/>",
                corners(points),
                hex(*color)
            )
        }
        Shape::Area { points, color } => {
            writeln!(text, "<polygon points=\"{}\" fill=\"{}\"/>", corners(points), hex(*color))
        }
        Shape::Dot { at: [x, y], radius, color } => writeln!(
            text,
            "<circle cx=\"{x:.2}\" cy=\"{y:.2}\" r=\"{radius}\" fill=\"{}\"/>",
            hex(*color)
        ),
        Shape::Text { at: [x, y], text: says, anchor, color } => {
            let anchor = match anchor {
                Anchor::Start => "start",
                Anchor::Middle => "middle",
                Anchor::End => "end",
            };
            writeln!(
                text,
                "<text x=\"{x:.2}\" y=\"{y:.2}\" text-anchor=\"{anchor}\" fill=\"{}\">{}</text>",
                hex(*color),
                escape(says)
            )
        }
    };
}

fn corners(points: &[[f64; 2]]) -> String {
    let corner = |[x, y]: &[f64; 2]| format!("{x:.2},{y:.2}");
    points.iter().map(corner).collect::<Vec<String>>().join(" ")
}

fn hex([r, g, b]: Color) -> String {
    format!("#{r:02x}{g:02x}{b:02x}")
}

fn escape(text: &str) -> String {
    text.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ticks_are_round_and_inside() {
        let texts = |range| ticks(range).into_iter().map(|(_, text)| text).collect::<Vec<_>>();
        assert_eq!(texts([0.0, 1.0]), ["0.0", "0.2", "0.4", "0.6", "0.8", "1.0"]);
        assert_eq!(texts([-2.3, 0.1]), ["-2.0", "-1.5", "-1.0", "-0.5", "0.0"]);
        assert_eq!(
            texts([0.0, 7854.0]),
            ["0", "1000", "2000", "3000", "4000", "5000", "6000", "7000"]
        );
    }

    #[test]
    fn curves_lie_inside_the_axes_and_break_where_a_value_is_missing() {
        let values = vec![0.0, 1.0, f64::NAN, 4.0, 2.0];
        let radii: Vec<f64> = (0..5).map(f64::from).collect();
        let columns = vec![("r", radii), ("theo", vec![1.0; 5]), ("trans", values)];
        let figure = Figure::of_table("A < B & C", &Table { name: "K", columns });
        let svg = figure.svg();
        // One curve of theory, two pieces, two keys of the legend, two axes and the grid.
        assert!(svg.contains("<title>A &lt; B &amp; C</title>"));
        assert!(!svg.contains("NaN") && svg.ends_with("</svg>\n"));
        let pieces = figure.drawing().into_iter().filter(
            |shape| matches!(shape, Shape::Line { width, points, .. } if *width > 1.5 && points[0][0] < 500.0),
        );
        assert_eq!(pieces.count(), 3);
        for shape in figure.drawing() {
            if let Shape::Line { points, .. } = shape {
                for [x, y] in points {
                    assert!((0.0..=SIZE[0]).contains(&x) && (0.0..=SIZE[1]).contains(&y));
                }
            }
        }
    }

    #[test]
    fn a_figure_of_nothing_is_still_a_figure() {
        let table = Table { name: "K", columns: vec![("r", vec![]), ("theo", vec![])] };
        assert!(Figure::of_table("nothing", &table).svg().contains("</svg>"));
    }
}
