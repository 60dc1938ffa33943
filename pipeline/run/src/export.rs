//! Our files for programs that want them otherwise: `weald export`.

mod mitsuba;

use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use crate::make::{self, Assembled, Made, RenderPaths};
use crate::recipe::Stage;
use crate::scene::Scene;
use std::path::Path;
use weald_contract::{Progress, Projection};
use weald_formats::Provenance;

weald_contract::words! {
    /// A renderer that scenes are written for.
    pub enum Renderer {
        /// Mitsuba 3.
        Mitsuba = "mitsuba",
    }
}

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
            let hint = match kind {
                FileKind::Scene => "`--to mitsuba -o FOLDER` writes a scene for another renderer",
                _ => "export takes plant models (.glb), tables (.parquet, .csv) and scenes",
            };
            let what =
                format!("{} is {}, which has no other form", path.display(), kind.describe());
            return Err(Error::plain(what, hint));
        }
    }
    Ok(())
}

/// Writes a scene, from the files of a run, for another renderer into a folder.
///
/// # Errors
/// The view is one that the renderer lacks, a file is damaged, or the disk refuses.
pub fn scene(
    scene: &Scene,
    paths: &RenderPaths,
    renderer: Renderer,
    folder: &Path,
    progress: &dyn Progress,
) -> Result<Made> {
    let view = scene.wanted_view()?;
    if view.projection == Projection::Panorama {
        let what =
            format!("the view `{}` is a panorama, for which Mitsuba has no camera", view.name);
        return Err(Error::plain(what, "`--view NAME` takes another one"));
    }
    if folder.is_file() {
        let what = format!("{} is a file", folder.display());
        return Err(Error::plain(what, "a scene is a folder of files: `-o FOLDER`"));
    }
    let Assembled { built, view, config, inputs, .. } =
        make::assemble(scene, paths, false, progress)?;
    let portable = built.portable(&config).map_err(|error| Error::Stage {
        stage: Stage::Render.word(),
        message: error.to_string(),
    })?;
    let story = Provenance {
        stage: "export".into(),
        ..make::provenance(scene, Stage::Render, false, inputs)
    };
    let eye = built.eye(view, &config);
    let mitsuba::Written { files, report } = match renderer {
        Renderer::Mitsuba => mitsuba::write(&portable, &eye, &config, folder, &story, progress)?,
    };
    let words = match portable.haze() {
        0.0 => String::new(),
        _ => {
            "the haze of the air is left out; `--set sky.haze=0` renders without it here too".into()
        }
    };
    Ok(Made { files, report, words })
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
