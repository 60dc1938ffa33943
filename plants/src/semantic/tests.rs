//! What the paper states, and what edits must keep.

use super::script::Editor;
use super::tree::Tree;
use super::trees::TREES;
use super::{Semantic, Statistics};
use glam::Vec3;
use proptest::prelude::*;

const SMALL: &str = "cps main on trunk count 8 anchor 0.2-1 angle 60~5 length 0.6\n\
                     cps twigs on level:1 count 5 length 0.2";

fn small() -> Editor {
    let mut editor = Editor::new(7);
    editor.run(SMALL).unwrap();
    editor
}

/// Everything but the count of work done.
fn same(a: &Tree, b: &Tree) -> bool {
    a.root == b.root && a.branches == b.branches
}

#[test]
fn the_nine_trees_have_the_papers_counts() {
    for (example, seed) in TREES.into_iter().flat_map(|tree| (1..5).map(move |seed| (tree, seed))) {
        let mut editor = Editor::new(seed);
        let operations = editor.run(example.script).unwrap();
        let counted = Statistics::of(editor.tree());
        assert!(operations <= 40, "{}", example.name);
        assert_eq!(counted.branches, example.branches, "{}", example.name);
        let ratio = counted.leaves as f64 / example.leaves as f64;
        assert!((0.98..1.02).contains(&ratio), "{}: {} leaves", example.name, counted.leaves);
        let each = counted.parameters / counted.branches;
        assert!(each <= 300, "{}: {each} bytes a branch", example.name);
    }
}

#[test]
fn a_child_begins_at_the_interpolated_control_points() {
    let points = [Vec3::ZERO, Vec3::Z, Vec3::new(1.0, 0.0, 1.0)];
    let at = |anchor| super::tree::point_at(&points, anchor).0;
    assert_eq!(at(-1.0), points[0]);
    assert_eq!(at(2.0), points[2]);
    assert_eq!(at(0.25), Vec3::new(0.0, 0.0, 0.5));
    assert_eq!(at(0.75), Vec3::new(0.5, 0.0, 1.0));
}

#[test]
fn modes_widen_a_selection_as_the_paper_says() {
    let rebuilt = |modes: &str| {
        let mut editor = small();
        editor.run("select path trunk/main/0").unwrap();
        editor.run(modes).unwrap();
        editor.run("tag seen\nselect tag seen").unwrap();
        editor.selected().len()
    };
    assert_eq!(rebuilt(""), 1);
    assert_eq!(rebuilt("mode same_level on"), 8);
    assert_eq!(rebuilt("mode recursive on"), 6);
    assert_eq!(rebuilt("mode recursive on\nmode same_level on"), 48);
}

#[test]
fn only_what_hangs_on_an_edited_branch_is_rebuilt() {
    let mut editor = small();
    let before = editor.tree().rebuilt;
    editor.run("select path trunk/main/3\nset length 0.9").unwrap();
    assert_eq!(editor.tree().rebuilt - before, 6);
    let mut anew = editor.tree().clone();
    anew.rebuild(anew.root.unwrap());
    assert!(same(&anew, editor.tree()));
}

#[test]
fn moving_a_point_carries_what_follows_and_deduces_length_and_anchor() {
    let mut editor = small();
    let length = editor.tree().get(0).value(super::tree::LENGTH);
    let before = editor.tree().clone();
    editor.run("select trunk\nmove point 4 by 0,0,0.5").unwrap();
    let tree = editor.tree();
    assert!((tree.get(0).value(super::tree::LENGTH) - length - 0.5).abs() < 1e-4);
    for &child in &tree.get(0).children {
        let moved = tree.get(child).points[0] - before.get(child).points[0];
        let part = (before.get(child).anchor * 4.0 - 3.0).max(0.0);
        assert!((moved - Vec3::new(0.0, 0.0, 0.5 * part)).length() < 1e-4);
    }
    editor.run("select path trunk/main/0\nmove point 0 by 0,0,0.1").unwrap();
    let child = editor.selected()[0];
    let (old, new) = (tree_anchor(&before, child), tree_anchor(editor.tree(), child));
    assert!(new > old && editor.tree().get(child).edited != 0);
}

