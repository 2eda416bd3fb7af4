use std::cmp::Ordering;

use glam::DVec3;

use super::{Sign, collinear, orient2d, orient3d};

/// Points sorted by their angle around the axis from `a` to `b`, counter-clockwise seen from `b`, beginning with the
/// direction of the first point. `before` orders points at the same angle.
///
/// Decided by exact signs for points in the range of [`super::to_unit_range`]. None where a point lies on the axis,
/// since it has no angle.
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
    let ahead = |i: usize, j: usize| match orient3d(a, b, points[i], points[j]) {
        Sign::Negative => Sign::Positive,
        Sign::Positive => Sign::Negative,
        Sign::Zero => Sign::Zero,
    };
    Some(sort_by_angle(&quarters, ahead, before))
}

/// Directions around an axis sorted by angle. `quarters` tells for each where it is as seen from the first: 0 at its angle, 1 less
/// than half a turn on, 2 opposite, 3 beyond. `ahead(i, j)` is positive where `j` is less than half a turn on from `i`, and zero
/// where both are on one line. `before` orders directions at the same angle.
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

/// Where `p` is as seen from the half-plane of `first`: 0 in it, 1 less than half a turn on, 2 opposite, 3 beyond.
fn quarter(a: DVec3, b: DVec3, first: DVec3, p: DVec3) -> u8 {
    match orient3d(a, b, first, p) {
        Sign::Negative => 1,
        Sign::Positive => 3,
        Sign::Zero if same_side(a, b, first, p) => 0,
        Sign::Zero => 2,
    }
}

/// Whether two points in a plane with the line `a`, `b` lie on the same side of it.
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
#[allow(clippy::unwrap_used, reason = "a test fails by panicking")]
mod tests {
    use super::*;

    #[test]
    fn points_around_an_axis_stand_in_counter_clockwise_order() {
        let at = |degrees: f64| DVec3::new(degrees.to_radians().cos(), degrees.to_radians().sin(), degrees / 100.0);
        let angles = [10.0, 350.0, 100.0, 189.0, 11.0, 280.0];
        let points: Vec<DVec3> = angles.iter().map(|&d| at(d)).collect();
        let order = order_around(DVec3::ZERO, DVec3::Z, &points, |_, _| Ordering::Equal).unwrap();
        let sorted: Vec<f64> = order.iter().map(|&i| angles[i]).collect();
        assert_eq!(sorted, [10.0, 11.0, 100.0, 189.0, 280.0, 350.0]);
        // Seen from the other end it is the other way round.
        let order = order_around(DVec3::Z, DVec3::ZERO, &points, |_, _| Ordering::Equal).unwrap();
        assert_eq!(order.iter().map(|&i| angles[i]).collect::<Vec<_>>(), [10.0, 350.0, 280.0, 189.0, 100.0, 11.0]);
    }

    #[test]
    fn points_at_the_same_angle_stand_as_asked() {
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
