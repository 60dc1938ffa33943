//! Trees as published, against published counts and hand-worked lengths.

use super::*;
use crate::Form;
use weald_contract::{FromToml, Representative, Size, Species, Value};

fn species(text: &str) -> (Size, Form) {
    let species = Species::read(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap();
    let form = Form::from_toml(species.form.as_ref().unwrap(), &mut Vec::new()).unwrap();
    (species.size, form)
}

fn mature(size: &Size) -> Representative {
    Representative {
        id: 1,
        species: "tree".into(),
        age: 1e4,
        vigor: 1.0,
        height: size.height,
        radius: size.crown_radius,
        weight: 1.0,
        count: 1,
    }
}

fn grown(text: &str, seed: u64) -> Skeleton {
    let (size, form) = species(text);
    crate::skeleton(&form, &size, &mature(&size), Seed(seed)).unwrap()
}

const OAK: &str = include_str!("../../../scenes/species/oak.toml");
const TUPELO: &str = include_str!("../../../scenes/species/tupelo.toml");

#[test]
fn black_oaks_have_the_stems_and_leaves_of_the_reference_program() {
    // Arbaro grows 4,613 stems and 73,179 leaves from these parameters with its default seed.
    // Splits are left to chance, so trees differ; the mean of a few must come near.
    let trees: Vec<Skeleton> = (0..6).map(|seed| grown(OAK, seed)).collect();
    let mean = |count: fn(&Skeleton) -> usize| {
        trees.iter().map(count).sum::<usize>() as f64 / trees.len() as f64
    };
    let (stems, leaves) = (mean(|t| t.axes.len()), mean(|t| t.organs.len()));
    assert!((stems / 4613.0 - 1.0).abs() < 0.1, "{stems} stems");
    assert!((leaves / 73179.0 - 1.0).abs() < 0.1, "{leaves} leaves");
}

#[test]
fn tupelos_have_exactly_the_published_numbers_of_branches() {
    // No splits: one trunk, 50 branches, and on a branch of relative length s
    // round(25 (0.2 + 0.8 s)) twigs, where s is ShapeRatio 4 at its offset.
    let tupelo = grown(TUPELO, 1);
    let order = |order: u8| tupelo.axes.iter().filter(|axis| axis.order == order).count();
    assert_eq!((order(0), order(1)), (1, 50));
    let twigs: u32 = (0..50)
        .map(|slot| {
            let from_top = 1.0 - (slot as f32 + 0.5) / 50.0;
            formula::second_level_count(25, 0.5 + 0.5 * from_top)
        })
        .sum();
    assert_eq!(order(2), twigs as usize);
}

#[test]
fn branch_lengths_follow_the_envelope() {
    let text = "title = \"x\"\n[size]\nheight = 10\ncrown_radius = 3\n[form]\ngenerator = \"weber_penn\"\nshape = 0\nbase_size = 0.2\n[[form.level]]\ncurve_res = 4\n[[form.level]]\nbranches = 8\nlength = [0.3, 0]\ncurve_res = 4\ndown_angle_deg = [90, 0]\n[form.leaf]\ncount = 0\n";
    let skeleton = grown(text, 1);
    let lengths: Vec<f32> = skeleton
        .axes
        .iter()
        .filter(|axis| axis.order == 1)
        .map(|axis| {
            let nodes = skeleton.nodes_of(axis);
            nodes[0].position.distance(nodes[nodes.len() - 1].position)
        })
        .collect();
    for (slot, length) in lengths.iter().enumerate() {
        // Conical: 10 m × 0.3 × (0.2 + 0.8 ratio), ratio falling evenly from the crown's foot.
        let ratio = 1.0 - (slot as f32 + 0.5) / 8.0;
        assert!((length - 3.0 * (0.2 + 0.8 * ratio)).abs() < 1e-3, "{slot}: {length}");
    }
}

#[test]
fn level_branches_stand_at_right_angles_and_turn_by_the_helix() {
    let text = "title = \"x\"\n[size]\nheight = 10\ncrown_radius = 3\n[form]\ngenerator = \"weber_penn\"\n[[form.level]]\n[[form.level]]\nbranches = 5\nlength = [0.3, 0]\nrotate_deg = [100, 0]\ndown_angle_deg = [90, 0]\n[form.leaf]\ncount = 0\n";
    let skeleton = grown(text, 3);
    let directions: Vec<glam::Vec3> = skeleton
        .axes
        .iter()
        .filter(|axis| axis.order == 1)
        .map(|axis| {
            let nodes = skeleton.nodes_of(axis);
            (nodes[1].position - nodes[0].position).normalize()
        })
        .collect();
    for pair in directions.windows(2) {
        assert!(pair[0].z.abs() < 1e-4);
        assert!((pair[0].dot(pair[1]) - 100.0_f32.to_radians().cos()).abs() < 1e-4);
    }
}

#[test]
fn pruned_willows_stay_in_their_envelope() {
    let (size, form) = species(include_str!("../../../scenes/species/weeping_willow.toml"));
    let young = Representative { height: 5.0, ..mature(&size) };
    let willow = crate::skeleton(&form, &size, &young, Seed(2)).unwrap();
    // Prune width 0.4 of the height, plus what the last stretch to the exact height adds.
    let wood = willow.nodes.iter().map(|node| node.position.truncate().length());
    let reach = wood.fold(0.0, f32::max);
    assert!(reach < 0.4 * 5.0 * 1.25, "{reach}");
    let hanging = willow.nodes.iter().filter(|node| node.position.z < 0.5 * 5.0).count();
    assert!(hanging * 4 > willow.nodes.len(), "{hanging} of {}", willow.nodes.len());
}

#[test]
fn forks_of_forks_come_to_an_end() {
    let text = "title = \"x\"\n[size]\nheight = 10\ncrown_radius = 3\n[form]\ngenerator = \"weber_penn\"\n[[form.level]]\ncurve_res = 64\nseg_splits = 4\nsplit_angle_deg = [30, 10]\n[form.leaf]\ncount = 3\n";
    let skeleton = grown(text, 1);
    assert_eq!(skeleton.check(), Ok(()));
    assert!(skeleton.axes.len() < 100);
}

#[test]
fn helices_and_fans_grow_too() {
    let text = "title = \"x\"\n[size]\nheight = 3\ncrown_radius = 1\n[form]\ngenerator = \"weber_penn\"\n[[form.level]]\ncurve_res = 12\ncurve_v_deg = -30\n[form.leaf]\ncount = -7\nrotate_deg = [120, 0]\n";
    let skeleton = grown(text, 1);
    assert_eq!(skeleton.check(), Ok(()));
    // Leaves spread over a fan at the very tip.
    let tip = skeleton.nodes.last().unwrap().position;
    assert_eq!(skeleton.organs.len(), 7);
    assert!(skeleton.organs.iter().all(|leaf| leaf.position.distance(tip) < 1e-3));
}

proptest::proptest! {
    #![proptest_config(proptest::prelude::ProptestConfig {
        cases: 64, failure_persistence: None, rng_seed: proptest::test_runner::RngSeed::Fixed(1), ..Default::default()
    })]
    #[test]
    fn no_parameters_break_a_tree(
        shape in 0_u32..=8,
        taper in 0.0_f32..=3.0,
        res in 1_u32..12,
        angles in proptest::array::uniform8(-180.0_f32..180.0),
        splits in 0.0_f32..2.0,
        up in -5.0_f32..5.0,
        sizes in proptest::array::uniform4(0.0_f32..1.0),
        is_pruned: bool,
        fit_crown: bool,
        seed: u64,
    ) {
        let [a, b, c, d, e, f, g, h] = angles;
        let [base, length, maturity, vigor] = sizes;
        let base = 0.9 * base;
        // A trunk that turns to the ground cannot have the height asked for.
        let trunk = 0.3 * a;
        let prune = if is_pruned { "prune = { width = 0.3 }" } else { "" };
        let text = format!(
            "shape = {shape}\nbase_size = {base}\nattraction_up = {up}\nfit_crown = {fit_crown}\n\
             flare = 0.7\nlobes = 3\nlobe_depth = 0.2\nbase_splits = 1\nscar = [0.1, 0.1, 0.1]\n{prune}\n\
             [[level]]\ncurve_res = {res}\ntaper = {taper}\ncurve_v_deg = {trunk}\nseg_splits = {splits}\n\
             split_angle_deg = [{b}, 20]\n\
             [[level]]\nbranches = 7\ncurve_res = {res}\ntaper = {taper}\nlength = [{length}, 0.1]\n\
             down_angle_deg = [{c}, {d}]\nrotate_deg = [{e}, 10]\ncurve_deg = {f}\ncurve_back_deg = {g}\n\
             [[level]]\nbranches = 4\ndown_angle_deg = [{d}, 10]\nlength = [0.5, {length}]\ncurve_v_deg = {h}\n\
             [leaf]\ncount = 5\ndroop = {length}\nbend = {base}\nstalk = 0.5\n"
        );
        let mut problems = Vec::new();
        let form = WeberPenn::from_toml(&Value::parse(0, &text).unwrap(), &mut problems);
        proptest::prop_assert!(problems.is_empty(), "{:?}", problems);
        let (height, radius) = (8.0 * maturity.max(0.01), 2.0 * maturity.max(0.01));
        let stature =
            Stature { height, radius, stem_radius: 0.02 * height, maturity: maturity.max(0.01), vigor };
        let skeleton = form.unwrap().grow(&stature, Seed(seed));
        proptest::prop_assert_eq!(skeleton.check(), Ok(()));
        proptest::prop_assert!((skeleton.height() - height).abs() < 1e-3 * height);
    }
}
