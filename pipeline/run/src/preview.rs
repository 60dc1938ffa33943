//! A picture of any of our files, to look at while working.
//!
//! Shaded relief with water and contours for terrains, dots in the colours of their species for
//! populations, a contact sheet for plant models, the tone-mapped picture for renderings.

mod dots;
mod models;
mod relief;
mod sheet;
mod sketch;
mod stands;

pub use dots::{Painted, draw_dots};
pub use models::{draw_errors, draw_models};
pub use relief::{
    MapScale, colors_by_name, draw_population, draw_relief, draw_relief_on, draw_view,
};
pub use sheet::{contact_sheet, schematic_sheet};
pub use sketch::Sketch;
pub use stands::draw_stand;

use crate::error::{Error, Result};
use crate::files::{self, FileKind};
use std::path::Path;
use weald_contract::PlantModel;

/// Draws any of our files, for `weald preview`.
///
/// # Errors
/// The file cannot be read, or is of a kind that has no picture.
pub fn of_file(path: &Path, terrain: Option<&Path>) -> Result<Sketch> {
    match files::kind(path)? {
        FileKind::Terrain => {
            Ok(draw_relief(&weald_formats::read_terrain(&files::terrain_folder(path))?))
        }
        FileKind::Population => {
            let population = weald_formats::read_population(path)?;
            let terrain = terrain.map(weald_formats::read_terrain).transpose()?;
            Ok(draw_population(&population, terrain.as_ref(), &files::colors_of(&population, path)))
        }
        FileKind::Plant => {
            let model = weald_formats::read_plant(path)?;
            Ok(contact_sheet(&[(model.name.clone(), &model)], 480))
        }
        FileKind::Plants => {
            let models = plants_in(path)?;
            let named: Vec<_> = models.iter().map(|model| (model.name.clone(), model)).collect();
            Ok(contact_sheet(&named, 200))
        }
        FileKind::Picture => {
            let picture = weald_formats::read_picture(path)?;
            let rgb = weald_render::tone_map(&picture, 0.0);
            Ok(Sketch { width: picture.width, height: picture.height, rgb })
        }
        FileKind::Raster => Ok(relief::draw_values(&weald_formats::read_raster(path)?.grid)),
        FileKind::Png => {
            let preview = weald_formats::read_png(path)?;
            Ok(Sketch { width: preview.width, height: preview.height, rgb: preview.rgb })
        }
        kind => Err(Error::plain(
            format!("{} is {}, which has no picture", path.display(), kind.describe()),
            "preview takes terrains, populations, plants (.glb), rasters and pictures",
        )),
    }
}

/// All models of a folder, by name of file.
fn plants_in(folder: &Path) -> Result<Vec<PlantModel>> {
    let files = files::with_ending(folder, "glb")?;
    files.iter().map(|file| Ok(weald_formats::read_plant(file)?)).collect()
}

/// Draws a file and writes the PNG, which carries the file's own story.
///
/// # Errors
/// See [`of_file`]; or the disk refuses.
pub fn write(path: &Path, terrain: Option<&Path>, to: &Path) -> Result<()> {
    files::must_end(to, "png")?;
    let sketch = of_file(path, terrain)?;
    crate::make::make_folder_of(to)?;
    let story = weald_formats::provenance(path).ok().flatten();
    let story = story.unwrap_or_else(|| crate::export::foreign(path));
    weald_formats::write_png(to, sketch.width, sketch.height, &sketch.rgb, &story)?;
    Ok(())
}
