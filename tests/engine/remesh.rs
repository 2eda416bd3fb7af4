//! The native remesh makes a solid of any mesh that encloses volume.

use glam::{DQuat, DVec3};
use meshmend::context::{Cancelled, Context, NoProgress};
use meshmend::inspect::measure;
use meshmend::math::{Tree, r3};
use meshmend::mesh::{NO_SOURCE, Soup, Surface};
use meshmend::remesh::{Remesh, RemeshError, Remeshed, WindingRule};
use meshmend::repair::operators::remesh::RemeshInside;
use proptest::prelude::*;

use crate::meshes::{cube, cuboid, inside_out, join, push, sheet, sphere};
use crate::support::{change_count, measured_as_stl, with_context};

/// Remeshes with cells of 1/`n` of the diagonal.
fn remeshed(soup: &Soup, n: f64, winding_rule: WindingRule) -> Result<Remeshed, RemeshError> {
    let (surface, _) = Surface::from_soup(soup);
    let diagonal = meshmend::math::Box3::of(surface.positions.iter().copied()).diagonal();
    with_context(|c| Remesh { cell: Some(diagonal / n), winding_rule, ..Remesh::default() }.apply(&surface, c))
}

fn solid(soup: &Soup, n: f64) -> Remeshed {
    let remeshed = remeshed(soup, n, WindingRule::Positive).unwrap();
    let m = measured_as_stl(&remeshed.surface);
    assert!(m.closed && m.manifold && m.consistent, "{m:?}");
    assert_eq!((m.degenerate_faces, m.duplicate_faces, m.self_intersections.pairs), (0, 0, Some(0)), "{m:?}");
    assert!(m.printable() && m.volume.value > 0.0, "{m:?}");
    assert_eq!(m.faces, remeshed.surface.faces.len() as u64);
    assert!(remeshed.surface.source.iter().all(|&source| source == NO_SOURCE));
    remeshed
}

fn volume(remeshed: &Remeshed) -> f64 {
    measured_as_stl(&remeshed.surface).volume.value
}

fn turned(mut soup: Soup) -> Soup {
    let turn = DQuat::from_axis_angle(DVec3::new(1.0, 2.0, 3.0).normalize(), 0.7);
    for p in &mut soup.positions {
        *p = turn * *p;
    }
    soup
}

fn assert_near(value: f64, wanted: f64, share: f64) {
    assert!((value - wanted).abs() <= share * wanted, "{value} instead of {wanted}");
}

