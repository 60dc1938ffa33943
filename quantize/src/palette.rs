//! From a population to palette and instances: the order of the work.

use crate::codebook::{Codebook, Mode, cluster_in_order, gains};
use crate::features::{COUNT, LEAST_HEIGHT, Traits};
use crate::groups::{self, Patches};
use crate::neighbours::{Beside, part};
use crate::report::{Report, SpeciesReport};
use crate::table::Table;
use crate::{Bytes, Config, Error, Quantized, budget};
use glam::{DQuat, Quat};
use rayon::prelude::*;
use std::collections::BTreeMap;
use std::f64::consts::{PI, TAU};
use weald_contract::instances::Instance;
use weald_contract::source::nearest;
use weald_contract::{
    Group, Instances, Palette, Plant, Population, Problem, Progress, Representative, Seed, Size,
    Species, Stream,
};

/// Where something stands.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Place {
    /// In the scene: the plant with this index, and its id.
    Scene { index: usize, id: u64 },
    /// In a patch: that patch's index, and the member's number.
    Patch { patch: usize, ordinal: usize },
}

impl Place {
    /// A random stream of this place's own.
    pub fn stream(self, seed: Seed, name: &str) -> Stream {
        match self {
            Place::Scene { id, .. } => seed.part("variant", 0).stream(name, id),
            Place::Patch { patch, ordinal } => {
                seed.part("variant", 1 + patch as u64).stream(name, ordinal as u64)
            }
        }
    }
}

/// One plant or patch of a species, wherever it stands.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Standing {
    pub place: Place,
    pub traits: Traits,
    /// Times it is seen in the scene: 1 there, and as often as its patch inside a patch.
    pub seen: f64,
    /// Sum over those times of the inverse squared distance from the eye, 1/m²; 0 without one.
    pub nearness: f64,
}

/// A plant nearer to the eye than this counts as if it stood there, m.
const NEAREST: f64 = 1.0;

/// How much plants out of the picture count beside those in it: their shadows and light still fall
/// into it. (Ours.)
const OUT_OF_PICTURE: f64 = 0.05;

fn nearness(plant: &Plant, config: &Config) -> f64 {
    let Some([x, y, z]) = config.eye else { return 0.0 };
    let apart = [plant.x - x, plant.y - y, f64::from(plant.z) - z];
    let nearness = 1.0 / apart.iter().map(|d| d * d).sum::<f64>().max(NEAREST * NEAREST);
    let Some(target) = config.target else { return nearness };
    let ahead = libm::atan2(target[1] - y, target[0] - x);
    let aside = (libm::atan2(apart[1], apart[0]) - ahead + PI).rem_euclid(TAU) - PI;
    // A crown is seen as soon as its edge is.
    let distance = libm::hypot(apart[0], apart[1]);
    let half = libm::asin((f64::from(plant.radius) / distance.max(1e-9)).min(1.0));
    let is_seen = aside.abs() <= 0.5 * config.fov_deg.to_radians() + half;
    if is_seen { nearness } else { OUT_OF_PICTURE * nearness }
}

