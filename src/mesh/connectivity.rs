//! Connectivity of a surface: disjoint sets, edge-connected parts, and fans of corners around vertices.

use super::adjacency::{Edges, origin};
use super::surface::Surface;

/// Disjoint sets over `0..n` (Tarjan 1975). The root of a set is its smallest member, so results do not depend on the
/// order of unions.
#[derive(Debug, Clone)]
pub struct UnionFind {
    parent: Vec<u32>,
}

impl UnionFind {
    /// Creates `n` sets of one member each.
    #[must_use]
    pub fn new(n: usize) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "meshes are counted in u32")]
        Self { parent: (0..n as u32).collect() }
    }

    /// Adds sets of one member each, up to `n` members in all.
    pub fn extend_to(&mut self, n: usize) {
        #[expect(clippy::cast_possible_truncation, reason = "meshes are counted in u32")]
        self.parent.extend(self.parent.len() as u32..n as u32);
    }

    /// The smallest member of the set that holds `x`.
    pub fn root(&mut self, mut x: u32) -> u32 {
        while self.parent[x as usize] != x {
            let up = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = up;
            x = up;
        }
        x
    }

    /// Merges the sets of `a` and `b`.
    pub fn unite(&mut self, a: u32, b: u32) {
        let (a, b) = (self.root(a), self.root(b));
        if a != b {
            self.parent[a.max(b) as usize] = a.min(b);
        }
    }

    /// For each member the smallest member of its set.
    #[must_use]
    pub fn into_roots(mut self) -> Vec<u32> {
        // A parent is never larger than its child, so its root is already known.
        for x in 0..self.parent.len() {
            self.parent[x] = self.parent[self.parent[x] as usize];
        }
        self.parent
    }

    /// For each element the number of its set, in the order of their first elements, and the number of sets. An element for
    /// which `is_included` returns false has [`Parts::NONE`], and so has every set of which it is the first.
    pub fn into_numbers(self, is_included: impl Fn(usize) -> bool) -> (Vec<u32>, usize) {
        let mut numbers = self.into_roots();
        let mut count = 0u32;
        for element in 0..numbers.len() {
            numbers[element] = if !is_included(element) {
                Parts::NONE
            } else if numbers[element] as usize == element {
                count += 1;
                count - 1
            } else {
                // The root is smaller, so its entry already holds the set's number.
                numbers[numbers[element] as usize]
            };
        }
        (numbers, count as usize)
    }
}

/// The edge-connected parts of a surface: faces joined by a chain of shared edges are in one part.
///
/// Parts are numbered in the order of their first face. Faces with a repeated vertex belong to no part.
#[derive(Debug, Clone)]
pub struct Parts {
    /// The part of each face, or [`Parts::NONE`].
    pub of_face: Vec<u32>,
    /// Number of parts.
    pub count: usize,
}

impl Parts {
    /// The value for a face that belongs to no part.
    pub const NONE: u32 = u32::MAX;

    /// Parts joined across every shared edge, whatever its number of faces.
    #[must_use]
    pub fn new(surface: &Surface, edges: &Edges) -> Self {
        Self::joined_where(surface, edges, |_| true)
    }

    /// Patches: parts joined only across edges with exactly two faces.
    #[must_use]
    pub fn patches(surface: &Surface, edges: &Edges) -> Self {
        Self::joined_where(surface, edges, |half_edges| half_edges.len() == 2)
    }

    fn joined_where(surface: &Surface, edges: &Edges, joins: impl Fn(&[u32]) -> bool) -> Self {
        let mut sets = UnionFind::new(surface.faces.len());
        for half_edges in edges.iter().filter(|h| joins(h)) {
            for pair in half_edges.windows(2) {
                sets.unite(pair[0] / 3, pair[1] / 3);
            }
        }
        Self::numbered(sets, |f| {
            let [a, b, c] = surface.faces[f];
            a != b && b != c && c != a
        })
    }

