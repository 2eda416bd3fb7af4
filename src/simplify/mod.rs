//! Fewer faces, and nothing broken by it: edges collapse one by one, cheapest first, and only where all that held before
//! holds afterwards.
//!
//! ```text
//!      x---x            x---x
//!     / \ / \          / \ / \
//!    x---a---b    ->  x---p   x      the two faces between a and b go
//!     \ / \ /          \ / \ /
//!      x---x            x---x
//! ```
//!
//! [`queue`] says where the vertex comes to stand and what that costs, [`collapse`] what must hold.

mod collapse;
mod complex;
mod decimate;
mod deviation;
mod queue;
mod slabs;
mod validity;

use crate::context::{Cancelled, Context};
use crate::mesh::Surface;
use decimate::Held;

pub use decimate::{Simplified, Simplify};
pub use deviation::Reference;

impl Simplify<'_> {
    /// Collapses edges, the cheapest first by quadrics of area (Garland and Heckbert 1997), until there are no more faces than
    /// asked for or no edge may go.
    ///
    /// An edge goes only where
    /// - the surface stays what it is: closed, manifold, of as many handles and parts (the link condition of Dey, Edelsbrunner,
    ///   Guha and Nekhayev 1999); boundary and sharp edges keep their line; no closed part shrinks to less than half of its
    ///   volume or grows to twice of it;
    /// - no face turns by more than 78 degrees at once, loses its area or becomes a needle;
    /// - the error stays within its bound;
    /// - the faces that change meet no other face, decided exactly on the positions that are written, rounded to f32 where
    ///   that is asked for. Vertices at one position are one for this, as they are for a reader of STL.
    ///
    /// Precondition: none. Vertices whose faces do not form one fan, or are turned against one another, are left where they
    /// are with all their edges. Where faces intersect, a collapse that leaves one of its faces intersecting is refused, so
    /// that the pairs only become fewer. Result: a face keeps the source of the face that it was; the order of faces stays;
    /// where nothing goes, the surface is untouched. The same surface gives the same result.
    ///
    /// # Errors
    /// [`Cancelled`] when the work was asked to stop, or the deadline came before the first edge went; the surface is then unchanged.
    /// A deadline that comes later ends it there: what is gone by then is gone, and all that is said above holds.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Simplified, Cancelled> {
        if self.max_faces.is_none() && self.max_error.is_finite() && slabs::is_large(surface) {
            return slabs::simplify_in_slabs(self, surface, context);
        }
        self.apply_held(surface, &Held::default(), context)
    }
}
