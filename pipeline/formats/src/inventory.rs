//! What the columns of other people's inventories mean: names that ForestGEO, iLand, QGIS and
//! foresters use, and the units that stand in a column's name.
//!
//! A unit follows the name: `dbh_cm`, `dbh.cm`, `dbh [cm]`, `Height (ft)`. A diameter or a height
//! without a unit is only understood where the program that wrote the table fixes it.

use crate::table::{Column, Table};
use std::sync::Arc;

/// Column for breast height diameters, cm; `weald analyze` knows the same name.
pub const DIAMETER: &str = "dbh_cm";

/// One of our columns, and the other names that it has, the commonest first.
struct Meaning {
    column: &'static str,
    /// Our unit, m; none for what is no length.
    unit: Option<f64>,
    aliases: &'static [Alias],
}

/// A name in lower case, with `_` for any other separator.
struct Alias {
    name: &'static str,
    /// Part of the number that counts: half of a crown's width.
    part: f64,
    /// The unit where the name says none, in ours; none when it cannot be known.
    bare: Option<f64>,
}

const fn plain(name: &'static str) -> Alias {
    Alias { name, part: 1.0, bare: Some(1.0) }
}

const fn bare(name: &'static str, unit: Option<f64>) -> Alias {
    Alias { name, part: 1.0, bare: unit }
}

const fn half(name: &'static str) -> Alias {
    Alias { name, part: 0.5, bare: Some(1.0) }
}

/// `gx`, `gy`, `sp`, `treeid`, `stemid` and `tag` stand in ForestGEO's tables of stems, `px`, `py`
/// and `mnemonic` in its view of all measurements [ForestGEO]; `bhdfrom` (cm) and `treeheight`
/// (cm) are Picus's names, which iLand reads beside its own [iLand].
const MEANINGS: [Meaning; 8] = [
    Meaning {
        column: "x",
        unit: Some(1.0),
        aliases: &[
            plain("gx"),
            plain("px"),
            plain("easting"),
            plain("east"),
            plain("x_utm"),
            plain("xutm"),
            plain("utm_x"),
            plain("pos_x"),
            plain("posx"),
            plain("coord_x"),
            plain("lon"),
            plain("longitude"),
        ],
    },
    Meaning {
        column: "y",
        unit: Some(1.0),
        aliases: &[
            plain("gy"),
            plain("py"),
            plain("northing"),
            plain("north"),
            plain("y_utm"),
            plain("yutm"),
            plain("utm_y"),
            plain("pos_y"),
            plain("posy"),
            plain("coord_y"),
            plain("lat"),
            plain("latitude"),
        ],
    },
    Meaning {
        column: "species",
        unit: None,
        aliases: &[
            plain("sp"),
            plain("mnemonic"),
            plain("species_code"),
            plain("spcode"),
            plain("latin"),
            plain("scientific_name"),
            plain("taxon"),
            plain("tree_species"),
        ],
    },
    Meaning {
        column: "id",
        unit: None,
        aliases: &[
            plain("stemid"),
            plain("stem_id"),
            plain("treeid"),
            plain("tree_id"),
            plain("tag"),
            plain("fid"),
        ],
    },
    Meaning {
        column: "height",
        unit: Some(1.0),
        aliases: &[
            plain("h"),
            plain("ht"),
            plain("hgt"),
            plain("tree_height"),
            plain("total_height"),
            bare("treeheight", Some(0.01)),
        ],
    },
    Meaning {
        column: DIAMETER,
        unit: Some(0.01),
        aliases: &[bare("bhdfrom", Some(1.0)), bare("dbh", None), bare("bhd", None)],
    },
    Meaning {
        column: "radius",
        unit: Some(1.0),
        aliases: &[
            plain("crown_radius"),
            plain("crownradius"),
            half("crown_diameter"),
            half("crown_width"),
        ],
    },
    Meaning { column: "age", unit: None, aliases: &[plain("age_years"), plain("tree_age")] },
];

/// Diameters of ForestGEO are millimetres; ours, centimetres.
const FOREST_GEO_DIAMETER: f64 = 0.1;

/// Names of columns that say whether a plant lives.
const STATUS: [&str; 4] = ["dfstatus", "status", "life_status", "lifestatus"];
/// What stands there for those that do not: ForestGEO's dead, gone, missing, and not yet there.
const NOT_ALIVE: [&str; 12] = [
    "d",
    "dead",
    "g",
    "gone",
    "m",
    "missing",
    "p",
    "prior",
    "stem dead",
    "dead stem",
    "lost_stem",
    "stump",
];

