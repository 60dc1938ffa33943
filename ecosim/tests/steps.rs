//! Thinning, tables of other people, sizes and orientations from formulas, and odd images.

mod world;

use std::collections::BTreeMap;
use weald_contract::{Crs, Image, Plant, Population, State};
use world::{HERB, TREE, World, plain, unevenness};

const TREES: &str =
    "[[step]]\nkind = \"halftone\"\nspecies = \"tree\"\nper_m2 = 0.1\nage = [5, 90]\n";

fn wood() -> World {
    plain(100, 1.0).with_species("tree", TREE)
}

#[test]
fn thinning_leaves_the_exact_number_everywhere() {
    let world = wood();
    assert_eq!(world.grow(TREES).unwrap().population.len(), 1000);
    for (rule, left) in [("keep = 0.3", 300), ("plants = 137", 137), ("plants = 0", 0)] {
        let outcome = world.grow(&format!("{TREES}[[step]]\nkind = \"thin\"\n{rule}")).unwrap();
        assert_eq!((outcome.population.len(), outcome.deaths.len()), (left, 1000 - left), "{rule}");
        // Quarters of the ground keep their share within a plant or two.
        let places = world.places(&outcome.population);
        let quarter = places.iter().filter(|p| p[0] < 50.0 && p[1] < 50.0).count();
        assert!(quarter.abs_diff(left / 4) <= 5, "{quarter} of {left}");
    }
}

#[test]
fn thinning_favours_whom_it_is_told_to() {
    let world = wood();
    let mean = |favour: &str| {
        let steps = format!("{TREES}[[step]]\nkind = \"thin\"\nkeep = 0.25\nfavour = \"{favour}\"");
        let plants = world.grow(&steps).unwrap().population.plants;
        plants.iter().map(|plant| f64::from(plant.radius)).sum::<f64>() / plants.len() as f64
    };
    assert!(mean("small") < 0.85 * mean("any") && mean("any") < 0.85 * mean("large"));
}

#[test]
fn thinning_follows_a_formula_and_spares_whom_it_does_not_mean() {
    let world = wood().with_species("herb", HERB);
    let steps = format!(
        "{TREES}[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 0.2\n\
         [[step]]\nkind = \"thin\"\nspecies = [\"tree\"]\nkeep = \"if(x < 50, 0.2, 1)\""
    );
    let population = world.grow(&steps).unwrap().population;
    assert_eq!(population.counts(), [600, 2000]);
    let trees = population.plants.iter().filter(|plant| plant.species == 0);
    assert!(trees.filter(|plant| plant.x >= 500_050.0).count().abs_diff(500) <= 1);
}

#[test]
fn stems_of_a_thinned_wood_keep_their_distance_and_none_goes_without_need() {
    let world = wood();
    let before = world.grow(TREES).unwrap().population;
    let steps = format!("{TREES}[[step]]\nkind = \"thin\"\nstems = 4.0");
    let outcome = world.grow(&steps).unwrap();
    let apart = |a: &Plant, b: &Plant| (a.x - b.x).hypot(a.y - b.y);
    let stays = &outcome.population.plants;
    for (index, plant) in stays.iter().enumerate() {
        assert!(stays[..index].iter().all(|other| apart(plant, other) >= 4.0));
    }
    // Whoever went stood too near a larger one that stays.
    for death in &outcome.deaths {
        let gone = before.plants.iter().find(|plant| plant.id == death.id).unwrap();
        let is_rival = |other: &Plant| apart(gone, other) < 4.0 && other.radius >= gone.radius;
        assert!(stays.iter().any(is_rival));
    }
}

#[test]
fn a_thinning_that_says_nothing_is_a_mistake() {
    let (message, _) = wood().mistake(&format!("{TREES}[[step]]\nkind = \"thin\""));
    assert!(message.contains("how many plants stay"), "{message}");
}

fn table(crs: Crs, places: &[[f64; 2]], extra: &[(&str, f32)]) -> Population {
    let blank = Plant {
        id: 0,
        species: 0,
        state: State::Free,
        x: 0.0,
        y: 0.0,
        z: f32::NAN,
        radius: f32::NAN,
        height: f32::NAN,
        age: f32::NAN,
        vigor: f32::NAN,
        yaw: 0.0,
        lean: 0.0,
        lean_azimuth: 0.0,
    };
    let plants = places.iter().zip(0..).map(|(p, id)| Plant { id, x: p[0], y: p[1], ..blank });
    let columns = extra.iter().map(|(name, value)| (name.to_string(), vec![*value; places.len()]));
    Population {
        species: vec!["quru".into()],
        plants: plants.collect(),
        extra: columns.collect::<BTreeMap<_, _>>(),
        crs,
    }
}

