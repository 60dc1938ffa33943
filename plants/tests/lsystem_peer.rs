//! Strings of our L-systems against those of `symbios`, a program that others wrote after the
//! same book [Prus90].
//!
//! The two agree on the whole of the language but for three things, which the grammars here leave
//! out: symbios draws lots among all productions that fit, ours takes the first without a weight;
//! symbios lets a right context look beyond the end of a branch, where [Prus90] §1.8 has none; and
//! its precision is double.

use proptest::prelude::*;
use symbios::System;
use weald_contract::{FromToml, Seed, Value};
use weald_plants::lsystem::rewrite::{Word, derive};
use weald_plants::{Lsystem, Stature};

const GROWN: Stature =
    Stature { height: 1.0, radius: 0.5, stem_radius: 0.005, maturity: 1.0, vigor: 1.0 };

/// Our string, in symbios' way of writing it.
fn ours(axiom: &str, rules: &[String], ignore: &str, steps: u16) -> String {
    let rules = rules.join("\n");
    let text = format!("ignore = '{ignore}'\naxiom = '{axiom}'\nrules = '''\n{rules}\n'''");
    let mut problems = Vec::new();
    let form = Lsystem::from_toml(&Value::parse(0, &text).unwrap(), &mut problems);
    assert!(problems.is_empty(), "{problems:?}\n{text}");
    let grammar = form.unwrap().grammar().unwrap_or_else(|p| panic!("{p:?}\n{text}"));
    let word =
        derive(&grammar, f32::from(steps), &GROWN, Seed(1), &mut |_| Ok(Vec::new())).unwrap();
    let written = |module| {
        let values: Vec<String> =
            Word::values_of(&word, module).iter().map(|v| format!("{v:.4}")).collect();
        let values =
            if values.is_empty() { String::new() } else { format!("({})", values.join(", ")) };
        format!("{}{values}", module.symbol)
    };
    word.modules.iter().map(written).collect::<Vec<_>>().join(" ")
}

fn theirs(axiom: &str, rules: &[String], ignore: &str, steps: u16) -> String {
    let mut system = System::new();
    // Their letters are words: ours, of one letter each, are set apart.
    let apart = |text: &str| {
        let mut depth = 0;
        let mut out = String::new();
        for c in text.chars() {
            depth += i32::from(c == '(') - i32::from(c == ')');
            if depth == 0 && c != ')' && !c.is_ascii_digit() && c != '-' && c != '>' {
                out.push(' ');
            }
            out.push(c);
        }
        out
    };
    let ignored: Vec<String> = ignore.chars().map(|c| c.to_string()).collect();
    system.add_directive(&format!("#ignore: + - {}", ignored.join(" "))).unwrap();
    for rule in rules {
        let (head, body) = rule.split_once("->").unwrap();
        let rule = format!(
            "{head} -> {}",
            body.chars().fold(String::new(), |out, c| out + &c.to_string())
        );
        let (head, body) = rule.split_once("->").unwrap();
        let (sides, condition) = head.split_once(':').map_or((head, None), |(a, b)| (a, Some(b)));
        let condition = condition.map_or(String::new(), |c| format!(" : {c}"));
        system.add_rule(&format!("{}{condition} -> {}", apart(sides), apart(body))).unwrap();
    }
    system.set_axiom(&apart(axiom)).unwrap();
    system.derive(usize::from(steps)).unwrap();
    system.state.display(&system.interner).to_string()
}

#[track_caller]
fn agree(axiom: &str, rules: &[&str], ignore: &str, steps: u16) -> usize {
    let rules: Vec<String> = rules.iter().map(ToString::to_string).collect();
    let ours = ours(axiom, &rules, ignore, steps);
    assert_eq!(ours, theirs(axiom, &rules, ignore, steps));
    ours.split(' ').count()
}

