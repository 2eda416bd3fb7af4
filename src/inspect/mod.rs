//! What is wrong with a mesh: one analysis, the same for input and output.
//!
//! [`Analysis`] finds the structure once; [`measures`] counts, the other files each look at one thing, and [`inspect`]
//! puts all of it in one [`Inspection`].

mod analysis;
mod attributes;
mod characteristics;
mod defects;
mod distribution;
mod duplicates;
mod elements;
mod findings;
mod good;
mod inspection;
mod intersections;
mod lost;
mod measure;
mod measures;
mod nesting;
mod options_error;
mod set;
mod shells;
mod solids;
mod statistics;

pub use analysis::{Analysis, Subject};
pub use attributes::{Answer, Attributes, Unmeasurable};
pub use characteristics::{Characteristics, characteristics};
pub use defects::{CheckRule, CheckVerdict, Tolerance, ToleranceError, Tolerances, find_defects};
use distribution::finite;
pub use distribution::{Bins, Distribution, Histogram, Spacing};
pub use duplicates::{FaceGroups, group_faces};
pub use elements::Elements;
pub use findings::{Defect, DefectGroup, DefectKind, Findings, Meeting};
pub use good::{Goodness, Lack, Shortfall, Thresholds, goodness};
pub use inspection::{INSPECTION_VERSION, InspectOptions, Inspection, Level, inspect};
pub use intersections::{IntersectingPair, Intersections, intersections, intersections_between};
pub use lost::surface_lost_pct;
pub use measure::{measure, measures};
pub use measures::{BoundingBox, Measures, SelfIntersections, Volume};
pub use nesting::nesting_depths;
pub use options_error::OptionsError;
pub use set::{MeshPair, MeshSpacing, Nearest, SetIntersections, SetReport, SetSpacing};
pub use shells::{Shell, Shells, Turning, shells};
pub use solids::{Solid, doubled_areas, solids};
pub use statistics::{EdgeAngles, Side, Statistics, statistics};
