//! Operators that remesh the surface from the enclosed volume and that reduce the number of faces.

use super::operator::{Applied, Counter, Failure, Operation, Scope};
use super::rounding::{DistinguishLimits, distinguish_vertices};
use crate::math::Precision;
use crate::mesh::Surface;
use crate::remesh::{Remesh, RemeshError};
use crate::repair::{Cancelled, Change, ChangeKind, Context, Operator, Options};
use crate::simplify::Simplify;

/// The most faces of a remeshed model: a multiple of the faces before, but at least the second number.
const MAX_FACE_RATIO: u64 = 3;
const MIN_FACE_LIMIT: u64 = 20_000;
/// The note for a simplification that the deadline ended.
const LATE_NOTE: &str = "the deadline came before all faces that the remesh does not need were removed";
/// The note for a maximum error that was not tested everywhere.
const UNTESTED_NOTE: &str = "the deadline came before the distance was tested at every point; it holds at the vertices, and at the \
                             centroids of faces and midpoints of edges";
/// The dihedral angle in degrees from which edges of a remeshed surface are kept as features.
const REMESHED_ANGLE_DEG: f64 = 30.0;

/// The default largest error of a reduction, as a share of the bounding box's diagonal. A smaller deviation does not count as lost
/// surface.
const DEFAULT_ERROR: f64 = 0.005;
/// The dihedral angle in degrees from which edges are kept as features.
const FEATURE_ANGLE_DEG: f64 = 50.0;

/// Builds a closed, manifold surface without intersections around the enclosed volume.
#[derive(Debug, Clone, Copy)]
pub struct RemeshInside {
    /// The settings of the remesh: cell size, limits, winding rule, rounding.
    pub remesh: Remesh,
    /// The largest distance from the input surface to the new surface, in the model's unit.
    pub max_deviation: f64,
    /// Whether to remove faces that the new surface does not need.
    pub reduce: bool,
}

impl RemeshInside {
    /// The remesh that the options ask for.
    pub(crate) fn for_scope(scope: &Scope<'_>, surface: &Surface) -> Self {
        let options = scope.options;
        let default_cell = || surface.bounds().diagonal() / f64::from(options.voxel_resolution);
        let remesh = Remesh {
            cell: Some(options.voxel_size.unwrap_or_else(default_cell)),
            max_faces: options.max_remesh_faces,
            winding_rule: scope.winding_rule,
            precision: scope.format.precision(),
            ..Remesh::default()
        };
        Self { remesh, max_deviation: scope.max_deviation, reduce: !options.without.contains(&Operator::Simplify) }
    }

    /// The same remesh with cells of another size, without the reduction of faces.
    #[must_use]
    pub(crate) fn with_cell(&self, cell: f64) -> Self {
        Self { remesh: Remesh { cell: Some(cell), ..self.remesh }, reduce: false, ..*self }
    }

    /// Replaces the surface, then removes the faces that it does not need.
    ///
    /// ```text
    ///    .---. .                .---------.
    ///    |   |/|                |         |      holes closed, overlapping volumes united,
    ///    | .-+-.--.     ->      |         '--.   internal faces removed, sharp edges kept
    ///    '-+-'    |             '--.         |
    ///      '-- ---'                '---------'
    /// ```
    ///
    /// Precondition: faces mostly wind outward around solids; holes, flipped faces, overlaps and internal faces may be
    /// anywhere. Result: closed, oriented, manifold and free of intersections in the coordinates that the file will hold;
    /// within about one cell of the input, and the note reports the measured distance. Leaves: the input surface where nothing is
    /// enclosed, the limits allow no result, or the result would deviate by more than `max_deviation`. Source: see
    /// [`crate::remesh`].
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let remeshed = match self.remesh.apply(surface, context) {
            Ok(remeshed) => remeshed,
            Err(RemeshError::Cancelled(canceled)) => return Err(canceled),
            Err(error) => return Ok(Applied { failed: Some(error.into()), ..Applied::default() }),
        };
        let (lost, added) = (remeshed.deviation.lost, remeshed.deviation.added);
        if lost.max > self.max_deviation {
            return Ok(Applied { failed: Some(Failure::TooFar { away: lost.max }), ..Applied::default() });
        }
        let faces = remeshed.surface.faces.len() as u64;
        let mut changes = Change::list([
            (ChangeKind::FacesCreated, faces),
            (ChangeKind::ThinPlacesThickened, remeshed.forced_inside),
        ]);
        let mut result = remeshed.surface;
        let mut reduced = Applied::default();
        if self.reduce {
            reduced = reduce_remeshed(&mut result, surface, remeshed.cell, self.remesh.precision, context)?;
            changes.append(&mut reduced.changes);
        }
        let limits = DistinguishLimits { max_deviation: self.max_deviation, moves: true };
        let merged = distinguish_vertices(&mut result, limits, |_| true, context)?;
        changes.extend(Change::list([(ChangeKind::NearCoincidentVerticesMerged, merged)]));
        *surface = result;
        let mut left = format!(
            "cell size {:.6}; 99 % of the input is within {:.6} of the result, all of it within {:.6}; 99 % of the result \
             is within {:.6} of the input, all of it within {:.6}",
            remeshed.cell, lost.p99, lost.max, added.p99, added.max
        );
        if let Some(late) = reduced.left {
            left = format!("{left}; {late}");
        }
        let (moved, voxel_size, is_late) = (lost.max + reduced.moved, Some(remeshed.cell), reduced.is_late);
        Ok(Applied { changes, moved, left: Some(left), voxel_size, is_late, ..Applied::default() })
    }
}

