//! One definition of printable: the outcome of a repair, its check, and an inspection of the output file agree.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::analyze::subject;
use meshmend::format::{self, Format, Limits, ReadOptions};
use meshmend::inspect::{CheckRule, DefectKind, InspectOptions, Inspection, Tolerance, Tolerances, inspect};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::{Context, NoProgress, Options, Outcome, OutputFormat, Repaired};
use proptest::prelude::*;

use crate::meshes::{as_f32, cube, inside_out, join, push};
use crate::support::repair_bytes;

/// The inspection of a file.
fn inspected(bytes: &[u8]) -> Inspection {
    let mut file = format::read_shape(bytes, &ReadOptions::within(Limits::default())).unwrap();
    let unit = file.settle_unit(None, None);
    let mesh = file.mesh;
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    inspect(subject(&mesh, Some(&unit)), &InspectOptions::default(), &context).unwrap().0
}

/// A cube whose faces share their vertices.
fn shared_cube() -> Soup {
    Surface::from_soup(&cube(DVec3::ONE, 10.0, 2)).0.to_soup()
}

/// The same faces without shared vertices.
fn unshared(soup: &Soup) -> Soup {
    let mut apart = Soup::default();
    (0..soup.faces.len()).for_each(|face| push(&mut apart, soup.corners(face)));
    apart
}

/// Whether trimesh calls the soup watertight: after merging positions equal in eight decimals, every edge has two faces.
fn is_watertight_to_trimesh(soup: &Soup) -> bool {
    let mut numbers = std::collections::BTreeMap::new();
    #[expect(clippy::cast_possible_truncation, reason = "small numbers")]
    let keys: Vec<[i64; 3]> =
        soup.positions.iter().map(|p| (*p * 1e8).to_array().map(|x| x.round_ties_even() as i64)).collect();
    let mut edges = std::collections::BTreeMap::new();
    for face in &soup.faces {
        let corners = face.map(|v| {
            let next = numbers.len();
            *numbers.entry(keys[v as usize]).or_insert(next)
        });
        for k in 0..3 {
            let (a, b) = (corners[k], corners[(k + 1) % 3]);
            *edges.entry((a.min(b), a.max(b))).or_insert(0) += 1;
        }
    }
    !edges.is_empty() && edges.iter().all(|(&(a, b), &count)| a != b && count == 2)
}

fn run(bytes: &[u8], output: OutputFormat) -> Repaired {
    repair_bytes(bytes, &Options { output, ..Options::default() }, None).unwrap()
}

const INDEXED: [Format; 4] = [Format::Obj, Format::Ply, Format::Off, Format::Mesh];

#[test]
fn an_indexed_file_whose_faces_share_no_vertices_is_not_printable_until_repaired() {
    let soup = unshared(&shared_cube());
    for format in INDEXED {
        let bytes = format::write(&soup, format).unwrap();
        let before = inspected(&bytes);
        assert!(!before.measures.printable() && before.measures.unshared_edges > 0, "{format:?}");
        let check = before.check.unwrap();
        assert_eq!(check.broken, [CheckRule::NoSlit]);
        let slits = before.defects.iter().find(|group| group.kind == DefectKind::Slit).unwrap();
        assert_eq!(slits.places[0].value, Some(0.0));
        let repaired = run(&bytes, OutputFormat::Same);
        assert_eq!(repaired.report.outcome, Outcome::Repaired, "{format:?}");
        let after = inspected(&repaired.bytes);
        assert!(after.measures.printable() && after.check.unwrap().passes);
        assert_eq!(after.measures.vertices, after.characteristics.elements.vertices);
    }
    for format in [Format::Stl, Format::Glb] {
        let bytes = format::write(&soup, format).unwrap();
        assert!(
            inspected(&bytes).measures.printable(),
            "{format:?} has no slits, since its readers join vertices by position"
        );
    }
}

#[test]
fn one_unshared_edge_is_a_slit_at_its_place() {
    let mut soup = shared_cube();
    // The first face gets separate vertices.
    let corners = soup.corners(0);
    let first = u32::try_from(soup.positions.len()).unwrap();
    soup.positions.extend(corners);
    soup.faces[0] = [first, first + 1, first + 2];
    let found = inspected(&format::write(&soup, Format::Off).unwrap());
    assert_eq!(found.measures.unshared_edges, 3);
    let slits = found.defects.iter().find(|group| group.kind == DefectKind::Slit).unwrap();
    assert_eq!((slits.count, slits.places[0].line.len()), (1, 4));
    assert!(corners.iter().any(|p| p.to_array() == slits.places[0].at));
}

