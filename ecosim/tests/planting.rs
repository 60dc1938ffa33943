//! Densities become plants: counts, evenness, masks, and fidelity to what was painted.

mod world;

use weald_contract::{Frame, Grid, Seed};
use weald_ecosim::{Relaxation, relax};
use world::{HERB, plain, unevenness};

#[test]
fn a_constant_density_gives_its_integral_in_evenly_spaced_plants() {
    let world = plain(100, 0.5).with_species("herb", HERB);
    for per_m2 in [0.002, 0.3, 0.777, 2.0] {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = {per_m2}\nrelax = 5"
        );
        let population = world.grow(&steps).unwrap().population;
        assert_eq!(population.len(), (per_m2 * 2500.0_f64).round() as usize);
        if population.len() > 500 {
            let spread = unevenness(&world.places(&population), 50.0, 3.0);
            assert!(spread <= 0.10, "{spread} at {per_m2}");
        }
    }
}

#[test]
fn relaxation_makes_neighbours_more_evenly_spaced() {
    let world = plain(100, 0.5).with_species("herb", HERB);
    let spread = |passes: u32| {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 1\nrelax = {passes}"
        );
        unevenness(&world.places(&world.grow(&steps).unwrap().population), 50.0, 3.0)
    };
    let (none, few, many) = (spread(0), spread(3), spread(30));
    assert!(few < 0.6 * none && many < 0.9 * few, "{none} {few} {many}");
}

/// A disc of full density in an image of 200 x 200 pixels.
fn disc(column: usize, row: usize) -> f32 {
    let (dx, dy) = (column as f64 - 99.5, row as f64 - 99.5);
    if dx * dx + dy * dy < 60.0 * 60.0 { 1.0 } else { 0.0 }
}

#[test]
fn plants_keep_to_what_is_painted_and_to_its_count() {
    let world = plain(50, 1.0).with_species("herb", HERB).with_image("disc.png", 200, 200, disc);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"disc.png\"\n\
                 per_m2 = 4\nrelax = 20";
    let population = world.grow(steps).unwrap().population;
    let pixels = (0..200 * 200).filter(|i| disc(i % 200, i / 200) > 0.0).count();
    let wanted = pixels as f64 * 4.0 / 16.0;
    assert_eq!(population.len(), wanted.round() as usize);
    for [x, y] in world.places(&population) {
        let [column, row] = [x * 4.0, 200.0 - y * 4.0].map(|c| c as usize);
        assert_eq!(disc(column, row), 1.0);
    }
}

#[test]
fn many_passes_do_not_drift_away_from_a_painted_ramp() {
    // Density rises from 0 to 8 plants per m² over 50 m: strip k of 10 holds 2k+1 parts of 100.
    let ramp = |column: usize, _| (column as f32 + 0.5) / 200.0;
    let world = plain(50, 1.0).with_species("herb", HERB).with_image("ramp.png", 200, 200, ramp);
    for passes in [5, 60] {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"ramp.png\"\n\
             per_m2 = 8\nrelax = {passes}"
        );
        let places = world.places(&world.grow(&steps).unwrap().population);
        let mut counts = [0.0; 10];
        places.iter().for_each(|p| counts[((p[0] / 5.0) as usize).min(9)] += 1.0);
        for (strip, count) in counts.iter().enumerate() {
            let wanted = 100.0 * (2 * strip + 1) as f64;
            let off: f64 = (count - wanted) / wanted;
            assert!(off.abs() < 0.03 + 4.0 / wanted, "strip {strip}: {count} for {wanted}");
        }
    }
}

#[test]
fn inverted_and_georeferenced_images_lie_where_they_say() {
    let west_dense = |column: usize, _| if column < 10 { 0.0 } else { 1.0 };
    let mut world =
        plain(40, 1.0).with_species("herb", HERB).with_image("a.png", 20, 20, west_dense);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"a.png\"\n\
                 per_m2 = 1\ninvert = true";
    let places = world.places(&world.grow(steps).unwrap().population);
    assert_eq!(places.len(), 800);
    assert!(places.iter().all(|p| p[0] <= 20.0));
    // The same image on a square of 10 m: what lies off the paper stays empty.
    let frame = Frame { width: 20, height: 20, cell: 0.5, west: 500_010.0, south: 5_200_020.0 };
    world.images.get_mut("a.png").unwrap().frame = Some(frame);
    let places = world.places(&world.grow(steps).unwrap().population);
    assert_eq!(places.len(), 50);
    assert!(places.iter().all(|p| (10.0..=15.0).contains(&p[0]) && (20.0..=30.0).contains(&p[1])));
}

