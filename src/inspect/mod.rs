//! What is wrong with a mesh: counts and measures, the same for input and output.

mod duplicates;
mod lost;
mod measure;
mod measures;
mod nesting;
mod solids;

pub use duplicates::{FaceGroups, group_faces};
pub use lost::surface_lost_pct;
pub use measure::measure;
pub use measures::{BoundingBox, Measures, SelfIntersections, Volume};
pub use nesting::nesting_depths;
pub use solids::{Solid, doubled_areas, solids};
