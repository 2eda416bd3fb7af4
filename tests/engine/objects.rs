//! Repair of files with objects, colours and units.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::{DAffine3, DVec3};
use meshmend::analyze::{Analyst, AnalyzeOptions};
use meshmend::format::{self, Format, Limits, ReadFile, ReadOptions, read_file, write_scene};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::{
    AssumptionKind, Context, Merge, NoProgress, NotAppliedCause, Options, Outcome, OutputFormat, PrintOptions,
    RedFlagCode, Repaired, WallGrowth,
};
use meshmend::scene::{
    Component, Item, Material, Object, ObjectKind, Paint, PaintedMesh, Palette, Scene, Shape, Texture, Unit,
    UnitSource, Up, Wrap,
};

use crate::meshes::{cube, cuboid, cylinder, torus};
use crate::support::{assert_outcome, repair_bytes};

fn run(bytes: &[u8], options: &Options) -> Repaired {
    repair_bytes(bytes, &Options { max_tier: 2, ..options.clone() }, None).unwrap()
}

fn packed(scene: &Scene, format: Format) -> Vec<u8> {
    write_scene(scene, format).unwrap()
}

fn read(bytes: &[u8]) -> ReadFile {
    read_file(bytes, &ReadOptions::default()).unwrap()
}

fn scene_of(repaired: &Repaired) -> Scene {
    read(&repaired.bytes).scene.unwrap()
}

/// The soup with merged vertices and without its last face.
fn open(mut soup: Soup) -> Soup {
    soup.faces.pop();
    welded(&soup)
}

fn welded(soup: &Soup) -> Soup {
    Surface::from_soup(soup).0.to_soup()
}

fn named(name: &str, soup: Soup) -> Object {
    Object::of_mesh(Some(name.to_owned()), PaintedMesh { soup, paint: Vec::new() })
}

/// A box that is placed twice, once rotated, and an open cylinder between the two.
fn sample_scene() -> Scene {
    let turned = DAffine3::from_rotation_z(0.5) * DAffine3::from_translation(DVec3::new(40.0, 0.0, 0.0));
    Scene {
        unit: Some(Unit::Millimetre),
        up: Some(Up::Z),
        objects: vec![
            named("box", welded(&cube(DVec3::ZERO, 8.0, 2))),
            named("lid", open(cylinder(DVec3::ZERO, 5.0, 3.0, 16))),
            Object {
                shape: Shape::Components(vec![Component {
                    object: 1,
                    transform: DAffine3::from_translation(DVec3::new(20.0, 0.0, 0.0)),
                }]),
                ..named("pair", Soup::default())
            },
        ],
        items: vec![
            Item::of(0),
            Item {
                name: Some("second".to_owned()),
                transform: turned,
                part_number: Some("7".to_owned()),
                ..Item::of(0)
            },
            Item::of(2),
        ],
        ..Scene::default()
    }
}

#[test]
fn objects_stay_objects_and_each_is_repaired_separately() {
    let before = sample_scene();
    let repaired = run(&packed(&before, Format::ThreeMf), &Options::default());
    assert_eq!(
        (repaired.format, repaired.report.outcome),
        (Format::ThreeMf, Outcome::Repaired),
        "{}",
        repaired.report.summary
    );
    let after = scene_of(&repaired);
    let names = |scene: &Scene| scene.objects.iter().map(|object| object.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&after), names(&before));
    assert_eq!(after.items, before.items);
    assert_eq!(after.objects[2], before.objects[2]);
    assert_eq!(after.objects[0].mesh().unwrap().soup.faces.len(), 48, "nothing was done to the box");
    let sections: Vec<_> = repaired.report.objects.iter().map(|o| (o.name.as_deref(), o.places, o.outcome)).collect();
    assert_eq!(sections, [(Some("box"), 2, Outcome::AlreadyPrintable), (Some("lid"), 1, Outcome::Repaired)]);
    assert!(repaired.report.after.unwrap().measures.printable() && repaired.report.verified_from_output_bytes);
}