const CENSUS: &str = "[[step]]\nkind = \"place\"\nplants = \"c.csv\"\n\
                      names = [{ word = \"quru\", species = \"tree\" }]\n";

#[test]
fn a_census_plot_is_placed_by_its_corner_with_heights_from_diameters() {
    let tree = "size = { height = 20, crown_radius = 4, stem_diameter = 0.4, stem_exponent = 1.5 }";
    let mut world = plain(100, 1.0).with_species("tree", tree);
    let census = table(Crs::default(), &[[1.0, 2.0], [10.0, 20.0]], &[("dbh_cm", 5.0)]);
    world.plants.insert("c.csv".into(), census);
    let population = world.grow(&format!("{CENSUS}origin = [30, 40]")).unwrap().population;
    assert_eq!(world.places(&population), [[31.0, 42.0], [40.0, 60.0]]);
    assert_eq!(population.species, ["tree"]);
    // (5 cm / 40 cm)^(2/3) = 1/4 of the full height, and of the full crown.
    assert!((population.plants[0].height - 5.0).abs() < 1e-4, "{:?}", population.plants[0]);
    assert!((population.plants[0].radius - 1.0).abs() < 1e-4);
    assert!(population.plants[0].age > 0.0);
}

#[test]
fn diameters_without_a_unit_are_not_guessed() {
    let mut world = wood();
    let census = table(Crs::default(), &[[500_001.0, 5_200_002.0]], &[("dbh", 5.0)]);
    world.plants.insert("c.csv".into(), census);
    let (message, at) = world.mistake(CENSUS);
    assert!(message.contains("does not say its unit") && at == "\"c.csv\"", "{message} {at}");
}

#[test]
fn degrees_and_other_maps_are_aligned_or_refused() {
    let mut world = wood();
    world.terrain.crs.epsg = Some(25832);
    let crs = |epsg, is_geographic| Crs { epsg: Some(epsg), is_geographic, ..Crs::default() };
    // Where PROJ puts 500,038 m east, 5,200,030 m north in UTM zone 32.
    let degrees = [[9.000_499_401_468_92, 46.953_799_167_417_11]];
    world.plants.insert("c.csv".into(), table(crs(4326, true), &degrees, &[]));
    let population = world.grow(CENSUS).unwrap().population;
    let [x, y] = world.places(&population)[0];
    assert!((x - 38.0).abs() < 1e-3 && (y - 30.0).abs() < 1e-3, "{x} {y}");
    world.plants.insert("c.csv".into(), table(crs(25833, false), &[[1.0, 2.0]], &[]));
    let (message, _) = world.mistake(CENSUS);
    assert!(message.contains("EPSG:25833") && message.contains("EPSG:25832"), "{message}");
    world.terrain.crs.epsg = Some(3035);
    world.plants.insert("c.csv".into(), table(crs(4326, true), &degrees, &[]));
    assert!(world.mistake(CENSUS).0.contains("degrees"));
}

#[test]
fn heights_turns_and_leans_follow_formulas_over_images() {
    let world = wood().with_image("tall.png", 10, 10, |column, _| column as f32 / 9.0);
    let steps = "images = [\"tall.png\"]\n[[step]]\nkind = \"halftone\"\nspecies = \"tree\"\n\
                 per_m2 = 0.05\nheight = \"2 + 10 * tall\"\nyaw_deg = 90\nupright = [1, 1]";
    let steps = steps.replace("yaw_deg = 90", "yaw_deg = \"90 + 0 * tall\"");
    let population = world.grow(&steps).unwrap().population;
    assert_eq!(population.len(), 500);
    for plant in &population.plants {
        assert!((2.0..=12.0).contains(&plant.height) && plant.lean == 0.0);
        assert!((plant.yaw.to_degrees() - 90.0).abs() < 1e-4);
    }
    let east = population.plants.iter().max_by(|a, b| a.x.total_cmp(&b.x)).unwrap();
    let west = population.plants.iter().min_by(|a, b| a.x.total_cmp(&b.x)).unwrap();
    assert!(west.height < 3.0 && east.height > 11.0 && east.age > west.age);
}