fn tree_anchor(tree: &Tree, id: u32) -> f32 {
    tree.get(id).anchor
}

#[test]
fn da_vincis_law_keeps_the_area_of_sections() {
    let mut editor = small();
    editor.run("select trunk\nradii calculate").unwrap();
    let tree = editor.tree();
    // 1 trunk and 48 others end in tips of 2 mm.
    let expected = 0.002 * (49f32).sqrt();
    assert!((tree.get(0).radii[0] - expected).abs() < 1e-5);
    assert!((tree.get(0).value(super::tree::RADIUS) - expected).abs() < 1e-5);
    editor.run("set radius 0.05").unwrap();
    assert_eq!(editor.tree().get(0).radii[0], 0.05);
}

#[test]
fn sawing_removes_what_is_beyond_and_a_trunk_can_be_sketched_anew() {
    let mut editor = small();
    editor.run("select trunk\nsaw at 0.5").unwrap();
    let tree = editor.tree();
    assert!((tree.get(0).value(super::tree::LENGTH) - 0.5).abs() < 1e-4);
    assert!(tree.get(0).children.iter().all(|&child| tree.get(child).points[0].z <= 0.5 + 1e-4));
    // Half of a trunk from 10 mm to 2 mm.
    let cut = tree.get(0).radii.last().unwrap();
    assert!((cut - 0.006).abs() < 1e-5 && tree.get(0).radii[0] == 0.01);
    editor.run("delete\nsketch trunk 0,0,0 0,0,1 0.2,0,2").unwrap();
    let tree = editor.tree();
    assert_eq!(tree.all().len(), 1);
    assert!((tree.get(tree.root.unwrap()).points[2] - Vec3::new(0.2, 0.0, 2.0)).length() < 1e-5);
}

#[test]
fn a_camera_crosses_sketches_in_its_plane_and_saws() {
    let mut editor = Editor::new(1);
    // The trunk of 1 m fills the middle half of a picture 2 m wide.
    editor.run("camera A eye 0,-10,0.5 target 0,0,0.5 fov 11.4212").unwrap();
    editor.run("select crossing A 0.4,0.5 0.6,0.5").unwrap();
    assert_eq!(editor.selected(), [0]);
    assert!(editor.run("select crossing A 0.7,0.5 0.8,0.5").is_err());
    editor.run("sketch on #0 camera A points 5 0.5,0.5 0.6,0.45 0.7,0.3 0.75,0.2").unwrap();
    let branch = editor.tree().get(editor.selected()[0]).clone();
    assert_eq!(branch.points.len(), 5);
    assert!((branch.anchor - 0.5).abs() < 1e-3);
    assert!(branch.points.iter().all(|point| point.y.abs() < 1e-4));
    assert!((branch.points[4] - Vec3::new(0.5, 0.0, 1.1)).length() < 1e-2);
    editor.run("select trunk\nsaw camera A 0.5,0.375").unwrap();
    let trunk = editor.tree().get(0);
    assert!((trunk.value(super::tree::LENGTH) - 0.75).abs() < 1e-3);
    assert_eq!(trunk.children.len(), 1);
}

#[test]
fn a_bent_trunk_stays_where_it_was_moved() {
    let mut editor = Editor::new(1);
    let before = editor.tree().get(0).points.clone();
    editor.run("move point 1 by 0.3,0.1,0").unwrap();
    for (i, (new, old)) in editor.tree().get(0).points.iter().zip(&before).enumerate() {
        let by = if i == 0 { Vec3::ZERO } else { Vec3::new(0.3, 0.1, 0.0) };
        assert!((*new - *old - by).length() < 1e-5, "point {i} is at {new}");
    }
}

