//! Builders of binary trees, and the collapse to eight children a node.

use super::Bounds;
use super::lanes::{LEAF, Node};
use glam::Vec3A;
use rayon::join;

/// Bins along each axis when the surface-area heuristic looks for a split; more gain nothing
/// [Wald07] §3.
const BINS: usize = 16;

/// Subtrees of at least this many items are built as parallel tasks.
const PARALLEL: usize = 4096;

/// Below this depth splits halve the number of items, so that no input makes a deep tree.
const HEURISTIC_DEPTH: u32 = 48;

/// Items of a binary leaf.
const GRAIN: usize = 1;

/// From this many items on, clustering builds several times faster than binning.
const CLUSTER: usize = 4_000_000;

/// A binary tree over items that have boxes.
pub(crate) struct Binary {
    /// Nodes; the root is number 0.
    nodes: Vec<BinaryNode>,
    /// Items in the order in which leaves refer to them.
    pub order: Vec<u32>,
}

#[derive(Clone, Copy)]
struct BinaryNode {
    bounds: Bounds,
    /// First item of a leaf, or left child.
    first: u32,
    /// Right child of an inner node.
    right: u32,
    /// Items of a leaf; 0 for an inner node.
    count: u32,
}

const UNUSED: BinaryNode = BinaryNode { bounds: Bounds::EMPTY, first: 0, right: 0, count: 0 };

/// An item while it is sorted into the tree.
#[derive(Clone, Copy)]
struct Item {
    bounds: Bounds,
    index: u32,
}

/// Builds a tree whose leaves hold at most `leaf_size` items.
///
/// The tree depends only on the boxes, not on the number of threads.
pub(crate) fn build(boxes: &[Bounds], leaf_size: usize) -> Binary {
    if boxes.len() >= CLUSTER { cluster(boxes, leaf_size) } else { bin(boxes, leaf_size) }
}

/// Binned surface-area heuristic, down to single items.
pub(crate) fn bin(boxes: &[Bounds], leaf_size: usize) -> Binary {
    let mut items: Vec<Item> =
        boxes.iter().zip(0..).map(|(&bounds, index)| Item { bounds, index }).collect();
    // A subtree of n items never needs more than 2n - 1 nodes: each gets its own run of slots,
    // so that parallel tasks need not agree on numbers.
    let mut nodes = vec![UNUSED; (2 * items.len()).max(2) - 1];
    if !items.is_empty() {
        let place = Place { node: 0, item: 0, depth: 0, leaf_size };
        split(&mut items, &mut nodes, place);
    }
    Binary { nodes, order: items.into_iter().map(|item| item.index).collect() }
}

#[derive(Clone, Copy)]
struct Place {
    /// Number of the first slot handed to this subtree.
    node: u32,
    /// Number of its first item.
    item: u32,
    depth: u32,
    leaf_size: usize,
}

fn split(items: &mut [Item], nodes: &mut [BinaryNode], place: Place) {
    let bounds = items.iter().fold(Bounds::EMPTY, |all, item| all.union(item.bounds));
    let (here, below) = nodes.split_at_mut(1);
    if items.len() <= GRAIN.min(place.leaf_size) {
        let count = items.len() as u32;
        here[0] = BinaryNode { bounds, first: place.item, right: 0, count };
        return;
    }
    let middle = partition(items, place.depth, place.leaf_size);
    let (left_items, right_items) = items.split_at_mut(middle);
    let left_slots = 2 * middle - 1;
    let (left_nodes, right_nodes) = below.split_at_mut(left_slots);
    let depth = place.depth + 1;
    let left = Place { node: place.node + 1, depth, ..place };
    let right = Place {
        node: left.node + left_slots as u32,
        item: place.item + middle as u32,
        depth,
        ..place
    };
    here[0] = BinaryNode { bounds, first: left.node, right: right.node, count: 0 };
    if left_items.len() + right_items.len() >= PARALLEL {
        join(|| split(left_items, left_nodes, left), || split(right_items, right_nodes, right));
    } else {
        split(left_items, left_nodes, left);
        split(right_items, right_nodes, right);
    }
}

