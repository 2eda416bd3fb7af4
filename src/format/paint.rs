//! What readers and writers of paint share: palettes in the making, pictures, and colours in sRGB and in linear light.

use rustc_hash::FxHashMap;

use crate::scene::{Material, Paint, Palette, Texture};

/// What the faces of a mesh are painted with; empty where none is painted.
#[derive(Default)]
pub(super) struct Paints {
    pub of_faces: Vec<Paint>,
    pub palettes: Vec<Palette>,
    pub textures: Vec<Texture>,
}

/// Palettes in the making: one of all materials without a picture, one of all colours, and one for each material with a picture, in the order
/// in which they are asked for. An entry is named by its palette and its place there.
#[derive(Default)]
pub(super) struct Palettes {
    all: Vec<Palette>,
    materials: Option<u32>,
    colors: Option<u32>,
    /// Where a colour is in the palette of colours.
    colored: FxHashMap<[u8; 4], u32>,
}

impl Palettes {
    /// The palettes that were made.
    pub fn finish(self) -> Vec<Palette> {
        self.all
    }

    /// Adds a material.
    pub fn material(&mut self, material: Material) -> (u32, u32) {
        let palette = *self.materials.get_or_insert_with(|| push(&mut self.all, Palette::Materials(Vec::new())));
        let Some(Palette::Materials(materials)) = self.all.get_mut(palette as usize) else { return (palette, 0) };
        materials.push(material);
        (palette, index(materials.len() - 1))
    }

    /// The palette of colours.
    pub fn colors(&mut self) -> u32 {
        *self.colors.get_or_insert_with(|| push(&mut self.all, Palette::Colors(Vec::new())))
    }

    /// A colour, each of which is kept once.
    pub fn color(&mut self, color: [u8; 4]) -> (u32, u32) {
        let palette = self.colors();
        let next = index(self.colored.len());
        let entry = *self.colored.entry(color).or_insert_with(|| {
            if let Some(Palette::Colors(colors)) = self.all.get_mut(palette as usize) {
                colors.push(color);
            }
            next
        });
        (palette, entry)
    }

    /// Adds a palette of places in a texture, without any yet.
    pub fn textured(&mut self, texture: u32, name: Option<String>, tint: [u8; 4]) -> u32 {
        push(&mut self.all, Palette::Textured { texture, name, tint, places: Vec::new() })
    }

    /// Adds places to a palette of such, and tells where they begin.
    pub fn places(&mut self, palette: u32, new: impl Iterator<Item = [f64; 2]>) -> u32 {
        match self.all.get_mut(palette as usize) {
            Some(Palette::Textured { places, .. }) => {
                let base = index(places.len());
                places.extend(new);
                base
            }
            _ => 0,
        }
    }
}

fn push(palettes: &mut Vec<Palette>, palette: Palette) -> u32 {
    palettes.push(palette);
    index(palettes.len() - 1)
}

/// As a number of an entry; the entries of palettes are as bounded as corners and lists are.
fn index(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

// Pictures, kept as the files that they are: nothing here decodes one.

/// Most bytes of all pictures of a file together, where it does not hold them itself.
pub(super) const MOST_PICTURE_BYTES: u64 = 128 << 20;

/// What the files begin with that 3MF and glTF take, their media types and the usual endings of their names.
const KINDS: [(&[u8], &str, &str); 2] =
    [(b"\x89PNG\r\n\x1A\n", "image/png", "png"), (b"\xFF\xD8\xFF", "image/jpeg", "jpg")];

/// The media type of a picture by its first bytes; none for other kinds than PNG and JPEG.
pub(super) fn media_type(bytes: &[u8]) -> Option<&'static str> {
    KINDS.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|(_, media_type, _)| *media_type)
}

/// The usual ending of the name of a file of this kind.
pub(super) fn extension(bytes: &[u8]) -> Option<&'static str> {
    KINDS.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|(.., extension)| *extension)
}

// Colours between linear light, which glTF has, and sRGB, which scenes have (IEC 61966-2-1).

/// The part of a colour that is nearest to a value from 0 to 1.
pub(super) fn byte(value: f64) -> u8 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped; what is not a number becomes 0"
    )]
    let byte = (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    byte
}

/// A part of an sRGB colour in linear light, from 0 to 1.
fn linear(part: u8) -> f64 {
    let part = f64::from(part) / 255.0;
    if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
}

/// The part of an sRGB colour that is nearest to a value in linear light.
fn srgb(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    byte(if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 })
}

/// An sRGB colour with alpha as glTF's factors, to six places.
pub(super) fn linear_factor([r, g, b, alpha]: [u8; 4]) -> [f64; 4] {
    [linear(r), linear(g), linear(b), f64::from(alpha) / 255.0].map(|x| (x * 1e6).round() / 1e6)
}

/// An sRGB colour with alpha as a vertex has it: 16 bits are enough for linear light to give the same 8 bits of sRGB again.
pub(super) fn linear_vertex([r, g, b, alpha]: [u8; 4]) -> [u16; 4] {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 65535")]
    let wide = |part: u8| (linear(part) * 65535.0).round() as u16;
    [wide(r), wide(g), wide(b), u16::from(alpha) * 257]
}

/// Linear light with alpha as an sRGB colour.
pub(super) fn srgb_of_linear([r, g, b, alpha]: [f64; 4]) -> [u8; 4] {
    [srgb(r), srgb(g), srgb(b), byte(alpha)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_colour_comes_back_from_a_vertex_and_from_a_factor() {
        for part in 0..=255 {
            let color = [part, 255 - part, part, part];
            let wide = linear_vertex(color).map(|part| f64::from(f32::from(part) / 65535.0));
            assert_eq!(srgb_of_linear(wide), color);
            assert_eq!(srgb_of_linear(linear_factor(color)), color);
        }
    }

    #[test]
    fn middle_grey_is_darker_in_linear_light() {
        assert!((linear(188) - 0.502_886).abs() < 1e-6);
        assert_eq!([srgb(0.214), srgb(2.0), srgb(-1.0), srgb(f64::NAN)], [127, 255, 0, 0]);
    }
}
