//! Whether the faces that a collapse makes are well shaped, and clear of all others.

use glam::DVec3;

use super::complex::{Complex, area_vector};
use crate::math::{Box3, GrowingTree, Tree, collinear, contact};

/// Faces near new ones, for each face at the start and in all, that may be looked at: many times what a usual model needs.
const NEAR_A_FACE: u64 = 400;
const NEAR: u64 = 10_000_000;

/// How far beyond a plane a vertex is, as a share of the lengths concerned, for floating point to say so for certain.
const CERTAIN: f64 = 1e-10;

/// Cosine of the largest angle by which one collapse may turn a face.
const LEAST_COSINE: f64 = 0.2;
/// Roundness below which a face is a needle: then it must not become worse.
const NEEDLE: f64 = 1e-4;
/// Roundness below which a worse face makes an edge wait for others.
const SLENDER: f64 = 0.05;
/// Share of the square of its longest edge above which a triangle's area is not a matter of rounding.
const CERTAIN_AREA: f64 = 1e-12;

/// How a collapse changes the shapes of faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Good,
    /// Slender faces come about: better later, or elsewhere.
    Poor,
    /// A face turns over, has no area or becomes a needle.
    Bad,
}

/// Judges what becomes of faces: `gone` are those that vanish, `changed` those before and after.
pub(super) fn shape(gone: &[[DVec3; 3]], changed: &[([DVec3; 3], [DVec3; 3])]) -> Shape {
    let mut least_before = gone.iter().map(|&f| roundness(f)).fold(1.0, f64::min);
    let mut least_after = 1.0f64;
    for &(before, after) in changed {
        let (n, m) = (area_vector(before), area_vector(after));
        let (long, square) = (longest_squared(after), n.length_squared() * m.length_squared());
        if m.length() <= CERTAIN_AREA * long && collinear(after[0], after[1], after[2]) {
            return Shape::Bad;
        }
        // A face without area has no side to turn over.
        if n.length() > CERTAIN_AREA * longest_squared(before) && n.dot(m) < LEAST_COSINE * square.sqrt() {
            return Shape::Bad;
        }
        least_before = least_before.min(roundness(before));
        least_after = least_after.min(roundness(after));
    }
    match least_after {
        it if it >= SLENDER || it >= least_before => Shape::Good,
        it if it >= NEEDLE => Shape::Poor,
        _ => Shape::Bad,
    }
}

/// 1 for an equilateral triangle, 0 for one without area: its area for the sum of its squared sides.
fn roundness([a, b, c]: [DVec3; 3]) -> f64 {
    let sides = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    if sides > 0.0 { 2.0 * 3f64.sqrt() * area_vector([a, b, c]).length() / sides } else { 0.0 }
}

