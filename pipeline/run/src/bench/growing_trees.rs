//! Plants: trees that organize themselves, at sizes up to those of the papers.

use super::{Figure, Size, best, table, wrong};
use crate::error::Result;
use weald_contract::Seed;
use weald_plants::self_organizing::{Garden, SelfOrganizing};

/// Times of growing trees. The largest take seconds each, so they run once.
pub(super) fn figures(size: &Size, quick: bool) -> Result<Vec<Figure>> {
    let once = Size { repeat: 1, ..*size };
    let mut figures = Vec::new();
    let most: &[u32] = if quick { &[20_000] } else { &[80_000, 160_000, 320_000, 642_000] };
    for &metamers in most {
        figures.push(shadows(&once, metamers)?);
    }
    let counts: &[u32] = if quick { &[30_000] } else { &[125_000, 250_000, 500_000, 1_000_000] };
    for &count in counts {
        figures.push(markers(&once, count)?);
    }
    Ok(figures)
}

/// A tree in the light, grown until it has so many metamers.
fn shadows(size: &Size, metamers: u32) -> Result<Figure> {
    let form: SelfOrganizing = table(&format!(
        "most_metamers = {metamers}\nlambda = 0.5\nshed = 0.02\n\
         shadow = {{ grid = [200, 200, 200], voxel = 1.0, depth = 8 }}"
    ))?;
    grow("self-organizing, light", size, &form, 400.0)
}

/// A tree that colonizes a ball of markers.
fn markers(size: &Size, count: u32) -> Result<Figure> {
    // One marker for each unit of volume.
    let radius = (f64::from(count) * 3.0 / (4.0 * std::f64::consts::PI)).cbrt();
    let form: SelfOrganizing = table(&format!(
        "competition = 'markers'\nmost_metamers = 2000000\nshed_after = 3\nshed = 0.01\n\
         markers = {{ count = {count}, space = [{{ shape = 'ball', center = [0, 0, {radius}], \
         radius = {radius} }}] }}"
    ))?;
    grow("self-organizing, markers", size, &form, 60.0)
}

fn grow(name: &'static str, size: &Size, form: &SelfOrganizing, cycles: f32) -> Result<Figure> {
    let (time, report) = best(size, || {
        let mut garden = Garden::new(form, &[(glam::Vec3::ZERO, 1.0)], Seed(1)).map_err(wrong)?;
        garden.grow_to(cycles).map_err(wrong)?;
        Ok(garden.report())
    })?;
    let metamers = report.metamers[0];
    let input = format!(
        "{metamers} metamers in {} cycles, {} markers left, {}",
        report.cycles,
        report.free_markers,
        crate::check::bytes_in_words(report.bytes as u64)
    );
    Ok(Figure::time(name, time, input).with(metamers as f64))
}
