//! Each operator of tier 1 by itself.

use glam::DVec3;
use meshmend::format::{Format, write};
use meshmend::inspect::{Measures, measure};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::Outcome;
use meshmend::repair::operators::degenerate::{remove_caps, remove_collapsed, remove_without_area};
use meshmend::repair::operators::duplicates::remove_duplicates;
use meshmend::repair::operators::holes::FillHoles;
use meshmend::repair::operators::orient::Orient;
use meshmend::repair::operators::slivers::RemoveSlivers;
use meshmend::repair::operators::weld::Weld;
use meshmend::repair::sheets::{encloses, open_sheet_share};
use proptest::prelude::*;

use crate::meshes::{cube, inside_out, join, push, sheet, sphere, torus};
use crate::support::{change_count, measured_file, repair_up_to_tier_2, with_context};

fn measured(soup: &Soup) -> Measures {
    with_context(|c| measure(soup, c)).unwrap()
}

fn surface(soup: &Soup) -> Surface {
    let (surface, _) = Surface::from_soup(soup);
    surface.check().unwrap();
    surface
}

#[test]
fn generated_solids_are_printable() {
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
    // A part in the cavity is at depth two and must look outward.
    let tiny = inside_out(cube(DVec3::splat(1.25), 0.25, 1));
    assert_eq!(measured(&join(&join(&outer, &inside_out(inner)), &tiny)).inverted_parts, 1);
}

#[test]
fn welding_closes_a_crack_narrower_than_the_tolerance_and_no_other() {
    let mut soup = cube(DVec3::ZERO, 1.0, 2);
    // Move every corner of one face slightly.
    for v in soup.faces[3] {
        soup.positions[v as usize] += DVec3::new(1e-7, -1e-7, 1e-7);
    }
    for (tolerance, open) in [(1e-6, 0), (1e-9, 6)] {
        let mut mesh = surface(&soup);
        let changes = with_context(|c| Weld { tolerance, max_deviation: f64::INFINITY }.apply(&mut mesh, c)).unwrap();
        assert_eq!(measured(&mesh.to_soup()).boundary_edges, open);
        assert_eq!(change_count(&changes.changes, "boundary_vertices_merged"), if open == 0 { 3 } else { 0 });
    }
}

#[test]
fn welding_never_collapses_a_face_smaller_than_the_tolerance() {
    let mut soup = sheet(4);
    let tiny = 1e-4;
    push(&mut soup, [DVec3::ZERO, DVec3::X * tiny, DVec3::Y * tiny].map(|p| p + DVec3::new(9.0, 9.0, 0.0)));
    let mut mesh = surface(&soup);
    with_context(|c| Weld { tolerance: 0.01, max_deviation: f64::INFINITY }.apply(&mut mesh, c)).unwrap();
    assert!(mesh.faces.iter().all(|&[a, b, c]| a != b && b != c && c != a));
    assert_eq!(mesh.faces.len(), soup.faces.len());
}

#[test]
fn welding_many_vertices_in_one_place_is_not_quadratic() {
    let mut soup = Soup::default();
    for i in 0..20_000 {
        let p = DVec3::new(f64::from(i) * 1e-12, 0.0, 0.0);
        push(&mut soup, [p, p + DVec3::new(0.0, 1e-12, 0.0), p + DVec3::new(0.0, 0.0, 1e-12)]);
    }
    push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let mut mesh = surface(&soup);
    with_context(|c| Weld { tolerance: 0.01, max_deviation: f64::INFINITY }.apply(&mut mesh, c)).unwrap();
    mesh.check().unwrap();
}

/// A cube with a vertex on an edge that only one of its faces uses, and a cap that closes the gap.
///
/// ```text
///   +-------+      the upper face has the whole edge, the lower ones have its halves;
///   |     / |      the triangle between them has no area
///   a---m---b
/// ```
fn cube_with_cap() -> Soup {
    let soup = cube(DVec3::ZERO, 1.0, 1);
    let (indexed, _) = Surface::from_soup(&soup);
    let mut out = Soup { positions: indexed.positions.clone(), faces: Vec::new() };
    let [a, b, c] = indexed.faces[0];
    let m = out.positions.len() as u32;
    out.positions.push((indexed.positions[a as usize] + indexed.positions[b as usize]) / 2.0);
    out.faces.extend([[a, m, c], [m, b, c], [a, b, m]]);
    out.faces.extend(&indexed.faces[1..]);
    out
}

