//! Reading a formula's text: tokens, then operators by their binding power [Pratt73].
//!
//! No tree is built: each construct becomes nodes of the program's [`Builder`] as soon as it is
//! complete, since operands are read before the operation that needs them.

use std::ops::Range;

use super::program::{Binary, Builder, Id, Program, Unary};
use super::{Definition, FormulaError, Variable};
use crate::source::nearest;

/// Longest text that is read, bytes. Hand-written formulas stay under a few hundred.
const LONGEST_TEXT: usize = 64 * 1024;

/// Parentheses, calls and right-hand operands within one another; bounds the parser's recursion
/// to well under a thread's stack.
const DEEPEST_NESTING: usize = 200;

/// Calls of defined functions in one formula, those inside their bodies included: a chain of
/// functions that each call the one before twice would double with every link.
const MOST_EXPANSIONS: usize = 4096;

/// Seeds of `noise` are literals in single precision, which holds every integer up to 2^24.
const LARGEST_SEED: f32 = 16_777_215.0;

// Binding powers, weakest first; the table in the parent module's documentation.
const OR: u8 = 1;
const AND: u8 = 2;
const NOT: u8 = 3;
const COMPARISON: u8 = 4;
const SUM: u8 = 5;
const PRODUCT: u8 = 6;
const NEGATION: u8 = 7;
const POWER: u8 = 8;

/// A text read to its end.
pub(super) struct Parsed {
    /// Each variable once, with the bytes of its first use.
    pub(super) variables: Vec<(Variable, Range<usize>)>,
    pub(super) program: Program,
}

/// Reads a whole formula that may call the functions of `definitions`.
pub(super) fn parse(text: &str, definitions: &[Definition]) -> Result<Parsed, FormulaError> {
    if text.len() > LONGEST_TEXT {
        let limit = text.floor_char_boundary(LONGEST_TEXT);
        let message =
            format!("a formula has at most {LONGEST_TEXT} bytes, this one {}", text.len());
        return Err(FormulaError { message, span: limit..text.len() });
    }
    let mut parser = Parser::new(text, definitions)?;
    if parser.token == Token::End {
        let message =
            "the formula is empty: write a number, a layer's name or an expression of them";
        return Err(parser.error_here(message));
    }
    let root = parser.expression(OR)?;
    if parser.token != Token::End {
        return Err(parser.error_after_value());
    }
    Ok(Parsed { variables: parser.variables, program: parser.builder.finish(root) })
}

