//! `lib3mf`, the reference implementation of 3MF, reads the files that we write.

use std::process::Command;

use glam::{DAffine3, DVec3};
use meshmend::format::{Format, write_scene};
use meshmend::mesh::Soup;
use meshmend::scene::{
    Component, Item, Material, Note, Object, PAINTLESS, Paint, PaintedMesh, Palette, Scene, Shape, Texture, Unit, Up,
    Wrap,
};

/// Reads a file in strict mode, in which every warning is an error.
const SCRIPT: &str = "
import sys, lib3mf
model = lib3mf.get_wrapper().CreateModel()
reader = model.QueryReader('3mf')
reader.SetStrictModeActive(True)
reader.ReadFromFile(sys.argv[1])
meshes, faces, closed = model.GetMeshObjects(), 0, True
while meshes.MoveNext():
    mesh = meshes.GetCurrentMeshObject()
    faces += mesh.GetTriangleCount()
    closed &= mesh.IsManifoldAndOriented()
items, count = model.GetBuildItems(), 0
while items.MoveNext():
    count += 1
print(reader.GetWarningCount(), model.GetObjects().Count(), faces, count, int(closed), int(model.GetUnit()),
      model.GetColorGroups().Count(), model.GetBaseMaterialGroups().Count(), model.GetTexture2DGroups().Count(),
      model.GetMetaDataGroup().GetMetaDataCount())
";

fn scene() -> Scene {
    let soup = Soup {
        positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    };
    let painted = |palette, at| Paint { palette, at };
    let partly = vec![PAINTLESS, painted(0, [1; 3]), painted(1, [0, 1, 2]), painted(2, [0, 1, 1])];
    let object = |name: &str, paint| Object::of_mesh(Some(name.to_owned()), PaintedMesh { soup: soup.clone(), paint });
    let mut pair = object("a pair", Vec::new());
    let up = DAffine3::from_translation(DVec3::new(0.0, 0.0, 2.5));
    pair.shape =
        Shape::Components([DAffine3::IDENTITY, up].map(|transform| Component { object: 1, transform }).to_vec());
    let material = |name: &str, color| Material { name: name.to_owned(), color };
    let note = |name: &str, namespace: Option<&str>| Note {
        name: name.to_owned(),
        namespace: namespace.map(str::to_owned),
        value: "a & b".to_owned(),
        kind: Some("xs:string".to_owned()),
        preserve: true,
    };
    let picture = Texture {
        bytes: b"\x89PNG\r\n\x1A\n".as_slice().into(),
        media_type: "image/png".to_owned(),
        wrap_u: Wrap::Clamp,
        wrap_v: Wrap::Mirror,
        nearest: true,
    };
    let item = Item { transform: up, name: Some("upper".to_owned()), part_number: Some("7".to_owned()), ..Item::of(2) };
    Scene {
        unit: Some(Unit::Inch),
        up: Some(Up::Z),
        objects: vec![object("partly <painted>", partly), object("painted", vec![painted(0, [0; 3]); 4]), pair],
        items: vec![Item::of(0), item, Item::of(1)],
        palettes: vec![
            Palette::Materials(vec![material("PLA", [255, 0, 0, 255]), material("ABS", [0, 0, 255, 128])]),
            Palette::Colors(vec![[255, 255, 255, 255], [1, 2, 3, 255], [9, 9, 9, 9]]),
            Palette::Textured { texture: 0, name: None, tint: [255; 4], places: vec![[0.0, 0.0], [0.5, 1.0]] },
        ],
        textures: vec![picture],
        notes: vec![note("Title", None), note("Region", None), note("v:key", Some("urn:v"))],
    }
}

#[test]
#[ignore = "needs a Python with lib3mf, which MESHMEND_LIB3MF_PYTHON names"]
fn lib3mf_reads_what_is_written_without_a_warning() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.3mf");
    std::fs::write(&path, write_scene(&scene(), Format::ThreeMf).unwrap()).unwrap();
    let python = std::env::var("MESHMEND_LIB3MF_PYTHON").unwrap();
    let output = Command::new(python).args(["-c", SCRIPT]).arg(&path).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(String::from_utf8_lossy(&output.stdout).trim(), "0 3 8 3 1 3 1 1 1 3");
}
