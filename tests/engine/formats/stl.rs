//! STL, binary and ASCII: reading, writing and refused files.

use glam::DVec3;
use meshmend::format::{FileLocation, Format, ReadErrorKind, WriteError, write};

use super::{ascii_stl, assert_refused, assert_warned, corners, read_all, tetrahedron};

fn binary() -> Vec<u8> {
    write(&tetrahedron(), Format::Stl).unwrap()
}

fn with_count(count: u32) -> Vec<u8> {
    let mut bytes = binary();
    bytes[80..84].copy_from_slice(&count.to_le_bytes());
    bytes
}

fn plain() -> String {
    ascii_stl(&tetrahedron(), "tetrahedron")
}

#[track_caller]
fn assert_tetrahedron(bytes: &[u8], dialect: &str) {
    let mesh = read_all(bytes);
    assert_eq!(mesh.format, Format::Stl);
    assert_eq!(mesh.dialect, dialect);
    assert_eq!(mesh.warnings, Vec::<String>::new());
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
}

#[test]
fn a_reader_of_stl_joins_equal_positions_and_tells_how_many_the_file_has() {
    let mesh = read_all(&binary());
    assert_eq!((mesh.soup.positions.len(), mesh.stored_vertices), (4, Some(12)));
    assert_eq!(mesh.soup.faces[0], [0, 1, 2]);
    assert_tetrahedron(&binary(), "binary STL");
}

#[test]
fn a_binary_stl_that_begins_with_solid_is_read_as_binary() {
    let mut bytes = binary();
    bytes[..40].copy_from_slice(b"solid facet normal vertex outer loop    ");
    assert_tetrahedron(&bytes, "binary STL");
}

#[test]
fn a_binary_stl_that_begins_with_solid_and_counts_wrongly_is_read_as_binary() {
    let mut bytes = with_count(9);
    bytes[..16].copy_from_slice(b"solid facet of x");
    let mesh = read_all(&bytes);
    assert_eq!(mesh.dialect, "binary STL");
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
}

#[test]
fn a_binary_stl_may_have_any_bytes_in_its_header() {
    for header in [&b"PK\x03\x04"[..], b"ply\n", b"OFF 1 2 3", b"<html>", b"\xFF\xFE\x00\xEF\xBF\xBD", b"# v 1 2 3"] {
        let mut bytes = binary();
        bytes[..header.len()].copy_from_slice(header);
        assert_tetrahedron(&bytes, "binary STL");
    }
}

#[test]
fn attribute_bytes_are_ignored() {
    let mut bytes = binary();
    bytes[84 + 48] = 0xAB;
    bytes[84 + 49] = 0xCD;
    assert_tetrahedron(&bytes, "binary STL");
}

#[test]
fn with_too_large_a_count_existing_facets_are_read_and_both_numbers_reported() {
    for count in [5, 1000, u32::MAX] {
        let mesh = read_all(&with_count(count));
        assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
        assert_warned(&mesh, &format!("counts {count} facets, but the file has bytes for 4"));
    }
}

#[test]
fn a_cut_last_facet_is_left_out_with_a_warning() {
    let bytes = binary();
    let mesh = read_all(&bytes[..bytes.len() - 20]);
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron())[..3]);
    assert_warned(&mesh, "counts 4 facets, but the file has bytes for 3, and the last facet is cut off");
}

#[test]
fn a_file_cut_off_within_its_first_facet_is_refused() {
    let mut bytes = binary();
    bytes[..5].copy_from_slice(b"\0\0\0\0\0");
    let error = super::refused(&bytes[..100]);
    assert_eq!(error.kind, ReadErrorKind::UnknownFormat);
    assert!(error.detail.contains("if it was binary STL, it was cut off"), "{error}");
}

#[test]
fn with_too_small_a_count_that_many_facets_are_read_and_the_rest_reported() {
    let mesh = read_all(&with_count(3));
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron())[..3]);
    assert_warned(&mesh, "counts 3 facets, but bytes for 4 follow");
}

#[test]
fn bytes_after_the_last_facet_give_a_warning() {
    let mut bytes = binary();
    bytes.extend_from_slice(b"made by hand");
    let mesh = read_all(&bytes);
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
    assert_warned(&mesh, "12 bytes after the last facet");
}

#[test]
fn a_count_of_zero_with_facets_after_it_reads_them() {
    let mesh = read_all(&with_count(0));
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
    assert_warned(&mesh, "counts 0 facets, but bytes for 4 facets follow");
}

