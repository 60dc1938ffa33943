//! Operators: what one layer of the stack does to altitude.

use crate::breach::Breach;
use crate::config::{Config, LayerCommon};
use crate::erosion::{Erode, Thermal};
use crate::noise::NoiseShape;
use crate::overlay::LayerEdit;
use crate::road::Road;
use crate::stamp::{Crater, Hill, Remap, Translate};
use crate::stream::StreamCut;
use weald_contract::{Problem, Problems, Written, choice, table, words};

choice! {
    /// One operator, named by its `op`.
    pub enum Operator by "op" {
        /// Adds gradient noise of several scales.
        "noise" => Noise(Noise),
        /// Lets water stand in a hollow.
        "lake" => Lake(Lake),
        /// Cuts a stream or ditch along a line.
        "stream" => Stream(StreamCut),
        /// Averages with the neighbourhood.
        "smooth" => Smooth(Smooth),
        /// Makes steps.
        "terrace" => Terrace(Terrace),
        /// Sets one altitude.
        "flatten" => Flatten(Flatten),
        /// Raises or lowers.
        "offset" => Offset(Offset),
        /// Stretches heights.
        "scale" => Scale(Scale),
        /// Limits altitude.
        "clamp" => Clamp(Clamp),
        /// Moves the ground sideways.
        "translate" => Translate(Translate),
        /// Scales heights along a curve.
        "curve" => Curve(Remap),
        /// Lays a road or path along a line.
        "road" => Road(Road),
        /// Sets a hill into the ground.
        "hill" => Hill(Hill),
        /// Sets a crater into the ground.
        "crater" => Crater(Crater),
        /// Lets streams cut down and slopes creep.
        "erode" => Erode(Erode),
        /// Lets what is too steep slide down.
        "thermal" => Thermal(Thermal),
        /// Opens hollows by ditches.
        "breach" => Breach(Breach),
        /// Replaces or blends a finished layer.
        "layer" => Layer(LayerEdit),
    }
}

words! {
    /// How an operator's result joins what was there, before the mask weighs it.
    pub enum Blend {
        /// The result takes its place.
        Replace = "replace",
        /// The higher of the two: an operator that may only build up.
        Max = "max",
        /// The lower of the two: an operator that may only cut.
        Min = "min",
        /// The sum of the two.
        Add = "add",
        /// What was there less the result.
        Subtract = "subtract",
        /// The product of the two.
        Multiply = "multiply",
        /// How far apart the two are.
        Difference = "difference",
        /// The mean of the two.
        Mean = "mean",
    }
}

table! {
    /// Noise: octaves of Perlin noise added together.
    pub struct Noise {
        /// Bound of the added height, m; typical heights are a quarter of it.
        amplitude: f64, in -100000.0..=100000.0;
        /// Wavelength of the largest octave, m.
        wavelength: Written<f64>, in 0.001..=10000000.0;
        /// Character of the noise.
        kind: crate::noise::NoiseKind = crate::noise::NoiseKind::Fbm;
        /// Number of octaves. Those finer than a grid can show are left to finer grids.
        octaves: u32 = 6, in 1.0..=24.0;
        /// Amplitude of an octave relative to the one before.
        roughness: f64 = 0.5, in 0.0..=1.0;
        /// How much roughness varies over the ground: by factors of up to 2 to this power.
        roughness_change: f64 = 0.0, in 0.0..=4.0;
        /// Wavelength of an octave relative to the next finer one.
        lacunarity: f64 = 2.0, in 1.1..=8.0;
        /// How far the noise is dragged out of place, m: ridges bend and crowd.
        warp: f64 = 0.0, in 0.0..=1000000.0;
    }
}

table! {
    /// A lake: water stands in the hollow around a point up to a level.
    ///
    /// Lakes are filled when the stack is done, so that later operators shape their shores.
    pub struct Lake {
        /// A point under water, scene coordinates, m.
        at: Written<[f64; 2]>, in -1000000.0..=1000000.0;
        /// Altitude of the surface, m.
        level: Written<f64>, in -100000.0..=100000.0;
    }
}

table! {
    /// Gaussian smoothing.
    pub struct Smooth {
        /// Standard deviation of the weights, m.
        radius: f64, in 0.0..=10000.0;
    }
}

table! {
    /// Terraces: level treads with risers between.
    pub struct Terrace {
        /// Height of a step, m.
        step: f64, in 0.001..=10000.0;
        /// Altitude of one of the treads, m.
        base: f64 = 0.0, in -100000.0..=100000.0;
        /// 0 for soft waves, 1 for vertical risers.
        sharpness: f64 = 0.7, in 0.0..=1.0;
    }
}

