//! The area above every cell along single ways, tile by tile.
//!
//! Water is added up within a tile while the tile is in a processor's own cache. What passes from
//! tile to tile forms a forest over the cells by which it enters them: small enough to be summed at
//! once. At last what enters each tile is led through it [Barnes17]. So cost does not grow with the
//! size of the grid, and threads share the tiles.

use crate::flow::{OUT, STEPS};
use rayon::prelude::*;

/// Cells along a tile's side: what a tile needs takes 600 kB.
const SIDE: usize = 256;

/// Number of cells that drain through each, itself included, along `directions`.
///
/// `directions` are those of [`crate::flow::directions`], of fewer than 2³² cells; the numbers are
/// exact. Cells of ways that run in a circle keep what reached them before.
pub fn drained_cells(width: usize, directions: &[u8]) -> Vec<u32> {
    drained_cells_in_tiles(width, directions, SIDE)
}

fn drained_cells_in_tiles(width: usize, directions: &[u8], side: usize) -> Vec<u32> {
    let height = directions.len() / width.max(1);
    let map = Map { width, height, side, directions };
    let mut cells = vec![0u32; directions.len()];
    let band = (width * side).max(1);
    let crossings: Vec<Vec<Crossings>> = (0..height.div_ceil(side))
        .into_par_iter()
        .map_init(Tile::default, |tile, down| {
            let across = 0..width.div_ceil(side);
            let crossings = across.map(|across| {
                tile.load(&map, across, down);
                tile.add_up();
                tile.crossings(&map)
            });
            crossings.collect()
        })
        .collect();
    let inflow = inflow(&map, &crossings);
    cells.par_chunks_mut(band).zip(crossings).enumerate().for_each_init(
        Tile::default,
        |tile, (down, (cells, crossings))| {
            for (across, crossings) in crossings.into_iter().enumerate() {
                tile.load(&map, across, down);
                for (entry, _) in crossings.entries {
                    let place = tile.place(&map, entry);
                    tile.cells[place] += inflow[map.place(entry)];
                }
                tile.add_up();
                tile.store(width, cells);
            }
        },
    );
    cells
}

/// The ways, cut into tiles.
struct Map<'a> {
    width: usize,
    height: usize,
    side: usize,
    directions: &'a [u8],
}

impl Map<'_> {
    /// Place of a cell of a tile's rim among all such cells.
    fn place(&self, cell: u32) -> usize {
        let (column, row) = (cell as usize % self.width, cell as usize / self.width);
        let (x, y) = (column % self.side, row % self.side);
        let tile = row / self.side * self.width.div_ceil(self.side) + column / self.side;
        let along = match () {
            () if y == 0 => x,
            () if x == 0 => self.side + y,
            () if y + 1 == self.side || row + 1 == self.height => 2 * self.side + x,
            () => 3 * self.side + y,
        };
        tile * 4 * self.side + along
    }

    fn places(&self) -> usize {
        self.width.div_ceil(self.side) * self.height.div_ceil(self.side) * 4 * self.side
    }
}

/// No cell: water that stays in a tile leads to none beyond.
const NOWHERE: u32 = u32::MAX;

/// What passes the rim of a tile.
struct Crossings {
    /// Cells beyond the rim, with the cells of this tile alone that drain to them.
    leaving: Vec<(u32, u32)>,
    /// Cells that are drained to from beyond, with the one beyond that they lead to in turn.
    entries: Vec<(u32, u32)>,
}

/// How much enters each tile by each cell of its rim, from everywhere.
fn inflow(map: &Map<'_>, crossings: &[Vec<Crossings>]) -> Vec<u32> {
    let mut inflow = vec![0u32; map.places()];
    let mut onward = vec![NOWHERE; map.places()];
    let mut waiting = vec![0u32; map.places()];
    for crossings in crossings.iter().flatten() {
        for &(beyond, amount) in &crossings.leaving {
            inflow[map.place(beyond)] += amount;
        }
        for &(entry, beyond) in crossings.entries.iter().filter(|(_, to)| *to != NOWHERE) {
            let to = map.place(beyond);
            onward[map.place(entry)] = to as u32;
            waiting[to] += 1;
        }
    }
    for start in 0..inflow.len() {
        let mut place = start;
        while waiting[place] == 0 {
            waiting[place] = NOWHERE;
            if onward[place] == NOWHERE {
                break;
            }
            let next = onward[place] as usize;
            inflow[next] += inflow[place];
            waiting[next] -= 1;
            place = next;
        }
    }
    inflow
}

/// Low bits of a state: how many neighbours are still to arrive. The border waits for more than there
/// are.
const WAITING: u8 = 15;