impl Operation<'_> for RemeshInside {
    const FIXES: &'static [Counter] = &Counter::ALL;
    const MAY_RAISE: &'static [Counter] = &[];
    const IS_HEAVY: bool = true;

    fn with_scope(scope: &Scope<'_>, surface: &Surface) -> Self {
        Self::for_scope(scope, surface)
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}

/// Simplifies a remeshed surface with an error of up to a fifth of a cell. If it still has many more faces than `before`, the
/// error may reach 0.3 % of the diagonal. At the deadline the faces that are left by then stay.
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
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
        everywhere: false,
        feature_angle_deg: REMESHED_ANGLE_DEG,
        precision,
    };
    let faces_before = surface.faces.len() as u64;
    let Some(done) = context.unless_late(simplify.apply(surface, context))? else {
        return Ok(Applied { left: Some(LATE_NOTE.to_owned()), is_late: true, ..Applied::default() });
    };
    let (mut error, mut is_late) = (done.error, done.is_late);
    let most = MIN_FACE_LIMIT.max(MAX_FACE_RATIO * before.faces.len() as u64);
    if done.faces_after > most {
        let farther = Simplify { max_faces: Some(most), max_error: 0.003 * diagonal - error, ..simplify };
        if farther.max_error > simplify.max_error && !is_late {
            let done = context.unless_late(farther.apply(surface, context))?;
            is_late = done.as_ref().is_none_or(|done| done.is_late);
            error += done.map_or(0.0, |done| done.error);
        }
    }
    let changes = Change::list([(ChangeKind::FacesRemoved, faces_before - surface.faces.len() as u64)]);
    let left = is_late.then(|| LATE_NOTE.to_owned());
    Ok(Applied { changes, moved: error, left, is_late, ..Applied::default() })
}

/// Reduces the number of faces by collapsing edges.
#[derive(Debug, Clone, Copy)]
pub struct ReduceFaces {
    /// The number of faces at which to stop; `None` goes as far as the error allows.
    pub max_faces: Option<u64>,
    /// The largest error, in the model's unit; `None` is 0.5 % of the bounding box's diagonal.
    pub max_error: Option<f64>,
    /// The largest distance between the old and the new surface, in the model's unit.
    pub max_deviation: f64,
    /// The precision to which positions are rounded.
    pub precision: Precision,
}

impl ReduceFaces {
    /// Collapses edges while the surface stays intact: see [`Simplify::apply`].
    ///
    /// Precondition: none. Result: no topological counter rises, and no further pair of faces intersects. Leaves: more faces
    /// than requested where the error, feature edges or nearby faces allow no fewer; the note says why.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop; the surface is then unchanged.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        let diagonal = surface.bounds().diagonal();
        let simplify = Simplify {
            max_faces: self.max_faces,
            max_error: self.max_error.unwrap_or(DEFAULT_ERROR * diagonal).min(self.max_deviation),
            everywhere: true,
            feature_angle_deg: FEATURE_ANGLE_DEG,
            precision: self.precision,
        };
        let done = simplify.apply(surface, context)?;
        let changes = Change::list([(ChangeKind::FacesRemoved, done.faces_before - done.faces_after)]);
        let is_untested = self.max_error.is_some() && done.bound > simplify.max_error;
        let limited = is_untested.then(|| ("max_error", UNTESTED_NOTE.to_owned())).into_iter().collect();
        let is_late = done.is_late;
        Ok(Applied { changes, moved: done.error, left: done.shortfall, limited, is_late, ..Applied::default() })
    }
}

impl Operation<'_> for ReduceFaces {
    const FIXES: &'static [Counter] = &Counter::ALL;
    const MAY_RAISE: &'static [Counter] = &[];
    const IS_HEAVY: bool = true;

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        let Options { max_faces, max_error, .. } = *scope.options;
        Self { max_faces, max_error, max_deviation: scope.max_deviation, precision: scope.format.precision() }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        self.apply(surface, context)
    }
}
