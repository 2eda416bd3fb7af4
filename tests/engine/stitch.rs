//! Cracks: welded, split at T-junctions and stitched.

use glam::DVec3;
use meshmend::mesh::{Edges, Soup, Surface};
use meshmend::repair::operators::holes::FillHoles;
use meshmend::repair::operators::stitch::Stitch;
use meshmend::repair::operators::t_junctions::SplitTJunctions;
use meshmend::repair::operators::weld::Sew;
use meshmend::repair::operators::{Applied, Counts};
use proptest::prelude::*;
use proptest::test_runner::RngSeed;

use crate::meshes::{cube, join, push, sheet, sphere, torus};
use crate::support::{change_count, measured, with_context};

fn surface(soup: &Soup) -> Surface {
    Surface::from_soup(soup).0
}

/// Pseudo-random numbers in 0..1 that depend only on the seed.
struct Random(u64);

impl Random {
    fn next(&mut self) -> f64 {
        self.0 = self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((self.0 >> 33) as f64) / f64::from(1u32 << 31)
    }

    fn within(&mut self, size: f64) -> DVec3 {
        DVec3::new(self.next(), self.next(), self.next()) * 2.0 * size - size
    }
}

/// A connected patch of `faces` faces that grows randomly from one.
fn patch(surface: &Surface, faces: usize, random: &mut Random) -> Vec<bool> {
    let edges = Edges::new(&surface.faces);
    let mut next = vec![Vec::new(); surface.faces.len()];
    for pair in edges.iter().filter(|h| h.len() == 2) {
        let [f, g] = [pair[0] as usize / 3, pair[1] as usize / 3];
        next[f].push(g);
        next[g].push(f);
    }
    let mut inside = vec![false; surface.faces.len()];
    let mut front = vec![(random.next() * surface.faces.len() as f64) as usize];
    let mut taken = 0;
    while taken < faces && !front.is_empty() {
        let f = front.swap_remove((random.next() * front.len() as f64) as usize);
        if !std::mem::replace(&mut inside[f], true) {
            taken += 1;
            front.extend(next[f].iter().filter(|&&g| !inside[g]));
        }
    }
    inside
}

/// Separates the faces of a patch from the rest, moves each of its boundary vertices by up to `size`, and splits a share
/// of its outer edges.
fn cracked(soup: &Soup, inside: &[bool], size: f64, cuts: f64, random: &mut Random) -> Surface {
    let whole = surface(soup);
    let mut surface = Surface { positions: whole.positions.clone(), ..Surface::default() };
    let mut shared = vec![false; whole.positions.len()];
    for (face, _) in whole.faces.iter().zip(inside).filter(|(_, i)| !**i) {
        face.iter().for_each(|&v| shared[v as usize] = true);
    }
    let mut copy = vec![None; whole.positions.len()];
    let edges = Edges::new(&whole.faces);
    for (f, face) in whole.faces.iter().enumerate() {
        if !inside[f] {
            surface.push_patch(*face);
            continue;
        }
        let own = face.map(|v| {
            let add = |surface: &mut Surface, random: &mut Random| {
                surface.positions.push(whole.positions[v as usize] + random.within(size));
                surface.positions.len() as u32 - 1
            };
            if shared[v as usize] { *copy[v as usize].get_or_insert_with(|| add(&mut surface, random)) } else { v }
        });
        let outer = (0..3).find(|&i| {
            let pair = edges.half_edges(edges.find(face[i], face[(i + 1) % 3]).unwrap());
            pair.iter().any(|&h| !inside[h as usize / 3])
        });
        match outer.filter(|_| random.next() < cuts) {
            None => surface.push_patch(own),
            Some(i) => {
                let [a, b, c] = [own[i], own[(i + 1) % 3], own[(i + 2) % 3]];
                let middle =
                    surface.positions[a as usize].lerp(surface.positions[b as usize], 0.3 + 0.4 * random.next());
                let m = surface.positions.len() as u32;
                surface.positions.push(middle + random.within(size));
                surface.push_patch([a, m, c]);
                surface.push_patch([m, b, c]);
            }
        }
    }
    surface.drop_unreferenced();
    surface
}

fn stitched(surface: &mut Surface, stitch: Stitch) -> Applied {
    with_context(|c| stitch.apply(surface, c)).unwrap()
}

