//! PLY: reading, writing and refused files.

use glam::DVec3;
use meshmend::format::{FileLocation, Format, ReadErrorKind, write};

use super::{assert_refused, assert_warned, read_all, refused, tetrahedron};

const HEADER: &str = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 4\nproperty list uchar int vertex_indices\nend_header\n";
const VERTICES: &str = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";
const FACES: &str = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n";

fn ascii() -> String {
    format!("{HEADER}{VERTICES}{FACES}")
}

#[track_caller]
fn assert_tetrahedron(bytes: &[u8], dialect: &str) {
    let mesh = read_all(bytes);
    assert_eq!((mesh.format, mesh.dialect.as_str()), (Format::Ply, dialect));
    assert_eq!(mesh.warnings, Vec::<String>::new());
    assert_eq!(mesh.soup, tetrahedron());
}

/// A number as one of PLY's types, in either byte order.
fn push(bytes: &mut Vec<u8>, kind: &str, value: f64, little: bool) {
    let at = bytes.len();
    match kind {
        "char" | "int8" => bytes.extend((value as i8).to_be_bytes()),
        "uchar" | "uint8" => bytes.extend((value as u8).to_be_bytes()),
        "short" | "int16" => bytes.extend((value as i16).to_be_bytes()),
        "ushort" | "uint16" => bytes.extend((value as u16).to_be_bytes()),
        "int" | "int32" => bytes.extend((value as i32).to_be_bytes()),
        "uint" | "uint32" => bytes.extend((value as u32).to_be_bytes()),
        "float" | "float32" => bytes.extend((value as f32).to_be_bytes()),
        "double" | "float64" => bytes.extend(value.to_be_bytes()),
        _ => panic!("{kind}"),
    }
    if little {
        bytes[at..].reverse();
    }
}

/// The tetrahedron with extra elements and properties, both scalars and lists, around the ones that are read.
fn binary(vertex: &str, count: &str, index: &str, little: bool) -> Vec<u8> {
    let order = if little { "little" } else { "big" };
    let header = format!(
        "ply\r\nformat binary_{order}_endian 1.0\r\ncomment a b c\r\nobj_info d\r\nelement camera 2\r\nproperty double focus\r\nproperty list uchar short lens\r\nelement vertex 4\r\nproperty uchar red\r\nproperty {vertex} x\r\nproperty {vertex} y\r\nproperty list ushort double weights\r\nproperty {vertex} z\r\nelement material 3\r\nproperty int id\r\nelement face 4\r\nproperty list uchar float texcoord\r\nproperty list {count} {index} vertex_index\r\nproperty char flag\r\nelement edge 1\r\nproperty int a\r\nend_header\r\n"
    );
    let mut bytes = header.into_bytes();
    let soup = tetrahedron();
    for camera in 0..2 {
        push(&mut bytes, "double", 0.5, little);
        push(&mut bytes, "uchar", f64::from(camera), little);
        (0..camera).for_each(|k| push(&mut bytes, "short", f64::from(k), little));
    }
    for (k, p) in soup.positions.iter().enumerate() {
        push(&mut bytes, "uchar", 255.0, little);
        push(&mut bytes, vertex, p.x, little);
        push(&mut bytes, vertex, p.y, little);
        push(&mut bytes, "ushort", k as f64, little);
        (0..k).for_each(|_| push(&mut bytes, "double", 0.25, little));
        push(&mut bytes, vertex, p.z, little);
    }
    (0..3).for_each(|k| push(&mut bytes, "int", f64::from(k), little));
    for face in &soup.faces {
        push(&mut bytes, "uchar", 2.0, little);
        (0..2).for_each(|_| push(&mut bytes, "float", 0.5, little));
        push(&mut bytes, count, 3.0, little);
        face.iter().for_each(|&v| push(&mut bytes, index, f64::from(v), little));
        push(&mut bytes, "char", -1.0, little);
    }
    push(&mut bytes, "int", 7.0, little);
    bytes
}

