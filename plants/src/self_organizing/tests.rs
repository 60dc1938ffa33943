//! Fates by hand, pipes, shedding, and whole trees.

use super::fate::{Sprout, borchert_honda, priority, shares};
use super::plant::{Metamer, Plant, Slot};
use super::*;
use weald_contract::{FromToml, Value};

fn form(text: &str) -> SelfOrganizing {
    let mut problems = Vec::new();
    let read = SelfOrganizing::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
    let form = read.unwrap_or_else(|| panic!("{problems:?}"));
    assert_eq!(form.check(), Vec::new());
    form
}

/// A plant of one lateral a node from the parents of its metamers and the places they stand at;
/// all buds that are not listed in `lit` are dark.
fn plant(parents: &[(u32, usize)], lit: &[(usize, usize, f32)]) -> Plant {
    let mut plant = Plant::seedling(Vec3::ZERO, 1.0, 1);
    for (parent, place) in parents {
        let above = plant.metamers[*parent as usize];
        let new = plant.push(Metamer { parent: *parent, ..above });
        plant.slots[*parent as usize * 2 + place] = Slot::metamer(new);
    }
    plant.light = vec![0.0; plant.slots.len()];
    for (metamer, place, light) in lit {
        plant.light[metamer * 2 + place] = *light;
    }
    plant.gather();
    plant
}

fn reaching(sprouts: &[Sprout], metamer: u32, place: u32) -> f32 {
    let found = sprouts.iter().find(|s| (s.metamer, s.place) == (metamer, place));
    found.map_or(0.0, |sprout| sprout.resource)
}

#[test]
fn shares_sum_to_the_whole_and_equal_light_is_split_by_lambda() {
    for lambda in [0.0, 0.3, 0.5, 0.9, 1.0] {
        let [main, lateral] = shares(lambda, 2.0, 2.0);
        assert!((main - lambda).abs() < 1e-6 && (main + lateral - 1.0).abs() < 1e-6);
        let [main, lateral] = shares(lambda, 7.0, 0.5);
        assert!((main + lateral - 1.0).abs() < 1e-6);
    }
    assert_eq!(shares(0.5, 0.0, 0.0), [0.0, 0.0]);
    assert_eq!(shares(0.5, 3.0, 0.0), [1.0, 0.0]);
    // 0.6 * 1 / (0.6 * 1 + 0.4 * 3) = 1/3
    assert!((shares(0.6, 1.0, 3.0)[0] - 1.0 / 3.0).abs() < 1e-6);
}

#[test]
fn borchert_and_honda_by_hand() {
    // A stem of two metamers with a lateral bud at each node, and a branch of one metamer at the
    // first node:
    //   0 -- 1 -- (1,0) light 1; (1,1) light 0.5
    //    \-- 2 -- (2,0) light 0.5; (2,1) light 0
    let plant = plant(&[(0, 0), (0, 1)], &[(1, 0, 1.0), (1, 1, 0.5), (2, 0, 0.5)]);
    assert_eq!(plant.gathered, [2.0, 1.5, 0.5]);
    assert_eq!((plant.count[0], plant.buds[0]), (3, 4));
    let mut sprouts = Vec::new();
    borchert_honda(&plant, 0.6, 16.0, &mut sprouts);
    // First fork: main 0.6 * 1.5 = 0.9 against 0.4 * 0.5 = 0.2, so 16 * 9/11 and 16 * 2/11.
    // On the stem: 0.6 * 1 against 0.4 * 0.5, so 3/4 and 1/4. On the branch all goes on.
    let stem = 16.0 * 9.0 / 11.0;
    assert!((reaching(&sprouts, 1, 0) - 0.75 * stem).abs() < 1e-4);
    assert!((reaching(&sprouts, 1, 1) - 0.25 * stem).abs() < 1e-4);
    assert!((reaching(&sprouts, 2, 0) - 16.0 * 2.0 / 11.0).abs() < 1e-4);
    assert_eq!(reaching(&sprouts, 2, 1), 0.0);
    let sum: f32 = sprouts.iter().map(|sprout| sprout.resource).sum();
    assert!((sum - 16.0).abs() < 1e-4);
}

#[test]
fn buds_that_get_less_than_one_metamer_wait() {
    let plant = plant(&[], &[(0, 0, 1.0), (0, 1, 1.0)]);
    let mut sprouts = Vec::new();
    borchert_honda(&plant, 0.6, 2.0, &mut sprouts);
    assert_eq!(sprouts.len(), 1);
    assert!((sprouts[0].resource - 1.2).abs() < 1e-6);
}

