use glam::DVec3;
use serde_json::json;

use super::super::super::ReadErrorKind;
use super::{F32, Model, U8, floats};

fn positions(model: &Model) -> Vec<DVec3> {
    model.read().scene.objects[0].mesh().expect("a mesh").soup.positions.clone()
}

#[test]
fn a_mesh_morphs_as_far_as_its_weights_say() {
    let mut model = Model::tetrahedron();
    let shifts = model.accessor(&floats(&[1.0; 12]), F32, "VEC3", 4);
    model.json["meshes"][0]["primitives"][0]["targets"] = json!([{ "NORMAL": 9 }, { "POSITION": shifts }]);
    assert_eq!(positions(&model)[1], DVec3::X, "at rest without weights");
    assert!(model.read().warnings[0].contains("rest pose"));
    let model = model.with("/meshes/0/weights", json!([1, 0.5]));
    assert_eq!(positions(&model)[1], DVec3::new(1.5, 0.5, 0.5));
    // A node may say otherwise, and then shows another object.
    let model = model
        .with("/nodes", json!([{ "mesh": 0 }, { "mesh": 0, "weights": [0, 2] }, { "mesh": 0, "weights": [1, 0.5] }]));
    let scene = model.read().scene;
    assert_eq!(scene.objects.len(), 2);
    assert_eq!(scene.items.iter().map(|item| item.object).collect::<Vec<_>>(), [0, 1, 0]);
    assert_eq!(scene.objects[1].mesh().expect("a mesh").soup.positions[0], DVec3::splat(2.0));
}

/// A tetrahedron whose corners hang on two joints: the last one on the second, the third on both.
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
fn a_skinned_mesh_stands_where_its_joints_hold_it_wherever_its_node_is() {
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
fn skins_that_lack_something_are_refused() {
    for (pointer, value, words) in [
        ("/skins/0/joints", json!([1]), "joint 1, and its skin has 1"),
        ("/skins/0/joints", json!([1, 2, 0]), "each of its joints"),
        ("/skins/0/joints", json!([]), "no joints"),
        ("/skins/0/joints", json!([1, 7]), "node 7"),
        ("/skins/0/inverseBindMatrices", json!(0), "each of its joints"),
        ("/nodes/0/skin", json!(3), "skin 3"),
        ("/accessors/3/count", json!(2), "WEIGHTS_0 for 2"),
    ] {
        skinned().with(pointer, value).assert_refused(ReadErrorKind::Malformed, words);
    }
}
