//! A region that a grid samples.

use glam::DVec3;

use super::grid::{Grid, GridIndex};

/// An edge from an outside sample to an inside sample.
pub(super) struct MixedEdge {
    pub from: DVec3,
    pub to: DVec3,
    /// The depth of each end.
    pub depths: [f64; 2],
    /// Whether the inside end was forced inside.
    pub is_forced: bool,
}

/// A region whose boundary is contoured. Points with a depth above the level are inside. `steps` is the work that is left.
pub(super) trait Region: Sync {
    /// The depth inside of each of some samples of one block.
    fn depths_of(&self, grid: &Grid, indices: &[GridIndex], steps: &mut u64) -> Vec<f64>;

    /// The parameter at which an edge first enters the region, and the normal of the boundary there; none if the
    /// boundary is unknown.
    fn crossing_of(&self, edge: &MixedEdge, steps: &mut u64) -> (f64, Option<DVec3>);
}
