//! Every species file of `scenes/species`, grown at many ages and vigors.

use glam::{Quat, Vec3};
use std::collections::BTreeSet;
use weald_contract::{FromToml, Mesh, PlantModel, Representative, Seed, Species, Surface, Value};
use weald_plants::detail::{self, Detail, simplify};
use weald_plants::measure::{Measures, leaf_area};
use weald_plants::{Form, Skeleton};

struct Kind {
    name: String,
    species: Species,
    form: Form,
}

impl Kind {
    /// A plant of the size that its species gives it at this age and vigor.
    fn plant(&self, age: f32, vigor: f32) -> Representative {
        let height = self.species.size.height_at(age, vigor);
        Representative {
            id: 1,
            species: self.name.clone(),
            age,
            vigor,
            height,
            radius: self.species.size.radius_of_height(height),
            weight: 1.0,
            count: 1,
        }
    }

    fn skeleton(&self, age: f32, vigor: f32) -> Skeleton {
        let plant = self.plant(age, vigor);
        weald_plants::skeleton(&self.form, &self.species.size, &plant, Seed(7)).unwrap()
    }

    fn model(&self, age: f32, vigor: f32) -> PlantModel {
        let plant = self.plant(age, vigor);
        weald_plants::grow("model", &self.form, &self.species.size, &plant, Seed(7)).unwrap()
    }
}

fn read(name: &str, text: &str) -> Species {
    let mut problems = Vec::new();
    let value = Value::parse(0, text).unwrap();
    let species = Species::read(&value, &mut problems);
    assert!(problems.is_empty(), "{name}: {problems:?}");
    species.unwrap()
}

/// All species that have a form, by name.
fn kinds() -> Vec<Kind> {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/species");
    let mut kinds: Vec<Kind> = std::fs::read_dir(folder)
        .unwrap()
        .map(|entry| entry.unwrap().path())
        .filter(|path| path.extension().is_some_and(|extension| extension == "toml"))
        .filter_map(|path| {
            let name = path.file_stem().unwrap().to_string_lossy().into_owned();
            let species = read(&name, &std::fs::read_to_string(path).unwrap());
            let mut problems = Vec::new();
            let form = Form::from_toml(species.form.as_ref()?, &mut problems);
            assert!(problems.is_empty(), "{name}: {problems:?}");
            Some(Kind { name, species, form: form.unwrap() })
        })
        .collect();
    kinds.sort_by(|a, b| a.name.cmp(&b.name));
    kinds
}

fn kind(name: &str) -> Kind {
    kinds().into_iter().find(|kind| kind.name == name).unwrap()
}

fn meshes(model: &PlantModel) -> impl Iterator<Item = &Mesh> {
    model.wood.iter().chain(model.organs.iter().flat_map(|organ| &organ.meshes))
}

fn is_finite(model: &PlantModel) -> bool {
    let mesh = |mesh: &Mesh| {
        mesh.positions.iter().chain(&mesh.normals).flatten().all(|x| x.is_finite())
            && mesh.uvs.iter().flatten().all(|x| x.is_finite())
    };
    meshes(model).all(mesh)
}

#[test]
fn every_species_is_sound_at_every_age_and_vigor() {
    for kind in kinds() {
        assert!(kind.form.check().is_empty());
        let life = kind.species.size.lifespan;
        for (age, vigor) in
            [(0.1, 0.0), (0.1, 1.0), (0.07 * life, 0.5), (0.3 * life, 0.0), (life, 1.0)]
        {
            let skeleton = kind.skeleton(age, vigor);
            let at = format!("{} of {age} years and vigor {vigor}", kind.name);
            assert_eq!(skeleton.check(), Ok(()), "{at}");
            let model = weald_plants::mesh::model("model", &skeleton);
            assert!(meshes(&model).all(|mesh| mesh.is_sound(model.materials.len())), "{at}");
            assert!(is_finite(&model), "{at}");
            assert!(model.instanced_triangles() > 0, "{at}");
            for mesh in meshes(&model) {
                assert!(
                    mesh.normals
                        .iter()
                        .all(|n| { (n.iter().map(|x| x * x).sum::<f32>() - 1.0).abs() < 1e-3 })
                );
            }
        }
    }
}

