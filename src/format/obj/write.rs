//! Writing OBJ and its materials: each face has a material, a textured material, or the colours of its vertices.

use std::fmt::Write as _;
use std::sync::Arc;

use glam::DVec3;
use rustc_hash::{FxHashMap, FxHashSet};

use super::super::paint::{extension, media_type};
use super::super::sidecar::ObjZipFiles;
use super::mtl::{self, UNPAINTED, color_name};
use crate::mesh::Soup;
use crate::scene::{PAINTLESS, Paint, PaintedMesh, Palette, Scene, Texture, Wrap};

// Writing to a String can't fail, so the results of `writeln!` are ignored.

/// Writes OBJ without paint. Each f64 is the shortest decimal that parses to the same value.
pub(crate) fn write(soup: &Soup) -> Vec<u8> {
    let mut text = String::with_capacity(48 * soup.positions.len() + 24 * soup.faces.len());
    for &p in &soup.positions {
        vertex(&mut text, p);
        text.push('\n');
    }
    for face in &soup.faces {
        let [a, b, c] = face.map(|v| u64::from(v) + 1);
        let _ = writeln!(text, "f {a} {b} {c}");
    }
    text.into_bytes()
}

/// Writes a mesh with its paint; the OBJ refers to the MTL file as `library`.
///
/// Dropped, because OBJ can't store them: the alpha of colour gradients, a vertex colour that differs between faces (see
/// [`MaterialTable`]), and blanks in names.
pub(crate) fn write_painted(mesh: &PaintedMesh, scene: &Scene, library: &str) -> ObjZipFiles {
    let soup = &mesh.soup;
    let mut table = MaterialTable::new(scene, mesh);
    let mut places = TextureCoordinates::new(scene);
    let mut faces = String::with_capacity(24 * soup.faces.len());
    let mut last = None;
    for (number, face) in soup.faces.iter().enumerate() {
        let face_material = table.face_material(number);
        let material = match face_material {
            FaceMaterial::Unpainted => None,
            FaceMaterial::Material(material, _) => Some(material),
        };
        if last != Some(material) {
            let name = material.map_or(UNPAINTED, |material| table.materials[material].name.as_str());
            let _ = writeln!(faces, "usemtl {name}");
            last = Some(material);
        }
        let [a, b, c] = face.map(|v| u64::from(v) + 1);
        match face_material {
            FaceMaterial::Material(_, Some(paint)) => {
                let [p, q, r] = places.of(paint);
                let _ = writeln!(faces, "f {a}/{p} {b}/{q} {c}/{r}");
            }
            _ => {
                let _ = writeln!(faces, "f {a} {b} {c}");
            }
        }
    }
    if table.materials.is_empty() {
        return ObjZipFiles { obj: write(soup), mtl: None, textures: Vec::new() };
    }
    let mut text = String::with_capacity(48 * soup.positions.len() + places.text.len() + faces.len());
    let _ = writeln!(text, "mtllib {library}");
    for (number, &p) in soup.positions.iter().enumerate() {
        vertex(&mut text, p);
        if let Some(color) = table.vertex_color(number) {
            let [r, g, b] = color.map(decimal);
            let _ = write!(text, " {r} {g} {b}");
        }
        text.push('\n');
    }
    text.push_str(&places.text);
    text.push_str(&faces);
    ObjZipFiles { obj: text.into_bytes(), mtl: Some(materials(&table)), textures: table.textures }
}

fn vertex(text: &mut String, p: DVec3) {
    let _ = write!(text, "v {} {} {}", p.x, p.y, p.z);
}

fn materials(table: &MaterialTable<'_>) -> Vec<u8> {
    let mut text = String::new();
    for material in &table.materials {
        let [r, g, b, alpha] = material.color.map(decimal);
        let _ = writeln!(text, "newmtl {}\nKd {r} {g} {b}", material.name);
        if alpha < 1.0 {
            let _ = writeln!(text, "d {alpha}");
        }
        if let Some((texture_file, clamp)) = material.texture_file {
            let option = if clamp { "-clamp on " } else { "" };
            let _ = writeln!(text, "map_Kd {option}{}", table.textures[texture_file].0);
        }
    }
    text.into_bytes()
}

/// A colour component from 0 to 1 with three decimals, which are enough to restore the byte.
fn decimal(part: u8) -> f64 {
    (f64::from(part) / 255.0 * 1000.0).round() / 1000.0
}

