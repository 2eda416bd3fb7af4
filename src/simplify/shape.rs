use glam::DVec3;

use super::start::area_vector;
use crate::math::collinear;

/// Cosine of the largest angle by which one collapse may turn a face.
const LEAST_COSINE: f64 = 0.2;
/// Roundness below which a face is a needle: then it must not become worse.
const NEEDLE: f64 = 1e-4;
/// Roundness below which a worse face makes an edge wait for others.
const SLENDER: f64 = 0.05;
/// Share of the square of its longest edge above which a triangle's area is not a matter of rounding.
const CERTAIN: f64 = 1e-12;

/// How a collapse changes the shapes of faces.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Shape {
    Good,
    /// Slender faces come about: better later, or elsewhere.
    Poor,
    /// A face turns over, has no area or becomes a needle.
    Bad,
}

/// Judges what becomes of faces: `gone` are those that vanish, `changed` those before and after.
pub(super) fn shape(gone: &[[DVec3; 3]], changed: &[([DVec3; 3], [DVec3; 3])]) -> Shape {
    let mut least_before = gone.iter().map(|&f| roundness(f)).fold(1.0, f64::min);
    let mut least_after = 1.0f64;
    for &(before, after) in changed {
        let (n, m) = (area_vector(before), area_vector(after));
        let (long, square) = (longest_squared(after), n.length_squared() * m.length_squared());
        if m.length() <= CERTAIN * long && collinear(after[0], after[1], after[2]) {
            return Shape::Bad;
        }
        // A face without area has no side to turn over.
        if n.length() > CERTAIN * longest_squared(before) && n.dot(m) < LEAST_COSINE * square.sqrt() {
            return Shape::Bad;
        }
        least_before = least_before.min(roundness(before));
        least_after = least_after.min(roundness(after));
    }
    match least_after {
        it if it >= SLENDER || it >= least_before => Shape::Good,
        it if it >= NEEDLE => Shape::Poor,
        _ => Shape::Bad,
    }
}

/// 1 for an equilateral triangle, 0 for one without area: its area for the sum of its squared sides.
fn roundness([a, b, c]: [DVec3; 3]) -> f64 {
    let sides = a.distance_squared(b) + b.distance_squared(c) + c.distance_squared(a);
    if sides > 0.0 { 2.0 * 3f64.sqrt() * area_vector([a, b, c]).length() / sides } else { 0.0 }
}

fn longest_squared([a, b, c]: [DVec3; 3]) -> f64 {
    a.distance_squared(b).max(b.distance_squared(c)).max(c.distance_squared(a))
}

#[cfg(test)]
mod tests {
    use super::*;

    const BEFORE: [DVec3; 3] = [DVec3::ZERO, DVec3::X, DVec3::Y];

    #[test]
    fn faces_that_turn_over_or_lose_their_area_are_bad() {
        let with = |tip: DVec3| shape(&[], &[(BEFORE, [DVec3::ZERO, DVec3::X, tip])]);
        assert_eq!(with(DVec3::Y), Shape::Good);
        assert_eq!(with(-DVec3::Y), Shape::Bad);
        assert_eq!(with(DVec3::X * 3.0), Shape::Bad);
        assert_eq!(with(DVec3::new(0.5, 0.01, 0.0)), Shape::Poor);
        assert_eq!(with(DVec3::new(0.5, 1e-6, 0.0)), Shape::Bad);
    }

    #[test]
    fn a_slender_face_is_good_where_one_as_slender_goes() {
        let slender = [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.005, 0.0)];
        assert_eq!(shape(&[slender], &[(BEFORE, [DVec3::ZERO, DVec3::X, DVec3::new(0.5, 0.01, 0.0)])]), Shape::Good);
    }
}
