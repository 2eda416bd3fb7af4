//! A bounding volume hierarchy over triangles: construction, box queries, and refitting for triangles that move.

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use smallvec::SmallVec;

use super::boxes::Box3;
use super::bvh_build::{self, Built};
use super::threads;

/// How far a box in the tree extends beyond its triangle, in units of half the model's longest side. It covers the
/// rounding of the tree's frame, plus a spread that makes equal boxes differ (see [`Tree::new`]).
const PAD: f64 = 1e-6;

/// Initial capacity of a traversal's stack, the usual depth of a tree. Queries are many and short.
pub(super) const DEPTH: usize = 64;

/// Distance, in half-sides of the model, beyond which the whole model is at one distance up to rounding.
pub(super) const FAR: f64 = 1.152_921_504_606_847e18; // 2^60

/// A bounding volume hierarchy over triangles, which finds the few that a segment may meet or that lie near a point.
///
/// Queries return candidates, not hits: boxes are in f32 and rounded outward, and the exact predicates decide.
#[derive(Clone)]
pub struct Tree {
    /// The hierarchy; none without triangles.
    pub(crate) bvh: Option<Bvh2>,
    /// The coordinate frame of the boxes.
    pub(crate) frame: Frame,
    /// Ranges of nodes whose subtrees are within the range; they follow the nodes that join them.
    chunks: Vec<std::ops::Range<usize>>,
}

impl Tree {
    /// Builds the tree. The same triangles give the same tree. All positions that faces use must be finite.
    ///
    /// The builder takes quadratic time for many equal boxes. To avoid this, each box is widened by an amount hashed
    /// from its index.
    #[must_use]
    pub fn new(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        Self::in_frame(Frame::around(positions, faces), positions, faces)
    }

    /// Builds a tree over boxes, which its queries call triangles.
    #[must_use]
    pub fn of_boxes(boxes: &[Box3]) -> Self {
        let corners: Vec<DVec3> = boxes.iter().flat_map(|bounds| [bounds.min, bounds.max]).collect();
        #[expect(clippy::cast_possible_truncation, reason = "boxes are counted in u32")]
        let faces: Vec<[u32; 3]> = (0..boxes.len() as u32).map(|i| [2 * i, 2 * i + 1, 2 * i]).collect();
        Self::new(&corners, &faces)
    }

    /// Builds the tree in a frame that may cover more than these triangles, such as those of another tree.
    #[must_use]
    pub fn in_frame(frame: Frame, positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        if faces.is_empty() {
            return Self { bvh: None, frame, chunks: Vec::new() };
        }
        let corners = |index: usize| faces[index].map(|v| frame.to_tree(positions[v as usize]));
        let centre_of = |index: usize| corners(index).into_iter().sum::<DVec3>() / 3.0;
        let Built { bvh, chunks } = bvh_build::build(faces.len(), centre_of, |index| {
            let b = Box3::of(corners(index));
            // The pad exceeds the f32 rounding in [-1, 1].
            let pad = DVec3::splat(PAD * (1.0 + jitter(index)));
            Aabb::new(vec3a(b.min - pad), vec3a(b.max + pad))
        });
        Self { bvh: Some(bvh), frame, chunks }
    }

    /// A value for each node: of a leaf, `of_leaf` of its triangles; of any other node, `of_children` of the values of
    /// its two children. Both functions also receive the node.
    pub(crate) fn summaries<T: Copy + Send + Sync>(
        &self,
        empty: T,
        of_leaf: impl Fn(&Bvh2Node, &[u32]) -> T + Sync,
        of_children: impl Fn(&Bvh2Node, [T; 2]) -> T + Sync,
    ) -> Vec<T> {
        let Some(bvh) = &self.bvh else { return Vec::new() };
        let mut values = vec![empty; bvh.nodes.len()];
        // Children come after their parents.
        let summarize = |values: &mut [T], begin: usize, end: usize| {
            for at in (begin..end).rev() {
                let node = &bvh.nodes[at];
                values[at - begin] = if node.is_leaf() {
                    of_leaf(node, triangles_of(bvh, node))
                } else {
                    let first = node.first_index as usize - begin;
                    of_children(node, [values[first], values[first + 1]])
                };
            }
        };
        let joining = self.chunks.first().map_or(bvh.nodes.len(), |chunk| chunk.start);
        let mut rest = &mut values[joining..];
        let mut parts = Vec::with_capacity(self.chunks.len());
        for chunk in &self.chunks {
            let (part, after) = rest.split_at_mut(chunk.len());
            parts.push((part, chunk));
            rest = after;
        }
        threads::for_each(parts, |(part, chunk)| summarize(part, chunk.start, chunk.end));
        summarize(&mut values, 0, joining);
        values
    }

    /// Calls `visit` with every triangle whose box comes within `reach` of a point along each axis, until `visit`
    /// returns `false`.
    pub fn around(&self, point: DVec3, reach: f64, visit: impl FnMut(u32) -> bool) {
        let centre = self.frame.to_tree(point);
        let reach = DVec3::splat(reach * self.frame.scale());
        self.between(centre - reach, centre + reach, visit);
    }

