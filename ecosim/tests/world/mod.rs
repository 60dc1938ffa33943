//! A small world for tests: ground, species and steps from short texts.

#![allow(dead_code, reason = "each test file uses another part of the world")]

use std::collections::BTreeMap;
use weald_contract::{
    Crs, Frame, FromToml, Image, Layers, Population, Problems, Seed, Silent, Species, Value, View,
};
use weald_ecosim::{
    Checkpoint, Config, Course, Ecology, Error, Moment, Next, Outcome, Surroundings, Watch, grow_on,
};

pub struct World {
    pub terrain: Layers,
    pub species: BTreeMap<String, (Species, Ecology)>,
    pub images: BTreeMap<String, Image>,
    pub plants: BTreeMap<String, Population>,
    pub views: Vec<View>,
    pub seed: Seed,
}

/// Level, dry ground of `cells` x `cells` cells, with soil that grows wetter from west (0) to
/// east (1), at map coordinates far from 0.
pub fn plain(cells: usize, cell: f64) -> World {
    let frame = Frame { width: cells, height: cells, cell, west: 500_000.0, south: 5_200_000.0 };
    let mut terrain =
        Layers { frame, crs: Crs::default(), layers: BTreeMap::new(), detail: Vec::new() };
    let moisture = |i: usize| ((i % cells) as f32 + 0.5) / cells as f32;
    terrain.insert("altitude", "m", "height", vec![100.0; frame.len()]);
    terrain.insert("water_depth", "m", "depth", vec![0.0; frame.len()]);
    terrain.insert("soil_moisture", "1", "moisture", (0..frame.len()).map(moisture).collect());
    let (species, images, plants) = (BTreeMap::new(), BTreeMap::new(), BTreeMap::new());
    World { terrain, species, images, plants, views: Vec::new(), seed: Seed(7) }
}

impl World {
    /// Adds a species from the text of its file; `form` need not be given.
    pub fn with_species(mut self, name: &str, text: &str) -> Self {
        let text =
            if text.contains("group") { text.into() } else { format!("form = {{}}\n{text}") };
        let mut problems = Problems::new();
        let value = Value::parse(0, &text).unwrap();
        let species = Species::read(&value, &mut problems);
        assert_eq!(problems, []);
        let species = species.unwrap();
        let ecology = species.ecology.as_ref().and_then(|e| Ecology::from_toml(e, &mut problems));
        assert_eq!(problems, []);
        self.species.insert(name.into(), (species, ecology.unwrap_or_default()));
        self
    }

    /// Adds an image over the whole terrain.
    pub fn with_image(
        mut self,
        name: &str,
        width: usize,
        height: usize,
        value: impl Fn(usize, usize) -> f32,
    ) -> Self {
        let values = (0..width * height).map(|i| value(i % width, i / width)).collect();
        let image = Image { width, height, values, is_float: false, frame: None };
        self.images.insert(name.into(), image);
        self
    }

    /// Floods a disc, given in scene coordinates, with water of one depth.
    pub fn with_pond(mut self, x: f64, y: f64, radius: f64, depth: f32) -> Self {
        let frame = self.terrain.frame;
        let at = |i: usize| {
            let (cx, cy) = frame.center(i % frame.width, i / frame.width);
            let inside = (cx - frame.west - x).hypot(cy - frame.south - y) < radius;
            if inside { depth } else { 0.0 }
        };
        let depths = (0..frame.len()).map(at).collect();
        self.terrain.insert("water_depth", "m", "depth", depths);
        self
    }

    pub fn grow(&self, steps: &str) -> Result<Outcome, Error> {
        self.grow_from(steps, None)
    }

    pub fn grow_from(&self, steps: &str, start: Option<&Population>) -> Result<Outcome, Error> {
        self.grow_on(steps, start, Course::default())
    }

