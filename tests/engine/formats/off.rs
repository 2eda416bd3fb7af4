//! OFF: reading and refused files.

use meshmend::format::{FileLocation, Format, ReadErrorKind};

use super::{assert_refused, assert_warned, read_all, tetrahedron};

const VERTICES: &str = "0 0 0\n1 0 0\n0 1 0\n0 0 1\n";
const FACES: &str = "3 0 2 1\n3 0 1 3\n3 1 2 3\n3 2 0 3\n";

#[track_caller]
fn assert_tetrahedron(text: &str, dialect: &str) {
    let mesh = read_all(text.as_bytes());
    assert_eq!((mesh.format, mesh.dialect.as_str()), (Format::Off, dialect));
    assert_eq!(mesh.warnings, Vec::<String>::new());
    assert_eq!(mesh.soup, tetrahedron());
}

#[test]
fn the_counts_may_stand_on_the_next_line_or_on_the_same() {
    assert_tetrahedron(&format!("OFF\n4 4 6\n{VERTICES}{FACES}"), "OFF");
    assert_tetrahedron(&format!("OFF 4 4 6\n{VERTICES}{FACES}"), "OFF");
    assert_tetrahedron(&format!("off\n4 4 6\n{VERTICES}{FACES}"), "OFF");
}

#[test]
fn the_count_of_edges_may_be_missing() {
    assert_tetrahedron(&format!("OFF\n4 4\n{VERTICES}{FACES}"), "OFF");
}

#[test]
fn an_off_file_may_have_any_line_ends_and_none_at_the_end() {
    let text = format!("OFF\n4 4 6\n{VERTICES}{FACES}");
    assert_tetrahedron(&text.replace('\n', "\r\n"), "OFF");
    assert_tetrahedron(&text.replace('\n', "\r"), "OFF");
    assert_tetrahedron(text.trim_end(), "OFF");
    assert_tetrahedron(&format!("\u{FEFF}{text}"), "OFF");
}

#[test]
fn comments_and_blank_lines_may_stand_anywhere() {
    let text = format!("# first\n\nOFF # here\n# there\n\n4 4 6 # counts\n\n{VERTICES}\n# faces\n{FACES}\n#end\n");
    assert_tetrahedron(&text.replace("0 1 0\n", "0 1 0 # the third\n"), "OFF");
}

#[test]
fn colours_of_vertices_and_faces_are_passed_over() {
    let coloured = VERTICES.replace('\n', " 255 0 0 255\n");
    assert_tetrahedron(&format!("COFF\n4 4 6\n{coloured}{FACES}"), "COFF");
    let coloured = FACES.replace('\n', " 0.5 0.5 0.5\n");
    assert_tetrahedron(&format!("OFF\n4 4 6\n{VERTICES}{coloured}"), "OFF");
}

#[test]
fn normals_and_texture_coordinates_are_passed_over() {
    for (keyword, more) in
        [("NOFF", " 0 0 1"), ("CNOFF", " 0 0 1 1 1 1 1"), ("STOFF", " 0.5 0.5"), ("STCNOFF", " 1 2 3 4")]
    {
        let longer = VERTICES.replace('\n', &format!("{more}\n"));
        assert_tetrahedron(&format!("{keyword}\n4 4 6\n{longer}{FACES}"), keyword);
    }
}

#[test]
fn a_missing_keyword_is_told() {
    let mesh = read_all(format!("4 4 6\n{VERTICES}{FACES}").as_bytes());
    assert_eq!((mesh.format, &mesh.soup), (Format::Off, &tetrahedron()));
    assert_warned(&mesh, "does not start with the keyword OFF");
}

#[test]
fn vertices_of_other_than_three_coordinates_are_refused() {
    for keyword in ["4OFF", "C4OFF", "nOFF", "4nOFF"] {
        let text = format!("{keyword}\n4 4 6\n{VERTICES}{FACES}");
        assert_refused(text.as_bytes(), ReadErrorKind::UnsupportedFormat, Some(FileLocation::Line(1)), keyword);
    }
}

