//! Bad input: each gives one exit code, names file, line and field, and leaves nothing half-done.

mod tiny;

use tiny::Tiny;

/// Runs the scene, expects exit code 2, and that all the words are in what it says.
fn refused(tiny: &Tiny, arguments: &str, words: &[&str]) -> String {
    let answer = tiny.weald(arguments);
    assert_eq!(answer.code, 2, "{}{}", answer.out, answer.err);
    for word in words {
        assert!(answer.err.contains(word), "no `{word}` in\n{}", answer.err);
    }
    assert!(!answer.err.contains("panicked"), "{}", answer.err);
    answer.err
}

/// Line of the scene file on which a text stands, as errors write it.
fn line_of(tiny: &Tiny, text: &str) -> String {
    let scene = tiny.read("scene/scene.toml");
    let before = scene.find(text).expect("it is there");
    format!("scene.toml:{}:", scene[..before].matches('\n').count() + 1)
}

#[test]
fn a_missing_elevation_model_is_named_with_its_field() {
    let tiny = Tiny::new();
    tiny.edit("inputs/ground.asc", "inputs/grund.asc");
    let line = line_of(&tiny, "\"inputs/grund.asc\"");
    refused(&tiny, "run scene -o out", &[&line, "grund.asc", "did you mean `ground.asc`?"]);
    assert!(!tiny.path("out").exists());
}

#[test]
fn a_truncated_elevation_model_is_refused() {
    let tiny = Tiny::new();
    let whole = tiny.read("scene/inputs/ground.asc");
    tiny.write("scene/inputs/ground.asc", &whole[..whole.len() / 2]);
    refused(&tiny, "run scene -o out", &["ground.asc", &line_of(&tiny, "\"inputs/ground.asc\"")]);
    assert!(!tiny.path("out/terrain/altitude.tif").exists());
    // With the file whole again the next run goes on.
    tiny.write("scene/inputs/ground.asc", &whole);
    tiny.done("terrain scene -o terrain");
}

#[test]
fn typing_errors_at_any_depth_are_all_told_at_once() {
    let tiny = Tiny::new();
    tiny.edit("amplitude = 0.1", "amplitud = 0.1");
    tiny.edit("years = 12", "years = \"twelve\"");
    tiny.edit("samples = 2", "samples = 0");
    tiny.edit(
        "kind = \"halftone\"\nspecies = \"meadow\"",
        "kind = \"halftoen\"\nspecies = \"meadow\"",
    );
    let lines = [
        line_of(&tiny, "amplitud = "),
        line_of(&tiny, "\"twelve\""),
        line_of(&tiny, "samples = 0"),
        line_of(&tiny, "\"halftoen\""),
    ];
    let mut words: Vec<&str> = lines.iter().map(String::as_str).collect();
    words.extend(["did you mean `amplitude`?", "did you mean `halftone`?", "samples"]);
    refused(&tiny, "run scene -o out", &words);
}

#[test]
fn an_error_shows_the_line_and_what_would_be_right() {
    let tiny = Tiny::new();
    tiny.edit("wavelength = 8.0", "wavelenght = 8.0");
    insta::assert_snapshot!("misspelt_field", refused(&tiny, "check scene", &[]));
    let tiny = Tiny::new();
    tiny.edit("seed = 3", "seed = [3");
    refused(&tiny, "check scene", &["scene.toml:4:", "expected `,`"]);
}

#[test]
fn an_unknown_species_is_named_with_the_likely_one() {
    let tiny = Tiny::new();
    tiny.edit("[\"aspen\"]", "[\"aspne\"]");
    let line = line_of(&tiny, "\"aspne\"");
    refused(
        &tiny,
        "run scene -o out",
        &[&line, "unknown species `aspne`", "did you mean `aspen`?"],
    );
}

#[test]
fn a_mistake_in_a_species_file_is_told_there() {
    let tiny = Tiny::new();
    std::fs::create_dir_all(tiny.path("scene/species")).expect("a folder");
    tiny.write(
        "scene/species/aspen.toml",
        "[size]\nheight = 12\ncrown_radius = 2\ncrwon = 1\n[form]\ngenerator = \"grass\"\n",
    );
    refused(&tiny, "check scene", &["aspen.toml:4:", "crwon"]);
}

#[test]
fn an_unknown_view_is_named() {
    let tiny = Tiny::new();
    tiny.edit("view = \"bank\"", "view = \"bnak\"");
    refused(&tiny, "check scene", &[&line_of(&tiny, "\"bnak\""), "did you mean `bank`?"]);
}

