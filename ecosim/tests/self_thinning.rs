//! Self-thinning: the fast core against all pairs, the -1 line, and what must not matter.

use proptest::prelude::*;
use weald_contract::{Seed, State};
use weald_ecosim::self_thinning::{Rules, Stem, Tally, Thinning};
use weald_ecosim::{Edge, Growth, Law, Order};

fn rules(size: f64, edge: Edge, order: Order) -> Rules {
    Rules {
        size: [size, size],
        edge,
        order,
        growth: Growth::default(),
        limit: f32::INFINITY,
        seed: Seed(3),
    }
}

/// Circles on a coarse lattice, so that some share places and radii exactly; a few are giants.
fn random(count: u32, seed: u64, size: f64) -> Vec<Stem> {
    let mut stream = Seed(seed).stream("stems", 0);
    (0..count)
        .map(|id| {
            let [x, y] = [0, 1].map(|_| (stream.unit() * 256.0).floor() / 256.0 * size);
            let giant = if stream.unit() < 0.05 { 30.0 } else { 1.0 };
            let radius = (stream.range(1.0, 5.0).round() / 64.0 * giant) as f32;
            Stem { id, x, y, radius }
        })
        .collect()
}

/// Who is dominated, over all pairs, by the words of the rule.
fn brute_force(stems: &[Stem], rules: &Rules) -> Vec<bool> {
    let beats = |a: &Stem, b: &Stem| a.radius > b.radius || a.radius == b.radius && a.id < b.id;
    let apart = |a: f64, b: f64, size: f64| match rules.edge {
        Edge::Torus => (a - b).abs().min(size - (a - b).abs()),
        Edge::Open => (a - b).abs(),
    };
    let meet = |a: &Stem, b: &Stem| {
        let (dx, dy) = (apart(a.x, b.x, rules.size[0]), apart(a.y, b.y, rules.size[1]));
        dx * dx + dy * dy < (f64::from(a.radius) + f64::from(b.radius)).powi(2)
    };
    let mut order: Vec<usize> = (0..stems.len()).collect();
    order.sort_by(|&a, &b| {
        stems[b].radius.total_cmp(&stems[a].radius).then(stems[a].id.cmp(&stems[b].id))
    });
    let mut dominated = vec![false; stems.len()];
    for index in order {
        let counts = |&other: &usize| rules.order == Order::Sync || !dominated[other];
        let over = (0..stems.len())
            .filter(counts)
            .any(|o| beats(&stems[o], &stems[index]) && meet(&stems[o], &stems[index]));
        dominated[index] = over;
    }
    dominated
}

fn one_step(stems: &[Stem], rules: Rules) -> Vec<u32> {
    let mut thinning = Thinning::new(rules, stems.iter().copied());
    thinning.look();
    thinning.advance();
    thinning.stems().iter().map(|(stem, _)| stem.id).collect()
}

fn stem(id: u32, x: f64, radius: f32) -> Stem {
    Stem { id, x, y: 8.0, radius }
}

#[test]
fn cases_checked_by_hand() {
    // The field's side is a power of two, so that these places are exact.
    let both = |stems: &[Stem], edge, sync: &[u32], greedy: &[u32]| {
        assert_eq!(one_step(stems, rules(16.0, edge, Order::Sync)), sync);
        assert_eq!(one_step(stems, rules(16.0, edge, Order::Greedy)), greedy);
    };
    let pair = |a, b, d| [stem(0, 4.0, a), stem(1, 4.0 + d, b)];
    both(&pair(0.6, 0.5, 1.0), Edge::Open, &[0], &[0]);
    both(&pair(0.5, 0.5, 1.0), Edge::Open, &[0, 1], &[0, 1]);
    both(&pair(0.5, 0.5, 0.5), Edge::Open, &[0], &[0]);
    both(&pair(0.1, 3.0, 0.5), Edge::Open, &[1], &[1]);
    let chain = [stem(0, 4.0, 1.0), stem(1, 5.5, 0.8), stem(2, 6.8, 0.6)];
    both(&chain, Edge::Open, &[0], &[0, 2]);
    let across = [stem(0, 0.25, 0.5), stem(1, 15.75, 0.25)];
    both(&across, Edge::Open, &[0, 1], &[0, 1]);
    both(&across, Edge::Torus, &[0], &[0]);
    both(&[], Edge::Torus, &[], &[]);
}

