/// The faces at each vertex, in their order.
#[derive(Debug, Clone)]
pub struct Stars {
    /// For each vertex its first entry in `faces`, and the end.
    start: Vec<u32>,
    faces: Vec<u32>,
}

impl Stars {
    /// Distributes `faces`, of which there must be fewer than 2^32 / 3, over `vertices` vertices by counting.
    #[must_use]
    pub fn new(vertices: usize, faces: &[[u32; 3]]) -> Self {
        let mut start = vec![0u32; vertices + 1];
        for &v in faces.iter().flatten() {
            start[v as usize] += 1;
        }
        let mut total = 0;
        for count in &mut start {
            total += std::mem::replace(count, total);
        }
        let (mut next, mut of_vertex) = (start.clone(), vec![0; total as usize]);
        for (face, corners) in (0u32..).zip(faces) {
            for &v in corners {
                of_vertex[next[v as usize] as usize] = face;
                next[v as usize] += 1;
            }
        }
        Self { start, faces: of_vertex }
    }

    /// The faces at a vertex; a face with a repeated vertex is there as often.
    ///
    /// # Panics
    /// When there is no such vertex.
    #[must_use]
    pub fn of(&self, vertex: u32) -> &[u32] {
        &self.faces[self.start[vertex as usize] as usize..self.start[vertex as usize + 1] as usize]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_vertex_has_its_faces_in_order() {
        let stars = Stars::new(5, &[[0, 1, 2], [2, 1, 3], [1, 0, 3]]);
        let of: Vec<&[u32]> = (0..5).map(|v| stars.of(v)).collect();
        assert_eq!(of, [&[0, 2][..], &[0, 1, 2], &[0, 1], &[1, 2], &[]]);
    }
}
