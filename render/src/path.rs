//! The integrator: light paths from the eye to sun and sky.
//!
//! At every scattering the lights are connected to directly (next-event estimation) and the path
//! goes on in a direction drawn from the surface; both ways of reaching the sky are combined by
//! the power heuristic [Veach97] §9.2. Surfaces that shine are met by chance only: they are few
//! and dim beside the day. The sun is so small that only connections find it, except
//! for the eye itself and its mirror image in water. Paths end at random once they carry little
//! [AK90].

use crate::accel::{Hit, Place, Ray, Scratch as Stack};
use crate::bsdf::{Bsdf, Material, any_direction};
use crate::camera::{Camera, Filter};
use crate::config::Light;
use crate::film::{Film, FilmStatistics, Names, Pixel};
use crate::matte::{Ballots, name_hash};
use crate::noise::value;
use crate::sampler::Sampler;
use crate::scene::Scene;
use crate::tone::luminance;
use crate::{Config, Error, water};
use glam::Vec3;
use rayon::prelude::*;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};
use weald_contract::progress::Figure;
use weald_contract::{Progress, Seed, View, seed::mix};

/// Side of the squares of pixels that threads take, pixels.
const TILE: usize = 16;

/// Samples after which the noise of a tile is looked at: as many as are spread evenly by fours
/// in two dimensions.
const ROUND: u32 = 16;

/// Scatterings after which a path may end at random.
const SURE_BOUNCES: u32 = 2;

/// Luminance carried, times this, is the chance to go on: paths that carry a fifth or more are
/// worth their full price. Leaves absorb so much that higher values buy rays that nobody sees.
const WORTH: f32 = 5.0;

/// What the cone of a scattered ray gains on a metre: scattering blurs, and what it shows needs no
/// finer texels.
const SCATTERED_SPREAD: f32 = 0.2;

/// Light through leaves that is not followed further.
const LEAST_PASSING: f32 = 0.01;

/// Water surfaces that a path may cross; more are only met between ripples.
const CROSSINGS: u32 = 8;

/// Chance that a connection of a later bounce goes to the sun rather than to the sky: the sun
/// carries about three quarters of a clear day's light.
const SUN_CHANCE: f32 = 0.6;

/// Renders a view of a scene.
///
/// Threads share the picture in tiles; each pixel depends only on its own samples.
///
/// # Errors
/// [`Error::Cancelled`] when the caller asks to stop; a problem when the picture is too large.
pub fn render(
    scene: &Scene,
    view: &View,
    config: &Config,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Film, Error> {
    config.check_size()?;
    let [width, height] = config.resolution.map(|side| side as usize);
    let (columns, rows) = (width.div_ceil(TILE), height.div_ceil(TILE));
    let camera = camera(scene, view, config);
    let job = Job {
        tracer: Tracer::new(scene, config.bounces, config.light).varied(config.variation),
        cone: camera.cone(width),
        camera,
        filter: Filter::new(),
        seed: seed.part("render", 0),
        samples: config.samples,
        noise: f64::from(config.noise),
        width,
        height,
    };
    progress.begin("light paths", (width * height) as u64 * u64::from(config.samples), "samples");
    let noise = Mutex::new(Noise::default());
    let tiles: Vec<Result<Tile, Error>> = (0..columns * rows)
        .into_par_iter()
        .map(|number| {
            if progress.is_cancelled() {
                return Err(Error::Cancelled);
            }
            let tile = job.tile(number % columns * TILE, number / columns * TILE);
            progress.advance(tile.pixels.len() as u64 * u64::from(config.samples));
            // Shown and forgotten: what it adds up to depends on the order of the tiles.
            let mut sum = noise.lock().unwrap_or_else(PoisonError::into_inner);
            sum.add(Noise::of(tile.pixels.iter().map(|(_, pixel)| pixel)));
            progress.figure("rays", Figure::Counted(tile.rays));
            progress.figure("noise", Figure::Level(sum.value()));
            Ok(tile)
        })
        .collect();
    let mut film = Film {
        width,
        height,
        pixels: vec![Pixel::default(); width * height],
        names: Names::default(),
        statistics: FilmStatistics::default(),
    };
    for tile in tiles {
        let tile = tile?;
        film.statistics.rays += tile.rays;
        film.names.species.extend(tile.names.species);
        film.names.plants.extend(tile.names.plants);
        for (index, pixel) in tile.pixels {
            film.statistics.samples += u64::from(pixel.samples);
            film.pixels[index] = pixel;
        }
    }
    Ok(film)
}

/// The camera of a view, in scene-local metres.
pub(crate) fn camera(scene: &Scene, view: &View, config: &Config) -> Camera {
    let sight = view.sight(&scene.footing);
    let local =
        |p: [f64; 3]| Vec3::from_array([0, 1, 2].map(|axis| (p[axis] - scene.origin[axis]) as f32));
    let aspect = config.resolution[0] as f32 / config.resolution[1] as f32;
    let lens_radius = config.aperture_mm * 0.5e-3;
    let fov = (view.fov_deg as f32).to_radians();
    let (eye, target) = (local(sight.eye), local(sight.target));
    Camera::new(view.projection, eye, target, fov, aspect, lens_radius)
}

/// A rendering, the same for all threads.
struct Job<'a> {
    tracer: Tracer<'a>,
    camera: Camera,
    filter: Filter,
    /// Width of a pixel at the eye, m, and what it gains on a metre.
    cone: [f32; 2],
    seed: Seed,
    samples: u32,
    /// Noise at which a tile is done, or 0.
    noise: f64,
    width: usize,
    height: usize,
}

/// Finished pixels with their index in the picture.
struct Tile {
    pixels: Vec<(usize, Pixel)>,
    names: Names,
    rays: u64,
}

/// What mattes call ground, water and objects.
const NO_PLANT: &str = "no plant";

