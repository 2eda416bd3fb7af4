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
pub use crate::inspect::{AccountedPart, Changes, LostPart, OptionsError, PartAccounting, PartReason};
pub use change::{Change, ChangeKind};
pub use drawings::draw;
pub use input::RepairError;
pub use options::{
    Category, Merge, OpenSheets, Operator, Options, OutputFormat, Overlaps, Preset, Require, WindingRuleChoice,
};
pub use options_not_applied::options_accounted_for;
pub use part_accounting::part_accounting;
pub use pipeline::{Repaired, repair};
pub use plan::{categorise, make_plan};
pub use red_flags::{Compared, Standing, red_flags};
pub use remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};
pub use report::{
    Action, Assumption, AssumptionKind, Candidate, FileSummary, NotAppliedCause, ObjectReport, OfferedFile,
    OmittedSection, OptionNotApplied, Outcome, Plan, PlannedAction, Property, REPORT_VERSION, RedFlag, RedFlagCode,
    Report, ReportedOptions, Step, StepStatus, Strategy, UnfixedFaces, Verdict, When,
};
pub use time_budget::promised_overrun;
