//! Helpers for readers and writers of paint: building palettes, recognising texture files, and converting colours between sRGB and linear
//! light.

use rustc_hash::FxHashMap;

use crate::scene::{Material, Paint, Palette, Texture};

/// The paint of a mesh's faces, with its palettes and textures; empty if no face is painted.
#[derive(Default)]
pub(super) struct MeshPaint {
    /// The paint of each face; empty if no face is painted.
    pub of_faces: Vec<Paint>,
    /// The palettes that `of_faces` refers to.
    pub palettes: Vec<Palette>,
    /// The textures that palettes refer to.
    pub textures: Vec<Texture>,
}

/// Builds palettes: one of all untextured materials, one of all colours, and one for each textured material, in the order of first use. An
/// entry is identified by the index of its palette and its index there.
#[derive(Default)]
pub(super) struct PaletteBuilder {
    all: Vec<Palette>,
    materials: Option<u32>,
    colors: Option<u32>,
    /// Index of each colour in the palette of colours.
    colored: FxHashMap<[u8; 4], u32>,
}

impl PaletteBuilder {
    /// The finished palettes.
    pub fn finish(self) -> Vec<Palette> {
        self.all
    }

    /// Adds a material; returns its palette and entry.
    pub fn material(&mut self, material: Material) -> (u32, u32) {
        let palette = *self.materials.get_or_insert_with(|| push(&mut self.all, Palette::Materials(Vec::new())));
        let Some(Palette::Materials(materials)) = self.all.get_mut(palette as usize) else { return (palette, 0) };
        materials.push(material);
        (palette, index(materials.len() - 1))
    }

    /// Index of the palette of colours.
    pub fn colors(&mut self) -> u32 {
        *self.colors.get_or_insert_with(|| push(&mut self.all, Palette::Colors(Vec::new())))
    }

    /// Adds a colour unless it is there already; returns its palette and entry.
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

    /// Adds an empty palette of texture coordinates; returns its index.
    pub fn textured(&mut self, texture: u32, name: Option<String>, tint: [u8; 4]) -> u32 {
        push(&mut self.all, Palette::Textured { texture, name, tint, places: Vec::new() })
    }

    /// Adds texture coordinates to a palette; returns the index of the first.
    pub fn add_texture_coordinates(&mut self, palette: u32, new: impl Iterator<Item = [f64; 2]>) -> u32 {
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

/// Adds a palette; returns its index.
fn push(palettes: &mut Vec<Palette>, palette: Palette) -> u32 {
    palettes.push(palette);
    index(palettes.len() - 1)
}

/// An index as u32. Limits on corners and lists keep palettes far smaller than that.
fn index(number: usize) -> u32 {
    u32::try_from(number).unwrap_or(u32::MAX)
}

// Textures are kept as files; nothing here decodes an image.

/// Maximum total bytes of the textures that a model refers to as sidecar files.
pub(super) const MAX_TEXTURE_BYTES: u64 = 128 << 20;

/// Signature, media type and usual extension of the image formats that 3MF and glTF allow.
const IMAGE_TYPES: [(&[u8], &str, &str); 2] =
    [(b"\x89PNG\r\n\x1A\n", "image/png", "png"), (b"\xFF\xD8\xFF", "image/jpeg", "jpg")];

/// The media type of an image; `None` unless it is PNG or JPEG.
pub(super) fn media_type(bytes: &[u8]) -> Option<&'static str> {
    IMAGE_TYPES.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|(_, media_type, _)| *media_type)
}

/// The usual file name extension of an image; `None` unless it is PNG or JPEG.
pub(super) fn extension(bytes: &[u8]) -> Option<&'static str> {
    IMAGE_TYPES.iter().find(|(magic, ..)| bytes.starts_with(magic)).map(|(.., extension)| *extension)
}

// Colours in linear light, as glTF stores them, and in sRGB, as scenes store them (IEC 61966-2-1).

/// A colour component from 0 to 1 as the nearest byte.
pub(super) fn byte(value: f64) -> u8 {
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "clamped to 0..255; not-a-number becomes 0"
    )]
    let byte = (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    byte
}

/// An sRGB component in linear light, from 0 to 1.
fn linear(component: u8) -> f64 {
    let component = f64::from(component) / 255.0;
    if component <= 0.04045 { component / 12.92 } else { ((component + 0.055) / 1.055).powf(2.4) }
}

/// A component in linear light as the nearest sRGB byte.
fn srgb(linear: f64) -> u8 {
    let linear = linear.clamp(0.0, 1.0);
    byte(if linear <= 0.003_130_8 { linear * 12.92 } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 })
}

/// An sRGB colour with alpha as a glTF colour factor, rounded to six decimals.
pub(super) fn linear_factor([r, g, b, alpha]: [u8; 4]) -> [f64; 4] {
    [linear(r), linear(g), linear(b), f64::from(alpha) / 255.0].map(|x| (x * 1e6).round() / 1e6)
}

/// An sRGB colour with alpha as a glTF vertex colour. 16 bits of linear light are enough to restore each 8-bit sRGB component.
pub(super) fn linear_vertex([r, g, b, alpha]: [u8; 4]) -> [u16; 4] {
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "from 0 to 65535")]
    let wide = |component: u8| (linear(component) * 65535.0).round() as u16;
    [wide(r), wide(g), wide(b), u16::from(alpha) * 257]
}

/// A colour in linear light with alpha as an sRGB colour.
pub(super) fn srgb_of_linear([r, g, b, alpha]: [f64; 4]) -> [u8; 4] {
    [srgb(r), srgb(g), srgb(b), byte(alpha)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_colour_survives_conversion_to_a_vertex_colour_and_to_a_factor() {
        for component in 0..=255 {
            let color = [component, 255 - component, component, component];
            let wide = linear_vertex(color).map(|component| f64::from(f32::from(component) / 65535.0));
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
