use serde_json::{Value, json};

use super::super::super::{Limits, ReadErrorKind};
use super::{F32, Model, U8, assert_refused, floats, read_within};

use ReadErrorKind::{IndexOutOfRange, Malformed, TooLarge, Truncated};

#[test]
fn members_that_lie_are_refused() {
    for (pointer, value, kind, words) in [
        ("/accessors/0/count", json!(5), Truncated, "accessor 0 has 5 elements"),
        ("/accessors/0/count", json!(u32::MAX), Truncated, "4294967295 elements"),
        ("/accessors/0/count", json!(u64::MAX), Malformed, "whole number"),
        ("/accessors/0/byteOffset", json!(u32::MAX), Truncated, "from byte 4294967295"),
        ("/accessors/0/componentType", json!(5124), Malformed, "component type 5124"),
        ("/accessors/0/type", json!("VEC5"), Malformed, "VEC5"),
        ("/accessors/0/type", json!("VEC2"), Malformed, "2 coordinates"),
        ("/accessors/0/count", json!(3), IndexOutOfRange, "names vertex 3"),
        ("/accessors/1/componentType", json!(F32), Truncated, ""),
        ("/accessors/1/type", json!("VEC3"), Truncated, ""),
        ("/bufferViews/0/byteLength", json!(u32::MAX), Malformed, "buffer of 72 bytes"),
        ("/bufferViews/0/byteOffset", json!(71), Malformed, "from byte 71"),
        ("/bufferViews/0/byteStride", json!(8), Malformed, "12 bytes every 8"),
        ("/bufferViews/0/byteStride", json!(252), Truncated, "768 bytes"),
        ("/bufferViews/0/buffer", json!(1), Malformed, "buffer 1, and there are 1"),
        ("/buffers", json!([{ "byteLength": 73 }]), Truncated, "73 bytes and has 72"),
        ("/buffers", json!([{ "byteLength": 10 }]), Malformed, "buffer of 10 bytes"),
        ("/buffers", json!([{ "byteLength": 0 }, {}]), Malformed, "byteLength"),
        ("/meshes/0/primitives/0/indices", json!(7), Malformed, "accessor 7, and there are 2"),
        ("/meshes/0/primitives/0/mode", json!(7), Malformed, "mode 7"),
        ("/meshes/0/primitives/0/material", json!(0), Malformed, "material 0, and there are 0"),
        ("/meshes/0/primitives", json!({}), Malformed, "list"),
        ("/scene", json!(1), Malformed, "scene 1"),
        ("/asset", json!({}), Malformed, "version"),
    ] {
        Model::tetrahedron().with(pointer, value).assert_refused(kind, words);
    }
}

#[test]
fn indices_beyond_the_vertices_are_refused_where_they_stand() {
    let mut model = Model::tetrahedron();
    model.bytes[48 + 10] = 9;
    let error = super::read(&model.glb()).expect_err("vertex 9");
    assert_eq!(error.kind, IndexOutOfRange);
    let Some(super::super::super::Place::Byte(at)) = error.place else { panic!("{error}") };
    assert_eq!(model.glb()[at as usize], 9);
    model.bytes[48 + 10..48 + 12].copy_from_slice(&[255, 255]);
    model.assert_refused(IndexOutOfRange, "largest of its type");
}

#[test]
fn sparse_elements_that_are_not_there_are_refused() {
    let of = |numbers: &[u8], sparse_count: usize| {
        let mut model = Model::tetrahedron();
        let (numbers, values) = (model.view(numbers), model.view(&floats(&[0.0; 6])));
        model.json["accessors"][0]["sparse"] = json!({
            "count": sparse_count, "indices": { "bufferView": numbers, "componentType": U8 }, "values": { "bufferView": values },
        });
        model
    };
    assert_eq!(of(&[1, 2], 2).read().scene.placed_faces(), 4);
    of(&[1, 4], 2).assert_refused(Malformed, "not there");
    of(&[2, 1], 2).assert_refused(Malformed, "ascending");
    of(&[1, 1], 2).assert_refused(Malformed, "ascending");
    of(&[1, 2, 3], 3).assert_refused(Malformed, "not enough bytes");
    of(&[1, 2], usize::try_from(u32::MAX).expect("64 bits")).assert_refused(Malformed, "not enough bytes");
}

/// The model's positions or indices without any bytes, so many.
fn of_zeros(accessor: usize, count: u32) -> Model {
    let mut model = Model::tetrahedron();
    let entry = model.json["accessors"][accessor].as_object_mut().expect("an object");
    entry.remove("bufferView");
    entry.insert("count".to_owned(), json!(count));
    model
}

