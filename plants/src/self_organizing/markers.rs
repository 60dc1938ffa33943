//! Space by colonization: buds compete for points that mark free space [Palubicki09] §3,
//! [Runions07].
//!
//! Markers lie in the cells of a grid; those of a cell are consecutive, and the first `alive` of
//! them are still free, so that used up space costs nothing.

use super::Markers;
use crate::volume::{self, Bounds, Solid};
use glam::{IVec3, Vec3};
use weald_contract::Seed;

/// No bud.
const NOBODY: u32 = u32::MAX;

/// A bud that looks for space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Seeker {
    /// Where it sits.
    pub at: Vec3,
    /// Unit direction of its axis of sight.
    pub direction: Vec3,
}

/// What a bud was given.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Given {
    /// Markers for which this bud is the nearest that sees them.
    pub count: u32,
    /// Whether it sees any marker: one that sees none never will again.
    pub sees: bool,
    /// Mean direction to its markers, of length 1, or 0.
    pub toward: Vec3,
}

/// The markers that are still free.
pub struct MarkerSet {
    low: Vec3,
    cell: f32,
    size: IVec3,
    /// First marker of each cell, and one more at the end.
    first: Vec<u32>,
    /// Free markers of each cell.
    alive: Vec<u32>,
    places: Vec<Vec3>,
    /// The nearest bud that sees a marker so far, and the square of its distance.
    nearest: Vec<(f32, u32)>,
}

impl MarkerSet {
    /// Markers spread evenly by chance over the union of solids, as many as asked for.
    pub fn scatter(markers: &Markers, solids: &[Solid], seed: Seed) -> Self {
        let places = scattered(solids, markers.count, seed);
        Self::new(places, markers.sight)
    }

    /// Markers at given places, for buds that see as far as `sight`.
    pub fn new(places: Vec<Vec3>, sight: f32) -> Self {
        let around = places.iter().fold(Bounds::NONE, |sum, p| sum.with_point(*p));
        let around =
            if places.is_empty() { Bounds { low: Vec3::ZERO, high: Vec3::ZERO } } else { around };
        let extent = around.high - around.low;
        // Cells of half the sight: a cone of a quarter turn then meets about as much empty
        // corner as with smaller cells, which cost more looking up. A lone far marker must not
        // ask for more cells than there is memory.
        let roomy = libm::cbrtf(extent.x.max(1.0) * extent.y.max(1.0) * extent.z.max(1.0) / 4e6);
        let cell = (0.5 * sight).max(roomy);
        let size = (extent / cell).floor().as_ivec3() + 1;
        let mut set = Self {
            low: around.low,
            cell,
            size,
            first: vec![0; size.element_product() as usize + 1],
            alive: vec![0; size.element_product() as usize],
            nearest: vec![(f32::INFINITY, NOBODY); places.len()],
            places: Vec::new(),
        };
        set.fill(&places);
        set
    }

    /// Sorts markers into cells, keeping their order within a cell.
    fn fill(&mut self, places: &[Vec3]) {
        let cells: Vec<u32> =
            places.iter().map(|p| self.cell_index(self.cell_of(*p)) as u32).collect();
        for cell in &cells {
            self.alive[*cell as usize] += 1;
        }
        for cell in 0..self.alive.len() {
            self.first[cell + 1] = self.first[cell] + self.alive[cell];
        }
        let mut next = self.first.clone();
        self.places = vec![Vec3::ZERO; places.len()];
        for (place, cell) in places.iter().zip(cells) {
            let slot = &mut next[cell as usize];
            self.places[*slot as usize] = *place;
            *slot += 1;
        }
    }

    fn cell_of(&self, p: Vec3) -> IVec3 {
        ((p - self.low) / self.cell).floor().as_ivec3().clamp(IVec3::ZERO, self.size - 1)
    }

    fn cell_index(&self, cell: IVec3) -> usize {
        ((cell.z * self.size.y + cell.y) * self.size.x + cell.x) as usize
    }

    /// Free markers.
    pub fn len(&self) -> usize {
        self.alive.iter().map(|count| *count as usize).sum()
    }

