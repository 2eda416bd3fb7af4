//! Predicates, boxes, and the tree over obvhs.
//!
//! Where topology is decided, signs are exact (Shewchuk's adaptive predicates through the crate `robust`); boxes and
//! the tree only ever narrow down what the predicates look at.

mod angular;
mod boxes;
mod distance;
mod precision;
mod predicates;
mod ray;
mod sequence;
mod tree;
mod triangle_pair;

pub use angular::{order_around, sort_by_angle};
pub use boxes::Box3;
pub use distance::{nearest_on_segment, nearest_on_triangle, nearest_within, within};
pub use precision::{Precision, Rounding};
pub use predicates::{Sign, area_vanishes, collinear, midmost, orient2d, orient3d, to_unit_range, unit_scale};
pub use ray::{Crossing, crossing, hit, ray_direction};
pub use sequence::{r2, r3};
pub use tree::{Ball, Dipoles, Frame, GrowingTree, Hit, Nearest, OppositeFaces, PairSearch, Tree, winding_exact};
pub use triangle_pair::{Contact, common_point, contact};
