//! Depression filling, tile by tile.
//!
//! Every cell is raised to the lowest level at which water could leave it, the minimax over all
//! paths to the rim: a unique surface that any correct method gives bit for bit.
//!
//! A cell holds no more water than the lowest cell that it leads down to, or than its own altitude
//! if that is higher. So it is enough to know how high water stands in each catchment of such a
//! lowest cell, and that is decided by the ways over which catchments meet: each is joined to the
//! one behind its lowest way out, below which it cannot stand, again and again [Nesetril01]. All
//! loops are over cells, ways or catchments in their order; nothing waits in a queue.
//!
//! The grid is cut into tiles that fit in a processor's own cache, so that cost does not grow with
//! the size of the grid and threads share the tiles. What a tile cannot know is the lowest way out of
//! a catchment on its rim; what is joined to one is that rim's watershed. Where two watersheds
//! touch, in a tile or between two, the lowest pass is kept. The graph of watersheds and passes is
//! small; flooded from outside it gives the level of each watershed, below which none of its cells
//! can stand [Barnes16].

use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cells along a tile's side: altitudes, steps and labels of a tile take 650 kB.
const SIDE: usize = 256;

/// The lowest level at which water can leave each cell over eight neighbours and an open rim.
///
/// `altitude` holds `width * height` values, fewer than 2³² of them, finite but for NaN in holes:
/// water leaves the grid through them as over the rim, and their level is NaN. Levels are altitudes
/// of the grid, bit for bit, whatever the number of threads.
pub fn levels(width: usize, height: usize, altitude: &[f32]) -> Vec<f32> {
    levels_in_tiles(width, height, altitude, SIDE)
}

fn levels_in_tiles(width: usize, height: usize, altitude: &[f32], side: usize) -> Vec<f32> {
    assert_eq!(altitude.len(), width * height, "altitudes fit the grid");
    if altitude.is_empty() {
        return Vec::new();
    }
    let mut level = vec![0.0f32; altitude.len()];
    let mut label = vec![NONE; altitude.len()];
    let band = width * side;
    let bands = altitude.par_chunks(band).zip(level.par_chunks_mut(band));
    let bands = bands.zip(label.par_chunks_mut(band));
    // Bands of tiles, each with the passes in its tiles; watersheds are counted tile by tile.
    let flooded: Vec<Vec<Flooded>> = bands
        .map_init(Tile::default, |tile, ((altitude, level), label)| {
            let columns = (0..width).step_by(side).map(|west| west..(west + side).min(width));
            columns
                .map(|columns| {
                    tile.load(width, columns.clone(), altitude);
                    tile.flood();
                    tile.store(width, columns, level, label);
                    let (passes, holes) = (tile.passes.take(), tile.holes.clone());
                    Flooded { watersheds: tile.watersheds, passes, holes }
                })
                .collect()
        })
        .collect();

    let tiles_across = width.div_ceil(side);
    let mut first = Vec::with_capacity(flooded.len() * tiles_across);
    let mut watersheds = OUTSIDE + 1;
    let mut passes = Vec::new();
    for Flooded { watersheds: count, passes: inside, holes } in flooded.into_iter().flatten() {
        first.push(watersheds);
        let number = |label: u16| watersheds + u32::from(label) - 1;
        passes.extend(holes.into_iter().map(|hole| (OUTSIDE, number(hole), BOTTOMLESS)));
        passes.extend(inside.into_iter().map(|((a, b), level)| (number(a), number(b), level)));
        watersheds += u32::from(count);
    }
    let map = Map { width, height, side, tiles_across, altitude, label: &label, first: &first };
    map.add_passes_between_tiles(&mut passes);
    let stands = flood_watersheds(watersheds as usize, &passes);

    let bands = level.par_chunks_mut(band).zip(label.par_chunks(band)).enumerate();
    bands.for_each(|(down, (level, label))| {
        let rows = level.chunks_exact_mut(width).zip(label.chunks_exact(width));
        for (level, label) in rows {
            for (across, (level, label)) in
                level.chunks_mut(side).zip(label.chunks(side)).enumerate()
            {
                let stands = &stands[first[down * tiles_across + across] as usize - 1..];
                for (level, label) in level.iter_mut().zip(label) {
                    let stands = level.max(stands[*label as usize]);
                    *level = if stands == BOTTOMLESS { f32::NAN } else { stands };
                }
            }
        }
    });
    level
}

