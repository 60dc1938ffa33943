//! Count, fidelity, evenness and speed of planting, beside plain Floyd-Steinberg, white noise and
//! the Poisson disks of a crate, in one run:
//!
//! `cargo run --release --manifest-path ecosim/benches/peers/planting/Cargo.toml`
//!
//! Columns: plants; count error in boxes of 64, 256 and 1,024 plants on average, root mean square, as
//! a part of that number; spread over mean of the distance to the nearest neighbour; on even ground
//! mean squared distance from the nearest plant as a multiple of the hexagonal pattern's, and power
//! in four bands of waves (0.02-0.1-0.2-0.4-0.6 of the root of the count across the square); and
//! processor seconds.

#[path = "../../../../tests/painting/mod.rs"]
mod painting;

use fast_poisson::Poisson2D;
use painting::{Painting, energy, painted, plain_diffusion, power, white_noise};
use weald_contract::Seed;
use weald_ecosim::{Part, Relaxation, Weight, dither, polish, relax, systematic};

type Places = Vec<[f64; 2]>;

fn main() {
    let even = Painting::new(223, 10_000.0, |_, _| 1.0);
    let picture = Painting::new(360, 10_000.0, painted);
    for (name, painting) in [("even ground", &even), ("painted", &picture)] {
        println!("\n{name}, 10,000 plants wanted");
        println!(
            "{:<34}{:>7}{:>8}{:>8}{:>8}{:>8}{:>8}  power{:>30}",
            "", "plants", "@64", "@256", "@1024", "spread", "energy", "CPU s"
        );
        let row = |method: &str, work: &dyn Fn() -> Places| {
            let (time, places) = seconds(work);
            report(method, painting, &places, time, name == "even ground");
            places
        };
        row("white noise", &|| white_noise(painting));
        row("Floyd-Steinberg as printed", &|| painting.places(&plain_diffusion(painting), 1));
        row("fast_poisson, by density", &|| disks(painting));
        let curve = || {
            let cells = systematic(Part::whole(painting.side, painting.side), &painting.expected);
            painting.places(&cells, 1)
        };
        let diffusion = || painting.places(&dither(painting.side, painting.expected.clone()), 1);
        row("floyd_steinberg, no pass", &diffusion);
        row("floyd_steinberg, 10 passes", &|| passes(painting, diffusion(), 10, Weight::Squared));
        row("hilbert, no pass", &curve);
        for weight in [Weight::Squared, Weight::Density, Weight::Even] {
            for count in [5, 10, 20, 100] {
                let name = format!("hilbert, {count} passes, {}", word(weight));
                row(&name, &|| passes(painting, curve(), count, weight));
            }
        }
        row("hilbert, 10 passes, 10 of polish", &|| {
            let mut places = passes(painting, curve(), 10, Weight::Squared);
            polish(&mut places, &painting.grid(), 10);
            places
        });
        drift(painting);
    }
    rates();
}

/// How the count error at 256 plants changes from pass 20 to pass 100, over many starts: with some
/// forty boxes one start says little. The root mean squares, their ratio, and the middle and
/// extremes of the single starts' ratios.
fn drift(painting: &Painting) {
    const STARTS: u64 = 16;
    let cells = systematic(Part::whole(painting.side, painting.side), &painting.expected);
    println!("count error @256 of {STARTS} starts at pass 20, pass 100; ratio; of single starts");
    let row = |name: &str, weight, polished: u32| {
        let errors = |count: u32| -> Vec<f64> {
            let error = |seed| {
                let mut places = passes(painting, painting.places(&cells, seed), count, weight);
                if polished > 0 {
                    polish(&mut places, &painting.grid(), polished);
                }
                painting.count_error(&places, 256.0)
            };
            (0..STARTS).map(error).collect()
        };
        let [early, late] = [errors(20), errors(100)];
        let mut single: Vec<f64> = early.iter().zip(&late).map(|(a, b)| b / a).collect();
        single.sort_by(f64::total_cmp);
        let middle = 0.5 * (single[7] + single[8]);
        let square = |errors: &[f64]| {
            (errors.iter().map(|error| error * error).sum::<f64>() / errors.len() as f64).sqrt()
        };
        let [early, late] = [square(&early), square(&late)];
        println!(
            "{name:<34}{early:>8.4}{late:>8.4}{:>8.2}{middle:>8.2} ({:.2} to {:.2})",
            late / early,
            single[0],
            single[15]
        );
    };
    for weight in [Weight::Squared, Weight::Density, Weight::Even] {
        row(word(weight), weight, 0);
    }
    row("squared, 2 of polish", Weight::Squared, 2);
}

