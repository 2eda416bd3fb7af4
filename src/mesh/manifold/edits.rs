//! Local edits. Each says what it asks for, and refuses without having changed anything where that does not hold.

use glam::DVec3;

use super::HalfEdgeMesh;
use crate::mesh::{FaceId, HalfEdgeId, NO_SOURCE, VertexId};

/// Why an edit was not made.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum Refused {
    /// The face, half-edge or vertex is not there.
    #[error("there is no such element")]
    Missing,
    /// The edge has one face, and the edit asks for two.
    #[error("the edge is on the boundary")]
    Boundary,
    /// Two edges would join the same vertices, or two faces would have the same three.
    #[error("an edge or face would be there twice")]
    Doubled,
    /// The vertex would have two fans.
    #[error("the faces at {0} would form more than one fan")]
    Pinched(VertexId),
    /// The edge would have three faces, or two in the same direction.
    #[error("the edge from {0} to {1} has no room for the face")]
    Occupied(VertexId, VertexId),
    /// A face needs three different vertices.
    #[error("the face has {0} twice")]
    Repeated(VertexId),
}

impl HalfEdgeMesh {
    /// Turns the edge between two faces to join their other two vertices.
    ///
    /// ```text
    ///      c              c
    ///    /   \          / ^ \
    ///   a --h-> b  =>  a  h  b      asks for: two faces, and no edge from c to d yet
    ///    \   /          \ | /       changes nothing else: all counts stay
    ///      d              d
    /// ```
    ///
    /// The faces and this edge keep their handles; the four half-edges around trade theirs.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn flip_edge(&mut self, h: HalfEdgeId) -> Result<(), Refused> {
        let h = self.present(h).ok_or(Refused::Missing)?;
        let t = self.twin(h).ok_or(Refused::Boundary)?;
        let (a, b) = (self.origin(h), self.origin(t));
        let (c, d) = (self.origin(h.prev()), self.origin(t.prev()));
        if c == d || self.are_neighbours(c, d) {
            return Err(Refused::Doubled);
        }
        let [from_b, from_c, from_a, from_d] = [h.next(), h.prev(), t.next(), t.prev()].map(|around| self.twin(around));
        self.set_corners(h, [d, c, a]);
        self.set_corners(t, [c, d, b]);
        for (inner, outer) in [(h.next(), from_c), (h.prev(), from_a), (t.next(), from_d), (t.prev(), from_b)] {
            self.link(inner, outer);
        }
        for leaving in [h, t, h.prev(), t.prev()] {
            self.settle(leaving);
        }
        Ok(())
    }

    /// Puts a new vertex on an edge and cuts its faces in two there.
    ///
    /// ```text
    ///      c              c
    ///    /   \          / | \
    ///   a --h-> b  =>  a-h>m-> b    asks for: two vertices opposite the edge that differ
    ///    \   /          \ | /       adds one vertex, and one face for each face of the edge
    ///      d              d
    /// ```
    ///
    /// All handles stay; `h` then runs from `a` to the new vertex. New faces have the sources of the old.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn split_edge(&mut self, h: HalfEdgeId, position: DVec3) -> Result<VertexId, Refused> {
        let h = self.present(h).ok_or(Refused::Missing)?;
        let twin = self.twin(h);
        if twin.is_some_and(|t| self.origin(t.prev()) == self.origin(h.prev())) {
            return Err(Refused::Doubled);
        }
        let m = self.add_vertex(position);
        // The half of each face that lies at b: along h it is cut off at the end, along the twin at the beginning.
        let (b, c, from_b) = (self.destination(h), self.origin(h.prev()), self.twin(h.next()));
        let beyond = self.push_face([m, b, c], self.source(h.face()));
        self.origin[h.next().index()] = Some(m);
        self.link(beyond.next(), from_b);
        self.link(beyond.prev(), Some(h.next()));
        if let Some(t) = twin {
            let (d, from_d) = (self.origin(t.prev()), self.twin(t.prev()));
            let before = self.push_face([b, m, d], self.source(t.face()));
            self.origin[t.index()] = Some(m);
            self.link(before.prev(), from_d);
            self.link(before.next(), Some(t.prev()));
            self.link(before, Some(beyond));
            self.settle(before.prev());
        }
        for leaving in [h, beyond, beyond.next(), beyond.prev()] {
            self.settle(leaving);
        }
        Ok(m)
    }

    /// Draws an edge together: its origin moves into its destination, its faces go.
    ///
    /// ```text
    ///       c              c
    ///     /   \            |        asks for the link condition (Dey, Edelsbrunner, Guha and Nekhayev 1999): a and b
    ///   --a-h->b--  =>   --b--      have no neighbours in common but those opposite the edge, they are not both on
    ///     \   /            |        the boundary unless the edge is, and something is left
    ///       d              d        takes away one vertex, and one face for each face of the edge
    /// ```
    ///
    /// Answers the vertex that stays, where it was. Other handles stay.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn collapse_edge(&mut self, h: HalfEdgeId) -> Result<VertexId, Refused> {
        let h = self.present(h).ok_or(Refused::Missing)?;
        self.collapse(h, self.origin(h), self.destination(h))
    }

    /// Draws an edge together into either of its ends.
    pub(super) fn collapse(&mut self, h: HalfEdgeId, a: VertexId, b: VertexId) -> Result<VertexId, Refused> {
        self.check_link_condition(h)?;
        let leaving_a: Vec<HalfEdgeId> = self.around(a).collect();
        for g in leaving_a {
            self.origin[g.index()] = Some(b);
        }
        self.outgoing[a.index()] = None;
        let outer = [Some(h), self.twin(h)]
            .map(|side| side.map(|side| (side.face(), [self.twin(side.next()), self.twin(side.prev())])));
        for (face, [one, other]) in outer.into_iter().flatten() {
            self.erase(face);
            for (x, y) in [(one, other), (other, one)] {
                if let Some(x) = x {
                    self.twin[x.index()] = y;
                }
            }
        }
        // Only now does every walk end.
        for x in outer.into_iter().flatten().flat_map(|(_, around)| around).flatten() {
            self.settle(x);
            self.settle(x.next());
        }
        Ok(b)
    }

    /// Parts a vertex in two: the faces counter-clockwise from `first` to `last`, two half-edges that leave it, go to a
    /// new vertex, and two faces close the gap. [`HalfEdgeMesh::collapse_edge`] from the new vertex to the old undoes it,
    /// but where two faces lay on one another.
    ///
    /// ```text
    ///        d                 d
    ///        | last          /   \         asks for: two half-edges that leave the same vertex and have
    ///   ---- v ----   =>  --v --- a--      twins, and no boundary between them
    ///        | first         \   /         adds one vertex and two faces, which have no source
    ///        c                 c
    /// ```
    ///
    /// All handles stay; `first` then leaves the new vertex, `last` still the old.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn split_vertex(&mut self, first: HalfEdgeId, last: HalfEdgeId, position: DVec3) -> Result<VertexId, Refused> {
        let [first, last] = [self.present(first).ok_or(Refused::Missing)?, self.present(last).ok_or(Refused::Missing)?];
        let v = self.origin(first);
        if first == last || self.origin(last) != v {
            return Err(Refused::Repeated(v));
        }
        let (Some(to_first), Some(to_last)) = (self.twin(first), self.twin(last)) else {
            return Err(Refused::Boundary);
        };
        let moved = std::iter::successors(Some(first), |&h| self.twin(h.prev()).filter(|&next| next != last));
        let moved: Vec<HalfEdgeId> = moved.collect();
        if moved.last().is_none_or(|h| h.prev() != to_last) {
            return Err(Refused::Boundary);
        }
        let (c, d) = (self.destination(first), self.destination(last));
        let a = self.add_vertex(position);
        for h in moved {
            self.origin[h.index()] = Some(a);
        }
        let (at_c, at_d) = (self.push_face([v, c, a], NO_SOURCE), self.push_face([a, d, v], NO_SOURCE));
        self.join(at_c, to_first);
        self.join(at_c.next(), first);
        self.join(at_d, to_last);
        self.join(at_d.next(), last);
        self.join(at_c.prev(), at_d.prev());
        for leaving in [at_c, at_c.next(), at_c.prev(), at_d.next()] {
            self.settle(leaving);
        }
        Ok(a)
    }

    /// The link of the edge is all that the links of its ends have in common, boundary edges taken as faces to one
    /// more vertex.
    fn check_link_condition(&self, h: HalfEdgeId) -> Result<(), Refused> {
        let (a, b) = (self.origin(h), self.destination(h));
        let opposite = [Some(h), self.twin(h)].map(|side| side.map(|s| self.origin(s.prev())));
        let mut of_a: Vec<VertexId> = self.neighbours(a).collect();
        of_a.sort_unstable();
        let common = self.neighbours(b).filter(|v| of_a.binary_search(v).is_ok()).count();
        if common != opposite.iter().flatten().count() {
            return Err(Refused::Doubled);
        }
        if !self.is_boundary(h) && self.is_boundary_vertex(a) && self.is_boundary_vertex(b) {
            return Err(Refused::Pinched(b));
        }
        // Now an edge that both links have, and that of h has not, is the far edge of a tetrahedron or of a triangle.
        let nothing_left = match opposite {
            [Some(c), Some(d)] => c == d || [a, b].iter().all(|&v| self.around(v).any(|g| self.is_face(g, [v, c, d]))),
            _ => self.is_boundary(h.next()) && self.is_boundary(h.prev()),
        };
        if nothing_left { Err(Refused::Doubled) } else { Ok(()) }
    }

    /// Whether the face along a half-edge has these vertices, in any order.
    fn is_face(&self, h: HalfEdgeId, vertices: [VertexId; 3]) -> bool {
        self.corners(h.face()).iter().all(|v| vertices.contains(v))
    }

    /// Takes a face away.
    ///
    /// Asks that no corner lies within an open fan, which would fall in two. Takes away the vertices that it alone
    /// had. Other handles stay.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn remove_face(&mut self, f: FaceId) -> Result<(), Refused> {
        if !self.has_face(f) {
            return Err(Refused::Missing);
        }
        for h in f.half_edges() {
            if self.is_boundary_vertex(self.origin(h)) && !self.is_boundary(h) && !self.is_boundary(h.prev()) {
                return Err(Refused::Pinched(self.origin(h)));
            }
        }
        let corners = self.corners(f);
        let twins = f.half_edges().map(|h| self.twin(h));
        for v in corners {
            // A half-edge of another face that leaves the vertex, if there is one.
            let other = self.around(v).find(|h| h.face() != f);
            self.outgoing[v.index()] = other;
        }
        self.erase(f);
        for t in twins.into_iter().flatten() {
            self.twin[t.index()] = None;
        }
        for v in corners {
            if let Some(leaving) = self.outgoing[v.index()] {
                self.settle(leaving);
            }
        }
        Ok(())
    }

    /// Adds a face between three vertices, counter-clockwise seen from outside.
    ///
    /// Asks that the vertices differ and are there, with or without faces; that each of its edges is new or on the
    /// boundary and runs the other way there; and that it continues the fan of each vertex that has one.
    ///
    /// # Errors
    /// [`Refused`], and nothing was changed.
    pub fn add_face(&mut self, vertices: [VertexId; 3], source: u32) -> Result<FaceId, Refused> {
        let [a, b, c] = vertices;
        if let Some(twice) = [(a, b), (b, c), (c, a)].into_iter().find(|(p, q)| p == q) {
            return Err(Refused::Repeated(twice.0));
        }
        if vertices.iter().any(|v| v.index() >= self.outgoing.len()) {
            return Err(Refused::Missing);
        }
        let mut twins = [None; 3];
        for (twin, (p, q)) in twins.iter_mut().zip([(a, b), (b, c), (c, a)]) {
            *twin = self.find(q, p);
            if self.find(p, q).is_some() || twin.is_some_and(|t| !self.is_boundary(t)) {
                return Err(Refused::Occupied(p, q));
            }
        }
        for (at, &v) in vertices.iter().enumerate() {
            if self.has_vertex(v) && twins[at].is_none() && twins[(at + 2) % 3].is_none() {
                return Err(Refused::Pinched(v));
            }
        }
        let first = self.push_face(vertices, source);
        for (h, twin) in first.face().half_edges().into_iter().zip(twins) {
            self.link(h, twin);
        }
        for h in first.face().half_edges() {
            self.settle(h);
        }
        Ok(first.face())
    }

    /// Adds a vertex, which is part of the mesh when it has a face; the position must be finite.
    pub fn add_vertex(&mut self, position: DVec3) -> VertexId {
        #[expect(clippy::cast_possible_truncation, reason = "vertices are counted in u32")]
        let v = VertexId::new(self.positions.len() as u32);
        self.positions.push(position);
        self.outgoing.push(None);
        v
    }

    /// A face that has no twins yet; answers the half-edge that leaves its first vertex.
    fn push_face(&mut self, vertices: [VertexId; 3], source: u32) -> HalfEdgeId {
        #[expect(clippy::cast_possible_truncation, reason = "half-edges are counted in u32")]
        let first = HalfEdgeId::new(self.origin.len() as u32);
        self.origin.extend(vertices.map(Some));
        self.twin.extend([None; 3]);
        self.source.push(source);
        self.faces += 1;
        first
    }

    fn erase(&mut self, f: FaceId) {
        for h in f.half_edges() {
            self.origin[h.index()] = None;
            self.twin[h.index()] = None;
        }
        self.faces -= 1;
    }

    fn set_corners(&mut self, h: HalfEdgeId, vertices: [VertexId; 3]) {
        for (at, v) in [h, h.next(), h.prev()].into_iter().zip(vertices) {
            self.origin[at.index()] = Some(v);
        }
    }

    /// Makes two half-edges twins.
    pub(super) fn join(&mut self, h: HalfEdgeId, t: HalfEdgeId) {
        self.twin[h.index()] = Some(t);
        self.twin[t.index()] = Some(h);
    }

    fn link(&mut self, h: HalfEdgeId, twin: Option<HalfEdgeId>) {
        match twin {
            Some(t) => self.join(h, t),
            None => self.twin[h.index()] = None,
        }
    }

    /// Has the vertex that a half-edge leaves know the first half-edge of its fan: clockwise to the boundary, or this
    /// one.
    pub(super) fn settle(&mut self, leaving: HalfEdgeId) {
        let mut first = leaving;
        while let Some(t) = self.twin(first) {
            first = t.next();
            if first == leaving {
                break;
            }
        }
        let v = self.origin(leaving);
        self.outgoing[v.index()] = Some(first);
    }
}
