use super::{HalfEdgeMesh, Refused};
use crate::mesh::{HalfEdgeId, VertexId};

impl HalfEdgeMesh {
    /// Moves a boundary vertex into another: the collapse of a vertex into any vertex, with or without an edge between
    /// them. Faces are re-indexed where they are, and the boundary edges that then join the same vertices become one.
    ///
    /// ```text
    ///       c                c
    ///     /   \              |        asks for: no edge from a to b, else this is `collapse_edge`;
    ///   -a     b-   =>      -b-       boundary edges of both that lead to the same vertex on opposite sides of the hole,
    ///     \   /              |        and no other neighbour in common
    ///       d                d        takes away one vertex, and one edge for each pair
    /// ```
    ///
    /// Without such a pair `b` would have two fans; closing a longer crack begins at one of its ends, or
    /// where one fan to a vertex is not promised. Answers the vertex that stays, where it was. Other handles stay.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn merge_vertices(&mut self, from: VertexId, to: VertexId) -> Result<VertexId, Refused> {
        if !self.has_vertex(from) || !self.has_vertex(to) {
            return Err(Refused::Missing);
        }
        if from == to {
            return Err(Refused::Repeated(to));
        }
        if let Some(joined) = self.find(from, to).or_else(|| self.find(to, from)) {
            return self.collapse(joined, from, to);
        }
        let (Some([out, into]), Some([out_there, into_there])) = (self.open_edges(from), self.open_edges(to)) else {
            return Err(Refused::Pinched(to));
        };
        // Along the hole, what leaves one vertex lies opposite what comes to the other.
        let ahead = (self.destination(out) == self.origin(into_there)).then_some((out, into_there));
        let behind = (self.origin(into) == self.destination(out_there)).then_some((into, out_there));
        let mut of_from: Vec<VertexId> = self.neighbours(from).collect();
        of_from.sort_unstable();
        let shared = self.neighbours(to).filter(|v| of_from.binary_search(v).is_ok());
        let across = [ahead.map(|(h, _)| self.destination(h)), behind.map(|(h, _)| self.origin(h))];
        if let Some(v) = shared.into_iter().find(|v| !across.contains(&Some(*v))) {
            return Err(Refused::Occupied(to, v));
        }
        if ahead.is_none() && behind.is_none() {
            return Err(Refused::Pinched(to));
        }
        let leaving: Vec<HalfEdgeId> = self.around(from).collect();
        for h in leaving {
            self.origin[h.index()] = Some(to);
        }
        self.outgoing[from.index()] = None;
        for (h, t) in [ahead, behind].into_iter().flatten() {
            self.join(h, t);
        }
        for (h, t) in [ahead, behind].into_iter().flatten() {
            self.settle(h);
            self.settle(t);
        }
        Ok(to)
    }

    /// The half-edges without a twin that leave a vertex and come to it; none within the surface.
    fn open_edges(&self, v: VertexId) -> Option<[HalfEdgeId; 2]> {
        let out = self.around(v).next().filter(|&h| self.is_boundary(h))?;
        Some([out, self.around(v).last()?.prev()])
    }
}
