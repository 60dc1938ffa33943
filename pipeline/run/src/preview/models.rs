//! Maps of a quantized population: which model stands for each plant, and how well.

use super::sketch::Sketch;
use weald_contract::{Plant, Population};
use weald_quantize::Quantized;

/// Margin around the plants of a map, pixels.
const MARGIN: f64 = 6.0;

/// Colour of what no plant covers.
const PAPER: [u8; 3] = [245, 243, 236];

/// What stands for a plant in the scene.
#[derive(Clone, Copy)]
enum StandIn {
    /// The model with this index in the palette.
    Model(usize),
    /// The patch with this number.
    Patch(usize),
}

/// Crowns in the colours of their models, small ones above large ones; patches below all, paler. The longer side is `side` pixels and a margin.
pub fn draw_models(plants: &Population, quantized: &Quantized, side: usize) -> Sketch {
    draw(plants, quantized, side, &|_, stand_in| match stand_in {
        StandIn::Model(model) => color(model),
        StandIn::Patch(patch) => pale(color(patch)),
    })
}

/// Difference of a plant's height from its model's, as a part of it, that is shown in full red.
const FULL_ERROR: f64 = 0.4;

/// Crowns from green, where the model is as high as its plant before it is scaled, over yellow to
/// red; patches in gray.
pub fn draw_errors(plants: &Population, quantized: &Quantized, side: usize) -> Sketch {
    let models = &quantized.palette.representatives;
    draw(plants, quantized, side, &|row, stand_in| {
        let StandIn::Model(model) = stand_in else { return [222, 222, 218] };
        let part = f64::from(plants.plants[row].height) / f64::from(models[model].height);
        let error = ((part - 1.0).abs() / FULL_ERROR).min(1.0);
        let channel = |share: f64| (60.0 + 160.0 * share.clamp(0.0, 1.0)).round() as u8;
        [channel(2.0 * error), channel(2.0 - 2.0 * error), 60]
    })
}

fn draw(
    plants: &Population,
    quantized: &Quantized,
    side: usize,
    paint: &dyn Fn(usize, StandIn) -> [u8; 3],
) -> Sketch {
    let count = quantized.palette.representatives.len();
    let stand_in = |row: usize| {
        let index = (*quantized.instances.prototype.get(row)? as usize).checked_sub(1)?;
        Some(if index < count { StandIn::Model(index) } else { StandIn::Patch(index) })
    };
    let mut rows: Vec<(usize, StandIn)> =
        (0..plants.len()).filter_map(|row| Some((row, stand_in(row)?))).collect();
    let plant = |row: usize| &plants.plants[row];
    let is_plant = |stand_in: &StandIn| matches!(stand_in, StandIn::Model(_));
    rows.sort_by(|(a, of_a), (b, of_b)| {
        let radii = plant(*b).radius.total_cmp(&plant(*a).radius);
        is_plant(of_a).cmp(&is_plant(of_b)).then(radii).then(a.cmp(b))
    });
    let range = |of: fn(&Plant) -> f64| {
        let all = rows.iter().map(|(row, _)| of(plant(*row)));
        all.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], x| [low.min(x), high.max(x)])
    };
    let ([west, east], [south, north]) = (range(|plant| plant.x), range(|plant| plant.y));
    // One plant has no extent, and none an infinite one: then a metre is shown.
    let size = (east - west).max(north - south);
    let pixels_per_metre = side as f64 / if size.is_finite() && size > 0.0 { size } else { 1.0 };
    let pixels = |low: f64, high: f64| {
        ((high - low).max(0.0) * pixels_per_metre + 2.0 * MARGIN).ceil() as usize
    };
    let mut sketch = Sketch::filled(pixels(west, east), pixels(south, north), PAPER);
    for (row, stand_in) in rows {
        let Plant { x, y, radius, .. } = *plant(row);
        let x = MARGIN + (x - west) * pixels_per_metre;
        let y = MARGIN + (north - y) * pixels_per_metre;
        // Crowns are drawn a little smaller, so that neighbours stay apart.
        let radius = 0.8 * f64::from(radius) * pixels_per_metre;
        sketch.disc(x, y, radius, paint(row, stand_in), 1.0);
    }
    sketch
}

/// A colour for a number; neighbouring numbers differ.
///
/// Hues follow the golden section, which spreads any number of them [Knuth98, section 6.4].
fn color(number: usize) -> [u8; 3] {
    let hue = (number as f64 * 0.618_033_988_749_895).fract() * 6.0;
    // Three levels of brightness tell hues apart that have come close.
    let value = [0.85, 0.6, 0.4][number % 3];
    let channel = |shift: f64| {
        let k = (hue + shift) % 6.0;
        let part = 1.0 - 0.75 * k.min(4.0 - k).clamp(0.0, 1.0);
        (255.0 * value * part).round() as u8
    };
    [channel(5.0), channel(3.0), channel(1.0)]
}

fn pale(color: [u8; 3]) -> [u8; 3] {
    let mix = |(color, paper): (u8, u8)| ((u16::from(color) + 2 * u16::from(paper)) / 3) as u8;
    [0, 1, 2].map(|channel| mix((color[channel], PAPER[channel])))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn neighbouring_numbers_have_colours_that_differ() {
        for number in 0..500 {
            let pairs = color(number).into_iter().zip(color(number + 1));
            let apart: i32 = pairs.map(|(a, b)| (i32::from(a) - i32::from(b)).abs()).sum();
            assert!(apart > 80, "{number}: {apart}");
        }
    }
}
