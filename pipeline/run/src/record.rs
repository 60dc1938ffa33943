//! What a finished stage leaves for the next run: `OUT/.weald/STAGE.json`.
//!
//! A record is written last, after every output has its final name. A run that was killed leaves
//! an old record or none, and the stage is simply made again.

use crate::error::{Error, Result};
use crate::recipe::{Recipe, Stage};
use serde::{Deserialize, Serialize};
use std::path::{Path, PathBuf};

/// A file that a stage made.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Output {
    /// Path below the output folder, with `/` between its parts.
    pub path: String,
    /// Length.
    pub bytes: u64,
    /// BLAKE3 of its bytes.
    pub blake3: String,
}

/// The record of a finished stage.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Record {
    /// Key of `recipe`.
    pub key: String,
    /// What the stage was made from.
    pub recipe: Recipe,
    /// The files it made.
    pub outputs: Vec<Output>,
    /// Numbers worth knowing: plants, triangles, rays. No times, which would differ between runs.
    pub report: serde_json::Value,
}

/// Name of a stage's record; a draft's picture has its own, beside the full one.
pub fn record_path(out: &Path, stage: Stage, is_draft: bool) -> PathBuf {
    let draft = if is_draft && stage == Stage::Render { "-draft" } else { "" };
    out.join(".weald").join(format!("{}{draft}.json", stage.word()))
}

impl Record {
    /// The record of an earlier run, if there is a readable one.
    ///
    /// A damaged record counts as none: the stage runs again.
    pub fn read(path: &Path) -> Option<Record> {
        serde_json::from_slice(&std::fs::read(path).ok()?).ok()
    }

    /// Writes the record under its final name at once.
    ///
    /// # Errors
    /// The folder cannot be made or written.
    pub fn write(&self, path: &Path) -> Result<()> {
        use std::io::Write;
        let folder = path.parent().unwrap_or(Path::new("."));
        std::fs::create_dir_all(folder).map_err(|error| Error::system(folder, error))?;
        let text = serde_json::to_string_pretty(self).expect("a record holds only plain values");
        weald_formats::write_atomically(path, |file| {
            file.write_all(text.as_bytes())?;
            Ok(file.write_all(b"\n")?)
        })?;
        Ok(())
    }
}

impl Output {
    /// Measures a file that was just written.
    ///
    /// # Errors
    /// The file cannot be read.
    pub fn of(out: &Path, path: &str) -> Result<Output> {
        let full = out.join(path);
        let bytes = std::fs::metadata(&full).map_err(|error| Error::system(&full, error))?.len();
        Ok(Output { path: path.into(), bytes, blake3: weald_formats::hash_file(&full)? })
    }

    /// What is wrong with the file on disk, if something is: absent, or other bytes.
    ///
    /// The length is compared first; only files of the right length are hashed (BLAKE3 reads
    /// faster than disks do).
    pub fn complaint(&self, out: &Path) -> Option<String> {
        let full = out.join(&self.path);
        match std::fs::metadata(&full) {
            Err(_) => Some(format!("{} is missing", self.path)),
            Ok(data) if data.len() != self.bytes => Some(format!("{} was changed", self.path)),
            Ok(_) => match weald_formats::hash_file(&full) {
                Ok(hash) if hash == self.blake3 => None,
                Ok(_) => Some(format!("{} was changed", self.path)),
                Err(_) => Some(format!("{} cannot be read", self.path)),
            },
        }
    }
}
