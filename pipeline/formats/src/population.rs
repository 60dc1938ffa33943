//! Tables of plants: a row a plant, Parquet (a valid GeoParquet file) or CSV by the name's ending.
//! GeoJSON and GeoPackage are read too.
//!
//! Angles stand in degrees as 64-bit numbers: a 32-bit angle in radians, turned to degrees and
//! back at twice the digits, returns with the same bits.

use crate::error::{Error, Result};
use crate::parquet_table::{self, GEOMETRY, Points};
use crate::provenance::Provenance;
use crate::table::{Column, Metadata, Table, TableKind, kind_of, metadata_with, read_only};
use crate::{csv_table, geo, geojson, geopackage, inventory};
use std::collections::BTreeMap;
use std::path::Path;
use std::sync::Arc;
use weald_contract::{Crs, Plant, Population, State};

/// Key of the list of species, which may hold some that have no plant.
const SPECIES_KEY: &str = "weald_species";

/// Names of our own columns, in the order of the file.
pub const COLUMNS: [&str; 13] = [
    "id",
    "species",
    "x",
    "y",
    "z",
    "radius",
    "height",
    "age",
    "vigor",
    "state",
    "yaw_deg",
    "lean_deg",
    "lean_azimuth_deg",
];

/// Writes plants as `.parquet` or `.csv`.
///
/// # Errors
/// When a plant's species is not in the list, an extra column has another length or the name of
/// one of ours, or the disk refuses.
pub fn write_population(
    path: &Path,
    population: &Population,
    provenance: &Provenance,
) -> Result<()> {
    let kind = kind_of(path)?;
    if matches!(kind, TableKind::GeoJson | TableKind::GeoPackage) {
        return Err(read_only(path));
    }
    let table = to_table(path, population)?;
    table.check(path)?;
    let mut metadata = metadata_with(provenance);
    metadata.insert(geo::CRS_KEY.into(), geo::to_json(&population.crs));
    metadata.insert(SPECIES_KEY.into(), population.species.clone().into());
    if kind == TableKind::Csv {
        return csv_table::write(path, &table, &metadata);
    }
    let (Some(Column::Float(x)), Some(Column::Float(y))) = (table.column("x"), table.column("y"))
    else {
        return Err(Error::invalid(path, "the plants have no coordinates", ""));
    };
    metadata.insert("geo".into(), geo::geoparquet(&population.crs, x, y));
    parquet_table::write(path, &table, Some(Points { x, y }), &metadata)
}

fn to_table(path: &Path, population: &Population) -> Result<Table> {
    let plants = &population.plants;
    let names: Vec<Arc<str>> = population.species.iter().map(|name| Arc::from(&**name)).collect();
    let name = |plant: &Plant| {
        names.get(usize::from(plant.species)).cloned().ok_or_else(|| {
            let message = format!("plant {} has species number {}", plant.id, plant.species);
            Error::invalid(path, message, format!("there are {} species", names.len()))
        })
    };
    let words: [Arc<str>; 3] =
        [State::Free, State::Dominated, State::Old].map(|state| Arc::from(state.word()));
    let state = |plant: &Plant| -> Arc<str> { words[plant.state as usize].clone() };
    let floats = |get: fn(&Plant) -> f32| Column::Float32(plants.iter().map(get).collect());
    let degrees = |get: fn(&Plant) -> f32| {
        Column::Float(plants.iter().map(|plant| f64::from(get(plant)).to_degrees()).collect())
    };
    let species = plants.iter().map(name).collect::<Result<_>>()?;
    let mut table = Table::default()
        .with("id", Column::Unsigned(plants.iter().map(|plant| plant.id).collect()))
        .with("species", Column::Text(species))
        .with("x", Column::Float(plants.iter().map(|plant| plant.x).collect()))
        .with("y", Column::Float(plants.iter().map(|plant| plant.y).collect()))
        .with("z", floats(|plant| plant.z))
        .with("radius", floats(|plant| plant.radius))
        .with("height", floats(|plant| plant.height))
        .with("age", floats(|plant| plant.age))
        .with("vigor", floats(|plant| plant.vigor))
        .with("state", Column::Text(plants.iter().map(state).collect()))
        .with("yaw_deg", degrees(|plant| plant.yaw))
        .with("lean_deg", degrees(|plant| plant.lean))
        .with("lean_azimuth_deg", degrees(|plant| plant.lean_azimuth));
    for (name, values) in &population.extra {
        if name == GEOMETRY {
            let message = "an extra column is called `geometry`";
            return Err(Error::invalid(path, message, "that name is GeoParquet's"));
        }
        table = table.with(name, Column::Float32(values.clone()));
    }
    Ok(table)
}

