//! The search of the best mode: swaps that merge two clusters and split a third, from several
//! starts.
//!
//! Lloyd's steps end in a local optimum, which swaps leave: where two clusters cost little to
//! merge and a third gains more by a cut, their exchange lowers the distortion before the next
//! steps begin. Where clusters are few, a single optimum is often not the best, and the search
//! begins again from centres drawn apart from each other [Arthur07].
//!
//! Long tables are searched in a condensed form; the centres found there settle on all rows.

use crate::codebook::split_samples;
use crate::condense::{cells_for, condensed, thinned};
use crate::refine::{Partition, State, descend, descend_from, means};
use crate::samples::Samples;
use crate::split::best_gain;
use rayon::prelude::*;
use weald_contract::{Seed, Stream};

/// Rounds of swaps at many clusters, where one round swaps several and more no longer pay.
const ROUNDS: usize = 12;
/// Rounds below [`FEW`] clusters: there a single swap matters, and many can be tried.
const ROUNDS_OF_FEW: usize = 48;
const FEW: usize = 64;
/// Lloyd's steps in each round: twice as many take twice the time and leave the same error.
const STEPS_PER_ROUND: usize = 4;
/// Steps before the first and after the last round; most partitions settle sooner.
const STEPS_TO_SETTLE: usize = 60;
/// How far a search goes.
struct Effort {
    /// Part of the distortion that a step must lower to be followed by another: before swaps, and
    /// after them.
    gains: [f64; 2],
    /// Rows times columns times clusters that all other starts may compare in one step: starts are
    /// for small tables and few clusters, where they take little time.
    starts_work: usize,
    /// Other starts at least.
    starts: usize,
    /// Rounds of swaps where clusters are not [`FEW`].
    rounds: usize,
}

/// On all rows: until steps settle.
const WHOLE: Effort = Effort { gains: [0.0; 2], starts_work: 1 << 21, starts: 0, rounds: ROUNDS };

/// On all rows, for [`MANY`] clusters: splitting is then a poor start, and swaps go on gaining. 1024
/// clusters of 100,000 rows of 4 columns end 1.5 % lower, after nine times as long.
const DEEP: Effort = Effort { gains: [0.0; 2], starts_work: 0, starts: 2, rounds: 64 };
const MANY: usize = 512;

/// On a condensed table, whose centres move on when they meet all rows: swaps change more than the
/// last steps before them would.
const ROUGH: Effort =
    Effort { gains: [1e-3, 1e-4], starts_work: 1 << 19, starts: 0, rounds: ROUNDS };

/// On a condensed table, from this many clusters on: of 256 clusters of 100,000 rows of 2 to 4
/// columns, more rounds lower the error by 0.4 to 0.7 % in three to five times as long.
const ROUGH_FOR_MORE: Effort = Effort { rounds: 40, ..ROUGH };
const MORE: usize = 128;

/// Part of the distortion that a step on all rows after that must lower to be followed by another.
const GAIN_TO_SETTLE: f64 = 1e-3;

/// Times as many cells in which centres settle before they meet all rows: as a step on the cells
/// costs less than one on all rows.
const FINER: usize = 4;

/// Rows that are searched for [`MANY`] clusters, at least, and for each cluster; of longer tables a
/// sample.
const SAMPLE: usize = 1 << 18;
const ROWS_A_CLUSTER: usize = 256;

/// Other starts at most.
const STARTS: usize = 128;

/// Clusters samples into at most `k` clusters, with as little distortion as is found.
pub(crate) fn search(samples: &Samples, k: usize) -> Partition {
    if samples.dims == 0 || samples.len() == 0 {
        return split_samples(samples, k);
    }
    let found = if k >= MANY {
        let thin = thinned(samples, SAMPLE.max(k.saturating_mul(ROWS_A_CLUSTER)));
        thin.map(|rows| search_all(&rows, k, &DEEP))
    } else {
        search_condensed(samples, k, if k >= MORE { &ROUGH_FOR_MORE } else { &ROUGH })
    };
    match found {
        // With fewer clusters than asked for, a part may lack rows that the table has.
        Some(found) if found.partition.k == k => {
            descend_from(samples, found.centres, STEPS_TO_SETTLE, GAIN_TO_SETTLE).partition
        }
        _ => search_all(samples, k, if k >= MANY { &DEEP } else { &WHOLE }).partition,
    }
}

