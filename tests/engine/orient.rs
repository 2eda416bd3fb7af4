//! Orientation: neighbours agree, solids face outward, cavities inward, and non-orientable parts are cut open.

use std::f64::consts::TAU;

use glam::DVec3;
use meshmend::math::Precision;
use meshmend::mesh::{NO_SOURCE, Soup, Surface};
use meshmend::repair::operators::Applied;
use meshmend::repair::operators::cut_non_orientable::CutNonOrientable;
use meshmend::repair::operators::orient::{Nested, Orient};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::meshes::{cube, inside_out, join, push, sheet, sphere, torus};
use crate::support::{change_count, measured, with_context};

const KEEP: Orient = Orient { nested: Nested::Keep };
const ALTERNATE: Orient = Orient { nested: Nested::Alternate };

fn oriented(soup: &Soup, how: Orient) -> (Surface, Applied) {
    let (mut surface, _) = Surface::from_soup(soup);
    let applied = with_context(|c| how.apply(&mut surface, c)).unwrap();
    (surface, applied)
}

/// Six times the signed volume of some faces.
fn volume(surface: &Surface, faces: std::ops::Range<usize>) -> f64 {
    faces.map(|f| surface.corners(f)).map(|[a, b, c]| a.dot(b.cross(c))).sum()
}

/// Whether each cube of 12 faces faces outward.
fn outward(surface: &Surface) -> Vec<bool> {
    (0..surface.faces.len() / 12).map(|i| volume(surface, 12 * i..12 * i + 12) > 0.0).collect()
}

/// Nested cubes from the outermost in, each facing outward or not.
fn nested_cubes(outward: &[bool]) -> Soup {
    let mut soup = Soup::default();
    for (i, &outward) in outward.iter().enumerate() {
        let cube = cube(DVec3::splat(i as f64), 16.0 - 2.0 * i as f64, 1);
        soup = join(&soup, &if outward { cube } else { inside_out(cube) });
    }
    soup
}

/// A strip of `n` by `m` quads whose vertices `index` numbers and `at` places.
fn strip(n: u32, m: u32, index: impl Fn(u32, u32) -> u32, at: impl Fn(u32, u32) -> DVec3, rows: u32) -> Surface {
    let positions = (0..n).flat_map(|i| (0..rows).map(move |j| (i, j))).map(|(i, j)| at(i, j)).collect();
    let mut faces = Vec::new();
    for i in 0..n {
        for j in 0..m {
            let [a, b, c, d] = [index(i, j), index(i + 1, j), index(i + 1, j + 1), index(i, j + 1)];
            faces.extend([[a, b, c], [a, c, d]]);
        }
    }
    let source = vec![NO_SOURCE; faces.len()];
    Surface { positions, faces, source }
}

fn moebius_band(n: u32, m: u32) -> Surface {
    let at = |i: u32, j: u32| {
        let u = f64::from(i) / f64::from(n) * TAU;
        let t = f64::from(j) / f64::from(m) - 0.5;
        let r = 4.0 + t * (u / 2.0).cos();
        DVec3::new(r * u.cos(), r * u.sin(), t * (u / 2.0).sin())
    };
    strip(n, m, |i, j| if i == n { m - j } else { i * (m + 1) + j }, at, m + 1)
}

/// The figure-eight immersion of a Klein bottle; `m` must be even.
fn klein_bottle(n: u32, m: u32) -> Surface {
    let at = |i: u32, j: u32| {
        let u = f64::from(i) / f64::from(n) * TAU;
        let v = (f64::from(j) + 0.5) / f64::from(m) * TAU;
        let [s, t] = [v.sin(), (2.0 * v).sin()];
        let r = 4.0 + (u / 2.0).cos() * s - (u / 2.0).sin() * t;
        DVec3::new(r * u.cos(), r * u.sin(), (u / 2.0).sin() * s + (u / 2.0).cos() * t)
    };
    strip(n, m, |i, j| if i == n { (2 * m - 1 - j % m) % m } else { i * m + j % m }, at, m)
}

#[test]
fn a_cavity_of_a_solid_that_is_inside_out_as_a_whole_is_turned_with_it() {
    let (surface, applied) = oriented(&nested_cubes(&[false, true]), KEEP);
    assert_eq!(outward(&surface), [true, false]);
    assert_eq!(change_count(&applied.changes, "closed_parts_flipped"), 2);
    assert!(measured(&surface).printable());
}

