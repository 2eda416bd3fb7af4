//! Edges, half-edges and vertex stars of a list of faces, in compact arrays.

use std::ops::Range;

use crate::math::threads;

/// Half-edges of a vertex up to which insertion sort is used.
const INSERTION_SORT_LIMIT: usize = 16;
/// Faces from which several threads build the edges, and the most parts into which the work is divided: each part reads all
/// faces.
const MANY_FACES: usize = 1 << 16;
const MAX_PARTS: usize = 8;

/// The edges of a list of faces, sorted by their vertices.
///
/// A half-edge has the index of its corner, `3 * face + i`. It runs from corner `i` of the face to corner `i + 1`.
/// Faces with a repeated vertex have no half-edges here.
#[derive(Debug, Clone, Default)]
pub struct Edges {
    /// The two vertices of each edge, the smaller first.
    ends: Vec<[u32; 2]>,
    /// For each vertex, the first edge of which it is the smaller vertex, followed by the number of edges.
    from: Vec<u32>,
    /// For each edge, the index of its first half-edge in `half_edges`, followed by their number.
    start: Vec<u32>,
    half_edges: Vec<u32>,
}

impl Edges {
    /// Builds the edges of `faces`, of which there must be fewer than 2^32 / 3. O(n). In parallel if the faces are many: each
    /// thread builds the edges of a range of smaller vertices.
    #[must_use]
    pub fn new(faces: &[[u32; 3]]) -> Self {
        let vertices = faces.iter().flatten().max().map_or(0, |&v| v as usize + 1);
        let parts = if faces.len() < MANY_FACES { 1 } else { rayon::current_num_threads().min(MAX_PARTS) };
        let bound = |part: usize| index(vertices * part / parts);
        let mut built = threads::map(parts, 2, |part| Self::from_vertices(faces, bound(part)..bound(part + 1)));
        let mut edges = built.remove(0);
        for part in built {
            let [first_edge, first_half_edge] = [edges.ends.len(), edges.half_edges.len()].map(index);
            // Replaces the total at the end of each list.
            edges.from.pop();
            edges.from.extend(part.from.into_iter().map(|edge| edge + first_edge));
            edges.start.pop();
            edges.start.extend(part.start.into_iter().map(|half_edge| half_edge + first_half_edge));
            edges.ends.extend(part.ends);
            edges.half_edges.extend(part.half_edges);
        }
        edges
    }

    /// The edges whose smaller vertex is in a range. A counting sort groups the half-edges by that vertex; then each group is
    /// sorted.
    fn from_vertices(faces: &[[u32; 3]], vertices: Range<u32>) -> Self {
        let mut from = vec![0u32; vertices.len() + 1];
        // The place of a half-edge's smaller vertex in the range.
        let place =
            |a: u32, b: u32| a.min(b).checked_sub(vertices.start).filter(|&at| at < vertices.end - vertices.start);
        for_each_half_edge(faces, |_, a, b| {
            if let Some(at) = place(a, b) {
                from[at as usize] += 1;
            }
        });
        let mut total = 0;
        for count in &mut from {
            total += std::mem::replace(count, total);
        }
        // Packs the larger vertex above the half-edge, so that sorting groups edges and orders their half-edges by
        // face.
        let mut sorted = vec![0u64; total as usize];
        for_each_half_edge(faces, |half_edge, a, b| {
            if let Some(at) = place(a, b) {
                let next = &mut from[at as usize];
                sorted[*next as usize] = u64::from(a.max(b)) << 32 | u64::from(half_edge);
                *next += 1;
            }
        });
        // `from` now holds the end of each vertex's range, which is the start of the next.
        let mut edges = Self { half_edges: Vec::with_capacity(sorted.len()), ..Self::default() };
        edges.ends.reserve(sorted.len() / 2);
        edges.start.reserve(sorted.len() / 2 + 1);
        let mut begin = 0;
        for (low, end) in (vertices.start..).zip(&mut from) {
            let of_low = &mut sorted[begin..*end as usize];
            begin = *end as usize;
            *end = index(edges.ends.len());
            sort_few(of_low);
            let mut last = None;
            for &entry in &*of_low {
                let [high, half_edge] = [(entry >> 32) as u32, low_half(entry)];
                if last != Some(high) {
                    last = Some(high);
                    edges.start.push(index(edges.half_edges.len()));
                    edges.ends.push([low, high]);
                }
                edges.half_edges.push(half_edge);
            }
        }
        edges.start.push(total);
        edges.from = from;
        edges
    }