/// Reorders items into a left and a right part, both non-empty; returns the size of the left.
fn partition(items: &mut [Item], depth: u32, leaf_size: usize) -> usize {
    let centers = Bounds::of(items.iter().map(|item| item.bounds.center()));
    let extent = centers.high - centers.low;
    if depth < HEURISTIC_DEPTH
        && extent.max_element() > 0.0
        && let Some(cut) = best_cut(items, &Binning::new(&centers), leaf_size)
    {
        return reorder(items, |item| cut.is_left(item));
    }
    // All centres coincide, or the tree is too deep: halve along the longest axis.
    let middle = items.len() / 2;
    let axis = (0..3).fold(0, |best, axis| if extent[axis] > extent[best] { axis } else { best });
    items.select_nth_unstable_by(middle, |a, b| {
        let key = |item: &Item| item.bounds.center()[axis];
        key(a).total_cmp(&key(b)).then(a.index.cmp(&b.index))
    });
    middle
}

/// Moves the items that are left before the others; returns how many there are.
fn reorder(items: &mut [Item], is_left: impl Fn(&Item) -> bool) -> usize {
    let mut middle = 0;
    for index in 0..items.len() {
        if is_left(&items[index]) {
            items.swap(index, middle);
            middle += 1;
        }
    }
    middle
}

/// Maps centres to bins, along all axes at once.
#[derive(Clone, Copy)]
struct Binning {
    low: Vec3A,
    scale: Vec3A,
}

impl Binning {
    fn new(centers: &Bounds) -> Self {
        let extent = centers.high - centers.low;
        let scale = |axis: usize| {
            // A little less than BINS, so that the farthest centre falls into the last bin.
            if extent[axis] > 0.0 { BINS as f32 * 0.9999 / extent[axis] } else { 0.0 }
        };
        Self { low: centers.low, scale: Vec3A::new(scale(0), scale(1), scale(2)) }
    }

    fn bins(&self, item: &Item) -> [usize; 3] {
        let scaled = (item.bounds.center() - self.low) * self.scale;
        [scaled.x, scaled.y, scaled.z].map(|s| (s as usize).min(BINS - 1))
    }
}

/// A plane between two bins.
struct Cut {
    binning: Binning,
    axis: usize,
    /// First bin of the right part.
    bin: usize,
}

impl Cut {
    fn is_left(&self, item: &Item) -> bool {
        self.binning.bins(item)[self.axis] < self.bin
    }
}

/// The cut of least expected work: area times number of full leaves, summed over both sides. A
/// leaf costs the same whether it is full or not, since its triangles are tested at once.
fn best_cut(items: &[Item], binning: &Binning, leaf_size: usize) -> Option<Cut> {
    let mut boxes = [[Bounds::EMPTY; BINS]; 3];
    let mut counts = [[0u32; BINS]; 3];
    for item in items {
        let bins = binning.bins(item);
        for axis in 0..3 {
            boxes[axis][bins[axis]] = boxes[axis][bins[axis]].union(item.bounds);
            counts[axis][bins[axis]] += 1;
        }
    }
    let mut best: Option<(f32, usize, usize)> = None;
    for axis in 0..3 {
        for (bin, cost) in cut_costs(&boxes[axis], &counts[axis], leaf_size as u32) {
            if best.is_none_or(|(least, ..)| cost < least) {
                best = Some((cost, axis, bin));
            }
        }
    }
    best.map(|(_, axis, bin)| Cut { binning: *binning, axis, bin })
}

/// Cost of each cut that leaves something on both sides, as (first bin of the right side, cost).
fn cut_costs(
    boxes: &[Bounds; BINS],
    counts: &[u32; BINS],
    leaf_size: u32,
) -> impl Iterator<Item = (usize, f32)> {
    let leaves = |count: u32| count.div_ceil(leaf_size) as f32;
    let mut right = [(0.0, 0u32); BINS];
    let (mut all, mut count) = (Bounds::EMPTY, 0);
    for bin in (1..BINS).rev() {
        all = all.union(boxes[bin]);
        count += counts[bin];
        right[bin] = (all.half_area(), count);
    }
    let mut costs = [(0, f32::NAN); BINS];
    (all, count) = (Bounds::EMPTY, 0);
    for bin in 1..BINS {
        all = all.union(boxes[bin - 1]);
        count += counts[bin - 1];
        let (right_area, right_count) = right[bin];
        if count > 0 && right_count > 0 {
            let cost = all.half_area() * leaves(count) + right_area * leaves(right_count);
            costs[bin] = (bin, cost);
        }
    }
    costs.into_iter().filter(|(_, cost)| !cost.is_nan())
}