fn word(weight: Weight) -> &'static str {
    match weight {
        Weight::Even => "even",
        Weight::Density => "density",
        Weight::Squared => "squared",
    }
}

fn passes(painting: &Painting, mut places: Places, count: u32, weight: Weight) -> Places {
    let grid = painting.grid();
    for pass in 0..count {
        relax(&mut places, &grid, &Relaxation::weighted(weight, pass, count));
    }
    places
}

/// The crate's disks for the greatest density, each kept with the density as probability: what
/// scatterers do with a density image.
fn disks(painting: &Painting) -> Places {
    let side = painting.side as f64;
    let most = painting.expected.iter().copied().fold(0.0, f32::max);
    // Bridson's disks come to 0.70 / r² plants per m²: with this radius the count is about right.
    let radius = (0.70 / f64::from(most)).sqrt();
    let mut stream = Seed(9).stream("keep", 0);
    let all = Poisson2D::new().with_dimensions([side, side], radius).with_seed(1).generate();
    let kept = |place: &[f64; 2]| {
        let cell = (painting.side - 1 - place[1] as usize) * painting.side + place[0] as usize;
        stream.unit() < f64::from(painting.expected[cell] / most)
    };
    all.into_iter().filter(kept).collect()
}

fn report(method: &str, painting: &Painting, places: &[[f64; 2]], time: f64, is_even: bool) {
    let [a, b, c] = [64.0, 256.0, 1024.0].map(|mean| painting.count_error(places, mean));
    print!(
        "{method:<34}{:>7}{a:>8.4}{b:>8.4}{c:>8.4}{:>8.4}",
        places.len(),
        painting.unevenness(places)
    );
    if is_even {
        let side = painting.side as f64;
        print!("{:>8.4} ", energy(places, side));
        for band in [[0.02, 0.1], [0.1, 0.2], [0.2, 0.4], [0.4, 0.6]] {
            print!("{:>7.4}", power(places, side, band));
        }
    }
    println!("{time:>8.2}");
}

/// A pass of relaxation over as many plants as given, on ground that is full, or mostly empty.
fn rates() {
    println!("\none pass of relaxation");
    for (name, part) in [("full", 1.0), ("a tenth painted", 0.1)] {
        for count in [10_000usize, 100_000, 1_000_000] {
            let side = ((count as f64).sqrt() * 1.8) as usize;
            let spot = move |u: f64, v: f64| {
                let is_in = |along: f64| (along * 9.0).fract() < f64::sqrt(part);
                f64::from(u8::from(is_in(u) && is_in(v)))
            };
            let painting = Painting::new(side, count as f64, spot);
            let mut places = white_noise(&painting);
            let grid = painting.grid();
            let clock = std::time::Instant::now();
            let (time, ()) = seconds(&mut || relax(&mut places, &grid, &Relaxation::pass(0, 1)));
            let wall = clock.elapsed().as_secs_f64();
            let rate = |time: f64| places.len() as f64 / time / 1e6;
            println!(
                "{name:<20}{:>10} plants: {:>5.2} M plants per processor second, {:>5.2} M per \
                      second",
                places.len(),
                rate(time),
                rate(wall)
            );
        }
    }
}

/// Processor time of all threads, to a hundredth of a second.
fn seconds<T>(work: impl FnOnce() -> T) -> (f64, T) {
    let ticks = || {
        let line = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
        // User and system time are fields 14 and 15; the name before them ends in `)`.
        let fields = line.rsplit(')').next().unwrap_or_default().split_whitespace();
        fields.skip(11).take(2).filter_map(|field| field.parse::<f64>().ok()).sum::<f64>()
    };
    let start = ticks();
    let made = work();
    (((ticks() - start) / 100.0).max(0.01), made)
}
