//! MESH files, which consist of numbered `Vertex` and `Face` lines: reading, writing and refused files.

use glam::DVec3;
use meshmend::format::{FileLocation, Format, ReadErrorKind, write};
use meshmend::mesh::Numbering;

use super::{assert_refused, assert_warned, read_all, tetrahedron};

const IN_ORDER: Numbering = Numbering {
    vertices_contiguous: true,
    faces_contiguous: true,
    missing_vertices: 0,
    faces_without_vertex: 0,
    omitted: Vec::new(),
    missing: Vec::new(),
    vertex_numbers: Vec::new(),
    face_numbers: Vec::new(),
};

#[test]
fn vertices_and_faces_are_written_a_line_each_with_numbers_from_one() {
    let text = String::from_utf8(write(&tetrahedron(), Format::Mesh).unwrap()).unwrap();
    assert_eq!(
        text,
        "Vertex 1 0 0 0\nVertex 2 1 0 0\nVertex 3 0 1 0\nVertex 4 0 0 1\nFace 1 1 3 2\nFace 2 1 2 4\nFace 3 2 3 4\nFace 4 3 1 4\n"
    );
    let mesh = read_all(text.as_bytes());
    assert_eq!((mesh.format, mesh.numbering), (Format::Mesh, Some(IN_ORDER)));
    assert_eq!((mesh.soup, mesh.warnings), (tetrahedron(), Vec::new()));
}

#[test]
fn numbers_may_have_gaps_and_lines_may_stand_in_any_order() {
    let mesh = read_all(b"Face 5 40 10 20\n\n# between\nVertex 20 0 1 0\nvertex 40 0 0 0\r\nVERTEX\t10 1 0 0\n");
    assert_eq!(mesh.soup.positions, [DVec3::Y, DVec3::ZERO, DVec3::X]);
    assert_eq!(mesh.soup.faces, [[1, 2, 0]]);
    assert_eq!(mesh.warnings, Vec::<String>::new());
    let expected = Numbering {
        vertices_contiguous: false,
        faces_contiguous: false,
        vertex_numbers: vec![20, 40, 10],
        face_numbers: vec![5],
        ..IN_ORDER
    };
    assert_eq!(mesh.numbering, Some(expected));
}

#[test]
fn numbers_out_of_order_are_not_contiguous_though_none_is_missing() {
    let mesh = read_all(b"Vertex 2 1 0 0\nVertex 1 0 0 0\nVertex 3 0 1 0\nFace 1 1 2 3\n");
    assert_eq!(
        mesh.numbering,
        Some(Numbering { vertices_contiguous: false, vertex_numbers: vec![2, 1, 3], ..IN_ORDER })
    );
    assert_eq!(mesh.soup.faces, [[1, 0, 2]]);
}

#[test]
fn faces_that_name_a_missing_vertex_are_left_out_and_each_vertex_is_counted_once() {
    for numbers in [[1, 2, 3], [1, 2, 5]] {
        let [a, b, c] = numbers;
        let text = format!(
            "Vertex {a} 0 0 0\nVertex {b} 1 0 0\nVertex {c} 0 1 0\nFace 1 {a} {b} 9\nFace 2 {a} {b} {c}\nFace 3 9 {a} 8\n"
        );
        let mesh = read_all(text.as_bytes());
        assert_eq!(mesh.soup.faces, [[0, 1, 2]]);
        let numbering = mesh.numbering.as_ref().unwrap();
        assert_eq!((numbering.missing_vertices, numbering.faces_without_vertex), (2, 2));
        assert!(numbering.faces_contiguous);
        assert_warned(&mesh, "missing: 2, the first is number 8");
    }
}

#[test]
fn a_vertex_number_given_twice_is_refused_at_its_second_line() {
    let text = b"Vertex 1 0 0 0\nVertex 2 1 0 0\nFace 1 1 2 2\nVertex 2 0 1 0\n";
    assert_refused(text, ReadErrorKind::Malformed, Some(FileLocation::Line(4)), "vertex 2 is defined a second time");
}

#[test]
fn an_error_in_a_line_is_reported_with_its_line() {
    let line = |n| Some(FileLocation::Line(n));
    for (text, place, words) in [
        ("Vertex 1 0 0\nFace 1 1 1 1\n", line(1), "the line ends where a coordinate"),
        ("Vertex 1 0 0 0\nFace 1 1 1\nFace 2 1 1 1\n", line(2), "the line ends where the number of a vertex"),
        ("Vertex 1 0 0 0\nFace 1 1 1 1 1\n", line(2), "three vertices"),
        ("Vertex 1 0 x 0\nFace 1 1 1 1\n", line(1), "'x'"),
        ("Vertex 1 0 0 0\nFace 1 1 1 0\n", line(2), "numbers must be from 1"),
        ("Vertex 1 0 0 0\nFace 1 1 1 -3\n", line(2), "'-3'"),
        ("Vertex 1 0 0 0\nFace 1 1 1 4294967296\n", line(2), "4294967295"),
        ("Vertex 1 0 0 0\nVertex 1.5 0 0 0\n", line(2), "'1.5'"),
    ] {
        assert_refused(text.as_bytes(), ReadErrorKind::Malformed, place, words);
    }
    assert_refused(b"Vertex 1 0 0 0\nFace 1 1 1", ReadErrorKind::Truncated, line(2), "cut off");
}

#[test]
fn a_file_without_a_whole_face_is_refused() {
    assert_refused(b"Vertex 1 0 0 0\n", ReadErrorKind::NoFaces, None, "point cloud");
    assert_refused(b"Vertex 1 0 0 0\nFace 1 1 2 3\n", ReadErrorKind::NoFaces, None, "refer to missing vertices");
}

#[test]
fn lines_of_other_kinds_are_passed_over_and_counted() {
    let text = "Vertex 1 0 0 0\nColour red\nVertex 2 1 0 0\nVertex 3 0 1 0\nFace 1 1 2 3\nEnd\n";
    let mesh = read_all(text.as_bytes());
    assert_warned(&mesh, "were ignored: 2, the first begins with 'Colour'");
    assert_eq!(mesh.soup.faces.len(), 1);
}

#[test]
fn other_formats_have_no_numbering() {
    for format in [Format::Stl, Format::Obj, Format::Ply, Format::Off] {
        assert_eq!(read_all(&write(&tetrahedron(), format).unwrap()).numbering, None);
    }
}
