//! Depression filling, tile by tile.
//!
//! Every cell is raised to the lowest level at which water could leave it, the minimax over all
//! paths to the rim: a unique surface that any correct method gives bit for bit.
//!
//! The grid is cut into tiles that fit in a processor's own cache, and each is flooded from its own
//! rim, so that cost does not grow with the size of the grid and threads share the tiles. What a
//! tile cannot know is how high water stands beyond its rim. Therefore every cell is labelled with
//! the watershed of the rim that it drains to, and where two watersheds touch, in a tile or between
//! two, the lowest pass is kept. The graph of watersheds and passes is small; flooded from outside
//! it gives the level of each watershed, below which none of its cells can stand [Barnes16].
//!
//! Within a tile this is a priority flood [Barnes14] that, as in [Zhou16], sends rising slopes past
//! the queue: only a cell with something lower behind it can matter to the order. The queue is of
//! buckets over altitude with a small heap in the bucket at work, since floods only ever move on to
//! higher water.

use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Cells along a tile's side: levels, labels and queue of a tile take half a megabyte.
const SIDE: usize = 256;

/// The lowest level at which water can leave each cell over eight neighbours and an open rim.
///
/// `altitude` must be finite and hold `width * height` values, fewer than 2³² of them. The levels
/// are altitudes of the grid, bit for bit, whatever the number of threads.
pub fn levels(width: usize, height: usize, altitude: &[f32]) -> Vec<f32> {
    levels_in_tiles(width, height, altitude, SIDE)
}

fn levels_in_tiles(width: usize, height: usize, altitude: &[f32], side: usize) -> Vec<f32> {
    assert_eq!(altitude.len(), width * height, "altitudes fit the grid");
    if altitude.is_empty() {
        return Vec::new();
    }
    let mut level = vec![0.0f32; altitude.len()];
    let mut label = vec![DRY; altitude.len()];
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
                    Flooded { watersheds: tile.watersheds, passes: tile.passes.take() }
                })
                .collect()
        })
        .collect();

    let tiles_across = width.div_ceil(side);
    let mut first = Vec::with_capacity(flooded.len() * tiles_across);
    let mut watersheds = OUTSIDE + 1;
    let mut passes = Vec::new();
    for Flooded { watersheds: count, passes: inside } in flooded.into_iter().flatten() {
        first.push(watersheds);
        let number = |label: u16| watersheds + u32::from(label) - 1;
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
                    *level = level.max(stands[*label as usize]);
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
}

/// Label of a cell that the flood has not reached.
const DRY: u16 = 0;
/// Label of a cell on the tile's rim that no other has reached, until its turn comes.
const RIM: u16 = u16::MAX - 1;
/// Label of the border around a tile, which is not part of it.
const BORDER: u16 = u16::MAX;

/// A tile while its water rises. Arrays have a border of one cell, so that the inner loops need no
/// test for the rim.
#[derive(Default)]
struct Tile {
    width: usize,
    height: usize,
    /// Altitude of dry cells, level of flooded ones.
    level: Vec<f32>,
    /// Watershed, counted from 1, or one of the three constants above.
    label: Vec<u16>,
    watersheds: u16,
    passes: Passes,
    queue: Buckets,
    /// Cells at or below the current level whose neighbours wait.
    pool: Vec<u32>,
    /// Rising cells whose neighbours wait.
    slope: Vec<u32>,
}

impl Tile {
    fn stride(&self) -> usize {
        self.width + 2
    }

