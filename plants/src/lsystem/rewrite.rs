//! Rewriting a string of modules.
//!
//! Between two steps the modules that ask something are answered: the string is interpreted as at
//! the end of the step that has just been made, and whoever reads it returns the answers
//! [Mech96] §3. They replace the modules' parameters before the next step sees them.

use super::grammar::{Expression, Grammar, Pattern, Production, Source, Symbol, Template};
use crate::Stature;
use std::collections::HashMap;
use weald_contract::{Problem, Seed, Span};

/// Most modules of a string: a tree of that many would not be drawn with sense.
const MOST_MODULES: usize = 1_000_000;

/// How often decomposition or interpretation may apply to what it has just made.
const DEEPEST: u32 = 64;

/// One module of a string.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Module {
    /// What it is.
    pub symbol: Symbol,
    /// Hash of the path of successors that it descends from.
    pub id: u64,
    first: u32,
    count: u32,
}

/// A string of modules.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Word {
    /// The modules.
    pub modules: Vec<Module>,
    values: Vec<f32>,
}

impl Word {
    /// Parameters of a module.
    pub fn values_of(&self, module: &Module) -> &[f32] {
        &self.values[module.first as usize..(module.first + module.count) as usize]
    }

    /// Replaces parameters of modules by the answers that they got.
    fn take(&mut self, answers: &[Answer]) {
        let answers: HashMap<u64, [f32; 3]> = answers.iter().map(|a| (a.id, a.values)).collect();
        for module in self.modules.iter().filter(|module| module.symbol.is_question()) {
            let Some(answer) = answers.get(&module.id) else { continue };
            let (first, count) = (module.first as usize, module.count as usize);
            for (value, answer) in self.values[first..first + count].iter_mut().zip(answer) {
                *value = *answer;
            }
        }
    }

    fn push(&mut self, symbol: Symbol, id: u64, values: &[f32]) {
        let first = self.values.len() as u32;
        self.values.extend_from_slice(values);
        self.modules.push(Module { symbol, id, first, count: values.len() as u32 });
    }
}

/// Letters, signs and parameters, as they would be written.
impl std::fmt::Display for Word {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        for module in &self.modules {
            let values: Vec<String> =
                self.values_of(module).iter().map(ToString::to_string).collect();
            write!(f, "{}", module.symbol)?;
            if !values.is_empty() {
                write!(f, "({})", values.join(","))?;
            }
        }
        Ok(())
    }
}

/// The answer to one question.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Answer {
    /// The module that asked.
    pub id: u64,
    /// What replaces its parameters, as many as it has.
    pub values: [f32; 3],
}

/// The string that the turtle reads after `time` steps: whole steps are made, and formulas see
/// the time itself. `answer` gets each interpreted string whose questions are to be answered.
///
/// # Errors
/// The production that makes the string too long or never ends, or what `answer` finds wrong.
pub fn derive(
    grammar: &Grammar,
    time: f32,
    stature: &Stature,
    seed: Seed,
    answer: &mut dyn FnMut(&Word) -> Result<Vec<Answer>, Problem>,
) -> Result<Word, Problem> {
    // A step that has begun counts: what it makes starts from nothing.
    let steps = libm::ceilf(time.max(0.0)) as usize;
    let mut answers: Vec<Vec<Answer>> = Vec::new();
    let at = |then: f32, steps: usize, answers: &[Vec<Answer>]| {
        let part = if time > 0.0 { then / time } else { 1.0 };
        let stature = Stature { maturity: stature.maturity * part, ..*stature };
        Rewriter { grammar, globals: globals(grammar, then, &stature), seed }.after(steps, answers)
    };
    if grammar.asks {
        // What a plant was told in its youth does not depend on how old it is now, so each
        // answer is that of a plant grown to its step: formulas see that time.
        for step in 0..steps {
            answers.push(answer(&at(step as f32, step, &answers)?)?);
        }
        answers.push(answer(&at(time, steps, &answers)?)?);
    }
    at(time, steps, &answers)
}

/// Values of the names that hold everywhere, in the order of [`super::grammar::GLOBALS`].
fn globals(grammar: &Grammar, time: f32, stature: &Stature) -> Vec<f32> {
    let Stature { height, radius, stem_radius, maturity, vigor } = *stature;
    let mut globals = vec![time, vigor, maturity, height, radius, 2.0 * stem_radius];
    for definition in &grammar.definitions {
        let value = evaluate(definition, &[], &globals, || 0.0);
        globals.push(value);
    }
    globals
}

fn evaluate(
    expression: &Expression,
    parameters: &[f32],
    globals: &[f32],
    mut chance: impl FnMut() -> f32,
) -> f32 {
    let value = |source: &Source| match *source {
        Source::Parameter(i) => parameters[i],
        Source::Global(i) => globals[i],
        Source::Chance => chance(),
    };
    // Few formulas have more than a handful of names.
    let inputs: Vec<f32> = expression.sources.iter().map(value).collect();
    expression.formula.eval(&inputs)
}

