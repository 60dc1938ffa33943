//! The command on a tiny scene: what runs, what does not, and that files are the same.

mod tiny;

use tiny::{Tiny, bytes_below};

/// The stages that a run worked on, from its JSON report.
fn ran(report: &str) -> Vec<String> {
    let report: serde_json::Value = serde_json::from_str(report).expect("a JSON report");
    let stages = report["stages"].as_array().expect("stages");
    let ran = stages.iter().filter(|stage| stage["ran"] == true);
    ran.map(|stage| stage["stage"].as_str().expect("a word").to_string()).collect()
}

#[test]
fn a_second_run_does_nothing_and_a_change_runs_what_it_touches() {
    let tiny = Tiny::new();
    let first = tiny.done("run scene -o out --json");
    assert_eq!(ran(&first.out), ["terrain", "ecosim", "quantize", "plants", "render"]);
    for file in [
        "terrain/altitude.tif",
        "terrain/soil_moisture.tif",
        "terrain.png",
        "population.parquet",
        "summary.csv",
        "deaths.parquet",
        "population.png",
        "palette.toml",
        "instances.parquet",
        "quantize.json",
        "quantize.png",
        "quantize-error.png",
        "plants/0001.glb",
        "plants.png",
        "image.exr",
        "image.png",
    ] {
        assert!(tiny.path("out").join(file).is_file(), "{file} was not written");
    }
    let before = bytes_below(&tiny.path("out"));
    assert_eq!(ran(&tiny.done("run scene -o out --json").out), Vec::<String>::new());
    assert!(tiny.done("run scene -o out").out.contains("up to date"));
    assert_eq!(before, bytes_below(&tiny.path("out")));

    // The picture's own fields and the light concern nobody else.
    assert_eq!(ran(&tiny.done("run scene -o out --json --set render.samples=3").out), ["render"]);
    for set in ["sky.sun_elevation_deg=20", "view[0].look_at=[30,40]", "view[0].fov_deg=30"] {
        assert_eq!(
            ran(&tiny.done(&format!("run scene -o out --json --set {set}")).out),
            ["render"]
        );
    }
    let all = ran(&tiny.done("run scene -o out --json --set ecosim.step[0].years=14").out);
    assert_eq!(all, ["ecosim", "quantize", "plants", "render"]);
    // Back to the scene as it stands: the same bytes as in the beginning.
    tiny.done("run scene -o out");
    assert_eq!(before, bytes_below(&tiny.path("out")));
}

#[test]
fn the_plan_gives_a_reason_for_each_stage_and_does_nothing() {
    let tiny = Tiny::new();
    let plan = tiny.done("run scene -o out -n");
    assert!(!tiny.path("out").exists());
    insta::assert_snapshot!("plan_from_nothing", plan.out);
    tiny.done("run scene -o out");
    insta::assert_snapshot!("plan_up_to_date", tiny.done("run scene -o out -n").out);
    let plan = tiny.done("run scene -o out -n --set quantize.representatives=3");
    insta::assert_snapshot!("plan_after_a_change", plan.out);
    std::fs::remove_file(tiny.path("out/population.parquet")).expect("it was written");
    insta::assert_snapshot!("plan_after_a_loss", tiny.done("run scene -o out -n").out);
}

#[test]
fn one_thread_and_two_make_the_same_bytes_in_every_file() {
    let tiny = Tiny::new();
    tiny.done("run scene -o one --threads 1");
    tiny.done("run scene -o two --threads 2");
    let (one, two) = (bytes_below(&tiny.path("one")), bytes_below(&tiny.path("two")));
    assert_eq!(one.keys().collect::<Vec<_>>(), two.keys().collect::<Vec<_>>());
    for (name, bytes) in &one {
        assert!(Some(bytes) == two.get(name), "{name} differs");
    }
    assert!(tiny.done("compare one two").out.contains("same"));
}

