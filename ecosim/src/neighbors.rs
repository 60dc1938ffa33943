//! Which circles may meet: sites sorted by size class, and by cell within a class.
//!
//! Circles of very different sizes share one plain, so a single cell size would be too coarse
//! for the small or too fine for the large. Each class holds radii within a factor of two and
//! has its own grid. Sites of a cell lie side by side in memory, and cells of a row in turn, so
//! that a query reads a few runs of memory.

use rayon::prelude::*;
use std::ops::Range;

/// Number of size classes; the last holds all that are smaller still.
const CLASSES: usize = 16;
/// Cells per site of a class, at most about; more would be mostly empty.
const CELLS_PER_SITE: f64 = 1.0;

/// A circle as the kernel reads it.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Site {
    pub(crate) x: f64,
    pub(crate) y: f64,
    /// Competitive strength: ability, then lower index. Greater keys win.
    pub(crate) key: u64,
    pub(crate) radius: f32,
}

/// One size class.
#[derive(Clone, Copy, Debug)]
struct Class {
    /// Cells of the classes before it.
    first_cell: usize,
    columns: usize,
    rows: usize,
    cell: f64,
    greatest_radius: f64,
    greatest_key: u64,
}

/// Sites, findable by place.
pub(crate) struct SizeGrids {
    pub(crate) sites: Vec<Site>,
    /// Where each cell's sites begin; one more entry than cells.
    starts: Vec<u32>,
    classes: Vec<Class>,
    low: [f64; 2],
}

impl SizeGrids {
    /// Sorts the sites.
    pub(crate) fn new(sites: &[Site]) -> Self {
        let (low, high) = bounds(sites);
        let greatest = sites.iter().fold(0.0f32, |most, site| most.max(site.radius));
        let classes = classes(sites, low, high, greatest);
        let cell_count = classes.last().map_or(0, |c| c.first_cell + c.columns * c.rows);
        let cells: Vec<u32> = sites
            .par_iter()
            .map(|site| {
                let class = &classes[class_of(site.radius, greatest)];
                let column = column_of(site.x - low[0], class.cell, class.columns);
                let row = column_of(site.y - low[1], class.cell, class.rows);
                (class.first_cell + row * class.columns + column) as u32
            })
            .collect();
        let (starts, sites) = counting_sort(sites, &cells, cell_count);
        Self { sites, starts, classes, low }
    }

    /// Calls `visit` with the sites of each run that may hold a circle which meets `site`,
    /// shifted by `shift`, and has a greater key.
    pub(crate) fn visit_stronger(
        &self,
        site: &Site,
        shift: [f64; 2],
        mut visit: impl FnMut(&[Site]),
    ) {
        let (x, y) = (site.x + shift[0] - self.low[0], site.y + shift[1] - self.low[1]);
        for class in self.classes.iter().filter(|class| class.greatest_key > site.key) {
            let reach = f64::from(site.radius) + class.greatest_radius;
            let columns = span(x, reach, class.cell, class.columns);
            let rows = span(y, reach, class.cell, class.rows);
            if columns.is_empty() {
                continue;
            }
            for row in rows {
                let line = class.first_cell + row * class.columns;
                let from = self.starts[line + columns.start] as usize;
                let to = self.starts[line + columns.end] as usize;
                visit(&self.sites[from..to]);
            }
        }
    }
}

fn bounds(sites: &[Site]) -> ([f64; 2], [f64; 2]) {
    let start = ([f64::INFINITY; 2], [f64::NEG_INFINITY; 2]);
    sites.iter().fold(start, |(low, high), site| {
        ([low[0].min(site.x), low[1].min(site.y)], [high[0].max(site.x), high[1].max(site.y)])
    })
}

/// Returns the class of a radius: halvings below the greatest one, by the exponents of the
/// numbers.
fn class_of(radius: f32, greatest: f32) -> usize {
    let exponent = |number: f32| (number.to_bits() >> 23) as usize;
    exponent(greatest).saturating_sub(exponent(radius)).min(CLASSES - 1)
}

fn classes(sites: &[Site], low: [f64; 2], high: [f64; 2], greatest: f32) -> Vec<Class> {
    let mut counts = [0usize; CLASSES];
    let mut radii = [0.0f32; CLASSES];
    let mut keys = [0u64; CLASSES];
    for site in sites {
        let class = class_of(site.radius, greatest);
        counts[class] += 1;
        radii[class] = radii[class].max(site.radius);
        keys[class] = keys[class].max(site.key);
    }
    let (width, height) = ((high[0] - low[0]).max(0.0), (high[1] - low[1]).max(0.0));
    let mut first_cell = 0;
    let mut classes = Vec::with_capacity(CLASSES);
    for class in 0..CLASSES {
        let greatest_radius = f64::from(radii[class]);
        let most = (counts[class] as f64 * CELLS_PER_SITE).max(1.0);
        // Sites on a line have no area, and still no more cells than sites.
        let cell = (width * height / most).sqrt().max(width.max(height) / most);
        let cell = cell.max(greatest_radius).max(f64::MIN_POSITIVE);
        let across = |length: f64| (length / cell) as usize + 1;
        let (columns, rows) = match counts[class] {
            0 => (0, 0),
            _ => (across(width), across(height)),
        };
        let greatest_key = keys[class];
        classes.push(Class { first_cell, columns, rows, cell, greatest_radius, greatest_key });
        first_cell += columns * rows;
    }
    classes
}

fn column_of(along: f64, cell: f64, count: usize) -> usize {
    ((along / cell) as usize).min(count.saturating_sub(1))
}

/// Returns the cells that `at - reach ..= at + reach` touches.
fn span(at: f64, reach: f64, cell: f64, count: usize) -> Range<usize> {
    let (from, to) = ((at - reach) / cell, (at + reach) / cell);
    if to < 0.0 || count == 0 {
        return 0..0;
    }
    // Casts of negative numbers give 0. The last cell also holds sites on the far rim.
    let from = (from.max(0.0) as usize).min(count - 1);
    from..(to as usize + 1).min(count)
}

fn counting_sort(sites: &[Site], cells: &[u32], cell_count: usize) -> (Vec<u32>, Vec<Site>) {
    let mut starts = vec![0u32; cell_count + 1];
    for &cell in cells {
        starts[cell as usize + 1] += 1;
    }
    for cell in 0..cell_count {
        starts[cell + 1] += starts[cell];
    }
    let mut next = starts.clone();
    let mut sorted = sites.to_vec();
    for (site, &cell) in sites.iter().zip(cells) {
        let slot = &mut next[cell as usize];
        sorted[*slot as usize] = *site;
        *slot += 1;
    }
    (starts, sorted)
}
