//! Fins: faces that hang on an edge of two others.

use super::cut::{NONE, Pairing, mates};
use super::{Applied, Counter, Operation, Scope};
use crate::math::Precision;
use crate::mesh::{Edges, Surface};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

/// Rounds over the mesh: a face may hang on three edges.
const MOST_ROUNDS: usize = 3;

/// Frees the faces without a partner from edges that could not be cut apart, since the faces at both ends are one fan.
#[derive(Debug, Clone, Copy)]
pub struct FreeFins {
    /// Whether the result is rounded to f32.
    pub precision: Precision,
}

impl FreeFins {
    /// Puts a vertex on the middle of the edge for such a face alone, so that what was one edge of three faces is an edge of
    /// two and an open border that can be walked.
    ///
    /// ```text
    ///    u---------v           u---------v      two faces of the wall keep the edge
    ///     \       /      ->     \---m---/       the fin has the two edges at m
    ///      \ fin /               \  |  /
    ///       \   /                 \ | /
    /// ```
    ///
    /// Precondition: cut apart, so that edges of more than two faces are only those whose ends are in one fan. Result: no
    /// vertex moves; where the middle is not a number of f32 it is off the edge by what rounding takes. Leaves: edges that
    /// several pairs of faces share.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Vec<Change>, Cancelled> {
        let mut freed = 0;
        for _ in 0..MOST_ROUNDS {
            let done = self.round(surface, context)?;
            freed += done;
            if done == 0 {
                break;
            }
        }
        Ok(Change::list([(ChangeKind::FinsFreed, freed)]))
    }

    fn round(self, surface: &mut Surface, context: &Context<'_>) -> Result<u64, Cancelled> {
        let edges = Edges::new(&surface.faces);
        if edges.iter().all(|h| h.len() <= 2) {
            return Ok(0);
        }
        let mates = mates(surface, &edges, Pairing::FinsLast, context)?.of;
        let mut busy = vec![false; surface.faces.len()];
        let mut freed = 0;
        for half_edges in edges.iter().filter(|h| h.len() > 2) {
            let (pairs, fins): (Vec<u32>, Vec<u32>) = half_edges.iter().partition(|&&h| mates[h as usize] != NONE);
            // Where there is no pair one of them may keep the edge.
            for h in fins.into_iter().skip(usize::from(pairs.is_empty())) {
                if !std::mem::replace(&mut busy[h as usize / 3], true) && self.split(surface, h) {
                    freed += 1;
                }
            }
        }
        Ok(freed)
    }

    /// Cuts the face of a half-edge in two at the edge's middle.
    fn split(self, surface: &mut Surface, h: u32) -> bool {
        let [u, v] = Edges::ends(&surface.faces, h);
        let (w, f) = (Edges::opposite(&surface.faces, h), h as usize / 3);
        let [a, b] = [u, v].map(|v| surface.positions[v as usize]);
        let middle = self.precision.round((a + b) * 0.5);
        let Ok(m) = u32::try_from(surface.positions.len()) else { return false };
        if middle == a || middle == b || !middle.is_finite() {
            return false;
        }
        surface.positions.push(middle);
        surface.faces[f] = [u, m, w];
        surface.faces.push([m, v, w]);
        surface.source.push(surface.source[f]);
        true
    }
}

impl Operation for FreeFins {
    const FIXES: &'static [Counter] = &[Counter::NonmanifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::PinchedVertices];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { precision: scope.format.precision() }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(self.apply(surface, context)?.into())
    }
}
