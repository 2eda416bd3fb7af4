use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use super::{Candidate, Changes, Outcome, Plan, RedFlag, Report, Step};
use crate::inspect::{Inspection, Ledger};

/// Places of each kind that the account of an object has: with those of all, reports of many objects would be too large.
const PLACES: usize = 5;

/// The account of one object that was repaired apart from the others, in its own coordinates.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
    pub ledger: Option<Ledger>,
    /// What was going to be done, and why.
    pub plan: Plan,
    /// What was done, in order.
    pub steps: Vec<Step>,
    /// Every result that was judged; the chosen one is marked.
    pub candidates: Vec<Candidate>,
    /// Signs that its repair destroyed something.
    pub red_flags: Vec<RedFlag>,
    /// What a person should know.
    pub warnings: Vec<String>,
    /// Time that it took, in milliseconds.
    pub milliseconds: f64,
}

impl ObjectReport {
    /// The account of an object, of which the account of its repair is the most.
    pub(super) fn new(name: Option<String>, number: usize, places: u64, mut report: Report) -> Self {
        for looked in std::iter::once(&mut report.before).chain(&mut report.after) {
            looked.keep_places(PLACES);
        }
        Self {
            name,
            number: u32::try_from(number + 1).unwrap_or(u32::MAX),
            places,
            outcome: report.outcome,
            summary: report.summary,
            before: report.before,
            after: report.after,
            changes: report.changes,
            ledger: report.ledger,
            plan: report.plan,
            steps: report.steps,
            candidates: report.candidates,
            red_flags: report.red_flags,
            warnings: report.warnings,
            milliseconds: report.milliseconds,
        }
    }

    /// What it is called: by its name, or by its number where it has none.
    #[must_use]
    pub fn title(&self) -> String {
        self.name.as_ref().map_or_else(|| format!("object {}", self.number), |name| format!("'{name}'"))
    }
}
