//! Simplification: fewer faces within the tolerance, and a printable model stays printable.

use glam::DVec3;
use meshmend::inspect::{Analysis, CompareOptions, compare, measure};
use meshmend::math::Precision;
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::{Context, NoProgress, Options, Outcome};
use meshmend::simplify::{Simplified, Simplify};
use proptest::prelude::*;

use crate::meshes::{as_f32, cube, inside_out, join, sheet, sphere, torus};
use crate::support::{measured_as_stl, repair_soup, with_context};

const EXACT: Simplify =
    Simplify { max_faces: None, max_error: 1e-9, everywhere: true, feature_angle_deg: 50.0, precision: Precision::F32 };

fn to_faces(max_faces: u64) -> Simplify {
    Simplify { max_faces: Some(max_faces), max_error: f64::INFINITY, ..EXACT }
}

fn simplified(soup: &Soup, with: &Simplify) -> (Surface, Simplified) {
    let (mut surface, _) = Surface::from_soup(soup);
    let done = with_context(|c| with.apply(&mut surface, c)).unwrap();
    surface.check().unwrap();
    assert_eq!((done.faces_before, done.faces_after), (soup.faces.len() as u64, surface.faces.len() as u64));
    (surface, done)
}

/// The largest distance of samples of either surface from the other.
fn distance(before: &Soup, after: &Surface) -> f64 {
    let after = after.to_soup();
    with_context(|c| {
        let (a, b) = (Analysis::new(before.into(), c).unwrap(), Analysis::new((&after).into(), c).unwrap());
        let there = compare(&a, &b, CompareOptions::BRIEF, c).unwrap();
        let back = compare(&b, &a, CompareOptions::BRIEF, c).unwrap();
        [there, back].map(|comparison| comparison.deviation.unwrap().distance.max).into_iter().fold(0.0, f64::max)
    })
}

#[test]
fn a_cube_of_many_faces_comes_back_as_twelve() {
    let (surface, done) = simplified(&cube(DVec3::ZERO, 1.0, 32), &EXACT);
    assert_eq!(surface.faces.len(), 12, "{done:?}");
    let measures = measured_as_stl(&surface);
    assert!(measures.printable() && measures.volume.value == 1.0, "{measures:?}");
    assert!(done.error < 1e-12 && done.shortfall.is_none(), "{done:?}");
}

#[test]
fn a_turned_box_whose_planes_f32_rounds_loses_all_that_its_planes_do_not_need() {
    let mut soup = cube(DVec3::ZERO, 1.0, 20);
    let turn = glam::DMat3::from_euler(glam::EulerRot::XYZ, 0.3, 0.7, 1.1);
    soup.positions.iter_mut().for_each(|p| *p = turn * (*p * DVec3::new(4.0, 1.0, 0.2)) + 5.0);
    let soup = as_f32(soup);
    let (surface, done) = simplified(&soup, &Simplify { max_error: 1e-5, ..EXACT });
    assert_eq!(surface.faces.len(), 12, "{done:?}");
    assert!(measured_as_stl(&surface).printable() && (measured_as_stl(&surface).volume.value - 0.8).abs() < 1e-4);
    let corners =
        (0..8).map(|i| turn * DVec3::new(f64::from(i & 1) * 4.0, f64::from(i >> 1 & 1), f64::from(i >> 2) * 0.2));
    for corner in corners.map(|p| p + 5.0) {
        assert!(surface.positions.iter().any(|p| p.distance(corner) < 1e-6), "{corner}");
    }
}

#[test]
fn a_ball_stays_within_the_error_that_was_asked_for() {
    let soup = as_f32(sphere(DVec3::new(3.0, 1.0, -2.0), 2.0, 128, 64));
    for (max_error, most_faces) in [(0.1, 400), (0.01, 2500)] {
        let (surface, done) = simplified(&soup, &Simplify { max_error, ..EXACT });
        let measures = measured_as_stl(&surface);
        assert!(measures.printable(), "{measures:?}");
        let distance = distance(&soup, &surface);
        assert!(
            distance <= 1.2 * max_error && distance <= done.bound && done.error <= max_error,
            "{distance} {done:?}"
        );
        assert!(surface.faces.len() < most_faces, "{done:?}");
    }
}

#[test]
fn walls_as_thin_as_paper_do_not_cross() {
    // A thin shell: a ball with a cavity a hundredth below its surface.
    let soup = as_f32(join(&sphere(DVec3::ZERO, 1.0, 64, 32), &inside_out(sphere(DVec3::ZERO, 0.99, 61, 33))));
    let (surface, done) = simplified(&soup, &to_faces(300));
    let measures = measured_as_stl(&surface);
    assert!(measures.printable() && measures.parts == 2, "{measures:?} {done:?}");
    assert!(surface.faces.len() < 4000, "{done:?}");
}

