//! Which faces have another behind them that is turned the other way. Most faces of a thick model have none within reach: one walk through
//! the tree rules out whole neighbourhoods, and a ray passes over what is not turned the other way.

use glam::{DVec3, Vec3A};
use obvhs::bvh2::Bvh2;
use rayon::prelude::*;
use smallvec::SmallVec;

use super::tree::{DEPTH, Tree, spend, triangles_of, vec3a};

/// Most faces of a neighbourhood, which is asked about as one.
const NEIGHBOURS: usize = 16;
/// Nodes that one question may look at. Where it does not end, the answer is yes.
const STEPS: usize = 512;
/// What f32 may lose of a length or of a cosine, and more.
const SLACK: f32 = 1e-4;

/// A box around vectors.
#[derive(Clone, Copy)]
struct Range {
    min: Vec3A,
    max: Vec3A,
}

impl Range {
    const EMPTY: Self = Self { min: Vec3A::INFINITY, max: Vec3A::NEG_INFINITY };

    fn of(vector: Vec3A) -> Self {
        Self { min: vector, max: vector }
    }

    fn is_empty(&self) -> bool {
        self.min.cmpgt(self.max).any()
    }

    fn and(self, other: Self) -> Self {
        Self { min: self.min.min(other.min), max: self.max.max(other.max) }
    }

    fn meets(&self, other: &Self) -> bool {
        self.min.cmple(other.max).all() && other.min.cmple(self.max).all()
    }

    /// The least dot product of a vector in one box and one in the other.
    fn least_dot(&self, other: &Self) -> f32 {
        let low = (self.min * other.min).min(self.min * other.max);
        let high = (self.max * other.min).min(self.max * other.max);
        low.min(high).element_sum()
    }
}

/// What is below a node: its box and its faces' normals.
#[derive(Clone, Copy)]
struct Below {
    bounds: Range,
    normals: Range,
    faces: usize,
}

/// The faces of a tree and the ways they are turned, to find those that are turned the other way than a given face: those whose
/// unit normals have a dot product of at most minus a cosine.
pub struct OppositeFaces<'a> {
    tree: &'a Tree,
    below: Vec<Below>,
    /// The dot product from which on two faces are not opposite, for certain.
    limit: f32,
}

impl Tree {
    /// Prepares the search for opposite faces. `normal` gives a face's unit normal, or zero for a face that is opposite to none.
    #[must_use]
    pub fn opposite_faces(&self, cosine: f64, normal: impl Fn(u32) -> DVec3) -> OppositeFaces<'_> {
        #[expect(clippy::cast_possible_truncation, reason = "rounded, with slack for it")]
        let limit = SLACK - cosine as f32;
        OppositeFaces { tree: self, below: self.below(normal), limit }
    }

    fn below(&self, normal: impl Fn(u32) -> DVec3) -> Vec<Below> {
        let Some(bvh) = &self.bvh else { return Vec::new() };
        let nothing = Below { bounds: Range::EMPTY, normals: Range::EMPTY, faces: 0 };
        let mut below = vec![nothing; bvh.nodes.len()];
        for at in self.children_first() {
            let node = &bvh.nodes[at as usize];
            let (normals, faces) = if node.is_leaf() {
                let own = triangles_of(bvh, node).iter();
                let normals = own.map(|&face| vec3a(normal(face))).filter(|n| *n != Vec3A::ZERO).map(Range::of);
                (normals.fold(Range::EMPTY, Range::and), node.prim_count as usize)
            } else {
                let [a, b] = [node.first_index, node.first_index + 1].map(|child| below[child as usize]);
                (a.normals.and(b.normals), a.faces + b.faces)
            };
            let aabb = node.aabb();
            below[at as usize] = Below { bounds: Range { min: aabb.min, max: aabb.max }, normals, faces };
        }
        below
    }
}