#[test]
fn imported_weber_penn_trees_keep_counts_lengths_and_places() {
    use weald_contract::{FromToml, Representative, Seed, Value};
    for text in [
        include_str!("../../../scenes/species/tupelo.toml"),
        include_str!("../../../scenes/species/quaking_aspen.toml"),
    ] {
        let species =
            weald_contract::Species::read(&Value::parse(0, text).unwrap(), &mut Vec::new());
        let species = species.unwrap();
        let form = crate::Form::from_toml(species.form.as_ref().unwrap(), &mut Vec::new()).unwrap();
        let (height, radius) = (species.size.height, species.size.crown_radius);
        let (id, weight, count) = (1, 1.0, 1);
        let (age, vigor) = (1e4, 1.0);
        let name = "tree".to_string();
        let plant = Representative { id, species: name, age, vigor, height, radius, weight, count };
        let skeleton = crate::skeleton(&form, &species.size, &plant, Seed(3)).unwrap();
        let tree = super::import::tree_of(&skeleton, 3).unwrap();
        assert_eq!(tree.all().len(), skeleton.axes.len());
        let leaves: usize = tree.all().iter().map(|&id| tree.get(id).leaf_count()).sum();
        let borne = skeleton
            .organs
            .iter()
            .filter(|o| skeleton.prototypes[o.prototype as usize].name != "scar");
        assert_eq!(leaves, borne.count());
        for (id, axis) in skeleton.axes.iter().enumerate() {
            let branch = tree.get(id as u32);
            let nodes = skeleton.nodes_of(axis);
            let length: f32 = nodes.windows(2).map(|p| p[0].position.distance(p[1].position)).sum();
            let deduced = branch.value(super::tree::LENGTH);
            assert!((deduced - length).abs() < 1e-3 + 1e-3 * length, "{deduced} m for {length} m");
            // The contract lets a child begin a thousandth of its parent's length off.
            let far = nodes[0].position.distance(branch.points[0]);
            assert!(far < 1e-3 * height, "{far} m off");
        }
    }
}

#[test]
fn the_oldest_states_are_forgotten_when_many_branches_are_kept() {
    let mut editor = Editor::new(1);
    editor.run("cps a on trunk count 300\ncps b on level:1 count 300 length 0.1").unwrap();
    editor.run("select trunk\nmode recursive on").unwrap();
    for gnarl in 0..40 {
        editor.run(&format!("set gnarl {gnarl}")).unwrap();
    }
    let undone = (0..40).take_while(|_| editor.run("undo").is_ok()).count();
    // 90,301 branches and a 32nd of that a state: 32 states fit into three million.
    assert_eq!(undone, 32);
}

#[test]
fn a_limit_to_tags_leaves_others_alone() {
    let mut editor = small();
    editor.run("select path trunk/main/0\ntag a\nselect path trunk/main/1\ntag a").unwrap();
    editor.run("mode same_level on\nlimit tag on\nset length 0.9").unwrap();
    let tree = editor.tree();
    let long = tree.all().into_iter().filter(|&id| tree.get(id).value(super::tree::LENGTH) == 0.9);
    assert_eq!(long.count(), 2);
}

#[test]
fn a_wrong_line_names_itself_and_changes_nothing() {
    for line in [
        "fly",
        "set",
        "set length",
        "set length x",
        "set girth 2",
        "set points 1",
        "select #999",
        "select tag none",
        "move point 9 by 0,0,1",
        "saw at 2",
        "redo",
        "cps main on trunk count 2",
        "sketch trunk 0,0,0 0,0,1",
        "radii calculate law 9",
        "camera A eye 0,0,0 target 0,0,0 fov 40",
        "select crossing B 0,0 1,1",
        "cps x on trunk count 1e9",
    ] {
        let mut editor = small();
        editor.run("select trunk").unwrap();
        let before = editor.tree().clone();
        let error = editor.run(&format!("% comment\n{line}")).unwrap_err();
        assert_eq!(error.line, 2);
        assert_eq!(&before, editor.tree(), "{line}");
    }
}

