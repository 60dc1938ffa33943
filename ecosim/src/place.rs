//! Plants placed one by one: a table, points in the scene, or dots of an image.

use crate::Error;
use crate::align;
use crate::attribute::{Attributes, Looks, Newcomers, USUAL_AGE};
use crate::blobs;
use crate::config::Place;
use crate::field::ImageField;
use crate::stand::{Kind, Spot, Stand, fault, settle, stand_on};
use crate::steps::{Site, image_of};
use weald_contract::{Plant, Population, Problem, Span, Written};

/// Adds the plants of the table, then those at the points.
pub(crate) fn run(place: &Place, site: &Site<'_>, stand: &mut Stand<'_>) -> Result<(), Error> {
    site.progress.begin("place", 1, "steps");
    let mut plants = Vec::new();
    if let Some(path) = &place.plants {
        plants.extend(from_table(place, path, site, stand)?);
    }
    if let Some(species) = &place.species {
        plants.extend(from_points(place, species, plants.len() as u64, site, stand)?);
    }
    stand.check_room(plants.len() as u64, "placing plants")?;
    stand.add(plants);
    site.progress.advance(1);
    Ok(())
}

/// Breast height diameters, cm, as the readers of inventories name them.
const DIAMETER: &str = "dbh_cm";

/// Takes over the plants of a table, which get fresh ids in the order of their old ones.
///
/// Altitude and lean follow from this terrain; a height or radius of 0 follows from age and
/// vigor, or from the stem's diameter.
fn from_table(
    place: &Place,
    path: &Written<String>,
    site: &Site<'_>,
    stand: &mut Stand<'_>,
) -> Result<Vec<Plant>, Error> {
    let Some(table) = site.around.plants.get(&path.value) else {
        let message = format!("the table of plants `{}` was not read", path.value);
        return Err(Problem::at(path.span, message).into());
    };
    check_diameters(path, table)?;
    let places = align::places(path, table, place.origin, site.around.terrain)?;
    let diameters = table.extra.get(DIAMETER);
    let mut rows: Vec<usize> = (0..table.plants.len()).collect();
    rows.sort_by_key(|&row| (table.plants[row].id, row));
    let species = species_of_table(place, path, table, stand)?;
    let mut plants = Vec::with_capacity(rows.len());
    for (counter, row) in rows.into_iter().enumerate() {
        let who = format!("plant {} (row {row}) of `{}`", table.plants[row].id, path.value);
        let mut plant = table.plants[row];
        [plant.x, plant.y] = places[row];
        plant.id = site.ids.id(counter as u64);
        let own = species.get(usize::from(plant.species));
        let diameter = diameters.map(|diameters| 0.01 * diameters[row]);
        fill_in(&mut plant, own, diameter, site, stand);
        if let Some(wrong) = fault(&plant, species.len()) {
            return Err(Problem::at(path.span, format!("{who}: {wrong}")).into());
        }
        plant.species = species[usize::from(plant.species)];
        let kind = stand.kind(plant.species);
        check_place(&who, path.span, [plant.x, plant.y], &kind, site)?;
        complete(&mut plant, &kind);
        stand_on(&site.ground, &kind, &mut plant);
        plants.push(plant);
    }
    Ok(plants)
}

/// Complains of diameters without a unit where sizes would have to follow from them.
fn check_diameters(path: &Written<String>, table: &Population) -> Result<(), Problem> {
    let says_size = |plant: &Plant| {
        [plant.height, plant.radius, plant.age].iter().any(|number| !number.is_nan())
    };
    if table.extra.contains_key(DIAMETER)
        || !table.extra.contains_key("dbh")
        || table.plants.iter().any(says_size)
    {
        return Ok(());
    }
    let message = format!("`{}`: column `dbh` does not say its unit", path.value);
    Err(Problem::at(path.span, message).hint("call it `dbh_cm`, `dbh_mm` or `dbh_m`"))
}

fn species_of_table(
    place: &Place,
    path: &Written<String>,
    table: &Population,
    stand: &mut Stand<'_>,
) -> Result<Vec<u16>, Error> {
    let find = |word: &String| {
        let value = place.species_meant(word).to_string();
        stand.species_of(&Written { value, span: path.span })
    };
    table.species.iter().map(find).collect()
}

/// Gives a plant the numbers that its table does not tell: size from age and age from size, and
/// what a halftone would draw where it tells neither.
fn fill_in(
    plant: &mut Plant,
    species: Option<&u16>,
    diameter: Option<f32>,
    site: &Site<'_>,
    stand: &Stand<'_>,
) {
    let Some(kind) = species.map(|species| stand.kind(*species)) else { return };
    if plant.vigor.is_nan() {
        let suitability = site.ground.suitability(kind.ecology, plant.x, plant.y);
        plant.vigor = kind.ecology.vigor(suitability, site.seed, plant.id);
    }
    for size in [&mut plant.height, &mut plant.radius] {
        *size = if size.is_nan() { 0.0 } else { *size };
    }
    if let (true, Some(diameter)) = (plant.height == 0.0, diameter.filter(|d| *d > 0.0)) {
        // Allometry knows the diameter at the base, which is a little more.
        plant.height = kind.size.height_of_stem_diameter(diameter);
    }
    if plant.age.is_nan() {
        let height = match plant.height {
            0.0 => kind.size.height_of_radius(plant.radius),
            height => height,
        };
        plant.age = if height > 0.0 {
            kind.size.age_of_height(height, plant.vigor)
        } else {
            let part = USUAL_AGE.map(f64::from);
            let part = site.seed.stream("age", plant.id).range(part[0], part[1]) as f32;
            part * kind.size.lifespan
        };
    }
}

