//! Formulas: short expressions over a terrain's layers that users write in scenes and species.
//!
//! ```text
//! vigor   = clamp(soil_moisture * (1 - crown_shadow("aspen")), 0, 1)
//! density = if(water_depth > 0.1, 0, 4 + 2 * noise(25))
//! ```
//!
//! From weakest to strongest binding:
//!
//! | written | meaning |
//! |---|---|
//! | `a or b` | 1 when either is true, else 0 |
//! | `a and b` | 1 when both are true, else 0 |
//! | `not a` | 1 when `a` is false, else 0 |
//! | `< <= > >= == !=` | 1 or 0; they do not chain |
//! | `a + b`, `a - b` | |
//! | `a * b`, `a / b` | |
//! | `-a` | so `-2^2` is -4 |
//! | `a ^ b` | power, grouping to the right: `2^3^2` is 512 |
//!
//! A value is true unless it equals 0. Functions: `if(condition, then, else)`, `min` and `max` of
//! two or more, `clamp(x, low, high)`, `lerp(a, b, t)`, `smoothstep(low, high, x)`,
//! `curve(v, x0, y0, x1, y1, …)` (linear between points of rising x, flat outside), `sqrt`,
//! `exp`, `ln`, `log10`, `sin`, `cos`, `tan` (radians), `atan2(y, x)`, `abs`, `floor`, `ceil`,
//! `round` (halves away from 0), `sign` (-1, 0 or 1), `noise(wavelength)` and
//! `noise(wavelength, seed)`, `crown_shadow("species")`. `pi` is a constant, `x` and `y` are metres
//! east and north in scene coordinates, and every other name is a layer, by the stem of its file.
//!
//! Arithmetic is that of IEEE 754 single precision: division by zero and logarithms of negative
//! numbers give infinities and NaN, which callers clamp. Nothing is short-circuited, as both
//! branches of an `if` are free of effects. Functions that hardware rounds differently come from
//! `libm`, so a formula gives the same bytes everywhere.
//!
//! The text becomes a list of steps without jumps, and each step runs over a block of 1,024 values
//! before the next begins: decoding is paid once a block, intermediate values stay in the
//! first-level cache, and the plain loops compile to SIMD. On one core of a 2020s server that is
//! 4,200 million values a second for `clamp(soil_moisture*2-0.3,0,1)`, 2,000 for
//! `smoothstep(2,10,slope)*(1-water_depth)`, 300 for `exp(-slope/8)*soil_moisture`, 90 for
//! `noise(25)` and 40 for `slope^1.5`, with 4 Mi values and SSE2 alone: calls into `libm` set
//! the pace where there are any.

mod parse;
mod program;

use std::fmt;
use std::ops::Range;

pub use parse::is_function;
use program::Program;

/// What a formula reads: one number for each value that it computes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Variable {
    /// The terrain layer whose file has this stem, in the layer's unit.
    Layer(String),
    /// Shadow of the crowns of the named species, 0 (open sky) to 1.
    CrownShadow(String),
    /// Metres east of the terrain's south-west corner.
    X,
    /// Metres north of the terrain's south-west corner.
    Y,
}

/// A function that a formula may call besides those of the language.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Definition {
    /// What it is called by; one of which [`is_function`] is true would never be found.
    pub name: String,
    /// Names of its parameters.
    pub parameters: Vec<String>,
    /// A formula over them. It may call what is defined before it; other names are variables of
    /// the formula that calls it.
    pub body: String,
}

/// Why a text is not a formula, and where.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{message}")]
pub struct FormulaError {
    /// What was found and what would be right there.
    pub message: String,
    /// Bytes of the text at fault; empty at the end of the text when something is missing.
    pub span: Range<usize>,
}

/// A parsed formula, ready to run.
///
/// Two formulas are equal when their texts are.
#[derive(Clone)]
pub struct Formula {
    text: String,
    /// Each once, in order of first use.
    variables: Vec<Variable>,
    /// First use of each variable, bytes of `text`.
    spans: Vec<Range<usize>>,
    program: Program,
}

