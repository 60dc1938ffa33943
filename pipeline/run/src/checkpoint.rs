//! Checkpoints: a simulation that was stopped goes on when the same command is given again.
//!
//! A checkpoint file says first what it was made from, as a recipe, so that it goes on with nothing
//! else, and ends with the hash of all before. `docs/formats.md` gives its layout.

use crate::error::{Error, Result};
use crate::recipe::{HashedInput, Recipe, Stage};
use serde::{Deserialize, Serialize};
use std::io::{Read, Write};
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};
use weald_contract::Progress;
use weald_ecosim::{CHECKPOINT_VERSION, Checkpoint, Moment, Next, Watch};
use weald_formats::{Error as FileError, Provenance};

/// The first bytes of a checkpoint. The first of all is no letter, so that nobody takes it for text.
const MAGIC: [u8; 8] = *b"\x8aWEALDCK";
/// Bytes of the hash at the end.
const HASH: usize = 32;
/// Longest description that is read, bytes: parameters of a scene take some thousand.
const MOST_HEADER: usize = 1 << 26;
/// Part of the time that saving may take: the next time comes so many times later than it took.
const PATIENCE: u32 = 20;

/// How a growth is saved as it goes.
#[derive(Clone, Debug)]
pub struct Saving {
    /// The checkpoint's file.
    pub file: PathBuf,
    /// Time from one save to the next, at least.
    pub every: Duration,
    /// Simulated years after which the work is saved and stops.
    pub stop_after: Option<u32>,
    /// Whether a file of other work is an error, or is replaced.
    pub is_strict: bool,
}

/// What a checkpoint says of itself.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Header {
    /// All that the plants depend on.
    pub recipe: Recipe,
    /// Years simulated so far.
    pub year: u32,
}

impl Saving {
    /// Reads the checkpoint to go on from, if one is there.
    ///
    /// # Errors
    /// The file is damaged, or of other work; then, unless [`Saving::is_strict`], it counts as none.
    pub(crate) fn open(&self, recipe: &Recipe) -> Result<Option<Checkpoint>> {
        if !self.file.exists() {
            return Ok(None);
        }
        match self.read(recipe) {
            Ok(checkpoint) => Ok(Some(checkpoint)),
            Err(error) if self.is_strict => Err(error),
            Err(_) => Ok(None),
        }
    }

    fn read(&self, recipe: &Recipe) -> Result<Checkpoint> {
        let wrong = |message: String, hint: &str| FileError::invalid(&self.file, message, hint);
        let bytes = read_whole(&self.file)?;
        let (header, state) = header(&self.file, &bytes)?;
        let reasons = recipe.differences(&header.recipe);
        if !reasons.is_empty() || *recipe != header.recipe {
            let reasons =
                if reasons.is_empty() { "an input is gone".into() } else { reasons.join(", ") };
            let message = format!("this checkpoint is of other work: {reasons}");
            return Err(wrong(message, "change it back, or remove the file to begin anew").into());
        }
        let (state, hash) = state.split_at(state.len() - HASH);
        let checked = &bytes[..bytes.len() - HASH];
        if blake3::hash(checked).as_bytes() != hash {
            return Err(damaged(&self.file).into());
        }
        Checkpoint::read(state)
            .map_err(|error| wrong(error.to_string(), "remove the file to begin anew").into())
    }

    /// Removes the file when the work is done.
    pub(crate) fn close(&self) -> Result<()> {
        match std::fs::remove_file(&self.file) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => {
                Err(Error::system(&self.file, error))
            }
            _ => Ok(()),
        }
    }
}

/// What a checkpoint says of itself, when a file is one.
///
/// # Errors
/// It cannot be read, or is a damaged checkpoint.
pub fn describe(path: &Path) -> Result<Option<Header>> {
    if !is_checkpoint(path) {
        return Ok(None);
    }
    let bytes = read_whole(path)?;
    Ok(Some(header(path, &bytes)?.0))
}

/// Whether a file begins as a checkpoint does.
pub(crate) fn is_checkpoint(path: &Path) -> bool {
    let mut first = [0; MAGIC.len()];
    let read = std::fs::File::open(path).and_then(|mut file| file.read_exact(&mut first));
    read.is_ok() && first == MAGIC
}

fn damaged(path: &Path) -> FileError {
    let hint = "remove it to begin anew";
    FileError::invalid(path, "this checkpoint is damaged or cut off", hint)
}

fn read_whole(path: &Path) -> Result<Vec<u8>> {
    if !is_checkpoint(path) {
        let hint = "name another file: this one would be replaced";
        return Err(FileError::invalid(path, "this is no checkpoint", hint).into());
    }
    std::fs::read(path).map_err(|error| Error::system(path, error))
}