#[test]
fn a_draft_is_small_has_its_own_name_and_shares_the_stages_before_it() {
    let tiny = Tiny::new();
    tiny.edit("resolution = [32, 18]", "resolution = [1920, 1080]");
    tiny.edit("samples = 2", "samples = 64");
    tiny.done("run scene -o out --draft --set render.resolution=[600,8]");
    let info = tiny.done("info out/image-draft.exr").out;
    assert!(info.contains("480 x 6 pixels"), "{info}");
    let full =
        tiny.done("run scene -o out --json --set render.resolution=[16,9] --set render.samples=1");
    assert_eq!(ran(&full.out), ["render"]);
    assert!(tiny.path("out/image.exr").is_file());
}

#[test]
fn a_killed_run_goes_on_from_what_was_finished() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    let whole = bytes_below(&tiny.path("out"));
    // What a run leaves that was killed while it wrote the plants: no record from there on, a
    // file without its final name, and some of the files.
    std::fs::remove_file(tiny.path("out/.weald/plants.json")).expect("a record");
    std::fs::remove_file(tiny.path("out/.weald/render.json")).expect("a record");
    std::fs::remove_file(tiny.path("out/plants/0002.glb")).expect("a model");
    tiny.write("out/plants/.weald-x.part", "half a mod");
    let report = tiny.done("run scene -o out --json");
    assert_eq!(ran(&report.out), ["plants", "render"]);
    assert!(whole == bytes_below(&tiny.path("out")));
}

#[test]
fn an_output_that_someone_changed_is_made_again() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    let whole = bytes_below(&tiny.path("out"));
    tiny.write("out/terrain/slope.tif", "not what the stage wrote");
    let plan = tiny.done("run scene -o out -n").out;
    assert!(plan.contains("terrain/slope.tif was changed"), "{plan}");
    tiny.done("run scene -o out");
    assert!(whole == bytes_below(&tiny.path("out")));
    // A palette that shrinks takes the models along that it no longer needs.
    tiny.done("run scene -o out --set quantize.representatives=1");
    assert!(bytes_below(&tiny.path("out/plants")).len() < 8);
    assert!(!tiny.path("out/plants/0008.glb").exists());
}

#[cfg(unix)]
#[test]
fn ctrl_c_keeps_what_was_finished_and_says_so_by_its_exit_code() {
    use std::process::{Command, Stdio};
    let tiny = Tiny::new();
    // More samples than any machine traces in a minute.
    let run = "run scene -o out --set render.samples=65536 --set render.resolution=[640,360]";
    let mut child = Command::new(env!("CARGO_BIN_EXE_weald"))
        .args(run.split(' '))
        .current_dir(tiny.path(""))
        .stderr(Stdio::null())
        .stdout(Stdio::null())
        .spawn()
        .expect("weald starts");
    let began = std::time::Instant::now();
    while !tiny.path("out/.weald/plants.json").exists() {
        assert!(began.elapsed().as_secs() < 60, "the stages before the picture take seconds");
        std::thread::sleep(std::time::Duration::from_millis(20));
    }
    let kill = Command::new("kill").args(["-INT", &child.id().to_string()]).status();
    assert!(kill.expect("a kill command").success());
    assert_eq!(child.wait().expect("it ends").code(), Some(75));
    assert!(!tiny.path("out/image.exr").exists());
    assert_eq!(ran(&tiny.done("run scene -o out --json").out), ["render"]);
}

#[test]
fn stages_alone_make_the_same_files_as_a_run() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    tiny.done("terrain scene -o alone/terrain");
    tiny.done("ecosim scene --terrain alone/terrain -o alone/population.parquet");
    tiny.done("quantize alone/population.parquet --scene scene -o alone");
    tiny.done("plants alone/palette.toml --scene scene -o alone/plants");
    tiny.done("render scene --from alone -o alone/image.exr");
    for name in [
        "terrain/altitude.tif",
        "population.parquet",
        "palette.toml",
        "plants/0001.glb",
        "image.exr",
    ] {
        let read = |folder: &str| std::fs::read(tiny.path(folder).join(name)).expect(name);
        assert!(read("out") == read("alone"), "{name} differs");
    }
}

