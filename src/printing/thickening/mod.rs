//! Thickening: grows the walls of a solid that are thinner than a limit, and proves the result.
//!
//! Three ways follow one another, each on the result of the one before, until nothing is thin. Flat regions that are thin nearly
//! everywhere grow by one distance (`regions`): their vertices move (`moved`), so that the surface keeps its faces. Then a few
//! thin faces get a layer of prisms, as high as each point needs (`refine`, `layer`), which keeps edges sharp. `growth` finds
//! the distances, and `rounds` repeats and checks both, with the unions of `attempt`. At last balls of the least wall's
//! diameter stand along the middle of the thin places (`bodies`), in rounds (`fill`), and one closed surface around all balls
//! is built (`spheres`). The exact union of the solid with the layer or the balls is the result (`unite`), so faces outside
//! the added material keep their exact corners. Pockets of air between both are filled where they are narrow (`pockets`).
//! Balls that would close a hole or change a cavity are left out (`unions`).
//! After each way the walls of the rounded result are measured. The result with the least lack of thickness counts
//! (`results`).

mod attempt;
mod bodies;
mod clearance;
mod fill;
mod gaps;
mod growth;
mod handles;
mod layer;
mod limits;
mod mitre;
mod moved;
mod nested;
mod outcome;
mod places;
mod pockets;
mod refine;
mod regions;
mod results;
mod rounds;
mod sampling;
mod sides;
mod spheres;
mod spread;
mod unions;
mod unite;
mod walls;

use std::time::Duration;

use growth::thin_walls;
use limits::Limits;
use results::{Grown, Thin};
use rounds::{Fit, Rounds};
use sides::kept_side;
use unions::Filling;
use unite::Topology;
use walls::Walls;

use crate::context::{Cancelled, Context};
use crate::mesh::{ClosedSurface, Surface};
use crate::printing::thickness::{Space, opposed_pairs, rounded_limit};

pub use outcome::{Growth, PlaceResult, Thickened, ThickenedPlace, Thickening, ThickeningError, ThinReason};
pub use unite::SelfUnion;

/// The time that is kept for the end, before the time of a measurement of a result is known: for removing slivers, and for checks. The
/// first share of the remaining time, but no more than these seconds or the second share.
const KEPT_SHARES: [f64; 2] = [0.3, 0.15];
const KEPT_S: u64 = 8;
/// The time that is kept for the end at least, in times that a measurement took and alone.
const KEPT_MEASUREMENTS: u32 = 3;
const LEAST_KEPT: Duration = Duration::from_secs(1);
/// Share of the time that is left then for each kind of layer, and the most. Where a layer can help it is quick as a rule.
const LAYER_SHARE: f64 = 0.1;
const LAYER_S: u64 = 15;
/// Most thin faces for which prisms are tried: they keep edges sharp, but often fail on many small faces.
const MAX_PRISMS: usize = 400;
/// The expected duration of a thickening of many faces, on two cores, if they lack the least wall over a square of it. It grows with the
/// root of what all lack.
const EXPECTED: Duration = Duration::from_millis(900);
/// The share of the least gap to which rounding may narrow a gap.
const MAX_NARROWER: f64 = 0.98;
/// The share of the lack of thickness up to which the next way starts from a result with a wall that is thinner than before.
const MAX_LACK: f64 = 0.5;

impl Thickening {
    /// Thickens the walls of a solid. The surface must be oriented outward and without intersections; its positions must
    /// have the precision of the output.
    ///
    /// Promises: the input is contained in the result. Faces outside the added material keep their corners and sources, but
    /// beside a moved region their corners move within their plane.
    /// Nested solids, which lie inside the material of others, stay as they are. Large cavities stay, only touching or small
    /// near solids are joined, and no through hole that is wider than the least gap is closed. A slit that the growth closes on
    /// all sides is filled if it is nowhere wider than the least gap. Where a wall stays thin, a place says why.
    ///
    /// # Errors
    /// [`ThickeningError`] for unusable settings or a cancellation.
    pub fn apply(
        &self,
        surface: ClosedSurface<'_>,
        union: &dyn SelfUnion,
        context: &Context<'_>,
    ) -> Result<Thickened, ThickeningError> {
        let &Self { min_wall, min_gap, .. } = self;
        if !(min_wall > 0.0 && min_wall.is_finite() && min_gap >= 0.0 && min_gap.is_finite()) {
            return Err(ThickeningError::Settings { min_wall, min_gap });
        }
        let Some([outer, nested]) = nested::split(surface.get(), context)? else {
            return self.thickened(surface.get(), union, context);
        };
        let mut thickened = self.thickened(&outer, union, context)?;
        thickened.surface.append(nested);
        Ok(thickened)
    }