/// The largest distance of a face corner of `after` from the nearest vertex of `before`.
fn farthest(before: &Surface, after: &Surface) -> f64 {
    let nearest = |p: &DVec3| before.positions.iter().map(|q| q.distance(*p)).fold(f64::MAX, f64::min);
    after.positions.iter().map(nearest).fold(0.0, f64::max)
}

fn solids() -> [Soup; 3] {
    [cube(DVec3::ZERO, 2.0, 6), torus(3.0, 1.0, 24, 12), sphere(DVec3::ONE, 2.0, 20, 12)]
}

#[test]
fn a_crack_with_the_same_vertices_on_both_sides_is_sewn() {
    let mut random = Random(3);
    for soup in solids() {
        let whole = measured(&surface(&soup));
        let inside = patch(&surface(&soup), soup.faces.len() / 3, &mut random);
        let mut mesh = cracked(&soup, &inside, 1e-4, 0.0, &mut random);
        let before = mesh.clone();
        assert!(measured(&mesh).boundary_edges > 20);
        let applied = with_context(|c| Sew::default().apply(&mut mesh, c)).unwrap();
        let after = measured(&mesh);
        assert!(after.printable() && after.parts == 1, "{after:?}");
        assert_eq!(
            before.positions.len() - mesh.positions.len(),
            change_count(&applied.changes, "boundary_vertices_sewn") as usize
        );
        assert!((after.volume.value - whole.volume.value).abs() < 1e-3 * whole.volume.value);
        assert!(applied.moved > 0.0 && applied.moved < 4e-4);
        assert_eq!(farthest(&before, &mesh), 0.0, "vertices that stay do not move");
        assert_eq!(mesh.faces.len(), soup.faces.len());
    }
}

#[test]
fn sewing_respects_the_ratio_and_the_cap() {
    let mut random = Random(5);
    let soup = cube(DVec3::ZERO, 2.0, 4);
    let inside: Vec<bool> = (0..soup.faces.len()).map(|f| f < 32).collect();
    let open = cracked(&soup, &inside, 2e-3, 0.0, &mut random);
    let boundary = measured(&open).boundary_edges;
    for (ratio, tolerance, most, closes) in [
        (0.2, 1e-2, f64::INFINITY, true),
        (1e-4, 1e-2, f64::INFINITY, false),
        (0.2, 1e-5, f64::INFINITY, false),
        (0.2, 1e-2, 1e-5, false),
        (0.0, 1e-2, f64::INFINITY, false),
    ] {
        let mut mesh = open.clone();
        let applied = with_context(|c| Sew { ratio, tolerance, max_deviation: most }.apply(&mut mesh, c)).unwrap();
        assert_eq!(measured(&mesh).boundary_edges, if closes { 0 } else { boundary }, "{ratio} {tolerance} {most}");
        assert!(applied.moved <= most);
        assert!(closes || mesh == open);
    }
}

#[test]
fn t_junctions_are_cut_all_at_once_and_no_coordinate_changes() {
    // One side of a cube is finer than the others and has seven vertices along each edge of its neighbours.
    let coarse = cube(DVec3::ZERO, 2.0, 1);
    let fine = cube(DVec3::ZERO, 2.0, 8);
    let mut soup = Soup { positions: fine.positions.clone(), faces: fine.faces[..128].to_vec() };
    for face in 2..coarse.faces.len() {
        push(&mut soup, coarse.corners(face));
    }
    let mut mesh = surface(&soup);
    assert_eq!(mesh.positions.len(), surface(&soup).positions.len());
    let before = mesh.clone();
    assert!(measured(&mesh).boundary_edges > 0);
    let applied = with_context(|c| SplitTJunctions::default().apply(&mut mesh, c)).unwrap();
    assert_eq!(change_count(&applied.changes, "t_junctions_split"), 28);
    assert_eq!(mesh.positions, before.positions);
    let after = measured(&mesh);
    assert!(after.printable(), "{after:?}");
    assert!((after.volume.value - 8.0).abs() < 1e-12);
}

