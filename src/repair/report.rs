//! The report of a repair and of its objects, as it is written to JSON.

mod alternatives;
mod findings;
mod outcome;
mod print_steps;
mod steps;

use serde::{Deserialize, Serialize};

pub use self::alternatives::{Alternative, Alternatives, NotOffered, NotOfferedCause, OpenQuestion};
pub use self::findings::{
    Assumption, AssumptionKind, NotAppliedCause, OmittedSection, OptionNotApplied, RedFlag, RedFlagCode,
    ReportedOptions,
};
pub use self::outcome::{FileSummary, OfferedFile, Outcome, Property, Verdict};
pub use self::print_steps::{DrilledVent, ThinPlaceLeft, ThinPlaceReason, WallThickening};
pub use self::steps::{
    Action, Candidate, Plan, PlannedAction, SkipReason, Step, StepStatus, Strategy, UnfixedFaces, When,
};
use self::steps::{abridge_candidates, abridge_steps};
use super::options::Require;
use crate::inspect::{Changes, Inspection, Measures, PartAccounting};
use crate::printing::readiness::PrintReadiness;
use crate::printing::unit_candidates::UnitCandidates;
use crate::scene::LengthUnit;

/// The version of [`Report`]'s structure.
///
/// - 2: `before` and `after` are inspections, which add `version`, `level` and `defects` to the measures of version 1.
/// - 3: a plan's actions list their operators, and a step is one operator.
/// - 4: adds `part_accounting`, `changes.surface` and the red flag `part_lost`.
/// - 5: adds `unit` and `objects`.
/// - 6: adds `verdict`, `assumptions`, `options_not_applied`, `steps[].unfixed` and the red flags `surface_invented`,
///   `objects_intersect` and `vertex_loss`.
/// - 7: adds `abridged`, and `operators` of a planned action may be missing.
/// - 8: renames fields, and adds `print_ready`, `unit_candidates`, `scaled_by`, `alternatives` and the assumption
///   `interior_filled`.
pub const REPORT_VERSION: u32 = 8;

/// Most candidates for the unit in an abridged report.
const MAX_UNITS: usize = 2;

/// The report of one repair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Report {
    /// Version of this structure.
    pub version: u32,
    /// Whether the report is abridged: lists are cut to their first items, and statistics, planned operators and steps without effect are
    /// missing. Counts always cover everything.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub abridged: bool,
    /// Name and version of the engine.
    pub engine: String,
    /// The outcome for the model.
    pub outcome: Outcome,
    /// The claims about the returned file.
    #[serde(default)]
    pub verdict: Verdict,
    /// The outcome as text, with advice if the result is not printable.
    pub summary: String,
    /// The input file.
    pub input: FileSummary,
    /// The returned file; for an `unrepairable` model, the input. Null only if nothing can be written.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub output: Option<FileSummary>,
    /// The options of the repair. An abridged report lists only options that differ from their defaults.
    #[cfg_attr(feature = "openapi", schema(value_type = super::options::Options))]
    pub options: ReportedOptions,
    /// The unit of every length in this report and of the result.
    pub unit: LengthUnit,
    /// Factor by which the model was scaled, before any inspection, to the size that the options ask for. Missing without such a request.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub scaled_by: Option<f64>,
    /// The units that the file may have, if its unit is in doubt. Missing if the unit is plausible.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit_candidates: Option<UnitCandidates>,
    /// The inspection of the input after its unit was settled, before any repair. All objects are in their places, as one mesh.
    pub before: Inspection,
    /// The inspection of the result, read back from its own bytes. If separate objects intersect, each may be printable while the whole is
    /// not; the red flag `objects_intersect` reports this case.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub after: Option<Inspection>,
    /// Whether `after` was measured on the written bytes, read back and welded by position.
    pub verified_from_output_bytes: bool,
    /// Whether the returned file meets each rule of the process. Missing without the option `process`, or if there was no time.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub print_ready: Option<PrintReadiness>,
    /// The results to choose from, where the file leaves the model's intent open. Missing without the option `alternatives`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub alternatives: Option<Alternatives>,
    /// The changes from `before` to `after`.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub changes: Option<Changes>,
    /// The whereabouts of each part of the input. Missing if the input itself is returned.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_accounting: Option<PartAccounting>,
    /// The repair plan, and the reason for it.
    pub plan: Plan,
    /// The steps that were run or skipped, in order.
    pub steps: Vec<Step>,
    /// Every result that was judged; `chosen` marks the returned one.
    pub candidates: Vec<Candidate>,
    /// Signs that the repair damaged the model, for the chosen result.
    pub red_flags: Vec<RedFlag>,
    /// Decisions that the input does not prove.
    #[serde(default)]
    pub assumptions: Vec<Assumption>,
    /// Options that were set but not followed, followed in part, or without anything to do, each with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// The reports of objects that were repaired separately, each in its own coordinates, in the file's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<ObjectReport>,
    /// The work that the deadline left no time for, in the order of a repair. Empty if there was time for everything.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub omitted: Vec<OmittedSection>,
    /// Warnings for the reader.
    pub warnings: Vec<String>,
    /// Time from the first byte read to the last byte written, in milliseconds.
    pub milliseconds: f64,
}

