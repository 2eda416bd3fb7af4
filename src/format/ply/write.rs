//! Writing PLY: little-endian binary, with colours of vertices or faces.

use crate::mesh::Soup;
use crate::scene::{PAINTLESS, PaintedMesh, Scene};

/// The colour of unpainted faces and vertices in a file with colours.
const WHITE: [u8; 4] = [255; 4];

/// The colours to write.
enum Colors {
    None,
    OfVertices(Vec<[u8; 4]>),
    OfFaces(Vec<[u8; 4]>),
}

/// Writes little-endian binary PLY. Coordinates are `float` if all are exactly representable as f32, else `double`.
pub(crate) fn write(soup: &Soup) -> Vec<u8> {
    write_with(soup, &Colors::None)
}

/// As [`write`], with colours. Textures are dropped.
///
/// If each face has a single colour, faces have colours; otherwise vertices have. PLY allows one colour for each vertex: the first face
/// with a colour gradient sets it, else the first painted face. Unpainted faces and vertices become white.
pub(crate) fn write_painted(mesh: &PaintedMesh, scene: &Scene) -> Vec<u8> {
    write_with(&mesh.soup, &colors(mesh, scene))
}

fn colors(mesh: &PaintedMesh, scene: &Scene) -> Colors {
    let colors = |face: usize| {
        let paint = mesh.paint.get(face).copied().unwrap_or(PAINTLESS);
        scene.palettes.get(paint.palette as usize)?.colors(paint.at)
    };
    let faces = 0..mesh.soup.faces.len();
    let is_gradient = |colors: [[u8; 4]; 3]| colors[0] != colors[1] || colors[1] != colors[2];
    let (mut any, mut has_gradient) = (false, false);
    for colors in faces.clone().filter_map(colors) {
        any = true;
        has_gradient |= is_gradient(colors);
    }
    if !any {
        return Colors::None;
    }
    if !has_gradient {
        return Colors::OfFaces(faces.map(|face| colors(face).map_or(WHITE, |[color, ..]| color)).collect());
    }
    let mut of_vertices: Vec<Option<[u8; 4]>> = vec![None; mesh.soup.positions.len()];
    for running in [true, false] {
        for (face, corners) in mesh.soup.faces.iter().enumerate() {
            let Some(colors) = colors(face).filter(|&colors| is_gradient(colors) == running) else { continue };
            for (&v, color) in corners.iter().zip(colors) {
                of_vertices[v as usize].get_or_insert(color);
            }
        }
    }
    let of_vertices: Vec<[u8; 4]> = of_vertices.into_iter().map(|color| color.unwrap_or(WHITE)).collect();
    let seen = |face: usize| mesh.soup.faces[face].map(|v| of_vertices[v as usize]);
    // A gradient can occur only on degenerate faces that repeat a vertex, and then disappears here.
    match faces.clone().map(seen).any(is_gradient) {
        true => Colors::OfVertices(of_vertices),
        false => Colors::OfFaces(faces.map(|face| seen(face)[0]).collect()),
    }
}

fn write_with(soup: &Soup, colors: &Colors) -> Vec<u8> {
    #[expect(clippy::cast_possible_truncation, reason = "tests whether the cast is exact")]
    let fits_f32 = soup
        .positions
        .iter()
        .all(|p| p.to_array().into_iter().all(|x| x.is_nan() || f64::from(x as f32).to_bits() == x.to_bits()));
    let kind = if fits_f32 { "float" } else { "double" };
    // Most readers expect signed indices.
    let index = if soup.positions.len() > i32::MAX as usize { "uint" } else { "int" };
    let (of_vertices, of_faces): (&[[u8; 4]], &[[u8; 4]]) = match colors {
        Colors::None => (&[], &[]),
        Colors::OfVertices(colors) => (colors, &[]),
        Colors::OfFaces(colors) => (&[], colors),
    };
    // Alpha is written only if some colour is not opaque.
    let parts = |colors: &[[u8; 4]]| match colors {
        [] => 0,
        _ if colors.iter().all(|color| color[3] == 255) => 3,
        _ => 4,
    };
    let (in_vertex, in_face) = (parts(of_vertices), parts(of_faces));
    let header = format!(
        "ply\nformat binary_little_endian 1.0\ncomment meshmend\nelement vertex {}\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n{}element face {}\nproperty list uchar {index} vertex_indices\n{}end_header\n",
        soup.positions.len(),
        properties(in_vertex),
        soup.faces.len(),
        properties(in_face)
    );
    let vertex = if fits_f32 { 12 } else { 24 } + in_vertex;
    let mut bytes =
        Vec::with_capacity(header.len() + vertex * soup.positions.len() + (13 + in_face) * soup.faces.len());
    bytes.extend_from_slice(header.as_bytes());
    for (number, position) in soup.positions.iter().enumerate() {
        for value in position.to_array() {
            if fits_f32 {
                #[expect(clippy::cast_possible_truncation, reason = "exact, as checked")]
                bytes.extend_from_slice(&(value as f32).to_le_bytes());
            } else {
                bytes.extend_from_slice(&value.to_le_bytes());
            }
        }
        if let Some(color) = of_vertices.get(number) {
            bytes.extend_from_slice(&color[..in_vertex]);
        }
    }
    for (number, face) in soup.faces.iter().enumerate() {
        bytes.push(3);
        for v in face {
            bytes.extend_from_slice(&v.to_le_bytes());
        }
        if let Some(color) = of_faces.get(number) {
            bytes.extend_from_slice(&color[..in_face]);
        }
    }
    bytes
}

/// The header lines of the first `parts` colour components.
fn properties(parts: usize) -> String {
    ["red", "green", "blue", "alpha"][..parts].iter().map(|part| format!("property uchar {part}\n")).collect()
}