#[test]
fn nested_shells_stay_nested_and_none_vanishes() {
    let mut soup = Soup::default();
    for (i, radius) in [1.0, 0.8, 0.6, 0.02].into_iter().enumerate() {
        let ball = sphere(DVec3::ZERO, radius, 32, 16);
        soup = join(&soup, &if i % 2 == 0 { ball } else { inside_out(ball) });
    }
    let (surface, _) = simplified(&as_f32(soup), &to_faces(100));
    let measures = measured_as_stl(&surface);
    assert!(measures.printable() && measures.parts == 4, "{measures:?}");
    assert!(surface.faces.len() <= 100);
}

#[test]
fn a_ring_keeps_its_hole_however_few_faces_are_asked_for() {
    let (surface, done) = simplified(&as_f32(torus(2.0, 0.5, 48, 24)), &to_faces(4));
    let measures = measured_as_stl(&surface);
    assert!(measures.printable() && measures.parts == 1, "{measures:?}");
    let (faces, vertices) = (surface.faces.len() as i64, surface.positions.len() as i64);
    assert_eq!(vertices - faces / 2, 0, "the Euler characteristic of a torus");
    assert!(faces < 100 && done.shortfall.is_some(), "{done:?}");
}

#[test]
fn an_open_sheet_keeps_its_boundary() {
    let flat = |mut soup: Soup| {
        soup.positions.iter_mut().for_each(|p| p.z = 0.0);
        soup
    };
    let (surface, done) = simplified(&flat(sheet(20)), &EXACT);
    assert_eq!((surface.faces.len(), surface.positions.len()), (2, 4), "{done:?}");
    // A wavy sheet, whose boundary is a wave on two sides.
    let wavy = as_f32(sheet(40));
    let (surface, done) = simplified(&wavy, &Simplify { max_error: 0.1, ..EXACT });
    let result = with_context(|c| measure(&surface.to_soup(), c)).unwrap();
    assert!(result.boundary_loops == 1 && result.self_intersections.pairs == Some(0), "{result:?}");
    let distance = distance(&wavy, &surface);
    assert!(distance <= 0.12 && distance <= done.bound && done.error <= 0.1, "{distance} {done:?}");
    assert!(surface.faces.len() < wavy.faces.len() / 3, "{done:?}");
}

#[test]
fn a_minimal_mesh_comes_back_bit_for_bit() {
    let tetrahedron = Soup {
        positions: vec![DVec3::new(0.1, 0.2, 0.3), DVec3::X * 3.0, DVec3::Y * 2.0, DVec3::Z * 7.7],
        faces: vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]],
    };
    for (soup, with) in [(&tetrahedron, to_faces(1)), (&cube(DVec3::splat(0.1), 0.7, 1), EXACT)] {
        let (before, _) = Surface::from_soup(soup);
        assert_eq!(simplified(soup, &with).0, before);
    }
}

#[test]
fn faces_keep_their_source_and_their_order() {
    let (surface, _) = simplified(&as_f32(torus(2.0, 0.5, 48, 24)), &to_faces(500));
    assert_eq!(surface.faces.len(), 500);
    assert!(surface.source.is_sorted() && surface.source.iter().all(|&s| s < 2304));
    assert!(surface.positions.iter().all(|p| p.as_vec3().as_dvec3() == *p), "f32 holds every position");
}

#[test]
fn faces_that_intersect_do_not_become_more() {
    let soup = as_f32(join(&sphere(DVec3::ZERO, 1.0, 48, 24), &sphere(DVec3::X, 1.0, 47, 25)));
    let pairs = |soup: &Soup| with_context(|c| measure(soup, c)).unwrap().self_intersections.pairs.unwrap();
    let (surface, _) = simplified(&soup, &to_faces(1000));
    assert!(surface.faces.len() < 3000);
    assert!(pairs(&surface.to_soup()) <= pairs(&soup));
}

#[test]
fn vertices_split_at_one_position_do_not_move() {
    // Two cubes that share an edge with separate vertices.
    let (a, b) = (cube(DVec3::ZERO, 1.0, 6), cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 6));
    let (mut surface, _) = Surface::from_soup(&a);
    let (other, _) = Surface::from_soup(&b);
    let first = surface.positions.len() as u32;
    surface.positions.extend(other.positions);
    surface.faces.extend(other.faces.iter().map(|f| f.map(|v| v + first)));
    surface.source = (0..surface.faces.len() as u32).collect();
    with_context(|c| EXACT.apply(&mut surface, c)).unwrap();
    let doubled = surface.positions.iter().filter(|p| p.x == 1.0 && p.y == 1.0).count();
    assert_eq!(doubled, 14, "seven vertices, twice");
    assert!(surface.faces.len() < 120, "{}", surface.faces.len());
    let result = with_context(|c| measure(&surface.to_soup(), c)).unwrap();
    assert_eq!((result.boundary_edges, result.self_intersections.pairs), (0, Some(0)), "{result:?}");
}