#[test]
fn a_vertex_off_the_edge_or_only_touching_it_is_no_t_junction() {
    let near = |offset: f64, along: DVec3| {
        let mut soup = Soup::default();
        push(&mut soup, [DVec3::ZERO, DVec3::X, DVec3::Y]);
        let tip = DVec3::new(0.5, -offset, 0.0);
        push(&mut soup, [tip, tip + along - DVec3::Y, tip + along]);
        let mut mesh = surface(&soup);
        let applied = with_context(|c| SplitTJunctions::default().apply(&mut mesh, c)).unwrap();
        change_count(&applied.changes, "t_junctions_split")
    };
    assert_eq!(near(0.0, DVec3::X), 1 + 1, "the tip on the edge, and the edge's end on the other's");
    assert_eq!(near(1e-3, DVec3::X), 0);
    assert_eq!(near(0.0, DVec3::new(0.3, -1.0, 0.0)), 0, "it touches at a point only");
}

#[test]
fn a_crack_with_other_vertices_on_its_sides_is_stitched() {
    for seed in 0..6 {
        for soup in solids() {
            let mut random = Random(seed);
            let whole = measured(&surface(&soup));
            let inside = patch(&surface(&soup), soup.faces.len() / 3, &mut random);
            let mut mesh = cracked(&soup, &inside, 1e-3, 0.6, &mut random);
            let before = mesh.clone();
            let applied = stitched(&mut mesh, Stitch { threshold: 5e-3, ..Stitch::default() });
            let after = measured(&mesh);
            assert!(after.closed && after.manifold && after.parts == 1, "{seed} {applied:?} {after:?}");
            assert!(change_count(&applied.changes, "crack_edges_split") > 0);
            assert!((after.volume.value - whole.volume.value).abs() < 0.01 * whole.volume.value);
            assert_eq!(farthest(&before, &mesh), 0.0);
        }
    }
}

#[test]
fn a_crack_between_two_parts_is_stitched() {
    // Two halves of a sphere, one of them rotated slightly, so that no vertices coincide.
    let soup = sphere(DVec3::ZERO, 1.0, 64, 32);
    let mut turned = soup.clone();
    let (sin, cos) = 0.02f64.sin_cos();
    for p in &mut turned.positions {
        *p = DVec3::new(p.x * cos - p.y * sin, p.x * sin + p.y * cos, p.z);
    }
    let half = |soup: &Soup, upper: bool| {
        let kept = (0..soup.faces.len()).filter(|&f| (soup.corners(f).iter().map(|p| p.z).sum::<f64>() > 0.0) == upper);
        Soup { positions: soup.positions.clone(), faces: kept.map(|f| soup.faces[f]).collect() }
    };
    let mut mesh = surface(&join(&half(&soup, true), &half(&turned, false)));
    assert_eq!(measured(&mesh).parts, 2);
    stitched(&mut mesh, Stitch { threshold: 1e-2, ..Stitch::default() });
    let after = measured(&mesh);
    assert!(after.closed && after.manifold && after.parts == 1, "{after:?}");
}

/// A square of four fans around a slit from `y` = 0 to `width`, with vertices on its sides at `upper` and `lower`.
fn slit(width: f64, upper: &[f64], lower: &[f64]) -> Surface {
    let mut mesh = Surface::default();
    let mut add = |x: f64, y: f64| {
        mesh.positions.push(DVec3::new(x, y, 0.0));
        mesh.positions.len() as u32 - 1
    };
    let ends = [add(0.0, 0.0), add(10.0, 0.0)];
    let (top, bottom) = (add(5.0, 5.0), add(5.0, -5.0));
    let chain = |add: &mut dyn FnMut(f64, f64) -> u32, xs: &[f64], y: f64| {
        let inner = xs.iter().map(|&x| add(x, y)).collect::<Vec<_>>();
        [&ends[..1], &inner, &ends[1..]].concat()
    };
    let above = chain(&mut add, upper, width);
    let below = chain(&mut add, lower, 0.0);
    for pair in above.windows(2) {
        mesh.push_patch([pair[0], pair[1], top]);
    }
    for pair in below.windows(2) {
        mesh.push_patch([pair[1], pair[0], bottom]);
    }
    mesh
}