#[test]
fn a_cap_is_removed_by_an_edge_flip_and_the_surface_stays_closed() {
    let soup = cube_with_cap();
    let before = measured(&soup);
    assert_eq!((before.degenerate_faces, before.boundary_edges), (1, 0));
    let mut mesh = surface(&soup);
    let changes = with_context(|c| remove_caps(&mut mesh, c)).unwrap();
    assert_eq!(change_count(&changes, "degenerate_faces_flipped"), 1);
    let after = measured(&mesh.to_soup());
    assert!(after.printable(), "{after:?}");
    assert_eq!(after.volume.value, before.volume.value);
    assert_eq!(mesh.positions, surface(&soup).positions);
}

#[test]
fn two_caps_on_the_same_edge_are_both_removed_by_edge_flips() {
    let mut soup = cube_with_cap();
    let (faces, n) = (soup.faces.clone(), soup.positions.len() as u32);
    // The neighbour across the cap's long edge gets another cap at a different place.
    let [a, b, m] = faces[2];
    let at = faces.iter().position(|f| f.contains(&a) && f.contains(&b) && !f.contains(&m)).unwrap();
    let d = *faces[at].iter().find(|&&v| v != a && v != b).unwrap();
    soup.positions.push(soup.positions[a as usize] * 0.25 + soup.positions[b as usize] * 0.75);
    soup.faces.remove(at);
    soup.faces.extend([[b, a, n], [b, n, d], [n, a, d]]);
    assert_eq!(measured(&soup).degenerate_faces, 2);
    let mut mesh = surface(&soup);
    with_context(|c| remove_caps(&mut mesh, c)).unwrap();
    let after = measured(&mesh.to_soup());
    assert!(after.printable(), "{after:?}");
}

/// A cube with a third face on an edge, whose other corner is `off` the edge's middle.
fn cube_with_fin(off: DVec3) -> Soup {
    let mut soup = cube(DVec3::ZERO, 1.0, 1);
    let [a, b, _] = soup.corners(0);
    push(&mut soup, [a, b, (a + b) / 2.0 + off]);
    soup
}

#[test]
fn a_face_without_area_that_stands_on_other_faces_is_removed() {
    let soup = cube_with_fin(DVec3::ZERO);
    let mut mesh = surface(&soup);
    let before = measured(&soup);
    assert_eq!((before.degenerate_faces, before.non_manifold_edges), (1, 1));
    let changes = with_context(|c| remove_caps(&mut mesh, c)).unwrap();
    assert_eq!(change_count(&changes, "degenerate_faces_removed"), 1);
    assert!(measured(&mesh.to_soup()).printable());
}

#[test]
fn a_sliver_that_stands_on_other_faces_is_removed_and_a_fin_with_area_is_not() {
    let slivers = RemoveSlivers { tolerance: 1e-6, max_deviation: f64::INFINITY };
    let removed = [1e-7, 1e-3].map(|height| {
        let mut mesh = surface(&cube_with_fin(DVec3::splat(height)));
        let applied = with_context(|c| slivers.apply(&mut mesh, c)).unwrap();
        (change_count(&applied.changes, "caps_removed"), measured(&mesh.to_soup()).non_manifold_edges)
    });
    assert_eq!(removed, [(1, 0), (0, 1)]);
}

/// A tetrahedron with a vertex on an edge, as far from its end as the smallest positive f32.
fn tetrahedron_with_a_face_that_vanishes() -> Soup {
    let beside = DVec3::new(f64::from(f32::from_bits(1)), 0.0, 0.0);
    let ends = [DVec3::ZERO, DVec3::new(1.0, 0.25, 0.125), DVec3::new(0.125, 1.0, 0.0), DVec3::new(0.0, 0.25, 1.0)];
    let faces = vec![[0, 2, 4], [4, 2, 1], [0, 4, 3], [4, 1, 3], [0, 3, 2], [1, 2, 3]];
    Soup { positions: ends.into_iter().chain([beside]).collect(), faces }
}