#[test]
fn no_step_puts_plants_into_water_that_they_cannot_stand_in() {
    let reed = format!("{HERB}\necology = {{ water_depth = [0.1, 0.5] }}");
    let meadow = "size = { height = 0.3, crown_radius = 0.4 }\n[group]\nside = 0.8\nmember = []";
    let world = plain(60, 1.0)
        .with_species("herb", HERB)
        .with_species("reed", &reed)
        .with_species("meadow", meadow)
        .with_species(
            "aspen",
            &format!("{TREE}\necology = {{ seedlings = 500 }}", TREE = world::TREE),
        )
        .with_pond(30.0, 30.0, 12.0, 0.4);
    let steps = "
        [[step]]
        kind = \"halftone\"
        species = \"herb\"
        per_m2 = 1
        [[step]]
        kind = \"halftone\"
        species = \"reed\"
        per_m2 = 3
        [[step]]
        kind = \"halftone\"
        species = \"meadow\"
        per_m2 = 1
        arrange = \"grid\"
        [[step]]
        kind = \"simulate\"
        species = [\"aspen\"]
        years = 20
        [[step]]
        kind = \"relax\"
        iterations = 10";
    let population = world.grow(steps).unwrap().population;
    let reed = population.species.iter().position(|name| name == "reed").unwrap();
    let depth = |p: &weald_contract::Plant| world.terrain.sample("water_depth", p.x, p.y).unwrap();
    assert!(population.counts().iter().all(|count| *count > 50), "{:?}", population.counts());
    for plant in &population.plants {
        let is_reed = usize::from(plant.species) == reed;
        let range = if is_reed { 0.1..=0.5 } else { 0.0..=0.01 };
        assert!(range.contains(&depth(plant)), "{plant:?}");
    }
}

#[test]
fn patches_lie_on_a_grid_in_quarter_turns_and_as_many_as_is_probable() {
    let meadow = "size = { height = 0.3, crown_radius = 0.4 }\n[group]\nside = 0.5\nmember = []";
    let world = plain(100, 1.0).with_species("meadow", meadow);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"meadow\"\narrange = \"grid\"\n\
                 per_m2 = 0.25\nvigor = \"soil_moisture\"\nvigor_noise = 0";
    let population = world.grow(steps).unwrap().population;
    // 40,000 cells, each taken with probability 1/4: mean 10,000, standard deviation 87.
    assert!((population.len() as f64 - 10_000.0).abs() < 5.0 * 87.0, "{}", population.len());
    for (plant, [x, y]) in population.plants.iter().zip(world.places(&population)) {
        let off = |c: f64| ((c - 0.25) / 0.5 - ((c - 0.25) / 0.5).round()).abs();
        assert!(off(x) < 1e-6 && off(y) < 1e-6);
        let quarter = plant.yaw / std::f32::consts::FRAC_PI_2;
        assert_eq!(quarter, quarter.round());
        assert!((plant.vigor - (x / 100.0) as f32).abs() < 0.011);
    }
}

#[test]
fn attributes_follow_ranges_and_formulas_with_noise() {
    let world = plain(40, 1.0).with_species("herb", HERB);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 2\n\
                 age = [1, 2]\nvigor = \"x / 40\"\nvigor_noise = 0.05";
    let population = world.grow(steps).unwrap().population;
    for (plant, [x, _]) in population.plants.iter().zip(world.places(&population)) {
        assert!((1.0..=2.0).contains(&plant.age));
        assert!((plant.vigor - x as f32 / 40.0).abs() <= 0.0501);
        let size = &world.species["herb"].0.size;
        assert_eq!(plant.height, size.height_at(plant.age, plant.vigor));
    }
    let ages: f64 = population.plants.iter().map(|p| f64::from(p.age)).sum();
    // Mean 1.5; standard error 0.289 / sqrt(3,200) = 0.005.
    assert!((ages / population.len() as f64 - 1.5).abs() < 0.026);
}

#[test]
fn crowns_keep_shade_fleeing_plants_away() {
    let world = plain(40, 1.0).with_species("herb", HERB).with_species("tree", world::TREE);
    let steps = "
        [[step]]
        kind = \"place\"
        species = \"tree\"
        at = [[20, 20]]
        age = [80, 80]
        vigor = [1, 1]
        [[step]]
        kind = \"halftone\"
        species = \"herb\"
        formula = \"2 * (1 - crown_shadow(\\\"tree\\\"))\"";
    let population = world.grow(steps).unwrap().population;
    let tree = population.plants.iter().find(|p| p.species == 0).unwrap();
    let radius = f64::from(tree.radius);
    let near = |p: &weald_contract::Plant| (p.x - tree.x).hypot(p.y - tree.y);
    // Shadow is blurred over one cell of half a metre.
    assert!(population.plants.iter().all(|p| p.id == tree.id || near(p) > radius - 0.6));
    assert!(radius > 2.0 && population.len() > 3000);
}

/// The centre of the places nearer to `own` than to any other, weighted by density squared:
/// by brute force over a fine raster.
fn centre_by_force(own: usize, places: &[[f64; 2]], density: impl Fn(f64, f64) -> f64) -> [f64; 2] {
    let (mut mass, mut sum) = (0.0, [0.0; 2]);
    for i in 0..1000 * 1000 {
        let [x, y] = [i % 1000, i / 1000].map(|c| (c as f64 + 0.5) / 100.0);
        let squared = |p: &[f64; 2]| (p[0] - x).powi(2) + (p[1] - y).powi(2);
        let nearest =
            (0..places.len()).min_by(|&a, &b| squared(&places[a]).total_cmp(&squared(&places[b])));
        if nearest == Some(own) {
            let weight = density(x, y).powi(2);
            mass += weight;
            sum = [sum[0] + weight * x, sum[1] + weight * y];
        }
    }
    sum.map(|s| s / mass)
}

#[test]
fn plants_move_to_the_centre_of_mass_of_their_polygon() {
    let frame = Frame { width: 100, height: 100, cell: 0.1, west: 0.0, south: 0.0 };
    let density = |x: f64, _: f64| 1.0 + (x * 10.0).floor() / 10.0;
    let grid = Grid::from_fn(frame, |x, y| density(x, y) as f32);
    // A jittered grid, so that no polygon outgrows the square that bounds it.
    let mut stream = Seed(5).stream("places", 0);
    let places: Vec<[f64; 2]> = (0..36)
        .map(|i| {
            [i % 6, i / 6].map(|c| (c as f64 + 0.5 + 0.5 * (stream.unit() - 0.5)) * 10.0 / 6.0)
        })
        .collect();
    let mut moved = places.clone();
    relax(&mut moved, &grid, &Relaxation::pass(0, 1));
    for own in [0, 7, 14, 15, 20, 35] {
        let [x, y] = centre_by_force(own, &places, density);
        let off = (moved[own][0] - x).hypot(moved[own][1] - y);
        // Spacing is 1.67 m; ten lines a polygon leave errors of a percent of it.
        assert!(off < 0.02, "plant {own} is {off} m from its centre");
    }
}

#[test]
fn relaxing_few_or_coincident_plants_is_harmless() {
    let frame = Frame { width: 10, height: 10, cell: 1.0, west: 0.0, south: 0.0 };
    let grid = Grid::filled(frame, 1.0);
    let step = Relaxation::pass(0, 1);
    relax(&mut [], &grid, &step);
    let mut one = [[2.0, 3.0]];
    (0..50).for_each(|_| relax(&mut one, &grid, &step));
    assert!((one[0][0] - 5.0).abs() < 1e-6 && (one[0][1] - 5.0).abs() < 1e-6, "{one:?}");
    let mut twins = vec![[5.0, 5.0]; 20];
    relax(&mut twins, &grid, &step);
    let mut line: Vec<[f64; 2]> = (0..20).map(|i| [0.25 + 0.5 * f64::from(i), 5.0]).collect();
    relax(&mut line, &grid, &step);
    assert!(twins.iter().chain(&line).flatten().all(|c| (0.0..=10.0).contains(c)));
}

#[test]
fn small_and_large_densities_on_mostly_empty_ground_keep_their_count() {
    let dots = |column: usize, row: usize| {
        if (column / 10).is_multiple_of(7) && (row / 10).is_multiple_of(5) { 1.0 } else { 0.0 }
    };
    let world = plain(60, 2.0).with_species("herb", HERB).with_image("d.png", 240, 240, dots);
    let painted: f32 = (0..240 * 240).map(|i| dots(i % 240, i / 240)).sum();
    let wanted = f64::from(painted) * 0.25 * 10.0;
    let steps =
        "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"d.png\"\nper_m2 = 10";
    let population = world.grow(steps).unwrap().population;
    assert_eq!(population.len(), wanted.round() as usize);
}

#[test]
fn plants_near_a_view_stand_on_its_finer_ground() {
    let mut world = plain(40, 1.0).with_species("herb", HERB);
    let fine = plain(80, 0.25).terrain;
    let altitude = vec![107.5; fine.frame.len()];
    world.terrain.detail.push(fine);
    world.terrain.detail[0].insert("altitude", "m", "height", altitude);
    let steps = "[[step]]\nkind = \"place\"\nspecies = \"herb\"\nat = [[10, 10], [30, 30]]";
    let population = world.grow(steps).unwrap().population;
    let z: Vec<f32> = population.plants.iter().map(|plant| plant.z).collect();
    assert!((z[0] - 107.5).abs() < 1e-3 && (z[1] - 100.0).abs() < 1e-3, "{z:?}");
}

#[test]
fn dots_smaller_than_a_terrain_cell_are_planted_where_they_are() {
    // One pixel of 0.25 m in each terrain cell of 5 m: 100 dots that hold a plant each.
    let dot = |column: usize, row: usize| {
        if column % 20 == 7 && row % 20 == 11 { 1.0 } else { 0.0 }
    };
    let world = plain(10, 5.0).with_species("herb", HERB).with_image("dots.png", 200, 200, dot);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"dots.png\"\n\
                 per_m2 = 16";
    let places = world.places(&world.grow(steps).unwrap().population);
    assert_eq!(places.len(), 100);
    let near = |[x, y]: [f64; 2]| {
        let off = |c: f64, at: f64| (c.rem_euclid(5.0) - at).abs();
        // Columns count from the west and rows from the north; pixels are 0.25 m.
        off(x, 7.5 * 0.25) <= 0.126 && off(y, 5.0 - 11.5 * 0.25) <= 0.126
    };
    assert!(places.iter().all(|place| near(*place)), "{places:?}");
}

#[test]
fn both_methods_give_the_exact_count_of_a_painted_image() {
    let blots = |column: usize, row: usize| {
        let (u, v) = (column as f32 / 120.0, row as f32 / 120.0);
        (0.5 + 0.5 * (7.0 * u).sin() * (9.0 * v).cos()).powi(2)
    };
    let world = plain(60, 1.0).with_species("herb", HERB).with_image("b.png", 120, 120, blots);
    let wanted: f64 = (0..120 * 120).map(|i| f64::from(blots(i % 120, i / 120)) * 0.75).sum();
    for method in ["hilbert", "floyd_steinberg"] {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"b.png\"\n\
             per_m2 = 3\nmethod = \"{method}\""
        );
        let population = world.grow(&steps).unwrap().population;
        assert_eq!(population.len(), wanted.round() as usize, "{method}");
    }
}

