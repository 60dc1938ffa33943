//! Organs shared among plant models: the level below the plant.
//!
//! Models of one species grow leaves, petals and blades that differ little, or only in size. A
//! placement may scale an organ along its own axes, so organs are compared after each axis has
//! been stretched to the same width: what is left is shape. Organs of equal make, the same
//! triangles over the same number of vertices, are points in a space of their vertices, are
//! clustered there, and the organ nearest to a cluster's middle stands for all of it.
//!
//! An actual organ is chosen, not a mean, so that normals and texture coordinates stay true.

use crate::budget;
use crate::codebook::{Mode, cluster, gains};
use crate::table::Table;
use std::collections::BTreeMap;
use weald_contract::{Mesh, Organ, Placement, PlantModel, Problem};

/// What sharing saved.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize)]
pub struct PartsReport {
    /// Organs of all models.
    pub organs: u64,
    /// Different organs after sharing.
    pub shared: u64,
    /// Triangles of the organs of all models.
    pub triangles: u64,
    /// Triangles of the different organs after sharing.
    pub shared_triangles: u64,
    /// Weighted mean of the squared distances between vertices of organs and of those in their
    /// place, where an organ is 1 wide along each axis.
    pub distortion: f64,
}

/// Gives the organs of all models at most `most` shapes (at least one of each make), by replacing
/// organs with similar ones of other models and stretching their placements. Organs of which
/// `is_own` says so stay as they are, and count for nothing.
///
/// Materials stay those of the model; organs whose numbers are broken stay as they are.
///
/// # Errors
/// An organ with a position that is not finite; the problem names it, and no model was changed.
pub fn share_organs(
    models: &mut [&mut PlantModel],
    most: usize,
    is_own: impl Fn(&Organ) -> bool,
) -> Result<PartsReport, Problem> {
    let makes = makes(models, is_own);
    let tables = makes.iter().map(|make| shapes(models, make)).collect::<Result<Vec<_>, _>>()?;
    let all_gains: Vec<Vec<f64>> = tables.iter().map(|table| gains(table, table.len())).collect();
    let all_gains: Vec<&[f64]> = all_gains.iter().map(Vec::as_slice).collect();
    let counts = budget::share(&all_gains, most);

    let mut report = PartsReport::default();
    let (mut squares, mut weight) = (0.0, 0.0);
    for ((make, table), count) in makes.iter().zip(&tables).zip(counts) {
        let book = cluster(table, count, Mode::Fast);
        let chosen = book.nearest_rows(table);
        let triangles = triangles(organ(models, make[0]));
        let stand_ins: Vec<Organ> =
            chosen.iter().map(|row| bare(organ(models, make[*row]))).collect();
        for (row, label) in book.labels.iter().enumerate() {
            let middle = chosen[*label as usize];
            let apart = squared(table.row(row), table.row(middle));
            (squares, weight) =
                (squares + table.weights()[row] * apart, weight + table.weights()[row]);
            if row != middle {
                let At { model, organ } = make[row];
                replace(&mut models[model].organs[organ], &stand_ins[*label as usize]);
            }
        }
        report.organs += make.len() as u64;
        report.shared += chosen.len() as u64;
        report.triangles += triangles * make.len() as u64;
        report.shared_triangles += triangles * chosen.len() as u64;
    }
    report.distortion = if weight > 0.0 { squares / weight } else { 0.0 };
    Ok(report)
}

/// An organ that stands nowhere.
fn bare(organ: &Organ) -> Organ {
    Organ { name: organ.name.clone(), meshes: organ.meshes.clone(), ..Organ::default() }
}

/// An organ of a model, by their numbers.
#[derive(Clone, Copy)]
struct At {
    model: usize,
    organ: usize,
}

fn organ<'a>(models: &'a [&mut PlantModel], at: At) -> &'a Organ {
    &models[at.model].organs[at.organ]
}

fn triangles(organ: &Organ) -> u64 {
    organ.meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum()
}

/// Organs of equal make: the same name, number of vertices and triangles in every mesh.
fn makes(models: &[&mut PlantModel], is_own: impl Fn(&Organ) -> bool) -> Vec<Vec<At>> {
    type Make<'a> = (&'a str, Vec<(usize, usize, usize, &'a [[u32; 3]])>);
    let mut makes: BTreeMap<Make<'_>, Vec<At>> = BTreeMap::new();
    for (model, plant) in models.iter().enumerate() {
        let organs = plant.organs.iter().enumerate().filter(|(_, organ)| !is_own(organ));
        for (number, organ) in organs {
            let of_mesh =
                |mesh: &'_ Mesh| (mesh.positions.len(), mesh.normals.len(), mesh.uvs.len());
            let meshes = organ.meshes.iter().map(|mesh| {
                let (positions, normals, uvs) = of_mesh(mesh);
                (positions, normals, uvs, mesh.triangles.as_slice())
            });
            let make = (organ.name.as_str(), meshes.collect());
            makes.entry(make).or_default().push(At { model, organ: number });
        }
    }
    makes.into_values().collect()
}

/// Widths of an organ along its axes, m; 1 along an axis in which it is flat.
fn widths(organ: &Organ) -> [f32; 3] {
    let positions = || organ.meshes.iter().flat_map(|mesh| &mesh.positions);
    std::array::from_fn(|axis| {
        let farthest = positions().fold(0.0f32, |far, position| far.max(position[axis].abs()));
        if farthest > 0.0 { farthest } else { 1.0 }
    })
}

/// The vertices of organs of one make, each organ stretched to reach 1 along every axis; weighted
/// by how much of the plants they are: places times triangles.
fn shapes(models: &[&mut PlantModel], make: &[At]) -> Result<Table, Problem> {
    let mut values = Vec::new();
    let mut weights = Vec::new();
    for at in make {
        let organ = organ(models, *at);
        let widths = widths(organ);
        for position in organ.meshes.iter().flat_map(|mesh| &mesh.positions) {
            values.extend((0..3).map(|axis| f64::from(position[axis] / widths[axis])));
        }
        weights.push((organ.placements.len() as u64 * triangles(organ)) as f64);
    }
    if values.is_empty() {
        // Organs without vertices are alike.
        values = vec![0.0; make.len()];
    }
    let columns = values.len() / make.len().max(1);
    Table::new(values, columns, weights).map_err(|_| {
        let names = make.first().map_or("", |at| &organ(models, *at).name);
        Problem::new(format!("an organ `{names}` has a position that is not finite"))
    })
}

fn squared(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(a, b)| (a - b).powi(2)).sum()
}

