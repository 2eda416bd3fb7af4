//! Floods the leaves of a [`Reach`] from outside, and finds openings of undecided width.

use std::collections::VecDeque;

use super::octree::{Fit, Reach};
use crate::mesh::UnionFind;

/// How much longer than the shortest way through undecided leaves a way may be, in leaves,
/// to be split in the same round.
const EXTRA_HOPS: u32 = 3;

/// The leaves that the ball reaches, through open leaves alone or through undecided ones too.
pub(super) struct Flood {
    /// For each node the smallest node of its component of open leaves.
    sure: Vec<u32>,
    /// The same through undecided leaves too.
    pub possible: Vec<u32>,
    /// A node outside.
    outer: u32,
}

impl Flood {
    pub fn new(reach: &Reach, pairs: &[[u32; 2]]) -> Self {
        let (mut sure, mut possible) = (UnionFind::new(reach.nodes.len()), UnionFind::new(reach.nodes.len()));
        for &[a, b] in pairs {
            possible.unite(a, b);
            if [a, b].iter().all(|&node| reach.nodes[node as usize].fit == Fit::Open) {
                sure.unite(a, b);
            }
        }
        let outer = reach.leaf([0; 3], reach.finest).0;
        Self { sure: sure.into_roots(), possible: possible.into_roots(), outer }
    }

    /// Whether the ball certainly comes to an open node from outside.
    pub fn is_sure(&self, node: u32) -> bool {
        self.sure[node as usize] == self.sure[self.outer as usize]
    }

    /// Whether the ball may come to a node from outside.
    pub fn is_possible(&self, node: u32) -> bool {
        self.possible[node as usize] == self.possible[self.outer as usize]
    }

    /// The undecided leaves on the shortest ways from air that is surely outside to air that may be: the openings whose
    /// width is undecided. Numbers of leaves, in ascending order.
    pub fn openings(&self, reach: &Reach, pairs: &[[u32; 2]]) -> Vec<u32> {
        let fit = |node: u32| reach.nodes[node as usize].fit;
        let is_doubtful = |node: u32| fit(node) == Fit::Open && self.is_possible(node) && !self.is_sure(node);
        if !reach.leaves.iter().any(|&(node, ..)| is_doubtful(node)) {
            return Vec::new();
        }
        let neighbours = Neighbours::new(reach.nodes.len(), pairs);
        let hops = |is_start: &dyn Fn(u32) -> bool| {
            let mut hops = vec![u32::MAX; reach.nodes.len()];
            let mut queue: VecDeque<u32> =
                reach.leaves.iter().map(|leaf| leaf.0).filter(|&node| is_start(node)).collect();
            queue.iter().for_each(|&node| hops[node as usize] = 0);
            while let Some(node) = queue.pop_front() {
                for &to in neighbours.of(node) {
                    if fit(to) == Fit::Undecided && hops[to as usize] == u32::MAX {
                        hops[to as usize] = hops[node as usize] + 1;
                        queue.push_back(to);
                    }
                }
            }
            hops
        };
        let from_outside = hops(&|node| fit(node) == Fit::Open && self.is_sure(node));
        let from_inside = hops(&is_doubtful);
        let way = |node: u32| from_outside[node as usize].saturating_add(from_inside[node as usize]);
        let leaves = || (0u32..).zip(&reach.leaves).filter(|(_, leaf)| fit(leaf.0) == Fit::Undecided);
        let can_split = |level: u32| level < reach.finest;
        let shortest = leaves().filter(|(_, leaf)| can_split(leaf.1)).map(|(_, leaf)| way(leaf.0)).min();
        let Some(most) = shortest.filter(|&way| way < u32::MAX).map(|way| way + EXTRA_HOPS) else { return Vec::new() };
        leaves().filter(|(_, leaf)| can_split(leaf.1) && way(leaf.0) <= most).map(|(at, _)| at).collect()
    }
}

/// The neighbours of each node, in a compact array.
struct Neighbours {
    first: Vec<u32>,
    nodes: Vec<u32>,
}

impl Neighbours {
    fn new(count: usize, pairs: &[[u32; 2]]) -> Self {
        let mut first = vec![0u32; count + 1];
        pairs.iter().flatten().for_each(|&node| first[node as usize + 1] += 1);
        for node in 0..count {
            first[node + 1] += first[node];
        }
        let (mut next, mut nodes) = (first.clone(), vec![0u32; 2 * pairs.len()]);
        for &[a, b] in pairs {
            for (from, to) in [(a, b), (b, a)] {
                nodes[next[from as usize] as usize] = to;
                next[from as usize] += 1;
            }
        }
        Self { first, nodes }
    }

    fn of(&self, node: u32) -> &[u32] {
        &self.nodes[self.first[node as usize] as usize..self.first[node as usize + 1] as usize]
    }
}
