//! Reading, writing, and what is refused; each test makes its own file.

mod container;
mod cycle;
mod draco;
mod hostile;
mod nodes;
mod paint;
mod pose;
mod vertices;

use serde_json::{Value, json};

use super::super::beside::Beside;
use super::super::{Limits, ReadError, ReadErrorKind, ReadOptions, ReadScene};
use super::container::assemble;

const U8: u32 = 5121;
const U16: u32 = 5123;
const U32: u32 = 5125;
const F32: u32 = 5126;

/// The corners of a tetrahedron, and its faces, turned outward.
const CORNERS: [f32; 12] = [0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
const FACES: [u16; 12] = [0, 2, 1, 0, 1, 3, 1, 2, 3, 2, 0, 3];

/// A file in the making.
struct Model {
    json: Value,
    bytes: Vec<u8>,
}

impl Model {
    /// Without anything in it.
    fn empty() -> Self {
        let json =
            json!({ "asset": { "version": "2.0" }, "accessors": [], "bufferViews": [], "meshes": [], "nodes": [] });
        Self { json, bytes: Vec::new() }
    }

    /// A tetrahedron at the origin: accessor 0 has its corners, accessor 1 its faces.
    fn tetrahedron() -> Self {
        let mut model = Self::empty();
        model.accessor(&floats(&CORNERS), F32, "VEC3", 4);
        model.accessor(&shorts(&FACES), U16, "SCALAR", 12);
        model.json["meshes"] =
            json!([{ "name": "body", "primitives": [{ "attributes": { "POSITION": 0 }, "indices": 1 }] }]);
        model.json["nodes"] = json!([{ "mesh": 0 }]);
        model
    }

    /// The document with something changed, by the place of a member and its new value.
    fn with(mut self, pointer: &str, value: Value) -> Self {
        let (parent, name) = pointer.rsplit_once('/').expect("a path");
        match self.json.pointer_mut(parent).expect("a member") {
            Value::Array(list) => list[name.parse::<usize>().expect("a number")] = value,
            parent => parent[name] = value,
        }
        self
    }

    /// A view of bytes that are put into the buffer.
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
    super::read(bytes, &ReadOptions::default(), &Beside::nothing())
}

fn read_within(bytes: &[u8], limits: Limits) -> Result<ReadScene, ReadError> {
    super::read(bytes, &ReadOptions::within(limits), &Beside::nothing())
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
