//! Reading and writing of files: dialects, damaged files, warnings and errors.

mod any_bytes;
mod limits;
mod normals;
mod obj;
mod obj_colors;
mod off;
mod ply;
mod ply_colors;
mod round_trip;
mod sniffing;
mod stl;
mod threemf;
mod vertex_face;
mod zip;

use glam::DVec3;
use meshmend::format::{FileLocation, Limits, ReadError, ReadErrorKind, ReadMesh, read};
use meshmend::mesh::Soup;

/// A tetrahedron with outward faces.
fn tetrahedron() -> Soup {
    Soup {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    }
}

fn read_all(bytes: &[u8]) -> ReadMesh {
    match read(bytes, &Limits::default()) {
        Ok(mesh) => mesh,
        Err(error) => panic!("{error}\n{}", String::from_utf8_lossy(&bytes[..bytes.len().min(300)])),
    }
}

fn refused(bytes: &[u8]) -> ReadError {
    match read(bytes, &Limits::default()) {
        Ok(mesh) => panic!("expected an error, read {mesh:?}"),
        Err(error) => error,
    }
}

/// The corner positions of all faces: what a format without indices keeps.
fn corners(soup: &Soup) -> Vec<[DVec3; 3]> {
    (0..soup.faces.len()).map(|face| soup.corners(face)).collect()
}

/// The triangles as an ASCII STL file.
fn ascii_stl(soup: &Soup, name: &str) -> String {
    let mut text = format!("solid {name}\n");
    for [a, b, c] in corners(soup) {
        text += "  facet normal 0 0 0\n    outer loop\n";
        for p in [a, b, c] {
            text += &format!("      vertex {} {} {}\n", p.x, p.y, p.z);
        }
        text += "    endloop\n  endfacet\n";
    }
    text + &format!("endsolid {name}\n")
}

#[track_caller]
fn assert_refused(bytes: &[u8], kind: ReadErrorKind, place: Option<FileLocation>, words: &str) {
    let error = refused(bytes);
    assert_eq!((error.kind, error.place), (kind, place), "{error}");
    assert!(error.detail.contains(words), "'{error}' does not say '{words}'");
}

/// Asserts that there is one warning and that it contains these words.
#[track_caller]
fn assert_warned(mesh: &ReadMesh, words: &str) {
    assert_eq!(mesh.warnings.len(), 1, "{:?}", mesh.warnings);
    assert!(mesh.warnings[0].contains(words), "'{}' does not say '{words}'", mesh.warnings[0]);
}
