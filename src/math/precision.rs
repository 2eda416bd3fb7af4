//! Floating-point precision of files, and scaling of coordinates into the range where the exact predicates hold.

use glam::DVec3;

use super::threads;

/// The floating-point format in which a file holds coordinates.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default)]
pub enum Precision {
    /// Single precision, as in STL.
    #[default]
    F32,
    /// Double precision: coordinates stay as they are.
    F64,
}

impl Precision {
    /// The position as a file of this precision stores it. Coordinates too large for f32 stay unchanged, because
    /// infinity is no valid position.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
    pub fn round(self, p: DVec3) -> DVec3 {
        let nearest = |x: f64| Some(f64::from(x as f32)).filter(|rounded| rounded.is_finite()).unwrap_or(x);
        match self {
            Self::F32 => DVec3::new(nearest(p.x), nearest(p.y), nearest(p.z)),
            Self::F64 => p,
        }
    }
}

/// Rounds positions that were scaled for the exact predicates: to the values that the output file can store, in the
/// scaled unit.
#[derive(Debug, Clone, Copy)]
pub struct Rounding {
    /// Factor by which positions in the model's unit were multiplied: a power of two.
    pub scale: f64,
    /// Precision of the output file.
    pub precision: Precision,
}

impl Rounding {
    /// The position that a reader of the file gets, in the scaled unit.
    #[must_use]
    pub fn of(self, p: DVec3) -> DVec3 {
        match self.precision {
            Precision::F32 => Precision::F32.round(p / self.scale) * self.scale,
            Precision::F64 => p,
        }
    }
}

/// The smallest magnitude that [`to_unit_range`] keeps. A product of three such factors, with 53 bits below it, exceeds
/// the smallest subnormal number, so the predicates' expansions do not underflow.
const FLUSH: f64 = 4.909_093_465_297_727e-91; // 2^-300

/// Scales coordinates by one power of two so that the largest magnitude is in `[1, 2)`.
///
/// Shewchuk's predicates are exact only without underflow and overflow. A power of two changes no mantissa, so the
/// signs for the scaled points are the signs for the original ones. Points are not moved to the origin: the subtraction
/// would round, and an exact predicate of rounded input answers the wrong question. Values below 2^-300 of the largest
/// coordinate become 0; no f32 file holds such values.
///
/// All coordinates must be finite.
#[must_use]
pub fn to_unit_range(positions: &[DVec3]) -> Vec<DVec3> {
    let scale = unit_scale(positions);
    let flush = |x: f64| if x.abs() < FLUSH { 0.0 } else { x };
    threads::map_cheap(positions.len(), |v| {
        let q = positions[v] * scale;
        DVec3::new(flush(q.x), flush(q.y), flush(q.z))
    })
}

/// The power of two by which [`to_unit_range`] scales; 1 if all coordinates are 0 or one is not finite.
#[must_use]
pub fn unit_scale(positions: &[DVec3]) -> f64 {
    let largest = positions.iter().fold(0.0f64, |m, p| m.max(p.abs().max_element()));
    if largest == 0.0 || !largest.is_finite() {
        return 1.0;
    }
    #[expect(clippy::cast_possible_wrap, reason = "11 bits")]
    let exponent = ((largest.to_bits() >> 52) & 0x7ff) as i64 - 1023;
    let shift = (-exponent).clamp(-1022, 1023);
    #[expect(clippy::cast_sign_loss, reason = "at least 1 by the clamp")]
    f64::from_bits(((shift + 1023) as u64) << 52)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_coordinate_is_rounded_and_none_becomes_infinite() {
        let rounded = Precision::F32.round(DVec3::new(0.1, -1e39, f64::from(f32::MAX) * 1.000_000_001));
        assert_eq!(rounded, DVec3::new(f64::from(0.1f32), -1e39, f64::from(f32::MAX)));
    }

    #[test]
    fn scaling_by_a_power_of_two_keeps_every_mantissa() {
        let p = [DVec3::new(3.1e-30, -7.3e-31, 0.0)];
        let q = to_unit_range(&p)[0];
        assert!(q.x >= 1.0 && q.x < 2.0);
        assert_eq!(q.x / q.y, p[0].x / p[0].y);
        assert_eq!(q.x.to_bits() << 12, p[0].x.to_bits() << 12);
    }

    #[test]
    fn scaling_keeps_the_largest_and_smallest_numbers_finite() {
        for x in [f64::MAX, f64::MIN_POSITIVE, 5e-324, 0.0] {
            assert!(to_unit_range(&[DVec3::splat(x)])[0].is_finite());
        }
    }
}
