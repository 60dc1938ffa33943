//! Placements of representatives: a Parquet row an instance.

use crate::error::{Error, Result};
use crate::geo;
use crate::parquet_table;
use crate::provenance::Provenance;
use crate::table::{Column, Table, TableKind, kind_of, metadata_with};
use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;
use weald_contract::{Instances, Palette, Problem};

/// Writes placements as `.parquet`.
///
/// # Errors
/// When the columns differ in length, the name has another ending or the disk refuses.
pub fn write_instances(path: &Path, instances: &Instances, provenance: &Provenance) -> Result<()> {
    require_parquet(path)?;
    let ids = |column: &[u32]| Column::Unsigned(column.iter().map(|&id| u64::from(id)).collect());
    let place = |axis: usize| Column::Float(instances.position.iter().map(|p| p[axis]).collect());
    let turn = |part: usize| Column::Float32(instances.rotation.iter().map(|q| q[part]).collect());
    let table = Table::default()
        .with("group", ids(&instances.group))
        .with("prototype", ids(&instances.prototype))
        .with("plant_id", Column::Unsigned(instances.plant_id.clone()))
        .with("x", place(0))
        .with("y", place(1))
        .with("z", place(2))
        .with("qx", turn(0))
        .with("qy", turn(1))
        .with("qz", turn(2))
        .with("qw", turn(3))
        .with("scale", Column::Float32(instances.scale.clone()));
    table.check(path)?;
    let mut metadata = metadata_with(provenance);
    metadata.insert(geo::CRS_KEY.into(), geo::to_json(&instances.crs));
    parquet_table::write(path, &table, None, &metadata)
}

/// Reads placements.
///
/// # Errors
/// When the file is damaged, a column is missing, or a row is no rigid placement with a
/// positive scale. Whether prototypes exist is for [`check_instances`].
pub fn read_instances(path: &Path) -> Result<Instances> {
    require_parquet(path)?;
    let (table, metadata) = parquet_table::read(path)?;
    let columns = Columns { path, table: &table };
    let [x, y, z] = [columns.floats("x")?, columns.floats("y")?, columns.floats("z")?];
    let [qx, qy, qz, qw] = [
        columns.singles("qx")?,
        columns.singles("qy")?,
        columns.singles("qz")?,
        columns.singles("qw")?,
    ];
    let rows = table.rows();
    let instances = Instances {
        group: columns.ids("group")?,
        prototype: columns.ids("prototype")?,
        plant_id: columns.unsigned("plant_id")?,
        position: (0..rows).map(|i| [x[i], y[i], z[i]]).collect(),
        rotation: (0..rows).map(|i| [qx[i], qy[i], qz[i], qw[i]]).collect(),
        scale: columns.singles("scale")?,
        crs: geo::from_json(metadata.get(geo::CRS_KEY)),
    };
    columns.check_rows(&instances)?;
    Ok(instances)
}

fn require_parquet(path: &Path) -> Result<()> {
    if kind_of(path)? == TableKind::Parquet {
        return Ok(());
    }
    Err(Error::unsupported(path, "instances in this kind of table", "name the file `.parquet`"))
}

/// Reads columns of a table, each as what it should be.
struct Columns<'a> {
    path: &'a Path,
    table: &'a Table,
}

