//! Where water runs: depression filling, steepest descent, and the area above every cell.
//!
//! **Conventions.** Cells touch eight neighbours. The rim is open: a cell on it may always drain
//! off the grid, and does so unless a neighbour lies lower; it takes part in all flow. Cells of NaN
//! are holes in the grid, with a rim of their own.
//!
//! **Filling** raises every cell to the lowest level at which water could leave it, the minimax
//! over all paths to the rim ([`crate::fill`]); level ground then drains to where it falls.

use crate::fill::key;
use rayon::prelude::*;
use std::cmp::Reverse;
use std::collections::BinaryHeap;

/// Direction codes 0 to 7: east, then clockwise to north-east.
pub const STEPS: [(isize, isize); 8] =
    [(1, 0), (1, 1), (0, 1), (-1, 1), (-1, 0), (-1, -1), (0, -1), (1, -1)];

/// Direction code of water that leaves the grid.
pub const OUT: u8 = 8;

/// One over the distance to each neighbour, in cells.
const PER_DISTANCE: [f32; 8] = {
    const D: f32 = std::f32::consts::FRAC_1_SQRT_2;
    [1.0, D, 1.0, D, 1.0, D, 1.0, D]
};

/// A filled surface and the way the flood came.
#[derive(Clone, Debug, PartialEq)]
pub struct Flood {
    /// Lowest level from which water can leave each cell, at least the cell's altitude; NaN in holes.
    pub level: Vec<f32>,
    /// Direction to a neighbour that is no higher; [`OUT`] on the rim where none is lower, and in
    /// holes.
    /// Following it leads off the grid from anywhere; it is the drain of level ground.
    pub toward: Vec<u8>,
}

/// The index of a cell's neighbour in a direction below 8, in rows of `width`.
#[inline]
pub fn neighbor(cell: usize, direction: u8, width: usize) -> usize {
    let (right, down) = STEPS[direction as usize & 7];
    cell.wrapping_add_signed(down * width as isize + right)
}

/// Fills depressions: the exact minimax surface over eight neighbours with an open rim.
///
/// `altitude` holds `width * height` values, fewer than 2³² of them, finite but for NaN in holes.
///
/// ```
/// // A pit of 1 m in ground of 5 m fills to the notch of 3 m in its rim.
/// let altitude = [5.0, 3.0, 5.0, 5.0, 1.0, 5.0, 5.0, 5.0, 5.0];
/// let flood = weald_terrain::flow::fill(3, 3, &altitude);
/// assert_eq!(flood.level[4], 3.0);
/// ```
pub fn fill(width: usize, height: usize, altitude: &[f32]) -> Flood {
    let level = crate::fill::levels(width, height, altitude);
    let toward = drains(width, height, altitude, &level);
    Flood { level, toward }
}

/// No drain found yet.
const DRY: u8 = 255;

/// The way off the grid from every cell of a filled surface: the steepest way down, and over level
/// ground one that leads to where it falls.
///
/// Level ground is crossed breadth first from all its outlets at once. A hollow that is reached is
/// taken whole before anything else, from the one cell that reached it: it has a single outlet,
/// which drains no water back into it.
fn drains(width: usize, height: usize, altitude: &[f32], level: &[f32]) -> Vec<u8> {
    let mut toward = steepest(width, height, level);
    // Level ground: on the rim it drains at once, inside it waits for a neighbour.
    toward.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        if row > 0 && row + 1 < height && width > 2 {
            for (column, code) in line.iter_mut().enumerate().take(width - 1).skip(1) {
                if *code == OUT && !is_beside_hole(width, level, row * width + column) {
                    *code = DRY;
                }
            }
        }
    });
    let first = |toward: &[u8], cell: usize| {
        let leads = |direction: &u8| {
            let beside = neighbor(cell, *direction, width);
            toward[beside] != DRY && level[beside] == level[cell]
        };
        (0u8..8).find(leads)
    };
    let mut shelf: Vec<(u32, u8)> = (0..level.len())
        .into_par_iter()
        .filter(|cell| toward[*cell] == DRY)
        .filter_map(|cell| first(&toward, cell).map(|direction| (cell as u32, direction)))
        .collect();
    let mut pool: Vec<u32> = Vec::new();
    let mut next = 0;
    while let Some(&(cell, direction)) = shelf.get(next) {
        next += 1;
        let cell = cell as usize;
        if toward[cell] != DRY {
            continue;
        }
        toward[cell] = direction;
        pool.push(cell as u32);
        // A raised cell takes the whole hollow; one at its own altitude leaves its like to the shelf.
        while let Some(from) = pool.pop() {
            let from = from as usize;
            for direction in 0..8 {
                let beside = neighbor(from, direction, width);
                if toward[beside] != DRY || level[beside] != level[from] {
                    continue;
                }
                if level[beside] > altitude[beside] && level[from] > altitude[from] {
                    toward[beside] = direction ^ 4;
                    pool.push(beside as u32);
                } else {
                    shelf.push((beside as u32, direction ^ 4));
                }
            }
        }
    }
    toward
}

