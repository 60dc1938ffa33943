//! How far each cell of a raster lies from what is empty, and from crowns.

use rayon::prelude::*;
use weald_contract::{Grid, Plant};

/// Returns the distance in metres of each cell's centre from the nearest cell without a value
/// above 0, less half a cell; infinite where there is none. What lies beyond the raster is not
/// empty: the rim of a terrain is no edge of a bed.
///
/// The two passes of [Felzenszwalb12]: down the columns by counting, along the rows by the lower
/// envelope of parabolas; exact.
pub(crate) fn inside(grid: &Grid) -> Grid {
    let frame = grid.frame;
    let (width, height) = (frame.width, frame.height);
    let mut down = vec![f64::INFINITY; width * height];
    for row in 0..height {
        for column in 0..width {
            let cell = row * width + column;
            let above = if row > 0 { down[cell - width] + 1.0 } else { f64::INFINITY };
            down[cell] = if grid.values[cell] > 0.0 { above } else { 0.0 };
        }
    }
    for row in (0..height.saturating_sub(1)).rev() {
        for column in 0..width {
            let cell = row * width + column;
            down[cell] = down[cell].min(down[cell + width] + 1.0);
        }
    }
    let mut values = vec![0.0; width * height];
    values.par_chunks_mut(width.max(1)).zip(down.par_chunks(width.max(1))).for_each(
        |(line, down)| {
            let squares = envelope(down);
            for (value, square) in line.iter_mut().zip(squares) {
                *value = (frame.cell * (square.sqrt() - 0.5).max(0.0)) as f32;
            }
        },
    );
    Grid { frame, values }
}

/// Returns for each place along a line the least of `(place - other)² + height(other)²`.
fn envelope(heights: &[f64]) -> Vec<f64> {
    // Vertices of the parabolas that form the envelope, and where each begins.
    let mut parabolas: Vec<(usize, f64)> = Vec::new();
    for (at, height) in heights.iter().enumerate().filter(|(_, height)| height.is_finite()) {
        let rise = |place: usize, height: f64| (place * place) as f64 + height * height;
        let mut start = f64::NEG_INFINITY;
        while let Some(&(last, begins)) = parabolas.last() {
            let meets = (rise(at, *height) - rise(last, heights[last])) / (2 * (at - last)) as f64;
            if meets > begins {
                start = meets;
                break;
            }
            parabolas.pop();
        }
        parabolas.push((at, start));
    }
    let mut current = 0;
    let least = |place: usize| {
        while parabolas.get(current + 1).is_some_and(|(_, begins)| *begins < place as f64) {
            current += 1;
        }
        parabolas.get(current).map_or(f64::INFINITY, |&(at, _)| {
            (place as f64 - at as f64).powi(2) + heights[at] * heights[at]
        })
    };
    (0..heights.len()).map(least).collect()
}

/// Raises the cells near a crown to how near they are: 1 up to `within` metres from its rim,
/// falling smoothly to 0 over the next `transition` metres.
pub(crate) fn add_nearness(grid: &mut Grid, plant: &Plant, within: f64, transition: f64) {
    let frame = grid.frame;
    let full = f64::from(plant.radius) + within;
    let reach = full + transition;
    let column = |x: f64| ((x - frame.west) / frame.cell).floor().max(0.0) as usize;
    let row = |y: f64| ((frame.north() - y) / frame.cell).floor().max(0.0) as usize;
    for r in row(plant.y + reach)..(row(plant.y - reach) + 1).min(frame.height) {
        for c in column(plant.x - reach)..(column(plant.x + reach) + 1).min(frame.width) {
            let (x, y) = frame.center(c, r);
            let distance = ((x - plant.x).powi(2) + (y - plant.y).powi(2)).sqrt();
            let value = &mut grid.values[r * frame.width + c];
            *value = value.max(1.0 - rise(distance, full, reach) as f32);
        }
    }
}

/// Returns 0 up to `from`, 1 from `to`, and the cubic between them that is level at both.
pub(crate) fn rise(value: f64, from: f64, to: f64) -> f64 {
    if value >= to {
        return 1.0;
    }
    let t = ((value - from) / (to - from)).clamp(0.0, 1.0);
    t * t * (3.0 - 2.0 * t)
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Frame, Seed};

    #[test]
    fn distances_are_those_to_the_nearest_empty_cell() {
        let frame = Frame { width: 37, height: 23, cell: 0.5, west: 10.0, south: 20.0 };
        let mut stream = Seed(9).stream("holes", 0);
        let values: Vec<f32> =
            (0..frame.len()).map(|_| if stream.unit() < 0.02 { 0.0 } else { 1.0 }).collect();
        let grid = Grid { frame, values };
        let found = inside(&grid);
        let empty: Vec<usize> = (0..frame.len()).filter(|&i| grid.values[i] == 0.0).collect();
        let center = |i: usize| frame.center(i % frame.width, i / frame.width);
        for cell in 0..frame.len() {
            let (x, y) = center(cell);
            let away = |&other: &usize| (center(other).0 - x).hypot(center(other).1 - y);
            let nearest = empty.iter().map(away).fold(f64::INFINITY, f64::min);
            assert!((f64::from(found.values[cell]) - (nearest - 0.25).max(0.0)).abs() < 1e-5);
        }
    }

    #[test]
    fn a_raster_without_holes_lies_infinitely_far_inside() {
        let frame = Frame { width: 3, height: 2, cell: 1.0, west: 0.0, south: 0.0 };
        assert!(inside(&Grid::filled(frame, 1.0)).values.iter().all(|v| v.is_infinite()));
        assert_eq!(inside(&Grid::filled(frame, 0.0)).values, [0.0; 6]);
    }
}