#[test]
fn files_tell_their_story_back_to_the_ground() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    let story = tiny.done("info out/image.exr").out;
    for word in
        ["made by render", "made by quantize", "made by ecosim", "made by terrain", "ground.asc"]
    {
        assert!(story.contains(word), "no `{word}` in\n{story}");
    }
    for path in [
        "out",
        "out/terrain",
        "out/terrain/slope.tif",
        "out/population.parquet",
        "out/palette.toml",
        "out/instances.parquet",
        "out/plants",
        "out/plants/0001.glb",
        "out/image.png",
        "out/summary.csv",
        "out/quantize.json",
        "out/population.png",
    ] {
        let answer = tiny.done(&format!("info {path}"));
        assert!(answer.out.contains("made by"), "{path}:\n{}", answer.out);
    }
    let json = tiny.done("info out/image.exr --json").out;
    let json: serde_json::Value = serde_json::from_str(&json).expect("JSON");
    assert_eq!(json["provenance"]["stage"], "render");
}

#[test]
fn a_comparison_that_differs_exits_with_one() {
    let tiny = Tiny::new();
    tiny.done("run scene -o a");
    tiny.done("run scene -o b --seed 4");
    assert_eq!(tiny.weald("compare a/image.exr a/image.exr").code, 0);
    assert_eq!(tiny.weald("compare a/image.exr b/image.exr").code, 1);
    assert_eq!(tiny.weald("compare a/image.exr b/image.exr --tolerance 1e12").code, 0);
    assert_eq!(tiny.weald("compare a/population.parquet b/population.parquet").code, 1);
    assert_eq!(tiny.weald("compare a b").code, 1);
    assert_eq!(tiny.weald("compare a/image.exr a/terrain").code, 1);
    assert_eq!(tiny.weald("compare a/image.exr nowhere.exr").code, 2);
}

#[test]
fn previews_exports_and_canvases_are_written() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    for (file, more) in [
        ("out/terrain", ""),
        ("out/terrain/slope.tif", ""),
        ("out/population.parquet", "--terrain out/terrain"),
        ("out/plants/0001.glb", ""),
        ("out/image.exr", ""),
    ] {
        tiny.done(&format!("preview {file} {more} -o shown.png"));
        assert!(std::fs::read(tiny.path("shown.png")).expect("a PNG").starts_with(b"\x89PNG"));
    }
    tiny.done("export out/population.parquet -o population.csv");
    assert_eq!(tiny.weald("compare population.csv out/population.parquet").code, 0);
    tiny.done("export out/plants/0001.glb --flatten -o flat.glb");
    let flat = std::fs::read(tiny.path("flat.glb")).expect("a GLB");
    assert!(!String::from_utf8_lossy(&flat).contains("EXT_mesh_gpu_instancing"));
    let canvas = tiny.done("canvas scene --terrain out/terrain -o scene/inputs/nettle.png");
    assert!(canvas.out.contains("1024 x 1024"), "{}", canvas.out);
    assert!(tiny.path("scene/inputs/nettle.guide.png").is_file());
    tiny.done("canvas scene");
    assert!(tiny.path("scene/inputs/density.png").is_file());
}

/// Every value of an attribute in an XML text.
fn values<'a>(xml: &'a str, attribute: &str) -> Vec<&'a str> {
    let start = format!("{attribute}=\"");
    xml.split(&start).skip(1).filter_map(|rest| rest.split('"').next()).collect()
}

/// Whether all tags of an XML text without processing instructions are closed in turn.
fn is_well_formed(xml: &str) -> bool {
    let mut open: Vec<&str> = Vec::new();
    let mut rest = xml;
    while let Some((_, from)) = rest.split_once('<') {
        if let Some(comment) = from.strip_prefix("!--") {
            let Some((text, after)) = comment.split_once("-->") else { return false };
            if text.contains("--") {
                return false;
            }
            rest = after;
            continue;
        }
        let Some((tag, after)) = from.split_once('>') else { return false };
        rest = after;
        let name = tag.split([' ', '/']).find(|part| !part.is_empty()).unwrap_or("");
        if tag.matches('"').count() % 2 == 1 || tag.contains(['<', '&']) {
            return false;
        }
        match (tag.starts_with('/'), tag.ends_with('/')) {
            (true, _) if open.pop() != Some(name) => return false,
            (false, false) => open.push(name),
            _ => {}
        }
    }
    open.is_empty() && !rest.contains('>')
}

