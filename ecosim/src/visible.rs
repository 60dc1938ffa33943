//! What a view sees of the ground, so that only that is planted.

use crate::config::Halftone;
use crate::distance::inside;
use crate::steps::Site;
use crate::{Error, density};
use rayon::prelude::*;
use weald_contract::view::Sight;
use weald_contract::{Grid, Problem, View};

/// Most cells of the raster of what is seen.
const MOST_CELLS: f64 = 250_000.0;

/// Returns 1 in the cells that the step's view sees, or that lie within its margin of such a
/// cell, and 0 elsewhere; `None` when the step names no view.
///
/// A place is seen when it lies within the horizontal angle of view and the line from the eye to
/// the tips of plants of `height` passes over the ground between. Places above and below the
/// picture count as seen.
pub(crate) fn seen(
    halftone: &Halftone,
    height: f64,
    site: &Site<'_>,
) -> Result<Option<Grid>, Error> {
    let Some(name) = &halftone.visible_from else { return Ok(None) };
    let Some(view) = site.around.views.iter().find(|view| view.name == name.value) else {
        let problem = Problem::at(name.span, format!("there is no view `{}`", name.value));
        return Err(problem.hint("it must be the `name` of a `[[view]]` of the scene").into());
    };
    let terrain = site.ground.frame();
    let cell = terrain.cell.max((site.ground.area() / MOST_CELLS).sqrt());
    let frame = density::covering(terrain, cell);
    let sight = view.sight(site.ground.terrain);
    let mut values = vec![0.0; frame.len()];
    values.par_chunks_mut(frame.width).enumerate().for_each(|(row, line)| {
        for (column, value) in line.iter_mut().enumerate() {
            let (x, y) = frame.center(column, row);
            // 1 where nothing is seen, so that distances count from what is.
            *value = f32::from(u8::from(!is_seen(view, &sight, [x, y, height], site)));
        }
    });
    let margin = halftone.visible_margin as f32;
    let mut away = inside(&Grid { frame, values });
    away.values.iter_mut().for_each(|value| *value = f32::from(u8::from(*value <= margin)));
    Ok(Some(away))
}

/// Returns whether the tip of a plant of some height is seen; looks at the ground once a cell.
fn is_seen(view: &View, sight: &Sight, [x, y, height]: [f64; 3], site: &Site<'_>) -> bool {
    let cell = site.ground.frame().cell;
    let [eye_x, eye_y, eye_z] = sight.eye;
    let (dx, dy) = (x - eye_x, y - eye_y);
    let distance = (dx * dx + dy * dy).sqrt();
    if distance < cell {
        return true;
    }
    let (ahead_x, ahead_y) = (sight.target[0] - eye_x, sight.target[1] - eye_y);
    let ahead = (ahead_x * ahead_x + ahead_y * ahead_y).sqrt();
    let cosine = (dx * ahead_x + dy * ahead_y) / (distance * ahead);
    if ahead > 0.0 && cosine < libm::cos((0.5 * view.fov_deg).to_radians()) {
        return false;
    }
    let top = f64::from(site.ground.altitude(x, y)) + height;
    let steps = (distance / cell).ceil();
    (1..steps as usize).all(|step| {
        let t = step as f64 / steps;
        let line = eye_z + t * (top - eye_z);
        f64::from(site.ground.altitude(eye_x + t * dx, eye_y + t * dy)) <= line
    })
}
