//! Lines that users draw: the nearest point on them, and the curve along which influence falls.
//!
//! A stream's mask is "the minimum distance from the sample point to the segments", to which "a
//! spline is applied to smoothly increase influence close to the segments" [Deussen98, §3].

/// Cubic Hermite curve from 0 at `low` to 1 at `high`, level at both ends and flat outside.
///
/// With equal ends it is the step that is 1 from `high` on.
pub fn smoothstep(low: f64, high: f64, x: f64) -> f64 {
    if x >= high {
        return 1.0;
    }
    if x <= low {
        return 0.0;
    }
    let t = (x - low) / (high - low);
    t * t * (3.0 - 2.0 * t)
}

/// Influence at a distance: 1 up to `core`, then falling to 0 at `core + falloff`.
pub fn influence(distance: f64, core: f64, falloff: f64) -> f64 {
    if distance <= core { 1.0 } else { 1.0 - smoothstep(core, core + falloff, distance) }
}

/// Segments joined end to end.
#[derive(Clone, Debug, PartialEq)]
pub struct Polyline {
    points: Vec<[f64; 2]>,
    /// Length of the line up to each point, m.
    stations: Vec<f64>,
}

/// The point in which two legs cross, each from one side of the other to its other side.
fn crossing(a: &[[f64; 2]], b: &[[f64; 2]]) -> Option<[f64; 2]> {
    let side = |leg: &[[f64; 2]], p: [f64; 2]| {
        let ([x0, y0], [x1, y1]) = (leg[0], leg[1]);
        (x1 - x0) * (p[1] - y0) - (y1 - y0) * (p[0] - x0)
    };
    let (from, to) = (side(a, b[0]), side(a, b[1]));
    let is_across = from * to < 0.0 && side(b, a[0]) * side(b, a[1]) < 0.0;
    let t = from / (from - to);
    is_across.then(|| [0, 1].map(|axis| b[0][axis] + t * (b[1][axis] - b[0][axis])))
}

/// The point of a line that is nearest to another.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Nearest {
    /// Distance to it, m.
    pub distance: f64,
    /// Length of the line up to it, m.
    pub station: f64,
}

impl Polyline {
    /// A line through points; repeated points are dropped. At least one point is needed to be
    /// near to anything.
    pub fn new(points: &[[f64; 2]]) -> Self {
        let mut line = Self { points: Vec::new(), stations: Vec::new() };
        for &point in points {
            let station = match (line.points.last(), line.stations.last()) {
                (Some(last), Some(_)) if *last == point => continue,
                (Some(last), Some(station)) => station + length(*last, point),
                _ => 0.0,
            };
            line.points.push(point);
            line.stations.push(station);
        }
        line
    }

    /// The line that returns to its first point.
    pub fn closed(points: &[[f64; 2]]) -> Self {
        let ring: Vec<[f64; 2]> = points.iter().chain(points.first()).copied().collect();
        Self::new(&ring)
    }

    /// A smooth curve through points, as a line of short segments: a centripetal Catmull-Rom
    /// spline, which neither loops nor overshoots between its points [Yuksel11].
    pub fn curved(points: &[[f64; 2]]) -> Self {
        let line = Self::new(points);
        let points = &line.points;
        let (Some(first), Some(last), true) = (points.first(), points.last(), points.len() > 2)
        else {
            return line;
        };
        // Beyond its ends the curve would go on straight.
        let beyond = |end: [f64; 2], before: [f64; 2]| [0, 1].map(|i| 2.0 * end[i] - before[i]);
        let mut controls = vec![beyond(*first, points[1])];
        controls.extend(points);
        controls.push(beyond(*last, points[points.len() - 2]));
        let mut curve = vec![*first];
        for quad in controls.windows(4) {
            let steps = 1..=CURVE_STEPS;
            curve.extend(
                steps.map(|step| catmull_rom(quad, f64::from(step) / f64::from(CURVE_STEPS))),
            );
        }
        Self::new(&curve)
    }

    /// Length of the line, m.
    pub fn length(&self) -> f64 {
        self.stations.last().copied().unwrap_or(0.0)
    }