/// Walls from `z = 0` to `z = height` along an outline: counter-clockwise, or clockwise for a hole.
fn walls(soup: &mut Soup, outline: &[[f64; 2]], height: f64) {
    for i in 0..outline.len() {
        let [a, b] = [outline[i], outline[(i + 1) % outline.len()]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let up = DVec3::Z * height;
        push(soup, [a, b, b + up]);
        push(soup, [a, b + up, a + up]);
    }
}

fn circle(centre: [f64; 2], radius: f64, n: u32, clockwise: bool) -> Vec<[f64; 2]> {
    let point = |i: u32| {
        let angle = f64::from(if clockwise { n - i } else { i }) / f64::from(n) * std::f64::consts::TAU;
        [centre[0] + radius * angle.cos(), centre[1] + radius * angle.sin()]
    };
    (0..n).map(point).collect()
}

/// The floor and the roof between an outline and a hole with as many corners.
fn caps(soup: &mut Soup, outline: &[[f64; 2]], hole: &[[f64; 2]], height: f64) {
    let n = outline.len();
    for i in 0..n {
        // The hole has the opposite direction.
        let inner = |i: usize| hole[(n - i) % n];
        let at = |[x, y]: [f64; 2], z: f64| DVec3::new(x, y, z);
        let [a, b, c, d] = [outline[i], outline[(i + 1) % n], inner(i + 1), inner(i)];
        for triangle in [[a, b, c], [a, c, d]] {
            push(soup, triangle.map(|p| at(p, height)));
            let [p, q, r] = triangle.map(|p| at(p, 0.0));
            push(soup, [p, r, q]);
        }
    }
}

/// A bracket: two plates at a right angle, one with a round hole. Plates overlap at the corner.
fn bracket() -> Soup {
    let mut plate = Soup::default();
    let n = 48;
    let hole = circle([0.0, 0.0], 0.6, n, true);
    // A square outline with as many corners as the hole.
    let outline: Vec<[f64; 2]> = circle([0.0, 0.0], 1.0, n, false)
        .into_iter()
        .map(|[x, y]| {
            let longest = x.abs().max(y.abs());
            [2.0 * x / longest, 2.0 * y / longest]
        })
        .collect();
    walls(&mut plate, &outline, 0.5);
    walls(&mut plate, &hole, 0.5);
    caps(&mut plate, &outline, &hole, 0.5);
    let mut upright = cube(DVec3::ZERO, 1.0, 1);
    for p in &mut upright.positions {
        *p = DVec3::new(1.5 + 0.5 * p.x, -2.0 + 4.0 * p.y, 3.0 * p.z);
    }
    join(&plate, &upright)
}

/// The share of the length of these edges that is within a quarter of a cell of the result.
fn share_kept(remeshed: &Remeshed, edges: &[[DVec3; 2]]) -> f64 {
    let Surface { positions, faces, .. } = &remeshed.surface;
    let tree = Tree::new(positions, faces);
    let corners = |f: u32| faces[f as usize].map(|v| positions[v as usize]);
    let (mut good, mut all) = (0.0, 0.0);
    for [a, b] in edges {
        for i in 0..200 {
            let p = a.lerp(*b, (f64::from(i) + 0.5) / 200.0);
            let near = tree.nearest(p, f64::INFINITY, &mut u64::MAX.clone(), corners).unwrap();
            all += a.distance(*b);
            good += if near.distance <= remeshed.cell / 4.0 { a.distance(*b) } else { 0.0 };
        }
    }
    good / all
}

#[test]
fn a_turned_box_keeps_its_volume_its_sides_and_its_edges() {
    let soup = turned(cube(DVec3::ZERO, 1.0, 1));
    let remeshed = solid(&soup, 64.0);
    assert_near(volume(&remeshed), 1.0, 1e-4);
    assert!(remeshed.deviation.lost.max < remeshed.cell / 4.0, "{:?}", remeshed.deviation);
    assert!(remeshed.deviation.added.p99 < 0.02 * remeshed.cell, "{:?}", remeshed.deviation);
    let corners: Vec<DVec3> = turned(Soup {
        positions: (0..8).map(|i| DVec3::new(f64::from(i & 1), f64::from(i >> 1 & 1), f64::from(i >> 2))).collect(),
        faces: Vec::new(),
    })
    .positions;
    let edges: Vec<[DVec3; 2]> = (0..8usize)
        .flat_map(|i| [1usize, 2, 4].map(|bit| (i, i ^ bit)))
        .filter(|(i, j)| i < j)
        .map(|(i, j)| [corners[i], corners[j]])
        .collect();
    assert_eq!(edges.len(), 12);
    assert!(share_kept(&remeshed, &edges) > 0.98, "{}", share_kept(&remeshed, &edges));
}

#[test]
fn a_box_along_the_axes_has_flat_sides() {
    let remeshed = solid(&cube(DVec3::ZERO, 10.0, 2), 80.0);
    assert_near(volume(&remeshed), 1000.0, 1e-4);
    assert!(remeshed.deviation.added.p99 < 1e-5, "{:?}", remeshed.deviation);
}

#[test]
fn a_ball_keeps_its_volume_and_its_shape() {
    let remeshed = solid(&sphere(DVec3::splat(5.0), 1.0, 48, 24), 100.0);
    let wanted = with_context(|c| measure(&sphere(DVec3::ZERO, 1.0, 48, 24), c)).unwrap().volume.value;
    assert_near(volume(&remeshed), wanted, 1e-3);
    assert!(remeshed.deviation.lost.max < remeshed.cell / 4.0 && remeshed.deviation.added.max < remeshed.cell / 4.0);
}

#[test]
fn a_cavity_stays_a_cavity() {
    let soup = join(&sphere(DVec3::ZERO, 2.0, 32, 16), &inside_out(cube(DVec3::splat(-0.5), 1.0, 1)));
    let remeshed = solid(&soup, 80.0);
    let outer = with_context(|c| measure(&sphere(DVec3::ZERO, 2.0, 32, 16), c)).unwrap().volume.value;
    assert_near(volume(&remeshed), outer - 1.0, 2e-3);
    assert_eq!(measured_as_stl(&remeshed.surface).parts, 2);
}

#[test]
fn holes_are_closed_and_flipped_faces_forgiven() {
    let mut soup = cube(DVec3::ZERO, 1.0, 6);
    for f in [0, 50, 51, 130, 200] {
        soup.faces.swap_remove(f);
    }
    for f in [17, 100, 180] {
        soup.faces[f].swap(1, 2);
    }
    let remeshed = solid(&turned(soup), 64.0);
    assert_near(volume(&remeshed), 1.0, 0.01);
    assert_eq!(measured_as_stl(&remeshed.surface).parts, 1);
}

#[test]
fn boxes_that_overlap_are_one() {
    let soup = turned(join(&cube(DVec3::ZERO, 1.0, 2), &cube(DVec3::splat(0.5), 1.0, 3)));
    let remeshed = solid(&soup, 64.0);
    assert_near(volume(&remeshed), 2.0 - 0.125, 1e-3);
    assert_eq!(measured_as_stl(&remeshed.surface).parts, 1);
}

#[test]
fn an_inverted_part_is_solid_on_request() {
    let soup = inside_out(cube(DVec3::ZERO, 1.0, 2));
    assert_eq!(remeshed(&soup, 32.0, WindingRule::Positive).unwrap_err(), RemeshError::Empty);
    let remeshed = remeshed(&soup, 32.0, WindingRule::Nonzero).unwrap();
    assert_near(volume(&remeshed), 1.0, 1e-3);
}

#[test]
fn the_sharp_edges_of_a_bracket_are_kept() {
    let remeshed = solid(&turned(bracket()), 128.0);
    let area = 16.0 - 24.0 * 0.36 * (std::f64::consts::TAU / 48.0).sin();
    assert_near(volume(&remeshed), area * 0.5 + 0.5 * 4.0 * 2.5, 2e-3);
    let hole = circle([0.0, 0.0], 0.6, 48, false);
    let mut edges: Vec<[DVec3; 2]> = Vec::new();
    for z in [0.0, 0.5] {
        edges.extend((0..48).map(|i| [hole[i], hole[(i + 1) % 48]].map(|[x, y]| DVec3::new(x, y, z))));
    }
    let at = DVec3::new;
    edges.extend([
        [at(-2.0, -2.0, 0.0), at(2.0, -2.0, 0.0)],
        [at(-2.0, -2.0, 0.0), at(-2.0, 2.0, 0.0)],
        [at(-2.0, -2.0, 0.0), at(-2.0, -2.0, 0.5)],
        [at(-2.0, -2.0, 0.5), at(1.5, -2.0, 0.5)],
        // Where the plates meet, which is not an edge of either.
        [at(1.5, -2.0, 0.5), at(1.5, 2.0, 0.5)],
        [at(1.5, -2.0, 3.0), at(1.5, 2.0, 3.0)],
        [at(2.0, -2.0, 0.0), at(2.0, -2.0, 3.0)],
    ]);
    let positions = edges.iter().flatten().copied().collect();
    let turned: Vec<DVec3> = turned(Soup { positions, faces: Vec::new() }).positions;
    let edges: Vec<[DVec3; 2]> = turned.chunks(2).map(|ends| [ends[0], ends[1]]).collect();
    assert!(share_kept(&remeshed, &edges) > 0.95, "{}", share_kept(&remeshed, &edges));
}

#[test]
fn a_wall_and_a_wire_thinner_than_a_cell_are_kept() {
    let mut wall = cube(DVec3::ZERO, 1.0, 1);
    for p in &mut wall.positions {
        *p = DVec3::new(p.x * 10.0, 0.003 + p.y * 0.01, p.z * 10.0);
    }
    let mut wire = cube(DVec3::ZERO, 1.0, 1);
    for p in &mut wire.positions {
        *p = DVec3::new(p.x * 10.0, 3.0 + p.y * 0.02, 5.0 + p.z * 0.02);
    }
    for soup in [&wall, &wire] {
        let remeshed = solid(&turned(join(soup, &cube(DVec3::new(0.0, 6.0, 0.0), 1.0, 1))), 64.0);
        assert!(remeshed.deviation.lost.max < 1.5 * remeshed.cell, "{:?} at {}", remeshed.deviation, remeshed.cell);
        assert_eq!(measured_as_stl(&remeshed.surface).parts, 2);
    }
}

#[test]
fn a_small_distant_part_is_kept() {
    let soup = join(&cube(DVec3::ZERO, 1e-3, 1), &cube(DVec3::splat(100.0), 20.0, 1));
    let remeshed = solid(&soup, 100.0);
    assert_eq!(measured_as_stl(&remeshed.surface).parts, 2);
    assert!(remeshed.deviation.lost.max < 1.5 * remeshed.cell);
}

#[test]
fn a_soup_of_walls_is_solid() {
    let mut soup = Soup::default();
    for i in 0..40 {
        let at = DVec3::from(r3(f64::from(i))) * 4.0;
        let size = DVec3::from(r3(f64::from(i + 900))) * 2.0 + 0.05;
        soup = join(&soup, &cuboid(at, size, 1));
        push(&mut soup, [at, at + DVec3::new(size.x, 0.3, 0.0), at + DVec3::new(0.2, size.y, size.z)]);
    }
    solid(&turned(soup), 96.0);
}

#[test]
fn a_volume_that_reaches_the_limit_of_the_grid_is_closed_there() {
    // So many coincident sheets have a winding number above one half far outside their bounding box.
    let soup = (0..40).fold(Soup::default(), |all, i| {
        let mut one = sheet(6);
        one.positions.iter_mut().for_each(|p| p.z += 0.01 * f64::from(i));
        join(&all, &one)
    });
    let remeshed = solid(&soup, 24.0);
    assert!(volume(&remeshed) > 100.0, "{}", volume(&remeshed));
}

#[test]
fn a_mesh_that_encloses_nothing_gives_an_empty_result() {
    let mut triangle = Soup::default();
    push(&mut triangle, [DVec3::ZERO, DVec3::X, DVec3::Y]);
    let mut needle = Soup::default();
    push(&mut needle, [DVec3::ZERO, DVec3::X, DVec3::X * 2.0]);
    let mut flat = sheet(8);
    for p in &mut flat.positions {
        p.z = 0.0;
    }
    for soup in [Soup::default(), triangle, needle, flat] {
        assert_eq!(remeshed(&soup, 64.0, WindingRule::Positive).unwrap_err(), RemeshError::Empty);
    }
}

#[test]
fn there_are_never_more_faces_than_allowed() {
    let (surface, _) = Surface::from_soup(&sphere(DVec3::ZERO, 1.0, 24, 12));
    for max_faces in [500, 3000, 20_000] {
        let remeshed = with_context(|c| Remesh { max_faces, ..Remesh::default() }.apply(&surface, c)).unwrap();
        let faces = remeshed.surface.faces.len() as u64;
        assert!(faces <= max_faces && faces * 4 > max_faces, "{faces}");
    }
    let none = with_context(|c| Remesh { max_faces: 3, ..Remesh::default() }.apply(&surface, c));
    assert_eq!(none.unwrap_err(), RemeshError::Limits);
}

#[test]
fn size_and_place_of_the_model_do_not_matter() {
    for (size, at) in [(1e-30, 0.0), (1e30, 0.0), (1.0, 1000.0), (1e-3, 1.0)] {
        let mut soup = sphere(DVec3::ZERO, 1.0, 16, 8);
        for p in &mut soup.positions {
            *p = *p * size + at;
        }
        let remeshed = remeshed(&soup, 48.0, WindingRule::Positive).unwrap();
        let m = measured_as_stl(&remeshed.surface);
        assert!(m.closed && m.manifold && m.consistent, "{size} {at} {m:?}");
        assert_eq!(m.self_intersections.pairs, Some(0), "{size} {at}");
    }
}

#[test]
fn the_surface_and_deviation_are_the_same_on_any_number_of_threads() {
    let soup = turned(join(&bracket(), &sphere(DVec3::splat(0.4), 1.0, 24, 12)));
    let [one, two] = [1, 2].map(|threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| remeshed(&soup, 100.0, WindingRule::Positive).unwrap())
    });
    assert_eq!(one.surface, two.surface);
    assert_eq!(one.deviation, two.deviation);
}