fn longest_squared([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
}

/// A face with planes that part it from others: its own, and those that stand on its edges, with normals outward.
struct Fenced {
    face: [u32; 3],
    bounds: Box3,
    corners: [DVec3; 3],
    /// Its normal, of unit length.
    normal: DVec3,
    /// For the edge from each corner to the next the normal of the plane on it, of unit length.
    outward: [DVec3; 3],
}

impl Fenced {
    fn new(it: &Complex, face: [u32; 3]) -> Self {
        let corners = face.map(|v| it.at[v as usize]);
        let [a, b, c] = corners;
        let edges = [b - a, c - b, a - c];
        let normal = edges[0].cross(edges[1]).normalize_or_zero();
        let mut outward = edges.map(|edge| edge.cross(normal).normalize_or_zero());
        for (i, outward) in outward.iter_mut().enumerate() {
            // The third corner must be inside for certain.
            let third = corners[(i + 2) % 3] - corners[i];
            if outward.dot(third) > -CERTAIN {
                *outward = DVec3::ZERO;
            }
        }
        Self { face, bounds: Box3::of(corners), corners, normal, outward }
    }

    /// Whether one of the planes parts it from another face for certain, so that they have nothing in common but the vertices that they
    /// share by their numbers, and the edge between those. Where it is not, they may still be apart.
    ///
    /// A plane on an edge has the face on its inner side, with nothing but the edge on the plane. Where every vertex of the other face is
    /// an end of the edge or beyond the plane, the two have only those ends in common. The same holds for the face's own
    /// plane and all its corners. The normals are rounded, but a plane through the same points that does the same is near enough.
    fn is_parted_from(&self, it: &Complex, other: [u32; 3]) -> bool {
        let beyond = |normal: DVec3, from: DVec3, ends: &[u32]| {
            other.iter().all(|v| ends.contains(v) || normal.dot(it.at[*v as usize] - from) > CERTAIN)
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

/// The faces as a tree, to find those that new faces may intersect.
pub(super) struct Clearance {
    tree: GrowingTree,
    /// The face of each triangle of the tree, and the other way round.
    face: Vec<u32>,
    triangle: Vec<u32>,
    stack: Vec<u32>,
    near: Vec<u32>,
    /// Faces that may still be looked at.
    pub near_left: u64,
}

impl Clearance {
    pub fn new(it: &Complex) -> Self {
        let (tree, face) = tree_of(it);
        let triangle = face.clone();
        let near_left = NEAR + NEAR_A_FACE * face.len() as u64;
        Self { tree, face, triangle, stack: Vec::new(), near: Vec::new(), near_left }
    }

    /// Builds a new tree where half of the faces are gone.
    pub fn refresh(&mut self, it: &Complex) {
        if it.alive * 2 < self.face.len() {
            (self.tree, self.face) = tree_of(it);
            for (&f, triangle) in self.face.iter().zip(0u32..) {
                self.triangle[f as usize] = triangle;
            }
        }
    }

    /// Makes room for a face that has changed.
    pub fn grow(&mut self, it: &Complex, face: u32) {
        self.tree.grow(self.triangle[face as usize], it.corners(face as usize));
    }

    /// Whether new faces meet no other face, exactly, but in the vertices and edges that they share, and neither one another.
    /// Faces that `passes_over` names are not asked. Faces without area have no inside and are not asked either.
    pub fn is_clear(&mut self, it: &Complex, new: &[[u32; 3]], passes_over: impl Fn(u32) -> bool) -> bool {
        let mut slow = 0;
        let new: Vec<Fenced> = new.iter().map(|&face| Fenced::new(it, face)).collect();
        let mut apart =
            |a: &Fenced, b: [u32; 3]| a.is_parted_from(it, b) || contact(&it.at, a.face, b, &mut slow).is_apart();
        for (i, a) in new.iter().enumerate() {
            if !new[i + 1..].iter().all(|b| apart(a, b.face)) {
                return false;
            }
        }
        let bounds = Box3::of(new.iter().flat_map(|it| it.corners));
        let (near, face) = (&mut self.near, &self.face);
        near.clear();
        self.tree.overlapping(&bounds, &mut self.stack, |triangle| near.push(face[triangle as usize]));
        self.near_left = self.near_left.saturating_sub(near.len() as u64);
        near.retain(|&f| it.is_alive(f as usize) && !it.flat[f as usize] && !passes_over(f));
        for &f in &*near {
            let face = it.faces[f as usize];
            let around = Box3::of(face.map(|v| it.at[v as usize]));
            if new.iter().any(|own| own.bounds.meets(&around) && !apart(own, face)) {
                return false;
            }
        }
        true
    }
}

fn tree_of(it: &Complex) -> (GrowingTree, Vec<u32>) {
    let face: Vec<u32> = (0u32..).take(it.faces.len()).filter(|&f| it.is_alive(f as usize)).collect();
    let corners: Vec<[u32; 3]> = face.iter().map(|&f| it.faces[f as usize]).collect();
    (GrowingTree::new(Tree::new(&it.at, &corners)), face)
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn faces_that_turn_over_or_lose_their_area_are_bad() {
        let with = |tip: DVec3| shape(&[], &[(BEFORE, [DVec3::ZERO, DVec3::X, tip])]);
        assert_eq!(with(DVec3::Y), Shape::Good);
        assert_eq!(with(-DVec3::Y), Shape::Bad);
        assert_eq!(with(DVec3::X * 3.0), Shape::Bad);
        assert_eq!(with(DVec3::new(0.5, 0.01, 0.0)), Shape::Poor);
        assert_eq!(with(DVec3::new(0.5, 1e-6, 0.0)), Shape::Bad);
    }

    #[test]
    fn a_slender_face_is_good_where_one_as_slender_goes() {
        let slender = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.005, 0.0)];
        assert_eq!(shape(&[slender], &[(BEFORE, [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.01, 0.0)])]), Shape::Good);
    }
}
