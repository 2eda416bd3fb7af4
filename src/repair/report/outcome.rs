//! The outcome of a repair, its files, and the claims about the returned file.

use serde::{Deserialize, Serialize};

use crate::format::Format;
use crate::inspect::Measures;

/// The outcome of a repair for the model.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Outcome {
    /// The input is printable; its geometry is returned unchanged.
    AlreadyPrintable,
    /// The result passes every check and has no red flag.
    Repaired,
    /// The result is better than the input, but fails a check or has a red flag.
    PartiallyRepaired,
    /// No repair step improved the model; the report gives the reason.
    Unrepairable,
}

impl Outcome {
    /// Whether the returned file is printable and has no red flag.
    #[must_use]
    pub fn is_printable(self) -> bool {
        matches!(self, Self::AlreadyPrintable | Self::Repaired)
    }
}

/// The claims about the file that a repair returns.
///
/// Report, exit codes, messages, webhooks, artifacts, the page and the widget all take their claims from the verdict.
#[derive(Debug, Clone, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Verdict {
    /// Whether the file can be printed as it is: the outcome is `already_printable` or `repaired`.
    pub printable: bool,
    /// Whether the file is printable and meets every rule of the process. Missing without the option `process`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub print_ready: Option<bool>,
    /// Whether the file's mesh passes every check of `meshmend inspect`. With a red flag, a mesh may pass without being `printable`.
    pub passes: bool,
    /// The file that is returned.
    pub file: OfferedFile,
    /// Properties that were verified on the file's own bytes.
    pub proven: Vec<Property>,
}

/// The file that a repair returns.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum OfferedFile {
    /// A result better than the input, or an input that was already printable.
    Model,
    /// The input, because no repair step improved it.
    Original,
    /// No file: nothing can be written, or the result does not meet `require`.
    #[default]
    None,
}

/// A property of a mesh that was checked on a file's own bytes.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum Property {
    /// Every edge has faces on both sides.
    Closed,
    /// Exactly two faces meet at every edge, and the faces around every vertex form one fan.
    Manifold,
    /// All faces are oriented outward.
    Outward,
    /// No two faces intersect.
    NoIntersections,
}

impl Property {
    /// The properties that a file's measures prove.
    pub(super) fn proven_by(measures: &Measures) -> Vec<Self> {
        let properties = [
            (Self::Closed, measures.closed),
            (Self::Manifold, measures.manifold),
            (Self::Outward, measures.consistent && measures.outward),
            (Self::NoIntersections, measures.self_intersections.proven_none()),
        ];
        properties.into_iter().filter(|&(_, holds)| holds && measures.faces > 0).map(|(property, _)| property).collect()
    }
}

/// The format and size of the input file or of the returned file.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct FileSummary {
    /// The file format.
    pub format: Format,
    /// The dialect of the format, such as `binary STL`.
    pub dialect: String,
    /// The size in bytes.
    pub bytes: u64,
}

impl FileSummary {
    /// The summary of written bytes.
    pub(crate) fn of(format: Format, dialect: &str, bytes: &[u8]) -> Self {
        Self { format, dialect: dialect.to_owned(), bytes: bytes.len() as u64 }
    }
}
