//! Reading productions.
//!
//! A letter with the digits after it is a symbol of its own; so is every sign of the turtle, and
//! a question with its letter: `?P`.
//! A statement begins on a line with `->` or the word `define` and reaches to the next one;
//! `#` begins a comment.

use std::ops::Range;
use weald_contract::formula::{Definition, Formula, Variable, is_function};
use weald_contract::{Problem, Problems, Span, Written};

/// The signs that the turtle knows, besides letters, `F` and `f` among them, and `~`.
const SIGNS: &str = "+-&^\\/|[]!'{}.$%_";

/// Letters of the questions `?E`, `?P`, `?H`, `?L`, `?U`; a symbol's number is its place here.
pub const QUESTIONS: [char; 5] = ['E', 'P', 'H', 'L', 'U'];

/// What every formula may name, in the order of [`crate::lsystem::rewrite`]'s table.
pub const GLOBALS: [&str; 6] = ["time", "vigor", "maturity", "height", "radius", "stem"];

/// The name that gives a new number in [0, 1) to each place where it stands.
const CHANCE: &str = "random";

/// A letter, or a sign of the turtle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Symbol {
    /// The letter or sign.
    pub mark: char,
    /// For a letter the digits after it and one, or 0; for `~` the number of the organ; for `?`
    /// the place in [`QUESTIONS`].
    pub number: u32,
}

impl Symbol {
    /// Whether contexts see it.
    fn is_letter(self) -> bool {
        self.mark.is_ascii_alphabetic()
    }

    /// Whether something answers it after a step.
    pub fn is_question(self) -> bool {
        self.mark == '?'
    }
}

impl std::fmt::Display for Symbol {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match (self.is_letter(), self.number) {
            (true, 1..) => write!(f, "{}{}", self.mark, self.number - 1),
            (false, number) if self.is_question() => {
                write!(f, "?{}", QUESTIONS.get(number as usize).unwrap_or(&' '))
            }
            _ => write!(f, "{}", self.mark),
        }
    }
}

/// Where a formula finds the value of one of its names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Source {
    /// A parameter of the modules that a production matches, in the order of its text.
    Parameter(usize),
    /// A number that holds everywhere: those of [`GLOBALS`], then what was defined.
    Global(usize),
    /// Chance.
    Chance,
}

/// A formula whose names are known.
#[derive(Clone, Debug, PartialEq)]
pub struct Expression {
    /// The formula.
    pub formula: Formula,
    /// Source of each of its variables.
    pub sources: Vec<Source>,
}

/// A module with formulas for parameters.
#[derive(Clone, Debug, PartialEq)]
pub struct Template {
    /// What it is.
    pub symbol: Symbol,
    /// Its parameters.
    pub arguments: Vec<Expression>,
}

/// A module that must be found: so many parameters, which get names.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Pattern {
    /// What it is.
    pub symbol: Symbol,
    /// Number of its parameters.
    pub arity: usize,
}

/// `left < predecessor > right : condition -> successor : weight`.
#[derive(Clone, Debug, PartialEq)]
pub struct Production {
    /// What must stand before.
    pub left: Vec<Pattern>,
    /// What is replaced.
    pub predecessor: Pattern,
    /// What must stand after.
    pub right: Vec<Pattern>,
    /// What must not be 0.
    pub condition: Option<Expression>,
    /// What replaces it.
    pub successor: Vec<Template>,
    /// Share of the cases, among the productions that fit and have one.
    pub weight: Option<Expression>,
    /// Where it is written.
    pub span: Span,
}

/// An L-system, read.
#[derive(Clone, Debug, PartialEq)]
pub struct Grammar {
    /// The string to begin with.
    pub axiom: Vec<Template>,
    /// Formulas of the defined numbers, each of those before it.
    pub definitions: Vec<Expression>,
    /// Productions of a step.
    pub rules: Vec<Production>,
    /// Productions applied to what a step has made.
    pub decomposition: Vec<Production>,
    /// Productions applied to what the turtle reads.
    pub interpretation: Vec<Production>,
    /// Letters that contexts do not see.
    pub ignored: Vec<char>,
    /// Whether the axiom or a successor asks something.
    pub asks: bool,
    /// Where the axiom is written.
    pub span: Span,
}

/// The parts of an L-system as they were written.
#[derive(Clone, Debug)]
pub struct Texts<'a> {
    /// The string to begin with.
    pub axiom: &'a Written<String>,
    /// Definitions and productions of a step.
    pub rules: &'a Written<String>,
    /// Productions applied to what a step has made.
    pub decomposition: &'a Written<String>,
    /// Productions applied to what the turtle reads.
    pub interpretation: &'a Written<String>,
    /// Letters that contexts do not see.
    pub ignore: &'a str,
    /// Names of organs.
    pub organs: Vec<&'a Written<String>>,
}

