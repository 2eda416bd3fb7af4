//! Repair of slivers, foldovers, overlapping faces, internal faces, slits and twisted polygons.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::format::{self, Format, Limits, ReadOptions};
use meshmend::inspect::{Measures, measure};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::foldovers::RemoveOverlappingNeighbours;
use meshmend::repair::operators::foldovers::UnfoldFoldovers;
use meshmend::repair::operators::slivers::RemoveSlivers;
use meshmend::repair::{ChangeKind, Context, NoProgress, Operator, Options, Outcome, OutputFormat, Repaired, repair};
use proptest::prelude::*;

use crate::meshes::{cube, join, push, sphere, torus};
use crate::support::{change_count, with_context};

const SLIVERS: RemoveSlivers = RemoveSlivers { tolerance: 1e-6, max_deviation: f64::INFINITY };
const FOLDS: UnfoldFoldovers = UnfoldFoldovers { angle: 0.01, height: 1e-7, max_deviation: f64::INFINITY };

fn surface(soup: &Soup) -> Surface {
    Surface::from_soup(soup).0
}

fn measured(soup: &Soup) -> Measures {
    with_context(|c| measure(soup, c)).unwrap()
}

/// Repairs without tier 3.
fn repair_without_tier_3(soup: &Soup, options: &Options) -> Repaired {
    let bytes = format::write(soup, Format::Obj).unwrap();
    let cancel = AtomicBool::new(false);
    let clock = || Duration::ZERO;
    let context = Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(600));
    let options = Options { max_tier: 2, pictures: false, output: OutputFormat::Obj, ..options.clone() };
    repair(&bytes, &options, &Limits::default(), None, &context).unwrap()
}

/// The smallest height or edge length of all faces.
fn thinnest(surface: &Surface) -> f64 {
    let of = |f: usize| {
        let [a, b, c] = surface.corners(f);
        let sides = [a.distance(b), b.distance(c), c.distance(a)];
        let height = surface.area_vector(f).length() / sides.into_iter().fold(0.0, f64::max);
        sides.into_iter().fold(height, f64::min)
    };
    (0..surface.faces.len()).map(of).fold(f64::INFINITY, f64::min)
}

/// Splits an edge of a face at a fraction of its length, in the neighbouring face too.
fn split(mesh: &mut Surface, face: usize, corner: usize, share: f64) {
    let (a, b) = (mesh.faces[face][corner], mesh.faces[face][(corner + 1) % 3]);
    let m = mesh.positions.len() as u32;
    mesh.positions.push(mesh.positions[a as usize].lerp(mesh.positions[b as usize], share));
    for f in 0..mesh.faces.len() {
        if mesh.faces[f].contains(&a) && mesh.faces[f].contains(&b) {
            let old = mesh.faces[f];
            mesh.faces[f] = old.map(|v| if v == a { m } else { v });
            mesh.push_patch(old.map(|v| if v == b { m } else { v }));
        }
    }
}

/// Inserts a vertex into a face, so near the middle of an edge that it leaves a cap.
fn cap(mesh: &mut Surface, face: usize, corner: usize, rise: f64) {
    let [a, b, c] = [0, 1, 2].map(|i| mesh.faces[face][(corner + i) % 3]);
    let m = mesh.positions.len() as u32;
    let at = |v: u32| mesh.positions[v as usize];
    let p = at(a).lerp(at(b), 0.45).lerp(at(c), rise);
    mesh.positions.push(p);
    mesh.faces[face] = [a, b, m];
    mesh.push_patch([b, c, m]);
    mesh.push_patch([c, a, m]);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    #[test]
    fn slivers_in_a_solid_are_removed_and_it_stays_closed_with_its_volume(
        ring in any::<bool>(),
        splits in prop::collection::vec((any::<prop::sample::Index>(), 0..3usize, 1e-9..1e-7f64), 1..12),
        caps in prop::collection::vec((any::<prop::sample::Index>(), 0..3usize, 1e-9..1e-7f64), 1..12),
    ) {
        let soup = if ring { torus(3.0, 1.0, 14, 8) } else { sphere(DVec3::ONE, 2.0, 12, 8) };
        let mut mesh = surface(&soup);
        let before = measured(&soup);
        for (at, corner, share) in &splits {
            let face = at.index(mesh.faces.len());
            split(&mut mesh, face, *corner, *share);
        }
        for (at, corner, rise) in &caps {
            let face = at.index(soup.faces.len());
            cap(&mut mesh, face, *corner, *rise);
        }
        prop_assume!(thinnest(&mesh) > 0.0);
        let applied = with_context(|c| SLIVERS.apply(&mut mesh, c)).unwrap();
        prop_assert_eq!(applied.left, None);
        let after = measured(&mesh.to_soup());
        prop_assert!(after.closed && after.manifold && after.consistent);
        prop_assert!((after.volume.value - before.volume.value).abs() < 1e-4);
        prop_assert!(thinnest(&mesh) > 6e-6, "{}", thinnest(&mesh));
        prop_assert!(applied.moved < 2e-5);
    }
}