/// See [`crate::quantize`].
pub(crate) fn build(
    config: &Config,
    population: &Population,
    species: &BTreeMap<String, Species>,
    bytes: Option<Bytes<'_>>,
    seed: Seed,
    progress: &dyn Progress,
) -> Result<Quantized, Error> {
    if let Some(problem) = config.check(species).into_iter().next() {
        return Err(problem.into());
    }
    if config.lacks_eye() {
        let problem = Problem::new("`weights = \"view\"` needs to know where the eye is");
        return Err(problem.hint("add `eye = [x, y, altitude]` in map coordinates").into());
    }
    let mut standing = standing_in_scene(population, species, config)?;
    let patches = groups::fill(config, population, species, &mut standing, seed)?;
    standing.retain(|_, plants| !plants.is_empty());
    progress.begin(
        "quantizing",
        standing.values().map(|plants| plants.len() as u64).sum(),
        "plants",
    );

    let counts = match bytes {
        Some(bytes) => counts_within(bytes, config, &standing, species, progress)?,
        None => representative_counts(config, &standing, species, progress)?,
    };
    let mut palette = Palette::default();
    let mut prototypes = Prototypes::new(population.len(), &patches);
    let mut reports = Vec::new();
    // By value: what a species took is given back before the next.
    for ((name, plants), count) in standing.into_iter().zip(counts) {
        stop_if_asked(progress)?;
        let (name, plants) = (name.as_str(), plants.as_slice());
        let Some(kind) = species.get(name) else { continue };
        let table = feature_table(config, &kind.size, plants)?;
        let (book, order) = match config.max_height_error {
            Some(most) => within_height(most.into(), config, plants, &table, count),
            None => cluster_in_order(&table, count, config.mode),
        };
        let first_id = palette.representatives.len() as u32 + 1;
        let (mut chosen, number) = representatives(name, plants, &table, &book, &order, first_id);
        let book = part_neighbours(config, population, plants, &table, book);
        count_plants(&mut chosen, &number, &book, &table, &order);
        for (plant, label) in plants.iter().zip(&book.labels) {
            let representative = &chosen[number[*label as usize]];
            let height = plant.traits.height.max(LEAST_HEIGHT);
            prototypes.set(plant.place, representative.id, height / representative.height);
        }
        reports.push(SpeciesReport::of(name, plants, &table, &book, &chosen, &number));
        palette.representatives.extend(chosen);
        progress.advance(plants.len() as u64);
    }
    add_groups(&mut palette, &mut prototypes, &patches);
    let instances = instances(population, &patches, &prototypes, &palette);
    let report = Report::of(reports, &palette, &instances, population.len());
    Ok(Quantized { palette, instances, report })
}

fn stop_if_asked(progress: &dyn Progress) -> Result<(), Error> {
    if progress.is_cancelled() { Err(Error::Cancelled) } else { Ok(()) }
}

/// The population's plants by species, checked.
fn standing_in_scene(
    population: &Population,
    species: &BTreeMap<String, Species>,
    config: &Config,
) -> Result<BTreeMap<String, Vec<Standing>>, Problem> {
    // Growing vectors would take up to twice as much.
    let mut counts = vec![0; population.species.len()];
    for plant in &population.plants {
        if let Some(count) = counts.get_mut(usize::from(plant.species)) {
            *count += 1;
        }
    }
    let mut by_index: Vec<Vec<Standing>> = counts.into_iter().map(Vec::with_capacity).collect();
    for (index, plant) in population.plants.iter().enumerate() {
        check_plant(plant)?;
        let Some(plants) = by_index.get_mut(usize::from(plant.species)) else {
            return Err(Problem::new(format!(
                "plant {} has species number {}, but the population names {}",
                plant.id,
                plant.species,
                population.species.len()
            )));
        };
        let place = Place::Scene { index, id: plant.id };
        let nearness = nearness(plant, config);
        plants.push(Standing { place, traits: Traits::of_plant(plant), seen: 1.0, nearness });
    }
    let mut standing = BTreeMap::new();
    for (name, plants) in population.species.iter().zip(by_index) {
        if !plants.is_empty() && !species.contains_key(name) {
            return Err(unknown_species(name, plants.len(), species));
        }
        // A name may stand twice in a foreign table.
        standing.entry(name.clone()).or_insert_with(Vec::new).extend(plants);
    }
    Ok(standing)
}

fn unknown_species(name: &str, plants: usize, species: &BTreeMap<String, Species>) -> Problem {
    let problem =
        Problem::new(format!("the population holds {plants} plants of unknown species `{name}`"));
    match nearest(name, species.keys().map(String::as_str)) {
        Some(near) => problem.hint(format!("did you mean `{near}`?")),
        None => problem.hint(format!("add a species file `{name}.toml`")),
    }
}