/// Lengths that a name may end in, m. Feet are international ones.
const UNITS: [(&str, f64); 7] = [
    ("mm", 0.001),
    ("cm", 0.01),
    ("dm", 0.1),
    ("m", 1.0),
    ("km", 1000.0),
    ("ft", 0.3048),
    ("in", 0.0254),
];

/// A column's name without its unit, and the unit, m.
#[derive(Debug, PartialEq)]
struct Header {
    name: String,
    unit: Option<f64>,
}

impl Header {
    fn of(text: &str) -> Self {
        let text = text.trim().to_lowercase();
        let words: Vec<&str> =
            text.split(|c: char| !c.is_alphanumeric()).filter(|word| !word.is_empty()).collect();
        if let [name @ .., last] = &words[..]
            && !name.is_empty()
            && let Some((_, unit)) = UNITS.iter().find(|(unit, _)| unit == last)
        {
            return Self { name: name.join("_"), unit: Some(*unit) };
        }
        Self { name: words.join("_"), unit: None }
    }
}

/// How a foreign column becomes one of ours.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Reading {
    factor: f64,
    /// Of several columns with the same meaning the one of least rank counts.
    rank: usize,
}

impl Meaning {
    /// Returns how a column of this name is read, if it means this.
    fn reading(&self, header: &str, is_forest_geo: bool) -> Option<Reading> {
        let Header { name, unit } = Header::of(header);
        let own = Alias { name: self.column, part: 1.0, bare: Some(1.0) };
        let named = |alias: &Alias| alias.name == name;
        let (rank, alias) = match self.aliases.iter().position(named) {
            Some(index) => (index + 1, &self.aliases[index]),
            None if named(&own) => (0, &own),
            None => return None,
        };
        let factor = match (unit, self.unit) {
            (Some(written), Some(ours)) => alias.part * written / ours,
            (Some(_), None) => return None,
            (None, _) if name == "dbh" && is_forest_geo => FOREST_GEO_DIAMETER,
            (None, _) => alias.part * alias.bare?,
        };
        Some(Reading { factor, rank })
    }
}

/// Whether these are the columns of a ForestGEO census, whose diameters are millimetres.
fn is_forest_geo(headers: &[&str]) -> bool {
    let has = |name: &str| headers.iter().any(|header| header.eq_ignore_ascii_case(name));
    (has("gx") && has("sp") && (has("stemID") || has("treeID")))
        || (has("PX") && has("Mnemonic") && has("QuadratName"))
}

/// Whether a column of this name may be understood, though it is not called as ours is.
pub(crate) fn is_known(header: &str) -> bool {
    STATUS.contains(&Header::of(header).name.as_str())
        || MEANINGS.iter().any(|meaning| meaning.reading(header, true).is_some())
}

/// Gives columns our names and units, and takes out the rows of plants that are not alive.
///
/// A column that is called as ours is stays as it is. Returns whether places are degrees.
pub(crate) fn translate(table: &mut Table) -> bool {
    take_out_dead(table);
    let headers: Vec<String> = table.columns.iter().map(|(name, _)| name.clone()).collect();
    let headers: Vec<&str> = headers.iter().map(String::as_str).collect();
    let is_forest_geo = is_forest_geo(&headers);
    let mut is_degrees = false;
    for meaning in &MEANINGS {
        if headers.contains(&meaning.column) {
            continue;
        }
        let readings = headers.iter().enumerate().filter_map(|(index, header)| {
            let reading = meaning.reading(header, is_forest_geo)?;
            is_usable(&table.columns[index].1, meaning.column).then_some((reading, index))
        });
        let Some((reading, index)) = readings.min_by_key(|(reading, _)| reading.rank) else {
            continue;
        };
        is_degrees |= meaning.column == "x" && headers[index].to_lowercase().starts_with("lon");
        let (name, column) = &mut table.columns[index];
        *name = meaning.column.into();
        scale(column, reading.factor);
    }
    is_degrees
}

/// Whether a column can stand for ours; an id that is no number, or stands twice, cannot.
fn is_usable(column: &Column, meaning: &str) -> bool {
    if meaning != "id" {
        return true;
    }
    let Some(mut numbers) = column.numbers() else { return false };
    numbers.sort_by(f64::total_cmp);
    let is_whole = |number: &f64| *number >= 0.0 && *number < 9e15 && number.fract() == 0.0;
    numbers.iter().all(is_whole) && numbers.array_windows().all(|[a, b]| a < b)
}

fn scale(column: &mut Column, factor: f64) {
    if factor == 1.0 {
        return;
    }
    if let Some(numbers) = column.numbers() {
        *column = Column::Float(numbers.into_iter().map(|number| number * factor).collect());
    }
}