#[test]
fn weights_of_the_priority_model_fall_on_a_line_to_the_part_kappa() {
    let weights = Priority { most: 1.0, least: 0.2, span: 0.5, ..defaults() };
    // Ten entries: rank 1 has 1, rank 5 has 0.2, and all later ones too.
    let found: Vec<f32> = (0..10).map(|rank| weights.weight(rank, 10)).collect();
    for (rank, wanted) in [(0, 1.0), (1, 0.8), (2, 0.6), (3, 0.4), (4, 0.2), (5, 0.2), (9, 0.2)] {
        assert!((found[rank] - wanted).abs() < 1e-6, "{found:?}");
    }
    assert_eq!(weights.weight(0, 1), 1.0);
}

#[test]
fn priority_by_hand() {
    let plant = plant(&[(0, 0), (0, 1)], &[(1, 0, 0.2), (1, 1, 0.5), (2, 0, 1.0), (2, 1, 0.5)]);
    let weights = Priority { most: 1.0, least: 0.1, span: 1.0, ..defaults() };
    // The stem's list: its tip (0.2), the lateral bud (0.5), the branch (1.5 in two buds).
    // By mean light: branch 0.75, bud 0.5, tip 0.2; weights 1, 0.55, 0.1.
    let mut sprouts = Vec::new();
    priority(&plant, &weights, false, 18.0, &mut sprouts);
    let sum = 1.5 + 0.5 * 0.55 + 0.2 * 0.1;
    assert!((reaching(&sprouts, 1, 1) - 18.0 * 0.275 / sum).abs() < 1e-4);
    // Within the branch: tip 1 with weight 1, bud 0.5 with weight 0.1.
    let branch = 18.0 * 1.5 / sum;
    assert!((reaching(&sprouts, 2, 0) - branch / 1.05).abs() < 1e-3);
    // With the tip first: tip 0.2 with weight 1, branch 1.5 with 0.55, bud 0.5 with 0.1.
    let mut sprouts = Vec::new();
    priority(&plant, &weights, true, 18.0, &mut sprouts);
    let sum = 0.2 + 1.5 * 0.55 + 0.05;
    assert!((reaching(&sprouts, 1, 0) - 18.0 * 0.2 / sum).abs() < 1e-3);
}

#[test]
fn symmetric_plants_share_symmetrically() {
    // Opposite branches of equal light get the same.
    let mut plant = Plant::seedling(Vec3::ZERO, 1.0, 2);
    for place in [1, 2] {
        let above = plant.metamers[0];
        let new = plant.push(Metamer { parent: 0, ..above });
        plant.slots[place] = Slot::metamer(new);
    }
    plant.light = vec![0.7; plant.slots.len()];
    plant.gather();
    for lambda in [0.4, 0.5, 0.6] {
        let mut sprouts = Vec::new();
        borchert_honda(&plant, lambda, 30.0, &mut sprouts);
        assert_eq!(reaching(&sprouts, 1, 0), reaching(&sprouts, 2, 0));
        assert!(reaching(&sprouts, 1, 0) > 0.0);
    }
}

#[test]
fn pipes_lead_to_every_leaf_and_remember_those_that_fell() {
    let mut plant = plant(&[(0, 0), (0, 1), (2, 0), (2, 1)], &[]);
    plant.gather_pipes();
    assert_eq!(plant.pipe, [5.0, 1.0, 3.0, 1.0, 1.0]);
    // d^n = d1^n + d2^n + one leaf, for any n.
    let width = |leaves: f32| leaves.powf(1.0 / 2.3);
    let forks = width(1.0).powf(2.3) + width(3.0).powf(2.3) + 1.0;
    assert!((width(5.0).powf(2.3) - forks).abs() < 1e-4);
    let mut forgetful = plant.clone();
    plant.shed(vec![false, false, true, false, false], true, |_| {});
    plant.gather_pipes();
    assert_eq!((plant.metamers.len(), plant.pipe[0]), (2, 5.0));
    forgetful.shed(vec![false, false, true, false, false], false, |_| {});
    forgetful.gather_pipes();
    assert_eq!(forgetful.pipe[0], 2.0);
    // The place of the fallen branch bears nothing; the other branch has kept its own.
    assert_eq!(plant.slots[1], Slot::EMPTY);
    assert_eq!(plant.slots[0], Slot::metamer(1));
}

