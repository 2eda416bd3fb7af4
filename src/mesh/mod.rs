//! Meshes, as types with growing guarantees.
//!
//! [`Soup`] is what a file says and promises nothing. [`Surface`] is finite, indexed and welded at equal positions,
//! and remembers which input face each face comes from; it may still be non-manifold, open or wrongly turned. What
//! holds beyond that is asked of its [`Edges`], [`Parts`] and [`Fans`]. [`ClosedSurface`] encloses something; it is checked once,
//! where it is made.

mod adjacency;
mod connectivity;
mod loops;
mod soup;
mod surface;
mod weld;

pub use adjacency::{Edges, Stars};
pub use connectivity::{Fans, Parts, UnionFind};
pub use loops::{BoundaryLoops, boundary_chains, boundary_loops, count_boundary_chains};
pub use soup::{CornerNormals, LeftOutFace, Numbering, Soup};
pub use surface::{
    BASE_SOURCE, ClosedSurface, Ingest, NO_SOURCE, NotClosed, OPENED_SKIN_SOURCE, SKIN_SOURCE, Surface, is_made,
    position_key,
};
pub use weld::weld_exactly;
