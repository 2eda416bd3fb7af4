//! Inspection finds exactly the known defects of meshes, at their places, in any representation of the mesh.

mod examples;

use std::collections::BTreeMap;
use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::context::{Context, NoProgress};
use meshmend::inspect::{
    Defect, DefectKind, FileFacts, Findings, InspectOptions, Inspection, Level, Subject, Tolerance, Tolerances, inspect,
};
use meshmend::mesh::{CornerNormals, Soup};
use proptest::prelude::*;

use crate::meshes::{cube, inside_out, join, push, sphere, torus};
use DefectKind as K;
use examples::{
    block, cut, damaged, faces_with, first_equal_face, folded, indexed, moved, top, variant, with_t_junction, without,
};

fn with_normals<'a>(soup: &'a Soup, normals: Option<&'a CornerNormals>) -> Subject<'a> {
    Subject { facts: FileFacts { normals, ..FileFacts::default() }, ..Subject::from(soup) }
}

fn look(subject: Subject<'_>, options: &InspectOptions) -> (Inspection, Findings) {
    let (cancel, clock) = (AtomicBool::new(false), || Duration::ZERO);
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1));
    inspect(subject, options, &context).unwrap()
}

fn findings(soup: &Soup) -> Findings {
    look(soup.into(), &InspectOptions::default()).1
}

/// The count of each kind of defect, except self-intersections, which `intersections.rs` tests.
fn counts(findings: &Findings) -> BTreeMap<DefectKind, u64> {
    let found = K::ALL.into_iter().map(|kind| (kind, findings.count(kind)));
    found.filter(|&(kind, count)| count > 0 && kind != K::SelfIntersection).collect()
}

fn only_defect(findings: &Findings, kind: DefectKind) -> Defect {
    let [one] = findings.places(kind) else { panic!("{kind:?}: {:?}", findings.places(kind)) };
    one.clone()
}

#[test]
fn clean_meshes_have_no_defects() {
    for (name, soup) in [
        ("cube", cube(DVec3::splat(-3.0), 2.0, 5)),
        ("sphere", sphere(DVec3::X, 1.0, 24, 16)),
        ("fine sphere far away", sphere(DVec3::splat(1e4), 1.0, 60, 40)),
        ("torus", torus(2.0, 0.5, 32, 16)),
        ("thin torus", torus(2.0, 0.01, 200, 8)),
    ] {
        let (inspection, found) = look((&soup).into(), &InspectOptions::default());
        assert_eq!(counts(&found), BTreeMap::new(), "{name}");
        let check = inspection.check.unwrap();
        assert!(check.broken.is_empty() && inspection.incomplete.is_empty(), "{name}");
    }
}

#[test]
fn every_damage_is_found_and_nothing_else() {
    for (name, soup, expected) in damaged() {
        assert_eq!(counts(&findings(&soup)), expected.into_iter().collect(), "{name}");
    }
}

#[test]
fn as_many_defects_are_placed_as_the_measures_count() {
    for (name, soup, _) in damaged() {
        let (inspection, found) = look((&soup).into(), &InspectOptions::default());
        let m = &inspection.measures;
        for (kind, measured) in [
            (K::Hole, m.boundary_loops),
            (K::NonManifoldEdge, m.non_manifold_edges),
            (K::NonManifoldVertex, m.non_manifold_vertices),
            (K::MisorientedEdge, m.misoriented_edges),
            (K::Corrupt, m.non_finite_faces),
            (K::InvertedPart, m.inverted_parts),
            (K::Disjoint, m.parts - 1),
        ] {
            assert_eq!(found.count(kind), measured, "{name}: {kind:?}");
        }
        assert_eq!(found.count(K::DuplicateFace) + found.count(K::OppositeFace), m.duplicate_faces, "{name}");
        assert!(found.count(K::FlatFace) >= m.degenerate_faces, "{name}");
        let listed: u64 = inspection.defects.iter().map(|group| group.count).sum();
        assert_eq!(listed, K::ALL.into_iter().map(|kind| found.count(kind)).sum::<u64>());
    }
}