/// Whether a cell inside the grid is a hole or touches one.
fn is_beside_hole(width: usize, level: &[f32], cell: usize) -> bool {
    let is_hole = |cell: usize| level[cell].is_nan();
    is_hole(cell) || (0..8).any(|direction| is_hole(neighbor(cell, direction, width)))
}

/// Direction in which water leaves every cell: the steepest way down (the first of equally steep
/// ones, clockwise from east) [OCallaghan84], on level ground the way the flood came.
pub fn directions(width: usize, height: usize, flood: &Flood) -> Vec<u8> {
    let mut directions = steepest(width, height, &flood.level);
    directions.par_iter_mut().zip(&flood.toward).for_each(|(out, toward)| {
        *out = if *out == OUT { *toward } else { *out };
    });
    directions
}

/// Direction of the steepest way down, [`OUT`] where no neighbour is lower.
fn steepest(width: usize, height: usize, level: &[f32]) -> Vec<u8> {
    let mut directions = vec![OUT; level.len()];
    directions.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, line)| {
        if row > 0 && row + 1 < height && width > 2 {
            steepest_inside(width, row, level, line);
            line[0] = steepest_on_rim(width, height, level, 0, row);
            line[width - 1] = steepest_on_rim(width, height, level, width - 1, row);
        } else {
            for (column, out) in line.iter_mut().enumerate() {
                *out = steepest_on_rim(width, height, level, column, row);
            }
        }
    });
    directions
}

/// Steepest directions of a row's inner cells: without branches, so that cells share SIMD lanes.
fn steepest_inside(width: usize, row: usize, level: &[f32], directions: &mut [u8]) {
    let inner = width - 2;
    let line = |row: usize| &level[row * width..][..inner + 2];
    let (above, here, below) = (line(row - 1), line(row), line(row + 1));
    let directions = &mut directions[1..][..inner];
    for i in 0..inner {
        let z = here[i + 1];
        let neighbors = [
            here[i + 2],
            below[i + 2],
            below[i + 1],
            below[i],
            here[i],
            above[i],
            above[i + 1],
            above[i + 2],
        ];
        let (mut best, mut code) = (0.0f32, u32::from(OUT));
        for direction in 0..8 {
            let fall = (z - neighbors[direction]) * PER_DISTANCE[direction];
            let is_steeper = fall > best;
            best = if is_steeper { fall } else { best };
            code = if is_steeper { direction as u32 } else { code };
        }
        directions[i] = code as u8;
    }
}

fn steepest_on_rim(width: usize, height: usize, level: &[f32], column: usize, row: usize) -> u8 {
    let here = level[row * width + column];
    let (mut best, mut code) = (0.0, OUT);
    for (direction, (right, down)) in STEPS.iter().enumerate() {
        let (Some(x), Some(y)) = (column.checked_add_signed(*right), row.checked_add_signed(*down))
        else {
            continue;
        };
        if x < width && y < height {
            let fall = (here - level[y * width + x]) * PER_DISTANCE[direction];
            if fall > best {
                (best, code) = (fall, direction as u8);
            }
        }
    }
    code
}

