use super::{Edges, Surface, UnionFind};

/// The edge-connected parts of a surface: faces belong together where a chain of shared edges joins them.
///
/// Parts are numbered in the order of their first face. Faces with a repeated vertex belong to no part.
#[derive(Debug, Clone)]
pub struct Parts {
    /// The part of each face, or [`Parts::NONE`].
    pub of_face: Vec<u32>,
    /// How many parts there are.
    pub count: usize,
}

impl Parts {
    /// The part of a face that belongs to none.
    pub const NONE: u32 = u32::MAX;

    /// Parts joined across every shared edge, however many faces it has.
    #[must_use]
    pub fn new(surface: &Surface, edges: &Edges) -> Self {
        Self::joined_where(surface, edges, |_| true)
    }

    /// Patches: parts joined across edges of exactly two faces only.
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

    /// Numbers sets of faces in the order of their first face; where `counts` says no, a face stands alone and is in
    /// no part.
    pub(super) fn numbered(sets: UnionFind, counts: impl Fn(usize) -> bool) -> Self {
        let mut of_face = sets.into_roots();
        let mut count = 0u32;
        for f in 0..of_face.len() {
            of_face[f] = if !counts(f) {
                Self::NONE
            } else if of_face[f] as usize == f {
                count += 1;
                count - 1
            } else {
                // The root is smaller, so that it holds its number already.
                of_face[of_face[f] as usize]
            };
        }
        Self { of_face, count: count as usize }
    }

    /// For each part whether it has a boundary: an edge of one face.
    #[must_use]
    pub fn open(&self, edges: &Edges) -> Vec<bool> {
        let mut open = vec![false; self.count];
        for half_edges in edges.iter().filter(|h| h.len() == 1) {
            open[self.of_face[half_edges[0] as usize / 3] as usize] = true;
        }
        open
    }

    /// Removes the faces of the parts that `goes` marks, and the vertices that none uses then. Answers how many faces went.
    pub fn remove(&self, goes: &[bool], surface: &mut Surface) -> u64 {
        let keep: Vec<bool> = self.of_face.iter().map(|&p| p == Self::NONE || !goes[p as usize]).collect();
        let gone = surface.retain_faces(&keep);
        surface.drop_unreferenced();
        gone
    }

    /// The faces of each part, in order.
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
