//! The materials that faces name, as palettes.

use rustc_hash::FxHashMap;

use super::super::beside::Beside;
use super::super::errors::shown;
use super::super::faces::NONE;
use super::super::palettes::Palettes;
use super::mtl::{self, Definitions, Picture};
use super::write_looks::{UNPAINTED, color_name};
use crate::scene::{Material, PAINTLESS, Paint, Palette, Texture, Wrap};

/// Most libraries in one statement.
const LIBRARIES: usize = 100;

/// What a name stands for.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(super) enum Named {
    /// No name was said.
    Nothing,
    /// Said to be not painted.
    Unpainted,
    /// A material that no library has.
    Unknown,
    /// The material of a number.
    Known {
        number: u32,
        color: [u8; 4],
        has_picture: bool,
        /// Whether the name says no more than the colour.
        is_color: bool,
    },
}

/// Materials in use.
pub(super) struct Materials<'m> {
    names: &'m [&'m [u8]],
    places: &'m [[f64; 2]],
    beside: &'m Beside<'m>,
    /// A library that is not there, of a model that came alone.
    alone: Option<&'m [u8]>,
    definitions: Definitions,
    /// What each name stands for.
    named: Vec<Named>,
    /// The paint of a material without its picture.
    plain: FxHashMap<u32, Paint>,
    /// The palette of a material with a picture; none where that can't be had.
    textured: FxHashMap<u32, Option<u32>>,
    pictures: FxHashMap<Picture, Option<u32>>,
    /// Where a place is in a palette.
    placed: FxHashMap<(u32, u32), u32>,
    palettes: Palettes,
    textures: Vec<Texture>,
    /// Triangles whose material no library has, and the first such material.
    unknown: (u64, Option<u32>),
    /// Triangles that name a place in a picture that is not there.
    displaced: u64,
}

