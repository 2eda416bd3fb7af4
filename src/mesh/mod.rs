//! Triangle meshes, as types with growing guarantees.
//!
//! [`Soup`] holds the triangles of a file and guarantees little. [`Surface`] is finite, indexed and welded at equal
//! positions, and records the input face of each face. It may still be non-manifold, open or inconsistently wound.
//! [`Edges`], [`Parts`] and [`Fans`] answer further questions about its connectivity. [`ClosedSurface`] is checked
//! once, on construction.

mod adjacency;
mod connectivity;
mod distinct;
mod loops;
mod soup;
mod surface;
mod weld;

pub use adjacency::{Edges, HalfEdge, Stars};
pub use connectivity::{Fans, Parts, UnionFind};
pub use distinct::{are_distinct, first_equal, hash_coordinates, number_by_first, position_key};
pub use loops::{BoundaryLoops, boundary_chains, boundary_loops, count_boundary_chains};
pub use soup::{CornerNormals, Numbering, OmittedFace, Soup};
pub use surface::{
    BASE_SOURCE, ClosedSurface, Ingest, NO_SOURCE, NotClosed, OPENED_SKIN_SOURCE, REQUESTED_SOURCE, SKIN_SOURCE,
    Surface, is_generated,
};
pub use weld::weld_exactly;