    /// The parts of sets of faces. A face for which `is_included` returns false is in no part.
    fn numbered(sets: UnionFind, is_included: impl Fn(usize) -> bool) -> Self {
        let (of_face, count) = sets.into_numbers(is_included);
        Self { of_face, count }
    }

    /// For each part, whether it has a boundary: an edge with one face.
    #[must_use]
    pub fn open(&self, edges: &Edges) -> Vec<bool> {
        let mut open = vec![false; self.count];
        for half_edges in edges.iter().filter(|h| h.len() == 1) {
            open[self.of_face[half_edges[0] as usize / 3] as usize] = true;
        }
        open
    }

    /// Removes the faces of the parts that `is_removed` marks, and the vertices that are unused then. Returns the
    /// number of removed faces.
    pub fn remove(&self, is_removed: &[bool], surface: &mut Surface) -> u64 {
        let keep: Vec<bool> = self.of_face.iter().map(|&p| p == Self::NONE || !is_removed[p as usize]).collect();
        let gone = surface.retain_faces(&keep);
        surface.drop_unreferenced();
        gone
    }

    /// The faces of each part, in ascending order.
    #[must_use]
    pub fn faces(&self) -> Vec<Vec<u32>> {
        let mut lists = vec![Vec::new(); self.count];
        for (&part, f) in self.of_face.iter().zip(0u32..) {
            if part != Self::NONE {
                lists[part as usize].push(f);
            }
        }
        lists
    }
}

/// The fans (umbrellas) of a surface: at each vertex, the sets of face corners connected across shared edges.
///
/// A vertex is manifold if its corners form one fan.
#[derive(Debug, Clone)]
pub struct Fans {
    /// For each vertex, the smallest corner of its first fan; [`NO_FAN`] if it has none.
    first: Vec<u32>,
    /// The corners of all further fans, ascending, each with the smallest corner of its fan.
    others: Vec<(u32, u32)>,
    /// Vertices with more than one fan.
    pub non_manifold_vertices: u64,
}

/// The fan of a corner of a face with a repeated vertex.
const NO_FAN: u32 = u32::MAX;

impl Fans {
    /// Joins corners across every edge, whatever its number of faces.
    #[must_use]
    pub fn new(surface: &Surface, edges: &Edges) -> Self {
        let (mut first, mut others) = (vec![NO_FAN; surface.positions.len()], Vec::new());
        for (root, corner) in fans_at(surface, edges, |_| true).into_iter().zip(0u32..) {
            let first = &mut first[origin(&surface.faces, corner) as usize];
            if *first == NO_FAN {
                *first = root;
            } else if root != *first && root != NO_FAN {
                others.push((corner, root));
            }
        }
        let mut fans = Self { first, others, non_manifold_vertices: 0 };
        let mut at: Vec<u32> = fans.further_fans().map(|root| origin(&surface.faces, root)).collect();
        at.sort_unstable();
        at.dedup();
        fans.non_manifold_vertices = at.len() as u64;
        fans
    }

    /// The smallest corner of the fan of a corner `3 * face + i` of these faces; none for a face with a repeated vertex.
    #[must_use]
    pub fn of_corner(&self, faces: &[[u32; 3]], corner: u32) -> Option<u32> {
        let [a, b, c] = faces[corner as usize / 3];
        if a == b || b == c || c == a {
            return None;
        }
        match self.others.binary_search_by_key(&corner, |&(other, _)| other) {
            Ok(at) => Some(self.others[at].1),
            Err(_) => Some(self.first[origin(faces, corner) as usize]),
        }
    }

    /// The smallest corner of every fan.
    pub fn roots(&self) -> impl Iterator<Item = u32> {
        self.first.iter().copied().filter(|&root| root != NO_FAN).chain(self.further_fans())
    }

    /// The smallest corners of fans that are not the first at their vertex.
    fn further_fans(&self) -> impl Iterator<Item = u32> {
        self.others.iter().filter(|(corner, root)| corner == root).map(|&(corner, _)| corner)
    }

