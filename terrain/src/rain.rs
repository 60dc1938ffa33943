//! Rain: part of it is absorbed where it falls, "the rest flows downhill and is absorbed by the
//! soil that it passes" [Deussen98, §3].
//!
//! The paper drops water; we let all of it run at once, from the highest cell to the lowest, each
//! cell after everything above it: one pass, with no water lost on the way,
//! `rain = absorbed + ponded + outflow`. A cell shares what it passes on among all lower
//! neighbours, in proportion to slope and to the length of contour that faces them [Quinn91]. A
//! hollow collects what enters it, soaks and fills from its bottom up, and spills the rest at its
//! outlet.

use crate::flow::{Flood, OUT, STEPS, neighbor};

/// What rain falls on.
#[derive(Clone, Copy, Debug)]
pub struct Catchment<'a> {
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
    /// Altitude of the ground, m.
    pub altitude: &'a [f32],
    /// Altitude of the ground, or of the open water that stands on it, m.
    pub surface: &'a [f32],
    /// The flood that filled the ground.
    pub flood: &'a Flood,
    /// Cells under open water: their soil is full and absorbs nothing.
    pub is_water: &'a [bool],
    /// Water that each cell's soil can hold, m.
    pub capacity: &'a [f32],
}

/// How rain falls and soaks in.
#[derive(Clone, Copy, Debug)]
pub struct Shower {
    /// Rain, m of water.
    pub rain: f64,
    /// Share of it that is absorbed where it falls.
    pub absorbed: f64,
    /// Share of the passing water that a cell's soil absorbs.
    pub seepage: f64,
}

/// Where the rain went.
#[derive(Clone, Debug, PartialEq)]
pub struct Soaked {
    /// Water in the soil that came from the rain, m.
    pub soil_water: Vec<f32>,
    /// Depth of rain that stands on each cell, m.
    pub ponded: Vec<f32>,
    /// The sums.
    pub balance: Balance,
}

/// Sums over all cells, m of water times cells.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Balance {
    /// Fallen.
    pub rain: f64,
    /// In the soil.
    pub absorbed: f64,
    /// Standing in hollows.
    pub ponded: f64,
    /// Off the grid.
    pub outflow: f64,
}

/// Lets it rain on a catchment.
pub fn fall(catchment: &Catchment<'_>, shower: &Shower) -> Soaked {
    let mut run = Run::new(catchment, shower);
    run.count_waiting();
    run.flow();
    let Run { soil_water, ponded, balance, .. } = run;
    Soaked { soil_water, ponded, balance }
}

/// A cell that belongs to no hollow.
const NO_POOL: u32 = u32::MAX;

/// A hollow: cells that touch and lie below the level at which water leaves them.
struct Pool {
    /// Its cells, from the lowest surface up.
    cells: Vec<u32>,
    /// Level at which it spills, m.
    spill: f32,
    /// The cell outside over which it spills.
    outlet: u32,
    /// Sources that still have to arrive.
    waiting: u32,
    /// Water that has arrived, m times cells.
    inflow: f64,
}

struct Run<'a> {
    catchment: &'a Catchment<'a>,
    shower: &'a Shower,
    pools: Vec<Pool>,
    /// Pool of each cell, or [`NO_POOL`].
    pool_of: Vec<u32>,
    waiting: Vec<u8>,
    /// Water that has arrived at each cell, m.
    inflow: Vec<f64>,
    soil_water: Vec<f32>,
    ponded: Vec<f32>,
    balance: Balance,
}

/// A cell or, above all cells' indices, a pool.
type Node = usize;

impl<'a> Run<'a> {
    fn new(catchment: &'a Catchment<'a>, shower: &'a Shower) -> Self {
        let count = catchment.surface.len();
        let (pools, pool_of) = pools(catchment);
        let balance = Balance { rain: shower.rain * count as f64, ..Balance::default() };
        Self {
            catchment,
            shower,
            pools,
            pool_of,
            waiting: vec![0; count],
            inflow: vec![0.0; count],
            soil_water: vec![0.0; count],
            ponded: vec![0.0; count],
            balance,
        }
    }