impl Job<'_> {
    fn tile(&self, left: usize, top: usize) -> Tile {
        let mut scratch = Scratch::default();
        let rows = top..(top + TILE).min(self.height);
        let columns = left..(left + TILE).min(self.width);
        let places = rows.flat_map(|y| columns.clone().map(move |x| (x, y)));
        let mut pixels: Vec<_> =
            places.map(|place| (place, Pixel::default(), Ballots::default())).collect();
        let mut taken = 0;
        while taken < self.samples {
            let next = if self.noise > 0.0 { taken + ROUND } else { self.samples };
            let round = taken..next.min(self.samples);
            taken = round.end;
            for (place, pixel, ballots) in &mut pixels {
                self.sample(*place, round.clone(), (pixel, ballots), &mut scratch);
            }
            if Noise::of(pixels.iter().map(|(_, pixel, _)| pixel)).is_at_most(self.noise) {
                break;
            }
        }
        let mut tile = Tile { pixels: Vec::new(), names: Names::default(), rays: scratch.rays };
        for ((x, y), mut pixel, ballots) in pixels {
            self.count(&mut pixel, &ballots, &mut tile.names);
            tile.pixels.push((y * self.width + x, pixel));
        }
        tile
    }

    /// Gives a pixel what its samples saw.
    fn count(&self, pixel: &mut Pixel, ballots: &Ballots, names: &mut Names) {
        let species_name = |species: u32| match species.checked_sub(1) {
            Some(index) => self.tracer.scene.species.get(index as usize).map_or("", String::as_str),
            None => NO_PLANT,
        };
        let plants = ballots.plants();
        if plants[0].1 > pixel.samples - pixel.covered {
            pixel.majority = plants[0].0;
        }
        for (rank, (species, count)) in ballots.species().into_iter().enumerate() {
            if count > 0 {
                let name = species_name(species);
                let hash = name_hash(name);
                pixel.species[rank] = (hash, count);
                names.species.entry(hash).or_insert_with(|| name.to_string());
            }
        }
        for (rank, ((species, plant), count)) in plants.into_iter().enumerate() {
            if count > 0 {
                let name = match species {
                    0 => NO_PLANT.to_string(),
                    _ => format!("{} {plant}", species_name(species)),
                };
                let hash = name_hash(&name);
                pixel.plants[rank] = (hash, count);
                names.plants.entry(hash).or_insert(name);
            }
        }
    }

    /// Traces some of a pixel's samples.
    fn sample(
        &self,
        (x, y): (usize, usize),
        samples: Range<u32>,
        (pixel, ballots): (&mut Pixel, &mut Ballots),
        scratch: &mut Scratch,
    ) {
        for sample in samples {
            let mut sampler = Sampler::new(self.seed, (y * self.width + x) as u64, sample);
            let [fx, fy, lens_u, lens_v] = sampler.next();
            let at = |index: usize, offset: f32, count: usize| {
                2.0 * (index as f32 + 0.5 + offset) / count as f32 - 1.0
            };
            let px = at(x, self.filter.offset(fx), self.width);
            let py = -at(y, self.filter.offset(fy), self.height);
            let ray = self.camera.ray(px, py, [lens_u, lens_v]);
            let gathered = self.tracer.trace(ray, self.cone, &mut sampler, scratch);
            self.expose(pixel, ballots, &gathered);
        }
    }

    /// Adds one sample to a pixel.
    fn expose(&self, pixel: &mut Pixel, ballots: &mut Ballots, gathered: &Gathered) {
        pixel.samples += 1;
        // One broken number would blacken the pixel for good.
        if gathered.light.is_finite() {
            pixel.add_light(gathered.light, gathered.direct);
        }
        let Some(seen) = gathered.seen else {
            return;
        };
        pixel.covered += 1;
        for axis in 0..3 {
            pixel.albedo[axis] += f64::from(seen.albedo[axis]);
            pixel.normal[axis] += f64::from(seen.normal[axis]);
        }
        let origin = self.tracer.scene.origin;
        let altitude = (f64::from(seen.position.z) + origin[2]) as f32;
        let position = [seen.position.x, seen.position.y, altitude];
        let depth = self.camera.depth(seen.position);
        if pixel.nearest.is_none_or(|(nearest, _)| depth < nearest) {
            pixel.nearest = Some((depth, position));
        }
        ballots.cast(seen.species, seen.plant);
    }
}

/// Sums over pixels from which their noise follows.
#[derive(Clone, Copy, Debug, Default)]
struct Noise {
    variance: f64,
    light: f64,
    count: f64,
}

impl Noise {
    /// The noise of some pixels.
    fn of<'a>(pixels: impl Iterator<Item = &'a Pixel>) -> Self {
        pixels.fold(Self::default(), |sum, pixel| Self {
            variance: sum.variance + pixel.variance(),
            light: sum.light + pixel.brightness() / f64::from(pixel.samples.max(1)),
            count: sum.count + 1.0,
        })
    }

    /// Whether the standard error of the pixels, over their mean luminance, is at most `noise`.
    fn is_at_most(&self, noise: f64) -> bool {
        // √(variance / count) <= noise · light / count, without roots and divisions.
        self.variance * self.count <= (noise * self.light).powi(2)
    }

    fn add(&mut self, other: Self) {
        self.variance += other.variance;
        self.light += other.light;
        self.count += other.count;
    }

    /// The standard error over the mean luminance; 0 where all is black.
    fn value(&self) -> f64 {
        if self.light > 0.0 { (self.variance * self.count).sqrt() / self.light } else { 0.0 }
    }
}

/// What came along a path.
struct Gathered {
    light: Vec3,
    /// The part that was scattered at most once.
    direct: Vec3,
    seen: Option<Seen>,
}

/// What a path met first.
#[derive(Clone, Copy, Debug)]
struct Seen {
    position: Vec3,
    albedo: Vec3,
    normal: Vec3,
    species: u32,
    plant: u64,
}

/// Memory of a thread, kept between rays.
#[derive(Debug, Default)]
struct Scratch {
    stack: Stack,
    /// Rays traced.
    rays: u64,
}

/// Follows paths through a scene.
struct Tracer<'a> {
    scene: &'a Scene,
    bounces: u32,
    /// Whether leaves dim the light that they stand in the way of, and nothing is scattered twice.
    is_direct: bool,
    /// Factor of the variation of materials.
    variation: f32,
}

/// State of a path.
struct Path {
    ray: Ray,
    /// Part of the light at the end of the path that reaches the eye.
    beta: Vec3,
    /// Light gathered.
    light: Vec3,
    /// The part of it that was scattered at most once.
    direct: Vec3,
    /// Scatterings so far.
    bounces: u32,
    /// Water surfaces crossed.
    crossings: u32,
    /// The cone that the ray stands for: its width where the ray starts, m, and what it gains on
    /// a metre.
    width: f32,
    spread: f32,
    /// Whether the ray runs under water.
    in_water: bool,
    /// Whether only mirrors lie between the ray and the eye.
    is_straight: bool,
    /// Density with which the direction was drawn where the sky could also have been connected
    /// to, and the chance of that connection; `None` after a mirror.
    drawn: Option<(f32, f32)>,
    seen: Option<Seen>,
}

impl Path {
    /// Adds light that was scattered so many times on its way to the eye.
    fn gather(&mut self, light: Vec3, scatterings: u32) {
        self.light += light;
        if scatterings <= 1 {
            self.direct += light;
        }
    }
}

/// A surface that a path met.
struct Vertex {
    position: Vec3,
    bsdf: Bsdf,
    emission: Vec3,
    species: u32,
    plant: u64,
}

impl<'a> Tracer<'a> {
    fn new(scene: &'a Scene, bounces: u32, light: Light) -> Self {
        let is_direct = light == Light::Direct;
        Self { scene, bounces: if is_direct { 1 } else { bounces }, is_direct, variation: 1.0 }
    }

