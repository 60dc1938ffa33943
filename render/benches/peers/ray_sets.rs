//! Eight sets of rays through a wood of one tree, traced by weald and by Embree.
//!
//! `cargo run --release -p weald-render --example ray_sets -- --embree libembree4.so [--trees N ...]`
//!
//! Embree is loaded at run time; the Python package `embreex` holds a library of it. The tree has
//! 507,200 triangles, 480,000 of them in pairs that make leaves. N of them stand 5 m apart, turned
//! and scaled at random, on weald's own ground mesh. Two eyes, one at 1.7 m in a clearing and one
//! at 35 m over the canopy, send 640 x 360 x 4 rays each, of which one in 16 is traced; from what
//! they meet go cosine-distributed bounces, from there a second bounce, and rays to the sun. Both
//! tracers get the same numbers, one thread each, by turns; times are CPU seconds of the thread,
//! medians of the repetitions. Distances must agree for all
//! but 1 in 100 rays, and hits with misses for all but 1 in 1,000: rotations of ours have 16 bits
//! a component, a millimetre at the top of a tree.
//!
//! `--paths SAMPLES` renders both views instead, `--write FOLDER` keeps the tree and the placements for other programs, see `write`.

mod ray_sets {
    pub mod embree;
    pub mod wood;
}

use ray_sets::embree::{Embree, Quality};
use ray_sets::wood::{self, Wood};
use std::error::Error;
use std::time::Duration;
use weald_contract::{Seed, Silent, seed::Stream};
use weald_render::Scene;
use weald_render::probe::{Met, Probe, are_blocked, distances, meet};

/// Every how many rays one is traced.
const KEEP: usize = 16;
/// The direction to the sun.
const SUN: [f32; 3] = [0.5, -0.3, 0.9];

fn main() -> Result<(), Box<dyn Error>> {
    let options = Options::read(std::env::args().skip(1))?;
    let tree = wood::tree();
    if let Some(folder) = &options.write {
        for &count in &options.trees {
            Wood::new(&tree, count)?.write(folder)?;
        }
        return Ok(());
    }
    for &count in &options.trees {
        let wood = Wood::new(&tree, count)?;
        match options.paths {
            Some(samples) => follow_paths(&options, &wood, samples)?,
            None => compare(&options, &wood)?,
        }
    }
    Ok(())
}

/// Renders both eyes' views, 640 x 360, five scatterings.
fn follow_paths(options: &Options, wood: &Wood, samples: u32) -> Result<(), Box<dyn Error>> {
    let (scene, built) = cpu(|| wood.scene());
    let scene = scene?;
    println!("{} trees; scene {built:.2?} CPU of all threads", wood.places.len());
    for (name, eye, forward) in wood.eyes() {
        let view = |key: &str| {
            let at = [0, 1].map(|axis| f64::from(eye[axis]));
            let to = [0, 1].map(|axis| at[axis] + 40.0 * f64::from(forward[axis]));
            let height = f64::from(eye[2]) + 40.0 * f64::from(forward[2]);
            format!(
                "name = \"{key}\"\nstand_at = {at:?}\neye_height = {}\nlook_at = {to:?}\n\
                 look_height = {height}\nfov_deg = 60",
                eye[2]
            )
        };
        let config = |samples: u32, side: [u32; 2]| {
            format!("view = \"v\"\nresolution = {side:?}\nsamples = {samples}\nbounces = 5")
        };
        let view: weald_contract::View = wood::read(&view("v"))?;
        let one: weald_render::Config = wood::read(&config(1, [1, 1]))?;
        let (first, time) = cpu(|| weald_render::render(&scene, &view, &one, Seed(1), &Silent));
        first?;
        println!("{name}: first pixel {time:.2?} CPU after the scene");
        let config: weald_render::Config = wood::read(&config(samples, [640, 360]))?;
        let mut rates = Vec::new();
        let mut mean = 0.0;
        for seed in 0..options.repeat as u64 {
            let (film, time) =
                cpu(|| weald_render::render(&scene, &view, &config, Seed(seed), &Silent));
            let film = film?;
            let counted = film.statistics();
            rates.push(counted.samples as f64 / time.as_secs_f64() / 1e6);
            let picture = film.picture();
            let green = picture.channel("G").unwrap_or_default();
            mean = green.iter().map(|&g| f64::from(g)).sum::<f64>() / green.len() as f64;
            if seed == 0 {
                println!(
                    "{name}: {:.2} rays a sample",
                    counted.rays as f64 / counted.samples as f64
                );
            }
        }
        rates.sort_by(f64::total_cmp);
        let median = rates[rates.len() / 2];
        println!("{name}: {median:.4} million samples a CPU second, mean green {mean:.5}");
    }
    Ok(())
}

