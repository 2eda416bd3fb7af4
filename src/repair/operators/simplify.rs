//! Fewer faces, where that is asked for.

use super::operator::{Applied, Operation, Scope};
use super::topology::Counter;
use crate::math::Precision;
use crate::mesh::Surface;
use crate::repair::{Cancelled, Change, ChangeKind, Context, Options};
use crate::simplify::Simplify;

/// The largest error where only a number of faces is asked for, as a share of the bounding box's diagonal: what is within
/// it counts as no loss of surface.
const MOST_ERROR: f64 = 0.005;
/// Edges of which the faces differ by more degrees keep their line.
const FEATURE_ANGLE_DEG: f64 = 50.0;

/// Removes faces by collapsing edges.
#[derive(Debug, Clone, Copy)]
pub struct ReduceFaces {
    /// Stop at so many faces; none: go as far as the error allows.
    pub max_faces: Option<u64>,
    /// The largest error, in the model's unit; none: 0.5 % of the bounding box's diagonal.
    pub max_error: Option<f64>,
    /// Nor may surface come farther than this from where it was, in the model's unit.
    pub max_deviation: f64,
    /// Whether positions are rounded to f32.
    pub precision: Precision,
}

/// Most faces of a remeshed model: as many times those of the model before, but never fewer than the floor.
const REMESHED_TIMES: u64 = 3;
const REMESHED_FLOOR: u64 = 20_000;
/// What is said of a simplification that the deadline ended.
const LATE: &str = "the time was over before all the faces that a remesh does not need were removed";
/// Edges that a remesh has found keep their line from this angle on, in degrees.
const REMESHED_ANGLE_DEG: f64 = 30.0;

/// What a remesh of `before` left, with as few faces as a fifth of a cell of error allows; where that are still many more than
/// before, with up to 0.3 % of the diagonal. When the deadline comes the faces that are left by then stay.
///
/// # Errors
/// [`Cancelled`] when the work was asked to stop; the surface is then unchanged.
pub(crate) fn reduce_remeshed(
    surface: &mut Surface,
    before: &Surface,
    cell: f64,
    precision: Precision,
    context: &Context<'_>,
) -> Result<Applied, Cancelled> {
    let diagonal = surface.bounds().diagonal();
    let simplify = Simplify {
        max_faces: None,
        max_error: cell / 5.0,
        feature_angle_deg: REMESHED_ANGLE_DEG,
        precision,
        toward: None,
    };
    let faces_before = surface.faces.len() as u64;
    let Some(done) = context.unless_late(simplify.apply(surface, context))? else {
        return Ok(Applied { left: Some(LATE.to_owned()), is_late: true, ..Applied::default() });
    };
    let (mut error, mut is_late) = (done.error, done.is_late);
    let most = REMESHED_FLOOR.max(REMESHED_TIMES * before.faces.len() as u64);
    if done.faces_after > most {
        let farther = Simplify { max_faces: Some(most), max_error: 0.003 * diagonal - error, ..simplify };
        if farther.max_error > simplify.max_error && !is_late {
            let done = context.unless_late(farther.apply(surface, context))?;
            is_late = done.as_ref().is_none_or(|done| done.is_late);
            error += done.map_or(0.0, |done| done.error);
        }
    }
    let changes = Change::list([(ChangeKind::FacesRemoved, faces_before - surface.faces.len() as u64)]);
    let left = is_late.then(|| LATE.to_owned());
    Ok(Applied { changes, moved: error, left, is_late, ..Applied::default() })
}

impl ReduceFaces {
    /// Collapses edges while nothing breaks by it: see [`Simplify::apply`].
    ///
    /// Precondition: none. Result: no counter of the topology rises and no pair of faces intersects that did not before.
    /// Leaves: more faces than asked for, where the error, lines or faces nearby allow no fewer; it is said why.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let diagonal = surface.bounds().diagonal();
        let simplify = Simplify {
            max_faces: self.max_faces,
            max_error: self.max_error.unwrap_or(MOST_ERROR * diagonal).min(self.max_deviation),
            feature_angle_deg: FEATURE_ANGLE_DEG,
            precision: self.precision,
            toward: None,
        };
        let done = simplify.apply(surface, context)?;
        let changes = Change::list([(ChangeKind::FacesRemoved, done.faces_before - done.faces_after)]);
        let is_late = done.is_late;
        Ok(Applied { changes, moved: done.error, left: done.left, is_late, ..Applied::default() })
    }
}

impl Operation for ReduceFaces {
    const FIXES: &'static [Counter] = &Counter::ALL;
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let Options { max_faces, max_error, .. } = *scope.options;
        Self { max_faces, max_error, max_deviation: scope.max_deviation, precision: scope.format.precision() }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
