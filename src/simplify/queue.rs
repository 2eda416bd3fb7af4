use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

/// An edge that waits to be collapsed.
#[derive(Debug, Clone, Copy)]
pub(super) struct Waiting {
    /// The bits of its cost, which is not negative, so that they are ordered as it is.
    cost: u64,
    /// Its vertices, the smaller first.
    pub ends: [u32; 2],
    /// The sum of their versions when it was put in.
    pub version: u32,
    /// Whether it is on a line.
    pub along_line: bool,
    /// Whether it has waited for others already.
    pub patient: bool,
}

impl Waiting {
    pub fn new([a, b]: [u32; 2], version: u32, along_line: bool) -> Self {
        Self { cost: 0, ends: [a.min(b), a.max(b)], version, along_line, patient: false }
    }

    pub fn with_cost(self, cost: f64) -> Self {
        Self { cost: cost.max(0.0).to_bits(), ..self }
    }

    /// The same edge when it has waited, at so many times its cost.
    pub fn patient(self, times: f64) -> Self {
        Self { patient: true, ..self.with_cost(f64::from_bits(self.cost) * times) }
    }

    /// One number that is ordered by cost, then by vertices.
    fn key(&self) -> u128 {
        let [a, b] = self.ends.map(u128::from);
        u128::from(self.cost) << 64 | a << 32 | b
    }
}

impl Ord for Waiting {
    /// By cost, then by vertices.
    fn cmp(&self, other: &Self) -> Ordering {
        self.key().cmp(&other.key())
    }
}

impl PartialOrd for Waiting {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Waiting {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Waiting {}

/// Edges, the cheapest first. Of one edge there may be several, of which all but one are of an earlier version.
#[derive(Default)]
pub(super) struct Queue {
    heap: BinaryHeap<Reverse<Waiting>>,
}

impl Queue {
    pub fn push(&mut self, waiting: Waiting) {
        self.heap.push(Reverse(waiting));
    }

    /// Puts edges in the place of what is in the queue, in linear time.
    pub fn fill(&mut self, edges: impl Iterator<Item = Waiting>) {
        let mut list = std::mem::take(&mut self.heap).into_vec();
        list.clear();
        list.extend(edges.map(Reverse));
        self.heap = BinaryHeap::from(list);
    }

    pub fn pop(&mut self) -> Option<Waiting> {
        self.heap.pop().map(|Reverse(waiting)| waiting)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cheapest_edge_comes_first_and_of_equals_that_of_the_smallest_vertices() {
        let mut queue = Queue::default();
        let edge = |a, b, cost| Waiting::new([a, b], 0, false).with_cost(cost);
        queue.fill([edge(5, 4, 1.0), edge(9, 8, 0.0), edge(3, 2, 1e-300)].into_iter());
        queue.push(edge(1, 7, 1.0));
        queue.push(edge(0, 6, 0.5).patient(4.0));
        let order: Vec<_> = std::iter::from_fn(|| queue.pop()).map(|it| it.ends).collect();
        assert_eq!(order, [[8, 9], [2, 3], [1, 7], [4, 5], [0, 6]]);
    }
}
