//! Models for plants and variants for patches such that neighbours differ.
//!
//! A patch that stands beside itself, turned alike, is seen as a pattern. All variants of a kind
//! are equally good stand-ins, so a place may take another than its chance says. A plant may take
//! another model than the nearest where that one is about as near.

use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::TAU;

/// A patch in the scene.
pub(crate) struct Spot {
    pub id: u64,
    pub position: [f64; 2],
    /// Radians.
    pub yaw: f64,
    /// Patches of another kind are other patches.
    pub kind: usize,
    /// The variant that chance gives it.
    pub wish: u64,
}

/// Turns that differ by less look alike, radians: 5 degrees.
const SAME_TURN: f64 = TAU / 72.0;

/// A variant for each spot: its wish, or the next one that no spot within `reach` has with the
/// same turn, if there is any. Spots choose in the order of their ids.
pub(crate) fn vary(spots: &[Spot], reach: f64, variants: u64) -> Vec<u64> {
    let mut order: Vec<usize> = (0..spots.len()).collect();
    order.sort_by_key(|index| (spots[*index].id, *index));
    let cell = |position: [f64; 2]| position.map(|x| (x / reach).floor() as i64);
    let mut standing: BTreeMap<[i64; 2], Vec<usize>> = BTreeMap::new();
    let mut chosen: Vec<u64> = spots.iter().map(|spot| spot.wish).collect();
    for index in order {
        let spot = &spots[index];
        let [column, row] = cell(spot.position);
        let around = (-1..=1).flat_map(|dx| (-1..=1).map(move |dy| [column + dx, row + dy]));
        let near: Vec<u64> = around
            .filter_map(|cell| standing.get(&cell))
            .flatten()
            .filter(|other| looks_alike(spot, &spots[**other], reach))
            .map(|other| chosen[*other])
            .collect();
        let candidates = (0..variants).map(|step| (spot.wish + step) % variants);
        let free = candidates.into_iter().find(|variant| !near.contains(variant));
        chosen[index] = free.unwrap_or(spot.wish);
        standing.entry([column, row]).or_default().push(index);
    }
    chosen
}

/// Whether two spots would be seen as one pattern if they had the same variant.
fn looks_alike(a: &Spot, b: &Spot, reach: f64) -> bool {
    a.kind == b.kind && are_twins((a.position, a.yaw), (b.position, b.yaw), reach)
}

/// Whether two places with their turns are within `reach` and turned alike.
fn are_twins((a, yaw): ([f64; 2], f64), (b, other_yaw): ([f64; 2], f64), reach: f64) -> bool {
    let [dx, dy] = [0, 1].map(|axis| b[axis] - a[axis]);
    let turn = (other_yaw - yaw).rem_euclid(TAU);
    dx * dx + dy * dy <= reach * reach && turn.min(TAU - turn) < SAME_TURN
}

/// A plant of the scene.
#[derive(Clone, Copy)]
pub(crate) struct Beside {
    pub id: u64,
    pub position: [f64; 2],
    /// Radians.
    pub yaw: f64,
}

/// A cluster for each plant: its own by `labels`, or where a plant within `reach` has the same one
/// with the same turn, the first of `others` that none there has, if there is any.
///
/// Plants choose in the order of their ids, and the last plant of a cluster stays in it.
pub(crate) fn part(
    plants: &[Beside],
    labels: &[u32],
    reach: f64,
    others: impl Fn(usize) -> Vec<u32>,
) -> Vec<u32> {
    let mut chosen = labels.to_vec();
    let cells = Cells::of(plants, reach);
    let twins = |index: usize| cells.twins(plants, index, reach);
    let clashes =
        |chosen: &[u32], index: usize| twins(index).any(|other| chosen[other] == chosen[index]);
    let is_clash = |index: &usize| clashes(labels, *index);
    let mut clashing: Vec<usize> = (0..plants.len()).into_par_iter().filter(is_clash).collect();
    clashing.sort_by_key(|index| (plants[*index].id, *index));
    let mut counts = vec![0u64; labels.iter().max().map_or(0, |label| *label as usize + 1)];
    labels.iter().for_each(|label| counts[*label as usize] += 1);
    for index in clashing {
        let own = chosen[index] as usize;
        // A twin that chose before may have gone elsewhere.
        if counts[own] < 2 || !clashes(&chosen, index) {
            continue;
        }
        let taken: Vec<u32> = twins(index).map(|other| chosen[other]).collect();
        if let Some(label) = others(index).into_iter().find(|label| !taken.contains(label)) {
            counts[own] -= 1;
            counts[label as usize] += 1;
            chosen[index] = label;
        }
    }
    chosen
}

/// Plants sorted by squares of the ground.
struct Cells {
    side: f64,
    /// Column and row of a square, and a plant there; sorted.
    plants: Vec<([i64; 2], usize)>,
}

impl Cells {
    fn of(plants: &[Beside], side: f64) -> Self {
        let cell = |plant: &Beside| plant.position.map(|x| (x / side).floor() as i64);
        let mut plants: Vec<_> =
            plants.iter().enumerate().map(|(index, plant)| (cell(plant), index)).collect();
        plants.par_sort_unstable();
        Self { side, plants }
    }

