//! Repair: operators (one file each), presets and the plan as data, and the pipeline on one page.
//!
//! [`repair`] is the way in. A plan ([`make_plan`]) is a list of rungs, a rung a list of actions, an action a list of
//! [`operators`]; those work on a [`crate::mesh::Surface`] and answer what they changed as [`Change`]s.

mod abridge;
mod account;
mod agreement;
mod apart;
mod assumed;
mod assumptions;
mod body;
mod category;
mod change;
mod checkpoints;
mod climb;
mod drawings;
mod dress;
mod input;
mod invented;
mod ledger;
mod limited_options;
mod objects;
mod one_object;
pub mod operators;
mod options;
mod options_not_applied;
mod outcome;
mod overlaps;
mod pipeline;
mod plan;
mod presets;
mod red_flags;
mod remesher;
mod repaint;
mod report;
mod requests;
mod settled;
pub mod sheets;
mod summary;
mod tiers;
mod time_budget;
mod unite;
mod verdict;

pub use crate::context::{Cancelled, Context, NoProgress, Progress, Stage, monotonic_clock};
pub use crate::inspect::OptionsError;
pub use abridge::ReportedOptions;
pub use assumptions::{Assumption, AssumptionKind};
pub use category::categorise;
pub use change::{Change, ChangeKind};
pub use drawings::draw;
pub use ledger::ledger;
pub use objects::ObjectReport;
pub use operators::Operator;
pub use options::{InsideRule, Merge, OpenSheets, Options, OutputFormat, Overlaps, Preset, Require};
pub use options_not_applied::{NotAppliedCause, OptionNotApplied, options_accounted_for};
pub use outcome::{HandedOut, Outcome, Property, Verdict};
pub use pipeline::{RepairError, Repaired, repair};
pub use plan::make_plan;
pub use red_flags::{Standing, red_flags};
pub use remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};
pub use report::*;
pub use time_budget::promised_overrun;
