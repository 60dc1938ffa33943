//! Estimators held against spatstat on stem maps of real stands.
//!
//! The data are GPL and stay outside this repository; without them the tests say so and pass.
//! `WEALD_SHARED` names the folder that holds `data/stems`.

#![allow(clippy::excessive_precision, reason = "values stand as R prints them, with 17 digits")]

use std::collections::BTreeMap;
use std::path::PathBuf;
use weald_analyze::nearest::cross_g_table;
use weald_analyze::ripley::{cross_k_table, inhomogeneous_k_table};
use weald_analyze::{
    Divisor, Pattern, Quadrats, Sizes, StandState, Statistic, Window, clark_evans,
    mark_correlation, pair_correlation, plateau, quantile, statistics, thinning_line,
};

/// Stands and their windows.
const STANDS: [(&str, Window); 8] = [
    ("longleaf", Window { x: [0.0, 200.0], y: [0.0, 200.0] }),
    ("finpines", Window { x: [-5.0, 5.0], y: [-8.0, 2.0] }),
    ("spruces", Window { x: [0.0, 56.0], y: [0.0, 38.0] }),
    ("swedishpines", Window { x: [0.0, 96.0], y: [0.0, 100.0] }),
    ("hyytiala", Window { x: [0.0, 20.0], y: [0.0, 20.0] }),
    ("nztrees", Window { x: [0.0, 153.0], y: [0.0, 95.0] }),
    ("japanesepines", Window { x: [0.0, 1.0], y: [0.0, 1.0] }),
    ("redwood", Window { x: [0.0, 1.0], y: [-1.0, 0.0] }),
];

type Columns = BTreeMap<String, Vec<f64>>;

/// The folder of stem maps, unless it is absent.
fn stems() -> Option<PathBuf> {
    let shared = std::env::var_os("WEALD_SHARED").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared"),
        PathBuf::from,
    );
    let stems = shared.join("data/stems");
    if !stems.is_dir() {
        eprintln!("SKIPPED: no data/stems; set WEALD_SHARED to the folder above data/");
        return None;
    }
    Some(stems)
}

/// Numbers by column; what is no number becomes NaN.
fn read(path: PathBuf) -> Columns {
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{path:?}: {e}"));
    let fields = |line: &str| {
        line.split(',').map(|field| field.trim_matches(['"', ' ']).to_owned()).collect::<Vec<_>>()
    };
    let mut lines = text.lines().map(fields);
    let header = lines.next().unwrap();
    let mut columns: Columns = header.iter().map(|name| (name.clone(), vec![])).collect();
    for row in lines {
        for (name, field) in header.iter().zip(row) {
            let number = match field.as_str() {
                "Inf" => f64::INFINITY,
                field => field.parse().unwrap_or(f64::NAN),
            };
            columns.get_mut(name).unwrap().push(number);
        }
    }
    columns
}

fn pattern(stems: &std::path::Path, name: &str, window: Window) -> Pattern {
    let table = read(stems.join(format!("{name}.csv")));
    let points = table["x"].iter().zip(&table["y"]).map(|(x, y)| [*x, *y]).collect();
    Pattern::new(points, window).unwrap()
}

/// Asserts agreement to 1e-9, relative to the larger of the two.
fn agree(what: &str, ours: &[f64], theirs: &[f64]) {
    assert_eq!(ours.len(), theirs.len(), "{what}");
    for (row, (a, b)) in ours.iter().zip(theirs).enumerate() {
        let same = a == b || a.is_nan() && b.is_nan();
        let near = (a - b).abs() <= 1e-9 * a.abs().max(b.abs());
        assert!(same || near, "{what}, row {row}: {a} instead of {b}");
    }
}

#[test]
fn k_of_real_stands_is_that_of_spatstat_for_all_corrections() {
    let Some(stems) = stems() else { return };
    for (name, window) in STANDS {
        let theirs = read(stems.join(format!("stats/{name}.K.csv")));
        let pattern = pattern(&stems, name, window);
        let table = statistics(&pattern, &[Statistic::K], &theirs["r"]).unwrap().remove(0);
        for (column, ours) in &table.columns {
            agree(&format!("K of {name}, {column}"), ours, &theirs[*column]);
        }
    }
}

#[test]
fn g_of_real_stands_is_that_of_spatstat_in_all_forms() {
    let Some(stems) = stems() else { return };
    for (name, window) in STANDS {
        let theirs = read(stems.join(format!("stats/{name}.G.csv")));
        let pattern = pattern(&stems, name, window);
        let table = statistics(&pattern, &[Statistic::G], &theirs["r"]).unwrap().remove(0);
        for (column, ours) in &table.columns {
            agree(&format!("G of {name}, {column}"), ours, &theirs[*column]);
        }
    }
}

