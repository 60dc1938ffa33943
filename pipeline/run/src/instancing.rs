//! What instancing saves, level by level: organ, twig, plant, group, and all of them together.
//!
//! The measure is that of the tables of [Deussen98]: primitives stored against primitives seen, and
//! their bytes in a file with indexed triangles. (The renderer copies small organs and patches to
//! their places, to be faster; what it takes it says before it begins.)

use serde::Serialize;
use std::collections::BTreeMap;
use std::fmt;
use weald_contract::{Instances, Organ, Palette, PlantModel};
use weald_plants::twig;

/// Bytes of a stored triangle with its share of vertices: three indices of 4 bytes, and half a
/// vertex of position, normal and texture coordinate, 32 bytes.
pub const TRIANGLE_BYTES: u64 = 12 + 16;

/// Bytes of an instance: a transform of 3 by 4 numbers of 4 bytes, and a number of what stands there.
pub const INSTANCE_BYTES: u64 = 48 + 4;

/// One level of instancing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Level {
    /// Different things that are kept.
    pub prototypes: u64,
    /// Where they are placed by whatever stands one level above.
    pub placements: u64,
    /// Triangles of the prototypes, with all that is placed in them copied to its place.
    pub triangles: f64,
    /// Triangles if a prototype were copied to each placement.
    pub triangles_without: f64,
}

/// All levels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Instancing {
    /// Leaves, petals, blades.
    pub organs: Level,
    /// Shared twigs.
    pub twigs: Level,
    /// Plant models.
    pub plants: Level,
    /// Patches.
    pub groups: Level,
    /// Triangles that are stored when every level is instanced.
    pub triangles: u64,
    /// Triangles seen in the scene.
    pub triangles_without: f64,
    /// Bytes of what is stored, all placements included.
    pub bytes: u64,
    /// Bytes if all triangles seen were stored.
    pub bytes_without: f64,
}

impl Level {
    /// Bytes of prototypes and placements.
    pub fn bytes(&self) -> f64 {
        self.triangles * TRIANGLE_BYTES as f64 + (self.placements * INSTANCE_BYTES) as f64
    }

    /// Bytes if a prototype were copied to each placement.
    pub fn bytes_without(&self) -> f64 {
        self.triangles_without * TRIANGLE_BYTES as f64
    }

    fn add(&mut self, prototypes: u64, placements: f64, triangles: f64) {
        self.prototypes += prototypes;
        self.placements += placements as u64;
        self.triangles += prototypes as f64 * triangles;
        self.triangles_without += placements * triangles;
    }
}

impl Instancing {
    /// Counts a scene; `models` are those of the representatives, in the palette's order.
    pub fn of(palette: &Palette, instances: &Instances, models: &[&PlantModel]) -> Self {
        let mut found = Self::default();
        let mut wood = 0;
        let mut known: Vec<&Organ> = Vec::new();
        let mut alike: BTreeMap<(&str, usize), Vec<usize>> = BTreeMap::new();
        for model in models {
            wood += triangles_of(&model.wood);
            for organ in &model.organs {
                let same = alike.entry((&organ.name, first_len(organ))).or_default();
                let is_new = same.iter().all(|&other| !is_same(known[other], organ));
                if is_new {
                    same.push(known.len());
                    known.push(organ);
                }
                let level = match organ.name.starts_with(twig::PREFIX) {
                    true => &mut found.twigs,
                    false => &mut found.organs,
                };
                let placements = organ.placements.len() as f64;
                level.add(u64::from(is_new), placements, triangles_of(&organ.meshes) as f64);
            }
        }
        found.triangles = wood + (found.organs.triangles + found.twigs.triangles) as u64;
        found.count_rows(palette, instances, models);
        let levels = [found.organs, found.twigs, found.plants, found.groups];
        let placements: u64 = levels.iter().map(|level| level.placements).sum();
        found.bytes = found.triangles * TRIANGLE_BYTES + placements * INSTANCE_BYTES;
        found.bytes_without = found.triangles_without * TRIANGLE_BYTES as f64;
        found
    }

    /// Counts plants and groups.
    fn count_rows(&mut self, palette: &Palette, instances: &Instances, models: &[&PlantModel]) {
        // Triangles of everything that has a number; a group's once its members' are known.
        let plants = palette.representatives.iter().zip(models);
        let mut seen: BTreeMap<u32, f64> =
            plants.map(|(plant, model)| (plant.id, model.instanced_triangles() as f64)).collect();
        let mut rows: BTreeMap<u32, BTreeMap<u32, u64>> = BTreeMap::new();
        for (group, prototype) in instances.group.iter().zip(&instances.prototype) {
            *rows.entry(*group).or_default().entry(*prototype).or_default() += 1;
        }
        // Groups nest no deeper than there are groups; each round settles one depth.
        for _ in 0..=palette.groups.len() {
            let sum = |members: &BTreeMap<u32, u64>| {
                members.iter().try_fold(0.0, |sum, (id, count)| {
                    seen.get(id).map(|triangles| sum + *count as f64 * triangles)
                })
            };
            let unsettled = rows.iter().filter(|(group, _)| !seen.contains_key(group));
            let settled: Vec<(u32, f64)> =
                unsettled.filter_map(|(group, members)| Some((*group, sum(members)?))).collect();
            if settled.is_empty() {
                break;
            }
            seen.extend(settled);
        }
        self.triangles_without = seen.get(&0).copied().unwrap_or(0.0);
        let mut counts: BTreeMap<u32, u64> = BTreeMap::new();
        for (id, count) in rows.values().flatten() {
            *counts.entry(*id).or_default() += count;
        }
        let triangles = |id: u32| seen.get(&id).copied().unwrap_or(0.0);
        let placements = |id: u32| counts.get(&id).copied().unwrap_or(0) as f64;
        for plant in &palette.representatives {
            self.plants.add(1, placements(plant.id), triangles(plant.id));
        }
        for group in &palette.groups {
            self.groups.add(1, placements(group.id), triangles(group.id));
        }
    }
}