/// Parallel locally-ordered clustering, by `obvhs` [MB18].
pub(crate) fn cluster(boxes: &[Bounds], leaf_size: usize) -> Binary {
    let boxes: Vec<obvhs::aabb::Aabb> =
        boxes.iter().map(|b| obvhs::aabb::Aabb::new(b.low, b.high)).collect();
    let params = obvhs::BvhBuildParams {
        max_prims_per_leaf: leaf_size as u32,
        ..obvhs::BvhBuildParams::medium_build()
    };
    let mut unwatched = std::time::Duration::default();
    let tree = obvhs::bvh2::builder::build_bvh2(&boxes, params, &mut unwatched);
    let node = |node: &obvhs::bvh2::node::Bvh2Node| BinaryNode {
        bounds: Bounds { low: node.aabb().min, high: node.aabb().max },
        first: node.first_index,
        right: node.first_index + 1,
        count: if node.is_leaf() { node.prim_count } else { 0 },
    };
    Binary { nodes: tree.nodes.iter().map(node).collect(), order: tree.primitive_indices }
}

/// A tree of eight children a node, and the runs of items that its leaves hold.
pub(crate) struct Wide {
    pub nodes: Vec<Node>,
    /// Leaf number `i` holds the items `leaves[i].0 .. leaves[i].0 + leaves[i].1` of the order.
    pub leaves: Vec<(u32, u32)>,
}

/// Cost of testing a block of a leaf, where testing the eight boxes of a node costs 1.
const BLOCK_COST: f32 = 1.0;

/// Collapses a binary tree so that the expected work is least [Ylitie17] §3: which subtrees become
/// nodes of eight children, and which become leaves of at most `leaf_size` items.
pub(crate) fn widen(tree: &Binary, leaf_size: usize) -> Wide {
    let mut wide = Wide { nodes: Vec::new(), leaves: Vec::new() };
    if tree.order.is_empty() {
        return wide;
    }
    let plan = Plan::new(tree, leaf_size);
    wide.nodes.push(Node::EMPTY);
    // Pairs of a binary subtree and the wide node that it fills.
    let mut open = vec![(0u32, 0usize)];
    let mut children = Vec::with_capacity(8);
    while let Some((root, target)) = open.pop() {
        children.clear();
        plan.children(tree, root, &mut children);
        for (slot, &child) in children.iter().enumerate() {
            let chosen = &plan.choices[child as usize];
            let link = if chosen.split[0] == 0 {
                wide.leaves.push(chosen.run);
                LEAF | (wide.leaves.len() - 1) as u32
            } else {
                wide.nodes.push(Node::EMPTY);
                open.push((child, wide.nodes.len() - 1));
                (wide.nodes.len() - 1) as u32
            };
            wide.nodes[target].set(slot, &tree.nodes[child as usize].bounds, link);
        }
    }
    wide
}

/// The best collapse of every binary subtree.
struct Plan {
    choices: Vec<Choice>,
}

/// How a subtree is best cut into at most 1, 2 … 7 pieces, each a node or a leaf.
#[derive(Clone, Copy)]
struct Choice {
    /// Expected work, by the number of pieces less one.
    cost: [f32; 7],
    /// Pieces that the left child gets. For one piece: of the eight children of a node, or 0 for
    /// a leaf. For more: of these pieces, or 0 where fewer are as good.
    split: [u8; 7],
    /// First item and number of items; no number when they are not neighbours in the order.
    run: (u32, u32),
}

impl Plan {
    fn new(tree: &Binary, leaf_size: usize) -> Self {
        let unknown = Choice { cost: [0.0; 7], split: [0; 7], run: (0, 0) };
        let mut plan = Self { choices: vec![unknown; tree.nodes.len()] };
        // Parents before children; walked backwards, children are known before their parents.
        let mut order = vec![0u32];
        let mut next = 0;
        while let Some(&index) = order.get(next) {
            let node = &tree.nodes[index as usize];
            if node.count == 0 {
                order.extend([node.first, node.right]);
            }
            next += 1;
        }
        for &index in order.iter().rev() {
            plan.choices[index as usize] = plan.choose(&tree.nodes[index as usize], leaf_size);
        }
        plan
    }

