//! A species whose shape is somebody's model: a `.glb` or `.obj`, scaled to the size asked for.
//!
//! The file is opened by whoever calls; here is what is done with what was in it.

use crate::Stature;
use weald_contract::{PlantModel, Written, table};

table! {
    /// A model from a file.
    pub struct ModelFile {
        /// The file, `.glb` or `.obj`, relative to the species' file.
        file: Written<String>;
        /// Whether the crown is stretched to the radius asked for; else it follows the height.
        fit_crown: bool = false;
    }
}

impl ModelFile {
    /// The model, its foot on the origin, as high as the stature asks.
    ///
    /// A model without height stays as large as it is.
    pub fn fit(&self, mut model: PlantModel, stature: &Stature) -> PlantModel {
        let height = model.height();
        if height <= 0.0 {
            return model;
        }
        let up = stature.height / height;
        let reach = reach(&model);
        let across = if self.fit_crown && reach > 0.0 { stature.radius / reach } else { up };
        let scale = [across, across, up];
        let stretch = |p: &mut [f32; 3]| (0..3).for_each(|axis| p[axis] *= scale[axis]);
        for mesh in &mut model.wood {
            mesh.positions.iter_mut().for_each(stretch);
            for normal in &mut mesh.normals {
                let turned = glam::Vec3::from_array(std::array::from_fn(|i| normal[i] / scale[i]));
                *normal = turned.normalize_or(glam::Vec3::Z).to_array();
            }
        }
        for organ in &mut model.organs {
            for place in &mut organ.placements {
                stretch(&mut place.position);
                // An organ is turned before it is moved: it keeps its proportions.
                place.scale.iter_mut().for_each(|part| *part *= up);
            }
        }
        model.branches.iter_mut().for_each(|branch| stretch(&mut branch.pivot));
        model
    }
}

/// Greatest distance of wood and of organ places from the vertical through the origin, m.
fn reach(model: &PlantModel) -> f32 {
    let wood = model.wood.iter().flat_map(|mesh| &mesh.positions);
    let places = model.organs.iter().flat_map(|organ| &organ.placements).map(|p| &p.position);
    wood.chain(places).map(|p| p[0].hypot(p[1])).fold(0.0, f32::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Mesh, Value};

    fn stature(height: f32, radius: f32) -> Stature {
        Stature { height, radius, stem_radius: 0.1, maturity: 1.0, vigor: 1.0 }
    }

    fn post() -> PlantModel {
        let positions = vec![[-0.5, 0.0, 0.0], [0.5, 0.0, 0.0], [0.0, 0.0, 2.0]];
        let normals = vec![[0.0, -1.0, 0.0]; 3];
        let mesh = Mesh { positions, normals, triangles: vec![[0, 1, 2]], ..Mesh::default() };
        PlantModel { wood: vec![mesh], ..PlantModel::default() }
    }

    fn form(text: &str) -> ModelFile {
        ModelFile::from_toml(&Value::parse(0, text).unwrap(), &mut Vec::new()).unwrap()
    }

    #[test]
    fn a_model_is_scaled_to_the_height_and_if_asked_to_the_radius() {
        let even = form("file = \"a.glb\"").fit(post(), &stature(6.0, 3.0));
        assert_eq!(even.wood[0].positions[0], [-1.5, 0.0, 0.0]);
        let fitted = form("file = \"a.glb\"\nfit_crown = true").fit(post(), &stature(6.0, 3.0));
        assert_eq!(fitted.wood[0].positions, [[-3.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 0.0, 6.0]]);
        assert_eq!(fitted.wood[0].normals[0], [0.0, -1.0, 0.0]);
    }

    #[test]
    fn a_model_without_height_stays() {
        let flat = form("file = \"a.glb\"").fit(PlantModel::default(), &stature(1.0, 1.0));
        assert_eq!(flat, PlantModel::default());
    }
}
