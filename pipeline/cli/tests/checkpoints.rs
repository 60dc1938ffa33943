//! A simulation that was stopped and taken up again leaves the files of one that was not.

mod tiny;

use std::path::Path;
use tiny::{Answer, Tiny, bytes_below};

/// Self-thinning, several species on the result, painted plants in their shade.
const STEPS: &str = r#"
[[ecosim.step]]
kind = "self_thinning"
species = "silver_birch"
plants = 3000
radius = [0.05, 0.3]
steps = 12
growth = { law = "additive", rate = 0.1, spread = 0.3 }
keep = [0, 5, 12]

[[ecosim.step]]
kind = "simulate"
species = ["aspen", "silver_birch"]
years = 9
initial = 60
chance = "1 - 0.5 * crown_shadow(\"silver_birch\")"

[[ecosim.step]]
kind = "halftone"
species = "coneflower"
density = "inputs/density.asc"
per_m2 = 0.2

[quantize]"#;
const YEARS: u32 = 12 + 9;

fn scene() -> Tiny {
    let tiny = Tiny::new();
    let text = tiny.read("scene/scene.toml");
    let (from, to) = (text.find("[[ecosim.step]]"), text.find("[quantize]"));
    let old = &text[from.expect("steps")..to.expect("a table") + "[quantize]".len()];
    tiny.edit(old, STEPS);
    tiny.done("terrain scene -o terrain");
    tiny
}

fn grow(tiny: &Tiny, folder: &str, more: &str) -> Answer {
    let out = format!("-o {folder}/population.parquet");
    tiny.weald(&format!("ecosim scene --terrain terrain {out} {more}"))
}

fn assert_same(tiny: &Tiny, one: &str, other: &str) {
    let [one, other] = [one, other].map(|name| bytes_below(&tiny.path(name)));
    assert_eq!(one.keys().collect::<Vec<_>>(), other.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(Some(bytes) == other.get(name), "{name} differs");
    }
}

#[test]
fn stopped_at_several_years_and_on_other_threads_every_file_has_the_same_bytes() {
    let tiny = scene();
    assert_eq!(grow(&tiny, "whole", "").code, 0);
    assert!(bytes_below(&tiny.path("whole")).len() >= 9);
    for years in [1, 4, 12, 15, YEARS] {
        let folder = format!("parts{years}");
        let mut stops = 0;
        loop {
            let threads = 1 + stops % 2;
            let more =
                format!("--checkpoint state.checkpoint --stop-after {years} --threads {threads}");
            let answer = grow(&tiny, &folder, &more);
            if answer.code == 0 {
                break;
            }
            stops += 1;
            assert_eq!(answer.code, 75, "{}", answer.err);
            let year = format!("stopped after year {}", years * stops);
            assert!(answer.err.contains(&year), "no `{year}` in {}", answer.err);
            assert!(answer.err.contains("the same command goes on"), "{}", answer.err);
            assert!(!tiny.path(&folder).exists() && tiny.path("state.checkpoint").exists());
        }
        assert_eq!(stops, YEARS / years);
        assert!(!tiny.path("state.checkpoint").exists(), "it is removed at the end");
        assert_same(&tiny, "whole", &folder);
    }
}

#[test]
fn a_checkpoint_of_other_work_is_refused_with_the_difference() {
    let tiny = scene();
    let state = "--checkpoint state.checkpoint";
    assert_eq!(grow(&tiny, "out", &format!("{state} --stop-after 3")).code, 75);
    let info = tiny.done("info state.checkpoint").out;
    assert!(info.contains("a checkpoint of a simulation") && info.contains("years done"), "{info}");
    let before = std::fs::read(tiny.path("state.checkpoint")).expect("a checkpoint");
    let refused = |more: &str, words: &[&str]| {
        let answer = grow(&tiny, "out", &format!("{state} {more}"));
        assert_eq!(answer.code, 2, "{more}: {}", answer.err);
        for word in words {
            assert!(answer.err.contains(word), "{more}: no `{word}` in {}", answer.err);
        }
    };
    refused("--seed 4", &["state.checkpoint", "seed was 3, is 4", "remove the file to begin anew"]);
    refused("--set ecosim.step[1].years=20", &["ecosim.step[1]", "years was 9, is 20"]);
    std::fs::copy(tiny.path("terrain/slope.tif"), tiny.path("kept.tif")).expect("a copy");
    std::fs::copy(tiny.path("terrain/soil_moisture.tif"), tiny.path("terrain/slope.tif"))
        .expect("another layer");
    refused("", &["terrain/slope.tif changed"]);
    std::fs::copy(tiny.path("kept.tif"), tiny.path("terrain/slope.tif")).expect("the layer");
    tiny.write("notes.txt", "precious");
    let answer = grow(&tiny, "out", "--checkpoint notes.txt");
    assert_eq!(answer.code, 2);
    assert!(answer.err.contains("notes.txt: this is no checkpoint"), "{}", answer.err);
    assert_eq!(tiny.read("notes.txt"), "precious");
    assert_eq!(before, std::fs::read(tiny.path("state.checkpoint")).expect("it is still there"));
    let answer = grow(&tiny, "out", "--stop-after 3");
    assert!(answer.code == 2 && answer.err.contains("--checkpoint"), "{}", answer.err);
}

