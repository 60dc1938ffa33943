//! Hollows within hollows: which of them water fills first, and where it spills to.
//!
//! Raise the water everywhere at once, cell by cell from the lowest: a cell with no neighbour
//! under water begins a hollow, one between two hollows joins them, one at the rim or at a lake
//! opens its hollow. What has been joined is a tree of hollows [Barnes20]; pouring into it, from
//! leaf to leaf and then into the parents' room above, is Fill-Spill-Merge [Barnes21].

use crate::flow::STEPS;

/// Number of a hollow.
pub type Id = u32;

/// Not a hollow: water leaves the grid.
pub const OUTSIDE: Id = 0;

/// Not a hollow: water joins a lake.
pub const LAKE: Id = 1;

/// Hollows that are found have numbers from here; children's are below their parents'.
pub const FIRST: Id = 2;

const UNSEEN: Id = Id::MAX;

/// One hollow.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Hollow {
    /// The hollow that this and its sibling make together; [`OUTSIDE`] for the outermost.
    pub parent: Id,
    /// The two that were joined.
    pub children: Option<[Id; 2]>,
    /// Level at which it spills, m.
    pub spill: f32,
    /// The hollow without children, or [`OUTSIDE`] or [`LAKE`], that its spill runs down to.
    pub link: Id,
}

/// All hollows of a surface.
#[derive(Clone, Debug)]
pub struct Hollows {
    /// By number; the first two are no hollows.
    pub list: Vec<Hollow>,
    /// Outermost hollows, in rising order of their spill: each spills to earlier ones only.
    pub outermost: Vec<Id>,
    /// The smallest hollow that holds each cell; [`OUTSIDE`] for slopes that hold no water.
    pub of_cell: Vec<Id>,
    /// Where the water of each cell runs to if nothing stops it: a hollow without children,
    /// [`OUTSIDE`] or [`LAKE`].
    pub drain: Vec<Id>,
    /// For union-find: a hollow that contains it, or itself.
    within: Vec<Id>,
}

/// Lower neighbours that belong to one body of water.
#[derive(Clone, Copy)]
struct Side {
    body: Id,
    /// The lowest of them.
    lowest: u32,
}

/// All cells, lowest first; equal ones by index, so that no two count as level.
pub fn rising(surface: &[f32]) -> Vec<u32> {
    use rayon::prelude::*;
    let mut order: Vec<u32> = (0..surface.len() as u32).collect();
    order.par_sort_unstable_by(|&a, &b| {
        surface[a as usize].total_cmp(&surface[b as usize]).then(a.cmp(&b))
    });
    order
}

impl Hollows {
    /// Finds the hollows of a surface whose cells, lowest first, are `order`.
    pub fn find(width: usize, surface: &[f32], order: &[u32], is_lake: &[bool]) -> Self {
        let nothing = Hollow { parent: OUTSIDE, children: None, spill: 0.0, link: OUTSIDE };
        let mut hollows = Self {
            list: vec![nothing; FIRST as usize],
            outermost: Vec::new(),
            of_cell: vec![UNSEEN; surface.len()],
            drain: vec![OUTSIDE; surface.len()],
            within: vec![OUTSIDE; FIRST as usize],
        };
        let height = surface.len() / width.max(1);
        let mut sides = Vec::with_capacity(8);
        for &cell in order {
            let (column, row) = (cell as usize % width, cell as usize / width);
            hollows.sides(width, height, surface, (column, row), &mut sides);
            let is_rim = column == 0 || row == 0 || column + 1 == width || row + 1 == height;
            let is_lake = is_lake[cell as usize];
            hollows.drain[cell as usize] = hollows.drain_of(surface, &sides, is_rim, is_lake);
            let body = if is_rim || is_lake || sides.iter().any(|side| side.body == OUTSIDE) {
                hollows.open(cell, surface, &sides, is_lake);
                OUTSIDE
            } else {
                hollows.join(surface[cell as usize], &sides)
            };
            hollows.of_cell[cell as usize] = body;
        }
        hollows
    }

    /// The bodies of water that touch a cell.
    fn sides(
        &mut self,
        width: usize,
        height: usize,
        surface: &[f32],
        (column, row): (usize, usize),
        sides: &mut Vec<Side>,
    ) {
        sides.clear();
        for (right, down) in STEPS {
            let (Some(x), Some(y)) =
                (column.checked_add_signed(right), row.checked_add_signed(down))
            else {
                continue;
            };
            if x >= width || y >= height || self.of_cell[y * width + x] == UNSEEN {
                continue;
            }
            let beside = (y * width + x) as u32;
            let body = self.body(self.of_cell[beside as usize]);
            match sides.iter_mut().find(|side| side.body == body) {
                Some(side) if is_lower(surface, beside, side.lowest) => side.lowest = beside,
                Some(_) => {}
                None => sides.push(Side { body, lowest: beside }),
            }
        }
    }