#[test]
fn no_vertex_moves_farther_than_it_may() {
    let mut mesh = surface(&sphere(DVec3::ZERO, 1.0, 12, 8));
    split(&mut mesh, 7, 0, 1e-7);
    let kept = mesh.clone();
    let held = RemoveSlivers { max_deviation: 1e-9, ..SLIVERS };
    assert_eq!(with_context(|c| held.apply(&mut mesh, c)).unwrap().changes, []);
    assert_eq!(mesh, kept);
    assert_eq!(
        change_count(&with_context(|c| SLIVERS.apply(&mut mesh, c)).unwrap().changes, "short_edges_collapsed"),
        1
    );
}

#[test]
fn slivers_are_removed_beside_kept_faces_but_not_from_them() {
    let mut mesh = surface(&sphere(DVec3::ZERO, 1.0, 12, 8));
    let before: Vec<_> = (0..mesh.faces.len()).map(|face| mesh.face_key(face)).collect();
    split(&mut mesh, 7, 0, 1e-7);
    split(&mut mesh, 60, 1, 1e-7);
    let kept: Vec<bool> = (0..mesh.faces.len()).map(|face| before.contains(&mesh.face_key(face))).collect();
    let mut beside = mesh.clone();
    let applied = with_context(|c| SLIVERS.apply_beside(&kept, &mut beside, c)).unwrap();
    assert_eq!(change_count(&applied.changes, "short_edges_collapsed"), 2);
    let keys: Vec<_> = (0..beside.faces.len()).map(|face| beside.face_key(face)).collect();
    assert!(before.iter().all(|face| keys.contains(face)) && keys.len() == before.len());
    let all = vec![true; mesh.faces.len()];
    let split = mesh.clone();
    assert_eq!(with_context(|c| SLIVERS.apply_beside(&all, &mut mesh, c)).unwrap().changes, []);
    assert_eq!(mesh, split);
}

#[test]
fn a_solid_smaller_than_the_tolerance_is_not_lost() {
    let soup = join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::splat(3.0), 1e-7, 1));
    let mut mesh = surface(&soup);
    let applied = with_context(|c| SLIVERS.apply(&mut mesh, c)).unwrap();
    assert!(applied.left.is_some());
    let after = measured(&mesh.to_soup());
    assert!(after.closed && after.manifold);
    assert_eq!(after.parts, 2);
}

#[test]
fn slivers_beside_an_edge_of_three_faces_leave_that_edge() {
    let mut soup = cube(DVec3::ZERO, 1.0, 1);
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::new(0.5, -1.0, -1.0)]);
    let mut mesh = surface(&soup);
    let (face, corner) = (0..12)
        .flat_map(|f| (0..3).map(move |i| (f, i)))
        .find(|&(f, i)| {
            let [a, b] = [mesh.faces[f][i], mesh.faces[f][(i + 1) % 3]].map(|v| mesh.positions[v as usize]);
            a == DVec3::ZERO && b != DVec3::X && a.distance(b) < 1.1
        })
        .unwrap();
    split(&mut mesh, face, corner, 1e-8);
    let before = measured(&mesh.to_soup());
    with_context(|c| SLIVERS.apply(&mut mesh, c)).unwrap();
    let after = measured(&mesh.to_soup());
    assert_eq!((before.non_manifold_edges, after.non_manifold_edges), (1, 1));
    assert_eq!((after.boundary_edges, after.faces), (2, 13));
    assert!(mesh.positions.contains(&DVec3::ZERO), "the end of that edge stays where it was");
}

/// A cube with a vertex of its top moved within the top, across an edge.
fn folded_cube(to: [f64; 2]) -> Soup {
    let mut mesh = surface(&cube(DVec3::ZERO, 4.0, 4));
    let v = mesh.positions.iter().position(|&p| p == DVec3::new(2.0, 2.0, 4.0)).unwrap();
    mesh.positions[v] = DVec3::new(to[0], to[1], 4.0);
    mesh.to_soup()
}