fn complete(plant: &mut Plant, kind: &Kind<'_>) {
    if plant.height == 0.0 {
        plant.height = match plant.radius {
            0.0 => kind.size.height_at(plant.age, plant.vigor),
            radius => kind.size.height_of_radius(radius),
        };
    }
    if plant.radius == 0.0 {
        plant.radius = kind.size.radius_of_height(plant.height);
    }
}

/// Makes a plant at each point of `at`, then of `dots`; `first` ids of the step are taken.
fn from_points(
    place: &Place,
    species: &Written<String>,
    first: u64,
    site: &Site<'_>,
    stand: &mut Stand<'_>,
) -> Result<Vec<Plant>, Error> {
    let index = stand.species_of(species)?;
    let kind = stand.kind(index);
    let frame = site.ground.frame();
    let point =
        |at: &Written<[f64; 2]>| (at.span, [frame.west + at.value[0], frame.south + at.value[1]]);
    let mut places: Vec<(Span, [f64; 2])> = place.at.iter().map(point).collect();
    if let Some(path) = &place.dots {
        places.extend(dots(path, site)?.into_iter().map(|place| (path.span, place)));
    }
    let mut spots = Vec::with_capacity(places.len());
    for (counter, (span, at)) in places.into_iter().enumerate() {
        let [x, y] = [at[0] - frame.west, at[1] - frame.south];
        let who = format!("the {} at {x:.1}, {y:.1}", species.value);
        check_place(&who, span, at, &kind, site)?;
        spots.push((site.ids.id(first + counter as u64), at));
    }
    let (age, vigor) = (&place.age, &place.vigor);
    let attributes = Attributes { age, age_noise: 0.0, vigor, vigor_noise: 0.0 };
    let (ground, seed) = (&site.ground, site.seed);
    let newcomers = Newcomers { ground, stand, kind, seed, sites: &spots };
    let drawn = attributes.draw(&newcomers)?;
    let plant = |(&(id, [x, y]), (age, vigor)): (&(u64, [f64; 2]), (f32, f32))| {
        let yaw = site.seed.stream("yaw", id).range(0.0, std::f64::consts::TAU) as f32;
        settle(&site.ground, &kind, index, Spot { id, x, y, age, vigor, yaw })
    };
    let mut plants: Vec<Plant> = spots.iter().zip(drawn).map(plant).collect();
    let (height, yaw_deg, upright) = (&place.height, &place.yaw_deg, &place.upright);
    let looks = Looks { height, yaw_deg, upright, is_age_given: place.age.is_some() };
    looks.size(&mut plants, &newcomers)?;
    looks.orient(&mut plants, &newcomers)?;
    Ok(plants)
}

/// Returns the middles of the blobs of an image in map coordinates.
fn dots(path: &Written<String>, site: &Site<'_>) -> Result<Vec<[f64; 2]>, Error> {
    let (image, terrain) = (image_of(path, &site.around)?, site.ground.frame());
    // The image must fit as densities must; what is read are its blobs.
    ImageField::new(path, image, false, terrain)?;
    let frame = image.frame.as_ref().unwrap_or(terrain);
    let (width, height) = (frame.east() - frame.west, frame.north() - frame.south);
    let place = |[u, v]: [f64; 2]| [frame.west + u * width, frame.south + v * height];
    Ok(blobs::middles(image).into_iter().map(place).collect())
}

/// Complains of a place off the terrain or in water of the wrong depth.
///
/// Steepness is left to the one who places a plant by hand.
fn check_place(
    who: &str,
    span: Span,
    [x, y]: [f64; 2],
    kind: &Kind<'_>,
    site: &Site<'_>,
) -> Result<(), Error> {
    let frame = site.ground.frame();
    if !frame.contains(x, y) {
        let (width, height) = (frame.east() - frame.west, frame.north() - frame.south);
        let message = format!("{who} stands off the terrain");
        let hint = format!("scene coordinates run from 0, 0 to {width}, {height}");
        return Err(Problem::at(span, message).hint(hint).into());
    }
    if !site.ground.is_depth_right(kind.ecology, x, y) {
        let [least, greatest] = kind.ecology.water_depth;
        let depth = site.ground.water_depth(x, y);
        let message = format!("{who} stands where the water is {depth:.2} m deep");
        let hint = format!("its `water_depth` allows {least} to {greatest} m");
        return Err(Problem::at(span, message).hint(hint).into());
    }
    Ok(())
}
