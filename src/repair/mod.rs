//! Mesh repair: the pipeline, presets and plans as data, and the operators.
//!
//! [`repair`] is the entry point. A plan ([`make_plan`]) is a list of strategies, a strategy is a list of actions, and an action is a list
//! of [`operators`]. Operators work on a [`crate::mesh::Surface`] and return their changes as [`Change`]s.

mod alternatives;
mod attribute_transfer;
mod body;
mod change;
mod common_start;
mod conclusion;
mod drawings;
mod escalation;
mod estimate;
mod export;
mod forecast;
mod input;
mod judge;
mod method_agreement;
mod objects;
pub mod operators;
mod options;
mod options_limited;
mod options_not_applied;
mod part_accounting;
mod pipeline;
mod plan;
mod prefix_cache;
mod presets;
mod red_flags;
mod remesher;
mod report;
mod report_draft;
mod runner;
mod size;
mod tasks;
mod time_budget;
mod unite;

pub use crate::context::{Cancelled, Context, NoProgress, Progress, Stage, monotonic_clock};
pub use crate::inspect::{AccountedPart, Changes, LostPart, OptionsError, PartAccounting, PartReason};
pub use crate::render::{ALTERNATIVE_DRAWINGS, name_for_choice};
pub use alternatives::{AlternativeRequest, AlternativeRuns, DEFAULT_CHOICE, RepairedAlternative};
pub use change::{Change, ChangeKind};
pub use drawings::{draw, draw_alternative};
pub use input::RepairError;
pub use operators::{sheets, solid_skin};
pub use options::{
    Category, Interior, Islands, Merge, OpenSheets, Operator, Options, OutputFormat, Overlaps, Preset, PrintOptions,
    Require, Verify, Voids, WallGrowth, WindingRuleChoice,
};
pub use options_not_applied::options_accounted_for;
pub use part_accounting::{IntendedChanges, part_accounting};
pub use pipeline::{Repaired, repair};
pub use plan::{categorise, make_plan};
pub use red_flags::{Comparison, SurvivingInput, red_flags};
pub use remesher::{RemeshAction, RemeshError, RemeshRequest, Remeshed, Remesher, RemesherInfo};
pub use report::{
    Action, Alternative, Alternatives, Assumption, AssumptionKind, Candidate, DrilledVent, FileSummary,
    NotAppliedCause, NotOffered, NotOfferedCause, ObjectReport, OfferedFile, OmittedSection, OpenQuestion,
    OptionNotApplied, Outcome, Plan, PlannedAction, Property, REPORT_VERSION, RedFlag, RedFlagCode, Report,
    ReportedOptions, SkipReason, Step, StepStatus, Strategy, ThinPlaceLeft, ThinPlaceReason, UnfixedFaces, Verdict,
    WallThickening, When,
};
pub use time_budget::promised_overrun;
