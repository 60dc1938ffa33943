//! Wetness with suction: gentle slopes draw water up from wetter neighbours [Boehner06].

use crate::derive;
use crate::resample::by_row;
use crate::sun::Relief;

/// The topographic wetness index over areas that gentle slopes have drawn up.
///
/// `area` is the specific catchment area of each cell, m. A cell lets (1 / `strength`)^(β e^(`strength` β))
/// of its neighbours' area pass, β its slope in radians.
pub fn wetness(relief: &Relief<'_>, mut area: Vec<f32>, strength: f64) -> Vec<f32> {
    let Relief { width, height, cell, altitude } = *relief;
    let tangents = derive::from_gradient(width, height, cell, altitude, |_, g| g.tangent() as f32);
    let passing = by_row(width, height, |row, out| {
        let line = &tangents[row * width..][..width];
        for (out, tangent) in out.iter_mut().zip(line) {
            let slope = libm::atan(f64::from(*tangent));
            *out = libm::pow(1.0 / strength, slope * libm::exp(strength * slope)) as f32;
        }
    });
    draw_up(width, height, &passing, &mut area);
    let cells = area.iter().zip(&tangents);
    cells.map(|(a, t)| derive::wetness(f64::from(*a) * cell, cell, f64::from(*t))).collect()
}

/// Raises every area to the greatest that reaches it from a neighbour, lessened by the share that
/// its own slope lets pass, until nothing changes.
///
/// The greatest product over all paths is unique, so the order of the sweeps does not matter.
fn draw_up(width: usize, height: usize, passing: &[f32], area: &mut [f32]) {
    let raise = |area: &mut [f32], cell: usize, from: usize| {
        let drawn = area[from] * passing[cell];
        let is_more = drawn > area[cell];
        if is_more {
            area[cell] = drawn;
        }
        is_more
    };
    loop {
        let mut changed = false;
        for row in 0..height {
            for column in 0..width {
                let cell = row * width + column;
                if row > 0 {
                    for beside in column.saturating_sub(1)..(column + 2).min(width) {
                        changed |= raise(area, cell, cell - width - column + beside);
                    }
                }
                if column > 0 {
                    changed |= raise(area, cell, cell - 1);
                }
            }
            for column in (0..width.saturating_sub(1)).rev() {
                let cell = row * width + column;
                changed |= raise(area, cell, cell + 1);
            }
        }
        for row in (0..height).rev() {
            for column in (0..width).rev() {
                let cell = row * width + column;
                if row + 1 < height {
                    for beside in column.saturating_sub(1)..(column + 2).min(width) {
                        changed |= raise(area, cell, cell + width - column + beside);
                    }
                }
                if column + 1 < width {
                    changed |= raise(area, cell, cell + 1);
                }
            }
            for column in 1..width {
                let cell = row * width + column;
                changed |= raise(area, cell, cell - 1);
            }
        }
        if !changed {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn drawn_up_areas_are_those_of_relaxing_every_cell_until_nothing_changes() {
        let (width, height) = (23, 17);
        let mut stream = Seed(4).stream("areas", 0);
        let passing: Vec<f32> = (0..width * height).map(|_| stream.unit() as f32).collect();
        let mut area: Vec<f32> =
            (0..width * height).map(|_| (stream.unit() as f32).powi(8) * 1e4).collect();
        let mut expected = area.clone();
        loop {
            let before = expected.clone();
            for cell in 0..expected.len() {
                let (x, y) = (cell % width, cell / width);
                for (i, from) in before.iter().enumerate() {
                    if (i % width).abs_diff(x) <= 1 && (i / width).abs_diff(y) <= 1 && i != cell {
                        expected[cell] = expected[cell].max(from * passing[cell]);
                    }
                }
            }
            if expected == before {
                break;
            }
        }
        draw_up(width, height, &passing, &mut area);
        assert_eq!(area, expected);
    }
}