#[test]
fn zeros_that_cost_no_byte_are_believed_up_to_the_length_of_the_file() {
    for accessor in [0, 1] {
        assert_eq!(of_zeros(accessor, 12).read().scene.objects.len(), 1);
        of_zeros(accessor, 1 << 31).assert_refused(TooLarge, "2147483648 elements without data");
        of_zeros(accessor, 1_000_000).assert_refused(TooLarge, "without data");
    }
}

#[test]
fn the_same_bytes_used_over_and_over_are_bounded_by_the_limits() {
    let mut model = Model::tetrahedron();
    let primitive = model.json["meshes"][0]["primitives"][0].clone();
    model.json["meshes"] = vec![json!({ "primitives": [primitive] }); 1000].into();
    model.json["nodes"] = (0..1000).map(|mesh| json!({ "mesh": mesh })).collect::<Vec<Value>>().into();
    let limits = Limits { max_faces: 3000, ..Limits::default() };
    assert_eq!(read_within(&model.glb(), limits).expect_err("4000 faces").kind, TooLarge);

    // Sparse elements, of which each use costs and none is counted as a vertex.
    let (numbers, values) = (model.view(&[0, 1, 2, 3]), model.view(&floats(&[0.0; 12])));
    model.json["accessors"][0]["sparse"] = json!({
        "count": 4, "indices": { "bufferView": numbers, "componentType": U8 }, "values": { "bufferView": values },
    });
    let none = model.accessor(&[], U8, "SCALAR", 0);
    for mesh in model.json["meshes"].as_array_mut().expect("a list") {
        mesh["primitives"][0]["indices"] = none.into();
    }
    let limits = Limits { max_vertices: 100, ..Limits::default() };
    let error = read_within(&model.glb(), limits).expect_err("4000 elements");
    assert!(error.detail.contains("over and over"), "{error}");
}

#[test]
fn pictures_over_each_other_are_refused() {
    let mut model = Model::tetrahedron();
    let places = model.accessor(&floats(&[0.0; 8]), F32, "VEC2", 4);
    let picture = [b"\xFF\xD8\xFF".repeat(1000), vec![0; 100_000]].concat();
    let view = model.view(&picture);
    let begin = model.json["bufferViews"][view]["byteOffset"].as_u64().expect("a number");
    for number in 0..50_u64 {
        super::push(
            &mut model.json["bufferViews"],
            json!({ "buffer": 0, "byteOffset": begin + 3 * number, "byteLength": 100_000 }),
        );
    }
    let list = |of: &dyn Fn(usize) -> Value| Value::from((0..50).map(of).collect::<Vec<_>>());
    model.json["images"] = list(&|k| json!({ "bufferView": view + 1 + k }));
    model.json["textures"] = list(&|k| json!({ "source": k }));
    model.json["materials"] = list(&|k| json!({ "pbrMetallicRoughness": { "baseColorTexture": { "index": k } } }));
    let attributes = json!({ "POSITION": 0, "TEXCOORD_0": places });
    model.json["meshes"][0]["primitives"] = list(&|k| json!({ "attributes": attributes, "indices": 1, "material": k }));
    model.assert_refused(TooLarge, "pictures come to more bytes");
}

#[test]
fn documents_that_are_deep_or_long_are_answered() {
    let deep =
        format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"x\": {}1{}}}", "[".repeat(100_000), "]".repeat(100_000));
    assert_refused(deep.as_bytes(), ReadErrorKind::NoFaces, "no mesh");
    let deep = deep.replace("\"x\"", "\"nodes\"");
    assert_refused(deep.as_bytes(), Malformed, "can't be read");
    let long = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"x\": [{}0]}}", "0,".repeat(17 << 20));
    assert_refused(long.as_bytes(), TooLarge, "longer than");
    // Texts may be long, as buffers are.
    let text = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"x\": \"{}\\\"\"}}", "A".repeat(34 << 20));
    assert_refused(text.as_bytes(), ReadErrorKind::NoFaces, "no mesh");
    for bad in ["NaN", "1e999", "Infinity", "\"1\"", "null"] {
        let document =
            Model::tetrahedron().json.to_string().replace("\"mesh\":0", &format!("\"mesh\":0,\"scale\":[1,{bad},1]"));
        assert_refused(document.as_bytes(), Malformed, "can't be read");
    }
}

#[test]
fn a_file_with_any_one_byte_changed_is_answered() {
    let whole = Model::tetrahedron().glb();
    for at in 0..whole.len() {
        for value in [0, b'9', b'"', b'{', b']', b',', b'-', 0x7F, 0xFF] {
            let mut bytes = whole.clone();
            bytes[at] = value;
            match super::read(&bytes) {
                Ok(read) => assert!(read.scene.placed_faces() > 0 && read.warnings.len() <= 6),
                Err(error) => assert!(!error.detail.is_empty() && error.detail.len() < 600, "{error}"),
            }
        }
    }
}