#[test]
fn a_cavity_is_kept_and_told() {
    let soup = nested_cubes(&[true, false]);
    let (surface, applied) = oriented(&soup, KEEP);
    assert_eq!(outward(&surface), [true, false]);
    assert_eq!((change_count(&applied.changes, "cavities_kept"), applied.left), (1, None));
    // A cavity in a shell that alone was flipped stays a cavity.
    assert_eq!(outward(&oriented(&nested_cubes(&[false, false]), KEEP).0), [true, false]);
}

#[test]
fn a_solid_inside_a_solid_is_kept_and_reported() {
    let (surface, applied) = oriented(&nested_cubes(&[true, true]), KEEP);
    assert_eq!(outward(&surface), [true, true]);
    assert_eq!(change_count(&applied.changes, "solids_inside_solids"), 1);
}

#[test]
fn nested_layers_alternate_on_request_whatever_their_orientation() {
    for bits in 0..16u32 {
        let as_it_was: Vec<bool> = (0..4).map(|i| bits >> i & 1 == 1).collect();
        let (surface, _) = oriented(&nested_cubes(&as_it_was), ALTERNATE);
        assert_eq!(outward(&surface), [true, false, true, false], "{as_it_was:?}");
        let kept = outward(&oriented(&nested_cubes(&as_it_was), KEEP).0);
        assert!(kept[0] && kept[2], "{as_it_was:?}: {kept:?}");
        assert_eq!(measured(&surface).inverted_parts, 0);
    }
}

/// Nested cubes without the first face of the outermost.
fn nested_cubes_with_a_hole(outward: &[bool]) -> Soup {
    let mut soup = nested_cubes(outward);
    soup.faces.remove(0);
    soup
}

#[test]
fn a_cavity_behind_a_wall_with_a_hole_stays_one_and_is_flipped_with_the_wall() {
    let inner = |surface: &Surface| (0..2).map(|i| volume(surface, 11 + 12 * i..23 + 12 * i) > 0.0).collect::<Vec<_>>();
    for (as_it_was, becomes) in [
        ([true, false, true], [false, true]),
        ([true, true, true], [true, true]),
        ([false, true, false], [false, true]),
        ([false, false, true], [false, true]),
    ] {
        let (surface, _) = oriented(&nested_cubes_with_a_hole(&as_it_was), KEEP);
        assert_eq!(inner(&surface), becomes, "{as_it_was:?}");
        assert!(volume(&surface, 0..11) > 0.0);
    }
}

#[test]
fn a_ball_over_or_beside_an_open_sheet_is_turned_outward() {
    let mut ball = inside_out(sphere(DVec3::new(4.0, 4.0, 3.0), 1.0, 12, 6));
    let faces = ball.faces.len();
    ball = join(&ball, &sheet(9));
    let (surface, _) = oriented(&ball, KEEP);
    let middle = DVec3::new(4.0, 4.0, 3.0);
    let outward = |f: usize| {
        let [a, b, c] = surface.corners(f);
        (b - a).cross(c - a).dot(a - middle) > 0.0
    };
    assert!((0..faces).all(outward));
}

#[test]
fn the_inverted_one_of_two_overlapping_cubes_is_flipped() {
    for (first, second) in [(true, false), (false, true), (false, false)] {
        let turned = |cube: Soup, outward: bool| if outward { cube } else { inside_out(cube) };
        let soup = join(&turned(cube(DVec3::ZERO, 2.0, 1), first), &turned(cube(DVec3::splat(0.7), 2.0, 1), second));
        assert_eq!(outward(&oriented(&soup, KEEP).0), [true, true]);
    }
}

/// A cube without its second side.
fn open_box(n: u32) -> Soup {
    let mut soup = cube(DVec3::ZERO, 1.0, n);
    let side = soup.faces.len() / 6;
    soup.faces.drain(side..2 * side);
    soup
}