/// Parts the bytes into what they say of themselves, and the state with the hash.
fn header<'a>(path: &Path, bytes: &'a [u8]) -> Result<(Header, &'a [u8])> {
    let cut = || damaged(path);
    let rest = bytes.get(MAGIC.len()..).ok_or_else(cut)?;
    let (version, rest) = rest.split_first_chunk().ok_or_else(cut)?;
    let version = u32::from_le_bytes(*version);
    if version != CHECKPOINT_VERSION {
        let message = format!("this checkpoint is of version {version}");
        let hint = format!(
            "this program goes on from version {CHECKPOINT_VERSION}; remove the file to begin anew"
        );
        return Err(FileError::invalid(path, message, hint).into());
    }
    let (length, rest) = rest.split_first_chunk().ok_or_else(cut)?;
    let length = u32::from_le_bytes(*length) as usize;
    let parts = rest.split_at_checked(length).filter(|_| length <= MOST_HEADER);
    let (text, state) = parts.ok_or_else(cut)?;
    let header = serde_json::from_slice(text).map_err(|_| damaged(path))?;
    if state.len() < HASH {
        return Err(cut().into());
    }
    Ok((header, state))
}

/// The recipe of a growth that stands on files rather than on other stages.
pub(crate) fn recipe(
    story: &Provenance,
    inputs: Vec<HashedInput>,
    terrain: &Path,
    start: Option<&Path>,
) -> Result<Recipe> {
    let mut inputs = inputs;
    for (name, path) in layers(terrain, "terrain")? {
        inputs.push(HashedInput { name, blake3: weald_formats::hash_file(&path)? });
    }
    if let Some(start) = start {
        let blake3 = weald_formats::hash_file(start)?;
        inputs.push(HashedInput { name: "the start".into(), blake3 });
    }
    Ok(Recipe {
        stage: Stage::Ecosim,
        output_version: story.output_version,
        seed: story.seed,
        parameters: story.parameters.clone(),
        inputs,
        reads: Vec::new(),
    })
}

/// The files of a terrain with their names below it, finer patches included.
fn layers(folder: &Path, name: &str) -> Result<Vec<(String, PathBuf)>> {
    let mut found = Vec::new();
    let entries = std::fs::read_dir(folder).map_err(|error| Error::system(folder, error))?;
    for path in entries.flatten().map(|entry| entry.path()) {
        let own = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let name = format!("{name}/{own}");
        if path.is_dir() && own.starts_with("detail-") {
            found.extend(layers(&path, &name)?);
        } else if path.extension().is_some_and(|ending| ending == "tif") {
            found.push((name, path));
        }
    }
    found.sort();
    Ok(found)
}

/// Saves every so often, and when the user asks to stop.
pub(crate) struct Keeper<'a> {
    saving: &'a Saving,
    recipe: &'a Recipe,
    due: Instant,
    years_left: Option<u32>,
    /// The year of the state that the file holds.
    pub(crate) saved: Option<u32>,
}

impl<'a> Keeper<'a> {
    /// Begins; `saved` is the year of the state that the file holds already.
    pub(crate) fn new(saving: &'a Saving, recipe: &'a Recipe, saved: Option<u32>) -> Self {
        let (due, years_left) = (Instant::now() + saving.every, saving.stop_after);
        Self { saving, recipe, due, years_left, saved }
    }

    fn write(&self, moment: &Moment<'_>) -> weald_formats::Result<()> {
        let header = Header { recipe: self.recipe.clone(), year: moment.year() };
        weald_formats::write_atomically(&self.saving.file, |file| {
            let mut out = Hashing { file, hasher: blake3::Hasher::new() };
            let text = serde_json::to_vec(&header)?;
            out.write_all(&MAGIC)?;
            out.write_all(&CHECKPOINT_VERSION.to_le_bytes())?;
            out.write_all(&u32::try_from(text.len())?.to_le_bytes())?;
            out.write_all(&text)?;
            moment.write(&mut std::io::BufWriter::with_capacity(1 << 20, &mut out))?;
            let hash = out.hasher.finalize();
            Ok(out.file.write_all(hash.as_bytes())?)
        })
    }
}

impl Watch for Keeper<'_> {
    fn next(&mut self, years: u32) -> Next {
        if let Some(left) = &mut self.years_left {
            *left = left.saturating_sub(years);
            if *left == 0 {
                return Next::Stop;
            }
        }
        if Instant::now() >= self.due { Next::Save } else { Next::GoOn }
    }

    fn save(&mut self, moment: &Moment<'_>) -> std::io::Result<()> {
        let began = Instant::now();
        self.write(moment).map_err(std::io::Error::other)?;
        self.saved = Some(moment.year());
        self.due = Instant::now() + self.saving.every.max(began.elapsed() * PATIENCE);
        Ok(())
    }
}

/// Hashes what goes through.
struct Hashing<W> {
    file: W,
    hasher: blake3::Hasher,
}

impl<W: Write> Write for Hashing<W> {
    fn write(&mut self, bytes: &[u8]) -> std::io::Result<usize> {
        let count = self.file.write(bytes)?;
        self.hasher.update(&bytes[..count]);
        Ok(count)
    }

    fn flush(&mut self) -> std::io::Result<()> {
        self.file.flush()
    }
}

/// Tells that the work goes on from a checkpoint.
pub(crate) fn tell(saving: &Saving, checkpoint: &Checkpoint, progress: &dyn Progress) {
    progress.say(&format!("goes on after year {} of {}", checkpoint.year(), saving.file.display()));
}