#[test]
fn models_have_the_height_asked_for() {
    for kind in kinds() {
        for (age, vigor) in [(1.0, 0.8), (0.2, 0.3), (0.5 * kind.species.size.lifespan, 1.0)] {
            let wanted = kind.plant(age, vigor).height.max(weald_plants::LOWEST);
            let model = kind.model(age, vigor);
            // Leaves of a rosette stand higher than the places where they grow.
            let is_scaled_whole = matches!(kind.form, Form::Lsystem(_));
            let height = if is_scaled_whole { top(&model) } else { model.height() };
            assert!((height / wanted - 1.0).abs() < 0.05, "{}: {height} for {wanted}", kind.name);
        }
    }
}

/// Highest vertex, those of organs at their places included.
fn top(model: &PlantModel) -> f32 {
    let organs = model.organs.iter().flat_map(|organ| {
        let corners = organ.meshes.iter().flat_map(|mesh| &mesh.positions);
        corners.flat_map(|corner| {
            organ.placements.iter().map(|place| {
                let scaled = Vec3::from_array(place.scale) * Vec3::from_array(*corner);
                place.position[2] + (Quat::from_array(place.rotation) * scaled).z
            })
        })
    });
    let wood = model.wood.iter().flat_map(|mesh| &mesh.positions).map(|p| p[2]);
    wood.chain(organs).fold(0.0, f32::max)
}

#[test]
fn fitted_crowns_have_the_radius_asked_for() {
    for name in ["aspen", "willow", "grass", "sedge", "reed", "goldenrod"] {
        let kind = kind(name);
        let life = kind.species.size.lifespan;
        for age in [0.1 * life, 0.3 * life, 0.8 * life] {
            let plant = kind.plant(age, 0.9);
            let reach = kind.skeleton(age, 0.9).reach();
            let part = reach / plant.radius;
            assert!((0.75..1.35).contains(&part), "{name} of {age} years reaches {part}");
        }
    }
}

#[test]
fn no_material_gives_back_more_light_than_it_receives() {
    for kind in kinds() {
        for vigor in [0.0, 0.5, 1.0] {
            for material in kind.model(2.0, vigor).materials {
                let through = match material.surface {
                    Surface::Leaf { transmittance } => transmittance,
                    _ => [0.0; 3],
                };
                let sums = material.reflectance.iter().zip(through).map(|(r, t)| r + t);
                assert!(sums.fold(0.0, f32::max) <= 0.951, "{}: {}", kind.name, material.name);
            }
        }
    }
}

#[test]
fn the_same_seed_gives_the_same_plant_on_any_thread() {
    for name in ["aspen", "grass", "reed", "goldenrod"] {
        let kind = kind(name);
        let here = kind.model(6.0, 0.8);
        let grow = || std::thread::scope(|s| s.spawn(|| kind.model(6.0, 0.8)).join().unwrap());
        assert!(grow() == here && grow() == here, "{name}");
        let plant = kind.plant(6.0, 0.8);
        let other =
            weald_plants::grow("model", &kind.form, &kind.species.size, &plant, Seed(8)).unwrap();
        assert!(other != here, "{name} does not depend on its seed");
    }
}

/// Length of all axes, m: what small steps must change little.
fn total_length(skeleton: &Skeleton) -> f32 {
    let axis = |axis| {
        let nodes: &[weald_plants::skeleton::Node] = skeleton.nodes_of(axis);
        nodes.windows(2).map(|p| p[0].position.distance(p[1].position)).sum::<f32>()
    };
    skeleton.axes.iter().map(axis).sum()
}

/// Area of the organs' bounding rectangles, m² up to a factor for each species.
fn organ_area(skeleton: &Skeleton) -> f32 {
    skeleton.organs.iter().map(|organ| organ.scale.x * organ.scale.y).sum()
}