fn turned_down(mesh: &Surface) -> usize {
    (0..mesh.faces.len())
        .filter(|&f| mesh.corners(f).iter().all(|p| p.z == 4.0) && mesh.area_vector(f).z <= 0.0)
        .count()
}

#[test]
fn a_foldover_is_unfolded_without_moving_a_vertex() {
    let mut mesh = surface(&folded_cube([2.7, 1.4]));
    assert!(turned_down(&mesh) > 0);
    let positions = mesh.positions.clone();
    let applied = with_context(|c| FOLDS.apply(&mut mesh, c)).unwrap();
    assert!(change_count(&applied.changes, "folds_flipped") > 0);
    assert_eq!(turned_down(&mesh), 0);
    assert_eq!(mesh.positions, positions);
    let after = measured(&mesh.to_soup());
    assert!(after.printable(), "{after:?}");
    assert!((after.volume.value - 64.0).abs() < 1e-9);
}

#[test]
fn a_foldover_is_mended_by_a_plan() {
    // Across one edge, and across a vertex, where no edge flip alone unfolds it.
    for to in [[2.7, 1.4], [3.2, 1.9]] {
        let repaired = repair_without_tier_3(&folded_cube(to), &Options::default());
        assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report.summary);
        let after = repaired.report.after.unwrap().measures;
        assert!((after.volume.value - 64.0).abs() < 1e-4 && after.parts == 1);
    }
}

#[test]
fn a_zero_thickness_plate_keeps_its_rim() {
    let mut soup = Soup::default();
    for z in [0.0, 1e-9] {
        let at = |i: u32, j: u32| {
            DVec3::new(f64::from(i), f64::from(j), if (1..3).contains(&i) && (1..3).contains(&j) { z } else { 0.0 })
        };
        for i in 0..3 {
            for j in 0..3 {
                let q = [at(i, j), at(i + 1, j), at(i + 1, j + 1), at(i, j + 1)];
                if z > 0.0 {
                    push(&mut soup, [q[0], q[1], q[2]]);
                    push(&mut soup, [q[0], q[2], q[3]]);
                } else {
                    push(&mut soup, [q[1], q[0], q[3]]);
                    push(&mut soup, [q[1], q[3], q[2]]);
                }
            }
        }
    }
    let mut mesh = surface(&soup);
    let before = mesh.clone();
    with_context(|c| FOLDS.apply(&mut mesh, c)).unwrap();
    assert_eq!(mesh, before);
}

#[test]
fn the_smaller_of_two_overlapping_neighbours_is_removed() {
    let mut soup = cube(DVec3::ZERO, 1.0, 1);
    // A face that is folded back onto the top from one of its edges.
    push(&mut soup, [DVec3::new(0.0, 0.0, 1.0), DVec3::new(1.0, 0.0, 1.0), DVec3::new(0.6, 0.2, 1.0)]);
    let mut mesh = surface(&soup);
    let applied = with_context(|c| RemoveOverlappingNeighbours::default().apply(&mut mesh, c)).unwrap();
    assert_eq!(change_count(&applied.changes, "overlapping_faces_removed"), 1);
    assert_eq!(mesh.faces.len(), 12);
    assert!(measured(&mesh.to_soup()).printable());
}

#[test]
fn the_sharp_edge_of_a_wedge_is_kept() {
    // Half a degree between its sides.
    let [a, b, c, d] = [DVec3::ZERO, DVec3::Y, DVec3::new(1.0, 0.5, 0.005), DVec3::new(1.0, 0.5, -0.005)];
    let mut soup = Soup::default();
    for t in [[a, c, b], [a, b, d], [a, d, c], [b, c, d]] {
        push(&mut soup, t);
    }
    let mut mesh = surface(&soup);
    let before = mesh.clone();
    let applied = with_context(|c| RemoveOverlappingNeighbours::default().apply(&mut mesh, c)).unwrap();
    assert_eq!((applied.changes, mesh), (Vec::new(), before));
}

/// Asserts that repair gives one solid of this volume, and this number of faces if given.
fn expect_solid(soup: &Soup, volume: f64, faces: Option<u64>, what: &str) {
    let repaired = repair_without_tier_3(soup, &Options::default());
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{what}: {}", repaired.report.summary);
    let after = repaired.report.after.unwrap().measures;
    assert!(after.printable(), "{what}: {after:?}");
    assert!((after.volume.value - volume).abs() < 1e-4, "{what}: {}", after.volume.value);
    if let Some(faces) = faces {
        assert_eq!(after.faces, faces, "{what}");
    }
}

