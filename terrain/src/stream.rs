//! Streams and ditches: a bed cut along a line, never running uphill.
//!
//! Inside half the width the ground is the bed, beyond the falloff it is untouched, and between
//! the two it is ramped along the mask's spline [Deussen98, §3].

use crate::mask::check_line;
use crate::spline::{Polyline, influence};
use weald_contract::{Problem, Problems, Written, table};

table! {
    /// A stream or ditch.
    pub struct StreamCut {
        /// Points of its middle line from source to mouth, scene coordinates, m.
        points: Written<Vec<[f64; 2]>>, in -1000000.0..=1000000.0;
        /// Whether the line is a smooth curve through the points, and not straight between them.
        curved: bool = false;
        /// Width of the bed, m.
        width: f64, in 0.0..=100000.0;
        /// Depth of the bed below the ground along the line, m.
        depth: f64, in 0.0..=10000.0;
        /// Width of each bank, from the bed's side to untouched ground, m.
        falloff: f64 = 1.0, in 0.0..=100000.0;
        /// Least fall of the bed, m per m.
        fall: f64 = 0.0, in 0.0..=10.0;
        /// Deepest cut that is accepted, m. Where the ground rises along the line, the bed cannot.
        max_depth: Option<f64> = None, in 0.0..=100000.0;
        /// Depth of water above the bed, m; its surface follows the bed.
        water_depth: f64 = 0.0, in 0.0..=10000.0;
        /// Altitude up to which water stands in the cut, m.
        water_level: Option<f64> = None, in -100000.0..=100000.0;
    }
}

/// Distance between samples of the ground along the line, in cells: finer finds nothing new in
/// ground that is interpolated between cells.
const SAMPLE_CELLS: f64 = 0.5;

/// Most samples along one line.
const MAX_SAMPLES: f64 = 1e7;

impl StreamCut {
    /// Notes what is wrong with the stream's own numbers.
    pub(crate) fn check(&self, problems: &mut Problems) {
        check_line(&self.points, problems);
    }

    /// Runs the bed along the line over ground whose altitude `ground(x, y)` gives.
    pub(crate) fn run(
        &self,
        cell: f64,
        ground: impl Fn(f64, f64) -> f32,
    ) -> Result<Channel, Problem> {
        let points = &self.points.value;
        let line = if self.curved { Polyline::curved(points) } else { Polyline::new(points) };
        let count = (line.length() / (SAMPLE_CELLS * cell)).ceil().clamp(1.0, MAX_SAMPLES);
        let spacing = line.length() / count;
        let mut bed: Vec<f64> = Vec::with_capacity(count as usize + 1);
        for index in 0..=count as usize {
            let station = index as f64 * spacing;
            let [x, y] = line.at(station);
            let surface = f64::from(ground(x, y));
            let below = surface - self.depth;
            // The bed follows the ground down and stays level, or falls, under rising ground.
            let level = bed.last().map_or(below, |last| below.min(last - self.fall * spacing));
            self.check_depth(surface - level, station)?;
            bed.push(level);
        }
        Ok(Channel { line, bed, spacing, cut: self.clone() })
    }

    /// The dry cross-section of a strip along a line.
    pub(crate) fn strip(points: &Written<Vec<[f64; 2]>>, width: f64, falloff: f64) -> Self {
        Self {
            points: points.clone(),
            curved: false,
            width,
            depth: 0.0,
            falloff,
            fall: 0.0,
            max_depth: None,
            water_depth: 0.0,
            water_level: None,
        }
    }

    fn check_depth(&self, depth: f64, station: f64) -> Result<(), Problem> {
        match self.max_depth {
            Some(limit) if depth > limit => Err(Problem::at(
                self.points.span,
                format!("{station:.0} m along the line the bed would lie {depth:.2} m deep"),
            )
            .hint(
                "water runs from the first point to the last; turn the line around, lead it \
                   along lower ground, or raise `max_depth`",
            )),
            _ => Ok(()),
        }
    }
}

/// A bed along a line.
#[derive(Clone, Debug)]
pub(crate) struct Channel {
    line: Polyline,
    /// Altitude of the bed at every `spacing` metres, never rising.
    bed: Vec<f64>,
    spacing: f64,
    cut: StreamCut,
}

impl Channel {
    /// A bed whose altitude `level(point)` gives along the whole line.
    pub fn over(
        line: Polyline,
        cut: StreamCut,
        cell: f64,
        level: impl Fn([f64; 2]) -> f64,
    ) -> Self {
        let count = (line.length() / (SAMPLE_CELLS * cell)).ceil().clamp(1.0, MAX_SAMPLES);
        let spacing = line.length() / count;
        let bed =
            (0..=count as usize).map(|index| level(line.at(index as f64 * spacing))).collect();
        Self { line, bed, spacing, cut }
    }

    /// Altitudes of the bed at every [`Self::spacing`] metres.
    pub fn levels(&self) -> &[f64] {
        &self.bed
    }