#[test]
fn a_small_step_of_age_or_vigor_makes_a_small_change() {
    for kind in kinds() {
        let life = kind.species.size.lifespan;
        for age in [0.05 * life, 0.3 * life] {
            let before = kind.skeleton(age, 0.6);
            for after in [kind.skeleton(1.01 * age, 0.6), kind.skeleton(age, 0.61)] {
                // A hundredth more changes counts and lengths by a few hundredths, and a
                // plant of few parts by one or two of them.
                // Pruning drops a branch that no longer fits with all that it bears.
                let part = if kind.name == "weeping_willow" { 0.25 } else { 0.06 };
                let close = |a: f32, b: f32, few: f32| (a - b).abs() <= part * a.max(b) + few;
                // New leaves begin small, so that their number may change more than their area.
                let (a, b) = (before.organs.len() as f32, after.organs.len() as f32);
                assert!(close(a, b, part * a + 8.0), "{}: {a} to {b} organs", kind.name);
                let (a, b) = (organ_area(&before), organ_area(&after));
                // The first organ begins with no area at all: one mm² is free.
                assert!(close(a, b, 1e-6), "{} of {age} years: {a} to {b}", kind.name);
                let (a, b) = (total_length(&before), total_length(&after));
                assert!(close(a, b, 0.0), "{} of {age} years: {a} m to {b} m", kind.name);
                let (a, b) = (before.height(), after.height());
                assert!(close(a, b, 0.0), "{}: {a} m high to {b} m", kind.name);
            }
        }
    }
}

#[test]
fn a_plant_contains_its_younger_self() {
    for kind in kinds() {
        let life = kind.species.size.lifespan;
        let ids = |age: f32| -> BTreeSet<u64> {
            kind.skeleton(age, 0.7).axes.iter().map(|axis| axis.id).collect()
        };
        let (young, old) = (ids(0.1 * life), ids(0.2 * life));
        assert!(young.is_subset(&old), "{}", kind.name);
    }
}

#[test]
fn axis_ids_are_unique_within_a_plant() {
    for kind in kinds() {
        let skeleton = kind.skeleton(0.2 * kind.species.size.lifespan, 0.9);
        let ids: BTreeSet<u64> = skeleton.axes.iter().map(|axis| axis.id).collect();
        assert_eq!(ids.len(), skeleton.axes.len(), "{}", kind.name);
    }
}

#[test]
fn young_aspens_have_the_leaf_area_of_measured_trees() {
    // Medians and 5 to 95 % bands of one-sided leaf area by trunk diameter [Falster15]: 5 to
    // 10 cm, 1.7 to 52 m²; 10 to 20 cm, 6 to 135 m².
    let aspen = kind("aspen");
    for (age, band) in [(20.0, 1.7..52.0), (45.0, 6.0..135.0)] {
        let model = aspen.model(age, 0.9);
        let area: f32 = model
            .organs
            .iter()
            .filter(|organ| organ.name.starts_with("leaf"))
            .map(|organ| {
                let one: f32 = organ.meshes.iter().map(area).sum();
                organ.placements.iter().map(|p| one * p.scale[0] * p.scale[1]).sum::<f32>()
            })
            .sum();
        assert!(band.contains(&area), "{age} years: {area} m²");
    }
}

fn area(mesh: &Mesh) -> f32 {
    let corner = |i: u32| Vec3::from_array(mesh.positions[i as usize]);
    let of = |t: &[u32; 3]| {
        0.5 * (corner(t[1]) - corner(t[0])).cross(corner(t[2]) - corner(t[0])).length()
    };
    mesh.triangles.iter().map(of).sum()
}

#[test]
fn coarser_levels_keep_the_leaf_area_and_shed_triangles() {
    for name in ["aspen", "beech", "oak", "silver_birch", "tamarack", "nettle"] {
        let kind = kind(name);
        let skeleton = kind.skeleton(0.4 * kind.species.size.lifespan, 0.9);
        let area = leaf_area(&skeleton);
        let mut triangles = u64::MAX;
        for pixel in [0.0, 0.06, 0.2] {
            let detail = Detail::for_pixel(pixel);
            let coarse = simplify(&skeleton, &detail);
            assert_eq!(coarse.check(), Ok(()), "{name} at {pixel}");
            let part = leaf_area(&coarse) / area;
            assert!((0.9..1.1).contains(&part), "{name} at {pixel} m has {part} of its leaf area");
            let count = detail::model(name, &skeleton, &detail).instanced_triangles();
            assert!(count < triangles, "{name} at {pixel} m has {count} triangles");
            triangles = count;
        }
    }
}

/// Trees that may leave the measured bands: those kept as Weber and Penn published them, the palm,
/// of which no likeness was measured, and the willow, a shrub of many thin trunks.
const EXCEPTED: [&str; 6] = ["oak", "quaking_aspen", "tupelo", "weeping_willow", "palm", "willow"];

