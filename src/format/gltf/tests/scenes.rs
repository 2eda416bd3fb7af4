//! Reading scenes: nodes, transforms, materials, colours and textures.

use glam::DVec3;
use serde_json::{Value, json};

use super::super::super::ReadErrorKind;
use super::{F32, Model, U8, U16, floats, shorts};
use crate::scene::{Material, Paint, Palette, Scene, Unit, Up, Wrap};

fn of_nodes(nodes: Value) -> Model {
    Model::tetrahedron().with("/nodes", nodes)
}

/// The placed corner (1, 2, 3) of each item.
fn corners(model: &Model) -> Vec<DVec3> {
    let scene = model.read().scene;
    scene.items.iter().map(|item| item.transform.transform_point3(DVec3::new(1.0, 2.0, 3.0))).collect()
}

#[test]
fn coordinates_are_kept_and_the_scene_has_y_up() {
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
    // (1, 2, 3), doubled in x, rotated about z, and translated.
    let [corner] = corners(&model)[..] else { panic!("one item") };
    assert!(corner.abs_diff_eq(DVec3::new(8.0, 2.0, 3.0), 1e-12), "{corner}");
    assert_eq!(model.read().scene.items[0].name.as_deref(), Some("leaf"));
    let matrix = json!([2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0, 5, 6, 7, 1]);
    assert_eq!(corners(&of_nodes(json!([{ "mesh": 0, "matrix": matrix }]))), [DVec3::new(7.0, 12.0, 19.0)]);
}

