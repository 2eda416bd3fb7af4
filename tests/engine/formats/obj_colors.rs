//! Colours in OBJ: vertex colours after positions, and how they combine with materials.

use meshmend::format::{Format, ReadOptions, ReadScene, read_scene, write_scene};
use meshmend::scene::{PAINTLESS, PaintedMesh, Palette};

use super::read_all;
use crate::support::archives::package;

type Corners = [[u8; 4]; 3];

#[track_caller]
fn scene_of(bytes: &[u8]) -> ReadScene {
    let file = read_scene(bytes, &ReadOptions::default()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(file.warnings, Vec::<String>::new());
    file
}

fn mesh(file: &ReadScene) -> &PaintedMesh {
    file.scene.objects[0].mesh().unwrap()
}

fn colors(file: &ReadScene) -> Vec<Option<Corners>> {
    let color = |paint: &meshmend::scene::Paint| file.scene.palettes.get(paint.palette as usize)?.colors(paint.at);
    mesh(file).paint.iter().map(color).collect()
}

const RUN: Corners = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]];

#[test]
fn colours_after_positions_run_over_faces() {
    for text in [
        "v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nf 1 2 3\n",
        "v 0 0 0 255 0 0\nv 1 0 0 0 255 0\nv 0 1 0 0 0 255\nf 1 2 3\n",
        "f 1 2 3\nv 0 0 0 1.0 0 0 1\nv 1 0 0 0 1 0 0.5\nv 0 1 0 0 0 1 # blue\n",
    ] {
        let file = scene_of(text.as_bytes());
        assert_eq!((file.format, colors(&file)), (Format::Obj, vec![Some(RUN)]), "{text}");
        assert_eq!(mesh(&file).soup, read_all(text.as_bytes()).soup);
    }
}

#[test]
fn faces_with_a_vertex_without_a_colour_are_not_painted() {
    let file = scene_of(
        b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nv 1 1 0 1\nv 2 2 2 nan 0 0\nf 1 2 3\nf 2 3 4\nf 1 2 5\n",
    );
    assert_eq!(colors(&file), [Some(RUN), None, None]);
    assert_eq!(mesh(&file).paint[1..], [PAINTLESS; 2]);
}

#[test]
fn weights_and_plain_positions_are_no_colours() {
    for text in ["v 0 0 0 1\nv 1 0 0 1\nv 0 1 0 1\nf 1 2 3\n", "v 0 0 0 1 1\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"] {
        let file = scene_of(text.as_bytes());
        assert_eq!((mesh(&file).paint.len(), file.scene.palettes.len()), (0, 0));
    }
}

#[test]
fn colours_go_before_grey_materials_and_others_before_colours() {
    let obj = "mtllib c.mtl\nv 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nusemtl grey\nf 1 2 3\nusemtl red\nf 1 2 3\nusemtl glass\nf 1 2 3\n\
               usemtl (null)\nf 1 2 3\nusemtl color_808080\nf 1 2 3\n";
    let mtl = "newmtl grey\nKd 0.8 0.8 0.8\nnewmtl red\nKd 1 0 0\nnewmtl glass\nd 0.2\nnewmtl color_808080\nKd 0.502 0.502 0.502\n";
    let file = scene_of(&package(&[("m.obj", obj.as_bytes()), ("c.mtl", mtl.as_bytes())]));
    let glass = RUN.map(|[r, g, b, _]| [r, g, b, 51]);
    let flat = |color| Some([color; 3]);
    assert_eq!(colors(&file), [Some(RUN), flat([255, 0, 0, 255]), Some(glass), None, flat([128, 128, 128, 255])]);
    // A material whose name is a colour code is read as a colour.
    let Palette::Colors(listed) = &file.scene.palettes[mesh(&file).paint[4].palette as usize] else {
        panic!("no colours")
    };
    assert!(listed.contains(&[128, 128, 128, 255]));
}

#[test]
fn colours_of_vertices_are_written_where_they_run() {
    let text = b"v 0 0 0 1 0 0\nv 1 0 0 0 1 0\nv 0 1 0 0 0 1\nv 0 0 1 0.2 0.4 0.6\nf 1 2 3\nf 2 3 4\nf 1 1 1\n";
    let first = scene_of(text);
    let bytes = write_scene(&first.scene, Format::Zip).unwrap();
    let again = scene_of(&bytes);
    assert_eq!((again.format, colors(&again)), (Format::Zip, colors(&first)));
    assert_eq!(mesh(&again).soup, mesh(&first).soup);
    assert_eq!(write_scene(&again.scene, Format::Zip).unwrap(), bytes);
}
