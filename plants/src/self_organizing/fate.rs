//! Bud fate: how resource is shared out from the base of a tree to its buds [Palubicki09] §4.

use super::Priority;
use super::plant::{Bears, Plant};

/// A bud that grows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sprout {
    /// The metamer that bears it.
    pub metamer: u32,
    /// Its place at the node, 0 for the axis' own.
    pub place: u32,
    /// Resource that reaches it.
    pub resource: f32,
}

/// Shares of the main axis and all laterals together, of the resource that reaches a fork: the
/// extended model of Borchert and Honda.
///
/// `[λ Qm, (1 - λ) Ql] / (λ Qm + (1 - λ) Ql)`, and nothing where there is no light.
pub fn shares(lambda: f32, main: f32, lateral: f32) -> [f32; 2] {
    let (main, lateral) = (lambda * main, (1.0 - lambda) * lateral);
    let sum = main + lateral;
    if sum > 0.0 { [main / sum, lateral / sum] } else { [0.0, 0.0] }
}

/// Shares `resource` out by light and bias; buds that get 1 or more are added to `sprouts`.
///
/// Needs [`Plant::gather`]. Several laterals of a node share by their light.
pub fn borchert_honda(plant: &Plant, lambda: f32, resource: f32, sprouts: &mut Vec<Sprout>) {
    let mut reaching = vec![0.0; plant.metamers.len()];
    if let Some(first) = reaching.first_mut() {
        *first = resource;
    }
    for index in 0..reaching.len() {
        let resource = reaching[index];
        // Less than 1 grows no metamer, however it is shared.
        if resource < 1.0 {
            continue;
        }
        let first = index * plant.stride;
        let light = |place: usize| light_of(plant, first + place);
        let main = light(0);
        let lateral: f32 = (1..plant.stride).map(light).sum();
        let [to_main, to_lateral] = shares(lambda, main, lateral);
        give(plant, &mut reaching, sprouts, (index, 0), resource * to_main);
        for place in 1..plant.stride {
            let part = if lateral > 0.0 { light(place) / lateral } else { 0.0 };
            give(plant, &mut reaching, sprouts, (index, place), resource * to_lateral * part);
        }
    }
}

/// Light of what stands at a place.
#[inline]
fn light_of(plant: &Plant, slot: usize) -> f32 {
    match plant.slots[slot].bears() {
        Bears::Nothing => 0.0,
        Bears::Bud { .. } => plant.light[slot],
        Bears::Metamer(child) => plant.gathered[child as usize],
    }
}

#[inline]
fn give(
    plant: &Plant,
    reaching: &mut [f32],
    sprouts: &mut Vec<Sprout>,
    (index, place): (usize, usize),
    resource: f32,
) {
    match plant.slots[index * plant.stride + place].bears() {
        Bears::Nothing => {}
        Bears::Metamer(child) => reaching[child as usize] = resource,
        Bears::Bud { .. } if resource >= 1.0 => {
            sprouts.push(Sprout { metamer: index as u32, place: place as u32, resource });
        }
        Bears::Bud { .. } => {}
    }
}

impl Priority {
    /// Weight of rank `rank` (from 0) in a list of `count`: on a line from `most` to `least`,
    /// which is reached at the part `span` of the list.
    pub fn weight(&self, rank: usize, count: usize) -> f32 {
        let last = (self.span * count as f32).max(1.0);
        // The first has rank 1 in the paper.
        let t = if last > 1.0 { (rank as f32 / (last - 1.0)).min(1.0) } else { 1.0 };
        if rank == 0 { self.most } else { self.most + (self.least - self.most) * t }
    }
}

/// One entry of an axis' list.
#[derive(Clone, Copy)]
struct Entry {
    index: u32,
    place: u32,
    light: f32,
    /// Mean light of its buds: what ranks it.
    mean: f32,
}

/// Shares `resource` out along each axis by light and rank; buds that get 1 or more are added to
/// `sprouts`.
///
/// Needs [`Plant::gather`]. The list of an axis holds its branches, its lateral buds and its tip.
pub fn priority(
    plant: &Plant,
    weights: &Priority,
    apical_first: bool,
    resource: f32,
    sprouts: &mut Vec<Sprout>,
) {
    let mut reaching = vec![0.0; plant.metamers.len()];
    if let Some(first) = reaching.first_mut() {
        *first = resource;
    }
    let mut list = Vec::new();
    for base in 0..reaching.len() {
        let resource = reaching[base];
        // Metamers within an axis are never given any.
        if resource < 1.0 {
            continue;
        }
        axis_list(plant, base, &mut list);
        rank(&mut list, apical_first);
        let count = list.len();
        let weighted = |(rank, entry): (usize, &Entry)| entry.light * weights.weight(rank, count);
        let sum: f32 = list.iter().enumerate().map(weighted).sum();
        if sum <= 0.0 {
            continue;
        }
        for (rank, entry) in list.iter().enumerate() {
            let share = resource * weighted((rank, entry)) / sum;
            let at = (entry.index as usize, entry.place as usize);
            give(plant, &mut reaching, sprouts, at, share);
        }
    }
}

/// Fills `list` with what the axis that begins at `base` bears; its own tip comes last.
fn axis_list(plant: &Plant, base: usize, list: &mut Vec<Entry>) {
    list.clear();
    let mut index = base;
    loop {
        let first = index * plant.stride;
        for place in (1..plant.stride).chain([0]) {
            let slot = plant.slots[first + place];
            let (light, buds) = match slot.bears() {
                Bears::Bud { .. } => (plant.light[first + place], 1),
                Bears::Metamer(child) if place > 0 => {
                    (plant.gathered[child as usize], plant.buds[child as usize])
                }
                _ => continue,
            };
            let mean = light / buds.max(1) as f32;
            list.push(Entry { index: index as u32, place: place as u32, light, mean });
        }
        match plant.slots[first].bears() {
            Bears::Metamer(next) => index = next as usize,
            _ => break,
        }
    }
}

/// Sorts by falling mean light, places nearer to the base first among equals; with
/// `apical_first` the axis' own tip leads.
fn rank(list: &mut [Entry], apical_first: bool) {
    let leads = |entry: &Entry| apical_first && entry.place == 0;
    list.sort_by(|a, b| leads(b).cmp(&leads(a)).then(b.mean.total_cmp(&a.mean)));
}
