//! Closing holes of every kind: the patch is manifold, intersects nothing, and lies where it should.

use std::collections::HashMap;

use glam::DVec3;
use meshmend::inspect::{Analysis, Measures, intersections, measure};
use meshmend::mesh::{Soup, Surface};
use meshmend::repair::operators::holes::{FillHoles, Filled, HoleFilling};
use meshmend::repair::sheets::open_sheet_share;
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::meshes::{cube, join, push, sphere, torus};
use crate::operators::{count, with_context};

fn measured(soup: &Soup) -> Measures {
    with_context(|c| measure(soup, c)).unwrap()
}

fn fill(soup: &Soup, with: FillHoles) -> (Surface, Filled) {
    let (mut surface, _) = Surface::from_soup(soup);
    let before = surface.clone();
    let filled = with_context(|c| with.apply(&mut surface, c)).unwrap();
    assert_eq!(surface.faces[..before.faces.len()], before.faces);
    assert_eq!(surface.positions[..before.positions.len()], before.positions);
    (surface, filled)
}

fn crossings(surface: &Surface) -> u64 {
    let soup = surface.to_soup();
    with_context(|c| {
        let analysis = Analysis::new((&soup).into(), c).unwrap();
        intersections(&analysis, c).unwrap().counts.pairs.unwrap()
    })
}

/// Fills, and asserts that the result is closed, manifold and intersects nothing.
fn filled_soundly(soup: &Soup, with: FillHoles) -> (Surface, Measures) {
    let (surface, filled) = fill(soup, with);
    assert_eq!((filled.holes_left, filled.open_sheets, filled.intersecting), (0, 0, 0), "{filled:?}");
    let after = measured(&surface.to_soup());
    assert!(after.printable() && after.degenerate_faces == 0, "{after:?}");
    assert_eq!(crossings(&surface), 0);
    (surface, after)
}

/// Walls over closed polygons in the plane z = 0, down to z = -1, with a bottom that `bottom` gives; polygons of solid
/// outline run counter-clockwise, those of shafts clockwise.
fn without_lid(outlines: &[Vec<[f64; 2]>], bottom: &[[[f64; 2]; 3]]) -> Soup {
    let mut soup = Soup::default();
    let at = |[x, y]: [f64; 2], z: f64| DVec3::new(x, y, z);
    for outline in outlines {
        for (i, &p) in outline.iter().enumerate() {
            let q = outline[(i + 1) % outline.len()];
            push(&mut soup, [at(p, -1.0), at(q, -1.0), at(q, 0.0)]);
            push(&mut soup, [at(p, -1.0), at(q, 0.0), at(p, 0.0)]);
        }
    }
    for t in bottom {
        push(&mut soup, [at(t[0], -1.0), at(t[2], -1.0), at(t[1], -1.0)]);
    }
    soup
}

/// A solid like a comb seen from above, without its lid.
fn comb(teeth: u32) -> Soup {
    let (mut outline, mut bottom) = (vec![[0.0, 0.0], [2.0 * f64::from(teeth), 0.0]], Vec::new());
    for t in (0..teeth).rev() {
        let x = 2.0 * f64::from(t);
        outline.extend([[x + 2.0, 1.0], [x + 1.0, 1.0], [x + 1.0, 5.0], [x, 5.0]]);
        outline.push([x, 1.0]);
    }
    outline.dedup();
    for t in 0..teeth {
        let x = 2.0 * f64::from(t);
        bottom.extend([[[x, 1.0], [x + 1.0, 1.0], [x + 1.0, 5.0]], [[x, 1.0], [x + 1.0, 5.0], [x, 5.0]]]);
    }
    let mut row: Vec<[f64; 2]> = (0..=2 * teeth).map(|i| [f64::from(i), 1.0]).collect();
    row.reverse();
    let end = [2.0 * f64::from(teeth), 0.0];
    bottom.push([[0.0, 0.0], end, row[0]]);
    bottom.extend(row.windows(2).map(|w| [[0.0, 0.0], w[0], w[1]]));
    without_lid(&[outline], &bottom)
}

#[test]
fn a_flat_hole_that_is_not_convex_gets_a_flat_patch_without_overlap() {
    for filling in [HoleFilling::Auto, HoleFilling::Planar, HoleFilling::Sharp] {
        for teeth in [2, 5, 60] {
            let soup = comb(teeth);
            let before = soup.faces.len();
            let (surface, after) = filled_soundly(&soup, FillHoles { filling, ..FillHoles::default() });
            for &f in &surface.faces[before..] {
                assert!(f.iter().all(|&v| surface.positions[v as usize].z == 0.0));
            }
            assert!((after.volume.value - 6.0 * f64::from(teeth)).abs() < 1e-9, "{filling:?} {teeth}");
        }
    }
}

