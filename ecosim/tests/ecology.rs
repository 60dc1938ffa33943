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

/// A wood that nothing can shade, so that every seedling lives.
fn mothers(ecology: &str) -> World {
    let text = format!(
        "size = {{ height = 10, rate = 1000, crown_radius = 2, lifespan = 1000 }}\n\
         ecology = {{ survival = 1, wet_tolerance = 100, growth_spread = 0, {ecology} }}"
    );
    plain(50, 2.0).with_species("mother", &text)
}

const ONE_MOTHER: &str = "
    [[step]]
    name = \"mother\"
    kind = \"place\"
    species = \"mother\"
    at = [[50, 50]]
    age = [50, 50]
    vigor = [1, 1]
    [[step]]
    name = \"years\"
    kind = \"simulate\"
    species = [\"mother\"]
    years = 1\n";

#[test]
fn a_mother_bears_by_her_crown_and_her_seeds_fall_about_her() {
    let ecology = "seedlings = 0, seeds = 100, maturity = 50, \
                   dispersal = { kernel = \"gaussian\", scale = 8 }";
    let world = mothers(ecology);
    let population = world.grow(ONE_MOTHER).unwrap().population;
    // 100 seeds from each of 4 π m²; none flies 50 m, which one in e^39 would.
    let children = population.len() - 1;
    assert!((1256..=1257).contains(&children), "{children}");
    let distances = world.places(&population).into_iter().map(|[x, y]| (x - 50.0).hypot(y - 50.0));
    let mean = distances.sum::<f64>() / children as f64;
    // Mean a √π / 2 = 7.0898, deviation a √(1 - π/4) = 3.706.
    assert!((mean - 7.0898).abs() < 5.0 * 3.706 / 1256f64.sqrt(), "{mean}");
    let young = mothers(&ecology.replace("maturity = 50", "maturity = 50.5"));
    assert_eq!(young.grow(ONE_MOTHER).unwrap().population.len(), 1);
}

#[test]
fn seeds_that_fly_over_the_rim_are_lost_but_on_a_torus() {
    let ecology = "seedlings = 0, seeds = 100, dispersal = { kernel = \"uniform\", radius = 300 }";
    let world = mothers(ecology);
    let torus = world.grow(&format!("{ONE_MOTHER}edge = \"torus\"")).unwrap().population;
    assert!((1256..=1257).contains(&(torus.len() - 1)));
    assert!(world.places(&torus).iter().flatten().all(|at| (0.0..=100.0).contains(at)));
    let open = world.grow(ONE_MOTHER).unwrap().population.len() - 1;
    // The square of 100 m is a part 1/(9 π) = 0.0354 of the disc: 44.4 of 1,256.6 seeds.
    assert!((open as f64 - 44.4).abs() < 5.0 * 44.4f64.sqrt(), "{open}");
}

/// With S seeds a year, a bank B that keeps a part d of what does not germinate goes to
/// `B = S (1 - g) d / (1 - (1 - g) d)`, and `g (B + S)` seedlings come up.
#[test]
fn a_bank_of_seeds_goes_to_its_balance_and_is_handed_on() {
    let world = mothers("seedlings = 4000, germination = 0.2, dormancy = 0.5");
    let years = |name: &str, years: u32| {
        format!(
            "[[step]]\nname = \"{name}\"\nkind = \"simulate\"\nspecies = [\"mother\"]\n\
             years = {years}\n"
        )
    };
    let outcome = world.grow(&(years("first", 15) + &years("then", 15))).unwrap();
    let last = outcome.summary.last().unwrap();
    // S = 4,000, g = 0.2, d = 0.5: B = 2,666.7 and 1,333.3 births.
    assert!((last.seeds as f64 - 2666.7).abs() < 5.0 * 2667f64.sqrt(), "{last:?}");
    assert!((last.births as f64 - 1333.3).abs() < 5.0 * 1333f64.sqrt(), "{last:?}");
    // The first year of the second step finds the bank of the first one, and so does not begin
    // with 0.2 · 4,000 = 800 seedlings.
    let first = outcome.summary.iter().find(|row| row.step == 16).unwrap();
    assert!((first.births as f64 - 1333.3).abs() < 5.0 * 1333f64.sqrt(), "{first:?}");
}

#[test]
fn mast_years_come_to_all_plants_at_once() {
    let world = mothers("seedlings = 400, mast = { interval = 4, share = 0.8 }");
    let steps = "[[step]]\nkind = \"simulate\"\nspecies = [\"mother\"]\nyears = 60";
    let outcome = world.grow(steps).unwrap();
    let births = |row: &weald_ecosim::SummaryRow| row.births;
    let births: Vec<u64> = outcome.summary.iter().skip(1).map(births).collect();
    // 400 · 0.8 · 4 = 1,280 in mast years, 400 · 0.2 · 4/3 = 106.7 in others.
    assert!(births.iter().all(|n| (1280..=1281).contains(n) || (106..=107).contains(n)));
    let masts = births.iter().filter(|n| **n > 1000).count();
    // Binomial of 60 and 1/4: 15 with a deviation of 3.4.
    assert!((5..=26).contains(&masts), "{masts}");
}

#[test]
fn seeds_beyond_the_limit_of_plants_are_refused_before_they_fall() {
    let world = mothers("seedlings = 0, seeds = 100000");
    let steps = format!("max_plants = 1000\n{ONE_MOTHER}");
    let error = world.grow(&steps).unwrap_err().to_string();
    assert!(error.contains("the seeds of one year"), "{error}");
}

fn species_of(plants: &[Plant], species: u16) -> impl Iterator<Item = &Plant> + Clone {
    plants.iter().filter(move |plant| plant.species == species)
}

#[test]
fn kept_years_hold_the_plants_of_the_summary_with_their_states() {
    let world = wood(0.8);
    let whole = world.grow(YEARS).unwrap();
    let kept = world.grow(&format!("{YEARS}\nkeep = [40, 0, 7]")).unwrap();
    // To keep years changes nothing else.
    assert!(kept.population == whole.population && kept.summary == whole.summary);
    let steps: Vec<u32> = kept.snapshots.iter().map(|snapshot| snapshot.step).collect();
    assert_eq!(steps, [0, 7, 40]);
    assert_eq!(kept.snapshots[2].population, whole.population);
    for snapshot in &kept.snapshots {
        let plants = &snapshot.population.plants;
        assert!(plants.is_sorted_by_key(|plant| plant.id));
        for row in kept.summary.iter().filter(|row| row.step == snapshot.step) {
            let own = species_of(plants, row.species);
            assert_eq!(own.clone().count() as u64, row.alive);
            let mean = own.clone().map(|p| f64::from(p.radius)).sum::<f64>() / row.alive as f64;
            assert!((f64::from(row.mean_radius) - mean).abs() < 1e-5);
            let areas: Vec<f64> = own.map(|plant| f64::from(plant.radius).powi(2)).collect();
            let pairs = areas.iter().flat_map(|a| areas.iter().map(move |b| (a - b).abs()));
            let (n, sum) = (areas.len() as f64, areas.iter().sum::<f64>());
            let gini = pairs.sum::<f64>() / (2.0 * n * sum);
            assert!((f64::from(row.sizes.gini) - gini).abs() < 1e-5, "{row:?} {gini}");
        }
        for state in [State::Free, State::Dominated] {
            assert!(plants.iter().any(|plant| plant.state == state), "{state:?}");
        }
    }
    // At the start nobody has died yet: a plant is dominated exactly if a stronger one meets it.
    let start = &kept.snapshots[0].population.plants;
    for plant in start.iter().filter(|plant| plant.state != State::Old) {
        let is_under = start.iter().any(|other| {
            let reach = f64::from(plant.radius) + f64::from(other.radius);
            (plant.x - other.x).hypot(plant.y - other.y) < reach
                && ability(&world, &kept, other) > ability(&world, &kept, plant)
        });
        assert_eq!(plant.state == State::Dominated, is_under, "{plant:?}");
    }
}

#[test]
fn two_simulations_that_meet_in_a_kept_year_share_its_table() {
    let world = wood(0.5);
    let steps = "[[step]]\nkind = \"self_thinning\"\nspecies = \"aspen\"\nplants = 300\nsteps = 5\n\
                 radius = [0.1, 2.0]\nkeep = [5]\n\
                 [[step]]\nkind = \"simulate\"\nspecies = [\"willow\"]\nyears = 3\ninitial = 50\n\
                 keep = [0, 3]";
    let outcome = world.grow(steps).unwrap();
    let steps: Vec<u32> = outcome.snapshots.iter().map(|snapshot| snapshot.step).collect();
    assert_eq!(steps, [5, 8]);
    let plants = &outcome.snapshots[0].population.plants;
    assert!(plants.is_sorted_by_key(|plant| plant.id));
    assert!(species_of(plants, 0).count() > 10 && species_of(plants, 1).count() == 50);
    assert_eq!(species_of(&outcome.snapshots[1].population.plants, 0).count(), 0);
}

/// The bell of one layer times that of another is the bell of both, and a terrain without the layer
/// is a mistake in the species.
#[test]
fn vigor_follows_any_layer_of_the_terrain() {
    let text = |layer: &str| {
        format!(
            "{TREE}\n[ecology]\nwet_tolerance = 100\ngrowth_spread = 0\nsurvival = 1\n\
             [[ecology.response]]\nlayer = \"{layer}\"\nbest = [10, 20]\ntolerance = 5\n\
             [[ecology.response]]\nlayer = \"soil_moisture\"\nbest = [0, 1]\ntolerance = 1"
        )
    };
    let mut world = plain(50, 1.0).with_species("tree", &text("insolation"));
    let warmth = (0..2500).map(|i| (i % 50) as f32 + 0.5).collect();
    world.terrain.insert("insolation", "MJ m-2 d-1", "warmer to the east", warmth);
    let steps = "[[step]]\nkind = \"simulate\"\nspecies = [\"tree\"]\nyears = 1\ninitial = 500\n\
                 [[step]]\nkind = \"halftone\"\nspecies = \"tree\"\nper_m2 = 0.1";
    let population = world.grow(steps).unwrap().population;
    assert!(population.len() >= 740);
    for (plant, [x, _]) in population.plants.iter().zip(world.places(&population)) {
        // Bilinear between cell centres, level beyond the outermost.
        let value = x.clamp(0.5, 49.5);
        let off = (10.0 - value).max(value - 20.0).max(0.0) / 5.0;
        let right = (-0.5 * off * off).exp();
        // Moisture, wide as it is, takes up to 0.0000125.
        assert!((f64::from(plant.vigor) - right).abs() < 3e-5, "{x}: {} {right}", plant.vigor);
    }
    let world = plain(50, 1.0).with_species("tree", &text("insolatoin"));
    let message = world.grow(steps).unwrap_err().to_string();
    assert!(message.contains("no layer `insolatoin`"), "{message}");
}