#[test]
fn the_grammars_of_the_book_give_the_same_strings() {
    // §1.3, the quadratic Koch island: 4 sides, each replaced by 8; between them 4 and 11 turns.
    let island = agree("F-F-F-F", &["F -> F-F+F+FF-F-F+F"], "", 3);
    assert_eq!(island, 4 * 512 + 4 - 1 + 4 * 73 * 6);
    // Figure 1.24 b, d and e: bracketed plants.
    agree("F", &["F -> F[+F]F[-F][F]"], "", 4);
    agree("X", &["X -> F[+X]F[-X]+X", "F -> FF"], "", 5);
    agree("X", &["X -> F-[[X]+X]+F[+FX]-X", "F -> FF"], "", 5);
    // Equation 1.1, Anabaena catenula, its four states as letters.
    let filament = ["A -> CB", "B -> DA", "C -> AX", "D -> XB", "X -> X"];
    agree("A", &filament[..4], "", 8);
    // Figure 1.38 and the row of trees of figure 1.40.
    let counters = [
        "A(x, y) : y <= 3 -> A(x * 2, x + y)",
        "A(x, y) : y > 3 -> B(x)A(x / y, 0)",
        "B(x) : x < 1 -> C",
        "B(x) : x >= 1 -> B(x - 1)",
    ];
    agree("B(2)A(4, 4)", &counters, "", 4);
    let row = ["F(x) -> F(x * 0.5)+F(x * 0.25)-F(x * 0.25)+F(x * 0.5)"];
    agree("F(1)", &row, "", 4);
    // §1.8: a signal from the root and one from a tip, and neighbours among ignored letters.
    agree("B[+A]A[-A]A[+A]A", &["B < A -> B"], "", 3);
    agree("FAFAFAFB", &["A > B -> B"], "F", 3);
    agree("P(3)A(1)A(2)Q(4)", &["P(a) < A(x) > A(y) : a > 1 -> A(a + x + y)"], "", 1);
}

/// A successor: letters with parameters, turns and branches.
fn successor(context: bool) -> impl Strategy<Value = String> {
    let values = if context {
        vec!["x + 1", "x - 2", "x * 0.5", "y - x", "x + y"]
    } else {
        vec!["x + 1", "x - 2", "x * 0.5", "3", "4 - x"]
    };
    let module = (prop::sample::select(vec!["A", "B", "C", "F"]), prop::sample::select(values))
        .prop_map(|(letter, value)| match letter {
            "A" | "B" => format!("{letter}({value})"),
            _ => letter.to_string(),
        });
    let piece = (module, 0_u8..6).prop_map(|(module, wrap)| match wrap {
        0 => format!("[+{module}]"),
        1 => format!("[{module}-F]"),
        2 => format!("+{module}"),
        _ => module,
    });
    prop::collection::vec(piece, 1..4).prop_map(|pieces| pieces.concat())
}

/// Two productions of a letter that never fit together, the first with a left context or none.
fn productions(letter: &'static str) -> impl Strategy<Value = Vec<String>> {
    let left = prop::sample::select(vec![
        ("", false),
        ("C < ", false),
        ("B(y) < ", true),
        ("A(y) < ", true),
    ]);
    (left, -2..3_i32)
        .prop_flat_map(|((left, lends), at)| {
            (Just(left), Just(at), successor(lends), successor(false))
        })
        .prop_map(move |(left, at, first, second)| {
            vec![
                format!("{left}{letter}(x) : x > {at} -> {first}"),
                format!("{letter}(x) : x <= {at} -> {second}"),
            ]
        })
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, ..ProptestConfig::default() })]
    #[test]
    fn any_branching_grammar_gives_the_same_string(
        a in productions("A"),
        b in productions("B"),
        c in successor(false).prop_map(|body| body.replace('x', "2")),
        steps in 0_u16..5,
    ) {
        let rules = [a, b, vec![format!("C -> {c}")]].concat();
        let axiom = "CA(1)[+B(2)F]B(3)A(0)";
        prop_assert_eq!(ours(axiom, &rules, "F", steps), theirs(axiom, &rules, "F", steps));
    }
}
