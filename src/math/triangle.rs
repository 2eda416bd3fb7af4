//! Distances to, and intersections with, a single triangle. Only [`crossing`] is exact; the other functions measure in
//! f64.

use glam::DVec3;

use super::predicates::{Sign, orient3d};

/// Squared sine of the angle at the first corner below which barycentric weights are too inaccurate to be used alone.
/// At this angle they err by less than 1e-12 of the distance to that corner.
const NEEDLE_SINE_SQUARED: f64 = 1e-8;

/// A difference of dot products far above its rounding error, as a share of the lengths.
const FAR_FROM_RIGHT: f64 = 1e-9;

/// Tolerance of [`hit`] beside a triangle, in barycentric weight: larger than their rounding error.
const WEIGHT_TOLERANCE: f64 = 1e-12;

/// Whether a point lies within `reach` of a triangle. Computed in f64: a measurement, not a topological predicate.
#[must_use]
pub fn within(p: DVec3, triangle: [DVec3; 3], reach: f64) -> bool {
    p.distance_squared(nearest_on_triangle(p, triangle)) <= reach * reach
}

/// The point of a triangle nearest to `p`, if it is nearer than `reach`. Same result as [`nearest_on_triangle`], but
/// fast for a triangle whose plane is farther away.
#[must_use]
pub fn nearest_within(p: DVec3, triangle: [DVec3; 3], reach: f64) -> Option<DVec3> {
    let [a, b, c] = triangle;
    let (ab, ac) = (b - a, c - a);
    let normal = ab.cross(ac);
    let square = normal.length_squared();
    let above = normal.dot(p - a);
    // The normal of a needle is dominated by rounding.
    if above * above >= reach * reach * square
        && square > NEEDLE_SINE_SQUARED * ab.length_squared() * ac.length_squared()
    {
        return None;
    }
    let found = nearest_on_triangle(p, triangle);
    (p.distance_squared(found) < reach * reach).then_some(found)
}

/// The point of a triangle nearest to `p`: the foot of the perpendicular if it lies in the triangle, otherwise the
/// nearest point of the edges. A triangle without area consists of its edges.
///
/// Exact up to rounding, also for needles: their barycentric weights are unreliable, so the edges are tested as well.
/// Squares of the coordinates must not overflow.
#[must_use]
pub fn nearest_on_triangle(p: DVec3, [a, b, c]: [DVec3; 3]) -> DVec3 {
    let (ab, ac, ap) = (b - a, c - a, p - a);
    let normal = ab.cross(ac);
    let square = normal.length_squared();
    // p - a = v ab + w ac + the part along the normal.
    let (v, w) = (ap.cross(ac).dot(normal), ab.cross(ap).dot(normal));
    let foot =
        (square > 0.0 && v >= 0.0 && w >= 0.0 && v + w <= square).then(|| a + ab * (v / square) + ac * (w / square));
    if let Some(foot) = foot
        && square > NEEDLE_SINE_SQUARED * ab.length_squared() * ac.length_squared()
    {
        return foot;
    }
    let nearer = |best: DVec3, q: DVec3| if p.distance_squared(q) < p.distance_squared(best) { q } else { best };
    let of_two = nearer(nearest_on_segment(p, [a, b]), nearest_on_segment(p, [b, c]));
    let of_edges = nearer(of_two, nearest_on_segment(p, [c, a]));
    foot.map_or(of_edges, |foot| nearer(of_edges, foot))
}

/// The point of a segment nearest to `p`.
#[must_use]
#[inline]
pub fn nearest_on_segment(p: DVec3, [a, b]: [DVec3; 2]) -> DVec3 {
    let ab = b - a;
    let (along, whole) = ((p - a).dot(ab), ab.length_squared());
    if along <= 0.0 || whole == 0.0 {
        a
    } else if along >= whole {
        b
    } else {
        a + ab * (along / whole)
    }
}

