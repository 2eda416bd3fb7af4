//! Mesh inspection: finds and measures the defects of a mesh, in the same way for a repair's input and output.
//!
//! [`Analysis`] builds the connectivity once, and [`measures()`] counts. The other files each search for one type of
//! defect or measure one quantity. [`inspect`] combines the results in one [`Inspection`].

mod analysis;
mod check;
mod compare;
mod defects;
mod distribution;
mod findings;
mod inspection;
mod intersections;
mod known_pairs;
mod matching;
mod measure;
mod measures;
mod options;
mod print;
mod ray_winding;
mod sampling;
mod set;
mod shells;
mod solids;
mod statistics;
mod unfolded_stars;

pub use analysis::{Analysis, FileFacts, Subject};
pub use check::{CheckRule, CheckVerdict};
pub use compare::{
    AccountedPart, COMPARISON_VERSION, Changes, CompareOptions, ComparedMesh, Comparison, Deviation, InsideAgreement,
    LostPart, Original, PartAccounting, PartReason, Provenance, Spread, SurfaceProvenance, SurfaceShare, SurfaceShares,
    compare,
};
pub use defects::find_defects;
use distribution::finite;
pub use distribution::{BinSpacing, Bins, Distribution, Histogram, percent};
pub use findings::{Defect, DefectGroup, DefectKind, Findings, Meeting};
pub use inspection::{
    Characteristics, Elements, Goodness, INSPECTION_VERSION, Inspection, Lack, Shortfall, Thresholds, characteristics,
    goodness, inspect, inspect_analysis,
};
pub use intersections::{InstanceContact, instance_contacts, intersections, intersections_between};
pub use known_pairs::{KnownIntersections, SearchedMesh};
pub use matching::{FaceGroups, duplicate_faces, group_faces};
pub use measure::{Decimals, EdgeCounts, joined_by_decimals, measure, measure_analysis, measures};
pub use measures::{BoundingBox, IntersectingPair, Intersections, Measures, SelfIntersections, Volume};
pub use options::{InspectOptions, Level, OptionsError, Tolerance, ToleranceError, Tolerances, changed_fields};
pub use print::{
    Fit, NoWallReason, Overhang, OverhangArea, PrintMeasures, ThinPlace, ThinnestWall, print_measures, thin_walls,
};
pub(crate) use sampling::spread_by_area;
pub use set::{MeshPair, MeshSpacing, Nearest, SetIntersections, SetReport, SetSpacing, Spacing, spacing};
pub use shells::{Answer, Attributes, OrientationCounts, Shell, Shells, Unmeasurable, shells};
pub use solids::{Solid, doubled_areas, nesting, nesting_depths, solids};
pub use statistics::{EdgeAngles, Side, Statistics, aspect_ratio, statistics};