#[test]
fn a_vertex_with_very_many_faces_is_handled_quickly() {
    let n = 20_000u32;
    let rim =
        (0..n).map(|i| f64::from(i) * std::f64::consts::TAU / f64::from(n)).map(|a| DVec3::new(a.cos(), a.sin(), 0.0));
    let mut soup = Soup { positions: vec![DVec3::Z, -DVec3::Z], faces: Vec::new() };
    soup.positions.extend(rim);
    for i in 0..n {
        let (a, b) = (2 + i, 2 + (i + 1) % n);
        soup.faces.extend([[0, a, b], [1, b, a]]);
    }
    let (_, done) = simplified(&soup, &Simplify { precision: Precision::F64, ..to_faces(100) });
    assert!(done.shortfall.unwrap().ends_with("close together to check for intersections"));
}

#[test]
fn a_cancelled_run_leaves_the_surface_as_it_was() {
    let (before, _) = Surface::from_soup(&sphere(DVec3::ZERO, 2.0, 64, 32));
    let mut surface = before.clone();
    let cancel = std::sync::atomic::AtomicBool::new(true);
    let clock = || std::time::Duration::ZERO;
    let context = Context::new(&NoProgress, &cancel, &clock, std::time::Duration::from_secs(1));
    assert!(to_faces(10).apply(&mut surface, &context).is_err());
    assert_eq!(surface, before);
}

#[test]
fn a_broken_model_is_repaired_and_simplified_to_the_requested_face_count() {
    let mut soup = cube(DVec3::ZERO, 1.0, 10);
    soup.faces.remove(57);
    let options = Options { max_tier: 2, max_error: Some(1e-6), pictures: false, ..Options::default() };
    let repaired = repair_soup(&soup, &options, None);
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{:?}", repaired.report);
    assert_eq!(repaired.report.after.unwrap().measures.faces, 12);
    assert!(repaired.report.red_flags.is_empty(), "{:?}", repaired.report.red_flags);
}

#[test]
fn one_thread_and_two_give_the_same_surface() {
    let soup = as_f32(torus(2.0, 0.7, 60, 30));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| simplified(&soup, &to_faces(700)))
    };
    assert_eq!(on(1), on(2));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 12, ..ProptestConfig::default() })]

    /// Bumpy balls, nested and side by side: with any options a printable model stays printable, and every point near it.
    #[test]
    fn a_printable_model_stays_printable(
        waves in proptest::collection::vec((1.0..6.0f64, 0.0..6.0f64, 0.0..0.25f64), 1..4),
        faces in 4u64..600,
        share in 0.001..0.2f64,
        inner in any::<bool>(),
    ) {
        let bumpy = |scale: f64, at: DVec3| {
            let mut soup = sphere(DVec3::ZERO, 1.0, 24, 14);
            for p in &mut soup.positions {
                let bump: f64 = waves.iter().map(|&(f, o, h)| h / 3.0 * (f * p.x + o).sin() * (f * p.y - o).cos()).sum();
                *p = *p * (1.0 + bump) * scale + at;
            }
            soup
        };
        let outer = bumpy(1.0, DVec3::ZERO);
        let soup = as_f32(if inner { join(&outer, &inside_out(bumpy(0.9, DVec3::ZERO))) } else { join(&outer, &bumpy(0.7, DVec3::X * 2.3)) });
        let before = with_context(|c| measure(&soup, c)).unwrap();
        prop_assume!(before.printable());
        let (surface, done) = simplified(&soup, &Simplify { max_faces: Some(faces), max_error: share, ..EXACT });
        let after = measured_as_stl(&surface);
        prop_assert!(after.printable(), "{:?} {:?}", after, done);
        prop_assert_eq!(after.parts, before.parts);
        let distance = distance(&soup, &surface);
        prop_assert!(distance <= done.bound.min(share) * (1.0 + 1e-9) && done.error <= share, "{} {:?}", distance, done);
    }
}

#[test]
fn a_large_shell_is_simplified_in_slabs_the_same_way_on_any_number_of_threads() {
    // Two spheres with over 80,000 faces, nearer to each other than the edges of the result are long.
    let shell = as_f32(join(&sphere(DVec3::ZERO, 10.0, 240, 100), &inside_out(sphere(DVec3::ZERO, 9.8, 240, 100))));
    assert!(shell.faces.len() > 80_000);
    let how = Simplify { max_error: 0.05, ..EXACT };
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| simplified(&shell, &how))
    };
    let ((surface, done), (again, _)) = (on(1), on(3));
    assert_eq!(surface, again);
    assert!(done.faces_after < 5_000 && done.error <= 0.05, "{done:?}");
    assert!(distance(&shell, &surface) <= 0.05);
    let measures = measured_as_stl(&surface);
    assert!(measures.printable() && measures.parts == 2, "{measures:?}");
}