/// What the command line asks for.
struct Options {
    embree: Option<String>,
    quality: Quality,
    trees: Vec<usize>,
    repeat: usize,
    write: Option<std::path::PathBuf>,
    paths: Option<u32>,
}

impl Options {
    fn read(mut arguments: impl Iterator<Item = String>) -> Result<Self, Box<dyn Error>> {
        let mut options = Self {
            embree: None,
            quality: Quality::Medium,
            trees: Vec::new(),
            repeat: 5,
            write: None,
            paths: None,
        };
        while let Some(name) = arguments.next() {
            if name == "--high" {
                options.quality = Quality::High;
                continue;
            }
            let value = arguments.next().ok_or(format!("{name} needs a value"))?;
            match name.as_str() {
                "--embree" => options.embree = Some(value),
                "--trees" => options.trees.push(value.parse()?),
                "--repeat" => options.repeat = value.parse()?,
                "--paths" => options.paths = Some(value.parse()?),
                "--write" => options.write = Some(value.into()),
                other => return Err(format!("unknown option {other}").into()),
            }
        }
        if options.trees.is_empty() {
            options.trees.push(10_000);
        }
        Ok(options)
    }
}

fn compare(options: &Options, wood: &Wood) -> Result<(), Box<dyn Error>> {
    let before = resident();
    let (scene, built) = cpu(|| wood.scene());
    let scene = scene?;
    let held = resident().saturating_sub(before);
    println!(
        "{} trees; weald: scene {built:.2?} CPU of all threads, {} bytes, {held} resident",
        wood.places.len(),
        scene.statistics().bytes
    );
    let embree = match &options.embree {
        Some(path) => {
            let before = resident();
            let (embree, built) = cpu(|| Embree::new(path, wood, options.quality));
            let held = resident().saturating_sub(before);
            println!("Embree: scene {built:.2?} CPU of all threads, {held} resident");
            Some(embree?)
        }
        None => None,
    };
    let mut ratios = Vec::new();
    println!(
        "{:<16}{:>8}{:>10}{:>10}{:>8}  differing",
        "rays", "count", "weald", "Embree", "ratio"
    );
    for (name, probes, is_shadow) in sets(wood, &scene) {
        let (mut ours, mut theirs) = (Vec::new(), Vec::new());
        let mut differing = [0; 2];
        for _ in 0..options.repeat {
            let (time, mine) = trace(&scene, &probes, is_shadow);
            ours.push(time);
            if let Some(embree) = &embree {
                let (time, other) = embree.trace(&probes, is_shadow);
                theirs.push(time);
                let count = |test: fn(f32, f32) -> bool| {
                    mine.iter().zip(&other).filter(|&(&a, &b)| test(a, b)).count()
                };
                differing =
                    [count(|a, b| !agree(a, b)), count(|a, b| a.is_finite() != b.is_finite())];
            }
        }
        let rate = |times: &mut Vec<Duration>| {
            times.sort();
            probes.len() as f64 / times[times.len() / 2].as_secs_f64() / 1e6
        };
        let mine = rate(&mut ours);
        if theirs.is_empty() {
            println!("{name:<16}{:>8}{mine:>10.3}", probes.len());
            continue;
        }
        let other = rate(&mut theirs);
        ratios.push(mine / other);
        println!(
            "{name:<16}{:>8}{mine:>10.3}{other:>10.3}{:>8.2}  {differing:?}",
            probes.len(),
            mine / other
        );
        if differing[0] * 100 > probes.len() || differing[1] * 1000 > probes.len() {
            return Err("the two tracers do not see the same scene".into());
        }
    }
    if !ratios.is_empty() {
        let mean = (ratios.iter().map(|r: &f64| r.ln()).sum::<f64>() / ratios.len() as f64).exp();
        println!("geometric mean of the ratios {mean:.3}, million rays a CPU second\n");
    }
    Ok(())
}

/// Whether two distances are the same but for rounding.
fn agree(a: f32, b: f32) -> bool {
    a == b || (a - b).abs() < 1e-3 * a.abs().max(1.0)
}

/// Time and distances; of shadow rays 0 where something is in the way.
fn trace(scene: &Scene, probes: &[Probe], is_shadow: bool) -> (Duration, Vec<f32>) {
    let start = thread_time();
    if is_shadow {
        let blocked = are_blocked(scene, probes);
        let time = thread_time() - start;
        (time, blocked.iter().map(|&b| if b { 0.0 } else { f32::INFINITY }).collect())
    } else {
        let found = distances(scene, probes);
        (thread_time() - start, found)
    }
}

