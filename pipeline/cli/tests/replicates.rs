//! Many simulations: each is the one of its seed and values, and the tables add them up rightly.

mod tiny;

use std::collections::BTreeMap;
use tiny::{Tiny, bytes_below};

fn scene() -> Tiny {
    let tiny = Tiny::new();
    tiny.edit("initial = 60", "initial = 60\nkeep = [4]");
    tiny.done("terrain scene -o terrain");
    tiny
}

/// Rows of a table by the names of its columns.
fn rows(tiny: &Tiny, name: &str) -> Vec<BTreeMap<String, String>> {
    let text = tiny.read(name);
    let mut lines = text.lines().map(|line| line.split(',').map(String::from));
    let names: Vec<String> = lines.next().expect("a header").collect();
    lines.map(|line| names.iter().cloned().zip(line).collect()).collect()
}

fn number(row: &BTreeMap<String, String>, name: &str) -> f64 {
    row[name].parse().unwrap_or(f64::NAN)
}

#[test]
fn a_replicate_is_the_simulation_of_its_seed() {
    let tiny = scene();
    let answer =
        tiny.done("ecosim scene --terrain terrain --replicates 3 --keep-plants -o runs --json");
    assert!(answer.out.contains("runs/plants-0002.parquet"), "{}", answer.out);
    let table = rows(&tiny, "runs/replicates.csv");
    for (replicate, seed) in [(0, 3), (1, 4), (2, 5)] {
        tiny.done(&format!("ecosim scene --terrain terrain --seed {seed} -o one/plants.parquet"));
        tiny.done(&format!("compare one/plants.parquet runs/plants-000{replicate}.parquet"));
        let single = rows(&tiny, "one/summary.csv");
        let last = single.last().expect("years");
        let is_own = |row: &&BTreeMap<String, String>| {
            row["species"] == "aspen" && number(row, "replicate") == f64::from(replicate)
        };
        let row = table.iter().find(is_own).expect("a row");
        assert_eq!(number(row, "seed"), f64::from(seed));
        assert_eq!(number(row, "plants"), number(last, "alive"));
        assert!((number(row, "cover") - number(last, "cover")).abs() < 1e-6);
        assert!((number(row, "gini") - number(last, "gini")).abs() < 1e-6);
        let births: f64 = single.iter().map(|row| number(row, "births")).sum();
        assert_eq!(number(row, "births"), births);
    }
}

#[test]
fn statistics_are_those_of_the_replicates_on_any_number_of_threads() {
    let tiny = scene();
    let command = "ecosim scene --terrain terrain --replicates 7 \
                   --sweep species.aspen.ecology.survival=0..1:3 --sweep ecosim.step[0].years=4,9";
    tiny.done(&format!("{command} --threads 1 -o one"));
    let words = tiny.done(&format!("{command} --threads 2 -o two")).err;
    assert!(words.contains("species.aspen.ecology.survival = 0.5, ecosim.step[0].years = 9"));
    let (one, two) = (bytes_below(&tiny.path("one")), bytes_below(&tiny.path("two")));
    assert_eq!(one.len(), 3 * 2 + 2);
    assert!(one == two);
    let each = rows(&tiny, "one/replicates.csv");
    let mut plants: Vec<(f64, f64)> = Vec::new();
    for row in rows(&tiny, "one/statistics.csv") {
        let is_own = |other: &&BTreeMap<String, String>| {
            other["point"] == row["point"] && other["species"] == row["species"]
        };
        let mut values: Vec<f64> = each
            .iter()
            .filter(is_own)
            .map(|other| number(other, &row["measure"]))
            .filter(|value| value.is_finite())
            .collect();
        values.sort_by(f64::total_cmp);
        let n = values.len() as f64;
        assert_eq!(number(&row, "replicates"), n);
        if values.len() < 2 {
            continue;
        }
        let mean = values.iter().sum::<f64>() / n;
        let squares: f64 = values.iter().map(|value| (value - mean).powi(2)).sum();
        let near = |name: &str, right: f64| {
            let found = number(&row, name);
            assert!((found - right).abs() <= 1e-9 * right.abs() + 1e-12, "{row:?}: {name} {right}");
        };
        near("mean", mean);
        near("sd", (squares / (n - 1.0)).sqrt());
        near("least", values[0]);
        near("greatest", values[values.len() - 1]);
        if values.len() == 7 {
            // Seven values: the quartiles lie in the middle between two of them.
            near("median", values[3]);
            near("q25", 0.5 * (values[1] + values[2]));
        }
        if row["measure"] == "plants" && row["species"] == "aspen" {
            assert_eq!(number(&row, "replicates"), 7.0);
            plants.push((number(&row, "species.aspen.ecology.survival"), number(&row, "mean")));
        }
    }
    // Points in the order of the values, the last field fastest: more survival leaves more plants.
    let survivals: Vec<f64> = plants.iter().map(|(survival, _)| *survival).collect();
    assert_eq!(survivals, [0.0, 0.0, 0.5, 0.5, 1.0, 1.0]);
    assert!(plants[1].1 < plants[3].1 && plants[3].1 < plants[5].1, "{plants:?}");
    // A row for the start and each year of each point.
    let years = rows(&tiny, "one/years.csv");
    let alive = years.iter().filter(|row| row["measure"] == "alive" && row["point"] == "1");
    assert_eq!(alive.count(), 10);
    assert!(tiny.read("one/cover.svg").starts_with("<svg"));
}

#[test]
fn mistakes_are_told_before_any_work() {
    let tiny = scene();
    let refused = |more: &str, words: &[&str]| {
        let answer = tiny.weald(&format!("ecosim scene --terrain terrain -o runs {more}"));
        assert_eq!(answer.code, 2, "{more}: {}", answer.err);
        for word in words {
            assert!(answer.err.contains(word), "{more}: no `{word}` in {}", answer.err);
        }
        assert!(!tiny.path("runs").exists(), "{more}");
    };
    refused("--sweep species.aspn.ecology.survival=0,1", &["no species `aspn`", "`aspen`"]);
    refused("--sweep species.aspen.ecology.survivl=0,1", &["survivl", "did you mean `survival`"]);
    refused("--sweep species.aspen.ecology.survival=0.5,7", &["survival", "7"]);
    refused("--sweep ecosim.step[9].years=1,2", &["there is no place 9"]);
    refused("--sweep render.samples=1,2", &["changes no simulation"]);
    refused("--sweep ecosim.step[0].years=1..9", &["is no range"]);
    refused("--replicates 0", &["0"]);
    refused("--replicates 2 --checkpoint a.checkpoint", &["cannot be used with"]);
    let set = "--set species.coneflower.ecology.survival=2";
    let answer = tiny.weald(&format!("run scene -o out {set}"));
    assert!(answer.code == 2 && answer.err.contains("survival"), "{}", answer.err);
}

#[test]
fn a_species_is_changed_for_this_time_and_makes_ecosim_stale() {
    let tiny = scene();
    let grow = |more: &str, out: &str| {
        tiny.done(&format!("ecosim scene --terrain terrain {more} -o {out}/plants.csv"));
        rows(&tiny, &format!("{out}/summary.csv")).last().map(|row| number(row, "alive"))
    };
    let plain = grow("", "plain");
    assert!(grow("--set species.aspen.ecology.seedlings=500", "more") > plain);
    tiny.done("run scene -o out -q");
    let plan = tiny.done("run scene -o out -n --set species.aspen.ecology.seedlings=500").out;
    assert!(plan.contains("seedlings was"), "{plan}");
}