#[test]
fn ascii_ply_is_read() {
    assert_tetrahedron(ascii().as_bytes(), "ASCII PLY");
}

#[test]
fn an_ascii_ply_may_have_any_line_ends() {
    assert_tetrahedron(ascii().replace('\n', "\r\n").as_bytes(), "ASCII PLY");
    assert_tetrahedron(ascii().replace('\n', "\r").as_bytes(), "ASCII PLY");
    assert_tetrahedron(ascii().trim_end().as_bytes(), "ASCII PLY");
}

#[test]
fn all_number_types_and_both_byte_orders_are_read() {
    for little in [true, false] {
        let dialect = if little { "binary little-endian PLY" } else { "binary big-endian PLY" };
        for vertex in ["char", "uchar", "short", "ushort", "int", "uint", "float", "double", "float32", "float64"] {
            assert_tetrahedron(&binary(vertex, "uchar", "int", little), dialect);
        }
        for kind in
            ["char", "uchar", "short", "ushort", "int", "uint", "int8", "uint8", "int16", "uint16", "int32", "uint32"]
        {
            assert_tetrahedron(&binary("float", kind, "int", little), dialect);
            assert_tetrahedron(&binary("float", "uchar", kind, little), dialect);
        }
    }
}

#[test]
fn extra_elements_and_properties_of_an_ascii_ply_are_passed_over() {
    let text = "ply\nformat ascii 1.0\ncomment x\nelement a 2\nproperty list uchar int b\nelement vertex 4\nproperty float nx\nproperty float z\nproperty float y\nproperty float x\nproperty list int int w\nelement face 4\nproperty list uchar int vertex_indices\nproperty uchar red\nelement c 0\nproperty int d\nend_header\n2 9 9\n0\n5 0 0 0 0\n5 0 0 1 1 7\n5 0 1 0 2 7 7\n5 1 0 0 0\n3 0 2 1 255\n3 0 1 3 255\n3 1 2 3 255\n3 2 0 3 255\n";
    assert_tetrahedron(text.as_bytes(), "ASCII PLY");
}

