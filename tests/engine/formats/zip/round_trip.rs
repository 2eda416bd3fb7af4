//! Scenes that are written as OBJ in a ZIP archive and read again look the same.

use std::io::{Cursor, Read};
use std::sync::Arc;

use glam::{DAffine3, DVec3};
use meshmend::format::{Format, write, write_scene};
use meshmend::mesh::Soup;
use meshmend::scene::{Item, Material, Object, PAINTLESS, Paint, PaintedMesh, Palette, Scene, Texture, Wrap};
use proptest::prelude::*;

use super::super::tetrahedron;
use super::{PNG, mesh};

const JPEG: &[u8] = b"\xFF\xD8\xFFrest";

/// The appearance of the corners of a face.
#[derive(Debug, Clone, PartialEq)]
enum Appearance {
    Nothing,
    Material(String, [u8; 4]),
    Colors([[u8; 4]; 3]),
    Picture { bytes: Vec<u8>, clamp: bool, name: String, tint: [u8; 4], places: [[f64; 2]; 3] },
}

fn appearance(scene: &Scene, paint: Paint) -> Appearance {
    let Some(palette) = scene.palettes.get(paint.palette as usize) else { return Appearance::Nothing };
    if paint.at.iter().any(|&at| at as usize >= palette.len()) {
        return Appearance::Nothing;
    }
    match palette {
        Palette::Materials(materials) => {
            let Material { name, color } = &materials[paint.at[0] as usize];
            Appearance::Material(name.clone(), *color)
        }
        Palette::Colors(_) => Appearance::Colors(palette.colors(paint.at).unwrap()),
        Palette::Textured { texture, name, tint, places } => {
            let name = name.clone().unwrap_or_default();
            match scene.textures.get(*texture as usize) {
                Some(texture) if texture.bytes.starts_with(&PNG[..4]) || texture.bytes.starts_with(&JPEG[..3]) => {
                    let ends = |wrap| matches!(wrap, Wrap::Clamp | Wrap::None);
                    Appearance::Picture {
                        bytes: texture.bytes.to_vec(),
                        clamp: ends(texture.wrap_u) && ends(texture.wrap_v),
                        name,
                        tint: *tint,
                        places: paint.at.map(|at| {
                            places[at as usize].map(|coordinate| if coordinate.is_finite() { coordinate } else { 0.0 })
                        }),
                    }
                }
                _ => Appearance::Material(name, *tint),
            }
        }
    }
}

/// Whether two appearances are the same as far as OBJ can express them: material names are single words made unique by
/// numbers, materials without a name are colours, and each vertex has one opaque colour.
fn is_expressed(found: &Appearance, expected: &Appearance) -> bool {
    let named = |found: &str, expected: &str| {
        let expected = expected.replace(' ', "_");
        let rest = found.strip_prefix(&expected);
        rest.is_some_and(|rest| rest.bytes().all(|c| c == b'_' || c.is_ascii_digit()))
    };
    match (found, expected) {
        (Appearance::Material(name, color), Appearance::Material(wanted, other)) => {
            color == other && named(name, wanted)
        }
        (Appearance::Colors(found), Appearance::Material(name, color)) => {
            (name.is_empty() || name == "color_FF0000") && *found == [*color; 3]
        }
        (Appearance::Colors(found), Appearance::Colors(colors)) if colors[0] == colors[1] && colors[1] == colors[2] => {
            found == colors
        }
        (Appearance::Colors(found), Appearance::Colors(colors)) => {
            let opaque = colors.map(|[r, g, b, _]| [r, g, b, 255]);
            *found == opaque || *found == [opaque[0]; 3]
        }
        (
            Appearance::Picture { bytes, clamp, name, tint, places },
            Appearance::Picture { bytes: b, clamp: c, name: n, tint: t, places: p },
        ) => (bytes, clamp, tint, places) == (b, c, t, p) && (n.is_empty() || named(name, n)),
        (found, expected) => found == expected,
    }
}

fn palettes() -> impl Strategy<Value = Vec<Palette>> {
    let name = prop::sample::select(vec!["", "a", "b c", "(null)", "a_2", "vertex_colors", "color_FF0000"]);
    let color = || {
        prop::sample::select(vec![
            [255, 0, 0, 255],
            [128, 128, 128, 255],
            [255; 4],
            [1, 2, 3, 255],
            [1, 2, 3, 4],
            [9, 9, 9, 77],
        ])
    };
    let material = (name.clone(), color()).prop_map(|(name, color)| Material { name: name.to_owned(), color });
    let place = (prop_oneof![-2.0..3.0, Just(f64::NAN)], -2.0..3.0).prop_map(|(u, v)| [u, v]);
    let places = prop::collection::vec(place, 1..5);
    let palette = prop_oneof![
        prop::collection::vec(material, 1..5).prop_map(Palette::Materials),
        prop::collection::vec(color(), 1..5).prop_map(Palette::Colors),
        (0..4_u32, prop::option::of(name), color(), places).prop_map(|(texture, name, tint, places)| {
            Palette::Textured { texture, name: name.map(str::to_owned), tint, places }
        }),
    ];
    prop::collection::vec(palette, 0..5)
}