/// Reads plants, ours or anyone's inventory.
///
/// `species`, `x` and `y` are required. Without `id` the rows are numbered from 0; without
/// `state` plants are free; angles default to 0. A missing `z`, `radius`, `height`, `age` or
/// `vigor` is NaN: who uses the table decides what it should be. Other columns of numbers become
/// [`Population::extra`], other columns of texts are left out. Names and units of other programs
/// are understood as `docs/formats.md` lists them; their rows of dead plants are left out.
///
/// # Errors
/// Names the row and column of a wrong cell; ids must be unique.
pub fn read_population(path: &Path) -> Result<Population> {
    match kind_of(path)? {
        TableKind::Parquet => {
            let (table, metadata) = parquet_table::read(path)?;
            from_table(path, table, &metadata, Crs::default())
        }
        TableKind::Csv => {
            let table = csv_table::read(path, want)?;
            from_table(path, table, &csv_table::read_metadata(path)?, Crs::default())
        }
        TableKind::GeoJson => foreign(path, geojson::read(path)?),
        TableKind::GeoPackage => foreign(path, geopackage::read(path)?),
    }
}

fn foreign(path: &Path, (table, crs): (Table, Crs)) -> Result<Population> {
    from_table(path, table, &Metadata::new(), crs)
}

/// Reads plants from the text of a CSV without companion; `path` is for messages only.
///
/// # Errors
/// As [`read_population`].
pub fn parse_population_csv(path: &Path, bytes: Vec<u8>) -> Result<Population> {
    let table = csv_table::parse(path, bytes, want)?;
    from_table(path, table, &Metadata::new(), Crs::default())
}

fn want(name: &str) -> csv_table::Want {
    use csv_table::Want;
    match name {
        "id" => Want::Unsigned,
        "species" | "state" => Want::Text,
        "x" | "y" | "yaw_deg" | "lean_deg" | "lean_azimuth_deg" => Want::Float,
        "z" | "radius" | "height" | "age" | "vigor" => Want::Float32,
        other if inventory::is_known(other) => Want::Guess,
        _ => Want::Float32OrNothing,
    }
}

/// Plants of a table; `crs` is what its file says where the metadata say nothing.
fn from_table(path: &Path, mut table: Table, metadata: &Metadata, crs: Crs) -> Result<Population> {
    let is_degrees = inventory::translate(&mut table);
    let rows = table.rows();
    let mut columns = Columns { path, rows, table: &mut table };
    let (names, species) = columns.species(metadata)?;
    let (x, y) = (columns.coordinates("x")?, columns.coordinates("y")?);
    let id = columns.ids()?;
    let state = columns.states()?;
    let (z, age, vigor) = (columns.floats("z")?, columns.floats("age")?, columns.floats("vigor")?);
    let (radius, height) = (columns.floats("radius")?, columns.floats("height")?);
    let (yaw, lean) = (columns.radians("yaw_deg")?, columns.radians("lean_deg")?);
    let lean_azimuth = columns.radians("lean_azimuth_deg")?;
    let plant = |i: usize| Plant {
        id: id[i],
        species: species[i],
        state: state[i],
        x: x[i],
        y: y[i],
        z: z[i],
        radius: radius[i],
        height: height[i],
        age: age[i],
        vigor: vigor[i],
        yaw: yaw[i],
        lean: lean[i],
        lean_azimuth: lean_azimuth[i],
    };
    let plants = (0..rows).map(plant).collect();
    let extra = columns.extra();
    let crs = match (metadata.get(geo::CRS_KEY), metadata.get("geo")) {
        (Some(record), _) => geo::from_json(Some(record)),
        (None, Some(geo)) => geo::from_geoparquet(Some(geo)),
        // Longitudes by name are those of WGS 84.
        (None, None) if is_degrees => {
            Crs { epsg: Some(4326), is_geographic: true, ..Crs::default() }
        }
        (None, None) => crs,
    };
    Ok(Population { species: names, plants, extra, crs })
}

/// Takes columns out of a table, each as what it should be.
struct Columns<'a> {
    path: &'a Path,
    rows: usize,
    table: &'a mut Table,
}

