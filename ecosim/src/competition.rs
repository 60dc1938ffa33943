//! Competition between plants whose circles intersect.
//!
//! "When two circles intersect, the competitive abilities are compared" [Deussen98]: the plant
//! of smaller ability is dominated. Circles that only touch do not compete; equal abilities are
//! decided for the lower index.

use crate::neighbors::{Site, SizeGrids};
use rayon::prelude::*;

use crate::config::Order;

/// A plant as its competitors see it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Circle {
    /// Place, m.
    pub x: f64,
    /// Place, m.
    pub y: f64,
    /// Radius, m, from 0.
    pub radius: f32,
    /// Competitive ability, from 0.
    pub ability: f32,
}

/// The plain on which circles compete.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Plain {
    /// Nothing lies beyond the rim.
    Open,
    /// Opposite rims meet: width and height, m. All places lie between 0 and these.
    Torus([f64; 2]),
}

/// Number of sites that one task looks at.
const RUN: usize = 2048;

/// Returns, for each circle, the index of the strongest circle that dominates it.
///
/// With [`Order::Sync`] every circle counts. With [`Order::Greedy`] only those count that live
/// on: `survives` says which circles live on although dominated, and strongest come first.
pub fn dominators(
    circles: &[Circle],
    plain: Plain,
    order: Order,
    survives: impl Fn(usize) -> bool,
) -> Vec<Option<u32>> {
    let sites: Vec<Site> = circles.par_iter().enumerate().map(|(i, c)| site(i, c)).collect();
    let grids = SizeGrids::new(&sites);
    match order {
        Order::Sync => all_at_once(&grids, plain),
        Order::Greedy => strongest_first(&sites, &grids, plain, survives),
    }
}

/// The upper half of a key orders by ability (non-negative floats sort as their bits do), the
/// lower half prefers low indices.
fn site(index: usize, circle: &Circle) -> Site {
    let ability = (circle.ability + 0.0).to_bits();
    let key = (u64::from(ability) << 32) | u64::from(!(index as u32));
    Site { x: circle.x, y: circle.y, key, radius: circle.radius }
}

/// Returns the index of the circle with this key.
fn index_of(key: u64) -> u32 {
    !(key as u32)
}

fn all_at_once(grids: &SizeGrids, plain: Plain) -> Vec<Option<u32>> {
    let found: Vec<u64> = grids
        .sites
        .par_iter()
        .with_min_len(RUN)
        .map(|site| strongest_over(site, grids, plain, |_| true))
        .collect();
    let mut dominators = vec![None; found.len()];
    for (site, key) in grids.sites.iter().zip(found) {
        if key > 0 {
            dominators[index_of(site.key) as usize] = Some(index_of(key));
        }
    }
    dominators
}

fn strongest_first(
    sites: &[Site],
    grids: &SizeGrids,
    plain: Plain,
    survives: impl Fn(usize) -> bool,
) -> Vec<Option<u32>> {
    let mut order: Vec<u32> = (0..sites.len() as u32).collect();
    order.par_sort_unstable_by_key(|&index| std::cmp::Reverse(sites[index as usize].key));
    let mut is_dead = vec![false; sites.len()];
    let mut dominators = vec![None; sites.len()];
    for index in order {
        let lives = |key: u64| !is_dead[index_of(key) as usize];
        let key = strongest_over(&sites[index as usize], grids, plain, lives);
        if key > 0 {
            dominators[index as usize] = Some(index_of(key));
            is_dead[index as usize] = !survives(index as usize);
        }
    }
    dominators
}

/// Returns the greatest key that beats and meets a site and counts, or 0.
fn strongest_over(
    site: &Site,
    grids: &SizeGrids,
    plain: Plain,
    counts: impl Fn(u64) -> bool,
) -> u64 {
    let mut strongest = site.key;
    let mut look = |shift: [f64; 2]| {
        let (x, y) = (site.x + shift[0], site.y + shift[1]);
        grids.visit_stronger(site, shift, |run| {
            for other in run {
                // Either test is a toss-up alone: both are made, and one branch is taken.
                let is_over = (other.key > strongest) & meets(x, y, site.radius, other);
                if is_over && counts(other.key) {
                    strongest = other.key;
                }
            }
        });
    };
    match plain {
        Plain::Open => look([0.0, 0.0]),
        Plain::Torus([width, height]) => {
            for dy in [-height, 0.0, height] {
                for dx in [-width, 0.0, width] {
                    look([dx, dy]);
                }
            }
        }
    }
    if strongest > site.key { strongest } else { 0 }
}

