//! Colours in PLY, read and written.

use glam::DVec3;
use meshmend::format::{Format, ReadOptions, ReadScene, read_scene, write, write_scene};
use meshmend::mesh::Soup;
use meshmend::scene::{Material, PAINTLESS, Paint, PaintedMesh, Palette, Scene};
use proptest::prelude::*;

use super::{read_all, tetrahedron};

type Corners = [[u8; 4]; 3];

fn scene_of(bytes: &[u8]) -> ReadScene {
    read_scene(bytes, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"))
}

fn colors(file: &ReadScene) -> Vec<Option<Corners>> {
    let color = |paint: &Paint| file.scene.palettes.get(paint.palette as usize)?.colors(paint.at);
    file.scene.objects[0].mesh().unwrap().paint.iter().map(color).collect()
}

/// A square and a triangle; `vertex` and `face` are extra properties, and their values in each row.
fn ascii(vertex: (&str, [&str; 4]), face: (&str, [&str; 2])) -> Vec<u8> {
    let properties = |kind_and_names: &str| -> String {
        kind_and_names.split(", ").filter(|name| !name.is_empty()).map(|name| format!("property {name}\n")).collect()
    };
    let positions = ["0 0 0", "1 0 0", "1 1 0", "0 1 0"];
    let vertices: String = positions.iter().zip(vertex.1).map(|(p, more)| format!("{p} {more}\n")).collect();
    let faces: String = ["4 0 1 2 3", "3 2 1 0"].iter().zip(face.1).map(|(f, more)| format!("{f} {more}\n")).collect();
    format!(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n{}element face 2\nproperty list uchar int vertex_indices\n{}end_header\n{vertices}{faces}",
        properties(vertex.0),
        properties(face.0)
    )
    .into_bytes()
}

const BYTES: &str = "uchar red, uchar green, uchar blue";

#[test]
fn colours_of_vertices_run_over_faces() {
    let bytes = ascii((BYTES, ["255 0 0", "0 255 0", "0 0 255", "9 8 7"]), ("", [""; 2]));
    let of = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [9, 8, 7, 255]];
    let file = scene_of(&bytes);
    let soup = &file.scene.objects[0].mesh().unwrap().soup;
    let expected: Vec<_> = soup.faces.iter().map(|face| Some(face.map(|v| of[v as usize]))).collect();
    assert_eq!((colors(&file), file.warnings.len()), (expected, 0));
    assert_eq!(*soup, read_all(&bytes).soup);
    assert_eq!(*soup, read_all(&ascii(("", [""; 4]), ("", [""; 2]))).soup, "as without colours");
}

#[test]
fn colours_are_of_any_type_and_may_have_an_opacity() {
    for (properties, row) in [
        ("uchar red, uchar green, uchar blue, uchar alpha", "255 128 0 51"),
        ("float blue, double alpha, float red, float green", "0 0.2 1 0.502"),
        ("ushort red, ushort green, ushort blue, ushort alpha", "65535 32896 0 13107"),
        ("int diffuse_red, int diffuse_green, int diffuse_blue, uchar alpha", "999 128 -5 51"),
    ] {
        let file = scene_of(&ascii((properties, [row; 4]), ("", [""; 2])));
        assert_eq!(colors(&file), [Some([[255, 128, 0, 51]; 3]); 3], "{properties}");
    }
    for (properties, row) in
        [("uchar red, uchar green", "1 2"), ("list uchar int red, uchar green, uchar blue", "1 7 2 3")]
    {
        let read = scene_of(&ascii((properties, [row; 4]), ("", [""; 2])));
        assert_eq!(read.scene.palettes, [], "{properties}");
    }
}

#[test]
fn colours_of_faces_are_those_of_their_triangles() {
    let file = scene_of(&ascii(("", [""; 4]), (BYTES, ["255 0 0", "0 0 9"])));
    let (red, blue) = (Some([[255, 0, 0, 255]; 3]), Some([[0, 0, 9, 255]; 3]));
    assert_eq!(colors(&file), [red, red, blue]);
    let both = ascii((BYTES, ["1 2 3"; 4]), (BYTES, ["255 0 0", "0 0 9"]));
    assert_eq!(colors(&scene_of(&both)), [Some([[1, 2, 3, 255]; 3]); 3], "vertices go before faces");
}

#[test]
fn a_colour_that_is_not_a_number_is_black() {
    let file = scene_of(&ascii((BYTES, ["x 0 0", "0 nan 0", "0 0 0", "0 0 0"]), ("", [""; 2])));
    assert_eq!(colors(&file), [Some([[0, 0, 0, 255]; 3]); 3]);
}

