use super::*;
use crate::skeleton::Node;
use weald_contract::{FromToml, Value};

const GROWN: Stature =
    Stature { height: 1.0, radius: 0.5, stem_radius: 0.005, maturity: 1.0, vigor: 1.0 };

fn read(text: &str) -> Lsystem {
    let mut problems = Vec::new();
    let form = Lsystem::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
    assert!(problems.is_empty(), "{problems:?}");
    form.unwrap()
}

/// The string of a grammar whose questions stay without an answer.
fn derive(grammar: &grammar::Grammar, steps: f32, seed: Seed) -> rewrite::Word {
    rewrite::derive(grammar, steps, &GROWN, seed, &mut |_| Ok(Vec::new())).unwrap()
}

/// The string after so many steps, as text.
fn string(axiom: &str, rules: &str, steps: f32) -> String {
    let form = read(&format!("axiom = '{axiom}'\nrules = '''\n{rules}\n'''"));
    let grammar = form.grammar().unwrap();
    derive(&grammar, steps, Seed(3)).to_string()
}

#[test]
fn lindenmayers_algae_grow_by_fibonacci() {
    // [Prus90] §1.2, with a and b exchanged for capital letters.
    let rules = "A -> AB\nB -> A";
    assert_eq!(string("A", rules, 0.0), "A");
    assert_eq!(string("A", rules, 4.0), "ABAABABA");
    assert_eq!(string("A", rules, 10.0).len(), 144);
}

#[test]
fn parameters_and_conditions_follow_the_derivation_in_the_book() {
    // [Prus90] §1.10.1, figure 1.38.
    let rules = "A(x, y) : y <= 3 -> A(x * 2, x + y)\n\
                 A(x, y) : y > 3 -> B(x) A(x / y, 0)\n\
                 B(x) : x < 1 -> C\n\
                 B(x) : x >= 1 -> B(x - 1)";
    let steps = ["B(2)A(4,4)", "B(1)B(4)A(1,0)", "B(0)B(3)A(2,1)", "CB(2)A(4,3)", "CB(1)A(8,7)"];
    for (expected, time) in steps.iter().zip(0_u8..) {
        assert_eq!(string("B(2)A(4,4)", rules, f32::from(time)), *expected);
    }
}

#[test]
fn a_signal_travels_along_the_string() {
    let rules = "B < A -> B\nB -> A";
    assert_eq!(string("BAAAA", rules, 1.0), "ABAAA");
    assert_eq!(string("BAAAA", rules, 3.0), "AAABA");
    // Signs of the turtle are not seen.
    assert_eq!(string("B+(30)A", rules, 1.0), "A+(30)B");
}

#[test]
fn a_context_passes_over_branches_as_in_the_book() {
    // [Prus90] §1.8: S has BC before and G[H]M after it.
    let axiom = "ABC[DE][SG[HI[JK]L]MNO]";
    assert_eq!(string(axiom, "BC < S > G[H]M -> X", 1.0), "ABC[DE][XG[HI[JK]L]MNO]");
    assert_eq!(string(axiom, "BC < S > G[I]M -> X", 1.0), axiom);
    assert_eq!(string(axiom, "E < S -> X", 1.0), axiom);
    assert_eq!(string(axiom, "G > M -> X", 1.0), "ABC[DE][SX[HI[JK]L]MNO]");
    assert_eq!(string(axiom, "C > N -> X", 1.0), axiom);
    assert_eq!(string("A[B]C", "A > C -> X", 1.0), "X[B]C");
    assert_eq!(string("A[B]C", "A < B -> X", 1.0), "A[X]C");
}

#[test]
fn contexts_lend_their_parameters() {
    assert_eq!(
        string("A(1)B(2)C(3)", "A(a) < B(b) > C(c) -> D(a + 10 * b + 100 * c)", 1.0),
        "A(1)D(321)C(3)"
    );
}

#[test]
fn letters_that_are_ignored_do_not_stand_between_neighbours() {
    let text = "ignore = 'F'\naxiom = 'AFFB'\nrules = 'A < B -> C'";
    let grammar = read(text).grammar().unwrap();
    assert_eq!(derive(&grammar, 1.0, Seed(1)).to_string(), "AFFC");
}

#[test]
fn chance_keeps_to_the_weights() {
    // 400 modules, weights 3 to 1: mean 300, standard deviation 8.7.
    let axiom = "A".repeat(400);
    let made = string(&axiom, "A -> B : 3\nA -> C : 1", 1.0);
    let count = made.chars().filter(|c| *c == 'B').count();
    assert!((265..335).contains(&count), "{count}");
}

