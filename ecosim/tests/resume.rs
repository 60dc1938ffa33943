//! A growth that was stopped goes on to the same plants, and damaged states are refused.

mod world;

use proptest::prelude::*;
use weald_ecosim::{Checkpoint, Error, Outcome};
use world::{HERB, TREE, World, plain};

fn world() -> World {
    let seeds = "ecology = { seedlings = 300, seeds = 1, maturity = 3, germination = 0.4, \
                 dormancy = 0.8, mast = {}, dispersal = { kernel = \"wind\", fall = 1 } }";
    let plots = weald_contract::Population {
        species: vec!["herb".into()],
        plants: [10.0, 30.0, 50.0].map(plot).to_vec(),
        extra: [("count", [3.0, 9.0, 1.0]), ("area", [9.0; 3])]
            .map(|(name, values)| (name.to_string(), values.to_vec()))
            .into(),
        ..Default::default()
    };
    let mut world = plain(30, 2.0)
        .with_species("herb", &format!("{HERB}\necology = {{ seedlings = 4000 }}"))
        .with_species("aspen", &format!("{TREE}\n{seeds}"))
        .with_pond(20.0, 30.0, 8.0, 0.4);
    world.plants.insert("plots.csv".into(), plots);
    world
}

fn plot(along: f64) -> weald_contract::Plant {
    weald_contract::Plant {
        id: along as u64,
        species: 0,
        state: Default::default(),
        x: 500_000.0 + along,
        y: 5_200_030.0,
        z: f32::NAN,
        radius: f32::NAN,
        height: f32::NAN,
        age: f32::NAN,
        vigor: f32::NAN,
        yaw: 0.0,
        lean: 0.0,
        lean_azimuth: 0.0,
    }
}