#[test]
fn a_scene_is_written_for_mitsuba_with_every_file_that_it_names() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    let told = tiny.done("export scene --to mitsuba --from out -o theirs --json --set sky.haze=0");
    let told: serde_json::Value = serde_json::from_str(&told.out).expect("JSON");
    let xml = tiny.read("theirs/scene.xml");
    assert!(is_well_formed(&xml), "{}", &xml[..2000]);
    assert!(!is_well_formed(&xml.replacen("</scene>", "", 1)));
    for file in values(&xml, "filename\" value") {
        assert!(tiny.path("theirs").join(file).is_file(), "{file} is not there");
    }
    let ids = values(&xml, " id");
    assert!(xml.split("<ref id=\"").skip(1).all(|r| ids.contains(&r.split('"').next().unwrap())));
    // What stands in many places is an instance, what stands once a mesh or a few.
    let places = told["report"]["places"].as_u64().expect("a number") as usize;
    let instances = xml.matches("<shape type=\"instance\">").count();
    let groups = xml.matches("<shape type=\"shapegroup\"").count();
    let pieces = told["report"]["pieces"].as_u64().expect("a number") as usize;
    assert_eq!(places - instances, pieces - groups);
    assert!(instances > 20 && groups > 2, "{instances} instances of {groups} groups");
    let aspens = tiny.read("out/palette.toml").matches("species = \"aspen\"").count();
    assert!(groups >= aspens, "{groups} groups, {aspens} aspens");
    assert!(xml.contains("type=\"envmap\"") && xml.contains("id=\"sun\""));

    let before = bytes_below(&tiny.path("theirs"));
    tiny.done("export scene --to mitsuba --from out -o again --threads 1 --set sky.haze=0");
    assert!(before == bytes_below(&tiny.path("again")), "one thread wrote other bytes");

    for (wrong, said) in [
        ("export scene -o x", "--to mitsuba"),
        ("export scene --to povray -o x", "mitsuba"),
        ("export scene --to mitsuba --from nowhere -o x", "nowhere"),
        ("export scene --to mitsuba --from out --view bnak -o x", "bank"),
        ("export scene --to mitsuba --from out -o scene/scene.toml", "is a file"),
        (
            "export scene --to mitsuba --from out --set view[0].projection=\"panorama\" -o x",
            "panorama",
        ),
    ] {
        let answer = tiny.weald(wrong);
        assert_eq!(answer.code, 2, "{wrong}: {}", answer.err);
        assert!(answer.err.contains(said), "{wrong}: {}", answer.err);
    }
}

#[test]
fn a_new_scene_has_nothing_wrong_and_is_not_overwritten() {
    let tiny = Tiny::new();
    tiny.done("new fresh");
    assert!(tiny.done("check fresh").out.contains("nothing wrong"));
    tiny.done("run fresh -o new --set render.resolution=[32,18] --set render.samples=1");
    assert!(tiny.path("new/image.png").is_file());
    assert_eq!(tiny.weald("new fresh").code, 2);
    tiny.done("new placed --elevation scene/inputs/ground.asc");
    tiny.done("check placed");
}

#[test]
fn a_table_of_points_is_analyzed() {
    let tiny = Tiny::new();
    tiny.done("run scene -o out");
    let found =
        tiny.done("analyze out/population.parquet --species aspen -o statistics --steps 16");
    assert!(found.out.contains("Clark-Evans"), "{}", found.out);
    for name in ["K", "L", "G", "pcf"] {
        let table = tiny.read(&format!("statistics/{name}.csv"));
        assert_eq!(table.lines().count(), 17, "{name}: a header and a row a distance");
    }
    let answer = tiny.weald("analyze out/population.parquet --species apsen");
    assert_eq!(answer.code, 2);
    assert!(answer.err.contains("aspen"), "{}", answer.err);
    assert_eq!(tiny.weald("analyze out/deaths.parquet").code, 2);
}