/// How a segment meets a triangle.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Crossing {
    /// No common point.
    Miss,
    /// The segment passes through the interior against the triangle's normal, into the solid.
    Enters,
    /// The segment passes through the interior along the triangle's normal, out of the solid.
    Leaves,
    /// The segment touches the border, one end lies in the plane, or the triangle has no area. Try another segment.
    Touches,
}

/// How the segment from `p` to `q` meets the triangle, from the exact signs of five tetrahedra.
///
/// The points must be in the range of [`super::to_unit_range`].
#[must_use]
pub fn crossing(p: DVec3, q: DVec3, [a, b, c]: [DVec3; 3]) -> Crossing {
    let (sp, sq) = (orient3d(a, b, c, p), orient3d(a, b, c, q));
    if sp == sq && sp != Sign::Zero {
        return Crossing::Miss;
    }
    let edges = [orient3d(p, q, a, b), orient3d(p, q, b, c), orient3d(p, q, c, a)];
    if edges.contains(&Sign::Positive) && edges.contains(&Sign::Negative) {
        return Crossing::Miss;
    }
    if edges.contains(&Sign::Zero) || !sp.opposes(sq) {
        return Crossing::Touches;
    }
    // `orient3d` is positive behind the face.
    if sp == Sign::Negative { Crossing::Enters } else { Crossing::Leaves }
}

/// The centre of a triangle, and the distance of its farthest corner from it.
#[must_use]
pub fn centre_and_radius(corners: [DVec3; 3]) -> (DVec3, f64) {
    let centre = corners.iter().sum::<DVec3>() / 3.0;
    (centre, corners.iter().fold(0.0, |most, p| p.distance(centre).max(most)))
}

/// The square of the length of a triangle's longest side.
#[must_use]
pub fn longest_squared([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
}

/// The corners of a triangle in cyclic order, with the longest side between the first two.
#[must_use]
pub fn longest_side_first([a, b, c]: [DVec3; 3]) -> [DVec3; 3] {
    let [ab, bc, ca] = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    if ab >= bc && ab >= ca {
        [a, b, c]
    } else if bc >= ca {
        [b, c, a]
    } else {
        [c, a, b]
    }
}

/// The two halves of a triangle, cut across its longest side.
#[must_use]
pub fn halves(corners: [DVec3; 3]) -> [[DVec3; 3]; 2] {
    let [a, b, c] = longest_side_first(corners);
    let middle = (a + b) / 2.0;
    [[a, middle, c], [middle, b, c]]
}

/// The parameter, from 0 to 1, at which the segment from `origin` to `origin + step` meets a triangle (Moeller and
/// Trumbore 1997). A segment through a shared edge of two triangles meets at least one of them. Computed in f64: a
/// measurement, not a topological predicate.
#[must_use]
pub fn hit(origin: DVec3, step: DVec3, [a, b, c]: [DVec3; 3]) -> Option<f64> {
    let (e, f) = (b - a, c - a);
    let p = step.cross(f);
    let determinant = e.dot(p);
    if determinant == 0.0 {
        return None;
    }
    let s = origin - a;
    let u = s.dot(p) / determinant;
    if !(-WEIGHT_TOLERANCE..=1.0 + 3.0 * WEIGHT_TOLERANCE).contains(&u) {
        return None;
    }
    let q = s.cross(e);
    let v = step.dot(q) / determinant;
    let t = f.dot(q) / determinant;
    (v >= -WEIGHT_TOLERANCE && u + v <= 1.0 + WEIGHT_TOLERANCE && (0.0..=1.0).contains(&t)).then_some(t)
}

/// Two triangles at an edge that enclose less than a right angle.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct SharpFold {
    /// The angle, in radians. Close to zero, rounding decides it.
    pub angle: f64,
    /// The distance from the edge of the opposite corner that is nearer to it.
    pub width: f64,
}

