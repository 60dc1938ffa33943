//! Whole populations: what palette, instances and report promise to plants and render.

use std::collections::{BTreeMap, BTreeSet};
use weald_contract::{Plant, Population, Problems, Progress, Seed, Silent, Species, State, Value};
use weald_quantize::{Bytes, Config, Error, Mode, Quantized, Weights, quantize, quantize_within};

fn species(text: &str) -> Species {
    let mut problems: Problems = Vec::new();
    let value = Value::parse(0, text).unwrap();
    Species::read(&value, &mut problems).unwrap_or_else(|| panic!("{problems:?}"))
}

fn tree(height: f32) -> Species {
    species(&format!("[size]\nheight = {height}\ncrown_radius = {}\n[form]", height / 4.0))
}

fn group(side: f32, members: &[(&str, f32)]) -> Species {
    let mut text = format!("[size]\nheight = 1\ncrown_radius = 1\n[group]\nside = {side}\n");
    for (name, per_m2) in members {
        text += &format!("[[group.member]]\nspecies = \"{name}\"\nper_m2 = {per_m2}\n");
    }
    species(&text)
}

/// Aspens, oaks, and tufts both free-standing and in lawns of patches inside patches.
fn meadow() -> BTreeMap<String, Species> {
    let pairs = [
        ("aspen", tree(18.0)),
        ("oak", tree(25.0)),
        ("tuft", tree(0.4)),
        ("daisy", tree(0.2)),
        ("turf", group(1.0, &[("tuft", 30.0), ("daisy", 2.0)])),
        ("lawn", group(4.0, &[("turf", 1.0), ("daisy", 0.5)])),
    ];
    pairs.map(|(name, kind)| (name.to_string(), kind)).into_iter().collect()
}

fn population(n: u64, names: &[&str], kinds: &BTreeMap<String, Species>) -> Population {
    let plant = |id: u64| {
        let mut random = Seed(5).stream("plants", id);
        let index = random.below(names.len() as u64) as usize;
        let (age, vigor) = (random.range(0.5, 90.0) as f32, random.unit() as f32);
        let size = &kinds[names[index]].size;
        let height = size.height_at(age, vigor) * random.range(0.8, 1.2) as f32;
        Plant {
            id: 10 + id,
            species: index as u16,
            state: State::Free,
            x: 500_000.0 + random.range(0.0, 400.0),
            y: 5_000_000.0 + random.range(0.0, 400.0),
            z: random.range(300.0, 310.0) as f32,
            radius: size.radius_of_height(height),
            height,
            age,
            vigor,
            yaw: random.range(0.0, 6.0) as f32,
            lean: random.range(0.0, 0.3) as f32,
            lean_azimuth: random.range(0.0, 6.0) as f32,
        }
    };
    Population {
        species: names.iter().map(|name| name.to_string()).collect(),
        plants: (0..n).map(plant).collect(),
        ..Population::default()
    }
}

fn run(config: &Config, plants: &Population) -> Result<Quantized, Error> {
    quantize(config, plants, &meadow(), Seed(7), &Silent)
}

fn whole_meadow(n: u64) -> Population {
    population(n, &["aspen", "oak", "tuft", "turf", "lawn"], &meadow())
}

#[test]
fn every_row_refers_to_a_prototype_and_counts_sum_to_rows() {
    let plants = whole_meadow(3000);
    let Quantized { palette, instances, report } = run(&Config::default(), &plants).unwrap();
    let ids: Vec<u32> = palette
        .representatives
        .iter()
        .map(|r| r.id)
        .chain(palette.groups.iter().map(|g| g.id))
        .collect();
    assert_eq!(ids, (1..=ids.len() as u32).collect::<Vec<_>>());
    let mut counts: BTreeMap<u32, u64> = ids.iter().map(|id| (*id, 0)).collect();
    for prototype in &instances.prototype {
        *counts.get_mut(prototype).expect("a row refers to nothing") += 1;
    }
    for r in &palette.representatives {
        assert_eq!(counts[&r.id], r.count);
        assert!(r.count > 0 && r.height > 0.0 && (0.0..=1.0).contains(&r.vigor));
    }
    assert!(palette.groups.iter().all(|g| counts[&g.id] == g.count && g.count > 0));
    assert_eq!(report.instances, instances.len() as u64);
    assert_eq!(instances.group.iter().filter(|group| **group == 0).count(), 3000);
}

