//! Identical faces: groups of faces with the same vertices in one mesh, and faces at the same positions in two
//! meshes.

use glam::DVec3;
use smallvec::SmallVec;

use crate::math::Box3;
use crate::math::threads;
use crate::mesh::{Edges, Surface};

/// Faces grouped by their three vertices, regardless of vertex order.
#[derive(Debug, Clone, Default)]
pub struct FaceGroups {
    /// Faces sorted by group, and by index within a group.
    order: Vec<u32>,
    /// Start of each group in `order`, and the end of the last.
    start: Vec<u32>,
}

impl FaceGroups {
    /// Number of groups, that is, of distinct faces.
    #[must_use]
    pub fn len(&self) -> usize {
        self.start.len().saturating_sub(1)
    }

    /// Whether there are no faces.
    #[must_use]
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// The groups, ordered by their vertices. Each lists its faces by ascending index.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        self.start.windows(2).map(|w| &self.order[w[0] as usize..w[1] as usize])
    }
}

/// Number of faces with the same three vertices as an earlier one, in any order. `edges` are those of the faces. O(n), in parallel if
/// the faces are many.
#[must_use]
pub fn duplicate_faces(faces: &[[u32; 3]], edges: &Edges) -> u64 {
    let uses_a_vertex_twice = |face: usize| matches!(faces[face], [a, b, c] if a == b || b == c || c == a);
    if threads::count(faces.len(), uses_a_vertex_twice) > 0 {
        // Such faces have no edges.
        return (faces.len() - group_faces(faces).len()) as u64;
    }
    // A face counts at the edge between its two smaller vertices.
    let at_edge = |edge: usize| {
        let [_, larger] = edges.vertices(edge);
        let third = |half_edge: &u32| faces[*half_edge as usize / 3][(*half_edge as usize + 2) % 3];
        let mut thirds: SmallVec<[u32; 4]> =
            edges.half_edges(edge).iter().map(third).filter(|&third| third > larger).collect();
        thirds.sort_unstable();
        thirds.windows(2).filter(|pair| pair[0] == pair[1]).count() as u64
    };
    threads::map_chunks(edges.len(), |range| range.map(at_edge).sum::<u64>()).into_iter().sum()
}

/// Groups faces with the same three vertices. Distributes the faces by their smallest vertex with a counting sort,
/// then sorts the few faces of each vertex.
#[must_use]
pub fn group_faces(faces: &[[u32; 3]]) -> FaceGroups {
    let vertices = faces.iter().flatten().max().map_or(0, |&v| v as usize + 1);
    let mut end = vec![0u32; vertices];
    let smallest = |face: &[u32; 3]| face[0].min(face[1]).min(face[2]);
    for face in faces {
        end[smallest(face) as usize] += 1;
    }
    let mut total = 0;
    for count in &mut end {
        total += std::mem::replace(count, total);
    }
    let mut order = vec![0u32; faces.len()];
    for (face, f) in faces.iter().zip(0u32..) {
        let next = &mut end[smallest(face) as usize];
        order[*next as usize] = f;
        *next += 1;
    }
    let key = |f: u32| {
        let mut key = faces[f as usize];
        key.sort_unstable();
        key
    };
    let mut start = Vec::with_capacity(faces.len() + 1);
    let mut begin = 0;
    for end in end {
        let group = &mut order[begin as usize..end as usize];
        group.sort_unstable_by_key(|&f| (key(f), f));
        let mut last = None;
        for (&f, at) in group.iter().zip(begin..) {
            let key = key(f);
            if last.replace(key) != Some(key) {
                start.push(at);
            }
        }
        begin = end;
    }
    start.push(total);
    FaceGroups { order, start }
}

/// Largest distance of a mesh from the origin, in diagonals, at which f32 positions are accurate to a millionth of
/// the diagonal.
const MAX_DIAGONALS_FROM_ORIGIN: f64 = 16.0;

/// Marks a face without an identical face in the other mesh.
pub(super) const NO_FACE: u32 = u32::MAX;

/// Sorted position keys of a mesh's faces, for finding identical faces in another mesh.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FaceKeys {
    /// For each face its sorted corner positions as f32 bits, with the face index. Sorted by key.
    sorted: Vec<([[u32; 3]; 3], u32)>,
    /// Whether f32 positions are accurate enough to distinguish the mesh's faces.
    fine: bool,
    /// Whether f32 holds all positions exactly, so that faces with equal keys in two such meshes are at the same positions.
    pub is_exact: bool,
}