impl Formula {
    /// Reads a formula, or says where it fails and what would be right.
    ///
    /// Any name that is no function, constant or word of the language becomes a
    /// [`Variable::Layer`]: only the caller knows which layers exist.
    pub fn parse(text: &str) -> Result<Formula, FormulaError> {
        Self::parse_with(text, &[])
    }

    /// Reads a formula that may call the functions of `definitions`.
    pub fn parse_with(text: &str, definitions: &[Definition]) -> Result<Formula, FormulaError> {
        let parsed = parse::parse(text, definitions)?;
        let (variables, spans) = parsed.variables.into_iter().unzip();
        Ok(Formula { text: text.to_owned(), variables, spans, program: parsed.program })
    }

    /// Returns the formula that is `value` everywhere.
    pub fn constant(value: f32) -> Formula {
        // `inf` and `NaN`, as Rust prints them, would read as names of layers.
        let text = match value {
            v if v.is_nan() => "0 / 0".to_owned(),
            f32::INFINITY => "1 / 0".to_owned(),
            f32::NEG_INFINITY => "-1 / 0".to_owned(),
            v => v.to_string(),
        };
        Formula { text, variables: vec![], spans: vec![], program: Program::constant(value) }
    }

    /// Returns the text as it was written.
    pub fn text(&self) -> &str {
        &self.text
    }

    /// Returns what the formula reads, each once, in order of first use.
    ///
    /// `noise` counts as a use of `x`, then `y`. A variable that folding made irrelevant, as in
    /// `if(1, 2, slope)`, is listed all the same, so that a misspelt layer never goes unnoticed.
    pub fn variables(&self) -> &[Variable] {
        &self.variables
    }

    /// Returns, for each of [`Formula::variables`], the bytes of the text where it is first used:
    /// its name, or the whole call of `crown_shadow`, or the word `noise`.
    pub fn spans(&self) -> &[Range<usize>] {
        &self.spans
    }

    /// Returns the value for one input per variable, in the order of [`Formula::variables`].
    ///
    /// Gives the same bits as [`Formula::eval_block`].
    ///
    /// # Panics
    /// If the number of inputs is not the number of variables.
    pub fn eval(&self, inputs: &[f32]) -> f32 {
        self.assert_input_count(inputs.len());
        self.program.eval(inputs)
    }

    /// Computes `out[i]` from `inputs[variable][i]` for every `i`; any length, none included.
    ///
    /// # Panics
    /// If the number of inputs is not the number of variables, or the lengths differ.
    pub fn eval_block(&self, inputs: &[&[f32]], out: &mut [f32]) {
        self.assert_input_count(inputs.len());
        for (input, variable) in inputs.iter().zip(&self.variables) {
            assert_eq!(
                input.len(),
                out.len(),
                "values of {variable:?} and results differ in count"
            );
        }
        self.program.eval_block(inputs, out);
    }

    fn assert_input_count(&self, count: usize) {
        assert_eq!(count, self.variables.len(), "`{}` needs one input per variable", self.text);
    }
}

impl PartialEq for Formula {
    fn eq(&self, other: &Formula) -> bool {
        self.text == other.text
    }
}

impl Eq for Formula {}

impl fmt::Debug for Formula {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_tuple("Formula").field(&self.text).finish()
    }
}

impl serde::Serialize for Formula {
    fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.serialize_str(&self.text)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn formula(text: &str) -> Formula {
        Formula::parse(text).unwrap_or_else(|e| panic!("`{text}`: {e} at {:?}", e.span))
    }

    fn value(text: &str) -> f32 {
        formula(text).eval(&[])
    }

    /// Equal bits, or both NaN: IEEE 754 leaves a NaN's sign and payload open.
    fn same(a: f32, b: f32) -> bool {
        a.to_bits() == b.to_bits() || (a.is_nan() && b.is_nan())
    }