#[test]
fn old_plants_die_at_the_limit_and_the_dominated_name_their_killer() {
    let rules = Rules { limit: 1.0, ..rules(16.0, Edge::Open, Order::Sync) };
    let stems = [stem(7, 4.0, 1.0), stem(2, 5.5, 0.8), stem(3, 6.8, 0.6), stem(9, 12.0, 0.5)];
    let mut thinning = Thinning::new(rules, stems.into_iter());
    thinning.look();
    let states: Vec<State> = thinning.stems().into_iter().map(|(_, state)| state).collect();
    assert_eq!(states, [State::Dominated, State::Dominated, State::Old, State::Free]);
    let losses: Vec<_> = thinning.losses().iter().map(|l| (l.id, l.killer)).collect();
    assert_eq!(losses, [(2, Some(7)), (3, Some(2)), (7, None)]);
    thinning.advance();
    let tally = thinning.tally();
    assert_eq!((tally.alive, tally.dominated, tally.old), (1, 2, 1));
    assert_eq!(thinning.stems()[0].0.radius, 0.52);
}

fn stand(count: u32, seed: u64) -> Vec<Stem> {
    let size = f64::from(count).sqrt();
    let mut stream = Seed(seed).stream("stand", 0);
    (0..count)
        .map(|id| {
            let [x, y] = [0, 1].map(|_| stream.range(0.0, size));
            Stem { id, x, y, radius: stream.range(0.01, 0.05) as f32 }
        })
        .collect()
}

/// Least-squares slope of log mean area over log density where 2 to 10 % of the plants live.
fn slope(seed: u64, order: Order) -> f64 {
    const COUNT: u32 = 300_000;
    let rules = rules(f64::from(COUNT).sqrt(), Edge::Torus, order);
    let mut thinning = Thinning::new(rules, stand(COUNT, seed).into_iter());
    let mut points = Vec::new();
    while thinning.len() as u32 > COUNT / 50 {
        let Tally { alive, .. } = thinning.tally();
        if alive < u64::from(COUNT / 10) {
            points.push([(alive as f64).ln(), (thinning.tally().area() / alive as f64).ln()]);
        }
        thinning.look();
        thinning.advance();
    }
    let n = points.len() as f64;
    let [mx, my] = [0, 1].map(|axis| points.iter().map(|p| p[axis]).sum::<f64>() / n);
    let sum = |f: &dyn Fn(&[f64; 2]) -> f64| points.iter().map(f).sum::<f64>();
    sum(&|p| (p[0] - mx) * (p[1] - my)) / sum(&|p| (p[0] - mx).powi(2))
}

/// Once the first sizes are forgotten the pattern looks the same at any scale: density times mean
/// area, which is cover, stays level, so that mean area falls with slope -1 and mass with -3/2.
#[test]
fn mean_area_falls_over_density_with_slope_minus_one() {
    for order in [Order::Sync, Order::Greedy] {
        let slope = slope(11, order);
        assert!((slope + 1.0).abs() < 0.01, "{order:?}: {slope}");
    }
}

fn history(stems: Vec<Stem>, rules: Rules, steps: u32) -> (Vec<Tally>, Vec<(Stem, State)>) {
    let mut thinning = Thinning::new(rules, stems.into_iter());
    let step = |_| {
        thinning.look();
        thinning.advance();
        thinning.tally()
    };
    let tallies = (0..steps).map(step).collect();
    thinning.look();
    (tallies, thinning.stems())
}

