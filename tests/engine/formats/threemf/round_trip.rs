//! Scenes that are written as 3MF and read again are the same.

use std::sync::Arc;

use glam::{DAffine3, DMat3, DVec3};
use meshmend::format::{Format, WriteError, read, write, write_scene};
use meshmend::mesh::Soup;
use meshmend::scene::{
    Component, Item, Material, Note, Object, ObjectKind, PAINTLESS, Paint, PaintedMesh, Palette, Scene, Shape, Texture,
    Unit, Up, Wrap,
};
use proptest::prelude::*;

use super::{clean, scene_of};

fn coordinate() -> impl Strategy<Value = f64> + Clone {
    prop_oneof![
        (prop::num::f32::NORMAL | prop::num::f32::ZERO | prop::num::f32::NEGATIVE).prop_map(f64::from),
        prop::num::f64::NORMAL | prop::num::f64::SUBNORMAL | prop::num::f64::ZERO | prop::num::f64::NEGATIVE,
    ]
}

fn transform() -> impl Strategy<Value = DAffine3> {
    let turned = (0.1..3.0_f64, 0.0..6.0_f64, any::<bool>(), [coordinate(), coordinate(), coordinate()]);
    let turned = turned.prop_map(|(scale, angle, mirrored, translation)| {
        let sides = if mirrored { DVec3::new(-scale, scale, scale) } else { DVec3::splat(scale) };
        DAffine3 {
            matrix3: DMat3::from_rotation_z(angle) * DMat3::from_diagonal(sides),
            translation: translation.into(),
        }
    });
    prop_oneof![Just(DAffine3::IDENTITY), turned]
}

/// Palettes of each kind; the textured one uses the scene's first texture.
fn palettes() -> Vec<Palette> {
    let material = |name: &str, color| Material { name: name.to_owned(), color };
    vec![
        Palette::Materials(vec![material("", [1, 2, 3, 255]), material("<PLA> & \"more\"", [9, 8, 7, 6])]),
        Palette::Colors(vec![[0, 0, 0, 255], [255, 254, 253, 0], [1, 1, 1, 1]]),
        Palette::Textured { texture: 0, name: None, tint: [255; 4], places: vec![[0.0, 1.0], [0.125, -3.5]] },
    ]
}

fn textures() -> Vec<Texture> {
    let texture = |bytes: &[u8], media_type: &str, wrap_u, nearest| Texture {
        bytes: Arc::from(bytes),
        media_type: media_type.to_owned(),
        wrap_u,
        wrap_v: Wrap::Repeat,
        nearest,
    };
    vec![texture(b"one", "image/png", Wrap::Clamp, false), texture(b"two", "image/jpeg", Wrap::Mirror, true)]
}

fn paint() -> impl Strategy<Value = Paint> {
    prop_oneof![
        Just(PAINTLESS),
        (0..2_u32).prop_map(|at| Paint { palette: 0, at: [at; 3] }),
        [0..3_u32, 0..3, 0..3].prop_map(|at| Paint { palette: 1, at }),
        [0..2_u32, 0..2, 0..2].prop_map(|at| Paint { palette: 2, at }),
    ]
}

fn painted_mesh() -> impl Strategy<Value = PaintedMesh> {
    let positions =
        prop::collection::vec([coordinate(), coordinate(), coordinate()].prop_map(DVec3::from_array), 1..12);
    (positions, 0..3_u8).prop_flat_map(|(positions, painted)| {
        let vertex = 0..positions.len() as u32;
        let face = [vertex.clone(), vertex.clone(), vertex];
        prop::collection::vec((face, paint()), 1..12).prop_map(move |faces| {
            let mut paint: Vec<Paint> = match painted {
                0 => Vec::new(),
                1 => vec![faces[0].1; faces.len()],
                _ => faces.iter().map(|face| face.1).collect(),
            };
            if paint.iter().all(|&paint| paint == PAINTLESS) {
                paint.clear();
            }
            PaintedMesh {
                soup: Soup { positions: positions.clone(), faces: faces.iter().map(|face| face.0).collect() },
                paint,
            }
        })
    })
}