#[test]
fn a_face_with_a_missing_vertex_is_not_printable_and_its_place_is_reported() {
    let soup = shared_cube();
    let mut bytes = format::write(&soup, Format::Mesh).unwrap();
    bytes.extend_from_slice(b"Face 999 1 2 4711\n");
    let before = inspected(&bytes);
    assert!(!before.measures.printable());
    assert_eq!(before.measures.unreadable_faces, 1);
    let corrupt = before.defects.iter().find(|group| group.kind == DefectKind::Corrupt).unwrap();
    let middle = (soup.positions[0] + soup.positions[1]) / 2.0;
    assert_eq!((corrupt.count, corrupt.places[0].at), (1, middle.to_array()));
    let repaired = run(&bytes, OutputFormat::Same);
    assert_eq!(repaired.report.outcome, Outcome::Repaired);
    assert!(inspected(&repaired.bytes).measures.printable());
}

#[test]
fn vertices_that_readers_take_for_one_are_merged_in_every_format() {
    // A cube with one corner split into two vertices 1e-16 apart.
    let mut soup = Surface::from_soup(&cube(DVec3::ZERO, 10.0, 1)).0.to_soup();
    let (edge, opposite) = split_at_origin(&mut soup);
    assert!(edge && opposite);
    assert!(!is_watertight_to_trimesh(&soup));
    for format in [Format::Stl, Format::Obj, Format::Ply, Format::Off, Format::Mesh] {
        let bytes = format::write(&soup, format).unwrap();
        let before = inspected(&bytes);
        assert!(before.measures.near_coincident_defects > 0 && !before.measures.printable(), "{format:?}");
        let repaired = run(&bytes, OutputFormat::Same);
        assert_eq!(repaired.report.outcome, Outcome::Repaired, "{format:?}");
        let after = format::read(&repaired.bytes, &Limits::default()).unwrap().soup;
        assert!(is_watertight_to_trimesh(&after) && inspected(&repaired.bytes).measures.printable(), "{format:?}");
        assert_eq!(after.faces.len(), 12);
    }
}

/// Splits an edge at the origin in both of its faces, at a vertex 1e-16 from the origin.
fn split_at_origin(soup: &mut Soup) -> (bool, bool) {
    let Some(corner) = soup.positions.iter().position(|p| *p == DVec3::ZERO) else { return (false, false) };
    let corner = u32::try_from(corner).unwrap();
    let near = u32::try_from(soup.positions.len()).unwrap();
    let face = soup.faces.iter().position(|face| face.contains(&corner)).unwrap();
    let k = soup.faces[face].iter().position(|&v| v == corner).unwrap();
    let end = soup.faces[face][(k + 1) % 3];
    let along = soup.positions[end as usize].normalize() * 1e-16;
    soup.positions.push(along.as_vec3().as_dvec3());
    let mut split = 0;
    for f in 0..soup.faces.len() {
        let face = soup.faces[f];
        if face.contains(&corner) && face.contains(&end) {
            soup.faces[f] = face.map(|v| if v == corner { near } else { v });
            soup.faces.push(face.map(|v| if v == end { near } else { v }));
            split += 1;
        }
    }
    (split > 0, split == 2)
}

#[test]
fn a_face_lower_than_the_tolerance_is_advice_and_not_a_broken_rule() {
    // A closed cube with a vertex a millionth of a millimetre off an edge's line: every reader accepts it.
    let mut soup = shared_cube();
    let [a, b, c] = soup.faces[0];
    let [p, q, r] = soup.corners(0);
    let new = u32::try_from(soup.positions.len()).unwrap();
    soup.positions.push((p + q) / 2.0 + (r - (p + q) / 2.0) * 5e-8);
    soup.faces[0] = [new, b, c];
    soup.faces.extend([[a, new, c], [a, b, new]]);
    let found = inspected(&format::write(&soup, Format::Ply).unwrap());
    assert!(found.measures.printable(), "{:?}", found.measures.faults());
    let check = found.check.unwrap();
    assert!(check.passes && check.advice.contains(&CheckRule::NoZeroAreaFace), "{check:?}");
    let ply = format::write(&soup, Format::Ply).unwrap();
    let summary =
        repair_bytes(&ply, &Options { output: OutputFormat::Same, ..Options::default() }, None).unwrap().report.summary;
    assert!(summary.contains("Left unchanged because slicers accept them: "), "{summary}");
    assert!(summary.contains(" of almost no height."), "{summary}");
}

#[test]
fn normals_that_point_into_the_mesh_are_left_out_of_the_result() {
    let soup = as_f32(shared_cube());
    let mut text = String::new();
    for p in &soup.positions {
        text += &format!("v {} {} {}\n", p.x, p.y, p.z);
    }
    for p in &soup.positions {
        let inward = DVec3::splat(6.0) - *p;
        text += &format!("vn {} {} {}\n", inward.x, inward.y, inward.z);
    }
    for face in &soup.faces {
        let [a, b, c] = face.map(|v| v + 1);
        text += &format!("f {a}//{a} {b}//{b} {c}//{c}\n");
    }
    let before = inspected(text.as_bytes());
    assert_eq!(before.check.unwrap().advice, [CheckRule::NoOpposedVertexNormal]);
    for output in [OutputFormat::Same, OutputFormat::Stl, OutputFormat::Ply] {
        let repaired = run(text.as_bytes(), output);
        assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
        assert!(repaired.report.warnings.iter().any(|warning| warning.contains("normal that points into the mesh")));
        let after = inspected(&repaired.bytes);
        assert!(after.defects.iter().all(|group| group.kind != DefectKind::BadVertexNormal));
        assert_eq!(after.measures.faces, 48);
    }
}