/// What is left of a tile when it is flooded.
struct Flooded {
    watersheds: u16,
    passes: Vec<((u16, u16), f32)>,
    /// Watersheds of holes.
    holes: Vec<u16>,
}

/// Altitude of a hole: what flows there is gone.
const BOTTOMLESS: f32 = f32::NEG_INFINITY;

/// Label of what is around a tile, and of cells that have none yet.
const NONE: u16 = 0;

/// The lowest ground between two catchments, or a way between two cells of them.
#[derive(Clone, Copy)]
struct Pass {
    between: [u16; 2],
    level: f32,
}

/// A tile while its cells are joined. Arrays of cells have a border of one cell, so that the inner
/// loops need no test for the rim.
#[derive(Default)]
struct Tile {
    width: usize,
    height: usize,
    /// Altitude, infinite on the border.
    altitude: Vec<f32>,
    /// Step to the lowest cell among a cell and its neighbours, the first of equals.
    downhill: Vec<i32>,
    /// Catchment of each cell, counted from 1.
    label: Vec<u16>,
    /// Cells on the way to a catchment's floor.
    path: Vec<usize>,
    ways: Vec<Pass>,
    catchments: Catchments,
    watersheds: u16,
    passes: Passes,
    /// Catchments of holes, then their watersheds.
    holes: Vec<u16>,
}

impl Tile {
    fn stride(&self) -> usize {
        self.width + 2
    }

    fn load(&mut self, width: usize, columns: std::ops::Range<usize>, altitude: &[f32]) {
        (self.width, self.height) = (columns.len(), altitude.len() / width);
        let stride = self.stride();
        let len = stride * (self.height + 2);
        self.altitude.clear();
        self.altitude.resize(len, f32::INFINITY);
        self.label.clear();
        self.label.resize(len, NONE);
        self.downhill.resize(len, 0);
        for (row, line) in altitude.chunks_exact(width).enumerate() {
            let start = (row + 1) * stride + 1;
            let cells = self.altitude[start..][..self.width].iter_mut().zip(&line[columns.clone()]);
            cells.for_each(|(here, z)| *here = if z.is_nan() { BOTTOMLESS } else { *z });
        }
    }

    fn flood(&mut self) {
        self.find_downhill();
        let count = self.label_catchments();
        self.find_ways();
        self.catchments.start(count);
        self.open_rim();
        self.holes.iter().for_each(|label| self.catchments.open(*label));
        self.catchments.join(&mut self.ways);
        self.watersheds = self.catchments.number();
        let watershed = |label: &u16| self.catchments.watershed[*label as usize];
        self.holes.iter_mut().for_each(|label| *label = watershed(label));
        for way in &self.ways {
            let [a, b] = way.between.map(|side| self.catchments.watershed[side as usize]);
            self.passes.add(a, b, way.level);
        }
    }

    fn store(
        &self,
        width: usize,
        columns: std::ops::Range<usize>,
        level: &mut [f32],
        label: &mut [u16],
    ) {
        let rows = level.chunks_exact_mut(width).zip(label.chunks_exact_mut(width));
        let Catchments { floor, watershed, .. } = &self.catchments;
        for (row, (level, label)) in rows.enumerate() {
            let start = (row + 1) * self.stride() + 1;
            let cells = level[columns.clone()].iter_mut().zip(&mut label[columns.clone()]);
            let found = self.altitude[start..].iter().zip(&self.label[start..]);
            for ((level, label), (altitude, catchment)) in cells.zip(found) {
                *level = altitude.max(floor[*catchment as usize]);
                *label = watershed[*catchment as usize];
            }
        }
    }

