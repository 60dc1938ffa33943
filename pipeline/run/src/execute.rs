//! Carrying out a plan: stale stages run, in order, and leave a record each.

use crate::checkpoint::Saving;
use crate::error::{Error, Result};
use crate::make::{self, EcosimPaths, Made, RenderPaths};
use crate::plan::{Plan, Step};
use crate::recipe::Stage;
use crate::record::{Output, Record, record_path};
use crate::scene::Scene;
use serde::Serialize;
use serde_json::Value as Json;
use std::path::{Path, PathBuf};
use std::time::Duration;
use weald_contract::Progress;

/// Hears of stages as they begin and end, beside the progress within them.
pub trait Listener: Progress {
    /// A stage begins; `step` says why.
    fn stage_begins(&self, step: &Step);
    /// A stage is done and recorded.
    fn stage_ends(&self, stage: Stage, report: &Json);
}

/// What a run did for one stage.
#[derive(Clone, Debug, Serialize)]
pub struct Done {
    /// The stage.
    pub stage: Stage,
    /// Whether it ran; otherwise its output was up to date.
    pub ran: bool,
    /// Its numbers, from now or from the record.
    pub report: Json,
}

/// Where everything of a run lies.
#[derive(Clone, Debug)]
pub struct Layout {
    /// The output folder.
    pub out: PathBuf,
}

impl Layout {
    /// The terrain's folder.
    pub fn terrain(&self) -> PathBuf {
        self.out.join("terrain")
    }

    /// The plants.
    pub fn population(&self) -> PathBuf {
        self.out.join("population.parquet")
    }

    /// The representatives.
    pub fn palette(&self) -> PathBuf {
        self.out.join("palette.toml")
    }

    /// Where they stand.
    pub fn instances(&self) -> PathBuf {
        self.out.join("instances.parquet")
    }

    /// Their models.
    pub fn plants(&self) -> PathBuf {
        self.out.join("plants")
    }

    /// The picture; drafts have their own, so that a draft never replaces a finished picture.
    pub fn image(&self, is_draft: bool) -> PathBuf {
        self.out.join(if is_draft { "image-draft.exr" } else { "image.exr" })
    }
}

/// Runs every stale stage of the plan.
///
/// # Errors
/// The first failure; stages that were finished before it stay finished.
pub fn execute(scene: &Scene, plan: &Plan, listener: &dyn Listener) -> Result<Vec<Done>> {
    scene.wanted_view()?;
    if plan.out.exists() && !plan.out.is_dir() {
        let message = format!("{} is a file", plan.out.display());
        return Err(Error::plain(
            message,
            "the output of a run is a folder: give another with `-o`",
        ));
    }
    std::fs::create_dir_all(&plan.out).map_err(|error| Error::system(&plan.out, error))?;
    let layout = Layout { out: plan.out.clone() };
    let _lock = lock(&layout)?;
    sweep(&layout);
    let mut done = Vec::new();
    let mut finished = false;
    for step in &plan.steps {
        if !step.is_stale() {
            let report = step.record.as_ref().map_or(Json::Null, |record| record.report.clone());
            done.push(Done { stage: step.stage, ran: false, report });
            continue;
        }
        listener.stage_begins(step);
        let made = make_stage(scene, step, plan.is_draft, &layout, listener)
            .and_then(|made| record(step, plan, made))
            .map_err(|error| match error {
                Error::Stopped { .. } => Error::Stopped { saved: finished },
                other => other,
            })?;
        finished = true;
        listener.stage_ends(step.stage, &made);
        done.push(Done { stage: step.stage, ran: true, report: made });
    }
    Ok(done)
}

/// Holds the output folder for this run alone; the system lets go of it however the run ends.
fn lock(layout: &Layout) -> Result<std::fs::File> {
    let folder = layout.out.join(".weald");
    std::fs::create_dir_all(&folder).map_err(|error| Error::system(&folder, error))?;
    let path = folder.join("lock");
    let file = std::fs::File::create(&path).map_err(|error| Error::system(&path, error))?;
    match file.try_lock() {
        Err(std::fs::TryLockError::WouldBlock) => Err(Error::plain(
            format!("another run is at work in {}", layout.out.display()),
            "wait for it, or write elsewhere with `-o`",
        )),
        // A file system without locks is no reason not to work.
        Ok(()) | Err(std::fs::TryLockError::Error(_)) => Ok(file),
    }
}