    /// Calls `visit` with every triangle whose box meets `bounds`, until `visit` returns `false`.
    pub fn overlapping(&self, bounds: &Box3, visit: impl FnMut(u32) -> bool) {
        self.between(self.frame.to_tree(bounds.min), self.frame.to_tree(bounds.max), visit);
    }

    /// Whether `is_wanted` holds for a triangle whose box meets `bounds`.
    #[must_use]
    pub fn any_overlapping(&self, bounds: &Box3, mut is_wanted: impl FnMut(u32) -> bool) -> bool {
        let mut is_found = false;
        self.overlapping(bounds, |triangle| {
            is_found = is_wanted(triangle);
            !is_found
        });
        is_found
    }

    /// Visits the triangles whose boxes meet a box in the tree's frame. Rounding the query to f32 is monotonic, so no
    /// meeting box of the tree, which is in f32 as well, is missed.
    fn between(&self, low: DVec3, high: DVec3, visit: impl FnMut(u32) -> bool) {
        let (low, high) = (vec3a(low), vec3a(high));
        self.walk(|aabb| aabb.min.cmple(high).all() && aabb.max.cmpge(low).all(), visit);
    }

    /// Visits the triangles of all leaves for which `accepts` holds for the boxes of the leaf and of all its ancestors.
    pub(super) fn walk(&self, accepts: impl Fn(&Aabb) -> bool, mut visit: impl FnMut(u32) -> bool) {
        let Some(bvh) = &self.bvh else { return };
        let accepts = |node: &u32| accepts(bvh.nodes[*node as usize].aabb());
        let mut stack: SmallVec<[u32; DEPTH]> = SmallVec::new();
        stack.extend(Some(0u32).filter(accepts));
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if node.is_leaf() {
                for &triangle in triangles_of(bvh, node) {
                    if !visit(triangle) {
                        return;
                    }
                }
            } else {
                for child in [node.first_index + 1, node.first_index] {
                    if accepts(&child) {
                        stack.push(child);
                    }
                }
            }
        }
    }
}

/// The coordinate frame of a tree's boxes: the origin is the centre of the model, and half of the model's longest side
/// is 1, which uses the precision of f32 best. Trees that are searched together share a frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    centre: DVec3,
    scale: f64,
}

impl Frame {
    /// The frame of triangles given as indices into `positions`. All positions that faces use must be finite.
    ///
    /// # Panics
    /// If a face has an index that is out of range.
    #[must_use]
    pub fn around(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let bounds = Box3::of_faces(positions, faces);
        let half = (bounds.max * 0.5 - bounds.min * 0.5).max_element();
        let scale = if half > 0.0 && half.is_finite() && (1.0 / half).is_finite() { 1.0 / half } else { 1.0 };
        Self { centre: bounds.centre(), scale }
    }

    /// Transforms a point into the frame. The order of coordinates along each axis is preserved.
    #[inline]
    #[must_use]
    pub fn to_tree(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// The length in the frame of a length of 1 in the model.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }
}

/// A tree whose triangles may change their corners: boxes grow and never shrink.
///
/// Boxes still cover the previous corners of a triangle, so a search may return too many candidates but never misses
/// one. After many changes it pays to build a new tree.
pub struct GrowingTree {
    tree: Tree,
}

impl GrowingTree {
    /// Prepares a tree so that [`GrowingTree::grow`] finds the boxes of a triangle.
    #[must_use]
    pub fn new(mut tree: Tree) -> Self {
        if let Some(bvh) = &mut tree.bvh {
            bvh.init_parents_if_uninit();
            bvh.init_primitives_to_nodes_if_uninit();
        }
        Self { tree }
    }

    /// Grows the boxes of a triangle to cover its new corners.
    ///
    /// # Panics
    /// If the tree was built without this triangle.
    pub fn grow(&mut self, triangle: u32, corners: [DVec3; 3]) {
        let Some(bvh) = &mut self.tree.bvh else { return };
        let bounds = Box3::of(corners.map(|p| self.tree.frame.to_tree(p)));
        let pad = DVec3::splat(PAD);
        let needed = Aabb::new(vec3a(bounds.min - pad), vec3a(bounds.max + pad));
        let mut at = bvh.primitives_to_nodes[triangle as usize] as usize;
        loop {
            let node = &mut bvh.nodes[at];
            let old = *node.aabb();
            if old.min.cmple(needed.min).all() && old.max.cmpge(needed.max).all() {
                return;
            }
            node.set_aabb(old.union(&needed));
            if at == 0 {
                return;
            }
            at = bvh.parents[at] as usize;
        }
    }

