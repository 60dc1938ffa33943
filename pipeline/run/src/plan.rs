//! Which stages must run, and why.

use crate::error::Result;
use crate::parameters::recipes;
use crate::recipe::{Recipe, Stage};
use crate::record::{Record, record_path};
use crate::scene::Scene;
use serde::Serialize;
use std::fmt;
use std::path::{Path, PathBuf};

/// The plan of a run.
#[derive(Clone, Debug)]
pub struct Plan {
    /// Folder of all outputs.
    pub out: PathBuf,
    /// Whether the picture is a draft.
    pub is_draft: bool,
    /// One step a stage, in order.
    pub steps: Vec<Step>,
}

/// What is to be done for one stage.
#[derive(Clone, Debug, Serialize)]
pub struct Step {
    /// The stage.
    pub stage: Stage,
    /// Why it must run; empty when its output is up to date.
    pub reasons: Vec<String>,
    /// What it would be made from.
    #[serde(skip)]
    pub recipe: Recipe,
    /// What an earlier run left; still valid when `reasons` is empty.
    #[serde(skip)]
    pub record: Option<Record>,
}

impl Step {
    /// Whether the stage must run.
    pub fn is_stale(&self) -> bool {
        !self.reasons.is_empty()
    }
}

impl Plan {
    /// Compares the scene with what stands in the output folder.
    ///
    /// # Errors
    /// An input file cannot be read.
    pub fn new(scene: &Scene, out: &Path, is_draft: bool) -> Result<Plan> {
        let mut recipes = recipes(scene, is_draft)?;
        let mut steps: Vec<Step> = Vec::new();
        for stage in Stage::ALL {
            let Some(recipe) = recipes.remove(&stage) else { continue };
            let record = Record::read(&record_path(out, stage, is_draft));
            let mut reasons = reasons(&recipe, record.as_ref(), out);
            if reasons.is_empty() {
                // Outputs may be whole while those of an earlier stage were changed or removed.
                let before = steps.iter().filter(|step| step.is_stale());
                reasons.extend(
                    before
                        .filter(|step| stage.reads().contains(&step.stage))
                        .map(|step| format!("{} runs", step.stage.word())),
                );
            }
            steps.push(Step { stage, reasons, recipe, record });
        }
        Ok(Plan { out: out.to_path_buf(), is_draft, steps })
    }

    /// Whether nothing is to be done.
    pub fn is_done(&self) -> bool {
        self.steps.iter().all(|step| !step.is_stale())
    }
}

/// Why a stage must run, from its own recipe and outputs.
fn reasons(recipe: &Recipe, record: Option<&Record>, out: &Path) -> Vec<String> {
    let Some(record) = record else { return vec!["it has not run yet".into()] };
    if record.key != recipe.key() {
        // Through text and back, so that numbers compare as they were stored.
        let text = serde_json::to_string(recipe).unwrap_or_default();
        let recipe = serde_json::from_str(&text).unwrap_or_else(|_| recipe.clone());
        let found = recipe.differences(&record.recipe);
        return if found.is_empty() { vec!["its recipe changed".into()] } else { found };
    }
    record.outputs.iter().filter_map(|output| output.complaint(out)).take(3).collect()
}

impl fmt::Display for Plan {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for step in &self.steps {
            let draft = if self.is_draft && step.stage == Stage::Render { " (draft)" } else { "" };
            let word = format!("{}{draft}", step.stage.word());
            match step.reasons.as_slice() {
                [] => writeln!(f, "{word:<16} up to date")?,
                [first, rest @ ..] => {
                    writeln!(f, "{word:<16} runs: {first}")?;
                    for reason in rest {
                        writeln!(f, "{:<16}       {reason}", "")?;
                    }
                }
            }
        }
        Ok(())
    }
}