/// The eight sets: name, rays, and whether any hit will do.
fn sets(wood: &Wood, scene: &Scene) -> Vec<(String, Vec<Probe>, bool)> {
    let mut sets = Vec::new();
    for (eye, origin, forward) in wood.eyes() {
        let mut chance = Seed(5).stream(eye, 0);
        let prime = primary(origin, forward, &mut chance);
        let first = bounce(scene, &prime, &mut chance);
        let second = bounce(scene, &first, &mut chance);
        let shadow = to_sun(scene, &prime);
        sets.push((format!("{eye} prime"), prime, false));
        sets.push((format!("{eye} bounce 1"), first, false));
        sets.push((format!("{eye} bounce 2"), second, false));
        sets.push((format!("{eye} shadow"), shadow, true));
    }
    sets
}

fn primary(origin: [f32; 3], forward: [f32; 3], chance: &mut Stream) -> Vec<Probe> {
    use glam::Vec3;
    let forward = Vec3::from(forward).normalize();
    let right = forward.cross(Vec3::Z).normalize();
    let up = right.cross(forward);
    let half = 30f32.to_radians().tan();
    let (width, height) = (640, 360);
    let mut probes = Vec::new();
    for index in 0..width * height * 4 {
        let (dx, dy) = (chance.unit() as f32, chance.unit() as f32);
        if index % KEEP != 0 {
            continue;
        }
        let pixel = index / 4;
        let x = ((pixel % width) as f32 + dx) / width as f32 * 2.0 - 1.0;
        let y = 1.0 - ((pixel / width) as f32 + dy) / height as f32 * 2.0;
        let aspect = height as f32 / width as f32;
        let direction = (forward + half * (x * right + y * aspect * up)).normalize();
        probes.push(Probe { origin, direction: direction.to_array() });
    }
    probes
}

/// A ray on from where each ray meets something, in a cosine-distributed direction.
fn bounce(scene: &Scene, probes: &[Probe], chance: &mut Stream) -> Vec<Probe> {
    use glam::Vec3;
    let mut next = Vec::new();
    for probe in probes {
        let u = [chance.unit(), chance.unit()];
        let Some((at, normal)) = foot(scene, probe) else { continue };
        let (x, y) = normal.any_orthonormal_pair();
        let (sin, cos) = (u[1] * std::f64::consts::TAU).sin_cos();
        let across = u[0].sqrt() as f32;
        let direction: Vec3 =
            across * (cos as f32 * x + sin as f32 * y) + (1.0 - u[0]).sqrt() as f32 * normal;
        next.push(Probe { origin: at.to_array(), direction: direction.normalize().to_array() });
    }
    next
}

fn to_sun(scene: &Scene, probes: &[Probe]) -> Vec<Probe> {
    let sun = glam::Vec3::from(SUN).normalize();
    let feet = probes.iter().filter_map(|probe| foot(scene, probe));
    let lit = feet.filter(|(_, normal)| normal.dot(sun) > 0.0);
    lit.map(|(at, _)| Probe { origin: at.to_array(), direction: sun.to_array() }).collect()
}

/// A place a little off what a ray meets, and the normal on the ray's side.
fn foot(scene: &Scene, probe: &Probe) -> Option<(glam::Vec3, glam::Vec3)> {
    use glam::Vec3;
    let Met { distance, normal } = meet(scene, probe)?;
    let (direction, normal) = (Vec3::from(probe.direction), Vec3::from(normal));
    let normal = if normal.dot(direction) > 0.0 { -normal } else { normal };
    Some((Vec3::from(probe.origin) + distance * direction + 2e-3 * normal, normal))
}

/// Seconds and result of some work, CPU time of all threads.
fn cpu<T>(work: impl FnOnce() -> T) -> (T, Duration) {
    let start = clock(PROCESS_CLOCK);
    let result = work();
    (result, clock(PROCESS_CLOCK) - start)
}

/// CPU time of this thread.
pub fn thread_time() -> Duration {
    clock(THREAD_CLOCK)
}

/// Numbers of Linux' clocks of CPU time.
const PROCESS_CLOCK: i32 = 2;
const THREAD_CLOCK: i32 = 3;

fn clock(number: i32) -> Duration {
    #[repr(C)]
    struct Timespec {
        seconds: i64,
        nanoseconds: i64,
    }
    unsafe extern "C" {
        fn clock_gettime(clock: i32, time: *mut Timespec) -> i32;
    }
    let mut time = Timespec { seconds: 0, nanoseconds: 0 };
    // SAFETY: the struct is what 64-bit Linux fills.
    unsafe { clock_gettime(number, &mut time) };
    Duration::new(time.seconds as u64, time.nanoseconds as u32)
}

/// Memory of this process that is in use, bytes.
fn resident() -> u64 {
    let text = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = text.lines().find(|line| line.starts_with("VmRSS:"));
    let kilobytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<u64>().ok());
    kilobytes.unwrap_or(0) * 1024
}