impl FaceKeys {
    /// Builds the keys. O(n log n). `scale` is a power of two, the same for both meshes, so that f32 represents
    /// coordinates of any magnitude without changing mantissas. `unit` holds the positions in the range of
    /// [`to_unit_range`](crate::math::to_unit_range).
    #[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
    pub fn new(surface: &Surface, unit: &[DVec3], scale: f64) -> Self {
        let mut sorted = threads::map_cheap(surface.faces.len(), |f| {
            let mut key = surface.corners(f).map(|p| p.to_array().map(|x| ((x * scale) as f32 + 0.0).to_bits()));
            key.sort_unstable();
            (key, f as u32)
        });
        threads::sort_by(&mut sorted, &Ord::cmp);
        let bounds = Box3::of(unit.iter().copied());
        let is_held = |p: f64| f64::from((p * scale) as f32) == p * scale;
        let is_rounded = |v: usize| !surface.positions[v].to_array().into_iter().all(is_held);
        let is_exact = threads::count(surface.positions.len(), is_rounded) == 0;
        // Unit coordinates reach 2.
        Self { sorted, is_exact, fine: bounds.diagonal() * MAX_DIAGONALS_FROM_ORIGIN >= 2.0 }
    }
}

/// For each face of mesh `a` the face of mesh `b` at the same three f32 positions, or [`NO_FACE`]. Coincident faces
/// of `a` match as often as `b` has faces there, lowest index first. O(n).
pub(super) fn matched(a: &FaceKeys, b: &FaceKeys) -> Vec<u32> {
    let mut matched = vec![NO_FACE; a.sorted.len()];
    let mut at = 0;
    for &(key, face) in &a.sorted {
        while b.sorted.get(at).is_some_and(|(other, _)| *other < key) {
            at += 1;
        }
        if let Some(&(_, other)) = b.sorted.get(at).filter(|(other, _)| *other == key) {
            matched[face as usize] = other;
            at += 1;
        }
    }
    matched
}

/// Faces that two meshes have in common.
pub(super) struct Common {
    /// For each face of the first mesh, whether the second has a face at the same three f32 positions, with any
    /// winding.
    pub first: Vec<bool>,
    /// For each face of the second mesh, whether the first has a face there.
    pub second: Vec<bool>,
    /// Whether a common face coincides in both meshes to within measurable distance.
    pub fine: bool,
}

impl Common {
    /// A mesh with `faces` faces compared with itself.
    pub fn whole(faces: usize) -> Self {
        Self { first: vec![true; faces], second: vec![true; faces], fine: true }
    }

    /// Finds the common faces of two meshes. O(n).
    pub fn new(a: &FaceKeys, b: &FaceKeys) -> Self {
        let mut common =
            Self { first: vec![false; a.sorted.len()], second: vec![false; b.sorted.len()], fine: a.fine && b.fine };
        let mut at = 0;
        for group in a.sorted.chunk_by(|x, y| x.0 == y.0) {
            let key = group[0].0;
            while b.sorted.get(at).is_some_and(|(other, _)| *other < key) {
                at += 1;
            }
            if b.sorted.get(at).is_none_or(|(other, _)| *other != key) {
                continue;
            }
            for &(_, face) in group {
                common.first[face as usize] = true;
            }
            while let Some(&(_, face)) = b.sorted.get(at).filter(|(other, _)| *other == key) {
                common.second[face as usize] = true;
                at += 1;
            }
        }
        common
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn faces_with_the_same_vertices_form_one_group_in_any_vertex_order() {
        let groups = group_faces(&[[2, 1, 0], [0, 1, 3], [0, 1, 2]]);
        assert_eq!(groups.iter().collect::<Vec<_>>(), [&[0u32, 2][..], &[1][..]]);
        assert_eq!(groups.len(), 2);
        assert!(group_faces(&[]).is_empty());
    }

    #[test]
    fn duplicate_faces_are_counted_like_those_of_groups() {
        let corner = |i: u32| i * i % 53 % 6;
        let all: Vec<[u32; 3]> = (0..400).map(|i| [3 * i, 3 * i + 1, 3 * i + 2].map(corner)).collect();
        let whole: Vec<[u32; 3]> = all.iter().copied().filter(|&[a, b, c]| a != b && b != c && c != a).collect();
        assert!(whole.len() < all.len());
        for faces in [&all[..], &whole, &whole[..3], &[]] {
            let expected = (faces.len() - group_faces(faces).len()) as u64;
            assert_eq!(duplicate_faces(faces, &Edges::new(faces)), expected);
        }
    }
}
