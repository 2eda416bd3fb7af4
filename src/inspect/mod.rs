//! What is wrong with a mesh: one analysis, the same for input and output.
//!
//! [`Analysis`] finds the structure once; [`measures`] counts, the other files each look at one thing, and [`inspect`]
//! puts all of it in one [`Inspection`].

mod analysis;
mod attributes;
mod characteristics;
mod compare;
mod contacts;
mod defects;
mod distribution;
mod duplicates;
mod elements;
mod findings;
mod good;
mod inspection;
mod intersections;
mod measure;
mod measures;
mod nesting;
mod options;
mod print;
mod queries;
mod readers;
mod set;
mod shells;
mod solids;
mod spacing;
mod statistics;

pub use analysis::{Analysis, Subject};
pub use attributes::{Answer, Attributes, Unmeasurable};
pub use characteristics::{Characteristics, characteristics};
pub use compare::{
    COMPARISON_VERSION, Certificate, Changes, CompareOptions, Comparison, Deviation, Dispensable, Fate, Fates,
    InsideAgreement, Ledger, LostPart, Original, PartCertificate, Spread, SurfaceShare, SurfaceShares, compare,
    percent,
};
pub use contacts::{InstanceContact, instance_contacts};
pub use defects::{CheckRule, CheckVerdict, Tolerance, ToleranceError, Tolerances, find_defects};
use distribution::finite;
pub use distribution::{BinSpacing, Bins, Distribution, Histogram};
pub use duplicates::{FaceGroups, group_faces};
pub use elements::Elements;
pub use findings::{Defect, DefectGroup, DefectKind, Findings, Meeting};
pub use good::{Goodness, Lack, Shortfall, Thresholds, goodness};
pub use inspection::{INSPECTION_VERSION, InspectOptions, Inspection, Level, inspect, inspect_analysis};
pub use intersections::{IntersectingPair, Intersections, intersections, intersections_between};
pub use measure::{measure, measure_analysis, measures};
pub use measures::{BoundingBox, Measures, SelfIntersections, Volume};
use nesting::depths_of;
pub use nesting::{nesting, nesting_depths};
pub use options::{OptionsError, changed_fields};
pub use print::{
    Fit, NoWall, Overhang, OverhangArea, PrintMeasures, ThinPlace, ThinnestWall, print_measures, thin_walls,
};
pub use readers::{Decimals, joined_by_decimals};
pub use set::{MeshPair, MeshSpacing, Nearest, SetIntersections, SetReport, SetSpacing};
pub use shells::{Shell, Shells, Turning, shells};
pub use solids::{Solid, doubled_areas, solids};
pub use spacing::{Gap, Spacing, spacing};
pub use statistics::{EdgeAngles, Side, Statistics, aspect_ratio, statistics};