#[test]
fn a_cancelled_remesh_stops() {
    let (surface, _) = Surface::from_soup(&cube(DVec3::ZERO, 1.0, 1));
    let cancel = std::sync::atomic::AtomicBool::new(true);
    let clock = || std::time::Duration::ZERO;
    let context = Context::new(&NoProgress, &cancel, &clock, std::time::Duration::from_secs(1));
    let error = Remesh::default().apply(&surface, &context).unwrap_err();
    assert_eq!(error, RemeshError::Cancelled(Cancelled));
}

#[test]
fn a_remesh_that_moves_too_far_or_encloses_nothing_is_undone() {
    let (before, _) = Surface::from_soup(&sphere(DVec3::ZERO, 1.0, 16, 8));
    let remesh = Remesh { cell: Some(0.1), ..Remesh::default() };
    let run = |surface: &mut Surface, most: f64| {
        with_context(|c| RemeshInside { remesh, max_deviation: most, reduce: true }.apply(surface, c)).unwrap()
    };
    let mut surface = before.clone();
    let applied = run(&mut surface, 0.0);
    assert!(applied.failed.is_some() && surface == before);
    let applied = run(&mut surface, f64::INFINITY);
    assert!(applied.failed.is_none() && applied.moved > 0.0 && surface != before);
    let count = |what| change_count(&applied.changes, what);
    assert_eq!(count("faces_created") - count("faces_removed"), surface.faces.len() as u64);
    let (mut open, _) =
        Surface::from_soup(&Soup { positions: vec![DVec3::ZERO, DVec3::X, DVec3::Y], faces: vec![[0, 1, 2]] });
    assert!(run(&mut open, f64::INFINITY).failed.unwrap().to_string().contains("has no inside"));
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn any_triangles_give_a_solid_or_nothing(seed in 0u32..100_000, count in 4u32..40, n in 16.0f64..48.0) {
        let mut soup = Soup::default();
        for i in 0..count {
            let corner = |k: u32| DVec3::from(r3(f64::from(seed + 3 * i + k)));
            push(&mut soup, [corner(0), corner(1), corner(2)]);
        }
        for winding_rule in [WindingRule::Positive, WindingRule::Nonzero] {
            match remeshed(&soup, n, winding_rule) {
                Ok(remeshed) => {
                    let m = measured_as_stl(&remeshed.surface);
                    prop_assert!(m.closed && m.manifold && m.consistent, "{:?}", m);
                    prop_assert_eq!(m.self_intersections.pairs, Some(0));
                    prop_assert_eq!(m.degenerate_faces, 0);
                }
                Err(error) => prop_assert_eq!(error, RemeshError::Empty),
            }
        }
    }
}