#[test]
fn skeletons_keep_the_contract() {
    let form = Semantic {
        script: weald_contract::Written { value: SMALL.into(), span: Default::default() },
        leaf_shape: crate::organ::LeafShape::Ovate,
        leaf_width: 0.6,
        leaf_color: Default::default(),
        bark: [0.1; 3],
    };
    let mut editor = small();
    editor.run("select level 2\nset leaves 4").unwrap();
    let skeleton = form.skeleton(editor.tree(), 1.0, 1.0);
    assert_eq!(skeleton.check(), Ok(()));
    assert_eq!((skeleton.axes.len(), skeleton.organs.len()), (49, 160));
}

fn line() -> impl Strategy<Value = String> {
    prop_oneof![
        (0..8u32).prop_map(|i| format!("select path trunk/main/{i}")),
        (0..3u8).prop_map(|level| format!("select level {level}")),
        (0.1..2f32).prop_map(|length| format!("set length {length}~0.05")),
        (0..12u32).prop_map(|count| format!("set count main {count}")),
        (0..5u32, -1f32..1.0).prop_map(|(i, by)| format!("move point {i} by {by},0.1,0")),
        (-40f32..40.0).prop_map(|by| format!("rotate angle {by}")),
        (0.2..0.9f32).prop_map(|at| format!("saw at {at}")),
        Just("delete".into()),
        Just("mode recursive on".into()),
        Just("mode recursive off".into()),
        Just("radii calculate".into()),
        Just("tag t".into()),
        Just("sketch on #0 at 0.5 0,0,0 0.5,0,0.2 1,0,0.1".into()),
    ]
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn undo_and_redo_lead_through_the_same_trees(lines in prop::collection::vec(line(), 1..20)) {
        let mut editor = small();
        let mut states = vec![editor.tree().clone()];
        for line in &lines {
            // Some lines are wrong after others: those leave no state.
            if editor.run(line).is_ok() {
                states.push(editor.tree().clone());
            }
        }
        for state in states.iter().rev().skip(1) {
            editor.run("undo").unwrap();
            prop_assert_eq!(state, editor.tree());
        }
        for state in &states[1..] {
            editor.run("redo").unwrap();
            prop_assert_eq!(state, editor.tree());
        }
        // What was rebuilt in parts equals what is built anew.
        if let Some(root) = editor.tree().root {
            let mut anew = editor.tree().clone();
            anew.rebuild(root);
            prop_assert!(same(&anew, editor.tree()));
        }
    }

    #[test]
    fn other_numbers_of_branches_keep_edits(
        m in 3u32..30, other in 3u32..30, picks in prop::collection::btree_set(0u32..3, 1..3),
    ) {
        let mut editor = small();
        editor.run(&format!("select trunk\nset count main {m}")).unwrap();
        for pick in &picks {
            editor.run(&format!("select path trunk/main/{pick}\nset length 0.77\nmove point 2 by 0,0,0.1")).unwrap();
        }
        let edited = |tree: &Tree| -> Vec<_> {
            let ids = tree.get(0).children.iter();
            let branches = ids.map(|&id| (id, tree.get(id))).filter(|(_, b)| b.edited != 0);
            let mut found: Vec<_> = branches.map(|(id, b)| (id, b.edited, b.style.clone(), b.shape.clone())).collect();
            found.sort_by_key(|one| one.0);
            found
        };
        let before = edited(editor.tree());
        editor.run(&format!("select trunk\nset count main {other}")).unwrap();
        prop_assert_eq!(&before, &edited(editor.tree()));
        editor.run(&format!("set count main {m}")).unwrap();
        prop_assert_eq!(&before, &edited(editor.tree()));
        prop_assert_eq!(editor.tree().get(0).children.len(), m as usize);
    }

    #[test]
    fn no_script_panics(text in "(select|set|cps|move|saw|sketch|#0|trunk|on|at|count|main|[0-9.,~-]{1,4}| |\n){0,24}") {
        let _ = small().run(&text);
    }
}