/// A module with the production that was chosen for it.
struct Match<'a> {
    production: &'a Production,
    parameters: Vec<f32>,
}

struct Rewriter<'a> {
    grammar: &'a Grammar,
    globals: Vec<f32>,
    seed: Seed,
}

impl<'a> Rewriter<'a> {
    fn axiom(&mut self) -> Result<Word, Problem> {
        let mut word = Word::default();
        let grammar = self.grammar;
        self.append(&grammar.axiom, &[], 0, 0, grammar.span, &mut word)?;
        Ok(word)
    }

    /// The interpreted string after so many steps; before each the answers are taken that belong
    /// to it, and at the end those of one more.
    fn after(&mut self, steps: usize, answers: &[Vec<Answer>]) -> Result<Word, Problem> {
        let mut word = self.axiom()?;
        let mut next = Word::default();
        for step in 0..steps {
            answers.get(step).into_iter().for_each(|answers| word.take(answers));
            self.step(&word, &mut next)?;
            std::mem::swap(&mut word, &mut next);
        }
        answers.get(steps).into_iter().for_each(|answers| word.take(answers));
        self.interpret(&word)
    }

    /// Replaces all modules at once.
    fn step(&mut self, word: &Word, next: &mut Word) -> Result<(), Problem> {
        next.modules.clear();
        next.values.clear();
        let mut at = 0;
        while let Some(module) = word.modules.get(at) {
            // The cut removes the rest of its branch.
            if module.symbol.mark == '%' {
                at = branch_end(&word.modules, at);
                continue;
            }
            match self.choose(&self.grammar.rules, word, at) {
                Some(found) => {
                    let Match { production, parameters } = found;
                    let (successor, span) = (&production.successor, production.span);
                    self.append(successor, &parameters, module.id, 0, span, next)?;
                }
                None => next.push(module.symbol, module.id, word.values_of(module)),
            }
            at += 1;
        }
        Ok(())
    }

    /// Appends a successor, decomposed.
    fn append(
        &self,
        successor: &'a [Template],
        parameters: &[f32],
        parent: u64,
        depth: u32,
        span: Span,
        out: &mut Word,
    ) -> Result<(), Problem> {
        let single = self.instance(successor, parameters, parent);
        self.expand(&self.grammar.decomposition, &single, depth, span, out)
    }

    /// Modules of a successor with their parameters computed.
    fn instance(&self, successor: &[Template], parameters: &[f32], parent: u64) -> Word {
        let mut word = Word::default();
        for (template, place) in successor.iter().zip(0_u64..) {
            let id = Seed(parent).part("successor", place).0;
            let mut stream = Seed(self.seed.0 ^ id).stream("parameters", 0);
            let value = |expression: &Expression| {
                evaluate(expression, parameters, &self.globals, || stream.unit() as f32)
            };
            let values: Vec<f32> = template.arguments.iter().map(value).collect();
            word.push(template.symbol, id, &values);
        }
        word
    }

    /// Appends a string, applying productions to each module for as long as one fits.
    fn expand(
        &self,
        productions: &'a [Production],
        word: &Word,
        depth: u32,
        span: Span,
        out: &mut Word,
    ) -> Result<(), Problem> {
        for (at, module) in word.modules.iter().enumerate() {
            let Some(found) = self.choose(productions, word, at) else {
                out.push(module.symbol, module.id, word.values_of(module));
                if out.modules.len() > MOST_MODULES {
                    let what = format!("the string grows beyond {MOST_MODULES} modules here");
                    let hint = "lower `steps`, or let a condition end the growth";
                    return Err(Problem::at(span, what).hint(hint));
                }
                continue;
            };
            let span = found.production.span;
            if depth == DEEPEST {
                let what = format!("this production applies to its own result {DEEPEST} times");
                return Err(Problem::at(span, what).hint("let a condition end it"));
            }
            let made = self.instance(&found.production.successor, &found.parameters, module.id);
            self.expand(productions, &made, depth + 1, span, out)?;
        }
        Ok(())
    }

    fn interpret(&self, word: &Word) -> Result<Word, Problem> {
        let mut out = Word::default();
        self.expand(&self.grammar.interpretation, word, 0, self.grammar.span, &mut out)?;
        Ok(out)
    }

