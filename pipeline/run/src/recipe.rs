//! What a stage's output depends on, and the key made of it.
//!
//! A recipe holds the parameters that the stage really reads, the seed, the hashes of the files
//! its table names and the keys of the stages before it. Nothing else may change the output, so
//! equal keys mean that the work is done. The recipe is kept beside the key, for then a stale
//! stage can say in words what changed.

use serde::{Deserialize, Serialize};
use serde_json::Value as Json;

/// The stages, in the order in which they run.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stage {
    /// Ground, water and soil.
    Terrain,
    /// Where plants grow.
    Ecosim,
    /// Which few models stand for them.
    Quantize,
    /// The models.
    Plants,
    /// The picture.
    Render,
}

impl Stage {
    /// All stages, in order.
    pub const ALL: [Stage; 5] =
        [Stage::Terrain, Stage::Ecosim, Stage::Quantize, Stage::Plants, Stage::Render];

    /// The stage's one word.
    pub fn word(self) -> &'static str {
        match self {
            Stage::Terrain => "terrain",
            Stage::Ecosim => "ecosim",
            Stage::Quantize => "quantize",
            Stage::Plants => "plants",
            Stage::Render => "render",
        }
    }

    /// The stages whose files this one opens.
    pub fn reads(self) -> &'static [Stage] {
        match self {
            Stage::Terrain => &[],
            Stage::Ecosim => &[Stage::Terrain],
            Stage::Quantize => &[Stage::Ecosim],
            Stage::Plants => &[Stage::Quantize],
            Stage::Render => &[Stage::Terrain, Stage::Quantize, Stage::Plants],
        }
    }

    /// Number that the stage's crate raises whenever the same recipe gives other bytes.
    pub fn output_version(self) -> u32 {
        match self {
            Stage::Terrain => weald_terrain::OUTPUT_VERSION,
            Stage::Ecosim => weald_ecosim::OUTPUT_VERSION,
            Stage::Quantize => weald_quantize::OUTPUT_VERSION,
            Stage::Plants => weald_plants::OUTPUT_VERSION,
            Stage::Render => weald_render::OUTPUT_VERSION,
        }
    }
}

/// A file that a stage's table names, by content.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct HashedInput {
    /// Path as the scene writes it.
    pub name: String,
    /// BLAKE3 of its bytes.
    pub blake3: String,
}

/// Everything that a stage's output depends on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Recipe {
    /// The stage.
    pub stage: Stage,
    /// See [`Stage::output_version`].
    pub output_version: u32,
    /// Seed of the scene.
    pub seed: u64,
    /// What the stage reads of the scene and the species.
    pub parameters: Json,
    /// Files it opens.
    pub inputs: Vec<HashedInput>,
    /// Keys of the stages before it.
    pub reads: Vec<(Stage, String)>,
}

impl Recipe {
    /// The key: BLAKE3 of the recipe's JSON, in hexadecimal.
    pub fn key(&self) -> String {
        let text = serde_json::to_string(self).expect("a recipe holds only plain values");
        blake3::hash(text.as_bytes()).to_hex().to_string()
    }

    /// Says in words how `self` differs from an `earlier` recipe of the same stage.
    pub fn differences(&self, earlier: &Recipe) -> Vec<String> {
        let mut reasons = Vec::new();
        if self.output_version != earlier.output_version {
            reasons.push("the program computes it in a new way".into());
        }
        if self.seed != earlier.seed {
            reasons.push(format!("seed was {}, is {}", earlier.seed, self.seed));
        }
        json_differences("", &earlier.parameters, &self.parameters, &mut reasons);
        for input in &self.inputs {
            match earlier.inputs.iter().find(|before| before.name == input.name) {
                None => reasons.push(format!("{} is a new input", input.name)),
                Some(before) if before != input => reasons.push(format!("{} changed", input.name)),
                Some(_) => {}
            }
        }
        for (stage, key) in &self.reads {
            if !earlier.reads.contains(&(*stage, key.clone())) {
                reasons.push(format!("{} changed", stage.word()));
            }
        }
        reasons
    }
}

/// How many differences are told one by one.
const MAX_REASONS: usize = 4;

/// Adds a reason for every leaf in which two JSON trees differ.
fn json_differences(path: &str, before: &Json, after: &Json, reasons: &mut Vec<String>) {
    if before == after || reasons.len() >= MAX_REASONS {
        return;
    }
    match (before, after) {
        (Json::Object(old), Json::Object(new)) => {
            let join =
                |key: &str| if path.is_empty() { key.into() } else { format!("{path}.{key}") };
            for (key, value) in new {
                json_differences(&join(key), old.get(key).unwrap_or(&Json::Null), value, reasons);
            }
            for (key, value) in old.iter().filter(|(key, _)| !new.contains_key(*key)) {
                json_differences(&join(key), value, &Json::Null, reasons);
            }
        }
        (Json::Array(old), Json::Array(new)) if old.len() == new.len() => {
            for (index, (old, new)) in old.iter().zip(new).enumerate() {
                json_differences(&format!("{path}[{index}]"), old, new, reasons);
            }
        }
        _ => reasons.push(format!("{path} was {}, is {}", brief(before), brief(after))),
    }
}

/// A JSON value short enough for a line.
fn brief(value: &Json) -> String {
    match value {
        Json::Null => "absent".into(),
        Json::Array(items) if value.to_string().len() > 40 => format!("a list of {}", items.len()),
        Json::Object(map) if value.to_string().len() > 40 => format!("a table of {}", map.len()),
        other => {
            let text = other.to_string();
            let mut short: String = text.chars().take(40).collect();
            if short.len() < text.len() {
                short.push('…');
            }
            short
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn recipe(parameters: Json) -> Recipe {
        let inputs = vec![HashedInput { name: "dem.tif".into(), blake3: "aa".into() }];
        let reads = vec![(Stage::Terrain, "k1".into())];
        Recipe { stage: Stage::Ecosim, output_version: 1, seed: 7, parameters, inputs, reads }
    }

    #[test]
    fn equal_recipes_have_equal_keys_and_any_change_another() {
        let base = recipe(json!({ "step": [{ "years": 60 }] }));
        assert_eq!(base.key(), base.clone().key());
        let mut others = vec![recipe(json!({ "step": [{ "years": 80 }] }))];
        others.push(Recipe { seed: 8, ..base.clone() });
        others.push(Recipe { output_version: 2, ..base.clone() });
        others.push(Recipe { reads: vec![(Stage::Terrain, "k2".into())], ..base.clone() });
        others.push(Recipe { inputs: vec![], ..base.clone() });
        for other in others {
            assert_ne!(base.key(), other.key());
        }
    }

    #[test]
    fn a_change_is_told_by_its_path_and_values() {
        let before = recipe(json!({ "step": [{ "years": 60, "kind": "simulate" }], "old": 1 }));
        let mut after = recipe(json!({ "step": [{ "years": 80, "kind": "simulate" }] }));
        after.inputs[0].blake3 = "bb".into();
        after.reads[0].1 = "k2".into();
        assert_eq!(
            after.differences(&before),
            [
                "step[0].years was 60, is 80",
                "old was 1, is absent",
                "dem.tif changed",
                "terrain changed"
            ]
        );
        assert!(before.differences(&before).is_empty());
    }

    #[test]
    fn a_key_survives_a_round_trip_through_its_file() {
        let base = recipe(json!({ "a": 0.1, "b": 1e300, "c": 0.30000001192092896 }));
        let back: Recipe = serde_json::from_str(&serde_json::to_string(&base).unwrap()).unwrap();
        assert_eq!(back.key(), base.key());
    }
}
