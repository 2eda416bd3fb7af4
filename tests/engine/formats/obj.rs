//! OBJ: reading and refused files.

use glam::DVec3;
use meshmend::format::{FileLocation, Format, ReadErrorKind};

use super::{assert_refused, assert_warned, read_all, tetrahedron};

const VERTICES: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n";
const FACES: &str = "f 1 3 2\nf 1 2 4\nf 2 3 4\nf 3 1 4\n";

#[track_caller]
fn assert_tetrahedron(text: &str) {
    let mesh = read_all(text.as_bytes());
    assert_eq!((mesh.format, mesh.dialect.as_str()), (Format::Obj, "OBJ"));
    assert_eq!(mesh.warnings, Vec::<String>::new());
    assert_eq!(mesh.soup, tetrahedron());
}

#[test]
fn vertices_and_faces_are_read() {
    assert_tetrahedron(&format!("{VERTICES}{FACES}"));
}

#[test]
fn an_obj_file_may_have_any_line_ends_and_none_at_the_end() {
    let text = format!("{VERTICES}{FACES}");
    assert_tetrahedron(&text.replace('\n', "\r\n"));
    assert_tetrahedron(&text.replace('\n', "\r"));
    assert_tetrahedron(text.trim_end());
    assert_tetrahedron(&format!("\u{FEFF}{}", text.replace(' ', " \t ")));
}

#[test]
fn texture_and_normal_indices_are_passed_over() {
    let attributes = "vt 0 0\nvn 0 0 1\n";
    for form in ["1/1 3/1 2/1", "1//1 3//1 2//1", "1/1/1 3/1/1 2/1/1", "1/ 3// 2"] {
        assert_tetrahedron(&format!("{VERTICES}{attributes}{}", FACES.replace("1 3 2", form)));
    }
}

#[test]
fn a_fourth_coordinate_and_colours_are_passed_over() {
    assert_tetrahedron(&format!("{}{FACES}", VERTICES.replace("1 0 0", "1 0 0 1.0").replace("0 1 0", "0 1 0 1 0.5 0")));
}

#[test]
fn negative_indices_count_back_from_the_last_vertex() {
    assert_tetrahedron(&format!("{VERTICES}f -4 -2 -3\nf -4 -3 -1\nf -3 -2 -1\nf -2 -4 -1\n"));
    let text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -1 -2\nv 0 0 1\nf 1 2 -1\nf 2 3 -1\nf 3 1 -1\n";
    assert_tetrahedron(text);
}

#[test]
fn a_backslash_continues_a_line() {
    assert_tetrahedron(&format!("v 0 \\\n 0 0\n{}{}", &VERTICES[8..], FACES.replace("1 3 2", "1 \\\r\n3\\\n2")));
}

#[test]
fn a_backslash_that_ends_a_name_or_a_comment_continues_nothing() {
    let names = "# C:\\models\\\nmtllib C:\\materials\\\no part\\\ng group\\\nusemtl wood\\\n";
    assert_tetrahedron(&format!("{names}{VERTICES}# faces \\\n{FACES}"));
}

#[test]
fn comments_may_stand_anywhere() {
    assert_tetrahedron(&format!("#\n# v 9 9 9\n{VERTICES}{}", FACES.replace("1 3 2", "1 3 2 # first")));
}

#[test]
fn all_groups_and_objects_are_kept() {
    let text =
        format!("{VERTICES}{}", FACES.replace("f 2", "g side\ns off\nusemtl red\nf 2").replace("f 3", "o other\nf 3"));
    assert_tetrahedron(&text);
}

#[test]
fn faces_may_come_before_their_vertices() {
    assert_tetrahedron(&format!("{FACES}{VERTICES}"));
    let mesh = read_all(b"f 1 2 3 4\nf 1 2 3\nv 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\n");
    assert_eq!(mesh.soup.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]]);
}

#[test]
fn polygons_are_cut_without_folds() {
    // An arrowhead, whose reflex corner is the third.
    let mesh = read_all(b"v 0 0 0\nv 4 2 0\nv 1 2 0\nv 0 4 0\nf 1 2 3 4\n");
    assert_eq!(mesh.soup.faces.len(), 2);
    for face in 0..2 {
        let [a, b, c] = mesh.soup.corners(face);
        assert!((b - a).cross(c - a).z > 0.0);
    }
}

