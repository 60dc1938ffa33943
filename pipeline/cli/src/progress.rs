//! Progress on stderr: bars on a terminal, a line a stage elsewhere.

use crate::args::Global;
use crate::say;
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::Value as Json;
use std::io::IsTerminal;
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};
use weald_contract::Progress;
use weald_contract::progress::Figure;
use weald_run::check::seconds_in_words;
use weald_run::plan::Step;
use weald_run::{Listener, Stage};

/// Set by the first Ctrl-C; the second one ends the program at once.
static STOP: AtomicBool = AtomicBool::new(false);

/// Listens for Ctrl-C from now on.
pub fn listen_for_ctrl_c() {
    let heard = || {
        if STOP.swap(true, Ordering::Relaxed) {
            std::process::exit(2);
        }
        say::aside("stopping; once more to stop at once\n");
    };
    // Without a handler Ctrl-C still ends the program, only less politely.
    let _ = ctrlc::set_handler(heard);
}

/// Whether Ctrl-C was heard.
pub fn is_stopped() -> bool {
    STOP.load(Ordering::Relaxed)
}

/// Shows progress as far as the flags and the terminal allow.
pub struct Shown {
    state: Mutex<State>,
    is_quiet: bool,
    is_verbose: bool,
    is_terminal: bool,
}

struct State {
    bar: Option<ProgressBar>,
    stage: Option<Stage>,
    began: Instant,
    /// The part of the stage that goes on, since when, and its figures in the order they came.
    part: String,
    part_began: Instant,
    figures: Vec<(String, Figure)>,
}

impl State {
    /// The part and its figures on one line.
    fn words(&self) -> String {
        let seconds = self.part_began.elapsed().as_secs_f64().max(0.1);
        let figures = self.figures.iter().map(|(name, figure)| match figure {
            Figure::Counted(count) => {
                format!("{} {name}/s", rate_in_words(*count as f64 / seconds))
            }
            Figure::Level(value) => format!("{name} {value:.3}"),
        });
        std::iter::once(self.part.clone()).chain(figures).collect::<Vec<_>>().join("  ")
    }
}

/// A rate as people say it: three digits and a power of thousand.
fn rate_in_words(rate: f64) -> String {
    match rate {
        r if r >= 1e6 => format!("{:.2} M", r / 1e6),
        r if r >= 1e3 => format!("{:.1} k", r / 1e3),
        r => format!("{r:.0}"),
    }
}

impl Shown {
    /// Follows the global flags.
    pub fn new(global: &Global) -> Self {
        let state = State {
            bar: None,
            stage: None,
            began: Instant::now(),
            part: String::new(),
            part_began: Instant::now(),
            figures: Vec::new(),
        };
        Self {
            state: Mutex::new(state),
            is_quiet: global.quiet,
            is_verbose: global.verbose,
            is_terminal: std::io::stderr().is_terminal(),
        }
    }

    /// The state; a panic elsewhere while it was held leaves nothing half-done in it.
    fn state(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Prints a line above the bar.
    fn say(&self, state: &State, line: &str) {
        match &state.bar {
            Some(bar) => bar.println(line),
            None => say::aside(&format!("{line}\n")),
        }
    }
}

impl Progress for Shown {
    fn begin(&self, what: &str, total: u64, unit: &str) {
        if self.is_quiet {
            return;
        }
        let mut state = self.state();
        let word = state.stage.map_or("", Stage::word);
        state.part = what.to_string();
        state.part_began = Instant::now();
        state.figures.clear();
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
        if self.is_terminal {
            let bar = ProgressBar::new(total)
                .with_style(style(unit, 20))
                .with_prefix(word)
                .with_message(what.to_string());
            bar.enable_steady_tick(Duration::from_millis(200));
            state.bar = Some(bar);
        } else if self.is_verbose {
            say::aside(&format!("{word:<10}{what}\n"));
        }
    }

    fn advance(&self, steps: u64) {
        if let Some(bar) = &self.state().bar {
            bar.inc(steps);
        }
    }

    fn figure(&self, name: &str, figure: Figure) {
        let mut state = self.state();
        let is_first = state.figures.is_empty();
        match (state.figures.iter_mut().find(|(known, _)| known == name), figure) {
            (Some((_, Figure::Counted(sum))), Figure::Counted(more)) => *sum += more,
            (Some((_, level)), figure) => *level = figure,
            (None, figure) => state.figures.push((name.to_string(), figure)),
        }
        if let Some(bar) = &state.bar {
            if is_first {
                bar.set_style(style("", 46));
            }
            bar.set_message(state.words());
        }
    }

    fn say(&self, what: &str) {
        if self.is_quiet {
            return;
        }
        let state = self.state();
        let word = state.stage.map_or("", Stage::word);
        self.say(&state, &format!("{word:<10}{what}"));
    }

    fn is_cancelled(&self) -> bool {
        is_stopped()
    }
}

/// A bar with its unit; templates of ours are right, so the fallback is never seen.
fn style(unit: &str, words: usize) -> ProgressStyle {
    let unit = unit.replace(['{', '}'], "");
    // The bar takes what room the terminal leaves, so that the line never wraps.
    let done =
        if unit.is_empty() { "{percent}%".into() } else { format!("{{pos}}/{{len}} {unit}") };
    let template = format!("{{prefix:<10}}{{msg:<{words}!}} {{wide_bar}} {done} {{eta:>3}} left");
    ProgressStyle::with_template(&template).unwrap_or_else(|_| ProgressStyle::default_bar())
}

impl Listener for Shown {
    fn stage_begins(&self, step: &Step) {
        let mut state = self.state();
        state.stage = Some(step.stage);
        state.began = Instant::now();
        if self.is_verbose && !self.is_quiet {
            for reason in &step.reasons {
                self.say(&state, &format!("{:<10}{reason}", step.stage.word()));
            }
        }
    }

    fn stage_ends(&self, stage: Stage, report: &Json) {
        let mut state = self.state();
        if let Some(bar) = state.bar.take() {
            bar.finish_and_clear();
        }
        if !self.is_quiet {
            let time = seconds_in_words(state.began.elapsed().as_secs_f64());
            say::aside(&format!("{:<10}{time:>8}   {}\n", stage.word(), in_words(report)));
        }
    }
}

/// A report on one line: names and numbers.
pub fn in_words(report: &Json) -> String {
    let named = |name: &str, value: &Json| format!("{} {}", plain(value), name.replace('_', " "));
    let parts = report.as_object().into_iter().flatten().filter_map(|(name, value)| match value {
        // Tables of tables are told line by line, or by `--json`.
        Json::Object(inner) if inner.values().any(Json::is_object) => None,
        Json::Object(inner) => {
            let inner: Vec<String> = inner.iter().map(|(name, value)| named(name, value)).collect();
            Some(inner.join(", "))
        }
        other => Some(named(name, other)),
    });
    parts.collect::<Vec<_>>().join(", ")
}

fn plain(value: &Json) -> String {
    match value {
        Json::String(text) => text.clone(),
        other => other.to_string(),
    }
}
