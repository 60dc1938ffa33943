//! The palette: few representatives that stand for many plants.

/// A plant model to grow, standing for `count` similar plants.
#[derive(Clone, Debug, PartialEq)]
pub struct Representative {
    /// Number by which instances refer to it; unique among representatives and groups.
    pub id: u32,
    /// Species name.
    pub species: String,
    /// Age, years.
    pub age: f32,
    /// Vigor in [0, 1].
    pub vigor: f32,
    /// Height, m.
    pub height: f32,
    /// Crown radius, m.
    pub radius: f32,
    /// Sum of the importance weights of its plants.
    pub weight: f64,
    /// Number of plants it stands for; for members of groups, of placements in groups.
    pub count: u64,
}

/// A patch of plants that is instanced as a whole.
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Number by which instances refer to it; never 0, which is the scene.
    pub id: u32,
    /// Species name of the group.
    pub species: String,
    /// Age the group stands for, years.
    pub age: f32,
    /// Vigor the group stands for.
    pub vigor: f32,
    /// Number of instances of it.
    pub count: u64,
}

/// Representatives and groups, by rising id.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Palette {
    /// Plants to grow.
    pub representatives: Vec<Representative>,
    /// Patches made of them.
    pub groups: Vec<Group>,
}
