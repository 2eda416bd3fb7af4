//! Identical faces: groups of faces with the same vertices in one mesh, and faces at the same positions in two
//! meshes.

use std::borrow::Cow;

use glam::DVec3;
use smallvec::SmallVec;

use crate::math::{Box3, threads};
use crate::mesh::{Edges, Surface, hash_coordinates};

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

/// The corner positions of a face as f32 bits, sorted: equal exactly for faces at the same three f32 positions.
type FaceKey = [[u32; 3]; 3];

/// The faces of a mesh in the order of a hash of their corner positions.
#[derive(Debug, Clone, PartialEq)]
pub(super) struct FaceHashes {
    /// For each face the upper half of its hash, above its index. Sorted.
    sorted: Vec<u64>,
    /// Power of two by which positions are multiplied before they are rounded to f32.
    scale: f64,
    /// Whether f32 positions are accurate enough to distinguish the mesh's faces.
    fine: bool,
    /// Whether f32 holds all positions exactly.
    is_exact: bool,
}

impl FaceHashes {
    /// Hashes and sorts the faces. O(n log n). `scale` is a power of two, the same for both meshes, so that f32 represents
    /// coordinates of any magnitude without changing mantissas. `unit` holds the positions in the range of
    /// [`to_unit_range`](crate::math::to_unit_range).
    pub fn new(surface: &Surface, unit: &[DVec3], scale: f64) -> Self {
        let positions = &surface.positions;
        let of_vertex =
            threads::map_cheap(positions.len(), |v| hash_coordinates(rounded(positions[v], scale).map(u64::from)));
        let mut sorted = threads::map_cheap(surface.faces.len(), |face| {
            // The sum does not depend on the order of the corners.
            let hash = surface.faces[face].iter().fold(0u64, |sum, &v| sum.wrapping_add(of_vertex[v as usize]));
            hash >> 32 << 32 | face as u64
        });
        threads::sort_by(&mut sorted, &Ord::cmp);
        let bounds = Box3::of(unit.iter().copied());
        #[expect(clippy::cast_possible_truncation, reason = "whether f32 holds a number is asked")]
        let is_held = |p: f64| f64::from((p * scale) as f32) == p * scale;
        let is_rounded = |v: usize| !positions[v].to_array().into_iter().all(is_held);
        let is_exact = threads::count(positions.len(), is_rounded) == 0;
        // Unit coordinates reach 2.
        Self { sorted, scale, is_exact, fine: bounds.diagonal() * MAX_DIAGONALS_FROM_ORIGIN >= 2.0 }
    }

    /// The scale of the positions.
    pub fn scale(&self) -> f64 {
        self.scale
    }
}

/// The bits of a position's coordinates in f32, times a power of two. Adding 0.0 turns -0.0 into 0.0.
#[expect(clippy::cast_possible_truncation, reason = "compared as an STL file would hold them")]
fn rounded(position: DVec3, scale: f64) -> [u32; 3] {
    position.to_array().map(|x| ((x * scale) as f32 + 0.0).to_bits())
}

/// A mesh prepared for finding its faces in another mesh.
#[derive(Clone)]
pub(super) struct KeyedFaces<'a> {
    /// The mesh.
    pub surface: &'a Surface,
    /// The hashes of its faces.
    pub hashes: Cow<'a, FaceHashes>,
}

impl KeyedFaces<'_> {
    fn len(&self) -> usize {
        self.hashes.sorted.len()
    }

    /// Whether f32 holds all positions exactly, so that faces with equal keys in two such meshes are at the same positions.
    pub fn is_exact(&self) -> bool {
        self.hashes.is_exact
    }

    fn key(&self, face: u32) -> FaceKey {
        let mut key = self.surface.corners(face as usize).map(|p| rounded(p, self.hashes.scale));
        key.sort_unstable();
        key
    }

    /// Faces with their keys, sorted.
    fn keyed(&self, hashes: &[u64]) -> Vec<(FaceKey, u32)> {
        let mut keyed: Vec<_> = hashes.iter().map(|&hash| (self.key(face_of(hash)), face_of(hash))).collect();
        keyed.sort_unstable();
        keyed
    }
}

/// The face of an entry of [`FaceHashes`].
#[expect(clippy::cast_possible_truncation, reason = "the lower half is the face")]
fn face_of(entry: u64) -> u32 {
    entry as u32
}

/// Faces of two meshes at the same three f32 positions. Both have the same scale.
struct Matches {
    /// For each face of the first mesh, the face of the second mesh at its positions where each mesh has one face with this hash.
    single: Vec<u32>,
    /// The other faces with a counterpart, of each mesh in groups of one key, ascending.
    groups: [Vec<(FaceKey, u32)>; 2],
}

