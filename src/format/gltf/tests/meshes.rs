//! Reading meshes: topology, accessors, morph targets, skins and Draco compression.

use draco_core::{
    DataType, EncoderBuffer, EncoderOptions, FaceIndex, GeometryAttributeType, Mesh, MeshEncoder, PointAttribute,
    PointIndex,
};
use glam::DVec3;
use serde_json::json;

use super::super::super::{Limits, ReadErrorKind};
use super::{F32, Model, U8, U16, U32, floats, read, read_within, shorts};
use crate::mesh::Soup;
use crate::scene::Palette;

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
fn indices_of_every_width_are_read_and_may_be_missing() {
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
fn strips_and_fans_become_consistently_oriented_triangles() {
    assert_eq!(soup(&of_indices(&[0, 1, 2, 3, 0], U8, 5, 5)).faces, [[0, 1, 2], [1, 3, 2], [2, 3, 0]]);
    assert_eq!(soup(&of_indices(&[0, 1, 2, 3, 1], U8, 5, 6)).faces, [[1, 2, 0], [2, 3, 0], [3, 1, 0]]);
    assert_eq!(soup(&of_indices(&[0, 1, 2, 2, 3, 3, 0, 1], U8, 8, 5)).faces, [[0, 1, 2], [3, 1, 0]], "joined strips");
}

#[test]
fn points_lines_and_primitives_without_positions_are_dropped_with_a_warning() {
    let mut model = Model::tetrahedron();
    let primitives = model.json["meshes"][0]["primitives"].as_array_mut().expect("a list");
    primitives.push(json!({ "attributes": { "POSITION": 0 }, "mode": 1 }));
    primitives.push(json!({ "attributes": {}, "indices": 1 }));
    let read = model.read();
    assert_eq!(read.scene.placed_faces(), 4);
    assert!(read.warnings[0].ends_with("dropped: 2"), "{:?}", read.warnings);
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
fn unused_vertices_are_dropped_if_they_are_many() {
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
fn elements_may_have_a_stride_and_sparse_replacements() {
    // Positions of 12 bytes with a stride of 16.
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
fn integer_positions_are_read_as_integers_or_as_fractions() {
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
fn a_count_may_be_written_with_a_decimal_point() {
    let model = Model::tetrahedron().with("/accessors/1/count", json!(12.0)).with("/accessors/0/count", json!(4.0));
    assert_eq!(soup(&model).faces.len(), 4);
    Model::tetrahedron()
        .with("/accessors/1/count", json!(12.5))
        .assert_refused(ReadErrorKind::Malformed, "whole number");
    Model::tetrahedron().with("/accessors/1/count", json!(-1)).assert_refused(ReadErrorKind::Malformed, "whole number");
}

#[test]
fn non_finite_positions_are_kept() {
    let mut model = Model::tetrahedron();
    model.bytes[..4].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(soup(&model).positions[0].x.is_nan());
}

#[test]
fn limits_apply_to_all_meshes_together() {
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

fn positions(model: &Model) -> Vec<DVec3> {
    model.read().scene.objects[0].mesh().expect("a mesh").soup.positions.clone()
}

#[test]
fn a_mesh_morphs_by_its_weights() {
    let mut model = Model::tetrahedron();
    let shifts = model.accessor(&floats(&[1.0; 12]), F32, "VEC3", 4);
    model.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "NORMAL": 9 }, { "POSITION": shifts }]);
    assert_eq!(positions(&model)[1], DVec3::X, "at rest without weights");
    assert!(model.read().warnings[0].contains("rest pose"));
    let model = model.with("/meshes/0/weights", json!([1, 0.5]));
    assert_eq!(positions(&model)[1], DVec3::new(1.5, 0.5, 0.5));
    // A node with its own weights shows another object.
    let model = model
        .with("/nodes", json!([{ "mesh": 0 }, { "mesh": 0, "weights": [0, 2] }, { "mesh": 0, "weights": [1, 0.5] }]));
    let scene = model.read().scene;
    assert_eq!(scene.objects.len(), 2);
    assert_eq!(scene.items.iter().map(|item| item.object).collect::<Vec<_>>(), [0, 1, 0]);
    assert_eq!(scene.objects[1].mesh().expect("a mesh").soup.positions[0], DVec3::splat(2.0));
}

/// A tetrahedron with two joints: the last corner belongs to the second joint, the third corner to both.
fn skinned() -> Model {
    let mut model = Model::tetrahedron();
    let joints = model.accessor(&[0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 1, 0, 0, 0], U8, "VEC4", 4);
    let weights: Vec<f32> =
        [[1.0, 0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.5, 0.5, 0.0, 0.0], [0.9, 0.0, 0.0, 0.0]].concat();
    let weights = model.accessor(&floats(&weights), F32, "VEC4", 4);
    let shifted = |x: f32| [1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0, 0.0, x, 0.0, 0.0, 1.0];
    let bind = model.accessor(&floats(&[shifted(0.0), shifted(-10.0)].concat()), F32, "MAT4", 2);
    let attributes = &mut model.json["meshes"][0]["primitives"][0]["attributes"];
    attributes["JOINTS_0"] = joints.into();
    attributes["WEIGHTS_0"] = weights.into();
    model.json["skins"] = json!([{ "joints": [1, 2], "inverseBindMatrices": bind }]);
    model.with("/nodes", json!([{ "mesh": 0, "skin": 0, "translation": [99, 0, 0] }, { "children": [2] }, { "translation": [14, 0, 0] }]))
}

#[test]
fn a_skinned_mesh_is_placed_by_its_joints_not_its_node() {
    let read = skinned().read();
    let placed = read.scene.placed(4).expect("few faces").soup.positions;
    let expected = [DVec3::ZERO, DVec3::X, DVec3::new(2.0, 1.0, 0.0), DVec3::new(4.0, 0.0, 1.0)];
    assert!(placed.iter().zip(expected).all(|(a, b)| a.abs_diff_eq(b, 1e-6)), "{placed:?}");
    assert!(read.warnings[0].contains("rest pose"), "{:?}", read.warnings);
}

#[test]
fn a_skin_on_a_mesh_without_joints_changes_nothing() {
    let mut model = skinned();
    model.json["meshes"][0]["primitives"][0]["attributes"] = json!({ "POSITION": 0 });
    let scene = model.read().scene;
    assert_eq!(scene.items[0].transform.translation, DVec3::X * 99.0);
}

#[test]
fn incomplete_skins_are_rejected() {
    for (pointer, value, words) in [
        ("/skins/0/joints", json!([1]), "joint 1, but its skin has only 1"),
        ("/skins/0/joints", json!([1, 2, 0]), "fewer inverse bind matrices than joints"),
        ("/skins/0/joints", json!([]), "no joints"),
        ("/skins/0/joints", json!([1, 7]), "node 7"),
        ("/skins/0/inverseBindMatrices", json!(0), "fewer inverse bind matrices than joints"),
        ("/nodes/0/skin", json!(3), "skin 3"),
        ("/accessors/3/count", json!(2), "WEIGHTS_0 values for only 2"),
    ] {
        skinned().with(pointer, value).assert_refused(ReadErrorKind::Malformed, words);
    }
}

/// A bent grid of vertices, and its faces.
fn grid(n: u32) -> (Vec<f32>, Vec<[u32; 3]>) {
    let at = |k: u32| f64::from(k) / f64::from(n);
    let positions = (0..=n)
        .flat_map(|y| (0..=n).flat_map(move |x| [at(x) as f32, at(y) as f32, (at(x) * at(y) * 3.0).sin() as f32]));
    let faces = (0..n).flat_map(|y| {
        (0..n).flat_map(move |x| {
            let a = y * (n + 1) + x;
            [[a, a + 1, a + n + 2], [a, a + n + 2, a + n + 1]]
        })
    });
    (positions.collect(), faces.collect())
}

fn attribute(of: GeometryAttributeType, width: u8, kind: DataType, bytes: &[u8], count: usize) -> PointAttribute {
    let mut attribute = PointAttribute::new();
    attribute.init(of, width, kind, kind != DataType::Float32, count);
    attribute.buffer_mut().write(0, bytes);
    attribute
}

/// A grid compressed with Draco. Attribute 0 has positions, attribute 1 vertex colours.
fn compressed(n: u32, options: &EncoderOptions) -> Vec<u8> {
    let (positions, faces) = grid(n);
    let count = positions.len() / 3;
    let colors: Vec<u8> = (0..count).flat_map(|k| [255, if k % 2 == 0 { 255 } else { 0 }, 0]).collect();
    let mut mesh = Mesh::new();
    mesh.add_attribute(attribute(GeometryAttributeType::Position, 3, DataType::Float32, &floats(&positions), count));
    mesh.add_attribute(attribute(GeometryAttributeType::Color, 3, DataType::Uint8, &colors, count));
    mesh.set_num_points(count);
    mesh.set_num_faces(faces.len());
    for (face, corners) in faces.iter().enumerate() {
        mesh.set_face(FaceIndex(face as u32), corners.map(PointIndex));
    }
    let mut encoder = MeshEncoder::new();
    encoder.set_mesh(mesh);
    let mut out = EncoderBuffer::new();
    encoder.encode(options, &mut out).expect("a sound mesh");
    out.data().to_vec()
}

/// The grid encoded sequentially, with the default options, and with the highest compression level.
fn all_encodings(n: u32) -> Vec<Vec<u8>> {
    let mut in_order = EncoderOptions::new();
    in_order.set_encoding_method(0);
    let mut close = EncoderOptions::new();
    close.set_compression_level(10);
    [in_order, EncoderOptions::new(), close].iter().map(|options| compressed(n, options)).collect()
}

/// A file with a compressed grid.
fn model(data: &[u8]) -> Model {
    let mut model = Model::empty();
    let view = model.view(data);
    let declared = |shape: &str, component: u32| json!({ "componentType": component, "type": shape, "count": 9, "normalized": component == 5121 });
    model.json["accessors"] = json!([declared("VEC3", 5126), declared("VEC3", 5121), declared("SCALAR", 5123)]);
    model.json["meshes"] = json!([{ "primitives": [{
        "attributes": { "POSITION": 0, "COLOR_0": 1 }, "indices": 2, "mode": 5,
        "extensions": { "KHR_draco_mesh_compression": { "bufferView": view, "attributes": { "POSITION": 0, "COLOR_0": 1 } } },
    }] }]);
    model.json["nodes"] = json!([{ "mesh": 0 }]);
    model.json["extensionsRequired"] = json!(["KHR_draco_mesh_compression"]);
    model
}

#[test]
fn compressed_primitives_are_decoded() {
    let (positions, faces) = grid(8);
    let middle = |corners: [DVec3; 3]| corners.iter().sum::<DVec3>() / 3.0;
    let at = |v: u32| DVec3::from_array([0, 1, 2].map(|k| f64::from(positions[3 * v as usize + k])));
    let expected: Vec<DVec3> = faces.iter().map(|face| middle(face.map(at))).collect();
    for data in all_encodings(8) {
        let read = model(&data).read();
        let mesh = read.scene.objects[0].mesh().expect("a mesh");
        assert_eq!((mesh.soup.faces.len(), mesh.soup.positions.len()), (128, 81));
        for face in 0..128 {
            let found = middle(mesh.soup.corners(face));
            assert!(expected.iter().any(|it| it.abs_diff_eq(found, 2e-3)), "{found} is the middle of no face");
        }
        let Palette::Colors(colors) = &read.scene.palettes[0] else { panic!("{:?}", read.scene.palettes) };
        let mut colors = colors.clone();
        colors.sort_unstable();
        assert_eq!(colors, [[255, 0, 0, 255], [255, 255, 0, 255]]);
    }
}

#[test]
fn compressed_data_without_a_declared_attribute_is_rejected() {
    let data = all_encodings(2).remove(1);
    let model =
        model(&data).with("/meshes/0/primitives/0/extensions/KHR_draco_mesh_compression/attributes/COLOR_0", json!(7));
    model.assert_refused(ReadErrorKind::Malformed, "no attribute COLOR_0");
}

#[test]
fn compressed_data_with_any_damage_gives_a_result_or_an_error() {
    for data in all_encodings(4) {
        for end in 0..data.len() {
            let answer = read(&model(&data[..end]).glb());
            // The last bytes may be unused.
            assert!(answer.is_err() || end > data.len() / 2, "{end} of {} bytes were enough", data.len());
        }
        for at in 0..data.len() {
            for value in [0, 1, 0x7F, 0x80, 0xFF, data[at] ^ 0x10] {
                let mut bytes = data.clone();
                bytes[at] = value;
                if let Ok(read) = read(&model(&bytes).glb()) {
                    let mesh = read.scene.objects[0].mesh().expect("a mesh");
                    let count = mesh.soup.positions.len() as u32;
                    assert!(mesh.soup.faces.iter().flatten().all(|&v| v < count));
                }
            }
        }
    }
}

#[test]
fn compressed_data_is_decoded_within_the_limits() {
    for data in all_encodings(8) {
        let bytes = model(&data).glb();
        assert!(read_within(&bytes, Limits { max_faces: 128, max_vertices: 81, ..Limits::default() }).is_ok());
        for limits in [Limits { max_faces: 127, ..Limits::default() }, Limits { max_vertices: 80, ..Limits::default() }]
        {
            assert_eq!(read_within(&bytes, limits).expect_err("over").kind, ReadErrorKind::TooLarge);
        }
    }
}