#[test]
fn holes_slits_and_cracks_are_where_they_were_cut() {
    let hole = only_defect(&findings(&without(block(), 100)), K::Hole);
    let corners = block().corners(100).map(|p| p.to_array());
    assert_eq!((hole.line.len(), hole.line.first()), (4, hole.line.last()));
    assert!(corners.iter().all(|p| hole.line.contains(p)));
    let length: f64 = hole.line.windows(2).map(|w| DVec3::from(w[0]).distance(DVec3::from(w[1]))).sum();
    assert_eq!(hole.value, Some(length));

    for (gap, kind) in [(1e-9, K::Slit), (5e-5, K::Crack)] {
        let defect = only_defect(&findings(&cut(gap)), kind);
        assert!((defect.value.unwrap() / gap - 1.0).abs() < 1e-6, "{defect:?}");
        // Both sides of the slit, from one end to the other and back.
        assert_eq!(defect.line.len(), 7);
        for i in 2..6 {
            assert!(defect.line.contains(&top(i, 4).to_array()), "{i}");
        }
        assert_eq!(defect.faces.len(), 6);
    }
}

#[test]
fn the_value_of_a_t_junction_distinguishes_exact_from_near() {
    for off in [0.0, 1e-8] {
        let (soup, m, _) = with_t_junction(off);
        let defect = only_defect(&findings(&soup), K::TJunction);
        assert_eq!(defect.at, m.to_array());
        assert!((defect.value.unwrap() - off).abs() < 1e-12);
        assert_eq!(defect.value == Some(0.0), off == 0.0);
        let mut line = defect.line.clone();
        line.sort_by(|a, b| a[0].total_cmp(&b[0]));
        assert_eq!(line, [top(3, 4).to_array(), top(4, 4).to_array()]);
    }
    let exact = Tolerances { t_junction: Some(Tolerance::Absolute(0.0)), ..Tolerances::default() };
    let options = InspectOptions { tolerances: exact, ..InspectOptions::default() };
    assert_eq!(look((&with_t_junction(0.0).0).into(), &options).1.count(K::TJunction), 1);
    assert_eq!(look((&with_t_junction(1e-8).0).into(), &options).1.count(K::TJunction), 0);
}

#[test]
fn a_foldover_names_its_faces_and_draws_its_folds() {
    let soup = folded();
    let defect = only_defect(&findings(&soup), K::Foldover);
    let upside_down: Vec<u32> = (0..u32::try_from(soup.faces.len()).unwrap())
        .filter(|&f| {
            let [a, b, c] = soup.corners(f as usize);
            [a, b, c].iter().all(|p| p.z == 1.0) && (b - a).cross(c - a).z < 0.0
        })
        .collect();
    assert_eq!(upside_down.len(), 2);
    assert!(upside_down.iter().all(|f| defect.faces.contains(f)));
    // Four folds around two faces, each with one neighbouring face.
    assert_eq!((defect.line.len(), defect.faces.len()), (5, 6));
    assert!(defect.value.unwrap() < 1e-12);
}

#[test]
fn a_fold_is_found_only_within_the_tolerances() {
    // A flap on a plate, at an angle of 0.004: at its tip 0.0005 above it.
    let flap = |tolerances: Tolerances| {
        let mut soup = block();
        let gone = faces_with(&soup, &[top(3, 4), top(4, 4)])[0];
        let [a, b, c] = soup.corners(gone);
        soup.faces.remove(gone);
        let apex = [a, b, c].into_iter().find(|p| ![top(3, 4), top(4, 4)].contains(p)).unwrap();
        let mirrored = DVec3::new(apex.x, 1.0 - apex.y, 1.0 + 0.004 * (apex.y - 0.5).abs());
        push(&mut soup, [a, b, c].map(|p| if p == apex { mirrored } else { p }));
        look((&soup).into(), &InspectOptions { tolerances, ..InspectOptions::default() }).1.count(K::Foldover)
    };
    let height = Some(Tolerance::Absolute(0.001));
    assert_eq!(flap(Tolerances::default()), 0);
    assert_eq!(flap(Tolerances { foldover_height: height, ..Tolerances::default() }), 1);
    assert_eq!(flap(Tolerances { foldover_height: height, foldover_angle: 0.003, ..Tolerances::default() }), 0);
}