#[test]
fn the_bench_gives_a_figure_for_every_stage() {
    let figures = Tiny::new().done("bench --quick --json").out;
    let figures: serde_json::Value = serde_json::from_str(&figures).expect("JSON");
    let units: Vec<&str> = figures["figures"]
        .as_array()
        .expect("figures")
        .iter()
        .map(|figure| figure["unit"].as_str().expect("a unit"))
        .collect();
    let wanted =
        ["cells/s", "plant-steps/s", "points/s", "s", "triangles/s", "rays/s", "samples/s"];
    assert!(wanted.iter().all(|unit| units.contains(unit)), "{units:?}");
}

#[test]
fn one_plant_is_grown_by_name_at_an_age() {
    let tiny = Tiny::new();
    tiny.done("plants aspen --age 20 --vigor 0.8 -o aspen.glb");
    assert!(tiny.path("aspen.png").is_file());
    assert!(tiny.done("info aspen.glb").out.contains("made by plants"));
    let answer = tiny.weald("plants aspne -o x.glb");
    assert_eq!(answer.code, 2);
    assert!(answer.err.contains("did you mean `aspen`?"), "{}", answer.err);
    assert!(!tiny.path("x.glb").exists());
}

#[test]
fn completions_man_pages_and_schemas_come_from_the_same_definitions() {
    let tiny = Tiny::new();
    assert!(tiny.done("completions bash").out.contains("_weald"));
    assert!(tiny.done("man").out.contains(".TH"));
    tiny.done("man -o man1");
    assert!(tiny.path("man1/weald-run.1").is_file());
    for of in ["scene", "species"] {
        let schema = tiny.done(&format!("schema {of}")).out;
        let schema: serde_json::Value = serde_json::from_str(&schema).expect("JSON");
        assert_eq!(schema["type"], "object");
    }
}

#[test]
fn help_teaches() {
    let tiny = Tiny::new();
    insta::assert_snapshot!("help", tiny.done("--help").out);
    insta::assert_snapshot!("help_run", tiny.done("run --help").out);
}

#[test]
fn a_house_of_either_format_stands_on_ground_that_is_level_under_it() {
    let tiny = Tiny::new();
    let house = "v -3 0 -2\nv 3 0 -2\nv 3 4 2\nv -3 4 2\nf 1 2 3 4\n";
    tiny.write("scene/inputs/house.obj", house);
    tiny.done("plants oak --age 30 -o scene/inputs/oak.glb");
    tiny.done("terrain scene -o plain");
    let scene = tiny.read("scene/scene.toml");
    for model in ["house.obj", "oak.glb"] {
        let place = format!("model = \"inputs/{model}\"\nat = [20, 12]\n");
        let mask = format!("mask.footprint.{}", place.replace('\n', "\nmask.footprint."));
        let mask = mask.trim_end_matches("mask.footprint.");
        let level = format!("[[terrain.op]]\nop = \"flatten\"\naltitude = 14\n{mask}");
        let object = format!("[[object]]\n{place}");
        let ops = scene.replacen("[[terrain.op]]", &format!("{level}\n[[terrain.op]]"), 1);
        tiny.write("scene/scene.toml", &format!("{ops}\n{object}"));
        tiny.done("check scene");
        tiny.done("terrain scene -o level");
        let answer = tiny.weald("compare plain/altitude.tif level/altitude.tif");
        assert_eq!(answer.code, 1, "{}", answer.out);
    }
}

