//! The report's section `alternatives`: other verified results, where the file leaves the model's intent open.

use serde::{Deserialize, Serialize};

use super::outcome::{FileSummary, Outcome};

/// The results to choose from, where the file leaves the model's intent open.
#[derive(Debug, Clone, PartialEq, Default, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Alternatives {
    /// The results to choose from. The first one is the default, which the rest of the report describes.
    pub offered: Vec<Alternative>,
    /// Answers to open questions whose results are not offered, each with the reason.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub not_offered: Vec<NotOffered>,
}

/// One result to choose from. Lengths are in millimetres, whatever the file's unit is.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Alternative {
    /// Value of `choice` that selects this result: `default`, or the option and its value, such as `interior-keep`.
    pub id: String,
    /// Whether the job returns this result if the request names no `choice`.
    pub is_default: bool,
    /// The open question that the alternative answers differently. Missing for the default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub question: Option<OpenQuestion>,
    /// The option in which the alternative differs from the default, as `name=value`. Missing for the default.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub option: Option<String>,
    /// Description of the result, as text.
    pub detail: String,
    /// The outcome of the repair that made this result.
    pub outcome: Outcome,
    /// Whether the result is printable.
    pub printable: bool,
    /// Whether the result meets every rule of the process. Null without the option `process`.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub print_ready: Option<bool>,
    /// The result's file.
    pub file: FileSummary,
    /// Side lengths of the bounding box, in mm.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub size_mm: Option<[f64; 3]>,
    /// Enclosed volume, in mm³. Null if the mesh encloses no reliable volume.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub volume_mm3: Option<f64>,
    /// Surface area, in mm².
    pub area_mm2: f64,
    /// Thinnest wall found, in mm. Null if none was measured.
    #[serde(default)]
    #[cfg_attr(feature = "openapi", schema(required))]
    pub thinnest_wall_mm: Option<f64>,
    /// Weight in grams: the volume times the density of the process's material. Null if either is unknown.
    #[cfg_attr(feature = "openapi", schema(required))]
    pub weight_g: Option<f64>,
    /// Number of faces.
    pub faces: u64,
    /// Number of connected parts, including the surfaces of cavities.
    pub parts: u64,
}

/// A question about the intent of the model that the file leaves open.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum OpenQuestion {
    /// Whether a double shell is meant as a solid, or as a hollow body with thin walls.
    Interior,
    /// Whether sealed cavities are meant to be hollow or solid.
    Cavities,
    /// Whether small separate solids belong to the model.
    Islands,
    /// Whether overlapping objects are meant as one solid or as separate solids.
    Objects,
}

/// An answer to an open question whose result is not offered.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct NotOffered {
    /// The id that the alternative would have.
    pub id: String,
    /// The open question.
    pub question: OpenQuestion,
    /// The option that gives this answer, as `name=value`.
    pub option: String,
    /// The kind of reason, for programs.
    pub cause: NotOfferedCause,
    /// The reason as text.
    pub reason: String,
}

/// The kinds of reason why the result of an answer is not offered.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NotOfferedCause {
    /// The result has the same bytes as one that is already offered.
    SameResult,
    /// The result is not printable.
    NotPrintable,
    /// The result does not meet the requirement of the option `require`.
    RequirementMissed,
    /// The repair with this option failed.
    Failed,
    /// The deadline left no time for this repair.
    NoTime,
    /// The job already offers three results, the maximum.
    OverLimit,
}