#[derive(Clone, Copy, Debug, PartialEq)]
enum Token<'a> {
    Number(f32),
    Name(&'a str),
    /// A text without its quotes.
    Quoted(&'a str),
    /// An operator, a parenthesis or a comma, as written.
    Symbol(&'a str),
    End,
}

/// Symbols of the language; of two that begin alike the longer comes first.
const SYMBOLS: [&str; 14] =
    ["<=", ">=", "==", "!=", "<", ">", "+", "-", "*", "/", "^", "(", ")", ","];

/// How other languages write what this one writes otherwise, longer ones first.
const FOREIGN_SYMBOLS: [(&str, &str); 8] = [
    ("&&", "write `and`"),
    ("||", "write `or`"),
    ("&", "write `and`"),
    ("|", "write `or`"),
    ("=", "to compare, write `==`"),
    ("!", "write `not`, or `!=` to compare"),
    ("?", "write `if(condition, then, else)`"),
    ("%", "write a percentage as a number such as 0.25"),
];

/// Returns the token at or after byte `from`, and its span.
fn next_token(text: &str, from: usize) -> Result<(Token<'_>, Range<usize>), FormulaError> {
    let start = text.len() - text[from..].trim_start().len();
    let rest = &text[start..];
    let Some(first) = rest.chars().next() else {
        return Ok((Token::End, text.len()..text.len()));
    };
    let taken = |token, length: usize| Ok((token, start..start + length));
    let number = number_length(rest);
    if number > 0 {
        return taken(number_token(&rest[..number], start)?, number);
    }
    if first.is_alphabetic() || first == '_' {
        let end = rest.find(|c: char| !c.is_alphanumeric() && c != '_').unwrap_or(rest.len());
        return taken(Token::Name(&rest[..end]), end);
    }
    if first == '"' || first == '\'' {
        let Some(length) = rest[1..].find(first) else {
            let message = format!("this {first} is never closed");
            return Err(FormulaError { message, span: start..start + 1 });
        };
        return taken(Token::Quoted(&rest[1..1 + length]), length + 2);
    }
    if let Some(symbol) = SYMBOLS.iter().find(|s| rest.starts_with(**s)) {
        return taken(Token::Symbol(&rest[..symbol.len()]), symbol.len());
    }
    Err(unknown_symbol(rest, first, start))
}

fn unknown_symbol(rest: &str, first: char, start: usize) -> FormulaError {
    if let Some((symbol, advice)) = FOREIGN_SYMBOLS.iter().find(|(s, _)| rest.starts_with(s)) {
        let message = format!("`{symbol}` has no meaning in a formula; {advice}");
        return FormulaError { message, span: start..start + symbol.len() };
    }
    let message = format!(
        "`{}` has no meaning in a formula; allowed are numbers, names, parentheses, commas, \
         + - * / ^, < <= > >= == != and the words and, or, not",
        first.escape_debug()
    );
    FormulaError { message, span: start..start + first.len_utf8() }
}

/// Bytes of the number that `text` begins with: `2`, `.5`, `1.`, `2.5e-3`; 0 if there is none.
fn number_length(text: &str) -> usize {
    let bytes = text.as_bytes();
    let digits = |from: usize| bytes.iter().skip(from).take_while(|b| b.is_ascii_digit()).count();
    let whole = digits(0);
    let mut end = whole;
    if bytes.get(end) == Some(&b'.') {
        let fraction = digits(end + 1);
        if whole + fraction == 0 {
            return 0;
        }
        end += 1 + fraction;
    }
    if end == 0 {
        return 0;
    }
    // An exponent counts only when complete: `2e` is a number and a stray name.
    if matches!(bytes.get(end), Some(b'e' | b'E')) {
        let sign = usize::from(matches!(bytes.get(end + 1), Some(b'+' | b'-')));
        let exponent = digits(end + 1 + sign);
        if exponent > 0 {
            end += 1 + sign + exponent;
        }
    }
    end
}

fn number_token(written: &str, start: usize) -> Result<Token<'_>, FormulaError> {
    match written.parse::<f32>() {
        Ok(value) if value.is_finite() => Ok(Token::Number(value)),
        _ => Err(FormulaError {
            message: format!("`{written}` is beyond the largest number, {:e}", f32::MAX),
            span: start..start + written.len(),
        }),
    }
}

/// What a function's call becomes.
#[derive(Clone, Copy)]
enum Meaning {
    Unary(Unary),
    Of(fn(&mut Builder, &[Id]) -> Id),
    /// Needs the spans of its arguments and the variables `x` and `y`.
    Noise,
    /// Takes a text, not a value.
    CrownShadow,
}

/// A function of the language.
struct Function {
    name: &'static str,
    /// How a call looks, for error messages.
    usage: &'static str,
    fewest: usize,
    most: usize,
    meaning: Meaning,
}

const fn function(
    name: &'static str,
    usage: &'static str,
    (fewest, most): (usize, usize),
    meaning: Meaning,
) -> Function {
    Function { name, usage, fewest, most, meaning }
}

/// All functions, by name in alphabetical order, as error messages list them.
const FUNCTIONS: [Function; 22] = [
    function("abs", "abs(v)", (1, 1), Meaning::Unary(Unary::Abs)),
    function("atan2", "atan2(y, x)", (2, 2), Meaning::Of(atan2)),
    function("ceil", "ceil(v)", (1, 1), Meaning::Unary(Unary::Ceil)),
    function("clamp", "clamp(v, low, high)", (3, 3), Meaning::Of(clamp)),
    function("cos", "cos(radians)", (1, 1), Meaning::Unary(Unary::Cos)),
    function("crown_shadow", "crown_shadow(\"species\")", (1, 1), Meaning::CrownShadow),
    function("curve", "curve(v, x0, y0, x1, y1, …)", (5, usize::MAX), Meaning::Of(curve)),
    function("exp", "exp(v)", (1, 1), Meaning::Unary(Unary::Exp)),
    function("floor", "floor(v)", (1, 1), Meaning::Unary(Unary::Floor)),
    function("if", "if(condition, then, else)", (3, 3), Meaning::Of(choose)),
    function("lerp", "lerp(a, b, t)", (3, 3), Meaning::Of(lerp)),
    function("ln", "ln(v)", (1, 1), Meaning::Unary(Unary::Ln)),
    function("log10", "log10(v)", (1, 1), Meaning::Unary(Unary::Log10)),
    function("max", "max(a, b, …)", (2, usize::MAX), Meaning::Of(max)),
    function("min", "min(a, b, …)", (2, usize::MAX), Meaning::Of(min)),
    function("noise", "noise(wavelength) or noise(wavelength, seed)", (1, 2), Meaning::Noise),
    function("round", "round(v)", (1, 1), Meaning::Unary(Unary::Round)),
    function("sign", "sign(v)", (1, 1), Meaning::Unary(Unary::Sign)),
    function("sin", "sin(radians)", (1, 1), Meaning::Unary(Unary::Sin)),
    function("smoothstep", "smoothstep(low, high, v)", (3, 3), Meaning::Of(smoothstep)),
    function("sqrt", "sqrt(v)", (1, 1), Meaning::Unary(Unary::Sqrt)),
    function("tan", "tan(radians)", (1, 1), Meaning::Unary(Unary::Tan)),
];

/// Whether the language has a function of this name.
pub fn is_function(name: &str) -> bool {
    FUNCTIONS.iter().any(|function| function.name == name)
}

/// Functions of other languages, and what to write here.
const FOREIGN_FUNCTIONS: [(&str, &str); 5] = [
    ("log", "write `ln` (natural) or `log10`"),
    ("pow", "write `a ^ b`"),
    ("mix", "write `lerp(a, b, t)`"),
    ("saturate", "write `clamp(v, 0, 1)`"),
    ("select", "write `if(condition, then, else)`"),
];

fn atan2(b: &mut Builder, v: &[Id]) -> Id {
    b.binary(Binary::Atan2, v[0], v[1])
}

fn choose(b: &mut Builder, v: &[Id]) -> Id {
    b.select(v[0], v[1], v[2])
}

fn min(b: &mut Builder, v: &[Id]) -> Id {
    v[1..].iter().fold(v[0], |smallest, &next| b.binary(Binary::Min, smallest, next))
}

fn max(b: &mut Builder, v: &[Id]) -> Id {
    v[1..].iter().fold(v[0], |largest, &next| b.binary(Binary::Max, largest, next))
}

fn clamp(b: &mut Builder, v: &[Id]) -> Id {
    let raised = b.binary(Binary::AtLeast, v[0], v[1]);
    b.binary(Binary::AtMost, raised, v[2])
}

/// a (1 - t) + b t, which meets both ends exactly, as a + (b - a) t does not.
fn lerp(b: &mut Builder, v: &[Id]) -> Id {
    let one = b.constant(1.0);
    let rest = b.binary(Binary::Subtract, one, v[2]);
    let from = b.binary(Binary::Multiply, v[0], rest);
    let to = b.binary(Binary::Multiply, v[1], v[2]);
    b.binary(Binary::Add, from, to)
}

fn smoothstep(b: &mut Builder, v: &[Id]) -> Id {
    let (low, high, x) = (v[0], v[1], v[2]);
    let above = b.binary(Binary::Subtract, x, low);
    let width = b.binary(Binary::Subtract, high, low);
    let t = b.binary(Binary::Ramp, above, width);
    b.unary(Unary::Hermite, t)
}

/// y0 + Σ (y[i+1] - y[i]) ramp(v - x[i], x[i+1] - x[i]): linear between the points, flat outside.
fn curve(b: &mut Builder, v: &[Id]) -> Id {
    v[1..].windows(4).step_by(2).fold(v[2], |height, points| {
        let above = b.binary(Binary::Subtract, v[0], points[0]);
        let width = b.binary(Binary::Subtract, points[2], points[0]);
        let t = b.binary(Binary::Ramp, above, width);
        let rise = b.binary(Binary::Subtract, points[3], points[1]);
        let rise = b.binary(Binary::Multiply, rise, t);
        b.binary(Binary::Add, height, rise)
    })
}

/// What an operator between two values does.
#[derive(Clone, Copy)]
struct Infix {
    power: u8,
    /// Weakest operator that the right-hand operand may hold without parentheses.
    right: u8,
    op: Binary,
    /// Whether the operands change places, since the program knows less-than only.
    swapped: bool,
}

fn infix(token: Token<'_>) -> Option<Infix> {
    let (Token::Symbol(word) | Token::Name(word)) = token else {
        return None;
    };
    let (power, op) = match word {
        "or" => (OR, Binary::Or),
        "and" => (AND, Binary::And),
        "<" | ">" => (COMPARISON, Binary::Less),
        "<=" | ">=" => (COMPARISON, Binary::LessOrEqual),
        "==" => (COMPARISON, Binary::Equal),
        "!=" => (COMPARISON, Binary::NotEqual),
        "+" => (SUM, Binary::Add),
        "-" => (SUM, Binary::Subtract),
        "*" => (PRODUCT, Binary::Multiply),
        "/" => (PRODUCT, Binary::Divide),
        "^" => (POWER, Binary::Power),
        _ => return None,
    };
    // Powers group to the right, and their exponent may carry a sign: 2^-1.
    let right = if power == POWER { NEGATION } else { power + 1 };
    Some(Infix { power, right, op, swapped: matches!(word, ">" | ">=") })
}

struct Parser<'a> {
    text: &'a str,
    /// The token to read next, and its bytes.
    token: Token<'a>,
    span: Range<usize>,
    /// End of the token before it.
    last_end: usize,
    depth: usize,
    builder: Builder,
    variables: Vec<(Variable, Range<usize>)>,
    /// Functions that the text may call besides those of the language.
    definitions: &'a [Definition],
    /// Parameters of the function whose body is being read, with their values.
    parameters: Vec<(&'a str, Id)>,
    /// The call whose body is being read, bytes of the formula itself.
    expanded: Option<Range<usize>>,
    expansions: usize,
}

impl<'a> Parser<'a> {
    fn new(text: &'a str, definitions: &'a [Definition]) -> Result<Self, FormulaError> {
        let (token, span) = next_token(text, 0)?;
        let builder = Builder::default();
        let (variables, parameters, expanded) = Default::default();
        Ok(Parser {
            text,
            token,
            span,
            last_end: 0,
            depth: 0,
            builder,
            variables,
            definitions,
            parameters,
            expanded,
            expansions: 0,
        })
    }

    /// Steps to the next token and returns the span of the one left behind.
    fn advance(&mut self) -> Result<Range<usize>, FormulaError> {
        let (token, span) = next_token(self.text, self.span.end)?;
        self.token = token;
        let left = std::mem::replace(&mut self.span, span);
        self.last_end = left.end;
        Ok(left)
    }

    fn is_at(&self, symbol: &str) -> bool {
        self.token == Token::Symbol(symbol)
    }

    /// Reads an expression whose operators bind at least as strongly as `weakest`.
    fn expression(&mut self, weakest: u8) -> Result<Id, FormulaError> {
        if self.depth > DEEPEST_NESTING {
            let message = format!("nested deeper than {DEEPEST_NESTING} levels: split the formula");
            return Err(self.error_here(message));
        }
        self.depth += 1;
        let mut left = self.prefix(weakest)?;
        let mut compared = false;
        while let Some(infix) = infix(self.token).filter(|i| i.power >= weakest) {
            if compared && infix.power == COMPARISON {
                let message = "comparisons do not chain: write `a < b and b < c`, or parentheses";
                return Err(self.error_here(message));
            }
            compared = infix.power == COMPARISON;
            self.advance()?;
            let right = self.expression(infix.right)?;
            let (a, b) = if infix.swapped { (right, left) } else { (left, right) };
            left = self.builder.binary(infix.op, a, b);
        }
        self.depth -= 1;
        Ok(left)
    }

    /// Reads a value with the signs and negations before it.
    fn prefix(&mut self, weakest: u8) -> Result<Id, FormulaError> {
        let (op, power) = match self.token {
            Token::Symbol("-") => (Unary::Negate, NEGATION),
            Token::Name("not") if weakest > NOT => {
                let message = "`not` binds weaker than the operator before it: write `(not …)`";
                return Err(self.error_here(message));
            }
            Token::Name("not") => (Unary::Not, NOT),
            _ => return self.value(),
        };
        self.advance()?;
        let operand = self.expression(power)?;
        Ok(self.builder.unary(op, operand))
    }

    /// Reads a number, a name, a call or a parenthesis.
    fn value(&mut self) -> Result<Id, FormulaError> {
        match self.token {
            Token::Number(value) => {
                self.advance()?;
                Ok(self.builder.constant(value))
            }
            Token::Symbol("(") => {
                let open = self.advance()?;
                let inner = self.expression(OR)?;
                self.close(open, "`)`")?;
                Ok(inner)
            }
            Token::Name(name) if !matches!(name, "and" | "or" | "not") => self.named(name),
            _ => Err(self.error_here(format!(
                "expected a number, a name, a function or `(`, found {}",
                self.describe_token()
            ))),
        }
    }

    /// Steps over the `)` that answers the parenthesis at `open`; `expected` names all that may
    /// stand here.
    fn close(&mut self, open: Range<usize>, expected: &str) -> Result<(), FormulaError> {
        if self.is_at(")") {
            self.advance()?;
            return Ok(());
        }
        if self.token == Token::End {
            let message = "this `(` is never closed".to_owned();
            return Err(FormulaError { message, span: open });
        }
        let found = self.describe_token();
        Err(self.error_here(format!("expected an operator or {expected}, found {found}")))
    }

    /// Reads a constant, a variable or a call.
    fn named(&mut self, name: &'a str) -> Result<Id, FormulaError> {
        let span = self.advance()?;
        if self.is_at("(") {
            return match FUNCTIONS.iter().find(|f| f.name == name) {
                Some(function) => self.call(function, span),
                None => match self.definitions.iter().find(|d| d.name == name) {
                    Some(definition) => self.expand(definition, span),
                    None => Err(unknown_function(name, self.definitions, span)),
                },
            };
        }
        if let Some((_, value)) = self.parameters.iter().find(|(known, _)| *known == name) {
            return Ok(*value);
        }
        if let Some(function) = FUNCTIONS.iter().find(|f| f.name == name) {
            let message = format!("`{name}` is a function: write {}", function.usage);
            return Err(FormulaError { message, span });
        }
        Ok(match name {
            "pi" => self.builder.constant(std::f32::consts::PI),
            "x" => self.variable(Variable::X, span),
            "y" => self.variable(Variable::Y, span),
            _ => self.variable(Variable::Layer(name.to_owned()), span),
        })
    }

    /// Reads a call of a defined function: its body with the arguments in place of parameters.
    fn expand(
        &mut self,
        definition: &'a Definition,
        name: Range<usize>,
    ) -> Result<Id, FormulaError> {
        let open = self.advance()?;
        let (values, _) = self.arguments(open)?;
        let span = self.expanded.clone().unwrap_or(name.start..self.last_end);
        let (found, wanted) = (values.len(), definition.parameters.len());
        if found != wanted {
            let Definition { name, parameters, .. } = definition;
            let usage = format!("{name}({})", parameters.join(", "));
            let message = format!("`{name}` takes {wanted}, found {found}: write {usage}");
            return Err(FormulaError { message, span });
        }
        self.expansions += 1;
        if self.expansions > MOST_EXPANSIONS {
            let message = format!("more than {MOST_EXPANSIONS} calls of defined functions");
            return Err(FormulaError { message, span });
        }
        let names = definition.parameters.iter().map(String::as_str);
        let inner = |mut error: FormulaError| {
            error.message = format!("in `{}`: {}", definition.name, error.message);
            error.span = span.clone();
            error
        };
        let (token, first) = next_token(&definition.body, 0).map_err(inner)?;
        let outer =
            (self.text, self.token, self.span.clone(), self.last_end, self.expanded.clone());
        let parameters = std::mem::replace(&mut self.parameters, names.zip(values).collect());
        (self.text, self.token, self.span, self.last_end) = (&definition.body, token, first, 0);
        self.expanded = Some(span.clone());
        let value = self.expression(OR).and_then(|value| match self.token {
            Token::End => Ok(value),
            _ => Err(self.error_after_value()),
        });
        (self.text, self.token, self.span, self.last_end, self.expanded) = outer;
        self.parameters = parameters;
        value.map_err(inner)
    }

    fn variable(&mut self, variable: Variable, span: Range<usize>) -> Id {
        let span = self.expanded.clone().unwrap_or(span);
        let known = self.variables.iter().position(|(v, _)| *v == variable);
        let index = known.unwrap_or_else(|| {
            self.variables.push((variable, span));
            self.variables.len() - 1
        });
        self.builder.input(index)
    }

    /// Reads a call from its `(` on; `name` is the span of the function's name.
    fn call(&mut self, function: &Function, name: Range<usize>) -> Result<Id, FormulaError> {
        let open = self.advance()?;
        if let Meaning::CrownShadow = function.meaning {
            return self.crown_shadow(function, name, open);
        }
        let (values, spans) = self.arguments(open)?;
        if !(function.fewest..=function.most).contains(&values.len()) {
            return Err(wrong_count(function, values.len(), name.start..self.last_end));
        }
        if function.name == "curve" && values.len().is_multiple_of(2) {
            let message = "the last point has no height: write curve(v, x0, y0, x1, y1, …)".into();
            return Err(FormulaError { message, span: name.start..self.last_end });
        }
        Ok(match function.meaning {
            Meaning::Unary(op) => self.builder.unary(op, values[0]),
            Meaning::Of(build) => build(&mut self.builder, &values),
            Meaning::Noise | Meaning::CrownShadow => self.noise(name, &values, &spans)?,
        })
    }

    /// Reads arguments up to and with the `)`: their values and where each is written.
    fn arguments(
        &mut self,
        open: Range<usize>,
    ) -> Result<(Vec<Id>, Vec<Range<usize>>), FormulaError> {
        let (mut values, mut spans) = (vec![], vec![]);
        if self.is_at(")") {
            self.advance()?;
            return Ok((values, spans));
        }
        loop {
            let start = self.span.start;
            values.push(self.expression(OR)?);
            spans.push(start..self.last_end);
            if !self.is_at(",") {
                self.close(open, "`,` or `)`")?;
                return Ok((values, spans));
            }
            self.advance()?;
        }
    }

    /// Reads the rest of `crown_shadow("species")`.
    fn crown_shadow(
        &mut self,
        function: &Function,
        name: Range<usize>,
        open: Range<usize>,
    ) -> Result<Id, FormulaError> {
        let species = match self.token {
            Token::Quoted(species) if !species.trim().is_empty() => species.to_owned(),
            _ => {
                let found = self.describe_token();
                let usage = function.usage;
                let message = format!("expected a species in quotes, as in {usage}, found {found}");
                return Err(self.error_here(message));
            }
        };
        self.advance()?;
        if self.is_at(",") {
            return Err(self.error_here(format!("one species only: {}", function.usage)));
        }
        self.close(open, "`)`")?;
        Ok(self.variable(Variable::CrownShadow(species), name.start..self.last_end))
    }

    /// Builds `noise` of the given wavelength and seed.
    fn noise(
        &mut self,
        name: Range<usize>,
        values: &[Id],
        spans: &[Range<usize>],
    ) -> Result<Id, FormulaError> {
        let wavelength = values[0];
        if let Some(metres) = self.builder.known_value(wavelength)
            && !(metres > 0.0 && metres.is_finite())
        {
            let message = format!("a wavelength is a length above 0 m, this one is {metres}");
            return Err(FormulaError { message, span: spans[0].clone() });
        }
        let seed = match values.get(1) {
            None => 0,
            Some(&id) => self.noise_seed(id, &spans[1])?,
        };
        let x = self.variable(Variable::X, name.clone());
        let y = self.variable(Variable::Y, name);
        let x = self.builder.binary(Binary::Divide, x, wavelength);
        let y = self.builder.binary(Binary::Divide, y, wavelength);
        Ok(self.builder.noise(seed, x, y))
    }

    fn noise_seed(&self, seed: Id, span: &Range<usize>) -> Result<u32, FormulaError> {
        match self.builder.known_value(seed) {
            Some(v) if v.fract() == 0.0 && (0.0..=LARGEST_SEED).contains(&v) => Ok(v as u32),
            _ => Err(FormulaError {
                message: format!("a seed is a whole number from 0 to {LARGEST_SEED}"),
                span: span.clone(),
            }),
        }
    }

    fn error_here(&self, message: impl Into<String>) -> FormulaError {
        FormulaError { message: message.into(), span: self.span.clone() }
    }

    /// What is wrong when a complete value is followed by neither an operator nor the end.
    fn error_after_value(&self) -> FormulaError {
        let found = self.describe_token();
        self.error_here(match self.token {
            Token::Symbol(")") => "this `)` has no `(` before it".to_owned(),
            Token::Symbol(",") => "a `,` stands only between a function's arguments".to_owned(),
            Token::Name(_) | Token::Number(_) | Token::Symbol("(") => {
                format!("expected an operator or the end, found {found}: to multiply, write `*`")
            }
            _ => format!("expected an operator or the end, found {found}"),
        })
    }

    fn describe_token(&self) -> String {
        match self.token {
            Token::End => "the end".to_owned(),
            _ => format!("`{}`", &self.text[self.span.clone()]),
        }
    }
}

fn wrong_count(function: &Function, found: usize, span: Range<usize>) -> FormulaError {
    let expected = match (function.fewest, function.most) {
        (1, 1) => "1 argument".to_owned(),
        (fewest, usize::MAX) => format!("{fewest} or more arguments"),
        (fewest, most) if fewest == most => format!("{fewest} arguments"),
        (fewest, most) => format!("{fewest} to {most} arguments"),
    };
    let Function { name, usage, .. } = function;
    let message = format!("`{name}` takes {expected}, found {found}: write {usage}");
    FormulaError { message, span }
}

fn unknown_function(name: &str, definitions: &[Definition], span: Range<usize>) -> FormulaError {
    let foreign = FOREIGN_FUNCTIONS.iter().find(|(n, _)| *n == name);
    let defined = definitions.iter().map(|d| d.name.as_str());
    let known = || FUNCTIONS.iter().map(|f| f.name).chain(defined.clone());
    let message = if let Some((_, advice)) = foreign {
        format!("no function `{name}`: {advice}")
    } else if let Some(near) = nearest(&name.to_lowercase(), known()) {
        format!("no function `{name}`; did you mean `{near}`?")
    } else {
        let all: Vec<&str> = known().collect();
        format!("no function `{name}`; there are {}", all.join(", "))
    };
    FormulaError { message, span }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The error for `text`: the part it points at, and its message.
    fn fault(text: &str) -> (&str, String) {
        match parse(text, &[]) {
            Ok(_) => panic!("`{text}` was read"),
            Err(e) => (&text[e.span], e.message),
        }
    }

    #[track_caller]
    fn assert_fault(text: &str, at: &str, says: &str) {
        let (found, message) = fault(text);
        assert_eq!(found, at, "{message}");
        assert!(message.contains(says), "{message}");
    }

    #[test]
    fn functions_are_listed_in_alphabetical_order() {
        assert!(FUNCTIONS.windows(2).all(|pair| pair[0].name < pair[1].name));
    }

    #[test]
    fn misspelt_functions_are_answered_with_the_nearest() {
        assert_fault("1 + clmap(x, 0, 1)", "clmap", "did you mean `clamp`?");
        assert_fault("Sqrt(x)", "Sqrt", "did you mean `sqrt`?");
        assert_fault("smoothstpe(0, 1, x)", "smoothstpe", "did you mean `smoothstep`?");
        assert_fault("crownshadow(\"oak\")", "crownshadow", "did you mean `crown_shadow`?");
    }

    #[test]
    fn functions_of_other_languages_are_translated() {
        assert_fault("pow(x, 2)", "pow", "write `a ^ b`");
        assert_fault("log(x)", "log", "`ln` (natural) or `log10`");
    }

    #[test]
    fn functions_like_no_other_are_answered_with_the_list() {
        assert_fault("erosion(x)", "erosion", "there are abs, atan2, ceil, clamp");
    }

    fn defined(name: &str, parameters: &[&str], body: &str) -> Definition {
        let parameters = parameters.iter().map(ToString::to_string).collect();
        Definition { name: name.into(), parameters, body: body.into() }
    }

    #[test]
    fn calls_of_defined_functions_count_their_arguments_and_are_bounded() {
        let one = [defined("half", &["v"], "v / 2"), defined("odd", &["v"], "v +")];
        let fault =
            |text: &str| parse(text, &one).err().map(|e| (text[e.span].to_owned(), e.message));
        let (at, says) = fault("1 + half(2, 3)").unwrap();
        assert_eq!((at.as_str(), says.contains("takes 1, found 2")), ("half(2, 3)", true));
        let (at, says) = fault("2 * hafl(3)").unwrap();
        assert_eq!((at.as_str(), says.contains("`half`")), ("hafl", true), "{says}");
        let (at, says) = fault("1 + odd(2)").unwrap();
        assert_eq!(
            (at.as_str(), says.starts_with("in `odd`: expected")),
            ("odd(2)", true),
            "{says}"
        );
        let mut chain = vec![defined("f0", &["v"], "v + 1")];
        for i in 1..40 {
            let body = format!("f{0}(v) + f{0}(v + 1)", i - 1);
            chain.push(defined(&format!("f{i}"), &["v"], &body));
        }
        let error = parse("f39(x)", &chain).err().unwrap();
        assert!(error.message.contains("more than 4096 calls"), "{}", error.message);
    }

    #[test]
    fn wrong_argument_counts_point_at_the_call() {
        assert_fault("2 * clamp(x, 0) + 1", "clamp(x, 0)", "takes 3 arguments, found 2");
        assert_fault("min(x)", "min(x)", "2 or more arguments, found 1");
        assert_fault("sqrt()", "sqrt()", "1 argument, found 0");
        assert_fault("noise(1, 2, 3)", "noise(1, 2, 3)", "1 to 2 arguments, found 3");
        assert_fault("curve(x, 0, 1)", "curve(x, 0, 1)", "5 or more arguments, found 3");
        assert_fault("curve(x, 0, 1, 2, 3, 4)", "curve(x, 0, 1, 2, 3, 4)", "has no height");
    }

    #[test]
    fn functions_without_arguments_show_how_to_call_them() {
        assert_fault("1 + min", "min", "write min(a, b");
    }

    #[test]
    fn unbalanced_parentheses_point_at_the_one_without_partner() {
        assert_fault("2 * (x + (y)", "(", "never closed");
        assert_eq!(parse("2 * (x + (y)", &[]).err().map(|e| e.span), Some(4..5));
        assert_fault("max(1, 2", "(", "never closed");
        assert_fault("(x))", ")", "has no `(`");
    }

    #[test]
    fn trailing_text_is_pointed_at() {
        assert_fault("2 x", "x", "to multiply, write `*`");
        assert_fault("2m", "m", "to multiply, write `*`");
        assert_fault("slope (2)", "slope", "no function");
        assert_fault("1, 2", ",", "between a function's arguments");
        assert_fault("max(1 2)", "2", "`,` or `)`");
        assert_fault("1 'oak'", "'oak'", "expected an operator");
    }

    #[test]
    fn missing_operands_are_pointed_at() {
        assert_fault("1 +", "", "found the end");
        assert_eq!(parse("1 + ", &[]).err().map(|e| e.span), Some(4..4));
        assert_fault("* 2", "*", "expected a number");
        assert_fault("max(1, )", ")", "expected a number");
        assert_fault("1 + and", "and", "expected a number");
        assert_fault("()", ")", "expected a number");
    }

    #[test]
    fn empty_texts_are_refused() {
        for text in ["", " ", "\n\t"] {
            assert_fault(text, "", "empty");
        }
    }

    #[test]
    fn symbols_of_other_languages_are_translated() {
        assert_fault("a && b", "&&", "write `and`");
        assert_fault("a = b", "=", "write `==`");
        assert_fault("!a", "!", "write `not`");
        assert_fault("a $ b", "$", "allowed are");
        assert_fault("a − b", "−", "allowed are");
    }

    #[test]
    fn comparisons_do_not_chain() {
        assert_fault("1 < x < 3", "<", "do not chain");
        assert_eq!(parse("1 < x < 3", &[]).err().map(|e| e.span), Some(6..7));
        assert!(parse("1 < x and x < 3", &[]).is_ok());
        assert!(parse("(1 < x) == (x < 3)", &[]).is_ok());
    }

    #[test]
    fn not_behind_a_stronger_operator_asks_for_parentheses() {
        assert_fault("2 * not x", "not", "(not …)");
        assert!(parse("2 * (not x)", &[]).is_ok());
        assert!(parse("a and not b", &[]).is_ok());
    }

    #[test]
    fn crown_shadow_asks_for_one_species_in_quotes() {
        assert_fault("crown_shadow(oak)", "oak", "in quotes");
        assert_fault("crown_shadow()", ")", "in quotes");
        assert_fault("crown_shadow(\"\")", "\"\"", "in quotes");
        assert_fault("crown_shadow(\"oak\", 2)", ",", "one species");
        assert_fault("crown_shadow(\"oak)", "\"", "never closed");
        assert_fault("\"oak\" + 1", "\"oak\"", "expected a number");
    }

    #[test]
    fn noise_asks_for_a_positive_wavelength_and_a_whole_seed() {
        assert_fault("noise(0)", "0", "above 0 m");
        assert_fault("noise(2 - 5, 1)", "2 - 5", "above 0 m");
        assert_fault("noise(5, 1.5)", "1.5", "whole number");
        assert_fault("noise(5, -1)", "-1", "whole number");
        assert_fault("noise(5, slope)", "slope", "whole number");
    }

    #[test]
    fn numbers_too_large_are_pointed_at() {
        assert_fault("1 + 1e99", "1e99", "beyond the largest");
    }

    #[test]
    fn nesting_is_bounded_at_two_hundred_levels() {
        let nested = |depth: usize| format!("{}x{}", "(".repeat(depth), ")".repeat(depth));
        assert!(parse(&nested(200), &[]).is_ok());
        let deep = nested(201);
        let (at, message) = fault(&deep);
        assert_eq!(at, "x");
        assert!(message.contains("deeper than 200"), "{message}");
        for opening in ["(", "-", "not ", "2^", "min(1,", "1+(", "(1<2*-3^"] {
            let endless = opening.repeat(LONGEST_TEXT / opening.len());
            assert!(fault(&endless).1.contains("deeper than 200"), "{opening}");
        }
    }

    #[test]
    fn deepest_nesting_fits_a_small_stack() {
        // A quarter of what Rust gives a thread; every level of precedence is passed at each depth.
        let small = std::thread::Builder::new().stack_size(512 * 1024);
        let thread = small.spawn(|| fault(&"max(1 or 1 and 1 < 1 + 2 * -3^".repeat(60)).1);
        let message = thread.map(std::thread::JoinHandle::join);
        assert!(message.is_ok_and(|joined| joined.is_ok_and(|m| m.contains("deeper than 200"))));
    }

    #[test]
    fn texts_longer_than_64_kib_are_refused() {
        let long = "1+".repeat(LONGEST_TEXT / 2) + "1";
        let (at, message) = fault(&long);
        assert_eq!(at, "1");
        assert!(message.contains("at most 65536 bytes"), "{message}");
        // A character across the limit is kept whole.
        assert!(fault(&"é+".repeat(LONGEST_TEXT / 2)).0.starts_with(['é', '+']));
        assert!(parse(&long[..LONGEST_TEXT - 1], &[]).is_ok());
    }
}
