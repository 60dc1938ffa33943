//! The stack: operators one after another, each on what the last one left.
//!
//! Every operator reads the whole field before it and writes a new one, rows in parallel, so
//! that neither threads nor tiles can change a byte. What only the whole ground can tell (a
//! stream's bed, the slopes under a mask) is found on the terrain's own grid and kept; a finer patch
//! replays the stack with it, and so shapes the same ground.
//!
//! Results may be kept ([`Cache`]): a step is found again when the ground before it and the operator
//! itself are the same, so evaluation starts at the first change, and undoing one is no work.

use crate::config::{Config, LayerCommon};
use crate::import::Ground;
use crate::lattice::Lattice;
use crate::mask::{self, Map, Row, Whole};
use crate::noise::Fractal;
use crate::operator::{Blend, Lake, Operator};
use crate::resample::{by_row, gaussian, gaussian_reach};
use crate::stream::Channel;
use crate::{Error, check_cancelled};
use rayon::prelude::*;
use std::borrow::Cow;
use std::sync::Arc;
use weald_contract::table::Tagged;
use weald_contract::{Problem, Progress, Seed, Span};

/// Ground after the last operator, and what is needed to shape finer patches of it alike.
pub(crate) struct Shaped<'a> {
    /// The terrain's cells.
    pub lattice: Lattice,
    /// Altitudes, m.
    pub altitude: Vec<f32>,
    /// Lakes, which are filled when the stack is done.
    pub lakes: Vec<&'a Lake>,
    /// The operators that shape the ground, in order.
    pub layers: Vec<Layer<'a>>,
}

/// An operator with what was found out about it on the terrain's own grid.
#[derive(Clone)]
pub(crate) struct Layer<'a> {
    op: &'a Tagged<LayerCommon, Operator>,
    found: Arc<Found>,
}

/// What an operator learns from the terrain's own grid.
struct Found {
    seed: u32,
    /// The bed, if this is a stream or a road.
    channel: Option<Channel>,
    /// What an operator that needs the whole ground does to it, m; finer patches take the same.
    change: Option<Vec<f32>>,
    /// The terrain's own cells.
    whole: Lattice,
    /// The mask's values on the terrain's grid, kept where they depend on its fineness.
    weights: Option<Vec<f32>>,
}

/// Runs the stack over the whole ground.
pub(crate) fn shape<'a>(
    config: &'a Config,
    ground: &Ground,
    map: &Map<'_>,
    seed: Seed,
    cache: &mut Cache,
    progress: &dyn Progress,
) -> Result<Shaped<'a>, Error> {
    let lattice = Lattice::of(&ground.frame);
    let mut altitude = Arc::new(ground.altitude.clone());
    let (mut lakes, mut layers) = (Vec::new(), Vec::new());
    let mut before = START;
    progress.begin("operators", config.op.len() as u64, "operators");
    for (index, op) in config.op.iter().enumerate() {
        check_cancelled(progress)?;
        match &op.variant {
            _ if !op.common.enabled => {}
            Operator::Lake(lake) => lakes.push(lake),
            // Layers are edited when they are made.
            Operator::Layer(_) => {}
            _ => {
                let step = Step { before, index, op, is_for_patches: !config.detail.is_empty() };
                let (found, after);
                (before, found, after) = match cache.find(&step) {
                    Some(kept) => kept,
                    None => {
                        let (found, after) = step.run(seed, &lattice, &altitude, map)?;
                        let (found, after) = (Arc::new(found), Arc::new(after));
                        (cache.keep(&step, &found, &after), found, after)
                    }
                };
                altitude = after;
                layers.push(Layer { op, found });
            }
        }
        progress.advance(1);
    }
    check_finite(&altitude, config.source.span)?;
    let altitude = Arc::try_unwrap(altitude).unwrap_or_else(|kept| kept.to_vec());
    Ok(Shaped { lattice, altitude, lakes, layers })
}

