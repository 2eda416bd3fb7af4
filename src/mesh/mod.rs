//! Meshes, as types with growing guarantees.
//!
//! [`Soup`] is what a file says and promises nothing. [`Surface`] is finite, indexed and welded at equal positions,
//! and remembers which input face each face comes from; it may still be non-manifold, open or wrongly turned. What
//! holds beyond that is asked of its [`Edges`], [`Parts`] and [`Fans`]. [`ClosedSurface`] encloses something; it is checked once,
//! where it is made.

mod closed;
mod edges;
mod extras;
mod fans;
mod loops;
mod parts;
mod soup;
mod stars;
mod surface;
mod union_find;
mod weld;

pub use closed::{ClosedSurface, NotClosed};
pub use edges::Edges;
pub use extras::{CornerNormals, LeftOutFace, Numbering};
pub use fans::Fans;
pub use loops::{BoundaryLoops, boundary_chains, boundary_loops, count_boundary_chains};
pub use parts::Parts;
pub use soup::Soup;
pub use stars::Stars;
pub use surface::{BASE_SOURCE, Ingest, NO_SOURCE, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, is_made, position_key};
pub use union_find::UnionFind;
pub use weld::weld_exactly;
