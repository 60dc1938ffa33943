//! The trees of Xu and Mould's table 2 in `scenes/species/irregular`.

use weald_contract::{FromToml, Representative, Seed, Species, Value};
use weald_plants::Form;

/// Endpoints of all levels by the paper's numbers of branches.
const TABLE_2: [(&str, u64); 15] = [
    ("a", 12 + 36 + 108 + 648),
    ("b", 10 + 50 + 500),
    // Levels 2 and 5 fork, 3, 4 and 6 to 8 go on.
    ("c", 30 + 3 * 60 + 4 * 120),
    ("d", 2 + 20 + 120 + 720),
    ("e", 10 + 40 + 160 + 960),
    // Eight more around each of seven levels' endpoints.
    ("f", 7 * 32 * 9),
    ("g", 8 + 48 + 576),
    ("h", 11 + 66 + 396),
    ("i", 16 + 128 + 1024),
    ("j", 42 + 126 + 378 + 1512),
    ("k", 4 * 40 * 4),
    ("l", 16 + 16 + 160),
    ("m", 50 + 200 + 800),
    ("n", 35 + 140 + 560 + 2240),
    ("o", 10 + 10 + 10 + 120),
];

fn species(name: &str) -> (Species, Form) {
    let folder = concat!(env!("CARGO_MANIFEST_DIR"), "/../scenes/species/irregular");
    let text = std::fs::read_to_string(format!("{folder}/{name}.toml")).unwrap();
    let mut problems = Vec::new();
    let species = Species::read(&Value::parse(0, &text).unwrap(), &mut problems).unwrap();
    let form = Form::from_toml(species.form.as_ref().unwrap(), &mut problems);
    assert!(problems.is_empty(), "{name}: {problems:?}");
    (species, form.unwrap())
}

#[test]
fn trees_of_table_2_have_its_endpoints_and_sound_skeletons() {
    for (name, endpoints) in TABLE_2 {
        let (species, form) = species(name);
        assert_eq!(form.check(), Vec::new(), "{name}");
        let Form::Irregular(irregular) = &form else { panic!("{name}") };
        let report = irregular.tree(1.0, Seed(1)).unwrap().report;
        assert_eq!(irregular.estimate().0, endpoints as f64, "{name}");
        if irregular.obstacle.is_empty() {
            assert_eq!((report.endpoints_in_all(), report.lost), (endpoints, 0), "{name}");
        } else {
            // Nothing grows into the ground: graphs close to it hold a few less.
            let part = report.endpoints_in_all() as f64 / endpoints as f64;
            assert!((0.95..=1.0).contains(&part), "{name}: {part}");
        }
        let height = species.size.height_at(300.0, 1.0);
        let plant = Representative {
            id: 1,
            species: name.into(),
            age: 300.0,
            vigor: 1.0,
            height,
            radius: species.size.radius_of_height(height),
            weight: 1.0,
            count: 1,
        };
        let skeleton = weald_plants::skeleton(&form, &species.size, &plant, Seed(1)).unwrap();
        assert_eq!(skeleton.check(), Ok(()), "{name}");
        assert!((skeleton.height() / height - 1.0).abs() < 0.1, "{name}");
    }
}