#[test]
fn the_elements_may_stand_in_any_order() {
    let text = "ply\nformat ascii 1.0\nelement face 2\nproperty list uchar int vertex_indices\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nend_header\n4 0 1 2 3\n3 0 1 2\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n";
    let mesh = read_all(text.as_bytes());
    assert_eq!(mesh.soup.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
}

#[test]
fn a_body_that_begins_with_a_byte_like_a_line_end_is_read_from_its_first_byte() {
    // The first coordinate's first byte is 0x0A.
    let first = f32::from_le_bytes([0x0A, 0, 0, 0x40]);
    let mut soup = tetrahedron();
    soup.positions[0].x = f64::from(first);
    let bytes = write(&soup, Format::Ply).unwrap();
    assert_eq!(read_all(&bytes).soup, soup);
    let end = bytes.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    assert_eq!(bytes[end], 0x0A);
    for line_end in ["\r\n", "\r"] {
        let header = String::from_utf8(bytes[..end].to_vec()).unwrap().replace('\n', line_end);
        let other = [header.as_bytes(), &bytes[end..]].concat();
        assert_eq!(read_all(&other).soup, soup, "{line_end:?}");
    }
}

#[test]
fn triangle_strips_alternate_orientation_and_restart_after_minus_one() {
    let text = "ply\nformat ascii 1.0\nelement vertex 6\nproperty float x\nproperty float y\nproperty float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n0 2 0\n1 2 0\n10 0 1 2 3 4 -1 2 3 4 5\n";
    let mesh = read_all(text.as_bytes());
    assert_eq!(mesh.soup.faces, [[0, 1, 2], [2, 1, 3], [2, 3, 4], [2, 3, 4], [4, 3, 5]]);
    let up = |face| {
        let [a, b, c] = mesh.soup.corners(face);
        (b - a).cross(c - a).z > 0.0
    };
    assert!((0..5).all(up));
}

#[test]
fn triangles_that_only_join_strips_are_left_out_with_a_warning() {
    let text = "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n0 0 0\n1 0 0\n0 1 0\n1 1 0\n6 0 1 2 2 1 3\n";
    let mesh = read_all(text.as_bytes());
    assert_eq!(mesh.soup.faces.len(), 2);
    assert_warned(&mesh, "degenerate triangles that join triangle strips were dropped: 2");
}

#[test]
fn lists_of_vertex_index_and_vertex_indices_are_the_same() {
    assert_tetrahedron(ascii().replace("vertex_indices", "vertex_index").as_bytes(), "ASCII PLY");
}

#[test]
fn a_face_that_names_a_vertex_that_is_not_there_is_refused_with_its_place() {
    for index in ["4", "-1"] {
        let text = format!("{HEADER}{VERTICES}{}", FACES.replace("1 2 3", &format!("1 {index} 3")));
        assert_refused(text.as_bytes(), ReadErrorKind::IndexOutOfRange, Some(FileLocation::Line(16)), "has 4 vertices");
    }
    let mut bytes = write(&tetrahedron(), Format::Ply).unwrap();
    let last = bytes.len() - 4;
    bytes[last] = 9;
    assert_refused(&bytes, ReadErrorKind::IndexOutOfRange, Some(FileLocation::Byte(last as u64)), "vertex 9");
}

#[test]
fn a_binary_ply_that_is_cut_off_anywhere_is_refused_with_a_place() {
    let bytes = write(&tetrahedron(), Format::Ply).unwrap();
    for end in 4..bytes.len() {
        let error = refused(&bytes[..end]);
        assert!(error.place.is_some(), "cut at {end}: {error}");
        assert!(matches!(error.kind, ReadErrorKind::Truncated | ReadErrorKind::Malformed), "cut at {end}: {error}");
    }
    assert_refused(
        &bytes[..bytes.len() - 1],
        ReadErrorKind::Truncated,
        Some(FileLocation::Byte(bytes.len() as u64 - 13)),
        "'face' 3 of 4",
    );
}

#[test]
fn an_ascii_ply_that_is_cut_off_is_refused_with_the_line_where_it_ends() {
    let text = ascii();
    assert_refused(
        &text.as_bytes()[..text.len() - 5],
        ReadErrorKind::Truncated,
        Some(FileLocation::Line(17)),
        "'face' 3 of 4",
    );
}

#[test]
fn counts_that_the_bytes_cannot_hold_are_refused_before_anything_is_allocated() {
    for (what, count) in [
        ("vertex 4", "vertex 4000000000"),
        ("face 4", "face 4000000000"),
        ("vertex 4", "vertex 99999999999999999999999"),
    ] {
        let text = ascii().replace(what, count);
        let length = text.len() as u64;
        assert_refused(text.as_bytes(), ReadErrorKind::Truncated, Some(FileLocation::Byte(length)), "can't hold");
    }
    let mut bytes = write(&tetrahedron(), Format::Ply).unwrap();
    let at = bytes.windows(9).position(|w| w == b"element f").unwrap();
    bytes.splice(at..at, *b"element many 18446744073709551615\nproperty double x\n");
    assert_eq!(refused(&bytes).kind, ReadErrorKind::Truncated);
}

#[test]
fn an_element_without_properties_takes_no_time_however_often_it_is_counted() {
    let text = ascii().replace("element face", "element nothing 9000000000000000000\nelement face");
    assert_tetrahedron(text.as_bytes(), "ASCII PLY");
}

#[test]
fn a_list_longer_than_the_file_is_refused() {
    let text = ascii().replace("3 1 2 3", "4000000000 1 2 3");
    assert_refused(text.as_bytes(), ReadErrorKind::Truncated, Some(FileLocation::Line(16)), "4000000000 vertices");
    let text = ascii().replace("3 1 2 3", "-3 1 2 3");
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(16)), "below zero");
}

