//! Statistics of made patterns: randomness, moves, threads, and all pairs by brute force.

use proptest::prelude::*;
use weald_analyze::{Correction, Error, Pattern, Statistic, Window, ripley_k, statistics};
use weald_contract::Seed;

const FIELD: Window = Window { x: [0.0, 30.0], y: [0.0, 20.0] };
const ALL: [Statistic; 6] =
    [Statistic::K, Statistic::L, Statistic::G, Statistic::F, Statistic::J, Statistic::Pcf];

fn random(n: u64, window: Window) -> Pattern {
    let mut stream = Seed(4).stream("points", n);
    let point =
        |_| [stream.range(window.x[0], window.x[1]), stream.range(window.y[0], window.y[1])];
    Pattern::new((0..n).map(point).collect(), window).unwrap()
}

#[test]
fn points_spread_at_random_have_the_statistics_of_randomness() {
    let pattern = random(20_000, FIELD);
    let radii = [0.2, 0.5, 1.0];
    for table in statistics(&pattern, &ALL[..2], &radii).unwrap() {
        let theo = table.column("theo").unwrap();
        for correction in ["border", "trans", "iso"] {
            for (k, theo) in table.column(correction).unwrap().iter().zip(theo) {
                // About 20,000 points with 4 to 100 neighbours: 2 % is five standard errors.
                assert!((k / theo - 1.0).abs() < 0.02, "{} {correction}", table.name);
            }
        }
    }
    let table = statistics(&pattern, &[Statistic::G], &[0.0, 0.05, 0.1, 0.15]).unwrap().remove(0);
    for form in ["rs", "km", "han"] {
        for (g, theo) in table.column(form).unwrap().iter().zip(table.column("theo").unwrap()) {
            // Hanisch's form is scaled to end at 1, which G has not reached at these radii.
            let scale = if form == "han" { table.column("theo").unwrap()[3] } else { 1.0 };
            assert!((g * scale - theo).abs() < 0.03, "{form}");
        }
    }
}

#[test]
fn empty_space_of_random_points_is_that_of_randomness_and_j_is_one() {
    let pattern = random(20_000, FIELD);
    let radii: Vec<f64> = (0..=30).map(|step| f64::from(step) * 0.005).collect();
    let tables = statistics(&pattern, &[Statistic::F, Statistic::J], &radii).unwrap();
    let theo = tables[0].column("theo").unwrap();
    for row in [10, 20, 30] {
        for form in ["raw", "rs", "km"] {
            let f = tables[0].column(form).unwrap()[row];
            // 43,776 places, of which about one in two is independent of another.
            assert!((f - theo[row]).abs() < 0.012, "{form}: {f} for {}", theo[row]);
        }
        // 1 - F is a third at the last radius: both errors add to some percent.
        let j = tables[1].column("km").unwrap()[row];
        assert!((j - 1.0).abs() < 0.05, "J {j}");
    }
}

#[test]
fn grid_and_continuous_forms_of_g_meet_on_fine_radii() {
    let pattern = random(400, FIELD);
    let radii: Vec<f64> = (0..=40_000).map(|step| f64::from(step) * 5e-5).collect();
    let binned = statistics(&pattern, &[Statistic::G], &radii).unwrap().remove(0);
    let continuous = weald_analyze::nearest::continuous_g_table(&pattern, &radii).unwrap();
    for form in ["rs", "km"] {
        let pairs = binned.column(form).unwrap().iter().zip(continuous.column(form).unwrap());
        for (row, (a, b)) in pairs.enumerate() {
            assert!((a - b).abs() < 0.006, "{form} {row}: {a} {b}");
        }
    }
}

