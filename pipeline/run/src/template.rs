//! A new scene to start from: `weald new`.

use crate::error::{Error, Result};
use std::path::{Path, PathBuf};

/// The scene file of a new scene, with every table explained where it stands.
const SCENE: &str = include_str!("template/scene.toml");

/// Cells a side of the ground that comes with a new scene.
const CELLS: usize = 100;
/// Side of a cell, m.
const CELL: f64 = 2.0;

/// Writes a scene into a new folder and returns its files.
///
/// With `elevation` the scene stands on that file, copied beside it; without, on a small ground
/// with a hollow, which is written as ESRI ASCII so that it can be looked at in an editor.
///
/// # Errors
/// The folder already holds a scene, the elevation model cannot be read, or the disk refuses.
pub fn new_scene(folder: &Path, elevation: Option<&Path>) -> Result<Vec<PathBuf>> {
    let scene = folder.join("scene.toml");
    if scene.exists() {
        return Err(Error::plain(
            format!("{} exists already", scene.display()),
            "give another folder, or remove it first: nothing is overwritten",
        ));
    }
    let inputs = folder.join("inputs");
    std::fs::create_dir_all(&inputs).map_err(|error| Error::system(&inputs, error))?;
    let (ground, text) = match elevation {
        Some(source) => given_ground(source, &inputs)?,
        None => {
            let path = inputs.join("ground.asc");
            write(&path, hollow().as_bytes())?;
            (path, SCENE.to_string())
        }
    };
    write(&scene, text.as_bytes())?;
    Ok(vec![scene, ground])
}

/// Copies the user's elevation model and fits the scene's places to its size.
fn given_ground(source: &Path, inputs: &Path) -> Result<(PathBuf, String)> {
    let raster = weald_formats::read_raster(source)?;
    let name = source.file_name().unwrap_or_default().to_string_lossy().into_owned();
    let path = inputs.join(&name);
    std::fs::copy(source, &path).map_err(|error| Error::system(&path, error))?;
    let frame = raster.grid.frame;
    let (width, height) = (frame.east() - frame.west, frame.north() - frame.south);
    let place = |east: f64, north: f64| format!("[{:.1}, {:.1}]", east * width, north * height);
    let text = SCENE
        .replace("inputs/ground.asc", &format!("inputs/{name}"))
        .replace("stand_at = [60.0, 40.0]", &format!("stand_at = {}", place(0.3, 0.2)))
        .replace("look_at = [100.0, 100.0]", &format!("look_at = {}", place(0.5, 0.5)));
    // The pond belongs to the ground that comes with the template.
    let text = without(&text, "[[terrain.op]] # pond", "[terrain.water]");
    let text = text.replace(
        "disc = [75.0, 65.0, 15.0]",
        &format!("disc = [{:.1}, {:.1}, 15.0]", 0.36 * width, 0.3 * height),
    );
    Ok((path, text))
}

/// The text without the part from `start` up to `end`.
fn without(text: &str, start: &str, end: &str) -> String {
    match text.find(start).zip(text.find(end)) {
        Some((start, end)) => format!("{}{}", &text[..start], &text[end..]),
        None => text.to_string(),
    }
}

/// A gentle slope with a round hollow in the middle, as an ESRI ASCII grid.
fn hollow() -> String {
    use std::fmt::Write;
    let mut text =
        format!("ncols {CELLS}\nnrows {CELLS}\nxllcorner 0\nyllcorner 0\ncellsize {CELL}\n");
    for row in 0..CELLS {
        for column in 0..CELLS {
            let metres = |index: usize| (index as f64 + 0.5) * CELL;
            let (x, y) = (metres(column), metres(CELLS - 1 - row));
            let altitude = altitude(x, y);
            let space = if column == 0 { "" } else { " " };
            // Writing to a text cannot fail.
            let _ = write!(text, "{space}{altitude:.3}");
        }
        text.push('\n');
    }
    text
}

/// The template's ground, m: a hollow 3 m deep and 70 m wide in a slope of 1 %.
fn altitude(x: f64, y: f64) -> f64 {
    let middle = CELLS as f64 * CELL / 2.0;
    let squared = ((x - middle).powi(2) + (y - middle).powi(2)) / (35.0 * 35.0);
    100.0 + 0.01 * y - 3.0 * libm::exp(-squared)
}

fn write(path: &Path, bytes: &[u8]) -> Result<()> {
    use std::io::Write;
    weald_formats::write_atomically(path, |file| Ok(file.write_all(bytes)?))?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_hollow_is_lower_than_the_template_lake() {
        // The lake of the template stands at 99.6 m.
        assert!(altitude(100.0, 100.0) < 99.0);
        assert!(altitude(60.0, 40.0) > 99.6);
    }

    #[test]
    fn the_ground_has_a_row_a_line() {
        let text = hollow();
        assert_eq!(text.lines().count(), 5 + CELLS);
        assert!(text.lines().skip(5).all(|line| line.split(' ').count() == CELLS));
    }
}
