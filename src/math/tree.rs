use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;
use obvhs::bvh2::Bvh2;
use obvhs::bvh2::node::Bvh2Node;
use obvhs::ploc::{PlocBuilder, PlocSearchDistance, SortPrecision};

use super::boxes::Box3;

/// How far a box in the tree reaches beyond its triangle, as a share of half of the model's longest side: more than
/// the rounding of the tree's own frame, and a spread that keeps equal boxes from being equal (see [`Tree::new`]).
const PAD: f64 = 1e-6;

/// Capacity of the stack of a walk, as deep as trees usually are: questions are many and short.
pub(super) const DEPTH: usize = 64;

/// Half-sides of the model from which on all its points are equally far, but for rounding.
pub(super) const FAR: f64 = 1.152_921_504_606_847e18; // 2^60

/// A tree of boxes over triangles, to find the few that a segment may meet or that are near a point.
///
/// It answers candidates, never hits: boxes are f32 and rounded outward, and the exact predicates decide.
pub struct Tree {
    pub(super) bvh: Option<Bvh2>,
    pub(super) frame: Frame,
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
    pub(super) fn children_first(&self) -> impl Iterator<Item = u32> {
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
    pub(super) fn walk(&self, wanted: impl Fn(&Aabb) -> bool, mut visit: impl FnMut(u32) -> bool) {
        let Some(bvh) = &self.bvh else { return };
        let wanted = |node: &u32| wanted(bvh.nodes[*node as usize].aabb());
        let mut stack = Vec::with_capacity(DEPTH);
        stack.extend(Some(0u32).filter(wanted));
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
                    if wanted(&child) {
                        stack.push(child);
                    }
                }
            }
        }
    }
}

/// Where a tree's boxes are: the model's middle is the origin, and half of its longest side is 1, so that f32 holds
/// as much as it can. Trees that are searched together have one frame.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Frame {
    centre: DVec3,
    scale: f64,
}

impl Frame {
    /// The frame of triangles, given by numbers in `positions`. All positions that are used must be finite.
    ///
    /// # Panics
    /// When a number is not one of `positions`.
    #[must_use]
    pub fn around(positions: &[DVec3], faces: &[[u32; 3]]) -> Self {
        let bounds = Box3::of(faces.iter().flatten().map(|&v| positions[v as usize]));
        let half = (bounds.max * 0.5 - bounds.min * 0.5).max_element();
        let scale = if half > 0.0 && half.is_finite() && (1.0 / half).is_finite() { 1.0 / half } else { 1.0 };
        Self { centre: bounds.centre(), scale }
    }

    /// A point in the frame. Along each axis the order of numbers is kept.
    #[inline]
    #[must_use]
    pub fn to_tree(&self, p: DVec3) -> DVec3 {
        (p - self.centre) * self.scale
    }

    /// The length in the frame of a length of 1.
    #[must_use]
    pub fn scale(&self) -> f64 {
        self.scale
    }
}

/// A tree whose triangles may change their corners: their boxes grow, and never shrink.
///
/// What a triangle has left stays in its boxes, so that a search may answer more candidates than it must, but none too few.
/// After many changes a new tree is worth its price.
pub struct GrowingTree {
    tree: Tree,
}

impl GrowingTree {
    /// The tree with what it takes to find the boxes of a triangle.
    #[must_use]
    pub fn new(mut tree: Tree) -> Self {
        if let Some(bvh) = &mut tree.bvh {
            bvh.init_parents_if_uninit();
            bvh.init_primitives_to_nodes_if_uninit();
        }
        Self { tree }
    }

    /// Makes room for new corners of a triangle.
    ///
    /// # Panics
    /// When the tree was built without this triangle.
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

    /// Calls `visit` with every triangle whose boxes meet `bounds`. `stack` is room for the walk.
    pub fn overlapping(&self, bounds: &Box3, stack: &mut Vec<u32>, mut visit: impl FnMut(u32)) {
        let Some(bvh) = &self.tree.bvh else { return };
        // Rounding is far less than what the boxes are padded by.
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
pub(super) fn triangles_of<'a>(bvh: &'a Bvh2, leaf: &Bvh2Node) -> &'a [u32] {
    let first = leaf.first_index as usize;
    &bvh.primitive_indices[first..first + leaf.prim_count as usize]
}

/// Counts the look at a node and its triangles. Answers whether there were steps enough; otherwise none are left.
#[inline]
pub(super) fn spend(steps: &mut u64, node: &Bvh2Node) -> bool {
    let left = steps.checked_sub(1 + u64::from(node.prim_count));
    *steps = left.unwrap_or(0);
    left.is_some()
}

/// How far a point is from a box, squared; 0 in it.
#[inline]
pub(super) fn box_distance_squared(aabb: &Aabb, point: DVec3) -> f64 {
    let outside = (aabb.min.as_dvec3() - point).max(point - aabb.max.as_dvec3());
    outside.max(DVec3::ZERO).length_squared()
}

#[expect(clippy::cast_possible_truncation, reason = "rounded to the nearest, which keeps the order of numbers")]
pub(super) fn vec3a(v: DVec3) -> Vec3A {
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

    #[test]
    fn triangles_are_found_where_they_went_and_by_chance_where_they_were() {
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