impl Matches {
    /// O(n), and O(n log n) where many faces coincide or have equal hashes.
    fn new(a: &KeyedFaces<'_>, b: &KeyedFaces<'_>) -> Self {
        let (mut candidates, mut groups) = (vec![NO_FACE; a.len()], [Vec::new(), Vec::new()]);
        let mut rest = b.hashes.sorted.as_slice();
        let is_same = |x: &u64, y: &u64| x >> 32 == y >> 32;
        for of_a in a.hashes.sorted.chunk_by(is_same) {
            rest = &rest[rest.iter().take_while(|other| **other >> 32 < of_a[0] >> 32).count()..];
            let (of_b, after) = rest.split_at(rest.iter().take_while(|other| is_same(other, &of_a[0])).count());
            rest = after;
            match (of_a, of_b) {
                (_, []) => {}
                (&[face], &[other]) => candidates[face_of(face) as usize] = face_of(other),
                _ => {
                    let [of_a, of_b] = [a.keyed(of_a), b.keyed(of_b)];
                    let is_in = |of_other: &[(FaceKey, u32)], key: &FaceKey| {
                        of_other.binary_search_by(|(other, _)| other.cmp(key)).is_ok()
                    };
                    groups[0].extend(of_a.iter().filter(|(key, _)| is_in(&of_b, key)));
                    groups[1].extend(of_b.iter().filter(|(key, _)| is_in(&of_a, key)));
                }
            }
        }
        // In the order of the faces, most positions are found close together.
        let single = threads::map_cheap(candidates.len(), |face| {
            let other = candidates[face];
            #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
            let is_match = other != NO_FACE && a.key(face as u32) == b.key(other);
            if is_match { other } else { NO_FACE }
        });
        Self { single, groups }
    }
}

/// For each face of mesh `a` the face of mesh `b` at the same three f32 positions, or [`NO_FACE`]. Coincident faces
/// of `a` match as often as `b` has faces there, lowest index first. O(n log n).
pub(super) fn matched(a: &KeyedFaces<'_>, b: &KeyedFaces<'_>) -> Vec<u32> {
    let Matches { single: mut matched, groups } = Matches::new(a, b);
    let [of_a, of_b] = groups.each_ref().map(|of_mesh| of_mesh.chunk_by(|x, y| x.0 == y.0));
    for (of_a, of_b) in of_a.zip(of_b) {
        for (&(_, face), &(_, other)) in of_a.iter().zip(of_b) {
            matched[face as usize] = other;
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

    /// Finds the common faces of two meshes. O(n log n).
    pub fn new(a: &KeyedFaces<'_>, b: &KeyedFaces<'_>) -> Self {
        let Matches { single, groups } = Matches::new(a, b);
        let mut first: Vec<bool> = single.iter().map(|&other| other != NO_FACE).collect();
        let mut second = vec![false; b.len()];
        single.into_iter().filter(|&other| other != NO_FACE).for_each(|other| second[other as usize] = true);
        for (is_common, of_mesh) in [&mut first, &mut second].into_iter().zip(&groups) {
            of_mesh.iter().for_each(|&(_, face)| is_common[face as usize] = true);
        }
        Self { first, second, fine: a.hashes.fine && b.hashes.fine }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Faces of a grid of 4 by 4 vertices, of which some coincide.
    fn faces_on_a_grid(seed: u32, count: u32) -> Surface {
        let positions = (0..16u32).map(|i| DVec3::new(f64::from(i % 4), f64::from(i / 4), f64::from(i % 3))).collect();
        let corner = |i: u32| (i * i * 7 + i * seed) % 53 % 16;
        let faces: Vec<[u32; 3]> = (0..count).map(|i| [3 * i, 3 * i + 1, 3 * i + 2].map(corner)).collect();
        let source = (0..count).collect();
        Surface { positions, faces, source }
    }

    #[test]
    fn faces_match_whatever_their_hashes() {
        let meshes = [faces_on_a_grid(3, 60), faces_on_a_grid(3, 40), faces_on_a_grid(5, 50)];
        let with_hashes = |surface: &Surface| FaceHashes::new(surface, &surface.positions, 1.0);
        // All faces have the hash 0.
        let without = |surface: &Surface| FaceHashes {
            sorted: (0..surface.faces.len() as u64).collect(),
            ..with_hashes(surface)
        };
        let mut found = 0;
        for (a, b) in meshes.iter().flat_map(|a| meshes.iter().map(move |b| (a, b))) {
            let [with, same] = [&with_hashes as &dyn Fn(&Surface) -> FaceHashes, &without].map(|hashes| {
                let [a, b] = [a, b].map(|surface| KeyedFaces { surface, hashes: Cow::Owned(hashes(surface)) });
                let Common { first, second, .. } = Common::new(&a, &b);
                (matched(&a, &b), first, second)
            });
            assert_eq!(with, same);
            let key = |surface: &Surface, face: u32| {
                let mut key = surface.corners(face as usize).map(|p| rounded(p, 1.0));
                key.sort_unstable();
                key
            };
            let keys_of =
                |surface: &Surface| (0..surface.faces.len() as u32).map(|f| key(surface, f)).collect::<Vec<_>>();
            let (of_a, of_b) = (keys_of(a), keys_of(b));
            assert!(with.1.iter().zip(&of_a).all(|(&is_common, key)| is_common == of_b.contains(key)));
            assert!(with.2.iter().zip(&of_b).all(|(&is_common, key)| is_common == of_a.contains(key)));
            // The first of several faces at one place match the first ones there.
            for (face, key) in of_a.iter().enumerate() {
                let earlier = of_a[..face].iter().filter(|other| *other == key).count();
                let place = (0..of_b.len()).filter(|&other| of_b[other] == *key).nth(earlier);
                assert_eq!(with.0[face], place.map_or(NO_FACE, |place| u32::try_from(place).unwrap()));
            }
            found += with.0.iter().filter(|&&other| other != NO_FACE).count();
        }
        assert!(found > 100, "{found}");
    }

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
