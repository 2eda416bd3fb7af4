//! Colours between linear light, which glTF has, and sRGB, which scenes have (IEC 61966-2-1).

use super::super::palettes::byte;

/// A part of an sRGB colour in linear light, from 0 to 1.
pub(super) fn linear(part: u8) -> f64 {
    let part = f64::from(part) / 255.0;
    if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
}

/// The part of an sRGB colour that is nearest to a value in linear light.
pub(super) fn srgb(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    byte(if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 })
}

/// An sRGB colour with alpha as glTF's factors, to six places.
pub(super) fn factor([r, g, b, alpha]: [u8; 4]) -> [f64; 4] {
    [linear(r), linear(g), linear(b), f64::from(alpha) / 255.0].map(|x| (x * 1e6).round() / 1e6)
}

/// An sRGB colour with alpha as a vertex has it: 16 bits are enough for linear light to give the same 8 bits of sRGB again.
pub(super) fn of_vertex([r, g, b, alpha]: [u8; 4]) -> [u16; 4] {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 65535")]
    let wide = |part: u8| (linear(part) * 65535.0).round() as u16;
    [wide(r), wide(g), wide(b), u16::from(alpha) * 257]
}

/// Linear light with alpha as an sRGB colour.
pub(super) fn of_linear([r, g, b, alpha]: [f64; 4]) -> [u8; 4] {
    [srgb(r), srgb(g), srgb(b), byte(alpha)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_colour_comes_back_from_a_vertex_and_from_a_factor() {
        for part in 0..=255 {
            let color = [part, 255 - part, part, part];
            let wide = of_vertex(color).map(|part| f64::from(f32::from(part) / 65535.0));
            assert_eq!(of_linear(wide), color);
            assert_eq!(of_linear(factor(color)), color);
        }
    }

    #[test]
    fn middle_grey_is_darker_in_linear_light() {
        assert!((linear(188) - 0.502_886).abs() < 1e-6);
        assert_eq!([srgb(0.214), srgb(2.0), srgb(-1.0), srgb(f64::NAN)], [127, 255, 0, 0]);
    }
}