#[test]
fn inner_shells_are_classified_by_depth_and_orientation() {
    let shell = |size: f64| cube(DVec3::splat(-size), 2.0 * size, 1);
    let nested = join(&join(&shell(8.0), &inside_out(shell(4.0))), &join(&shell(2.0), &inside_out(shell(1.0))));
    let depths =
        |soup: &Soup| -> Vec<f64> { findings(soup).places(K::InnerShell).iter().map(|d| d.value.unwrap()).collect() };
    assert_eq!(depths(&nested), [1.0, -2.0, 3.0]);
    assert_eq!(depths(&join(&shell(2.0), &shell(1.0))), [-1.0]);
    let wrong = join(&join(&shell(8.0), &inside_out(shell(4.0))), &inside_out(shell(2.0)));
    let found = findings(&wrong);
    assert_eq!(only_defect(&found, K::InvertedPart).value, Some(2.0));
    assert_eq!(found.marks[24..].iter().map(|m| m & K::InvertedPart.bit()).collect::<Vec<_>>(), [1 << 14; 12]);
}

#[test]
fn faces_below_the_tolerance_are_flat_or_degenerate_with_their_size() {
    let sliver = |height: f64, short: f64| {
        let mut soup = cube(DVec3::ZERO, 1.0, 1);
        let first = DVec3::new(0.0, 3.0, 0.0);
        push(&mut soup, [first, first + DVec3::X * 0.5, first + DVec3::new(0.25, height, 0.0)]);
        push(&mut soup, [first + DVec3::Z, first + DVec3::new(1.0, 0.0, 1.0), first + DVec3::new(0.0, short, 1.0)]);
        findings(&soup)
    };
    let found = sliver(1e-9, 2e-9);
    assert_eq!((found.count(K::FlatFace), found.count(K::DegenerateFace)), (2, 1));
    let degenerate = only_defect(&found, K::DegenerateFace);
    assert_eq!(degenerate.faces, [13]);
    assert!((degenerate.value.unwrap() / 2e-9 - 1.0).abs() < 1e-6);
    assert!((found.places(K::FlatFace)[0].value.unwrap() / 1e-9 - 1.0).abs() < 1e-6);
    let none = sliver(1e-3, 1e-3);
    assert_eq!((none.count(K::FlatFace), none.count(K::DegenerateFace)), (0, 0));
}

#[test]
fn level_basic_leaves_out_what_needs_a_search_and_none_everything() {
    let all = damaged();
    let soup = all.iter().map(|(_, soup, _)| soup).fold(Soup::default(), |a, b| join(&a, b));
    let at = |level| look((&soup).into(), &InspectOptions { level, ..InspectOptions::default() });
    let (none, nothing) = at(Level::None);
    assert_eq!((counts(&nothing), none.check), (BTreeMap::new(), None));
    let basic = at(Level::Basic).1;
    for kind in [K::Slit, K::Crack, K::TJunction, K::InnerShell] {
        assert_eq!(basic.count(kind), 0, "{kind:?}");
        assert!(all.iter().any(|(_, _, found)| found.iter().any(|(k, _)| *k == kind)));
    }
    assert!(basic.count(K::Hole) > 0 && basic.count(K::Sheet) > 0);
}