/// Adds to every cell what all cells above it hold, along `directions`.
///
/// `amounts` of 1 give the number of cells that drain through each, itself included: exact whole
/// numbers. The directions must lead off the grid from everywhere, as those of [`directions()`] do.
pub fn accumulate(width: usize, directions: &[u8], mut amounts: Vec<f64>) -> Vec<f64> {
    /// No cell waits for this one any more.
    const DONE: u8 = 255;
    let mut waiting = vec![0u8; directions.len()];
    for (cell, &direction) in directions.iter().enumerate().filter(|(_, d)| **d < OUT) {
        waiting[neighbor(cell, direction, width)] += 1;
    }
    for start in 0..directions.len() {
        let mut cell = start;
        // Walk down as long as nothing else is still to arrive.
        while waiting[cell] == 0 {
            waiting[cell] = DONE;
            if directions[cell] >= OUT {
                break;
            }
            let next = neighbor(cell, directions[cell], width);
            amounts[next] += amounts[cell];
            waiting[next] -= 1;
            cell = next;
        }
    }
    amounts
}

/// All cells in an order in which each comes before the one it drains to.
pub fn upstream_first(width: usize, directions: &[u8]) -> Vec<u32> {
    let mut waiting = donors(width, directions);
    let mut order = Vec::with_capacity(directions.len());
    let is_source = |waiting: &[u8], cell: usize| waiting[cell] == 0;
    let sources: Vec<usize> = (0..directions.len()).filter(|&c| is_source(&waiting, c)).collect();
    for mut cell in sources {
        loop {
            order.push(cell as u32);
            if directions[cell] >= OUT {
                break;
            }
            cell = neighbor(cell, directions[cell], width);
            waiting[cell] -= 1;
            if waiting[cell] > 0 {
                break;
            }
        }
    }
    order
}

/// How many neighbours drain into each cell: gathered row by row, in parallel.
fn donors(width: usize, directions: &[u8]) -> Vec<u8> {
    let height = directions.len() / width.max(1);
    let mut donors = vec![0u8; directions.len()];
    donors.par_chunks_mut(width.max(1)).enumerate().for_each(|(row, donors)| {
        for (direction, (right, down)) in (0u8..8).zip(STEPS) {
            // Who drains here in this direction lies against it.
            let Some(from) = row.checked_add_signed(-down).filter(|from| *from < height) else {
                continue;
            };
            let line = &directions[from * width..][..width];
            let (to, from) = match right {
                1 => (&mut donors[1..], &line[..width - 1]),
                -1 => (&mut donors[..width - 1], &line[1..]),
                _ => (&mut donors[..], line),
            };
            for (count, code) in to.iter_mut().zip(from) {
                *count += u8::from(*code == direction);
            }
        }
    });
    donors
}

/// Lower neighbours of a cell, with the shares of its water that they take.
#[derive(Clone, Copy, Debug)]
pub struct LowerNeighbors {
    list: [(usize, f64); 8],
    count: usize,
}

impl LowerNeighbors {
    /// Cells and their shares, which add up to 1.
    pub fn iter(&self) -> std::slice::Iter<'_, (usize, f64)> {
        self.list[..self.count].iter()
    }

    /// Whether the cell is the lowest of its neighbourhood.
    pub fn is_empty(&self) -> bool {
        self.count == 0
    }
}

/// Contour length over distance to the four sides and the four corners, in cells: contours of
/// 1/2 and √2/4 [Quinn91, fig. 3] over distances 1 and √2.
const CONTOUR_PER_DISTANCE: [f64; 8] = [0.5, 0.25, 0.5, 0.25, 0.5, 0.25, 0.5, 0.25];

/// Shares a cell's water among all lower neighbours by slope times length of contour [Quinn91].
///
/// On level ground all of it goes to the neighbour with the least index, if that is less than the
/// cell's own: the order of cells by altitude, then index, is one in which water only descends.
pub fn lower_neighbors(
    width: usize,
    height: usize,
    surface: &[f32],
    cell: usize,
) -> LowerNeighbors {
    let (column, row) = (cell % width, cell / width);
    let mut lower = LowerNeighbors { list: [(0, 0.0); 8], count: 0 };
    let (mut sum, mut level) = (0.0, cell);
    for (direction, (right, down)) in STEPS.iter().enumerate() {
        let (Some(x), Some(y)) = (column.checked_add_signed(*right), row.checked_add_signed(*down))
        else {
            continue;
        };
        if x >= width || y >= height {
            continue;
        }
        let beside = y * width + x;
        let fall = f64::from(surface[cell]) - f64::from(surface[beside]);
        if fall > 0.0 {
            let share = fall * CONTOUR_PER_DISTANCE[direction];
            lower.list[lower.count] = (beside, share);
            lower.count += 1;
            sum += share;
        } else if fall == 0.0 {
            level = level.min(beside);
        }
    }
    for (_, share) in &mut lower.list[..lower.count] {
        *share /= sum;
    }
    if lower.count == 0 && level < cell {
        lower.list[0] = (level, 1.0);
        lower.count = 1;
    }
    lower
}