    /// Counts, for every cell and pool, the sources that it must wait for.
    fn count_waiting(&mut self) {
        for cell in (0..self.pool_of.len()).filter(|&cell| self.pool_of[cell] == NO_POOL) {
            for (receiver, _) in receivers(self.catchment, cell).iter() {
                match self.pool_of[*receiver] {
                    NO_POOL => self.waiting[*receiver] += 1,
                    pool => self.pools[pool as usize].waiting += 1,
                }
            }
        }
        for pool in &self.pools {
            self.waiting[pool.outlet as usize] += 1;
        }
    }

    /// Visits everything that no longer waits, until all is done.
    fn flow(&mut self) {
        let cells = self.pool_of.len();
        let is_ready = |run: &Self, node: Node| match node.checked_sub(cells) {
            Some(pool) => run.pools[pool].waiting == 0,
            None => run.pool_of[node] == NO_POOL && run.waiting[node] == 0,
        };
        let mut ready: Vec<Node> =
            (0..cells + self.pools.len()).filter(|&node| is_ready(self, node)).collect();
        while let Some(node) = ready.pop() {
            match node.checked_sub(cells) {
                Some(pool) => {
                    let spilled = self.fill_pool(pool);
                    self.pass_on(self.pools[pool].outlet as usize, spilled, &mut ready);
                }
                None => {
                    let rest = self.wet_slope(node);
                    let receivers = receivers(self.catchment, node);
                    if receivers.is_empty() {
                        self.balance.outflow += rest;
                    }
                    for (receiver, share) in receivers.iter() {
                        self.pass_on(*receiver, rest * share, &mut ready);
                    }
                }
            }
        }
    }

    /// Hands water to a cell, or to the pool it belongs to.
    fn pass_on(&mut self, receiver: usize, water: f64, ready: &mut Vec<Node>) {
        if self.pool_of[receiver] == NO_POOL {
            self.inflow[receiver] += water;
            self.waiting[receiver] -= 1;
            if self.waiting[receiver] == 0 {
                ready.push(receiver);
            }
        } else {
            let index = self.pool_of[receiver] as usize;
            let pool = &mut self.pools[index];
            pool.inflow += water;
            pool.waiting -= 1;
            if pool.waiting == 0 {
                ready.push(self.pool_of.len() + index);
            }
        }
    }

    /// Rain on one cell of a slope and water passing it; gives back what runs on.
    fn wet_slope(&mut self, cell: usize) -> f64 {
        let room = self.room(cell);
        let at_once = (self.shower.rain * self.shower.absorbed).min(room);
        let passing = self.shower.rain - at_once + self.inflow[cell];
        let seeped = (passing * self.shower.seepage).min(room - at_once);
        self.absorb(cell, at_once + seeped);
        passing - seeped
    }

    /// Fills a hollow from its bottom up with all that has come to it; gives back what spills.
    fn fill_pool(&mut self, pool: usize) -> f64 {
        let cells = std::mem::take(&mut self.pools[pool].cells);
        let mut water = self.pools[pool].inflow;
        for &cell in &cells {
            let room = self.room(cell as usize);
            let at_once = (self.shower.rain * self.shower.absorbed).min(room);
            self.absorb(cell as usize, at_once);
            water += self.shower.rain - at_once;
        }
        let level = self.raise(&cells, f64::from(self.pools[pool].spill), &mut water);
        for &cell in &cells {
            let depth = level - f64::from(self.catchment.surface[cell as usize]);
            if depth > 0.0 {
                self.ponded[cell as usize] = depth as f32;
                self.balance.ponded += depth;
            }
        }
        water
    }

    /// Raises the water over cells sorted by altitude, each soaking first as it is reached, until
    /// the water is used up or spills. Gives the level; `water` keeps the rest.
    fn raise(&mut self, cells: &[u32], spill: f64, water: &mut f64) -> f64 {
        let altitude = |cell: u32| f64::from(self.catchment.surface[cell as usize]);
        let Some(&lowest) = cells.first() else { return spill };
        let mut level = altitude(lowest);
        for (index, &cell) in cells.iter().enumerate() {
            let room = self.room(cell as usize) - f64::from(self.soil_water[cell as usize]);
            let soaked = room.max(0.0).min(*water);
            self.absorb(cell as usize, soaked);
            *water -= soaked;
            let next = cells.get(index + 1).map_or(spill, |&cell| altitude(cell)).min(spill);
            let under_water = (index + 1) as f64;
            let rise = (next - level).max(0.0).min(*water / under_water);
            level += rise;
            *water = (*water - rise * under_water).max(0.0);
            if *water == 0.0 {
                break;
            }
        }
        level
    }