#[test]
fn the_cut_removes_the_rest_of_its_branch() {
    assert_eq!(string("A[B%C[D]E]F", "Z -> Z", 1.0), "A[B]F");
}

#[test]
fn decomposition_and_interpretation_repeat_until_nothing_fits() {
    let form = read(
        "axiom = 'A(5)'\nrules = 'A(n) -> B(n)'\n\
         decomposition = 'B(n) : n > 1 -> C B(n - 1)'\n\
         interpretation = '''\nC -> D\nD -> EE\n'''",
    );
    let word = derive(&form.grammar().unwrap(), 1.0, Seed(3));
    assert_eq!(word.to_string(), "EEEEEEEEB(1)");
}

#[test]
fn defined_numbers_and_those_of_the_plant_are_known_everywhere() {
    let rules = "define long = 2 * height\ndefine more = long + vigor\nA(x) -> B(more + x)";
    assert_eq!(string("A(0.5)", rules, 1.0), "B(3.5)");
}

#[test]
fn functions_of_tables_are_defined_once_and_called_anywhere() {
    let rules = "define open(t) = curve(t, 0, 0, 2, 1)\n\
                 define twice(t, k) = open(t) * k + open(t - 1)\n\
                 A(x) : open(x) > 0.4 -> B(twice(x, 10))";
    assert_eq!(string("A(1)A(0.5)A(9)", rules, 1.0), "B(5)A(0.5)B(11)");
}

#[test]
fn the_turtles_place_and_frame_answer_questions() {
    let form = read(
        "axiom = 'F(2)+(90)F(1)?P(0,0,0)?H(0,0)A'\n\
         rules = '?P(x, y, z) ?H(a, b) < A -> B(x, y, z, a, b)'",
    );
    let grammar = form.grammar().unwrap();
    let mut skeleton = Skeleton::default();
    let styles = form.styles(&mut skeleton, 1.0);
    let word = rewrite::derive(&grammar, 1.0, &GROWN, Seed(3), &mut |word| {
        let questions = turtle::draw(&form, word, &styles, &GROWN, &mut skeleton.clone())?;
        Ok(form.environment.answers(&questions))
    });
    let word = word.unwrap();
    let last = word.modules.last().unwrap();
    let rounded: Vec<f32> = word.values_of(last).iter().map(|v| (v * 1e4).round() / 1e4).collect();
    assert_eq!(rounded, [1.0, 0.0, 2.0, 1.0, 0.0]);
}

/// A bush clipped to a sphere of radius 0.4 around (0, 0, 1), the topiary of [Prus94].
const CLIPPED: &str = "fit_crown = false\nsteps = 12\nangle_deg = 35\naxiom = 'F(1)A?P(0,0,0)'
rules = '''
define off(x, y, z) = x^2 + y^2 + (z - 1)^2
A > ?P(x, y, z) : off(x, y, z) < 0.16 -> [+F(0.1)A?P(0,0,0)]/(90)[-F(0.1)A?P(0,0,0)]
A > ?P(x, y, z) : off(x, y, z) >= 0.16 -> %
'''";

#[test]
fn shoots_that_know_their_place_can_be_kept_within_a_shape() {
    let skeleton = grown(CLIPPED, &GROWN);
    let tips = tips(&skeleton);
    let top = tips.iter().map(|tip| tip[2]).fold(0.0, f32::max);
    // The drawing is scaled to a height of 1; its stem is 1 high before.
    let stem = tips[0][2];
    assert!((0.65..0.75).contains(&stem) && top <= 1.0, "{stem} {top}");
    let reach = |tip: &[f32; 3]| (glam::Vec3::from_array(*tip) / stem - glam::Vec3::Z).length();
    let far = tips.iter().skip(1).map(reach).fold(0.0, f32::max);
    assert!((0.4..0.5).contains(&far), "{far}");
}

const SHADED: &str = "steps = 10\nfit_crown = false\nenvironment = { voxel = 0.05 }
axiom = 'F(0.05)A(0)?E(0.0005)'\norgan = [{ name = 'leaf', kind = 'leaf' }]
rules = '''
define size(n) = smoothstep(0, 3, time - n)
A(n) > ?E(q) : q > 0.7 -> F(0.04 * size(n)) ~leaf(0.03 * size(n))
    [+(40) A(n + 1) ?E(0.0005)] /(137.5) [-(25) A(n + 1) ?E(0.0005)]
'''";

