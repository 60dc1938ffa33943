//! Bad input: each mistake is told at its own place, with what would be right.

mod world;

use weald_contract::{FromToml, Population, Problems, Value};
use weald_ecosim::Config;
use world::{HERB, World, config, plain};

fn world() -> World {
    plain(40, 1.0).with_species("herb", HERB).with_image("all.png", 40, 40, |_, _| 1.0)
}

fn told(steps: &str, message: &str, at: &str) {
    let (problem, place) = world().mistake(steps);
    assert!(problem.contains(message), "{problem}");
    assert_eq!(place, at, "{problem}");
}

const HALFTONE: &str = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\n";

#[test]
fn an_unknown_species_is_pointed_at_with_the_one_meant() {
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"hreb\"\nper_m2 = 1";
    told(steps, "unknown species `hreb`; did you mean `herb`?", "\"hreb\"");
}

#[test]
fn an_unknown_layer_is_pointed_at_inside_its_formula() {
    let steps = format!("{HALFTONE}formula = \"2 * soil_moistur + 1\"");
    told(&steps, "unknown layer `soil_moistur`; did you mean `soil_moisture`?", "soil_moistur");
    let steps = format!("{HALFTONE}formula = \"1 - crown_shadow('aspen')\"");
    let parsed = Config::from_toml(&Value::parse(0, &steps).unwrap(), &mut Problems::new());
    if parsed.is_some() {
        told(&steps, "unknown species `aspen`", "crown_shadow('aspen')");
    }
}

#[test]
fn an_image_of_another_size_is_refused() {
    let world = world().with_image("wide.png", 80, 40, |_, _| 1.0);
    let steps = format!("{HALFTONE}density = \"wide.png\"\nper_m2 = 1");
    let (problem, at) = world.mistake(&steps);
    assert!(problem.contains("a density image of another size: 80 x 40 pixels"), "{problem}");
    assert_eq!(at, "\"wide.png\"");
}

#[test]
fn a_density_that_is_no_number_is_refused_where_it_is() {
    let world =
        world().with_image("hole.png", 40, 40, |c, r| if c + r == 9 { f32::NAN } else { 1.0 });
    let steps = format!("{HALFTONE}density = \"hole.png\"\nper_m2 = 1");
    let (problem, at) = world.mistake(&steps);
    assert!(problem.contains("NaN at column 9, row 0"), "{problem}");
    assert_eq!(at, "\"hole.png\"");
    told(&format!("{HALFTONE}formula = \"ln(x - 20)\""), "has no value at", "\"ln(x - 20)\"");
    let infinite = format!("{HALFTONE}formula = \"1 / (x * 0)\"");
    told(&infinite, "infinite density", "\"1 / (x * 0)\"");
}

#[test]
fn more_than_one_plant_a_cell_is_refused_with_the_cell_that_fits() {
    let steps = format!("{HALFTONE}per_m2 = 25\ncell = 0.5");
    told(
        &steps,
        "more than one in a cell of 0.5 m; leave `cell` out, or make it at most 0.2",
        "0.5",
    );
}

#[test]
fn a_halftone_without_density_and_an_image_without_scale_are_refused() {
    told(HALFTONE, "says nowhere how dense", "\"herb\"");
    told(&format!("{HALFTONE}density = \"all.png\""), "give `per_m2`", "\"all.png\"");
    told(&format!("{HALFTONE}per_m2 = 1\narrange = \"grid\""), "give `cell`", "\"herb\"");
}

#[test]
fn an_absurd_number_of_plants_is_refused_before_any_work() {
    let steps = format!("max_plants = 1000\n{HALFTONE}per_m2 = 9999");
    let (problem, _) = world().mistake(&steps);
    assert!(problem.contains("1599840") && problem.contains("allows 1000"), "{problem}");
    let steps = format!("max_plants = 1000\n{HALFTONE}per_m2 = 1\ncell = 0.01\narrange = \"grid\"");
    assert!(world().mistake(&steps).0.contains("max_plants"));
    let weed = "size = { height = 1, crown_radius = 1 }\necology = { seedlings = 1000000 }";
    let world = world().with_species("weed", weed);
    let years = "[[step]]\nkind = \"simulate\"\nspecies = [\"weed\"]\nyears = 9";
    let (problem, _) = world.mistake(&format!("max_plants = 1000\n{years}"));
    assert!(problem.contains("the seeds of one year would bring the plants to 160000"));
    let (problem, _) = world.mistake(&format!("max_plants = 200000\n{years}\ninitial = 300000"));
    assert!(problem.contains("sowing `initial` plants"), "{problem}");
}

