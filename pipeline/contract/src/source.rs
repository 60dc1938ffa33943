//! Texts that users wrote, places in them, and what is wrong there.

use std::fmt;

/// A text with the name to show for it: a file's path, or the flag it came from.
#[derive(Clone, Debug)]
pub struct Source {
    /// Path or flag, as the user wrote it.
    pub name: String,
    /// The whole text.
    pub text: String,
}

/// The texts of one run; a [`Span`] refers into it.
#[derive(Clone, Debug, Default)]
pub struct Sources {
    list: Vec<Source>,
}

/// A place in a text: byte range `start..end` of source number `source`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Span {
    /// Index into [`Sources`].
    pub source: u32,
    /// First byte.
    pub start: u32,
    /// One past the last byte.
    pub end: u32,
}

impl Span {
    /// Narrows the span to `range`, given in bytes from the span's own start.
    pub fn narrow(self, range: std::ops::Range<usize>) -> Span {
        let start = (self.start + range.start as u32).min(self.end);
        let end = (self.start + range.end as u32).clamp(start, self.end);
        Span { start, end, ..self }
    }
}

/// One thing wrong in what the user wrote: what, where, and what would be right.
#[derive(Clone, Debug, PartialEq)]
pub struct Problem {
    /// What is wrong, in one sentence without a full stop.
    pub message: String,
    /// The offending token, where there is one.
    pub span: Option<Span>,
    /// What would be right, if we know it.
    pub hint: Option<String>,
}

impl Problem {
    /// A problem at a place.
    pub fn at(span: Span, message: impl Into<String>) -> Self {
        Self { message: message.into(), span: Some(span), hint: None }
    }

    /// A problem with no place in a text.
    pub fn new(message: impl Into<String>) -> Self {
        Self { message: message.into(), span: None, hint: None }
    }

    /// Adds what would be right.
    pub fn hint(mut self, hint: impl Into<String>) -> Self {
        self.hint = Some(hint.into());
        self
    }
}

impl fmt::Display for Problem {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.message)?;
        match &self.hint {
            Some(hint) => write!(f, "; {hint}"),
            None => Ok(()),
        }
    }
}

impl std::error::Error for Problem {}

/// All problems of a text, gathered so that the user sees them at once.
pub type Problems = Vec<Problem>;

impl Sources {
    /// Adds a text and returns its index.
    pub fn add(&mut self, name: impl Into<String>, text: impl Into<String>) -> u32 {
        self.list.push(Source { name: name.into(), text: text.into() });
        (self.list.len() - 1) as u32
    }

    /// The source with this index, if there is one.
    pub fn get(&self, index: u32) -> Option<&Source> {
        self.list.get(index as usize)
    }

    /// Line and column (both from 1, columns in characters) of a span's start.
    pub fn line_column(&self, span: Span) -> Option<(usize, usize)> {
        let text = &self.get(span.source)?.text;
        let before = text.get(..(span.start as usize).min(text.len()))?;
        let line_start = before.rfind('\n').map_or(0, |i| i + 1);
        Some((before.matches('\n').count() + 1, before[line_start..].chars().count() + 1))
    }
}

/// The candidate nearest to `word`, if near enough to be a slip of the finger.
///
/// Edit distance at most a third of the word's length, rounded up.
pub fn nearest<'a>(word: &str, candidates: impl IntoIterator<Item = &'a str>) -> Option<&'a str> {
    let allowed = word.chars().count().div_ceil(3).max(1);
    candidates
        .into_iter()
        .map(|candidate| (edit_distance(word, candidate), candidate))
        .filter(|(distance, _)| *distance <= allowed)
        .min_by_key(|(distance, _)| *distance)
        .map(|(_, candidate)| candidate)
}

/// Levenshtein distance in characters.
fn edit_distance(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slip_finds_the_word_that_was_meant_and_nonsense_finds_none() {
        assert_eq!(nearest("amplitud", ["wavelength", "amplitude"]), Some("amplitude"));
        assert_eq!(nearest("zzz", ["wavelength", "amplitude"]), None);
        assert_eq!(edit_distance("kitten", "sitting"), 3);
    }

    #[test]
    fn line_and_column_count_from_one() {
        let mut sources = Sources::default();
        let source = sources.add("scene.toml", "a = 1\nbö = 2\n");
        assert_eq!(sources.line_column(Span { source, start: 6, end: 8 }), Some((2, 1)));
        assert_eq!(sources.line_column(Span { source, start: 10, end: 11 }), Some((2, 4)));
    }
}
