//! Reading, writing and rejecting glTF; each test builds its own file.

mod cycle;
mod meshes;
mod scenes;

use serde_json::{Value, json};

use super::super::errors::FileLocation;
use super::super::sidecar::Sidecars;
use super::super::{Format, Limits, ReadError, ReadErrorKind, ReadOptions, ReadScene};
use super::container::assemble;
use ReadErrorKind::{IndexOutOfRange, Malformed, TooLarge, Truncated};

const U8: u32 = 5121;
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;

/// The corners of a tetrahedron, and its outward-facing faces.
const CORNERS: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
const FACES: [u16; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];

/// A file under construction.
struct Model {
    json: Value,
    bytes: Vec<u8>,
}

impl Model {
    /// A document without content.
    fn empty() -> Self {
        let json =
            json!({ "asset": { "version": "2.0" }, "accessors": [], "bufferViews": [], "meshes": [], "nodes": [] });
        Self { json, bytes: Vec::new() }
    }

    /// A tetrahedron at the origin: accessor 0 holds its corners, accessor 1 its faces.
    fn tetrahedron() -> Self {
        let mut model = Self::empty();
        model.accessor(&floats(&CORNERS), F32, "VEC3", 4);
        model.accessor(&shorts(&FACES), U16, "SCALAR", 12);
        model.json["meshes"] =
            json!([{ "name": "body", "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }]);
        model.json["nodes"] = json!([{ "mesh": 0 }]);
        model
    }

    /// The document with the value at a JSON pointer changed.
    fn with(mut self, pointer: &str, value: Value) -> Self {
        let (parent, name) = pointer.rsplit_once('/').expect("a path");
        match self.json.pointer_mut(parent).expect("a member") {
            Value::Array(list) => list[name.parse::<usize>().expect("a number")] = value,
            parent => parent[name] = value,
        }
        self
    }

    /// Appends bytes to the buffer and adds a buffer view of them.
    fn view(&mut self, bytes: &[u8]) -> usize {
        let view = json!({ "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len() });
        self.bytes.extend_from_slice(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        push(&mut self.json["bufferViews"], view)
    }

    fn accessor(&mut self, bytes: &[u8], component: u32, shape: &str, count: usize) -> usize {
        let view = self.view(bytes);
        push(
            &mut self.json["accessors"],
            json!({ "bufferView": view, "componentType": component, "type": shape, "count": count }),
        )
    }

    fn glb(&self) -> Vec<u8> {
        let mut json = self.json.clone();
        if json.get("buffers").is_none() {
            json["buffers"] = json!([{ "byteLength": self.bytes.len() }]);
        }
        assemble(json.to_string().into_bytes(), self.bytes.clone()).expect("short")
    }

    fn read(&self) -> ReadScene {
        read(&self.glb()).unwrap_or_else(|error| panic!("{error}\n{}", self.json))
    }

    #[track_caller]
    fn assert_refused(&self, kind: ReadErrorKind, words: &str) {
        assert_refused(&self.glb(), kind, words);
    }
}

fn push(list: &mut Value, entry: Value) -> usize {
    let list = list.as_array_mut().expect("a list");
    list.push(entry);
    list.len() - 1
}

fn floats(values: &[f32]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn shorts(values: &[u16]) -> Vec<u8> {
    values.iter().flat_map(|value| value.to_le_bytes()).collect()
}

fn read(bytes: &[u8]) -> Result<ReadScene, ReadError> {
    super::read(bytes, &ReadOptions::default(), &Sidecars::none())
}

fn read_within(bytes: &[u8], limits: Limits) -> Result<ReadScene, ReadError> {
    super::read(bytes, &ReadOptions::within(limits), &Sidecars::none())
}

#[track_caller]
fn assert_refused(bytes: &[u8], kind: ReadErrorKind, words: &str) {
    match read(bytes) {
        Ok(read) => panic!("was read: {:?}", read.scene.items),
        Err(error) => {
            assert_eq!(error.kind, kind, "{error}");
            assert!(error.detail.contains(words), "'{error}' does not say '{words}'");
        }
    }
}

/// A GLB file with these chunks, valid or not.
fn file(chunks: &[(&[u8; 4], &[u8])]) -> Vec<u8> {
    let mut bytes = b"glTF\x02\0\0\0\0\0\0\0".to_vec();
    for (kind, chunk) in chunks {
        bytes.extend_from_slice(&(chunk.len() as u32).to_le_bytes());
        bytes.extend_from_slice(*kind);
        bytes.extend_from_slice(chunk);
    }
    let length = bytes.len() as u32;
    bytes[8..12].copy_from_slice(&length.to_le_bytes());
    bytes
}

/// The JSON and the binary data of a tetrahedron.
fn parts() -> (Vec<u8>, Vec<u8>) {
    let mut model = Model::tetrahedron();
    model.json["buffers"] = json!([{ "byteLength": model.bytes.len() }]);
    let mut text = model.json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    (text, model.bytes)
}

#[test]
fn chunks_of_unknown_types_are_skipped() {
    let (text, bytes) = parts();
    let read = read(&file(&[(b"JSON", &text), (b"BIN\0", &bytes), (b"XYZ1", b"abcd"), (b"XYZ2", b"")])).expect("sound");
    assert_eq!((read.format, read.dialect.as_str(), read.warnings), (Format::Glb, "GLB", Vec::new()));
    assert_eq!(read.scene.placed_faces(), 4);
}

#[test]
fn chunks_in_the_wrong_order_are_rejected_at_their_byte() {
    let (text, bytes) = parts();
    let (json, binary) = ((b"JSON", &text[..]), (b"BIN\0", &bytes[..]));
    let second = 20 + text.len();
    let third = second + 8 + bytes.len();
    for (chunks, at, words) in [
        (&[binary, json][..], 12, "first chunk"),
        (&[(b"XYZ1", b"abcd"), json], 12, "first chunk"),
        (&[json, binary, json], third, "second JSON chunk"),
        (&[json, binary, binary], third, "not its second chunk"),
        (&[json, (b"XYZ1", b"abcd"), binary], second + 12, "not its second chunk"),
    ] {
        let error = read(&file(chunks)).expect_err("out of order");
        assert_eq!(
            (error.kind, error.place),
            (ReadErrorKind::Malformed, Some(FileLocation::Byte(at as u64))),
            "{error}"
        );
        assert!(error.detail.contains(words), "{error}");
    }
}

#[test]
fn a_file_truncated_anywhere_is_rejected() {
    let whole = Model::tetrahedron().glb();
    for end in 4..whole.len() {
        let error = read(&whole[..end]).expect_err("cut off");
        assert_eq!(error.kind, ReadErrorKind::Truncated, "{end}: {error}");
    }
}

#[test]
fn wrong_lengths_are_rejected() {
    let whole = Model::tetrahedron().glb();
    let changed = |at: usize, value: u32| {
        let mut bytes = whole.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    assert_refused(&changed(8, 0), ReadErrorKind::Malformed, "too short");
    assert_refused(&changed(8, u32::MAX), ReadErrorKind::Truncated, "length of 4294967295 bytes");
    assert_refused(&changed(12, u32::MAX), ReadErrorKind::Truncated, "chunk of the GLB file declares 4294967295 bytes");
    assert_refused(&changed(12, 8), ReadErrorKind::Truncated, "chunk of the GLB file");
    assert_refused(&changed(4, 1), ReadErrorKind::UnsupportedFormat, "glTF 1.0");
    assert_refused(&changed(4, 3), ReadErrorKind::Malformed, "version 3");
}

#[test]
fn odd_but_valid_files_are_read_with_a_warning() {
    let (text, bytes) = parts();
    let longer = [&bytes[..], &[0; 12]].concat();
    let unaligned = [&text[..], b" "].concat();
    let marked = [b"\xEF\xBB\xBF", &text[..], b" "].concat();
    let mut more = file(&[(b"JSON", &text), (b"BIN\0", &bytes)]);
    more.extend_from_slice(b"more");
    for (file, words) in [
        (file(&[(b"JSON", &text), (b"BIN\0", &longer)]), "after the end of the binary data were ignored: 12"),
        (file(&[(b"JSON", &unaligned), (b"BIN\0", &bytes)]), "multiple of four"),
        (more, "after the end of the GLB file were ignored: 4"),
    ] {
        let read = read(&file).expect("sound");
        assert_eq!(read.warnings.len(), 1, "{:?}", read.warnings);
        assert!(read.warnings[0].contains(words), "{:?}", read.warnings);
    }
    assert_eq!(read(&file(&[(b"JSON", &marked), (b"BIN\0", &bytes)])).expect("sound").warnings, Vec::<String>::new());
}

#[test]
fn json_with_an_embedded_buffer_is_read() {
    use base64::Engine;

    let model = Model::tetrahedron();
    let data = base64::engine::general_purpose::STANDARD.encode(&model.bytes);
    let length = model.bytes.len();
    let of = |uri: String| {
        let model = Model::tetrahedron().with("/buffers", json!([{ "byteLength": length, "uri": uri }]));
        serde_json::to_vec_pretty(&model.json).expect("JSON")
    };
    let found = read(&of(format!("data:application/octet-stream;base64,{data}"))).expect("sound");
    assert_eq!((found.dialect.as_str(), found.scene.placed_faces()), ("glTF", 4));
    assert_eq!(found.scene, model.read().scene);
    let unpadded = data.trim_end_matches('=');
    assert!(read(&of(format!("data:;base64,{unpadded}"))).is_ok());
    assert_refused(&of("model.bin".to_owned()), ReadErrorKind::UnsupportedFormat, "in another file, 'model.bin'");
    assert_refused(&of(format!("data:;base64,{}", &data[..40])), ReadErrorKind::Truncated, "cut off");
    assert_refused(&of("data:;base64,????".to_owned()), ReadErrorKind::Malformed, "not valid base64");
    assert_refused(&of("data:text/plain,abc".to_owned()), ReadErrorKind::Malformed, "base64");
}

#[test]
fn malformed_json_is_rejected_at_its_byte_or_line() {
    let (_, bytes) = parts();
    let error =
        read(&file(&[(b"JSON", b"{\n \"asset\": {\"version\": 2}}   "), (b"BIN\0", &bytes)])).expect_err("a number");
    assert!(matches!(error.place, Some(FileLocation::Byte(44..=45))), "{error}");
    let error = read(b"{\n \"asset\": {\"version\": 2}}").expect_err("a number");
    assert_eq!(error.place, Some(FileLocation::Line(2)), "{error}");
    assert!(error.detail.contains("expected a string") && !error.detail.contains(" column "), "{error}");
}

#[test]
fn other_versions_are_rejected_by_name() {
    let of = |version: &str, least: Option<&str>| {
        Model::tetrahedron().with("/asset", json!({ "version": version, "minVersion": least }))
    };
    of("1.0", None).assert_refused(ReadErrorKind::UnsupportedFormat, "version 1.0");
    of("2.1", Some("2.1")).assert_refused(ReadErrorKind::UnsupportedFormat, "version 2.1");
    assert_eq!(of("2.1", Some("2.0")).read().scene.placed_faces(), 4);
}

#[test]
fn required_extensions_are_rejected_and_used_ones_reported() {
    let model = Model::tetrahedron().with("/extensionsUsed", json!(["EXT_mesh_gpu_instancing", "KHR_materials_unlit"]));
    let read = model.read();
    assert_eq!(read.warnings.len(), 1);
    assert!(read.warnings[0].ends_with("EXT_mesh_gpu_instancing"), "{:?}", read.warnings);
    let required = |name: &str| Model::tetrahedron().with("/extensionsRequired", json!([name]));
    required("EXT_mesh_gpu_instancing").assert_refused(ReadErrorKind::UnsupportedFormat, "EXT_mesh_gpu_instancing");
    required("EXT_meshopt_compression").assert_refused(ReadErrorKind::UnsupportedFormat, "without compression");
    assert!(required("KHR_materials_unlit").read().warnings.is_empty());
}

#[test]
fn wrong_members_are_rejected() {
    for (pointer, value, kind, words) in [
        ("/accessors/0/count", json!(5), Truncated, "accessor 0 spans 5 elements"),
        ("/accessors/0/count", json!(u32::MAX), Truncated, "4294967295 elements"),
        ("/accessors/0/count", json!(u64::MAX), Malformed, "whole number"),
        ("/accessors/0/byteOffset", json!(u32::MAX), Truncated, "from byte 4294967295"),
        ("/accessors/0/componentType", json!(5124), Malformed, "component type 5124"),
        ("/accessors/0/type", json!("VEC5"), Malformed, "VEC5"),
        ("/accessors/0/type", json!("VEC2"), Malformed, "2 coordinates"),
        ("/accessors/0/count", json!(3), IndexOutOfRange, "refers to vertex 3"),
        ("/accessors/1/componentType", json!(F32), Truncated, ""),
        ("/accessors/1/type", json!("VEC3"), Truncated, ""),
        ("/bufferViews/0/byteLength", json!(u32::MAX), Malformed, "buffer of 72 bytes"),
        ("/bufferViews/0/byteOffset", json!(71), Malformed, "from byte 71"),
        ("/bufferViews/0/byteStride", json!(8), Malformed, "12 bytes, but a stride of only 8"),
        ("/bufferViews/0/byteStride", json!(252), Truncated, "768 bytes"),
        ("/bufferViews/0/buffer", json!(1), Malformed, "buffer 1, but has only 1"),
        ("/buffers", json!([{ "byteLength": 73 }]), Truncated, "73 bytes but has 72"),
        ("/buffers", json!([{ "byteLength": 10 }]), Malformed, "buffer of 10 bytes"),
        ("/buffers", json!([{ "byteLength": 0 }, {}]), Malformed, "byteLength"),
        ("/meshes/0/primitives/0/indices", json!(7), Malformed, "accessor 7, but has only 2"),
        ("/meshes/0/primitives/0/mode", json!(7), Malformed, "mode 7"),
        ("/meshes/0/primitives/0/material", json!(0), Malformed, "material 0, but has only 0"),
        ("/meshes/0/primitives", json!({}), Malformed, "list"),
        ("/scene", json!(1), Malformed, "scene 1"),
        ("/asset", json!({}), Malformed, "version"),
    ] {
        Model::tetrahedron().with(pointer, value).assert_refused(kind, words);
    }
}

#[test]
fn indices_out_of_range_are_rejected_at_their_byte() {
    let mut model = Model::tetrahedron();
    model.bytes[48 + 10] = 9;
    let error = read(&model.glb()).expect_err("vertex 9");
    assert_eq!(error.kind, IndexOutOfRange);
    let Some(FileLocation::Byte(at)) = error.place else { panic!("{error}") };
    assert_eq!(model.glb()[at as usize], 9);
    model.bytes[48 + 10..48 + 12].copy_from_slice(&[255, 255]);
    model.assert_refused(IndexOutOfRange, "largest of its type");
}

#[test]
fn sparse_indices_out_of_range_are_rejected() {
    let of = |numbers: &[u8], sparse_count: usize| {
        let mut model = Model::tetrahedron();
        let (numbers, values) = (model.view(numbers), model.view(&floats(&[0.0; 6])));
        model.json["accessors"][0]["sparse"] = json!({
            "count": sparse_count, "indices": { "bufferView": numbers, "componentType": U8 }, "values": { "bufferView": values },
        });
        model
    };
    assert_eq!(of(&[1, 2], 2).read().scene.placed_faces(), 4);
    of(&[1, 4], 2).assert_refused(Malformed, "out of range");
    of(&[2, 1], 2).assert_refused(Malformed, "ascending");
    of(&[1, 1], 2).assert_refused(Malformed, "ascending");
    of(&[1, 2, 3], 3).assert_refused(Malformed, "too short");
    of(&[1, 2], usize::try_from(u32::MAX).expect("64 bits")).assert_refused(Malformed, "too short");
}

/// A model whose positions or indices have a count but no data.
fn of_zeros(accessor: usize, count: u32) -> Model {
    let mut model = Model::tetrahedron();
    let entry = model.json["accessors"][accessor].as_object_mut().expect("an object");
    entry.remove("bufferView");
    entry.insert("count".to_owned(), json!(count));
    model
}

#[test]
fn zero_elements_without_data_are_limited_by_the_file_size() {
    for accessor in [0, 1] {
        assert_eq!(of_zeros(accessor, 12).read().scene.objects.len(), 1);
        of_zeros(accessor, 1 << 31).assert_refused(TooLarge, "2147483648 elements without data");
        of_zeros(accessor, 1_000_000).assert_refused(TooLarge, "without data");
    }
}

#[test]
fn repeated_use_of_the_same_bytes_is_limited() {
    let mut model = Model::tetrahedron();
    let primitive = model.json["meshes"][0]["primitives"][0].clone();
    model.json["meshes"] = vec![json!({ "primitives": [primitive] }); 1000].into();
    model.json["nodes"] = (0..1000).map(|mesh| json!({ "mesh": mesh })).collect::<Vec<Value>>().into();
    let limits = Limits { max_faces: 3000, ..Limits::default() };
    assert_eq!(read_within(&model.glb(), limits).expect_err("4000 faces").kind, TooLarge);

    // Sparse elements cost work on each use, but do not count as vertices.
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
    assert!(error.detail.contains("too often"), "{error}");
}

#[test]
fn overlapping_images_are_rejected() {
    let mut model = Model::tetrahedron();
    let places = model.accessor(&floats(&[0.0; 8]), F32, "VEC2", 4);
    let picture = [b"\xFF\xD8\xFF".repeat(1000), vec![0; 100_000]].concat();
    let view = model.view(&picture);
    let begin = model.json["bufferViews"][view]["byteOffset"].as_u64().expect("a number");
    for number in 0..50_u64 {
        push(
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
    model.assert_refused(TooLarge, "images have more bytes");
}

#[test]
fn deep_or_long_documents_give_a_result_or_an_error() {
    let deep =
        format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"x\": {}1{}}}", "[".repeat(100_000), "]".repeat(100_000));
    assert_refused(deep.as_bytes(), ReadErrorKind::NoFaces, "no mesh");
    let deep = deep.replace("\"x\"", "\"nodes\"");
    assert_refused(deep.as_bytes(), Malformed, "can't be read");
    let long = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"x\": [{}0]}}", "0,".repeat(17 << 20));
    assert_refused(long.as_bytes(), TooLarge, "longer than");
    // Strings may be long, because they hold buffers.
    let text = format!("{{\"asset\": {{\"version\": \"2.0\"}}, \"x\": \"{}\\\"\"}}", "A".repeat(34 << 20));
    assert_refused(text.as_bytes(), ReadErrorKind::NoFaces, "no mesh");
    for bad in ["NaN", "1e999", "Infinity", "\"1\"", "null"] {
        let document =
            Model::tetrahedron().json.to_string().replace("\"mesh\":0", &format!("\"mesh\":0,\"scale\":[1,{bad},1]"));
        assert_refused(document.as_bytes(), Malformed, "can't be read");
    }
}

#[test]
fn a_file_with_any_byte_changed_gives_a_result_or_an_error() {
    let whole = Model::tetrahedron().glb();
    for at in 0..whole.len() {
        for value in [0, b'9', b'"', b'{', b']', b',', b'-', 0x7F, 0xFF] {
            let mut bytes = whole.clone();
            bytes[at] = value;
            match read(&bytes) {
                Ok(read) => assert!(read.scene.placed_faces() > 0 && read.warnings.len() <= 6),
                Err(error) => assert!(!error.detail.is_empty() && error.detail.len() < 600, "{error}"),
            }
        }
    }
}
