//! Light by shadow propagation: each metamer darkens a pyramid of voxels below it [Palubicki09]
//! §3.
//!
//! Shadow is kept in whole numbers, so that taking a metamer away gives back the very grid that
//! was there before it, and the order of metamers leaves no trace. In the additive model of the
//! paper the numbers are shadow itself, in the multiplicative one of the authors' demo program
//! they are binary logarithms of transmittance, whose sum is the product.

use super::{ShadowModel, Shadows};
use crate::Error;
use crate::volume::{Bounds, Solid};
use glam::{IVec3, Vec3};
use weald_contract::{Problem, Seed};

/// Fixed point units in a shadow of 1, and in one halving of the light.
const UNIT: f64 = (1u64 << 24) as f64;

/// Shadow of a voxel inside an obstacle: no sum of metamers comes near.
const SOLID: i64 = i64::MAX / 4;

/// What one metamer adds to one layer of voxels.
struct Layer {
    /// Layers below the metamer.
    below: i32,
    /// Where the layer's middle lies, in voxels from the metamer: 0 when light comes from above.
    shift: [i32; 2],
    /// Voxels on each side of the middle.
    half: i32,
    /// Shadow of each voxel, row by row.
    shadow: Vec<i64>,
}

/// Voxels of shadow.
pub struct ShadowGrid {
    size: [i32; 3],
    low: Vec3,
    voxel: f32,
    shadow: Vec<i64>,
    layers: Vec<Layer>,
    shadows: Shadows,
    /// Shadow that a metamer casts on its own voxel.
    own: i64,
}

impl ShadowGrid {
    /// A grid without shadow around what grows from the points `feet`.
    pub fn new(shadows: &Shadows, feet: Bounds, seed: Seed) -> Self {
        let size = shadows.grid.map(|count| count as i32);
        let extent = Vec3::from_array(shadows.grid.map(|count| count as f32)) * shadows.voxel;
        let middle = 0.5 * (feet.low + feet.high);
        // The feet stand half a voxel above the floor.
        let low = Vec3::new(
            middle.x - 0.5 * extent.x,
            middle.y - 0.5 * extent.y,
            feet.low.z - 0.5 * shadows.voxel,
        );
        let voxels = size.iter().map(|side| *side as usize).product();
        let mut shadow = vec![0; voxels];
        if shadows.noise > 0.0 {
            let mut stream = seed.stream("sky", 0);
            let most = f64::from(shadows.noise) * UNIT;
            shadow.iter_mut().for_each(|voxel| *voxel = (stream.unit() * most) as i64);
        }
        let (shadows, voxel) = (shadows.clone(), shadows.voxel);
        let mut grid = Self { size, low, voxel, shadow, layers: Vec::new(), shadows, own: 0 };
        grid.light_from(Vec3::Z);
        grid
    }

    /// Sets the direction that most light comes from; shadows cast before keep theirs.
    fn light_from(&mut self, light: Vec3) {
        let slope = -light.truncate() / light.z.max(0.1);
        self.layers.clear();
        self.own = 0;
        for below in 0..=self.shadows.depth as i32 {
            let half = libm::floorf(below as f32 * self.shadows.spread) as i32;
            let side = -half..=half;
            let cells = side.clone().flat_map(|j| side.clone().map(move |i| (i, j)));
            let shadow: Vec<i64> = cells.map(|(i, j)| self.shadow_of(i, j, below)).collect();
            if shadow.iter().all(|shadow| *shadow == 0) {
                continue;
            }
            let shift = (slope * below as f32).round();
            let shift = [shift.x as i32, shift.y as i32];
            if below == 0 {
                self.own = shadow[0];
            }
            self.layers.push(Layer { below, shift, half, shadow });
        }
    }

    /// What a metamer casts on the voxel `i`, `j` beside and `below` it.
    fn shadow_of(&self, i: i32, j: i32, below: i32) -> i64 {
        let Shadows { model, strength, decay, .. } = self.shadows;
        match model {
            // [Palubicki09]: a b^-q
            ShadowModel::Additive => {
                let shadow = f64::from(strength) * libm::pow(f64::from(decay), -f64::from(below));
                (shadow * UNIT).round() as i64
            }
            // The authors' program: exposure times 1 - a b^-distance, nothing in the own layer.
            ShadowModel::Multiplicative if below == 0 => 0,
            ShadowModel::Multiplicative => {
                let distance = f64::from(i * i + j * j + below * below).sqrt();
                let taken = f64::from(strength.min(0.999)) * libm::pow(f64::from(decay), -distance);
                (-libm::log2(1.0 - taken) * UNIT).round() as i64
            }
        }
    }

