//! Least-cost paths from one root to many nodes [Dijkstra59].
//!
//! Costs are numbers above 0, whose bits as floating point sort like the numbers themselves; so
//! a radix heap [Ahuja90] takes them as they are. It asks only that nothing is pushed below what
//! was popped last, which holds of Dijkstra's method.

use super::graph::{Graph, NOTHING};
use glam::Vec3;
use weald_contract::seed::mix;

/// Steps of chance in a weight.
const STEPS: usize = 4096;

/// What it costs to go along edges.
#[derive(Clone, Debug)]
pub struct Weights {
    /// Factor of the length for each step of chance.
    factors: Vec<f32>,
    /// Which chances the edges of this graph have.
    pub seed: u64,
    /// Direction in which growing costs least, unit.
    pub toward: Vec3,
    /// How much more it costs to grow the other way: 1 doubles the length.
    pub guide: f32,
}

impl Weights {
    /// Weights from `least` to 1 times the length; `irregularity` is the power of chance.
    pub fn new(least: f32, irregularity: f32, guide: f32) -> Self {
        let chance = |step: usize| (step as f32 + 0.5) / STEPS as f32;
        let factor = |step| least + (1.0 - least) * libm::powf(chance(step), irregularity);
        // A weight of nothing would make all ways through it alike.
        let factors = (0..STEPS).map(|step| factor(step).max(1e-6)).collect();
        Self { factors, seed: 0, toward: Vec3::Z, guide }
    }

    /// Cost of growing from `a` at `from` to `b` at `to`.
    #[inline]
    pub fn cost(&self, (a, from): (u32, Vec3), (b, to): (u32, Vec3)) -> f32 {
        let pair = u64::from(a.min(b)) << 32 | u64::from(a.max(b));
        // The high bits choose one of 4,096 steps.
        let factor = self.factors[(mix(self.seed ^ pair) >> 52) as usize];
        let along = to - from;
        let length = along.length();
        let mut cost = length * factor;
        if self.guide > 0.0 {
            cost += 0.5 * self.guide * (length - along.dot(self.toward)).max(0.0);
        }
        cost
    }
}

/// Paths from sources to all that were asked for.
#[derive(Clone, Debug, Default)]
pub struct Paths {
    /// Least cost of each node so far; infinite of those not reached.
    pub costs: Vec<f32>,
    /// The node before each on its path; [`NOTHING`] for sources and for those not reached.
    pub before: Vec<u32>,
    heap: RadixHeap,
    is_wanted: Vec<bool>,
}

impl Paths {
    /// Finds the paths from `sources` to all `wanted` nodes; returns how many can be reached.
    ///
    /// The search ends with the last of them: costs of other nodes may then be too large. Where
    /// one cannot be reached, every node that can be has its least cost.
    pub fn find(
        &mut self,
        graph: &Graph,
        weights: &Weights,
        sources: &[u32],
        wanted: &[u32],
    ) -> usize {
        let count = graph.nodes.places.len();
        self.before.clear();
        self.before.resize(count, NOTHING);
        self.costs.clear();
        self.costs.resize(count, f32::INFINITY);
        self.is_wanted.clear();
        self.is_wanted.resize(count, false);
        let mut missing = 0;
        for node in wanted {
            missing += usize::from(!std::mem::replace(&mut self.is_wanted[*node as usize], true));
        }
        let asked = missing;
        self.heap.clear();
        for source in sources {
            self.costs[*source as usize] = 0.0;
            self.heap.push(0.0, *source);
        }
        while missing > 0 {
            let Some((cost, node)) = self.heap.pop() else { break };
            if cost > self.costs[node as usize] {
                continue;
            }
            missing -= usize::from(std::mem::take(&mut self.is_wanted[node as usize]));
            self.relax(graph, weights, node, cost);
        }
        asked - missing
    }

    #[inline]
    fn relax(&mut self, graph: &Graph, weights: &Weights, node: u32, cost: f32) {
        let from = graph.nodes.places[node as usize];
        for other in graph.neighbors(node) {
            let known = &mut self.costs[other as usize];
            // An edge costs something: who is cheaper already needs no look at it.
            if *known <= cost {
                continue;
            }
            let to = graph.nodes.places[other as usize];
            let new = cost + weights.cost((node, from), (other, to));
            if new < *known {
                *known = new;
                self.before[other as usize] = node;
                self.heap.push(new, other);
            }
        }
    }

    /// Whether a node was reached.
    pub fn has_reached(&self, node: u32) -> bool {
        self.costs[node as usize] < f32::INFINITY
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        4 * (self.costs.capacity() + self.before.capacity())
            + self.is_wanted.capacity()
            + self.heap.buckets.iter().map(|bucket| 8 * bucket.capacity()).sum::<usize>()
    }
}

/// A queue of costs at or above the one popped last: those in bucket `i` differ from it in bit
/// `i - 1` first.
#[derive(Clone, Debug)]
struct RadixHeap {
    buckets: Vec<Vec<(u32, u32)>>,
    last: u32,
}

impl Default for RadixHeap {
    fn default() -> Self {
        Self { buckets: vec![Vec::new(); 33], last: 0 }
    }
}

impl RadixHeap {
    fn clear(&mut self) {
        self.buckets.iter_mut().for_each(Vec::clear);
        self.last = 0;
    }

    #[inline]
    fn push(&mut self, cost: f32, node: u32) {
        self.put((cost.to_bits(), node));
    }

    #[inline]
    fn put(&mut self, entry: (u32, u32)) {
        let bucket = 32 - (entry.0 ^ self.last).leading_zeros();
        self.buckets[bucket as usize].push(entry);
    }

    #[inline]
    fn pop(&mut self) -> Option<(f32, u32)> {
        if self.buckets[0].is_empty() {
            let index = self.buckets.iter().position(|bucket| !bucket.is_empty())?;
            let mut bucket = std::mem::take(&mut self.buckets[index]);
            self.last = bucket.iter().map(|(cost, _)| *cost).min()?;
            bucket.drain(..).for_each(|entry| self.put(entry));
            self.buckets[index] = bucket;
        }
        self.buckets[0].pop().map(|(cost, node)| (f32::from_bits(cost), node))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_heap_gives_back_what_was_pushed_in_order() {
        let mut heap = RadixHeap::default();
        let mut stream = weald_contract::Seed(4).stream("heap", 0);
        let mut popped = Vec::new();
        let mut count = 0;
        for node in 0..50 {
            heap.push(stream.range(0.0, 10.0) as f32, node);
            count += 1;
        }
        while let Some((cost, _)) = heap.pop() {
            popped.push(cost);
            // Like Dijkstra's method: nothing below what was popped.
            if count < 3000 {
                for _ in 0..2 {
                    heap.push(cost + stream.range(0.0, 3.0) as f32, 0);
                    count += 1;
                }
            }
        }
        assert_eq!(popped.len(), count);
        assert!(popped.windows(2).all(|pair| pair[0] <= pair[1]));
    }
}
