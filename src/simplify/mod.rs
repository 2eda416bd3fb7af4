//! Mesh simplification by edge collapse, cheapest edge first. A collapse is made only if it preserves every property
//! listed at [`Simplify::apply`].
//!
//! ```text
//!      x---x            x---x
//!     / \ / \          / \ / \
//!    x---a---b    ->  x---p   x      removes the two faces at edge a-b
//!     \ / \ /          \ / \ /
//!      x---x            x---x
//! ```
//!
//! [`queue`] chooses the new vertex position and the cost of a collapse; [`collapse`] decides whether the collapse is
//! allowed.

mod collapse;
mod decimate;
mod deviation;
mod dynamic_mesh;
mod queue;
mod slabs;
mod validity;

use crate::context::{Cancelled, Context};
use crate::mesh::Surface;
use decimate::Constraints;

pub use decimate::{Simplified, Simplify};
pub use deviation::Reference;

impl Simplify<'_> {
    /// Collapses edges, cheapest first by area-weighted quadrics (Garland and Heckbert 1997), until `max_faces` is
    /// reached or no edge may collapse.
    ///
    /// An edge collapses only if
    /// - the topology stays the same: closed, manifold, with as many handles and parts (link condition of Dey,
    ///   Edelsbrunner, Guha and Nekhayev 1999);
    /// - boundary and sharp edges keep their line;
    /// - no closed part shrinks to less than half of its volume or grows to more than twice its volume;
    /// - no face turns by more than 78 degrees in one collapse, loses its area or becomes a needle;
    /// - the error stays within its bound;
    /// - the changed faces meet no other face. This test is exact on the output positions, rounded to f32 if requested.
    ///   Like a reader of STL, the test treats vertices at one position as one.
    ///
    /// There is no precondition. Vertices whose faces do not form one fan, or are inconsistently oriented, keep their
    /// position and all their edges. Where faces intersect, a collapse that would leave one of its faces intersecting
    /// is refused, so the number of intersecting pairs only decreases. Each face keeps its source, and the order of
    /// faces stays the same. If no edge collapses, the surface is unchanged. The result is deterministic.
    ///
    /// # Errors
    /// [`Cancelled`] if the work is cancelled, or the deadline passes before the first collapse; the surface is then
    /// unchanged. A later deadline ends the work with the collapses made so far, and all guarantees above hold.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Simplified, Cancelled> {
        if self.max_faces.is_none() && self.max_error.is_finite() && slabs::is_large(surface) {
            return slabs::simplify_in_slabs(self, surface, context);
        }
        self.apply_constrained(surface, &Constraints::default(), context)
    }
}
