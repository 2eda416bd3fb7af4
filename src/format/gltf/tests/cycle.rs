//! Writing and reading random scenes, and scenes that glTF cannot store.

use std::sync::Arc;

use glam::{DAffine3, DVec3};
use proptest::prelude::*;

use super::super::super::errors::WriteError;
use super::super::write;
use super::read;
use crate::mesh::Soup;
use crate::scene::{
    Component, Item, Material, Note, Object, ObjectKind, PAINTLESS, Paint, PaintedMesh, Palette, Scene, Shape, Texture,
    Unit, Up, Wrap,
};

fn texts() -> impl Strategy<Value = Option<String>> {
    prop::option::of("[a-zÄ\"\\\\ ]{0,6}")
}

fn colors() -> impl Strategy<Value = [u8; 4]> {
    prop_oneof![any::<[u8; 4]>(), any::<[u8; 3]>().prop_map(|[r, g, b]| [r, g, b, 255])]
}

/// Few palettes with few differences, so that some are equal.
fn palettes() -> impl Strategy<Value = Vec<Palette>> {
    let material = ("[ab]?", prop::sample::select(vec![[255; 4], [255, 0, 3, 128]]))
        .prop_map(|(name, color)| Material { name, color });
    let places = prop::collection::vec([-2.0..3.0, -2.0..3.0], 1..5);
    let palette = prop_oneof![
        prop::collection::vec(material, 1..5).prop_map(Palette::Materials),
        prop::collection::vec(colors(), 1..5).prop_map(Palette::Colors),
        (0..4_u32, texts(), colors(), places).prop_map(|(texture, name, tint, places)| Palette::Textured {
            texture,
            name,
            tint,
            places
        }),
    ];
    prop::collection::vec(palette, 0..5)
}

fn textures() -> impl Strategy<Value = Vec<Texture>> {
    let wraps = || prop::sample::select(vec![Wrap::Repeat, Wrap::Mirror, Wrap::Clamp, Wrap::None]);
    let bytes = prop::sample::select(vec![&b"\x89PNG\r\n\x1A\nx"[..], b"\xFF\xD8\xFF", b"no picture"]);
    let texture = (bytes, wraps(), wraps(), any::<bool>()).prop_map(|(bytes, wrap_u, wrap_v, nearest)| Texture {
        bytes: Arc::from(bytes),
        media_type: "image/png".to_owned(),
        wrap_u,
        wrap_v,
        nearest,
    });
    prop::collection::vec(texture, 0..3)
}

fn meshes() -> impl Strategy<Value = PaintedMesh> {
    let single = prop::num::f32::NORMAL.prop_map(f64::from);
    let position = (-9.0..9.0, -1e30..1e30, single).prop_map(|(x, y, z)| DVec3::new(x, y, z));
    let paint = (0..6_u32, [0..5_u32, 0..5, 0..5], 0..4).prop_map(|(palette, at, none)| match none {
        0 => PAINTLESS,
        _ => Paint { palette, at },
    });
    prop::collection::vec(position, 1..9).prop_flat_map(move |positions| {
        let vertex = 0..positions.len() as u32;
        let face = ([vertex.clone(), vertex.clone(), vertex], paint.clone());
        (prop::collection::vec(face, 0..12), any::<bool>()).prop_map(move |(faces, painted)| PaintedMesh {
            soup: Soup { positions: positions.clone(), faces: faces.iter().map(|(face, _)| *face).collect() },
            paint: if painted { faces.iter().map(|(_, paint)| *paint).collect() } else { Vec::new() },
        })
    })
}

fn transforms() -> impl Strategy<Value = DAffine3> {
    let any = prop::collection::vec(-4.0..4.0, 12).prop_map(|m| DAffine3 {
        matrix3: glam::DMat3::from_cols_slice(&m[..9]),
        translation: DVec3::from_slice(&m[9..]),
    });
    prop_oneof![Just(DAffine3::IDENTITY), Just(DAffine3::from_scale(DVec3::ZERO)), any]
}

fn notes() -> impl Strategy<Value = Vec<Note>> {
    let name = prop::sample::select(vec!["Title", "Copyright", "x:Note"]);
    let note =
        (name, texts(), "[a-z\n]{0,5}", texts(), any::<bool>()).prop_map(|(name, namespace, value, kind, preserve)| {
            Note { name: name.to_owned(), namespace, value, kind, preserve }
        });
    prop::collection::vec(note, 0..4)
}