    /// A plain loop over rows, which compiles to vector instructions.
    fn find_downhill(&mut self) {
        let (stride, width) = (self.stride(), self.width);
        let far = stride as i32;
        for row in 1..=self.height {
            let line = |row: usize, column: usize| &self.altitude[row * stride + column..][..width];
            let [north_west, north, north_east] = [0, 1, 2].map(|column| line(row - 1, column));
            let [west, here, east] = [0, 1, 2].map(|column| line(row, column));
            let [south_west, south, south_east] = [0, 1, 2].map(|column| line(row + 1, column));
            let downhill = &mut self.downhill[row * stride + 1..][..width];
            for i in 0..width {
                let mut lowest = (north_west[i], -far - 1);
                let mut look = |altitude: f32, step: i32| {
                    let is_lower = altitude < lowest.0;
                    lowest.0 = if is_lower { altitude } else { lowest.0 };
                    lowest.1 = if is_lower { step } else { lowest.1 };
                };
                look(north[i], -far);
                look(north_east[i], 1 - far);
                look(west[i], -1);
                look(here[i], 0);
                look(east[i], 1);
                look(south_west[i], far - 1);
                look(south[i], far);
                look(south_east[i], far + 1);
                downhill[i] = lowest.1;
            }
        }
    }

    /// Labels every cell with the lowest cell that it leads down to; returns their number.
    ///
    /// No two of those touch, so that fewer than 2¹⁶ of them fit in a tile of 2¹⁸ cells.
    fn label_catchments(&mut self) -> usize {
        let mut count = NONE;
        self.holes.clear();
        for row in 1..=self.height {
            let start = row * self.stride() + 1;
            for first in start..start + self.width {
                let mut cell = first;
                while self.label[cell] == NONE {
                    self.path.push(cell);
                    let step = self.downhill[cell];
                    if step == 0 {
                        count += 1;
                        self.label[cell] = count;
                        if self.altitude[cell] == BOTTOMLESS {
                            self.holes.push(count);
                        }
                    }
                    cell = cell.wrapping_add_signed(step as isize);
                }
                let label = self.label[cell];
                self.path.drain(..).for_each(|cell| self.label[cell] = label);
            }
        }
        count.into()
    }

    /// All ways from a cell to the next that lead from one catchment into another.
    fn find_ways(&mut self) {
        self.ways.clear();
        let stride = self.stride();
        for row in 1..=self.height {
            let start = row * stride + 1;
            for cell in start..start + self.width {
                let here = self.label[cell];
                let onward = [cell + 1, cell + stride - 1, cell + stride, cell + stride + 1];
                let labels = onward.map(|next| self.label[next]);
                if labels == [here; 4] {
                    continue;
                }
                for (next, label) in onward.into_iter().zip(labels) {
                    if label != here && label != NONE {
                        let level = self.altitude[cell].max(self.altitude[next]);
                        self.ways.push(Pass { between: [here, label], level });
                    }
                }
            }
        }
    }

    /// Nobody in the tile knows the lowest way out of a catchment on its rim.
    fn open_rim(&mut self) {
        for row in 1..=self.height {
            let is_end = row == 1 || row == self.height;
            let step = if is_end { 1 } else { (self.width - 1).max(1) };
            for column in (1..=self.width).step_by(step) {
                let label = self.label[row * self.stride() + column];
                self.catchments.open(label);
            }
        }
    }
}

/// The catchments of a tile while they are joined, by label; none has label 0.
#[derive(Default)]
struct Catchments {
    /// What a catchment was joined to; itself while it is alone or others were joined to it.
    root: Vec<u16>,
    /// The level of the way by which it was joined: water stands no lower in it.
    floor: Vec<f32>,
    /// Level and number of its lowest way out; catchments that touch the rim have none.
    lowest: Vec<(f32, u32)>,
    /// Watershed of the rim that it drains to, counted from 1.
    watershed: Vec<u16>,
    /// Those that do not touch the rim and are not joined to others yet.
    closed: Vec<u16>,
    /// Those that were joined, first to last.
    joined: Vec<u16>,
}