/// The four combinations of competition and fate.
fn combinations() -> Vec<SelfOrganizing> {
    let space = "competition = 'markers'\nshed_after = 3\nmarkers = { count = 6000, space = \
        [{ shape = 'ball', center = [0, 0, 14], radius = 12 }, \
         { shape = 'cylinder', to = [0, 0, 6], radius = 2 }] }";
    let light = "shadow = { grid = [48, 48, 48] }\nshed = 0.1";
    let fates = ["fate = 'borchert_honda'", "fate = 'priority'\npriority = { least = 0.02 }"];
    let texts = fates.iter().flat_map(|fate| [light, space].map(|c| format!("{c}\n{fate}")));
    texts.map(|text| form(&text)).collect()
}

#[test]
fn all_four_combinations_grow_branched_trees_that_keep_the_contract() {
    for form in combinations() {
        let stature =
            Stature { height: 12.0, radius: 4.0, stem_radius: 0.2, maturity: 1.0, vigor: 1.0 };
        let skeleton = form.grow(14.0, &stature, Seed(3)).unwrap();
        assert_eq!(skeleton.check(), Ok(()));
        assert!(
            (skeleton.nodes.iter().map(|n| n.position.z).fold(0.0, f32::max) - 12.0).abs() < 1e-3
        );
        assert!(
            skeleton.axes.len() > 60,
            "{} axes by {:?} {:?}",
            skeleton.axes.len(),
            form.competition,
            form.fate
        );
        assert!(skeleton.axes.iter().any(|axis| axis.order >= 2));
        assert!(!skeleton.organs.is_empty());
        // Radii never grow from base to tip, and no child is thicker than its parent there.
        for axis in &skeleton.axes {
            let nodes = skeleton.nodes_of(axis);
            assert!(nodes.windows(2).all(|pair| pair[0].radius >= pair[1].radius));
        }
        // The same again, byte for byte.
        assert_eq!(skeleton, form.grow(14.0, &stature, Seed(3)).unwrap());
    }
}

#[test]
fn what_a_garden_takes_back_leaves_the_light_as_it_was() {
    let form = form("shadow = { grid = [48, 48, 48] }\nshed = 0.25");
    let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
    garden.grow_to(14.0).unwrap();
    assert!(garden.report().fallen > 0);
    // A fresh grid with the metamers that stand has the light of the one that saw it all.
    let fresh = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
    let (garden::Environment::Light(mut fresh), garden::Environment::Light(seen)) =
        (fresh.environment, &garden.environment)
    else {
        panic!("both compete for light")
    };
    garden.plant(0).metamers.iter().skip(1).for_each(|metamer| fresh.add(metamer.tip));
    for metamer in &garden.plant(0).metamers {
        assert_eq!(fresh.exposure(metamer.tip), seen.exposure(metamer.tip));
    }
}

#[test]
fn a_tree_of_more_cycles_contains_the_younger_one_when_nothing_is_shed() {
    let form = form("shadow = { grid = [48, 48, 48] }");
    let ids = |cycles: f32| -> Vec<u64> {
        let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
        garden.grow_to(cycles).unwrap();
        garden.skeleton(0, 1.0).axes.iter().map(|axis| axis.id).collect()
    };
    let old: std::collections::BTreeSet<u64> = ids(9.0).into_iter().collect();
    assert!(ids(8.0).iter().all(|id| old.contains(id)));
    let young = ids(8.0);
    assert_eq!(young.len(), young.iter().collect::<std::collections::BTreeSet<_>>().len());
}

#[test]
fn lambda_makes_trees_slender_or_round() {
    let slenderness = |lambda: f32| {
        let form = form(&format!("lambda = {lambda}\nshadow = {{ grid = [64, 64, 64] }}"));
        let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
        garden.grow_to(12.0).unwrap();
        let skeleton = garden.skeleton(0, 1.0);
        skeleton.height() / skeleton.reach()
    };
    assert!(slenderness(0.6) > 1.5 * slenderness(0.46));
}

#[test]
fn trees_side_by_side_grow_away_from_each_other() {
    let form = form("shadow = { grid = [64, 48, 48] }");
    let feet = [(Vec3::new(-4.0, 0.0, 0.0), 1.0), (Vec3::new(4.0, 0.0, 0.0), 1.0)];
    let mut garden = Garden::new(&form, &feet, Seed(1)).unwrap();
    garden.grow_to(13.0).unwrap();
    let mean = |index: usize| {
        let metamers = &garden.plant(index).metamers;
        metamers.iter().map(|m| m.tip.x).sum::<f32>() / metamers.len() as f32
    };
    assert!(mean(0) < -4.5 && mean(1) > 4.5, "{} and {}", mean(0), mean(1));
}

