//! A report's findings beside its measures: red flags, assumptions, options not applied, and work left out for lack of time.

use std::ops::Deref;

use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use crate::repair::options::Options;
use crate::scene::{LengthUnit, UnitSource};

/// Work that was left out because the deadline left no time for it.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum OmittedSection {
    /// The search for intersecting faces in the input. Whether the input is printable is unknown.
    InputVerification,
    /// The places of the input's defects, its statistics and print measures. `before` has the level `none`.
    InputDetails,
    /// Part of the repair: some operators or strategies did not run, or did not finish.
    Repair,
    /// The verification of a result. That result is not returned.
    Verification,
    /// The transfer of colours and materials to the result.
    Attributes,
    /// The places of the result's defects, its statistics and print measures. `after` has the level `none`.
    ResultDetails,
    /// The shares of the surface that were kept, moved, added and removed (`changes.surface`).
    SurfaceChanges,
    /// The assessment against the process (`print_ready`).
    PrintReadiness,
}

/// A sign that a repair damaged the model, after the MeshPrep repair strategy guide (lessons 3 and 4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RedFlag {
    /// The kind of red flag.
    pub code: RedFlagCode,
    /// The measured value.
    pub value: f64,
    /// The threshold that the value exceeds.
    pub threshold: f64,
    /// The finding as text.
    pub detail: String,
    /// Points that the finding concerns, in the model's unit; at most five.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f64; 3]>,
}

/// The kinds of red flag.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum RedFlagCode {
    /// More faces were lost than `max_face_loss_pct`.
    FaceLoss,
    /// A side of the bounding box moved by more than `max_bounding_box_change_pct`.
    BoundingBoxChange,
    /// The volume changed by more than `max_volume_change_pct`.
    VolumeChange,
    /// More of the visible surface was lost than `max_surface_lost_pct`.
    SurfaceLost,
    /// Surface, except hole patches, is farther from the input than `max_deviation`.
    Deviation,
    /// Several parts became one.
    PartsMerged,
    /// A part of the input is not in the result, and no accepted reason explains it: a program error.
    PartLost,
    /// More of the result's surface is new than `max_surface_added_pct`: thickened sheets and patches of large holes.
    SurfaceInvented,
    /// Objects of the file intersect in their placed positions.
    ObjectsIntersect,
    /// More vertices were lost than `max_vertex_loss_pct`.
    VertexLoss,
}

/// Most places that an assumption lists.
const MAX_PLACES: usize = 5;

/// A decision that the input does not prove, with the extent it concerns and the option that decides otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Assumption {
    /// The kind of decision.
    pub kind: AssumptionKind,
    /// Number of sheets, holes, objects, pieces or cavities that the decision concerns.
    pub count: u64,
    /// Extent of the decision; the kind documents the quantity.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amount: Option<f64>,
    /// Share of the result's surface that the decision concerns, in percent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_pct: Option<f64>,
    /// Points where the decision applies, in the model's unit; at most five.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f64; 3]>,
    /// The decision as text.
    pub detail: String,
    /// The option that reverses the decision, as `name=value`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub option: Option<String>,
}

/// The kinds of assumption.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AssumptionKind {
    /// The file states no unit; millimetres were assumed.
    Unit,
    /// Objects that intersect were united into one solid. The amount is the number of objects before.
    ObjectsUnited,
    /// Overlapping parts of an assembly were cut so that their interiors are disjoint. The amount is the removed volume.
    OverlapRemoved,
    /// Open sheets were given a thickness. The amount is that thickness.
    SheetsThickened,
    /// Open sheets were extruded down to a plane. The amount is the base's thickness at its lowest point.
    BasesAdded,
    /// Holes that each exceed 2 % of the surface were closed. The amount is the area of their patches.
    LargeHolesClosed,
    /// Separate parts were joined by bands of surface. The amount is the longest band's length.
    PartsJoined,
    /// A winding rule decided which space is solid where surface winds several times or inward.
    WindingRule,
    /// Pieces that enclose nothing, or are smaller than the options keep, were removed. The amount is their area.
    PiecesDropped,
    /// Sealed cavities were kept hollow. The amount is their volume.
    CavitiesKept,
    /// Sealed cavities were filled. The amount is their volume.
    CavitiesFilled,
    /// A double shell was assumed to be a solid, and its interior was filled.
    InteriorFilled,
    /// Through holes narrower than the least gap were closed where walls were thickened.
    ThroughHolesClosed,
    /// Gaps narrower than the least gap were filled, since thickened walls closed them on all sides.
    NarrowGapsFilled,
    /// A measure over a red flag's threshold is a property of the input, because independent methods agree on it. The amount is that
    /// measure.
    MethodsAgree,
}

