//! What can be wrong with a file, said so that its owner knows what to do.

use std::path::{Path, PathBuf};

/// A file that could not be read or written.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The system refused.
    #[error("cannot {action} {}: {source}", path.display())]
    Io {
        /// What was tried: "open", "read", "create".
        action: &'static str,
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Writing stopped; the file does not exist under its final name.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file that was to be.
        path: PathBuf,
        /// Why not.
        source: Box<dyn std::error::Error + Send + Sync>,
    },
    /// The file is damaged or does not hold what its place requires.
    #[error("{}: {message}{}", path.display(), after_semicolon(hint))]
    Invalid {
        /// The file.
        path: PathBuf,
        /// What is wrong.
        message: String,
        /// What would be right; may be empty.
        hint: String,
    },
    /// One cell of a table is wrong.
    #[error("{}, row {row}, column `{column}`: {message}", path.display())]
    Cell {
        /// The file.
        path: PathBuf,
        /// Row, counted from 1, the header not counted.
        row: u64,
        /// Name of the column.
        column: String,
        /// What is wrong and what would be right.
        message: String,
    },
    /// The file may be fine, but we do not read its kind.
    #[error("{}: {message} is not supported{}", path.display(), after_semicolon(hint))]
    Unsupported {
        /// The file.
        path: PathBuf,
        /// What is not supported.
        message: String,
        /// What is; may be empty.
        hint: String,
    },
}

/// Result of reading or writing a file.
pub type Result<T> = std::result::Result<T, Error>;

fn after_semicolon(hint: &str) -> String {
    if hint.is_empty() { String::new() } else { format!("; {hint}") }
}

impl Error {
    /// A file that is not what it should be.
    pub fn invalid(path: &Path, message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Invalid { path: path.into(), message: message.into(), hint: hint.into() }
    }

    /// A file of a kind that is not read.
    pub fn unsupported(path: &Path, message: impl Into<String>, hint: impl Into<String>) -> Self {
        Self::Unsupported { path: path.into(), message: message.into(), hint: hint.into() }
    }

    /// Adds the path to a system error.
    pub fn io(action: &'static str, path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { action, path, source }
    }

    /// The file that the error is about.
    pub fn path(&self) -> &Path {
        match self {
            Self::Io { path, .. }
            | Self::Write { path, .. }
            | Self::Invalid { path, .. }
            | Self::Cell { path, .. }
            | Self::Unsupported { path, .. } => path,
        }
    }
}