fn both_sides(soup: &mut Soup, [a, b, c]: [DVec3; 3]) {
    push(soup, [a, b, c]);
    push(soup, [a, c, b]);
}

#[test]
fn a_zero_thickness_flap_is_removed_and_the_solid_stays() {
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let mut flap = cube(DVec3::ZERO, 1.0, 1);
    both_sides(&mut flap, [corner(0.0, 0.0, 0.0), corner(1.0, 0.0, 0.0), corner(0.5, -0.02, -0.02)]);
    expect_solid(&flap, 1.0, Some(12), "a flap of two faces");
}

#[test]
fn a_two_sided_sheet_inside_a_solid_is_removed() {
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let mut inside = cube(DVec3::ZERO, 4.0, 8);
    both_sides(&mut inside, [corner(1.0, 1.0, 1.0), corner(3.0, 1.0, 1.0), corner(2.0, 3.0, 2.0)]);
    expect_solid(&inside, 64.0, Some(768), "a sheet of two sides inside");
}

#[test]
fn complete_and_partial_zero_thickness_walls_in_a_solid_are_removed() {
    let corner = |x: f64, y: f64, z: f64| DVec3::new(x, y, z);
    let walls = |sides: usize, partial: bool| {
        let mut soup = cube(DVec3::ZERO, 4.0, 2);
        let q = [corner(2.0, 0.0, 0.0), corner(2.0, 2.0, 0.0), corner(2.0, 4.0, 0.0)];
        let r = [corner(2.0, 0.0, 2.0), corner(2.0, 2.0, 2.0), corner(2.0, 4.0, 2.0)];
        let s = [corner(2.0, 0.0, 4.0), corner(2.0, 2.0, 4.0), corner(2.0, 4.0, 4.0)];
        let mut quads = vec![[q[0], q[1], r[1], r[0]], [q[1], q[2], r[2], r[1]]];
        if !partial {
            quads.extend([[r[0], r[1], s[1], s[0]], [r[1], r[2], s[2], s[1]]]);
        }
        for [a, b, c, d] in quads {
            for t in [[a, b, c], [a, c, d]] {
                if sides == 2 { both_sides(&mut soup, t) } else { push(&mut soup, t) }
            }
        }
        soup
    };
    for (sides, partial) in [(1, false), (1, true), (2, false), (2, true)] {
        expect_solid(&walls(sides, partial), 64.0, None, &format!("a wall of {sides} sides, partial: {partial}"));
    }
}

#[test]
fn two_glued_solids_lose_the_wall_between_them() {
    expect_solid(&join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::X, 1.0, 2)), 2.0, Some(80), "two cubes");
}

/// A cube whose top has a slit that ends inside it, or at its rim if `through`.
fn slit_cube(through: bool, gap: f64) -> Soup {
    let mut mesh = surface(&cube(DVec3::ZERO, 4.0, 4));
    let on_line = |p: DVec3| p.z == 4.0 && p.y == 2.0 && (through || (p.x > 0.5 && p.x < 3.5));
    let count = mesh.positions.len();
    for v in 0..count {
        let p = mesh.positions[v];
        if on_line(p) {
            let copy = mesh.positions.len() as u32;
            mesh.positions.push(p + DVec3::new(0.0, gap, 0.0));
            for f in 0..mesh.faces.len() {
                let middle = mesh.corners(f).into_iter().sum::<DVec3>() / 3.0;
                if middle.z == 4.0 && middle.y > 2.0 {
                    for w in &mut mesh.faces[f] {
                        *w = if *w as usize == v { copy } else { *w };
                    }
                }
            }
        }
    }
    mesh.to_soup()
}

#[test]
fn slits_are_closed_at_zero_distance_and_within_the_tolerance() {
    for through in [false, true] {
        // Vertices at equal positions are merged on reading.
        let exact = slit_cube(through, 0.0);
        assert!(measured(&exact).printable());
        for gap in [1e-9, 4e-6] {
            let soup = slit_cube(through, gap);
            assert!(measured(&soup).boundary_edges > 0);
            expect_solid(&soup, 64.0, Some(192), "a slit");
        }
    }
}

#[test]
fn a_slit_beside_a_non_manifold_edge_is_closed_too() {
    let slit = slit_cube(true, 1e-6);
    expect_solid(
        &join(&slit, &cube(DVec3::new(4.0, 4.0, 0.0), 4.0, 4)),
        128.0,
        None,
        "a slit and an edge of four faces",
    );
}