#[test]
fn vertex_normals_that_point_into_the_mesh_are_found() {
    let soup = indexed(&sphere(DVec3::ZERO, 1.0, 12, 8));
    let mut normals: Vec<[f32; 3]> = soup.positions.iter().map(|p| p.as_vec3().to_array()).collect();
    let look_at = |normals: &CornerNormals| {
        let subject = with_normals(&soup, Some(normals));
        look(subject, &InspectOptions::default()).1
    };
    assert_eq!(counts(&look_at(&CornerNormals::OfVertices(normals.clone()))), BTreeMap::new());
    normals[5] = normals[5].map(|x| -x);
    normals[9] = [0.0, f32::NAN, 1.0];
    let found = look_at(&CornerNormals::OfVertices(normals.clone()));
    assert_eq!(counts(&found), [(K::BadVertexNormal, 1)].into());
    let bad = only_defect(&found, K::BadVertexNormal);
    assert_eq!(bad.at, soup.positions[5].to_array());
    assert!(bad.value.unwrap() > 2.5);

    // Flat shading with one wrong corner normal, at a vertex that has several normals.
    let normal = |f: usize| {
        let [a, b, c] = soup.corners(f);
        (b - a).cross(c - a).as_vec3().to_array()
    };
    let mut normals: Vec<[f32; 3]> = (0..soup.faces.len()).map(normal).collect();
    let count = u32::try_from(normals.len()).unwrap();
    normals.push(normals[30].map(|x| -x));
    let mut faces: Vec<[u32; 3]> = (0..count).map(|f| [f; 3]).collect();
    faces[30][1] = count;
    faces[31][2] = u32::MAX;
    let found = look_at(&CornerNormals::OfCorners { normals, faces });
    assert_eq!(counts(&found), [(K::BadVertexNormal, 1)].into());
    assert_eq!(only_defect(&found, K::BadVertexNormal).faces, [30]);
    let at = soup.positions[soup.faces[30][1] as usize].to_array();
    assert_eq!(only_defect(&found, K::BadVertexNormal).at, at);
}

#[test]
fn a_facet_normal_against_its_corners_is_bad_at_all_three() {
    let soup = cube(DVec3::ZERO, 1.0, 2);
    let mut bytes = meshmend::format::write(&soup, meshmend::format::Format::Stl).unwrap();
    for at in [84 + 50 * 17, 84 + 50 * 17 + 4, 84 + 50 * 17 + 8] {
        let x = f32::from_le_bytes(bytes[at..at + 4].try_into().unwrap());
        bytes[at..at + 4].copy_from_slice(&(-x).to_le_bytes());
    }
    let read = meshmend::format::read(&bytes, &meshmend::format::Limits::default()).unwrap();
    let subject = with_normals(&read.soup, read.normals.as_ref());
    let (inspection, found) = look(subject, &InspectOptions { level: Level::Basic, ..InspectOptions::default() });
    assert_eq!(counts(&found), [(K::BadVertexNormal, 3)].into());
    assert!(found.places(K::BadVertexNormal).iter().all(|bad| bad.faces == [17]));
    let check = inspection.check.unwrap();
    assert_eq!((check.passes, check.advice), (true, vec![meshmend::inspect::CheckRule::NoOpposedVertexNormal]));
}

#[test]
fn crafted_boundaries_stop_at_the_budget_and_are_reported() {
    // Edges of many triangles, all close enough to each other to be slits.
    let mut soup = Soup::default();
    for i in 0..10_000 {
        let off = DVec3::new(0.0, f64::from(i) * 1e-13, 0.0);
        let (y, z) = (f64::from(i) / 1e3).sin_cos();
        push(&mut soup, [off, DVec3::X + off, DVec3::new(0.5, y, z)]);
    }
    let tolerances = Tolerances { linear: Tolerance::Absolute(1e-6), ..Tolerances::default() };
    let (inspection, found) = look((&soup).into(), &InspectOptions { tolerances, ..InspectOptions::default() });
    assert!(found.count(K::Slit) > 0);
    assert!(inspection.incomplete.contains(&K::Slit), "{:?}", inspection.incomplete);
}

