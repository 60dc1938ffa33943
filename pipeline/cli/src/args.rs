//! The command line: one definition for parsing, help, completions and man pages.

use clap::{Args as ClapArgs, Parser, Subcommand, ValueHint};
use std::path::PathBuf;

/// From bare ground to a finished picture of plants.
#[derive(Debug, Parser)]
#[command(name = "weald", version, about, long_about = LONG, after_long_help = EXIT_CODES)]
#[command(subcommand_required = true, arg_required_else_help = true)]
pub struct Args {
    /// What to do.
    #[command(subcommand)]
    pub command: Command,
    /// What all commands share.
    #[command(flatten)]
    pub global: Global,
}

const LONG: &str = "\
Weald turns an elevation model into a path-traced picture of the plants that grow on it.

Five stages pass files along, each open to other programs:

  terrain   elevation model   ->  terrain/*.tif        ground, water, soil moisture
  ecosim    terrain           ->  population.parquet   where which plant grows
  quantize  population        ->  palette.toml,        few models for many plants,
                                  instances.parquet    and where they stand
  plants    palette           ->  plants/*.glb         the models
  render    all of these      ->  image.exr            the picture

`weald run SCENE` makes all that is not up to date. Start with:

  weald new my-scene
  weald run my-scene --draft";

const EXIT_CODES: &str = "\
Exit codes:
  0   done
  1   a comparison found a difference
  2   an error
  75  stopped early with progress saved: run again to go on";

/// Flags that every command takes.
#[derive(Clone, Debug, Default, ClapArgs)]
pub struct Global {
    /// Root of all chance; replaces the scene's `seed`.
    #[arg(long, global = true, value_name = "NUMBER")]
    pub seed: Option<u64>,
    /// Threads to use; the results are the same for any number.
    #[arg(long, global = true, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=4096))]
    pub threads: Option<u32>,
    /// Say nothing but errors.
    #[arg(long, short, global = true)]
    pub quiet: bool,
    /// Say more: every reason, every part of the work.
    #[arg(long, short, global = true)]
    pub verbose: bool,
    /// Print a report on stdout as JSON.
    #[arg(long, global = true)]
    pub json: bool,
}

/// The commands.
#[derive(Debug, Subcommand)]
pub enum Command {
    /// Make everything of a scene that is not up to date.
    Run(Run),
    /// Make a scene's terrain only.
    Terrain(Terrain),
    /// Grow a scene's plants on a terrain.
    Ecosim(Ecosim),
    /// Turn a population into a palette and instances.
    Quantize(Quantize),
    /// Grow plant models: one species, or all of a palette.
    Plants(Plants),
    /// Render a scene from files that are there.
    Render(Render),
    /// Write a new scene to start from.
    New(New),
    /// Find every mistake in a scene, and what a run will take.
    Check(Check),
    /// Write an empty density to paint on, and a map to paint over.
    Canvas(Canvas),
    /// Tell what a file holds and how it came to be.
    Info(Info),
    /// Compare two files or folders; exit code 1 when they differ.
    Compare(Compare),
    /// Draw a PNG of any of our files.
    Preview(Preview),
    /// Point statistics of a population.
    Analyze(Analyze),
    /// Write a file in another form.
    Export(Export),
    /// Measure how fast this machine is at each stage.
    Bench(Bench),
    /// Print completions for a shell.
    Completions(Completions),
    /// Write man pages.
    Man(Man),
    /// Print the JSON Schema of scene or species files.
    Schema(Schema),
}

/// How a scene is named and changed on the command line.
#[derive(Clone, Debug, ClapArgs)]
pub struct SceneArgs {
    /// A scene's folder, or its TOML file.
    #[arg(value_name = "SCENE", value_hint = ValueHint::AnyPath)]
    pub scene: PathBuf,
    /// Change a field for this time: `--set render.samples=16`, `--set ecosim.step[0].years=80`,
    /// `--set species.aspen.ecology.survival=0.5`.
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
}

/// `weald run`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald run scenes/pond                 make what is not up to date, into out/pond
  weald run scenes/pond --draft         a small quick picture, out/pond/image-draft.png
  weald run scenes/pond -n              show what would run, and why
  weald run scenes/pond --set render.samples=64 --set sky.sun_elevation_deg=12
  weald run scenes/pond --watch         draft again whenever a file of the scene is saved")]
pub struct Run {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Output folder [default: out/NAME].
    #[arg(long, short, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub output: Option<PathBuf>,
    /// Show the plan with every reason, and do nothing.
    #[arg(long, short = 'n')]
    pub dry_run: bool,
    /// At most 480 pixels wide and 8 samples, into image-draft.exr; earlier stages are shared
    /// with the full run.
    #[arg(long)]
    pub draft: bool,
    /// Run a draft again whenever a file of the scene is saved; stop with Ctrl-C.
    #[arg(long, conflicts_with = "dry_run")]
    pub watch: bool,
}

/// `weald terrain`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald terrain scenes/pond -o terrain
  weald terrain stack.toml --layers filled,wetness,insolation -o layers

`stack.toml` needs no more than a `[terrain]` table; docs/terrain.md lists the layers.")]
pub struct Terrain {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Write just these layers, separated by commas, instead of a whole terrain.
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub layers: Vec<String>,
    /// Folder for the layers; the preview goes beside it.
    #[arg(long, short, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub output: PathBuf,
}

/// `weald ecosim`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald ecosim scenes/pond --terrain terrain -o population.parquet
  weald ecosim scenes/pond --terrain terrain --start field.csv -o grown.csv

How far do twenty simulations differ, and how do they answer to shade tolerance?
  weald ecosim scenes/pond --terrain terrain --replicates 20 -o runs
  weald ecosim scenes/pond --terrain terrain --replicates 20 -o runs \\
      --sweep species.aspen.ecology.survival=0.1..0.9:5

A long simulation that may be stopped at any time, by Ctrl-C or a reboot:
  weald ecosim scenes/pond --terrain terrain --checkpoint pond.checkpoint -o population.parquet
The same command goes on from what was saved; the files are those of a run without a stop.")]
pub struct Ecosim {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder of the terrain's layers.
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub terrain: PathBuf,
    /// A population to go on from.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub start: Option<PathBuf>,
    /// The population, `.parquet` or `.csv`; of replicates and sweeps, the folder for their tables.
    #[arg(long, short, value_name = "PATH", value_hint = ValueHint::AnyPath)]
    pub output: PathBuf,
    /// Simulate so many times, with the seeds from the scene's upwards, and write how they differ.
    #[arg(long, value_name = "NUMBER", conflicts_with = "checkpoint", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    pub replicates: Option<u32>,
    /// Simulate with each of these values of a field of `ecosim.` or `species.`: `FIELD=0.1..0.9:5`
    /// for five even steps, or `FIELD=1,3,10`. May be given several times: all meet all.
    #[arg(long, value_name = "FIELD=VALUES", conflicts_with = "checkpoint")]
    pub sweep: Vec<weald_run::replicates::Sweep>,
    /// Write the plants of every replicate too, as `plants-0000.parquet` and so on.
    #[arg(long)]
    pub keep_plants: bool,
    /// Save the state of the simulation in this file as it goes, and on Ctrl-C; go on from it if it
    /// is there. It is removed when all is done.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub checkpoint: Option<PathBuf>,
    /// Time from one save to the next, at least.
    #[arg(long, value_name = "SECONDS", default_value_t = 60, requires = "checkpoint", value_parser = clap::value_parser!(u32).range(0..=604_800))]
    pub checkpoint_every: u32,
    /// Save and stop, with exit code 75, after so many simulated years or steps.
    #[arg(long, value_name = "YEARS", requires = "checkpoint", value_parser = clap::value_parser!(u32).range(1..))]
    pub stop_after: Option<u32>,
}

/// `weald quantize`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald quantize population.parquet --representatives 8 -o quantized
  weald quantize population.csv --budget 64 --set mode=best -o quantized
  weald quantize population.parquet --scene scenes/pond -o quantized
  weald quantize population.parquet --sweep 4,16,64,256 -o sweep
  weald quantize --table v.csv --columns a,b,c --weight w -k 64 --mode best -o centres.csv

Without a scene, species are looked for in `species/` beside the population, then in the program.")]
pub struct Quantize {
    /// The plants, `.parquet` or `.csv`.
    #[arg(value_name = "POPULATION", required_unless_present = "table", value_hint = ValueHint::FilePath)]
    pub population: Option<PathBuf>,
    /// Cluster the rows of any table of numbers instead, `.parquet` or `.csv`.
    #[arg(long, value_name = "FILE", conflicts_with_all = ["population", "scene", "budget", "set"], value_hint = ValueHint::FilePath)]
    pub table: Option<PathBuf>,
    /// Columns of the table to compare [default: all of numbers but the weight].
    #[arg(long, value_name = "NAMES", value_delimiter = ',', requires = "table")]
    pub columns: Vec<String>,
    /// Column of the table that says how much a row counts.
    #[arg(long, value_name = "NAME", requires = "table")]
    pub weight: Option<String>,
    /// Take `[quantize]` and species from this scene.
    #[arg(long, value_name = "SCENE", value_hint = ValueHint::AnyPath)]
    pub scene: Option<PathBuf>,
    /// The scene's terrain, when `weights = "view"`: the eye of its view stands on it.
    #[arg(long, value_name = "FOLDER", requires = "scene", value_hint = ValueHint::DirPath)]
    pub terrain: Option<PathBuf>,
    /// Models grown of each species, or clusters of the table.
    #[arg(long, short = 'k', value_name = "NUMBER")]
    pub representatives: Option<u32>,
    /// Models grown in all.
    #[arg(long, value_name = "NUMBER", conflicts_with = "representatives")]
    pub budget: Option<u32>,
    /// As many models as can be rendered with their instances in so much memory; the ground, coarser
    /// levels and the making of the scene come on top.
    #[arg(long, value_name = "GIGABYTES", conflicts_with_all = ["representatives", "budget", "table", "sweep"])]
    pub memory_gb: Option<f64>,
    /// Quantize with each of these numbers of models a species, grow them, and compare their looks
    /// and size: `--sweep 4,16,64`.
    #[arg(long, value_name = "NUMBERS", value_delimiter = ',', conflicts_with_all = ["table", "scene", "representatives", "budget"], value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub sweep: Vec<u32>,
    /// How long to improve: paper, fast, best or exact [default: fast].
    #[arg(long, value_name = "WORD", value_parser = quantize_mode)]
    pub mode: Option<weald_run::vectors::Mode>,
    /// Any field of `[quantize]`: `--set mode=best`.
    #[arg(long, value_name = "FIELD=VALUE")]
    pub set: Vec<String>,
    /// Folder for `palette.toml`, `instances.parquet`, `quantize.json` and two maps: which model
    /// stands where, and how far heights are off. Or the table of centres.
    #[arg(long, short, value_name = "PATH", required_unless_present = "table", value_hint = ValueHint::AnyPath)]
    pub output: Option<PathBuf>,
}

/// A mode of quantization by its word.
fn quantize_mode(word: &str) -> Result<weald_run::vectors::Mode, String> {
    use weald_run::vectors::Mode;
    let found = [Mode::Paper, Mode::Fast, Mode::Best, Mode::Exact]
        .into_iter()
        .find(|mode| mode.word() == word);
    found.ok_or_else(|| "the modes are paper, fast, best and exact".to_string())
}

/// What else `weald plants` does.
#[derive(Debug, clap::Subcommand)]
pub enum PlantsAction {
    /// Make a tree by an edit script, one operation a line.
    #[command(after_long_help = "\
Examples:
  weald plants edit hazel                       counts beside the paper's
  weald plants edit plane -o plane.glb          a model and its portrait
  weald plants edit mine.tree -o mine.png --watch
  weald plants edit prune.tree --from oak --age 60 -o oak.glb

The program has hazel, oak, silver_linden, poplar, ash, beech, maple, birch and plane.
docs/semantic-trees.md describes the operations.")]
    Edit(EditTree),
}

/// `weald plants edit`.
#[derive(Debug, ClapArgs)]
pub struct EditTree {
    /// The script, or the name of one in the program.
    #[arg(value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub script: String,
    /// The model (`.glb`, a `.png` goes beside it) or its picture alone (`.png`); without it the
    /// tree is only counted.
    #[arg(long, short, value_name = "PATH", value_hint = ValueHint::AnyPath)]
    pub output: Option<PathBuf>,
    /// Edit a tree of this species instead of beginning with a trunk.
    #[arg(long, value_name = "SPECIES", value_hint = ValueHint::FilePath)]
    pub from: Option<String>,
    /// Age of that tree, years.
    #[arg(long, default_value_t = 20.0, value_name = "YEARS", requires = "from")]
    pub age: f32,
    /// Run the script again whenever it is saved.
    #[arg(long)]
    pub watch: bool,
    /// Light paths a pixel of the portrait; 0 draws it at once, without light and shadow.
    #[arg(long, default_value_t = 16, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(0..=65_536))]
    pub samples: u32,
    /// Side of the portrait, pixels.
    #[arg(long, default_value_t = 480, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub side: u32,
}

/// `weald plants`.
#[derive(Debug, ClapArgs)]
#[command(args_conflicts_with_subcommands = true, subcommand_negates_reqs = true)]
#[command(after_long_help = "\
Examples:
  weald plants aspen --age 20 --vigor 0.8 -o aspen.glb
  weald plants species/oak.toml --age 90 --day 285 -o oak.glb     in autumn
  weald plants oak --count 20 --vary age=10..80 -o oaks/oak.glb   twenty oaks
  weald plants oak --same --count 8 --vary age=5..200 -o oak.png  one oak through its life
  weald plants oak --schematic -o oak.png                         its branches, black on white
  weald plants palette.toml -o plants
  weald plants --check                                            all presets beside real plants")]
pub struct Plants {
    /// Something else than growing a species.
    #[command(subcommand)]
    pub action: Option<PlantsAction>,
    /// A species file, the name of a species in the program, or a palette.
    #[arg(value_name = "SPECIES|PALETTE", value_hint = ValueHint::FilePath)]
    #[arg(required_unless_present = "check")]
    pub from: Option<String>,
    /// Age of the plant, years.
    #[arg(long, default_value_t = 20.0, value_name = "YEARS")]
    pub age: f32,
    /// Vigor of the plant, 0 to 1.
    #[arg(long, default_value_t = 1.0, value_name = "NUMBER")]
    pub vigor: f32,
    /// How many plants to grow, each by a chance of its own.
    #[arg(long, default_value_t = 1, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub count: u32,
    /// Spread the plants over a range: age=10..80, vigor=0.2..1 or day=90..330; may be repeated.
    #[arg(long, value_name = "RANGE")]
    pub vary: Vec<weald_run::specimen::Vary>,
    /// Grow the same plant again and again instead of others of its kind (with `--vary`).
    #[arg(long)]
    pub same: bool,
    /// Day of the year, 1 to 366: leaves unfold, turn and fall, fruits ripen.
    #[arg(long, value_name = "DAY")]
    pub day: Option<f32>,
    /// Keep only the detail that is seen when a pixel covers this many metres; 0 keeps all.
    #[arg(long, default_value_t = 0.0, value_name = "METRES")]
    pub pixel: f32,
    /// For a palette: write coarser models, too, for pixels of these sizes [for a scene: `levels`
    /// of its `[plants]`].
    #[arg(long, value_name = "METRES,…", value_delimiter = ',')]
    pub levels: Vec<f32>,
    /// Leave bark and leaves without textures.
    #[arg(long)]
    pub plain: bool,
    /// Let the model know how wind moves its branches.
    #[arg(long)]
    pub wind: bool,
    /// Leaves as pictures on cards: fewer triangles, cut out by their coverage.
    #[arg(long)]
    pub leaf_cards: bool,
    /// The thinnest branches with their leaves as pictures on cards.
    #[arg(long)]
    pub twig_cards: bool,
    /// For a palette: so many different twigs a species, each kept once and shared by its models.
    #[arg(long, value_name = "NUMBER", conflicts_with = "twig_cards", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub shared_twigs: Option<u32>,
    /// For a palette: so many different leaves, petals and blades a species, shared by its models
    /// and stretched to each one's size.
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=65_536))]
    pub shared_organs: Option<u32>,
    /// Draw the branches as black cones on white instead of a portrait.
    #[arg(long)]
    pub schematic: bool,
    /// Light paths a pixel of the portrait; 0 draws it at once, without light and shadow.
    #[arg(long, default_value_t = 16, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(0..=65_536))]
    pub samples: u32,
    /// Side of the portrait, pixels.
    #[arg(long, default_value_t = 480, value_name = "PIXELS", value_parser = clap::value_parser!(u32).range(16..=8192))]
    pub side: u32,
    /// Measure the species, or all in the program, beside real plants; nothing is written.
    #[arg(long, conflicts_with_all = ["output", "scene"])]
    pub check: bool,
    /// Take species from this scene (with a palette).
    #[arg(long, value_name = "SCENE", value_hint = ValueHint::AnyPath)]
    pub scene: Option<PathBuf>,
    /// The model (`.glb`, a `.png` goes beside it), its picture alone (`.png`), or a folder for
    /// the models of a palette.
    #[arg(long, short, value_name = "PATH", value_hint = ValueHint::AnyPath)]
    #[arg(required_unless_present = "check")]
    pub output: Option<PathBuf>,
}

/// `weald render`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald render scenes/pond -o image.exr            from the files in out/pond
  weald render scenes/pond -o fine.exr --samples 256 --noise 0.02
  weald render scenes/pond --from elsewhere -o image.exr --set sky.sun_elevation_deg=12")]
pub struct Render {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder that holds terrain/, palette.toml, instances.parquet and plants/ [default: out/NAME].
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub from: Option<PathBuf>,
    /// Light paths a pixel, instead of the scene's.
    #[arg(long, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(1..=65536))]
    pub samples: Option<u32>,
    /// Stop where the noise is this low: 0.02 is clean, 0.1 a good draft; `--samples` is then the most.
    #[arg(long, value_name = "PART")]
    pub noise: Option<f32>,
    /// Light from sun and sky only, dimmed by the leaves on its way: fast, a little too dark in shade.
    #[arg(long)]
    pub fast: bool,
    /// Take the noise out by Open Image Denoise, where it is installed or `WEALD_OIDN` names it.
    #[arg(long)]
    pub denoise: bool,
    /// The view to render, instead of the scene's.
    #[arg(long, value_name = "NAME")]
    pub view: Option<String>,
    /// Small and quick, as in `weald run --draft`.
    #[arg(long)]
    pub draft: bool,
    /// The picture, `.exr`; a tone-mapped `.png` goes beside it.
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: PathBuf,
}

/// `weald new`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald new my-scene
  weald new my-scene --elevation ~/maps/valley.tif")]
pub struct New {
    /// Folder to make.
    #[arg(value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub folder: PathBuf,
    /// Elevation model to stand on; copied into the scene.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub elevation: Option<PathBuf>,
}

/// `weald check`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "Example:\n  weald check scenes/pond")]
pub struct Check {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// `weald canvas`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Example:
  weald canvas scenes/pond -o scenes/pond/inputs/nettle.png

Paint on nettle.png in any paint program, with nettle.guide.png as the layer below, then name it
in a step: density = \"inputs/nettle.png\", per_m2 = 6.0. An existing nettle.png is kept.")]
pub struct Canvas {
    /// The scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// Folder of the terrain's layers; without it the terrain is made for this.
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub terrain: Option<PathBuf>,
    /// The density, `.png` [default: inputs/density.png in the scene's folder].
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Option<PathBuf>,
}

/// `weald info`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald info out/pond/image.exr         what made it, back to the ground
  weald info out/pond/terrain
  weald info out/pond")]
pub struct Info {
    /// Files or folders.
    #[arg(value_name = "PATH", required = true, value_hint = ValueHint::AnyPath)]
    pub paths: Vec<PathBuf>,
}

/// `weald compare`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald compare a.exr b.exr --tolerance 0.01
  weald compare out/pond/terrain other/terrain
  weald compare population.parquet population.csv")]
pub struct Compare {
    /// The first file or folder.
    #[arg(value_name = "A", value_hint = ValueHint::AnyPath)]
    pub a: PathBuf,
    /// The second, of the same kind.
    #[arg(value_name = "B", value_hint = ValueHint::AnyPath)]
    pub b: PathBuf,
    /// Largest difference that counts as equal.
    #[arg(long, default_value_t = 0.0, value_name = "NUMBER", value_parser = tolerance, allow_negative_numbers = true)]
    pub tolerance: f64,
}

/// A tolerance: with one that is no number, nothing would ever be the same.
fn tolerance(word: &str) -> Result<f64, String> {
    let number = word.parse().ok().filter(|number: &f64| *number >= 0.0);
    number.ok_or_else(|| "a number of at least 0 is right".into())
}

/// `weald preview`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald preview out/pond/terrain -o terrain.png
  weald preview population.csv --terrain out/pond/terrain -o dots.png
  weald preview anything.glb -o plant.png")]
pub struct Preview {
    /// A terrain, raster, population, plant model or picture.
    #[arg(value_name = "FILE", value_hint = ValueHint::AnyPath)]
    pub file: PathBuf,
    /// Terrain to draw a population on.
    #[arg(long, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub terrain: Option<PathBuf>,
    /// The picture [default: FILE with the ending .preview.png].
    #[arg(long, short, value_name = "FILE", value_hint = ValueHint::FilePath)]
    pub output: Option<PathBuf>,
}

/// `weald analyze`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Statistics:
  K    further points within r of a point      L    sqrt(K / pi), which is r at random
  G    distance to the nearest neighbour       F    distance from anywhere to a point
  J    (1 - G) / (1 - F)                       pcf  density at r over the mean density

Examples:
  weald analyze population.parquet -o statistics
  weald analyze stems.csv --window 0,0,200,200 --statistics L,pcf --simulations 199 -o statistics
  weald analyze stems.csv --types species --marks dbh_cm -o statistics
  weald analyze stems.csv --patterns run1.csv run2.csv -o statistics     against a simulation
  weald analyze summary.csv -o statistics                the self-thinning line")]
pub struct Analyze {
    /// Points (columns x and y in metres), the summary of a simulation, or a stand's history
    /// (columns density and mean_area).
    #[arg(value_name = "TABLE", value_hint = ValueHint::FilePath)]
    pub table: PathBuf,
    /// Only plants of this species.
    #[arg(long, value_name = "NAME")]
    pub species: Option<String>,
    /// Window as west,south,east,north, m [default: the extent of the points].
    #[arg(long, value_name = "W,S,E,N", allow_hyphen_values = true, value_parser = numbers::<4>)]
    pub window: Option<[f64; 4]>,
    /// Statistics: K, L, G, F, J, pcf [default: K,L,G,pcf].
    #[arg(long, value_name = "NAMES", value_delimiter = ',')]
    pub statistics: Vec<String>,
    /// Largest distance, m [default: a quarter of the window's shorter side, or 1,000 neighbours].
    #[arg(long, value_name = "METRES", allow_negative_numbers = true)]
    pub radius: Option<f64>,
    /// Number of distances.
    #[arg(long, default_value_t = 128, value_name = "NUMBER", value_parser = clap::value_parser!(u32).range(2..=100_000))]
    pub steps: u32,
    /// A table whose column r holds the distances, in place of --radius and --steps.
    #[arg(long, value_name = "FILE", value_hint = ValueHint::FilePath, conflicts_with_all = ["radius", "steps"])]
    pub radii: Option<PathBuf>,
    /// Column of types; adds statistics from each type to each other one.
    #[arg(long, value_name = "COLUMN")]
    pub types: Option<String>,
    /// Column of marks, such as diameters; adds the mark correlation.
    #[arg(long, value_name = "COLUMN")]
    pub marks: Option<String>,
    /// Column or raster of plants per area; adds K relative to it.
    #[arg(long, value_name = "COLUMN|FILE", value_hint = ValueHint::FilePath)]
    pub intensity: Option<String>,
    /// Simulations of randomness for envelopes and verdicts; 199 are good.
    #[arg(long, value_name = "NUMBER", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=100_000))]
    pub simulations: u32,
    /// Tables of points of a null model, in place of points spread at random.
    #[arg(long, value_name = "FILES", num_args = 1.., value_hint = ValueHint::FilePath)]
    pub patterns: Vec<PathBuf>,
    /// Densities between which a thinning line is fitted [default: where cover is level].
    #[arg(long, value_name = "LOW,HIGH", value_parser = numbers::<2>)]
    pub densities: Option<[f64; 2]>,
    /// Folder for tables and figures; without it only a summary is printed.
    #[arg(long, short, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub output: Option<PathBuf>,
}

/// So many numbers with commas between them.
fn numbers<const N: usize>(text: &str) -> Result<[f64; N], String> {
    let number = |part: &str| part.trim().parse::<f64>().ok().filter(|number| number.is_finite());
    let found: Option<Vec<f64>> = text.split(',').map(number).collect();
    let found: Option<[f64; N]> = found.and_then(|numbers| numbers.try_into().ok());
    found.ok_or_else(|| format!("{N} numbers with commas between them are right"))
}

/// `weald export`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Examples:
  weald export plants/0003.glb --flatten -o aspen.glb    for viewers without instancing
  weald export population.parquet -o population.csv
  weald export scenes/pond --to mitsuba -o pond          from the files in out/pond
  mitsuba pond/scene.xml                                 writes pond/scene.exr")]
pub struct Export {
    /// A plant model, a table, or a scene with `--to`.
    #[arg(value_name = "FILE|SCENE", value_hint = ValueHint::AnyPath)]
    pub file: PathBuf,
    /// Write every leaf as triangles of its own.
    #[arg(long)]
    pub flatten: bool,
    /// Write a scene for another renderer: mitsuba.
    #[arg(long, value_name = "RENDERER", conflicts_with = "flatten", value_parser = renderer)]
    pub to: Option<weald_run::export::Renderer>,
    /// Folder that holds terrain/, palette.toml, instances.parquet and plants/ [default: out/NAME].
    #[arg(long, value_name = "FOLDER", requires = "to", value_hint = ValueHint::DirPath)]
    pub from: Option<PathBuf>,
    /// The view of the camera, instead of the scene's.
    #[arg(long, value_name = "NAME", requires = "to")]
    pub view: Option<String>,
    /// Change a field of the scene for this time: `--set sky.sun_elevation_deg=12`.
    #[arg(long, value_name = "FIELD=VALUE", requires = "to")]
    pub set: Vec<String>,
    /// The file to write, whose ending chooses the form, or the folder of a scene.
    #[arg(long, short, value_name = "PATH", value_hint = ValueHint::AnyPath)]
    pub output: PathBuf,
}

/// A renderer by its word.
fn renderer(word: &str) -> Result<weald_run::export::Renderer, String> {
    use weald_run::export::Renderer;
    let found = [Renderer::Mitsuba].into_iter().find(|renderer| renderer.word() == word);
    found.ok_or_else(|| "mitsuba is the one there is".to_string())
}

/// `weald bench`.
#[derive(Debug, ClapArgs)]
#[command(
    after_long_help = "Examples:\n  weald bench --json > bench.json\n  weald bench --only terrain --input dem.tif --repeat 1"
)]
pub struct Bench {
    /// Smaller inputs: about five seconds in all.
    #[arg(long)]
    pub quick: bool,
    /// Measure one stage only: terrain, ecosim, quantize, plants or render.
    #[arg(long, value_name = "STAGE", value_parser = stage)]
    pub only: Option<weald_run::Stage>,
    /// Size of that stage's input: cells along a side, plants, rows, trees to grow, trees to see.
    #[arg(long, value_name = "NUMBER", requires = "only", value_parser = clap::value_parser!(u32).range(1..=100_000_000))]
    pub size: Option<u32>,
    /// Measure that stage on a file: an elevation model, a table of x, y, radius, or of numbers.
    #[arg(long, value_name = "FILE", requires = "only", value_hint = ValueHint::FilePath)]
    pub input: Option<PathBuf>,
    /// Runs of which the fastest counts.
    #[arg(long, value_name = "NUMBER", default_value_t = 3, value_parser = clap::value_parser!(u32).range(1..=1000))]
    pub repeat: u32,
}

/// A stage by its one word.
fn stage(word: &str) -> Result<weald_run::Stage, String> {
    let found = weald_run::Stage::ALL.into_iter().find(|stage| stage.word() == word);
    found.ok_or_else(|| "the stages are terrain, ecosim, quantize, plants and render".to_string())
}

/// `weald completions`.
#[derive(Debug, ClapArgs)]
#[command(
    after_long_help = "Example:\n  weald completions bash > ~/.local/share/bash-completion/completions/weald"
)]
pub struct Completions {
    /// The shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// `weald man`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "Example:\n  weald man -o ~/.local/share/man/man1")]
pub struct Man {
    /// Folder for one page a command; without it the main page goes to stdout.
    #[arg(long, short, value_name = "FOLDER", value_hint = ValueHint::DirPath)]
    pub output: Option<PathBuf>,
}

/// `weald schema`.
#[derive(Debug, ClapArgs)]
#[command(after_long_help = "\
Example:
  weald schema scene > scene.schema.json

Editors that know TOML (for instance with taplo) then complete and check scenes while you type.")]
pub struct Schema {
    /// Which file.
    #[arg(value_enum, default_value = "scene")]
    pub of: SchemaOf,
}

/// Files that have a schema.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
pub enum SchemaOf {
    /// `scene.toml`.
    Scene,
    /// `species/NAME.toml`.
    Species,
}
