use glam::DVec3;

use super::tree::{DEPTH, FAR, Tree, box_distance_squared, spend, triangles_of};
use super::triangle::{nearest_on_triangle, nearest_within};

/// Share of its radius by which a ball may reach through what it touches.
const SLACK: f64 = 1e-6;
/// Steps in which a ball shrinks until it clears one triangle. It mostly takes three; beside an edge it halves in each.
const MOST_SHRUNK: usize = 40;

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
            if !spend(steps, node) {
                break;
            }
            if node.is_leaf() {
                for &face in triangles_of(bvh, node) {
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

/// A ball that was shrunk until it was empty.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Ball {
    /// Its radius.
    pub radius: f64,
    /// What it touches beside the point that it was shrunk towards; none where it was empty at once.
    pub touches: Option<Nearest>,
}

impl Tree {
    /// The largest ball of at most `radius` with no triangle in it that touches `point` and has its centre in the direction
    /// `way`, of length 1 (the shrinking ball of Ma et al. 2012). None where rounding leaves no such ball or the steps were
    /// spent.
    ///
    /// A smaller ball through the same point lies in the larger one, so what is passed over once need not be looked at
    /// again, and all of it is one walk. What is near `point` comes first, since it leaves the smallest ball: in a round
    /// body the largest one meets nearly every triangle, and the neighbours shrink it to where few are left. `triangle` and
    /// `steps` as in [`Tree::nearest`].
    pub fn shrunk_ball(
        &self,
        [point, way]: [DVec3; 2],
        radius: f64,
        steps: &mut u64,
        triangle: impl Fn(u32) -> [DVec3; 3],
    ) -> Option<Ball> {
        let mut ball = Ball { radius, touches: None };
        let Some(bvh) = &self.bvh else { return Some(ball) };
        // Its centre, and the square of what must be empty around it, in the frame of the tree.
        let framed = |radius: f64| {
            let reach = radius * (1.0 - SLACK) * self.frame.scale();
            (self.frame.to_tree(point + way * radius), reach * reach)
        };
        let (mut centre, mut square) = framed(radius);
        let start = self.frame.to_tree(point);
        let distance = |node: u32, from: DVec3| box_distance_squared(bvh.nodes[node as usize].aabb(), from);
        // With the radius at which each was seen to reach into the ball.
        let mut stack = Vec::with_capacity(DEPTH);
        stack.push((0u32, f64::INFINITY));
        while let Some((at, seen)) = stack.pop() {
            let node = &bvh.nodes[at as usize];
            if !spend(steps, node) {
                return None;
            }
            if seen > ball.radius && distance(at, centre) >= square {
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
                ball = ball.shrunk(point, way, face, triangle(face))?;
            }
            (centre, square) = framed(ball.radius);
        }
        Some(ball)
    }
}

impl Ball {
    /// The ball shrunk towards `point` until a triangle does not reach into it. None where rounding leaves none.
    fn shrunk(mut self, point: DVec3, way: DVec3, face: u32, corners: [DVec3; 3]) -> Option<Self> {
        for _ in 0..MOST_SHRUNK {
            let middle = point + way * self.radius;
            let Some(found) = nearest_within(middle, corners, self.radius * (1.0 - SLACK)) else {
                return Some(self);
            };
            let towards = found - point;
            let smaller = towards.length_squared() / (2.0 * towards.dot(way));
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

    #[test]
    fn nothing_is_in_it_and_it_touches_what_stopped_it() {
        let (positions, faces) = triangles(300, 1.0);
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut shrunk = 0;
        for i in 0..200 {
            let point = DVec3::from(r3(f64::from(i) + 0.3)) * 2.0 - 0.5;
            let way = (DVec3::from(r3(f64::from(i) + 0.7)) - 0.5).normalize();
            let Some(ball) = tree.shrunk_ball([point, way], 0.5, &mut u64::MAX.clone(), corners) else { continue };
            let centre = point + way * ball.radius;
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
    fn the_steps_are_an_end_to_the_ball_too() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let tree = Tree::new(&positions, &vec![[0, 1, 2]; 5000]);
        let mut steps = 3000;
        let (point, way) = (DVec3::new(0.2, 0.2, -1.0), DVec3::Z);
        assert_eq!(tree.shrunk_ball([point, way], 2.0, &mut steps, |_| positions), None);
        assert_eq!(steps, 0);
        let ball = tree.shrunk_ball([point, way], 2.0, &mut u64::MAX.clone(), |_| positions).unwrap();
        assert!((ball.radius - 0.5).abs() < 1e-6);
    }
}