#[test]
fn trees_of_our_own_have_the_heights_and_leaf_areas_of_measured_ones() {
    let mut outside = Vec::new();
    for kind in kinds() {
        if !matches!(kind.form, Form::WeberPenn(_)) || EXCEPTED.contains(&kind.name.as_str()) {
            continue;
        }
        for part in [0.15, 0.3, 0.6] {
            let age = part * kind.species.size.lifespan;
            let findings = Measures::of(&kind.skeleton(age, 0.9)).findings();
            let real = ["height over diameter", "height, m", "leaf area, m²"];
            let found = findings.into_iter().filter(|f| real.contains(&f.name));
            let found = found.filter(|finding| !finding.is_natural());
            outside.extend(found.map(|f| format!("{} of {age} years: {f:?}", kind.name)));
        }
    }
    assert!(outside.is_empty(), "{outside:#?}");
}

#[test]
fn triangle_counts_stay_within_what_a_meadow_can_carry() {
    let limits = [
        ("aspen", 50.0, 30_000..100_000),
        ("grass", 3.0, 150..400),
        ("reed", 4.0, 180..600),
        ("goldenrod", 4.0, 200..900),
        ("susan", 2.0, 150..600),
    ];
    for (name, age, limit) in limits {
        let count = kind(name).model(age, 0.9).instanced_triangles();
        assert!(limit.contains(&count), "{name} has {count} triangles");
    }
}

#[test]
fn a_plant_of_no_finite_size_is_refused() {
    let aspen = kind("aspen");
    let plant = Representative { height: f32::NAN, ..aspen.plant(5.0, 0.5) };
    let refused = weald_plants::grow("x", &aspen.form, &aspen.species.size, &plant, Seed(1));
    assert!(refused.unwrap_err().to_string().contains("cannot be NaN m high"));
}

fn form_problems(text: &str) -> Vec<(String, String)> {
    let mut problems = Vec::new();
    let form = Form::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
    problems.extend(form.iter().flat_map(Form::check));
    let place = |p: &weald_contract::Problem| {
        let span = p.span.unwrap();
        (text[span.start as usize..span.end as usize].to_string(), p.to_string())
    };
    problems.iter().map(place).collect()
}

#[test]
fn blades_that_lie_on_the_ground_still_make_a_sound_model() {
    let text = "generator = \"grass\"\nlean_deg = [90, 90]\narch_deg = [170, 170]\nheads = 0";
    let form = Form::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap();
    let grass = kind("grass");
    let plant = grass.plant(3.0, 1.0);
    let model = weald_plants::grow("x", &form, &grass.species.size, &plant, Seed(1)).unwrap();
    assert!(is_finite(&model) && model.instanced_triangles() > 0);
}

#[test]
fn mistakes_in_a_form_are_told_at_their_own_tokens() {
    let told = form_problems("generator = \"grass\"\nblades = [0, 40]\nwidht = 0.01");
    let tokens: Vec<&str> = told.iter().map(|(token, _)| token.as_str()).collect();
    assert_eq!(tokens, ["[0, 40]", "widht"]);
    let told = form_problems("generator = \"weber_pen\"");
    assert!(told[0].1.contains("did you mean `weber_penn`?"), "{told:?}");
    let told = form_problems("generator = \"weber_penn\"\nlevel = []\nleaf = { count = 3 }");
    assert_eq!(told[0].0, "[]");
    let told = form_problems(
        "generator = \"weber_penn\"\nlevel = [{}, {branches = 999}, {branches = 999}]\nleaf = { count = 999 }",
    );
    assert!(told[0].1.contains("lower `branches`"), "{told:?}");
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig {
        cases: 24, failure_persistence: None, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..Default::default()
    })]
    #[test]
    fn no_stature_breaks_a_small_plant(
        which in 0_usize..9, height in 0.0_f32..3.0, radius in 0.0_f32..2.0, vigor in 0.0_f32..=1.0,
        seed in 0_u64..1000,
    ) {
        let small = ["aspen", "grass", "sedge", "herbage", "reed", "cattail", "goldenrod", "coneflower", "willow"];
        let kind = kind(small[which]);
        let plant = Representative { height, radius, ..kind.plant(1.0, vigor) };
        let skeleton =
            weald_plants::skeleton(&kind.form, &kind.species.size, &plant, Seed(seed)).unwrap();
        proptest::prop_assert_eq!(skeleton.check(), Ok(()));
        proptest::prop_assert!(is_finite(&weald_plants::mesh::model("x", &skeleton)));
    }
}
