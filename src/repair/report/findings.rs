//! What a report says beside measures: red flags, assumptions, options that were not applied, and what there was no time for.

use std::ops::Deref;

use serde::{Deserialize, Serialize, Serializer};
use serde_json::Value;

use crate::repair::options::Options;
use crate::scene::{LengthUnit, UnitSource};

/// Work that the deadline left no time for.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum OmittedSection {
    /// The search for intersecting faces in the input: whether it is printable is not known.
    InputVerification,
    /// The input's defects by place, its statistics and print measures: `before` has the level `none`.
    InputDetails,
    /// Repair: some operators or strategies did not run, or not to their end.
    Repair,
    /// The verification of a result that was made: that result is not handed out.
    Verification,
    /// The transfer of colours and materials to the result.
    Attributes,
    /// The result's defects by place, its statistics and print measures: `after` has the level `none`.
    ResultDetails,
    /// The shares of the surface that were kept, moved, added and removed.
    SurfaceChanges,
}

/// A sign that a repair destroyed something, after the MeshPrep repair strategy guide (lessons 3 and 4).
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct RedFlag {
    /// Which sign.
    pub code: RedFlagCode,
    /// What was measured.
    pub value: f64,
    /// The threshold that it is over.
    pub threshold: f64,
    /// In words.
    pub detail: String,
    /// Points that it concerns, in the model's unit; at most five.
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
    /// The box changed by more than `max_bounding_box_change_pct`.
    BoundingBoxChange,
    /// The volume changed by more than `max_volume_change_pct`.
    VolumeChange,
    /// More of the visible surface was lost than `max_surface_lost_pct`.
    SurfaceLost,
    /// Surface other than hole patches is farther from the input than `max_deviation`.
    Deviation,
    /// Several parts became one.
    PartsMerged,
    /// A part of the input is neither in the result nor certified as not missed: an error of the program.
    PartLost,
    /// More of the result's surface was invented than `max_surface_added_pct`: thickened skins and patches of large holes.
    SurfaceInvented,
    /// Objects of the file intersect where they stand.
    ObjectsIntersect,
    /// More vertices were lost than `max_vertex_loss_pct`.
    VertexLoss,
}

/// Most places that an assumption lists.
const MAX_PLACES: usize = 5;

/// A decision that the input does not prove: what was decided, how much of the model it concerns, and the option that decides
/// otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct Assumption {
    /// What was decided.
    pub kind: AssumptionKind,
    /// How many things it concerns: sheets, holes, objects, pieces or cavities.
    pub count: u64,
    /// How much, in the quantity that the kind documents.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub amount: Option<f64>,
    /// Share of the result's surface that it concerns, in percent.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub share_pct: Option<f64>,
    /// Points where it applies, in the model's unit; at most five.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub places: Vec<[f64; 3]>,
    /// The decision as a sentence.
    pub detail: String,
    /// The option that decides otherwise, as `name=value`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub option: Option<String>,
}

/// The kinds of [`Assumption`].
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum AssumptionKind {
    /// The file names no unit; lengths were taken to be millimetres.
    Unit,
    /// Objects that intersect were united into one solid. The amount is the number of objects before.
    ObjectsUnited,
    /// Parts of an assembly that overlapped were cut so that their interiors are disjoint. The amount is the volume removed.
    OverlapRemoved,
    /// Open sheets were given a thickness. The amount is that thickness.
    SheetsThickened,
    /// Open sheets were extruded down to a plane. The amount is the thickness at the lowest point.
    BasesAdded,
    /// Holes of more than 2 % of the surface each were closed. The amount is the area of their patches.
    LargeHolesClosed,
    /// Parts that were apart were joined by bands of surface. The amount is the longest band's length.
    PartsJoined,
    /// What is solid where surface winds several times or inward was chosen by a winding rule.
    WindingRule,
    /// Pieces that enclose nothing, or are smaller than the options keep, were dropped. The amount is their area.
    PiecesDropped,
    /// Sealed cavities were kept hollow. The amount is their volume.
    CavitiesKept,
    /// Sealed cavities were filled. The amount is their volume.
    CavitiesFilled,
    /// A measure that would raise a red flag is a property of the input, since methods of different kind agree on it. The amount is
    /// that measure.
    MethodsAgree,
}

impl Assumption {
    /// The assumption that lengths are millimetres, where the file and the request name no unit.
    pub(crate) fn of_unit(unit: &LengthUnit) -> Option<Self> {
        let detail = "The file names no unit; lengths were taken to be millimetres.";
        let is_assumed = unit.source == UnitSource::Assumed;
        is_assumed.then(|| Self::new(AssumptionKind::Unit, 1, detail).unless("unit=in"))
    }

    /// An assumption of a kind about `count` things, with its sentence.
    #[must_use]
    pub fn new(kind: AssumptionKind, count: u64, detail: impl Into<String>) -> Self {
        let detail = detail.into();
        Self { kind, count, amount: None, share_pct: None, places: Vec::new(), detail, option: None }
    }

    /// The same with an amount; numbers that are not finite are left out.
    #[must_use]
    pub fn with_amount(self, amount: f64) -> Self {
        Self { amount: amount.is_finite().then_some(amount), ..self }
    }

    /// The same with its share of the result's surface in percent.
    #[must_use]
    pub fn with_share(self, share_pct: f64) -> Self {
        Self { share_pct: share_pct.is_finite().then_some(share_pct), ..self }
    }

    /// The same with the first places.
    #[must_use]
    pub fn at(self, places: impl IntoIterator<Item = [f64; 3]>) -> Self {
        Self { places: places.into_iter().take(MAX_PLACES).collect(), ..self }
    }

    /// The same with the option that decides otherwise.
    #[must_use]
    pub fn unless(self, option: &str) -> Self {
        Self { option: Some(option.to_owned()), ..self }
    }
}

/// An option that was set and that the result does not follow, or only in part.
#[derive(Debug, Clone, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct OptionNotApplied {
    /// The option's name.
    pub option: String,
    /// Its value as text.
    pub value: String,
    /// What kind of reason it is.
    pub cause: NotAppliedCause,
    /// The reason as a sentence.
    pub reason: String,
}

/// The kinds of reason why an option was not applied.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum NotAppliedCause {
    /// The model has nothing that the option is about.
    NothingToDo,
    /// It was applied in part.
    Limited,
    /// Another option rules it out.
    Excluded,
    /// What it needs failed or is not available.
    Unavailable,
    /// The result with it would be worse than the input, which is handed out.
    MadeWorse,
}

impl OptionNotApplied {
    /// An option with its value, the cause and the reason.
    #[must_use]
    pub fn new(options: &Options, option: &str, cause: NotAppliedCause, reason: impl Into<String>) -> Self {
        let value = serde_json::to_value(options).ok().and_then(|all| all.get(option).cloned());
        let value = value.map_or_else(String::new, |value| as_text(&value));
        Self { option: option.to_owned(), value, cause, reason: reason.into() }
    }

    /// As one line for a person.
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

/// Options as a report writes them.
#[derive(Debug, Clone, PartialEq, Deserialize)]
#[serde(from = "Options")]
pub struct ReportedOptions {
    options: Options,
    /// Whether options that have their default are left out.
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
    /// Leaves out options that have their default.
    pub(super) fn leave_out_defaults(&mut self) {
        self.only_changed = true;
    }
}