/// Ground of a part of the terrain after the last operator, for a view that waits: only the part is
/// shaped, from the last step that is kept, unless an operator needs the whole ground.
pub(crate) fn shape_part(
    config: &Config,
    ground: &Ground,
    map: &Map<'_>,
    seed: Seed,
    part: &Lattice,
    cache: &mut Cache,
    progress: &dyn Progress,
) -> Result<Vec<f32>, Error> {
    let lattice = Lattice::of(&ground.frame);
    let is_for_patches = !config.detail.is_empty();
    let shaping = |op: &&(usize, &Tagged<LayerCommon, Operator>)| {
        op.1.common.enabled && !matches!(op.1.variant, Operator::Lake(_) | Operator::Layer(_))
    };
    let ops: Vec<(usize, &Tagged<LayerCommon, Operator>)> = config.op.iter().enumerate().collect();
    let mut ops: Vec<_> = ops.iter().filter(shaping).collect();
    let (mut before, mut altitude) = (START, None);
    while let Some((index, op)) = ops.first() {
        let step = Step { before, index: *index, op, is_for_patches };
        let Some((id, _, after)) = cache.find(&step) else { break };
        (before, altitude) = (id, Some(after));
        ops.remove(0);
    }
    if ops.iter().any(|(_, op)| needs_whole(op)) {
        let shaped = shape(config, ground, map, seed, cache, progress)?;
        return Ok(lattice.crop(&shaped.altitude, part));
    }
    let start: &[f32] = altitude.as_ref().map_or(&ground.altitude, |kept| kept.as_slice());
    let found = |(index, op): &&(usize, &Tagged<LayerCommon, Operator>)| {
        Found::new(op, *index, seed, &lattice, start).map(Arc::new)
    };
    let layers: Result<Vec<Layer<'_>>, Problem> =
        ops.iter().map(|step| Ok(Layer { op: step.1, found: found(step)? })).collect();
    let shaped = Shaped { lattice, altitude: Vec::new(), lakes: Vec::new(), layers: layers? };
    let wide = part.grown(halo(&shaped.layers, lattice.cell), &lattice);
    let after = replay(&shaped, &wide, lattice.crop(start, &wide), map, progress)?;
    Ok(wide.crop(&after, part))
}

/// Whether an operator's effect at a place depends on ground however far away.
fn needs_whole(op: &Tagged<LayerCommon, Operator>) -> bool {
    // Each is named, so that a new operator must say which it is.
    let is_whole = match op.variant {
        Operator::Stream(_)
        | Operator::Road(_)
        | Operator::Erode(_)
        | Operator::Thermal(_)
        | Operator::Breach(_) => true,
        Operator::Noise(_)
        | Operator::Lake(_)
        | Operator::Smooth(_)
        | Operator::Terrace(_)
        | Operator::Flatten(_)
        | Operator::Offset(_)
        | Operator::Scale(_)
        | Operator::Clamp(_)
        | Operator::Translate(_)
        | Operator::Curve(_)
        | Operator::Hill(_)
        | Operator::Crater(_)
        | Operator::Layer(_) => false,
    };
    is_whole || op.common.mask.reads_flow()
}

/// One operator and the ground it meets.
struct Step<'a> {
    /// The kept step whose result it meets.
    before: StepId,
    /// Its place in the list, on which its chance hangs.
    index: usize,
    op: &'a Tagged<LayerCommon, Operator>,
    /// Whether finer patches will follow.
    is_for_patches: bool,
}

/// Number of a step that ran; each number is given once.
type StepId = u64;

/// The ground before the first operator.
const START: StepId = 0;

/// Results of steps that ran, up to a limit of memory; those longest unused go first.
///
/// Holds for one ground, one seed and one set of images.
pub(crate) struct Cache {
    kept: Vec<Kept>,
    /// Bytes that may be held.
    limit: usize,
    last: StepId,
    clock: u64,
}

struct Kept {
    id: StepId,
    before: StepId,
    index: usize,
    op: Tagged<LayerCommon, Operator>,
    is_for_patches: bool,
    found: Arc<Found>,
    altitude: Arc<Vec<f32>>,
    used: u64,
}