#[test]
fn rows_of_the_scene_follow_the_plants_and_keep_their_place_and_height() {
    let plants = whole_meadow(1000);
    let Quantized { palette, instances, .. } = run(&Config::default(), &plants).unwrap();
    for (index, plant) in plants.plants.iter().enumerate() {
        let row = instances.row(index);
        assert_eq!((row.group, row.plant_id), (0, plant.id));
        assert_eq!(row.position, [plant.x, plant.y, f64::from(plant.z)]);
        let norm: f32 = row.rotation.iter().map(|q| q * q).sum();
        assert!((norm - 1.0).abs() < 1e-6);
        let name = &plants.species[usize::from(plant.species)];
        match palette.representatives.iter().find(|r| r.id == row.prototype) {
            Some(r) => {
                assert_eq!(&r.species, name);
                assert!((row.scale * r.height / plant.height - 1.0).abs() < 1e-5);
            }
            None => {
                let group = palette.groups.iter().find(|g| g.id == row.prototype).unwrap();
                assert_eq!((&group.species, row.scale), (name, 1.0));
            }
        }
    }
}

#[test]
fn patches_hold_what_their_recipe_asks_for_and_nest_without_a_cycle() {
    let plants = whole_meadow(2000);
    let Quantized { palette, instances, .. } = run(&Config::default(), &plants).unwrap();
    let of: BTreeMap<u32, &str> = palette.groups.iter().map(|g| (g.id, &*g.species)).collect();
    let mut members: BTreeMap<u32, (u32, u32)> = BTreeMap::new();
    let inside = (0..instances.len()).map(|i| instances.row(i)).filter(|row| row.group != 0);
    for row in inside {
        let side = if of[&row.group] == "turf" { 1.0 } else { 4.0 };
        let half = side / 2.0;
        assert!(row.position[..2].iter().all(|x| (-half..half).contains(x)));
        let counts = members.entry(row.group).or_default();
        match of.get(&row.prototype) {
            Some(inner) => {
                assert_eq!((of[&row.group], *inner), ("lawn", "turf"));
                counts.0 += 1;
            }
            None => counts.1 += 1,
        }
    }
    for group in &palette.groups {
        let (patches, singles) = members[&group.id];
        let expected = if group.species == "turf" { [0.0, 32.0] } else { [16.0, 8.0] };
        // Each member's number is its mean, rounded up or down.
        assert!((f64::from(patches) - expected[0] * f64::from(group.vigor)).abs() <= 1.0);
        assert!((f64::from(singles) - expected[1] * f64::from(group.vigor)).abs() <= 2.0);
    }
    let variants: BTreeSet<u32> = of.keys().copied().collect();
    assert_eq!(variants.len(), 2 * 4 * 8, "two groups, four kinds, eight variants");
}

#[test]
fn what_is_seen_is_counted_through_all_levels() {
    let plants = whole_meadow(600);
    let Quantized { palette, instances, report } = run(&Config::default(), &plants).unwrap();
    // Brute force: expand every group from the scene down.
    fn expand(group: u32, rows: &BTreeMap<u32, Vec<u32>>, groups: &BTreeSet<u32>) -> u64 {
        rows.get(&group)
            .into_iter()
            .flatten()
            .map(
                |prototype| {
                    if groups.contains(prototype) { expand(*prototype, rows, groups) } else { 1 }
                },
            )
            .sum()
    }
    let mut rows: BTreeMap<u32, Vec<u32>> = BTreeMap::new();
    for (group, prototype) in instances.group.iter().zip(&instances.prototype) {
        rows.entry(*group).or_default().push(*prototype);
    }
    let groups = palette.groups.iter().map(|g| g.id).collect();
    assert_eq!(report.seen, expand(0, &rows, &groups) as f64);
    assert!(report.compression > 100.0);
}