    pub fn grow_on(
        &self,
        steps: &str,
        start: Option<&Population>,
        course: Course<'_>,
    ) -> Result<Outcome, Error> {
        let around = Surroundings {
            terrain: &self.terrain,
            species: &self.species,
            images: &self.images,
            plants: &self.plants,
            views: &self.views,
        };
        grow_on(&config(steps), &around, start, self.seed, &Silent, course)
    }

    /// The state after so many years in all, reached with a stop at each of the `stops` before.
    pub fn stopped(&self, steps: &str, start: Option<&Population>, stops: &[u32]) -> Vec<u8> {
        let mut watch = StopAfter { years: 0, state: Vec::new() };
        let mut before = 0;
        for stop in stops {
            let from = (!watch.state.is_empty()).then(|| Checkpoint::read(&watch.state).unwrap());
            watch.years = stop - before;
            let course = Course::new(from, Some(&mut watch));
            let end = self.grow_on(steps, start, course);
            assert!(matches!(end, Err(Error::Paused)), "{end:?}");
            before = *stop;
        }
        watch.state
    }

    /// What comes of going on from a state.
    pub fn resumed(
        &self,
        steps: &str,
        start: Option<&Population>,
        state: &[u8],
    ) -> Result<Outcome, Error> {
        let from = Some(Checkpoint::read(state).map_err(|_| Error::Unfit("damaged"))?);
        self.grow_on(steps, start, Course::new(from, None))
    }

    /// Places of plants in scene coordinates.
    pub fn places(&self, population: &Population) -> Vec<[f64; 2]> {
        let frame = self.terrain.frame;
        population.plants.iter().map(|p| [p.x - frame.west, p.y - frame.south]).collect()
    }

    /// The problem that `steps` lead to, and the text that it points at.
    pub fn mistake(&self, steps: &str) -> (String, String) {
        match self.grow(steps) {
            Err(Error::Problem(problem)) => {
                let at = problem.span.map_or("", |s| &steps[s.start as usize..s.end as usize]);
                (problem.to_string(), at.to_string())
            }
            other => panic!("expected a problem, got {other:?}"),
        }
    }
}

pub fn config(steps: &str) -> Config {
    let mut problems = Problems::new();
    let config = Config::from_toml(&Value::parse(0, steps).unwrap(), &mut problems);
    assert_eq!(problems, []);
    config.unwrap()
}

/// Coefficient of variation of the distance to the nearest neighbour, of points at least
/// `margin` inside a square of side `side`.
pub fn unevenness(places: &[[f64; 2]], side: f64, margin: f64) -> f64 {
    let inside = |p: &&[f64; 2]| p.iter().all(|c| (margin..side - margin).contains(c));
    let distances: Vec<f64> = places
        .iter()
        .filter(inside)
        .map(|p| {
            let squared = |q: &[f64; 2]| (q[0] - p[0]).powi(2) + (q[1] - p[1]).powi(2);
            let others = places.iter().filter(|q| *q != p);
            others.map(squared).fold(f64::INFINITY, f64::min).sqrt()
        })
        .collect();
    let count = distances.len() as f64;
    let mean = distances.iter().sum::<f64>() / count;
    let variance = distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / count;
    variance.sqrt() / mean
}

pub const HERB: &str = "size = { height = 0.5, crown_radius = 0.2, lifespan = 3 }";
pub const TREE: &str = "size = { height = 18, crown_radius = 2.5, lifespan = 120 }";

/// A watch that keeps the state in memory and stops after so many years.
pub struct StopAfter {
    pub years: u32,
    pub state: Vec<u8>,
}

impl Watch for StopAfter {
    fn next(&mut self, years: u32) -> Next {
        self.years = self.years.saturating_sub(years);
        if self.years == 0 { Next::Stop } else { Next::GoOn }
    }

    fn save(&mut self, moment: &Moment<'_>) -> std::io::Result<()> {
        self.state.clear();
        moment.write(&mut self.state)
    }
}
