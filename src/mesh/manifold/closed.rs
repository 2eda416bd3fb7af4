use std::ops::Deref;

use glam::DVec3;

use super::{HalfEdgeMesh, NotManifold, Refused};
use crate::mesh::{HalfEdgeId, Surface, VertexId};

/// The top of the ladder: a [`HalfEdgeMesh`] without boundary, so that every half-edge has a twin and every fan is
/// closed. Its edits keep it closed and keep its Euler characteristic; to open it, take the mesh out.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Manifold(HalfEdgeMesh);

impl Deref for Manifold {
    type Target = HalfEdgeMesh;

    fn deref(&self) -> &HalfEdgeMesh {
        &self.0
    }
}

impl TryFrom<HalfEdgeMesh> for Manifold {
    type Error = NotManifold;

    fn try_from(mesh: HalfEdgeMesh) -> Result<Self, NotManifold> {
        let open = mesh.half_edges().find(|&h| mesh.is_boundary(h));
        match open {
            Some(h) => Err(NotManifold::Open { ends: [mesh.origin(h), mesh.destination(h)], face: h.face() }),
            None => Ok(Self(mesh)),
        }
    }
}

impl TryFrom<&Surface> for Manifold {
    type Error = NotManifold;

    fn try_from(surface: &Surface) -> Result<Self, NotManifold> {
        HalfEdgeMesh::try_from(surface)?.try_into()
    }
}

impl From<Manifold> for HalfEdgeMesh {
    fn from(manifold: Manifold) -> Self {
        manifold.0
    }
}

impl Manifold {
    /// The other side of the edge.
    ///
    /// # Panics
    /// When there is no such half-edge.
    #[must_use]
    pub fn twin(&self, h: HalfEdgeId) -> HalfEdgeId {
        self.0.twin(h).expect("a closed mesh has no half-edge without a twin")
    }

    /// Moves a vertex, as [`HalfEdgeMesh::set_position`] does.
    ///
    /// # Panics
    /// When there is no such vertex.
    pub fn set_position(&mut self, v: VertexId, position: DVec3) {
        self.0.set_position(v, position);
    }

    /// Turns an edge, as [`HalfEdgeMesh::flip_edge`] does.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn flip_edge(&mut self, h: HalfEdgeId) -> Result<(), Refused> {
        self.0.flip_edge(h)
    }

    /// Puts a vertex on an edge, as [`HalfEdgeMesh::split_edge`] does.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn split_edge(&mut self, h: HalfEdgeId, position: DVec3) -> Result<VertexId, Refused> {
        self.0.split_edge(h, position)
    }

    /// Draws an edge together, as [`HalfEdgeMesh::collapse_edge`] does.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn collapse_edge(&mut self, h: HalfEdgeId) -> Result<VertexId, Refused> {
        self.0.collapse_edge(h)
    }

    /// Parts a vertex in two, as [`HalfEdgeMesh::split_vertex`] does.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn split_vertex(&mut self, first: HalfEdgeId, last: HalfEdgeId, position: DVec3) -> Result<VertexId, Refused> {
        self.0.split_vertex(first, last, position)
    }

    /// Whether the type's promises hold; for tests.
    ///
    /// # Errors
    /// The first promise that is broken, in words.
    pub fn check(&self) -> Result<(), String> {
        self.0.check()?;
        match self.half_edges().find(|&h| self.is_boundary(h)) {
            Some(h) => Err(format!("{h} has no twin in a closed mesh")),
            None => Ok(()),
        }
    }
}
