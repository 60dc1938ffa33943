//! Errors on stderr, with the line and the token they speak of.

use miette::{
    GraphicalReportHandler, GraphicalTheme, LabeledSpan, MietteDiagnostic, NamedSource, Report,
};
use std::io::IsTerminal;
use weald_contract::{Problem, Sources};
use weald_run::Error;

/// Prints an error: every problem with its place, or one line.
pub fn error(error: &Error) {
    match error {
        Error::Wrong { sources, problems } => {
            for problem in problems {
                eprint!("{}", problem_in_words(problem, sources));
            }
            if problems.len() > 1 {
                eprintln!("{} problems", problems.len());
            }
        }
        other => eprintln!("error: {other}"),
    }
}

/// A problem with the lines around its place; without one, a line.
fn problem_in_words(problem: &Problem, sources: &Sources) -> String {
    let placed = problem.span.and_then(|span| Some((span, sources.get(span.source)?)));
    let Some((span, source)) = placed else {
        let hint = problem.hint.as_ref().map_or(String::new(), |hint| format!("\n hint: {hint}"));
        return format!("error: {}{hint}\n", problem.message);
    };
    let length = source.text.len();
    let start = (span.start as usize).min(length);
    let end = (span.end as usize).clamp(start, length);
    let mut diagnostic = MietteDiagnostic::new(problem.message.clone())
        .with_label(LabeledSpan::new_with_span(None, (start, end - start)));
    if let Some(hint) = &problem.hint {
        diagnostic = diagnostic.with_help(hint.clone());
    }
    let report = Report::new(diagnostic)
        .with_source_code(NamedSource::new(&source.name, source.text.clone()));
    let mut text = String::new();
    let shown = handler().render_report(&mut text, report.as_ref());
    match shown {
        Ok(()) => text,
        Err(_) => format!("error: {problem}\n"),
    }
}

/// Colours on a terminal that did not ask for none; plain lines elsewhere.
fn handler() -> GraphicalReportHandler {
    let is_terminal = std::io::stderr().is_terminal();
    let wants_color = std::env::var_os("NO_COLOR").is_none_or(|value| value.is_empty());
    let theme = match is_terminal && wants_color {
        true => GraphicalTheme::unicode(),
        false => GraphicalTheme::unicode_nocolor(),
    };
    GraphicalReportHandler::new_themed(theme).with_width(100).with_links(false)
}