#[test]
fn a_face_whose_area_is_zero_in_f64_is_removed_without_a_report() {
    let soup = tetrahedron_with_a_face_that_vanishes();
    let before = measured(&soup);
    assert_eq!((before.degenerate_faces, before.boundary_edges), (1, 0));
    assert!(!before.printable(), "its normal belongs to no face");
    let mut mesh = surface(&soup);
    let applied = with_context(|c| remove_without_area(&mut mesh, f64::INFINITY, c)).unwrap();
    assert_eq!(change_count(&applied.changes, "short_edges_collapsed"), 1);
    assert!(applied.moved > 0.0 && applied.moved < 1e-44, "{}", applied.moved);
    let after = measured(&mesh.to_soup());
    assert!(after.printable() && after.faces == 4, "{after:?}");
    assert_eq!(after.volume.value, before.volume.value);
}

#[test]
fn a_face_whose_area_is_lost_in_f64_stays_where_no_vertex_may_move() {
    let soup = tetrahedron_with_a_face_that_vanishes();
    let mut mesh = surface(&soup);
    let applied = with_context(|c| remove_without_area(&mut mesh, 0.0, c)).unwrap();
    assert_eq!(applied.moved, 0.0);
    assert_eq!(mesh.to_soup(), surface(&soup).to_soup());
}

#[test]
fn a_face_with_a_repeated_vertex_is_removed_and_nothing_opens() {
    let mut mesh = surface(&cube(DVec3::ZERO, 1.0, 1));
    mesh.faces.push([0, 0, 1]);
    mesh.source.push(12);
    assert_eq!(change_count(&remove_collapsed(&mut mesh), "collapsed_faces_removed"), 1);
    assert!(measured(&mesh.to_soup()).printable());
}

#[test]
fn the_first_of_duplicate_faces_stays() {
    let cube = cube(DVec3::ZERO, 1.0, 2);
    let mut mesh = surface(&join(&cube, &cube));
    assert_eq!(change_count(&remove_duplicates(&mut mesh), "duplicate_faces_removed"), cube.faces.len() as u64);
    assert_eq!(mesh.source, (0..cube.faces.len() as u32).collect::<Vec<_>>());
    assert!(measured(&mesh.to_soup()).printable());
}

#[test]
fn a_solid_written_twice_stays_where_it_touches_another_at_an_edge() {
    let twice = cube(DVec3::ZERO, 1.0, 1);
    let other = cube(DVec3::new(1.0, 1.0, 0.0), 1.0, 1);
    let mut mesh = surface(&join(&join(&twice, &twice), &other));
    let changes = remove_duplicates(&mut mesh);
    assert_eq!(change_count(&changes, "duplicate_faces_removed"), twice.faces.len() as u64);
    assert_eq!(change_count(&changes, "cancelling_faces_removed"), 0);
    assert_eq!(mesh.faces.len(), 24);
}

#[test]
fn solids_written_twice_stay_where_they_share_a_side_and_edges_with_others() {
    let at = |x: f64, y: f64| cube(DVec3::new(x, y, 0.0), 1.0, 1);
    let cubes = [at(0.0, 0.0), at(0.0, 0.0), at(1.0, 0.0), at(-1.0, 1.0), at(-1.0, -1.0), at(3.0, 3.0)];
    let soup = cubes.iter().fold(Soup::default(), |all, cube| join(&all, cube));
    let repaired = repair_up_to_tier_2(&write(&soup, Format::Stl).unwrap());
    assert_eq!(repaired.report.outcome, Outcome::Repaired, "{}", repaired.report.summary);
    let volume = measured_file(&repaired.bytes).volume.value;
    assert!((volume - 5.0).abs() < 1e-4, "{volume}");
    // One of two solids that share a side faces inward, so that the side is wound alike twice, but encloses nothing.
    let soup = join(&at(0.0, 0.0), &inside_out(at(1.0, 0.0)));
    let repaired = repair_up_to_tier_2(&write(&soup, Format::Stl).unwrap());
    assert!((measured_file(&repaired.bytes).volume.value - 2.0).abs() < 1e-4);
}

