//! Paint of OBJ files: material names, texture coordinates, and vertex colours (the extension `v x y z r g b`); and the palettes built from
//! them.

use rustc_hash::FxHashMap;

use super::super::errors::excerpt;
use super::super::faces::NO_INDEX;
use super::super::limits::Limits;
use super::super::paint::{MeshPaint, PaletteBuilder, byte};
use super::super::sidecar::Sidecars;
use super::super::text::{Text, Word, integer, number};
use super::mtl::{self, ColorTexture, MaterialDefinitions, UNPAINTED, color_name};
use crate::scene::{Material, PAINTLESS, Paint, Palette, Texture, Wrap};

/// Maximum number of `mtllib` statements that are read.
const MAX_LIBRARIES: usize = 100;

/// The paint statements read so far.
pub(super) struct PaintStatements<'a> {
    limits: Limits,
    /// Whether textures can be read; texture coordinates are kept only then.
    keep_coordinates: bool,
    places: Vec<[f64; 2]>,
    libraries: Vec<&'a [u8]>,
    /// The material names in use, and the index of each.
    names: Vec<&'a [u8]>,
    numbers: FxHashMap<&'a [u8], u32>,
    /// The triangle from which each material applies, and the material's index.
    uses: Vec<(usize, u32)>,
    /// Colours of the first vertices, up to the last vertex that has one; not-a-number for vertices without.
    colors: Vec<[f32; 3]>,
}

impl<'a> PaintStatements<'a> {
    /// No statements yet. `keep_coordinates` tells whether textures can be read.
    pub fn new(limits: Limits, keep_coordinates: bool) -> Self {
        let (places, libraries, names, numbers) = (Vec::new(), Vec::new(), Vec::new(), FxHashMap::default());
        Self { limits, keep_coordinates, places, libraries, names, numbers, uses: Vec::new(), colors: Vec::new() }
    }

    /// Reads a texture coordinate. Those over the vertex limit are ignored.
    pub fn texture_coordinate(&mut self, text: &mut Text<'_>) {
        if !self.keep_coordinates || self.limits.check_vertices(self.places.len() as u64 + 1).is_err() {
            return;
        }
        let mut next = || text.word_on_line().and_then(|word| number(word.bytes)).filter(|value| value.is_finite());
        self.places.push([next().unwrap_or(0.0), next().unwrap_or(0.0)]);
    }

    /// The texture coordinate index of a corner `v/vt` or `v/vt/vn`; `None` if it has none. The coordinate may come later or not at all.
    pub fn texture_coordinate_index(&self, word: Word<'_>) -> Option<u32> {
        if self.keep_coordinates { field_index(word, 1, self.places.len()) } else { None }
    }

    /// Records an MTL file.
    pub fn library(&mut self, name: &'a [u8]) {
        if self.libraries.len() < MAX_LIBRARIES && !self.libraries.contains(&name) {
            self.libraries.push(name);
        }
    }

    /// Records the material of the triangles after the first `triangles`.
    pub fn material(&mut self, name: &'a [u8], triangles: usize) {
        let number = match self.numbers.get(name) {
            Some(number) => *number,
            None if self.names.len() < mtl::MAX_MATERIALS => {
                let number = u32::try_from(self.names.len()).unwrap_or(NO_INDEX);
                self.names.push(name);
                self.numbers.insert(name, number);
                number
            }
            None => NO_INDEX,
        };
        match self.uses.last_mut() {
            Some(last) if last.1 == number => {}
            Some(last) if last.0 == triangles => last.1 = number,
            _ => self.uses.push((triangles, number)),
        }
    }

    /// Reads the numbers after a vertex's position: a colour if there are three, else a weight, which is ignored.
    #[inline]
    pub fn color(&mut self, vertex: usize, text: &mut Text<'_>) {
        let Some(first) = text.word_on_line() else { return };
        let (Some(second), Some(third)) = (text.word_on_line(), text.word_on_line()) else { return };
        let color = [first, second, third].map(|word| number(word.bytes).unwrap_or(f64::NAN));
        if color.iter().all(|part| part.is_finite()) {
            self.colors.resize(vertex, [f32::NAN; 3]);
            #[expect(clippy::cast_possible_truncation, reason = "f32 is more precise than a colour needs")]
            self.colors.push(color.map(|part| part as f32));
        }
    }

