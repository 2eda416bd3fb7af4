use std::fmt::Write as _;
use std::sync::Arc;

use glam::DVec3;
use rustc_hash::FxHashMap;

use super::write_looks::{Look, Looks, UNPAINTED};
use crate::mesh::Soup;
use crate::scene::{Paint, PaintedMesh, Palette, Scene};

/// What a model is written as.
pub(in crate::format) struct Files {
    pub obj: Vec<u8>,
    /// Its materials, where it has some.
    pub mtl: Option<Vec<u8>>,
    /// The pictures that materials name.
    pub pictures: Vec<(String, Arc<[u8]>)>,
}

// Writing to a string can't fail, so that what `writeln!` answers says nothing.

/// Writes OBJ; every f64 as the shortest decimal that reads back the same.
pub(in crate::format) fn write(soup: &Soup) -> Vec<u8> {
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

/// Writes a mesh with its paint, and the materials to a file of the name `library`.
///
/// What OBJ has no words for is left out: the opacity of colours that run over a face; colours of a vertex in one face where it has others in
/// another (see [`Looks`]); blanks in names.
pub(in crate::format) fn write_painted(mesh: &PaintedMesh, scene: &Scene, library: &str) -> Files {
    let soup = &mesh.soup;
    let mut looks = Looks::new(scene, mesh);
    let mut places = Places::new(scene);
    let mut faces = String::with_capacity(24 * soup.faces.len());
    let mut last = None;
    for (number, face) in soup.faces.iter().enumerate() {
        let look = looks.of_face(number);
        let material = match look {
            Look::Bare => None,
            Look::Material(material, _) => Some(material),
        };
        if last != Some(material) {
            let name = material.map_or(UNPAINTED, |material| looks.materials[material].name.as_str());
            let _ = writeln!(faces, "usemtl {name}");
            last = Some(material);
        }
        let [a, b, c] = face.map(|v| u64::from(v) + 1);
        match look {
            Look::Material(_, Some(paint)) => {
                let [p, q, r] = places.of(paint);
                let _ = writeln!(faces, "f {a}/{p} {b}/{q} {c}/{r}");
            }
            _ => {
                let _ = writeln!(faces, "f {a} {b} {c}");
            }
        }
    }
    if looks.materials.is_empty() {
        return Files { obj: write(soup), mtl: None, pictures: Vec::new() };
    }
    let mut text = String::with_capacity(48 * soup.positions.len() + places.text.len() + faces.len());
    let _ = writeln!(text, "mtllib {library}");
    for (number, &p) in soup.positions.iter().enumerate() {
        vertex(&mut text, p);
        if let Some(color) = looks.of_vertex(number) {
            let [r, g, b] = color.map(fraction);
            let _ = write!(text, " {r} {g} {b}");
        }
        text.push('\n');
    }
    text.push_str(&places.text);
    text.push_str(&faces);
    Files { obj: text.into_bytes(), mtl: Some(materials(&looks)), pictures: looks.pictures }
}

fn vertex(text: &mut String, p: DVec3) {
    let _ = write!(text, "v {} {} {}", p.x, p.y, p.z);
}

fn materials(looks: &Looks<'_>) -> Vec<u8> {
    let mut text = String::new();
    for material in &looks.materials {
        let [r, g, b, alpha] = material.color.map(fraction);
        let _ = writeln!(text, "newmtl {}\nKd {r} {g} {b}", material.name);
        if alpha < 1.0 {
            let _ = writeln!(text, "d {alpha}");
        }
        if let Some((picture, clamp)) = material.picture {
            let option = if clamp { "-clamp on " } else { "" };
            let _ = writeln!(text, "map_Kd {option}{}", looks.pictures[picture].0);
        }
    }
    text.into_bytes()
}

/// A part of a colour, to three places, from which it is read again.
fn fraction(part: u8) -> f64 {
    (f64::from(part) / 255.0 * 1000.0).round() / 1000.0
}

/// The places in pictures that faces name, each once, in that order.
struct Places<'s> {
    scene: &'s Scene,
    known: FxHashMap<[u64; 2], u64>,
    text: String,
}

impl<'s> Places<'s> {
    fn new(scene: &'s Scene) -> Self {
        Self { scene, known: FxHashMap::default(), text: String::new() }
    }

    /// The numbers, counted from 1, of the places of a face.
    fn of(&mut self, paint: Paint) -> [u64; 3] {
        let Some(Palette::Textured { places, .. }) = self.scene.palettes.get(paint.palette as usize) else {
            return [0; 3];
        };
        paint.at.map(|at| {
            let [u, v] = places[at as usize].map(|it| if it.is_finite() { it } else { 0.0 });
            let next = self.known.len() as u64 + 1;
            *self.known.entry([u.to_bits(), v.to_bits()]).or_insert_with(|| {
                let _ = writeln!(self.text, "vt {u} {v}");
                next
            })
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::format::palettes::byte;

    #[test]
    fn every_part_of_a_colour_is_read_again() {
        for part in 0..=255 {
            assert_eq!(byte(fraction(part)), part);
            assert_eq!(byte(f64::from(fraction(part) as f32)), part);
        }
    }
}