    /// The point at a length along the line; its ends beyond them.
    pub fn at(&self, station: f64) -> [f64; 2] {
        let after = self.stations.partition_point(|&s| s <= station);
        let last = self.points.len().saturating_sub(1);
        let (Some(from), Some(to)) =
            (self.points.get(after.saturating_sub(1)), self.points.get(after.min(last)))
        else {
            return [0.0; 2];
        };
        let (s0, s1) = (self.stations[after.saturating_sub(1)], self.stations[after.min(last)]);
        let t = if s1 > s0 { ((station - s0) / (s1 - s0)).clamp(0.0, 1.0) } else { 0.0 };
        [from[0] + t * (to[0] - from[0]), from[1] + t * (to[1] - from[1])]
    }

    /// Segments (by index) that points with this `y` may have within `reach`.
    pub fn segments_near_row(&self, y: f64, reach: f64) -> Vec<usize> {
        let near = |pair: &[[f64; 2]]| {
            let (low, high) = (pair[0][1].min(pair[1][1]), pair[0][1].max(pair[1][1]));
            y >= low - reach && y <= high + reach
        };
        self.points.windows(2).enumerate().filter(|(_, pair)| near(pair)).map(|(i, _)| i).collect()
    }

    /// The nearest point among some segments; `None` when there are none.
    pub fn nearest(&self, segments: &[usize], [x, y]: [f64; 2]) -> Option<Nearest> {
        let mut best: Option<(f64, f64)> = None;
        for &segment in segments {
            let (from, to) = (self.points[segment], self.points[segment + 1]);
            let (dx, dy) = (to[0] - from[0], to[1] - from[1]);
            let along = (x - from[0]) * dx + (y - from[1]) * dy;
            // Points of a segment differ, so its length is not zero.
            let t = (along / (dx * dx + dy * dy)).clamp(0.0, 1.0);
            let (ox, oy) = (x - from[0] - t * dx, y - from[1] - t * dy);
            let squared = ox * ox + oy * oy;
            if best.is_none_or(|(least, _)| squared < least) {
                let (s0, s1) = (self.stations[segment], self.stations[segment + 1]);
                best = Some((squared, s0 + t * (s1 - s0)));
            }
        }
        best.map(|(squared, station)| Nearest { distance: squared.sqrt(), station })
    }

    /// A point where the line crosses itself, if it does: legs that touch at their ends or lie
    /// along each other do not cross.
    pub fn crossing(&self) -> Option<[f64; 2]> {
        let legs: Vec<&[[f64; 2]]> = self.points.windows(2).collect();
        // From west to east, so that each leg meets only those that begin before it ends.
        let west = |leg: &[[f64; 2]]| leg[0][0].min(leg[1][0]);
        let east = |leg: &[[f64; 2]]| leg[0][0].max(leg[1][0]);
        let mut order: Vec<usize> = (0..legs.len()).collect();
        order.sort_by(|&a, &b| west(legs[a]).total_cmp(&west(legs[b])));
        order.iter().enumerate().find_map(|(place, &a)| {
            let beside = order[place + 1..].iter();
            let beside = beside.take_while(|&&b| west(legs[b]) <= east(legs[a]));
            beside.into_iter().find_map(|&b| crossing(legs[a], legs[b]))
        })
    }

    /// Whether a closed line winds around a point (even-odd rule).
    pub fn encloses(&self, [x, y]: [f64; 2]) -> bool {
        let crossings = self.points.windows(2).filter(|pair| {
            let ([x0, y0], [x1, y1]) = (pair[0], pair[1]);
            (y0 > y) != (y1 > y) && x < x0 + (y - y0) / (y1 - y0) * (x1 - x0)
        });
        crossings.count() % 2 == 1
    }
}

/// Segments between two points of a curve: a right angle then turns by 18 degrees at its sharpest.
const CURVE_STEPS: u32 = 16;

/// Point of the spline between the middle two of four points, by the pyramid of [Barry88] with
/// centripetal knots.
fn catmull_rom(points: &[[f64; 2]], t: f64) -> [f64; 2] {
    let mut knots = [0.0; 4];
    for i in 1..4 {
        knots[i] = knots[i - 1] + length(points[i - 1], points[i]).sqrt();
    }
    let at = knots[1] + t * (knots[2] - knots[1]);
    let mut pyramid = [points[0], points[1], points[2], points[3]];
    // The three levels interpolate over 1, 2 and, at the top, the middle interval again.
    for (level, span) in [(3, 1), (2, 2), (1, 1)] {
        for i in 0..level {
            let from = if level == 1 { 1 } else { i };
            let s = (at - knots[from]) / (knots[from + span] - knots[from]);
            pyramid[i] = [0, 1].map(|k| pyramid[i][k] + s * (pyramid[i + 1][k] - pyramid[i][k]));
        }
    }
    pyramid[0]
}