/// Refuses numbers that no plant can have, naming the plant.
fn check_plant(plant: &Plant) -> Result<(), Problem> {
    let lengths = [("age", plant.age), ("height", plant.height), ("radius", plant.radius)];
    let angles = [("yaw", plant.yaw), ("lean", plant.lean), ("lean_azimuth", plant.lean_azimuth)];
    let wrong = |name: &str, value: f64, right: &str| {
        Problem::new(format!("plant {}: `{name}` is {value}", plant.id)).hint(right)
    };
    for (name, value) in lengths {
        if !(value.is_finite() && value >= 0.0) {
            return Err(wrong(name, value.into(), "a finite number of at least 0 is right"));
        }
    }
    if !(0.0..=1.0).contains(&plant.vigor) {
        return Err(wrong("vigor", plant.vigor.into(), "a number from 0 to 1 is right"));
    }
    let places = [("x", plant.x), ("y", plant.y), ("z", plant.z.into())];
    let finite = places.into_iter().chain(angles.map(|(name, value)| (name, f64::from(value))));
    for (name, value) in finite {
        if !value.is_finite() {
            return Err(wrong(name, value, "a finite number is right"));
        }
    }
    Ok(())
}

/// Clusters of each species, in the order of `standing`.
fn representative_counts(
    config: &Config,
    standing: &BTreeMap<String, Vec<Standing>>,
    species: &BTreeMap<String, Species>,
    progress: &dyn Progress,
) -> Result<Vec<usize>, Error> {
    let Some(budget) = config.budget.map(|budget| budget as usize) else {
        return Ok(vec![config.representatives.max(1) as usize; standing.len()]);
    };
    if budget < standing.len() {
        let message = format!(
            "`quantize.budget` is {budget}, but {} species grow in the scene",
            standing.len()
        );
        let problem = Problem::new(message);
        return Err(problem.hint(format!("{} or more is right", standing.len())).into());
    }
    let most = budget - standing.len() + 1;
    let all_gains = all_gains(config, standing, species, |_| most, progress)?;
    let gains: Vec<&[f64]> = all_gains.iter().map(Vec::as_slice).collect();
    Ok(budget::share(&gains, budget))
}

/// Gains of splitting each species into at most the clusters that `most` allows it.
fn all_gains(
    config: &Config,
    standing: &BTreeMap<String, Vec<Standing>>,
    species: &BTreeMap<String, Species>,
    most: impl Fn(&str) -> usize,
    progress: &dyn Progress,
) -> Result<Vec<Vec<f64>>, Error> {
    let mut all = Vec::new();
    for (name, plants) in standing {
        stop_if_asked(progress)?;
        if let Some(kind) = species.get(name) {
            all.push(gains(&feature_table(config, &kind.size, plants)?, most(name)));
        }
    }
    Ok(all)
}

/// Most models of a species that a number of bytes is shared out to.
const MOST_WITHIN: u64 = 4096;

/// Clusters of each species that fit into a number of bytes, in the order of `standing`.
fn counts_within(
    bytes: Bytes<'_>,
    config: &Config,
    standing: &BTreeMap<String, Vec<Standing>>,
    species: &BTreeMap<String, Species>,
    progress: &dyn Progress,
) -> Result<Vec<usize>, Error> {
    let of_model = |name: &str| (bytes.of_model)(name).max(1);
    let most = |name: &str| (bytes.budget / of_model(name)).clamp(1, MOST_WITHIN) as usize;
    let all_gains = all_gains(config, standing, species, most, progress)?;
    let gains: Vec<&[f64]> = all_gains.iter().map(Vec::as_slice).collect();
    let of_models: Vec<u64> = standing.keys().map(|name| of_model(name)).collect();
    budget::share_bytes(&gains, &of_models, bytes.budget).ok_or_else(|| {
        let least: u64 = of_models.iter().sum();
        let message = format!(
            "one model of each of {} species takes {least} bytes, but {} are allowed",
            of_models.len(),
            bytes.budget
        );
        Problem::new(message).hint(format!("{least} or more are right")).into()
    })
}

