//! Each operator alone.

use std::sync::atomic::AtomicBool;
use std::time::Duration;

use glam::DVec3;
use meshmend::inspect::{Measures, measure};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::degenerate::{remove_caps, remove_collapsed, remove_without_area};
use meshmend::repair::operators::duplicates::remove_duplicates;
use meshmend::repair::operators::holes::FillHoles;
use meshmend::repair::operators::orient::Orient;
use meshmend::repair::operators::weld::Weld;
use meshmend::repair::sheets::{encloses, open_sheet_share};
use meshmend::repair::{Change, Context, NoProgress};
use proptest::prelude::*;

use crate::meshes::{cube, inside_out, join, push, sheet, sphere, torus};

pub fn with_context<T>(f: impl FnOnce(&Context<'_>) -> T) -> T {
    let cancel = AtomicBool::new(false);
    let clock = || Duration::ZERO;
    f(&Context::new(&NoProgress, &cancel, &clock, Duration::from_secs(1)))
}

fn measured(soup: &Soup) -> Measures {
    with_context(|c| measure(soup, c)).unwrap()
}

fn surface(soup: &Soup) -> Surface {
    let (surface, _) = Surface::from_soup(soup);
    surface.check().unwrap();
    surface
}

pub fn count(changes: &[Change], what: &str) -> u64 {
    changes.iter().find(|c| c.kind.as_str() == what).map_or(0, |c| c.count)
}

#[test]
fn made_solids_are_printable_as_they_are() {
    for soup in [cube(DVec3::ZERO, 2.0, 3), torus(3.0, 1.0, 24, 12), sphere(DVec3::ONE, 2.0, 16, 8)] {
        let m = measured(&soup);
        assert!(m.printable(), "{m:?}");
        assert_eq!(m.parts, 1);
        assert!(m.volume.reliable);
    }
    assert!((measured(&cube(DVec3::ZERO, 2.0, 3)).volume.value - 8.0).abs() < 1e-12);
}

#[test]
fn a_missing_face_is_one_boundary_loop_of_three_edges() {
    let mut soup = cube(DVec3::ZERO, 1.0, 2);
    soup.faces.remove(5);
    let m = measured(&soup);
    assert_eq!((m.boundary_edges, m.boundary_loops), (3, 1));
    assert!(!m.closed && !m.volume.reliable);
}

#[test]
fn two_cubes_that_share_an_edge_have_one_non_manifold_edge() {
    let m = measured(&join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1)));
    assert_eq!((m.non_manifold_edges, m.boundary_edges, m.parts), (1, 0, 1));
    assert!(m.closed && !m.manifold);
}

#[test]
fn two_cubes_that_share_a_vertex_have_one_non_manifold_vertex() {
    let m = measured(&join(&cube(DVec3::ZERO, 1.0, 1), &cube(DVec3::ONE, 1.0, 1)));
    assert_eq!((m.non_manifold_vertices, m.non_manifold_edges, m.parts), (1, 0, 2));
}

#[test]
fn a_cavity_is_not_a_part_turned_inside_out() {
    let outer = cube(DVec3::ZERO, 4.0, 2);
    let inner = cube(DVec3::ONE, 1.0, 1);
    let hollow = measured(&join(&outer, &inside_out(inner.clone())));
    assert_eq!(hollow.inverted_parts, 0);
    assert!((hollow.volume.value - 63.0).abs() < 1e-9);
    assert_eq!(measured(&inside_out(inner.clone())).inverted_parts, 1);
    let beside = join(&outer, &inside_out(cube(DVec3::splat(9.0), 1.0, 1)));
    assert_eq!(measured(&beside).inverted_parts, 1);
    // A part in the cavity is at depth two, and inside out there is inside out.
    let tiny = inside_out(cube(DVec3::splat(1.25), 0.25, 1));
    assert_eq!(measured(&join(&join(&outer, &inside_out(inner)), &tiny)).inverted_parts, 1);
}

#[test]
fn welding_closes_a_crack_narrower_than_the_tolerance_and_no_other() {
    let mut soup = cube(DVec3::ZERO, 1.0, 2);
    // Every corner of one face moves by a little.
    for v in soup.faces[3] {
        soup.positions[v as usize] += DVec3::new(1e-7, -1e-7, 1e-7);
    }
    for (tolerance, open) in [(1e-6, 0), (1e-9, 6)] {
        let mut it = surface(&soup);
        let changes = with_context(|c| Weld { tolerance, max_deviation: f64::INFINITY }.apply(&mut it, c)).unwrap();
        assert_eq!(measured(&it.to_soup()).boundary_edges, open);
        assert_eq!(count(&changes.changes, "boundary_vertices_merged"), if open == 0 { 3 } else { 0 });
    }
}

