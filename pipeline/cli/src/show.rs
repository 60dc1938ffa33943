//! Errors on stderr, with the line and the token they speak of.

use crate::say;
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
                say::aside(&problem_in_words(problem, sources));
            }
            if problems.len() > 1 {
                say::aside(&format!("{} problems\n", problems.len()));
            }
        }
        other => say::aside(&format!("error: {other}\n")),
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
    let (start, end) = first_line(&source.text, start, end);
    if widest_line_near(&source.text, start) > MAX_WIDTH {
        let (line, column) = sources.line_column(span).unwrap_or((1, 1));
        return format!("error: {}:{line}:{column}: {problem}\n", source.name);
    }
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

/// Widest line that is drawn, bytes. Wider ones fill the terminal with what helps nobody, and
/// miette 7.6 panics when a token stands beyond column 65,535.
const MAX_WIDTH: usize = 500;

/// Ends a span with its first line: the beginning of a long one says enough.
fn first_line(text: &str, start: usize, end: usize) -> (usize, usize) {
    let bytes = text.as_bytes().get(start..end).unwrap_or_default();
    let newline = bytes.iter().skip(1).position(|byte| *byte == b'\n');
    (start, newline.map_or(end, |at| start + 1 + at))
}

/// Length of the longest of the lines that are drawn with a place: its own and both neighbours.
fn widest_line_near(text: &str, at: usize) -> usize {
    let bytes = text.as_bytes();
    let (before, after) = bytes.split_at(at.min(bytes.len()));
    let widths = |part: &[u8]| part.split(|byte| *byte == b'\n').map(<[u8]>::len).take(2).max();
    let reversed: Vec<u8> = before.iter().rev().copied().collect();
    // Both halves of the line itself come first.
    widths(&reversed).unwrap_or(0) + widths(after).unwrap_or(0)
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

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Span;

    #[test]
    fn a_token_in_an_endless_line_is_told_without_the_line() {
        let mut sources = Sources::default();
        let text = format!("a = 1\nformula = \"{}\"\n", "(".repeat(100_000));
        let source = sources.add("scene.toml", text.clone());
        let end = text.len() as u32 - 2;
        let problem = Problem::at(Span { source, start: 90_000, end }, "too deep").hint("less");
        let words = problem_in_words(&problem, &sources);
        assert_eq!(words, "error: scene.toml:2:89995: too deep; less\n");
    }

    #[test]
    fn a_token_of_many_lines_is_shown_by_its_first() {
        let mut sources = Sources::default();
        let source = sources.add("scene.toml", "[[op]]\na = 1\n".repeat(5000));
        let problem = Problem::at(Span { source, start: 0, end: 60_000 }, "too many");
        let words = problem_in_words(&problem, &sources);
        assert!(words.contains("scene.toml:1:1") && words.lines().count() < 8, "{words}");
    }
}