#[test]
fn an_island_in_a_hole_is_joined_and_not_covered() {
    // Of the top of a box a ring is missing; what is left in the middle hangs in the air.
    let mut soup = cube(DVec3::ZERO, 1.0, 6);
    let in_ring = |p: DVec3| {
        let from_middle = (p - DVec3::new(0.5, 0.5, 1.0)).abs();
        p.z == 1.0 && from_middle.max_element() < 1.0 / 3.0 && from_middle.max_element() > 1.0 / 6.0
    };
    let corners: Vec<[DVec3; 3]> = (0..soup.faces.len()).map(|f| soup.corners(f)).collect();
    let mut keep = corners.iter().map(|t| !in_ring(t.iter().sum::<DVec3>() / 3.0));
    soup.faces.retain(|_| keep.next().unwrap());
    let before = measured(&soup);
    assert_eq!((before.parts, before.boundary_loops), (2, 2));
    let (surface, filled) = fill(&soup, FillHoles::default());
    assert_eq!(count(&filled.changes, "islands_joined"), 1);
    let after = measured(&surface.to_soup());
    assert!(after.printable() && after.parts == 1, "{after:?}");
    assert!((after.volume.value - 1.0).abs() < 1e-9);
    assert_eq!(crossings(&surface), 0);
}

fn ring(n: u32, r: f64) -> Vec<[f64; 2]> {
    let at = |i: u32| f64::from(i) / f64::from(n) * std::f64::consts::TAU;
    (0..n).map(|i| [r * at(i).cos(), r * at(i).sin()]).collect()
}

#[test]
fn a_washer_without_its_ends_gets_rings_and_keeps_its_shaft() {
    let (outer, mut inner) = (ring(32, 2.0), ring(16, 1.0));
    inner.reverse();
    let soup = without_lid(&[outer, inner], &[]);
    let (_, after) = filled_soundly(&soup, FillHoles::default());
    let area = |n: f64, r: f64| n / 2.0 * r * r * (std::f64::consts::TAU / n).sin();
    assert_eq!(after.parts, 1);
    assert!((after.volume.value - (area(32.0, 2.0) - area(16.0, 1.0))).abs() < 1e-9, "{after:?}");
}

#[test]
fn both_ends_of_a_flat_cone_without_ends_are_closed_apart() {
    let mut soup = Soup::default();
    let (low, high) = (ring(24, 2.0), ring(24, 1.0));
    for i in 0..24 {
        let j = (i + 1) % 24;
        let [a, b] = [low[i], low[j]].map(|[x, y]| DVec3::new(x, y, 0.0));
        let [c, d] = [high[j], high[i]].map(|[x, y]| DVec3::new(x, y, 0.4));
        push(&mut soup, [a, b, c]);
        push(&mut soup, [a, c, d]);
    }
    let (_, after) = filled_soundly(&soup, FillHoles::default());
    assert!(after.volume.value > 2.0 && after.faces == 48 + 44, "{after:?}");
}

#[test]
fn holes_that_touch_in_a_vertex_are_closed_to_one_manifold_surface() {
    let soup = torus(3.0, 1.0, 24, 12);
    let (surface, _) = Surface::from_soup(&soup);
    for vertex in [0u32, 17, 100] {
        // Of the faces around a vertex every other one goes; and a ring of faces that leaves one vertex' own.
        let around: Vec<usize> = (0..surface.faces.len()).filter(|&f| surface.faces[f].contains(&vertex)).collect();
        let mut holed = surface.to_soup();
        let mut index = 0;
        let gone = [around[0], around[3]];
        let share = |f: usize, g: usize| surface.faces[f].iter().filter(|v| surface.faces[g].contains(v)).count();
        let gone = if share(gone[0], gone[1]) == 1 { gone } else { [around[0], around[2]] };
        holed.faces.retain(|_| {
            index += 1;
            !gone.contains(&(index - 1))
        });
        filled_soundly(&holed, FillHoles::default());
    }
}