    /// The paint of all triangles. Textures take precedence, then materials, then vertex colours. Vertex colours take precedence over grey
    /// materials, because exporters write a grey material where they need any.
    pub fn paint(
        self,
        triangles: &[[u32; 3]],
        places_of_triangles: &[[u32; 3]],
        sidecars: &Sidecars<'_>,
        warnings: &mut Vec<String>,
    ) -> MeshPaint {
        if self.uses.is_empty() && self.colors.is_empty() {
            return MeshPaint::default();
        }
        let colors = self.colors_of_vertices();
        let mut materials = Materials::new(&self.names, &self.libraries, &self.places, sidecars);
        let mut of_faces = Vec::with_capacity(triangles.len());
        let mut uses = self.uses.iter().peekable();
        let mut material = None;
        for (number, corners) in triangles.iter().enumerate() {
            while let Some((_, next)) = uses.next_if(|(begin, _)| *begin <= number) {
                material = Some(*next);
            }
            let reference = material.map_or(MaterialReference::None, |material| materials.resolve(material));
            let places = places_of_triangles.get(number).copied().unwrap_or([NO_INDEX; 3]);
            of_faces.push(match materials.textured_paint(reference, places) {
                Some(paint) => paint,
                None => {
                    let colors = corners.map(|v| colors.get(v as usize).copied().flatten());
                    materials.plain_paint(reference, colors)
                }
            });
        }
        materials.add_warnings(warnings);
        if of_faces.iter().all(|paint: &Paint| *paint == PAINTLESS) {
            return MeshPaint::default();
        }
        let (palettes, textures) = materials.finish();
        MeshPaint { of_faces, palettes, textures }
    }

    /// The colours of vertices as bytes. Components range from 0 to 1, or from 0 to 255 if any is above 1.
    fn colors_of_vertices(&self) -> Vec<Option<[u8; 3]>> {
        let most = self.colors.iter().flatten().copied().fold(0.0, f32::max);
        let scale = if most > 1.0 { 1.0 / 255.0 } else { 1.0 };
        let color = |color: &[f32; 3]| (!color[0].is_nan()).then(|| color.map(|part| byte(f64::from(part) * scale)));
        self.colors.iter().map(color).collect()
    }
}

/// The index, counted from 0, in a field of a corner `v/vt/vn`. Negative numbers count backwards from `have`.
pub(super) fn field_index(word: Word<'_>, field: usize, have: usize) -> Option<u32> {
    let number = integer(word.bytes.split(|&b| b == b'/').nth(field)?)?;
    let index = if number > 0 { number - 1 } else { (have as i64).saturating_add(number) };
    u32::try_from(index).ok().filter(|_| number != 0)
}

/// Maximum number of MTL files in one statement.
const MAX_LIBRARIES_PER_STATEMENT: usize = 100;

/// What a material name refers to.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
enum MaterialReference {
    /// No material was named.
    None,
    /// The name that marks faces as unpainted.
    Unpainted,
    /// A material that no MTL file defines.
    Undefined,
    /// A defined material.
    Defined {
        number: u32,
        color: [u8; 4],
        has_texture: bool,
        /// Whether the name only describes the colour.
        is_color: bool,
    },
}

/// The materials in use, and the palettes built from them.
struct Materials<'m> {
    names: &'m [&'m [u8]],
    places: &'m [[f64; 2]],
    sidecars: &'m Sidecars<'m>,
    /// An MTL file that was not sent, for a model without an archive.
    unsent_library: Option<&'m [u8]>,
    definitions: MaterialDefinitions,
    /// What each material name refers to.
    references: Vec<MaterialReference>,
    /// The untextured paint of each material.
    plain: FxHashMap<u32, Paint>,
    /// The palette of each textured material; `None` if its texture can't be read.
    textured: FxHashMap<u32, Option<u32>>,
    /// Index in `textures` of each colour texture; `None` if the file can't be read.
    by_color_texture: FxHashMap<ColorTexture, Option<u32>>,
    /// Palette index of each texture coordinate, by palette and coordinate.
    coordinate_entries: FxHashMap<(u32, u32), u32>,
    palettes: PaletteBuilder,
    textures: Vec<Texture>,
    /// Number of triangles with undefined materials, and the first such material.
    undefined: (u64, Option<u32>),
    /// Number of triangles that refer to missing texture coordinates.
    missing_coordinates: u64,
}

