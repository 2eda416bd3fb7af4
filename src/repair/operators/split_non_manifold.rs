//! Splits a surface at non-manifold edges and vertices: fans of faces get separate vertices, and fins are detached.

use super::face_pairs::{FacePairs, NONE, pair_faces};
use super::operator::{Applied, Counter, Operation, Scope};
use crate::math::Precision;
use crate::mesh::{Edges, Surface, UnionFind};
use crate::repair::{Cancelled, Change, ChangeKind, Context};

pub use super::face_pairs::Pairing;

/// Which fans at a pinched vertex get separate vertices.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Pinches {
    /// All fans.
    Cut,
    /// All fans, but those with a boundary stay together where no non-manifold edge ends, so that filling the holes can
    /// join them.
    KeepAtBoundaries,
}

/// Gives each sheet separate vertices where it meets others in a non-manifold edge or vertex.
///
/// Around an edge with more than two faces, the faces are paired in angular order so that each pair bounds the solid between
/// its faces. The pairing matches brackets: a face opens where a turn around the edge enters a solid, and closes where it leaves.
///
/// ```text
///    solid 1 |                       solid 1 |
///    --------+--------      ->       --------+  +--------
///            | solid 2                          | solid 2
/// ```
///
/// Precondition: faces wind consistently and outward as far as possible. Result: copies have the same positions as the
/// originals, no face goes, no vertex moves; every edge has one or two faces, except where both ends of the edge lie in one
/// fan. Leaves: those edges; faces without a mate, whose edges become boundary. [`super::perturb`] keeps the sheets apart in
/// formats without indices.
///
/// Guéziec et al. 2001, "Cutting and Stitching: Converting Sets of Polygons to Manifold Surfaces".
///
/// # Errors
/// [`Cancelled`] when the work should stop; the surface is then unchanged.
pub fn split_non_manifold(
    surface: &mut Surface,
    pairing: Pairing,
    pinches: Pinches,
    context: &Context<'_>,
) -> Result<Vec<Change>, Cancelled> {
    let edges = Edges::new(&surface.faces);
    let FacePairs { mate, non_manifold_edges, unpaired } = pair_faces(surface, &edges, pairing, context)?;
    let faces = &surface.faces;
    let mut sets = UnionFind::new(faces.len() * 3);
    for (h, &mate) in (0u32..).zip(&mate).filter(|&(h, &mate)| mate != NONE && mate > h) {
        if Edges::ends(faces, h) == Edges::ends(faces, mate) {
            sets.unite(h, mate);
            sets.unite(Edges::next(h), Edges::next(mate));
        } else {
            sets.unite(h, Edges::next(mate));
            sets.unite(Edges::next(h), mate);
        }
    }
    if pinches == Pinches::KeepAtBoundaries {
        join_boundary_fans(surface, &edges, &mate, &mut sets);
    }
    let (mut first_fan, mut of_fan) = (vec![NONE; surface.positions.len()], vec![NONE; faces.len() * 3]);
    let mut copies = 0;
    for corner in 0..of_fan.len() {
        let (face, i) = (corner / 3, corner % 3);
        #[expect(clippy::cast_possible_truncation, reason = "corners are counted in u32")]
        let root = sets.root(corner as u32) as usize;
        if root == corner {
            let v = surface.faces[face][i];
            if first_fan[v as usize] == NONE {
                first_fan[v as usize] = v;
                of_fan[root] = v;
            } else {
                #[expect(clippy::cast_possible_truncation, reason = "no more vertices than corners")]
                {
                    of_fan[root] = surface.positions.len() as u32;
                }
                surface.positions.push(surface.positions[v as usize]);
                copies += 1;
            }
        }
        surface.faces[face][i] = of_fan[root];
    }
    Ok(Change::list([
        (ChangeKind::NonManifoldEdgesSplit, non_manifold_edges),
        (ChangeKind::VerticesDuplicated, copies),
        (ChangeKind::FacesWithoutPartner, unpaired),
    ]))
}

