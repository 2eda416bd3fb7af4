use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use glam::DVec3;

use super::complex::{Complex, LINE, OPEN, corner};
use crate::math::Rounding;
use crate::mesh::Edges;

/// What an edge costs for its length alone, per length to the fourth. It orders what quadrics call free, so that a plane
/// collapses evenly and not from one side, and counts for nothing against a fold of a thousandth of the length.
const COST_OF_LENGTH: f64 = 1e-6;
/// Distance from its planes, in the range of exact predicates, that rounding to f32 explains.
const ROUNDING: f64 = 2.4e-7;
/// The farthest from an edge's middle that its vertex may come to stand, in lengths of the edge.
const FARTHEST: f64 = 2.0;

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

/// Which end of an edge goes, and where the other stands then.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    pub gone: u32,
    pub kept: u32,
    pub at: DVec3,
    /// What orders the queue.
    pub cost: f64,
}

/// The cheapest way to collapse an edge that keeps lines where they are, if there is one: a vertex on no line may go, and
/// one that is no end or branch of its line along that line. Only where both ends are on no line is a new position made.
///
/// An end is preferred to a new position where it is as good but for rounding, so that flat faces keep their coordinates.
pub(super) fn choose(
    it: &Complex,
    [a, b]: [u32; 2],
    along_line: bool,
    written: impl Fn(DVec3) -> DVec3,
) -> Option<Choice> {
    if it.fixed[a as usize] || it.fixed[b as usize] {
        return None;
    }
    let [p, q] = [a, b].map(|v| it.at[v as usize]);
    let square = p.distance_squared(q);
    let mut quadric = it.quadric[a as usize];
    quadric.add(&it.quadric[b as usize]);
    let of_length = COST_OF_LENGTH * square * square;
    let may_go = |v: u32| match it.lines[v as usize] {
        0 => true,
        2 => along_line,
        _ => false,
    };
    let stay = |gone: u32, kept: u32| {
        let at = it.at[kept as usize];
        may_go(gone).then(|| Choice { gone, kept, at, cost: quadric.at(at) })
    };
    let end = match (stay(a, b), stay(b, a)) {
        (Some(one), Some(other)) => Some(if other.cost < one.cost { other } else { one }),
        (one, other) => one.or(other),
    }?;
    let mut best = end;
    if it.lines[a as usize] == 0 && it.lines[b as usize] == 0 && end.cost > ROUNDING * ROUNDING * quadric.weight {
        let middle = p.midpoint(q);
        let new = quadric
            .lowest(middle)
            .map(&written)
            .filter(|new| new.is_finite() && new.distance_squared(middle) <= FARTHEST * FARTHEST * square);
        for at in [new, Some(written(middle))].into_iter().flatten().filter(|at| at.is_finite()) {
            let cost = quadric.at(at);
            if cost < best.cost {
                best = Choice { at, cost, ..best };
            }
        }
    }
    Some(Choice { cost: best.cost + of_length, ..best })
}

pub(super) fn version(it: &Complex, a: u32, b: u32) -> u32 {
    it.version[a as usize].wrapping_add(it.version[b as usize])
}

/// Fills the queue with all edges that may go.
pub(super) fn fill(queue: &mut Queue, it: &Complex, rounding: Rounding) {
    let corners = (0..it.faces.len()).filter(|&f| it.is_alive(f)).flat_map(|f| [0, 1, 2].map(|i| corner(f, i)));
    queue.fill(corners.filter_map(|c| {
        let [a, b] = [c, Edges::next(c)].map(|c| it.faces[c as usize / 3][c as usize % 3]);
        let marks = it.marks(c);
        // Each edge once: faces that agree run along it in both directions.
        if a > b && marks & OPEN == 0 {
            return None;
        }
        waiting(it, a, b, marks, rounding)
    }));
}

fn waiting(it: &Complex, a: u32, b: u32, marks: u8, rounding: Rounding) -> Option<Waiting> {
    let along_line = marks & LINE != 0;
    let edge = Waiting::new([a, b], version(it, a, b), along_line);
    choose(it, edge.ends, along_line, |p| rounding.of(p)).map(|choice| edge.with_cost(choice.cost))
}

/// Puts the edges around a vertex into the queue.
pub(super) fn push_around(queue: &mut Queue, it: &mut Complex, v: u32, corners: &mut Vec<u32>, rounding: Rounding) {
    it.star(v, corners);
    for &c in &*corners {
        let to = |c: u32| it.faces[c as usize / 3][c as usize % 3];
        let open = Edges::previous(c);
        let mut add = |other: u32, marks: u8| {
            if let Some(waiting) = waiting(it, v, other, marks, rounding) {
                queue.push(waiting);
            }
        };
        add(to(Edges::next(c)), it.marks(c));
        if it.marks(open) & OPEN != 0 {
            add(to(open), it.marks(open));
        }
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