impl Grammar {
    /// Reads an L-system.
    ///
    /// # Errors
    /// Every mistake, each at its token.
    pub fn read(texts: &Texts<'_>) -> Result<Self, Problems> {
        let organs: Vec<&str> = texts.organs.iter().map(|name| name.value.as_str()).collect();
        let mut problems: Problems =
            texts.organs.iter().filter(|name| !is_name(&name.value)).map(|n| bad_name(n)).collect();
        let globals = GLOBALS.iter().map(ToString::to_string).collect();
        let (defined, functions) = Default::default();
        let mut names = Names { globals, organs: &organs, defined, functions };
        let mut read = |text: &Written<String>, contexts: bool| {
            Reader::new(text).productions(&mut names, contexts, &mut problems)
        };
        let rules = read(texts.rules, true);
        let decomposition = read(texts.decomposition, false);
        let interpretation = read(texts.interpretation, false);
        let reader = Reader::new(texts.axiom);
        let axiom = reader.successor(0..reader.text.len(), &names, &[]).unwrap_or_else(|problem| {
            problems.push(problem);
            Vec::new()
        });
        if !problems.is_empty() {
            return Err(problems);
        }
        let ignored = texts.ignore.chars().filter(|c| !c.is_whitespace()).collect();
        let (definitions, span) = (names.defined, texts.axiom.span);
        let all = [&rules, &decomposition, &interpretation].into_iter().flatten();
        let made = axiom.iter().chain(all.flat_map(|production| &production.successor));
        let asks = made.into_iter().any(|template| template.symbol.is_question());
        Ok(Self { axiom, definitions, rules, decomposition, interpretation, ignored, asks, span })
    }

    /// Whether contexts see a symbol.
    pub fn is_seen(&self, symbol: Symbol) -> bool {
        (symbol.is_letter() || symbol.is_question()) && !self.ignored.contains(&symbol.mark)
    }
}

fn is_name(text: &str) -> bool {
    let word = |c: char| c.is_ascii_alphanumeric() || c == '_';
    text.starts_with(|c: char| c.is_ascii_alphabetic()) && text.chars().all(word)
}

fn bad_name(name: &Written<String>) -> Problem {
    Problem::at(name.span, format!("`{}` is no name", name.value))
        .hint("letters, digits and underscores, a letter first")
}

/// Names that formulas may use.
struct Names<'a> {
    globals: Vec<String>,
    organs: &'a [&'a str],
    defined: Vec<Expression>,
    functions: Vec<Definition>,
}

/// One text with its place in the file.
struct Reader {
    /// The text, comments blanked.
    text: String,
    span: Span,
    /// Bytes of quotes before the text.
    quotes: usize,
}

type Parsed<T> = Result<T, Problem>;

impl Reader {
    fn new(written: &Written<String>) -> Self {
        let text = blank_comments(&written.value);
        let quotes = opening_quotes(&written.value, written.span);
        Self { text, span: written.span, quotes }
    }

    /// A problem at bytes of the text.
    fn problem(&self, range: Range<usize>, what: impl Into<String>) -> Problem {
        Problem::at(self.place(range), what)
    }

    fn place(&self, range: Range<usize>) -> Span {
        self.span.narrow(range.start + self.quotes..range.end + self.quotes)
    }

    fn productions(
        &self,
        names: &mut Names<'_>,
        contexts: bool,
        problems: &mut Problems,
    ) -> Vec<Production> {
        let mut productions = Vec::new();
        for range in self.statements() {
            let result = match self.text[range.clone()].strip_prefix("define ") {
                Some(_) => self.definition(range.start + "define ".len()..range.end, names),
                None => self.production(range, names, contexts).map(|p| productions.push(p)),
            };
            problems.extend(result.err());
        }
        productions
    }

    /// Bytes of each statement.
    fn statements(&self) -> Vec<Range<usize>> {
        let mut statements: Vec<Range<usize>> = Vec::new();
        let mut start = 0;
        for line in self.text.split_inclusive('\n') {
            let range = self.trimmed(start..start + line.len());
            start += line.len();
            if range.is_empty() {
                continue;
            }
            let begins = line.contains("->") || self.text[range.clone()].starts_with("define ");
            match statements.last_mut().filter(|_| !begins) {
                Some(last) => last.end = range.end,
                None => statements.push(range),
            }
        }
        statements
    }

