use glam::DVec3;
use serde_json::json;

use super::super::super::{Limits, ReadErrorKind};
use super::{F32, Model, U8, U16, U32, floats, read_within, shorts};
use crate::mesh::Soup;

/// The only mesh of a model.
fn soup(model: &Model) -> Soup {
    model.read().scene.objects[0].mesh().expect("a mesh").soup.clone()
}

fn of_indices(bytes: &[u8], component: u32, count: usize, mode: u32) -> Model {
    let mut model = Model::tetrahedron();
    let indices = model.accessor(bytes, component, "SCALAR", count);
    model.json["meshes"][0]["primitives"][0]["indices"] = indices.into();
    model.with("/meshes/0/primitives/0/mode", json!(mode))
}

#[test]
fn indices_of_every_width_are_read_and_none_are_as_vertices_follow() {
    let wide: Vec<u8> = [3_u32, 2, 1].iter().flat_map(|v| v.to_le_bytes()).collect();
    for model in
        [of_indices(&[3, 2, 1], U8, 3, 4), of_indices(&shorts(&[3, 2, 1]), U16, 3, 4), of_indices(&wide, U32, 3, 4)]
    {
        let soup = soup(&model);
        assert_eq!(soup.corners(0), [DVec3::Z, DVec3::Y, DVec3::X]);
    }
    let mut model = Model::tetrahedron();
    model.json["meshes"][0]["primitives"][0] = json!({ "attributes": { "POSITION": 0 } });
    assert_eq!(soup(&model).faces, [[0, 1, 2]], "the fourth vertex makes no face");
}

#[test]
fn strips_and_fans_become_triangles_that_are_turned_alike() {
    assert_eq!(soup(&of_indices(&[0, 1, 2, 3, 0], U8, 5, 5)).faces, [[0, 1, 2], [1, 3, 2], [2, 3, 0]]);
    assert_eq!(soup(&of_indices(&[0, 1, 2, 3, 1], U8, 5, 6)).faces, [[1, 2, 0], [2, 3, 0], [3, 1, 0]]);
    assert_eq!(soup(&of_indices(&[0, 1, 2, 2, 3, 3, 0, 1], U8, 8, 5)).faces, [[0, 1, 2], [3, 1, 0]], "joined strips");
}

#[test]
fn points_lines_and_what_has_no_positions_are_left_out_with_a_warning() {
    let mut model = Model::tetrahedron();
    let primitives = model.json["meshes"][0]["primitives"].as_array_mut().expect("a list");
    primitives.push(json!({ "attributes": { "POSITION": 0 }, "mode": 1 }));
    primitives.push(json!({ "attributes": {}, "indices": 1 }));
    let read = model.read();
    assert_eq!(read.scene.placed_faces(), 4);
    assert!(read.warnings[0].ends_with("left out: 2"), "{:?}", read.warnings);
}

#[test]
fn primitives_with_the_same_vertices_share_them() {
    let mut model = Model::tetrahedron();
    let more = model.accessor(&[3, 1, 0], U8, "SCALAR", 3);
    push_primitive(&mut model, json!({ "attributes": { "POSITION": 0 }, "indices": more }));
    let soup = soup(&model);
    assert_eq!((soup.positions.len(), soup.faces[4]), (4, [3, 1, 0]));
}

#[test]
fn vertices_that_are_not_used_are_left_out_where_they_are_many() {
    let many: Vec<f32> = (0..3000).map(|k| k as f32).collect();
    let mut model = Model::tetrahedron();
    let positions = model.accessor(&floats(&many), F32, "VEC3", 1000);
    let indices = model.accessor(&shorts(&[999, 7, 8]), U16, "SCALAR", 3);
    push_primitive(&mut model, json!({ "attributes": { "POSITION": positions }, "indices": indices }));
    let soup = soup(&model);
    assert_eq!((soup.positions.len(), soup.faces[4]), (7, [6, 4, 5]));
    assert_eq!(soup.positions[6], DVec3::new(2997.0, 2998.0, 2999.0));
}

fn push_primitive(model: &mut Model, primitive: serde_json::Value) {
    super::push(&mut model.json["meshes"][0]["primitives"], primitive);
}