/// A tile with a border of one cell, which receives what leaves.
#[derive(Default)]
struct Tile {
    /// North-west cell.
    west: usize,
    north: usize,
    width: usize,
    height: usize,
    /// Direction times 16, plus how many neighbours are still to arrive.
    state: Vec<u8>,
    cells: Vec<u32>,
    /// Cells to which nothing more can come, in the order in which that is found.
    ready: Vec<u32>,
    /// Where the way from a cell leaves the tile: its place in the border plus 1, 0 while unknown.
    end: Vec<u32>,
    way: Vec<usize>,
}

/// The way from a cell ends within the tile.
const ENDS_INSIDE: u32 = u32::MAX;

impl Tile {
    fn stride(&self) -> usize {
        self.width + 2
    }

    fn steps(&self) -> [isize; 8] {
        STEPS.map(|(right, down)| down * self.stride() as isize + right)
    }

    /// Reads the directions; nobody waits yet.
    fn load(&mut self, map: &Map<'_>, across: usize, down: usize) {
        (self.west, self.north) = (across * map.side, down * map.side);
        self.width = map.side.min(map.width - self.west);
        self.height = map.side.min(map.height - self.north);
        let stride = self.stride();
        let len = stride * (self.height + 2);
        self.state.clear();
        self.state.resize(len, OUT << 4 | WAITING);
        self.cells.clear();
        self.cells.resize(len, 0);
        self.end.clear();
        self.end.resize(len, 0);
        for row in 0..self.height {
            self.cells[(row + 1) * stride + 1..][..self.width].fill(1);
            let from = &map.directions[(self.north + row) * map.width + self.west..][..self.width];
            let to = &mut self.state[(row + 1) * stride + 1..][..self.width];
            to.iter_mut().zip(from).for_each(|(state, direction)| *state = direction << 4);
        }
    }

    /// Adds up what stays in the tile, and in the border what leaves it.
    ///
    /// `self.cells` holds what each cell has of itself. Cells to which nothing more can come wait in
    /// a list: no branch hangs on the ground, which no processor could foresee.
    fn add_up(&mut self) {
        self.count_donors();
        let stride = self.stride();
        self.ready.resize(self.state.len() + 1, 0);
        let mut last = 0;
        for row in 1..=self.height {
            for cell in row * stride + 1..row * stride + 1 + self.width {
                self.ready[last] = cell as u32;
                last += usize::from(self.state[cell] & WAITING == 0);
            }
        }
        // Water that leaves the grid takes no step, and nothing along.
        let (mut steps, mut parts) = ([0isize; 16], [0u32; 16]);
        steps[..8].copy_from_slice(&self.steps());
        parts[..8].fill(u32::MAX);
        let mut first = 0;
        while first < last {
            let cell = self.ready[first] as usize;
            first += 1;
            let direction = usize::from(self.state[cell] >> 4);
            let next = cell.wrapping_add_signed(steps[direction]);
            let part = parts[direction];
            self.cells[next] += self.cells[cell] & part;
            let state = self.state[next] - (part & 1) as u8;
            self.state[next] = state;
            self.ready[last] = next as u32;
            last += usize::from(state & WAITING == 0) & (part & 1) as usize;
        }
    }

    fn count_donors(&mut self) {
        let (stride, steps) = (self.stride(), self.steps());
        let mut donors = vec![0u8; self.width];
        for row in 1..=self.height {
            let first = row * stride + 1;
            donors.fill(0);
            for (direction, step) in (0u8..8).zip(steps) {
                // Who drains here in this direction lies against it; the border drains nowhere.
                let from = &self.state[first.wrapping_add_signed(-step)..][..self.width];
                for (count, state) in donors.iter_mut().zip(from) {
                    *count += u8::from(state >> 4 == direction);
                }
            }
            // Directions stay in the high bits, where rows to come see them.
            let states = self.state[first..][..self.width].iter_mut();
            states.zip(&donors).for_each(|(state, donors)| *state |= donors);
        }
    }

    fn store(&self, width: usize, cells: &mut [u32]) {
        for (row, line) in cells.chunks_exact_mut(width).enumerate() {
            let from = &self.cells[(row + 1) * self.stride() + 1..][..self.width];
            line[self.west..][..self.width].copy_from_slice(from);
        }
    }