#[test]
fn a_ply_with_a_texture_gives_a_warning_that_it_is_ignored() {
    let list = ascii(("", [""; 4]), ("list uchar float texcoord", ["2 0 0", "2 0 0"]));
    let named = String::from_utf8(ascii(("", [""; 4]), ("", [""; 2]))).unwrap();
    let named = named.replace("1.0\n", "1.0\ncomment TextureFile a.png\n").into_bytes();
    for bytes in [list, named] {
        assert_eq!(read_all(&bytes).warnings, Vec::<String>::new());
        let file = scene_of(&bytes);
        assert!(
            file.warnings.len() == 1 && file.warnings[0].contains("texture coordinates of faces were dropped"),
            "{:?}",
            file.warnings
        );
    }
}

fn painted(paint: Vec<Paint>) -> Scene {
    let palettes = vec![
        Palette::Colors(vec![[255, 0, 0, 255], [0, 255, 0, 255], [1, 2, 3, 99]]),
        Palette::Materials(vec![Material { name: "a".to_owned(), color: [7, 7, 7, 255] }]),
        Palette::Textured { texture: 0, name: None, tint: [255; 4], places: vec![[0.0; 2]] },
    ];
    Scene { palettes, ..Scene::of_mesh(PaintedMesh { soup: tetrahedron(), paint }) }
}

fn colored(at: [u32; 3]) -> Paint {
    Paint { palette: 0, at }
}

#[test]
fn a_scene_without_colours_is_written_as_a_plain_mesh() {
    let picture = Paint { palette: 2, at: [0; 3] };
    for paint in [vec![], vec![picture, PAINTLESS, picture, Paint { palette: 9, at: [0; 3] }]] {
        assert_eq!(write_scene(&painted(paint), Format::Ply), write(&tetrahedron(), Format::Ply));
    }
}

#[test]
fn faces_of_one_colour_are_written_as_such() {
    let material = Paint { palette: 1, at: [0; 3] };
    let mut scene = painted(vec![colored([0; 3]), material, PAINTLESS, colored([1; 3])]);
    let bytes = write_scene(&scene, Format::Ply).unwrap();
    let header = String::from_utf8_lossy(&bytes[..300]).into_owned();
    assert!(
        header.contains("vertex_indices\nproperty uchar red\nproperty uchar green\nproperty uchar blue\nend_header")
    );
    let file = scene_of(&bytes);
    let flat = |color| Some([color; 3]);
    let expected = [[255, 0, 0, 255], [7, 7, 7, 255], [255; 4], [0, 255, 0, 255]].map(flat);
    assert_eq!(colors(&file), expected);
    if let meshmend::scene::Shape::Mesh(mesh) = &mut scene.objects[0].shape {
        mesh.paint[3] = colored([2; 3]);
    }
    let read = scene_of(&write_scene(&scene, Format::Ply).unwrap());
    assert_eq!(colors(&read)[3], flat([1, 2, 3, 99]));
}

#[test]
fn a_colour_whose_bytes_are_those_of_a_replaced_character_is_read() {
    let mut scene = painted(vec![colored([0; 3]); 4]);
    scene.palettes[0] = Palette::Colors(vec![[0xEF, 0xBF, 0xBD, 255]]);
    let file = scene_of(&write_scene(&scene, Format::Ply).unwrap());
    assert_eq!(colors(&file), [Some([[0xEF, 0xBF, 0xBD, 255]; 3]); 4]);
}

#[test]
fn a_vertex_has_the_colour_of_the_first_face_that_runs_over_it() {
    // Faces [0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3].
    let scene = painted(vec![colored([2; 3]), PAINTLESS, colored([0, 1, 0]), colored([1, 1, 1])]);
    let file = scene_of(&write_scene(&scene, Format::Ply).unwrap());
    let [red, green, blue] = [[255, 0, 0, 255], [0, 255, 0, 255], [1, 2, 3, 99]];
    let of = [blue, red, green, red];
    let expected: Vec<_> = tetrahedron().faces.iter().map(|face| Some(face.map(|v| of[v as usize]))).collect();
    assert_eq!(colors(&file), expected);
}

proptest! {
    #[test]
    fn colours_do_not_change_the_shape_and_are_written_the_same_again(
        rows in prop::collection::vec(([0..6_u32, 0..6, 0..6], 0..4_u32, [0..4_u32, 0..4, 0..4]), 1..12),
        far in any::<bool>(),
    ) {
        let positions = (0..6).map(|i| DVec3::new(f64::from(i), if far { 0.1 } else { 0.5 }, f64::from(i * i))).collect();
        let soup = Soup { positions, faces: rows.iter().map(|row| row.0).collect() };
        let mut scene = painted(rows.iter().map(|row| Paint { palette: row.1, at: row.2 }).collect());
        if let meshmend::scene::Shape::Mesh(mesh) = &mut scene.objects[0].shape {
            mesh.soup = soup.clone();
        }
        let bytes = write_scene(&scene, Format::Ply).unwrap();
        let file = scene_of(&bytes);
        prop_assert_eq!(&file.scene.objects[0].mesh().unwrap().soup, &soup);
        prop_assert_eq!(write_scene(&file.scene, Format::Ply).unwrap(), bytes);
    }
}