#[test]
fn more_representatives_bring_plants_closer_to_them() {
    let plants = population(4000, &["aspen", "oak"], &meadow());
    let at = |representatives| {
        let config = Config { representatives, ..Config::default() };
        run(&config, &plants).unwrap().report.species[0].clone()
    };
    let (few, many) = (at(4), at(64));
    assert_eq!((few.representatives, many.representatives), (4, 64));
    assert!(many.distortion < few.distortion / 4.0);
    assert!(many.age.mean < few.age.mean && many.vigor.mean < few.vigor.mean);
    assert!(many.height.mean < few.height.mean);
}

#[test]
fn a_model_for_each_plant_is_the_plant() {
    let plants = population(50, &["aspen"], &meadow());
    let config = Config { representatives: 50, ..Config::default() };
    let Quantized { report, instances, .. } = run(&config, &plants).unwrap();
    let aspen = &report.species[0];
    assert_eq!((aspen.age.worst, aspen.vigor.worst, aspen.height.worst), (0.0, 0.0, 0.0));
    assert!(instances.scale.iter().all(|scale| *scale == 1.0));
}

#[test]
fn a_budget_is_spent_whole_and_more_on_the_species_that_varies() {
    let kinds = meadow();
    let mut plants = population(2000, &["aspen", "oak"], &kinds);
    for plant in plants.plants.iter_mut().filter(|plant| plant.species == 1) {
        (plant.age, plant.vigor) = (40.0 + plant.age * 0.01, 0.5);
        plant.height = kinds["oak"].size.height_at(plant.age, plant.vigor);
    }
    let config = Config { budget: Some(20), ..Config::default() };
    let report = run(&config, &plants).unwrap().report;
    assert_eq!(report.representatives, 20);
    assert!(report.species[0].representatives > 15);
    let config = Config { budget: Some(1), ..Config::default() };
    let error = run(&config, &plants).unwrap_err().to_string();
    assert!(error.contains("`quantize.budget` is 1") && error.contains("2 species"), "{error}");
}

#[test]
fn weights_by_area_fit_large_plants_better_than_uniform_ones() {
    let plants = population(3000, &["aspen"], &meadow());
    let tall_error = |weights| {
        let config = Config { weights, representatives: 6, ..Config::default() };
        let Quantized { instances, .. } = run(&config, &plants).unwrap();
        let tall = plants.plants.iter().zip(&instances.scale).filter(|(p, _)| p.height > 12.0);
        tall.map(|(_, scale)| f64::from((scale - 1.0).abs())).sum::<f64>()
    };
    assert!(tall_error(Weights::Area) < tall_error(Weights::Uniform));
}

#[test]
fn the_same_bytes_for_one_thread_and_two_and_any_order_of_plants() {
    let plants = whole_meadow(40_000);
    let on = |threads, plants: &Population| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| run(&Config::default(), plants)).unwrap()
    };
    let one = on(1, &plants);
    assert_eq!(one, on(2, &plants));
    let reversed = Population { plants: plants.plants.iter().rev().copied().collect(), ..plants };
    let other = on(2, &reversed);
    assert_eq!(one.palette.representatives, other.palette.representatives);
    let last = reversed.len() - 1;
    assert!((0..=last).all(|i| one.instances.row(i) == other.instances.row(last - i)));
}

