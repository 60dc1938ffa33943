//! Where the rows of a table lie on the terrain: in its map's metres, in degrees, or counted from
//! a corner of their own.

use rayon::prelude::*;
use weald_contract::{Layers, Population, Problem, Written};

/// Returns the places of a table's rows in the terrain's map coordinates.
///
/// With `origin`, the scene coordinates of the table's 0, 0, its places are metres from there,
/// whatever map it names. Otherwise its map must be the terrain's, or longitude and latitude,
/// which are brought to the terrain's UTM zone.
pub(crate) fn places(
    path: &Written<String>,
    table: &Population,
    origin: Option<[f64; 2]>,
    terrain: &Layers,
) -> Result<Vec<[f64; 2]>, Problem> {
    let plants = table.plants.par_iter();
    if let Some([x, y]) = origin {
        let corner = [terrain.frame.west + x, terrain.frame.south + y];
        return Ok(plants.map(|plant| [corner[0] + plant.x, corner[1] + plant.y]).collect());
    }
    let wrong = |message: String| {
        let message = format!("`{}`: {message}", path.value);
        Err(Problem::at(path.span, message)
            .hint("save the table in the terrain's reference system, or give `origin`"))
    };
    let (theirs, ours) = (&table.crs, &terrain.crs);
    if theirs.is_geographic && !ours.is_geographic {
        let place = |plant: &weald_contract::Plant| ours.map_from_degrees(plant.x, plant.y);
        let places: Option<Vec<[f64; 2]>> = plants.map(place).collect();
        return match places {
            Some(places) => Ok(places),
            None => wrong("places are in degrees, and not within the terrain's UTM zone".into()),
        };
    }
    if let (Some(theirs), Some(ours)) = (theirs.epsg, ours.epsg)
        && theirs != ours
    {
        return wrong(format!("places are in EPSG:{theirs}, the terrain in EPSG:{ours}"));
    }
    Ok(plants.map(|plant| [plant.x, plant.y]).collect())
}