#[test]
fn of_two_patches_that_which_intersects_nothing_is_taken() {
    // The rim of a box is a bent square: along one diagonal its patch is a ridge, along the other a valley. A spike ends
    // between the two, once from below and once from above, so that once the one and once the other is clear.
    for base in [-0.5, 1.0] {
        let mut soup = Soup::default();
        let rim = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.3), (1.0, 1.0, 0.0), (0.0, 1.0, 0.3)].map(DVec3::from);
        let floor = rim.map(|p| DVec3::new(p.x, p.y, -1.0));
        for i in 0..4 {
            let j = (i + 1) % 4;
            push(&mut soup, [floor[i], floor[j], rim[j]]);
            push(&mut soup, [floor[i], rim[j], rim[i]]);
        }
        push(&mut soup, [floor[0], floor[2], floor[1]]);
        push(&mut soup, [floor[0], floor[3], floor[2]]);
        let corner = |x: f64, y: f64| DVec3::new(0.5 + x, 0.5 + y, base);
        let foot = [corner(-0.1, -0.1), corner(0.1, -0.1), corner(0.0, 0.1)];
        let tip = DVec3::new(0.5, 0.5, 0.15);
        let mut spike =
            [[foot[0], foot[2], foot[1]], [foot[0], foot[1], tip], [foot[1], foot[2], tip], [foot[2], foot[0], tip]];
        // From below it is a cavity, from above a solid of its own.
        spike.iter_mut().for_each(|t| t.swap(1, 2));
        spike.into_iter().for_each(|t| push(&mut soup, t));
        let (_, after) = filled_soundly(&soup, FillHoles::default());
        assert_eq!(after.parts, 2);
    }
}

/// A cup whose rim has `n` edges and goes up and down by `wave`.
fn cup(n: u32, wave: f64) -> Soup {
    let mut soup = Soup::default();
    let at = |i: u32, top: bool| {
        let u = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        let r = 1.0 + 0.1 * (7.0 * u).sin();
        DVec3::new(r * u.cos(), r * u.sin(), if top { 1.0 + wave * (5.0 * u).sin() } else { 0.0 })
    };
    for i in 0..n {
        let [a, b, c, d] = [at(i, false), at(i + 1, false), at(i + 1, true), at(i, true)];
        for t in [[a, b, c], [a, c, d], [DVec3::ZERO, b, a]] {
            push(&mut soup, t);
        }
    }
    soup
}

#[test]
fn a_rim_of_ten_thousand_edges_is_closed() {
    for wave in [0.0, 0.1] {
        filled_soundly(&cup(500, wave), FillHoles::default());
        let (surface, filled) = fill(&cup(10_000, wave), FillHoles::default());
        assert_eq!((filled.holes_left, filled.intersecting, filled.unchecked), (0, 0, 0));
        assert_eq!(surface.faces.len(), 30_000 + 9_998);
        let uses = uses(&surface);
        assert!(uses.iter().all(|(&(a, b), &n)| n == 1 && uses.contains_key(&(b, a))));
    }
}

#[test]
fn sharp_filling_leaves_open_what_would_intersect() {
    // A plate that passes through the opening of a box and touches its walls nowhere.
    let mut soup = cube(DVec3::ZERO, 1.0, 2);
    soup.faces.truncate(soup.faces.len() - 8);
    let plate = cube(DVec3::splat(0.0), 0.5, 1);
    let mut through = plate.clone();
    for p in &mut through.positions {
        *p = DVec3::new(0.25, 0.45, 0.5) + *p * DVec3::new(1.0, 0.2, 2.0);
    }
    let soup = join(&soup, &through);
    let sharp = FillHoles { filling: HoleFilling::Sharp, ..FillHoles::default() };
    let (surface, filled) = fill(&soup, sharp);
    assert_eq!((filled.holes_left, crossings(&surface)), (1, 0), "{filled:?}");
    let (surface, filled) = fill(&soup, FillHoles::default());
    assert_eq!((filled.holes_left, filled.intersecting), (0, 1));
    assert!(crossings(&surface) > 0);
}

#[test]
fn the_mouths_of_a_ball_cut_on_four_sides_are_closed_clear_of_each_other() {
    let soup = sphere(DVec3::ZERO, 1.0, 24, 12);
    let mut holed = soup.clone();
    let mut keep = (0..soup.faces.len()).map(|f| {
        let middle = soup.corners(f).iter().sum::<DVec3>() / 3.0;
        middle.x.abs() < 0.6 && middle.y.abs() < 0.6
    });
    holed.faces.retain(|_| keep.next().unwrap());
    filled_soundly(&holed, FillHoles::default());
}