/// Searches a condensed table, and settles on one that is less condensed; `None` for short ones.
fn search_condensed(samples: &Samples, k: usize, effort: &Effort) -> Option<State> {
    let cells = cells_for(samples.len(), k);
    let found = search_all(&condensed(samples, cells)?, k, effort);
    let finer = condensed(samples, cells.saturating_mul(FINER));
    Some(match finer {
        Some(finer) => descend_from(&finer, found.centres, STEPS_TO_SETTLE, GAIN_TO_SETTLE),
        None => found,
    })
}

/// Searches from splitting and from other starts, and keeps the best.
fn search_all(samples: &Samples, k: usize, effort: &Effort) -> State {
    let first = split_samples(samples, k);
    let k = first.k;
    let start = means(samples, &first);
    let best = search_from(samples, start, effort);
    let work = samples.rows.len().saturating_mul(k).max(1);
    let starts = if k < 2 || k >= samples.len() {
        0
    } else {
        (effort.starts_work / work).clamp(effort.starts, STARTS)
    };
    let others: Vec<State> = (0..starts as u64)
        .into_par_iter()
        .map(|start| {
            // Chance of its own: a start is the same in every search of the same table.
            let centres = spread(samples, k, &mut Seed(0).stream("quantize start", start));
            search_from(samples, centres, effort)
        })
        .collect();
    // The first of equally good ones: order decides, not the threads.
    others
        .into_iter()
        .fold(best, |best, other| if other.distortion < best.distortion { other } else { best })
}

/// Draws `k` of the samples, each with a chance proportional to its weighted squared distance to
/// those drawn before [Arthur07].
fn spread(samples: &Samples, k: usize, random: &mut Stream) -> Vec<f32> {
    let mut distance = vec![f64::INFINITY; samples.len()];
    let mut centres = Vec::with_capacity(k * samples.dims);
    let mut chances: Vec<f64> = samples.weights.iter().map(|weight| f64::from(*weight)).collect();
    for _ in 0..k {
        let drawn = draw(&chances, random);
        let centre = samples.row(drawn).to_vec();
        for (sample, distance) in distance.iter_mut().enumerate() {
            let apart = samples.row(sample).iter().zip(&centre);
            let apart: f64 = apart.map(|(a, b)| f64::from(a - b).powi(2)).sum();
            *distance = distance.min(apart);
            chances[sample] = *distance * f64::from(samples.weights[sample]);
        }
        centres.extend(centre);
    }
    centres
}

/// An index with a chance proportional to its number; the last when no number is above 0.
fn draw(chances: &[f64], random: &mut Stream) -> usize {
    let mut left = random.unit() * chances.iter().sum::<f64>();
    let found = chances.iter().position(|chance| {
        left -= chance;
        left < 0.0
    });
    found.unwrap_or(chances.len() - 1)
}

/// Searches on from centres by rounds of swaps, keeping only what lowers the distortion.
fn search_from(samples: &Samples, centres: Vec<f32>, effort: &Effort) -> State {
    let [before, after] = effort.gains;
    let mut state = descend_from(samples, centres, STEPS_TO_SETTLE, before);
    let k = state.partition.k;
    // A round may swap up to a quarter of the clusters at once; when that fails, fewer, and when
    // a single one fails, the next best.
    let (mut most, mut passed_over) = (k.div_ceil(4), 0);
    for _ in 0..if k < FEW { ROUNDS_OF_FEW } else { effort.rounds } {
        let swapped = swap(samples, &state, most, passed_over);
        let next = swapped.map(|swapped| descend(samples, &swapped, STEPS_PER_ROUND));
        match next {
            Some(next) if next.distortion < state.distortion => (state, passed_over) = (next, 0),
            _ if most > 1 => most = most.div_ceil(4),
            Some(_) => passed_over += 1,
            None => break,
        }
    }
    descend_from(samples, state.centres, STEPS_TO_SETTLE, after)
}