fn take_out_dead(table: &mut Table) {
    let is_status =
        |column: &&(String, Column)| STATUS.contains(&Header::of(&column.0).name.as_str());
    let Some((_, Column::Text(words))) = table.columns.iter().find(is_status) else { return };
    let lives: Vec<bool> =
        words.iter().map(|word| !NOT_ALIVE.contains(&word.to_lowercase().as_str())).collect();
    if lives.iter().all(|lives| *lives) {
        return;
    }
    for (_, column) in &mut table.columns {
        match column {
            Column::Float(values) => keep(values, &lives),
            Column::Float32(values) => keep(values, &lives),
            Column::Integer(values) => keep(values, &lives),
            Column::Unsigned(values) => keep(values, &lives),
            Column::Text(values) => keep::<Arc<str>>(values, &lives),
        }
    }
}

fn keep<T>(values: &mut Vec<T>, wanted: &[bool]) {
    let mut wanted = wanted.iter();
    values.retain(|_| wanted.next().is_some_and(|wanted| *wanted));
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::population::parse_population_csv;
    use std::path::Path;
    use weald_contract::Population;

    fn parse(text: &str) -> Population {
        parse_population_csv(Path::new("inventory.csv"), text.as_bytes().to_vec()).unwrap()
    }

    #[test]
    fn units_are_read_from_the_end_of_a_name() {
        let cases = [
            ("dbh_cm", "dbh", Some(0.01)),
            ("DBH [mm]", "dbh", Some(0.001)),
            ("Height (ft)", "height", Some(0.3048)),
            ("crown.width.m", "crown_width", Some(1.0)),
            ("cm", "cm", None),
            ("species", "species", None),
        ];
        for (text, name, unit) in cases {
            assert_eq!(Header::of(text), Header { name: name.into(), unit }, "{text}");
        }
    }

    #[test]
    fn a_forest_geo_census_is_read_without_its_dead() {
        // Columns of a ForestGEO stem table; diameters are millimetres.
        let plants = parse(
            "treeID,stemID,tag,StemTag,sp,quadrat,gx,gy,dbh,status,DFstatus\n\
             11,21,000011,1,quru,0001,10.5,20.25,153,A,alive\n\
             11,22,000011,2,quru,0001,10.5,20.25,41,A,alive\n\
             12,23,000012,1,acru,0001,NA,NA,NA,D,dead\n",
        );
        assert_eq!(plants.species, ["quru"]);
        assert_eq!(plants.plants.iter().map(|p| p.id).collect::<Vec<_>>(), [21, 22]);
        assert_eq!((plants.plants[0].x, plants.plants[0].y), (10.5, 20.25));
        assert!((plants.extra[DIAMETER][0] - 15.3).abs() < 1e-5);
        assert!(plants.plants[0].height.is_nan());
    }

    #[test]
    fn iland_and_picus_trees_are_read() {
        let plants = parse("x;y;bhdfrom;species;treeheight;age\n3;4;28.5;piab;2150;60\n");
        assert_eq!(plants.extra[DIAMETER], [28.5]);
        assert_eq!((plants.plants[0].height, plants.plants[0].age), (21.5, 60.0));
    }

    #[test]
    fn our_own_names_win_and_units_are_converted() {
        let plants = parse(
            "id,tag,x,gx,y,species,Height [dm],crown width (m),DBH.in\n\
             7,1,3,99,4,oak,125,6,10\n",
        );
        let plant = plants.plants[0];
        assert_eq!((plant.id, plant.x, plant.height, plant.radius), (7, 3.0, 12.5, 3.0));
        assert!((plants.extra[DIAMETER][0] - 25.4).abs() < 1e-5);
        // A diameter whose unit nobody says is left as it is.
        let plants = parse("x,y,species,dbh\n1,2,oak,30\n");
        assert_eq!((plants.extra["dbh"][0], plants.extra.get(DIAMETER)), (30.0, None));
    }

    #[test]
    fn longitudes_make_places_geographic() {
        let plants = parse("lon,lat,species\n-93.2,45.1,oak\n");
        assert!(plants.crs.is_geographic && plants.plants[0].x == -93.2);
    }

    #[test]
    fn ids_that_stand_twice_are_numbered_anew() {
        let plants = parse("treeID,x,y,species\n5,1,2,oak\n5,1,3,oak\n");
        assert_eq!(plants.plants.iter().map(|p| p.id).collect::<Vec<_>>(), [0, 1]);
    }
}