#[test]
fn a_box_without_lid_is_turned_outward_and_one_that_looks_outward_stays() {
    for n in [1, 4, 9] {
        let (surface, applied) = oriented(&inside_out(open_box(n)), KEEP);
        assert_eq!(change_count(&applied.changes, "open_parts_flipped"), 1);
        let (as_it_was, applied) = oriented(&open_box(n), KEEP);
        assert_eq!(change_count(&applied.changes, "open_parts_flipped"), 0);
        assert_eq!(as_it_was.faces, Surface::from_soup(&open_box(n)).0.faces);
        let sum = |s: &Surface| volume(s, 0..s.faces.len());
        assert!((sum(&surface) - sum(&as_it_was)).abs() < 1e-9);
    }
}

#[test]
fn an_open_box_in_a_solid_is_kept_as_it_was() {
    let around = cube(DVec3::splat(-3.0), 7.0, 2);
    for inner in [open_box(3), inside_out(open_box(3))] {
        let soup = join(&around, &inner);
        let (surface, applied) = oriented(&soup, KEEP);
        assert_eq!(surface.faces, Surface::from_soup(&soup).0.faces);
        assert!(applied.left.unwrap().contains("1 open part"));
        let (surface, _) = oriented(&soup, ALTERNATE);
        let faces = around.faces.len()..soup.faces.len();
        assert!(volume(&surface, faces.clone()) < 0.0, "{}", volume(&surface, faces));
    }
}

#[test]
fn an_open_box_stuck_in_another_is_oriented_by_its_outer_part() {
    let through = |soup: Soup| join(&cube(DVec3::new(0.2, 0.2, -0.3), 0.6, 2), &soup);
    for soup in [through(open_box(4)), through(inside_out(open_box(4)))] {
        let (surface, _) = oriented(&soup, KEEP);
        assert!(volume(&surface, 48..surface.faces.len()) > 0.0);
    }
}

#[test]
fn patches_that_share_edges_of_many_faces_are_each_turned_outward() {
    // Two cubes that share one wall, so that every edge of its rim has three faces.
    let (left, right) = (cube(DVec3::ZERO, 1.0, 2), cube(DVec3::X, 1.0, 2));
    let wall = |p: [DVec3; 3]| p.iter().all(|p| p.x == 1.0);
    let mut soup = left.clone();
    for f in (0..right.faces.len()).filter(|&f| !wall(right.corners(f))) {
        let [a, b, c] = right.corners(f);
        push(&mut soup, [a, c, b]);
    }
    let (surface, _) = oriented(&soup, KEEP);
    for f in (0..surface.faces.len()).filter(|&f| !wall(surface.corners(f))) {
        let middle = surface.corners(f).iter().sum::<DVec3>() / 3.0;
        assert!(surface.area_vector(f).dot(middle - DVec3::new(1.0, 0.5, 0.5)) > 0.0, "face {f}");
    }
}

#[test]
fn a_sheet_alone_stays_as_it_was() {
    for soup in [sheet(6), inside_out(sheet(6))] {
        let (surface, applied) = oriented(&soup, KEEP);
        assert_eq!(surface.faces, Surface::from_soup(&soup).0.faces);
        assert!(applied.changes.is_empty());
    }
}

#[test]
fn many_parts_side_by_side_are_all_decided() {
    let mut soup = Soup::default();
    for i in 0..8000u32 {
        let [x, y, z] = [i % 20, i / 20 % 20, i / 400].map(f64::from);
        let first = soup.positions.len() as u32;
        let one = cube(DVec3::new(x, y, z) * 2.0, 1.0, 1);
        soup.positions.extend(one.positions);
        soup.faces.extend(
            one.faces.iter().map(|&[a, b, c]| if i % 3 == 0 { [a, c, b] } else { [a, b, c] }.map(|v| v + first)),
        );
    }
    let all_around = join(&inside_out(cube(DVec3::splat(-9.0), 80.0, 1)), &soup);
    let (surface, applied) = oriented(&soup, KEEP);
    assert!(outward(&surface).into_iter().all(|o| o));
    assert_eq!(applied.left, None);
    let (_, applied) = oriented(&all_around, ALTERNATE);
    assert_eq!((change_count(&applied.changes, "cavities_kept"), applied.left), (2667, None));
}

fn opened(surface: &mut Surface) -> [Applied; 2] {
    with_context(|c| {
        let oriented = KEEP.apply(surface, c).unwrap();
        [oriented, CutNonOrientable::default().apply(surface, c).unwrap()]
    })
}