#[test]
fn a_mesh_with_several_nodes_is_one_object_and_items_are_depth_first() {
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
fn the_first_scene_is_the_default_and_without_scenes_all_roots_are_read() {
    let nodes =
        json!([{ "mesh": 0, "name": "x", "children": [1] }, { "mesh": 0, "name": "y" }, { "mesh": 0, "name": "z" }]);
    assert_eq!(of_nodes(nodes.clone()).read().scene.items.len(), 3);
    let first = of_nodes(nodes).with("/scenes", json!([{ "nodes": [2] }, { "nodes": [0] }]));
    assert_eq!(first.read().scene.items[0].name.as_deref(), Some("z"));
}

#[test]
fn nodes_that_form_no_tree_are_rejected() {
    for (nodes, words) in [
        (json!([{ "mesh": 0, "children": [0] }]), "own ancestors"),
        (json!([{ "mesh": 0, "children": [1] }, { "children": [2] }, { "children": [1] }]), "two parents"),
        (json!([{ "mesh": 0 }, { "children": [2] }, { "children": [1] }]), "own ancestors"),
        (json!([{ "mesh": 0, "children": [1, 1] }, {}]), "two parents"),
        (json!([{ "mesh": 0, "children": [7] }]), "node 7, but has only 1"),
        (json!([{ "mesh": 9 }]), "mesh 9, but has only 1"),
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
fn nodes_may_be_nested_to_any_depth() {
    let mut nodes: Vec<Value> =
        (1..100_000).map(|child| json!({ "children": [child], "translation": [0, 0, -1] })).collect();
    nodes.push(json!({ "mesh": 0 }));
    assert_eq!(corners(&of_nodes(nodes.into())), [DVec3::new(1.0, 2.0, -99_996.0)]);
}

#[test]
fn a_million_nodes_without_a_mesh_are_read_and_more_are_rejected() {
    let of = |count: usize| {
        let mut model = Model::empty();
        model.json["nodes"] = vec![json!({}); count].into();
        model
    };
    of(1 << 20).assert_refused(ReadErrorKind::NoFaces, "no mesh");
    of((1 << 20) + 1).assert_refused(ReadErrorKind::TooLarge, "more than 1048576");
}

#[test]
fn nodes_with_a_scale_of_zero_are_dropped() {
    let read = of_nodes(json!([{ "mesh": 0, "scale": [0, 0, 0] }, { "mesh": 0, "scale": [-1, 1, 1] }])).read();
    assert_eq!(read.scene.items.len(), 1);
    assert_eq!(read.scene.items[0].transform.matrix3.x_axis, -DVec3::X);
    assert!(read.warnings[0].contains("scale of zero were dropped: 1"), "{:?}", read.warnings);
}

#[test]
fn a_scene_without_triangles_is_rejected() {
    of_nodes(json!([])).assert_refused(ReadErrorKind::NoFaces, "scene shows no triangles");
    let dots = Model::tetrahedron().with("/meshes/0/primitives/0/mode", json!(0));
    dots.assert_refused(ReadErrorKind::NoFaces, "points or lines");
}

const PNG: &[u8] = b"\x89PNG\r\n\x1A\n and what follows";

/// The corner colours of a face.
fn colors(scene: &Scene, face: usize) -> [[u8; 4]; 3] {
    let Paint { palette, at } = scene.objects[0].mesh().expect("a mesh").paint[face];
    let Palette::Colors(colors) = &scene.palettes[palette as usize] else { panic!("{:?}", scene.palettes) };
    at.map(|at| colors[at as usize])
}

fn with_attribute(name: &str, bytes: &[u8], component: u32, shape: &str) -> Model {
    let mut model = Model::tetrahedron();
    let accessor = model.accessor(bytes, component, shape, 4);
    model.json["accessors"][accessor]["normalized"] = json!(component != F32);
    model.json["meshes"][0]["primitives"][0]["attributes"][name] = accessor.into();
    model
}

/// A textured tetrahedron with these texture coordinates.
fn with_picture(places: &[f32; 8], picture: &[u8]) -> Model {
    let mut model = with_attribute("TEXCOORD_0", &floats(places), F32, "VEC2");
    let view = model.view(picture);
    model.json["images"] = json!([{ "bufferView": view, "mimeType": "image/png" }]);
    model.json["samplers"] = json!([{ "magFilter": 9728, "wrapS": 33071, "wrapT": 33648 }]);
    model.json["textures"] = json!([{ "sampler": 0, "source": 0 }]);
    model.json["materials"] = json!([{
        "name": "skin",
        "pbrMetallicRoughness": { "baseColorTexture": { "index": 0 }, "baseColorFactor": [1, 0.2122, 0, 0.5] },
    }]);
    model.with("/meshes/0/primitives/0/material", json!(0))
}

#[test]
fn faces_without_material_or_colours_are_not_painted() {
    let scene = Model::tetrahedron().read().scene;
    assert!(scene.palettes.is_empty() && scene.objects[0].mesh().expect("a mesh").paint.is_empty());
}

#[test]
fn a_material_is_kept_by_name_and_colour() {
    let material = |alpha: &str| json!([{ "name": "red", "alphaMode": alpha, "pbrMetallicRoughness": { "baseColorFactor": [1, 0, 0.2122, 0.5] } }]);
    for (mode, alpha) in [("OPAQUE", 255), ("BLEND", 128)] {
        let model =
            Model::tetrahedron().with("/materials", material(mode)).with("/meshes/0/primitives/0/material", json!(0));
        let scene = model.read().scene;
        let expected = Material { name: "red".to_owned(), color: [255, 0, 127, alpha] };
        assert_eq!(scene.palettes, [Palette::Materials(vec![expected])]);
        assert_eq!(scene.objects[0].mesh().expect("a mesh").paint, [Paint { palette: 0, at: [0; 3] }; 4]);
    }
}

#[test]
fn specular_glossiness_materials_have_their_diffuse_colour() {
    let old =
        json!({ "KHR_materials_pbrSpecularGlossiness": { "diffuseFactor": [0, 1, 0, 1], "glossinessFactor": 0 } });
    let model = Model::tetrahedron()
        .with("/materials", json!([{ "extensions": old }]))
        .with("/meshes/0/primitives/0/material", json!(0));
    let expected = Material { name: String::new(), color: [0, 255, 0, 255] };
    assert_eq!(model.read().scene.palettes, [Palette::Materials(vec![expected])]);
}

#[test]
fn vertex_colours_are_converted_to_srgb_and_multiplied_with_the_material() {
    let half = 0.2122_f32;
    let four: Vec<f32> = [[1.0, 0.0, half], [half; 3], [0.0; 3], [1.0; 3]].concat();
    let scene = with_attribute("COLOR_0", &floats(&four), F32, "VEC3").read().scene;
    assert_eq!(colors(&scene, 0), [[255, 0, 127, 255], [0, 0, 0, 255], [127, 127, 127, 255]]);

    let bytes: Vec<u8> = [[255, 0, 55, 128], [255; 4], [0; 4], [255; 4]].concat();
    let tinted = with_attribute("COLOR_0", &bytes, U8, "VEC4")
        .with(
            "/materials",
            json!([{ "alphaMode": "BLEND", "pbrMetallicRoughness": { "baseColorFactor": [1, 1, 0, 0.5] } }]),
        )
        .with("/meshes/0/primitives/0/material", json!(0));
    assert_eq!(colors(&tinted.read().scene, 1), [[255, 0, 0, 64], [255, 255, 0, 128], [255, 255, 0, 128]]);

    let wide: Vec<u16> = [[65535, 0, 13907, 0], [0; 4], [0; 4], [0; 4]].concat();
    let scene = with_attribute("COLOR_0", &shorts(&wide), U16, "VEC4").read().scene;
    assert_eq!(colors(&scene, 0)[0], [255, 0, 127, 255], "opaque without a material that blends");
}

#[test]
fn a_texture_is_kept_with_its_origin_in_the_lower_left_corner() {
    let read = with_picture(&[0.0, 0.0, 1.0, 0.25, 0.5, -1.0, 0.0, 1.0], PNG).read();
    let scene = read.scene;
    let [Palette::Textured { texture: 0, name, tint, places }] = &scene.palettes[..] else {
        panic!("{:?}", scene.palettes)
    };
    assert_eq!((name.as_deref(), tint), (Some("skin"), &[255, 127, 0, 255]));
    assert_eq!(places[..], [[0.0, 1.0], [1.0, 0.75], [0.5, 2.0], [0.0, 0.0]]);
    let texture = &scene.textures[0];
    assert_eq!((&texture.bytes[..], texture.media_type.as_str()), (PNG, "image/png"));
    assert_eq!((texture.wrap_u, texture.wrap_v, texture.nearest), (Wrap::Clamp, Wrap::Mirror, true));
    assert_eq!(scene.objects[0].mesh().expect("a mesh").paint[1], Paint { palette: 0, at: [0, 1, 3] });
    assert_eq!(read.warnings, Vec::<String>::new());
}

#[test]
fn texture_coordinates_are_transformed_by_the_material() {
    let transform = json!({ "KHR_texture_transform": { "offset": [0.5, 0.25], "rotation": std::f64::consts::FRAC_PI_2, "scale": [2, 4] } });
    let model = with_picture(&[0.0, 0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0], PNG)
        .with("/materials/0/pbrMetallicRoughness/baseColorTexture/extensions", transform);
    let scene = model.read().scene;
    let Palette::Textured { places, .. } = &scene.palettes[0] else { panic!("{:?}", scene.palettes) };
    // After a quarter turn, u runs up the texture with scale 2, v to the right with scale 4.
    for (found, expected) in places.iter().zip([[0.5, 0.75], [0.5, 2.75], [4.5, 0.75]]) {
        assert!((found[0] - expected[0]).abs() < 1e-9 && (found[1] - expected[1]).abs() < 1e-9, "{places:?}");
    }
}

#[test]
fn the_material_selects_the_texture_coordinate_set() {
    let mut model = with_picture(&[0.0; 8], PNG);
    let second = model.accessor(&shorts(&[65535, 0, 0, 0, 0, 0, 0, 0]), U16, "VEC2", 4);
    model.json["accessors"][second]["normalized"] = json!(true);
    model.json["meshes"][0]["primitives"][0]["attributes"]["TEXCOORD_1"] = second.into();
    model.json["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"]["texCoord"] = json!(1);
    let scene = model.read().scene;
    let Palette::Textured { places, .. } = &scene.palettes[0] else { panic!("{:?}", scene.palettes) };
    assert_eq!(places[0], [1.0, 1.0]);
}

#[test]
fn a_texture_takes_precedence_over_vertex_colours_with_a_warning() {
    let mut model = with_picture(&[0.0; 8], PNG);
    let colors = model.accessor(&[255; 16], U8, "VEC4", 4);
    model.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] = colors.into();
    let read = model.read();
    assert!(matches!(read.scene.palettes[..], [Palette::Textured { .. }]));
    assert!(read.warnings[0].contains("kept only the texture"), "{:?}", read.warnings);
}

#[test]
fn a_texture_that_cannot_be_kept_leaves_the_material_with_a_warning() {
    let elsewhere = with_picture(&[0.0; 8], PNG).with("/images", json!([{ "uri": "skin.png" }]));
    let webp = with_picture(&[0.0; 8], b"RIFF....WEBP");
    let by_extension = with_picture(&[0.0; 8], PNG).with("/textures", json!([{ "extensions": {} }]));
    for model in [elsewhere, webp, by_extension] {
        let read = model.read();
        let expected = Material { name: "skin".to_owned(), color: [255, 127, 0, 255] };
        assert_eq!(read.scene.palettes, [Palette::Materials(vec![expected])]);
        assert!(read.warnings[0].contains("dropped: 1"), "{:?}", read.warnings);
    }
}

#[test]
fn other_textures_are_dropped_with_one_warning() {
    let model = with_picture(&[0.0; 8], PNG)
        .with("/materials/0/normalTexture", json!({ "index": 0 }))
        .with("/materials/0/emissiveTexture", json!({ "index": 0 }));
    let read = model.read();
    assert_eq!((read.scene.textures.len(), read.warnings.len()), (1, 1));
    assert!(read.warnings[0].contains("roughness"), "{:?}", read.warnings);
}

#[test]
fn a_texture_in_a_data_uri_is_kept() {
    let model = with_picture(&[0.0; 8], PNG).with("/images", json!([{ "uri": "data:image/jpeg;base64,/9j/4A==" }]));
    let scene = model.read().scene;
    assert_eq!(
        (&scene.textures[0].bytes[..], scene.textures[0].media_type.as_str()),
        (&b"\xFF\xD8\xFF\xE0"[..], "image/jpeg")
    );
}
