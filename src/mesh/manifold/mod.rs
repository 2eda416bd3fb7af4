//! The rungs above [`Surface`]: [`HalfEdgeMesh`], an oriented 2-manifold that may have boundary, and [`Manifold`], a
//! closed one.
//!
//! Half-edges are the corners of the faces (a corner table: Rossignac, Safonova and Szymczak 2001), so that a face's
//! three half-edges need no links; each knows its twin, and each vertex one half-edge that leaves it:
//!
//! ```text
//!            c                   h       runs from a to b along face(h)
//!          /   \                 next(h) b to c,  prev(h) c to a
//!   prev /   f   \ next          twin(h) b to a along the other face; none on the boundary
//!      /     h     \
//!     a ----------> b            around(a) turns counter-clockwise: h, twin(prev(h)), ...
//!       <----------              on the boundary it begins with the half-edge that has no twin
//!         twin(h)
//! ```

mod check;
mod closed;
mod convert;
mod edits;
mod merge;
mod walks;

#[cfg(test)]
mod tests;

pub use closed::Manifold;
pub use convert::NotManifold;
pub use edits::Refused;

use glam::DVec3;

use super::{FaceId, HalfEdgeId, VertexId};

/// A triangle mesh in which every edge has one face, or two that run along it in opposite directions, no two edges
/// join the same vertices, and the faces at every vertex form one fan.
///
/// Edits keep this. They name elements by handles, which stay good until an edit that says otherwise; what an edit
/// removes leaves a gap, so that nothing else is renumbered until [`HalfEdgeMesh::to_surface`]. A vertex without faces
/// is not part of the mesh.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct HalfEdgeMesh {
    /// Where each half-edge starts, three for each face; none for a face that was removed.
    origin: Vec<Option<VertexId>>,
    /// The other side of each half-edge; none on the boundary.
    twin: Vec<Option<HalfEdgeId>>,
    /// A half-edge that leaves each vertex, the one without a twin if there is one; none for a vertex without faces.
    outgoing: Vec<Option<HalfEdgeId>>,
    positions: Vec<DVec3>,
    /// For each face the input face that it is or was cut from.
    source: Vec<u32>,
    /// How many faces there are, without gaps.
    faces: usize,
}

impl HalfEdgeMesh {
    /// How many faces there are.
    #[must_use]
    pub fn face_count(&self) -> usize {
        self.faces
    }

    /// How many vertices have a face.
    #[must_use]
    pub fn vertex_count(&self) -> usize {
        self.outgoing.iter().flatten().count()
    }

    /// How many edges there are.
    #[must_use]
    pub fn edge_count(&self) -> usize {
        self.edges().count()
    }

    /// Vertices less edges plus faces: 2 less twice the genus and less the boundary loops, summed over shells.
    #[must_use]
    #[expect(clippy::cast_possible_wrap, reason = "counts are below 2^32")]
    pub fn euler_characteristic(&self) -> i64 {
        self.vertex_count() as i64 - self.edge_count() as i64 + self.face_count() as i64
    }

    /// The faces, in order.
    pub fn faces(&self) -> impl Iterator<Item = FaceId> + '_ {
        (0u32..).zip(self.origin.as_chunks::<3>().0).filter(|(_, o)| o[0].is_some()).map(|(f, _)| FaceId::new(f))
    }

    /// The vertices that have a face, in order.
    pub fn vertices(&self) -> impl Iterator<Item = VertexId> + '_ {
        (0u32..).zip(&self.outgoing).filter(|(_, o)| o.is_some()).map(|(v, _)| VertexId::new(v))
    }

    /// One half-edge of each edge: the smaller.
    pub fn edges(&self) -> impl Iterator<Item = HalfEdgeId> + '_ {
        self.half_edges().filter(|&h| self.twin(h).is_none_or(|t| h < t))
    }

    /// All half-edges, in order.
    pub fn half_edges(&self) -> impl Iterator<Item = HalfEdgeId> + '_ {
        self.faces().flat_map(FaceId::half_edges)
    }

    /// Whether a face is there: neither removed nor beyond the last.
    #[must_use]
    pub fn has_face(&self, f: FaceId) -> bool {
        f.index() < self.source.len() && self.origin[3 * f.index()].is_some()
    }

    /// Whether a vertex is there and has a face.
    #[must_use]
    pub fn has_vertex(&self, v: VertexId) -> bool {
        self.outgoing.get(v.index()).is_some_and(Option::is_some)
    }

    /// Where a half-edge starts.
    ///
    /// # Panics
    /// When its face is not there.
    #[must_use]
    pub fn origin(&self, h: HalfEdgeId) -> VertexId {
        self.origin[h.index()].expect("a half-edge of a face that is there")
    }

    /// Where a half-edge ends.
    ///
    /// # Panics
    /// When its face is not there.
    #[must_use]
    pub fn destination(&self, h: HalfEdgeId) -> VertexId {
        self.origin(h.next())
    }

    /// The other side of the edge; none on the boundary.
    ///
    /// # Panics
    /// When there is no such half-edge.
    #[must_use]
    pub fn twin(&self, h: HalfEdgeId) -> Option<HalfEdgeId> {
        self.twin[h.index()]
    }

    /// The vertices of a face.
    ///
    /// # Panics
    /// When the face is not there.
    #[must_use]
    pub fn corners(&self, f: FaceId) -> [VertexId; 3] {
        f.half_edges().map(|h| self.origin(h))
    }

    /// The position of a vertex.
    ///
    /// # Panics
    /// When there is no such vertex.
    #[must_use]
    pub fn position(&self, v: VertexId) -> DVec3 {
        self.positions[v.index()]
    }

    /// Moves a vertex; the position must be finite.
    ///
    /// # Panics
    /// When there is no such vertex.
    pub fn set_position(&mut self, v: VertexId, position: DVec3) {
        self.positions[v.index()] = position;
    }

    /// The input face that a face is or was cut from, or [`NO_SOURCE`](super::NO_SOURCE).
    ///
    /// # Panics
    /// When there is no such face.
    #[must_use]
    pub fn source(&self, f: FaceId) -> u32 {
        self.source[f.index()]
    }
}