#[test]
fn more_memory_holds_more_models_and_too_little_is_told() {
    let tiny = Tiny::new();
    tiny.done("terrain scene -o terrain");
    tiny.done("ecosim scene --terrain terrain -o plants.parquet");
    let models = |gigabytes: &str, more: &str| -> u64 {
        let command = format!(
            "quantize plants.parquet --scene scene --memory-gb {gigabytes} -o out --json {more}"
        );
        let report = tiny.done(&command).out;
        let report: serde_json::Value = serde_json::from_str(&report).expect("JSON");
        report["report"]["representatives"].as_u64().expect("a number")
    };
    let few = models("0.02", "--threads 1");
    let palette = tiny.read("out/palette.toml");
    assert_eq!(models("0.02", "--threads 2"), few);
    assert_eq!(tiny.read("out/palette.toml"), palette, "the same on any threads");
    assert!(models("0.2", "") > few);
    let refused = tiny.weald("quantize plants.parquet --scene scene --memory-gb 0.001 -o none");
    assert_eq!(refused.code, 2, "{}", refused.err);
    assert!(refused.err.contains("memory_gb") && !tiny.path("none").exists(), "{}", refused.err);
}

/// Grows the models of a palette, and tells what instancing of them saves.
fn instancing(tiny: &Tiny, folder: &str, more: &str) -> serde_json::Value {
    let command = format!("plants out/palette.toml -o {folder} --json {more}");
    let report: serde_json::Value = serde_json::from_str(&tiny.done(&command).out).expect("JSON");
    report["report"]["instancing"].clone()
}

/// A tiny scene with a palette of three models.
fn tiny_palette() -> Tiny {
    let tiny = Tiny::new();
    tiny.done("terrain scene -o terrain");
    tiny.done("ecosim scene --terrain terrain -o plants.parquet");
    tiny.done("quantize plants.parquet --scene scene -k 3 -o out");
    tiny
}

#[test]
fn models_share_leaves_where_they_are_asked_to() {
    let tiny = Tiny::new();
    let plant = |id: u32| {
        format!(
            "[[representative]]\nid = {id}\nspecies = \"ragwort\"\nage = {id}.5\nvigor = 0.{id}\n\
             height = 0.{id}\nradius = 0.1\nweight = 1.0\ncount = 1\n"
        )
    };
    tiny.write("palette.toml", &(1..5).map(plant).collect::<String>());
    let report = |folder: &str, more: &str| -> serde_json::Value {
        let command = format!("plants palette.toml -o {folder} --json {more}");
        let report: serde_json::Value =
            serde_json::from_str(&tiny.done(&command).out).expect("JSON");
        report["report"].clone()
    };
    let own = report("own", "");
    let shared = report("shared", "--shared-organs 1 --threads 1");
    let organs = &shared["organs"]["ragwort"];
    // One of each make: a leaf, a ray and a disk.
    assert!(organs["organs"].as_u64() > Some(8) && organs["shared"] == 3, "{organs}");
    assert_eq!(own["instanced_triangles"], shared["instanced_triangles"], "as much is seen");
    assert!(own["organs"].is_null());
    report("again", "--shared-organs 1 --threads 2");
    for model in ["0001.glb", "0002.glb", "0003.glb", "0004.glb"] {
        let bytes = |folder: &str| std::fs::read(tiny.path(folder).join(model)).expect("a model");
        assert_eq!(bytes("shared"), bytes("again"));
    }
    assert_eq!(tiny.weald("plants palette.toml --shared-organs 0 -o none").code, 2);
}

#[test]
fn models_share_twigs_where_they_are_asked_to() {
    let tiny = tiny_palette();
    let own = instancing(&tiny, "own", "");
    let shared = instancing(&tiny, "shared", "--shared-twigs 4 --threads 1");
    assert_eq!(own["twigs"]["prototypes"], 0);
    assert_eq!(shared["twigs"]["prototypes"], 4, "{shared}");
    let bytes = |levels: &serde_json::Value| levels["bytes"].as_f64().expect("a number");
    assert!(bytes(&shared) < bytes(&own));
    instancing(&tiny, "again", "--shared-twigs 4 --threads 2");
    let bytes = |path: &str| std::fs::read(tiny.path(path)).expect("a model");
    assert_eq!(bytes("shared/0001.glb"), bytes("again/0001.glb"));
    let both = "\n[plants]\nshared_twigs = 4\ntwig_cards = true\n";
    tiny.write("scene/scene.toml", &(tiny.read("scene/scene.toml") + both));
    let refused = tiny.weald("check scene");
    assert!(refused.code == 2 && refused.err.contains("shared_twigs"), "{}", refused.err);
}