#[test]
fn damaged_checkpoints_are_errors_that_name_the_file() {
    let tiny = scene();
    let state = "--checkpoint state.checkpoint";
    assert_eq!(grow(&tiny, "out", &format!("{state} --stop-after 14")).code, 75);
    let whole = std::fs::read(tiny.path("state.checkpoint")).expect("a checkpoint");
    let try_with = |bytes: &[u8]| {
        std::fs::write(tiny.path("state.checkpoint"), bytes).expect("a file");
        let answer = grow(&tiny, "out", state);
        assert_eq!(answer.code, 2, "{}", answer.err);
        assert!(answer.err.contains("state.checkpoint: this"), "{}", answer.err);
        assert!(!answer.err.contains("panic"), "{}", answer.err);
    };
    for length in [0, 7, 8, 12, 15, 16, 500, whole.len() / 2, whole.len() - 33, whole.len() - 1] {
        try_with(&whole[..length]);
    }
    for at in [0, 9, 13, 40, whole.len() / 3, whole.len() / 2, whole.len() - 40, whole.len() - 1] {
        let mut bytes = whole.clone();
        bytes[at] ^= 0x10;
        try_with(&bytes);
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_in_the_middle_of_a_simulation_loses_no_year() {
    use std::process::{Command, Stdio};
    let tiny = scene();
    let years = "--set ecosim.step[0].steps=4000 --set ecosim.step[0].growth.rate=0.0001 \
                 --set ecosim.step[0].keep=[]";
    let interrupted = |arguments: &str, is_under_way: &dyn Fn() -> bool| {
        let mut child = Command::new(env!("CARGO_BIN_EXE_weald"))
            .args(arguments.split_whitespace())
            .current_dir(tiny.path(""))
            .stderr(Stdio::null())
            .stdout(Stdio::null())
            .spawn()
            .expect("weald starts");
        let began = std::time::Instant::now();
        while !is_under_way() {
            assert!(began.elapsed().as_secs() < 60, "it begins soon");
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
        assert!(kill.expect("a kill command").success());
        child.wait().expect("it ends").code()
    };
    let alone = format!(
        "ecosim scene --terrain terrain -o parts/population.parquet {years} \
         --checkpoint state.checkpoint --checkpoint-every 0"
    );
    let code = interrupted(&alone, &|| tiny.path("state.checkpoint").exists());
    assert_eq!(code, Some(75));
    tiny.done(&alone);
    assert_eq!(grow(&tiny, "whole", years).code, 0);
    assert_same(&tiny, "whole", "parts");

    // A run keeps its own, which nothing but the years shows afterwards.
    let run = format!("run scene -o run {years}");
    let terrain = |name: &str| tiny.path("run/.weald").join(name).exists();
    assert_eq!(interrupted(&run, &|| terrain("terrain.json")), Some(75));
    if tiny.path("run/.weald/ecosim.checkpoint").exists() {
        let header = tiny.done("info run/.weald/ecosim.checkpoint --json").out;
        assert!(header.contains("years done"), "{header}");
    }
    tiny.done(&run);
    assert!(!terrain("ecosim.checkpoint") && Path::new(&tiny.path("run/image.exr")).exists());
    for name in ["population.parquet", "summary.csv", "deaths.parquet"] {
        let read = |folder: &str| std::fs::read(tiny.path(folder).join(name)).expect(name);
        assert!(read("run") == read("whole"), "{name} differs");
    }
}
