//! Levels of detail: what stands far away is shown by a coarser model of the same plant.
//!
//! The plants stage writes a model for each size of a pixel in `[plants] levels`; here each plant
//! of the scene takes the coarsest of those made for pixels no larger than a pixel is at its place.
//! The renderer knows nothing of it: a level is a prototype of its own.

use std::collections::{BTreeMap, BTreeSet};
use weald_contract::instances::Instance;
use weald_contract::view::Sight;
use weald_contract::{Group, Instances, Palette, Projection, Representative, View};

/// How large a pixel is where something stands.
#[derive(Clone, Copy, Debug)]
pub struct Pixels {
    eye: [f64; 3],
    /// Size at a distance of 1 m, m.
    per_meter: f64,
    /// Size everywhere, instead, m: without foreshortening.
    everywhere: Option<f64>,
}

impl Pixels {
    /// Pixels of a picture that is `width` wide, in its middle, where they are largest.
    pub fn new(view: &View, sight: &Sight, width: u32) -> Self {
        let width = f64::from(width.max(1));
        let across = 2.0 * (0.5 * view.fov_deg.to_radians()).tan() / width;
        let (per_meter, everywhere) = match view.projection {
            Projection::Perspective => (across, None),
            Projection::Panorama => (std::f64::consts::TAU / width, None),
            Projection::Orthographic => (0.0, Some(across * distance(sight.eye, sight.target))),
        };
        Self { eye: sight.eye, per_meter, everywhere }
    }

    /// Size of a pixel for something of this reach around a place, m: that at its nearest point.
    fn at(&self, place: [f64; 3], reach: f64) -> f64 {
        let near = (distance(self.eye, place) - reach).max(0.0);
        self.everywhere.unwrap_or(self.per_meter * near)
    }
}