#[test]
fn nothing_one_plant_and_plants_of_no_height_are_populations_too() {
    for mode in [Mode::Paper, Mode::Fast, Mode::Best, Mode::Exact] {
        let config = Config { mode, ..Config::default() };
        let none = run(&config, &Population::default()).unwrap();
        assert!(none.palette.representatives.is_empty() && none.instances.is_empty());
        let one = run(&config, &population(1, &["oak"], &meadow())).unwrap();
        assert_eq!((one.palette.representatives.len(), one.instances.len()), (1, 1));
        let mut seeds = population(5, &["oak"], &meadow());
        for plant in &mut seeds.plants {
            (plant.age, plant.height, plant.radius) = (0.0, 0.0, 0.0);
        }
        let seeds = run(&config, &seeds).unwrap();
        assert!(seeds.instances.scale.iter().all(|scale| scale.is_finite() && *scale > 0.0));
    }
}

#[test]
fn exact_gives_every_plant_a_model_as_it_is() {
    let plants = population(300, &["oak"], &meadow());
    let exact = run(&Config { mode: Mode::Exact, ..Config::default() }, &plants).unwrap();
    let models = &exact.palette.representatives;
    assert_eq!(models.len(), plants.len());
    for (row, plant) in plants.plants.iter().enumerate() {
        let model = &models[exact.instances.prototype[row] as usize - 1];
        assert_eq!((model.age, model.vigor, model.height), (plant.age, plant.vigor, plant.height));
        assert_eq!((exact.instances.scale[row], model.count), (1.0, 1));
    }
    assert!(exact.report.species.iter().all(|species| species.distortion < 1e-12));
}

#[test]
fn a_plant_with_an_impossible_number_is_named() {
    type Spoil = fn(&mut Plant);
    let spoil: [(&str, Spoil); 5] = [
        ("age", |p| p.age = f32::NAN),
        ("height", |p| p.height = -1.0),
        ("vigor", |p| p.vigor = 1.5),
        ("x", |p| p.x = f64::INFINITY),
        ("lean", |p| p.lean = f32::NAN),
    ];
    for (name, spoil) in spoil {
        let mut plants = population(5, &["oak"], &meadow());
        spoil(&mut plants.plants[3]);
        let error = run(&Config::default(), &plants).unwrap_err().to_string();
        assert!(error.starts_with(&format!("plant 13: `{name}` is ")), "{error}");
    }
}

#[test]
fn an_unknown_species_is_named_with_the_nearest_known() {
    let mut plants = population(5, &["oak"], &meadow());
    plants.species[0] = "oaj".into();
    let error = run(&Config::default(), &plants).unwrap_err().to_string();
    assert!(error.contains("`oaj`") && error.contains("did you mean `oak`?"), "{error}");
}

#[test]
fn a_group_that_contains_itself_is_refused_naming_both() {
    let mut kinds = meadow();
    kinds.insert("turf".into(), group(1.0, &[("tuft", 30.0), ("lawn", 1.0)]));
    let problems = Config::default().check(&kinds);
    assert_eq!(problems.len(), 1);
    let text = problems[0].to_string();
    assert!(text.contains("`turf`") && text.contains("`lawn`"), "{text}");
    let error = quantize(&Config::default(), &whole_meadow(10), &kinds, Seed(1), &Silent);
    assert!(error.is_err());
}

#[test]
fn a_member_that_is_no_species_points_at_its_name() {
    let mut kinds = meadow();
    kinds.insert("turf".into(), group(1.0, &[("tufft", 30.0)]));
    let problems = Config::default().check(&kinds);
    assert!(problems[0].span.is_some() && problems[0].to_string().contains("`tuft`"));
}

#[test]
fn patches_of_absurd_size_are_refused_before_memory_is_taken() {
    let mut kinds = meadow();
    kinds.insert("turf".into(), group(50.0, &[("tuft", 1000.0)]));
    let result = quantize(&Config::default(), &whole_meadow(2000), &kinds, Seed(1), &Silent);
    assert!(result.unwrap_err().to_string().contains("members"));
}

