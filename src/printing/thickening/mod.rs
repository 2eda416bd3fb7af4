//! Thickening: grows the walls of a solid that are thinner than a limit, and proves the result.
//!
//! A few thin faces get a layer of prisms (`growth`, `refine`, `layer`, `rounds`), which keeps edges sharp. Otherwise balls of the
//! least wall's diameter stand along the middle of the thin places (`bodies`), and one closed surface around all balls is
//! built (`spheres`, `fill`). The exact union of the solid with the layer or the balls is the result (`unite`). So every
//! face outside the added material keeps its exact corners. The walls of the rounded result are then measured again, and
//! further rounds add what is missing. The result with the least lack of thickness counts (`results`).

mod bodies;
mod fill;
mod growth;
mod layer;
mod mitre;
mod outcome;
mod places;
mod refine;
mod results;
mod rounds;
mod sides;
mod spheres;
mod spread;
mod unite;
mod walls;

use fill::Filling;
use results::{Grown, Thin};
use unite::Topology;

use crate::context::Context;
use crate::mesh::{ClosedSurface, Surface};

pub use outcome::{Growth, PlaceResult, Thickened, ThickenedPlace, Thickening, ThickeningError, ThinReason};
pub use unite::SelfUnion;

/// Share of the remaining time that the growth may take; the rest is for the last measure and for the checks of the result.
const TIME_SHARE: f64 = 0.6;
/// Share of that time for the prisms.
const PRISM_SHARE: f64 = 0.4;
/// Most thin faces for which prisms are tried: they keep edges sharp, but often fail on many small faces.
const MAX_PRISMS: usize = 400;
/// The share of the lack of thickness up to which balls add to prisms; above it they replace the prisms, because the
/// surfaces of both meet at angles that leave slivers.
const MAX_LACK: f64 = 0.5;

impl Thickening {
    /// Thickens the walls of a solid. The surface must be closed, oriented outward and without intersections; its
    /// positions must have the precision of the output.
    ///
    /// Promises: the input is contained in the result. Faces outside the added material keep their corners and sources.
    /// Handles and large cavities stay, and only touching or small near solids are joined. Where a wall stays thin, a
    /// place says why.
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
        let before = Thin::of(surface, min_wall, context)?;
        let results = results::Results { settings: *self, input: surface, before: &before };
        let start = Grown { surface: results::with_own_sources(surface), thin: before.clone(), ..Grown::default() };
        if before.is_empty() {
            return Ok(results.finish(start));
        }
        let limited = context.limited_to(context.remaining().mul_f64(TIME_SHARE));
        let mut grown = start.clone();
        if let Some(layered) = self.with_prisms(&start, union, &limited, context)? {
            if layered.thin.is_empty() {
                return Ok(results.finish(layered));
            }
            if layered.thin.lack < before.lack {
                grown = layered;
            }
        }
        // Sharp edges alone stay as they are.
        if self.growth == Growth::Both && !grown.thin.walls().is_empty() {
            let topology = Topology::of(surface, self);
            let filling = Filling { settings: *self, union, context: &limited, input: surface, topology };
            let base = if grown.thin.lack <= MAX_LACK * before.lack { grown.clone() } else { start };
            let filled = filling.run(&base)?;
            let deviation = || results::deviation_of_added(surface, &filled.surface);
            if filled.thin.lack < grown.thin.lack && deviation() <= fill::MAX_DEVIATION * min_wall {
                grown = filled;
            } else {
                (grown.limited, grown.reason) = (filled.limited, filled.reason);
            }
        }
        Ok(results.finish(grown))
    }

    /// The surface with a layer of prisms, within a share of the time in `limited`. Nothing is thin in it if the prisms'
    /// own measure, which follows each prism, finds no thin wall. None if prisms are not tried, or the time ran out.
    fn with_prisms(
        &self,
        start: &Grown,
        union: &dyn SelfUnion,
        limited: &Context<'_>,
        context: &Context<'_>,
    ) -> Result<Option<Grown>, ThickeningError> {
        if self.growth == Growth::Both && start.thin.count() > MAX_PRISMS {
            return Ok(None);
        }
        let prisms = limited.limited_to(limited.remaining().mul_f64(PRISM_SHARE));
        let (surface, is_proved) = match rounds::Rounds::run(*self, &start.surface, union, &prisms) {
            Err(ThickeningError::Cancelled(_)) if !context.is_cancelled() => return Ok(None),
            result => result?,
        };
        let thin = if is_proved { Thin::default() } else { Thin::of(&surface, self.min_wall, context)? };
        Ok(Some(Grown { surface, thin, ..Grown::default() }))
    }
}
