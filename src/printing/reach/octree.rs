//! The octree of a [`Reach`], and the labels of its nodes.

use glam::DVec3;

/// Nodes evaluated between two checks for cancellation.
pub(super) const BATCH: usize = 1 << 14;
/// A node that is not split.
pub(super) const LEAF: u32 = 0;

/// Where the centre of the ball may be.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Reached {
    /// The ball fits, and comes here from outside.
    Outside,
    /// The ball comes here from outside only if some opening as wide as the ball, within the resolution, lets it pass.
    Doubtful,
    /// The ball fits, but cannot come here from outside: the index of the hidden region.
    Hidden(u32),
    /// The ball does not fit.
    Blocked,
}

/// A region in which the ball fits, and which it cannot reach from outside. The inside of a solid is such a region too.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct HiddenRegion {
    /// A point of the region where the ball fits.
    pub at: DVec3,
    /// Lower bound of the volume of all positions that the ball's centre can have.
    pub volume: f64,
}

/// Whether the ball fits in a node.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Fit {
    /// Everywhere.
    Open,
    /// Nowhere.
    Blocked,
    /// At the finest size, in a part of the node.
    Undecided,
}

/// A node of the octree. Its eight children follow each other.
#[derive(Debug, Clone, Copy)]
pub(super) struct Node {
    /// The first child, or [`LEAF`].
    pub children: u32,
    pub fit: Fit,
    /// The label of a leaf.
    pub reached: Reached,
}

/// A node without children, its level and its cell at that level.
pub(super) type Leaf = (u32, u32, [u32; 3]);

/// The octree of the air that a ball can reach.
pub struct Reach {
    pub(super) diameter: f64,
    pub(super) low: DVec3,
    pub(super) side: f64,
    /// The finest level without refinement, and with it.
    pub(super) depth: u32,
    pub(super) finest: u32,
    pub(super) nodes: Vec<Node>,
    pub(super) leaves: Vec<Leaf>,
    pub(super) regions: Vec<HiddenRegion>,
    pub(super) doubtful_volume: f64,
}

impl Reach {
    /// The node at or above a cell of a level, and the level of that node.
    pub(super) fn leaf(&self, cell: [u32; 3], level: u32) -> (u32, u32) {
        let mut at = 0u32;
        for step in 0..level {
            let children = self.nodes[at as usize].children;
            if children == LEAF {
                return (at, step);
            }
            let shift = level - 1 - step;
            at = children + cell.iter().enumerate().map(|(axis, x)| (x >> shift & 1) << axis).sum::<u32>();
        }
        (at, level)
    }

    /// The pairs of a leaf that is not blocked with its neighbours of the same or a larger size that are not blocked.
    pub(super) fn neighbours(&self, (node, level, cell): Leaf) -> impl Iterator<Item = [u32; 2]> + use<> {
        let mut pairs = smallvec::SmallVec::<[[u32; 2]; 6]>::new();
        if self.nodes[node as usize].fit != Fit::Blocked {
            let cells = 1u32 << level;
            for (axis, up) in [0, 1, 2].into_iter().flat_map(|axis| [(axis, false), (axis, true)]) {
                let mut beside = cell;
                beside[axis] = if up { cell[axis] + 1 } else { cell[axis].wrapping_sub(1) };
                if beside[axis] >= cells {
                    continue;
                }
                let (other, _) = self.leaf(beside, level);
                let Node { children, fit, .. } = self.nodes[other as usize];
                if children == LEAF && fit != Fit::Blocked {
                    pairs.push([node, other]);
                }
            }
        }
        pairs.into_iter()
    }
}

impl Node {
    /// A leaf of which it is not yet known whether the ball fits.
    pub const fn undecided() -> Self {
        Self { children: LEAF, fit: Fit::Undecided, reached: Reached::Blocked }
    }
}