impl<'m> Materials<'m> {
    pub fn new(
        names: &'m [&'m [u8]],
        libraries: &'m [&'m [u8]],
        places: &'m [[f64; 2]],
        beside: &'m Beside<'m>,
    ) -> Self {
        let mut definitions = Definitions::default();
        if !names.is_empty() {
            libraries.iter().for_each(|names| read(names, beside, &mut definitions));
        }
        let stands_for = |(number, name): (u32, &&[u8])| match definitions.get(*name) {
            Some(definition) => {
                let color = definition.color();
                let is_color = *name == color_name(color).as_bytes();
                Named::Known { number, color, has_picture: definition.picture.is_some(), is_color }
            }
            None if name.is_empty() || *name == UNPAINTED.as_bytes() => Named::Unpainted,
            None => Named::Unknown,
        };
        let named = (0..).zip(names).map(stands_for).collect();
        Self {
            names,
            places,
            beside,
            alone: if beside.is_something() { None } else { libraries.first().copied() },
            definitions,
            named,
            plain: FxHashMap::default(),
            textured: FxHashMap::default(),
            pictures: FxHashMap::default(),
            placed: FxHashMap::default(),
            palettes: Palettes::default(),
            textures: Vec::new(),
            unknown: (0, None),
            displaced: 0,
        }
    }

    /// What the name of a number stands for, which one more triangle has.
    pub fn named(&mut self, number: u32) -> Named {
        let named = self.named.get(number as usize).copied().unwrap_or(Named::Unknown);
        if named == Named::Unknown {
            self.unknown.0 += 1;
            self.unknown.1.get_or_insert(number);
        }
        named
    }

    /// The paint of a triangle in places of its material's picture; none where it has no picture or no places.
    pub fn pictured(&mut self, named: Named, places: [u32; 3]) -> Option<Paint> {
        let Named::Known { number, color, has_picture: true, .. } = named else { return None };
        if places.contains(&NONE) {
            return None;
        }
        let palette = match self.textured.get(&number) {
            Some(palette) => *palette,
            None => {
                let palette = self.textured_palette(number, color);
                self.textured.insert(number, palette);
                palette
            }
        }?;
        if places.iter().any(|&place| place as usize >= self.places.len()) {
            self.displaced += 1;
            return None;
        }
        let at = places.map(|place| {
            let new = || self.palettes.places(palette, std::iter::once(self.places[place as usize]));
            *self.placed.entry((palette, place)).or_insert_with(new)
        });
        Some(Paint { palette, at })
    }

    /// The paint of a triangle without a picture, whose corners may have colours.
    pub fn plain(&mut self, named: Named, colors: [Option<[u8; 3]>; 3]) -> Paint {
        let alpha = match named {
            Named::Unpainted => return PAINTLESS,
            Named::Nothing | Named::Unknown => Some(255),
            Named::Known { color: [r, g, b, alpha], is_color, .. } => (r == g && g == b && !is_color).then_some(alpha),
        };
        if let (Some(alpha), [Some(a), Some(b), Some(c)]) = (alpha, colors) {
            let at = [a, b, c].map(|[r, g, b]| self.palettes.color([r, g, b, alpha]).1);
            return Paint { palette: self.palettes.colors(), at };
        }
        let Named::Known { number, color, is_color, .. } = named else { return PAINTLESS };
        *self.plain.entry(number).or_insert_with(|| {
            let name = || String::from_utf8_lossy(self.names[number as usize]).into_owned();
            let (palette, entry) = match is_color {
                true => self.palettes.color(color),
                false => self.palettes.material(Material { name: name(), color }),
            };
            Paint { palette, at: [entry; 3] }
        })
    }

    /// What there is to tell, but for files that are missing.
    pub fn tell(&self, warnings: &mut Vec<String>) {
        if let (count, Some(first)) = self.unknown {
            let name = self.names.get(first as usize).copied().unwrap_or_default();
            warnings.push(match self.alone {
                Some(library) => format!(
                    "the model's colours are in the file '{}', which was not sent; to keep them, send it and the model in one ZIP archive",
                    shown(library)
                ),
                None => format!(
                    "triangles whose material is not defined were left without colour: {count}, the first of '{}'",
                    shown(name)
                ),
            });
        }
        if self.displaced > 0 {
            warnings.push(format!(
                "triangles that name a place in a picture that is not there are in their material's colour: {}",
                self.displaced
            ));
        }
    }

    pub fn finish(self) -> (Vec<Palette>, Vec<Texture>) {
        (self.palettes.finish(), self.textures)
    }

    fn textured_palette(&mut self, number: u32, color: [u8; 4]) -> Option<u32> {
        let picture = self.definitions.get(self.names[number as usize])?.picture.clone()?;
        let texture = match self.pictures.get(&picture) {
            Some(texture) => *texture,
            None => {
                let texture = self.texture(&picture);
                self.pictures.insert(picture, texture);
                texture
            }
        }?;
        let name = String::from_utf8_lossy(self.names[number as usize]).into_owned();
        Some(self.palettes.textured(texture, Some(name).filter(|name| !name.is_empty()), color))
    }

    fn texture(&mut self, picture: &Picture) -> Option<u32> {
        let (bytes, media_type) = self.beside.picture(&picture.file)?;
        let wrap = if picture.clamp { Wrap::Clamp } else { Wrap::Repeat };
        let media_type = media_type.to_owned();
        self.textures.push(Texture { bytes, media_type, wrap_u: wrap, wrap_v: wrap, nearest: false });
        u32::try_from(self.textures.len() - 1).ok()
    }
}

/// Reads the libraries of a statement: one whose name may have blanks, or several.
fn read(names: &[u8], beside: &Beside<'_>, definitions: &mut Definitions) {
    let whole = String::from_utf8_lossy(names);
    let whole = whole.trim_matches('"');
    let mut read = |name: &str| {
        if let Some(bytes) = beside.file(name, mtl::MOST_BYTES) {
            mtl::read(&bytes, definitions);
        }
    };
    let words: Vec<&str> = whole.split_ascii_whitespace().take(LIBRARIES).collect();
    match words[..] {
        // A name with blanks that is not there is told as it stands.
        [_, _, ..] if !beside.has(whole) && words.iter().any(|name| beside.has(name)) => {
            words.iter().for_each(|name| read(name));
        }
        _ => read(whole),
    }
}
