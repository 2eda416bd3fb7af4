//! The error of a remesh.

use crate::context::Cancelled;

/// Why no new surface could be built.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum RemeshError {
    /// Nothing is inside.
    #[error("the surface has no inside at any cell size tried")]
    Empty,
    /// The limits allow only cells that are too large to resolve the model.
    #[error("the limits on faces, memory and work are too low for a remesh")]
    Limits,
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
