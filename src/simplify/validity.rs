//! Checks that the faces created by a collapse are well shaped and clear of all other faces.

use glam::DVec3;

use super::dynamic_mesh::{DynamicMesh, area_vector};
use crate::math::{Box3, GrowingTree, Tree, collinear, contact, longest_squared};

/// Budget of nearby faces that may be tested: per original face, and in total. Ordinary models need a small fraction.
const NEARBY_PER_FACE: u64 = 400;
const MIN_NEARBY: u64 = 10_000_000;

/// Relative distance of a vertex from a plane beyond which floating point decides the side with certainty.
const CERTAIN: f64 = 1e-10;

/// Cosine of the largest angle by which one collapse may turn a face.
const MIN_TURN_COSINE: f64 = 0.2;
/// Roundness below which a face is a needle, which must not become worse.
const NEEDLE: f64 = 1e-4;
/// Roundness below which a face that becomes worse defers the edge.
const SLENDER: f64 = 0.05;
/// Area of a triangle, relative to the square of its longest edge, above which the area is not just rounding.
const MIN_CERTAIN_AREA: f64 = 1e-12;

/// The effect of a collapse on face shapes.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    /// All faces keep or improve their shape sufficiently.
    Good,
    /// The collapse creates slender faces; it should be deferred.
    Poor,
    /// A face flips, loses its area or becomes a needle.
    Bad,
}

/// Classifies a collapse: `removed` are the faces that vanish, `changed` the other faces before and after it.
pub(super) fn shape(removed: &[[DVec3; 3]], changed: &[([DVec3; 3], [DVec3; 3])]) -> Shape {
    let mut least_before = removed.iter().map(|&f| roundness(f)).fold(1.0, f64::min);
    let mut least_after = 1.0f64;
    for &(before, after) in changed {
        let (n, m) = (area_vector(before), area_vector(after));
        let (long, square) = (longest_squared(after), n.length_squared() * m.length_squared());
        if m.length() <= MIN_CERTAIN_AREA * long && collinear(after[0], after[1], after[2]) {
            return Shape::Bad;
        }
        // A face without area cannot flip.
        if n.length() > MIN_CERTAIN_AREA * longest_squared(before) && n.dot(m) < MIN_TURN_COSINE * square.sqrt() {
            return Shape::Bad;
        }
        least_before = least_before.min(roundness(before));
        least_after = least_after.min(roundness(after));
    }
    match least_after {
        roundness if roundness >= SLENDER || roundness >= least_before => Shape::Good,
        roundness if roundness >= NEEDLE => Shape::Poor,
        _ => Shape::Bad,
    }
}

/// The roundness of a triangle: 1 if equilateral, 0 if without area. The ratio of the area to the sum of the squared
/// sides, normalised.
fn roundness([a, b, c]: [DVec3; 3]) -> f64 {
    let sides = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    if sides > 0.0 { 2.0 * 3f64.sqrt() * area_vector([a, b, c]).length() / sides } else { 0.0 }
}

/// A face with separating planes: its own plane, and the perpendicular planes through its edges, with outward normals.
struct SeparableFace {
    face: [u32; 3],
    bounds: Box3,
    corners: [DVec3; 3],
    /// The unit normal.
    normal: DVec3,
    /// For each edge, from a corner to the next, the outward unit normal of the perpendicular plane; zero if it is not
    /// usable.
    outward: [DVec3; 3],
}

impl SeparableFace {
    fn new(mesh: &DynamicMesh, face: [u32; 3]) -> Self {
        let corners = face.map(|v| mesh.at[v as usize]);
        let [a, b, c] = corners;
        let edges = [b - a, c - b, a - c];
        let normal = edges[0].cross(edges[1]).normalize_or_zero();
        let mut outward = edges.map(|edge| edge.cross(normal).normalize_or_zero());
        for (i, outward) in outward.iter_mut().enumerate() {
            // The third corner must be certainly inside.
            let third = corners[(i + 2) % 3] - corners[i];
            if outward.dot(third) > -CERTAIN {
                *outward = DVec3::ZERO;
            }
        }
        Self { face, bounds: Box3::of(corners), corners, normal, outward }
    }

    /// Whether one of the planes certainly separates this face from another. They then share only vertices with the
    /// same index, and the edge between those. If false, the faces may still be apart.
    ///
    /// A plane through an edge has the face on its inner side, and meets the face only in that edge. If every vertex of
    /// the other face is an end of the edge or beyond the plane, the faces share only those ends. The same holds for
    /// the face's own plane and all its corners. The normals are rounded, but an exact plane through the same points
    /// exists close enough to separate the faces as well.
    fn is_separated_from(&self, mesh: &DynamicMesh, other: [u32; 3]) -> bool {
        let beyond = |normal: DVec3, from: DVec3, ends: &[u32]| {
            other.iter().all(|v| ends.contains(v) || normal.dot(mesh.at[*v as usize] - from) > CERTAIN)
        };
        let [a, b, c] = self.face;
        let is_thick = self.outward.iter().all(|outward| *outward != DVec3::ZERO);
        (is_thick
            && (beyond(self.normal, self.corners[0], &self.face) || beyond(-self.normal, self.corners[0], &self.face)))
            || [[a, b], [b, c], [c, a]]
                .iter()
                .zip(self.outward)
                .zip(self.corners)
                .any(|((ends, outward), from)| outward != DVec3::ZERO && beyond(outward, from, ends))
    }
}