/// Merges cheap pairs and cuts costly clusters, at most `most` at once, each cluster in one role.
///
/// The cheapest `passed_over` merges are left out. `None` when there is nothing left to swap.
fn swap(samples: &Samples, state: &State, most: usize, passed_over: usize) -> Option<Partition> {
    let k = state.partition.k;
    let members = members(&state.partition);
    let cuts: Vec<Option<(usize, f32, f64)>> =
        members.par_iter().map(|members| best_gain(samples, members)).collect();
    let mut by_gain: Vec<usize> = (0..k).filter(|label| cuts[*label].is_some()).collect();
    let gain = |label: usize| cuts[label].map_or(0.0, |(_, _, gain)| gain);
    by_gain.sort_by(|a, b| gain(*b).total_cmp(&gain(*a)).then(a.cmp(b)));
    let merges = cheapest_merges(samples, state);

    let mut is_used = vec![false; k];
    let mut labels = state.partition.labels.clone();
    let mut count = 0;
    let mut costly = by_gain.into_iter();
    for Merge { cost, from, into } in merges.into_iter().skip(passed_over) {
        if count == most || is_used[from] || is_used[into] {
            continue;
        }
        let free = |label: &usize| !is_used[*label] && *label != from && *label != into;
        let Some(cut_label) = costly.find(free) else { break };
        let Some((dim, value, gain)) = cuts[cut_label] else { break };
        // A single swap is tried even where its first effect is a loss: the steps that follow
        // may turn it. Several at once would only add up.
        if gain <= cost && most > 1 {
            break;
        }
        members[from].iter().for_each(|sample| labels[*sample as usize] = into as u32);
        for sample in &members[cut_label] {
            if samples.row(*sample as usize)[dim] > value {
                labels[*sample as usize] = from as u32;
            }
        }
        for label in [from, into, cut_label] {
            is_used[label] = true;
        }
        count += 1;
    }
    (count > 0).then_some(Partition { labels, k })
}

/// Samples of each cluster.
fn members(partition: &Partition) -> Vec<Vec<u32>> {
    let mut members = vec![Vec::new(); partition.k];
    for (sample, label) in partition.labels.iter().enumerate() {
        members[*label as usize].push(sample as u32);
    }
    members
}

/// What it costs to give the samples of one cluster to another.
struct Merge {
    cost: f64,
    from: usize,
    into: usize,
}

/// For each cluster its cheapest merge into one that is no lighter, cheapest first:
/// `w0 w1 / (w0 + w1) |c0 - c1|²` [Ward63].
///
/// Every pair is looked at from its lighter side, where the factor is at least half the lighter
/// weight. So clusters are sought outwards along the first axis, and no farther than that axis
/// alone could still be cheaper: far fewer than all pairs.
fn cheapest_merges(samples: &Samples, state: &State) -> Vec<Merge> {
    let (dims, k) = (samples.dims, state.partition.k);
    let mut weights = vec![0.0; k];
    for (label, weight) in state.partition.labels.iter().zip(&samples.weights) {
        weights[*label as usize] += f64::from(*weight);
    }
    let centre = |label: usize| &state.centres[label * dims..][..dims];
    let mut along: Vec<usize> = (0..k).collect();
    along.sort_by(|a, b| centre(*a)[0].total_cmp(&centre(*b)[0]).then(a.cmp(b)));
    let pairs = Pairs { centres: &state.centres, dims, weights: &weights, along: &along };
    let mut merges: Vec<Merge> =
        (0..k).into_par_iter().filter_map(|place| pairs.cheapest(place)).collect();
    merges.sort_by(|a, b| a.cost.total_cmp(&b.cost).then(a.from.cmp(&b.from)));
    merges
}

