//! 3MF: reading, refused files, and round trips.

mod archive;
mod colors;
mod hostile;
mod objects;
mod oracle;
mod round_trip;
mod rules;

use meshmend::format::{Format, ReadErrorKind, ReadOptions, ReadScene, read_scene};
use meshmend::scene::PaintedMesh;

use crate::support::archives::package;

const ROOT: &str = "3D/3dmodel.model";
const ROOT_RELATIONSHIPS: &str = "_rels/.rels";
const MODEL: &str = "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel";

/// A mesh of one triangle.
const MESH: &str = "<mesh><vertices><vertex x=\"0\" y=\"0\" z=\"0\"/><vertex x=\"1\" y=\"0\" z=\"0\"/><vertex x=\"0\" y=\"1\" z=\"0\"/></vertices><triangles><triangle v1=\"0\" v2=\"1\" v3=\"2\"/></triangles></mesh>";

fn relationships(all: &[(&str, &str)]) -> String {
    let each = all
        .iter()
        .enumerate()
        .map(|(n, (kind, target))| format!("<Relationship Id=\"r{n}\" Type=\"{kind}\" Target=\"{target}\"/>"));
    let all: String = each.collect();
    format!(
        "<Relationships xmlns=\"http://schemas.openxmlformats.org/package/2006/relationships\">{all}</Relationships>"
    )
}

/// A file with this model and other parts.
fn file_with(model: &str, others: &[(&str, &[u8])]) -> Vec<u8> {
    let root = relationships(&[(MODEL, "/3D/3dmodel.model")]);
    let own: [(&str, &[u8]); 2] = [(ROOT_RELATIONSHIPS, root.as_bytes()), (ROOT, model.as_bytes())];
    package(&[&own[..], others].concat())
}

fn file(model: &str) -> Vec<u8> {
    file_with(model, &[])
}

/// The text of a model part; `attributes` are added to its root element.
fn model(attributes: &str, resources: &str, build: &str) -> String {
    format!(
        "<?xml version=\"1.0\" encoding=\"UTF-8\"?><model xmlns=\"http://schemas.microsoft.com/3dmanufacturing/core/2015/02\" xmlns:m=\"http://schemas.microsoft.com/3dmanufacturing/material/2015/02\" xmlns:p=\"http://schemas.microsoft.com/3dmanufacturing/production/2015/06\" {attributes}><resources>{resources}</resources><build>{build}</build></model>"
    )
}

/// A file with one object; the arguments add attributes to the root and the object, and resources before the object.
fn simple(attributes: &str, resources: &str, object: &str, mesh: &str) -> Vec<u8> {
    let resources = format!("{resources}<object id=\"100\" {object}>{mesh}</object>");
    file(&model(attributes, &resources, "<item objectid=\"100\"/>"))
}

#[track_caller]
fn scene_of(bytes: &[u8]) -> ReadScene {
    match read_scene(bytes, &ReadOptions::default()) {
        Ok(file) => {
            assert_eq!((file.format, file.dialect.as_str()), (Format::ThreeMf, "3MF"));
            file
        }
        Err(error) => panic!("{error}"),
    }
}

/// Reads a file and asserts that there are no warnings.
#[track_caller]
fn clean(bytes: &[u8]) -> ReadScene {
    let file = scene_of(bytes);
    assert_eq!(file.warnings, Vec::<String>::new());
    file
}

#[track_caller]
fn assert_no(bytes: &[u8], kind: ReadErrorKind, words: &str) {
    match read_scene(bytes, &ReadOptions::default()) {
        Ok(file) => panic!("was read: {:?}", file.scene),
        Err(error) => {
            assert_eq!(error.kind, kind, "{error}");
            assert!(error.detail.contains(words), "'{error}' does not say '{words}'");
        }
    }
}

/// The only mesh.
fn mesh(file: &ReadScene) -> &PaintedMesh {
    let mut meshes = file.scene.objects.iter().filter_map(|object| object.mesh());
    let mesh = meshes.next().unwrap();
    assert!(meshes.next().is_none());
    mesh
}
