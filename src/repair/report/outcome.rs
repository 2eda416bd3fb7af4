use serde::{Deserialize, Serialize};

use crate::inspect::Measures;
use crate::repair::options::Require;

/// What became of a model, apart from whether the job ran.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The input is printable; its geometry comes back untouched.
    AlreadyPrintable,
    /// The result passes every check, and no red flag is up.
    Repaired,
    /// The result is better than the input, but fails a check, or passes all of them with a red flag up.
    PartiallyRepaired,
    /// Nothing that ran made the model better; the reason is in the report.
    Unrepairable,
}

impl Outcome {
    /// Whether the file that is handed out is printable as it stands, with no red flag.
    #[must_use]
    pub fn is_printable(self) -> bool {
        matches!(self, Self::AlreadyPrintable | Self::Repaired)
    }
}

impl Require {
    /// Whether a result of this outcome is what was asked for.
    #[must_use]
    pub fn is_met_by(self, outcome: Outcome) -> bool {
        match self {
            Self::Any => true,
            Self::Printable => outcome.is_printable(),
        }
    }
}

/// What is claimed of the file that a repair hands out.
///
/// Every surface that tells an outcome takes its claims from here: report, exit codes, messages, webhooks, artifacts, the page and the
/// widget.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Verdict {
    /// Whether the file can be printed as it stands: the outcome is `already_printable` or `repaired`.
    pub printable: bool,
    /// Whether the file's mesh passes every check, as `meshmend inspect` finds on it. With a red flag up a mesh may pass and not be
    /// `printable`.
    pub passes: bool,
    /// The file that is handed out.
    pub file: OfferedFile,
    /// What was found true of the file's own bytes.
    pub proven: Vec<Property>,
}

/// The file that a repair hands out.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum OfferedFile {
    /// A result that is better than what came in, or was printable already.
    Model,
    /// What came in, since nothing made it better.
    Original,
    /// None: nothing can be written, or the result is not what `require` asks for.
    #[default]
    None,
}

/// A property of a mesh that was checked on a file's own bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Property {
    /// No edge has a face on one side only.
    Closed,
    /// Two faces meet at every edge, and the faces around every vertex are one fan.
    Manifold,
    /// All faces are turned outward.
    Outward,
    /// No two faces intersect.
    NoIntersections,
}

impl Property {
    /// What the measures of a file prove.
    pub(super) fn proven_by(measures: &Measures) -> Vec<Self> {
        let found = [
            (Self::Closed, measures.closed),
            (Self::Manifold, measures.manifold),
            (Self::Outward, measures.consistent && measures.outward),
            (Self::NoIntersections, measures.self_intersections.proven_none()),
        ];
        found.into_iter().filter(|&(_, holds)| holds && measures.faces > 0).map(|(property, _)| property).collect()
    }
}
