//! Provenance: how a file came to be, back to the ground.
//!
//! Only what decides the bytes is recorded: never time, host, thread count or an absolute path,
//! so that equal work gives equal files.

use crate::bytes::ending;
use crate::error::{Error, Result};
use serde::{Deserialize, Serialize};
use std::io::Read;
use std::path::Path;

/// How a file came to be.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Provenance {
    /// Stage that wrote it: `terrain`, `ecosim`, `quantize`, `plants`, `render`.
    pub stage: String,
    /// Version of the tool.
    pub version: String,
    /// Number that the stage raises when its results change.
    pub output_version: u32,
    /// Canonical parameters that the stage read.
    pub parameters: serde_json::Value,
    /// Root of all chance.
    pub seed: u64,
    /// The files it was made from.
    pub inputs: Vec<Parent>,
}

/// One input of a file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parent {
    /// Its name, as the scene wrote it.
    pub name: String,
    /// BLAKE3 of its bytes, in hexadecimal.
    pub blake3: String,
    /// Its own provenance, if it was one of ours.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub provenance: Option<Box<Provenance>>,
}

impl Provenance {
    /// The form that stands in files: one line of JSON.
    pub fn to_json(&self) -> String {
        // Strings, numbers and JSON values always serialize.
        serde_json::to_string(self).unwrap_or_default()
    }

    /// Reads the form that stands in files; `None` when it is not ours.
    pub fn from_json(text: &str) -> Option<Self> {
        serde_json::from_str(text).ok()
    }
}

/// The provenance of a file or terrain folder; `None` when it carries none.
///
/// # Errors
/// When the file cannot be read as what its ending says.
pub fn provenance(path: &Path) -> Result<Option<Provenance>> {
    if path.is_dir() {
        return provenance(&path.join(crate::terrain::ALTITUDE_FILE));
    }
    match ending(path).as_str() {
        "tif" | "tiff" => crate::geotiff::provenance(path),
        "parquet" => crate::table::parquet_provenance(path),
        "csv" => crate::table::csv_provenance(path),
        "toml" => crate::palette::provenance(path),
        "glb" => crate::plant::provenance(path),
        "exr" => crate::picture::provenance(path),
        "png" => crate::png::provenance(path),
        // Maps of other programs, which tell no story of ours.
        "geojson" | "gpkg" => Ok(None),
        other => {
            let hint = "known endings: tif, parquet, csv, toml, glb, exr, png";
            Err(Error::unsupported(path, format!("a file that ends in `.{other}`"), hint))
        }
    }
}

/// BLAKE3 of a file's bytes, in hexadecimal.
///
/// # Errors
/// When the file cannot be read.
pub fn hash_file(path: &Path) -> Result<String> {
    let mut file = std::fs::File::open(path).map_err(Error::io("open", path))?;
    let mut hasher = blake3::Hasher::new();
    let mut buffer = vec![0; 1 << 16];
    loop {
        let count = file.read(&mut buffer).map_err(Error::io("read", path))?;
        if count == 0 {
            return Ok(hasher.finalize().to_hex().to_string());
        }
        hasher.update(buffer.get(..count).unwrap_or_default());
    }
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;

    /// A provenance with a parent and awkward characters, for round trips.
    pub(crate) fn story() -> Provenance {
        let ground = Provenance {
            stage: "terrain".into(),
            version: "0.1.0".into(),
            output_version: 1,
            parameters: serde_json::json!({ "source": "dem <&> \"quoted\".tif", "b": [1, 2.5], "a": null }),
            seed: u64::MAX,
            inputs: Vec::new(),
        };
        Provenance {
            stage: "ecosim".into(),
            version: "0.1.0".into(),
            output_version: 3,
            parameters: serde_json::json!({ "years": 120, "note": "ümläut\n]]>" }),
            seed: 7,
            inputs: vec![Parent {
                name: "terrain".into(),
                blake3: "00ff".into(),
                provenance: Some(Box::new(ground)),
            }],
        }
    }

    #[test]
    fn provenance_survives_its_json_form() {
        assert_eq!(Provenance::from_json(&story().to_json()), Some(story()));
        assert_eq!(Provenance::from_json("{}"), None);
    }

    #[test]
    fn the_hash_of_nothing_is_the_published_one() {
        // BLAKE3 of the empty input, from the reference test vectors.
        let file = tempfile::NamedTempFile::new().unwrap();
        let expected = "af1349b9f5f9a1a6a0404dea36dcc9499bcb25c9adc112b7cc9a93cae41f3262";
        assert_eq!(hash_file(file.path()).unwrap(), expected);
    }
}