/// Texture coordinates in the order of first use, each written once.
struct TextureCoordinates<'s> {
    scene: &'s Scene,
    known: FxHashMap<[u64; 2], u64>,
    text: String,
}

impl<'s> TextureCoordinates<'s> {
    fn new(scene: &'s Scene) -> Self {
        Self { scene, known: FxHashMap::default(), text: String::new() }
    }

    /// The numbers, counted from 1, of the texture coordinates of a face.
    fn of(&mut self, paint: Paint) -> [u64; 3] {
        let Some(Palette::Textured { places, .. }) = self.scene.palettes.get(paint.palette as usize) else {
            return [0; 3];
        };
        paint.at.map(|at| {
            let [u, v] = places[at as usize].map(|x| if x.is_finite() { x } else { 0.0 });
            let next = self.known.len() as u64 + 1;
            *self.known.entry([u.to_bits(), v.to_bits()]).or_insert_with(|| {
                let _ = writeln!(self.text, "vt {u} {v}");
                next
            })
        })
    }
}

/// The name of the white material of faces that have the colours of their vertices.
const VERTEX_COLORS: &str = "vertex_colors";

/// A material's name as it is written, changed if it looks like the name of a plain colour.
fn written_name(name: &str) -> String {
    let mut name = safe_name(name);
    let hex = name.strip_prefix("color_").filter(|hex| matches!(hex.len(), 6 | 8));
    if hex.is_some_and(|hex| hex.bytes().all(|digit| digit.is_ascii_hexdigit())) {
        name.push('_');
    }
    name
}

/// Whether a material's name only describes its colour.
fn is_color_name(name: &str, color: [u8; 4]) -> bool {
    name.starts_with("color") && safe_name(name) == color_name(color)
}

/// The paint of a face, reduced to what OBJ can store.
#[derive(Clone, Copy)]
enum FacePaint<'s> {
    /// No paint.
    Unpainted,
    /// A named material with a colour.
    Named(&'s str, [u8; 4]),
    /// A textured material.
    Textured { name: &'s str, tint: [u8; 4], texture: &'s Texture },
    /// The colours of the three corners.
    Colored([[u8; 4]; 3]),
}

/// What identifies a material in the MTL file.
#[derive(Clone, Copy, PartialEq, Eq, Hash)]
enum MaterialKey<'s> {
    VertexColors,
    Color([u8; 4]),
    Named(&'s str, [u8; 4]),
    Textured { name: &'s str, tint: [u8; 4], texture_file: usize, clamp: bool },
}

/// A material of the MTL file.
struct WrittenMaterial {
    name: String,
    color: [u8; 4],
    /// Index of its texture in [`MaterialTable::textures`], and whether the texture is clamped.
    texture_file: Option<(usize, bool)>,
}

/// How a face is written.
#[derive(Clone, Copy, PartialEq, Eq)]
enum FaceMaterial {
    /// No material.
    Unpainted,
    /// The index of its material, and its paint if it has texture coordinates.
    Material(usize, Option<Paint>),
}

/// The colour of a vertex.
#[derive(Clone, Copy, PartialEq, Eq)]
enum VertexColor {
    /// Not yet decided.
    Undecided,
    /// No colour, because readers would prefer it over the grey material of a face at the vertex.
    Blocked,
    /// This colour.
    Color([u8; 3]),
}

/// The materials in the order of first use, and the colours of the vertices.
struct MaterialTable<'s> {
    scene: &'s Scene,
    mesh: &'s PaintedMesh,
    materials: Vec<WrittenMaterial>,
    known: FxHashMap<MaterialKey<'s>, usize>,
    names: FxHashSet<String>,
    /// How often each name was requested, to number duplicates.
    requested: FxHashMap<String, usize>,
    /// Texture files with their names.
    textures: Vec<(String, Arc<[u8]>)>,
    known_textures: FxHashMap<&'s [u8], usize>,
    vertex_colors: Vec<VertexColor>,
}

impl<'s> MaterialTable<'s> {
    fn new(scene: &'s Scene, mesh: &'s PaintedMesh) -> Self {
        let mut table = Self {
            scene,
            mesh,
            materials: Vec::new(),
            known: FxHashMap::default(),
            names: FxHashSet::from_iter([UNPAINTED.to_owned()]),
            requested: FxHashMap::default(),
            textures: Vec::new(),
            known_textures: FxHashMap::default(),
            vertex_colors: Vec::new(),
        };
        table.vertex_colors = table.vertex_colors();
        table
    }

