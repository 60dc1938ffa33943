//! Thinning: as many plants as said stay, evenly over the ground.
//!
//! The plants are put in order along a Hilbert curve, and the parts of them that are to stay are
//! summed up. Between two whole numbers of that sum lie plants that stand near each other; one of
//! them stays, the strongest unless said otherwise. So the count is exact, every patch of ground
//! keeps its share, and competition is between neighbours only, as a forester decides it.

use crate::Error;
use crate::clear::record;
use crate::config::{Favour, Thin};
use crate::curve::hilbert_index;
use crate::field::BoundFormula;
use crate::stand::Stand;
use crate::steps::Site;
use std::collections::HashMap;
use weald_contract::{Frame, Plant, Problem};

/// Cells along the curve's side as a power of two: a millimetre on 4 km.
const CURVE_BITS: u32 = 22;

/// Removes all but the plants that stay.
pub(crate) fn run(thin: &Thin, site: &Site<'_>, stand: &mut Stand<'_>) -> Result<(), Error> {
    site.progress.begin("thin", 2, "steps");
    if thin.keep.is_none() && thin.plants.is_none() && thin.stems == 0.0 {
        let problem = Problem::new("a `thin` step says nowhere how many plants stay");
        return Err(problem.hint("give `keep`, `plants` or `stems`").into());
    }
    let mut species = Vec::new();
    for name in &thin.species {
        species.push(stand.species_of(name)?);
    }
    let frame = *site.ground.frame();
    let is_meant = |plant: &Plant| {
        let is_named = species.is_empty() || species.contains(&plant.species);
        is_named && thin.disc.is_none_or(|disc| is_in(disc, plant, &frame))
    };
    let plants = &stand.population.plants;
    let meant: Vec<usize> = (0..plants.len()).filter(|&index| is_meant(&plants[index])).collect();
    let shares = shares(thin, &meant, site, stand)?;
    let mut keep = vec![true; plants.len()];
    if thin.keep.is_some() || thin.plants.is_some() {
        meant.iter().for_each(|&index| keep[index] = false);
        for index in chosen(thin, &meant, &shares, site, stand) {
            keep[index] = true;
        }
    }
    site.progress.advance(1);
    if thin.stems > 0.0 {
        keep_apart(thin, &meant, &mut keep, site, stand);
    }
    record(stand, &keep);
    stand.keep(&keep);
    site.progress.advance(1);
    Ok(())
}

fn is_in([x, y, radius]: [f64; 3], plant: &Plant, frame: &Frame) -> bool {
    let (dx, dy) = (plant.x - frame.west - x, plant.y - frame.south - y);
    dx * dx + dy * dy <= radius * radius
}

