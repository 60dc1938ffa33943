//! Envelopes: whether a pattern is one that a null model would give.
//!
//! The statistic of the observed pattern is held against that of simulations. At one radius chosen
//! beforehand the pointwise envelope is a test; over all radii together the largest deviation from
//! the mean decides, by its rank [Ripley77], [Baddeley16] chapter 10. Looking for radii at which a
//! curve leaves the pointwise envelope, and calling that a test, finds structure everywhere.

use crate::neighbors::Cells;
use crate::pattern::{Error, Pattern, Table, check_radii};
use crate::ripley::{Correction, KERNEL_WIDTH, check_cross, pair_weight};
use crate::{Statistic, statistics};
use rayon::prelude::*;
use std::f64::consts::{PI, TAU};
use std::fmt;
use weald_contract::{Progress, Seed};

/// Part of patterns of the null model that a test rejects.
pub const LEVEL: f64 = 0.05;

/// A statistic, the range it has under a null model, and what follows.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Envelope {
    /// The statistic, and the null model in the words of the verdict.
    pub subject: Subject,
    /// Radii.
    pub radii: Vec<f64>,
    /// Of the observed pattern.
    pub observed: Vec<f64>,
    /// Mean over the simulations and the observed pattern.
    pub mean: Vec<f64>,
    /// Lower and upper end of the pointwise envelope.
    pub pointwise: [Vec<f64>; 2],
    /// Lower and upper end of the global envelope; infinite with too few simulations for the level.
    pub global: [Vec<f64>; 2],
    /// What follows.
    pub verdict: Verdict,
}

/// Words for a verdict.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Subject {
    /// Name of the statistic.
    pub statistic: &'static str,
    /// The null model, as "points spread at random".
    pub null: &'static str,
    /// What a curve above the envelope means.
    pub above: &'static str,
    /// What a curve below it means.
    pub below: &'static str,
}

/// The outcome of the tests.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Verdict {
    /// Number of simulations.
    pub simulations: usize,
    /// Rank test of the largest absolute deviation from the mean over all radii.
    pub p: f64,
    /// Rank test of the extreme ranks [Myllymaki17], for which each radius counts alike: the
    /// deviation is dominated by the radii at which the statistic varies most.
    pub p_rank: f64,
    /// Level below which the null model is rejected.
    pub level: f64,
    /// Radius of the largest deviation.
    pub radius: f64,
    /// Whether the curve is above the mean there.
    pub is_above: bool,
    /// Part of the radii at which the curve is outside the pointwise envelope.
    pub outside: f64,
}

impl Verdict {
    /// Whether the null model is rejected by the largest deviation.
    pub fn is_rejected(&self) -> bool {
        self.p <= self.level
    }
}

impl fmt::Display for Envelope {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Verdict { simulations, p, p_rank, radius, is_above, .. } = self.verdict;
        let Subject { statistic, null, above, below } = self.subject;
        if self.verdict.is_rejected() {
            let meaning = if is_above { above } else { below };
            write!(f, "{statistic}: {meaning}, most at {radius:.4}")?;
        } else if self.verdict.level * ((simulations + 1) as f64) < 1.0 {
            write!(f, "{statistic}: too few simulations for a verdict on {null}")?;
        } else if p_rank <= self.verdict.level {
            // One noisy radius can hide what the others show.
            write!(f, "{statistic}: unlike {null} by its ranks, not by its largest deviation")?;
        } else {
            write!(f, "{statistic}: not told apart from {null}")?;
        }
        write!(
            f,
            " (p = {p:.3} by largest deviation, {p_rank:.3} by rank; {simulations} simulations)"
        )
    }
}