    #[test]
    fn precedence_is_that_of_the_table() {
        let by_hand: &[(&str, f32)] = &[
            ("1 + 2 * 3", 7.0),
            ("(1 + 2) * 3", 9.0),
            ("10 - 3 - 2", 5.0),
            ("24 / 4 / 2", 3.0),
            ("24 / 4 * 2", 12.0),
            ("-2^2", -4.0),
            ("(-2)^2", 4.0),
            ("2^-1", 0.5),
            ("2^3^2", 512.0),
            ("2^-1^2 * 4", 2.0),
            ("-3 * -2", 6.0),
            ("--3", 3.0),
            ("2 * 3^2", 18.0),
            ("1 + 1 < 3", 1.0),
            ("(3 > 2) == 1", 1.0),
            ("not 1 == 2", 1.0),
            ("(not 1) == 2", 0.0),
            ("not 0 and 0", 0.0),
            ("not (0 and 0)", 1.0),
            ("not not 7", 1.0),
            ("1 or 0 and 0", 1.0),
            ("(1 or 0) and 0", 0.0),
            ("0.5 and -2", 1.0),
            ("1 < 2 and 2 < 3", 1.0),
            ("2 <= 2", 1.0),
            ("2 >= 3", 0.0),
            ("2 != 2", 0.0),
        ];
        for &(text, expected) in by_hand {
            assert_eq!(value(text), expected, "{text}");
        }
    }

    #[test]
    fn numbers_are_read_as_rust_reads_them() {
        for text in ["0", "7", "2.5", ".5", "3.", "1e3", "1E-3", "2.5e+2", "1e-46", "16777217"] {
            assert_eq!(value(text), text.parse::<f32>().unwrap(), "{text}");
        }
        assert_eq!(value("pi"), std::f32::consts::PI);
    }

    #[test]
    fn division_by_zero_and_its_kin_follow_ieee() {
        assert_eq!(value("1 / 0"), f32::INFINITY);
        assert_eq!(value("-1 / 0"), f32::NEG_INFINITY);
        assert!(value("0 / 0").is_nan());
        assert!(value("ln(-1)").is_nan());
        assert_eq!(value("ln(0)"), f32::NEG_INFINITY);
        assert!(value("sqrt(-1)").is_nan());
        assert_eq!(value("0 ^ 0"), 1.0);
    }

    #[test]
    fn functions_of_one_number_agree_with_std() {
        type Reference = fn(f64) -> f64;
        let functions: &[(&str, Reference)] = &[
            ("sqrt", f64::sqrt),
            ("exp", f64::exp),
            ("ln", f64::ln),
            ("log10", f64::log10),
            ("sin", f64::sin),
            ("cos", f64::cos),
            ("tan", f64::tan),
            ("abs", f64::abs),
            ("floor", f64::floor),
            ("ceil", f64::ceil),
            ("round", f64::round),
        ];
        for (name, reference) in functions {
            let f = formula(&format!("{name}(v)"));
            for i in -2000..=2000 {
                let v = i as f32 * 0.0137 + if i % 7 == 0 { 0.0 } else { 0.25 };
                let exact = reference(f64::from(v));
                let got = f.eval(&[v]);
                // One unit in the last place is what libm claims for these.
                let tolerance =
                    exact.abs() * f64::from(f32::EPSILON) + f64::from(f32::MIN_POSITIVE);
                let agrees = (f64::from(got) - exact).abs() <= tolerance
                    || (got.is_nan() && exact.is_nan())
                    || f64::from(got) == exact;
                assert!(agrees, "{name}({v}) = {got}, std says {exact}");
            }
        }
    }

