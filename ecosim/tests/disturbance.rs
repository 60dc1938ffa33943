//! Disturbances strike when, where and whom they should, and the ledger tells of it.

mod world;

use weald_contract::Plant;
use weald_ecosim::{Agent, Cause, Death, Outcome};
use world::{TREE, World, plain};

/// Trees that neither shade nor age kills, one to ten square metres from the start.
fn wood() -> World {
    let ecology =
        "ecology = { seedlings = 0, survival = 1, growth_spread = 0, wet_tolerance = 100 }";
    plain(100, 1.0)
        .with_species("tree", &format!("{TREE}\n{ecology}"))
        .with_species("other", &format!("{TREE}\n{ecology}"))
}

fn grow(world: &World, years: u32, disturbances: &str) -> Outcome {
    let steps = format!(
        "[[step]]\nkind = \"simulate\"\nspecies = [\"tree\", \"other\"]\nyears = {years}\n\
         initial = 1000\nkeep = [0]\n{disturbances}"
    );
    world.grow(&steps).unwrap()
}

fn start(outcome: &Outcome) -> &[Plant] {
    &outcome.snapshots[0].population.plants
}

fn deaths_in(outcome: &Outcome, year: u32) -> Vec<&Death> {
    outcome.deaths.iter().filter(|death| death.step == year).collect()
}

#[test]
fn named_years_kill_the_named_part_and_the_ledger_closes() {
    let world = wood();
    let fire = "[[step.disturbance]]\nagent = \"fire\"\nyears = [2, 5]\nmortality = 0.3";
    let outcome = grow(&world, 6, fire);
    let mut alive = [0u64; 2];
    for row in &outcome.summary {
        let before = alive[usize::from(row.species)];
        assert_eq!(row.alive, before + row.births - row.dominated - row.old - row.disturbed);
        alive[usize::from(row.species)] = row.alive;
        assert_eq!(row.disturbed > 0, [2, 5].contains(&row.step), "{row:?}");
    }
    assert!(outcome.deaths.iter().all(|death| death.cause == Cause::Disturbed(Agent::Fire)));
    assert!(outcome.deaths.iter().all(|death| death.killer.is_none()));
    // Binomial counts of 2,000 and then some 1,400 plants, five standard deviations.
    let first = deaths_in(&outcome, 2).len() as f64;
    assert!((first - 600.0).abs() < 5.0 * (2000.0f64 * 0.21).sqrt(), "{first}");
    let left = 2000.0 - first;
    let second = deaths_in(&outcome, 5).len() as f64;
    assert!((second - 0.3 * left).abs() < 5.0 * (left * 0.21).sqrt(), "{second}");
    assert_eq!(outcome.population.len() as f64, left - second);
}

#[test]
fn chance_brings_one_in_an_interval_of_years() {
    let world = wood();
    let wind = "[[step.disturbance]]\nagent = \"wind\"\ninterval = 4\nmortality = 0.001";
    let years = 2000u32;
    // So few die each time that some live to the end; a year counts when any died or could have.
    let all = "[[step.disturbance]]\nagent = \"wind\"\ninterval = 4\nradius = [0, 0]";
    assert!(grow(&world, 50, all).deaths.is_empty(), "a disc without area strikes nobody");
    let outcome = grow(&world, 40, wind);
    assert!(outcome.population.len() > 1900);
    // Years are drawn from the seed alone, so that they can be counted over many seeds.
    let mut struck = 0u32;
    for seed in 0..years / 40 {
        let mut world = wood();
        world.seed = weald_contract::Seed(u64::from(seed));
        let every = "[[step.disturbance]]\nagent = \"pest\"\ninterval = 4\nmortality = 0.02";
        let outcome = grow(&world, 40, every);
        struck += (1..=40).filter(|year| !deaths_in(&outcome, *year).is_empty()).count() as u32;
    }
    let (n, expected) = (f64::from(years), f64::from(years) / 4.0);
    assert!((f64::from(struck) - expected).abs() < 5.0 * (n * 3.0 / 16.0).sqrt(), "{struck}");
}