    /// The colour of a vertex; `None` if none is written.
    fn vertex_color(&self, vertex: usize) -> Option<[u8; 3]> {
        match self.vertex_colors.get(vertex) {
            Some(VertexColor::Color(color)) => Some(*color),
            _ => None,
        }
    }

    /// How a face is written.
    fn face_material(&mut self, face: usize) -> FaceMaterial {
        let paint = self.mesh.paint.get(face).copied().unwrap_or(PAINTLESS);
        let (key, places) = match self.face_paint(paint) {
            FacePaint::Unpainted => return FaceMaterial::Unpainted,
            FacePaint::Named(name, color) => (MaterialKey::Named(name, color), None),
            FacePaint::Textured { name, tint, texture } => (self.textured_key(name, tint, texture), Some(paint)),
            FacePaint::Colored(colors) => {
                let of_vertices = |colors| has_vertex_colors(&self.vertex_colors, self.mesh.soup.faces[face], colors);
                let key = match of_vertices(colors) || of_vertices([colors[0]; 3]) {
                    true => MaterialKey::VertexColors,
                    false => MaterialKey::Color(colors[0]),
                };
                (key, None)
            }
        };
        self.material(key).map_or(FaceMaterial::Unpainted, |material| FaceMaterial::Material(material, places))
    }

    /// The key of a textured material.
    fn textured_key(&mut self, name: &'s str, tint: [u8; 4], texture: &'s Texture) -> MaterialKey<'s> {
        let next = self.textures.len();
        let texture_file = *self.known_textures.entry(&texture.bytes).or_insert(next);
        if texture_file == next {
            let ending = extension(&texture.bytes).unwrap_or_default();
            self.textures.push((format!("texture_{texture_file}.{ending}"), Arc::clone(&texture.bytes)));
        }
        // MTL has one clamp option for both axes, and no mirroring. Clamping is nearest to a texture without continuation.
        let ends = |wrap| matches!(wrap, Wrap::Clamp | Wrap::None);
        MaterialKey::Textured { name, tint, texture_file, clamp: ends(texture.wrap_u) && ends(texture.wrap_v) }
    }

    /// The index of a material with a unique name; `None` if the MTL file has the maximum number of materials already.
    fn material(&mut self, key: MaterialKey<'s>) -> Option<usize> {
        if let Some(known) = self.known.get(&key) {
            return Some(*known);
        }
        if self.materials.len() >= mtl::MAX_MATERIALS {
            return None;
        }
        let (name, color, texture_file) = match key {
            MaterialKey::VertexColors => (VERTEX_COLORS.to_owned(), [255; 4], None),
            MaterialKey::Color(color) => (color_name(color), color, None),
            MaterialKey::Named(name, color) => (written_name(name), color, None),
            MaterialKey::Textured { name: "", tint, texture_file, clamp } => {
                (format!("texture_{texture_file}"), tint, Some((texture_file, clamp)))
            }
            MaterialKey::Textured { name, tint, texture_file, clamp } => {
                (written_name(name), tint, Some((texture_file, clamp)))
            }
        };
        let mut own = name.clone();
        while !self.names.insert(own.clone()) {
            let count = self.requested.entry(name.clone()).or_insert(1);
            *count += 1;
            own = format!("{name}_{count}");
        }
        self.known.insert(key, self.materials.len());
        self.materials.push(WrittenMaterial { name: own, color, texture_file });
        Some(self.materials.len() - 1)
    }

    /// The paint of a face, reduced to what OBJ can store.
    fn face_paint(&self, paint: Paint) -> FacePaint<'s> {
        let Some(palette) = self.scene.palettes.get(paint.palette as usize) else { return FacePaint::Unpainted };
        if paint.at.iter().any(|&at| at as usize >= palette.len()) {
            return FacePaint::Unpainted;
        }
        let named = |name: &'s str, color| match name.is_empty() || is_color_name(name, color) {
            true => FacePaint::Colored([color; 3]),
            false => FacePaint::Named(name, color),
        };
        match palette {
            Palette::Materials(materials) => {
                let material = &materials[paint.at[0] as usize];
                named(&material.name, material.color)
            }
            // Vertex colours have no alpha; only faces with one colour keep it.
            Palette::Colors(colors) => match paint.at.map(|at| colors[at as usize]) {
                [a, b, c] if a == b && b == c => FacePaint::Colored([a; 3]),
                running => FacePaint::Colored(running.map(|[r, g, b, _]| [r, g, b, 255])),
            },
            Palette::Textured { texture, name, tint, .. } => {
                let (name, tint) = (name.as_deref().unwrap_or_default(), *tint);
                match self.scene.textures.get(*texture as usize) {
                    // A black tint makes the texture black.
                    Some(texture) if media_type(&texture.bytes).is_some() && tint[..3] != [0; 3] => {
                        FacePaint::Textured { name, tint, texture }
                    }
                    _ => named(name, tint),
                }
            }
        }
    }

    /// Decides the colours of vertices; empty if no face has a colour gradient.
    ///
    /// Faces with gradients come first. Faces with one colour then use vertex colours if their vertices allow it. A face with a gradient
    /// whose vertices already have other colours is written in the colour of its first corner.
    fn vertex_colors(&self) -> Vec<VertexColor> {
        let faces =
            || self.mesh.soup.faces.iter().copied().zip(self.mesh.paint.iter().map(|&paint| self.face_paint(paint)));
        let is_gradient = |colors: [[u8; 4]; 3]| colors[0] != colors[1] || colors[1] != colors[2];
        if !faces().any(|(_, face_paint)| matches!(face_paint, FacePaint::Colored(colors) if is_gradient(colors))) {
            return Vec::new();
        }
        let mut vertex_colors = vec![VertexColor::Undecided; self.mesh.soup.positions.len()];
        for (face, face_paint) in faces() {
            // Readers prefer vertex colours over grey materials.
            if matches!(face_paint, FacePaint::Named(_, [r, g, b, _]) if r == g && g == b) {
                face.iter().for_each(|&v| vertex_colors[v as usize] = VertexColor::Blocked);
            }
        }
        let mut any = false;
        for (face, face_paint) in faces() {
            if let FacePaint::Colored(colors) = face_paint
                && is_gradient(colors)
            {
                any |= assign_vertex_colors(&mut vertex_colors, face, colors);
            }
        }
        if !any {
            return Vec::new();
        }
        for (face, face_paint) in faces() {
            if let FacePaint::Colored(colors) = face_paint
                && colors[0][3] == 255
                && !has_vertex_colors(&vertex_colors, face, colors)
            {
                assign_vertex_colors(&mut vertex_colors, face, [colors[0]; 3]);
            }
        }
        vertex_colors
    }
}

