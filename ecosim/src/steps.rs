//! The list of steps, run in order.

use crate::checkpoint::{Checkpoint, Course, Going, Moment};
use crate::config::{Config, Step, stem};
use crate::field::ImageField;
use crate::ground::Ground;
use crate::ids::{IdSource, Tags};
use crate::stand::Stand;
use crate::{
    Error, Outcome, Surroundings, checkpoint, clear, halftone, place, plots, relax, self_thinning,
    simulate, thin,
};
use weald_contract::{Image, Population, Problem, Progress, Seed, Written};

/// What every step reads.
pub(crate) struct Site<'a> {
    pub(crate) ground: Ground<'a>,
    pub(crate) around: Surroundings<'a>,
    /// Root of this step's chance.
    pub(crate) seed: Seed,
    /// Root of the chance that steps share.
    pub(crate) shared_seed: Seed,
    /// Ids of the plants that this step creates.
    pub(crate) ids: IdSource,
    pub(crate) progress: &'a dyn Progress,
}

impl Site<'_> {
    /// Gives an error when the user asked to stop.
    pub(crate) fn check_cancelled(&self) -> Result<(), Error> {
        if self.progress.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
    }
}

/// Runs the steps on the plants of `start`, or on bare ground.
///
/// # Errors
/// The first problem met, at the place in the scene where it was written; or
/// [`Error::Cancelled`] when `progress` asks to stop. [`Config::check`] finds many problems
/// without any work, and all of them at once.
pub fn grow(
    config: &Config,
    around: &Surroundings<'_>,
    start: Option<&Population>,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Outcome, Error> {
    grow_on(config, around, start, seed, progress, Course::default())
}

/// Does the same with rests, at which a watch may save the state, and goes on from one saved so.
///
/// All arguments must be those with which the checkpoint was made; the outcome is then the same,
/// bit for bit, as if nothing had come between.
///
/// # Errors
/// As [`grow`]; [`Error::Paused`] when the watch asks to stop, [`Error::NotSaved`] when it cannot
/// save, [`Error::Unfit`] when the checkpoint is of other work.
pub fn grow_on(
    config: &Config,
    around: &Surroundings<'_>,
    start: Option<&Population>,
    seed: Seed,
    progress: &dyn Progress,
    mut course: Course<'_>,
) -> Result<Outcome, Error> {
    let layers: Vec<&str> = around.terrain.layers.keys().map(String::as_str).collect();
    if let Some(problem) = config.check(around.species, &layers).into_iter().next() {
        return Err(problem.into());
    }
    let mut tags = Tags::beside(start.iter().flat_map(|s| &s.plants).map(|plant| plant.id));
    let (mut stand, first) = match course.from.take() {
        None => (Stand::new(around, start, config.max_plants)?, 0),
        Some(Checkpoint { ordinal, so_far, begun }) => {
            course.begun = begun;
            (checkpoint::restore(config, around, so_far)?, ordinal)
        }
    };
    stand.spacing = &config.spacing;
    for path in &config.images {
        let image = image_of(path, around)?;
        let field = ImageField::new(path, image, false, &around.terrain.frame)?;
        stand.images.insert(stem(&path.value), field);
    }
    let ground = Ground::new(around.terrain)?;
    for (ordinal, step) in config.step.iter().enumerate().filter(|(_, s)| s.common.enabled) {
        let ids = tags.take(step.common.name.as_deref(), ordinal);
        if ordinal < first {
            continue;
        }
        let site = Site {
            ground: ground.clone(),
            around: *around,
            seed: seed.part("ecosim", ids.tag),
            shared_seed: seed,
            ids,
            progress,
        };
        site.check_cancelled()?;
        run(&step.variant, ordinal, &site, &mut stand, &mut course)?;
        if ordinal + 1 < config.step.len() {
            let going = Going::Between;
            course.rest(&site, 0, &Moment { ordinal: ordinal + 1, stand: &stand, going })?;
        }
    }
    Ok(stand.finish())
}

/// Returns the image that a path names.
pub(crate) fn image_of<'a>(
    path: &Written<String>,
    around: &Surroundings<'a>,
) -> Result<&'a Image, Error> {
    let image = around.images.get(&path.value).ok_or_else(|| {
        Problem::at(path.span, format!("the image `{}` was not read", path.value))
    })?;
    Ok(image)
}

fn run<'a>(
    step: &'a Step,
    ordinal: usize,
    site: &Site<'a>,
    stand: &mut Stand<'a>,
    course: &mut Course<'_>,
) -> Result<(), Error> {
    match step {
        Step::Simulate(simulate) => simulate::run(simulate, ordinal, site, stand, course),
        Step::SelfThinning(thinning) => self_thinning::run(thinning, ordinal, site, stand, course),
        _ if course.begun.is_some() => Err(Error::Unfit("it stopped in a step of another kind")),
        Step::Halftone(halftone) => halftone::run(halftone, site, stand),
        Step::Place(place) => place::run(place, site, stand),
        Step::Plots(plots) => plots::run(plots, site, stand),
        Step::Relax(relax) => relax::run(relax, site, stand),
        Step::Thin(thin) => thin::run(thin, site, stand),
        Step::Clear(clear) => clear::run(clear, site, stand),
    }
}
