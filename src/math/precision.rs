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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_rounded_one_by_one_and_none_becomes_infinite() {
        let rounded = Precision::F32.round(DVec3::new(0.1, -1e39, f64::from(f32::MAX) * 1.000_000_001));
        assert_eq!(rounded, DVec3::new(f64::from(0.1f32), -1e39, f64::from(f32::MAX)));
    }
}