#[test]
fn lines_and_points_are_left_out_with_one_warning() {
    let mesh = read_all(format!("{VERTICES}l 1 2 3\nl 1 2\np 1\n{FACES}").as_bytes());
    assert_eq!(mesh.soup, tetrahedron());
    assert_warned(&mesh, "lines and points, which form no surface, were dropped: 3");
}

#[test]
fn unknown_statements_are_passed_over_with_one_warning() {
    let mesh = read_all(format!("{VERTICES}foo 1\nbar\n{FACES}foo\n").as_bytes());
    assert_eq!(mesh.soup, tetrahedron());
    assert_warned(&mesh, "were ignored: 3, the first begins with 'foo'");
}

#[test]
fn faces_with_fewer_than_three_corners_are_left_out_with_one_warning() {
    let mesh = read_all(format!("{VERTICES}f 1 2\nf 1\nf\n{FACES}").as_bytes());
    assert_eq!(mesh.soup, tetrahedron());
    assert_warned(&mesh, "fewer than three corners were dropped: 3");
}

#[test]
fn a_face_that_names_vertex_zero_is_refused_with_its_line() {
    let text = format!("{VERTICES}{}", FACES.replace("2 3 4", "0 1 2"));
    assert_refused(
        text.as_bytes(),
        ReadErrorKind::IndexOutOfRange,
        Some(FileLocation::Line(7)),
        "counts vertices from 1",
    );
}

#[test]
fn a_face_that_names_a_vertex_that_is_not_there_is_refused_with_its_line() {
    for (index, words) in
        [("9", "vertex 9, but the file has 4"), ("99999999999999999999", "the file has 4"), ("-5", "vertex -5")]
    {
        let text = format!("{VERTICES}{}", FACES.replace("2 3 4", &format!("2 {index} 4")));
        assert_refused(text.as_bytes(), ReadErrorKind::IndexOutOfRange, Some(FileLocation::Line(7)), words);
    }
}

#[test]
fn a_vertex_without_three_numbers_is_refused_with_its_line() {
    let text = format!("{}{FACES}", VERTICES.replace("v 0 1 0", "v 0 1"));
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(3)), "2 coordinates");
    let text = format!("{}{FACES}", VERTICES.replace("v 0 1 0", "v 0 x 0"));
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(3)), "'x'");
    let text = format!("{}{FACES}", VERTICES.replace("v 0 1 0", "v 0,0 1,5 0,0"));
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(3)), "decimal points");
}

#[test]
fn a_face_of_words_is_refused_with_its_line() {
    let text = format!("{VERTICES}f a b c\n");
    assert_refused(text.as_bytes(), ReadErrorKind::Malformed, Some(FileLocation::Line(5)), "'a'");
}

#[test]
fn coordinates_are_read_as_f64_and_need_not_be_finite() {
    let mesh = read_all(b"v 0.1 .5 -5.e-1\nv nan inf 1e400\nv 0 1 0\nf 1 2 3\n");
    assert_eq!(mesh.soup.positions[0], DVec3::new(0.1, 0.5, -0.5));
    assert!(mesh.soup.positions[1].x.is_nan());
    assert_eq!(mesh.soup.positions[1].z, f64::INFINITY);
}

#[test]
fn free_form_surfaces_without_faces_are_named() {
    let text = format!("{VERTICES}cstype bezier\ndeg 1 1\nsurf 0 1 0 1 1 2 \\\n 3 4\nend\n");
    assert_refused(text.as_bytes(), ReadErrorKind::NoFaces, None, "free-form");
}

#[test]
fn a_point_cloud_and_a_file_of_lines_are_named() {
    assert_refused(VERTICES.as_bytes(), ReadErrorKind::NoFaces, None, "point cloud");
    assert_refused(format!("{VERTICES}l 1 2\n").as_bytes(), ReadErrorKind::NoFaces, None, "lines or points");
    assert_refused(b"# nothing\n", ReadErrorKind::NoFaces, None, "no vertices and no faces");
    assert_refused(format!("{VERTICES}f 1 2\n").as_bytes(), ReadErrorKind::NoFaces, None, "three or more corners");
}