    #[test]
    fn functions_of_several_numbers_agree_with_std() {
        let names = ["a", "b", "c"];
        let grid: Vec<f32> = vec![-3.5, -1.0, -0.25, 0.0, 0.3, 1.0, 2.0, 7.75];
        let call = |text: &str, [a, b, c]: [f32; 3]| {
            let f = formula(text);
            let inputs: Vec<f32> = f
                .variables()
                .iter()
                .map(|v| match v {
                    Variable::Layer(name) => {
                        [a, b, c][names.iter().position(|n| n == name).unwrap()]
                    }
                    other => panic!("{other:?}"),
                })
                .collect();
            f.eval(&inputs)
        };
        let close = |got: f32, exact: f64| {
            (f64::from(got) - exact).abs() <= 1e-6 * exact.abs().max(1e-3)
                || (got.is_nan() && exact.is_nan())
                || f64::from(got) == exact
        };
        for &a in &grid {
            for &b in &grid {
                let (a64, b64) = (f64::from(a), f64::from(b));
                let v = [a, b, 0.0];
                assert_eq!(call("min(a, b)", v), a.min(b));
                assert_eq!(call("max(a, b)", v), a.max(b));
                assert!(close(call("atan2(a, b)", v), a64.atan2(b64)), "atan2({a}, {b})");
                assert!(close(call("a ^ b", v), a64.powf(b64)), "{a}^{b}");
                for &c in &grid {
                    let v = [a, b, c];
                    let t = f64::from(c);
                    assert_eq!(call("if(a, b, c)", v), if a != 0.0 { b } else { c });
                    assert_eq!(call("min(a, b, c)", v), a.min(b).min(c));
                    let lerp = a64 * (1.0 - t) + b64 * t;
                    assert!((f64::from(call("lerp(a, b, c)", v)) - lerp).abs() < 1e-5);
                    if b <= c {
                        assert_eq!(call("clamp(a, b, c)", v), a.clamp(b, c));
                    }
                }
            }
        }
    }

    #[test]
    fn sign_of_zero_is_zero_and_of_nan_is_nan() {
        let f = formula("sign(v)");
        assert_eq!([-2.0, -0.0, 0.0, 1e-30].map(|v| f.eval(&[v])), [-1.0, 0.0, 0.0, 1.0]);
        assert!(f.eval(&[f32::NAN]).is_nan());
    }

    #[test]
    fn halves_round_away_from_zero() {
        let f = formula("round(v)");
        assert_eq!([-2.5, -0.5, 0.5, 1.5].map(|v| f.eval(&[v])), [-3.0, -1.0, 1.0, 2.0]);
    }

    #[test]
    fn min_and_max_ignore_nan_where_clamp_passes_it_on() {
        for text in ["min(v, 2)", "min(2, v)", "max(v, 2)", "max(2, v)"] {
            assert_eq!(formula(text).eval(&[f32::NAN]), 2.0, "{text}");
        }
        assert!(formula("clamp(v, 0, 1)").eval(&[f32::NAN]).is_nan());
        assert_eq!(value("clamp(5, 3, 1)"), 1.0, "crossed bounds: the upper one wins");
    }

    #[test]
    fn a_curve_passes_through_its_points_and_is_flat_outside() {
        let f = formula("curve(v, 0, 1, 10, 3, 20, 0)");
        let at = [-5.0, 0.0, 5.0, 10.0, 15.0, 20.0, 99.0].map(|v| f.eval(&[v]));
        assert_eq!(at, [1.0, 1.0, 2.0, 3.0, 1.5, 0.0, 0.0]);
        // Two points at one place make a step; points may be formulas.
        assert_eq!(formula("curve(v, 0, 1, 0, 5)").eval(&[-0.1]), 1.0);
        assert_eq!(formula("curve(v, 0, 1, 0, 5)").eval(&[0.0]), 5.0);
        assert_eq!(formula("curve(v, 0, 2 * a, 1, b)").eval(&[0.25, 1.0, 6.0]), 3.0);
    }

