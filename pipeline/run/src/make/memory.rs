//! As many plant models as fit into memory: what a model takes is known when it has grown.

use super::plants::Growing;
use super::quantize::Quantizing;
use crate::check::bytes_in_words;
use crate::error::{Error, Result};
use crate::prototypes::HeldPrototypes;
use std::collections::BTreeMap;
use weald_contract::{Instances, Palette, Population, Progress};
use weald_quantize::{Bytes, Config, Quantized};

/// Palettes that are grown at most, each nearer to what is allowed.
const TRIES: usize = 6;

/// A palette that takes this part of what is allowed, or more, is full enough.
const FULL: f64 = 0.95;

/// Quantizes with as many models as the renderer can hold beside their instances in `allowed` bytes.
///
/// The first palette has one model a species. What its models take tells how many more there may
/// be, and each palette's own weight corrects the next.
///
/// # Errors
/// A species cannot be grown, one model of each takes too much already, or the caller asked to
/// stop.
pub(super) fn quantize_within(
    allowed: u64,
    quantizing: &Quantizing<'_>,
    growing: &Growing<'_>,
    population: &Population,
    progress: &dyn Progress,
) -> Result<Quantized> {
    let fewest = Config { representatives: 1, ..quantizing.config.clone() };
    let fewest = Quantizing { config: &fewest, ..*quantizing };
    let mut found = fewest.plain(population, progress)?;
    let mut weight = Weight::of(&found, growing, progress)?;
    if weight.whole > allowed {
        return Err(too_little(allowed, weight.whole));
    }
    let of_model = weight.mean_bytes(&found.palette);
    let of_model = |name: &str| of_model.get(name).copied().unwrap_or(1);
    // What is left for models beside instances and patches.
    let mut room = allowed.saturating_sub(weight.whole - weight.models) as f64;
    let mut best = (weight.whole, found.clone());
    for _ in 0..TRIES {
        let bytes = Bytes { budget: room as u64, of_model: &of_model };
        let count = found.palette.representatives.len();
        found = quantizing.within(bytes, population, progress)?;
        if found.palette.representatives.len() == count {
            // Every plant has its model, or no further one fits.
            break;
        }
        weight = Weight::of(&found, growing, progress)?;
        let filled = weight.whole as f64 / allowed as f64;
        if weight.whole <= allowed && weight.whole > best.0 {
            best = (weight.whole, found.clone());
        }
        if weight.models == 0 || (FULL..=1.0).contains(&filled) {
            break;
        }
        let beside = (weight.whole - weight.models) as f64;
        let wanted = (allowed as f64 - beside).max(0.0) / weight.models as f64;
        room *= wanted.clamp(0.1, 10.0);
    }
    Ok(best.1)
}

fn too_little(allowed: u64, needed: u64) -> Error {
    let [allowed, needed] = [allowed, needed].map(bytes_in_words);
    Error::plain(
        format!("`memory_gb` allows {allowed}, but one model of each species takes {needed}"),
        "allow more, or place fewer plants",
    )
}

/// What a palette takes in the renderer, bytes.
struct Weight {
    /// Models, patches and instances.
    whole: u64,
    /// Models alone.
    models: u64,
    /// Each model, by its representative's id.
    each: BTreeMap<u32, u64>,
}

impl Weight {
    fn of(found: &Quantized, growing: &Growing<'_>, progress: &dyn Progress) -> Result<Self> {
        let held = HeldPrototypes::grow(&found.palette, growing, progress)?;
        let nowhere = Instances::default();
        let ids = found.palette.representatives.iter().map(|plant| plant.id);
        Ok(Self {
            whole: held.bytes(&found.instances, &[], 0),
            models: held.bytes(&nowhere, &[], 0),
            each: ids.map(|id| (id, held.only(id).bytes(&nowhere, &[], 0))).collect(),
        })
    }

    /// What a model of each species takes on average.
    fn mean_bytes(&self, palette: &Palette) -> BTreeMap<String, u64> {
        let mut sums: BTreeMap<String, (u64, u64)> = BTreeMap::new();
        for plant in &palette.representatives {
            let (sum, count) = sums.entry(plant.species.clone()).or_default();
            *sum += self.each.get(&plant.id).copied().unwrap_or(0);
            *count += 1;
        }
        sums.into_iter().map(|(name, (sum, count))| (name, sum / count.max(1))).collect()
    }
}
