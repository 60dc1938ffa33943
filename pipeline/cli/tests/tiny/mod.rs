//! A scene small enough to be made in a second or two, and the command to make it with.

use std::path::{Path, PathBuf};
use std::process::{Command, Output};

/// Sixty-four metres of ground with a pond, some aspen, grass and reeds, 32 x 18 pixels.
const SCENE: &str = r#"
seed = 3

[terrain]
source = "inputs/ground.asc"

[[terrain.op]]
op = "noise"
amplitude = 0.1
wavelength = 8.0

[[terrain.op]]
op = "lake"
at = [32.0, 32.0]
level = 9.2

[[ecosim.step]]
kind = "simulate"
species = ["aspen"]
years = 12
initial = 60

[[ecosim.step]]
kind = "halftone"
species = "coneflower"
density = "inputs/density.asc"
per_m2 = 0.2

[[ecosim.step]]
kind = "halftone"
species = "meadow"
arrange = "grid"
formula = "if(x > 20 and x < 30 and y < 12, 1, 0)"

[quantize]
representatives = 2
group_representatives = 1
group_variants = 2

[[view]]
name = "bank"
stand_at = [25.0, 2.0]
look_at = [32.0, 32.0]

[sky]
sun_elevation_deg = 40

[render]
view = "bank"
resolution = [32, 18]
samples = 2
"#;

/// A scene in a folder of its own, which is removed at the end.
pub struct Tiny {
    folder: tempfile::TempDir,
}

impl Tiny {
    /// Writes the scene and its inputs.
    pub fn new() -> Self {
        let tiny = Self { folder: tempfile::tempdir().expect("a folder for the test") };
        std::fs::create_dir_all(tiny.path("scene/inputs")).expect("a folder for inputs");
        tiny.write("scene/scene.toml", SCENE);
        let ground = |x: f64, y: f64| {
            let squared = ((x - 32.0).powi(2) + (y - 32.0).powi(2)) / 200.0;
            10.0 + 0.01 * y - 2.0 * (-squared).exp()
        };
        tiny.write("scene/inputs/ground.asc", &ascii(64, ground));
        tiny.write("scene/inputs/density.asc", &ascii(32, |x, _| if x > 40.0 { 1.0 } else { 0.0 }));
        tiny
    }

    /// A path in the test's folder.
    pub fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// Writes a file.
    pub fn write(&self, name: &str, text: &str) {
        std::fs::write(self.path(name), text).expect("a file of the test");
    }

    /// The text of a file.
    pub fn read(&self, name: &str) -> String {
        std::fs::read_to_string(self.path(name)).expect("a file of the test")
    }

    /// Replaces a part of the scene file, which must be there.
    pub fn edit(&self, from: &str, to: &str) {
        let text = self.read("scene/scene.toml");
        assert!(text.contains(from), "the scene has no `{from}`");
        self.write("scene/scene.toml", &text.replace(from, to));
    }

    /// Runs `weald` in the test's folder.
    pub fn weald(&self, arguments: &str) -> Answer {
        let mut command = Command::new(env!("CARGO_BIN_EXE_weald"));
        command.args(arguments.split_whitespace()).current_dir(self.folder.path());
        command.env("NO_COLOR", "1").env_remove("RAYON_NUM_THREADS");
        Answer::from(command.output().expect("weald starts"))
    }

    /// Runs `weald` and expects success.
    pub fn done(&self, arguments: &str) -> Answer {
        let answer = self.weald(arguments);
        assert_eq!(answer.code, 0, "weald {arguments}\n{}{}", answer.out, answer.err);
        answer
    }
}

/// An ESRI ASCII grid of `cells` a side over 64 m.
fn ascii(cells: usize, value: impl Fn(f64, f64) -> f64) -> String {
    let cell = 64.0 / cells as f64;
    let mut text =
        format!("ncols {cells}\nnrows {cells}\nxllcorner 0\nyllcorner 0\ncellsize {cell}\n");
    for row in 0..cells {
        let y = 64.0 - (row as f64 + 0.5) * cell;
        let line: Vec<String> = (0..cells)
            .map(|column| format!("{:.4}", value((column as f64 + 0.5) * cell, y)))
            .collect();
        text.push_str(&line.join(" "));
        text.push('\n');
    }
    text
}

/// What a command said.
pub struct Answer {
    /// Exit code; -1 when a signal ended it.
    pub code: i32,
    /// Stdout.
    pub out: String,
    /// Stderr.
    pub err: String,
}

impl From<Output> for Answer {
    fn from(output: Output) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        Self {
            code: output.status.code().unwrap_or(-1),
            out: text(&output.stdout),
            err: text(&output.stderr),
        }
    }
}

/// Every file below a folder, by its path, with its bytes.
pub fn bytes_below(folder: &Path) -> std::collections::BTreeMap<String, Vec<u8>> {
    let mut found = std::collections::BTreeMap::new();
    let mut open = vec![folder.to_path_buf()];
    while let Some(next) = open.pop() {
        for entry in std::fs::read_dir(&next).expect("a folder").flatten() {
            let path = entry.path();
            if path.is_dir() {
                open.push(path);
            } else {
                let name = path.strip_prefix(folder).expect("below").display().to_string();
                found.insert(name, std::fs::read(&path).expect("a file"));
            }
        }
    }
    found
}
