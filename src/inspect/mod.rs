//! What is wrong with a mesh: counts and measures, the same for input and output.

mod measures;

pub use measures::{BoundingBox, Measures, SelfIntersections, Volume};