/// Returns the part of each plant that is to stay, 0 to 1, together with the wanted number.
fn shares(
    thin: &Thin,
    meant: &[usize],
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Result<Vec<f64>, Error> {
    let plants = &stand.population.plants;
    let mut shares = match &thin.keep {
        None => vec![1.0; meant.len()],
        Some(formula) => {
            let bound = BoundFormula::bind(formula, site.around.terrain, stand)?;
            let place = |index: usize| [plants[meant[index]].x, plants[meant[index]].y];
            let parts = bound.numbers(meant.len(), place)?;
            parts.into_iter().map(|part| f64::from(part.clamp(0.0, 1.0))).collect()
        }
    };
    if let Some(wanted) = thin.plants {
        fit(&mut shares, wanted as f64);
    }
    Ok(shares)
}

/// Scales parts so that they add up to `wanted`, none above 1.
fn fit(shares: &mut [f64], wanted: f64) {
    let mut factor = 0.0;
    let mut full = 0;
    // What reaches 1 leaves its surplus to the others, of which more may then reach 1.
    for _ in 0..=shares.len() {
        let is_full = |share: &&f64| full > 0 && **share * factor >= 1.0;
        let open: f64 = shares.iter().filter(|share| !is_full(share)).sum();
        let next = (wanted - full as f64).max(0.0) / open;
        if !next.is_finite() {
            break;
        }
        factor = next;
        let reached = shares.iter().filter(|share| **share * factor >= 1.0).count();
        if reached == full {
            break;
        }
        full = reached;
    }
    shares.iter_mut().for_each(|share| *share = (*share * factor).min(1.0));
}

/// Returns the plants that stay: one for each whole number that the sum of parts passes.
fn chosen(
    thin: &Thin,
    meant: &[usize],
    shares: &[f64],
    site: &Site<'_>,
    stand: &Stand<'_>,
) -> Vec<usize> {
    let (plants, frame) = (&stand.population.plants, site.ground.frame());
    let side = (frame.width.max(frame.height) as f64 * frame.cell) / f64::from(1 << CURVE_BITS);
    let place = |plant: &Plant| {
        let cell =
            |length: f64| (length / side).clamp(0.0, f64::from((1 << CURVE_BITS) - 1)) as u32;
        hilbert_index(CURVE_BITS, [cell(plant.x - frame.west), cell(plant.y - frame.south)])
    };
    let mut order: Vec<(u64, usize)> =
        meant.iter().enumerate().map(|(at, &index)| (place(&plants[index]), at)).collect();
    // Plants are sorted by id, so that twins of a place are told apart the same way every time.
    order.sort_unstable();
    let rank = |at: usize| {
        let plant = &plants[meant[at]];
        match thin.favour {
            Favour::Large => f64::from(plant.radius),
            Favour::Small => -f64::from(plant.radius),
            Favour::Any => site.seed.stream("thin", plant.id).unit(),
        }
    };
    let total: f64 = shares.iter().sum();
    let is_whole = |at: &usize| shares[*at] >= 1.0;
    let mut chosen: Vec<usize> = (0..meant.len()).filter(is_whole).map(|at| meant[at]).collect();
    let (mut sum, mut group) = (0.0, Vec::new());
    // Whole numbers begin a half late, so that as many are passed as the sum rounds to.
    let mut next = 0.5;
    let compete = |(_, at): &(u64, usize)| shares[*at] > 0.0 && !is_whole(at);
    for (_, at) in order.into_iter().filter(compete) {
        group.push(at);
        sum += shares[at];
        // Rounding of a sum of thousands of thirds must not cost the last plant.
        if sum + 1e-9 * total >= next {
            let best =
                group.iter().copied().max_by(|&a, &b| rank(a).total_cmp(&rank(b)).then(b.cmp(&a)));
            let best = best.unwrap_or(at);
            chosen.push(meant[best]);
            group.clear();
            next += 1.0;
        }
    }
    chosen
}

/// Takes those that stand too near one that is favoured over them.
fn keep_apart(thin: &Thin, meant: &[usize], keep: &mut [bool], site: &Site<'_>, stand: &Stand<'_>) {
    let plants = &stand.population.plants;
    let mut order: Vec<usize> = meant.iter().copied().filter(|&index| keep[index]).collect();
    let chance = |index: usize| site.seed.stream("thin", plants[index].id).unit();
    match thin.favour {
        Favour::Large => order.sort_by(|&a, &b| plants[b].radius.total_cmp(&plants[a].radius)),
        Favour::Small => order.sort_by(|&a, &b| plants[a].radius.total_cmp(&plants[b].radius)),
        Favour::Any => order.sort_by(|&a, &b| chance(a).total_cmp(&chance(b))),
    }
    let mut standing = Standing { side: thin.stems, squares: HashMap::new() };
    for index in order {
        let place = [plants[index].x, plants[index].y];
        if standing.is_any_nearer(place) {
            keep[index] = false;
        } else {
            standing.add(place);
        }
    }
}

/// Stems by the square in which they stand.
struct Standing {
    side: f64,
    /// Only looked up, never walked through, so that its order does not matter.
    squares: HashMap<[i64; 2], Vec<[f64; 2]>>,
}

impl Standing {
    fn square(&self, place: [f64; 2]) -> [i64; 2] {
        place.map(|along| (along / self.side).floor() as i64)
    }

    fn add(&mut self, place: [f64; 2]) {
        self.squares.entry(self.square(place)).or_default().push(place);
    }

    /// Whether a stem stands nearer than a square's side.
    fn is_any_nearer(&self, [x, y]: [f64; 2]) -> bool {
        let [column, row] = self.square([x, y]);
        let near = (row - 1..=row + 1).flat_map(|r| (column - 1..=column + 1).map(move |c| [c, r]));
        near.filter_map(|square| self.squares.get(&square))
            .flatten()
            .any(|other| (other[0] - x).powi(2) + (other[1] - y).powi(2) < self.side.powi(2))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_add_up_to_what_is_wanted_and_none_is_above_one() {
        let sum_of = |wanted: f64| {
            let mut shares = vec![1.0, 0.5, 0.5, 0.0, 0.25];
            fit(&mut shares, wanted);
            assert!(shares.iter().all(|share| (0.0..=1.0).contains(share)) && shares[3] == 0.0);
            shares.iter().sum::<f64>()
        };
        for wanted in [0.0, 0.5, 1.7, 3.0, 3.9, 4.0] {
            assert!((sum_of(wanted) - wanted).abs() < 1e-9, "{wanted}");
        }
        // More than there are: all that may stay.
        assert_eq!(sum_of(9.0), 4.0);
        let mut none: Vec<f64> = Vec::new();
        fit(&mut none, 3.0);
    }
}