/// The lowest way out of what touches the rim: no way is lower.
const OPEN: (f32, u32) = (f32::NEG_INFINITY, u32::MAX);

impl Catchments {
    fn start(&mut self, count: usize) {
        self.root.clear();
        self.root.extend(0..=count as u16);
        self.floor.clear();
        self.floor.resize(count + 1, f32::NEG_INFINITY);
        self.lowest.clear();
        self.lowest.resize(count + 1, (f32::INFINITY, u32::MAX));
    }

    fn open(&mut self, label: u16) {
        self.lowest[label as usize] = OPEN;
    }

    fn is_open(&self, label: u16) -> bool {
        self.lowest[label as usize].0 == OPEN.0
    }

    /// Joins each catchment to the one behind its lowest way out, until all have joined one on the
    /// rim; what is left of the ways lies between those.
    ///
    /// Ways of one level follow their order in the list, so that two catchments may choose the same
    /// way, but never three a circle of ways.
    fn join(&mut self, ways: &mut Vec<Pass>) {
        self.joined.clear();
        self.closed.clear();
        let labels = 1..self.root.len() as u16;
        self.closed.extend(labels.filter(|label| self.lowest[*label as usize].0 != OPEN.0));
        while !self.closed.is_empty() {
            for (number, way) in ways.iter().enumerate() {
                for side in way.between {
                    let lowest = &mut self.lowest[side as usize];
                    if way.level < lowest.0 {
                        *lowest = (way.level, number as u32);
                    }
                }
            }
            let before = self.joined.len();
            for &label in &self.closed {
                let (level, number) = self.lowest[label as usize];
                let [a, b] = ways[number as usize].between;
                let behind = if a == label { b } else { a };
                let is_mutual = !self.is_open(behind) && self.lowest[behind as usize].1 == number;
                if !(is_mutual && label < behind) {
                    self.root[label as usize] = behind;
                    self.floor[label as usize] = level;
                    self.joined.push(label);
                }
            }
            for &label in &self.joined[before..] {
                let mut root = self.root[label as usize];
                while self.root[root as usize] != root {
                    root = self.root[root as usize];
                }
                // Ways get no higher towards the root: the first one is the floor of all.
                self.root[label as usize] = root;
            }
            ways.retain_mut(|way| {
                way.between = way.between.map(|side| self.root[side as usize]);
                way.between[0] != way.between[1]
            });
            self.closed.retain(|label| self.root[*label as usize] == *label);
            for &label in &self.closed {
                self.lowest[label as usize] = (f32::INFINITY, u32::MAX);
            }
        }
    }

    /// Numbers the watersheds and tells all that was joined; returns their number.
    fn number(&mut self) -> u16 {
        let mut count = NONE;
        self.watershed.clear();
        self.watershed.resize(self.root.len(), NONE);
        for label in 1..self.root.len() {
            if self.root[label] == label as u16 {
                count += 1;
                self.watershed[label] = count;
            }
        }
        for &label in self.joined.iter().rev() {
            let root = self.root[label as usize] as usize;
            let floor = self.floor[root];
            self.watershed[label as usize] = self.watershed[root];
            self.floor[label as usize] = self.floor[label as usize].max(floor);
        }
        count
    }
}

/// The lowest pass between each two watersheds of a tile: a hash table with open addresses.
#[derive(Default)]
struct Passes {
    slots: Vec<((u16, u16), f32)>,
    count: usize,
}

const EMPTY: ((u16, u16), f32) = ((0, 0), f32::INFINITY);

