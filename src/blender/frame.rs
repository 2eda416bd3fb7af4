use glam::DVec3;

/// Where a model stands while Blender has it: its box centred on the origin and its larger half extent in [16, 32), so
/// that f32 keeps 24 bits of the shape and not of the place, and Blender's absolute tolerances meet ordinary sizes.
///
/// The scale is a power of two, so that only the shift rounds.
#[derive(Debug, Clone, Copy, PartialEq)]
pub(super) struct Frame {
    centre: DVec3,
    /// Model to frame.
    scale: f64,
}

/// Binary exponents that are scaled: outside, a step to f32 and back would leave the normal numbers of f64.
const EXPONENTS: std::ops::RangeInclusive<i64> = -900..=900;
/// The half extent becomes 2^4 to 2^5.
const FRAME_EXPONENT: i64 = 4;

impl Frame {
    /// The frame of the box around `positions`; none where a position is not finite, or the box is a point or of a
    /// size that f64 can't scale (below 2^-900 or above 2^900).
    pub(super) fn around(positions: impl Iterator<Item = DVec3>) -> Option<Self> {
        let mut low = DVec3::INFINITY;
        let mut high = DVec3::NEG_INFINITY;
        for position in positions {
            if !position.is_finite() {
                return None;
            }
            low = low.min(position);
            high = high.max(position);
        }
        // Halves first: the sum of two large corners overflows.
        let half = high * 0.5 - low * 0.5;
        let exponent = binary_exponent(half.max_element())?;
        Some(Self { centre: low * 0.5 + high * 0.5, scale: power_of_two(FRAME_EXPONENT - exponent) })
    }

    /// A position in the frame, rounded as Blender keeps it. Negative zero becomes zero, so that equal positions have
    /// equal bits.
    pub(super) fn enter(&self, position: DVec3) -> [f32; 3] {
        let inside = (position - self.centre) * self.scale;
        #[expect(clippy::cast_possible_truncation, reason = "rounding to f32 is the purpose")]
        inside.to_array().map(|c| c as f32 + 0.0)
    }

    /// A position of the frame in the model's unit and place.
    pub(super) fn leave(&self, position: [f32; 3]) -> DVec3 {
        DVec3::from_array(position.map(f64::from)) / self.scale + self.centre
    }

    /// A length of the model in the frame.
    pub(super) fn enter_length(&self, length: f64) -> f64 {
        length * self.scale
    }

    /// A length of the frame in the model's unit.
    pub(super) fn leave_length(&self, length: f64) -> f64 {
        length / self.scale
    }
}

/// The exponent e of a positive `value` in [2^e, 2^(e+1)); none outside [`EXPONENTS`]. Read from the bits, since a
/// logarithm may differ from machine to machine.
fn binary_exponent(value: f64) -> Option<i64> {
    if !value.is_finite() || value <= 0.0 {
        return None;
    }
    let exponent = ((value.to_bits() >> 52) & 0x7ff).cast_signed() - 1023;
    EXPONENTS.contains(&exponent).then_some(exponent)
}

/// 2 to the power of an exponent between -1022 and 1023.
fn power_of_two(exponent: i64) -> f64 {
    f64::from_bits((1023 + exponent).clamp(1, 2046).cast_unsigned() << 52)
}

#[cfg(test)]
#[allow(clippy::unwrap_used)]
mod tests {
    use super::*;

    fn frame(corners: &[DVec3]) -> Option<Frame> {
        Frame::around(corners.iter().copied())
    }

    #[test]
    fn a_frame_centres_the_box_and_scales_by_a_power_of_two() {
        let corners = [DVec3::new(1000.0, 0.0, 0.0), DVec3::new(1003.0, 1.0, 0.0)];
        let frame = frame(&corners).unwrap();
        assert_eq!(frame.enter(corners[0]), [-24.0, -8.0, 0.0]);
        assert_eq!(frame.enter(corners[1]), [24.0, 8.0, 0.0]);
        assert_eq!(frame.enter_length(3.0), 48.0);
        assert_eq!(frame.leave_length(48.0), 3.0);
    }

    #[test]
    fn leaving_a_frame_undoes_entering_it_at_any_size_and_place() {
        for size in [1e-200, 1e-6, 1.0, 1e9, 1e200] {
            for place in [0.0, 1.0, -1e5] {
                let corners = [DVec3::splat(size * place), DVec3::new(1.0, 0.5, 0.25) * size + size * place];
                let frame = frame(&corners).unwrap();
                for corner in corners {
                    let back = frame.leave(frame.enter(corner));
                    assert!((back - corner).abs().max_element() <= size * 1e-7, "{corner} came back as {back}");
                }
            }
        }
    }

    #[test]
    fn a_box_that_cannot_be_scaled_has_no_frame() {
        assert_eq!(frame(&[]), None);
        assert_eq!(frame(&[DVec3::ONE, DVec3::ONE]), None);
        assert_eq!(frame(&[DVec3::ZERO, DVec3::splat(f64::MIN_POSITIVE)]), None);
        assert_eq!(frame(&[DVec3::splat(-f64::MAX), DVec3::splat(f64::MAX)]), None);
        assert_eq!(frame(&[DVec3::ZERO, DVec3::new(1.0, f64::NAN, 0.0)]), None);
    }

    #[test]
    fn negative_zero_enters_as_zero() {
        let frame = frame(&[DVec3::splat(-1.0), DVec3::splat(1.0)]).unwrap();
        assert_eq!(frame.enter(DVec3::splat(-0.0)).map(f32::to_bits), [0; 3]);
    }
}