#[test]
fn elements_may_be_apart_and_some_may_stand_elsewhere() {
    // Positions of 12 bytes every 16.
    let mut model = Model::tetrahedron();
    let apart: Vec<f32> =
        super::CORNERS.chunks(3).flat_map(|p| [p[0] * 2.0, p[1] * 2.0, p[2] * 2.0, f32::NAN]).collect();
    let positions = model.accessor(&floats(&apart), F32, "VEC3", 4);
    let view = model.json["accessors"][positions]["bufferView"].as_u64().expect("a view") as usize;
    model.json["bufferViews"][view]["byteStride"] = json!(16);
    model.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = positions.into();
    assert_eq!(soup(&model).positions, [DVec3::ZERO, DVec3::X * 2.0, DVec3::Y * 2.0, DVec3::Z * 2.0]);

    let (numbers, values) = (model.view(&[1, 3]), model.view(&floats(&[7.0, 8.0, 9.0, 4.0, 5.0, 6.0])));
    model.json["accessors"][positions]["sparse"] = json!({
        "count": 2, "indices": { "bufferView": numbers, "componentType": U8 }, "values": { "bufferView": values },
    });
    let sparse = soup(&model).positions;
    assert_eq!(sparse, [DVec3::ZERO, DVec3::new(7.0, 8.0, 9.0), DVec3::Y * 2.0, DVec3::new(4.0, 5.0, 6.0)]);

    let accessor = model.json["accessors"][positions].as_object_mut().expect("an object");
    accessor.remove("bufferView");
    assert_eq!(soup(&model).positions[2], DVec3::ZERO, "zero where there are no bytes");
}

#[test]
fn whole_numbers_are_positions_as_they_are_or_as_fractions() {
    let bytes: Vec<u8> =
        [[0_i8; 4], [-128, 0, 0, 0], [0, 127, 0, 0], [0, 0, -64, 0]].concat().iter().map(|b| *b as u8).collect();
    for (normalized, expected) in [
        (false, [DVec3::ZERO, DVec3::X * -128.0, DVec3::Y * 127.0, DVec3::Z * -64.0]),
        (true, [DVec3::ZERO, DVec3::NEG_X, DVec3::Y, DVec3::Z * f64::from(-64.0_f32 / 127.0)]),
    ] {
        let mut model = Model::tetrahedron();
        let positions = model.accessor(&bytes, 5120, "VEC3", 4);
        model.json["accessors"][positions]["normalized"] = json!(normalized);
        let view = model.json["accessors"][positions]["bufferView"].as_u64().expect("a view") as usize;
        model.json["bufferViews"][view]["byteStride"] = json!(4);
        model.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = positions.into();
        model.json["extensionsRequired"] = json!(["KHR_mesh_quantization"]);
        assert_eq!(soup(&model).positions, expected);
    }
}

#[test]
fn a_count_may_be_written_with_a_point() {
    let model = Model::tetrahedron().with("/accessors/1/count", json!(12.0)).with("/accessors/0/count", json!(4.0));
    assert_eq!(soup(&model).faces.len(), 4);
    Model::tetrahedron()
        .with("/accessors/1/count", json!(12.5))
        .assert_refused(ReadErrorKind::Malformed, "whole number");
    Model::tetrahedron().with("/accessors/1/count", json!(-1)).assert_refused(ReadErrorKind::Malformed, "whole number");
}

#[test]
fn positions_that_are_not_finite_are_passed_on() {
    let mut model = Model::tetrahedron();
    model.bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(soup(&model).positions[0].x.is_nan());
}

#[test]
fn limits_hold_for_all_meshes_together() {
    let mut model = Model::tetrahedron();
    let again = model.json["meshes"][0]["primitives"][0].clone();
    model.json["meshes"] = json!([{ "primitives": [again] }, { "primitives": [again] }]);
    model.json["nodes"] = json!([{ "mesh": 0 }, { "mesh": 1 }]);
    let bytes = model.glb();
    let limits = Limits { max_faces: 8, max_vertices: 8, ..Limits::default() };
    assert!(read_within(&bytes, limits).is_ok());
    for (limits, words) in
        [(Limits { max_faces: 7, ..limits }, "8 faces"), (Limits { max_vertices: 7, ..limits }, "8 vertices")]
    {
        let error = read_within(&bytes, limits).expect_err("over the limit");
        assert_eq!(error.kind, ReadErrorKind::TooLarge);
        assert!(error.detail.contains(words), "{error}");
    }
}