    /// The voxel around a place; it may lie outside.
    #[inline]
    fn voxel_of(&self, p: Vec3) -> IVec3 {
        ((p - self.low) / self.voxel).floor().as_ivec3()
    }

    #[inline]
    fn index(&self, IVec3 { x, y, z }: IVec3) -> Option<usize> {
        let [nx, ny, nz] = self.size;
        let inside = (0..nx).contains(&x) && (0..ny).contains(&y) && (0..nz).contains(&z);
        inside.then(|| ((z as usize * ny as usize) + y as usize) * nx as usize + x as usize)
    }

    /// Whether a shoot may grow to a place: inside the walls and outside obstacles.
    pub fn is_open(&self, p: Vec3) -> bool {
        self.index(self.voxel_of(p)).is_some_and(|index| self.shadow[index] < SOLID / 2)
    }

    /// Casts the shadow of a metamer at `p` once more.
    pub fn add(&mut self, p: Vec3) {
        self.cast(p, |voxel, shadow| *voxel += shadow);
    }

    /// Takes back the shadow of a metamer at `p`.
    pub fn remove(&mut self, p: Vec3) {
        self.cast(p, |voxel, shadow| *voxel -= shadow);
    }

    fn cast(&mut self, p: Vec3, apply: impl Fn(&mut i64, i64)) {
        let at = self.voxel_of(p);
        let [nx, ny, nz] = self.size;
        for layer in &self.layers {
            let z = at.z - layer.below;
            if !(0..nz).contains(&z) {
                continue;
            }
            let Layer { half, shift: [sx, sy], .. } = *layer;
            let side = 2 * half + 1;
            let (left, front) = (at.x + sx - half, at.y + sy - half);
            // The part of the layer inside the walls.
            let (x0, x1) = (left.max(0), (left + side).min(nx));
            let (y0, y1) = (front.max(0), (front + side).min(ny));
            if x0 >= x1 {
                continue;
            }
            let width = (x1 - x0) as usize;
            for y in y0..y1 {
                let row = ((z as usize * ny as usize) + y as usize) * nx as usize + x0 as usize;
                let from = ((y - front) * side + (x0 - left)) as usize;
                let shadows = &layer.shadow[from..from + width];
                for (voxel, shadow) in self.shadow[row..row + width].iter_mut().zip(shadows) {
                    apply(voxel, *shadow);
                }
            }
        }
    }

    /// Light that reaches a bud, without the shadow of its own metamer: at most
    /// [`Shadows::full`], and 0 outside.
    #[inline]
    pub fn exposure(&self, p: Vec3) -> f32 {
        let Some(index) = self.index(self.voxel_of(p)) else { return 0.0 };
        self.light(self.shadow[index] - self.own)
    }

    #[inline]
    fn light(&self, shadow: i64) -> f32 {
        let shadow = (shadow as f64 * (1.0 / UNIT)) as f32;
        match self.shadows.model {
            ShadowModel::Additive => (self.shadows.full - shadow).max(0.0),
            ShadowModel::Multiplicative => self.shadows.full * libm::exp2f(-shadow),
        }
    }

    /// Shadow of a voxel near `at`; that at `at` itself stands for voxels outside the grid.
    fn shadow_near(&self, at: IVec3, by: IVec3) -> f32 {
        let index = self.index(at + by).or_else(|| self.index(at));
        index.map_or(0.0, |index| (self.shadow[index] as f64 / UNIT) as f32)
    }

    /// Direction in which shadow lessens fastest: the negative gradient of the voxels, of
    /// length 1, or 0 where all are alike.
    pub fn against_gradient(&self, p: Vec3) -> Vec3 {
        let at = self.voxel_of(p);
        let slope = |axis: IVec3| self.shadow_near(at, -axis) - self.shadow_near(at, axis);
        Vec3::new(slope(IVec3::X), slope(IVec3::Y), slope(IVec3::Z)).normalize_or_zero()
    }