    /// Thickens the walls of a surface without nested solids.
    fn thickened(
        &self,
        surface: &Surface,
        union: &dyn SelfUnion,
        context: &Context<'_>,
    ) -> Result<Thickened, ThickeningError> {
        let min_wall = self.min_wall;
        let at_start = context.remaining();
        let before = Thin::of(surface, min_wall, context)?;
        let results = results::Results { settings: *self, input: surface, before: &before };
        let start = Grown { surface: results::with_own_sources(surface), thin: before.clone(), ..Grown::default() };
        if before.is_empty() {
            return Ok(results.finish(start));
        }
        if before.count() > MAX_PRISMS {
            context.expect_remaining(EXPECTED.mul_f64((before.lack / (min_wall * min_wall)).sqrt()));
        }
        let remaining = context.remaining();
        let [short, long] = KEPT_SHARES.map(|share| remaining.mul_f64(share));
        let of_measure = at_start.saturating_sub(remaining) * KEPT_MEASUREMENTS;
        let kept = short.min(long.max(Duration::from_secs(KEPT_S)).max(of_measure));
        let limited = context.ending_before(kept);
        let (mut grown, mut base) = (start.clone(), start.clone());
        for fit in [Fit::Regions, Fit::Points] {
            let Some(layered) = self.with_layer(fit, (&start, &base), union, (&limited, context))? else { continue };
            let is_better = layered.is_better_than(&grown, &before);
            if layered.thin.is_empty() {
                return Ok(results.finish(layered));
            }
            if is_better || layered.thin.lack <= MAX_LACK * base.thin.lack {
                base = layered.clone();
            }
            if is_better {
                grown = layered;
            }
        }
        // A layer can end where balls can't go on, since it moved the surface as far as is allowed.
        let bases: &[&Grown] = if base.surface == start.surface { &[&start] } else { &[&base, &start] };
        let grown = self.with_balls(grown, (surface, &before), (bases, kept), (union, context))?;
        Ok(results.finish(grown))
    }

    /// The best of a result and of bases with balls in their thin places. The time `kept` is for the end.
    fn with_balls(
        &self,
        mut grown: Grown,
        (surface, before): (&Surface, &Thin),
        (bases, kept): (&[&Grown], Duration),
        (union, context): (&dyn SelfUnion, &Context<'_>),
    ) -> Result<Grown, Cancelled> {
        let (limits, has_equal_sides) = self.limits(surface, before, context)?;
        let topology = Topology::of(surface, self);
        let filling = Filling { settings: *self, union, context, kept, limits: &limits, before, topology };
        for (number, base) in bases.iter().enumerate() {
            let mut filled = filling.run(base)?;
            filled.grew_on_equal_sides |= has_equal_sides;
            if filled.is_better_than(&grown, before) {
                grown = filled;
            } else if number == 0 {
                (grown.limited, grown.reason) = (filled.limited, filled.reason);
            }
            if grown.thin.is_empty() {
                break;
            }
        }
        Ok(grown)
    }

    /// The limits of balls in a surface, and whether a wall has no side that stays.
    fn limits<'a>(
        &self,
        surface: &'a Surface,
        before: &Thin,
        context: &Context<'_>,
    ) -> Result<(Limits<'a>, bool), Cancelled> {
        let limits = Limits::new(surface, *self);
        if self.growth == Growth::Both {
            return Ok((limits, false));
        }
        let walls = Walls::new(surface);
        let thin = thin_walls(&walls, before.walls(), self.min_wall, context)?;
        let side = kept_side(surface, &walls, &thin, (self.growth, self.min_wall), context)?;
        Ok((limits.keeping(side.faces), side.has_equal_sides))
    }

    /// A surface with a layer on it. Takes a share of the time in `limited`. None if the layer is not tried, or the time ran out.
    fn with_layer(
        &self,
        fit: Fit,
        (start, base): (&Grown, &Grown),
        union: &dyn SelfUnion,
        (limited, context): (&Context<'_>, &Context<'_>),
    ) -> Result<Option<Grown>, ThickeningError> {
        if fit == Fit::Points && self.growth == Growth::Both && base.thin.count() > MAX_PRISMS {
            return Ok(None);
        }
        let share = limited.remaining().mul_f64(LAYER_SHARE);
        let limited = limited.limited_to(share.min(Duration::from_secs(LAYER_S)));
        let mut grown = match Rounds::run(*self, fit, (&base.surface, &base.thin), union, &limited) {
            Err(ThickeningError::Cancelled(_)) if !context.is_cancelled() => return Ok(None),
            result => result?,
        };
        let (of_base, of_input) = (results::face_count(&base.surface), results::face_count(&start.surface));
        for source in &mut grown.surface.source {
            let below = base.surface.source[(*source % of_base.max(1)) as usize];
            *source = if *source >= of_base { below % of_input + of_input } else { below };
        }
        if fit == Fit::Regions && self.narrows_a_gap(&grown.surface, of_input, context)? {
            return Ok(None);
        }
        grown.grew_on_equal_sides |= base.grew_on_equal_sides;
        Ok(Some(grown))
    }

    /// Whether a gap at an added face, whose source is at least `first_added`, is narrower than the least gap.
    fn narrows_a_gap(&self, surface: &Surface, first_added: u32, context: &Context<'_>) -> Result<bool, Cancelled> {
        if self.min_gap <= 0.0 {
            return Ok(false);
        }
        let limit = rounded_limit(surface, MAX_NARROWER * self.min_gap);
        let gaps = opposed_pairs(surface, limit, Space::Air, context)?.walls;
        let is_added = |face: &u32| surface.source[*face as usize] >= first_added;
        Ok(gaps.iter().any(|gap| gap.faces.iter().any(is_added)))
    }
}
