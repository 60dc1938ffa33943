//! What can go wrong in a run, said so that the person who must act knows what to do.

use std::path::{Path, PathBuf};
use std::sync::Arc;
use weald_contract::{Problem, Problems, Sources};

/// Why a command did not do its work.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// What the user wrote is wrong: every mistake found, each with its place in `sources`.
    #[error("{}", first_and_rest(problems, sources))]
    Wrong {
        /// The texts that the problems' spans refer to.
        sources: Arc<Sources>,
        /// The mistakes; at least one.
        problems: Problems,
    },
    /// A file of ours, or one that a scene names, cannot be read or written.
    #[error(transparent)]
    File(#[from] weald_formats::Error),
    /// The system refused.
    #[error("{}: {source}", path.display())]
    System {
        /// File or folder concerned.
        path: PathBuf,
        /// The system's answer.
        source: std::io::Error,
    },
    /// A stage failed for a reason that is in no text.
    #[error("{stage}: {message}")]
    Stage {
        /// Word of the stage.
        stage: &'static str,
        /// What happened.
        message: String,
    },
    /// The user asked to stop.
    #[error("stopped{}", if *saved { "; finished stages are kept, and the next run goes on from there" } else { "" })]
    Stopped {
        /// Whether something was finished that the next run will not repeat.
        saved: bool,
    },
    /// The user asked to stop in the middle of a simulation, whose state is kept.
    #[error(
        "stopped after year {year}; {} holds all of it: the same command goes on from there",
        file.display()
    )]
    Paused {
        /// The checkpoint.
        file: PathBuf,
        /// Years simulated so far.
        year: u32,
    },
}

/// Result of this crate's functions.
pub type Result<T, E = Error> = std::result::Result<T, E>;

impl Error {
    /// One problem with its place in a text.
    pub fn wrong(sources: &Sources, problem: Problem) -> Self {
        Self::Wrong { sources: Arc::new(sources.clone()), problems: vec![problem] }
    }

    /// A problem of the command line or of a file that has no text to point into.
    pub fn plain(message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::wrong(&Sources::default(), Problem::new(message).hint(hint))
    }

    /// The system's refusal, with the path it concerns.
    pub fn system(path: &Path, source: std::io::Error) -> Self {
        Self::System { path: path.to_path_buf(), source }
    }

    /// The command's exit code, as the manual lists them.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Stopped { saved: true } | Self::Paused { .. } => 75,
            _ => 2,
        }
    }
}

/// `Ok` when nothing is wrong, else all that is.
pub fn none_wrong(sources: &Sources, problems: Problems) -> Result<()> {
    if problems.is_empty() {
        return Ok(());
    }
    Err(Error::Wrong { sources: Arc::new(sources.clone()), problems })
}

/// One line for logs; the command prints each problem with its text instead.
fn first_and_rest(problems: &Problems, sources: &Sources) -> String {
    let Some(first) = problems.first() else { return "nothing is wrong".into() };
    let place = first.span.and_then(|span| {
        let (line, column) = sources.line_column(span)?;
        Some(format!("{}:{line}:{column}: ", sources.get(span.source)?.name))
    });
    let more = match problems.len() {
        1 => String::new(),
        n => format!(" (and {} more)", n - 1),
    };
    format!("{}{first}{more}", place.unwrap_or_default())
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Span;

    #[test]
    fn a_line_names_file_line_column_and_what_would_be_right() {
        let mut sources = Sources::default();
        let source = sources.add("scene.toml", "seed = 1\nsede = 2\n");
        let span = Span { source, start: 9, end: 13 };
        let error = Error::wrong(
            &sources,
            Problem::at(span, "unknown field `sede`").hint("did you mean `seed`?"),
        );
        assert_eq!(error.to_string(), "scene.toml:2:1: unknown field `sede`; did you mean `seed`?");
        assert_eq!(error.exit_code(), 2);
        assert_eq!(Error::Stopped { saved: true }.exit_code(), 75);
        assert_eq!(Error::Stopped { saved: false }.exit_code(), 2);
    }
}