/// A ball without the faces above a height.
fn open_ball(below: f64) -> Soup {
    let mut soup = sphere(DVec3::ZERO, 1.0, 40, 20);
    let corners: Vec<[DVec3; 3]> = (0..soup.faces.len()).map(|f| soup.corners(f)).collect();
    let mut keep = corners.iter().map(|t| t.iter().all(|p| p.z < below));
    soup.faces.retain(|_| keep.next().unwrap());
    soup
}

#[test]
fn fairing_bulges_where_the_surface_does_and_moves_nothing_of_it() {
    let ball = measured(&sphere(DVec3::ZERO, 1.0, 40, 20)).volume.value;
    let wavy = {
        // A rim that is not plane, so that the patch is not either.
        let mut soup = open_ball(0.75);
        soup.faces.truncate(soup.faces.len() - 1);
        soup
    };
    let volume = |refine, fair| {
        let (surface, after) = filled_soundly(&wavy, FillHoles { refine, fair, ..FillHoles::default() });
        (after.volume.value, surface.positions.len())
    };
    let (plain, refined, faired) = (volume(false, false), volume(true, false), volume(true, true));
    assert!(refined.1 > plain.1 && faired.1 == refined.1, "{plain:?} {refined:?}");
    assert!((refined.0 - plain.0).abs() < 0.02 * ball);
    assert!(ball - faired.0 < 0.5 * (ball - plain.0), "{plain:?} {faired:?} {ball}");
}

#[test]
fn a_plane_patch_stays_plane_when_patches_are_faired() {
    let mut soup = cube(DVec3::ZERO, 1.0, 8);
    soup.faces.truncate(soup.faces.len() - 128);
    let (surface, after) = filled_soundly(&soup, FillHoles { refine: true, fair: true, ..FillHoles::default() });
    assert!((after.volume.value - 1.0).abs() < 1e-12);
    assert_eq!(surface.faces.len(), soup.faces.len() + 30);
}

#[test]
fn limits_in_size_and_number_leave_the_larger_holes_and_say_so() {
    let mut soup = sphere(DVec3::ZERO, 1.0, 24, 12);
    soup.faces.drain(300..302);
    soup.faces.drain(156..170);
    soup.faces.remove(40);
    for (with, left) in [
        (FillHoles { max_holes: 2, ..FillHoles::default() }, 1),
        (FillHoles { max_holes: 0, ..FillHoles::default() }, 3),
        (FillHoles { max_size: 0.13, ..FillHoles::default() }, 2),
        (FillHoles { max_edges: 4, ..FillHoles::default() }, 1),
    ] {
        let (_, filled) = fill(&soup, with);
        assert!(filled.over_limit >= 1 && filled.over_limit == filled.holes_left, "{with:?} {filled:?}");
        assert_eq!(filled.over_limit.min(3), left, "{with:?} {filled:?}");
    }
}

/// A thin-walled vase: an outer and an inner surface, joined at the rim or not.
fn vase(rim: bool) -> Soup {
    let mut soup = Soup::default();
    let n = 24;
    let at = |i: u32, r: f64, z: f64| {
        let u = f64::from(i % n) / f64::from(n) * std::f64::consts::TAU;
        DVec3::new(r * u.cos(), r * u.sin(), z)
    };
    for i in 0..n {
        let mut quad = |[r0, z0]: [f64; 2], [r1, z1]: [f64; 2]| {
            let [a, b, c, d] = [at(i, r0, z0), at(i + 1, r0, z0), at(i + 1, r1, z1), at(i, r1, z1)];
            for t in [[a, b, c], [a, c, d]] {
                if t[0] != t[1] && t[1] != t[2] && t[2] != t[0] {
                    push(&mut soup, t);
                }
            }
        };
        quad([0.0, 0.0], [1.0, 0.0]);
        quad([1.0, 0.0], [1.2, 3.0]);
        if rim {
            quad([1.2, 3.0], [1.1, 3.0]);
        }
        quad([1.1, 3.0], [0.9, 0.1]);
        quad([0.9, 0.1], [0.0, 0.1]);
    }
    soup
}

#[test]
fn a_vase_without_its_rim_gets_a_rim_and_no_lid() {
    let whole = measured(&vase(true));
    assert!(whole.printable());
    let (_, after) = filled_soundly(&vase(false), FillHoles::default());
    assert!((after.volume.value - whole.volume.value).abs() < 1e-9 && after.parts == 1);
}

