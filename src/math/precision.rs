use glam::DVec3;

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
    /// The position that a file of this precision holds. Coordinates too large for f32 stay as they are, since infinity is no place.
    #[must_use]
    #[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
    pub fn round(self, p: DVec3) -> DVec3 {
        let nearest = |x: f64| Some(f64::from(x as f32)).filter(|it| it.is_finite()).unwrap_or(x);
        match self {
            Self::F32 => DVec3::new(nearest(p.x), nearest(p.y), nearest(p.z)),
            Self::F64 => p,
        }
    }
}

/// How scaled positions are rounded, as for exact predicates: to what the result's file will hold, scaled again.
#[derive(Debug, Clone, Copy)]
pub struct Rounding {
    /// What positions in the model's unit were multiplied by: a power of two.
    pub scale: f64,
    /// The precision of the file.
    pub precision: Precision,
}

impl Rounding {
    /// The position that will be read again.
    #[must_use]
    pub fn of(self, p: DVec3) -> DVec3 {
        match self.precision {
            Precision::F32 => Precision::F32.round(p / self.scale) * self.scale,
            Precision::F64 => p,
        }
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_rounded_one_by_one_and_none_becomes_infinite() {
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
    fn scaling_stands_the_largest_and_the_smallest_numbers() {
        for x in [f64::MAX, f64::MIN_POSITIVE, 5e-324, 0.0] {
            assert!(to_unit_range(&[DVec3::splat(x)])[0].is_finite());
        }
    }
}
