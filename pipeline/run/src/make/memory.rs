//! As many plant models as fit into memory: what a model takes is known when it has grown.

use super::plants::Growing;
use super::quantize::Quantizing;
use crate::check::bytes_in_words;
use crate::error::{Error, Result};
use rayon::prelude::*;
use std::collections::BTreeMap;
use weald_contract::{Palette, Population, Progress};
use weald_quantize::{Bytes, Config, Quantized};

/// Models of each species that are grown first, for a mean of what one takes.
const PROBES: u32 = 4;

/// Palettes that are grown at most, each nearer to what is allowed.
const TRIES: usize = 5;

/// A palette that takes this part of what is allowed, or more, is full enough.
const FULL: f64 = 0.95;

/// Quantizes with as many models as the renderer can hold beside their instances in `allowed` bytes.
///
/// # Errors
/// A species cannot be grown, or one model of each takes too much already.
pub(super) fn quantize_within(
    allowed: u64,
    quantizing: &Quantizing<'_>,
    growing: &Growing<'_>,
    population: &Population,
    progress: &dyn Progress,
) -> Result<Quantized> {
    let probes = Config { representatives: PROBES, ..quantizing.config.clone() };
    let probed = Quantizing { config: &probes, ..*quantizing }.plain(population, progress)?;
    let triangles = triangles(growing, &probed.palette)?;
    let of_model = mean_bytes(&probed.palette, &triangles);
    let whole = weald_render::estimate_bytes(&triangles, &probed.instances, 0);
    let models: u64 = weald_render::estimate_bytes(&triangles, &Default::default(), 0);
    // What is left for models beside instances and patches.
    let mut room = allowed.saturating_sub(whole - models) as f64;
    let mut best: Option<(u64, Quantized)> = None;
    let mut least = whole;
    for _ in 0..TRIES {
        let of_model = |name: &str| of_model.get(name).copied().unwrap_or(1);
        let bytes = Bytes { budget: room as u64, of_model: &of_model };
        let Ok(found) = quantizing.within(bytes, population, progress) else { break };
        let triangles = self::triangles(growing, &found.palette)?;
        let taken = weald_render::estimate_bytes(&triangles, &found.instances, 0);
        let models = weald_render::estimate_bytes(&triangles, &Default::default(), 0);
        least = least.min(taken);
        let is_fuller = best.as_ref().is_none_or(|(most, _)| taken > *most);
        if taken <= allowed && is_fuller {
            best = Some((taken, found));
        }
        let is_full = taken <= allowed && taken as f64 >= FULL * allowed as f64;
        if is_full || models == 0 {
            break;
        }
        let beside = (taken - models) as f64;
        room *= ((allowed as f64 - beside).max(0.0) / models as f64).clamp(0.1, 10.0);
    }
    best.map(|(_, found)| found).ok_or_else(|| {
        Error::plain(
            format!(
                "`memory_gb` allows {}, but these plants take {} with few models",
                bytes_in_words(allowed),
                bytes_in_words(least)
            ),
            "allow more, or place fewer plants",
        )
    })
}

/// Triangles of each model as the renderer holds it.
fn triangles(growing: &Growing<'_>, palette: &Palette) -> Result<BTreeMap<u32, u64>> {
    let plants = palette.representatives.par_iter();
    plants.map(|plant| Ok((plant.id, growing.grow(plant)?.instanced_triangles()))).collect()
}

/// What a model of each species takes on average.
fn mean_bytes(palette: &Palette, triangles: &BTreeMap<u32, u64>) -> BTreeMap<String, u64> {
    let mut sums: BTreeMap<String, (u64, u64)> = BTreeMap::new();
    for plant in &palette.representatives {
        let one = BTreeMap::from([(plant.id, triangles.get(&plant.id).copied().unwrap_or(0))]);
        let (sum, count) = sums.entry(plant.species.clone()).or_default();
        *sum += weald_render::estimate_bytes(&one, &Default::default(), 0);
        *count += 1;
    }
    sums.into_iter().map(|(name, (sum, count))| (name, sum / count.max(1))).collect()
}