#[test]
fn solids_with_openings_are_told_from_sheets() {
    let tube = {
        let outline = ring(24, 1.0);
        without_lid(&[outline], &[])
    };
    let mut box_without_lid = cube(DVec3::ZERO, 1.0, 4);
    box_without_lid.faces.truncate(box_without_lid.faces.len() - 32);
    let mut wall = Soup::default();
    let at = |x: f64, z: f64| DVec3::new(x, 0.0, z);
    push(&mut wall, [at(0.0, 0.0), at(4.0, 0.0), at(4.0, 2.0)]);
    push(&mut wall, [at(0.0, 0.0), at(4.0, 2.0), at(0.0, 2.0)]);
    for (what, soup, is_sheet) in [
        ("a bowl as a half sphere is closed by its disc", open_ball(0.0), false),
        ("a ball without a cap", open_ball(0.7), false),
        ("a watch glass", open_ball(-0.97), true),
        ("a box without a lid", box_without_lid, false),
        ("a tube open at both ends", tube, false),
        ("terrain", crate::meshes::sheet(12), true),
        ("a single wall", wall, true),
    ] {
        let (_, filled) = fill(&soup, FillHoles::default());
        assert_eq!(filled.open_sheets > 0, is_sheet, "{what}: {filled:?}");
        assert_eq!(open_sheet_share(&Surface::from_soup(&soup).0) > 0.5, is_sheet, "{what}");
    }
}

/// How many faces use each edge in each direction.
fn uses(surface: &Surface) -> HashMap<(u32, u32), u32> {
    let mut uses = HashMap::new();
    for &[a, b, c] in &surface.faces {
        for edge in [(a, b), (b, c), (c, a)] {
            *uses.entry(edge).or_default() += 1;
        }
    }
    uses
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 64, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn whatever_faces_are_missing_the_surface_is_closed_again(
        which in 0..3usize,
        gone in proptest::collection::vec((0..10_000usize, 1..5usize), 1..12),
    ) {
        let soup = [cube(DVec3::ZERO, 2.0, 5), torus(3.0, 1.0, 20, 12), sphere(DVec3::ZERO, 2.0, 20, 10)][which].clone();
        let whole = measured(&soup).volume.value;
        let (surface, _) = Surface::from_soup(&soup);
        let mut missing = vec![false; surface.faces.len()];
        for (seed, spread) in gone {
            // A face and what is around it.
            let vertex = surface.faces[seed % surface.faces.len()][0];
            let near = surface.faces.iter().enumerate().filter(|(_, f)| f.contains(&vertex));
            for (f, _) in near.take(spread) {
                missing[f] = true;
            }
        }
        let mut index = 0;
        let mut holed = surface.to_soup();
        holed.faces.retain(|_| { index += 1; !missing[index - 1] });
        // What hangs on by vertices alone is a part of its own, and a lone face encloses nothing.
        prop_assume!(measured(&holed).parts == 1);
        let (after, filled) = fill(&holed, FillHoles::default());
        prop_assert_eq!((filled.holes_left, filled.open_sheets), (0, 0));
        prop_assert!(uses(&after).values().all(|&n| n == 1));
        let m = measured(&after.to_soup());
        prop_assert!(m.closed && m.manifold && m.consistent, "{:?}", m);
        prop_assert!((m.volume.value - whole).abs() < 0.2 * whole, "{} {}", m.volume.value, whole);
        if filled.intersecting == 0 {
            prop_assert_eq!(crossings(&after), 0);
        }
    }

    #[test]
    fn every_way_of_filling_keeps_random_faces_no_worse(
        faces in proptest::collection::vec((0..9u32, 0..9u32, 0..9u32), 1..30),
        which in 0..4usize,
        refine in any::<bool>(),
    ) {
        let positions = (0..9).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 3), f64::from(i * i % 5))).collect();
        let faces = faces.into_iter().filter(|(a, b, c)| a != b && b != c && c != a);
        let soup = Soup { positions, faces: faces.map(|(a, b, c)| [a, b, c]).collect() };
        let filling = [HoleFilling::Auto, HoleFilling::Smooth, HoleFilling::Planar, HoleFilling::Sharp][which];
        let before = measured(&soup);
        let (surface, _) = fill(&soup, FillHoles { filling, refine, fair: refine, ..FillHoles::default() });
        let after = measured(&surface.to_soup());
        prop_assert!(after.boundary_edges <= before.boundary_edges);
        prop_assert!(after.non_manifold_edges <= before.non_manifold_edges);
        prop_assert!(after.non_manifold_vertices <= before.non_manifold_vertices);
    }
}