#[test]
fn vertices_in_a_straight_line_are_not_merged() {
    // The nearest vertices are on the same side with one between them, and merging them would leave a T-junction. On the
    // other side there is only an edge.
    let mut mesh = slit(0.05, &[2.0, 2.01, 2.02, 6.0], &[]);
    let before = mesh.clone();
    let applied = stitched(&mut mesh, Stitch { threshold: 0.02, ..Stitch::default() });
    assert_eq!(change_count(&applied.changes, "crack_vertices_merged"), 0);
    assert_eq!(change_count(&applied.changes, "crack_edges_split"), 4);
    assert_eq!(mesh.positions, before.positions);
    assert_eq!(measured(&mesh).boundary_edges, 4, "only the outline is open");
}

#[test]
fn the_threshold_and_the_reach_bound_the_width_of_a_crack() {
    for (threshold, most, closes) in [(1e-2, 1.0, true), (1e-3, 1.0, false), (1e-2, 0.04, false), (0.0, 1.0, false)] {
        let open = slit(0.05, &[3.0, 7.0], &[5.0]);
        let mut mesh = open.clone();
        let applied = stitched(&mut mesh, Stitch { threshold, max_deviation: most, ..Stitch::default() });
        assert_eq!(measured(&mesh).boundary_edges == 4, closes, "{threshold} {most}");
        assert!(applied.moved <= most.min(threshold * 20.0));
        assert!(closes || mesh == open);
    }
}

#[test]
fn near_an_end_of_an_edge_the_end_is_taken() {
    for (snap, splits) in [(0.2, 0), (0.0, 2)] {
        let mut mesh = slit(0.01, &[5.0], &[5.1]);
        let applied = stitched(&mut mesh, Stitch { threshold: 0.02, snap, ..Stitch::default() });
        assert_eq!(change_count(&applied.changes, "crack_edges_split"), splits, "{applied:?}");
        assert_eq!(measured(&mesh).boundary_edges, 4);
    }
}

#[test]
fn a_hole_as_wide_as_its_edges_is_no_crack() {
    // Two faces of a fine mesh are missing.
    let mut soup = sphere(DVec3::ZERO, 1.0, 200, 100);
    soup.faces.drain(7001..7003);
    let mut target = surface(&soup);
    let before = target.clone();
    stitched(&mut target, Stitch { threshold: 0.1, ..Stitch::default() });
    assert_eq!(target, before);
}

#[test]
fn a_missing_face_is_no_crack_even_where_its_edges_are_longer_than_it_is_high() {
    let whole = sphere(DVec3::ZERO, 1.0, 60, 100);
    for missing in [1, 2] {
        let mut soup = whole.clone();
        soup.faces.drain(7001..7001 + missing);
        let mut target = surface(&soup);
        let before = target.clone();
        let applied = stitched(&mut target, Stitch { threshold: 0.1, ..Stitch::default() });
        assert!(target == before, "{missing}: {applied:?}");
    }
}

#[test]
fn closed_parts_near_one_another_and_open_sheets_are_not_touched() {
    let sheets = [
        join(&cube(DVec3::ZERO, 1.0, 4), &cube(DVec3::X * 1.0005, 1.0, 4)),
        sheet(30),
        // Two boxes without lids whose rims share a corner.
        {
            let mut open = cube(DVec3::ZERO, 1.0, 4);
            open.faces.truncate(160);
            let mut other = open.clone();
            other.positions.iter_mut().for_each(|p| *p += DVec3::new(1.0001, 1.0001, 0.0));
            join(&open, &other)
        },
    ];
    for soup in sheets {
        let before = surface(&soup);
        let mut mesh = before.clone();
        with_context(|c| {
            SplitTJunctions::default().apply(&mut mesh, c).unwrap();
            Sew::default().apply(&mut mesh, c).unwrap();
            Stitch::default().apply(&mut mesh, c).unwrap();
        });
        assert_eq!(mesh, before);
    }
}

#[test]
fn a_narrow_sheet_is_not_folded() {
    // A ribbon far narrower than the threshold.
    let mut soup = Soup::default();
    for i in 0..40 {
        let (x, y) = (f64::from(i), 1e-3);
        push(&mut soup, [DVec3::X * x, DVec3::X * (x + 1.0), DVec3::new(x + 0.5, y, 0.0)]);
        push(&mut soup, [DVec3::X * (x + 1.0), DVec3::new(x + 1.5, y, 0.0), DVec3::new(x + 0.5, y, 0.0)]);
    }
    let before = surface(&soup);
    let mut mesh = before.clone();
    with_context(|c| {
        SplitTJunctions { tolerance: 1e-3, ..SplitTJunctions::default() }.apply(&mut mesh, c).unwrap();
        Sew::default().apply(&mut mesh, c).unwrap();
        Stitch::default().apply(&mut mesh, c).unwrap();
    });
    assert_eq!(mesh, before);
}