#[test]
fn a_header_that_lacks_something_is_refused_with_its_line() {
    for (from, to, line, words) in [
        ("format ascii 1.0\n", "", 8, "no line such as `format"),
        ("ascii", "roman", 2, "'roman'"),
        ("property float y\n", "", 3, "no property 'y'"),
        ("float y", "complex y", 5, "'complex'"),
        ("vertex_indices", "corners", 7, "vertex_indices"),
        ("int vertex_indices", "float vertex_indices", 7, "vertex_indices"),
        ("uchar int", "float int", 8, "whole number"),
        ("element vertex 4\n", "", 3, "an 'element' line before this property"),
        ("vertex 4", "vertex four", 3, "'four'"),
        (
            "element face 4",
            "element vertex 4\nproperty int x\nproperty int y\nproperty int z\nelement face 4",
            7,
            "second element 'vertex'",
        ),
    ] {
        let text = ascii().replacen(from, to, 1);
        assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(line)), words);
    }
    let text = ascii().replace("end_header\n", "");
    assert_refused(text.as_bytes(), ReadErrorKind::Truncated, Some(FileLocation::Line(17)), "end_header");
}

#[test]
fn unknown_header_lines_give_one_warning() {
    let text = ascii().replace("element vertex", "Created by hand\nand foot\nelement vertex");
    let mesh = read_all(text.as_bytes());
    assert_eq!(mesh.soup, tetrahedron());
    assert_warned(&mesh, "'Created'");
}

#[test]
fn a_number_with_a_decimal_comma_is_refused_with_its_line() {
    let text = ascii().replacen("\n1 0 0\n", "\n1,5 0 0\n", 1);
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(11)), "decimal points");
}

#[test]
fn a_point_cloud_is_named() {
    let text = "ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n1 1 1\n";
    assert_refused(text.as_bytes(), ReadErrorKind::NoFaces, None, "2 vertices and no faces, so it is a point cloud");
    let text = format!("{}{VERTICES}", HEADER.replace("face 4", "face 0"));
    assert_refused(text.as_bytes(), ReadErrorKind::NoFaces, None, "point cloud");
    let text = format!("{}{VERTICES}2 0 1\n", HEADER.replace("face 4", "face 1"));
    assert_refused(text.as_bytes(), ReadErrorKind::NoFaces, None, "three or more corners");
    assert_refused(b"ply\nformat ascii 1.0\nend_header\n", ReadErrorKind::NoFaces, None, "no vertices and no faces");
}

#[test]
fn bytes_after_the_last_element_give_a_warning() {
    let mut bytes = write(&tetrahedron(), Format::Ply).unwrap();
    bytes.extend_from_slice(b"more");
    assert_warned(&read_all(&bytes), "4 bytes after the last element");
    assert_warned(&read_all((ascii() + "more").as_bytes()), "after the last element");
}

#[test]
fn coordinates_are_written_as_float_only_if_that_loses_nothing() {
    let exact = write(&tetrahedron(), Format::Ply).unwrap();
    assert!(exact.windows(16).any(|w| w == b"property float x"));
    let mut soup = tetrahedron();
    soup.positions[1] = DVec3::new(0.1, 1e300, -0.0);
    let bytes = write(&soup, Format::Ply).unwrap();
    assert!(bytes.windows(17).any(|w| w == b"property double x"));
    assert_eq!(read_all(&bytes).soup, soup);
}

#[test]
fn a_number_of_an_ascii_ply_is_as_wide_as_the_header_says() {
    let with = |kind: &str| {
        let header = format!(
            "ply\nformat ascii 1.0\nelement vertex 3\nproperty {kind} x\nproperty {kind} y\nproperty {kind} z\n"
        );
        let text = format!(
            "{header}element face 1\nproperty list uchar int vertex_indices\nend_header\n0.1 0 0\n1 0 0\n0 1 0\n3 0 1 2\n"
        );
        read_all(text.as_bytes()).soup.positions[0].x
    };
    assert_eq!(with("float"), f64::from(0.1f32));
    assert_eq!(with("double"), 0.1);
}
