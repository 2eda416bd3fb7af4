/// Normals that a file gives, as it gives them. They need not have unit length; one that is zero or not finite is none.
#[derive(Debug, Clone, PartialEq)]
pub enum CornerNormals {
    /// One for each vertex of the soup.
    OfVertices(Vec<[f32; 3]>),
    /// A list, and for each face of the soup the places in it of its corners' normals.
    OfCorners {
        /// The normals.
        normals: Vec<[f32; 3]>,
        /// Places in `normals`; one that is out of range is none.
        faces: Vec<[u32; 3]>,
    },
    /// One for each face. Only those are kept that are opposed to their face as its corners turn: there are hardly ever
    /// any, and the others say nothing that the corners don't.
    OfFaces {
        /// Faces of the soup with their normals, ascending.
        opposed: Vec<(u32, [f32; 3])>,
    },
}

impl CornerNormals {
    /// The normal at corner `k` (0 to 2) of a face of the soup with these vertices.
    ///
    /// # Panics
    /// When `k` is more than 2.
    #[must_use]
    pub fn at(&self, face: usize, vertices: [u32; 3], k: usize) -> Option<[f32; 3]> {
        let found = match self {
            Self::OfVertices(normals) => normals.get(vertices[k] as usize),
            Self::OfCorners { normals, faces } => faces.get(face).and_then(|corners| normals.get(corners[k] as usize)),
            Self::OfFaces { opposed } => {
                let at = opposed.binary_search_by(|(f, _)| (*f as usize).cmp(&face)).ok();
                at.map(|at| &opposed[at].1)
            }
        };
        found.copied().filter(|n| n.iter().all(|x| x.is_finite()) && *n != [0.0; 3])
    }
}

/// What a file with explicit numbers says of its vertices and faces.
#[derive(Debug, Clone, Copy, Default, PartialEq, Eq)]
pub struct Numbering {
    /// Whether vertices are numbered 1, 2, 3 and so on, in the order of the file.
    pub vertices_contiguous: bool,
    /// Whether faces are numbered 1, 2, 3 and so on, in the order of the file.
    pub faces_contiguous: bool,
    /// Vertex numbers that a face names and that do not exist, each counted once.
    pub missing_vertices: u64,
    /// Faces that name such a vertex; they are not in the soup.
    pub faces_without_vertex: u64,
}