#[test]
fn a_local_edit_moves_only_plants_near_it_and_keeps_their_ids() {
    // A stroke over 12 m of 400 in the south-west takes away a third of what is painted.
    let painted = |edit: f32| {
        move |column: usize, row: usize| {
            let edited = (80..104).contains(&column) && (700..724).contains(&row);
            (0.3 + 0.4 * (column as f32 / 799.0)) * if edited { edit } else { 1.0 }
        }
    };
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"d.png\"\n\
                 per_m2 = 0.5\nrelax = 5";
    let planted = |edit: f32| {
        let world = plain(400, 1.0).with_species("herb", HERB);
        let world = world.with_image("d.png", 800, 800, painted(edit));
        let population = world.grow(steps).unwrap().population;
        let places = world.places(&population);
        let ids = population.plants.iter().map(|plant| plant.id);
        ids.zip(places).collect::<std::collections::BTreeMap<u64, [f64; 2]>>()
    };
    let (before, after) = (planted(1.0), planted(0.66));
    assert!(after.len() < before.len());
    let is_far = |p: &[f64; 2]| (p[0] - 46.0).hypot(p[1] - 44.0) > 90.0;
    let mut far: Vec<u64> = Vec::new();
    for (id, place) in before.iter().filter(|(_, place)| is_far(place)) {
        let stays = |p: &[f64; 2]| (p[0] - place[0]).hypot(p[1] - place[1]) < 1e-6;
        if !after.get(id).is_some_and(stays) {
            far.push(*id);
        }
    }
    // The sum is rounded as a whole, so that a few distant squares gain or lose one plant.
    assert!(far.len() < before.len() / 20, "{} of {} moved", far.len(), before.len());
}

