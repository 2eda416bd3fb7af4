use glam::{DVec3, Vec3A};
use obvhs::aabb::Aabb;

use super::{PAD, Tree, vec3a};
use crate::math::Box3;

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
        let room = Aabb::new(vec3a(bounds.min - pad), vec3a(bounds.max + pad));
        let mut at = bvh.primitives_to_nodes[triangle as usize] as usize;
        loop {
            let node = &mut bvh.nodes[at];
            let old = *node.aabb();
            if old.min.cmple(room.min).all() && old.max.cmpge(room.max).all() {
                return;
            }
            node.set_aabb(old.union(&room));
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
                for i in 0..node.prim_count {
                    visit(bvh.primitive_indices[(node.first_index + i) as usize]);
                }
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::r3;

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
