//! Circles that do not move, findable by place: grids by size, which thin out with them.
//!
//! Circles much larger than the space between plants get grids of their own, each for radii within
//! a factor of four; all others share one. Within a grid, sites lie in memory cell by cell and row
//! by row, so that a query reads a few runs.

use rayon::prelude::*;
use std::ops::Range;

/// Quarterings of the greatest radius that are told apart.
const CLASSES: usize = 12;
/// Cells for each site of a level, about.
const CELLS_PER_SITE: f64 = 1.0;
/// Cells whose sites are swept as one.
const BAND: usize = 4096;
/// Largest radius, in spaces between plants, that shares the grid of the smaller ones.
const COMMON: f64 = 1.0;

/// A circle: 16 bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Site {
    /// Place as a fraction of the field's width, in 2⁻³².
    pub(crate) x: u32,
    /// The same of its height.
    pub(crate) y: u32,
    pub(crate) radius: f32,
    pub(crate) id: u32,
}

impl Site {
    /// Whether this circle wins over another.
    #[inline]
    fn beats(&self, other: &Self) -> bool {
        self.radius > other.radius || (self.radius == other.radius && self.id < other.id)
    }
}

/// The field in which circles lie.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Field {
    /// Width and height, m.
    size: [f64; 2],
    /// Length of 2⁻³² of each, m.
    unit: [f64; 2],
    is_torus: bool,
}

impl Field {
    pub(crate) fn new(size: [f64; 2], is_torus: bool) -> Self {
        Self { size, unit: size.map(|length| length / 2f64.powi(32)), is_torus }
    }

    /// Returns a place as fractions.
    pub(crate) fn fraction(&self, place: [f64; 2]) -> [u32; 2] {
        // Casts cut off the part beyond 32 bits when they go through 64.
        [0, 1].map(|axis| (place[axis] / self.unit[axis]).round() as i64 as u32)
    }

    pub(crate) fn place(&self, site: &Site) -> [f64; 2] {
        [f64::from(site.x) * self.unit[0], f64::from(site.y) * self.unit[1]]
    }

    /// Whether two circles share more than a point: d² < (r₁ + r₂)².
    #[inline]
    fn meet<const TORUS: bool>(&self, a: &Site, b: &Site) -> bool {
        let apart = |a: u32, b: u32| {
            // On a torus, overflow is the shorter way round.
            if TORUS { f64::from(b.wrapping_sub(a) as i32) } else { f64::from(b) - f64::from(a) }
        };
        let (dx, dy) = (apart(a.x, b.x) * self.unit[0], apart(a.y, b.y) * self.unit[1]);
        let reach = f64::from(a.radius) + f64::from(b.radius);
        dx * dx + dy * dy < reach * reach
    }
}

/// The grid of one range of sizes.
#[derive(Clone, Copy, Debug)]
struct Level {
    /// Cells of the levels before it.
    first_cell: usize,
    columns: usize,
    rows: usize,
    /// Greatest radius at present, and when the grid was made, m.
    greatest: f32,
    greatest_at_first: f32,
}

impl Level {
    fn cells(&self) -> Range<usize> {
        self.first_cell..self.first_cell + self.columns * self.rows
    }

    fn cell_of(&self, site: &Site) -> usize {
        let along = |at: u32, count: usize| ((u64::from(at) * count as u64) >> 32) as usize;
        self.first_cell + along(site.y, self.rows) * self.columns + along(site.x, self.columns)
    }
}

/// Sites in grids by size.
pub(crate) struct Levels {
    field: Field,
    /// By level, then cell.
    pub(crate) sites: Vec<Site>,
    /// Where each cell's sites begin; one more entry than cells.
    starts: Vec<u32>,
    levels: Vec<Level>,
    count_at_first: usize,
}