#[test]
fn threads_order_of_input_and_resuming_change_nothing() {
    let growth = Growth { law: Law::Geometric, rate: 0.1, spread: 0.5, ..Growth::default() };
    for order in [Order::Sync, Order::Greedy] {
        let size = 20_000f64.sqrt();
        let rules = || Rules { growth: growth.clone(), ..rules(size, Edge::Torus, order) };
        let stems = stand(20_000, 5);
        let once = history(stems.clone(), rules(), 60);
        assert!(once.1.len() < 5_000);
        for threads in [1, 2, 5] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            assert_eq!(pool.install(|| history(stems.clone(), rules(), 60)), once);
        }
        let mut backwards = stems.clone();
        backwards.reverse();
        assert_eq!(history(backwards, rules(), 60), once);
        // A stand handed out and in again goes on the same way.
        let (mut tallies, half) = history(stems, rules(), 25);
        let (rest, end) = history(half.into_iter().map(|(stem, _)| stem).collect(), rules(), 35);
        tallies.extend(rest);
        assert_eq!((tallies, end), once);
    }
}

proptest! {
    #[test]
    fn grids_kill_whom_all_pairs_kill(count in 0u32..250, seed in any::<u64>()) {
        let stems = random(count, seed, 16.0);
        for edge in [Edge::Open, Edge::Torus] {
            let mut survivors = Vec::new();
            for order in [Order::Sync, Order::Greedy] {
                let dominated = brute_force(&stems, &rules(16.0, edge, order));
                let living: Vec<u32> =
                    stems.iter().filter(|s| !dominated[s.id as usize]).map(|s| s.id).collect();
                let found = one_step(&stems, rules(16.0, edge, order));
                prop_assert_eq!(&found, &living);
                survivors.push(found);
            }
            // In one step from the same state, sync kills at least as many.
            prop_assert!(survivors[0].iter().all(|id| survivors[1].contains(id)));
        }
    }

    #[test]
    fn all_steps_of_a_stand_agree_with_all_pairs(count in 1u32..200, seed in any::<u64>()) {
        for (edge, order) in [(Edge::Open, Order::Sync), (Edge::Torus, Order::Greedy)] {
            let growth = Growth { rate: 0.125, ..Growth::default() };
            let rules = Rules { growth, ..rules(16.0, edge, order) };
            let mut stems = random(count, seed, 16.0);
            let mut thinning = Thinning::new(rules.clone(), stems.iter().copied());
            for _ in 0..12 {
                let dominated = brute_force(&stems, &rules);
                let mut fates = dominated.iter();
                stems.retain(|_| fates.next() == Some(&false));
                stems.iter_mut().for_each(|stem| stem.radius += 0.125);
                thinning.look();
                thinning.advance();
                let found: Vec<Stem> = thinning.stems().into_iter().map(|(stem, _)| stem).collect();
                prop_assert_eq!(&found, &stems);
            }
        }
    }

    #[test]
    fn a_power_of_two_in_all_lengths_changes_nothing(count in 0u32..250, seed in any::<u64>()) {
        let stems = random(count, seed, 16.0);
        let large: Vec<Stem> = stems
            .iter()
            .map(|s| Stem { x: s.x * 8.0, y: s.y * 8.0, radius: s.radius * 8.0, ..*s })
            .collect();
        let [small, large] = [(stems, 16.0), (large, 128.0)]
            .map(|(stems, size)| one_step(&stems, rules(size, Edge::Torus, Order::Sync)));
        prop_assert_eq!(small, large);
    }
}

#[test]
fn inequality_is_that_of_the_plants_which_the_tally_tells_of() {
    let growth = Growth { law: Law::Geometric, rate: 0.1, spread: 0.5, ..Growth::default() };
    let rules = Rules { growth, ..rules(4000f64.sqrt(), Edge::Torus, Order::Greedy) };
    let mut thinning = Thinning::new(rules, stand(4000, 5).into_iter());
    for _ in 0..40 {
        thinning.look();
        let areas: Vec<f64> = thinning
            .stems()
            .iter()
            .filter(|(_, state)| *state == State::Free)
            .map(|(stem, _)| f64::from(stem.radius).powi(2))
            .collect();
        let found = thinning.inequality();
        thinning.advance();
        let n = areas.len() as f64;
        assert_eq!(thinning.tally().alive, areas.len() as u64);
        let pairs = areas.iter().flat_map(|a| areas.iter().map(move |b| (a - b).abs()));
        let gini = pairs.sum::<f64>() / (2.0 * n * areas.iter().sum::<f64>());
        assert!((f64::from(found.gini) - gini).abs() < 1e-5, "{found:?} {gini}");
    }
}
