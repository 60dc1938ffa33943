//! `weald analyze` on tables as people bring them.

#[allow(dead_code, reason = "other tests use the rest")]
mod tiny;

use tiny::{Tiny, bytes_below};

/// Sixty plants in clusters on 20 m by 10 m, with types, marks and a density.
fn stems() -> String {
    let mut text = String::from("x,y,kind,dbh_cm,density\n");
    for index in 0..60u32 {
        let (cluster, member) = (index % 12, index / 12);
        let x = 1.5 + f64::from(cluster) * 1.5 + 0.07 * f64::from(member * member % 7);
        let y = 1.0 + f64::from(cluster * 5 % 12) * 0.7 + 0.05 * f64::from(member * 3 % 5);
        let kind = if cluster % 2 == 0 { "pine" } else { "birch" };
        text += &format!("{x:.4},{y:.4},{kind},{},{:.3}\n", 5 + index % 9, 0.1 + x / 50.0);
    }
    text
}

fn header(tiny: &Tiny, name: &str) -> String {
    tiny.read(name).lines().next().unwrap_or_default().to_string()
}

#[test]
fn every_statistic_has_its_table_and_figures() {
    let tiny = Tiny::new();
    tiny.write("stems.csv", &stems());
    tiny.write("radii.csv", "r,other\n0,1\n0.5,2\n1.25,3\n");
    let answer = tiny.done(
        "analyze stems.csv --window 0,0,20,10 --statistics K,L,G,F,J,pcf --radii radii.csv \
         --types kind --marks dbh_cm --intensity density -o out",
    );
    for word in ["Morisita", "Clark-Evans", "Reineke SDI"] {
        assert!(answer.out.contains(word), "{}", answer.out);
    }
    for (name, columns) in [
        ("K", "r,theo,un,border,trans,iso"),
        ("L", "r,theo,un,border,trans,iso"),
        ("G", "r,theo,raw,rs,km,han"),
        ("G.continuous", "r,theo,rs,km"),
        ("F", "r,theo,raw,rs,km,cs"),
        ("J", "r,theo,un,rs,km,han"),
        ("pcf", "r,theo,trans"),
        ("Kinhom", "r,theo,un,border,trans,iso"),
        ("markcorr", "r,theo,trans,iso"),
        ("K.birch-pine", "r,theo,un,border,trans,iso"),
        ("G.pine-birch", "r,theo,raw,rs,km,han"),
        ("pcf.pine-birch", "r,theo,trans"),
    ] {
        assert_eq!(header(&tiny, &format!("out/{name}.csv")), columns, "{name}");
        let rows = tiny.read(&format!("out/{name}.csv"));
        let radii: Vec<&str> =
            rows.lines().skip(1).map(|row| row.split(',').next().unwrap_or_default()).collect();
        assert_eq!(radii, ["0", "0.5", "1.25"], "{name}");
    }
    assert!(tiny.read("out/K.svg").starts_with("<svg"));
    assert!(tiny.read("out/pcf.pine-birch.svg").ends_with("</svg>\n"));
    assert!(tiny.done("info out/markcorr.png").out.contains("analyze"));
}

#[test]
fn a_verdict_is_the_same_on_one_thread_and_two_and_follows_the_seed() {
    let tiny = Tiny::new();
    tiny.write("stems.csv", &stems());
    let run = |rest: &str| {
        tiny.done(&format!(
            "analyze stems.csv --window 0,0,20,10 --statistics L,J --types kind --marks dbh_cm \
             --simulations 39 --steps 20 {rest}"
        ))
    };
    let answer = run("-o one --threads 1");
    assert!(answer.out.contains("L: points stand closer together"), "{}", answer.out);
    assert!(answer.out.contains("p = 0.025"), "{}", answer.out);
    run("-o two --threads 2");
    assert_eq!(bytes_below(&tiny.path("one")), bytes_below(&tiny.path("two")));
    run("-o other --seed 5");
    assert_ne!(
        bytes_below(&tiny.path("one"))["L.envelope.csv"],
        bytes_below(&tiny.path("other"))["L.envelope.csv"]
    );
    // A pattern is like its own replicates.
    let answer = tiny.done(
        "analyze stems.csv --window 0,0,20,10 --statistics L --patterns stems.csv stems.csv -o of",
    );
    assert!(answer.out.contains("too few simulations"), "{}", answer.out);
    let nineteen = " stems.csv".repeat(19);
    let answer = tiny
        .done(&format!("analyze stems.csv --window 0,0,20,10 --statistics L --patterns{nineteen}"));
    assert!(answer.out.contains("not told apart from the simulated patterns"), "{}", answer.out);
}

#[test]
fn mistakes_in_a_table_are_named_by_row_and_column() {
    let tiny = Tiny::new();
    tiny.write("stems.csv", &stems());
    tiny.write("hole.csv", "x,y,dbh\n1,2,3\n4,,3\n2,2,x\n");
    tiny.write("words.csv", "x,y\n1,2\n4,oak\n");
    tiny.write("falling.csv", "r\n0\n1\n0.5\n");
    tiny.write("negative.csv", "x,y,size\n1,2,3\n4,5,-3\n2,2,1\n");
    for (arguments, parts) in [
        ("stems.csv --window 0,0,3,10", vec!["row 3, column `x`, `y`", "outside the window"]),
        ("hole.csv", vec!["row 2, column `y`", "missing"]),
        ("words.csv", vec!["row 2, column `y`", "expected a number, found `oak`"]),
        ("negative.csv --marks size -o out", vec!["row 2, column `size`", "-3"]),
        ("stems.csv --marks weight", vec!["no column `weight`", "x, y, kind, dbh_cm, density"]),
        ("stems.csv --types density", vec!["holds fractions", "--marks"]),
        ("stems.csv --statistics K,H", vec!["no statistic is called `H`", "K, L, G, F, J, pcf"]),
        ("stems.csv --radii words.csv", vec!["no column `r`"]),
        ("stems.csv --radii falling.csv", vec!["falling.csv, row 3, column `r`", "0.5"]),
        ("stems.csv --radius -1", vec!["-1 m", "positive"]),
    ] {
        let answer = tiny.weald(&format!("analyze {arguments}"));
        assert_eq!(answer.code, 2, "{arguments}: {}", answer.out);
        // The report breaks lines where it likes.
        let told = answer.err.split_whitespace().collect::<Vec<_>>().join(" ").replace("│ ", "");
        for part in parts {
            assert!(told.contains(part), "{arguments}: {told}");
        }
    }
}

#[test]
fn a_stands_history_gets_its_line_from_the_plateau_of_cover() {
    let tiny = Tiny::new();
    let mut text = String::from("step,density,mean_area,cover\n");
    for step in 0..300 {
        let density = 0.985f64.powi(step);
        let cover = 0.3 * (1.0 - (-f64::from(step) / 30.0).exp());
        text += &format!("{step},{density},{},{cover}\n", cover / density);
    }
    tiny.write("history.csv", &text);
    let answer = tiny.done("analyze history.csv -o out");
    assert!(answer.out.contains("-1.0"), "{}", answer.out);
    assert!(!answer.out.contains("too early"), "{}", answer.out);
    assert_eq!(header(&tiny, "out/thinning.csv"), "density,mean_size,cover,used");
    assert!(tiny.read("out/thinning.svg").contains("log10 density"));
    let early = tiny.done("analyze history.csv --densities 0.01,0.9");
    assert!(early.out.contains("starts too early"), "{}", early.out);
}
