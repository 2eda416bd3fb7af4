//! What the steps that prepare a model for printing did: the walls that they thickened, and the vents that they drilled.

use serde::{Deserialize, Serialize};

/// Why a place stays thin.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
#[serde(rename_all = "snake_case")]
pub enum ThinPlaceReason {
    /// A thicker wall would narrow a gap, close a hole or join parts.
    Gap,
    /// The faces meet in a sharp edge that could not be covered, for example because walls grow on one side only.
    SharpEdge,
    /// The added material could not be united exactly, or still had thin places after the last round.
    Undecided,
    /// The time ran out.
    OutOfTime,
}

/// A place that stays thin.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct ThinPlaceLeft {
    /// The thinnest point, in the model's unit.
    pub at: [f64; 3],
    /// The least thickness in millimetres.
    pub thickness_mm: f64,
    /// Why the place stays thin.
    pub reason: ThinPlaceReason,
}

/// What a step that thickens walls added and left.
#[derive(Debug, Clone, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct WallThickening {
    /// Number of added faces.
    pub added_faces: u64,
    /// Volume of the added material in cubic millimetres.
    pub added_volume_mm3: f64,
    /// Largest distance of the added surface from the input, in millimetres.
    pub max_deviation_mm: f64,
    /// Number of through holes that the added material closed. Each was narrower than the least gap.
    #[serde(default)]
    pub through_holes_closed: u64,
    /// Number of gaps that were filled, since the added material closed them on all sides. Each was narrower than the least gap.
    #[serde(default)]
    pub narrow_gaps_filled: u64,
    /// Number of places that stay thin, sharp edges included.
    pub left_count: u64,
    /// The places that stay thin: walls first, then sharp edges; at most 100.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub left: Vec<ThinPlaceLeft>,
}

/// A hole that was drilled into a sealed cavity, as a straight bore.
#[derive(Debug, Clone, Copy, PartialEq, Serialize, Deserialize)]
#[cfg_attr(feature = "openapi", derive(utoipa::ToSchema))]
pub struct DrilledVent {
    /// The centre of its mouth on the outer surface, in the model's unit.
    pub at: [f64; 3],
    /// The unit vector from the cavity to the mouth.
    pub direction: [f64; 3],
    /// The diameter in millimetres.
    pub diameter_mm: f64,
    /// The length of its axis in the wall, in millimetres.
    pub length_mm: f64,
    /// A point inside the cavity, in the model's unit. Vents of one cavity have the same point.
    pub cavity: [f64; 3],
    /// The volume of the cavity in cubic millimetres, without the solids inside.
    pub cavity_volume_mm3: f64,
}