/// The fewest clusters, from `least` on, in which no plant's height differs from its model's by
/// more than a part `most` of it.
///
/// More clusters may, seldom, leave a plant worse off; halving then finds a number that is enough
/// and nearly least. As many clusters as distinct plants always are.
fn within_height(
    most: f64,
    config: &Config,
    plants: &[Standing],
    table: &Table,
    least: usize,
) -> (Codebook, Vec<u32>) {
    let with = |count: usize| {
        let found = cluster_in_order(table, count, config.mode);
        let worst = worst_height(plants, table, &found.0, &found.1);
        (worst <= most).then_some(found)
    };
    let (mut few, mut enough) = (least, least);
    let mut found = with(enough);
    while found.is_none() && enough < plants.len() {
        few = enough;
        enough = (enough * 2).min(plants.len());
        found = with(enough);
    }
    while found.is_some() && few + 1 < enough {
        let middle = few.midpoint(enough);
        match with(middle) {
            Some(better) => (found, enough) = (Some(better), middle),
            None => few = middle,
        }
    }
    // Plants that are alike in all features and still of other heights are one cluster.
    found.unwrap_or_else(|| cluster_in_order(table, plants.len(), config.mode))
}

/// Plants nearer than this many median crown radii are neighbours: one and a half crowns.
const NEIGHBOURS: f64 = 3.0;

/// A model is about as good as another at up to this many times its distance.
const ABOUT_AS_GOOD: f64 = 1.1;

/// Gives another model that is about as good to plants of the scene that would stand beside their
/// own model with the same turn. Splitting alone stays as it is, and so do promises of a height.
fn part_neighbours(
    config: &Config,
    population: &Population,
    plants: &[Standing],
    table: &Table,
    mut book: Codebook,
) -> Codebook {
    let is_free = matches!(config.mode, Mode::Fast | Mode::Best);
    if !is_free || config.max_height_error.is_some() || book.len() < 2 {
        return book;
    }
    let in_scene = |(row, standing): (usize, &Standing)| {
        let Place::Scene { index, id } = standing.place else { return None };
        let plant = population.plants.get(index)?;
        Some((row, Beside { id, position: [plant.x, plant.y], yaw: plant.yaw.into() }))
    };
    let (rows, spots): (Vec<usize>, Vec<Beside>) =
        plants.iter().enumerate().filter_map(in_scene).unzip();
    let mut radii: Vec<f32> = rows.iter().map(|row| plants[*row].traits.radius).collect();
    let middle = radii.len() / 2;
    let reach = match radii.get(middle) {
        Some(_) => NEIGHBOURS * f64::from(*radii.select_nth_unstable_by(middle, f32::total_cmp).1),
        None => 0.0,
    };
    // Plants without a crown would all be far from each other.
    if reach < LEAST_HEIGHT.into() {
        return book;
    }
    let labels: Vec<u32> = rows.iter().map(|row| book.labels[*row]).collect();
    let parted = part(&spots, &labels, reach, |spot| about_as_good(&book, table, rows[spot]));
    for (row, label) in rows.into_iter().zip(parted) {
        book.labels[row] = label;
    }
    book
}

/// Other clusters of a row that are about as near as its own, by rising distance.
fn about_as_good(book: &Codebook, table: &Table, row: usize) -> Vec<u32> {
    let squared = |label: u32| {
        let pairs = table.row(row).iter().zip(book.centre(label as usize));
        pairs.map(|(value, centre)| (value - centre).powi(2)).sum::<f64>()
    };
    let own = book.labels[row];
    let most = ABOUT_AS_GOOD * ABOUT_AS_GOOD * squared(own);
    let labels = (0..book.len() as u32).filter(|label| *label != own);
    let mut others: Vec<(f64, u32)> = labels.map(|label| (squared(label), label)).collect();
    others.retain(|(distance, _)| *distance <= most);
    others.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
    others.into_iter().map(|(_, label)| label).collect()
}

/// Number and weight of the plants of each representative, as the labels are now.
fn count_plants(
    chosen: &mut [Representative],
    number: &[usize],
    book: &Codebook,
    table: &Table,
    order: &[u32],
) {
    for representative in chosen.iter_mut() {
        (representative.count, representative.weight) = (0, 0.0);
    }
    for row in order.iter().map(|row| *row as usize) {
        let representative = &mut chosen[number[book.labels[row] as usize]];
        representative.count += 1;
        representative.weight += table.weights()[row];
    }
}