impl<'m> Materials<'m> {
    fn new(
        names: &'m [&'m [u8]],
        libraries: &'m [&'m [u8]],
        places: &'m [[f64; 2]],
        sidecars: &'m Sidecars<'m>,
    ) -> Self {
        let mut definitions = MaterialDefinitions::default();
        if !names.is_empty() {
            libraries.iter().for_each(|names| read_libraries(names, sidecars, &mut definitions));
        }
        let resolve_name = |(number, name): (u32, &&[u8])| match definitions.get(*name) {
            Some(definition) => {
                let color = definition.color();
                let is_color = *name == color_name(color).as_bytes();
                MaterialReference::Defined { number, color, has_texture: definition.texture.is_some(), is_color }
            }
            None if name.is_empty() || *name == UNPAINTED.as_bytes() => MaterialReference::Unpainted,
            None => MaterialReference::Undefined,
        };
        let references = (0..).zip(names).map(resolve_name).collect();
        Self {
            names,
            places,
            sidecars,
            unsent_library: if sidecars.has_archive() { None } else { libraries.first().copied() },
            definitions,
            references,
            plain: FxHashMap::default(),
            textured: FxHashMap::default(),
            by_color_texture: FxHashMap::default(),
            coordinate_entries: FxHashMap::default(),
            palettes: PaletteBuilder::default(),
            textures: Vec::new(),
            undefined: (0, None),
            missing_coordinates: 0,
        }
    }

    /// What the material of one more triangle refers to.
    fn resolve(&mut self, number: u32) -> MaterialReference {
        let reference = self.references.get(number as usize).copied().unwrap_or(MaterialReference::Undefined);
        if reference == MaterialReference::Undefined {
            self.undefined.0 += 1;
            self.undefined.1.get_or_insert(number);
        }
        reference
    }

    /// The textured paint of a triangle; `None` if its material has no texture or the triangle has no texture coordinates.
    fn textured_paint(&mut self, reference: MaterialReference, places: [u32; 3]) -> Option<Paint> {
        let MaterialReference::Defined { number, color, has_texture: true, .. } = reference else { return None };
        if places.contains(&NO_INDEX) {
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
            self.missing_coordinates += 1;
            return None;
        }
        let at = places.map(|place| {
            let new = || self.palettes.add_texture_coordinates(palette, std::iter::once(self.places[place as usize]));
            *self.coordinate_entries.entry((palette, place)).or_insert_with(new)
        });
        Some(Paint { palette, at })
    }

    /// The untextured paint of a triangle, whose corners may have colours.
    fn plain_paint(&mut self, reference: MaterialReference, colors: [Option<[u8; 3]>; 3]) -> Paint {
        let alpha = match reference {
            MaterialReference::Unpainted => return PAINTLESS,
            MaterialReference::None | MaterialReference::Undefined => Some(255),
            MaterialReference::Defined { color: [r, g, b, alpha], is_color, .. } => {
                (r == g && g == b && !is_color).then_some(alpha)
            }
        };
        if let (Some(alpha), [Some(a), Some(b), Some(c)]) = (alpha, colors) {
            let at = [a, b, c].map(|[r, g, b]| self.palettes.color([r, g, b, alpha]).1);
            return Paint { palette: self.palettes.colors(), at };
        }
        let MaterialReference::Defined { number, color, is_color, .. } = reference else { return PAINTLESS };
        *self.plain.entry(number).or_insert_with(|| {
            let name = || String::from_utf8_lossy(self.names[number as usize]).into_owned();
            let (palette, entry) = match is_color {
                true => self.palettes.color(color),
                false => self.palettes.material(Material { name: name(), color }),
            };
            Paint { palette, at: [entry; 3] }
        })
    }

    /// Adds warnings, except those about missing files.
    fn add_warnings(&self, warnings: &mut Vec<String>) {
        if let (count, Some(first)) = self.undefined {
            let name = self.names.get(first as usize).copied().unwrap_or_default();
            warnings.push(match self.unsent_library {
                Some(library) => format!(
                    "the model's colours are in the file '{}', which was not sent; to keep them, send both files in one ZIP archive",
                    excerpt(library)
                ),
                None => format!(
                    "triangles with an undefined material were left without colour: {count}, the first has the material '{}'",
                    excerpt(name)
                ),
            });
        }
        if self.missing_coordinates > 0 {
            warnings.push(format!(
                "triangles that refer to missing texture coordinates have their material's plain colour: {}",
                self.missing_coordinates
            ));
        }
    }

    fn finish(self) -> (Vec<Palette>, Vec<Texture>) {
        (self.palettes.finish(), self.textures)
    }

    fn textured_palette(&mut self, number: u32, color: [u8; 4]) -> Option<u32> {
        let color_texture = self.definitions.get(self.names[number as usize])?.texture.clone()?;
        let texture = match self.by_color_texture.get(&color_texture) {
            Some(texture) => *texture,
            None => {
                let texture = self.texture(&color_texture);
                self.by_color_texture.insert(color_texture, texture);
                texture
            }
        }?;
        let name = String::from_utf8_lossy(self.names[number as usize]).into_owned();
        Some(self.palettes.textured(texture, Some(name).filter(|name| !name.is_empty()), color))
    }

    fn texture(&mut self, color_texture: &ColorTexture) -> Option<u32> {
        let (bytes, media_type) = self.sidecars.read_texture(&color_texture.file)?;
        let wrap = if color_texture.clamp { Wrap::Clamp } else { Wrap::Repeat };
        let media_type = media_type.to_owned();
        self.textures.push(Texture { bytes, media_type, wrap_u: wrap, wrap_v: wrap, nearest: false });
        u32::try_from(self.textures.len() - 1).ok()
    }
}

/// Reads the MTL files of a statement: one file whose name may contain blanks, or several files.
fn read_libraries(names: &[u8], sidecars: &Sidecars<'_>, definitions: &mut MaterialDefinitions) {
    let whole = String::from_utf8_lossy(names);
    let whole = whole.trim_matches('"');
    let mut read = |name: &str| {
        if let Some(bytes) = sidecars.read_file(name, mtl::MAX_LIBRARY_BYTES) {
            mtl::read(&bytes, definitions);
        }
    };
    let words: Vec<&str> = whole.split_ascii_whitespace().take(MAX_LIBRARIES_PER_STATEMENT).collect();
    match words[..] {
        // If no interpretation matches a file, the whole name is reported as missing.
        [_, _, ..] if !sidecars.has(whole) && words.iter().any(|name| sidecars.has(name)) => {
            words.iter().for_each(|name| read(name));
        }
        _ => read(whole),
    }
}
