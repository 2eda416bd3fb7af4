//! Thickening: grows the walls of a solid that are thinner than a limit, and proves the result.
//!
//! A layer of prisms stands on the thin faces (`growth`, `refine`, `layer`), and the exact union of the solid with the
//! layer is the result (`unite`). So every face outside the layer keeps its exact corners. The walls of the rounded result
//! are then measured again: up to three rounds add what is missing. Where a round breaks a promise, the layer of the thin
//! places that cause it is taken back (`rounds`).

mod growth;
mod layer;
mod mitre;
mod places;
mod refine;
mod rounds;
mod sides;
mod spread;
mod unite;
mod walls;

use crate::context::{Cancelled, Context};
use crate::math::Precision;
use crate::mesh::{ClosedSurface, NotClosed, Surface};
use glam::DVec3;

pub use unite::SelfUnion;

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
    /// The thin places, largest area first.
    pub places: Vec<ThickenedPlace>,
    /// The added faces, as indices into `surface`.
    pub added_faces: Vec<u32>,
    /// Whether no wall of `surface` is thinner than the limit.
    pub is_proved: bool,
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
    /// The surface is not closed.
    #[error(transparent)]
    NotClosed(#[from] NotClosed),
    /// The work was cancelled.
    #[error(transparent)]
    Cancelled(#[from] Cancelled),
}

impl Thickening {
    /// Thickens the walls of a solid. The surface must be closed, oriented outward and without intersections; its
    /// positions must have the precision of the output.
    ///
    /// Promises: the input is contained in the result. Faces outside the layer keep their corners and sources. Parts and
    /// handles stay the same. Where a wall stays thin, a place says why.
    ///
    /// # Errors
    /// [`ThickeningError`] for unusable settings, a surface that is not closed, or a cancellation.
    pub fn apply(
        &self,
        surface: &Surface,
        union: &dyn SelfUnion,
        context: &Context<'_>,
    ) -> Result<Thickened, ThickeningError> {
        let &Self { min_wall, min_gap, .. } = self;
        if !(min_wall > 0.0 && min_wall.is_finite() && min_gap >= 0.0 && min_gap.is_finite()) {
            return Err(ThickeningError::Settings { min_wall, min_gap });
        }
        ClosedSurface::try_from(surface)?;
        rounds::Rounds::run(*self, surface, union, context)
    }
}
