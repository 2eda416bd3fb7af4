//! Repair: operators (one file each), presets and the plan as data, and the pipeline on one page.
//!
//! [`repair`] is the way in. A plan ([`make_plan`]) is a list of strategies, a strategy a list of actions, an action a list of
//! [`operators`]; those work on a [`crate::mesh::Surface`] and answer what they changed as [`Change`]s.

mod account;
mod attribute_transfer;
mod body;
mod change;
mod drawings;
mod ended;
mod escalation;
mod export;
mod input;
mod judge;
mod objects;
pub mod operators;
mod options;
mod options_not_applied;
mod part_accounting;
mod pipeline;
mod plan;
mod prefix_cache;
mod presets;
mod red_flags;
mod remesher;
mod report;
mod runner;
pub mod sheets;
mod tasks;
mod time_budget;
mod unite;

pub use crate::context::{Cancelled, Context, NoProgress, Progress, Stage, monotonic_clock};
pub use crate::inspect::{Certificate, Changes, Ledger, LostPart, OptionsError, PartCertificate};
pub use change::{Change, ChangeKind};
pub use drawings::draw;
pub use input::RepairError;
pub use options::{
    Category, InsideRule, Merge, OpenSheets, Operator, Options, OutputFormat, Overlaps, Preset, Require,
};
pub use options_not_applied::options_accounted_for;
pub use part_accounting::ledger;
pub use pipeline::{Repaired, repair};
pub use plan::{categorise, make_plan};
pub use red_flags::{Compared, Standing, red_flags};
pub use remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};
pub use report::{
    Action, Assumption, AssumptionKind, Candidate, FileSummary, HandedOut, LeftOut, NotAppliedCause, ObjectReport,
    OptionNotApplied, Outcome, Plan, PlannedAction, Property, REPORT_VERSION, RedFlag, RedFlagCode, Report,
    ReportedOptions, Rung, Step, StepStatus, UnfixedFaces, Verdict, When,
};
pub use time_budget::promised_overrun;