    #[test]
    fn defined_functions_stand_for_their_bodies() {
        let define = |name: &str, parameters: &[&str], body: &str| Definition {
            name: name.into(),
            parameters: parameters.iter().map(ToString::to_string).collect(),
            body: body.into(),
        };
        let known = [
            define("twice", &["x"], "x + x"),
            define("grow", &["t", "late"], "twice(clamp(t - late, 0, 1)) * vigor"),
        ];
        let f = Formula::parse_with("1 + grow(2 * t, 1) + grow(x, 0)", &known).unwrap();
        // t is the caller's own; vigor is found at the call that brings it in.
        let names: Vec<_> = f.variables().iter().map(|v| format!("{v:?}")).collect();
        assert_eq!(names, ["Layer(\"t\")", "Layer(\"vigor\")", "X"]);
        assert_eq!(&f.text()[f.spans()[1].clone()], "grow(2 * t, 1)");
        assert_eq!(f.eval(&[0.75, 0.5, 0.25]), 1.0 + 0.5 + 0.25);
    }

    #[test]
    fn smoothstep_is_the_hermite_cubic_between_its_bounds() {
        // t²(3 - 2t) at t = 0, 1/4, 1/2, 3/4, 1 on paper; flat outside.
        let f = formula("smoothstep(2, 10, v)");
        let at = [-5.0, 2.0, 4.0, 6.0, 8.0, 10.0, 99.0];
        assert_eq!(at.map(|v| f.eval(&[v])), [0.0, 0.0, 0.15625, 0.5, 0.84375, 1.0, 1.0]);
        // Bounds the other way round fall instead of rising.
        assert_eq!(formula("smoothstep(10, 2, v)").eval(&[4.0]), 0.84375);
        // Equal bounds make a step, with no NaN at the bound itself.
        let step = formula("smoothstep(3, 3, v)");
        assert_eq!([2.9, 3.0, 3.1].map(|v| step.eval(&[v])), [0.0, 1.0, 1.0]);
    }

    #[test]
    fn lerp_meets_both_ends_exactly() {
        let f = formula("lerp(a, b, t)");
        for (a, b) in [(0.1, 0.3), (-7.7, 1e9), (1e-9, 3.3)] {
            assert_eq!(f.eval(&[a, b, 0.0]), a);
            assert_eq!(f.eval(&[a, b, 1.0]), b);
        }
    }