#[test]
fn shoots_in_the_shade_rest_and_the_plant_still_contains_its_younger_self() {
    let at = |maturity: f32| grown(SHADED, &Stature { height: maturity, maturity, ..GROWN });
    let open = grown(&SHADED.replace("q > 0.7", "q > -1"), &GROWN);
    let mut before = at(0.05);
    for step in 2..=20 {
        let after = at(step as f32 / 20.0);
        let is_kept = |axis: &crate::skeleton::Axis| after.axes.iter().any(|a| a.id == axis.id);
        assert!(before.axes.iter().all(is_kept), "an axis is lost at {step}");
        before = after;
    }
    let (shaded, open) = (before.organs.len(), open.organs.len());
    assert!(shaded > 60 && 3 * shaded < open, "{shaded} of {open}");
}

fn grown(text: &str, stature: &Stature) -> Skeleton {
    let skeleton = read(text).grow(stature, Seed(5)).unwrap();
    assert_eq!(skeleton.check(), Ok(()));
    skeleton
}

fn tips(skeleton: &Skeleton) -> Vec<[f32; 3]> {
    let tip = |axis| skeleton.nodes_of(axis).last().map(|n: &Node| n.position);
    let round = |p: glam::Vec3| p.to_array().map(|x| (x * 1e4).round() / 1e4);
    skeleton.axes.iter().filter_map(tip).map(round).collect()
}

#[test]
fn the_turtle_turns_as_in_the_book() {
    // Height 1 is the height of the drawing, so that nothing is stretched.
    let tip = |signs: &str| {
        let text = format!("fit_crown = false\nsteps = 0\naxiom = 'F(1)[{signs}F(0.5)]'");
        tips(&grown(&text, &GROWN))[1]
    };
    assert_eq!(tip("+(90)"), [0.5, 0.0, 1.0]);
    assert_eq!(tip("-(90)"), [-0.5, 0.0, 1.0]);
    assert_eq!(tip("&(90)"), [0.0, -0.5, 1.0]);
    assert_eq!(tip("^(90)"), [0.0, 0.5, 1.0]);
    assert_eq!(tip("/(90)&(90)"), tip("-(90)"));
    assert_eq!(tip("\\(90)&(90)"), tip("+(90)"));
    assert_eq!(tip("|"), [0.0, 0.0, 0.5]);
}

#[test]
fn a_branch_begins_where_its_parent_had_grown_to() {
    let skeleton = grown(
        "fit_crown = false\nsteps = 0\naxiom = 'F(0.25)[+(90)F(0.1)[+(90)F(0.1)]]F(0.75)'",
        &GROWN,
    );
    let about: Vec<_> = skeleton.axes.iter().map(|a| (a.parent, a.at, a.order)).collect();
    assert_eq!(about, [(None, 0.0, 0), (Some(0), 0.25, 1), (Some(1), 1.0, 2)]);
}

#[test]
fn stems_bend_towards_the_tropism() {
    let bent = "fit_crown = false\nsteps = 0\nelasticity = 0.2\ntropism = [1, 0, 0]\n\
                axiom = 'F(0.2)F(0.2)F(0.2)F(0.2)F(0.2)'";
    let tip = tips(&grown(bent, &GROWN))[0];
    assert!(tip[0] > 0.2 && tip[1] == 0.0, "{tip:?}");
}

#[test]
fn a_surface_becomes_a_mesh_of_its_corners() {
    let square =
        "fit_crown = false\nsteps = 0\naxiom = 'F(1)+(90){.f(0.1).-(90)f(0.1).-(90)f(0.1).}'";
    let skeleton = grown(square, &GROWN);
    assert_eq!(skeleton.prototypes[0].meshes[0].triangles.len(), 2);
    assert_eq!(skeleton.organs.len(), 1);
}

const HERB: &str = "steps = 14\naxiom = 'F(0.01) A(0)'\n\
    organ = [{ name = 'leaf', kind = 'leaf' }]\nrules = '''\n\
    A(n) : n < 14 -> I(n) [ &(60) F(0.02 * smoothstep(0, 4, time - n)) ~leaf(0.1 * smoothstep(0, 4, time - n)) ] /(137.5) A(n + 1)\n\
    '''\ninterpretation = 'I(n) -> F(0.05 * smoothstep(0, 3, time - n))'";