#[test]
fn discs_kill_within_and_nobody_without() {
    let world = wood();
    for edge in ["open", "torus"] {
        let wind = format!(
            "edge = \"{edge}\"\n[[step.disturbance]]\nagent = \"wind\"\nyears = [1]\n\
             radius = [20, 20]\ndiscs = 1"
        );
        let outcome = grow(&world, 1, &wind);
        let plants = start(&outcome);
        let (dead, living): (Vec<&Plant>, Vec<&Plant>) =
            plants.iter().partition(|plant| outcome.deaths.iter().any(|d| d.id == plant.id));
        // 2,000 plants on 10,000 m², and a disc of 1,257 m² that an open rim may cut.
        assert!(dead.len() > 50 && dead.len() < 330, "{edge}: {}", dead.len());
        if edge == "torus" {
            let expected = 2000.0 * 0.04 * std::f64::consts::PI;
            assert!((dead.len() as f64 - expected).abs() < 5.0 * expected.sqrt());
        }
        // The dead lie in a disc of that radius: no two are farther apart than its diameter, and
        // nobody lives between two of them that are nearly that far apart.
        let apart = |a: &Plant, b: &Plant| {
            let [dx, dy] = [(a.x - b.x).abs(), (a.y - b.y).abs()]
                .map(|d| if edge == "torus" { d.min(100.0 - d) } else { d });
            dx.hypot(dy)
        };
        let most = dead.iter().flat_map(|a| dead.iter().map(|b| apart(a, b))).fold(0.0, f64::max);
        assert!(most <= 40.0, "{most}");
        for plant in living {
            let near = dead.iter().filter(|other| apart(plant, other) < 8.0).count();
            let around = plants.iter().filter(|other| apart(plant, other) < 8.0).count();
            assert!(near * 10 <= around * 9, "a plant lives in the middle of the disc");
        }
    }
}

#[test]
fn height_species_and_ground_say_who_dies() {
    let world = wood();
    let logging = "[[step.disturbance]]\nagent = \"logging\"\nyears = [1]\nspecies = [\"other\"]\n\
                   height = [0.6, 100]\nmortality = \"if(x < 50, 1, 0)\"";
    let outcome = grow(&world, 1, logging);
    let mut struck = 0;
    for plant in start(&outcome) {
        let is_dead = outcome.deaths.iter().any(|death| death.id == plant.id);
        let is_meant = plant.species == 1 && plant.height >= 0.6 && plant.x - 500_000.0 < 50.0;
        assert_eq!(is_dead, is_meant, "{plant:?}");
        struck += u32::from(is_dead);
    }
    assert!(struck > 100, "{struck}");
    let heights = start(&outcome).iter().filter(|plant| plant.height < 0.6).count();
    assert!(heights > 50, "some are too low: {heights}");
}

#[test]
fn slips_are_told_at_their_place() {
    let world = wood();
    let mistake = |line: &str| {
        let steps = format!(
            "[[step]]\nkind = \"simulate\"\nspecies = [\"tree\"]\nyears = 9\n\
             [[step.disturbance]]\n{line}"
        );
        world.mistake(&steps)
    };
    let (message, at) = mistake("agent = \"fire\"");
    assert!(message.contains("never comes") && at == "\"fire\"", "{message} {at}");
    let (message, at) = mistake("agent = \"fire\"\nyears = [3, 10]");
    assert!(message.contains("year 10 is never reached") && at == "10", "{message} {at}");
    let (message, at) = mistake("agent = \"fire\"\nyears = [3]\nspecies = [\"other\"]");
    assert!(message.contains("takes no part") && at == "\"other\"", "{message} {at}");
    let (message, _) = mistake("agent = \"fire\"\nyears = [3]\nradius = [9, 3]");
    assert!(message.contains("least comes first"), "{message}");
    let (message, at) = mistake("agent = \"fire\"\nyears = [3]\nmortality = \"lava\"");
    assert!(message.contains("unknown layer `lava`") && at == "lava", "{message} {at}");
}