    /// The outermost hollow so far that contains `id`.
    fn body(&mut self, mut id: Id) -> Id {
        while self.within[id as usize] != id {
            let above = self.within[self.within[id as usize] as usize];
            self.within[id as usize] = above;
            id = above;
        }
        id
    }

    fn drain_of(&mut self, surface: &[f32], sides: &[Side], is_rim: bool, is_lake: bool) -> Id {
        let lowest = sides.iter().map(|side| side.lowest);
        let lowest = lowest.reduce(|a, b| if is_lower(surface, b, a) { b } else { a });
        match lowest {
            _ if is_lake => LAKE,
            Some(lowest) => self.drain[lowest as usize],
            None if is_rim => OUTSIDE,
            None => self.add(None),
        }
    }

    fn add(&mut self, children: Option<[Id; 2]>) -> Id {
        let id = self.list.len() as Id;
        self.list.push(Hollow { parent: OUTSIDE, children, spill: 0.0, link: OUTSIDE });
        self.within.push(id);
        id
    }

    /// Ends the hollows beside a cell that is open to the outside.
    fn open(&mut self, cell: u32, surface: &[f32], sides: &[Side], is_lake: bool) {
        let open = sides.iter().find(|side| side.body == OUTSIDE);
        let link = match open {
            _ if is_lake => LAKE,
            Some(side) => self.drain[side.lowest as usize],
            None => OUTSIDE,
        };
        for side in sides.iter().filter(|side| side.body != OUTSIDE) {
            let hollow = &mut self.list[side.body as usize];
            hollow.spill = surface[cell as usize];
            hollow.link = link;
            self.within[side.body as usize] = OUTSIDE;
            self.outermost.push(side.body);
        }
    }

    /// Makes one hollow of those beside a cell at `level`; gives its number.
    fn join(&mut self, level: f32, sides: &[Side]) -> Id {
        let Some((first, rest)) = sides.split_first() else {
            // `drain_of` has just begun a hollow for this lowest cell.
            return self.list.len() as Id - 1;
        };
        let mut body = first.body;
        for side in rest {
            let parent = self.add(Some([body, side.body]));
            let links = [self.drain[side.lowest as usize], self.drain[first.lowest as usize]];
            for (child, link) in [body, side.body].into_iter().zip(links) {
                let hollow = &mut self.list[child as usize];
                (hollow.parent, hollow.spill, hollow.link) = (parent, level, link);
                self.within[child as usize] = parent;
            }
            body = parent;
        }
        body
    }
}

/// Whether one cell comes before another in [`rising`] order.
pub fn is_lower(surface: &[f32], cell: u32, than: u32) -> bool {
    let (a, b) = (surface[cell as usize], surface[than as usize]);
    a < b || (a == b && cell < than)
}

/// Water in hollows while it is poured.
pub struct Filling<'a> {
    hollows: &'a Hollows,
    /// What each hollow holds when full beyond what its children hold, m times cells.
    room: Vec<f64>,
    /// What of that is taken.
    held: Vec<f64>,
    /// Whether it and all inside it are full.
    is_full: Vec<bool>,
    /// For full hollows: one that contains it and is full, or itself.
    full_within: Vec<Id>,
}