impl Cache {
    /// A cache that holds up to `limit` bytes.
    pub fn new(limit: usize) -> Self {
        Self { kept: Vec::new(), limit, last: START, clock: 0 }
    }

    /// Forgets all steps.
    pub fn clear(&mut self) {
        self.kept.clear();
    }

    /// Number of steps that are held.
    pub fn len(&self) -> usize {
        self.kept.len()
    }

    fn find(&mut self, step: &Step<'_>) -> Option<(StepId, Arc<Found>, Arc<Vec<f32>>)> {
        self.clock += 1;
        let kept = self.kept.iter_mut().find(|kept| {
            kept.before == step.before
                && kept.index == step.index
                && kept.is_for_patches == step.is_for_patches
                && kept.op == *step.op
        })?;
        kept.used = self.clock;
        Some((kept.id, kept.found.clone(), kept.altitude.clone()))
    }

    fn keep(&mut self, step: &Step<'_>, found: &Arc<Found>, altitude: &Arc<Vec<f32>>) -> StepId {
        self.last += 1;
        let size = |kept: &Kept| 4 * kept.altitude.len() + kept.found.size();
        let kept = Kept {
            id: self.last,
            before: step.before,
            index: step.index,
            op: step.op.clone(),
            is_for_patches: step.is_for_patches,
            found: found.clone(),
            altitude: altitude.clone(),
            used: self.clock,
        };
        self.kept.push(kept);
        while self.kept.iter().map(size).sum::<usize>() > self.limit {
            let oldest = self.kept.iter().enumerate().min_by_key(|(_, kept)| kept.used);
            let Some((oldest, _)) = oldest else { break };
            self.kept.remove(oldest);
        }
        self.last
    }
}

/// Factors may multiply up to heights that single precision does not hold.
pub(crate) fn check_finite(altitude: &[f32], span: Span) -> Result<(), Problem> {
    if altitude.iter().all(|z| z.is_finite()) {
        return Ok(());
    }
    Err(Problem::at(span, "the operators raise the ground beyond all numbers")
        .hint("look for a large `factor` or `amplitude`"))
}

/// Runs the stack over a patch whose cells differ from the terrain's.
pub(crate) fn replay(
    shaped: &Shaped<'_>,
    lattice: &Lattice,
    mut altitude: Vec<f32>,
    map: &Map<'_>,
    progress: &dyn Progress,
) -> Result<Vec<f32>, Error> {
    for layer in &shaped.layers {
        check_cancelled(progress)?;
        let weights = match &layer.found.weights {
            Some(weights) => sample(&shaped.lattice, weights, lattice),
            None => layer.weights(lattice, &altitude, map)?,
        };
        altitude = layer.apply(lattice, &altitude, &weights);
    }
    Ok(altitude)
}

