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

/// Runs the scene in a shell that set a limit, expects exit code 2, and gives what it says.
#[cfg(unix)]
fn limited(tiny: &Tiny, limit: &str, arguments: &str) -> String {
    let script = format!("{limit}; exec {} {arguments}", env!("CARGO_BIN_EXE_weald"));
    let mut command = std::process::Command::new("sh");
    command.args(["-c", &script]).current_dir(tiny.path(""));
    let output = command.output().expect("a shell");
    let told = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(2), "{told}");
    told
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

#[cfg(target_os = "linux")]
#[test]
fn a_terrain_beyond_the_memory_of_the_process_is_refused_before_work() {
    let tiny = Tiny::new();
    // 64 million cells take 5 GB; the process may have 4.
    let told = limited(&tiny, "ulimit -v 4000000", "terrain scene -o out --set terrain.cell=0.008");
    assert!(told.contains("GB") && told.contains("`cell`"), "{told}");
    assert!(!tiny.path("out").exists());
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
    let told = limited(&tiny, "trap '' XFSZ; ulimit -f 4", "run scene -o out");
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

#[test]
fn a_formula_without_end_is_told_without_panic() {
    let tiny = Tiny::new();
    let deep = format!("{}1{}", "(".repeat(100_000), ")".repeat(100_000));
    tiny.edit("if(x > 20 and x < 30 and y < 12, 1, 0)", &deep);
    let told = refused(&tiny, "check scene", &["scene.toml:"]);
    assert!(told.len() < 1000, "{} bytes", told.len());
}

#[test]
fn a_file_is_not_written_under_the_name_of_another_kind() {
    let tiny = Tiny::new();
    tiny.write("x.csv", "species,x,y\naspen,1,2\n");
    refused(&tiny, "render scene --from out -o x.png", &["x.png does not end", "x.exr is right"]);
    refused(&tiny, "plants aspen -o x.obj", &["x.glb is right"]);
    refused(&tiny, "canvas scene -o x.tif", &["x.png is right"]);
    refused(&tiny, "preview x.csv -o x.jpg", &["x.png is right"]);
}

#[test]
fn a_population_with_missing_columns_names_row_and_column() {
    let tiny = Tiny::new();
    tiny.write("x.csv", "species,x,y,vigor\naspen,1,2,1\n");
    refused(&tiny, "quantize x.csv -o q", &["x.csv, row 1, column `age`", "is missing"]);
    tiny.write("x.csv", "species,x,y,age,vigor,height,radius\naspen,1,2,3,1.5,4,1\n");
    refused(
        &tiny,
        "quantize x.csv -o q",
        &["x.csv, row 1, column `vigor`", "1.5", "0 to 1 is right"],
    );
    assert!(!tiny.path("q").exists());
}

#[test]
fn a_folder_in_place_of_a_file_and_the_other_way_round_are_named() {
    let tiny = Tiny::new();
    tiny.write("taken", "a file");
    refused(&tiny, "run scene -o taken", &["taken is a file", "-o"]);
    tiny.edit("\"inputs/ground.asc\"", "\"inputs\"");
    let line = line_of(&tiny, "\"inputs\"");
    refused(&tiny, "check scene", &[&line, "is a folder", "terrain.source"]);
}

#[test]
fn two_views_of_one_name_are_told_at_the_second() {
    let tiny = Tiny::new();
    let scene = tiny.read("scene/scene.toml");
    let twin = "\n[[view]]\nstand_at = [1, 1]\nlook_at = [9, 9]\nname = \"bank\"\n";
    tiny.write("scene/scene.toml", &format!("{scene}{twin}"));
    let line = scene.matches('\n').count() + 5;
    refused(&tiny, "check scene", &[&format!("scene.toml:{line}:"), "two views are called"]);
}

#[test]
fn windows_and_tolerances_that_make_no_sense_are_refused() {
    let tiny = Tiny::new();
    tiny.write("x.csv", "x,y\n-1,2\n3,-4\n5,6\n");
    refused(&tiny, "analyze x.csv --window 0,0,1", &["4 numbers"]);
    refused(&tiny, "analyze x.csv --window 0,0,nan,1", &["4 numbers"]);
    refused(&tiny, "compare x.csv x.csv --tolerance nan", &["at least 0"]);
    refused(&tiny, "compare x.csv x.csv --tolerance -1", &["at least 0"]);
    let answer = tiny.done("analyze x.csv --window -10,-10,10,10 --json");
    assert!(answer.out.contains("400"), "{}", answer.out);
}

#[cfg(target_os = "linux")]
#[test]
fn output_that_nobody_reads_or_that_does_not_fit_causes_no_panic() {
    let tiny = Tiny::new();
    let weald = env!("CARGO_BIN_EXE_weald");
    let shell = |script: &str| {
        let mut command = std::process::Command::new("sh");
        command.args(["-c", script]).current_dir(tiny.path(""));
        let output = command.output().expect("a shell");
        (output.status.code(), String::from_utf8_lossy(&output.stderr).into_owned())
    };
    // A report cut short is an error; a reader that has read enough is none.
    let (code, told) = shell(&format!("{weald} schema >/dev/full"));
    assert!(code == Some(2) && told.contains("stdout"), "{code:?} {told}");
    let (code, told) = shell(&format!("{weald} schema | head -1 >/dev/null"));
    assert!(code == Some(0) && told.is_empty(), "{code:?} {told}");
    // What goes wrong on stderr can be told nowhere.
    assert_eq!(shell(&format!("{weald} run scene -o out 2>/dev/full")).0, Some(0));
    assert_eq!(shell(&format!("{weald} check nothing 2>/dev/full")).0, Some(2));
    assert_eq!(shell(&format!("{weald} run scene -o out2 2>&- >&- <&-")).0, Some(0));
}

#[cfg(unix)]
#[test]
fn a_path_that_is_not_unicode_is_a_path() {
    use std::os::unix::ffi::OsStrExt;
    let tiny = Tiny::new();
    let mut command = std::process::Command::new(env!("CARGO_BIN_EXE_weald"));
    command.args(["run", "scene", "-n", "--json", "-o"]).current_dir(tiny.path(""));
    command.arg(std::ffi::OsStr::from_bytes(b"gr\xfcn"));
    let output = command.output().expect("weald starts");
    assert_eq!(output.status.code(), Some(0), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(serde_json::from_slice::<serde_json::Value>(&output.stdout).is_ok());
}

#[test]
fn an_object_stands_in_the_picture_and_its_mistakes_are_told() {
    let tiny = Tiny::new();
    tiny.done("plants oak --age 8 -o scene/inputs/oak.glb");
    tiny.done("run scene -o out");
    let scene = tiny.read("scene/scene.toml");
    let with = |object: &str| tiny.write("scene/scene.toml", &format!("{scene}\n{object}"));
    // Right before the eye.
    let oak = "[[object]]\nmodel = \"inputs/oak.glb\"\nat = [26, 6]\nyaw_deg = 30\nscale = 1.5\n";
    with(oak);
    let plan = tiny.done("run scene -o out -n").out;
    assert_eq!(plan.matches("up to date").count(), 4, "{plan}");
    tiny.done("run scene -o with");
    assert_eq!(tiny.weald("compare out/image.png with/image.png").code, 1);
    with(&oak.replace("[26, 6]", "[2600, 6]"));
    let line = line_of(&tiny, "\"inputs/oak.glb\"");
    refused(&tiny, "run scene -o with", &[&line, "object[0].at", "0, 0 to 64, 64"]);
    with(&oak.replace("oak.glb", "aok.glb"));
    refused(&tiny, "check scene", &["aok.glb", "did you mean `oak.glb`?"]);
}

#[test]
fn ages_beyond_any_plant_are_refused_where_they_stand() {
    let tiny = Tiny::new();
    let table = "species,x,y,age,vigor,height,radius\naspen,1,2,1e30,1,4,1\n";
    tiny.write("scene/inputs/field.csv", table);
    let words = ["field.csv, row 1, column `age`", "100000"];
    refused(&tiny, "quantize scene/inputs/field.csv -o q", &words);
    tiny.edit(
        "[quantize]",
        "[[ecosim.step]]\nkind = \"place\"\nplants = \"inputs/field.csv\"\n[quantize]",
    );
    let line = line_of(&tiny, "\"inputs/field.csv\"");
    refused(&tiny, "check scene", &[&line, words[0], words[1]]);
}

#[test]
fn pictures_of_other_sizes_are_told_by_their_sizes() {
    let tiny = Tiny::new();
    tiny.done("run scene -o a");
    tiny.done("run scene -o b --set render.resolution=[16,9]");
    let answer = tiny.weald("compare a/image.exr b/image.exr");
    assert_eq!(answer.code, 1);
    assert_eq!(answer.out, "sizes: 32 x 18 against 16 x 9\ndifferent\n");
    // A folder of a scene is told by its scene.
    assert!(tiny.done("info scene").out.contains("species planted"));
    // Folders of output files are made.
    tiny.done("export a/population.parquet -o new/folder/plants.csv");
    tiny.done("preview a/image.exr -o new/picture/image.png");
    // What was painted is kept, and told so.
    tiny.done("canvas scene -o new/nettle.png");
    assert!(tiny.done("canvas scene -o new/nettle.png").out.starts_with("kept "));
}

#[test]
fn damaged_images_and_models_are_all_told_before_any_work() {
    let tiny = Tiny::new();
    tiny.write("scene/inputs/half.png", "no picture");
    tiny.write("scene/inputs/half.glb", "no model");
    tiny.edit("inputs/density.asc", "inputs/half.png");
    let scene = tiny.read("scene/scene.toml");
    let object = "[[object]]\nmodel = \"inputs/half.glb\"\nat = [1, 1]\n";
    tiny.write("scene/scene.toml", &format!("{scene}\n{object}"));
    let lines = [line_of(&tiny, "\"inputs/half.png\""), line_of(&tiny, "\"inputs/half.glb\"")];
    for command in ["check scene", "run scene -o out"] {
        refused(&tiny, command, &[&lines[0], &lines[1], "ecosim.step[1].density", "2 problems"]);
    }
    assert!(!tiny.path("out/terrain").exists());
}

#[test]
fn a_density_on_another_map_is_named_with_both_maps() {
    let tiny = Tiny::new();
    // Grids in degrees come to the UTM zone of their middle.
    let ground = |west: f64| {
        let header = format!("ncols 8\nnrows 8\nxllcorner {west}\nyllcorner 40\ncellsize 0.0001\n");
        header + &"1 2 3 4 5 6 7 8\n".repeat(8)
    };
    tiny.edit("[[terrain.op]]\nop = \"lake\"\nat = [32.0, 32.0]\nlevel = 9.2\n", "");
    tiny.write("scene/inputs/ground.asc", &ground(-105.0));
    tiny.done("terrain scene -o other");
    std::fs::copy(tiny.path("other/altitude.tif"), tiny.path("scene/inputs/density.tif")).unwrap();
    tiny.write("scene/inputs/ground.asc", &ground(-99.0));
    tiny.edit("inputs/density.asc", "inputs/density.tif");
    let line = line_of(&tiny, "\"inputs/density.tif\"");
    let words = [&line, "EPSG:32613", "EPSG:32614", "gdalwarp -t_srs EPSG:32614"];
    refused(&tiny, "run scene -o out", &words);
    assert!(!tiny.path("out/ecosim").exists());
}
