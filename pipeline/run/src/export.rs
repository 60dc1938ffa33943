//! Our files for programs that want them otherwise: `weald export`.

use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use std::path::Path;
use weald_formats::Provenance;

/// How to export.
#[derive(Clone, Copy, Debug, Default)]
pub struct Options {
    /// Write every leaf as triangles of its own, for viewers that know no instancing.
    pub flatten: bool,
}

/// Copies a file into another form: a plant flattened, a table as CSV or Parquet.
///
/// # Errors
/// The file is damaged or of a kind that has no other form, or the disk refuses.
pub fn export(path: &Path, to: &Path, options: Options) -> Result<()> {
    let story = weald_formats::provenance(path).ok().flatten();
    let story = story.unwrap_or_else(|| foreign(path));
    let kind = files::kind(path)?;
    crate::make::make_folder_of(to)?;
    match kind {
        FileKind::Plant => {
            files::must_end(to, "glb")?;
            let model = weald_formats::read_plant(path)?;
            let model = if options.flatten { weald_formats::flatten(&model) } else { model };
            weald_formats::write_plant(to, &model, &story)?;
        }
        FileKind::Population => {
            let population = weald_formats::read_population(path)?;
            weald_formats::write_population(to, &population, &story)?;
        }
        FileKind::Table | FileKind::Instances => {
            weald_formats::write_table(to, &weald_formats::read_table(path)?, &story)?;
        }
        kind => {
            return Err(Error::plain(
                format!("{} is {}, which has no other form", path.display(), kind.describe()),
                "export takes plant models (.glb) and tables (.parquet, .csv)",
            ));
        }
    }
    Ok(())
}

/// The story of a file that another program made.
pub(crate) fn foreign(path: &Path) -> Provenance {
    let name = path.file_name().unwrap_or_default().to_string_lossy();
    Provenance {
        stage: "export".into(),
        version: env!("CARGO_PKG_VERSION").into(),
        output_version: 0,
        parameters: serde_json::json!({ "file": name }),
        seed: 0,
        inputs: Vec::new(),
    }
}
