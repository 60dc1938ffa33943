//! What each command does: arguments to a call of `weald_run`, its result to stdout.

use crate::args::{self, Args, Command, Global, SceneArgs, SchemaOf};
use crate::progress::{Shown, in_words, is_stopped, listen_for_ctrl_c};
use crate::say;
use clap::CommandFactory;
use serde::Serialize;
use serde_json::{Value as Json, json};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::time::{Duration, Instant, SystemTime};
use weald_run::checkpoint::Saving;
use weald_run::make::{EcosimPaths, Made, RenderPaths};
use weald_run::{
    Changes, Error, Plan, Result, Scene, alone, analysis, bench, canvas, check, compare, execute,
    export, info, preview, real, replicates, semantic, specimen, sweep, template, vectors,
};

/// Exit code of a comparison that found a difference.
const DIFFERENT: u8 = 1;

/// Carries out the command.
///
/// # Errors
/// Whatever kept it from being done.
pub fn run(args: &Args) -> Result<ExitCode> {
    let global = &args.global;
    set_threads(global)?;
    match &args.command {
        Command::Run(run) if run.watch => watch(run, global),
        Command::Run(run) => run_once(run, run.draft, global).map(|_| ExitCode::SUCCESS),
        Command::Terrain(terrain) => one_stage(global, |shown| {
            let Some(layers) = layers_flag(&terrain.layers) else {
                return alone::terrain(&load(&terrain.scene, global)?, &terrain.output, shown);
            };
            let mut changes = changes(&terrain.scene, global);
            changes.set.push(layers);
            let scene = Scene::load(&terrain.scene.scene, &changes)?;
            alone::named_layers(&scene, &terrain.output, shown)
        }),
        Command::Ecosim(ecosim) => one_stage(global, |shown| grow(ecosim, global, shown)),
        Command::Quantize(arguments) if arguments.table.is_some() => {
            quantize_table(arguments, global)
        }
        Command::Quantize(arguments) if !arguments.sweep.is_empty() => sweep(arguments, global),
        Command::Quantize(quantize) => {
            one_stage(global, |shown| quantize_alone(quantize, global, shown))
        }
        Command::Plants(args::Plants { action: Some(args::PlantsAction::Edit(edit)), .. }) => {
            edit_tree(edit, global)
        }
        Command::Plants(plants) if plants.check => {
            let report = real::check(plants.from.as_deref(), global.seed.unwrap_or(0))?;
            tell(&report, &report.to_string(), global);
            Ok(match report.outside().next() {
                None => ExitCode::SUCCESS,
                Some(_) => ExitCode::from(DIFFERENT),
            })
        }
        Command::Plants(plants) => one_stage(global, |shown| plants_alone(plants, global, shown)),
        Command::Render(render) => one_stage(global, |shown| render_alone(render, global, shown)),
        Command::New(new) => {
            let files = template::new_scene(&new.folder, new.elevation.as_deref())?;
            tell_files(&files, json!({}), global);
            Ok(ExitCode::SUCCESS)
        }
        Command::Check(check) => {
            let scene = load(&check.scene, global)?;
            let estimate = check::estimate(&scene, false)?;
            tell(&estimate, &format!("{}: nothing wrong\n{estimate}", scene.name), global);
            Ok(ExitCode::SUCCESS)
        }
        Command::Canvas(canvas) => paint(canvas, global),
        Command::Info(info) => tell_all(info, global),
        Command::Compare(compare) => compare_two(compare, global),
        Command::Preview(preview) => draw(preview, global),
        Command::Analyze(analyze) => statistics(analyze, global),
        Command::Export(arguments) if arguments.to.is_some() => {
            one_stage(global, |shown| export_scene(arguments, global, shown))
        }
        Command::Export(arguments) => {
            let options = export::Options { flatten: arguments.flatten };
            export::export(&arguments.file, &arguments.output, options)?;
            tell_files(std::slice::from_ref(&arguments.output), json!({}), global);
            Ok(ExitCode::SUCCESS)
        }
        Command::Bench(arguments) => {
            let figures = bench::bench(&bench::Request {
                quick: arguments.quick,
                only: arguments.only,
                size: arguments.size,
                input: arguments.input.clone(),
                repeat: Some(arguments.repeat),
            })?;
            tell(&figures, &figures.to_string(), global);
            Ok(ExitCode::SUCCESS)
        }
        Command::Completions(completions) => {
            let mut command = Args::command();
            let mut text = Vec::new();
            clap_complete::generate(completions.shell, &mut command, "weald", &mut text);
            say::out(&String::from_utf8_lossy(&text));
            Ok(ExitCode::SUCCESS)
        }
        Command::Man(man) => man_pages(man, global),
        Command::Schema(schema) => {
            let schema = match schema.of {
                SchemaOf::Scene => Scene::json_schema(),
                SchemaOf::Species => weald_run::scene::species_schema(),
            };
            say::out(&format!("{schema:#}\n"));
            Ok(ExitCode::SUCCESS)
        }
    }
}

