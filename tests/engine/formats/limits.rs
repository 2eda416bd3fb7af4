//! Readers enforce the limits on bytes, faces and vertices.

use meshmend::format::{Format, Limits, ReadErrorKind, read, write};

use super::tetrahedron;

const FORMATS: [Format; 8] = Format::ALL;

#[track_caller]
fn assert_too_large(bytes: &[u8], limits: &Limits, words: [&str; 2]) {
    let error = read(bytes, limits).unwrap_err();
    assert_eq!(error.kind, ReadErrorKind::TooLarge, "{error}");
    assert!(words.iter().all(|w| error.detail.contains(w)), "'{error}' does not say {words:?}");
}

#[test]
fn a_mesh_at_the_limits_is_read() {
    for format in FORMATS {
        let bytes = write(&tetrahedron(), format).unwrap();
        let limits = Limits { max_bytes: bytes.len() as u64, max_faces: 4, max_vertices: 12 };
        assert_eq!(read(&bytes, &limits).unwrap().soup.faces.len(), 4);
    }
}

#[test]
fn more_bytes_than_the_limit_are_refused_with_both_numbers() {
    for format in FORMATS {
        let bytes = write(&tetrahedron(), format).unwrap();
        let limits = Limits { max_bytes: 20, ..Limits::default() };
        assert_too_large(&bytes, &limits, [&format!("{} bytes", bytes.len()), "limit of 20"]);
    }
}

#[test]
fn more_faces_than_the_limit_are_refused_with_both_numbers() {
    for format in FORMATS {
        let bytes = write(&tetrahedron(), format).unwrap();
        let limits = Limits { max_faces: 3, ..Limits::default() };
        assert_too_large(&bytes, &limits, ["4 faces", "limit of 3"]);
    }
}

#[test]
fn more_vertices_than_the_limit_are_refused_with_both_numbers() {
    for format in FORMATS {
        let bytes = write(&tetrahedron(), format).unwrap();
        let limits = Limits { max_vertices: 3, ..Limits::default() };
        assert_too_large(&bytes, &limits, ["vertices", "limit of 3"]);
    }
}

#[test]
fn ascii_readers_keep_the_limits_too() {
    let text = super::ascii_stl(&tetrahedron(), "x");
    assert_too_large(text.as_bytes(), &Limits { max_faces: 3, ..Limits::default() }, ["4 faces", "limit of 3"]);
    assert_too_large(
        text.as_bytes(),
        &Limits { max_vertices: 11, ..Limits::default() },
        ["12 vertices", "limit of 11"],
    );
}

#[test]
fn the_triangles_of_polygons_are_counted() {
    let mut obj = String::new();
    let mut off = "OFF\n100 1 0\n".to_owned();
    let mut ply = "ply\nformat ascii 1.0\nelement vertex 100\nproperty int x\nproperty int y\nproperty int z\nelement face 1\nproperty list uchar int vertex_indices\nend_header\n".to_owned();
    for k in 0..100 {
        obj += &format!("v {k} {} 0\n", k * k);
        off += &format!("{k} {} 0\n", k * k);
        ply += &format!("{k} {} 0\n", k * k);
    }
    let indices = |from: u32| (from..from + 100).map(|k| k.to_string()).collect::<Vec<_>>().join(" ");
    obj += &format!("f {}\n", indices(1));
    off += &format!("100 {}\n", indices(0));
    ply += &format!("100 {}\n", indices(0));
    for text in [obj, off, ply] {
        assert_eq!(read(text.as_bytes(), &Limits::default()).unwrap().soup.faces.len(), 98);
        let limits = Limits { max_faces: 97, ..Limits::default() };
        assert_too_large(text.as_bytes(), &limits, ["98 faces", "limit of 97"]);
    }
}

#[test]
fn warnings_of_one_kind_are_one_however_many_lines_there_are() {
    let mut text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n".to_owned();
    text += &"foo bar\nl 1 2\nf 1 2\n".repeat(10_000);
    let mesh = read(text.as_bytes(), &Limits::default()).unwrap();
    assert_eq!(mesh.warnings.len(), 3);
    assert!(mesh.warnings.iter().all(|w| w.contains("10000") && w.len() < 200), "{:?}", mesh.warnings);
}

#[test]
fn a_word_of_megabytes_is_cut_in_the_message() {
    let text = format!("v 0 0 {}\n", "9x".repeat(1_000_000));
    let error = read(text.as_bytes(), &Limits::default()).unwrap_err();
    assert!(error.detail.len() < 300, "{} bytes", error.detail.len());
}
