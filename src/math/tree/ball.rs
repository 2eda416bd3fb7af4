use glam::DVec3;

use super::{DEPTH, Nearest, Tree, box_distance_squared};
use crate::math::nearest_within;

/// Share of its radius by which a ball may reach through what it touches.
const SLACK: f64 = 1e-6;
/// Steps in which a ball shrinks until it clears one triangle. It mostly takes three; beside an edge it halves in each.
const MOST_SHRUNK: usize = 40;

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
        point: DVec3,
        way: DVec3,
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
            let cost = 1 + u64::from(node.prim_count);
            if *steps < cost {
                *steps = 0;
                return None;
            }
            *steps -= cost;
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
            for i in 0..node.prim_count {
                let face = bvh.primitive_indices[(node.first_index + i) as usize];
                let corners = triangle(face);
                let mut clear = false;
                for _ in 0..MOST_SHRUNK {
                    let middle = point + way * ball.radius;
                    let Some(found) = nearest_within(middle, corners, ball.radius * (1.0 - SLACK)) else {
                        clear = true;
                        break;
                    };
                    let towards = found - point;
                    let smaller = towards.length_squared() / (2.0 * towards.dot(way));
                    if !(smaller > 0.0 && smaller < ball.radius) {
                        return None;
                    }
                    let touches = Nearest { face, point: found, distance: smaller };
                    ball = Ball { radius: smaller, touches: Some(touches) };
                }
                if !clear {
                    return None;
                }
            }
            (centre, square) = framed(ball.radius);
        }
        Some(ball)
    }
}

#[cfg(test)]
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;
    use crate::math::{nearest_on_triangle, r3};

    #[test]
    fn nothing_is_in_it_and_it_touches_what_stopped_it() {
        let corner = |i: u32| DVec3::from(r3(f64::from(i / 3))) + DVec3::from(r3(f64::from(i + 7000))) * 0.05;
        let positions: Vec<DVec3> = (0..900).map(corner).collect();
        let faces: Vec<[u32; 3]> = (0..300).map(|t| [3 * t, 3 * t + 1, 3 * t + 2]).collect();
        let tree = Tree::new(&positions, &faces);
        let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
        let mut shrunk = 0;
        for i in 0..200 {
            let point = DVec3::from(r3(f64::from(i) + 0.3)) * 2.0 - 0.5;
            let way = (DVec3::from(r3(f64::from(i) + 0.7)) - 0.5).normalize();
            let Some(ball) = tree.shrunk_ball(point, way, 0.5, &mut u64::MAX.clone(), corners) else { continue };
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
    fn the_steps_are_an_end_to_the_search() {
        let positions = [DVec3::ZERO, DVec3::X, DVec3::Y];
        let tree = Tree::new(&positions, &vec![[0, 1, 2]; 5000]);
        let mut steps = 3000;
        let (point, way) = (DVec3::new(0.2, 0.2, -1.0), DVec3::Z);
        assert_eq!(tree.shrunk_ball(point, way, 2.0, &mut steps, |_| positions), None);
        assert_eq!(steps, 0);
        let ball = tree.shrunk_ball(point, way, 2.0, &mut u64::MAX.clone(), |_| positions).unwrap();
        assert!((ball.radius - 0.5).abs() < 1e-6);
    }
}
