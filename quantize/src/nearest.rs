//! The centre that is nearest to a row.
//!
//! [`Blocks`] seeks it for rows one by one, in any order. [`Centres`] seeks it for runs of rows that
//! lie near each other, such as those along a [`crate::order::Curve`]: a centre that is farther from
//! the whole box around a run than another centre at most is, is nearest to none of its rows
//! [Kanungo02].

/// The centre that was found.
pub(crate) struct Nearest {
    pub label: u32,
    /// Squared distance.
    pub distance: f32,
}

/// Rows that are compared with the same few centres.
const RUN: usize = 16;

/// Rows for whose runs centres are chosen in advance, a multiple of [`RUN`].
const LONG_RUN: usize = 16 * RUN;

/// Rows that are compared with a centre at once.
const ROWS: usize = 8;

/// Rounding may swap distances that differ by less than this part.
const ROUNDING: f32 = 1e-5;

/// Some of the centres, axis by axis.
pub(crate) struct Centres {
    dims: usize,
    labels: Vec<u32>,
    /// For each axis the numbers of all centres.
    values: Vec<f32>,
}

/// The least and the largest numbers of a run of rows, axis by axis.
#[derive(Default)]
struct Extent {
    low: Vec<f32>,
    high: Vec<f32>,
}

/// Room for squared distances between a box and each centre.
#[derive(Default)]
struct Distances {
    least: Vec<f32>,
    most: Vec<f32>,
    /// Places of the centres that stay, at the front.
    places: Vec<u32>,
}

impl Centres {
    /// Centres that come one after the other, `dims` numbers each.
    pub fn of(centres: &[f32], dims: usize) -> Self {
        let on_axis = |dim: usize| centres.iter().skip(dim).step_by(dims).copied();
        let labels = (0..(centres.len() / dims) as u32).collect();
        Self { dims, labels, values: (0..dims).flat_map(on_axis).collect() }
    }

    fn empty(dims: usize) -> Self {
        Self { dims, labels: Vec::new(), values: Vec::new() }
    }

    /// Calls `found` with the number and the nearest centre of each row, in their order; of equally
    /// near centres the first. Any order of rows is right, one in which they lie near each other is
    /// fast.
    pub fn nearest_of_rows(&self, rows: &[f32], mut found: impl FnMut(usize, Nearest)) {
        // The same loops, compiled for each common number of axes.
        match self.dims {
            2 => self.in_runs::<2>(rows, &mut found),
            3 => self.in_runs::<3>(rows, &mut found),
            4 => self.in_runs::<4>(rows, &mut found),
            _ => self.in_runs::<0>(rows, &mut found),
        }
    }

    /// See [`Self::nearest_of_rows`]; `DIMS` axes, or any number when 0.
    fn in_runs<const DIMS: usize>(&self, rows: &[f32], found: &mut impl FnMut(usize, Nearest)) {
        let (mut extent, mut room) = (Extent::default(), Distances::default());
        let (mut some, mut few) = (Self::empty(self.dims), Self::empty(self.dims));
        for (number, rows) in rows.chunks(LONG_RUN * self.dims).enumerate() {
            extent.set::<DIMS>(rows, self.dims);
            self.near(&extent, &mut room, &mut some);
            for (run, rows) in rows.chunks(RUN * self.dims).enumerate() {
                extent.set::<DIMS>(rows, self.dims);
                some.near(&extent, &mut room, &mut few);
                let first = number * LONG_RUN + run * RUN;
                for (part, rows) in rows.chunks(ROWS * self.dims).enumerate() {
                    few.compare::<DIMS>(rows, first + part * ROWS, found);
                }
            }
        }
    }

