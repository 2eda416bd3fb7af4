//! Finds faces that have an oppositely oriented face behind them, as thin walls do. In a thick model most faces have
//! none within reach: one traversal rules out a whole cluster of faces, and ray queries skip faces that are not
//! opposite.

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use smallvec::SmallVec;

use super::boxes::Box3;
use super::threads::{self, FEW_SEARCHES};
use super::tree::{DEPTH, Tree, spend, triangles_of, vec3a};

/// Maximum faces of a cluster, which is tested as a whole.
const CLUSTER_FACES: u8 = 16;
/// Maximum nodes visited per cluster. A cluster that exceeds the limit is not ruled out.
const MAX_STEPS: usize = 512;
/// Upper bound of the f32 rounding error of a length or a cosine, with a margin.
const SLACK: f32 = 1e-4;

/// A bounding box of vectors in f32.
#[derive(Clone, Copy)]
struct Range {
    min: Vec3A,
    max: Vec3A,
}

impl From<&Aabb> for Range {
    fn from(aabb: &Aabb) -> Self {
        Self { min: aabb.min, max: aabb.max }
    }
}

impl Range {
    fn meets(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// Lower bound of the dot product of a vector in this box and one in the other.
    fn least_dot(&self, other: &Self) -> f32 {
        let low = (self.min * other.min).min(self.min * other.max);
        let high = (self.max * other.min).min(self.max * other.max);
        low.min(high).element_sum()
    }
}

/// Steps of a coordinate of a unit normal in a [`Subtree`].
const STEPS: f32 = 127.0;

/// Summary of a node's subtree: the range of its faces' normals, and the number of its faces. Small, since a large mesh
/// has millions of nodes.
#[derive(Clone, Copy)]
struct Subtree {
    /// The range of the normals, rounded outward to whole steps. Empty if the lower bounds are above the upper ones.
    low: [i8; 3],
    high: [i8; 3],
    /// The number of faces, at most one more than a cluster has.
    faces: u8,
}

impl Subtree {
    const EMPTY: Self = Self { low: [i8::MAX; 3], high: [i8::MIN; 3], faces: 0 };

    fn of_normal(normal: Vec3A) -> Self {
        #[expect(clippy::cast_possible_truncation, reason = "unit vectors")]
        let steps = |vector: Vec3A| vector.to_array().map(|x| x as i8);
        Self { low: steps((normal * STEPS).floor()), high: steps((normal * STEPS).ceil()), faces: 0 }
    }

    fn and(self, other: Self) -> Self {
        let each = |of: fn(i8, i8) -> i8, [a, b, c]: [i8; 3], [d, e, f]: [i8; 3]| [of(a, d), of(b, e), of(c, f)];
        Self {
            low: each(i8::min, self.low, other.low),
            high: each(i8::max, self.high, other.high),
            faces: (self.faces + other.faces).min(CLUSTER_FACES + 1),
        }
    }

    /// Whether no face below is opposite to any.
    fn is_empty(&self) -> bool {
        self.low[0] > self.high[0]
    }

    fn normals(&self) -> Range {
        let vector = |[x, y, z]: [i8; 3]| Vec3A::new(x.into(), y.into(), z.into()) * (1.0 / STEPS);
        Range { min: vector(self.low), max: vector(self.high) }
    }

    /// Lower bound of the dot product of `STEPS * scaled` and the normal of a face below. Positive if there is no such face.
    fn least_dot(&self, scaled: [f32; 3]) -> f32 {
        let along = |axis: usize| scaled[axis] * f32::from(if scaled[axis] < 0.0 { self.high } else { self.low }[axis]);
        along(0) + along(1) + along(2)
    }
}

/// Search for opposite faces in a tree. Two faces are opposite if the dot product of their unit normals is at most
/// minus a given cosine.
pub struct OppositeFaces<'a> {
    tree: &'a Tree,
    below: Vec<Subtree>,
    /// Two faces whose normals have a larger dot product are certainly not opposite.
    limit: f32,
}