#[test]
fn every_way_of_spreading_keeps_the_count_and_the_paint() {
    let world = wood().with_image("d.png", 50, 50, |column, row| {
        f32::from(u8::from(column.abs_diff(25).pow(2) + row.abs_diff(25).pow(2) < 200)) * 0.5
    });
    for way in ["weight = \"even\"", "weight = \"density\"", "polish = 4", "relax = 0\npolish = 2"]
    {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"tree\"\ndensity = \"d.png\"\nper_m2 = 2\n{way}"
        );
        let places = world.places(&world.grow(&steps).unwrap().population);
        let inside = |p: &[f64; 2]| (p[0] - 51.0).hypot(p[1] - 49.0) < 30.5;
        assert!(places.iter().all(inside), "{way}");
        // 626 pixels of 4 m², one plant to a square metre.
        let painted = (0..2500usize)
            .filter(|i| (i % 50).abs_diff(25).pow(2) + (i / 50).abs_diff(25).pow(2) < 200)
            .count();
        assert_eq!(places.len(), 4 * painted, "{way}");
    }
}

#[test]
fn polish_makes_an_even_ground_more_even() {
    let world = plain(60, 1.0).with_species("herb", HERB);
    let spread = |polish: u32| {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 0.5\npolish = {polish}"
        );
        unevenness(&world.places(&world.grow(&steps).unwrap().population), 60.0, 5.0)
    };
    assert!(spread(20) < 0.055, "{}", spread(20));
}

fn image_of(values: Vec<f32>, width: usize, height: usize, is_float: bool) -> Image {
    Image { width, height, values, is_float, frame: None }
}

const IMAGE: &str = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"i\"\nper_m2 = ";

#[test]
fn odd_images_give_the_right_answer_or_a_clear_error() {
    let mut world = plain(20, 1.0).with_species("herb", HERB);
    let mut count = |image: Image, per_m2: f64| {
        world.images.insert("i".into(), image);
        world.grow(&format!("{IMAGE}{per_m2}")).unwrap().population.len()
    };
    // All black: nothing, without complaint.
    assert_eq!(count(image_of(vec![0.0; 64], 8, 8, false), 5.0), 0);
    // One pixel over all the ground.
    assert_eq!(count(image_of(vec![0.5], 1, 1, false), 2.0), 400);
    // One plant on all the ground, and just less than half of one.
    assert_eq!(count(image_of(vec![1.0], 1, 1, false), 1.0 / 400.0), 1);
    assert_eq!(count(image_of(vec![1.0], 1, 1, false), 0.49 / 400.0), 0);
    // More than one a square metre, cell or pixel: cells grow finer.
    assert_eq!(count(image_of(vec![1.0], 1, 1, false), 90.0), 36_000);
}

#[test]
fn numbers_and_shapes_that_no_density_has_are_mistakes() {
    let mut world = plain(20, 1.0).with_species("herb", HERB);
    for wrong in [f32::INFINITY, f32::NAN, -1.0] {
        world.images.insert("i".into(), image_of(vec![1.0, 1.0, 1.0, wrong], 2, 2, true));
        let (message, at) = world.mistake(&format!("{IMAGE}1"));
        let place = format!("holds {wrong} at column 1, row 1; densities are numbers from 0");
        assert!(message.contains(&place) && at == "\"i\"", "{message} {at}");
    }
    let mut beside = image_of(vec![1.0; 4], 2, 2, false);
    beside.frame =
        Some(weald_contract::Frame { width: 2, height: 2, cell: 9.0, west: 0.0, south: 0.0 });
    world.images.insert("i".into(), beside);
    let (message, _) = world.mistake(&format!("{IMAGE}1"));
    assert!(message.contains("lies beside the terrain, at 0 to 18, 0 to 18"), "{message}");
    world.images.insert("i".into(), image_of(vec![1.0; 7], 1, 7, false));
    assert!(world.mistake(&format!("{IMAGE}1")).0.contains("1 x 7 pixels over 20 x 20 m"));
    world.images.insert("i".into(), image_of(vec![1.0], 1, 1, false));
    let (message, _) = world.mistake(&format!("{IMAGE}4\ncell = 1.0"));
    assert!(message.contains("more than one in a cell of 1 m"), "{message}");
}