impl<'a> Filling<'a> {
    /// Empty hollows. `takes(cell)` is the water that a cell's soil will take before water stands
    /// on it, m.
    pub fn new(hollows: &'a Hollows, surface: &[f32], takes: impl Fn(usize) -> f64) -> Self {
        let count = hollows.list.len();
        let (mut cells, mut altitudes, mut soils) =
            (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        for (cell, &id) in hollows.of_cell.iter().enumerate().filter(|(_, id)| **id >= FIRST) {
            cells[id as usize] += 1.0;
            altitudes[id as usize] += f64::from(surface[cell]);
            soils[id as usize] += takes(cell);
        }
        let mut room = vec![0.0; count];
        let mut whole = vec![0.0; count];
        for id in FIRST as usize..count {
            let hollow = &hollows.list[id];
            let mut inside = 0.0;
            for child in hollow.children.into_iter().flatten().map(|child| child as usize) {
                cells[id] += cells[child];
                altitudes[id] += altitudes[child];
                soils[id] += soils[child];
                inside += whole[child];
            }
            whole[id] = cells[id] * f64::from(hollow.spill) - altitudes[id] + soils[id];
            room[id] = (whole[id] - inside).max(0.0);
        }
        let full_within = (0..count as Id).collect();
        Self { hollows, room, held: vec![0.0; count], is_full: vec![false; count], full_within }
    }

    /// Pours water into a hollow without children; gives back what spills from its outermost
    /// hollow, and where to.
    pub fn pour(&mut self, leaf: Id, mut water: f64) -> (f64, Id) {
        let mut id = leaf;
        while water > 0.0 {
            id = self.outermost_full(id);
            let hollow = self.hollows.list[id as usize];
            if !self.is_full[id as usize] {
                water = self.fill(id, water);
            } else if hollow.parent == OUTSIDE {
                return (water, hollow.link);
            } else {
                // A full hollow spills to its sibling; when that is full too, both are one.
                let is_sibling_full = match self.hollows.list[hollow.parent as usize].children {
                    Some([a, b]) => self.is_full[if a == id { b } else { a } as usize],
                    None => true,
                };
                id = if is_sibling_full { hollow.parent } else { hollow.link };
            }
        }
        (0.0, OUTSIDE)
    }

    /// Fills a hollow's own room; gives back the rest.
    fn fill(&mut self, id: Id, water: f64) -> f64 {
        let index = id as usize;
        let free = self.room[index] - self.held[index];
        if water < free {
            self.held[index] += water;
            return 0.0;
        }
        self.held[index] = self.room[index];
        self.is_full[index] = true;
        for child in self.hollows.list[index].children.into_iter().flatten() {
            self.full_within[child as usize] = id;
        }
        water - free
    }

    /// The outermost full hollow around a full one; `id` itself if it is not full.
    fn outermost_full(&mut self, mut id: Id) -> Id {
        while self.full_within[id as usize] != id {
            let above = self.full_within[self.full_within[id as usize] as usize];
            self.full_within[id as usize] = above;
            id = above;
        }
        id
    }

    /// The ponds that have formed: their water (m times cells) and their cells, lowest first.
    pub fn ponds(&self, order: &[u32]) -> Vec<(f64, Vec<u32>)> {
        // A hollow's water belongs to the outermost one around it that holds any.
        let mut pond_of = vec![UNSEEN; self.held.len()];
        let mut ponds: Vec<(f64, Vec<u32>)> = Vec::new();
        for id in (FIRST as usize..self.held.len()).rev() {
            let parent = self.hollows.list[id].parent;
            pond_of[id] = if parent >= FIRST { pond_of[parent as usize] } else { UNSEEN };
            if pond_of[id] == UNSEEN && self.held[id] > 0.0 {
                pond_of[id] = ponds.len() as Id;
                ponds.push((0.0, Vec::new()));
            }
            if let Some(pond) = ponds.get_mut(pond_of[id] as usize) {
                pond.0 += self.held[id];
            }
        }
        for &cell in order {
            let id = self.hollows.of_cell[cell as usize];
            if id >= FIRST
                && let Some(pond) = ponds.get_mut(pond_of[id as usize] as usize)
            {
                pond.1.push(cell);
            }
        }
        ponds
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// One row of ground between walls, so that only its ends are open.
    fn row(ground: &[f32]) -> (usize, Vec<f32>) {
        let wall = vec![100.0; ground.len()];
        (ground.len(), [wall.as_slice(), ground, wall.as_slice()].concat())
    }

    fn find(width: usize, surface: &[f32]) -> (Hollows, Vec<u32>) {
        let order = rising(surface);
        let hollows = Hollows::find(width, surface, &order, &vec![false; surface.len()]);
        (hollows, order)
    }

    #[test]
    fn two_hollows_and_the_one_that_they_make_spill_as_drawn() {
        // Floors 2 and 1, sill 4 between them, rim 6 on the left and 7 on the right.
        let (width, surface) = row(&[0.0, 6.0, 2.0, 4.0, 1.0, 7.0, 0.0]);
        let (hollows, _) = find(width, &surface);
        assert_eq!(hollows.list.len() - FIRST as usize, 3);
        let [right, left, both] = [2, 3, 4].map(|id| hollows.list[id]);
        assert_eq!((right.parent, right.spill, right.link), (4, 4.0, 3));
        assert_eq!((left.parent, left.spill, left.link), (4, 4.0, 2));
        assert_eq!((both.parent, both.spill, both.link), (OUTSIDE, 6.0, OUTSIDE));
        assert_eq!(hollows.outermost, [4]);
    }

    #[test]
    fn water_fills_one_hollow_then_its_sibling_then_both_and_then_leaves() {
        let (width, surface) = row(&[0.0, 6.0, 2.0, 4.0, 1.0, 7.0, 0.0]);
        let (hollows, _) = find(width, &surface);
        let mut filling = Filling::new(&hollows, &surface, |_| 0.0);
        // Left holds 4 - 2, right 4 - 1, both together 3 cells more of 6 - 4.
        assert_eq!(filling.room[2..], [3.0, 2.0, 6.0]);
        assert_eq!(filling.pour(3, 2.5), (0.0, OUTSIDE));
        assert_eq!(filling.held[2..], [0.5, 2.0, 0.0]);
        assert_eq!(filling.pour(3, 3.5), (0.0, OUTSIDE));
        assert_eq!(filling.held[2..], [3.0, 2.0, 1.0]);
        assert_eq!(filling.pour(2, 9.0), (4.0, OUTSIDE));
        assert_eq!(filling.ponds(&rising(&surface)), [(11.0, vec![11, 9, 10])]);
    }

    #[test]
    fn level_ground_has_hollows_that_hold_nothing() {
        let (hollows, _) = find(5, &[1.0; 25]);
        let filling = Filling::new(&hollows, &[1.0; 25], |_| 0.0);
        assert!(filling.room.iter().all(|room| *room == 0.0));
    }
}