impl Envelope {
    /// Makes an envelope of curves over the same radii.
    ///
    /// Radii at which a curve is not finite have no part in the tests.
    ///
    /// # Errors
    /// No simulation; curves of another length than the radii; no radius at which all are finite.
    pub fn of(
        subject: Subject,
        radii: &[f64],
        observed: &[f64],
        simulated: &[Vec<f64>],
    ) -> Result<Self, Error> {
        if simulated.is_empty() {
            return Err(Error::TooFew { what: "simulations", found: 0, needed: 1 });
        }
        let curves: Vec<&[f64]> =
            std::iter::once(observed).chain(simulated.iter().map(Vec::as_slice)).collect();
        if let Some(curve) = curves.iter().find(|curve| curve.len() != radii.len()) {
            return Err(Error::Unmatched { sizes: curve.len(), points: radii.len() });
        }
        let usable: Vec<usize> =
            (0..radii.len()).filter(|row| curves.iter().all(|c| c[*row].is_finite())).collect();
        if usable.is_empty() {
            let what = "radii at which the statistic exists";
            return Err(Error::TooFew { what, found: 0, needed: 1 });
        }
        let total = curves.len() as f64;
        let mean: Vec<f64> = (0..radii.len())
            .map(|row| curves.iter().map(|curve| curve[row]).sum::<f64>() / total)
            .collect();
        let pointwise = pointwise(simulated, radii.len());
        let (deviations, row) = deviations(&curves, &mean, &usable);
        let width = critical(&deviations[1..]);
        let global = [-width, width].map(|width| mean.iter().map(|mean| mean + width).collect());
        let is_outside = |row: &&usize| {
            observed[**row] < pointwise[0][**row] || observed[**row] > pointwise[1][**row]
        };
        let verdict = Verdict {
            simulations: simulated.len(),
            p: rank_p(&deviations),
            p_rank: extreme_rank_p(&curves, &usable),
            level: LEVEL,
            radius: radii[row],
            is_above: observed[row] > mean[row],
            outside: usable.iter().filter(is_outside).count() as f64 / usable.len() as f64,
        };
        let (radii, observed) = (radii.to_vec(), observed.to_vec());
        Ok(Self { subject, radii, observed, mean, pointwise, global, verdict })
    }

    /// The columns `r, obs, mean, low, high, global_low, global_high`.
    pub fn table(&self) -> Table {
        let [low, high] = &self.pointwise;
        let [global_low, global_high] = &self.global;
        let columns = [
            ("r", &self.radii),
            ("obs", &self.observed),
            ("mean", &self.mean),
            ("low", low),
            ("high", high),
            ("global_low", global_low),
            ("global_high", global_high),
        ];
        let columns = columns.map(|(name, values)| (name, values.clone())).into();
        Table { name: "envelope", columns }
    }
}

/// Number of the most extreme simulations at each end that a test of the level rejects; at least
/// one, so few simulations give a wider test.
fn rejected(simulations: usize, level: f64) -> usize {
    ((level * (simulations + 1) as f64) as usize).clamp(1, simulations)
}

fn pointwise(simulated: &[Vec<f64>], rows: usize) -> [Vec<f64>; 2] {
    let rank = rejected(simulated.len(), LEVEL / 2.0);
    let (mut low, mut high) = (Vec::with_capacity(rows), Vec::with_capacity(rows));
    for row in 0..rows {
        let mut values: Vec<f64> = simulated.iter().map(|curve| curve[row]).collect();
        values.sort_by(f64::total_cmp);
        low.push(values[rank - 1]);
        high.push(values[values.len() - rank]);
    }
    [low, high]
}

/// Largest absolute deviation of each curve from the mean of all, the observed one included so
/// that all are alike under the null model, and the row of the first curve's.
fn deviations(curves: &[&[f64]], mean: &[f64], usable: &[usize]) -> (Vec<f64>, usize) {
    let of = |curve: &&[f64]| {
        let each = usable.iter().map(|row| ((curve[*row] - mean[*row]).abs(), *row));
        // The first of several equal ones.
        each.fold((-1.0, 0), |best, next| if next.0 > best.0 { next } else { best })
    };
    let all: Vec<(f64, usize)> = curves.iter().map(of).collect();
    let row = all.first().map_or(0, |(_, row)| *row);
    (all.into_iter().map(|(deviation, _)| deviation).collect(), row)
}

/// Deviation that a part [`LEVEL`] of the simulations reach.
fn critical(deviations: &[f64]) -> f64 {
    let mut sorted = deviations.to_vec();
    sorted.sort_by(f64::total_cmp);
    let rank = (LEVEL * (sorted.len() + 1) as f64) as usize;
    // With fewer than 19 simulations no deviation is rare enough.
    if rank == 0 { f64::INFINITY } else { sorted[sorted.len() - rank] }
}