fn textures() -> impl Strategy<Value = Vec<Texture>> {
    let wraps = || prop::sample::select(vec![Wrap::Repeat, Wrap::Mirror, Wrap::Clamp, Wrap::None]);
    let bytes = prop::sample::select(vec![PNG, JPEG, b"no picture"]);
    let texture = (bytes, wraps(), wraps()).prop_map(|(bytes, wrap_u, wrap_v)| Texture {
        bytes: Arc::from(bytes),
        media_type: "image/png".to_owned(),
        wrap_u,
        wrap_v,
        nearest: false,
    });
    prop::collection::vec(texture, 0..4)
}

fn meshes() -> impl Strategy<Value = PaintedMesh> {
    let coordinate = || prop_oneof![-9.0..9.0, prop::num::f64::NORMAL, Just(-0.0)];
    let position = [coordinate(), coordinate(), coordinate()].prop_map(DVec3::from_array);
    let paint = (0..6_u32, [0..4_u32, 0..4, 0..4], 0..4).prop_map(|(palette, at, none)| match none {
        0 => PAINTLESS,
        _ => Paint { palette, at },
    });
    prop::collection::vec(position, 1..9).prop_flat_map(move |positions| {
        let vertex = 0..positions.len() as u32;
        let face = ([vertex.clone(), vertex.clone(), vertex], paint.clone());
        (prop::collection::vec(face, 1..14), 0..5).prop_map(move |(faces, painted)| PaintedMesh {
            soup: Soup { positions: positions.clone(), faces: faces.iter().map(|(face, _)| *face).collect() },
            paint: if painted > 0 { faces.iter().map(|(_, paint)| *paint).collect() } else { Vec::new() },
        })
    })
}

fn scenes() -> impl Strategy<Value = Scene> {
    let move_it = prop::option::of(-4.0..4.0)
        .prop_map(|by| DAffine3 { translation: DVec3::splat(by.unwrap_or(0.0)), ..DAffine3::IDENTITY });
    let items = prop::collection::vec((0..3_u32, move_it), 0..3);
    (prop::collection::vec(meshes(), 1..4), items, palettes(), textures()).prop_map(
        |(meshes, items, palettes, textures)| {
            let items = items.into_iter().map(|(object, transform)| Item { transform, ..Item::of(object) });
            Scene {
                objects: meshes.into_iter().map(|mesh| Object::of_mesh(None, mesh)).collect(),
                items: std::iter::once(Item::of(0)).chain(items).collect(),
                palettes,
                textures,
                ..Scene::default()
            }
        },
    )
}

fn read(bytes: &[u8]) -> meshmend::format::ReadScene {
    let file = meshmend::format::read_scene(bytes, &Default::default()).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!((file.format, file.warnings.len()), (Format::Zip, 0), "{:?}", file.warnings);
    file
}

/// The files of an archive, in order.
fn files(bytes: &[u8]) -> Vec<(String, Vec<u8>)> {
    let mut zip = zip::ZipArchive::new(Cursor::new(bytes)).unwrap();
    let file = |index| {
        let mut file = zip.by_index(index).unwrap();
        let mut content = Vec::new();
        file.read_to_end(&mut content).unwrap();
        (file.name().unwrap().into_owned(), content)
    };
    (0..zip::ZipArchive::new(Cursor::new(bytes)).unwrap().len()).map(file).collect()
}

fn texts(bytes: &[u8]) -> String {
    files(bytes).iter().map(|(name, content)| format!("{name}:\n{}\n", String::from_utf8_lossy(content))).collect()
}