#[test]
fn welding_never_collapses_a_face_smaller_than_the_tolerance() {
    let mut soup = sheet(4);
    let tiny = 1e-4;
    push(&mut soup, [DVec3::ZERO, DVec3::X * tiny, DVec3::Y * tiny].map(|p| p + DVec3::new(9.0, 9.0, 0.0)));
    let mut it = surface(&soup);
    with_context(|c| Weld { tolerance: 0.01, max_deviation: f64::INFINITY }.apply(&mut it, c)).unwrap();
    assert!(it.faces.iter().all(|&[a, b, c]| a != b && b != c && c != a));
    assert_eq!(it.faces.len(), soup.faces.len());
}

#[test]
fn welding_many_vertices_in_one_place_is_not_quadratic() {
    let mut soup = Soup::default();
    for i in 0..20_000 {
        let p = DVec3::new(f64::from(i) * 1e-12, 0.0, 0.0);
        push(&mut soup, [p, p + DVec3::new(0.0, 1e-12, 0.0), p + DVec3::new(0.0, 0.0, 1e-12)]);
    }
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let mut it = surface(&soup);
    with_context(|c| Weld { tolerance: 0.01, max_deviation: f64::INFINITY }.apply(&mut it, c)).unwrap();
    it.check().unwrap();
}

/// A cube with a vertex put on an edge of one face only, and a cap that closes the gap.
///
/// ```text
///   +-------+      the upper face ends at the whole edge, the lower ones at its halves;
///   |     / |      between them lies a triangle without area
///   a---m---b
/// ```
fn cube_with_cap() -> Soup {
    let soup = cube(DVec3::ZERO, 1.0, 1);
    let (it, _) = Surface::from_soup(&soup);
    let mut out = Soup { positions: it.positions.clone(), faces: Vec::new() };
    let [a, b, c] = it.faces[0];
    let m = out.positions.len() as u32;
    out.positions.push((it.positions[a as usize] + it.positions[b as usize]) / 2.0);
    out.faces.extend([[a, m, c], [m, b, c], [a, b, m]]);
    out.faces.extend(&it.faces[1..]);
    out
}

#[test]
fn a_cap_is_flipped_away_and_the_surface_stays_closed() {
    let soup = cube_with_cap();
    let before = measured(&soup);
    assert_eq!((before.degenerate_faces, before.boundary_edges), (1, 0));
    let mut it = surface(&soup);
    let changes = with_context(|c| remove_caps(&mut it, c)).unwrap();
    assert_eq!(count(&changes, "degenerate_faces_flipped"), 1);
    let after = measured(&it.to_soup());
    assert!(after.printable(), "{after:?}");
    assert_eq!(after.volume.value, before.volume.value);
    assert_eq!(it.positions, surface(&soup).positions);
}

#[test]
fn two_caps_on_the_same_edge_are_both_flipped_away() {
    let mut soup = cube_with_cap();
    let (faces, n) = (soup.faces.clone(), soup.positions.len() as u32);
    // The neighbour of the cap beyond its long edge gets a cap of its own at another place.
    let [a, b, m] = faces[2];
    let at = faces.iter().position(|f| f.contains(&a) && f.contains(&b) && !f.contains(&m)).unwrap();
    let d = *faces[at].iter().find(|&&v| v != a && v != b).unwrap();
    soup.positions.push(soup.positions[a as usize] * 0.25 + soup.positions[b as usize] * 0.75);
    soup.faces.remove(at);
    soup.faces.extend([[b, a, n], [b, n, d], [n, a, d]]);
    assert_eq!(measured(&soup).degenerate_faces, 2);
    let mut it = surface(&soup);
    with_context(|c| remove_caps(&mut it, c)).unwrap();
    let after = measured(&it.to_soup());
    assert!(after.printable(), "{after:?}");
}

/// A tetrahedron of which an edge has a vertex near an end, as far off as the smallest number of f32.
fn tetrahedron_with_a_face_that_vanishes() -> Soup {
    let beside = DVec3::new(f64::from(f32::from_bits(1)), 0.0, 0.0);
    let ends = [DVec3::ZERO, DVec3::new(1.0, 0.25, 0.125), DVec3::new(0.125, 1.0, 0.0), DVec3::new(0.0, 0.25, 1.0)];
    let faces = vec![[0, 2, 4], [4, 2, 1], [0, 4, 3], [4, 1, 3], [0, 3, 2], [1, 2, 3]];
    Soup { positions: ends.into_iter().chain([beside]).collect(), faces }
}