#[test]
fn the_pair_correlation_of_real_stands_is_the_exact_sum() {
    let Some(stems) = stems() else { return };
    for (name, window) in STANDS {
        let theirs = read(stems.join(format!("stats/{name}.pcf_exact.csv")));
        let pattern = pattern(&stems, name, window);
        for (divisor, column) in
            [(Divisor::Radius, "trans_exact_divr"), (Divisor::Distance, "trans_exact_divd")]
        {
            let ours = pair_correlation(&pattern, &theirs["r"], divisor).unwrap();
            agree(&format!("g of {name}, {column}"), &ours, &theirs[column]);
        }
    }
}

#[test]
fn clark_and_evans_find_longleaf_pines_clustered_as_spatstat_does() {
    let Some(stems) = stems() else { return };
    let index = clark_evans(&pattern(&stems, STANDS[0].0, STANDS[0].1)).unwrap();
    agree("Clark-Evans", &[index.naive, index.donnelly], &[0.832054731188646, 0.817679949858518]);
}

#[test]
fn fits_of_a_thinning_series_are_those_of_r() {
    let Some(stems) = stems() else { return };
    let expected = oracles(&stems);
    let series = read(stems.join("stats/selfthin_series_sync_seed11.csv"));
    let states: Vec<StandState> = series["density"]
        .iter()
        .zip(&series["mean_area"])
        .zip(&series["n"])
        .filter(|(_, n)| **n >= 100.0)
        .map(|((density, mean_size), _)| StandState { density: *density, mean_size: *mean_size })
        .collect();
    let line = thinning_line(&states, [0.0, 0.25]).unwrap();
    assert_eq!(line.states as f64, expected["n"]);
    let (ols, sma) = (line.least_squares, line.major_axis);
    let found = [
        ("ols_slope", ols.slope),
        ("ols_ci_lo", ols.slope_interval[0]),
        ("ols_ci_hi", ols.slope_interval[1]),
        ("sma_slope", sma.slope),
        ("sma_ci_lo", sma.slope_interval[0]),
        ("sma_ci_hi", sma.slope_interval[1]),
        ("r2", line.r_squared),
        ("ols_intercept", ols.intercept),
        ("sma_intercept", sma.intercept),
        ("rq50_slope", line.median.slope),
        ("rq95_slope", line.upper.slope),
        ("rq95_intercept", line.upper.intercept),
    ];
    for (name, value) in found {
        agree(name, &[value], &[expected[name]]);
    }
}

#[test]
fn a_thinning_series_levels_off_at_a_third_of_the_ground() {
    let Some(stems) = stems() else { return };
    let series = read(stems.join("stats/selfthin_series_sync_seed11.csv"));
    let found = plateau(&series["density"], &series["cover"]).unwrap();
    // Plateau cover of this model over three seeds: 0.32.
    assert!((found.cover - 0.32).abs() < 0.01, "{found:?}");
    assert!((0.1..0.25).contains(&found.densities[1]), "{found:?}");
    assert!(found.densities[0] < 0.012, "{found:?}");
    let early = found.early_start(&series["density"], &series["cover"], 0.9).unwrap();
    assert!(early.cover < 0.25, "{early}");
}

/// Rows of spatstat's tables whose values stand below.
const ROWS: [usize; 5] = [32, 64, 128, 192, 256];

fn of_type(stems: &std::path::Path, wanted: &str) -> Pattern {
    let text = std::fs::read_to_string(stems.join("hyytiala.csv")).unwrap();
    let mut points = Vec::new();
    for line in text.lines().skip(1) {
        let fields: Vec<&str> = line.split(',').map(|f| f.trim_matches(['"', ' '])).collect();
        if fields[3] == wanted {
            points.push([1, 2].map(|column| fields[column].trim().parse().unwrap()));
        }
    }
    Pattern::new(points, STANDS[4].1).unwrap()
}

fn agree_in_rows(what: &str, ours: &[f64], theirs: [f64; 5]) {
    agree(what, &ROWS.map(|row| ours[row]), &theirs);
}