    /// Those centres that may be nearest to something in a box.
    fn near(&self, within: &Extent, room: &mut Distances, near: &mut Self) {
        let count = self.labels.len();
        room.measure(within, &self.values, count);
        let bound = least(&room.most) * (1.0 + ROUNDING);
        // Write each and advance by those that stay: a branch would be mispredicted often.
        room.places.resize(count, 0);
        let mut kept = 0;
        for (place, least) in room.least.iter().enumerate() {
            room.places[kept] = place as u32;
            kept += usize::from(*least <= bound);
        }
        let places = &room.places[..kept];
        near.labels.clear();
        near.labels.extend(places.iter().map(|place| self.labels[*place as usize]));
        near.values.clear();
        for values in self.values.chunks_exact(count) {
            near.values.extend(places.iter().map(|place| values[*place as usize]));
        }
    }

    /// Finds the nearest centres of up to [`ROWS`] rows, the first of which has the number `first`.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "arrays advance together")]
    fn compare<const DIMS: usize>(
        &self,
        rows: &[f32],
        first: usize,
        found: &mut impl FnMut(usize, Nearest),
    ) {
        let dims = if DIMS == 0 { self.dims } else { DIMS };
        let count = self.labels.len();
        let mut best = [f32::INFINITY; ROWS];
        let mut nearest = [0u32; ROWS];
        let mut side_by_side = [[0.0; ROWS]; DIMS];
        for (at, row) in rows.chunks_exact(dims).enumerate() {
            for dim in 0..DIMS {
                side_by_side[dim][at] = row[dim];
            }
        }
        for centre in 0..count {
            let mut distance = [0f32; ROWS];
            for dim in 0..dims {
                let value = self.values[dim * count + centre];
                for at in 0..ROWS {
                    let row = match DIMS {
                        0 => rows.get(at * dims + dim).copied().unwrap_or(0.0),
                        _ => side_by_side[dim][at],
                    };
                    let apart = row - value;
                    distance[at] += apart * apart;
                }
            }
            for at in 0..ROWS {
                let is_nearer = distance[at] < best[at];
                best[at] = if is_nearer { distance[at] } else { best[at] };
                nearest[at] = if is_nearer { centre as u32 } else { nearest[at] };
            }
        }
        for at in 0..rows.len() / dims {
            let label = self.labels[nearest[at] as usize];
            found(first + at, Nearest { label, distance: best[at] });
        }
    }
}

impl Extent {
    /// Becomes the box around some rows; see [`Centres::in_runs`].
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "three arrays advance together")]
    fn set<const DIMS: usize>(&mut self, rows: &[f32], dims: usize) {
        let dims = if DIMS == 0 { dims } else { DIMS };
        let first = &rows[..dims];
        self.low.clear();
        self.low.extend_from_slice(first);
        self.high.clear();
        self.high.extend_from_slice(first);
        let (low, high) = (&mut self.low[..dims], &mut self.high[..dims]);
        for row in rows.chunks_exact(dims) {
            for dim in 0..dims {
                low[dim] = if row[dim] < low[dim] { row[dim] } else { low[dim] };
                high[dim] = if row[dim] > high[dim] { row[dim] } else { high[dim] };
            }
        }
    }
}

impl Distances {
    /// The least and the largest squared distance between each centre and anything in a box.
    fn measure(&mut self, within: &Extent, values: &[f32], count: usize) {
        for distances in [&mut self.least, &mut self.most] {
            distances.clear();
            distances.resize(count, 0.0);
        }
        let sides = within.low.iter().zip(&within.high);
        for ((low, high), values) in sides.zip(values.chunks_exact(count)) {
            let distances = self.least.iter_mut().zip(&mut self.most);
            for ((least, most), value) in distances.zip(values) {
                let (below, above) = (low - value, value - high);
                let outside = if below > above { below } else { above };
                let outside = if outside > 0.0 { outside } else { 0.0 };
                // The far side: the larger of the distances to both sides.
                let inside = if below < above { -below } else { -above };
                *least += outside * outside;
                *most += inside * inside;
            }
        }
    }
}