    /// Replaces the altitudes of the bed by as many others.
    pub fn set_levels(&mut self, levels: Vec<f64>) {
        assert_eq!(levels.len(), self.bed.len(), "a bed keeps its length");
        self.bed = levels;
    }

    /// Metres between two altitudes of the bed.
    pub fn spacing(&self) -> f64 {
        self.spacing
    }

    /// Altitude of the bed at a length along the line.
    pub fn bed_at(&self, station: f64) -> f64 {
        let place = (station / self.spacing).clamp(0.0, (self.bed.len() - 1) as f64);
        let index = (place as usize).min(self.bed.len().saturating_sub(2));
        let t = place - index as f64;
        let next = self.bed[(index + 1).min(self.bed.len() - 1)];
        self.bed[index] + t * (next - self.bed[index])
    }

    /// Segments of the line that matter to a row of cells.
    pub fn segments_near_row(&self, y: f64) -> Vec<usize> {
        self.line.segments_near_row(y, self.reach())
    }

    /// Altitude after the cut at a point.
    pub fn shape(&self, segments: &[usize], point: [f64; 2], altitude: f64) -> f64 {
        let Some(near) = self.line.nearest(segments, point) else { return altitude };
        let weight = influence(near.distance, 0.5 * self.cut.width, self.cut.falloff);
        if weight >= 1.0 {
            return self.bed_at(near.station);
        }
        altitude + weight * (self.bed_at(near.station) - altitude)
    }

    /// Level of the water at a point, if the stream carries any there.
    pub fn water_at(&self, segments: &[usize], point: [f64; 2]) -> Option<f64> {
        let near = self.line.nearest(segments, point)?;
        if near.distance > self.reach() {
            return None;
        }
        let running =
            (self.cut.water_depth > 0.0).then(|| self.bed_at(near.station) + self.cut.water_depth);
        running.into_iter().chain(self.cut.water_level).reduce(f64::max)
    }

    /// Whether the stream carries water at all.
    pub fn is_wet(&self) -> bool {
        self.cut.water_depth > 0.0 || self.cut.water_level.is_some()
    }

    /// Distance from the line within which the cut has any effect, m.
    fn reach(&self) -> f64 {
        0.5 * self.cut.width + self.cut.falloff
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::spline::smoothstep;
    use weald_contract::Span;

    fn cut(points: Vec<[f64; 2]>) -> StreamCut {
        StreamCut {
            points: Written { value: points, span: Span { source: 0, start: 3, end: 9 } },
            curved: false,
            width: 4.0,
            depth: 1.0,
            falloff: 3.0,
            fall: 0.0,
            max_depth: None,
            water_depth: 0.0,
            water_level: None,
        }
    }

    #[test]
    fn a_cut_is_bed_inside_its_width_ramped_on_its_banks_and_ground_beyond() {
        let channel = cut(vec![[0.0, 0.0], [100.0, 0.0]]).run(1.0, |_, _| 10.0).unwrap();
        for distance in [0.0, 0.5, 1.0, 2.0, 2.5, 3.0, 4.0, 4.99, 5.0, 9.0] {
            let expected = 9.0 + smoothstep(2.0, 5.0, distance);
            let got = channel.shape(&[0], [50.0, distance], 10.0);
            assert!((got - expected).abs() < 1e-12, "{distance}: {got} is not {expected}");
        }
    }

    #[test]
    fn a_bed_never_runs_uphill_and_lies_at_least_its_depth_below_the_ground() {
        let ground = |x: f64, _: f64| (10.0 - 0.02 * x + 0.7 * (0.3 * x).sin()) as f32;
        let mut stream = cut(vec![[0.0, 0.0], [40.0, 10.0], [100.0, 0.0]]);
        stream.fall = 0.001;
        let channel = stream.run(1.0, ground).unwrap();
        assert!(channel.bed.windows(2).all(|pair| pair[1] <= pair[0] - 0.001 * 0.49));
        for (index, bed) in channel.bed.iter().enumerate() {
            let [x, y] = channel.line.at(index as f64 * channel.spacing);
            assert!(*bed <= f64::from(ground(x, y)) - 1.0 + 1e-9);
        }
    }

    #[test]
    fn a_line_drawn_from_mouth_to_source_is_refused_at_its_points_with_the_way_out() {
        let mut stream = cut(vec![[0.0, 0.0], [100.0, 0.0]]);
        stream.max_depth = Some(2.5);
        let problem = stream.run(1.0, |x, _| (0.1 * x) as f32).unwrap_err();
        assert_eq!(problem.span, Some(stream.points.span));
        assert!(problem.to_string().contains("turn the line around"), "{problem}");
    }

    #[test]
    fn water_stands_at_its_level_or_runs_above_the_bed() {
        let mut stream = cut(vec![[0.0, 0.0], [100.0, 0.0]]);
        stream.water_depth = 0.3;
        let channel = stream.run(1.0, |x, _| (20.0 - 0.1 * x) as f32).unwrap();
        assert!((channel.water_at(&[0], [50.0, 1.0]).unwrap() - 14.3).abs() < 1e-6);
        assert_eq!(channel.water_at(&[0], [50.0, 6.0]), None);
    }
}
