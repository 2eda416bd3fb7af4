//! Meshes, as a ladder of types with growing guarantees.
//!
//! [`Soup`] is what a file says and promises nothing.

mod soup;

pub use soup::Soup;
