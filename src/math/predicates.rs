//! Exact geometric predicates on points, and orders that depend only on their signs.

use std::cmp::Ordering;
use std::ops::Neg;

use glam::DVec3;
use robust::{Coord, Coord3D};

/// The sign of a determinant, decided exactly.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub enum Sign {
    /// Below zero.
    Negative,
    /// Exactly zero.
    Zero,
    /// Above zero.
    Positive,
}

impl Sign {
    /// The sign of a number; zero for NaN.
    #[must_use]
    pub fn of(value: f64) -> Self {
        if value > 0.0 {
            Self::Positive
        } else if value < 0.0 {
            Self::Negative
        } else {
            Self::Zero
        }
    }

    /// Whether one sign is positive and the other negative.
    #[must_use]
    pub fn opposes(self, other: Self) -> bool {
        matches!((self, other), (Self::Positive, Self::Negative) | (Self::Negative, Self::Positive))
    }
}

impl Neg for Sign {
    type Output = Self;

    fn neg(self) -> Self {
        match self {
            Self::Negative => Self::Positive,
            Self::Zero => Self::Zero,
            Self::Positive => Self::Negative,
        }
    }
}

impl From<Ordering> for Sign {
    /// The sign of a number, from its comparison with zero.
    fn from(order: Ordering) -> Self {
        match order {
            Ordering::Less => Self::Negative,
            Ordering::Equal => Self::Zero,
            Ordering::Greater => Self::Positive,
        }
    }
}

/// The side of the plane `a`, `b`, `c` on which the point `d` lies. Positive if `a`, `b`, `c` appear clockwise seen
/// from `d`: on the inner side of a face that is counter-clockwise seen from outside.
///
/// Shewchuk 1997, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates".
/// Exact for points in the range of [`super::to_unit_range`].
#[must_use]
pub fn orient3d(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Sign {
    let p = |v: DVec3| Coord3D { x: v.x, y: v.y, z: v.z };
    Sign::of(robust::orient3d(p(a), p(b), p(c), p(d)))
}

/// The turn of three points in a plane: positive for counter-clockwise, negative for clockwise, zero for collinear
/// points. Exact for points in the range of [`super::to_unit_range`].
#[must_use]
pub fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    let p = |v: [f64; 2]| Coord { x: v[0], y: v[1] };
    Sign::of(robust::orient2d(p(a), p(b), p(c)))
}

/// Whether three points are collinear, exactly: their projections on the three coordinate planes must all be collinear.
#[must_use]
pub fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    orient2d([a.x, a.y], [b.x, b.y], [c.x, c.y]) == Sign::Zero
        && orient2d([a.y, a.z], [b.y, b.z], [c.y, c.z]) == Sign::Zero
        && orient2d([a.z, a.x], [b.z, b.x], [c.z, c.x]) == Sign::Zero
}

/// Whether the face's area is zero in f64: at one of its corners, the cross product of two sides evaluates to zero. The
/// corners need not be exactly collinear. Programs drop such a face or give it a zero normal.
#[must_use]
pub fn area_vanishes(a: DVec3, b: DVec3, c: DVec3) -> bool {
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().any(|[p, q, r]| (q - p).cross(r - p) == DVec3::ZERO)
}

/// The index of the middle one of three different, collinear points.
#[must_use]
pub fn index_of_middle(points: [DVec3; 3]) -> usize {
    // Along a line the lexicographic order is the geometric order, and comparing needs no arithmetic.
    let key = |i: usize| points[i].to_array();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| {
        let (a, b) = (key(i), key(j));
        a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
    });
    order[1]
}

/// The order of points by angle around the axis from `a` to `b`, counter-clockwise seen from `b`, starting at the
/// direction of the first point. `before` orders points at the same angle.
///
/// Exact for points in the range of [`super::to_unit_range`]. None if a point lies on the axis, where it has no angle.
#[must_use]
pub fn order_around(
    a: DVec3,
    b: DVec3,
    points: &[DVec3],
    before: impl Fn(usize, usize) -> Ordering,
) -> Option<Vec<usize>> {
    if points.iter().any(|&p| collinear(a, b, p)) {
        return None;
    }
    let quarters: Vec<u8> = points.iter().map(|&p| quarter(a, b, points[0], p)).collect();
    let ahead = |i: usize, j: usize| -orient3d(a, b, points[i], points[j]);
    Some(sort_by_angle(&quarters, ahead, before))
}

