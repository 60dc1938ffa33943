//! Rain: part of it is absorbed where it falls, "the rest flows downhill and is absorbed by the
//! soil that it passes" [Deussen98, §3].
//!
//! The paper drops water; we let all of it run at once, from the highest cell to the lowest: one
//! pass, with no water lost on the way, `rain = absorbed + ponded + lakes + outflow`. A cell shares
//! what it passes on among all lower neighbours, in proportion to slope and to the length of
//! contour that faces them [Quinn91]. What reaches the floor of a hollow soaks and fills it from
//! there up, spills into the next, and leaves the grid at last ([`crate::hollow`]). A lake keeps its
//! level: what runs into it, it loses to the air and the ground.

use crate::flow::lower_neighbors;
use crate::hollow::{FIRST, Filling, Hollows, Id, LAKE, rising};

/// What rain falls on.
#[derive(Clone, Copy, Debug)]
pub struct Catchment<'a> {
    /// Cells from west to east.
    pub width: usize,
    /// Cells from north to south.
    pub height: usize,
    /// Altitude of the ground, or of the open water that stands on it, m.
    pub surface: &'a [f32],
    /// Cells of lakes.
    pub is_lake: &'a [bool],
    /// Water that each cell's soil can take up, m; 0 where it is full already.
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
    /// Depth of rain that stands on each cell outside lakes, m.
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
    /// Run or fallen into lakes.
    pub lakes: f64,
    /// Off the grid.
    pub outflow: f64,
}

/// Lets it rain on a catchment.
pub fn fall(catchment: &Catchment<'_>, shower: &Shower) -> Soaked {
    let order = rising(catchment.surface);
    let hollows = Hollows::find(catchment.width, catchment.surface, &order, catchment.is_lake);
    let count = catchment.surface.len();
    let mut run = Run {
        catchment,
        shower,
        soaked: Soaked {
            soil_water: vec![0.0; count],
            ponded: vec![0.0; count],
            balance: Balance { rain: shower.rain * count as f64, ..Balance::default() },
        },
    };
    let arrived = run.run_down(&order, &hollows);
    let mut filling = Filling::new(&hollows, catchment.surface, |cell| run.room(cell));
    run.pour(&hollows, arrived, &mut filling);
    for (water, cells) in filling.ponds(&order) {
        run.stand(water, &cells);
    }
    run.soaked
}

struct Run<'a> {
    catchment: &'a Catchment<'a>,
    shower: &'a Shower,
    soaked: Soaked,
}

impl Run<'_> {
    /// Sends water down all slopes, from the highest cell; gives what arrives in each hollow.
    fn run_down(&mut self, order: &[u32], hollows: &Hollows) -> Vec<f64> {
        let Catchment { width, height, surface, is_lake, .. } = *self.catchment;
        let mut arrived = vec![0.0; hollows.list.len()];
        let mut inflow = vec![0.0f64; surface.len()];
        for cell in order.iter().rev().map(|&cell| cell as usize) {
            if is_lake[cell] {
                self.soaked.balance.lakes += self.shower.rain + inflow[cell];
                continue;
            }
            let rest = self.wet_slope(cell, inflow[cell]);
            let lower = lower_neighbors(width, height, surface, cell);
            if lower.is_empty() {
                // The floor of a hollow, or a cell of the rim.
                self.arrive(hollows.drain[cell], rest, &mut arrived);
            }
            for (receiver, share) in lower.iter() {
                inflow[*receiver] += rest * share;
            }
        }
        arrived
    }

    /// Rain on one cell of a slope and water passing it; gives back what runs on.
    fn wet_slope(&mut self, cell: usize, inflow: f64) -> f64 {
        let room = self.room(cell);
        let at_once = (self.shower.rain * self.shower.absorbed).min(room);
        let passing = self.shower.rain - at_once + inflow;
        let seeped = (passing * self.shower.seepage).min(room - at_once);
        self.absorb(cell, at_once + seeped);
        passing - seeped
    }

    /// Fills hollows with what arrived in them, the highest first: those spill to lower ones.
    fn pour(&mut self, hollows: &Hollows, mut arrived: Vec<f64>, filling: &mut Filling<'_>) {
        let mut leaves = Vec::new();
        for &outermost in hollows.outermost.iter().rev() {
            leaves.push(outermost);
            while let Some(id) = leaves.pop() {
                match hollows.list[id as usize].children {
                    Some(children) => leaves.extend(children),
                    None => {
                        let water = std::mem::take(&mut arrived[id as usize]);
                        let (spilled, to) = filling.pour(id, water);
                        self.arrive(to, spilled, &mut arrived);
                    }
                }
            }
        }
    }

    /// Books water at the end of its way down.
    fn arrive(&mut self, at: Id, water: f64, arrived: &mut [f64]) {
        match at {
            LAKE => self.soaked.balance.lakes += water,
            FIRST.. => arrived[at as usize] += water,
            _ => self.soaked.balance.outflow += water,
        }
    }

    /// Lets water stand over cells, lowest first, each soaking as it is reached.
    fn stand(&mut self, mut water: f64, cells: &[u32]) {
        let altitude = |cell: u32| f64::from(self.catchment.surface[cell as usize]);
        let Some(mut level) = cells.first().map(|&cell| altitude(cell)) else { return };
        let mut flooded = 0;
        for (index, &cell) in cells.iter().enumerate() {
            let soaked = self.room(cell as usize).min(water);
            self.absorb(cell as usize, soaked);
            water -= soaked;
            flooded = index + 1;
            // Over the last cell the level rises until all the water stands.
            let next = cells.get(flooded).map_or(f64::INFINITY, |&cell| altitude(cell));
            let rise = (next - level).min(water / flooded as f64);
            level += rise;
            water = (water - rise * flooded as f64).max(0.0);
            if water == 0.0 {
                break;
            }
        }
        for &cell in &cells[..flooded] {
            let depth = (level - altitude(cell)).max(0.0);
            self.soaked.ponded[cell as usize] = depth as f32;
            self.soaked.balance.ponded += depth;
        }
    }

    /// Water that a cell's soil can still take, m.
    fn room(&self, cell: usize) -> f64 {
        let capacity = self.catchment.capacity[cell];
        f64::from(capacity - self.soaked.soil_water[cell]).max(0.0)
    }

    fn absorb(&mut self, cell: usize, water: f64) {
        self.soaked.soil_water[cell] += water as f32;
        self.soaked.balance.absorbed += water;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn soak(width: usize, height: usize, ground: &[f32], capacity: f32, shower: Shower) -> Soaked {
        let catchment = Catchment {
            width,
            height,
            surface: ground,
            is_lake: &vec![false; ground.len()],
            capacity: &vec![capacity; ground.len()],
        };
        fall(&catchment, &shower)
    }

    fn assert_balanced(soaked: &Soaked) {
        let Balance { rain, absorbed, ponded, lakes, outflow } = soaked.balance;
        let error = (rain - absorbed - ponded - lakes - outflow).abs();
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