    /// The number of fans at each vertex.
    #[must_use]
    pub fn at_vertices(&self, surface: &Surface) -> Vec<u32> {
        let mut counts = vec![0; surface.positions.len()];
        self.roots().for_each(|root| counts[origin(&surface.faces, root) as usize] += 1);
        counts
    }
}

/// For each corner, the smallest corner of its fan; [`NO_FAN`] for a face with a repeated vertex. Corners at vertices for which
/// `is_wanted` returns false stay alone.
pub(super) fn fans_at(surface: &Surface, edges: &Edges, is_wanted: impl Fn(u32) -> bool) -> Vec<u32> {
    let faces = &surface.faces;
    let mut sets = UnionFind::new(faces.len() * 3);
    for (e, half_edges) in edges.iter().enumerate() {
        for v in edges.vertices(e).into_iter().filter(|&v| is_wanted(v)) {
            let corner_at = |h: u32| if origin(faces, h) == v { h } else { Edges::next(h) };
            half_edges.windows(2).for_each(|pair| sets.unite(corner_at(pair[0]), corner_at(pair[1])));
        }
    }
    let mut of_corner = sets.into_roots();
    for (corners, &[a, b, c]) in of_corner.as_chunks_mut::<3>().0.iter_mut().zip(faces) {
        if a == b || b == c || c == a {
            *corners = [NO_FAN; 3];
        }
    }
    of_corner
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    #[test]
    fn the_root_of_every_member_is_the_smallest_of_its_set() {
        let mut sets = UnionFind::new(7);
        for (a, b) in [(6, 5), (5, 2), (4, 3), (3, 1), (6, 4)] {
            sets.unite(a, b);
        }
        let one_by_one: Vec<u32> = (0..7).map(|x| sets.root(x)).collect();
        assert_eq!(one_by_one, [0, 1, 1, 1, 1, 1, 1]);
        let mut fresh = UnionFind::new(7);
        for (a, b) in [(6, 5), (5, 2), (4, 3), (3, 1)] {
            fresh.unite(a, b);
        }
        assert_eq!(fresh.into_roots(), [0, 1, 2, 1, 1, 2, 2]);
    }

    fn fans(faces: &[[u32; 3]]) -> Fans {
        let n = faces.iter().flatten().max().map_or(0, |m| m + 1);
        let source = vec![0; faces.len()];
        let positions = (0..n).map(|i| DVec3::splat(f64::from(i))).collect();
        let surface = Surface { positions, faces: faces.to_vec(), source };
        Fans::new(&surface, &Edges::new(&surface.faces))
    }

    #[test]
    fn two_faces_that_touch_in_a_vertex_are_two_fans() {
        let faces = [[0, 1, 2], [0, 3, 4]];
        let found = fans(&faces);
        assert_eq!(found.non_manifold_vertices, 1);
        assert_eq!([0, 3].map(|corner| found.of_corner(&faces, corner)), [Some(0), Some(3)]);
        assert!(found.roots().eq([0, 1, 2, 4, 5, 3]));
    }

    #[test]
    fn faces_around_a_vertex_are_one_fan() {
        let faces = [[0, 1, 2], [0, 2, 3], [0, 3, 1]];
        let found = fans(&faces);
        assert_eq!(found.non_manifold_vertices, 0);
        assert_eq!([3, 6].map(|corner| found.of_corner(&faces, corner)), [Some(0); 2]);
    }

    #[test]
    fn a_face_with_a_repeated_vertex_is_in_no_fan() {
        let faces = [[0, 0, 1], [0, 1, 2], [0, 3, 4]];
        let found = fans(&faces);
        assert_eq!([0, 3, 6].map(|corner| found.of_corner(&faces, corner)), [None, Some(3), Some(6)]);
        assert_eq!(found.non_manifold_vertices, 1);
    }
}
