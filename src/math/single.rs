use glam::DVec3;

/// The nearest position with coordinates of f32; those that are too large for one stay as they are, since infinity is nowhere.
#[must_use]
#[expect(clippy::cast_possible_truncation, reason = "rounding is the purpose")]
pub fn to_single(p: DVec3) -> DVec3 {
    let nearest = |x: f64| Some(f64::from(x as f32)).filter(|it| it.is_finite()).unwrap_or(x);
    DVec3::new(nearest(p.x), nearest(p.y), nearest(p.z))
}

/// How positions are rounded that were scaled, as for exact predicates: to what the result's file will say, scaled again.
#[derive(Debug, Clone, Copy)]
pub struct Rounding {
    /// What positions in the model's unit were multiplied by: a power of two.
    pub scale: f64,
    /// Whether the file holds f32; otherwise positions stay as they are.
    pub to_f32: bool,
}

impl Rounding {
    /// The position that will be read again.
    #[must_use]
    pub fn of(self, p: DVec3) -> DVec3 {
        if self.to_f32 { to_single(p / self.scale) * self.scale } else { p }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coordinates_are_rounded_one_by_one_and_none_becomes_infinite() {
        let rounded = to_single(DVec3::new(0.1, -1e39, f64::from(f32::MAX) * 1.000_000_001));
        assert_eq!(rounded, DVec3::new(f64::from(0.1f32), -1e39, f64::from(f32::MAX)));
    }
}