/// Adds to every cell what runs down to it from above, shared as by [`lower_neighbors`]; `order`
/// holds all cells from the lowest. What reaches the floor of a hollow stays there.
pub fn accumulate_shared(
    width: usize,
    surface: &[f32],
    order: &[u32],
    mut amounts: Vec<f64>,
) -> Vec<f64> {
    let height = surface.len() / width.max(1);
    for cell in order.iter().rev().map(|&cell| cell as usize) {
        let amount = amounts[cell];
        for (receiver, share) in lower_neighbors(width, height, surface, cell).iter() {
            amounts[*receiver] += amount * share;
        }
    }
    amounts
}

/// Leads the drains of hollows through their floors: to the lowest point first, from there the
/// lowest way out [Metz11], instead of straight across the filled level.
///
/// Inside a hollow the flood is let in again at its outlet, taking the lowest cell it touches each
/// time; every cell drains to where the flood came from.
pub fn drain_through_floors(width: usize, altitude: &[f32], flood: &mut Flood) {
    let is_hollow = |level: &[f32], cell: usize| level[cell] > altitude[cell];
    let mut is_done = vec![false; altitude.len()];
    let mut heap = BinaryHeap::new();
    for entry in 0..altitude.len() {
        // A hollow is entered where its first drain comes from outside; it never touches the rim.
        if is_done[entry] || !is_hollow(&flood.level, entry) {
            continue;
        }
        let outlet = neighbor(entry, flood.toward[entry], width);
        if is_hollow(&flood.level, outlet) {
            continue;
        }
        heap.push(Reverse(key(altitude[outlet], outlet as u32)));
        while let Some(Reverse(lowest)) = heap.pop() {
            let cell = lowest as u32 as usize;
            for direction in 0..8 {
                // The outlet may lie on the rim, beyond which there is nothing.
                let beside = neighbor(cell, direction, width);
                let is_inside = beside < altitude.len()
                    && (beside % width).abs_diff(cell % width) <= 1
                    && is_hollow(&flood.level, beside);
                // The outlet may touch hollows that drain elsewhere.
                let is_entry = cell != outlet || flood.toward.get(beside) == Some(&(direction ^ 4));
                if is_inside && is_entry && !is_done[beside] {
                    is_done[beside] = true;
                    flood.toward[beside] = direction ^ 4;
                    heap.push(Reverse(key(altitude[beside], beside as u32)));
                }
            }
        }
    }
}