/// Part of all values that are at least the first; ties count against it.
fn rank_p(values: &[f64]) -> f64 {
    let at_least = values.iter().filter(|value| **value >= values[0]).count();
    at_least as f64 / values.len() as f64
}

/// The same for the extreme ranks: a curve is as extreme as its most extreme rank over the radii,
/// and of equal ones that with more radii at this rank.
fn extreme_rank_p(curves: &[&[f64]], usable: &[usize]) -> f64 {
    let mut ranks = vec![Vec::with_capacity(usable.len()); curves.len()];
    for row in usable {
        let mut sorted: Vec<f64> = curves.iter().map(|curve| curve[*row]).collect();
        sorted.sort_by(f64::total_cmp);
        for (curve, ranks) in curves.iter().zip(&mut ranks) {
            let value = curve[*row];
            // Equal values share the less extreme rank: where all agree none is extreme.
            let from_below = sorted.partition_point(|other| *other <= value);
            let from_above = sorted.len() - sorted.partition_point(|other| *other < value);
            ranks.push(from_below.min(from_above));
        }
    }
    ranks.iter_mut().for_each(|ranks| ranks.sort_unstable());
    let at_least = ranks.iter().filter(|other| **other <= ranks[0]).count();
    at_least as f64 / curves.len() as f64
}