/// `Kcross(X, "pine", "birch")` and the reverse, spatstat.explore 3.0-6. Its border form depends on
/// the radii; ours is held by brute force.
#[test]
fn cross_k_of_pines_and_birches_is_that_of_spatstat() {
    let Some(stems) = stems() else { return };
    let radii = &read(stems.join("stats/hyytiala.K.csv"))["r"];
    let (pines, birches) = (of_type(&stems, "pine"), of_type(&stems, "birch"));
    let table = cross_k_table(&pines, &birches, radii).unwrap();
    let at = |name| table.column(name).unwrap();
    let un = [
        1.6544117647058822,
        4.7794117647058822,
        21.5073529411764675,
        47.0588235294117609,
        76.2867647058823479,
    ];
    let trans = [
        1.6979312189309033,
        5.0284684014114651,
        24.1094035324659899,
        55.8422029687553660,
        95.8040336220749111,
    ];
    let iso = [
        1.6544117647058822,
        4.7794117647058822,
        21.9795794217678235,
        49.9717746403864567,
        86.5364442821816624,
    ];
    agree_in_rows("un", at("un"), un);
    agree_in_rows("trans", at("trans"), trans);
    agree_in_rows("iso", at("iso"), iso);

    let back = cross_k_table(&birches, &pines, radii).unwrap();
    let iso = [
        1.6544117647058822,
        4.7794117647058822,
        21.6418133210583541,
        48.3263817975788967,
        80.3894222308080799,
    ];
    agree_in_rows("back, iso", back.column("iso").unwrap(), iso);
}

/// `Gcross(X, "pine", "birch")`, spatstat.explore 3.0-6.
#[test]
fn cross_g_of_pines_and_birches_is_that_of_spatstat() {
    let Some(stems) = stems() else { return };
    let radii = &read(stems.join("stats/hyytiala.K.csv"))["r"];
    let table = cross_g_table(&of_type(&stems, "pine"), &of_type(&stems, "birch"), radii).unwrap();
    let expected = [
        (
            "theo",
            [
                0.050815486453217873,
                0.188286861778347414,
                0.565879492841483644,
                0.847024042981810776,
                0.964482596693492011,
            ],
        ),
        ("raw", [0.0625, 0.1640625, 0.4765625, 0.640625, 0.734375]),
        (
            "rs",
            [
                0.064516129032258063,
                0.192660550458715607,
                0.609756097560975596,
                0.779661016949152574,
                0.875000000000000000,
            ],
        ),
        (
            "km",
            [
                0.06308593749999980,
                0.17427392422408650,
                0.54994526782484932,
                0.70551940174795635,
                0.80316835012667220,
            ],
        ),
        (
            "han",
            [
                0.083898907344724133,
                0.236979680272914078,
                0.725474488141480411,
                0.902161754911949831,
                1.000000000000000000,
            ],
        ),
    ];
    for (name, values) in expected {
        agree_in_rows(name, table.column(name).unwrap(), values);
    }
}

/// `Kinhom(X, lambda = 0.01 (0.5 + x / 200))`, spatstat.explore 3.0-6.
#[test]
fn inhomogeneous_k_of_longleaf_pines_is_that_of_spatstat() {
    let Some(stems) = stems() else { return };
    let radii = &read(stems.join("stats/longleaf.K.csv"))["r"];
    let pattern = pattern(&stems, "longleaf", STANDS[0].1);
    let intensity: Vec<f64> =
        pattern.points().iter().map(|[x, _]| 0.01 * (0.5 + x / 200.0)).collect();
    let table = inhomogeneous_k_table(&pattern, &intensity, radii).unwrap();
    let expected = [
        (
            "border",
            [
                250.51094773381294,
                725.80988832080516,
                2462.26968915851330,
                5204.39042602287100,
                9081.71636086249782,
            ],
        ),
        (
            "trans",
            [
                404.46232025681104,
                1149.43775573602716,
                3942.23850306699296,
                8594.16402369100433,
                15084.40895222984909,
            ],
        ),
        (
            "iso",
            [
                407.04367389971668,
                1147.07330642938427,
                3904.11105826466428,
                8496.00009657068586,
                14867.75573277540389,
            ],
        ),
    ];
    for (name, values) in expected {
        agree_in_rows(name, table.column(name).unwrap(), values);
    }
}

#[test]
fn the_mark_correlation_of_longleaf_pines_is_that_of_spatstat_but_for_its_binning() {
    let Some(stems) = stems() else { return };
    let theirs = read(stems.join("stats/longleaf.markcorr.csv"));
    let longleaf = pattern(&stems, "longleaf", STANDS[0].1);
    let marks = &read(stems.join("longleaf.csv"))["mark"];
    // The file holds the lower half of the radii that decided spatstat's bandwidth.
    let radii: Vec<f64> = (0..=512).map(|step| f64::from(step) * 50.0 / 512.0).collect();
    let ours = mark_correlation(&longleaf, marks, &radii).unwrap();
    for name in ["trans", "iso"] {
        for (row, theirs) in theirs[name].iter().enumerate() {
            let ours = ours.column(name).unwrap()[row];
            assert!((ours / theirs - 1.0).abs() < 0.005, "{name} {row}: {ours} for {theirs}");
        }
    }
}