    /// Number of edges.
    #[must_use]
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    /// Whether there are no edges.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// The two vertices of an edge, the smaller first.
    ///
    /// # Panics
    /// If there is no such edge.
    #[must_use]
    pub fn vertices(&self, edge: usize) -> [u32; 2] {
        self.ends[edge]
    }

    /// The half-edges of an edge, in the order of their faces.
    ///
    /// # Panics
    /// If there is no such edge.
    #[must_use]
    pub fn half_edges(&self, edge: usize) -> &[u32] {
        &self.half_edges[self.start[edge] as usize..self.start[edge + 1] as usize]
    }

    /// The half-edges of every edge, in the order of the edges.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.start.windows(2).map(|w| &self.half_edges[w[0] as usize..w[1] as usize])
    }

    /// The half-edges of each edge with exactly two, in the order of the edges.
    pub fn pairs(&self) -> impl Iterator<Item = [u32; 2]> {
        self.iter().filter_map(|half_edges| <[u32; 2]>::try_from(half_edges).ok())
    }

    /// The edge between two vertices, in either direction, if there is one.
    #[must_use]
    pub fn find(&self, a: u32, b: u32) -> Option<usize> {
        let (low, high) = (a.min(b) as usize, a.max(b));
        let [begin, end] = [*self.from.get(low)? as usize, *self.from.get(low + 1)? as usize];
        let among = &self.ends[begin..end];
        among.binary_search_by_key(&high, |ends| ends[1]).ok().map(|at| begin + at)
    }

    /// The next half-edge around the face, which starts where this one ends.
    #[must_use]
    pub fn next(half_edge: u32) -> u32 {
        if half_edge % 3 == 2 { half_edge - 2 } else { half_edge + 1 }
    }

    /// The previous half-edge around the face, which ends where this one starts.
    #[must_use]
    pub fn previous(half_edge: u32) -> u32 {
        if half_edge.is_multiple_of(3) { half_edge + 2 } else { half_edge - 1 }
    }

    /// The vertex of the half-edge's face that the half-edge does not touch.
    ///
    /// # Panics
    /// If `half_edge` does not belong to these faces.
    #[must_use]
    pub fn opposite(faces: &[[u32; 3]], half_edge: u32) -> u32 {
        origin(faces, Self::previous(half_edge))
    }

    /// The vertices at which a half-edge starts and ends.
    ///
    /// # Panics
    /// If `half_edge` does not belong to these faces.
    #[must_use]
    pub fn ends(faces: &[[u32; 3]], half_edge: u32) -> [u32; 2] {
        [origin(faces, half_edge), origin(faces, Self::next(half_edge))]
    }

    /// Whether a half-edge runs from the smaller vertex to the larger.
    ///
    /// # Panics
    /// If `half_edge` does not belong to these faces.
    #[must_use]
    pub fn is_forward(faces: &[[u32; 3]], half_edge: u32) -> bool {
        let [a, b] = Self::ends(faces, half_edge);
        a < b
    }
}

/// A half-edge by its number, as in [`Edges`]: a type for functions that take vertices too.
#[derive(Debug, Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
pub struct HalfEdge(pub u32);

impl HalfEdge {
    /// The number, as an index into a list for all half-edges.
    #[must_use]
    pub fn index(self) -> usize {
        self.0 as usize
    }

    /// The next half-edge around the face, which starts where this one ends.
    #[must_use]
    pub fn next(self) -> Self {
        Self(Edges::next(self.0))
    }

    /// The vertices at which the half-edge starts and ends.
    ///
    /// # Panics
    /// If the half-edge does not belong to these faces.
    #[must_use]
    pub fn ends(self, faces: &[[u32; 3]]) -> [u32; 2] {
        Edges::ends(faces, self.0)
    }
}

/// Sorts a list that usually has only a few entries.
fn sort_few(entries: &mut [u64]) {
    if entries.len() > INSERTION_SORT_LIMIT {
        entries.sort_unstable();
        return;
    }
    for end in 1..entries.len() {
        let (entry, mut at) = (entries[end], end);
        while at > 0 && entries[at - 1] > entry {
            entries[at] = entries[at - 1];
            at -= 1;
        }
        entries[at] = entry;
    }
}

