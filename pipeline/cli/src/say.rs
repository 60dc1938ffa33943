//! Words on stdout and stderr, whose other end may be full or gone.
//!
//! The `print` macros of the standard library panic there; a command must not.

use std::io::{ErrorKind, Write};
use std::path::Path;
use std::sync::OnceLock;
use weald_run::{Error, Result};

/// Why stdout took no more, if it did not.
static REFUSED: OnceLock<std::io::Error> = OnceLock::new();

/// Prints on stdout. A reader that went away, as `head` does, is no error of ours; any other
/// refusal is kept for [`heard`].
pub fn out(text: &str) {
    let mut stdout = std::io::stdout().lock();
    match stdout.write_all(text.as_bytes()).and_then(|()| stdout.flush()) {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            // Only the first reason is told.
            let _ = REFUSED.set(error);
        }
        _ => {}
    }
}

/// Prints on stderr; where that fails there is nobody left to tell.
pub fn aside(text: &str) {
    let _ = std::io::stderr().write_all(text.as_bytes());
}

/// `Ok` when all that was printed on stdout arrived.
///
/// # Errors
/// A report was cut short, as on a full disk: a script must not take it for whole.
pub fn heard() -> Result<()> {
    match REFUSED.get() {
        Some(error) => {
            let copy = std::io::Error::new(error.kind(), error.to_string());
            Err(Error::system(Path::new("cannot write to stdout"), copy))
        }
        None => Ok(()),
    }
}