    /// Whether no marker is free.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The free markers, cell by cell.
    pub fn free(&self) -> impl Iterator<Item = Vec3> + '_ {
        let cells = self.alive.iter().zip(&self.first);
        cells.flat_map(|(alive, first)| {
            self.places[*first as usize..(first + alive) as usize].iter().copied()
        })
    }

    /// Calls `visit` with each cell that has free markers and meets the ball.
    fn cells_near(&self, at: Vec3, radius: f32, mut visit: impl FnMut(usize)) {
        let outside = (at + radius).cmplt(self.low).any()
            || (at - radius).cmpgt(self.low + self.size.as_vec3() * self.cell).any();
        if outside {
            return;
        }
        let (from, to) = (self.cell_of(at - radius), self.cell_of(at + radius));
        for z in from.z..=to.z {
            for y in from.y..=to.y {
                let row = self.cell_index(IVec3::new(0, y, z));
                for cell in row + from.x as usize..=row + to.x as usize {
                    if self.alive[cell] > 0 {
                        visit(cell);
                    }
                }
            }
        }
    }

    /// Uses up the markers within `radius` of a place.
    pub fn occupy(&mut self, at: Vec3, radius: f32) {
        let mut near = Vec::new();
        self.cells_near(at, radius, |cell| near.push(cell));
        for cell in near {
            let first = self.first[cell] as usize;
            let mut i = 0;
            while i < self.alive[cell] as usize {
                if self.places[first + i].distance_squared(at) < radius * radius {
                    self.alive[cell] -= 1;
                    self.places.swap(first + i, first + self.alive[cell] as usize);
                } else {
                    i += 1;
                }
            }
        }
    }

    /// Gives each free marker to the nearest bud that sees it, the earlier of two as near.
    ///
    /// A bud sees as far as `sight`, within `half_angle` (rad) of its direction.
    pub fn compete(&mut self, seekers: &[Seeker], sight: f32, half_angle: f32) -> Vec<Given> {
        let mut given = vec![Given::default(); seekers.len()];
        let mut touched = Vec::new();
        let mut nearest = std::mem::take(&mut self.nearest);
        for (index, seeker) in seekers.iter().enumerate() {
            self.seen(seeker, sight, half_angle, |marker, distance2| {
                given[index].sees = true;
                let best = &mut nearest[marker];
                if best.1 == NOBODY {
                    touched.push(marker as u32);
                }
                if distance2 < best.0 {
                    *best = (distance2, index as u32);
                }
            });
        }
        for marker in touched {
            let marker = marker as usize;
            let (distance2, bud) = std::mem::replace(&mut nearest[marker], (f32::INFINITY, NOBODY));
            let (own, seeker) = (&mut given[bud as usize], &seekers[bud as usize]);
            own.count += 1;
            own.toward += (self.places[marker] - seeker.at) / distance2.sqrt();
        }
        given.iter_mut().for_each(|own| own.toward = own.toward.normalize_or_zero());
        self.nearest = nearest;
        given
    }

    /// Calls `visit` with the index and squared distance of each marker that a bud sees.
    #[inline]
    fn seen(
        &self,
        seeker: &Seeker,
        sight: f32,
        half_angle: f32,
        mut visit: impl FnMut(usize, f32),
    ) {
        let Seeker { at, direction } = *seeker;
        let cos = libm::cosf(half_angle);
        let (cos2, sight2) = (cos * cos.abs(), sight * sight);
        // A ball around the cone that is smaller than the whole sight.
        let (middle, radius) = if cos > 0.71 {
            let out = 0.5 * sight / cos;
            (at + direction * out, out)
        } else {
            (at, sight)
        };
        self.cells_near(middle, radius, |cell| {
            let first = self.first[cell] as usize;
            let places = &self.places[first..first + self.alive[cell] as usize];
            for (i, place) in places.iter().enumerate() {
                let to = *place - at;
                let distance2 = to.length_squared();
                let along = to.dot(direction);
                // cos(angle) >= cos(half), squared with its sign so that no root is needed.
                if distance2 <= sight2 && distance2 > 0.0 && along * along.abs() >= cos2 * distance2
                {
                    visit(first + i, distance2);
                }
            }
        });
    }

    /// Adds markers at places. All buds must look again.
    pub fn add(&mut self, more: impl IntoIterator<Item = Vec3>, sight: f32) {
        let places: Vec<Vec3> = self.free().chain(more).collect();
        *self = Self::new(places, sight);
    }

    /// Removes the markers that `inside` holds.
    pub fn erase(&mut self, inside: impl Fn(Vec3) -> bool, sight: f32) {
        let places: Vec<Vec3> = self.free().filter(|p| !inside(*p)).collect();
        *self = Self::new(places, sight);
    }

    /// Bytes that the markers and their grid take.
    pub fn bytes(&self) -> usize {
        self.places.len() * (size_of::<Vec3>() + size_of::<(f32, u32)>())
            + (self.first.len() + self.alive.len()) * size_of::<u32>()
    }
}

