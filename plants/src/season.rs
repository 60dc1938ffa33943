//! Leaves through the year: they unfold, turn and fall.
//!
//! Every leaf has its own days, a little earlier or later than the species': buds of a crown do
//! not open at once. Days are those of the northern hemisphere; in the south add half a year.

use crate::skeleton::Skeleton;
use weald_contract::{Material, Problem, Problems, Seed, Surface, table};

table! {
    /// Days of the year on which a deciduous species changes.
    pub struct Calendar {
        /// Buds open.
        budburst: f32 = 110.0, in 0.0..=366.0;
        /// Leaves have their full size.
        full: f32 = 150.0, in 0.0..=366.0;
        /// Leaves begin to turn.
        turning: f32 = 262.0, in 0.0..=366.0;
        /// Leaves fall.
        fall: f32 = 298.0, in 0.0..=366.0;
        /// How many days a leaf may be early or late.
        spread: f32 = 12.0, in 0.0..=90.0;
        /// Reflectance of leaves before they fall.
        autumn: [f32; 3] = [0.36, 0.25, 0.04], in 0.0..=0.8;
    }
}

/// Part of the light an autumn leaf reflects that it also lets through: it has lost its green but
/// is still moist.
const AUTUMN_TRANSMITTANCE: f32 = 0.6;

impl Calendar {
    /// Reports days that are not in the order of a year.
    pub fn check(&self) -> Problems {
        let days = [self.budburst, self.full, self.turning, self.fall];
        if days.is_sorted() {
            return Vec::new();
        }
        let what = format!("the days of `season` are {days:?}");
        let hint = "budburst, full, turning and fall come in this order";
        vec![Problem::new(what).hint(hint)]
    }

    /// Size of a leaf relative to its full size, 0 to 1; fallen ones have none.
    fn size(&self, day: f32) -> f32 {
        if day >= self.fall { 0.0 } else { part(self.budburst, self.full, day) }
    }

    /// How far a leaf has turned, 0 to 1.
    fn turned(&self, day: f32) -> f32 {
        part(self.turning, self.fall, day)
    }
}

/// How far `day` lies between two others, 0 to 1.
fn part(from: f32, to: f32, day: f32) -> f32 {
    if to > from { ((day - from) / (to - from)).clamp(0.0, 1.0) } else { f32::from(day >= to) }
}

/// Dresses a plant for a day of the year.
///
/// Leaves are the organs whose prototype's name begins with `leaf`. Colours turn prototype by
/// prototype, each at its own pace, so species with several `hues` turn unevenly.
pub fn dress(skeleton: &mut Skeleton, calendar: &Calendar, day: f32, seed: Seed) {
    let is_leaf: Vec<bool> =
        skeleton.prototypes.iter().map(|p| p.name.starts_with("leaf")).collect();
    let shift = |stream: &str, index: usize| {
        seed.stream(stream, index as u64).around(0.0, f64::from(calendar.spread)) as f32
    };
    for (index, prototype) in skeleton.prototypes.iter().enumerate().filter(|(i, _)| is_leaf[*i]) {
        let turned = calendar.turned(day + shift("hue", index));
        for mesh in &prototype.meshes {
            if let Some(material) = skeleton.materials.get_mut(mesh.material as usize) {
                turn(material, calendar.autumn, turned);
            }
        }
    }
    let mut index = 0;
    skeleton.organs.retain_mut(|organ| {
        index += 1;
        if !is_leaf[organ.prototype as usize] {
            return true;
        }
        let size = calendar.size(day + shift("leaf", index));
        organ.scale *= size;
        size > 0.0
    });
}

/// Mixes a leaf's colours with that of autumn.
fn turn(material: &mut Material, autumn: [f32; 3], turned: f32) {
    let Surface::Leaf { transmittance } = &mut material.surface else { return };
    for channel in 0..3 {
        let through = AUTUMN_TRANSMITTANCE * autumn[channel];
        let old = &mut material.reflectance[channel];
        *old += (autumn[channel] - *old) * turned;
        transmittance[channel] += (through - transmittance[channel]) * turned;
        // A sheet gives back no more light than it receives.
        transmittance[channel] = transmittance[channel].min(0.95 - *old).max(0.0);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::material::LeafColor;
    use crate::skeleton::{Axis, AxisKind, Node, PlacedOrgan};
    use glam::{Quat, Vec3};
    use weald_contract::{FromToml, Mesh, Value};

    fn calendar() -> Calendar {
        Calendar::from_toml(&Value::parse(0, "").unwrap(), &mut Vec::new()).unwrap()
    }

    fn twig() -> Skeleton {
        let mut skeleton = Skeleton::default();
        let green = skeleton.add_material(LeafColor::default().material("leaf", 1.0, 0, 1));
        let leaf =
            skeleton.add_prototype("leaf-0", vec![Mesh { material: green, ..Mesh::default() }]);
        let bud = skeleton.add_prototype("bud", Vec::new());
        let node = |z| Node { position: Vec3::Z * z, radius: 0.01 };
        let axis = skeleton.push(Axis::new(1, AxisKind::Stem, green), [node(0.0), node(1.0)]);
        for i in 0..201 {
            let prototype = if i == 200 { bud } else { leaf };
            let (position, rotation, scale) = (Vec3::Z, Quat::IDENTITY, Vec3::ONE);
            skeleton.organs.push(PlacedOrgan { prototype, axis, position, rotation, scale });
        }
        skeleton
    }

    fn on(day: f32) -> Skeleton {
        let mut skeleton = twig();
        dress(&mut skeleton, &calendar(), day, Seed(1));
        skeleton
    }

    #[test]
    fn twigs_are_bare_in_winter_and_full_in_summer() {
        // The bud stays at all times.
        assert_eq!([on(20.0), on(200.0), on(340.0)].map(|s| s.organs.len()), [1, 201, 1]);
        assert_eq!(on(200.0), twig());
    }

    #[test]
    fn leaves_grow_in_spring_and_fall_one_after_another() {
        let size = |s: &Skeleton| s.organs.iter().map(|o| o.scale.x).sum::<f32>();
        let spring: Vec<f32> = (0..5).map(|i| size(&on(105.0 + 10.0 * i as f32))).collect();
        assert!(spring.windows(2).all(|pair| pair[0] < pair[1]), "{spring:?}");
        let autumn = on(298.0).organs.len();
        assert!((60..140).contains(&autumn), "{autumn}");
    }

    #[test]
    fn autumn_turns_green_to_yellow_and_makes_no_light() {
        let ratio = |s: &Skeleton| s.materials[0].reflectance[0] / s.materials[0].reflectance[1];
        let late = on(311.0);
        assert!(ratio(&late) > 1.2 && ratio(&on(200.0)) < 1.0);
        let Surface::Leaf { transmittance } = late.materials[0].surface else { panic!("no leaf") };
        let sums = late.materials[0].reflectance.iter().zip(transmittance).map(|(r, t)| r + t);
        assert!(sums.fold(0.0, f32::max) <= 0.95);
    }
}