    /// Plants within `reach`, at most a square's side, that are turned as the plant `index` is.
    fn twins<'a>(
        &'a self,
        plants: &'a [Beside],
        index: usize,
        reach: f64,
    ) -> impl Iterator<Item = usize> + 'a {
        let plant = &plants[index];
        let place = |plant: &Beside| (plant.position, plant.yaw);
        let is_twin = move |other: &usize| are_twins(place(plant), place(&plants[*other]), reach);
        self.around(plant.position).filter(move |other| *other != index).filter(is_twin)
    }

    /// Plants in the square of a place and the eight around it.
    fn around(&self, place: [f64; 2]) -> impl Iterator<Item = usize> + '_ {
        let [column, row] = place.map(|x| (x / self.side).floor() as i64);
        let in_column = move |aside: i64| {
            let column = column.saturating_add(aside);
            let [from, to] = [-1, 1].map(|aside| [column, row.saturating_add(aside)]);
            let start = self.plants.partition_point(|(cell, _)| *cell < from);
            self.plants[start..].iter().take_while(move |(cell, _)| *cell <= to)
        };
        (-1..=1).flat_map(in_column).map(|(_, plant)| *plant)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    /// A lawn of `side` by `side` patches, a metre apart, with quarter turns.
    fn lawn(side: u64, variants: u64) -> Vec<Spot> {
        let mut random = Seed(2).stream("lawn", 0);
        let mut spot = |id: u64| Spot {
            id,
            position: [(id % side) as f64, (id / side) as f64],
            yaw: TAU / 4.0 * random.below(4) as f64,
            kind: 0,
            wish: random.below(variants),
        };
        (0..side * side).map(&mut spot).collect()
    }

    fn clashes(spots: &[Spot], chosen: &[u64]) -> usize {
        let pairs = (0..spots.len()).flat_map(|a| (0..a).map(move |b| (a, b)));
        pairs
            .filter(|(a, b)| chosen[*a] == chosen[*b] && looks_alike(&spots[*a], &spots[*b], 1.5))
            .count()
    }

    #[test]
    fn no_patch_stands_beside_itself_where_variants_are_enough() {
        let spots = lawn(30, 9);
        let wishes: Vec<u64> = spots.iter().map(|spot| spot.wish).collect();
        assert!(clashes(&spots, &wishes) > 20);
        // Eight neighbours leave one of nine variants free.
        let chosen = vary(&spots, 1.5, 9);
        assert_eq!(clashes(&spots, &chosen), 0);
        let kept = chosen.iter().zip(&wishes).filter(|(a, b)| a == b).count();
        assert!(kept > 700, "only {kept} of 900 kept their wish");
    }

    #[test]
    fn one_variant_is_all_there_is() {
        let spots = lawn(5, 1);
        assert_eq!(vary(&spots, 1.5, 1), [0; 25]);
    }

    /// A meadow at random, with few turns, and models that are as good as the next two.
    #[test]
    fn plants_stand_beside_themselves_only_where_no_other_model_is_free() {
        const MODELS: u32 = 7;
        const REACH: f64 = 1.5;
        let mut random = Seed(5).stream("meadow", 0);
        let plants: Vec<Beside> = (0..900)
            .map(|id| Beside {
                id,
                position: [30.0 * random.unit() - 15.0, 30.0 * random.unit()],
                yaw: TAU / 3.0 * random.below(3) as f64,
            })
            .collect();
        let labels: Vec<u32> = plants.iter().map(|_| random.below(MODELS.into()) as u32).collect();
        let others = |index: usize| [1, 2].map(|step| (labels[index] + step) % MODELS).to_vec();
        let chosen = part(&plants, &labels, REACH, others);
        let twins = |a: usize, b: usize| {
            let apart = [0, 1].map(|axis| plants[a].position[axis] - plants[b].position[axis]);
            a != b && apart[0].hypot(apart[1]) <= REACH && plants[a].yaw == plants[b].yaw
        };
        let beside = |a: usize, chosen: &[u32], label: u32| {
            (0..plants.len()).any(|b| twins(a, b) && chosen[b] == label)
        };
        let count =
            |chosen: &[u32]| (0..plants.len()).filter(|a| beside(*a, chosen, chosen[*a])).count();
        let (before, after) = (count(&labels), count(&chosen));
        assert!(before > 200 && 10 * after < before, "{before} {after}");
        for plant in 0..plants.len() {
            let has_moved = chosen[plant] != labels[plant];
            assert!(!has_moved || others(plant).contains(&chosen[plant]));
            assert!(!has_moved || beside(plant, &labels, labels[plant]), "moved without need");
        }
    }

    #[test]
    fn a_cluster_keeps_its_last_plant() {
        let plant = |id| Beside { id, position: [0.0, 0.0], yaw: 0.0 };
        let plants = [plant(0), plant(1), plant(2)];
        // Two may leave; the third has nobody beside it any more.
        assert_eq!(part(&plants, &[0, 0, 1], 1.0, |_| vec![1]), [0, 0, 1]);
        assert_eq!(part(&plants, &[0, 1, 1], 1.0, |_| vec![0, 1]), [0, 1, 1]);
        assert_eq!(part(&plants[..2], &[0, 0], 1.0, |_| vec![0]), [0, 0]);
    }
}