    /// Water that a cell's soil can take from dry, m.
    fn room(&self, cell: usize) -> f64 {
        if self.catchment.is_water[cell] { 0.0 } else { f64::from(self.catchment.capacity[cell]) }
    }

    fn absorb(&mut self, cell: usize, water: f64) {
        self.soil_water[cell] += water as f32;
        self.balance.absorbed += water;
    }
}

/// Cells that take a cell's water, with their shares.
struct Receivers {
    list: [(usize, f64); 8],
    count: usize,
}

impl Receivers {
    fn iter(&self) -> std::slice::Iter<'_, (usize, f64)> {
        self.list[..self.count].iter()
    }

    fn is_empty(&self) -> bool {
        self.count == 0
    }
}

/// Share of contour times slope per height, to the four sides and the four corners: lengths of
/// contour 1/2 and √2/4 [Quinn91, fig. 3] over distances 1 and √2, in cells.
const SHARE_PER_FALL: [f64; 8] = [0.5, 0.25, 0.5, 0.25, 0.5, 0.25, 0.5, 0.25];

/// All lower neighbours by [Quinn91]; on level ground the way the flood came; none off the grid.
fn receivers(catchment: &Catchment<'_>, cell: usize) -> Receivers {
    let Catchment { width, height, flood, .. } = *catchment;
    let (column, row) = (cell % width, cell / width);
    let mut receivers = Receivers { list: [(0, 0.0); 8], count: 0 };
    let mut sum = 0.0;
    for (direction, (right, down)) in STEPS.iter().enumerate() {
        let (Some(x), Some(y)) = (column.checked_add_signed(*right), row.checked_add_signed(*down))
        else {
            continue;
        };
        if x >= width || y >= height {
            continue;
        }
        let fall = f64::from(flood.level[cell]) - f64::from(flood.level[y * width + x]);
        if fall > 0.0 {
            let share = fall * SHARE_PER_FALL[direction];
            receivers.list[receivers.count] = (y * width + x, share);
            receivers.count += 1;
            sum += share;
        }
    }
    for (_, share) in &mut receivers.list[..receivers.count] {
        *share /= sum;
    }
    if receivers.count == 0 && flood.toward[cell] < OUT {
        receivers.list[0] = (neighbor(cell, flood.toward[cell], width), 1.0);
        receivers.count = 1;
    }
    receivers
}

