use super::HalfEdgeMesh;
use crate::mesh::{HalfEdgeId, Parts, UnionFind, VertexId};

impl HalfEdgeMesh {
    /// The half-edges that leave a vertex, counter-clockwise; on the boundary from the one without a twin on.
    pub fn around(&self, v: VertexId) -> impl Iterator<Item = HalfEdgeId> + '_ {
        let first = self.outgoing.get(v.index()).copied().flatten();
        std::iter::successors(first, move |h| self.twin(h.prev()).filter(|&next| Some(next) != first))
    }

    /// The vertices that share an edge with a vertex, counter-clockwise.
    pub fn neighbours(&self, v: VertexId) -> impl Iterator<Item = VertexId> + '_ {
        self.around(v).flat_map(|h| {
            let last = self.twin(h.prev()).is_none().then(|| self.origin(h.prev()));
            [Some(self.destination(h)), last].into_iter().flatten()
        })
    }

    /// Whether a half-edge has no twin.
    ///
    /// # Panics
    /// When there is no such half-edge.
    #[must_use]
    pub fn is_boundary(&self, h: HalfEdgeId) -> bool {
        self.twin(h).is_none()
    }

    /// Whether a vertex has an edge with one face.
    #[must_use]
    pub fn is_boundary_vertex(&self, v: VertexId) -> bool {
        self.outgoing.get(v.index()).copied().flatten().is_some_and(|h| self.is_boundary(h))
    }

    /// The half-edge from one vertex to another. O(d) for a vertex of `d` faces.
    #[must_use]
    pub fn find(&self, from: VertexId, to: VertexId) -> Option<HalfEdgeId> {
        self.around(from).find(|&h| self.destination(h) == to)
    }

    /// Whether two vertices share an edge.
    #[must_use]
    pub fn are_neighbours(&self, a: VertexId, b: VertexId) -> bool {
        self.neighbours(a).any(|v| v == b)
    }

    /// The half-edge that follows another along the boundary: the one without a twin that leaves where this one ends.
    /// None for a half-edge that has a twin.
    ///
    /// # Panics
    /// When its face is not there.
    #[must_use]
    pub fn next_on_boundary(&self, h: HalfEdgeId) -> Option<HalfEdgeId> {
        if self.is_boundary(h) { self.outgoing[self.destination(h).index()] } else { None }
    }

    /// The boundary as closed loops of half-edges, each from its smallest on and along the faces, so that the hole is
    /// on the right; in the order of their smallest half-edges. No loop passes a vertex twice, since its faces
    /// form one fan.
    #[must_use]
    pub fn boundary_loops(&self) -> Vec<Vec<HalfEdgeId>> {
        let mut seen = vec![false; self.twin.len()];
        let mut loops = Vec::new();
        for start in self.half_edges().filter(|&h| self.is_boundary(h)) {
            if seen[start.index()] {
                continue;
            }
            let walk = std::iter::successors(Some(start), |&h| self.next_on_boundary(h).filter(|&next| next != start));
            let walk: Vec<HalfEdgeId> = walk.collect();
            for h in &walk {
                seen[h.index()] = true;
            }
            loops.push(walk);
        }
        loops
    }

    /// The shells: faces that a chain of shared edges joins. Faces that were removed belong to none.
    #[must_use]
    pub fn shells(&self) -> Parts {
        let mut sets = UnionFind::new(self.source.len());
        for h in self.edges() {
            if let Some(t) = self.twin(h) {
                sets.unite(h.face().raw(), t.face().raw());
            }
        }
        Parts::numbered(sets, |f| self.origin[3 * f].is_some())
    }
}