/// Makes one stage's files in the run's layout.
fn make_stage(
    scene: &Scene,
    step: &Step,
    is_draft: bool,
    layout: &Layout,
    progress: &dyn Progress,
) -> Result<Made> {
    let parents = make::parents_of_inputs(&step.recipe.inputs);
    let story = make::provenance(scene, step.stage, is_draft, parents);
    match step.stage {
        Stage::Terrain => make::terrain(scene, &layout.terrain(), &story, progress),
        Stage::Ecosim => {
            let paths = EcosimPaths {
                terrain: layout.terrain(),
                start: None,
                population: layout.population(),
                saving: Some(saving(layout)),
            };
            make::ecosim(scene, &paths, story, progress)
        }
        Stage::Quantize => {
            let terrain = layout.terrain();
            let (plants, out) = (layout.population(), &layout.out);
            make::quantize(scene, &plants, Some(&terrain), out, story, progress)
        }
        Stage::Plants => make::plants(scene, &layout.palette(), &layout.plants(), story, progress),
        Stage::Render => {
            let paths = RenderPaths {
                terrain: layout.terrain(),
                palette: layout.palette(),
                instances: layout.instances(),
                plants: layout.plants(),
                image: layout.image(is_draft),
            };
            make::render(scene, &paths, is_draft, story, progress)
        }
    }
}

/// Time from one checkpoint of a run's simulation to the next: less than anyone minds to lose.
const CHECKPOINT_INTERVAL: Duration = Duration::from_secs(60);

/// A simulation that a run was stopped in goes on with the next run.
fn saving(layout: &Layout) -> Saving {
    Saving {
        file: layout.out.join(".weald/ecosim.checkpoint"),
        every: CHECKPOINT_INTERVAL,
        stop_after: None,
        is_strict: false,
    }
}

/// Writes the record of a finished stage, and removes files that only the earlier run made.
fn record(step: &Step, plan: &Plan, made: Made) -> Result<Json> {
    let mut outputs = Vec::new();
    for file in &made.files {
        outputs.push(Output::of(&plan.out, &below(&plan.out, file))?);
    }
    for old in step.record.iter().flat_map(|record| &record.outputs) {
        if !outputs.iter().any(|output| output.path == old.path) && is_below(&old.path) {
            // Already gone is as good.
            let _ = std::fs::remove_file(plan.out.join(&old.path));
        }
    }
    let recipe = step.recipe.clone();
    let record = Record { key: recipe.key(), recipe, outputs, report: made.report.clone() };
    record.write(&record_path(&plan.out, step.stage, plan.is_draft))?;
    Ok(made.report)
}

/// A path below the output folder, with `/` on every system.
fn below(out: &Path, file: &Path) -> String {
    let relative = file.strip_prefix(out).unwrap_or(file);
    let parts: Vec<_> =
        relative.components().map(|part| part.as_os_str().to_string_lossy()).collect();
    parts.join("/")
}

/// Whether a recorded path stays inside the output folder: a record is a file that anyone may
/// edit, and what it names gets removed.
fn is_below(path: &str) -> bool {
    use std::path::Component;
    Path::new(path).components().all(|part| matches!(part, Component::Normal(_)))
}

/// Removes what a killed run left half-written; such files never have their final name.
fn sweep(layout: &Layout) {
    let mut folders = vec![layout.out.clone(), layout.plants(), layout.out.join(".weald")];
    folders.push(layout.terrain());
    let patches = std::fs::read_dir(layout.terrain()).into_iter().flatten().flatten();
    folders.extend(patches.map(|entry| entry.path()).filter(|path| path.is_dir()));
    for folder in folders {
        for entry in std::fs::read_dir(folder).into_iter().flatten().flatten() {
            let name = entry.file_name().to_string_lossy().into_owned();
            if name.starts_with(".weald-") && name.ends_with(".part") {
                let _ = std::fs::remove_file(entry.path());
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_runs_do_not_work_in_one_folder() {
        let folder = tempfile::tempdir().unwrap();
        let layout = Layout { out: folder.path().to_path_buf() };
        let held = lock(&layout).unwrap();
        assert!(lock(&layout).unwrap_err().to_string().contains("another run is at work"));
        drop(held);
        assert!(lock(&layout).is_ok());
    }

    #[test]
    fn recorded_paths_are_relative_and_cannot_leave_the_folder() {
        assert_eq!(
            below(Path::new("out/a"), Path::new("out/a/plants/0001.glb")),
            "plants/0001.glb"
        );
        assert!(is_below("plants/0001.glb"));
        assert!(!is_below("../x") && !is_below("/etc/passwd") && !is_below("a/../../x"));
    }
}