#[test]
fn operators_that_are_switched_off_do_not_run() {
    let mut mesh = surface(&sphere(DVec3::ZERO, 1.0, 12, 8));
    split(&mut mesh, 30, 0, 1e-8);
    mesh.faces.remove(3);
    mesh.source.remove(3);
    let ran = |options: &Options| {
        let steps = repair_without_tier_3(&mesh.to_soup(), options).report.steps;
        steps.iter().flat_map(|s| s.changed.clone()).any(|c| c.kind == ChangeKind::ShortEdgesCollapsed)
    };
    assert!(ran(&Options::default()));
    assert!(!ran(&Options { without: vec![Operator::RemoveSlivers], ..Options::default() }));
    assert!(!ran(&Options { degenerate_tolerance: 0.0, ..Options::default() }));
}

fn obj(corners: &[[f64; 3]]) -> Vec<u8> {
    let mut text = String::new();
    for [x, y, z] in corners {
        text.push_str(&format!("v {x} {y} {z}\n"));
    }
    text.push('f');
    for k in 1..=corners.len() {
        text.push_str(&format!(" {k}"));
    }
    text.into_bytes()
}

/// The largest angle between faces that share an edge, in degrees.
fn worst_fold(soup: &Soup) -> f64 {
    let mesh = surface(soup);
    let mut worst: f64 = 0.0;
    for f in 0..mesh.faces.len() {
        for g in 0..f {
            if mesh.faces[f].iter().filter(|v| mesh.faces[g].contains(v)).count() == 2 {
                worst = worst.max(mesh.area_vector(f).angle_between(mesh.area_vector(g)));
            }
        }
    }
    worst.to_degrees()
}

fn read(bytes: &[u8], twist_angle_deg: f64) -> format::ReadMesh {
    format::read_with(bytes, &ReadOptions { twist_angle_deg, ..ReadOptions::default() }).unwrap()
}

#[test]
fn a_twisted_quad_is_cut_along_the_diagonal_of_the_lesser_fold() {
    // A kite bent along its long diagonal, with its corners numbered so that a planar cut takes the other diagonal.
    for turn in 0..2 {
        let mut kite = [[0.0, 0.0, 0.0], [1.0, -0.3, 0.6], [4.0, 0.0, 0.0], [1.0, 0.3, 0.6]];
        kite.rotate_left(turn);
        let (flat, twisted) = (read(&obj(&kite), 180.0), read(&obj(&kite), 5.0));
        assert_eq!((flat.polygons.count, flat.polygons.twisted, twisted.polygons.twisted), (1, 0, 1));
        assert!(flat.polygons.largest_twist_deg > 10.0 && flat.polygons.largest_twist_deg < 90.0);
        assert!(twisted.warnings.iter().any(|w| w.contains("least fold")), "{:?}", twisted.warnings);
        assert!(worst_fold(&twisted.soup) <= worst_fold(&flat.soup) + 1e-9);
        assert!(worst_fold(&twisted.soup) < 60.0, "{}", worst_fold(&twisted.soup));
    }
}

#[test]
fn a_flat_polygon_has_no_twist() {
    let square = read(&obj(&[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0], [0.0, 1.0, 1.0]]), 0.0);
    assert_eq!((square.polygons.twisted, square.polygons.largest_twist_deg), (0, 0.0));
    assert!(square.warnings.is_empty());
    let triangle = read(&obj(&[[0.0, 0.0, 1.0], [1.0, 0.0, 1.0], [1.0, 1.0, 1.0]]), 5.0);
    assert_eq!(triangle.polygons.count, 0);
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(64))]

    #[test]
    fn twisted_polygons_are_cut_into_a_disk_with_all_corners(
        heights in prop::collection::vec(-1.0..1.0f64, 4..16),
    ) {
        let n = heights.len();
        let corners: Vec<[f64; 3]> = heights.iter().enumerate().map(|(k, &z)| {
            let (sin, cos) = (k as f64 / n as f64 * std::f64::consts::TAU).sin_cos();
            [3.0 * cos, 2.0 * sin, z]
        }).collect();
        let twisted = read(&obj(&corners), 0.0);
        prop_assert_eq!(twisted.soup.faces.len(), n - 2);
        let m = measured(&twisted.soup);
        prop_assert_eq!((m.boundary_edges, m.non_manifold_edges, m.boundary_loops), (n as u64, 0, 1));
        prop_assert!(m.consistent);
    }
}
