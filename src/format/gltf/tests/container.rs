use serde_json::json;

use super::super::super::errors::Place;
use super::super::super::{Format, ReadErrorKind};
use super::{Model, assert_refused, read};

/// A file of these chunks, whatever they are.
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

/// The document and the bytes of a tetrahedron.
fn parts() -> (Vec<u8>, Vec<u8>) {
    let mut model = Model::tetrahedron();
    model.json["buffers"] = json!([{ "byteLength": model.bytes.len() }]);
    let mut text = model.json.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    (text, model.bytes)
}

#[test]
fn chunks_of_unknown_kinds_are_passed_over() {
    let (text, bytes) = parts();
    let read = read(&file(&[(b"JSON", &text), (b"BIN\0", &bytes), (b"XYZ1", b"abcd"), (b"XYZ2", b"")])).expect("sound");
    assert_eq!((read.format, read.dialect.as_str(), read.warnings), (Format::Glb, "GLB", Vec::new()));
    assert_eq!(read.scene.placed_faces(), 4);
}

#[test]
fn chunks_in_another_order_are_refused_where_they_stand() {
    let (text, bytes) = parts();
    let (json, binary) = ((b"JSON", &text[..]), (b"BIN\0", &bytes[..]));
    let second = 20 + text.len();
    let third = second + 8 + bytes.len();
    for (chunks, at, words) in [
        (&[binary, json][..], 12, "first chunk"),
        (&[(b"XYZ1", b"abcd"), json], 12, "first chunk"),
        (&[json, binary, json], third, "second chunk of JSON"),
        (&[json, binary, binary], third, "not its second chunk"),
        (&[json, (b"XYZ1", b"abcd"), binary], second + 12, "not its second chunk"),
    ] {
        let error = read(&file(chunks)).expect_err("out of order");
        assert_eq!((error.kind, error.place), (ReadErrorKind::Malformed, Some(Place::Byte(at as u64))), "{error}");
        assert!(error.detail.contains(words), "{error}");
    }
}

#[test]
fn a_file_that_is_cut_off_anywhere_is_refused() {
    let whole = Model::tetrahedron().glb();
    for end in 4..whole.len() {
        let error = read(&whole[..end]).expect_err("cut off");
        assert_eq!(error.kind, ReadErrorKind::Truncated, "{end}: {error}");
    }
}

#[test]
fn lengths_that_lie_are_refused() {
    let whole = Model::tetrahedron().glb();
    let changed = |at: usize, value: u32| {
        let mut bytes = whole.clone();
        bytes[at..at + 4].copy_from_slice(&value.to_le_bytes());
        bytes
    };
    assert_refused(&changed(8, 0), ReadErrorKind::Malformed, "too short");
    assert_refused(&changed(8, u32::MAX), ReadErrorKind::Truncated, "4294967295 bytes long");
    assert_refused(&changed(12, u32::MAX), ReadErrorKind::Truncated, "chunk of the GLB file is 4294967295 bytes");
    assert_refused(&changed(12, 8), ReadErrorKind::Truncated, "chunk of the GLB file");
    assert_refused(&changed(4, 1), ReadErrorKind::UnsupportedFormat, "glTF 1.0");
    assert_refused(&changed(4, 3), ReadErrorKind::Malformed, "version 3");
}

#[test]
fn what_is_sound_but_odd_is_read_with_a_warning() {
    let (text, bytes) = parts();
    let longer = [&bytes[..], &[0; 12]].concat();
    let unaligned = [&text[..], b" "].concat();
    let marked = [b"\xEF\xBB\xBF", &text[..], b" "].concat();
    let mut more = file(&[(b"JSON", &text), (b"BIN\0", &bytes)]);
    more.extend_from_slice(b"more");
    for (file, words) in [
        (file(&[(b"JSON", &text), (b"BIN\0", &longer)]), "after the end of the binary data were left out: 12"),
        (file(&[(b"JSON", &unaligned), (b"BIN\0", &bytes)]), "multiples of four"),
        (more, "after the end of the GLB file were left out: 4"),
    ] {
        let read = read(&file).expect("sound");
        assert_eq!(read.warnings.len(), 1, "{:?}", read.warnings);
        assert!(read.warnings[0].contains(words), "{:?}", read.warnings);
    }
    assert_eq!(read(&file(&[(b"JSON", &marked), (b"BIN\0", &bytes)])).expect("sound").warnings, Vec::<String>::new());
}

#[test]
fn json_with_its_buffer_in_it_is_read() {
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
    assert_refused(&of("data:;base64,????".to_owned()), ReadErrorKind::Malformed, "not base64");
    assert_refused(&of("data:text/plain,abc".to_owned()), ReadErrorKind::Malformed, "base64");
}

#[test]
fn a_document_that_is_no_json_is_refused_at_its_byte_or_line() {
    let (_, bytes) = parts();
    let error =
        read(&file(&[(b"JSON", b"{\n \"asset\": {\"version\": 2}}   "), (b"BIN\0", &bytes)])).expect_err("a number");
    assert!(matches!(error.place, Some(Place::Byte(44..=45))), "{error}");
    let error = read(b"{\n \"asset\": {\"version\": 2}}").expect_err("a number");
    assert_eq!(error.place, Some(Place::Line(2)), "{error}");
    assert!(error.detail.contains("expected a text") && !error.detail.contains(" column "), "{error}");
}

#[test]
fn other_versions_are_refused_by_name() {
    let of = |version: &str, least: Option<&str>| {
        Model::tetrahedron().with("/asset", json!({ "version": version, "minVersion": least }))
    };
    of("1.0", None).assert_refused(ReadErrorKind::UnsupportedFormat, "version 1.0");
    of("2.1", Some("2.1")).assert_refused(ReadErrorKind::UnsupportedFormat, "version 2.1");
    assert_eq!(of("2.1", Some("2.0")).read().scene.placed_faces(), 4);
}

#[test]
fn extensions_are_refused_where_required_and_told_where_used() {
    let model = Model::tetrahedron().with("/extensionsUsed", json!(["EXT_mesh_gpu_instancing", "KHR_materials_unlit"]));
    let read = model.read();
    assert_eq!(read.warnings.len(), 1);
    assert!(read.warnings[0].ends_with("EXT_mesh_gpu_instancing"), "{:?}", read.warnings);
    let required = |name: &str| Model::tetrahedron().with("/extensionsRequired", json!([name]));
    required("EXT_mesh_gpu_instancing").assert_refused(ReadErrorKind::UnsupportedFormat, "EXT_mesh_gpu_instancing");
    required("EXT_meshopt_compression").assert_refused(ReadErrorKind::UnsupportedFormat, "without compression");
    assert!(required("KHR_materials_unlit").read().warnings.is_empty());
}