#[test]
fn a_flag_with_a_mistake_is_shown_as_the_flag() {
    let tiny = Tiny::new();
    refused(
        &tiny,
        "check scene --set render.smaples=3",
        &["--set render.smaples=3", "did you mean `samples`?"],
    );
    refused(&tiny, "check scene --set render.samples", &["no `=`"]);
}

#[test]
fn a_plant_of_impossible_age_or_vigor_is_refused() {
    let tiny = Tiny::new();
    for flag in ["--age NaN", "--age=-1", "--vigor 1.5"] {
        refused(&tiny, &format!("plants aspen {flag} -o x.glb"), &["allowed: 0 to"]);
    }
    refused(&tiny, "plants meadow -o x.glb", &["is a patch of other plants", "grass"]);
    assert!(!tiny.path("x.glb").exists());
}

#[test]
fn absurd_sizes_are_refused_before_work() {
    let tiny = Tiny::new();
    refused(
        &tiny,
        "run scene -o out --set render.resolution=[900000,900000]",
        &["resolution", "allowed"],
    );
    refused(&tiny, "run scene -o out --set terrain.cell=0.001", &["terrain"]);
    assert!(!tiny.path("out/terrain").exists());
}

#[test]
fn a_density_of_another_shape_is_refused_at_its_field() {
    let tiny = Tiny::new();
    // A canvas for ground of another shape, which names no place on the map.
    let wide = "ncols 8\nnrows 4\nxllcorner 0\nyllcorner 0\ncellsize 8\n";
    tiny.write("scene/inputs/wide.asc", &format!("{wide}{}", "1 2 3 4 5 6 7 8\n".repeat(4)));
    tiny.done(
        "canvas scene -o scene/inputs/wide.png --set terrain.source=inputs/wide.asc --set terrain.op=[]",
    );
    tiny.edit("inputs/density.asc", "inputs/wide.png");
    let line = line_of(&tiny, "\"inputs/wide.png\"");
    refused(&tiny, "run scene -o out", &[&line, "8"]);
    assert!(!tiny.path("out/population.parquet").exists());
    // The stage before it is kept, and the next run goes on from there.
    assert!(tiny.path("out/.weald/terrain.json").is_file());
    tiny.edit("inputs/wide.png", "inputs/density.asc");
    tiny.done("run scene -o out");
}

#[test]
fn a_folder_that_cannot_be_written_is_an_error_that_names_it() {
    let tiny = Tiny::new();
    tiny.write("file", "not a folder");
    refused(&tiny, "run scene -o file/out", &["file/out"]);
}

#[cfg(unix)]
#[test]
fn a_disk_that_takes_no_more_leaves_no_half_written_file() {
    // A limit on the size of files stands for a full disk: writes fail in the middle of a file.
    let tiny = Tiny::new();
    let script =
        format!("trap '' XFSZ; ulimit -f 4; exec {} run scene -o out", env!("CARGO_BIN_EXE_weald"));
    let mut command = std::process::Command::new("sh");
    command.args(["-c", &script]).current_dir(tiny.path(""));
    let output = command.output().expect("a shell");
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{told}");
    assert!(told.contains("cannot write") && told.contains(".tif"), "{told}");
    let left = tiny::bytes_below(&tiny.path("out"));
    assert!(
        left.keys().all(|name| !name.ends_with(".json") && !name.ends_with(".part")),
        "{:?}",
        left.keys()
    );
    // With room again, the next run goes on.
    tiny.done("run scene -o out");
}

#[test]
fn a_scene_that_is_nowhere_says_how_to_make_one() {
    let tiny = Tiny::new();
    std::fs::create_dir(tiny.path("empty")).expect("a folder");
    refused(&tiny, "run empty", &["scene.toml", "weald new"]);
    refused(&tiny, "run nowhere.toml", &["nowhere.toml"]);
}

#[test]
fn damaged_files_of_ours_are_refused_by_every_command_that_reads_them() {
    let tiny = Tiny::new();
    for (name, command) in [
        ("x.parquet", "info"),
        ("x.glb", "info"),
        ("x.exr", "info"),
        ("x.tif", "info"),
        ("x.png", "info"),
        ("x.toml", "info"),
        ("x.csv", "preview"),
        ("x.glb", "preview"),
    ] {
        tiny.write(name, "this is no such file \u{0}\u{1}");
        refused(&tiny, &format!("{command} {name}"), &[name]);
    }
}
