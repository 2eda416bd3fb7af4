//! Meshes, as a ladder of types with growing guarantees.
//!
//! [`Soup`] is what a file says and promises nothing. [`Surface`] is finite, indexed and welded at equal positions,
//! and remembers which input face each face comes from; it may still be non-manifold, open or wrongly turned. What
//! holds beyond that is asked of its [`Edges`], [`Parts`] and [`Fans`].

mod edges;
mod extras;
mod fans;
mod loops;
mod parts;
mod soup;
mod surface;
mod union_find;

pub use edges::Edges;
pub use extras::{CornerNormals, Numbering};
pub use fans::Fans;
pub use loops::{BoundaryLoops, boundary_chains, boundary_loops, count_boundary_chains};
pub use parts::Parts;
pub use soup::Soup;
pub use surface::{Ingest, NO_SOURCE, Surface, weld_exactly};
pub use union_find::UnionFind;