#[test]
fn models_fit_into_the_bytes_that_are_allowed() {
    let of_model = |name: &str| if name == "oak" { 1000 } else { 100 };
    let plants = population(3000, &["aspen", "oak"], &meadow());
    let within = |budget| {
        let bytes = Bytes { budget, of_model: &of_model };
        quantize_within(bytes, &Config::default(), &plants, &meadow(), Seed(7), &Silent)
    };
    let mut last = f64::INFINITY;
    for budget in [1100, 4000, 16_000] {
        let Quantized { palette, report, .. } = within(budget).unwrap();
        let bytes: u64 = palette.representatives.iter().map(|r| of_model(&r.species)).sum();
        assert!(bytes <= budget && bytes > budget - 1000, "{bytes} of {budget}");
        let distortion: f64 = report.species.iter().map(|s| s.distortion).sum();
        assert!(distortion < last);
        last = distortion;
    }
    assert!(within(1099).unwrap_err().to_string().contains("1100"));
}

#[test]
fn no_plant_is_farther_off_in_height_than_allowed() {
    let plants = population(2000, &["aspen", "oak"], &meadow());
    let mut last = 0;
    for most in [0.5, 0.2, 0.1] {
        let config =
            Config { representatives: 1, max_height_error: Some(most), ..Config::default() };
        let report = run(&config, &plants).unwrap().report;
        assert!(report.species.iter().all(|s| s.height.worst <= f64::from(most)));
        assert!(report.representatives > last);
        last = report.representatives;
    }
}

#[test]
fn plants_near_the_eye_are_nearer_to_their_models() {
    let plants = population(4000, &["aspen"], &meadow());
    let eye = [500_100.0, 5_000_100.0, 305.0];
    let near = |plant: &Plant| (plant.x - eye[0]).hypot(plant.y - eye[1]) < 30.0;
    let error = |config: &Config, is_seen: &dyn Fn(&Plant) -> bool| {
        let found = run(config, &plants).unwrap();
        let off = |(index, plant): (usize, &Plant)| {
            let model = found.instances.prototype[index] as usize - 1;
            f64::from((plant.height / found.palette.representatives[model].height).ln().abs())
        };
        let all = plants.plants.iter().enumerate().filter(|(_, plant)| is_seen(plant));
        let (sum, count) = all.fold((0.0, 0.0), |(sum, n), plant| (sum + off(plant), n + 1.0));
        sum / count
    };
    let view = Config { weights: Weights::View, eye: Some(eye), ..Config::default() };
    assert!(error(&view, &near) < error(&Config::default(), &near));
    // Looking the other way, the same plants are as far, but out of the picture.
    let looking = |dx: f64| Config { target: Some([eye[0] + dx, eye[1]]), ..view.clone() };
    let [east, west] = [looking(1000.0), looking(-1000.0)];
    let in_the_east = |plant: &Plant| {
        let angle = (plant.y - eye[1]).atan2(plant.x - eye[0]).to_degrees();
        near(plant) && angle.abs() < 0.5 * east.fov_deg
    };
    assert!(error(&east, &in_the_east) < error(&west, &in_the_east));
    let blind = Config { eye: None, ..view };
    assert!(run(&blind, &plants).unwrap_err().to_string().contains("eye"));
}

#[test]
fn the_report_names_the_worst_plants_and_counts_each_level() {
    let plants = whole_meadow(1500);
    let Quantized { palette, instances, report } = run(&Config::default(), &plants).unwrap();
    let [of_plants, of_groups] = &report.levels[..] else { panic!("two levels") };
    assert_eq!(of_plants.prototypes, palette.representatives.len() as u64);
    assert_eq!(of_groups.instances, palette.groups.iter().map(|g| g.count).sum::<u64>());
    assert_eq!(of_plants.instances + of_groups.instances, instances.len() as u64);
    for kind in report.species.iter().filter(|kind| kind.species == "oak") {
        let [worst, next, ..] = &kind.worst_plants[..] else { panic!("oaks stand in the scene") };
        assert!(worst.distance >= next.distance);
        let row = plants.plants.iter().position(|plant| plant.id == worst.plant).unwrap();
        assert_eq!(instances.prototype[row], worst.representative);
        assert!((f64::from(instances.scale[row]) - worst.height).abs() < 1e-6);
    }
}

