//! Estimators held against spatstat on stem maps of real stands.
//!
//! The data are GPL and stay outside this repository; without them the tests say so and pass.
//! `WEALD_SHARED` names the folder that holds `data/stems`.

use std::collections::BTreeMap;
use std::path::PathBuf;
use weald_analyze::{
    Divisor, Pattern, Sizes, StandState, Statistic, Window, clark_evans, pair_correlation,
    quantile, statistics, thinning_line,
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
    ];
    for (name, value) in found {
        agree(name, &[value], &[expected[name]]);
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