/// The least of some numbers, none of which is NaN.
fn least(values: &[f32]) -> f32 {
    let smaller = |a: f32, b: f32| if b < a { b } else { a };
    // Eight at a time, so that no comparison waits for the one before it.
    let mut lanes = [f32::INFINITY; 8];
    let chunks = values.chunks_exact(8);
    let rest = chunks.remainder().iter().copied().fold(f32::INFINITY, smaller);
    for chunk in chunks {
        for (lane, value) in lanes.iter_mut().zip(chunk) {
            *lane = smaller(*lane, *value);
        }
    }
    lanes.into_iter().fold(rest, smaller)
}

/// Centres side by side in blocks of this many, so that one instruction compares several.
const LANES: usize = 8;

/// Centres in blocks of [`LANES`], sorted along the first axis.
///
/// A block is first numbers together, then second ones, …. The last block is filled up with
/// centres that are infinitely far.
pub(crate) struct Blocks {
    values: Vec<f32>,
    /// Cluster of each lane of each block.
    labels: Vec<u32>,
    /// Least and largest first number of each block; both rise.
    ranges: Vec<[f32; 2]>,
}

impl Blocks {
    pub fn of(centres: &[f32], dims: usize) -> Self {
        let first = |label: u32| centres[label as usize * dims];
        let mut labels: Vec<u32> = (0..(centres.len() / dims) as u32).collect();
        labels.sort_by(|a, b| first(*a).total_cmp(&first(*b)));
        let mut values = Vec::with_capacity(centres.len() + LANES * dims);
        let mut ranges = Vec::new();
        for block in labels.chunks(LANES) {
            ranges.push([first(block[0]), first(block[block.len() - 1])]);
            for dim in 0..dims {
                let value = |label: &u32| centres[*label as usize * dims + dim];
                let lane = |lane: usize| block.get(lane).map_or(f32::INFINITY, value);
                values.extend((0..LANES).map(lane));
            }
        }
        labels.resize(ranges.len() * LANES, u32::MAX);
        Self { values, labels, ranges }
    }

    pub fn nearest(&self, row: &[f32]) -> Nearest {
        // The same loop, compiled for each common number of axes.
        match row.len() {
            2 => row.first_chunk::<2>().map_or_else(|| self.search(row), |row| self.search(row)),
            3 => row.first_chunk::<3>().map_or_else(|| self.search(row), |row| self.search(row)),
            4 => row.first_chunk::<4>().map_or_else(|| self.search(row), |row| self.search(row)),
            _ => self.search(row),
        }
    }

    /// Looks at the block where the row lies along the first axis, then outwards on both sides
    /// until the first axis alone is farther than the nearest centre found.
    #[inline(always)]
    fn search(&self, row: &[f32]) -> Nearest {
        let size = row.len() * LANES;
        let block = |number: usize| &self.values[number * size..][..size];
        let first = row[0];
        let start = self.ranges.partition_point(|range| range[0] <= first).saturating_sub(1);
        let mut lanes = Lanes::new().compare(row, block(start), start);
        let (mut left, mut right) = (start, start + 1);
        loop {
            let nearest = lanes.least();
            let is_near = |gap: f32| gap * gap < nearest;
            let goes_left = left > 0 && is_near(first - self.ranges[left - 1][1]);
            let goes_right = right < self.ranges.len() && is_near(self.ranges[right][0] - first);
            if goes_left {
                left -= 1;
                lanes = lanes.compare(row, block(left), left);
            }
            if goes_right {
                lanes = lanes.compare(row, block(right), right);
                right += 1;
            }
            if !(goes_left || goes_right) {
                break;
            }
        }
        let lane = (1..LANES).fold(0, |a, b| if lanes.best[b] < lanes.best[a] { b } else { a });
        let label = self.labels[lanes.block[lane] as usize * LANES + lane];
        Nearest { label, distance: lanes.best[lane] }
    }
}

/// The nearest centre so far in each lane.
#[derive(Clone, Copy)]
struct Lanes {
    /// Squared distance.
    best: [f32; LANES],
    /// Number of the centre's block.
    block: [u32; LANES],
}

