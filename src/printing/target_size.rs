//! The scale factor that brings a model to a requested size.

use glam::DVec3;

use crate::math::Box3;
use crate::scene::{Unit, Up};

/// A requested size.
#[derive(Debug, Clone, Copy, PartialEq)]
pub enum TargetSize {
    /// The extent along the up axis, in millimetres.
    HeightMm(f64),
    /// The longest side of the bounding box, in millimetres.
    LongestMm(f64),
}

/// Why there is no scale factor.
#[derive(Debug, Clone, Copy, PartialEq, Eq, thiserror::Error)]
pub enum TargetSizeError {
    /// The target is not a positive number.
    #[error("the target size must be a number above 0")]
    NotPositive,
    /// The model has no points.
    #[error("the model is empty, so it has no size to scale")]
    Empty,
    /// The extent that the target names is zero.
    #[error("the model is flat along the up axis; give the longest side instead of the height")]
    Flat,
    /// All sides are zero.
    #[error("the model is a point, so no factor gives it a size")]
    Point,
    /// The factor is too large or too small for a number.
    #[error("the factor between the model's size and the target is out of range")]
    OutOfRange,
}

/// The factor by which to multiply coordinates so that the model has the target size when they are in `unit`.
///
/// # Errors
/// [`TargetSizeError`] if the target is not positive or if the model has no such extent.
pub fn scale_to_target(bounds: &Box3, unit: Unit, up: Up, target: TargetSize) -> Result<f64, TargetSizeError> {
    if bounds.is_empty() {
        return Err(TargetSizeError::Empty);
    }
    let size: DVec3 = bounds.max - bounds.min;
    let (extent, wanted, none) = match target {
        TargetSize::LongestMm(wanted) => (size.max_element(), wanted, TargetSizeError::Point),
        TargetSize::HeightMm(wanted) => {
            let height = match up {
                Up::Y => size.y,
                Up::Z => size.z,
            };
            let none = if size.max_element() > 0.0 { TargetSizeError::Flat } else { TargetSizeError::Point };
            (height, wanted, none)
        }
    };
    if !(wanted > 0.0 && wanted.is_finite()) {
        return Err(TargetSizeError::NotPositive);
    }
    if extent <= 0.0 {
        return Err(none);
    }
    let factor = wanted / unit.millimetres() / extent;
    if factor.is_normal() { Ok(factor) } else { Err(TargetSizeError::OutOfRange) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sized(x: f64, y: f64, z: f64) -> Box3 {
        Box3 { min: DVec3::new(-1.0, 2.0, 3.0), max: DVec3::new(x - 1.0, y + 2.0, z + 3.0) }
    }

    #[test]
    fn the_factor_gives_the_height_along_the_up_axis_or_the_longest_side() {
        let bounds = sized(2.0, 4.0, 8.0);
        let factor = |unit, up, target| scale_to_target(&bounds, unit, up, target);
        assert_eq!(factor(Unit::Millimetre, Up::Z, TargetSize::HeightMm(120.0)), Ok(15.0));
        assert_eq!(factor(Unit::Millimetre, Up::Y, TargetSize::HeightMm(120.0)), Ok(30.0));
        assert_eq!(factor(Unit::Millimetre, Up::Y, TargetSize::LongestMm(120.0)), Ok(15.0));
        assert_eq!(factor(Unit::Metre, Up::Z, TargetSize::LongestMm(8000.0)), Ok(1.0));
    }

    #[test]
    fn a_target_that_cannot_be_met_is_refused_with_the_reason() {
        let factor = |bounds: &Box3, target| scale_to_target(bounds, Unit::Millimetre, Up::Z, target);
        let solid = sized(1.0, 1.0, 1.0);
        for wanted in [0.0, -3.0, f64::NAN, f64::INFINITY] {
            assert_eq!(factor(&solid, TargetSize::HeightMm(wanted)), Err(TargetSizeError::NotPositive));
        }
        assert_eq!(factor(&sized(1.0, 1.0, 0.0), TargetSize::HeightMm(5.0)), Err(TargetSizeError::Flat));
        assert_eq!(factor(&sized(0.0, 0.0, 0.0), TargetSize::HeightMm(5.0)), Err(TargetSizeError::Point));
        assert_eq!(factor(&sized(0.0, 0.0, 0.0), TargetSize::LongestMm(5.0)), Err(TargetSizeError::Point));
        assert_eq!(factor(&Box3::EMPTY, TargetSize::LongestMm(5.0)), Err(TargetSizeError::Empty));
        let speck = Box3 { min: DVec3::ZERO, max: DVec3::splat(1e-310) };
        assert_eq!(factor(&speck, TargetSize::LongestMm(5e5)), Err(TargetSizeError::OutOfRange));
    }
}