#[test]
fn a_cell_larger_than_the_terrain_holds_nothing_on_a_grid() {
    let steps = format!("{HALFTONE}per_m2 = 1\ncell = 100\narrange = \"grid\"");
    assert!(world().grow(&steps).unwrap().population.is_empty());
}

#[test]
fn zero_years_and_species_without_ecology_are_refused() {
    let steps = "[[step]]\nkind = \"simulate\"\nspecies = [\"herb\"]\nyears = 0";
    let mut problems = Problems::new();
    assert!(Config::from_toml(&Value::parse(0, steps).unwrap(), &mut problems).is_none());
    assert!(problems[0].to_string().contains("allowed: 1 to 100000"));
    let steps = steps.replace("years = 0", "years = 1");
    told(&steps, "species `herb` has no `[ecology]`", "\"herb\"");
    let steps = "[[step]]\nkind = \"simulate\"\nspecies = []\nyears = 7";
    told(steps, "this simulation has no species", "7");
}

#[test]
fn plants_placed_in_water_or_off_the_terrain_are_refused_at_their_point() {
    let world = world().with_pond(20.0, 20.0, 5.0, 0.4);
    let steps = "[[step]]\nkind = \"place\"\nspecies = \"herb\"\nat = [[1, 2], [20, 21]]";
    let (problem, at) = world.mistake(steps);
    assert!(
        problem.contains("the water is 0.40 m deep") && problem.contains("0 to 0 m"),
        "{problem}"
    );
    assert_eq!(at, "[20, 21]");
    let (problem, at) = world.mistake(&steps.replace("21", "41"));
    assert!(problem.contains("off the terrain") && problem.contains("40, 40"), "{problem}");
    assert_eq!(at, "[20, 41]");
}

#[test]
fn a_table_with_a_bad_plant_is_refused_with_its_row() {
    let mut world = world();
    let good = world.grow(&format!("{HALFTONE}per_m2 = 0.1")).unwrap().population;
    let mut bad: Population = good.clone();
    bad.plants[3].vigor = -1.0;
    world.plants.insert("trees.csv".into(), bad.clone());
    let steps = "[[step]]\nkind = \"place\"\nplants = \"trees.csv\"";
    let (problem, at) = world.mistake(steps);
    assert!(problem.contains("(row 3) of `trees.csv`: vigor must lie"), "{problem}");
    assert_eq!(at, "\"trees.csv\"");
    let error = world.grow_from("", Some(&bad)).unwrap_err().to_string();
    assert!(error.contains("(row 3): vigor"), "{error}");
    // The good table is taken over as it is, on this ground.
    world.plants.insert("trees.csv".into(), good.clone());
    let placed = world.grow(steps).unwrap().population;
    let same = |(a, b): (&weald_contract::Plant, &weald_contract::Plant)| {
        a.x == b.x && a.radius == b.radius && (a.z - 100.0).abs() < 1e-4
    };
    assert!(placed.plants.iter().zip(&good.plants).all(same));
    let mut twins = good.clone();
    twins.plants[1].id = twins.plants[0].id;
    let error = world.grow_from("", Some(&twins)).unwrap_err().to_string();
    assert!(error.contains("two plants have the id"), "{error}");
}

#[test]
fn all_mistakes_of_a_list_of_steps_are_told_at_once() {
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"hreb\"\n\
                 [[step]]\nkind = \"simulate\"\nspecies = [\"herb\", \"herb\"]\nyears = 1";
    let problems = config(steps).check(&world().species, &["altitude"]);
    // Unknown species, no density; no ecology twice, named twice, no soil moisture.
    assert_eq!(problems.len(), 6, "{problems:#?}");
    assert!(problems.iter().all(|problem| problem.span.is_some()));
}

#[test]
fn a_stop_is_heard() {
    struct Stop;
    impl weald_contract::Progress for Stop {
        fn begin(&self, _: &str, _: u64, _: &str) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let world = world();
    let around = weald_ecosim::Surroundings {
        terrain: &world.terrain,
        species: &world.species,
        images: &world.images,
        plants: &world.plants,
        views: &[],
    };
    let steps = config(&format!("{HALFTONE}per_m2 = 1"));
    let stopped = weald_ecosim::grow(&steps, &around, None, world.seed, &Stop);
    assert!(matches!(stopped, Err(weald_ecosim::Error::Cancelled)));
}
