//! Editing a finished layer: soil that a map knows better, water that a painter wants.
//!
//! Such operators run when all layers are made, in the order of the stack, under masks that see the
//! finished ground.

use crate::config::{Config, LayerCommon};
use crate::environment;
use crate::lattice::Lattice;
use crate::mask::{self, Map, Row, Whole};
use crate::operator::{Blend, Operator};
use crate::resample::by_row;
use weald_contract::formula::Variable;
use weald_contract::{Formula, Layers, Problem, Problems, Written, table};

table! {
    /// Replacing or blending a layer; the mask says where, `blend` says how.
    pub struct LayerEdit {
        /// Name of the layer.
        layer: Written<String>;
        /// One value for all cells, in the layer's unit.
        value: Option<f64> = None, in -1e9..=1e9;
        /// An image over the whole terrain; black and white are the ends of `range`.
        image: Option<Written<String>> = None;
        /// Values of black and white, in the layer's unit.
        range: [f64; 2] = [0.0, 1.0], in -1e9..=1e9;
        /// A formula over the finished layers, `x` and `y` (m).
        formula: Option<Written<Formula>> = None;
    }
}

impl LayerEdit {
    /// Notes what is wrong with the edit's own words.
    pub(crate) fn check(&self, config: &Config, problems: &mut Problems) {
        environment::check_names(std::slice::from_ref(&self.layer), problems);
        if matches!(self.layer.value.as_str(), "altitude" | "normal") {
            let message = format!("`{}` is not edited as a layer", self.layer.value);
            problems.push(
                Problem::at(self.layer.span, message).hint("shape the ground with other operators"),
            );
        }
        let given = [self.value.is_some(), self.image.is_some(), self.formula.is_some()];
        if given.iter().filter(|given| **given).count() != 1 {
            problems.push(
                Problem::at(self.layer.span, "a layer takes its values from one thing")
                    .hint("write one of `value`, `image` and `formula`"),
            );
        }
        self.check_formula(config, problems);
    }

    fn check_formula(&self, config: &Config, problems: &mut Problems) {
        let Some(formula) = &self.formula else { return };
        let known = environment::wanted(config);
        for (variable, span) in formula.value.variables().iter().zip(formula.value.spans()) {
            let is_known = match variable {
                Variable::Layer(name) => known.contains(name.as_str()),
                Variable::X | Variable::Y => true,
                Variable::CrownShadow(_) => false,
            };
            if !is_known {
                // Past the opening quote.
                let span = formula.span.narrow(span.start + 1..span.end + 1);
                let names: Vec<&str> = known.iter().copied().collect();
                problems.push(
                    Problem::at(span, "the terrain has no layer of this name")
                        .hint(format!("known here: {}, x, y", names.join(", "))),
                );
            }
        }
    }
}

/// Runs all layer edits over the layers of a lattice.
pub(crate) fn run(
    config: &Config,
    lattice: &Lattice,
    map: &Map<'_>,
    layers: &mut Layers,
) -> Result<(), Problem> {
    for op in config.op.iter().filter(|op| op.common.enabled) {
        if let Operator::Layer(edit) = &op.variant {
            let values = edited(edit, &op.common, lattice, map, layers)?;
            if let Some(layer) = layers.layers.get_mut(&edit.layer.value) {
                layer.values = values;
                if !layer.definition.ends_with(EDITED) {
                    layer.definition.push_str(EDITED);
                }
            }
        }
    }
    Ok(())
}

/// Said at the end of a definition that no longer holds everywhere.
const EDITED: &str = "; edited in the scene";

fn edited(
    edit: &LayerEdit,
    common: &LayerCommon,
    lattice: &Lattice,
    map: &Map<'_>,
    layers: &Layers,
) -> Result<Vec<f32>, Problem> {
    let Lattice { width, height, .. } = *lattice;
    let missing = || {
        let message = format!("the terrain has no layer `{}`", edit.layer.value);
        Problem::at(edit.layer.span, message)
    };
    let before = layers.values(&edit.layer.value).ok_or_else(missing)?;
    let altitude = layers.values("altitude").ok_or_else(missing)?;
    let masks = common.mask.prepare(map, lattice.cell)?;
    let whole = Whole::of_layers(&common.mask, layers);
    let image = edit.image.as_ref().map(|path| map.image(path)).transpose()?;
    let after = by_row(width, height, |row, out| {
        let mut weights = vec![common.strength as f32; width];
        let place = Row { lattice, altitude, row, whole: whole.as_ref() };
        mask::apply(&masks, &place, &mut weights);
        match (&image, &edit.formula, edit.value) {
            (Some((image, frame)), _, _) => {
                let [black, white] = edit.range.map(|value| value as f32);
                let y = lattice.y(row);
                for (column, out) in out.iter_mut().enumerate() {
                    let pixel = frame.sample(&image.values, lattice.x(column), y);
                    *out = pixel.map_or(f32::NAN, |pixel| black + (white - black) * pixel);
                }
            }
            (None, Some(formula), _) => by_formula(&formula.value, layers, lattice, row, out),
            (None, None, value) => out.fill(value.map_or(f32::NAN, |value| value as f32)),
        }
        let before = &before[row * width..][..width];
        for ((out, before), weight) in out.iter_mut().zip(before).zip(weights) {
            *out = blended(common.blend, *before, *out, weight);
        }
    });
    Ok(after)
}

fn by_formula(formula: &Formula, layers: &Layers, lattice: &Lattice, row: usize, out: &mut [f32]) {
    let width = lattice.width;
    let column_of = |variable: &Variable| match variable {
        Variable::X => (0..width).map(|column| lattice.x(column) as f32).collect(),
        Variable::Y => vec![lattice.y(row) as f32; width],
        Variable::Layer(name) => match layers.values(name) {
            Some(values) => values[row * width..][..width].to_vec(),
            None => vec![f32::NAN; width],
        },
        Variable::CrownShadow(_) => vec![f32::NAN; width],
    };
    let columns: Vec<Vec<f32>> = formula.variables().iter().map(column_of).collect();
    let columns: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
    formula.eval_block(&columns, out);
}

/// The value between what was and what is wanted; what is not finite changes nothing.
fn blended(blend: Blend, before: f32, wanted: f32, weight: f32) -> f32 {
    let result = blend.join(f64::from(before), f64::from(wanted));
    let (before, weight) = (f64::from(before), f64::from(weight));
    let mixed = if weight >= 1.0 { result } else { before + weight * (result - before) } as f32;
    if mixed.is_finite() && weight > 0.0 { mixed } else { before as f32 }
}