#[test]
fn a_caller_can_stop_the_work() {
    struct Stop;
    impl Progress for Stop {
        fn begin(&self, _: &str, _: u64, _: &str) {}
        fn advance(&self, _: u64) {}
        fn is_cancelled(&self) -> bool {
            true
        }
    }
    let result = quantize(&Config::default(), &whole_meadow(10), &meadow(), Seed(1), &Stop);
    assert!(matches!(result, Err(Error::Cancelled)));
}

#[test]
fn the_report_reads_as_a_table() {
    let report = run(&Config::default(), &whole_meadow(500)).unwrap().report;
    let text = report.to_string();
    assert_eq!(text.lines().count(), 2 + report.species.len() + 1);
    assert!(text.lines().all(|line| line.chars().count() <= 120));
}

#[test]
fn a_lawn_has_as_many_daisies_as_its_column_says() {
    let mut kinds = meadow();
    let text = "[size]\nheight = 1\ncrown_radius = 1\n[group]\nside = 2\n\
                [[group.member]]\nspecies = \"tuft\"\nper_m2 = 10\n\
                [[group.member]]\nspecies = \"daisy\"\nper_m2 = 8\namount = \"daisies\"\n";
    kinds.insert("green".into(), species(text));
    let outer = "[size]\nheight = 1\ncrown_radius = 1\n[group]\nside = 6\n\
                 [[group.member]]\nspecies = \"green\"\nper_m2 = 0.25\n";
    kinds.insert("park".into(), species(outer));
    let config = Config { group_representatives: 16, group_variants: 4, ..Config::default() };
    for name in ["green", "park"] {
        let mut plants = population(2000, &[name], &kinds);
        let amounts = (0..2000).map(|i| [0.0, 0.5, 2.0, f32::NAN][i % 4]).collect();
        plants.extra.insert("daisies".into(), amounts);
        let found = quantize(&config, &plants, &kinds, Seed(7), &Silent).unwrap();
        let of = |name: &str| {
            let seen = found.report.species.iter().find(|species| species.species == name);
            seen.map_or(0.0, |species| species.seen)
        };
        // Mean of 0, 0.5, 2 and 1, and of 1, times plants a square metre.
        let ratio = of("daisy") / of("tuft");
        assert!((ratio / (8.0 * 0.875 / 10.0) - 1.0).abs() < 0.05, "{name}: {ratio}");
        if name == "park" {
            continue;
        }
        // Patches without daisies are told from the others.
        let daisies: BTreeSet<u32> = {
            let of_species = found.palette.representatives.iter().filter(|r| r.species == "daisy");
            of_species.map(|r| r.id).collect()
        };
        let rows = found.instances.group.iter().zip(&found.instances.prototype);
        let with: BTreeSet<u32> =
            rows.filter(|(_, model)| daisies.contains(model)).map(|(group, _)| *group).collect();
        let has = |index: usize| with.contains(&found.instances.prototype[index]);
        let count = |kind: usize| (kind..2000).step_by(4).filter(|index| has(*index)).count();
        assert_eq!(count(0), 0);
        assert!(count(2) > 450, "{}", count(2));
    }
    let plants = population(20, &["green"], &kinds);
    let error = quantize(&config, &plants, &kinds, Seed(7), &Silent).unwrap_err().to_string();
    assert!(error.contains("`daisies`") && error.contains("`green`"), "{error}");
    let mut plants = plants;
    plants.extra.insert("daisies".into(), vec![-1.0; 20]);
    let error = quantize(&config, &plants, &kinds, Seed(7), &Silent).unwrap_err().to_string();
    assert!(error.contains("plant 10") && error.contains("-1"), "{error}");
}