/// Joins the fans with a boundary at each vertex where no non-manifold edge ends.
fn join_boundary_fans(surface: &Surface, edges: &Edges, mates: &[u32], sets: &mut UnionFind) {
    let mut joins = vec![true; surface.positions.len()];
    for (e, _) in edges.iter().enumerate().filter(|(_, h)| h.len() > 2) {
        for v in edges.vertices(e) {
            joins[v as usize] = false;
        }
    }
    let mut first = vec![NONE; surface.positions.len()];
    for half_edges in edges.iter() {
        for &h in half_edges.iter().filter(|&&h| mates[h as usize] == NONE) {
            for corner in [h, Edges::next(h)] {
                let v = surface.faces[corner as usize / 3][corner as usize % 3] as usize;
                if !joins[v] {
                    continue;
                }
                if first[v] == NONE {
                    first[v] = corner;
                }
                sets.unite(first[v], corner);
            }
        }
    }
}

/// Splits the surface at non-manifold edges and vertices.
#[derive(Debug, Clone, Copy)]
pub struct SplitNonManifold {
    pairing: Pairing,
}

impl Operation<'_> for SplitNonManifold {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges, Counter::PinchedVertices];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::DuplicateFaces];
    const ACTS_ON: &'static [Counter] = &[Counter::NonManifoldEdges, Counter::PinchedVertices];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { pairing: scope.pairing }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(split_non_manifold(surface, self.pairing, Pinches::KeepAtBoundaries, context)?.into())
    }
}

/// The most rounds over the mesh: a face may be attached along three edges.
const MAX_ROUNDS: usize = 3;

/// Detaches faces without a mate from edges that could not be split, since the faces at both ends form one fan.
#[derive(Debug, Clone, Copy)]
pub struct DetachFins {
    /// The precision to which new positions are rounded.
    pub precision: Precision,
}

impl DetachFins {
    /// Adds a vertex at the middle of the edge to the unpaired face only. The edge with three faces becomes an edge with two
    /// faces and a boundary that can be traversed.
    ///
    /// ```text
    ///    u---------v           u---------v      two faces of the solid keep the edge
    ///     \       /      ->     \---m---/       the fin gets the two edges at m
    ///      \ fin /               \  |  /
    ///       \   /                 \ | /
    /// ```
    ///
    /// Precondition: split, so that non-manifold edges remain only where both ends lie in one fan. Result: no vertex moves;
    /// the new vertex is off the edge by no more than the rounding. Leaves: edges that several pairs of faces share.
    ///
    /// # Errors
    /// [`Cancelled`] when the work should stop.
    pub fn apply(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Vec<Change>, Cancelled> {
        let mut detached = 0;
        for _ in 0..MAX_ROUNDS {
            let count = self.round(surface, context)?;
            detached += count;
            if count == 0 {
                break;
            }
        }
        Ok(Change::list([(ChangeKind::FinsDetached, detached)]))
    }

    fn round(self, surface: &mut Surface, context: &Context<'_>) -> Result<u64, Cancelled> {
        let edges = Edges::new(&surface.faces);
        if edges.iter().all(|h| h.len() <= 2) {
            return Ok(0);
        }
        let mates = pair_faces(surface, &edges, Pairing::FinsLast, context)?.mate;
        let mut busy = vec![false; surface.faces.len()];
        let mut detached = 0;
        for half_edges in edges.iter().filter(|h| h.len() > 2) {
            let (pairs, fins): (Vec<u32>, Vec<u32>) = half_edges.iter().partition(|&&h| mates[h as usize] != NONE);
            // Where there is no pair, one fin may keep the edge.
            for h in fins.into_iter().skip(usize::from(pairs.is_empty())) {
                if !std::mem::replace(&mut busy[h as usize / 3], true) && self.split(surface, h) {
                    detached += 1;
                }
            }
        }
        Ok(detached)
    }

    /// Splits the face of a half-edge in two at the edge's middle.
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

impl Operation<'_> for DetachFins {
    const FIXES: &'static [Counter] = &[Counter::NonManifoldEdges];
    const MAY_RAISE: &'static [Counter] = &[Counter::BoundaryEdges, Counter::PinchedVertices];
    const ACTS_ON: &'static [Counter] = &[Counter::NonManifoldEdges];

    fn with_scope(scope: &Scope<'_>, _surface: &Surface) -> Self {
        Self { precision: scope.format.precision() }
    }

    fn run(&self, surface: &mut Surface, context: &Context<'_>) -> Result<Applied, Cancelled> {
        Ok(self.apply(surface, context)?.into())
    }
}