/// Calls `visit` with every half-edge, its start vertex and its end vertex.
fn for_each_half_edge(faces: &[[u32; 3]], mut visit: impl FnMut(u32, u32, u32)) {
    for (&[a, b, c], corner) in faces.iter().zip((0u32..).step_by(3)) {
        if a != b && b != c && c != a {
            visit(corner, a, b);
            visit(corner + 1, b, c);
            visit(corner + 2, c, a);
        }
    }
}

#[expect(clippy::cast_possible_truncation, reason = "the lower half is meant")]
fn low_half(entry: u64) -> u32 {
    entry as u32
}

#[expect(clippy::cast_possible_truncation, reason = "there are fewer than 2^32 half-edges")]
fn index(count: usize) -> u32 {
    count as u32
}

/// The start vertex of a half-edge.
#[must_use]
pub(super) fn origin(faces: &[[u32; 3]], half_edge: u32) -> u32 {
    faces[half_edge as usize / 3][half_edge as usize % 3]
}

/// The faces at each vertex (its star), in ascending order.
#[derive(Debug, Clone)]
pub struct Stars {
    /// For each vertex, the index of its first entry in `faces`, followed by the number of entries.
    start: Vec<u32>,
    faces: Vec<u32>,
}

impl Stars {
    /// Builds the stars of `vertices` vertices with a counting sort. There must be fewer than 2^32 / 3 faces.
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

    /// The faces at a vertex; a face with a repeated vertex occurs once for each repetition.
    ///
    /// # Panics
    /// If there is no such vertex.
    #[must_use]
    pub fn of(&self, vertex: u32) -> &[u32] {
        &self.faces[self.start[vertex as usize] as usize..self.start[vertex as usize + 1] as usize]
    }
}

#[cfg(test)]
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

    #[test]
    fn edges_and_half_edges_are_in_sorted_order() {
        assert_sorted(&random_faces(300, 40));
    }

    #[test]
    fn edges_of_many_faces_are_in_sorted_order_for_any_number_of_threads() {
        let faces = random_faces(MANY_FACES + 300, 20_000);
        for threads in [1, 3, 20] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| assert_sorted(&faces));
        }
    }

    fn random_faces(count: usize, vertices: u32) -> Vec<[u32; 3]> {
        let mut state = 1u32;
        let mut random = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 16) % vertices
        };
        (0..count).map(|_| [random(), random(), random()]).collect()
    }

    fn assert_sorted(faces: &[[u32; 3]]) {
        let mut sorted: Vec<([u32; 2], u32)> = Vec::new();
        for (face, corner) in faces.iter().zip((0u32..).step_by(3)) {
            let [a, b, c] = *face;
            if a != b && b != c && c != a {
                let ends = [[a, b], [b, c], [c, a]].map(|[p, q]| [p.min(q), p.max(q)]);
                sorted.extend(ends.into_iter().zip(corner..));
            }
        }
        sorted.sort_unstable();
        let edges = Edges::new(faces);
        let found = (0..edges.len()).flat_map(|e| edges.half_edges(e).iter().map(move |&h| (e, h)));
        assert!(found.map(|(e, h)| (edges.vertices(e), h)).eq(sorted.iter().copied()));
        assert!(edges.iter().eq((0..edges.len()).map(|e| edges.half_edges(e))));
        for e in 0..edges.len() {
            let [a, b] = edges.vertices(e);
            assert_eq!((edges.find(a, b), edges.find(b, a)), (Some(e), Some(e)));
        }
        assert_eq!((edges.find(3, 3), edges.find(39, 70_077), edges.find(70_077, 70_078)), (None, None, None));
    }

    #[test]
    fn each_vertex_has_its_faces_in_order() {
        let stars = Stars::new(5, &[[0, 1, 2], [2, 1, 3], [1, 0, 3]]);
        let of: Vec<&[u32]> = (0..5).map(|v| stars.of(v)).collect();
        assert_eq!(of, [&[0, 2][..], &[0, 1, 2], &[0, 1], &[1, 2], &[]]);
    }
}
