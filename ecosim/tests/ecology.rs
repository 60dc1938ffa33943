//! The simulation: ledgers, invariants, and patterns that competition must lead to.

mod world;

use std::collections::BTreeMap;
use weald_contract::{Plant, State};
use weald_ecosim::{Cause, Outcome};
use world::{HERB, TREE, World, plain};

fn wood(survival: f32) -> World {
    plain(50, 2.0)
        .with_species(
            "aspen",
            &format!("{TREE}\necology = {{ seedlings = 400, survival = {survival} }}"),
        )
        .with_species(
            "willow",
            "size = { height = 9, crown_radius = 2.8, lifespan = 25 }\n\
             ecology = { seedlings = 300, wet_preference = 0.8, survival = 0.5 }",
        )
}

const YEARS: &str = "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\", \"willow\"]\n\
                     years = 40\ninitial = 100";

#[test]
fn the_ledger_closes_for_every_species_and_year() {
    let outcome = wood(0.3).grow(YEARS).unwrap();
    let mut alive: BTreeMap<u16, u64> = BTreeMap::new();
    for row in &outcome.summary {
        let before = alive.get(&row.species).copied().unwrap_or(0);
        assert_eq!(row.alive, before + row.births - row.dominated - row.old, "{row:?}");
        alive.insert(row.species, row.alive);
    }
    assert_eq!(outcome.summary.len(), 2 * 41);
    let counts = outcome.population.counts();
    assert_eq!([alive[&0] as usize, alive[&1] as usize], [counts[0], counts[1]]);
    let deaths = |cause: Cause| outcome.deaths.iter().filter(|d| d.cause == cause).count() as u64;
    assert_eq!(deaths(Cause::Dominated), outcome.summary.iter().map(|r| r.dominated).sum::<u64>());
    assert_eq!(deaths(Cause::Old), outcome.summary.iter().map(|r| r.old).sum::<u64>());
    assert!(deaths(Cause::Old) > 0 && deaths(Cause::Dominated) > 0);
}

#[test]
fn every_death_under_a_stronger_plant_names_it() {
    let outcome = wood(0.3).grow(YEARS).unwrap();
    for death in &outcome.deaths {
        assert_eq!(death.killer.is_some(), death.cause == Cause::Dominated);
        assert_ne!(death.killer, Some(death.id));
    }
    let alive = |id| outcome.population.plants.binary_search_by_key(&id, |p: &Plant| p.id).is_ok();
    assert!(outcome.deaths.iter().all(|death| !alive(death.id)));
}

fn ability(world: &World, outcome: &Outcome, plant: &Plant) -> f32 {
    let name = &outcome.population.species[usize::from(plant.species)];
    plant.vigor * plant.radius / world.species[name].0.size.crown_radius
}

#[test]
fn without_survival_no_two_circles_intersect() {
    let mut world = wood(0.0);
    world.species.get_mut("willow").unwrap().1.survival = 0.0;
    for order in ["sync", "greedy"] {
        let outcome = world.grow(&format!("{YEARS}\norder = \"{order}\"")).unwrap();
        let plants = &outcome.population.plants;
        assert!(plants.len() > 100);
        for (i, a) in plants.iter().enumerate() {
            for b in &plants[i + 1..] {
                let (dx, dy) = (a.x - b.x, a.y - b.y);
                let reach = f64::from(a.radius) + f64::from(b.radius);
                // Places are compared relative to the corner: allow that rounding, 1e-9 m.
                assert!((dx * dx + dy * dy).sqrt() > reach - 1e-8, "{a:?} {b:?}");
            }
        }
    }
}

#[test]
fn states_say_who_stands_under_a_stronger_plant() {
    let world = wood(0.9);
    let outcome = world.grow(YEARS).unwrap();
    let plants = &outcome.population.plants;
    let is_under = |a: &Plant| {
        plants.iter().any(|b| {
            let (dx, dy) = (a.x - b.x, a.y - b.y);
            let reach = f64::from(a.radius) + f64::from(b.radius);
            dx * dx + dy * dy < reach * reach
                && ability(&world, &outcome, b) > ability(&world, &outcome, a)
        })
    };
    for plant in plants {
        match plant.state {
            State::Free => assert!(!is_under(plant)),
            // The stronger plant may have died in the same year: all look at the same state.
            State::Dominated => {}
            State::Old => assert!(plant.age >= 25.0),
        }
    }
    assert!(plants.iter().filter(|p| p.state == State::Dominated).count() > 50);
}

