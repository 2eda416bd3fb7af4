//! The surface remeshed from what is inside of it; and fewer faces, after a remesh or where that is asked for.

use super::names::Operator;
use super::operator::{Applied, Counter, Failure, Operation, Scope};
use crate::arrange::WindingRule;
use crate::math::Precision;
use crate::mesh::Surface;
use crate::remesh;
use crate::remesh::{Remesh, RemeshError};
use crate::repair::{Cancelled, Change, ChangeKind, Context, Options};
use crate::simplify::Simplify;

/// Most faces of a remeshed model: as many times those of the model before, but never fewer than the floor.
const REMESHED_TIMES: u64 = 3;
const REMESHED_FLOOR: u64 = 20_000;
/// What is said of a simplification that the deadline ended.
const LATE: &str = "the time was over before all the faces that a remesh does not need were removed";
/// Edges that a remesh has found keep their line from this angle on, in degrees.
const REMESHED_ANGLE_DEG: f64 = 30.0;

/// The largest error where only a number of faces is asked for, as a share of the bounding box's diagonal: what is within
/// it counts as no loss of surface.
const MOST_ERROR: f64 = 0.005;
/// Edges of which the faces differ by more degrees keep their line.
const FEATURE_ANGLE_DEG: f64 = 50.0;

/// Makes a closed, manifold surface without intersections around whatever is inside.
#[derive(Debug, Clone, Copy)]
pub struct RemeshInside {
    /// How: size of cells, limits, what is inside, rounding.
    pub remesh: Remesh,
    /// The farthest that the surface as it was may be from the new one, in the model's unit.
    pub max_deviation: f64,
    /// Whether faces that the new surface does not need are removed.
    pub reduce: bool,
}

impl RemeshInside {
    /// Replaces the surface, and then removes the faces that it does not need.
    ///
    /// ```text
    ///    .---. .                .---------.
    ///    |   |/|                |         |      holes closed, what overlaps united,
    ///    | .-+-.--.     ->      |         '--.   inner walls gone, sharp edges kept
    ///    '-+-'    |             '--.         |
    ///      '-- ---'                '---------'
    /// ```
    ///
    /// Precondition: faces mostly wind outward around what is solid; holes, flips, overlaps and inner walls may be anywhere.
    /// Result: closed, oriented, manifold, free of intersections in the coordinates that the file will hold, and within about
    /// a cell of the input, as measured and told. Leaves: everything where nothing is inside, the limits allow no result,
    /// or the result would be farther away than `max_deviation`. Source: see [`crate::remesh`].
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let made = match self.remesh.apply(surface, context) {
            Ok(made) => made,
            Err(RemeshError::Cancelled(canceled)) => return Err(canceled),
            Err(error) => return Ok(Applied { failed: Some(error.into()), ..Applied::default() }),
        };
        let (lost, added) = (made.deviation.lost, made.deviation.added);
        if lost.max > self.max_deviation {
            return Ok(Applied { failed: Some(Failure::TooFar { away: lost.max }), ..Applied::default() });
        }
        let faces = made.surface.faces.len() as u64;
        let mut changes =
            Change::list([(ChangeKind::FacesCreated, faces), (ChangeKind::ThinPlacesThickened, made.forced_inside)]);
        let mut result = made.surface;
        let mut reduced = Applied::default();
        if self.reduce {
            reduced = reduce_remeshed(&mut result, surface, made.cell, self.remesh.precision, context)?;
            changes.append(&mut reduced.changes);
        }
        *surface = result;
        let mut left = format!(
            "with cells of {:.6}; 99 % of what was there is within {:.6} of the result, the farthest {:.6}; 99 % of the \
             result is within {:.6} of what was there, the farthest {:.6}",
            made.cell, lost.p99, lost.max, added.p99, added.max
        );
        if let Some(late) = reduced.left {
            left = format!("{left}; {late}");
        }
        let (moved, voxel_size, is_late) = (lost.max + reduced.moved, Some(made.cell), reduced.is_late);
        Ok(Applied { changes, moved, left: Some(left), voxel_size, is_late, ..Applied::default() })
    }
}

impl Operation for RemeshInside {
    const FIXES: &'static [Counter] = &Counter::ALL;
    const MAY_RAISE: &'static [Counter] = &[];

    fn with_scope(scope: &Scope<'_>, surface: &Surface) -> Self {
        let options = scope.options;
        let usual = || surface.bounds().diagonal() / f64::from(options.voxel_resolution);
        let remesh = Remesh {
            cell: Some(options.voxel_size.unwrap_or_else(usual)),
            max_faces: options.max_remesh_faces,
            winding_rule: match scope.winding_rule {
                WindingRule::Positive => remesh::WindingRule::Positive,
                WindingRule::Nonzero => remesh::WindingRule::Nonzero,
                WindingRule::Odd => remesh::WindingRule::Odd,
            },
            precision: scope.format.precision(),
            ..Remesh::default()
        };
        Self { remesh, max_deviation: scope.max_deviation, reduce: !options.without.contains(&Operator::Simplify) }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

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
        Ok(Applied { changes, moved: done.error, left: done.shortfall, is_late, ..Applied::default() })
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
