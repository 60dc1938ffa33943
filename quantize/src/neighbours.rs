//! Variants for patches such that neighbours differ.
//!
//! A patch that stands beside itself, turned alike, is seen as a pattern. All variants of a kind
//! are equally good stand-ins, so a place may take another than its chance says.

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
    let apart = (a.position[0] - b.position[0]).hypot(a.position[1] - b.position[1]);
    let turn = (a.yaw - b.yaw).rem_euclid(TAU);
    a.kind == b.kind && apart <= reach && turn.min(TAU - turn) < SAME_TURN
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
}