/// A cube with damage of the given kinds at the given faces.
fn damaged(ways: &[(u8, usize)]) -> Soup {
    let mut soup = shared_cube();
    for &(way, at) in ways {
        let face = at % soup.faces.len().max(1);
        match way % 8 {
            0 => drop(soup.faces.remove(face)),
            1 => soup.faces[face].swap(0, 1),
            2 => soup.faces.push(soup.faces[face]),
            3 => soup = unshared(&soup),
            4 => soup = join(&soup, &cube(DVec3::splat(5.0), 10.0, 1)),
            5 => drop(split_at_origin(&mut soup)),
            6 => soup = inside_out(soup),
            _ => {
                let corner = soup.faces[face][0];
                soup.positions[corner as usize] += DVec3::new(1e-9, 0.0, 1e-12);
                soup.faces.push([corner; 3]);
            }
        }
    }
    soup
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 6, ..ProptestConfig::default() })]

    #[test]
    fn the_outcome_the_check_and_an_inspection_of_the_result_agree_in_every_format(
        ways in prop::collection::vec((any::<u8>(), 0usize..48), 0..4),
        from in 0usize..5,
        to in 0usize..7,
    ) {
        let input = [Format::Stl, Format::Obj, Format::Ply, Format::Off, Format::Mesh][from];
        let output = [
            OutputFormat::Stl,
            OutputFormat::Obj,
            OutputFormat::Ply,
            OutputFormat::Off,
            OutputFormat::Mesh,
            OutputFormat::Glb,
            OutputFormat::ThreeMf,
        ][to];
        let bytes = format::write(&damaged(&ways), input).unwrap();
        let before = inspected(&bytes);
        prop_assert!(!before.measures.printable() || before.check.as_ref().is_some_and(|check| check.passes));
        let repaired = run(&bytes, output);
        let report = &repaired.report;
        prop_assert_eq!(before.measures.printable(), report.before.measures.printable());
        let Some(after) = &report.after else { return Ok(()) };
        let seen = inspected(&repaired.bytes);
        prop_assert_eq!(seen.measures.printable(), after.measures.printable(), "{:?}", seen.measures.faults());
        prop_assert_eq!(seen.check.map(|check| check.passes), after.check.as_ref().map(|check| check.passes));
        if report.outcome.is_printable() {
            prop_assert!(after.measures.printable() && after.check.as_ref().is_some_and(|check| check.passes));
            let file = format::read_shape(&repaired.bytes, &ReadOptions::within(Limits::default())).unwrap();
            prop_assert!(is_watertight_to_trimesh(&file.mesh.soup));
        } else {
            prop_assert!(!after.measures.printable() || !report.red_flags.is_empty());
        }
    }
}

#[test]
fn a_fold_of_zero_height_is_found_at_zero_tolerance() {
    // Two faces in an oblique plane, one folded back onto the other. In f64 the cross product of their heights is not 0.
    let soup = Soup {
        positions: [[0.125, 0.25, 0.375], [1.125, 0.5, 0.875], [0.375, 1.75, 0.625]].map(DVec3::from_array).to_vec(),
        faces: vec![[0, 1, 2]],
    };
    let [a, b, c] = soup.corners(0);
    let mut folded = soup.clone();
    // Exactly in the plane, since all coordinates are short binary fractions.
    folded.positions.push((a + c) * 0.5 + (b - a) * 0.25);
    folded.faces.push([1, 0, 3]);
    let tolerances = Tolerances { linear: Tolerance::Absolute(0.0), foldover_angle: 0.0, ..Tolerances::default() };
    let options = InspectOptions { tolerances, ..InspectOptions::default() };
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::MAX);
    let found = inspect((&folded).into(), &options, &context).unwrap().0;
    let folds = found.defects.iter().find(|group| group.kind == DefectKind::Foldover).unwrap();
    assert_eq!(folds.places[0].value, Some(0.0));
}

#[test]
fn a_model_in_millimetres_is_equally_printable_in_glb_which_uses_metres() {
    // 5e-6 mm, which is 5e-9 m: distinct with eight decimals in millimetres, but not in metres.
    let mut soup = Surface::from_soup(&cube(DVec3::ZERO, 10.0, 1)).0.to_soup();
    assert_eq!(split_at_origin(&mut soup), (true, true));
    let near = soup.positions.len() - 1;
    soup.positions[near] = (soup.positions[near].normalize() * 5e-6).as_vec3().as_dvec3();
    let bytes = format::write(&soup, Format::Stl).unwrap();
    let repaired = run(&bytes, OutputFormat::Glb);
    assert_eq!(repaired.report.outcome, Outcome::AlreadyPrintable);
    assert!(inspected(&repaired.bytes).measures.printable());
}