/// A tree over the current faces, to find those that new faces may intersect.
pub(super) struct Clearance {
    tree: GrowingTree,
    /// The face of each triangle of the tree, and the triangle of each face.
    face: Vec<u32>,
    triangle: Vec<u32>,
    stack: Vec<u32>,
    near: Vec<u32>,
    /// Number of faces that may still be tested.
    pub nearby_left: u64,
}

impl Clearance {
    /// Builds the tree over the current faces.
    pub fn new(mesh: &DynamicMesh) -> Self {
        let (tree, face) = tree_of(mesh);
        let triangle = face.clone();
        let nearby_left = MIN_NEARBY + NEARBY_PER_FACE * face.len() as u64;
        Self { tree, face, triangle, stack: Vec::new(), near: Vec::new(), nearby_left }
    }

    /// Rebuilds the tree once half of its faces are removed.
    pub fn refresh(&mut self, mesh: &DynamicMesh) {
        if mesh.alive * 2 < self.face.len() {
            (self.tree, self.face) = tree_of(mesh);
            for (&f, triangle) in self.face.iter().zip(0u32..) {
                self.triangle[f as usize] = triangle;
            }
        }
    }

    /// Grows the tree's boxes to cover a changed face.
    pub fn grow(&mut self, mesh: &DynamicMesh, face: u32) {
        self.tree.grow(self.triangle[face as usize], mesh.corners(face as usize));
    }

    /// Whether new faces meet neither each other nor another face, except in shared vertices and edges; exact. Faces
    /// that `is_ignored` accepts, and faces without area, are not tested.
    pub fn is_clear(&mut self, mesh: &DynamicMesh, new: &[[u32; 3]], is_ignored: impl Fn(u32) -> bool) -> bool {
        let mut slow = 0;
        let new: Vec<SeparableFace> = new.iter().map(|&face| SeparableFace::new(mesh, face)).collect();
        let mut apart = |a: &SeparableFace, b: [u32; 3]| {
            a.is_separated_from(mesh, b) || contact(&mesh.at, a.face, b, &mut slow).is_apart()
        };
        for (i, a) in new.iter().enumerate() {
            if !new[i + 1..].iter().all(|b| apart(a, b.face)) {
                return false;
            }
        }
        let bounds = Box3::of(new.iter().flat_map(|face| face.corners));
        let (near, face) = (&mut self.near, &self.face);
        near.clear();
        self.tree.overlapping(&bounds, &mut self.stack, |triangle| near.push(face[triangle as usize]));
        self.nearby_left = self.nearby_left.saturating_sub(near.len() as u64);
        near.retain(|&f| mesh.is_alive(f as usize) && !mesh.flat[f as usize] && !is_ignored(f));
        for &f in &*near {
            let face = mesh.faces[f as usize];
            let around = Box3::of(face.map(|v| mesh.at[v as usize]));
            if new.iter().any(|own| own.bounds.meets(&around) && !apart(own, face)) {
                return false;
            }
        }
        true
    }
}

/// The tree over the current faces, and the face of each of its triangles.
fn tree_of(mesh: &DynamicMesh) -> (GrowingTree, Vec<u32>) {
    let face: Vec<u32> = (0u32..).take(mesh.faces.len()).filter(|&f| mesh.is_alive(f as usize)).collect();
    let corners: Vec<[u32; 3]> = face.iter().map(|&f| mesh.faces[f as usize]).collect();
    (GrowingTree::new(Tree::new(&mesh.at, &corners)), face)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn faces_that_flip_or_lose_their_area_are_bad() {
        let with = |tip: DVec3| shape(&[], &[(BEFORE, [DVec3::ZERO, DVec3::X, tip])]);
        assert_eq!(with(DVec3::Y), Shape::Good);
        assert_eq!(with(-DVec3::Y), Shape::Bad);
        assert_eq!(with(DVec3::X * 3.0), Shape::Bad);
        assert_eq!(with(DVec3::new(0.5, 0.01, 0.0)), Shape::Poor);
        assert_eq!(with(DVec3::new(0.5, 1e-6, 0.0)), Shape::Bad);
    }

    #[test]
    fn a_slender_face_is_good_if_an_equally_slender_one_vanishes() {
        let slender = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.005, 0.0)];
        assert_eq!(shape(&[slender], &[(BEFORE, [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.01, 0.0)])]), Shape::Good);
    }
}