    /// The bytes without white space around them.
    fn trimmed(&self, range: Range<usize>) -> Range<usize> {
        let text = &self.text[range.clone()];
        let start = range.start + (text.len() - text.trim_start().len());
        start..start + text.trim().len()
    }

    fn definition(&self, range: Range<usize>, names: &mut Names<'_>) -> Parsed<()> {
        let text = &self.text[range.clone()];
        let missing = || {
            let what = "expected `define name = formula` or `define name(parameters) = formula`";
            self.problem(range.clone(), what)
        };
        let equals = range.start + text.find('=').ok_or_else(missing)?;
        let head = self.trimmed(range.start..equals);
        let open = self.text[head.clone()].find('(').map_or(head.end, |at| head.start + at);
        let name = self.trimmed(head.start..open);
        let word = &self.text[name.clone()];
        let mut known = names.globals.iter().chain(names.functions.iter().map(|f| &f.name));
        let is_taken = known.any(|known| known == word) || word == CHANCE || is_function(word);
        if !is_name(word) || is_taken {
            let what = format!("`{word}` cannot be defined");
            return Err(self.problem(name, what).hint("a new name is needed, a letter first"));
        }
        let word = word.to_string();
        let body = equals + 1..range.end;
        if open < head.end {
            let (arguments, end) = self.arguments(open, head.end)?;
            if end != head.end {
                return Err(missing());
            }
            let mut parameters = Vec::new();
            arguments.into_iter().try_for_each(|a| self.parameter(a, &mut parameters))?;
            // Read once by itself, so that a mistake is told where it is written.
            self.expression(body.clone(), names, &parameters)?;
            let body = self.text[body].to_string();
            names.functions.push(Definition { name: word, parameters, body });
            return Ok(());
        }
        let value = self.expression(body, names, &[])?;
        if value.sources.contains(&Source::Chance) {
            let what = "a definition holds everywhere and takes no chance";
            return Err(self.problem(equals + 1..range.end, what));
        }
        names.defined.push(value);
        names.globals.push(word);
        Ok(())
    }

    fn production(
        &self,
        range: Range<usize>,
        names: &Names<'_>,
        contexts: bool,
    ) -> Parsed<Production> {
        let Some(arrow) = self.text[range.clone()].find("->").map(|at| range.start + at) else {
            return Err(self.problem(range, "expected a production, `A -> B`"));
        };
        let body = arrow + 2..range.end;
        let (head, condition) = split(range.start..arrow, self.text[range.start..arrow].find(':'));
        let weight = self.last_colon(body.clone()).map(|at| at - body.start);
        let (body, weight) = split(body, weight);
        let mut parameters = Vec::new();
        let [left, own, right] = self.sides(head.clone(), contexts)?;
        let left = self.patterns(left, names, &mut parameters)?;
        let predecessor = self.patterns(own, names, &mut parameters)?;
        let right = self.patterns(right, names, &mut parameters)?;
        let [predecessor] = predecessor[..] else {
            return Err(self.problem(head, "exactly one module is replaced"));
        };
        if "[]".contains(predecessor.symbol.mark) {
            return Err(self.problem(head, "brackets are not replaced"));
        }
        let formula = |range: Option<Range<usize>>| {
            range.map(|range| self.expression(range, names, &parameters)).transpose()
        };
        Ok(Production {
            left,
            predecessor,
            right,
            condition: formula(condition)?,
            successor: self.successor(body, names, &parameters)?,
            weight: formula(weight)?,
            span: self.place(range),
        })
    }

    /// Bytes of the left context, the predecessor and the right context.
    fn sides(&self, head: Range<usize>, contexts: bool) -> Parsed<[Range<usize>; 3]> {
        let text = &self.text[head.clone()];
        let less = text.find('<').map(|at| head.start + at);
        let more = text.find('>').map(|at| head.start + at);
        if !contexts && let Some(at) = less.or(more) {
            let what = "decomposition and interpretation do not look at neighbours";
            return Err(self.problem(at..at + 1, what));
        }
        let own = less.map_or(head.start, |at| at + 1)..more.unwrap_or(head.end);
        if own.start > own.end {
            return Err(self.problem(head, "expected `left < predecessor > right`"));
        }
        let left = head.start..less.unwrap_or(head.start);
        Ok([left, own, more.map_or(head.end, |at| at + 1)..head.end])
    }

    /// The last colon that is not inside parentheses.
    fn last_colon(&self, range: Range<usize>) -> Option<usize> {
        let mut depth = 0_i32;
        let mut found = None;
        for (at, byte) in self.text[range.clone()].bytes().enumerate() {
            depth += i32::from(byte == b'(') - i32::from(byte == b')');
            if byte == b':' && depth == 0 {
                found = Some(range.start + at);
            }
        }
        found
    }

