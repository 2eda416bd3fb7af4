//! Fills sealed cavities, or drills holes into them, as the option `voids` asks.

use super::operator::{Applied, Counter, Operation, Scope};
use super::self_union::SelfUnionRounds;
use crate::arrange::{Exact, WindingRule};
use crate::mesh::{ClosedSurface, Edges, NO_SOURCE, REQUESTED_SOURCE, Surface};
use crate::printing::fill::fill_voids;
use crate::printing::vents::{UnionError, Vent, VentError, VentFailure, VentOptions, Vented, vent_voids};
use crate::printing::voids::{Regions, RegionsError, voids_of};
use crate::repair::{Cancelled, Change, ChangeKind, Context, DrilledVent};

/// The farthest that rounding may move a vertex, as a share of the model's diagonal.
const MAX_ROUNDING: f64 = 1e-4;

/// Makes sealed cavities solid.
///
/// ```text
///    +---------+        +---------+
///    |  +---+  |        |         |
///    |  |   |  |   ->   |         |
///    |  +---+  |        |         |
///    +---------+        +---------+
/// ```
///
/// Precondition: a closed surface without intersections. Result: the faces around each sealed cavity and everything inside
/// it are gone; all other faces stay. Leaves: cavities larger than a limit, and a surface whose nesting is undecided.
#[derive(Debug, Clone, Copy)]
pub struct FillVoids {
    /// The largest cavity to fill, in cubic units.
    max_volume: f64,
}

impl Operation<'_> for FillVoids {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];
    const CHANGES_SOUND_MODEL: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let limit = scope.options.print.keep_cavities_over_mm3;
        Self { max_volume: limit.map_or(f64::INFINITY, |limit| limit / scope.millimetres.powi(3)) }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let edges = Edges::new(&surface.faces);
        let closed = match ClosedSurface::new(surface, &edges) {
            Ok(closed) => closed,
            Err(open) => return Ok(Applied::unchanged(&open)),
        };
        let regions = match Regions::new(closed, &edges, context) {
            Ok(regions) => regions,
            Err(RegionsError::Cancelled(stop)) => return Err(stop),
            Err(error) => return Ok(Applied::unchanged(&error)),
        };
        let voids = voids_of(surface, &regions, context)?;
        let filled = fill_voids(surface, &regions, &voids, |void| voids[void].volume <= self.max_volume);
        *surface = filled.surface;
        Ok(Change::list([
            (ChangeKind::VoidsFilled, filled.filled.len() as u64),
            (ChangeKind::FacesRemoved, filled.faces_removed),
        ])
        .into())
    }
}

/// Drills holes into sealed cavities, so that powder or resin can leave.
///
/// Precondition: a closed surface without intersections. Result: each cavity is joined with the outside by bores, verified
/// one by one; all other faces stay. Leaves: cavities to which no straight bore leads, with the reason.
#[derive(Debug, Clone, Copy)]
pub struct VentVoids {
    options: VentOptions,
    /// Millimetres per unit of the model.
    millimetres: f64,
}

impl Operation<'_> for VentVoids {
    const FIXES: &'static [Counter] = &[];
    const MAY_RAISE: &'static [Counter] = &[];
    const CHANGES_SOUND_MODEL: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let (diameter_mm, per_void) = scope.options.print.vents();
        let diameter = diameter_mm / scope.millimetres;
        let wall = scope.options.print.wall_limit_mm().map_or(diameter / 2.0, |limit| limit / scope.millimetres);
        let precision = scope.format.precision();
        let options = VentOptions { diameter, per_void, wall, up: scope.up, precision };
        Self { options, millimetres: scope.millimetres }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let closed = match ClosedSurface::try_from(&*surface) {
            Ok(closed) => closed,
            Err(open) => return Ok(Applied::unchanged(&open)),
        };
        let vented = match vent_voids(closed, &self.options, &union_of, context) {
            Ok(vented) => vented,
            Err(VentError::Cancelled(stop) | VentError::Regions(RegionsError::Cancelled(stop))) => return Err(stop),
            Err(error) => return Ok(Applied::unchanged(&error)),
        };
        let mut opened: Vec<usize> = vented.vents.iter().map(|vent| vent.void).collect();
        opened.sort_unstable();
        opened.dedup();
        let left = cavities_left(&vented);
        let vents = drilled(&vented, self.millimetres);
        if !opened.is_empty() {
            let known = surface.source.contains(&NO_SOURCE);
            *surface = vented.surface;
            if !known {
                mark_requested(surface);
            }
        }
        let changes = Change::list([
            (ChangeKind::VoidsVented, opened.len() as u64),
            (ChangeKind::VentsDrilled, vented.vents.len() as u64),
            (ChangeKind::VoidsLeft, vented.failed.len() as u64),
        ]);
        Ok(Applied { changes, left, vents, ..Applied::default() })
    }
}

/// The vents as the report lists them: those of the largest cavity first.
fn drilled(vented: &Vented, millimetres: f64) -> Vec<DrilledVent> {
    let mut vents: Vec<&Vent> = vented.vents.iter().collect();
    vents.sort_by_key(|vent| vent.void);
    let listed = vents.into_iter().map(|vent| {
        let cavity = &vented.voids[vent.void];
        DrilledVent {
            at: vent.at.to_array(),
            direction: vent.direction.to_array(),
            diameter_mm: vent.diameter * millimetres,
            length_mm: vent.length * millimetres,
            cavity: cavity.at.to_array(),
            cavity_volume_mm3: cavity.volume * millimetres.powi(3),
        }
    });
    listed.collect()
}

/// The cavities with fewer bores than requested, by reason; `None` if there are none.
fn cavities_left(vented: &Vented) -> Option<String> {
    // For each reason the largest cavity, which comes first, and the number of cavities.
    let mut by_reason: Vec<(&VentFailure, usize, usize)> = Vec::new();
    for (void, failure) in &vented.failed {
        match by_reason.iter_mut().find(|(known, ..)| *known == failure) {
            Some((_, _, count)) => *count += 1,
            None => by_reason.push((failure, *void, 1)),
        }
    }
    let reasons = by_reason.into_iter().map(|(failure, largest, count)| {
        let [x, y, z] = vented.voids[largest].at.to_array();
        let cavities =
            if count == 1 { "the cavity".to_owned() } else { format!("{count} cavities, of which the largest is") };
        format!("{cavities} at ({x:.6}, {y:.6}, {z:.6}): {failure}")
    });
    reasons.reduce(|all, one| format!("{all}; {one}"))
}

/// Marks faces without a source as surface that the options asked for.
pub(super) fn mark_requested(surface: &mut Surface) {
    surface.source.iter_mut().filter(|source| **source == NO_SOURCE).for_each(|source| *source = REQUESTED_SOURCE);
}

/// The boundary of the space that a closed surface winds around at least once, rounded to f32.
pub(super) fn union_of(mut surface: Surface, context: &Context<'_>) -> Result<Surface, UnionError> {
    let max_deviation = MAX_ROUNDING * surface.bounds().diagonal();
    let winding_rule = WindingRule::Positive;
    let rounds = SelfUnionRounds { winding_rule, max_deviation, sheets: None, always: false };
    let resolved = rounds.apply(&mut surface, &Exact, context)?;
    match resolved.error {
        Some(error) => Err(UnionError::Failed(error.to_string())),
        None if resolved.pairs_left > 0 => Err(UnionError::Failed("faces still intersect".to_owned())),
        None => Ok(surface),
    }
}
