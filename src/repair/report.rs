//! The account of a repair, of its objects too, as it is written to JSON.

mod findings;
mod outcome;
mod steps;

use serde::{Deserialize, Serialize};

pub use self::findings::{
    Assumption, AssumptionKind, NotAppliedCause, OmittedSection, OptionNotApplied, RedFlag, RedFlagCode,
    ReportedOptions,
};
pub use self::outcome::{OfferedFile, Outcome, Property, Verdict};
pub use self::steps::{Action, Candidate, Plan, PlannedAction, Step, StepStatus, Strategy, UnfixedFaces, When};
use self::steps::{abridge_candidates, abridge_steps};
use crate::format::Format;
use crate::inspect::{Changes, Inspection, Measures, PartAccounting};
use crate::scene::LengthUnit;

/// The version of [`Report`]'s structure. 2: `before` and `after` are inspections, which add `version`, `level` and
/// `defects` to the measures of version 1. 3: a plan's actions list their operators, and a step is one operator. 4:
/// adds `part_accounting`, `changes.surface` and the red flag `part_lost`. 5: adds `unit` and `objects`.
/// 6: adds `verdict`, `assumptions`, `options_not_applied`, `steps[].unfixed` and the red flags `surface_invented`, `objects_intersect` and `vertex_loss`.
/// 7: adds `abridged`, and `operators` of a planned action may be left out.
pub const REPORT_VERSION: u32 = 7;

/// The account of one repair.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Report {
    /// Version of this structure.
    pub version: u32,
    /// Whether lists are shortened to their first items, and statistics, planned operators and idle steps are left out. Counts are always
    /// of everything.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub abridged: bool,
    /// Name and version of the engine.
    pub engine: String,
    /// What became of the model.
    pub outcome: Outcome,
    /// What is claimed of the file that is handed out.
    #[serde(default)]
    pub verdict: Verdict,
    /// The outcome in words, with what to do next where it is not good.
    pub summary: String,
    /// The input file.
    pub input: FileSummary,
    /// The result, of an `unrepairable` model what came in; none only if nothing can be written.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub output: Option<FileSummary>,
    /// The options that were in force; in an abridged report those that differ from their defaults.
    #[cfg_attr(feature = "openapi", schema(value_type = super::options::Options))]
    pub options: ReportedOptions,
    /// The unit of every length in this report and of the result.
    pub unit: LengthUnit,
    /// The input, looked at before anything was processed but the unit; all its objects in their places as one mesh.
    pub before: Inspection,
    /// The result, looked at in the same way, on its own bytes. Objects that are kept apart may meet one another, and then what is printable
    /// apart is not as one mesh; the warnings say so.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub after: Option<Inspection>,
    /// Whether `after` was found on the written bytes, read back and welded by position.
    pub verified_from_output_bytes: bool,
    /// From `before` to `after`.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub changes: Option<Changes>,
    /// What became of each part of the input; none where the input itself is handed out.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_accounting: Option<PartAccounting>,
    /// What was going to be done, and why.
    pub plan: Plan,
    /// What was done, in order.
    pub steps: Vec<Step>,
    /// Every result that was judged; the chosen one is marked.
    pub candidates: Vec<Candidate>,
    /// Signs that the repair destroyed something, on the chosen result.
    pub red_flags: Vec<RedFlag>,
    /// Decisions that the input does not prove.
    #[serde(default)]
    pub assumptions: Vec<Assumption>,
    /// Options that were set and that the result does not follow, or only in part, and why; also those that found nothing to do.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// Where the result has objects: each that was repaired, apart from the others and in its own coordinates, in the file's order.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub objects: Vec<ObjectReport>,
    /// What the deadline left no time for, in the order of a repair; empty where there was time for everything.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub omitted: Vec<OmittedSection>,
    /// What a person should know.
    pub warnings: Vec<String>,
    /// Time from first byte read to last byte written, in milliseconds.
    pub milliseconds: f64,
}

/// A file that went in or came out.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FileSummary {
    /// Its format.
    pub format: Format,
    /// The dialect in words, such as `binary STL`.
    pub dialect: String,
    /// Its size.
    pub bytes: u64,
}

impl FileSummary {
    /// The summary of written bytes.
    pub(super) fn of(format: Format, dialect: &str, bytes: &[u8]) -> Self {
        Self { format, dialect: dialect.to_owned(), bytes: bytes.len() as u64 }
    }
}