#[test]
fn many_edges_in_one_place_are_given_up_in_bounded_time() {
    let mut soup = Soup::default();
    for i in 0..20_000 {
        let p = DVec3::new(f64::from(i) * 1e-9, 0.0, 0.0);
        push(&mut soup, [p, p + DVec3::Y, p + DVec3::new(0.5, 0.5, 1.0)]);
    }
    let mut mesh = surface(&soup);
    let applied = stitched(&mut mesh, Stitch::default());
    assert!(applied.left.is_some(), "{:?}", applied.changes);
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, failure_persistence: None, rng_seed: RngSeed::Fixed(1), ..ProptestConfig::default() })]

    #[test]
    fn cracked_solids_close_but_for_a_small_hole_that_filling_closes(seed in any::<u64>(), share in 0.02..0.9f64, cuts in 0.0..1.0f64, which in 0..3usize, exact in any::<bool>()) {
        let soup = &solids()[which];
        let mut random = Random(seed);
        let inside = patch(&surface(soup), (soup.faces.len() as f64 * share) as usize + 1, &mut random);
        let mut mesh = cracked(soup, &inside, if exact { 0.0 } else { 5e-4 }, cuts, &mut random);
        if exact {
            mesh = surface(&mesh.to_soup());
        }
        let whole = measured(&surface(soup));
        let moved = with_context(|c| {
            let applied = [
                SplitTJunctions::default().apply(&mut mesh, c).unwrap(),
                Sew::default().apply(&mut mesh, c).unwrap(),
                Stitch::default().apply(&mut mesh, c).unwrap(),
            ];
            applied.iter().map(|a| a.moved).sum::<f64>()
        });
        // Edges stay open where a crack ends bluntly, or where its last vertices are too far apart.
        let stitched = measured(&mesh);
        prop_assert!(stitched.boundary_edges <= 8 && stitched.manifold, "{stitched:?}");
        with_context(|c| FillHoles::default().apply(&mut mesh, c)).unwrap();
        let after = measured(&mesh);
        prop_assert!(after.closed && after.manifold && after.parts == 1, "{after:?}");
        prop_assert!((after.volume.value - whole.volume.value).abs() <= 3.0 * (moved + 1e-6) * whole.area);
    }

    #[test]
    fn random_faces_are_never_made_worse(faces in proptest::collection::vec((0..12u32, 0..12u32, 0..12u32), 1..30)) {
        let positions = (0..12).map(|i| DVec3::new(f64::from(i % 3), f64::from(i / 3) * 0.2, f64::from(i * i % 5) * 0.1)).collect();
        let soup = Soup { positions, faces: faces.into_iter().map(|(a, b, c)| [a, b, c]).collect() };
        let mut mesh = surface(&soup);
        with_context(|c| {
            let before = Counts::of(&mesh);
            SplitTJunctions { tolerance: 0.05, ..SplitTJunctions::default() }.apply(&mut mesh, c).unwrap();
            let cut = Counts::of(&mesh);
            Sew { ratio: 0.5, tolerance: 0.5, ..Sew::default() }.apply(&mut mesh, c).unwrap();
            let sewn = Counts::of(&mesh);
            Stitch { threshold: 0.5, ..Stitch::default() }.apply(&mut mesh, c).unwrap();
            let after = Counts::of(&mesh);
            use meshmend::repair::operators::Counter;
            for counter in [Counter::NonManifoldEdges, Counter::MisorientedEdges, Counter::DegenerateFaces, Counter::DuplicateFaces] {
                prop_assert!(after.get(counter) <= before.get(counter), "{counter:?} {before:?} {after:?}");
            }
            prop_assert!(sewn.get(Counter::BoundaryEdges) <= cut.get(Counter::BoundaryEdges));
            Ok(())
        })?;
    }
}
