use glam::DVec3;

use super::{DEPTH, Tree, box_distance_squared};
use crate::math::nearest_on_triangle;

/// Half-sides of the model from which on all its points are equally far, but for rounding.
pub(super) const FAR: f64 = 1.152_921_504_606_847e18; // 2^60

/// The point of a surface that is nearest to another point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// The triangle it is on.
    pub face: u32,
    /// Where it is.
    pub point: DVec3,
    /// How far away it is.
    pub distance: f64,
}

impl Tree {
    /// The point of the triangles nearest to `point`, where that is nearer than `bound`.
    ///
    /// Branch and bound, the nearer box first: a box holds its triangles for certain, so none that is nearer is passed
    /// over, and the distance is exact but for rounding in f64. Of several nearest triangles it is always the same one.
    ///
    /// `triangle` gives the corners that the tree was built with. `steps` is how many boxes and triangles may be looked at
    /// and is counted down; where it reaches 0 the answer is only the best so far.
    pub fn nearest(
        &self,
        point: DVec3,
        bound: f64,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<Nearest> {
        let bvh = self.bvh.as_ref()?;
        let place = self.frame.to_tree(point);
        if !place.abs().cmplt(DVec3::splat(FAR)).all() {
            return self.nearest_from_afar(point, bound, triangle);
        }
        let mut best = None;
        let limit = bound.max(0.0) * self.frame.scale();
        let mut best_square = if limit < FAR { limit * limit } else { f64::INFINITY };
        let square = |node: u32| box_distance_squared(bvh.nodes[node as usize].aabb(), place);
        let mut stack = Vec::with_capacity(DEPTH);
        stack.push((square(0), 0u32));
        while let Some((at_least, at)) = stack.pop() {
            if at_least >= best_square {
                continue;
            }
            let node = &bvh.nodes[at as usize];
            let cost = 1 + u64::from(node.prim_count);
            if *steps < cost {
                *steps = 0;
                break;
            }
            *steps -= cost;
            if node.is_leaf() {
                for i in 0..node.prim_count {
                    let face = bvh.primitive_indices[(node.first_index + i) as usize];
                    let found = nearest_on_triangle(point, triangle(face));
                    let square = ((found - point) * self.frame.scale()).length_squared();
                    if square < best_square {
                        best_square = square;
                        best = Some((face, found));
                    }
                }
                continue;
            }
            let (left, right) = (node.first_index, node.first_index + 1);
            let (near, far) = ((square(left), left), (square(right), right));
            let (near, far) = if far.0 < near.0 { (far, near) } else { (near, far) };
            for child in [far, near] {
                if child.0 < best_square {
                    stack.push(child);
                }
            }
        }
        best.map(|(face, found)| Nearest { face, point: found, distance: best_square.sqrt() / self.frame.scale() })
    }

    /// From where the model is no more than a point.
    fn nearest_from_afar(&self, point: DVec3, bound: f64, triangle: impl Fn(u32) -> [DVec3; 3]) -> Option<Nearest> {
        let face = *self.bvh.as_ref()?.primitive_indices.first()?;
        let found = triangle(face)[0];
        let apart = point * 0.5 - found * 0.5;
        let largest = apart.abs().max_element();
        let distance = (apart / largest).length() * largest * 2.0;
        (distance < bound || distance.is_infinite()).then_some(Nearest { face, point: found, distance })
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use crate::math::r3;

    fn triangles(n: u32, size: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |i: u32| DVec3::from(r3(f64::from(i)));
        let corner = |i: u32| (at(i / 3) + at(i + 7000) * 0.05) * size;
        ((0..3 * n).map(corner).collect(), (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    #[test]
    fn it_is_the_least_of_the_distances_to_all_triangles() {
        for size in [1.0, 1e-60, 1e60] {
            let (positions, faces) = triangles(300, size);
            let tree = Tree::new(&positions, &faces);
            let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
            for i in 0..200 {
                let point = (DVec3::from(r3(f64::from(i) + 0.3)) * 3.0 - 1.0) * size;
                let least =
                    (0..300).map(|f| point.distance(nearest_on_triangle(point, corners(f)))).fold(9.0 * size, f64::min);
                let (mut few, mut many) = (u64::MAX, u64::MAX);
                let found = tree.nearest(point, f64::INFINITY, &mut many, corners).unwrap();
                assert!((found.distance - least).abs() <= 1e-12 * size, "{} {least}", found.distance);
                assert_eq!(found.point, nearest_on_triangle(point, corners(found.face)));
                assert_eq!(tree.nearest(point, least * (1.0 - 1e-9), &mut few, corners), None);
                assert_eq!(tree.nearest(point, least * (1.0 + 1e-9), &mut few, corners), Some(found));
            }
        }
    }

    #[test]
    fn a_point_that_sees_no_size_is_as_far_as_the_model() {
        let (positions, faces) = triangles(10, 1e-300);
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut steps = u64::MAX;
        let found = tree.nearest(DVec3::new(0.0, 3.0, 4.0), f64::INFINITY, &mut steps, corners).unwrap();
        assert!((found.distance - 5.0).abs() < 1e-12);
        assert_eq!(tree.nearest(DVec3::NAN, f64::INFINITY, &mut steps, corners).map(|n| n.distance.is_nan()), None);
    }

    #[test]
    fn the_steps_are_an_end_to_the_search() {
        let (positions, _) = triangles(1, 1.0);
        let faces = vec![[0, 1, 2]; 5000];
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut steps = 3000;
        let found = tree.nearest(DVec3::ONE, f64::INFINITY, &mut steps, corners);
        assert!(found.is_some() && steps == 0);
        assert_eq!(Tree::new(&[], &[]).nearest(DVec3::ONE, 1.0, &mut steps, corners), None);
    }
}
