//! What an OBJ file says of paint: materials by name, places in pictures, and the extension `v x y z r g b` for colours of vertices.

use rustc_hash::FxHashMap;

use super::super::Limits;
use super::super::beside::Beside;
use super::super::content::Paints;
use super::super::faces::NONE;
use super::super::palettes::byte;
use super::super::text::{Text, Word, number};
use super::field_index;
use super::materials::{Materials, Named};
use super::mtl;
use crate::scene::{PAINTLESS, Paint};

/// Most libraries of materials that a file may name.
const LIBRARIES: usize = 100;

/// What has been said so far.
pub(super) struct Said<'a> {
    limits: Limits,
    /// Whether there may be pictures, for which alone places in them are of use.
    pictures: bool,
    places: Vec<[f64; 2]>,
    libraries: Vec<&'a [u8]>,
    /// The materials that faces name, and their numbers.
    names: Vec<&'a [u8]>,
    numbers: FxHashMap<&'a [u8], u32>,
    /// From which triangle on which material is used.
    uses: Vec<(usize, u32)>,
    /// Of the first vertices, up to the last that has one; not a number for one that has none.
    colors: Vec<[f32; 3]>,
}

impl<'a> Said<'a> {
    pub fn new(limits: Limits, pictures: bool) -> Self {
        let (places, libraries, names, numbers) = (Vec::new(), Vec::new(), Vec::new(), FxHashMap::default());
        Self { limits, pictures, places, libraries, names, numbers, uses: Vec::new(), colors: Vec::new() }
    }

    /// A place in a picture. Those beyond the limit of vertices are passed over.
    pub fn place(&mut self, text: &mut Text<'_>) {
        if !self.pictures || self.limits.check_vertices(self.places.len() as u64 + 1).is_err() {
            return;
        }
        let mut next = || text.word_on_line().and_then(|word| number(word.bytes)).filter(|it| it.is_finite());
        self.places.push([next().unwrap_or(0.0), next().unwrap_or(0.0)]);
    }

    /// The place of a corner `v/vt` or `v/vt/vn`, if it has one. It may be read later, or never.
    pub fn place_index(&self, word: Word<'_>) -> Option<u32> {
        if self.pictures { field_index(word, 1, self.places.len()) } else { None }
    }

    pub fn library(&mut self, name: &'a [u8]) {
        if self.libraries.len() < LIBRARIES && !self.libraries.contains(&name) {
            self.libraries.push(name);
        }
    }

    /// The material of what follows after so many triangles.
    pub fn material(&mut self, name: &'a [u8], triangles: usize) {
        let number = match self.numbers.get(name) {
            Some(number) => *number,
            None if self.names.len() < mtl::MOST => {
                let number = u32::try_from(self.names.len()).unwrap_or(NONE);
                self.names.push(name);
                self.numbers.insert(name, number);
                number
            }
            None => NONE,
        };
        match self.uses.last_mut() {
            Some(last) if last.1 == number => {}
            Some(last) if last.0 == triangles => last.1 = number,
            _ => self.uses.push((triangles, number)),
        }
    }

    /// What may follow a vertex's position: its weight, or its colour.
    #[inline]
    pub fn color(&mut self, vertex: usize, text: &mut Text<'_>) {
        let Some(first) = text.word_on_line() else { return };
        let (Some(second), Some(third)) = (text.word_on_line(), text.word_on_line()) else { return };
        let color = [first, second, third].map(|word| number(word.bytes).unwrap_or(f64::NAN));
        if color.iter().all(|part| part.is_finite()) {
            self.colors.resize(vertex, [f32::NAN; 3]);
            #[expect(clippy::cast_possible_truncation, reason = "far more exact than a colour")]
            self.colors.push(color.map(|part| part as f32));
        }
    }

    /// The paint of all triangles. A picture goes before colours of vertices; these before a material that is a shade of grey, which is what
    /// programs say where they have to say something; and any other material before colours of vertices.
    pub fn paint(
        self,
        triangles: &[[u32; 3]],
        places_of_triangles: &[[u32; 3]],
        beside: &Beside<'_>,
        warnings: &mut Vec<String>,
    ) -> Paints {
        if self.uses.is_empty() && self.colors.is_empty() {
            return Paints::default();
        }
        let colors = self.colors_of_vertices();
        let mut materials = Materials::new(&self.names, &self.libraries, &self.places, beside);
        let mut of_faces = Vec::with_capacity(triangles.len());
        let mut uses = self.uses.iter().peekable();
        let mut material = None;
        for (number, corners) in triangles.iter().enumerate() {
            while let Some((_, next)) = uses.next_if(|(begin, _)| *begin <= number) {
                material = Some(*next);
            }
            let named = material.map_or(Named::Nothing, |material| materials.named(material));
            let places = places_of_triangles.get(number).copied().unwrap_or([NONE; 3]);
            of_faces.push(match materials.pictured(named, places) {
                Some(paint) => paint,
                None => {
                    let colors = corners.map(|v| colors.get(v as usize).copied().flatten());
                    materials.plain(named, colors)
                }
            });
        }
        materials.tell(warnings);
        if of_faces.iter().all(|paint: &Paint| *paint == PAINTLESS) {
            return Paints::default();
        }
        let (palettes, textures) = materials.finish();
        Paints { of_faces, palettes, textures }
    }

    /// Colours are from 0 to 1, or from 0 to 255 where any is above 1.
    fn colors_of_vertices(&self) -> Vec<Option<[u8; 3]>> {
        let most = self.colors.iter().flatten().copied().fold(0.0, f32::max);
        let scale = if most > 1.0 { 1.0 / 255.0 } else { 1.0 };
        let color = |color: &[f32; 3]| (!color[0].is_nan()).then(|| color.map(|part| byte(f64::from(part) * scale)));
        self.colors.iter().map(color).collect()
    }
}