/// The envelope of a statistic under points spread at random, as many in the same window.
///
/// # Errors
/// No simulation; see [`statistics`]; the caller asked to stop.
pub fn of_randomness(
    pattern: &Pattern,
    statistic: Statistic,
    radii: &[f64],
    simulations: usize,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Envelope, Error> {
    let subject = subject(statistic, "points spread at random");
    let observed = curve(pattern, statistic, radii)?;
    let window = *pattern.window();
    let simulated = simulate(simulations, progress, |simulation| {
        let mut stream = seed.stream("randomness", simulation);
        let point =
            |_| [stream.range(window.x[0], window.x[1]), stream.range(window.y[0], window.y[1])];
        let points = (0..pattern.len()).map(point).collect();
        curve(&Pattern::new(points, window)?, statistic, radii)
    })?;
    Envelope::of(subject, radii, &observed, &simulated)
}

/// The envelope of a statistic over given patterns, such as replicates of a simulated stand.
///
/// # Errors
/// No pattern; see [`statistics`]; the caller asked to stop.
pub fn of_patterns(
    pattern: &Pattern,
    statistic: Statistic,
    radii: &[f64],
    patterns: &[Pattern],
    progress: &dyn Progress,
) -> Result<Envelope, Error> {
    let subject = subject(statistic, "the simulated patterns");
    let observed = curve(pattern, statistic, radii)?;
    let simulated = simulate(patterns.len(), progress, |simulation| {
        curve(&patterns[simulation as usize], statistic, radii)
    })?;
    Envelope::of(subject, radii, &observed, &simulated)
}

/// Curves of simulations in order, on as many threads as there are.
fn simulate(
    simulations: usize,
    progress: &dyn Progress,
    curve: impl Fn(u64) -> Result<Vec<f64>, Error> + Sync,
) -> Result<Vec<Vec<f64>>, Error> {
    progress.begin("simulations", simulations as u64, "patterns");
    let one = |simulation: usize| {
        if progress.is_cancelled() {
            return Err(Error::Cancelled);
        }
        let curve = curve(simulation as u64);
        progress.advance(1);
        curve
    };
    (0..simulations).into_par_iter().map(one).collect()
}

/// The statistic in the form that envelopes use: translation-corrected, or Kaplan and Meier's.
fn curve(pattern: &Pattern, statistic: Statistic, radii: &[f64]) -> Result<Vec<f64>, Error> {
    let column = match statistic {
        Statistic::K => return crate::ripley_k(pattern, radii, Correction::Translation),
        Statistic::L => {
            let k = crate::ripley_k(pattern, radii, Correction::Translation)?;
            return Ok(k.into_iter().map(|k| (k / PI).sqrt()).collect());
        }
        Statistic::Pcf => "trans",
        Statistic::G | Statistic::F | Statistic::J => "km",
    };
    let tables = statistics(pattern, &[statistic], radii)?;
    let column = tables.first().and_then(|table| table.column(column));
    Ok(column.unwrap_or_default().to_vec())
}

fn subject(statistic: Statistic, null: &'static str) -> Subject {
    let (gathered, apart) = ("points stand closer together", "points stand farther apart");
    let (above, below) = match statistic {
        // Much empty space lies between clusters, so F rises late.
        Statistic::F | Statistic::J => (apart, gathered),
        _ => (gathered, apart),
    };
    Subject { statistic: statistic.word(), null, above, below }
}

/// The envelope of K, L or g between two types, given all places, if types were dealt out at
/// random. The pairs of places are found once and serve all simulations.
///
/// # Errors
/// A pattern without a point; two windows; another statistic; no simulation; radii that are not
/// finite, negative or not rising; the caller asked to stop.
pub fn of_labels(
    [from, to]: [&Pattern; 2],
    statistic: Statistic,
    radii: &[f64],
    simulations: usize,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Envelope, Error> {
    check_cross(from, to)?;
    check_radii(radii)?;
    let subject = Subject {
        statistic: statistic.word(),
        null: "types that are dealt out at random",
        above: "the types stand together",
        below: "the types avoid each other",
    };
    let pairs = LabelledPairs::of(from, to, statistic, radii)?;
    let labels: Vec<bool> = (0..from.len() + to.len()).map(|index| index < from.len()).collect();
    let observed = pairs.curve(&labels);
    let simulated = simulate(simulations, progress, |simulation| {
        let mut labels = labels.clone();
        shuffle(&mut labels, seed, simulation);
        Ok(pairs.curve(&labels))
    })?;
    Envelope::of(subject, radii, &observed, &simulated)
}

/// Puts values in a random order, each as likely, by the method of Fisher and Yates.
fn shuffle<T>(values: &mut [T], seed: Seed, simulation: u64) {
    let mut stream = seed.stream("labels", simulation);
    for last in (1..values.len()).rev() {
        values.swap(last, stream.below(last as u64 + 1) as usize);
    }
}

/// All pairs of the points of two types that a statistic needs, found once.
struct LabelledPairs<'a> {
    radii: &'a [f64],
    statistic: Statistic,
    /// Numbers of both points, those of the second type after those of the first; first radius
    /// that the pair counts at; distance; weight.
    pairs: Vec<(u32, u32, u32, f64, f64)>,
    /// Number of pairs of both types in a unit of area.
    per_area: f64,
    /// Of the kernel of g.
    half_width: f64,
}

impl<'a> LabelledPairs<'a> {
    fn of(
        from: &Pattern,
        to: &Pattern,
        statistic: Statistic,
        radii: &'a [f64],
    ) -> Result<Self, Error> {
        let half_width = match statistic {
            Statistic::K | Statistic::L => 0.0,
            Statistic::Pcf => KERNEL_WIDTH / to.intensity().sqrt(),
            _ => return Err(Error::NotByLabels { statistic: statistic.word() }),
        };
        let window = *from.window();
        let points: Vec<[f64; 2]> = from.points().iter().chain(to.points()).copied().collect();
        // Numbers of points are stored in 32 bits.
        if u32::try_from(points.len()).is_err() {
            let right = "fewer than 2^32 points are right";
            let value = points.len() as f64;
            return Err(Error::BadValue { what: "the number of points", row: 0, value, right });
        }
        let all = Pattern::new(points, window)?;
        let reach = radii.last().copied().unwrap_or(0.0) + half_width;
        let cells = Cells::new(&all, reach);
        let mut pairs = Vec::new();
        for index in 0..cells.points.len() {
            let center = cells.points[index];
            cells.for_around(center, reach, |other, squared, apart| {
                if other <= index {
                    return;
                }
                let distance = squared.sqrt();
                let weight = pair_weight(Correction::Translation, &window, center, distance, apart);
                let first = match statistic {
                    Statistic::Pcf => radii.partition_point(|r| *r <= distance - half_width),
                    _ => radii.partition_point(|r| *r < distance),
                };
                let [a, b] = [index, other].map(|sorted| cells.numbers[sorted] as u32);
                pairs.push((a, b, first as u32, distance, weight));
            });
        }
        let per_area = from.intensity() * to.len() as f64;
        Ok(Self { radii, statistic, pairs, per_area, half_width })
    }

    /// The statistic if the points with a true label are of the first type.
    fn curve(&self, labels: &[bool]) -> Vec<f64> {
        let mixed =
            |pair: &&(u32, u32, u32, f64, f64)| labels[pair.0 as usize] != labels[pair.1 as usize];
        let mut sums = vec![0.0; self.radii.len() + 1];
        if self.statistic == Statistic::Pcf {
            for (_, _, first, distance, weight) in self.pairs.iter().filter(mixed) {
                let first = *first as usize;
                for (r, sum) in self.radii[first..].iter().zip(&mut sums[first..]) {
                    let t = (r - distance) / self.half_width;
                    if t >= 1.0 {
                        break;
                    }
                    *sum += weight * (1.0 - t * t);
                }
            }
            let scale = 0.75 / self.half_width / (TAU * self.per_area);
            let g = |(r, sum): (&f64, &f64)| if *sum == 0.0 { 0.0 } else { scale * sum / r };
            return self.radii.iter().zip(&sums).map(g).collect();
        }
        for (_, _, first, _, weight) in self.pairs.iter().filter(mixed) {
            sums[*first as usize] += weight;
        }
        let mut sum = 0.0;
        let k = |step: &f64| {
            sum += step;
            sum / self.per_area
        };
        let ks: Vec<f64> = sums[..self.radii.len()].iter().map(k).collect();
        match self.statistic {
            Statistic::L => ks.into_iter().map(|k| (k / PI).sqrt()).collect(),
            _ => ks,
        }
    }
}

/// The envelope of the mark correlation, given places and marks, if marks were dealt out at
/// random. The pairs of points are found once and serve all simulations.
///
/// # Errors
/// See [`crate::mark_correlation`]; no simulation; the caller asked to stop.
pub fn of_marks(
    pattern: &Pattern,
    marks: &[f64],
    radii: &[f64],
    simulations: usize,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Envelope, Error> {
    let subject = Subject {
        statistic: "markcorr",
        null: "marks that are dealt out at random",
        above: "neighbours have larger marks than chance gives them",
        below: "neighbours have smaller marks than chance gives them",
    };
    let pairs = crate::marks::MarkedPairs::of(pattern, marks, radii)?;
    let observed = pairs.translated(marks);
    let simulated = simulate(simulations, progress, |simulation| {
        let mut marks = marks.to_vec();
        shuffle(&mut marks, seed, simulation);
        Ok(pairs.translated(&marks))
    })?;
    Envelope::of(subject, radii, &observed, &simulated)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::pattern::Window;
    use crate::ripley::{cross_k_table, cross_pcf_table};
    use weald_contract::Silent;

    const FIELD: Window = Window { x: [0.0, 20.0], y: [0.0, 10.0] };

    fn random(n: usize, index: u64) -> Pattern {
        let mut stream = Seed(3).stream("points", index);
        let points = (0..n).map(|_| [stream.range(0.0, 20.0), stream.range(0.0, 10.0)]).collect();
        Pattern::new(points, FIELD).unwrap()
    }

    fn radii() -> Vec<f64> {
        (1..=20).map(|step| f64::from(step) * 0.1).collect()
    }

    const TEST: Subject = Subject { statistic: "T", null: "chance", above: "up", below: "down" };

    #[test]
    fn ranks_of_known_curves_give_known_p_values() {
        let simulated: Vec<Vec<f64>> = (1..=19).map(|i| vec![f64::from(i); 3]).collect();
        let p = |observed: f64| {
            let envelope =
                Envelope::of(TEST, &[1.0, 2.0, 3.0], &[observed; 3], &simulated).unwrap();
            (envelope.verdict.p, envelope.verdict.p_rank, envelope.verdict.is_rejected())
        };
        // Far above all 19: first of 20 by deviation; by rank it ties with the lowest.
        assert_eq!(p(100.0), (0.05, 0.1, true));
        // In the middle no curve is less extreme.
        assert_eq!(p(10.0).0, 1.0);
    }

    #[test]
    fn the_global_envelope_holds_the_curve_exactly_when_the_test_does_not_reject() {
        let window = radii();
        for index in 0..12 {
            let pattern = random(40, index);
            let seed = Seed(index);
            let envelope =
                of_randomness(&pattern, Statistic::L, &window, 39, seed, &Silent).unwrap();
            let is_inside = (0..window.len()).all(|row| {
                let [low, high] = [0, 1].map(|end: usize| envelope.global[end][row]);
                (low..=high).contains(&envelope.observed[row])
            });
            assert_eq!(is_inside, !envelope.verdict.is_rejected(), "{envelope}");
        }
    }

    #[test]
    fn random_points_are_rejected_as_often_as_the_level_says() {
        let rejected = |index: &u64| {
            let pattern = random(30, 1000 + index);
            let envelope =
                of_randomness(&pattern, Statistic::L, &radii(), 19, Seed(*index), &Silent).unwrap();
            envelope.verdict.is_rejected()
        };
        let count = (0..400).filter(rejected).count();
        // 20 expected of 400 with standard deviation 4.4.
        assert!((7..=33).contains(&count), "{count}");
    }

    #[test]
    fn clusters_and_lattices_are_told_from_randomness_by_every_statistic() {
        let mut stream = Seed(5).stream("spread", 0);
        let mut near = |[x, y]: [f64; 2], spread: f64| {
            [
                (x + stream.around(0.0, spread)).clamp(0.0, 20.0),
                (y + stream.around(0.0, spread)).clamp(0.0, 10.0),
            ]
        };
        let parents = random(20, 7);
        let clusters =
            (0..100).map(|index| near(parents.points()[index % 20], 0.3)).collect::<Vec<_>>();
        let lattice: Vec<[f64; 2]> = (0..98)
            .map(|index| {
                near([0.7 + (index % 14) as f64 * 1.4, 0.7 + (index / 14) as f64 * 1.4], 0.1)
            })
            .collect();
        use Statistic::{F, G, J, K, L, Pcf};
        for statistic in [K, L, G, F, J, Pcf] {
            for (points, meaning) in [(&clusters, "closer together"), (&lattice, "farther apart")] {
                // From where g has enough pairs to where the lattice leaves no empty space.
                let radii: Vec<f64> = (6..=18).map(|step| f64::from(step) * 0.05).collect();
                let pattern = Pattern::new(points.clone(), FIELD).unwrap();
                let envelope =
                    of_randomness(&pattern, statistic, &radii, 39, Seed(1), &Silent).unwrap();
                let Verdict { p, p_rank, is_above, .. } = envelope.verdict;
                assert!(p.min(p_rank) <= LEVEL, "{envelope}");
                let Subject { above, below, .. } = envelope.subject;
                let said = if is_above { above } else { below };
                assert!(said.contains(meaning), "{envelope}");
            }
        }
    }

    #[test]
    fn pairs_found_once_give_the_cross_statistics() {
        let (from, to) = (random(50, 1), random(70, 2));
        let radii = radii();
        for statistic in [Statistic::K, Statistic::Pcf] {
            let table = match statistic {
                Statistic::K => cross_k_table(&from, &to, &radii).unwrap(),
                _ => cross_pcf_table(&from, &to, &radii).unwrap(),
            };
            let envelope =
                of_labels([&from, &to], statistic, &radii, 19, Seed(2), &Silent).unwrap();
            for (ours, direct) in envelope.observed.iter().zip(table.column("trans").unwrap()) {
                assert!((ours - direct).abs() < 1e-9 * (1.0 + direct), "{ours} {direct}");
            }
        }
        let error = of_labels([&from, &to], Statistic::G, &radii, 19, Seed(2), &Silent);
        assert!(matches!(error, Err(Error::NotByLabels { statistic: "G" })));
    }

    #[test]
    fn one_thread_and_two_give_the_same_envelope() {
        let pattern = random(300, 3);
        let marks: Vec<f64> = pattern.points().iter().map(|[x, _]| *x).collect();
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| {
                let (radii, seed) = (radii(), Seed(8));
                let l = of_randomness(&pattern, Statistic::L, &radii, 39, seed, &Silent).unwrap();
                let marks = of_marks(&pattern, &marks, &radii, 39, seed, &Silent).unwrap();
                (l, marks)
            })
        };
        let (one, two) = (on(1), on(2));
        assert_eq!(one, two);
        // Marks that rise with x make neighbours alike, of the observed pattern only.
        assert!(one.1.verdict.is_rejected() && one.1.verdict.is_above, "{}", one.1);
    }
}