    fn patterns(
        &self,
        range: Range<usize>,
        names: &Names<'_>,
        parameters: &mut Vec<String>,
    ) -> Parsed<Vec<Pattern>> {
        let mut patterns = Vec::new();
        for (symbol, arguments) in self.modules(range, names)? {
            let arity = arguments.len();
            arguments.into_iter().try_for_each(|a| self.parameter(a, parameters))?;
            patterns.push(Pattern { symbol, arity });
        }
        Ok(patterns)
    }

    /// Takes in the name of a parameter.
    fn parameter(&self, name: Range<usize>, parameters: &mut Vec<String>) -> Parsed<()> {
        let word = &self.text[name.clone()];
        if !is_name(word) || parameters.iter().any(|known| known == word) {
            let what = format!("`{word}` is no new name of a parameter");
            return Err(self.problem(name, what));
        }
        parameters.push(word.to_string());
        Ok(())
    }

    fn successor(
        &self,
        range: Range<usize>,
        names: &Names<'_>,
        parameters: &[String],
    ) -> Parsed<Vec<Template>> {
        let mut templates = Vec::new();
        let mut depth = 0_usize;
        for (symbol, arguments) in self.modules(range.clone(), names)? {
            depth = match symbol.mark {
                '[' => depth + 1,
                ']' if depth == 0 => {
                    return Err(self.problem(range, "a `]` without its `[`"));
                }
                ']' => depth - 1,
                _ => depth,
            };
            let argument = |range| self.expression(range, names, parameters);
            let arguments = arguments.into_iter().map(argument).collect::<Parsed<_>>()?;
            templates.push(Template { symbol, arguments });
        }
        match depth {
            0 => Ok(templates),
            _ => Err(self.problem(range, "a `[` without its `]`")),
        }
    }

    /// Symbols with the bytes of their arguments.
    fn modules(
        &self,
        range: Range<usize>,
        names: &Names<'_>,
    ) -> Parsed<Vec<(Symbol, Vec<Range<usize>>)>> {
        let mut modules = Vec::new();
        let mut at = self.skip_space(range.start, range.end);
        while at < range.end {
            let (symbol, after) = self.symbol(at, range.end, names)?;
            let (arguments, after) = self.arguments(after, range.end)?;
            let most = match symbol.mark {
                '?' => 3,
                '~' => 2,
                _ if symbol.is_letter() => usize::MAX,
                _ => 1,
            };
            if arguments.len() > most {
                let what = format!("`{symbol}` takes at most {most} parameters");
                return Err(self.problem(at..after, what));
            }
            if symbol.is_question() && arguments.is_empty() {
                let what = format!("`{symbol}` needs a parameter that the answer replaces");
                return Err(self.problem(at..after, what).hint(format!("write `{symbol}(0)`")));
            }
            modules.push((symbol, arguments));
            at = self.skip_space(after, range.end);
        }
        Ok(modules)
    }

    fn skip_space(&self, at: usize, end: usize) -> usize {
        at + (self.text[at..end].len() - self.text[at..end].trim_start().len())
    }

    fn symbol(&self, at: usize, end: usize, names: &Names<'_>) -> Parsed<(Symbol, usize)> {
        let rest = &self.text[at..end];
        let mark = rest.chars().next().unwrap_or(' ');
        let after = at + mark.len_utf8();
        let word = |is: fn(char) -> bool| {
            let tail = &self.text[after..end];
            after..after + tail.find(|c| !is(c)).unwrap_or(tail.len())
        };
        if mark.is_ascii_alphabetic() {
            let digits = word(|c| c.is_ascii_digit());
            let number = match &self.text[digits.clone()] {
                "" => 0,
                text => text.parse::<u16>().map(|n| u32::from(n) + 1).map_err(|_| {
                    self.problem(digits.clone(), "a letter's number is at most 65535")
                })?,
            };
            return Ok((Symbol { mark, number }, digits.end));
        }
        if mark == '~' {
            let name = word(|c| c.is_ascii_alphanumeric() || c == '_');
            let text = &self.text[name.clone()];
            let Some(number) = names.organs.iter().position(|organ| *organ == text) else {
                let what = format!("no organ is called `{text}`");
                let known = format!("known here: {}", names.organs.join(", "));
                return Err(self.problem(at..name.end, what).hint(known));
            };
            return Ok((Symbol { mark, number: number as u32 }, name.end));
        }
        if mark == '?' {
            let letter = self.text[after..end].chars().next();
            let number = QUESTIONS.iter().position(|question| Some(*question) == letter);
            let Some(number) = number else {
                let what = "`?` asks nothing without its letter";
                let hint =
                    "`?E` (environment), `?P` (position), `?H`, `?L`, `?U` (heading, left, up)";
                return Err(self.problem(at..after, what).hint(hint));
            };
            return Ok((Symbol { mark, number: number as u32 }, after + 1));
        }
        if SIGNS.contains(mark) {
            return Ok((Symbol { mark, number: 0 }, after));
        }
        let what = format!("`{mark}` is no module");
        let hint = format!("a letter, `~organ`, a question such as `?E`, or one of {SIGNS}");
        Err(self.problem(at..after, what).hint(hint))
    }

