//! Geometric predicates, bounding boxes, and bounding volume hierarchies over triangles (crate `obvhs`).
//!
//! Every decision of topology takes the exact sign of a determinant (Shewchuk's adaptive predicates, through the crate
//! `robust`). Boxes and trees only select the candidates that the predicates then test.

mod boxes;
mod bvh_build;
mod hubs;
mod nearest;
mod opposite;
mod pairs;
mod planar;
mod polygon;
mod precision;
mod predicates;
mod segment;
mod sequence;
pub(crate) mod threads;
mod tree;
mod triangle;
mod triangle_pair;
mod winding;

pub use boxes::Box3;
pub use hubs::Hubs;
pub use nearest::{Ball, Nearest};
pub use opposite::OppositeFaces;
pub use pairs::{ChangedTriangles, Hit, PairSearch};
pub use planar::triangulated_area;
pub use polygon::{Polygon, clip, covered, sides_along};
pub use precision::{Precision, Rounding, to_unit_range, unit_scale};
pub use predicates::{
    Sign, area_vanishes, collinear, index_of_middle, order_around, orient2d, orient3d, sort_by_angle,
};
pub use sequence::{r2, r3, ray_direction};
pub use tree::{Frame, GrowingTree, Tree};
pub(crate) use tree::{triangles_of, vec3a};
pub use triangle::{
    Crossing, SharpFold, centre_and_radius, crossing, halves, hit, longest_side_first, longest_squared,
    nearest_on_segment, nearest_on_triangle, nearest_within, within,
};
pub use triangle_pair::{Contact, common_point, contact, intersection};
pub use winding::{Dipoles, WindingRule, winding_exact};