#[test]
fn binary_off_is_refused_by_name() {
    assert_refused(
        b"OFF BINARY\n\0\0\0\x04",
        ReadErrorKind::UnsupportedFormat,
        Some(FileLocation::Line(1)),
        "binary OFF",
    );
}

#[test]
fn polygons_are_cut_and_short_faces_left_out() {
    let mesh = read_all(b"OFF\n4 3 0\n0 0 0\n1 0 0\n1 1 0\n0 1 0\n4 0 1 2 3\n2 0 1\n1 0\n");
    assert_eq!(mesh.soup.faces, [[0, 1, 2], [0, 2, 3]]);
    assert_warned(&mesh, "fewer than three corners were dropped: 2");
}

#[test]
fn a_face_that_names_a_vertex_that_is_not_there_is_refused_with_its_line() {
    for index in ["4", "-1", "99999999999999999999"] {
        let text = format!("OFF\n4 4 6\n{VERTICES}{}", FACES.replace("1 2 3", &format!("1 {index} 3")));
        assert_refused(text.as_bytes(), ReadErrorKind::IndexOutOfRange, Some(FileLocation::Line(9)), index);
    }
}

#[test]
fn a_word_that_is_no_number_is_refused_with_its_line() {
    let text = format!("OFF\n4 4 6\n{}{FACES}", VERTICES.replace("0 1 0", "0 one 0"));
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(5)), "'one'");
    let text = format!("OFF\n4 4 6\n{}{FACES}", VERTICES.replace("0 1 0", "0 1,5 0"));
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(5)), "decimal points");
    assert_refused(b"OFF\nfour 4 6\n0 0 0\n", ReadErrorKind::Malformed, Some(FileLocation::Line(2)), "'four'");
    assert_refused(b"OFF\n-4 4 6\n0 0 0\n", ReadErrorKind::Malformed, Some(FileLocation::Line(2)), "below zero");
}

#[test]
fn a_file_that_is_cut_off_is_refused_with_the_line_where_it_ends() {
    let text = format!("OFF\n4 4 6\n{VERTICES}{FACES}");
    let end = text.len() - 4;
    assert_refused(&text.as_bytes()[..end], ReadErrorKind::Truncated, Some(FileLocation::Line(10)), "face 3 of 4");
}

#[test]
fn counts_that_the_bytes_cannot_hold_are_refused_before_anything_is_allocated() {
    for counts in ["2000000000 4 0", "4 2000000000 0", "18446744073709551615 18446744073709551615 0"] {
        let text = format!("OFF\n{counts}\n{VERTICES}{FACES}");
        assert_refused(text.as_bytes(), ReadErrorKind::Truncated, Some(FileLocation::Line(2)), "can't hold");
    }
}

#[test]
fn a_face_of_billions_of_corners_is_refused() {
    let text = format!("OFF\n4 4 6\n{VERTICES}{}", FACES.replace("3 1 2 3", "4000000000 1 2 3"));
    // The reader takes the counts of the following lines for corners.
    assert_refused(text.as_bytes(), ReadErrorKind::Truncated, Some(FileLocation::Line(11)), "a corner of face 2");
}

#[test]
fn a_point_cloud_is_named() {
    assert_refused(format!("OFF\n4 0 0\n{VERTICES}").as_bytes(), ReadErrorKind::NoFaces, None, "point cloud");
    assert_refused(b"OFF\n0 0 0\n", ReadErrorKind::NoFaces, None, "no vertices and no faces");
    assert_refused(
        format!("OFF\n4 1 0\n{VERTICES}2 0 1\n").as_bytes(),
        ReadErrorKind::NoFaces,
        None,
        "three or more corners",
    );
}

#[test]
fn text_after_the_last_face_gives_a_warning() {
    let mesh = read_all(format!("OFF\n4 4 6\n{VERTICES}{FACES}more\n").as_bytes());
    assert_eq!(mesh.soup, tetrahedron());
    assert_warned(&mesh, "after the last face");
}