fn distance(a: [f64; 3], b: [f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

/// A scene whose plants have got their levels.
pub struct Leveled {
    /// The palette with a representative for each level of those that are used.
    pub palette: Palette,
    /// The instances of those levels.
    pub instances: Instances,
    /// Ids of level 0, from which those of level n are n times this away.
    stride: u32,
}

impl Leveled {
    /// Id of the plant, and its level, that an id of the leveled palette stands for.
    pub fn origin(&self, id: u32) -> (u32, u32) {
        (id % self.stride, id / self.stride)
    }

    /// How many plants of the scene got each level; those of a group count as one.
    pub fn counts(&self, levels: usize) -> Vec<u64> {
        let mut counts = vec![0; levels + 1];
        let rows = self.instances.group.iter().zip(&self.instances.prototype);
        for (_, &prototype) in rows.filter(|(group, _)| **group == 0) {
            counts[self.origin(prototype).1 as usize] += 1;
        }
        counts
    }
}

/// Gives each plant of the scene, and each group with all that is in it, its level.
///
/// `levels` are sizes of a pixel by rising size, m; a plant at whose place a pixel is smaller than
/// the first keeps its full model. Groups are treated as wide as they are and larger by their
/// scale. Where ids would not fit 32 bits, nothing changes.
pub fn level(
    palette: &Palette,
    instances: &Instances,
    levels: &[f32],
    is_fixed: impl Fn(&str) -> bool,
    pixels: &Pixels,
) -> Leveled {
    let ids = palette.representatives.iter().map(|plant| plant.id);
    let most = ids.chain(palette.groups.iter().map(|group| group.id)).max().unwrap_or(0);
    let stride = most.saturating_add(1);
    if u64::from(stride) * (levels.len() as u64 + 1) > u64::from(u32::MAX) || levels.is_empty() {
        let (palette, instances) = (palette.clone(), instances.clone());
        return Leveled { palette, instances, stride: u32::MAX };
    }
    let fixed: BTreeSet<u32> = palette
        .representatives
        .iter()
        .filter(|plant| is_fixed(&plant.species))
        .map(|plant| plant.id)
        .collect();
    let raised = |id: u32, level: u32| if fixed.contains(&id) { id } else { id + level * stride };
    let reach = reaches(palette, instances);
    let mut leveled = Instances { crs: instances.crs.clone(), ..Instances::default() };
    for index in 0..instances.len() {
        let row = instances.row(index);
        if row.group == 0 {
            let scale = f64::from(row.scale.max(1e-6));
            let reach = scale * reach.get(&row.prototype).copied().unwrap_or(0.0);
            let pixel = pixels.at(row.position, reach) / scale;
            let level = levels.partition_point(|size| f64::from(*size) <= pixel) as u32;
            leveled.push(Instance { prototype: raised(row.prototype, level), ..row });
            continue;
        }
        for level in 0..=levels.len() as u32 {
            let (group, prototype) = (row.group + level * stride, raised(row.prototype, level));
            leveled.push(Instance { group, prototype, ..row });
        }
    }
    Leveled {
        palette: all_levels(palette, levels.len() as u32, stride),
        instances: leveled,
        stride,
    }
}

/// The palette with every level of each representative and group.
fn all_levels(palette: &Palette, levels: u32, stride: u32) -> Palette {
    let at = |level: u32| level * stride;
    let plants = (0..=levels).flat_map(|level| {
        let raise = move |plant: &Representative| Representative {
            id: plant.id + at(level),
            ..plant.clone()
        };
        palette.representatives.iter().map(raise)
    });
    let groups = (0..=levels).flat_map(|level| {
        let raise = move |group: &Group| Group { id: group.id + at(level), ..group.clone() };
        palette.groups.iter().map(raise)
    });
    Palette { representatives: plants.collect(), groups: groups.collect() }
}

/// How far each representative and group reaches from its foot, m.
fn reaches(palette: &Palette, instances: &Instances) -> BTreeMap<u32, f64> {
    let reach_of = |plant: &Representative| f64::from(plant.height.max(plant.radius));
    let mut reaches: BTreeMap<u32, f64> =
        palette.representatives.iter().map(|plant| (plant.id, reach_of(plant))).collect();
    // Groups may hold groups, as deep as there are groups at most.
    for _ in 0..palette.groups.len() {
        let mut wider: BTreeMap<u32, f64> = BTreeMap::new();
        for index in (0..instances.len()).filter(|index| instances.group[*index] != 0) {
            let row = instances.row(index);
            let own = reaches.get(&row.prototype).copied().unwrap_or(0.0);
            let far = distance(row.position, [0.0; 3]) + f64::from(row.scale) * own;
            let widest = wider.entry(row.group).or_insert(0.0);
            *widest = widest.max(far);
        }
        let changed = wider.iter().any(|(id, reach)| reaches.get(id) != Some(reach));
        reaches.extend(wider);
        if !changed {
            break;
        }
    }
    reaches
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{FromToml, Value};

    fn plant(id: u32, species: &str) -> Representative {
        let (age, vigor, height, radius, weight, count) = (10.0, 1.0, 2.0, 1.0, 1.0, 1);
        Representative { id, species: species.into(), age, vigor, height, radius, weight, count }
    }

    fn row(group: u32, prototype: u32, x: f64, scale: f32) -> Instance {
        let (position, rotation) = ([x, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]);
        Instance { group, prototype, plant_id: 1, position, rotation, scale }
    }

    /// 0.01 m a pixel at 10 m.
    fn pixels() -> Pixels {
        let text = "name = 'a'\nstand_at = [0, 0]\nlook_at = [1, 0]\nfov_deg = 53.130102354";
        let mut problems = Vec::new();
        let view = View::from_toml(&Value::parse(0, text).unwrap(), &mut problems).unwrap();
        let sight = Sight { eye: [0.0; 3], target: [1.0, 0.0, 0.0] };
        Pixels::new(&view, &sight, 1000)
    }

    fn leveled(instances: &[Instance]) -> Leveled {
        let palette = Palette {
            representatives: vec![plant(1, "oak"), plant(3, "rock")],
            groups: vec![Group { id: 4, species: "tuft".into(), age: 1.0, vigor: 1.0, count: 1 }],
        };
        let mut rows = Instances::default();
        instances.iter().for_each(|row| rows.push(*row));
        level(&palette, &rows, &[0.01, 0.04], |species| species == "rock", &pixels())
    }

    #[test]
    fn plants_get_coarser_with_the_size_of_a_pixel_at_their_nearest_point() {
        // A plant reaches 2 m: its nearest point is that much nearer.
        let scene = [11.9, 12.1, 41.9, 42.1].map(|x| row(0, 1, x, 1.0));
        let made = leveled(&scene);
        let levels: Vec<_> = made.instances.prototype.iter().map(|&id| made.origin(id)).collect();
        assert_eq!(levels, [(1, 0), (1, 1), (1, 1), (1, 2)]);
        assert_eq!(made.counts(2), [1, 2, 1]);
        // Twice as large, a plant shows twice the detail and reaches twice as far.
        let made = leveled(&[row(0, 1, 23.9, 2.0), row(0, 1, 24.1, 2.0)]);
        assert_eq!(made.counts(2), [1, 1, 0]);
    }

    #[test]
    fn groups_take_their_members_along() {
        let made = leveled(&[
            row(0, 4, 5.0, 1.0),
            row(0, 4, 16.0, 1.0),
            row(4, 1, 1.0, 1.0),
            row(4, 3, 2.0, 1.0),
        ]);
        let inside = |group: u32| {
            let rows = (0..made.instances.len()).map(|i| made.instances.row(i));
            let of = rows.filter(|row| row.group == group);
            of.map(|row| made.origin(row.prototype)).collect::<Vec<_>>()
        };
        let placed = [made.instances.prototype[0], made.instances.prototype[1]];
        assert_eq!(placed.map(|id| made.origin(id)), [(4, 0), (4, 1)]);
        assert_eq!(inside(placed[0]), [(1, 0), (3, 0)]);
        // A stone has one model only.
        assert_eq!(inside(placed[1]), [(1, 1), (3, 0)]);
    }

    #[test]
    fn without_levels_nothing_changes() {
        let palette = Palette { representatives: vec![plant(1, "oak")], groups: Vec::new() };
        let mut rows = Instances::default();
        rows.push(row(0, 1, 500.0, 1.0));
        let made = level(&palette, &rows, &[], |_| false, &pixels());
        assert_eq!((made.palette, made.instances), (palette, rows));
    }
}