/// Clusters in their order along the first axis.
struct Pairs<'a> {
    centres: &'a [f32],
    dims: usize,
    weights: &'a [f64],
    along: &'a [usize],
}

impl Pairs<'_> {
    fn centre(&self, label: usize) -> &[f32] {
        &self.centres[label * self.dims..][..self.dims]
    }

    fn cost(&self, a: usize, b: usize) -> f64 {
        let total = self.weights[a] + self.weights[b];
        let apart =
            self.centre(a).iter().zip(self.centre(b)).map(|(a, b)| f64::from(a - b).powi(2));
        match total > 0.0 {
            true => self.weights[a] * self.weights[b] / total * apart.sum::<f64>(),
            false => 0.0,
        }
    }

    /// The cheapest merge of the cluster at a place along the axis.
    fn cheapest(&self, place: usize) -> Option<Merge> {
        let from = self.along[place];
        let is_heavier = |into: usize| (self.weights[into], into) > (self.weights[from], from);
        let mut best: Option<Merge> = None;
        let mut look = |into: usize| -> bool {
            let gap = f64::from(self.centre(into)[0] - self.centre(from)[0]);
            let least = self.weights[from] / 2.0 * gap * gap;
            if best.as_ref().is_some_and(|best| least > best.cost) {
                return false;
            }
            if is_heavier(into) {
                let cost = self.cost(from, into);
                // Of equally cheap ones the lowest label.
                let is_better = |best: &Merge| (cost, into) < (best.cost, best.into);
                if best.as_ref().is_none_or(is_better) {
                    best = Some(Merge { cost, from, into });
                }
            }
            true
        };
        let (mut left, mut right) = (place, place + 1);
        let (mut goes_left, mut goes_right) = (true, true);
        while goes_left || goes_right {
            goes_left = goes_left && left > 0 && look(self.along[left - 1]);
            left -= usize::from(goes_left);
            goes_right = goes_right && right < self.along.len() && look(self.along[right]);
            right += usize::from(goes_right);
        }
        best
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::Table;

    #[test]
    fn the_cheapest_merge_of_all_pairs_is_found() {
        for round in 0..20 {
            let mut random = Seed(6).stream("clusters", round);
            let k = 2 + random.below(60) as usize;
            let centres: Vec<f32> = (0..k * 3).map(|_| random.normal() as f32).collect();
            let weights: Vec<f64> = (0..k).map(|_| random.unit().powi(4)).collect();
            let mut along: Vec<usize> = (0..k).collect();
            along.sort_by(|a, b| centres[a * 3].total_cmp(&centres[b * 3]));
            let pairs = Pairs { centres: &centres, dims: 3, weights: &weights, along: &along };
            let found = (0..k).filter_map(|place| pairs.cheapest(place)).map(|merge| merge.cost);
            let all = (0..k).flat_map(|a| (0..a).map(move |b| (a, b)));
            let least = all.map(|(a, b)| pairs.cost(a, b)).fold(f64::INFINITY, f64::min);
            assert_eq!(found.fold(f64::INFINITY, f64::min), least);
        }
    }

    #[test]
    fn centres_are_drawn_apart_and_never_without_weight() {
        // Three places, one of which carries no weight.
        let values = [0.0, 5.0, 9.0].into_iter().cycle().take(30).collect();
        let weights = [1.0, 2.0, 0.0].into_iter().cycle().take(30).collect();
        let samples = Samples::of(&Table::new(values, 1, weights).unwrap());
        for start in 0..20 {
            let mut centres = spread(&samples, 2, &mut Seed(0).stream("test", start));
            centres.sort_by(f32::total_cmp);
            assert_eq!(centres, [samples.row(0)[0], samples.row(10)[0]]);
        }
    }
}
