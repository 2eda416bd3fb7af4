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
    fn of(value: f64) -> Self {
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

/// The smallest magnitude that a coordinate keeps in [`to_unit_range`]. Three factors of it, each with 53 bits below,
/// are still above the smallest subnormal number, so that the predicates' expansions do not underflow.
const FLUSH: f64 = 4.909_093_465_297_727e-91; // 2^-300

/// Scales coordinates by one power of two so that the largest magnitude is in `[1, 2)`.
///
/// Shewchuk's predicates are exact only while nothing underflows or overflows. A power of two changes no mantissa, so
/// signs on the scaled points are the signs on the given ones. Points are not moved to the origin: a subtraction
/// rounds, and a rounded input gets an exact answer to the wrong question. What is smaller than 2^-300 of the
/// largest coordinate becomes 0; a file of f32 numbers holds nothing so small.
///
/// All coordinates must be finite.
#[must_use]
pub fn to_unit_range(positions: &[DVec3]) -> Vec<DVec3> {
    let scale = unit_scale(positions);
    let flush = |x: f64| if x.abs() < FLUSH { 0.0 } else { x };
    positions
        .iter()
        .map(|&p| {
            let q = p * scale;
            DVec3::new(flush(q.x), flush(q.y), flush(q.z))
        })
        .collect()
}

/// The power of two by which [`to_unit_range`] scales.
#[must_use]
pub fn unit_scale(positions: &[DVec3]) -> f64 {
    let largest = positions.iter().fold(0.0f64, |m, p| m.max(p.abs().max_element()));
    if largest == 0.0 || !largest.is_finite() {
        return 1.0;
    }
    #[expect(clippy::cast_possible_wrap, reason = "11 bits")]
    let exponent = ((largest.to_bits() >> 52) & 0x7ff) as i64 - 1023;
    let wanted = (-exponent).clamp(-1022, 1023);
    #[expect(clippy::cast_sign_loss, reason = "at least 1 by the clamp")]
    f64::from_bits(((wanted + 1023) as u64) << 52)
}

/// Which side of the plane `a`, `b`, `c` the point `d` is on: positive where `a`, `b`, `c` appear clockwise seen
/// from `d`, that is, on the inner side of a face that is counter-clockwise seen from outside.
///
/// Shewchuk 1997, "Adaptive Precision Floating-Point Arithmetic and Fast Robust Geometric Predicates".
/// Exact for points in the range of [`to_unit_range`].
#[must_use]
pub fn orient3d(a: DVec3, b: DVec3, c: DVec3, d: DVec3) -> Sign {
    let p = |v: DVec3| Coord3D { x: v.x, y: v.y, z: v.z };
    Sign::of(robust::orient3d(p(a), p(b), p(c), p(d)))
}

/// Whether three points of a plane turn counter-clockwise (positive), clockwise (negative) or not at all.
/// Exact for points in the range of [`to_unit_range`].
#[must_use]
pub fn orient2d(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> Sign {
    let p = |v: [f64; 2]| Coord { x: v[0], y: v[1] };
    Sign::of(robust::orient2d(p(a), p(b), p(c)))
}

/// Whether three points lie on a line, exactly: their projections on the three coordinate planes all do.
#[must_use]
pub fn collinear(a: DVec3, b: DVec3, c: DVec3) -> bool {
    orient2d([a.x, a.y], [b.x, b.y], [c.x, c.y]) == Sign::Zero
        && orient2d([a.y, a.z], [b.y, b.z], [c.y, c.z]) == Sign::Zero
        && orient2d([a.z, a.x], [b.z, b.x], [c.z, c.x]) == Sign::Zero
}

/// Whether nobody who computes in f64 finds the area of a face: the cross product of two sides comes out as zero at one of its
/// corners, though they need not lie on a line exactly. Programs drop such a face, or give it a normal of zeros.
#[must_use]
pub fn area_vanishes(a: DVec3, b: DVec3, c: DVec3) -> bool {
    [[a, b, c], [b, c, a], [c, a, b]].into_iter().any(|[p, q, r]| (q - p).cross(r - p) == DVec3::ZERO)
}

/// Of three different points on a line, the index of the one between the others.
#[must_use]
pub fn midmost(points: [DVec3; 3]) -> usize {
    // On a line the lexicographic order is the order along the line, and needs no arithmetic.
    let key = |i: usize| points[i].to_array();
    let mut order = [0, 1, 2];
    order.sort_by(|&i, &j| {
        let (a, b) = (key(i), key(j));
        a[0].total_cmp(&b[0]).then(a[1].total_cmp(&b[1])).then(a[2].total_cmp(&b[2]))
    });
    order[1]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn scaling_by_a_power_of_two_keeps_every_mantissa() {
        let p = [DVec3::new(3.1e-30, -7.3e-31, 0.0)];
        let q = to_unit_range(&p)[0];
        assert!(q.x >= 1.0 && q.x < 2.0);
        assert_eq!(q.x / q.y, p[0].x / p[0].y);
        assert_eq!(q.x.to_bits() << 12, p[0].x.to_bits() << 12);
    }

    #[test]
    fn scaling_stands_the_largest_and_the_smallest_numbers() {
        for x in [f64::MAX, f64::MIN_POSITIVE, 5e-324, 0.0] {
            assert!(to_unit_range(&[DVec3::splat(x)])[0].is_finite());
        }
    }

    #[test]
    fn tiny_triangles_have_a_side_after_scaling() {
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
        assert_eq!(midmost([a, b, c]), 1);
        assert_eq!(midmost([b, c, a]), 0);
        assert_eq!(midmost([c, a, b]), 2);
    }
}