table! {
    /// One altitude.
    pub struct Flatten {
        /// The altitude, m.
        altitude: f64, in -100000.0..=100000.0;
    }
}

table! {
    /// Raising or lowering.
    pub struct Offset {
        /// Added height, m; negative lowers.
        by: f64, in -100000.0..=100000.0;
    }
}

table! {
    /// Stretching heights about an altitude.
    pub struct Scale {
        /// Factor on heights.
        factor: f64, in -1000.0..=1000.0;
        /// Altitude that stays, m.
        about: f64 = 0.0, in -100000.0..=100000.0;
    }
}

table! {
    /// Limits of altitude.
    pub struct Clamp {
        /// Lowest altitude, m.
        low: Option<f64> = None, in -100000.0..=100000.0;
        /// Highest altitude, m.
        high: Option<Written<f64>> = None, in -100000.0..=100000.0;
    }
}

impl Blend {
    /// What was there, joined with an operator's result.
    pub(crate) fn join(self, before: f64, result: f64) -> f64 {
        match self {
            Self::Replace => result,
            Self::Max => result.max(before),
            Self::Min => result.min(before),
            Self::Add => before + result,
            Self::Subtract => before - result,
            Self::Multiply => before * result,
            Self::Difference => (before - result).abs(),
            Self::Mean => 0.5 * (before + result),
        }
    }
}

impl Noise {
    /// The noise as a shape, without its amplitude.
    pub(crate) fn shape(&self) -> NoiseShape {
        NoiseShape {
            kind: self.kind,
            wavelength: self.wavelength.value,
            octaves: self.octaves,
            roughness: self.roughness,
            roughness_change: self.roughness_change,
            lacunarity: self.lacunarity,
            warp: self.warp,
        }
    }
}

impl Terrace {
    /// The stepped altitude: treads at `base + k step`, risers of `1 - sharpness` of a step's run.
    pub(crate) fn at(&self, altitude: f64) -> f64 {
        let steps = (altitude - self.base) / self.step;
        let tread = steps.floor();
        let riser = 0.5 * (1.0 - self.sharpness);
        let rise = crate::spline::smoothstep(0.5 - riser, 0.5 + riser, steps - tread);
        self.base + self.step * (tread + rise)
    }
}

impl Clamp {
    /// The limited altitude.
    pub(crate) fn at(&self, altitude: f64) -> f64 {
        let raised = self.low.map_or(altitude, |low| altitude.max(low));
        self.high.as_ref().map_or(raised, |high| raised.min(high.value))
    }
}

impl Operator {
    /// Notes what is wrong with the operator's own numbers.
    pub(crate) fn check(&self, common: &LayerCommon, config: &Config, problems: &mut Problems) {
        match self {
            Self::Stream(stream) => stream.check(problems),
            Self::Road(road) => road.check(problems),
            Self::Curve(curve) => curve.check(problems),
            Self::Layer(edit) => edit.check(config, problems),
            Self::Lake(lake) if !common.mask.0.is_empty() => problems.push(
                Problem::at(lake.at.span, "a lake fills its whole hollow and takes no mask")
                    .hint("remove `mask`, or shape the hollow with other operators"),
            ),
            Self::Clamp(Clamp { low: Some(low), high: Some(high) }) if *low > high.value => {
                problems.push(
                    Problem::at(high.span, format!("`high` is below `low`, which is {low}"))
                        .hint("`low` must not exceed `high`"),
                );
            }
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn terraces_keep_their_treads_and_rise_halfway_between_them() {
        let terrace = Terrace { step: 2.0, base: 1.0, sharpness: 0.8 };
        assert_eq!([1.0, 3.0, 5.0].map(|z| terrace.at(z)), [1.0, 3.0, 5.0]);
        assert_eq!(terrace.at(1.5), 1.0, "a tread is level");
        assert_eq!(terrace.at(2.0), 2.0, "halfway up the riser");
        assert_eq!(terrace.at(2.5), 3.0, "the next tread");
        let cliffs = Terrace { sharpness: 1.0, ..terrace };
        assert_eq!([1.99, 2.01].map(|z| cliffs.at(z)), [1.0, 3.0]);
    }

    #[test]
    fn clamping_needs_only_one_of_its_limits() {
        let low = Clamp { low: Some(2.0), high: None };
        assert_eq!([1.0, 5.0].map(|z| low.at(z)), [2.0, 5.0]);
    }
}