/// Whether two circles share more than a point: d² < (r₁ + r₂)².
fn meets(x: f64, y: f64, radius: f32, other: &Site) -> bool {
    let (dx, dy) = (other.x - x, other.y - y);
    let reach = f64::from(radius) + f64::from(other.radius);
    dx * dx + dy * dy < reach * reach
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    use weald_contract::Seed;

    fn circle(x: f64, y: f64, radius: f32) -> Circle {
        Circle { x, y, radius, ability: radius }
    }

    /// Indices of those that live when nobody survives domination.
    fn living(circles: &[Circle], plain: Plain, order: Order) -> Vec<usize> {
        let dominators = dominators(circles, plain, order, |_| false);
        (0..circles.len()).filter(|&i| dominators[i].is_none()).collect()
    }

    #[test]
    fn of_two_that_meet_the_smaller_dies_and_of_two_that_touch_none() {
        for order in [Order::Sync, Order::Greedy] {
            let pair = |a, b| [circle(0.0, 0.0, a), circle(1.0, 0.0, b)];
            assert_eq!(living(&pair(0.6, 0.5), Plain::Open, order), [0]);
            assert_eq!(living(&pair(0.5, 0.5), Plain::Open, order), [0, 1]);
        }
    }

    #[test]
    fn in_a_chain_the_order_of_deaths_decides_over_the_last() {
        let chain = [circle(0.0, 0.0, 1.0), circle(1.5, 0.0, 0.8), circle(2.8, 0.0, 0.6)];
        assert_eq!(living(&chain, Plain::Open, Order::Sync), [0]);
        assert_eq!(living(&chain, Plain::Open, Order::Greedy), [0, 2]);
    }

    #[test]
    fn a_circle_within_a_larger_one_dies() {
        let nested = [circle(0.1, 0.0, 0.2), circle(0.0, 0.0, 3.0)];
        assert_eq!(living(&nested, Plain::Open, Order::Sync), [1]);
    }

    #[test]
    fn of_equals_the_first_lives() {
        let equals = [circle(0.0, 0.0, 1.0), circle(0.5, 0.0, 1.0)];
        assert_eq!(living(&equals, Plain::Open, Order::Sync), [0]);
        assert_eq!(dominators(&equals, Plain::Open, Order::Sync, |_| false), [None, Some(0)]);
    }

    #[test]
    fn across_the_rim_only_a_torus_lets_circles_meet() {
        let pair = [circle(0.1, 5.0, 0.3), circle(9.9, 5.0, 0.2)];
        assert_eq!(living(&pair, Plain::Torus([10.0, 10.0]), Order::Sync), [0]);
        assert_eq!(living(&pair, Plain::Open, Order::Sync), [0, 1]);
    }

    #[test]
    fn ability_and_not_size_decides() {
        // v = 0.9, r = 1, r max = 10 against v = 0.2, r = 1, r max = 1.
        let large = Circle { x: 0.0, y: 0.0, radius: 1.0, ability: 0.9 * 1.0 / 10.0 };
        let small = Circle { x: 1.0, y: 0.0, radius: 1.0, ability: 0.2 };
        assert_eq!(living(&[large, small], Plain::Open, Order::Sync), [1]);
    }

    #[test]
    fn no_circles_and_one_circle_have_no_dominator() {
        assert!(dominators(&[], Plain::Open, Order::Sync, |_| false).is_empty());
        let one = [circle(3.0, 4.0, 0.0)];
        assert_eq!(dominators(&one, Plain::Open, Order::Greedy, |_| false), [None]);
    }

    /// Circles of mixed sizes and abilities; some share their place exactly.
    fn random(count: usize, seed: u64) -> Vec<Circle> {
        let mut stream = Seed(seed).stream("circles", 0);
        (0..count)
            .map(|_| {
                let radius = libm::exp(stream.range(-6.0, 1.0)) as f32;
                let [x, y] = [0, 1].map(|_| (stream.unit() * 160.0).round() / 16.0);
                Circle { x, y, radius, ability: stream.unit() as f32 * radius }
            })
            .collect()
    }

    /// The rule of the paper, over all pairs.
    fn brute_force(circles: &[Circle], plain: Plain) -> Vec<Option<u32>> {
        let beats = |i: usize, j: usize| {
            let (a, b) = (circles[i].ability, circles[j].ability);
            b > a || (b == a && j < i)
        };
        let apart = |from: f64, to: f64, period: Option<f64>| {
            let d = (to - from).abs();
            period.map_or(d, |period| d.min(period - d))
        };
        let intersects = |a: &Circle, b: &Circle| {
            let [width, height] = match plain {
                Plain::Open => [None, None],
                Plain::Torus(size) => size.map(Some),
            };
            let (dx, dy) = (apart(a.x, b.x, width), apart(a.y, b.y, height));
            let reach = f64::from(a.radius) + f64::from(b.radius);
            dx * dx + dy * dy < reach * reach
        };
        (0..circles.len())
            .map(|i| {
                (0..circles.len())
                    .filter(|&j| j != i && beats(i, j) && intersects(&circles[i], &circles[j]))
                    .reduce(|best, j| if beats(best, j) { j } else { best })
                    .map(|j| j as u32)
            })
            .collect()
    }

    proptest! {
        #[test]
        fn grids_find_what_all_pairs_find(count in 0usize..120, seed in any::<u64>()) {
            let circles = random(count, seed);
            for plain in [Plain::Open, Plain::Torus([10.0, 10.0])] {
                let found = dominators(&circles, plain, Order::Sync, |_| false);
                prop_assert_eq!(found, brute_force(&circles, plain));
            }
        }

        #[test]
        fn after_deaths_no_two_circles_meet(count in 0usize..200, seed in any::<u64>()) {
            let circles = random(count, seed);
            let sync = living(&circles, Plain::Open, Order::Sync);
            let greedy = living(&circles, Plain::Open, Order::Greedy);
            for alive in [&sync, &greedy] {
                let left: Vec<Circle> = alive.iter().map(|&i| circles[i]).collect();
                prop_assert!(brute_force(&left, Plain::Open).iter().all(Option::is_none));
            }
            // In one step from the same state, sync kills at least as many.
            prop_assert!(sync.iter().all(|i| greedy.contains(i)));
        }

        #[test]
        fn scaling_by_a_power_of_two_changes_nothing(count in 0usize..120, seed in any::<u64>()) {
            let circles = random(count, seed);
            let scaled: Vec<Circle> = circles
                .iter()
                .map(|c| Circle { x: c.x * 8.0, y: c.y * 8.0, radius: c.radius * 8.0, ..*c })
                .collect();
            let [plain, large] = [&circles, &scaled]
                .map(|circles| dominators(circles, Plain::Open, Order::Sync, |_| false));
            prop_assert_eq!(plain, large);
        }
    }
}