#[test]
fn a_face_whose_area_is_lost_in_f64_is_no_face_and_goes_without_a_trace() {
    let soup = tetrahedron_with_a_face_that_vanishes();
    let before = measured(&soup);
    assert_eq!((before.degenerate_faces, before.boundary_edges), (1, 0));
    assert!(!before.printable(), "its normal is nobody's");
    let mut it = surface(&soup);
    let applied = with_context(|c| remove_without_area(&mut it, f64::INFINITY, c)).unwrap();
    assert_eq!(count(&applied.changes, "short_edges_collapsed"), 1);
    assert!(applied.moved > 0.0 && applied.moved < 1e-44, "{}", applied.moved);
    let after = measured(&it.to_soup());
    assert!(after.printable() && after.faces == 4, "{after:?}");
    assert_eq!(after.volume.value, before.volume.value);
}

#[test]
fn a_face_whose_area_is_lost_in_f64_stays_where_no_vertex_may_move() {
    let soup = tetrahedron_with_a_face_that_vanishes();
    let mut it = surface(&soup);
    let applied = with_context(|c| remove_without_area(&mut it, 0.0, c)).unwrap();
    assert_eq!(applied.moved, 0.0);
    assert_eq!(it.to_soup(), surface(&soup).to_soup());
}

#[test]
fn a_face_with_a_repeated_vertex_goes_and_nothing_opens() {
    let mut it = surface(&cube(DVec3::ZERO, 1.0, 1));
    it.faces.push([0, 0, 1]);
    it.source.push(12);
    assert_eq!(count(&remove_collapsed(&mut it), "collapsed_faces_removed"), 1);
    assert!(measured(&it.to_soup()).printable());
}

#[test]
fn of_duplicates_the_first_stays() {
    let cube = cube(DVec3::ZERO, 1.0, 2);
    let mut it = surface(&join(&cube, &cube));
    assert_eq!(count(&remove_duplicates(&mut it), "duplicate_faces_removed"), cube.faces.len() as u64);
    assert_eq!(it.source, (0..cube.faces.len() as u32).collect::<Vec<_>>());
    assert!(measured(&it.to_soup()).printable());
}

#[test]
fn a_wall_without_thickness_between_two_boxes_goes_whole() {
    // Two cubes side by side, each with its own wall between them.
    let mut it = surface(&join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::X, 1.0, 2)));
    let changes = remove_duplicates(&mut it);
    assert_eq!(count(&changes, "cancelling_faces_removed"), 16);
    let after = measured(&it.to_soup());
    assert!(after.printable(), "{after:?}");
    assert!((after.volume.value - 2.0).abs() < 1e-9);
}

#[test]
fn a_small_flap_of_two_faces_goes_and_a_large_one_stays_as_a_sheet() {
    for (length, gone) in [(0.02, 2), (3.0, 0)] {
        let mut soup = cube(DVec3::ZERO, 1.0, 1);
        let [a, b, _] = soup.corners(0);
        let tip = (a + b) * 0.5 - DVec3::splat(length);
        push(&mut soup, [a, b, tip]);
        push(&mut soup, [b, a, tip]);
        let mut it = surface(&soup);
        let changes = remove_duplicates(&mut it);
        assert_eq!(count(&changes, "cancelling_faces_removed"), gone);
        assert_eq!(count(&changes, "duplicate_faces_removed"), if gone > 0 { 0 } else { 1 });
        assert_eq!(measured(&it.to_soup()).printable(), gone > 0);
    }
}

#[test]
fn a_two_sided_sheet_alone_is_not_lost() {
    let one = sheet(3);
    let mut it = surface(&join(&one, &inside_out(one.clone())));
    remove_duplicates(&mut it);
    assert_eq!(it.faces.len(), one.faces.len());
}

#[test]
fn a_cavity_keeps_looking_into_the_hollow_and_a_solid_outward() {
    let hollow = join(&cube(DVec3::ZERO, 4.0, 2), &inside_out(cube(DVec3::ONE, 1.0, 1)));
    let mut it = surface(&hollow);
    let before = it.faces.clone();
    with_context(|c| Orient::default().apply(&mut it, c)).unwrap();
    assert_eq!(it.faces, before);
    let mut it = surface(&inside_out(torus(3.0, 1.0, 12, 6)));
    let changes = with_context(|c| Orient::default().apply(&mut it, c)).unwrap().changes;
    assert_eq!(count(&changes, "closed_parts_flipped"), 1);
    assert!(measured(&it.to_soup()).printable());
}

#[test]
fn an_open_box_turned_inside_out_is_turned_by_what_its_faces_see() {
    let mut soup = inside_out(cube(DVec3::ZERO, 1.0, 4));
    soup.faces.truncate(soup.faces.len() - 2);
    let mut it = surface(&soup);
    let changes = with_context(|c| Orient::default().apply(&mut it, c)).unwrap().changes;
    assert_eq!(count(&changes, "open_parts_flipped"), 1);
}

