mod along;
mod ball;
mod frame;
mod growing;
mod nearest;
mod opposite;
mod pairs;
mod winding;

use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use crate::math::Box3;

pub use ball::Ball;
pub use frame::Frame;
pub use growing::GrowingTree;
pub use nearest::Nearest;
pub use opposite::OppositeFaces;
pub use pairs::{Hit, PairSearch};
pub use winding::{Dipoles, winding_exact};

/// How far a box in the tree reaches beyond its triangle, as a share of half of the model's longest side: more than
/// the rounding of the tree's own frame, and a spread that keeps equal boxes from being equal (see [`Tree::new`]).
const PAD: f64 = 1e-6;

/// Room for what a walk has yet to look at, as deep as trees usually are: questions are many and short.
const DEPTH: usize = 64;

/// A tree of boxes over triangles, to find the few that a segment may meet or that are near a point.
///
/// It answers candidates, never hits: boxes are f32 and rounded outward, and the exact predicates decide.
pub struct Tree {
    bvh: Option<Bvh2>,
    frame: Frame,
}

impl Tree {
    /// Builds the tree. The same triangles give the same tree. All positions that are used must be finite.
    ///
    /// The builder is quadratic where many boxes are equal, so each box is widened by an amount that is hashed from
    /// its index.
    #[must_use]
    pub fn new(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        Self::in_frame(Frame::around(positions, faces), positions, faces)
    }

    /// Builds the tree in a frame that may hold more than these triangles, such as those of another tree.
    #[must_use]
    pub fn in_frame(frame: Frame, positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        if faces.is_empty() {
            return Self { bvh: None, frame };
        }
        let boxes: Vec<Aabb> = faces
            .iter()
            .enumerate()
            .map(|(index, face)| {
                let b = Box3::of(face.map(|v| frame.to_tree(positions[v as usize])));
                // Wider than f32's rounding in [-1, 1].
                let pad = DVec3::splat(PAD * (1.0 + jitter(index)));
                Aabb::new(vec3a(b.min - pad), vec3a(b.max + pad))
            })
            .collect();
        #[expect(clippy::cast_possible_truncation, reason = "faces are counted in u32")]
        let indices = (0..faces.len() as u32).collect();
        let bvh = PlocBuilder::new().build(PlocSearchDistance::Minimum, &boxes, indices, SortPrecision::U64, 0);
        Self { bvh: Some(bvh), frame }
    }

    /// All nodes, each after its children. They need not stand in any such order in the array.
    fn children_first(&self) -> impl Iterator<Item = u32> {
        let nodes = self.bvh.as_ref().map_or(&[][..], |bvh| &bvh.nodes);
        let (mut order, mut stack) = (Vec::with_capacity(nodes.len()), Vec::new());
        stack.extend((!nodes.is_empty()).then_some(0u32));
        while let Some(at) = stack.pop() {
            order.push(at);
            let node = &nodes[at as usize];
            if !node.is_leaf() {
                stack.extend([node.first_index, node.first_index + 1]);
            }
        }
        order.into_iter().rev()
    }

    /// Calls `visit` with every triangle whose box comes within `reach` of a point along each axis, until it answers
    /// `false`.
    pub fn around(&self, point: DVec3, reach: f64, visit: impl FnMut(u32) -> bool) {
        let centre = self.frame.to_tree(point);
        let reach = DVec3::splat(reach * self.frame.scale());
        self.between(centre - reach, centre + reach, visit);
    }

    /// Calls `visit` with every triangle whose box meets `bounds`, until it answers `false`.
    pub fn overlapping(&self, bounds: &Box3, visit: impl FnMut(u32) -> bool) {
        self.between(self.frame.to_tree(bounds.min), self.frame.to_tree(bounds.max), visit);
    }

    /// Visits the triangles whose boxes meet a box in the tree's frame. Rounded to f32, in which the tree's boxes are, its sides
    /// stay on the same side of theirs.
    fn between(&self, low: DVec3, high: DVec3, visit: impl FnMut(u32) -> bool) {
        let (low, high) = (vec3a(low), vec3a(high));
        self.walk(|aabb| aabb.min.cmple(high).all() && aabb.max.cmpge(low).all(), visit);
    }

    /// Visits the triangles of all boxes that `wanted` says yes to, and whose parents it says yes to.
    fn walk(&self, wanted: impl Fn(&Aabb) -> bool, mut visit: impl FnMut(u32) -> bool) {
        let Some(bvh) = &self.bvh else { return };
        let wanted = |node: &u32| wanted(bvh.nodes[*node as usize].aabb());
        let mut stack = Vec::with_capacity(DEPTH);
        stack.extend(Some(0u32).filter(wanted));
        while let Some(at) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if node.is_leaf() {
                for i in 0..node.prim_count {
                    if !visit(bvh.primitive_indices[(node.first_index + i) as usize]) {
                        return;
                    }
                }
            } else {
                for child in [node.first_index + 1, node.first_index] {
                    if wanted(&child) {
                        stack.push(child);
                    }
                }
            }
        }
    }
}

/// How far a point is from a box, squared; 0 in it.
#[inline]
fn box_distance_squared(aabb: &Aabb, point: DVec3) -> f64 {
    let outside = (aabb.min.as_dvec3() - point).max(point - aabb.max.as_dvec3());
    outside.max(DVec3::ZERO).length_squared()
}

#[expect(clippy::cast_possible_truncation, reason = "rounded to the nearest, which keeps the order of numbers")]
fn vec3a(v: DVec3) -> Vec3A {
    Vec3A::new(v.x as f32, v.y as f32, v.z as f32)
}

/// A number in `[0, 1)` from an index (the finaliser of SplitMix64, Steele et al. 2014).
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
    fn one_triangle_and_no_triangle_make_trees_too() {
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
    fn many_equal_triangles_do_not_make_the_build_quadratic() {
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
}