    fn choose(&self, node: &BinaryNode, leaf_size: usize) -> Choice {
        let area = node.bounds.half_area();
        if node.count > 0 {
            let run = (node.first, node.count);
            return Choice { cost: [area * BLOCK_COST; 7], split: [0; 7], run };
        }
        let [left, right] = [node.first, node.right].map(|child| &self.choices[child as usize]);
        // The least work of `pieces` pieces, and how many of them the left child gets.
        let divide = |pieces: usize| {
            let costs = (1..pieces)
                .filter(|&k| k <= 7 && pieces - k <= 7)
                .map(|k| (left.cost[k - 1] + right.cost[pieces - k - 1], k as u8));
            costs.fold((f32::INFINITY, 1), |best, cost| if cost.0 < best.0 { cost } else { best })
        };
        let is_run = left.run.1 > 0 && right.run.1 > 0 && left.run.0 + left.run.1 == right.run.0;
        let run = if is_run { (left.run.0, left.run.1 + right.run.1) } else { (0, 0) };
        let mut choice = Choice { cost: [0.0; 7], split: [0; 7], run };
        let (below, k) = divide(8);
        choice.cost[0] = below + area;
        choice.split[0] = k;
        let as_leaf = area * BLOCK_COST;
        if is_run && run.1 as usize <= leaf_size && as_leaf <= choice.cost[0] {
            choice.cost[0] = as_leaf;
            choice.split[0] = 0;
        }
        for pieces in 2..=7 {
            let (cost, k) = divide(pieces);
            let fewer = choice.cost[pieces - 2];
            (choice.cost[pieces - 1], choice.split[pieces - 1]) =
                if cost < fewer { (cost, k) } else { (fewer, 0) };
        }
        choice
    }

    /// The children of the wide node that a subtree becomes.
    fn children(&self, tree: &Binary, root: u32, into: &mut Vec<u32>) {
        let node = &tree.nodes[root as usize];
        let k = self.choices[root as usize].split[0] as usize;
        if node.count > 0 || k == 0 {
            // A whole tree that is one leaf hangs below a node of its own.
            return into.push(root);
        }
        self.pieces(tree, node.first, k, into);
        self.pieces(tree, node.right, 8 - k, into);
    }

    /// The pieces of a subtree that is cut into at most so many.
    fn pieces(&self, tree: &Binary, root: u32, most: usize, into: &mut Vec<u32>) {
        let split = &self.choices[root as usize].split;
        let Some(pieces) = (2..=most).rev().find(|&pieces| split[pieces - 1] > 0) else {
            return into.push(root);
        };
        let (node, k) = (&tree.nodes[root as usize], split[pieces - 1] as usize);
        self.pieces(tree, node.first, k, into);
        self.pieces(tree, node.right, pieces - k, into);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use weald_contract::Seed;

    fn scattered(count: usize) -> Vec<Bounds> {
        let mut chance = Seed(3).stream("boxes", 0);
        let mut point = || Vec3A::from_array([0; 3].map(|_| chance.range(-9.0, 9.0) as f32));
        (0..count).map(|_| point()).map(|p| Bounds { low: p, high: p + 0.1 }).collect()
    }

    /// Every item is in exactly one leaf, and inside the boxes of all nodes above it.
    fn check(boxes: &[Bounds], tree: &Binary, leaf_size: usize) {
        let wide = widen(tree, leaf_size);
        let mut seen = vec![0; boxes.len()];
        let mut open = vec![(0u32, Bounds { low: Vec3A::MIN, high: Vec3A::MAX })];
        while let Some((link, around)) = open.pop() {
            if link & LEAF == 0 {
                let node = &wide.nodes[link as usize];
                open.extend(node.children().map(|(bounds, link)| (link, bounds)));
                continue;
            }
            let (first, count) = wide.leaves[(link & !LEAF) as usize];
            assert!(count as usize <= leaf_size && count > 0);
            for &item in &tree.order[first as usize..(first + count) as usize] {
                seen[item as usize] += 1;
                assert_eq!(around.union(boxes[item as usize]), around);
            }
        }
        assert!(seen.iter().all(|&times| times == 1));
    }

    #[test]
    fn both_builders_put_every_item_into_exactly_one_leaf_inside_its_boxes() {
        for count in [1, 2, 7, 8, 9, 100, 5000] {
            let boxes = scattered(count);
            for leaf_size in [1, 8] {
                check(&boxes, &bin(&boxes, leaf_size), leaf_size);
                check(&boxes, &cluster(&boxes, leaf_size), leaf_size);
            }
        }
    }

    #[test]
    fn coincident_items_still_make_a_tree() {
        let boxes = vec![scattered(1)[0]; 1000];
        check(&boxes, &bin(&boxes, 8), 8);
    }

    #[test]
    fn nothing_makes_an_empty_tree() {
        assert!(widen(&build(&[], 8), 8).nodes.is_empty());
    }
}
