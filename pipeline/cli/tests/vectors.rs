//! `weald quantize --table`: clusters of anyone's rows, from the command line.

#[allow(dead_code, reason = "other tests use the rest")]
mod tiny;

use tiny::Tiny;

#[test]
fn a_table_is_clustered_and_its_centres_are_written() {
    let tiny = Tiny::new();
    let text = "a,b,w\n0,0,1\n0,2,1\n9,5,2\n9,5,0\n";
    std::fs::write(tiny.path("v.csv"), text).expect("a folder to write to");
    let words = "quantize --table v.csv --columns a,b --weight w -k 2 --mode best";
    let report = tiny.done(&format!("{words} -o centres.csv --json")).out;
    let report: serde_json::Value = serde_json::from_str(&report).expect("a JSON report");
    // Two rows of weight 1, each a distance of 1 from their mean, of a weight of 4 in all.
    assert_eq!(report["weighted_mse"], 0.5);
    assert_eq!((&report["clusters"], &report["rows"]), (&2.into(), &4.into()));
    assert!(report["seconds"].is_number());
    let centres = std::fs::read_to_string(tiny.path("centres.csv")).expect("it was written");
    assert_eq!(centres, "a,b,count,weight\n0,1,2,2\n9,5,2,2\n");
}

#[test]
fn a_table_with_a_hole_is_refused_by_row_and_column() {
    let tiny = Tiny::new();
    std::fs::write(tiny.path("v.csv"), "a,b\n1,2\nNaN,4\n").expect("a folder to write to");
    let refused = tiny.weald("quantize --table v.csv -k 2");
    assert_eq!(refused.code, 2);
    assert!(refused.err.contains("row 2, column `a`"), "{}", refused.err);
    let neither = tiny.weald("quantize -o out");
    assert_eq!(neither.code, 2);
}
