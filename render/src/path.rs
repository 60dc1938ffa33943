//! The integrator.
use crate::{Config, Error, Film, Scene};
use weald_contract::{Problem, Progress, Seed, View};

/// Renders a view of a scene.
///
/// # Errors
/// [`Error::Cancelled`] when the caller asks to stop.
pub fn render(
    scene: &Scene,
    view: &View,
    config: &Config,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Film, Error> {
    let _ = (scene, view, config, seed, progress);
    Err(Problem::new("not built yet").into())
}
