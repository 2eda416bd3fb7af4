//! The last way natively: the surface made anew from what is inside of it.

use super::names::Operator;
use super::operator::{Applied, Failure, Operation, Scope};
use super::simplify::reduce_remeshed;
use super::topology::Counter;
use crate::arrange::Inside;
use crate::mesh::Surface;
use crate::remesh;
use crate::remesh::{Remesh, RemeshError};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

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
        let (lost, added) = (made.deviation.lost, made.deviation.made);
        if lost.max > self.max_deviation {
            return Ok(Applied { failed: Some(Failure::TooFar { away: lost.max }), ..Applied::default() });
        }
        let faces = made.surface.faces.len() as u64;
        let mut changes =
            Change::list([(ChangeKind::FacesMade, faces), (ChangeKind::ThinPlacesThickened, made.made_inside)]);
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
            inside: match scope.inside {
                Inside::Positive => remesh::Inside::Outward,
                Inside::Nonzero => remesh::Inside::EitherWay,
                Inside::Odd => remesh::Inside::Odd,
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