#[test]
fn a_binary_stl_without_facets_has_no_faces() {
    assert_refused(&[0; 84], ReadErrorKind::NoFaces, None, "0 facets");
}

#[test]
fn numbers_that_are_not_finite_are_passed_on() {
    let mut bytes = binary();
    bytes[84 + 12..84 + 16].copy_from_slice(&f32::NAN.to_le_bytes());
    bytes[84 + 16..84 + 20].copy_from_slice(&f32::INFINITY.to_le_bytes());
    let mesh = read_all(&bytes);
    assert!(mesh.soup.positions[0].x.is_nan());
    assert_eq!(mesh.soup.positions[0].y, f64::INFINITY);
}

#[test]
fn ascii_stl_is_read() {
    assert_tetrahedron(plain().as_bytes(), "ASCII STL");
}

#[test]
fn ascii_stl_may_have_any_line_ends() {
    assert_tetrahedron(plain().replace('\n', "\r\n").as_bytes(), "ASCII STL");
    assert_tetrahedron(plain().replace('\n', "\r").as_bytes(), "ASCII STL");
    assert_tetrahedron(plain().replace('\n', "\n\n \t\n").as_bytes(), "ASCII STL");
}

#[test]
fn ascii_stl_may_be_in_uppercase() {
    assert_tetrahedron(plain().to_uppercase().as_bytes(), "ASCII STL");
}

#[test]
fn ascii_stl_may_begin_with_a_byte_order_mark_or_white_space() {
    assert_tetrahedron(format!("\u{FEFF}{}", plain()).as_bytes(), "ASCII STL");
    assert_tetrahedron(format!("\n\n   {}", plain()).as_bytes(), "ASCII STL");
}

#[test]
fn ascii_stl_may_stand_on_one_line() {
    assert_tetrahedron(plain().replace('\n', " ").as_bytes(), "ASCII STL");
}

#[test]
fn a_name_may_be_any_bytes() {
    let text = ascii_stl(&tetrahedron(), "facet vertex \u{1}NAME endfacet");
    let mut bytes = text.into_bytes();
    let at = bytes.windows(4).position(|w| w == b"NAME").unwrap();
    bytes[at..at + 4].copy_from_slice(b"\xFF\xC3\x28\x80");
    assert_tetrahedron(&bytes, "ASCII STL");
    let long = "name ".repeat(3000);
    assert_tetrahedron(ascii_stl(&tetrahedron(), &long).as_bytes(), "ASCII STL");
    assert_tetrahedron(ascii_stl(&tetrahedron(), "").as_bytes(), "ASCII STL");
}

#[test]
fn normals_may_be_missing_or_no_numbers() {
    for normal in ["", "normal", "normal 0 0", "normal nan nan nan", "normal 1,0 0,0 x", "normal -1.#IND 0 0"] {
        let text = plain().replace("normal 0 0 0", normal);
        assert_tetrahedron(text.as_bytes(), "ASCII STL");
    }
}

#[test]
fn several_solids_are_all_kept() {
    let text = plain() + &plain() + &plain();
    let mesh = read_all(text.as_bytes());
    assert_eq!(mesh.soup.faces.len(), 12);
    assert_warned(&mesh, "3 solids");
}

#[test]
fn a_missing_endsolid_gives_a_warning() {
    let text = plain().replace("endsolid tetrahedron\n", "");
    let mesh = read_all(text.as_bytes());
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
    assert_warned(&mesh, "without 'endsolid'");
}

#[test]
fn an_ascii_stl_that_is_cut_off_gives_its_whole_facets_wherever_the_cut_is() {
    let text = plain();
    let all = corners(&tetrahedron());
    let first_end = text.find("endfacet").unwrap() + 8;
    for end in first_end..text.find("endsolid").unwrap() {
        let mesh = read_all(&text.as_bytes()[..end]);
        let whole = mesh.soup.faces.len();
        assert_eq!(corners(&mesh.soup), all[..whole], "cut at {end}");
        let ended = text[..end].matches("endfacet").count();
        let closed = text[..end].matches("endloop").count();
        assert!((ended..=closed).contains(&whole), "cut at {end}: {whole}");
        assert!(!mesh.warnings.is_empty(), "cut at {end}");
    }
}

