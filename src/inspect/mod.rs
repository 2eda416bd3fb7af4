//! What is wrong with a mesh: one analysis, the same for input and output.
//!
//! [`Analysis`] finds the structure once; [`measures`] counts, the other files each look at one thing, and [`inspect`]
//! puts all of it in one [`Inspection`].

mod analysis;
mod compare;
mod duplicates;
mod findings;
mod inspection;
mod measure;
mod measures;
mod nesting;
mod print;
mod queries;
mod solids;
mod spacing;

pub use analysis::{Analysis, Subject};
pub use compare::{
    COMPARISON_VERSION, Changes, CompareOptions, Comparison, Deviation, InsideAgreement, Original, Spread, compare,
    percent,
};
pub use duplicates::{FaceGroups, group_faces};
pub use findings::{Defect, DefectGroup, DefectKind, Findings, Meeting};
pub use inspection::{INSPECTION_VERSION, InspectOptions, Inspection, Level, inspect};
use measure::finite;
pub use measure::{measure, measures};
pub use measures::{BoundingBox, Measures, SelfIntersections, Volume};
pub use nesting::nesting_depths;
pub use print::{Fit, NoWall, Overhang, OverhangArea, PrintMeasures, ThinnestWall, Unit, UnitSource, print_measures};
pub use solids::{Solid, doubled_areas, solids};
pub use spacing::{Gap, Spacing, spacing};
