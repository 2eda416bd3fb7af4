use rustc_hash::FxHashMap;

use crate::scene::{Material, Palette};

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
