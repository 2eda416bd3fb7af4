//! Thickening: grows the walls of a solid that are thinner than a limit, and proves the result.
//!
//! A layer of prisms stands on the thin faces (`growth`, `refine`, `layer`), and the exact union of the solid with the
//! layer is the result (`unite`). So every face outside the layer keeps its exact corners. The walls of the rounded result
//! are then measured again: up to three rounds add what is missing. Where a round breaks a promise, the layer of the thin
//! places that cause it is taken back (`rounds`).

mod growth;
mod layer;
mod mitre;
mod outcome;
mod places;
mod refine;
mod rounds;
mod sides;
mod spread;
mod unite;
mod walls;

use crate::context::Context;
use crate::mesh::{ClosedSurface, Surface};

pub use outcome::{Growth, PlaceResult, Thickened, ThickenedPlace, Thickening, ThickeningError, ThinReason};
pub use unite::SelfUnion;

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