/// Puts the meshes of another organ in the place of an organ's own, stretched to its widths.
fn replace(organ: &mut Organ, stand_in: &Organ) {
    let (own, other) = (widths(organ), widths(stand_in));
    for (mesh, new) in organ.meshes.iter_mut().zip(&stand_in.meshes) {
        *mesh = Mesh { material: mesh.material, ..new.clone() };
    }
    for Placement { scale, .. } in &mut organ.placements {
        for axis in 0..3 {
            scale[axis] *= own[axis] / other[axis];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A model with one leaf: a triangle `width` wide and `length` long, bent by `bend`.
    fn model(width: f32, length: f32, bend: f32, places: usize) -> PlantModel {
        let positions = vec![[-width, 0.0, 0.0], [width, bend * length, 0.0], [0.0, length, 0.0]];
        let mesh = Mesh { positions, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        let placement =
            Placement { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale: [1.0; 3] };
        let organ = Organ {
            name: "leaf".into(),
            meshes: vec![mesh],
            placements: vec![placement; places],
            ..Organ::default()
        };
        PlantModel { organs: vec![organ], ..PlantModel::default() }
    }

    fn with_shared(
        models: &[PlantModel],
        most: usize,
    ) -> Result<(Vec<PlantModel>, PartsReport), Problem> {
        let mut copies = models.to_vec();
        let report = share_organs(&mut copies.iter_mut().collect::<Vec<_>>(), most, |_| false)?;
        Ok((copies, report))
    }

    /// Corners of an organ at its first place.
    fn corners(model: &PlantModel) -> Vec<[f32; 3]> {
        let organ = &model.organs[0];
        let scale = organ.placements[0].scale;
        let scaled = |p: &[f32; 3]| std::array::from_fn(|axis| p[axis] * scale[axis]);
        organ.meshes[0].positions.iter().map(scaled).collect()
    }

    #[test]
    fn leaves_that_differ_in_size_alone_become_one_and_keep_their_size() {
        let models = [model(1.0, 2.0, 0.25, 3), model(0.5, 3.0, 0.25, 5), model(2.0, 2.0, 0.25, 1)];
        let (shared, report) = with_shared(&models, 1).unwrap();
        assert_eq!((report.organs, report.shared, report.shared_triangles), (3, 1, 1));
        assert!(report.distortion < 1e-12);
        for (before, after) in models.iter().zip(&shared) {
            assert_eq!(after.organs[0].meshes, shared[0].organs[0].meshes);
            for (a, b) in corners(before).iter().zip(corners(after)) {
                assert!((0..3).all(|axis| (a[axis] - b[axis]).abs() < 1e-6));
            }
        }
    }

    #[test]
    fn shapes_that_differ_most_stay_apart() {
        let bends = [0.0, 0.05, 0.9, 0.95];
        let models = bends.map(|bend| model(1.0, 1.0, bend, 1));
        let (shared, report) = with_shared(&models, 2).unwrap();
        assert_eq!(report.shared, 2);
        let mesh = |index: usize| &shared[index].organs[0].meshes;
        assert!(mesh(0) == mesh(1) && mesh(2) == mesh(3) && mesh(1) != mesh(2));
        // As many as there are leave everything as it is.
        let (same, none) = with_shared(&models, 100).unwrap();
        assert_eq!((same.as_slice(), none.distortion), (models.as_slice(), 0.0));
    }

    #[test]
    fn organs_of_another_make_are_never_exchanged() {
        let mut flower = model(1.0, 1.0, 0.0, 2);
        flower.organs[0].name = "petal".into();
        let models = [model(1.0, 1.0, 0.0, 2), flower, PlantModel::default()];
        let (shared, report) = with_shared(&models, 1).unwrap();
        assert_eq!((shared.as_slice(), report.shared), (models.as_slice(), 2));
        let broken = [model(f32::NAN, 1.0, f32::NAN, 1)];
        assert!(with_shared(&broken, 1).unwrap_err().message.contains("leaf"));
        assert_eq!(with_shared(&[], 4).unwrap().1, PartsReport::default());
    }

    #[test]
    fn organs_that_are_to_stay_stay_and_count_for_nothing() {
        let mut models =
            [model(1.0, 1.0, 0.0, 2), model(1.0, 1.0, 0.5, 2), model(1.0, 1.0, 0.9, 2)];
        models[2].organs[0].name = "twig-1".into();
        let before = models.clone();
        let mut all: Vec<&mut PlantModel> = models.iter_mut().collect();
        let report = share_organs(&mut all, 1, |organ| organ.name == "twig-1").unwrap();
        assert_eq!((report.organs, report.shared), (2, 1));
        assert_eq!(models[2], before[2]);
        assert_eq!(models[0].organs[0].meshes, models[1].organs[0].meshes);
    }
}
