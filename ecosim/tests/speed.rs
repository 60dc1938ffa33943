//! Rates of one processor second, so that other programs do not disturb them: `cargo test --release -p weald-ecosim --test speed -- --ignored --nocapture`.

mod world;

use weald_contract::{Frame, Grid, Seed};
use weald_ecosim::{Circle, Order, Plain, Relaxation, Simulation, Step, dominators, relax};
use world::{HERB, TREE, config, plain};

/// Returns the processor time of all threads that some work took, to a hundredth of a second.
fn seconds<T>(what: impl FnOnce() -> T) -> (f64, T) {
    let ticks = || {
        let line = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
        // User and system time are fields 14 and 15; the name before them ends in `)`.
        let fields = line.rsplit(')').next().unwrap_or_default().split_whitespace();
        let times: Vec<f64> = fields.skip(11).take(2).filter_map(|f| f.parse().ok()).collect();
        times.iter().sum::<f64>()
    };
    let start = ticks();
    let made = what();
    (((ticks() - start) / 100.0).max(0.01), made)
}

fn scattered(count: usize, side: f64) -> Vec<[f64; 2]> {
    let mut stream = Seed(1).stream("places", 0);
    (0..count).map(|_| [stream.range(0.0, side), stream.range(0.0, side)]).collect()
}

#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn lloyd_points_per_second() {
    for count in [10_000, 100_000, 1_000_000] {
        let side = (count as f64).sqrt();
        let cells = (side * 1.8) as usize;
        let frame =
            Frame { width: cells, height: cells, cell: side / cells as f64, west: 0.0, south: 0.0 };
        let whole = Grid::filled(frame, 1.0);
        let spots = |x: f64, y: f64| {
            f32::from(u8::from(
                (x / side * 9.0) as i32 % 4 == 1 && (y / side * 9.0) as i32 % 4 == 2,
            ))
        };
        let painted = Grid::from_fn(frame, spots);
        for (name, density) in [("whole", &whole), ("mostly empty", &painted)] {
            let mut places = scattered(count * 20, side);
            places.retain(|p| density.nearest(p[0], p[1]).is_some_and(|d| d > 0.0));
            places.truncate(count);
            let (time, ()) = seconds(|| relax(&mut places, density, &Relaxation::pass(0, 1)));
            println!("lloyd {name} {}: {:.2} M/s", places.len(), places.len() as f64 / time / 1e6);
        }
    }
}

#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn competition_steps_per_second() {
    for count in [10_000, 100_000, 1_000_000] {
        for giants in [false, true] {
            let mut stream = Seed(1).stream("radii", 0);
            let mut circles: Vec<Circle> = scattered(count, (count as f64).sqrt())
                .into_iter()
                .map(|[x, y]| {
                    let giant = giants && stream.unit() < 0.001;
                    let radius = stream.range(0.02, 0.10) as f32 * if giant { 50.0 } else { 1.0 };
                    Circle { x, y, radius, ability: radius }
                })
                .collect();
            let (time, steps) = seconds(|| {
                let mut steps = 0;
                for _ in 0..20 {
                    steps += circles.len();
                    let over = dominators(&circles, Plain::Open, Order::Sync, |_| false);
                    let mut over = over.iter();
                    circles.retain(|_| over.next().is_some_and(Option::is_none));
                    circles.iter_mut().for_each(|c| {
                        c.radius += 0.01;
                        c.ability = c.radius;
                    });
                }
                steps
            });
            let rate = steps as f64 / time / 1e6;
            println!("competition {count}, giants {giants}: {rate:.1} M plant-steps/s");
        }
    }
}

#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn simulated_plant_years_per_second() {
    for (cells, seedlings) in [(200, 200.0), (600, 300.0)] {
        let aspen = format!("{TREE}\necology = {{ seedlings = {seedlings}, survival = 0.9 }}");
        let world = plain(cells, 2.0).with_species("aspen", &aspen);
        let steps = "[[step]]\nkind = \"simulate\"\nspecies = [\"aspen\"]\nyears = 100";
        let (time, outcome) = seconds(|| world.grow(steps).unwrap());
        let alive: u64 = outcome.summary.iter().map(|row| row.alive).sum();
        let rate = alive as f64 / time / 1e6;
        println!(
            "simulate {} at the end: {time:.2} s, {rate:.1} M plant-years/s, cover {}",
            outcome.population.len(),
            outcome.summary.last().map_or(0.0, |row| row.cover)
        );
        let around = weald_ecosim::Surroundings {
            terrain: &world.terrain,
            species: &world.species,
            images: &world.images,
            plants: &world.plants,
            views: &[],
        };
        let config = config(&steps.replace("years = 100", "years = 1\ninitial = 100000"));
        let Step::Simulate(rules) = &config.step[0].variant else { panic!("a simulation") };
        let mut simulation = Simulation::new(rules, &around, Seed(1)).unwrap();
        simulation.sow();
        let before = simulation.len();
        let (time, _) = seconds(|| simulation.step().unwrap());
        println!("one step of {before}: {:.1} M plant-steps/s", before as f64 / time / 1e6);
    }
}

#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn halftones_and_grids() {
    let meadow = "size = { height = 0.3, crown_radius = 0.4 }\n[group]\nside = 0.5\nmember = []";
    let world = plain(400, 1.0).with_species("herb", HERB).with_species("meadow", meadow);
    let herbs = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = ";
    for per_m2 in [0.0625, 0.625, 6.25] {
        let (time, outcome) = seconds(|| world.grow(&format!("{herbs}{per_m2}")).unwrap());
        println!("halftone {}: {time:.2} s", outcome.population.len());
    }
    let reeds = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\n\
                 formula = \"20 * smoothstep(0.7, 0.75, soil_moisture) * (soil_moisture < 0.8)\"";
    let (time, outcome) = seconds(|| world.grow(reeds).unwrap());
    println!("band of reeds {}: {time:.2} s", outcome.population.len());
    let grid = "[[step]]\nkind = \"halftone\"\nspecies = \"meadow\"\narrange = \"grid\"\n\
                formula = \"0.95\"\nvigor = \"0.4 + 0.5 * soil_moisture\"";
    let (time, outcome) = seconds(|| world.grow(grid).unwrap());
    println!("grid {}: {time:.2} s", outcome.population.len());
}

#[test]
#[ignore = "a measurement, printed for people: run with --release --nocapture"]
fn many_millions() {
    // The number of plants in millions may be given, since ten of them take a minute.
    let millions = std::env::var("WEALD_MILLIONS").ok().and_then(|text| text.parse().ok());
    let millions: f64 = millions.unwrap_or(2.0);
    let world = plain(1000, 1.0).with_species("herb", HERB);
    let steps = format!(
        "max_plants = 20000000\n[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\n\
         per_m2 = {millions}\nrelax = 5"
    );
    let (time, outcome) = seconds(|| world.grow(&steps).unwrap());
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let peak = status.lines().find(|line| line.starts_with("VmHWM")).unwrap_or_default();
    println!("halftone {}: {time:.1} processor s, {peak}", outcome.population.len());
}