    /// The same with more or less variation from leaf to leaf.
    fn varied(self, variation: f32) -> Self {
        Self { variation, ..self }
    }

    /// Light along a ray, and what it meets first. `cone` is the width of a pixel where the ray
    /// starts, m, and what it gains on a metre.
    fn trace(
        &self,
        ray: Ray,
        cone: [f32; 2],
        sampler: &mut Sampler,
        scratch: &mut Scratch,
    ) -> Gathered {
        let mut path = Path {
            ray,
            beta: Vec3::ONE,
            light: Vec3::ZERO,
            direct: Vec3::ZERO,
            bounces: 0,
            crossings: 0,
            width: cone[0],
            spread: cone[1],
            in_water: false,
            is_straight: true,
            drawn: None,
            seen: None,
        };
        while self.step(&mut path, sampler, scratch) {}
        Gathered { light: path.light, direct: path.direct, seen: path.seen }
    }

    /// Follows the path to its next event; returns whether it goes on.
    fn step(&self, path: &mut Path, sampler: &mut Sampler, scratch: &mut Scratch) -> bool {
        let scene = self.scene;
        let levels = &scene.levels;
        scratch.rays += 1;
        let hit = levels.nearest(scene.solid, &path.ray, f32::INFINITY, &mut scratch.stack);
        let surface = levels.nearest(scene.water, &path.ray, hit.t, &mut scratch.stack);
        let distance = if surface.is_some() { surface.t } else { hit.t };
        if path.in_water {
            let [u, a, b, _] = sampler.next();
            // Free flight in the medium; its end may come before anything is met.
            let flight = -libm::logf(1.0 - u) / water::EXTINCTION;
            if flight < distance {
                return self.scatter_in_water(path, flight, [a, b], sampler, scratch);
            }
        }
        if surface.is_some() {
            return self.cross_water(path, surface.t, sampler);
        }
        if !hit.is_some() {
            self.add_sky(path);
            return false;
        }
        let vertex = self.vertex(path, &hit);
        self.note(path, &vertex);
        if path.is_straight {
            self.add_haze(path, distance);
        }
        path.gather(path.beta * vertex.emission, path.bounces);
        self.scatter(path, &vertex, sampler, scratch)
    }

    /// Surface and material at a hit.
    fn vertex(&self, path: &Path, hit: &Hit) -> Vertex {
        let place = self.scene.levels.place(self.scene.solid, hit);
        let position = path.ray.origin + hit.t * path.ray.direction;
        let width = path.width + path.spread * hit.t;
        let material = self.material(&place, position, width);
        let bsdf = Bsdf::new(&material, place.geometric, place.shading, -path.ray.direction);
        let (emission, species) = (material.emission, material.species);
        Vertex { position, bsdf, emission, species, plant: place.plant }
    }

    /// The material at a place, with its texture as seen through a window of a width, m, and its
    /// variation from organ to organ and plant to plant.
    fn material(&self, place: &Place, position: Vec3, width: f32) -> Material {
        let mut material = self.scene.materials[usize::from(place.face.material)];
        if let (true, Some(colors)) = (material.is_ground, &self.scene.colors) {
            material.reflectance = colors.reflectance(position.x, position.y);
            return material;
        }
        if let Some(texture) = material.texture {
            let color = self.scene.levels.paints.color(texture, place, width);
            material.reflectance *= color;
            material.transmittance *= color;
        }
        let variation = material.variation * self.variation;
        if variation > 0.0 {
            let organ = f32::from(place.face.shade) / 65536.0;
            let plant = (mix(place.plant) >> 40) as f32 / (1 << 24) as f32;
            let grain = 0.5 + 0.5 * value(40.0 * (position.x + position.y), 18.0 * position.z, 9);
            let mixed = if place.face.shade == 0 { grain } else { organ };
            let factor = 1.0 - variation * (0.65 * mixed + 0.35 * plant);
            material.reflectance *= factor;
            material.transmittance *= factor;
        }
        material
    }

    /// Remembers what the eye sees first.
    fn note(&self, path: &mut Path, vertex: &Vertex) {
        if path.seen.is_none() {
            path.seen = Some(Seen {
                position: vertex.position,
                albedo: vertex.bsdf.reflectance,
                normal: vertex.bsdf.normal,
                species: vertex.species,
                plant: vertex.plant,
            });
        }
    }

    /// Sky and sun at the end of a path.
    fn add_sky(&self, path: &mut Path) {
        let direction = path.ray.direction;
        let dome = &self.scene.dome;
        let weight =
            path.drawn.map_or(1.0, |(pdf, chance)| heuristic(pdf, chance * dome.pdf(direction)));
        path.gather(path.beta * dome.radiance(direction) * weight, path.bounces);
        if let (true, Some(sun)) = (path.is_straight, &dome.sun)
            && sun.covers(direction)
        {
            path.gather(path.beta * sun.radiance, path.bounces);
        }
    }

    /// Air between the eye and what it sees: it dims, and glows like the sky at the horizon.
    fn add_haze(&self, path: &mut Path, distance: f32) {
        if self.scene.haze == 0.0 {
            return;
        }
        let clear = libm::expf(-self.scene.haze * distance);
        // A few degrees above the horizon, in the direction of the ray.
        let level = Vec3::new(path.ray.direction.x, path.ray.direction.y, 0.0);
        let glow =
            self.scene.dome.radiance((level.normalize_or(Vec3::Y) + 0.06 * Vec3::Z).normalize());
        path.gather(path.beta * glow * (1.0 - clear), path.bounces);
        path.beta *= clear;
    }

    /// Connects to the lights, then goes on from a surface.
    fn scatter(
        &self,
        path: &mut Path,
        vertex: &Vertex,
        sampler: &mut Sampler,
        scratch: &mut Scratch,
    ) -> bool {
        let view = -path.ray.direction;
        let from = |direction: Vec3| {
            let side = vertex.bsdf.geometric * vertex.bsdf.geometric.dot(direction).signum();
            vertex.position + side * clearance(vertex.position)
        };
        let evaluate = |direction: Vec3| {
            let scatter = vertex.bsdf.evaluate(view, direction);
            (scatter.value, scatter.pdf)
        };
        let chance = self.connect(path, sampler, scratch, &from, &evaluate);
        path.bounces += 1;
        if self.is_direct {
            return false;
        }
        let [u, v, w, survival] = sampler.next();
        if path.bounces >= self.bounces {
            return self.finish(path, vertex, [u, v, w], &from, scratch);
        }
        let Some(sample) = vertex.bsdf.sample(view, [u, v, w]) else {
            return false;
        };
        path.beta *= sample.weight;
        path.width += path.spread * vertex.position.distance(path.ray.origin);
        path.spread = path.spread.max(SCATTERED_SPREAD);
        path.ray = Ray { origin: from(sample.direction), direction: sample.direction };
        path.drawn = Some((sample.pdf, chance));
        path.is_straight = false;
        survives(path, survival)
    }