#[test]
fn a_zero_thickness_wall_between_two_boxes_is_removed_completely() {
    // Two adjacent cubes, each with its own wall between them.
    let mut mesh = surface(&join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::X, 1.0, 2)));
    let changes = remove_duplicates(&mut mesh);
    assert_eq!(change_count(&changes, "cancelling_faces_removed"), 16);
    let after = measured(&mesh.to_soup());
    assert!(after.printable(), "{after:?}");
    assert!((after.volume.value - 2.0).abs() < 1e-9);
}

#[test]
fn a_small_two_sided_flap_is_removed_and_a_large_one_stays_as_a_sheet() {
    for (length, gone) in [(0.02, 2), (3.0, 0)] {
        let mut soup = cube(DVec3::ZERO, 1.0, 1);
        let [a, b, _] = soup.corners(0);
        let tip = (a + b) * 0.5 - DVec3::splat(length);
        push(&mut soup, [a, b, tip]);
        push(&mut soup, [b, a, tip]);
        let mut mesh = surface(&soup);
        let changes = remove_duplicates(&mut mesh);
        assert_eq!(change_count(&changes, "cancelling_faces_removed"), gone);
        assert_eq!(change_count(&changes, "duplicate_faces_removed"), if gone > 0 { 0 } else { 1 });
        assert_eq!(measured(&mesh.to_soup()).printable(), gone > 0);
    }
}

#[test]
fn a_two_sided_sheet_alone_is_not_lost() {
    let one = sheet(3);
    let mut mesh = surface(&join(&one, &inside_out(one.clone())));
    remove_duplicates(&mut mesh);
    assert_eq!(mesh.faces.len(), one.faces.len());
}

#[test]
fn a_cavity_keeps_facing_inward_and_a_solid_outward() {
    let hollow = join(&cube(DVec3::ZERO, 4.0, 2), &inside_out(cube(DVec3::ONE, 1.0, 1)));
    let mut mesh = surface(&hollow);
    let before = mesh.faces.clone();
    with_context(|c| Orient::default().apply(&mut mesh, c)).unwrap();
    assert_eq!(mesh.faces, before);
    let mut target = surface(&inside_out(torus(3.0, 1.0, 12, 6)));
    let changes = with_context(|c| Orient::default().apply(&mut target, c)).unwrap().changes;
    assert_eq!(change_count(&changes, "closed_parts_flipped"), 1);
    assert!(measured(&target.to_soup()).printable());
}

#[test]
fn an_inverted_open_box_is_flipped_by_the_visibility_of_its_faces() {
    let mut soup = inside_out(cube(DVec3::ZERO, 1.0, 4));
    soup.faces.truncate(soup.faces.len() - 2);
    let mut mesh = surface(&soup);
    let changes = with_context(|c| Orient::default().apply(&mut mesh, c)).unwrap().changes;
    assert_eq!(change_count(&changes, "open_parts_flipped"), 1);
}

#[test]
fn a_hole_on_a_sphere_is_closed_without_moving_a_vertex() {
    let mut soup = sphere(DVec3::ZERO, 1.0, 24, 12);
    soup.faces.drain(100..140);
    let mut mesh = surface(&soup);
    let before = mesh.clone();
    let filled = with_context(|c| FillHoles { max_edges: 10_000, ..FillHoles::default() }.apply(&mut mesh, c)).unwrap();
    assert!(filled.holes_left == 0 && filled.open_sheets == 0);
    assert_eq!(mesh.positions, before.positions);
    assert_eq!(mesh.faces[..before.faces.len()], before.faces);
    assert!(measured(&mesh.to_soup()).printable());
}

#[test]
fn a_hole_of_hundreds_of_edges_is_closed() {
    for n in [100, 300, 1500] {
        let mut soup = sphere(DVec3::ZERO, 1.0, n, 6);
        // The faces around one pole: the first of the ten faces of each slice.
        let mut index = 0;
        soup.faces.retain(|_| {
            index += 1;
            index % 10 != 1
        });
        let mut mesh = surface(&soup);
        let filled =
            with_context(|c| FillHoles { max_edges: 10_000, ..FillHoles::default() }.apply(&mut mesh, c)).unwrap();
        assert_eq!(filled.holes_left, 0);
        assert_eq!(change_count(&filled.changes, "faces_added"), u64::from(n) - 2);
        let after = measured(&mesh.to_soup());
        assert!(after.printable(), "{n}: {after:?}");
    }
}

