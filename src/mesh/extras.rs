/// Normals that a file gives at the corners of its faces, one triple for each face of the soup. A corner without a
/// normal has zeros.
#[derive(Debug, Clone, Default, PartialEq)]
pub struct CornerNormals {
    /// Of each face of the soup, the normals at its three corners, not necessarily of unit length.
    pub of_face: Vec<[[f32; 3]; 3]>,
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