impl Lanes {
    #[inline(always)]
    fn new() -> Self {
        Self { best: [f32::INFINITY; LANES], block: [0; LANES] }
    }

    /// By value, so that both arrays stay in registers.
    #[inline(always)]
    #[allow(clippy::needless_range_loop, reason = "three arrays advance together")]
    fn compare(mut self, row: &[f32], block: &[f32], number: usize) -> Self {
        let mut distance = [0f32; LANES];
        for (value, lanes) in row.iter().zip(block.chunks_exact(LANES)) {
            for lane in 0..LANES {
                let apart = value - lanes[lane];
                distance[lane] += apart * apart;
            }
        }
        for lane in 0..LANES {
            let is_nearer = distance[lane] < self.best[lane];
            self.best[lane] = if is_nearer { distance[lane] } else { self.best[lane] };
            self.block[lane] = if is_nearer { number as u32 } else { self.block[lane] };
        }
        self
    }

    #[inline(always)]
    fn least(&self) -> f32 {
        self.best.iter().copied().fold(f32::INFINITY, |a, b| if b < a { b } else { a })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    #[test]
    fn blocks_find_the_centre_that_looking_at_all_finds() {
        for dims in 1..=6 {
            let mut random = Seed(8).stream("centres", dims as u64);
            let mut numbers = |n: usize| -> Vec<f32> {
                // Steps of 1/8: distances are exact, and tie.
                (0..n * dims).map(|_| random.below(33) as f32 / 8.0 - 2.0).collect()
            };
            for k in [1, 7, 8, 9, 100, 2000] {
                let (centres, rows) = (numbers(k), numbers(200));
                let blocks = Blocks::of(&centres, dims);
                for row in rows.chunks_exact(dims) {
                    let distance = |centre: &[f32]| {
                        centre.iter().zip(row).map(|(c, r)| (c - r).powi(2)).sum::<f32>()
                    };
                    let least =
                        centres.chunks_exact(dims).map(distance).fold(f32::INFINITY, f32::min);
                    let near = blocks.nearest(row);
                    let centre = &centres[near.label as usize * dims..][..dims];
                    assert_eq!((near.distance, distance(centre)), (least, least));
                }
            }
        }
    }

    #[test]
    fn runs_of_rows_find_the_first_centre_that_looking_at_all_finds() {
        for dims in [1, 2, 3, 4, 7] {
            let mut random = Seed(11).stream("centres", dims as u64);
            let mut numbers = |n: usize| -> Vec<f32> {
                // Steps of 1/8: distances are exact, and tie.
                (0..n * dims).map(|_| random.below(33) as f32 / 8.0 - 2.0).collect()
            };
            for (k, count) in [(1, 3), (2, RUN), (9, RUN + 1), (100, 2 * LONG_RUN + 77)] {
                let (centres, mut rows) = (numbers(k), numbers(count));
                // Sorted along the first axis, so that boxes leave something out.
                let mut sorted: Vec<&[f32]> = rows.chunks_exact(dims).collect();
                sorted.sort_by(|a, b| a[0].total_cmp(&b[0]));
                rows = sorted.concat();
                let mut next = 0;
                Centres::of(&centres, dims).nearest_of_rows(&rows, |number, near| {
                    let row = &rows[number * dims..][..dims];
                    let distance = |centre: &[f32]| {
                        centre.iter().zip(row).map(|(c, r)| (c - r).powi(2)).sum::<f32>()
                    };
                    let all: Vec<f32> = centres.chunks_exact(dims).map(distance).collect();
                    let least = all.iter().copied().fold(f32::INFINITY, f32::min);
                    let first = all.iter().position(|distance| *distance == least);
                    assert_eq!((number, near.distance), (next, least));
                    assert_eq!(Some(near.label as usize), first);
                    next += 1;
                });
                assert_eq!(next, count);
            }
        }
    }
}