    /// Direction to the lightest voxel within `reach` voxels of `p` and within `half_angle` (rad)
    /// of `direction`; the nearest of several, and 0 where there is none.
    pub fn to_lightest(&self, p: Vec3, direction: Vec3, half_angle: f32, reach: i32) -> Vec3 {
        let at = self.voxel_of(p);
        let least_cos = libm::cosf(half_angle);
        let (mut best, mut found) = ((i64::MAX, i32::MAX), Vec3::ZERO);
        let side = -reach..=reach;
        for z in side.clone() {
            for y in side.clone() {
                for x in side.clone() {
                    let by = IVec3::new(x, y, z);
                    let Some(index) = self.index(at + by).filter(|_| by != IVec3::ZERO) else {
                        continue;
                    };
                    let to = by.as_vec3();
                    let far = by.length_squared();
                    let seen = far <= reach * reach && to.dot(direction) >= least_cos * to.length();
                    if seen && (self.shadow[index], far) < best {
                        (best, found) = ((self.shadow[index], far), to.normalize());
                    }
                }
            }
        }
        found
    }

    /// Lets light come from another side; `metamers` are all that cast shadow.
    ///
    /// # Errors
    /// A direction at or below the horizon.
    pub fn turn_light(
        &mut self,
        light: Vec3,
        metamers: impl Iterator<Item = Vec3> + Clone,
    ) -> Result<(), Error> {
        let light = light.normalize_or_zero();
        if light.z < 0.1 {
            let what = "light must come from 6 degrees above the horizon or higher";
            return Err(Problem::new(what).into());
        }
        metamers.clone().for_each(|p| self.remove(p));
        self.light_from(light);
        metamers.for_each(|p| self.add(p));
        Ok(())
    }

