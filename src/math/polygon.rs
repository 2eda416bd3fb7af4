//! Parts of convex polygons, such as the part of a triangle that another one covers.

use glam::DVec3;
use smallvec::SmallVec;

/// The corners of a convex polygon, in their order.
pub type Polygon = SmallVec<[DVec3; 8]>;

/// The part of a convex polygon or segment with `height` at least 0 (Sutherland and Hodgman 1974). `height` must be linear.
#[must_use]
pub fn clip(polygon: &[DVec3], height: impl Fn(DVec3) -> f64) -> Polygon {
    let mut part = Polygon::new();
    let Some(&first) = polygon.first() else { return part };
    let (mut a, mut from) = (first, height(first));
    for &b in polygon.iter().cycle().skip(1).take(polygon.len()) {
        let to = height(b);
        if from >= 0.0 {
            part.push(a);
        }
        if (from < 0.0 && to > 0.0) || (from > 0.0 && to < 0.0) {
            part.push(a.lerp(b, from / (from - to)));
        }
        (a, from) = (b, to);
    }
    part
}

/// The sides of a triangle seen along a direction: for each, a vector across it towards the triangle, and its start.
#[must_use]
pub fn sides_along(triangle: [DVec3; 3], direction: DVec3) -> [(DVec3, DVec3); 3] {
    [0, 1, 2].map(|k| {
        let (start, end, third) = (triangle[k], triangle[(k + 1) % 3], triangle[(k + 2) % 3]);
        let across = (end - start).cross(direction);
        (if across.dot(third - start) < 0.0 { -across } else { across }, start)
    })
}

/// The part of triangle `p` that triangle `q` covers, seen along a direction.
#[must_use]
pub fn covered(p: [DVec3; 3], q: [DVec3; 3], direction: DVec3) -> Polygon {
    let sides = sides_along(q, direction);
    // Most triangles lie beside each other, which takes less time to find than a part.
    let is_beside = |of: [DVec3; 3], (across, start): (DVec3, DVec3)| of.iter().all(|&x| across.dot(x - start) < 0.0);
    if sides.iter().any(|&side| is_beside(p, side)) || sides_along(p, direction).iter().any(|&side| is_beside(q, side))
    {
        return Polygon::new();
    }
    let mut part = Polygon::from(p.as_slice());
    for (across, start) in sides {
        let height = |x: DVec3| across.dot(x - start);
        if part.iter().any(|&x| height(x) < 0.0) {
            part = clip(&part, height);
        }
    }
    part
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_triangle_covers_the_part_of_another_that_is_behind_it() {
        let p = [DVec3::ZERO, DVec3::X * 4.0, DVec3::Y * 4.0];
        let area = |part: &[DVec3]| {
            let fan = part.windows(2).map(|w| (w[0] - part[0]).cross(w[1] - part[0]));
            fan.sum::<DVec3>().length() / 2.0
        };
        for height in [-3.0, 1.0] {
            let q = [DVec3::new(1.0, -1.0, height), DVec3::new(2.0, -1.0, height), DVec3::new(1.0, 9.0, height)];
            for q in [q, [q[1], q[0], q[2]]] {
                let part = covered(p, q, DVec3::Z);
                assert!((area(&part) - 2.05).abs() < 1e-12, "{part:?}");
                let slack = 1e-12;
                assert!(
                    part.iter().all(|x| x.x >= 1.0 - slack && x.y >= -slack && x.x + x.y <= 4.0 + slack),
                    "{part:?}"
                );
            }
            assert!(covered(p, q.map(|x| x + DVec3::X * 9.0), DVec3::Z).is_empty());
        }
    }

    #[test]
    fn a_corner_on_the_plane_is_kept_once() {
        let p = [DVec3::ZERO, DVec3::X, DVec3::Y];
        assert_eq!(clip(&p, |x| x.x).to_vec(), p);
        assert_eq!(clip(&p, |x| -x.x).to_vec(), [DVec3::ZERO, DVec3::Y]);
        assert!(clip(&[], |x| x.x).is_empty());
    }
}
