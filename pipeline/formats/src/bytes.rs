//! Reading whole files within a bound.

use crate::error::{Error, Result};
use std::io::Read;
use std::path::Path;

/// Longest file that is read into memory at once, 4 GiB: plant tables of ~60 million rows and
/// 16k × 16k pictures fit; a mistaken path to a disk image does not.
pub(crate) const MAX_FILE_BYTES: u64 = 4 << 30;

/// Reads a file whole, unless it is longer than `limit`.
pub(crate) fn read_bounded(path: &Path, limit: u64) -> Result<Vec<u8>> {
    let file = std::fs::File::open(path).map_err(Error::io("open", path))?;
    let found = file.metadata().map_err(Error::io("look at", path))?;
    if found.is_dir() {
        return Err(Error::invalid(path, "this is a folder", "give the name of a file"));
    }
    if found.len() > limit {
        let message = format!("the file has {} bytes", found.len());
        return Err(Error::invalid(path, message, format!("at most {limit} are read")));
    }
    let mut bytes = Vec::new();
    // The length above may be wrong for pipes and growing files: `take` holds the bound.
    file.take(limit + 1).read_to_end(&mut bytes).map_err(Error::io("read", path))?;
    if bytes.len() as u64 > limit {
        return Err(Error::invalid(path, "the file is too long", format!("at most {limit} bytes")));
    }
    Ok(bytes)
}

/// Reads a text file in UTF-8, without a byte order mark.
pub(crate) fn read_text(path: &Path, limit: u64) -> Result<String> {
    text(path, read_bounded(path, limit)?)
}

/// Bytes as UTF-8 text, without a byte order mark.
pub(crate) fn text(path: &Path, bytes: Vec<u8>) -> Result<String> {
    let text = String::from_utf8(bytes)
        .map_err(|_| Error::invalid(path, "this is not a text in UTF-8", "save it as UTF-8"))?;
    Ok(text.strip_prefix('\u{feff}').map(str::to_string).unwrap_or(text))
}

/// The ending of a file's name in lower case, without the dot.
pub(crate) fn ending(path: &Path) -> String {
    path.extension().map(|ending| ending.to_string_lossy().to_lowercase()).unwrap_or_default()
}