/// The hollows of a catchment, and the hollow of every cell.
fn pools(catchment: &Catchment<'_>) -> (Vec<Pool>, Vec<u32>) {
    let Catchment { width, flood, altitude, surface, .. } = *catchment;
    let is_hollow = |cell: usize| flood.level[cell] > altitude[cell];
    let mut pools: Vec<Pool> = Vec::new();
    let mut pool_of = vec![NO_POOL; surface.len()];
    for start in (0..surface.len()).filter(|&cell| is_hollow(cell)) {
        if pool_of[start] != NO_POOL {
            continue;
        }
        let index = pools.len() as u32;
        let mut cells = vec![start as u32];
        pool_of[start] = index;
        let mut outlet = None;
        let mut next = 0;
        // A hollow's cells lie inside the grid, for the rim is never below its own level.
        while let Some(&cell) = cells.get(next) {
            next += 1;
            for direction in 0..8 {
                let beside = neighbor(cell as usize, direction, width);
                if is_hollow(beside) && pool_of[beside] == NO_POOL {
                    pool_of[beside] = index;
                    cells.push(beside as u32);
                }
            }
            let drain = neighbor(cell as usize, flood.toward[cell as usize], width);
            if !is_hollow(drain) {
                outlet = Some(drain as u32);
            }
        }
        // The flood entered the hollow from outside, so some cell drains to there.
        let outlet = outlet.unwrap_or(start as u32);
        cells.sort_by(|&a, &b| surface[a as usize].total_cmp(&surface[b as usize]));
        let spill = flood.level[start];
        pools.push(Pool { cells, spill, outlet, waiting: 0, inflow: 0.0 });
    }
    (pools, pool_of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::flow::fill;
    use proptest::prelude::*;

    fn soak(width: usize, height: usize, ground: &[f32], capacity: f32, shower: Shower) -> Soaked {
        let flood = fill(width, height, ground);
        let catchment = Catchment {
            width,
            height,
            altitude: ground,
            surface: ground,
            flood: &flood,
            is_water: &vec![false; ground.len()],
            capacity: &vec![capacity; ground.len()],
        };
        fall(&catchment, &shower)
    }

    fn assert_balanced(soaked: &Soaked) {
        let Balance { rain, absorbed, ponded, outflow } = soaked.balance;
        let error = (rain - absorbed - ponded - outflow).abs();
        assert!(error <= 1e-9 * rain.max(1e-9), "{:?}", soaked.balance);
        let stored: f64 = soaked.soil_water.iter().map(|&water| f64::from(water)).sum();
        let standing: f64 = soaked.ponded.iter().map(|&water| f64::from(water)).sum();
        assert!((stored - absorbed).abs() <= 1e-5 * rain.max(1e-9));
        assert!((standing - ponded).abs() <= 1e-5 * rain.max(1e-9));
    }

    #[test]
    fn down_a_plane_the_soil_wets_as_the_recurrence_says() {
        // Falling east in one row: w(x) = r (1 - a) + (1 - s) w(x - 1), soil = r a + s w(x).
        let ground: Vec<f32> = (0..20).map(|x| -(x as f32)).collect();
        let shower = Shower { rain: 1.0, absorbed: 0.25, seepage: 0.1 };
        let soaked = soak(20, 1, &ground, 100.0, shower);
        let mut passing = 0.0;
        for water in &soaked.soil_water {
            passing += 0.75;
            assert!((f64::from(*water) - (0.25 + 0.1 * passing)).abs() < 1e-6);
            passing *= 0.9;
        }
        assert!((soaked.balance.outflow - passing).abs() < 1e-12);
        assert_balanced(&soaked);
    }

    #[test]
    fn a_full_soil_takes_no_more() {
        let ground: Vec<f32> = (0..20).map(|x| -(x as f32)).collect();
        let shower = Shower { rain: 1.0, absorbed: 0.25, seepage: 0.5 };
        let soaked = soak(20, 1, &ground, 0.4, shower);
        assert!(soaked.soil_water.iter().all(|&water| water <= 0.4 + 1e-6));
        assert!((soaked.balance.absorbed - 20.0 * f64::from(0.4f32)).abs() < 1e-6);
        assert_balanced(&soaked);
    }

    #[test]
    fn a_hollow_without_soil_holds_its_volume_and_spills_the_rest() {
        // A box of 3 × 3 cells, 1 m deep, in a high rim with a spout.
        let mut ground = vec![2.0f32; 49];
        for (x, y) in (2..5).flat_map(|x| (2..5).map(move |y| (x, y))) {
            ground[y * 7 + x] = 0.0;
        }
        ground[3 * 7 + 5] = 1.0;
        ground[3 * 7 + 6] = 0.5;
        let rain = |rain| soak(7, 7, &ground, 0.0, Shower { rain, absorbed: 0.0, seepage: 0.0 });
        let full = rain(2.0);
        assert!((full.balance.ponded - 9.0).abs() < 1e-9);
        assert_eq!(full.ponded[3 * 7 + 3], 1.0);
        assert_balanced(&full);
        let shallow = rain(0.1);
        let depth = f64::from(shallow.ponded[3 * 7 + 3]);
        assert!((shallow.balance.ponded - 9.0 * depth).abs() < 1e-6, "the pond is level");
        assert_balanced(&shallow);
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(64))]

        #[test]
        fn no_water_is_lost_on_any_ground(
            width in 1usize..20,
            height in 1usize..20,
            steps in 1u64..50,
            capacity in 0.0f32..3.0,
            rain in 0.0f64..4.0,
            absorbed in 0.0f64..1.0,
            seepage in 0.0f64..1.0,
            seed: u64,
        ) {
            let mut stream = weald_contract::Seed(seed).stream("ground", 0);
            let ground: Vec<f32> =
                (0..width * height).map(|_| stream.below(steps) as f32 * 0.1).collect();
            let soaked = soak(width, height, &ground, capacity, Shower { rain, absorbed, seepage });
            assert_balanced(&soaked);
        }
    }
}