impl Levels {
    pub(crate) fn new(field: Field, sites: Vec<Site>) -> Self {
        let greatest = sites.par_iter().map(|site| site.radius).reduce(|| 0.0, f32::max);
        let (level_of_class, levels) = layout(&field, &sites, greatest);
        let cell_count = levels.last().map_or(0, |level| level.cells().end);
        let mut starts = vec![0u32; cell_count + 1];
        let cell_of =
            |site: &Site| levels[level_of_class[class_of(site.radius, greatest)]].cell_of(site);
        // Each entry counts up from where its cell begins to where it ends, which is where the
        // next begins; moving all by one afterwards spares a copy.
        sites.iter().for_each(|site| starts[cell_of(site)] += 1);
        let mut sum = 0;
        for start in &mut starts {
            (*start, sum) = (sum, sum + *start);
        }
        let mut sorted = vec![Site::default(); sites.len()];
        for site in &sites {
            let slot = &mut starts[cell_of(site)];
            sorted[*slot as usize] = *site;
            *slot += 1;
        }
        starts.copy_within(0..cell_count, 1);
        starts[0] = 0;
        Self { field, count_at_first: sites.len(), sites: sorted, starts, levels }
    }

    pub(crate) fn field(&self) -> &Field {
        &self.field
    }

    /// Whether a circle that meets this one wins over it and counts, by its index.
    pub(crate) fn any_over(&self, site: &Site, counts: impl Fn(usize) -> bool) -> bool {
        let mut is_over = false;
        self.visit_over(site, |index, _| {
            is_over = counts(index);
            is_over
        });
        is_over
    }

    /// Returns the id of the circle that wins over all others which meet this one and count.
    pub(crate) fn greatest_over(&self, site: &Site, counts: impl Fn(usize) -> bool) -> Option<u32> {
        let mut best: Option<Site> = None;
        self.visit_over(site, |index, other| {
            if counts(index) && best.as_ref().is_none_or(|best| other.beats(best)) {
                best = Some(*other);
            }
            false
        });
        best.map(|best| best.id)
    }

    /// Calls `visit` for each circle that meets this one and wins over it, until it returns true.
    fn visit_over(&self, site: &Site, visit: impl FnMut(usize, &Site) -> bool) {
        if self.field.is_torus {
            self.visit_over_in::<true>(site, visit);
        } else {
            self.visit_over_in::<false>(site, visit);
        }
    }

    #[inline]
    fn visit_over_in<const TORUS: bool>(
        &self,
        site: &Site,
        mut visit: impl FnMut(usize, &Site) -> bool,
    ) {
        for level in self.levels.iter().filter(|level| level.greatest >= site.radius) {
            let reach = f64::from(site.radius) + f64::from(level.greatest);
            let columns = span::<TORUS>(site.x, reach / self.field.unit[0], level.columns);
            let rows = span::<TORUS>(site.y, reach / self.field.unit[1], level.rows);
            for row in rows.cells() {
                let line = level.first_cell + row * level.columns;
                for (from, to) in columns.runs() {
                    let from = self.starts[line + from] as usize;
                    let to = self.starts[line + to] as usize;
                    for (offset, other) in self.sites[from..to].iter().enumerate() {
                        // Either test is a toss-up alone: both are made, one branch is taken.
                        let is_over = other.beats(site) & self.field.meet::<TORUS>(site, other);
                        if is_over && visit(from + offset, other) {
                            return;
                        }
                    }
                }
            }
        }
    }

    /// Drops the sites whose state is not `keep`, reads off a value from each band of sites (those
    /// left, and the states of all that were), and changes those left.
    pub(crate) fn sweep<T: Send>(
        &mut self,
        states: &[u8],
        keep: u8,
        change: impl Fn(&mut Site) + Sync,
        read: impl Fn(&[Site], &[u8]) -> T + Sync,
    ) -> Vec<T> {
        let bands = self.bands(states);
        let swept: Vec<(Swept, T)> = bands
            .into_par_iter()
            .map(|band| {
                let Band { sites, starts, states, base } = band;
                let kept = compact(sites, starts, base, states, keep);
                let left = &mut sites[..kept];
                let value = read(left, states);
                left.iter_mut().for_each(&change);
                let greatest = left.iter().fold(0.0f32, |most, site| most.max(site.radius));
                (Swept { base, kept, greatest }, value)
            })
            .collect();
        let (swept, values): (Vec<Swept>, Vec<T>) = swept.into_iter().unzip();
        self.close_up(&swept);
        values
    }