impl OppositeFaces<'_> {
    /// For each of `faces` faces whether an opposite one may be within `reach` behind it: a ray of that length from the face against
    /// its normal may meet one. It may also say so of a face that has none, but never the contrary.
    ///
    /// The time is linear in the faces, whatever their shape.
    #[must_use]
    pub fn may_be_within(&self, reach: f64, faces: usize) -> Vec<bool> {
        let mut answers = vec![false; faces];
        let Some(bvh) = &self.tree.bvh else { return answers };
        #[expect(clippy::cast_possible_truncation, reason = "rounded, with slack for it")]
        let reach = (reach * self.tree.frame.scale()) as f32 * (1.0 + SLACK) + SLACK * SLACK;
        let yes: Vec<u32> = neighbourhoods(bvh, &self.below)
            .into_par_iter()
            .filter(|&node| self.meets_swept(bvh, &self.below[node as usize], reach))
            .collect();
        for node in yes {
            for face in faces_below(bvh, node) {
                answers[face as usize] = true;
            }
        }
        answers
    }

    /// Whether the volume that faces sweep on their way against their normals meets the box of a leaf with an opposite face.
    fn meets_swept(&self, bvh: &Bvh2, faces: &Below, reach: f32) -> bool {
        let normals = faces.normals;
        if normals.is_empty() {
            return false;
        }
        let swept = Range {
            min: faces.bounds.min - normals.max.max(Vec3A::ZERO) * reach,
            max: faces.bounds.max - normals.min.min(Vec3A::ZERO) * reach,
        };
        let wanted = |at: u32| self.may_be_opposite(at, &normals) && self.below[at as usize].bounds.meets(&swept);
        let (mut stack, mut steps) = (vec![0u32], 0);
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            steps += 1;
            if node.is_leaf() || steps > STEPS {
                return true;
            }
            stack.extend([node.first_index + 1, node.first_index].into_iter().filter(|&child| wanted(child)));
        }
        false
    }

    /// Whether `is_met` says yes to a face that is opposite to one with the unit normal `normal` and whose box the segment from `from`
    /// to `to` meets. It is asked about others too. `steps` as in [`Tree::nearest`]; where it reaches 0 the answer is yes.
    pub fn any_along(
        &self,
        [from, to]: [DVec3; 2],
        normal: DVec3,
        steps: &mut u64,
        is_met: impl Fn(u32) -> bool,
    ) -> bool {
        let Some(bvh) = &self.tree.bvh else { return false };
        let (segment, normals) = (self.tree.segment(from, to), Range::of(vec3a(normal)));
        let wanted =
            |at: u32| self.may_be_opposite(at, &normals) && segment.enters(bvh.nodes[at as usize].aabb()).is_some();
        let mut stack: SmallVec<[u32; DEPTH]> = SmallVec::new();
        stack.extend(wanted(0).then_some(0));
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if !spend(steps, node) {
                return true;
            }
            if node.is_leaf() {
                if triangles_of(bvh, node).iter().any(|&face| is_met(face)) {
                    return true;
                }
                continue;
            }
            for child in [node.first_index + 1, node.first_index] {
                if wanted(child) {
                    stack.push(child);
                }
            }
        }
        false
    }

    /// Whether a face below a node may be opposite to one whose normal is in a box.
    fn may_be_opposite(&self, node: u32, normals: &Range) -> bool {
        let below = &self.below[node as usize].normals;
        let dot = below.least_dot(normals);
        !below.is_empty() && (dot <= self.limit || dot.is_nan())
    }
}

/// The nodes nearest to the root that have few faces. Together they have all faces.
fn neighbourhoods(bvh: &Bvh2, below: &[Below]) -> Vec<u32> {
    let (mut found, mut stack) = (Vec::new(), vec![0u32]);
    while let Some(at) = stack.pop() {
        let node = &bvh.nodes[at as usize];
        if node.is_leaf() || below[at as usize].faces <= NEIGHBOURS {
            found.push(at);
        } else {
            stack.extend([node.first_index + 1, node.first_index]);
        }
    }
    found
}

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
    fn a_face_with_an_opposite_one_within_reach_is_never_ruled_out() {
        // Groups of 40 faces that are turned alike, near each other: a neighbourhood is within one or two of them.
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
        let (mut with, mut ruled_out) = (0, 0);
        for reach in [0.01, 0.1, 0.4] {
            let answers = may_have_opposite(&positions, &faces, reach);
            for (face, &answer) in answers.iter().enumerate() {
                let [a, b, c] = corners(face);
                let normal = unit_normal([a, b, c]);
                let (from, step) = ((a + b + c) / 3.0, -normal * reach);
                let is_met = |other: u32| {
                    let other = corners(other as usize);
                    unit_normal(other).dot(normal) <= -COSINE && hit(from, step, other).is_some()
                };
                let meets = (0u32..).take(faces.len()).any(is_met);
                assert!(answer || !meets, "face {face} within {reach}");
                assert_eq!(opposite.any_along([from, from + step], normal, &mut u64::MAX.clone(), is_met), meets);
                with += u32::from(meets);
                ruled_out += u32::from(!answer);
            }
        }
        assert!(with > 100 && ruled_out > 100, "{with} with an opposite face, {ruled_out} ruled out");
    }

    #[test]
    fn two_plates_rule_each_other_out_beyond_their_distance_only() {
        let row = |z: f64| (0..64).map(move |i| DVec3::new(f64::from(i / 2), f64::from(i % 2), z));
        let positions: Vec<DVec3> = row(0.0).chain(row(1.0)).collect();
        let strip = |from: u32, up: bool| {
            (0..62).map(move |i| {
                let [a, b, c] = [from + i, from + i + 1, from + i + 2];
                if up == (i % 2 == 1) { [a, b, c] } else { [a, c, b] }
            })
        };
        // The lower plate faces down and the upper one up: material is between them.
        let outward: Vec<[u32; 3]> = strip(0, false).chain(strip(64, true)).collect();
        assert!(outward[62..].iter().all(|face| unit_normal(face.map(|v| positions[v as usize])) == DVec3::Z));
        assert!(may_have_opposite(&positions, &outward, 1.01).iter().all(|&may| may));
        assert!(may_have_opposite(&positions, &outward, 0.99).iter().all(|&may| !may));
        // Turned the other way, air is between them, and behind each plate is nothing.
        let inward: Vec<[u32; 3]> = outward.iter().map(|&[a, b, c]| [a, c, b]).collect();
        assert!(may_have_opposite(&positions, &inward, 1.01).iter().all(|&may| !may));
    }
}