#[test]
fn meshes_made_to_be_slow_are_inspected_quickly() {
    let begin = std::time::Instant::now();
    let circle = |i: u32| {
        let (y, x) = (f64::from(i) * 1e-5).sin_cos();
        DVec3::new(x, y, 0.0)
    };
    // A fan of slivers around one vertex, each overlapping its neighbours.
    let mut fan = Soup::default();
    // Many triangles that share only one vertex, and many around one edge.
    let (mut pinch, mut book) = (Soup::default(), Soup::default());
    // Many coincident faces with alternating orientation.
    let mut pile = Soup::default();
    for i in 0..5_000 {
        push(&mut fan, [DVec3::Z, circle(i), circle(i + 1)]);
        push(&mut pinch, [DVec3::ZERO, circle(2 * i), circle(2 * i + 1)]);
        push(&mut book, [DVec3::ZERO, DVec3::Z, circle(i)]);
        let off = DVec3::new(0.0, 0.0, f64::from(i) * 1e-13);
        let corners = [DVec3::ZERO, DVec3::X, DVec3::Y].map(|p| p + off);
        push(&mut pile, if i % 2 == 0 { corners } else { [corners[0], corners[2], corners[1]] });
    }
    assert!(findings(&fan).count(K::Hole) == 1);
    assert_eq!(only_defect(&findings(&pinch), K::NonManifoldVertex).value, Some(5e3));
    let edge = only_defect(&findings(&book), K::NonManifoldEdge);
    assert_eq!((edge.value, edge.faces.len()), (Some(5e3), 1000));
    assert!(findings(&pile).count(K::Sheet) > 0);
    assert!(begin.elapsed().as_secs() < 60, "{:?}", begin.elapsed());
}

#[test]
fn coordinates_near_the_ends_of_f64_change_no_count() {
    for power in [-900, 900] {
        for (name, soup, expected) in damaged() {
            let found = counts(&findings(&variant(&soup, 1, 5, power).soup));
            assert_eq!(found, expected.into_iter().collect(), "{name} {power}");
        }
    }
}

/// The places of one kind of defect: faces, numbered as in the original mesh, and the points of the lines.
fn places(
    found: &Findings,
    kind: DefectKind,
    was: &[u32],
    turn: impl Fn(DVec3) -> DVec3,
) -> Vec<(Vec<u32>, Vec<String>)> {
    let mut all: Vec<_> = found
        .places(kind)
        .iter()
        .map(|defect| {
            let mut faces: Vec<u32> = defect.faces.iter().map(|&f| was[f as usize]).collect();
            faces.sort_unstable();
            faces.dedup();
            let mut line: Vec<String> =
                defect.line.iter().map(|&p| format!("{:?}", (turn(DVec3::from(p)) + 0.0).to_array())).collect();
            line.sort_unstable();
            line.dedup();
            (faces, line)
        })
        .collect();
    all.sort_unstable();
    all
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(96))]

    #[test]
    fn the_same_is_found_at_the_same_places_however_a_mesh_is_written_down(
        seed in any::<u64>(), turns in 0usize..12, power in -150i32..150, damage in 0usize..25,
    ) {
        let all = damaged();
        let (name, soup, expected) = &all[damage % all.len()];
        let changed = variant(soup, seed, turns, power);
        let (first, second) = (findings(soup), findings(&changed.soup));
        prop_assert_eq!(counts(&second), expected.iter().copied().collect::<BTreeMap<_, _>>(), "{}", name);
        let same = first_equal_face(soup);
        let was: Vec<u32> = changed.was.iter().map(|&f| same[f as usize]).collect();
        for kind in K::ALL.into_iter().filter(|&kind| kind != K::SelfIntersection) {
            let here = places(&first, kind, &same, |p| moved(p, turns, power));
            let there = places(&second, kind, &was, |p| p);
            prop_assert_eq!(here, there, "{} {:?}", name, kind);
        }
    }
}