#[test]
fn an_option_that_acts_on_one_object_has_something_to_do_in_the_file() {
    let plate = cuboid(DVec3::new(40.0, 0.0, 0.0), DVec3::new(20.0, 15.0, 0.5), 1);
    let scene = Scene {
        unit: Some(Unit::Millimetre),
        objects: vec![named("box", welded(&cube(DVec3::ZERO, 20.0, 1))), named("plate", welded(&plate))],
        items: vec![Item::of(0), Item::of(1)],
        ..Scene::default()
    };
    let print = PrintOptions { min_wall: Some(1.0), wall_growth: WallGrowth::Inward, ..PrintOptions::default() };
    let report = run(&packed(&scene, Format::ThreeMf), &Options { print, ..Options::default() }).report;
    let entries: Vec<_> = report.options_not_applied.iter().map(|entry| (&*entry.option, entry.cause)).collect();
    assert_eq!(entries, [("wall_growth", NotAppliedCause::Limited)], "{:?}", report.options_not_applied);
    assert_eq!(report.summary, "Of 2 objects: 1 already printable, 1 already printable and changed.");
}

#[test]
fn a_file_whose_objects_need_nothing_comes_back_byte_for_byte() {
    let mut scene = sample_scene();
    scene.objects[1] = named("lid", welded(&cylinder(DVec3::ZERO, 5.0, 3.0, 16)));
    for format in [Format::ThreeMf, Format::Glb] {
        let bytes = packed(&scene, format);
        let repaired = run(&bytes, &Options::default());
        assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
        assert!(repaired.bytes == bytes, "{format:?}");
    }
}

