//! The priority queue of edges, and the choice of the cheapest way to collapse each.

use std::cmp::{Ordering, Reverse};
use std::collections::BinaryHeap;

use glam::DVec3;

use super::dynamic_mesh::{DynamicMesh, LINE, OPEN, corner};
use crate::math::Rounding;
use crate::mesh::Edges;

/// Cost of an edge's length alone, per length to the fourth power. It orders edges with zero quadric error, so that a
/// plane collapses evenly and not from one side. It is negligible against a fold of a thousandth of the length.
const COST_OF_LENGTH: f64 = 1e-6;
/// Distance from a vertex's planes that rounding to f32 explains, in the scaled coordinates of the exact predicates.
const ROUNDING_DISTANCE: f64 = 2.4e-7;
/// Maximum distance of a new vertex from the edge's midpoint, in lengths of the edge.
const MAX_OFFSET: f64 = 2.0;

/// A candidate edge for a collapse.
#[derive(Debug, Clone, Copy)]
pub(super) struct Candidate {
    /// The bits of the nonnegative cost, which are ordered like the cost.
    cost: u64,
    /// The vertices, the smaller first.
    pub ends: [u32; 2],
    /// The sum of the vertices' versions when the candidate was queued.
    pub version: u32,
    /// Whether the edge is on a line.
    pub along_line: bool,
    /// Whether the edge was already deferred once.
    pub deferred: bool,
}

impl Candidate {
    /// A candidate with cost 0.
    pub fn new([a, b]: [u32; 2], version: u32, along_line: bool) -> Self {
        Self { cost: 0, ends: [a.min(b), a.max(b)], version, along_line, deferred: false }
    }

    /// The candidate with another cost.
    pub fn with_cost(self, cost: f64) -> Self {
        Self { cost: cost.max(0.0).to_bits(), ..self }
    }

    /// The deferred candidate, with its cost multiplied by `factor`.
    pub fn deferred(self, factor: f64) -> Self {
        Self { deferred: true, ..self.with_cost(f64::from_bits(self.cost) * factor) }
    }

    /// A sort key: by cost, then by vertices.
    fn key(&self) -> u128 {
        let [a, b] = self.ends.map(u128::from);
        u128::from(self.cost) << 64 | a << 32 | b
    }
}

impl Ord for Candidate {
    /// By cost, then by vertices.
    fn cmp(&self, other: &Self) -> Ordering {
        self.key().cmp(&other.key())
    }
}

impl PartialOrd for Candidate {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Candidate {
    fn eq(&self, other: &Self) -> bool {
        self.key() == other.key()
    }
}

impl Eq for Candidate {}

/// A queue of edges, cheapest first. It may contain outdated candidates for the same edge; only the one with the
/// current version is valid.
#[derive(Default)]
pub(super) struct Queue {
    heap: BinaryHeap<Reverse<Candidate>>,
}

impl Queue {
    /// Adds a candidate.
    pub fn push(&mut self, candidate: Candidate) {
        self.heap.push(Reverse(candidate));
    }

    /// Replaces the content of the queue, in linear time.
    pub fn fill(&mut self, edges: impl Iterator<Item = Candidate>) {
        let mut list = std::mem::take(&mut self.heap).into_vec();
        list.clear();
        list.extend(edges.map(Reverse));
        self.heap = BinaryHeap::from(list);
    }

    /// Removes and returns the cheapest candidate.
    pub fn pop(&mut self) -> Option<Candidate> {
        self.heap.pop().map(|Reverse(candidate)| candidate)
    }
}

/// A way to collapse an edge: the removed vertex, the kept vertex, and its new position.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Choice {
    /// The removed vertex.
    pub removed: u32,
    /// The kept vertex.
    pub kept: u32,
    /// New position of the kept vertex.
    pub at: DVec3,
    /// The cost that orders the queue.
    pub cost: f64,
}