impl SharpFold {
    /// The fold at an edge, given the corners opposite it. None if the triangles enclose a right angle or more.
    #[must_use]
    pub fn of([a, b]: [DVec3; 2], apexes: [DVec3; 2]) -> Option<Self> {
        let (edge, [to_p, to_q]) = (b - a, apexes.map(|apex| apex - a));
        // Most edges are flat or obtuse. Without square roots this is decided wherever rounding cannot change the answer.
        let dot = to_p.dot(to_q) * edge.length_squared() - to_p.dot(edge) * to_q.dot(edge);
        let most = edge.length_squared() * (to_p.length_squared() + to_q.length_squared());
        if dot < -FAR_FROM_RIGHT * most {
            return None;
        }
        let along = edge.normalize_or_zero();
        // The components perpendicular to the edge, from the edge to the opposite corners.
        let [p, q] = [to_p, to_q].map(|to| to - along * to.dot(along));
        (p.dot(q) > 0.0).then(|| Self { angle: p.cross(q).length().atan2(p.dot(q)), width: p.length().min(q.length()) })
    }

    /// The distance of the triangles from each other if they enclose this angle.
    #[must_use]
    pub fn height(&self, angle: f64) -> f64 {
        self.width * angle.sin()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::r3;

    #[test]
    fn the_longest_side_comes_first_and_the_first_of_equal_ones() {
        let [a, b, c] = [DVec3::ZERO, DVec3::X * 3.0, DVec3::Y];
        assert_eq!(longest_squared([a, b, c]), 10.0);
        for corners in [[a, b, c], [b, c, a], [c, a, b]] {
            assert_eq!(longest_side_first(corners), [b, c, a]);
        }
        let equal = [DVec3::X, DVec3::Y, DVec3::Z];
        assert_eq!(longest_side_first(equal), equal);
        assert_eq!(centre_and_radius([a, b, DVec3::ZERO]), (DVec3::X, 2.0));
    }

    #[test]
    fn the_distance_is_to_the_nearest_of_interior_edges_and_corners() {
        let triangle = [DVec3::ZERO, DVec3::X, DVec3::Y];
        for (p, distance) in [
            (DVec3::new(0.25, 0.25, 0.5), 0.5),
            (DVec3::new(0.5, -2.0, 0.0), 2.0),
            (DVec3::new(-3.0, -4.0, 0.0), 5.0),
            (DVec3::new(1.0, 1.0, 0.0), 0.5f64.sqrt()),
            (DVec3::new(2.0, 0.0, 0.0), 1.0),
            (DVec3::new(0.0, 3.0, 0.0), 2.0),
            (DVec3::new(-1.0, 0.5, 0.0), 1.0),
        ] {
            for turn in 0..3 {
                let mut triangle = triangle;
                triangle.rotate_left(turn);
                assert!(within(p, triangle, distance + 1e-12), "{p}");
                assert!(!within(p, triangle, distance - 1e-12), "{p}");
            }
        }
    }

    #[test]
    fn the_nearest_point_is_returned_exactly_within_the_reach() {
        let corner = |i: u32| DVec3::from(r3(f64::from(i)));
        let (mut near, mut far) = (0, 0);
        for i in 0..2000 {
            let (p, reach) = (corner(i + 9000), 0.1 + f64::from(i % 7) * 0.1);
            for height in [1.0, 1e-6, 0.0] {
                let [a, b, c] = [0, 1, 2].map(|k| corner(3 * i + k));
                let triangle = [a, b, b + (c - b) * height];
                let nearest = nearest_on_triangle(p, triangle);
                let expected = (p.distance(nearest) < reach).then_some(nearest);
                assert_eq!(nearest_within(p, triangle, reach), expected, "{i} {height}");
                *(if expected.is_some() { &mut near } else { &mut far }) += 1;
            }
        }
        assert!(near > 500 && far > 500, "{near} {far}");
    }

    #[test]
    fn needles_and_triangles_without_area_have_a_nearest_point() {
        for height in [0.0, 1e-17, 1e-12, 1e-7] {
            let (a, b, c) = (DVec3::ZERO, DVec3::new(0.7, 0.1, 0.3), DVec3::new(1.4, 0.2 + height, 0.6));
            for (at, t) in [(a, 0.0), (b, 0.5), (c, 1.0), (c * 0.3, 0.3), (c * 0.9, 0.9)] {
                let p = at + DVec3::new(0.1, -0.7, 0.0) * 1e-3;
                for triangle in [[a, b, c], [b, c, a], [c, a, b], [c, b, a]] {
                    let q = nearest_on_triangle(p, triangle);
                    let direct = p.distance(nearest_on_segment(p, [a, c]));
                    assert!((p.distance(q) - direct).abs() < 1e-12 + 2.0 * height, "{height} {t} {q}");
                }
            }
        }
        assert_eq!(nearest_on_triangle(DVec3::X, [DVec3::Y; 3]), DVec3::Y);
    }

    const FACE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn a_segment_through_the_inside_enters_against_the_normal() {
        let (above, below) = (DVec3::new(0.25, 0.25, 1.0), DVec3::new(0.25, 0.25, -1.0));
        assert_eq!(crossing(above, below, FACE), Crossing::Enters);
        assert_eq!(crossing(below, above, FACE), Crossing::Leaves);
    }

    #[test]
    fn a_segment_through_an_edge_touches() {
        assert_eq!(crossing(DVec3::new(0.5, 0.0, 1.0), DVec3::new(0.5, 0.0, -1.0), FACE), Crossing::Touches);
    }

    #[test]
    fn a_segment_that_passes_beside_or_ends_before_the_face_misses() {
        assert_eq!(crossing(DVec3::new(2.0, 2.0, 1.0), DVec3::new(2.0, 2.0, -1.0), FACE), Crossing::Miss);
        assert_eq!(crossing(DVec3::new(0.25, 0.25, 2.0), DVec3::new(0.25, 0.25, 1.0), FACE), Crossing::Miss);
    }

    #[test]
    fn a_segment_that_starts_on_the_face_touches() {
        assert_eq!(crossing(DVec3::new(0.25, 0.25, 0.0), DVec3::new(0.25, 0.25, 1.0), FACE), Crossing::Touches);
    }

    #[test]
    fn a_hit_returns_the_parameter_along_the_segment() {
        let above = DVec3::new(0.25, 0.25, 1.0);
        assert_eq!(hit(above, DVec3::NEG_Z * 4.0, FACE), Some(0.25));
        for miss in [DVec3::NEG_Z * 0.5, DVec3::Z, DVec3::X, DVec3::new(1.0, 1.0, -1.0)] {
            assert_eq!(hit(above, miss, FACE), None, "{miss}");
        }
    }

    #[test]
    fn a_fold_has_the_angle_of_its_triangles_and_is_none_from_a_right_angle_on() {
        let edge = [DVec3::ZERO, DVec3::X * 2.0];
        let fold = |angle: f64| {
            let (sin, cos) = angle.sin_cos();
            SharpFold::of(edge, [DVec3::new(5.0, 3.0, 0.0), DVec3::new(-1.0, 2.0 * cos, 2.0 * sin)])
        };
        for angle in [1e-12, 1e-6, 0.3, 1.57] {
            let found = fold(angle).unwrap();
            assert!((found.angle - angle).abs() < 1e-12 && (found.width - 2.0).abs() < 1e-12, "{angle} {found:?}");
        }
        for angle in [1.571, 1.6, 2.5, std::f64::consts::PI] {
            assert_eq!(fold(angle), None, "{angle}");
        }
        assert_eq!(SharpFold::of([DVec3::X; 2], [DVec3::X; 2]), None, "no triangles");
    }
}
