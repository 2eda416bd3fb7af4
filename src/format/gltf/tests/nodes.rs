use glam::DVec3;
use serde_json::{Value, json};

use super::super::super::ReadErrorKind;
use super::Model;
use crate::scene::{Unit, Up};

fn of_nodes(nodes: Value) -> Model {
    Model::tetrahedron().with("/nodes", nodes)
}

/// Where the corner (1, 2, 3) of each item comes to.
fn corners(model: &Model) -> Vec<DVec3> {
    let scene = model.read().scene;
    scene.items.iter().map(|item| item.transform.transform_point3(DVec3::new(1.0, 2.0, 3.0))).collect()
}

#[test]
fn coordinates_are_kept_and_the_scene_says_that_y_is_up() {
    let scene = Model::tetrahedron().read().scene;
    assert_eq!((scene.unit, scene.up), (Some(Unit::Metre), Some(Up::Y)));
    let mesh = scene.objects[0].mesh().expect("a mesh");
    assert_eq!(mesh.soup.positions, [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z], "the object's own coordinates");
    assert_eq!(mesh.soup.faces, [[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]]);
    assert_eq!((scene.objects[0].name.as_deref(), &scene.items[0].name), (Some("body"), &None));
    let placed = scene.placed(4).expect("few faces").soup;
    assert_eq!(placed.positions, [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z]);
}

#[test]
fn transforms_of_ancestors_are_multiplied_in_order() {
    let half = 0.5_f32.sqrt();
    let model = of_nodes(json!([
        { "name": "top", "children": [1], "translation": [10, 0, 0] },
        { "children": [2], "rotation": [0, 0, half, half] },
        { "mesh": 0, "name": "leaf", "scale": [2, 1, 1] },
    ]));
    // (1, 2, 3), doubled in x, turned about z, and shifted.
    let [corner] = corners(&model)[..] else { panic!("one item") };
    assert!(corner.abs_diff_eq(DVec3::new(8.0, 2.0, 3.0), 1e-12), "{corner}");
    assert_eq!(model.read().scene.items[0].name.as_deref(), Some("leaf"));
    let matrix = json!([2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0, 5, 6, 7, 1]);
    assert_eq!(corners(&of_nodes(json!([{ "mesh": 0, "matrix": matrix }]))), [DVec3::new(7.0, 12.0, 19.0)]);
}

#[test]
fn a_mesh_in_several_places_is_one_object_and_items_are_in_depth_first_order() {
    let model = of_nodes(json!([
        { "mesh": 0, "name": "c" },
        { "mesh": 0, "name": "a", "children": [3, 2] },
        { "mesh": 0, "name": "b2" },
        { "mesh": 0, "name": "b1" },
        { "mesh": 0, "name": "not in the scene" },
    ]))
    .with("/scenes", json!([{ "nodes": [4] }, { "nodes": [1, 0] }]))
    .with("/scene", json!(1));
    let scene = model.read().scene;
    assert_eq!(scene.objects.len(), 1);
    let names: Vec<_> = scene.items.iter().map(|item| item.name.as_deref().unwrap_or_default()).collect();
    assert_eq!(names, ["a", "b1", "b2", "c"]);
}

#[test]
fn without_a_default_the_first_scene_is_read_and_without_scenes_all_roots() {
    let nodes =
        json!([{ "mesh": 0, "name": "x", "children": [1] }, { "mesh": 0, "name": "y" }, { "mesh": 0, "name": "z" }]);
    assert_eq!(of_nodes(nodes.clone()).read().scene.items.len(), 3);
    let first = of_nodes(nodes).with("/scenes", json!([{ "nodes": [2] }, { "nodes": [0] }]));
    assert_eq!(first.read().scene.items[0].name.as_deref(), Some("z"));
}

#[test]
fn nodes_that_are_no_tree_are_refused() {
    for (nodes, words) in [
        (json!([{ "mesh": 0, "children": [0] }]), "own ancestors"),
        (json!([{ "mesh": 0, "children": [1] }, { "children": [2] }, { "children": [1] }]), "two parents"),
        (json!([{ "mesh": 0 }, { "children": [2] }, { "children": [1] }]), "own ancestors"),
        (json!([{ "mesh": 0, "children": [1, 1] }, {}]), "two parents"),
        (json!([{ "mesh": 0, "children": [7] }]), "node 7, and there are 1"),
        (json!([{ "mesh": 9 }]), "mesh 9, and there are 1"),
        (json!([{ "mesh": 0, "rotation": [0, 0, 0, 0] }]), "rotation of node 0"),
        (json!([{ "mesh": 0, "matrix": [1, 0, 0, 1, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1] }]), "not affine"),
        (json!([{ "scale": [1e200, 1, 1], "children": [1] }, { "mesh": 0, "scale": [1e200, 1, 1] }]), "not finite"),
    ] {
        of_nodes(nodes).assert_refused(ReadErrorKind::Malformed, words);
    }
    let twice =
        of_nodes(json!([{ "mesh": 0, "children": [1] }, { "mesh": 0 }])).with("/scenes", json!([{ "nodes": [0, 1] }]));
    twice.assert_refused(ReadErrorKind::Malformed, "twice");
}

#[test]
fn no_depth_of_nodes_is_too_much() {
    let mut nodes: Vec<Value> =
        (1..100_000).map(|child| json!({ "children": [child], "translation": [0, 0, -1] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    assert_eq!(corners(&of_nodes(nodes.into())), [DVec3::new(1.0, 2.0, -99_996.0)]);
}

#[test]
fn a_million_nodes_without_a_mesh_are_read_and_more_are_refused() {
    let of = |count: usize| {
        let mut model = Model::empty();
        model.json["nodes"] = vec![json!({}); count].into();
        model
    };
    of(1 << 20).assert_refused(ReadErrorKind::NoFaces, "no mesh");
    of((1 << 20) + 1).assert_refused(ReadErrorKind::TooLarge, "more than 1048576");
}

#[test]
fn nodes_that_are_scaled_to_nothing_are_left_out() {
    let read = of_nodes(json!([{ "mesh": 0, "scale": [0, 0, 0] }, { "mesh": 0, "scale": [-1, 1, 1] }])).read();
    assert_eq!(read.scene.items.len(), 1);
    assert_eq!(read.scene.items[0].transform.matrix3.x_axis, -DVec3::X);
    assert!(read.warnings[0].contains("scaled to nothing were left out: 1"), "{:?}", read.warnings);
}

#[test]
fn a_scene_without_triangles_is_refused() {
    of_nodes(json!([])).assert_refused(ReadErrorKind::NoFaces, "scene shows no triangles");
    let dots = Model::tetrahedron().with("/meshes/0/primitives/0/mode", json!(0));
    dots.assert_refused(ReadErrorKind::NoFaces, "points or lines");
}
