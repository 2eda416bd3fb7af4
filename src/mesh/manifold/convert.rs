use super::HalfEdgeMesh;
use crate::mesh::{Edges, FaceId, HalfEdgeId, Surface, VertexId};

/// Why a surface is not a manifold: the first thing that is in the way. Faces are looked at first, then edges, then
/// vertices, each in order.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum NotManifold {
    /// A face has a vertex twice, or names one that is not there.
    #[error("{face} is no triangle between three vertices")]
    BadFace {
        /// The face.
        face: FaceId,
    },
    /// An edge has more than two faces.
    #[error("the edge from {} to {} has {faces} faces; the first is {face}", ends[0], ends[1])]
    ManyFaces {
        /// Its vertices.
        ends: [VertexId; 2],
        /// How many faces it has.
        faces: u32,
        /// The first of them.
        face: FaceId,
    },
    /// Two faces run along their edge in the same direction.
    #[error("{} and {} run along the edge from {} to {} in the same direction", faces[0], faces[1], ends[0], ends[1])]
    SameDirection {
        /// The edge's vertices.
        ends: [VertexId; 2],
        /// The faces.
        faces: [FaceId; 2],
    },
    /// The faces at a vertex form more than one fan.
    #[error("the faces at {vertex} form more than one fan")]
    ManyFans {
        /// The vertex.
        vertex: VertexId,
    },
    /// An edge has one face, where a closed mesh was asked for.
    #[error("the edge from {} to {} has no other face than {face}", ends[0], ends[1])]
    Open {
        /// Its vertices.
        ends: [VertexId; 2],
        /// Its face.
        face: FaceId,
    },
}

impl TryFrom<&Surface> for HalfEdgeMesh {
    type Error = NotManifold;

    /// O(n log d) for vertices of at most `d` faces. Handles are the indices of the surface.
    fn try_from(surface: &Surface) -> Result<Self, NotManifold> {
        let known = surface.positions.len();
        for (&[a, b, c], f) in surface.faces.iter().zip(0u32..) {
            if a == b || b == c || c == a || [a, b, c].iter().any(|&v| v as usize >= known) {
                return Err(NotManifold::BadFace { face: FaceId::new(f) });
            }
        }
        let mut mesh = Self {
            origin: surface.faces.iter().flatten().map(|&v| Some(VertexId::new(v))).collect(),
            twin: vec![None; surface.faces.len() * 3],
            outgoing: vec![None; known],
            positions: surface.positions.clone(),
            source: surface.source.clone(),
            faces: surface.faces.len(),
        };
        mesh.link_twins(&surface.faces)?;
        for (at, h) in (0u32..).map(HalfEdgeId::new).enumerate().take(mesh.origin.len()) {
            let outgoing = &mut mesh.outgoing[surface.faces[at / 3][at % 3] as usize];
            if outgoing.is_none() || mesh.twin[at].is_none() {
                *outgoing = Some(h);
            }
        }
        let mut corners = vec![0usize; known];
        for &v in surface.faces.iter().flatten() {
            corners[v as usize] += 1;
        }
        let pinched = mesh.vertices().find(|&v| mesh.around(v).count() != corners[v.index()]);
        match pinched {
            Some(vertex) => Err(NotManifold::ManyFans { vertex }),
            None => Ok(mesh),
        }
    }
}

impl HalfEdgeMesh {
    fn link_twins(&mut self, faces: &[[u32; 3]]) -> Result<(), NotManifold> {
        let edges = Edges::new(faces);
        for (e, half_edges) in edges.iter().enumerate() {
            let ends = || edges.vertices(e).map(VertexId::new);
            match *half_edges {
                [_] => {}
                [h, t] => {
                    let [h, t] = [HalfEdgeId::new(h), HalfEdgeId::new(t)];
                    if self.origin(h) == self.origin(t) {
                        return Err(NotManifold::SameDirection { ends: ends(), faces: [h.face(), t.face()] });
                    }
                    self.join(h, t);
                }
                _ => {
                    #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
                    let faces = half_edges.len() as u32;
                    let face = HalfEdgeId::new(half_edges[0]).face();
                    return Err(NotManifold::ManyFaces { ends: ends(), faces, face });
                }
            }
        }
        Ok(())
    }

    /// The mesh as a surface: its faces in order, its vertices in the order of their first use.
    #[must_use]
    pub fn to_surface(&self) -> Surface {
        let mut surface = Surface {
            positions: self.positions.clone(),
            faces: self.faces().map(|f| self.corners(f).map(VertexId::raw)).collect(),
            source: self.faces().map(|f| self.source(f)).collect(),
        };
        surface.drop_unreferenced();
        surface
    }
}