fn scenes() -> impl Strategy<Value = Scene> {
    let kinds = || prop::sample::select(vec![ObjectKind::Model, ObjectKind::Support, ObjectKind::Other]);
    let components = prop::collection::vec((0..4_u32, transforms()), 0..3).prop_map(|parts| {
        Shape::Components(parts.into_iter().map(|(object, transform)| Component { object, transform }).collect())
    });
    let shape = prop_oneof![3 => meshes().prop_map(Shape::Mesh), 1 => components];
    let object = (texts(), texts(), kinds(), shape, notes())
        .prop_map(|(name, part_number, kind, shape, notes)| Object { name, part_number, kind, shape, notes });
    let item = (0..6_u32, transforms(), texts(), texts(), notes())
        .prop_map(|(object, transform, name, part_number, notes)| Item { object, transform, name, part_number, notes });
    let unit = prop::option::of(prop::sample::select(Unit::ALL.to_vec()));
    let objects = prop::collection::vec(object, 1..5);
    (unit, objects, prop::collection::vec(item, 1..5), palettes(), textures(), notes()).prop_map(
        |(unit, mut objects, items, palettes, textures, notes)| {
            for (index, object) in (0..).zip(&mut objects) {
                if let Shape::Components(parts) = &mut object.shape {
                    parts.retain(|part| part.object < index);
                }
            }
            Scene { unit, up: Some(Up::Y), objects, items, palettes, textures, notes }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(256))]

    #[test]
    fn reading_and_writing_a_written_file_reproduces_it(scene in scenes()) {
        let bytes = write(&scene).expect("few and finite");
        match read(&bytes) {
            Ok(read) => {
                prop_assert_eq!(&read.warnings, &Vec::<String>::new());
                let again = write(&read.scene).expect("as before");
                prop_assert!(again == bytes, "{}\n{}", String::from_utf8_lossy(&bytes), String::from_utf8_lossy(&again));
            }
            // No object with faces is placed.
            Err(error) => prop_assert_eq!(error.kind, super::super::super::ReadErrorKind::NoFaces),
        }
    }

    #[test]
    fn reading_a_written_file_gives_the_scene_in_metres(mut scene in scenes()) {
        // Unpainted faces keep their order, and instances scaled to zero are dropped.
        let nothing = |transform: &DAffine3| transform.matrix3 == glam::DMat3::ZERO;
        scene.items.retain(|item| !nothing(&item.transform));
        for object in &mut scene.objects {
            match &mut object.shape {
                Shape::Mesh(mesh) => mesh.paint.clear(),
                Shape::Components(parts) => parts.retain(|part| !nothing(&part.transform)),
            }
        }
        let Ok(read) = read(&write(&scene).expect("few and finite")) else { return Ok(()) };
        let metres = scene.unit.map_or(1.0, |unit| unit.to(Unit::Metre));
        for object in &mut scene.objects {
            if let Shape::Mesh(mesh) = &mut object.shape {
                mesh.soup.positions.iter_mut().for_each(|p| *p = p.as_vec3().as_dvec3());
            }
        }
        let corners = |scene: &Scene, scale: f64| {
            let soup = scene.placed(100_000).expect("few").soup;
            (0..soup.faces.len()).flat_map(|face| soup.corners(face)).map(|p| p * scale).collect::<Vec<_>>()
        };
        let (found, expected) = (corners(&read.scene, 1.0), corners(&scene, metres));
        prop_assert_eq!(found.len(), expected.len());
        let size = expected.iter().fold(0.0, |most: f64, p| most.max(p.abs().max_element()));
        for (a, b) in found.iter().zip(&expected) {
            prop_assert!(a.abs_diff_eq(*b, size * 1e-9), "{a} for {b}");
        }
    }
}

#[test]
fn endlessly_nested_objects_are_rejected() {
    let mesh = PaintedMesh { soup: Soup { positions: vec![DVec3::ZERO], faces: vec![[0; 3]] }, paint: Vec::new() };
    let mut scene = Scene::of_mesh(mesh);
    for below in 0..40 {
        let parts = vec![Component { object: below, transform: DAffine3::IDENTITY }; 2];
        scene.objects.push(Object { shape: Shape::Components(parts), ..Object::of_mesh(None, PaintedMesh::default()) });
    }
    scene.items = vec![Item::of(40)];
    assert_eq!(write(&scene), Err(WriteError::TooManyParts { parts: 1 << 40, max: 1 << 20 }));
    // An object that contains itself violates the scene's invariant and has no instances.
    scene.objects[40].shape = Shape::Components(vec![Component { object: 40, transform: DAffine3::IDENTITY }]);
    let bytes = write(&scene).expect("nothing to write");
    assert!(read(&bytes).is_err());
}

#[test]
fn scenes_that_gltf_cannot_store_are_rejected_or_changed() {
    let far = PaintedMesh { soup: Soup { positions: vec![DVec3::X * 1e39], faces: vec![[0; 3]] }, paint: Vec::new() };
    assert_eq!(write(&Scene::of_mesh(far)), Err(WriteError::OutOfRange { vertex: 0, value: 1e39 }));
    let mut scene = Scene::of_mesh(PaintedMesh {
        soup: Soup { positions: vec![DVec3::X], faces: vec![[0; 3]] },
        paint: Vec::new(),
    });
    scene.unit = Some(Unit::Inch);
    let read = read(&write(&scene).expect("small")).expect("sound").scene;
    assert_eq!((read.unit, read.items[0].transform), (Some(Unit::Metre), DAffine3::from_scale(DVec3::splat(0.0254))));
}