/// `Fest(X, eps = 0.25)` and `Jest(X, eps = 0.25)`, spatstat.explore 3.0-6: distances there are
/// between pixels of 0.25 m, and from other places than ours.
#[test]
fn f_and_j_of_longleaf_pines_are_those_of_spatstat_but_for_its_pixels() {
    let Some(stems) = stems() else { return };
    let pattern = pattern(&stems, "longleaf", STANDS[0].1);
    let last = 20.0 * (1.0 - std::f64::consts::PI * 1e-5);
    let radii: Vec<f64> = (0..=400).map(|step| f64::from(step) * last / 400.0).collect();
    let mut tables = statistics(&pattern, &[Statistic::F, Statistic::J], &radii).unwrap();
    let (j, f) = (tables.remove(1), tables.remove(0));
    let near = |table: &weald_analyze::Table, row: usize, name: &str, theirs: f64, within: f64| {
        let ours = table.column(name).unwrap()[row];
        assert!((ours - theirs).abs() < within, "{} {name} {row}: {ours} for {theirs}", table.name);
    };
    // Row, raw, cs, rs, km.
    for (row, values) in [
        (80, [0.41740156, 0.43338497, 0.42668152, 0.42491942]),
        (160, [0.81846250, 0.84992257, 0.84279744, 0.83788472]),
        (240, [0.95408125, 0.98082691, 0.97758547, 0.97398567]),
    ] {
        for (name, theirs) in ["raw", "cs", "rs", "km"].into_iter().zip(values) {
            near(&f, row, name, theirs, 0.01);
        }
    }
    // Row, un, rs, han, km.
    for (row, values) in [
        (40, [0.74951733, 0.75135763, 0.75781368, 0.75365685]),
        (80, [0.54341294, 0.54894865, 0.56151737, 0.55020994]),
        (120, [0.45282129, 0.48511142, 0.50882635, 0.48433937]),
    ] {
        for (name, theirs) in ["un", "rs", "han", "km"].into_iter().zip(values) {
            near(&j, row, name, theirs, 0.02);
        }
    }
}

/// Ratio from `quadratcount`, index by its definition, R 4.2.2.
#[test]
fn quadrats_of_real_stands_count_as_in_spatstat() {
    let Some(stems) = stems() else { return };
    let expected = [
        (0, 5, 6.3601598173515983, 1.2206583801311122),
        (0, 10, 3.7004289470042897, 1.4585634060950681),
        (4, 5, 0.93650793650793651, 0.99087539207299691),
        (4, 10, 0.8042328042328043, 0.8839463929284288),
    ];
    for (stand, side, ratio, morisita) in expected {
        let (name, window) = STANDS[stand];
        let quadrats = Quadrats::of(&pattern(&stems, name, window), side, side).unwrap();
        agree(name, &[quadrats.variance_mean_ratio, quadrats.morisita], &[ratio, morisita]);
    }
}

#[test]
fn sizes_of_real_stands_are_as_unequal_as_r_says() {
    let Some(stems) = stems() else { return };
    let expected = oracles(&stems);
    for name in ["longleaf", "spruces"] {
        let marks = &read(stems.join(format!("{name}.csv")))["mark"];
        let sizes = Sizes::of(marks).unwrap();
        let found = [
            ("gini", sizes.gini),
            ("cv", sizes.variation),
            ("skew_pop", sizes.skewness),
            ("mean", sizes.mean),
        ];
        for (what, value) in found {
            let key = format!("{name}_mark_{what}");
            agree(&key, &[value], &[expected[&key]]);
        }
    }
    let dbh = &read(stems.join("longleaf.csv"))["mark"];
    let found = [0.5, 0.9].map(|part| quantile(dbh, part).unwrap());
    agree("quantiles", &found, &[26.15, 51.17]);
}

fn oracles(stems: &std::path::Path) -> BTreeMap<String, f64> {
    let text = std::fs::read_to_string(stems.join("stats/fit_oracles.csv")).unwrap();
    let pair = |line: &str| {
        let (name, value) = line.split_once(',')?;
        Some((name.to_owned(), value.trim().parse().ok()?))
    };
    text.lines().filter_map(pair).collect()
}