/// Largest difference of a plant's height from its cluster's mean, as a part of the mean.
fn worst_height(plants: &[Standing], table: &Table, book: &Codebook, order: &[u32]) -> f64 {
    let (chosen, number) = representatives("", plants, table, book, order, 1);
    let of_plant = |(plant, label): (&Standing, &u32)| {
        let model = f64::from(chosen[number[*label as usize]].height);
        (f64::from(plant.traits.height.max(LEAST_HEIGHT)) - model).abs() / model
    };
    plants.iter().zip(&book.labels).map(of_plant).fold(0.0, f64::max)
}

fn feature_table(config: &Config, size: &Size, plants: &[Standing]) -> Result<Table, Problem> {
    let features: Vec<[f64; COUNT]> =
        plants.par_iter().map(|plant| plant.traits.features(size)).collect();
    let weight = |plant: &Standing| plant.traits.weight(config.weights, plant.seen, plant.nearness);
    Table::new(features.into_flattened(), COUNT, plants.iter().map(weight).collect())
        .map_err(|error| Problem::new(error.to_string()))
}

/// The representatives of a species by rising age, vigor and height, and for each cluster the
/// number of its representative in that list.
///
/// A representative has the weighted mean age, vigor, height and radius of its plants: unlike the
/// centre taken back through the curve of growth, which is flat at old age, it always lies among
/// them.
fn representatives(
    name: &str,
    plants: &[Standing],
    table: &Table,
    book: &Codebook,
    order: &[u32],
    first_id: u32,
) -> (Vec<Representative>, Vec<usize>) {
    let mut means = vec![Mean::default(); book.len()];
    for index in order.iter().map(|index| *index as usize) {
        let mean = &mut means[book.labels[index] as usize];
        mean.add(&plants[index].traits, table.weights()[index]);
    }
    let mut sorted: Vec<(usize, Representative)> =
        means.iter().map(|mean| mean.representative(name)).enumerate().collect();
    sorted.sort_by(|(a, left), (b, right)| {
        let age = left.age.total_cmp(&right.age);
        age.then(left.vigor.total_cmp(&right.vigor))
            .then(left.height.total_cmp(&right.height))
            .then(a.cmp(b))
    });
    let mut number = vec![0; book.len()];
    for (place, (label, representative)) in sorted.iter_mut().enumerate() {
        number[*label] = place;
        representative.id = first_id + place as u32;
    }
    (sorted.into_iter().map(|(_, representative)| representative).collect(), number)
}

/// Sums over the plants of a cluster.
#[derive(Clone, Default)]
struct Mean {
    weighted: [f64; 4],
    weight: f64,
    plain: [f64; 4],
    count: u64,
}

impl Mean {
    fn add(&mut self, traits: &Traits, weight: f64) {
        let values = [traits.age, traits.vigor, traits.height, traits.radius].map(f64::from);
        for (index, value) in values.into_iter().enumerate() {
            self.weighted[index] += weight * value;
            self.plain[index] += value;
        }
        self.weight += weight;
        self.count += 1;
    }

    fn representative(&self, species: &str) -> Representative {
        let (sums, total) = match self.weight {
            weight if weight > 0.0 => (self.weighted, weight),
            _ => (self.plain, self.count as f64),
        };
        let [age, vigor, height, radius] = sums.map(|sum| (sum / total) as f32);
        Representative {
            id: 0,
            species: species.to_owned(),
            age,
            vigor: vigor.clamp(0.0, 1.0),
            height: height.max(LEAST_HEIGHT),
            radius,
            weight: self.weight,
            count: self.count,
        }
    }
}

/// What stands at each place: an id, and the scale of its instance.
struct Prototypes {
    scene: Vec<(u32, f32)>,
    patches: Vec<Vec<(u32, f32)>>,
}

impl Prototypes {
    fn new(plants: usize, patches: &Patches) -> Self {
        let members = patches.patches.iter().map(|patch| vec![(0, 1.0); patch.members.len()]);
        Self { scene: vec![(0, 1.0); plants], patches: members.collect() }
    }