fn triangles_of(meshes: &[weald_contract::Mesh]) -> u64 {
    meshes.iter().map(|mesh| mesh.triangles.len() as u64).sum()
}

/// Whether two organs have the same shape; models number their materials each in its own way.
fn is_same(a: &Organ, b: &Organ) -> bool {
    let pairs = || a.meshes.iter().zip(&b.meshes);
    a.meshes.len() == b.meshes.len()
        && pairs().all(|(a, b)| a.positions == b.positions && a.triangles == b.triangles)
}

fn first_len(organ: &Organ) -> usize {
    organ.meshes.first().map_or(0, |mesh| mesh.positions.len())
}

impl fmt::Display for Instancing {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let head = ["level", "kept", "placed", "triangles", "without", "MB", "without", "saved"];
        let [level, rest @ ..] = head;
        write!(f, "{level:7}")?;
        rest.iter().try_for_each(|word| write!(f, " {word:>13}"))?;
        let mut line = |name: &str, counts: [u64; 2], triangles: [f64; 2], bytes: [f64; 2]| {
            let saved = bytes[1] / bytes[0].max(1.0);
            write!(f, "\n{name:7} {:13} {:13}", counts[0], counts[1])?;
            write!(f, " {:13.0} {:13.0}", triangles[0], triangles[1])?;
            write!(f, " {:13.1} {:13.1} {saved:11.1}:1", bytes[0] / 1e6, bytes[1] / 1e6)
        };
        let levels = [
            ("organs", self.organs),
            ("twigs", self.twigs),
            ("plants", self.plants),
            ("groups", self.groups),
        ];
        let (mut prototypes, mut placements) = (0, 0);
        for (name, level) in levels.iter().filter(|(_, level)| level.prototypes > 0) {
            let triangles = [level.triangles, level.triangles_without];
            let bytes = [level.bytes(), level.bytes_without()];
            line(name, [level.prototypes, level.placements], triangles, bytes)?;
            prototypes += level.prototypes;
            placements += level.placements;
        }
        let triangles = [self.triangles as f64, self.triangles_without];
        line("all", [prototypes, placements], triangles, [self.bytes as f64, self.bytes_without])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::{Group, Mesh, Placement, Representative};

    fn mesh(triangles: usize) -> Mesh {
        Mesh { triangles: vec![[0, 1, 2]; triangles], ..Mesh::default() }
    }

    fn organ(name: &str, triangles: usize, places: usize) -> Organ {
        let place =
            Placement { position: [0.0; 3], rotation: [0.0, 0.0, 0.0, 1.0], scale: [1.0; 3] };
        let (meshes, placements) = (vec![mesh(triangles)], vec![place; places]);
        Organ { name: name.into(), meshes, placements, ..Organ::default() }
    }

    #[test]
    fn every_level_is_counted_by_hand() {
        // Two trees share a twig of 70 triangles and a leaf of 2.
        let tree = |wood: usize, twigs: usize, leaves: usize| PlantModel {
            wood: vec![mesh(wood)],
            organs: vec![organ("twig-0", 70, twigs), organ("leaf", 2, leaves)],
            ..PlantModel::default()
        };
        let models = [tree(10, 3, 5), tree(20, 4, 10)];
        let seen = [10 + 210 + 10, 20 + 280 + 20];
        let plant = |id| Representative {
            id,
            species: "oak".into(),
            age: 1.0,
            vigor: 1.0,
            height: 1.0,
            radius: 1.0,
            weight: 1.0,
            count: 1,
        };
        let group = |id| Group { id, species: "grove".into(), age: 1.0, vigor: 1.0, count: 1 };
        let palette =
            Palette { representatives: vec![plant(1), plant(2)], groups: vec![group(3), group(4)] };
        // The scene: tree 1, grove 4 twice. Grove 4: tree 2 and grove 3 twice. Grove 3: both trees.
        let instances = Instances {
            group: vec![0, 0, 0, 4, 4, 4, 3, 3],
            prototype: vec![1, 4, 4, 2, 3, 3, 1, 2],
            ..Instances::default()
        };
        let found = Instancing::of(&palette, &instances, &[&models[0], &models[1]]);
        let level = |prototypes, placements, triangles: u64, triangles_without: u64| Level {
            prototypes,
            placements,
            triangles: triangles as f64,
            triangles_without: triangles_without as f64,
        };
        assert_eq!(found.organs, level(1, 15, 2, 30));
        assert_eq!(found.twigs, level(1, 7, 70, 490));
        let [one, two] = seen;
        assert_eq!(found.plants, level(2, 4, one + two, 2 * one + 2 * two));
        let (inner, outer) = (one + two, two + 2 * (one + two));
        assert_eq!(found.groups, level(2, 4, inner + outer, 2 * inner + 2 * outer));
        assert_eq!(found.triangles, 10 + 20 + 70 + 2);
        assert_eq!(found.triangles_without, (one + 2 * outer) as f64);
        assert_eq!(found.bytes, 102 * TRIANGLE_BYTES + (15 + 7 + 4 + 4) * INSTANCE_BYTES);
        let words = found.to_string();
        assert_eq!(words.lines().count(), 6, "{words}");
    }
}