    /// The last scattering: only the connections count, and the way to the sky that they share
    /// their weight with.
    fn finish(
        &self,
        path: &mut Path,
        vertex: &Vertex,
        u: [f32; 3],
        from: &dyn Fn(Vec3) -> Vec3,
        scratch: &mut Scratch,
    ) -> bool {
        let view = -path.ray.direction;
        let Some(sample) = vertex.bsdf.sample(view, u) else {
            return false;
        };
        let ray = Ray { origin: from(sample.direction), direction: sample.direction };
        path.beta *= sample.weight;
        self.meet_light(path, &ray, scratch);
        let reach = self.reach(path, &ray, scratch);
        if reach != Vec3::ZERO {
            let dome = &self.scene.dome;
            let chance = if path.bounces == 1 { 1.0 } else { 1.0 - self.sun_chance() };
            let weight = heuristic(sample.pdf, chance * dome.pdf(ray.direction));
            let light = dome.radiance(ray.direction) * weight * reach;
            path.gather(path.beta * light, path.bounces);
        }
        false
    }

    /// Adds what shines at the end of the last ray of a path.
    fn meet_light(&self, path: &mut Path, ray: &Ray, scratch: &mut Scratch) {
        if !self.scene.has_lights || path.in_water {
            return;
        }
        let levels = &self.scene.levels;
        scratch.rays += 1;
        let hit = levels.nearest(self.scene.solid, ray, f32::INFINITY, &mut scratch.stack);
        if hit.is_some() {
            let place = levels.place(self.scene.solid, &hit);
            let material = &self.scene.materials[usize::from(place.face.material)];
            path.gather(path.beta * material.emission, path.bounces);
        }
    }

    /// Chance that a later connection goes to the sun.
    fn sun_chance(&self) -> f32 {
        if self.scene.dome.sun.is_some() { SUN_CHANCE } else { 0.0 }
    }

    /// Connects a vertex to sun and sky; returns the chance with which the sky was connected to.
    ///
    /// The first vertex is connected to both, later ones to one of them.
    fn connect(
        &self,
        path: &mut Path,
        sampler: &mut Sampler,
        scratch: &mut Scratch,
        from: &dyn Fn(Vec3) -> Vec3,
        evaluate: &dyn Fn(Vec3) -> (Vec3, f32),
    ) -> f32 {
        let dome = &self.scene.dome;
        let [u, v, a, b] = sampler.next();
        let is_first = path.bounces == 0;
        let sun_chance = self.sun_chance();
        // The same number chooses and, stretched again, draws.
        let is_sun = u < sun_chance;
        let (sun_u, sky_u, sun_weight, sky_chance) = if is_first {
            (Some([u, v]), Some([a, b]), 1.0, 1.0)
        } else if is_sun {
            (Some([u / sun_chance, v]), None, 1.0 / sun_chance, 1.0 - sun_chance)
        } else {
            (None, Some([a, b]), 1.0, 1.0 - sun_chance)
        };
        if let (Some(u), Some(sun)) = (sun_u, &dome.sun) {
            let light = sun.sample(u);
            let (value, _) = evaluate(light.direction);
            let gain = path.beta * value * light.radiance * (sun_weight / light.pdf);
            self.add_connection(path, light.direction, gain, scratch, from);
        }
        if let Some(u) = sky_u {
            let light = dome.sample(u);
            let (value, pdf) = evaluate(light.direction);
            let density = light.pdf * sky_chance;
            let share = if self.is_direct { 1.0 } else { heuristic(density, pdf) };
            let weight = share / density;
            let gain = path.beta * value * light.radiance * weight;
            self.add_connection(path, light.direction, gain, scratch, from);
        }
        sky_chance
    }

    /// Adds light that comes from a direction unless something stands in its way.
    fn add_connection(
        &self,
        path: &mut Path,
        direction: Vec3,
        gain: Vec3,
        scratch: &mut Scratch,
        from: &dyn Fn(Vec3) -> Vec3,
    ) {
        if gain.max_element() > 0.0 {
            let ray = Ray { origin: from(direction), direction };
            let reach = self.reach(path, &ray, scratch);
            path.gather(gain * reach, path.bounces + 1);
        }
    }

    /// Part of the light from far away that comes down a ray: none behind things, some under
    /// water and, where nothing is scattered twice, through leaves.
    fn reach(&self, path: &Path, ray: &Ray, scratch: &mut Scratch) -> Vec3 {
        let (scene, levels) = (self.scene, &self.scene.levels);
        let passes = if self.is_direct {
            self.through_leaves(ray, scratch)
        } else {
            scratch.rays += 1;
            let is_blocked = levels.is_blocked(scene.solid, ray, f32::INFINITY, &mut scratch.stack);
            if is_blocked { Vec3::ZERO } else { Vec3::ONE }
        };
        if passes == Vec3::ZERO || !path.in_water {
            return passes;
        }
        let surface = levels.nearest(scene.water, ray, f32::INFINITY, &mut scratch.stack);
        if !surface.is_some() {
            return Vec3::ZERO;
        }
        passes * pane(ray.direction) * water::transmittance(surface.t)
    }

    /// Part of the light that comes down a ray through leaves: the product of what they transmit.
    fn through_leaves(&self, ray: &Ray, scratch: &mut Scratch) -> Vec3 {
        let (scene, mut ray) = (self.scene, *ray);
        let mut passes = Vec3::ONE;
        while passes.max_element() > LEAST_PASSING {
            scratch.rays += 1;
            let hit = scene.levels.nearest(scene.solid, &ray, f32::INFINITY, &mut scratch.stack);
            if !hit.is_some() {
                return passes;
            }
            let place = scene.levels.place(scene.solid, &hit);
            if scene.materials[usize::from(place.face.material)].transmittance == Vec3::ZERO {
                return Vec3::ZERO;
            }
            let position = ray.origin + hit.t * ray.direction;
            passes *= self.material(&place, position, SCATTERED_SPREAD * hit.t).transmittance;
            ray.origin = position + clearance(position) * ray.direction;
        }
        Vec3::ZERO
    }