/// The cheapest way to collapse an edge that keeps lines in place, if there is one. A vertex on no line may be removed;
/// a vertex inside a line only along that line. A new position is computed only if both ends are on no line.
///
/// An existing end is preferred to a new position if its cost is equal up to rounding, so that flat faces keep their
/// coordinates.
pub(super) fn choose(
    mesh: &DynamicMesh,
    [a, b]: [u32; 2],
    along_line: bool,
    written: impl Fn(DVec3) -> DVec3,
) -> Option<Choice> {
    if mesh.fixed[a as usize] || mesh.fixed[b as usize] {
        return None;
    }
    let [p, q] = [a, b].map(|v| mesh.at[v as usize]);
    let square = p.distance_squared(q);
    let mut quadric = mesh.quadric[a as usize];
    quadric.add(&mesh.quadric[b as usize]);
    let of_length = COST_OF_LENGTH * square * square;
    let may_remove = |v: u32| match mesh.lines[v as usize] {
        0 => true,
        2 => along_line,
        _ => false,
    };
    let keep_end = |removed: u32, kept: u32| {
        let at = mesh.at[kept as usize];
        may_remove(removed).then(|| Choice { removed, kept, at, cost: quadric.at(at) })
    };
    let end = match (keep_end(a, b), keep_end(b, a)) {
        (Some(one), Some(other)) => Some(if other.cost < one.cost { other } else { one }),
        (one, other) => one.or(other),
    }?;
    let mut best = end;
    if mesh.lines[a as usize] == 0
        && mesh.lines[b as usize] == 0
        && end.cost > ROUNDING_DISTANCE * ROUNDING_DISTANCE * quadric.weight
    {
        let middle = p.midpoint(q);
        let new = quadric
            .minimum(middle)
            .map(&written)
            .filter(|new| new.is_finite() && new.distance_squared(middle) <= MAX_OFFSET * MAX_OFFSET * square);
        for at in [new, Some(written(middle))].into_iter().flatten().filter(|at| at.is_finite()) {
            let cost = quadric.at(at);
            if cost < best.cost {
                best = Choice { at, cost, ..best };
            }
        }
    }
    Some(Choice { cost: best.cost + of_length, ..best })
}

/// The version of an edge: the sum of its vertices' versions.
pub(super) fn version(mesh: &DynamicMesh, a: u32, b: u32) -> u32 {
    mesh.version[a as usize].wrapping_add(mesh.version[b as usize])
}

/// Fills the queue with all edges that may collapse.
pub(super) fn fill(queue: &mut Queue, mesh: &DynamicMesh, rounding: Rounding) {
    let corners = (0..mesh.faces.len()).filter(|&f| mesh.is_alive(f)).flat_map(|f| [0, 1, 2].map(|i| corner(f, i)));
    queue.fill(corners.filter_map(|c| {
        let [a, b] = [c, Edges::next(c)].map(|c| mesh.faces[c as usize / 3][c as usize % 3]);
        let marks = mesh.marks(c);
        // Each edge once: consistently oriented faces traverse it in both directions.
        if a > b && marks & OPEN == 0 {
            return None;
        }
        candidate(mesh, a, b, marks, rounding)
    }));
}

fn candidate(mesh: &DynamicMesh, a: u32, b: u32, marks: u8, rounding: Rounding) -> Option<Candidate> {
    let along_line = marks & LINE != 0;
    let edge = Candidate::new([a, b], version(mesh, a, b), along_line);
    choose(mesh, edge.ends, along_line, |p| rounding.of(p)).map(|choice| edge.with_cost(choice.cost))
}

/// Queues the edges around a vertex.
pub(super) fn push_around(
    queue: &mut Queue,
    mesh: &mut DynamicMesh,
    v: u32,
    corners: &mut Vec<u32>,
    rounding: Rounding,
) {
    mesh.star(v, corners);
    for &c in &*corners {
        let to = |c: u32| mesh.faces[c as usize / 3][c as usize % 3];
        let open = Edges::previous(c);
        let mut add = |other: u32, marks: u8| {
            if let Some(candidate) = candidate(mesh, v, other, marks, rounding) {
                queue.push(candidate);
            }
        };
        add(to(Edges::next(c)), mesh.marks(c));
        if mesh.marks(open) & OPEN != 0 {
            add(to(open), mesh.marks(open));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cheapest_edge_comes_first_and_ties_go_to_smaller_vertices() {
        let mut queue = Queue::default();
        let edge = |a, b, cost| Candidate::new([a, b], 0, false).with_cost(cost);
        queue.fill([edge(5, 4, 1.0), edge(9, 8, 0.0), edge(3, 2, 1e-300)].into_iter());
        queue.push(edge(1, 7, 1.0));
        queue.push(edge(0, 6, 0.5).deferred(4.0));
        let order: Vec<_> = std::iter::from_fn(|| queue.pop()).map(|candidate| candidate.ends).collect();
        assert_eq!(order, [[8, 9], [2, 3], [1, 7], [4, 5], [0, 6]]);
    }
}