    /// Bytes of the arguments in parentheses, if there are any, and where they end.
    fn arguments(&self, at: usize, end: usize) -> Parsed<(Vec<Range<usize>>, usize)> {
        let open = self.skip_space(at, end);
        if !self.text[open..end].starts_with('(') {
            return Ok((Vec::new(), at));
        }
        let mut arguments = Vec::new();
        let (mut depth, mut start) = (0_usize, open + 1);
        for (offset, byte) in self.text[open..end].bytes().enumerate() {
            let here = open + offset;
            match byte {
                b'(' => depth += 1,
                b',' if depth == 1 => {
                    arguments.push(self.trimmed(start..here));
                    start = here + 1;
                }
                b')' if depth == 1 => {
                    arguments.push(self.trimmed(start..here));
                    return Ok((arguments, here + 1));
                }
                b')' => depth -= 1,
                _ => {}
            }
        }
        Err(self.problem(open..open + 1, "a `(` without its `)`"))
    }

    fn expression(
        &self,
        range: Range<usize>,
        names: &Names<'_>,
        parameters: &[String],
    ) -> Parsed<Expression> {
        let range = self.trimmed(range);
        let at = |inner: &Range<usize>| range.start + inner.start..range.start + inner.end;
        let formula = Formula::parse_with(&self.text[range.clone()], &names.functions)
            .map_err(|error| self.problem(at(&error.span), error.message))?;
        let mut sources = Vec::new();
        for (variable, span) in formula.variables().iter().zip(formula.spans()) {
            let place = at(span);
            let word = match variable {
                Variable::Layer(name) => name.as_str(),
                Variable::X => "x",
                Variable::Y => "y",
                Variable::CrownShadow(_) => "crown_shadow",
            };
            let is_noise = self.text[place.clone()].starts_with("noise");
            let source = source(word, names, parameters).filter(|_| !is_noise);
            let known = parameters.iter().chain(&names.globals).map(String::as_str);
            sources.push(source.ok_or_else(|| {
                let what = format!("`{}` is not known here", &self.text[place.clone()]);
                let known: Vec<&str> = known.chain([CHANCE]).collect();
                self.problem(place, what).hint(format!("known here: {}", known.join(", ")))
            })?);
        }
        Ok(Expression { formula, sources })
    }
}

/// What a name stands for; parameters hide what holds everywhere.
fn source(word: &str, names: &Names<'_>, parameters: &[String]) -> Option<Source> {
    let parameter = parameters.iter().position(|name| name == word).map(Source::Parameter);
    let global = || names.globals.iter().position(|name| name == word).map(Source::Global);
    parameter.or_else(global).or((word == CHANCE).then_some(Source::Chance))
}

/// What stands before and after a byte, counted from the start of the range.
fn split(range: Range<usize>, at: Option<usize>) -> (Range<usize>, Option<Range<usize>>) {
    match at.map(|at| range.start + at) {
        Some(at) => (range.start..at, Some(at + 1..range.end)),
        None => (range, None),
    }
}

/// The text with comments turned to spaces, so that places stay.
fn blank_comments(text: &str) -> String {
    let mut in_comment = false;
    let blank = |c: char| {
        in_comment = c != '\n' && (in_comment || c == '#');
        if in_comment { " ".repeat(c.len_utf8()) } else { c.to_string() }
    };
    text.chars().map(blank).collect()
}

/// Bytes of quotes before a text, judged by how much longer its token is.
///
/// Texts of several lines stand in triple quotes, after which a line break may be dropped. In
/// texts with escapes a place may be off by their number; single quotes have none.
fn opening_quotes(text: &str, span: Span) -> usize {
    let more = (span.end.saturating_sub(span.start) as usize).saturating_sub(text.len());
    match more {
        0..=5 if !text.contains('\n') => 1,
        0..=6 => 3,
        7 => 4,
        _ => 5,
    }
}
