//! Floods the leaves of a [`Reach`] from outside, and finds openings of undecided width.

use std::collections::VecDeque;

use rayon::prelude::*;

use super::octree::{BATCH, Fit, LEAF, Leaf, Reach};
use crate::context::{Cancelled, Context};
use crate::mesh::UnionFind;

/// How much longer than the shortest way through undecided leaves a way may be, in leaves,
/// to be split in the same round.
const EXTRA_HOPS: u32 = 3;

/// Which leaves touch each other, kept up to date while undecided leaves are split.
pub(super) struct Adjacency {
    /// The components of open leaves, over all nodes. They only grow, since open leaves are never split.
    open: UnionFind,
    /// The pairs of adjacent leaves that are not blocked, of which one or both are undecided. The first is not larger
    /// than the second.
    undecided: Vec<[u32; 2]>,
}

impl Adjacency {
    /// Finds the pairs of adjacent leaves, and joins the open ones.
    pub fn new(reach: &Reach, context: &Context<'_>) -> Result<Self, Cancelled> {
        let mut adjacency = Self { open: UnionFind::new(reach.nodes.len()), undecided: Vec::new() };
        adjacency.add(reach, &reach.leaves, context)?;
        Ok(adjacency)
    }

    /// Follows a round of splitting, after which the leaves of `reach` are up to date. `first_new` is the first node
    /// that was added.
    pub fn update(&mut self, reach: &Reach, first_new: u32, context: &Context<'_>) -> Result<(), Cancelled> {
        self.open.extend_to(reach.nodes.len());
        let is_split = |node: u32| reach.nodes[node as usize].children != LEAF;
        // The leaves whose neighbours are looked up: new ones, and those that touched a leaf that was split.
        let mut is_changed = vec![false; reach.nodes.len()];
        is_changed[first_new as usize..].fill(true);
        for &[a, b] in &self.undecided {
            is_changed[a as usize] |= is_split(b);
        }
        self.undecided.retain(|&[a, b]| !is_changed[a as usize] && !is_split(a) && !is_split(b));
        let changed: Vec<Leaf> = reach.leaves.iter().filter(|leaf| is_changed[leaf.0 as usize]).copied().collect();
        self.add(reach, &changed, context)
    }

    /// Adds the pairs of some leaves with their neighbours of the same or a larger size.
    fn add(&mut self, reach: &Reach, leaves: &[Leaf], context: &Context<'_>) -> Result<(), Cancelled> {
        for batch in leaves.chunks(BATCH) {
            context.check()?;
            let pairs: Vec<[u32; 2]> = batch.par_iter().flat_map_iter(|&leaf| reach.neighbours(leaf)).collect();
            for [a, b] in pairs {
                if [a, b].iter().all(|&node| reach.nodes[node as usize].fit == Fit::Open) {
                    self.open.unite(a, b);
                } else {
                    self.undecided.push([a, b]);
                }
            }
        }
        Ok(())
    }
}

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
    /// Joins the leaves into components: once the open leaves alone, and once with the undecided ones too.
    pub fn new(reach: &Reach, adjacency: &Adjacency) -> Self {
        let sure = adjacency.open.clone();
        let mut possible = sure.clone();
        adjacency.undecided.iter().for_each(|&[a, b]| possible.unite(a, b));
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
    pub fn openings(&self, reach: &Reach, adjacency: &Adjacency) -> Vec<u32> {
        let fit = |node: u32| reach.nodes[node as usize].fit;
        let is_doubtful = |node: u32| fit(node) == Fit::Open && self.is_possible(node) && !self.is_sure(node);
        if !reach.leaves.iter().any(|&(node, ..)| is_doubtful(node)) {
            return Vec::new();
        }
        let neighbours = Neighbours::new(reach.nodes.len(), &adjacency.undecided);
        let hops = |is_start: &dyn Fn(u32) -> bool| {
            let mut hops = vec![u32::MAX; reach.nodes.len()];
            // Open leaves between open leaves only have no way to go.
            let touches_undecided = |node: u32| !neighbours.of(node).is_empty();
            let mut queue: VecDeque<u32> =
                reach.leaves.iter().map(|leaf| leaf.0).filter(|&at| touches_undecided(at) && is_start(at)).collect();
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