/// Rough hills with many hollows, for measurements.
#[cfg(test)]
pub(crate) fn rough_hills(side: usize) -> Vec<f32> {
    let shape = crate::noise::NoiseShape {
        kind: crate::noise::NoiseKind::Fbm,
        wavelength: side as f64 / 3.0,
        octaves: 10,
        roughness: 0.5,
        roughness_change: 0.0,
        lacunarity: 2.0,
        warp: 0.0,
    };
    let noise = crate::noise::Fractal::new(shape, 7, 0.0);
    let z = |i: usize| 750.0 * noise.at((i % side) as f64, (i / side) as f64);
    (0..side * side).into_par_iter().map(|i| z(i) as f32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    #[test]
    #[ignore = "a measurement, printed for people: run with --release --nocapture"]
    fn speed_of_drainage() {
        let side = 4096;
        let ground = rough_hills(side);
        let rate = |name: &str, work: &mut dyn FnMut()| {
            let start = std::time::Instant::now();
            work();
            let rate = ground.len() as f64 / start.elapsed().as_secs_f64() / 1e6;
            println!("{name}: {rate:.1} Mcell/s");
        };
        rate("levels", &mut || drop(crate::fill::levels(side, side, &ground)));
        let mut flood = None;
        rate("fill", &mut || flood = Some(fill(side, side, &ground)));
        let Some(flood) = flood else { return };
        let mut ways = Vec::new();
        rate("D8", &mut || ways = directions(side, side, &flood));
        rate("accumulate numbers", &mut || drop(crate::area::drained_cells(side, &ways)));
        rate("accumulate amounts", &mut || drop(accumulate(side, &ways, vec![1.0; ways.len()])));
    }

    fn area(width: usize, height: usize, altitude: &[f32]) -> Vec<f64> {
        let flood = fill(width, height, altitude);
        let directions = directions(width, height, &flood);
        accumulate(width, &directions, vec![1.0; altitude.len()])
    }

    fn grid(width: usize, height: usize, z: impl Fn(usize, usize) -> f64) -> Vec<f32> {
        (0..width * height).map(|i| z(i % width, i / width) as f32).collect()
    }

    /// Minimax levels by relaxing every cell until nothing changes.
    fn minimax(width: usize, height: usize, altitude: &[f32]) -> Vec<f32> {
        let on_rim = |x, y| x == 0 || y == 0 || x + 1 == width || y + 1 == height;
        let mut level: Vec<f32> = (0..altitude.len())
            .map(|i| if on_rim(i % width, i / width) { altitude[i] } else { f32::INFINITY })
            .collect();
        loop {
            let before = level.clone();
            for i in (0..level.len()).filter(|i| !on_rim(i % width, i / width)) {
                let lowest = (0..8).map(|d| level[neighbor(i, d, width)]).fold(f32::MAX, f32::min);
                level[i] = level[i].min(lowest.max(altitude[i]));
            }
            if level == before {
                return level;
            }
        }
    }

    #[test]
    fn on_a_plane_falling_east_every_cell_drains_all_cells_west_of_it() {
        let area = area(65, 33, &grid(65, 33, |x, _| -2.0 * x as f64));
        for (i, cells) in area.iter().enumerate() {
            assert_eq!(*cells, (i % 65 + 1) as f64);
        }
    }

    #[test]
    fn on_a_plane_falling_south_east_flow_follows_the_diagonals() {
        let area = area(65, 65, &grid(65, 65, |x, y| -(x as f64) - y as f64));
        // On the south and east rims there is no diagonal: water runs along them.
        for (x, y) in (0..64).flat_map(|y| (0..64).map(move |x| (x, y))) {
            assert_eq!(area[y * 65 + x], (x.min(y) + 1) as f64);
        }
    }

    #[test]
    fn a_v_valley_gathers_whole_rows_in_its_channel() {
        // Walls steeper than sy / (√2 - 1) send water straight to the channel.
        let (width, height) = (65, 65);
        let z = |x: usize, y: usize| 3.0 * x.abs_diff(32) as f64 - y as f64;
        let area = area(width, height, &grid(width, height, z));
        for row in 0..height {
            assert_eq!(area[row * width + 32], ((row + 1) * width) as f64);
        }
    }

    #[test]
    fn a_bowl_with_a_notch_fills_to_the_notch() {
        let notch = 7.3f32;
        let mut bowl = grid(41, 41, |x, y| {
            let (dx, dy) = (x as f64 - 20.0, y as f64 - 20.0);
            0.02 * (dx * dx + dy * dy)
        });
        bowl[20 * 41 + 40] = notch;
        let flood = fill(41, 41, &bowl);
        for (level, z) in flood.level.iter().zip(&bowl) {
            assert_eq!(*level, z.max(notch), "every cell below the notch is under water");
        }
    }

    #[test]
    fn a_walled_bowl_fills_to_the_ground_inside_its_gap() {
        // Level and volume, m and cells times m, are those of other programs' filling of it.
        let mut bowl = grid(65, 65, |x, y| {
            let (dx, dy) = (x as f64 - 32.0, y as f64 - 32.0);
            let is_wall = x == 0 || y == 0 || x == 64 || y == 64;
            if is_wall { 120.0 } else { 100.0 - 50.0 * libm::exp(-(dx * dx + dy * dy) / 100.0) }
        });
        bowl[32 * 65 + 64] = 90.0;
        let flood = fill(65, 65, &bowl);
        assert_eq!(flood.level[32 * 65 + 32], 99.99665);
        let water = flood.level.iter().zip(&bowl).map(|(a, b)| f64::from(*a) - f64::from(*b));
        assert!((water.sum::<f64>() - 15_696.80).abs() < 0.01);
    }

    #[test]
    fn hollows_in_hollows_and_plateaus_drain_completely() {
        let z = |x: usize, y: usize| ((x / 3 * 7 + y / 4 * 5) % 11) as f64;
        let altitude = grid(50, 40, z);
        let flood = fill(50, 40, &altitude);
        assert_eq!(flood.level, minimax(50, 40, &altitude));
        let directions = directions(50, 40, &flood);
        let area = accumulate(50, &directions, vec![1.0; altitude.len()]);
        let out = directions.iter().zip(&area).filter(|(d, _)| **d == OUT).map(|(_, a)| a);
        assert_eq!(out.sum::<f64>(), 2000.0);
    }

    #[test]
    fn the_smallest_grids_drain_as_well() {
        for (width, height) in [(1, 1), (1, 5), (5, 1), (2, 2), (3, 3)] {
            let altitude = grid(width, height, |x, y| ((x + 2 * y) % 3) as f64 - 1.0);
            let out: f64 = area(width, height, &altitude).iter().copied().fold(0.0, f64::max);
            assert!(out >= 1.0 && out <= (width * height) as f64);
        }
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn filling_is_the_minimax_surface_bit_for_bit_and_everything_drains(
            width in 1usize..24,
            height in 1usize..24,
            steps in 1u32..400,
            holes in prop_oneof![Just(0.0), 0.0..0.2],
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            // Few steps make plateaus, negative values try the queue's order.
            let mut z = || stream.below(u64::from(steps)) as f32 * 0.37 - 20.0;
            let mut altitude: Vec<f32> = (0..width * height).map(|_| z()).collect();
            let mut pierce = |z: &mut f32| *z = if stream.unit() < holes { f32::NAN } else { *z };
            altitude.iter_mut().for_each(&mut pierce);
            let flood = fill(width, height, &altitude);
            let bits = |levels: &[f32]| levels.iter().map(|z| z.to_bits()).collect::<Vec<_>>();
            if holes == 0.0 {
                prop_assert_eq!(&flood.level, &minimax(width, height, &altitude));
            }
            prop_assert_eq!(bits(&fill(width, height, &flood.level).level), bits(&flood.level));
            for (cell, &toward) in flood.toward.iter().enumerate().filter(|(_, t)| **t < OUT) {
                prop_assert!(flood.level[neighbor(cell, toward, width)] <= flood.level[cell]);
            }
            let mut through_floors = flood.clone();
            drain_through_floors(width, &altitude, &mut through_floors);
            for flood in [flood, through_floors] {
                let directions = directions(width, height, &flood);
                let area = accumulate(width, &directions, vec![1.0; altitude.len()]);
                let out = directions.iter().zip(&area).filter(|(d, _)| **d == OUT).map(|(_, a)| a);
                prop_assert_eq!(out.sum::<f64>(), altitude.len() as f64);
                let cells = crate::area::drained_cells(width, &directions);
                prop_assert!(cells.iter().zip(&area).all(|(n, a)| f64::from(*n) == *a));
                let mut place = vec![usize::MAX; altitude.len()];
                for (index, cell) in upstream_first(width, &directions).into_iter().enumerate() {
                    place[cell as usize] = index;
                }
                prop_assert!(place.iter().all(|place| *place < altitude.len()));
                for (cell, &d) in directions.iter().enumerate().filter(|(_, d)| **d < OUT) {
                    prop_assert!(place[cell] < place[neighbor(cell, d, width)]);
                }
            }
        }

        #[test]
        fn shared_flow_loses_nothing_on_its_way_to_floors_and_rim(
            width in 1usize..24,
            height in 1usize..24,
            steps in 1u64..400,
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.37).collect();
            let order = crate::hollow::rising(&ground);
            let area = accumulate_shared(width, &ground, &order, vec![1.0; ground.len()]);
            let ends = (0..ground.len())
                .filter(|&cell| lower_neighbors(width, height, &ground, cell).is_empty());
            let sum: f64 = ends.map(|cell| area[cell]).sum();
            prop_assert!((sum - ground.len() as f64).abs() < 1e-9 * sum);
        }
    }
}