#[test]
fn a_hole_over_the_limit_is_left_and_reported() {
    let mut soup = cube(DVec3::ZERO, 1.0, 4);
    soup.faces.truncate(soup.faces.len() - 32);
    let mut mesh = surface(&soup);
    let filled = with_context(|c| FillHoles { max_edges: 8, ..FillHoles::default() }.apply(&mut mesh, c)).unwrap();
    assert_eq!(filled.holes_left, 1);
    assert_eq!(mesh.faces.len(), soup.faces.len());
}

#[test]
fn an_open_sheet_is_left_open() {
    let mut mesh = surface(&sheet(10));
    assert!(open_sheet_share(&mesh) > 0.99);
    let filled = with_context(|c| FillHoles { max_edges: 10_000, ..FillHoles::default() }.apply(&mut mesh, c)).unwrap();
    assert_eq!((filled.open_sheets, mesh.faces.len()), (1, 200));
    let mut half_open = cube(DVec3::ZERO, 1.0, 4);
    half_open.faces.truncate(half_open.faces.len() - 32);
    assert_eq!(open_sheet_share(&surface(&half_open)), 0.0);
}

#[test]
fn a_lone_triangle_encloses_nothing() {
    assert!(!encloses(1.0, 1.0, Some(0.0)));
    assert!(encloses(5.0, 1.0, Some(1.0)));
    // A narrow triangle gets no back either.
    let mut soup = Soup::default();
    push(&mut soup, [DVec3::ZERO, DVec3::new(10.0, 0.0, 0.0), DVec3::new(5.0, 0.2, 0.0)]);
    let mut mesh = surface(&soup);
    let filled = with_context(|c| FillHoles::default().apply(&mut mesh, c)).unwrap();
    assert_eq!((filled.open_sheets, filled.holes_left, mesh.faces.len()), (1, 0, 1));
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 48, failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn flipped_faces_are_turned_back(flips in proptest::collection::vec(any::<bool>(), 96), which in 0..3usize) {
        let soup = [cube(DVec3::ZERO, 1.0, 2), torus(3.0, 1.0, 8, 6), sphere(DVec3::ZERO, 1.0, 8, 7)][which].clone();
        let mut mesh = surface(&soup);
        for (face, flip) in mesh.faces.iter_mut().zip(&flips) {
            if *flip {
                face.swap(1, 2);
            }
        }
        with_context(|c| Orient::default().apply(&mut mesh, c)).unwrap();
        prop_assert!(measured(&mesh.to_soup()).printable());
    }

    #[test]
    fn no_operator_breaks_a_surface_of_random_faces(faces in proptest::collection::vec((0..9u32, 0..9u32, 0..9u32), 1..40)) {
        let positions = (0..9).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 3), f64::from(i * i % 5))).collect();
        let soup = Soup { positions, faces: faces.into_iter().map(|(a, b, c)| [a, b, c]).collect() };
        let mut mesh = surface(&soup);
        with_context(|c| {
            remove_collapsed(&mut mesh);
            Weld { tolerance: 0.01, max_deviation: f64::INFINITY }.apply(&mut mesh, c).unwrap();
            remove_collapsed(&mut mesh);
            remove_duplicates(&mut mesh);
            let before = measured(&mesh.to_soup()).degenerate_faces;
            remove_caps(&mut mesh, c).unwrap();
            prop_assert!(measured(&mesh.to_soup()).degenerate_faces <= before);
            Orient::default().apply(&mut mesh, c).unwrap();
            let open = measured(&mesh.to_soup());
            FillHoles { max_edges: 1000, ..FillHoles::default() }.apply(&mut mesh, c).unwrap();
            let after = measured(&mesh.to_soup());
            prop_assert!(after.boundary_edges <= open.boundary_edges);
            prop_assert!(after.non_manifold_edges <= open.non_manifold_edges);
            mesh.drop_unreferenced();
            mesh.check().unwrap();
            Ok(())
        })?;
    }
}
