//! The octree of a [`Reach`], and the labels of its nodes.

use glam::DVec3;

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

/// The octree of the air that a ball can reach.
pub struct Reach {
    pub(super) diameter: f64,
    pub(super) low: DVec3,
    pub(super) side: f64,
    /// The finest level without refinement, and with it.
    pub(super) depth: u32,
    pub(super) finest: u32,
    pub(super) nodes: Vec<Node>,
    /// Leaves with their level and their cell at that level.
    pub(super) leaves: Vec<(u32, u32, [u32; 3])>,
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
}

impl Node {
    pub const fn undecided() -> Self {
        Self { children: LEAF, fit: Fit::Undecided, reached: Reached::Blocked }
    }
}