impl Columns<'_> {
    fn required(&mut self, name: &str) -> Result<Column> {
        self.table.take(name).ok_or_else(|| {
            let message = format!("the table has no column `{name}`");
            Error::invalid(self.path, message, "`species`, `x` and `y` are required")
        })
    }

    fn wrong(&self, row: usize, column: &str, message: impl Into<String>) -> Error {
        let (path, column) = (self.path.into(), column.into());
        Error::Cell { path, row: row as u64 + 1, column, message: message.into() }
    }

    fn not_numbers(&self, name: &str) -> Error {
        let message = format!("column `{name}` holds text");
        Error::invalid(self.path, message, "numbers are expected")
    }

    /// Names of all species, and a number for each row.
    fn species(&mut self, metadata: &Metadata) -> Result<(Vec<String>, Vec<u16>)> {
        let Column::Text(words) = self.required("species")? else {
            let message = "column `species` holds numbers";
            return Err(Error::invalid(self.path, message, "names are expected"));
        };
        let listed = metadata.get(SPECIES_KEY).cloned().unwrap_or_default();
        let mut names: Vec<String> = serde_json::from_value(listed).unwrap_or_default();
        let mut numbers = BTreeMap::new();
        for (number, name) in names.iter().enumerate() {
            numbers.entry(Arc::from(&**name)).or_insert(number);
        }
        let mut species = Vec::with_capacity(words.len());
        for (row, word) in words.iter().enumerate() {
            if word.is_empty() {
                return Err(self.wrong(row, "species", "the cell is empty; name the species"));
            }
            let number = *numbers.entry(word.clone()).or_insert_with(|| {
                names.push(word.to_string());
                names.len() - 1
            });
            let number = u16::try_from(number)
                .map_err(|_| self.wrong(row, "species", "there are more than 65,536 species"))?;
            species.push(number);
        }
        Ok((names, species))
    }

    fn coordinates(&mut self, name: &str) -> Result<Vec<f64>> {
        let column = self.required(name)?;
        let values = column.numbers().ok_or_else(|| self.not_numbers(name))?;
        match values.iter().position(|value| !value.is_finite()) {
            Some(row) => Err(self.wrong(row, name, "every plant needs a place; give metres")),
            None => Ok(values),
        }
    }

    fn ids(&mut self) -> Result<Vec<u64>> {
        let ids = match self.table.take("id") {
            None => return Ok((0..self.rows as u64).collect()),
            Some(Column::Unsigned(ids)) => ids,
            Some(column) => self.whole_numbers(&column)?,
        };
        let mut sorted: Vec<(u64, usize)> = ids.iter().copied().zip(0..).collect();
        sorted.sort_unstable();
        match sorted.array_windows().find(|[a, b]| a.0 == b.0) {
            Some([first, again]) => {
                let message = format!("id {} stands in row {} already", first.0, first.1 + 1);
                Err(self.wrong(again.1, "id", message))
            }
            None => Ok(ids),
        }
    }

    fn whole_numbers(&self, column: &Column) -> Result<Vec<u64>> {
        let numbers = column.numbers().ok_or_else(|| self.not_numbers("id"))?;
        // Above 2⁵³ neighbouring whole numbers are no longer told apart.
        let is_whole = |number: f64| (0.0..=9_007_199_254_740_992.0).contains(&number);
        let whole = |(row, number): (usize, f64)| {
            if is_whole(number) && number.fract() == 0.0 {
                return Ok(number as u64);
            }
            Err(self.wrong(row, "id", format!("expected a whole number from 0, found {number}")))
        };
        numbers.into_iter().enumerate().map(whole).collect()
    }

    fn states(&mut self) -> Result<Vec<State>> {
        let words = match self.table.take("state") {
            Some(Column::Text(words)) => words,
            _ => return Ok(vec![State::Free; self.rows]),
        };
        let state = |(row, word): (usize, &Arc<str>)| match &**word {
            "" | "free" => Ok(State::Free),
            "dominated" => Ok(State::Dominated),
            "old" => Ok(State::Old),
            other => {
                let shown: String = other.chars().take(40).collect();
                let message = format!("expected free, dominated or old, found `{shown}`");
                Err(self.wrong(row, "state", message))
            }
        };
        words.iter().enumerate().map(state).collect()
    }

    fn floats(&mut self, name: &str) -> Result<Vec<f32>> {
        match self.table.take(name) {
            None => Ok(vec![f32::NAN; self.rows]),
            Some(Column::Float32(values)) => Ok(values),
            Some(column) => {
                let values = column.numbers().ok_or_else(|| self.not_numbers(name))?;
                Ok(values.into_iter().map(|value| value as f32).collect())
            }
        }
    }

    fn radians(&mut self, name: &str) -> Result<Vec<f32>> {
        let Some(column) = self.table.take(name) else {
            return Ok(vec![0.0; self.rows]);
        };
        let values = column.numbers().ok_or_else(|| self.not_numbers(name))?;
        let radian =
            |degrees: f64| if degrees.is_nan() { 0.0 } else { degrees.to_radians() as f32 };
        Ok(values.into_iter().map(radian).collect())
    }

    /// What is left: further columns of numbers.
    fn extra(&mut self) -> BTreeMap<String, Vec<f32>> {
        let columns = std::mem::take(&mut self.table.columns).into_iter();
        let number = |(name, column): (String, Column)| match column {
            Column::Float32(values) => Some((name, values)),
            column => Some((name, column.numbers()?.into_iter().map(|v| v as f32).collect())),
        };
        columns.filter_map(number).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;
    use proptest::prelude::*;
    use weald_contract::Seed;

    fn stand(count: u64) -> Population {
        let mut stream = Seed(5).stream("stand", 0);
        let mut float = |scale: f64| stream.range(0.0, scale) as f32;
        let plant = |id| Plant {
            id: id * 3 + 1,
            species: (id % 3) as u16,
            state: State::from_u8((id % 3) as u8).unwrap(),
            x: 481_000.0 + f64::from(float(400.0)),
            y: 5_250_000.0 + f64::from(float(400.0)) / 3.0,
            z: float(400.0),
            radius: float(5.0),
            height: float(20.0),
            age: float(120.0),
            vigor: float(1.0),
            yaw: float(6.0),
            lean: float(0.3),
            lean_azimuth: -float(6.0),
        };
        let plants: Vec<Plant> = (0..count).map(plant).collect();
        let extra = plants.iter().map(|plant| plant.age * 0.1).collect();
        let keys = vec![1, 1, 0, 3, 1024, 0, 1, 1, 1025, 0, 1, 1, 3072, 0, 1, 26915];
        Population {
            species: ["willow", "aspen", "fescue", "nobody"].map(String::from).into(),
            plants,
            extra: BTreeMap::from([("dbh".to_string(), extra)]),
            crs: Crs { epsg: Some(26915), keys, ascii: "NAD83|".into(), ..Crs::default() },
        }
    }

    #[test]
    fn plants_come_back_bit_for_bit_from_both_kinds_of_file() {
        let folder = tempfile::tempdir().unwrap();
        for name in ["plants.parquet", "plants.csv"] {
            for count in [0, 1, 2000] {
                let path = folder.path().join(name);
                write_population(&path, &stand(count), &story()).unwrap();
                assert!(read_population(&path).unwrap() == stand(count), "{name} of {count}");
                assert_eq!(crate::provenance(&path).unwrap(), Some(story()));
            }
        }
    }

    #[test]
    fn several_row_groups_keep_their_order() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("plants.parquet");
        write_population(&path, &stand(130_000), &story()).unwrap();
        assert!(read_population(&path).unwrap() == stand(130_000));
    }

    proptest! {
        #[test]
        fn every_angle_survives_degrees(radians in any::<f32>().prop_filter("a number", |a| !a.is_nan())) {
            let degrees = f64::from(radians).to_degrees();
            prop_assert_eq!((degrees.to_radians() as f32).to_bits(), radians.to_bits());
            let text = degrees.to_string();
            prop_assert_eq!(text.parse::<f64>().unwrap().to_bits(), degrees.to_bits());
        }

        #[test]
        fn random_text_is_refused_or_read_but_never_panics(text in "(species|x|y|id|,|\n|[0-9.\"-]|[a-z]){0,60}") {
            let _ = parse_population_csv(Path::new("p.csv"), text.into_bytes());
        }

        #[test]
        fn random_bytes_after_a_good_header_never_panic(bytes in prop::collection::vec(any::<u8>(), 0..200)) {
            let mut csv = b"species,x,y,state,id\n".to_vec();
            csv.extend(bytes);
            let _ = parse_population_csv(Path::new("p.csv"), csv);
        }
    }

    fn parse(text: &str) -> Result<Population> {
        parse_population_csv(Path::new("inventory.csv"), text.as_bytes().to_vec())
    }

    #[test]
    fn an_inventory_needs_only_species_and_place() {
        let plants = parse("species,x,y,note,dbh\noak,1,2,big,0.4\nash,3,4,,\n").unwrap();
        assert_eq!(plants.species, ["oak", "ash"]);
        assert_eq!((plants.plants[1].id, plants.plants[1].species), (1, 1));
        assert!(plants.plants[0].height.is_nan() && plants.extra["dbh"][1].is_nan());
        assert_eq!(plants.crs, Crs::default());
    }

    #[test]
    fn wrong_cells_are_named_by_row_and_column() {
        let cases = [
            ("species,x\noak,1\n", "no column `y`"),
            ("species,x,y\noak,1,2\noak,,2\n", "row 2, column `x`"),
            ("species,x,y\noak,1,2\n,1,2\n", "row 2, column `species`"),
            ("species,x,y,state\noak,1,2,dead\n", "row 1, column `state`"),
            ("id,species,x,y\n4,oak,1,2\n4,oak,1,2\n", "row 2, column `id`"),
            ("id,species,x,y\n-4,oak,1,2\n", "row 1, column `id`"),
        ];
        for (text, expected) in cases {
            let error = parse(text).unwrap_err().to_string();
            assert!(error.contains(expected) && error.contains("inventory.csv"), "{error}");
        }
    }
}