#[test]
fn constant_intensity_gives_k_up_to_the_pair_of_a_point_with_itself() {
    let pattern = random(300, FIELD);
    let radii = [0.0, 1.0, 3.0];
    let inhomogeneous =
        weald_analyze::ripley::inhomogeneous_k_table(&pattern, &[0.5; 300], &radii).unwrap();
    let plain = statistics(&pattern, &[Statistic::K], &radii).unwrap().remove(0);
    for name in ["un", "trans", "iso"] {
        for (a, b) in inhomogeneous.column(name).unwrap().iter().zip(plain.column(name).unwrap()) {
            assert!((a - b * 299.0 / 300.0).abs() <= 1e-12 * b, "{name}: {a} {b}");
        }
    }
    let bad = weald_analyze::ripley::inhomogeneous_k_table(&pattern, &[0.0; 300], &radii);
    assert!(matches!(bad, Err(Error::BadValue { row: 0, .. })));
}

#[test]
fn one_thread_and_two_give_the_same_bits() {
    let pattern = random(5000, FIELD);
    let radii: Vec<f64> = (0..50).map(|i| f64::from(i) * 0.1).collect();
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        // NaN is not equal to itself; the texts are.
        format!("{:?}", pool.install(|| statistics(&pattern, &ALL, &radii)).unwrap())
    };
    assert_eq!(on(1), on(2));
}

#[test]
fn lengths_in_another_unit_scale_k_by_area_and_leave_g_alone() {
    let pattern = random(300, FIELD);
    let radii = [0.0, 0.5, 1.0, 2.0];
    // A power of two scales without rounding.
    let scale = |value: f64| value * 4.0;
    let window = Window { x: FIELD.x.map(scale), y: FIELD.y.map(scale) };
    let points = pattern.points().iter().map(|point| point.map(scale)).collect();
    let scaled = Pattern::new(points, window).unwrap();
    let before = statistics(&pattern, &ALL, &radii).unwrap();
    let after = statistics(&scaled, &ALL, &radii.map(scale)).unwrap();
    for (a, b) in before.iter().zip(&after) {
        let factor = match a.name {
            "K" => 16.0,
            "L" => 4.0,
            _ => 1.0,
        };
        for ((name, a_values), (_, b_values)) in a.columns.iter().zip(&b.columns).skip(1) {
            for (a, b) in a_values.iter().zip(b_values) {
                let is_same = a == b || a.is_nan() && b.is_nan();
                assert!((a * factor - b).abs() <= 1e-12 * b.abs() || is_same, "{name}: {a} {b}");
            }
        }
    }
}

#[test]
fn radii_that_do_not_rise_are_refused_with_their_row() {
    let pattern = random(10, FIELD);
    for statistic in ALL {
        let error = statistics(&pattern, &[statistic], &[0.0, 2.0, 1.0]).unwrap_err();
        assert_eq!(error, Error::BadRadius { row: 2, value: 1.0 });
    }
}

/// As many points and radii as the tropical plot of Barro Colorado Island in spatstat's `bei`.
#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn pair_correlation_of_3604_points_takes_less_than_a_tenth_of_a_second() {
    let window = Window { x: [0.0, 1000.0], y: [0.0, 500.0] };
    let pattern = random(3604, window);
    let radii: Vec<f64> = (0..=512).map(|i| f64::from(i) * 125.0 / 512.0).collect();
    let start = std::time::Instant::now();
    let table = statistics(&pattern, &[Statistic::Pcf], &radii).unwrap().remove(0);
    eprintln!("{:.3} s", start.elapsed().as_secs_f64());
    assert!((table.column("trans").unwrap()[400] - 1.0).abs() < 0.05);
}

/// A million points with about 30 neighbours each; run alone to see the time.
#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn k_of_a_million_points_takes_seconds() {
    let window = Window { x: [0.0, 1000.0], y: [0.0, 1000.0] };
    let pattern = random(1_000_000, window);
    let radii: Vec<f64> = (0..=256).map(|i| f64::from(i) * 3.09 / 256.0).collect();
    let start = std::time::Instant::now();
    let k = ripley_k(&pattern, &radii, Correction::Translation).unwrap();
    let theo = std::f64::consts::PI * 3.09f64.powi(2);
    eprintln!("{:.2} s", start.elapsed().as_secs_f64());
    assert!((k[256] / theo - 1.0).abs() < 0.002);
}