/// Gives the vertices of a face these colours; `false` if one of them has another colour already.
fn assign_vertex_colors(vertex_colors: &mut [VertexColor], face: [u32; 3], colors: [[u8; 4]; 3]) -> bool {
    let wanted = colors.map(|[r, g, b, _]| [r, g, b]);
    let differ = |i: usize, j: usize| face[i] == face[j] && wanted[i] != wanted[j];
    let free = |(&v, color): (&u32, &[u8; 3])| match vertex_colors[v as usize] {
        VertexColor::Undecided => true,
        VertexColor::Blocked => false,
        VertexColor::Color(other) => other == *color,
    };
    if differ(0, 1) || differ(1, 2) || differ(2, 0) || !face.iter().zip(&wanted).all(free) {
        return false;
    }
    face.iter().zip(wanted).for_each(|(&v, color)| vertex_colors[v as usize] = VertexColor::Color(color));
    true
}

/// Whether the vertices of a face have exactly its colours.
fn has_vertex_colors(vertex_colors: &[VertexColor], face: [u32; 3], colors: [[u8; 4]; 3]) -> bool {
    !vertex_colors.is_empty()
        && face.iter().zip(colors).all(|(&v, [r, g, b, alpha])| {
            alpha == 255 && vertex_colors.get(v as usize) == Some(&VertexColor::Color([r, g, b]))
        })
}

/// A name without characters that OBJ readers would misread: blanks, control characters, `#` and backslashes.
fn safe_name(name: &str) -> String {
    name.chars().map(|c| if c.is_whitespace() || c.is_control() || matches!(c, '#' | '\\') { '_' } else { c }).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::paint::byte;

    #[test]
    fn every_colour_component_survives_writing_and_reading() {
        for part in 0..=255 {
            assert_eq!(byte(decimal(part)), part);
            assert_eq!(byte(f64::from(decimal(part) as f32)), part);
        }
    }

    #[test]
    fn a_written_name_is_one_word() {
        assert_eq!(safe_name("a b\t#1\\\n\u{a0}ü"), "a_b__1___ü");
    }
}
