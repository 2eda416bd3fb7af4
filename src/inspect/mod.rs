//! What is wrong with a mesh: one analysis, the same for input and output.
//!
//! [`Analysis`] finds the structure once; [`measures`] counts, the other files each look at one thing, and [`inspect`]
//! puts all of it in one [`Inspection`].

mod analysis;
mod duplicates;
mod findings;
mod inspection;
mod intersections;
mod lost;
mod measure;
mod measures;
mod nesting;
mod solids;

pub use analysis::{Analysis, Subject};
pub use duplicates::{FaceGroups, group_faces};
pub use findings::{Defect, DefectGroup, DefectKind, Findings, Meeting};
pub use inspection::{INSPECTION_VERSION, InspectOptions, Inspection, Level, inspect};
pub use intersections::{IntersectingPair, Intersections, intersections, intersections_between};
pub use lost::surface_lost_pct;
pub use measure::{measure, measures};
pub use measures::{BoundingBox, Measures, SelfIntersections, Volume};
pub use nesting::nesting_depths;
pub use solids::{Solid, doubled_areas, solids};
