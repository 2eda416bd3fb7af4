use super::HalfEdgeMesh;
use crate::mesh::{Edges, FaceId, HalfEdgeId};

impl HalfEdgeMesh {
    /// Whether the type's promises hold, found anew from the faces alone; for tests, after every edit.
    ///
    /// # Errors
    /// The first promise that is broken, in words.
    pub fn check(&self) -> Result<(), String> {
        self.check_sizes()?;
        self.check_faces()?;
        self.check_twins()?;
        self.check_fans()
    }

    fn check_sizes(&self) -> Result<(), String> {
        let slots = self.source.len();
        if self.origin.len() != 3 * slots || self.twin.len() != 3 * slots {
            return Err(format!("{} origins, {} twins for {slots} faces", self.origin.len(), self.twin.len()));
        }
        if self.positions.len() != self.outgoing.len() {
            return Err(format!("{} positions for {} vertices", self.positions.len(), self.outgoing.len()));
        }
        if let Some(p) = self.positions.iter().find(|p| !p.is_finite()) {
            return Err(format!("position {p} is not finite"));
        }
        let counted = self.faces().count();
        if counted == self.faces { Ok(()) } else { Err(format!("{counted} faces where {} are known", self.faces)) }
    }

    fn check_faces(&self) -> Result<(), String> {
        for (f, origins) in (0u32..).map(FaceId::new).zip(self.origin.as_chunks::<3>().0) {
            match *origins {
                [None, None, None] => {
                    if f.half_edges().iter().any(|&h| self.twin(h).is_some()) {
                        return Err(format!("{f} was removed and has twins"));
                    }
                }
                [Some(a), Some(b), Some(c)] => {
                    if a == b || b == c || c == a {
                        return Err(format!("{f} has a vertex twice"));
                    }
                    if let Some(v) = [a, b, c].into_iter().find(|&v| !self.has_vertex(v)) {
                        return Err(format!("{f} has {v}, which knows of no face"));
                    }
                }
                _ => return Err(format!("{f} is removed in part")),
            }
        }
        Ok(())
    }

    /// Twins are what the edges of the faces say, of which none has more than two faces.
    fn check_twins(&self) -> Result<(), String> {
        let ids: Vec<FaceId> = self.faces().collect();
        let faces: Vec<[u32; 3]> = ids.iter().map(|&f| self.corners(f).map(|v| v.raw())).collect();
        let edges = Edges::new(&faces);
        let here = |h: u32| ids[h as usize / 3].half_edges()[h as usize % 3];
        for (e, half_edges) in edges.iter().enumerate() {
            let [a, b] = edges.vertices(e);
            match *half_edges {
                [h] if self.twin(here(h)).is_none() => {}
                [h, t] => {
                    let (h, t) = (here(h), here(t));
                    if (self.twin(h), self.twin(t)) != (Some(t), Some(h)) {
                        return Err(format!("{h} and {t} share the edge {a} {b} and are not twins"));
                    }
                    if self.origin(h) != self.destination(t) {
                        return Err(format!("{h} and {t} run in the same direction"));
                    }
                }
                [h] => return Err(format!("{} has a twin that does not share its edge", here(h))),
                _ => return Err(format!("the edge {a} {b} has {} faces", half_edges.len())),
            }
        }
        Ok(())
    }

    /// The walk around each vertex begins on the boundary if there is one, and meets every face at the vertex.
    fn check_fans(&self) -> Result<(), String> {
        let mut corners = vec![0usize; self.outgoing.len()];
        let mut on_boundary = vec![false; self.outgoing.len()];
        for h in self.half_edges() {
            corners[self.origin(h).index()] += 1;
            on_boundary[self.origin(h).index()] |= self.is_boundary(h);
        }
        for (v, outgoing) in self.outgoing.iter().enumerate() {
            let Some(first) = *outgoing else {
                if corners[v] > 0 {
                    return Err(format!("vertex {v} has faces and knows of none"));
                }
                continue;
            };
            if first.index() >= self.origin.len() || self.origin[first.index()].map(|o| o.index()) != Some(v) {
                return Err(format!("{first} does not leave vertex {v}"));
            }
            if on_boundary[v] != self.is_boundary(first) {
                return Err(format!("the walk around vertex {v} does not begin on the boundary"));
            }
            let met = self.around(self.origin(first)).take(corners[v] + 1).count();
            if met != corners[v] {
                return Err(format!("the walk around vertex {v} meets {met} of {} faces", corners[v]));
            }
        }
        Ok(())
    }

    /// The half-edge, if its face is there.
    pub(super) fn present(&self, h: HalfEdgeId) -> Option<HalfEdgeId> {
        self.has_face(h.face()).then_some(h)
    }
}
