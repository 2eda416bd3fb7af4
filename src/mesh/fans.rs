use super::edges::origin;
use super::{Edges, Surface, UnionFind};

/// The fans of a surface: at each vertex, the corners of faces that follow one another across shared edges.
///
/// A vertex is manifold where its corners form one fan.
#[derive(Debug, Clone)]
pub struct Fans {
    /// For each corner `3 * face + i` the smallest corner of its fan.
    pub of_corner: Vec<u32>,
    /// Vertices with more than one fan.
    pub nonmanifold_vertices: u64,
}

impl Fans {
    /// Joins corners across every edge, however many faces it has.
    #[must_use]
    pub fn new(surface: &Surface, edges: &Edges) -> Self {
        let faces = &surface.faces;
        let mut sets = UnionFind::new(faces.len() * 3);
        for (e, half_edges) in edges.iter().enumerate() {
            let low = edges.vertices(e)[0];
            for pair in half_edges.windows(2) {
                let at_low = |h: u32| if origin(faces, h) == low { h } else { Edges::next(h) };
                let at_high = |h: u32| if origin(faces, h) == low { Edges::next(h) } else { h };
                sets.unite(at_low(pair[0]), at_low(pair[1]));
                sets.unite(at_high(pair[0]), at_high(pair[1]));
            }
        }
        let mut of_corner = sets.into_roots();
        let mut fans_at = vec![0u8; surface.positions.len()];
        for (corners, &[a, b, c]) in of_corner.as_chunks_mut::<3>().0.iter_mut().zip(faces) {
            if a == b || b == c || c == a {
                *corners = [u32::MAX; 3];
            }
        }
        for (&root, corner) in of_corner.iter().zip(0u32..) {
            if root == corner {
                let count = &mut fans_at[origin(faces, corner) as usize];
                *count = count.saturating_add(1);
            }
        }
        Self { of_corner, nonmanifold_vertices: fans_at.iter().filter(|&&n| n > 1).count() as u64 }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    fn fans(faces: Vec<[u32; 3]>) -> Fans {
        let n = faces.iter().flatten().max().map_or(0, |m| m + 1);
        let source = vec![0; faces.len()];
        let surface = Surface { positions: (0..n).map(|i| DVec3::splat(f64::from(i))).collect(), faces, source };
        Fans::new(&surface, &Edges::new(&surface.faces))
    }

    #[test]
    fn two_faces_that_touch_in_a_vertex_are_two_fans() {
        let it = fans(vec![[0, 1, 2], [0, 3, 4]]);
        assert_eq!(it.nonmanifold_vertices, 1);
        assert_ne!(it.of_corner[0], it.of_corner[3]);
    }

    #[test]
    fn faces_around_a_vertex_are_one_fan() {
        let it = fans(vec![[0, 1, 2], [0, 2, 3], [0, 3, 1]]);
        assert_eq!(it.nonmanifold_vertices, 0);
        assert_eq!(it.of_corner[3], it.of_corner[6]);
    }
}
