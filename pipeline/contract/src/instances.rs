//! Where the representatives stand: a row an instance.

use crate::grid::Crs;

/// Placements of prototypes, as columns of equal length.
///
/// Rows of group 0 are the scene, in map coordinates and altitude. Rows of another group are
/// placed relative to the group's origin, Z up. A prototype is a representative or a group, so
/// groups nest; a group never contains itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Instances {
    /// Group the row belongs to; 0 is the scene.
    pub group: Vec<u32>,
    /// Id of a representative or group.
    pub prototype: Vec<u32>,
    /// Plant the row stands for; the ordinal inside a group.
    pub plant_id: Vec<u64>,
    /// Position, m.
    pub position: Vec<[f64; 3]>,
    /// Rotation from the prototype's space, unit quaternion x, y, z, w.
    pub rotation: Vec<[f32; 4]>,
    /// Uniform scale.
    pub scale: Vec<f32>,
    /// Reference system of the scene's rows.
    pub crs: Crs,
}

/// One row of [`Instances`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Instance {
    /// See [`Instances::group`].
    pub group: u32,
    /// See [`Instances::prototype`].
    pub prototype: u32,
    /// See [`Instances::plant_id`].
    pub plant_id: u64,
    /// See [`Instances::position`].
    pub position: [f64; 3],
    /// See [`Instances::rotation`].
    pub rotation: [f32; 4],
    /// See [`Instances::scale`].
    pub scale: f32,
}

impl Instances {
    /// Number of rows.
    pub fn len(&self) -> usize {
        self.prototype.len()
    }

    /// Whether nothing is placed.
    pub fn is_empty(&self) -> bool {
        self.prototype.is_empty()
    }

    /// Appends a row.
    pub fn push(&mut self, row: Instance) {
        self.group.push(row.group);
        self.prototype.push(row.prototype);
        self.plant_id.push(row.plant_id);
        self.position.push(row.position);
        self.rotation.push(row.rotation);
        self.scale.push(row.scale);
    }

    /// Row number `index`.
    ///
    /// # Panics
    /// When there is no such row.
    pub fn row(&self, index: usize) -> Instance {
        Instance {
            group: self.group[index],
            prototype: self.prototype[index],
            plant_id: self.plant_id[index],
            position: self.position[index],
            rotation: self.rotation[index],
            scale: self.scale[index],
        }
    }
}