    fn load(&mut self, width: usize, columns: std::ops::Range<usize>, altitude: &[f32]) {
        (self.width, self.height) = (columns.len(), altitude.len() / width);
        let stride = self.stride();
        let len = stride * (self.height + 2);
        self.level.clear();
        self.level.resize(len, 0.0);
        self.label.clear();
        self.label.resize(len, BORDER);
        self.watersheds = 0;
        let (mut low, mut high) = (f32::INFINITY, f32::NEG_INFINITY);
        for (row, line) in altitude.chunks_exact(width).enumerate() {
            let line = &line[columns.clone()];
            let start = (row + 1) * stride + 1;
            self.level[start..][..line.len()].copy_from_slice(line);
            self.label[start..][..line.len()].fill(DRY);
            for z in line {
                (low, high) = (low.min(*z), high.max(*z));
            }
        }
        self.queue.start(low, high, self.width * self.height);
        for row in 1..=self.height {
            let is_end = row == 1 || row == self.height;
            let step = if is_end { 1 } else { (self.width - 1).max(1) };
            for column in (1..=self.width).step_by(step) {
                let cell = row * stride + column;
                self.label[cell] = RIM;
                self.queue.push(self.level[cell], cell as u32);
            }
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
        for (row, (level, label)) in rows.enumerate() {
            let start = (row + 1) * self.stride() + 1;
            level[columns.clone()].copy_from_slice(&self.level[start..][..self.width]);
            label[columns.clone()].copy_from_slice(&self.label[start..][..self.width]);
        }
    }

    fn flood(&mut self) {
        while let Some(cell) = self.queue.pop() {
            let cell = cell as usize;
            if self.label[cell] == RIM {
                self.watersheds += 1;
                self.label[cell] = self.watersheds;
            }
            self.spread(cell);
        }
    }

    fn steps(&self) -> [isize; 8] {
        let stride = self.stride() as isize;
        [1, stride + 1, stride, stride - 1, -1, -stride - 1, -stride, 1 - stride]
    }

    /// Floods everything that is reached from `start` without rising above its level, and all
    /// slopes that rise from there.
    fn spread(&mut self, start: usize) {
        let (level, label, steps) = (self.level[start], self.label[start], self.steps());
        let mut cell = start;
        loop {
            for step in steps {
                let next = cell.wrapping_add_signed(step);
                let beside = self.label[next];
                if beside != DRY {
                    if beside != label {
                        self.meet(label, level, next);
                    }
                    continue;
                }
                self.label[next] = label;
                if self.level[next] <= level {
                    self.level[next] = level;
                    self.pool.push(next as u32);
                } else {
                    self.climb(next, label, steps);
                }
            }
            match self.pool.pop() {
                Some(next) => cell = next as usize,
                None => return,
            }
        }
    }

    /// Takes whatever rises from a cell: a path that only rises keeps every altitude as it is.
    /// Cells with dry ground behind that does not rise wait in the queue for their turn.
    #[inline]
    fn climb(&mut self, start: usize, label: u16, steps: [isize; 8]) {
        let mut cell = start;
        loop {
            let altitude = self.level[cell];
            let mut may_spill = false;
            for step in steps {
                let next = cell.wrapping_add_signed(step);
                let beside = self.label[next];
                if beside != DRY {
                    if beside != label {
                        self.meet(label, altitude, next);
                    }
                } else if self.level[next] > altitude {
                    self.label[next] = label;
                    self.slope.push(next as u32);
                } else {
                    may_spill = true;
                }
            }
            if may_spill {
                self.queue.push(altitude, cell as u32);
            }
            match self.slope.pop() {
                Some(next) => cell = next as usize,
                None => return,
            }
        }
    }

    /// A watershed at `level` meets a cell that has another label: a pass, or a cell of the rim that
    /// joins the watershed because it drains to it. That cell is in the queue already.
    #[inline]
    fn meet(&mut self, label: u16, level: f32, cell: usize) {
        match self.label[cell] {
            BORDER => {}
            RIM if self.level[cell] < level => {}
            RIM => self.label[cell] = label,
            other => self.passes.add(label, other, level.max(self.level[cell])),
        }
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

/// A queue of cells by altitude, lowest first, for altitudes that never fall behind the last one
/// taken.
#[derive(Default)]
struct Buckets {
    low: f32,
    per_meter: f32,
    /// First entry of each bucket's list, or [`END`].
    heads: Vec<u32>,
    /// Altitude and cell as one key, and the next entry.
    entries: Vec<(u64, u32)>,
    current: usize,
    /// Entries of the current bucket by exact altitude, then cell.
    heap: BinaryHeap<Reverse<u64>>,
}

const END: u32 = u32::MAX;

/// Cells for which one bucket is made: few enough that hardly any bucket needs its heap.
const CELLS_PER_BUCKET: usize = 16;

impl Buckets {
    fn start(&mut self, low: f32, high: f32, cells: usize) {
        let count = (cells / CELLS_PER_BUCKET).max(1);
        let per_meter = (count - 1) as f32 / (high - low);
        self.low = low;
        self.per_meter = if per_meter.is_finite() { per_meter } else { 0.0 };
        self.heads.clear();
        self.heads.resize(count, END);
        self.entries.clear();
        self.heap.clear();
        self.current = 0;
    }

    #[inline]
    fn push(&mut self, altitude: f32, cell: u32) {
        let bucket = ((altitude - self.low) * self.per_meter) as usize;
        let bucket = bucket.min(self.heads.len() - 1);
        let key = key(altitude, cell);
        if bucket <= self.current {
            self.heap.push(Reverse(key));
            return;
        }
        self.entries.push((key, self.heads[bucket]));
        self.heads[bucket] = (self.entries.len() - 1) as u32;
    }

    fn pop(&mut self) -> Option<u32> {
        while self.heap.is_empty() && self.current + 1 < self.heads.len() {
            self.current += 1;
            let mut at = self.heads[self.current];
            while at != END {
                let (key, next) = self.entries[at as usize];
                self.heap.push(Reverse(key));
                at = next;
            }
        }
        self.heap.pop().map(|Reverse(key)| key as u32)
    }
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
            .collect();
        loop {
            let before = level.clone();
            for i in (0..level.len()).filter(|i| !on_rim(i % width, i / width)) {
                let lowest = [i - width - 1, i - width, i - width + 1, i - 1, i + 1]
                    .into_iter()
                    .chain([i + width - 1, i + width, i + width + 1])
                    .map(|beside| level[beside])
                    .fold(f32::MAX, f32::min);
                level[i] = level[i].min(lowest.max(altitude[i]));
            }
            if level == before {
                return level;
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
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            // Few steps make plateaus, negative values try the queue's order.
            let altitude: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37 - 20.0).collect();
            let expected = minimax(width, height, &altitude);
            prop_assert_eq!(&levels_in_tiles(width, height, &altitude, side), &expected);
            prop_assert_eq!(&levels(width, height, &altitude), &expected);
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
