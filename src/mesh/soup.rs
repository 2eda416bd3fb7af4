//! Triangles, normals and numbering as a file gives them, before any cleanup.

use glam::DVec3;

/// Triangles as a file gives them. The only guarantee is that face indices are in range.
///
/// Positions may be non-finite or repeated; faces may be degenerate, duplicated, flipped or intersecting. Readers
/// produce a soup and writers consume one; operators work on types with stronger guarantees.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Soup {
    /// Vertex positions, in the file's own unit.
    pub positions: Vec<DVec3>,
    /// Triangles as indices into `positions`, counter-clockwise seen from outside if the file is well oriented.
    pub faces: Vec<[u32; 3]>,
}

impl Soup {
    /// The corner positions of face `face`.
    ///
    /// # Panics
    /// If `face` is not an index of `faces`.
    #[must_use]
    pub fn corners(&self, face: usize) -> [DVec3; 3] {
        self.faces[face].map(|v| self.positions[v as usize])
    }
}

/// Normals as a file gives them. They need not have unit length; a normal that is zero or not finite counts as absent.
#[derive(Debug, Clone, PartialEq)]
pub enum CornerNormals {
    /// One normal for each vertex of the soup.
    OfVertices(Vec<[f32; 3]>),
    /// A list of normals, and for each face of the soup the indices of its corners' normals.
    OfCorners {
        /// The normals.
        normals: Vec<[f32; 3]>,
        /// Indices into `normals`; an index out of range means no normal.
        faces: Vec<[u32; 3]>,
    },
    /// One normal for each face. Only normals opposed to the orientation of their face's corners are stored: they are
    /// rare, and all others carry no further information.
    OfFaces {
        /// Faces of the soup with their opposed normals, in ascending order.
        opposed: Vec<(u32, [f32; 3])>,
    },
}

impl CornerNormals {
    /// The normal at corner `k` (0 to 2) of a face of the soup with these vertices, if the file gives a usable one.
    ///
    /// # Panics
    /// If `k` is more than 2.
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

/// The explicit vertex and face numbers of a file, and the faults in them.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct Numbering {
    /// Whether vertices are numbered 1, 2, 3, ... in the order of the file.
    pub vertices_contiguous: bool,
    /// Whether faces are numbered 1, 2, 3, ... in the order of the file.
    pub faces_contiguous: bool,
    /// Vertex numbers that faces reference but the file does not define, each counted once.
    pub missing_vertices: u64,
    /// Faces that reference an undefined vertex; the soup does not contain them.
    pub faces_without_vertex: u64,
    /// The first of those faces, in the order of the file.
    pub omitted: Vec<OmittedFace>,
    /// The first of the undefined vertex numbers, in ascending order.
    pub missing: Vec<u32>,
    /// The number of each vertex of the soup; empty if the numbers are 1, 2, 3, ...
    pub vertex_numbers: Vec<u32>,
    /// The number of each face of the soup; empty if the numbers are 1, 2, 3, ...
    pub face_numbers: Vec<u32>,
}

/// A face that references a vertex which the file does not define.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct OmittedFace {
    /// The face's number in the file.
    pub number: u32,
    /// The centre of the face's defined corners; for a face without any, the location of the previous such face.
    pub at: [f64; 3],
}

impl Numbering {
    /// The number in the file of a face of the soup.
    #[must_use]
    pub fn face(&self, index: u32) -> u32 {
        self.face_numbers.get(index as usize).copied().unwrap_or(index.saturating_add(1))
    }

    /// The number in the file of a vertex of the soup.
    #[must_use]
    pub fn vertex(&self, index: u32) -> u32 {
        self.vertex_numbers.get(index as usize).copied().unwrap_or(index.saturating_add(1))
    }
}