#[test]
fn nothing_grows_into_a_wall_or_through_the_grid() {
    let wall = "script = 'at 0 obstacle box 2,-50,-1 4,50,50'";
    for more in [
        "",
        "competition = 'markers'\nmarkers = { count = 8000, space = [{ shape = 'ball', center = [0, 0, 10], radius = 12 }] }\n",
    ] {
        let form = form(&format!("{more}{wall}\nshadow = {{ grid = [40, 40, 40], voxel = 1.0 }}"));
        let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
        garden.grow_to(12.0).unwrap();
        let tips = || garden.plant(0).metamers.iter().map(|metamer| metamer.tip);
        assert!(tips().count() > 100);
        assert!(tips().all(|tip| !(2.0..=4.0).contains(&tip.x)));
        assert!(tips().all(|tip| tip.abs().max_element() <= 50.0));
    }
}

#[test]
fn a_neighbour_takes_light_and_space() {
    let form = form("shadow = { grid = [64, 48, 48] }");
    let grow = |neighbors: &[Neighbor]| {
        let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
        garden.stand_beside(neighbors);
        garden.grow_to(12.0).unwrap();
        let metamers = &garden.plant(0).metamers;
        metamers.iter().map(|m| m.tip.x).sum::<f32>() / metamers.len() as f32
    };
    let foot = Vec3::new(10.0, 0.0, 0.0);
    for shades_only in [true, false] {
        let beside = grow(&[Neighbor { foot, height: 40.0, radius: 9.0, shades_only }]);
        assert!(beside < grow(&[]) - 0.5, "{beside}");
    }
}

#[test]
fn commands_bend_prune_and_paint() {
    let base = "shadow = { grid = [48, 48, 48] }\n";
    let tips = |text: &str| -> Vec<Vec3> {
        let form = form(text);
        let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
        garden.grow_to(10.0).unwrap();
        garden.plant(0).metamers.iter().map(|metamer| metamer.tip).collect()
    };
    let free = tips(base);
    let bent = tips(&format!("{base}script = 'at 3 bend 0,0,2 toward 1,0,0 by 60'"));
    let mean_x = |tips: &[Vec3]| tips.iter().map(|tip| tip.x).sum::<f32>() / tips.len() as f32;
    assert!(mean_x(&bent) > mean_x(&free) + 1.0, "{}", mean_x(&bent));
    let hedge = tips(&format!("{base}script = 'every 1 prune outside box -3,-3,-1 3,3,9'"));
    // One cycle grows between two cuts.
    assert!(hedge.iter().all(|tip| tip.x.abs() < 20.0));
    assert!(hedge.len() < free.len());
    let painted = tips(
        "competition = 'markers'\nmarkers = { count = 0 }\n\
         script = '''\nat 0 brush add tube 0,0,0 0,0,12 radius 3 markers 3000\n\
         at 5 brush add ball 9,0,12 4 markers 1500'''",
    );
    assert!(painted.iter().any(|tip| tip.x > 7.0));
}

#[test]
fn what_cannot_grow_is_told() {
    let problems = |text: &str| {
        let mut problems = Vec::new();
        let read = SelfOrganizing::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
        problems.extend(read.map(|form| form.check()).unwrap_or_default());
        problems.iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
    };
    for (text, words) in [
        ("competition = 'markers'\nmarkers = { count = 0 }", "no space to grow in"),
        ("competition = 'markers'", "markers need a `space`"),
        ("pipe_exponent = 0.5", "allowed: 1 to 6"),
        ("lambda = 1.5", "allowed: 0 to 1"),
        ("shadow = { grid = [1024, 1024, 1024] }", "at most"),
        ("script = 'at 1 prune near'", "line 1 of the script"),
        ("priority = { most = 0.1, least = 0.5 }", "weights fall"),
        ("tropism_toward = [0, 0, 0]", "no direction"),
    ] {
        let told = problems(text);
        assert!(told.contains(words), "{text}: {told}");
    }
    let form = form("script = 'at 0 brush add ball 0,0,1 1 markers 5'");
    let mut garden = Garden::new(&form, &[(Vec3::ZERO, 1.0)], Seed(1)).unwrap();
    let error = garden.grow_to(2.0).unwrap_err().to_string();
    assert!(error.contains("competition = \"markers\""), "{error}");
}
