//! The shadow that crowns cast straight down, as a layer for formulas.

use crate::stand::Stand;
use weald_contract::{Frame, Grid, Layers};

/// Most cells of a shadow raster; crowns are soft shapes and need no finer ones.
const MOST_CELLS: f64 = 4e6;
/// Side of its cells where the terrain's are larger, m: small crowns keep their shape.
const FINE_CELL: f64 = 0.5;

/// Returns how much of each cell lies under a crown of the species, 0 to 1.
///
/// The "image representing the projection of the crown on the ground" of [Deussen98], taken from
/// the plants so far. Overlapping crowns shade no more than the deepest of them. A species
/// without plants casts no shadow.
pub(crate) fn crown_shadow(terrain: &Layers, stand: &Stand<'_>, species: &str) -> Grid {
    let mut shadow = Grid::filled(shadow_frame(&terrain.frame), 0.0);
    let Some(index) = stand.population.species.iter().position(|name| name == species) else {
        return shadow;
    };
    let plants = stand.population.plants.iter();
    for plant in plants.filter(|plant| usize::from(plant.species) == index) {
        shade(&mut shadow, plant.x, plant.y, f64::from(plant.radius));
    }
    shadow
}

/// Returns the cells of a raster of crowns.
pub(crate) fn shadow_frame(terrain: &Frame) -> Frame {
    let (width, height) =
        (terrain.width as f64 * terrain.cell, terrain.height as f64 * terrain.cell);
    let cell = terrain.cell.min(FINE_CELL).max((width * height / MOST_CELLS).sqrt());
    let cells = |length: f64| ((length / cell).ceil() as usize).max(1);
    Frame { width: cells(width), height: cells(height), cell, ..*terrain }
}

/// Darkens the cells under one crown.
///
/// A cell's share under the disc is linear over one cell across the rim; a crown smaller than a
/// cell darkens it by its share of the area.
fn shade(shadow: &mut Grid, x: f64, y: f64, radius: f64) {
    let frame = shadow.frame;
    let depth = (std::f64::consts::PI * radius * radius / frame.cell_area()).min(1.0);
    let reach = radius + 0.5 * frame.cell;
    let column = |x: f64| ((x - frame.west) / frame.cell).floor().max(0.0) as usize;
    let row = |y: f64| ((frame.north() - y) / frame.cell).floor().max(0.0) as usize;
    for r in row(y + reach)..(row(y - reach) + 1).min(frame.height) {
        for c in column(x - reach)..(column(x + reach) + 1).min(frame.width) {
            let (cx, cy) = frame.center(c, r);
            let distance = ((cx - x).powi(2) + (cy - y).powi(2)).sqrt();
            let share = ((radius - distance) / frame.cell + 0.5).clamp(0.0, 1.0) * depth;
            let value = &mut shadow.values[r * frame.width + c];
            *value = value.max(share as f32);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stand::tests::ramp;

    #[test]
    fn the_shadow_of_a_crown_has_its_area() {
        let terrain = ramp(40, 0.5, 0.0);
        for radius in [0.4, 1.0, 3.7] {
            let mut shadow = Grid::filled(shadow_frame(&terrain.frame), 0.0);
            shade(&mut shadow, 10.1, 9.3, radius);
            let area =
                shadow.values.iter().map(|v| f64::from(*v)).sum::<f64>() * shadow.frame.cell_area();
            let disc = std::f64::consts::PI * radius * radius;
            // The rim is blurred over one cell, which favours crowns of less than one.
            assert!((area - disc).abs() < 0.15 * disc, "{area} for {disc}");
        }
    }
}
