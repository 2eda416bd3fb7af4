//! Distance queries on a [`Tree`]: the nearest point of a surface, and the largest empty ball that touches a point.

use glam::DVec3;
use smallvec::{SmallVec, smallvec};

use super::tree::{DEPTH, FAR, Tree, box_distance_squared, spend, triangles_of};
use super::triangle::{nearest_on_triangle, nearest_within};

/// Relative reduction of a ball's radius in intersection tests, so that triangles touching the ball do not count as
/// inside.
const SLACK: f64 = 1e-6;
/// Maximum steps to shrink a ball until it is clear of one triangle. Usually three are enough; beside an edge each step
/// halves the ball.
const MAX_SHRINK_STEPS: usize = 40;

/// The point of a surface that is nearest to a query point.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Nearest {
    /// The triangle that contains the point.
    pub face: u32,
    /// The nearest point.
    pub point: DVec3,
    /// Distance from the query point.
    pub distance: f64,
}

impl Tree {
    /// The point of the triangles nearest to `point`, if it is nearer than `bound`.
    ///
    /// Branch and bound, visiting the nearer box first. Each box contains its triangles, so no nearer triangle is
    /// missed: the distance is exact up to f64 rounding. Ties between triangles are resolved deterministically.
    ///
    /// `triangle` returns the corners that the tree was built with. `steps` is the number of boxes and triangles that
    /// the search may still visit, and counts down. When it reaches 0, the result is the best point found until then.
    pub fn nearest(
        &self,
        point: DVec3,
        bound: f64,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<Nearest> {
        if self.is_far(point) {
            return self.nearest_from_afar(point, bound, triangle);
        }
        let limit = bound.max(0.0) * self.frame.scale();
        let square = if limit < FAR { limit * limit } else { f64::INFINITY };
        self.nearer(point, (None, square), steps, triangle)
    }

    /// The distance from a point to the triangles, as [`Tree::nearest`] finds it without a bound. `last` is a triangle that may be
    /// near, such as the nearest one of a neighbouring point, and becomes the nearest one. The closer it is, the shorter the search.
    pub fn distance(
        &self,
        point: DVec3,
        last: &mut Option<u32>,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<f64> {
        if self.is_far(point) {
            return self.nearest_from_afar(point, f64::INFINITY, triangle).map(|nearest| nearest.distance);
        }
        let start = last.map(|face| (face, nearest_on_triangle(point, triangle(face))));
        let square = start.map_or(f64::INFINITY, |(_, found)| self.framed_square(point, found));
        let nearest = self.nearer(point, (start, square), steps, triangle)?;
        *last = Some(nearest.face);
        Some(nearest.distance)
    }

    /// Whether a point is so far away that the model is a point to it.
    fn is_far(&self, point: DVec3) -> bool {
        !self.frame.to_tree(point).abs().cmplt(DVec3::splat(FAR)).all()
    }

    /// The square of the distance of two points, in the tree's frame.
    fn framed_square(&self, p: DVec3, q: DVec3) -> f64 {
        ((q - p) * self.frame.scale()).length_squared()
    }

    /// The point of the triangles nearest to `point`, from a start with its squared distance in the tree's frame.
    fn nearer(
        &self,
        point: DVec3,
        (mut best, mut best_square): (Option<(u32, DVec3)>, f64),
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<Nearest> {
        let bvh = self.bvh.as_ref()?;
        let query = self.frame.to_tree(point);
        let square = |node: u32| box_distance_squared(bvh.nodes[node as usize].aabb(), query);
        let mut stack: SmallVec<[(f64, u32); DEPTH]> = smallvec![(square(0), 0)];
        while let Some((at_least, at)) = stack.pop() {
            if at_least >= best_square {
                continue;
            }
            let node = &bvh.nodes[at as usize];
            if !spend(steps, node) {
                break;
            }
            if node.is_leaf() {
                for &face in triangles_of(bvh, node) {
                    let found = nearest_on_triangle(point, triangle(face));
                    let square = self.framed_square(point, found);
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

    /// The distance from a point for which [`Tree::is_far`] holds.
    fn nearest_from_afar(&self, point: DVec3, bound: f64, triangle: impl Fn(u32) -> [DVec3; 3]) -> Option<Nearest> {
        let face = *self.bvh.as_ref()?.primitive_indices.first()?;
        let found = triangle(face)[0];
        let apart = point * 0.5 - found * 0.5;
        let largest = apart.abs().max_element();
        let distance = (apart / largest).length() * largest * 2.0;
        (distance < bound || distance.is_infinite()).then_some(Nearest { face, point: found, distance })
    }
}

/// A ball that was shrunk until it contained no triangle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Radius.
    pub radius: f64,
    /// The surface point that stopped the ball, apart from the point it was shrunk towards. None if the initial ball
    /// was already empty.
    pub touches: Option<Nearest>,
}

impl Tree {
    /// The largest empty ball of at most `radius` that touches `point`, with its centre in the unit direction
    /// `direction`: the shrinking ball of Ma, Bae and Choi (2012). None if rounding leaves no such ball or the steps
    /// run out.
    ///
    /// A smaller ball through the same point lies within the larger one, so a skipped subtree never needs another
    /// visit. One traversal suffices. The traversal visits the surroundings of `point` first, because they shrink the
    /// ball most: in a round body the largest ball meets nearly every triangle. `triangle` and `steps` as in
    /// [`Tree::nearest`].
    pub fn shrunk_ball(
        &self,
        [point, direction]: [DVec3; 2],
        radius: f64,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<Ball> {
        let mut ball = Ball { radius, touches: None };
        let Some(bvh) = &self.bvh else { return Some(ball) };
        // The ball's centre and its squared radius less the slack, in the tree's frame.
        let framed = |radius: f64| {
            let reach = radius * (1.0 - SLACK) * self.frame.scale();
            (self.frame.to_tree(point + direction * radius), reach * reach)
        };
        let (mut centre, mut square) = framed(radius);
        let start = self.frame.to_tree(point);
        let distance = |node: u32, from: DVec3| box_distance_squared(bvh.nodes[node as usize].aabb(), from);
        // Nodes to visit, each with the ball's radius when the node was found to meet the ball.
        let mut stack: SmallVec<[(u32, f64); DEPTH]> = smallvec![(0, f64::INFINITY)];
        while let Some((at, radius_at_push)) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if !spend(steps, node) {
                return None;
            }
            if radius_at_push > ball.radius && distance(at, centre) >= square {
                continue;
            }
            if !node.is_leaf() {
                let (left, right) = (node.first_index, node.first_index + 1);
                match (distance(left, centre) < square, distance(right, centre) < square) {
                    (true, true) => {
                        let right_first = distance(right, start) < distance(left, start);
                        let (first, then) = if right_first { (right, left) } else { (left, right) };
                        stack.push((then, ball.radius));
                        stack.push((first, ball.radius));
                    }
                    (true, false) => stack.push((left, ball.radius)),
                    (false, true) => stack.push((right, ball.radius)),
                    (false, false) => {}
                }
                continue;
            }
            for &face in triangles_of(bvh, node) {
                ball = ball.shrunk(point, direction, face, triangle(face))?;
            }
            (centre, square) = framed(ball.radius);
        }
        Some(ball)
    }
}

impl Ball {
    /// The ball shrunk towards `point` until the triangle is not inside it. None if rounding leaves no such ball.
    fn shrunk(mut self, point: DVec3, direction: DVec3, face: u32, corners: [DVec3; 3]) -> Option<Self> {
        for _ in 0..MAX_SHRINK_STEPS {
            let middle = point + direction * self.radius;
            let Some(found) = nearest_within(middle, corners, self.radius * (1.0 - SLACK)) else {
                return Some(self);
            };
            let towards = found - point;
            let smaller = towards.length_squared() / (2.0 * towards.dot(direction));
            if !(smaller > 0.0 && smaller < self.radius) {
                return None;
            }
            self = Self { radius: smaller, touches: Some(Nearest { face, point: found, distance: smaller }) };
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::r3;

    fn triangles(n: u32, size: f64) -> (Vec<DVec3>, Vec<[u32; 3]>) {
        let at = |i: u32| DVec3::from(r3(f64::from(i)));
        let corner = |i: u32| (at(i / 3) + at(i + 7000) * 0.05) * size;
        ((0..3 * n).map(corner).collect(), (0..n).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect())
    }

    #[test]
    fn the_nearest_distance_is_the_minimum_over_all_triangles() {
        for size in [1.0, 1e-60, 1e60] {
            let (positions, faces) = triangles(300, size);
            let tree = Tree::new(&positions, &faces);
            let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
            let mut last = None;
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
                assert_eq!(tree.distance(point, &mut last, &mut few, corners), Some(found.distance));
                assert_eq!(last, Some(found.face));
            }
        }
    }

    #[test]
    fn a_point_far_from_a_tiny_model_gets_its_distance_to_the_model() {
        let (positions, faces) = triangles(10, 1e-300);
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut steps = u64::MAX;
        let found = tree.nearest(DVec3::new(0.0, 3.0, 4.0), f64::INFINITY, &mut steps, corners).unwrap();
        assert!((found.distance - 5.0).abs() < 1e-12);
        assert_eq!(tree.nearest(DVec3::NAN, f64::INFINITY, &mut steps, corners).map(|n| n.distance.is_nan()), None);
    }

    #[test]
    fn the_search_ends_when_the_steps_run_out() {
        let (positions, _) = triangles(1, 1.0);
        let faces = vec![[0, 1, 2]; 5000];
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut steps = 3000;
        let found = tree.nearest(DVec3::ONE, f64::INFINITY, &mut steps, corners);
        assert!(found.is_some() && steps == 0);
        assert_eq!(Tree::new(&[], &[]).nearest(DVec3::ONE, 1.0, &mut steps, corners), None);
    }

    #[test]
    fn the_ball_is_empty_and_touches_the_triangle_that_stopped_it() {
        let (positions, faces) = triangles(300, 1.0);
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut shrunk = 0;
        for i in 0..200 {
            let point = DVec3::from(r3(f64::from(i) + 0.3)) * 2.0 - 0.5;
            let direction = (DVec3::from(r3(f64::from(i) + 0.7)) - 0.5).normalize();
            let Some(ball) = tree.shrunk_ball([point, direction], 0.5, &mut u64::MAX.clone(), corners) else {
                continue;
            };
            let centre = point + direction * ball.radius;
            let least = (0..300).map(|f| centre.distance(nearest_on_triangle(centre, corners(f)))).fold(9.0, f64::min);
            assert!(least >= ball.radius * (1.0 - 2.0 * SLACK), "{least} {ball:?}");
            match ball.touches {
                Some(touched) => {
                    assert!((centre.distance(touched.point) - ball.radius).abs() < 1e-9, "{ball:?}");
                    shrunk += 1;
                }
                None => assert_eq!(ball.radius, 0.5),
            }
        }
        assert!(shrunk > 50, "{shrunk}");
    }

    #[test]
    fn shrinking_the_ball_ends_when_the_steps_run_out() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let tree = Tree::new(&positions, &vec![[0, 1, 2]; 5000]);
        let mut steps = 3000;
        let (point, direction) = (DVec3::new(0.2, 0.2, -1.0), DVec3::Z);
        assert_eq!(tree.shrunk_ball([point, direction], 2.0, &mut steps, |_| positions), None);
        assert_eq!(steps, 0);
        let ball = tree.shrunk_ball([point, direction], 2.0, &mut u64::MAX.clone(), |_| positions).unwrap();
        assert!((ball.radius - 0.5).abs() < 1e-6);
    }
}