    /// Meets the water's surface: a mirror or a window for the eye's own ray and for light from
    /// above, a dimming pane for light that was scattered below.
    fn cross_water(&self, path: &mut Path, t: f32, sampler: &mut Sampler) -> bool {
        path.crossings += 1;
        if path.crossings > CROSSINGS {
            return false;
        }
        let position = path.ray.origin + t * path.ray.direction;
        let direction = path.ray.direction;
        let is_rising = direction.z > 0.0;
        if is_rising && !path.is_straight {
            // Connections from below cross straight, so this way of reaching the sky must too.
            path.beta *= pane(direction);
            path.ray.origin = position + Vec3::Z * clearance(position);
            path.in_water = false;
            return path.beta.max_element() > 0.0;
        }
        let ripple = self.scene.ripples.normal(position.x, position.y);
        let normal = if is_rising { -ripple } else { ripple };
        if path.seen.is_none() {
            let albedo = water::SCATTERING_ALBEDO * 0.1;
            path.seen = Some(Seen { position, albedo, normal: ripple, species: 0, plant: 0 });
            self.add_haze(path, t);
        }
        let cos = -direction.dot(normal);
        let [u, ..] = sampler.next();
        path.drawn = None;
        let refracted = water::refract(direction, normal, is_rising);
        match refracted {
            Some(through) if u >= water::reflectance(cos, is_rising) => {
                path.in_water = !is_rising;
                path.ray =
                    Ray { origin: position - normal * clearance(position), direction: through };
            }
            _ => {
                let mirrored = direction + 2.0 * cos * normal;
                // A ripple that leans far may mirror a flat ray into the water.
                let up = normal.z.signum();
                let lifted = mirrored.with_z(up * (up * mirrored.z).max(1e-3));
                let direction = lifted.normalize();
                path.ray = Ray { origin: position + normal * clearance(position), direction };
            }
        }
        true
    }

    /// Scatters inside the water.
    fn scatter_in_water(
        &self,
        path: &mut Path,
        flight: f32,
        u: [f32; 2],
        sampler: &mut Sampler,
        scratch: &mut Scratch,
    ) -> bool {
        let position = path.ray.origin + flight * path.ray.direction;
        path.beta *= water::SCATTERING_ALBEDO;
        // Isotropic: the phase function and its density are both 1 / 4π.
        let phase = 0.25 * std::f32::consts::FRAC_1_PI;
        let evaluate = |_| (Vec3::splat(phase), phase);
        let chance = self.connect(path, sampler, scratch, &|_| position, &evaluate);
        path.bounces += 1;
        if path.bounces >= self.bounces {
            return false;
        }
        path.ray = Ray { origin: position, direction: any_direction(u) };
        path.drawn = Some((phase, chance));
        path.is_straight = false;
        let [survival, ..] = sampler.next();
        survives(path, survival)
    }
}

/// Ends a path at random when it carries little; those that live carry more.
fn survives(path: &mut Path, u: f32) -> bool {
    let carried = luminance(path.beta.to_array());
    if carried <= 0.0 {
        return false;
    }
    if path.bounces <= SURE_BOUNCES {
        return true;
    }
    let chance = (WORTH * carried).clamp(0.05, 0.95);
    path.beta /= chance;
    u < chance
}

/// The power heuristic of two densities [Veach97] eq. 9.13, written so that infinities stay out.
fn heuristic(mine: f32, other: f32) -> f32 {
    if mine <= 0.0 {
        return 0.0;
    }
    let ratio = other / mine;
    1.0 / (1.0 + ratio * ratio)
}

/// Part of the light that passes the water's surface on a straight, unrefracted way.
fn pane(direction: Vec3) -> f32 {
    1.0 - water::reflectance(direction.z.abs(), false)
}

