//! Something to paint a density on: `weald canvas`.

use crate::error::{Error, Result};
use crate::files;
use crate::make;
use crate::preview::{MapScale, Sketch, draw_relief_on, draw_view};
use crate::recipe::Stage;
use crate::scene::Scene;
use serde::Serialize;
use std::path::{Path, PathBuf};
use weald_contract::{Frame, Layers, Progress};

/// The files of a canvas.
#[derive(Clone, Debug, Serialize)]
pub struct Canvas {
    /// An empty density: black, a whole number of pixels to a cell.
    pub density: PathBuf,
    /// Shaded relief with contours, water and views, of the same shape, to lay under it.
    pub guide: PathBuf,
    /// Pixels of the density across and down.
    pub size: [usize; 2],
    /// Whether a density stood there already and was left alone.
    pub is_kept: bool,
}

/// Fewest pixels along the longer side: a soft brush needs some to be soft in.
const LEAST_SIDE: usize = 1024;

/// Writes an empty density image of the terrain's shape, and a map of the same size to paint over.
///
/// An existing density is left alone, for someone may have painted on it.
///
/// # Errors
/// The terrain is damaged, or the disk refuses.
pub fn write(scene: &Scene, terrain: &Path, density: &Path) -> Result<Canvas> {
    files::must_end(density, "png")?;
    let layers = weald_formats::read_terrain(terrain)?;
    let story = make::provenance(scene, Stage::Terrain, false, Vec::new());
    make::make_folder_of(density)?;
    let is_kept = density.exists();
    let painted = is_kept.then(|| weald_formats::read_image(density).ok()).flatten();
    let side = painted.map_or(usual_side(&layers.frame), |image| image.width.max(image.height));
    let map = MapScale::with_side(layers.frame, side);
    let size = map.size();
    if !is_kept {
        let empty = Sketch::filled(size[0], size[1], [0; 3]);
        weald_formats::write_png(density, size[0], size[1], &empty.rgb, &story)?;
    }
    let guide = guide_path(density);
    let map = guide_map(scene, &layers, &map);
    weald_formats::write_png(&guide, map.width, map.height, &map.rgb, &story)?;
    Ok(Canvas { density: density.to_path_buf(), guide, size, is_kept })
}

/// `nettle.png` is painted over `nettle.guide.png`.
fn guide_path(density: &Path) -> PathBuf {
    density.with_extension("guide.png")
}

/// The relief with every view of the scene drawn in.
fn guide_map(scene: &Scene, layers: &Layers, map: &MapScale) -> Sketch {
    let mut relief = draw_relief_on(layers, map);
    for view in &scene.tables.view {
        draw_view(&mut relief, map, view);
    }
    relief
}

/// Pixels along the longer side: so many to each cell that there are enough.
fn usual_side(frame: &Frame) -> usize {
    let cells = frame.width.max(frame.height).max(1);
    cells * LEAST_SIDE.div_ceil(cells)
}

/// The same where no run has left a terrain: it is made in a folder that is then forgotten.
///
/// # Errors
/// See [`make::terrain`] and [`write`].
pub fn write_with_new_terrain(
    scene: &Scene,
    density: &Path,
    progress: &dyn Progress,
) -> Result<Canvas> {
    let folder = tempfile::tempdir().map_err(|error| Error::system(density, error))?;
    let terrain = folder.path().join("terrain");
    let story = make::provenance(scene, Stage::Terrain, false, Vec::new());
    make::terrain(scene, &terrain, &story, progress)?;
    write(scene, &terrain, density)
}