#[test]
fn vertices_that_are_one_by_position_only_become_one_in_3mf() {
    let mut soup = welded(&cube(DVec3::ZERO, 8.0, 1));
    soup = Soup {
        positions: soup.faces.iter().flatten().map(|&v| soup.positions[v as usize]).collect(),
        faces: (0..12).map(|face| [3 * face, 3 * face + 1, 3 * face + 2]).collect(),
    };
    let scene = Scene { objects: vec![named("box", soup)], items: vec![Item::of(0)], ..sample_scene() };
    let repaired = run(&packed(&scene, Format::ThreeMf), &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    assert_eq!(repaired.report.before.measures.unshared_edges, 18);
    assert_eq!(scene_of(&repaired).objects[0].mesh().unwrap().soup.positions.len(), 8);
}

#[test]
fn objects_are_united_where_that_is_asked_for_and_where_the_format_has_none() {
    let mut scene = sample_scene();
    scene.items[1].transform = DAffine3::from_translation(DVec3::splat(3.0));
    let bytes = packed(&scene, Format::ThreeMf);
    let apart = run(&bytes, &Options::default());
    assert_eq!(apart.report.outcome, Outcome::Repaired, "{}", apart.report.summary);
    assert!(apart.report.after.unwrap().measures.printable());
    let united = run(&bytes, &Options { merge: Merge::Objects, ..Options::default() });
    assert_eq!(united.report.outcome, Outcome::Repaired);
    assert_eq!((scene_of(&united).objects.len(), united.report.objects.len()), (1, 0));
    assert_eq!(united.report.after.unwrap().measures.parts, 2);
    let stl = run(&bytes, &Options { output: OutputFormat::Stl, ..Options::default() });
    assert_eq!((stl.format, stl.report.outcome), (Format::Stl, Outcome::Repaired));
    assert_eq!(stl.report.after.unwrap().measures.parts, 2);
}

#[test]
fn support_structures_are_left_unchanged() {
    let mut scene = sample_scene();
    scene.objects[1].kind = ObjectKind::Support;
    let bytes = packed(&scene, Format::ThreeMf);
    let repaired = run(&bytes, &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
    assert!(
        repaired.bytes == bytes && repaired.report.warnings.iter().any(|warning| warning.contains("left unchanged"))
    );
}

#[test]
fn faces_that_may_be_left_are_shared_among_objects() {
    let objects = vec![named("large", torus(30.0, 8.0, 64, 32)), named("small", torus(30.0, 8.0, 32, 16))];
    let apart = DAffine3::from_translation(DVec3::new(100.0, 0.0, 0.0));
    let items = vec![Item::of(0), Item { transform: apart, ..Item::of(1) }];
    let bytes = packed(&Scene { objects, items, ..sample_scene() }, Format::ThreeMf);
    let repaired = run(&bytes, &Options { max_faces: Some(2560), ..Options::default() });
    let faces: Vec<usize> =
        scene_of(&repaired).objects.iter().map(|object| object.mesh().unwrap().soup.faces.len()).collect();
    assert!(faces[0] <= 2048 && faces[1] <= 512, "{faces:?}");
}

/// An open cube whose sides each have their own material; the first has a texture.
fn painted(open_side: bool) -> Scene {
    let soup = cube(DVec3::ZERO, 10.0, 4);
    let colors =
        [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255], [9, 9, 9, 255], [90, 0, 90, 255], [1, 2, 3, 255]];
    let materials = (0..).zip(colors).map(|(side, color)| Material { name: format!("side {side}"), color }).collect();
    let places = soup
        .positions
        .iter()
        .map(|p| [p.x / 10.0, p.y / 10.0])
        .map(|place| place.map(|x| f64::from(x as f32)))
        .collect();
    let texture = Texture {
        bytes: b"\x89PNG\r\n\x1a\nand so on".as_slice().into(),
        media_type: "image/png".to_owned(),
        wrap_u: Wrap::Repeat,
        wrap_v: Wrap::Repeat,
        nearest: false,
    };
    let side = |face: usize| -> u32 {
        let [a, b, c] = soup.corners(face);
        let normal = (b - a).cross(c - a).normalize();
        (0..)
            .zip([DVec3::NEG_Z, DVec3::Z, DVec3::X, DVec3::NEG_X, DVec3::Y, DVec3::NEG_Y])
            .find(|(_, axis)| normal.dot(*axis) > 0.5)
            .unwrap()
            .0
    };
    let mut mesh = PaintedMesh::default();
    for face in 0..soup.faces.len() {
        let paint = match side(face) {
            0 => Paint { palette: 1, at: soup.faces[face] },
            side => Paint { palette: 0, at: [side; 3] },
        };
        let is_gap = open_side
            && side(face) == 1
            && soup.corners(face).iter().all(|p| (2.5..=7.5).contains(&p.x) && (2.5..=7.5).contains(&p.y));
        if !is_gap {
            mesh.soup.faces.push(soup.faces[face]);
            mesh.paint.push(paint);
        }
    }
    mesh.soup.positions = soup.positions;
    Scene {
        unit: Some(Unit::Millimetre),
        up: Some(Up::Z),
        palettes: vec![
            Palette::Materials(materials),
            Palette::Textured { texture: 0, name: None, tint: [255; 4], places },
        ],
        textures: vec![texture],
        ..Scene::of_mesh(mesh)
    }
}

/// The centre of each face with its colour, or with its texture coordinates.
fn appearances(file: &ReadFile) -> Vec<([i64; 3], String)> {
    let scene = file.scene.as_ref().unwrap();
    let mut appearances: Vec<_> = (0..file.mesh.soup.faces.len())
        .map(|face| {
            let corners = file.mesh.soup.corners(face);
            let middle = (corners[0] + corners[1] + corners[2]) * 1e4 / 3.0;
            let paint = file.paint[face];
            let appearance = match &scene.palettes[paint.palette as usize] {
                Palette::Materials(materials) => format!("{:?}", materials[paint.at[0] as usize].color),
                Palette::Colors(colors) => format!("{:?}", colors[paint.at[0] as usize]),
                Palette::Textured { places, .. } => {
                    let mut at: Vec<_> =
                        paint.at.iter().map(|&at| places[at as usize].map(|x| (x * 1e4).round() as i64)).collect();
                    at.sort_unstable();
                    format!("{at:?}")
                }
            };
            (middle.to_array().map(|x| x.round() as i64), appearance)
        })
        .collect();
    appearances.sort();
    appearances
}

#[test]
fn kept_faces_keep_colours_and_textures_and_new_faces_get_them() {
    let formats =
        [(Format::ThreeMf, OutputFormat::ThreeMf), (Format::Glb, OutputFormat::Glb), (Format::Zip, OutputFormat::Auto)];
    for (format, output) in formats {
        for merge in [Merge::None, Merge::Objects] {
            let input = packed(&painted(true), format);
            let repaired =
                run(&input, &Options { output, merge, scale_to: Some(Unit::Millimetre), ..Options::default() });
            assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
            let (was, is) = (read(&input), read(&repaired.bytes));
            let scale = |file: ReadFile| {
                let mut file = file;
                let factor = file.scene.as_ref().unwrap().unit.map_or(1.0, |unit| unit.to(Unit::Millimetre));
                file.mesh.soup.positions.iter_mut().for_each(|p| *p *= factor);
                appearances(&file)
            };
            let (was, is) = (scale(was), scale(is));
            assert!(was.iter().all(|appearance| is.contains(appearance)), "{format:?}: what stayed looks as it did");
            let new: Vec<_> = is.iter().filter(|appearance| !was.contains(appearance)).collect();
            assert!(!new.is_empty());
            assert!(
                new.iter().all(|(_, appearance)| appearance == "[0, 255, 0, 255]"),
                "{format:?}: the gap was green: {new:?}"
            );
            let scene = scene_of(&repaired);
            assert_eq!(scene.textures[0].bytes, painted(true).textures[0].bytes);
        }
    }
}

#[test]
fn a_painted_file_in_another_format_keeps_its_colours() {
    let input = packed(&painted(false), Format::Glb);
    let repaired =
        run(&input, &Options { output: OutputFormat::ThreeMf, scale_to: Some(Unit::Millimetre), ..Options::default() });
    assert_eq!((repaired.format, repaired.report.outcome), (Format::ThreeMf, Outcome::AlreadyPrintable));
    let after = read(&repaired.bytes);
    assert_eq!(after.scene.as_ref().unwrap().unit, Some(Unit::Millimetre));
    // glTF has y up and 3MF has z up: the model stands upright again.
    assert_eq!(appearances(&after), appearances(&read(&packed(&painted(false), Format::ThreeMf))));
}

fn longest_side(bytes: &[u8]) -> f64 {
    let soup = format::read(bytes, &Limits::default()).unwrap().soup;
    let of = |get: fn(&DVec3) -> f64| {
        let all = soup.positions.iter().map(get);
        all.clone().fold(f64::NEG_INFINITY, f64::max) - all.fold(f64::INFINITY, f64::min)
    };
    of(|p| p.x).max(of(|p| p.y)).max(of(|p| p.z))
}

#[test]
fn a_unit_is_declared_or_read_or_assumed_and_lengths_are_scaled_to_another() {
    let stl = format::write(&cube(DVec3::ZERO, 20.0, 1), Format::Stl).unwrap();
    let assumed = run(&stl, &Options::default()).report;
    assert_eq!((assumed.unit.used, assumed.unit.source), (Unit::Millimetre, UnitSource::Assumed));
    assert!(assumed.unit.note.is_some() && assumed.warnings.is_empty(), "{:?}", assumed.warnings);
    let declared =
        run(&stl, &Options { unit: Some(Unit::Inch), scale_to: Some(Unit::Millimetre), ..Options::default() });
    let unit = &declared.report.unit;
    assert_eq!((unit.used, unit.source, unit.scaled_from), (Unit::Millimetre, UnitSource::Declared, Some(Unit::Inch)));
    assert_eq!(longest_side(&declared.bytes), 508.0);
    assert_eq!(declared.report.outcome, Outcome::AlreadyPrintable);
    let glb = packed(
        &Scene {
            unit: Some(Unit::Metre),
            up: Some(Up::Y),
            ..Scene::of_mesh(PaintedMesh { soup: cube(DVec3::ZERO, 0.5, 1), paint: Vec::new() })
        },
        Format::Glb,
    );
    let kept = run(&glb, &Options { output: OutputFormat::Stl, ..Options::default() });
    assert_eq!(
        (kept.report.unit.used, kept.report.unit.source, kept.report.unit.up),
        (Unit::Metre, UnitSource::File, Some(Up::Y))
    );
    assert_eq!(longest_side(&kept.bytes), 0.5);
    let scaled =
        run(&glb, &Options { output: OutputFormat::Stl, scale_to: Some(Unit::Centimetre), ..Options::default() });
    assert_eq!(longest_side(&scaled.bytes), 50.0);
}

#[test]
fn a_size_implausible_in_millimetres_gives_a_warning() {
    let warnings_of = |side: f64| {
        let stl = format::write(&cube(DVec3::ZERO, side, 1), Format::Stl).unwrap();
        run(&stl, &Options::default()).report.warnings.join(" ")
    };
    assert!(warnings_of(2.0).contains("inches"), "{}", warnings_of(2.0));
    assert!(warnings_of(30_000.0).contains("micrometres"));
    let stl = format::write(&cube(DVec3::ZERO, 2.0, 1), Format::Stl).unwrap();
    assert_eq!(
        run(&stl, &Options { unit: Some(Unit::Inch), ..Options::default() }).report.warnings,
        Vec::<String>::new()
    );
}

#[test]
fn stl_is_the_output_format_unless_the_file_holds_more() {
    let soup = open(cube(DVec3::ZERO, 20.0, 2));
    let of = |format| run(&format::write(&soup, format).unwrap(), &Options::default()).format;
    assert_eq!([Format::Stl, Format::Obj, Format::Off].map(of), [Format::Stl; 3]);
    assert_eq!([Format::ThreeMf, Format::Glb].map(of), [Format::ThreeMf, Format::Glb]);
}

/// A cube with a hole, red in the lower half and blue in the upper one.
fn two_colours() -> Scene {
    let soup = open(cube(DVec3::ZERO, 20.0, 2));
    let lower = |face: usize| soup.corners(face).iter().map(|p| p.z).sum::<f64>() < 30.0;
    let paint = (0..soup.faces.len()).map(|face| Paint { palette: 0, at: [u32::from(!lower(face)); 3] }).collect();
    let palettes = vec![Palette::Colors(vec![[255, 0, 0, 255], [0, 0, 255, 255]])];
    Scene { palettes, ..Scene::of_mesh(PaintedMesh { soup, paint }) }
}

#[test]
fn colours_of_ply_come_back_in_ply() {
    let input = packed(&two_colours(), Format::Ply);
    let repaired = run(&input, &Options::default());
    assert_eq!((repaired.format, repaired.report.outcome), (Format::Ply, Outcome::Repaired));
    let (was, is) = (appearances(&read(&input)), appearances(&read(&repaired.bytes)));
    assert!(was.iter().all(|appearance| is.contains(appearance)));
    assert_eq!(is.len(), 48);
}

#[test]
fn properties_that_a_format_cannot_hold_are_reported() {
    let warnings_of =
        |options: Options| run(&packed(&painted(true), Format::ThreeMf), &options).report.warnings.join(" ");
    let stl = warnings_of(Options { output: OutputFormat::Stl, ..Options::default() });
    assert!(stl.contains("STL can't store colours and textures"), "{stl}");
    assert_eq!(warnings_of(Options::default()), "");
}

#[test]
fn an_archive_is_not_returned_for_the_model_in_it() {
    use std::io::Write;
    let stl = format::write(&cube(DVec3::ZERO, 20.0, 1), Format::Stl).unwrap();
    let mut archive = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    archive.start_file("folder/cube.stl", zip::write::SimpleFileOptions::default()).unwrap();
    archive.write_all(&stl).unwrap();
    let archive = archive.finish().unwrap().into_inner();
    let repaired = run(&archive, &Options { output: OutputFormat::Same, ..Options::default() });
    assert_eq!((repaired.format, repaired.report.outcome), (Format::Stl, Outcome::AlreadyPrintable));
    assert_eq!(read(&repaired.bytes).mesh.soup, read(&stl).mesh.soup);
    assert!(repaired.report.input.dialect.contains("ZIP"), "{}", repaired.report.input.dialect);
}

#[test]
fn the_report_of_the_maximum_number_of_objects_has_a_bounded_size() {
    let soup = open(torus(10.0, 3.0, 12, 8));
    let item = |number: u32| Item {
        transform: DAffine3::from_translation(DVec3::new(f64::from(number) * 30.0, 0.0, 0.0)),
        ..Item::of(number)
    };
    let scene = |count: u32| Scene {
        objects: (0..count).map(|number| named(&number.to_string(), soup.clone())).collect(),
        items: (0..count).map(item).collect(),
        ..sample_scene()
    };
    let repaired = run(&packed(&scene(200), Format::ThreeMf), &Options::default());
    assert_eq!((repaired.report.outcome, repaired.report.objects.len()), (Outcome::Repaired, 200));
    let size = serde_json::to_vec_pretty(&repaired.report).unwrap().len();
    assert!(size < 12 << 20, "{size}");
    let result = run(&packed(&scene(201), Format::ThreeMf), &Options::default());
    assert_eq!((scene_of(&result).objects.len(), result.report.objects.len()), (1, 0));
    assert!(
        result.report.warnings.iter().any(|warning| warning.contains("more than the limit of 200")),
        "{:?}",
        result.report.warnings
    );
}

/// Two overlapping boxes of different colours, and a third box apart from them.
fn colored_boxes() -> Scene {
    let colors = [[255, 0, 0, 255], [0, 255, 0, 255], [0, 0, 255, 255]];
    let materials = colors.map(|color| Material { name: format!("{color:?}"), color }).to_vec();
    let object = |(number, name): (u32, &str)| {
        let soup = welded(&cube(DVec3::ZERO, 10.0, 1));
        let paint = vec![Paint { palette: 0, at: [number; 3] }; soup.faces.len()];
        Object::of_mesh(Some(name.to_owned()), PaintedMesh { soup, paint })
    };
    let at =
        |object: u32, x: f64| Item { transform: DAffine3::from_translation(DVec3::new(x, x, x)), ..Item::of(object) };
    Scene {
        unit: Some(Unit::Millimetre),
        up: Some(Up::Z),
        objects: (0u32..).zip(["red", "green", "blue"]).map(object).collect(),
        items: vec![at(0, 0.0), at(1, 5.0), at(2, 40.0)],
        palettes: vec![Palette::Materials(materials)],
        ..Scene::default()
    }
}

fn flags(repaired: &Repaired) -> Vec<RedFlagCode> {
    repaired.report.red_flags.iter().map(|flag| flag.code).collect()
}

#[test]
fn objects_that_overlap_become_one_solid_in_their_colours_and_others_stay_objects() {
    let repaired = run(&packed(&colored_boxes(), Format::Glb), &Options::default());
    assert_eq!((repaired.report.outcome, flags(&repaired)), (Outcome::Repaired, vec![]), "{}", repaired.report.summary);
    let file = read(&repaired.bytes);
    let names: Vec<_> = file.scene.as_ref().unwrap().objects.iter().map(|object| object.name.clone()).collect();
    assert_eq!(names, [Some("red + green".to_owned()), Some("blue".to_owned())]);
    let after = repaired.report.after.as_ref().unwrap();
    assert!(after.measures.printable());
    // GLB is in metres.
    let volume = after.measures.volume.value * 1e9;
    assert!((volume - 2875.0).abs() < 1e-2, "{volume}");
    let appearances: Vec<String> = appearances(&file).into_iter().map(|(_, appearance)| appearance).collect();
    for color in ["255, 0, 0", "0, 255, 0", "0, 0, 255"] {
        assert!(appearances.iter().any(|appearance| appearance.contains(color)), "{color} in {appearances:?}");
    }
    let united: Vec<_> =
        repaired.report.assumptions.iter().filter(|a| a.kind == AssumptionKind::ObjectsUnited).collect();
    assert_eq!((united.len(), united[0].count, united[0].option.as_deref()), (1, 2, Some("merge=none")));
}

#[test]
fn separate_objects_that_overlap_are_flagged_with_name_and_place() {
    for format in [Format::Glb, Format::ThreeMf] {
        let bytes = packed(&colored_boxes(), format);
        let repaired = run(&bytes, &Options { merge: Merge::None, ..Options::default() });
        assert_eq!(repaired.report.outcome, Outcome::PartiallyRepaired);
        let flag = repaired.report.red_flags.iter().find(|flag| flag.code == RedFlagCode::ObjectsIntersect).unwrap();
        assert!(flag.detail.contains("'red' and object 'green'") && !flag.places.is_empty(), "{}", flag.detail);
        assert!(repaired.report.summary.contains("merge=auto"), "{}", repaired.report.summary);
    }
}

#[test]
fn an_object_that_overlaps_its_other_instance_is_united_there_and_kept_elsewhere() {
    let mut scene = colored_boxes();
    scene.items.iter_mut().for_each(|item| item.object = 0);
    let repaired = run(&packed(&scene, Format::ThreeMf), &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
    let after = repaired.report.after.as_ref().unwrap();
    assert!(after.measures.printable() && (after.measures.volume.value - 2875.0).abs() < 1e-3);
    assert_eq!(volumes(&repaired), [1000.0, 1875.0]);
}

#[test]
fn the_halves_of_a_solid_that_are_two_objects_are_closed_by_each_other() {
    let soup = welded(&cube(DVec3::ZERO, 10.0, 4));
    let half = |upper: bool| {
        let faces = (0..soup.faces.len()).filter(|&face| {
            let [a, b, c] = soup.corners(face);
            (a.z.min(b.z).min(c.z) >= 5.0) == upper
        });
        welded(&Soup { faces: faces.map(|face| soup.faces[face]).collect(), positions: soup.positions.clone() })
    };
    let objects = vec![named("lower", half(false)), named("upper", half(true))];
    let scene = Scene { objects, items: vec![Item::of(0), Item::of(1)], ..sample_scene() };
    let repaired = run(&packed(&scene, Format::ThreeMf), &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
    let after = repaired.report.after.as_ref().unwrap();
    assert!(after.measures.printable() && (after.measures.volume.value - 1000.0).abs() < 1e-3);
    assert_eq!((scene_of(&repaired).objects.len(), after.measures.faces), (1, soup.faces.len() as u64));
}

#[test]
fn random_scenes_end_with_the_verdict_that_an_inspection_of_the_result_gives() {
    let mut seed = 7u64;
    let mut random = |below: f64| {
        seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (seed >> 40) as f64 / (1u64 << 24) as f64 * below
    };
    for round in 0..6 {
        let mut scene = colored_boxes();
        scene.objects[1] = named("lid", open(cylinder(DVec3::ZERO, 5.0, 3.0, 8)));
        scene.objects[2] = named("ring", welded(&torus(6.0, 2.0, 12, 8)));
        for item in &mut scene.items {
            let at = DVec3::new(random(30.0), random(10.0), random(10.0));
            item.transform = DAffine3::from_translation(at) * DAffine3::from_rotation_x(random(3.0));
        }
        for (format, merge) in [(Format::Glb, Merge::Auto), (Format::ThreeMf, Merge::Auto), (Format::Glb, Merge::None)]
        {
            for output in [OutputFormat::Same, OutputFormat::Stl, OutputFormat::ThreeMf] {
                let options = Options { merge, output, ..Options::default() };
                let repaired = run(&packed(&scene, format), &options);
                let again = is_printable(&repaired.bytes);
                let (summary, flags) = (&repaired.report.summary, &repaired.report.red_flags);
                let context = format!("{round} {format:?} {merge:?} {output:?}: {summary} {flags:?}");
                assert!(!repaired.report.outcome.is_printable() || again, "{context}");
                assert!(repaired.report.outcome.is_printable() || !again || !flags.is_empty(), "{context}");
                // A red flag says that bodies of different materials could not be cut.
                let is_assembly = format == Format::ThreeMf && output != OutputFormat::Stl;
                assert!(again || merge == Merge::None || is_assembly, "{context}");
            }
        }
    }
}

fn volumes(repaired: &Repaired) -> Vec<f64> {
    let volume = |soup: &Soup| -> f64 {
        let tetrahedron = |face: usize| {
            let [a, b, c] = soup.corners(face);
            a.dot(b.cross(c)) / 6.0
        };
        (0..soup.faces.len()).map(tetrahedron).sum()
    };
    let scene = scene_of(repaired);
    let placed = scene.objects.iter().zip(scene.places()).filter(|(_, places)| *places > 0);
    placed.filter_map(|(object, _)| object.mesh()).map(|mesh| volume(&mesh.soup).round()).collect()
}

#[test]
fn parts_of_other_materials_in_3mf_stay_parts_and_the_later_one_keeps_the_space() {
    let repaired = run(&packed(&colored_boxes(), Format::ThreeMf), &Options::default());
    assert_eq!((repaired.report.outcome, flags(&repaired)), (Outcome::Repaired, vec![]), "{}", repaired.report.summary);
    assert_eq!(volumes(&repaired), [875.0, 1000.0, 1000.0]);
    assert!(is_printable(&repaired.bytes));
    let cut: Vec<_> = repaired.report.assumptions.iter().filter(|a| a.kind == AssumptionKind::OverlapRemoved).collect();
    assert_eq!((cut.len(), cut[0].amount.map(f64::round)), (1, Some(125.0)), "{cut:?}");
}

#[test]
fn a_part_within_a_part_of_another_material_gets_a_cavity_of_its_shape() {
    let mut scene = colored_boxes();
    let Shape::Mesh(inner) = &mut scene.objects[1].shape else { panic!("a mesh") };
    inner.soup.positions.iter_mut().for_each(|p| *p *= 0.5);
    scene.items[1].transform = DAffine3::from_translation(DVec3::splat(2.0));
    let bytes = packed(&scene, Format::ThreeMf);
    assert!(!is_printable(&bytes));
    let repaired = run(&bytes, &Options::default());
    assert_outcome(&repaired, Outcome::Repaired);
    assert_eq!(volumes(&repaired), [875.0, 125.0, 1000.0]);
    assert!(is_printable(&repaired.bytes));
}

#[test]
fn touching_parts_of_two_materials_are_an_assembly_and_of_one_material_one_solid() {
    let mut scene = colored_boxes();
    for (object, divisions) in [(0, 1), (1, 2)] {
        let Shape::Mesh(mesh) = &mut scene.objects[object].shape else { panic!("a mesh") };
        mesh.soup = welded(&cube(DVec3::ZERO, 10.0, divisions));
        mesh.paint = vec![Paint { palette: 0, at: [object as u32; 3] }; mesh.soup.faces.len()];
    }
    scene.items[1].transform = DAffine3::from_translation(DVec3::new(10.0, 0.0, 0.0));
    let bytes = packed(&scene, Format::ThreeMf);
    assert!(is_printable(&bytes));
    let repaired = run(&bytes, &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable, "{}", repaired.report.summary);
    assert!(repaired.bytes == bytes);
    scene.items[1].object = 0;
    let one = packed(&scene, Format::ThreeMf);
    assert!(!is_printable(&one));
    let result = run(&one, &Options::default());
    assert_eq!(result.report.outcome, Outcome::Repaired, "{}", result.report.summary);
    assert_eq!(volumes(&result), [2000.0, 1000.0]);
}

#[test]
fn parts_whose_surfaces_cross_only_along_edges_still_overlap() {
    let mut scene = colored_boxes();
    for object in [0, 1] {
        let Shape::Mesh(mesh) = &mut scene.objects[object].shape else { panic!("a mesh") };
        mesh.soup = welded(&cube(DVec3::ZERO, 10.0, 2));
        mesh.paint = vec![Paint { palette: 0, at: [object as u32; 3] }; mesh.soup.faces.len()];
    }
    let bytes = packed(&scene, Format::ThreeMf);
    assert!(!is_printable(&bytes));
    let repaired = run(&bytes, &Options::default());
    assert_outcome(&repaired, Outcome::Repaired);
    assert_eq!(volumes(&repaired), [875.0, 1000.0, 1000.0]);
}

/// Whether inspection finds a file printable.
fn is_printable(bytes: &[u8]) -> bool {
    let cancel = AtomicBool::new(false);
    let clock = || Duration::ZERO;
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
    let options = AnalyzeOptions::default();
    let limits = Limits::default();
    let mut analyst = Analyst::new(&options, &limits, 1, &context).unwrap();
    analyst.add("file", None, bytes).unwrap();
    analyst.finish().unwrap().files[0].printable == Some(true)
}