#[test]
fn a_plant_contains_its_younger_self_and_grows_without_jumps() {
    let at = |maturity: f32| grown(HERB, &Stature { height: maturity, maturity, ..GROWN });
    let mut before = at(0.02);
    for step in 3..=100 {
        let after = at(step as f32 / 100.0);
        let is_kept = |axis: &crate::skeleton::Axis| after.axes.iter().any(|a| a.id == axis.id);
        assert!(before.axes.iter().all(is_kept), "an axis is lost at {step}");
        let area = |s: &Skeleton| s.organs.iter().map(|o| o.scale.x * o.scale.y).sum::<f32>();
        assert!((area(&after) - area(&before)).abs() < 0.01, "leaves jump at {step}");
        before = after;
    }
    assert_eq!(before.organs.len(), 14);
}

fn told(text: &str) -> Vec<(String, String)> {
    let mut problems = Vec::new();
    let form = Lsystem::from_toml(&Value::parse(0, text).unwrap(), &mut problems);
    problems.extend(form.iter().flat_map(Lsystem::check));
    let place = |p: &Problem| {
        let span = p.span.unwrap();
        (text[span.start as usize..span.end as usize].to_string(), p.to_string())
    };
    problems.iter().map(place).collect()
}

#[test]
fn mistakes_are_told_at_their_tokens() {
    let tokens = |text: &str| told(text).into_iter().map(|(t, _)| t).collect::<Vec<_>>();
    assert_eq!(tokens("axiom = 'A(lenght)'"), ["lenght"]);
    assert_eq!(tokens("axiom = 'A = B'"), ["="]);
    assert_eq!(tokens("axiom = 'A ~petal(1)'"), ["~petal"]);
    assert_eq!(tokens("axiom = 'A(1'"), ["("]);
    assert_eq!(tokens("axiom = 'A(noise(3))'"), ["noise"]);
    assert_eq!(tokens("axiom = 'F(1, 2)'\nrules = '''\nA(x) -> B(x) +(1, 2)\n'''"), ["+(1, 2)"]);
    assert_eq!(
        tokens("axiom = 'A(1)'\nrules = '''\n# first\nA(x) -> B(y)\nA(x, x) -> C\nB -> [C\n'''"),
        ["y", "x", " [C"]
    );
    assert_eq!(tokens("axiom = 'A'\ninterpretation = 'A < B -> C'"), ["<"]);
    assert_eq!(tokens("axiom = 'A ?X(0)'"), ["?"]);
    assert_eq!(tokens("axiom = 'A ?E'"), ["?E"]);
    assert_eq!(tokens("axiom = 'A ?P(0, 0, 0, 0)'"), ["?P(0, 0, 0, 0)"]);
    let functions = "define f(t = t\ndefine g(t) = u\ndefine h(t) = t\nA -> B(h(1, 2))";
    assert_eq!(
        tokens(&format!("axiom = 'A'\nrules = \'\'\'\n{functions}\n\'\'\'")),
        ["(", "u", "h(1, 2)"]
    );
    let taken = "define sqrt(x) = x\ndefine exp = 3\nA -> B";
    assert_eq!(tokens(&format!("axiom = 'A'\nrules = '''\n{taken}\n'''")), ["sqrt", "exp"]);
    assert_eq!(tokens("axiom = 'A'\nstroke = []"), ["[]"]);
    assert!(told("axiom = 'A(lenght)'")[0].1.contains("`lenght` is not known here"));
}

#[test]
fn a_string_that_grows_without_end_is_stopped_at_its_production() {
    let text = "steps = 60\naxiom = 'A'\nrules = 'A -> AA'";
    let problem = read(text).grow(&GROWN, Seed(1)).unwrap_err();
    let span = problem.span.unwrap();
    assert_eq!(&text[span.start as usize..span.end as usize], "A -> AA");
    let text = "axiom = 'A'\ndecomposition = 'A -> A'";
    let problem = read(text).grow(&GROWN, Seed(1)).unwrap_err();
    assert!(problem.to_string().contains("its own result"), "{problem}");
}

#[test]
fn numbers_without_bounds_still_make_a_sound_plant() {
    let text = "steps = 0\norgan = [{ name = 'leaf', kind = 'leaf' }]\n\
                axiom = 'F(1/0)+(0/0)F(ln(-1))!(-1)F(1e30)~leaf(1/0)~leaf(0/0, 1)&(1e30)F'";
    let skeleton = grown(text, &GROWN);
    assert!(skeleton.nodes.iter().all(|node| node.position.is_finite()));
    let only_a_leaf = "steps = 0\norgan = [{ name = 'leaf', kind = 'leaf' }]\naxiom = '~leaf(0.1)'";
    assert_eq!(grown(only_a_leaf, &GROWN).organs.len(), 1);
}