    fn set(&mut self, place: Place, id: u32, scale: f32) {
        match place {
            Place::Scene { index, .. } => self.scene[index] = (id, scale),
            Place::Patch { patch, ordinal } => self.patches[patch][ordinal] = (id, scale),
        }
    }
}

/// Numbers groups after the representatives and enters them where they stand.
fn add_groups(palette: &mut Palette, prototypes: &mut Prototypes, patches: &Patches) {
    let first_id = palette.representatives.len() as u32 + 1;
    palette.groups = (first_id..)
        .zip(&patches.patches)
        .map(|(id, patch)| Group {
            id,
            species: patch.species.clone(),
            age: patch.age,
            vigor: patch.vigor,
            count: patch.rows,
        })
        .collect();
    for (place, patch) in &patches.placed {
        prototypes.set(*place, palette.groups[*patch].id, 1.0);
    }
}

/// Rows of the scene in the order of its plants, then those of each group.
fn instances(
    population: &Population,
    patches: &Patches,
    prototypes: &Prototypes,
    palette: &Palette,
) -> Instances {
    let mut instances = Instances { crs: population.crs.clone(), ..Instances::default() };
    for (plant, (prototype, scale)) in population.plants.iter().zip(&prototypes.scene) {
        instances.push(Instance {
            group: 0,
            prototype: *prototype,
            plant_id: plant.id,
            position: [plant.x, plant.y, plant.z.into()],
            rotation: rotation(plant.yaw.into(), plant.lean.into(), plant.lean_azimuth.into()),
            scale: *scale,
        });
    }
    for ((group, patch), chosen) in
        palette.groups.iter().zip(&patches.patches).zip(&prototypes.patches)
    {
        for (ordinal, (member, (prototype, scale))) in patch.members.iter().zip(chosen).enumerate()
        {
            let [x, y] = member.position;
            instances.push(Instance {
                group: group.id,
                prototype: *prototype,
                plant_id: ordinal as u64,
                position: [x, y, 0.0],
                rotation: rotation(member.yaw, 0.0, 0.0),
                scale: *scale,
            });
        }
    }
    instances
}

/// `world_from_plant`: a turn by `yaw` about the plant's own axis, then a lean of that axis from
/// the vertical towards `azimuth`.
fn rotation(yaw: f64, lean: f64, azimuth: f64) -> [f32; 4] {
    let (sin_yaw, cos_yaw) = libm::sincos(yaw / 2.0);
    let (sin_lean, cos_lean) = libm::sincos(lean / 2.0);
    let (sin_azimuth, cos_azimuth) = libm::sincos(azimuth);
    // Towards (sin, cos) of the azimuth the vertical turns about the horizontal axis (-cos, sin).
    let lean = DQuat::from_xyzw(-cos_azimuth * sin_lean, sin_azimuth * sin_lean, 0.0, cos_lean);
    let yaw = DQuat::from_xyzw(0.0, 0.0, sin_yaw, cos_yaw);
    let turned: Quat = (lean * yaw).as_quat();
    turned.to_array()
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_6};

    fn turned(rotation: [f32; 4], v: Vec3) -> Vec3 {
        Quat::from_array(rotation) * v
    }

    #[test]
    fn a_plant_leans_towards_its_azimuth() {
        let east = rotation(1.0, FRAC_PI_6, FRAC_PI_2);
        assert!(turned(east, Vec3::Z).abs_diff_eq(Vec3::new(0.5, 0.0, 0.75f32.sqrt()), 1e-6));
        let north = rotation(1.0, FRAC_PI_6, 0.0);
        assert!(turned(north, Vec3::Z).abs_diff_eq(Vec3::new(0.0, 0.5, 0.75f32.sqrt()), 1e-6));
    }

    #[test]
    fn yaw_turns_an_upright_plant_counter_clockwise() {
        let quarter = rotation(FRAC_PI_2, 0.0, 0.3);
        assert!(turned(quarter, Vec3::X).abs_diff_eq(Vec3::Y, 1e-6));
    }
}
