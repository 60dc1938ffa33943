//! Breaching: hollows are opened by the cheapest ditch to lower ground, instead of being filled.
//!
//! From the floor of every hollow the way is searched on which the least has to be dug away until
//! ground lower than the floor, or the terrain's rim, is reached; everything above the floor is
//! dug away along it [Lindsay16]. Floors are taken from the lowest, equal ones in order of their
//! cells, and so are equally cheap ways: the result does not depend on chance or threads.

use crate::flow::{self, STEPS};
use crate::lattice::Lattice;
use std::cmp::Reverse;
use std::collections::BinaryHeap;
use weald_contract::table;

table! {
    /// Least-cost breaching of hollows.
    pub struct Breach {
        /// Deepest cut, m; hollows that need more stay.
        max_depth: f64 = 5.0, in 0.0..=100000.0;
        /// How far from a hollow's floor its ditch may lead, m.
        max_length: f64 = 200.0, in 0.0..=1000000.0;
    }
}

/// What is known of the ways from one floor to a cell.
#[derive(Clone, Copy)]
struct Reached {
    /// Number of the search that this belongs to, from 1.
    search: u32,
    /// Direction back to the floor.
    back: u8,
    /// Earth dug away on the cheapest way so far: depth times length, m times cells.
    cost: f32,
}

impl Breach {
    /// The ground with its hollows opened.
    pub(crate) fn run(&self, lattice: &Lattice, altitude: &[f32]) -> Vec<f32> {
        let Lattice { width, height, .. } = *lattice;
        let mut ground = altitude.to_vec();
        let nothing = Reached { search: 0, back: 0, cost: 0.0 };
        let mut reached = vec![nothing; ground.len()];
        for (search, floor) in (1..).zip(floors(width, height, altitude)) {
            if let Some(end) = self.search(lattice, &ground, floor, search, &mut reached) {
                dig(width, &mut ground, floor, end, &reached);
            }
        }
        ground
    }

    /// The nearest end, by earth to dig, of a ditch from `floor`; [`Reached`] leads back.
    fn search(
        &self,
        lattice: &Lattice,
        ground: &[f32],
        floor: usize,
        search: u32,
        reached: &mut [Reached],
    ) -> Option<usize> {
        let Lattice { width, height, cell, .. } = *lattice;
        let bed = ground[floor];
        let reach = self.max_length / cell;
        let (column, row) = (floor % width, floor / width);
        reached[floor] = Reached { search, back: flow::OUT, cost: 0.0 };
        let mut heap = BinaryHeap::from([Reverse((0u32, floor as u32))]);
        while let Some(Reverse((bits, from))) = heap.pop() {
            let (from, cost) = (from as usize, f32::from_bits(bits));
            if cost > reached[from].cost {
                continue;
            }
            let (x, y) = (from % width, from / width);
            let is_rim = x == 0 || y == 0 || x + 1 == width || y + 1 == height;
            if ground[from] < bed || is_rim {
                return Some(from);
            }
            for direction in 0..8u8 {
                // Not on the rim: all neighbours are there.
                let beside = flow::neighbor(from, direction, width);
                let depth = (ground[beside] - bed).max(0.0);
                let (dx, dy) = ((beside % width).abs_diff(column), (beside / width).abs_diff(row));
                if f64::from(depth) > self.max_depth || f64::hypot(dx as f64, dy as f64) > reach {
                    continue;
                }
                let (right, down) = STEPS[direction as usize];
                let is_diagonal = right != 0 && down != 0;
                let length = if is_diagonal { std::f32::consts::SQRT_2 } else { 1.0 };
                let cost = cost + depth * length;
                if reached[beside].search != search || cost < reached[beside].cost {
                    reached[beside] = Reached { search, back: direction ^ 4, cost };
                    // Costs are not negative: their bits sort as they do.
                    heap.push(Reverse((cost.to_bits(), beside as u32)));
                }
            }
        }
        None
    }
}

