use glam::DVec3;

/// Triangles as a file gives them. They promise only that face indices are in range.
///
/// Positions may be non-finite or repeated, faces may be degenerate, duplicated, flipped or intersecting.
/// Readers make a soup and writers take it; operators work on types with stronger guarantees.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Soup {
    /// Vertex positions, in the file's own unit.
    pub positions: Vec<DVec3>,
    /// Triangles as indices into `positions`, counter-clockwise seen from outside where the file is well oriented.
    pub faces: Vec<[u32; 3]>,
}

impl Soup {
    /// The corner positions of face `face`.
    ///
    /// # Panics
    /// When `face` is not an index of `faces`.
    #[must_use]
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.positions[v as usize])
    }
}

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
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Numbering {
    /// Whether vertices are numbered 1, 2, 3 and so on, in the order of the file.
    pub vertices_contiguous: bool,
    /// Whether faces are numbered 1, 2, 3 and so on, in the order of the file.
    pub faces_contiguous: bool,
    /// Vertex numbers that a face names and that do not exist, each counted once.
    pub missing_vertices: u64,
    /// Faces that name such a vertex; they are not in the soup.
    pub faces_without_vertex: u64,
    /// The first of those faces, in the order of the file.
    pub omitted: Vec<LeftOutFace>,
    /// The first of the missing vertex numbers, ascending.
    pub missing: Vec<u32>,
    /// The number of each vertex of the soup; empty where they are 1, 2, 3 and so on.
    pub vertex_numbers: Vec<u32>,
    /// The number of each face of the soup; empty where they are 1, 2, 3 and so on.
    pub face_numbers: Vec<u32>,
}

/// A face that names a vertex which the file does not give.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct LeftOutFace {
    /// Its number in the file.
    pub number: u32,
    /// The middle of its corners that are given; of a face without any, that of the face before it.
    pub at: [f64; 3],
}

impl Numbering {
    /// The file's number of a face of the soup.
    #[must_use]
    pub fn face(&self, index: u32) -> u32 {
        self.face_numbers.get(index as usize).copied().unwrap_or(index.saturating_add(1))
    }

    /// The file's number of a vertex of the soup.
    #[must_use]
    pub fn vertex(&self, index: u32) -> u32 {
        self.vertex_numbers.get(index as usize).copied().unwrap_or(index.saturating_add(1))
    }
}