/// Cells around a patch that its values depend on: each operator looks so far at what the one
/// before left.
pub(crate) fn halo(layers: &[Layer<'_>], cell: f64) -> usize {
    layers.iter().map(|layer| layer.reach(cell)).sum()
}

/// Bilinear values of one lattice at the cells of another, of those that are numbers.
pub(crate) fn sample(from: &Lattice, values: &[f32], to: &Lattice) -> Vec<f32> {
    let frame = from.frame((0.0, 0.0));
    by_row(to.width, to.height, |row, out| {
        let y = to.y(row);
        for (column, out) in out.iter_mut().enumerate() {
            let corners = frame.bilinear(to.x(column), y);
            *out = corners.iter().map(|&(index, weight)| values[index] * weight).sum();
            if out.is_nan() {
                let known = corners.iter().filter(|(index, _)| !values[*index].is_nan());
                let (sum, weight) = known.fold((0.0, 0.0), |(sum, total), &(index, weight)| {
                    (sum + values[index] * weight, total + weight)
                });
                *out = sum / weight;
            }
        }
    })
}

impl<'a> Step<'a> {
    /// Runs the operator over the whole ground.
    fn run(
        &self,
        seed: Seed,
        lattice: &Lattice,
        altitude: &[f32],
        map: &Map<'_>,
    ) -> Result<(Found, Vec<f32>), Problem> {
        let found = Arc::new(Found::new(self.op, self.index, seed, lattice, altitude)?);
        let layer = Layer { op: self.op, found: found.clone() };
        let weights = layer.weights(lattice, altitude, map)?;
        let after = layer.apply(lattice, altitude, &weights);
        // Finer patches need the change, and masks that see how fine a grid is.
        let is_needed = self.is_for_patches && self.op.common.mask.reads_slope();
        let Found { seed, whole, .. } = *found;
        let kept = Found {
            seed,
            whole,
            channel: found.channel.clone(),
            change: found.change.clone().filter(|_| self.is_for_patches),
            weights: is_needed.then_some(weights),
        };
        Ok((kept, after))
    }
}

impl Found {
    fn new(
        op: &Tagged<LayerCommon, Operator>,
        index: usize,
        seed: Seed,
        lattice: &Lattice,
        altitude: &[f32],
    ) -> Result<Self, Problem> {
        // A name keeps an operator's chance when others come before it.
        let mut stream = match &op.common.name {
            Some(name) => seed.stream(&format!("operator {name}"), 0),
            None => seed.stream("operator", index as u64),
        };
        let frame = lattice.frame((0.0, 0.0));
        let ground = |x: f64, y: f64| frame.sample(altitude, x, y);
        let channel = match &op.variant {
            Operator::Stream(cut) => Some(cut.run(lattice.cell, ground)?),
            Operator::Road(road) => Some(road.lay(lattice.cell, ground)?),
            _ => None,
        };
        let after = match &op.variant {
            Operator::Erode(erode) => Some(erode.run(lattice, altitude)),
            Operator::Thermal(thermal) => Some(thermal.run(lattice, altitude)),
            Operator::Breach(breach) => Some(breach.run(lattice, altitude)),
            _ => None,
        };
        let change = after.map(|after| after.iter().zip(altitude).map(|(a, b)| a - b).collect());
        let seed = stream.next_u64() as u32;
        Ok(Self { seed, channel, change, whole: *lattice, weights: None })
    }

    /// Bytes that it holds.
    fn size(&self) -> usize {
        let fields = [&self.change, &self.weights];
        fields.iter().filter_map(|field| field.as_ref()).map(|field| 4 * field.len()).sum()
    }
}

impl Layer<'_> {
    /// The bed and what it carries, if this is a stream with water.
    pub fn wet_channel(&self) -> Option<&Channel> {
        self.found.channel.as_ref().filter(|channel| channel.is_wet())
    }

    /// How many cells away this operator looks.
    fn reach(&self, cell: f64) -> usize {
        let by_operator = match &self.op.variant {
            Operator::Smooth(smooth) => gaussian_reach(smooth.radius, cell),
            Operator::Translate(translate) => translate.reach(cell),
            _ => 0,
        };
        by_operator.max(usize::from(self.op.common.mask.reads_slope()))
    }

    /// The mask times the strength, for every cell.
    fn weights(
        &self,
        lattice: &Lattice,
        altitude: &[f32],
        map: &Map<'_>,
    ) -> Result<Vec<f32>, Problem> {
        let masks = self.op.common.mask.prepare(map, lattice.cell)?;
        let strength = self.op.common.strength as f32;
        let whole = Whole::of(&self.op.common.mask, lattice, altitude);
        Ok(by_row(lattice.width, lattice.height, |row, weights| {
            weights.fill(strength);
            mask::apply(&masks, &Row { lattice, altitude, row, whole: whole.as_ref() }, weights);
        }))
    }

    /// `lerp(in, op(in), mask)` for every cell.
    fn apply(&self, lattice: &Lattice, altitude: &[f32], weights: &[f32]) -> Vec<f32> {
        let Lattice { width, height, cell, .. } = *lattice;
        let joined = Joined { lattice, altitude, weights, blend: self.op.common.blend };
        match &self.op.variant {
            Operator::Noise(noise) => {
                let fractal = Fractal::new(noise.shape(), self.found.seed, cell);
                joined.each(|_, y| {
                    let fractal = &fractal;
                    move |x, _, z| z + noise.amplitude * fractal.at(x, y)
                })
            }
            Operator::Stream(_) | Operator::Road(_) => match &self.found.channel {
                Some(channel) => joined.each(|_, y| {
                    let segments = channel.segments_near_row(y);
                    move |x, _, z| channel.shape(&segments, [x, y], z)
                }),
                None => altitude.to_vec(),
            },
            Operator::Smooth(smooth) => {
                let smoothed = gaussian(width, height, cell, altitude, smooth.radius);
                joined.each(|row, _| {
                    let line = &smoothed[row * width..][..width];
                    move |_, column, _| f64::from(line[column])
                })
            }
            Operator::Terrace(terrace) => joined.each(|_, _| |_, _, z| terrace.at(z)),
            Operator::Flatten(flatten) => joined.each(|_, _| |_, _, _| flatten.altitude),
            Operator::Offset(offset) => joined.each(|_, _| |_, _, z| z + offset.by),
            Operator::Scale(scale) => {
                joined.each(|_, _| |_, _, z| scale.about + scale.factor * (z - scale.about))
            }
            Operator::Clamp(clamp) => joined.each(|_, _| |_, _, z| clamp.at(z)),
            Operator::Hill(hill) => joined.each(|_, y| move |x, _, z| hill.at(x, y, z)),
            Operator::Crater(crater) => joined.each(|_, y| move |x, _, z| crater.at(x, y, z)),
            Operator::Curve(curve) => {
                let tangents = curve.tangents();
                joined.each(|_, _| |_, _, z| curve.at(&tangents, z))
            }
            Operator::Translate(translate) => {
                let moved = translate.run(lattice, altitude);
                joined.each(|row, _| {
                    let line = &moved[row * width..][..width];
                    move |_, column, _| f64::from(line[column])
                })
            }
            Operator::Erode(_) | Operator::Thermal(_) | Operator::Breach(_) => {
                let change = self.change_on(lattice);
                joined.each(|row, _| {
                    let line = &change[row * width..][..width];
                    move |_, column, z| z + f64::from(line[column])
                })
            }
            Operator::Lake(_) | Operator::Layer(_) => altitude.to_vec(),
        }
    }
}