/// Sets the number of threads for everything; without the flag, all that the process may use.
fn set_threads(global: &Global) -> Result<()> {
    let Some(threads) = global.threads else { return Ok(()) };
    rayon::ThreadPoolBuilder::new().num_threads(threads as usize).build_global().map_err(|error| {
        Error::plain(format!("cannot start {threads} threads: {error}"), "use fewer")
    })
}

fn load(arguments: &SceneArgs, global: &Global) -> Result<Scene> {
    Scene::load(&arguments.scene, &changes(arguments, global))
}

fn changes(arguments: &SceneArgs, global: &Global) -> Changes {
    Changes { set: arguments.set.clone(), seed: global.seed }
}

/// The change of a scene that `--layers` stands for, if it was given.
fn layers_flag(names: &[String]) -> Option<String> {
    let quoted: Vec<String> = names.iter().map(|name| format!("{:?}", name.trim())).collect();
    (!names.is_empty()).then(|| format!("terrain.layers=[{}]", quoted.join(", ")))
}

/// Prints a report: as JSON if asked, else in words unless quiet.
fn tell(report: &impl Serialize, words: &str, global: &Global) {
    if global.json {
        let text = serde_json::to_string_pretty(report).unwrap_or_default();
        say::out(&format!("{text}\n"));
    } else if !global.quiet {
        say::out(words);
    }
}

/// Tells which files were written.
fn tell_files(files: &[PathBuf], report: Json, global: &Global) {
    let names: Vec<String> = files.iter().map(|path| path.display().to_string()).collect();
    let words: String = match names.as_slice() {
        [first, .., last] if names.len() > MAX_FILES_TOLD => {
            format!("wrote {} files, {first} to {last}\n", names.len())
        }
        _ => names.iter().map(|name| format!("wrote {name}\n")).collect(),
    };
    tell(&json!({ "files": names, "report": report }), &words, global);
}

/// Longer lists of files are told by their number.
const MAX_FILES_TOLD: usize = 12;

/// Runs one stage with progress and tells what it left.
fn one_stage(global: &Global, make: impl FnOnce(&Shown) -> Result<Made>) -> Result<ExitCode> {
    listen_for_ctrl_c();
    let shown = Shown::new(global);
    let made = make(&shown)?;
    drop(shown);
    if !global.quiet {
        say::aside(&format!("{}\n", in_words(&made.report)));
        if !made.words.is_empty() {
            say::aside(&format!("{}\n", made.words.trim_end()));
        }
    }
    tell_files(&made.files, made.report, global);
    Ok(ExitCode::SUCCESS)
}

/// The output folder of a run.
fn output_folder(arguments: &args::Run, scene: &Scene) -> PathBuf {
    arguments.output.clone().unwrap_or_else(|| Path::new("out").join(&scene.name))
}

/// `weald run`, once; returns the files that the scene depends on.
fn run_once(arguments: &args::Run, is_draft: bool, global: &Global) -> Result<Vec<PathBuf>> {
    let began = Instant::now();
    let scene = load(&arguments.scene, global)?;
    let out = output_folder(arguments, &scene);
    let plan = Plan::new(&scene, &out, is_draft)?;
    if arguments.dry_run {
        let report = json!({ "out": out.display().to_string(), "plan": plan.steps });
        tell(&report, &plan.to_string(), global);
        return Ok(scene.files());
    }
    if !plan.is_done() {
        check::estimate(&scene, is_draft)?;
    }
    listen_for_ctrl_c();
    let done = execute(&scene, &plan, &Shown::new(global))?;
    let seconds = began.elapsed().as_secs_f64();
    let image = weald_run::Layout { out: out.clone() }.image(is_draft).with_extension("png");
    let words = match plan.is_done() {
        true => format!("{} is up to date\n", out.display()),
        false => format!("{} in {}\n", image.display(), check::seconds_in_words(seconds)),
    };
    tell(
        &json!({
            // A path need not be Unicode, and JSON must.
            "out": out.display().to_string(), "image": image.display().to_string(),
            "seconds": seconds, "stages": done,
        }),
        &words,
        global,
    );
    Ok(scene.files())
}