    #[test]
    fn variables_come_once_in_order_of_first_use_with_their_spans() {
        let text = r#"slope + x * crown_shadow("oak") - slope + noise(9) + crown_shadow('oak')"#;
        let f = formula(text);
        let layer = |s: &str| Variable::Layer(s.to_owned());
        let oak = Variable::CrownShadow("oak".to_owned());
        assert_eq!(f.variables(), [layer("slope"), Variable::X, oak, Variable::Y]);
        let named: Vec<&str> = f.spans().iter().map(|s| &text[s.clone()]).collect();
        assert_eq!(named, ["slope", "x", r#"crown_shadow("oak")"#, "noise"]);
    }

    #[test]
    fn variables_in_a_branch_never_taken_are_still_listed() {
        let f = formula("if(1, 2, slpoe)");
        assert_eq!(f.variables(), [Variable::Layer("slpoe".to_owned())]);
        assert_eq!(f.eval(&[9.0]), 2.0);
    }

    #[test]
    fn constants_print_as_a_text_that_reads_back() {
        let values = [0.0, -0.0, 1.5, -3e-39, 3.4e38, f32::INFINITY, f32::NEG_INFINITY, f32::NAN];
        for v in values {
            let f = Formula::constant(v);
            assert!(same(f.eval(&[]), v));
            assert!(same(value(f.text()), v), "{}", f.text());
            let mut out = [7.0; 3];
            f.eval_block(&[], &mut out);
            assert!(out.iter().all(|&o| same(o, v)));
        }
    }

    #[test]
    fn noise_is_perlin_noise_of_position_over_wavelength() {
        use noise::NoiseFn;
        let f = formula("noise(25, 3)");
        assert_eq!(f.variables(), [Variable::X, Variable::Y]);
        let perlin = noise::Perlin::new(3);
        let mut largest = 0.0_f32;
        for i in 0..4000 {
            let (x, y) = (i as f32 * 0.731, 400.0 - i as f32 * 0.377);
            let got = f.eval(&[x, y]);
            let expected = perlin.get([f64::from(x / 25.0), f64::from(y / 25.0)]) as f32;
            assert_eq!(got, expected);
            largest = largest.max(got.abs());
        }
        assert!((0.5..=1.0).contains(&largest), "{largest}");
        // Gradient noise vanishes on its lattice [Perlin02].
        assert_eq!(f.eval(&[50.0, -75.0]), 0.0);
        assert_eq!(
            formula("noise(25)").eval(&[30.0, 4.0]),
            formula("noise(25, 0)").eval(&[30.0, 4.0])
        );
        assert_ne!(formula("noise(25)").eval(&[30.0, 4.0]), f.eval(&[30.0, 4.0]));
    }

    #[test]
    fn noise_keeps_its_values_when_the_crate_behind_it_changes() {
        let f = formula("noise(10, 7)");
        let golden = [(31.0, 4.5), (123.4, 56.7), (-8.5, 999.25)].map(|(x, y)| f.eval(&[x, y]));
        assert_eq!(golden, [-0.53981656, 0.07083956, 0.079112105]);
    }

    #[test]
    fn noise_of_absurd_positions_stays_within_its_range() {
        let f = formula("noise(w)"); // variables: w, x, y
        for v in [f32::MAX, f32::MIN, 1e30, 3e9, f32::MIN_POSITIVE] {
            for w in [1.0, 1e-38, 1e38, -2.0] {
                let got = f.eval(&[w, v, v]);
                assert!(got.is_nan() || got.abs() <= 1.0, "{got}");
            }
        }
        assert!(f.eval(&[0.0, 1.0, 1.0]).is_nan());
        assert!(f.eval(&[1.0, f32::NAN, 1.0]).is_nan());
    }

    #[test]
    fn equality_debug_and_serialization_speak_of_the_text() {
        assert_eq!(formula("1 + slope"), formula("1 + slope"));
        assert_ne!(formula("1 + slope"), formula("1+slope"));
        assert_eq!(format!("{:?}", formula("1 + slope")), r#"Formula("1 + slope")"#);
        #[derive(serde::Serialize)]
        struct Table {
            vigor: Formula,
        }
        let toml = toml::to_string(&Table { vigor: formula("1 + slope") }).unwrap();
        assert_eq!(toml, "vigor = \"1 + slope\"\n");
    }

    #[test]
    fn blocks_of_every_awkward_length_are_filled() {
        let f = formula("clamp(soil * 2 - 0.3, 0, 1) + soil");
        for length in [0, 1, 3, 1023, 1024, 1025, 2048, 5000] {
            let soil: Vec<f32> = (0..length).map(|i| i as f32 / 999.0).collect();
            let mut out = vec![f32::NAN; length];
            f.eval_block(&[&soil], &mut out);
            for (&s, &o) in soil.iter().zip(&out) {
                assert_eq!(o, (s * 2.0 - 0.3).clamp(0.0, 1.0) + s);
            }
        }
    }

    #[test]
    #[should_panic(expected = "differ in count")]
    fn blocks_of_unequal_length_are_refused() {
        formula("a + b").eval_block(&[&[1.0], &[1.0, 2.0]], &mut [0.0]);
    }

    /// An expression with its own printer and evaluator, to hold the parser and the program against.
    #[derive(Clone, Debug)]
    enum Expression {
        Number(f32),
        Layer(usize),
        Unary(&'static str, Box<Expression>),
        Binary(&'static str, Box<Expression>, Box<Expression>),
        Call(&'static str, Vec<Expression>),
    }

    /// Binding strength as the module's table orders it.
    fn strength(operator: &str) -> u8 {
        match operator {
            "or" => 1,
            "and" => 2,
            "not" => 3,
            "+" | "-" => 5,
            "*" | "/" => 6,
            "negate" => 7,
            "^" => 8,
            _ => 4, // comparisons
        }
    }

    const LAYERS: [&str; 3] = ["soil_moisture", "slope", "h2"];

    impl Expression {
        /// Prints with no more parentheses than precedence asks for.
        fn print(&self, weakest: u8) -> String {
            let (text, own) = match self {
                Expression::Number(n) => (n.to_string(), 9),
                Expression::Layer(i) => (LAYERS[*i].to_owned(), 9),
                Expression::Unary("negate", a) => (format!("-{}", a.print(7)), 7),
                Expression::Unary(op, a) => {
                    (format!("{op} {}", a.print(strength(op))), strength(op))
                }
                Expression::Binary(op, a, b) => {
                    let own = strength(op);
                    let (left, right) = match own {
                        8 => (9, 7), // groups to the right; `2^-1` needs no parentheses
                        4 => (5, 5), // does not chain
                        _ => (own, own + 1),
                    };
                    (format!("{} {op} {}", a.print(left), b.print(right)), own)
                }
                Expression::Call(name, arguments) => {
                    let list: Vec<String> = arguments.iter().map(|a| a.print(0)).collect();
                    (format!("{name}({})", list.join(", ")), 9)
                }
            };
            if own < weakest { format!("({text})") } else { text }
        }

        fn eval(&self, layers: &[f32; 3]) -> f32 {
            let truth = |b: bool| f32::from(u8::from(b));
            match self {
                Expression::Number(n) => *n,
                Expression::Layer(i) => layers[*i],
                Expression::Unary(op, a) => match (*op, a.eval(layers)) {
                    ("negate", a) => -a,
                    (_, a) => truth(a == 0.0),
                },
                Expression::Binary(op, a, b) => {
                    let (a, b) = (a.eval(layers), b.eval(layers));
                    match *op {
                        "or" => truth(a != 0.0 || b != 0.0),
                        "and" => truth(a != 0.0 && b != 0.0),
                        "+" => a + b,
                        "-" => a - b,
                        "*" => a * b,
                        "/" => a / b,
                        "^" => libm::powf(a, b),
                        "<" => truth(a < b),
                        "<=" => truth(a <= b),
                        ">" => truth(a > b),
                        ">=" => truth(a >= b),
                        "==" => truth(a == b),
                        _ => truth(a != b),
                    }
                }
                Expression::Call(name, arguments) => {
                    let v: Vec<f32> = arguments.iter().map(|a| a.eval(layers)).collect();
                    match *name {
                        "if" => {
                            if v[0] != 0.0 {
                                v[1]
                            } else {
                                v[2]
                            }
                        }
                        "lerp" => v[0] * (1.0 - v[2]) + v[1] * v[2],
                        "exp" => libm::expf(v[0]),
                        "sin" => libm::sinf(v[0]),
                        "abs" => v[0].abs(),
                        "floor" => v[0].floor(),
                        "sqrt" => v[0].sqrt(),
                        _ => libm::atan2f(v[0], v[1]),
                    }
                }
            }
        }
    }

    fn expression() -> impl Strategy<Value = Expression> {
        let number = prop_oneof![(0_u8..5).prop_map(f32::from), 0.0_f32..100.0];
        let leaf = prop_oneof![
            number.prop_map(Expression::Number),
            (0_usize..3).prop_map(Expression::Layer)
        ];
        leaf.prop_recursive(6, 48, 3, |inner| {
            let unary = prop::sample::select(vec!["negate", "not"]);
            let binary = prop::sample::select(vec![
                "or", "and", "+", "-", "*", "/", "^", "<", "<=", ">", ">=", "==", "!=",
            ]);
            let call = prop::sample::select(vec![
                ("if", 3),
                ("lerp", 3),
                ("exp", 1),
                ("sin", 1),
                ("abs", 1),
                ("floor", 1),
                ("sqrt", 1),
                ("atan2", 2),
            ]);
            let (a, b, c) = (inner.clone(), inner.clone(), inner.clone());
            prop_oneof![
                (unary, inner).prop_map(|(op, a)| Expression::Unary(op, Box::new(a))),
                (binary, a, b).prop_map(|(op, a, b)| Expression::Binary(
                    op,
                    Box::new(a),
                    Box::new(b)
                )),
                (call, prop::collection::vec(c, 3)).prop_map(|((name, count), mut arguments)| {
                    arguments.truncate(count);
                    Expression::Call(name, arguments)
                }),
            ]
        })
    }

    proptest! {
        #[test]
        fn random_formulas_equal_a_tree_walk_by_scalar_and_by_block(
            tree in expression(),
            rows in prop::collection::vec(prop::array::uniform3(-20.0_f32..20.0), 1..40),
            repeats in 1_usize..60,
        ) {
            let f = formula(&tree.print(0));
            // Lengths around and beyond a block, from few random rows.
            let rows: Vec<[f32; 3]> = rows.iter().copied().cycle().take(rows.len() * repeats).collect();
            let columns: Vec<Vec<f32>> = f.variables().iter().map(|v| match v {
                Variable::Layer(name) => {
                    let i = LAYERS.iter().position(|l| l == name).unwrap();
                    rows.iter().map(|r| r[i]).collect()
                }
                other => panic!("{other:?}"),
            }).collect();
            let slices: Vec<&[f32]> = columns.iter().map(Vec::as_slice).collect();
            let mut out = vec![0.0; rows.len()];
            f.eval_block(&slices, &mut out);
            for (i, row) in rows.iter().enumerate() {
                let inputs: Vec<f32> = columns.iter().map(|c| c[i]).collect();
                let scalar = f.eval(&inputs);
                prop_assert!(same(out[i], scalar), "block {} scalar {scalar}: {f:?}", out[i]);
                prop_assert!(same(scalar, tree.eval(row)), "{} for {f:?} at {row:?}", tree.eval(row));
            }
        }

        #[test]
        fn random_text_is_refused_or_read_but_never_panics(text in any::<String>()) {
            if let Err(e) = Formula::parse(&text) {
                prop_assert!(text.get(e.span.clone()).is_some(), "{:?}", e.span);
            }
        }

        #[test]
        fn random_words_of_the_language_never_panic(
            words in prop::collection::vec(prop::sample::select(vec![
                "(", ")", ",", "+", "-", "*", "/", "^", "<", "<=", "==", "=", "!", "and", "or", "not",
                "if", "min", "clamp", "smoothstep", "curve", "noise", "crown_shadow", "\"oak\"", "\"", "x",
                "slope", "1", "2.5", "1e9", "0", "pi", "é", "&&", ".", "1e", " ",
            ]), 0..40)
        ) {
            let text = words.concat();
            match Formula::parse(&text) {
                Ok(f) => {
                    f.eval(&vec![0.5; f.variables().len()]);
                }
                Err(e) => {
                    prop_assert!(text.get(e.span.clone()).is_some(), "{:?}", e.span);
                    prop_assert!(!e.message.is_empty());
                }
            }
        }
    }

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn speed_of_typical_formulas() {
        // A layer of 2048 by 2048: 16 MiB, as a terrain of 500 m at 0.25 m has.
        let count = 1 << 22;
        let column: Vec<f32> = (0..count).map(|i| i as f32 * 2.7e-6).collect();
        let mut out = vec![0.0; count];
        for text in [
            "clamp(soil_moisture*2-0.3,0,1)",
            "smoothstep(2,10,slope)*(1-water_depth)",
            "if(water_depth > 0.1, 0, min(slope, 4))",
            "exp(-slope/8)*soil_moisture",
            "slope^1.5",
            "floor(slope)",
            "noise(25)",
        ] {
            let f = formula(text);
            let inputs: Vec<&[f32]> = f.variables().iter().map(|_| column.as_slice()).collect();
            let mut times: Vec<f64> = (0..7)
                .map(|_| {
                    let start = std::time::Instant::now();
                    f.eval_block(std::hint::black_box(&inputs), std::hint::black_box(&mut out));
                    start.elapsed().as_secs_f64()
                })
                .collect();
            times.sort_by(f64::total_cmp);
            let rate = |seconds: f64| count as f64 / seconds / 1e6;
            println!("{:6.0} M values/s (slowest {:.0})  {text}", rate(times[3]), rate(times[6]));
        }
    }
}