impl Columns<'_> {
    fn column(&self, name: &str) -> Result<&Column> {
        self.table.column(name).ok_or_else(|| {
            let hint = "instances need group, prototype, plant_id, x, y, z, qx, qy, qz, qw, scale";
            Error::invalid(self.path, format!("the table has no column `{name}`"), hint)
        })
    }

    fn floats(&self, name: &str) -> Result<Vec<f64>> {
        self.column(name)?.numbers().ok_or_else(|| {
            let message = format!("column `{name}` holds text");
            Error::invalid(self.path, message, "numbers are expected")
        })
    }

    fn singles(&self, name: &str) -> Result<Vec<f32>> {
        match self.column(name)? {
            Column::Float32(values) => Ok(values.clone()),
            _ => Ok(self.floats(name)?.into_iter().map(|value| value as f32).collect()),
        }
    }

    fn unsigned(&self, name: &str) -> Result<Vec<u64>> {
        let whole = |(row, &value): (usize, &i64)| {
            u64::try_from(value).map_err(|_| self.wrong(row, name, format!("{value} is negative")))
        };
        match self.column(name)? {
            Column::Unsigned(values) => Ok(values.clone()),
            Column::Integer(values) => values.iter().enumerate().map(whole).collect(),
            _ => {
                let message = format!("column `{name}` does not hold whole numbers");
                Err(Error::invalid(self.path, message, ""))
            }
        }
    }

    fn ids(&self, name: &str) -> Result<Vec<u32>> {
        let narrow = |(row, id): (usize, u64)| {
            let hint = "ids go up to 4294967295";
            u32::try_from(id).map_err(|_| self.wrong(row, name, format!("{id}; {hint}")))
        };
        self.unsigned(name)?.into_iter().enumerate().map(narrow).collect()
    }

    fn check_rows(&self, instances: &Instances) -> Result<()> {
        for (row, position) in instances.position.iter().enumerate() {
            if position.iter().any(|number| !number.is_finite()) {
                return Err(self.wrong(row, "x, y, z", "the position is not finite"));
            }
        }
        for (row, rotation) in instances.rotation.iter().enumerate() {
            let square: f32 = rotation.iter().map(|part| part * part).sum();
            // Written as 32-bit numbers, a unit quaternion keeps its length within 1e-6; other
            // programs may have rounded theirs.
            let is_unit = (square - 1.0).abs() < 1e-3;
            if !is_unit {
                return Err(self.wrong(row, "qx, qy, qz, qw", "this is no unit quaternion"));
            }
        }
        match instances.scale.iter().position(|scale| !(scale.is_finite() && *scale > 0.0)) {
            Some(row) => Err(self.wrong(row, "scale", "the scale must be above 0")),
            None => Ok(()),
        }
    }

    fn wrong(&self, row: usize, column: &str, message: impl Into<String>) -> Error {
        let (path, column) = (self.path.into(), column.into());
        Error::Cell { path, row: row as u64 + 1, column, message: message.into() }
    }
}

/// Checks that placements and palette belong together.
///
/// # Errors
/// When two prototypes share an id, a row names a prototype or group that the palette lacks, or
/// a group contains itself.
pub fn check_instances(
    palette: &Palette,
    instances: &Instances,
) -> std::result::Result<(), Problem> {
    let plants = palette.representatives.iter().map(|representative| representative.id);
    let groups: BTreeSet<u32> = palette.groups.iter().map(|group| group.id).collect();
    let mut known = BTreeSet::new();
    for id in plants.chain(palette.groups.iter().map(|group| group.id)) {
        if id == 0 || !known.insert(id) {
            let message = format!("the palette has two prototypes {id}, or uses 0");
            return Err(Problem::new(message).hint("ids are unique; 0 is the scene"));
        }
    }
    let mut inside: BTreeMap<u32, BTreeSet<u32>> = BTreeMap::new();
    for (row, (&group, &prototype)) in instances.group.iter().zip(&instances.prototype).enumerate()
    {
        if !known.contains(&prototype) {
            return Err(unknown(row, "prototype", prototype));
        }
        if group != 0 && !groups.contains(&group) {
            return Err(unknown(row, "group", group));
        }
        if groups.contains(&prototype) {
            inside.entry(group).or_default().insert(prototype);
        }
    }
    match find_cycle(&inside) {
        Some(id) => {
            let message = format!("group {id} contains itself");
            Err(Problem::new(message).hint("groups may nest, but not in a circle"))
        }
        None => Ok(()),
    }
}

fn unknown(row: usize, what: &str, id: u32) -> Problem {
    Problem::new(format!("row {} of the instances names {what} {id}", row + 1))
        .hint("the palette has none; both files must come from the same `weald quantize`")
}