/// A bit of everything that a state must hold: layers, kept steps, a seed bank, settlers, shade.
const STEPS: &str = "
    [[step]]
    kind = \"plots\"
    plots = \"plots.csv\"
    species = \"herb\"
    layer = \"herbs\"
    [[step]]
    name = \"stand\"
    kind = \"self_thinning\"
    species = \"aspen\"
    plants = 400
    radius = [0.1, 0.4]
    steps = 6
    keep = [0, 3, 6]
    growth = { rate = 0.05, spread = 0.3 }
    [[step]]
    kind = \"halftone\"
    species = \"herb\"
    per_m2 = 0.2
    formula = \"herbs\"
    [[step]]
    kind = \"clear\"
    enabled = false
    [[step]]
    kind = \"simulate\"
    species = [\"aspen\", \"herb\"]
    years = 8
    initial = 30
    keep = [0, 3, 8]
    disturbance = [{ agent = \"wind\", interval = 2, radius = [3, 9], mortality = 0.5 }]
    chance = \"1 - 0.5 * crown_shadow(\\\"aspen\\\")\"
    [[step]]
    kind = \"simulate\"
    species = [\"aspen\"]
    years = 3
    order = \"greedy\"
    [[step]]
    kind = \"place\"
    species = \"herb\"
    at = [[5, 5]]";
/// Years of all steps.
const YEARS: u32 = 6 + 8 + 3;

fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
    rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
}

fn uninterrupted(world: &World) -> Outcome {
    let outcome = world.grow(STEPS).unwrap();
    assert!(outcome.population.len() > 300 && outcome.snapshots.len() == 5);
    assert!(outcome.deaths.len() > 300 && outcome.layers.len() == 1);
    assert!(outcome.summary.iter().any(|row| row.seeds > 100));
    outcome
}

#[test]
fn a_growth_that_stops_after_any_year_goes_on_to_the_same_plants() {
    let world = world();
    let whole = uninterrupted(&world);
    for stop in 1..=YEARS {
        let state = with_threads(1 + stop as usize % 2, || world.stopped(STEPS, None, &[stop]));
        assert_eq!(Checkpoint::read(&state).unwrap().year(), stop);
        let end = with_threads(2 - stop as usize % 2, || world.resumed(STEPS, None, &state));
        assert!(end.unwrap() == whole, "stopped after {stop} years");
    }
}

#[test]
fn many_stops_and_one_lead_to_the_same_state_on_any_number_of_threads() {
    let world = world();
    let stops: Vec<u32> = (1..=YEARS).collect();
    let [one, two] = [1, 2].map(|n| with_threads(n, || world.stopped(STEPS, None, &stops)));
    assert_eq!(one, two);
    assert_eq!(one, world.stopped(STEPS, None, &[YEARS]));
    assert!(world.resumed(STEPS, None, &one).unwrap() == uninterrupted(&world));
}

#[test]
fn plants_of_the_start_keep_their_ids_and_further_columns() {
    let world = world();
    let mut start = uninterrupted(&world).population;
    let tags = start.plants.iter().map(|plant| (plant.id % 100) as f32).collect();
    start.extra.insert("tag".into(), tags);
    let years = "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\"]\nyears = 5\n\
                 [[step]]\nkind = \"simulate\"\nspecies = [\"herb\"]\nyears = 2";
    let whole = world.grow_from(years, Some(&start)).unwrap();
    for stop in 1..=7 {
        let state = world.stopped(years, Some(&start), &[stop]);
        let end = world.resumed(years, Some(&start), &state).unwrap();
        // As words, since newcomers have no tag, and no number equals none.
        assert_eq!(format!("{end:?}"), format!("{whole:?}"), "{stop}");
    }
}

#[test]
fn a_state_of_other_steps_does_not_fit() {
    let world = world();
    let state = world.stopped(STEPS, None, &[3]);
    for (from, to) in [
        ("kind = \"self_thinning\"", "kind = \"place\"\nat = [[1, 1]] #"),
        ("steps = 6", "steps = 2\n#"),
        ("plants = 400", "plants = 4"),
        ("layer = \"herbs\"", "layer = \"others\""),
    ] {
        let steps = STEPS.replacen(from, to, 1).replace("formula = \"herbs\"", "");
        let steps = match from {
            "kind = \"self_thinning\"" => steps
                .replace("plants = 400\n", "")
                .replace("radius = [0.1, 0.4]\n", "")
                .replace("steps = 6\n", "")
                .replace("keep = [0, 3, 6]\n", "")
                .replace("growth = { rate = 0.05, spread = 0.3 }\n", ""),
            "steps = 6" => steps.replace("keep = [0, 3, 6]\n", ""),
            _ => steps,
        };
        let end = world.resumed(&steps, None, &state);
        assert!(matches!(end, Err(Error::Unfit(_))), "{from}: {end:?}");
    }
}

#[test]
fn no_shortened_state_is_read() {
    let world = world();
    for stop in [2, 9, 17] {
        let state = world.stopped(STEPS, None, &[stop]);
        let lengths = (0..state.len()).step_by(97).chain(state.len() - 9..state.len());
        assert!(lengths.into_iter().all(|length| Checkpoint::read(&state[..length]).is_err()));
        let mut longer = state.clone();
        longer.push(0);
        assert!(Checkpoint::read(&longer).is_err());
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(192))]
    /// Damage may go unnoticed here, where a bit of an age is a bit of an age, but it never leads
    /// to a panic.
    #[test]
    fn damaged_states_are_refused_or_run(
        stop in 1..=YEARS,
        places in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 1..6),
    ) {
        static STATES: std::sync::OnceLock<(World, Vec<Vec<u8>>)> = std::sync::OnceLock::new();
        let (world, states) = STATES.get_or_init(|| {
            let world = world();
            let states = (1..=YEARS).map(|stop| world.stopped(STEPS, None, &[stop])).collect();
            (world, states)
        });
        let mut state = states[stop as usize - 1].clone();
        for (index, value) in &places {
            let at = index.index(state.len());
            state[at] ^= value;
        }
        let _ = world.resumed(STEPS, None, &state);
    }
}