impl Passes {
    #[inline]
    fn add(&mut self, a: u16, b: u16, level: f32) {
        if self.count * 2 >= self.slots.len() {
            self.grow();
        }
        let pair = if a < b { (a, b) } else { (b, a) };
        let place = self.place(pair);
        let slot = &mut self.slots[place];
        if slot.0 == EMPTY.0 {
            self.count += 1;
            *slot = (pair, level);
        } else if level < slot.1 {
            slot.1 = level;
        }
    }

    #[inline]
    fn place(&self, pair: (u16, u16)) -> usize {
        let mask = self.slots.len() - 1;
        let bits = u32::from(pair.0) << 16 | u32::from(pair.1);
        let mut place = (bits.wrapping_mul(0x9E37_79B1) >> 12) as usize & mask;
        while self.slots[place].0 != pair && self.slots[place].0 != EMPTY.0 {
            place = (place + 1) & mask;
        }
        place
    }

    fn grow(&mut self) {
        let length = (self.slots.len() * 2).max(1024);
        let old = std::mem::replace(&mut self.slots, vec![EMPTY; length]);
        for slot in old.into_iter().filter(|slot| slot.0 != EMPTY.0) {
            let place = self.place(slot.0);
            self.slots[place] = slot;
        }
    }

    /// What was gathered, in no order that matters; leaves the table empty.
    fn take(&mut self) -> Vec<((u16, u16), f32)> {
        let found = self.slots.iter().filter(|slot| slot.0 != EMPTY.0).copied().collect();
        self.slots.fill(EMPTY);
        self.count = 0;
        found
    }
}

/// Number of what lies around the grid, in the graph of watersheds.
const OUTSIDE: u32 = 0;

/// All tiles, labelled.
struct Map<'a> {
    width: usize,
    height: usize,
    side: usize,
    tiles_across: usize,
    altitude: &'a [f32],
    label: &'a [u16],
    /// Number of each tile's first watershed.
    first: &'a [u32],
}

impl Map<'_> {
    fn watershed(&self, column: usize, row: usize) -> u32 {
        let tile = row / self.side * self.tiles_across + column / self.side;
        self.first[tile] + u32::from(self.label[row * self.width + column]) - 1
    }

    /// Cells on the rims of tiles still stand at their altitude.
    fn add_passes_between_tiles(&self, passes: &mut Vec<(u32, u32, f32)>) {
        let (width, height, side) = (self.width, self.height, self.side);
        let z = |column, row| self.altitude[row * width + column];
        let mut add = |a: (usize, usize), b: (usize, usize)| {
            let level = z(a.0, a.1).max(z(b.0, b.1));
            let pass = (self.watershed(a.0, a.1), self.watershed(b.0, b.1), level);
            match passes.last_mut() {
                Some(last) if (last.0, last.1) == (pass.0, pass.1) => last.2 = last.2.min(level),
                _ => passes.push(pass),
            }
        };
        for row in (side..height).step_by(side) {
            for column in 0..width {
                for beside in column.saturating_sub(1)..(column + 2).min(width) {
                    add((column, row), (beside, row - 1));
                }
            }
        }
        for column in (side..width).step_by(side) {
            for row in 0..height {
                for beside in row.saturating_sub(1)..(row + 2).min(height) {
                    add((column, row), (column - 1, beside));
                }
            }
        }
        for row in 0..height {
            let is_end = row == 0 || row + 1 == height;
            let step = if is_end { 1 } else { (width - 1).max(1) };
            for column in (0..width).step_by(step) {
                passes.push((OUTSIDE, self.watershed(column, row), z(column, row)));
            }
        }
    }
}

