/// The edges of a list of faces, found by sorting.
///
/// A half-edge is named by its corner `3 * face + i` and runs from corner `i` of the face to corner `i + 1`. Faces
/// with a repeated vertex have no half-edges here.
#[derive(Debug, Clone, Default)]
pub struct Edges {
    keys: Vec<u64>,
    start: Vec<u32>,
    half_edges: Vec<u32>,
}

impl Edges {
    /// Sorts the half-edges of `faces`, of which there must be fewer than 2^32 / 3.
    #[must_use]
    pub fn new(faces: &[[u32; 3]]) -> Self {
        let mut sorted: Vec<(u64, u32)> = Vec::with_capacity(faces.len() * 3);
        for (&[a, b, c], corner) in faces.iter().zip((0u32..).step_by(3)) {
            if a != b && b != c && c != a {
                sorted.push((key(a, b), corner));
                sorted.push((key(b, c), corner + 1));
                sorted.push((key(c, a), corner + 2));
            }
        }
        sorted.sort_unstable();
        let mut edges = Self { half_edges: sorted.iter().map(|&(_, h)| h).collect(), ..Self::default() };
        for (&(key, _), at) in sorted.iter().zip(0u32..) {
            if edges.keys.last() != Some(&key) {
                edges.keys.push(key);
                edges.start.push(at);
            }
        }
        #[expect(clippy::cast_possible_truncation, reason = "three for each face")]
        edges.start.push(sorted.len() as u32);
        edges
    }

    /// How many different edges there are.
    #[must_use]
    pub fn len(&self) -> usize {
        self.keys.len()
    }

    /// Whether there is no edge.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// The two vertices of an edge, the smaller first.
    ///
    /// # Panics
    /// When there is no such edge.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "two halves of a key")]
    pub fn vertices(&self, edge: usize) -> [u32; 2] {
        [(self.keys[edge] >> 32) as u32, self.keys[edge] as u32]
    }

    /// The half-edges along an edge, in order of their faces.
    ///
    /// # Panics
    /// When there is no such edge.
    #[must_use]
    pub fn half_edges(&self, edge: usize) -> &[u32] {
        &self.half_edges[self.start[edge] as usize..self.start[edge + 1] as usize]
    }

    /// The half-edges of every edge, in order of the edges.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.len()).map(|e| self.half_edges(e))
    }

    /// The edge between two vertices, in either direction.
    #[must_use]
    pub fn find(&self, a: u32, b: u32) -> Option<usize> {
        self.keys.binary_search(&key(a, b)).ok()
    }
}

/// Where a half-edge starts.
#[must_use]
pub(super) fn origin(faces: &[[u32; 3]], half_edge: u32) -> u32 {
    faces[half_edge as usize / 3][half_edge as usize % 3]
}

/// The corner after this one around its face, which is where the half-edge ends.
#[must_use]
pub(super) fn next(half_edge: u32) -> u32 {
    if half_edge % 3 == 2 { half_edge - 2 } else { half_edge + 1 }
}

impl Edges {
    /// Where a half-edge starts and ends.
    ///
    /// # Panics
    /// When `half_edge` is not one of these faces.
    #[must_use]
    pub fn ends(faces: &[[u32; 3]], half_edge: u32) -> [u32; 2] {
        [origin(faces, half_edge), origin(faces, next(half_edge))]
    }

    /// Whether a half-edge runs from the smaller vertex to the larger.
    ///
    /// # Panics
    /// When `half_edge` is not one of these faces.
    #[must_use]
    pub fn is_forward(faces: &[[u32; 3]], half_edge: u32) -> bool {
        let [a, b] = Self::ends(faces, half_edge);
        a < b
    }
}

fn key(a: u32, b: u32) -> u64 {
    u64::from(a.min(b)) << 32 | u64::from(a.max(b))
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    #[test]
    fn two_faces_share_one_edge_of_five() {
        let faces = [[0, 1, 2], [2, 1, 3]];
        let edges = Edges::new(&faces);
        assert_eq!(edges.len(), 5);
        let shared = edges.find(2, 1).unwrap();
        assert_eq!(edges.vertices(shared), [1, 2]);
        assert_eq!(edges.half_edges(shared), [1, 3]);
        assert!(Edges::is_forward(&faces, 1) && !Edges::is_forward(&faces, 3));
        assert_eq!(edges.find(0, 3), None);
    }

    #[test]
    fn a_face_with_a_repeated_vertex_has_no_edges() {
        assert!(Edges::new(&[[4, 4, 1]]).is_empty());
    }
}