    /// Cuts sites and cells into bands.
    fn bands<'a>(&'a mut self, states: &'a [u8]) -> Vec<Band<'a>> {
        let edges: Vec<usize> = self.band_cells().map(|cells| cells.end).collect();
        let ends: Vec<usize> = edges.iter().map(|&cell| self.starts[cell] as usize).collect();
        let cell_count = self.starts.len() - 1;
        let (mut starts, mut sites, mut states) =
            (&mut self.starts[..cell_count], self.sites.as_mut_slice(), states);
        let (mut cell, mut base) = (0, 0);
        let mut bands = Vec::with_capacity(edges.len());
        for (edge, end) in edges.into_iter().zip(ends) {
            let (own_starts, other_starts) = starts.split_at_mut(edge - cell);
            let (own_sites, other_sites) = sites.split_at_mut(end - base);
            let (own_states, other_states) = states.split_at(end - base);
            bands.push(Band { sites: own_sites, starts: own_starts, states: own_states, base });
            (starts, sites, states) = (other_starts, other_sites, other_states);
            (cell, base) = (edge, end);
        }
        bands
    }

    /// Returns the cells of each band; none holds cells of two levels.
    fn band_cells(&self) -> impl Iterator<Item = Range<usize>> {
        self.levels.iter().flat_map(|level| {
            let cells = level.cells();
            let end = cells.end;
            cells.step_by(BAND).map(move |first| first..(first + BAND).min(end))
        })
    }

    /// Moves the bands together, whose cells count from their own begin, and renews what depends
    /// on sizes.
    fn close_up(&mut self, swept: &[Swept]) {
        let mut greatest: Vec<f32> = vec![0.0; self.levels.len()];
        let mut total = 0;
        for (band, cells) in swept.iter().zip(self.band_cells().collect::<Vec<_>>()) {
            self.sites.copy_within(band.base..band.base + band.kept, total);
            self.starts[cells.clone()].iter_mut().for_each(|start| *start += total as u32);
            let level = self.levels.partition_point(|level| level.first_cell <= cells.start) - 1;
            greatest[level] = greatest[level].max(band.greatest);
            total += band.kept;
        }
        self.sites.truncate(total);
        if let Some(last) = self.starts.last_mut() {
            *last = total as u32;
        }
        for (level, greatest) in self.levels.iter_mut().zip(greatest) {
            level.greatest = greatest;
        }
        if self.is_stale() {
            let sites = std::mem::take(&mut self.sites);
            *self = Self::new(self.field, sites);
        }
    }

    /// Whether a new grid would serve better: half of the sites are gone, or sizes have doubled
    /// and are no longer small against the cells.
    fn is_stale(&self) -> bool {
        let has_outgrown = |level: &Level| {
            let cell = self.field.size[0] / level.columns as f64;
            level.greatest > 2.0 * level.greatest_at_first && f64::from(level.greatest) > cell
        };
        self.sites.len() * 2 < self.count_at_first || self.levels.iter().any(has_outgrown)
    }
}

/// What became of a band.
struct Swept {
    /// Index of its first site before.
    base: usize,
    /// Sites left.
    kept: usize,
    /// Greatest radius of those.
    greatest: f32,
}

/// Sites of neighbouring cells, and the cells.
struct Band<'a> {
    sites: &'a mut [Site],
    starts: &'a mut [u32],
    states: &'a [u8],
    /// Index of the first site.
    base: usize,
}

/// Moves the sites to keep to the front and lets cells count from there; returns their number.
fn compact(sites: &mut [Site], starts: &mut [u32], base: usize, states: &[u8], keep: u8) -> usize {
    let (mut kept, mut from) = (0, 0);
    for cell in 0..starts.len() {
        let to = starts.get(cell + 1).map_or(sites.len(), |&next| next as usize - base);
        starts[cell] = kept as u32;
        for index in from..to {
            sites[kept] = sites[index];
            kept += usize::from(states[index] == keep);
        }
        from = to;
    }
    kept
}