impl Tree {
    /// Prepares the search for opposite faces. `normal` returns a face's unit normal, or zero for a face that is
    /// opposite to none.
    #[must_use]
    pub fn opposite_faces(&self, cosine: f64, normal: impl Fn(u32) -> DVec3 + Sync) -> OppositeFaces<'_> {
        #[expect(clippy::cast_possible_truncation, reason = "rounded; the slack covers the rounding")]
        let limit = SLACK - cosine as f32;
        OppositeFaces { tree: self, below: self.below(normal), limit }
    }

    /// The summary of each node's subtree.
    fn below(&self, normal: impl Fn(u32) -> DVec3 + Sync) -> Vec<Subtree> {
        let of_leaf = |_: &Bvh2Node, faces: &[u32]| {
            let normals = faces.iter().map(|&face| vec3a(normal(face))).filter(|n| *n != Vec3A::ZERO);
            let all = normals.map(Subtree::of_normal).fold(Subtree::EMPTY, Subtree::and);
            Subtree { faces: faces.len().min(usize::from(CLUSTER_FACES) + 1) as u8, ..all }
        };
        self.summaries(Subtree::EMPTY, of_leaf, |_, [left, right]| left.and(right))
    }
}

impl OppositeFaces<'_> {
    /// For each of `faces` faces, whether an opposite face may lie within `reach` behind it: a ray of that length
    /// against the face's normal may hit one. False positives are possible, false negatives are not.
    ///
    /// Takes time linear in the number of faces, whatever their shape.
    #[must_use]
    pub fn may_be_within(&self, reach: f64, faces: usize) -> Vec<bool> {
        let reach = self.reach_in_tree(reach);
        self.may_be_in(faces, |own, normals| Range {
            min: own.min - normals.max.max(Vec3A::ZERO) * reach,
            max: own.max - normals.min.min(Vec3A::ZERO) * reach,
        })
    }

    /// For each of `faces` faces, whether an opposite face may come within `reach` of it, in any direction. Otherwise
    /// like [`OppositeFaces::may_be_within`].
    #[must_use]
    pub fn may_be_near(&self, reach: f64, faces: usize) -> Vec<bool> {
        let reach = Vec3A::splat(self.reach_in_tree(reach));
        self.may_be_in(faces, |own, _| Range { min: own.min - reach, max: own.max + reach })
    }

    /// A length in the tree's frame, rounded up.
    fn reach_in_tree(&self, reach: f64) -> f32 {
        #[expect(clippy::cast_possible_truncation, reason = "rounded; the slack covers the rounding")]
        {
            (reach * self.tree.frame.scale()) as f32 * (1.0 + SLACK) + SLACK * SLACK
        }
    }

    /// For each of `faces` faces, whether an opposite face may be in the volume that `volume` returns for the bounding
    /// box and the normals of the face's cluster.
    fn may_be_in(&self, faces: usize, volume: impl Fn(&Range, &Range) -> Range + Sync) -> Vec<bool> {
        let mut answers = vec![false; faces];
        let Some(bvh) = &self.tree.bvh else { return answers };
        let clusters = clusters(bvh, &self.below);
        let may_meet = threads::map(clusters.len(), FEW_SEARCHES, |i| self.meets_in(bvh, clusters[i], &volume));
        for (&node, _) in clusters.iter().zip(may_meet).filter(|(_, may_meet)| *may_meet) {
            for face in faces_below(bvh, node) {
                answers[face as usize] = true;
            }
        }
        answers
    }

    /// Whether the volume for a cluster meets the box of a leaf with an opposite face.
    fn meets_in(&self, bvh: &Bvh2, cluster: u32, volume: impl Fn(&Range, &Range) -> Range) -> bool {
        let bounds = |at: u32| Range::from(bvh.nodes[at as usize].aabb());
        let below = self.below[cluster as usize];
        if below.is_empty() {
            return false;
        }
        let normals = below.normals();
        let volume = volume(&bounds(cluster), &normals);
        let may_hit = |at: u32| self.may_be_opposite(at, &normals) && bounds(at).meets(&volume);
        let (mut stack, mut steps) = (vec![0u32], 0);
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            steps += 1;
            if node.is_leaf() || steps > MAX_STEPS {
                return true;
            }
            stack.extend([node.first_index + 1, node.first_index].into_iter().filter(|&child| may_hit(child)));
        }
        false
    }

    /// Whether `is_hit` accepts a face that is opposite to the unit normal `normal` and whose box meets the segment
    /// from `from` to `to`. `is_hit` may also be called for other faces. `steps` as in [`Tree::nearest`]; when it
    /// reaches 0 the result is true.
    pub fn any_along(
        &self,
        [from, to]: [DVec3; 2],
        normal: DVec3,
        steps: &mut u64,
        is_hit: impl Fn(u32) -> bool,
    ) -> bool {
        let segment = self.tree.segment(from, to);
        self.any(normal, steps, |aabb| segment.enters(aabb).is_some(), is_hit)
    }

    /// Whether `is_hit` accepts a face that is opposite to the unit normal `normal` and whose box meets the volume that a
    /// triangle sweeps when it is moved by `step`. Otherwise like [`OppositeFaces::any_along`].
    pub fn any_swept(
        &self,
        (triangle, step): ([DVec3; 3], DVec3),
        normal: DVec3,
        steps: &mut u64,
        is_hit: impl FnMut(u32) -> bool,
    ) -> bool {
        let bounds = Box3::of(triangle);
        let centre = bounds.centre();
        let half = vec3a((bounds.max - centre) * self.tree.frame.scale()) * (1.0 + SLACK);
        let segment = self.tree.segment(centre, centre + step).widened(half);
        self.any(normal, steps, |aabb| segment.enters(aabb).is_some(), is_hit)
    }

    fn any(
        &self,
        normal: DVec3,
        steps: &mut u64,
        meets: impl Fn(&Aabb) -> bool,
        mut is_hit: impl FnMut(u32) -> bool,
    ) -> bool {
        let Some(bvh) = &self.tree.bvh else { return false };
        let scaled = (vec3a(normal) * (1.0 / STEPS)).to_array();
        let may_hit = |at: u32| {
            let dot = self.below[at as usize].least_dot(scaled);
            self.allows(dot) && meets(bvh.nodes[at as usize].aabb())
        };
        let mut stack: SmallVec<[u32; DEPTH]> = SmallVec::new();
        stack.extend(may_hit(0).then_some(0));
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if !spend(steps, node) {
                return true;
            }
            if node.is_leaf() {
                if triangles_of(bvh, node).iter().any(|&face| is_hit(face)) {
                    return true;
                }
                continue;
            }
            for child in [node.first_index + 1, node.first_index] {
                if may_hit(child) {
                    stack.push(child);
                }
            }
        }
        false
    }

    /// Whether a face below a node may be opposite to one of the normals in a range.
    fn may_be_opposite(&self, node: u32, normals: &Range) -> bool {
        let below = self.below[node as usize];
        let dot = below.normals().least_dot(normals);
        !below.is_empty() && self.allows(dot)
    }

    /// Whether two faces may be opposite if the dot product of their normals is at least `dot`.
    fn allows(&self, dot: f32) -> bool {
        dot <= self.limit || dot.is_nan()
    }
}