fn length(a: [f64; 2], b: [f64; 2]) -> f64 {
    libm::hypot(b[0] - a[0], b[1] - a[1])
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_nearest_point_of_a_bent_line_is_on_the_nearer_leg() {
        let line = Polyline::new(&[[0.0, 0.0], [10.0, 0.0], [10.0, 0.0], [10.0, 10.0]]);
        assert_eq!(line.length(), 20.0);
        assert_eq!(line.at(15.0), [10.0, 5.0]);
        assert_eq!(line.at(99.0), [10.0, 10.0]);
        let nearest = |p| line.nearest(&[0, 1], p).unwrap();
        assert_eq!(nearest([4.0, 3.0]), Nearest { distance: 3.0, station: 4.0 });
        assert_eq!(nearest([12.0, 7.0]), Nearest { distance: 2.0, station: 17.0 });
        assert_eq!(nearest([-3.0, -4.0]), Nearest { distance: 5.0, station: 0.0 });
        assert_eq!(line.segments_near_row(5.0, 1.0), [1]);
    }

    #[test]
    fn a_curve_passes_through_its_points_and_bends_between_them() {
        let points = [[0.0, 0.0], [10.0, 0.0], [10.0, 20.0], [30.0, 20.0]];
        let curve = Polyline::curved(&points);
        let all: Vec<usize> = (0..curve.points.len() - 1).collect();
        for point in points {
            assert!(curve.nearest(&all, point).unwrap().distance < 1e-12, "{point:?}");
        }
        let turns = curve.points.windows(3).map(|p| {
            let direction = |a: [f64; 2], b: [f64; 2]| (b[1] - a[1]).atan2(b[0] - a[0]);
            (direction(p[1], p[2]) - direction(p[0], p[1])).abs()
        });
        assert!(turns.fold(0.0, f64::max) < 0.32, "no corner is left");
        let straight = Polyline::curved(&[[0.0, 0.0], [1.0, 0.0], [5.0, 0.0]]);
        assert!((straight.length() - 5.0).abs() < 1e-12);
    }

    #[test]
    fn a_bow_tie_crosses_itself_where_its_diagonals_meet_and_a_star_shaped_ring_does_not() {
        let bow = Polyline::closed(&[[0.0, 0.0], [4.0, 4.0], [4.0, 0.0], [0.0, 4.0]]);
        assert_eq!(bow.crossing(), Some([2.0, 2.0]));
        let ring: Vec<[f64; 2]> = (0..200)
            .map(|k| {
                let (sin, cos) = libm::sincos(f64::from(k) * std::f64::consts::TAU / 200.0);
                let radius = if k % 2 == 0 { 5.0 } else { 9.0 };
                [radius * cos, radius * sin]
            })
            .collect();
        assert_eq!(Polyline::closed(&ring).crossing(), None);
        // The same ring with two corners taken in the wrong order.
        let mut wrong = ring;
        wrong.swap(20, 22);
        assert!(Polyline::closed(&wrong).crossing().is_some());
    }

    #[test]
    fn a_concave_polygon_encloses_its_arms_and_not_its_bay() {
        let ring = Polyline::closed(&[[0.0, 0.0], [6.0, 0.0], [6.0, 6.0], [3.0, 2.0], [0.0, 6.0]]);
        assert!(ring.encloses([0.5, 4.0]) && ring.encloses([5.5, 4.0]));
        assert!(!ring.encloses([3.0, 4.0]) && !ring.encloses([7.0, 1.0]));
    }

    #[test]
    fn influence_is_full_in_the_core_and_half_in_the_middle_of_the_falloff() {
        let at = [0.0, 2.0, 4.0, 6.0, 9.0].map(|d| influence(d, 2.0, 4.0));
        assert_eq!(at, [1.0, 1.0, 0.5, 0.0, 0.0]);
        assert_eq!(influence(2.001, 2.0, 0.0), 0.0, "no falloff makes a sharp edge");
    }
}