#[test]
fn a_moebius_band_is_cut_across_into_an_orientable_sheet() {
    for (n, m) in [(40, 6), (9, 1), (24, 3)] {
        let mut surface = moebius_band(n, m);
        let before = measured(&surface);
        let [oriented, cut] = opened(&mut surface);
        assert!(oriented.left.unwrap().contains("1 non-orientable part"));
        let after = measured(&surface);
        assert!(before.misoriented_edges > 0 && after.misoriented_edges == 0, "{n} {m}: {after:?}");
        assert!(after.manifold && after.parts == 1 && surface.faces.len() == (2 * n * m) as usize);
        // The shortest cut across has one edge for each quad.
        assert_eq!(change_count(&cut.changes, "non_orientable_parts_cut"), 1);
        assert_eq!(change_count(&cut.changes, "edges_cut"), u64::from(m), "{n} {m}");
        assert_eq!(after.boundary_edges, before.boundary_edges + 2 * u64::from(m));
        assert!(cut.moved > 0.0 && cut.moved < 1e-5, "{}", cut.moved);
    }
}

#[test]
fn a_klein_bottle_is_cut_into_an_orientable_part() {
    let mut surface = klein_bottle(32, 10);
    let before = measured(&surface);
    assert!(before.closed && before.manifold && before.misoriented_edges > 0);
    let [_, cut] = opened(&mut surface);
    let after = measured(&surface);
    assert_eq!((after.misoriented_edges, after.manifold, after.parts), (0, true, 1));
    assert!(change_count(&cut.changes, "edges_cut") <= 20, "{:?}", cut.changes);
}

#[test]
fn coincident_vertices_that_may_not_move_are_left_and_reported() {
    let mut surface = moebius_band(20, 2);
    with_context(|c| KEEP.apply(&mut surface, c)).unwrap();
    let cut =
        with_context(|c| CutNonOrientable { max_deviation: 0.0, precision: Precision::F32 }.apply(&mut surface, c))
            .unwrap();
    assert_eq!((change_count(&cut.changes, "coincident_vertices_left"), cut.moved), (3, 0.0));
}

#[test]
fn an_orientable_surface_is_not_cut() {
    for soup in [torus(3.0, 1.0, 12, 8), sheet(5), sphere(DVec3::ZERO, 1.0, 12, 6)] {
        let (mut surface, _) = oriented(&soup, KEEP);
        let before = surface.clone();
        assert_eq!(with_context(|c| CutNonOrientable::default().apply(&mut surface, c)).unwrap(), Applied::default());
        assert_eq!(surface, before);
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 32, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn solids_side_by_side_and_hollow_are_right_whatever_faces_were_turned(
        flips in proptest::collection::vec(any::<bool>(), 192),
    ) {
        let hollow = join(&torus(6.0, 2.0, 8, 6), &inside_out(torus(6.0, 0.5, 8, 6)));
        let (right, _) = oriented(&hollow, KEEP);
        let mut soup = hollow;
        for (face, _) in soup.faces.iter_mut().zip(&flips).filter(|(_, flip)| **flip) {
            face.swap(1, 2);
        }
        let (surface, _) = oriented(&soup, ALTERNATE);
        prop_assert!(measured(&surface).printable());
        prop_assert!((volume(&surface, 0..192) - volume(&right, 0..192)).abs() < 1e-9);
    }

    #[test]
    fn there_are_never_more_conflicts_than_before(flips in proptest::collection::vec(any::<bool>(), 96), some in 0..3u32) {
        let mut surface = [moebius_band(12, 4), klein_bottle(12, 4), moebius_band(48, 1)][some as usize].clone();
        for (face, _) in surface.faces.iter_mut().zip(&flips).filter(|(_, flip)| **flip) {
            face.swap(1, 2);
        }
        let before = measured(&surface).misoriented_edges;
        let [oriented, _] = opened(&mut surface);
        prop_assert!(change_count(&oriented.changes, "orientation_conflicts_left") <= before);
        prop_assert_eq!(measured(&surface).misoriented_edges, 0);
        surface.check().map_err(TestCaseError::fail)?;
    }
}