/// How high water stands at least in each watershed: the minimax over passes to the outside.
fn flood_watersheds(count: usize, passes: &[(u32, u32, f32)]) -> Vec<f32> {
    // Passes of each watershed, one list after the other.
    let mut start = vec![0u32; count + 1];
    for (a, b, _) in passes {
        start[*a as usize] += 1;
        start[*b as usize] += 1;
    }
    let mut sum = 0;
    for entry in &mut start {
        sum += *entry;
        *entry = sum;
    }
    let mut beside = vec![(OUTSIDE, 0.0f32); sum as usize];
    for &(a, b, level) in passes {
        for (from, to) in [(a, b), (b, a)] {
            start[from as usize] -= 1;
            beside[start[from as usize] as usize] = (to, level);
        }
    }
    let mut stands = vec![f32::INFINITY; count];
    stands[OUTSIDE as usize] = f32::NEG_INFINITY;
    let mut queue = BinaryHeap::from([Reverse(key(f32::NEG_INFINITY, OUTSIDE))]);
    let mut is_done = vec![false; count];
    while let Some(Reverse(key)) = queue.pop() {
        let here = key as u32 as usize;
        if std::mem::replace(&mut is_done[here], true) {
            continue;
        }
        for &(next, pass) in &beside[start[here] as usize..start[here + 1] as usize] {
            let level = stands[here].max(pass);
            if level < stands[next as usize] {
                stands[next as usize] = level;
                queue.push(Reverse(self::key(level, next)));
            }
        }
    }
    stands
}

/// Altitude and cell as one number that sorts by the first, then the second.
#[inline]
pub(crate) fn key(altitude: f32, cell: u32) -> u64 {
    let bits = altitude.to_bits();
    let ordered = if bits >> 31 == 0 { bits | 1 << 31 } else { !bits };
    u64::from(ordered) << 32 | u64::from(cell)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Minimax levels by relaxing every cell until nothing changes.
    fn minimax(width: usize, height: usize, altitude: &[f32]) -> Vec<f32> {
        let on_rim = |x, y| x == 0 || y == 0 || x + 1 == width || y + 1 == height;
        let mut level: Vec<f32> = (0..altitude.len())
            .map(|i| if on_rim(i % width, i / width) { altitude[i] } else { f32::INFINITY })
            .map(|z| if z.is_nan() { BOTTOMLESS } else { z })
            .collect();
        loop {
            let before = level.clone();
            for i in (0..level.len()).filter(|i| !on_rim(i % width, i / width)) {
                let lowest = [i - width - 1, i - width, i - width + 1, i - 1, i + 1]
                    .into_iter()
                    .chain([i + width - 1, i + width, i + width + 1])
                    .map(
                        |beside| if altitude[beside].is_nan() { BOTTOMLESS } else { level[beside] },
                    )
                    .fold(f32::MAX, f32::min);
                level[i] = level[i].min(lowest.max(altitude[i]));
            }
            if level == before {
                let cells = level.iter().zip(altitude);
                return cells.map(|(level, z)| if z.is_nan() { *z } else { *level }).collect();
            }
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn tiles_of_any_size_give_the_minimax_surface_bit_for_bit(
            width in 1usize..40,
            height in 1usize..40,
            side in 1usize..20,
            steps in 1u64..400,
            holes in 0.0..0.2,
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            // Few steps make plateaus, negative values try the queue's order.
            let mut altitude: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37 - 20.0).collect();
            let mut pierce = |z: &mut f32| *z = if stream.unit() < holes { f32::NAN } else { *z };
            altitude.iter_mut().for_each(&mut pierce);
            let bits = |levels: Vec<f32>| levels.into_iter().map(f32::to_bits).collect::<Vec<_>>();
            let expected = bits(minimax(width, height, &altitude));
            prop_assert_eq!(&bits(levels_in_tiles(width, height, &altitude, side)), &expected);
            prop_assert_eq!(&bits(levels(width, height, &altitude)), &expected);
        }
    }

    #[test]
    fn rough_hills_in_many_tiles_and_in_one_fill_alike() {
        let hills = crate::flow::rough_hills(300);
        let whole = levels_in_tiles(300, 300, &hills, 300);
        for side in [7, 64, 150, 256] {
            assert_eq!(levels_in_tiles(300, 300, &hills, side), whole, "tiles of {side}");
        }
        assert!(whole.iter().zip(&hills).filter(|(a, b)| a > b).count() > 1000, "it has hollows");
    }
}