/// Cells inside hollows with no lower neighbour, lowest first.
fn floors(width: usize, height: usize, altitude: &[f32]) -> Vec<usize> {
    let level = crate::fill::levels(width, height, altitude);
    let is_floor = |&cell: &usize| {
        // Hollows never touch the rim.
        level[cell] > altitude[cell]
            && (0..8).all(|d| altitude[flow::neighbor(cell, d, width)] >= altitude[cell])
    };
    let mut floors: Vec<usize> = (0..altitude.len()).filter(is_floor).collect();
    floors.sort_by(|a, b| altitude[*a].total_cmp(&altitude[*b]).then(a.cmp(b)));
    floors
}

/// Digs the way from `end` back to `floor` down to the floor's altitude.
fn dig(width: usize, ground: &mut [f32], floor: usize, end: usize, reached: &[Reached]) {
    let bed = ground[floor];
    let mut cell = end;
    while cell != floor {
        ground[cell] = ground[cell].min(bed);
        cell = flow::neighbor(cell, reached[cell].back, width);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    const ALL: Breach = Breach { max_depth: 1e5, max_length: 1e6 };

    fn lattice(width: usize, height: usize) -> Lattice {
        Lattice { cell: 1.0, west: 0, south: 0, width, height }
    }

    /// A basin 4 m deep in ground of 10 m, with a wall of 1 m to the east, where it is lower.
    fn basin() -> Vec<f32> {
        let z = |i: usize| match (i % 9, i / 9) {
            (3..=5, 3..=5) => 6.0,
            (6, 4) => 7.0,
            (7.., 4) => 5.0,
            _ => 10.0,
        };
        (0..81).map(z).collect()
    }

    #[test]
    fn a_basin_is_opened_where_least_stands_in_the_way() {
        let ground = basin();
        let breached = ALL.run(&lattice(9, 9), &ground);
        let mut expected = ground.clone();
        expected[4 * 9 + 6] = 6.0;
        assert_eq!(breached, expected);
        let shallow = Breach { max_depth: 0.9, ..ALL };
        assert_eq!(shallow.run(&lattice(9, 9), &ground), ground, "too deep a cut is not made");
        let short = Breach { max_length: 1.0, ..ALL };
        assert_eq!(short.run(&lattice(9, 9), &ground), ground, "too long a ditch is not dug");
    }

    /// Least earth to dig from `floor`, by relaxing every cell until nothing changes.
    fn least_cost(width: usize, height: usize, ground: &[f32], floor: usize) -> f32 {
        let mut cost = vec![f32::INFINITY; ground.len()];
        cost[floor] = 0.0;
        let is_end = |i: usize| {
            let (x, y) = (i % width, i / width);
            ground[i] < ground[floor] || x == 0 || y == 0 || x + 1 == width || y + 1 == height
        };
        loop {
            let before = cost.clone();
            for from in 0..ground.len() {
                if cost[from].is_infinite() || is_end(from) {
                    continue;
                }
                for (direction, (right, down)) in (0u8..8).zip(STEPS) {
                    let beside = flow::neighbor(from, direction, width);
                    let length = if right * down == 0 { 1.0 } else { std::f32::consts::SQRT_2 };
                    let dug = cost[from] + (ground[beside] - ground[floor]).max(0.0) * length;
                    cost[beside] = cost[beside].min(dug);
                }
            }
            if before == cost {
                let ends = (0..ground.len()).filter(|&i| is_end(i));
                return ends.map(|i| cost[i]).fold(f32::INFINITY, f32::min);
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn breached_ground_has_no_hollows_and_is_nowhere_raised(
            width in 1usize..24,
            height in 1usize..24,
            steps in 1u64..400,
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            let breached = ALL.run(&lattice(width, height), &ground);
            prop_assert!(breached.iter().zip(&ground).all(|(after, before)| after <= before));
            prop_assert_eq!(&crate::fill::levels(width, height, &breached), &breached);
        }

        #[test]
        fn a_ditch_is_the_cheapest_of_all_ways(seed: u64, steps in 2u64..400) {
            let (width, height) = (12, 10);
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            for floor in floors(width, height, &ground) {
                let nothing = Reached { search: 0, back: 0, cost: 0.0 };
                let mut reached = vec![nothing; ground.len()];
                let end = ALL.search(&lattice(width, height), &ground, floor, 1, &mut reached);
                let cost = end.map(|end| reached[end].cost);
                prop_assert_eq!(cost, Some(least_cost(width, height, &ground, floor)));
            }
        }
    }
}