proptest! {
    #![proptest_config(ProptestConfig { failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn cross_statistics_are_sums_over_all_pairs_of_two_types(
        points in prop::collection::vec((0.0..=30.0f64, 0.0..=20.0f64), 4..60),
        r in 0.1..15.0f64,
    ) {
        let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
        let (from, to) = points.split_at(points.len() / 2);
        let pattern = |points: &[[f64; 2]]| Pattern::new(points.to_vec(), FIELD).unwrap();
        let (mut weight, mut g, mut near, mut inside) = (0.0, 0.0, 0.0, 0.0);
        let half_width = 0.15 / (to.len() as f64 / 600.0).sqrt();
        for a in from {
            let is_inside = FIELD.border_distance(*a) >= r;
            inside += f64::from(is_inside);
            for b in to {
                let [dx, dy] = [(a[0] - b[0]).abs(), (a[1] - b[1]).abs()];
                let distance = (dx * dx + dy * dy).sqrt();
                let pair = (600.0 / ((30.0 - dx) * (20.0 - dy))).min(100.0);
                weight += if distance <= r { pair } else { 0.0 };
                near += f64::from(is_inside && distance <= r);
                let t = (r - distance) / half_width;
                g += (pair * 0.75 / half_width * (1.0 - t * t)).max(0.0);
            }
        }
        let pairs = (from.len() * to.len()) as f64 / 600.0;
        let k = weald_analyze::ripley::cross_k_table(&pattern(from), &pattern(to), &[r]).unwrap();
        let border = k.column("border").unwrap()[0];
        let expected = near / inside / (to.len() as f64 / 600.0);
        let is_same = border.is_nan() && expected.is_nan();
        prop_assert!(is_same || (border - expected).abs() < 1e-9 * (1.0 + expected));
        let k = k.column("trans").unwrap()[0];
        prop_assert!((k * pairs - weight).abs() < 1e-9 * (1.0 + weight));
        let pcf = weald_analyze::ripley::cross_pcf_table(&pattern(from), &pattern(to), &[r]);
        let expected = g / (std::f64::consts::TAU * r * pairs);
        let found = pcf.unwrap().column("trans").unwrap()[0];
        prop_assert!((found - expected).abs() < 1e-9 * (1.0 + expected), "{found} {expected}");
    }

    #[test]
    fn uncorrected_and_translated_k_are_sums_over_all_pairs(
        points in prop::collection::vec((0.0..=30.0f64, 0.0..=20.0f64), 2..60),
        r in 0.1..25.0f64,
    ) {
        let points: Vec<[f64; 2]> = points.into_iter().map(|(x, y)| [x, y]).collect();
        let pattern = Pattern::new(points.clone(), FIELD).unwrap();
        let (mut count, mut weight) = (0.0, 0.0f64);
        for (i, a) in points.iter().enumerate() {
            for (j, b) in points.iter().enumerate() {
                let [dx, dy] = [(a[0] - b[0]).abs(), (a[1] - b[1]).abs()];
                if i != j && (dx * dx + dy * dy).sqrt() <= r {
                    count += 1.0;
                    weight += (600.0 / ((30.0 - dx) * (20.0 - dy))).min(100.0);
                }
            }
        }
        let n = points.len() as f64;
        let at = |correction| ripley_k(&pattern, &[r], correction).unwrap()[0] * n * (n - 1.0) / 600.0;
        prop_assert!((at(Correction::None) - count).abs() < 1e-9 * (1.0 + count));
        prop_assert!((at(Correction::Translation) - weight).abs() < 1e-9 * (1.0 + weight));
    }
}