impl Assumption {
    /// The assumption that lengths are millimetres, if neither the file nor the options state a unit.
    pub(crate) fn of_unit(unit: &LengthUnit) -> Option<Self> {
        let detail = "The file states no unit; millimetres were assumed.";
        let is_assumed = unit.source == UnitSource::Assumed;
        is_assumed.then(|| Self::new(AssumptionKind::Unit, 1, detail).unless("unit=in"))
    }

    /// Makes an assumption of a kind about `count` things, described by `detail`.
    #[must_use]
    pub fn new(kind: AssumptionKind, count: u64, detail: impl Into<String>) -> Self {
        let detail = detail.into();
        Self { kind, count, amount: None, share_pct: None, places: Vec::new(), detail, option: None }
    }

    /// Adds an amount. Numbers that are not finite are ignored.
    #[must_use]
    pub fn with_amount(self, amount: f64) -> Self {
        Self { amount: amount.is_finite().then_some(amount), ..self }
    }

    /// Adds the share of the result's surface, in percent. Numbers that are not finite are ignored.
    #[must_use]
    pub fn with_share(self, share_pct: f64) -> Self {
        Self { share_pct: share_pct.is_finite().then_some(share_pct), ..self }
    }

    /// Adds the first places.
    #[must_use]
    pub fn at(self, places: impl IntoIterator<Item = [f64; 3]>) -> Self {
        Self { places: places.into_iter().take(MAX_PLACES).collect(), ..self }
    }

    /// Adds the option that reverses the decision, as `name=value`.
    #[must_use]
    pub fn unless(self, option: &str) -> Self {
        Self { option: Some(option.to_owned()), ..self }
    }
}

/// An option that was set but not followed, or followed only in part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct OptionNotApplied {
    /// The option's name.
    pub option: String,
    /// The option's value as text.
    pub value: String,
    /// The kind of reason.
    pub cause: NotAppliedCause,
    /// The reason as text.
    pub reason: String,
}

/// The kinds of reason why an option was not applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NotAppliedCause {
    /// The model has nothing that the option applies to.
    NothingToDo,
    /// The option was applied in part.
    Limited,
    /// Another option rules the option out.
    Excluded,
    /// A step that the option needs failed or is not available.
    Unavailable,
    /// The result with the option is worse than the input or than another result, which is returned.
    MadeWorse,
}

impl OptionNotApplied {
    /// Makes the entry of an option, with its value from `options`.
    #[must_use]
    pub fn new(options: &Options, option: &str, cause: NotAppliedCause, reason: impl Into<String>) -> Self {
        let value = serde_json::to_value(options).ok().and_then(|all| all.get(option).cloned());
        let value = value.map_or_else(String::new, |value| as_text(&value));
        Self { option: option.to_owned(), value, cause, reason: reason.into() }
    }

    /// Formats the entry as one line of text.
    #[must_use]
    pub fn in_words(&self) -> String {
        let verdict = match self.cause {
            NotAppliedCause::NothingToDo => "had nothing to do",
            NotAppliedCause::Limited => "was applied in part",
            _ => "was not applied",
        };
        format!("`{}={}` {verdict}: {}", self.option, self.value, self.reason)
    }
}

fn as_text(value: &Value) -> String {
    match value {
        Value::String(text) => text.clone(),
        Value::Array(values) => values.iter().map(as_text).collect::<Vec<_>>().join(","),
        other => other.to_string(),
    }
}

/// Options in a report: all of them, or only those that differ from their defaults.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(from = "Options")]
pub struct ReportedOptions {
    options: Options,
    /// Whether options with their default value are left out.
    only_changed: bool,
}

impl From<Options> for ReportedOptions {
    fn from(options: Options) -> Self {
        Self { options, only_changed: false }
    }
}

impl Deref for ReportedOptions {
    type Target = Options;

    fn deref(&self) -> &Options {
        &self.options
    }
}

impl Serialize for ReportedOptions {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        if self.only_changed {
            self.options.to_changed_fields().serialize(serializer)
        } else {
            self.options.serialize(serializer)
        }
    }
}

impl ReportedOptions {
    /// Leaves out options with their default value.
    pub(super) fn omit_defaults(&mut self) {
        self.only_changed = true;
    }
}