/// The order of directions around an axis by angle. `quarters` gives the position of each relative to the first: 0 at
/// the same angle, 1 less than half a turn ahead, 2 opposite, 3 beyond. `ahead(i, j)` is positive if `j` is less than
/// half a turn ahead of `i`, and zero if both are collinear. `before` orders directions at the same angle.
#[must_use]
pub fn sort_by_angle(
    quarters: &[u8],
    ahead: impl Fn(usize, usize) -> Sign,
    before: impl Fn(usize, usize) -> Ordering,
) -> Vec<usize> {
    let mut order: Vec<usize> = (0..quarters.len()).collect();
    order.sort_by(|&i, &j| {
        let within_half = || match ahead(i, j) {
            Sign::Positive => Ordering::Less,
            Sign::Negative => Ordering::Greater,
            Sign::Zero => Ordering::Equal,
        };
        let angle = match quarters[i].cmp(&quarters[j]) {
            Ordering::Equal if i != j && quarters[i] % 2 == 1 => within_half(),
            other => other,
        };
        angle.then_with(|| before(i, j)).then(i.cmp(&j))
    });
    order
}

/// The position of `p` relative to the half-plane of `first`: 0 in it, 1 less than half a turn ahead, 2 opposite, 3
/// beyond.
fn quarter(a: DVec3, b: DVec3, first: DVec3, p: DVec3) -> u8 {
    match orient3d(a, b, first, p) {
        Sign::Negative => 1,
        Sign::Positive => 3,
        Sign::Zero if same_side(a, b, first, p) => 0,
        Sign::Zero => 2,
    }
}

/// Whether two points in a plane that contains the line `a`, `b` lie on the same side of the line.
fn same_side(a: DVec3, b: DVec3, p: DVec3, q: DVec3) -> bool {
    for k in 0..3 {
        let flat = |v: DVec3| [v[(k + 1) % 3], v[(k + 2) % 3]];
        let sign = orient2d(flat(a), flat(b), flat(p));
        if sign != Sign::Zero {
            return sign == orient2d(flat(a), flat(b), flat(q));
        }
    }
    false
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::math::precision::to_unit_range;

    #[test]
    fn tiny_tetrahedra_have_an_orientation_after_scaling() {
        let p = to_unit_range(&[DVec3::ZERO, DVec3::X * 1e-110, DVec3::Y * 1e-110, DVec3::Z * 1e-110]);
        assert_ne!(orient3d(p[0], p[1], p[2], p[3]), Sign::Zero);
    }

    #[test]
    fn a_point_one_bit_off_the_line_is_not_collinear() {
        let (a, b) = (DVec3::ZERO, DVec3::new(0.1, 0.3, 0.7));
        let c = b * 2.0;
        assert!(collinear(a, b, c));
        assert!(!collinear(a, b, DVec3::new(c.x, c.y, f64::from_bits(c.z.to_bits() + 1))));
    }

    #[test]
    fn the_middle_of_a_line_is_found_in_any_order() {
        let [a, b, c] = [DVec3::ZERO, DVec3::new(0.0, -1.0, 1.0), DVec3::new(0.0, -2.0, 2.0)];
        assert_eq!(index_of_middle([a, b, c]), 1);
        assert_eq!(index_of_middle([b, c, a]), 0);
        assert_eq!(index_of_middle([c, a, b]), 2);
    }

    #[test]
    fn points_around_an_axis_are_in_counter_clockwise_order() {
        let at = |degrees: f64| DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), degrees / 100.0);
        let angles = [10.0, 350.0, 100.0, 189.0, 11.0, 280.0];
        let points: Vec<DVec3> = angles.iter().map(|&d| at(d)).collect();
        let order = order_around(DVec3::ZERO, DVec3::Z, &points, |_, _| Ordering::Equal).unwrap();
        let sorted: Vec<f64> = order.iter().map(|&i| angles[i]).collect();
        assert_eq!(sorted, [10.0, 11.0, 100.0, 189.0, 280.0, 350.0]);
        // Seen from the other end the order is reversed.
        let order = order_around(DVec3::Z, DVec3::ZERO, &points, |_, _| Ordering::Equal).unwrap();
        assert_eq!(order.iter().map(|&i| angles[i]).collect::<Vec<_>>(), [10.0, 350.0, 280.0, 189.0, 100.0, 11.0]);
    }

    #[test]
    fn points_at_the_same_angle_follow_the_given_order() {
        let points = [DVec3::X, DVec3::new(3.0, 0.0, 2.0), -DVec3::X, DVec3::Y, DVec3::new(-0.1, 0.0, 9.0)];
        let order = order_around(DVec3::ZERO, DVec3::Z, &points, |i, j| j.cmp(&i)).unwrap();
        assert_eq!(order, [1, 0, 3, 4, 2]);
    }

    #[test]
    fn a_point_on_the_axis_has_no_angle() {
        let points = [DVec3::X, DVec3::new(0.0, 0.0, 5.0)];
        assert_eq!(order_around(DVec3::ZERO, DVec3::Z, &points, |_, _| Ordering::Equal), None);
    }
}