    /// The first production that fits the module; if it has a weight, one by chance of those
    /// that fit and have one.
    fn choose(&self, productions: &'a [Production], word: &Word, at: usize) -> Option<Match<'a>> {
        let module = &word.modules[at];
        let candidates = productions.iter().filter(|p| p.predecessor.symbol == module.symbol);
        let mut fitting = candidates.filter_map(|production| {
            let parameters = self.fit(production, word, at)?;
            Some(Match { production, parameters })
        });
        let first = fitting.next()?;
        if first.production.weight.is_none() {
            return Some(first);
        }
        let rest = fitting.filter(|found| found.production.weight.is_some());
        self.draw(std::iter::once(first).chain(rest).collect(), module.id)
    }

    fn draw(&self, matches: Vec<Match<'a>>, id: u64) -> Option<Match<'a>> {
        let weight = |found: &Match<'_>| {
            let weight = found.production.weight.as_ref()?;
            let weight = evaluate(weight, &found.parameters, &self.globals, || 0.0);
            (weight > 0.0 && weight.is_finite()).then_some(f64::from(weight))
        };
        let weights: Vec<f64> = matches.iter().map(|found| weight(found).unwrap_or(0.0)).collect();
        let total: f64 = weights.iter().sum();
        let mut rest = Seed(self.seed.0 ^ id).stream("production", 0).unit() * total;
        let chosen = weights.iter().position(|weight| {
            rest -= weight;
            rest < 0.0
        });
        matches.into_iter().nth(chosen?)
    }

    /// The values of a production's parameters, if it fits the module.
    fn fit(&self, production: &Production, word: &Word, at: usize) -> Option<Vec<f32>> {
        let module = &word.modules[at];
        if module.count as usize != production.predecessor.arity {
            return None;
        }
        let mut parameters = Vec::new();
        for module in self.left(&production.left, word, at)? {
            parameters.extend_from_slice(word.values_of(module));
        }
        parameters.extend_from_slice(word.values_of(module));
        self.right(&production.right, word, at + 1, &mut parameters)?;
        let holds = production.condition.as_ref().is_none_or(|condition| {
            let value = evaluate(condition, &parameters, &self.globals, || {
                Seed(self.seed.0 ^ module.id).stream("condition", 0).unit() as f32
            });
            value != 0.0 && !value.is_nan()
        });
        holds.then_some(parameters)
    }

    /// The modules of a left context, in the order of the text: the path towards the root.
    fn left<'w>(&self, patterns: &[Pattern], word: &'w Word, at: usize) -> Option<Vec<&'w Module>> {
        let mut found = Vec::new();
        let mut at = at;
        for pattern in patterns.iter().rev() {
            let module = loop {
                at = at.checked_sub(1)?;
                let module = &word.modules[at];
                match module.symbol.mark {
                    // A branch that ended before does not lie on the path.
                    ']' => at = branch_start(&word.modules, at)?,
                    _ if self.grammar.is_seen(module.symbol) => break module,
                    _ => {}
                }
            };
            if !is_match(pattern, module) {
                return None;
            }
            found.push(module);
        }
        found.reverse();
        Some(found)
    }

    /// Matches a right context from `at` on and appends its parameters; gives where it ends.
    fn right(
        &self,
        patterns: &[Pattern],
        word: &Word,
        at: usize,
        parameters: &mut Vec<f32>,
    ) -> Option<usize> {
        let mut at = at;
        for pattern in patterns {
            let module = loop {
                let module = word.modules.get(at)?;
                let mark = module.symbol.mark;
                match (mark, pattern.symbol.mark) {
                    ('[', '[') => break module,
                    // Branches that the context does not ask for are passed over.
                    ('[', _) => at = branch_end(&word.modules, at + 1),
                    (']', ']') => break module,
                    (_, ']') => at = branch_end(&word.modules, at).checked_sub(1)?,
                    (']', _) => return None,
                    _ if self.grammar.is_seen(module.symbol) => break module,
                    _ => {}
                }
                at += 1;
            };
            if !is_match(pattern, module) {
                return None;
            }
            parameters.extend_from_slice(word.values_of(module));
            at += 1;
        }
        Some(at)
    }
}

fn is_match(pattern: &Pattern, module: &Module) -> bool {
    pattern.symbol == module.symbol && pattern.arity == module.count as usize
}

/// The place of the `]` that ends the branch in which `at` lies, or the end of the string.
fn branch_end(modules: &[Module], at: usize) -> usize {
    let mut depth = 0_usize;
    for (offset, module) in modules[at.min(modules.len())..].iter().enumerate() {
        match module.symbol.mark {
            '[' => depth += 1,
            ']' if depth == 0 => return at + offset,
            ']' => depth -= 1,
            _ => {}
        }
    }
    modules.len()
}

/// The place of the `[` that begins the branch that ends at `at`.
fn branch_start(modules: &[Module], at: usize) -> Option<usize> {
    let mut depth = 0_usize;
    for place in (0..at).rev() {
        match modules[place].symbol.mark {
            ']' => depth += 1,
            '[' if depth == 0 => return Some(place),
            '[' => depth -= 1,
            _ => {}
        }
    }
    None
}
