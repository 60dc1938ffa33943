//! Presets beside real plants: `weald plants --check`.
//!
//! Trees are grown at five ages and measured as foresters do; what lies outside the range of
//! measured trees is said. Herbs are measured by height and leaf area index.

use crate::error::Result;
use crate::library;
use crate::scene::SceneSpecies;
use crate::specimen::{skeleton_at, species_given};
use rayon::prelude::*;
use serde::Serialize;
use std::fmt;
use weald_contract::{Seed, Sources};
use weald_plants::Form;
use weald_plants::measure::{Finding, Kind, Measures};

/// Parts of the lifespan at which plants are measured.
const AGES: [f32; 5] = [0.1, 0.2, 0.35, 0.6, 0.9];

/// Vigor at which plants are measured.
const VIGOR: f32 = 0.9;

/// Every preset beside real plants.
#[derive(Clone, Debug, Serialize)]
pub struct Report {
    /// The species, by name.
    pub species: Vec<Measured>,
}

/// One species at several ages.
#[derive(Clone, Debug, Serialize)]
pub struct Measured {
    /// Name.
    pub name: String,
    /// Whether it is held against trees or against herbs.
    pub kind: &'static str,
    /// Where its numbers were published, if they are kept although real trees differ.
    pub published: Option<String>,
    /// Its measures at each age.
    pub ages: Vec<Aged>,
}

/// The measures of a plant of one age.
#[derive(Clone, Debug, Serialize)]
pub struct Aged {
    /// Age, years.
    pub age: f32,
    /// Each measure beside the range of real plants.
    pub measures: Vec<Held>,
}

/// One measure beside the range of real plants.
#[derive(Clone, Debug, Serialize)]
pub struct Held {
    /// What was measured.
    pub name: &'static str,
    /// Its value.
    pub value: f64,
    /// Least and most of real plants.
    pub range: [f64; 2],
    /// Whether it lies between them.
    pub is_natural: bool,
}

/// Measures one species, or all that the program knows.
///
/// # Errors
/// A species is nowhere, has mistakes or cannot be grown.
pub fn check(species: Option<&str>, seed: u64) -> Result<Report> {
    let names: Vec<String> = match species {
        Some(given) => vec![given.to_string()],
        None => library::SPECIES.iter().map(|(name, _)| (*name).to_string()).collect(),
    };
    let measured = names.par_iter().map(|given| {
        let (sources, name, found) = species_given(given)?;
        measured(&sources, &name, &found, Seed(seed))
    });
    let measured: Vec<Option<Measured>> = measured.collect::<Result<_>>()?;
    Ok(Report { species: measured.into_iter().flatten().collect() })
}

/// `None` for patches of other plants and for models from files, which have no skeleton.
fn measured(
    sources: &Sources,
    name: &str,
    found: &SceneSpecies,
    seed: Seed,
) -> Result<Option<Measured>> {
    if matches!(found.form, None | Some(Form::Model(_))) {
        return Ok(None);
    }
    let size = &found.species.size;
    // What bears wood and stands higher than a person is held against trees.
    let kind = if size.height >= 2.0 && size.stem_diameter_of_height(size.height) >= 0.05 {
        Kind::Tree
    } else {
        Kind::Herb
    };
    let mut ages = Vec::new();
    for part in AGES {
        let age = (part * size.lifespan).max(0.5);
        let skeleton = skeleton_at(sources, name, found, [age, VIGOR], seed)?;
        let findings = Measures::of(&skeleton).beside(kind, &skeleton);
        ages.push(Aged { age, measures: findings.iter().map(held).collect() });
    }
    Ok(Some(Measured {
        name: name.into(),
        kind: match kind {
            Kind::Tree => "tree",
            Kind::Herb => "herb",
        },
        published: found.species.published.clone(),
        ages,
    }))
}

fn held(finding: &Finding) -> Held {
    Held {
        name: finding.name,
        value: finding.value,
        range: [*finding.band.start(), *finding.band.end()],
        is_natural: finding.is_natural(),
    }
}

impl Report {
    /// Species outside the range of real plants in anything, but for those kept as published.
    pub fn outside(&self) -> impl Iterator<Item = &Measured> {
        self.species.iter().filter(|found| found.published.is_none() && !found.is_natural())
    }
}

impl Measured {
    /// Whether every measure at every age lies within the range of real plants.
    pub fn is_natural(&self) -> bool {
        self.ages.iter().flat_map(|aged| &aged.measures).all(|held| held.is_natural)
    }
}

impl fmt::Display for Report {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for found in &self.species {
            let verdict = match (found.is_natural(), &found.published) {
                (true, _) => "within the range of real plants".to_string(),
                (false, Some(source)) => format!("outside *, kept as published: {source}"),
                (false, None) => "outside *".to_string(),
            };
            writeln!(f, "{} ({}): {verdict}", found.name, found.kind)?;
            for Aged { age, measures } in &found.ages {
                let told = measures.iter().map(|held| {
                    let mark = if held.is_natural { "" } else { " *" };
                    format!("{} {}{mark}", held.name, rounded(held.value))
                });
                writeln!(f, "  {age:>6.1} years  {}", told.collect::<Vec<_>>().join(", "))?;
            }
        }
        let all = self.species.len();
        let natural = self.species.iter().filter(|found| found.is_natural()).count();
        writeln!(f, "{natural} of {all} species lie within the range of real plants at every age")
    }
}

/// Three digits.
fn rounded(value: f64) -> String {
    match value.abs() {
        v if v >= 100.0 => format!("{value:.0}"),
        v if v >= 10.0 => format!("{value:.1}"),
        _ => format!("{value:.2}"),
    }
}