/// The least distance between a plant of one species and one of the other, m.
fn nearest_pair(population: &weald_contract::Population, one: &str, other: &str) -> f64 {
    let of = |name: &str| {
        let index = population.species.iter().position(|known| known == name).unwrap();
        population.plants.iter().filter(move |plant| usize::from(plant.species) == index)
    };
    let mut least = f64::INFINITY;
    for a in of(one) {
        let others = of(other).filter(|b| b.id != a.id);
        least = others.map(|b| (a.x - b.x).hypot(a.y - b.y)).fold(least, f64::min);
    }
    least
}

#[test]
fn species_keep_their_distances_and_their_counts() {
    let blot = |column: usize, row: usize| {
        let path = column.abs_diff(row) < 8;
        if path { 0.0 } else { 0.3 + 0.7 * (column as f32 / 99.0) }
    };
    let world = plain(40, 1.0)
        .with_species("herb", HERB)
        .with_species("rose", HERB)
        .with_species("tree", world::TREE)
        .with_image("d.png", 100, 100, blot);
    let steps = "
        spacing = [
            { species = [\"tree\", \"rose\"], stems = 1.5 },
            { species = [\"herb\"], from = \"rose\", stems = 0.6 },
            { species = [\"herb\"], from = \"tree\", crowns = 0.8 },
            { species = [\"herb\"], stems = 0.3 },
        ]
        [[step]]
        kind = \"place\"
        species = \"tree\"
        at = [[8, 20], [30, 12], [20, 33]]
        age = [60, 80]
        vigor = [1, 1]
        [[step]]
        kind = \"halftone\"
        species = \"rose\"
        density = \"d.png\"
        per_m2 = 0.2
        [[step]]
        kind = \"halftone\"
        species = \"herb\"
        density = \"d.png\"
        per_m2 = 1.5
        age = [2, 3]";
    let outcome = world.grow(steps).unwrap();
    let painted: f64 = (0..10_000).map(|i| f64::from(blot(i % 100, i / 100)) * 0.16).sum();
    let counts = outcome.population.counts();
    assert_eq!(outcome.unplaced, []);
    assert_eq!(counts[0], 3);
    assert_eq!(counts[1], (painted * 0.2).round() as usize);
    assert_eq!(counts[2], (painted * 1.5).round() as usize);
    let population = &outcome.population;
    assert!(nearest_pair(population, "rose", "rose") >= 1.5);
    assert!(nearest_pair(population, "rose", "tree") >= 1.5);
    assert!(nearest_pair(population, "herb", "rose") >= 0.6);
    assert!(nearest_pair(population, "herb", "herb") >= 0.3);
    for tree in population.plants.iter().filter(|p| p.species == 0) {
        for herb in population.plants.iter().filter(|p| p.species == 2) {
            let apart = 0.8 * f64::from(tree.radius + herb.radius);
            assert!((tree.x - herb.x).hypot(tree.y - herb.y) >= apart);
        }
    }
    // Whoever moved still keeps off the path.
    for [x, y] in world
        .places(population)
        .iter()
        .zip(&population.plants)
        .filter_map(|(p, plant)| (plant.species > 0).then_some(*p))
    {
        assert!(blot((x * 2.5) as usize, 99 - (y * 2.5) as usize) > 0.0);
    }
}

#[test]
fn what_finds_no_place_is_counted() {
    let world = plain(20, 1.0).with_species("herb", HERB);
    let steps = "
        spacing = [{ species = [\"herb\"], stems = 1.0 }]
        [[step]]
        kind = \"halftone\"
        species = \"herb\"
        per_m2 = 2";
    let outcome = world.grow(steps).unwrap();
    let [unplaced] = outcome.unplaced[..] else { panic!("one row: {:?}", outcome.unplaced) };
    assert_eq!(unplaced.wanted, 800);
    assert_eq!(outcome.population.len() as u64, 800 - unplaced.unplaced);
    // Hexagons one metre apart hold 2/√3 plants per m²; discs dropped at random 0.697.
    assert!((270..540).contains(&outcome.population.len()), "{}", outcome.population.len());
    assert!(nearest_pair(&outcome.population, "herb", "herb") >= 1.0);
}

#[test]
fn images_are_read_by_formulas_so_that_one_density_excludes_another() {
    let half = |column: usize, _| if column < 10 { 1.0 } else { 0.25 };
    let world = plain(40, 1.0).with_species("herb", HERB).with_image("in/rose.png", 20, 20, half);
    let steps = "images = [\"in/rose.png\"]\n[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\n\
                 formula = \"1 - rose\"\nvigor = \"rose\"\nvigor_noise = 0";
    let population = world.grow(steps).unwrap().population;
    assert_eq!(population.len(), 600);
    assert!(world.places(&population).iter().all(|p| p[0] >= 20.0));
    assert!(population.plants.iter().all(|plant| plant.vigor == 0.25));
}

#[test]
fn neighbours_draw_near_and_drive_away() {
    let world = plain(60, 0.5).with_species("herb", HERB).with_species("tree", world::TREE);
    let planted = |effect: &str| {
        let steps = format!(
            "[[step]]\nkind = \"place\"\nspecies = \"tree\"\nat = [[15, 15]]\nage = [80, 80]\n\
             [[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 2\n\
             neighbour = [{{ species = \"tree\", effect = \"{effect}\", within = 1, transition = 2 }}]"
        );
        let population = world.grow(&steps).unwrap().population;
        let tree = *population.plants.iter().find(|p| p.species == 0).unwrap();
        let radius = f64::from(tree.radius);
        let away: Vec<f64> = population
            .plants
            .iter()
            .filter(|p| p.species == 1)
            .map(|p| (p.x - tree.x).hypot(p.y - tree.y) - radius)
            .collect();
        away
    };
    let (near, far) = (planted("attract"), planted("repel"));
    assert!(near.iter().all(|away| *away < 3.6) && near.len() > 60);
    assert!(far.iter().all(|away| *away > 0.4) && far.len() > 1200);
}

#[test]
fn rims_keep_the_count_inside_and_make_the_edge_younger() {
    let world = plain(50, 1.0).with_species("herb", HERB).with_image("disc.png", 200, 200, disc);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\ndensity = \"disc.png\"\n\
                 per_m2 = 2\nage = [3, 3]\n\
                 rim = { inset = 1, falloff = 4, least = 0.2, crowns_inside = true }";
    let population = world.grow(steps).unwrap().population;
    let pixels = (0..200 * 200).filter(|i| disc(i % 200, i / 200) > 0.0).count();
    assert_eq!(population.len(), (pixels as f64 * 2.0 / 16.0).round() as usize);
    for (plant, [x, y]) in population.plants.iter().zip(world.places(&population)) {
        let away = 15.0 - (x - 25.0).hypot(y - 25.0);
        // Cells are about a third of a metre.
        assert!(away > 0.6, "{away}");
        assert!(f64::from(plant.radius) < away + 0.4);
        assert!(away > 4.5 && plant.age == 3.0 || away < 4.5 && plant.age <= 3.0);
    }
    let young = population.plants.iter().map(|p| p.age).fold(3.0, f32::min);
    assert!(young < 1.2, "{young}");
}

#[test]
fn clumps_hold_what_is_planted() {
    let world = plain(60, 1.0).with_species("herb", HERB);
    let planted = |clump: &str| {
        let steps = format!(
            "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 1\nclump = {clump}"
        );
        world.grow(&steps).unwrap().population.len()
    };
    assert_eq!(planted("{ size = 6, share = 0 }"), 0);
    assert_eq!(planted("{ size = 6, share = 0, between = 0.5 }"), 1800);
    assert!((400..2400).contains(&planted("{ size = 6 }")));
}

#[test]
fn fixed_plants_keep_newcomers_off_and_stay() {
    let world = plain(40, 0.5).with_species("herb", HERB).with_species("rose", HERB);
    let planted = |around: &str| {
        let steps = format!(
            "[[step]]\nkind = \"place\"\nspecies = \"rose\"\nat = [[10, 10], [5, 14], [13.25, 6.125]]\n\
             [[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 1\nrelax = 40\n\
             around = [{around}]"
        );
        let population = world.grow(&steps).unwrap().population;
        let roses = population.plants.iter().filter(|p| p.species == 0);
        let places: Vec<[f64; 2]> = roses.map(|p| [p.x - 500_000.0, p.y - 5_200_000.0]).collect();
        assert_eq!(places, [[10.0, 10.0], [5.0, 14.0], [13.25, 6.125]]);
        nearest_pair(&population, "rose", "herb")
    };
    // In an even pattern of one plant per m², neighbours are 1.07 m apart.
    assert!(planted("\"rose\"") > 0.7);
    assert!(planted("") < 0.6);
}

#[test]
fn every_dark_blob_of_an_image_is_one_plant() {
    let dots = |column: usize, row: usize| {
        let near = |c: usize, at: usize| c.abs_diff(at) <= 2;
        let is_dot =
            near(row, 50) && (near(column, 20) || near(column, 60)) || (column, row) == (99, 0);
        if is_dot { 0.0 } else { 1.0 }
    };
    let world =
        plain(50, 1.0).with_species("tree", world::TREE).with_image("d.png", 100, 100, dots);
    let steps = "[[step]]\nkind = \"place\"\nspecies = \"tree\"\ndots = \"d.png\"\nage = [9, 9]";
    let mut places = world.places(&world.grow(steps).unwrap().population);
    places.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) < 1e-6;
    assert_eq!(places.len(), 3);
    assert!(near(places[0], [10.25, 24.75]) && near(places[1], [30.25, 24.75]), "{places:?}");
    assert!(near(places[2], [49.75, 49.75]));
}

#[test]
fn sample_plots_become_a_density() {
    let mut world = plain(60, 1.0).with_species("herb", HERB);
    let mut plots = weald_contract::Population::default();
    let herb = plots.species_index("herb");
    let ground = world.terrain.frame;
    let blank = weald_contract::Plant {
        id: 0,
        species: herb,
        state: weald_contract::State::Free,
        x: 0.0,
        y: 0.0,
        z: 0.0,
        radius: 0.0,
        height: 0.0,
        age: 0.0,
        vigor: 0.0,
        yaw: 0.0,
        lean: 0.0,
        lean_azimuth: 0.0,
    };
    for i in 0..36 {
        let [x, y] = [(i % 6) as f64 * 10.0 + 5.0, (i / 6) as f64 * 10.0 + 5.0];
        plots.plants.push(weald_contract::Plant {
            id: i,
            x: ground.west + x,
            y: ground.south + y,
            ..blank
        });
        plots.extra.entry("area".into()).or_default().push(4.0);
        let count = if x < 30.0 { 12.0 } else { 4.0 };
        plots.extra.entry("count".into()).or_default().push(count);
    }
    world.plants.insert("plots.csv".into(), plots);
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nplots = \"plots.csv\"";
    let outcome = world.grow(steps).unwrap();
    let [fit] = outcome.plot_fits[..] else { panic!("one row: {:?}", outcome.plot_fits) };
    assert_eq!(fit.plots, 36);
    assert!(fit.error > 0.1 && fit.error < 1.0, "{fit:?}");
    let west = world.places(&outcome.population).iter().filter(|p| p[0] < 30.0).count() as f64;
    let all = outcome.population.len() as f64;
    // The same as a layer of its own, halved by a formula.
    let steps = "[[step]]\nkind = \"plots\"\nplots = \"plots.csv\"\nspecies = \"herb\"\n\
                 layer = \"found\"\n[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\n\
                 formula = \"found / 2\"";
    let by_layer = world.grow(steps).unwrap();
    assert_eq!(by_layer.plot_fits, [fit]);
    assert!(by_layer.population.len().abs_diff(outcome.population.len() / 2) < 20);
    assert!(by_layer.layers.contains_key("found"));
    let (message, _) = world.mistake(&steps.replace("\"found\"", "\"water depth\""));
    assert!(message.contains("no name of a layer"), "{message}");
    let (message, _) = world.mistake(&steps.replace("\"found\"", "\"water_depth\""));
    assert!(message.contains("another layer or image"), "{message}");
    // 3 and 1 plants per m² on 1,800 m² each.
    assert!((all - 7200.0).abs() < 360.0 && (west / all - 0.75).abs() < 0.06, "{west} of {all}");
}

#[test]
fn a_view_plants_what_it_sees_with_the_ids_of_the_whole() {
    let mut world = plain(100, 1.0).with_species("herb", HERB);
    // A wall in the north, 10 m high, hides what lies behind it.
    let frame = world.terrain.frame;
    let heights = (0..frame.len()).map(|i| {
        let (_, y) = frame.center(i % frame.width, i / frame.width);
        if (70.0..73.0).contains(&(y - frame.south)) { 110.0 } else { 100.0 }
    });
    let heights = heights.collect();
    world.terrain.insert("altitude", "m", "height", heights);
    let value = weald_contract::Value::parse(
        0,
        "name = \"gate\"\nstand_at = [50, 20]\nlook_at = [50, 60]\nfov_deg = 60",
    );
    let view = weald_contract::FromToml::from_toml(&value.unwrap(), &mut Vec::new());
    world.views = vec![view.unwrap()];
    let steps = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 0.5\n";
    let whole = world.grow(steps).unwrap().population;
    let some = format!("{steps}visible_from = \"gate\"\nvisible_margin = 3");
    let seen = world.grow(&some).unwrap().population;
    let by_id: std::collections::BTreeMap<u64, _> =
        whole.plants.iter().map(|plant| (plant.id, *plant)).collect();
    assert!(seen.plants.iter().all(|plant| by_id.get(&plant.id) == Some(plant)));
    let places = world.places(&seen);
    let is_in = |p: &[f64; 2]| (p[0] - 50.0).abs() < (p[1] - 20.0) * 0.577 && p[1] < 69.0;
    let wanted = world.places(&whole).iter().filter(|p| is_in(p)).count();
    assert_eq!(places.iter().filter(|p| is_in(p)).count(), wanted);
    // Nothing behind the wall or the eye, but for margins and the rim of cells.
    assert!(places.iter().all(|p| p[1] > 15.0 && p[1] < 78.0));
    let (problem, at) = world.mistake(&some.replace("gate", "gat"));
    assert!(problem.contains("no view") && at == "\"gat\"", "{problem} {at}");
}

#[test]
fn amounts_are_columns_of_the_plants_that_ask_for_them() {
    let world = plain(40, 1.0).with_species("herb", HERB);
    let plain = "[[step]]\nkind = \"halftone\"\nspecies = \"herb\"\nper_m2 = 0.1\n";
    let amount = "amount = [{ name = \"daisies\", formula = \"(x - 20) / 10\" }]\n";
    let population = world.grow(&format!("{plain}{plain}{amount}")).unwrap().population;
    let column = &population.extra["daisies"];
    assert_eq!((population.len(), column.len()), (320, 320));
    assert_eq!(column.iter().filter(|value| value.is_nan()).count(), 160, "of the first step");
    for ([x, _], value) in world.places(&population).into_iter().zip(column) {
        let wanted = ((x - 20.0) / 10.0).max(0.0) as f32;
        assert!(value.is_nan() || (value - wanted).abs() < 1e-4, "{x} {value}");
    }
    for (name, word) in [("Daisies", "no name of a column"), ("height", "another column")] {
        let steps = format!("{plain}amount = [{{ name = \"{name}\", formula = \"1\" }}]\n");
        let error = world.grow(&steps).unwrap_err().to_string();
        assert!(error.contains(word), "{error}");
    }
}
