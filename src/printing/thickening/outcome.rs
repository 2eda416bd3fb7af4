//! The settings and the outcome of a thickening.

use glam::DVec3;

use crate::context::Cancelled;
use crate::math::Precision;
use crate::mesh::Surface;
use crate::printing::thickness::OpposedPairs;

/// The sides on which walls grow.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Growth {
    /// Half on each side.
    #[default]
    Both,
    /// Away from cavities and concave air: the inner side of a wall stays as it is, so that inner fits stay.
    Outward,
    /// Into cavities and concave air: the outer side of a wall stays as it is.
    Inward,
}

/// The least gap as a share of the least wall, where the settings have none.
const LEAST_GAP: f64 = 0.02;

/// The settings of a thickening.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Thickening {
    /// The least thickness of walls, in the model's unit.
    pub min_wall: f64,
    /// The sides on which walls grow.
    pub growth: Growth,
    /// Gaps become no narrower than this, in the model's unit. Narrower ones keep their width.
    pub min_gap: f64,
    /// The precision of the output file.
    pub precision: Precision,
}

impl Thickening {
    /// The gap that stays at least. Without a limit it is small, so that faces do not touch.
    pub(super) fn least_gap(&self) -> f64 {
        self.min_gap.max(LEAST_GAP * self.min_wall)
    }
}

/// Why a place stays thin.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum ThinReason {
    /// Growth would narrow a gap below the least gap.
    Gap,
    /// The faces meet in an edge that is too sharp.
    SharpEdge,
    /// Growth would change the topology: join parts, or close a hole.
    Topology,
    /// The exact union or its rounding failed.
    Union,
    /// The rounds did not suffice.
    Rounds,
    /// The time ran out.
    Time,
}

/// The result at a thin place.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum PlaceResult {
    /// No wall is thinner than the limit any more.
    Proved,
    /// Walls thinner than the limit remain.
    LeftThin(ThinReason),
}

/// A connected thin place.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct ThickenedPlace {
    /// The thinnest point before.
    pub at: DVec3,
    /// The least thickness before, in the model's unit.
    pub least_before: f64,
    /// The least thickness that remains; at least the limit if the place is proved.
    pub least_after: f64,
    /// The area of the thin faces on both sides before.
    pub area: f64,
    /// The result.
    pub result: PlaceResult,
}

/// The result of a thickening.
#[derive(Debug, Clone, PartialEq)]
pub struct Thickened {
    /// The solid. Faces outside the layer keep their exact corners; added faces have the source of the face below.
    pub surface: Surface,
    /// The added volume, in cubic units.
    pub added_volume: f64,
    /// The largest distance from an added vertex to the input.
    pub max_deviation: f64,
    /// The number of through holes that were closed. Each was narrower than the least gap.
    pub through_holes_closed: u64,
    /// The number of gaps that were filled, since added material closed them on all sides. Each was narrower than the least gap.
    pub narrow_gaps_filled: u64,
    /// Whether a wall without an inner side, such as a plate, grew on both sides although [`Growth`] names one.
    pub grew_on_equal_sides: bool,
    /// The thin places, largest area first.
    pub places: Vec<ThickenedPlace>,
    /// The added faces, as indices into `surface`.
    pub added_faces: Vec<u32>,
    /// What is still thin in `surface`.
    pub thin: OpposedPairs,
}

impl Thickened {
    /// Whether no wall is thinner than the limit.
    pub fn is_proved(&self) -> bool {
        self.thin.walls.is_empty()
    }
}

/// Why nothing could be thickened.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
pub enum ThickeningError {
    /// `min_wall` or `min_gap` is not a usable length.
    #[error("`min_wall` must be greater than 0 and `min_gap` at least 0; got {min_wall} and {min_gap}")]
    Settings {
        /// The least wall.
        min_wall: f64,
        /// The least gap.
        min_gap: f64,
    },
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}