    /// Calls `visit` with every triangle whose boxes meet `bounds`. `stack` is a reusable buffer for the traversal.
    pub fn overlapping(&self, bounds: &Box3, stack: &mut Vec<u32>, mut visit: impl FnMut(u32)) {
        let Some(bvh) = &self.tree.bvh else { return };
        // The padding of the boxes is far larger than the rounding here.
        let (low, high) = (vec3a(self.tree.frame.to_tree(bounds.min)), vec3a(self.tree.frame.to_tree(bounds.max)));
        let meets = |aabb: &Aabb| -> bool {
            let (min, max): (Vec3A, Vec3A) = (aabb.min, aabb.max);
            (min.cmple(high) & max.cmpge(low)).all()
        };
        stack.clear();
        stack.push(0);
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if node.is_leaf() {
                triangles_of(bvh, node).iter().for_each(|&triangle| visit(triangle));
                continue;
            }
            for child in [node.first_index + 1, node.first_index] {
                if meets(bvh.nodes[child as usize].aabb()) {
                    stack.push(child);
                }
            }
        }
    }
}

/// The triangles of a leaf.
#[inline]
pub(crate) fn triangles_of<'a>(bvh: &'a Bvh2, leaf: &Bvh2Node) -> &'a [u32] {
    let first = leaf.first_index as usize;
    &bvh.primitive_indices[first..first + leaf.prim_count as usize]
}

/// Deducts the visit of a node and its triangles from `steps`. Returns whether enough steps were left; otherwise
/// `steps` becomes 0.
#[inline]
pub(super) fn spend(steps: &mut u64, node: &Bvh2Node) -> bool {
    let left = steps.checked_sub(1 + u64::from(node.prim_count));
    *steps = left.unwrap_or(0);
    left.is_some()
}

/// The squared distance of a point from a box; 0 inside.
#[inline]
pub(super) fn box_distance_squared(aabb: &Aabb, point: DVec3) -> f64 {
    let outside = (aabb.min.as_dvec3() - point).max(point - aabb.max.as_dvec3());
    outside.max(DVec3::ZERO).length_squared()
}

/// Rounds a vector to f32, to nearest, which preserves the order of coordinates.
#[expect(clippy::cast_possible_truncation, reason = "rounded to the nearest, which keeps the order of numbers")]
pub(crate) fn vec3a(v: DVec3) -> Vec3A {
    Vec3A::new(v.x as f32, v.y as f32, v.z as f32)
}

/// A number in `[0, 1)` hashed from an index (the finaliser of SplitMix64, Steele, Lea and Flood 2014).
#[expect(clippy::cast_precision_loss, reason = "53 bits are kept")]
fn jitter(index: usize) -> f64 {
    let mut z = (index as u64).wrapping_add(0x9e37_79b9_7f4a_7c15);
    z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((z ^ (z >> 31)) >> 11) as f64 / (1u64 << 53) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::r3;

    fn grid(n: u32) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let positions = (0..n * 3)
            .map(|i| {
                let (t, c) = (i / 3, i % 3);
                DVec3::new(f64::from(t) + f64::from(c % 2), f64::from(c / 2), 0.0)
            })
            .collect();
        (positions, (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    #[test]
    fn trees_of_no_and_one_triangle_answer_queries() {
        for n in [0, 1, 2] {
            let (positions, faces) = grid(n);
            let mut hits = 0;
            Tree::new(&positions, &faces).along(DVec3::new(0.2, 0.1, -1.0), DVec3::new(0.2, 0.1, 1.0), |_| {
                hits += 1;
                true
            });
            assert_eq!(hits, n.min(1));
        }
    }

    #[test]
    fn a_tree_of_many_equal_triangles_builds_quickly() {
        let (positions, _) = grid(1);
        let faces = vec![[0, 1, 2]; 50_000];
        let tree = Tree::new(&positions, &faces);
        let mut hits = 0;
        tree.along(DVec3::new(0.2, 0.1, -1.0), DVec3::new(0.2, 0.1, 1.0), |_| {
            hits += 1;
            true
        });
        assert_eq!(hits, 50_000);
    }

    #[test]
    fn moved_triangles_are_found_at_their_new_position() {
        let corner = |i: u32| DVec3::from(r3(f64::from(i / 3))) + DVec3::from(r3(f64::from(i + 7000))) * 0.05;
        let mut positions: Vec<DVec3> = (0..900).map(corner).collect();
        let faces: Vec<[u32; 3]> = (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let mut tree = GrowingTree::new(Tree::new(&positions, &faces));
        for t in (0..300).step_by(7) {
            let moved = DVec3::from(r3(f64::from(t) + 0.4)) * 1.2;
            positions[3 * t as usize] = moved;
            tree.grow(t, faces[t as usize].map(|v| positions[v as usize]));
        }
        let mut stack = Vec::new();
        for i in 0..50 {
            let low = DVec3::from(r3(f64::from(i) + 0.2));
            let bounds = Box3 { min: low, max: low + 0.1 };
            let mut found = Vec::new();
            tree.overlapping(&bounds, &mut stack, |t| found.push(t));
            for t in 0..300u32 {
                let own = Box3::of(faces[t as usize].map(|v| positions[v as usize]));
                assert!(!own.meets(&bounds) || found.contains(&t), "{t}");
            }
            assert!(found.len() < 150);
        }
    }
}