fn notes(words: &'static str) -> impl Strategy<Value = Vec<Note>> {
    let note = (0..4_usize, words, any::<bool>(), any::<bool>()).prop_map(|(which, value, typed, preserve)| {
        let (name, namespace) =
            [("Designer", None), ("v:key", Some("urn:v")), ("Own", None), ("w:3.x", Some("urn:w&\""))][which];
        let kind = typed.then(|| "xs:string".to_owned());
        Note { name: name.to_owned(), namespace: namespace.map(str::to_owned), value, kind, preserve }
    });
    prop::collection::vec(note, 0..3).prop_map(|mut notes| {
        notes.sort_by(|a, b| a.name.cmp(&b.name));
        notes.dedup_by(|a, b| a.name == b.name);
        notes
    })
}

/// Scenes whose first item is a mesh; names and notes are made of `words`.
fn scenes(words: &'static str) -> impl Strategy<Value = Scene> {
    let kind = prop::sample::select(vec![
        ObjectKind::Model,
        ObjectKind::SolidSupport,
        ObjectKind::Support,
        ObjectKind::Surface,
    ]);
    let name = || prop::option::of(words);
    let parts = prop::collection::vec((any::<prop::sample::Index>(), transform()), 1..3);
    let object = (painted_mesh(), prop::option::of(parts), name(), name(), kind, notes(words));
    let item = (any::<prop::sample::Index>(), transform(), name(), name(), notes(words));
    let unit = prop::sample::select(Unit::ALL.to_vec());
    (prop::collection::vec(object, 1..5), prop::collection::vec(item, 0..4), unit, notes(words)).prop_map(
        |(objects, items, unit, notes)| {
            let count = objects.len();
            let object = |(number, (mesh, parts, name, part_number, kind, notes)): (usize, _)| {
                let parts: Option<Vec<(prop::sample::Index, DAffine3)>> = parts;
                let shape = match parts.filter(|_| number > 0) {
                    Some(parts) => {
                        let part = |(of, transform): (prop::sample::Index, _)| Component {
                            object: of.index(number) as u32,
                            transform,
                        };
                        Shape::Components(parts.into_iter().map(part).collect())
                    }
                    None => Shape::Mesh(mesh),
                };
                Object { name, part_number, kind, shape, notes }
            };
            let item = |(of, transform, name, part_number, notes): (prop::sample::Index, _, _, _, _)| Item {
                object: of.index(count) as u32,
                transform,
                name,
                part_number,
                notes,
            };
            Scene {
                unit: Some(unit),
                up: Some(Up::Z),
                objects: objects.into_iter().enumerate().map(object).collect(),
                items: [Item::of(0)].into_iter().chain(items.into_iter().map(item)).collect(),
                palettes: palettes(),
                textures: textures(),
                notes,
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn a_scene_comes_back_as_it_was(scene in scenes("[a-zA-Z<>&\"' \t\n\r\u{1F600}é]{1,12}")) {
        let bytes = write_scene(&scene, Format::ThreeMf).unwrap();
        let again = clean(&bytes).scene;
        prop_assert_eq!(&again, &scene);
        prop_assert_eq!(write_scene(&again, Format::ThreeMf).unwrap(), bytes);
    }

    #[test]
    fn a_scene_with_any_text_is_written_the_same_again(scene in scenes("\\PC{0,6}|[\u{0}-\u{20}]{0,4}|:|xml")) {
        let bytes = write_scene(&scene, Format::ThreeMf).unwrap();
        let again = clean(&bytes).scene;
        prop_assert_eq!(again.objects.len(), scene.objects.len());
        prop_assert_eq!(write_scene(&again, Format::ThreeMf).unwrap(), bytes);
    }
}

fn triangle() -> Soup {
    Soup { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], faces: vec![[0, 1, 2]] }
}

#[test]
fn a_mesh_keeps_its_indices_and_every_bit() {
    let mut soup = triangle();
    soup.positions[1] = DVec3::new(0.1, f64::MIN_POSITIVE / 4.0, -f64::MAX);
    soup.positions[2].x = -0.0;
    let bytes = write(&soup, Format::ThreeMf).unwrap();
    let again = read(&bytes, &meshmend::format::Limits::default()).unwrap();
    let bits = |soup: &Soup| soup.positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect::<Vec<_>>();
    assert_eq!((bits(&again.soup), &again.soup.faces), (bits(&soup), &soup.faces));
    assert_eq!(write(&soup, Format::ThreeMf).unwrap(), bytes);
}

#[test]
fn non_finite_numbers_are_not_written() {
    let mut soup = triangle();
    soup.positions[1].y = f64::NAN;
    assert_eq!(write(&soup, Format::ThreeMf), Err(WriteError::NotFinite));
    let mut scene = Scene::of_mesh(PaintedMesh { soup: triangle(), paint: Vec::new() });
    scene.items[0].transform.translation.x = f64::INFINITY;
    assert_eq!(write_scene(&scene, Format::ThreeMf), Err(WriteError::NotFinite));
}

#[test]
fn properties_that_3mf_cannot_express_are_left_out() {
    let paint = |palette| Paint { palette, at: [0; 3] };
    let mut soup = triangle();
    soup.faces = vec![[0, 1, 2]; 4];
    let mesh = PaintedMesh { soup, paint: vec![paint(0), paint(1), paint(2), paint(3)] };
    let mut scene = Scene::of_mesh(mesh);
    scene.textures = textures();
    scene.textures[0].media_type = "image/webp".to_owned();
    let textured = |texture| Palette::Textured {
        texture,
        name: Some("x".to_owned()),
        tint: [1; 4],
        places: vec![[f64::NAN, 2.0]],
    };
    scene.palettes = vec![textured(0), Palette::Colors(Vec::new()), textured(1), Palette::Colors(vec![[1, 2, 3, 255]])];
    scene.objects[0].kind = ObjectKind::Other;
    scene.items.push(Item::of(7));
    let bytes = write_scene(&scene, Format::ThreeMf).unwrap();
    let again = scene_of(&bytes).scene;
    let places = vec![[0.0, 2.0]];
    let left = Palette::Textured { texture: 0, name: None, tint: [255; 4], places };
    assert_eq!(again.palettes, [left, Palette::Colors(vec![[1, 2, 3, 255]])]);
    assert_eq!(again.objects[0].mesh().unwrap().paint, [PAINTLESS, PAINTLESS, paint(0), paint(1)]);
    assert_eq!((again.objects[0].kind, again.items.len()), (ObjectKind::Model, 1));
    assert_eq!(write_scene(&again, Format::ThreeMf).unwrap(), bytes);
}

#[test]
fn two_namespaces_that_want_one_prefix_get_two() {
    let note = |name: &str, namespace: Option<&str>| Note {
        name: name.to_owned(),
        namespace: namespace.map(str::to_owned),
        value: String::new(),
        kind: None,
        preserve: false,
    };
    let mut scene = Scene::of_mesh(PaintedMesh { soup: triangle(), paint: Vec::new() });
    scene.notes = vec![
        note("v:a", Some("urn:1")),
        note("v:a", Some("urn:2")),
        note("m:a", Some("urn:3")),
        note("a b", None),
        note("a b", None),
    ];
    let bytes = write_scene(&scene, Format::ThreeMf).unwrap();
    let again = clean(&bytes).scene;
    let names: Vec<_> = again.notes.iter().map(|note| (note.name.as_str(), note.namespace.as_deref())).collect();
    assert_eq!(names, [("v:a", Some("urn:1")), ("n1:a", Some("urn:2")), ("n2:a", Some("urn:3")), ("a_b", None)]);
    assert_eq!(write_scene(&again, Format::ThreeMf).unwrap(), bytes);
}
