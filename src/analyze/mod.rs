//! Analysis of files: read each, look at it, and say everything in one report.
//!
//! [`Analyst`] is the way in: one file after the other is added, and the end is an [`AnalysisReport`]. What is said of
//! each file is the same [`Inspection`](crate::inspect::Inspection) that a repair reports before and after.

mod analyst;
mod options;
mod report;

pub use analyst::{Analyst, AnalyzeError, DrawError, draw, subject};
pub use options::AnalyzeOptions;
pub use report::{ANALYSIS_VERSION, AnalysisReport, FileAnalysis};
