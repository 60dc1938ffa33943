//! Equal inputs and seed give equal plants: for any threads, and any order of the plants so far.

mod world;

use weald_contract::Population;
use weald_ecosim::Outcome;
use world::{HERB, TREE, World, plain};

fn world() -> World {
    plain(60, 1.0)
        .with_species("herb", &format!("{HERB}\necology = {{}}"))
        .with_species("aspen", &format!("{TREE}\necology = {{ seedlings = 2000 }}"))
        .with_species(
            "meadow",
            "size = { height = 0.3, crown_radius = 0.4 }\n[group]\nside = 0.8\nmember = []",
        )
        .with_image("spots.png", 60, 60, |c, r| ((c * 7 + r * 13) % 10) as f32 / 10.0)
        .with_pond(20.0, 30.0, 8.0, 0.4)
}

const STEPS: &str = "
    [[step]]
    kind = \"simulate\"
    species = [\"aspen\"]
    years = 30
    initial = 200
    [[step]]
    kind = \"halftone\"
    species = \"herb\"
    density = \"spots.png\"
    per_m2 = 9
    formula = \"1 - 0.5 * crown_shadow(\\\"aspen\\\")\"
    [[step]]
    kind = \"halftone\"
    species = \"meadow\"
    arrange = \"grid\"
    per_m2 = 0.7
    [[step]]
    kind = \"relax\"
    species = [\"aspen\"]
    iterations = 2";

fn with_threads(threads: usize, work: impl FnOnce() -> Outcome + Send) -> Outcome {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
    pool.install(work)
}

#[test]
fn one_two_and_three_threads_give_the_same_plants() {
    let world = world();
    let [one, two, three] =
        [1, 2, 3].map(|threads| with_threads(threads, || world.grow(STEPS).unwrap()));
    assert!(one.population.len() > 15_000);
    assert_eq!(one, two);
    assert_eq!(one, three);
}

#[test]
fn seeds_fall_and_wait_alike_for_any_number_of_threads() {
    let text = "ecology = { seedlings = 300, seeds = 1, maturity = 5, germination = 0.4, \
                dormancy = 0.8, mast = {}, dispersal = { kernel = \"wind\", fall = 1 } }";
    let world = plain(60, 2.0).with_species("aspen", &format!("{TREE}\n{text}"));
    let years = "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\"]\nyears = 40";
    let [one, three] = [1, 3].map(|threads| with_threads(threads, || world.grow(years).unwrap()));
    assert!(one.summary.last().unwrap().seeds > 100, "{:?}", one.summary.last());
    assert_eq!(one, three);
}

#[test]
fn the_order_of_the_plants_handed_in_changes_nothing() {
    let world = world();
    let start = world.grow(STEPS).unwrap().population;
    let mut shuffled: Population = start.clone();
    shuffled.plants.sort_by_key(|plant| weald_contract::seed::mix(plant.id));
    assert_ne!(start, shuffled);
    let years = "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\", \"herb\"]\nyears = 4";
    let [a, b] = [start, shuffled].map(|start| world.grow_from(years, Some(&start)).unwrap());
    assert_eq!(a, b);
    assert!(!a.deaths.is_empty());
}

#[test]
fn ids_are_unique_sorted_and_kept_when_other_steps_come_before() {
    let world = world();
    let population = world.grow(STEPS).unwrap().population;
    assert!(population.plants.windows(2).all(|pair| pair[0].id < pair[1].id));
    let named = "[[step]]\nname = \"herbs\"\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 1";
    let alone = world.grow(named).unwrap().population;
    let meadow = "[[step]]\nkind = \"halftone\"\nspecies = \"meadow\"\narrange = \"grid\"\n\
                  per_m2 = 1\n";
    let both = world.grow(&format!("{meadow}{named}")).unwrap().population;
    let herb = both.species.iter().position(|name| name == "herb").unwrap();
    let herbs: Vec<u64> =
        both.plants.iter().filter(|p| usize::from(p.species) == herb).map(|p| p.id).collect();
    assert_eq!(herbs, alone.plants.iter().map(|p| p.id).collect::<Vec<_>>());
}

#[test]
fn extra_columns_follow_their_plants() {
    let world = world();
    let mut start = world.grow(STEPS).unwrap().population;
    let ids = start.plants.iter().map(|p| (p.id % 1000) as f32).collect();
    start.extra.insert("tag".into(), ids);
    let steps = "[[step]]\nkind = \"clear\"\nformula = \"x < 10\"\n\
                 [[step]]\nkind = \"place\"\nspecies = \"herb\"\nat = [[50, 50]]";
    let population = world.grow_from(steps, Some(&start)).unwrap().population;
    let tags = &population.extra["tag"];
    assert_eq!(tags.len(), population.len());
    let new = tags.iter().filter(|tag| tag.is_nan()).count();
    assert_eq!(new, 1);
    let is_own = |(plant, tag): (&weald_contract::Plant, &f32)| {
        tag.is_nan() || *tag == (plant.id % 1000) as f32
    };
    assert!(population.plants.iter().zip(tags).all(is_own));
}
