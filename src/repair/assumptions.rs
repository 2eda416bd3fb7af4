use serde::{Deserialize, Serialize};
use utoipa::ToSchema;

use crate::scene::{LengthUnit, UnitSource};

/// Most places that an assumption lists.
const MAX_PLACES: usize = 5;

/// A decision that the input does not prove: what was decided, how much of the model it concerns, and the option that decides
/// otherwise.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize, ToSchema)]
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
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize, ToSchema)]
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
    pub(super) fn of_unit(unit: &LengthUnit) -> Option<Self> {
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