/// `count` points spread evenly by chance over the union of solids; fewer if the solids are
/// too thin to be hit.
pub fn scattered(solids: &[Solid], count: u32, seed: Seed) -> Vec<Vec3> {
    let around = volume::bounds(solids);
    let mut stream = seed.stream("markers", 0);
    let mut places = Vec::with_capacity(count as usize);
    let tries = u64::from(count) * 1000;
    for _ in 0..tries {
        if places.len() == count as usize {
            break;
        }
        let p = around.sample(&mut stream);
        if solids.iter().any(|solid| solid.contains(p)) {
            places.push(p);
        }
    }
    places
}

#[cfg(test)]
mod tests {
    use super::*;

    const BOX: Bounds = Bounds { low: Vec3::splat(-10.0), high: Vec3::splat(10.0) };

    fn points(count: usize, seed: u64) -> Vec<Vec3> {
        let mut stream = Seed(seed).stream("points", 0);
        (0..count).map(|_| BOX.sample(&mut stream)).collect()
    }

    /// Buds and what each is given, by comparing all with all.
    fn brute(places: &[Vec3], buds: &[Seeker], sight: f32, half_angle: f32) -> Vec<(u32, Vec3)> {
        let mut given = vec![(0, Vec3::ZERO); buds.len()];
        for place in places {
            let sees = |bud: &Seeker| {
                let to = *place - bud.at;
                to.length() <= sight && bud.direction.angle_between(to) <= half_angle
            };
            let distance = |bud: &Seeker| bud.at.distance(*place);
            let best = (0..buds.len())
                .filter(|i| sees(&buds[*i]))
                .min_by(|a, b| distance(&buds[*a]).total_cmp(&distance(&buds[*b])));
            if let Some(best) = best {
                given[best].0 += 1;
                given[best].1 += (*place - buds[best].at).normalize();
            }
        }
        given
    }

    #[test]
    fn each_marker_goes_to_the_nearest_bud_that_sees_it() {
        for (sight, half_angle) in [(5.0, 0.785), (3.0, 1.3), (4.0, 2.5), (2.0, 0.3)] {
            let places = points(4_000, 1);
            let directions = points(300, 3);
            let buds: Vec<Seeker> = points(300, 2)
                .into_iter()
                .zip(directions)
                .map(|(at, direction)| Seeker { at, direction: direction.normalize() })
                .collect();
            let mut set = MarkerSet::new(places.clone(), 5.0);
            let found = set.compete(&buds, sight, half_angle);
            let wanted = brute(&places, &buds, sight, half_angle);
            assert!(wanted.iter().any(|(count, _)| *count > 1));
            for (found, (count, sum)) in found.iter().zip(wanted) {
                assert_eq!(found.count, count, "{sight} {half_angle}");
                assert!(found.toward.distance(sum.normalize_or_zero()) < 1e-3);
            }
            // A second round finds the same: nothing of the first remains.
            assert_eq!(set.compete(&buds, sight, half_angle), found);
        }
    }

    #[test]
    fn occupied_space_is_used_up_and_no_other() {
        let places = points(3_000, 4);
        let mut set = MarkerSet::new(places.clone(), 4.0);
        let occupied = points(60, 5);
        occupied.iter().for_each(|at| set.occupy(*at, 2.0));
        let mut left: Vec<Vec3> = set.free().collect();
        let mut wanted: Vec<Vec3> = places
            .into_iter()
            .filter(|p| occupied.iter().all(|at| at.distance(*p) >= 2.0))
            .collect();
        let by_x = |a: &Vec3, b: &Vec3| a.x.total_cmp(&b.x);
        left.sort_by(by_x);
        wanted.sort_by(by_x);
        assert_eq!(left, wanted);
    }

    #[test]
    fn markers_can_be_painted_and_erased() {
        let mut set = MarkerSet::new(Vec::new(), 4.0);
        assert!(set.is_empty());
        set.add(points(100, 6), 4.0);
        assert_eq!(set.len(), 100);
        set.erase(|p| p.x > 0.0, 4.0);
        assert!(set.free().all(|p| p.x <= 0.0) && !set.is_empty());
    }
}