#[test]
fn more_survival_leaves_more_plants_and_full_survival_kills_none() {
    let mut counts = Vec::new();
    for survival in [0.0, 0.5, 0.9, 1.0] {
        let mut world = wood(survival);
        world.species.remove("willow");
        let steps = YEARS.replace(", \"willow\"", "");
        let outcome = world.grow(&steps).unwrap();
        counts.push(outcome.population.len());
        if survival == 1.0 {
            assert!(outcome.summary.iter().all(|row| row.dominated == 0));
        }
    }
    assert!(counts.windows(2).all(|pair| pair[0] < pair[1]), "{counts:?}");
}

/// Opposite preferences on soil that grows wetter to the east. By number, seedlings that arrive
/// everywhere would hide the pattern; crown area shows it.
#[test]
fn species_of_opposite_preference_part_along_the_gradient() {
    let species = |preference: f32| {
        format!(
            "size = {{ height = 12, crown_radius = 1.5, lifespan = 200 }}\necology = \
             {{ seedlings = 600, survival = 0.3, wet_preference = {preference}, wet_tolerance = 0.5 }}"
        )
    };
    let mut world =
        plain(50, 1.0).with_species("wet", &species(1.0)).with_species("dry", &species(-1.0));
    let steps = "[[step]]\nkind = \"simulate\"\nspecies = [\"wet\", \"dry\"]\nyears = 150";
    for seed in [1, 2, 3] {
        world.seed = weald_contract::Seed(seed);
        let population = world.grow(steps).unwrap().population;
        // By species, then half: west is dry.
        let mut area = [[0.0f64; 2]; 2];
        for (plant, [x, _]) in population.plants.iter().zip(world.places(&population)) {
            let half = usize::from(x > 25.0);
            area[usize::from(plant.species)][half] += f64::from(plant.radius).powi(2);
        }
        let wet_share = |half: usize| area[0][half] / (area[0][half] + area[1][half]);
        assert!(wet_share(1) > 0.8, "wet half {}", wet_share(1));
        assert!(wet_share(0) < 0.2, "dry half {}", wet_share(0));
    }
}

#[test]
fn plants_that_stand_already_take_part_and_others_are_left_alone() {
    let world = wood(0.3).with_species("herb", HERB);
    let planted = "
        [[step]]
        kind = \"place\"
        species = \"aspen\"
        at = [[50, 50], [51, 50], [10.5, 20]]
        age = [60, 60]
        vigor = [0.9, 1]
        [[step]]
        name = \"herbs\"
        kind = \"halftone\"
        species = \"herb\"
        per_m2 = 0.05
        [[step]]
        name = \"years\"
        kind = \"simulate\"
        species = [\"aspen\", \"willow\"]
        years = 5";
    let outcome = world.grow(planted).unwrap();
    let counts = outcome.population.counts();
    let herb = outcome.population.species.iter().position(|name| name == "herb").unwrap();
    assert_eq!(counts[herb], 500);
    let grown: Vec<&Plant> = outcome.population.plants.iter().filter(|p| p.age == 65.0).collect();
    // Of the two that stand a metre apart one is dominated, which it may survive at 0.3 a year.
    assert!((2..=3).contains(&grown.len()), "{}", grown.len());
    let size = &world.species["aspen"].0.size;
    for plant in grown {
        let radius = size.radius_at(65.0, plant.vigor);
        assert!((plant.radius - radius).abs() < 1e-5 * radius);
    }
}

#[test]
fn growth_agrees_with_the_allometry_of_the_species() {
    let world = wood(0.3);
    let outcome = world.grow(YEARS).unwrap();
    for plant in &outcome.population.plants {
        let name = &outcome.population.species[usize::from(plant.species)];
        let size = &world.species[name].0.size;
        let radius = size.radius_at(plant.age, plant.vigor);
        assert!((plant.radius - radius).abs() <= 1e-5 * radius);
        assert_eq!(plant.height, size.height_at(plant.age, plant.vigor));
        assert!(plant.age <= size.lifespan);
    }
}

#[test]
fn clearing_takes_what_the_disc_and_the_species_single_out() {
    let world = plain(50, 1.0).with_species("herb", HERB).with_species("weed", HERB);
    let steps = "
        [[step]]
        kind = \"halftone\"
        species = \"herb\"
        per_m2 = 1
        [[step]]
        kind = \"halftone\"
        species = \"weed\"
        per_m2 = 1
        [[step]]
        kind = \"clear\"
        species = [\"weed\"]
        disc = [25, 25, 10]
        [[step]]
        kind = \"clear\"
        formula = \"x > 45\"";
    let outcome = world.grow(steps).unwrap();
    let population = &outcome.population;
    for (plant, [x, y]) in population.plants.iter().zip(world.places(population)) {
        assert!(x <= 45.0);
        assert!(plant.species == 0 || (x - 25.0).hypot(y - 25.0) > 10.0);
    }
    assert_eq!(population.len() + outcome.deaths.len(), 5000);
    assert!(outcome.deaths.iter().all(|death| death.cause == Cause::Cleared));
}