#[test]
fn an_ascii_stl_cut_off_in_its_first_facet_is_truncated() {
    let text = plain();
    let end = text.find("endloop").unwrap() - 8;
    assert_refused(&text.as_bytes()[..end], ReadErrorKind::Truncated, Some(FileLocation::Line(6)), "cut off");
}

#[test]
fn a_facet_without_three_vertices_is_refused_with_its_line() {
    let two = plain().replacen("      vertex 0 1 0\n", "", 1);
    assert_refused(two.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(2)), "2 vertices");
    let four = plain().replacen("    endloop", "      vertex 9 9 9\n    endloop", 1);
    assert_refused(four.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(9)), "4 vertices");
}

#[test]
fn a_decimal_comma_is_named_with_its_line() {
    let text = plain().replacen("vertex 0 1 0", "vertex 0,5 1,0 0,0", 1);
    assert_refused(
        text.as_bytes(),
        ReadErrorKind::Malformed,
        Some(FileLocation::Line(5)),
        "export with decimal points",
    );
}

#[test]
fn a_coordinate_that_is_no_number_is_named_with_its_line() {
    let text = plain().replacen("vertex 0 1 0", "vertex 0 1 hello", 1).replace('\n', "\r\n");
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(5)), "'hello'");
}

#[test]
fn words_for_numbers_that_are_not_finite_are_passed_on() {
    let text = plain().replacen("vertex 0 1 0", "vertex nan -inf 1.#QNAN", 1);
    let mesh = read_all(text.as_bytes());
    let p = mesh.soup.positions[1];
    assert!(p.x.is_nan() && p.z.is_nan());
    assert_eq!(p.y, f64::NEG_INFINITY);
}

#[test]
fn ascii_coordinates_are_rounded_to_f32_as_binary_ones_are() {
    let text = plain().replacen("vertex 0 1 0", "vertex 0.1 1 0", 1);
    assert_eq!(read_all(text.as_bytes()).soup.positions[1].x, f64::from(0.1_f32));
}

#[test]
fn unknown_words_between_facets_give_one_warning() {
    let text = plain().replace("endfacet", "endfacet blah").replace("endloop", "endloop foo");
    let mesh = read_all(text.as_bytes());
    assert_eq!(corners(&mesh.soup), corners(&tetrahedron()));
    assert_warned(&mesh, "were ignored: 8, the first 'foo'");
}

#[test]
fn an_ascii_stl_without_facets_has_no_faces() {
    assert_refused(b"solid empty\nendsolid empty\n", ReadErrorKind::NoFaces, None, "no facet");
    assert_refused(b"solid", ReadErrorKind::NoFaces, None, "no facet");
}

#[test]
fn a_written_stl_has_a_fixed_header_and_unit_normals() {
    let bytes = binary();
    assert_eq!(bytes.len(), 84 + 4 * 50);
    assert_eq!(&bytes[..8], b"meshmend");
    assert!(bytes[8..80].iter().all(|&b| b == 0));
    let number = |at: usize| f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
    assert_eq!([number(84), number(88), number(92)], [0.0, 0.0, -1.0]);
    let third = [number(184), number(188), number(192)];
    assert!(third.iter().all(|n| (n - 1.0 / 3.0_f32.sqrt()).abs() < 1e-6), "{third:?}");
}

#[test]
fn a_degenerate_face_is_written_with_a_normal_of_zero() {
    let mut soup = tetrahedron();
    soup.faces = vec![[0, 1, 1]];
    let bytes = write(&soup, Format::Stl).unwrap();
    assert!(bytes[84..96].iter().all(|&b| b == 0));
}

#[test]
fn normals_of_very_small_and_very_large_faces_are_unit_vectors() {
    for scale in [1e-38, 1e37] {
        let mut soup = tetrahedron();
        soup.positions.iter_mut().for_each(|p| *p *= scale);
        let bytes = write(&soup, Format::Stl).unwrap();
        assert_eq!(f32::from_le_bytes(bytes[92..96].try_into().unwrap()), -1.0);
    }
}

#[test]
fn a_coordinate_beyond_f32_is_not_written_as_stl() {
    for value in [1e39, f64::NAN, f64::NEG_INFINITY] {
        let mut soup = tetrahedron();
        soup.positions[2] = DVec3::new(0.0, value, 0.0);
        match write(&soup, Format::Stl) {
            Err(WriteError::OutOfRange { vertex: 2, value: found }) => assert_eq!(found.to_bits(), value.to_bits()),
            other => panic!("{other:?}"),
        }
    }
}