/// A group that contains itself, if there is one: groups are peeled off from the innermost.
fn find_cycle(inside: &BTreeMap<u32, BTreeSet<u32>>) -> Option<u32> {
    let mut left = inside.clone();
    loop {
        let settled: Vec<u32> = left
            .iter()
            .filter(|(_, parts)| parts.iter().all(|part| !left.contains_key(part)))
            .map(|(&group, _)| group)
            .collect();
        if settled.is_empty() {
            return left.keys().next().copied();
        }
        for group in settled {
            left.remove(&group);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::provenance::tests::story;
    use weald_contract::instances::Instance;
    use weald_contract::{Crs, Group, Representative};

    fn row(group: u32, prototype: u32) -> Instance {
        let position = [481_000.25, 5_250_000.125, 390.1];
        let rotation = [0.6, 0.0, 0.0, 0.8];
        Instance { group, prototype, plant_id: u64::MAX, position, rotation, scale: 1.25 }
    }

    fn placed(rows: &[(u32, u32)]) -> Instances {
        let mut instances = Instances::default();
        rows.iter().for_each(|&(group, prototype)| instances.push(row(group, prototype)));
        instances
    }

    fn palette() -> Palette {
        let plant = Representative {
            id: 1,
            species: "fescue".into(),
            age: 1.0,
            vigor: 0.5,
            height: 0.3,
            radius: 0.1,
            weight: 1.0,
            count: 2,
        };
        let group = |id| Group { id, species: "turf".into(), age: 1.0, vigor: 0.5, count: 1 };
        Palette { representatives: vec![plant], groups: vec![group(2), group(3)] }
    }

    #[test]
    fn placements_come_back_bit_for_bit() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("instances.parquet");
        let mut instances = placed(&[(0, 2), (2, 1), (2, 1)]);
        instances.crs = Crs { epsg: Some(32633), ..Crs::default() };
        write_instances(&path, &instances, &story()).unwrap();
        assert_eq!(read_instances(&path).unwrap(), instances);
        assert_eq!(crate::provenance(&path).unwrap(), Some(story()));
    }

    #[test]
    fn rows_that_are_no_placement_are_named() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("instances.parquet");
        type Spoil = fn(&mut Instances);
        let spoil: [(&str, Spoil); 3] = [
            ("row 2, column `scale`", |rows| rows.scale[1] = 0.0),
            ("row 1, column `qx, qy, qz, qw`", |rows| rows.rotation[0] = [0.0; 4]),
            ("row 1, column `x, y, z`", |rows| rows.position[0][2] = f64::NAN),
        ];
        for (expected, spoil) in spoil {
            let mut instances = placed(&[(0, 1), (0, 1)]);
            spoil(&mut instances);
            write_instances(&path, &instances, &story()).unwrap();
            let error = read_instances(&path).unwrap_err().to_string();
            assert!(error.contains(expected), "{error}");
        }
    }

    #[test]
    fn nested_groups_are_fine_and_circles_are_not() {
        assert_eq!(check_instances(&palette(), &placed(&[(0, 3), (3, 2), (2, 1), (0, 1)])), Ok(()));
        let circle = placed(&[(0, 3), (3, 2), (2, 3)]);
        let problem = check_instances(&palette(), &circle).unwrap_err();
        assert!(problem.message.contains("contains itself"), "{problem}");
        assert!(check_instances(&palette(), &placed(&[(2, 2)])).is_err());
    }

    #[test]
    fn a_prototype_or_group_that_the_palette_lacks_is_named() {
        let problem = check_instances(&palette(), &placed(&[(0, 1), (0, 9)])).unwrap_err();
        assert!(problem.message.contains("row 2") && problem.message.contains("prototype 9"));
        // Plant 1 is no group.
        assert!(check_instances(&palette(), &placed(&[(1, 1)])).is_err());
    }
}