impl Layer<'_> {
    /// What the operator does to the ground, at the cells of a lattice.
    fn change_on(&self, lattice: &Lattice) -> Cow<'_, [f32]> {
        let whole = &self.found.whole;
        match &self.found.change {
            None => vec![0.0; lattice.len()].into(),
            Some(change) if lattice == whole => change.into(),
            Some(change) if lattice.cell == whole.cell => whole.crop(change, lattice).into(),
            Some(change) => sample(whole, change, lattice).into(),
        }
    }
}

/// A field, and how an operator's result joins it.
struct Joined<'a> {
    lattice: &'a Lattice,
    altitude: &'a [f32],
    weights: &'a [f32],
    blend: Blend,
}

impl Joined<'_> {
    /// Every cell after the operator. `along(row, y)` prepares a row and gives the operator there:
    /// x, column and altitude before to altitude after.
    fn each<F: Fn(f64, usize, f64) -> f64>(
        &self,
        along: impl Fn(usize, f64) -> F + Sync,
    ) -> Vec<f32> {
        let width = self.lattice.width;
        let mut after = self.altitude.to_vec();
        let rows = after.par_chunks_mut(width).zip(self.weights.par_chunks(width)).enumerate();
        rows.for_each(|(row, (line, weights))| {
            let op = along(row, self.lattice.y(row));
            for (column, (z, &weight)) in line.iter_mut().zip(weights).enumerate() {
                if weight > 0.0 {
                    let before = f64::from(*z);
                    let result = op(self.lattice.x(column), column, before);
                    let result = self.blend.join(before, result);
                    let weight = f64::from(weight);
                    // Full weight gives the result itself, without rounding on the way.
                    let is_full = weight >= 1.0;
                    *z = if is_full { result } else { before + weight * (result - before) } as f32;
                }
            }
        });
        after
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::BTreeMap;
    use weald_contract::{Frame, FromToml, Silent, Value};

    const FRAME: Frame = Frame { width: 90, height: 70, cell: 1.0, west: 429_252.313, south: 77.7 };

    const STACK: &str = r#"
        source = "dem.tif"
        [[op]]
        op = "noise"
        amplitude = 2
        wavelength = 20
        roughness_change = 1
        [[op]]
        op = "smooth"
        radius = 1.3
        mask = { slope_deg = [3, 90], falloff = 3 }
        [[op]]
        op = "stream"
        points = [[5, 60], [40, 30], [85, 20]]
        width = 3
        depth = 1
        falloff = 4
        [[op]]
        op = "terrace"
        step = 2
        strength = 0.5
        mask = { formula = "slope / 20", noise = { wavelength = 15 } }
    "#;

    fn ground() -> Ground {
        let z = |i: usize| {
            let (x, y) = ((i % FRAME.width) as f64, (i / FRAME.width) as f64);
            (380.0 + 0.1 * x + 3.0 * (0.1 * y).sin()) as f32
        };
        let altitude = (0..FRAME.len()).map(z).collect();
        Ground { frame: FRAME, altitude, source: None, mended: 0, holes: None }
    }

    fn config(text: &str) -> Config {
        Config::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap()
    }

    #[test]
    fn a_tile_with_its_halo_has_the_bytes_of_the_whole() {
        let (config, ground, images) = (config(STACK), ground(), BTreeMap::new());
        let map = Map { frame: FRAME, images: &images };
        let shaped = shape(&config, &ground, &map, Seed(3), &mut Cache::new(0), &Silent).unwrap();
        let whole = shaped.lattice;
        for (west, south, width, height) in [(0, 0, 31, 17), (29, 16, 40, 40), (69, 50, 21, 20)] {
            let tile = Lattice { cell: 1.0, west, south, width, height };
            let wide = tile.grown(halo(&shaped.layers, 1.0), &whole);
            assert!(wide.len() < whole.len());
            let start = whole.crop(&ground.altitude, &wide);
            let replayed = replay(&shaped, &wide, start, &map, &Silent).unwrap();
            assert_eq!(wide.crop(&replayed, &tile), whole.crop(&shaped.altitude, &tile));
        }
    }

    #[test]
    fn a_named_operator_keeps_its_noise_when_others_come_before_it() {
        let named = |before: &str| {
            let noise = "[[op]]\nop = \"noise\"\nname = \"hills\"\namplitude = 1\nwavelength = 9\n";
            let (config, ground) = (config(&format!("source = \"d\"\n{before}{noise}")), ground());
            let images = BTreeMap::new();
            let map = Map { frame: FRAME, images: &images };
            shape(&config, &ground, &map, Seed(3), &mut Cache::new(0), &Silent).unwrap().altitude
        };
        let nothing = "[[op]]\nop = \"offset\"\nby = 0\n";
        assert_eq!(named(""), named(nothing));
    }

    #[test]
    fn blending_keeps_the_higher_or_the_lower_and_masks_interpolate() {
        let after = |text: &str| {
            let (config, ground, images) = (config(text), ground(), BTreeMap::new());
            let map = Map { frame: FRAME, images: &images };
            shape(&config, &ground, &map, Seed(3), &mut Cache::new(0), &Silent).unwrap().altitude
        };
        let before = ground().altitude;
        let flat = "source = \"d\"\n[[op]]\nop = \"flatten\"\naltitude = 384\n";
        assert!(after(flat).iter().all(|z| *z == 384.0));
        let max = after(&format!("{flat}blend = \"max\""));
        assert!(max.iter().zip(&before).all(|(z, was)| *z == was.max(384.0)));
        let min = after(&format!("{flat}blend = \"min\""));
        assert!(min.iter().zip(&before).all(|(z, was)| *z == was.min(384.0)));
        let half = after(&format!("{flat}strength = 0.5"));
        assert!(half.iter().zip(&before).all(|(z, was)| (z - 0.5 * (was + 384.0)).abs() < 1e-4));
        assert_eq!(after(&format!("{flat}enabled = false")), before);
    }
}