/// Returns the class of a radius: quarterings below the greatest one, by the exponents of the
/// numbers.
fn class_of(radius: f32, greatest: f32) -> usize {
    let exponent = |number: f32| (number.to_bits() >> 23) as usize;
    (exponent(greatest).saturating_sub(exponent(radius)) / 2).min(CLASSES - 1)
}

/// Returns the level of each class, and the levels, those of large circles first.
fn layout(field: &Field, sites: &[Site], greatest: f32) -> ([usize; CLASSES], Vec<Level>) {
    let (mut counts, mut radii) = ([0usize; CLASSES], [0.0f32; CLASSES]);
    for site in sites {
        let class = class_of(site.radius, greatest);
        counts[class] += 1;
        radii[class] = radii[class].max(site.radius);
    }
    let area = field.size[0] * field.size[1];
    // The smallest class of circles that need a grid of their own.
    let common = (0..CLASSES).rev().find(|&class| {
        let below: usize = counts[class..].iter().sum();
        f64::from(radii[class]) > COMMON * (area / below.max(1) as f64).sqrt()
    });
    let common = common.map_or(0, |class| class + 1);
    let (mut of_class, mut levels) = ([0; CLASSES], Vec::new());
    let mut first_cell = 0;
    for (class, level) in of_class.iter_mut().enumerate().take(common + 1) {
        *level = levels.len();
        let classes = if class == common { class..CLASSES } else { class..class + 1 };
        let count: usize = counts[classes.clone()].iter().sum();
        if count == 0 {
            continue;
        }
        let cell = (area / (CELLS_PER_SITE * count as f64)).sqrt();
        // A narrow strip has no more cells than sites either.
        let across = |length: f64| ((length / cell) as usize).clamp(1, count);
        let [columns, rows] = field.size.map(across);
        let greatest = radii[classes].iter().copied().fold(0.0, f32::max);
        let level = Level { first_cell, columns, rows, greatest, greatest_at_first: greatest };
        first_cell = level.cells().end;
        levels.push(level);
    }
    of_class[common.min(CLASSES - 1)..].fill(levels.len().saturating_sub(1));
    (of_class, levels)
}

/// Cells along one axis that a circle's reach touches.
#[derive(Clone, Copy, Debug)]
struct Span {
    first: i64,
    last: i64,
    count: i64,
}

/// Returns the cells that `at - reach ..= at + reach` touches; `reach` in units of `at`.
#[inline]
fn span<const TORUS: bool>(at: u32, reach: f64, count: usize) -> Span {
    // One unit more than the reach outweighs its rounding.
    let (at, reach, count) = (i64::from(at), reach as i64 + 1, count as i64);
    let whole = Span { first: 0, last: count - 1, count };
    // A reach of half the field meets all of it, and larger ones must not overflow.
    if reach >= 1 << 31 {
        return whole;
    }
    let [first, last] = [at - reach, at + reach].map(|at| (at * count) >> 32);
    match TORUS {
        true if last - first + 1 >= count => whole,
        true => Span { first, last, count },
        false => Span { first: first.max(0), last: last.min(count - 1), count },
    }
}

impl Span {
    /// Returns the cells.
    #[inline]
    fn cells(self) -> impl Iterator<Item = usize> {
        (self.first..=self.last).map(move |cell| cell.rem_euclid(self.count) as usize)
    }

    /// Returns the cells as runs, each from a cell to one before another.
    #[inline]
    fn runs(self) -> impl Iterator<Item = (usize, usize)> {
        let Self { first, last, count } = self;
        let (from, to) = (first.max(0) as usize, last.min(count - 1) as usize + 1);
        let before = (first < 0).then_some(((first + count) as usize, count as usize));
        let after = (last >= count).then_some((0, (last - count) as usize + 1));
        std::iter::once((from, to)).chain(before).chain(after)
    }
}