/// The report of one object that was repaired separately, in its own coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ObjectReport {
    /// The object's name in the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// The object's number in the file, from 1.
    pub number: u32,
    /// The number of instances of the object in the file.
    pub places: u64,
    /// The outcome for the object.
    pub outcome: Outcome,
    /// The outcome as text.
    pub summary: String,
    /// The inspection of the object after its unit was settled, before any repair, with a few places of each defect.
    pub before: Inspection,
    /// The inspection of the repaired object.
    pub after: Option<Inspection>,
    /// The changes from `before` to `after`.
    pub changes: Option<Changes>,
    /// The whereabouts of each part of the object. Missing if the object is unchanged.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_accounting: Option<PartAccounting>,
    /// The repair plan, and the reason for it.
    pub plan: Plan,
    /// The steps that were run or skipped, in order.
    pub steps: Vec<Step>,
    /// Every result that was judged; `chosen` marks the returned one.
    pub candidates: Vec<Candidate>,
    /// Signs that the repair damaged the object.
    pub red_flags: Vec<RedFlag>,
    /// Decisions that the object does not prove.
    #[serde(default)]
    pub assumptions: Vec<Assumption>,
    /// Options that were set but not followed, followed in part, or without anything to do, each with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// The work that the deadline left no time for, in the order of a repair.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub omitted: Vec<OmittedSection>,
    /// Warnings for the reader.
    pub warnings: Vec<String>,
    /// Time of the object's repair, in milliseconds.
    pub milliseconds: f64,
}

impl ObjectReport {
    /// The object's name in quotes, or its number if it has no name.
    #[must_use]
    pub fn title(&self) -> String {
        self.name.as_ref().map_or_else(|| format!("object {}", self.number), |name| format!("'{name}'"))
    }
}

impl Verdict {
    /// The verdict that follows from a report's outcome and measures.
    pub(super) fn of(report: &Report) -> Self {
        let after = report.after.as_ref().filter(|_| report.verified_from_output_bytes).map(|after| &after.measures);
        let file = match report.outcome {
            _ if report.after.is_none() || !report.meets_requirement() => OfferedFile::None,
            Outcome::Unrepairable => OfferedFile::Original,
            _ => OfferedFile::Model,
        };
        Self {
            printable: report.outcome.is_printable(),
            print_ready: report.is_print_ready(),
            passes: after.is_some_and(Measures::printable),
            file,
            proven: after.map(Property::proven_by).unwrap_or_default(),
        }
    }
}

impl Report {
    /// Why no model is returned, with advice, if the result does not meet `require`; none if it does.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        let reason = match (self.options.require, &self.print_ready) {
            _ if self.meets_requirement() => return None,
            (Require::PrintReady, Some(readiness)) if self.outcome.is_printable() => {
                format!("`require=print_ready`, so no model is returned. {}", readiness.in_words())
            }
            (Require::PrintReady, _) => format!("`require=print_ready`, so no model is returned. {}", self.summary),
            _ => format!("`require=printable`, so no model is returned. {}", self.summary),
        };
        Some(format!("The result does not meet {reason} Set `require=any` to get the best result."))
    }

    /// Whether the result meets the option `require`.
    fn meets_requirement(&self) -> bool {
        match self.options.require {
            Require::Any => true,
            Require::Printable => self.outcome.is_printable(),
            Require::PrintReady => self.is_print_ready() == Some(true),
        }
    }

    /// Whether the returned file is printable and meets every rule of the process; none without a process.
    fn is_print_ready(&self) -> Option<bool> {
        self.options.print.process.as_ref()?;
        let meets_rules = self.print_ready.as_ref().is_some_and(|readiness| readiness.ready);
        Some(meets_rules && self.outcome.is_printable())
    }

    /// Cuts each list to its first `most` items, and removes statistics, planned actions, strategies that did not run, and steps of
    /// tiers 1 and 2 without effect. Counts, the verdict, red flags and assumptions stay.
    pub fn abridge(&mut self, most: usize) {
        self.abridged = true;
        self.options.omit_defaults();
        self.before.abridge(most);
        // The result is what gets printed: of the input's print measures, the size is enough.
        if self.after.as_ref().is_some_and(|after| after.print.is_some())
            && let Some(print) = &mut self.before.print
        {
            print.thinnest_wall = None;
            print.overhang.areas.clear();
        }
        self.after.iter_mut().for_each(|after| after.abridge(most));
        self.part_accounting.iter_mut().for_each(|parts| abridge_parts(parts, most));
        self.print_ready.iter_mut().for_each(|readiness| readiness.abridge(most));
        self.unit_candidates.iter_mut().for_each(|candidates| candidates.ranked.truncate(MAX_UNITS));
        self.plan.abridge(&self.steps);
        abridge_steps(&mut self.steps, most);
        abridge_candidates(&mut self.candidates, most);
        self.objects.truncate(most);
        for object in &mut self.objects {
            object.before.abridge(most);
            object.after.iter_mut().for_each(|after| after.abridge(most));
            object.part_accounting.iter_mut().for_each(|parts| abridge_parts(parts, most));
            object.plan.abridge(&object.steps);
            abridge_steps(&mut object.steps, most);
            abridge_candidates(&mut object.candidates, most);
        }
    }
}

fn abridge_parts(parts: &mut PartAccounting, most: usize) {
    parts.reasons.truncate(most);
    parts.lost_parts.truncate(most);
}
