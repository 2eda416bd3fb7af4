use glam::DVec3;

/// Triangles as a file gives them: the lowest rung, which promises only that face indices are in range.
///
/// Positions may be non-finite or repeated, faces may be degenerate, duplicated, flipped or intersecting.
/// Readers make it, writers take it; everything that repairs works on higher rungs.
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