/// The nodes nearest to the root with at most [`CLUSTER_FACES`] faces. Together they contain all faces.
fn clusters(bvh: &Bvh2, below: &[Subtree]) -> Vec<u32> {
    let (mut found, mut stack) = (Vec::new(), vec![0u32]);
    while let Some(at) = stack.pop() {
        let node = &bvh.nodes[at as usize];
        if node.is_leaf() || below[at as usize].faces <= CLUSTER_FACES {
            found.push(at);
        } else {
            stack.extend([node.first_index + 1, node.first_index]);
        }
    }
    found
}

/// The faces of a node's subtree.
fn faces_below(bvh: &Bvh2, root: u32) -> Vec<u32> {
    let (mut found, mut stack) = (Vec::new(), vec![root]);
    while let Some(at) = stack.pop() {
        let node = &bvh.nodes[at as usize];
        if node.is_leaf() {
            found.extend(triangles_of(bvh, node));
        } else {
            stack.extend([node.first_index + 1, node.first_index]);
        }
    }
    found
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::{hit, r3};

    const COSINE: f64 = 0.866;

    fn may_have_opposite(positions: &[DVec3], faces: &[[u32; 3]], reach: f64) -> Vec<bool> {
        let normal = |face: u32| unit_normal(faces[face as usize].map(|v| positions[v as usize]));
        Tree::new(positions, faces).opposite_faces(COSINE, normal).may_be_within(reach, faces.len())
    }

    fn unit_normal([a, b, c]: [DVec3; 3]) -> DVec3 {
        (b - a).cross(c - a).normalize_or_zero()
    }

    #[test]
    fn a_face_with_an_opposite_face_within_reach_is_never_ruled_out() {
        // Groups of 40 nearby faces with similar orientation: each cluster lies within one or two groups.
        let corner = |i: u32| {
            let (group, k) = (i / 120, i % 3);
            let centre = DVec3::from(r3(f64::from(group))) + DVec3::from(r3(f64::from(i / 3 + 500))) * 0.1;
            centre + DVec3::from(r3(f64::from(7000 + 3 * group + k))) * 0.2
        };
        let positions: Vec<DVec3> = (0..6000).map(corner).collect();
        let faces: Vec<[u32; 3]> = (0..2000).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let corners = |face: usize| faces[face].map(|v| positions[v as usize]);
        let tree = Tree::new(&positions, &faces);
        let opposite = tree.opposite_faces(COSINE, |face| unit_normal(corners(face as usize)));
        let (mut opposite_count, mut ruled_out_count) = (0, 0);
        for reach in [0.01, 0.1, 0.4] {
            let answers = may_have_opposite(&positions, &faces, reach);
            for (face, &answer) in answers.iter().enumerate() {
                let [a, b, c] = corners(face);
                let normal = unit_normal([a, b, c]);
                let (from, step) = ((a + b + c) / 3.0, -normal * reach);
                let is_hit = |other: u32| {
                    let other = corners(other as usize);
                    unit_normal(other).dot(normal) <= -COSINE && hit(from, step, other).is_some()
                };
                let meets = (0u32..).take(faces.len()).any(is_hit);
                assert!(answer || !meets, "face {face} within {reach}");
                assert_eq!(opposite.any_along([from, from + step], normal, &mut u64::MAX.clone(), is_hit), meets);
                let is_hit_from_corner = |other: u32| {
                    let other = corners(other as usize);
                    unit_normal(other).dot(normal) <= -COSINE
                        && [a, b, c].iter().any(|&p| hit(p, step, other).is_some())
                };
                let is_below = (0u32..).take(faces.len()).any(is_hit_from_corner);
                let swept = ([a, b, c], step);
                assert_eq!(opposite.any_swept(swept, normal, &mut u64::MAX.clone(), is_hit_from_corner), is_below);
                opposite_count += u32::from(meets);
                ruled_out_count += u32::from(!answer);
            }
        }
        assert!(
            opposite_count > 100 && ruled_out_count > 100,
            "{opposite_count} with an opposite face, {ruled_out_count} ruled out"
        );
    }

    #[test]
    fn two_plates_are_opposite_exactly_within_their_distance() {
        let row = |z: f64| (0..64).map(move |i| DVec3::new(f64::from(i / 2), f64::from(i % 2), z));
        let positions: Vec<DVec3> = row(0.0).chain(row(1.0)).collect();
        let strip = |from: u32, up: bool| {
            (0..62).map(move |i| {
                let [a, b, c] = [from + i, from + i + 1, from + i + 2];
                if up == (i % 2 == 1) { [a, b, c] } else { [a, c, b] }
            })
        };
        // The lower plate faces down and the upper one up, so the material lies between them.
        let outward: Vec<[u32; 3]> = strip(0, false).chain(strip(64, true)).collect();
        assert!(outward[62..].iter().all(|face| unit_normal(face.map(|v| positions[v as usize])) == DVec3::Z));
        assert!(may_have_opposite(&positions, &outward, 1.01).iter().all(|&may| may));
        assert!(may_have_opposite(&positions, &outward, 0.99).iter().all(|&may| !may));
        // Flipped, the plates have air between them, and nothing behind them.
        let inward: Vec<[u32; 3]> = outward.iter().map(|&[a, b, c]| [a, c, b]).collect();
        assert!(may_have_opposite(&positions, &inward, 1.01).iter().all(|&may| !may));
        // But each is near the other, on whichever side.
        for faces in [outward, inward] {
            let tree = Tree::new(&positions, &faces);
            let opposite =
                tree.opposite_faces(COSINE, |face| unit_normal(faces[face as usize].map(|v| positions[v as usize])));
            assert!(opposite.may_be_near(1.01, faces.len()).iter().all(|&may| may));
            assert!(opposite.may_be_near(0.99, faces.len()).iter().all(|&may| !may));
        }
    }
}