    fn crossings(&mut self, map: &Map<'_>) -> Crossings {
        let stride = self.stride();
        let steps = self.steps();
        let (mut leaving, mut entries) = (Vec::new(), Vec::new());
        for place in self.border() {
            let Some(beyond) = self.cell(map, place) else { continue };
            if self.cells[place] > 0 {
                leaving.push((beyond, self.cells[place]));
            }
            let direction = map.directions[beyond as usize];
            if direction >= OUT {
                continue;
            }
            let entry = place.wrapping_add_signed(steps[direction as usize & 7]);
            let (column, row) = (entry % stride, entry / stride);
            let is_inside = (1..=self.width).contains(&column) && (1..=self.height).contains(&row);
            // A step from the rim of one row may land in the next: distances tell.
            let is_beside = column.abs_diff(place % stride) <= 1;
            if is_inside && is_beside {
                entries.push(entry);
            }
        }
        entries.sort_unstable();
        entries.dedup();
        let entries = entries.into_iter().filter_map(|entry| {
            let end = self.end_of(entry, &steps);
            let beyond = if end == ENDS_INSIDE { None } else { self.cell(map, end as usize - 1) };
            Some((self.cell(map, entry)?, beyond.unwrap_or(NOWHERE)))
        });
        Crossings { leaving, entries: entries.collect() }
    }

    /// Places of the border's cells.
    fn border(&self) -> impl Iterator<Item = usize> + use<> {
        let (stride, height) = (self.stride(), self.height);
        let ends = (0..stride).chain((height + 1) * stride..(height + 2) * stride);
        ends.chain((1..=height).flat_map(move |row| [row * stride, (row + 1) * stride - 1]))
    }

    /// Place of one of the tile's cells.
    fn place(&self, map: &Map<'_>, cell: u32) -> usize {
        let (column, row) = (cell as usize % map.width, cell as usize / map.width);
        (row - self.north + 1) * self.stride() + column - self.west + 1
    }

    /// The grid's cell at a place of the tile or its border.
    fn cell(&self, map: &Map<'_>, place: usize) -> Option<u32> {
        let column = (self.west + place % self.stride()).checked_sub(1)?;
        let row = (self.north + place / self.stride()).checked_sub(1)?;
        let is_on_grid = column < map.width && row < map.height;
        is_on_grid.then_some((row * map.width + column) as u32)
    }

    /// Where the way from a cell leaves the tile.
    fn end_of(&mut self, start: usize, steps: &[isize; 8]) -> u32 {
        let mut cell = start;
        let end = loop {
            if self.end[cell] != 0 {
                break self.end[cell];
            }
            // Whoever comes back here runs in a circle.
            self.end[cell] = ENDS_INSIDE;
            self.way.push(cell);
            let direction = self.state[cell] >> 4;
            if direction >= OUT {
                let is_border = !(1..=self.width).contains(&(cell % self.stride()))
                    || !(1..=self.height).contains(&(cell / self.stride()));
                break if is_border { cell as u32 + 1 } else { ENDS_INSIDE };
            }
            cell = cell.wrapping_add_signed(steps[direction as usize & 7]);
        };
        self.way.drain(..).for_each(|cell| self.end[cell] = end);
        end
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::{accumulate, directions, fill, rough_hills};
    use proptest::prelude::*;

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(256))]

        #[test]
        fn tiles_of_any_size_count_what_plain_walks_count(
            width in 1usize..40,
            height in 1usize..40,
            side in 1usize..20,
            steps in 1u64..400,
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let altitude: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            let ways = directions(width, height, &fill(width, height, &altitude));
            let plain = accumulate(width, &ways, vec![1.0; ways.len()]);
            for side in [side, SIDE] {
                let cells = drained_cells_in_tiles(width, &ways, side);
                prop_assert!(cells.iter().zip(&plain).all(|(cells, plain)| f64::from(*cells) == *plain));
            }
        }
    }

    #[test]
    fn a_serpentine_through_all_tiles_and_a_circle_end() {
        // East on even rows, west on odd ones, down at their ends.
        let (width, height) = (50, 40);
        let way = |cell: usize| match (cell % width, cell / width) {
            (0, 39) => OUT,
            (49, row) if row % 2 == 0 => 2,
            (0, row) if row % 2 == 1 => 2,
            (_, row) => (row % 2 * 4) as u8,
        };
        let ways: Vec<u8> = (0..width * height).map(way).collect();
        let cells = drained_cells_in_tiles(width, &ways, 7);
        assert_eq!(cells.iter().max(), Some(&2000));
        assert_eq!(cells.iter().map(|n| u64::from(*n)).sum::<u64>(), 2000 * 2001 / 2);
        assert_eq!(drained_cells_in_tiles(3, &[0, 2, OUT, 6, 4, OUT], 2).len(), 6);
    }

    #[test]
    fn hills_of_many_tiles_count_as_one() {
        let ways = directions(300, 300, &fill(300, 300, &rough_hills(300)));
        let whole = drained_cells_in_tiles(300, &ways, 300);
        for side in [7, 64, 150, 256] {
            assert_eq!(drained_cells_in_tiles(300, &ways, side), whole, "tiles of {side}");
        }
    }
}