/// The account of one object that was repaired apart from the others, in its own coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ObjectReport {
    /// Its name in the file.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub name: Option<String>,
    /// Its number among the file's objects, from 1.
    pub number: u32,
    /// In how many places it stands.
    pub places: u64,
    /// What became of it.
    pub outcome: Outcome,
    /// The outcome in words.
    pub summary: String,
    /// The object, looked at before anything was processed but the unit, with a few places of each kind.
    pub before: Inspection,
    /// What was made of it, looked at in the same way.
    pub after: Option<Inspection>,
    /// From `before` to `after`.
    pub changes: Option<Changes>,
    /// What became of each of its parts; none where it is as it was.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub part_accounting: Option<PartAccounting>,
    /// What was going to be done, and why.
    pub plan: Plan,
    /// What was done, in order.
    pub steps: Vec<Step>,
    /// Every result that was judged; the chosen one is marked.
    pub candidates: Vec<Candidate>,
    /// Signs that its repair destroyed something.
    pub red_flags: Vec<RedFlag>,
    /// Decisions that the object does not prove.
    #[serde(default)]
    pub assumptions: Vec<Assumption>,
    /// Options that were set and that the result does not follow, or only in part, and why; also those that found nothing to do.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub options_not_applied: Vec<OptionNotApplied>,
    /// What the deadline left no time for, in the order of a repair.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub omitted: Vec<OmittedSection>,
    /// What a person should know.
    pub warnings: Vec<String>,
    /// Time that it took, in milliseconds.
    pub milliseconds: f64,
}

impl ObjectReport {
    /// What it is called: by its name, or by its number where it has none.
    #[must_use]
    pub fn title(&self) -> String {
        self.name.as_ref().map_or_else(|| format!("object {}", self.number), |name| format!("'{name}'"))
    }
}

impl Verdict {
    /// The verdict of a report whose outcome is settled.
    pub(super) fn of(report: &Report) -> Self {
        let after = report.after.as_ref().filter(|_| report.verified_from_output_bytes).map(|after| &after.measures);
        let file = match report.outcome {
            _ if report.after.is_none() || !report.options.require.is_met_by(report.outcome) => OfferedFile::None,
            Outcome::Unrepairable => OfferedFile::Original,
            _ => OfferedFile::Model,
        };
        Self {
            printable: report.outcome.is_printable(),
            passes: after.is_some_and(Measures::printable),
            file,
            proven: after.map(Property::proven_by).unwrap_or_default(),
        }
    }
}

impl Report {
    /// Why no model is handed out where `require` asks for more than the result is, with what to do; none where it is met.
    #[must_use]
    pub fn refusal(&self) -> Option<String> {
        (!self.options.require.is_met_by(self.outcome)).then(|| {
            format!(
                "`require=printable` asks for a printable result, and the result is not one, so no model is handed out. {} \
                 `require=any` hands out the best result there is.",
                self.summary
            )
        })
    }

    /// Shortens each list to its first `most` items, and leaves out statistics, planned actions, strategies that did not run and steps
    /// of tiers 1 and 2 that changed nothing. Counts, the verdict, flags and assumptions stay.
    pub fn abridge(&mut self, most: usize) {
        self.abridged = true;
        self.options.leave_out_defaults();
        self.before.abridge(most);
        // What is printed is the result, where there is one: of the input its size is enough.
        if self.after.as_ref().is_some_and(|after| after.print.is_some())
            && let Some(print) = &mut self.before.print
        {
            print.thinnest_wall = None;
            print.overhang.areas.clear();
        }
        self.after.iter_mut().for_each(|after| after.abridge(most));
        self.part_accounting.iter_mut().for_each(|part_accounting| abridge_ledger(part_accounting, most));
        self.plan.abridge(&self.steps);
        abridge_steps(&mut self.steps, most);
        abridge_candidates(&mut self.candidates, most);
        self.objects.truncate(most);
        for object in &mut self.objects {
            object.before.abridge(most);
            object.after.iter_mut().for_each(|after| after.abridge(most));
            object.part_accounting.iter_mut().for_each(|part_accounting| abridge_ledger(part_accounting, most));
            object.plan.abridge(&object.steps);
            abridge_steps(&mut object.steps, most);
            abridge_candidates(&mut object.candidates, most);
        }
    }
}

fn abridge_ledger(part_accounting: &mut PartAccounting, most: usize) {
    part_accounting.reasons.truncate(most);
    part_accounting.lost_parts.truncate(most);
}