/// How often the files of a scene are looked at, and how long they must have been quiet: editors
/// write a file in several steps.
const WATCH_INTERVAL: Duration = Duration::from_millis(300);

/// Runs a draft whenever a file of the scene changes, until Ctrl-C.
fn watch(arguments: &args::Run, global: &Global) -> Result<ExitCode> {
    listen_for_ctrl_c();
    let mut files = vec![weald_run::scene::scene_file(&arguments.scene.scene)];
    while !is_stopped() {
        let seen = times(&files);
        match run_once(arguments, true, global) {
            Ok(found) => files = found,
            // A mistake is shown and the next save tried: that is what watching is for.
            Err(error) => crate::show::error(&error),
        }
        let before = if files.len() == seen.len() { seen } else { times(&files) };
        while !is_stopped() && times(&files) == before {
            std::thread::sleep(WATCH_INTERVAL);
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// `weald plants edit`, once or after each save.
fn edit_tree(arguments: &args::EditTree, global: &Global) -> Result<ExitCode> {
    let seed = global.seed.unwrap_or(0);
    let from = arguments.from.clone().map(|species| (species, arguments.age));
    let (side, samples) = (arguments.side, arguments.samples);
    let wanted = semantic::Wanted { seed, from, side, samples };
    let output = arguments.output.as_deref();
    let once =
        || one_stage(global, |shown| semantic::edit(&arguments.script, &wanted, output, shown));
    if !arguments.watch {
        return once();
    }
    listen_for_ctrl_c();
    let files = [PathBuf::from(&arguments.script)];
    while !is_stopped() {
        let seen = times(&files);
        if let Err(error) = once() {
            crate::show::error(&error);
        }
        while !is_stopped() && times(&files) == seen {
            std::thread::sleep(WATCH_INTERVAL);
        }
    }
    Ok(ExitCode::SUCCESS)
}

/// When each file was last changed; a missing one has no time.
fn times(files: &[PathBuf]) -> Vec<Option<SystemTime>> {
    let time = |path: &PathBuf| std::fs::metadata(path).and_then(|data| data.modified()).ok();
    files.iter().map(time).collect()
}

fn grow(arguments: &args::Ecosim, global: &Global, shown: &Shown) -> Result<Made> {
    if arguments.replicates.is_some() || !arguments.sweep.is_empty() {
        let request = replicates::Request {
            scene: arguments.scene.scene.clone(),
            changes: changes(&arguments.scene, global),
            terrain: arguments.terrain.clone(),
            start: arguments.start.clone(),
            replicates: arguments.replicates.unwrap_or(1),
            sweeps: arguments.sweep.clone(),
            keep_plants: arguments.keep_plants,
            folder: arguments.output.clone(),
        };
        return replicates::replicates(&request, shown);
    }
    let scene = load(&arguments.scene, global)?;
    let paths = EcosimPaths {
        terrain: arguments.terrain.clone(),
        start: arguments.start.clone(),
        population: arguments.output.clone(),
        saving: arguments.checkpoint.as_ref().map(|file| Saving {
            file: file.clone(),
            every: Duration::from_secs(arguments.checkpoint_every.into()),
            stop_after: arguments.stop_after,
            is_strict: true,
        }),
    };
    alone::ecosim(&scene, &paths, shown)
}

fn quantize_alone(arguments: &args::Quantize, global: &Global, shown: &Shown) -> Result<Made> {
    let mut set = arguments.set.clone();
    set.extend(arguments.representatives.map(|number| format!("representatives={number}")));
    set.extend(arguments.budget.map(|number| format!("budget={number}")));
    set.extend(arguments.memory_gb.map(|gigabytes| format!("memory_gb={gigabytes:?}")));
    set.extend(arguments.mode.map(|mode| format!("mode={}", mode.word())));
    // The parser asks for both when there is no table.
    let population = arguments.population.as_deref().unwrap_or(Path::new(""));
    let output = arguments.output.as_deref().unwrap_or(Path::new(""));
    let Some(path) = &arguments.scene else {
        let fields = alone::Fields { set, seed: global.seed.unwrap_or(0) };
        return alone::quantize(population, output, &fields, shown);
    };
    let set = set.into_iter().map(|field| format!("quantize.{field}")).collect();
    let scene = Scene::load(path, &Changes { set, seed: global.seed })?;
    alone::quantize_in_scene(&scene, population, arguments.terrain.as_deref(), output, shown)
}

fn sweep(arguments: &args::Quantize, global: &Global) -> Result<ExitCode> {
    listen_for_ctrl_c();
    let mut set = arguments.set.clone();
    set.extend(arguments.mode.map(|mode| format!("mode={}", mode.word())));
    let fields = alone::Fields { set, seed: global.seed.unwrap_or(0) };
    // The parser asks for both when there is no table.
    let population = arguments.population.as_deref().unwrap_or(Path::new(""));
    let output = arguments.output.as_deref().unwrap_or(Path::new(""));
    let shown = Shown::new(global);
    let found = sweep::sweep(population, &arguments.sweep, output, &fields, &shown)?;
    drop(shown);
    tell(&found, &found.to_string(), global);
    Ok(ExitCode::SUCCESS)
}

/// Clusters a table of numbers takes unless it is told: those of a species.
const CLUSTERS: u32 = 8;

fn quantize_table(arguments: &args::Quantize, global: &Global) -> Result<ExitCode> {
    listen_for_ctrl_c();
    let request = vectors::Request {
        table: arguments.table.clone().unwrap_or_default(),
        columns: arguments.columns.clone(),
        weight: arguments.weight.clone(),
        clusters: arguments.representatives.unwrap_or(CLUSTERS) as usize,
        mode: arguments.mode.unwrap_or(vectors::Mode::Fast),
        output: arguments.output.clone(),
    };
    let shown = Shown::new(global);
    let found = vectors::quantize_table(&request, &shown)?;
    drop(shown);
    tell(&found, &found.to_string(), global);
    Ok(ExitCode::SUCCESS)
}

fn plants_alone(arguments: &args::Plants, global: &Global, shown: &Shown) -> Result<Made> {
    let seed = global.seed.unwrap_or(0);
    let (Some(from), Some(output)) = (&arguments.from, &arguments.output) else {
        return Err(Error::plain("nothing to grow", "name a species or a palette, and an output"));
    };
    if let Some(scene) = &arguments.scene {
        let scene = Scene::load(scene, &Changes { set: Vec::new(), seed: global.seed })?;
        return alone::plants_in_scene(&scene, Path::new(from), output, shown);
    }
    let conditions = conditions_of(arguments);
    if alone::is_palette(Path::new(from)) {
        return alone::plants(Path::new(from), output, &conditions, seed, shown);
    }
    let wanted = specimen::Wanted {
        age: arguments.age,
        vigor: arguments.vigor,
        seed,
        count: arguments.count,
        vary: arguments.vary.clone(),
        same: arguments.same,
        conditions,
        pixel: arguments.pixel,
        schematic: arguments.schematic,
        samples: arguments.samples,
        side: arguments.side,
    };
    specimen::plants(from, &wanted, output, shown)
}

fn conditions_of(arguments: &args::Plants) -> specimen::Conditions {
    specimen::Conditions {
        day: arguments.day,
        levels: arguments.levels.clone(),
        textures: !arguments.plain,
        wind: arguments.wind,
        leaf_cards: arguments.leaf_cards,
        twig_cards: arguments.twig_cards,
        shared_twigs: arguments.shared_twigs,
        shared_organs: arguments.shared_organs,
    }
}

fn render_alone(arguments: &args::Render, global: &Global, shown: &Shown) -> Result<Made> {
    let set = |name: &str, value: Option<String>| value.map(|v| format!("render.{name}={v}"));
    let shortcuts = [
        set("samples", arguments.samples.map(|samples| samples.to_string())),
        set("noise", arguments.noise.map(|noise| noise.to_string())),
        set("light", arguments.fast.then(|| "\"direct\"".to_string())),
        set("denoise", arguments.denoise.then(|| "true".to_string())),
        set("view", arguments.view.as_ref().map(|view| format!("{view:?}"))),
    ];
    let mut wanted = arguments.scene.clone();
    wanted.set.extend(shortcuts.into_iter().flatten());
    let scene = load(&wanted, global)?;
    let paths = render_paths(&scene, arguments.from.as_deref(), &arguments.output);
    alone::render(&scene, &paths, arguments.draft, shown)
}

fn export_scene(arguments: &args::Export, global: &Global, shown: &Shown) -> Result<Made> {
    let mut set = arguments.set.clone();
    set.extend(arguments.view.as_ref().map(|view| format!("render.view={view:?}")));
    let scene = load(&SceneArgs { scene: arguments.file.clone(), set }, global)?;
    let paths = render_paths(&scene, arguments.from.as_deref(), &arguments.output);
    let renderer = arguments.to.unwrap_or(export::Renderer::Mitsuba);
    export::scene(&scene, &paths, renderer, &arguments.output, shown)
}

/// Where the files of a run lie that a picture is made from.
fn render_paths(scene: &Scene, from: Option<&Path>, image: &Path) -> RenderPaths {
    let default = || Path::new("out").join(&scene.name);
    let layout = weald_run::Layout { out: from.map_or_else(default, Path::to_path_buf) };
    RenderPaths {
        terrain: layout.terrain(),
        palette: layout.palette(),
        instances: layout.instances(),
        plants: layout.plants(),
        image: image.to_path_buf(),
    }
}

fn paint(arguments: &args::Canvas, global: &Global) -> Result<ExitCode> {
    let scene = load(&arguments.scene, global)?;
    let beside = || scene.folder().join("inputs").join("density.png");
    let density = arguments.output.clone().unwrap_or_else(beside);
    let made = match &arguments.terrain {
        Some(terrain) => canvas::write(&scene, terrain, &density)?,
        None => {
            listen_for_ctrl_c();
            canvas::write_with_new_terrain(&scene, &density, &Shown::new(global))?
        }
    };
    let [width, height] = made.size;
    let (density, guide) = (made.density.display(), made.guide.display());
    let words = match made.is_kept {
        true => format!("kept {density} as it is; wrote {guide} ({width} x {height})\n"),
        false => format!("wrote {density} ({width} x {height}) and {guide}\n"),
    };
    tell(&made, &words, global);
    Ok(ExitCode::SUCCESS)
}

fn tell_all(arguments: &args::Info, global: &Global) -> Result<ExitCode> {
    let found = arguments.paths.iter().map(|path| info::info(path)).collect::<Result<Vec<_>>>()?;
    let words: Vec<String> = found.iter().map(ToString::to_string).collect();
    match found.as_slice() {
        [one] => tell(one, &words.concat(), global),
        _ => tell(&found, &words.join("\n"), global),
    }
    Ok(ExitCode::SUCCESS)
}

fn compare_two(arguments: &args::Compare, global: &Global) -> Result<ExitCode> {
    let found = compare::compare(&arguments.a, &arguments.b, arguments.tolerance)?;
    tell(&found, &found.to_string(), global);
    Ok(ExitCode::from(if found.is_same() { 0 } else { DIFFERENT }))
}

fn draw(arguments: &args::Preview, global: &Global) -> Result<ExitCode> {
    let default = || arguments.file.with_extension("preview.png");
    let to = arguments.output.clone().unwrap_or_else(default);
    preview::write(&arguments.file, arguments.terrain.as_deref(), &to)?;
    tell_files(&[to], json!({}), global);
    Ok(ExitCode::SUCCESS)
}

fn statistics(arguments: &args::Analyze, global: &Global) -> Result<ExitCode> {
    let request = analysis::Request {
        table: arguments.table.clone(),
        species: arguments.species.clone(),
        window: arguments.window,
        statistics: arguments.statistics.clone(),
        radius: arguments.radius,
        steps: arguments.steps as usize,
        radii: arguments.radii.clone(),
        types: arguments.types.clone(),
        marks: arguments.marks.clone(),
        intensity: arguments.intensity.clone(),
        simulations: arguments.simulations as usize,
        patterns: arguments.patterns.clone(),
        seed: global.seed.unwrap_or(0),
        densities: arguments.densities,
        output: arguments.output.clone(),
    };
    listen_for_ctrl_c();
    let shown = Shown::new(global);
    let found = analysis::analyze(&request, &shown)?;
    drop(shown);
    tell(&found, &found.to_string(), global);
    Ok(ExitCode::SUCCESS)
}

/// Writes a page for `weald` and one for each command, from the definitions that parse.
fn man_pages(arguments: &args::Man, global: &Global) -> Result<ExitCode> {
    let mut command = Args::command();
    command.build();
    let Some(folder) = &arguments.output else {
        say::out(&String::from_utf8_lossy(&page(command)));
        return Ok(ExitCode::SUCCESS);
    };
    std::fs::create_dir_all(folder).map_err(|error| Error::system(folder, error))?;
    let mut files = Vec::new();
    for part in command.get_subcommands().chain([&command]) {
        let name = part.get_display_name().unwrap_or(part.get_name());
        let path = folder.join(format!("{name}.1"));
        std::fs::write(&path, page(part.clone())).map_err(|error| Error::system(&path, error))?;
        files.push(path);
    }
    tell_files(&files, json!({}), global);
    Ok(ExitCode::SUCCESS)
}

fn page(command: clap::Command) -> Vec<u8> {
    let mut text = Vec::new();
    // Writing to memory does not fail.
    let _ = clap_mangen::Man::new(command).render(&mut text);
    text
}
