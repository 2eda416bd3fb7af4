//! A minimum cut between two terminals (Dinic 1970), with integer capacities so that the cut is exact.

use std::collections::VecDeque;

use crate::context::{Cancelled, Context};

/// An arc and its reverse follow each other: arc `a` and arc `a ^ 1`.
#[derive(Debug, Clone, Copy)]
struct Arc {
    to: u32,
    capacity: u64,
}

/// A flow network over `n` nodes, each with a capacity from the source or to the sink.
pub struct Network {
    arcs: Vec<Arc>,
    first: Vec<u32>,
    order: Vec<u32>,
    /// Capacity left from the source (positive) or to the sink (negative).
    terminal: Vec<i64>,
}

impl Network {
    /// Builds the network. An edge carries its capacity in both directions.
    pub fn new(terminal: Vec<i64>, edges: &[([u32; 2], u64)]) -> Self {
        let mut first = vec![0u32; terminal.len() + 1];
        for ([a, b], _) in edges {
            first[*a as usize + 1] += 1;
            first[*b as usize + 1] += 1;
        }
        for node in 0..terminal.len() {
            first[node + 1] += first[node];
        }
        let mut next = first.clone();
        let mut order = vec![0u32; 2 * edges.len()];
        let mut arcs = Vec::with_capacity(2 * edges.len());
        for &([a, b], capacity) in edges {
            for (from, to) in [(a, b), (b, a)] {
                order[next[from as usize] as usize] = index(arcs.len());
                next[from as usize] += 1;
                arcs.push(Arc { to, capacity });
            }
        }
        Self { arcs, first, order, terminal }
    }

    /// The nodes on the source's side of the minimum cut that has the fewest such nodes.
    ///
    /// # Errors
    /// [`Cancelled`] on cancellation or timeout.
    pub fn source_side(mut self, context: &Context<'_>) -> Result<Vec<bool>, Cancelled> {
        loop {
            context.check()?;
            let level = self.levels();
            let mut next: Vec<u32> = self.first[..self.terminal.len()].to_vec();
            let mut pushed = 0u64;
            for node in 0..self.terminal.len() {
                while self.terminal[node] > 0 {
                    let flow = self.push(index(node), &level, &mut next);
                    if flow == 0 {
                        break;
                    }
                    pushed += flow;
                }
            }
            if pushed == 0 {
                return Ok(level.into_iter().map(|level| level != u32::MAX).collect());
            }
        }
    }

    fn arcs_of(&self, node: u32) -> impl Iterator<Item = u32> + '_ {
        let range = self.first[node as usize] as usize..self.first[node as usize + 1] as usize;
        self.order[range].iter().copied()
    }

    /// The distance of each node from the source in arcs with capacity left; `u32::MAX` if it is cut off.
    fn levels(&self) -> Vec<u32> {
        let mut level = vec![u32::MAX; self.terminal.len()];
        let mut queue = VecDeque::new();
        for (node, (level, _)) in level.iter_mut().zip(&self.terminal).enumerate().filter(|(_, (_, left))| **left > 0) {
            *level = 0;
            queue.push_back(index(node));
        }
        while let Some(node) = queue.pop_front() {
            for arc in self.arcs_of(node) {
                let Arc { to, capacity } = self.arcs[arc as usize];
                if capacity > 0 && level[to as usize] == u32::MAX {
                    level[to as usize] = level[node as usize] + 1;
                    queue.push_back(to);
                }
            }
        }
        level
    }

    /// Pushes flow from a node with capacity from the source along one shortest path to the sink.
    fn push(&mut self, start: u32, level: &[u32], next: &mut [u32]) -> u64 {
        let mut path: Vec<u32> = Vec::new();
        let mut at = start;
        loop {
            if self.terminal[at as usize] < 0 {
                return self.augment(start, at, &path);
            }
            let end = self.first[at as usize + 1];
            let found = loop {
                if next[at as usize] == end {
                    break None;
                }
                let arc = self.order[next[at as usize] as usize];
                let Arc { to, capacity } = self.arcs[arc as usize];
                if capacity > 0 && level[to as usize] == level[at as usize].wrapping_add(1) {
                    break Some((arc, to));
                }
                next[at as usize] += 1;
            };
            match found {
                Some((arc, to)) => {
                    path.push(arc);
                    at = to;
                }
                None => {
                    let Some(arc) = path.pop() else { return 0 };
                    at = self.arcs[(arc ^ 1) as usize].to;
                    next[at as usize] += 1;
                }
            }
        }
    }

    fn augment(&mut self, start: u32, end: u32, path: &[u32]) -> u64 {
        let ends = self.terminal[start as usize].unsigned_abs().min(self.terminal[end as usize].unsigned_abs());
        let flow = path.iter().map(|&arc| self.arcs[arc as usize].capacity).fold(ends, u64::min);
        for &arc in path {
            self.arcs[arc as usize].capacity -= flow;
            self.arcs[(arc ^ 1) as usize].capacity += flow;
        }
        #[expect(clippy::cast_possible_wrap, reason = "at most a terminal's capacity")]
        let signed = flow as i64;
        self.terminal[start as usize] -= signed;
        self.terminal[end as usize] += signed;
        flow
    }
}

#[expect(clippy::cast_possible_truncation, reason = "nodes and arcs are counted in u32")]
fn index(count: usize) -> u32 {
    count as u32
}