/// Distance by which rays start off a surface: more than the rounding of its position.
fn clearance(position: Vec3) -> f32 {
    1e-4 + 1.5e-6 * position.abs().max_element()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::accel::Triangle;
    use crate::primitive::Face;
    use crate::sky::Dome;
    use weald_contract::{Silent, Written};

    fn material(reflectance: f32, transmittance: f32) -> Material {
        Material {
            reflectance: Vec3::splat(reflectance),
            transmittance: Vec3::splat(transmittance),
            emission: Vec3::ZERO,
            roughness: 1.0,
            variation: 0.0,
            is_ground: false,
            texture: None,
            species: 1,
        }
    }

    fn triangle(corners: [Vec3; 3]) -> Triangle {
        let normal = (corners[1] - corners[0]).cross(corners[2] - corners[0]).normalize();
        Triangle::new(corners, Face::new([normal; 3], 0))
    }

    /// Level ground of 200 m at height 0.
    fn plane() -> Vec<Triangle> {
        let corner = |x: f32, y: f32| Vec3::new(100.0 * x, 100.0 * y, 0.0);
        let (a, b, c, d) =
            (corner(-1.0, -1.0), corner(1.0, -1.0), corner(1.0, 1.0), corner(-1.0, 1.0));
        vec![triangle([a, b, c]), triangle([a, c, d])]
    }

    /// Leaves at random in a box of 2 m.
    fn leaves(count: usize) -> Vec<Triangle> {
        let mut chance = Seed(9).stream("leaves", 0);
        let mut point =
            |reach: f64| Vec3::from_array([0; 3].map(|_| chance.around(0.0, reach) as f32));
        let mut leaf = || {
            let a = point(1.0);
            triangle([a, a + point(0.3), a + point(0.3)])
        };
        (0..count).map(|_| leaf()).collect()
    }

    /// Mean light of many samples along rays.
    fn mean(scene: &Scene, bounces: u32, samples: u32, ray: impl Fn(u32) -> Ray) -> Vec3 {
        let tracer = Tracer::new(scene, bounces, Light::Paths);
        let mut scratch = Scratch::default();
        let light = |number: u32| {
            let mut sampler = Sampler::new(Seed(1), 5, number);
            tracer.trace(ray(number), [0.0; 2], &mut sampler, &mut scratch).light.as_dvec3()
        };
        ((0..samples).map(light).sum::<glam::DVec3>() / f64::from(samples)).as_vec3()
    }

    /// Rays from all around towards a box at the origin.
    fn inwards(number: u32) -> Ray {
        let mut chance = Seed(4).stream("inwards", number.into());
        let direction = any_direction([chance.unit() as f32, chance.unit() as f32]);
        let aside = Vec3::from_array([0; 3].map(|_| chance.around(0.0, 0.7) as f32));
        Ray { origin: aside - 5.0 * direction, direction }
    }

    #[test]
    fn lossless_leaves_vanish_in_a_white_furnace() {
        for (reflectance, transmittance) in [(0.5, 0.5), (1.0, 0.0), (0.2, 0.8)] {
            let materials = vec![material(reflectance, transmittance)];
            let scene = Scene::of_mesh(&leaves(150), materials, Dome::constant(1.0));
            let light = mean(&scene, 64, 30_000, inwards);
            assert!((light - 1.0).abs().max_element() < 0.005, "{light}");
        }
    }

    #[test]
    fn lossless_leaves_with_bent_normals_vanish_in_a_white_furnace_too() {
        let mut chance = Seed(11).stream("bent", 0);
        let mut bent: Vec<Triangle> = leaves(150);
        for leaf in &mut bent {
            let [a, b, c] = leaf.corners;
            let flat = (b - a).cross(c - a).normalize();
            let normals = [0; 3].map(|_| {
                let aside = Vec3::from_array([0; 3].map(|_| chance.around(0.0, 0.5) as f32));
                (flat + aside).normalize()
            });
            leaf.face = Face::new(normals, 0);
        }
        for (reflectance, transmittance) in [(0.5, 0.5), (1.0, 0.0)] {
            let materials = vec![material(reflectance, transmittance)];
            let scene = Scene::of_mesh(&bent, materials, Dome::constant(1.0));
            let light = mean(&scene, 64, 30_000, inwards);
            assert!((light - 1.0).abs().max_element() < 0.005, "{light}");
        }
    }

    #[test]
    fn the_bounce_limit_changes_nothing_where_one_scattering_is_all() {
        // Level ground sees only the sky: ρ E / π whatever the limit.
        let dome = Dome::constant(1.0);
        let scene = Scene::of_mesh(&plane(), vec![material(0.6, 0.0)], dome);
        let down = |_| Ray { origin: Vec3::new(0.1, 0.2, 2.0), direction: -Vec3::Z };
        for bounces in [1, 2, 6] {
            let light = mean(&scene, bounces, 4000, down);
            assert!((light.x - 0.6).abs() < 0.005, "{bounces} bounces gave {light}");
        }
    }

    #[test]
    fn sunlit_ground_has_the_radiance_of_its_irradiance() {
        let dome = Dome::new(&crate::Sky::clear_day()).only_sun();
        let sun = dome.sun.unwrap();
        let solid_angle = 1.0 / sun.sample([0.5, 0.5]).pdf;
        let expected = sun.radiance * solid_angle * sun.direction.z * 0.3 / std::f32::consts::PI;
        let scene = Scene::of_mesh(&plane(), vec![material(0.3, 0.1)], dome);
        let down = |_| Ray { origin: Vec3::new(0.1, 0.2, 2.0), direction: -Vec3::Z };
        let light = mean(&scene, 6, 1000, down);
        assert!((light / expected - 1.0).abs().max_element() < 1e-3, "{light} {expected}");
        // Through a leaf as large as the world comes what it transmits.
        let up = |_| Ray { origin: Vec3::new(0.1, 0.2, -2.0), direction: Vec3::Z };
        let through = mean(&scene, 6, 1000, up);
        assert!((through * 3.0 / expected - 1.0).abs().max_element() < 1e-3, "{through}");
    }

    #[test]
    fn skylit_ground_has_the_radiance_of_its_irradiance() {
        let mut dome = Dome::new(&crate::Sky::clear_day());
        dome.sun = None;
        let expected = dome.irradiance() * 0.5 / std::f32::consts::PI;
        let scene = Scene::of_mesh(&plane(), vec![material(0.5, 0.0)], dome);
        let down = |_| Ray { origin: Vec3::new(0.1, 0.2, 2.0), direction: -Vec3::Z };
        let light = mean(&scene, 6, 20_000, down);
        assert!((light / expected - 1.0).abs().max_element() < 0.01, "{light} {expected}");
    }

    /// The walls of a room of 2 m around the origin.
    fn room() -> Vec<Triangle> {
        let corner = |i: usize| {
            Vec3::from_array([0, 1, 2].map(|axis| if i >> axis & 1 == 1 { 1.0 } else { -1.0 }))
        };
        let quads =
            [[0, 1, 3, 2], [4, 5, 7, 6], [0, 1, 5, 4], [2, 3, 7, 6], [0, 2, 6, 4], [1, 3, 7, 5]];
        let quads = quads.iter().map(|quad| quad.map(corner));
        quads.flat_map(|[a, b, c, d]| [triangle([a, b, c]), triangle([a, c, d])]).collect()
    }

    /// Rays in all directions from a place in the room.
    fn outwards(number: u32) -> Ray {
        Ray { origin: Vec3::new(0.3, -0.2, 0.1), direction: inwards(number).direction }
    }

    #[test]
    fn no_light_leaks_into_a_closed_room() {
        let scene = Scene::of_mesh(&room(), vec![material(0.9, 0.0)], Dome::constant(1.0));
        assert_eq!(mean(&scene, 20, 5000, outwards), Vec3::ZERO);
    }

    #[test]
    fn a_closed_room_that_emits_what_it_absorbs_shines_with_one_everywhere() {
        // L = E + ρ L, so that E = 1 - ρ gives L = 1, whatever the shape of the room.
        for albedo in [0.3, 0.6, 0.8] {
            let walls = Material { emission: Vec3::splat(1.0 - albedo), ..material(albedo, 0.0) };
            let scene = Scene::of_mesh(&room(), vec![walls], Dome::constant(0.0));
            let light = mean(&scene, 64, 40_000, outwards);
            assert!((light - 1.0).abs().max_element() < 0.005, "{albedo}: {light}");
            // A path of one scattering sees the walls and their first reflection.
            let first = mean(&scene, 1, 2_000, outwards);
            let expected = (1.0 - albedo) * (1.0 + albedo);
            assert!((first - expected).abs().max_element() < 1e-4, "{albedo}: {first}");
        }
    }

    #[test]
    fn a_slab_of_random_leaves_transmits_by_beer_and_lambert() {
        // Black leaves of random orientation: a ray passes leaf area density times path with
        // probability exp(-G LAI), where G = 1/2 for the spherical leaf angle distribution.
        let mut chance = Seed(12).stream("slab", 0);
        let (count, half, side) = (12_000, 4.0, 0.08f32);
        let mut slab = Vec::new();
        for _ in 0..count {
            let at = [0; 3].map(|_| chance.around(0.0, half) as f32);
            let normal = any_direction([chance.unit() as f32, chance.unit() as f32]);
            let (x, y) = normal.any_orthonormal_pair();
            let (a, x, y) = (Vec3::from(at), x * side, y * side);
            slab.extend([triangle([a, a + x, a + x + y]), triangle([a, a + x + y, a + y])]);
        }
        let area_density = f64::from(count) * f64::from(side * side) / (2.0 * half).powi(3);
        let path = 6.0;
        let expected = (-0.5 * area_density * path).exp();
        let scene = Scene::of_mesh(&slab, vec![material(0.0, 0.0)], Dome::constant(1.0));
        let mut stack = Stack::default();
        let rays = 20_000;
        let passes = (0..rays).filter(|_| {
            let aside = [0; 2].map(|_| chance.around(0.0, 0.8 * half) as f32);
            let ray = Ray { origin: Vec3::new(aside[0], aside[1], 3.0), direction: -Vec3::Z };
            !scene.levels.is_blocked(scene.solid, &ray, path as f32, &mut stack)
        });
        let got = passes.count() as f64 / f64::from(rays);
        assert!((got - expected).abs() < 0.03 * expected.max(0.3), "{got} {expected}");
    }

    #[test]
    fn direct_light_is_dimmed_by_each_leaf_on_its_way() {
        // Ground under two sheets that transmit 0.4: the sun's irradiance times 0.16.
        let sheet = |z: f32, material: u16| {
            plane().into_iter().map(move |t| {
                let corners = t.corners.map(|corner| corner + z * Vec3::Z);
                Triangle::new(corners, Face::new([Vec3::Z; 3], material))
            })
        };
        let leaves = [material(0.5, 0.0), material(0.3, 0.4)];
        let light = |sheets: u16| {
            let mut list = plane();
            list.extend((0..sheets).flat_map(|number| sheet(2.0 + f32::from(number), 1)));
            let dome = Dome::new(&crate::Sky::clear_day()).only_sun();
            let scene = Scene::of_mesh(&list, leaves.to_vec(), dome);
            let tracer = Tracer::new(&scene, 6, Light::Direct);
            let down = Ray { origin: Vec3::new(0.1, 0.2, 1.0), direction: -Vec3::Z };
            let mut sampler = Sampler::new(Seed(1), 5, 0);
            tracer.trace(down, [0.0; 2], &mut sampler, &mut Scratch::default()).light
        };
        let open = light(0);
        for (sheets, expected) in [(1, 0.4), (2, 0.16)] {
            let part = light(sheets) / open;
            assert!((part - expected).abs().max_element() < 1e-3, "{part} through {sheets}");
        }
    }

    #[test]
    fn direct_light_of_an_open_place_is_that_of_paths() {
        let dome = Dome::new(&crate::Sky::clear_day());
        let scene = Scene::of_mesh(&plane(), vec![material(0.5, 0.0)], dome);
        let down = Ray { origin: Vec3::new(0.1, 0.2, 2.0), direction: -Vec3::Z };
        let mean = |light: Light| {
            let tracer = Tracer::new(&scene, 6, light);
            let mut scratch = Scratch::default();
            let mut one = |number: u32| {
                let mut sampler = Sampler::new(Seed(1), 5, number);
                tracer.trace(down, [0.0; 2], &mut sampler, &mut scratch).light.as_dvec3()
            };
            (0..20_000).map(&mut one).sum::<glam::DVec3>() / 20_000.0
        };
        let part = mean(Light::Direct) / mean(Light::Paths);
        assert!((part - 1.0).abs().max_element() < 3e-3, "{part}");
    }

    fn config() -> Config {
        Config {
            view: Written::default(),
            resolution: [40, 24],
            samples: 3,
            noise: 0.0,
            bounces: 5,
            variation: 1.0,
            light: Light::Paths,
            denoise: false,
            exposure: 0.0,
            aperture_mm: 20.0,
        }
    }

    fn small(scene: &Scene, seed: u64) -> Film {
        film(scene, seed, &config())
    }

    fn film(scene: &Scene, seed: u64, config: &Config) -> Film {
        let view = View {
            name: "v".into(),
            stand_at: [0.0, -4.0],
            eye_height: 0.5,
            look_at: [0.0, 0.0],
            look_height: 0.0,
            fov_deg: 50.0,
            projection: weald_contract::Projection::Perspective,
        };
        render(scene, &view, config, Seed(seed), &Silent).unwrap()
    }

    fn with_threads<T: Send>(threads: usize, work: impl FnOnce() -> T + Send) -> T {
        rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap().install(work)
    }

    #[test]
    fn the_picture_has_the_same_bits_on_one_and_two_threads() {
        let make = || {
            let dome = Dome::new(&crate::Sky::clear_day());
            let scene = Scene::of_mesh(&leaves(20_000), vec![material(0.4, 0.3)], dome);
            small(&scene, 3).picture()
        };
        let bits = |picture: weald_contract::Picture| -> Vec<u32> {
            picture.channels.into_iter().flat_map(|c| c.values).map(f32::to_bits).collect()
        };
        assert_eq!(bits(with_threads(1, make)), bits(with_threads(2, make)));
    }

    #[test]
    fn an_empty_scene_is_the_sky() {
        let scene = Scene::of_mesh(&[], vec![], Dome::constant(0.7));
        let picture = small(&scene, 1).picture();
        assert!(picture.channel("G").unwrap().iter().all(|g| (g - 0.7).abs() < 1e-6));
        assert!(picture.channel("A").unwrap().iter().all(|&a| a == 0.0));
    }

    #[test]
    fn a_rendering_stops_when_asked() {
        struct Stop;
        impl Progress for Stop {
            fn begin(&self, _: &str, _: u64, _: &str) {}
            fn advance(&self, _: u64) {}
            fn is_cancelled(&self) -> bool {
                true
            }
        }
        let scene = Scene::of_mesh(&[], vec![], Dome::constant(1.0));
        let config = config();
        let view = View {
            name: "v".into(),
            stand_at: [0.0; 2],
            eye_height: 1.0,
            look_at: [1.0; 2],
            look_height: 0.0,
            fov_deg: 50.0,
            projection: weald_contract::Projection::Perspective,
        };
        let result = render(&scene, &view, &config, Seed(1), &Stop);
        assert!(matches!(result, Err(Error::Cancelled)));
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn our_walk_outruns_that_of_obvhs_on_the_rays_of_probe() {
        use obvhs::{BvhBuildParams, ray::RayHit, rt_triangle::RtTriangle, triangle::Triangle};
        use std::time::{Duration, Instant};
        // Leaves of 6 to 10 cm in a box of 20 m, about 1 m²/m³: the inside of a crown.
        let mut chance = Seed(9).stream("crown", 0);
        let mut point = |reach: f64| [0; 3].map(|_| chance.around(0.0, reach) as f32);
        let list: Vec<_> = (0..500_000)
            .map(|_| {
                let a = Vec3::from(point(10.0));
                triangle([a, a + Vec3::from(point(0.1)), a + Vec3::from(point(0.1))])
            })
            .collect();
        let theirs: Vec<Triangle> = list
            .iter()
            .map(|t| {
                let [v0, v1, v2] = t.corners.map(glam::Vec3A::from);
                Triangle { v0, v1, v2 }
            })
            .collect();
        let scene = Scene::of_mesh(&list, vec![material(0.5, 0.0)], Dome::constant(1.0));
        let count = 1_000_000;
        let rays: Vec<Ray> =
            crate::probe::random_rays(scene.bounds(), Seed(1), 0).take(count).collect();
        let best = |name: &str, walk: &mut dyn FnMut(&Ray) -> bool| {
            let mut once = || {
                let start = Instant::now();
                let met = rays.iter().filter(|&ray| walk(ray)).count();
                (start.elapsed(), met)
            };
            let (time, met) = (0..3).map(|_| once()).min().unwrap();
            println!("{name}: {:.3} Mrays/s, {met} met", count as f64 / time.as_secs_f64() / 1e6);
            (time, met)
        };
        let mut stack = Stack::default();
        let (ours, met) = best("ours", &mut |ray| {
            scene.levels.nearest(scene.solid, ray, f32::INFINITY, &mut stack).is_some()
        });
        let to_theirs =
            |ray: &Ray| obvhs::ray::Ray::new_inf(ray.origin.into(), ray.direction.into());
        let packed = |order: &[u32]| -> Vec<RtTriangle> {
            order.iter().map(|&i| RtTriangle::from(&theirs[i as usize])).collect()
        };
        let mut build_time = Duration::default();
        let params = BvhBuildParams::medium_build();
        let binary = obvhs::bvh2::builder::build_bvh2_from_tris(&theirs, params, &mut build_time);
        let list = packed(&binary.primitive_indices);
        let (two, met_two) = best("obvhs BVH2", &mut |ray| {
            let mut hit = RayHit::none();
            binary.ray_traverse(to_theirs(ray), &mut hit, |ray, id| list[id].intersect(ray))
        });
        let wide = obvhs::cwbvh::builder::build_cwbvh_from_tris(&theirs, params, &mut build_time);
        let list = packed(&wide.primitive_indices);
        let (eight, met_eight) = best("obvhs CWBVH", &mut |ray| {
            let mut hit = RayHit::none();
            wide.ray_traverse(to_theirs(ray), &mut hit, |ray, id| list[id].intersect(ray))
        });
        // A ray within a rounding error of an edge may go either way.
        assert!(met.abs_diff(met_two) < count / 1000 && met.abs_diff(met_eight) < count / 1000);
        assert!(ours < two && ours < eight);
    }

    fn leafy() -> Scene {
        let dome = Dome::new(&crate::Sky::clear_day());
        Scene::of_mesh(&leaves(300), vec![material(0.4, 0.3)], dome)
    }

    #[test]
    fn direct_and_indirect_light_are_those_of_one_scattering_and_of_more() {
        // In a room of albedo 0.6 that emits 0.4, the first two terms of 0.4 Σ 0.6^k are direct.
        let walls = Material { emission: Vec3::splat(0.4), ..material(0.6, 0.0) };
        let scene = Scene::of_mesh(&room(), vec![walls], Dome::constant(0.0));
        let tracer = Tracer::new(&scene, 64, Light::Paths);
        for number in 0..200 {
            let mut sampler = Sampler::new(Seed(1), 5, number);
            let got =
                tracer.trace(outwards(number), [0.0; 2], &mut sampler, &mut Scratch::default());
            assert!((got.direct.x - 0.4 * 1.6).abs() < 1e-5, "{}", got.direct);
        }
        // With one scattering there is no other light.
        let once = film(&leafy(), 1, &Config { bounces: 1, ..config() }).picture();
        assert!(once.channel("indirect.G").unwrap().iter().all(|&light| light.abs() < 1e-6));
        let more = small(&leafy(), 1).picture();
        let [all, direct, indirect] =
            ["G", "direct.G", "indirect.G"].map(|name| more.channel(name).unwrap());
        assert!(indirect.iter().any(|&light| light > 0.0));
        for ((all, direct), indirect) in all.iter().zip(direct).zip(indirect) {
            assert!((all - direct - indirect).abs() < 1e-4 * all.max(1.0));
        }
    }

    #[test]
    fn colours_vary_as_much_as_the_scene_asks() {
        let varied = Material { variation: 0.16, ..material(0.4, 0.3) };
        let mut list = leaves(3000);
        for (leaf, number) in list.iter_mut().zip(1..) {
            leaf.face.shade = mix(number) as u16;
        }
        let scene = Scene::of_mesh(&list, vec![varied], Dome::constant(1.0));
        let albedo = |variation: f32| {
            let config = Config { variation, samples: 1, ..config() };
            let picture = film(&scene, 1, &config).picture();
            let seen = picture.channel("A").unwrap().iter().map(|a| *a == 1.0);
            let values = picture.channel("albedo.G").unwrap().iter().copied();
            values.zip(seen).filter_map(|(v, seen)| seen.then_some(v / 0.4)).collect::<Vec<_>>()
        };
        assert!(albedo(0.0).iter().all(|part| (part - 1.0).abs() < 1e-6));
        // Of the factor 1 - v (0.65 u + 0.35 u'), u varies from leaf to leaf; all are of one plant.
        let (once, thrice) = (albedo(1.0), albedo(3.0));
        let mean = once.iter().sum::<f32>() / once.len() as f32;
        let plant = 1.0 - once.iter().copied().fold(0.0, f32::max);
        assert!(once.len() > 200 && once.iter().all(|part| (0.84..=1.0).contains(part)));
        assert!((mean - (1.0 - plant - 0.16 * 0.65 / 2.0)).abs() < 0.006, "{mean}, {plant}");
        let difference = |(a, b): (&f32, &f32)| (1.0 - b - 3.0 * (1.0 - a)).abs();
        assert!(once.iter().zip(&thrice).map(difference).fold(0.0, f32::max) < 1e-5);
    }

    #[test]
    fn more_samples_are_taken_only_where_there_is_noise() {
        let scene = leafy();
        let noise = 0.05;
        let wanted = Config { samples: 1024, noise, resolution: [64, 48], ..config() };
        let make = || film(&scene, 1, &wanted);
        let one = with_threads(1, make);
        let two = with_threads(2, make);
        let picture = one.picture();
        assert_eq!(picture, two.picture());
        let samples = picture.channel("samples").unwrap();
        // The upper corner is sky without a leaf; leaves against it need more.
        assert_eq!(samples[0], ROUND as f32);
        assert!(samples.iter().any(|&count| count > 2.0 * ROUND as f32));
        let total: f64 = samples.iter().map(|&count| f64::from(count)).sum();
        assert_eq!(one.statistics().samples, total as u64);
        // The claimed noise against a picture with four times the samples and other numbers.
        let fine = Config { samples: 600, noise: 0.0, ..wanted.clone() };
        let truth = film(&scene, 2, &fine);
        let (mut error, mut light, mut claimed) = (0.0, 0.0, 0.0);
        for (got, truth) in one.pixels.iter().zip(&truth.pixels) {
            let mean = |pixel: &Pixel| pixel.brightness() / f64::from(pixel.samples);
            error += (mean(got) - mean(truth)).powi(2) - truth.variance();
            claimed += got.variance();
            light += mean(truth);
        }
        let count = one.pixels.len() as f64;
        let measured = (error.max(0.0) / count).sqrt() / (light / count);
        assert!(measured < f64::from(noise), "{measured}");
        assert!(error < 1.1 * claimed, "{error} where {claimed} was claimed");
    }
}