fn bits(soup: &Soup) -> Vec<[u64; 3]> {
    soup.positions.iter().map(|p| p.to_array().map(f64::to_bits)).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(512))]

    #[test]
    fn a_scene_comes_back_as_one_mesh_with_its_paint_and_is_written_the_same_again(scene in scenes()) {
        let bytes = write_scene(&scene, Format::Zip).unwrap();
        let again = read(&bytes);
        let expected = scene.placed(1000).unwrap();
        let found = mesh(&again);
        prop_assert_eq!(bits(&found.soup), bits(&expected.soup));
        prop_assert_eq!(&found.soup.faces, &expected.soup.faces);
        for face in 0..found.soup.faces.len() {
            let of = |scene: &Scene, mesh: &PaintedMesh| appearance(scene, mesh.paint.get(face).copied().unwrap_or(PAINTLESS));
            let (found, expected) = (of(&again.scene, found), of(&scene, &expected));
            prop_assert!(is_expressed(&found, &expected), "{:?} for {:?} of face {}\n{}", found, expected, face, texts(&bytes));
        }
        let second = write_scene(&again.scene, Format::Zip).unwrap();
        prop_assert!(second == bytes, "{}\n\n{}", texts(&bytes), texts(&second));
    }

    #[test]
    fn colours_that_are_one_at_each_vertex_come_back_as_they_were(
        colors in prop::collection::vec(any::<[u8; 3]>(), 6),
        faces in prop::collection::vec(([0..6_u32, 0..6, 0..6], any::<bool>()), 1..20),
    ) {
        let soup = Soup { positions: vec![DVec3::X; 6], faces: faces.iter().map(|face| face.0).collect() };
        let paint = faces.iter().map(|(at, _)| Paint { palette: 0, at: *at }).collect();
        let palette = Palette::Colors(colors.iter().map(|&[r, g, b]| [r, g, b, 255]).collect());
        let scene = Scene { palettes: vec![palette], ..Scene::of_mesh(PaintedMesh { soup, paint }) };
        let again = read(&write_scene(&scene, Format::Zip).unwrap());
        for (number, (face, _)) in faces.iter().enumerate() {
            let found = appearance(&again.scene, mesh(&again).paint[number]);
            prop_assert_eq!(found, Appearance::Colors(face.map(|v| { let [r, g, b] = colors[v as usize]; [r, g, b, 255] })));
        }
    }
}

#[test]
fn an_unpainted_scene_is_a_zip_with_only_the_plain_obj_file() {
    let bytes = write(&tetrahedron(), Format::Zip).unwrap();
    let obj = write(&tetrahedron(), Format::Obj).unwrap();
    assert_eq!(files(&bytes), [("model.obj".to_owned(), obj)]);
    let scene = Scene::of_mesh(PaintedMesh { soup: tetrahedron(), paint: vec![PAINTLESS; 4] });
    assert_eq!(write_scene(&scene, Format::Zip).unwrap(), bytes);
}

#[test]
fn a_painted_model_is_written_with_its_materials_and_pictures() {
    let texture = |bytes: &[u8]| Texture {
        bytes: Arc::from(bytes),
        media_type: "image/png".to_owned(),
        wrap_u: Wrap::Clamp,
        wrap_v: Wrap::Clamp,
        nearest: false,
    };
    let material = |name: &str, color| Material { name: name.to_owned(), color };
    let paint = |palette, at| Paint { palette, at };
    let scene = Scene {
        palettes: vec![
            Palette::Materials(vec![material("PLA red", [255, 0, 0, 255]), material("PLA red", [0, 0, 255, 51])]),
            Palette::Textured { texture: 1, name: None, tint: [255; 4], places: vec![[0.25, 1.0], [0.0, 0.5]] },
        ],
        textures: vec![texture(JPEG), texture(PNG)],
        ..Scene::of_mesh(PaintedMesh {
            soup: tetrahedron(),
            paint: vec![paint(0, [0; 3]), paint(0, [1; 3]), PAINTLESS, paint(1, [1, 0, 1])],
        })
    };
    let bytes = write_scene(&scene, Format::Zip).unwrap();
    let obj = "mtllib model.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nvt 0 0.5\nvt 0.25 1\nusemtl PLA_red\nf 1 3 2\nusemtl PLA_red_2\nf 1 2 4\n\
               usemtl (null)\nf 2 3 4\nusemtl texture_0\nf 3/1 1/2 4/1\n";
    let mtl = "newmtl PLA_red\nKd 1 0 0\nnewmtl PLA_red_2\nKd 0 0 1\nd 0.2\nnewmtl texture_0\nKd 1 1 1\nmap_Kd -clamp on texture_0.png\n";
    let expected = [("model.obj", obj.as_bytes()), ("model.mtl", mtl.as_bytes()), ("texture_0.png", PNG)];
    let expected = expected.map(|(name, content)| (name.to_owned(), content.to_vec()));
    assert_eq!(files(&bytes), expected, "{}", texts(&bytes));
    // The archive holds no time and nothing about the machine.
    let mut zip = zip::ZipArchive::new(Cursor::new(&bytes)).unwrap();
    let entry = zip.by_index(0).unwrap();
    assert_eq!(
        (entry.extra_data().unwrap_or_default().len(), entry.last_modified()),
        (0, Some(zip::DateTime::default()))
    );
}