    /// Makes the voxels whose middles lie inside solid: nothing grows there. They cast no shadow
    /// of their own unless `opaque`, which darkens all voxels below them as well.
    pub fn block(&mut self, bounds: Bounds, opaque: bool, inside: impl Fn(Vec3) -> bool) {
        let low = self.voxel_of(bounds.low).max(IVec3::ZERO);
        let high = self.voxel_of(bounds.high).min(IVec3::from_array(self.size) - 1);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let mut is_below = false;
                for z in (0..=high.z).rev() {
                    let at = IVec3::new(x, y, z);
                    let middle = self.low + (at.as_vec3() + 0.5) * self.voxel;
                    let hit = z >= low.z && inside(middle);
                    let Some(index) = self.index(at) else { continue };
                    match (hit, is_below && opaque) {
                        (true, _) => self.shadow[index] += SOLID,
                        (false, true) => self.shadow[index] += self.darkness(1.0),
                        _ => {}
                    }
                    is_below |= hit;
                }
            }
        }
    }

    /// Shadow that takes a part of the full light; hardly any is left of a part of 1.
    fn darkness(&self, part: f32) -> i64 {
        let part = f64::from(part);
        let shadow = match self.shadows.model {
            ShadowModel::Additive => part * f64::from(self.shadows.full),
            ShadowModel::Multiplicative => -libm::log2((1.0 - part).max(1e-6)),
        };
        (shadow * UNIT).round() as i64
    }

    /// Darkens the voxels inside and below a crown, as leaves do: a tenth of the light is left.
    pub fn shade(&mut self, crown: &Solid) {
        let dark = self.darkness(0.9);
        let bounds = crown.bounds();
        let low = self.voxel_of(bounds.low).max(IVec3::ZERO);
        let high = self.voxel_of(bounds.high).min(IVec3::from_array(self.size) - 1);
        for y in low.y..=high.y {
            for x in low.x..=high.x {
                let mut is_below = false;
                for z in (0..=high.z).rev() {
                    let at = IVec3::new(x, y, z);
                    let middle = self.low + (at.as_vec3() + 0.5) * self.voxel;
                    is_below |= crown.contains(middle);
                    if let Some(index) = self.index(at).filter(|_| is_below) {
                        self.shadow[index] += dark;
                    }
                }
            }
        }
    }

    /// Side of a voxel.
    pub fn voxel(&self) -> f32 {
        self.voxel
    }

    /// Bytes that the grid takes.
    pub fn bytes(&self) -> usize {
        self.shadow.len() * size_of::<i64>()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::defaults;

    fn grid(model: ShadowModel) -> ShadowGrid {
        let shadows = Shadows { model, grid: [24, 20, 16], noise: 0.05, ..defaults() };
        ShadowGrid::new(&shadows, Bounds { low: Vec3::ZERO, high: Vec3::ZERO }, Seed(1))
    }

    #[test]
    fn taking_metamers_away_gives_back_the_very_grid() {
        for model in [ShadowModel::Additive, ShadowModel::Multiplicative] {
            let mut grid = grid(model);
            let before = grid.shadow.clone();
            let mut stream = Seed(2).stream("p", 0);
            let around = Bounds { low: Vec3::new(-16.0, -16.0, -4.0), high: Vec3::splat(20.0) };
            let places: Vec<Vec3> = (0..500).map(|_| around.sample(&mut stream)).collect();
            places.iter().for_each(|p| grid.add(*p));
            assert_ne!(grid.shadow, before);
            // In another order.
            places.iter().rev().for_each(|p| grid.remove(*p));
            assert_eq!(grid.shadow, before);
        }
    }

    #[test]
    fn one_metamer_casts_the_pyramid_of_the_paper() {
        let shadows = Shadows {
            grid: [32, 32, 32],
            noise: 0.0,
            strength: 0.2,
            decay: 2.0,
            depth: 4,
            voxel: 1.0,
            ..defaults()
        };
        let mut grid =
            ShadowGrid::new(&shadows, Bounds { low: Vec3::ZERO, high: Vec3::ZERO }, Seed(1));
        grid.add(Vec3::new(0.0, 0.0, 10.0));
        let shadow_at = |x: f32, y: f32, z: f32| {
            grid.shadow_near(grid.voxel_of(Vec3::new(x, y, z)), IVec3::ZERO)
        };
        for (q, wanted) in [0.2, 0.1, 0.05, 0.025, 0.0125].into_iter().enumerate() {
            let (q, z) = (q as f32, 10.0 - q as f32);
            for (x, y) in [(0.0, 0.0), (q, 0.0), (-q, q), (q, -q)] {
                assert!((shadow_at(x, y, z) - wanted).abs() < 1e-6, "{x} {y} {z}");
            }
            assert_eq!(shadow_at(q + 1.0, 0.0, z), 0.0);
        }
        assert_eq!(shadow_at(0.0, 0.0, 11.0), 0.0);
        assert_eq!(shadow_at(0.0, 0.0, 5.0), 0.0);
        // A bud is not shaded by its own metamer; Q = C - s + a.
        assert!((grid.exposure(Vec3::new(0.0, 0.0, 10.0)) - 1.0).abs() < 1e-6);
        assert!((grid.exposure(Vec3::new(0.0, 0.0, 9.0)) - 1.1).abs() < 1e-6);
    }

    #[test]
    fn multiplicative_exposure_is_the_product_over_all_metamers() {
        let shadows = Shadows {
            model: ShadowModel::Multiplicative,
            grid: [32, 32, 32],
            noise: 0.0,
            strength: 0.441,
            decay: 6.31,
            voxel: 1.0,
            ..defaults()
        };
        let mut grid =
            ShadowGrid::new(&shadows, Bounds { low: Vec3::ZERO, high: Vec3::ZERO }, Seed(1));
        grid.add(Vec3::new(0.0, 0.0, 10.0));
        grid.add(Vec3::new(1.0, 0.0, 11.0));
        // One voxel below the first; one aside and two below the second.
        let wanted = (1.0 - 0.441 / 6.31) * (1.0 - 0.441 * 6.31_f64.powf(-5_f64.sqrt()));
        let found = grid.exposure(Vec3::new(0.0, 0.0, 9.0));
        assert!((f64::from(found) - wanted).abs() < 1e-6, "{found} for {wanted}");
    }

    #[test]
    fn buds_turn_away_from_shadow() {
        let mut grid = grid(ShadowModel::Additive);
        for _ in 0..20 {
            grid.add(Vec3::new(0.0, 0.0, 8.0));
        }
        let beside = Vec3::new(3.2, 0.2, 4.0);
        assert!(grid.against_gradient(beside).x > 0.5);
        assert!(grid.to_lightest(beside, Vec3::X, 0.8, 3).x > 0.5);
        assert!(grid.to_lightest(beside, -Vec3::X, 0.8, 3).x < -0.5);
    }

    #[test]
    fn slanting_light_throws_shadow_to_the_other_side_and_can_be_turned_back() {
        let mut grid = grid(ShadowModel::Additive);
        let metamer = Vec3::new(0.0, 0.0, 8.0);
        grid.add(metamer);
        let before = grid.shadow.clone();
        grid.turn_light(Vec3::new(1.0, 0.0, 1.0), std::iter::once(metamer)).unwrap();
        let shade = |x: f32| grid.exposure(Vec3::new(x, 0.0, 4.0));
        assert!(shade(-4.0) < shade(4.0));
        grid.turn_light(Vec3::Z, std::iter::once(metamer)).unwrap();
        assert_eq!(grid.shadow, before);
        assert!(grid.turn_light(Vec3::X, std::iter::empty()).is_err());
    }
}