#[test]
fn a_hole_on_a_sphere_is_closed_without_moving_a_vertex() {
    let mut soup = sphere(DVec3::ZERO, 1.0, 24, 12);
    soup.faces.drain(100..140);
    let mut it = surface(&soup);
    let before = it.clone();
    let filled = with_context(|c| FillHoles { max_edges: 10_000, ..FillHoles::default() }.apply(&mut it, c)).unwrap();
    assert!(filled.holes_left == 0 && filled.open_sheets == 0);
    assert_eq!(it.positions, before.positions);
    assert_eq!(it.faces[..before.faces.len()], before.faces);
    assert!(measured(&it.to_soup()).printable());
}

#[test]
fn a_hole_of_hundreds_of_edges_is_closed() {
    for n in [100, 300, 1500] {
        let mut soup = sphere(DVec3::ZERO, 1.0, n, 6);
        // The cap around one pole: the first of the ten faces of each slice.
        let mut index = 0;
        soup.faces.retain(|_| {
            index += 1;
            index % 10 != 1
        });
        let mut it = surface(&soup);
        let filled =
            with_context(|c| FillHoles { max_edges: 10_000, ..FillHoles::default() }.apply(&mut it, c)).unwrap();
        assert_eq!(filled.holes_left, 0);
        assert_eq!(count(&filled.changes, "faces_added"), u64::from(n) - 2);
        let after = measured(&it.to_soup());
        assert!(after.printable(), "{n}: {after:?}");
    }
}

#[test]
fn a_hole_over_the_limit_is_left_and_told() {
    let mut soup = cube(DVec3::ZERO, 1.0, 4);
    soup.faces.truncate(soup.faces.len() - 32);
    let mut it = surface(&soup);
    let filled = with_context(|c| FillHoles { max_edges: 8, ..FillHoles::default() }.apply(&mut it, c)).unwrap();
    assert_eq!(filled.holes_left, 1);
    assert_eq!(it.faces.len(), soup.faces.len());
}

#[test]
fn an_open_sheet_is_left_open() {
    let mut it = surface(&sheet(10));
    assert!(open_sheet_share(&it) > 0.99);
    let filled = with_context(|c| FillHoles { max_edges: 10_000, ..FillHoles::default() }.apply(&mut it, c)).unwrap();
    assert_eq!((filled.open_sheets, it.faces.len()), (1, 200));
    let mut half_open = cube(DVec3::ZERO, 1.0, 4);
    half_open.faces.truncate(half_open.faces.len() - 32);
    assert_eq!(open_sheet_share(&surface(&half_open)), 0.0);
}

#[test]
fn a_lone_triangle_encloses_nothing() {
    assert!(!encloses(1.0, 1.0, Some(0.0)));
    assert!(encloses(5.0, 1.0, Some(1.0)));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn flipped_faces_are_turned_back(flips in proptest::collection::vec(any::<bool>(), 96), which in 0..3usize) {
        let soup = [cube(DVec3::ZERO, 1.0, 2), torus(3.0, 1.0, 8, 6), sphere(DVec3::ZERO, 1.0, 8, 7)][which].clone();
        let mut it = surface(&soup);
        for (face, flip) in it.faces.iter_mut().zip(&flips) {
            if *flip {
                face.swap(1, 2);
            }
        }
        with_context(|c| Orient::default().apply(&mut it, c)).unwrap();
        prop_assert!(measured(&it.to_soup()).printable());
    }

    #[test]
    fn no_operator_breaks_a_surface_of_random_faces(faces in proptest::collection::vec((0..9u32, 0..9u32, 0..9u32), 1..40)) {
        let positions = (0..9).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 3), f64::from(i * i % 5))).collect();
        let soup = Soup { positions, faces: faces.into_iter().map(|(a, b, c)| [a, b, c]).collect() };
        let mut it = surface(&soup);
        with_context(|c| {
            remove_collapsed(&mut it);
            Weld { tolerance: 0.01, max_deviation: f64::INFINITY }.apply(&mut it, c).unwrap();
            remove_collapsed(&mut it);
            remove_duplicates(&mut it);
            let before = measured(&it.to_soup()).degenerate_faces;
            remove_caps(&mut it, c).unwrap();
            prop_assert!(measured(&it.to_soup()).degenerate_faces <= before);
            Orient::default().apply(&mut it, c).unwrap();
            let open = measured(&it.to_soup());
            FillHoles { max_edges: 1000, ..FillHoles::default() }.apply(&mut it, c).unwrap();
            let after = measured(&it.to_soup());
            prop_assert!(after.boundary_edges <= open.boundary_edges);
            prop_assert!(after.non_manifold_edges <= open.non_manifold_edges);
            it.drop_unreferenced();
            it.check().unwrap();
            Ok(())
        })?;
    }
}
